//! NULL: offset drift, noise and what the offset follows, from a long record in zero field.

use super::Body;
use super::kind::Naming;
use crate::data::note::Told;
use crate::data::result::Conditions;
use crate::data::zero_field::ZeroFieldFound;
use crate::model::applied::ModelApplied;
use serde::{Deserialize, Serialize};

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NullConvention {
    /// Model of the drift.
    pub drift: String,
    /// The density.
    pub density: String,
    /// The Allan deviation.
    pub allan: String,
    /// What `*_std_*`, `low` and `high` are.
    pub uncertainty: String,
}

impl Default for NullConvention {
    fn default() -> Self {
        Self {
            drift: "B_r(t) = mean_ent + sum_k drift_ent_per_h[k-1] ((t - time_s)/3600)^k, raw readings, enT, sensor axes; the residual field of the coil system is part of the mean".to_owned(),
            density: "one-sided amplitude density, enT/sqrt(Hz), Welch's method: Hann window, half overlap, straight line taken away, mean over bands of 1/16 decade; lines are left out of the bands".to_owned(),
            allan: "sigma^2(tau) = <(mean_2 - mean_1)^2>/2 of neighbouring means over tau, overlapping from 64 samples on, enT".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, slow noise included for offset, drift and coefficients; low and high are limits of 95 % from chi-square; factors multiply the value".to_owned(),
        }
    }
}

impl NullConvention {
    /// For samples from which known effects were taken off.
    #[must_use]
    pub fn without_effects(self) -> Self {
        Self {
            drift: format!("{}; the effects of [model] were taken off B_r", self.drift),
            uncertainty: format!("{}; that of the parameters of [model] is not included", self.uncertainty),
            ..self
        }
    }
}

/// The result of a zero-field run. Values that are not determined are nan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Npf {
    /// What the numbers mean.
    pub convention: NullConvention,
    /// What was found.
    #[serde(flatten)]
    pub found: ZeroFieldFound,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// Known effects that were taken off the samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelApplied>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for Npf {
    const FORMAT: &'static str = "NULL";
    const NAMING: Naming = Naming::Begin("NULL_PARAMETER__");
    const MAY_LACK: &'static [&'static str] = &["offset", "scaled", "corner", "line", "channel", "together", "allan", "spectrum"];
    fn file_name(&self) -> String {
        format!("NULL_PARAMETER__{}.toml", self.found.run.id)
    }
}
