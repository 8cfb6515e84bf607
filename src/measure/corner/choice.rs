//! Which response describes all components best, and whether known noise explains what it leaves.

use super::fit::{Outcome, is_likely};
use super::prepared::Prepared;
use super::refusal::Refusal;
use super::result::{Candidate, Explained};
use crate::model::response::Response;
use rayon::prelude::*;

/// The fits of one response to every component there is.
pub(super) type PerComponent = [Option<Result<Outcome, Refusal>>; 3];

/// The same of every response.
pub(super) type Fits = Vec<PerComponent>;

/// Fits every response to every component.
pub(super) fn fit_all(
    responses: &[Response],
    prepared: &[Result<Prepared, Refusal>; 3],
    fit: impl Fn(&Prepared, Response) -> Result<Outcome, Refusal> + Sync,
) -> Fits {
    let each = |response: &Response| std::array::from_fn(|c| prepared[c].as_ref().ok().map(|prepared| fit(prepared, *response)));
    responses.par_iter().map(each).collect()
}

/// The fits of all responses with known standard deviations.
pub(super) struct Known {
    pub fits: Fits,
    pub totals: Vec<Option<f64>>,
}

impl Known {
    /// `None` where a standard deviation is not known.
    pub fn of(responses: &[Response], prepared: &[Result<Prepared, Refusal>; 3]) -> Option<Self> {
        let mut present = prepared.iter().flatten().peekable();
        present.peek()?;
        if !present.all(|prepared| prepared.data.std.iter().all(|std| *std > 0.0)) {
            return None;
        }
        let fits = fit_all(responses, prepared, Prepared::known_fit);
        let totals = fits.iter().map(total_aicc).collect();
        Some(Self { fits, totals })
    }
}

/// What a response leaves, if that is no more than the known standard deviations let expect.
pub(super) fn explained(fit: &PerComponent, prepared: &[Result<Prepared, Refusal>; 3]) -> Option<Explained> {
    let mut explained = Explained { chi_square: 0.0, dof: 0 };
    for (prepared, outcome) in prepared.iter().flatten().zip(fit.iter().flatten().flatten()) {
        if !prepared.explains(outcome) {
            return None;
        }
        explained.chi_square += outcome.found.deviance;
        explained.dof += outcome.found.solution.dof;
    }
    is_likely(explained.chi_square, explained.dof).then_some(explained)
}

/// AICc summed over the components that are there; `None` where the response does not fit to one of them.
pub(super) fn total_aicc(fit: &PerComponent) -> Option<f64> {
    fit.iter().flatten().try_fold(0.0, |sum, fit| Some(sum + fit.as_ref().ok()?.aicc))
}

/// The first of the smallest.
pub(super) fn least(totals: &[Option<f64>]) -> Option<usize> {
    let present = totals.iter().enumerate().filter_map(|(m, total)| total.map(|total| (m, total)));
    present.min_by(|a, b| a.1.total_cmp(&b.1)).map(|(m, _)| m)
}

/// That no response fits to all components, with the first reason.
pub(super) fn no_model(fits: &[PerComponent]) -> Refusal {
    let why = fits.iter().flatten().flatten().find_map(|fit| fit.as_ref().err());
    Refusal::NoModel { why: why.map_or_else(String::new, ToString::to_string) }
}

/// Every response that was tried, in the order given; without `any` component there is nothing to choose by.
pub(super) fn candidates(responses: &[Response], fits: &[PerComponent], totals: &[Option<f64>], any: bool) -> Vec<Candidate> {
    let candidate = |((response, fit), total): ((&Response, &PerComponent), &Option<f64>)| Candidate {
        model: response.name,
        aicc: total.filter(|_| any),
        component_aicc: std::array::from_fn(|c| fit[c].as_ref()?.as_ref().ok().map(|outcome| outcome.aicc)),
        f_3db_hz: std::array::from_fn(|c| fit[c].as_ref()?.as_ref().ok().map(|outcome| outcome.corner_hz)),
        refusal: fit.iter().flatten().find_map(|fit| fit.as_ref().err().cloned()),
    };
    responses.iter().zip(fits).zip(totals).map(candidate).collect()
}
