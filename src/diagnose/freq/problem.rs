//! A response with terms of effects in it as a problem of the search.

use super::candidates::{Refined, Scored, corrected, refined};
use super::model::{EffectTerm, Fit};
use super::sines::Sines;
use super::{STRETCH, describe, in_time};
use crate::diagnose::APART;
use crate::diagnose::explanations::stands_for;
use crate::diagnose::problem::{Description, Problem, Revision};
use crate::diagnose::result::RunnerUp;
use crate::diagnose::steps::Significance;
use crate::model::effects::{Catalogue, EffectRef, UNKNOWN};

/// Two explanations are distinguished by this difference of AICc, which is twice that of the logarithms of likelihoods.
pub const APART_AICC: f64 = 2.0 * APART;

/// The sines of a run, and the response with the terms that are there for sure.
pub struct SineSearch<'a> {
    pub sines: &'a Sines,
    pub catalogue: &'a Catalogue,
    pub base: Fit,
    /// Effects that are no longer looked for, since they did not predict what was held out; they are rivals of what is named in their place.
    pub ruled_out: Vec<EffectRef>,
}

/// A term that was accepted.
#[derive(Clone)]
pub struct Term {
    pub term: EffectTerm,
    pub significance: Significance,
    /// Independent trials that make as many false alarms as the candidates among which it was chosen.
    independent: f64,
    /// Effects that these sines cannot tell from it; [`UNKNOWN`] where a drift of the amplitude describes them as well.
    pub ambiguous: Vec<EffectRef>,
    pub runners_up: Vec<RunnerUp>,
    /// The model before it.
    pub before: Fit,
    /// The model with it and all terms before it.
    pub fit: Fit,
}

/// The candidates beside a model, fitted with all parameters, where the best of them is no noise by its linear score.
pub struct Promising {
    scored: Scored,
    p_value: f64,
    /// One per effect, the best first.
    pub refined: Vec<Refined>,
}

impl Problem for SineSearch<'_> {
    type Term = Term;
    type Fit = Fit;

    /// Half of the hundredth of a run that is one false alarm: the noise near every sine is known from few frequencies; as in
    /// reports/blind-study.md.
    const FALSE_ALARM: f64 = 0.005;
    /// As in reports/blind-study.md. A response with more than three effects in it follows anything.
    const MOST_TERMS: usize = 3;
    /// Terms that were dropped may come back.
    const MOST_ROUNDS: usize = 3 * Self::MOST_TERMS;
    /// Once: all parameters are fitted again with every term.
    const MOST_REVISIONS: usize = 1;

    fn fitted(&self, chosen: &[Term]) -> Option<Fit> {
        Some(chosen.last().map_or(&self.base, |last| &last.fit).clone())
    }

    fn evident(&self, fit: &Fit, chosen: &[Term]) -> Option<Vec<Term>> {
        let best = self.promising(fit, chosen).and_then(|promising| self.most_evident(fit, &promising));
        Some(best.into_iter().collect())
    }

    /// Settings that are held out have no veto when a term is added, as in reports/blind-study.md: what comes later may have to stand beside it.
    fn predicts(&self, _: &[Term], _: &[Term]) -> Option<bool> {
        Some(true)
    }

    /// The last term goes if the settings that were held out are predicted better without it: terms before it were fitted without it.
    fn unconfirmed(&self, fit: &Fit, chosen: &[Term]) -> Option<Option<usize>> {
        let Some(last) = chosen.len().checked_sub(1) else { return Some(None) };
        let squares = |fit: &Fit| fit.held_out(self.sines, STRETCH).norm_squared();
        Some((squares(&chosen[last].before) < squares(fit)).then_some(last))
    }

    fn rule_out(&mut self, term: &Term) {
        self.ruled_out.push(term.term.effect);
    }

    /// An effect that was found is not looked for again.
    fn belong_together(&self, _: &Term, _: &Term) -> bool {
        false
    }

    fn merged(&self, _: &Term, _: &Term) -> Option<Term> {
        None
    }

    /// What was found first goes if it is not needed beside what was found since. Nothing is swapped: the candidates were fitted beside all
    /// terms when the last one was chosen.
    fn revised(&self, chosen: &mut [Term], index: usize) -> Option<Revision<Term>> {
        let of_base = self.base.model.terms.len();
        let Some((last, earlier)) = chosen.split_last_mut() else { return Some(Revision::Keep) };
        if index >= earlier.len() {
            return Some(Revision::Keep);
        }
        let Some(without) = last.fit.without(of_base + index, self.sines) else { return Some(Revision::Keep) };
        if corrected(last.independent, without.p_value_of(&last.fit)) < Self::FALSE_ALARM {
            return Some(Revision::Keep);
        }
        last.fit = without;
        Some(Revision::Drop)
    }

    fn describe(&self, fit: &Fit, chosen: &[Term], index: usize, number: usize) -> Description {
        describe::describe(self, fit, &chosen[index], index, number)
    }
}

impl SineSearch<'_> {
    /// The candidates beside a model, if the best of them is no noise by its linear score.
    pub fn promising(&self, fit: &Fit, chosen: &[Term]) -> Option<Promising> {
        let scored = self.scored(fit, chosen);
        let p_value = scored.least_p_value(fit, &self.ruled_out)?;
        if scored.corrected(p_value) >= Self::FALSE_ALARM {
            return None;
        }
        let refined = refined(fit, &scored, self.sines);
        Some(Promising { scored, p_value, refined })
    }

    /// The candidates beside a model with these terms.
    pub fn scored(&self, fit: &Fit, chosen: &[Term]) -> Scored {
        let found: Vec<EffectRef> = chosen.iter().map(|t| t.term.effect).collect();
        Scored::new(fit, self.sines, self.catalogue, &found, Self::FALSE_ALARM)
    }

    /// The best candidate that is looked for, if it is no noise when all parameters are fitted.
    fn most_evident(&self, fit: &Fit, promising: &Promising) -> Option<Term> {
        let Promising { scored, p_value, refined } = promising;
        let best = refined.iter().find(|r| !self.ruled_out.contains(&r.effect()))?;
        if scored.corrected(fit.p_value_of(&best.fit)) >= Self::FALSE_ALARM {
            return None;
        }
        let noise = (best.fit.chi2 / best.fit.dof()).max(1.0);
        // What was ruled out is a rival where little of the best one is left beside it.
        let may_be = |r: &Refined| {
            let both = r.fit.with(&best.term, &best.fit.p[fit.p.len()..], self.sines);
            both.is_none_or(|both| stands_for((fit.chi2 - best.fit.chi2) / noise, (r.fit.chi2 - both.chi2) / noise))
        };
        let is_rival = |r: &&Refined| r.effect() != best.effect() && (!self.ruled_out.contains(&r.effect()) || may_be(r));
        let rivals: Vec<&Refined> = refined.iter().filter(is_rival).collect();
        let is_near = |r: &&&Refined| r.aicc - best.aicc < APART_AICC;
        let runner_up = |r: &Refined| RunnerUp {
            effect: r.effect().to_string(),
            log_ratio: 0.5 * (best.aicc - r.aicc),
            correlation: fit.correlation(best, r, self.sines),
        };
        let in_time = in_time::rival(fit, best, self.sines);
        let ambiguous = rivals.iter().filter(is_near).map(|r| r.effect()).chain(in_time.as_ref().map(|_| UNKNOWN)).collect();
        let mut runners_up: Vec<RunnerUp> = rivals.iter().copied().map(runner_up).chain(in_time).collect();
        runners_up.sort_by(|a, b| b.log_ratio.total_cmp(&a.log_ratio));
        Some(Term {
            term: best.term.clone(),
            significance: Significance {
                p_value: *p_value,
                trials: scored.terms.len(),
                p_value_corrected: scored.corrected(*p_value),
                strength_k: ((fit.chi2 - best.fit.chi2) / noise).max(0.0).sqrt(),
            },
            independent: scored.independent,
            ambiguous,
            runners_up,
            before: fit.clone(),
            fit: best.fit.clone(),
        })
    }
}
