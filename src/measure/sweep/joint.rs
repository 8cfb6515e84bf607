//! Nine parameters as polynomials of the temperature, fitted to all settings at once.

use super::means::{Means, Orders};
use super::refusal::SweepError;
use super::result::SweepBlock;
use crate::data::across::RunRotations;
use crate::data::plateau::Plateau;
use crate::fit::statistics::extremes;
use crate::fit::{DenseNoise, Limits, Propagated, propagate};
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::{Linear, Split, split};
use crate::record::baseline::Baseline;
use crate::record::conditions;
use nalgebra::Matrix3;

/// Largest condition number of a fit.
pub(super) const MOST_CONDITION: f64 = 1e4;

/// Sensitivities, angles and offsets as polynomials that follow from the coefficients of a baseline.
struct Curves {
    baseline: Baseline,
    r_nom: Matrix3<f64>,
    /// Temperatures through which the polynomials of sensitivities and angles go, °C.
    response_degc: Vec<f64>,
    /// The same of the offsets.
    offset_degc: Vec<f64>,
}

impl Curves {
    fn of(baseline: Baseline, orders: Orders, r_nom: Matrix3<f64>) -> Self {
        // Where interpolation errs least.
        let nodes = |order: usize| -> Vec<f64> {
            let angle = |k: usize| std::f64::consts::PI * (k as f64 + 0.5) / (order + 1) as f64;
            (0..=order).map(|k| baseline.middle() + baseline.half() * angle(k).cos()).collect()
        };
        Self { baseline, r_nom, response_degc: nodes(orders.response), offset_degc: nodes(orders.offset) }
    }

    /// The sensor at a temperature, if there is one.
    fn sensor(&self, stacked: &[f64], degc: f64) -> Option<Split> {
        split(&self.baseline.at(stacked, degc).0.try_inverse()?, &self.r_nom).ok()
    }

    /// All coefficients of the nine polynomials, one after the other, then the rotation at the middle temperature.
    fn coefficients(&self, stacked: &[f64]) -> Vec<f64> {
        let splits: Vec<Option<Split>> = self.response_degc.iter().map(|t| self.sensor(stacked, *t)).collect();
        let of = |get: &dyn Fn(&Split) -> f64| {
            let values: Vec<f64> = splits.iter().map(|s| s.as_ref().map_or(f64::NAN, get)).collect();
            through(&self.response_degc, &values)
        };
        let mut all: Vec<f64> = (0..3).flat_map(|i| of(&|s| s.sigma[i])).collect();
        all.extend((0..3).flat_map(|i| of(&|s| s.xi_deg[i])));
        for i in 0..3 {
            let values: Vec<f64> = self.offset_degc.iter().map(|t| self.baseline.at(stacked, *t).1[i]).collect();
            all.extend(through(&self.offset_degc, &values));
        }
        all.extend(self.sensor(stacked, self.baseline.middle()).map_or([f64::NAN; 3], |s| s.rotation_deg));
        all
    }
}

/// The joint fit.
pub(super) struct Joint {
    /// The linear model.
    pub baseline: Baseline,
    /// Its noise.
    pub noise: DenseNoise,
    /// Lowest and highest temperature of the settings, °C.
    pub valid_degc: [f64; 2],
    orders: Orders,
    stacked: Vec<f64>,
    found: Propagated,
}

impl Joint {
    /// Of settings at given temperatures.
    pub fn fit(means: &Means, used: &[&Plateau], degc: &[f64], orders: Orders, r_nom: Matrix3<f64>) -> Result<Self, SweepError> {
        let baseline = means.baseline(degc, orders);
        let limits = Limits { max_condition: MOST_CONDITION };
        let solution = baseline.fit(&means.fields_nt, degc, &means.readings_ent, &limits)?;
        let stacked = solution.coefficients.as_slice().to_vec();
        let noise = conditions::noise(&solution, used)?;
        let curves = Curves::of(baseline, orders, r_nom);
        if let Some(degc) = curves.response_degc.iter().find(|t| curves.sensor(&stacked, **t).is_none()) {
            return Err(SweepError::NoSensor { degc: *degc });
        }
        let found = propagate(|x| curves.coefficients(x), &stacked, &noise.covariance())?;
        Ok(Self { baseline, noise, valid_degc: extremes(degc.iter().copied()), orders, stacked, found })
    }

    /// The polynomials of σ_x, σ_y, σ_z, ξ_xy, ξ_xz, ξ_yz and `B_or` of x, y, z.
    pub fn polynomials(&self) -> Vec<TemperaturePolynomial> {
        let mut from = 0;
        let mut next = |order: usize| {
            let (at, count) = (from, order + 1);
            from += count;
            TemperaturePolynomial {
                coefficients: self.found.values[at..at + count].to_vec(),
                covariance: self.found.covariance.view((at, at), (count, count)).into_owned(),
                valid_degc: self.valid_degc,
            }
        };
        (0..9).map(|k| next(if k < 6 { self.orders.response } else { self.orders.offset })).collect()
    }

    /// Rotation at the middle temperature.
    pub fn rotation(&self) -> RunRotations {
        let from = 6 * (self.orders.response + 1) + 3 * (self.orders.offset + 1);
        let [lambda, mu, nu] = [from, from + 1, from + 2].map(|i| (vec![self.found.values[i]], vec![self.found.std[i]]));
        RunRotations {
            lambda_x_deg: lambda.0,
            mu_y_deg: mu.0,
            nu_z_deg: nu.0,
            lambda_x_std_deg: lambda.1,
            mu_y_std_deg: mu.1,
            nu_z_std_deg: nu.1,
            initial: None,
        }
    }

    /// The settings with what the fit leaves of them.
    pub fn blocks(&self, used: &[&Plateau], degc: &[f64]) -> Vec<SweepBlock> {
        let block = |(p, degc): (&&Plateau, &f64)| {
            let (response, b_or) = self.baseline.at(&self.stacked, *degc);
            let modelled = response.try_inverse().and_then(|phi| Linear::new(phi).ok()).map(|s| s.field(p.mean, b_or).0);
            let residual_nt = modelled.map_or([f64::NAN; 3], |m| std::array::from_fn(|k| p.setting.field.0[k] - m[k]));
            SweepBlock { t_s: p.t_s(), temperature_degc: *degc, residual_nt }
        };
        used.iter().zip(degc).map(block).collect()
    }
}

/// Coefficients of the polynomial through as many points, lowest order first: Newton's divided differences.
fn through(x: &[f64], y: &[f64]) -> Vec<f64> {
    let mut differences = y.to_vec();
    for k in 1..x.len() {
        for i in (k..x.len()).rev() {
            differences[i] = (differences[i] - differences[i - 1]) / (x[i] - x[i - k]);
        }
    }
    let mut coefficients: Vec<f64> = Vec::new();
    for (difference, x) in differences.iter().zip(x).rev() {
        // Times (T - x), plus the difference.
        let mut next = vec![0.0; coefficients.len() + 1];
        for (k, c) in coefficients.iter().enumerate() {
            next[k + 1] += c;
            next[k] -= c * x;
        }
        next[0] += difference;
        coefficients = next;
    }
    coefficients.truncate(x.len());
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_through_points_has_their_coefficients() {
        let cubic = |t: f64| 2.0 - 0.5 * t + 0.25 * t * t - 0.125 * t * t * t;
        let x = [-3.0, -1.0, 0.5, 4.0];
        let found = through(&x, &x.map(cubic));
        for (found, expected) in found.iter().zip([2.0, -0.5, 0.25, -0.125]) {
            assert!((found - expected).abs() < 1e-13, "{found}");
        }
        assert_eq!(through(&[7.0], &[3.0]), [3.0]);
    }
}
