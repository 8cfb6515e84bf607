//! Telemetry and truth as tables.

use super::surroundings::{MARGIN_NS, Parts};
use super::truth::name;
use super::{SensorTelemetry, Telemetry, readings};
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000, ns};
use crate::files::output::Folder;
use crate::files::table::long::{Column, GROUP_ROWS, LongWriter};
use crate::files::twin::telemetry::TelemetryTwin;
use crate::model::polynomial::value;
use crate::simulate::noise::Random;
use nalgebra::Vector3;
use std::collections::BTreeMap;
use std::path::Path;

/// Quality bit of the inboard sensor.
const INBOARD: u8 = 8;
/// Full scales of the converters of the housekeeping (RO-IGEP-TR0028 section 4.2.2).
const U16: f64 = 65_536.0;
const U20: f64 = 1_048_576.0;

/// Columns of one type under their names, of equal lengths.
enum Values {
    Whole(Vec<i64>),
    Timestamps(Vec<i64>),
    Numbers(Vec<f64>),
    Counts(Vec<i32>),
    Bytes(Vec<u8>),
    Words(Vec<u8>, Vec<String>),
}

/// A table on its way into a file.
#[derive(Default)]
struct Table(Vec<(String, Values)>);

impl Table {
    fn put(&mut self, name: &str, values: Values) {
        self.0.push((name.to_owned(), values));
    }

    /// Times in the columns of telemetry.
    fn put_times(&mut self, time: &[Tt2000], leap: &LeapSeconds) {
        self.put("time_tt2000", Values::Whole(time.to_vec()));
        self.put("time_utc", Values::Timestamps(time.iter().map(|t| leap.utc(*t).timestamp_ns()).collect()));
    }

    fn put_three(&mut self, stem: &str, vectors: impl Iterator<Item = Vector3<f64>> + Clone) {
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            self.put(&format!("{stem}_{axis}"), Values::Numbers(vectors.clone().map(|v| v[i]).collect()));
        }
    }

    fn write(&self, out: &Path, name: &str, force: bool) -> Result<(), Finding> {
        let folder = Folder::open(out, force)?;
        let rows = self.0.first().map_or(0, |(_, values)| values.len());
        let group = |begin: usize| -> Vec<(&str, Column<'_>)> {
            let range = begin..(begin + GROUP_ROWS).min(rows);
            self.0.iter().map(|(name, values)| (name.as_str(), values.column(range.clone()))).collect()
        };
        let mut file = folder.create(name)?;
        let says = vec![("written_by".to_owned(), format!("calfit {}, simulated", env!("CARGO_PKG_VERSION")))];
        let mut writer = LongWriter::new(&mut file, &group(0), says)?;
        for begin in (0..rows).step_by(GROUP_ROWS) {
            writer.write(&group(begin))?;
        }
        writer.finish()?;
        file.finish().map(drop)
    }
}

impl Values {
    fn len(&self) -> usize {
        match self {
            Values::Whole(v) | Values::Timestamps(v) => v.len(),
            Values::Numbers(v) => v.len(),
            Values::Counts(v) => v.len(),
            Values::Bytes(v) | Values::Words(v, _) => v.len(),
        }
    }

    fn column(&self, rows: std::ops::Range<usize>) -> Column<'_> {
        match self {
            Values::Whole(v) => Column::Whole(&v[rows]),
            Values::Timestamps(v) => Column::Timestamps(&v[rows]),
            Values::Numbers(v) => Column::Numbers(&v[rows]),
            Values::Counts(v) => Column::Counts(&v[rows]),
            Values::Bytes(v) => Column::Bytes(&v[rows]),
            Values::Words(v, words) => Column::Words(&v[rows], words),
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "counts of 20 bits")]
fn whole(values: impl Iterator<Item = f64>) -> Values {
    Values::Counts(values.map(|v| v as i32).collect())
}

/// Seconds of the clock of the spacecraft.
fn clock(leap: &LeapSeconds, time: Tt2000) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "the clock has microseconds")]
    let seconds = (time - leap.clock_begin()) as f64 / SECOND_NS as f64;
    seconds
}

/// Times in equal steps from before the first to behind the last packet.
fn even(twin: &TelemetryTwin, step_s: f64) -> Vec<Tt2000> {
    let (begin, end, step) = (twin.span.from - MARGIN_NS, twin.span.to + MARGIN_NS, ns(step_s).max(1));
    (0..=(end - begin) / step).map(|k| begin + k * step).collect()
}

/// The times of the table of attitudes, without its holes.
#[must_use]
pub fn attitude_times(twin: &TelemetryTwin) -> Vec<Tt2000> {
    let holds = |time: &Tt2000| !twin.attitude.holes.iter().any(|hole| hole.holds(*time));
    even(twin, twin.attitude.step_s).into_iter().filter(holds).collect()
}

/// Rows by the day of a time, in their order.
fn by_day(leap: &LeapSeconds, rows: impl Iterator<Item = (usize, Tt2000)>) -> BTreeMap<i32, Vec<usize>> {
    let mut days: BTreeMap<i32, Vec<usize>> = BTreeMap::new();
    for (row, time) in rows {
        days.entry(leap.utc(time).day).or_default().push(row);
    }
    days
}

/// Writes telemetry, auxiliary tables and truth.
///
/// # Errors
/// What the operating system says, or a name that is taken.
pub fn write(telemetry: &Telemetry<'_>, out: &Path, force: bool) -> Result<(), Finding> {
    for (index, sensor) in telemetry.sensors.iter().enumerate() {
        edited(telemetry, index, sensor, out, force)?;
        truth(telemetry, index, sensor, out, force)?;
    }
    auxiliary(telemetry, out, force)?;
    housekeeping(telemetry, out, force)
}

fn edited(telemetry: &Telemetry<'_>, index: usize, sensor: &SensorTelemetry, out: &Path, force: bool) -> Result<(), Finding> {
    let (twin, leap) = (telemetry.twin, &telemetry.leap);
    let words: Vec<String> = twin.modes.iter().map(|m| m.sid.clone()).collect();
    let place = out.join("edited").join(format!("sensor={}", twin.sensors[index].name));
    for (day, rows) in by_day(leap, sensor.rows.iter().map(|r| r.tag).enumerate()) {
        let tags: Vec<Tt2000> = rows.iter().map(|i| sensor.rows[*i].tag).collect();
        let mut table = Table::default();
        table.put_times(&tags, leap);
        table.put("time_obt", Values::Numbers(tags.iter().map(|t| clock(leap, *t)).collect()));
        let number = |values: Vec<f64>| if twin.exact { Values::Numbers(values) } else { whole(values.into_iter()) };
        for (name, counts) in ["bx", "by", "bz"].into_iter().zip(&sensor.counts) {
            table.put(name, number(rows.iter().map(|i| counts[*i]).collect()));
        }
        for (name, own) in ["t_ob", "t_ib"].into_iter().zip([0, 1]) {
            table.put(name, number(rows.iter().map(|i| sensor.rows[*i].thermistor[own]).collect()));
        }
        let bit = if index == 0 { 0 } else { INBOARD };
        table.put("quality", Values::Bytes(rows.iter().map(|i| sensor.rows[*i].bad | bit).collect()));
        table.put("sid", Values::Words(rows.iter().map(|i| sensor.rows[*i].mode).collect(), words.clone()));
        table.write(&place.join(format!("date={}", name(day))), "part-0.parquet", force)?;
    }
    Ok(())
}

fn truth(telemetry: &Telemetry<'_>, index: usize, sensor: &SensorTelemetry, out: &Path, force: bool) -> Result<(), Finding> {
    let (twin, leap) = (telemetry.twin, &telemetry.leap);
    let words: Vec<String> = twin.modes.iter().map(|m| m.sid.clone()).collect();
    let mut order: Vec<usize> = (0..sensor.rows.len()).filter(|i| !sensor.rows[*i].repeated).collect();
    order.sort_by_key(|i| (sensor.rows[*i].time, *i));
    let thinned = order.into_iter().step_by(twin.truth_every as usize);
    let place = out.join("truth").join(format!("sensor={}", twin.sensors[index].name));
    for (day, rows) in by_day(leap, thinned.map(|i| (i, sensor.rows[i].time))) {
        let of = |i: &usize| &sensor.rows[*i];
        let times: Vec<Tt2000> = rows.iter().map(|i| of(i).time).collect();
        let mut table = Table::default();
        table.put_times(&times, leap);
        table.put("tag_tt2000", Values::Whole(rows.iter().map(|i| of(i).tag).collect()));
        table.put("sid", Values::Words(rows.iter().map(|i| of(i).mode).collect(), words.clone()));
        table.put("good", Values::Bytes(rows.iter().map(|i| u8::from(of(i).bad == 0)).collect()));
        table.put("t_degc", Values::Numbers(times.iter().map(|t| telemetry.degc(index, *t)).collect()));
        let fields: Vec<(Parts, Vector3<f64>)> = rows.iter().map(|i| telemetry.field(index, *i)).collect();
        let parts = fields.iter().map(|(parts, _)| parts);
        table.put_three("ext", parts.clone().map(|p| p.external_cel_nt));
        table.put_three("heat_sc", parts.clone().map(|p| p.heat_nt));
        table.put_three("wheel_sc", parts.clone().map(|p| p.wheel_nt));
        table.put_three("lap_sc", parts.clone().map(|p| p.lap_nt));
        table.put_three("scn_sc", parts.clone().map(|p| p.scn_nt));
        table.put_three("jump_sc", parts.clone().map(|p| p.jump_nt));
        table.put_three("a_uvw", fields.iter().map(|(_, a_nt)| *a_nt));
        table.put_three("b_sc", parts.map(|p| p.level_b_nt()));
        table.write(&place.join(format!("date={}", name(day))), "truth.parquet", force)?;
    }
    Ok(())
}

fn auxiliary(telemetry: &Telemetry<'_>, out: &Path, force: bool) -> Result<(), Finding> {
    let (twin, leap) = (telemetry.twin, &telemetry.leap);
    let times = attitude_times(twin);
    let mut random = Random::new(telemetry.seed, &["attitude"]);
    // Both signs of a quaternion are the same rotation, and tables hold both.
    let quaternions: Vec<[f64; 4]> = times
        .iter()
        .map(|time| {
            let sign = if random.uniform() < 0.5 { -1.0 } else { 1.0 };
            telemetry.surroundings.quaternion(*time).map(|v| sign * v)
        })
        .collect();
    let mut table = Table::default();
    table.put_times(&times, leap);
    for k in 0..4 {
        table.put(&format!("q{k}"), Values::Numbers(quaternions.iter().map(|q| q[k]).collect()));
    }
    table.write(&out.join("attitude"), "attitude.parquet", force)?;
    let times = even(twin, twin.orbit.step_s);
    let mut table = Table::default();
    table.put("time_tt2000", Values::Whole(times.clone()));
    for (axis, km) in ["x_km", "y_km", "z_km"].into_iter().zip(&twin.orbit.km) {
        let at = |t: &Tt2000| value(km, super::schedule::hours(twin.span.from, *t));
        table.put(axis, Values::Numbers(times.iter().map(at).collect()));
    }
    table.write(&out.join("attitude"), "position.parquet", force)?;
    let (times, wheels) = telemetry.surroundings.wheel_table();
    if !wheels.is_empty() {
        let mut table = Table::default();
        table.put("time_tt2000", Values::Whole(times));
        for (k, rates) in wheels.into_iter().enumerate() {
            table.put(&format!("w{}_hz", k + 1), Values::Numbers(rates.to_vec()));
        }
        table.write(&out.join("wheels"), "wheels.parquet", force)?;
    }
    if !twin.heaters.is_empty() {
        let on = telemetry.surroundings.heaters();
        let words: Vec<String> = twin.heaters.iter().map(|h| h.name.clone()).collect();
        #[expect(clippy::cast_possible_truncation, reason = "a spacecraft has few heaters")]
        let class = |class: usize| class as u8;
        let mut table = Table::default();
        table.put("from_tt2000", Values::Whole(on.iter().map(|o| o.from).collect()));
        table.put("to_tt2000", Values::Whole(on.iter().map(|o| o.to).collect()));
        table.put("cls", Values::Words(on.iter().map(|o| class(o.class)).collect(), words.clone()));
        table.write(&out.join("heater"), "romap.parquet", force)?;
        let mut jumps: Vec<(Tt2000, u8, i64)> =
            on.iter().flat_map(|o| [(o.from, class(o.class), 1), (o.to, class(o.class), -1)]).collect();
        jumps.sort_unstable();
        let mut table = Table::default();
        table.put("time_tt2000", Values::Whole(jumps.iter().map(|j| j.0).collect()));
        table.put("cls", Values::Words(jumps.iter().map(|j| j.1).collect(), words));
        table.put("sign", Values::Whole(jumps.iter().map(|j| j.2).collect()));
        table.write(&out.join("truth"), "heater_jumps.parquet", force)?;
    }
    Ok(())
}

/// Unsigned counts of signed ones: the middle of the range becomes zero.
fn wrapped(count: f64, range: f64) -> i32 {
    #[expect(clippy::cast_possible_truncation, reason = "counts of 20 bits")]
    let wrapped = (count.round() + 0.5 * range).rem_euclid(range) as i32;
    wrapped
}

fn housekeeping(telemetry: &Telemetry<'_>, out: &Path, force: bool) -> Result<(), Finding> {
    let (twin, leap) = (telemetry.twin, &telemetry.leap);
    let step = ns(twin.hk_step_s).max(1);
    let times: Vec<Tt2000> = (0..(twin.span.to - twin.span.from).div_euclid(step)).map(|k| twin.span.from + k * step).collect();
    // Voltages that drift by less than their steps an hour.
    let hours = |t: Tt2000| super::schedule::hours(twin.span.from, t);
    let reference = |t: Tt2000| 2.4996 + 4e-5 * hours(t);
    let positive = |t: Tt2000| 5.02 + 7e-3 * hours(t);
    let negative = |t: Tt2000| -4.958 - 9e-3 * hours(t);
    let readings: Vec<Vector3<f64>> = times.iter().map(|t| housekept(telemetry, *t)).collect::<Result<_, _>>()?;
    for (day, rows) in by_day(leap, times.iter().copied().enumerate()) {
        let own: Vec<Tt2000> = rows.iter().map(|i| times[*i]).collect();
        let mut table = Table::default();
        table.put_times(&own, leap);
        table.put("time_obt", Values::Numbers(own.iter().map(|t| clock(leap, *t)).collect()));
        for (name, index) in [("t_ob", 0), ("t_ib", 1)] {
            let count = |t: &Tt2000| telemetry.thermistors[index].count(telemetry.degc(index, *t)).round();
            table.put(name, whole(own.iter().map(count)));
        }
        for (name, id) in [("stage_a_id", 1), ("stage_b_id", 2), ("filter_cfg", 3)] {
            table.put(name, Values::Counts(vec![id; own.len()]));
        }
        // The formulas of section 4.2.2, solved for the count.
        let volts = |t: &Tt2000| (reference(*t) * 100_016.0 / 200_016.0 + 2.5) * (U20 - 1.0) / 5.0;
        table.put("ref_voltage", Values::Counts(own.iter().map(|t| wrapped(volts(t), U20)).collect()));
        let low = |t: &Tt2000| (negative(*t) + 5.0) * ((U20 - 1.0) * 27_400.0 / 127_424.0) / (256.0 * 2.4996);
        table.put("neg_voltage", whole(own.iter().map(|t| low(t).round().rem_euclid(256.0))));
        let high = |t: &Tt2000| (positive(*t) - 5.0) * ((U20 - 1.0) * 90_956.0 / 190_928.0) / (512.0 * 2.4996);
        table.put("pos_voltage", whole(own.iter().map(|t| high(t).round().rem_euclid(256.0))));
        for (axis, name) in ["bx_ob", "by_ob", "bz_ob"].into_iter().enumerate() {
            let count = |i: &usize| wrapped((readings[*i][axis] + 16_384.0) * (U16 - 1.0) / 32_768.0, U16);
            table.put(name, Values::Counts(rows.iter().map(count).collect()));
        }
        table.write(&out.join("hk").join(format!("date={}", name(day))), "part-0.parquet", force)?;
    }
    let mut table = Table::default();
    table.put_times(&times, leap);
    for (name, index) in [("t_ob_degc", 0), ("t_ib_degc", 1)] {
        table.put(name, Values::Numbers(times.iter().map(|t| telemetry.degc(index, *t)).collect()));
    }
    for (name, of) in
        [("ref_voltage", &reference as &dyn Fn(Tt2000) -> f64), ("neg_voltage", &negative), ("pos_voltage", &positive)]
    {
        table.put(name, Values::Numbers(times.iter().map(|t| of(*t)).collect()));
    }
    table.put_three("b_ob", readings.iter().copied());
    table.write(&out.join("truth"), "hk.parquet", force)
}

/// The reading of the primary sensor that housekeeping shows, enT.
fn housekept(telemetry: &Telemetry<'_>, time: Tt2000) -> Result<Vector3<f64>, Finding> {
    let (sensor, part) = (&telemetry.twin.sensors[0], telemetry.surroundings.at(time, 0, None));
    let sensing = readings::sensing(sensor, telemetry.degc(0, time))
        .map_err(|e| Finding::error(&sensor.twin.name, e.to_string(), super::REMEDY))?;
    let state = sensor.rotations.iter().find(|state| state.span.holds(time)).or(sensor.rotations.first());
    let field = state.map_or_else(Vector3::zeros, |s| s.uvw_to_sc.transpose() * (part.level_b_nt() + part.jump_nt));
    Ok(sensing.response * field + sensing.offset_ent)
}
