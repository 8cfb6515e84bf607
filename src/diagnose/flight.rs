//! In flight: what the difference of two sensors, or of a sensor and a model of the field, follows. Its means are a problem of the same search
//! as the plateau means of a run; a constant is the linear model, and slow noise, which the field of a spacecraft has, is estimated beside
//! every set of effects.

use super::limits::{hidden_drifts, limits};
use super::means::Means;
use super::one_run::{noise_floor_nt, quiet_maps};
use super::problem;
use super::result::{Diagnosis, Pictures, Step, VerdictKind};
use super::steps::{joined, sufficient};
use super::{DiagnoseError, left, where_map, words};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Kind;
use crate::fit::smooth::Course;
use crate::fit::statistics::extremes;
use crate::model::effects::record::{Channel, EARLIER};
use crate::model::effects::{Record, Row, in_flight};
use crate::record::prepared::PreparedRun;
use nalgebra::{DMatrix, Matrix3};

/// Fewest means.
pub const LEAST_ROWS: usize = 24;

/// Means of a difference with what it may follow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Difference {
    /// What it is of, as `OB-IB`.
    pub name: String,
    /// Begin and end of every mean, s.
    pub span_s: Vec<[f64; 2]>,
    /// Pairs of every mean.
    pub pairs: Vec<usize>,
    /// nT, axes of the spacecraft.
    pub difference_nt: Vec<[f64; 3]>,
    /// Temperature of the first sensor, °C; nan where it is not known.
    pub degc: Vec<f64>,
    /// Everything else by name, see [`in_flight`]; those with values that are not known are not used.
    pub channels: Vec<(String, Vec<f64>)>,
}

fn channel(name: &str, t_s: &[f64], values: &[f64]) -> Channel {
    Channel {
        name: name.to_owned(),
        course: Course::exact(t_s.iter().copied().zip(values.iter().copied()).collect()),
        mean: values.iter().sum::<f64>() / values.len() as f64,
        values: values.to_vec(),
    }
}

fn prepared(of: &Difference) -> PreparedRun {
    let n = of.pairs.len();
    let t_s: Vec<f64> = of.span_s.iter().map(|[a, b]| 0.5 * (a + b)).collect();
    let known = |values: &[f64]| values.iter().all(|v| v.is_finite());
    let row = |span: &[f64; 2]| Row {
        run: 0,
        used_s: *span,
        field_coil_nt: [0.0; 3],
        earlier_coil_nt: [[0.0; 3]; EARLIER],
        linear_ent: [0.0; 3],
    };
    let record = Record {
        kind: Kind::ZeroField,
        rows: of.span_s.iter().map(row).collect(),
        response: Matrix3::identity(),
        span_s: [of.span_s[0][0], of.span_s[n - 1][1]],
        steps: Vec::new(),
        sensor: known(&of.degc).then(|| channel("sensor", &t_s, &of.degc)),
        thermistors: Vec::new(),
        coil: None,
        rack: None,
        variometer: None,
        others: of.channels.iter().filter(|(_, v)| known(v)).map(|(name, v)| channel(name, &t_s, v)).collect(),
        thermal: None,
        trend_order: 0,
        has_samples: false,
    };
    let mean = of.pairs.iter().map(|pairs| 1.0 / *pairs as f64).sum::<f64>() / n as f64;
    PreparedRun {
        readings: DMatrix::from_fn(n, 3, |row, c| of.difference_nt[row][c]),
        design: DMatrix::from_element(n, 1, 1.0),
        white: of.pairs.iter().map(|pairs| [1.0 / *pairs as f64 / mean; 3]).collect(),
        inside: None,
        nt_per_ent: [1.0; 3],
        windows: Vec::new(),
        displacement: None,
        notes: Vec::new(),
        faults: Vec::new(),
        record,
    }
}

/// Looks for what the difference follows.
///
/// # Errors
/// Too few means, or means that do not tell their noise.
pub fn of_difference(of: &Difference) -> Result<Diagnosis, DiagnoseError> {
    let n = of.pairs.len();
    if n < LEAST_ROWS {
        return Err(DiagnoseError::Record(format!("there are {n} means with both fields, and {LEAST_ROWS} are needed")));
    }
    let catalogue = in_flight::catalogue();
    let prepared = prepared(of);
    let mut means = Means::new(&prepared, prepared.readings.clone(), &catalogue, Vec::new());
    let outcome = problem::search(&mut means).ok_or(DiagnoseError::NoNoise)?;
    let all = means.all(&outcome.terms);
    let (steps, maps, evidence) = problem::steps(&means, &outcome, 0);
    let (mut steps, places) = joined(steps);
    sufficient(&mut steps);
    let first = |step: usize| places.get(step).filter(|place| place.is_first).map(|place| place.step);
    let evidence = evidence.into_iter().filter_map(|e| Some(super::result::Evidence { step: first(e.step)?, ..e })).collect();
    let mut pictures = Pictures { evidence, ..Pictures::default() };
    let maps = maps.into_iter().filter_map(|m| Some(super::result::Map { step: first(m.step)?, ..m })).collect();
    let numbers: Vec<usize> = places.iter().map(|place| place.step + 1).collect();
    let gap_chain = left::chain(&means, &outcome.fit, &all, &numbers, Vec::new());
    let left = left::left(&means, &outcome.fit, &all);
    let noise_floor_nt = noise_floor_nt(&means, &outcome.fit, &all);
    pictures.left = quiet_maps(&means, &outcome.fit, &all, noise_floor_nt);
    let before = where_map::Model {
        record: &prepared.record,
        readings: &prepared.readings,
        design: &prepared.design,
        given: Vec::new(),
        nt_per_ent: prepared.nt_per_ent,
    };
    pictures.places = where_map::places(&before, &outcome.fit.noise);
    let (not_identifiable, mut detection_limits) = limits(&means, &outcome.fit, &steps, &catalogue);
    let mut notes = vec![Note::new(NoteKind::Method, method(of))];
    notes.extend(hidden_drifts(&means, &outcome.fit, &all, &steps));
    steps.iter_mut().for_each(in_nt);
    detection_limits.iter_mut().for_each(|limit| limit.parameter = limit.parameter.replace("enT", "nT"));
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![of.name.clone()],
        noise_floor_nt,
        noise: Some(outcome.fit.noise.parameters),
        verdict: words::verdict(&steps, left.as_ref()),
        verdict_kind: VerdictKind::of(&steps, left.as_ref()),
        left,
        gap_chain,
        steps,
        not_identifiable,
        detection_limits,
        response: None,
        notes,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures,
    })
}

/// The readings of a flight are nT already.
fn in_nt(step: &mut Step) {
    let further = step.further.iter_mut().flat_map(|(_, parameters)| parameters);
    step.parameters.iter_mut().chain(further).for_each(|parameter| parameter.unit = parameter.unit.replace("enT", "nT"));
    step.sentence = step.sentence.replace("enT", "nT");
}

fn method(of: &Difference) -> String {
    let lengths: Vec<f64> = of.span_s.iter().map(|[a, b]| b - a).collect();
    let [low, high] = extremes(of.degc.iter().copied());
    let degc = if low.is_finite() { format!("; sensor temperature {low:.1} to {high:.1} °C") } else { String::new() };
    format!(
        "{} means of up to {:.0} s of {}, axes of the spacecraft, before heaters and wheels are taken off; times count from the first day{degc}",
        of.pairs.len(),
        lengths.into_iter().fold(0.0, f64::max),
        of.name
    )
}
