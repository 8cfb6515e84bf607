//! The difference of two sensors in flight, or of a sensor and a model of the field, for the diagnosis.

use super::day::{Context, Product};
use super::{Carry, Level, NoLevels, Prepared, prepare};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::Recipe;
use crate::data::time::{SECOND_NS, Tt2000};
use crate::diagnose::flight::{Difference, of_difference};
use crate::files::flight::auxiliary::{Attitude, ModelField, Timeline};
use crate::flight::attitude::{AttitudeFaults, AttitudeStep};
use crate::flight::two_sensors::common_times;
use crate::flight::{Block, Step};
use crate::model::effects::in_flight;
use crate::workflow::diagnose::Diagnosed;
use std::collections::BTreeSet;
use std::ops::Range;
use std::path::{Path, PathBuf};

/// Means of the difference at most: what is slower than a few minutes is looked for.
const MOST_ROWS: usize = 720;
/// Shortest mean, ns.
const MINUTE_NS: i64 = 60 * SECOND_NS;
/// Rows of a model of the field further apart than this are not interpolated, ns.
const MODEL_GAP_NS: i64 = 600 * SECOND_NS;

/// What is compared.
#[derive(Clone, Debug, Default)]
pub struct DifferenceOptions {
    /// A table of the field at the spacecraft in the celestial frame; the other sensor without it.
    pub field: Option<PathBuf>,
    /// The sensor that is compared with a model; the primary one by default.
    pub sensor: Option<String>,
    /// First and last day, counted from 1970-01-01.
    pub days: [Option<i32>; 2],
}

/// Means of one second of a sensor.
#[derive(Default)]
struct Seconds {
    time: Vec<Tt2000>,
    field_nt: [Vec<f64>; 3],
    degc: Vec<f64>,
}

/// Sums of a mean.
#[derive(Clone, Debug)]
struct Sums {
    begin: Tt2000,
    pairs: usize,
    difference_nt: [f64; 3],
    degc: f64,
    channels: Vec<f64>,
}

/// Diagnoses a mission.
///
/// # Errors
/// What is wrong with the configuration, a table or the telemetry; too few vectors that can be compared.
pub fn diagnose_flight(path: &Path, options: &DifferenceOptions, findings: &mut Vec<Finding>) -> Result<Diagnosed, Finding> {
    let mut prepared = prepare(path, findings)?;
    let shown = path.display().to_string();
    let level = if options.field.is_some() { Level::G } else { Level::D };
    if let Some(what) = level.lacks(&prepared) {
        let error = NoLevels::Missing { level: level.letter(), what };
        return Err(Finding::error(&shown, error.to_string(), "state it; without --field two sensors are compared"));
    }
    // Heaters and wheels stay in the data: they are what is looked for.
    let classes = prepared.mission.heater.take().map_or(Vec::new(), |heater| heater.classes);
    prepared.mission.mean_ns = SECOND_NS;
    prepared.mission.uncertainty = false;
    let named = |name: &String| {
        let found = prepared.mission.sensors.iter().position(|s| s.name == *name);
        found.ok_or_else(|| Finding::error(&shown, format!("has no sensor {name}"), "name one of its [[sensor]]"))
    };
    let primary = match (&options.sensor, &prepared.mission.roles.primary) {
        (Some(name), _) | (None, Some(name)) => named(name)?,
        (None, None) => 0,
    };
    let mut inputs = prepared.inputs.clone();
    let model = match &options.field {
        Some(table) => {
            let frame = prepared.mission.celestial.as_ref().map_or(String::new(), |c| c.frame.clone());
            let (read, input) = Timeline::<ModelField>::open(table, frame, prepared.mission.time_rule, &prepared.leap)?;
            inputs.push(input);
            Some(read)
        }
        None => None,
    };
    let carry = Carry::find(&prepared, false)?;
    let [first, last] = options.days;
    let days: Vec<i32> = prepared
        .days(&prepared.mission.sensors[primary])?
        .filter(|day| first.is_none_or(|first| *day >= first) && last.is_none_or(|last| *day <= last))
        .collect();
    let other = (0..prepared.mission.sensors.len()).find(|i| *i != primary);
    let mut collected = Collected::new(&prepared, primary, &days, classes, model.is_none().then_some(other).flatten());
    for day in &days {
        let Some(own) = seconds(&prepared, &carry, primary, *day, &mut inputs)? else { continue };
        let reference = match (&model, other) {
            (Some(model), _) => in_spacecraft(&prepared, model, *day, &own)?,
            (None, Some(other)) => match seconds(&prepared, &carry, other, *day, &mut inputs)? {
                Some(second) => second,
                None => continue,
            },
            (None, None) => continue,
        };
        collected.take(&prepared, *day, &own, &reference)?;
    }
    let sensor = &prepared.mission.sensors[primary].name;
    let with = other.filter(|_| model.is_none()).map_or("model", |i| prepared.mission.sensors[i].name.as_str());
    let difference = collected.finish(format!("{sensor}-{with}"));
    let diagnosis = of_difference(&difference).map_err(|reason| {
        Finding::error(&shown, reason.to_string(), "take more days, or see `calfit inspect` for what there is in the telemetry")
    })?;
    inputs.sort_by(|a, b| a.path.cmp(&b.path));
    inputs.dedup();
    Ok(Diagnosed::new(diagnosis, Provenance::new(Recipe::plain("diagnose"), inputs)))
}

/// Means of one second of a sensor and day in axes of the spacecraft; those outside of the table of offsets are left out.
fn seconds(
    prepared: &Prepared,
    carry: &Carry,
    index: usize,
    day: i32,
    inputs: &mut Vec<Input>,
) -> Result<Option<Seconds>, Finding> {
    let wanted = BTreeSet::from([Level::F]);
    let mut found = None;
    Context::new(prepared, carry, index, day, &wanted).make(&mut |_, product, own, _| {
        let Product::Means(means, blocks) = product else { return Ok(()) };
        inputs.extend_from_slice(own);
        let degc: Vec<f64> = blocks.iter().flat_map(|block| block.t_degc.iter().copied()).collect();
        let mut out = Seconds::default();
        for i in 0..means.time.len() {
            if means.count[i] == 0 || Flags(means.flags[i]).any_of(Flags::JUMP) {
                continue;
            }
            let (begin, end) = means.rows[i];
            out.time.push(means.time[i]);
            (0..3).for_each(|c| out.field_nt[c].push(means.field_nt[c][i]));
            out.degc.push(degc[begin..end].iter().sum::<f64>() / (end - begin) as f64);
        }
        found = Some(out);
        Ok(())
    })?;
    Ok(found)
}

/// The field of a model at the times of a sensor, turned into axes of the spacecraft.
fn in_spacecraft(prepared: &Prepared, model: &Timeline<ModelField>, day: i32, own: &Seconds) -> Result<Seconds, Finding> {
    let (leap, span) = (&prepared.leap, prepared.leap.day(day));
    let table = model.over(&span, leap)?;
    let (Some(attitude), Some(celestial)) = (&prepared.attitude, &prepared.mission.celestial) else {
        return Ok(Seconds::default());
    };
    let attitude = attitude.over(&span, leap)?;
    let wrong = AttitudeFaults::of(&attitude, celestial.max_gap_ns).wrong;
    let back = attitude.wxyz.iter().map(|[w, x, y, z]| [*w, -x, -y, -z]).collect();
    let table_back = Attitude { time: attitude.time.clone(), wxyz: back };
    let step = AttitudeStep { table: table_back.into(), max_gap_ns: celestial.max_gap_ns, std_rad: 0.0, wrong };
    let mut block = Block::default();
    for time in &own.time {
        let next = table.time.partition_point(|t| t <= time);
        let near = |i: usize| table.time.get(i).copied().zip(table.field_nt.get(i).copied());
        let pair = next.checked_sub(1).and_then(near).zip(near(next));
        let Some(((before, a), (behind, b))) = pair.filter(|((t, _), (u, _))| u - t <= MODEL_GAP_NS) else { continue };
        let share = (time - before) as f64 / (behind - before) as f64;
        block.time.push(*time);
        (0..3).for_each(|c| block.field[c].push(a[c] + share * (b[c] - a[c])));
    }
    block.flags = vec![0; block.time.len()];
    step.apply(&mut block);
    let degc = vec![f64::NAN; block.time.len()];
    Ok(Seconds { time: block.time, field_nt: block.field, degc })
}

/// Means on their way.
struct Collected {
    /// Begin of the day of the first pair.
    begin: Tt2000,
    /// Length of a mean; doubled where there would be too many.
    row_ns: i64,
    /// Name of the sensor.
    sensor: String,
    names: Vec<String>,
    other_degc: bool,
    wheels: usize,
    /// When each heater is on, in order.
    heaters: Vec<Vec<Range<Tt2000>>>,
    rows: Vec<Sums>,
}

impl Collected {
    fn new(prepared: &Prepared, own: usize, days: &[i32], classes: Vec<String>, other: Option<usize>) -> Self {
        let mut names = Vec::new();
        names.extend(other.map(|i| format!("{}{}", in_flight::TEMPERATURE, prepared.mission.sensors[i].name)));
        // Of two sensors the field is known with the noise that is in their difference as well, which would look like a dependence.
        if other.is_none() {
            names.extend(["x", "y", "z"].map(|axis| format!("{}{axis}", in_flight::FIELD)));
        }
        let first = days.first().and_then(|day| prepared.wheels.as_ref()?.over(&prepared.leap.day(*day), &prepared.leap).ok());
        let wheels = first.map_or(0, |rates| rates.rate_hz.len());
        names.extend((1..=wheels).map(|number| format!("{}{number}", in_flight::WHEEL)));
        let classes = if prepared.heater.is_some() { classes } else { Vec::new() };
        names.extend(classes.iter().map(|class| format!("{}{class}", in_flight::HEATER)));
        let on = |class: usize| {
            let all = prepared.heater.iter().flatten().filter(|on| on.class == class);
            let mut spans: Vec<Range<Tt2000>> = all.map(|on| on.from_tt2000..on.to_tt2000).collect();
            spans.sort_by_key(|span| span.start);
            spans
        };
        Self {
            begin: 0,
            row_ns: MINUTE_NS,
            sensor: prepared.mission.sensors[own].name.clone(),
            names,
            other_degc: other.is_some(),
            wheels,
            heaters: (0..classes.len()).map(on).collect(),
            rows: Vec::new(),
        }
    }

    fn take(&mut self, prepared: &Prepared, day: i32, own: &Seconds, reference: &Seconds) -> Result<(), Finding> {
        let leap = &prepared.leap;
        let rates = prepared.wheels.as_ref().map(|table| table.over(&leap.day(day), leap)).transpose()?;
        for [i, j] in common_times(&own.time, &reference.time) {
            let time = own.time[i];
            let difference: [f64; 3] = std::array::from_fn(|c| own.field_nt[c][i] - reference.field_nt[c][j]);
            if difference.iter().any(|v| v.is_nan()) {
                continue;
            }
            let mut channels = Vec::with_capacity(self.names.len());
            if self.other_degc {
                channels.push(reference.degc[j]);
            } else {
                channels.extend((0..3).map(|c| reference.field_nt[c][j]));
            }
            for wheel in 0..self.wheels {
                channels.push(rates.as_ref().map_or(f64::NAN, |rates| {
                    let next = rates.time_tt2000.partition_point(|t| *t <= time);
                    let Some(before) = next.checked_sub(1).filter(|_| next < rates.time_tt2000.len()) else { return f64::NAN };
                    let [t, u] = [before, next].map(|k| rates.time_tt2000[k]);
                    let [a, b] = [before, next].map(|k| rates.rate_hz[wheel][k]);
                    a + (time - t) as f64 / (u - t) as f64 * (b - a)
                }));
            }
            for spans in &self.heaters {
                let begun = spans.partition_point(|span| span.start <= time);
                channels.push(f64::from(u8::from(begun > 0 && spans[begun - 1].contains(&time))));
            }
            if self.rows.is_empty() {
                self.begin = leap.day(leap.utc(time).day).start;
            }
            let begin = self.row_of(time);
            if self.rows.last().is_none_or(|row| row.begin != begin) {
                let empty = vec![0.0; channels.len()];
                self.rows.push(Sums { begin, pairs: 0, difference_nt: [0.0; 3], degc: 0.0, channels: empty });
            }
            if let Some(row) = self.rows.last_mut() {
                row.pairs += 1;
                (0..3).for_each(|c| row.difference_nt[c] += difference[c]);
                row.degc += own.degc[i];
                row.channels.iter_mut().zip(&channels).for_each(|(sum, value)| *sum += value);
            }
            if self.rows.len() > MOST_ROWS {
                self.double();
            }
        }
        Ok(())
    }

    /// Begin of the mean that a time belongs to.
    fn row_of(&self, time: Tt2000) -> Tt2000 {
        self.begin + (time - self.begin).div_euclid(self.row_ns) * self.row_ns
    }

    /// Makes means of twice the length.
    fn double(&mut self) {
        self.row_ns *= 2;
        let mut rows: Vec<Sums> = Vec::with_capacity(self.rows.len());
        for row in std::mem::take(&mut self.rows) {
            let begin = self.row_of(row.begin);
            match rows.last_mut().filter(|last| last.begin == begin) {
                Some(last) => {
                    last.pairs += row.pairs;
                    (0..3).for_each(|c| last.difference_nt[c] += row.difference_nt[c]);
                    last.degc += row.degc;
                    last.channels.iter_mut().zip(&row.channels).for_each(|(sum, more)| *sum += more);
                }
                None => rows.push(Sums { begin, ..row }),
            }
        }
        self.rows = rows;
    }

    fn finish(self, name: String) -> Difference {
        let seconds = |time: Tt2000| (time - self.begin) as f64 / SECOND_NS as f64;
        let mean = |row: &Sums, sum: f64| sum / row.pairs as f64;
        let span_s: Vec<[f64; 2]> = self.rows.iter().map(|row| [seconds(row.begin), seconds(row.begin + self.row_ns)]).collect();
        let degc: Vec<f64> = self.rows.iter().map(|row| mean(row, row.degc)).collect();
        let mut channels: Vec<(String, Vec<f64>)> = Vec::new();
        for (k, name) in self.names.iter().enumerate() {
            channels.push((name.clone(), self.rows.iter().map(|row| mean(row, row.channels[k])).collect()));
        }
        let others = channels.iter().filter_map(|(name, degc)| Some((name.strip_prefix(in_flight::TEMPERATURE)?, degc)));
        let temperatures = others.chain([(self.sensor.as_str(), &degc)]);
        let rate = |(sensor, degc): (&str, &Vec<f64>)| (format!("{}{sensor}", in_flight::RATE), rates(&span_s, degc));
        let rates: Vec<(String, Vec<f64>)> = temperatures.map(rate).collect();
        channels.extend(rates);
        Difference {
            name,
            span_s,
            pairs: self.rows.iter().map(|row| row.pairs).collect(),
            difference_nt: self.rows.iter().map(|row| row.difference_nt.map(|sum| mean(row, sum))).collect(),
            degc,
            channels,
        }
    }
}

/// How fast means change, per second, from their neighbours.
fn rates(span_s: &[[f64; 2]], values: &[f64]) -> Vec<f64> {
    let slope = |i: usize| {
        let (a, b) = (i.saturating_sub(1), (i + 1).min(values.len() - 1));
        if a == b { 0.0 } else { (values[b] - values[a]) / (span_s[b][0] - span_s[a][0]) }
    };
    (0..values.len()).map(slope).collect()
}
