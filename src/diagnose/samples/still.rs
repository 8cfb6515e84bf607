//! Components of a record in zero field that stand still for a while: a converter that hangs, which no effect is.

use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::diagnose::result::{Left, LeftLike};
use crate::fit::statistics::{median, robust_std};
use crate::record::prepared::{PreparedRun, Samples};

/// Equal readings one after the other are no chance from so many on, and from so many times the length that all but one in a thousand of such
/// stretches have.
const FEWEST: usize = 20;
const LONGER: usize = 8;
const USUAL: f64 = 0.999;

/// A component that stands still.
pub(in crate::diagnose) struct Still {
    /// Component.
    pub axis: usize,
    /// First and last time, s since the run's start.
    span_s: [f64; 2],
    /// How far its reading is from the usual one, and the standard deviation of its readings, enT.
    off_ent: f64,
    std_ent: f64,
}

impl Still {
    /// The warning about it.
    pub fn note(&self) -> Note {
        let name = COMPONENTS[self.axis];
        let text = format!("component {name} is stuck {}", self.time());
        Note::new(NoteKind::Stuck, text).about(name).with_remedy("leave this part out with --exclude, and diagnose again")
    }

    /// The same as what is left.
    pub fn left(&self, prepared: &PreparedRun) -> Left {
        Left {
            place: format!("{}, {}", COMPONENTS[self.axis], self.time()),
            rms_nt: self.off_ent * prepared.nt_per_ent[self.axis],
            times_noise: self.off_ent / self.std_ent.max(f64::MIN_POSITIVE),
            like: LeftLike::Still,
        }
    }

    fn time(&self) -> String {
        format!("from {:.1} to {:.1} s", self.span_s[0], self.span_s[1])
    }
}

/// The components that do.
pub(in crate::diagnose) fn still(samples: &Samples) -> Vec<Still> {
    let of_axis = |axis: usize| {
        let readings = || samples.reading_ent.iter().map(move |reading| reading[axis]);
        let [from, count] = longest(readings())?;
        let usual = median(&mut readings().collect::<Vec<f64>>());
        Some(Still {
            axis,
            span_s: [samples.t_s[from], samples.t_s[from + count - 1]],
            off_ent: (samples.reading_ent[from][axis] - usual).abs(),
            std_ent: robust_std(readings().map(|reading| reading - usual)),
        })
    };
    (0..3).filter_map(of_axis).collect()
}

/// First reading and number of the longest stretch of equal readings, if it is no chance.
fn longest(readings: impl Iterator<Item = f64>) -> Option<[usize; 2]> {
    let mut stretches: Vec<[usize; 2]> = Vec::new();
    let mut last = None;
    for (place, reading) in readings.enumerate() {
        match stretches.last_mut() {
            Some([_, count]) if last == Some(reading) => *count += 1,
            _ => stretches.push([place, 1]),
        }
        last = Some(reading);
    }
    let longest = *stretches.iter().max_by_key(|[_, count]| *count)?;
    let mut counts: Vec<usize> = stretches.into_iter().map(|[_, count]| count).collect();
    counts.sort_unstable();
    let usual = counts[(USUAL * (counts.len() - 1) as f64) as usize];
    (longest[1] >= FEWEST && longest[1] >= LONGER * usual).then_some(longest)
}

#[cfg(test)]
mod tests {
    use super::longest;
    use crate::fit::random::Random;

    #[test]
    fn a_component_that_hangs_is_found_and_coarse_readings_are_not() {
        let mut random = Random::seeded(5);
        for step in [0.001, 1.0, 4.0] {
            let mut readings: Vec<f64> = (0..4000).map(|_| (random.gaussian() / step).round() * step).collect();
            assert_eq!(longest(readings.iter().copied()), None, "{step}");
            let held = readings[1000];
            // Of readings that seldom change a hundred equal ones are no wonder.
            let count = if step < 2.0 { 300 } else { 3000 };
            readings[1000..1000 + count].fill(held);
            let found = longest(readings.iter().copied());
            assert!(found.is_some_and(|[from, n]| from <= 1000 && n >= count), "{step}: {found:?}");
        }
    }
}
