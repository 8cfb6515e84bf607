//! What was not found between runs: what they cannot show, and how small an effect they would have shown.

use super::problem::Comparison;
use super::run_set::RunCandidate;
use crate::data::units::{COMPONENTS, three_digits};
use crate::diagnose::result::{DetectionLimit, NotIdentifiable, Step};
use crate::diagnose::{FOUND_90, SHOWN};
use crate::fit::scan::{Fitted, Group};
use crate::model::effects::EffectRef;

/// Smallest effects that would have been found; what cannot be shown goes to `none`.
pub(super) fn limits(
    comparison: &Comparison,
    fitted: &Fitted,
    scales: &[f64; 3],
    steps: &[Step],
    none: &mut Vec<NotIdentifiable>,
) -> Vec<DetectionLimit> {
    let (set, n) = (&comparison.set, comparison.set.count());
    let mut limits = Vec::new();
    let mut effects: Vec<EffectRef> = comparison.candidates.iter().map(|c| c.effect).filter(|e| !e.is_unknown()).collect();
    effects.dedup();
    for effect in effects.into_iter().filter(|effect| steps.iter().all(|s| s.effect != *effect)) {
        let own: Vec<&RunCandidate> = comparison.candidates.iter().filter(|c| c.effect == effect).collect();
        let groups: Vec<Group> = own.iter().map(|c| set.group(fitted, c)).collect();
        if groups.iter().all(|g| g.surviving < SHOWN) {
            none.push(NotIdentifiable::absorbed(effect, groups.iter().map(|g| g.surviving)));
            continue;
        }
        for axis in 0..3 {
            let best = own
                .iter()
                .zip(&groups)
                .filter(|(c, g)| c.spec.axes == [axis] && c.columns.ncols() == 1 && g.surviving >= SHOWN)
                .map(|(c, g)| {
                    let class = (0..3).find(|k| c.columns.rows(k * 3 * n, 3 * n).norm() > 0.0).unwrap_or(0);
                    let least = FOUND_90 * scales[class] / g.norms[0];
                    let size = (0..9 * n)
                        .map(|row| c.columns[(row, 0)].abs() * set.runs[(row / 3) % n].nt_per_unit(class))
                        .fold(0.0, f64::max);
                    (least * size, least, *c)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((amplitude_nt, least, c)) = best {
                let (name, unit) = &c.parameters[0];
                limits.push(DetectionLimit {
                    effect,
                    axis: COMPONENTS[axis].to_owned(),
                    amplitude_nt,
                    parameter: format!("{name} = {} {unit}", three_digits(least)).trim_end().to_owned(),
                });
            }
        }
    }
    limits
}
