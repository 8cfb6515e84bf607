//! From values to places on the page.

use super::axis::Axis;
use super::canvas::{Point, Rect};

/// Places data on the page.
#[derive(Clone, Copy)]
pub(super) struct Frame<'a> {
    /// From left to right.
    pub x: &'a Axis,
    /// From below to above.
    pub y: &'a Axis,
    /// The panel on the page.
    pub area: Rect,
    /// Points are drawn so many pixels to the right of their place.
    pub aside: f64,
}

impl Frame<'_> {
    /// Place of a value from left to right.
    pub fn x(&self, value: f64) -> f64 {
        let (left, right) = (self.area.left, self.area.right);
        self.x.at(value, f64::from(left), f64::from(right))
    }

    /// Place of a value from below to above.
    pub fn y(&self, value: f64) -> f64 {
        let (bottom, top) = (self.area.bottom, self.area.top);
        // The place of a value a logarithmic axis does not take is not finite.
        self.y.at(value, f64::from(bottom), f64::from(top)).min(f64::from(bottom + 20))
    }

    /// The place of a point, or `None` for one that cannot be drawn.
    pub fn at(&self, x: f64, y: f64) -> Option<Point> {
        (self.takes_x(x) && self.takes_y(y)).then(|| (self.x(x) + self.aside, self.y(y)))
    }

    /// Whether the axis has a place for a value.
    pub fn takes_x(&self, value: f64) -> bool {
        self.x.span.scale.takes(value)
    }

    /// Whether the axis has a place for a value.
    pub fn takes_y(&self, value: f64) -> bool {
        self.y.span.scale.takes(value)
    }
}
