//! Why a zero-field run has no result, and what to do about it.

use crate::data::calibration::OfAnotherSensor;
use crate::data::run::Kind;
use crate::fit::FitError;
use thiserror::Error;

/// Fewer samples are no record of noise.
pub const LEAST_SAMPLES: u64 = 1024;

/// Why a run has no result.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum NullError {
    /// Another kind of run.
    #[error("the run is of kind {0}, not zero-field")]
    Kind(Kind),
    /// Sensitivities of another sensor or mode.
    #[error(transparent)]
    Sensitivities(#[from] OfAnotherSensor),
    /// A field is applied.
    #[error("setting {0} applies a field, or a sine")]
    Field(usize),
    /// The sensor was turned.
    #[error("the run holds more than one position, so its offset is not one quantity")]
    Positions,
    /// Too short.
    #[error("the run holds {0} samples; noise and drift need {LEAST_SAMPLES} at least")]
    TooShort(u64),
    /// A fit has no answer.
    #[error("the drift cannot be fitted: {0}")]
    Fit(#[from] FitError),
}

impl NullError {
    /// What to do.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            NullError::Kind(kind) => kind.command(),
            NullError::Sensitivities(_) => OfAnotherSensor::REMEDY,
            NullError::Field(_) => "correct `kind` in the head of the run, or use the command for such runs",
            NullError::Positions => "use `calfit offset`, or part the run",
            NullError::TooShort(_) => "record longer",
            NullError::Fit(_) => "choose a lower --order",
        }
    }
}
