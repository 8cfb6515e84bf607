//! What the sensors measure: the external field, the attitude, and what the spacecraft adds.

use super::schedule::hours;
use crate::data::time::{SECOND_NS, Tt2000, ns};
use crate::files::twin::telemetry::TelemetryTwin;
use crate::simulate::climate::History;
use crate::simulate::noise::{Flicker, Random};
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use std::f64::consts::TAU;

/// Everything is known so far before the first and behind the last packet: shifts and tables reach beyond them, ns.
pub const MARGIN_NS: i64 = 1800 * SECOND_NS;
/// Step of fields that move slowly, s.
const STEP_S: f64 = 1.0;
/// Sines of the external field per axis.
const SINES: u32 = 64;
/// The lowest frequency of the noise of the spacecraft, Hz.
const LOWEST_HZ: f64 = 1e-4;

/// The parts of the field at a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Parts {
    /// External field, nT, celestial frame.
    pub external_cel_nt: Vector3<f64>,
    /// The same in axes of the spacecraft, as all further ones.
    pub external_sc_nt: Vector3<f64>,
    /// Heaters.
    pub heat_nt: Vector3<f64>,
    /// Wheels.
    pub wheel_nt: Vector3<f64>,
    /// Fixed lines.
    pub lap_nt: Vector3<f64>,
    /// Noise of the spacecraft.
    pub scn_nt: Vector3<f64>,
    /// The offset that jumps.
    pub jump_nt: Vector3<f64>,
}

impl Parts {
    /// LEVEL_B: everything but the offset that jumps.
    #[must_use]
    pub fn level_b_nt(&self) -> Vector3<f64> {
        self.external_sc_nt + self.heat_nt + self.wheel_nt + self.lap_nt + self.scn_nt
    }
}

/// A heater that is on, by its class.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct On {
    /// From when on.
    pub from: Tt2000,
    /// Until when, not of it.
    pub to: Tt2000,
    /// Its class.
    pub class: usize,
}

/// A wheel or a fixed line: the field turns in a plane.
#[derive(Clone, Copy, Debug)]
struct Turning {
    cosine_nt: Vector3<f64>,
    sine_nt: Vector3<f64>,
}

impl Turning {
    fn new(amplitude_nt: f64, random: &mut Random) -> Self {
        let mut direction = || Vector3::from_fn(|_, _| random.normal()).normalize() * amplitude_nt;
        Self { cosine_nt: direction(), sine_nt: direction() }
    }

    fn at(&self, cycles: f64) -> Vector3<f64> {
        // Whole turns are taken off first: sines of large angles lose digits.
        let (sine, cosine) = (TAU * cycles.fract()).sin_cos();
        self.cosine_nt * cosine + self.sine_nt * sine
    }
}

/// A wheel with its rates at the rows of the table and the turns that it has made until there.
#[derive(Clone, Debug)]
struct Wheel {
    rate_hz: Vec<f64>,
    turns: Vec<f64>,
    field: Turning,
}

/// All that is around the sensors.
#[derive(Clone, Debug)]
pub struct Surroundings<'a> {
    twin: &'a TelemetryTwin,
    begin: Tt2000,
    external: [History; 3],
    noise: [History; 3],
    heaters: Vec<Vec<On>>,
    wheels: Vec<Wheel>,
    lines: Vec<Vec<Turning>>,
    start: Rotation3<f64>,
    rate: Vector3<f64>,
}

fn seconds(from: Tt2000, to: Tt2000) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "differences of times of days")]
    let seconds = (to - from) as f64 / SECOND_NS as f64;
    seconds
}

impl<'a> Surroundings<'a> {
    /// The surroundings of a twin with a seed.
    #[must_use]
    pub fn new(twin: &'a TelemetryTwin, seed: u64) -> Self {
        let begin = twin.span.from - MARGIN_NS;
        let count = (seconds(begin, twin.span.to + MARGIN_NS) / STEP_S).ceil() as usize + 2;
        let axes = ["x", "y", "z"];
        let external = std::array::from_fn(|i| external(twin, i, count, &mut Random::new(seed, &["external", axes[i]])));
        let noise = std::array::from_fn(|i| {
            let mut random = Random::new(seed, &["spacecraft", axes[i]]);
            let mut flicker = Flicker::new(twin.spacecraft.noise_nt[i], 1.0 / STEP_S, LOWEST_HZ, &mut random);
            History { step_s: STEP_S, values: (0..count).map(|_| flicker.next(&mut random)).collect() }
        });
        let heaters = (0..twin.heaters.len()).map(|class| switched(twin, class, seed)).collect();
        let rows = wheel_times(twin).len();
        let wheels = twin.wheels.iter().enumerate().map(|(index, stated)| {
            let mut random = Random::new(seed, &["wheel", &index.to_string()]);
            let wander = TAU * random.uniform();
            let rate_hz: Vec<f64> = (0..rows)
                .map(|row| {
                    let h = (row as f64 * twin.wheel_step_s - seconds(begin, twin.span.from)) / 3600.0;
                    // A slow swing about the drift, so that the rates are no straight lines.
                    stated.rate_hz + stated.drift_hz_per_h * (h + 0.02 * (TAU * 3.0 * h + wander).sin())
                })
                .collect();
            let mut turns = vec![0.0];
            for pair in rate_hz.windows(2) {
                let last = turns.last().copied().unwrap_or(0.0);
                turns.push(last + 0.5 * (pair[0] + pair[1]) * twin.wheel_step_s);
            }
            Wheel { rate_hz, turns, field: Turning::new(stated.amplitude_nt, &mut random) }
        });
        let wheels = wheels.collect();
        let lines = twin.modes.iter().map(|mode| {
            let mut random = Random::new(seed, &["lines", &mode.sid]);
            mode.lines_hz.iter().map(|_| Turning::new(twin.spacecraft.line_nt, &mut random)).collect()
        });
        let turn = |deg: [f64; 3]| Vector3::from(deg.map(f64::to_radians));
        Self {
            begin,
            external,
            noise,
            heaters,
            wheels,
            lines: lines.collect(),
            start: Rotation3::new(turn(twin.attitude.start_deg)),
            rate: turn(twin.attitude.rate_deg_per_h),
            twin,
        }
    }

    /// From the spacecraft to the celestial frame.
    #[must_use]
    pub fn attitude(&self, time: Tt2000) -> Rotation3<f64> {
        self.start * Rotation3::new(self.rate * hours(self.twin.span.from, time))
    }

    /// The same as quaternion (w, x, y, z).
    #[must_use]
    pub fn quaternion(&self, time: Tt2000) -> [f64; 4] {
        let half = UnitQuaternion::from_scaled_axis(self.rate * hours(self.twin.span.from, time));
        let q = UnitQuaternion::from_rotation_matrix(&self.start) * half;
        [q.w, q.i, q.j, q.k]
    }

    /// Stretches in which heaters are on, in the order of their begins.
    #[must_use]
    pub fn heaters(&self) -> Vec<On> {
        let mut all: Vec<On> = self.heaters.iter().flatten().copied().collect();
        all.sort_unstable();
        all
    }

    /// Times and rates of the wheels, Hz.
    #[must_use]
    pub fn wheel_table(&self) -> (Vec<Tt2000>, Vec<&[f64]>) {
        (wheel_times(self.twin), self.wheels.iter().map(|w| w.rate_hz.as_slice()).collect())
    }

    /// The parts of the field at a sensor in a mode; housekeeping is in none.
    #[must_use]
    pub fn at(&self, time: Tt2000, sensor: usize, mode: Option<u8>) -> Parts {
        let t_s = seconds(self.begin, time);
        let three = |list: &[History; 3]| Vector3::from_fn(|i, _| list[i].at(t_s));
        let external_cel_nt = three(&self.external);
        let spacecraft = &self.twin.spacecraft;
        let [heat, wheel, line] = if sensor == 0 { [1.0; 3] } else { spacecraft.factors };
        let coupling = if sensor == 0 { Matrix3::identity() } else { spacecraft.coupling };
        let is_on = |list: &Vec<On>| {
            let next = list.partition_point(|on| on.from <= time);
            next.checked_sub(1).is_some_and(|i| time < list[i].to)
        };
        let on = self.heaters.iter().zip(&self.twin.heaters).filter(|(list, _)| is_on(list));
        let heaters: Vector3<f64> = on.map(|(_, heater)| Vector3::from(heater.field_nt)).sum();
        let place = t_s / self.twin.wheel_step_s;
        let row = place as usize;
        let wheels: Vector3<f64> = self.wheels.iter().map(|w| w.field.at(w.turns_at(row, place, self.twin.wheel_step_s))).sum();
        let lines: Vector3<f64> = mode.map_or_else(Vector3::zeros, |mode| {
            let mode = usize::from(mode);
            self.lines[mode].iter().zip(&self.twin.modes[mode].lines_hz).map(|(l, f)| l.at(f * t_s)).sum()
        });
        let jump = self.twin.sensors[sensor].jumps.iter().find(|jump| jump.span.holds(time));
        Parts {
            external_cel_nt,
            external_sc_nt: self.attitude(time).inverse() * external_cel_nt,
            heat_nt: heaters * heat,
            wheel_nt: wheels * wheel,
            lap_nt: lines * line,
            scn_nt: coupling * three(&self.noise),
            jump_nt: jump.map_or_else(Vector3::zeros, |jump| jump.subtract_nt),
        }
    }
}

impl Wheel {
    /// Turns until a place of the table: rates go in straight lines from row to row.
    fn turns_at(&self, row: usize, place: f64, step_s: f64) -> f64 {
        let row = row.min(self.rate_hz.len().saturating_sub(2));
        let over_s = (place - row as f64) * step_s;
        let slope = (self.rate_hz[row + 1] - self.rate_hz[row]) / step_s;
        self.turns[row] + (self.rate_hz[row] + 0.5 * slope * over_s) * over_s
    }
}

/// The times of the table of wheels.
fn wheel_times(twin: &TelemetryTwin) -> Vec<Tt2000> {
    let (begin, end) = (twin.span.from - MARGIN_NS, twin.span.to + MARGIN_NS);
    let count = (seconds(begin, end) / twin.wheel_step_s).ceil() as i64 + 1;
    let step = ns(twin.wheel_step_s);
    (0..count).map(|k| begin + k * step).collect()
}

/// A mean and sines whose powers follow the slope.
fn external(twin: &TelemetryTwin, axis: usize, count: usize, random: &mut Random) -> History {
    let stated = &twin.external;
    let [shortest, longest] = stated.periods_s;
    let ratio = (longest / shortest).powf(1.0 / f64::from(SINES - 1));
    let mut sines: Vec<(f64, f64, f64)> = (0..SINES)
        .map(|k| {
            // Between neighbours in equal ratios, moved at random so that no two are in phase again soon.
            let frequency = ratio.powf(f64::from(k) + 0.5 * random.uniform()) / longest;
            (frequency, frequency.powf(0.5 * (1.0 - stated.slope)), random.uniform())
        })
        .collect();
    let variance: f64 = sines.iter().map(|(_, a, _)| 0.5 * a * a).sum();
    let scale = stated.scatter_nt[axis] / variance.sqrt();
    sines.iter_mut().for_each(|(_, a, _)| *a *= scale);
    let value = |k: usize| {
        let t_s = k as f64 * STEP_S;
        let moving: f64 = sines.iter().map(|(f, a, phase)| a * (TAU * (f * t_s + phase)).sin()).sum();
        stated.mean_nt[axis] + moving
    };
    History { step_s: STEP_S, values: (0..count).map(value).collect() }
}

/// When a heater is on: at random within its intervals, off at both of their ends.
fn switched(twin: &TelemetryTwin, class: usize, seed: u64) -> Vec<On> {
    let heater = &twin.heaters[class];
    let mut random = Random::new(seed, &["heater", &heater.name]);
    let mut list = Vec::new();
    let mut lasts = |[low, high]: [f64; 2]| ns(low + (high - low) * random.uniform());
    for span in &twin.heater_intervals {
        let mut from = span.from + lasts(heater.off_s);
        loop {
            let to = from + lasts(heater.on_s);
            if to + ns(heater.off_s[0]) > span.to {
                break;
            }
            list.push(On { from, to, class });
            from = to + lasts(heater.off_s);
        }
    }
    list
}
