//! The coil system: from settings to the field at its centre (CH-GFZ-TR-2601 section 6; docs/mathematics.md, "The coil system").

use crate::data::units::FieldCoil;
use nalgebra::{Matrix3, Vector3};

/// The largest relative change of a scale factor with the coil temperature in CH-GFZ-TR-2601 section 6, 1/K: that of X, alike in all axes of one frame. It is
/// sized by the expansion of a metal frame, which other coil systems share.
pub const SCALE_PER_K: f64 = 1.90e-5;
/// By how much the axes differ there: 1.65e-5 to 1.90e-5, 1/K.
pub const SCALE_APART_PER_K: f64 = 0.25e-5;
/// The largest change of an offset field there, that of Z, nT/K; the axes are independent (0.35, 0 and 0.80).
pub const OFFSET_NT_PER_K: f64 = 0.80;

/// What turns settings into a field: scale factors, offset fields, angles between the axes, and what the temperatures of coil and
/// rack do to them. In [`Coil::IDEAL`] the field is the setting.
#[derive(Clone, Debug, PartialEq)]
pub struct Coil {
    /// Scale factors per axis at the reference temperatures, nT per unit of the setting.
    pub scale_nt_per_eu: [f64; 3],
    /// Relative change of the scale factors with the coil temperature, 1/K.
    pub scale_per_k: [f64; 3],
    /// Relative change of the scale factors with the rack temperature, 1/K.
    pub rack_scale_per_k: [f64; 3],
    /// Offset fields at the reference temperatures, nT, coil axes.
    pub offset_nt: [f64; 3],
    /// Change of the offset fields with the coil temperature, nT/K.
    pub offset_nt_per_k: [f64; 3],
    /// Change of the offset fields with the rack temperature, nT/K.
    pub rack_offset_nt_per_k: [f64; 3],
    /// Angles between the axes of the coils: XY, XZ, YZ, degrees.
    pub angles_deg: [f64; 3],
    /// Coil temperature at which scale factors and offset fields hold, °C.
    pub reference_degc: f64,
    /// Rack temperature at which they hold, °C.
    pub rack_reference_degc: f64,
}

impl Coil {
    /// The field is the setting, at any temperature.
    pub const IDEAL: Coil = Coil {
        scale_nt_per_eu: [1.0; 3],
        scale_per_k: [0.0; 3],
        rack_scale_per_k: [0.0; 3],
        offset_nt: [0.0; 3],
        offset_nt_per_k: [0.0; 3],
        rack_offset_nt_per_k: [0.0; 3],
        angles_deg: [90.0; 3],
        reference_degc: 16.5,
        rack_reference_degc: 32.0,
    };

    /// The axes of the coils as columns, in coil coordinates: X_c along the coil X, Y_c in the plane of the coils X and Y.
    ///
    /// `None` for angles that no three axes have between them.
    #[must_use]
    pub fn axes(&self) -> Option<Matrix3<f64>> {
        crate::data::convention::base_vectors(self.angles_deg).ok()
    }

    /// Derivatives of [`Coil::axes`] by the angles XY, XZ, YZ, per degree; `None` where there are no axes.
    #[must_use]
    pub fn axes_per_degree(&self) -> Option<[Matrix3<f64>; 3]> {
        let axes = self.axes()?;
        let [xy, xz, yz] = self.angles_deg.map(f64::to_radians);
        // The third axis is (cos xz, q, height).
        let (q, height) = (axes[(1, 2)], axes[(2, 2)]);
        let q_by = [xz.cos() - q / xy.tan(), xy.cos() * xz.sin() / xy.sin(), -yz.sin() / xy.sin()];
        let squares_by = [0.0, xz.sin() * xz.cos(), 0.0];
        Some(std::array::from_fn(|angle| {
            let mut by = Matrix3::zeros();
            if angle == 0 {
                by.set_column(1, &Vector3::new(-xy.sin(), xy.cos(), 0.0));
            }
            let x_by = if angle == 1 { -xz.sin() } else { 0.0 };
            by.set_column(2, &Vector3::new(x_by, q_by[angle], (squares_by[angle] - q * q_by[angle]) / height));
            by * 1f64.to_radians()
        }))
    }

    /// The field of a setting at the temperatures of the coils X, Y and Z and of the rack, °C; `axes` are those of [`Coil::axes`].
    #[must_use]
    pub fn field(&self, axes: &Matrix3<f64>, setting: [f64; 3], coil_degc: [f64; 3], rack_degc: f64) -> FieldCoil {
        let (coil_k, rack_k) = (coil_degc.map(|t| t - self.reference_degc), rack_degc - self.rack_reference_degc);
        let driven = Vector3::from_fn(|k, _| {
            let scale =
                self.scale_nt_per_eu[k] * (1.0 + self.scale_per_k[k] * coil_k[k]) * (1.0 + self.rack_scale_per_k[k] * rack_k);
            scale * setting[k]
        });
        let offset = Vector3::from_fn(|k, _| {
            self.offset_nt[k] + self.offset_nt_per_k[k] * coil_k[k] + self.rack_offset_nt_per_k[k] * rack_k
        });
        FieldCoil((axes * driven + offset).into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn temperatures_act_as_the_facility_model_of_1998_says() {
        // CH-GFZ-TR-2601 section 6: F_X = 0.99988 [1 + 1.90e-5 (T_X - 16.5)] [1 - 8e-7 (T_R - 32)], offset 2.0 + 0.35 (T - 16.5) + ...
        let coil = Coil {
            scale_nt_per_eu: [0.99988, 0.99993, 0.99994],
            scale_per_k: [1.90e-5, 1.65e-5, 1.75e-5],
            rack_scale_per_k: [-8e-7; 3],
            offset_nt: [2.0, -2.2, -1.2],
            offset_nt_per_k: [0.35, 0.0, 0.80],
            rack_offset_nt_per_k: [0.075, 0.0, 0.2],
            ..Coil::IDEAL
        };
        let axes = coil.axes().unwrap();
        let field = coil.field(&axes, [50_000.0, 0.0, 0.0], [17.5; 3], 30.0).0;
        let expected = 50_000.0 * 0.99988 * (1.0 + 1.90e-5) * (1.0 + 1.6e-6) + 2.0 + 0.35 - 0.15;
        assert!((field[0] - expected).abs() < 1e-9);
        assert!((field[1] + 2.2).abs() < 1e-9 && (field[2] - (-1.2 + 0.8 - 0.4)).abs() < 1e-9);
    }

    #[test]
    fn every_coil_has_the_temperature_of_its_own() {
        let coil = Coil { scale_per_k: [1e-3; 3], offset_nt_per_k: [1.0; 3], ..Coil::IDEAL };
        let axes = coil.axes().unwrap();
        let FieldCoil(field) = coil.field(&axes, [100.0; 3], [16.5, 17.5, 14.5], 32.0);
        for (found, expected) in field.into_iter().zip([100.0, 100.1 + 1.0, 99.8 - 2.0]) {
            assert!((found - expected).abs() < 1e-12, "{field:?}");
        }
    }

    #[test]
    fn axes_turn_with_the_angles_as_their_differences_say() {
        let coil = Coil { angles_deg: [91.3, 87.9, 88.6], ..Coil::IDEAL };
        let by = coil.axes_per_degree().unwrap();
        for (angle, by) in by.into_iter().enumerate() {
            let moved = |deg: f64| {
                let mut moved = coil.clone();
                moved.angles_deg[angle] += deg;
                moved.axes().unwrap()
            };
            assert!(((moved(1e-4) - moved(-1e-4)) / 2e-4 - by).amax() < 1e-10);
        }
    }

    #[test]
    fn skew_coils_add_as_vectors() {
        let coil = Coil { angles_deg: [90.0031, 89.9962, 89.9664], ..Coil::IDEAL };
        let axes = coil.axes().unwrap();
        let fields = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|s| coil.field(&axes, s, [16.5; 3], 32.0).0);
        let dot = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        for (pair, angle) in [((0, 1), 90.0031f64), ((0, 2), 89.9962), ((1, 2), 89.9664)] {
            assert!((dot(fields[pair.0], fields[pair.1]) - angle.to_radians().cos()).abs() < 1e-15);
        }
    }
}
