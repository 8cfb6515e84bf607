//! Why a run has no frequency analysis.

use super::samples::{LEAST_SAMPLES, MOST_SAMPLES};
use crate::data::run::Kind;
use crate::record::screens::Implausible;
use thiserror::Error;

/// Why a run has no frequency analysis.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum FreqError {
    /// Not a frequency run.
    #[error("the run is of kind {0}, not frequency")]
    Kind(Kind),
    /// No sines.
    #[error("no setting is a sine: the frequencies in @FIELDS are all 0")]
    NoSines,
    /// No samples.
    #[error("no samples fall into the settings")]
    NoSamples,
    /// Settling leaves nothing.
    #[error("no setting has {LEAST_SAMPLES} samples after its settling")]
    Unsettled,
    /// More than fits into memory.
    #[error("the settings hold more than {MOST_SAMPLES} samples")]
    TooLong,
    /// Every frequency is refused.
    #[error("no frequency can be used; the first, {frequency_hz} Hz: {why}")]
    NothingUsable {
        /// Frequency, Hz.
        frequency_hz: f64,
        /// Why.
        why: String,
    },
    /// Settings of another run.
    #[error("{disturbed} of {total} settings hold no sine of their frequencies")]
    Mismatch {
        /// Settings that hold something else.
        disturbed: usize,
        /// Settings with a frequency.
        total: usize,
    },
    /// Readings that cannot be right.
    #[error(transparent)]
    Implausible(#[from] Implausible),
    /// No sampling frequency.
    #[error("component {component} has no sampling frequency: {why}")]
    NoRate {
        /// Component.
        component: &'static str,
        /// Why.
        why: String,
    },
}

impl FreqError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            FreqError::Kind(kind) => kind.command(),
            FreqError::NoSines => "check `kind` and the settings of the run",
            FreqError::NoSamples => "check the times of the settings; a table of amplitudes goes with --amplitudes",
            FreqError::Unsettled => "say with --settling how much time to leave out after a change of frequency",
            FreqError::TooLong => "split the run",
            FreqError::NothingUsable { .. } => "check the frequencies and times of the settings",
            FreqError::Mismatch { .. } => "check that settings and times are those of this run",
            FreqError::Implausible(error) => error.remedy(),
            FreqError::NoRate { .. } => "check the sample rate in the head of the file and the frequencies of the settings",
        }
    }
}
