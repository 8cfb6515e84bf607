//! OPF: sensor offset and residual field of the coil system from normal and turned positions.

use super::Body;
use crate::data::result::{Conditions, Covariance, Dropped, RunHead, Spread};
use crate::model::facility::FacilityApplied;
use serde::{Deserialize, Serialize};

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetConvention {
    /// Equation of the model.
    pub model: String,
    /// Frames and units.
    pub frames: String,
    /// What `*_std_*` and `covariance` are.
    pub uncertainty: String,
}

impl Default for OffsetConvention {
    fn default() -> Self {
        Self {
            model: "B_r = B_off + A (B_c + B_res,c) in every position, A measured with the applied fields; in a turned pair B_off = (B_normal + B_turned)/2, residual_ent = (B_normal - B_turned)/2".to_owned(),
            frames: "offset_ent and residual_ent along the sensor axes (DUT coordinates), enT, in the normal position; residual_coil_nt in coil coordinates, nT; nan is not determined".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, from the scatter of the samples within and of the means between the plateaus, slow noise included: 1.96 of them make an interval of 95 %; the field between the positions is taken as constant but for the drift stated".to_owned(),
        }
    }
}

/// Offset and residual field. Components that the positions do not determine are nan and stand in `refused`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opf {
    /// Offset of the sensor, enT, sensor axes.
    pub offset_ent: [f64; 3],
    /// Standard uncertainty of the offset, enT.
    pub offset_std_ent: [f64; 3],
    /// Residual field of the coil system, enT, along the sensor axes in the normal position.
    pub residual_ent: [f64; 3],
    /// Standard uncertainty of the residual field, enT.
    pub residual_std_ent: [f64; 3],
    /// Residual field of the coil system, nT, coil axes.
    pub residual_coil_nt: [f64; 3],
    /// Its standard uncertainty, nT.
    pub residual_coil_std_nt: [f64; 3],
    /// What the numbers mean.
    pub convention: OffsetConvention,
    /// Run and conditions.
    pub run: RunHead,
    /// How the offsets were found, per component.
    pub method: Method,
    /// Offsets in nT with the sensitivity of a linear calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled: Option<Scaled>,
    /// Covariance of offsets and residual field.
    pub covariance: Covariance,
    /// Drift between visits of the same position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<Drift>,
    /// Quality of the data.
    pub quality: OffsetQuality,
    /// The visits of positions in time order.
    pub visit: Vec<Visit>,
    /// Components that were refused.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedComponent>,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// The facility whose scale factors and angles turned settings into applied fields; absent if the settings were taken as fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facility: Option<FacilityApplied>,
    /// Plateaus that were not used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<Dropped>,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl Body for Opf {
    const FORMAT: &'static str = "OPF";
    const MAY_LACK: &'static [&'static str] = &[
        "offset_ent",
        "offset_std_ent",
        "residual_ent",
        "residual_std_ent",
        "residual_coil_nt",
        "residual_coil_std_nt",
        "scaled",
    ];
    fn file_name(&self) -> String {
        format!("OFF_PARAMETER__{}.OPF", self.run.dashed_id())
    }
}

/// How the components were separated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Method {
    /// Per component `turned` (the axis flips sign between two positions), `tilted` (it looks along several coil axes), or `none`.
    pub component: [String; 3],
    /// Per component the positions that were compared, the normal one first.
    pub positions: [Vec<u32>; 3],
    /// Per component the coil axis along which it looks in the normal position, `+X` for example: the axis whose residual field
    /// `residual_ent` shows.
    pub normal_axis: [String; 3],
    /// Where the response of the sensor to a field comes from: `run` or `nominal`.
    pub response: String,
}

/// Offsets in nT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scaled {
    /// The linear calibration that gave the sensitivity.
    pub cpf: String,
    /// Sensitivity, nT/enT.
    pub sigma: [f64; 3],
    /// Offset, nT, sensor axes.
    pub offset_nt: [f64; 3],
    /// Its standard uncertainty, nT.
    pub offset_std_nt: [f64; 3],
    /// Residual field along the sensor axes in the normal position, nT.
    pub residual_nt: [f64; 3],
    /// Its standard uncertainty, nT.
    pub residual_std_nt: [f64; 3],
}

/// Linear drift of the readings, estimated because a position was visited more than once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Drift {
    /// enT per hour.
    pub ent_per_h: [f64; 3],
    /// Its standard uncertainty.
    pub std_ent_per_h: [f64; 3],
    /// Time for which the offsets hold, s since the run's start.
    pub reference_s: f64,
}

/// Quality of an offset measurement.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetQuality {
    /// Plateaus used.
    pub blocks_used: usize,
    /// Plateaus in the run.
    pub blocks_total: usize,
    /// Samples lost.
    pub lost_samples: u64,
    /// Smallest, mean and largest standard deviation of the samples within a plateau, enT.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw_std_ent: Option<Spread>,
    /// Standard deviation of a plateau mean, enT.
    pub plateau_std_ent: [f64; 3],
    /// Plateaus minus fitted levels and responses: the degrees of freedom of the uncertainties.
    pub plateau_degrees_of_freedom: usize,
    /// Chi-square of the visits against the model.
    pub chi_square: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Factor by which the uncertainties were widened because the visits disagree; 1 where they agree.
    pub widened: f64,
}

/// Zero-field reading in one visit of a position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Visit {
    /// Id of the position.
    pub position: u32,
    /// Sensor axes along coil axes.
    pub axes: [String; 3],
    /// First and last used time, s since the run's start.
    pub time_s: [f64; 2],
    /// Plateaus used.
    pub blocks: usize,
    /// Reading at zero applied field, enT.
    pub reading_ent: [f64; 3],
    /// Its standard uncertainty, enT.
    pub std_ent: [f64; 3],
    /// Reading minus model, enT; absent for components that were refused.
    #[serde(default)]
    pub residual_ent: Vec<f64>,
}

/// A component that the positions do not determine.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefusedComponent {
    /// `x`, `y` or `z`.
    pub component: String,
    /// Why.
    pub reason: String,
    /// What to do.
    pub remedy: String,
}
