//! Readings that stand on coarse steps: the means of plateaus keep a part of a step, which is the same in all settings of one field.
//!
//! Readings in steps of `q` whose noise before they are rounded is `σ` have a mean that is wrong by up to `q/π · exp(-2π² σ²/q²)`, the first
//! term of the Fourier series of the sawtooth that rounding is, averaged over the noise.

use super::windows_of;
use crate::data::note::{Note, NoteKind};
use crate::data::units::{COMPONENTS, three_digits};
use crate::fit::statistics::median;
use crate::record::prepared::Samples;
use rayon::prelude::*;
use std::f64::consts::PI;

/// What is kept of a step counts from this part of the noise of a mean on.
const COUNTS: f64 = 0.5;
/// Less than this part of the differences between samples are those of an edge.
const FEW: f64 = 0.05;

/// A component whose means keep a part of a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::diagnose) struct Coarse {
    /// The component.
    pub axis: usize,
    /// The step, enT.
    step_ent: f64,
    /// By how much means can be wrong, enT.
    kept_ent: f64,
}

impl Coarse {
    /// What is to be known of it.
    pub fn note(&self) -> Note {
        let name = COMPONENTS[self.axis];
        let [step, kept] = [self.step_ent, self.kept_ent].map(three_digits);
        let text = format!(
            "the readings of {name} stand in steps of {step} enT, in which their noise does not go around: means are wrong by up to {kept} enT, alike in \
             settings of one field; an unknown function of the modulus of the field is not looked for on {name}"
        );
        Note::new(NoteKind::Data, text).about(name).with_remedy("record with more digits")
    }
}

/// The value that so many others are less than or equal to; none if there are not so many. It reorders the values.
fn smallest(values: &mut [f64], place: f64) -> Option<f64> {
    let place = place as usize;
    (place < values.len()).then(|| *values.select_nth_unstable_by(place, f64::total_cmp).1)
}

/// Components of the samples, as they were recorded, that are coarse in some settings.
pub(in crate::diagnose) fn coarse(samples: &Samples, settings: &[[f64; 2]]) -> Vec<Coarse> {
    let windows: Vec<[usize; 2]> = windows_of(samples, settings, 0.0).into_iter().filter(|[from, to]| to > from).collect();
    let usual = median(&mut windows.iter().map(|[from, to]| (to - from) as f64).collect::<Vec<f64>>());
    let of_axis = |axis: usize| {
        let steps = || {
            let own = windows.iter().flat_map(|[from, to]| samples.reading_ent[*from..*to].windows(2));
            own.map(move |pair| (pair[1][axis] - pair[0][axis]).abs())
        };
        let mut all: Vec<f64> = steps().collect();
        let count = all.len() as f64;
        let equal = all.iter().filter(|step| **step == 0.0).count() as f64;
        // Samples behind a filter, at edges, stand between the steps; and an edge within a setting is no noise.
        let most = smallest(&mut all, (1.0 - 2.0 * FEW) * count)?;
        let step_ent = smallest(&mut all, equal + FEW * (count - equal))?;
        let kept: Vec<f64> = steps().filter(|step| *step <= most.max(step_ent)).collect();
        let variance = kept.iter().map(|step| step * step).sum::<f64>() / (2.0 * kept.len() as f64);
        let before = (variance - step_ent * step_ent / 12.0).max(0.0);
        let kept_ent = step_ent / PI * (-2.0 * PI * PI * before / (step_ent * step_ent)).exp();
        (kept_ent > COUNTS * (variance / usual).sqrt()).then_some(Coarse { axis, step_ent, kept_ent })
    };
    (0..3).into_par_iter().filter_map(of_axis).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    /// Ninety settings of 200 samples with a noise of 0.25 enT, in steps of 1 enT on x, of 0.01 enT on y and of 0.5 enT on z: only x is coarse, whose means
    /// are wrong by up to `exp(-2π²/16)/π = 0.093` enT; z keeps less than a tenth of the noise of a mean. One sample in 200 stands between the steps.
    #[test]
    fn steps_that_the_noise_does_not_fill_are_coarse() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let mut samples = Samples { n: Vec::new(), t_s: Vec::new(), reading_ent: Vec::new() };
        for k in 0..90 * 200_u64 {
            let level = 37.3 * (k / 200) as f64;
            let mut reading = [0.0; 3];
            for (value, step) in reading.iter_mut().zip([1.0, 0.01, 0.5]) {
                let noise: f64 = StandardNormal.sample(&mut random);
                // The first sample of a setting stands where a filter left it.
                let late = if k % 200 == 0 { -0.137 } else { 0.0 };
                *value = ((level + 0.25 * noise) / step).round() * step + late;
            }
            samples.n.push(k);
            samples.t_s.push(k as f64 * 0.05);
            samples.reading_ent.push(reading);
        }
        let settings: Vec<[f64; 2]> = (0..90).map(|k| [10.0 * f64::from(k), 10.0 * f64::from(k) + 9.99]).collect();
        let found = coarse(&samples, &settings);
        let [Coarse { axis: 0, step_ent, kept_ent }] = found[..] else { panic!("{found:?}") };
        assert_eq!(step_ent, 1.0);
        assert!((0.05..0.15).contains(&kept_ent), "{kept_ent}");
        assert!(found[0].note().text.contains("steps of 1.00 enT"));
    }
}
