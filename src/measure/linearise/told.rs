//! What the noise of the runs says of the parameters that they share.

use super::data::Data;
use crate::fit::partitioned::{self, Projected};
use crate::fit::{FitError, Limits, linear, order};
use crate::record::conditions::{self, Within};
use nalgebra::{DMatrix, Matrix2, Vector2};

/// What the noise of the runs says about shared parameters.
pub(super) struct Told {
    /// Their covariance.
    pub covariance: DMatrix<f64>,
    /// Sum of squares of what the runs say against the shared parameters, over their variances.
    pub chi2: f64,
    /// Its degrees of freedom.
    pub dof: usize,
    /// Factor on the standard uncertainties where the runs disagree; contained in the covariance.
    pub inflation: f64,
    /// The samples within the plateaus tell the noise.
    pub from_samples: bool,
}

/// Uncertainty of shared parameters of a component from the noise model of every run.
pub(super) fn tell(data: &[Data], axis: usize, parts: &[Projected], solved: &partitioned::Shared) -> Result<Told, FitError> {
    let mut from_samples = true;
    let mut noise = Vec::new();
    for (d, projected) in data.iter().zip(parts) {
        let (rows, own, shared) = (d.own.nrows(), d.own.ncols(), projected.basis.ncols());
        let columns = DMatrix::from_fn(rows, own + shared, |i, j| {
            if j < own { projected.part.own[(i, j)] } else { projected.basis[(i, j - own)] }
        });
        let design = linear::Design::new((0..own + shared).map(|j| format!("column {j}")).collect(), columns)?;
        let rhs = DMatrix::from_column_slice(rows, 1, projected.part.rhs.as_slice());
        let solution = linear::solve(&design, &rhs, None, &Limits::default())?;
        let within = if d.lin.with_temperature.is_some() { Within::Drift } else { Within::Still };
        let model = conditions::noise_of(&solution, &d.plateaus(), &[axis], within, None)?;
        from_samples &= model.is_from_samples();
        noise.push(model.covariance().view((own, own), (shared, shared)).into_owned());
    }
    let told = partitioned::uncertainty(parts, solved, &noise);
    let inflation = order::excess(told.chi2, told.dof);
    Ok(Told { covariance: told.covariance * inflation.powi(2), chi2: told.chi2, dof: told.dof, inflation, from_samples })
}

/// Probability of two values as large as these if the true ones are zero: Hotelling's T² with the degrees of freedom of the noise, the
/// normal limit without.
pub(super) fn probability(values: &Vector2<f64>, covariance: &Matrix2<f64>, dof: Option<usize>) -> f64 {
    let Some(inverse) = covariance.try_inverse() else {
        return if values.amax() > 0.0 { 0.0 } else { 1.0 };
    };
    let squares = (values.transpose() * inverse * values)[(0, 0)].max(0.0);
    match dof {
        Some(dof) => (1.0 + squares / dof as f64).powf(-0.5 * dof as f64),
        None => (-0.5 * squares).exp(),
    }
}
