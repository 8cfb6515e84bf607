//! What the field does without heaters: increments from cell to cell that are predicted from the ones before, with coefficients
//! and noise of the surroundings.
//!
//! The external field wanders like a random walk, so its increments are nearly white; aliases of wheels are narrow, polarised and
//! move slowly, so they can be predicted from the vectors before. What is left, the innovation, is independent from cell to cell.

use nalgebra::{DMatrix, Matrix3, SymmetricEigen, Vector3};

use crate::fit::statistics::median;

/// Cells from the middle of one model to that of the next.
const HOP_CELLS: usize = 128;
/// Cells that one model is fitted to.
const WINDOW_CELLS: usize = 640;
/// Degrees of freedom of the distribution that the innovations are weighted by: edges which are not found yet must not count as
/// noise.
const STUDENT_DEGREES: f64 = 5.0;
/// What the weights make of the variance of three normal numbers: the solution s of E[8 u / (5 + u)] = 3, u = χ²/s with three
/// degrees of freedom.
const WEIGHTED_SHARE: f64 = 0.784_136_472_528_473_4;
/// Rounds of weighting.
const ROUNDS: usize = 4;
/// A part of the variance that is added, so that a component without noise does not make the precision infinite.
const FLOOR: f64 = 1e-9;

/// The predictor of one part of an interval.
#[derive(Clone, Debug)]
pub(super) struct Predictor {
    /// Matrix on the increment one cell before, two cells before and so on.
    pub coefficients: Vec<Matrix3<f64>>,
    /// Inverse covariance of the innovations, nT⁻².
    pub precision: Matrix3<f64>,
    /// Covariance of the innovations, nT².
    pub covariance: Matrix3<f64>,
}

/// The predictors of an interval.
#[derive(Clone, Debug)]
pub(super) struct Background {
    predictors: Vec<Predictor>,
}

impl Background {
    /// Fits predictors of an order to increments; of order 0, only the covariance.
    pub fn of(increments: &[Vector3<f64>], order: usize) -> Self {
        let starts = (0..increments.len().div_ceil(HOP_CELLS)).map(|hop| hop * HOP_CELLS + HOP_CELLS / 2);
        let predictors = starts
            .map(|middle| {
                // Windows at the ends are as long as the others.
                let end = (middle + WINDOW_CELLS / 2).max(WINDOW_CELLS).min(increments.len());
                let start = end.saturating_sub(WINDOW_CELLS);
                fit(increments, start..end, order)
            })
            .collect();
        Background { predictors }
    }

    /// The index of the predictor of a cell.
    pub fn index(&self, cell: usize) -> usize {
        (cell / HOP_CELLS).min(self.predictors.len() - 1)
    }

    /// The predictor of a cell.
    pub fn at(&self, cell: usize) -> &Predictor {
        &self.predictors[self.index(cell)]
    }

    /// How many increments before one it is predicted from.
    pub fn order(&self) -> usize {
        self.predictors[0].coefficients.len()
    }

    /// The innovations, NaN where an increment they are made of is missing.
    pub fn innovations(&self, increments: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        (0..increments.len()).map(|cell| innovation(&self.at(cell).coefficients, increments, cell)).collect()
    }
}

impl Background {
    /// Logarithm of the likelihood of increments, up to a constant that depends on their number only; outliers count as what they
    /// are weighted.
    pub fn log_likelihood(&self, increments: &[Vector3<f64>]) -> f64 {
        let innovations = self.innovations(increments);
        let of = |(cell, left): (usize, &Vector3<f64>)| {
            let Predictor { precision, .. } = self.at(cell);
            let distance = left.dot(&(precision * left));
            0.5 * precision.determinant().max(f64::MIN_POSITIVE).ln()
                - 0.5 * (STUDENT_DEGREES + 3.0) * (distance / (WEIGHTED_SHARE * STUDENT_DEGREES)).ln_1p()
        };
        innovations.iter().enumerate().filter(|(_, left)| left.x.is_finite()).map(of).sum()
    }
}

/// An increment minus what is predicted of it.
fn innovation(coefficients: &[Matrix3<f64>], increments: &[Vector3<f64>], cell: usize) -> Vector3<f64> {
    if cell < coefficients.len() {
        return Vector3::repeat(f64::NAN);
    }
    coefficients.iter().enumerate().fold(increments[cell], |sum, (lag, matrix)| sum - matrix * increments[cell - lag - 1])
}

/// Weighted least squares of the predictor over a window, each row weighted by how well it fits.
fn fit(increments: &[Vector3<f64>], window: std::ops::Range<usize>, order: usize) -> Predictor {
    let rows: Vec<usize> = window
        .filter(|&cell| cell >= order && (0..=order).all(|lag| increments[cell - lag].iter().all(|v| v.is_finite())))
        .collect();
    let mut predictor = start(increments, &rows, order);
    if rows.len() < 8 * (order + 1) {
        return predictor;
    }
    for _ in 0..ROUNDS {
        let weights: Vec<f64> = rows
            .iter()
            .map(|&cell| {
                let left = innovation(&predictor.coefficients, increments, cell);
                (STUDENT_DEGREES + 3.0) / (STUDENT_DEGREES + left.dot(&(predictor.precision * left)) / WEIGHTED_SHARE)
            })
            .collect();
        if order > 0 {
            predictor.coefficients = regress(increments, &rows, &weights, order);
        }
        let mut covariance = Matrix3::zeros();
        for (&cell, weight) in rows.iter().zip(&weights) {
            let left = innovation(&predictor.coefficients, increments, cell);
            covariance += left * left.transpose() * *weight;
        }
        predictor.set(covariance / (WEIGHTED_SHARE * rows.len() as f64));
    }
    predictor
}

impl Predictor {
    /// Takes a covariance and its inverse.
    fn set(&mut self, covariance: Matrix3<f64>) {
        let scale = covariance.trace().max(f64::MIN_POSITIVE);
        self.covariance = covariance + Matrix3::from_diagonal_element(FLOOR * scale);
        self.precision = inverse(&self.covariance);
    }
}

/// Inverse of a symmetric positive definite matrix by its axes.
fn inverse(matrix: &Matrix3<f64>) -> Matrix3<f64> {
    let axes = SymmetricEigen::new(*matrix);
    let least = axes.eigenvalues.max() * FLOOR;
    axes.eigenvectors
        * Matrix3::from_diagonal(&axes.eigenvalues.map(|value| 1.0 / value.max(least)))
        * axes.eigenvectors.transpose()
}

/// No prediction, and the scatter of each component from the median of its magnitudes, which many edges do not spoil.
fn start(increments: &[Vector3<f64>], rows: &[usize], order: usize) -> Predictor {
    let scatter = |component: usize| {
        let mut magnitudes: Vec<f64> = rows.iter().map(|&cell| increments[cell][component].abs()).collect();
        if magnitudes.is_empty() { 1.0 } else { median(&mut magnitudes) / 0.674_489_750_196 }
    };
    let variances = Vector3::from_fn(|component, _| scatter(component).powi(2).max(f64::MIN_POSITIVE));
    let mut predictor =
        Predictor { coefficients: vec![Matrix3::zeros(); order], precision: Matrix3::zeros(), covariance: Matrix3::zeros() };
    predictor.set(Matrix3::from_diagonal(&variances));
    predictor
}

/// The coefficients by weighted least squares; none where the increments do not determine them.
fn regress(increments: &[Vector3<f64>], rows: &[usize], weights: &[f64], order: usize) -> Vec<Matrix3<f64>> {
    let columns = 3 * order;
    let mut normal = DMatrix::<f64>::zeros(columns, columns);
    let mut right = DMatrix::<f64>::zeros(columns, 3);
    let mut past = vec![0.0; columns];
    for (&cell, weight) in rows.iter().zip(weights) {
        for lag in 0..order {
            past[3 * lag..3 * lag + 3].copy_from_slice(increments[cell - lag - 1].as_slice());
        }
        for i in 0..columns {
            let weighted = weight * past[i];
            for j in 0..=i {
                normal[(i, j)] += weighted * past[j];
            }
            for component in 0..3 {
                right[(i, component)] += weighted * increments[cell][component];
            }
        }
    }
    let ridge = normal.trace() * 1e-6 / columns as f64 + f64::MIN_POSITIVE;
    for i in 0..columns {
        normal[(i, i)] += ridge;
        for j in i + 1..columns {
            normal[(i, j)] = normal[(j, i)];
        }
    }
    let Some(cholesky) = normal.cholesky() else { return vec![Matrix3::zeros(); order] };
    let solution = cholesky.solve(&right);
    (0..order).map(|lag| Matrix3::from_fn(|component, of| solution[(3 * lag + of, component)])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    #[test]
    fn a_predicted_series_gives_its_coefficients_and_noise_back() {
        // d[n] = A d[n-1] + e with a rotation times 0.8 in the plane of x and y, noise of 0.1, 0.1 and 0.3 nT.
        let mut random = Random::seeded(3);
        let matrix = Matrix3::new(0.0, -0.8, 0.0, 0.8, 0.0, 0.0, 0.0, 0.0, 0.0);
        let mut series = vec![Vector3::zeros()];
        for cell in 1..WINDOW_CELLS {
            let noise = Vector3::new(0.1 * random.gaussian(), 0.1 * random.gaussian(), 0.3 * random.gaussian());
            series.push(matrix * series[cell - 1] + noise);
        }
        let background = Background::of(&series, 1);
        let found = background.at(300);
        // The standard error of a coefficient is the root of (1 - 0.64) / 640, or of 1 / 640 beside a component of equal noise.
        assert!((found.coefficients[0] - matrix).abs().max() < 4.0 * 3.0 / (WINDOW_CELLS as f64).sqrt());
        // The standard error of a standard deviation of 640 numbers is 0.028 of it.
        let scatter = found.covariance.diagonal().map(f64::sqrt);
        for (scatter, truth) in scatter.iter().zip([0.1, 0.1, 0.3]) {
            assert!((scatter / truth - 1.0).abs() < 4.0 * 0.028, "{scatter}");
        }
    }

    #[test]
    fn a_missing_increment_costs_the_innovations_that_are_made_of_it() {
        let mut series = vec![Vector3::new(0.1, -0.1, 0.1); 100];
        (0..100).for_each(|cell| series[cell] *= if cell % 2 == 0 { 1.0 } else { -0.5 });
        series[40] = Vector3::repeat(f64::NAN);
        let left = Background::of(&series, 2).innovations(&series);
        let missing: Vec<usize> = (0..100).filter(|&cell| left[cell].x.is_nan()).collect();
        assert_eq!(missing, [0, 1, 40, 41, 42]);
    }
}
