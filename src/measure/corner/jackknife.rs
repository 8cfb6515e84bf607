//! Choice and fit repeated without one row at a time, or without one group of rows where there are many.

use super::choice::{PerComponent, least, total_aicc};
use super::fit::Outcome;
use super::prepared::Prepared;
use super::refusal::Refusal;
use super::rows::Amplitude;
use crate::model::response::Response;

/// Most repetitions: beyond, rows are left out in groups, each of which holds one row of so many in turn. Of tables so long that the
/// repetitions would take minutes there are fewer, at least so many that they tell a standard deviation within an eighth.
const MOST_REPLICATES: usize = 256;
const LEAST_REPLICATES: usize = 32;
/// Rows in all repetitions together that may count.
const MOST_ROWS: usize = 16_000;

/// The rows that are left out together, each once, ascending; `rows` ascend.
pub(super) fn groups(rows: &[usize]) -> Vec<Vec<usize>> {
    let affordable = (MOST_ROWS / rows.len().max(1)).clamp(LEAST_REPLICATES, MOST_REPLICATES);
    let count = rows.len().min(affordable);
    (0..count).map(|first| rows.iter().copied().skip(first).step_by(count).collect()).collect()
}

/// What is left when rows are left out: corner of the response then best, and parameters of the one chosen with all rows.
pub(super) struct Replicate {
    pub corner_hz: [Option<f64>; 3],
    pub values: [Option<Vec<f64>>; 3],
}

/// Repeats choice and fit without some rows.
pub(super) fn without(
    table: &[Amplitude],
    rows: &[usize],
    responses: &[Response],
    all: &[Result<Prepared, Refusal>; 3],
    fits: &[PerComponent],
    contenders: &[usize],
    chosen: usize,
) -> Replicate {
    let prepared: [Option<Prepared>; 3] = std::array::from_fn(|c| {
        fits[chosen][c].as_ref()?;
        Prepared::new(table, c, rows).ok()
    });
    let refit = |m: usize, c: usize| -> Option<Result<Outcome, Refusal>> {
        let full = fits[m][c].as_ref()?.as_ref().ok()?;
        let fitted = match &prepared[c] {
            Some(prepared) => {
                let mut state = full.found.state.clone();
                // Relative to the first guess of the DC amplitude, which moves with the rows.
                let whole = all[c].as_ref().ok()?;
                state.parameters[0] += (whole.dc / prepared.dc).ln();
                prepared.continued(responses[m], &state)
            }
            None => Err(Refusal::NoAmplitude),
        };
        Some(fitted)
    };
    let again: Vec<PerComponent> = contenders.iter().map(|&m| std::array::from_fn(|c| refit(m, c))).collect();
    let totals: Vec<Option<f64>> = again.iter().map(total_aicc).collect();
    let best = least(&totals);
    let same = contenders.iter().position(|&m| m == chosen);
    let outcome = |m: Option<usize>, c: usize| again.get(m?)?[c].as_ref()?.as_ref().ok();
    Replicate {
        corner_hz: std::array::from_fn(|c| outcome(best, c).map(|outcome| outcome.corner_hz)),
        values: std::array::from_fn(|c| Some(outcome(same, c)?.values(prepared[c].as_ref()?.dc))),
    }
}

/// Standard deviation of the jackknife, NaN for fewer than two replicates.
pub(super) fn jackknife(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    if values.len() < 2 {
        return f64::NAN;
    }
    let mean = values.iter().sum::<f64>() / n;
    ((n - 1.0) / n * values.iter().map(|value| (value - mean).powi(2)).sum::<f64>()).sqrt()
}
