//! Predictions of stretches of a run that were left out of the fit.

use super::Means;
use crate::diagnose::candidate::Candidate;
use crate::fit::noise::state_space::Noise;
use nalgebra::{DMatrix, DVector, DVectorView};
use std::ops::Range;

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
    /// The same of each component in nT²: of what is not predicted although the readings before it in the stretch are known.
    fresh_nt2: [f64; 3],
    /// Sum of the weights, 1/nT².
    weight: f64,
}

impl HeldOut {
    /// Weighted root mean square of what is not predicted, nT: slow noise that passes from reading to reading is not in it.
    #[must_use]
    pub fn weighted_rms_nt(&self) -> f64 {
        (self.sum / self.weight.max(f64::MIN_POSITIVE)).sqrt()
    }

    /// The same squares without weights, all components, nT².
    #[must_use]
    pub fn plain_nt2(&self) -> f64 {
        self.fresh_nt2.iter().sum()
    }
}

/// One stretch.
struct Stretch {
    rows: Range<usize>,
    columns: DMatrix<f64>,
    readings: DVector<f64>,
    /// Columns and readings whitened.
    white_columns: DMatrix<f64>,
    white_readings: DVector<f64>,
    /// Standard deviation of each reading beside those before it in the stretch, enT.
    fresh_std: Vec<f64>,
}

impl Stretch {
    /// What a fit leaves of the whitened readings.
    fn white_left(&self, coefficients: &DVector<f64>) -> DVector<f64> {
        &self.white_readings - &self.white_columns * coefficients
    }
}

/// The columns of the linear model and of terms, every column divided by its largest value: columns of very different size make bad normal
/// equations.
struct Design<'a> {
    means: &'a Means<'a>,
    terms: Vec<DVectorView<'a, f64>>,
    inverse_sizes: Vec<f64>,
}

impl<'a> Design<'a> {
    fn new(means: &'a Means<'a>, terms: &[&'a Candidate]) -> Self {
        let terms: Vec<DVectorView<f64>> = terms.iter().flat_map(|t| t.columns.column_iter()).collect();
        let own: Vec<f64> = means.prepared.design.column_iter().map(|c| c.amax()).collect();
        let sizes = [&own; 3].into_iter().flatten().copied().chain(terms.iter().map(|t| t.amax()));
        let inverse_sizes = sizes.map(|s| if s > 0.0 { s.recip() } else { 1.0 }).collect();
        Self { means, terms, inverse_sizes }
    }

    fn width(&self) -> usize {
        self.inverse_sizes.len()
    }

    /// The columns for some rows, component after component.
    fn columns(&self, rows: &Range<usize>) -> DMatrix<f64> {
        let (n, p) = self.means.prepared.design.shape();
        let m = rows.len();
        let mut columns = DMatrix::zeros(3 * m, self.width());
        for a in 0..3 {
            for j in 0..p {
                let own = self.means.prepared.design.view((rows.start, j), (m, 1)) * self.inverse_sizes[a * p + j];
                columns.view_mut((a * m, a * p + j), (m, 1)).copy_from(&own);
            }
            for (term, at) in self.terms.iter().zip(3 * p..) {
                let own = term.rows(a * n + rows.start, m) * self.inverse_sizes[at];
                columns.view_mut((a * m, at), (m, 1)).copy_from(&own);
            }
        }
        columns
    }
}

impl Means<'_> {
    /// Predictions of stretches that were left out of the fit, one after the other.
    #[must_use]
    pub fn predicted(&self, noise: &Noise, terms: &[&Candidate]) -> HeldOut {
        let n = self.rows();
        let mut held = HeldOut { residual_ent: DMatrix::zeros(n, 3), sum: 0.0, fresh_nt2: [0.0; 3], weight: 0.0 };
        self.each_held_out(noise, terms, |stretch, coefficients, _| {
            let left = &stretch.readings - &stretch.columns * coefficients;
            let white = stretch.white_left(coefficients);
            let m = stretch.rows.len();
            for (at, (std, z)) in stretch.fresh_std.iter().zip(white.iter()).enumerate() {
                let a = at / m;
                let std_nt = std * self.prepared.nt_per_ent[a];
                held.residual_ent[(stretch.rows.start + at % m, a)] = left[at];
                held.fresh_nt2[a] += (z * std_nt).powi(2);
                held.weight += (std_nt * std_nt).recip();
            }
            held.sum += white.norm_squared();
        });
        held
    }

    /// Chi square of the predictions of held-out stretches over the number of readings, component by component, beside the noise and the
    /// uncertainty of the predictions: it is one of a model in which nothing is missing, also where a stretch is far from all others.
    #[must_use]
    pub fn surprise(&self, noise: &Noise, terms: &[&Candidate]) -> [f64; 3] {
        let mut squares = [0.0; 3];
        let mut count = 0;
        self.each_held_out(noise, terms, |stretch, coefficients, others| {
            let m = stretch.rows.len();
            let white = stretch.white_left(coefficients);
            for (a, sum) in squares.iter_mut().enumerate() {
                let columns = stretch.white_columns.rows(a * m, m);
                let left = white.rows(a * m, m);
                // The inverse of 1 + C A⁻¹ Cᵀ is 1 - C (A + CᵀC)⁻¹ Cᵀ: there are fewer columns than readings.
                let along = columns.tr_mul(&left);
                let explained = (others + columns.tr_mul(&columns)).cholesky().map_or(0.0, |all| along.dot(&all.solve(&along)));
                *sum += left.norm_squared() - explained;
            }
            count += m;
        });
        squares.map(|sum| sum / count.max(1) as f64)
    }

    /// Every stretch with the coefficients of a fit to all others, and the information of these on them.
    fn each_held_out(&self, noise: &Noise, terms: &[&Candidate], mut of: impl FnMut(&Stretch, &DVector<f64>, &DMatrix<f64>)) {
        let n = self.rows();
        let design = Design::new(self, terms);
        let width = design.width();
        let count = STRETCHES.min(n / 3);
        let stretch = |k: usize| self.stretch(noise, &design, k * n / count..(k + 1) * n / count);
        let stretches: Vec<Stretch> = (0..count).filter_map(stretch).collect();
        let normal: Vec<(DMatrix<f64>, DVector<f64>)> = stretches
            .iter()
            .map(|s| (s.white_columns.transpose() * &s.white_columns, s.white_columns.tr_mul(&s.white_readings)))
            .collect();
        let total = normal.iter().fold((DMatrix::zeros(width, width), DVector::zeros(width)), |(g, b), (h, c)| (g + h, b + c));
        let ridge = RIDGE * total.0.trace() / width as f64;
        for (stretch, (gram, right)) in stretches.iter().zip(&normal) {
            let mut others = &total.0 - gram;
            (0..width).for_each(|j| others[(j, j)] += ridge);
            let Some(cholesky) = others.clone().cholesky() else { continue };
            of(stretch, &cholesky.solve(&(&total.1 - right)), &others);
        }
    }

    /// The readings of some rows with their columns, whitened by their own covariance.
    fn stretch(&self, noise: &Noise, design: &Design, rows: Range<usize>) -> Option<Stretch> {
        let (m, width) = (rows.len(), design.width());
        let mut all = design.columns(&rows).insert_column(width, 0.0);
        for a in 0..3 {
            all.view_mut((a * m, width), (m, 1)).copy_from(&self.readings.view((rows.start, a), (m, 1)));
        }
        let mut white = all.clone();
        let mut fresh_std = Vec::with_capacity(3 * m);
        for a in 0..3 {
            let own = noise.of_stretch(a, rows.clone())?;
            white.rows_mut(a * m, m).copy_from(&own.whitened(&all.rows(a * m, m).into_owned()));
            fresh_std.extend(own.fresh_std());
        }
        let [readings, white_readings] = [&all, &white].map(|m| m.column(width).into_owned());
        let [columns, white_columns] = [all, white].map(|m| m.remove_column(width));
        Some(Stretch { rows, columns, readings, white_columns, white_readings, fresh_std })
    }
}
