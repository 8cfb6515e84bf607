//! Another form of a term's own effect, of which another term makes a twin: beside the square of one component of a field of one size, that of a second
//! component is that of the third one, up to a constant. Then the data do not say which of the two it is, and the size of the other term depends on it.

use super::chosen::Chosen;
use super::{Means, MeansModel};
use crate::diagnose::APART;
use crate::diagnose::candidate::{Candidate, without};
use crate::fit::scan::{ABSORBED, Fitted};

/// Forms with at least this canonical correlation are alike by themselves, as neighbours of a grid are.
const ALIKE: f64 = 0.9;
/// A size moves where its values differ by more than this many of its standard uncertainties, which an interval of 95 % does not hold.
const MOVED: f64 = 2.0;

/// Why the form or the size of a term, `at` of all, is not certain beside the other ones, in sentences; nothing where both are.
pub(super) fn doubts(chosen: &Chosen, model: &MeansModel, all: &[&Candidate], at: usize) -> String {
    let means = chosen.means;
    let mut why = String::new();
    for other in (0..all.len()).filter(|other| *other != at) {
        let key = &all[other].key;
        if let Some(twin) = twin(means, chosen.without, all, [at, other]) {
            why.push_str(&format!(" Beside {key}, {} describes the data as well as {}.", names(twin), names(all[at])));
        }
        // The form of what was known before is known.
        if other < means.given.len() {
            continue;
        }
        let without_other = means.model_beside(model, &without(all, &[other]));
        let twin = twin(means, &without_other, all, [other, at]);
        if let Some(twin) = twin.filter(|twin| moves(means, model, all, [at, other], twin)) {
            let [own, twin] = [all[other], twin].map(names);
            why.push_str(&format!(" Its size depends on whether {key} is {own} or {twin}, which the data do not tell."));
        }
    }
    why
}

/// The best other form of a term that describes the readings as well beside the model of all others, and is another curve without one of them.
fn twin<'m>(means: &'m Means, others: &MeansModel, all: &[&Candidate], [at, beside]: [usize; 2]) -> Option<&'m Candidate> {
    let own = all[at];
    let is_tried = |c: &&Candidate| c.key == own.key && !c.effect.is_unknown() && c.spec != own.spec;
    let fewer = means.model_beside(others, &without(all, &[at, beside]));
    let [own_group, own_beside_fewer] = [others, &fewer].map(|model| means.group(model, own));
    let least = others.fitted.score(&own_group).evidence - APART;
    let evidence = |c: &Candidate| {
        let group = means.group(others, c);
        let evidence = others.fitted.score(&group).evidence;
        (group.surviving > ABSORBED && evidence > least).then_some(evidence)
    };
    let is_other = |c: &Candidate| Fitted::correlation(&means.group(&fewer, c), &own_beside_fewer) < ALIKE;
    let tried = means.candidates.iter().filter(is_tried).filter_map(|c| Some((c, evidence(c)?)));
    tried.filter(|(c, _)| is_other(c)).max_by(|a, b| a.1.total_cmp(&b.1)).map(|(c, _)| c)
}

/// Whether the size of a term is another one with a twin in the place of another term.
fn moves(means: &Means, model: &MeansModel, all: &[&Candidate], [at, other]: [usize; 2], twin: &Candidate) -> bool {
    let with_twin: Vec<&Candidate> = all.iter().enumerate().map(|(i, c)| if i == other { twin } else { *c }).collect();
    let of = |model: &MeansModel, terms: &[&Candidate]| means.estimate(model, terms, at);
    let [Some(own), Some(beside_twin)] = [of(model, all), of(&means.model_beside(model, &with_twin), &with_twin)] else {
        return false;
    };
    own.iter().zip(&beside_twin).any(|((a, std), (b, _))| (a - b).abs() > MOVED * std)
}

/// The linear parameters, which say what a form depends on.
fn names(candidate: &Candidate) -> String {
    candidate.parameters.iter().map(|(name, _)| name.as_str()).collect::<Vec<&str>>().join(", ")
}
