//! The corner of one component with its uncertainties, from the fit of the response that was chosen.

use super::fit::Outcome;
use super::jackknife::{Replicate, jackknife};
use super::prepared::{Prepared, relative_times};
use super::result::{Explained, Fitted, ModelCorner};
use super::rows::Amplitude;
use crate::fit::statistics::std_of;
use crate::model::response::Response;
use nalgebra::DVector;

/// Rows next to the corner that do not belong.
fn neighbours_left_out(prepared: &Prepared, outcome: &Outcome) -> usize {
    let above = prepared.frequencies.partition_point(|f| *f < outcome.corner_hz);
    let weights = outcome.found.weights.iter().skip(above.saturating_sub(2)).take(above.min(2) + 2);
    weights.filter(|weight| **weight < 0.5).count()
}

/// The answer for one component.
pub(super) fn describe(
    table: &[Amplitude],
    component: usize,
    response: Response,
    prepared: &Prepared,
    outcome: &Outcome,
    explained: Option<Explained>,
    replicates: &[Replicate],
) -> ModelCorner {
    let covariance = outcome.covariance(&prepared.data, explained);
    let slopes = std::iter::once(0.0).chain(response.corner_slopes(outcome.corner_hz, &outcome.shape));
    // A drift of the amplitudes moves no corner.
    let slopes = slopes.chain(outcome.drift.parameters.iter().map(|_| 0.0)).collect();
    let slopes = DVector::from_vec(slopes);
    let linearised_std_hz = outcome.corner_hz * std_of((slopes.transpose() * &covariance * &slopes)[(0, 0)]);
    let corners: Vec<f64> = replicates.iter().filter_map(|replicate| replicate.corner_hz[component]).collect();
    let jackknife_std_hz = jackknife(&corners);
    let values = outcome.values(prepared.dc);
    let std = |j: usize| {
        let column: Vec<f64> =
            replicates.iter().filter_map(|replicate| replicate.values[component].as_ref()?.get(j).copied()).collect();
        // Of a logarithm: the relative standard deviation.
        (values[j] * std_of(covariance[(j, j)])).max(jackknife(&column))
    };
    let fitted = |(row, time): (&Amplitude, f64)| {
        values[0] * response.value(row.frequency_hz, &outcome.shape) * outcome.drift.factor(time)
    };
    let fitted_ent: Vec<f64> = table.iter().zip(relative_times(table)).map(fitted).collect();
    let residual_ent = table.iter().zip(&fitted_ent).map(|(row, fitted)| row.amplitude_ent[component] - fitted).collect();
    let mut weight = vec![0.0; table.len()];
    prepared.rows.iter().zip(&outcome.found.weights).for_each(|(&row, &w)| weight[row] = w);
    let [fine, coarse] = outcome.scatter(&prepared.data, explained);
    let parameters = response.parameters().into_iter().zip(&outcome.shape).enumerate();
    ModelCorner {
        f_3db_model_hz: outcome.corner_hz,
        f_3db_model_std_hz: linearised_std_hz.max(jackknife_std_hz),
        linearised_std_hz,
        jackknife_std_hz,
        neighbours_left_out: neighbours_left_out(prepared, outcome),
        jackknife_rows: corners.len(),
        dc_ent: values[0],
        dc_std_ent: std(0),
        parameters: parameters.map(|(j, (parameter, &value))| Fitted { parameter, value, std: std(j + 1) }).collect(),
        residual_std_ent: prepared.dc * fine,
        stop_residual_std_ent: prepared.dc * coarse,
        fitted_ent,
        residual_ent,
        weight,
    }
}
