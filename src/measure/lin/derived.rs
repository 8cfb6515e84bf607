//! What follows from the coefficients of a linear fit: the split of the response with the uncertainty of every part.

use super::fit::Means;
use super::refusal::LinError;
use crate::data::across::CommonChange;
use crate::data::calibration::{Angles, LinearStd, Matrices};
use crate::data::result::{Covariance, Rows};
use crate::fit::{Propagated, propagate};
use crate::model::sensor::{Split, SplitError, split};
use nalgebra::{DMatrix, Matrix3, Vector3};

/// Everything that follows from the coefficients, with its uncertainties.
pub(super) struct Parameters {
    /// `Φ` and its parts.
    pub split: Split,
    /// Mean offset and residual field over the used plateaus, enT.
    pub b_or_ent: [f64; 3],
    uncertain: Propagated,
}

impl Parameters {
    /// First-order propagation of the covariance of the coefficients.
    pub fn of(
        derived: Derived,
        stacked: &[f64],
        covariance: &DMatrix<f64>,
        means: &Means,
        r_nom: &Matrix3<f64>,
    ) -> Result<Self, LinError> {
        let uncertain = propagate(
            |x| Derived::of(x, means, r_nom).map(|d| d.list()).unwrap_or_else(|_| vec![f64::NAN; Derived::COUNT]),
            stacked,
            covariance,
        )
        .map_err(LinError::Fit)?;
        Ok(Self { split: derived.split, b_or_ent: derived.b_or_ent, uncertain })
    }

    /// `Φ` and its parts as rows.
    pub fn matrices(&self) -> Matrices {
        let split = &self.split;
        Matrices {
            omega_convention: "BepiColombo".to_owned(),
            r_nom: rows(&split.r_nom),
            rho: rows(&split.rho),
            omega: rows(&split.omega),
            sigma: rows(&Matrix3::from_diagonal(&Vector3::from(split.sigma))),
            phi: rows(&split.phi),
            phi_tilde: rows(&split.phi_tilde),
        }
    }

    /// Angles between the sensor axes, and of the sensor against its nominal axes.
    pub fn angles(&self) -> Angles {
        let [xi_xy, xi_xz, xi_yz] = self.split.xi_deg;
        let [lambda_x, mu_y, nu_z] = self.split.rotation_deg;
        Angles { xi_xy, xi_xz, xi_yz, lambda_x, mu_y, nu_z }
    }

    /// Standard uncertainties.
    pub fn std(&self) -> LinearStd {
        LinearStd {
            sigma: self.three(Derived::SIGMA),
            xi_deg: self.three(Derived::XI),
            b_or_ent: self.three(Derived::B_OR),
            lambda_mu_nu_deg: rotation_std(&self.split, &self.uncertain),
            phi: self.rows_of_std(Derived::PHI),
            phi_tilde: self.rows_of_std(Derived::PHI_TILDE),
        }
    }

    fn three(&self, from: usize) -> [f64; 3] {
        std::array::from_fn(|i| self.uncertain.std.get(from + i).copied().unwrap_or(f64::NAN))
    }

    fn rows_of_std(&self, from: usize) -> Rows {
        [self.three(from), self.three(from + 3), self.three(from + 6)]
    }

    /// Covariance of `Φ` and `B_or`.
    pub fn covariance(&self) -> Covariance {
        covariance(&self.uncertain)
    }
}

/// What follows from the coefficients, in one list, so that one propagation gives all uncertainties.
pub(super) struct Derived {
    split: Split,
    b_or_ent: [f64; 3],
}

impl Derived {
    const PHI: usize = 0;
    const B_OR: usize = 9;
    const SIGMA: usize = 12;
    const XI: usize = 15;
    const ROTATION: usize = 18;
    const RHO: usize = 21;
    const PHI_TILDE: usize = 30;
    const COUNT: usize = 39;

    /// The split of the fitted response.
    pub fn of(stacked: &[f64], means: &Means, r_nom: &Matrix3<f64>) -> Result<Self, SplitError> {
        let response = means.baseline.responses(stacked).first().copied().ok_or(SplitError::Singular)?;
        let phi = response.try_inverse().ok_or(SplitError::Singular)?;
        Ok(Self { split: split(&phi, r_nom)?, b_or_ent: means.mean_b_or_ent(stacked) })
    }

    /// The response, coil field to reading.
    pub fn response(&self) -> Matrix3<f64> {
        // The split had an inverse to start from.
        self.split.phi.try_inverse().unwrap_or_else(Matrix3::zeros)
    }

    /// What the values become more in `moved`, which something common to several runs moved.
    pub fn change_to(&self, moved: &Self, source: &str) -> CommonChange {
        let by = |of: &dyn Fn(&Self) -> [f64; 3]| -> [f64; 3] {
            let (from, to) = (of(self), of(moved));
            std::array::from_fn(|i| to[i] - from[i])
        };
        CommonChange {
            source: source.to_owned(),
            sigma: by(&|d| d.split.sigma),
            xi_deg: by(&|d| d.split.xi_deg),
            b_or_ent: by(&|d| d.b_or_ent),
        }
    }

    fn list(&self) -> Vec<f64> {
        let s = &self.split;
        let matrix = |m: &Matrix3<f64>| m.transpose().iter().copied().collect::<Vec<f64>>();
        [
            matrix(&s.phi),
            self.b_or_ent.to_vec(),
            s.sigma.to_vec(),
            s.xi_deg.to_vec(),
            s.rotation_deg.to_vec(),
            matrix(&s.rho),
            matrix(&s.phi_tilde),
        ]
        .concat()
    }
}

/// First order, except where an axis is turned by less than its uncertainty: there the angle behaves like a length, and the root
/// mean square of its two components is taken.
fn rotation_std(split: &Split, uncertain: &Propagated) -> [f64; 3] {
    std::array::from_fn(|i| {
        let variance = |row: usize| uncertain.std.get(Derived::RHO + 3 * row + i).map_or(f64::NAN, |s| s * s);
        let aside: f64 = (0..3).filter(|row| *row != i).map(variance).sum();
        let floor = (0.5 * aside).sqrt().to_degrees();
        match uncertain.std.get(Derived::ROTATION + i) {
            Some(std) if split.rotation_deg[i] > 3.0 * floor && std.is_finite() => *std,
            _ => floor,
        }
    })
}

fn covariance(uncertain: &Propagated) -> Covariance {
    let axes = ["x", "y", "z"];
    let mut parameters: Vec<String> = axes.iter().flat_map(|r| axes.iter().map(move |c| format!("phi_{r}{c}"))).collect();
    parameters.extend(axes.iter().map(|c| format!("b_or_{c}")));
    let mut units = vec!["nT/enT".to_owned(); 9];
    units.extend(vec!["enT".to_owned(); 3]);
    let matrix = (0..12).map(|row| (0..12).map(|column| uncertain.covariance[(row, column)]).collect()).collect();
    Covariance { parameters, units, matrix }
}

fn rows(m: &Matrix3<f64>) -> Rows {
    // Adding zero turns a negative zero into a positive one.
    std::array::from_fn(|row| std::array::from_fn(|column| m[(row, column)] + 0.0))
}
