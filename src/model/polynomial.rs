//! A sensor parameter as a polynomial of the temperature: `p(T) = Σ p_k T^k`, T in °C (BC-MAG-TR-0085 sections 12 and 13).

use nalgebra::{DMatrix, DVector};

/// `Σ p_k T^k`, coefficients lowest order first; zero without any.
#[must_use]
pub fn value(coefficients: &[f64], temperature_degc: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| sum * temperature_degc + c)
}

/// Column k holds the coefficients of `(constant + slope x)^k` in powers of x.
#[must_use]
pub fn powers_of_line(count: usize, constant: f64, slope: f64) -> DMatrix<f64> {
    let mut map = DMatrix::zeros(count, count);
    for k in 0..count {
        for j in 0..=k {
            map[(j, k)] = match (j, k) {
                (0, 0) => 1.0,
                (0, _) => constant * map[(0, k - 1)],
                _ => slope * map[(j - 1, k - 1)] + constant * map[(j, k - 1)],
            };
        }
    }
    map
}

/// `p(T)` with the covariance of its coefficients and the range of temperatures it was fitted in.
///
/// The unit of coefficient k is that of the parameter per °C to the power k.
#[derive(Clone, Debug, PartialEq)]
pub struct TemperaturePolynomial {
    /// Coefficients of `T⁰ … Tᵈ`.
    pub coefficients: Vec<f64>,
    /// Their covariance, (d+1) x (d+1).
    pub covariance: DMatrix<f64>,
    /// Lowest and highest temperature of the fit, °C.
    pub valid_degc: [f64; 2],
}

impl TemperaturePolynomial {
    /// The order d; zero also without any coefficient.
    #[must_use]
    pub fn order(&self) -> usize {
        self.coefficients.len().saturating_sub(1)
    }

    /// Value and standard deviation at a temperature, °C, inside of the range of the fit or outside of it.
    ///
    /// Raw powers cancel in the variance. What is left of it is exact to 1e-9 at order 5 over -80 to 180 °C; the rounding of the
    /// covariance itself takes as much, so that higher precision here would gain nothing. A covariance of another size than the
    /// coefficients gives NaN.
    #[must_use]
    pub fn evaluate(&self, temperature_degc: f64) -> (f64, f64) {
        let variance = self.variance_of(|k| temperature_degc.powi(k as i32));
        (value(&self.coefficients, temperature_degc), variance.sqrt())
    }

    /// Variance of the sum of the coefficients with weights, such as the powers of a temperature; NaN where the covariance has another size
    /// than the coefficients.
    #[must_use]
    pub fn variance_of(&self, weight: impl Fn(usize) -> f64) -> f64 {
        let count = self.coefficients.len();
        if self.covariance.shape() != (count, count) {
            return f64::NAN;
        }
        let weights = DMatrix::from_fn(count, 1, |k, _| weight(k));
        let variance = weights.dot(&(&self.covariance * &weights));
        // Rounding may make a variance near zero negative; `max` would turn NaN into zero.
        if variance < 0.0 { 0.0 } else { variance }
    }

    /// The same polynomial in powers of `T - degc`, in the same range of temperatures.
    #[must_use]
    pub fn about(&self, degc: f64) -> Self {
        let count = self.coefficients.len();
        let map = powers_of_line(count, degc, 1.0);
        let known = self.covariance.shape() == (count, count);
        Self {
            coefficients: (&map * DVector::from_column_slice(&self.coefficients)).as_slice().to_vec(),
            covariance: if known { &map * &self.covariance * map.transpose() } else { self.covariance.clone() },
            valid_degc: self.valid_degc,
        }
    }

    /// Standard deviations of the coefficients.
    #[must_use]
    pub fn std(&self) -> Vec<f64> {
        self.covariance.diagonal().iter().map(|variance| variance.sqrt()).collect()
    }

    /// Whether the polynomial was fitted at temperatures on both sides of this one, °C: outside it is an extrapolation.
    #[must_use]
    pub fn covers(&self, temperature_degc: f64) -> bool {
        let [low, high] = self.valid_degc;
        (low..=high).contains(&temperature_degc)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::{Limits, polynomial};

    #[test]
    fn the_band_is_that_of_the_fit_up_to_order_five() {
        let x: Vec<f64> = (0..9).map(|i| -80.0 + 32.5 * f64::from(i)).collect();
        let noise = [0.3, -0.8, 1.1, 0.2, -1.4, 0.9, -0.1, 0.6, -0.7];
        let y: Vec<f64> = x.iter().zip(noise).map(|(t, e)| 0.97 - 1.8e-5 * t + 1e-8 * t * t + 1e-6 * e).collect();
        for order in 0..=5 {
            let fit = polynomial::fit(&x, &y, None, order, &Limits::default()).unwrap();
            let ours = TemperaturePolynomial {
                coefficients: fit.coefficients.clone(),
                covariance: fit.covariance(),
                valid_degc: [-80.0, 180.0],
            };
            for step in 0..=60 {
                let t = -100.0 + 5.0 * f64::from(step);
                let ((value, std), (expected, expected_std)) = (ours.evaluate(t), fit.evaluate(t));
                assert!((value - expected).abs() < 1e-14, "{order} {t}");
                assert!((std / expected_std - 1.0).abs() < 1e-9, "{order} {t}: {}", std / expected_std - 1.0);
            }
        }
    }

    #[test]
    fn values_and_bands_are_the_same_about_another_temperature() {
        let covariance = DMatrix::from_row_slice(3, 3, &[4.0, 0.1, -0.01, 0.1, 0.01, 1e-4, -0.01, 1e-4, 1e-4]);
        let own = TemperaturePolynomial { coefficients: vec![1.0, 0.5, -0.02], covariance, valid_degc: [-50.0, 80.0] };
        let about = own.about(12.5);
        for degc in [-40.0, 0.0, 12.5, 70.0] {
            let ((value, std), (expected, expected_std)) = (about.evaluate(degc - 12.5), own.evaluate(degc));
            assert!((value - expected).abs() < 1e-12 && (std / expected_std - 1.0).abs() < 1e-9, "{degc}");
        }
        // The slope is that of the derivative, 0.5 - 2 · 0.02 · 12.5.
        assert!((about.coefficients[1]).abs() < 1e-15);
    }

    #[test]
    fn extrapolation_shows() {
        let line = TemperaturePolynomial {
            coefficients: vec![1.0, 0.5],
            covariance: DMatrix::from_row_slice(2, 2, &[4.0, 0.0, 0.0, 0.01]),
            valid_degc: [-71.0, 180.0],
        };
        assert_eq!(line.order(), 1);
        assert!(line.covers(-71.0) && line.covers(180.0) && !line.covers(180.5) && !line.covers(f64::NAN));
        assert_eq!(line.evaluate(200.0), (101.0, (4.0f64 + 400.0).sqrt()));
        assert_eq!(line.std(), [2.0, 0.1]);
        assert!(TemperaturePolynomial { covariance: DMatrix::zeros(1, 1), ..line }.evaluate(1.0).1.is_nan());
    }
}
