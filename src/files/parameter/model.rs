//! MODEL: effects beside the linear sensor, as `diagnose` found them, for `diagnose`, `lin`, `thermal`, `freq` and `simulate`.

use super::Body;
use super::kind::Naming;
use serde::{Deserialize, Serialize};

/// Effects of one sensor or facility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// Runs in which they were found.
    pub used: Vec<String>,
    /// Sensor of these runs. Absent in files of earlier versions, and where the runs are of several sensors or do not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sensor: Option<String>,
    /// Mode of these runs, absent likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mode: Option<String>,
    /// What the numbers mean.
    pub convention: String,
    /// The effects.
    pub effect: Vec<ModelEffect>,
}

/// One effect.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelEffect {
    /// Id in the catalogue.
    pub id: String,
    /// Which of its forms.
    pub form: String,
    /// Axes on which it acts, x, y, z.
    pub axes: Vec<String>,
    /// Run in which it was found; absent if it may be any of `used`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub run: Option<String>,
    /// Smallest and largest reading of the three sensor axes, without offset, with which it was found, enT.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading_ent: Option<Vec<[f64; 2]>>,
    /// Linear parameters in the order of the form.
    #[serde(default)]
    pub parameter: Vec<ModelParameter>,
    /// Shape parameters.
    #[serde(default)]
    pub shape: Vec<ModelParameter>,
}

/// A parameter with its unit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelParameter {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard uncertainty, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<f64>,
    /// Unit.
    pub unit: String,
}

impl Body for Model {
    const FORMAT: &'static str = "MODEL";
    const NAMING: Naming = Naming::Free;

    fn file_name(&self) -> String {
        "model.toml".to_owned()
    }
}
