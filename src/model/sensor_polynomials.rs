//! Sensitivities, angles and offset of a sensor as polynomials of its temperature, with their uncertainties, as a thermal analysis gives
//! them: what a run takes its slopes from while the sensor temperature moves (docs/mathematics.md, "Temperature").

use super::lag::Lag;
use super::polynomial::TemperaturePolynomial;
use super::sensor::Split;
use crate::data::convention::base_vectors;
use crate::data::provenance::Input;
use crate::fit::noise::dense::GroupNoise;
use nalgebra::{Matrix3, Rotation3, Vector3};

/// The polynomials of a sensor in one mode.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorPolynomials {
    /// The file that holds them.
    pub input: Input,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Channel of the sensor temperature; absent if the file does not tell.
    pub channel: Option<String>,
    /// How the part of the sensor whose temperature they follow goes after that channel, where the two differ.
    pub lag: Option<Lag>,
    /// Lowest and highest temperature for which all of them hold, °C.
    pub valid_degc: [f64; 2],
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [TemperaturePolynomial; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Offset and residual field of x, y and z, enT.
    pub b_or_ent: [TemperaturePolynomial; 3],
    /// A sensitivity or angle that is constant although nobody gave it the order 0: its runs show no slope, which tells none of zero.
    pub without_slope: Option<String>,
    /// What the runs behind them show of their noise together; absent where the file does not tell.
    pub noise: Option<GroupNoise>,
}

impl SensorPolynomials {
    /// A quantity whose coefficients have no covariance, if there is one.
    #[must_use]
    pub fn without_covariance(&self) -> Option<String> {
        let lacks = |p: &TemperaturePolynomial| {
            let count = p.coefficients.len();
            p.covariance.shape() != (count, count) || p.covariance.iter().any(|c| !c.is_finite())
        };
        let find = |family: &str, names: [&str; 3], all: &[TemperaturePolynomial; 3]| {
            names.iter().zip(all).find(|(_, p)| lacks(p)).map(|(name, _)| format!("{family}_{name}"))
        };
        find("sigma", ["x", "y", "z"], &self.sigma).or_else(|| find("xi", ["xy", "xz", "yz"], &self.xi_deg))
    }
}

/// How the parameters of the response change about the stated temperature, in powers of `T - T_0`, the first power first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorChange {
    /// σ_x, σ_y, σ_z, nT/enT, and ξ_xy, ξ_xz, ξ_yz, degrees, per K to the power.
    pub sensor: [Vec<f64>; 6],
    /// Turn of the sensor about its axes, radians.
    pub turn: Vec<Vector3<f64>>,
    /// Offset of x, y, z, enT.
    pub b_or: [Vec<f64>; 3],
}

/// `Σ c_k x^(k+1)`.
#[must_use]
pub fn change_at(coefficients: &[f64], x: f64) -> f64 {
    coefficients.iter().rev().fold(0.0, |sum, c| (sum + c) * x)
}

impl SensorChange {
    /// What the polynomials say of a sensor about a temperature, °C.
    #[must_use]
    pub fn of(polynomials: &SensorPolynomials, degc: f64) -> Self {
        let [x, y, z] = polynomials.sigma.each_ref();
        let [xy, xz, yz] = polynomials.xi_deg.each_ref();
        let slopes = |p: &TemperaturePolynomial| p.about(degc).coefficients.get(1..).unwrap_or_default().to_vec();
        Self { sensor: [x, y, z, xy, xz, yz].map(slopes), turn: Vec::new(), b_or: polynomials.b_or_ent.each_ref().map(slopes) }
    }

    /// What a reading so many kelvins over the stated temperature has over one there, of a sensor with the parameters that it has there,
    /// enT; `None` for angles that no three axes have between them.
    #[must_use]
    pub fn reading_ent(&self, at: &Split, over_k: f64, field_coil_nt: [f64; 3]) -> Option<[f64; 3]> {
        let own = |k: usize| change_at(&self.sensor[k], over_k);
        let sigma = std::array::from_fn(|i| at.sigma[i] + own(i));
        let xi_deg = std::array::from_fn(|i| at.xi_deg[i] + own(3 + i));
        let turn = self.turn.iter().rev().fold(Vector3::zeros(), |sum, turn| (sum + turn) * over_k);
        let field = (at.r_nom * at.rho).transpose() * Vector3::from(field_coil_nt);
        let there = response(sigma, xi_deg)? * (Rotation3::new(-turn) * field);
        let here = response(at.sigma, at.xi_deg)? * field;
        Some(std::array::from_fn(|i| there[i] - here[i] + change_at(&self.b_or[i], over_k)))
    }
}

/// `S = σ⁻¹ Qᵀ(ξ)`: readings without offset are S times the field in the sensor frame; σ in nT/enT, ξ in degrees. `None` for angles that no
/// three axes have between them.
#[must_use]
pub fn response(sigma: [f64; 3], xi_deg: [f64; 3]) -> Option<Matrix3<f64>> {
    let q = base_vectors(xi_deg).ok()?;
    Some(Matrix3::from_fn(|i, j| q[(j, i)] / sigma[i]))
}
