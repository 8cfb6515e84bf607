//! From a position beside the centre of the coil system to the centre (RO-IGEP-TR0028 sections 3.2.2.2 and 3.2.2.3). ω is in the Rosetta
//! convention here: the upper triangular `Q(ξ)` of [`Convention::Rosetta`].

use super::sensor::SplitError;
use crate::data::convention::{Alignment, Convention, column_angles_deg};
use nalgebra::{Matrix3, Vector3};

/// Change of sensitivities and angles at a position beside the centre. It belongs to the coil system and does not depend on temperature.
#[derive(Clone, Debug, PartialEq)]
pub struct Transfer {
    /// `k_i = σ¹_i(T1) / σ⁰_i(T1)`, superscript 1 off-centre, 0 at the centre.
    pub k: [f64; 3],
    /// `K = ω⁰(T1)⁻¹ ω¹(T1)`.
    pub k_matrix: Matrix3<f64>,
    /// `K⁻¹`.
    pub k_inverse: Matrix3<f64>,
}

impl Transfer {
    /// From sensitivities, nT/enT, and angles ξ_xy, ξ_xz, ξ_yz, degrees, of both positions at one temperature.
    ///
    /// # Errors
    /// Angles that no three axes have between them, or a sensitivity of zero.
    pub fn new(off_centre: ([f64; 3], [f64; 3]), centre: ([f64; 3], [f64; 3])) -> Result<Self, SplitError> {
        let k: [f64; 3] = std::array::from_fn(|i| off_centre.0[i] / centre.0[i]);
        if !k.iter().all(|k| k.is_finite() && *k != 0.0) {
            return Err(SplitError::Singular);
        }
        let omega = |xi_deg| Convention::Rosetta.omega(xi_deg);
        let k_matrix = omega(centre.1)?.try_inverse().ok_or(SplitError::Planar)? * omega(off_centre.1)?;
        Ok(Self { k, k_matrix, k_inverse: k_matrix.try_inverse().ok_or(SplitError::Planar)? })
    }

    /// The sensor at the centre from the sensor beside it, both in the Rosetta convention: lengths of and angles between the columns of
    /// `ω¹ K⁻¹ σ¹ / k`.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn to_centre(&self, beside: &Alignment) -> Result<Alignment, SplitError> {
        let sigma = Vector3::from_fn(|i, _| beside.sigma[i] / self.k[i]);
        let columns = self.omega(beside.xi_deg)? * Matrix3::from_diagonal(&sigma);
        Ok(Alignment {
            convention: Convention::Rosetta,
            sigma: std::array::from_fn(|i| columns.column(i).norm()),
            xi_deg: column_angles_deg(&columns),
        })
    }

    /// `ω⁰(T) = ω¹(T) K⁻¹` from the angles ξ¹(T) off-centre, degrees.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn omega(&self, xi_off_centre_deg: [f64; 3]) -> Result<Matrix3<f64>, SplitError> {
        Ok(Convention::Rosetta.omega(xi_off_centre_deg)? * self.k_inverse)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_the_temperature_of_the_pair_the_centre_comes_back() {
        let (off, centre) = (([1.09, 1.094, 0.97], [90.03, 89.95, 89.2]), ([1.0905, 1.0945, 0.98], [90.5, 89.94, 89.1]));
        let transfer = Transfer::new(off, centre).unwrap();
        let xi = column_angles_deg(&transfer.omega(off.1).unwrap());
        for i in 0..3 {
            assert!((off.0[i] / transfer.k[i] - centre.0[i]).abs() < 1e-15);
            assert!((xi[i] - centre.1[i]).abs() < 1e-12, "{xi:?}");
        }
        assert!(Transfer::new(off, ([0.0, 1.0, 1.0], centre.1)).is_err());
        assert!(Transfer::new(off, (centre.0, [10.0, 10.0, 170.0])).is_err());
    }
}
