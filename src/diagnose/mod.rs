//! Where simulated and measured data disagree, which effect is missing, and how the gap shrinks with it.
//!
//! A run becomes rows with covariates and a linear model ([`crate::record::scene`]); jumps of thermistors are taken off ([`crate::record::faults`]). What happens inside the
//! plateaus is looked for in the samples ([`samples`]) and taken off. The noise of the means is estimated before anything is named; then
//! every term of the catalogue ([`crate::model::effects`]) and a smooth function of every covariate are scored beside the model ([`search`]),
//! the evidence of the best is averaged over all noise that the readings allow, the best term is added, all is fitted again, and terms
//! are dropped and swapped, until nothing significant is left. What is accepted has predicted stretches that were held out. Results are
//! plain structs ([`result`]).

pub mod across;
pub mod branches;
mod error;
pub mod freq;
pub mod inside_maps;
mod lag;
mod limits;
pub mod result;
pub mod samples;
pub mod search;
pub mod selection;
pub mod signature;
mod steps;
pub mod where_map;
pub mod words;

use crate::data::plateau::Plateaus;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::model::effects::thermal_lag::ThermalLag;
use crate::model::effects::time_shift::SHIFT;
use crate::model::effects::{Acts, Catalogue, EffectRef, Record, Row, Spec};
use crate::model::facility::Facility;
pub use crate::record::known::Given;
pub use crate::record::scene::Samples;
use crate::record::scene::Scene;
pub use error::DiagnoseError;
use limits::{hidden_drifts, limits};
use nalgebra::DMatrix;
use result::{Diagnosis, Evidence, Map, Pictures, Step};
use samples::Inside;
use search::{Candidate, Search, State};
use steps::{inside_step, joined, sufficient, term_step};

/// Two explanations are told apart by this ratio of likelihoods (logarithm).
const APART: f64 = 4.605;
/// Groups that look alike to this degree are one.
const ALIKE: f64 = 0.99;
/// Signal to noise ratio of a group that is found with 90 %, at one false alarm in a hundred runs.
const FOUND_90: f64 = 5.2;
/// From here on a name may be called certain.
const CERTAIN: f64 = 10.0;
/// An effect of which less than this part is left beside the fitted parameters cannot be shown.
const SHOWN: f64 = 0.02;

/// How a diagnosis is made.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The facility that turns settings into the reference field.
    pub facility: Option<Facility>,
    /// Effects that are known already. What acts between the means is fitted again; what acts inside the plateaus is taken off.
    pub given: Vec<Given>,
    /// The effects that are looked for.
    pub catalogue: Catalogue,
}

/// Diagnoses one run with fields in steps, a sweep, sines, or a run in zero field.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(
    run: &Run,
    plateaus: &Plateaus,
    samples: Option<&Samples>,
    campaign: &Campaign,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    if run.header.kind == Kind::Frequency {
        return freq::run(run, samples, campaign, options);
    }
    let samples = samples.filter(|s| !s.t_s.is_empty());
    let mut scene = Scene::new(run, plateaus, samples, &campaign.file.instructions, options.facility.as_ref())
        .map_err(|e| DiagnoseError::Record(e.0))?;
    let mut warnings = std::mem::take(&mut scene.warnings);
    let mut steps: Vec<Step> = scene.faults.iter().map(steps::fault_step).collect();
    let known: Vec<Inside> = options.given.iter().filter(|g| g.is_inside()).map(Inside::known).collect();
    let count_known = known.len();
    let mut inside: Vec<Inside> = known;
    let settings: Vec<[f64; 2]> = plateaus
        .list
        .iter()
        .filter(|p| p.setting.frequency_hz == 0.0)
        .map(|p| [p.setting.t_start_s, p.setting.t_end_s])
        .collect();
    let known_lag = options.given.iter().find_map(Given::thermal_lag);
    if let Some(lag) = known_lag {
        scene.follow(lag);
    }
    let between = options.given.iter().filter(|g| !g.is_inside() && !g.effect.is(&ThermalLag));
    let given: Vec<Candidate> = between.filter_map(|g| candidate(&scene.record, g.effect, &g.spec)).collect();

    let mut pictures = Pictures::default();
    let design_before = scene.design.clone();
    let raw = corrected(&scene, &inside);
    // A lag changes the temperatures that the model itself is a polynomial of: it is looked for first, and then built in.
    let mut has_lag = known_lag.is_some();
    if scene.record.thermal.is_some()
        && !has_lag
        && let Some((step, branches, evidence)) = lag::find(&mut scene, &raw, &given, steps.len(), &options.catalogue)
    {
        has_lag = true;
        steps.push(step);
        pictures.branches = Some(branches);
        pictures.evidence.push(evidence);
    }
    // What happens inside the plateaus next: its consequences for the means are known then.
    let steady = samples.map(|samples| scene.at_steady_temperature(samples, &settings));
    let samples = steady.as_deref();
    if let Some(samples) = samples {
        if scene.record.has_fields() {
            let shift = samples::displaced(&scene, samples);
            let skip_s = shift.as_ref().and_then(|s| s.spec.get(SHIFT)).map_or(0.0, f64::abs) * 1.5;
            let transient = samples::transient(&scene, samples, &settings, skip_s, &options.catalogue);
            let is_known = |found: &Inside| inside.iter().any(|k: &Inside| k.effect == found.effect);
            let new: Vec<Inside> = [shift, transient].into_iter().flatten().filter(|f| !is_known(f)).collect();
            for mut found in new {
                samples::measure(&scene, samples, &settings, &inside, &mut found);
                inside.push(found);
            }
        }
        let known = inside.clone();
        inside.extend(samples::periodic(&scene, samples, &known, &options.catalogue));
    }
    let readings = corrected(&scene, &inside);
    let mut search = Search::new(&scene, readings, &options.catalogue);
    if has_lag {
        search.leave_out(|c| c.effect.is(&ThermalLag));
    }
    if scene.record.has_samples {
        // The samples have told already.
        search.leave_out(|c| c.effect.acts_in(Acts::Samples));
    }
    let (terms, state) = search.run(&given).ok_or(DiagnoseError::NoNoise)?;
    let all: Vec<&Candidate> = given.iter().chain(terms.iter().map(|t| &t.candidate)).collect();

    let row_std = search.row_std(&state, &all);
    let noise_floor_nt = std::array::from_fn(|a| row_std[0][a] * scene.nt_per_ent[a]);
    let mut maps = Vec::new();
    for (index, found) in inside.iter().enumerate().skip(count_known) {
        let picture = samples.and_then(|s| inside_maps::of(&scene, s, &settings, &inside[..index], found, steps.len()));
        pictures.inside.extend(picture);
        steps.push(inside_step(found, &scene));
    }
    let found_before = steps.len();
    for (index, term) in terms.iter().enumerate() {
        let at = given.len() + index;
        steps.push(term_step(&search, &state, &all, at, term, &row_std, found_before + index, &mut maps, &mut pictures));
    }
    let (mut steps, places) = joined(steps);
    // A further form of an effect has no picture of its own.
    let place = |step: usize| places.get(step).copied().flatten();
    maps = maps.into_iter().filter_map(|m| Some(Map { step: place(m.step)?, ..m })).collect();
    let evidence = std::mem::take(&mut pictures.evidence);
    pictures.evidence = evidence.into_iter().filter_map(|e| Some(Evidence { step: place(e.step)?, ..e })).collect();
    pictures.left = quiet_maps(&search, &state, &all, noise_floor_nt);
    let before = where_map::Model {
        record: &scene.record,
        readings: &raw,
        design: &design_before,
        given: given.iter().map(|g| &g.stacked).collect(),
        nt_per_ent: scene.nt_per_ent,
    };
    pictures.places = where_map::places(&before, &state.noise);
    sufficient(&mut steps);
    let (not_identifiable, detection_limits) = limits(&search, &state, &steps, &options.catalogue);
    warnings.extend(hidden_drifts(&search, &state, &all, &steps));
    if run.vectors.lost > 0 {
        warnings.push(format!("{} samples are missing in {} gaps", run.vectors.lost, run.vectors.gap_count));
    }
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![run.header.run.clone()],
        noise_floor_nt,
        noise: Some(state.noise.colour),
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits,
        response: None,
        warnings,
        reading_ent: std::array::from_fn(|a| {
            let readings = search.scene.record.rows.iter().map(|r| r.linear_ent[a]);
            readings.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        }),
        maps,
        pictures,
    })
}

fn candidate(record: &Record, effect: EffectRef, spec: &Spec) -> Option<Candidate> {
    Some(Candidate::new(effect, spec.clone(), effect.columns(record, spec)?))
}

/// Readings without what was found in the samples, enT.
fn corrected(scene: &Scene, inside: &[Inside]) -> DMatrix<f64> {
    let mut readings = scene.readings.clone();
    for found in inside {
        let columns = found.effect.columns(&scene.record, &found.spec).unwrap_or_default();
        for (column, (value, _)) in columns.iter().zip(&found.values) {
            for i in 0..readings.nrows() {
                for a in 0..3 {
                    readings[(i, a)] -= value * column.values[i][a];
                }
            }
        }
    }
    readings
}

/// What the whole model leaves of the readings.
fn quiet_maps(search: &Search, state: &State, all: &[&Candidate], noise_floor_nt: [f64; 3]) -> Vec<Map> {
    let held = search.held_out(&state.noise, all);
    (0..3)
        .map(|axis| {
            let record = &search.scene.record;
            let nt: Vec<f64> = held.residual_ent.column(axis).iter().map(|r| r * search.scene.nt_per_ent[axis]).collect();
            Map {
                covariate: "time".to_owned(),
                unit: "s".to_owned(),
                axis,
                x: record.rows.iter().map(Row::t_s).collect(),
                before_nt: nt.clone(),
                after_nt: nt,
                noise_nt: noise_floor_nt[axis],
                step: 0,
            }
        })
        .collect()
}

/// Kinds of runs that [`run`] takes.
#[must_use]
pub fn takes(kind: Kind) -> bool {
    matches!(kind, Kind::Linearity | Kind::Sweep | Kind::ZeroField | Kind::Frequency)
}
