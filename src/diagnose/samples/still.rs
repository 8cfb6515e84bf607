//! Components of a record in zero field that stand still for a while: a converter that hangs, which no effect is.

use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::record::prepared::Samples;

/// Equal readings one after the other are no chance from so many on, and from so many times the length that all but one in a thousand of such
/// stretches have.
const FEWEST: usize = 20;
const LONGER: usize = 8;
const USUAL: f64 = 0.999;

/// Says where they do.
pub fn still(samples: &Samples) -> Vec<Note> {
    let of_axis = |axis: usize| {
        let [from, count] = longest(samples.reading_ent.iter().map(|reading| reading[axis]))?;
        let name = COMPONENTS[axis];
        let text = format!("component {name} is stuck from {:.1} to {:.1} s", samples.t_s[from], samples.t_s[from + count - 1]);
        Some(Note::new(NoteKind::Stuck, text).about(name).with_remedy("leave this part out with --exclude, and diagnose again"))
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
