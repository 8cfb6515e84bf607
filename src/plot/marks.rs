//! Data on the page.

use plotters::prelude::RGBColor;
use std::collections::BTreeSet;

use super::axis::usable;
use super::canvas::{Canvas, Point, rect};
use super::frame::Frame;
use super::rows::{draw_bars, draw_cells, place};
use super::style::{FALLING, Look, ROUND, TRIANGLE, WHITE};
use super::{Column, Marks, Panel, Scale, Series, Style};

/// Most points of a line that are marked one by one.
const MARKED_LINE: usize = 40;
/// Opacity of envelopes that share a panel, the least thickness of an envelope, and how many
/// times the usual distance of its columns makes a gap.
const SHEER: f64 = 0.7;
const ENVELOPE_LINE: f64 = 1.6;
const ENVELOPE_BREAK: f64 = 3.5;
/// Size of a column of an envelope that has no neighbours, pixels.
const LONE: f64 = 3.0;
/// Opacity of a ribbon, light enough for three to lie on each other.
pub(super) const RIBBON: f64 = 0.2;
/// White rim that sets a marker off from what lies below it.
pub(super) const RIM: f64 = 1.2;
/// Distance of points that stand beside each other, pixels.
const ASIDE: f64 = 12.0;
/// Distance of the tags along a line.
const TAG_DISTANCE: f64 = 160.0;

impl Marks {
    /// Calls `see` with corners that enclose everything that is drawn.
    pub(super) fn visit(&self, scales: [Scale; 2], mut see: impl FnMut(f64, f64)) {
        let mut both = |x: f64, y: f64| {
            if scales[0].takes(x) && scales[1].takes(y) {
                see(x, y);
            }
        };
        match self {
            Marks::Line(points) | Marks::Rejected(points) => {
                points.iter().for_each(|&(x, y)| both(x, y));
            }
            Marks::Steps(steps) => {
                for &(start, end, y) in steps.iter().filter(|s| scales[0].takes(s.0) && scales[0].takes(s.1)) {
                    both(start, y);
                    both(end, y);
                }
            }
            Marks::Points(points) => {
                for &(x, y, error) in points.iter().filter(|p| scales[1].takes(p.1)) {
                    both(x, y);
                    if let Some(error) = error.filter(|e| usable(y + e) && usable(y - e)) {
                        both(x, y - error);
                        both(x, y + error);
                    }
                }
            }
            Marks::Envelope(columns) => {
                for column in columns.iter().filter(|c| scales[1].takes(c.min) && scales[1].takes(c.max)) {
                    both(column.x, column.min);
                    both(column.x, column.max);
                }
            }
            Marks::Ribbon(points) => {
                for &(x, low, high) in points.iter().filter(|p| usable(p.1) && usable(p.2)) {
                    both(x, low);
                    both(x, high);
                }
            }
            Marks::Bars(bars) => {
                for (row, (_, own)) in bars.iter().enumerate() {
                    for (from, to) in own {
                        both(*from, place(row) + 0.5);
                        both(*to, place(row) - 0.5);
                    }
                }
            }
            Marks::Shown(points) => points.iter().for_each(|(x, y)| both(*x, *y)),
            Marks::Names(_) => {}
            Marks::Cells(rows) => {
                for (row, cells) in rows.iter().enumerate() {
                    for (from, to, _) in &cells.cells {
                        both(*from, place(row) + 0.5);
                        both(*to, place(row) - 0.5);
                    }
                }
            }
        }
    }

    /// Names in place of the numbers of the x axis, where these marks are such.
    pub(super) fn names(&self) -> Option<&[(f64, String)]> {
        if let Marks::Names(names) = self { Some(names) } else { None }
    }

    /// Order of drawing: points lie on lines, lines on areas.
    pub(super) fn layer(&self) -> u8 {
        match self {
            Marks::Ribbon(_) | Marks::Bars(_) | Marks::Cells(_) | Marks::Shown(_) | Marks::Names(_) => 0,
            Marks::Envelope(_) => 1,
            Marks::Line(_) | Marks::Steps(_) => 2,
            Marks::Points(_) => 3,
            Marks::Rejected(_) => 4,
        }
    }
}

/// Whether every point of a line gets a marker.
pub(super) fn is_marked(points: &[(f64, f64)], style: Style) -> bool {
    points.len() <= MARKED_LINE && style != Style::Reference
}

/// Whether the lines and areas of a panel carry tags, markers set here and there along them: so
/// they do where several areas, or several lines of settings, are to be told apart in more than
/// colour. Lines have dashes for it, and among points tags would pass for data.
pub(super) fn is_tagged(panel: &Panel) -> bool {
    let has_points = panel.series.iter().any(|series| matches!(series.marks, Marks::Points(_)));
    let bare = |series: &&Series| match &series.marks {
        Marks::Steps(_) => series.style != Style::Reference,
        Marks::Envelope(_) => true,
        _ => false,
    };
    !has_points && panel.series.iter().filter(bare).count() > 1
}

/// Opacity of the envelopes of a panel, which let each other show through.
pub(super) fn envelope_alpha(panel: &Panel) -> f64 {
    let marks = panel.series.iter().map(|series| &series.marks);
    match marks.filter(|m| matches!(m, Marks::Envelope(_))).count() {
        ..=1 => 1.0,
        _ => SHEER,
    }
}

/// Draws the series of a panel.
pub(super) fn draw_series(canvas: &mut Canvas, frame: &Frame, panel: &Panel) {
    let mut series: Vec<&Series> = panel.series.iter().collect();
    // Within a layer what stands first lies below.
    series.sort_by_key(|s| s.marks.layer());
    let dense = series.partition_point(|s| s.marks.layer() < 3);
    let (dense, points) = series.split_at(dense);
    for one in dense {
        if let Marks::Ribbon(points) = &one.marks {
            draw_ribbon(canvas, frame, points, one.style, false);
        }
    }
    for one in dense {
        draw_marks(canvas, frame, panel, one);
    }
    for one in dense.iter().filter(|_| is_tagged(panel)) {
        draw_tags(canvas, frame, one);
    }
    let sides = beside_each_other(frame, panel);
    for one in points {
        // Series that share their places stand beside each other.
        let side = panel.series.iter().position(|s| std::ptr::eq(s, *one)).map_or(0.0, |i| sides[i]);
        draw_marks(canvas, &Frame { aside: side, ..*frame }, panel, one);
    }
}

/// How far to the right of its place each series of a panel is drawn, in pixels: points of several series at the same places of x,
/// without a curve that they lie on, would hide each other.
pub(super) fn beside_each_other(frame: &Frame, panel: &Panel) -> Vec<f64> {
    let none = vec![0.0; panel.series.len()];
    let on_a_curve = |s: &Series| match &s.marks {
        Marks::Line(_) | Marks::Ribbon(_) => s.style != Style::Reference,
        Marks::Steps(_) | Marks::Envelope(_) => true,
        _ => false,
    };
    if panel.series.iter().any(on_a_curve) {
        return none;
    }
    let places = |s: &Series| match &s.marks {
        Marks::Points(points) => points.iter().filter(|p| frame.takes_x(p.0)).map(|p| frame.x(p.0).round() as i64).collect(),
        _ => BTreeSet::new(),
    };
    let places: Vec<BTreeSet<i64>> = panel.series.iter().map(places).collect();
    let shared = |i: usize| {
        let others = |x: &&i64| places.iter().enumerate().any(|(j, own)| j != i && own.contains(x));
        !places[i].is_empty() && 2 * places[i].iter().filter(others).count() >= places[i].len()
    };
    let together: Vec<usize> = (0..places.len()).filter(|i| shared(*i)).collect();
    let mut sides = none;
    for (k, i) in together.iter().enumerate() {
        sides[*i] = ASIDE * (k as f64 - (together.len() as f64 - 1.0) / 2.0);
    }
    sides
}

fn draw_marks(canvas: &mut Canvas, frame: &Frame, panel: &Panel, series: &Series) {
    let look = series.style.look();
    match &series.marks {
        Marks::Line(points) => draw_line(canvas, frame, points, series.style),
        Marks::Steps(steps) => draw_steps(canvas, frame, steps, &series.style.level()),
        Marks::Points(points) => {
            let all = panel.series.iter().map(|s| match &s.marks {
                Marks::Points(points) => points.len(),
                _ => 0,
            });
            draw_points(canvas, frame, points, &look, radius(all.sum()));
        }
        Marks::Rejected(points) => draw_rejected(canvas, frame, points, &look),
        Marks::Envelope(columns) => {
            draw_envelope(canvas, frame, columns, look.ink, envelope_alpha(panel));
        }
        Marks::Ribbon(points) => draw_ribbon(canvas, frame, points, series.style, true),
        Marks::Bars(bars) => draw_bars(canvas, frame, bars, &look),
        Marks::Cells(rows) => draw_cells(canvas, frame, rows),
        Marks::Shown(_) | Marks::Names(_) => {}
    }
}

/// Sets markers along settings or an area, staggered between the styles.
fn draw_tags(canvas: &mut Canvas, frame: &Frame, series: &Series) {
    let style = series.style;
    let places: Vec<(f64, f64)> = match &series.marks {
        Marks::Steps(_) if style == Style::Reference => return,
        Marks::Steps(steps) => steps.iter().map(|s| (s.0 / 2.0 + s.1 / 2.0, s.2)).collect(),
        Marks::Envelope(columns) => {
            let middle = |c: &Column| (c.x, c.min / 2.0 + c.max / 2.0);
            columns.iter().map(middle).collect()
        }
        _ => return,
    };
    let rim = if matches!(series.marks, Marks::Envelope(_)) { RIM } else { 0.0 };
    let stagger = TAG_DISTANCE / 4.0 * f64::from(style as u8 % 3 + 1);
    let mut next = f64::from(frame.area.left) + stagger;
    for place in places.iter().filter_map(|p| frame.at(p.0, p.1)) {
        if place.0 >= next {
            marker(canvas, &style.look(), place, 5.5, rim);
            next = place.0 + TAG_DISTANCE;
        }
    }
}

/// Markers shrink as they become many.
fn radius(count: usize) -> f64 {
    match count {
        ..=200 => 5.5,
        201..=600 => 4.5,
        601..=2000 => 3.0,
        _ => 2.0,
    }
}

fn draw_line(canvas: &mut Canvas, frame: &Frame, points: &[(f64, f64)], style: Style) {
    let look = style.look();
    let pieces = points.split(|&(x, y)| !frame.takes_x(x) || !frame.takes_y(y));
    for piece in pieces.filter(|piece| !piece.is_empty()) {
        let places: Vec<Point> = piece.iter().filter_map(|p| frame.at(p.0, p.1)).collect();
        stroke(canvas, &places, &look);
        if is_marked(points, style) || places.len() == 1 {
            for &place in &places {
                marker(canvas, &look, place, 5.0, 0.0);
            }
        }
    }
}

/// Draws a joined line with its dashes, a few pieces at a time to keep the shapes small.
pub(super) fn stroke(canvas: &mut Canvas, places: &[Point], look: &Look) {
    let Some((&first, rest)) = places.split_first() else {
        return;
    };
    let mut dash = (0, look.dashes.first().copied().unwrap_or(f64::INFINITY));
    let mut from = first;
    let mut pending = 0;
    for &to in rest {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        if length < 0.5 {
            continue;
        }
        let mut done = 0.0;
        while done < length {
            let end = length.min(done + dash.1);
            if dash.0 % 2 == 0 {
                let place = |way: f64| (from.0 + dx * way / length, from.1 + dy * way / length);
                canvas.bar(place(done), place(end), look.width);
                pending += 1;
            }
            dash.1 -= end - done;
            // What rounding leaves of a dash would be too short to move on by.
            if dash.1 < 1e-6 {
                dash.0 = (dash.0 + 1) % look.dashes.len().max(1);
                dash.1 = look.dashes.get(dash.0).copied().unwrap_or(f64::INFINITY);
            }
            done = end;
        }
        if dash.0 % 2 == 0 {
            shape(canvas, ROUND, to, look.width / 2.0);
        }
        if pending >= 32 {
            canvas.fill(look.ink, 1.0);
            pending = 0;
        }
        from = to;
    }
    canvas.fill(look.ink, 1.0);
}

fn draw_steps(canvas: &mut Canvas, frame: &Frame, steps: &[(f64, f64, f64)], look: &Look) {
    let mut last: Option<(Point, f64)> = None;
    for &(start, end, y) in steps {
        let ends = frame.at(start.min(end), y).zip(frame.at(start.max(end), y));
        let Some((from, to)) = ends.filter(|_| frame.takes_x(start) && frame.takes_x(end)) else {
            last = None;
            continue;
        };
        let length = to.0 - from.0;
        if let Some((before, previous)) = last {
            let gap = from.0 - before.0;
            if gap > -1.0 && gap <= f64::max(6.0, previous.min(length) / 2.0) {
                canvas.bar(before, from, 1.5);
                canvas.fill(look.ink, 1.0);
            }
        }
        step(canvas, from.0, to.0, from.1, look);
        last = Some((to, length));
    }
}

/// A horizontal line on whole pixels; each one starts with a dash, so that none gets lost.
pub(super) fn step(canvas: &mut Canvas, from: f64, to: f64, y: f64, look: &Look) {
    let width = look.width as i32;
    let top = (y - look.width / 2.0).round() as i32;
    let mut x = from.round() as i32;
    let end = (to.round() as i32).max(x + 2);
    let mut dashes = look.dashes.iter().map(|&d| d as i32).cycle();
    while x < end {
        let dash = dashes.next().unwrap_or(end - x);
        canvas.rect(rect(x, top, end.min(x + dash), top + width), look.ink, 1.0);
        x += dash + dashes.next().unwrap_or(0);
    }
}

fn draw_points(canvas: &mut Canvas, frame: &Frame, points: &[(f64, f64, Option<f64>)], look: &Look, radius: f64) {
    for &(x, y, error) in points {
        let bar = error.filter(|e| usable(y + e) && usable(y - e));
        if let (Some(place), Some(error)) = (frame.at(x, y), bar) {
            let ends = (frame.y(y + error.abs()), frame.y(y - error.abs()));
            error_bar(canvas, place, ends, look.ink, radius > 4.0);
        }
    }
    for place in points.iter().filter_map(|p| frame.at(p.0, p.1)) {
        marker(canvas, look, place, radius, if radius > 2.5 { RIM } else { 0.0 });
    }
}

pub(super) fn error_bar(canvas: &mut Canvas, at: Point, ends: (f64, f64), ink: RGBColor, caps: bool) {
    let (top, bottom) = (ends.0.round() as i32, ends.1.round() as i32);
    let x = at.0.round() as i32;
    canvas.rect(rect(x - 1, top, x + 1, bottom.max(top + 1)), ink, 1.0);
    if caps {
        for y in [top, bottom] {
            canvas.rect(rect(x - 5, y - 1, x + 5, y + 1), ink, 1.0);
        }
    }
}

fn shape(canvas: &mut Canvas, corners: &[Point], at: Point, radius: f64) {
    let place = |corner: &Point| (at.0 + corner.0 * radius, at.1 + corner.1 * radius);
    canvas.outline(corners.iter().map(place));
}

/// A filled marker, set off from what lies below it by a white rim.
pub(super) fn marker(canvas: &mut Canvas, look: &Look, at: Point, radius: f64, rim: f64) {
    if rim > 0.0 {
        shape(canvas, look.marker, at, radius + rim);
        canvas.fill(WHITE, 1.0);
    }
    shape(canvas, look.marker, at, radius);
    canvas.fill(look.ink, 1.0);
}

fn draw_rejected(canvas: &mut Canvas, frame: &Frame, points: &[(f64, f64)], look: &Look) {
    for &(x, y) in points {
        let Some(place) = frame.at(x, y) else {
            continue;
        };
        if frame.y.span.contains(y) {
            crossed(canvas, look, place);
        } else if y > frame.y.span.high {
            hollow(canvas, TRIANGLE, (place.0, f64::from(frame.area.top) + 11.0), look);
        } else {
            hollow(canvas, FALLING, (place.0, f64::from(frame.area.bottom) - 11.0), look);
        }
    }
}

fn hollow(canvas: &mut Canvas, corners: &[Point], at: Point, look: &Look) {
    shape(canvas, corners, at, 7.0);
    canvas.fill(look.ink, 1.0);
    shape(canvas, corners, at, 4.6);
    canvas.fill(WHITE, 1.0);
}

/// A hollow marker with a cross through it.
pub(super) fn crossed(canvas: &mut Canvas, look: &Look, at: Point) {
    hollow(canvas, look.marker, at, look);
    for side in [-1.0, 1.0] {
        let end = |way: f64| (at.0 + way, at.1 + way * side);
        canvas.bar(end(-8.0), end(8.0), 1.8);
    }
    canvas.fill(look.ink, 1.0);
}

/// Fills a ribbon, or draws its edges: those of all ribbons lie on the tints.
fn draw_ribbon(canvas: &mut Canvas, frame: &Frame, points: &[(f64, f64, f64)], style: Style, edges: bool) {
    let look = style.look().edge();
    let is_shown = |&(x, low, high): &(f64, f64, f64)| {
        frame.takes_x(x) && usable(low) && usable(high) && (frame.takes_y(low) || frame.takes_y(high))
    };
    for piece in points.split(|point| !is_shown(point)).filter(|piece| !piece.is_empty()) {
        let side = |end: fn(f64, f64) -> f64| -> Vec<Point> {
            piece.iter().map(|&(x, low, high)| (frame.x(x), frame.y(end(low, high)))).collect()
        };
        let (low, high) = (side(f64::min), side(f64::max));
        if !edges {
            canvas.outline(low.into_iter().chain(high.into_iter().rev()));
            canvas.fill(look.ink, RIBBON);
        } else if piece.len() == 1 {
            error_bar(canvas, high[0], (high[0].1, low[0].1), look.ink, true);
        } else {
            stroke(canvas, &low, &look);
            stroke(canvas, &high, &look);
        }
    }
}

/// Fills between the extremes of the columns; the area breaks where columns are missing.
fn draw_envelope(canvas: &mut Canvas, frame: &Frame, columns: &[Column], ink: RGBColor, alpha: f64) {
    let distance = |a: &Column, b: &Column| frame.x.span.scale.place(b.x) - frame.x.span.scale.place(a.x);
    let mut distances: Vec<f64> = columns.windows(2).map(|w| distance(&w[0], &w[1])).collect();
    distances.sort_by(f64::total_cmp);
    let usual = distances.get(distances.len() / 2).copied().unwrap_or(0.0);
    let is_usable = |c: &Column| frame.takes_x(c.x) && frame.takes_y(c.min) && frame.takes_y(c.max);
    let joined = |a: &Column, b: &Column| is_usable(a) && is_usable(b) && distance(a, b) <= usual * ENVELOPE_BREAK;
    // Extent in each column of pixels, empty where it stays inverted.
    let left = f64::from(frame.area.left);
    let mut extents = vec![(f64::MAX, f64::MIN); (frame.area.right - frame.area.left) as usize];
    let mut add = |x: f64, (top, bottom): (f64, f64)| {
        if let Some(extent) = extents.get_mut((x - left) as usize) {
            *extent = (extent.0.min(top), extent.1.max(bottom));
        }
    };
    for run in columns.chunk_by(joined).filter(|run| run.iter().all(is_usable)) {
        let mut last: Option<(f64, (f64, f64))> = None;
        for column in run {
            let (x, a, b) = (frame.x(column.x), frame.y(column.min), frame.y(column.max));
            // Extremes that coincide still make a line.
            let least = if run.len() == 1 { LONE } else { ENVELOPE_LINE };
            let half = f64::max(least - (a - b).abs(), 0.0) / 2.0;
            let extent = (a.min(b) - half, a.max(b) + half);
            if let Some((from, start)) = last {
                let mut middle = (from - 0.5).ceil() + 0.5;
                while middle < x {
                    let way = (middle - from) / (x - from);
                    let between = |a: f64, b: f64| a + (b - a) * way;
                    add(middle, (between(start.0, extent.0), between(start.1, extent.1)));
                    middle += 1.0;
                }
            }
            add(x, extent);
            // What has no neighbours would be a dot that nobody sees.
            if run.len() == 1 {
                add(x - 1.0, extent);
                add(x + 1.0, extent);
            }
            last = Some((x, extent));
        }
    }
    for n in 1..extents.len() {
        // After a jump, neighbours are drawn out to meet half way.
        let (before, after) = (extents[n - 1], extents[n]);
        if before.0 < before.1 && before.1 < after.0 && after.0 < after.1 {
            let meet = (before.1 + after.0) / 2.0;
            (extents[n - 1].1, extents[n].0) = (meet, meet);
        } else if after.0 < after.1 && after.1 < before.0 && before.0 < before.1 {
            let meet = (after.1 + before.0) / 2.0;
            (extents[n - 1].0, extents[n].1) = (meet, meet);
        }
    }
    for (x, (top, bottom)) in (frame.area.left..).zip(extents) {
        canvas.column(x, top, bottom, ink, alpha);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dashes_end_however_their_lengths_round() {
        let mut pixels = vec![0xff; 400 * 300 * 3];
        let mut canvas = Canvas::new(&mut pixels, 400, 300);
        let zigzag = |n: u32| {
            let n = f64::from(n);
            (n * 0.37, 150.0 + 140.0 * (n * 0.71).sin())
        };
        let places: Vec<Point> = (0..1000).map(zigzag).collect();
        for style in Style::ALL {
            stroke(&mut canvas, &places, &style.look());
        }
        assert!(canvas.finish().is_ok());
        assert!(pixels.iter().any(|&p| p < 0xff));
    }
}
