//! The restricted likelihood of a white and a slow variance, and its average where only residuals tell them.

use super::ComponentNoise;
use super::projected::Series;
use crate::fit::scalar::{self, Stop};

/// Largest share of slow noise; below one, so that the covariance stays regular whatever the times.
const MAX_SHARE: f64 = 0.999;
/// Nodes between no slow noise and `MAX_SHARE`, equidistant in the angle whose squared sine is the share.
const NODES: usize = 48;
/// Prior probability that there is no slow noise at all.
const PRIOR_WHITE: f64 = 0.1;

/// What only the residuals of one right-hand side tell.
pub(super) struct Estimate {
    pub noise: ComponentNoise,
    /// Variance of a row if the noise is independent from row to row.
    pub alone: f64,
    /// Minus twice the logarithm of the likelihood averaged over the shares of slow noise, up to a constant.
    pub deviance: f64,
}

/// The restricted likelihood of one right-hand side.
#[derive(Clone, Copy)]
pub(super) enum Likelihood<'a> {
    /// In coordinates in which the slow covariance is tridiagonal.
    Tridiagonal { diagonal: &'a [f64], off_diagonal: &'a [f64], data: &'a [f64] },
    /// Of many rows.
    Series { series: &'a Series, component: usize },
}

impl Likelihood<'_> {
    /// Degrees of freedom.
    fn count(self) -> f64 {
        match self {
            Likelihood::Tridiagonal { data, .. } => data.len() as f64,
            Likelihood::Series { series, .. } => series.freedom() as f64,
        }
    }

    fn is_silent(self) -> bool {
        match self {
            Likelihood::Tridiagonal { data, .. } => data.iter().all(|&value| value == 0.0),
            Likelihood::Series { series, component } => series.is_silent(component),
        }
    }

    /// Logarithm of the determinant of `white I + slow F`, and the data through its inverse.
    fn reduce(self, white: f64, slow: f64) -> (f64, f64) {
        match self {
            Likelihood::Tridiagonal { diagonal, off_diagonal, data } => reduce(diagonal, off_diagonal, data, [white, slow]),
            Likelihood::Series { series, component } => series.reduce(component, white, slow),
        }
    }

    /// Minus twice the log likelihood, profiled over the variance, up to a constant, and that variance.
    fn deviance(self, share: f64) -> (f64, f64) {
        let (log_determinant, squares) = self.reduce(1.0 - share, share);
        let count = self.count();
        let variance = squares / count;
        (count * variance.ln() + log_determinant, variance)
    }

    /// Averages over the likelihood and finds its maximum; `independent_rows` is left open.
    pub(super) fn estimate(self) -> Estimate {
        let mut noise =
            ComponentNoise { std: 0.0, share: 0.0, most_likely_std: 0.0, most_likely_share: 0.0, independent_rows: f64::NAN };
        if self.is_silent() {
            return Estimate { noise, alone: 0.0, deviance: f64::NEG_INFINITY };
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
        Estimate { noise, alone: values[0].1, deviance: lowest - 2.0 * f64::ln(total) }
    }

    /// Minus twice the log likelihood of given white and slow variances, up to a constant.
    pub(super) fn absolute(self, white: f64, slow: f64) -> f64 {
        // Pivots near one do not leave the range of numbers.
        let scale = 1.0 / (white + slow);
        let (log_determinant, squares) = self.reduce(white * scale, slow * scale);
        log_determinant - self.count() * scale.ln() + squares * scale
    }

    /// Brent's search for a minimum of the deviance between two shares.
    fn search(self, low: f64, high: f64) -> Option<f64> {
        scalar::minimum(|share| self.deviance(share).0, [low, high], Stop { relative: 1e-8, absolute: 1e-9, steps: 100 })
    }
}

/// Determinant and squares in coordinates in which slow noise is tridiagonal.
fn reduce(diagonal: &[f64], off_diagonal: &[f64], data: &[f64], [white, slow]: [f64; 2]) -> (f64, f64) {
    let (mut log_determinant, mut product) = (0.0, 1.0);
    let (mut inverse, mut reduced, mut squares, mut off) = (0.0, 0.0, 0.0, 0.0);
    for (i, (diagonal, value)) in diagonal.iter().zip(data).enumerate() {
        let factor = off * inverse;
        let pivot = white + slow * diagonal - factor * off;
        reduced = value - factor * reduced;
        inverse = 1.0 / pivot;
        squares += reduced * reduced * inverse;
        off = slow * off_diagonal.get(i).copied().unwrap_or(0.0);
        // One logarithm for many pivots.
        product *= pivot;
        if !(1e-200..1e200).contains(&product) {
            log_determinant += f64::ln(product);
            product = 1.0;
        }
    }
    (log_determinant + f64::ln(product), squares)
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
