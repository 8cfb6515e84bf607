//! The linearisation of readings: `B_l = B_r + c2 B_r² + c3 B_r³` (CH-GFZ-TR-2601 section 7). The constant and the linear part belong
//! to offset and sensitivity.

use crate::data::linearisation::LinearisationPolynomials;
use crate::data::provenance::Input;
use nalgebra::Matrix2;

/// A polynomial of this slope somewhere is no small correction of a reading, and its inverse is not safe to search for.
pub const LEAST_SLOPE: f64 = 0.5;
/// Newton steps of the inverse; each squares an error that starts far below one.
const MAX_STEPS: usize = 30;

/// The polynomial of one sensor axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisLinearisation {
    /// Coefficient of the square, 1/enT.
    pub c2_per_ent: f64,
    /// Coefficient of the cube, 1/enT².
    pub c3_per_ent2: f64,
}

impl AxisLinearisation {
    /// The polynomial of a sensor axis, 0 to 2.
    #[must_use]
    pub fn of(polynomials: &LinearisationPolynomials, axis: usize) -> Self {
        Self { c2_per_ent: polynomials.c2_per_ent[axis], c3_per_ent2: polynomials.c3_per_ent2[axis] }
    }

    /// Correction that is added to a reading, enT.
    #[must_use]
    pub fn correction_ent(&self, reading_ent: f64) -> f64 {
        reading_ent * reading_ent * (self.c2_per_ent + self.c3_per_ent2 * reading_ent)
    }

    /// The linearised reading, enT.
    #[must_use]
    pub fn linearised_ent(&self, reading_ent: f64) -> f64 {
        reading_ent + self.correction_ent(reading_ent)
    }

    /// Derivative of the linearised reading by the reading.
    #[must_use]
    pub fn slope(&self, reading_ent: f64) -> f64 {
        1.0 + reading_ent * (2.0 * self.c2_per_ent + 3.0 * self.c3_per_ent2 * reading_ent)
    }

    /// The reading whose linearised value is given, enT; `None` where the slope falls below [`LEAST_SLOPE`] on the way.
    #[must_use]
    pub fn reading_ent(&self, linearised_ent: f64) -> Option<f64> {
        let mut reading = linearised_ent;
        for _ in 0..MAX_STEPS {
            let slope = self.slope(reading);
            if slope.is_nan() || slope < LEAST_SLOPE {
                return None;
            }
            let step = (self.linearised_ent(reading) - linearised_ent) / slope;
            reading -= step;
            if step.abs() <= 2.0 * f64::EPSILON * reading.abs() {
                return Some(reading);
            }
        }
        // Rounding keeps the last steps from vanishing; the value is as good as it gets.
        Some(reading)
    }

    /// Smallest slope within a range of readings, enT.
    #[must_use]
    pub fn least_slope(&self, [low, high]: [f64; 2]) -> f64 {
        // The slope is a parabola: smallest at an end or at its vertex.
        let vertex = -self.c2_per_ent / (3.0 * self.c3_per_ent2);
        let inside = if vertex > low && vertex < high { vertex } else { low };
        [low, high, inside].into_iter().map(|r| self.slope(r)).fold(f64::INFINITY, f64::min)
    }
}

/// A linearisation with where it comes from.
#[derive(Clone, Debug, PartialEq)]
pub struct Linearisation {
    /// The file, under its name.
    pub input: Input,
    /// Sensor that it was measured with.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Polynomials.
    pub part: LinearisationPolynomials,
    /// Covariance of c2, 1/enT, and c3, 1/enT², per sensor axis.
    pub covariance: [Matrix2<f64>; 3],
}

impl Linearisation {
    /// The polynomial of a sensor axis, 0 to 2.
    #[must_use]
    pub fn axis(&self, axis: usize) -> AxisLinearisation {
        AxisLinearisation::of(&self.part, axis)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_gives_the_reading_back() {
        let axis = AxisLinearisation { c2_per_ent: 3e-8, c3_per_ent2: -4e-12 };
        for reading in [-60_000.0, -123.4, 0.0, 7.0, 59_000.0] {
            let back = axis.reading_ent(axis.linearised_ent(reading)).unwrap();
            assert!((back - reading).abs() < 1e-10, "{reading} comes back as {back}");
        }
    }

    #[test]
    fn a_polynomial_that_turns_back_has_no_inverse() {
        let axis = AxisLinearisation { c2_per_ent: 0.0, c3_per_ent2: -1e-9 };
        // Slope 1 - 3e-9 r²: one half at 12910 enT.
        assert!(axis.reading_ent(60_000.0).is_none());
        assert!((axis.least_slope([-1e4, 2e4]) - (1.0 - 3e-9 * 4e8)).abs() < 1e-15);
        // Vertex of 1 + 2 c2 r + 3 c3 r² at -c2 / (3 c3): 1 - c2² / (3 c3).
        let axis = AxisLinearisation { c2_per_ent: 1e-5, c3_per_ent2: 1e-9 };
        assert!((axis.least_slope([-1e4, 1e4]) - (1.0 - 1e-10 / 3e-9)).abs() < 1e-15);
    }
}
