//! The likelihood of white and slow variances, and what is averaged over it.

use super::ComponentNoise;
use crate::fit::scalar::{self, Stop};

/// Largest share of slow noise; below one, so that the covariance stays regular whatever the times.
const MAX_SHARE: f64 = 0.999;
/// Nodes between no slow noise and `MAX_SHARE`, equidistant in the angle whose squared sine is the share.
const NODES: usize = 48;
/// Prior probability that there is no slow noise at all.
const PRIOR_WHITE: f64 = 0.1;
/// Prior probability that the samples carry white noise alone.
const PRIOR_NONE: f64 = 0.9;
/// Smallest and largest ratio of slow to white noise in a row, and how many in between: less cannot be told from none, more is slow noise
/// alone.
const LEAST_RATIO: f64 = 2.0;
const MOST_RATIO: f64 = 1e5;
const RATIOS: usize = 29;
/// Contrasts of 1/f noise are not quite independent: they count as this part of their number.
pub(super) const INDEPENDENT: f64 = 0.8;
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

/// A white and a slow variance of a row of mean weight, and how probable they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub(super) probability: f64,
    pub(super) white: f64,
    pub(super) slow: f64,
}

/// Contrasts of one length beside a row of mean weight: their variances for white and for slow noise that gives such a row unit
/// variance.
pub(super) struct Inside {
    pub(super) count: f64,
    pub(super) white: f64,
    pub(super) slow: f64,
}

/// The restricted likelihood of one right-hand side, in coordinates in which the slow covariance is tridiagonal.
#[derive(Clone, Copy)]
pub(super) struct Likelihood<'a> {
    pub(super) diagonal: &'a [f64],
    pub(super) off_diagonal: &'a [f64],
    pub(super) data: &'a [f64],
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
    pub(super) fn estimate(self) -> ComponentNoise {
        let mut noise =
            ComponentNoise { std: 0.0, share: 0.0, most_likely_std: 0.0, most_likely_share: 0.0, independent_rows: f64::NAN };
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
    pub(super) fn estimate_with(self, inside: &[Inside], mean_squares: &[f64]) -> (ComponentNoise, Vec<Place>) {
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
        let noise = ComponentNoise {
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
