//! Fields that follow readings of the housekeeping, currents mostly, in axes of the sensor: `B - v I(t)`.

use super::{Block, Step};
use crate::data::time::{SECOND_NS, Tt2000};
use nalgebra::Vector3;

/// One such field.
#[derive(Clone, Debug, PartialEq)]
pub struct DisturbanceStep {
    /// Times of the readings, rising.
    pub time: Vec<Tt2000>,
    /// Readings, in the unit of the column.
    pub reading: Vec<f64>,
    /// Readings further apart have a gap between them, in which the field is not known, ns.
    pub max_gap_ns: i64,
    /// nT per unit.
    pub vector_nt_per_unit: Vector3<f64>,
}

/// Readings of the housekeeping have no gap between them up to here, ns.
const LEAST_GAP_NS: i64 = 60 * SECOND_NS;

/// The longest time between readings that is no gap, ns: a minute as in other tables, or one and a half of their usual step if that is
/// longer. Times rise.
#[must_use]
pub fn max_gap_ns(time: &[Tt2000]) -> i64 {
    let mut steps: Vec<i64> = time.windows(2).map(|pair| pair[1] - pair[0]).collect();
    steps.sort_unstable();
    let usual = steps.get(steps.len() / 2).copied().unwrap_or(0);
    LEAST_GAP_NS.max(usual.saturating_add(usual / 2))
}

impl Step for DisturbanceStep {
    fn apply(&self, block: &mut Block) {
        let mut next = 0;
        for row in 0..block.len() {
            let time = block.time[row];
            while next < self.time.len() && self.time[next] <= time {
                next += 1;
            }
            // Between two readings on a straight line; nothing is known in a gap, before the first and behind the last one.
            let pair = next.checked_sub(1).zip(self.time.get(next));
            let Some((before, after)) = pair.filter(|(before, after)| *after - self.time[*before] <= self.max_gap_ns) else {
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_of_the_readings_is_not_bridged() {
        // A reading per second, and then one after ten minutes.
        let time: Vec<Tt2000> = [0, 1, 2, 3, 603].map(|s| s * SECOND_NS).to_vec();
        let max_gap_ns = max_gap_ns(&time);
        assert_eq!(max_gap_ns, 60 * SECOND_NS);
        let step = DisturbanceStep {
            reading: vec![1.0, 3.0, 3.0, 3.0, 3.0],
            time,
            max_gap_ns,
            vector_nt_per_unit: Vector3::new(1.0, 2.0, 0.0),
        };
        let mut block = Block {
            time: vec![SECOND_NS / 2, 300 * SECOND_NS],
            field: [vec![10.0; 2], vec![10.0; 2], vec![10.0; 2]],
            flags: vec![0; 2],
            ..Block::default()
        };
        step.apply(&mut block);
        assert_eq!(block.vector(0), Vector3::new(8.0, 6.0, 10.0));
        assert!(block.vector(1).x.is_nan());
        assert_eq!(block.flags, [0, crate::data::flags::Flags::TIME.0]);
        // Slow housekeeping has its own step.
        assert_eq!(super::max_gap_ns(&[0, 100 * SECOND_NS, 200 * SECOND_NS]), 150 * SECOND_NS);
        assert_eq!(super::max_gap_ns(&[]), 60 * SECOND_NS);
    }
}
