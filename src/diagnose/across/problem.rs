//! Runs that disagree as a problem of the search.

use super::candidates::ORIENTATION;
use super::run_set::{RunCandidate, RunSet, count};
use super::{LEAST_AGREEING, describe};
use crate::diagnose::candidate::{self, Accepted, Candidate, Threshold};
use crate::diagnose::explanations::{self, Scored};
use crate::diagnose::problem::{Description, Problem, Revision};
use crate::fit::scan::{Fitted, Group};

/// Below this evidence (logarithm) noise alone gives as much in one case of a few, so that nothing has to be simulated.
const HOPELESS: f64 = 2.0;
/// A model with fewer degrees of freedom determines no scatter, and nothing is looked for beside it.
const LEAST_FREEDOM: f64 = 2.0;
/// Signal to noise ratio from which an effect is significant, about: what selection does to values depends on it little.
const LEAST: f64 = 4.0;
/// Seed of the simulated noise.
const SEED: u64 = 0x0ca1_ac05;

/// A term that was accepted.
pub type Term = Accepted<RunCandidate>;

/// The runs with everything that may make them disagree.
pub struct Comparison<'a> {
    pub set: RunSet<'a>,
    pub candidates: Vec<RunCandidate>,
    /// Logarithm of the prior of each.
    log_priors: Vec<f64>,
    /// Those that are no longer looked for, since they did not predict; they are rivals of what is named in their place.
    ruled_out: Vec<bool>,
}

/// The terms of a search.
pub fn chosen_candidates(chosen: &[Term]) -> Vec<&RunCandidate> {
    chosen.iter().map(|t| &t.candidate).collect()
}

impl Problem for Comparison<'_> {
    type Term = Term;
    type Fit = Fitted;

    /// Three sets in a thousand: the scatter of few runs is known badly, and reports/blind-study.md counts their false alarms among those of
    /// all runs.
    const FALSE_ALARM: f64 = 0.003;
    /// As in reports/blind-study.md. A dozen runs do not determine more.
    const MOST_TERMS: usize = 6;
    /// Twice as many rounds may rule something out.
    const MOST_ROUNDS: usize = 3 * Self::MOST_TERMS;
    /// Once: nothing is refined.
    const MOST_REVISIONS: usize = 1;

    fn fitted(&self, chosen: &[Term]) -> Option<Fitted> {
        Some(self.set.fitted(&chosen_candidates(chosen)))
    }

    fn evident(&self, fitted: &Fitted, chosen: &[Term]) -> Option<Vec<Term>> {
        Some(self.most_evident(fitted, &chosen_candidates(chosen)).into_iter().collect())
    }

    /// Every run in turn, with the scatter that is left with the further terms, in the classes on which these act.
    fn predicts(&self, chosen: &[Term], further: &[Term]) -> Option<bool> {
        let (now, further) = (chosen_candidates(chosen), chosen_candidates(further));
        let with = [now.clone(), further.clone()].concat();
        let scales = self.set.scales(&self.set.fitted(&with));
        let classes = self.set.classes(&further);
        let squares = |terms: &[&RunCandidate]| self.set.gap(&self.set.held_out(terms, &scales), &scales, &with, classes).1;
        Some(squares(&with) < squares(&now))
    }

    /// This term alone: an orientation may stand alone in one class and not in another.
    fn rule_out(&mut self, term: &Term) {
        for (is_out, candidate) in self.ruled_out.iter_mut().zip(&self.candidates) {
            *is_out |= candidate.is_same_term(&term.candidate) && candidate.parameters == term.candidate.parameters;
        }
    }

    fn belong_together(&self, earlier: &Term, last: &Term) -> bool {
        earlier.candidate.is_same_form(&last.candidate)
    }

    /// On all axes: wrong parameters of a facility have no axis of the sensor.
    fn merged(&self, earlier: &Term, last: &Term) -> Option<Term> {
        let on_all = |s: &&RunCandidate| s.is_same_form(&last.candidate) && s.spec.axes.len() == 3;
        let candidate = self.candidates.iter().find(on_all)?.clone();
        Some(Term { candidate, ..earlier.clone() })
    }

    fn revised(&self, chosen: &mut [Term], index: usize) -> Option<Revision<Term>> {
        let all = chosen_candidates(chosen);
        let others = candidate::without(&all, &[index]);
        let fitted = self.set.fitted(&others);
        let own = all[index];
        let score = fitted.score(&self.set.group(&fitted, own));
        Some(match self.scored(&fitted, &others).revised(&own.key, &score) {
            Revision::Keep => Revision::Keep,
            Revision::Drop => Revision::Drop,
            Revision::Swap(better) => {
                Revision::Swap(Term { candidate: self.candidates[better].clone(), ..chosen[index].clone() })
            }
        })
    }

    fn describe(&self, fitted: &Fitted, chosen: &[Term], index: usize, number: usize) -> Description {
        describe::describe(self, fitted, chosen, index, number)
    }
}

impl<'a> Comparison<'a> {
    pub fn new(set: RunSet<'a>, candidates: Vec<RunCandidate>) -> Self {
        let log_priors = explanations::log_priors(candidates.iter().map(|s| &s.candidate), |effect| effect.prior(None));
        let ruled_out = vec![false; candidates.len()];
        Self { set, candidates, log_priors, ruled_out }
    }

    /// A term that leaves too few orientations to compare is not looked for, nor one that is there.
    fn is_open(&self, candidate: &RunCandidate, terms: &[&RunCandidate]) -> bool {
        if terms.iter().any(|t| t.is_same_term(candidate)) {
            return false;
        }
        let is_orientation = |s: &RunCandidate| s.covariate.as_deref() == Some(ORIENTATION);
        let stand_alone = terms.iter().filter(|t| is_orientation(t)).count();
        !is_orientation(candidate) || count(&self.set.orientation) > LEAST_AGREEING + stand_alone
    }

    pub fn groups(&self, fitted: &Fitted) -> Vec<Group> {
        self.candidates.iter().map(|s| self.set.group(fitted, s)).collect()
    }

    /// The candidates that are looked for, scored beside a model with these terms.
    fn scored<'b>(&'b self, fitted: &'b Fitted, terms: &[&RunCandidate]) -> Scored<'b> {
        self.scored_if(fitted, terms, |_| false)
    }

    /// The same as rivals of one that was chosen: those that were ruled out as well, where it may stand for them.
    pub fn scored_as_rivals<'b>(&'b self, fitted: &'b Fitted, terms: &[&RunCandidate], chosen: &Group) -> Scored<'b> {
        self.scored_if(fitted, terms, |other| explanations::may_be(fitted, chosen, other))
    }

    /// Candidates scored beside a model with these terms; of those that were ruled out the ones that count.
    fn scored_if<'b>(&'b self, fitted: &'b Fitted, terms: &[&RunCandidate], counts: impl Fn(&Group) -> bool) -> Scored<'b> {
        let groups = self.groups(fitted);
        let is_scored = |i: usize| self.is_open(&self.candidates[i], terms) && (!self.ruled_out[i] || counts(&groups[i]));
        let log_prior = |(i, own): (usize, &f64)| if is_scored(i) { *own } else { f64::NEG_INFINITY };
        let log_priors = self.log_priors.iter().enumerate().map(log_prior).collect();
        let candidates: Vec<&Candidate> = self.candidates.iter().map(|s| &s.candidate).collect();
        Scored::new(fitted, candidates, groups, log_priors, None)
    }

    /// The most evident term beside others, if it is no noise.
    fn most_evident(&self, fitted: &Fitted, now: &[&RunCandidate]) -> Option<Term> {
        if fitted.freedom().iter().sum::<f64>() < LEAST_FREEDOM {
            return None;
        }
        let scored = self.scored(fitted, now);
        let most = scored.explanations.iter().map(|e| e.beside_noise()).fold(f64::NEG_INFINITY, f64::max);
        let best = scored.explanations.first().filter(|_| most > HOPELESS)?;
        let evident = scored.evident(most, Self::FALSE_ALARM, SEED)?;
        Some(Term {
            candidate: self.candidates[best.best].clone(),
            p_global: evident.p_global,
            trials: evident.trials,
            threshold: Threshold::Strength(LEAST),
        })
    }
}
