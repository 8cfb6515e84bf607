//! The position of a run, and the limits of the field along the nominal sensor axes in it.

use crate::data::plateau::{Drop, Plateau, Plateaus};
use crate::model::campaign::Instructions;
use crate::model::position::Position;
use thiserror::Error;

/// Why a run has no position for all of its settings.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
pub enum PositionError {
    /// Several positions in one run.
    #[error("the run holds settings in positions {0}; a linear calibration needs one position")]
    Several(String),
    /// A position without axes.
    #[error("position {0} is not in the position table")]
    Unknown(u32),
}

impl PositionError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            PositionError::Several(_) => "split the run",
            PositionError::Unknown(_) => "add [[position]] with this id and its axes to campaign.toml",
        }
    }
}

/// The one position of all settings, with its id.
///
/// # Errors
/// Several positions, or one without axes.
pub fn the_position(plateaus: &Plateaus, instructions: &Instructions) -> Result<(u32, Position), PositionError> {
    match plateaus.positions().as_slice() {
        [id] => Ok((*id, position(*id, instructions)?)),
        several => Err(PositionError::Several(several.iter().map(u32::to_string).collect::<Vec<_>>().join(", "))),
    }
}

/// The position with this id.
///
/// # Errors
/// The campaign does not tell its axes.
pub fn position(id: u32, instructions: &Instructions) -> Result<Position, PositionError> {
    instructions.position(id).ok_or(PositionError::Unknown(id))
}

/// Drops plateaus whose field along a nominal sensor axis is beyond a limit.
pub fn apply_limits(list: &mut [Plateau], position: Position, limits_nt: &[Option<f64>; 3]) {
    for plateau in list.iter_mut().filter(|p| p.dropped.is_none()) {
        let along = position.to_nominal(plateau.setting.field.0);
        plateau.dropped = (0..3).find_map(|component| {
            let limit_nt = limits_nt[component]?;
            (along[component].abs() > limit_nt).then_some(Drop::FieldLimit { component, limit_nt })
        });
    }
}
