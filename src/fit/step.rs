//! The row from which on something counts more or less than before, beside the columns of a fit.

use nalgebra::DMatrix;

/// Least part of the squares of a course on either side of a step: fewer rows tell single readings from a step no longer.
const LEAST_SIDE: f64 = 0.05;

/// A course that counts differently from one row on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    /// First row of the later part.
    pub row: usize,
    /// Factor of the course in the later part, beside that of the fit.
    pub size: f64,
    /// Sum of squares of the residuals that it explains.
    pub explained: f64,
}

/// The step that explains most of the residuals of a fit; `basis` holds orthonormal columns that span those of the fit. Takes time in
/// proportion to the rows. `None` if no row divides the course.
#[must_use]
pub fn best(basis: &DMatrix<f64>, residuals: &[f64], course: &[f64]) -> Option<Step> {
    let total: f64 = course.iter().map(|c| c * c).sum();
    let mut along = vec![0.0; basis.ncols()];
    let (mut squares, mut product) = (0.0, 0.0);
    let mut found: Option<Step> = None;
    for row in (1..course.len()).rev() {
        let (c, r) = (course[row], residuals[row]);
        squares += c * c;
        product += c * r;
        along.iter_mut().zip(basis.row(row).iter()).for_each(|(a, b)| *a += c * b);
        if squares < LEAST_SIDE * total || squares > (1.0 - LEAST_SIDE) * total {
            continue;
        }
        let free = squares - along.iter().map(|a| a * a).sum::<f64>();
        if free <= 1e-6 * squares {
            continue;
        }
        let explained = product * product / free;
        if found.is_none_or(|best| explained > best.explained) {
            found = Some(Step { row, size: product / free, explained });
        }
    }
    found
}

/// Sum of squares of the residuals that one more column would explain.
#[must_use]
pub fn explained(basis: &DMatrix<f64>, residuals: &[f64], column: impl Fn(usize) -> f64) -> f64 {
    let values: Vec<f64> = (0..residuals.len()).map(column).collect();
    let squares: f64 = values.iter().map(|c| c * c).sum();
    let product: f64 = values.iter().zip(residuals).map(|(c, r)| c * r).sum();
    let along = basis.column_iter().map(|b| b.iter().zip(&values).map(|(b, c)| b * c).sum::<f64>().powi(2)).sum::<f64>();
    let free = squares - along;
    if free > 1e-6 * squares { product * product / free } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_found_where_it_is() {
        let course: Vec<f64> = (0..40).map(|i| [1.0, -2.0, 0.5, 1.5][i % 4]).collect();
        let columns = DMatrix::from_fn(40, 2, |i, j| if j == 0 { 1.0 } else { course[i] });
        let basis = columns.qr().q();
        let stepped = DMatrix::from_fn(40, 1, |i, _| if i < 25 { 0.0 } else { 0.01 * course[i] });
        let residuals = &stepped - &basis * basis.tr_mul(&stepped);
        let found = best(&basis, residuals.as_slice(), &course).unwrap();
        assert_eq!(found.row, 25);
        assert!((found.size - 0.01).abs() < 1e-12 && (found.explained / residuals.norm_squared() - 1.0).abs() < 1e-9);
        let again = explained(&basis, residuals.as_slice(), |i| if i < 25 { 0.0 } else { course[i] });
        assert!((again / found.explained - 1.0).abs() < 1e-9);
    }
}
