//! Whether the axes of the sensor do together what a term says: a turn moves two of them by the same angle, a change of the direction of one
//! axis moves this one alone, and a turn takes half of it.

use super::chosen::Chosen;
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::RunnerUp;
use crate::model::effects::{Spec, UNKNOWN};
use nalgebra::{DMatrix, DVector};

/// An axis that has less than this part of a column is none of its own: axes of coil and sensor are not quite parallel.
const SMALL_PART: f64 = 0.1;
/// Its name among the rivals.
const EACH_AXIS: &str = "every axis by a size of its own";

/// The same on every axis with a size of its own, where that is the better explanation in spite of its further parameters.
pub(super) fn rival(chosen: &Chosen) -> Option<RunnerUp> {
    let candidate = chosen.candidate;
    let columns = on_each_axis(&candidate.columns)?;
    let parameters = (0..columns.ncols()).map(|k| (format!("s{k}"), "1")).collect();
    let spec = Spec::new(EACH_AXIS, &candidate.spec.axes);
    let apart = Candidate::new(UNKNOWN, Some(EACH_AXIS.to_owned()), spec, parameters, columns);
    chosen.rival(&apart, 1).filter(|r| r.log_ratio > 0.0)
}

/// Columns on three components as columns on one each, what is small with what is largest; `None` where each is on one already.
fn on_each_axis(columns: &DMatrix<f64>) -> Option<DMatrix<f64>> {
    let n = columns.nrows() / 3;
    let mut all: Vec<DVector<f64>> = Vec::new();
    for column in columns.column_iter() {
        let sizes = [0, 1, 2].map(|a| column.rows(a * n, n).norm());
        let largest = (0..3).max_by(|a, b| sizes[*a].total_cmp(&sizes[*b]))?;
        let is_small = |a: usize| sizes[a] < SMALL_PART * sizes[largest];
        for own in (0..3).filter(|a| !is_small(*a)) {
            let is_here = |a: usize| a == own || (own == largest && is_small(a));
            all.push(DVector::from_fn(3 * n, |i, _| if is_here(i / n) { column[i] } else { 0.0 }));
        }
    }
    (all.len() > columns.ncols()).then(|| DMatrix::from_columns(&all))
}
