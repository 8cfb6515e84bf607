//! What the search in means found, of a run or of a flight, as a diagnosis: steps with what is drawn of them, what is left, limits, notes.

use super::beside::Beside;
use super::candidate::Candidate;
use super::left::{self, OUTLIER, Rest, StandingOut};
use super::limits::{hidden_drifts, limits};
use super::means::{Means, MeansModel, Term};
use super::problem::{self, Outcome};
use super::result::{Diagnosis, Evidence, Map, Pictures, Step, VerdictKind};
use super::steps::{joined, sufficient};
use super::{where_map, words};
use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::model::effects::{Catalogue, Row};
use nalgebra::DMatrix;

/// A search in means that came to its end, and what stands beside it.
pub(super) struct Searched<'a> {
    /// The means.
    pub means: &'a Means<'a>,
    /// What was found in them.
    pub outcome: &'a Outcome<Term, MeansModel>,
    /// The effects that were looked for.
    pub catalogue: &'a Catalogue,
    /// Readings before anything was named.
    pub readings: &'a DMatrix<f64>,
    /// Columns of the linear model before anything was named.
    pub design: &'a DMatrix<f64>,
    /// Runs, or what the means are of.
    pub runs: Vec<String>,
    /// Smallest and largest reading of each axis, without offset.
    pub reading_ent: [[f64; 2]; 3],
    /// What was found before.
    pub steps: Vec<Step>,
    /// What is drawn of it.
    pub pictures: Pictures,
    /// What the samples show that no effect explains.
    pub beside: Beside,
    /// What was noted before.
    pub notes: Vec<Note>,
}

impl Searched<'_> {
    /// The diagnosis.
    pub fn diagnosis(self) -> Diagnosis {
        let Searched { means, outcome, mut pictures, beside, mut notes, .. } = self;
        let all = means.all(&outcome.terms);
        let before = self.steps.len();
        let Rest { left, open } = left::left(means, &outcome.fit, &all);
        let (mut steps, maps, places) = steps_of_all(means, outcome, self.steps, &mut pictures, open);
        beside.doubt(&mut steps, &means.prepared.record);
        // What the means leave concerns every calibration; where it is nothing, the samples may tell more.
        let left = left.or(beside.left);
        let numbers: Vec<usize> = places.iter().map(|place| place + 1).collect();
        let gap_chain = left::chain(means, &outcome.fit, &all, &numbers[before..], numbers[..before].to_vec());
        let noise_floor_nt = means.mean_noise_nt(&means.row_std(&outcome.fit, &all));
        pictures.scale = means.prepared.record.scale;
        pictures.left = quiet_maps(means, &outcome.fit, &all, noise_floor_nt);
        let model = where_map::Model {
            record: &means.prepared.record,
            readings: self.readings,
            design: self.design,
            given: means.given.iter().map(|g| &g.columns).collect(),
            nt_per_ent: means.prepared.nt_per_ent,
        };
        pictures.places = where_map::places(&model, &outcome.fit.noise);
        let (not_identifiable, detection_limits) = limits(means, &outcome.fit, &steps, self.catalogue);
        notes.extend(hidden_drifts(means, &outcome.fit, &all, &steps));
        notes.extend(plateaus_apart(means, &all));
        Diagnosis {
            format: "diagnosis",
            version: 1,
            runs: self.runs,
            noise_floor_nt,
            noise: Some(outcome.fit.noise.parameters),
            basis: None,
            verdict: words::verdict(&steps, None, left.as_ref()),
            verdict_kind: VerdictKind::of(&steps, left.as_ref()),
            left,
            gap_chain,
            steps,
            not_identifiable,
            detection_limits,
            response: None,
            notes,
            reading_ent: self.reading_ent,
            maps,
            pictures,
        }
    }
}

/// The steps so far and those of the means, one per effect, with their maps, and where each went; their evidence goes to the pictures. On `open`
/// axes the gap is not closed.
fn steps_of_all(
    means: &Means,
    outcome: &Outcome<Term, MeansModel>,
    mut steps: Vec<Step>,
    pictures: &mut Pictures,
    open: [bool; 3],
) -> (Vec<Step>, Vec<Map>, Vec<usize>) {
    let (of_means, maps, evidence) = problem::steps(means, outcome, steps.len());
    steps.extend(of_means);
    pictures.evidence.extend(evidence);
    let (mut steps, places) = joined(steps);
    // A further form of an effect has no picture of its own.
    let place = |step: usize| places.get(step).filter(|p| p.is_first).map(|p| p.step);
    let maps = maps.into_iter().filter_map(|m| Some(Map { step: place(m.step)?, ..m })).collect();
    let evidence = std::mem::take(&mut pictures.evidence);
    pictures.evidence = evidence.into_iter().filter_map(|e| Some(Evidence { step: place(e.step)?, ..e })).collect();
    sufficient(&mut steps, &means.prepared.record, open);
    (steps, maps, places.iter().map(|p| p.step).collect())
}

/// Says where plateaus stand out.
fn plateaus_apart(means: &Means, all: &[&Candidate]) -> Vec<Note> {
    let note = |apart: StandingOut| {
        let axis = COMPONENTS[apart.axis];
        let text = format!(
            "{axis} stands out by more than {OUTLIER:.0} standard deviations at {} s: plateaus that were disturbed, which no effect explains",
            apart.times_s(means)
        );
        Note::new(NoteKind::Fit, text).about(axis)
    };
    left::standing_out(means, all).into_iter().map(note).collect()
}

/// What the whole model leaves of the readings.
fn quiet_maps(means: &Means, model: &MeansModel, all: &[&Candidate], noise_floor_nt: [f64; 3]) -> Vec<Map> {
    let held = means.predicted(&model.noise, all);
    (0..3)
        .map(|axis| {
            let record = &means.prepared.record;
            let nt: Vec<f64> = held.residual_ent.column(axis).iter().map(|r| r * means.prepared.nt_per_ent[axis]).collect();
            Map {
                covariate: "time".to_owned(),
                unit: "s".to_owned(),
                axis,
                x: record.rows.iter().map(Row::t_s).collect(),
                before_nt: nt.clone(),
                after_nt: nt,
                noise_nt: noise_floor_nt[axis],
                step: 0,
                names: Vec::new(),
            }
        })
        .collect()
}
