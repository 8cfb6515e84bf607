//! White and slow noise in the residuals of a fit, and what slow noise does to its coefficients.
//!
//! Rows measured one after the other carry noise which remembers: it averages out in coefficients whose column changes sign
//! quickly and hardly at all in a mean or a trend. The noise of a right-hand side is modelled as `V = w D + s F`: white noise of
//! variance w in a row of mean weight, which the diagonal D spreads over the rows, and slow noise of variance s, whose correlation F is
//! that of a sum of relaxations with a power density of `f^-a` and a memory that ends with the record. Slower noise cannot be told from
//! the mean by the record itself; what it adds to the coefficient of a constant column is not included.
//!
//! The likelihood is the restricted one: the data are projected on the complement of the design, so that the coefficients drop
//! out. What every pair of variances then costs is in proportion to the rows (`projected`).
//!
//! **Averaged, not maximised.** Some ninety rows say little about the share of slow noise: pure white noise yields a maximum of zero half
//! of the time only, and intervals that trust the maximum hold the mean of a record with slow noise far too seldom. The covariance is
//! therefore averaged over the likelihood. Where rows are no means of samples, `a` is 1 and the share of slow noise has a mild prior (a
//! tenth at zero, the rest uniform in the root of the white share); the price is intervals of mean and trend that are 1.4 to 2.4 times as
//! wide as necessary where the noise is purely white. That the scatter between the rows grows with the reading is averaged over as below.
//!
//! **Inside the rows.** Where rows are means of samples, contrasts between neighbouring parts of a row tell white and slow noise
//! apart: the mean square of white noise falls with the length of the parts, that of 1/f noise does not ([`estimate_with`]). Rows
//! and contrasts share one spectrum, exact averages of relaxations over intervals, with these quantities:
//!
//! * white and slow noise of the samples, from contrasts at every octave and from the residuals; exponents other than 1 are tried where
//!   slow noise is probable at all;
//! * the white variance of the rows: what the samples let expect or, as probable beforehand, more, for scatter that comes between rows
//!   only, as where a field is set anew for every row. It is white from row to row: where the prior of it was a tenth, some of it was
//!   taken for slow noise, and intervals of gains held too seldom;
//! * how white noise differs between the rows: by the scatter of the samples of each, where that clearly changes with the reading or in
//!   time, or as scatter between the rows that grows with the reading: ten of ninety rows are large enough to tell a gain, and ten rows
//!   hardly tell whether their scatter grows, so that both are averaged over and not one of them chosen;
//! * with a small probability a steep noise between rows with nothing to do with the contrasts. It wins where the residuals show
//!   clearly more than what is inside the rows foretells, as with drifts.
//!
//! Heavy tails of samples need nothing: means of thousands of them are normal, and their variance is that of the contrasts.
//!
//! Coefficients then have a mixture of normal distributions, and their standard deviations are those with which 1.96 of them hold
//! 95 % of it. The prior gives white noise nine tenths, and every order of magnitude of slow noise from the white noise of a row
//! upwards the same part of the rest: for plateaus of 24 s and 1/f noise a corner above 0.004 Hz. Noise with a corner below that shows in
//! the slowest few waves of the record only and can double the uncertainty of the mean unseen; no rule holds both white noise and such
//! noise in 95 % of the cases. `reports/coverage.md` has the study with which the priors were chosen, and the cases they do not reach.

mod estimates;
mod kernel;
mod likelihood;
mod plausible;
mod projected;
mod relaxations;
mod spread;
#[cfg(test)]
mod tests;
mod together;

use kernel::{LONGER, SHORTER, mean_of_variances, octave_constants, time_constants};
use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use plausible::{Average, EXPONENTS, GROWTHS, Inside, Place};
use projected::Projected;
use relaxations::Relaxations;
pub use together::{Candidate, GroupNoise, NoiseKind, Origin, Pooled};

use super::NoiseModel;
use super::spectrum::parts;
use crate::fit::linear::Solution;
use crate::fit::scalar;
use crate::fit::statistics::{student_tail, two_sided_tail};
use crate::fit::{FitError, NORMAL_95, require_finite, require_length, student_95};

/// The noise of one right-hand side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ComponentNoise {
    /// Standard deviation of a row of mean weight, white and slow noise together, averaged over the likelihood.
    pub std: f64,
    /// Share of slow noise in the variance, averaged over the likelihood.
    pub share: f64,
    /// Standard deviation at the most likely share.
    pub most_likely_std: f64,
    /// Share of slow noise with the largest restricted likelihood, in \[0, 0.999\]; zero where slow noise does not help.
    pub most_likely_share: f64,
    /// Independent rows whose mean would be as uncertain as the mean of these rows.
    pub independent_rows: f64,
}

/// The noise of all right-hand sides of a fit and its effect on the coefficients.
#[derive(Clone, Debug)]
pub struct DenseNoise {
    /// One entry per right-hand side.
    pub noise: Vec<ComponentNoise>,
    /// Correlation of the residuals between right-hand sides, m x m.
    pub correlation: DMatrix<f64>,
    /// Standard deviation of a row of mean weight per right-hand side, noise taken as independent.
    independent_std: Vec<f64>,
    /// What the noise of every right-hand side may be.
    places: Vec<Vec<Place>>,
    /// Whether what is inside the rows told it, and the degrees of freedom of the fit.
    is_from_samples: bool,
    freedom: usize,
    /// What the least-squares coefficients make of the rows, p x n.
    response: DMatrix<f64>,
    /// Per right-hand side the averaged white variance of every row, and the averaged variance of the slow noise of each shape.
    white: Vec<DVector<f64>>,
    slow: Vec<Vec<f64>>,
    /// Slow noise of each shape that was tried.
    shapes: Vec<Shape>,
    /// How white noise differs between the rows, per right-hand side: by the samples, and with one of [`GROWTHS`] besides.
    spreads: Vec<Vec<DVector<f64>>>,
    /// Per right-hand side what was tried, with its likelihood; empty where only the residuals tell the noise.
    tried: Vec<Vec<Candidate>>,
}

/// Slow noise of one shape, rows of mean weight having unit variance.
#[derive(Clone, Debug)]
struct Shape {
    /// Its covariance between the rows.
    rows: Relaxations,
    /// What it does to the least-squares coefficients, p x p.
    coefficients: DMatrix<f64>,
}

impl Shape {
    fn of(rows: Relaxations, response: &DMatrix<f64>) -> Self {
        let coefficients = response * rows.times(&response.transpose());
        Self { coefficients: (&coefficients + coefficients.transpose()) * 0.5, rows }
    }
}

impl DenseNoise {
    /// Covariance of all coefficients, parameter j of right-hand side a at `a * p + j`.
    ///
    /// It is the one averaged over the likelihood of the noise, widened where the mixture needs it, or where only residuals tell the noise
    /// and independent noise alone would give more: noise that is white but taken for slow in part would leave too little for
    /// coefficients of columns that change sign quickly.
    ///
    /// Intervals of 95 %: 1.96 standard deviations where the noise is known from inside the rows, otherwise Student's t with the
    /// degrees of freedom of the fit.
    pub fn covariance(&self) -> DMatrix<f64> {
        let mut covariance = self.averaged_covariance();
        let p = self.response.nrows();
        let widening: Vec<f64> = (0..covariance.nrows())
            .map(|i| {
                let slow: Vec<f64> = self.shapes.iter().map(|shape| shape.coefficients[(i % p, i % p)]).collect();
                self.widening(i / p, &self.response.row(i % p).transpose(), &slow)
            })
            .collect();
        for (index, value) in covariance.iter_mut().enumerate() {
            *value *= widening[index % widening.len()] * widening[index / widening.len()];
        }
        covariance
    }

    /// Factor on the averaged standard deviation of an estimate from one right-hand side. `influence` is what it makes of the rows, `slow` its
    /// variance for slow noise of unit variance of each shape.
    fn widening(&self, a: usize, influence: &DVector<f64>, slow: &[f64]) -> f64 {
        let of = |rows: &DVector<f64>| influence.iter().zip(rows).map(|(g, v)| g * g * v).sum::<f64>();
        let averaged = of(&self.white[a]) + slow.iter().zip(&self.slow[a]).map(|(s, v)| s * v).sum::<f64>();
        let white: Vec<f64> = self.spreads[a].iter().map(of).collect();
        let freedom = (!self.is_from_samples).then_some(self.freedom);
        interval_factor(&self.places[a], &white, slow, averaged.sqrt(), freedom)
    }

    /// Probability that the noise of a right-hand side is steeper than 1/f, so that most of it is slower than the rows show; `None` where
    /// only residuals tell the noise.
    #[must_use]
    pub fn steep_probability(&self, a: usize) -> Option<f64> {
        let places = self.is_from_samples.then(|| &self.places[a])?;
        Some(places.iter().filter(|p| p.slow > 0.0 && p.kind.parameters.exponent > 1.0).map(|p| p.probability).sum())
    }

    /// What was tried for every right-hand side, with its likelihood; `None` where only residuals tell the noise.
    #[must_use]
    pub fn tried(&self) -> Option<&[Vec<Candidate>]> {
        self.is_from_samples.then_some(&self.tried)
    }

    /// Whether what is inside the rows told their noise: intervals are normal then, otherwise Student's.
    #[must_use]
    pub fn is_from_samples(&self) -> bool {
        self.is_from_samples
    }

    /// The covariance averaged over the likelihood of the noise.
    fn averaged_covariance(&self) -> DMatrix<f64> {
        let (p, m) = (self.response.nrows(), self.noise.len());
        let mut covariance = DMatrix::zeros(p * m, p * m);
        for a in 0..m {
            for b in 0..=a {
                let mut scaled = self.response.clone();
                for (i, mut column) in scaled.column_iter_mut().enumerate() {
                    column *= (self.white[a][i] * self.white[b][i]).sqrt();
                }
                let mut block = scaled * self.response.transpose();
                for (shape, (v, w)) in self.shapes.iter().zip(self.slow[a].iter().zip(&self.slow[b])) {
                    block += &shape.coefficients * (v * w).sqrt();
                }
                block *= self.correlation[(a, b)];
                covariance.view_mut((a * p, b * p), (p, p)).copy_from(&block);
                covariance.view_mut((b * p, a * p), (p, p)).copy_from(&block.transpose());
            }
        }
        covariance
    }

    /// Noise of a right-hand side as it is if it does not grow with the reading: what a model lacks grows with it as well, and would pass for
    /// such noise.
    #[must_use]
    pub fn without_growth(&self, component: usize) -> EvenNoise<'_> {
        let by_samples = &self.spreads[component][0];
        let own = || self.places[component].iter().filter(|p| !p.grows());
        let probability: f64 = own().map(|p| p.probability).sum();
        if probability <= 0.0 {
            // As much as the residuals scatter, independent from row to row.
            return EvenNoise { white: by_samples * self.independent_std[component].powi(2), slow: Vec::new() };
        }
        let mean = |of: &dyn Fn(&Place) -> f64| own().map(|p| p.probability * of(p)).sum::<f64>() / probability;
        let slow = self.shapes.iter().enumerate().map(|(index, shape)| {
            let variance = mean(&|p| if p.shape == index { p.slow } else { 0.0 });
            (&shape.rows, variance)
        });
        EvenNoise { white: by_samples * mean(&|p| p.white), slow: slow.filter(|(_, v)| *v > 0.0).collect() }
    }

    fn cholesky(&self, component: usize) -> Option<Cholesky<f64, Dyn>> {
        self.covariance_of_rows(component, &(0..self.rows()).collect::<Vec<_>>()).cholesky()
    }
}

/// Noise of one right-hand side that does not grow with the reading.
#[derive(Debug)]
pub struct EvenNoise<'a> {
    /// White variance of every row.
    white: DVector<f64>,
    /// Slow noise of every shape, with its variance.
    slow: Vec<(&'a Relaxations, f64)>,
}

impl EvenNoise<'_> {
    /// Variance of the sum of the rows, each times its element of a column.
    #[must_use]
    pub fn variance_of(&self, column: &DVector<f64>) -> f64 {
        let white: f64 = column.iter().zip(&self.white).map(|(c, v)| c * c * v).sum();
        white + self.slow.iter().map(|(rows, variance)| variance * rows.variance_of(column)).sum::<f64>()
    }
}

/// Factor on the averaged standard deviation of an estimate that makes the interval hold 95 % of what the places let expect, whose
/// distributions differ in width: the normal interval, or Student's with degrees of freedom where only residuals tell the noise. Noise that is white
/// but taken for slow in part would leave too little for coefficients of columns that change sign quickly: there no place is narrower than with
/// independent noise alone.
fn interval_factor(places: &[Place], white: &[f64], slow: &[f64], averaged: f64, freedom: Option<usize>) -> f64 {
    if averaged.is_nan() || averaged <= 0.0 {
        return 1.0;
    }
    let width = |p: &Place| {
        let white = white[p.growth.map_or(0, |g| g + 1)];
        (p.white * white + p.slow * slow.get(p.shape).unwrap_or(&0.0)).max(p.alone * white).sqrt()
    };
    if let [place] = places {
        return width(place) / averaged;
    }
    let widths: Vec<(f64, f64)> = places.iter().map(|p| (p.probability, width(p))).collect();
    let of_95 = freedom.map_or(NORMAL_95, student_95);
    let tail = |x: f64| freedom.map_or_else(|| two_sided_tail(x), |dof| 2.0 * student_tail(x, dof).unwrap_or(0.5));
    let outside = |x: f64| widths.iter().map(|(p, width)| p * tail(x / width)).sum::<f64>();
    let widest = widths.iter().map(|w| w.1).fold(0.0, f64::max);
    let [_, high] = scalar::bisect(|x| outside(x) > 0.05, [0.0, of_95 * widest], 1e-4);
    high / (of_95 * averaged)
}

/// Rows are those of positive weight.
impl NoiseModel for DenseNoise {
    fn rows(&self) -> usize {
        self.response.ncols()
    }

    fn covariance_of_rows(&self, component: usize, rows: &[usize]) -> DMatrix<f64> {
        let white = rows.iter().map(|row| self.white[component][*row]);
        let mut covariance = DMatrix::from_diagonal(&DVector::from_iterator(rows.len(), white));
        for (shape, variance) in self.shapes.iter().zip(&self.slow[component]).filter(|(_, v)| **v > 0.0) {
            covariance += shape.rows.of_rows(rows) * *variance;
        }
        covariance
    }

    fn whiten(&self, component: usize, columns: &mut DMatrix<f64>) {
        match self.cholesky(component) {
            Some(cholesky) if cholesky.l_dirty().solve_lower_triangular_mut(columns) => {}
            _ => columns.fill(f64::NAN),
        }
    }

    fn log_determinant(&self, component: usize) -> f64 {
        let cholesky = self.cholesky(component);
        cholesky.map_or(f64::NAN, |c| 2.0 * c.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>())
    }
}

/// Estimates the noise from the residuals of a fit whose row i was measured at `times[i]` (any unit, any order). Scatter may grow with
/// `readings`, a row per row and a column per right-hand side.
///
/// Weights of the fit scale the white part alone: `V = s² [(1 - φ) W⁻¹ + φ F]` with weights of mean one, which suits rows that
/// average different numbers of samples. Rows of weight zero do not count. Of a robust fit pass
/// [`Robust::pseudo`](crate::fit::robust::Robust::pseudo): its weights are no property of the noise.
///
/// Costs half a millisecond for 90 rows; up to some hundreds it grows with their cube, and in proportion to them beyond.
///
/// # Errors
///
/// [`FitError::Length`] and [`FitError::NotFinite`] for the times, [`FitError::NoNoise`] where the fit has no degree of
/// freedom or all rows the same time.
pub fn estimate(solution: &Solution, times: &[f64], readings: Option<&DMatrix<f64>>) -> Result<DenseNoise, FitError> {
    require_length("times", solution.residuals.nrows(), times.len())?;
    require_finite("times", times, times.len())?;
    if solution.dof == 0 {
        let why = "as many parameters as rows";
        return Err(FitError::NoNoise { why });
    }
    let times: Vec<f64> = solution.kept.iter().map(|&i| times[i]).collect();
    let time_constants = time_constants(&times)?;
    let fitted = Fitted::of(solution);
    let kernel = Relaxations::at(&times, &time_constants, &parts(&time_constants, EXPONENTS[0]));
    let even = Projected::of(&fitted, &fitted.by_weights, &kernel);
    let mut found = Vec::new();
    let mut spreads = Vec::new();
    for a in 0..fitted.residuals.ncols() {
        let mut tried = vec![(None, even.likelihood(a).estimate())];
        let mut spread = vec![fitted.by_weights.clone()];
        let readings = readings.map(|r| r.column(a).into_owned()).filter(|_| tried[0].1.noise.std > 0.0);
        if let Some(squares) = readings.and_then(|r| spread::may_grow(&fitted, solution, a, &fitted.by_weights, &r)) {
            for (growth, size) in GROWTHS.iter().enumerate() {
                let with = squares.zip_map(&fitted.by_weights, |u, s| s * (1.0 + size * u));
                let projected = Projected::of(&fitted, &with, &kernel);
                let mut grown = projected.likelihood(a).estimate();
                grown.deviance += projected.log_scale - even.log_scale;
                tried.push((Some(growth), grown));
                spread.push(with);
            }
        }
        let (noise, places) = plausible::of_residuals(&tried);
        found.push((noise, places, Vec::new()));
        spreads.push(spread);
    }
    Ok(fitted.model(solution, found, (vec![kernel], spreads), false))
}

/// Contrasts of one length inside the rows, which are means over intervals: differences of the means of neighbouring parts.
#[derive(Clone, Debug, PartialEq)]
pub struct Octave {
    /// Length of a part, in the unit of the times.
    pub length: f64,
    /// Number of contrasts.
    pub count: f64,
    /// Mean square for white noise of unit variance per sample.
    pub white: f64,
    /// Sum of the squares per right-hand side.
    pub squares: Vec<f64>,
}

/// What is inside rows that are means of samples.
#[derive(Clone, Copy, Debug)]
pub struct Sampled<'a> {
    /// Begin and end of the rows, in any unit of time and any order.
    pub intervals: &'a [[f64; 2]],
    /// Samples of the rows.
    pub counts: &'a [f64],
    /// Contrasts inside them.
    pub octaves: &'a [Octave],
    /// Variance of the samples of each row, and the reading with which noise may grow: a row per row, a column per right-hand side.
    pub scatter: Option<[&'a DMatrix<f64>; 2]>,
    /// What runs of the same sensor show together, if it is known; the right-hand sides are those of it.
    pub group: Option<&'a GroupNoise>,
}

/// Estimates the noise from the residuals and from what is inside the rows. A right-hand side without scatter inside its rows is left to
/// its residuals.
///
/// # Errors
///
/// Those of [`estimate`].
pub fn estimate_with(solution: &Solution, sampled: &Sampled) -> Result<DenseNoise, FitError> {
    let Sampled { intervals, counts, octaves, .. } = *sampled;
    require_length("intervals", solution.residuals.nrows(), intervals.len())?;
    require_length("counts of samples", solution.residuals.nrows(), counts.len())?;
    let middles: Vec<f64> = intervals.iter().map(|[begin, end]| 0.5 * (begin + end)).collect();
    let shortest = octaves.iter().map(|o| o.length).fold(f64::INFINITY, f64::min);
    let told = |a: usize| octaves.iter().any(|o| o.squares[a] > 0.0);
    if solution.dof == 0 || !(0..solution.residuals.ncols()).all(told) || !counts.iter().all(|n| *n > 0.0) {
        return estimate(solution, &middles, sampled.scatter.map(|s| s[1]));
    }
    require_finite("intervals", &middles, middles.len())?;
    let intervals: Vec<[f64; 2]> = solution.kept.iter().map(|&i| intervals[i]).collect();
    let begin = intervals.iter().map(|i| i[0]).fold(f64::INFINITY, f64::min);
    let end = intervals.iter().map(|i| i[1]).fold(f64::NEG_INFINITY, f64::max);
    let time_constants = octave_constants(shortest / SHORTER, LONGER * (end - begin));
    let fitted = Fitted::of(solution);
    // A row of mean weight has unit variance.
    let units = EXPONENTS.map(|e| 1.0 / mean_of_variances(&intervals, &time_constants, &parts(&time_constants, e)));
    let kernel = |shape: usize| {
        let parts: Vec<f64> = parts(&time_constants, EXPONENTS[shape]).iter().map(|part| part * units[shape]).collect();
        Relaxations::of_means(&intervals, &time_constants, &parts)
    };
    let mut kernels: Vec<Relaxations> = Vec::new();
    let mut of_gains: Vec<Relaxations> = Vec::new();
    let rows = fitted.by_weights.len() as f64;
    let inverse_samples =
        solution.kept.iter().zip(fitted.by_weights.iter()).map(|(&i, spread)| 1.0 / (counts[i] * spread)).sum::<f64>() / rows;
    let inside: Vec<Inside> = octaves.iter().map(|o| Inside::of(o, inverse_samples, &time_constants, units)).collect();
    // The same for all right-hand sides whose samples scatter alike in all rows.
    let mut shared: Vec<Option<Projected>> = EXPONENTS.iter().map(|_| None).collect();
    let mut found = Vec::new();
    let mut spreads = Vec::new();
    let scatter = sampled.scatter;
    for a in 0..fitted.residuals.ncols() {
        let by_samples =
            scatter.and_then(|s| spread::by_samples(&fitted, solution, &intervals, s.map(|m| m.column(a).into_owned()), counts));
        let own_spread = by_samples.or_else(|| {
            let variances = scatter.map(|s| s[0].column(a).into_owned());
            spread::by_rows(&fitted, solution, a, counts, variances.as_ref())
        });
        let own = own_spread.is_some();
        let base = own_spread.unwrap_or_else(|| fitted.by_weights.clone());
        let mut spread = vec![base.clone()];
        let pooled = sampled.group.and_then(|group| group.components.get(a));
        let mut average = Average::new(&inside, octaves.iter().map(|o| o.squares[a] / o.count).collect(), pooled);
        let mut log_scale = 0.0;
        for shape in 0..EXPONENTS.len() {
            if shape > 0 && !average.suspects_slow_noise() {
                break;
            }
            if kernels.len() == shape {
                kernels.push(kernel(shape));
            }
            let mut own_projected = None;
            let place = if own { &mut own_projected } else { &mut shared[shape] };
            let projected = place.get_or_insert_with(|| Projected::of(&fitted, &base, &kernels[shape]));
            average.try_shape(shape, projected.likelihood(a));
            log_scale = projected.log_scale;
        }
        let readings = scatter.map(|s| s[1].column(a).into_owned());
        if let Some(squares) = readings.as_ref().and_then(|r| spread::may_grow(&fitted, solution, a, &base, r)) {
            // Slow noise that is improbable without growth is left out beside it as well: its covariance is all of the cost.
            let is_slow = average.suspects_slow_noise();
            for (growth, size) in GROWTHS.iter().enumerate() {
                let with = squares.zip_map(&base, |u, s| s * (1.0 + size * u));
                let projected =
                    if is_slow { Projected::of(&fitted, &with, &kernels[0]) } else { Projected::white(&fitted, &with) };
                average.try_growth((growth, is_slow), projected.likelihood(a), projected.log_scale - log_scale);
                spread.push(with);
            }
        }
        if let Some(loads) = readings.and_then(|r| spread::gain_moves(&fitted, solution, a, &base, &r)) {
            let kernel = kernels[0].scaled(|row| loads[row]);
            average.try_gain(EXPONENTS.len() + of_gains.len(), Projected::of(&fitted, &base, &kernel).likelihood(a));
            of_gains.push(kernel);
        }
        found.push(average.finish());
        spreads.push(spread);
    }
    // Those that were not tried are left out.
    let first_gain = kernels.len();
    kernels.extend(of_gains);
    for place in found.iter_mut().flat_map(|f: &mut (ComponentNoise, Vec<Place>, Vec<Candidate>)| &mut f.1) {
        if let Some(gain) = place.shape.checked_sub(EXPONENTS.len()) {
            place.shape = first_gain + gain;
        }
    }
    Ok(fitted.model(solution, found, (kernels, spreads), true))
}

/// What the noise needs of a fit: rows of positive weight, and weights of mean one.
struct Fitted {
    /// Columns of the fit scaled to a norm of about one, n x p.
    columns: DMatrix<f64>,
    residuals: DMatrix<f64>,
    /// White variance of rows by their weights: that of a row of mean weight is one.
    by_weights: DVector<f64>,
    response: DMatrix<f64>,
    /// Part of each row that the fit takes for itself.
    leverage: DVector<f64>,
}

impl Fitted {
    fn of(solution: &Solution) -> Self {
        let n = solution.kept.len();
        let roots = DVector::from_column_slice(&solution.root_weights);
        let mean_weight = roots.norm_squared() / n as f64;
        let residuals = DMatrix::from_fn(n, solution.residuals.ncols(), |i, a| solution.residuals[(solution.kept[i], a)]);
        let (q, r) = (solution.factors.q(), solution.factors.r());
        // The columns of the weighted design are Q R; of the coefficients R⁻¹ Qᵀ times the scales.
        let leverage = DVector::from_fn(n, |i, _| q.row(i).norm_squared());
        let mut columns = &q * &r;
        let mut response = q.transpose();
        r.solve_upper_triangular_mut(&mut response);
        for (i, root) in roots.iter().enumerate() {
            columns.row_mut(i).scale_mut(1.0 / root);
            response.column_mut(i).scale_mut(*root);
        }
        for (j, scale) in solution.scales.iter().enumerate() {
            response.row_mut(j).scale_mut(*scale);
        }
        Self { leverage, columns, residuals, by_weights: roots.map(|r| mean_weight / (r * r)), response }
    }

    fn model(
        self,
        solution: &Solution,
        found: Vec<(ComponentNoise, Vec<Place>, Vec<Candidate>)>,
        (kernels, spreads): (Vec<Relaxations>, Vec<Vec<DVector<f64>>>),
        is_from_samples: bool,
    ) -> DenseNoise {
        let (mut noise, mut places, mut tried) = (Vec::new(), Vec::new(), Vec::new());
        for (of_noise, of_places, of_tried) in found {
            noise.push(of_noise);
            places.push(of_places);
            tried.push(of_tried);
        }
        let mut white = Vec::new();
        let mut slow = Vec::new();
        for (places, spread) in places.iter().zip(&spreads) {
            let mut rows = DVector::zeros(self.by_weights.len());
            let mut shapes = vec![0.0; kernels.len()];
            for place in places {
                rows += &spread[place.growth.map_or(0, |g| g + 1)] * (place.probability * place.white);
                shapes[place.shape] += place.probability * place.slow;
            }
            white.push(rows);
            slow.push(shapes);
        }
        let n = self.by_weights.len() as f64;
        let weights = self.by_weights.map(|s| 1.0 / s);
        let total = weights.sum();
        let means: Vec<f64> = kernels.iter().map(|k| k.variance_of(&weights) / (total * total)).collect();
        for (a, noise) in noise.iter_mut().enumerate() {
            let of_slow: f64 = slow[a].iter().zip(&means).map(|(v, m)| v * m).sum();
            let variance = noise.std * noise.std;
            noise.independent_rows = if variance > 0.0 { variance / ((1.0 - noise.share) * variance / n + of_slow) } else { n };
        }
        let roots = self.by_weights.map(|s| s.sqrt());
        let weighted = DMatrix::from_fn(self.residuals.nrows(), self.residuals.ncols(), |i, a| self.residuals[(i, a)] / roots[i]);
        let mean_weight = solution.root_weights.iter().map(|r| r * r).sum::<f64>() / n;
        DenseNoise {
            noise,
            correlation: correlation(&weighted),
            independent_std: solution.residual_std.iter().map(|std| std / mean_weight.sqrt()).collect(),
            places,
            is_from_samples,
            freedom: solution.dof,
            shapes: kernels.into_iter().map(|k| Shape::of(k, &self.response)).collect(),
            response: self.response,
            white,
            slow,
            spreads,
            tried,
        }
    }
}

/// Correlation of the columns about zero; a column of zeros correlates with itself alone.
fn correlation(residuals: &DMatrix<f64>) -> DMatrix<f64> {
    let products = residuals.tr_mul(residuals);
    DMatrix::from_fn(products.nrows(), products.ncols(), |a, b| {
        let norm = (products[(a, a)] * products[(b, b)]).sqrt();
        match (a == b, norm > 0.0) {
            (true, _) => 1.0,
            (false, true) => products[(a, b)] / norm,
            (false, false) => 0.0,
        }
    })
}
