//! What uncertain parameters of something that was applied to a run do to the coefficients of its linear model.

use crate::data::plateau::Plateau;
use crate::fit::{FitError, Limits, linear};
use nalgebra::{DMatrix, DVector};

/// Covariance of all coefficients, parameter j of component a at `a * p + j`, by first-order propagation: `changes_ent` are changes of the
/// mean readings of all plateaus of `list`, each by one standard deviation of something that is independent of the others. The rows of the
/// design are the plateaus that are not dropped.
///
/// # Errors
/// The design does not determine the coefficients.
pub fn covariance(changes_ent: &[Vec<[f64; 3]>], list: &[Plateau], design: &linear::Design) -> Result<DMatrix<f64>, FitError> {
    let places: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
    let count = design.names().len();
    let mut covariance = DMatrix::zeros(3 * count, 3 * count);
    for change in changes_ent {
        let rhs = DMatrix::from_fn(places.len(), 3, |i, a| change[places[i]][a]);
        let moved = linear::solve(design, &rhs, None, &Limits::default())?.coefficients;
        let stacked = DVector::from_iterator(3 * count, moved.iter().copied());
        covariance += &stacked * stacked.transpose();
    }
    Ok(covariance)
}
