//! Anti-aliased shapes and text on the pixel buffer of plotters.
//!
//! The polygons of plotters have whole-pixel corners and its wide lines no smooth edges. Shapes
//! are therefore turned into coverage here, exactly per pixel, and only blended by plotters.

use plotters::prelude::{BitMapBackend, Color, DrawingBackend, RGBColor};

use super::PlotError;
use super::text::{LEVELS, typeface};

pub(super) type Point = (f64, f64);

/// Pixels from `left`, `top` up to but without `right`, `bottom`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Rect {
    pub left: i32,
    pub top: i32,
    pub right: i32,
    pub bottom: i32,
}

pub(super) fn rect(left: i32, top: i32, right: i32, bottom: i32) -> Rect {
    Rect { left, top, right, bottom }
}

/// Size and colour of text.
#[derive(Debug, Clone, Copy)]
pub(super) struct Type {
    pub size: u32,
    pub ink: RGBColor,
}

pub(super) struct Canvas<'a> {
    backend: BitMapBackend<'a>,
    /// Shapes and rectangles are cut off at its edges; text is not.
    pub clip: Rect,
    path: Vec<Vec<Point>>,
    cover: Vec<f32>,
    touched: Vec<(usize, usize)>,
    failure: Option<String>,
}

impl<'a> Canvas<'a> {
    /// A canvas on a buffer of three bytes per pixel.
    pub fn new(pixels: &'a mut [u8], width: u32, height: u32) -> Self {
        Canvas {
            backend: BitMapBackend::with_buffer(pixels, (width, height)),
            clip: Rect { left: 0, top: 0, right: width as i32, bottom: height as i32 },
            path: Vec::new(),
            cover: Vec::new(),
            touched: Vec::new(),
            failure: None,
        }
    }

    /// Reports the first failure of the backend, if there was one.
    pub fn finish(self) -> Result<(), PlotError> {
        self.failure.map_or(Ok(()), |failure| Err(PlotError::Draw(failure)))
    }

    fn note<E: std::fmt::Display>(&mut self, result: Result<(), E>) {
        if let Err(error) = result {
            self.failure.get_or_insert_with(|| error.to_string());
        }
    }

    /// Fills whole pixels.
    pub fn rect(&mut self, area: Rect, ink: RGBColor, alpha: f64) {
        let (left, right) = (area.left.max(self.clip.left), area.right.min(self.clip.right));
        if left >= right {
            return;
        }
        for y in area.top.max(self.clip.top)..area.bottom.min(self.clip.bottom) {
            self.run(y, left, right, ink, alpha);
        }
    }

    /// Fills one column of pixels, its ends in part; nothing when the ends are inverted.
    pub fn column(&mut self, x: i32, top: f64, bottom: f64, ink: RGBColor, alpha: f64) {
        if top >= bottom {
            return;
        }
        let (first, last) = (top.floor() as i32, bottom.floor() as i32);
        let level = |share: f64| (share * f64::from(LEVELS) + 0.5) as u8;
        if first == last {
            return self.dot(x, first, ink, alpha, level(bottom - top));
        }
        self.dot(x, first, ink, alpha, level(f64::from(first + 1) - top));
        self.dot(x, last, ink, alpha, level(bottom - f64::from(last)));
        if first + 1 < last {
            let ends = ((x, first + 1), (x, last - 1));
            let done = self.backend.draw_line(ends.0, ends.1, &ink.mix(alpha));
            self.note(done);
        }
    }

    fn run(&mut self, y: i32, left: i32, right: i32, ink: RGBColor, alpha: f64) {
        let done = self.backend.draw_line((left, y), (right - 1, y), &ink.mix(alpha));
        self.note(done);
    }

    /// Adds a closed outline to the shape that the next `fill` paints.
    pub fn outline(&mut self, points: impl IntoIterator<Item = Point>) {
        self.path.push(points.into_iter().collect());
    }

    /// Adds the outline of a straight line of some width.
    pub fn bar(&mut self, from: Point, to: Point, width: f64) {
        let (dx, dy) = (to.0 - from.0, to.1 - from.1);
        let length = dx.hypot(dy);
        if length > 0.0 {
            let (nx, ny) = (-dy / length * width / 2.0, dx / length * width / 2.0);
            self.outline([
                (from.0 + nx, from.1 + ny),
                (to.0 + nx, to.1 + ny),
                (to.0 - nx, to.1 - ny),
                (from.0 - nx, from.1 - ny),
            ]);
        }
    }

    /// Paints the union of the outlines added since the last call.
    pub fn fill(&mut self, ink: RGBColor, alpha: f64) {
        let mut path = std::mem::take(&mut self.path);
        if let Some(area) = bounds(&path, self.clip) {
            let width = (area.right - area.left) as usize;
            let height = (area.bottom - area.top) as usize;
            // Two columns more take what lies at and beyond the right edge.
            self.cover.resize((width + 2) * height, 0.0);
            self.touched.clear();
            self.touched.resize(height, (width + 2, 0));
            for points in &path {
                self.cover_outline(points, area, width, height);
            }
            self.paint(area, width, ink, alpha);
        }
        path.clear();
        self.path = path;
    }

    fn cover_outline(&mut self, points: &[Point], area: Rect, width: usize, height: usize) {
        let shift = |p: &Point| (p.0 - f64::from(area.left), p.1 - f64::from(area.top));
        let edges = || points.iter().zip(points.iter().cycle().skip(1));
        let turn: f64 = edges().map(|(a, b)| a.0 * b.1 - a.1 * b.0).sum();
        for (a, b) in edges() {
            // All outlines turn the same way, so that overlapping ones never cancel.
            let (a, b) = if turn < 0.0 { (b, a) } else { (a, b) };
            self.cover_edge(shift(a), shift(b), width, height);
        }
    }

    /// Adds the signed area to the right of an edge: summed along a row, it gives the coverage.
    fn cover_edge(&mut self, a: Point, b: Point, width: usize, height: usize) {
        if a.1 == b.1 {
            return;
        }
        let (sign, a, b) = if a.1 < b.1 { (1.0, a, b) } else { (-1.0, b, a) };
        let slope = (b.0 - a.0) / (b.1 - a.1);
        let top = a.1.clamp(0.0, height as f64);
        let bottom = b.1.clamp(0.0, height as f64);
        let x = |y: f64| (a.0 + (y - a.1) * slope).clamp(0.0, width as f64);
        let mut start = x(top);
        for row in top as usize..ceil(bottom) {
            let from = top.max(row as f64);
            let to = bottom.min((row + 1) as f64);
            let end = x(to);
            let (left, right) = (start.min(end), start.max(end));
            start = end;
            let area = sign * (to - from);
            let cells = &mut self.cover[row * (width + 2)..(row + 1) * (width + 2)];
            let (first, last) = (left as usize, ceil(right));
            if last <= first + 1 {
                let beyond = (left + right) / 2.0 - first as f64;
                cells[first] += (area * (1.0 - beyond)) as f32;
                cells[first + 1] += (area * beyond) as f32;
            } else {
                // Share of the edge's area gained up to a pixel boundary.
                let gained = |n: usize| {
                    let inside = (n as f64).min(right) - left;
                    inside * inside / 2.0 / (right - left) + (n as f64 - right).max(0.0)
                };
                let mut before = (0.0, 0.0);
                for (cell, n) in cells[first..=last].iter_mut().zip(first + 1..) {
                    let total = gained(n);
                    let share = total - before.0;
                    *cell += (area * (share - before.1)) as f32;
                    before = (total, share);
                }
            }
            let reach = &mut self.touched[row];
            *reach = (reach.0.min(first), reach.1.max(last.max(first + 1)));
        }
    }

    /// Blends the covered pixels and clears the coverage for the next shape.
    fn paint(&mut self, area: Rect, width: usize, ink: RGBColor, alpha: f64) {
        let mut cover = std::mem::take(&mut self.cover);
        for (row, cells) in cover.chunks_exact_mut(width + 2).enumerate() {
            let (first, last) = self.touched[row];
            let y = area.top + row as i32;
            let mut sum = 0.0;
            let mut from = 0;
            let mut level = 0;
            for (n, cell) in cells.iter_mut().enumerate().take(last + 1).skip(first) {
                if *cell == 0.0 {
                    continue;
                }
                let now = n.min(width);
                self.stretch(y, area.left + from as i32, area.left + now as i32, ink, alpha, level);
                sum += std::mem::take(cell);
                level = (sum.abs().min(1.0) * f32::from(LEVELS) + 0.5) as u8;
                from = now;
            }
            // Only an outline cut off at the right edge is still open here.
            self.stretch(y, area.left + from as i32, area.left + width as i32, ink, alpha, level);
        }
        self.cover = cover;
    }

    fn stretch(&mut self, y: i32, left: i32, right: i32, ink: RGBColor, alpha: f64, level: u8) {
        match right - left {
            1 => self.dot(left, y, ink, alpha, level),
            2.. if level > 0 => {
                let alpha = alpha * f64::from(level) / f64::from(LEVELS);
                self.run(y, left, right, ink, alpha);
            }
            _ => (),
        }
    }

    fn dot(&mut self, x: i32, y: i32, ink: RGBColor, alpha: f64, level: u8) {
        if level > 0 {
            let alpha = alpha * f64::from(level) / f64::from(LEVELS);
            let done = self.backend.draw_pixel((x, y), ink.mix(alpha).to_backend_color());
            self.note(done);
        }
    }

    /// Writes a line with its baseline at `at`; `anchor` is 0 for text that starts there, 1/2 for
    /// centred text and 1 for text that ends there. Turned text runs upwards.
    pub fn text(&mut self, text: &str, style: Type, at: Point, anchor: f64, turned: bool) {
        let Some(mut face) = typeface() else {
            return;
        };
        let (places, length) = face.layout(text, style.size);
        let (along, across) = if turned { (-at.1, at.0) } else { at };
        let across = across.round() as i32;
        for (c, pen) in places {
            let fine = ((along - anchor * length + pen) * 4.0).round() as i32;
            let origin = fine.div_euclid(4);
            let glyph = face.glyph(c, style.size, fine.rem_euclid(4));
            for (row, levels) in glyph.levels.chunks(glyph.width.max(1)).enumerate() {
                let v = across + glyph.top + row as i32;
                for (column, &level) in levels.iter().enumerate() {
                    let u = origin + glyph.left + column as i32;
                    let (x, y) = if turned { (v, -u - 1) } else { (u, v) };
                    self.dot(x, y, style.ink, 1.0, level);
                }
            }
        }
    }
}

/// The next whole number at or above a positive value. `f64::ceil` is a library call on the
/// baseline instruction set, and this runs for every row of every edge.
fn ceil(value: f64) -> usize {
    let whole = value as usize;
    whole + usize::from(whole as f64 != value)
}

/// The pixels a path can touch.
fn bounds(path: &[Vec<Point>], clip: Rect) -> Option<Rect> {
    let mut points = path.iter().flatten();
    let &(x, y) = points.next()?;
    let (mut low, mut high) = ((x, y), (x, y));
    for &(x, y) in points {
        low = (low.0.min(x), low.1.min(y));
        high = (high.0.max(x), high.1.max(y));
    }
    let area = Rect {
        left: (low.0.floor() as i32).max(clip.left),
        top: (low.1.floor() as i32).max(clip.top),
        right: (high.0.ceil() as i32).min(clip.right),
        bottom: (high.1.ceil() as i32).min(clip.bottom),
    };
    (area.left < area.right && area.top < area.bottom).then_some(area)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLACK: RGBColor = RGBColor(0, 0, 0);

    /// Darkness of a canvas of 20 by 20 pixels, in pixels.
    fn ink(draw: impl FnOnce(&mut Canvas)) -> f64 {
        let mut pixels = vec![0xff; 20 * 20 * 3];
        let mut canvas = Canvas::new(&mut pixels, 20, 20);
        draw(&mut canvas);
        canvas.finish().expect("drawn in memory");
        pixels.iter().map(|&p| f64::from(255 - p) / 255.0).sum::<f64>() / 3.0
    }

    fn close(ink: f64, area: f64) -> bool {
        (ink - area).abs() < 0.05 * area + 0.1
    }

    #[test]
    fn shapes_cover_their_area() {
        let square = ink(|c| {
            c.outline([(2.25, 3.5), (10.75, 3.5), (10.75, 9.0), (2.25, 9.0)]);
            c.fill(BLACK, 1.0);
        });
        assert!(close(square, 8.5 * 5.5), "{square}");
        let triangle = ink(|c| {
            c.outline([(1.0, 1.0), (18.0, 4.0), (6.0, 17.0)]);
            c.fill(BLACK, 1.0);
        });
        assert!(close(triangle, 128.5), "{triangle}");
        let bar = ink(|c| {
            c.bar((2.0, 2.0), (14.0, 11.0), 3.0);
            c.fill(BLACK, 1.0);
        });
        assert!(close(bar, 45.0), "{bar}");
        let column = ink(|c| c.column(4, 2.5, 9.25, BLACK, 1.0));
        assert!(close(column, 6.75), "{column}");
    }

    #[test]
    fn overlapping_outlines_make_a_union() {
        let union = ink(|c| {
            c.outline([(2.0, 2.0), (12.0, 2.0), (12.0, 8.0), (2.0, 8.0)]);
            // Turns the other way.
            c.outline([(6.0, 4.0), (6.0, 12.0), (16.0, 12.0), (16.0, 4.0)]);
            c.fill(BLACK, 1.0);
        });
        assert!(close(union, 60.0 + 80.0 - 24.0), "{union}");
    }

    #[test]
    fn shapes_are_cut_off_at_the_clip() {
        let cut = ink(|c| {
            c.clip = rect(5, 5, 15, 15);
            c.outline([(-50.0, -50.0), (90.0, -50.0), (90.0, 10.0), (-50.0, 10.0)]);
            c.fill(BLACK, 1.0);
            c.outline([(-9.0, -9.0), (-4.0, -9.0), (-4.0, -1.0)]);
            c.fill(BLACK, 1.0);
        });
        assert!(close(cut, 50.0), "{cut}");
    }

    #[test]
    fn ends_beyond_the_canvas_do_no_harm() {
        let full = ink(|c| {
            c.column(3, -1e9, 1e9, BLACK, 1.0);
            c.column(900, 0.0, 5.0, BLACK, 1.0);
            c.column(5, 9.0, 2.0, BLACK, 1.0);
            c.rect(rect(-5, -5, -1, 40), BLACK, 1.0);
            c.bar((f64::NAN, 1.0), (4.0, 4.0), 2.0);
            c.fill(BLACK, 1.0);
            c.text("far", Type { size: 24, ink: BLACK }, (-900.0, 1e12), 0.5, true);
        });
        assert!(close(full, 20.0), "{full}");
    }
}
