//! What a run shows beside the means of its plateaus that no effect explains: it is told, names that it speaks against are no longer certain, and
//! where the means leave nothing it is what is left.

use super::result::{Left, Step};
use super::samples::{self, AroundMeans, Inside};
use super::steps::acts_on;
use super::words;
use crate::data::note::Note;
use crate::data::plateau::Plateaus;
use crate::model::effects::settling::Settling;
use crate::model::effects::time_shift::TimeShift;
use crate::model::effects::{Covariate, EffectRef, Family, Record};
use crate::record::prepared::{PreparedRun, Samples};

/// What stands beside the means.
#[derive(Default)]
pub(super) struct Beside {
    /// What is left in the samples that is more than their noise.
    pub left: Option<Left>,
    /// Whether the readings still follow the step before a setting in what is used of it.
    follows: bool,
    /// Whether some edges of the settings stand elsewhere than the others.
    is_apart: bool,
    /// Components that rest at an end of their range.
    at_end: [bool; 3],
    /// Components that stand still for a while.
    still: [bool; 3],
    /// Whether parts of a periodic signal were left out of the means as spikes: what is taken off the means is then not what is in them.
    is_cut: bool,
}

impl Beside {
    /// Of a run whose samples are given as they were recorded, and without what the temperature moves; `inside` is what they show and `around` what periodic
    /// signals leave of them. Notes say what was seen.
    pub fn of(
        prepared: &PreparedRun,
        [recorded, steady]: [Option<&Samples>; 2],
        plateaus: &Plateaus,
        inside: &[Inside],
        around: Option<&AroundMeans>,
        notes: &mut Vec<Note>,
    ) -> Self {
        let mut beside = Self { follows: plateaus.still_follows.is_some(), ..Self::default() };
        let (Some(recorded), Some(steady)) = (recorded, steady) else { return beside };
        // What makes the most of what follows useless comes first.
        let mut left: Vec<Left> = Vec::new();
        if let Some(cut) = samples::cut(plateaus, inside) {
            beside.is_cut = true;
            notes.push(cut);
        }
        let narrow = || around.and_then(|around| samples::narrow(prepared, steady, around));
        let narrow = if prepared.record.has_fields() {
            let noise_ent = samples::usual_std(recorded, &prepared.windows);
            let of_edges = || samples::apart(prepared, recorded, plateaus, noise_ent);
            let (at_end, (apart, narrow)) =
                rayon::join(|| samples::at_end(recorded, plateaus, noise_ent), || rayon::join(of_edges, narrow));
            for end in at_end {
                beside.at_end[end.axis] = true;
                notes.push(end.note());
            }
            if let Some(apart) = apart {
                beside.is_apart = true;
                notes.push(apart.note());
                left.push(apart.left(prepared));
            }
            narrow
        } else {
            for still in samples::still(recorded) {
                beside.still[still.axis] = true;
                notes.push(still.note());
                left.push(still.left(prepared));
            }
            narrow()
        };
        left.extend(narrow);
        beside.left = left.into_iter().next();
        beside
    }

    /// Names that it speaks against are no longer certain.
    pub fn doubt(&self, steps: &mut [Step], record: &Record) {
        for step in steps {
            if self.follows && is_memory(step, record) {
                // What the readings lose of a step while they are used is a memory of it in their means, and a decay of any shape leaves one.
                let settling = EffectRef::new(&Settling);
                if !step.ambiguous_with.contains(&settling) {
                    step.ambiguous_with.push(settling);
                }
                if step.next_measurement.is_none() {
                    step.next_measurement = words::next_measurement(step.effect, &step.ambiguous_with);
                }
                step.doubt();
            } else if step.wording == "is" && self.contradicts(step, record) {
                step.doubt();
            }
        }
    }

    /// Whether what is seen beside the means speaks against a name.
    fn contradicts(&self, step: &Step, record: &Record) -> bool {
        let family = step.effect.about().family;
        if step.effect.is(&TimeShift) {
            // A displacement of all time tags displaces all edges.
            return self.is_apart;
        }
        if family == Family::DataFault {
            return false;
        }
        if self.is_cut && step.effect.in_samples().is_none() {
            return true;
        }
        let acts = acts_on(step, record);
        let meets = |axes: [bool; 3]| (0..3).any(|a| axes[a] && acts[a]);
        // A reading at the end of its range is what a function of the field makes of it; nothing that comes and goes with time is shown by it.
        let is_of_field = matches!(family, Family::StaticOdd | Family::StaticEven | Family::CrossField);
        meets(self.still) || (!is_of_field && meets(self.at_end))
    }
}

/// Whether a step says that means remember the settings before. What was found in the samples is a transient by its own shape.
fn is_memory(step: &Step, record: &Record) -> bool {
    match &step.covariate {
        Some(name) => Covariate::all(record).iter().any(|c| c.name == *name && c.is_of_history()),
        None => step.effect.about().family == Family::History && step.effect.in_samples().is_none(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::diagnose::steps::{Facts, Significance};
    use crate::model::effects::offset_drift::OffsetDrift;
    use crate::model::effects::remanence::{Remanence, of_one_cause};
    use crate::model::effects::{Catalogue, Spec, example, time_shift};

    fn step(effect: EffectRef, form: Spec) -> Step {
        let significance = Significance { p_value: 1e-9, trials: 100, p_value_corrected: 1e-7, strength_k: 25.0 };
        Facts::new(effect, form, significance).step()
    }

    /// The wording of a clear step of an effect, in the example in which it shows.
    fn wording(beside: &Beside, effect: EffectRef) -> &'static str {
        let record = example::of(&*effect).unwrap().record;
        let form = effect.example(&record).unwrap();
        let mut steps = [step(effect, form)];
        beside.doubt(&mut steps, &record);
        steps[0].wording
    }

    fn drift() -> EffectRef {
        EffectRef::new(&OffsetDrift)
    }

    /// Readings that still follow a step are a memory of it in the means: the name is doubted, and a transient is its rival.
    #[test]
    fn a_memory_is_not_certain_while_the_readings_follow_the_step() {
        let record = example::of(&Remanence).unwrap().record;
        for follows in [false, true] {
            let beside = Beside { follows, ..Beside::default() };
            let mut steps = [step(EffectRef::new(&Remanence), of_one_cause(&[0, 1, 2]))];
            beside.doubt(&mut steps, &record);
            let [Step { wording: said, ambiguous_with, sentence, next_measurement, .. }] = &steps;
            assert_eq!(*said == "is", !follows, "{sentence}");
            assert_eq!(ambiguous_with.contains(&EffectRef::new(&Settling)), follows);
            assert_eq!(sentence.contains("cannot tell it from settling"), follows, "{sentence}");
            assert_eq!(next_measurement.is_some(), follows);
            // What does not remember is another matter.
            assert_eq!(wording(&beside, drift()), "is");
        }
    }

    /// Saturated samples make drifts and no functions of the field; a component that stands still makes both.
    #[test]
    fn what_comes_and_goes_is_not_certain_where_readings_rest_at_the_end_of_the_range() {
        let catalogue = Catalogue::default();
        let is_of_field = |effect: &EffectRef| effect.about().family == Family::StaticOdd;
        let of_field = catalogue.iter().find(is_of_field).unwrap();
        let at_end = Beside { at_end: [true; 3], ..Beside::default() };
        let [still, nothing] = [true, false].map(|is_still| Beside { still: [is_still; 3], ..Beside::default() });
        for (beside, effect, said) in [
            (&at_end, drift(), "consistent with"),
            (&at_end, of_field, "is"),
            (&still, of_field, "consistent with"),
            (&nothing, drift(), "is"),
        ] {
            assert_eq!(wording(beside, effect), said, "{effect}");
        }
    }

    /// Of means without parts of a periodic signal nothing is certain.
    #[test]
    fn nothing_is_certain_in_means_without_parts_of_a_signal() {
        for is_cut in [false, true] {
            let beside = Beside { is_cut, ..Beside::default() };
            assert_eq!(wording(&beside, drift()) == "is", !is_cut);
            let of_field = Catalogue::default().iter().find(|effect| effect.about().family == Family::StaticOdd).unwrap();
            assert_eq!(wording(&beside, of_field) == "is", !is_cut);
        }
    }

    /// Edges that stand elsewhere speak against a displacement of all of them, and against nothing else.
    #[test]
    fn a_displacement_is_not_certain_where_edges_stand_elsewhere() {
        for is_apart in [false, true] {
            let beside = Beside { is_apart, ..Beside::default() };
            let record = example::of(&TimeShift).unwrap().record;
            let mut steps = [step(EffectRef::new(&TimeShift), time_shift::edges(0.5))];
            beside.doubt(&mut steps, &record);
            assert_eq!(steps[0].wording == "is", !is_apart);
            assert_eq!(wording(&beside, drift()), "is");
        }
    }
}
