//! The legend above a panel.

use plotters::prelude::RGBColor;

use super::axis::Span;
use super::canvas::{Canvas, Point, rect};
use super::marks::{RIBBON, RIM, crossed, envelope_alpha, error_bar, is_marked, is_tagged, marker, step, stroke};
use super::style::{BAND_EDGE, BANDS, HALF_DIGIT, NUMBER};
use super::{Marks, Panel, RIGHT, Scale, Style, text};

pub(super) const LEGEND_ROW: i32 = 28;
const MOST_ROWS: usize = 6;
const ENTRY_GAP: f64 = 26.0;
const SAMPLE_GAP: f64 = 8.0;
/// Width a legend may take, which leaves room for the note of the y axis beside it.
const LEGEND_ROOM: f64 = 900.0;

/// How an entry is shown in the legend.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Sample {
    /// With or without a marker.
    Line(Style, bool),
    /// With or without a marker.
    Steps(Style, bool),
    /// With or without an error bar.
    Points(Style, bool),
    Rejected(Style),
    /// With or without a marker, and the opacity.
    Envelope(Style, bool, f64),
    Ribbon(Style),
    Band(RGBColor),
}

impl Sample {
    fn width(self) -> f64 {
        match self {
            Sample::Points(..) | Sample::Rejected(_) => 20.0,
            _ => 44.0,
        }
    }
}

#[derive(Debug, Clone, PartialEq)]
pub(super) struct Entry {
    sample: Sample,
    label: String,
    /// Width of the sample and the label.
    width: f64,
}

/// The legend of a panel: series in their order, then bands, without repetitions.
pub(super) fn entries(panel: &Panel, scales: [Scale; 2], span: Option<Span>) -> Vec<Entry> {
    let mut found: Vec<Entry> = Vec::new();
    let mut add = |sample: Sample, label: &str, extra: &str| {
        let room = LEGEND_ROOM - 60.0 - text::width(extra, NUMBER.size);
        let label = text::fit(label, NUMBER.size, room) + extra;
        let width = sample.width() + SAMPLE_GAP + text::width(&label, NUMBER.size);
        let entry = Entry { sample, label, width };
        if entry.label != extra && !found.contains(&entry) {
            found.push(entry);
        }
    };
    let tagged = is_tagged(panel);
    for series in &panel.series {
        let style = series.style;
        let mut extra = String::new();
        let sample = match &series.marks {
            Marks::Line(points) => Sample::Line(style, is_marked(points, style)),
            Marks::Steps(_) => Sample::Steps(style, tagged && style != Style::Reference),
            Marks::Points(points) => Sample::Points(style, points.iter().any(|p| p.2.is_some())),
            Marks::Rejected(_) => {
                let mut outside = 0;
                series.marks.visit(scales, |_, y| outside += usize::from(span.is_some_and(|s| !s.contains(y))));
                if outside > 0 {
                    extra = format!(" ({outside} off scale)");
                }
                Sample::Rejected(style)
            }
            Marks::Envelope(_) => Sample::Envelope(style, tagged, envelope_alpha(panel)),
            Marks::Ribbon(_) => Sample::Ribbon(style),
            Marks::Bars(_) => Sample::Envelope(style, false, 1.0),
            // Their numbers stand in them.
            Marks::Cells(_) | Marks::Shown(_) | Marks::Names(_) => continue,
        };
        add(sample, &series.label, &extra);
    }
    let bands = panel.bands.iter().zip(BANDS.iter().cycle());
    for (band, ink) in bands.filter(|(band, _)| band.is_drawable(panel.y_scale)) {
        add(Sample::Band(*ink), &band.label, "");
    }
    found
}

/// Sets the entries of a legend in rows.
pub(super) fn flow(entries: &[Entry]) -> Vec<Vec<Entry>> {
    let mut rows: Vec<Vec<Entry>> = Vec::new();
    let mut used = 0.0;
    for entry in entries {
        used += entry.width + ENTRY_GAP;
        match rows.last_mut() {
            Some(row) if used - ENTRY_GAP <= LEGEND_ROOM => row.push(entry.clone()),
            _ => {
                used = entry.width + ENTRY_GAP;
                rows.push(vec![entry.clone()]);
            }
        }
    }
    if rows.len() > MOST_ROWS {
        rows.truncate(MOST_ROWS);
        if let Some(last) = rows.last_mut().and_then(|row| row.last_mut()) {
            last.label.push_str(" …");
        }
    }
    rows
}

/// Draws the rows of a legend, the last one directly above `bottom`.
pub(super) fn draw_legend(canvas: &mut Canvas, rows: &[Vec<Entry>], bottom: i32) {
    for (row, entries) in rows.iter().rev().enumerate() {
        let total: f64 = entries.iter().map(|e| e.width + ENTRY_GAP).sum();
        let mut x = f64::from(RIGHT) - total + ENTRY_GAP;
        let y = f64::from(bottom - LEGEND_ROW * row as i32 - 8);
        for entry in entries {
            draw_sample(canvas, entry.sample, (x, y - HALF_DIGIT));
            let start = x + entry.sample.width() + SAMPLE_GAP;
            canvas.text(&entry.label, NUMBER, (start, y), 0.0, false);
            x += entry.width + ENTRY_GAP;
        }
    }
}

fn draw_sample(canvas: &mut Canvas, sample: Sample, at: Point) {
    let end = (at.0 + sample.width(), at.1);
    let centre = (at.0 + sample.width() / 2.0, at.1);
    let (left, right) = (at.0.round() as i32, end.0.round() as i32);
    let box_of = |half: i32| rect(left, at.1 as i32 - half, right, at.1 as i32 + half);
    match sample {
        Sample::Line(style, marked) => {
            stroke(canvas, &[at, end], &style.look());
            if marked {
                marker(canvas, &style.look(), centre, 5.0, 0.0);
            }
        }
        Sample::Steps(style, marked) => {
            step(canvas, at.0, end.0, at.1, &style.level());
            if marked {
                marker(canvas, &style.look(), centre, 5.5, 0.0);
            }
        }
        Sample::Points(style, errors) => {
            let look = style.look();
            if errors {
                error_bar(canvas, centre, (at.1 - 10.0, at.1 + 10.0), look.ink, true);
            }
            marker(canvas, &look, centre, 5.0, RIM);
        }
        Sample::Rejected(style) => crossed(canvas, &style.look(), centre),
        Sample::Envelope(style, marked, alpha) => {
            canvas.rect(box_of(6), style.look().ink, alpha);
            if marked {
                marker(canvas, &style.look(), centre, 5.5, RIM);
            }
        }
        Sample::Ribbon(style) => {
            canvas.rect(box_of(7), style.look().ink, RIBBON);
            for y in [at.1 - 7.0, at.1 + 7.0] {
                stroke(canvas, &[(at.0, y), (end.0, y)], &style.look().edge());
            }
        }
        Sample::Band(ink) => {
            canvas.rect(box_of(7), BAND_EDGE, 1.0);
            let inner = box_of(6);
            canvas.rect(rect(left + 1, inner.top, right - 1, inner.bottom), ink, 1.0);
        }
    }
}
