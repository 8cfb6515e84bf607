//! From the sensor to the spacecraft, by the state of the boom (RO-IGEP-TR0028 section 4.3): `B_sc = R_uvw2sc B_uvw`.

use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::Tt2000;
use nalgebra::Matrix3;

/// Rotations by time, `[from, to)`.
#[derive(Clone, Debug, PartialEq)]
pub struct RotateStep {
    /// From, to, rotation.
    pub states: Vec<(Tt2000, Tt2000, Matrix3<f64>)>,
}

impl Step for RotateStep {
    fn apply(&self, block: &mut Block) {
        let mut last: Option<&(Tt2000, Tt2000, Matrix3<f64>)> = None;
        for row in 0..block.len() {
            let time = block.time[row];
            if !last.is_some_and(|(from, to, _)| (*from..*to).contains(&time)) {
                last = self.states.iter().find(|(from, to, _)| (*from..*to).contains(&time));
            }
            let Some((.., rotation)) = last else {
                block.take_away(row, Flags::ROTATION);
                continue;
            };
            let vector = rotation * block.vector(row);
            block.put(row, &vector);
            block.turn_covariances(row, rotation);
        }
    }
}
