//! What is missing between runs: the parameters of several runs disagree where nothing may differ.
//!
//! Every run gives nine values: ln σ (3), offset (3, nT) and ξ (3, degrees). What is common to the runs of a sensor is fitted, with
//! polynomials of its temperature where the runs span temperatures; candidates are the first-order consequences of wrong facility
//! parameters (docs/mathematics.md, "The coil system", CH-GFZ-TR-2601 sections 7 and 9), of temperatures, of time and of a place beside the
//! centre. The scatter of each of the three classes has its own unknown scale. Where the runs bring uncertainties and do not contradict
//! them, these count as values without parameters; otherwise the scatter is known from repeats and from what the model leaves.

mod candidates;
mod describe;
mod limits;
mod problem;
mod run_set;
mod values;

use super::candidate::Candidate;
use super::problem::{search, steps};
use super::result::{Diagnosis, Left, LeftLike, NotIdentifiable, Pictures, VerdictKind};
use super::{DiagnoseError, words};
use crate::data::note::{Note, NoteKind};
use crate::data::units::counted;
use crate::fit::statistics::{chi2_tail, fisher_tail};
use crate::model::effects::{Catalogue, Spec, UNKNOWN};
use crate::model::position::PAIRS;
use candidates::candidates;
use describe::{by_orientations, map_of};
use limits::limits;
use nalgebra::DMatrix;
use problem::{Comparison, chosen_candidates};
use run_set::{RunCandidate, RunSet, count};
pub use values::RunValues;

/// Classes of values that have a scatter of their own, as parameters are named and in words.
const CLASSES: [&str; 3] = ["sigma", "offset", "xi"];
const CLASSES_IN_WORDS: [&str; 3] = ["sensitivity", "offset", "angle"];
/// Uncertainties are not believed where the best models leave so unlikely a scatter.
const CONTRADICTED: f64 = 0.01;
/// The scatter of three classes needs as many degrees of freedom.
const LEAST_FREEDOM: f64 = 3.0;
/// As many orientations must agree before another one can stand out.
const LEAST_AGREEING: usize = 3;

/// Sensor axis whose reading an angle between two axes changes: the later one, as ω is triangular.
fn axis_of(class: usize, i: usize) -> usize {
    if class == 2 { PAIRS[i].1 } else { i }
}

/// Diagnoses runs together.
///
/// # Errors
/// Why these runs show nothing together.
pub fn across(runs: &[RunValues], catalogue: &Catalogue) -> Result<Diagnosis, DiagnoseError> {
    let mut notes = Vec::new();
    let runs = of_sensors_with_several(runs, &mut notes)?;
    let (mut comparison, mut not_identifiable) = comparison(&runs, catalogue, &mut notes)?;
    // A model of few linear terms always has a fit.
    let outcome = search(&mut comparison).ok_or(DiagnoseError::NoFreedom)?;
    notes.extend(outcome.note());
    let set = &comparison.set;
    let terms = chosen_candidates(&outcome.terms);
    let scales = set.scales(&outcome.fit);
    let (mut steps, mut maps, _) = steps(&comparison, &outcome, 0);
    let caution = by_orientations(set, &terms).map(|p| {
        format!("where every orientation counts once, noise alone gives as much as one of them with a probability of {p:.2}")
    });
    let noise_floor_nt = noise_floor_nt(set, &scales);
    let not_explained = remaining(set, &terms, &mut notes);
    if not_explained.is_some() {
        steps.iter_mut().for_each(|s| s.wording = "consistent with");
    }
    if maps.is_empty() {
        let deviations = set.held_out(&[], &scales);
        maps = (0..3).map(|a| map_of(set, 1, a, 0, [&deviations; 2], noise_floor_nt[a])).collect();
    }
    let detection_limits = limits(&comparison, &outcome.fit, &scales, &steps, &mut not_identifiable);
    let (n, orientations) = (set.count(), count(&set.orientation));
    let basis = format!(
        "{}, {}; every run in turn was held out; nT of scale factors and angles at the largest field of the run",
        counted(n as u64, "run"),
        counted(orientations as u64, "orientation")
    );
    let left = if steps.is_empty() { maps.clone() } else { Vec::new() };
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: runs.iter().map(|r| r.run.clone()).collect(),
        noise_floor_nt,
        noise: None,
        basis: Some(basis),
        verdict: words::verdict(&steps, caution.as_deref(), not_explained.as_ref()),
        verdict_kind: VerdictKind::of(&steps, not_explained.as_ref()),
        left: not_explained,
        gap_chain: Vec::new(),
        steps,
        not_identifiable,
        detection_limits,
        notes,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        response: None,
        pictures: Pictures { left, ..Pictures::default() },
    })
}

/// The runs of sensors that have several.
fn of_sensors_with_several(runs: &[RunValues], notes: &mut Vec<Note>) -> Result<Vec<RunValues>, DiagnoseError> {
    let has_others = |run: &RunValues| runs.iter().filter(|r| r.sensor == run.sensor).count() > 1;
    let (kept, alone): (Vec<RunValues>, Vec<RunValues>) = runs.iter().cloned().partition(has_others);
    if kept.is_empty() {
        return Err(DiagnoseError::SingleRuns);
    }
    let note = |r: &RunValues| {
        let text = format!("run {} is the only one of sensor {} and was not used", r.run, r.sensor);
        Note::new(NoteKind::LeftOut, text).about(r.run.as_str())
    };
    notes.extend(alone.iter().map(note));
    Ok(kept)
}

/// The runs with everything that may make them disagree, and what of the catalogue they cannot show.
fn comparison<'a>(
    runs: &'a [RunValues],
    catalogue: &Catalogue,
    notes: &mut Vec<Note>,
) -> Result<(Comparison<'a>, Vec<NotIdentifiable>), DiagnoseError> {
    let mut set = RunSet::new(runs);
    let (candidates, not_identifiable) = candidates(&set, catalogue);
    let left: f64 = (0..3).map(|c| set.left(c, &[]).1).sum();
    if left < LEAST_FREEDOM {
        return Err(DiagnoseError::NoFreedom);
    }
    if runs.iter().any(|r| r.field_nt.is_none()) {
        let text = "a run states no field: the deviations of its scale factors and angles have no size in nT";
        notes.push(Note::new(NoteKind::Method, text));
    }
    set.anchor(&candidates, notes);
    Ok((Comparison::new(set, candidates), not_identifiable))
}

/// Noise of a run along each sensor axis, nT: of all values that belong to the axis together.
fn noise_floor_nt(set: &RunSet, scales: &[f64; 3]) -> [f64; 3] {
    let n = set.count();
    std::array::from_fn(|a| {
        let mut sum = 0.0;
        for (r, run) in set.runs.iter().enumerate() {
            for class in 0..3 {
                for i in (0..3).filter(|i| axis_of(class, *i) == a) {
                    sum += (set.std[(class * n + r) * 3 + i] * scales[class] * run.nt_per_unit(class)).powi(2);
                }
            }
        }
        (sum / n as f64).sqrt()
    })
}

/// The class in which the runs still disagree most, if they do; says by how much.
fn remaining(set: &RunSet, terms: &[&RunCandidate], notes: &mut Vec<Note>) -> Option<Left> {
    let (n, orientations) = (set.count(), count(&set.orientation));
    let mut most: Option<Left> = None;
    for class in 0..3 {
        let (sum, freedom) = set.left(class, terms);
        // What every orientation may have of its own leaves the repeats.
        let own = DMatrix::from_fn(9 * n, 9 * orientations, |row, c| {
            let (k, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if set.orientation[r] == c / 9 && (c % 9) / 3 == k && c % 3 == i { 1.0 } else { 0.0 }
        });
        let free = Candidate::new(UNKNOWN, None, Spec::new("", &[]), Vec::new(), own);
        let free = RunCandidate { candidate: free, cause: None, alone: None };
        let with: Vec<&RunCandidate> = terms.iter().copied().chain(std::iter::once(&free)).collect();
        let (within, within_freedom) = set.left(class, &with);
        let (between, between_freedom) = (sum - within, freedom - within_freedom);
        if between_freedom < 0.5 {
            continue;
        }
        let (p, noise) = if within_freedom > 1.5 {
            let noise = within / within_freedom;
            (fisher_tail(between / between_freedom / noise, [between_freedom, within_freedom]), noise)
        } else if set.anchors[class] > 0 {
            (chi2_tail(between, between_freedom), 1.0)
        } else {
            continue;
        };
        if p < CONTRADICTED {
            let ratio = (between / between_freedom / noise).sqrt();
            if most.as_ref().is_none_or(|m| ratio > m.times_noise) {
                let place = format!("{}, between the orientations", CLASSES_IN_WORDS[class]);
                let rms_nt = ratio * noise.sqrt() * usual_nt(set, class);
                most = Some(Left { place, rms_nt, times_noise: ratio, like: LeftLike::Disagreement });
            }
            let text = format!(
                "{}: the orientations still differ by {ratio:.1} times what repeats let expect (p = {p:.1e}), and nothing that was tried explains it",
                CLASSES[class]
            );
            notes.push(Note::new(NoteKind::Method, text).about(CLASSES[class]));
        }
    }
    most
}

/// Root mean square of the stated uncertainties of a class, nT.
fn usual_nt(set: &RunSet, class: usize) -> f64 {
    let n = set.count();
    let of_run = |r: usize| (0..3).map(move |i| set.std[(class * n + r) * 3 + i] * set.runs[r].nt_per_unit(class));
    ((0..n).flat_map(of_run).map(|nt| nt * nt).sum::<f64>() / (3 * n) as f64).sqrt()
}
