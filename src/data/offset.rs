//! The parts of an offset measurement in several positions.
//!
//! The result of the analysis and its parameter file both hold them, so that each is defined here only.

use super::result::{Covariance, RunHead, Spread};
use serde::{Deserialize, Serialize};

/// Offset and residual field with their uncertainties. What is not determined is nan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetValues {
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
    /// Sensor temperatures at which the offsets hold, °C, where they are not that of the run: of every component the mean over its visits, each as
    /// it counts in the offset.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_degc: Option<[f64; 3]>,
}

impl OffsetValues {
    /// Nothing is determined.
    pub const UNDETERMINED: Self = Self {
        offset_ent: [f64::NAN; 3],
        offset_std_ent: [f64::NAN; 3],
        residual_ent: [f64::NAN; 3],
        residual_std_ent: [f64::NAN; 3],
        residual_coil_nt: [f64::NAN; 3],
        residual_coil_std_nt: [f64::NAN; 3],
        offset_degc: None,
    };

    /// The standard uncertainties, type A.
    #[must_use]
    pub fn std(&self) -> OffsetStd {
        OffsetStd {
            offset_ent: self.offset_std_ent,
            residual_ent: self.residual_std_ent,
            residual_coil_nt: self.residual_coil_std_nt,
        }
    }
}

/// Standard uncertainties of offset and residual field. What is not determined is nan.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetStd {
    /// Of the offset, enT, sensor axes.
    pub offset_ent: [f64; 3],
    /// Of the residual field along the sensor axes in the normal position, enT.
    pub residual_ent: [f64; 3],
    /// Of the residual field, nT, coil axes.
    pub residual_coil_nt: [f64; 3],
}

/// Type B uncertainties of an offset measurement, and both types together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetTypeB {
    /// Standard uncertainties, type B: those of the facility, common to all runs that use the same facility file.
    pub std_b: OffsetStd,
    /// Standard uncertainties of both types.
    pub std_combined: OffsetStd,
    /// Covariance of offsets and residual field, type B.
    pub covariance_b: Covariance,
    /// The same of both types.
    pub covariance_combined: Covariance,
}

impl OffsetTypeB {
    /// Those of type B with those of type A, which are independent of them.
    #[must_use]
    pub fn with(std_b: OffsetStd, covariance_b: Covariance, values: &OffsetValues, covariance: &Covariance) -> Self {
        let both = |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| f64::hypot(a[i], b[i]));
        Self {
            std_combined: OffsetStd {
                offset_ent: both(values.offset_std_ent, std_b.offset_ent),
                residual_ent: both(values.residual_std_ent, std_b.residual_ent),
                residual_coil_nt: both(values.residual_coil_std_nt, std_b.residual_coil_nt),
            },
            covariance_combined: covariance.plus(&covariance_b),
            std_b,
            covariance_b,
        }
    }
}

/// How offset and residual field were found.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetFound {
    /// Run and conditions.
    pub run: RunHead,
    /// How the offsets were found, per component.
    pub method: OffsetMethod,
    /// Offsets in nT with the sensitivity of a linear calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled: Option<ScaledOffset>,
    /// Covariance of offsets and residual field.
    pub covariance: Covariance,
    /// What the uncertainty of the facility adds; absent where its file states none.
    #[serde(flatten)]
    pub of_facility: Option<OffsetTypeB>,
    /// Drift between visits of the same position.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<OffsetDrift>,
    /// Quality of the data.
    pub quality: OffsetQuality,
    /// The visits of positions in time order.
    pub visit: Vec<PositionVisit>,
    /// Components that were refused.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub refused: Vec<RefusedComponent>,
}

impl OffsetFound {
    /// The covariance that users of the offsets need: of both types where type B is stated.
    #[must_use]
    pub fn covariance_of_both(&self) -> &Covariance {
        self.of_facility.as_ref().map_or(&self.covariance, |b| &b.covariance_combined)
    }

    /// The standard uncertainties that users of the values need: of both types where type B is stated.
    #[must_use]
    pub fn std_of_both(&self, values: &OffsetValues) -> OffsetStd {
        self.of_facility.as_ref().map_or_else(|| values.std(), |b| b.std_combined)
    }
}

/// How the components were separated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetMethod {
    /// Per component `turned` (the axis flips sign between two positions), `tilted` (it looks along several coil axes), or `none`.
    pub component: [String; 3],
    /// Per component the positions that were compared, the normal one first.
    pub positions: [Vec<u32>; 3],
    /// Per component the coil axis along which it looks in the normal position, `+X` for example: the axis whose residual field
    /// `residual_ent` shows.
    pub normal_axis: [String; 3],
    /// Where the response of the sensor to a field comes from: `run` or `nominal`.
    pub response: String,
    /// For which noise the uncertainties hold, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_covers: Option<String>,
    /// What an error of the facility does to the results, in words; absent where its file states no uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_b_covers: Option<String>,
}

/// Offsets in nT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaledOffset {
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
pub struct OffsetDrift {
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
pub struct PositionVisit {
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
