//! The simple response that describes a run with sines, before anything is missed in it.

use super::candidates::Refined;
use super::model::{EffectTerm, Fit, Model};
use super::problem::APART_AICC;
use super::sines::Sines;
use crate::data::units::COMPONENTS;
use crate::diagnose::DiagnoseError;
use crate::fit::aicc;
use crate::measure::freq::Freq;
use crate::model::effects::EffectRef;
use crate::model::effects::eddy_current_attenuation::{EddyCurrentAttenuation, one_pole};
use crate::model::effects::response_order::{ResponseOrder, two_poles};
use crate::model::response::{RESPONSES, Response};
use rayon::prelude::*;

/// Responses of so many parameters are simple: what is missing beside them is an effect.
const SIMPLE: usize = 2;
/// As many of them, the best by their amplitudes, are fitted.
const BASES: usize = 3;
/// Parts of the field behind poles, and the pole, Hz, with which a response is tried in place of another one.
const PARTS: [f64; 2] = [0.5, 1.0];
const POLE_HZ: f64 = 300.0;

/// The simple response that describes the run best, without any effect.
pub(super) fn base(freq: &Freq, sines: &mut Sines) -> Result<Fit, DiagnoseError> {
    let simple = |name: &str| Response::named(name).filter(|r| r.freedom() <= SIMPLE);
    let mut order: Vec<(f64, Response, [f64; 3])> = freq
        .corner
        .candidates
        .iter()
        .filter_map(|c| Some((c.aicc?, simple(c.model)?, c.f_3db_hz.map(|f| f.unwrap_or(f64::NAN)))))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fits: Vec<(f64, Fit)> =
        order.iter().take(BASES).filter_map(|(_, response, corners)| fitted(*response, *corners, freq, sines)).collect();
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = fits.into_iter().next().ok_or(DiagnoseError::NoResponse)?.1;
    let shapes = best.model.shapes(&best.p);
    let settings = sines.clone();
    sines.see_begins(|j, i| best.model.triple(&best.p, &shapes, &settings, j, i));
    if !sines.run.begins_known {
        return Ok(best);
    }
    let known = best.model.fit(&best.p, sines).ok_or(DiagnoseError::NoPhases)?;
    // Where rounded time tags leave the time of the counter open, it is a parameter of the base.
    if sines.run.tags_are_rounded {
        known.with(&EffectTerm::shift(), &[0.0], sines).ok_or(DiagnoseError::NoPhases)
    } else {
        Ok(known)
    }
}

/// AICc and fit of a response whose corners are near the given ones. Beside a notch a logarithm has more than one minimum: what the amplitudes
/// by themselves show is a start as well.
fn fitted(response: Response, corner_hz: [f64; 3], freq: &Freq, sines: &Sines) -> Option<(f64, Fit)> {
    let model = Model { response, terms: Vec::new() };
    let by_amplitudes = freq.corner.components.each_ref().map(|c| {
        let parameters = c.model.iter().flat_map(|m| &m.parameters);
        parameters.map(|p| p.value).collect::<Vec<f64>>()
    });
    let is_the_same = freq.corner.model == Some(response.name) && freq.corner.components.iter().all(|c| c.model.is_some());
    let starts = model.starts(corner_hz).into_iter().chain(is_the_same.then_some(by_amplitudes));
    let fits = starts.filter_map(|shapes| model.fit(&model.start(sines, &shapes), sines));
    let best = fits.min_by(|a, b| a.chi2.total_cmp(&b.chi2))?;
    Some((aicc(best.chi2, best.p.len(), best.residual.len())?, best))
}

/// Where a simple response does not describe the run: another one that does so with an effect, or a rich one without, if it is better than the
/// best so far beyond doubt.
pub(super) fn another_base(freq: &Freq, best: &Refined, sines: &Sines) -> Option<Fit> {
    let corners: [f64; 3] = std::array::from_fn(|i| freq.values.f_3db_igep_hz[i]);
    let known = corners.iter().copied().filter(|c| c.is_finite()).fold(f64::NAN, f64::min);
    let corners = corners.map(|c| if c.is_finite() { c } else { known });
    let all: Vec<(f64, Fit)> = RESPONSES
        .par_iter()
        .filter_map(|response| {
            let (aicc_alone, alone) = fitted(*response, corners, freq, sines)?;
            if response.freedom() > SIMPLE {
                return Some((aicc_alone, alone));
            }
            let all = [true; 3];
            let one = EffectTerm::new(EffectRef::new(&EddyCurrentAttenuation), one_pole(all));
            let two = EffectTerm::new(EffectRef::new(&ResponseOrder), two_poles(all, alone.model.corner_hz(&alone.p)));
            let with = [one, two].into_iter().flat_map(|term| {
                let alone = &alone;
                PARTS.into_iter().filter_map(move |part| alone.with(&term, &[part, POLE_HZ.ln()], sines))
            });
            let least = with.filter_map(|f| aicc(f.chi2, f.p.len(), f.residual.len())).fold(aicc_alone, f64::min);
            Some((least, alone))
        })
        .collect();
    let scale = (best.fit.chi2 / best.fit.dof()).max(1.0);
    let least = all.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let now = aicc(best.fit.chi2, best.fit.p.len(), best.fit.residual.len())?;
    let other = Some(least.1).filter(|f| (now - least.0) / scale > APART_AICC && f.model.response != best.fit.model.response)?;
    if sines.run.begins_known && sines.run.tags_are_rounded {
        other.with(&EffectTerm::shift(), &[0.0], sines)
    } else {
        Some(other)
    }
}

/// The response in words, with its -3 dB frequencies.
pub(super) fn response_words(fit: &Fit, sines: &Sines) -> String {
    let shapes = fit.model.shapes(&fit.p);
    let response = fit.model.response;
    let all: Vec<String> = (0..3)
        .map(|i| {
            let corner = response.corner_hz(&shapes[i]).map_or_else(|| "none".to_owned(), |c| format!("{c:.3} Hz"));
            format!("{} {corner}", COMPONENTS[i])
        })
        .collect();
    format!(
        "{}, -3 dB at {}; chi²/dof {:.2} over {} settings",
        response.name,
        all.join(", "),
        fit.chi2 / fit.dof(),
        sines.list.len()
    )
}
