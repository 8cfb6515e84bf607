//! What was not found in one run: what it cannot show, how small an effect it would have shown, and drifts that slow noise explains as well.

use super::candidate::Candidate;
use super::means::{Means, MeansModel};
use super::result::{DetectionLimit, NotIdentifiable, Step};
use super::{FOUND_90, SHOWN};
use crate::data::note::{Note, NoteKind};
use crate::data::units::{COMPONENTS, three_digits};
use crate::model::effects::offset_drift::OffsetDrift;
use crate::model::effects::{Catalogue, EffectRef};

/// From this many standard deviations on a drift beside white noise is reported.
const HIDDEN: f64 = 4.0;

/// What cannot be shown, and how small an effect of the rest would have been found.
pub(super) fn limits(
    means: &Means,
    model: &MeansModel,
    steps: &[Step],
    catalogue: &Catalogue,
) -> (Vec<NotIdentifiable>, Vec<DetectionLimit>) {
    let found = |effect: EffectRef| steps.iter().any(|s| s.effect == effect);
    let mut none: Vec<NotIdentifiable> = means
        .absent
        .iter()
        .filter(|a| !found(a.effect))
        .map(|a| NotIdentifiable { effect: a.effect, reason: a.reason.to_string() })
        .collect();
    let groups = means.groups(model);
    let n = means.prepared.readings.nrows();
    let mut limits = Vec::new();
    for effect in catalogue.iter().filter(|e| !found(*e)) {
        let own: Vec<usize> = (0..means.candidates.len()).filter(|i| means.candidates[*i].effect == effect).collect();
        if own.is_empty() {
            continue;
        }
        if own.iter().all(|i| groups[*i].surviving < SHOWN) {
            none.push(NotIdentifiable::absorbed(effect, own.iter().map(|i| groups[*i].surviving)));
            continue;
        }
        for axis in 0..3 {
            let best = own
                .iter()
                .filter(|i| {
                    means.candidates[**i].spec.axes == [axis]
                        && means.candidates[**i].columns.ncols() == 1
                        && groups[**i].surviving >= SHOWN
                })
                .map(|i| {
                    let least = FOUND_90 / groups[*i].norms[0];
                    let size = (0..3)
                        .map(|a| means.candidates[*i].columns.rows(a * n, n).amax() * means.prepared.nt_per_ent[a])
                        .fold(0.0, f64::max);
                    (least * size, least, *i)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((amplitude_nt, least, i)) = best {
                let (name, unit) = &means.candidates[i].parameters[0];
                limits.push(DetectionLimit {
                    effect,
                    axis: COMPONENTS[axis].to_owned(),
                    amplitude_nt,
                    parameter: format!("{name} = {} {unit}", three_digits(least)),
                });
            }
        }
    }
    none.sort_by_key(|n| n.effect.as_str());
    (none, limits)
}

/// Drifts that would be clear beside white noise and that the slow noise explains as well.
pub(super) fn hidden_drifts(means: &Means, model: &MeansModel, all: &[&Candidate], steps: &[Step]) -> Vec<Note> {
    let noise = model.noise.parameters;
    if noise.slow == 0.0 {
        return Vec::new();
    }
    let Some(drifts) = means.drifts(all) else { return Vec::new() };
    let order = means.prepared.record.trend_order + 1;
    let named = |axis: &str| steps.iter().any(|s| s.effect.is(&OffsetDrift) && s.axes.iter().any(|a| a == axis));
    (0..3)
        .filter(|a| drifts[*a].0.abs() > HIDDEN * drifts[*a].1 && !named(COMPONENTS[*a]))
        .map(|a| {
            let (c, std) = drifts[a];
            let text = format!(
                "the offset of {} drifts in order {order} of time, p{order} = {:+.3} nT, {:.1} times its standard deviation beside white noise; the \
                 slow noise of this run, {:.1} times the white variance of a mean, makes as much, so that no effect is named",
                COMPONENTS[a],
                c * means.prepared.nt_per_ent[a],
                c.abs() / std,
                noise.slow
            );
            Note::new(NoteKind::Method, text).about(COMPONENTS[a])
        })
        .collect()
}
