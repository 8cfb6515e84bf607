//! The -3 dB corner of the AC response from a table of amplitudes, in two ways (docs/mathematics.md, "Frequency response").
//!
//! * **igep**, as in the printed tables of 2013: the level in dB relative to the largest amplitude, and a straight line in (f, dB)
//!   between the two neighbours of -3 dB (not of `1/√2`, which is 0.01 dB lower and 0.08 Hz further up). Low readings cross that
//!   level several times: the crossing is the last one, found from the high frequencies.
//! * **model**: the response of [`RESPONSES`] with the least AICc, summed over the components, and where it has fallen to `1/√2` of
//!   its DC gain.
//!
//! # Errors of the amplitudes
//!
//! The data decide between two treatments, for all components together:
//!
//! * **known noise**: every amplitude has its standard deviation, as amplitudes of waveforms do, and the best response leaves no more
//!   than they let expect: chi-square below its 99.99 % quantile and no residual beyond five standard deviations. Then
//!   weighted least squares is efficient, and its linearised covariance is the uncertainty. Chi-square above its 99 % quantile widens
//!   it by `sqrt(chi-square / dof)` and Student's factor. [`Corner::explained`] tells that it was so.
//! * **scatter**: otherwise, and for tables without standard deviations, what follows.
//!
//! None of the responses describes a printed table within its noise. What the best leaves in the tables of 2013 is 0.1 to 0.4 % of the
//! DC amplitude down to -10 dB and 5 to 7 % below, where the lobes of a digital filter are not those of the textbook; and stretches
//! with lost samples give amplitudes that are far too low. Residuals are therefore taken in amplitude, not in its logarithm, and
//! the fit ([`crate::fit::contaminated`]) estimates one scatter above -10 dB, another one of at least 5 % of DC below, and the probability
//! that a row belongs at all. Given standard deviations add to that scatter. The lobes thus choose between responses that do equally well
//! at the corner, and do not move it: with a free scatter the fits of x and y of 13-04-03-12-59-48 follow the lobes, call the good
//! reading at 100 Hz an outlier, and have the corner 0.2 and 0.5 Hz further up.
//!
//! # Uncertainty of the second treatment
//!
//! What a response leaves is systematic: the linearised covariance takes it for noise of independent rows, and knows nothing of the
//! choice of the model. The jackknife leaves one amplitude out at a time, chooses again, and has both in its spread,
//! `sqrt((n-1)/n Σ (θ_i - mean)²)`; but with few rows around the corner it may come out too small by chance. The larger of the two
//! is given. By its construction hardly any single amplitude can move the corner by more than one standard deviation.
//!
//! Neither knows of several rows that are missing together. Where lost samples spoil most of the rows around the corner, another
//! response may fit what is left: [`ModelCorner::neighbours_left_out`] counts them.
//!
//! # Drift
//!
//! Amplitudes with known noise and times are described with a drift of the gain or of the field beside every response as well. Where
//! the drift is the better description by far, the response that stands with it is the answer. Where it does about as well as the responses
//! alone, what it would do to f_3dB is in the uncertainty. [`Corner::drift`] has both.

mod choice;
mod course;
mod describe;
mod drift;
mod fit;
mod igep;
mod jackknife;
mod prepared;
mod refusal;
mod result;
mod rows;
#[cfg(test)]
mod tests;
mod thin;

pub use igep::igep_corner_hz;
pub(super) use prepared::DECIDING;
pub use refusal::Refusal;
pub use result::{AmplitudeDrift, Candidate, Component, Corner, Explained, Fitted, ModelCorner};
pub use rows::Amplitude;

use crate::model::response::{RESPONSES, Response};
use choice::{Known, candidates, explained as explained_by, fit_all, least, no_model, total_aicc};
use describe::describe;
use drift::drifting;
use jackknife::{Replicate, groups, without};
use prepared::Prepared;
use rayon::prelude::*;
use rows::{detected, usable};
use thin::Thin;

/// Responses whose AICc exceeds the least by no more stay in the choice when a row is left out.
const CONTENDERS: f64 = 30.0;

/// How the corner is found.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// The responses to choose from.
    pub responses: Vec<Response>,
    /// Leave out one row at a time where known noise does not explain the amplitudes. Without, standard deviations are those of the
    /// linearised covariance, which are too small for tables that no response describes.
    pub jackknife: bool,
}

impl Default for Options {
    fn default() -> Self {
        Self { responses: RESPONSES.to_vec(), jackknife: true }
    }
}

/// Finds the corner of all components.
///
/// Never fails as a whole: a component without an answer says why. Rows may come in any order. Neighbouring rows of a long table are taken
/// together first, so that the time grows with the rows and no faster.
#[must_use]
pub fn corner(table: &[Amplitude], options: &Options) -> Corner {
    let Some(thin) = Thin::of(table) else { return short(table, options) };
    let mut corner = short(&thin.rows, options);
    let response = options.responses.iter().find(|r| Some(r.name) == corner.model);
    for (c, component) in corner.components.iter_mut().enumerate() {
        let is_undetected = |row: &Amplitude| row.amplitude_ent[c].is_finite() && !detected(row, c);
        component.undetected = table.iter().map(is_undetected).collect();
        if let (Some(model), Some(response)) = (&mut component.model, response) {
            thin.spread(model, c, *response, table);
        }
    }
    corner
}

/// Finds the corner from all rows one by one.
fn short(table: &[Amplitude], options: &Options) -> Corner {
    let responses = &options.responses;
    let prepared: [Result<Prepared, Refusal>; 3] = std::array::from_fn(|c| Prepared::new(table, c, &[]));
    let known = Known::of(responses, &prepared);
    let drifting = known.as_ref().and_then(|known| drifting(responses, &prepared, known));
    let drift = drifting.as_ref().map(|found| AmplitudeDrift::of(responses[found.response].name, found, &prepared));
    let described = known.and_then(|Known { mut fits, mut totals }| {
        if let Some(found) = drifting.filter(|drifting| drifting.is_found) {
            fits[found.response] = found.fit;
            totals[found.response] = Some(found.total);
            return Some((fits, totals, Some(found.response), Some(found.explained)));
        }
        let best = least(&totals)?;
        let explained = explained_by(&fits[best], &prepared)?;
        Some((fits, totals, Some(best), Some(explained)))
    });
    let (fits, totals, chosen, explained) = described.unwrap_or_else(|| {
        let fits = fit_all(responses, &prepared, Prepared::fit);
        let totals: Vec<Option<f64>> = fits.iter().map(total_aicc).collect();
        let best = least(&totals);
        (fits, totals, best, None)
    });
    let any = prepared.iter().any(Result::is_ok);
    let chosen = chosen.filter(|_| any);

    let contenders: Vec<usize> = match chosen.and_then(|best| totals[best]) {
        Some(best) => (0..fits.len()).filter(|&m| totals[m].is_some_and(|aicc| aicc <= best + CONTENDERS)).collect(),
        None => Vec::new(),
    };
    let mut rows: Vec<usize> = prepared.iter().flatten().flat_map(|prepared| prepared.rows.iter().copied()).collect();
    rows.sort_unstable();
    rows.dedup();
    let replicates: Vec<Replicate> = match chosen {
        Some(chosen) if options.jackknife && explained.is_none() => {
            groups(&rows).par_iter().map(|rows| without(table, rows, responses, &prepared, &fits, &contenders, chosen)).collect()
        }
        _ => Vec::new(),
    };

    let components = std::array::from_fn(|c| {
        let undetected: Vec<bool> = table.iter().map(|row| row.amplitude_ent[c].is_finite() && !detected(row, c)).collect();
        let points: Vec<(f64, f64)> = usable(table, c, &[])
            .into_iter()
            .filter(|&i| detected(&table[i], c))
            .map(|i| (table[i].frequency_hz, table[i].amplitude_ent[c]))
            .collect();
        let igep = igep_corner_hz(&points);
        let model = match (&prepared[c], chosen.and_then(|best| fits[best][c].as_ref().map(|fit| (best, fit)))) {
            (Err(refusal), _) => Err(refusal.clone()),
            (Ok(_), Some((_, Err(refusal)))) => Err(refusal.clone()),
            (Ok(_), None) => Err(no_model(&fits)),
            (Ok(prepared), Some((best, Ok(outcome)))) => {
                let model = describe(table, c, responses[best], prepared, outcome, explained, &replicates);
                Ok(match &drift {
                    Some(drift) => drift.widen(model, c),
                    None => model,
                })
            }
        };
        Component {
            f_3db_igep_hz: igep.as_ref().ok().copied(),
            igep_refusal: igep.err(),
            model: model.as_ref().ok().cloned(),
            model_refusal: model.err(),
            undetected,
        }
    });
    let candidates = candidates(responses, &fits, &totals, any);
    Corner { model: chosen.map(|best| responses[best].name), explained, drift, components, candidates }
}
