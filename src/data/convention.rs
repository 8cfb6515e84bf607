//! The two ways in which misalignment is written, and the exact way from one to the other (BC-MAG-TR-0085 section 15.1,
//! RO-IGEP-TR0028 section 3.3).
//!
//! A sensor axis with unit vector `e_i` reads `(e_i · B) / σ_i`. BepiColombo states the angles ξ between the axes `e_i` and uses
//! `ω = (Q(ξ)ᵀ)⁻¹`, lower triangular. Rosetta states the angles between the columns of the matrix that takes readings to the field, and
//! uses `ω = Q(ξ)` itself, upper triangular. These columns are the dual basis of the axes, so that the way from one convention to the
//! other is the same in both directions: invert, transpose, and take lengths and angles of the columns. To first order the angles of one
//! convention are 180° minus those of the other; angles put into the wrong formula turn the sign of every misalignment.

use nalgebra::{Matrix3, Matrix6, Vector3, Vector6};
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// Angles that no three axes have between them.
#[derive(Clone, Copy, Debug, Error, PartialEq)]
#[error("the sensor axes lie in one plane")]
pub struct PlanarAxes;

/// How the angles ξ make the misalignment matrix ω.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Convention {
    /// `ω = (Q(ξ)ᵀ)⁻¹`, lower triangular; ξ are the angles between the sensor axes.
    BepiColombo,
    /// `ω = Q(ξ)`, upper triangular with columns of length one; ξ are the angles between these columns.
    Rosetta,
}

/// Sensitivities and angles of one sensor in one convention.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Alignment {
    /// What the angles mean.
    pub convention: Convention,
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [f64; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
}

/// Standard uncertainties of σ_x, σ_y, σ_z, nT/enT, and of ξ_xy, ξ_xz, ξ_yz, degrees, as far as they are known.
pub type AlignmentStd = [Option<[f64; 3]>; 2];

/// An [`Alignment`] in the other convention.
#[derive(Clone, Debug, PartialEq)]
pub struct Converted {
    /// The same sensor in the other convention.
    pub alignment: Alignment,
    /// Derivatives of the new (σ_x, σ_y, σ_z, ξ_xy, ξ_xz, ξ_yz) by the old ones, with angles in degrees.
    pub jacobian: Matrix6<f64>,
    /// Takes vectors in the sensor frame of the new convention to the frame of the old one: `(ω σ)_old = P (ω σ)_new`.
    pub rotation: Matrix3<f64>,
}

impl Converted {
    /// Covariance of the new (σ, ξ) from that of the old ones, angles in degrees: `J C Jᵀ`.
    #[must_use]
    pub fn covariance(&self, old: &Matrix6<f64>) -> Matrix6<f64> {
        self.jacobian * old * self.jacobian.transpose()
    }
}

/// Pairs of axes in the order of the angles ξ_xy, ξ_xz, ξ_yz.
const PAIRS: [(usize, usize); 3] = [(0, 1), (0, 2), (1, 2)];

/// `Q(ξ)`, upper triangular: three unit vectors as columns with the angles ξ_xy, ξ_xz, ξ_yz, degrees, between them, the first along x,
/// the second in the xy plane.
///
/// # Errors
/// Angles that no three axes have between them.
pub fn base_vectors(xi_deg: [f64; 3]) -> Result<Matrix3<f64>, PlanarAxes> {
    let [xy, xz, yz] = xi_deg.map(f64::to_radians);
    let q = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    let height = xz.sin().powi(2) - q * q;
    if height.is_nan() || height <= 0.0 {
        return Err(PlanarAxes);
    }
    Ok(Matrix3::new(1.0, xy.cos(), xz.cos(), 0.0, xy.sin(), q, 0.0, 0.0, height.sqrt()))
}

/// `Q(ξ)` and its derivatives by ξ_xy, ξ_xz, ξ_yz, per degree.
///
/// # Errors
/// Angles that no three axes have between them.
pub fn base_vectors_and_slopes(xi_deg: [f64; 3]) -> Result<(Matrix3<f64>, [Matrix3<f64>; 3]), PlanarAxes> {
    let matrix = base_vectors(xi_deg)?;
    let [(sin_xy, cos_xy), (sin_xz, cos_xz), (sin_yz, _)] = xi_deg.map(|xi| xi.to_radians().sin_cos());
    let (q, height) = (matrix[(1, 2)], matrix[(2, 2)]);
    // Derivatives of q, then of the height sqrt(sin²ξ_xz - q²), by each angle.
    let q_by = [cos_xz - q * cos_xy / sin_xy, cos_xy * sin_xz / sin_xy, -sin_yz / sin_xy];
    let first = [-sin_xy, cos_xy, -sin_xz];
    let slopes = std::array::from_fn(|k| {
        let own = if k == 1 { sin_xz * cos_xz } else { 0.0 };
        let mut slope = Matrix3::zeros();
        slope[(1, 2)] = q_by[k];
        slope[(2, 2)] = (own - q * q_by[k]) / height;
        match k {
            0 => (slope[(0, 1)], slope[(1, 1)]) = (first[0], first[1]),
            1 => slope[(0, 2)] = first[2],
            _ => {}
        }
        slope.map(f64::to_radians)
    });
    Ok((matrix, slopes))
}

/// Angle between two vectors, degrees, accurate near 0, 90 and 180 degrees.
#[must_use]
pub fn angle_deg(a: &Vector3<f64>, b: &Vector3<f64>) -> f64 {
    a.cross(b).norm().atan2(a.dot(b)).to_degrees()
}

/// Angles ξ_xy, ξ_xz, ξ_yz between the columns of a matrix, degrees.
#[must_use]
pub fn column_angles_deg(matrix: &Matrix3<f64>) -> [f64; 3] {
    PAIRS.map(|(i, j)| angle_deg(&matrix.column(i).normalize(), &matrix.column(j).normalize()))
}

impl Convention {
    /// `ω` of the angles ξ_xy, ξ_xz, ξ_yz, degrees.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn omega(self, xi_deg: [f64; 3]) -> Result<Matrix3<f64>, PlanarAxes> {
        let q = base_vectors(xi_deg)?;
        match self {
            Convention::BepiColombo => q.transpose().try_inverse().ok_or(PlanarAxes),
            Convention::Rosetta => Ok(q),
        }
    }

    /// `ω` and its derivatives by ξ_xy, ξ_xz, ξ_yz, per degree.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn omega_and_slopes(self, xi_deg: [f64; 3]) -> Result<(Matrix3<f64>, [Matrix3<f64>; 3]), PlanarAxes> {
        let (q, slopes) = base_vectors_and_slopes(xi_deg)?;
        match self {
            Convention::Rosetta => Ok((q, slopes)),
            Convention::BepiColombo => {
                let omega = q.transpose().try_inverse().ok_or(PlanarAxes)?;
                Ok((omega, slopes.map(|slope| -omega * slope.transpose() * omega)))
            }
        }
    }

    /// The rotation from the frame of a matrix, which takes readings to the field, to the sensor frame of this convention: the same sensor
    /// has a lower triangular matrix there (BepiColombo), or an upper triangular one (Rosetta).
    ///
    /// The identity for a matrix without an inverse.
    #[must_use]
    pub fn frame_of(self, matrix: &Matrix3<f64>) -> Matrix3<f64> {
        let rows = match self {
            // The rows of the inverse stand along the sensor axes.
            Convention::BepiColombo => matrix.try_inverse().map(|m| m.transpose()),
            Convention::Rosetta => Some(*matrix),
        };
        let Some(columns) = rows else { return Matrix3::identity() };
        let x: Vector3<f64> = columns.column(0).normalize();
        let y: Vector3<f64> = (columns.column(1) - x * x.dot(&columns.column(1))).normalize();
        Matrix3::from_rows(&[x.transpose(), y.transpose(), x.cross(&y).transpose()])
    }

    /// ω as a function of ξ, in words that a program can follow.
    #[must_use]
    pub fn formula(self) -> &'static str {
        match self {
            Convention::BepiColombo => "omega = inverse(transpose(Q(xi)))",
            Convention::Rosetta => "omega = Q(xi)",
        }
    }

    /// The frame in which `ω σ` gives the field.
    #[must_use]
    pub fn sensor_frame(self) -> &'static str {
        match self {
            Convention::BepiColombo => "sensor (BepiColombo): x along sensor axis x, y in the plane of x and y",
            Convention::Rosetta => {
                "sensor (Rosetta): x along the first column of omega, y in the plane of the first two columns; the columns are the \
                 directions in which a field shows on one component only"
            }
        }
    }

    /// The convention with this name in files.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        match name {
            "bepicolombo" => Some(Convention::BepiColombo),
            "rosetta" => Some(Convention::Rosetta),
            _ => None,
        }
    }

    /// The other one.
    #[must_use]
    pub fn other(self) -> Self {
        match self {
            Convention::BepiColombo => Convention::Rosetta,
            Convention::Rosetta => Convention::BepiColombo,
        }
    }

    /// The power of σ that is the length of the vectors between which ξ are: of the axes `e_i / σ_i`, or of the columns of `ω σ`.
    fn power(self) -> i32 {
        match self {
            Convention::BepiColombo => -1,
            Convention::Rosetta => 1,
        }
    }
}

impl fmt::Display for Convention {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Convention::BepiColombo => "BepiColombo",
            Convention::Rosetta => "Rosetta",
        })
    }
}

impl Alignment {
    /// `ω σ`, nT/enT: readings to the field in the sensor frame of the convention.
    ///
    /// # Errors
    /// Angles that no three axes have between them.
    pub fn transfer(&self) -> Result<Matrix3<f64>, PlanarAxes> {
        Ok(self.convention.omega(self.xi_deg)? * Matrix3::from_diagonal(&Vector3::from(self.sigma)))
    }

    /// The same sensor in the other convention, exactly, with what covariances and frames need.
    ///
    /// # Errors
    /// Angles that no three axes have between them, or a sensitivity of zero.
    ///
    /// ```
    /// use calfit::data::convention::{Alignment, Convention};
    /// let sensor = Alignment { convention: Convention::BepiColombo, sigma: [1.0, 1.01, 0.99], xi_deg: [90.5, 89.9, 90.2] };
    /// let rosetta = sensor.to_other().unwrap().alignment;
    /// // To first order the angles are 180 degrees minus those of the other convention.
    /// assert!((rosetta.xi_deg[0] - 89.5).abs() < 0.01);
    /// ```
    pub fn to_other(&self) -> Result<Converted, PlanarAxes> {
        let power = self.convention.power();
        let lengths = self.sigma.map(|s| s.powi(power));
        let q = base_vectors(self.xi_deg)?;
        // Columns with the lengths and angles of this convention, and their dual basis, which has those of the other one.
        let columns = q * Matrix3::from_diagonal(&Vector3::from(lengths));
        let dual = columns.transpose().try_inverse().filter(|d| d.iter().all(|v| v.is_finite())).ok_or(PlanarAxes)?;
        let dual_lengths: [f64; 3] = std::array::from_fn(|i| dual.column(i).norm());
        let convention = self.convention.other();
        let sigma = dual_lengths.map(|l| l.powi(convention.power()));
        let alignment = Alignment { convention, sigma, xi_deg: column_angles_deg(&dual) };

        let mut jacobian = Matrix6::zeros();
        for parameter in 0..6 {
            let change = self.columns_by(parameter, &q, &lengths);
            // d(X⁻ᵀ) = -X⁻ᵀ dXᵀ X⁻ᵀ.
            let change = -dual * change.transpose() * dual;
            jacobian.set_column(parameter, &alignment.by_columns(&dual, &change));
        }
        let rotation = self.transfer()? * alignment.transfer()?.try_inverse().ok_or(PlanarAxes)?;
        Ok(Converted { alignment, jacobian, rotation })
    }

    /// The sensor in the convention that is wanted, with the standard uncertainties of sensitivities and angles (degrees) carried along;
    /// those are taken as independent, and are unknown in the other convention where one of the two is.
    ///
    /// # Errors
    /// Angles that no three axes have between them, or a sensitivity of zero; only where there is something to convert.
    pub fn in_convention(
        &self,
        wanted: Convention,
        [sigma_std, xi_std_deg]: AlignmentStd,
    ) -> Result<(Self, AlignmentStd), PlanarAxes> {
        if self.convention == wanted {
            return Ok((*self, [sigma_std, xi_std_deg]));
        }
        let converted = self.to_other()?;
        let std = match (sigma_std, xi_std_deg) {
            (Some(sigma), Some(xi)) => {
                let variances = Vector6::from_fn(|i, _| if i < 3 { sigma[i].powi(2) } else { xi[i - 3].powi(2) });
                let covariance = converted.covariance(&Matrix6::from_diagonal(&variances));
                let std = |from: usize| Some(std::array::from_fn(|i| covariance[(from + i, from + i)].sqrt()));
                [std(0), std(3)]
            }
            _ => [None, None],
        };
        Ok((converted.alignment, std))
    }

    /// Change of the columns `Q(ξ) diag(length)` per unit of one of (σ_x, σ_y, σ_z, ξ_xy, ξ_xz, ξ_yz), angles in degrees.
    fn columns_by(&self, parameter: usize, q: &Matrix3<f64>, lengths: &[f64; 3]) -> Matrix3<f64> {
        let mut change = Matrix3::zeros();
        if parameter < 3 {
            let slope = f64::from(self.convention.power()) * lengths[parameter] / self.sigma[parameter];
            change.set_column(parameter, &(q.column(parameter) * slope));
            return change;
        }
        let [xy, xz, yz] = self.xi_deg.map(f64::to_radians);
        let (middle, height) = (q[(1, 2)], q[(2, 2)]);
        let middle_by = match parameter {
            3 => xz.cos() - middle * xy.cos() / xy.sin(),
            4 => xy.cos() * xz.sin() / xy.sin(),
            _ => -yz.sin() / xy.sin(),
        };
        match parameter {
            3 => change.set_column(1, &Vector3::new(-xy.sin(), xy.cos(), 0.0)),
            4 => change[(0, 2)] = -xz.sin(),
            _ => {}
        }
        let square_by = if parameter == 4 { 2.0 * xz.sin() * xz.cos() } else { 0.0 } - 2.0 * middle * middle_by;
        change[(1, 2)] = middle_by;
        change[(2, 2)] = square_by / (2.0 * height);
        change * Matrix3::from_diagonal(&Vector3::from(*lengths)) * 1.0_f64.to_radians()
    }

    /// Change of (σ, ξ), angles in degrees, for a change of the columns that have their lengths and angles.
    fn by_columns(&self, columns: &Matrix3<f64>, change: &Matrix3<f64>) -> Vector6<f64> {
        let unit: [Vector3<f64>; 3] = std::array::from_fn(|i| columns.column(i).normalize());
        let length: [f64; 3] = std::array::from_fn(|i| columns.column(i).norm());
        // Changes of length and, across it, of direction.
        let along: [f64; 3] = std::array::from_fn(|i| unit[i].dot(&change.column(i)));
        let turn: [Vector3<f64>; 3] = std::array::from_fn(|i| (change.column(i) - unit[i] * along[i]) / length[i]);
        let power = self.convention.power();
        let mut out = Vector6::zeros();
        for i in 0..3 {
            out[i] = f64::from(power) * self.sigma[i] / length[i] * along[i];
            let (a, b) = PAIRS[i];
            let cosine_by = turn[a].dot(&unit[b]) + unit[a].dot(&turn[b]);
            out[3 + i] = -(cosine_by / unit[a].cross(&unit[b]).norm()).to_degrees();
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A sensor with misalignments of up to five degrees.
    fn sensors() -> impl Strategy<Value = Alignment> {
        let convention = prop_oneof![Just(Convention::BepiColombo), Just(Convention::Rosetta)];
        (convention, prop::array::uniform3(0.5_f64..2.0), prop::array::uniform3(85.0_f64..95.0))
            .prop_map(|(convention, sigma, xi_deg)| Alignment { convention, sigma, xi_deg })
    }

    proptest! {
        #[test]
        fn both_conventions_turn_equal_readings_into_one_field(sensor in sensors()) {
            let to = sensor.to_other().unwrap();
            // The rotation is a rotation, and with it the transfer matrices are equal.
            prop_assert!((to.rotation * to.rotation.transpose() - Matrix3::identity()).amax() < 1e-13);
            prop_assert!((to.rotation.determinant() - 1.0).abs() < 1e-13);
            let difference = sensor.transfer().unwrap() - to.rotation * to.alignment.transfer().unwrap();
            prop_assert!(difference.amax() < 1e-13);
        }

        #[test]
        fn there_and_back_is_where_it_began(sensor in sensors()) {
            let there = sensor.to_other().unwrap();
            let back = there.alignment.to_other().unwrap();
            for i in 0..3 {
                prop_assert!((back.alignment.sigma[i] / sensor.sigma[i] - 1.0).abs() < 1e-13);
                prop_assert!((back.alignment.xi_deg[i] - sensor.xi_deg[i]).abs() < 1e-11);
            }
            prop_assert!((back.jacobian * there.jacobian - Matrix6::identity()).amax() < 1e-10);
            prop_assert!((back.rotation * there.rotation - Matrix3::identity()).amax() < 1e-13);
        }

        #[test]
        fn slopes_of_omega_are_those_of_central_differences(sensor in sensors(), angle in 0usize..3) {
            let (omega, slopes) = sensor.convention.omega_and_slopes(sensor.xi_deg).unwrap();
            prop_assert_eq!(omega, sensor.convention.omega(sensor.xi_deg).unwrap());
            let step = 1e-4;
            let moved = |by: f64| {
                let mut xi_deg = sensor.xi_deg;
                xi_deg[angle] += by;
                sensor.convention.omega(xi_deg).unwrap()
            };
            let difference = (moved(step) - moved(-step)) / (2.0 * step);
            prop_assert!((difference - slopes[angle]).amax() < 1e-10);
        }

        #[test]
        fn derivatives_are_those_of_central_differences(sensor in sensors(), parameter in 0usize..6) {
            let step = 1e-5;
            let moved = |by: f64| {
                let mut s = sensor;
                if parameter < 3 { s.sigma[parameter] += by } else { s.xi_deg[parameter - 3] += by }
                let a = s.to_other().unwrap().alignment;
                Vector6::from_column_slice(&[a.sigma, a.xi_deg].concat())
            };
            let difference = (moved(step) - moved(-step)) / (2.0 * step);
            let column = sensor.to_other().unwrap().jacobian.column(parameter).into_owned();
            // Rounding of angles near 90 degrees over the step.
            prop_assert!((difference - column).amax() < 1e-7 * (1.0 + column.amax()), "{difference} {column}");
        }
    }

    #[test]
    fn the_misalignment_of_one_convention_has_the_other_sign_in_the_formula_of_the_other() {
        // Only ξ_xy differs from 90 degrees: closed form. ω_B = [[1, 0], [-cot ξ, 1/sin ξ]]: its columns have lengths 1/sin ξ both,
        // and between them is 180° - ξ.
        let xi = 90.5_f64;
        let sensor = Alignment { convention: Convention::BepiColombo, sigma: [1.0; 3], xi_deg: [xi, 90.0, 90.0] };
        let other = sensor.to_other().unwrap().alignment;
        let expected = 1.0 / xi.to_radians().sin();
        assert!((other.sigma[0] - expected).abs() < 1e-15 && (other.sigma[1] - expected).abs() < 1e-15);
        assert!((other.xi_deg[0] - (180.0 - xi)).abs() < 1e-12 && (other.xi_deg[1] - 90.0).abs() < 1e-12);
        let planar = Alignment { xi_deg: [10.0, 10.0, 170.0], ..sensor };
        assert_eq!(planar.to_other().unwrap_err(), PlanarAxes);
        assert!(Alignment { sigma: [0.0, 1.0, 1.0], ..sensor }.to_other().is_err());
    }
}
