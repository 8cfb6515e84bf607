//! Why a run has no offsets, and what to do about it.

use crate::data::calibration::OfAnotherSensor;
use crate::data::run::Kind;
use crate::fit::FitError;
use crate::model::facility::FacilityError;
use crate::record::position::PositionError;
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
    /// A position without axes.
    #[error(transparent)]
    Position(#[from] PositionError),
    /// Step edges elsewhere.
    #[error("the data do not step where the settings do: the edges are displaced by about {shift_s:+.2} s, or by whole settings")]
    Edges {
        /// Displacement, s.
        shift_s: f64,
    },
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
    /// A component with one constant reading.
    #[error("component {component} is stuck at {reading_ent} enT")]
    Stuck {
        /// Component.
        component: &'static str,
        /// Reading, enT.
        reading_ent: f64,
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
            OffsetError::Kind(_) => "use the command for that kind",
            OffsetError::Sensitivities(_) => OfAnotherSensor::REMEDY,
            OffsetError::NoPlateaus => "check the file with `calfit check`",
            OffsetError::Position(error) => error.remedy(),
            OffsetError::Edges { .. } => {
                "correct the times of the settings or take those of this run, or go on with --allow mismatch"
            }
            OffsetError::NothingUsable { .. } => {
                "hold the fields longer, or say with --settling and --coverage what can be accepted"
            }
            OffsetError::Response { .. } => {
                "check the position table, the wiring and the settings, or go on with --allow mismatch"
            }
            OffsetError::Stuck { .. } => "check the component and its wiring",
            OffsetError::NoPairs(_) => "measure every component in a normal and a turned position",
            OffsetError::Facility(error) => error.remedy(),
            OffsetError::Fit(_) => "check the plateaus of the run",
        }
    }
}
