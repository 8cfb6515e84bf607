//! What the resolution of the readings does to amplitudes.
//!
//! Noise of more than half a step makes the mean of rounded readings that of the field. With less, rounding leaves an error that depends on the
//! reading alone, `(q/π) Σ (-1)^k/k · exp(-2π²k²σ²/q²) · sin(2πky/q)`. Where the samples meet the sine again and again at the same few phases, it
//! is the same every time: no length of a setting makes it smaller, and its harmonics fall upon the sine itself, where no noise beside it tells.

use crate::fit::sine::{self, Sine};
use crate::fit::statistics::median;
use std::f64::consts::{PI, TAU};

/// Readings of a setting from which the resolution is taken.
const MOST_READINGS: usize = 4096;
/// Distances of neighbouring readings, in steps, that have to be multiples of the step, and how nearly.
const NEAR_STEPS: f64 = 6.0;
const NEARLY: f64 = 0.1;
/// Share of these, and their least number, with which readings have a resolution.
const LEAST_SHARE: f64 = 0.9;
const LEAST_DISTANCES: usize = 5;
/// How often values come again in the mean where a few have a step.
const COMMON: usize = 20;
/// A distance below this part of the largest reading is rounding of the arithmetic, in single precision it may be.
const ARITHMETIC: f64 = 1e-7;
/// Terms of the error of a rounded reading; those left out are below 2 % of its variance without noise.
const TERMS: i32 = 30;
/// Rounding errors that are told apart at most.
const MOST_ERRORS: f64 = 1e5;
/// Classes of phases within which a reading changes by less than a step, and the share of readings that have to be at phases that were there
/// before.
const CLASSES: usize = 10;
const LEAST_AGAIN: f64 = 0.5;
/// Noise, in steps, that averages every error, and cuts of the range up to there.
const MOST_NOISE: f64 = 2.0;
const HALVINGS: usize = 40;

/// The step of readings that are rounded, from all settings of a run; `None` where they show none. A few values that come again and again have one,
/// however few; one that came once only, where values come again, is left out: a spike is on no step.
pub(super) fn resolution<'a>(settings: impl Iterator<Item = &'a [f64]>) -> Option<f64> {
    let mut readings: Vec<f64> = settings.flat_map(|readings| &readings[..readings.len().min(MOST_READINGS)]).copied().collect();
    readings.sort_by(f64::total_cmp);
    let least = ARITHMETIC * readings.last()?.abs().max(readings[0].abs());
    let values: Vec<&[f64]> = readings.chunk_by(|one, next| next - one <= least).collect();
    let come_again = readings.len() >= COMMON * values.len();
    let values: Vec<f64> = values.iter().filter(|same| !come_again || same.len() > 1).map(|same| same[0]).collect();
    let distances: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
    let step = distances.iter().copied().min_by(f64::total_cmp)?;
    let near: Vec<f64> = distances.iter().map(|distance| distance / step).filter(|steps| *steps < NEAR_STEPS).collect();
    let whole = near.iter().filter(|steps| (*steps - steps.round()).abs() < NEARLY).count();
    ((come_again || near.len() >= LEAST_DISTANCES) && whole as f64 >= LEAST_SHARE * near.len() as f64).then_some(step)
}

/// A sine of a setting with what it was fitted to.
pub(super) struct Rounded<'a> {
    pub n: &'a [u64],
    pub frequency_hz: f64,
    pub rate_hz: f64,
    pub sine: &'a Sine,
}

/// Standard deviations of the amplitudes of the sines of a run by the rounding of their readings; zero where there is no sine.
pub(super) fn amplitude_stds(step: f64, sines: &[Option<Rounded>]) -> Vec<f64> {
    // With as much noise rounding errors average.
    if sines.iter().flatten().all(|one| one.sine.residual_std > step) {
        return vec![0.0; sines.len()];
    }
    let met: Vec<Option<Met>> = sines.iter().map(|one| Some(Met::of(step, one.as_ref()?))).collect();
    let noise = noise_steps(step, &met);
    met.iter().map(|met| met.map_or(0.0, |met| step * error_std(noise) * (2.0 / met.errors as f64).sqrt())).collect()
}

/// The phases of a sine at which it is read.
#[derive(Clone, Copy, Debug)]
struct Met {
    /// Rounding errors that are met: readings less than a step apart have the same.
    errors: usize,
    /// Variance of the readings about the sine.
    variance: f64,
    /// Variance of the readings at the same phase, where phases come again.
    within: Option<f64>,
}

impl Met {
    fn of(step: f64, rounded: &Rounded) -> Self {
        let Rounded { n, frequency_hz, rate_hz, sine } = *rounded;
        let Sine { amplitude, residual_std, ref residuals, .. } = *sine;
        let errors = (TAU * amplitude / step).ceil().clamp(1.0, MOST_ERRORS) as usize;
        let classes = errors * CLASSES;
        let mut sums = vec![(0_u32, 0.0, 0.0); classes];
        for (n, residual) in n.iter().zip(residuals) {
            let cycle = sine::phase(frequency_hz, rate_hz, *n) / TAU;
            let place = ((cycle - cycle.floor()) * classes as f64) as usize;
            let (count, sum, square) = &mut sums[place.min(classes - 1)];
            (*count, *sum, *square) = (*count + 1, *sum + residual, *square + residual * residual);
        }
        let met = sums.iter().filter(|(count, ..)| *count > 0);
        let dof: f64 = met.clone().map(|(count, ..)| f64::from(count - 1)).sum();
        let squares: f64 = met.map(|(count, sum, square)| (square - sum * sum / f64::from(*count)).max(0.0)).sum();
        Self {
            errors: sums.chunks(CLASSES).filter(|classes| classes.iter().any(|(count, ..)| *count > 0)).count().max(1),
            variance: residual_std * residual_std,
            within: (dof >= LEAST_AGAIN * residuals.len() as f64).then(|| squares / dof),
        }
    }

    /// How much more the readings scatter, in units of the square of a step, than after noise of a standard deviation in steps. A reading about
    /// which rounding errors are as good as drawn scatters by a twelfth more than before; at one phase the part of the error that is always
    /// the same does not show, and a sine with its offset takes three errors with it.
    fn excess(&self, step: f64, noise: f64) -> f64 {
        let drawn = noise * noise + 1.0 / 12.0;
        match self.within {
            Some(within) => within / (step * step) - (drawn - error_std(noise).powi(2)),
            None => self.variance / (step * step) - (drawn - (3.0 / self.errors as f64).min(1.0) / 12.0),
        }
    }
}

/// Standard deviation of readings before they were rounded, in steps: the median of the settings. In one alone it would be large where its errors
/// happen to be, or a drift.
fn noise_steps(step: f64, settings: &[Option<Met>]) -> f64 {
    let of_setting = |met: &Met| {
        let (mut low, mut high) = (0.0, MOST_NOISE);
        for _ in 0..HALVINGS {
            let middle = 0.5 * (low + high);
            if met.excess(step, middle) > 0.0 { low = middle } else { high = middle }
        }
        low
    };
    median(&mut settings.iter().flatten().map(of_setting).collect::<Vec<f64>>())
}

/// Standard deviation of the error of readings that are rounded to a step, over all that are rounded alike.
pub(super) fn uniform_std(step: f64) -> f64 {
    step / 12.0_f64.sqrt()
}

/// Standard deviation of the error of a rounded reading over all readings, in steps, that noise of a standard deviation in steps does not average.
fn error_std(noise: f64) -> f64 {
    let term = |k: i32| ((-2.0 * (PI * f64::from(k) * noise).powi(2)).exp() / (PI * f64::from(k))).powi(2);
    (0.5 * (1..=TERMS).map(term).sum::<f64>()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    #[test]
    fn the_error_of_a_rounded_reading_is_uniform_without_noise_and_none_with_much() {
        assert!((error_std(0.0) * 12.0_f64.sqrt() - 1.0).abs() < 0.02);
        // The fundamental alone: (1/π√2) exp(-2π²/4).
        assert!((error_std(0.5) - 0.001_618_9).abs() < 1e-6, "{}", error_std(0.5));
        assert!(error_std(1.0) < 1e-9);
    }

    #[test]
    fn readings_have_a_resolution_if_they_are_rounded() {
        let mut random = Random::seeded(4);
        let free: Vec<f64> = (0..3000).map(|i| 500.0 * (0.37 * f64::from(i)).sin() + random.gaussian()).collect();
        assert_eq!(resolution([free.as_slice()].into_iter()), None);
        // Also where two decimals are written of a step that has more.
        for (step, decimals) in [(0.1, 1e6), (10.0, 1e6), (1.0 / 3.0, 100.0)] {
            let rounded: Vec<f64> = free.iter().map(|y| ((y / step).round() * step * decimals).round() / decimals).collect();
            let found = resolution([&rounded[..1000], &rounded[1000..]].into_iter()).expect("a step");
            assert!((found / step - 1.0).abs() < 0.02, "{step} {found}");
        }
        // Sines without noise at few phases are no multiples of anything.
        let few: Vec<f64> = (0..3000).map(|i| 500.0 * (TAU * f64::from(i) / 8.0 + 0.3).sin()).collect();
        assert_eq!(resolution([few.as_slice()].into_iter()), None);
        assert_eq!(resolution([[0.0; 0].as_slice()].into_iter()), None);
        // Single precision, and a spike.
        let rounded = |y: f64| (1.0 + 6e-8 * (y * 1e7).sin()) * y.round();
        let single: Vec<f64> = (0..50_000).map(|i| rounded(500.0 * (0.37 * f64::from(i)).sin())).chain([100.3]).collect();
        let found = resolution(single.chunks(4000)).expect("a step");
        assert!((found - 1.0).abs() < 1e-3, "{found}");
        // Three values that come again and again.
        let small: Vec<f64> = free.iter().map(|y| 8.0 * (y / 400.0).round()).collect();
        assert_eq!(resolution([small.as_slice()].into_iter()), Some(8.0));
    }

    #[test]
    fn amplitudes_of_rounded_readings_hold_their_standard_deviations() {
        const RATE: f64 = 128.0;
        const SETTINGS: usize = 10;
        let n: Vec<u64> = (0..2000).collect();
        // Frequencies that meet 8, 16, 32 and 64 phases, and those whose phases drift through all.
        let few = [16.0, 8.0, 12.0, 6.0].into_iter().flat_map(|f| [0.02, 0.1, 0.2, 0.3, 0.45].map(|noise| (f, noise, true)));
        for (frequency, noise, is_few) in few.chain([(7.123, 0.05, false), (16.01, 0.05, false)]) {
            let mut random = Random::seeded(1);
            let (mut with, mut without) = (Vec::new(), Vec::new());
            for _ in 0..20 {
                let fits: Vec<(f64, Sine)> = (0..SETTINGS)
                    .map(|setting| {
                        let (amplitude, phase, offset) =
                            (30.0 + 40.0 * random.uniform(), TAU * random.uniform(), random.uniform());
                        // One of the settings drifts by twenty steps, which is not the noise of the others.
                        let drift = if setting == 0 { 0.01 } else { 0.0 };
                        let field =
                            |n: &u64| amplitude * (sine::phase(frequency, RATE, *n) + phase).sin() + offset + drift * *n as f64;
                        let readings: Vec<f64> = n.iter().map(|n| (field(n) + noise * random.gaussian()).round()).collect();
                        (amplitude, sine::three(&n, &readings, frequency, RATE).expect("a sine"))
                    })
                    .collect();
                let rounded = |sine| Some(Rounded { n: &n, frequency_hz: frequency, rate_hz: RATE, sine });
                let sines: Vec<Option<Rounded>> = fits.iter().map(|(_, sine)| rounded(sine)).collect();
                for ((amplitude, fit), rounded) in fits.iter().zip(amplitude_stds(1.0, &sines)).skip(1) {
                    with.push((fit.amplitude - amplitude) / rounded.hypot(fit.amplitude_std));
                    without.push((fit.amplitude - amplitude) / fit.amplitude_std);
                }
            }
            let rms = |pulls: &[f64]| (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
            let [with, without] = [rms(&with), rms(&without)];
            // Of 180 values an rms is known to 5 %. Phases that drift through all have errors that partly cancel.
            assert!(with < 1.15 && with > if is_few { 0.85 } else { 0.6 }, "{frequency} {noise}: {with} {without}");
            assert!(noise > 0.15 || !is_few || without > 3.0, "{frequency} {noise}: {without}");
        }
    }
}
