//! What is tried between runs: the effects of a catalogue, and an orientation or a run that stands alone.

use super::scene::{Candidate, Scene, count};
use super::{CLASSES, LEAST_AGREEING};
use crate::data::units::COMPONENTS;
use crate::diagnose::result::NotIdentifiable;
use crate::model::effects::between::BetweenRuns;
use crate::model::effects::{Catalogue, EffectRef, Spec, UNKNOWN};
use nalgebra::DMatrix;

/// What an orientation or a run that stands alone follows.
pub const ORIENTATION: &str = "orientation";
pub const RUN: &str = "run";

/// Everything that is tried, and what of the catalogue these runs cannot show.
pub fn candidates(scene: &Scene, catalogue: &Catalogue) -> (Vec<Candidate>, Vec<NotIdentifiable>) {
    let mut effects: Vec<(EffectRef, BetweenRuns)> =
        catalogue.iter().filter_map(|effect| Some((effect, effect.between_runs(&scene.conditions)?))).collect();
    effects.sort_by_key(|(_, made)| made.cause);
    let (mut all, mut none) = (Vec::new(), Vec::new());
    for (effect, BetweenRuns { cause, terms, unseen }) in effects {
        none.extend(unseen.map(|reason| NotIdentifiable { effect, reason: reason.to_string() }));
        all.extend(terms.into_iter().map(|term| {
            let rows = 9 * scene.count();
            Candidate {
                effect,
                covariate: None,
                cause: Some(cause),
                spec: term.spec,
                columns: DMatrix::from_fn(rows, term.columns.len(), |row, c| term.columns[c].values[row]),
                parameters: term.columns.into_iter().map(|c| (c.name, c.unit)).collect(),
                alone: None,
            }
        }));
    }
    all.extend(alone(scene));
    (all, none)
}

/// An orientation or a run by itself, in all classes and in each of them.
fn alone(scene: &Scene) -> Vec<Candidate> {
    let n = scene.count();
    let orientations = count(&scene.orientation);
    let members = |o: usize| (0..n).filter(|r| scene.orientation[*r] == o).collect::<Vec<usize>>();
    let mut outliers: Vec<(&'static str, String, Vec<usize>)> = Vec::new();
    if orientations > LEAST_AGREEING {
        let named = |own: Vec<usize>| (ORIENTATION, scene.runs[own[0]].position.orientation(), own);
        outliers.extend((0..orientations).map(members).map(named));
    }
    for r in (0..n).filter(|r| members(scene.orientation[*r]).len() > 2) {
        outliers.push((RUN, scene.runs[r].run.clone(), vec![r]));
    }
    let of = |(what, name, own): (&'static str, String, Vec<usize>)| {
        [&[0, 1, 2][..], &[0], &[1], &[2]].map(|classes| Candidate {
            effect: UNKNOWN,
            covariate: Some(what),
            cause: None,
            spec: Spec::new(&format!("{what} {name}"), &[0, 1, 2]),
            parameters: classes.iter().flat_map(|class| (0..3).map(|i| parameter(*class, i))).collect(),
            columns: DMatrix::from_fn(9 * n, 3 * classes.len(), |row, c| {
                let (class, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
                if class == classes[c / 3] && own.contains(&r) && i == c % 3 { 1.0 } else { 0.0 }
            }),
            alone: Some(own.clone()),
        })
    };
    outliers.into_iter().flat_map(of).collect()
}

/// Name and unit of the deviation of a value.
fn parameter(class: usize, i: usize) -> (String, &'static str) {
    let suffix = [COMPONENTS, COMPONENTS, ["xy", "xz", "yz"]][class][i];
    (format!("{}_{suffix}", CLASSES[class]), ["", "nT", "deg"][class])
}
