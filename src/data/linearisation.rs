//! The linearisation that the runs of one sensor and mode share.
//!
//! The result of the analysis and its parameter file both hold it, so that it is defined here only.

use super::result::Covariance;
use serde::{Deserialize, Serialize};

/// What runs of one sensor and mode say together of the non-linearity of its readings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SharedLinearisation {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Campaign and instrument.
    pub campaign: String,
    /// Runs in time order.
    pub used: Vec<String>,
    /// The polynomials.
    #[serde(rename = "linearisation")]
    pub polynomials: LinearisationPolynomials,
    /// Covariance of the six coefficients.
    pub covariance: Covariance,
    /// What is known of each sensor axis.
    pub axis: Vec<LinearisedAxis>,
    /// The runs without and with it.
    pub run: Vec<LinearisedRun>,
    /// Residual of every sensor axis against the field along every coil axis: the check for transverse effects.
    pub panel: Vec<LinearisationPanel>,
}

/// Polynomials of the three sensor axes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisationPolynomials {
    /// Coefficients of the square, 1/enT.
    pub c2_per_ent: [f64; 3],
    /// Their standard uncertainties.
    pub c2_std_per_ent: [f64; 3],
    /// Coefficients of the cube, 1/enT².
    pub c3_per_ent2: [f64; 3],
    /// Their standard uncertainties.
    pub c3_std_per_ent2: [f64; 3],
    /// Smallest and largest reading they hold for, enT.
    pub reading_ent: [[f64; 2]; 3],
}

/// The linearisation that was applied to the readings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisationApplied {
    /// File it came from, which is among the inputs.
    pub file: String,
    /// Its polynomials.
    pub applied: LinearisationPolynomials,
}

/// What is known of one sensor axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisedAxis {
    /// `x`, `y` or `z`.
    pub name: String,
    /// Largest correction of a reading within the range, enT.
    pub largest_correction_ent: f64,
    /// Probability of coefficients as large as these without non-linearity.
    pub probability: f64,
    /// Whether that is below 1 %.
    pub significant: bool,
    /// Degrees of freedom of the runs.
    pub degrees_of_freedom: usize,
    /// Sum of squares of what the runs say against the shared coefficients, over their variances.
    pub between_chi2: f64,
    /// Its degrees of freedom.
    pub between_degrees_of_freedom: usize,
    /// Factor on the standard uncertainties where the runs disagree by more than their noise, otherwise 1; contained in them.
    pub inflation: f64,
    /// Condition number of the two columns with the runs' own parameters projected out.
    pub condition: f64,
}

/// A run without and with the linearisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisedRun {
    /// Run id.
    pub id: String,
    /// Whether it took part in the estimate.
    pub used: bool,
    /// Plateaus.
    pub blocks: usize,
    /// Standard deviation of the residuals along the sensor axes without it, nT.
    pub residual_std_before_nt: [f64; 3],
    /// The same with it.
    pub residual_std_after_nt: [f64; 3],
}

/// Residual of a sensor axis against the field along a coil axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisationPanel {
    /// `x`, `y` or `z`.
    pub sensor_axis: String,
    /// `X`, `Y` or `Z`.
    pub coil_axis: String,
    /// Whether the sensor axis lies along the coil axis in every run.
    pub on_axis: bool,
    /// Largest magnitude of the field along the coil axis, nT.
    pub largest_field_nt: f64,
    /// Coefficients; absent where the runs do not determine them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fitted: Option<PanelFit>,
}

/// Quadratic and cubic dependence of a residual on a field.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PanelFit {
    /// Coefficient of the square, 1/nT.
    pub quadratic_per_nt: f64,
    /// Its standard uncertainty.
    pub quadratic_std_per_nt: f64,
    /// Coefficient of the cube, 1/nT².
    pub cubic_per_nt2: f64,
    /// Its standard uncertainty.
    pub cubic_std_per_nt2: f64,
    /// Probability of coefficients as large as these without any dependence.
    pub probability: f64,
}
