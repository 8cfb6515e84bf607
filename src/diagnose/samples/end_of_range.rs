//! Components that rest at an end of their range: what they would have read there is not known, and beside a saturation no effect makes it.

use super::{level, of_settings};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::units::{COMPONENTS, counted};
use crate::fit::statistics::extremes;
use crate::record::prepared::Samples;
use rayon::prelude::*;

/// The end of a range lies so many standard deviations of a sample beyond the levels of all settings, and is read in so many of them: a spike is read
/// once.
const FAR: f64 = 50.0;
const FEWEST_SETTINGS: usize = 3;
/// Where the level of a setting is at the end of the range, so many of its samples are, so many times as many as at the reading next to it, and the
/// others have so many readings: of noise the farthest reading is the rarest, and coarse readings are few.
const FEWEST: usize = 8;
const TIMES: usize = 3;
const READINGS: usize = 5;

/// A component that rests there.
pub(in crate::diagnose) struct AtEnd {
    /// Component.
    pub axis: usize,
    /// The end of its range, enT.
    reading_ent: f64,
    /// Settings in which it does.
    settings: usize,
}

impl AtEnd {
    /// The warning about it.
    pub fn note(&self) -> Note {
        let name = COMPONENTS[self.axis];
        let text = format!(
            "component {name} rests at {:.1} enT, the end of its range, in samples of {}: what it would have read is not known, and what changes with time is \
             no certain effect beside it",
            self.reading_ent,
            counted(self.settings as u64, "setting")
        );
        Note::new(NoteKind::Data, text)
            .about(name)
            .with_remedy("leave these samples out with --settling or --exclude, and diagnose again")
    }
}

/// The components that do, one entry for each end; beside the noise of a sample of each, enT.
pub(in crate::diagnose) fn at_end(samples: &Samples, plateaus: &Plateaus, noise_ent: [f64; 3]) -> Vec<AtEnd> {
    let mut settings = of_settings(samples, plateaus);
    settings.retain(|(plateau, [from, to])| plateau.dropped.is_none() && from < to);
    let levels: Vec<[f64; 3]> = settings.iter().filter_map(|(_, window)| level(samples, *window, [1, 3])).collect();
    let of_axis = |axis: usize| {
        let mut all = Vec::new();
        let readings = |(_, [from, to]): &(&Plateau, [usize; 2])| -> Vec<f64> {
            samples.reading_ent[*from..*to].iter().map(|reading| reading[axis]).collect()
        };
        let each: Vec<Vec<f64>> = settings.iter().map(readings).collect();
        let usual = extremes(levels.iter().map(|level| level[axis]));
        let ends = extremes(each.iter().flatten().copied());
        for (end, usual) in ends.into_iter().zip(usual) {
            // Without noise every reading is a level.
            let is_far = noise_ent[axis] > 0.0 && (end - usual).abs() > FAR * noise_ent[axis];
            let rests = |own: &&Vec<f64>| if is_far { own.contains(&end) } else { is_cut(own, end) };
            let count = each.iter().filter(rests).count();
            let least = if is_far { FEWEST_SETTINGS } else { 1 };
            if count >= least {
                all.push(AtEnd { axis, reading_ent: end, settings: count });
            }
        }
        all
    };
    (0..3).into_par_iter().flat_map_iter(of_axis).collect()
}

/// Whether the readings of a setting are cut off at a reading.
fn is_cut(own: &[f64], end: f64) -> bool {
    if own.iter().filter(|reading| **reading == end).count() < FEWEST {
        return false;
    }
    let mut off: Vec<f64> = own.iter().map(|reading| (reading - end).abs()).collect();
    off.sort_by(f64::total_cmp);
    let mut groups = off.chunk_by(|a, b| a == b).map(<[f64]>::len);
    let (at_end, next) = (groups.next().unwrap_or(0), groups.next().unwrap_or(0));
    at_end >= FEWEST && at_end >= TIMES * next.max(1) && groups.count() + 1 >= READINGS
}

#[cfg(test)]
mod tests {
    use super::is_cut;
    use crate::fit::random::Random;

    /// Noise of eleven steps of the converter that is cut off at half of its standard deviation above its level, which a third of it is above; the same
    /// noise whole; and readings of two or three steps, most of which are the largest one.
    #[test]
    fn what_is_cut_off_is_seen_and_coarse_readings_are_not() {
        let mut random = Random::seeded(3);
        for _ in 0..200 {
            let whole: Vec<f64> = (0..192).map(|_| 1500.0 + (11.0 * random.gaussian()).round() / 32.0).collect();
            let most = whole.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            assert!(!is_cut(&whole, most));
            let end = 1500.0 + 5.0 / 32.0;
            let cut: Vec<f64> = whole.iter().map(|reading| reading.min(end)).collect();
            assert!(is_cut(&cut, end));
            let coarse: Vec<f64> = (0..192).map(|_| 4.0 * (0.4 + 0.3 * random.gaussian()).round().min(1.0)).collect();
            assert!(!is_cut(&coarse, 4.0) && !is_cut(&coarse, 0.0));
        }
    }
}
