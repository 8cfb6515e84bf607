//! Displaced edges: data and settings that step at different times.

use super::{Inside, interval_s};
use crate::data::plateau::Displacement;
use crate::model::effects::EffectRef;
use crate::model::effects::time_shift::{self, TimeShift};
use crate::record::prepared::{PreparedRun, Samples};

/// Least part of a setting that shows another level, in samples: one sample of it is what the low-pass of every sensor and the place of the samples
/// between the edges make.
const LEAST: f64 = 1.1;
/// Least displacement in standard uncertainties by the scatter of the edges.
const SIGNIFICANT: f64 = 6.0;

/// Whether data and settings step at different times.
#[must_use]
pub fn displaced(prepared: &PreparedRun, samples: &Samples) -> Option<Inside> {
    let interval_s = interval_s(samples)?;
    let Displacement { shift_s, std_s, scatter_s, shown_s, .. } = prepared.displacement?;
    let strength = shift_s.abs() / scatter_s;
    (shown_s > LEAST * interval_s && strength > SIGNIFICANT).then(|| Inside {
        values: vec![(1.0, std_s / shift_s.abs())],
        shape_std: vec![(time_shift::SHIFT.to_owned(), std_s)],
        strength,
        p_value: (-0.5 * strength * strength).exp().max(f64::MIN_POSITIVE),
        trials: 1,
        ..Inside::new(EffectRef::new(&TimeShift), time_shift::edges(shift_s))
    })
}
