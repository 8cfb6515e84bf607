//! An amplitude of the field, or a gain, that drifts while one frequency after the other is applied.
//!
//! Where the frequencies follow each other from low to high or back, time is the frequency under another name: responses of more parameters take a
//! drift of some 1e-4 for what they do with frequency, and nothing is left that would tell. Every response is therefore fitted beside a drift as well, a polynomial
//! of the time, or the approach of something that warms up, in the logarithm of the amplitude of every component. A drift needs evidence beside the response that it stands with; it is found
//! where it describes the amplitudes better than all responses do without, and possible where it does about as well.

use super::choice::{Known, PerComponent, explained, least, total_aicc};
use super::course::Form;
use super::prepared::Prepared;
use super::refusal::Refusal;
use super::result::Explained;
use crate::fit::aicc;
use crate::model::response::Response;

/// A hypothesis whose AICc is lower by this much is a hundred times as likely.
const CLEAR: f64 = 9.2;
/// Drifts that are fitted: the most promising responses, each with its best form.
const FITTED: usize = 6;

/// A drift beside a response.
pub(super) struct Drifting {
    /// Index of the response.
    pub response: usize,
    /// Its fits with the drift.
    pub fit: PerComponent,
    /// Their AICc.
    pub total: f64,
    /// What they leave.
    pub explained: Explained,
    /// Whether it describes the amplitudes far better than the best response alone does.
    pub is_found: bool,
    /// Fits of other responses beside a drift that are about as likely.
    pub others: Vec<PerComponent>,
}

/// The likeliest drift that known noise explains what it leaves of, that has evidence beside its response and is at least about as likely as the best
/// response alone; `None` without one.
pub(super) fn drifting(responses: &[Response], prepared: &[Result<Prepared, Refusal>; 3], still: &Known) -> Option<Drifting> {
    if prepared.iter().flatten().any(|p| p.times.iter().any(|t| !t.is_finite())) {
        return None;
    }
    let at_best = least(&still.totals).filter(|best| explained(&still.fits[*best], prepared).is_some());
    let at_best = at_best.and_then(|best| still.totals[best]).unwrap_or(f64::INFINITY);
    let mut promising: Vec<(f64, usize, Form)> = Vec::new();
    for (m, (response, fit)) in responses.iter().zip(&still.fits).enumerate() {
        let of_form = |form: Form| Some((expected(*response, form, fit, prepared)?, m, form));
        let best = Form::all().filter_map(of_form).min_by(|a, b| a.0.total_cmp(&b.0));
        promising.extend(best.filter(|(expected, ..)| still.totals[m].is_some_and(|own| expected + CLEAR < own)));
    }
    promising.sort_by(|a, b| a.0.total_cmp(&b.0));
    let fitted = promising.into_iter().take(FITTED).filter_map(|(_, m, form)| {
        let again = |c: usize| {
            let (still, prepared) = (still.fits[m][c].as_ref()?.as_ref().ok()?, prepared[c].as_ref().ok()?);
            Some(prepared.drifting_fit(responses[m], form, still))
        };
        let fit: PerComponent = std::array::from_fn(again);
        let (total, explained) = (total_aicc(&fit)?, explained(&fit, prepared)?);
        let is_likely = still.totals[m].is_some_and(|own| total + CLEAR < own) && total < at_best + CLEAR;
        let is_found = total + CLEAR < at_best;
        is_likely.then_some(Drifting { response: m, fit, total, explained, is_found, others: Vec::new() })
    });
    let mut fitted: Vec<Drifting> = fitted.collect();
    fitted.sort_by(|a, b| a.total.total_cmp(&b.total));
    let mut fitted = fitted.into_iter();
    let best = fitted.next()?;
    let most = best.total + CLEAR;
    Some(Drifting { others: fitted.filter(|other| other.total < most).map(|other| other.fit).collect(), ..best })
}

/// AICc that a response is to have beside a drift; `None` where it does not fit to a component alone or has too few rows.
fn expected(response: Response, form: Form, fit: &PerComponent, prepared: &[Result<Prepared, Refusal>; 3]) -> Option<f64> {
    let mut sum = 0.0;
    for (outcome, prepared) in fit.iter().flatten().zip(prepared.iter().flatten()) {
        let outcome = outcome.as_ref().ok()?;
        // Without a value there are too few rows for so many parameters.
        let penalty = aicc(0.0, outcome.found.state.parameters.len() + form.count(), prepared.rows.len())?;
        sum += outcome.found.deviance - prepared.drift_takes(response, form, outcome).0 + penalty;
    }
    Some(sum)
}
