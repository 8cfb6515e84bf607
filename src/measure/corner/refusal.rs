//! Why a component has no corner.

use crate::fit::FitError;
use serde::{Serialize, Serializer};

/// Why a component has no corner.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Refusal {
    /// No row is usable with a positive amplitude.
    #[error("no amplitude is positive")]
    NoAmplitude,
    /// The highest frequency is still above -3 dB.
    #[error("the amplitudes do not fall below -3 dB up to {highest_hz} Hz")]
    NoCrossing {
        /// The highest frequency, Hz.
        highest_hz: f64,
    },
    /// No response could be fitted to all components.
    #[error("no response fits: {why}")]
    NoModel {
        /// Why the first candidate failed.
        why: String,
    },
    /// Too few rows for an AICc.
    #[error("{rows} amplitudes are too few for {parameters} parameters")]
    TooFew {
        /// Amplitudes.
        rows: usize,
        /// Parameters with DC gain and scatter.
        parameters: usize,
    },
    /// The response makes outliers of too many rows.
    #[error("{outlying:.0} of {rows} amplitudes do not follow the response")]
    Outlying {
        /// Expected number of outliers.
        outlying: f64,
        /// Amplitudes.
        rows: usize,
    },
    /// The fitted response has its corner outside of the frequencies measured.
    #[error("the response has no -3 dB corner between the frequencies measured")]
    Outside,
    /// The fit has no answer.
    #[error(transparent)]
    Fit(#[from] FitError),
}

impl Serialize for Refusal {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(self)
    }
}
