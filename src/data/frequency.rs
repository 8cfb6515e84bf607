//! What a frequency measurement says of the clock of the instrument and of every applied frequency.
//!
//! The result of the analysis and its parameter file both hold them, so that each is defined here only.

use super::result::RunHead;
use serde::{Deserialize, Serialize};

/// Sampling frequency and -3 dB frequencies. A table of amplitudes tells no sampling frequency.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FrequencyValues {
    /// Sampling frequency per component, Hz; nan where a component tells none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_s_hz: Option<[f64; 3]>,
    /// Its standard uncertainty, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_s_std_hz: Option<[f64; 3]>,
    /// Weighted mean of the components, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_f_s_hz: Option<f64>,
    /// Its standard uncertainty, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_f_s_std_hz: Option<f64>,
    /// Standard deviation of the components about their mean, Hz; absent if fewer than two tell one. The protocol of 2013 prints it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scatter_f_s_hz: Option<f64>,
    /// -3 dB frequency from the two neighbouring amplitudes, Hz; nan where the amplitudes do not fall by 3 dB.
    pub f_3db_igep_hz: [f64; 3],
    /// -3 dB frequency of the model, Hz; nan where no model fits.
    pub f_3db_model_hz: [f64; 3],
    /// Its standard uncertainty with that of the known effects, Hz.
    pub f_3db_model_std_hz: [f64; 3],
    /// Sensor temperature at which the frequencies of the model hold, °C, where it moved during the run; otherwise they hold at the mean.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub f_3db_model_degc: Option<[f64; 3]>,
}

/// What these were found with.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrequencyFound {
    /// Run and conditions.
    pub run: RunHead,
    /// Amplitude of the applied field to which all amplitudes are referred, nT; absent where none is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied_nt: Option<f64>,
    /// The response model.
    pub model: FittedResponse,
    /// What is known about the clock beside its frequency; absent for a table of amplitudes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clock: Option<ClockDrift>,
}

/// The clock of the instrument against that of the facility.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ClockDrift {
    /// Drift of the sampling frequency during the run per component beside a known one, Hz/s.
    pub drift_hz_per_s: [f64; 3],
    /// Its standard uncertainty.
    pub drift_std_hz_per_s: [f64; 3],
    /// Time for which the sampling frequencies hold, s after sample counter 0; absent without a significant or a known drift.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_s: Option<f64>,
    /// The drift is larger than four standard uncertainties in the mean of the components.
    pub drift_is_significant: bool,
    /// The next best sampling frequency, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rival_hz: Option<f64>,
    /// How much worse it describes the data, as a difference of chi-square.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rival_chi_square: Option<f64>,
}

/// One applied frequency.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SineAmplitude {
    /// Applied frequency, Hz.
    pub frequency_hz: f64,
    /// Amplitude per component, enT, at the applied field that all of a run are referred to; nan if it was refused.
    pub b_ent: [f64; 3],
    /// Its standard uncertainty, enT; nan if not known.
    pub b_std_ent: [f64; 3],
    /// Amplitude of the field that was applied, nT; absent where none is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied_nt: Option<f64>,
    /// Sample counter for which the phase holds: the middle of the used stretch.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase_counter: Option<u64>,
    /// Phase per component at that counter, degrees; nan where the amplitude is not detected.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase_deg: Option<[f64; 3]>,
    /// Its standard uncertainty, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub phase_std_deg: Option<[f64; 3]>,
    /// The amplitude counts in the response model, for every component.
    pub used: bool,
    /// Weight in the response model per component.
    pub weight: [f64; 3],
    /// The amplitude stands out of the noise, per component.
    pub detected: [bool; 3],
    /// Frequency at which the samples show it, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alias_hz: Option<f64>,
    /// Used stretch, s since the run's start.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub used_s: Option<[f64; 2]>,
    /// Used samples.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub samples: Option<u64>,
    /// Why it was refused, or part of it left out.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub remark: String,
}

impl SineAmplitude {
    /// Says one thing more about it.
    pub fn add_remark(&mut self, remark: &str) {
        if !self.remark.is_empty() {
            self.remark.push_str("; ");
        }
        self.remark.push_str(remark);
    }
}

/// A fitted response model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FittedResponse {
    /// Its name; `none` if the amplitudes determine no model.
    pub name: String,
    /// Names of its parameters with their units.
    pub parameters: Vec<String>,
    /// Values per component.
    pub values: Vec<Vec<f64>>,
    /// Standard uncertainties per component.
    pub std: Vec<Vec<f64>>,
    /// Chi-square of the amplitudes about the model over the components, where it explains them within their uncertainties; these then
    /// give the uncertainties. Absent where no model does: the scatter of the amplitudes and the jackknife give them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub chi_square: Option<f64>,
    /// Its degrees of freedom.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub degrees_of_freedom: Option<usize>,
    /// Relative standard deviation of the residuals per component; nan where no model fits.
    pub residual_std: Vec<f64>,
    /// Every model that was tried.
    pub candidate: Vec<ComparedResponse>,
}

/// A model that was tried.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ComparedResponse {
    /// Name.
    pub name: String,
    /// -3 dB frequency that it gives per component, Hz; nan where it gives none.
    pub f_3db_hz: [f64; 3],
    /// AICc over the three components, less that of the best.
    pub delta_aicc: f64,
}
