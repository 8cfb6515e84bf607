//! LINEARISATION: the polynomial per sensor axis that linearises the readings of the runs of a sensor and mode.

use super::Body;
use crate::data::result::Covariance;
use crate::model::linearisation::LinearisationPolynomials;
use serde::{Deserialize, Serialize};

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisationConvention {
    /// Equation of the linearisation.
    pub model: String,
    /// What `panel` holds.
    pub panel: String,
    /// What standard deviations and `covariance` are.
    pub uncertainty: String,
}

impl Default for LinearisationConvention {
    fn default() -> Self {
        Self {
            model: "linearised reading = B_r + c2 B_r^2 + c3 B_r^3 per sensor axis, enT; offset and sensitivity are those of the runs"
                .to_owned(),
            panel: "residual of a sensor axis (applied field minus modelled measurement, nT) = quadratic B^2 + cubic B^3 with B the field along a coil axis, nT; along the sensor axis without the linearisation, across it fitted beside the linearisation".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, from the noise of every run, slow noise included; coil constants and coil angles not included".to_owned(),
        }
    }
}

/// A linearisation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearisationFile {
    /// What the numbers mean.
    pub convention: LinearisationConvention,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Campaign and instrument.
    pub campaign: String,
    /// Runs in time order.
    pub used: Vec<String>,
    /// The polynomials.
    pub linearisation: LinearisationPolynomials,
    /// Covariance of the six coefficients.
    pub covariance: Covariance,
    /// What is known of each sensor axis.
    pub axis: Vec<LinearisedAxis>,
    /// The runs without and with it.
    pub run: Vec<LinearisedRun>,
    /// Residual of every sensor axis against the field along every coil axis: the check for transverse effects.
    pub panel: Vec<LinearisationPanel>,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
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

impl Body for LinearisationFile {
    const FORMAT: &'static str = "LINEARISATION";
    fn file_name(&self) -> String {
        linearisation_file_name(&self.used)
    }
}

/// Name of the file for the first of some runs.
#[must_use]
pub fn linearisation_file_name(used: &[String]) -> String {
    format!("LINEARISATION__{}.toml", used.first().map_or("none", String::as_str))
}
