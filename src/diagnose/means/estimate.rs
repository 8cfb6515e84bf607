//! Sizes of terms with their uncertainties, parameters of the linear model, and the noise of the rows.

use super::{Means, MeansModel, with_shape};
use crate::diagnose::candidate::Candidate;
use crate::fit::noise::state_space::NoiseParameters;
use crate::model::effects::offset_drift::{self, OffsetDrift};
use crate::model::effects::{EffectRef, Spec};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Logarithm of the probability of noise that has no influence on an average.
const NEGLIGIBLE: f64 = -7.0;
/// Step of the derivative by a shape parameter, as a part of its value.
const STEP: f64 = 1e-3;
/// Singular values of columns of unit length below this are those of columns that depend on each other.
const APART: f64 = 1e-10;

impl Means<'_> {
    /// Parameters of the linear model, component after component, and their covariance: averaged over the noise that the readings allow,
    /// the scatter of the averaged values included.
    #[must_use]
    pub fn linear(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let noise = self.model(&[])?.noise;
        let noises = self.correlations.plausible(&noise.parameters, &self.readings, &self.designs(&[]));
        let fits: Vec<(f64, DVector<f64>, DMatrix<f64>)> = noises
            .into_par_iter()
            .filter(|(_, weight)| *weight > NEGLIGIBLE)
            .filter_map(|(noise, weight)| {
                let model = self.model_with(noise, &[]);
                let covariance = model.columns.tr_mul(&model.columns).cholesky()?.inverse();
                let values = &covariance * model.columns.tr_mul(&model.readings);
                Some((weight.exp(), values, covariance))
            })
            .collect();
        let total: f64 = fits.iter().map(|f| f.0).sum();
        let count = fits.first()?.1.len();
        let mean = fits.iter().fold(DVector::zeros(count), |sum, (w, values, _)| sum + values * (w / total));
        let covariance = fits.iter().fold(DMatrix::zeros(count, count), |sum, (w, values, covariance)| {
            let off = values - &mean;
            sum + (covariance + &off * off.transpose()) * (w / total)
        });
        Some((mean, covariance))
    }

    /// Noise of every row about the fitted model, enT: slow noise that the model follows is not in it.
    #[must_use]
    pub fn row_std(&self, model: &MeansModel, terms: &[&Candidate]) -> Vec<[f64; 3]> {
        let n = self.rows();
        let level = self.residuals(terms).map(|left| left.rms());
        let total = model.noise.std();
        let usual: [f64; 3] = std::array::from_fn(|a| (total.iter().map(|s| s[a] * s[a]).sum::<f64>() / n as f64).sqrt());
        total.iter().map(|s| std::array::from_fn(|a| s[a] / usual[a] * level[a])).collect()
    }

    /// What least squares with the model and the terms leave of the readings of each component.
    #[must_use]
    pub fn residuals(&self, terms: &[&Candidate]) -> [Residuals; 3] {
        let designs = self.designs(terms);
        std::array::from_fn(|a| {
            let reading = self.readings.column(a);
            let ent = reading - &designs[a] * designs[a].tr_mul(&reading);
            Residuals { ent, freedom: (self.rows() - designs[a].ncols()).max(1) as f64 }
        })
    }

    /// White noise of the means of each component, enT: where no field is applied by the samples inside them, otherwise by the model of the
    /// noise.
    #[must_use]
    pub fn white_std(&self, model: &MeansModel) -> [f64; 3] {
        let n = self.rows() as f64;
        std::array::from_fn(|a| {
            let usual = self.prepared.white.iter().map(|w| w[a]).sum::<f64>() / n;
            let one = self.prepared.inside.map_or(model.noise.white_std[a], |inside| inside.variance[a].sqrt());
            one * usual.sqrt()
        })
    }

    /// Logarithm of the likelihood ratio of the noise of a model to the same without anything slow.
    #[must_use]
    pub fn slow_over_white(&self, model: &MeansModel, terms: &[&Candidate]) -> f64 {
        self.correlations.slow_over_white(&model.noise.parameters, &self.readings, &self.designs(terms))
    }

    /// How the offset of each component drifts beside a model with white noise, in the lowest order that is not fitted: amplitude and standard
    /// uncertainty, enT. It is what slow noise stands for.
    #[must_use]
    pub fn drifts(&self, terms: &[&Candidate]) -> Option<[(f64, f64); 3]> {
        let white = self.correlations.with_parameters(NoiseParameters::WHITE, &self.readings, &self.designs(terms))?;
        let of = |axis: usize| {
            let spec = Spec::new(offset_drift::LINE, &[axis]);
            let drift = EffectRef::new(&OffsetDrift);
            let columns = drift.columns(&self.prepared.record, &spec)?;
            let line = Candidate::of_readings(drift, spec, columns);
            let with: Vec<&Candidate> = terms.iter().copied().chain([&line]).collect();
            self.estimate(&self.model_with(white.clone(), &with), &with, terms.len())?.first().copied()
        };
        Some([of(0)?, of(1)?, of(2)?])
    }

    /// Values and standard uncertainties of the parameters of a term, with the uncertainty of its continuous shape parameter in them; the
    /// shape parameter last.
    #[must_use]
    pub fn estimate(&self, model: &MeansModel, terms: &[&Candidate], index: usize) -> Option<Vec<(f64, f64)>> {
        let before: usize = terms[..index].iter().map(|t| t.columns.ncols()).sum();
        let extra: usize = terms.iter().map(|t| t.columns.ncols()).sum();
        let from = model.columns.ncols() - extra + before;
        let own = from..from + terms[index].columns.ncols();
        let (values, covariance) = solution(&model.columns, &model.readings)?;
        let std = |covariance: &DMatrix<f64>, j: usize| covariance[(j, j)].max(0.0).sqrt();
        let mut result: Vec<(f64, f64)> = own.clone().map(|j| (values[j], std(&covariance, j))).collect();
        let Some((_, shape)) = terms[index].effect.continuous(&terms[index].spec) else { return Some(result) };
        let amplitudes = values.rows(own.start, own.len()).into_owned();
        let Some(slope) = self.shape_column(terms[index], &amplitudes, model) else { return Some(result) };
        let last = model.columns.ncols();
        let mut columns = model.columns.clone().insert_column(last, 0.0);
        columns.column_mut(last).copy_from(&slope);
        if let Some((_, covariance)) = solution(&columns, &model.readings) {
            result.iter_mut().zip(own).for_each(|(r, j)| r.1 = std(&covariance, j));
            result.push((shape, std(&covariance, last)));
        }
        Some(result)
    }

    /// The whitened column of the continuous shape parameter of a term, at the amplitudes that were found.
    fn shape_column(&self, term: &Candidate, amplitudes: &DVector<f64>, model: &MeansModel) -> Option<DVector<f64>> {
        let (name, value) = term.effect.continuous(&term.spec)?;
        let step = STEP * value.abs().max(1e-9);
        let at = |v: f64| with_shape(term, &self.prepared.record, name, v).map(|c| c.columns);
        let (up, down) = (at(value + step)?, at(value - step)?);
        let slope = (up - down) * amplitudes / (2.0 * step);
        let slope = DMatrix::from_column_slice(slope.len(), 1, slope.as_slice());
        (slope.norm() > 0.0).then(|| self.whiten(&model.noise, &slope).column(0).into_owned())
    }
}

/// What least squares leave of the readings of one component.
pub struct Residuals {
    /// Readings minus the fit, enT.
    pub ent: DVector<f64>,
    /// Degrees of freedom.
    pub freedom: f64,
}

impl Residuals {
    /// Root mean square, enT.
    #[must_use]
    pub fn rms(&self) -> f64 {
        self.ent.norm() / self.freedom.sqrt()
    }
}

/// Least squares with columns of very different size: the shortest solution and its covariance.
fn solution(columns: &DMatrix<f64>, readings: &DVector<f64>) -> Option<(DVector<f64>, DMatrix<f64>)> {
    let sizes: Vec<f64> = columns.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
    let scaled = DMatrix::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)] / sizes[j]);
    let inverse = scaled.svd(true, true).pseudo_inverse(APART).ok()?;
    let mut values = &inverse * readings;
    let mut covariance = &inverse * inverse.transpose();
    for i in 0..sizes.len() {
        values[i] /= sizes[i];
        for j in 0..sizes.len() {
            covariance[(i, j)] /= sizes[i] * sizes[j];
        }
    }
    Some((values, covariance))
}
