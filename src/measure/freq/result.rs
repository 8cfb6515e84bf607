//! What a frequency analysis finds.

use crate::data::frequency::{FrequencyFound, FrequencyValues, SineAmplitude};
use crate::data::note::Note;
use crate::data::run::Setting;
use crate::measure::corner::Corner;
use crate::model::applied::ModelApplied;
use crate::record::conditions::Temperatures;
use serde::Serialize;

/// One applied frequency with its used stretch.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stretch {
    /// The setting.
    pub setting: Setting,
    /// Begin and end of the used part, s since the run's start; absent if the frequency was refused.
    pub used_s: Option<[f64; 2]>,
}

/// A frequency analysis with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Freq {
    /// Sampling frequency and -3 dB frequencies.
    pub values: FrequencyValues,
    /// What they were found with.
    pub found: FrequencyFound,
    /// The response fit; its rows are the amplitudes in their order.
    pub corner: Corner,
    /// Known effects that were taken off the sines.
    pub effects: Option<ModelApplied>,
    /// One entry per applied frequency, in the order of the run.
    pub amplitude: Vec<SineAmplitude>,
    /// The settings and the parts of them that were used; empty for a table of amplitudes.
    pub stretches: Vec<Stretch>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// What a person should know.
    pub notes: Vec<Note>,
}
