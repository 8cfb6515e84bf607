//! The order of a polynomial: given, or the one with the least AICc.
//!
//! The corrected information criterion of Akaike (Hurvich and Tsai 1989) weighs the misfit against the number of coefficients;
//! at the handful of temperatures of a campaign its correction for small samples decides. Beside it stands the error of
//! leave-one-out prediction, in closed form through the hat matrix. The criterion has no value for orders with fewer than one or
//! two points to spare, however plain they are, and next to that limit its correction outweighs any misfit. There the prediction
//! overrules it, where it is better by a factor and leaves less scatter than points scattering about the lower order give by chance. Three points
//! leave one degree of freedom to a line, from which chance alone cannot be told; that their standard deviations are too small by a factor is the less
//! probable the larger it is, and that a quantity changes with temperature at all needs no proof, so that there both count together.
//!
//! Points may carry standard deviations. Runs often scatter by more than those say, and a criterion which believes them then
//! explains the scatter with coefficients. One which does not believe them cannot tell curvature from scatter in few points.
//! Both are therefore hypotheses on one scale: the standard deviations as they are, `χ² + penalty(k)`, and all of them too small
//! by one unknown factor, `n ln(χ²/n) + n + penalty(k + 1)`, which costs a parameter. Each order counts with the better.
//!
//! A coefficient of two or three standard deviations is left out as often as not, and what that does to the polynomial is in no covariance
//! of a fit. The uncertainty of a polynomial whose order was chosen is therefore the one averaged over all orders (Buckland, Burnham and
//! Augustin 1997): the variance of each and the square of its distance, weighed by its likelihood.

use nalgebra::DMatrix;
use serde::{Deserialize, Serialize};
use std::fmt;

use super::linear::Limits;
use super::polynomial::{self, Polynomial};
use super::scalar::bisect;
use super::statistics::{chi2_tail, extremes, fisher_tail};
use super::{FitError, aicc, require_finite, require_length};

/// The highest order that is fitted.
pub const HIGHEST_ORDER: usize = 5;
/// A higher order is chosen where its AICc is lower by more than this: below it the data hardly prefer either.
pub const TIE: f64 = 2.0;
/// A higher order than that of the criterion is chosen where it predicts points left out better by more than this factor.
const CLEARLY_BETTER: f64 = 3.0;
/// Residuals below this share of the largest value are rounding: the lowest order that leaves no more is exact.
const ROUNDING: f64 = 1e3 * f64::EPSILON;
/// A point with a leverage closer to one than this determines a coefficient alone: without it there is no prediction.
const LEAST_FREEDOM: f64 = 1e-9;

/// Why a polynomial has its order; the words are those of the files.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Reason {
    /// The analyst gave it.
    #[serde(rename = "given")]
    Given,
    /// It is the lowest which leaves nothing but rounding.
    #[serde(rename = "the lowest that leaves only rounding")]
    Exact,
    /// It is the lowest whose AICc is within 2 of the least.
    #[serde(rename = "AICc")]
    LeastAicc,
    /// It is one above the order that the AICc prefers, as far as the data determine it, so that what the choice leaves out is small beside
    /// the uncertainty.
    #[serde(rename = "one above AICc")]
    AboveLeastAicc,
    /// It is the lowest whose leave-one-out error is within a factor of 3 of the least; that of the order the criterion prefers,
    /// a lower one, is not.
    #[serde(rename = "leave-one-out error")]
    LeaveOneOut,
    /// There are too few points for the criterion at any order.
    #[serde(rename = "too few points for more")]
    TooFewPoints,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.serialize(f)
    }
}

/// One order in comparison.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The order.
    pub order: usize,
    /// Points minus coefficients.
    pub dof: usize,
    /// Weighted sum of squared residuals, weights of mean one, in units of y squared.
    pub rss: f64,
    /// `sqrt(rss / dof)`, in units of y; NaN where `dof` is zero.
    pub residual_std: f64,
    /// Sum of squared residuals over their variances, where standard deviations are given.
    pub chi2: Option<f64>,
    /// The criterion; absent where there are too few points for it.
    pub aicc: Option<f64>,
    /// Whether the criterion takes the points to scatter by more than their standard deviations.
    pub excess_scatter: bool,
    /// Weighted root mean square of the error at each point of the fit without it, in units of y; absent where the fit without
    /// a point has no answer.
    pub leave_one_out: Option<f64>,
}

/// A polynomial of the order given or chosen.
#[derive(Clone, Debug, PartialEq)]
pub struct Chosen {
    /// Its order.
    pub order: usize,
    /// Why this one.
    pub reason: Reason,
    /// The fit, weighted by `1/std²` where standard deviations are given.
    pub polynomial: Polynomial,
    /// Covariance of the coefficients in raw powers, (order+1) x (order+1): with standard deviations from those, times
    /// `inflation²`; without from the scatter of the residuals, NaN where no degree of freedom is left. Times `choice²` both.
    pub covariance: DMatrix<f64>,
    /// Factor on the given standard deviations: `sqrt(χ²/dof)` where χ² exceeds its 99 % quantile, otherwise 1. Without
    /// standard deviations the standard deviation of a point.
    pub inflation: f64,
    /// Factor on the standard deviations of the polynomial because its order was chosen: 1 where it was given or is exact.
    pub choice: f64,
    /// Every order that was compared, lowest first.
    pub candidates: Vec<Candidate>,
}

impl Chosen {
    /// Value and standard deviation at `x`, free of the cancellation that raw powers suffer.
    #[must_use]
    pub fn evaluate(&self, x: f64) -> (f64, f64) {
        let (value, unit_std) = self.polynomial.evaluate_unscaled(x);
        (value, self.choice * self.inflation * unit_std)
    }
}

/// Fits `y` (n points) at `x` by polynomials of all orders up to `max_order` and takes the order `wanted`, or else the one with
/// the least AICc, the lower where the gain is not more than 2, or a higher one whose leave-one-out error is less by a factor
/// of more than 3, and about which the points scatter less than by chance.
///
/// `std` are the standard deviations of the points; without them all points count alike and their scatter about the polynomial
/// tells their uncertainty. No order exceeds [`HIGHEST_ORDER`] or the number of different x less one. The criterion needs two
/// points more than it has parameters; where no order has one, order 0 takes its place. Values
/// without noise are seen as such: the lowest order which leaves only rounding is taken, whatever the criterion says of so few
/// points, if a point more than its coefficients confirms it.
///
/// # Errors
///
/// [`FitError::TooFewPoints`] and [`FitError::OrderTooHigh`] for `wanted`; [`FitError::NotPositive`] for a standard deviation;
/// otherwise those of [`polynomial::fit`]. Orders whose design exceeds `limits` are left out unless they are wanted.
pub fn choose(
    x: &[f64],
    y: &[f64],
    std: Option<&[f64]>,
    max_order: usize,
    wanted: Option<usize>,
    limits: &Limits,
) -> Result<Chosen, FitError> {
    require_length("y", x.len(), y.len())?;
    require_finite("x", x, x.len())?;
    require_finite("y", y, y.len())?;
    let weights = std.map(|std| weights_of(std, x.len())).transpose()?;
    let distinct = count_distinct(x);
    match wanted {
        Some(order) if order > HIGHEST_ORDER => return Err(FitError::OrderTooHigh { order, highest: HIGHEST_ORDER }),
        Some(order) if order >= distinct => return Err(FitError::TooFewPoints { order, distinct }),
        None if distinct == 0 => return Err(FitError::TooFewPoints { order: 0, distinct }),
        _ => {}
    }
    let highest = max_order.max(wanted.unwrap_or(0)).min(HIGHEST_ORDER).min(distinct - 1);

    let mut fits: Vec<(Candidate, Polynomial)> = Vec::new();
    for order in 0..=highest {
        match polynomial::fit(x, y, weights.as_deref(), order, limits) {
            Ok(polynomial) => fits.push((judge(&polynomial, order, x, weights.as_deref()), polynomial)),
            // Higher orders are no better conditioned.
            Err(FitError::Undetermined { .. }) if wanted.is_none_or(|wanted| order > wanted) => break,
            Err(error) => return Err(error),
        }
    }
    let candidates: Vec<Candidate> = fits.iter().map(|(candidate, _)| *candidate).collect();
    let floor = ROUNDING * y.iter().fold(0.0, |largest: f64, y| largest.max(y.abs()));
    let is_exact = |polynomial: &Polynomial| polynomial.dof > 0 && polynomial.residuals.iter().all(|r| r.abs() <= floor);
    let (index, reason) = if let Some(order) = wanted {
        (order, Reason::Given)
    } else if let Some(index) = fits.iter().position(|(_, polynomial)| is_exact(polynomial)) {
        (index, Reason::Exact)
    } else {
        let lowest_within = |value: fn(&Candidate) -> Option<f64>, limit: fn(f64) -> f64| {
            let least = candidates.iter().filter_map(value).fold(f64::INFINITY, f64::min);
            candidates.iter().position(|c| value(c).is_some_and(|value| value <= limit(least)))
        };
        let is_explained = |order: usize| candidates[order].chi2.is_some_and(|chi2| excess(chi2, candidates[order].dof) == 1.0);
        let preferred = lowest_within(|c| c.aicc, |least| least + TIE);
        match (preferred, lowest_within(|c| c.leave_one_out, |least| CLEARLY_BETTER * least)) {
            // Where the stated noise explains what the preferred order leaves, a smaller error is luck; it may be luck as well where a point or
            // two are left to tell the scatter.
            (preferred, Some(predicting))
                if predicting > preferred.unwrap_or(0)
                    && !preferred.is_some_and(is_explained)
                    && is_no_scatter(&candidates[preferred.unwrap_or(0)], &candidates[predicting]) =>
            {
                (predicting, Reason::LeaveOneOut)
            }
            (Some(preferred), _) => (preferred, Reason::LeastAicc),
            _ => (0, Reason::TooFewPoints),
        }
    };
    let inflation = match fits[index].0.chi2 {
        Some(chi2) => excess(chi2, fits[index].0.dof),
        None => fits[index].1.residual_std,
    };
    let choice = if matches!(reason, Reason::Given | Reason::Exact) { 1.0 } else { of_choice(&fits, index, inflation, x) };
    // Orders are fitted without gap from zero, so an index is an order; order zero is always determined.
    let (candidate, polynomial) = fits.swap_remove(index);
    let covariance = &polynomial.unscaled_covariance * (choice * inflation).powi(2);
    Ok(Chosen { order: candidate.order, reason, polynomial, covariance, inflation, choice, candidates })
}

/// Whether points that leave so little about a higher order do not only scatter about a lower one: they do so by chance less often than
/// [`UNLIKELY`]. A line whose points are within their standard deviations may also be told from a constant by both together, that chance and how
/// improbable standard deviations are that are too small by so much, `P(factor > f) = 1 / f`.
fn is_no_scatter(lower: &Candidate, higher: &Candidate) -> bool {
    let [gained, left] = [lower.dof - higher.dof, higher.dof].map(|dof| dof as f64);
    let f = (lower.rss - higher.rss) / gained / (higher.rss / left);
    let by_chance = fisher_tail(f, [gained, left]);
    let of_line = match (lower.chi2, higher.chi2) {
        (Some(scattering), Some(left)) if higher.order == 1 && excess(left, higher.dof) == 1.0 => {
            by_chance / excess(scattering, lower.dof) < NO_SCATTER
        }
        _ => false,
    };
    by_chance < UNLIKELY || of_line
}

/// Factor by which the standard deviation of a polynomial grows with the orders that it might have as well: that of the end of the range where it is
/// the larger. What an order leaves out is largest there, and a factor of the mean over the points would hold in the middle alone.
/// `std_unit` is the standard deviation of a point of weight 1.
fn of_choice(fits: &[(Candidate, Polynomial)], chosen: usize, std_unit: f64, x: &[f64]) -> f64 {
    // Where the standard deviations of the points are known the criterion needs no correction for small samples.
    let criterion = |candidate: &Candidate| match candidate.chi2 {
        Some(chi2) => Some(chi2 / std_unit.powi(2) + 2.0 * (candidate.order + 1) as f64),
        None => candidate.aicc,
    };
    let ends = extremes(x.iter().copied());
    let own = ends.map(|end| fits[chosen].1.evaluate_unscaled(end));
    let at_least = fits.iter().filter_map(|(candidate, _)| criterion(candidate)).fold(f64::INFINITY, f64::min);
    let (mut weights, mut weighed) = (0.0, [0.0; 2]);
    for (candidate, polynomial) in fits {
        let Some(value) = criterion(candidate) else { continue };
        let weight = (-(value - at_least) / 2.0).exp();
        weights += weight;
        for ((sum, end), (own, _)) in weighed.iter_mut().zip(ends).zip(own) {
            let (other, unit_std) = polynomial.evaluate_unscaled(end);
            *sum += weight * ((unit_std * std_unit).powi(2) + (other - own).powi(2));
        }
    }
    let factors = [0, 1].map(|end| (weighed[end] / weights).sqrt() / (own[end].1 * std_unit));
    let factor = factors[0].max(factors[1]);
    // Without a degree of freedom nothing is known of the scatter, and of the polynomial neither.
    if factor.is_nan() { 1.0 } else { factor.max(1.0) }
}

/// A sum of squares that chance exceeds less often than this shows that standard deviations are too small, and a scatter that is so small by
/// chance less often than this that an order is too low.
const UNLIKELY: f64 = 0.01;

/// Odds of scatter against a line through three points from which on the line is taken: what is lost is a slope whose uncertainty is too large, and
/// what a line by luck brings is a small uncertainty on a wrong one.
const NO_SCATTER: f64 = 0.001;

/// A polynomial through points with a scatter beside their own standard deviations, with its weights and the squares that it leaves.
fn scattered(
    [x, y, std]: [&[f64]; 3],
    scatter: f64,
    order: usize,
    limits: &Limits,
) -> Result<(Polynomial, Vec<f64>, f64), FitError> {
    let weights = weights_of(&std.iter().map(|s| s.hypot(scatter)).collect::<Vec<f64>>(), x.len())?;
    let fitted = polynomial::fit(x, y, Some(&weights), order, limits)?;
    let chi2 = fitted.residuals.iter().zip(&weights).map(|(r, w)| w * r * r).sum();
    Ok((fitted, weights, chi2))
}

/// Standard deviation of a scatter between points, beside their own standard deviations, with which the squares that a polynomial of an order leaves are
/// what their degrees of freedom let expect (Paule and Mandel 1982); 0 where they are no more than that without it.
///
/// # Errors
/// Those of [`polynomial::fit`] and for standard deviations that are not positive.
pub fn scatter(x: &[f64], y: &[f64], std: &[f64], order: usize, limits: &Limits) -> Result<f64, FitError> {
    let squares = |scatter: f64| -> Result<f64, FitError> {
        let (fitted, _, chi2) = scattered([x, y, std], scatter, order, limits)?;
        Ok(chi2 / fitted.dof.max(1) as f64)
    };
    if squares(0.0)? <= 1.0 {
        return Ok(0.0);
    }
    let [low, high] = extremes(y.iter().copied());
    // The squares fall as the scatter grows; with one as large as all differences they are less than one.
    let [_, found] = bisect(|scatter| squares(scatter).is_ok_and(|s| s > 1.0), [0.0, 2.0 * (high - low)], 1e-9);
    Ok(found)
}

/// What points scatter by about a polynomial of an order over what their standard deviations let expect; 1 without a degree of freedom.
///
/// # Errors
/// Those of [`polynomial::fit`] and for standard deviations that are not positive.
pub fn times(x: &[f64], y: &[f64], std: &[f64], order: usize, limits: &Limits) -> Result<f64, FitError> {
    let (fitted, _, chi2) = scattered([x, y, std], 0.0, order, limits)?;
    Ok(if fitted.dof > 0 { (chi2 / fitted.dof as f64).sqrt() } else { 1.0 })
}

/// Points from which on a scatter can be told from a slope: with fewer the criterion has no line beside it.
pub const LEAST_FOR_SCATTER: usize = 5;

/// The scatter of the order, up to a highest one, that is likeliest with it, by AICc with the scatter as a parameter; 0 where standard deviations
/// explain what their squares leave. Without it a high order that runs through the few points that are known best would need none. Of
/// [`LEAST_FOR_SCATTER`] points and more.
///
/// # Errors
/// Those of [`scatter`].
pub fn likely_scatter(x: &[f64], y: &[f64], std: &[f64], highest: usize, limits: &Limits) -> Result<f64, FitError> {
    let mut best = (f64::INFINITY, 0.0);
    for order in 0..=highest.min(HIGHEST_ORDER) {
        let (fitted, _, chi2) = match scattered([x, y, std], 0.0, order, limits) {
            Ok(found) => found,
            Err(FitError::Undetermined { .. }) => break,
            Err(error) => return Err(error),
        };
        let own = if excess(chi2, fitted.dof) > 1.0 { scatter(x, y, std, order, limits)? } else { 0.0 };
        let (_, weights, chi2) = scattered([x, y, std], own, order, limits)?;
        // Points of equal weight that would tell as much: what runs through all of them is confirmed by none.
        let effective = weights.iter().sum::<f64>().powi(2) / weights.iter().map(|w| w * w).sum::<f64>();
        if (order + 1) as f64 > effective - 1.0 {
            continue;
        }
        let deviance = chi2 - weights.iter().map(|w| w.ln()).sum::<f64>();
        let parameters = order + 1 + usize::from(own > 0.0);
        if let Some(value) = aicc(deviance, parameters, x.len())
            && value + TIE < best.0
        {
            best = (value, own);
        }
    }
    Ok(best.1)
}

/// Factor on standard deviations which a sum of squares asks for: `sqrt(chi2 / dof)` above the 99 % quantile, otherwise 1.
#[must_use]
pub fn excess(chi2: f64, dof: usize) -> f64 {
    if chi2_tail(chi2, dof as f64) < UNLIKELY { (chi2 / dof as f64).sqrt() } else { 1.0 }
}

fn weights_of(std: &[f64], rows: usize) -> Result<Vec<f64>, FitError> {
    require_length("standard deviations", rows, std.len())?;
    require_finite("standard deviations", std, rows)?;
    match std.iter().position(|&std| std <= 0.0) {
        Some(row) => Err(FitError::NotPositive { row }),
        None => Ok(std.iter().map(|std| std.powi(-2)).collect()),
    }
}

fn count_distinct(x: &[f64]) -> usize {
    let mut sorted = x.to_vec();
    sorted.sort_by(f64::total_cmp);
    // By value, for which zero has one sign only.
    sorted.dedup();
    sorted.len()
}

fn judge(polynomial: &Polynomial, order: usize, x: &[f64], weights: Option<&[f64]>) -> Candidate {
    let n = x.len() as f64;
    let weight = |i: usize| weights.map_or(1.0, |w| w[i]);
    let mean_weight = (0..x.len()).map(weight).sum::<f64>() / n;
    let sum: f64 = polynomial.residuals.iter().enumerate().map(|(i, r)| weight(i) * r * r).sum();
    let rss = sum / mean_weight;
    // AICc with k parameters; None where the correction has no value.
    let penalty = |k: usize| {
        let free = n - k as f64 - 1.0;
        (free > 0.0).then(|| 2.0 * k as f64 + 2.0 * k as f64 * (k as f64 + 1.0) / free)
    };
    let coefficients = order + 1;
    let scattering = penalty(coefficients + 1);
    let (aicc, excess_scatter) = if weights.is_some() {
        let as_given = penalty(coefficients).map(|penalty| sum + penalty);
        // The likelihood of a factor below one is not looked for: standard deviations are too small, not too large.
        let with_factor = scattering.filter(|_| sum > n).map(|penalty| n * (sum / n).ln() + n + penalty);
        match (as_given, with_factor) {
            (Some(given), Some(factor)) if factor < given => (Some(factor), true),
            _ => (as_given, false),
        }
    } else {
        (scattering.map(|penalty| n * (rss / n).ln() + penalty), false)
    };
    let leave_one_out = polynomial
        .residuals
        .iter()
        .enumerate()
        .map(|(i, residual)| {
            let (_, unit_std) = polynomial.evaluate_unscaled(x[i]);
            let freedom = 1.0 - weight(i) * unit_std.powi(2);
            (freedom > LEAST_FREEDOM).then(|| weight(i) * (residual / freedom).powi(2))
        })
        .sum::<Option<f64>>()
        .map(|sum| (sum / mean_weight / n).sqrt());
    let residual_std = if polynomial.dof > 0 { (rss / polynomial.dof as f64).sqrt() } else { f64::NAN };
    Candidate { order, dof: polynomial.dof, rss, residual_std, chi2: weights.map(|_| sum), aicc, excess_scatter, leave_one_out }
}

#[cfg(test)]
mod tests;
