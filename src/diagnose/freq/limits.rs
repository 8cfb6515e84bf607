//! What was not found in sines: what a run cannot show, and how small an effect it would have shown.

use super::candidates::{Scored, ScoredTerm};
use super::sines::{SineOf, Sines};
use crate::diagnose::FOUND_90;
use crate::diagnose::result::{DetectionLimit, NotIdentifiable, Step};
use crate::fit::statistics::median;
use crate::model::effects::{Catalogue, EffectRef};

/// What cannot be shown, and how small an effect of the rest would have been found.
pub(super) fn limits(
    scored: &Scored,
    sines: &Sines,
    steps: &[Step],
    catalogue: &Catalogue,
) -> (Vec<NotIdentifiable>, Vec<DetectionLimit>) {
    let found = |effect: EffectRef| steps.iter().any(|s| s.effect == effect);
    let none = catalogue
        .iter()
        .filter(|effect| !found(*effect))
        .filter_map(|effect| Some(NotIdentifiable { effect, reason: effect.unseen_in_sines(&sines.run)?.to_string() }))
        .collect();
    let mut limits = Vec::new();
    for effect in scored.effects() {
        if found(effect) {
            continue;
        }
        let is_one = |e: &&ScoredTerm| e.term.axes().len() == 3 && e.base.ncols() == 1 && e.term.has_limit();
        let own = scored.terms.iter().filter(|e| e.term.effect == effect).filter(is_one);
        let Some(best) = own.max_by(|a, b| a.norm.total_cmp(&b.norm)) else { continue };
        let least = FOUND_90 / best.norm;
        let (parameter, timing) = (best.term.limit(&sines.run, least, best.hz), best.term.is_of_timing());
        let noise = |s: &SineOf| s.tones[0].std[usize::from(timing)] * s.tones[0].log_amplitude.exp();
        let noise_nt = median(&mut sines.list.iter().map(noise).collect::<Vec<f64>>());
        limits.push(DetectionLimit {
            effect,
            axis: "x, y, z".to_owned(),
            // Of a part that is spread over all settings as the noise is.
            amplitude_nt: FOUND_90 * noise_nt / (sines.list.len() as f64).sqrt(),
            parameter,
        });
    }
    (none, limits)
}
