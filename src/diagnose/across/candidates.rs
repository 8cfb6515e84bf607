//! What is tried between runs: the effects of a catalogue, and an orientation or a run that stands alone.

use super::run_set::{RunCandidate, RunSet, count};
use super::{CLASSES, LEAST_AGREEING};
use crate::data::units::COMPONENTS;
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::NotIdentifiable;
use crate::model::effects::between::BetweenRuns;
use crate::model::effects::{Catalogue, EffectRef, Spec, UNKNOWN};
use nalgebra::DMatrix;

/// What an orientation or a run that stands alone follows.
pub const ORIENTATION: &str = "orientation";
pub const RUN: &str = "run";

/// Everything that is tried, and what of the catalogue these runs cannot show.
pub fn candidates(set: &RunSet, catalogue: &Catalogue) -> (Vec<RunCandidate>, Vec<NotIdentifiable>) {
    let mut effects: Vec<(EffectRef, BetweenRuns)> =
        catalogue.iter().filter_map(|effect| Some((effect, effect.between_runs(&set.conditions)?))).collect();
    effects.sort_by_key(|(_, made)| made.cause);
    let (mut all, mut none) = (Vec::new(), Vec::new());
    for (effect, BetweenRuns { cause, terms, unseen }) in effects {
        none.extend(unseen.map(|reason| NotIdentifiable { effect, reason: reason.to_string() }));
        all.extend(terms.into_iter().map(|term| {
            let columns = DMatrix::from_fn(9 * set.count(), term.columns.len(), |row, c| term.columns[c].values[row]);
            let parameters = term.columns.into_iter().map(|c| (c.name, c.unit)).collect();
            RunCandidate {
                candidate: Candidate::new(effect, None, term.spec, parameters, columns),
                cause: Some(cause),
                alone: None,
            }
        }));
    }
    all.extend(alone(set));
    (all, none)
}

/// An orientation or a run by itself, in all classes and in each of them.
fn alone(set: &RunSet) -> Vec<RunCandidate> {
    let n = set.count();
    let orientations = count(&set.orientation);
    let members = |o: usize| (0..n).filter(|r| set.orientation[*r] == o).collect::<Vec<usize>>();
    let mut outliers: Vec<(&'static str, String, Vec<usize>)> = Vec::new();
    if orientations > LEAST_AGREEING {
        let named = |own: Vec<usize>| (ORIENTATION, set.runs[own[0]].position.orientation(), own);
        outliers.extend((0..orientations).map(members).map(named));
    }
    for r in (0..n).filter(|r| members(set.orientation[*r]).len() > 2) {
        outliers.push((RUN, set.runs[r].run.clone(), vec![r]));
    }
    let of = |(what, name, own): (&'static str, String, Vec<usize>)| {
        [&[0, 1, 2][..], &[0], &[1], &[2]].map(|classes| {
            let columns = DMatrix::from_fn(9 * n, 3 * classes.len(), |row, c| {
                let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
                if class == classes[c / 3] && own.contains(&r) && i == c % 3 { 1.0 } else { 0.0 }
            });
            let parameters = classes.iter().flat_map(|class| (0..3).map(|i| parameter(*class, i))).collect();
            let spec = Spec::new(&format!("{what} {name}"), &[0, 1, 2]);
            let candidate = Candidate::new(UNKNOWN, Some(what.to_owned()), spec, parameters, columns);
            RunCandidate { candidate, cause: None, alone: Some(own.clone()) }
        })
    };
    outliers.into_iter().flat_map(of).collect()
}

/// Name and unit of the deviation of a value.
fn parameter(class: usize, i: usize) -> (String, &'static str) {
    let suffix = [COMPONENTS, COMPONENTS, ["xy", "xz", "yz"]][class][i];
    (format!("{}_{suffix}", CLASSES[class]), ["1", "nT", "deg"][class])
}
