//! Frequency runs: what amplitudes and phases of sines show beside a simple response and a steady clock.
//!
//! Every undamaged setting becomes three numbers per component ([`sines`]): amplitude, phase, and how fast the phase runs away. A response
//! of at most two parameters is fitted to all of them ([`model`]; mathematics section 3), with a sampling frequency per component. Where the
//! phase of the field at the begin of a setting is not known, only differences of the phases between components count. Then the effects of
//! the catalogue are tried beside it, on noise that was seen near every sine. Lost samples are no term of a response: they are seen in
//! the counters and in stretches that do not follow their sine.

mod candidates;
mod describe;
mod in_time;
mod limits;
mod lost;
pub mod model;
mod problem;
mod response;
pub mod sines;
mod table;

pub use table::table;

use super::problem::{search, steps};
use super::result::{Diagnosis, Left, LeftLike, Pictures, Step, VerdictKind};
use super::steps::fault_facts;
use super::{DiagnoseError, Options, words};
use crate::data::note::{Note, NoteKind};
use crate::data::run::{Run, Vector, VectorSink};
use crate::data::units::{COMPONENTS, Reading};
use crate::files::campaign::Campaign;
use crate::fit::statistics::median;
use crate::measure::freq::{self as analysis, Freq, Sines as Sink};
use crate::record::prepared::Samples;
use crate::record::temperature_faults;
use describe::map;
use limits::limits;
use lost::lost;
use model::{EffectTerm, Fit};
use nalgebra::DVector;
use problem::SineSearch;
use response::{another_base, base, response_words};
use sines::Sines;

/// Chi-square over degrees of freedom from which the base itself is doubted, and all names beside it.
const DOUBTFUL: f64 = 1.5;
/// What is left is told from this many times the noise of the sines on.
const NOT_EXPLAINED: f64 = 3.0;
/// Settings that are held out at once.
const STRETCH: usize = 3;

/// Diagnoses a run with sines.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(run: &Run, samples: Option<&Samples>, campaign: &Campaign, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    let samples = samples.filter(|s| !s.t_s.is_empty()).ok_or(DiagnoseError::NoSamples)?;
    let freq = analysed(run, samples, campaign)?;
    let span_s = [samples.t_s[0], samples.t_s[samples.t_s.len() - 1]];
    let (faults, _) = temperature_faults::without_jumps(&run.temperatures, span_s);
    let mut found: Vec<Step> = faults.iter().map(|fault| fault_facts(fault).step()).collect();
    found.extend(lost(run, samples, &freq));
    let mut notes = Vec::new();

    let mut sines = Sines::new(samples, &freq, &run.temperatures)?;
    let simple = base(&freq, &mut sines)?;
    let sines = sines;
    let given = known_terms(run, options, &sines, &mut notes);
    if !sines.run.begins_known {
        notes.push(Note::new(
            NoteKind::Method,
            "the phases of the field are not those of sines that begin with their settings: phases count between components and within \
             settings only",
        ));
    }
    let simple = with_given(with_small_delay(simple, &sines), &given, &sines);
    let mut problem = SineSearch { sines: &sines, catalogue: &options.catalogue, base: simple, ruled_out: Vec::new() };
    if let Some(other) = in_place_of_doubted(&problem, &freq) {
        problem.base = with_given(other, &given, &sines);
    }
    // Every model that was chosen has a fit.
    let outcome = search(&mut problem).ok_or(DiagnoseError::NoPhases)?;
    notes.extend(outcome.note());
    let fit = &outcome.fit;
    let (of_sines, maps, _) = steps(&problem, &outcome, found.len());
    found.extend(of_sines);
    let held = fit.held_out(&sines, STRETCH);
    let not_explained = not_explained(fit, &sines, &held);
    // What is left is told later than it lets doubt what was found.
    if fit.chi2 > DOUBTFUL * fit.dof() {
        found.iter_mut().for_each(Step::doubt);
    }
    let left = (0..3).map(|axis| map(&sines, axis, false, &held, &held, 0)).collect();
    let scored = problem.scored(fit, &outcome.terms);
    let (not_identifiable, detection_limits) = limits(&scored, &sines, &found, &options.catalogue);
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![run.header.run.clone()],
        noise_floor_nt: noise_floor_nt(&sines),
        noise: None,
        basis: None,
        verdict: words::verdict(&found, None, not_explained.as_ref()),
        verdict_kind: VerdictKind::of(&found, not_explained.as_ref()),
        left: not_explained,
        gap_chain: Vec::new(),
        steps: found,
        not_identifiable,
        detection_limits,
        response: Some(response_words(fit, &sines)),
        notes,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures: Pictures { left, ..Pictures::default() },
    })
}

/// What the response and all terms leave of the sines, if that is far more than their noise.
fn not_explained(fit: &Fit, sines: &Sines, held: &DVector<f64>) -> Option<Left> {
    let times_noise = (fit.chi2 / fit.dof()).sqrt();
    let rms_nt = describe::gap(sines, held, fit.p.len(), false).rms_nt;
    let axis = (0..3).max_by(|a, b| rms_nt[*a].total_cmp(&rms_nt[*b])).unwrap_or(0);
    let place = format!("{}, along the frequency", COMPONENTS[axis]);
    (times_noise > NOT_EXPLAINED).then_some(Left { place, rms_nt: rms_nt[axis], times_noise, like: LeftLike::Disagreement })
}

/// The frequency analysis of the run.
fn analysed(run: &Run, samples: &Samples, campaign: &Campaign) -> Result<Freq, DiagnoseError> {
    let mut sink = Sink::default();
    sink.begin(&run.header, &run.settings);
    for ((n, t_s), reading) in samples.n.iter().zip(&samples.t_s).zip(&samples.reading_ent) {
        sink.vector(Vector { n: *n, t_s: *t_s, reading: Reading(*reading) });
    }
    Ok(analysis::freq(run, &sink, &campaign.file.instructions, &analysis::Options::default())?)
}

/// Where the record begins is known to a part of a sample: a small delay belongs to the model and is no effect.
fn with_small_delay(base: Fit, sines: &Sines) -> Fit {
    let shift = EffectTerm::shift();
    if !sines.run.begins_known || base.model.terms.iter().any(|t| t.is_like(&shift)) {
        return base;
    }
    let is_small = |with: &Fit| with.p.last().is_some_and(|us| !shift.is_reported(&[*us], &sines.run));
    base.with(&shift, &[0.0], sines).filter(is_small).unwrap_or(base)
}

/// A model with the known effects that it does not have yet.
fn with_given(fit: Fit, given: &[(EffectTerm, Vec<f64>)], sines: &Sines) -> Fit {
    given.iter().fold(fit, |fit, (term, values)| {
        let wanted = !fit.model.terms.iter().any(|t| t.is_same(term));
        wanted.then(|| fit.with(term, values, sines)).flatten().unwrap_or(fit)
    })
}

/// Another response in place of one that leaves more than noise although the best candidate was added to it, if there is a better one.
fn in_place_of_doubted(problem: &SineSearch, freq: &Freq) -> Option<Fit> {
    let base = &problem.base;
    if base.chi2 <= DOUBTFUL * base.dof() {
        return None;
    }
    let best = problem.promising(base, &[])?.refined.into_iter().next()?;
    another_base(freq, &best, problem.sines)
}

fn noise_floor_nt(sines: &Sines) -> [f64; 3] {
    std::array::from_fn(|i| {
        median(&mut sines.list.iter().map(|s| s.tones[i].std[0] * s.tones[i].log_amplitude.exp()).collect::<Vec<f64>>())
    })
}

/// The known effects that act on the sines of this run, with their values; a note tells what the run cannot have.
fn known_terms(run: &Run, options: &Options, sines: &Sines, notes: &mut Vec<Note>) -> Vec<(EffectTerm, Vec<f64>)> {
    let of_this_run = options.given.iter().filter(|g| g.of_another(&run.header.run).is_none());
    of_this_run
        .filter_map(|given| {
            let term = given.effect.known_sine_term(given.in_sine.as_ref()?, &sines.run);
            let term = term.map(|(form, values)| (EffectTerm::new(given.effect, form), values));
            if term.is_none() {
                let text = format!("{} ({}) needs a temperature that the run does not have", given.effect, given.spec.form);
                notes.push(Note::new(NoteKind::Temperature, text).about(given.effect.as_str()));
            }
            term
        })
        .collect()
}
