//! Non-linear least squares where some rows do not belong, by maximum likelihood.
//!
//! An observation is the model plus Gaussian noise with probability 1 - ε, and otherwise anything in a given range:
//!
//! ```text
//! p(y) = (1 - ε) N(y; model, s_g² + std²) + 2 ε / range · (share below, or above, the model)
//! ```
//!
//! `s_g` is the scatter of the group the row is in, estimated with the parameters: it holds noise and what the model does not
//! describe. The likelihood is climbed by expectation maximisation: rows get the probability of belonging as their weight, which is
//! one for small residuals and falls to zero within about four standard deviations, so that the estimator redescends like Tukey's.
//! Unlike with Tukey's, the likelihood counts every row whether it belongs or not, and different models of the same data can be
//! compared by it. The maximum found depends on the start.

use super::nonlinear::{self, Model, NonlinearSolution};
use super::{FitError, Limits, require_length};
use std::f64::consts::TAU;

/// ε. The answer hardly depends on it: a row in three may be an outlier, each costs ln 10 more or less.
const OUTLYING: f64 = 0.1;
/// Weights below are zero: the model need not even be close there.
const LEAST_WEIGHT: f64 = 1e-8;
/// Largest change of a weight, and relative change of a scatter, that ends the iteration.
const SETTLED: f64 = 1e-5;

/// Data with what is known of their noise.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Data {
    /// The observations, n.
    pub observations: Vec<f64>,
    /// Known standard deviation of each, n; zero where nothing is known.
    pub std: Vec<f64>,
    /// Group of each, n: `false` where the model is to be trusted most. The scatter of the other group is never smaller: rows
    /// which matter less must not decide by being few and close to the model.
    pub coarse: Vec<bool>,
    /// Range of observations that do not belong.
    pub range: f64,
    /// Share of them that is below the model; one half where neither side is more likely. Not 0 nor 1: a row on the impossible side
    /// would hold the model wherever it is.
    pub below: f64,
    /// The scatter of the fine and the coarse group is not estimated below: rounding of the data, or what the model must not be
    /// asked to follow.
    pub least_scatter: [f64; 2],
}

/// Where the search starts, or ended.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    /// Parameters.
    pub parameters: Vec<f64>,
    /// Scatter of the fine and the coarse group beyond the known standard deviations.
    pub scatter: [f64; 2],
}

/// The answer of [`fit`].
#[derive(Clone, Debug)]
pub struct Contaminated {
    /// The weighted fit at the final weights.
    pub solution: NonlinearSolution,
    /// Parameters and scatter.
    pub state: State,
    /// Probability that each row belongs, n.
    pub weights: Vec<f64>,
    /// -2 ln L.
    pub deviance: f64,
    /// Whether the iteration settled; otherwise it was close.
    pub settled: bool,
}

/// Variance of each row and its probability of belonging at these residuals, and -2 ln L.
fn expectation(data: &Data, residuals: &[f64], scatter: [f64; 2]) -> (Vec<f64>, Vec<f64>, f64) {
    let mut variances = Vec::with_capacity(residuals.len());
    let mut weights = Vec::with_capacity(residuals.len());
    let mut deviance = 0.0;
    for ((residual, std), &coarse) in residuals.iter().zip(&data.std).zip(&data.coarse) {
        let variance = std * std + scatter[usize::from(coarse)].powi(2);
        variances.push(variance);
        let belongs = (1.0 - OUTLYING) * (-0.5 * residual * residual / variance).exp() / (TAU * variance).sqrt();
        let side = if *residual < 0.0 { data.below } else { 1.0 - data.below };
        let outlies = 2.0 * side * OUTLYING / data.range;
        let weight = belongs / (belongs + outlies);
        weights.push(if weight < LEAST_WEIGHT { 0.0 } else { weight });
        deviance -= 2.0 * (belongs + outlies).ln();
    }
    (variances, weights, deviance)
}

/// The most likely scatter of both groups.
fn scatter(data: &Data, residuals: &[f64], weights: &[f64]) -> [f64; 2] {
    let (mut excess, mut count) = ([0.0; 2], [0.0; 2]);
    for (i, residual) in residuals.iter().enumerate() {
        let group = usize::from(data.coarse[i]);
        excess[group] += weights[i] * (residual * residual - data.std[i].powi(2));
        count[group] += weights[i];
    }
    let root =
        |excess: f64, count: f64, least: f64| if count > 0.0 { (excess / count).max(0.0).sqrt().max(least) } else { least };
    let [least, least_coarse] = data.least_scatter;
    let [fine, coarse] = [root(excess[0], count[0], least), root(excess[1], count[1], least_coarse)];
    if fine <= coarse && count[0] > 0.0 { [fine, coarse] } else { [root(excess[0] + excess[1], count[0] + count[1], least); 2] }
}

/// Climbs from `start` for at most `iterations` steps.
///
/// # Errors
/// Those of [`nonlinear::solve`], and [`FitError::Length`] for data which do not fit together.
pub fn fit(model: &dyn Model, data: &Data, start: &State, iterations: usize, limits: &Limits) -> Result<Contaminated, FitError> {
    let rows = data.observations.len();
    require_length("standard deviations", rows, data.std.len())?;
    require_length("groups", rows, data.coarse.len())?;
    let mut state = start.clone();
    let mut residuals = vec![0.0; rows];
    model.values(&state.parameters, &mut residuals);
    residuals.iter_mut().zip(&data.observations).for_each(|(value, observed)| *value = observed - *value);
    let (mut variances, mut weights, _) = expectation(data, &residuals, state.scatter);
    let mut iteration = 0;
    loop {
        let combined: Vec<f64> = weights.iter().zip(&variances).map(|(weight, variance)| weight / variance).collect();
        let solution = nonlinear::solve(model, &data.observations, Some(&combined), &state.parameters, limits)?;
        let next = scatter(data, &solution.residuals, &weights);
        let change = next.iter().zip(state.scatter).map(|(next, last)| (next - last).abs() / next);
        let mut change = change.fold(0.0, f64::max);
        state = State { parameters: solution.parameters.clone(), scatter: next };
        let last = weights;
        let deviance;
        (variances, weights, deviance) = expectation(data, &solution.residuals, next);
        change = weights.iter().zip(&last).map(|(next, last)| (next - last).abs()).fold(change, f64::max);
        iteration += 1;
        let settled = change <= SETTLED;
        if settled || iteration >= iterations {
            return Ok(Contaminated { solution, state, weights: last, deviance, settled });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Line;

    impl Model for Line {
        fn names(&self) -> Vec<String> {
            vec!["offset".to_owned(), "slope".to_owned()]
        }

        fn values(&self, p: &[f64], values: &mut [f64]) {
            values.iter_mut().enumerate().for_each(|(i, value)| *value = p[0] + p[1] * i as f64);
        }
    }

    /// A line with a scatter of 0.01, alternating, ten times that in the coarse half.
    fn data() -> Data {
        let noise = |i: usize| if i < 20 { 0.01 } else { 0.1 } * if i.is_multiple_of(4) || i % 4 == 3 { 1.0 } else { -1.0 };
        Data {
            observations: (0..40).map(|i| 5.0 + 0.1 * i as f64 + noise(i)).collect(),
            std: vec![0.0; 40],
            coarse: (0..40).map(|i| i >= 20).collect(),
            range: 10.0,
            below: 0.5,
            least_scatter: [1e-9; 2],
        }
    }

    fn line(data: &Data) -> Contaminated {
        fit(&Line, data, &State { parameters: vec![5.0, 0.1], scatter: [0.1; 2] }, 100, &Limits::default()).unwrap()
    }

    #[test]
    fn groups_have_their_scatter() {
        let found = line(&data());
        assert!(found.settled && found.weights.iter().all(|w| *w > 0.98), "{found:?}");
        let [fine, coarse] = found.state.scatter;
        assert!((fine - 0.01).abs() < 0.001 && (coarse - 0.1).abs() < 0.01, "{fine} {coarse}");
        // The fine half alone determines the line.
        assert!((found.solution.parameters[1] - 0.1).abs() < 1e-3);
    }

    #[test]
    fn what_does_not_belong_has_no_say() {
        let mut spoilt = data();
        for i in [1, 2, 6, 9, 13, 17, 18, 25, 30] {
            spoilt.observations[i] *= 0.6;
        }
        let (clean, found) = (line(&data()), line(&spoilt));
        for (a, b) in clean.solution.parameters.iter().zip(&found.solution.parameters) {
            assert!((a - b).abs() < 0.01, "{a} {b}");
        }
        assert!([1, 2, 6, 9, 13, 17, 18, 25, 30].iter().all(|&i| found.weights[i] < 1e-3));
    }

    #[test]
    fn known_noise_is_no_scatter() {
        let mut known = data();
        known.std = known.coarse.iter().map(|&coarse| if coarse { 0.1 } else { 0.01 }).collect();
        let found = line(&known);
        assert!(found.state.scatter.iter().all(|s| *s < 0.004), "{:?}", found.state);
        // A coarse group that scatters less counts like the fine one.
        let swapped = Data { coarse: data().coarse.iter().map(|coarse| !coarse).collect(), ..data() };
        let [fine, coarse] = line(&swapped).state.scatter;
        assert_eq!(fine, coarse);
    }

    #[test]
    fn lengths_are_checked() {
        let short = Data { std: vec![0.0; 3], ..data() };
        let start = State { parameters: vec![5.0, 0.1], scatter: [0.1; 2] };
        assert!(matches!(fit(&Line, &short, &start, 9, &Limits::default()), Err(FitError::Length { .. })));
    }
}
