//! Figures of made data: nothing fails, nothing is lost, equal figures give equal bytes.

use super::*;

const ALL: [Style; 6] = Style::ALL;
const LINEAR: [Scale; 2] = [Scale::Linear; 2];
const SCALES: [Scale; 2] = [Scale::Linear, Scale::Logarithmic];
const KINDS: usize = 6;

fn figure(panels: Vec<Panel>) -> Figure {
    Figure {
        title: "Residuals".to_string(),
        caption: "Nothing to see but the residuals.".to_string(),
        x_label: "field (nT)".to_string(),
        x_scale: Scale::Linear,
        panels,
    }
}

fn panel(marks: impl IntoIterator<Item = Marks>) -> Panel {
    let series = marks.into_iter().zip(ALL.iter().cycle());
    Panel {
        y_label: "residual (nT)".to_string(),
        y_scale: Scale::Linear,
        series: series.enumerate().map(|(n, (marks, &style))| Series { label: format!("series {n}"), style, marks }).collect(),
        bands: Vec::new(),
    }
}

/// Every kind of marks, all with the same values.
fn every_kind(values: &[(f64, f64)]) -> Vec<Marks> {
    let columns = values.iter().map(|&(x, y)| Column { x, min: y, max: y * 1.5 });
    let mut kinds = vec![
        Marks::Line(values.to_vec()),
        Marks::Steps(values.iter().map(|&(x, y)| (x, x + 1.0, y)).collect()),
        Marks::Points(values.iter().map(|&(x, y)| (x, y, Some(y))).collect()),
        Marks::Rejected(values.to_vec()),
        Marks::Envelope(columns.collect()),
        Marks::Ribbon(values.iter().map(|&(x, y)| (x, y, y * 1.5)).collect()),
    ];
    kinds.extend(kinds.clone());
    kinds
}

struct Picture {
    width: u32,
    height: u32,
    texts: Vec<(String, String)>,
    rgb: Vec<u8>,
}

impl Picture {
    fn of(figure: &Figure) -> Picture {
        let bytes = render(figure).expect("rendered");
        let mut decoder = png::Decoder::new(std::io::Cursor::new(bytes));
        decoder.set_transformations(png::Transformations::EXPAND);
        let mut reader = decoder.read_info().expect("a PNG picture");
        let mut rgb = vec![0; reader.output_buffer_size().expect("size")];
        reader.next_frame(&mut rgb).expect("pixels");
        let info = reader.info();
        let dims = info.pixel_dims.expect("density");
        assert_eq!((dims.xppu, dims.yppu), (5906, 5906));
        let plain = info.uncompressed_latin1_text.iter();
        let plain = plain.map(|t| (t.keyword.clone(), t.text.clone()));
        let other = info.utf8_text.iter();
        let other = other.map(|t| (t.keyword.clone(), t.get_text().expect("text")));
        Picture { width: info.width, height: info.height, texts: plain.chain(other).collect(), rgb }
    }

    /// Pixels of exactly the colour of a style.
    fn count(&self, style: Style) -> usize {
        let ink = style.look().ink;
        let pixels = self.rgb.chunks_exact(3);
        pixels.filter(|p| *p == [ink.0, ink.1, ink.2]).count()
    }
}

#[test]
fn a_figure_has_one_to_three_panels() {
    let none = render(&figure(Vec::new()));
    assert!(matches!(none, Err(PlotError::Panels(0))));
    let four = render(&figure(vec![panel([]); 4]));
    assert!(matches!(four, Err(PlotError::Panels(4))));
}

#[test]
fn texts_are_kept_in_the_picture() {
    let mut one = figure(vec![panel([])]);
    one.caption = "Mean ± σ of ΔB".to_string();
    let picture = Picture::of(&one);
    assert_eq!((picture.width, picture.height), (1200, 750));
    let software = format!("calfit {}", env!("CARGO_PKG_VERSION"));
    let expected = [("Title", "Residuals"), ("Software", software.as_str()), ("Description", "Mean ± σ of ΔB")];
    let expected = expected.map(|(k, t)| (k.to_string(), t.to_string()));
    assert_eq!(picture.texts, expected);
}

#[test]
fn equal_figures_give_equal_bytes() {
    let values: Vec<(f64, f64)> = (0..50).map(|n| (f64::from(n), f64::from(n % 7))).collect();
    let one = figure(vec![panel(every_kind(&values)); 3]);
    assert_eq!(render(&one).expect("rendered"), render(&one).expect("rendered"));
}

#[test]
fn all_styles_and_marks_are_seen() {
    let values: Vec<(f64, f64)> = (0..30).map(|n| (f64::from(n), f64::from(n * n))).collect();
    for marks in &every_kind(&values)[..KINDS] {
        for style in ALL {
            let mut one = panel([marks.clone()]);
            one.series[0].style = style;
            one.series[0].label.clear();
            let picture = Picture::of(&figure(vec![one]));
            assert!(picture.count(style) > 200, "{style:?} {marks:?}");
        }
    }
}

#[test]
fn values_that_cannot_be_drawn_are_left_out() {
    let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MAX, f64::MIN, f64::MIN_POSITIVE, 1e300, -1e300, -0.0, 1.0];
    for (n, &a) in odd.iter().enumerate() {
        for &b in odd.iter().skip(n % 3).step_by(3) {
            let values = [(a, b), (b, a), (1.0, a), (a, 1.0), (b, b), (2.0, 3.0)];
            let mut one = panel(every_kind(&values));
            one.bands.push(Band { label: "band".to_string(), low: a, high: b });
            let mut one = figure(vec![one]);
            // Rendering must succeed, whatever is left to draw.
            render(&one).expect("rendered");
            one.x_scale = Scale::Logarithmic;
            one.panels[0].y_scale = Scale::Logarithmic;
            render(&one).expect("rendered");
        }
    }
}

#[test]
fn few_values_are_enough() {
    for values in [&[][..], &[(1.0, 2.0)], &[(1.0, 2.0); 5]] {
        for marks in every_kind(values).into_iter().take(KINDS) {
            for scale in SCALES {
                let mut one = figure(vec![panel([marks.clone()]), panel([])]);
                one.x_scale = scale;
                one.panels[0].y_scale = scale;
                Picture::of(&one);
            }
        }
    }
}

#[test]
fn an_empty_panel_has_no_range() {
    assert_eq!(y_span(&panel([]), LINEAR), None);
    let nothing = Marks::Points(vec![(f64::NAN, 1.0, None), (1.0, f64::NAN, Some(1.0))]);
    assert_eq!(y_span(&panel([nothing]), LINEAR), None);
}

#[test]
fn error_bars_and_bands_lie_within_the_range() {
    let mut one = panel([Marks::Points(vec![(0.0, 1.0, Some(5.0)), (1.0, 2.0, None)])]);
    one.bands.push(Band { label: String::new(), low: -8.0, high: 3.0 });
    let span = y_span(&one, LINEAR).expect("data");
    assert!(span.contains(6.0) && span.contains(-8.0));
}

#[test]
fn far_rejected_points_do_not_stretch_the_range() {
    let used = Marks::Points(vec![(0.0, -1.0, None), (1.0, 1.0, None)]);
    let one = panel([used, Marks::Rejected(vec![(0.5, 2.5), (0.6, 900.0)])]);
    let span = y_span(&one, LINEAR).expect("data");
    assert!(span.contains(2.5) && span.high < 4.0);
    let labels: Vec<_> = entries(&one, LINEAR, Some(span)).into_iter().collect();
    assert_eq!(labels.len(), 2);
    let only = panel([Marks::Rejected(vec![(0.5, 2.5), (0.6, 900.0)])]);
    assert!(y_span(&only, LINEAR).is_some_and(|span| span.contains(900.0)));
}

#[test]
fn labels_of_the_x_axis_never_touch() {
    for exponent in -12..12 {
        for (low, high) in [(0.0, 1.0), (-3.3, 9.1), (1000.0, 1000.7), (-5000.0, -4999.0)] {
            let scale = 10f64.powi(exponent);
            let line = Marks::Line(vec![(low * scale, 0.0), (high * scale, 1.0)]);
            let axis = x_axis(&figure(vec![panel([line])]), 1050.0).expect("data");
            assert_apart(&axis);
        }
        for high in [1.0001, 1.4, 3.3, 12.0, 99.0, 120.0, 1e5, 1e11, 1e40] {
            let scale = 1.3 * 10f64.powi(exponent);
            let mut one = figure(vec![panel([Marks::Line(vec![(scale, 0.0), (high * scale, 1.0)])])]);
            one.x_scale = Scale::Logarithmic;
            assert_apart(&x_axis(&one, 1050.0).expect("data"));
        }
    }
}

fn assert_apart(axis: &Axis) {
    assert!(axis.ticks.len() > 1, "{axis:?}");
    for pair in axis.ticks.windows(2) {
        let place = |tick: &Tick| axis.at(tick.value, 0.0, 1050.0);
        let half = |tick: &Tick| text::width(&tick.label, NUMBER.size) / 2.0;
        let gap = place(&pair[1]) - place(&pair[0]) - half(&pair[0]) - half(&pair[1]);
        assert!(gap > 15.0, "{pair:?}");
    }
}

#[test]
fn values_that_are_not_positive_are_left_out_of_logarithmic_panels() {
    let values = [(-1.0, 5.0), (0.0, 5.0), (2.0, -7.0), (2.0, 0.0)];
    let mut one = figure(vec![panel(every_kind(&values).into_iter().take(KINDS))]);
    one.x_scale = Scale::Logarithmic;
    one.panels[0].y_scale = Scale::Logarithmic;
    let scales = [Scale::Logarithmic; 2];
    assert!(!has_data(&one.panels[0], scales));
    assert!(y_span(&one.panels[0], scales).is_none() && x_axis(&one, 1050.0).is_none());
    Picture::of(&one);
}

#[test]
fn errors_and_ribbons_may_reach_below_a_logarithmic_panel() {
    let mut one = panel([
        Marks::Points(vec![(1.0, 2.0, Some(3.0)), (2.0, 4.0, None)]),
        Marks::Ribbon(vec![(1.0, -1.0, 8.0), (2.0, 0.0, 8.0)]),
    ]);
    one.y_scale = Scale::Logarithmic;
    let span = y_span(&one, SCALES).expect("data");
    assert!(span.contains(2.0) && span.contains(8.0) && !span.contains(1.0));
    let both = Picture::of(&figure(vec![one.clone()]));
    one.series.truncate(1);
    let points = Picture::of(&figure(vec![one]));
    let tinted = |picture: &Picture| picture.rgb.chunks_exact(3).filter(|p| p[0] > p[2] && p[2] > 200).count();
    assert!(tinted(&both) > tinted(&points) + 100_000);
}

#[test]
fn overlapping_ribbons_are_told_apart() {
    let ribbon = |shift: f64| Marks::Ribbon((0..90).map(|n| (f64::from(n), shift, shift + 10.0)).collect());
    let one = panel([ribbon(0.0), ribbon(3.0), ribbon(6.0)]);
    assert_eq!(entries(&one, LINEAR, y_span(&one, LINEAR)).len(), 3);
    let picture = Picture::of(&figure(vec![one]));
    for style in &ALL[..3] {
        assert!(picture.count(*style) > 300, "{style:?}");
    }
    let mut tints: Vec<&[u8]> = picture.rgb.chunks_exact(3).collect();
    tints.sort();
    let areas = tints.chunk_by(|a, b| a == b).filter(|area| area.len() > 20_000);
    // The page and five different overlaps.
    assert_eq!(areas.count(), 6);
}

#[test]
fn reference_steps_carry_no_tags() {
    let steps = |y: f64| Marks::Steps((0..9).map(|n| (f64::from(n), f64::from(n) + 0.5, y)).collect());
    let mut one = panel([steps(1.0), steps(2.0)]);
    assert!(marks::is_tagged(&one));
    one.series[1].style = Style::Reference;
    assert!(!marks::is_tagged(&one));
}

#[test]
fn long_texts_neither_fail_nor_hide_the_plot() {
    let mut one = figure(vec![panel(every_kind(&[(0.0, 1.0), (5.0, 2.0)])); 3]);
    one.title = "title ".repeat(500);
    one.caption = "W".repeat(100_000);
    one.x_label = "label ".repeat(500);
    for panel in &mut one.panels {
        panel.y_label = "label ".repeat(500);
        for (n, series) in panel.series.iter_mut().enumerate() {
            series.label = format!("{n} {}", "name ".repeat(100));
        }
    }
    one.panels[1].series.truncate(3);
    let picture = Picture::of(&one);
    assert!((750..2000).contains(&picture.height), "{}", picture.height);
}

#[test]
fn a_repeated_legend_is_left_out() {
    let line = || panel([Marks::Line(vec![(0.0, 1.0), (5.0, 2.0)])]);
    let same = figure(vec![line(), line()]);
    let (plots, _) = arrange(&same, 1, 1);
    assert_eq!(plots[0].legend.len(), 1);
    assert!(plots[1].legend.is_empty());
}

#[test]
fn points_of_two_series_at_one_place_stand_beside_each_other() {
    let points = |style: Style, shift: f64| Series {
        label: String::new(),
        style,
        marks: Marks::Points((0..9).map(|n| (f64::from(n) + shift, 1.0, None)).collect()),
    };
    let of = |series: Vec<Series>| Picture::of(&figure(vec![Panel { series, ..panel([]) }]));
    let alone = of(vec![points(Style::X, 0.0)]).count(Style::X);
    let both = of(vec![points(Style::X, 0.0), points(Style::Second, 0.0)]);
    // Nothing hides the first series, which is drawn below the second one.
    assert!(both.count(Style::X) > alone * 9 / 10, "{} of {alone}", both.count(Style::X));
    // Points on a curve stay on it.
    let curve =
        |style| Series { label: String::new(), style, marks: Marks::Line((0..99).map(|n| (f64::from(n) / 11.0, 1.0)).collect()) };
    let on_curve = of(vec![points(Style::X, 0.0), points(Style::Second, 0.0), curve(Style::X)]);
    let line = of(vec![curve(Style::X)]).count(Style::X);
    assert!(on_curve.count(Style::X) < line, "{} and {line}", on_curve.count(Style::X));
}

#[test]
fn names_stand_in_place_of_numbers() {
    let names: Vec<(f64, String)> = (0..4).map(|n| (f64::from(n) + 1.0, format!("state {n}"))).collect();
    let points = Marks::Points(vec![(1.0, 3.0, None), (4.0, 5.0, None)]);
    let of =
        |names: Vec<(f64, String)>| x_axis(&figure(vec![panel([Marks::Names(names), points.clone()])]), 1050.0).expect("data");
    let axis = of(names);
    assert_eq!(
        axis.ticks.iter().map(|tick| tick.label.as_str()).collect::<Vec<_>>(),
        ["state 0", "state 1", "state 2", "state 3"]
    );
    assert!(axis.minor.is_empty() && axis.at(1.0, 0.0, 1050.0) > 100.0);
    let many = of((0..300).map(|n| (f64::from(n), format!("state {n}"))).collect());
    assert!(many.ticks.len() < 20);
    for pair in many.ticks.windows(2) {
        assert!(
            many.at(pair[1].value, 0.0, 1050.0) - many.at(pair[0].value, 0.0, 1050.0) > text::width(&pair[1].label, NUMBER.size)
        );
    }
}

#[test]
fn what_holds_no_data_is_left_out() {
    let empty = || panel([Marks::Line(Vec::new())]);
    let full = || panel([Marks::Line(vec![(0.0, 1.0), (1.0, 2.0)])]);
    assert_eq!(figure(vec![empty(), empty()]).with_data(), None);
    assert_eq!(figure(vec![empty(), full()]).with_data(), Some(figure(vec![full()])));
    assert_eq!(figure(vec![full()]).with_data(), Some(figure(vec![full()])));
}

#[test]
fn a_caption_says_that_points_stand_beside_their_place() {
    let points = |y: f64| Marks::Points((0..9).map(|n| (f64::from(n), y, None)).collect());
    let aside = |marks: Vec<Marks>| {
        let figure = figure(vec![panel(marks)]);
        let (plots, _) = arrange(&figure, 1, 1);
        let x = x_axis(&figure, 1000.0);
        plots.iter().any(|plot| stand_aside(plot, x.as_ref()))
    };
    assert!(aside(vec![points(1.0), points(2.0)]));
    assert!(!aside(vec![points(1.0)]));
}
