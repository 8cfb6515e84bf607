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
mod figure;
#[cfg(feature = "tables")]
pub mod flight;
mod frame;
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

pub use figure::{Band, Column, Figure, Marks, Panel, Scale, Series, Style};
pub use parts::Named;
pub use rows::CellRow;

use axis::{Axis, Span, Tick};
use canvas::{Canvas, Rect, rect};
use frame::Frame;
use legend::{Entry, LEGEND_ROW, draw_legend, entries, flow};
use marks::{RIBBON, beside_each_other, draw_series};
use style::{
    AXIS_INK, BAND_EDGE, BANDS, CAPTION, CAPTION_LINE, EXACT, GRID, HALF_DIGIT, LABEL, LABEL_LINE, NUMBER, TITLE, TITLE_LINE,
    ZERO,
};

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
    let laid_out = |caption: &str| {
        let caption = text::wrap(caption, CAPTION.size, room, 8);
        let (mut plots, height) = arrange(figure, title.len() as i32, caption.len() as i32);
        let left = left_margin(&plots);
        for plot in &mut plots {
            plot.area.left = left;
        }
        (caption, plots, height, left, x_axis(figure, f64::from(RIGHT - left)))
    };
    let mut page = laid_out(&figure.caption);
    // Whoever reads a value off a moved point must know that it was moved.
    if page.1.iter().any(|plot| stand_aside(plot, page.4.as_ref())) {
        page = laid_out(&format!("{} {MOVED}", figure.caption));
    }
    let (caption, plots, height, left, x) = page;

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

/// What a caption says of points that were drawn beside their place.
const MOVED: &str = "Points of several series at one place stand side by side.";

/// Whether points of a panel are drawn beside their place.
fn stand_aside(plot: &Plot, x: Option<&Axis>) -> bool {
    let frame = x.zip(plot.y.as_ref()).map(|(x, y)| Frame { x, y, area: plot.area, aside: 0.0 });
    frame.is_some_and(|frame| beside_each_other(&frame, plot.panel).iter().any(|aside| *aside != 0.0))
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
    let names: Vec<&(f64, String)> = figure
        .panels
        .iter()
        .flat_map(|panel| &panel.series)
        .find_map(|series| series.marks.names())
        .into_iter()
        .flatten()
        .collect();
    let Some([first, last]) = names.first().zip(names.last()).map(|(first, last)| [first.0, last.0]) else {
        return Some(Axis::new(span.padded(0.02)?, length, room));
    };
    span.add(first - 0.5);
    span.add(last + 0.5);
    let mut axis = Axis::new(span, length, room);
    let widest = names.iter().map(|(_, name)| text::width(name, NUMBER.size)).fold(0.0, f64::max) + 16.0;
    // Every name, or every second or tenth of many.
    let step = (widest * span.width() / length).ceil().max(1.0) as usize;
    axis.ticks = names.iter().step_by(step).map(|(value, label)| Tick { value: *value, label: label.clone() }).collect();
    axis.minor.clear();
    axis.note.clear();
    Some(axis)
}

impl Figure {
    /// The figure without panels that hold no data; `None` where none holds any.
    #[must_use]
    pub fn with_data(mut self) -> Option<Figure> {
        let x_scale = self.x_scale;
        self.panels.retain(|panel| has_data(panel, [x_scale, panel.y_scale]));
        (!self.panels.is_empty()).then_some(self)
    }
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
        let frame = Frame { x, y, area, aside: 0.0 };
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
mod tests;
