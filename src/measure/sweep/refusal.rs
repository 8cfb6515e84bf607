//! Why a sweep has no result, and what to do about it.

use crate::data::run::Kind;
use crate::fit::FitError;
use crate::measure::joint::JointError;
use crate::model::facility::FacilityError;
use crate::record::position::PositionError;
use crate::record::screens::Implausible;
use thiserror::Error;

/// A thermistor must move by this much to tell anything, K.
pub(super) const LEAST_RANGE_K: f64 = 5.0;

/// Why a sweep has no result.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SweepError {
    /// Not a sweep.
    #[error("the run is of kind {0}, not sweep")]
    Kind(Kind),
    /// Several positions or one without axes.
    #[error(transparent)]
    Position(#[from] PositionError),
    /// A facility that cannot turn the settings into fields.
    #[error(transparent)]
    Facility(#[from] FacilityError),
    /// Readings that cannot be right.
    #[error(transparent)]
    Implausible(#[from] Implausible),
    /// No thermistor moves.
    #[error("no temperature channel moves by {LEAST_RANGE_K} K during the settings")]
    NoTemperature,
    /// Too few settings.
    #[error("{used} usable settings of {total} cannot determine {parameters} parameters per component")]
    TooFew {
        /// Usable settings.
        used: usize,
        /// All settings.
        total: usize,
        /// Parameters.
        parameters: usize,
    },
    /// The fit has no answer.
    #[error("the fit failed: {0}")]
    Fit(#[from] FitError),
    /// The fit of the polynomials has no answer.
    #[error("the fit of the polynomials failed: {0}")]
    Joint(#[from] JointError),
    /// The response is none of a sensor.
    #[error("the response at {degc:.1} °C belongs to no sensor with three axes")]
    NoSensor {
        /// Temperature, °C.
        degc: f64,
    },
}

impl SweepError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            SweepError::Kind(kind) => kind.command(),
            SweepError::Position(_) => "sweep in one position, and name its axes in campaign.toml",
            SweepError::Facility(error) => error.remedy(),
            SweepError::Implausible(error) => error.remedy(),
            SweepError::NoTemperature => "check the temperature channels of the run",
            SweepError::TooFew { .. } => "sweep longer, with lower orders or within the limits of campaign.toml",
            SweepError::Fit(_) | SweepError::Joint(_) | SweepError::NoSensor { .. } => {
                "check the directions of the fields and the readings"
            }
        }
    }
}
