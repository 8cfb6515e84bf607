//! What both forms of the noise model are told by.

use serde::Serialize;

/// Parameters of the noise of the rows of a component. The covariance of rows i and k is
/// `white_i δ_ik white (1 + white_field u_i²) + (slow + slow_field u_i u_k) C_ik`, all times a variance per component: `white_i` is the white variance
/// of a row beside those of the others, `u` what the noise may grow with over its largest value, the field or the reading, and `C` the
/// correlation of slow noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct NoiseParameters {
    /// Exponent `a` of the power density `f^-a` of the slow noise.
    pub exponent: f64,
    /// Rows after which the slow noise is forgotten; 0 where it never is.
    pub memory_rows: f64,
    /// White variance of a row. It is 1 where it is the unit itself; where the samples inside the rows are the unit, rows may scatter by more.
    #[serde(skip)]
    pub white: f64,
    /// Variance of the slow noise; over that of the white noise of one mean where that is the unit.
    pub slow: f64,
    /// What the white variance at the largest field has over that without field, as a part of the latter.
    pub white_field: f64,
    /// Variance of slow noise of the gain, at the largest field.
    pub slow_field: f64,
    /// The white noise of the means is not that of the samples inside them, as where a field is set anew for every row.
    pub apart: bool,
}

impl NoiseParameters {
    /// White noise.
    pub const WHITE: NoiseParameters = NoiseParameters {
        exponent: 1.0,
        memory_rows: 0.0,
        white: 1.0,
        slow: 0.0,
        white_field: 0.0,
        slow_field: 0.0,
        apart: false,
    };

    /// White variance of a row of mean weight at a field.
    pub(super) fn white_at(&self, field: f64) -> f64 {
        self.white * (1.0 + self.white_field * field * field)
    }

    /// Variances of all slow noise.
    pub(super) fn all_slow(&self) -> f64 {
        self.slow + self.slow_field
    }

    /// Whether the noise grows with the field.
    pub(super) fn grows(&self) -> bool {
        self.white_field + self.slow_field > 0.0
    }
}
