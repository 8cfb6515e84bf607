//! How white noise differs between the rows: what the samples inside them show, and what only the residuals show.

use super::Fitted;
use crate::fit::linear::Solution;
use crate::fit::statistics::median;
use nalgebra::{DMatrix, DVector};

/// Fewest rows of which it is asked how their samples scatter and whether the gain has slow noise.
const LEAST_ROWS: usize = 20;
/// Statistic of F from which the scatter of samples is taken to differ between the rows, and the least ratio of largest to smallest
/// variance that matters.
const CLEAR: f64 = 20.0;
const LEAST_RATIO: f64 = 1.2;
/// Samples of a row that scatter so many times the usual variance do so by no chance: that of ten samples is as large once in 25 000 rows.
const FAR_VARIANCE: f64 = 4.0;
/// Smallest variance as a part of the mean one.
const LEAST: f64 = 0.05;
/// Rows that tell themselves whether their scatter grows with the reading: twenty and more of them are large on each axis. To weigh it always costs as
/// much as all the rest of the noise there.
const MANY_ROWS: usize = 60;
/// Sources of a calibration are hardly wrong by more than this part of what they are set to.
const MOST_OF_A_SOURCE: f64 = 1e-3;
/// Standard deviations from which the residuals suggest scatter that grows with the reading, or slow noise of the gain.
const SUGGESTED: f64 = 2.0;
/// Rows one after the other of which slow noise of the gain is asked.
const NEIGHBOURS: usize = 3;

/// Squares of readings over the largest.
fn squares(readings: &DVector<f64>) -> DVector<f64> {
    let largest = readings.amax().powi(2);
    readings.map(|r| if largest > 0.0 { r * r / largest } else { 0.0 })
}

/// White variance of the rows where the scatter of their samples changes with the square of the reading or slowly in time, as with a
/// temperature: that of a row of mean weight is one.
pub(super) fn by_samples(
    fitted: &Fitted,
    solution: &Solution,
    intervals: &[[f64; 2]],
    [variances, readings]: [DVector<f64>; 2],
    counts: &[f64],
) -> Option<DVector<f64>> {
    let n = solution.kept.len();
    if n < LEAST_ROWS {
        return None;
    }
    let kept = |values: &DVector<f64>| DVector::from_fn(n, |i, _| values[solution.kept[i]]);
    let (variances, squares) = (kept(&variances), squares(&kept(&readings)));
    let begin = intervals.iter().map(|i| i[0]).fold(f64::INFINITY, f64::min);
    let end = intervals.iter().map(|i| i[1]).fold(f64::NEG_INFINITY, f64::max);
    let tau = |i: usize| (intervals[i][0] + intervals[i][1] - begin - end) / (end - begin);
    let columns = DMatrix::from_fn(n, 4, |i, j| match j {
        0 => 1.0,
        1 => squares[i],
        _ => tau(i).powi(j as i32 - 1),
    });
    let mean = variances.mean();
    let target = variances.map(|v| v / mean);
    let solved = columns.clone().svd(true, true).solve(&target, 1e-9).ok()?;
    let modelled = &columns * solved;
    let left = (&target - &modelled).norm_squared() / (n - 4) as f64;
    let explained = modelled.map(|v| (v - 1.0).powi(2)).sum() / 3.0;
    let modelled = modelled.map(|v| v.max(LEAST));
    let matters = modelled.max() > LEAST_RATIO * modelled.min();
    // NaN is no difference.
    (explained > CLEAR * left && matters).then(|| {
        let rows = DVector::from_fn(n, |i, _| modelled[i] / counts[solution.kept[i]]);
        // Samples of a row of mean weight have the mean variance.
        let unit = rows.zip_map(&fitted.by_weights, |r, w| r / w).mean();
        rows / unit
    })
}

/// White variance of the rows by what is known of each, where the rows differ in it and the residuals of a right-hand side are likelier so than with
/// one for all, as where every setting of a source is a little wrong: falling with the number of their samples, or that of a mean of samples that scatter
/// as those of the row do. That of a row of mean weight is one.
pub(super) fn by_rows(
    fitted: &Fitted,
    solution: &Solution,
    a: usize,
    counts: &[f64],
    variances: Option<&DVector<f64>>,
) -> Option<DVector<f64>> {
    let of_rows = |value: &dyn Fn(usize) -> f64| {
        let rows = DVector::from_iterator(solution.kept.len(), solution.kept.iter().map(|i| value(*i)));
        // NaN and zero are no variances.
        let (least, most) = (rows.min(), rows.max());
        let differ = least > 0.0 && rows.iter().all(|v| v.is_finite()) && most > LEAST_RATIO * least;
        differ.then(|| {
            let unit = rows.zip_map(&fitted.by_weights, |r, w| r / w).mean();
            rows / unit
        })
    };
    // Logarithm of the likelihood without a scale, which is free.
    let likelihood = |spread: &DVector<f64>| {
        let free = |i: usize| spread[i] * (1.0 - fitted.leverage[i]).max(LEAST);
        let n = spread.len() as f64;
        let squares: f64 = (0..spread.len()).map(|i| fitted.residuals[(i, a)].powi(2) / free(i)).sum();
        -0.5 * ((0..spread.len()).map(|i| free(i).ln()).sum::<f64>() + n * (squares / n).ln())
    };
    let by_counts = of_rows(&|i| 1.0 / counts[i]);
    let usual = variances.map(|v| median(&mut solution.kept.iter().map(|i| v[*i]).collect::<Vec<f64>>()));
    let by_scatter = variances
        .zip(usual)
        .filter(|(v, usual)| solution.kept.iter().any(|i| v[*i] > FAR_VARIANCE * usual))
        .and_then(|(v, _)| of_rows(&|i| v[i] / counts[i]));
    let alike = likelihood(&fitted.by_weights);
    let found = by_counts.into_iter().chain(by_scatter).map(|spread| (likelihood(&spread), spread));
    let best = found.filter(|(value, _)| *value > alike).max_by(|a, b| a.0.total_cmp(&b.0))?;
    Some(best.1)
}

/// Squares of readings with which the scatter between the rows may grow: always of few rows, which cannot tell, and of many where the residuals suggest
/// it. Where the readings are too small for a usual source to matter, as of offsets without a field, only the residuals ask for it.
pub(super) fn may_grow(
    fitted: &Fitted,
    solution: &Solution,
    a: usize,
    spread: &DVector<f64>,
    readings: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = solution.kept.len();
    let readings = DVector::from_fn(n, |i, _| readings[solution.kept[i]]);
    let squares = squares(&readings);
    let scatter =
        DVector::from_fn(n, |i, _| fitted.residuals[(i, a)].powi(2) / (spread[i] * (1.0 - fitted.leverage[i]).max(LEAST)));
    let mean = scatter.mean();
    let centred = squares.add_scalar(-squares.mean());
    let score = centred.dot(&scatter) / mean / (2.0 * centred.norm_squared()).sqrt();
    // Of the smaller half of the readings, which a source hardly makes scatter.
    let usual = median(&mut squares.iter().copied().collect::<Vec<f64>>());
    let of_small: Vec<f64> = squares.iter().zip(&scatter).filter(|(u, _)| **u <= usual).map(|(_, s)| *s).collect();
    let quiet = of_small.iter().sum::<f64>() / of_small.len() as f64;
    let is_small = MOST_OF_A_SOURCE * readings.amax() < quiet.sqrt();
    ((n < MANY_ROWS && !is_small) || score > SUGGESTED).then_some(squares)
}

/// Readings over the largest, in proportion to which slow noise acts, where the residuals suggest slow noise of the gain: neighbouring rows
/// differ from the fit in the same proportion to their readings.
pub(super) fn gain_moves(
    fitted: &Fitted,
    solution: &Solution,
    a: usize,
    spread: &DVector<f64>,
    readings: &DVector<f64>,
) -> Option<DVector<f64>> {
    let n = solution.kept.len();
    if n < LEAST_ROWS {
        return None;
    }
    let largest = readings.amax();
    if largest == 0.0 {
        return None;
    }
    let loads = DVector::from_fn(n, |i, _| readings[solution.kept[i]] / largest);
    let residuals = DVector::from_fn(n, |i, _| fitted.residuals[(i, a)] / spread[i].sqrt());
    let variance = residuals.norm_squared() / (n - fitted.columns.ncols()) as f64;
    // Rows far apart have lost what they share to the fit.
    let (mut sum, mut expected) = (0.0, 0.0);
    for i in 1..n {
        for j in i.saturating_sub(NEIGHBOURS)..i {
            let both = loads[i] * loads[j];
            sum += both * residuals[i] * residuals[j] / variance;
            expected += both * both;
        }
    }
    (sum > SUGGESTED * expected.sqrt()).then_some(loads)
}
