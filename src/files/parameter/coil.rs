//! COIL_SCALAR, COIL_RESIDUAL, COIL_TILT: the facility's own calibration.

use super::Body;
use crate::data::result::Covariance;
use crate::model::facility::FacilityParameters;
use serde::{Deserialize, Serialize};

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilConvention {
    /// Equation of the model.
    pub model: String,
    /// Frames and units.
    pub frames: String,
    /// What `std` and `covariance` are.
    pub uncertainty: String,
}

impl CoilConvention {
    /// The frames are the same for all; model and uncertainty are those of the method.
    #[must_use]
    pub fn of(model: &str, uncertainty: &str) -> Self {
        Self {
            model: model.to_owned(),
            frames: "settings EU along the coils, fields nT in coil coordinates: X_c along the coil X, Y_c in the plane of the coils X and Y; angles between the coils XY, XZ, YZ in degrees; per_k relative (scale) or nT (offset) per kelvin from the reference temperature".to_owned(),
            uncertainty: uncertainty.to_owned(),
        }
    }
}

/// The scalar calibration of the coil system.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilScalar {
    /// What the numbers mean.
    pub convention: CoilConvention,
    /// Runs in time order.
    pub used: Vec<String>,
    /// Campaign and instrument.
    pub campaign: String,
    /// The facility.
    pub facility: FacilityParameters,
    /// Standard uncertainties.
    pub std: FacilityParameters,
    /// Covariance of all fitted parameters.
    pub covariance: Covariance,
    /// Quality of data and model.
    pub quality: ScalarQuality,
    /// Every calibration on its own.
    pub calibration: Vec<ScalarCalibration>,
    /// Rows that stand out and were left out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub outlier: Vec<ScalarOutlier>,
    /// Where the calibration holds.
    pub valid: ScalarValidity,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
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
    pub start: String,
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

impl Body for CoilScalar {
    const FORMAT: &'static str = "COIL_SCALAR";
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.used)
    }
}

/// Residual fields from moduli at plus and minus F.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilResidual {
    /// What the numbers mean.
    pub convention: CoilConvention,
    /// Runs, or the name of the table.
    pub used: Vec<String>,
    /// The facility: the residual field of the last state as offset field, ideal coils otherwise.
    pub facility: FacilityParameters,
    /// Standard uncertainties; nan for what is not measured.
    pub std: FacilityParameters,
    /// States of the facility in their order.
    pub state: Vec<ResidualState>,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
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

impl Body for CoilResidual {
    const FORMAT: &'static str = "COIL_RESIDUAL";
    const MAY_LACK: &'static [&'static str] = &["std"];
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.used)
    }
}

/// Sensor and facility from runs in several orientations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilTilt {
    /// What the numbers mean.
    pub convention: CoilConvention,
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
    pub correction: TiltValues,
    /// The sensor as all orientations see it with the corrected facility.
    pub sensor_parameters: TiltValues,
    /// Standard uncertainties of them.
    pub sensor_std: TiltValues,
    /// Combinations that the orientations leave undetermined; the corrections have no part along them.
    pub undetermined: Vec<String>,
    /// Root mean square deviation of the used orientations from their mean, with the facility as it was.
    pub spread_before: TiltValues,
    /// The same with the corrected facility.
    pub spread_after: TiltValues,
    /// Standard deviation of one value of one orientation: relative (scale), nT, degrees.
    pub residual_std: [f64; 3],
    /// Degrees of freedom of scale factors, offsets, angles.
    pub degrees_of_freedom: [usize; 3],
    /// Covariance of the facility's nine parameters.
    pub covariance: Covariance,
    /// The orientations.
    pub orientation: Vec<TiltOrientation>,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
}

/// Three sensitivities or scale factors, three offsets, three angles.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TiltValues {
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
    pub before: TiltValues,
    /// Sensor parameters with the corrected facility.
    pub after: TiltValues,
}

impl Body for CoilTilt {
    const FORMAT: &'static str = "COIL_TILT";
    const MAY_LACK: &'static [&'static str] = &["std", "sensor_std", "residual_std", "covariance"];
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.used)
    }
}

/// Name of the file for the first of some runs.
fn name(format: &str, used: &[String]) -> String {
    format!("{format}__{}.toml", used.first().map_or("none", String::as_str))
}
