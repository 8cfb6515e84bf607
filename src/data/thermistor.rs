//! The parts of a thermistor calibration.
//!
//! The result of the analysis and its parameter file both hold them, so that each is defined here only.

use serde::{Deserialize, Serialize};

/// The highest order that is fitted.
pub const HIGHEST_ORDER: usize = 9;

/// Temperature from the signal of a thermistor, and how well it describes the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermistorPolynomial {
    /// Name of the table without its end.
    pub table: String,
    /// The sensor in which it sits; absent where that is not stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// `u` or `r`.
    pub signal: String,
    /// `V` or `ohm`.
    pub signal_unit: String,
    /// Order of the polynomial.
    pub order: usize,
    /// Why this one.
    pub reason: String,
    /// Coefficients, °C per unitᵏ, lowest first.
    pub coefficients: Vec<f64>,
    /// Their standard uncertainties.
    pub coefficients_std: Vec<f64>,
    /// Largest residual, °C.
    pub residual_max_degc: f64,
    /// Standard deviation of the residuals, °C.
    pub residual_std_degc: f64,
    /// Largest residual that is asked for, °C.
    pub within_degc: f64,
    /// The lowest order whose residuals are within that.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub order_within: Option<usize>,
    /// Smallest and largest signal of the table: the polynomial holds between them.
    pub valid_signal: [f64; 2],
    /// Smallest and largest temperature of the table, °C.
    pub valid_degc: [f64; 2],
}

/// One order.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TriedOrder {
    /// The order.
    pub order: usize,
    /// Largest residual, °C.
    pub residual_max_degc: f64,
    /// Standard deviation of the residuals, °C.
    pub residual_std_degc: f64,
    /// Root mean square of the error at each row of the fit without it, °C.
    pub leave_one_out_degc: f64,
    /// Corrected information criterion, where it was computed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aicc: Option<f64>,
}

/// A polynomial given for comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparedPolynomial {
    /// Its coefficients, lowest first.
    pub coefficients: Vec<f64>,
    /// Largest residual of the table, °C.
    pub residual_max_degc: f64,
    /// Root mean square of the residuals, °C.
    pub residual_rms_degc: f64,
    /// Largest residual of the best polynomial of the same order, °C.
    pub best_max_degc: f64,
    /// Largest difference from that polynomial at the rows of the table, °C.
    pub difference_max_degc: f64,
}

/// Comparison with a reference thermometer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ReferenceComparison {
    /// T_O, mean of polynomial minus reference, °C.
    pub offset_degc: f64,
    /// Its standard uncertainty, °C; absent for a single reading.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_std_degc: Option<f64>,
    /// Readings.
    pub readings: usize,
    /// Smallest and largest reference temperature, °C.
    pub range_degc: [f64; 2],
    /// Change of the difference per K of the reference; absent where that does not vary.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slope: Option<f64>,
    /// Its standard uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slope_std: Option<f64>,
}

/// A row of the table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedTableRow {
    /// Signal, V or Ω.
    pub signal: f64,
    /// Temperature of the table, °C.
    pub t_degc: f64,
    /// Table minus polynomial, °C.
    pub residual_degc: f64,
    /// Standard uncertainty of the polynomial here, °C.
    pub std_degc: f64,
    /// Table minus the polynomial given for comparison, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub compared_residual_degc: Option<f64>,
    /// Table minus the best polynomial of that one's order, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub best_residual_degc: Option<f64>,
}
