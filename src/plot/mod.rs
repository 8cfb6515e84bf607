//! Figures of measured data, in one house style, as PNG pictures.
//!
//! [`render`] takes plain numbers and returns the bytes of a picture: up to three panels stacked
//! above a common x axis, legends above the panels, the caption below. Equal figures give equal
//! bytes. Nothing is computed about the data but where they fall on the page.

mod axis;
mod canvas;
pub mod coil;
pub mod diagnose;
pub mod effects;
mod encode;
pub mod freq;
mod legend;
pub mod lin;
pub mod linearise;
mod marks;
pub mod null;
pub mod offset;
mod parts;
pub mod profile;
mod rows;
mod style;
pub mod sweep;
mod text;
pub mod thermal;
pub mod thermistor;

use plotters::prelude::RGBColor;

pub use parts::Named;
pub use rows::CellRow;

use axis::{Axis, Span, Tick};
use canvas::{Canvas, Rect, rect};
use legend::{Entry, LEGEND_ROW, draw_legend, entries, flow};
use marks::{Frame, RIBBON, draw_series};
use style::{
    AXIS_INK, BAND_EDGE, BANDS, CAPTION, CAPTION_LINE, EXACT, GRID, HALF_DIGIT, LABEL, LABEL_LINE, NUMBER, TITLE, TITLE_LINE,
    ZERO,
};

/// A picture of one to three panels above a common x axis.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    /// Printed at the top left and kept as the title of the picture.
    pub title: String,
    /// One or two sentences printed below the plot and kept as the description of the picture.
    pub caption: String,
    /// Quantity and unit of the x axis.
    pub x_label: String,
    /// Scale of the x axis.
    pub x_scale: Scale,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

/// One plot of a [`Figure`].
#[derive(Debug, Clone, PartialEq)]
pub struct Panel {
    /// Quantity and unit of the y axis.
    pub y_label: String,
    /// Scale of the y axis.
    pub y_scale: Scale,
    /// Data to show.
    pub series: Vec<Series>,
    /// Ranges of y to set off behind the data.
    pub bands: Vec<Band>,
}

/// How values are spread along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Scale {
    /// Equal differences are equal lengths.
    #[default]
    Linear,
    /// Equal ratios are equal lengths; values that are not positive are left out.
    Logarithmic,
}

/// Data drawn with one style.
#[derive(Debug, Clone, PartialEq)]
pub struct Series {
    /// Name in the legend; without one the series has no legend entry.
    pub label: String,
    /// Colour, marker shape, dashes and line width.
    pub style: Style,
    /// The data and the way they are drawn.
    pub marks: Marks,
}

/// What a series stands for; the styles differ in more than colour.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Style {
    /// First component: blue, solid, circles.
    X,
    /// Second component: vermilion, dashed, squares.
    Y,
    /// Third component: green, dotted, triangles.
    Z,
    /// The only series of a panel: black, solid, circles.
    Single,
    /// A second series beside [`Style::Single`]: purple, dashed, diamonds.
    Second,
    /// A model, limit or nominal value: grey, thin, long dashes.
    Reference,
}

/// Data and the way they are drawn. Values that are not finite are left out.
#[derive(Debug, Clone, PartialEq)]
pub enum Marks {
    /// A few points (x, y), joined; a value that is not finite breaks the line.
    Line(Vec<(f64, f64)>),
    /// Settings (start, end, y), with thin joins where they follow each other closely; one that is
    /// not finite in between parts them.
    Steps(Vec<(f64, f64, f64)>),
    /// Points (x, y, standard uncertainty).
    Points(Vec<(f64, f64, Option<f64>)>),
    /// Points (x, y) that were measured but not used. Those far outside the range of the other
    /// data are shown as arrows at the edge of the panel and counted in the legend.
    Rejected(Vec<(f64, f64)>),
    /// Dense data as the extent of each column.
    Envelope(Vec<Column>),
    /// A band along a curve (x, low, high), behind everything else; an end that is not positive
    /// lies below the panel of a logarithmic y axis.
    Ribbon(Vec<(f64, f64, f64)>),
    /// Bars from zero to a value in rows with a name each, from top to bottom; the panel has names instead of a y axis.
    Bars(Vec<(String, f64)>),
    /// Rows of cells, from top to bottom; the panel has names instead of a y axis.
    Cells(Vec<CellRow>),
}

/// Extent of dense data in one column of a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Column {
    /// Centre of the column.
    pub x: f64,
    /// Smallest value.
    pub min: f64,
    /// Largest value.
    pub max: f64,
}

/// A range of y set off by a light ground.
#[derive(Debug, Clone, PartialEq)]
pub struct Band {
    /// Name in the legend; without one the band has no legend entry.
    pub label: String,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

/// Why a figure could not be drawn.
#[derive(Debug, thiserror::Error)]
pub enum PlotError {
    /// A figure has one to three panels.
    #[error("a figure has 1 to {MOST_PANELS} panels, not {0}")]
    Panels(usize),
    /// The embedded typeface could not be read.
    #[error("the embedded typeface cannot be read")]
    Typeface,
    /// Drawing into the pixel buffer failed.
    #[error("drawing failed: {0}")]
    Draw(String),
    /// Writing the picture format failed.
    #[error("encoding the picture failed")]
    Encode(#[from] png::EncodingError),
}

const MOST_PANELS: usize = 3;

// Sizes in pixels; a page 16 cm wide has 75 of them to the centimetre.
const WIDTH: i32 = 1200;
const HEIGHT: i32 = 750;
const EDGE: i32 = 16;
const RIGHT: i32 = WIDTH - 28;
const LEAST_PANEL: i32 = 90;
const PANEL_GAP: i32 = 8;
const TICK: i32 = 7;
const MINOR_TICK: i32 = 4;
/// Height above a panel without a legend, enough for the note of its y axis.
const LEAST_STRIP: i32 = 24;
/// Least distance of ticks on a y axis: in pixels, and as a share of a high panel.
const TICK_DISTANCE: f64 = 26.0;
const TICK_SHARE: f64 = 0.075;

/// A panel with its place on the page.
struct Plot<'a> {
    panel: &'a Panel,
    has_data: bool,
    /// Rows of the legend above the panel.
    legend: Vec<Vec<Entry>>,
    /// The y axis, unless there is nothing to show.
    y: Option<Axis>,
    area: Rect,
}

/// Draws a figure and returns it as a PNG picture.
///
/// # Errors
///
/// [`PlotError::Panels`] for a figure with no panel or with more than three. Data never cause an
/// error: values that cannot be drawn are left out, and an empty panel says so.
pub fn render(figure: &Figure) -> Result<Vec<u8>, PlotError> {
    let count = figure.panels.len();
    if !(1..=MOST_PANELS).contains(&count) {
        return Err(PlotError::Panels(count));
    }
    if text::typeface().is_none() {
        return Err(PlotError::Typeface);
    }
    let room = f64::from(RIGHT - EDGE);
    let title = text::wrap(&figure.title, TITLE.size, room, 2);
    let caption = text::wrap(&figure.caption, CAPTION.size, room, 8);
    let (mut plots, height) = arrange(figure, title.len() as i32, caption.len() as i32);
    let left = left_margin(&plots);
    for plot in &mut plots {
        plot.area.left = left;
    }
    let x = x_axis(figure, f64::from(RIGHT - left));

    let mut pixels = vec![0xff; (WIDTH * height * 3) as usize];
    let mut canvas = Canvas::new(&mut pixels, WIDTH as u32, height as u32);
    for (line, text) in title.iter().enumerate() {
        let y = EDGE + line as i32 * TITLE_LINE + 24;
        canvas.text(text, TITLE, (f64::from(EDGE), f64::from(y)), 0.0, false);
    }
    for plot in &plots {
        draw_plot(&mut canvas, plot, x.as_ref());
    }
    let bottom = plots.last().map_or(0, |plot| plot.area.bottom);
    draw_x_labels(&mut canvas, x.as_ref(), &figure.x_label, left, bottom);
    for (line, text) in caption.iter().rev().enumerate() {
        let y = height - 14 - line as i32 * CAPTION_LINE;
        canvas.text(text, CAPTION, (f64::from(EDGE), f64::from(y)), 0.0, false);
    }
    canvas.finish()?;
    let inks = Style::ALL.map(|style| style.look().ink);
    // A tint that turned into that of another style would mislead.
    let tint = |ink: &RGBColor| [ink.0, ink.1, ink.2].map(|c| (RIBBON * f64::from(c) + (1.0 - RIBBON) * 255.0).round() as u8);
    let tints: Vec<[u8; 3]> = inks.iter().map(tint).collect();
    let exact = EXACT.iter().chain(&inks).map(|ink| [ink.0, ink.1, ink.2]).chain(tints);
    let size = (WIDTH as u32, height as u32);
    Ok(encode::png(&pixels, size, exact, figure)?)
}

/// Shares the height of the page among the panels; the page grows when they would be too low.
fn arrange(figure: &Figure, title_lines: i32, caption_lines: i32) -> (Vec<Plot<'_>>, i32) {
    let mut above: Vec<Entry> = Vec::new();
    let mut plots: Vec<Plot> = Vec::new();
    let mut spans = Vec::new();
    for panel in &figure.panels {
        let scales = [figure.x_scale, panel.y_scale];
        let span = y_span(panel, scales);
        let entries = entries(panel, scales, span);
        // A legend that only repeats the one above is left out.
        let fresh = if entries == above { &[][..] } else { &entries };
        let legend = flow(fresh);
        let strip = LEAST_STRIP.max(LEGEND_ROW * legend.len() as i32);
        let area = rect(EDGE, strip, RIGHT, 0);
        spans.push(span);
        plots.push(Plot { panel, has_data: has_data(panel, scales), legend, y: None, area });
        above = entries;
    }
    let count = plots.len() as i32;
    let head = EDGE + title_lines * TITLE_LINE;
    let foot = TICK + 2 * LABEL_LINE + 14 + caption_lines * CAPTION_LINE + EDGE / 2;
    let strips: i32 = plots.iter().map(|plot| plot.area.top).sum();
    let fixed = head + strips + (count - 1) * PANEL_GAP + foot;
    let rows = figure.panels.iter().map(rows::least_height).max().unwrap_or(0);
    let each = ((HEIGHT - fixed) / count).max(LEAST_PANEL).max(rows);
    let mut top = head;
    for (plot, span) in plots.iter_mut().zip(spans) {
        plot.area.top += top;
        plot.area.bottom = plot.area.top + each;
        top = plot.area.bottom + PANEL_GAP;
        let length = f64::from(each);
        let least = TICK_DISTANCE.max(length * TICK_SHARE);
        plot.y = span.map(|span| Axis::new(span, length, |_, distance| distance >= least));
        if let Some(axis) = &mut plot.y {
            rows::name_ticks(plot.panel, axis);
        }
    }
    (plots, HEIGHT.max(fixed + each * count))
}

/// Room for the widest numbers and the names of the y axes.
fn left_margin(plots: &[Plot]) -> i32 {
    let ticks = plots.iter().flat_map(|plot| &plot.y).flat_map(|y| &y.ticks);
    let numbers = ticks.map(|tick| text::width(&tick.label, NUMBER.size));
    let names = plots.iter().map(|plot| y_names(plot).len()).max();
    let lines = names.unwrap_or_default() as i32;
    EDGE + lines * LABEL_LINE + numbers.fold(0.0, f64::max).ceil() as i32 + TICK + 14
}

/// The name of a y axis in the lines that fit beside the panel.
fn y_names(plot: &Plot) -> Vec<String> {
    let room = f64::from(plot.area.bottom - plot.area.top + LEAST_STRIP);
    text::wrap(&plot.panel.y_label, LABEL.size, room, 3)
}

/// The range all panels share, with ticks whose labels leave a gap between them.
fn x_axis(figure: &Figure, length: f64) -> Option<Axis> {
    let mut span = Span::empty(figure.x_scale);
    for panel in &figure.panels {
        for series in &panel.series {
            series.marks.visit([figure.x_scale, panel.y_scale], |x, _| span.add(x));
        }
    }
    let room = |ticks: &[Tick], distance: f64| {
        let widths = ticks.iter().map(|t| text::width(&t.label, NUMBER.size));
        distance >= widths.fold(60.0, f64::max) + 30.0
    };
    Some(Axis::new(span.padded(0.015)?, length, room))
}

impl Band {
    fn is_drawable(&self, scale: Scale) -> bool {
        scale.takes(self.low) && scale.takes(self.high)
    }
}

fn has_data(panel: &Panel, scales: [Scale; 2]) -> bool {
    let mut any = false;
    for series in &panel.series {
        series.marks.visit(scales, |_, _| any = true);
    }
    any
}

/// The range of y: everything but rejected points far away, which would press the rest flat.
fn y_span(panel: &Panel, scales: [Scale; 2]) -> Option<Span> {
    let mut used = Span::empty(panel.y_scale);
    for series in &panel.series {
        if !matches!(series.marks, Marks::Rejected(_)) {
            series.marks.visit(scales, |_, y| used.add(y));
        }
    }
    let has_data = !used.is_empty();
    for band in panel.bands.iter().filter(|band| band.is_drawable(panel.y_scale)) {
        used.add(band.low);
        used.add(band.high);
    }
    let near = used.padded(1.0).filter(|_| has_data);
    for series in &panel.series {
        if matches!(series.marks, Marks::Rejected(_)) {
            series.marks.visit(scales, |_, y| {
                if near.is_none_or(|near| near.contains(y)) {
                    used.add(y);
                }
            });
        }
    }
    used.padded(0.07)
}

fn draw_plot(canvas: &mut Canvas, plot: &Plot, x: Option<&Axis>) {
    let area = plot.area;
    let full = canvas.clip;
    let (left, top, right, bottom) = (area.left, area.top, area.right, area.bottom);
    let middle = f64::from(top + bottom) / 2.0;
    if let Some(y) = &plot.y {
        draw_bands(canvas, plot, y, false);
        draw_y_ticks(canvas, area, y);
    }
    if let Some(x) = x {
        draw_x_ticks(canvas, area, x);
    }
    if let (Some(x), Some(y)) = (x, &plot.y) {
        draw_bands(canvas, plot, y, true);
        canvas.clip = area;
        let frame = Frame { x, y, area };
        draw_series(canvas, &frame, plot.panel);
    }
    canvas.clip = full;
    if !plot.has_data {
        let centre = f64::from(left + right) / 2.0;
        canvas.text("no data", LABEL, (centre, middle + 8.0), 0.5, false);
    }

    canvas.rect(rect(left, top, right, top + 1), GRID, 1.0);
    canvas.rect(rect(right - 1, top, right, bottom), GRID, 1.0);
    canvas.rect(rect(left, top, left + 1, bottom + 1), AXIS_INK, 1.0);
    canvas.rect(rect(left, bottom, right, bottom + 1), AXIS_INK, 1.0);
    for (line, name) in y_names(plot).iter().enumerate() {
        let x = EDGE + line as i32 * LABEL_LINE + 18;
        canvas.text(name, LABEL, (f64::from(x), middle), 0.5, true);
    }
    draw_legend(canvas, &plot.legend, area.top);
}

/// Grid lines, ticks and numbers of a y axis, and the note that belongs to them.
fn draw_y_ticks(canvas: &mut Canvas, area: Rect, y: &Axis) {
    let (left, right) = (area.left, area.right);
    let place = |v: f64| y.at(v, f64::from(area.bottom), f64::from(area.top)).round() as i32;
    for at in y.minor.iter().map(|&v| place(v)) {
        canvas.rect(rect(left - MINOR_TICK, at, left, at + 1), AXIS_INK, 1.0);
    }
    for tick in &y.ticks {
        let at = place(tick.value);
        canvas.rect(rect(left, at, right, at + 1), grid(tick), 1.0);
        canvas.rect(rect(left - TICK, at, left, at + 1), AXIS_INK, 1.0);
        let end = (f64::from(left - TICK - 6), f64::from(at) + HALF_DIGIT);
        canvas.text(&tick.label, NUMBER, end, 1.0, false);
    }
    let above = (f64::from(left), f64::from(area.top - 8));
    canvas.text(&y.note, NUMBER, above, 0.0, false);
}

/// Grid lines and ticks of the x axis.
fn draw_x_ticks(canvas: &mut Canvas, area: Rect, x: &Axis) {
    let (top, bottom) = (area.top, area.bottom);
    let place = |v: f64| x.at(v, f64::from(area.left), f64::from(area.right)).round() as i32;
    for at in x.minor.iter().map(|&v| place(v)) {
        canvas.rect(rect(at, bottom, at + 1, bottom + MINOR_TICK), AXIS_INK, 1.0);
    }
    for tick in &x.ticks {
        let at = place(tick.value);
        canvas.rect(rect(at, top, at + 1, bottom), grid(tick), 1.0);
        canvas.rect(rect(at, bottom, at + 1, bottom + TICK), AXIS_INK, 1.0);
    }
}

fn grid(tick: &Tick) -> RGBColor {
    if tick.value == 0.0 { ZERO } else { GRID }
}

fn draw_x_labels(canvas: &mut Canvas, x: Option<&Axis>, name: &str, left: i32, bottom: i32) {
    let (from, to) = (f64::from(left), f64::from(RIGHT));
    let numbers = f64::from(bottom + TICK + 20);
    let names = numbers + f64::from(LABEL_LINE);
    let mut note = 0.0;
    if let Some(x) = x {
        for tick in &x.ticks {
            // Numbers at the ends stay on the page.
            let half = text::width(&tick.label, NUMBER.size) / 2.0;
            let most = f64::from(WIDTH - 6) - half;
            let at = x.at(tick.value, from, to).min(most);
            canvas.text(&tick.label, NUMBER, (at, numbers), 0.5, false);
        }
        canvas.text(&x.note, NUMBER, (to, names), 1.0, false);
        note = text::width(&x.note, NUMBER.size);
    }
    let name = text::fit(name, LABEL.size, to - from - 2.0 * note - 40.0);
    canvas.text(&name, LABEL, ((from + to) / 2.0, names), 0.5, false);
}

fn draw_bands(canvas: &mut Canvas, plot: &Plot, y: &Axis, edges: bool) {
    let area = plot.area;
    let bands = plot.panel.bands.iter().zip(BANDS.iter().cycle());
    let mut bands: Vec<_> = bands.filter(|(band, _)| band.is_drawable(plot.panel.y_scale)).collect();
    // Wide bands first, so that narrow ones inside them stay visible.
    let width = |band: &Band| (band.high - band.low).abs();
    bands.sort_by(|(a, _), (b, _)| width(b).total_cmp(&width(a)));
    for (band, &ink) in bands {
        let place = |v: f64| y.at(v, f64::from(area.bottom), f64::from(area.top)).round() as i32;
        let (a, b) = (place(band.low), place(band.high));
        let (top, bottom) = (a.min(b), a.max(b) + 1);
        if edges {
            for edge in [top, bottom - 1] {
                canvas.rect(rect(area.left, edge, area.right, edge + 1), BAND_EDGE, 1.0);
            }
        } else {
            canvas.rect(rect(area.left, top, area.right, bottom), ink, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
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
            series: series
                .enumerate()
                .map(|(n, (marks, &style))| Series { label: format!("series {n}"), style, marks })
                .collect(),
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
}
