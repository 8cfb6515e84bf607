//! NULL: offset drift, noise and what the offset follows, from a long record in zero field.

use super::Body;
use crate::data::result::{Conditions, RunHead};
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

/// The result of a zero-field run. Values that are not determined are nan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Npf {
    /// What the numbers mean.
    pub convention: NullConvention,
    /// Run and conditions.
    pub run: RunHead,
    /// The record.
    pub record: RecordPart,
    /// Offset and drift.
    pub offset: NullOffset,
    /// Amplitude density at 1 Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density: Option<DensityPart>,
    /// Reading, drift and density in nT with the sensitivity of a linear calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled: Option<NullScaled>,
    /// White and 1/f noise.
    pub corner: CornerPart,
    /// The spectrum.
    pub spectrum: SpectrumPart,
    /// The Allan deviation.
    pub allan: AllanPart,
    /// Lines in the spectrum.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub line: Vec<LinePart>,
    /// The offset against each slow channel.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub channel: Vec<ChannelPart>,
    /// The offset against sensor temperature and variometer at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<TogetherPart>,
    /// Where the data stop.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stop: Vec<StopPart>,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// What a person should know.
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl Body for Npf {
    const FORMAT: &'static str = "NULL";
    const MAY_LACK: &'static [&'static str] = &["offset", "scaled", "corner", "line", "channel", "together", "allan", "spectrum"];
    fn file_name(&self) -> String {
        format!("NULL_PARAMETER__{}.toml", self.run.id)
    }
}

/// The record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordPart {
    /// Samples.
    pub samples: u64,
    /// Samples lost.
    pub lost: u64,
    /// Gaps.
    pub gaps: u64,
    /// Lost samples in short gaps, for which a straight line stands.
    pub bridged: u64,
    /// First and last sample, s since the run's start.
    pub time_s: [f64; 2],
    /// Measured sample rate, Hz.
    pub sample_rate_hz: f64,
}

/// Offset and drift.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NullOffset {
    /// Middle of the record, s since the run's start: the time for which `mean_ent` holds.
    pub time_s: f64,
    /// Order of the drift.
    pub order: usize,
    /// Reading of the drift at `time_s`, enT.
    pub mean_ent: [f64; 3],
    /// Its standard uncertainty, enT.
    pub mean_std_ent: [f64; 3],
    /// Coefficients of h, h², h³, enT/hᵏ.
    pub drift_ent_per_h: Vec<[f64; 3]>,
    /// Their standard uncertainties.
    pub drift_std_ent_per_h: Vec<[f64; 3]>,
    /// Standard deviation of the means about the drift, enT.
    pub residual_std_ent: [f64; 3],
    /// Largest minus smallest mean, enT.
    pub range_ent: [f64; 3],
    /// Means that were fitted.
    pub rows: usize,
}

/// What a zero-field run shows, in nT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NullScaled {
    /// The linear calibration that gave the sensitivity.
    pub cpf: String,
    /// Sensitivity, nT/enT.
    pub sigma: [f64; 3],
    /// Reading of the drift at `offset.time_s`, nT, sensor axes.
    pub mean_nt: [f64; 3],
    /// Its standard uncertainty, nT.
    pub mean_std_nt: [f64; 3],
    /// Coefficients of h, h², h³, nT/hᵏ.
    pub drift_nt_per_h: Vec<[f64; 3]>,
    /// Their standard uncertainties.
    pub drift_std_nt_per_h: Vec<[f64; 3]>,
    /// Amplitude density at the frequency of `density`, nT/√Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub nt_per_root_hz: Option<[f64; 3]>,
    /// Its standard uncertainty.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_nt_per_root_hz: Option<[f64; 3]>,
}

/// Amplitude density at a frequency.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct DensityPart {
    /// Frequency, Hz.
    pub frequency_hz: f64,
    /// Band over which the density was averaged, Hz.
    pub band_hz: [f64; 2],
    /// Amplitude density, enT/√Hz.
    pub ent_per_root_hz: [f64; 3],
    /// Its standard uncertainty.
    pub std_ent_per_root_hz: [f64; 3],
    /// Lower limit of 95 %.
    pub low_ent_per_root_hz: [f64; 3],
    /// Upper limit of 95 %.
    pub high_ent_per_root_hz: [f64; 3],
    /// Degrees of freedom.
    pub degrees_of_freedom: f64,
}

/// White and 1/f noise, `S(f) = white² + slow² / f`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CornerPart {
    /// White amplitude density, enT/√Hz.
    pub white_ent_per_root_hz: [f64; 3],
    /// Its standard uncertainty.
    pub white_std_ent_per_root_hz: [f64; 3],
    /// Amplitude density of the 1/f noise at 1 Hz, enT/√Hz.
    pub slow_ent_per_root_hz: [f64; 3],
    /// Frequency at which both are equal, Hz.
    pub corner_hz: [f64; 3],
    /// Its standard uncertainty, Hz.
    pub corner_std_hz: [f64; 3],
    /// χ² of the fit over its degrees of freedom.
    pub chi_square_per_degree: [f64; 3],
}

/// A line.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinePart {
    /// `x`, `y` or `z`.
    pub component: String,
    /// Frequency, Hz; it may be an alias.
    pub frequency_hz: f64,
    /// Width of a bin, Hz.
    pub resolution_hz: f64,
    /// Amplitude, half peak to peak, enT.
    pub amplitude_ent: f64,
    /// Its standard uncertainty, enT.
    pub amplitude_std_ent: f64,
    /// Power density over that beside the line.
    pub power_ratio: f64,
}

/// The spectrum, one entry per band.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SpectrumPart {
    /// Middle of the band, Hz.
    pub frequency_hz: Vec<f64>,
    /// Amplitude density, enT/√Hz.
    pub x_ent_per_root_hz: Vec<f64>,
    /// Amplitude density, enT/√Hz.
    pub y_ent_per_root_hz: Vec<f64>,
    /// Amplitude density, enT/√Hz.
    pub z_ent_per_root_hz: Vec<f64>,
    /// Lower limit of 95 % over the value.
    pub low_factor: Vec<f64>,
    /// Upper limit of 95 % over the value.
    pub high_factor: Vec<f64>,
    /// Degrees of freedom.
    pub degrees_of_freedom: Vec<f64>,
}

/// The Allan deviation, one entry per averaging time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AllanPart {
    /// Averaging time, s.
    pub tau_s: Vec<f64>,
    /// Deviation, enT.
    pub x_ent: Vec<f64>,
    /// Deviation, enT.
    pub y_ent: Vec<f64>,
    /// Deviation, enT.
    pub z_ent: Vec<f64>,
    /// Lower limit of 95 % over the value.
    pub low_factor: Vec<f64>,
    /// Upper limit of 95 % over the value.
    pub high_factor: Vec<f64>,
    /// Degrees of freedom.
    pub degrees_of_freedom: Vec<f64>,
}

/// The offset against one slow channel.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChannelPart {
    /// Name of the channel.
    pub name: String,
    /// Its unit, `K` or `nT` for example.
    pub unit: String,
    /// Largest minus smallest mean of the channel.
    pub range: f64,
    /// enT per unit of the channel.
    pub coefficient_ent: [f64; 3],
    /// Its standard uncertainty.
    pub coefficient_std_ent: [f64; 3],
    /// Correlation of the means.
    pub correlation: [f64; 3],
}

/// The offset against several channels at once.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TogetherPart {
    /// Names of the channels.
    pub channels: Vec<String>,
    /// enT per unit of each channel.
    pub coefficient_ent: Vec<[f64; 3]>,
    /// Their standard uncertainties.
    pub coefficient_std_ent: Vec<[f64; 3]>,
    /// Standard deviation of the means about the fit, enT.
    pub residual_std_ent: [f64; 3],
}

/// Where the data stop.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StopPart {
    /// What happened.
    pub what: String,
    /// Begin, s since the run's start.
    pub from_s: f64,
    /// End, s since the run's start.
    pub until_s: f64,
}
