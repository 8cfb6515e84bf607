//! Telemetry of a mission whose truth is known: what `calfit flight` reads, with the truth beside it.
//!
//! The configuration goes to columns in three steps, which know no files: the [`schedule`] says which vectors there are, the
//! [`surroundings`] which field there is at their times, and [`readings`] what the sensors of the ground twin read of it.
//! [`tables`] and [`mission`] write what came of it.

pub mod coefficients;
pub mod mission;
pub mod readings;
pub mod schedule;
pub mod surroundings;
pub mod tables;
pub mod thermistor;
pub mod truth;

use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, Tt2000};
use crate::files::flight::mission::Boom;
use crate::files::output::Folder;
use crate::files::twin::telemetry::TelemetryTwin;
use crate::flight::temperature::Thermometer;
use nalgebra::Vector3;
use readings::Daily;
use schedule::{PacketCounts, Row, degc};
use serde::Serialize;
use std::path::{Path, PathBuf};
use surroundings::{Parts, Surroundings};
use thermistor::Thermistor;
use truth::DayTruth;

use super::noise::Random;

/// The telemetry of one sensor.
#[derive(Clone, Debug)]
pub struct SensorTelemetry {
    /// Rows in the order of the telemetry.
    pub rows: Vec<Row>,
    /// Their counts.
    pub counts: [Vec<f64>; 3],
    /// Their boom states, by the place among those of the sensor.
    boom: Vec<u16>,
    /// Daily offsets.
    pub daily: Daily,
    /// Packets.
    pub packets: PacketCounts,
    /// What flight processing has to find, day by day.
    pub days: Vec<DayTruth>,
}

/// Telemetry of a mission.
pub struct Telemetry<'a> {
    /// What it was made of.
    pub twin: &'a TelemetryTwin,
    /// With which seed.
    pub seed: u64,
    /// Leap seconds.
    pub leap: LeapSeconds,
    /// Fields and attitude.
    pub surroundings: Surroundings<'a>,
    /// Thermistors of both sensors.
    pub thermistors: [Thermistor; 2],
    /// Both sensors.
    pub sensors: [SensorTelemetry; 2],
}

/// What was written.
#[derive(Clone, Debug, Serialize)]
pub struct TelemetryWritten {
    /// Seed.
    pub seed: u64,
    /// The configuration of flight processing.
    pub config: PathBuf,
    /// Rows by sensor.
    pub rows: Vec<(String, usize)>,
}

const REMEDY: &str = "correct the sensor of the ground twin";

fn thermistor(twin: &TelemetryTwin, index: usize) -> Result<Thermistor, Finding> {
    let sensor = &twin.sensors[index];
    let thermometer = Thermometer { coefficients: sensor.thermistor_degc.clone(), t_off_degc: sensor.t_off_degc };
    Thermistor::new(thermometer, sensor.valid_degc).ok_or_else(|| {
        let rule = "`thermistor_degc` does not rise over the temperatures of `valid_degc` within the range of the converter";
        Finding::error(&sensor.name, rule, "correct one of them")
    })
}

impl<'a> Telemetry<'a> {
    /// Makes the telemetry of a twin.
    ///
    /// # Errors
    /// A sensor that has no axes, a thermistor that does not tell its temperature.
    pub fn new(twin: &'a TelemetryTwin, seed: u64) -> Result<Self, Finding> {
        let leap = LeapSeconds::default();
        let thermistors = [thermistor(twin, 0)?, thermistor(twin, 1)?];
        let surroundings = Surroundings::new(twin, seed);
        let one = |index: usize| SensorTelemetry::new(twin, index, &surroundings, &thermistors, &leap, seed);
        let sensors = [one(0)?, one(1)?];
        Ok(Self { twin, seed, leap, surroundings, thermistors, sensors })
    }

    /// The temperature of a sensor, °C.
    #[must_use]
    pub fn degc(&self, sensor: usize, time: Tt2000) -> f64 {
        degc(&self.twin.sensors[sensor].course, self.twin.span.from, time)
    }

    /// The field at the time of a row of a sensor: its parts, and LEVEL_A in nT. It is made anew for every row that asks for it, since it takes
    /// several times the memory of the row.
    #[must_use]
    pub fn field(&self, sensor: usize, row: usize) -> (Parts, Vector3<f64>) {
        let (made, stated) = (&self.sensors[sensor], &self.twin.sensors[sensor]);
        let part = self.surroundings.at(made.rows[row].time, sensor, Some(made.rows[row].mode));
        let state = stated.rotations.get(usize::from(made.boom[row]));
        let a_nt = state.map_or_else(Vector3::zeros, |state| level_a_nt(&part, state));
        (part, a_nt)
    }

    /// Writes all of it, the configuration of flight processing last. `ground` are coefficient files; a sensor of which none
    /// is given has exact ones.
    ///
    /// # Errors
    /// A coefficient file of no sensor, or what the operating system says.
    pub fn write(&self, ground: &[PathBuf], out: &Path, force: bool) -> Result<TelemetryWritten, Finding> {
        let root = Folder::open(out, force)?;
        root.check(mission::FILE)?;
        let ground = coefficients::write(self, ground, out, force)?;
        tables::write(self, out, force)?;
        let daily = Folder::open(&out.join("daily"), force)?;
        for (stated, sensor) in self.twin.sensors.iter().zip(&self.sensors) {
            for (day, polynomials) in &sensor.daily.polynomials {
                let (name, text) = mission::daily(stated, *day, polynomials);
                daily.write(&name, text.as_bytes())?;
            }
        }
        let truth = Folder::open(&out.join("truth"), force)?;
        truth.write("truth.json", truth::json(self)?.as_bytes())?;
        root.write(mission::FILE, mission::text(self, &ground).as_bytes())?;
        root.sync()?;
        let rows = self.twin.sensors.iter().zip(&self.sensors).map(|(s, made)| (s.name.clone(), made.rows.len())).collect();
        Ok(TelemetryWritten { seed: self.seed, config: out.join(mission::FILE), rows })
    }
}

/// LEVEL_A in a boom state, nT.
fn level_a_nt(part: &Parts, state: &Boom) -> Vector3<f64> {
    state.uvw_to_sc.transpose() * (part.level_b_nt() + part.jump_nt)
}

impl SensorTelemetry {
    fn new(
        twin: &TelemetryTwin,
        index: usize,
        surroundings: &Surroundings<'_>,
        thermistors: &[Thermistor; 2],
        leap: &LeapSeconds,
        seed: u64,
    ) -> Result<Self, Finding> {
        let sensor = &twin.sensors[index];
        let (rows, packets) = schedule::rows(twin, index, thermistors, seed);
        let thermometer = &thermistors[index].thermometer;
        let daily = Daily::new(sensor, index, &rows, thermometer, leap, seed);
        let mut noise = Random::new(seed, &["noise", &sensor.name]);
        let mut bad = Random::new(seed, &["bad", &sensor.name]);
        let [low, high] = readings::CONVERTER.limits();
        let mut counts = [const { Vec::new() }; 3];
        let mut booms: Vec<u16> = Vec::with_capacity(rows.len());
        for (index_of_row, row) in rows.iter().enumerate() {
            let part = surroundings.at(row.time, index, Some(row.mode));
            let degc = degc(&sensor.course, twin.span.from, row.time);
            let sensing =
                readings::sensing(sensor, degc).map_err(|e| Finding::error(&sensor.twin.name, e.to_string(), REMEDY))?;
            let boom = sensor.rotations.iter().position(|state| state.span.holds(row.time)).map(|boom| boom as u16);
            let boom = boom.or(booms.last().copied()).unwrap_or(0);
            let Some(state) = sensor.rotations.get(usize::from(boom)) else { continue };
            let field = level_a_nt(&part, state) + daily.at(leap.utc(row.time).day, degc);
            let mut reading = sensing.response * field + sensing.offset_ent;
            let own = if row.repeated {
                // A packet that comes twice has the same counts both times.
                let first = |other: &Row| !other.repeated && (other.tag, other.mode) == (row.tag, row.mode);
                let first = rows[..index_of_row].iter().rposition(first);
                first.map_or([0.0; 3], |first| std::array::from_fn(|i| counts[i][first]))
            } else if row.bad != 0 {
                [0; 3].map(|_: u8| (low + (high - low) * bad.uniform()).round())
            } else if twin.exact {
                readings::counts(&reading)
            } else {
                reading += Vector3::from_fn(|_, _| noise.normal()) * sensor.noise_ent;
                readings::stepped(readings::counts(&reading))
            };
            (0..3).for_each(|i| counts[i].push(own[i]));
            booms.push(boom);
        }
        let days = truth::days(twin, index, &rows, &counts, thermometer, leap);
        Ok(Self { rows, counts, boom: booms, daily, packets, days })
    }
}
