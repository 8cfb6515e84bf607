//! The parts of the facility's own calibration.
//!
//! The result of the analysis and its parameter file both hold them, so that each is defined here only.

use super::facility::{FacilityParameters, PeriodSpan};
use crate::data::result::Covariance;
use crate::data::start::Start;
use serde::{Deserialize, Serialize};

/// What a scalar calibration of the coil system finds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarFound {
    /// Runs in time order.
    pub used: Vec<String>,
    /// Campaign and instrument.
    pub campaign: String,
    /// The facility; of several periods the last one.
    pub facility: FacilityParameters,
    /// Standard uncertainties; nan for coefficients that were taken as zero.
    pub std: FacilityParameters,
    /// Covariance of the facility's parameters.
    pub covariance: Covariance,
    /// What may explain that the calibrations differ, by its evidence; empty for a single one.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub hypothesis: Vec<ScalarHypothesis>,
    /// Steps between calibrations.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub step: Vec<ScalarStep>,
    /// The facility before and after the steps; empty if it did not step.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub period: Vec<ScalarPeriod>,
    /// Quality of data and model.
    pub quality: ScalarQuality,
    /// Every calibration on its own.
    pub calibration: Vec<ScalarCalibration>,
    /// Rows that stand out and were left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outlier: Vec<ScalarOutlier>,
    /// Where the calibration holds.
    pub valid: ScalarValidity,
}

/// What may explain that the calibrations of a facility differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Explanation {
    /// They differ by noise alone.
    Nothing,
    /// The facility follows the temperatures of coils and rack.
    Temperatures,
    /// Some of its parameters step between two calibrations, and none follows a temperature.
    Steps,
    /// Some of its parameters step, and it follows the temperatures.
    Both,
}

impl Explanation {
    /// What it is, in words.
    #[must_use]
    pub fn words(self) -> &'static str {
        match self {
            Explanation::Nothing => "noise alone",
            Explanation::Temperatures => "temperature coefficients",
            Explanation::Steps => "steps alone",
            Explanation::Both => "steps and temperature coefficients",
        }
    }
}

/// An explanation, fitted to the same rows as the others.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarHypothesis {
    /// The explanation.
    pub explanation: Explanation,
    /// Number of parameters.
    pub parameters: usize,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Standard deviation of measured minus modelled modulus, nT.
    pub residual_std_nt: f64,
    /// Bayesian information criterion, `n ln(S / n) + k ln n`: the smaller, the better; half of a difference is about the logarithm of the odds.
    pub bic: f64,
    /// Whether the facility is given by it.
    pub chosen: bool,
}

/// A parameter that stepped between two calibrations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarStep {
    /// The parameter, in words.
    pub parameter: String,
    /// Its value before: nT/EU, nT or degrees.
    pub before: f64,
    /// Its value after.
    pub after: f64,
    /// Last calibration with the old value, a run id.
    pub last_run_before: String,
    /// First calibration with the new value.
    pub first_run_after: String,
}

/// The facility in a part of the time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarPeriod {
    /// When it holds. Between two calibrations the boundary is the middle of the time between them.
    #[serde(flatten)]
    pub span: PeriodSpan,
    /// The facility.
    #[serde(flatten)]
    pub facility: FacilityParameters,
    /// Standard uncertainties; nan for coefficients that were taken as zero.
    pub std: FacilityParameters,
    /// Covariance of the facility's parameters.
    pub covariance: Covariance,
}

/// What moduli at plus and minus F say of the residual field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualFound {
    /// Runs, or the name of the table.
    pub used: Vec<String>,
    /// The facility: the residual field of the last state as offset field, ideal coils otherwise.
    pub facility: FacilityParameters,
    /// Standard uncertainties; nan for what is not measured.
    pub std: FacilityParameters,
    /// Covariance of the offset fields that were measured; files of earlier versions have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub covariance: Option<Covariance>,
    /// States of the facility in their order.
    pub state: Vec<ResidualState>,
}

/// What runs of a sensor in several orientations say of sensor and facility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltFound {
    /// Sensor.
    pub sensor: String,
    /// Runs that were used.
    pub used: Vec<String>,
    /// The facility that makes the orientations agree.
    pub facility: FacilityParameters,
    /// Standard uncertainties; nan where as many orientations as parameters leave nothing to see scatter in.
    pub std: FacilityParameters,
    /// The facility that the runs were evaluated with.
    pub facility_before: FacilityParameters,
    /// Corrections of the facility: relative (scale), nT (offset), degrees (angles).
    pub correction: SensorValues,
    /// The sensor as all orientations see it with the corrected facility.
    pub sensor_parameters: SensorValues,
    /// Standard uncertainties of them.
    pub sensor_std: SensorValues,
    /// Combinations that the orientations leave undetermined; the corrections have no part along them.
    pub undetermined: Vec<String>,
    /// Root mean square deviation of the used orientations from their mean, with the facility as it was.
    pub spread_before: SensorValues,
    /// The same with the corrected facility.
    pub spread_after: SensorValues,
    /// Standard deviation of one value of one orientation: relative (scale), nT, degrees.
    pub residual_std: [f64; 3],
    /// Degrees of freedom of scale factors, offsets, angles.
    pub degrees_of_freedom: [usize; 3],
    /// Covariance of the facility's nine parameters.
    pub covariance: Covariance,
    /// The orientations.
    pub orientation: Vec<TiltOrientation>,
}

/// Quality of a scalar calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarQuality {
    /// Rows used.
    pub rows_used: usize,
    /// Rows of the runs.
    pub rows_total: usize,
    /// Degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Condition number of the design with columns scaled to one.
    pub condition: f64,
    /// Share of the squared settings along the three principal directions, the largest first; a third each if spread evenly.
    pub direction_share: [f64; 3],
    /// Standard deviation of measured minus modelled modulus, nT.
    pub residual_std_nt: f64,
    /// Largest magnitude of it, nT.
    pub residual_max_nt: f64,
}

/// One calibration of several.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarCalibration {
    /// Run id.
    pub run: String,
    /// Start, UTC.
    pub start: Start,
    /// Rows used.
    pub rows: usize,
    /// Mean coil temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_degc: Option<f64>,
    /// Mean rack temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_degc: Option<f64>,
    /// Standard deviation of measured minus modelled modulus, nT.
    pub residual_std_nt: f64,
    /// Condition number of its design.
    pub condition: f64,
    /// The facility at these temperatures.
    pub facility: FacilityParameters,
    /// Standard uncertainties.
    pub std: FacilityParameters,
}

/// A row that stands out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarOutlier {
    /// Run id.
    pub run: String,
    /// Row of `@SCALAR`, from 1.
    pub row: usize,
    /// s since the run's start.
    pub t_s: f64,
    /// Setting, EU.
    pub setting_eu: [f64; 3],
    /// Measured modulus, nT.
    pub modulus_nt: f64,
    /// Measured minus modelled modulus, nT.
    pub residual_nt: f64,
}

/// Where a scalar calibration holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScalarValidity {
    /// Smallest and largest modulus, nT.
    pub modulus_nt: [f64; 2],
    /// Smallest and largest coil temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_degc: Option<[f64; 2]>,
    /// Smallest and largest rack temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_degc: Option<[f64; 2]>,
}

/// Residual field in one state of the facility, before or after nulling for example.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ResidualState {
    /// Its name.
    pub name: String,
    /// The axes that were measured.
    pub axis: Vec<AxisResidual>,
}

/// Residual field along one coil axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AxisResidual {
    /// `X`, `Y` or `Z`.
    pub axis: String,
    /// Mean modulus at plus F, nT.
    pub plus_nt: f64,
    /// Mean modulus at minus F, nT.
    pub minus_nt: f64,
    /// Residual field, nT.
    pub residual_nt: f64,
    /// Its standard uncertainty, nT.
    pub std_nt: f64,
    /// Pairs of plus and minus.
    pub pairs: usize,
}

/// Three sensitivities or scale factors, three offsets, three angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SensorValues {
    /// Sensitivities, nT/enT, or a relative change.
    pub scale: [f64; 3],
    /// Offsets, nT.
    pub offset_nt: [f64; 3],
    /// Angles or a change of them, degrees.
    pub angles_deg: [f64; 3],
}

/// One orientation of the sensor: means of its runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltOrientation {
    /// Sensor axes along the coil axes X, Y, Z.
    pub axes: String,
    /// Its runs.
    pub runs: Vec<String>,
    /// Whether it took part in the fit.
    pub used: bool,
    /// Sensor parameters with the facility as it was.
    pub before: SensorValues,
    /// Sensor parameters with the corrected facility.
    pub after: SensorValues,
}
