//! Fields that follow readings of the housekeeping, currents mostly, in axes of the sensor: `B - v I(t)`.

use super::{Block, Step};
use crate::data::time::Tt2000;
use nalgebra::Vector3;

/// One such field.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbanceStep {
    /// Times of the readings, rising.
    pub time: Vec<Tt2000>,
    /// Readings, in the unit of the column.
    pub reading: Vec<f64>,
    /// nT per unit.
    pub vector_nt_per_unit: Vector3<f64>,
}

impl Step for DisturbanceStep {
    fn apply(&self, block: &mut Block) {
        let mut next = 0;
        for row in 0..block.len() {
            let time = block.time[row];
            while next < self.time.len() && self.time[next] <= time {
                next += 1;
            }
            // Between two readings on a straight line; nothing is known before the first and behind the last one.
            let (Some(before), Some(after)) = (next.checked_sub(1), self.time.get(next)) else {
                block.take_away(row, crate::data::flags::Flags::TIME);
                continue;
            };
            #[expect(clippy::cast_precision_loss, reason = "differences of times")]
            let share = (time - self.time[before]) as f64 / (after - self.time[before]) as f64;
            let reading = self.reading[before] + share * (self.reading[next] - self.reading[before]);
            let vector = block.vector(row) - self.vector_nt_per_unit * reading;
            block.put(row, &vector);
        }
    }
}
