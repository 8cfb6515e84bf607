//! The parts of a run in zero field: drift, noise and what the offset follows.
//!
//! The result of the analysis and its parameter file both hold them, so that each is defined here only.

use super::result::RunHead;
use serde::{Deserialize, Serialize};

/// What a zero-field run says of its sensor. Values that are not determined are nan.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ZeroFieldFound {
    /// Run and conditions.
    pub run: RunHead,
    /// The record.
    pub record: RecordExtent,
    /// Offset and drift.
    pub offset: ZeroFieldOffset,
    /// Amplitude density at 1 Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub density: Option<NoiseDensity>,
    /// Reading, drift and density in nT with the sensitivity of a linear calibration.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled: Option<ScaledZeroField>,
    /// White and 1/f noise.
    pub corner: NoiseCorner,
    /// The spectrum.
    pub spectrum: NoiseSpectrum,
    /// The Allan deviation.
    pub allan: AllanDeviations,
    /// Lines in the spectrum.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub line: Vec<SpectralLine>,
    /// The offset against each slow channel.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub channel: Vec<ChannelDependence>,
    /// The offset against sensor temperature and variometer at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<JointDependence>,
    /// Where the data stop.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub stop: Vec<DataStop>,
}

/// The record.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RecordExtent {
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
pub struct ZeroFieldOffset {
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
    /// For which noise the uncertainties hold, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_covers: Option<String>,
}

/// What a zero-field run shows, in nT.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaledZeroField {
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
pub struct NoiseDensity {
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
pub struct NoiseCorner {
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
pub struct SpectralLine {
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
pub struct NoiseSpectrum {
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
pub struct AllanDeviations {
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
pub struct ChannelDependence {
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
pub struct JointDependence {
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
pub struct DataStop {
    /// What happened.
    pub what: String,
    /// Begin, s since the run's start.
    pub from_s: f64,
    /// End, s since the run's start.
    pub until_s: f64,
}
