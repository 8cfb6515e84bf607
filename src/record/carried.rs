//! What uncertain parameters of something that was applied to a run do to the coefficients of its linear model.

use crate::data::plateau::Plateau;
use crate::fit::{FitError, Limits, linear};
use nalgebra::DMatrix;

/// Covariance of all coefficients, parameter j of component a at `a * p + j`: that of their [`changes`], which are independent of each other.
///
/// # Errors
/// The design does not determine the coefficients.
pub fn covariance(changes_ent: &[Vec<[f64; 3]>], list: &[Plateau], design: &linear::Design) -> Result<DMatrix<f64>, FitError> {
    let changes = changes(changes_ent, list, design)?;
    Ok(&changes * changes.transpose())
}

/// Changes of all coefficients, parameter j of component a in row `a * p + j`, a column per change of the readings, to first order:
/// `changes_ent` are changes of the mean readings of all plateaus of `list`, each by one standard deviation of something that is independent
/// of the others. The rows of the design are the plateaus that are not dropped.
///
/// # Errors
/// The design does not determine the coefficients.
pub fn changes(changes_ent: &[Vec<[f64; 3]>], list: &[Plateau], design: &linear::Design) -> Result<DMatrix<f64>, FitError> {
    let places: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
    let count = design.names().len();
    if changes_ent.is_empty() {
        return Ok(DMatrix::zeros(3 * count, 0));
    }
    // Plain numbers are enough for a variance.
    let scales: Vec<f64> = design.columns().column_iter().map(|c| c.norm()).collect();
    let scaled = DMatrix::from_fn(places.len(), count, |i, j| design.columns()[(i, j)] / scales[j]);
    let factors = scaled.qr();
    let r = factors.r();
    linear::check_condition(&r, design.names(), &Limits::default())?;
    let rhs = DMatrix::from_fn(places.len(), 3 * changes_ent.len(), |i, k| changes_ent[k / 3][places[i]][k % 3]);
    let undetermined = || FitError::Undetermined { parameters: design.names().to_vec(), condition: f64::INFINITY };
    let moved = r.solve_upper_triangular(&factors.q().tr_mul(&rhs)).ok_or_else(undetermined)?;
    // All coefficients of the first component, then of the next.
    Ok(DMatrix::from_fn(3 * count, changes_ent.len(), |i, k| moved[(i % count, 3 * k + i / count)] / scales[i % count]))
}
