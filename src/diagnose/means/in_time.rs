//! What goes with time, or with a rate, in place of what a term follows, and the other way round. A temperature that moves evenly, or along one bend, is the
//! time under another name: a drift of the gain, or a step in it, makes the same of the readings. A drift may be an offset that follows its temperature while
//! the thermistor does so later.

use super::chosen::Chosen;
use crate::data::run::interpolate;
use crate::diagnose::APART;
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::RunnerUp;
use crate::fit::smooth::Course;
use crate::model::effects::coil_temperature::LAG;
use crate::model::effects::record::Channel;
use crate::model::effects::sensor_temperature_offset::SensorTemperatureOffset;
use crate::model::effects::{Column, Covariate, EffectRef, Family, GAIN_WITH, Record, Spec, TIME, UNKNOWN};

/// Equal parts of the run between which a step is tried.
const STEPS: usize = 12;

/// A course of time in words, the effect that makes it, and what it makes of the readings.
struct InTime {
    effect: EffectRef,
    name: String,
    candidate: Candidate,
    /// Forms that were tried for it.
    tried: usize,
}

/// The courses of time that describe the readings as well as a term does, the best of each kind, each with the effect that makes it. They are told by the
/// data alone, whatever their prior.
pub(super) fn rivals(chosen: &Chosen) -> Vec<(EffectRef, RunnerUp)> {
    let mut rivals: Vec<(EffectRef, RunnerUp)> = Vec::new();
    for InTime { effect, name, candidate, tried } in in_time(&chosen.means.prepared.record, chosen.candidate) {
        let Some(rival) = chosen.rival(&candidate, tried) else { continue };
        let rival = RunnerUp { effect: name, ..rival };
        match rivals.iter_mut().find(|(_, r)| r.effect == rival.effect) {
            Some((_, known)) if known.log_ratio >= rival.log_ratio => {}
            Some((_, known)) => *known = rival,
            None => rivals.push((effect, rival)),
        }
    }
    rivals.retain(|(_, r)| r.log_ratio > -APART);
    rivals
}

fn in_time(record: &Record, candidate: &Candidate) -> Vec<InTime> {
    if candidate.effect.is_unknown() {
        smooth(record, candidate).into_iter().chain(jumps(record, candidate)).collect()
    } else if candidate.effect.about().family == Family::Time {
        late_thermistor(record, candidate).into_iter().collect()
    } else {
        of_temperature(record, candidate).into_iter().chain(rates(record, candidate)).collect()
    }
}

/// A smooth function of time on the axis of an unknown one, or a gain that is one.
fn smooth(record: &Record, candidate: &Candidate) -> Option<InTime> {
    let axis = *candidate.spec.axes.first()?;
    let own = candidate.covariate.as_deref()?;
    let name = if own.starts_with(GAIN_WITH) { format!("{GAIN_WITH}{TIME}") } else { TIME.to_owned() };
    let covariate = Covariate::all(record).into_iter().find(|c| c.name == name && c.name != own)?;
    let (spec, columns) = covariate.close(record, axis)?;
    let candidate = Candidate::of_readings(UNKNOWN, spec, columns);
    Some(InTime { effect: UNKNOWN, name: candidate.key.clone(), candidate, tried: 1 })
}

/// Steps in time on the axis of an unknown function, or of the gain of the axis.
fn jumps(record: &Record, candidate: &Candidate) -> Vec<InTime> {
    let Some(axis) = candidate.spec.axes.first() else { return Vec::new() };
    let is_gain = candidate.covariate.as_ref().is_some_and(|own| own.starts_with(GAIN_WITH));
    let of = |at_s: f64| {
        let step = |t_s: f64| if t_s < at_s { -1.0 } else { 1.0 };
        let column =
            Column::on("s", *axis, "1", record, |_, row| step(row.t_s()) * if is_gain { row.linear_ent[*axis] } else { 1.0 });
        let candidate = Candidate::of_readings(UNKNOWN, Spec::new(STEP, &[*axis]), vec![column]);
        InTime { effect: UNKNOWN, name: candidate.key.clone(), candidate, tried: STEPS - 1 }
    };
    steps_s(record).map(of).collect()
}

/// Times at which a step is tried, s.
fn steps_s(record: &Record) -> impl Iterator<Item = f64> {
    let [begin_s, end_s] = record.span_s;
    (1..STEPS).map(move |k| begin_s + (end_s - begin_s) * k as f64 / STEPS as f64)
}

/// The same effect with a course of time in place of all temperatures; nothing where it follows none, or where they are what the model is a
/// polynomial of.
fn of_temperature(record: &Record, candidate: &Candidate) -> Vec<InTime> {
    if record.thermal.is_some() {
        return Vec::new();
    }
    let mut spec = candidate.spec.clone();
    spec.shape.retain(|(name, _, _)| name != LAG);
    let columns = |course: &dyn Fn(f64) -> f64| candidate.effect.columns(&with_course(record, course), &spec);
    let of = |name: &str, courses: &[&dyn Fn(f64) -> f64], tried: usize| {
        let columns: Vec<_> = courses.iter().map(|course| columns(*course)).collect::<Option<Vec<_>>>()?.concat();
        let candidate = Candidate::of_readings(UNKNOWN, Spec::new(name, &spec.axes), columns);
        Some(InTime { effect: UNKNOWN, name: format!("{UNKNOWN}: {name}"), candidate, tried })
    };
    // What does not move with the temperatures does not follow one.
    let still = of(STILL, &[&|_| 0.0], 1);
    if still.is_none_or(|still| still.candidate.columns.norm() > 0.0) {
        return Vec::new();
    }
    let tau = |t_s: f64| record.tau(t_s);
    let steps = steps_s(record).filter_map(|at_s| of(STEP, &[&|t_s| if t_s < at_s { -1.0 } else { 1.0 }], STEPS - 1));
    let drifts = [of("drift in time", &[&tau], 1), of("drift in time", &[&tau, &|t_s| tau(t_s).powi(2)], 1)];
    drifts.into_iter().flatten().chain(steps).collect()
}

/// The same effect with the rate of a temperature in place of a temperature of some time before: the difference of the two is a rate, and a lag
/// that is free makes a rate of any temperature.
fn rates(record: &Record, candidate: &Candidate) -> Vec<InTime> {
    if candidate.spec.get(LAG).is_none() {
        return Vec::new();
    }
    let mut spec = candidate.spec.clone();
    spec.shape.retain(|(name, _, _)| name != LAG);
    let channels: Vec<_> = [("sensor", &record.sensor), ("coil", &record.coil), ("rack", &record.rack)]
        .into_iter()
        .filter_map(|(name, channel)| Some((name, channel.as_ref()?)))
        .collect();
    let of = |(name, channel): &(&str, &Channel)| {
        let rates = rates_of(channel);
        let columns = candidate.effect.columns(&with_course(record, &|t_s| interpolate(&rates, t_s)), &spec)?;
        let name = format!("rate of the {name} temperature");
        let candidate = Candidate::of_readings(UNKNOWN, Spec::new(&name, &spec.axes), columns);
        Some(InTime { effect: UNKNOWN, name: format!("{UNKNOWN}: {name}"), candidate, tried: channels.len() })
    };
    channels.iter().filter_map(of).collect()
}

/// The rate of a channel, (s since the run's start, K/s).
fn rates_of(channel: &Channel) -> Vec<(f64, f64)> {
    let course = &channel.course;
    course.series.iter().zip(&course.rate_per_s).map(|((t, _), rate)| (*t, *rate)).collect()
}

/// An offset that follows the temperature of the sensor, whose thermistor shows it later or earlier: the temperature, and its rate.
fn late_thermistor(record: &Record, candidate: &Candidate) -> Option<InTime> {
    const LATE: &str = "with its rate";
    let effect = EffectRef::new(&SensorTemperatureOffset);
    let channel = record.sensor.as_ref()?;
    let rates = rates_of(channel);
    let axes = &candidate.spec.axes;
    let now =
        axes.iter().map(|a| Column::on("b", *a, record.scale.per_kelvin(), record, |i, _| channel.values[i] - channel.mean));
    let moving = axes.iter().map(|a| Column::on("rate", *a, "1", record, |_, row| interpolate(&rates, row.t_s())));
    let candidate = Candidate::of_readings(effect, Spec::new(LATE, axes), now.chain(moving).collect());
    Some(InTime { effect, name: format!("{effect}: {LATE}"), candidate, tried: 1 })
}

/// Names of the forms with a step, and with temperatures that do not move.
const STEP: &str = "step in time";
const STILL: &str = "still";

/// A record whose temperatures are a function of time.
fn with_course(record: &Record, course: &dyn Fn(f64) -> f64) -> Record {
    let mut other = record.clone();
    let values: Vec<f64> = record.rows.iter().map(|row| course(row.t_s())).collect();
    let series: Vec<(f64, f64)> = record.rows.iter().zip(&values).map(|(row, value)| (row.t_s(), *value)).collect();
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let single = [&mut other.sensor, &mut other.coil, &mut other.rack].into_iter().flatten();
    for channel in single.chain(&mut other.thermistors) {
        channel.values.clone_from(&values);
        channel.course = Course::exact(series.clone());
        channel.mean = mean;
    }
    other
}
