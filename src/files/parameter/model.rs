//! MODEL: effects beside the linear sensor, as `diagnose` found them, for `diagnose`, `lin`, `thermal`, `freq` and `simulate`.

use super::Body;
use serde::{Deserialize, Serialize};

/// Effects of one sensor or facility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    /// Runs in which they were found.
    pub used: Vec<String>,
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

/// A model whose effects were taken off the readings of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelApplied {
    /// The model file.
    pub file: String,
    /// What was taken off.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub effect: Vec<AppliedEffect>,
    /// Effects of the file that were not taken off.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<String>,
}

impl ModelApplied {
    /// What was done, in a sentence.
    #[must_use]
    pub fn sentence(&self) -> String {
        let names: Vec<String> = self
            .effect
            .iter()
            .map(|e| match e.id.as_str() {
                "thermal_lag" => format!("{}, whose temperatures were used", e.id),
                id => {
                    let nt = e.largest_nt.map(|nt| format!("{nt:.3} nT"));
                    let part = e.largest_part.map(|part| match id {
                        "clock_drift" => format!("{part:.1e} of the sampling frequency"),
                        _ => format!("{part:.1e} of a phasor"),
                    });
                    let largest: Vec<String> = nt.into_iter().chain(part).collect();
                    format!("{id} on {} (at most {})", e.axes.join(", "), largest.join(", "))
                }
            })
            .collect();
        let names = if names.is_empty() { "nothing".to_owned() } else { names.join("; ") };
        let left = if self.left_out.is_empty() { String::new() } else { format!("; left out: {}", self.left_out.join(", ")) };
        format!("The effects of `{}` were taken off before the fit: {names}{left}.", self.file)
    }
}

/// An effect that was taken off.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedEffect {
    /// Id in the catalogue.
    pub id: String,
    /// Which of its forms.
    pub form: String,
    /// Axes on which it acts.
    pub axes: Vec<String>,
    /// Largest contribution to the mean reading of a plateau that was used, nT along a sensor axis; absent for sines.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_nt: Option<f64>,
    /// Largest change of the phasor of a sine, as a part of it, or of the sampling frequency; absent for plateaus.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub largest_part: Option<f64>,
}

impl Body for Model {
    const FORMAT: &'static str = "MODEL";

    fn file_name(&self) -> String {
        "model.toml".to_owned()
    }
}
