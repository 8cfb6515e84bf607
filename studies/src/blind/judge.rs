//! The only place that calls the diagnosis, which sees the runs and the campaign, never the truth.

use super::ideal::ideal;
use super::{Amplitude, Blind, Proposal, Verdict, VerdictStep};
use calfit::data::plateau::{self, Accumulator, Cut, Plateaus};
use calfit::data::run::{Run, Vector, VectorSink};
use calfit::diagnose::across::{RunValues, across};
use calfit::diagnose::candidate::Candidate;
use calfit::diagnose::means::Means;
use calfit::diagnose::result::{Diagnosis, Forecast, Step, VerdictKind};
use calfit::diagnose::{self, Options, Samples};
use calfit::measure::lin;
use calfit::model::effects::{Catalogue, Column, Spec, UNKNOWN};
use calfit::record::plan::Plan;
use calfit::record::prepared::PreparedRun;

/// What the diagnosis says about a run set.
pub fn judge(blind: &Blind) -> Verdict {
    let [(run, vectors)] = blind.runs.as_slice() else {
        let cells: usize = blind.means.iter().map(|m| 3 * m.len()).sum();
        return together(blind).map_or_else(Verdict::default, |d| verdict(&d, cells as f64));
    };
    let cells = 3 * blind.means.first().map_or(0, Vec::len);
    let (plateaus, samples) = reduced(run, vectors);
    let diagnosis =
        diagnose::run(run, &plateaus, Some(&samples), &blind.campaign, &Options { without_insides: true, ..Options::default() });
    let oracle_chi2 = prepared(blind).and_then(|prepared| of_truth(&prepared, blind));
    diagnosis.map_or_else(|_| Verdict::default(), |d| Verdict { oracle_chi2, ..verdict(&d, cells as f64) })
}

/// The same with what could be found in runs of noise and of one effect that the means show, which takes longer.
pub fn judge_beside_ideal(blind: &Blind) -> Verdict {
    let counts = match blind.truth.effects.as_slice() {
        [] => true,
        [one] => one.identifiable && !one.seen_inside_plateaus && !one.natural_size && one.effect != UNKNOWN.as_str(),
        _ => false,
    };
    let ideal = prepared(blind).filter(|_| counts).and_then(|prepared| ideal(&prepared, blind));
    Verdict { ideal, ..judge(blind) }
}

/// The only run as the diagnosis sees it; none of several runs, and of those that it cannot look at in this way.
pub fn prepared(blind: &Blind) -> Option<PreparedRun> {
    let [(run, vectors)] = blind.runs.as_slice() else { return None };
    let (plateaus, samples) = reduced(run, vectors);
    PreparedRun::new(run, &plateaus, Some(&samples), &blind.campaign.file.instructions, None).ok()
}

fn reduced(run: &Run, vectors: &[Vector]) -> (Plateaus, Samples) {
    let mut sink = (Accumulator::default(), Samples::default());
    sink.begin(&run.header, &run.settings);
    vectors.iter().for_each(|v| sink.vector(*v));
    let (accumulator, samples) = sink;
    (plateau::of_run(run, accumulator, Cut::default()), samples)
}

/// Held-out χ² without and with the true effects, by the folds and the noise estimate of the diagnosis: the same measure as its own gaps.
fn of_truth(prepared: &PreparedRun, blind: &Blind) -> Option<[f64; 2]> {
    let hidden = &blind.truth.effects;
    if hidden.is_empty() || hidden.iter().any(|e| e.seen_inside_plateaus || !e.identifiable || e.natural_size) {
        return None;
    }
    let rows = prepared.record.rows.len();
    let column = |effect: &Vec<Vec<[f64; 3]>>| {
        let values = effect.first().filter(|v| v.len() == rows)?.clone();
        Some(Column { name: "truth".to_owned(), unit: "enT", values })
    };
    let columns: Vec<Column> = blind.oracle.iter().map(column).collect::<Option<_>>()?;
    let truth = Candidate::of_readings(UNKNOWN, Spec::new("truth", &[0, 1, 2]), columns);
    let means = Means::new(prepared, prepared.readings.clone(), &Catalogue::default(), Vec::new());
    let noise = means.model(&[&truth])?.noise;
    Some([means.predicted(&noise, &[]).sum, means.predicted(&noise, &[&truth]).sum])
}

/// Several runs of one sensor.
fn together(blind: &Blind) -> Option<Diagnosis> {
    let of = |(run, vectors): &(Run, Vec<Vector>)| {
        let mut sink = Accumulator::default();
        sink.begin(&run.header, &run.settings);
        vectors.iter().for_each(|v| sink.vector(*v));
        let plateaus = plateau::of_run(run, sink, Cut::default());
        RunValues::of_run(run, &plateaus, &blind.campaign, &lin::Options::default()).ok()
    };
    let values: Vec<RunValues> = blind.runs.iter().map(of).collect::<Option<_>>()?;
    across(&values, &Catalogue::default()).ok()
}

fn verdict(diagnosis: &Diagnosis, cells: f64) -> Verdict {
    Verdict {
        steps: diagnosis.steps.iter().enumerate().map(|(k, s)| step(s, drawn_over(diagnosis, k), cells)).collect(),
        undecided: diagnosis.verdict_kind == VerdictKind::Undecided,
        not_identifiable: diagnosis.not_identifiable.iter().map(|n| n.effect.to_string()).collect(),
        oracle_chi2: None,
        ideal: None,
    }
}

/// What the report draws a step over.
fn drawn_over(diagnosis: &Diagnosis, step: usize) -> Option<&str> {
    diagnosis.maps.iter().find(|m| m.step == step).map(|m| m.covariate.as_str())
}

fn step(step: &Step, drawn_over: Option<&str>, cells: f64) -> VerdictStep {
    VerdictStep {
        effect: step.effect.to_string(),
        axes: step.axes.clone(),
        ambiguous_with: step.ambiguous_with.iter().map(ToString::to_string).collect(),
        family: step.family.to_owned(),
        confident: step.wording == "is",
        runner_up: step.runners_up.first().map(|r| (r.effect.clone(), r.log_ratio)),
        covariate: step.covariate.as_deref().or(drawn_over).map(renamed_covariate),
        strength_k: step.strength_k,
        amplitudes: amplitudes(step),
        next: step.next_forecast.iter().filter_map(proposal).collect(),
        gap_before_chi2: step.gap_before.chi2_per_dof * cells,
        gap_after_chi2: step.gap_after.chi2_per_dof * cells,
    }
}

fn proposal(forecast: &Forecast) -> Option<Proposal> {
    let plan = Plan::ALL.into_iter().find(|plan| plan.name() == forecast.measurement)?;
    Some(Proposal { plan, strength_k: forecast.strength_k, apart_k: forecast.k })
}

/// A covariate under the name of this study: channels by their own names, components of the field as bx, by, bz.
fn renamed_covariate(name: &str) -> String {
    let mut name = name.to_owned();
    for (from, to) in [
        ("the rack temperature", "T55"),
        ("the sensor temperature", "TCSC"),
        (" times ", "*"),
        ("field x", "bx"),
        ("field y", "by"),
        ("field z", "bz"),
    ] {
        name = name.replace(from, to);
    }
    name
}

/// Parameters under the names and with the signs of this study.
fn amplitudes(step: &Step) -> Vec<Amplitude> {
    let renamed = |name: &str| -> (String, f64) {
        let axis = name.rsplit('_').next().unwrap_or_default();
        match step.effect.as_str() {
            // A sensitivity that grows makes the reading smaller.
            "sensor_temperature_sensitivity" => (name.to_owned(), -1.0),
            "offset_step" => (format!("step_{axis}"), 1.0),
            "earthfield_leakage" => (format!("k_{axis}"), 1.0),
            "heater_pwm" => (format!("amplitude_{axis}"), 1.0),
            "time_shift" if name == "shift" => ("dt".to_owned(), 1.0),
            _ => (name.to_owned(), 1.0),
        }
    };
    step.parameters
        .iter()
        .filter_map(|p| {
            let (name, sign) = renamed(&p.name);
            Some(Amplitude { name, value: sign * p.value, std: p.std? })
        })
        .collect()
}
