//! Temperature channels that jump, weighed against what the readings of the sensor say: the channel as it was recorded with the effects that
//! its readings would then need, against the channel without its jumps.

use super::candidate::Candidate;
use super::explanations::Explanation;
use super::means::{HeldOut, Means, gap};
use super::one_run::given_between;
use super::result::{Evidence, Gap, RunnerUp, Telling};
use super::steps::{Facts, Name, fault_facts};
use super::{APART, Given};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Run;
use crate::fit::noise::state_space::Noise;
use crate::model::effects::{Catalogue, EffectRef};
use crate::record::prepared::PreparedRun;
use crate::record::temperature_faults::{Jumps, small_jump};
use nalgebra::DMatrix;

/// Rivals of a fault that are listed.
const RIVALS: usize = 5;

/// A fault that the readings confirm or say nothing of.
pub(super) struct FoundFault {
    pub facts: Facts,
    /// Drawn where the readings confirm it.
    pub evidence: Option<Evidence>,
}

/// One way to read a temperature channel, with the effect that the readings need most beside it.
struct Side<'a> {
    means: Means<'a>,
    noise: Noise,
    explanations: Vec<Explanation>,
}

impl<'a> Side<'a> {
    fn new(prepared: &'a PreparedRun, readings: &DMatrix<f64>, given: &[Candidate], catalogue: &Catalogue) -> Option<Self> {
        let means = Means::new(prepared, readings.clone(), catalogue, given.to_vec());
        let (explanations, noise) = {
            let model = means.model(&means.all(&[]))?;
            (means.scored(&model).explanations, model.noise)
        };
        let mut side = Self { noise, means, explanations };
        side.noise = side.means.model(&side.terms())?.noise;
        Some(side)
    }

    /// The given terms and the one that the readings need most: a weak one would be chosen by noise.
    fn terms(&self) -> Vec<&Candidate> {
        let best = self.explanations.first().filter(|e| e.beside_noise() > APART);
        let mut terms = self.means.all(&[]);
        terms.extend(best.map(|e| &self.means.candidates[e.best]));
        terms
    }

    /// With the term if it helps to predict.
    fn held_out(&self, noise: &Noise) -> HeldOut {
        let [without, with] = [self.means.all(&[]), self.terms()].map(|terms| self.means.predicted(noise, &terms));
        if with.sum < without.sum { with } else { without }
    }
}

/// Weighs every channel that jumps. One that predicts held-out readings better as it was recorded is taken so, with a note; the others are
/// faults, confirmed by the readings or not. A jump that is too small to be believed by the channel alone is one where the readings confirm it.
pub(super) fn weigh(
    prepared: &mut PreparedRun,
    run: &Run,
    readings: impl Fn(&PreparedRun) -> DMatrix<f64>,
    given: &[Given],
    catalogue: &Catalogue,
) -> (Vec<FoundFault>, Vec<Note>) {
    let (mut found, mut notes) = (Vec::new(), Vec::new());
    let weighed = |[mended, recorded]: [&PreparedRun; 2]| {
        let sides = [mended, recorded].map(|side| {
            let given = given_between(&side.record, given);
            Side::new(side, &readings(side), &given, catalogue)
        });
        let [Some(with), Some(without)] = sides else { return None };
        Some(Weighed::new(&with, &without, mended.nt_per_ent))
    };
    for fault in prepared.faults.clone() {
        let recorded = prepared.as_recorded(run, &fault.channel);
        let weighed = recorded.as_ref().and_then(|recorded| weighed([prepared, recorded]));
        match (weighed, recorded) {
            (Some(weighed), Some(recorded)) if weighed.log_ratio < -APART => {
                notes.push(weighed.note(&fault));
                *prepared = recorded;
            }
            (Some(weighed), _) => found.push(weighed.found(&fault, found.len())),
            (None, _) => found.push(FoundFault { facts: fault_facts(&fault), evidence: None }),
        }
    }
    if let Some((fault, mended)) = small(prepared, run)
        && let Some(weighed) = weighed([&mended, prepared]).filter(|weighed| weighed.log_ratio > APART)
    {
        found.push(weighed.found(&fault, found.len()));
        *prepared = mended;
    }
    (found, notes)
}

/// A small jump of the temperature that the model of a sweep follows, and the run without it.
fn small(prepared: &PreparedRun, run: &Run) -> Option<(Jumps, PreparedRun)> {
    prepared.record.thermal.as_ref()?;
    let name = &prepared.record.sensor.as_ref()?.name;
    let fault = small_jump(&run.temperatures, name, prepared.record.span_s)?;
    let mended = prepared.without(run, &fault)?;
    Some((fault, mended))
}

/// A channel without its jumps against the channel as it was recorded.
struct Weighed {
    /// Natural logarithm of the likelihood ratio, on held-out readings.
    log_ratio: f64,
    gaps: [Gap; 2],
    /// Effects that the readings need beside the recorded channel, and the logarithms of their likelihood ratios to the fault.
    rivals: Vec<(String, EffectRef, f64)>,
    /// The effect that the readings need most beside the channel without jumps.
    needed: Option<String>,
}

impl Weighed {
    fn new(mended: &Side, recorded: &Side, nt_per_ent: [f64; 3]) -> Self {
        // With the noise that either of them leaves: neither may decide by a noise of its own.
        let both = [mended, recorded].map(|side| [recorded, mended].map(|of| of.held_out(&side.noise)));
        let ratios = both.each_ref().map(|[before, after]| 0.5 * (before.sum - after.sum));
        let log_ratio = if ratios[0] * ratios[1] > 0.0 { ratios[0].signum() * ratios[0].abs().min(ratios[1].abs()) } else { 0.0 };
        let gaps = both[0].each_ref().map(|held| gap(held, nt_per_ent));
        let most = recorded.explanations.first().map_or(0.0, |e| e.evidence);
        let rival = |e: &Explanation| {
            let effect = recorded.means.candidates[e.best].effect;
            (e.key.clone(), effect, e.evidence - most - log_ratio)
        };
        let rivals = recorded.explanations.iter().filter(|e| e.beside_noise() > APART).take(RIVALS).map(rival).collect();
        let needed = mended.explanations.first().filter(|e| e.beside_noise() > APART).map(|e| e.key.clone());
        Self { log_ratio, gaps, rivals, needed }
    }

    fn found(self, fault: &Jumps, number: usize) -> FoundFault {
        let plain = fault_facts(fault);
        let is_other = |key: &String| self.needed.as_ref() != Some(key);
        let near = self.rivals.iter().filter(|(key, _, log_ratio)| *log_ratio > -APART && is_other(key));
        let mut ambiguous_with: Vec<EffectRef> = Vec::new();
        near.for_each(|(_, effect, _)| {
            if !ambiguous_with.contains(effect) {
                ambiguous_with.push(*effect)
            }
        });
        let is_confirmed = self.log_ratio > APART && ambiguous_with.is_empty();
        let said = if is_confirmed {
            format!(
                " Without the jumps held-out readings are predicted better, by {:.0} in the logarithm of the likelihood.",
                self.log_ratio
            )
        } else {
            " Held-out readings of the sensor do not tell whether the temperature did so.".to_owned()
        };
        let bars = std::iter::once((plain.effect.to_string(), self.log_ratio.max(0.0)))
            .chain(self.rivals.iter().map(|(key, _, log_ratio)| (key.clone(), log_ratio + self.log_ratio.max(0.0))));
        let evidence = Evidence { step: number, bars: bars.filter(|(_, value)| *value >= 0.0).collect(), apart: APART };
        let runner_up = |(effect, _, log_ratio): &(String, EffectRef, f64)| RunnerUp {
            effect: effect.clone(),
            log_ratio: *log_ratio,
            correlation: 0.0,
        };
        let facts = Facts {
            name: if is_confirmed { Name::Certain } else { Name::Doubted },
            gaps: self.gaps,
            runners_up: self.rivals.iter().map(runner_up).collect(),
            ambiguous_with,
            telling: Telling { remark: said, ..plain.telling },
            ..plain
        };
        FoundFault { facts, evidence: is_confirmed.then_some(evidence) }
    }

    fn note(&self, fault: &Jumps) -> Note {
        let (t_s, by_k) = fault.jumps[0];
        let text = format!(
            "temperature channel {} changes by {by_k:+.1} K at {t_s:.0} s, faster than before and after, and the readings follow it: it is taken \
             as it was recorded, which predicts held-out readings better by {:.0} in the logarithm of the likelihood",
            fault.channel, -self.log_ratio
        );
        Note::new(NoteKind::Temperature, text).about(fault.channel.as_str())
    }
}
