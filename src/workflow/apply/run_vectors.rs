//! The vectors of a run, with the temperatures of its thermistor.

use super::{Applied, ApplyOptions, Failure, TEMPERATURE, Work};
use crate::data::error::Finding;
use crate::data::recipe::Reading;
use crate::data::run::{Run, Vector, VectorSink, interpolate};
use crate::files::campaign::Campaign;
use crate::files::ccr;
use crate::files::output::Pending;
use crate::files::table::stream::{Batch, Format, Writer};
use crate::fit::statistics::median;
use crate::model::position::Position;
use crate::record::temperature_faults::{ChannelFault, Fault, PLAUSIBLE_DEGC, faults, left_out_text};
use std::path::Path;

/// Hands the vectors of a run to a sink and returns the rest of it.
fn read_with(data: &Path, allowed: &Reading, sink: &mut impl VectorSink) -> Result<Run, Vec<Finding>> {
    let shown = data.display().to_string();
    let reading = ccr::Options {
        allow_truncated: allowed.allow_truncated,
        allow_duplicates: allowed.allow_duplicates,
        recorded_path: Some(shown.clone()),
        ..ccr::Options::default()
    };
    ccr::read(data, &reading, sink)
}

/// A run without its vectors, which must be of the sensor and mode of the calibration.
///
/// # Errors
/// What is wrong with the file; another sensor or mode.
pub(super) fn read_run(data: &Path, applied: &Applied, allowed: &Reading) -> Result<Run, Failure> {
    let own = read_with(data, allowed, &mut ()).map_err(Failure::Unreadable)?;
    let (sensor, mode) = (&applied.sensor, &applied.mode);
    if (&own.header.sensor, &own.header.mode) != (sensor, mode) {
        let rule =
            format!("is of sensor {} in mode {}, the calibration of {sensor} in {mode}", own.header.sensor, own.header.mode);
        let remedy = "name the files of this sensor and mode";
        return Err(Failure::Refused(Finding::error(&data.display().to_string(), rule, remedy)));
    }
    check_position(data, &own, applied).map_err(Failure::Refused)?;
    Ok(own)
}

/// Positions that are named one by one.
const MOST_NAMED: usize = 6;

/// Refuses coil axes for settings in another position than that of the calibration. Its matrix turns to coil axes from its own position alone:
/// in another one the sensor stands otherwise, and how exactly it was turned there is not known.
fn check_position(data: &Path, run: &Run, applied: &Applied) -> Result<(), Finding> {
    let Some(held_in) = &applied.position else { return Ok(()) };
    let campaigns = Campaign::open(&[data.to_owned()], &mut Vec::new())?;
    let instructions = campaigns.first().map(|c| &c.file.instructions);
    let own = Position::from_axes(&held_in.axes).ok();
    // Positions are the same if their axes are; of one without axes the id is all that is known.
    let is_same = |id: u32| match (instructions.and_then(|i| i.position(id)), own) {
        (Some(position), Some(own)) => position == own,
        _ => id == held_in.id,
    };
    let mut others: Vec<u32> = run.settings.iter().map(|s| s.position).filter(|id| !is_same(*id)).collect();
    others.sort_unstable();
    others.dedup();
    if others.is_empty() {
        return Ok(());
    }
    let mut named: Vec<String> = others.iter().take(MOST_NAMED).map(ToString::to_string).collect();
    if others.len() > MOST_NAMED {
        named.push(format!("{} more", others.len() - MOST_NAMED));
    }
    let rule = format!(
        "has settings in position{} {}, and the calibration turns to coil axes from position {}, {}, alone",
        if others.len() == 1 { "" } else { "s" },
        named.join(", "),
        held_in.id,
        held_in.axes.join(" ")
    );
    let remedy = "use --frame sensor, or name the CPF of a run in the same position";
    Err(Finding::error(&data.display().to_string(), rule, remedy))
}

/// Calibrates the vectors of a run, at the temperatures of its thermistor; what the run and its thermistor show goes to the notes.
///
/// # Errors
/// What is wrong with the file; no channel of the name given or stated.
pub(super) fn vectors(work: &mut Work, own: &Run, allowed: &Reading, note: &str, file: &mut Pending) -> Result<(), Finding> {
    let data = work.data;
    // The name of the file stands before every note.
    let place = |line: Option<u64>| line.map_or_else(String::new, |line| format!("line {line}: "));
    work.counts.notes.extend(own.findings.iter().map(|f| format!("{}{}; {}", place(f.line), f.rule, f.remedy)));
    let degc = Thermometer::of(work, own)?;
    let writer = Writer::new(file, Format::Parquet, note);
    let mut sink = Sink { work, degc, writer, counters: Vec::new(), t_s: Vec::new(), readings: Default::default(), error: None };
    read_with(data, allowed, &mut sink).map_err(|findings| {
        let shown = data.display().to_string();
        findings.into_iter().next_back().unwrap_or_else(|| Finding::error(&shown, "cannot be read", "check the file"))
    })?;
    sink.flush();
    match sink.error {
        Some(error) => Err(error),
        None => sink.writer.finish(),
    }
}

/// The sensor temperature of a run.
enum Thermometer {
    Constant(f64),
    /// Readings as (s, °C), and their usual distance, s: so far from the readings beside a gap a temperature is still taken from them.
    Series(Vec<(f64, f64)>, f64),
}

/// Whether a fault is one of a channel. That two channels were exchanged is told of the one of a room, and both are wrong then.
fn concerns(fault: &ChannelFault, channel: &str) -> bool {
    fault.channel == channel || matches!(&fault.fault, Fault::Exchanged { other: (other, _), .. } if other == channel)
}

/// Readings whose distance is more usual distances than this have a gap between them, which a straight line does not close.
const GAP_STEPS: f64 = 5.0;

/// The channel of the sensor temperature, and who names it.
enum Named {
    /// The analyst.
    Analyst(String),
    /// The parameter files: their polynomials are of this thermistor.
    Files(String),
    /// The campaign of the run, or the usual name.
    Campaign(String),
}

impl Named {
    fn of(options: &ApplyOptions, applied: &Applied, by_campaign: String) -> Self {
        match (&options.temperature_column, &applied.channel) {
            (Some(channel), _) => Named::Analyst(channel.clone()),
            (None, Some(channel)) => Named::Files(channel.clone()),
            (None, None) => Named::Campaign(by_campaign),
        }
    }

    fn channel(&self) -> &str {
        let (Named::Analyst(channel) | Named::Files(channel) | Named::Campaign(channel)) = self;
        channel
    }
}

impl Thermometer {
    fn of(work: &mut Work, run: &Run) -> Result<Self, Finding> {
        let (options, applied, data) = (work.options, work.applied, work.data);
        let campaigns = Campaign::open(&[data.to_owned()], &mut Vec::new())?;
        let instructions = campaigns.first().map(|c| &c.file.instructions);
        let named = Named::of(options, applied, instructions.map(|i| i.channels(&run.header).0).unwrap_or_default());
        let channel = named.channel();
        if let Some(degc) = options.temperature_degc {
            if run.slow_channel(channel).is_some() {
                work.counts.notes.push(format!(
                    "its temperature channel {channel} was not used: the field is that at the {degc} °C of --temperature"
                ));
            }
            return Ok(Thermometer::Constant(degc));
        }
        if let (Named::Analyst(_), Some(stated)) = (&named, &applied.channel)
            && channel != stated
        {
            work.counts
                .notes
                .push(format!("the temperatures are those of {channel}; the calibration was made of those of {stated}"));
        }
        let refused = |rule: String, remedy: &str| Err(Finding::error(&data.display().to_string(), rule, remedy));
        match (run.slow_channel(channel), &named) {
            (Some(mut series), _) => {
                let count = series.len();
                series.retain(|(_, degc)| PLAUSIBLE_DEGC.contains(degc));
                if series.len() < count {
                    work.counts.notes.push(left_out_text(count - series.len(), channel));
                }
                if let Some(instructions) = instructions {
                    let of_channel = faults(run, instructions).into_iter().filter(|fault| concerns(fault, channel));
                    work.counts.notes.extend(of_channel.map(|fault| fault.text()));
                }
                let mut steps: Vec<f64> = series.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
                let usual_step = if steps.is_empty() { f64::INFINITY } else { median(&mut steps) };
                if let [(t_s, degc)] = series.as_slice() {
                    work.counts.notes.push(format!(
                        "its temperature channel {channel} has a single reading, {degc} °C at {t_s} s, which is taken for the whole run"
                    ));
                }
                let gaps = series.windows(2).filter(|pair| pair[1].0 - pair[0].0 > GAP_STEPS * usual_step);
                work.counts.notes.extend(gaps.map(|pair| {
                    format!(
                        "its temperature channel {channel} has no reading from {} to {} s: the temperature is not known there",
                        pair[0].0, pair[1].0
                    )
                }));
                // The thermistor that the calibration is of, as it was read: another one has another way to the sensor.
                if let Some(lag) = applied.lag.filter(|_| applied.channel.as_deref().is_none_or(|own| own == channel)) {
                    series = lag.in_run(&series);
                }
                Ok(Thermometer::Series(series, usual_step))
            }
            (None, Named::Analyst(_)) => refused(format!("has no channel `{channel}`"), "name one of its temperature channels"),
            (None, Named::Files(_)) if !run.temperatures.names.is_empty() => refused(
                format!("has no channel `{channel}`, of whose temperatures the calibration was made"),
                "name the channel of this thermistor with --temperature-column",
            ),
            (None, _) => {
                work.without_temperature(&format!("has no temperature channel `{channel}`"))?;
                Ok(Thermometer::Constant(f64::NAN))
            }
        }
    }

    /// The temperature at a time, °C; nan before and after the readings and in their gaps, further from a reading than they usually are from
    /// each other.
    fn at(&self, t_s: f64) -> f64 {
        let (series, step_s) = match self {
            Thermometer::Constant(degc) => return *degc,
            Thermometer::Series(series, step_s) => (series, *step_s),
        };
        let after = series.partition_point(|(own_s, _)| *own_s < t_s);
        let before_s = after.checked_sub(1).map_or(f64::NEG_INFINITY, |place| series[place].0);
        let after_s = series.get(after).map_or(f64::INFINITY, |(own_s, _)| *own_s);
        let near = t_s - before_s <= step_s || after_s - t_s <= step_s;
        if near || after_s - before_s <= GAP_STEPS * step_s { interpolate(series, t_s) } else { f64::NAN }
    }
}

/// Takes the vectors of a run while its file is read.
struct Sink<'a, 'b> {
    work: &'a mut Work<'b>,
    degc: Thermometer,
    writer: Writer<'a>,
    /// Counters of the samples, by which rows are found in the run again.
    counters: Vec<f64>,
    t_s: Vec<f64>,
    readings: [Vec<f64>; 3],
    error: Option<Finding>,
}

/// Vectors of a run that are calibrated at once.
const CHUNK: usize = 1 << 17;

impl VectorSink for Sink<'_, '_> {
    fn vector(&mut self, vector: Vector) {
        #[expect(clippy::cast_precision_loss, reason = "a counter of fifteen digits is exact")]
        self.counters.push(vector.n as f64);
        self.t_s.push(vector.t_s);
        for (column, reading) in self.readings.iter_mut().zip(vector.reading.0) {
            column.push(reading);
        }
        if self.t_s.len() == CHUNK {
            self.flush();
        }
    }
}

impl Sink<'_, '_> {
    fn flush(&mut self) {
        if self.error.is_none() && (!self.t_s.is_empty() || !self.writer.has_begun()) {
            self.error = self.write().err();
        }
    }

    fn write(&mut self) -> Result<(), Finding> {
        let counters = std::mem::take(&mut self.counters);
        let t_s = std::mem::take(&mut self.t_s);
        let readings = std::mem::take(&mut self.readings);
        let degc: Vec<f64> = t_s.iter().map(|t| self.degc.at(*t)).collect();
        let [x, y, z] = readings.clone();
        let columns = vec![("n", counters), ("t", t_s), ("x", x), ("y", y), ("z", z), (TEMPERATURE, degc.clone())];
        let mut batch = Batch::of_numbers(columns, self.work.counts.rows)?;
        self.work.calibrate(&mut batch, &readings, &degc)?;
        self.writer.write(&batch)
    }
}
