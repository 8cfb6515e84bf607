//! Rows with names instead of numbers: bars, and cells whose colour and number say how large a value is.

use plotters::prelude::RGBColor;

use super::axis::{Axis, Tick};
use super::canvas::{Canvas, Type, rect};
use super::frame::Frame;
use super::style::{AXIS_INK, INK, Look};
use super::{Marks, Panel};

/// Least height of a row, pixels.
const ROW: i32 = 30;
/// Part of a row that a bar or a cell takes.
const FILLED: f64 = 0.8;
/// Numbers in cells.
const CELL: Type = Type { size: 19, ink: INK };
/// Least width of a cell with a number, pixels.
const LEAST_CELL: f64 = 46.0;
/// So many times as wide is a cell with room for the number of its neighbour beside its own.
const ROOMY: f64 = 3.0;
/// Values from which on cells are tinted, and the tints below and above zero; light to strong also in grey.
const CLASSES: [(f64, RGBColor, RGBColor); 4] = [
    (0.0, RGBColor(243, 243, 243), RGBColor(243, 243, 243)),
    (3.0, RGBColor(204, 226, 241), RGBColor(252, 222, 192)),
    (5.0, RGBColor(143, 193, 224), RGBColor(245, 181, 122)),
    (10.0, RGBColor(86, 160, 208), RGBColor(229, 131, 53)),
];

/// A named row of cells.
#[derive(Debug, Clone, PartialEq)]
pub struct CellRow {
    /// Name beside the row.
    pub name: String,
    /// Begin, end and value of each cell; the value of a tinted one is printed.
    pub cells: Vec<(f64, f64, f64)>,
}

/// Place of a row on the y axis: the first one is on top.
pub(super) fn place(row: usize) -> f64 {
    -(row as f64)
}

fn names(panel: &Panel) -> Option<Vec<&str>> {
    panel.series.iter().find_map(|series| match &series.marks {
        Marks::Bars(bars) => Some(bars.iter().map(|(name, _)| name.as_str()).collect()),
        Marks::Cells(rows) => Some(rows.iter().map(|row| row.name.as_str()).collect()),
        _ => None,
    })
}

/// Height that the rows of a panel need, pixels.
pub(super) fn least_height(panel: &Panel) -> i32 {
    names(panel).map_or(0, |names| ROW * (names.len() as i32 + 1))
}

/// Puts names where an axis had numbers.
pub(super) fn name_ticks(panel: &Panel, axis: &mut Axis) {
    let Some(names) = names(panel) else { return };
    axis.ticks = names.iter().enumerate().map(|(row, name)| Tick { value: place(row), label: (*name).to_owned() }).collect();
    axis.minor.clear();
    axis.note.clear();
}

/// From which value on a cell has which shade, in words.
pub(super) fn shades() -> String {
    let from: Vec<String> = CLASSES.iter().map(|class| class.0).filter(|from| *from > 0.0).map(|from| from.to_string()).collect();
    format!("shades begin at {}, and there the number stands where it has room", from.join(", "))
}

pub(super) fn draw_bars(canvas: &mut Canvas, frame: &Frame, bars: &[(String, Vec<(f64, f64)>)], look: &Look) {
    for (row, (_, own)) in bars.iter().enumerate() {
        for area in own.iter().filter_map(|(from, to)| area(frame, row, *from, *to)) {
            canvas.rect(area, look.ink, 1.0);
        }
    }
}

pub(super) fn draw_cells(canvas: &mut Canvas, frame: &Frame, rows: &[CellRow]) {
    for (row, cells) in rows.iter().enumerate() {
        let mut before: Option<f64> = None;
        for (from, to, value) in &cells.cells {
            let Some(area) = area(frame, row, *from, *to) else { continue };
            let class = CLASSES.iter().rev().find(|c| value.abs() >= c.0).unwrap_or(&CLASSES[0]);
            canvas.rect(area, AXIS_INK, 1.0);
            let inner = rect(area.left + 1, area.top + 1, area.right - 1, area.bottom - 1);
            canvas.rect(inner, if *value < 0.0 { class.1 } else { class.2 }, 1.0);
            let is_wide = f64::from(area.right - area.left) >= LEAST_CELL;
            let is_last = cells.cells.last().is_some_and(|last| last.0 == *from);
            // The number of a narrow last cell reaches into the one before it, if there is room beside a number there.
            let has_room = is_last && before.is_none_or(|width| width >= ROOMY * LEAST_CELL);
            before = Some(f64::from(area.right - area.left));
            if class.0 > 0.0 && (is_wide || has_room) {
                let (x, along) =
                    if is_wide { (f64::from(area.left + area.right) / 2.0, 0.5) } else { (f64::from(area.right - 2), 1.0) };
                let place = (x, f64::from(area.top + area.bottom) / 2.0 + 6.0);
                let text = if value.abs() < 9.95 { format!("{value:+.1}") } else { format!("{value:+.0}") };
                canvas.text(&text.replace('-', "\u{2212}"), CELL, place, along, false);
            }
        }
    }
}

fn area(frame: &Frame, row: usize, from: f64, to: f64) -> Option<super::canvas::Rect> {
    let (a, b) = frame.at(from, place(row) + 0.5 * FILLED).zip(frame.at(to, place(row) - 0.5 * FILLED))?;
    let (left, right) = (a.0.min(b.0).round() as i32, a.0.max(b.0).round() as i32);
    Some(rect(left, a.1.round() as i32, right.max(left + 2), b.1.round() as i32))
}
