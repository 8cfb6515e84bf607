//! Predictions of stretches of a run that were left out of the fit.

use super::Means;
use crate::diagnose::candidate::Candidate;
use crate::fit::noise::NoiseModel;
use crate::fit::noise::state_space::Noise;
use nalgebra::{DMatrix, DVector};

/// Stretches that are held out in turn, one after the other and never single rows: what is slow would be predicted by its neighbours.
const STRETCHES: usize = 18;
/// What a stretch alone determines stays where it is without it: by this part of the mean of the squares of the columns.
const RIDGE: f64 = 1e-12;

/// What predictions of held-out stretches leave.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// Readings minus predictions, enT.
    pub residual_ent: DMatrix<f64>,
    /// Squares of the whitened residuals.
    pub sum: f64,
}

/// One stretch.
struct Stretch {
    /// Row and component of each reading.
    places: Vec<(usize, usize)>,
    columns: DMatrix<f64>,
    readings: DVector<f64>,
    /// Columns and readings whitened.
    white_columns: DMatrix<f64>,
    white_readings: DVector<f64>,
}

/// The columns of the linear model and of terms for any reading, every column divided by its largest value: columns of very different size
/// make bad normal equations.
struct Design<'a> {
    means: &'a Means<'a>,
    terms: &'a [&'a Candidate],
    inverse_sizes: DVector<f64>,
}

impl<'a> Design<'a> {
    fn new(means: &'a Means<'a>, terms: &'a [&'a Candidate]) -> Self {
        let width = 3 * means.prepared.design.ncols() + terms.iter().map(|t| t.columns.ncols()).sum::<usize>();
        let mut design = Self { means, terms, inverse_sizes: DVector::from_element(width, 1.0) };
        let mut sizes = DVector::from_element(width, 0.0);
        for a in 0..3 {
            for i in 0..means.rows() {
                sizes.zip_apply(&design.row(a, i), |s: &mut f64, v: f64| *s = s.max(v.abs()));
            }
        }
        sizes.apply(|s| *s = if *s > 0.0 { s.recip() } else { 1.0 });
        design.inverse_sizes = sizes;
        design
    }

    fn width(&self) -> usize {
        self.inverse_sizes.len()
    }

    fn row(&self, component: usize, i: usize) -> DVector<f64> {
        let (n, p) = self.means.prepared.design.shape();
        let mut row = DVector::zeros(self.width());
        for j in 0..p {
            row[component * p + j] = self.means.prepared.design[(i, j)];
        }
        let columns = self.terms.iter().flat_map(|t| t.columns.column_iter());
        for (at, column) in columns.enumerate() {
            row[3 * p + at] = column[component * n + i];
        }
        row.component_mul(&self.inverse_sizes)
    }
}

impl Means<'_> {
    /// Predictions of stretches that were left out of the fit, one after the other.
    #[must_use]
    pub fn predicted(&self, noise: &Noise, terms: &[&Candidate]) -> HeldOut {
        let n = self.rows();
        let design = Design::new(self, terms);
        let width = design.width();
        let count = STRETCHES.min(n / 3);
        let stretch = |k: usize| self.stretch(noise, &design, (k * n / count..(k + 1) * n / count).collect());
        let stretches: Vec<Stretch> = (0..count).map(stretch).collect();
        let normal: Vec<(DMatrix<f64>, DVector<f64>)> = stretches
            .iter()
            .map(|s| (s.white_columns.tr_mul(&s.white_columns), s.white_columns.tr_mul(&s.white_readings)))
            .collect();
        let total = normal.iter().fold((DMatrix::zeros(width, width), DVector::zeros(width)), |(g, b), (h, c)| (g + h, b + c));
        let ridge = RIDGE * total.0.trace() / width as f64;
        let mut held = HeldOut { residual_ent: DMatrix::zeros(n, 3), sum: 0.0 };
        for (stretch, (gram, right)) in stretches.iter().zip(&normal) {
            let mut others = &total.0 - gram;
            (0..width).for_each(|j| others[(j, j)] += ridge);
            let Some(cholesky) = others.cholesky() else { continue };
            let coefficients = cholesky.solve(&(&total.1 - right));
            let left = &stretch.readings - &stretch.columns * &coefficients;
            for ((i, a), r) in stretch.places.iter().zip(left.iter()) {
                held.residual_ent[(*i, *a)] = *r;
            }
            let squares = (&stretch.white_readings - &stretch.white_columns * &coefficients).norm_squared();
            held.sum += squares;
        }
        held
    }

    /// The readings of some rows with their columns, whitened by their own covariance.
    fn stretch(&self, noise: &Noise, design: &Design, rows: Vec<usize>) -> Stretch {
        let m = rows.len();
        let mut columns = DMatrix::zeros(3 * m, design.width());
        let mut readings = DVector::zeros(3 * m);
        let mut places = Vec::with_capacity(3 * m);
        let (mut white_columns, mut white_readings) = (columns.clone(), readings.clone());
        for a in 0..3 {
            for (k, i) in rows.iter().enumerate() {
                columns.row_mut(a * m + k).copy_from(&design.row(a, *i).transpose());
                readings[a * m + k] = self.readings[(*i, a)];
                places.push((*i, a));
            }
            if let Some(cholesky) = noise.covariance_of_rows(a, &rows).cholesky() {
                let l = cholesky.l();
                let of_columns = l.solve_lower_triangular(&columns.rows(a * m, m).into_owned());
                let of_readings = l.solve_lower_triangular(&readings.rows(a * m, m).into_owned());
                if let (Some(of_columns), Some(of_readings)) = (of_columns, of_readings) {
                    white_columns.rows_mut(a * m, m).copy_from(&of_columns);
                    white_readings.rows_mut(a * m, m).copy_from(&of_readings);
                }
            }
        }
        Stretch { places, columns, readings, white_columns, white_readings }
    }
}
