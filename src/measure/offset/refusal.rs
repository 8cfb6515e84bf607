//! Why a run has no offsets, and what to do about it.

use crate::data::calibration::OfAnotherSensor;
use crate::data::run::Kind;
use crate::fit::FitError;
use crate::model::facility::FacilityError;
use crate::record::position::PositionError;
use crate::record::screens::Implausible;
use thiserror::Error;

/// Why a run has no offsets.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum OffsetError {
    /// Not an offset run.
    #[error("the run is of kind {0}, not offset")]
    Kind(Kind),
    /// Sensitivities of another sensor or mode.
    #[error(transparent)]
    Sensitivities(#[from] OfAnotherSensor),
    /// Nothing to fit.
    #[error("the run has no plateaus: neither @BLOCKS nor @FIELDS with @VECTORS")]
    NoPlateaus,
    /// Settings without a sample.
    #[error(
        "none of the {total} plateaus of the run is usable: there are no settled samples in them, since @VECTORS is missing or has no rows"
    )]
    NoSamples {
        /// Plateaus in the run.
        total: usize,
    },
    /// A position without axes.
    #[error(transparent)]
    Position(#[from] PositionError),
    /// Readings that cannot be right.
    #[error(transparent)]
    Implausible(#[from] Implausible),
    /// Every plateau was dropped.
    #[error("none of the {total} plateaus can be used: {reason}")]
    NothingUsable {
        /// Plateaus in the run.
        total: usize,
        /// The reason of the first.
        reason: String,
    },
    /// Readings that do not follow the applied fields.
    #[error(
        "in position {position} component {component} responds with {response:.3} enT/nT to the {axis} field, not with about +1"
    )]
    Response {
        /// Position.
        position: u32,
        /// Component.
        component: &'static str,
        /// Coil axis with the sign with which the component looks along it.
        axis: String,
        /// Response along that direction.
        response: f64,
    },
    /// The positions determine no component.
    #[error("no component has an offset: {0}")]
    NoPairs(String),
    /// A facility that cannot turn the settings into fields.
    #[error(transparent)]
    Facility(#[from] FacilityError),
    /// Another failure of the fit.
    #[error("the fit failed: {0}")]
    Fit(#[from] FitError),
}

impl OffsetError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            OffsetError::Kind(kind) => kind.command(),
            OffsetError::Sensitivities(_) => OfAnotherSensor::REMEDY,
            OffsetError::NoPlateaus => "check the file with `calfit check`",
            OffsetError::NoSamples { .. } => "take the file again with its samples, or give the means of the settings in @BLOCKS",
            OffsetError::Position(error) => error.remedy(),
            OffsetError::Implausible(error) => error.remedy(),
            OffsetError::NothingUsable { .. } => {
                "hold the fields longer, or say with --settling and --coverage what can be accepted"
            }
            OffsetError::Response { .. } => {
                "check the position table, the wiring and the settings, or go on with --allow mismatch"
            }
            OffsetError::NoPairs(_) => "measure every component in a normal and a turned position",
            OffsetError::Facility(error) => error.remedy(),
            OffsetError::Fit(_) => "check the plateaus of the run",
        }
    }
}
