//! Sensitivities, angles and offset of a sensor as polynomials of its temperature, with their uncertainties, as a thermal analysis gives
//! them: what a run takes its slopes from while the sensor temperature moves (mathematics.md section 6).

use super::polynomial::TemperaturePolynomial;
use crate::data::provenance::Input;

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
    /// Lowest and highest temperature for which all of them hold, °C.
    pub valid_degc: [f64; 2],
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [TemperaturePolynomial; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [TemperaturePolynomial; 3],
    /// Offset and residual field of x, y and z, enT.
    pub b_or_ent: [TemperaturePolynomial; 3],
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
