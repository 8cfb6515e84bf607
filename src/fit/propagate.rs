//! First-order propagation of a covariance through a function.

use nalgebra::DMatrix;

use super::statistics::std_of;
use super::{FitError, require_finite, require_length};

/// Steps of the ladder, each a quarter of the one before: eight decades.
const STEPS: usize = 14;
/// Ratio of neighbouring steps.
const RATIO: f64 = 4.0;
/// A derivative known to this share ends the search.
const ACCURATE: f64 = 1e-12;

/// Values of a function and their uncertainty.
#[derive(Clone, Debug, PartialEq)]
pub struct Propagated {
    /// The function at the given point.
    pub values: Vec<f64>,
    /// `J C Jᵀ`.
    pub covariance: DMatrix<f64>,
    /// Square roots of its diagonal.
    pub std: Vec<f64>,
}

/// The covariance of quantities that are independent between blocks: square blocks along the diagonal.
#[must_use]
pub fn block_diagonal<'a>(blocks: impl IntoIterator<Item = &'a DMatrix<f64>>) -> DMatrix<f64> {
    let blocks: Vec<&DMatrix<f64>> = blocks.into_iter().collect();
    let n = blocks.iter().map(|b| b.nrows()).sum();
    let mut whole = DMatrix::zeros(n, n);
    let mut at = 0;
    for block in blocks {
        whole.view_mut((at, at), block.shape()).copy_from(block);
        at += block.nrows();
    }
    whole
}

/// Propagates the covariance of `x` (p x p) through `f` to first order.
///
/// Derivatives are extrapolated central differences; the step of every parameter and output is the one with the smallest
/// error estimate on a ladder from an eighth of the size or the standard deviation of the parameter, whichever is larger,
/// downwards. Steps at which `f` is not finite are passed over, parameters of zero variance are not varied. `f` must return
/// the same number of values everywhere; it is called at most 28 times per parameter.
///
/// # Errors
///
/// [`FitError::Length`] where the sizes of `x`, the covariance or the values of `f` do not match, [`FitError::NotFinite`]
/// for `x`, the covariance, the values, and for a row of the result where `f` has no derivative.
pub fn propagate(f: impl Fn(&[f64]) -> Vec<f64>, x: &[f64], covariance: &DMatrix<f64>) -> Result<Propagated, FitError> {
    require_length("rows of the covariance", x.len(), covariance.nrows())?;
    require_length("columns of the covariance", x.len(), covariance.ncols())?;
    require_finite("parameters", x, x.len())?;
    require_finite("covariance", covariance.as_slice(), x.len())?;
    let values = f(x);
    require_finite("values of the function", &values, values.len())?;
    let mut jacobian = DMatrix::zeros(values.len(), x.len());
    for j in 0..x.len() {
        let std = std_of(covariance[(j, j)]);
        if std > 0.0 {
            let derivatives = differentiate(&f, x, j, 0.125 * std.max(x[j].abs()), values.len())?;
            jacobian.column_mut(j).copy_from_slice(&derivatives);
        }
    }
    let covariance = &jacobian * covariance * jacobian.transpose();
    require_finite("propagated covariance", covariance.as_slice(), values.len())?;
    let std = covariance.diagonal().iter().copied().map(std_of).collect();
    Ok(Propagated { values, covariance, std })
}

/// Derivatives of all values by parameter `j`: Ridders' tableau of central differences over a ladder of steps.
fn differentiate(
    f: &impl Fn(&[f64]) -> Vec<f64>,
    x: &[f64],
    j: usize,
    first_step: f64,
    count: usize,
) -> Result<Vec<f64>, FitError> {
    let mut best = vec![f64::NAN; count];
    let mut error = vec![f64::INFINITY; count];
    let mut last_row: Vec<Vec<f64>> = Vec::new();
    let mut at = x.to_vec();
    let mut step = first_step;
    for _ in 0..STEPS {
        at[j] = x[j] + step;
        let above = f(&at);
        // The step that was really made, free of the rounding of the sum.
        let up = at[j] - x[j];
        at[j] = x[j] - step;
        let below = f(&at);
        let width = up + (x[j] - at[j]);
        require_length("values of the function", count, above.len())?;
        require_length("values of the function", count, below.len())?;

        // Each column of the tableau removes the next even power of the step.
        let mut row = vec![above.iter().zip(&below).map(|(a, b)| (a - b) / width).collect::<Vec<f64>>()];
        let mut power = RATIO * RATIO;
        for previous in &last_row {
            let current = &row[row.len() - 1];
            let next: Vec<f64> = (0..count).map(|i| current[i] + (current[i] - previous[i]) / (power - 1.0)).collect();
            for i in 0..count {
                let estimate = (next[i] - current[i]).abs().max((next[i] - previous[i]).abs());
                if estimate < error[i] {
                    (best[i], error[i]) = (next[i], estimate);
                }
            }
            row.push(next);
            power *= RATIO * RATIO;
        }
        last_row = row;
        if error.iter().zip(&best).all(|(error, best)| *error <= ACCURATE * best.abs()) {
            break;
        }
        step /= RATIO;
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Standard deviation of a function of one parameter of standard deviation `std`, over `std`: the derivative.
    fn derivative(f: impl Fn(f64) -> f64, x: f64, std: f64) -> f64 {
        let covariance = DMatrix::from_element(1, 1, std * std);
        propagate(|x| vec![f(x[0])], &[x], &covariance).unwrap().std[0] / std
    }

    fn assert_relative(found: f64, expected: f64, tolerance: f64) {
        assert!((found / expected - 1.0).abs() < tolerance, "{found:e} is not {expected:e}");
    }

    #[test]
    fn derivatives_are_accurate_whatever_the_scales() {
        assert_relative(derivative(f64::exp, 3.0, 0.1), 3f64.exp(), 1e-10);
        assert_relative(derivative(|x| x.powi(5), 2.0, 1e-6), 80.0, 1e-10);
        assert_relative(derivative(|x| 1.0 / x, 1e-5, 1e-7), 1e10, 1e-10);
        assert_relative(derivative(f64::ln, 1e12, 1.0), 1e-12, 1e-10);
        assert_relative(derivative(f64::sin, 0.0, 1e-3), 1.0, 1e-10);
        // A parameter far from zero beside the scale of the function.
        assert_relative(derivative(|x| (x - 1e6).tanh(), 1e6 + 0.5, 0.1), 0.5f64.cosh().powi(-2), 1e-8);
        // A function much faster than the size of its parameter.
        assert_relative(derivative(|x| (1e3 * x).sin(), 1.0, 1e-4), (1e3 * 1e3f64.cos()).abs(), 1e-8);
        // Steps beyond the domain are passed over.
        assert_relative(derivative(f64::acos, 0.999, 1e-5), (1.0 - 0.999f64.powi(2)).powf(-0.5), 1e-8);
        assert_eq!(derivative(|_| 4.0, 2.0, 1.0), 0.0);
    }

    #[test]
    fn linear_functions_are_exact_with_all_correlations() {
        let covariance = DMatrix::from_row_slice(2, 2, &[4.0, 1.0, 1.0, 9.0]);
        let result = propagate(|x| vec![x[0] + x[1], x[0] - 2.0 * x[1], 7.0], &[1.0, -3.0], &covariance).unwrap();
        assert_eq!(result.values, [-2.0, 7.0, 7.0]);
        // 4 + 9 + 2, 4 + 36 - 4, and the mixed term 4 - 18 - 2 + 1.
        let expected = DMatrix::from_row_slice(3, 3, &[15.0, -15.0, 0.0, -15.0, 36.0, 0.0, 0.0, 0.0, 0.0]);
        assert!((&result.covariance - expected).amax() < 1e-10, "{}", result.covariance);
        assert_relative(result.std[1], 6.0, 1e-12);
    }

    #[test]
    fn polar_coordinates_have_their_closed_form() {
        let (r, a) = (2.0, 0.7);
        let covariance = DMatrix::from_row_slice(2, 2, &[0.01, 0.002, 0.002, 0.04]);
        let result = propagate(|x| vec![x[0] * x[1].cos(), x[0] * x[1].sin()], &[r, a], &covariance).unwrap();
        let (s, c) = a.sin_cos();
        let jacobian = DMatrix::from_row_slice(2, 2, &[c, -r * s, s, r * c]);
        let expected = &jacobian * covariance * jacobian.transpose();
        assert!((result.covariance - expected).amax() < 1e-12);
    }

    #[test]
    fn parameters_without_variance_stay_put() {
        let f = |x: &[f64]| vec![if x[0] == 5.0 { x[1] * x[0] } else { f64::NAN }];
        let result = propagate(f, &[5.0, 2.0], &DMatrix::from_row_slice(2, 2, &[0.0, 0.0, 0.0, 1.0])).unwrap();
        assert_relative(result.std[0], 5.0, 1e-12);
    }

    #[test]
    fn what_cannot_be_propagated_is_refused() {
        let one = DMatrix::from_element(1, 1, 1.0);
        let identity = |x: &[f64]| x.to_vec();
        assert!(matches!(propagate(identity, &[1.0, 2.0], &one).unwrap_err(), FitError::Length { expected: 2, found: 1, .. }));
        assert!(matches!(propagate(identity, &[f64::NAN], &one).unwrap_err(), FitError::NotFinite { .. }));
        let wall = |x: &[f64]| vec![x[0], if x[0] == 1.0 { 0.0 } else { f64::NAN }];
        assert!(matches!(propagate(wall, &[1.0], &one).unwrap_err(), FitError::NotFinite { row: 1, .. }));
        let growing = |x: &[f64]| vec![0.0; if x[0] > 1.0 { 2 } else { 1 }];
        assert!(matches!(propagate(growing, &[1.0], &one).unwrap_err(), FitError::Length { .. }));
    }
}
