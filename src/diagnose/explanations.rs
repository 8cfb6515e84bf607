//! Candidates scored beside a linear model: their evidence, effect by effect, what noise alone would give, and the rivals of a term.
//!
//! The evidence of a candidate is the logarithm of its Bayes factor against no effect ([`crate::fit::scan`]) plus the logarithm of its prior.
//! All candidates of one key (an effect, or an unknown dependence on one covariate) are one explanation: their evidences are added, the prior
//! of the effect is shared out among them.

use super::candidate::Candidate;
use super::problem::Revision;
use super::result::{Evidence, RunnerUp};
use super::{ALIKE, APART};
use crate::fit::scan::{ABSORBED, Fitted, Group, Score};
use crate::fit::statistics::log_sum;
use crate::model::effects::{EffectRef, Family};
use rayon::prelude::*;

/// A term gives way to another one whose evidence (logarithm) is larger by this much, a ratio of e: equals do not change places.
const SWAP: f64 = 1.0;
/// The prior of an effect is shared among its candidates; a term whose shape was refined is none of them and is judged as if it were one of
/// e³, about twenty.
pub const SHARE: f64 = 3.0;
/// Real curves differ from their formulas by a tenth to a fifth of the effect: in reports/blind-study.md that is four to ten standard deviations
/// at k = 50. Curves of one family with this canonical correlation differ from each other by less than half of it, not much more than that.
const FAMILY_TWIN: f64 = 0.9;
/// A term of which another one leaves less than this part of its strength may stand for it.
const LITTLE: f64 = 0.5;
/// Rivals of a term that are listed.
const RUNNERS_UP: usize = 5;
/// Rivals of a term whose evidence is drawn.
const BARS: usize = 7;

/// Evidence of an explanation: all its candidates together, and the best of them.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// Key of its candidates.
    pub key: String,
    /// Logarithm of evidence times prior among other effects.
    pub evidence: f64,
    /// What of it is no evidence against noise: the logarithm of how many times as likely it is among other effects as beside noise.
    pub favour: f64,
    /// Index of its best candidate.
    pub best: usize,
    /// Score of the best candidate.
    pub score: Score,
    /// What of the evidence is lost since the noise is not known, a logarithm; zero while it is that of one noise.
    pub lost: f64,
}

impl Explanation {
    /// Logarithm of evidence times prior beside noise.
    #[must_use]
    pub fn beside_noise(&self) -> f64 {
        self.evidence - self.favour
    }
}

/// Evidence that is more than noise alone gives.
pub struct Evident {
    /// Probability that noise alone gives any candidate as much.
    pub p_global: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// Evidence beyond that which noise alone gives at the level of false alarms.
    pub margin: f64,
}

/// Logarithm of the prior of every candidate: that of its effect, shared out among the candidates of one key.
pub fn log_priors<'a>(candidates: impl Iterator<Item = &'a Candidate> + Clone, prior: impl Fn(EffectRef) -> f64) -> Vec<f64> {
    let of = |candidate: &Candidate| {
        let same = candidates.clone().filter(|other| other.key == candidate.key).count() as f64;
        (prior(candidate.effect) / same).ln()
    };
    candidates.clone().map(of).collect()
}

/// Whether a term may stand for another explanation, one that was ruled out: beside that one so little of the chi square of the term is left that it
/// does not tell them apart, or less than real curves differ from their formulas. Beside an explanation of something else all of it is.
pub fn stands_for(chi_square: f64, left: f64) -> bool {
    left < (2.0 * APART).max(LITTLE * LITTLE * chi_square)
}

/// The same for groups beside a model.
pub fn may_be(fitted: &Fitted, chosen: &Group, other: &Group) -> bool {
    let [of_chosen, of_other, of_both] = [chosen, other, &fitted.both(other, chosen)].map(|g| fitted.score(g).chi_square);
    stands_for(of_chosen, of_both - of_other)
}

/// All candidates beside a model.
pub struct Scored<'a> {
    fitted: &'a Fitted,
    candidates: Vec<&'a Candidate>,
    log_priors: Vec<f64>,
    trend_order: Option<usize>,
    /// What the model leaves of the columns of each candidate.
    pub groups: Vec<Group>,
    /// Explanations by their evidence, the best first.
    pub explanations: Vec<Explanation>,
}

impl<'a> Scored<'a> {
    /// Scores candidates beside an offset that is a polynomial in time of this order; those with a prior of zero (minus infinity) are not
    /// looked for.
    pub fn new(
        fitted: &'a Fitted,
        candidates: Vec<&'a Candidate>,
        groups: Vec<Group>,
        log_priors: Vec<f64>,
        trend_order: Option<usize>,
    ) -> Self {
        let mut scored = Self { fitted, candidates, log_priors, trend_order, groups, explanations: Vec::new() };
        scored.explanations = scored.explained();
        scored
    }

    /// Whether a candidate is looked for and the model does not absorb it.
    fn is_open(&self, index: usize) -> bool {
        self.groups[index].surviving > ABSORBED && self.log_priors[index].is_finite()
    }

    /// Logarithm of how many times as likely an effect is among other effects as beside noise.
    fn favour(&self, candidate: &Candidate) -> f64 {
        candidate.effect.among_effects(self.trend_order).ln()
    }

    fn explained(&self) -> Vec<Explanation> {
        let mut keys: Vec<&str> = Vec::new();
        let mut own: Vec<Vec<(usize, f64, Score)>> = Vec::new();
        let score = |i: usize| self.is_open(i).then(|| self.fitted.score(&self.groups[i]));
        let scores: Vec<Option<Score>> = (0..self.candidates.len()).into_par_iter().map(score).collect();
        for (i, candidate) in self.candidates.iter().enumerate() {
            let key = candidate.key.as_str();
            let place = keys.iter().position(|k| *k == key).unwrap_or_else(|| {
                keys.push(key);
                own.push(Vec::new());
                keys.len() - 1
            });
            if let Some(score) = scores[i] {
                own[place].push((i, score.evidence + self.log_priors[i], score));
            }
        }
        let explanation = |(key, own): (&str, Vec<(usize, f64, Score)>)| {
            let (best, _, score) = own.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
            let favour = self.favour(self.candidates[best]);
            let evidence = log_sum(own.iter().map(|(_, evidence, _)| *evidence)) + favour;
            Some(Explanation { key: key.to_owned(), evidence, favour, best, score, lost: 0.0 })
        };
        let mut all: Vec<Explanation> = keys.into_iter().zip(own).filter_map(explanation).collect();
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        all
    }

    /// Whether noise alone gives any explanation so much evidence less often than `false_alarm`, simulated over all candidates at once; `None` if
    /// it does not.
    pub fn evident(&self, evidence: f64, false_alarm: f64, seed: u64) -> Option<Evident> {
        let usable = (0..self.candidates.len()).filter(|i| self.is_open(*i) && self.groups[*i].count() > 0);
        let of_explanation = |i: usize| Some((i, self.explanations.iter().position(|e| e.key == self.candidates[i].key)?));
        let (usable, explanations): (Vec<usize>, Vec<usize>) = usable.filter_map(of_explanation).unzip();
        let tried: Vec<&Group> = usable.iter().map(|i| &self.groups[*i]).collect();
        let priors: Vec<f64> = usable.iter().map(|i| self.log_priors[*i]).collect();
        let maxima = self.fitted.simulate(&tried, &priors, &explanations, seed);
        let margin = evidence - maxima.evidence_at(false_alarm);
        (margin > 0.0).then(|| Evident { p_global: maxima.global_p(evidence), trials: usable.len(), margin })
    }

    /// The explanation of a key.
    pub fn explanation(&self, key: &str) -> Option<&Explanation> {
        self.explanations.iter().find(|e| e.key == key)
    }

    /// What becomes of a term whose own score beside all other terms is this one; a better term is named by its index.
    pub fn revised(&self, key: &str, own: &Score) -> Revision<usize> {
        let (of_grid, favour) = self.explanation(key).map_or((f64::NEG_INFINITY, 0.0), |e| (e.beside_noise(), e.favour));
        let refined = own.evidence - SHARE;
        if of_grid.max(refined) < 0.0 {
            return Revision::Drop;
        }
        let evidence = of_grid.max(refined) + favour;
        let better = self.explanations.first().filter(|b| b.evidence > evidence + SWAP && b.key != key);
        better.map_or(Revision::Keep, |b| Revision::Swap(b.best))
    }

    /// A term beside everything that could stand in its place.
    pub fn rivals<'s>(&'s self, candidate: &'s Candidate, group: &'s Group) -> Rivals<'s> {
        let score = self.fitted.score(group);
        let own = self.explanation(&candidate.key);
        let of_grid = own.map_or(score.evidence, |e| e.evidence);
        let evidence = of_grid.max(score.evidence - SHARE + self.favour(candidate));
        Rivals { scored: self, candidate, group, score, evidence, least: of_grid.min(evidence) }
    }
}

/// A term beside everything that could stand in its place.
pub struct Rivals<'a> {
    scored: &'a Scored<'a>,
    candidate: &'a Candidate,
    group: &'a Group,
    /// Score of the term.
    pub score: Score,
    /// Evidence of its explanation, and that of it with a shape of the grid only, as rivals have it.
    evidence: f64,
    least: f64,
}

impl Rivals<'_> {
    fn others(&self) -> impl Iterator<Item = &Explanation> {
        self.scored.explanations.iter().filter(|e| e.key != self.candidate.key)
    }

    /// Other effects that these data cannot distinguish from it: their evidence is hardly less, or they look alike.
    pub fn ambiguous(&self) -> Vec<EffectRef> {
        let mut ambiguous: Vec<EffectRef> = Vec::new();
        for e in self.indistinct() {
            let effect = self.scored.candidates[e.best].effect;
            if !ambiguous.contains(&effect) {
                ambiguous.push(effect);
            }
        }
        ambiguous
    }

    /// The explanations of other effects that these data cannot distinguish from it.
    pub fn indistinct(&self) -> impl Iterator<Item = &Explanation> {
        self.others().filter(|e| {
            let effect = self.scored.candidates[e.best].effect;
            let group = &self.scored.groups[e.best];
            let twin =
                Fitted::correlation(group, self.group) > ALIKE && group.count() == self.group.count() && !effect.is_unknown();
            (e.evidence > self.least - APART || twin) && effect != self.candidate.effect
        })
    }

    /// Whether another curve of the reading of the axis itself is so much like it that what a real one differs from its formula tells as much as
    /// what it differs from that: cubes, fifth powers and knees in one range are told by a second range or a test signal.
    pub fn has_family_twin(&self) -> bool {
        let own = self.candidate.effect.about().family;
        own == Family::StaticOdd
            && self.others().any(|e| {
                let effect = self.scored.candidates[e.best].effect;
                effect != self.candidate.effect
                    && effect.about().family == own
                    && Fitted::correlation(&self.scored.groups[e.best], self.group) > FAMILY_TWIN
            })
    }

    /// The rivals of largest evidence, beside the term as it was fitted.
    pub fn runners_up(&self) -> Vec<RunnerUp> {
        self.others().take(RUNNERS_UP).map(|e| self.scored.runner_up(e, self.evidence, self.group)).collect()
    }

    /// Evidence of the term and of the rivals that explain anything at all.
    pub fn bars(&self, step: usize) -> Evidence {
        self.scored.bars(&self.candidate.key, self.evidence, step)
    }
}

impl Scored<'_> {
    fn runner_up(&self, e: &Explanation, evidence: f64, group: &Group) -> RunnerUp {
        let correlation = Fitted::correlation(&self.groups[e.best], group);
        RunnerUp { effect: e.key.clone(), log_ratio: e.evidence - evidence, correlation }
    }

    /// The rivals of the explanation of a key whose evidence is not hopelessly less than that of the explanation itself (a logarithm of
    /// `least`), beside its best candidate; none where there is no such explanation.
    pub fn runners_up(&self, key: &str, least: f64) -> Vec<RunnerUp> {
        let Some(own) = self.explanation(key) else { return Vec::new() };
        let others = self.explanations.iter().filter(|e| e.key != key && e.evidence > own.evidence - least);
        others.take(RUNNERS_UP).map(|e| self.runner_up(e, own.evidence, &self.groups[own.best])).collect()
    }

    /// Evidence of a step with this key and of the rivals that explain anything at all.
    pub fn bars(&self, key: &str, evidence: f64, step: usize) -> Evidence {
        let rivals = self.explanations.iter().filter(|e| e.key != key && e.evidence > 0.0).take(BARS);
        let named = std::iter::once((key.to_owned(), evidence));
        Evidence { step, bars: named.chain(rivals.map(|e| (e.key.clone(), e.evidence))).collect(), apart: APART }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{DMatrix, DVector};

    /// A wave that was named for one of nearly the same frequency: the true one takes all of it. One of another frequency, which is in the readings as
    /// well, takes nothing.
    #[test]
    fn a_term_may_be_what_takes_all_of_it() {
        let wave = |turns: f64, i: usize| (turns * i as f64).cos();
        let readings = DVector::from_fn(300, |i, _| (1.7 * (i * i) as f64).sin() + 3.0 * wave(0.3, i) + 5.0 * wave(1.1, i));
        let fitted = Fitted::new(&readings, &DMatrix::from_element(300, 1, 1.0), [0, 100, 200, 300]);
        let [truth, near, other] = [0.3, 0.304, 1.1].map(|turns| fitted.group(&DMatrix::from_fn(300, 1, |i, _| wave(turns, i))));
        assert!(may_be(&fitted, &near, &truth) && !may_be(&fitted, &truth, &other) && !may_be(&fitted, &truth, &near));
    }
}
