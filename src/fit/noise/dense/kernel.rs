//! Slow noise as a sum of relaxations: time constants, parts, exact averages over intervals.

use crate::fit::FitError;

/// Nominal ratio of neighbouring time constants.
const TIME_STEP: f64 = 4.0;
/// Shortest time constant of noise seen inside the rows, as a part of the shortest contrast: faster noise is white there.
pub(super) const SHORTER: f64 = 8.0;
/// Nominal ratio of its neighbouring time constants.
const OCTAVE_STEP: f64 = 3.0;
/// Longest time constant as a part of the record: half way between the usual meanings of a cutoff at its inverse.
pub(super) const LONGER: f64 = 1.3;

/// Time constants of a 1/f noise from `shortest` to `longest` in equal ratios near `OCTAVE_STEP`.
pub(super) fn octave_constants(shortest: f64, longest: f64) -> Vec<f64> {
    let ratio = longest / shortest;
    let steps = (ratio.ln() / OCTAVE_STEP.ln()).round().max(1.0);
    (0..=steps as i32).map(|k| shortest * ratio.powf(f64::from(k) / steps)).collect()
}

/// Variance of the mean over an interval of noise of unit variance whose correlation decays with the time constant 1.
pub(super) fn mean_variance(length: f64) -> f64 {
    // The closed form loses all digits for short intervals.
    if length < 1e-4 { 1.0 - length / 3.0 } else { 2.0 * (length + (-length).exp_m1()) / (length * length) }
}

/// Mean over an interval of the decay from its beginning, time constant 1.
pub(super) fn mean_decay(length: f64) -> f64 {
    if length < 1e-8 { 1.0 } else { -(-length).exp_m1() / length }
}

/// Variance of the difference of the means over neighbouring intervals of one length, for noise of unit variance.
pub(super) fn contrast_variance(length: f64, time_constants: &[f64], parts: &[f64]) -> f64 {
    let one = |tau: &f64| 2.0 * (mean_variance(length / tau) - mean_decay(length / tau).powi(2));
    time_constants.iter().zip(parts).map(|(tau, part)| part * one(tau)).sum()
}

/// Mean over the intervals of the variance of their means, for noise of unit variance.
pub(super) fn mean_of_variances(intervals: &[[f64; 2]], time_constants: &[f64], parts: &[f64]) -> f64 {
    let of = |i: &[f64; 2]| -> f64 {
        time_constants.iter().zip(parts).map(|(tau, part)| part * mean_variance((i[1] - i[0]) / tau)).sum()
    };
    intervals.iter().map(of).sum::<f64>() / intervals.len() as f64
}

/// From the median positive spacing to the span in equal ratios near `TIME_STEP`, at least two.
pub(super) fn time_constants(times: &[f64]) -> Result<Vec<f64>, FitError> {
    let mut sorted = times.to_vec();
    sorted.sort_by(f64::total_cmp);
    let spacings = sorted.windows(2).map(|pair| pair[1] - pair[0]);
    let mut spacings: Vec<f64> = spacings.filter(|&spacing| spacing > 0.0).collect();
    spacings.sort_by(f64::total_cmp);
    let Some(&shortest) = spacings.get(spacings.len() / 2) else {
        let why = "all rows have the same time";
        return Err(FitError::NoNoise { why });
    };
    let ratio = (sorted[sorted.len() - 1] - sorted[0]) / shortest;
    let steps = (ratio.ln() / TIME_STEP.ln()).round().max(1.0);
    Ok((0..=steps as i32).map(|k| shortest * ratio.powf(f64::from(k) / steps)).collect())
}
