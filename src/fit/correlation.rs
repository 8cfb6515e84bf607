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
//! upwards the same part of the rest: for plateaus of 24 s a corner above 0.007 Hz. Noise with a corner below that shows in the
//! slowest few waves of the record only and can double the uncertainty of the mean unseen; no rule holds both white noise and such
//! noise in 95 % of the cases.

use nalgebra::linalg::SymmetricTridiagonal;
use nalgebra::{DMatrix, DMatrixView, DVector};

use super::linear::Solution;
use super::scalar::{self, Stop};
use super::statistics::two_sided_tail;
use super::{FitError, NORMAL_95, require_finite, require_length};

/// Nominal ratio of neighbouring time constants.
const TIME_STEP: f64 = 4.0;
/// Largest share of slow noise; below one, so that the covariance stays regular whatever the times.
const MAX_SHARE: f64 = 0.999;
/// Nodes between no slow noise and `MAX_SHARE`, equidistant in the angle whose squared sine is the share.
const NODES: usize = 48;
/// Prior probability that there is no slow noise at all.
const PRIOR_WHITE: f64 = 0.1;
/// Shortest time constant of noise seen inside the rows, as a part of the shortest contrast: faster noise is white there.
const SHORTER: f64 = 8.0;
/// Nominal ratio of its neighbouring time constants.
const OCTAVE_STEP: f64 = 3.0;
/// Correlations that do not matter.
const NEGLIGIBLE: f64 = 1e-12;
/// Longest time constant as a part of the record: half way between the usual meanings of a cutoff at its inverse.
const LONGER: f64 = 1.3;
/// Prior probability that the samples carry white noise alone.
const PRIOR_NONE: f64 = 0.9;
/// Smallest and largest ratio of slow to white noise in a row, and how many in between: less cannot be told from none, more is slow noise
/// alone.
const LEAST_RATIO: f64 = 2.0;
const MOST_RATIO: f64 = 1e5;
const RATIOS: usize = 29;
/// Contrasts of 1/f noise are not quite independent: they count as this part of their number.
const INDEPENDENT: f64 = 0.8;
/// Prior probability of slow noise between the rows that what is inside them does not show, and its variances over the white one.
const PRIOR_APART: f64 = 0.002;
const APART_SIZES: [f64; 11] = [3.0, 10.0, 30.0, 1e2, 3e2, 1e3, 3e3, 1e4, 3e4, 1e5, 1e6];
/// Prior probability that rows scatter by more than their samples let expect, as where a field is set anew for every row, and the range
/// of the factors.
const PRIOR_EXCESS: f64 = 0.1;
const LEAST_EXCESS: f64 = 1.26;
const MOST_EXCESS: f64 = 1e5;
const EXCESSES: usize = 26;
/// The same for less scatter: noise that is not white between the samples, a tone for example, averages out in a row.
const PRIOR_LACK: f64 = 0.02;
const LACKS: [f64; 4] = [0.6, 0.3, 0.1, 0.01];
/// Deviance beyond the lowest of what the contrasts rule out.
const IMPROBABLE: f64 = 25.0;
/// Places less probable are left out.
const NO_PLACE: f64 = 1e-4;

/// The noise of one right-hand side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Noise {
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

/// A white and a slow variance of a row of mean weight, and how probable they are.
#[derive(Clone, Copy, Debug)]
struct Place {
    probability: f64,
    white: f64,
    slow: f64,
}

/// The noise of all right-hand sides of a fit and its effect on the coefficients.
#[derive(Clone, Debug)]
pub struct NoiseModel {
    /// One entry per right-hand side.
    pub noise: Vec<Noise>,
    /// Time constants of the slow noise, ascending, in the unit of the times.
    pub time_constants: Vec<f64>,
    /// Correlation of the residuals between right-hand sides, m x m.
    pub correlation: DMatrix<f64>,
    /// Standard deviation of a row of mean weight per right-hand side, noise taken as independent.
    independent_std: Vec<f64>,
    /// What the noise of every right-hand side may be; empty where only the residuals tell it.
    places: Vec<Vec<Place>>,
    /// Covariance of the coefficients for white noise of unit variance, p x p.
    white: DMatrix<f64>,
    /// Covariance of the least-squares coefficients for slow noise of unit variance, p x p.
    slow: DMatrix<f64>,
}

impl NoiseModel {
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
            .map(|i| {
                if let Some(places) = self.places.get(i / p) {
                    return self.interval_factor(places, i % p);
                }
                let independent = self.independent_std[i / p].powi(2) * self.white[(i % p, i % p)];
                let averaged = covariance[(i, i)];
                if averaged > 0.0 { (independent / averaged).max(1.0).sqrt() } else { 1.0 }
            })
            .collect();
        for (index, value) in covariance.iter_mut().enumerate() {
            *value *= widening[index % widening.len()] * widening[index / widening.len()];
        }
        covariance
    }

    /// Factor on the averaged standard deviation of coefficient j that makes the normal interval hold 95 % of what the places let
    /// expect: their normal distributions differ in width.
    fn interval_factor(&self, places: &[Place], j: usize) -> f64 {
        let (white, slow) = (self.white[(j, j)], self.slow[(j, j)]);
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

    fn stacked(&self, std_and_share: impl Fn(&Noise) -> (f64, f64)) -> DMatrix<f64> {
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

/// Estimates the noise from the residuals of a fit whose row i was measured at `times[i]` (any unit, any order).
///
/// Weights of the fit scale the white part alone: `V = s² [(1 - φ) W⁻¹ + φ F]` with weights of mean one, which suits rows that
/// average different numbers of samples. Rows of weight zero do not count. Of a robust fit pass
/// [`Robust::pseudo`](super::robust::Robust::pseudo): its weights are no property of the noise.
///
/// Costs O(n³): half a millisecond for 90 rows, half a second and 50 MB for 1000.
///
/// # Errors
///
/// [`FitError::Length`] and [`FitError::NotFinite`] for the times, [`FitError::NoNoise`] where the fit has no degree of
/// freedom or all rows the same time.
pub fn estimate(solution: &Solution, times: &[f64]) -> Result<NoiseModel, FitError> {
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
    Ok(projected.model(solution, noise, Vec::new(), time_constants))
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
) -> Result<NoiseModel, FitError> {
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
    Ok(projected.model(solution, noise, places, time_constants))
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

    fn model(self, solution: &Solution, mut noise: Vec<Noise>, places: Vec<Vec<Place>>, time_constants: Vec<f64>) -> NoiseModel {
        for noise in &mut noise {
            noise.independent_rows = 1.0 / ((1.0 - noise.share) / self.rows + noise.share / self.slow_rows);
        }
        let independent = |std: &f64| std / self.mean_weight.sqrt();
        NoiseModel {
            noise,
            time_constants,
            independent_std: solution.residual_std.iter().map(independent).collect(),
            // Rows of mean weight have unit variance here, rows of unit weight in the solution.
            white: &solution.unscaled_covariance * self.mean_weight,
            slow: self.slow,
            correlation: self.correlation,
            places,
        }
    }
}

/// Time constants of a 1/f noise from `shortest` to `longest` in equal ratios near `OCTAVE_STEP`.
fn octave_constants(shortest: f64, longest: f64) -> Vec<f64> {
    let ratio = longest / shortest;
    let steps = (ratio.ln() / OCTAVE_STEP.ln()).round().max(1.0);
    (0..=steps as i32).map(|k| shortest * ratio.powf(f64::from(k) / steps)).collect()
}

/// Variance of the mean over an interval of noise of unit variance whose correlation decays with the time constant 1.
fn mean_variance(length: f64) -> f64 {
    // The closed form loses all digits for short intervals.
    if length < 1e-4 { 1.0 - length / 3.0 } else { 2.0 * (length + (-length).exp_m1()) / (length * length) }
}

/// Mean over an interval of the decay from its beginning, time constant 1.
fn mean_decay(length: f64) -> f64 {
    if length < 1e-8 { 1.0 } else { -(-length).exp_m1() / length }
}

/// Variance of the difference of the means over neighbouring intervals of one length.
fn contrast_variance(length: f64, time_constants: &[f64]) -> f64 {
    let one = |tau: &f64| 2.0 * (mean_variance(length / tau) - mean_decay(length / tau).powi(2));
    time_constants.iter().map(one).sum::<f64>() / time_constants.len() as f64
}

/// Covariance of slow noise with these time constants over intervals, of unit variance in the mean: that of the slow part of a
/// [`NoiseModel`]. Intervals may have any order, not overlap.
#[must_use]
pub fn slow_kernel(intervals: &[[f64; 2]], time_constants: &[f64]) -> DMatrix<f64> {
    let kernel = mean_kernel(intervals, time_constants);
    let unit = 1.0 / kernel.diagonal().mean();
    kernel * unit
}

/// Covariance of the means over intervals, averaged over the time constants. Intervals may have any order, not overlap.
fn mean_kernel(intervals: &[[f64; 2]], time_constants: &[f64]) -> DMatrix<f64> {
    let mut order: Vec<usize> = (0..intervals.len()).collect();
    order.sort_by(|a, b| intervals[*a][0].total_cmp(&intervals[*b][0]));
    let mut kernel = DMatrix::zeros(intervals.len(), intervals.len());
    for tau in time_constants {
        let lengths: Vec<f64> = order.iter().map(|&i| (intervals[i][1] - intervals[i][0]) / tau).collect();
        let means: Vec<f64> = lengths.iter().map(|l| mean_decay(*l)).collect();
        // Decay over an interval and over the gap after it: products of them reach any pair.
        let across: Vec<f64> = lengths.iter().map(|l| (-l).exp()).collect();
        let gap = |k: usize| (intervals[order[k + 1]][0] - intervals[order[k]][1]).max(0.0) / tau;
        let gaps: Vec<f64> = (0..order.len().saturating_sub(1)).map(|k| (-gap(k)).exp()).collect();
        for k in 0..order.len() {
            kernel[(order[k], order[k])] += mean_variance(lengths[k]);
            let mut decay = means[k];
            for l in k + 1..order.len() {
                decay *= gaps[l - 1];
                if decay < NEGLIGIBLE {
                    break;
                }
                kernel[(order[l], order[k])] += decay * means[l];
                decay *= across[l];
            }
        }
    }
    let count = time_constants.len() as f64;
    for k in 0..order.len() {
        for l in k..order.len() {
            let value = kernel[(order[l], order[k])] / count;
            kernel[(order[l], order[k])] = value;
            kernel[(order[k], order[l])] = value;
        }
    }
    kernel
}

/// Contrasts of one length beside a row of mean weight: their variances for white and for slow noise that gives such a row unit
/// variance.
struct Inside {
    count: f64,
    white: f64,
    slow: f64,
}

/// From the median positive spacing to the span in equal ratios near `TIME_STEP`, at least two.
fn time_constants(times: &[f64]) -> Result<Vec<f64>, FitError> {
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

/// `F` with rows and columns multiplied by `roots`.
fn kernel(times: &[f64], time_constants: &[f64], roots: &DVector<f64>) -> DMatrix<f64> {
    let mut kernel = DMatrix::zeros(times.len(), times.len());
    for j in 0..times.len() {
        for i in j..times.len() {
            let lag = (times[i] - times[j]).abs();
            let sum: f64 = time_constants.iter().map(|tau| (-lag / tau).exp()).sum();
            kernel[(i, j)] = sum / time_constants.len() as f64 * roots[i] * roots[j];
            kernel[(j, i)] = kernel[(i, j)];
        }
    }
    kernel
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

/// The restricted likelihood of one right-hand side, in coordinates in which the slow covariance is tridiagonal.
#[derive(Clone, Copy)]
struct Likelihood<'a> {
    diagonal: &'a [f64],
    off_diagonal: &'a [f64],
    data: &'a [f64],
}

impl Likelihood<'_> {
    /// Logarithm of the determinant of `white I + slow F`, and the data through its inverse.
    fn reduce(self, white: f64, slow: f64) -> (f64, f64) {
        let (mut log_determinant, mut product) = (0.0, 1.0);
        let (mut inverse, mut reduced, mut squares, mut off) = (0.0, 0.0, 0.0, 0.0);
        for (i, (diagonal, value)) in self.diagonal.iter().zip(self.data).enumerate() {
            let factor = off * inverse;
            let pivot = white + slow * diagonal - factor * off;
            reduced = value - factor * reduced;
            inverse = 1.0 / pivot;
            squares += reduced * reduced * inverse;
            off = slow * self.off_diagonal.get(i).copied().unwrap_or(0.0);
            // One logarithm for many pivots.
            product *= pivot;
            if !(1e-200..1e200).contains(&product) {
                log_determinant += f64::ln(product);
                product = 1.0;
            }
        }
        (log_determinant + f64::ln(product), squares)
    }

    /// Minus twice the log likelihood, profiled over the variance, up to a constant, and that variance.
    fn deviance(self, share: f64) -> (f64, f64) {
        let (log_determinant, squares) = self.reduce(1.0 - share, share);
        let count = self.data.len() as f64;
        let variance = squares / count;
        (count * variance.ln() + log_determinant, variance)
    }

    /// Averages over the likelihood and finds its maximum; `independent_rows` is left open.
    fn estimate(self) -> Noise {
        let mut noise = Noise { std: 0.0, share: 0.0, most_likely_std: 0.0, most_likely_share: 0.0, independent_rows: f64::NAN };
        if self.data.iter().all(|&value| value == 0.0) {
            return noise;
        }
        let grid = grid();
        let values: Vec<_> = grid.iter().map(|&(share, _)| self.deviance(share)).collect();
        let (mut best, mut lowest) = (0, f64::INFINITY);
        for (k, &(deviance, _)) in values.iter().enumerate() {
            if deviance < lowest {
                (best, lowest) = (k, deviance);
            }
        }
        let (mut total, mut white, mut slow) = (0.0, 0.0, 0.0);
        for ((share, prior), (deviance, variance)) in grid.iter().zip(&values) {
            let posterior = prior * (0.5 * (lowest - deviance)).exp();
            total += posterior;
            white += posterior * variance * (1.0 - share);
            slow += posterior * variance * share;
        }
        noise.std = ((white + slow) / total).sqrt();
        noise.share = slow / (white + slow);

        let (below, above) = (best.saturating_sub(1), (best + 1).min(grid.len() - 1));
        let found = self.search(grid[below].0, grid[above].0).unwrap_or(grid[best].0);
        // A maximum at the end of the range is a point of the grid and found exactly.
        let (share, variance) = match self.deviance(found) {
            (deviance, variance) if deviance < lowest => (found, variance),
            _ => (grid[best].0, values[best].1),
        };
        noise.most_likely_share = share;
        noise.most_likely_std = variance.sqrt();
        noise
    }

    /// Minus twice the log likelihood of given white and slow variances, up to a constant.
    fn absolute(self, white: f64, slow: f64) -> f64 {
        // Pivots near one do not leave the range of numbers.
        let scale = 1.0 / (white + slow);
        let (log_determinant, squares) = self.reduce(white * scale, slow * scale);
        log_determinant - self.data.len() as f64 * scale.ln() + squares * scale
    }

    /// Averages over what the contrasts inside the rows and the residuals say together.
    fn estimate_with(self, inside: &[Inside], mean_squares: &[f64]) -> (Noise, Vec<Place>) {
        let total: f64 = inside.iter().map(|o| o.count).sum();
        // Per ratio of slow to white noise of the samples: their white noise in a row, profiled, and the deviance of the contrasts.
        let nodes: Vec<(f64, f64, f64, f64)> = ratios()
            .into_iter()
            .map(|(ratio, prior)| {
                let (mut sampled, mut deviance) = (0.0, 0.0);
                for (octave, square) in inside.iter().zip(mean_squares) {
                    let unit = octave.white + ratio * octave.slow;
                    sampled += octave.count * square / unit / total;
                    deviance += octave.count * unit.ln();
                }
                (ratio, sampled, prior, deviance + total * sampled.ln())
            })
            .collect();
        let lowest = nodes.iter().map(|n| n.3).fold(f64::INFINITY, f64::min);
        let possible = nodes.into_iter().filter(|n| n.3 < lowest + IMPROBABLE);
        // White variance of a row by its samples, slow variance, weight by prior and contrasts.
        let mut told: Vec<(f64, f64, f64)> = possible
            .map(|(ratio, sampled, prior, deviance)| (sampled, ratio * sampled, prior * (0.5 * (lowest - deviance)).exp()))
            .collect();
        let weight: f64 = told.iter().map(|t| t.2).sum();
        let best = told.iter().copied().max_by(|a, b| a.2.total_cmp(&b.2));
        if let Some((sampled, slow, _)) = best {
            let apart = APART_SIZES.map(|size| (sampled, slow + size * sampled, weight * PRIOR_APART / APART_SIZES.len() as f64));
            told.extend(apart);
        }
        let excesses = excesses();
        let mut places: Vec<(Place, f64)> = Vec::new();
        let usual = excesses.iter().position(|(factor, _)| *factor == 1.0).unwrap_or_default();
        let (mut lowest, mut likely) = (f64::INFINITY, usual);
        for (sampled, slow, weight) in told {
            // The likelihood has one maximum in the white variance: outwards from the last one until it has become small.
            let mut try_out = |k: usize| {
                let (factor, prior) = excesses[k];
                let (white, probability) = (factor * sampled, weight * prior);
                let deviance = self.absolute(white, slow);
                places.push((Place { probability, white, slow }, deviance));
                deviance
            };
            let mut here = (try_out(likely), likely);
            for (mut k, up) in [(likely, true), (likely, false)] {
                let mut last = here.0;
                while let Some(next) = if up { Some(k + 1).filter(|n| *n < excesses.len()) } else { k.checked_sub(1) } {
                    k = next;
                    let deviance = try_out(k);
                    if deviance < here.0 {
                        here = (deviance, k);
                    }
                    if deviance > last && deviance > lowest.min(here.0) + IMPROBABLE {
                        break;
                    }
                    last = deviance;
                }
            }
            (lowest, likely) = (lowest.min(here.0), here.1);
        }
        let posterior =
            |(p, deviance): (Place, f64)| Place { probability: p.probability * (0.5 * (lowest - deviance)).exp(), ..p };
        let mut places: Vec<Place> = places.into_iter().map(posterior).collect();
        let sum: f64 = places.iter().map(|p| p.probability).sum();
        places.retain(|p| p.probability > NO_PLACE * sum);
        let sum: f64 = places.iter().map(|p| p.probability).sum();
        places.iter_mut().for_each(|p| p.probability /= sum);
        let white: f64 = places.iter().map(|p| p.probability * p.white).sum();
        let slow: f64 = places.iter().map(|p| p.probability * p.slow).sum();
        let best = places.iter().max_by(|a, b| a.probability.total_cmp(&b.probability));
        let (v, s) = best.map_or((white, slow), |p| (p.white, p.slow));
        let noise = Noise {
            std: (white + slow).sqrt(),
            share: slow / (white + slow),
            most_likely_std: (v + s).sqrt(),
            most_likely_share: s / (v + s),
            independent_rows: f64::NAN,
        };
        (noise, places)
    }

    /// Brent's search for a minimum of the deviance between two shares.
    fn search(self, low: f64, high: f64) -> Option<f64> {
        scalar::minimum(|share| self.deviance(share).0, [low, high], Stop { relative: 1e-8, absolute: 1e-9, steps: 100 })
    }
}

/// Ratios of slow noise to white noise of the samples in a row, with their prior probabilities: none, or a size between
/// `LEAST_RATIO` and `MOST_RATIO` of which every order of magnitude is as likely.
fn ratios() -> Vec<(f64, f64)> {
    spread((0.0, PRIOR_NONE), 1.0 - PRIOR_NONE, [LEAST_RATIO, MOST_RATIO], RATIOS)
}

/// White variance of rows over what their samples let expect, ascending, with prior probabilities: equal, or scatter between the rows
/// besides.
fn excesses() -> Vec<(f64, f64)> {
    let mut list = spread((1.0, 1.0 - PRIOR_EXCESS - PRIOR_LACK), PRIOR_EXCESS, [LEAST_EXCESS, MOST_EXCESS], EXCESSES);
    list.extend(LACKS.map(|factor| (factor, PRIOR_LACK / LACKS.len() as f64)));
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}

/// A usual value with its prior probability, and values in equal ratios that share another one.
fn spread((usual, prior): (f64, f64), others: f64, [least, most]: [f64; 2], count: usize) -> Vec<(f64, f64)> {
    let step = (most / least).powf(1.0 / (count - 1) as f64);
    let others = (0..count).map(|k| (least * step.powi(k as i32), others / count as f64));
    std::iter::once((usual, prior)).chain(others).collect()
}

/// Shares and their prior probabilities: zero, the nodes of a midpoint rule and the upper end.
fn grid() -> Vec<(f64, f64)> {
    let step = MAX_SHARE.sqrt().asin() / NODES as f64;
    // A prior uniform in sqrt(1 - φ) = cos(angle) has a density of sin(angle) in the angle.
    let sines: Vec<f64> = (0..NODES).map(|k| ((k as f64 + 0.5) * step).sin()).collect();
    let scale = (1.0 - PRIOR_WHITE) / sines.iter().sum::<f64>();
    let mut grid = vec![(0.0, PRIOR_WHITE)];
    grid.extend(sines.iter().map(|sine| (sine * sine, sine * scale)));
    grid.push((MAX_SHARE, 0.0));
    grid
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::super::linear::{Design, Limits, solve};
    use super::super::random::Random;
    use super::*;

    const TIMES: [f64; 12] = [0.0, 1.0, 2.0, 3.5, 4.5, 5.5, 7.0, 8.0, 9.0, 10.5, 12.0, 13.0];
    const X: [f64; 12] = [1.0, -1.0, 2.0, 0.0, -2.0, 1.0, 0.0, -1.0, 2.0, -2.0, 1.0, 0.0];
    const Y: [[f64; 12]; 2] = [
        [0.3, 0.9, 1.6, 1.1, 0.2, 1.2, 0.4, -0.7, 0.5, -1.6, -0.9, -1.4],
        [1.2, -0.3, 2.5, -0.4, -1.1, 1.9, 0.6, -1.4, 1.8, -2.6, 0.2, 0.5],
    ];
    const WEIGHTS: [f64; 12] = [1.0, 1.0, 0.5, 1.0, 2.0, 1.0, 1.0, 1.0, 0.25, 1.0, 1.0, 1.0];

    fn design(columns: DMatrix<f64>) -> Design {
        Design::new((0..columns.ncols()).map(|j| format!("c{j}")).collect(), columns).unwrap()
    }

    fn example(weights: Option<&[f64]>) -> NoiseModel {
        let columns = DMatrix::from_fn(12, 2, |i, j| [1.0, X[i]][j]);
        let rhs = DMatrix::from_fn(12, 2, |i, a| Y[a][i]);
        let fit = solve(&design(columns), &rhs, weights, &Limits::default()).unwrap();
        estimate(&fit, &TIMES).unwrap()
    }

    fn assert_relative(found: f64, expected: f64, tolerance: f64) {
        assert!((found / expected - 1.0).abs() < tolerance, "{found} is not {expected}");
    }

    /// Expected values: the restricted likelihood with dense inverses and determinants, its maximum by bounded search and
    /// its averages by adaptive quadrature, in numpy and scipy.
    #[test]
    fn a_dense_calculation_agrees() {
        let model = example(None);
        for (found, expected) in model.time_constants.iter().zip([1.0, 3.605551275463989, 13.0]) {
            assert_relative(*found, expected, 1e-14);
        }
        assert_eq!(model.noise[0].most_likely_share, 0.999);
        assert_relative(model.noise[0].most_likely_std, 0.8789191757143893, 1e-9);
        assert_relative(model.noise[0].share, 0.8719740365697541, 1e-4);
        assert_relative(model.noise[0].std, 0.8660016449102372, 1e-4);
        assert_relative(model.noise[0].independent_rows, 2.668032053010304, 1e-4);
        assert_relative(model.noise[1].most_likely_share, 0.4883151307610789, 1e-6);
        assert_relative(model.noise[1].most_likely_std, 0.6930875705372179, 1e-6);
        assert_relative(model.noise[1].share, 0.6509654101058637, 1e-4);
        assert_relative(model.noise[1].std, 0.7506993418555138, 1e-4);
        assert_relative(model.correlation[(0, 1)], 0.5607100786669085, 1e-12);
        let covariance = model.averaged_covariance();
        let expected = [
            [0.28165235978099956, -0.003994299304120085, 0.1213573810266733, -0.0018238132027509125],
            [-0.003994299304120085, 0.014976164479596528, -0.0018238132027509097, 0.008045640035809173],
            [0.1213573810266733, -0.0018238132027509097, 0.16995235303892156, -0.002809798176326363],
            [-0.0018238132027509125, 0.008045640035809173, -0.002809798176326363, 0.015230173755554452],
        ];
        for (row, expected) in covariance.row_iter().zip(&expected) {
            for (found, expected) in row.iter().zip(expected) {
                assert_relative(*found, *expected, 1e-4);
            }
        }
    }

    #[test]
    fn a_dense_calculation_with_weights_agrees() {
        let model = example(Some(&WEIGHTS));
        assert_relative(model.noise[1].most_likely_std, 0.8994331254195118, 1e-9);
        assert_relative(model.noise[1].share, 0.7312699312352156, 1e-4);
        assert_relative(model.noise[1].std, 0.7872581315628461, 1e-4);
        assert_relative(model.noise[1].independent_rows, 2.977555858896663, 1e-4);
        assert_relative(model.correlation[(0, 1)], 0.5754791460775297, 1e-12);
        let covariance = model.averaged_covariance();
        assert_relative(covariance[(0, 0)], 0.28812135999874905, 1e-4);
        assert_relative(covariance[(0, 2)], 0.13900325172168507, 1e-4);
        assert_relative(covariance[(3, 2)], -0.0022169964597244783, 2e-4);
        assert_relative(covariance[(3, 3)], 0.019432862172151632, 1e-4);
        // The unit of the weights is nobody's business.
        let scaled: Vec<f64> = WEIGHTS.iter().map(|weight| 400.0 * weight).collect();
        let scaled = example(Some(&scaled));
        assert_relative(scaled.noise[1].std, model.noise[1].std, 1e-12);
        assert!((scaled.averaged_covariance() - covariance).amax() < 1e-14);
    }

    #[test]
    fn a_row_of_weight_zero_does_not_exist() {
        let mut weights = [1.0; 12];
        weights[5] = 0.0;
        let rows: Vec<usize> = (0..12).filter(|&i| i != 5).collect();
        let columns = DMatrix::from_fn(11, 2, |i, j| [1.0, X[rows[i]]][j]);
        let rhs = DMatrix::from_fn(11, 2, |i, a| Y[a][rows[i]]);
        let fit = solve(&design(columns), &rhs, None, &Limits::default()).unwrap();
        let times: Vec<f64> = rows.iter().map(|&i| TIMES[i]).collect();
        let without = estimate(&fit, &times).unwrap();
        assert!((example(Some(&weights)).averaged_covariance() - without.averaged_covariance()).amax() < 1e-13);
    }

    fn mean_of(rhs: DMatrix<f64>, times: &[f64]) -> Result<NoiseModel, FitError> {
        let ones = design(DMatrix::from_element(rhs.nrows(), 1, 1.0));
        estimate(&solve(&ones, &rhs, None, &Limits::default()).unwrap(), times)
    }

    #[test]
    fn noise_that_alternates_has_no_slow_part() {
        let rhs = DMatrix::from_fn(20, 1, |i, _| 3.0 + [1.0, -1.0][i % 2]);
        let times: Vec<f64> = (0..20).map(f64::from).collect();
        let model = mean_of(rhs, &times).unwrap();
        assert_eq!(model.noise[0].most_likely_share, 0.0);
        // White noise of the sample variance 20 / 19, averaged over 20 rows.
        assert_relative(model.most_likely_covariance()[(0, 0)], 1.0 / 19.0, 1e-12);
        assert!(model.noise[0].share < 0.2, "{}", model.noise[0].share);
    }

    #[test]
    fn a_perfect_fit_has_no_noise() {
        let rhs = DMatrix::from_fn(6, 2, |i, a| [0.0, 1.0, 0.0, -1.0, 1.0, -1.0][i * a]);
        let model = mean_of(rhs, &[0.0, 1.0, 2.0, 3.0, 4.0, 5.0]).unwrap();
        let covariance = model.covariance();
        assert_eq!((model.noise[0].std, covariance[(0, 0)], covariance[(0, 1)]), (0.0, 0.0, 0.0));
        assert!(covariance[(1, 1)] > 0.0);
    }

    #[test]
    fn records_without_information_are_refused() {
        let refused = |rows: usize, times: &[f64]| mean_of(DMatrix::from_fn(rows, 1, |i, _| i as f64), times).unwrap_err();
        assert!(matches!(refused(2, &[1.0, 1.0]), FitError::NoNoise { .. }));
        assert!(matches!(refused(1, &[1.0]), FitError::NoNoise { .. }));
        assert!(matches!(refused(2, &[1.0]), FitError::Length { expected: 2, found: 1, .. }));
        let error = refused(2, &[1.0, f64::INFINITY]);
        assert!(matches!(error, FitError::NotFinite { row: 1, .. }));
        assert!(mean_of(DMatrix::from_row_slice(2, 1, &[1.0, 2.0]), &[0.0, 1.0]).is_ok());
    }

    impl Random {
        /// Noise of unit variance with a spectrum 1/f from 1/2 down to 1 / (2 π n), flat below: a sum of waves, which has
        /// nothing in common with the kernel of the estimate.
        fn flicker(&mut self, n: usize) -> Vec<f64> {
            let waves = 100;
            // Between these frequencies lie `folds` factors e of equal power, below them the power of one more.
            let folds = (0.5 * TAU * n as f64).ln();
            let scale = f64::from(waves).sqrt().recip();
            let mut noise = vec![0.0; n];
            for k in 0..waves {
                let fold = (folds + 1.0) * (f64::from(k) + self.uniform()) / f64::from(waves);
                let step = if fold < folds { 0.5 * TAU * (-fold).exp() } else { (fold - folds) / n as f64 };
                let (sine, cosine) = (self.gaussian() * scale, self.gaussian() * scale);
                for (i, value) in noise.iter_mut().enumerate() {
                    let (s, c) = (step * i as f64).sin_cos();
                    *value += sine * s + cosine * c;
                }
            }
            noise
        }
    }

    /// How often 95 % intervals hold the true value: a quickly changing column and the mean with the averaged covariance,
    /// and the mean with slow noise ignored.
    fn coverage(share: f64) -> [f64; 3] {
        let (n, records) = (50, 200);
        let mut random = Random(88_172_645_463_325_252);
        let columns = DMatrix::from_fn(n, 2, |_, j| [random.uniform() - 0.5, 1.0][j]);
        let design = design(columns);
        let times: Vec<f64> = (0..n).map(|i| i as f64).collect();
        let mut held = [0.0; 3];
        for _ in 0..records {
            let slow = random.flicker(n);
            let mut noise = |i: usize| (1.0 - share).sqrt() * random.gaussian() + share.sqrt() * slow[i];
            let rhs = DMatrix::from_fn(n, 1, |i, _| noise(i));
            let fit = solve(&design, &rhs, None, &Limits::default()).unwrap();
            let std = estimate(&fit, &times).unwrap().covariance().diagonal().map(f64::sqrt);
            for (held, (j, std)) in held.iter_mut().zip([(0, std[0]), (1, std[1]), (1, fit.std()[1])]) {
                // Student's t for 48 degrees of freedom.
                *held += f64::from(fit.coefficients[j].abs() <= 2.011 * std);
            }
        }
        held.map(|count| count / f64::from(records))
    }

    #[test]
    fn intervals_hold_the_truth_as_often_as_they_say() {
        // 200 records: a true coverage of 95 % scatters by 1.5 %.
        let [quick, mean, ignored] = coverage(0.0);
        assert!((0.905..0.995).contains(&quick), "{quick}");
        assert!(mean > 0.95, "{mean}");
        assert!((0.905..0.995).contains(&ignored), "{ignored}");
        let [quick, mean, ignored] = coverage(0.5);
        assert!((0.905..0.995).contains(&quick), "{quick}");
        assert!((0.905..0.995).contains(&mean), "{mean}");
        assert!(ignored < 0.7, "{ignored}");
    }

    /// Four parts of 3 with a gap of 2 after the second.
    const PARTS: [[f64; 2]; 4] = [[0.0, 3.0], [3.0, 6.0], [8.0, 11.0], [11.0, 14.0]];

    #[test]
    fn covariances_of_means_have_their_closed_form() {
        // Whatever the time constant: a sum over fine steps.
        for tau in [0.05, 1.0, 40.0] {
            let kernel = mean_kernel(&PARTS, &[tau]);
            let steps = 1500;
            let at = |part: usize, k: usize| PARTS[part][0] + 3.0 * (k as f64 + 0.5) / f64::from(steps);
            for (a, b) in [(0, 0), (0, 1), (0, 2), (1, 3)] {
                let one = |k: usize| (0..steps as usize).map(|l| (-(at(a, k) - at(b, l)).abs() / tau).exp()).sum::<f64>();
                let sum: f64 = (0..steps as usize).map(one).sum::<f64>() / f64::from(steps * steps);
                assert!((kernel[(a, b)] - sum).abs() < 1e-5, "{tau}: {} is not {sum}", kernel[(a, b)]);
            }
        }
    }

    #[test]
    fn contrasts_and_means_share_one_covariance() {
        let constants = octave_constants(0.1, 100.0);
        let parts = mean_kernel(&PARTS, &constants);
        let contrast = parts[(0, 0)] + parts[(1, 1)] - 2.0 * parts[(0, 1)];
        assert_relative(contrast_variance(3.0, &constants), contrast, 1e-12);
        // Two parts make a whole, also across the gap and in any order.
        let whole = mean_kernel(&[[8.0, 14.0], [0.0, 6.0]], &constants);
        let of_parts =
            |a: [usize; 2], b: [usize; 2]| a.iter().map(|i| b.iter().map(|j| parts[(*i, *j)]).sum::<f64>()).sum::<f64>() / 4.0;
        assert_relative(whole[(1, 1)], of_parts([0, 1], [0, 1]), 1e-12);
        assert_relative(whole[(0, 1)], of_parts([0, 1], [2, 3]), 1e-12);
        // 1/f noise has contrasts of the same variance at every length: 4 ln 2 per octave of the spectrum and unit of ln τ.
        let constants = octave_constants(1e-6, 1e6);
        let step = (constants[1] / constants[0]).ln();
        for length in [0.1, 1.0, 10.0] {
            let variance = contrast_variance(length, &constants) * constants.len() as f64 * step;
            assert_relative(variance, 4.0 * 2f64.ln(), 1e-2);
        }
    }

    /// How often 95 % intervals hold a quickly changing column and the mean of rows of 32 samples with contrasts inside, and the
    /// mean standard deviation of both over the true one.
    fn coverage_with_contrasts(share: f64) -> [f64; 4] {
        let (n, m, records) = (40, 32, 150);
        let mut random = Random(88_172_645_463_325_252);
        let columns = DMatrix::from_fn(n, 2, |_, j| [random.uniform() - 0.5, 1.0][j]);
        let design = design(columns);
        let intervals: Vec<[f64; 2]> = (0..n).map(|i| [(m * i) as f64, (m * i + m) as f64]).collect();
        let (mut held, mut errors, mut stated) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        for _ in 0..records {
            let slow = if share > 0.0 { random.flicker(n * m) } else { vec![0.0; n * m] };
            let samples: Vec<f64> = slow.iter().map(|s| (1.0 - share).sqrt() * random.gaussian() + share.sqrt() * s).collect();
            let mean = |from: usize, length: usize| samples[from..from + length].iter().sum::<f64>() / length as f64;
            let rhs = DMatrix::from_fn(n, 1, |i, _| mean(m * i, m));
            let octaves: Vec<Octave> = [4, 8, 16]
                .into_iter()
                .map(|length| {
                    let starts = (0..n * m).step_by(2 * length);
                    let squares = starts.map(|k| (mean(k, length) - mean(k + length, length)).powi(2)).sum();
                    let count = (n * m / (2 * length)) as f64;
                    Octave { length: length as f64, count, white: 2.0 / length as f64, squares: vec![squares] }
                })
                .collect();
            let fit = solve(&design, &rhs, None, &Limits::default()).unwrap();
            let model = estimate_with(&fit, &intervals, &vec![m as f64; n], &octaves).unwrap();
            let std = model.covariance().diagonal().map(f64::sqrt);
            for j in 0..2 {
                held[j] += f64::from(fit.coefficients[j].abs() <= NORMAL_95 * std[j]) / f64::from(records);
                errors[j] += fit.coefficients[j].powi(2) / f64::from(records);
                stated[j] += std[j] / f64::from(records);
            }
        }
        [held[0], held[1], stated[0] / errors[0].sqrt(), stated[1] / errors[1].sqrt()]
    }

    #[test]
    fn contrasts_inside_the_rows_tell_slow_noise_from_white() {
        for share in [0.3, 0.9] {
            let [quick, mean, quick_ratio, mean_ratio] = coverage_with_contrasts(share);
            // 150 records: a true coverage of 95 % scatters by 1.8 %.
            assert!((0.895..0.995).contains(&quick), "{share}: {quick}");
            assert!((0.895..1.0).contains(&mean), "{share}: {mean}");
            assert!((0.8..1.25).contains(&quick_ratio) && (0.8..1.25).contains(&mean_ratio), "{quick_ratio} {mean_ratio}");
        }
        let [quick, mean, quick_ratio, _] = coverage_with_contrasts(0.0);
        assert!((0.895..0.995).contains(&quick) && mean > 0.9, "{quick} {mean}");
        assert!((0.85..1.2).contains(&quick_ratio), "{quick_ratio}");
    }

    #[test]
    fn rows_that_scatter_more_than_their_samples_are_believed() {
        // Rows alternate by 1, their samples by a hundredth.
        let rhs = DMatrix::from_fn(20, 1, |i, _| [1.0, -1.0][i % 2]);
        let fit = solve(&design(DMatrix::from_element(20, 1, 1.0)), &rhs, None, &Limits::default()).unwrap();
        let intervals: Vec<[f64; 2]> = (0..20).map(|i| [f64::from(i), f64::from(i) + 1.0]).collect();
        let octave = |squares: f64| Octave { length: 0.5, count: 20.0, white: 0.5, squares: vec![squares] };
        let with = estimate_with(&fit, &intervals, &[8.0; 20], &[octave(20.0 * 1e-4)]).unwrap();
        // Twenty rows tell their scatter with nineteen degrees of freedom: Student's interval in terms of the normal one.
        let widening = super::super::student_95(19) / NORMAL_95;
        assert_relative(with.covariance()[(0, 0)], widening.powi(2) / 19.0, 0.03);
        // Samples without scatter leave the noise to the residuals.
        let without = estimate_with(&fit, &intervals, &[8.0; 20], &[octave(0.0)]).unwrap();
        let middles: Vec<f64> = intervals.iter().map(|i| i[0] + 0.5).collect();
        assert_eq!(without.noise, estimate(&fit, &middles).unwrap().noise);
    }
}
