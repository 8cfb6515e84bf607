//! One run with plateaus: damaged data, then a lag of the thermistor, then the samples, then the plateau means.

use super::beside::Beside;
use super::candidate::Candidate;
use super::conclusion::Searched;
use super::fault::{self, FoundFault};
use super::lag::FoundLag;
use super::means::Means;
use super::problem;
use super::result::{Diagnosis, Pictures, Step};
use super::samples::{self, AroundMeans, Coarse, Inside};
use super::steps::{fit_into, inside_step};
use super::{DiagnoseError, Given, Options, inside_maps, lag};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateaus;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::model::effects::in_samples::InSamples;
use crate::model::effects::remanence::{self, Remanence};
use crate::model::effects::thermal_lag::ThermalLag;
use crate::model::effects::time_shift::{SHIFT, TimeShift};
use crate::model::effects::{Acts, Catalogue, EffectRef, MODULUS, Record, Spec};
use crate::model::sensor_polynomials::SensorPolynomials;
use crate::record::conditions;
use crate::record::position::the_position;
use crate::record::prepared::{PreparedRun, Samples};
use crate::record::screens;
use nalgebra::DMatrix;

/// Samples nearer to an edge than this many displacements do not show transients.
const SKIPPED_SHIFTS: f64 = 1.5;

/// What the means remember of the setting before may be a slower part of a transient up to this part of the transient: in 2000 runs of the blind study
/// with a second time constant it was 0.22 at most.
const MOST_SLOW_PART: f64 = 0.25;
/// A transient takes of the means what it is too large by, which is not beyond so many of its standard uncertainties.
const UNSURE: f64 = 2.0;
/// What is so many standard uncertainties is told.
const SHOWN_PART: f64 = 3.0;

/// What the samples show.
struct Shown {
    /// What was known before, then what was found.
    all: Vec<Inside>,
    /// How many were known before.
    known: usize,
    /// What they leave of the samples around the means.
    around: Option<AroundMeans>,
}

impl Shown {
    fn found(&self) -> &[Inside] {
        &self.all[self.known..]
    }
}

/// Diagnoses one run with plateaus.
///
/// # Errors
/// Why the run cannot be looked at.
pub(super) fn run(
    run: &Run,
    plateaus: &Plateaus,
    samples: Option<&Samples>,
    campaign: &Campaign,
    options: &Options,
) -> Result<Diagnosis, DiagnoseError> {
    let samples = samples.filter(|s| !s.t_s.is_empty());
    let mut prepared = PreparedRun::new(run, plateaus, samples, &campaign.file.instructions, options.facility.as_ref())
        .map_err(|e| DiagnoseError::Record(e.0))?;
    let mut notes = std::mem::take(&mut prepared.notes);
    let known: Vec<Inside> = options.given.iter().filter(|g| g.is_inside()).map(Inside::known).collect();
    let readings = |prepared: &PreparedRun| corrected(prepared, &known);
    let (faults, of_faults) = fault::weigh(&mut prepared, run, readings, &options.given, &options.catalogue);
    notes.extend(of_faults);
    if let Some(polynomials) = options.temperature.as_ref().filter(|_| run.header.kind == Kind::Linearity) {
        notes.push(at_one_temperature(&mut prepared, polynomials, run, plateaus, campaign)?);
    }
    let mut pictures = Pictures::default();
    let mut steps: Vec<Step> = Vec::new();
    for FoundFault { facts, evidence } in faults {
        steps.push(facts.step());
        pictures.evidence.extend(evidence);
    }
    let known_lag = options.given.iter().find_map(Given::thermal_lag);
    if let Some(lag) = known_lag {
        prepared.follow(lag);
    }
    let given = given_between(&prepared.record, &options.given);

    let design_before = prepared.design.clone();
    let raw = corrected(&prepared, &known);
    // A lag changes the temperatures that the model itself is a polynomial of: it is looked for first, and then built in.
    let lag = (known_lag.is_none() && prepared.record.thermal.is_some())
        .then(|| lag::find(&mut prepared, &raw, &given, steps.len(), &options.catalogue))
        .flatten();
    let has_lag = known_lag.is_some() || lag.is_some();
    if let Some(FoundLag { facts, branches, evidence }) = lag {
        steps.push(facts.step());
        pictures.branches = Some(branches);
        pictures.evidence.push(evidence);
    }
    // What happens inside the plateaus next: its consequences for the means are known then.
    let settings = settings_s(plateaus);
    let recorded = samples;
    let steady = samples.map(|samples| prepared.at_steady_temperature(samples, &settings));
    let samples = steady.as_deref();
    let inside = in_samples(&prepared, samples, &settings, known, &options.catalogue);

    let is_displaced = inside.all.iter().any(|f| f.effect.is(&TimeShift));
    let readings = corrected(&prepared, &inside.all);
    if prepared.record.has_fields() && !is_displaced {
        // Of readings that are not those of the settings nothing that was found would be true.
        screens::followed(&readings, &prepared.left_by_design(&readings))?;
    }
    let mut means = Means::new(&prepared, readings, &options.catalogue, given);
    means.leave_out(|c| is_found_elsewhere(c.effect, &prepared.record, has_lag));
    if let Some(recorded) = recorded.filter(|_| prepared.record.has_fields()) {
        // Settings without a field all keep the same part of a step, which stands out among the others.
        let coarse = samples::coarse(recorded, &settings);
        let is_coarse = |c: &Candidate| coarse.iter().any(|one| c.spec.axes.contains(&one.axis));
        means.leave_out(|c| c.covariate.as_deref() == Some(MODULUS) && is_coarse(c));
        notes.extend(coarse.iter().map(Coarse::note));
    }
    for found in inside.found() {
        notes.extend(with_slow_part(&mut means, found));
    }
    let outcome = problem::search(&mut means).ok_or(DiagnoseError::NoNoise)?;
    notes.extend(outcome.note());

    if let Some(samples) = samples.filter(|_| !options.without_insides) {
        pictures.inside = inside_maps::of(&prepared, samples, &settings, &inside.all, inside.known, steps.len());
    }
    for (found, fits_settings) in inside.found().iter().zip(fit_into(inside.found(), &settings)) {
        steps.push(inside_step(found, &prepared, is_displaced, fits_settings));
    }
    // A displacement of less than a sample or so is no effect of its own, but what the means are made of. One that was found is a step.
    let mut of_plateaus: Vec<Note> = Vec::new();
    conditions::warn_of_plateaus(&mut of_plateaus, run, plateaus);
    notes.extend(of_plateaus.into_iter().filter(|note| !is_displaced || note.kind != NoteKind::Mismatch));
    // What follows the steps of the field is larger in some settings than in others.
    if !inside.all.iter().any(|f| f.effect.in_samples().is_some_and(InSamples::follows_steps)) {
        notes.extend(samples::loud(plateaus));
    }
    let beside = Beside::of(&prepared, [recorded, samples], plateaus, &inside.all, inside.around.as_ref(), &mut notes);
    if run.vectors.lost > 0 {
        let text = conditions::lost(run.vectors.lost, run.vectors.gap_count);
        notes.push(Note::new(NoteKind::Data, text));
    }
    let searched = Searched {
        means: &means,
        outcome: &outcome,
        catalogue: &options.catalogue,
        readings: &raw,
        design: &design_before,
        runs: vec![run.header.run.clone()],
        reading_ent: reading_ranges_ent(&prepared.record),
        steps,
        pictures,
        beside,
        notes,
    };
    Ok(searched.diagnosis())
}

/// Known effects that act between the means: their sizes are fitted again. A lag is built into the temperatures.
pub(super) fn given_between(record: &Record, given: &[Given]) -> Vec<Candidate> {
    let between = given.iter().filter(|g| !g.is_inside() && !g.effect.is(&ThermalLag));
    between.filter_map(|g| candidate(record, g.effect, &g.spec)).collect()
}

fn candidate(record: &Record, effect: EffectRef, spec: &Spec) -> Option<Candidate> {
    Some(Candidate::of_readings(effect, spec.clone(), effect.columns(record, spec)?))
}

/// Begin and end of the settings without sines, s.
fn settings_s(plateaus: &Plateaus) -> Vec<[f64; 2]> {
    let steady = plateaus.list.iter().filter(|p| p.setting.frequency_hz == 0.0);
    steady.map(|p| [p.setting.t_start_s, p.setting.t_end_s]).collect()
}

/// What happens inside the plateaus: displaced edges and transients where fields are applied, and periodic signals.
fn in_samples(
    prepared: &PreparedRun,
    samples: Option<&Samples>,
    settings: &[[f64; 2]],
    known: Vec<Inside>,
    catalogue: &Catalogue,
) -> Shown {
    let mut inside = Shown { known: known.len(), all: known, around: None };
    let Some(samples) = samples else { return inside };
    if prepared.record.has_fields() {
        let shift = samples::displaced(prepared, samples);
        let skip_s = shift.as_ref().and_then(|s| s.spec.get(SHIFT)).map_or(0.0, f64::abs) * SKIPPED_SHIFTS;
        let transient = samples::transient(prepared, samples, settings, skip_s, catalogue);
        let is_known = |found: &Inside| inside.all.iter().any(|k: &Inside| k.effect == found.effect);
        let new: Vec<Inside> = [shift, transient].into_iter().flatten().filter(|f| !is_known(f)).collect();
        for mut found in new {
            samples::measure(prepared, samples, settings, &inside.all, &mut found);
            inside.all.push(found);
        }
    }
    let periodic = samples::periodic(prepared, samples, &inside.all, catalogue);
    inside.all.extend(periodic.found);
    inside.around = periodic.left;
    inside
}

/// Fits a memory of the setting before with the means, where it is a small part of a transient that was found: a part of this that decays slower
/// than its first seconds say shows in no sample of one setting, and is such a memory in the means. A larger memory is left to the search.
fn with_slow_part(means: &mut Means, found: &Inside) -> Option<Note> {
    if !matches!(found.effect.in_samples(), Some(InSamples::Transient(_))) {
        return None;
    }
    let remanence = EffectRef::new(&Remanence);
    let memory = candidate(&means.prepared.record, remanence, &remanence::of_one_cause(&found.spec.axes))?;
    let (amplitude, of_transient) = found.values.first().map(|(value, std)| (value.abs(), *std)).filter(|(v, _)| *v > 0.0)?;
    let terms: Vec<&Candidate> = means.given.iter().chain([&memory]).collect();
    let estimates = means.estimates(&means.model(&terms)?, &terms)?;
    let (part, std) = estimates.last()?.first().map(|(value, std)| (value / amplitude, std / amplitude))?;
    if !is_small(part, of_transient / amplitude) {
        return None;
    }
    means.given.push(memory);
    (part.abs() > SHOWN_PART * std).then(|| {
        let text = format!(
            "the plateau means remember the setting before by {:+.1} % (standard uncertainty {:.1} %) of the {} that follows a step: a slower part of it, \
             or that much {remanence}; it is fitted",
            100.0 * part,
            100.0 * std,
            found.effect,
        );
        Note::new(NoteKind::Method, text)
    })
}

/// Whether a part of a transient, which is known to a part of itself, is a small one of it.
fn is_small(part: f64, known_to: f64) -> bool {
    part.abs() <= MOST_SLOW_PART.max(UNSURE * known_to)
}

/// Whether an effect was looked for before the means were: a lag in the temperatures, what the samples show in the samples.
fn is_found_elsewhere(effect: EffectRef, record: &Record, has_lag: bool) -> bool {
    (has_lag && effect.is(&ThermalLag)) || (record.has_samples && effect.acts_in(Acts::Samples))
}

/// Readings without what was found in the samples, enT.
fn corrected(prepared: &PreparedRun, inside: &[Inside]) -> DMatrix<f64> {
    let mut readings = prepared.readings.clone();
    for found in inside {
        let columns = found.effect.columns(&prepared.record, &found.spec).unwrap_or_default();
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

/// Smallest and largest reading of each axis, without offset, enT.
fn reading_ranges_ent(record: &Record) -> [[f64; 2]; 3] {
    std::array::from_fn(|a| {
        let readings = record.rows.iter().map(|r| r.linear_ent[a]);
        readings.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    })
}

/// Refers the readings of a linearity run to one sensor temperature, and says so.
fn at_one_temperature(
    prepared: &mut PreparedRun,
    polynomials: &SensorPolynomials,
    run: &Run,
    plateaus: &Plateaus,
    campaign: &Campaign,
) -> Result<Note, DiagnoseError> {
    let (header, file) = (&run.header, &polynomials.input.path);
    if (&polynomials.sensor, &polynomials.mode) != (&header.sensor, &header.mode) {
        let (of, own) = (format!("{} {}", polynomials.sensor, polynomials.mode), format!("{} {}", header.sensor, header.mode));
        return Err(DiagnoseError::Record(format!("{file} holds polynomials of {of}, the run is of {own}")));
    }
    let (_, position) = the_position(plateaus, &campaign.file.instructions).map_err(|e| DiagnoseError::Record(e.to_string()))?;
    let range_k = prepared.refer(polynomials, &position.r_nom()).map_err(|e| DiagnoseError::Record(e.0))?;
    let text = format!("the readings were referred to the mean sensor temperature, which moves by {range_k:.1} K, with {file}");
    Ok(Note::new(NoteKind::Temperature, text).about(file))
}

#[cfg(test)]
mod tests {
    use super::is_small;

    /// Of a transient that is known to 60 %, a memory of a third of it is what it took too much of the means; of a sharp one it is a memory.
    #[test]
    fn a_transient_that_is_hardly_known_is_no_memory() {
        assert!(is_small(0.2, 0.05) && is_small(-0.33, 0.6));
        assert!(!is_small(-0.33, 0.05) && !is_small(1.3, 0.6));
    }
}
