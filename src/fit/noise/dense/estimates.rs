//! What the noise of the rows does to estimates of any kind that are linear in them.

use super::DenseNoise;
use super::kernel::slow_kernel;
use nalgebra::DMatrix;

impl DenseNoise {
    /// Covariance of estimates that follow from the rows by `influence`: per right-hand side a row per estimate and a column per row.
    ///
    /// For the coefficients of the fit itself this is [`covariance`](DenseNoise::covariance), its widening included: that of an estimate
    /// which rests on several right-hand sides is the mean of theirs by what they add to its variance.
    #[must_use]
    pub fn covariance_of(&self, influence: &[DMatrix<f64>]) -> DMatrix<f64> {
        let count = influence.first().map_or(0, DMatrix::nrows);
        let slow = slow_kernel(&self.intervals, &self.time_constants);
        let by_weight = |g: &DMatrix<f64>| {
            let mut g = g.clone();
            g.column_iter_mut().zip(&self.roots).for_each(|(mut column, root)| column /= root * root);
            g
        };
        let white: Vec<DMatrix<f64>> = influence.iter().map(by_weight).collect();
        let slow: Vec<DMatrix<f64>> = influence.iter().map(|g| g * &slow).collect();
        let mut covariance = DMatrix::zeros(count, count);
        let mut widened = vec![[0.0; 2]; count];
        for (a, of_a) in self.noise.iter().enumerate() {
            for (b, of_b) in self.noise.iter().enumerate() {
                let by_white = &white[a] * influence[b].transpose();
                let by_slow = &slow[a] * influence[b].transpose();
                let scale = self.correlation[(a, b)] * of_a.std * of_b.std;
                if a == b {
                    for (j, sums) in widened.iter_mut().enumerate() {
                        let (white, slow) = (by_white[(j, j)], by_slow[(j, j)]);
                        let variance = of_a.std.powi(2) * ((1.0 - of_a.share) * white + of_a.share * slow);
                        sums[0] += variance;
                        sums[1] += variance * self.widening(a, white, slow).powi(2);
                    }
                }
                covariance += by_white * (scale * ((1.0 - of_a.share) * (1.0 - of_b.share)).sqrt());
                covariance += by_slow * (scale * (of_a.share * of_b.share).sqrt());
            }
        }
        let factors: Vec<f64> =
            widened.iter().map(|[plain, wide]| if *plain > 0.0 { (wide / plain).sqrt() } else { 1.0 }).collect();
        DMatrix::from_fn(count, count, |i, j| 0.5 * (covariance[(i, j)] + covariance[(j, i)]) * factors[i] * factors[j])
    }
}
