//! What a frequency analysis finds.

use crate::data::frequency::{ClockDrift, SineAmplitude};
use crate::data::note::Note;
use crate::data::result::RunHead;
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

/// The sampling frequency against the clock of the facility.
#[derive(Clone, Debug, PartialEq)]
pub struct SamplingRate {
    /// Per component, Hz; nan where a component tells none.
    pub component_hz: [f64; 3],
    /// Its standard uncertainty, Hz.
    pub component_std_hz: [f64; 3],
    /// Weighted mean of the components, Hz.
    pub mean_hz: f64,
    /// Its standard uncertainty, Hz.
    pub mean_std_hz: f64,
    /// Standard deviation of the components about their mean, Hz; absent if fewer than two tell one.
    pub scatter_hz: Option<f64>,
    /// Drift and the next best value.
    pub clock: ClockDrift,
}

/// A frequency analysis with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Freq {
    /// The run.
    pub run: RunHead,
    /// Sampling frequency; absent for a table of amplitudes.
    pub rate: Option<SamplingRate>,
    /// -3 dB frequency from the two neighbouring amplitudes, Hz; nan where the amplitudes do not fall by 3 dB.
    pub f_3db_igep_hz: [f64; 3],
    /// -3 dB frequency of the model, Hz; nan where no model fits.
    pub f_3db_model_hz: [f64; 3],
    /// Its standard uncertainty with that of the known effects, Hz.
    pub f_3db_model_std_hz: [f64; 3],
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
