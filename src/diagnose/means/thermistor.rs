//! A jump of the thermistor that its readings have room for, in place of something that begins at a time: the model of a sweep is a polynomial of what
//! it reads, and moves with it.

use super::chosen::Chosen;
use crate::diagnose::APART;
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::RunnerUp;
use crate::model::effects::bad_thermistor::{self, BadThermistor};
use crate::model::effects::{EffectRef, Spec};
use crate::record::temperature_faults::may_jump;

/// Settings, or readings of the thermistor, on either side of the onset among which a jump has room.
const NEAR: f64 = 2.0;

/// The jump at the onset of a term, where the thermistor's readings have room for one of the size that the readings of the sensor ask for and it describes
/// these as well; with `others` in the model.
pub(super) fn rival(chosen: &Chosen, others: &[&Candidate]) -> Option<(EffectRef, RunnerUp)> {
    let Chosen { means, without, candidate, .. } = *chosen;
    let prepared = means.prepared;
    let onset_s = candidate.effect.begins_s(&candidate.spec)?;
    let effect = EffectRef::new(&BadThermistor);
    let column = bad_thermistor::jump(&prepared.record, onset_s)?;
    let jump = Candidate::of_readings(effect, Spec::new(bad_thermistor::JUMP, &[0, 1, 2]), vec![column]);
    let rival = chosen.rival(&jump, 1).filter(|r| r.log_ratio > -APART)?;
    let with: Vec<&Candidate> = others.iter().copied().chain([&jump]).collect();
    let (size_k, std_k) = *means.estimates(&means.model_with(without.noise.clone(), &with), &with)?.last()?.first()?;
    let readings = &prepared.thermistor;
    let interval_s = |count: usize| (prepared.record.span_s[1] - prepared.record.span_s[0]) / count.max(2) as f64;
    let near_s = NEAR * interval_s(means.rows()).max(interval_s(readings.len()));
    let mut near = readings.iter().filter(|(t_s, _)| (t_s - onset_s).abs() <= near_s);
    let has_room = near.any(|(t_s, _)| may_jump(readings, *t_s, [size_k, std_k]));
    has_room.then_some((effect, rival))
}
