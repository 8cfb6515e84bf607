//! What was applied to the readings or settings of a run before a fit; results and their files state it.

use super::effects::{Catalogue, Changes};
use serde::{Deserialize, Serialize};

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
        let catalogue = Catalogue::default();
        let names: Vec<String> = self
            .effect
            .iter()
            .map(|e| {
                let changes = catalogue.named(&e.id).map(|effect| effect.changes());
                if changes == Some(Changes::Temperatures) {
                    return format!("{}, whose temperatures were used", e.id);
                }
                let nt = e.largest_nt.map(|nt| format!("{nt:.3} nT"));
                let of = if changes == Some(Changes::Clock) { "the sampling frequency" } else { "a phasor" };
                let part = e.largest_part.map(|part| format!("{part:.1e} of {of}"));
                let largest: Vec<String> = nt.into_iter().chain(part).collect();
                format!("{} on {} (at most {})", e.id, e.axes.join(", "), largest.join(", "))
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
