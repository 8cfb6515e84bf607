//! The linear sensor: `B_c = Φ B_m`, `Φ = R_nom ρ ω σ`, and its split (BC-MAG-TR-0085 section 15.1).

use crate::data::convention::{Convention, PlanarAxes, angle_deg, base_vectors};
use crate::data::units::{FieldCoil, Reading};
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

/// Why a transfer matrix cannot be split.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SplitError {
    /// No inverse.
    #[error("the transfer matrix has no inverse")]
    Singular,
    /// Sensor axes in one plane.
    #[error("the sensor axes lie in one plane")]
    Planar,
}

/// Φ and its parts. Angles in degrees; σ in nT/enT.
#[derive(Clone, Debug, PartialEq)]
pub struct Split {
    /// Nominal orientation, nominal sensor to coil coordinates.
    pub r_nom: Matrix3<f64>,
    /// Rotation of the real against the nominal orientation.
    pub rho: Matrix3<f64>,
    /// Misalignment in the BepiColombo convention, lower triangular: `ω = (Qᵀ)⁻¹`.
    pub omega: Matrix3<f64>,
    /// Sensitivities σ_x, σ_y, σ_z.
    pub sigma: [f64; 3],
    /// `Φ`, readings to coil coordinates.
    pub phi: Matrix3<f64>,
    /// `φ̃ = ω σ`, what flight processing uses.
    pub phi_tilde: Matrix3<f64>,
    /// Angles between the sensor axes: ξ_xy, ξ_xz, ξ_yz.
    pub xi_deg: [f64; 3],
    /// Angles λ, μ, ν between each real and nominal sensor axis.
    pub rotation_deg: [f64; 3],
}

impl From<PlanarAxes> for SplitError {
    fn from(_: PlanarAxes) -> Self {
        SplitError::Planar
    }
}

/// Splits `Φ` for a nominal orientation.
///
/// # Errors
/// A singular matrix, or sensor axes in one plane.
pub fn split(phi: &Matrix3<f64>, r_nom: &Matrix3<f64>) -> Result<Split, SplitError> {
    // Ψ = (Φᵀ)⁻¹: its columns are the sensor axes in coil coordinates, divided by the sensitivities.
    let psi = phi.transpose().try_inverse().ok_or(SplitError::Singular)?;
    let columns: [Vector3<f64>; 3] = std::array::from_fn(|i| psi.column(i).into_owned());
    let sigma = columns.map(|c| 1.0 / c.norm());
    if sigma.iter().any(|s| !s.is_finite()) {
        return Err(SplitError::Singular);
    }
    let [e_x, e_y, e_z] = columns.map(|c| c.normalize());
    let xi_deg = [angle_deg(&e_x, &e_y), angle_deg(&e_x, &e_z), angle_deg(&e_y, &e_z)];
    let q = base_vectors(xi_deg)?;
    let omega = q.transpose().try_inverse().ok_or(SplitError::Planar)?;
    // φ̂ = (Eᵀ)⁻¹ with the axes E = [e_x e_y e_z], so ρ = R_nom⁻¹ φ̂ ω⁻¹ = R_nomᵀ E Q⁻¹.
    let q_inverse = q.try_inverse().ok_or(SplitError::Planar)?;
    let rho = r_nom.transpose() * Matrix3::from_columns(&[e_x, e_y, e_z]) * q_inverse;
    // The angle of a rotated axis from two of its components is well conditioned near zero, where arccos of the third is not.
    let rotation_deg = std::array::from_fn(|i| {
        let aside = (0..3).filter(|row| *row != i).map(|row| rho[(row, i)].powi(2)).sum::<f64>().sqrt();
        aside.atan2(rho[(i, i)]).to_degrees()
    });
    let phi_tilde = omega * Matrix3::from_diagonal(&Vector3::from(sigma));
    Ok(Split { r_nom: *r_nom, rho, omega, sigma, phi: *phi, phi_tilde, xi_deg, rotation_deg })
}

/// `Φ = R_nom ρ ω σ` from its parts.
///
/// # Errors
/// Angles that no three axes have between them.
pub fn compose(r_nom: &Matrix3<f64>, rho: &Matrix3<f64>, xi_deg: [f64; 3], sigma: [f64; 3]) -> Result<Matrix3<f64>, SplitError> {
    let omega = Convention::BepiColombo.omega(xi_deg)?;
    Ok(r_nom * rho * omega * Matrix3::from_diagonal(&Vector3::from(sigma)))
}

/// A sensor in one position: `B_r = Φ⁻¹ B_c + B_or`, in both directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Linear {
    phi: Matrix3<f64>,
    response: Matrix3<f64>,
}

impl Linear {
    /// From `Φ`, readings to coil coordinates, nT/enT.
    ///
    /// # Errors
    /// A matrix without inverse.
    pub fn new(phi: Matrix3<f64>) -> Result<Self, SplitError> {
        Ok(Self { phi, response: phi.try_inverse().ok_or(SplitError::Singular)? })
    }

    /// `A = Φ⁻¹`, enT/nT: rows are components, columns coil axes.
    #[must_use]
    pub fn response(&self) -> &Matrix3<f64> {
        &self.response
    }

    /// Reading in a field, with offset and residual field `B_or`, enT.
    #[must_use]
    pub fn reading(&self, field: FieldCoil, b_or_ent: [f64; 3]) -> Reading {
        Reading((self.response * Vector3::from(field.0) + Vector3::from(b_or_ent)).into())
    }

    /// The field that gives a reading: the modelled measurement `Φ (B_r - B_or)`, nT.
    #[must_use]
    pub fn field(&self, reading: Reading, b_or_ent: [f64; 3]) -> FieldCoil {
        FieldCoil((self.phi * (Vector3::from(reading.0) - Vector3::from(b_or_ent))).into())
    }
}

/// For each sensor component the nominal axis it really looks along, as `+x`, if that is not the one the position says.
#[must_use]
pub fn misplaced_axes(split: &Split) -> Vec<(usize, String)> {
    let axes = split.rho * base_vectors(split.xi_deg).unwrap_or_else(|_| Matrix3::identity());
    (0..3)
        .filter_map(|component| {
            let axis = axes.column(component);
            let along = axis.iamax();
            let negative = axis[along] < 0.0;
            let name = format!("{}{}", if negative { '-' } else { '+' }, crate::data::units::COMPONENTS[along]);
            (along != component || negative).then_some((component, name))
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation3;

    #[test]
    fn parts_come_back_from_their_product_in_every_position() {
        let axes: Vec<String> = ["-Z", "+Y", "+X"].map(str::to_owned).to_vec();
        for r_nom in [Matrix3::identity(), crate::model::position::Position::from_axes(&axes).unwrap().r_nom()] {
            let rho = Rotation3::from_euler_angles(0.011, -0.02, 0.007).into_inner();
            let (xi, sigma) = ([89.8, 90.3, 90.05], [0.98, 1.02, 0.995]);
            let phi = compose(&r_nom, &rho, xi, sigma).unwrap();
            let s = split(&phi, &r_nom).unwrap();
            assert!((s.rho - rho).norm() < 1e-14);
            for i in 0..3 {
                assert!((s.sigma[i] - sigma[i]).abs() < 1e-15 && (s.xi_deg[i] - xi[i]).abs() < 1e-12);
            }
            assert!((s.r_nom * s.rho * s.phi_tilde - phi).norm() < 1e-15);
            assert!(misplaced_axes(&s).is_empty());
        }
    }

    #[test]
    fn a_rotation_about_one_axis_shows_as_the_angle_of_the_other_two() {
        let rho = Rotation3::from_axis_angle(&Vector3::z_axis(), 0.01).into_inner();
        let s = split(&rho, &Matrix3::identity()).unwrap();
        let expected = 0.01f64.to_degrees();
        assert!((s.rotation_deg[0] - expected).abs() < 1e-12 && (s.rotation_deg[1] - expected).abs() < 1e-12);
        assert!(s.rotation_deg[2].abs() < 1e-12);
    }

    #[test]
    fn swapped_and_reversed_axes_are_named() {
        let swapped = Matrix3::new(0.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        let s = split(&swapped, &Matrix3::identity()).unwrap();
        assert!(s.rho.determinant() < 0.0);
        assert_eq!(misplaced_axes(&s), vec![(0, "+y".to_owned()), (1, "+x".to_owned())]);
        let reversed = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, 1.0));
        assert_eq!(misplaced_axes(&split(&reversed, &Matrix3::identity()).unwrap()), vec![(1, "-y".to_owned())]);
    }
}
