//! One simulated run: its timeline of fields, its slow channels, and its samples one by one.

use super::climate::{History, Temperatures, seconds};
use super::noise::{Flicker, Random};
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::run::{
    Header, InputFile, Kind, ReadingUnit, Run, ScalarRow, Setting, SlowTable, Vector, VectorAccount, VectorSink,
};
use crate::data::units::{FieldCoil, Reading};
use crate::files::twin::{Body, FacilityTwin, RunTwin, SensorTwin, Twin};
use crate::model::campaign::Instructions;
use crate::model::sensor::{Linear, SplitError};
use crate::record::known::in_sines::{InSines, Responses};
use crate::record::known::{Added, CHUNK, Known};
use jiff::Timestamp;
use nalgebra::{Matrix3, Rotation3, Vector3};
use std::f64::consts::TAU;

/// The temperatures and slow fields are straight lines over stretches of this length, s.
const SLOW_S: f64 = 5.0;
/// A clock that moves is steady over stretches of this length, s.
const CLOCK_S: f64 = 0.2;
/// Correlation time of the irregular part of the external field, s.
const IRREGULAR_S: f64 = 3600.0;
/// Numbers of this size have no fraction bits, and those of half of it either sign.
const WHOLE: f64 = 6_755_399_441_055_744.0;
/// Decimals of readings at most.
const MOST_DECIMALS: usize = 6;
/// A step has settled once this part of it is left.
const SETTLED: f64 = 1e-9;

/// A stretch of the timeline with one field.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    t_start_s: f64,
    t_end_s: f64,
    /// Setting of the coils including the scatter of the source; for a sine its amplitude.
    drive: [f64; 3],
    frequency_hz: f64,
    position: u32,
    /// Field of the heater, nT, coil axes.
    heater_nt: [f64; 3],
}

/// A run that was simulated: what stands in its file, and a source of its samples.
#[derive(Clone, Debug)]
pub struct SimulatedRun<'a> {
    /// Keys.
    pub header: Header,
    /// Settings.
    pub settings: Vec<Setting>,
    /// Thermistors.
    pub temperatures: SlowTable,
    /// Variometer; empty where the external field does not vary.
    pub channels: SlowTable,
    /// Moduli of a scalar calibration.
    pub scalar: Vec<ScalarRow>,
    influences: Influences<'a>,
    seed: u64,
    /// Known effects beside the linear sensor.
    added: Option<Added>,
}

/// All that acts on the sensor during a run.
#[derive(Clone, Debug)]
struct Influences<'a> {
    twin: &'a Twin,
    sensor: &'a SensorTwin,
    start: Timestamp,
    climate: &'a Temperatures,
    stretches: Vec<Stretch>,
    /// The external field at the variometer, nT, coil axes.
    variation_nt: [History; 3],
    coil_axes: Matrix3<f64>,
    /// Sampling frequency, about which known effects move it.
    rate_hz: f64,
    /// Known effects in sines.
    in_sines: InSines,
}

impl<'a> SimulatedRun<'a> {
    /// Prepares a run; its samples come from [`SimulatedRun::vectors`].
    ///
    /// # Errors
    /// A programme that names a position without axes, or a sensor that is none at the temperatures of the run.
    pub fn new(twin: &'a Twin, run: &RunTwin, climate: &'a Temperatures, seed: u64) -> Result<Self, Finding> {
        let refuse = |rule: String, remedy: &str| Finding::error(&format!("run {}", run.id), rule, remedy);
        let (Some(sensor), Some(programme)) = (twin.sensors.get(run.sensor), twin.programmes.get(run.programme)) else {
            return Err(refuse("names a sensor or programme that is not there".to_owned(), "correct the twin"));
        };
        let facility = &twin.facility;
        let nominal_rate_hz = run.nominal_rate_hz.unwrap_or(sensor.nominal_rate_hz);
        let mut random = Random::new(seed, &[&run.id, "programme"]);

        let mut settings = Vec::new();
        let mut stretches = Vec::new();
        let mut t_s = 0.0;
        for step in (0..run.repeat).flat_map(|_| &programme.steps) {
            let t_end_s = run.longest_s.map_or(f64::INFINITY, |longest_s| longest_s).min(t_s + step.duration_s);
            if t_end_s <= t_s {
                break;
            }
            let position = run.position.unwrap_or(step.position);
            if !twin.places.contains_key(&position) {
                let rule = format!("position {position} of {} has no axes", programme.name);
                return Err(refuse(rule, "add [[campaign.position]]"));
            }
            let scatter: [f64; 3] = facility.setting_scatter_nt.map(|s| s * random.normal());
            let field = FieldCoil(step.field.0.map(|b| run.field_factor * b));
            let drive = std::array::from_fn(|k| field.0[k] + if step.frequency_hz > 0.0 { 0.0 } else { scatter[k] });
            let (frequency_hz, heater_nt) = (step.frequency_hz, [0.0; 3]);
            settings.push(Setting { t_start_s: t_s, t_end_s, field, frequency_hz, position });
            stretches.push(Stretch { t_start_s: t_s, t_end_s, drive, frequency_hz, position, heater_nt });
            t_s = t_end_s;
            let heating = climate.body_degc(Body::Box, run.start, t_s + SLOW_S) > climate.body_degc(Body::Box, run.start, t_s);
            pause(&mut stretches, run.pause_s, twin.thermal_box.heater.filter(|_| heating), position);
            t_s += run.pause_s;
        }

        let slow = |begin: usize| {
            let count = (t_s / twin.slow_interval_s).ceil() as usize + 1;
            (begin..count).map(|i| (i as f64 * twin.slow_interval_s).min(t_s)).collect::<Vec<f64>>()
        };
        let slow_s = slow(0);
        let temperatures =
            climate.table(&twin.thermistors, run.start, &slow_s, &mut Random::new(seed, &[&run.id, "thermistors"]));
        let mut random = Random::new(seed, &[&run.id, "variation"]);
        let variation_nt = variation(facility, run.start, &slow_s, twin.slow_interval_s, &mut random);
        let varies = facility.daily_nt.iter().chain(&facility.irregular_nt).any(|v| *v > 0.0);
        let channels = if varies { variometer(&variation_nt, facility, &slow_s, &mut random) } else { SlowTable::default() };

        let influences = Influences {
            twin,
            sensor,
            start: run.start,
            climate,
            stretches,
            variation_nt,
            coil_axes: facility.coil.axes().unwrap_or_else(Matrix3::identity),
            rate_hz: sensor.rate_hz * nominal_rate_hz / sensor.nominal_rate_hz,
            in_sines: InSines::default(),
        };
        for stretch in &influences.stretches {
            influences
                .sensor_at(stretch, stretch.t_start_s)
                .map_err(|error| refuse(error.to_string(), "correct the polynomials of the sensor"))?;
        }
        let mut scalar = Vec::new();
        if programme.kind == Kind::Scalar {
            for setting in &settings {
                let t_s = 0.5 * (setting.t_start_s + setting.t_end_s);
                let holds = |s: &&Stretch| (s.t_start_s..s.t_end_s).contains(&t_s);
                let Some(stretch) = influences.stretches.iter().find(holds) else { continue };
                let modulus_nt =
                    Vector3::from(influences.field(stretch, t_s).0).norm() + facility.scalar_noise_nt * random.normal();
                scalar.push(ScalarRow { t_s, setting: setting.field.0, modulus_nt });
            }
        }
        let header = Header {
            run: run.id.clone(),
            start: run.start.into(),
            kind: programme.kind,
            configuration: programme.name.clone(),
            sensor: sensor.name.clone(),
            mode: sensor.mode.clone(),
            sample_rate_hz: nominal_rate_hz,
            unit: ReadingUnit::Ent,
            field_source: facility.field_source.clone(),
            coil_correction: facility.coil_correction,
            earthfield_compensation: facility.compensation.clone(),
        };
        Ok(Self { header, settings, temperatures, channels, scalar, influences, seed, added: None })
    }

    /// The same run with known effects in its readings. Effects that the run cannot have give a warning.
    #[must_use]
    pub fn with_effects(mut self, known: &Known, instructions: &Instructions, notes: &mut Vec<Note>) -> Self {
        if self.header.kind == Kind::Frequency {
            let run = self.run(VectorAccount::default());
            self.influences.in_sines = InSines::new(known, &run, Responses::All, notes);
            return self;
        }
        let level_ent = |t_s: f64| {
            let stretches = &self.influences.stretches;
            let at = stretches.partition_point(|s| s.t_end_s <= t_s).min(stretches.len().saturating_sub(1));
            stretches.get(at).map_or([f64::NAN; 3], |stretch| self.influences.level_ent(stretch, t_s))
        };
        self.added = Added::new(known, &self.run(VectorAccount::default()), level_ent, instructions, notes);
        self
    }

    /// Everything but the samples.
    fn run(&self, vectors: VectorAccount) -> Run {
        Run {
            header: self.header.clone(),
            settings: self.settings.clone(),
            blocks: Vec::new(),
            temperatures: self.temperatures.clone(),
            channels: self.channels.clone(),
            scalar: self.scalar.clone(),
            vectors,
            input: InputFile { path: self.header.run.clone(), size_bytes: 0, sha256: String::new() },
            findings: Vec::new(),
            exclusions: Vec::new(),
        }
    }

    /// Decimals that hold the resolution of the readings.
    #[must_use]
    pub fn decimals(&self) -> usize {
        let whole = |d: &usize| {
            let scaled = self.influences.sensor.resolution_ent * 10f64.powi(*d as i32);
            (scaled - scaled.round()).abs() < 1e-9 * scaled
        };
        (0..MOST_DECIMALS).find(whole).unwrap_or(MOST_DECIMALS)
    }

    /// Number of samples, lost ones included.
    #[must_use]
    pub fn samples(&self) -> u64 {
        let end_s = self.influences.stretches.last().map_or(0.0, |s| s.t_end_s);
        if self.header.kind == Kind::Scalar { 0 } else { (end_s * self.influences.rate_hz - 0.5).ceil().max(0.0) as u64 }
    }

    /// Gives the run to an analysis without a file: the samples go to `sink`. Times are exact, and gaps are counted but not listed.
    pub fn play(&self, sink: &mut impl VectorSink) -> Run {
        sink.begin(&self.header, &self.settings);
        let mut account = VectorAccount { measured_rate_hz: Some(self.influences.rate_hz), ..VectorAccount::default() };
        let mut expected = 0;
        for vector in self.vectors() {
            account.span_s = Some([account.span_s.map_or(vector.t_s, |[first, _]| first), vector.t_s]);
            account.gap_count += u64::from(vector.n > expected);
            account.lost += vector.n - expected;
            account.count += 1;
            expected = vector.n + 1;
            sink.vector(vector);
        }
        self.run(account)
    }

    /// The samples in time order; the same ones every time.
    #[must_use]
    pub fn vectors(&self) -> Samples<'_> {
        let mut random = Random::new(self.seed, &[&self.header.run, "samples"]);
        let sensor = self.influences.sensor;
        let flicker = sensor.flicker_ent.map(|a| Flicker::new(a, self.influences.rate_hz, sensor.flicker_lowest_hz, &mut random));
        Samples {
            influences: &self.influences,
            count: self.samples(),
            sample: 0,
            line_end: 0,
            stretch: 0,
            level_ent: [0.0; 3],
            slope_ent: [0.0; 3],
            transient_ent: [0.0; 3],
            transient_decay: [0.0; 3],
            tone: None,
            flicker,
            random,
            losses: Random::new(self.seed, &[&self.header.run, "losses"]),
            lost: false,
            added: self.added.clone(),
            chunk: Vec::new(),
        }
    }
}

/// Zero field after a setting, with a pulse of the heater in it.
fn pause(stretches: &mut Vec<Stretch>, pause_s: f64, heater: Option<crate::files::twin::Heater>, position: u32) {
    let Some(begin_s) = stretches.last().map(|s| s.t_end_s).filter(|_| pause_s > 0.0) else { return };
    let end_s = begin_s + pause_s;
    let mut push = |t_start_s: f64, t_end_s: f64, heater_nt: [f64; 3]| {
        if t_end_s > t_start_s {
            stretches.push(Stretch { t_start_s, t_end_s, drive: [0.0; 3], frequency_hz: 0.0, position, heater_nt });
        }
    };
    match heater {
        Some(h) => {
            let on_s = (begin_s + h.delay_s).min(end_s);
            let off_s = (on_s + h.longest_s).min(end_s);
            push(begin_s, on_s, [0.0; 3]);
            push(on_s, off_s, h.field_nt);
            push(off_s, end_s, [0.0; 3]);
        }
        None => push(begin_s, end_s, [0.0; 3]),
    }
}

fn variation(facility: &FacilityTwin, start: Timestamp, t_s: &[f64], interval_s: f64, random: &mut Random) -> [History; 3] {
    let decay = (-interval_s / IRREGULAR_S).exp();
    let mut irregular: [f64; 3] = std::array::from_fn(|_| random.normal());
    let day_s = start.as_second().rem_euclid(86_400) as f64;
    let mut variation_nt = std::array::from_fn(|_| History { step_s: interval_s, values: Vec::with_capacity(t_s.len()) });
    for t in t_s {
        let angle = TAU * (day_s + t) / 86_400.0;
        for (k, history) in variation_nt.iter_mut().enumerate() {
            history.values.push(facility.daily_nt[k] * angle.cos() + facility.irregular_nt[k] * irregular[k]);
        }
        irregular = irregular.map(|v| decay * v + (1.0 - decay * decay).sqrt() * random.normal());
    }
    variation_nt
}

fn variometer(variation_nt: &[History; 3], facility: &FacilityTwin, t_s: &[f64], random: &mut Random) -> SlowTable {
    let values = (0..3).map(|k| {
        t_s.iter().map(|t| variation_nt[k].at(*t) + facility.variometer_noise_nt * random.normal()).collect::<Vec<f64>>()
    });
    let values = values.collect();
    SlowTable { names: ["VARX", "VARY", "VARZ"].map(str::to_owned).to_vec(), t_s: t_s.to_vec(), values }
}

/// A rotation vector in degrees as a matrix.
fn rotation(vector_deg: [f64; 3]) -> Matrix3<f64> {
    Rotation3::from_scaled_axis(Vector3::from(vector_deg.map(f64::to_radians))).into_inner()
}

/// Why there is no sensor in a stretch of a run.
#[derive(Debug, thiserror::Error)]
enum SensorError {
    #[error("a position has no axes")]
    NoAxes,
    #[error("at {temperature_degc:.1} °C {why}")]
    Impossible { temperature_degc: f64, why: SplitError },
}

impl Influences<'_> {
    fn sensor_degc(&self, t_s: f64) -> f64 {
        self.climate.body_degc(Body::Sensor, self.start, t_s)
    }

    fn sensor_at(&self, stretch: &Stretch, t_s: f64) -> Result<Linear, SensorError> {
        let (position, missed_deg) = self.twin.places.get(&stretch.position).ok_or(SensorError::NoAxes)?;
        let temperature_degc = self.sensor_degc(t_s);
        let turned = |i: usize| self.sensor.rotation_deg[i] + self.sensor.rotation_per_k_deg[i] * temperature_degc;
        let rho = rotation(*missed_deg) * rotation(std::array::from_fn(turned));
        let sensor = self.sensor.model.at(temperature_degc, &position.r_nom(), &rho);
        sensor.map_err(|why| SensorError::Impossible { temperature_degc, why })
    }

    /// The constant part of the field at the sensor, nT, coil axes.
    fn field(&self, stretch: &Stretch, t_s: f64) -> FieldCoil {
        let drive = if stretch.frequency_hz > 0.0 { [0.0; 3] } else { stretch.drive };
        let facility = &self.twin.facility;
        let temperature = |body| self.climate.body_degc(body, self.start, t_s);
        let FieldCoil(driven) =
            facility.coil.field(&self.coil_axes, drive, [temperature(Body::Coil); 3], temperature(Body::Rack));
        let now = |r: &&crate::files::twin::Residual| seconds(self.start, r.from) <= t_s;
        let residual_nt = facility.residual.iter().rev().find(now).map_or([0.0; 3], |r| r.field_nt);
        FieldCoil(std::array::from_fn(|k| {
            driven[k] + residual_nt[k] + facility.leakage[k] * self.variation_nt[k].at(t_s) + stretch.heater_nt[k]
        }))
    }

    /// Reading without noise and sine, enT.
    fn level_ent(&self, stretch: &Stretch, t_s: f64) -> [f64; 3] {
        let offset_ent = self.sensor.model.offset_ent(self.sensor_degc(t_s));
        // The polynomials were checked when the run was prepared.
        match self.sensor_at(stretch, t_s) {
            Ok(sensor) => sensor.reading(self.field(stretch, t_s), offset_ent).0,
            Err(_) => [f64::NAN; 3],
        }
    }

    fn tone(&self, stretch: &Stretch, t_s: f64) -> Option<Tone> {
        if stretch.frequency_hz <= 0.0 {
            return None;
        }
        let facility = &self.twin.facility;
        let temperature = |body| self.climate.body_degc(body, self.start, t_s);
        let at = |drive| facility.coil.field(&self.coil_axes, drive, [temperature(Body::Coil); 3], temperature(Body::Rack)).0;
        let (with, without) = (at(stretch.drive), at([0.0; 3]));
        let amplitude = FieldCoil(std::array::from_fn(|k| with[k] - without[k]));
        let Reading(full) = self.sensor_at(stretch, t_s).ok()?.reading(amplitude, [0.0; 3]);
        let (model, f) = (&self.sensor.model, stretch.frequency_hz);
        let parameters = model.response_at(self.sensor_degc(t_s))?;
        let phasor = std::array::from_fn(|i| {
            let factor = self.in_sines.factor(f, i);
            let (sin, cos) = (model.response.phase_rad(f, &parameters[i]) + factor.arg()).sin_cos();
            let amplitude_ent = full[i] * model.response.value(f, &parameters[i]) * factor.norm();
            (amplitude_ent * cos, amplitude_ent * sin)
        });
        // Where the clock was fast, the time of the counter is ahead of that of the field.
        let field_s = t_s - self.in_sines.lead_s(t_s);
        let (sin, cos) = (TAU * (f * (field_s - stretch.t_start_s)).fract()).sin_cos();
        let (turn_sin, turn_cos) = (TAU * (f / self.rate_hz / (1.0 + self.in_sines.clock(t_s))).fract()).sin_cos();
        Some(Tone { phasor, sin, cos, turn_sin, turn_cos })
    }
}

/// A sine: the phase now, its change from sample to sample, and what the components make of it.
#[derive(Clone, Copy, Debug)]
struct Tone {
    /// Amplitude times cosine and sine of the phase of the response, enT.
    phasor: [(f64, f64); 3],
    sin: f64,
    cos: f64,
    turn_sin: f64,
    turn_cos: f64,
}

/// The samples of a run.
#[derive(Clone, Debug)]
pub struct Samples<'a> {
    influences: &'a Influences<'a>,
    count: u64,
    sample: u64,
    /// The straight lines hold before this sample.
    line_end: u64,
    stretch: usize,
    level_ent: [f64; 3],
    slope_ent: [f64; 3],
    transient_ent: [f64; 3],
    transient_decay: [f64; 3],
    tone: Option<Tone>,
    flicker: [Flicker; 3],
    random: Random,
    losses: Random,
    lost: bool,
    added: Option<Added>,
    /// Its contributions to the samples of the chunk that holds the next sample, enT.
    chunk: Vec<[f64; 3]>,
}

impl Samples<'_> {
    /// Time of a sample: the middle of its period.
    fn t_s(&self, sample: u64) -> f64 {
        (sample as f64 + 0.5) / self.influences.rate_hz
    }

    /// First sample at or after a time.
    fn sample_at(&self, t_s: f64) -> u64 {
        (t_s * self.influences.rate_hz - 0.5).ceil().max(0.0) as u64
    }

    /// Contribution of the known effects to the next sample, computed for many samples at a time.
    fn added_ent(&mut self) -> [f64; 3] {
        let place = (self.sample % CHUNK as u64) as usize;
        if place == 0 {
            let times: Vec<f64> = (self.sample..(self.sample + CHUNK as u64).min(self.count)).map(|n| self.t_s(n)).collect();
            self.chunk = self.added.as_mut().map_or_else(Vec::new, |added| added.at(&times));
        }
        self.chunk.get(place).copied().unwrap_or_default()
    }

    /// New straight lines from the sample that comes next.
    #[cold]
    fn enter(&mut self) {
        let stretches = &self.influences.stretches;
        let t_s = self.t_s(self.sample);
        let before = self.stretch;
        while self.stretch + 1 < stretches.len() && stretches[self.stretch].t_end_s <= t_s {
            self.stretch += 1;
        }
        let stretch = &stretches[self.stretch];
        let begin_ent = self.influences.level_ent(stretch, t_s);
        let line_s = if self.influences.in_sines.moves_clock() { CLOCK_S } else { SLOW_S };
        self.line_end = self.sample_at(stretch.t_end_s.min(t_s + line_s)).max(self.sample + 1);
        let steps = (self.line_end - self.sample) as f64;
        let end_ent = self.influences.level_ent(stretch, t_s + steps / self.influences.rate_hz);
        self.level_ent = begin_ent;
        self.slope_ent = std::array::from_fn(|i| (end_ent[i] - begin_ent[i]) / steps);
        self.tone = self.influences.tone(stretch, t_s);
        if self.stretch != before {
            self.step(&stretches[before], stretch, t_s);
        } else if self.transient_ent.iter().zip(begin_ent).all(|(left, level)| left.abs() < SETTLED * level.abs().max(1.0)) {
            self.transient_ent = [0.0; 3];
        }
    }

    /// The response follows a step of the constant field like a low-pass of first order with its f_3dB.
    fn step(&mut self, before: &Stretch, after: &Stretch, t_s: f64) {
        if before.frequency_hz > 0.0 || after.frequency_hz > 0.0 || before.position != after.position {
            self.transient_ent = [0.0; 3];
            return;
        }
        let edge_s = after.t_start_s;
        let (old, new) = (self.influences.level_ent(before, edge_s), self.influences.level_ent(after, edge_s));
        let model = &self.influences.sensor.model;
        let temperature_degc = self.influences.sensor_degc(edge_s);
        for i in 0..3 {
            let rate = TAU * crate::model::polynomial::value(&model.f_3db_hz[i], temperature_degc);
            self.transient_decay[i] = (-rate / self.influences.rate_hz).exp();
            self.transient_ent[i] = (old[i] - new[i]) * (-rate * (t_s - edge_s)).exp();
        }
    }
}

impl Iterator for Samples<'_> {
    type Item = Vector;

    fn next(&mut self) -> Option<Vector> {
        let sensor = self.influences.sensor;
        loop {
            if self.sample >= self.count {
                return None;
            }
            if self.sample >= self.line_end {
                self.enter();
            }
            let mut reading = [0.0; 3];
            for i in 0..3 {
                let noise = sensor.white_ent[i] * self.random.normal() + self.flicker[i].next(&mut self.random);
                reading[i] = self.level_ent[i] + self.transient_ent[i] + noise;
                self.level_ent[i] += self.slope_ent[i];
                self.transient_ent[i] *= self.transient_decay[i];
            }
            if let Some(tone) = &mut self.tone {
                for (value, (cos, sin)) in reading.iter_mut().zip(tone.phasor) {
                    *value += tone.sin * cos + tone.cos * sin;
                }
                let turned = tone.sin * tone.turn_cos + tone.cos * tone.turn_sin;
                tone.cos = tone.cos * tone.turn_cos - tone.sin * tone.turn_sin;
                tone.sin = turned;
            }
            if self.added.is_some() {
                let added_ent = self.added_ent();
                (0..3).for_each(|i| reading[i] += added_ent[i]);
            }
            let n = self.sample;
            self.sample += 1;
            if n.is_multiple_of(u64::from(sensor.packet_samples)) {
                self.lost = sensor.packet_loss > 0.0 && self.losses.uniform() < sensor.packet_loss;
            }
            if self.lost {
                continue;
            }
            let reading = reading.map(|v| {
                let steps = v.clamp(-sensor.range_ent, sensor.range_ent) / sensor.resolution_ent;
                // Adding and taking away a number without fraction bits rounds, without a call.
                ((steps + WHOLE) - WHOLE) * sensor.resolution_ent
            });
            return Some(Vector { n, t_s: self.t_s(n), reading: Reading(reading) });
        }
    }
}
