//! Where readings and model disagree before anything is named: displacements of bins of every covariate.

use super::result::{Bin, Place};
use crate::data::units::COMPONENTS;
use crate::fit::noise::NoiseModel;
use crate::fit::noise::state_space::Noise;
use crate::model::effects::{Covariate, Record};
use nalgebra::{DMatrix, DVector};

/// Bins of a covariate, at most.
const BINS: usize = 10;
/// Stretches of the run that are held out in turn, as for the terms.
const STRETCHES: usize = 18;
/// What a stretch alone determines is nothing without it: by this part of the mean of the squares of the columns.
const RIDGE: f64 = 1e-6;
/// A bin of which less than this part is left beside the model says nothing.
const SHOWN: f64 = 1e-3;

/// The model of a component and what is compared with it.
pub struct Model<'a> {
    /// Rows with their covariates.
    pub record: &'a Record,
    /// Mean readings, enT: a row per row, a column per component.
    pub readings: &'a DMatrix<f64>,
    /// Columns of the linear model of each component.
    pub design: &'a DMatrix<f64>,
    /// Columns of known terms, component after component.
    pub given: Vec<&'a DMatrix<f64>>,
    /// nT per enT of each component.
    pub nt_per_ent: [f64; 3],
}

/// Whitened columns that the model explains, orthonormal.
fn explained(model: &Model, noise: &Noise, axis: usize) -> DMatrix<f64> {
    let n = model.readings.nrows();
    let extra: usize = model.given.iter().map(|g| g.ncols()).sum();
    let mut columns = DMatrix::zeros(n, model.design.ncols() + extra);
    columns.columns_mut(0, model.design.ncols()).copy_from(model.design);
    let mut at = model.design.ncols();
    for given in &model.given {
        columns.columns_mut(at, given.ncols()).copy_from(&given.rows(axis * n, n));
        at += given.ncols();
    }
    noise.whiten(axis, &mut columns);
    for mut column in columns.column_iter_mut() {
        let size = column.norm();
        column /= size.max(f64::MIN_POSITIVE);
    }
    // Columns that repeat others have no direction of their own.
    let svd = columns.svd(true, false);
    let count = svd.singular_values.iter().filter(|s| **s > 1e-10).count();
    svd.u.map_or_else(|| DMatrix::zeros(n, 0), |u| u.columns(0, count).into_owned())
}

/// Rows in the order of a covariate, parted into bins of similar numbers; equal values stay together.
fn bins_of(values: &[f64]) -> Vec<Vec<usize>> {
    let mut order: Vec<usize> = (0..values.len()).collect();
    order.sort_by(|a, b| values[*a].total_cmp(&values[*b]));
    let range = values[order[order.len() - 1]] - values[order[0]];
    let most = order.len().div_ceil(BINS);
    let mut bins: Vec<Vec<usize>> = Vec::new();
    for group in order.chunk_by(|a, b| values[*b] - values[*a] <= 1e-9 * range) {
        match bins.last_mut() {
            Some(last) if last.len() + group.len() <= most => last.extend_from_slice(group),
            _ => bins.push(group.to_vec()),
        }
    }
    bins
}

/// Squares that columns explain of stretches of the whitened residuals that did not fit them, less what is added to others.
fn predicted(columns: &DMatrix<f64>, left: &DVector<f64>) -> f64 {
    let (n, width) = columns.shape();
    let count = STRETCHES.min(n / 3).max(1);
    let (gram, along) = (columns.tr_mul(columns), columns.tr_mul(left));
    let ridge = RIDGE * gram.trace().max(f64::MIN_POSITIVE) / width.max(1) as f64;
    let of_stretch = |k: usize| -> f64 {
        let (from, to) = (k * n / count, (k + 1) * n / count);
        let (own, left) = (columns.rows(from, to - from), left.rows(from, to - from));
        let mut others = &gram - own.tr_mul(&own);
        (0..width).for_each(|j| others[(j, j)] += ridge);
        let Some(cholesky) = others.cholesky() else { return 0.0 };
        let values = cholesky.solve(&(&along - own.tr_mul(&left)));
        left.norm_squared() - (left - own * values).norm_squared()
    };
    (0..count).map(of_stretch).sum()
}

/// Displacement of every bin of every covariate on every axis, fitted beside the model with the noise that is left when all is named;
/// the covariate and axis of which a smooth function explains most first.
#[must_use]
pub fn places(model: &Model, noise: &Noise) -> Vec<Place> {
    let n = model.readings.nrows();
    let bases: [DMatrix<f64>; 3] = std::array::from_fn(|a| explained(model, noise, a));
    let whitened = |axis: usize, column: DVector<f64>| -> DVector<f64> {
        let mut column = DMatrix::from_column_slice(n, 1, column.as_slice());
        noise.whiten(axis, &mut column);
        column.column(0).into_owned()
    };
    let beside = |axis: usize, column: DVector<f64>| -> DVector<f64> { &column - &bases[axis] * bases[axis].tr_mul(&column) };
    let left: [DVector<f64>; 3] = std::array::from_fn(|a| beside(a, whitened(a, model.readings.column(a).into_owned())));
    let mut places = Vec::new();
    for covariate in Covariate::all(model.record) {
        let groups = bins_of(&covariate.values);
        for axis in 0..3 {
            let most = model.record.most_ent(axis).max(f64::MIN_POSITIVE);
            let mut bins = Vec::with_capacity(groups.len());
            let mut begin = 0;
            for rows in &groups {
                let mut column = DVector::zeros(n);
                for &i in rows {
                    column[i] = if covariate.gain { model.record.rows[i].linear_ent[axis] / most } else { 1.0 };
                }
                let own = whitened(axis, column);
                let size = own.norm();
                let own = beside(axis, own);
                let share = [begin, begin + rows.len()].map(|k| k as f64 / n as f64);
                begin += rows.len();
                if own.norm() > SHOWN * size {
                    let along = own.dot(&left[axis]);
                    bins.push(Bin {
                        share,
                        at: rows.iter().map(|i| covariate.values[*i]).sum::<f64>() / rows.len() as f64,
                        displacement_nt: along / own.norm_squared() * model.nt_per_ent[axis],
                        multiples_of_noise: along / own.norm(),
                    });
                }
            }
            let smooth = covariate.smooth(model.record, axis).unwrap_or_default();
            let columns: Vec<DVector<f64>> = smooth
                .iter()
                .map(|c| beside(axis, whitened(axis, DVector::from_fn(n, |i, _| c.values[i][axis]))))
                .filter(|c| c.norm_squared() > 0.0)
                .map(|c| c.normalize())
                .collect();
            let predicted = if columns.is_empty() { 0.0 } else { predicted(&DMatrix::from_columns(&columns), &left[axis]) };
            let largest = bins.iter().max_by(|a, b| a.multiples_of_noise.abs().total_cmp(&b.multiples_of_noise.abs())).copied();
            places.extend(largest.map(|bin| Place {
                covariate: covariate.name.clone(),
                unit: covariate.unit,
                axis: COMPONENTS[axis],
                at: bin.at,
                displacement_nt: bin.displacement_nt,
                multiples_of_noise: bin.multiples_of_noise,
                predicted,
                bins,
            }));
        }
    }
    places.sort_by(|a, b| b.predicted.total_cmp(&a.predicted));
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_keep_equal_values_together_and_lose_no_row() {
        let values: Vec<f64> = (0..100).map(|i| if i % 2 == 0 { 0.0 } else { f64::from(i) - 50.0 }).collect();
        let bins = bins_of(&values);
        assert_eq!(bins.iter().map(Vec::len).sum::<usize>(), 100);
        assert_eq!(bins.iter().filter(|b| b.iter().any(|i| values[*i] == 0.0)).count(), 1);
        assert!(bins.windows(2).all(|p| values[p[0][p[0].len() - 1]] < values[p[1][0]]));
    }
}
