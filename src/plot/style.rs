//! Colours, lines, markers and type sizes of the house.

use plotters::prelude::RGBColor;

use super::Style;
use super::canvas::{Point, Type};

pub(super) const INK: RGBColor = RGBColor(26, 26, 26);
pub(super) const SOFT_INK: RGBColor = RGBColor(68, 68, 68);
pub(super) const AXIS_INK: RGBColor = RGBColor(90, 90, 90);
pub(super) const GRID: RGBColor = RGBColor(228, 228, 228);
pub(super) const ZERO: RGBColor = RGBColor(176, 176, 176);
pub(super) const WHITE: RGBColor = RGBColor(255, 255, 255);
pub(super) const BANDS: [RGBColor; 3] = [RGBColor(208, 221, 234), RGBColor(241, 234, 219), RGBColor(236, 236, 236)];
pub(super) const BAND_EDGE: RGBColor = RGBColor(150, 162, 176);

pub(super) const TITLE: Type = Type { size: 32, ink: INK };
pub(super) const LABEL: Type = Type { size: 24, ink: INK };
pub(super) const NUMBER: Type = Type { size: 22, ink: INK };
pub(super) const CAPTION: Type = Type { size: 22, ink: SOFT_INK };
pub(super) const TITLE_LINE: i32 = 36;
pub(super) const LABEL_LINE: i32 = 28;
pub(super) const CAPTION_LINE: i32 = 27;
/// Half the height of a digit, to centre numbers on their ticks.
pub(super) const HALF_DIGIT: f64 = 7.0;

/// Colour and line of a style; the colours are those of Okabe and Ito.
pub(super) struct Look {
    pub ink: RGBColor,
    pub width: f64,
    /// Lengths drawn and left out in turn; none for a solid line.
    pub dashes: &'static [f64],
    /// Corners of the marker, in units of its radius.
    pub marker: &'static [Point],
}

impl Look {
    /// For the outline of an area.
    pub(super) fn edge(self) -> Look {
        Look { width: 1.5, ..self }
    }
}

pub(super) const ROUND: &[Point] = &[
    (1.0, 0.0),
    (0.924, 0.383),
    (0.707, 0.707),
    (0.383, 0.924),
    (0.0, 1.0),
    (-0.383, 0.924),
    (-0.707, 0.707),
    (-0.924, 0.383),
    (-1.0, 0.0),
    (-0.924, -0.383),
    (-0.707, -0.707),
    (-0.383, -0.924),
    (0.0, -1.0),
    (0.383, -0.924),
    (0.707, -0.707),
    (0.924, -0.383),
];
const SQUARE: &[Point] = &[(0.87, 0.87), (-0.87, 0.87), (-0.87, -0.87), (0.87, -0.87)];
pub(super) const TRIANGLE: &[Point] = &[(0.0, -1.25), (1.15, 0.8), (-1.15, 0.8)];
pub(super) const FALLING: &[Point] = &[(0.0, 1.25), (1.15, -0.8), (-1.15, -0.8)];
const DIAMOND: &[Point] = &[(0.0, -1.3), (1.15, 0.0), (0.0, 1.3), (-1.15, 0.0)];

/// Colours that an indexed picture keeps exactly.
pub(super) const EXACT: [RGBColor; 10] = [WHITE, INK, SOFT_INK, AXIS_INK, GRID, ZERO, BAND_EDGE, BANDS[0], BANDS[1], BANDS[2]];

impl Style {
    pub(super) const ALL: [Style; 6] = [Style::X, Style::Y, Style::Z, Style::Single, Style::Second, Style::Reference];

    /// Wide lines come with early styles, so that later ones drawn over them leave them visible.
    pub(super) fn look(self) -> Look {
        let look = |ink, width, dashes, marker| Look { ink, width, dashes, marker };
        match self {
            Style::X => look(RGBColor(0, 114, 178), 5.0, &[], ROUND),
            Style::Y => look(RGBColor(213, 94, 0), 3.0, &[14.0, 8.0], SQUARE),
            Style::Z => look(RGBColor(0, 158, 115), 3.0, &[4.0, 6.0], TRIANGLE),
            Style::Single => look(RGBColor(0, 0, 0), 2.5, &[], ROUND),
            Style::Second => look(RGBColor(204, 121, 167), 2.5, &[14.0, 8.0], DIAMOND),
            Style::Reference => look(RGBColor(100, 100, 100), 2.0, &[22.0, 8.0], FALLING),
        }
    }

    /// The level pieces of steps, which are often shorter than a dash: without dashes, and those
    /// of a reference thinner than any other.
    pub(super) fn level(self) -> Look {
        let look = self.look();
        let width = if self == Style::Reference { 1.0 } else { look.width };
        Look { width, dashes: &[], ..look }
    }
}
