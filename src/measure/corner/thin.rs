//! Long tables of amplitudes, made short before they are fitted: every refit of a response goes through all rows.
//!
//! Rows that follow each other in frequency are taken together, as many in every group. A parabola through a group gives its amplitude at
//! its middle, so that the bend of the response inside it counts nothing; rows that stand out of their group do not belong.

use super::result::ModelCorner;
use super::rows::{Amplitude, std_ent};
use crate::fit::statistics::median;
use crate::model::response::Response;
use nalgebra::{DMatrix, DVector};

/// Rows of a table that is fitted as it is, and of a longer one when it is short.
const MOST: usize = 500;
/// Rows of a group that tell a parabola.
const LEAST_PARABOLA: usize = 6;
/// A row that differs from the median of its group by so many times what half of the rows do stands out.
const OUTSTANDING: f64 = 8.0;

/// A table that was made short.
pub(super) struct Thin {
    /// The groups.
    pub rows: Vec<Amplitude>,
    /// Group of every row of the table, and for every component whether the row belongs; none if it does not count.
    places: Vec<Option<(usize, [bool; 3])>>,
}

impl Thin {
    /// `None` if the table is short as it is.
    pub fn of(table: &[Amplitude]) -> Option<Self> {
        let counts = |i: &usize| table[*i].usable && table[*i].frequency_hz.is_finite() && table[*i].frequency_hz > 0.0;
        let mut order: Vec<usize> = (0..table.len()).filter(counts).collect();
        if order.len() <= MOST {
            return None;
        }
        order.sort_by(|a, b| table[*a].frequency_hz.total_cmp(&table[*b].frequency_hz));
        let mut thin = Self { rows: Vec::new(), places: vec![None; table.len()] };
        for group in order.chunks(order.len().div_ceil(MOST)) {
            let logarithm = |i: usize| table[i].frequency_hz.ln();
            let middle = group.iter().map(|i| logarithm(*i)).sum::<f64>() / group.len() as f64;
            let mut row = Amplitude {
                frequency_hz: middle.exp(),
                amplitude_ent: [f64::NAN; 3],
                std_ent: [f64::NAN; 3],
                t_s: f64::NAN,
                usable: true,
            };
            let mut belongs = vec![[false; 3]; group.len()];
            for c in 0..3 {
                let inliers = inliers(&group.iter().map(|i| table[*i].amplitude_ent[c]).collect::<Vec<f64>>());
                belongs.iter_mut().zip(&inliers).for_each(|(b, inlier)| b[c] = *inlier);
                let own: Vec<usize> = group.iter().zip(&inliers).filter(|(_, inlier)| **inlier).map(|(i, _)| *i).collect();
                if own.is_empty() {
                    continue;
                }
                let value = |i: usize| (logarithm(i) - middle, table[i].amplitude_ent[c]);
                let (amplitude, part) = at_middle(&own.iter().map(|i| value(*i)).collect::<Vec<_>>());
                let variance = own.iter().map(|i| std_ent(&table[*i], c).powi(2)).sum::<f64>() / own.len() as f64;
                row.amplitude_ent[c] = amplitude.max(0.0);
                row.std_ent[c] = if variance > 0.0 { (part * variance).sqrt() } else { f64::NAN };
            }
            for (i, belongs) in group.iter().zip(belongs) {
                thin.places[*i] = Some((thin.rows.len(), belongs));
            }
            thin.rows.push(row);
        }
        Some(thin)
    }

    /// The answer for a component with a row for every row of the table.
    pub fn spread(&self, model: &mut ModelCorner, component: usize, response: Response, table: &[Amplitude]) {
        let shape: Vec<f64> = model.parameters.iter().map(|p| p.value).collect();
        model.fitted_ent = table.iter().map(|row| model.dc_ent * response.value(row.frequency_hz, &shape)).collect();
        let residuals = table.iter().zip(&model.fitted_ent).map(|(row, fitted)| row.amplitude_ent[component] - fitted);
        model.residual_ent = residuals.collect();
        let weight = |place: &Option<(usize, [bool; 3])>| match place {
            Some((group, belongs)) if belongs[component] => model.weight[*group],
            _ => 0.0,
        };
        model.weight = self.places.iter().map(weight).collect();
    }
}

/// Which amplitudes of a group do not stand out.
fn inliers(amplitudes: &[f64]) -> Vec<bool> {
    let mut finite: Vec<f64> = amplitudes.iter().copied().filter(|a| a.is_finite()).collect();
    if finite.is_empty() {
        return vec![false; amplitudes.len()];
    }
    let middle = median(&mut finite);
    let usual = median(&mut finite.iter().map(|a| (a - middle).abs()).collect::<Vec<f64>>());
    amplitudes.iter().map(|a| (a - middle).abs() <= OUTSTANDING * usual).collect()
}

/// Amplitude at the middle, of pairs of a distance from it in logarithms of the frequency and an amplitude, and its variance for those of
/// unit variance: by a parabola where the rows tell one, by the mean where they are few or of one frequency.
fn at_middle(own: &[(f64, f64)]) -> (f64, f64) {
    let count = own.len() as f64;
    let mean = || (own.iter().map(|(_, a)| a).sum::<f64>() / count, 1.0 / count);
    let half = own.iter().map(|(u, _)| u.abs()).fold(0.0, f64::max);
    if own.len() < LEAST_PARABOLA || half < 1e-9 {
        return mean();
    }
    let columns = DMatrix::from_fn(own.len(), 3, |i, j| (own[i].0 / half).powi(j as i32));
    let Some(inverse) = (columns.transpose() * &columns).try_inverse().filter(|m| m[(0, 0)] < 0.5) else { return mean() };
    let values = DVector::from_fn(own.len(), |i, _| own[i].1);
    ((&inverse * columns.transpose() * values)[0], inverse[(0, 0)])
}
