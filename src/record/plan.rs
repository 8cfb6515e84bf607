//! Runs that could be measured next: the rows of a run with their covariates as they would be.
//!
//! Nothing is measured of them yet: courses of temperatures and channels are those of the run, times are stretched where there are more
//! settings or longer ones, and what is heated follows a course of its own.

use super::prepared::{self, PreparedRun};
use crate::fit::smooth::Course;
use crate::model::effects::record::{Channel, Step, earlier_fields};
use crate::model::effects::{Record, Row};
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::f64::consts::PI;

/// How far something is heated, K.
pub const HEATED_K: f64 = 5.0;

/// How the next run differs from the one that was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// The sensor is heated, and cooled to its first temperature again.
    SensorHeated,
    /// The coils are heated and cooled.
    CoilsHeated,
    /// The electronics of the facility are heated and cooled.
    RackHeated,
    /// The settings in reversed order.
    Reversed,
    /// Every setting lasts twice as long.
    Longer,
    /// A setting without field after every setting.
    ZeroPauses,
    /// The sensor is turned, so that every axis looks along another coil axis.
    Turned,
    /// The sensor stands at another place of the coils.
    Moved,
    /// A signal into the converter in place of a field.
    TestSignal,
}

impl Plan {
    /// All of them.
    pub const ALL: [Plan; 9] = [
        Plan::SensorHeated,
        Plan::CoilsHeated,
        Plan::RackHeated,
        Plan::Reversed,
        Plan::Longer,
        Plan::ZeroPauses,
        Plan::Turned,
        Plan::Moved,
        Plan::TestSignal,
    ];

    /// Its name for programs.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Plan::SensorHeated => "sensor_heated",
            Plan::CoilsHeated => "coils_heated",
            Plan::RackHeated => "rack_heated",
            Plan::Reversed => "reversed_order",
            Plan::Longer => "longer_settings",
            Plan::ZeroPauses => "zero_pauses",
            Plan::Turned => "sensor_turned",
            Plan::Moved => "sensor_moved",
            Plan::TestSignal => "test_signal",
        }
    }

    /// What to do, in words.
    #[must_use]
    pub fn words(self) -> String {
        let heated =
            |what: &str| format!("the same settings while {what} by {HEATED_K} K and cooled to the first temperature again");
        match self {
            Plan::SensorHeated => heated("the sensor alone is heated"),
            Plan::CoilsHeated => heated("the coils alone are heated"),
            Plan::RackHeated => heated("the rack of the facility alone is heated"),
            Plan::Reversed => "the same settings in reversed order".to_owned(),
            Plan::Longer => "the same settings, each twice as long".to_owned(),
            Plan::ZeroPauses => "the same settings with one of zero field after each".to_owned(),
            Plan::Turned => "the same settings with the sensor turned, x, y, z where y, z, x were".to_owned(),
            Plan::Moved => {
                "the same settings with the sensor at another place (no effect of one run depends on the place: it tells what the run once more \
                 tells)"
                    .to_owned()
            }
            Plan::TestSignal => "a test signal into the converter with the steps of these settings, without field".to_owned(),
        }
    }
}

/// A run that could be measured.
pub struct Planned {
    /// Its rows with their covariates.
    pub record: Record,
    /// Columns of its linear model.
    pub design: DMatrix<f64>,
    /// White variance of each row relative to those of the run that was measured.
    pub white: Vec<[f64; 3]>,
}

/// Rows of the next run: which row of the run it repeats, with its field, begin and length.
struct Next {
    from: usize,
    field_coil_nt: [f64; 3],
    used_s: [f64; 2],
}

/// The next run; `None` where there is nothing to change, as in a record without settings.
#[must_use]
pub fn planned(run: &PreparedRun, plan: Plan) -> Option<Planned> {
    let old = &run.record;
    let needs_fields = !matches!(plan, Plan::SensorHeated | Plan::CoilsHeated | Plan::RackHeated);
    if (needs_fields && !old.has_fields()) || (plan == Plan::TestSignal && old.thermal.is_some()) {
        return None;
    }
    let slower = if matches!(plan, Plan::Longer | Plan::ZeroPauses) { 2.0 } else { 1.0 };
    let begin_s = old.span_s[0];
    let stretched = |t_s: f64| begin_s + slower * (t_s - begin_s);
    let next = rows(old, plan, slower, stretched);
    let mut record = old.clone();
    record.span_s = [next.first()?.used_s[0], next.last()?.used_s[1]];
    if plan == Plan::Turned {
        record.response *= turn();
        record.thermal.iter_mut().flat_map(|t| &mut t.response).for_each(|response| *response *= turn());
    }
    let of_history = |i: usize| earlier_fields(|before| next.get(i.checked_sub(before)?).map(|n| n.field_coil_nt));
    record.rows = next
        .iter()
        .enumerate()
        .map(|(i, n)| Row {
            run: 0,
            used_s: n.used_s,
            field_coil_nt: n.field_coil_nt,
            earlier_coil_nt: of_history(i),
            linear_ent: record.reading(n.field_coil_nt),
        })
        .collect();
    let course = |channel: &Channel, heated: bool| moved(channel, &record, stretched, heated);
    let all = |channels: &[Channel], heated: bool| channels.iter().map(|c| course(c, heated)).collect::<Vec<_>>();
    let one = |channel: &Option<Channel>, heated: bool| channel.as_ref().map(|c| course(c, heated));
    let sensor = one(&old.sensor, plan == Plan::SensorHeated);
    let thermistors = all(&old.thermistors, plan == Plan::SensorHeated);
    let coil = one(&old.coil, plan == Plan::CoilsHeated);
    let rack = one(&old.rack, plan == Plan::RackHeated);
    let variometer = old.variometer.as_ref().map(|v| [0, 1, 2].map(|k| course(&v[k], false)));
    let others = all(&old.others, false);
    if [(Plan::SensorHeated, &sensor), (Plan::CoilsHeated, &coil), (Plan::RackHeated, &rack)]
        .iter()
        .any(|(of, channel)| *of == plan && channel.is_none())
    {
        return None;
    }
    record = Record { sensor, thermistors, coil, rack, variometer, others, ..record };
    prepared::with_same_sensor(&mut record);
    let design = prepared::design(&record);
    if plan == Plan::TestSignal {
        // What the converter gets is known as the field was; there is no field.
        for row in &mut record.rows {
            row.field_coil_nt = [0.0; 3];
            row.earlier_coil_nt = Default::default();
        }
    }
    record.steps = steps(&record);
    let white = next.iter().map(|n| run.white[n.from].map(|w| if plan == Plan::Longer { w / slower } else { w })).collect();
    Some(Planned { record, design, white })
}

/// The axes of a sensor that is turned so that x, y, z look where y, z, x did.
fn turn() -> Matrix3<f64> {
    Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0)
}

fn rows(old: &Record, plan: Plan, slower: f64, stretched: impl Fn(f64) -> f64) -> Vec<Next> {
    let n = old.rows.len();
    let row = |at: usize, from: usize| {
        let [begin_s, end_s] = old.rows[at].used_s;
        let begin = stretched(begin_s);
        let length_s = (end_s - begin_s) * if plan == Plan::Longer { slower } else { 1.0 };
        Next { from, field_coil_nt: old.rows[from].field_coil_nt, used_s: [begin, begin + length_s] }
    };
    match plan {
        Plan::Reversed => (0..n).map(|i| row(i, n - 1 - i)).collect(),
        Plan::ZeroPauses => (0..n)
            .flat_map(|i| {
                let own = row(i, i);
                // In the middle of the time until the next one.
                let later_s =
                    old.rows.get(i + 1).map_or(own.used_s[1] - own.used_s[0], |next| next.used_s[0] - old.rows[i].used_s[0]);
                let used_s = own.used_s.map(|t| t + later_s);
                let zero = Next { from: i, field_coil_nt: [0.0; 3], used_s };
                [own, zero]
            })
            .collect(),
        _ => (0..n).map(|i| row(i, i)).collect(),
    }
}

/// A channel at the rows of the next run, its course stretched, heated or not.
fn moved(channel: &Channel, record: &Record, stretched: impl Fn(f64) -> f64, heated: bool) -> Channel {
    let [begin, end] = record.span_s;
    let rise = |t: f64| if heated { HEATED_K * (PI * ((t - begin) / (end - begin)).clamp(0.0, 1.0)).sin().powi(2) } else { 0.0 };
    let series: Vec<(f64, f64)> = channel
        .course
        .series
        .iter()
        .map(|(t, v)| {
            let t = stretched(*t);
            (t, v + rise(t))
        })
        .collect();
    let used_s: Vec<[f64; 2]> = record.rows.iter().map(|r| r.used_s).collect();
    prepared::channel(&channel.name, Course::exact(series), &used_s)
}

/// Changes of the field at the beginnings of the rows.
fn steps(record: &Record) -> Vec<Step> {
    let mut last = Vector3::zeros();
    let mut steps = Vec::new();
    for row in &record.rows {
        let now = Vector3::from(row.linear_ent);
        if now != last {
            steps.push(Step { t_s: row.used_s[0], change_ent: (now - last).into() });
        }
        last = now;
    }
    steps
}
