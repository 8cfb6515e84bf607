//! How a polynomial of the temperature was found.
//!
//! The result of an analysis and its parameter file both hold it, so that it is defined here only.

use crate::fit::order::Reason;
use serde::{Deserialize, Serialize};

/// A scatter of zero is not written.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde passes a reference")]
fn is_zero(value: &f64) -> bool {
    *value == 0.0
}

/// How one polynomial was found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct QuantityFound {
    /// `sigma_x`, for example.
    pub name: String,
    /// Unit.
    pub unit: String,
    /// Ids of the runs that determine it.
    pub runs: Vec<String>,
    /// Lowest and highest temperature of those runs, °C.
    pub valid_degc: [f64; 2],
    /// Runs, or settings of a sweep, minus coefficients.
    pub degrees_of_freedom: usize,
    /// Standard uncertainties that make an interval of 95 %: more than 1.96 where the scatter of the runs told them.
    pub factor_95: f64,
    /// Order of the polynomial.
    pub order: usize,
    /// How the order was chosen.
    pub order_by: Reason,
    /// AICc of the orders 0, 1, ... that could be tried; nan where it is not defined.
    pub aicc: Vec<f64>,
    /// Root mean square of the leave-one-out errors of the same orders, in the unit of the quantity; nan where not defined.
    pub leave_one_out: Vec<f64>,
    /// Values of the runs, or of windows of a sweep.
    pub value: Vec<f64>,
    /// Their standard uncertainties; empty if they are not known.
    pub std: Vec<f64>,
    /// Scatter between the runs that their standard uncertainties do not explain, in the unit of the quantity: it was added to each of them; 0 where
    /// they explain it.
    #[serde(default, skip_serializing_if = "is_zero")]
    pub scatter: f64,
    /// Value minus polynomial.
    pub residual: Vec<f64>,
    /// What the runs scatter by over what their own uncertainties let expect, times the factor by which the uncertainties are larger because the order of the
    /// polynomial was chosen.
    pub widened: f64,
    /// Smallest value minus polynomial.
    pub min_error: f64,
    /// Largest value minus polynomial.
    pub max_error: f64,
}
