//! Fields that follow readings of the housekeeping, currents mostly, in axes of the sensor: `B - v I(t)`.

use super::{Block, Step};
use crate::data::time::{SECOND_NS, Tt2000};
use crate::model::field_calibration::SYMMETRIC;
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
    /// Standard uncertainty of a reading, in the unit of the column: the step of its converter. It is part of the covariance that vectors share, since
    /// a reading that changes slowly is off by the same for many of them.
    pub std_unit: f64,
}

/// Of fewer readings nothing is said.
const LEAST_READINGS: usize = 20;

impl DisturbanceStep {
    /// The reading that all times of a stretch have, if there are enough of them: a channel that stands tells nothing of what it should follow.
    #[must_use]
    pub fn standing(&self, span: &std::ops::Range<Tt2000>) -> Option<f64> {
        let rows = self.time.partition_point(|t| *t < span.start)..self.time.partition_point(|t| *t < span.end);
        let own = &self.reading[rows];
        own.first().copied().filter(|first| own.len() >= LEAST_READINGS && own.iter().all(|reading| reading == first))
    }
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
        let off_nt = self.vector_nt_per_unit * self.std_unit;
        #[expect(clippy::cast_possible_truncation, reason = "uncertainties need few digits")]
        let covariance = SYMMETRIC.map(|(i, k)| (off_nt[i] * off_nt[k]) as f32);
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
            if let Some(common) = block.common_nt2.get_mut(row) {
                common.iter_mut().zip(covariance).for_each(|(sum, own)| *sum += own);
            }
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
            std_unit: 0.5,
        };
        let mut block = Block {
            time: vec![SECOND_NS / 2, 300 * SECOND_NS],
            field: [vec![10.0; 2], vec![10.0; 2], vec![10.0; 2]],
            flags: vec![0; 2],
            common_nt2: vec![[1.0; 6]; 2],
            ..Block::default()
        };
        step.apply(&mut block);
        assert_eq!(block.vector(0), Vector3::new(8.0, 6.0, 10.0));
        assert!(block.vector(1).x.is_nan());
        // Half a unit is half a nT of x and one nT of y.
        assert_eq!(block.common_nt2[0], [1.25, 1.5, 1.0, 2.0, 1.0, 1.0]);
        assert_eq!(block.flags, [0, crate::data::flags::Flags::TIME.0]);
        // Slow housekeeping has its own step.
        assert_eq!(super::max_gap_ns(&[0, 100 * SECOND_NS, 200 * SECOND_NS]), 150 * SECOND_NS);
        assert_eq!(super::max_gap_ns(&[]), 60 * SECOND_NS);
    }

    #[test]
    fn readings_that_stand_are_told() {
        let step = |reading: Vec<f64>| DisturbanceStep {
            time: (0..reading.len() as i64).map(|k| k * SECOND_NS).collect(),
            reading,
            max_gap_ns: LEAST_GAP_NS,
            vector_nt_per_unit: Vector3::x(),
            std_unit: 0.0,
        };
        let mut reading = vec![17.0; 30];
        assert_eq!(step(reading.clone()).standing(&(0..30 * SECOND_NS)), Some(17.0));
        assert_eq!(step(reading.clone()).standing(&(0..19 * SECOND_NS)), None);
        reading[7] = 18.0;
        assert_eq!(step(reading.clone()).standing(&(0..30 * SECOND_NS)), None);
        assert_eq!(step(reading).standing(&(8 * SECOND_NS..30 * SECOND_NS)), Some(17.0));
    }
}
