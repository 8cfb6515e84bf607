//! A first guess of the class vectors from the steps of all intervals, before anything is known of states.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::edges::Evidence;

/// Squared distance from nothing, in standard deviations of a step, from which on a local maximum counts.
const LEAST_STEP: f64 = 16.0;
/// Variance of the step of an edge about its class vector, in units of that of a step.
const EDGE_WIDTH: f64 = 1.5;
/// Rounds of expectation and maximisation of a start and of the best of them.
const ROUNDS: [usize; 2] = [8, 30];
/// Steps that a start is tried on.
const TRIED: usize = 1200;
/// Starts per heater.
const STARTS: usize = 10;

/// A step of the field.
#[derive(Clone, Copy, Debug)]
pub(super) struct Step {
    /// Index of the interval.
    pub interval: usize,
    /// Field after minus field before.
    pub vector_nt: Vector3<f64>,
    /// Inverse covariance of it.
    pub precision: Matrix3<f64>,
}

/// The steps of an interval: where the innovations look most like an edge in the middle of a cell, and what its vector would be.
pub(super) fn steps(interval: usize, evidence: &Evidence) -> Vec<Step> {
    let innovations = evidence.background.innovations(evidence.increments);
    let half = evidence.profile.half_cells();
    let found: Vec<Option<(f64, Step)>> = (0..innovations.len())
        .map(|cell| {
            let (precision, right) = evidence.one_edge(cell as f64 - 0.5 + half, &innovations);
            let vector_nt = precision.try_inverse()? * right;
            Some((vector_nt.dot(&right), Step { interval, vector_nt, precision }))
        })
        .collect();
    let distance = |cell: usize| found[cell].map_or(f64::NEG_INFINITY, |(distance, _)| distance);
    let lag = (2.0 * half).ceil() as usize;
    let highest = |cell: usize| {
        let around = cell.saturating_sub(lag)..(cell + lag + 1).min(found.len());
        around.into_iter().all(|other| distance(other) <= distance(cell))
    };
    (0..found.len())
        .filter(|&cell| distance(cell) > LEAST_STEP && highest(cell))
        .filter_map(|cell| found[cell].map(|(_, step)| step))
        .collect()
}

/// What a step can be: each heater up, down or not, at most two of them at once. The first is none, noise that looks like a step.
fn kinds(heaters: usize) -> Vec<Vec<f64>> {
    let mut kinds = vec![vec![0.0; heaters]];
    for first in 0..heaters {
        for sign in [1.0, -1.0] {
            let mut one = vec![0.0; heaters];
            one[first] = sign;
            kinds.push(one.clone());
            for second in 0..first {
                for sign in [1.0, -1.0] {
                    let mut two = one.clone();
                    two[second] = sign;
                    kinds.push(two);
                }
            }
        }
    }
    kinds
}

/// A mixture of the kinds with shares of each interval: rounds of expectation and maximisation; gives the logarithm of the
/// likelihood.
fn settle(steps: &[Step], intervals: usize, vectors: &mut [Vector3<f64>], rounds: usize) -> f64 {
    let heaters = vectors.len();
    let kinds = kinds(heaters);
    let single = |kind: &[f64]| kind.iter().filter(|sign| **sign != 0.0).count() == 1;
    let first: Vec<f64> = kinds.iter().map(|kind| if single(kind) { 1.0 } else { 0.1 }).collect();
    let mut shares = vec![first.iter().map(|share| share / first.iter().sum::<f64>()).collect::<Vec<f64>>(); intervals];
    // Noise that passed as a step is wider than noise: its variance in units of that of a step, per interval.
    let mut widths = vec![9.0_f64; intervals];
    let mut likelihood = f64::NEG_INFINITY;
    for _ in 0..rounds {
        let mut noise = vec![[9.0, 1.0]; intervals];
        let mut counts = vec![vec![0.5; kinds.len()]; intervals];
        let mut normal = DMatrix::<f64>::zeros(3 * heaters, 3 * heaters);
        let mut right = DVector::<f64>::zeros(3 * heaters);
        likelihood = 0.0;
        for step in steps {
            let logs: Vec<f64> = kinds
                .iter()
                .zip(&shares[step.interval])
                .map(|(kind, share)| {
                    let left = kind.iter().zip(vectors.iter()).fold(step.vector_nt, |sum, (sign, vector)| sum - vector * *sign);
                    let distance = left.dot(&(step.precision * left));
                    // Edges are a little off in height, since they do not lie in the middle of a cell.
                    let width = if kind.iter().all(|sign| *sign == 0.0) { widths[step.interval] } else { EDGE_WIDTH };
                    share.ln() - 0.5 * distance / width - 1.5 * width.ln()
                })
                .collect();
            let most = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let sum: f64 = logs.iter().map(|log| (log - most).exp()).sum();
            likelihood += most + sum.ln();
            let weight = (logs[0] - most).exp() / sum;
            noise[step.interval][0] += weight * step.vector_nt.dot(&(step.precision * step.vector_nt)) / 3.0;
            noise[step.interval][1] += weight;
            for ((kind, log), count) in kinds.iter().zip(&logs).zip(&mut counts[step.interval]) {
                let weight = (log - most).exp() / sum;
                *count += weight;
                if weight < 1e-6 {
                    continue;
                }
                for i in (0..heaters).filter(|&i| kind[i] != 0.0) {
                    let mut rows = right.fixed_rows_mut::<3>(3 * i);
                    rows += step.precision * step.vector_nt * (weight * kind[i]);
                    for j in (0..heaters).filter(|&j| kind[j] != 0.0) {
                        let mut block = normal.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                        block += step.precision * (weight * kind[i] * kind[j]);
                    }
                }
            }
        }
        for (shares, counts) in shares.iter_mut().zip(&counts) {
            let sum: f64 = counts.iter().sum();
            shares.iter_mut().zip(counts).for_each(|(share, count)| *share = count / sum);
        }
        widths.iter_mut().zip(&noise).for_each(|(width, [sum, count])| *width = (sum / count).max(LEAST_STEP / 3.0));
        for i in 0..3 * heaters {
            normal[(i, i)] += 1e-9;
        }
        if let Some(cholesky) = normal.cholesky() {
            let solution = cholesky.solve(&right);
            vectors
                .iter_mut()
                .enumerate()
                .for_each(|(heater, vector)| *vector = solution.fixed_rows::<3>(3 * heater).into_owned());
        }
    }
    likelihood
}

/// The class vectors that the steps of all intervals are most probable with, in order of length, signs open; `None` where there
/// are too few steps.
pub(super) fn guess(steps: &[Step], intervals: usize, heaters: usize) -> Option<Vec<Vector3<f64>>> {
    if steps.len() < 4 * heaters || heaters == 0 {
        return None;
    }
    let mut by_length: Vec<&Step> = steps.iter().collect();
    by_length.sort_by(|a, b| a.vector_nt.norm().total_cmp(&b.vector_nt.norm()));
    let starts: Vec<Vector3<f64>> =
        (0..STARTS).map(|start| by_length[(2 * start + 1) * by_length.len() / (2 * STARTS)].vector_nt).collect();
    let stride = steps.len().div_ceil(TRIED);
    let tried: Vec<Step> = steps.iter().step_by(stride).copied().collect();
    // One heater after the other: the best company for those already there, and then all pairs of starts for two.
    let mut found: Vec<Vector3<f64>> = Vec::new();
    let best = |candidates: Vec<Vec<Vector3<f64>>>| {
        candidates
            .into_iter()
            .map(|mut vectors| (settle(&tried, intervals, &mut vectors, ROUNDS[0]), vectors))
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .map(|(_, vectors)| vectors)
    };
    if heaters == 2 {
        let pairs = (0..STARTS).flat_map(|i| (0..i).map(move |j| (i, j)));
        found = best(pairs.map(|(i, j)| vec![starts[i], starts[j]]).collect())?;
    }
    while found.len() < heaters {
        let more = starts.iter().map(|start| found.iter().chain(std::iter::once(start)).copied().collect());
        found = best(more.collect())?;
    }
    settle(steps, intervals, &mut found, ROUNDS[1]);
    found.sort_by(|a, b| a.norm().total_cmp(&b.norm()));
    Some(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    #[test]
    fn two_classes_come_out_of_steps_that_are_also_sums_and_noise() {
        let truth = [Vector3::new(0.5, 0.1, -0.3), Vector3::new(0.9, -0.4, -0.6)];
        let mut random = Random::seeded(5);
        let std = 0.1;
        let steps: Vec<Step> = (0..1500)
            .map(|index| {
                // The first interval has one heater, the second the other, the third both; a fifth of the steps is noise.
                let interval = index % 3;
                let sign = if random.uniform() < 0.5 { 1.0 } else { -1.0 };
                let at_once = if random.uniform() < 0.1 { 1.0 } else { 0.0 };
                let mean = match (interval, random.uniform()) {
                    (_, noise) if noise < 0.2 => Vector3::zeros(),
                    (2, which) if which < 0.6 => (truth[0] + truth[1] * at_once) * sign,
                    (2, _) => truth[1] * sign,
                    (heater, _) => truth[heater] * sign,
                };
                let vector_nt = mean + Vector3::from_fn(|_, _| std * random.gaussian());
                Step { interval, vector_nt, precision: Matrix3::from_diagonal_element(1.0 / (std * std)) }
            })
            .collect();
        let found = guess(&steps, 3, 2).expect("there are steps");
        for (found, truth) in found.iter().zip(&truth) {
            // Some 500 steps of 0.1 nT; the sign is open.
            let distance = (found - truth).norm().min((found + truth).norm());
            assert!(distance < 4.0 * std / 500_f64.sqrt(), "{found}");
        }
        assert!(guess(&steps[..3], 3, 2).is_none());
    }
}
