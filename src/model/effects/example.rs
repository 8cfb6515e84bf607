//! Example runs, built in code: what an effect does to the readings of an ordinary sensor.

use super::record::{Channel, Step, earlier_fields};
use super::{Acts, Effect, Record, Row, Thermal};
use crate::data::run::Kind;
use crate::data::units::Scale;
use crate::fit::smooth::Course;
use nalgebra::Matrix3;
use std::f64::consts::TAU;

/// Largest field of the examples, nT.
const MOST_NT: f64 = 2000.0;
/// Settings of the linearity run, and their length, s.
const SETTINGS: usize = 81;
const SETTING_S: f64 = 20.0;
/// Samples of the record at full rate: settings, their length, s, and the rate, Hz.
const SAMPLED_SETTINGS: usize = 6;
const SAMPLED_S: f64 = 5.0;
const RATE_HZ: f64 = 32.0;
/// Rows and time of the sweep, s.
const SWEEP_ROWS: usize = 240;
const SWEEP_S: f64 = 43200.0;
/// Temperatures of the sweep, °C.
const SWEEP_DEGC: [f64; 4] = [20.0, 60.0, -60.0, 20.0];

/// An example run in words, and as the record that effects read.
pub struct Example {
    /// What was measured.
    pub run: &'static str,
    /// Its rows; the sensor reads nT.
    pub record: Record,
    /// The rows are samples, and not means of plateaus.
    pub sampled: bool,
}

/// The example on which an effect shows; none where a reading of one run does not show it.
#[must_use]
pub fn of(effect: &dyn Effect) -> Option<Example> {
    let shows = |example: &Example| {
        let spec = effect.example(&example.record);
        spec.and_then(|s| effect.columns(&example.record, &s)).is_some_and(|c| !c.is_empty())
    };
    let all: &[fn() -> Example] = if effect.acts_in(Acts::Samples) { &[sampled] } else { &[linearity, sweep] };
    all.iter().map(|make| make()).find(shows)
}

/// Fields along the axes, then along pairs of them, up and down.
fn field(i: usize) -> [f64; 3] {
    let level = ((i % 9) as f64 - 4.0) / 4.0 * MOST_NT;
    let part = 0.7 * level;
    match i / 9 % 6 {
        0 => [level, 0.0, 0.0],
        1 => [0.0, level, 0.0],
        2 => [0.0, 0.0, level],
        3 => [part, part, 0.0],
        4 => [0.0, part, -part],
        _ => [-part, 0.0, part],
    }
}

/// A row in one of some settings.
fn row(used_s: [f64; 2], setting: usize, field_nt: &impl Fn(usize) -> [f64; 3]) -> Row {
    let earlier_coil_nt = earlier_fields(|before| setting.checked_sub(before).map(field_nt));
    Row { run: 0, used_s, field_coil_nt: field_nt(setting), earlier_coil_nt, linear_ent: field_nt(setting) }
}

fn channel(name: &str, rows: &[Row], span_s: [f64; 2], value: impl Fn(f64) -> f64) -> Channel {
    let series = (0..=400).map(|k| span_s[0] + (span_s[1] - span_s[0]) * f64::from(k) / 400.0).map(|t| (t, value(t))).collect();
    let values: Vec<f64> = rows.iter().map(|r| value(r.t_s())).collect();
    let mean = values.iter().sum::<f64>() / values.len().max(1) as f64;
    Channel { name: name.to_owned(), course: Course::exact(series), values, mean }
}

fn record(kind: Kind, rows: Vec<Row>, span_s: [f64; 2], has_samples: bool) -> Record {
    let mut steps = Vec::new();
    let mut last = [0.0; 3];
    for row in &rows {
        let change_ent = std::array::from_fn(|a| row.linear_ent[a] - last[a]);
        if change_ent != [0.0; 3] {
            steps.push(Step { t_s: row.used_s[0], change_ent });
        }
        last = row.linear_ent;
    }
    let part = |t: f64| (t - span_s[0]) / (span_s[1] - span_s[0]);
    let variometer = |name: &str, waves: f64| channel(name, &rows, span_s, |t| 4.0 * (TAU * waves * part(t)).sin());
    Record {
        trend_order: 2,
        kind,
        scale: Scale::Engineering,
        response: Matrix3::identity(),
        span_s,
        steps,
        sensor: Some(channel("sensor", &rows, span_s, |t| 20.0 + 1.5 * part(t))),
        thermistors: Vec::new(),
        coil: Some(channel("coil", &rows, span_s, |t| 19.0 + 2.0 * part(t).powi(2))),
        rack: Some(channel("rack", &rows, span_s, |t| 24.0 + (TAU * 3.0 * part(t)).cos())),
        variometer: Some([variometer("VARX", 1.3), variometer("VARY", 2.1), variometer("VARZ", 0.7)]),
        others: Vec::new(),
        thermal: None,
        has_samples,
        rows,
    }
}

fn linearity() -> Example {
    // The ends of a plateau settle.
    let used = |i: usize| [i as f64 * SETTING_S + 1.0, (i + 1) as f64 * SETTING_S];
    let rows = (0..SETTINGS).map(|i| row(used(i), i, &field)).collect();
    Example {
        run: "81 plateaus of 20 s with fields up to 2000 nT, along the axes and along pairs of them",
        record: record(Kind::Linearity, rows, [0.0, SETTINGS as f64 * SETTING_S], true),
        sampled: false,
    }
}

fn sampled() -> Example {
    let per = (SAMPLED_S * RATE_HZ) as usize;
    let setting = |k: usize| if k.is_multiple_of(2) { [0.0; 3] } else { [MOST_NT, -0.5 * MOST_NT, 0.25 * MOST_NT] };
    let rows = (0..SAMPLED_SETTINGS * per).map(|i| row([i as f64 / RATE_HZ; 2], i / per, &setting)).collect();
    Example {
        run: "30 s at 32 Hz, every 5 s a step between zero and (2000, -1000, 500) nT",
        record: record(Kind::Linearity, rows, [0.0, SAMPLED_SETTINGS as f64 * SAMPLED_S], true),
        sampled: true,
    }
}

fn sweep() -> Example {
    let each_s = SWEEP_S / SWEEP_ROWS as f64;
    let setting = |i: usize| match i % 7 {
        k @ 1..=6 => {
            let mut field = [0.0; 3];
            field[(k - 1) / 2] = if k % 2 == 0 { MOST_NT } else { -MOST_NT };
            field
        }
        _ => [0.0; 3],
    };
    let used = |i: usize| [i as f64 * each_s, (i + 1) as f64 * each_s];
    let rows: Vec<Row> = (0..SWEEP_ROWS).map(|i| row(used(i), i, &setting)).collect();
    // A quarter of the time up, a half down, a quarter up again.
    let degc = |t: f64| {
        let part = 4.0 * t / SWEEP_S;
        let [start, high, low, end] = SWEEP_DEGC;
        match part {
            p if p < 1.0 => start + (high - start) * p,
            p if p < 3.0 => high + (low - high) * 0.5 * (p - 1.0),
            p => low + (end - low) * (p - 3.0),
        }
    };
    let mut record = record(Kind::Sweep, rows, [0.0, SWEEP_S], true);
    record.sensor = Some(channel("sensor", &record.rows, [0.0, SWEEP_S], degc));
    record.thermal = Some(Thermal {
        middle_degc: 0.0,
        half_k: 60.0,
        response: vec![Matrix3::identity(), Matrix3::identity() * 1.8e-3, Matrix3::identity() * 1.3e-4],
        offset_ent: vec![[0.0; 3], [1.0, -0.5, 0.5], [0.2, 0.1, -0.1]],
        degc: record.rows.iter().map(|r| degc(r.t_s())).collect(),
    });
    Example {
        run: "12 h of heating and cooling between -60 and 60 °C, fields of 2000 nT along the axes in turn, a sensitivity of 30 ppm/K",
        record,
        sampled: false,
    }
}
