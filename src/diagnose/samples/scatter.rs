//! The covariance of bins of a plateau, each less the mean of the plateau.
//!
//! White samples make a covariance that is known but for its size; slow noise adds one of a known shape. Where there are many plateaus, their
//! own scatter says more than such a model: the covariance is expected to be the model's, as firmly as the plateaus themselves suggest (an
//! inverse Wishart distribution, whose number of expected plateaus has the largest likelihood).

use nalgebra::{DMatrix, DVector};
use statrs::function::gamma::ln_gamma;

/// Sizes of slow noise relative to the white one: ratios of their mean variances.
const SLOW: [f64; 5] = [0.0, 0.1, 0.3, 1.0, 4.0];
/// Numbers of plateaus for which the model may stand, beyond the number of bins.
const FIRMNESS: [f64; 5] = [2.0, 10.0, 40.0, 160.0, 2000.0];

/// Least part of the inverse of a covariance that is believed.
const LEAST_PART: f64 = 0.05;

/// What the covariance of bins may be.
pub(super) struct Expected {
    models: Vec<Model>,
}

/// A covariance of mean variance one.
struct Model {
    covariance: DMatrix<f64>,
    inverse: DMatrix<f64>,
    /// Logarithm of the determinant of the covariance.
    log: f64,
}

/// The covariance of bins that was found.
pub(super) struct Scatter {
    /// Its inverse, for bins without the last one, which follows from the others; as an estimate without bias.
    pub inverse: DMatrix<f64>,
    /// Degrees of freedom with which it is known.
    pub freedom: f64,
}

impl Expected {
    /// Of bins that end so many samples after the begin of a plateau.
    pub fn new(edges: &[usize]) -> Self {
        let samples = edges[edges.len() - 1];
        let bins = edges.len() - 2;
        let width = |k: usize| (edges[k + 1] - edges[k]) as f64;
        // Mean of a function of two samples over two bins, over one and all, and over all.
        let of_bins = |of: &dyn Fn(f64, f64) -> f64| {
            let middle = |k: usize| 0.5 * (edges[k] + edges[k + 1]) as f64;
            let all = edges.len() - 1;
            let weight = |k: usize| width(k) / samples as f64;
            let row: Vec<f64> = (0..all).map(|k| (0..all).map(|l| weight(l) * of(middle(k), middle(l))).sum()).collect();
            let whole: f64 = (0..all).map(|k| weight(k) * row[k]).sum();
            DMatrix::from_fn(bins, bins, |k, l| of(middle(k), middle(l)) - row[k] - row[l] + whole)
        };
        let white = DMatrix::from_fn(bins, bins, |k, l| if k == l { width(k).recip() } else { 0.0 } - (samples as f64).recip());
        let middle = 0.5 * samples as f64;
        let slow: [DMatrix<f64>; 3] = [
            of_bins(&|s, t| (s - middle) * (t - middle)),
            of_bins(&|s, t| -(s - t).abs()),
            of_bins(&|s, t| -((s - t).abs() + 0.5).ln()),
        ];
        let one = |m: &DMatrix<f64>| m * (bins as f64 / m.trace());
        let of_size = |size: f64| slow.iter().map(move |slow| (size, slow)).take(if size > 0.0 { slow.len() } else { 1 });
        let models = SLOW.into_iter().flat_map(of_size).filter_map(|(size, slow)| {
            let covariance = (one(&white) + one(slow) * size) / (1.0 + size);
            let cholesky = covariance.cholesky()?;
            let inverse = cholesky.inverse();
            let log = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
            Some(Model { covariance: inverse.clone().cholesky()?.inverse(), inverse, log })
        });
        Self { models: models.collect() }
    }

    /// The covariance about which some bins scatter, without their last ones.
    pub fn scatter(&self, rows: &[DVector<f64>]) -> Option<Scatter> {
        let (count, bins) = (rows.len() as f64, rows.first()?.len());
        let size = bins as f64;
        let all = DMatrix::from_columns(rows);
        let squares = &all * all.transpose();
        let gamma = |freedom: f64| (0..bins).map(|j| ln_gamma(0.5 * (freedom - j as f64))).sum::<f64>();
        let determinant = |m: DMatrix<f64>| Some(2.0 * m.cholesky()?.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>());
        // Of each firmness what all models have in common.
        let common = FIRMNESS.map(|firmness| {
            let freedom = size + 1.0 + firmness;
            gamma(freedom + count) - gamma(freedom)
        });
        let mut best: Option<(f64, f64, DMatrix<f64>)> = None;
        for Model { covariance, inverse, log } in &self.models {
            let variance = inverse.component_mul(&squares).sum() / (count * size);
            let covariance = covariance * variance;
            for (firmness, common) in FIRMNESS.into_iter().zip(common) {
                let freedom = size + 1.0 + firmness;
                let expected = &covariance * firmness;
                let log_expected = log + size * (variance * firmness).ln();
                let sum = &expected + &squares;
                let likelihood = common + 0.5 * freedom * log_expected - 0.5 * (freedom + count) * determinant(sum.clone())?;
                if best.as_ref().is_none_or(|b| likelihood > b.0) {
                    best = Some((likelihood, firmness, sum));
                }
            }
        }
        let (_, firmness, sum) = best?;
        let total = firmness + count;
        // The inverse of a covariance that is known from few plateaus is too large: to first order by this part, which is exact without a model.
        let part = (1.0 - count * (size + 1.0) / (total * total)).max(LEAST_PART);
        Some(Scatter { inverse: (sum / total).cholesky()?.inverse() * part, freedom: total * part })
    }
}
