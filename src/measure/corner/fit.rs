//! The fit of one response to one component: with known noise, or with a scatter and with rows that do not belong.

use super::course::{Course, Form};
use super::prepared::Prepared;
use super::refusal::Refusal;
use super::result::Explained;
use crate::fit::contaminated::{self, Contaminated, Data, State};
use crate::fit::nonlinear::{self, Model};
use crate::fit::statistics::chi2_tail;
use crate::fit::{Limits, aicc, order, student_factor};
use crate::model::response::Response;
use nalgebra::{DMatrix, DVector};

/// Scatter at the start: what is within is followed, what is without does not belong. The wide one is for starts far off.
const START_SCATTER: [[f64; 2]; 2] = [[0.02, 0.05], [0.08, 0.08]];
/// Iterations before the best starts are chosen.
const FIRST_ITERATIONS: usize = 2;
/// As many starts are followed to the end.
const STARTS_CONTINUED: usize = 2;
/// Iterations after.
const ITERATIONS: usize = 200;
/// A response that makes outliers of more than this share of the rows does not describe them.
const MOST_OUTLYING: f64 = 0.4;
/// Least probability of a chi square that large, and residual over its standard deviation, up to which known noise explains what a
/// response leaves: one run in several thousand with nothing but that noise fails.
const EXPLAINED_PROBABILITY: f64 = 1e-4;
const EXPLAINED_RESIDUAL: f64 = 5.0;
/// As many starts, the closest ones, are followed with known noise.
const KNOWN_STARTS: usize = 3;

/// A response with its DC gain as model of amplitudes: parameters are logarithms, relative DC gain first. Behind them stand those of the course of time
/// that the logarithm of the amplitude follows beside it.
struct Shape<'a> {
    response: Response,
    frequencies: &'a [f64],
    times: &'a [f64],
    drift: Form,
}

impl Shape<'_> {
    /// DC gain, parameters of the response, and those of the drift.
    fn parts<'p>(&self, parameters: &'p [f64]) -> (f64, Vec<f64>, &'p [f64]) {
        let (shape, drift) = parameters[1..].split_at(self.response.parameters().len());
        (parameters[0].exp(), shape.iter().map(|logarithm| logarithm.exp()).collect(), drift)
    }
}

impl Model for Shape<'_> {
    fn names(&self) -> Vec<String> {
        let own = self.response.parameters().into_iter().map(|parameter| parameter.name.to_owned());
        let drift = (1..=self.drift.count()).map(|number| format!("drift {number}"));
        std::iter::once("dc".to_owned()).chain(own).chain(drift).collect()
    }

    fn values(&self, parameters: &[f64], values: &mut [f64]) {
        let (dc, shape, drift) = self.parts(parameters);
        for ((value, &f), &time) in values.iter_mut().zip(self.frequencies).zip(self.times) {
            *value = dc * self.response.value(f, &shape) * self.drift.value_and_slopes(drift, time).0.exp();
        }
    }

    fn jacobian(&self, parameters: &[f64], jacobian: &mut DMatrix<f64>) {
        let (dc, shape, drift) = self.parts(parameters);
        for ((mut row, &f), &time) in jacobian.row_iter_mut().zip(self.frequencies).zip(self.times) {
            let (value, slopes) = self.response.value_and_slopes(f, &shape);
            let of_response = std::iter::once(value).chain(slopes.into_iter().take(shape.len()));
            let (course, by_drift) = self.drift.value_and_slopes(drift, time);
            let of_drift = by_drift.into_iter().map(|slope| value * slope);
            let amplitude = dc * course.exp();
            row.iter_mut().zip(of_response.chain(of_drift)).for_each(|(entry, derivative)| *entry = amplitude * derivative);
        }
    }
}

impl Prepared {
    /// The fit of a response with known standard deviations, from the best of several starts.
    pub fn known_fit(&self, response: Response) -> Result<Outcome, Refusal> {
        let weights = self.weights();
        let shape = self.shape(response, Form::STILL);
        let mut values = vec![0.0; self.rows.len()];
        let mut left = |start: &[f64]| -> f64 {
            shape.values(start, &mut values);
            values.iter().zip(&self.data.observations).zip(&weights).map(|((value, y), w)| w * (y - value).powi(2)).sum()
        };
        let mut starts: Vec<(f64, Vec<f64>)> = self.starts(response).into_iter().map(|start| (left(&start), start)).collect();
        starts.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.known_fit_from(response, Form::STILL, starts.into_iter().take(KNOWN_STARTS).map(|(_, start)| start))
    }

    /// The fit of a response with known standard deviations beside a drift of the amplitudes of a form, from the fit without.
    pub fn drifting_fit(&self, response: Response, drift: Form, still: &Outcome) -> Result<Outcome, Refusal> {
        let (_, sizes) = self.drift_takes(response, drift, still);
        let start = still.found.state.parameters.iter().copied().chain(drift.start(sizes.into_iter())).collect();
        self.known_fit_from(response, drift, [start])
    }

    fn known_fit_from(
        &self,
        response: Response,
        drift: Form,
        starts: impl IntoIterator<Item = Vec<f64>>,
    ) -> Result<Outcome, Refusal> {
        // A Butterworth of each order is a response of its own here: the order is one for all components, and data with known noise
        // leave no doubt about it.
        let parameters = response.parameters().len() + 1 + drift.count();
        let rows = self.rows.len();
        if aicc(0.0, parameters, rows).is_none() {
            return Err(Refusal::TooFew { rows, parameters });
        }
        let weights = self.weights();
        let shape = self.shape(response, drift);
        let mut refusal = None;
        let mut best: Option<Contaminated> = None;
        for start in starts {
            match nonlinear::solve(&shape, &self.data.observations, Some(&weights), &start, &Limits::default()) {
                Ok(solution) => {
                    let chi_square = solution.residuals.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
                    if best.as_ref().is_none_or(|best| chi_square < best.deviance) {
                        let state = State { parameters: solution.parameters.clone(), scatter: [0.0; 2] };
                        let dof = solution.dof;
                        best =
                            Some(Contaminated { solution, state, weights: vec![1.0; rows], deviance: chi_square, settled: true });
                        // There is nothing left for another minimum to explain.
                        if is_likely(chi_square, dof) {
                            break;
                        }
                    }
                }
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        let found = best.ok_or_else(|| refusal.map_or(Refusal::Outside, Refusal::Fit))?;
        self.outcome(response, drift, found, parameters)
    }

    /// By how much a drift of a form lowers the chi square of a fit with known standard deviations, and with which sizes, as far as the response is
    /// linear in its parameters.
    pub fn drift_takes(&self, response: Response, drift: Form, still: &Outcome) -> (f64, Vec<f64>) {
        let parameters = &still.found.state.parameters;
        let at_rest = drift.start(std::iter::repeat_n(0.0, drift.linear()));
        let extended: Vec<f64> = parameters.iter().copied().chain(at_rest).collect();
        let mut columns = DMatrix::zeros(self.rows.len(), extended.len());
        self.shape(response, drift).jacobian(&extended, &mut columns);
        // Without a size there is no time constant.
        let mut columns = columns.columns(0, parameters.len() + drift.linear()).into_owned();
        for (mut row, std) in columns.row_iter_mut().zip(&self.data.std) {
            row /= *std;
        }
        let left = still.found.solution.residuals.iter().zip(&self.data.std).map(|(r, std)| r / std);
        let left = DVector::from_iterator(self.rows.len(), left);
        // Behind the directions of the response stand those that the drift adds to them.
        let (directions, triangle) = columns.qr().unpack();
        let along = directions.columns(parameters.len(), drift.linear()).tr_mul(&left);
        let own = (parameters.len(), parameters.len());
        let triangle = triangle.view(own, (drift.linear(), drift.linear())).into_owned();
        let sizes = triangle.solve_upper_triangular(&along).map_or_else(Vec::new, |sizes| sizes.iter().copied().collect());
        (along.norm_squared(), sizes)
    }

    fn weights(&self) -> Vec<f64> {
        self.data.std.iter().map(|std| std.powi(-2)).collect()
    }

    fn shape(&self, response: Response, drift: Form) -> Shape<'_> {
        Shape { response, frequencies: &self.frequencies, times: &self.times, drift }
    }

    /// Whether known standard deviations explain the residuals one by one.
    pub fn explains(&self, outcome: &Outcome) -> bool {
        outcome.found.solution.residuals.iter().zip(&self.data.std).all(|(r, std)| r.abs() <= EXPLAINED_RESIDUAL * std)
    }

    /// The fit of a response from the best of several starts.
    pub fn fit(&self, response: Response) -> Result<Outcome, Refusal> {
        let mut refusal = None;
        let mut found = Vec::new();
        for parameters in self.starts(response) {
            for scatter in START_SCATTER {
                let state = State { parameters: parameters.clone(), scatter };
                match self.climb(response, &state, FIRST_ITERATIONS) {
                    Ok(first) => found.push(first),
                    Err(error) => refusal = refusal.or(Some(error)),
                }
            }
        }
        found.sort_by(|a, b| a.deviance.total_cmp(&b.deviance));
        let mut best: Option<Outcome> = None;
        for first in found.iter().take(STARTS_CONTINUED) {
            match self.continued(response, &first.state) {
                Ok(outcome) if best.as_ref().is_none_or(|best| outcome.aicc < best.aicc) => best = Some(outcome),
                Ok(_) => {}
                Err(error) => refusal = refusal.or(Some(error)),
            }
        }
        best.ok_or_else(|| refusal.unwrap_or(Refusal::Outside))
    }

    fn climb(&self, response: Response, state: &State, iterations: usize) -> Result<Contaminated, Refusal> {
        let parameters = response.freedom() + 1 + self.scatters();
        let rows = self.rows.len();
        if aicc(0.0, parameters, rows).is_none() {
            return Err(Refusal::TooFew { rows, parameters });
        }
        let found = contaminated::fit(&self.shape(response, Form::STILL), &self.data, state, iterations, &Limits::default())?;
        let outlying: f64 = found.weights.iter().map(|weight| 1.0 - weight).sum();
        if outlying > MOST_OUTLYING * rows as f64 {
            return Err(Refusal::Outlying { outlying, rows });
        }
        Ok(found)
    }

    /// The fit of a response from a state close to it.
    pub fn continued(&self, response: Response, state: &State) -> Result<Outcome, Refusal> {
        let found = self.climb(response, state, ITERATIONS)?;
        self.outcome(response, Form::STILL, found, response.freedom() + 1 + self.scatters())
    }

    /// The corner of a fitted response, and its AICc with so many parameters.
    fn outcome(&self, response: Response, drift: Form, found: Contaminated, parameters: usize) -> Result<Outcome, Refusal> {
        let (own, of_drift) = found.state.parameters[1..].split_at(response.parameters().len());
        let shape: Vec<f64> = own.iter().map(|logarithm| logarithm.exp()).collect();
        let drift = Course { form: drift, parameters: of_drift.to_vec() };
        let within = |corner: &f64| {
            let counted = || self.frequencies.iter().zip(&found.weights).filter(|(_, weight)| **weight > 0.5).map(|(f, _)| *f);
            counted().fold(f64::INFINITY, f64::min) <= *corner && *corner <= counted().fold(0.0, f64::max)
        };
        let corner_hz = response.corner_hz(&shape).filter(within).ok_or(Refusal::Outside)?;
        let rows = self.rows.len();
        let aicc = aicc(found.deviance, parameters, rows).ok_or(Refusal::TooFew { rows, parameters })?;
        Ok(Outcome { found, shape, drift, corner_hz, aicc })
    }
}

/// Whether known noise gives a chi square as large as this.
pub(super) fn is_likely(chi_square: f64, dof: usize) -> bool {
    dof > 0 && chi2_tail(chi_square, dof as f64) >= EXPLAINED_PROBABILITY
}

/// A response fitted to a component.
pub(super) struct Outcome {
    pub found: Contaminated,
    pub shape: Vec<f64>,
    /// What the logarithm of the amplitude follows of the relative time.
    pub drift: Course,
    pub corner_hz: f64,
    pub aicc: f64,
}

impl Outcome {
    /// DC amplitude relative to the first guess and parameters of the response.
    pub fn values(&self, dc: f64) -> Vec<f64> {
        std::iter::once(dc * self.found.state.parameters[0].exp()).chain(self.shape.iter().copied()).collect()
    }

    /// Covariance of the logarithms of DC amplitude and parameters.
    ///
    /// Where scatter was estimated, weights are inverse variances, most likely ones: what the parameters take from the scatter is
    /// given back, as the rows above -10 dB have it, for the others do not scatter as much as they are allowed to. Intervals are normal ones: where
    /// the scatter of a few rows tells their uncertainty, Student's factor is in it.
    pub fn covariance(&self, data: &Data, explained: Option<Explained>) -> DMatrix<f64> {
        let factor = match explained {
            Some(explained) => match order::excess(explained.chi_square, explained.dof) {
                excess if excess > 1.0 => (excess * student_factor(explained.dof.max(1))).powi(2),
                _ => 1.0,
            },
            None => {
                let weights = self.found.weights.iter().zip(&data.coarse);
                let deciding: f64 = weights.filter(|(_, coarse)| !**coarse).map(|(w, _)| w).sum();
                let freedom = (deciding - self.found.state.parameters.len() as f64).max(1.0);
                deciding / freedom * student_factor(freedom as usize).powi(2)
            }
        };
        &self.found.solution.unscaled_covariance * factor
    }

    /// Scatter of the residuals above and below -10 dB, relative to the first guess of the DC amplitude.
    pub fn scatter(&self, data: &Data, explained: Option<Explained>) -> [f64; 2] {
        if explained.is_none() {
            return self.found.state.scatter;
        }
        let rows = data.observations.len() as f64;
        let spare = rows - self.found.state.parameters.len() as f64;
        [false, true].map(|coarse| {
            let group = self.found.solution.residuals.iter().zip(&data.coarse).filter(|(_, own)| **own == coarse);
            let (sum, count) = group.fold((0.0, 0.0), |(sum, count), (r, _)| (sum + r * r, count + 1.0));
            // The parameters take from all residuals alike.
            (sum / count * rows / spare).sqrt()
        })
    }
}
