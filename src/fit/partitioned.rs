//! Parameters that several sets of data share, beside those that every set has of its own: partitioned least squares (Frisch and
//! Waugh). The own columns of every set are projected out of its shared columns and its right-hand side; what is left of all sets
//! determines the shared parameters, which are those of the one large fit with all columns.

use super::linear::check_condition;
use super::{FitError, Limits, require_finite, require_length};
use nalgebra::linalg::{QR, SVD};
use nalgebra::{DMatrix, DVector, Dyn};

/// A shared column of which the own columns leave no more than this share of its size is not determined by a set.
const NOTHING_LEFT: f64 = 1e-7;

/// One set of data: n rows, p own and q shared columns.
#[derive(Clone, Debug)]
pub struct Part {
    /// Own columns, n x p.
    pub own: DMatrix<f64>,
    /// Shared columns, n x q.
    pub shared: DMatrix<f64>,
    /// Right-hand side, n.
    pub rhs: DVector<f64>,
    /// Inverse variance of a row, up to a common factor.
    pub weight: f64,
}

/// A set without what its own columns explain.
#[derive(Clone, Debug)]
pub struct Projected {
    factors: QR<f64, Dyn, Dyn>,
    /// The set as it was given.
    pub part: Part,
    /// Right-hand side that is left.
    rhs: DVector<f64>,
    /// Shared columns that are left.
    shared: DMatrix<f64>,
    /// Orthonormal columns that span them, orthogonal to the own ones, n x m with m at most q.
    pub basis: DMatrix<f64>,
}

impl Projected {
    /// Projects the own columns out.
    ///
    /// # Errors
    /// [`FitError::TooFewRows`] where own and shared columns leave no row, [`FitError::Length`], [`FitError::NotFinite`].
    pub fn of(part: Part) -> Result<Self, FitError> {
        let (rows, own) = part.own.shape();
        let parameters = own + part.shared.ncols();
        require_length("rows of the shared columns", rows, part.shared.nrows())?;
        require_length("rows of the right-hand side", rows, part.rhs.len())?;
        if rows <= parameters {
            return Err(FitError::TooFewRows { rows, parameters });
        }
        require_finite("own columns", part.own.as_slice(), rows)?;
        require_finite("shared columns", part.shared.as_slice(), rows)?;
        require_finite("right-hand side", part.rhs.as_slice(), rows)?;
        let factors = QR::new(part.own.clone());
        let q = factors.q();
        // Twice: the second projection removes what rounding leaves of the first.
        let without = |m: &DMatrix<f64>| {
            let once = m - &q * q.tr_mul(m);
            &once - &q * q.tr_mul(&once)
        };
        let shared = without(&part.shared);
        let rhs = without(&DMatrix::from_column_slice(rows, 1, part.rhs.as_slice())).column(0).into_owned();
        let mut unit = shared.clone();
        for (mut column, given) in unit.column_iter_mut().zip(part.shared.column_iter()) {
            let norm = given.norm();
            if norm > 0.0 {
                column /= norm;
            }
        }
        let svd = SVD::new(unit, true, false);
        let u = svd.u.unwrap_or_else(|| DMatrix::zeros(rows, 0));
        let kept: Vec<usize> = (0..u.ncols()).filter(|i| svd.singular_values[*i] > NOTHING_LEFT).collect();
        let basis = u.select_columns(&kept);
        Ok(Self { factors, part, rhs, shared, basis })
    }

    /// Standard deviation of what the own columns leave of the right-hand side, without the shared ones.
    #[must_use]
    pub fn left_std(&self) -> f64 {
        self.rhs.norm() / ((self.rhs.len() - self.part.own.ncols()) as f64).sqrt()
    }

    /// Own parameters for given shared ones.
    #[must_use]
    pub fn own(&self, shared: &DVector<f64>) -> Option<DVector<f64>> {
        own_alone(&self.factors, &(&self.part.rhs - &self.part.shared * shared))
    }
}

/// Parameters of a set of own columns alone, such as a start without shared ones; `None` if the columns are dependent.
#[must_use]
pub fn alone(own: &DMatrix<f64>, rhs: &DVector<f64>) -> Option<DVector<f64>> {
    own_alone(&QR::new(own.clone()), rhs)
}

fn own_alone(factors: &QR<f64, Dyn, Dyn>, rhs: &DVector<f64>) -> Option<DVector<f64>> {
    factors.r().solve_upper_triangular(&factors.q().tr_mul(rhs))
}

/// The shared parameters.
#[derive(Clone, Debug)]
pub struct Shared {
    /// Their values, q.
    pub values: DVector<f64>,
    /// `(Σ w Zᵀ Z)⁻¹` of the columns that are left, q x q: their covariance if the weights are inverse variances and rows independent.
    pub unscaled_covariance: DMatrix<f64>,
    /// Condition number of the columns that are left, of unit norm.
    pub condition: f64,
}

/// Solves for the shared parameters of all sets.
///
/// # Errors
/// [`FitError::Undetermined`] with the names at fault where all sets together do not determine them.
pub fn solve(parts: &[Projected], names: &[String], limits: &Limits) -> Result<Shared, FitError> {
    let count = names.len();
    let rows = parts.iter().map(|p| p.rhs.len()).sum();
    let mut columns = DMatrix::zeros(rows, count);
    let mut rhs = DVector::zeros(rows);
    let mut given = vec![0.0; count];
    let mut at = 0;
    for p in parts {
        let (n, root) = (p.rhs.len(), p.part.weight.sqrt());
        columns.rows_mut(at, n).copy_from(&(&p.shared * root));
        rhs.rows_mut(at, n).copy_from(&(&p.rhs * root));
        for (sum, column) in given.iter_mut().zip(p.part.shared.column_iter()) {
            *sum += p.part.weight * column.norm_squared();
        }
        at += n;
    }
    let lost = |j: &usize| columns.column(*j).norm() <= NOTHING_LEFT * given[*j].sqrt();
    let lost: Vec<String> = (0..count).filter(lost).map(|j| names[j].clone()).collect();
    if !lost.is_empty() || rows == 0 {
        return Err(FitError::Undetermined { parameters: lost, condition: f64::INFINITY });
    }
    let factors = QR::new(columns);
    let r = factors.r();
    let condition = check_condition(&r, names, limits)?;
    let singular = || FitError::Undetermined { parameters: names.to_vec(), condition: f64::INFINITY };
    let values = r.solve_upper_triangular(&factors.q().tr_mul(&rhs)).ok_or_else(singular)?;
    let inverse = r.solve_upper_triangular(&DMatrix::identity(count, count)).ok_or_else(singular)?;
    let unscaled_covariance = &inverse * inverse.transpose();
    require_finite("shared parameters", values.as_slice(), count)?;
    Ok(Shared { values, unscaled_covariance, condition })
}

/// How far the sets agree and how uncertain the shared parameters are.
#[derive(Clone, Debug)]
pub struct Uncertainty {
    /// Covariance of the shared parameters from the noise of the sets, q x q.
    pub covariance: DMatrix<f64>,
    /// Misfit of the sets to the shared values: sum of squares over their variances.
    pub chi2: f64,
    /// Its degrees of freedom; zero for a single set.
    pub dof: usize,
}

/// Covariance from the noise of every set: `noise[k]` is the covariance of the coefficients of `basis` of set k, which may hold slow
/// noise that weights do not know.
#[must_use]
pub fn uncertainty(parts: &[Projected], shared: &Shared, noise: &[DMatrix<f64>]) -> Uncertainty {
    let count = shared.values.len();
    let mut middle = DMatrix::zeros(count, count);
    let (mut chi2, mut directions) = (0.0, 0);
    for (p, noise) in parts.iter().zip(noise) {
        let onto = p.basis.tr_mul(&p.shared);
        middle += onto.transpose() * noise * &onto * p.part.weight.powi(2);
        let left = p.basis.tr_mul(&(&p.rhs - &p.shared * &shared.values));
        if let Some(inverse) = noise.clone().cholesky() {
            chi2 += left.dot(&inverse.solve(&left));
            directions += left.len();
        }
    }
    let covariance = &shared.unscaled_covariance * middle * &shared.unscaled_covariance;
    Uncertainty { covariance, chi2, dof: directions.saturating_sub(count) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::linear;
    use crate::fit::random::Random;

    fn names(count: usize) -> Vec<String> {
        (0..count).map(|i| format!("p{i}")).collect()
    }

    /// Three sets of different lengths, each with a line of its own, and a square and a cube that they share.
    fn parts() -> Vec<Part> {
        let mut random = Random(7);
        [(9, 1.0), (14, 4.0), (30, 0.25)]
            .into_iter()
            .map(|(n, weight)| {
                let x: Vec<f64> = (0..n).map(|_| random.gaussian()).collect();
                Part {
                    own: DMatrix::from_fn(n, 2, |i, j| x[i].powi(j as i32)),
                    shared: DMatrix::from_fn(n, 2, |i, j| x[i].powi(j as i32 + 2)),
                    rhs: DVector::from_fn(n, |_, _| random.gaussian()),
                    weight,
                }
            })
            .collect()
    }

    #[test]
    fn the_parts_give_what_one_large_fit_gives() {
        let parts = parts();
        let rows = parts.iter().map(|p| p.rhs.len()).sum();
        let (mut columns, mut rhs, mut weights) = (DMatrix::zeros(rows, 8), DMatrix::zeros(rows, 1), Vec::new());
        let mut at = 0;
        for (k, p) in parts.iter().enumerate() {
            let n = p.rhs.len();
            columns.view_mut((at, 0), (n, 2)).copy_from(&p.shared);
            columns.view_mut((at, 2 + 2 * k), (n, 2)).copy_from(&p.own);
            rhs.rows_mut(at, n).copy_from(&p.rhs);
            weights.extend(vec![p.weight; n]);
            at += n;
        }
        let design = linear::Design::new(names(8), columns).unwrap();
        let whole = linear::solve(&design, &rhs, Some(&weights), &Limits::default()).unwrap();

        let projected: Vec<Projected> = parts.into_iter().map(|p| Projected::of(p).unwrap()).collect();
        let shared = solve(&projected, &names(2), &Limits::default()).unwrap();
        for j in 0..2 {
            assert!((shared.values[j] - whole.coefficients[j]).abs() < 1e-13);
            for i in 0..2 {
                assert!((shared.unscaled_covariance[(i, j)] - whole.unscaled_covariance[(i, j)]).abs() < 1e-13);
            }
        }
        for (k, p) in projected.iter().enumerate() {
            let own = p.own(&shared.values).unwrap();
            for j in 0..2 {
                assert!((own[j] - whole.coefficients[2 + 2 * k + j]).abs() < 1e-13);
            }
        }
        // White noise of variance 1/w in every set: the covariance of the large fit.
        let noise: Vec<DMatrix<f64>> = projected.iter().map(|p| DMatrix::identity(2, 2) / p.part.weight).collect();
        let uncertainty = uncertainty(&projected, &shared, &noise);
        assert!((uncertainty.covariance - &shared.unscaled_covariance).amax() < 1e-13);
        assert_eq!(uncertainty.dof, 4);
    }

    #[test]
    fn a_shared_column_within_the_own_ones_is_named() {
        let mut parts = parts();
        for p in &mut parts {
            let inside = p.own.column(0) - p.own.column(1) * 2.0;
            p.shared.set_column(1, &inside);
        }
        let projected: Vec<Projected> = parts.into_iter().map(|p| Projected::of(p).unwrap()).collect();
        assert!(projected.iter().all(|p| p.basis.ncols() == 1));
        let error = solve(&projected, &names(2), &Limits::default()).unwrap_err();
        assert!(matches!(error, FitError::Undetermined { parameters, .. } if parameters == ["p1"]));
    }
}
