//! Slow noise between rows as a sum of relaxations, with products and factors at a cost in proportion to the rows.
//!
//! The covariance of a row with a later one is a sum over relaxations of what the first leaves behind, what is left of that after the
//! time between them, and what the second takes up. Such a matrix needs no n² elements: a state per relaxation, carried from row to row,
//! multiplies with it (`times`) and factors it together with white noise (`whiten`).

use super::kernel::{mean_decay, mean_variance};
use nalgebra::{DMatrix, DVector};

/// Correlations that do not matter.
const NEGLIGIBLE: f64 = 1e-12;

/// The covariance of slow noise between rows.
#[derive(Clone, Debug)]
pub(super) struct Relaxations {
    /// Rows in the order of time.
    order: Vec<usize>,
    /// Number of relaxations.
    kinds: usize,
    /// Variance of each row, in the order of time.
    variance: Vec<f64>,
    /// Per row in the order of time, and per relaxation.
    steps: Vec<Step>,
}

/// What one relaxation does in one row.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// What is left of the state at the end of the row before; 0 in the first row.
    kept: f64,
    /// What is left of it at the end of this row, over that at its begin.
    through: f64,
    /// What the row takes up of the state.
    takes: f64,
    /// What the row leaves to the state.
    leaves: f64,
}

impl Relaxations {
    /// Means over intervals of noise that is the sum of relaxations with these time constants and variances. Intervals may have any order,
    /// not overlap.
    pub fn of_means(intervals: &[[f64; 2]], time_constants: &[f64], parts: &[f64]) -> Self {
        let mut order: Vec<usize> = (0..intervals.len()).collect();
        order.sort_by(|a, b| intervals[*a][0].total_cmp(&intervals[*b][0]));
        let mut steps = Vec::with_capacity(order.len() * parts.len());
        let mut variance = Vec::with_capacity(order.len());
        for (k, &row) in order.iter().enumerate() {
            let [begin, end] = intervals[row];
            let gap = k.checked_sub(1).map(|before| (begin - intervals[order[before]][1]).max(0.0));
            let mut own = 0.0;
            for (tau, part) in time_constants.iter().zip(parts) {
                let length = (end - begin) / tau;
                let takes = mean_decay(length);
                let kept = gap.map_or(0.0, |gap| (-gap / tau).exp());
                steps.push(Step { kept, through: (-length).exp(), takes, leaves: part * takes });
                own += part * mean_variance(length);
            }
            variance.push(own);
        }
        Self { order, kinds: parts.len(), variance, steps }
    }

    /// Values at instants of such noise.
    pub fn at(times: &[f64], time_constants: &[f64], parts: &[f64]) -> Self {
        let instants: Vec<[f64; 2]> = times.iter().map(|t| [*t, *t]).collect();
        Self::of_means(&instants, time_constants, parts)
    }

    /// The same with every row multiplied by a factor.
    pub fn scaled(&self, factor: impl Fn(usize) -> f64) -> Self {
        let mut scaled = self.clone();
        for (k, &row) in self.order.iter().enumerate() {
            let by = factor(row);
            scaled.variance[k] *= by * by;
            for step in &mut scaled.steps[k * self.kinds..(k + 1) * self.kinds] {
                step.takes *= by;
                step.leaves *= by;
            }
        }
        scaled
    }

    fn steps_of(&self, k: usize) -> &[Step] {
        &self.steps[k * self.kinds..(k + 1) * self.kinds]
    }

    /// All elements, n x n.
    pub fn dense(&self) -> DMatrix<f64> {
        self.of_rows(&(0..self.order.len()).collect::<Vec<_>>())
    }

    /// The elements of some rows, each named once, in any order: those between the first and the last of them in time are gone through.
    pub fn of_rows(&self, rows: &[usize]) -> DMatrix<f64> {
        let mut of_row = vec![None; self.order.len()];
        rows.iter().enumerate().for_each(|(i, row)| of_row[*row] = Some(i));
        // Index of the matrix, in the order of time.
        let at: Vec<Option<usize>> = self.order.iter().map(|row| of_row[*row]).collect();
        let end = at.iter().rposition(Option::is_some).map_or(0, |last| last + 1);
        let mut matrix = DMatrix::zeros(rows.len(), rows.len());
        for (k, i) in at.iter().enumerate().filter_map(|(k, i)| Some((k, (*i)?))) {
            matrix[(i, i)] = self.variance[k];
            for kind in 0..self.kinds {
                let mut left = self.steps_of(k)[kind].leaves;
                for (l, j) in at[..end].iter().enumerate().skip(k + 1) {
                    let step = self.steps_of(l)[kind];
                    left *= step.kept;
                    if left.abs() < NEGLIGIBLE {
                        break;
                    }
                    if let Some(j) = *j {
                        matrix[(j, i)] += left * step.takes;
                    }
                    left *= step.through;
                }
            }
        }
        // Only the elements of a later row and an earlier column are there yet.
        let in_time: Vec<usize> = at.into_iter().flatten().collect();
        for (later, &j) in in_time.iter().enumerate() {
            in_time[..later].iter().for_each(|&i| matrix[(i, j)] = matrix[(j, i)]);
        }
        matrix
    }

    /// The product with columns.
    pub fn times(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.order.len();
        let mut product = DMatrix::zeros(n, columns.ncols());
        let mut state = vec![0.0; self.kinds];
        for (column, mut sum) in columns.column_iter().zip(product.column_iter_mut()) {
            state.fill(0.0);
            for (k, &row) in self.order.iter().enumerate() {
                let mut earlier = self.variance[k] * column[row];
                for (s, step) in state.iter_mut().zip(self.steps_of(k)) {
                    let here = *s * step.kept;
                    earlier += step.takes * here;
                    *s = step.through * here + step.leaves * column[row];
                }
                sum[row] = earlier;
            }
            state.fill(0.0);
            for (k, &row) in self.order.iter().enumerate().rev() {
                let mut later = 0.0;
                for (s, step) in state.iter_mut().zip(self.steps_of(k)) {
                    later += step.leaves * *s;
                    *s = step.kept * (step.takes * column[row] + step.through * *s);
                }
                sum[row] += later;
            }
        }
        product
    }

    /// What it gives for a column on both sides.
    pub fn variance_of(&self, column: &DVector<f64>) -> f64 {
        let columns = DMatrix::from_column_slice(column.len(), 1, column.as_slice());
        self.times(&columns).column(0).dot(column)
    }

    /// Whitens columns for white noise of one variance beside `slow` times this covariance; returns the columns with their rows in the order of
    /// time, and the logarithm of the determinant. `None` where the sum is not positive.
    pub fn whiten(&self, white: f64, slow: f64, columns: &DMatrix<f64>) -> Option<(DMatrix<f64>, f64)> {
        let (n, kinds, width) = (self.order.len(), self.kinds, columns.ncols());
        let mut whitened = DMatrix::zeros(width, n);
        // Covariance of the states as far as the rows before tell them, lower half, and the states themselves per column.
        let mut told = vec![0.0; kinds * kinds];
        let mut states = vec![0.0; kinds * width];
        let (mut taken, mut gain) = (vec![0.0; kinds], vec![0.0; kinds]);
        let mut log_determinant = 0.0;
        let mut product = 1.0_f64;
        for (k, &row) in self.order.iter().enumerate() {
            let steps = self.steps_of(k);
            for i in 0..kinds {
                for j in 0..=i {
                    told[i * kinds + j] *= steps[i].kept * steps[j].kept;
                }
            }
            taken.fill(0.0);
            for i in 0..kinds {
                let mut sum = 0.0;
                for j in 0..i {
                    let element = told[i * kinds + j];
                    sum += element * steps[j].takes;
                    taken[j] += element * steps[i].takes;
                }
                taken[i] += sum + told[i * kinds + i] * steps[i].takes;
            }
            let explained: f64 = taken.iter().zip(steps).map(|(t, step)| t * step.takes).sum();
            let new = white + slow * self.variance[k] - explained;
            if new.is_nan() || new <= 0.0 {
                return None;
            }
            product *= new;
            if !(1e-200..1e200).contains(&product) {
                log_determinant += product.ln();
                product = 1.0;
            }
            for (i, step) in steps.iter().enumerate() {
                gain[i] = (slow * step.leaves - step.through * taken[i]) / new;
            }
            for i in 0..kinds {
                for j in 0..=i {
                    let element = &mut told[i * kinds + j];
                    *element = *element * steps[i].through * steps[j].through + new * gain[i] * gain[j];
                }
            }
            let scale = new.sqrt().recip();
            for c in 0..width {
                let state = &mut states[c * kinds..(c + 1) * kinds];
                let mut left = columns[(row, c)];
                for (s, step) in state.iter_mut().zip(steps) {
                    *s *= step.kept;
                    left -= step.takes * *s;
                }
                for ((s, step), g) in state.iter_mut().zip(steps).zip(&gain) {
                    *s = step.through * *s + g * left;
                }
                whitened[(c, k)] = left * scale;
            }
        }
        Some((whitened.transpose(), log_determinant + product.ln()))
    }
}
