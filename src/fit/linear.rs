//! Weighted linear least squares, refined to the accuracy of the data.
//!
//! Householder QR of the design with scaled columns gives a first answer; Björck's refinement of the augmented system with
//! residuals in double-double then removes the rounding errors of the factorisation, of the coefficients and of their
//! covariance alike. A design whose columns are dependent is refused, never answered with a minimum-norm solution.

use nalgebra::linalg::{QR, SVD};
use nalgebra::{DMatrix, DVectorView, Dyn};

use super::double_double::{DoubleDouble, add_product, add_transposed_product};
use super::{FitError, require_finite, require_length};

/// Corrections below this share of the solution end the refinement: well under `f64`, well over double-double.
const SETTLED: f64 = 1e-25;
/// Steps of refinement; each multiplies the error by about the condition number times 1e-16.
const MAX_STEPS: usize = 40;
/// Corrections which no longer shrink are rounding below this share of solution or right-hand side, above it a failure.
const STALLED: f64 = 1e-8;
/// A parameter is named as undetermined where its part of the near-null directions exceeds this share of the largest.
const NAMED_SHARE: f64 = 0.1;

/// Limits of what a fit accepts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Largest condition number of the design with columns of unit norm.
    pub max_condition: f64,
}

impl Default for Limits {
    /// A condition of 1e8: beyond it errors of 1e-8 in the columns themselves decide the answer.
    fn default() -> Self {
        Self { max_condition: 1e8 }
    }
}

/// A design matrix: one named column per parameter, one row per observation.
#[derive(Clone, Debug)]
pub struct Design {
    names: Vec<String>,
    columns: DMatrix<f64>,
    /// The columns with what rounding them to `f64` left over, where they are known better than that.
    precise: DMatrix<DoubleDouble>,
}

impl Design {
    /// A design of n rows and p columns from p names and an n x p matrix.
    ///
    /// # Errors
    ///
    /// [`FitError::Length`] where names and columns differ in number, [`FitError::NotFinite`].
    pub fn new(names: Vec<String>, columns: DMatrix<f64>) -> Result<Self, FitError> {
        require_length("parameter names", columns.ncols(), names.len())?;
        require_finite("design", columns.as_slice(), columns.nrows())?;
        let precise = columns.map(DoubleDouble::from);
        Ok(Self { names, columns, precise })
    }

    /// A design whose columns are known in double-double.
    pub(super) fn precise(names: Vec<String>, precise: DMatrix<DoubleDouble>) -> Result<Self, FitError> {
        Ok(Self { precise: precise.clone(), ..Self::new(names, precise.map(DoubleDouble::value))? })
    }

    /// Names of the parameters, in the order of the columns.
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// The n x p matrix.
    pub fn columns(&self) -> &DMatrix<f64> {
        &self.columns
    }
}

/// The answer of [`solve`]: n rows, p parameters, m right-hand sides.
#[derive(Clone, Debug)]
pub struct Solution {
    /// Coefficients, p x m.
    pub coefficients: DMatrix<f64>,
    /// Observed minus fitted, n x m, unweighted, also for rows of weight zero.
    pub residuals: DMatrix<f64>,
    /// `(XᵀWX)⁻¹`, p x p: times the variance of a row of unit weight it is the covariance of the coefficients.
    pub unscaled_covariance: DMatrix<f64>,
    /// Condition number of the weighted design with columns of unit norm.
    pub condition: f64,
    /// Rows of positive weight minus parameters.
    pub dof: usize,
    /// Per right-hand side the standard deviation of a row of unit weight, `sqrt(Σ w r² / dof)`; NaN where `dof` is zero.
    pub residual_std: Vec<f64>,
    /// The coefficients before rounding.
    pub(super) precise_coefficients: DMatrix<DoubleDouble>,
    /// The unscaled covariance before rounding.
    pub(super) precise_covariance: DMatrix<DoubleDouble>,
    /// QR of the weighted design: rows as in `kept`, columns multiplied by `scales`.
    pub(super) factors: QR<f64, Dyn, Dyn>,
    /// Powers of two which bring the columns to a size of about one.
    pub(super) scales: Vec<f64>,
    /// Rows of positive weight.
    pub(super) kept: Vec<usize>,
    /// Square root of the weight of every kept row.
    pub(super) root_weights: Vec<f64>,
}

impl Solution {
    /// Standard deviations of the coefficients, p x m, for independent errors of equal variance in rows of unit weight.
    pub fn std(&self) -> DMatrix<f64> {
        let (parameters, count) = self.coefficients.shape();
        DMatrix::from_fn(parameters, count, |j, a| self.residual_std[a] * self.unscaled_covariance[(j, j)].sqrt())
    }
}

/// Least-squares solution of `design * coefficients = rhs` for every column of `rhs` (n x m).
///
/// Row i counts with `weights[i]`, its inverse variance up to a common factor; a weight of zero leaves the row out.
///
/// # Errors
///
/// [`FitError::Length`], [`FitError::NotFinite`] and [`FitError::NegativeWeight`] for input that does not fit together,
/// [`FitError::TooFewRows`], and [`FitError::Undetermined`] where a column is zero or the condition exceeds
/// `limits.max_condition` or the accuracy of the arithmetic.
pub fn solve(design: &Design, rhs: &DMatrix<f64>, weights: Option<&[f64]>, limits: &Limits) -> Result<Solution, FitError> {
    let (rows, parameters) = design.columns.shape();
    require_length("rows of the right-hand sides", rows, rhs.nrows())?;
    require_finite("right-hand sides", rhs.as_slice(), rows)?;
    let (kept, root_weights) = keep(weights, rows)?;
    if kept.len() < parameters || parameters == 0 {
        return Err(FitError::TooFewRows { rows: kept.len(), parameters });
    }

    let scales: Vec<f64> = (0..parameters)
        .map(|j| {
            let entries = kept.iter().zip(&root_weights);
            power_of_two_scale(entries.fold(0.0, |max, (&i, root)| (design.columns[(i, j)] * root).abs().max(max)))
        })
        .collect();
    let matrix = DMatrix::from_fn(kept.len(), parameters, |i, j| design.precise[(kept[i], j)] * root_weights[i] * scales[j]);
    require_finite("weighted design", matrix.map(|value| value.hi).as_slice(), kept.len())?;
    let factors = QR::new(matrix.map(|value| value.hi));
    let condition = check_condition(&factors.r(), &design.names, limits)?;

    // Right-hand sides of the data, followed by those whose solutions are the columns of the covariance.
    let count = rhs.ncols();
    let mut upper = DMatrix::from_element(kept.len(), count + parameters, DoubleDouble::default());
    let mut lower = DMatrix::from_element(parameters, count + parameters, DoubleDouble::default());
    for a in 0..count {
        for (i, (&row, &root)) in kept.iter().zip(&root_weights).enumerate() {
            upper[(i, a)] = DoubleDouble::from(rhs[(row, a)]) * root;
        }
    }
    require_finite("weighted right-hand sides", upper.map(|value| value.hi).as_slice(), kept.len())?;
    for j in 0..parameters {
        lower[(j, count + j)] = -DoubleDouble::ONE;
    }
    let Some(mut refined) = refine(&matrix, &factors, &upper, &lower) else {
        return Err(undetermined(&factors.r(), &design.names, condition, limits));
    };
    for (mut row, &scale) in refined.row_iter_mut().zip(&scales) {
        row.iter_mut().for_each(|value| *value = *value * scale);
    }
    let precise_coefficients = refined.columns(0, count).into_owned();
    let precise_covariance = DMatrix::from_fn(parameters, parameters, |i, j| {
        (refined[(i, count + j)] * scales[j] + refined[(j, count + i)] * scales[i]) * 0.5
    });

    let mut residuals = rhs.map(DoubleDouble::from);
    add_product(&mut residuals, &design.precise, &-&precise_coefficients);
    let dof = kept.len() - parameters;
    let residual_std = |column: DVectorView<DoubleDouble>| {
        let mut sum = DoubleDouble::default();
        for (&row, &root) in kept.iter().zip(&root_weights) {
            let weighted = column[row] * root;
            sum += weighted * weighted;
        }
        if dof > 0 { (sum / dof as f64).value().sqrt() } else { f64::NAN }
    };
    let solution = Solution {
        coefficients: precise_coefficients.map(DoubleDouble::value),
        residuals: residuals.map(DoubleDouble::value),
        unscaled_covariance: precise_covariance.map(DoubleDouble::value),
        condition,
        dof,
        residual_std: residuals.column_iter().map(residual_std).collect(),
        precise_coefficients,
        precise_covariance,
        factors,
        scales,
        kept,
        root_weights,
    };
    // Units beyond the range of f64 overflow here.
    require_finite("coefficients", solution.coefficients.as_slice(), parameters)?;
    require_finite("covariance", solution.unscaled_covariance.as_slice(), parameters)?;
    Ok(solution)
}

/// Rows of positive weight and the square roots of their weights.
fn keep(weights: Option<&[f64]>, rows: usize) -> Result<(Vec<usize>, Vec<f64>), FitError> {
    let Some(weights) = weights else {
        return Ok(((0..rows).collect(), vec![1.0; rows]));
    };
    require_length("weights", rows, weights.len())?;
    require_finite("weights", weights, rows)?;
    if let Some(row) = weights.iter().position(|&weight| weight < 0.0) {
        return Err(FitError::NegativeWeight { row });
    }
    let kept: Vec<usize> = (0..rows).filter(|&i| weights[i] > 0.0).collect();
    let roots = kept.iter().map(|&i| weights[i].sqrt()).collect();
    Ok((kept, roots))
}

/// The power of two which brings `size` between 1/2 and 2, so that scaling rounds nothing; one for zero.
fn power_of_two_scale(size: f64) -> f64 {
    if size > 0.0 { 2f64.powi(-(size.log2().clamp(-1000.0, 1000.0) as i32)) } else { 1.0 }
}

/// `r` with columns of unit norm, zero columns left alone.
fn unit_columns(r: &DMatrix<f64>) -> DMatrix<f64> {
    let mut unit = r.clone();
    for mut column in unit.column_iter_mut() {
        let norm = column.norm();
        if norm > 0.0 {
            column /= norm;
        }
    }
    unit
}

/// Condition number of the design with triangular factor `r`, refused above the limit.
pub(crate) fn check_condition(r: &DMatrix<f64>, names: &[String], limits: &Limits) -> Result<f64, FitError> {
    let singular = unit_columns(r).singular_values();
    let smallest = singular.min();
    let has_zero_column = r.column_iter().any(|column| column.amax() == 0.0);
    let condition = if has_zero_column || smallest == 0.0 { f64::INFINITY } else { singular.max() / smallest };
    if condition > limits.max_condition {
        return Err(undetermined(r, names, condition, limits));
    }
    Ok(condition)
}

/// Names the parameters with a large part in the directions that `r` nearly annihilates.
fn undetermined(r: &DMatrix<f64>, names: &[String], condition: f64, limits: &Limits) -> FitError {
    let svd = SVD::new(unit_columns(r), false, true);
    let singular = &svd.singular_values;
    let near_null = singular.min().max(singular.max() / limits.max_condition);
    let mut part = vec![0.0_f64; names.len()];
    if let Some(v_t) = &svd.v_t {
        for (direction, &value) in v_t.row_iter().zip(singular.iter()) {
            if value <= near_null {
                for (sum, v) in part.iter_mut().zip(direction.iter()) {
                    *sum = sum.hypot(*v);
                }
            }
        }
    }
    let largest = part.iter().copied().fold(0.0, f64::max);
    let named = names.iter().zip(&part).filter(|(_, part)| **part >= NAMED_SHARE * largest);
    let parameters = named.map(|(name, _)| name.clone()).collect();
    FitError::Undetermined { parameters, condition }
}

/// Solves `s + A x = upper`, `Aᵀ s = lower` for `x`, one column per right-hand side, by Björck's iterative refinement.
///
/// None where the corrections do not shrink: the factors then carry no digit of the answer.
fn refine(
    matrix: &DMatrix<DoubleDouble>,
    factors: &QR<f64, Dyn, Dyn>,
    upper: &DMatrix<DoubleDouble>,
    lower: &DMatrix<DoubleDouble>,
) -> Option<DMatrix<DoubleDouble>> {
    let (q, r) = (factors.q(), factors.r());
    let mut x = lower.map(|_| DoubleDouble::default());
    let mut s = upper.map(|_| DoubleDouble::default());
    let (mut changes, mut settled) = (vec![1.0; lower.ncols()], vec![false; lower.ncols()]);
    for step in 0..MAX_STEPS {
        let (mut f, mut g) = (upper.zip_map(&s, |value, part| value - part), lower.clone());
        if step > 0 {
            add_product(&mut f, matrix, &-&x);
            add_transposed_product(&mut g, matrix, &-&s);
        }
        let (f, g) = (f.map(DoubleDouble::value), g.map(DoubleDouble::value));
        let normal = r.tr_solve_upper_triangular(&g)? - q.tr_mul(&f);
        let x_step = -r.solve_upper_triangular(&normal)?;
        let s_step = f + &q * normal;
        x.zip_apply(&x_step, |value, step| *value += step.into());
        s.zip_apply(&s_step, |value, step| *value += step.into());
        if step == 0 {
            continue;
        }
        for (a, (last, settled)) in changes.iter_mut().zip(&mut settled).enumerate() {
            let size = largest(x.column(a).iter()).max(f64::MIN_POSITIVE);
            let change = x_step.column(a).amax() / size;
            // The first correction may exceed a small solution beside large residuals and still leave digits.
            let stalled = step > 1 && change > 0.5 * *last;
            if stalled && change * size > STALLED * largest(upper.column(a).iter()).max(size) {
                return None;
            }
            // The next correction is smaller by the ratio of this one to the last.
            *settled |= stalled || change <= SETTLED || change * (change / *last) <= SETTLED;
            *last = change;
        }
        if settled.iter().all(|&settled| settled) {
            return Some(x);
        }
    }
    None
}

/// Largest magnitude.
fn largest<'a>(values: impl Iterator<Item = &'a DoubleDouble>) -> f64 {
    values.fold(0.0, |max, value| value.hi.abs().max(max))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn design(names: &str, columns: DMatrix<f64>) -> Design {
        Design::new(names.split_whitespace().map(str::to_owned).collect(), columns).unwrap()
    }

    fn line() -> Design {
        let columns = [1.0, 0.0, 1.0, 1.0, 1.0, 2.0, 1.0, 3.0];
        design("offset slope", DMatrix::from_row_slice(4, 2, &columns))
    }

    fn undetermined_names(error: FitError) -> Vec<String> {
        match error {
            FitError::Undetermined { parameters, .. } => parameters,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn a_line_through_four_points_has_its_closed_form() {
        // First column: mean y = 3, Sxy = 7, Sxx = 5. Second column: exact line 2 - x.
        let y = DMatrix::from_row_slice(4, 2, &[1.0, 2.0, 2.0, 1.0, 4.0, 0.0, 5.0, -1.0]);
        let fit = solve(&line(), &y, None, &Limits::default()).unwrap();
        let expected = DMatrix::from_row_slice(2, 2, &[0.9, 2.0, 1.4, -1.0]);
        assert!((&fit.coefficients - expected).amax() < 1e-15);
        let residuals = DMatrix::from_row_slice(4, 2, &[0.1, 0.0, -0.3, 0.0, 0.3, 0.0, -0.1, 0.0]);
        assert!((&fit.residuals - residuals).amax() < 1e-15);
        // (XᵀX)⁻¹ = [14 -6; -6 4] / 20.
        let covariance = DMatrix::from_row_slice(2, 2, &[0.7, -0.3, -0.3, 0.2]);
        assert!((&fit.unscaled_covariance - covariance).amax() < 1e-16);
        assert_eq!(fit.dof, 2);
        assert!((fit.residual_std[0] - 0.1_f64.sqrt()).abs() < 1e-16);
        assert!(fit.residual_std[1] < 1e-16);
        assert!((fit.std()[(1, 0)] - 0.02_f64.sqrt()).abs() < 1e-16);
        // Unit columns have the scalar product 6 / sqrt(4 · 14): condition sqrt((1 + c) / (1 - c)).
        let c = 6.0 / 56.0_f64.sqrt();
        assert!((fit.condition - ((1.0 + c) / (1.0 - c)).sqrt()).abs() < 1e-13);
    }

    #[test]
    fn a_nearly_singular_design_keeps_every_digit() {
        // Läuchli: XᵀX = [1 + e² 1; 1 1 + e²], the inverse is [1 + e² -1; -1 1 + e²] / (2 e² + e⁴).
        let e = 2f64.powi(-22);
        let columns = DMatrix::from_row_slice(3, 2, &[1.0, 1.0, e, 0.0, 0.0, e]);
        let y = DMatrix::from_row_slice(3, 1, &[3.0, 0.0, 0.0]);
        let fit = solve(&design("a b", columns), &y, None, &Limits::default()).unwrap();
        let determinant = 2.0 * e * e + e.powi(4);
        assert!((fit.unscaled_covariance[(0, 0)] / ((1.0 + e * e) / determinant) - 1.0).abs() < 4e-16);
        assert!((fit.unscaled_covariance[(0, 1)] / (-1.0 / determinant) - 1.0).abs() < 4e-16);
        // (XᵀX)⁻¹ Xᵀ y = 3 e² [1 1] / (2 e² + e⁴).
        assert!((fit.coefficients[(0, 0)] / (3.0 / (2.0 + e * e)) - 1.0).abs() < 4e-16);
    }

    #[test]
    fn weights_count_rows() {
        let y = DMatrix::from_row_slice(4, 1, &[1.0, 2.5, 4.0, 4.5]);
        let weighted = solve(&line(), &y, Some(&[1.0, 3.0, 0.0, 1.0]), &Limits::default()).unwrap();
        let rows = [0, 1, 1, 1, 3];
        let repeated = design("offset slope", line().columns().select_rows(&rows));
        let repeated = solve(&repeated, &y.select_rows(&rows), None, &Limits::default()).unwrap();
        assert!((&weighted.coefficients - &repeated.coefficients).amax() < 1e-15);
        assert!((&weighted.unscaled_covariance - &repeated.unscaled_covariance).amax() < 1e-15);
        assert_eq!((weighted.dof, repeated.dof), (1, 3));
        // A row left out still has its residual.
        let expected = 4.0 - weighted.coefficients[0] - 2.0 * weighted.coefficients[1];
        assert!((weighted.residuals[2] - expected).abs() < 1e-15);
        assert!((weighted.residual_std[0] / (3.0 * repeated.residual_std[0].powi(2)).sqrt() - 1.0).abs() < 1e-14);
    }

    #[test]
    fn units_of_columns_do_not_matter() {
        let scaled = DMatrix::from_fn(4, 2, |i, j| line().columns()[(i, j)] * [1e-120, 1e120][j]);
        let y = DMatrix::from_row_slice(4, 1, &[1.0, 2.0, 4.0, 5.0]);
        let fit = solve(&design("a b", scaled), &y, None, &Limits::default()).unwrap();
        assert!((fit.coefficients[0] / 0.9e120 - 1.0).abs() < 1e-14);
        assert!((fit.coefficients[1] / 1.4e-120 - 1.0).abs() < 1e-14);
    }

    #[test]
    fn a_right_hand_side_the_design_cannot_see_has_zero_coefficients() {
        let y = DMatrix::from_row_slice(4, 2, &[0.0, 1.0, 0.0, -3.0, 0.0, 3.0, 0.0, -1.0]);
        let fit = solve(&line(), &y, None, &Limits::default()).unwrap();
        assert!(fit.coefficients.amax() < 1e-30);
        assert_eq!(fit.residual_std[0], 0.0);
        assert!((fit.residual_std[1] - 10f64.sqrt()).abs() < 1e-15);
        // Also where the first answer is nothing but rounding errors magnified by the condition.
        let e = 2f64.powi(-22);
        let near = design("a b", DMatrix::from_row_slice(3, 2, &[1.0, 1.0, e, 0.0, 0.0, e]));
        let y = DMatrix::from_row_slice(3, 1, &[-e, 1.0, 1.0]);
        let fit = solve(&near, &y, None, &Limits::default()).unwrap();
        assert!(fit.coefficients.amax() < 1e-15);
    }

    #[test]
    fn as_many_rows_as_parameters_leave_no_residual_std() {
        let columns = line().columns().rows(0, 2).into_owned();
        let y = DMatrix::from_row_slice(2, 1, &[1.0, 3.0]);
        let fit = solve(&design("a b", columns), &y, None, &Limits::default()).unwrap();
        assert_eq!(fit.dof, 0);
        assert!(fit.residual_std[0].is_nan());
        assert!((fit.coefficients[1] - 2.0).abs() < 1e-15);
    }

    #[test]
    fn dependent_columns_are_named() {
        let columns = DMatrix::from_fn(6, 4, |i, j| {
            let x = i as f64;
            [1.0, x, x * x, 3.0 * x - 2.0][j]
        });
        let four = design("offset x x² copy", columns);
        let y = DMatrix::from_fn(6, 1, |i, _| i as f64);
        let error = solve(&four, &y, None, &Limits::default()).unwrap_err();
        let message = "the data do not determine offset, x, copy (condition ";
        assert!(error.to_string().starts_with(message), "{error}");
        assert_eq!(undetermined_names(error), ["offset", "x", "copy"]);
        // Also where the limit lets everything pass: refinement finds no digit to keep.
        let max_condition = f64::INFINITY;
        let error = solve(&four, &y, None, &Limits { max_condition }).unwrap_err();
        assert_eq!(undetermined_names(error), ["offset", "x", "copy"]);
    }

    #[test]
    fn a_zero_column_is_named_and_infinitely_ill_conditioned() {
        // The last row would fill the column, but its weight is zero.
        let columns = DMatrix::from_fn(5, 3, |i, j| [1.0, (i / 4) as f64, i as f64][j]);
        let (y, weights) = (DMatrix::from_element(5, 1, 1.0), [1.0, 1.0, 1.0, 1.0, 0.0]);
        let abc = design("a b c", columns);
        assert!(solve(&abc, &y, None, &Limits::default()).is_ok());
        let error = solve(&abc, &y, Some(&weights), &Limits::default()).unwrap_err();
        assert!(matches!(error, FitError::Undetermined { condition: f64::INFINITY, .. }));
        assert_eq!(undetermined_names(error), ["b"]);
    }

    #[test]
    fn the_limit_on_the_condition_is_kept() {
        let columns = DMatrix::from_fn(5, 2, |i, j| 1.0 + 1e-4 * (i * j) as f64);
        let near = design("a b", columns);
        let y = DMatrix::from_fn(5, 1, |i, _| i as f64);
        let fit = solve(&near, &y, None, &Limits::default()).unwrap();
        // For unit columns with an angle of a: condition 2 / a, here sin a = 1e-4 sqrt(Σ (i - 2)²) / sqrt(5).
        assert!((fit.condition * 1e-4 * 2f64.sqrt() / 2.0 - 1.0).abs() < 1e-3);
        let error = solve(&near, &y, None, &Limits { max_condition: 1e3 }).unwrap_err();
        assert_eq!(undetermined_names(error), ["a", "b"]);
    }

    #[test]
    fn input_that_does_not_fit_is_refused() {
        let y = DMatrix::from_element(4, 1, 1.0);
        let refused = |design: &Design, rhs: &DMatrix<f64>, weights: Option<&[f64]>| {
            solve(design, rhs, weights, &Limits::default()).unwrap_err()
        };
        let short = design("a b", DMatrix::from_element(1, 2, 1.0));
        let error = refused(&short, &DMatrix::from_element(1, 1, 1.0), None);
        assert_eq!(error.to_string(), "1 rows cannot determine 2 parameters");
        assert_eq!(refused(&line(), &y, Some(&[1.0, 0.0, 0.0, 0.0])), error);
        let error = refused(&design("", DMatrix::zeros(4, 0)), &y, None);
        assert!(matches!(error, FitError::TooFewRows { rows: 4, parameters: 0 }));
        let error = refused(&line(), &DMatrix::zeros(3, 1), None);
        assert!(matches!(error, FitError::Length { expected: 4, found: 3, .. }));
        let error = refused(&line(), &y, Some(&[1.0; 3]));
        assert!(matches!(error, FitError::Length { expected: 4, found: 3, .. }));
        let error = refused(&line(), &y, Some(&[1.0, 1.0, -1.0, 1.0]));
        assert_eq!(error, FitError::NegativeWeight { row: 2 });
        let mut holed = DMatrix::from_element(4, 2, 1.0);
        holed[(3, 1)] = f64::NAN;
        let error = refused(&line(), &holed, None);
        assert!(matches!(error, FitError::NotFinite { row: 3, .. }));
        let error = Design::new(vec!["a".into(), "b".into()], holed.clone()).unwrap_err();
        assert!(matches!(error, FitError::NotFinite { row: 3, .. }));
        let error = Design::new(vec!["a".into()], holed).unwrap_err();
        assert!(matches!(error, FitError::Length { expected: 2, found: 1, .. }));
        let error = refused(&line(), &DMatrix::from_element(4, 1, 1e300), Some(&[1e300; 4]));
        assert!(matches!(error, FitError::NotFinite { row: 0, .. }));
    }
}
