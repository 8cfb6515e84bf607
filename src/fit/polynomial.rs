//! Polynomials of one variable, fitted where they are well conditioned and reported in raw powers.
//!
//! The range of x is mapped to \[-1, 1\], the powers of the mapped variable are formed in double-double, and coefficients
//! and covariance go back to powers of x in double-double, so that neither direction costs digits.

use nalgebra::DMatrix;

use super::double_double::{DoubleDouble, product};
use super::linear::{Design, Limits, solve};
use super::{FitError, require_finite, require_length};

/// A fitted polynomial of degree d in powers of x, lowest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Polynomial {
    /// Coefficients of `x⁰ … xᵈ`.
    pub coefficients: Vec<f64>,
    /// `(XᵀWX)⁻¹` of the raw powers, (d+1) x (d+1).
    pub unscaled_covariance: DMatrix<f64>,
    /// Observed minus fitted, one per point.
    pub residuals: Vec<f64>,
    /// Condition number of the design in the mapped variable.
    pub condition: f64,
    /// Points of positive weight minus coefficients.
    pub dof: usize,
    /// Standard deviation of a point of unit weight; NaN where `dof` is zero.
    pub residual_std: f64,
    centre: f64,
    half_range: f64,
    mapped: Vec<f64>,
    mapped_covariance: DMatrix<f64>,
}

impl Polynomial {
    /// Covariance of the coefficients for independent errors, (d+1) x (d+1).
    pub fn covariance(&self) -> DMatrix<f64> {
        &self.unscaled_covariance * self.residual_std.powi(2)
    }

    /// Value and standard deviation at `x`, free of the cancellation that raw powers suffer.
    pub fn evaluate(&self, x: f64) -> (f64, f64) {
        let (value, unit_std) = self.evaluate_unscaled(x);
        (value, self.residual_std * unit_std)
    }

    /// Value at `x` and what its standard deviation is for points whose variances are one over their weights.
    pub fn evaluate_unscaled(&self, x: f64) -> (f64, f64) {
        let t = (x - self.centre) / self.half_range;
        let value = self.mapped.iter().rev().fold(0.0, |sum, c| sum * t + c);
        let powers = DMatrix::from_fn(self.mapped.len(), 1, |k, _| t.powi(k as i32));
        let variance = powers.dot(&(&self.mapped_covariance * &powers));
        (value, variance.sqrt())
    }
}

/// Fits `y` (n points) by a polynomial of the given degree in `x`; weights as in [`solve`].
///
/// # Errors
///
/// Those of [`solve`]; [`FitError::Undetermined`] names powers of x as `x^k`, for example where too few different x are
/// given.
pub fn fit(x: &[f64], y: &[f64], weights: Option<&[f64]>, degree: usize, limits: &Limits) -> Result<Polynomial, FitError> {
    require_length("y", x.len(), y.len())?;
    require_finite("x", x, x.len())?;
    let (low, high) = x.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &x| (low.min(x), high.max(x)));
    // These two are rounded once and used exactly from here on, which moves the map by less than a digit.
    let centre = 0.5 * low + 0.5 * high;
    let half_range = if high > low { 0.5 * high - 0.5 * low } else { 1.0 };

    let names = (0..=degree).map(|k| format!("x^{k}")).collect();
    let mut powers = DMatrix::from_element(x.len(), degree + 1, DoubleDouble::ONE);
    for (i, &x) in x.iter().enumerate() {
        let t = DoubleDouble::sum(x, -centre) / half_range;
        for k in 1..=degree {
            powers[(i, k)] = powers[(i, k - 1)] * t;
        }
    }
    let design = Design::precise(names, powers)?;
    let rhs = DMatrix::from_column_slice(y.len(), 1, y);
    let solution = solve(&design, &rhs, weights, limits)?;

    let map = raw_powers(degree, centre, half_range);
    let coefficients = product(&map, &solution.precise_coefficients);
    let covariance = product(&product(&map, &solution.precise_covariance), &map.transpose());
    let polynomial = Polynomial {
        coefficients: coefficients.iter().map(|value| value.value()).collect(),
        unscaled_covariance: covariance.map(DoubleDouble::value),
        residuals: solution.residuals.iter().copied().collect(),
        condition: solution.condition,
        dof: solution.dof,
        residual_std: solution.residual_std[0],
        centre,
        half_range,
        mapped: solution.coefficients.iter().copied().collect(),
        mapped_covariance: solution.unscaled_covariance,
    };
    // A degree or range beyond all reason overflows here.
    require_finite("coefficients", &polynomial.coefficients, degree + 1)?;
    require_finite("covariance", polynomial.unscaled_covariance.as_slice(), degree + 1)?;
    Ok(polynomial)
}

/// Column k holds the coefficients of `((x - centre) / half_range)^k` in raw powers of x.
fn raw_powers(degree: usize, centre: f64, half_range: f64) -> DMatrix<DoubleDouble> {
    let mut map = DMatrix::from_element(degree + 1, degree + 1, DoubleDouble::default());
    map[(0, 0)] = DoubleDouble::ONE;
    for k in 1..=degree {
        for j in 0..=k {
            let shifted = if j > 0 { map[(j - 1, k - 1)] } else { DoubleDouble::default() };
            map[(j, k)] = (shifted - map[(j, k - 1)] * centre) / half_range;
        }
    }
    map
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_exact_cubic_far_from_zero_is_found() {
        // 7 - 3 x + x³ / 2 in integers, exact in f64.
        let x: Vec<f64> = (0..9).map(|i| 1000.0 + 2.0 * f64::from(i)).collect();
        let y: Vec<f64> = x.iter().map(|x| 7.0 - 3.0 * x + 0.5 * x * x * x).collect();
        let fit = fit(&x, &y, None, 3, &Limits::default()).unwrap();
        for (found, expected) in fit.coefficients.iter().zip([7.0, -3.0, 0.0, 0.5]) {
            assert!((found - expected).abs() < 1e-12, "{found} {expected}");
        }
        assert_eq!((fit.dof, fit.residuals.len()), (5, 9));
        assert!(fit.residual_std < 1e-12);
        let (value, _) = fit.evaluate(1003.0);
        assert!((value - 504_510_511.5).abs() < 1e-6);
    }

    #[test]
    fn a_line_has_its_closed_form() {
        // x = 10 … 14, Sxx = 10, Sxy = 7, mean 12: slope 0.7, residual sum of squares Syy - 4.9 = 0.3.
        let y = [1.0, 2.0, 2.0, 3.0, 4.0];
        let line = fit(&[10.0, 11.0, 12.0, 13.0, 14.0], &y, None, 1, &Limits::default()).unwrap();
        assert!((line.coefficients[1] - 0.7).abs() < 1e-15);
        assert!((line.coefficients[0] + 6.0).abs() < 1e-14);
        assert!((line.residual_std - 0.1_f64.sqrt()).abs() < 1e-15);
        // (XᵀX)⁻¹ = [Σx² -Σx; -Σx n] / (n Sxx).
        let expected = DMatrix::from_row_slice(2, 2, &[14.6, -1.2, -1.2, 0.1]);
        assert!((&line.unscaled_covariance - &expected).amax() < 1e-14);
        assert!((line.covariance() - expected * 0.1).amax() < 1e-14);
        // Variance of the line: s² (1/n + (x - mean)² / Sxx).
        let (value, std) = line.evaluate(22.0);
        assert!((value - 9.4).abs() < 1e-14);
        assert!((std - (0.1_f64 * (0.2 + 10.0)).sqrt()).abs() < 1e-14);
    }

    #[test]
    fn weights_leave_points_out() {
        let (x, y) = ([0.0, 1.0, 2.0, 3.0], [1.0, 3.0, 100.0, 7.0]);
        let line = fit(&x, &y, Some(&[1.0, 2.0, 0.0, 1.0]), 1, &Limits::default()).unwrap();
        assert!((line.coefficients[0] - 1.0).abs() < 1e-14 && (line.coefficients[1] - 2.0).abs() < 1e-14);
        assert!((line.residuals[2] - 95.0).abs() < 1e-13);
    }

    #[test]
    fn degree_zero_is_the_mean() {
        let mean = fit(&[5.0, 5.0, 5.0], &[1.0, 2.0, 6.0], None, 0, &Limits::default()).unwrap();
        assert!((mean.coefficients[0] - 3.0).abs() < 1e-15);
        assert!((mean.evaluate(-1.0).1 - (7.0_f64 / 3.0).sqrt()).abs() < 1e-15);
    }

    #[test]
    fn too_few_different_points_are_refused_by_name() {
        let (x, y) = ([1.0, 1.0, 2.0, 2.0], [1.0, 2.0, 3.0, 4.0]);
        let error = fit(&x, &y, None, 2, &Limits::default()).unwrap_err();
        let FitError::Undetermined { parameters, .. } = error else { panic!("{error:?}") };
        assert_eq!(parameters, ["x^0", "x^2"]);
        let error = fit(&[1.0, 1.0], &[0.0, 1.0], None, 1, &Limits::default()).unwrap_err();
        let expected = FitError::Undetermined { parameters: vec!["x^1".into()], condition: f64::INFINITY };
        assert_eq!(error, expected);
        let error = fit(&[], &[], None, 1, &Limits::default()).unwrap_err();
        assert_eq!(error, FitError::TooFewRows { rows: 0, parameters: 2 });
        let error = fit(&[1.0], &[0.0, 1.0], None, 1, &Limits::default()).unwrap_err();
        assert!(matches!(error, FitError::Length { expected: 1, found: 2, .. }));
        let error = fit(&[1.0, f64::NAN], &[0.0, 1.0], None, 1, &Limits::default()).unwrap_err();
        assert!(matches!(error, FitError::NotFinite { row: 1, .. }));
    }
}
