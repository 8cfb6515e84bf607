//! What the noise of the rows does to estimates of any kind that are linear in them.

use super::DenseNoise;
use nalgebra::DMatrix;

impl DenseNoise {
    /// Covariance of estimates that follow from the rows by `influence`: per right-hand side a row per estimate and a column per row.
    ///
    /// For the coefficients of the fit itself this is [`covariance`](DenseNoise::covariance), its widening included: that of an estimate
    /// which rests on several right-hand sides is the mean of theirs by what they add to its variance.
    #[must_use]
    pub fn covariance_of(&self, influence: &[DMatrix<f64>]) -> DMatrix<f64> {
        let count = influence.first().map_or(0, DMatrix::nrows);
        // Per right-hand side and shape of slow noise.
        let slow: Vec<Vec<DMatrix<f64>>> = influence
            .iter()
            .map(|g| self.shapes.iter().map(|shape| shape.rows.times(&g.transpose()).transpose()).collect())
            .collect();
        let mut covariance = DMatrix::zeros(count, count);
        let mut widened = vec![[0.0; 2]; count];
        for (a, of_a) in influence.iter().enumerate() {
            for (b, of_b) in influence.iter().enumerate() {
                let mut scaled = of_a.clone();
                for (i, mut column) in scaled.column_iter_mut().enumerate() {
                    column *= (self.white[a][i] * self.white[b][i]).sqrt();
                }
                let mut block = scaled * of_b.transpose();
                for (by_shape, (v, w)) in slow[a].iter().zip(self.slow[a].iter().zip(&self.slow[b])) {
                    if v * w > 0.0 {
                        block += by_shape * of_b.transpose() * (v * w).sqrt();
                    }
                }
                if a == b {
                    for (j, sums) in widened.iter_mut().enumerate() {
                        let row = of_a.row(j);
                        let slow: Vec<f64> = slow[a].iter().map(|by_shape| by_shape.row(j).dot(&row)).collect();
                        let variance = block[(j, j)];
                        sums[0] += variance;
                        sums[1] += variance * self.widening(a, &row.transpose(), &slow).powi(2);
                    }
                }
                covariance += block * self.correlation[(a, b)];
            }
        }
        let factors: Vec<f64> =
            widened.iter().map(|[plain, wide]| if *plain > 0.0 { (wide / plain).sqrt() } else { 1.0 }).collect();
        DMatrix::from_fn(count, count, |i, j| 0.5 * (covariance[(i, j)] + covariance[(j, i)]) * factors[i] * factors[j])
    }
}
