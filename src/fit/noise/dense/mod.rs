//! White and slow noise in the residuals of a fit, and what slow noise does to its coefficients.
//!
//! Rows measured one after the other carry noise which remembers: it averages out in coefficients whose column changes sign
//! quickly and hardly at all in a mean or a trend. The noise of a right-hand side is modelled as
//! `V = s² [(1 - φ) I + φ F]`, a white part and a slow part of share φ, where `F_ij` is the mean over k of
//! `exp(-|t_i - t_j| / τ_k)` with time constants from the median spacing to the span of the record in steps near four: a
//! 1/f noise whose memory ends with the record. Slower noise cannot be told from the mean by the record itself; what it adds
//! to the coefficient of a constant column is not included.
//!
//! The likelihood of φ is the restricted one: the data are projected on the complement of the design, so that the
//! coefficients drop out. Reducing the projected `F` to tridiagonal form once makes it O(n) for every φ.
//!
//! **Averaged, not maximised.** Some ninety rows say little about φ: pure white noise yields a maximum of zero half of the
//! time only, and intervals that trust the maximum hold the mean of a record with slow noise far too seldom. The covariance is
//! therefore averaged over the likelihood of φ with a mild prior (a tenth at zero, the rest uniform in `sqrt(1 - φ)`). The price:
//! where the noise is purely white, intervals of mean and trend are 1.4 to 2.4 times as wide as necessary.
//!
//! **Inside the rows.** Where rows are means of samples, contrasts between neighbouring parts of a row tell white and 1/f noise
//! apart: the mean square of white noise falls with the length of the parts, that of 1/f noise does not ([`estimate_with`]). Rows
//! and contrasts share one spectrum, exact averages of exponential correlations over intervals, with three quantities:
//!
//! * white and 1/f noise of the samples, from contrasts at every octave and from the residuals;
//! * the white variance of the rows: what the samples let expect, or with a small prior probability another one, for scatter that
//!   comes between rows only;
//! * with a smaller one a slow noise between rows with nothing to do with the contrasts. It wins where the residuals show clearly
//!   more than what is inside the rows foretells, as with drifts.
//!
//! Coefficients then have a mixture of normal distributions, and their standard deviations are those with which 1.96 of them hold
//! 95 % of it. The prior gives white noise nine tenths, and every order of magnitude of 1/f noise from twice the white noise of a row
//! upwards the same part of the rest: for plateaus of 24 s a corner above 0.007 Hz. ComponentNoise with a corner below that shows in the
//! slowest few waves of the record only and can double the uncertainty of the mean unseen; no rule holds both white noise and such
//! noise in 95 % of the cases.

mod estimates;
mod kernel;
mod likelihood;
#[cfg(test)]
mod tests;

use kernel::{LONGER, SHORTER, contrast_variance, kernel, mean_kernel, octave_constants, slow_kernel, time_constants};
use likelihood::{INDEPENDENT, Inside, Likelihood, Place};
use nalgebra::linalg::SymmetricTridiagonal;
use nalgebra::{DMatrix, DMatrixView, DVector};

use super::NoiseModel;
use crate::fit::linear::Solution;
use crate::fit::scalar;
use crate::fit::statistics::two_sided_tail;
use crate::fit::{FitError, NORMAL_95, require_finite, require_length};

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
    /// Time constants of the slow noise, ascending, in the unit of the times.
    pub time_constants: Vec<f64>,
    /// Correlation of the residuals between right-hand sides, m x m.
    pub correlation: DMatrix<f64>,
    /// Standard deviation of a row of mean weight per right-hand side, noise taken as independent.
    independent_std: Vec<f64>,
    /// What the noise of every right-hand side may be; empty where only the residuals tell it.
    places: Vec<Vec<Place>>,
    /// The times over which the rows were taken, in the unit of the times, and the roots of their weights of mean one.
    intervals: Vec<[f64; 2]>,
    roots: Vec<f64>,
    /// Covariance of the coefficients for white noise of unit variance, p x p.
    white: DMatrix<f64>,
    /// Covariance of the least-squares coefficients for slow noise of unit variance, p x p.
    slow: DMatrix<f64>,
}

impl DenseNoise {
    /// Covariance of all coefficients, parameter j of right-hand side a at `a * p + j`.
    ///
    /// It is the one averaged over the likelihood of the share, widened where independent noise alone would give more: noise that is
    /// white but taken for slow in part would leave too little for coefficients of columns that change sign quickly.
    ///
    /// Intervals of 95 %: 1.96 standard deviations where the noise is known from inside the rows, otherwise Student's t with the
    /// degrees of freedom of the fit.
    pub fn covariance(&self) -> DMatrix<f64> {
        let mut covariance = self.averaged_covariance();
        let p = self.white.nrows();
        let widening: Vec<f64> = (0..covariance.nrows())
            .map(|i| self.widening(i / p, self.white[(i % p, i % p)], self.slow[(i % p, i % p)]))
            .collect();
        for (index, value) in covariance.iter_mut().enumerate() {
            *value *= widening[index % widening.len()] * widening[index / widening.len()];
        }
        covariance
    }

    /// Factor on the averaged standard deviation of an estimate from one right-hand side, whose variance is `white` and `slow` for noise
    /// of unit variance of either kind.
    fn widening(&self, a: usize, white: f64, slow: f64) -> f64 {
        if let Some(places) = self.places.get(a) {
            return interval_factor(places, white, slow);
        }
        let ComponentNoise { std, share, .. } = self.noise[a];
        let independent = self.independent_std[a].powi(2) * white;
        let averaged = std.powi(2) * ((1.0 - share) * white + share * slow);
        if averaged > 0.0 { (independent / averaged).max(1.0).sqrt() } else { 1.0 }
    }

    /// Whether what is inside the rows told their noise: intervals are normal then, otherwise Student's.
    #[must_use]
    pub fn is_from_samples(&self) -> bool {
        !self.places.is_empty()
    }

    /// The covariance averaged over the likelihood of the share of slow noise.
    fn averaged_covariance(&self) -> DMatrix<f64> {
        self.stacked(|noise| (noise.std, noise.share))
    }

    /// The same at the most likely shares: narrower, and too narrow for means and trends where the noise is slow.
    pub fn most_likely_covariance(&self) -> DMatrix<f64> {
        self.stacked(|noise| (noise.most_likely_std, noise.most_likely_share))
    }

    fn stacked(&self, std_and_share: impl Fn(&ComponentNoise) -> (f64, f64)) -> DMatrix<f64> {
        let p = self.white.nrows();
        let parts: Vec<(f64, f64)> = self.noise.iter().map(std_and_share).collect();
        DMatrix::from_fn(p * parts.len(), p * parts.len(), |row, column| {
            let (j, k) = (row % p, column % p);
            let ((s_a, phi_a), (s_b, phi_b)) = (parts[row / p], parts[column / p]);
            let white = ((1.0 - phi_a) * (1.0 - phi_b)).sqrt() * self.white[(j, k)];
            let slow = (phi_a * phi_b).sqrt() * self.slow[(j, k)];
            self.correlation[(row / p, column / p)] * s_a * s_b * (white + slow)
        })
    }
}

/// Factor on the averaged standard deviation of an estimate that makes the normal interval hold 95 % of what the places let expect: their
/// normal distributions differ in width.
fn interval_factor(places: &[Place], white: f64, slow: f64) -> f64 {
    let widths: Vec<(f64, f64)> = places.iter().map(|p| (p.probability, (p.white * white + p.slow * slow).sqrt())).collect();
    let averaged = widths.iter().map(|(p, width)| p * width * width).sum::<f64>().sqrt();
    if averaged.is_nan() || averaged <= 0.0 {
        return 1.0;
    }
    let outside = |x: f64| widths.iter().map(|(p, width)| p * two_sided_tail(x / width)).sum::<f64>();
    let widest = widths.iter().map(|w| w.1).fold(0.0, f64::max);
    let [_, high] = scalar::bisect(|x| outside(x) > 0.05, [0.0, NORMAL_95 * widest], 1e-4);
    high / (NORMAL_95 * averaged)
}

/// Rows are those of positive weight.
impl NoiseModel for DenseNoise {
    fn rows(&self) -> usize {
        self.intervals.len()
    }

    fn covariance_of_rows(&self, component: usize, rows: &[usize]) -> DMatrix<f64> {
        let ComponentNoise { std, share, .. } = self.noise[component];
        let slow = slow_kernel(&self.intervals, &self.time_constants);
        DMatrix::from_fn(rows.len(), rows.len(), |i, j| {
            let (row, column) = (rows[i], rows[j]);
            let white = if row == column { (1.0 - share) / self.roots[row].powi(2) } else { 0.0 };
            std * std * (white + share * slow[(row, column)])
        })
    }

    fn whiten(&self, component: usize, columns: &mut DMatrix<f64>) {
        match self.covariance_of_rows(component, &(0..self.rows()).collect::<Vec<_>>()).cholesky() {
            Some(cholesky) if cholesky.l_dirty().solve_lower_triangular_mut(columns) => {}
            _ => columns.fill(f64::NAN),
        }
    }

    fn log_determinant(&self, component: usize) -> f64 {
        let cholesky = self.covariance_of_rows(component, &(0..self.rows()).collect::<Vec<_>>()).cholesky();
        cholesky.map_or(f64::NAN, |c| 2.0 * c.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>())
    }
}

/// Estimates the noise from the residuals of a fit whose row i was measured at `times[i]` (any unit, any order).
///
/// Weights of the fit scale the white part alone: `V = s² [(1 - φ) W⁻¹ + φ F]` with weights of mean one, which suits rows that
/// average different numbers of samples. Rows of weight zero do not count. Of a robust fit pass
/// [`Robust::pseudo`](crate::fit::robust::Robust::pseudo): its weights are no property of the noise.
///
/// Costs O(n³): half a millisecond for 90 rows, half a second and 50 MB for 1000.
///
/// # Errors
///
/// [`FitError::Length`] and [`FitError::NotFinite`] for the times, [`FitError::NoNoise`] where the fit has no degree of
/// freedom or all rows the same time.
pub fn estimate(solution: &Solution, times: &[f64]) -> Result<DenseNoise, FitError> {
    require_length("times", solution.residuals.nrows(), times.len())?;
    require_finite("times", times, times.len())?;
    if solution.dof == 0 {
        let why = "as many parameters as rows";
        return Err(FitError::NoNoise { why });
    }
    let times: Vec<f64> = solution.kept.iter().map(|&i| times[i]).collect();
    let time_constants = time_constants(&times)?;
    let roots = roots(solution);
    let projected = Projected::of(solution, &kernel(&times, &time_constants, &roots), &roots);
    let noise = (0..projected.data.ncols()).map(|a| projected.likelihood(a).estimate()).collect();
    let instants = times.iter().map(|t| [*t; 2]).collect();
    Ok(projected.model(solution, noise, Vec::new(), time_constants, (instants, &roots)))
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

/// Estimates the noise from the residuals and from contrasts inside the rows: row i is the mean of `samples[i]` samples over
/// `intervals[i]`. A right-hand side without scatter inside its rows is left to its residuals.
///
/// # Errors
///
/// Those of [`estimate`].
pub fn estimate_with(
    solution: &Solution,
    intervals: &[[f64; 2]],
    samples: &[f64],
    octaves: &[Octave],
) -> Result<DenseNoise, FitError> {
    require_length("intervals", solution.residuals.nrows(), intervals.len())?;
    require_length("counts of samples", solution.residuals.nrows(), samples.len())?;
    let middles: Vec<f64> = intervals.iter().map(|[begin, end]| 0.5 * (begin + end)).collect();
    let shortest = octaves.iter().map(|o| o.length).fold(f64::INFINITY, f64::min);
    let told = |a: usize| octaves.iter().any(|o| o.squares[a] > 0.0);
    if solution.dof == 0 || !(0..solution.residuals.ncols()).all(told) || !samples.iter().all(|n| *n > 0.0) {
        return estimate(solution, &middles);
    }
    require_finite("intervals", &middles, middles.len())?;
    let intervals: Vec<[f64; 2]> = solution.kept.iter().map(|&i| intervals[i]).collect();
    let begin = intervals.iter().map(|i| i[0]).fold(f64::INFINITY, f64::min);
    let end = intervals.iter().map(|i| i[1]).fold(f64::NEG_INFINITY, f64::max);
    let time_constants = octave_constants(shortest / SHORTER, LONGER * (end - begin));
    let mut kernel = mean_kernel(&intervals, &time_constants);
    // A row of mean weight has unit variance.
    let unit = 1.0 / kernel.diagonal().mean();
    let roots = roots(solution);
    for j in 0..kernel.ncols() {
        for i in 0..kernel.nrows() {
            kernel[(i, j)] *= unit * roots[i] * roots[j];
        }
    }
    let projected = Projected::of(solution, &kernel, &roots);
    let inverse_samples =
        solution.kept.iter().zip(roots.iter()).map(|(&i, root)| root * root / samples[i]).sum::<f64>() / roots.len() as f64;
    let inside: Vec<Inside> = octaves
        .iter()
        .map(|o| Inside {
            count: INDEPENDENT * o.count,
            white: o.white / inverse_samples,
            slow: unit * contrast_variance(o.length, &time_constants),
        })
        .collect();
    let (noise, places) = (0..projected.data.ncols())
        .map(|a| {
            let mean_squares: Vec<f64> = octaves.iter().map(|o| o.squares[a] / o.count).collect();
            projected.likelihood(a).estimate_with(&inside, &mean_squares)
        })
        .unzip();
    Ok(projected.model(solution, noise, places, time_constants, (intervals, &roots)))
}

/// Roots of weights of mean one: rows are multiplied by them, which makes their white noise equal.
fn roots(solution: &Solution) -> DVector<f64> {
    let roots = DVector::from_column_slice(&solution.root_weights);
    let mean_weight = roots.norm_squared() / roots.len() as f64;
    roots / mean_weight.sqrt()
}

/// A fit with its slow covariance, split into what acts on the coefficients and what acts on the residuals.
struct Projected {
    /// Diagonals of the tridiagonal form of the slow covariance of what the design cannot explain.
    diagonal: DVector<f64>,
    off_diagonal: DVector<f64>,
    /// What the design cannot explain, in the coordinates of that form.
    data: DMatrix<f64>,
    correlation: DMatrix<f64>,
    /// Covariance of the coefficients for slow noise of unit variance, rows of mean weight.
    slow: DMatrix<f64>,
    mean_weight: f64,
    rows: f64,
    /// Rows whose mean would be as uncertain if they were independent as the mean of these rows is with slow noise alone.
    slow_rows: f64,
}

impl Projected {
    fn of(solution: &Solution, kernel: &DMatrix<f64>, roots: &DVector<f64>) -> Self {
        let (n, p) = (solution.kept.len(), solution.unscaled_covariance.nrows());
        let mean_weight = solution.root_weights.iter().map(|r| r * r).sum::<f64>() / n as f64;
        let residuals =
            DMatrix::from_fn(n, solution.residuals.ncols(), |i, a| solution.residuals[(solution.kept[i], a)] * roots[i]);
        // Qᵀ F Q: its upper left corner acts on the coefficients, its lower right corner on what the design cannot explain.
        let mut rotated = kernel.clone();
        solution.factors.q_tr_mul(&mut rotated);
        rotated.transpose_mut();
        solution.factors.q_tr_mul(&mut rotated);
        let mut unexplained = residuals.clone();
        solution.factors.q_tr_mul(&mut unexplained);
        let corner = rotated.view((p, p), (n - p, n - p)).into_owned();
        let (q, diagonal, off_diagonal) = SymmetricTridiagonal::new(corner).unpack();
        Self {
            diagonal,
            off_diagonal,
            data: q.tr_mul(&unexplained.rows(p, n - p)),
            correlation: correlation(&residuals),
            slow: slow_covariance(solution, rotated.view((0, 0), (p, p))) * mean_weight,
            mean_weight,
            rows: n as f64,
            slow_rows: n as f64 / (roots.dot(&(kernel * roots)) / n as f64),
        }
    }

    fn likelihood(&self, a: usize) -> Likelihood<'_> {
        let n = self.data.nrows();
        let data = &self.data.as_slice()[a * n..(a + 1) * n];
        Likelihood { diagonal: self.diagonal.as_slice(), off_diagonal: self.off_diagonal.as_slice(), data }
    }

    /// `intervals` and `roots` are those of the rows of positive weight.
    fn model(
        self,
        solution: &Solution,
        mut noise: Vec<ComponentNoise>,
        places: Vec<Vec<Place>>,
        time_constants: Vec<f64>,
        (intervals, roots): (Vec<[f64; 2]>, &DVector<f64>),
    ) -> DenseNoise {
        for noise in &mut noise {
            noise.independent_rows = 1.0 / ((1.0 - noise.share) / self.rows + noise.share / self.slow_rows);
        }
        let independent = |std: &f64| std / self.mean_weight.sqrt();
        DenseNoise {
            noise,
            time_constants,
            independent_std: solution.residual_std.iter().map(independent).collect(),
            // Rows of mean weight have unit variance here, rows of unit weight in the solution.
            intervals,
            roots: roots.as_slice().to_vec(),
            white: &solution.unscaled_covariance * self.mean_weight,
            slow: self.slow,
            correlation: self.correlation,
            places,
        }
    }
}

/// `(XᵀX)⁻¹ XᵀFX (XᵀX)⁻¹` of the weighted design, from `Q₁ᵀ F Q₁`: the sandwich is `R⁻¹ (Q₁ᵀ F Q₁) R⁻ᵀ`.
fn slow_covariance(solution: &Solution, rotated: DMatrixView<f64>) -> DMatrix<f64> {
    let r = solution.factors.r();
    let mut inverse = DMatrix::identity(r.ncols(), r.ncols());
    // A singular R was refused by the solver; its columns carry the scales of the design.
    r.solve_upper_triangular_mut(&mut inverse);
    let scales = DMatrix::from_diagonal(&DVector::from_column_slice(&solution.scales));
    let inverse = scales * inverse;
    let sandwich = &inverse * rotated * inverse.transpose();
    (&sandwich + sandwich.transpose()) * 0.5
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
