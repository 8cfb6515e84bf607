//! One search for missing effects, whatever the data are: plateau means of a run, parameters of several runs, sines.
//!
//! A [`Problem`] knows its data: which terms may be missing, how the model with some of them is fitted, what noise alone would show, which
//! terms exclude each other, which stretches can be held out, and the facts that describe an accepted term. [`search`] knows the way: the
//! most evident term is added if it predicts what it has not seen, terms of one effect are merged, and terms that another one made
//! superfluous or that something else explains better are dropped or swapped, until noise alone explains what is left. Then every term is
//! confirmed in the final model: what was right when it was added may predict worse beside what came later.

use super::result::{Evidence, Map, Step};
use super::steps::Facts;
use crate::data::note::{Note, NoteKind};
use crate::data::units::counted;

/// Data with everything that may be missing in their model.
pub trait Problem {
    /// A term that was accepted.
    type Term: Clone;
    /// The model with the chosen terms, fitted.
    type Fit;

    /// Probability with which noise alone may give as much evidence as a term needs.
    const FALSE_ALARM: f64;
    /// Most terms.
    const MOST_TERMS: usize;
    /// Rounds after which the search ends; a round adds terms, or rules some out because they predict nothing.
    const MOST_ROUNDS: usize;
    /// How often all terms are revised after one was added; earlier if nothing changes.
    const MOST_REVISIONS: usize;

    /// The model with the chosen terms; `None` if it has no fit.
    fn fitted(&self, chosen: &[Self::Term]) -> Option<Self::Fit>;

    /// What is evident beside the chosen terms: one term, or several that show only together; none where noise alone explains what is left.
    /// `None` if a model has no fit.
    fn evident(&self, fit: &Self::Fit, chosen: &[Self::Term]) -> Option<Vec<Self::Term>>;

    /// Whether the model with further terms predicts stretches that were held out better than the model without them. `None` if a model has no
    /// fit.
    fn predicts(&self, chosen: &[Self::Term], further: &[Self::Term]) -> Option<bool>;

    /// A term of the final model without which stretches that were held out are predicted better, the worst of them; `Some(None)` if all are
    /// confirmed, `None` if a model has no fit.
    fn unconfirmed(&self, _fit: &Self::Fit, chosen: &[Self::Term]) -> Option<Option<usize>> {
        for index in (0..chosen.len()).rev() {
            let mut others = chosen.to_vec();
            let own = others.remove(index);
            if !self.predicts(&others, &[own])? {
                return Some(Some(index));
            }
        }
        Some(None)
    }

    /// Rules out what did not predict stretches that were held out.
    fn rule_out(&mut self, term: &Self::Term);

    /// Whether two terms are one effect on different axes.
    fn belong_together(&self, earlier: &Self::Term, last: &Self::Term) -> bool;

    /// One term in place of two that belong together; `None` if both have to stay.
    fn merged(&self, earlier: &Self::Term, last: &Self::Term) -> Option<Self::Term>;

    /// Whether a single term is looked at again with the noise that it leaves: where slow noise was as likely before it, that may tell more.
    fn looks_again_at_one(&self) -> bool {
        false
    }

    /// What becomes of a term now that others were added; its parameters may be refined where it stays. `None` if a model has no fit.
    fn revised(&self, chosen: &mut [Self::Term], index: usize) -> Option<Revision<Self::Term>>;

    /// The facts that describe a chosen term; `number` is that of its step.
    fn describe(&self, fit: &Self::Fit, chosen: &[Self::Term], index: usize, number: usize) -> Description;
}

/// What becomes of a term.
pub enum Revision<T> {
    /// It stays.
    Keep,
    /// Something else explains the data better.
    Swap(T),
    /// The other terms made it superfluous.
    Drop,
}

/// The facts that describe a term, with what is drawn of it.
pub struct Description {
    /// The facts.
    pub facts: Facts,
    /// Residuals without and with it.
    pub map: Map,
    /// Its evidence and that of its rivals, if they are drawn.
    pub evidence: Option<Evidence>,
}

/// The terms that a search accepted, and the model with them.
pub struct Outcome<T, F> {
    /// Terms in the order in which they were accepted.
    pub terms: Vec<T>,
    /// The model with all of them.
    pub fit: F,
    /// The search ended since it may take no more terms or rounds, and another term was evident.
    pub is_cut: bool,
}

impl<T, F> Outcome<T, F> {
    /// Says that more is in the data than the search may take.
    pub fn note(&self) -> Option<Note> {
        let text = format!(
            "with {} the search has as many as it may take, and another one is evident: what is found may stand for it, and its uncertainties do not \
             hold",
            counted(self.terms.len() as u64, "effect")
        );
        self.is_cut.then(|| {
            Note::new(NoteKind::Fit, text)
                .with_remedy("put what is known for certain into a model file, and diagnose again with --model")
        })
    }
}

/// [`Outcome`] of a problem.
pub type OutcomeOf<P> = Outcome<<P as Problem>::Term, <P as Problem>::Fit>;

/// Looks for missing terms, one after the other. `None` if a model has no fit.
pub fn search<P: Problem>(problem: &mut P) -> Option<OutcomeOf<P>> {
    let mut terms: Vec<P::Term> = Vec::new();
    let mut rounds = 0;
    loop {
        let fit = problem.fitted(&terms)?;
        let is_open = rounds < P::MOST_ROUNDS && terms.len() < P::MOST_TERMS;
        rounds += 1;
        let found = if is_open { problem.evident(&fit, &terms)? } else { Vec::new() };
        if found.is_empty() {
            // What goes is ruled out, so that the search ends.
            let Some(index) = problem.unconfirmed(&fit, &terms)? else {
                let is_cut = !is_open && !problem.evident(&fit, &terms)?.is_empty();
                return Some(Outcome { terms, fit, is_cut });
            };
            let gone = terms.remove(index);
            problem.rule_out(&gone);
        } else if problem.predicts(&terms, &found)? {
            for term in found {
                add(problem, &mut terms, term);
            }
        } else {
            found.iter().for_each(|term| problem.rule_out(term));
            continue;
        }
        repair(problem, &mut terms)?;
    }
}

/// Adds a term, merged with an earlier one of the same effect on other axes.
fn add<P: Problem>(problem: &P, terms: &mut Vec<P::Term>, last: P::Term) {
    let earlier = terms.iter().position(|t| problem.belong_together(t, &last));
    match earlier.and_then(|index| Some((index, problem.merged(&terms[index], &last)?))) {
        Some((index, merged)) => terms[index] = merged,
        None => terms.push(last),
    }
}

/// Drops terms that the others made superfluous, and swaps those for which something better is left. A single term mostly stays: it has just
/// been accepted.
fn repair<P: Problem>(problem: &P, terms: &mut Vec<P::Term>) -> Option<()> {
    for _ in 0..P::MOST_REVISIONS {
        let mut changed = false;
        let mut index = 0;
        while index < terms.len() && (terms.len() > 1 || problem.looks_again_at_one()) {
            match problem.revised(terms, index)? {
                Revision::Keep => index += 1,
                Revision::Swap(better) => {
                    terms[index] = better;
                    changed = true;
                    index += 1;
                }
                Revision::Drop => {
                    terms.remove(index);
                    changed = true;
                }
            }
        }
        if !changed {
            break;
        }
    }
    Some(())
}

/// The accepted terms as steps, numbered from `first`, with what is drawn of them.
pub fn steps<P: Problem>(problem: &P, outcome: &OutcomeOf<P>, first: usize) -> (Vec<Step>, Vec<Map>, Vec<Evidence>) {
    let (mut steps, mut maps, mut evidence) = (Vec::new(), Vec::new(), Vec::new());
    for index in 0..outcome.terms.len() {
        let description = problem.describe(&outcome.fit, &outcome.terms, index, first + index);
        steps.push(description.facts.step());
        maps.push(description.map);
        evidence.extend(description.evidence);
    }
    (steps, maps, evidence)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Terms are letters; `a` predicts as long as `b` is not there, and `b` always does.
    #[derive(Default)]
    struct Letters {
        ruled_out: Vec<char>,
    }

    impl Problem for Letters {
        type Term = char;
        type Fit = ();
        const FALSE_ALARM: f64 = 0.01;
        const MOST_TERMS: usize = 4;
        const MOST_ROUNDS: usize = 8;
        const MOST_REVISIONS: usize = 1;

        fn fitted(&self, _: &[char]) -> Option<()> {
            Some(())
        }

        fn evident(&self, (): &(), chosen: &[char]) -> Option<Vec<char>> {
            let next = ['a', 'b', 'c'].into_iter().find(|term| !chosen.contains(term) && !self.ruled_out.contains(term));
            Some(next.into_iter().collect())
        }

        fn predicts(&self, chosen: &[char], further: &[char]) -> Option<bool> {
            Some(match further {
                ['a'] => !chosen.contains(&'b'),
                ['b'] => true,
                _ => false,
            })
        }

        fn rule_out(&mut self, term: &char) {
            self.ruled_out.push(*term);
        }

        fn belong_together(&self, _: &char, _: &char) -> bool {
            false
        }

        fn merged(&self, _: &char, _: &char) -> Option<char> {
            None
        }

        fn revised(&self, _: &mut [char], _: usize) -> Option<Revision<char>> {
            Some(Revision::Keep)
        }

        fn describe(&self, (): &(), _: &[char], _: usize, _: usize) -> Description {
            unreachable!("nothing is described")
        }
    }

    #[test]
    fn what_was_right_when_it_was_added_goes_if_it_is_wrong_in_the_end() {
        let mut letters = Letters::default();
        let outcome = search(&mut letters).unwrap();
        assert_eq!(outcome.terms, ['b']);
        assert_eq!(letters.ruled_out, ['c', 'a']);
        assert!(outcome.note().is_none());
    }

    #[test]
    fn a_search_that_may_take_no_more_says_so() {
        let cut = Outcome { terms: vec!['a', 'b'], fit: (), is_cut: true };
        assert!(cut.note().is_some_and(|note| note.text.starts_with("with 2 effects the search has as many as it may take")));
    }
}
