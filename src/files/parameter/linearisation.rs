//! LINEARISATION: the polynomial per sensor axis that linearises the readings of the runs of a sensor and mode.

use super::Body;
use super::kind::Naming;
use crate::data::apply::Apply;
use crate::data::error::Finding;
use crate::data::linearisation::SharedLinearisation;
use crate::data::note::Told;
use crate::files::linearisation;
use serde::{Deserialize, Serialize};
use std::path::Path;

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
    /// What the runs share, and what that makes of each.
    #[serde(flatten)]
    pub shared: SharedLinearisation,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for LinearisationFile {
    fn apply(&self) -> Option<Apply> {
        Some(Apply::linearisation_alone())
    }
    const FORMAT: &'static str = "LINEARISATION";
    const NAMING: Naming = Naming::Begin("LINEARISATION__");
    fn file_name(&self) -> String {
        linearisation_file_name(&self.shared.used)
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        linearisation::covariances(self, path).map(drop)
    }
}

/// Name of the file for the first of some runs.
#[must_use]
pub fn linearisation_file_name(used: &[String]) -> String {
    format!("LINEARISATION__{}.toml", used.first().map_or("none", String::as_str))
}
