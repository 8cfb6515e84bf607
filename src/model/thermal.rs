//! A sensor whose parameters are polynomials of its temperature (BC-MAG-TR-0085 sections 12 and 13).

use super::polynomial::value;
use super::response::Response;
use super::sensor::{Linear, SplitError, compose};
use nalgebra::Matrix3;

/// Coefficients per component, lowest order first; the unit of coefficient k is that of the quantity per °C to the power k.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermalSensor {
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [Vec<f64>; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [Vec<f64>; 3],
    /// B_off of x, y, z, enT.
    pub b_off_ent: [Vec<f64>; 3],
    /// f_3dB of x, y, z, Hz.
    pub f_3db_hz: [Vec<f64>; 3],
    /// Shape of the AC response.
    pub response: Response,
    /// Its parameters; those in Hz count in their proportions only, f_3dB tells their size.
    pub response_parameters: Vec<f64>,
}

impl ThermalSensor {
    /// The sensor at a temperature, °C, turned by `rho` out of the nominal orientation `r_nom`.
    ///
    /// # Errors
    /// Angles that no three axes have between them, or a sensitivity of zero.
    pub fn at(&self, temperature_degc: f64, r_nom: &Matrix3<f64>, rho: &Matrix3<f64>) -> Result<Linear, SplitError> {
        let each = |polynomials: &[Vec<f64>; 3]| std::array::from_fn(|i| value(&polynomials[i], temperature_degc));
        Linear::new(compose(r_nom, rho, each(&self.xi_deg), each(&self.sigma))?)
    }

    /// Offset at a temperature, enT.
    #[must_use]
    pub fn offset_ent(&self, temperature_degc: f64) -> [f64; 3] {
        std::array::from_fn(|i| value(&self.b_off_ent[i], temperature_degc))
    }

    /// Parameters of the AC response of each component at a temperature; `None` where its shape has no -3 dB point.
    #[must_use]
    pub fn response_at(&self, temperature_degc: f64) -> Option<[Vec<f64>; 3]> {
        let of = |i: usize| self.response.scaled_to(value(&self.f_3db_hz[i], temperature_degc), &self.response_parameters);
        Some([of(0)?, of(1)?, of(2)?])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::units::{FieldCoil, Reading};

    fn sensor() -> ThermalSensor {
        ThermalSensor {
            sigma: [vec![0.97, 1e-3], vec![1.0], vec![0.99, 0.0, 1e-5]],
            xi_deg: [vec![90.0], vec![90.0], vec![90.0]],
            b_off_ent: [vec![1.0, 0.5], vec![], vec![-2.0]],
            f_3db_hz: [vec![60.0, 0.1], vec![50.0], vec![40.0]],
            response: Response::named("second order").unwrap(),
            response_parameters: vec![7.0, 0.8],
        }
    }

    #[test]
    fn readings_of_orthogonal_axes_are_fields_over_sensitivities() {
        let hot = sensor().at(20.0, &Matrix3::identity(), &Matrix3::identity()).unwrap();
        let offset = sensor().offset_ent(20.0);
        assert_eq!(offset, [11.0, 0.0, -2.0]);
        let Reading(r) = hot.reading(FieldCoil([99.0, 10.0, -99.4]), offset);
        assert!((r[0] - 111.0).abs() < 1e-12 && (r[1] - 10.0).abs() < 1e-12 && (r[2] + 102.0).abs() < 1e-12);
        let FieldCoil(back) = hot.field(Reading(r), offset);
        assert!((back[0] - 99.0).abs() < 1e-12 && (back[2] + 99.4).abs() < 1e-12);
    }

    #[test]
    fn the_response_has_its_corner_where_the_polynomial_says() {
        let parameters = sensor().response_at(100.0).unwrap();
        let response = sensor().response;
        for (own, expected) in parameters.iter().zip([70.0, 50.0, 40.0]) {
            assert!((response.value(expected, own) - std::f64::consts::FRAC_1_SQRT_2).abs() < 1e-12 && own[1] == 0.8);
        }
    }
}
