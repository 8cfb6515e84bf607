//! Non-linear least squares, converged to the last digits the model has.
//!
//! Levenberg-Marquardt (MINPACK's algorithm, which scales every parameter by the norm of its column of the Jacobian) leads
//! from the start to the minimum. It ends where the sum of squares no longer changes, which leaves half of the digits of the
//! parameters open; Gauss-Newton steps then follow the gradient, which has all of them. Where residuals are large next to the
//! curvature of the model those steps close in slowly or overshoot: each is extrapolated from the last two (Anderson's
//! acceleration of depth one) and shortened where it does not lead closer.
//!
//! The covariance is that of the model linearised at the minimum, from the refined solver of [`linear`]. A minimum which leaves
//! parameters undetermined is refused, and so is a point which is none. Which minimum is found depends on the start.

use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Dyn, Owned};

use super::linear::{self, Design, Limits};
use super::{FitError, require_finite, require_length};

/// Evaluations of the search, per parameter and one more: long curved valleys need up to two hundred.
const PATIENCE: usize = 300;
/// Bounds of the first step, in sizes of the start, each tried where those before found no answer: a wide one leaves a distant
/// start soon and may leap to where the model no longer depends on a parameter, a narrow one stays in the valley.
const RADII: [f64; 3] = [100.0, 1.0, 0.1];
/// In place of residuals which are not finite: so far up that the search turns back, so far below overflow that it can.
const WALL: f64 = 1e150;
/// Gauss-Newton steps after the search.
const MAX_STEPS: usize = 50;
/// Lengths of a Gauss-Newton step tried: the shortest still closes in where the full one overshoots fourteenfold.
const SHARES: [f64; 4] = [1.0, 0.5, 0.25, 0.125];
/// A step is taken if the next one is at most this share of it: beyond that rounding has taken over.
const SHRINKS: f64 = 0.99;
/// A step of this share of the noise ends the iteration.
const FINISHED: f64 = 1e-13;
/// Where steps no longer shrink, this share of the noise is a minimum.
const SETTLED: f64 = 1e-6;
/// So is this multiple of the rounding of the largest term of the model, which is all there is in data without noise.
const ROUNDING: f64 = 1e3 * f64::EPSILON;

/// First step of a numerical derivative over the size of its parameter.
const FIRST_STEP: f64 = 1.0 / 1024.0;
/// Steps tried, each a sixteenth of the one before: six decades.
const STEPS: usize = 6;
/// Agreement of a difference with that of half the step which ends the search; extrapolation squares it.
const SMOOTH: f64 = 1e-5;

/// A function of some parameters with one value per observation.
pub trait Model {
    /// Names of the parameters.
    fn names(&self) -> Vec<String>;

    /// Writes the values at `parameters`. NaN marks parameters outside of the domain: the search turns back from them.
    fn values(&self, parameters: &[f64], values: &mut [f64]);

    /// Writes the derivative of value i by parameter j at (i, j); by default that of [`differentiate`].
    fn jacobian(&self, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
        differentiate(self, parameters, jacobian);
    }

    /// Change of parameter `index` at `value` which changes the model as a whole. Numerical derivatives start at a thousandth
    /// of it and find smaller steps by themselves, but not larger ones: give it where `value` may be much too small for that.
    fn size(&self, index: usize, value: f64) -> f64 {
        let _ = index;
        if value == 0.0 { 1.0 } else { value.abs() }
    }
}

/// Derivatives by central differences of two steps, extrapolated: about ten digits, for at least four evaluations each.
///
/// A column is NaN where the model has no finite values around `parameters`.
pub fn differentiate<M: Model + ?Sized>(model: &M, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
    let mut at = parameters.to_vec();
    let mut above = DVector::zeros(jacobian.nrows());
    let mut below = above.clone();
    for (j, &value) in parameters.iter().enumerate() {
        let mut difference = |step: f64| {
            at[j] = value + step;
            // The step that was really made, free of the rounding of the sum.
            let up = at[j] - value;
            model.values(&at, above.as_mut_slice());
            at[j] = value - step;
            let width = up + (value - at[j]);
            model.values(&at, below.as_mut_slice());
            at[j] = value;
            (&above - &below) / width
        };
        let mut step = FIRST_STEP * model.size(j, value);
        let mut least = f64::INFINITY;
        jacobian.column_mut(j).fill(f64::NAN);
        for _ in 0..STEPS {
            let (wide, narrow) = (difference(step), difference(0.5 * step));
            let error = (&narrow - &wide).norm();
            if error < least {
                least = error;
                jacobian.set_column(j, &((&narrow * 4.0 - &wide) / 3.0));
            }
            if error <= SMOOTH * narrow.norm() {
                break;
            }
            step /= 16.0;
        }
    }
}

/// The answer of [`solve`]: n observations, p parameters.
#[derive(Clone, Debug)]
pub struct NonlinearSolution {
    /// Parameters, p.
    pub parameters: Vec<f64>,
    /// Observed minus fitted, n, unweighted, also for observations of weight zero.
    pub residuals: Vec<f64>,
    /// `(JᵀWJ)⁻¹`, p x p: times the variance of an observation of unit weight it is the covariance of the parameters.
    pub unscaled_covariance: DMatrix<f64>,
    /// Condition number of the weighted Jacobian with columns of unit norm.
    pub condition: f64,
    /// Observations of positive weight minus parameters.
    pub dof: usize,
    /// Standard deviation of an observation of unit weight, `sqrt(Σ w r² / dof)`; NaN where `dof` is zero.
    pub residual_std: f64,
    /// Points at which the model was evaluated, without those of numerical derivatives.
    pub evaluations: usize,
}

impl NonlinearSolution {
    /// Covariance of the parameters, p x p, for independent errors of equal variance in observations of unit weight.
    pub fn covariance(&self) -> DMatrix<f64> {
        &self.unscaled_covariance * self.residual_std.powi(2)
    }

    /// Standard deviations of the parameters: the square roots of its diagonal.
    pub fn std(&self) -> Vec<f64> {
        self.unscaled_covariance.diagonal().iter().map(|variance| self.residual_std * variance.sqrt()).collect()
    }
}

/// The parameters with the least sum of weighted squares of observed minus modelled values, searched downhill from `start`.
///
/// Observation i counts with `weights[i]`, its inverse variance up to a common factor; a weight of zero leaves it out.
///
/// # Errors
///
/// [`FitError::Length`], [`FitError::NotFinite`] and [`FitError::NegativeWeight`] for input that does not fit together,
/// [`FitError::NotFinite`] also for a model that is not finite at the start or has no finite derivatives on the way,
/// [`FitError::TooFewRows`], [`FitError::Undetermined`] where the search ends at a Jacobian whose condition exceeds
/// `limits.max_condition`, and [`FitError::NotSettled`] where it ends before a minimum.
pub fn solve(
    model: &dyn Model,
    observations: &[f64],
    weights: Option<&[f64]>,
    start: &[f64],
    limits: &Limits,
) -> Result<NonlinearSolution, FitError> {
    let names = model.names();
    let rows = observations.len();
    require_length("start", names.len(), start.len())?;
    require_finite("start", start, start.len())?;
    require_finite("observations", observations, rows)?;
    let roots = root_weights(weights, rows)?;
    let counted = roots.iter().filter(|root| **root > 0.0).count();
    if counted < names.len() || names.is_empty() {
        return Err(FitError::TooFewRows { rows: counted, parameters: names.len() });
    }
    let parameters = DVector::from_column_slice(start);
    let residuals = DVector::zeros(rows);
    let mut problem = Problem { model, observations, roots: &roots, parameters, residuals, evaluations: 0 };
    problem.move_to(start);
    require_finite("model at the start", problem.residuals.as_slice(), rows)?;

    let mut result = problem.search(RADII[0], &names, weights, limits);
    for radius in &RADII[1..] {
        if result.is_err() {
            result = problem.search(*radius, &names, weights, limits).or(result);
        }
    }
    result
}

/// Square roots of the weights.
fn root_weights(weights: Option<&[f64]>, rows: usize) -> Result<Vec<f64>, FitError> {
    let Some(weights) = weights else {
        return Ok(vec![1.0; rows]);
    };
    require_length("weights", rows, weights.len())?;
    require_finite("weights", weights, rows)?;
    match weights.iter().position(|&weight| weight < 0.0) {
        Some(row) => Err(FitError::NegativeWeight { row }),
        None => Ok(weights.iter().map(|weight| weight.sqrt()).collect()),
    }
}

/// A model, its data, and a point.
#[derive(Clone)]
struct Problem<'a> {
    model: &'a dyn Model,
    observations: &'a [f64],
    roots: &'a [f64],
    parameters: DVector<f64>,
    /// Observed minus modelled, unweighted.
    residuals: DVector<f64>,
    evaluations: usize,
}

/// A Gauss-Newton step, the triangular factor of the Jacobian it comes from, and the norm of what it changes in the model.
struct Step {
    step: DVector<f64>,
    r: DMatrix<f64>,
    size: f64,
}

impl Problem<'_> {
    /// Searches from this point, which stays the start of the next search.
    fn search(
        &mut self,
        radius: f64,
        names: &[String],
        weights: Option<&[f64]>,
        limits: &Limits,
    ) -> Result<NonlinearSolution, FitError> {
        let method = LevenbergMarquardt::new().with_stepbound(radius).with_patience(PATIENCE);
        // However the search ends: whether it found a minimum is seen there.
        let (mut end, _) = method.minimize(self.clone());
        let size = end.polish();
        self.evaluations = end.evaluations;
        let rows = end.residuals.len();
        require_finite("model", end.residuals.as_slice(), rows)?;
        let jacobian = end.derivatives();
        require_finite("Jacobian", jacobian.as_slice(), rows)?;
        let rounding = ROUNDING * end.largest_term(&jacobian);
        let rhs = DMatrix::from_column_slice(rows, 1, end.residuals.as_slice());
        let linear = linear::solve(&Design::new(names.to_vec(), jacobian)?, &rhs, weights, limits)?;
        // Without degrees of freedom there is no noise to compare with: max passes over NaN.
        if size > rounding.max(SETTLED * linear.residual_std[0]) {
            return Err(FitError::NotSettled { what: "non-linear parameters", iterations: end.evaluations });
        }
        Ok(NonlinearSolution {
            parameters: end.parameters.as_slice().to_vec(),
            residuals: end.residuals.as_slice().to_vec(),
            unscaled_covariance: linear.unscaled_covariance,
            condition: linear.condition,
            dof: linear.dof,
            residual_std: linear.residual_std[0],
            evaluations: end.evaluations,
        })
    }

    /// Takes another point and evaluates the model there.
    fn move_to(&mut self, parameters: &[f64]) {
        self.parameters.as_mut_slice().copy_from_slice(parameters);
        self.model.values(parameters, self.residuals.as_mut_slice());
        self.residuals.iter_mut().zip(self.observations).for_each(|(value, observed)| *value = observed - *value);
        self.evaluations += 1;
    }

    fn derivatives(&self) -> DMatrix<f64> {
        let mut jacobian = DMatrix::zeros(self.observations.len(), self.parameters.len());
        self.model.jacobian(self.parameters.as_slice(), &mut jacobian);
        jacobian
    }

    /// None where the Jacobian is not finite or exactly singular.
    fn gauss_newton(&self) -> Option<Step> {
        let factors = QR::new(self.jacobian()?);
        let mut projected = self.residuals()?;
        factors.q_tr_mul(&mut projected);
        let projected = projected.rows(0, self.parameters.len());
        let (r, size) = (factors.r(), projected.norm());
        let step = -r.solve_upper_triangular(&projected)?;
        (size.is_finite() && step.iter().all(|value| value.is_finite())).then_some(Step { step, r, size })
    }

    /// Gauss-Newton steps as long as they lead closer; the size of the one that would be next, infinite where there is none.
    fn polish(&mut self) -> f64 {
        let Some(mut now) = self.gauss_newton() else {
            return f64::INFINITY;
        };
        let mut last: Option<(DVector<f64>, DVector<f64>)> = None;
        let finished = FINISHED * self.residuals().map_or(0.0, |residuals| residuals.norm() / (residuals.len() as f64).sqrt());
        for _ in 0..MAX_STEPS {
            if now.size <= finished {
                break;
            }
            let shares = SHARES.iter().map(|&share| &now.step * share);
            let tried = last.as_ref().and_then(|last| accelerated(&self.parameters, &now, last)).into_iter().chain(shares);
            let closer = tried.into_iter().find_map(|step| {
                let mut trial = self.clone();
                trial.move_to((&self.parameters + step).as_slice());
                self.evaluations += 1;
                let next = trial.gauss_newton()?;
                (next.size < SHRINKS * now.size).then_some((trial, next))
            });
            let Some((trial, next)) = closer else {
                break;
            };
            last = Some((std::mem::replace(&mut self.parameters, trial.parameters), now.step));
            self.residuals = trial.residuals;
            now = next;
        }
        now.size
    }

    /// The largest magnitude among observations and products of a parameter and its derivative, weighted.
    fn largest_term(&self, jacobian: &DMatrix<f64>) -> f64 {
        let mut largest: f64 = 0.0;
        for (i, row) in jacobian.row_iter().enumerate() {
            let terms = row.iter().zip(self.parameters.iter()).map(|(derivative, parameter)| (derivative * parameter).abs());
            largest = largest.max(self.roots[i] * terms.fold(self.observations[i].abs(), f64::max));
        }
        largest
    }
}

/// The step to where the Gauss-Newton step would vanish if it were linear in the parameters between this point and the last.
fn accelerated(parameters: &DVector<f64>, now: &Step, last: &(DVector<f64>, DVector<f64>)) -> Option<DVector<f64>> {
    let (moved, change) = (parameters - &last.0, &now.step - &last.1);
    let in_values = &now.r * &change;
    let share = in_values.dot(&(&now.r * &now.step)) / in_values.norm_squared();
    share.is_finite().then(|| &now.step - (moved + change) * share)
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Problem<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, parameters: &DVector<f64>) {
        self.move_to(parameters.as_slice());
    }

    fn params(&self) -> DVector<f64> {
        self.parameters.clone()
    }

    /// Modelled minus observed, weighted.
    fn residuals(&self) -> Option<DVector<f64>> {
        let residuals = DVector::from_fn(self.roots.len(), |i, _| -self.residuals[i] * self.roots[i]);
        let finite = residuals.iter().all(|residual| residual.is_finite());
        Some(if finite { residuals } else { residuals.map(|_| WALL) })
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut jacobian = self.derivatives();
        jacobian.row_iter_mut().zip(self.roots).for_each(|(mut row, root)| row *= *root);
        jacobian.iter().all(|derivative| derivative.is_finite()).then_some(jacobian)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    /// A model from a closure, with numerical derivatives.
    struct Closure<F>(&'static str, F);

    fn model<F: Fn(&[f64], usize) -> f64>(names: &'static str, value: F) -> Closure<F> {
        Closure(names, value)
    }

    impl<F: Fn(&[f64], usize) -> f64> Model for Closure<F> {
        fn names(&self) -> Vec<String> {
            self.0.split_whitespace().map(str::to_owned).collect()
        }

        fn values(&self, parameters: &[f64], values: &mut [f64]) {
            values.iter_mut().enumerate().for_each(|(i, value)| *value = (self.1)(parameters, i));
        }
    }

    fn fit(model: &dyn Model, y: &[f64], start: &[f64]) -> Result<NonlinearSolution, FitError> {
        solve(model, y, None, start, &Limits::default())
    }

    #[test]
    fn a_line_agrees_with_the_linear_solver() {
        let line = model("offset slope", |b, i| b[0] + b[1] * i as f64);
        let fit = fit(&line, &[1.0, 2.0, 4.0, 5.0], &[0.0, 0.0]).unwrap();
        assert!((fit.parameters[0] - 0.9).abs() < 1e-11 && (fit.parameters[1] - 1.4).abs() < 1e-11);
        // (XᵀX)⁻¹ = [14 -6; -6 4] / 20.
        let covariance = DMatrix::from_row_slice(2, 2, &[0.7, -0.3, -0.3, 0.2]);
        assert!((&fit.unscaled_covariance - &covariance).amax() < 1e-10);
        assert!((fit.covariance() - covariance * 0.1).amax() < 1e-10);
        assert_eq!(fit.dof, 2);
        assert!((fit.std()[1] - 0.02_f64.sqrt()).abs() < 1e-10);
        assert!((fit.residuals[0] - 0.1).abs() < 1e-11);
    }

    #[test]
    fn weights_count_observations() {
        // The logarithm of the weighted mean 3; Σ w r² = 4 + 0 + 4, (JᵀWJ)⁻¹ = 1 / (4 · 9).
        let mean = model("log", |b, _| b[0].exp());
        let (y, weights) = ([1.0, 3.0, 9.0, 5.0], [1.0, 2.0, 0.0, 1.0]);
        let fit = solve(&mean, &y, Some(&weights), &[-2.0], &Limits::default()).unwrap();
        assert!((fit.parameters[0] - 3f64.ln()).abs() < 1e-15);
        assert_eq!(fit.dof, 2);
        assert!((fit.residual_std - 2.0).abs() < 1e-14);
        assert!((fit.std()[0] - 2.0 / 6.0).abs() < 1e-10);
        assert!((fit.residuals[2] - 6.0).abs() < 1e-14);
    }

    #[test]
    fn large_residuals_cost_no_digits() {
        // The point of the unit circle below (R cos a, R sin a): the plain Gauss-Newton step is R times too long.
        let circle = model("angle", |b, i| [b[0].cos(), b[0].sin()][i]);
        for radius in [0.05_f64, 0.5, 3.0, 12.0] {
            let fit = fit(&circle, &[radius * 0.8, radius * 0.6], &[0.3]).unwrap();
            assert!((fit.parameters[0] - 0.6_f64.atan2(0.8)).abs() < 1e-10, "{radius}");
            assert!((fit.residual_std - (radius - 1.0).abs()).abs() < 1e-13, "{radius}");
        }
    }

    #[test]
    fn data_without_noise_are_no_obstacle() {
        // 6000 turns: the frequency has four digits more than the phase, and the model twelve.
        let wave = model("amplitude frequency phase", |b, i| b[0] * (2.0 * PI * b[1] * 0.31 * i as f64 + b[2]).sin());
        let truth = [3.0, 20.0001, 0.4];
        let mut y = vec![0.0; 1000];
        wave.values(&truth, &mut y);
        let found = fit(&wave, &y, &[2.0, 20.0, 0.3]).unwrap().parameters;
        assert!(found.iter().zip(truth).all(|(value, truth)| (value / truth - 1.0).abs() < 1e-11), "{found:?}");
        // As many observations as parameters leave none to estimate the noise from.
        let growth = model("a b", |b, i| b[0] * (b[1] * i as f64).exp());
        let exact = fit(&growth, &[2.0, 4.0], &[1.0, 0.1]).unwrap();
        assert!((exact.parameters[0] - 2.0).abs() < 1e-13 && (exact.parameters[1] - 2f64.ln()).abs() < 1e-13);
        assert!(exact.residual_std.is_nan() && exact.std()[0].is_nan());
    }

    #[test]
    fn units_do_not_matter() {
        let y = [2.1, 2.9, 4.2, 6.1, 8.3];
        let scaled = |unit: [f64; 2]| {
            let growth = model("a b", move |b, i| b[0] / unit[0] * (b[1] / unit[1] * i as f64).exp());
            let fit = fit(&growth, &y, &[unit[0], 0.1 * unit[1]]).unwrap();
            [fit.parameters[0] / unit[0], fit.parameters[1] / unit[1], fit.std()[0] / unit[0], fit.std()[1] / unit[1]]
        };
        for (a, b) in scaled([1.0, 1.0]).iter().zip(scaled([1e-30, 1e40])) {
            assert!((a / b - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn the_search_turns_back_from_where_the_model_is_not_defined() {
        let truth = [1.5, 1.2];
        let logarithm = model("a b", |b, i| b[0] * (b[1] * (i + 1) as f64 - 1.0).ln());
        let mut y = vec![0.0; 6];
        logarithm.values(&truth, &mut y);
        let fit = fit(&logarithm, &y, &[8.0, 4.0]).unwrap();
        assert!((fit.parameters[0] - 1.5).abs() < 1e-12 && (fit.parameters[1] - 1.2).abs() < 1e-12);
    }

    #[test]
    fn undetermined_parameters_are_named() {
        let names = |model: &dyn Model, start: &[f64]| match fit(model, &[1.1, 1.8, 3.3, 3.9], start) {
            Err(FitError::Undetermined { parameters, .. }) => parameters.join(" "),
            other => panic!("{other:?}"),
        };
        let product = model("a b c", |b, i| b[0] * b[1] * i as f64 + b[2]);
        assert_eq!(names(&product, &[1.0, 2.0, 0.0]), "a b");
        let idle = model("a b", |b, i| b[0] * i as f64 + 0.0 * b[1]);
        assert_eq!(names(&idle, &[1.0, 2.0]), "b");
    }

    #[test]
    fn what_has_no_answer_is_refused() {
        // The best decay to a negative value is an infinite one.
        let decay = model("rate", |b, _| (-b[0]).exp());
        let error = fit(&decay, &[-1.0, -1.5], &[1.0]).unwrap_err();
        assert!(matches!(error, FitError::NotSettled { .. } | FitError::Undetermined { .. }), "{error}");
        assert!(matches!(fit(&decay, &[1.0], &[-800.0]), Err(FitError::NotFinite { what: "model at the start", row: 0 })));
        let wall = model("a", |b, i| if b[0] == 1.0 { i as f64 } else { f64::NAN });
        assert!(matches!(fit(&wall, &[1.0, 2.0], &[1.0]), Err(FitError::NotFinite { what: "Jacobian", .. })));
        assert!(matches!(fit(&decay, &[], &[1.0]), Err(FitError::TooFewRows { rows: 0, parameters: 1 })));
        assert!(matches!(fit(&model("", |_, _| 0.0), &[1.0], &[]), Err(FitError::TooFewRows { .. })));
        assert!(matches!(fit(&decay, &[1.0], &[1.0, 2.0]), Err(FitError::Length { expected: 1, found: 2, .. })));
        assert!(matches!(fit(&decay, &[1.0], &[f64::NAN]), Err(FitError::NotFinite { what: "start", .. })));
        assert!(matches!(fit(&decay, &[f64::INFINITY], &[1.0]), Err(FitError::NotFinite { what: "observations", .. })));
        let weighted = |weights: &[f64]| solve(&decay, &[1.0, 2.0], Some(weights), &[1.0], &Limits::default()).unwrap_err();
        assert!(matches!(weighted(&[1.0]), FitError::Length { expected: 2, found: 1, .. }));
        assert!(matches!(weighted(&[1.0, -1.0]), FitError::NegativeWeight { row: 1 }));
        assert!(matches!(weighted(&[f64::NAN, 1.0]), FitError::NotFinite { what: "weights", row: 0 }));
        assert!(matches!(weighted(&[0.0, 0.0]), FitError::TooFewRows { rows: 0, .. }));
    }
}
