//! Runs of sines: a response of second order, sampled by a clock that is not quite that of the facility.

use super::effects::Effect;
use super::kinds::Column;
use super::noise::{Cell, Random};
use super::programme::Programme;
use super::sensor::{CleanRun, Curve, Sensor};
use calfit::data::run::Setting;
use calfit::data::units::FieldCoil;
use serde::Serialize;
use std::f64::consts::TAU;
use std::ops::Range;

/// Frequencies of the programme, Hz.
const SINES_HZ: [f64; 37] = [
    1000.0, 794.0, 631.0, 501.0, 398.0, 316.0, 251.0, 199.0, 158.0, 126.0, 100.0, 79.4, 63.1, 50.1, 39.8, 31.6, 25.1, 19.9, 15.8,
    12.6, 10.0, 7.9, 6.31, 5.01, 3.98, 3.16, 2.51, 1.99, 1.58, 1.26, 1.0, 0.79, 0.631, 0.501, 0.398, 0.316, 0.251,
];

/// From where poles are drawn: frequencies of one, frequencies and Q of two.
pub const ONE_POLE_HZ: [f64; 2] = [15.0, 250.0];
pub const TWO_POLES_HZ: [f64; 2] = [60.0, 160.0];
pub const TWO_POLES_Q: [f64; 2] = [0.5, 0.8];

/// What the sensor does to a sine, per component; worked out from the numbers of the sensor, which mean something else in other runs.
#[derive(Clone, Copy)]
struct Response {
    amplitude_ent: f64,
    f0_hz: f64,
    q: f64,
}

fn responses(clean: &CleanRun) -> [Response; 3] {
    std::array::from_fn(|i| Response {
        amplitude_ent: 577.0 + 1000.0 * (clean.sensor.sigma[i] - 1.0),
        f0_hz: 62.0 + 5.0 * (clean.sensor.xi_deg[i] - 90.0),
        q: 0.7 + 0.006 * clean.sensor.offset_ent[i],
    })
}

/// What is true about a run of sines, per component.
#[derive(Clone, Debug, Serialize)]
pub struct TrueSines {
    pub f_s_hz: f64,
    pub amplitude_ent: [f64; 3],
    /// Response of second order: `1 / (1 - (f/f0)² + i f / (f0 Q))`.
    pub f0_hz: [f64; 3],
    pub q: [f64; 3],
}

/// The truth of a run.
pub fn truth(clean: &CleanRun) -> TrueSines {
    let all = responses(clean);
    TrueSines {
        f_s_hz: clean.rate_hz,
        amplitude_ent: all.map(|r| r.amplitude_ent),
        f0_hz: all.map(|r| r.f0_hz),
        q: all.map(|r| r.q),
    }
}

/// Complex product.
pub fn multiply(a: [f64; 2], b: [f64; 2]) -> [f64; 2] {
    [a[0] * b[0] - a[1] * b[1], a[0] * b[1] + a[1] * b[0]]
}

fn inverse(a: [f64; 2]) -> [f64; 2] {
    let square = a[0] * a[0] + a[1] * a[1];
    [a[0] / square, -a[1] / square]
}

/// Response of one pole.
pub fn one_pole(hz: f64, corner_hz: f64) -> [f64; 2] {
    inverse([1.0, hz / corner_hz])
}

/// Response of two poles.
pub fn second_order(hz: f64, f0_hz: f64, q: f64) -> [f64; 2] {
    let x = hz / f0_hz;
    inverse([1.0 - x * x, x / q])
}

/// Readings of one component without offset over one setting; `gain` is a further response, `moved` the time added to a sample, s.
fn sine(
    setting: &Setting,
    samples: Range<usize>,
    rate_hz: f64,
    response: Response,
    gain: [f64; 2],
    moved: &dyn Fn(usize) -> f64,
) -> Vec<f64> {
    let h = multiply(second_order(setting.frequency_hz, response.f0_hz, response.q), gain);
    samples
        .map(|n| {
            let phase = TAU * setting.frequency_hz * (n as f64 / rate_hz + moved(n) - setting.t_start_s);
            response.amplitude_ent * (h[0] * phase.sin() + h[1] * phase.cos())
        })
        .collect()
}

/// The run without noise.
pub fn clean_run(sensor: Sensor, random: &mut Random) -> CleanRun {
    let rate_hz = 128.0 - 0.001 * random.between(0.3, 1.5);
    let mut clean = CleanRun {
        programme: Programme::Staircases,
        kind: super::sensor::Kind::Frequency,
        rate_hz,
        count: 0,
        settings: Vec::new(),
        plateaus: Vec::new(),
        field_nt: Vec::new(),
        sensor,
        towards: super::sensor::nominal(1),
        trend_ent: [[0.0; 2]; 3],
        sensor_degc: Curve { step_s: 10.0, values: Vec::new() },
        second_degc: None,
        coil_degc: Curve { step_s: 10.0, values: Vec::new() },
        rack_degc: Curve { step_s: 10.0, values: Vec::new() },
        variation_nt: None,
        supply_ma: None,
        position: 1,
        pure_ent: Vec::new(),
    };
    // The corner of a sensor must be one: draws far out are brought back.
    for i in 0..3 {
        clean.sensor.xi_deg[i] = clean.sensor.xi_deg[i].clamp(89.2, 90.8);
        clean.sensor.offset_ent[i] = clean.sensor.offset_ent[i].clamp(-12.0, 12.0);
    }
    let mut t_s = 2.0;
    for hz in SINES_HZ {
        let length_s = f64::max(12.0, (5.0 / hz * 1e3).round() / 1e3);
        let (t_end_s, field) = (t_s + length_s, FieldCoil([0.0, 1000.0, 0.0]));
        clean.settings.push(Setting { t_start_s: t_s, t_end_s, field, frequency_hz: hz, position: 1 });
        clean.plateaus.push((t_s * rate_hz).ceil() as usize..(t_end_s * rate_hz).floor() as usize);
        t_s = t_end_s + 0.5;
    }
    clean.count = ((t_s + 0.5) * rate_hz) as usize;
    clean.field_nt = vec![[0.0; 3]; clean.count];
    let length_s = clean.count as f64 / rate_hz;
    let (degc, phase) = ([-70.0, 17.0, 60.0][random.below(3)], random.between(0.0, TAU));
    let wave = |middle: f64, size: f64, period_s: f64| {
        Curve::of(10.0, length_s, move |t| middle + size * (TAU * t / period_s + phase).sin())
    };
    (clean.sensor_degc, clean.coil_degc, clean.rack_degc) =
        (wave(degc, 0.03, 900.0), wave(16.4, 0.02, 700.0), wave(32.0, 1.5, 180.0));
    clean.pure_ent = samples(&clean, |_, _, _| [1.0, 0.0], |_, _| 0.0);
    clean
}

/// Readings of all components, with a further response per component and frequency, and times moved.
fn samples(
    clean: &CleanRun,
    gain: impl Fn(&CleanRun, usize, f64) -> [f64; 2],
    moved: impl Fn(&CleanRun, usize) -> f64,
) -> Vec<[f64; 3]> {
    let mut record = vec![[0.0; 3]; clean.count];
    for (i, response) in responses(clean).into_iter().enumerate() {
        for (setting, plateau) in clean.settings.iter().zip(&clean.plateaus) {
            let gain = gain(clean, i, setting.frequency_hz);
            let values = sine(setting, plateau.clone(), clean.rate_hz, response, gain, &|n| moved(clean, n));
            record[plateau.clone()].iter_mut().zip(values).for_each(|(r, v)| r[i] = v);
        }
    }
    record
}

fn difference(clean: &CleanRun, changed: Vec<[f64; 3]>) -> Vec<[f64; 3]> {
    changed.into_iter().zip(&clean.pure_ent).map(|(a, b)| std::array::from_fn(|i| a[i] - b[i])).collect()
}

/// Per component amplitude, corner, quality, offset and sample rate; one delay of all readings, which nobody knows to a microsecond.
pub fn nuisance(clean: &CleanRun, cells: &[Cell]) -> Vec<Column> {
    let mut columns = Vec::new();
    for i in 0..3 {
        let mut push = |change: &dyn Fn(&mut Response), rate: f64| {
            let mut response = responses(clean)[i];
            change(&mut response);
            let mut record = vec![0.0; clean.count];
            for (setting, plateau) in clean.settings.iter().zip(&clean.plateaus) {
                let values = sine(setting, plateau.clone(), clean.rate_hz + rate, response, [1.0, 0.0], &|_| 0.0);
                record[plateau.clone()].copy_from_slice(&values);
            }
            let values = cells.iter().map(|c| 1e4 * (record[c.first] - clean.pure_ent[c.first][i])).collect();
            columns.push(vec![(i, values)]);
        };
        push(&|r| r.amplitude_ent *= 1.0 + 1e-5, 0.0);
        push(&|r| r.f0_hz *= 1.0 + 1e-5, 0.0);
        push(&|r| r.q *= 1.0 + 1e-5, 0.0);
        push(&|_| {}, 1e-9);
        columns.push(vec![(i, vec![1.0; cells.len()])]);
    }
    let late = samples(clean, |_, _, _| [1.0, 0.0], |_, _| 1e-9);
    let of = |i: usize| (i, cells.iter().map(|c| 1e4 * (late[c.first][i] - clean.pure_ent[c.first][i])).collect());
    columns.push((0..3).map(of).collect());
    columns
}

/// Where the search for the amplitude begins.
pub fn first_amplitude(name: &str) -> f64 {
    if name == "clock_drift" { 1e-9 } else { 1e-4 }
}

/// An effect on a run of sines.
pub fn drawn(name: &str, _scene: &CleanRun, random: &mut Random) -> Option<Effect> {
    let effect = match name {
        "eddy_current_attenuation" => {
            let hz = random.log_between(ONE_POLE_HZ[0], ONE_POLE_HZ[1]);
            let gain = move |f: f64, part: f64| {
                let pole = one_pole(f, hz);
                [1.0 + part * (pole[0] - 1.0), part * pole[1]]
            };
            Effect::of_sines("eddy_current_attenuation", "a pole in part of the field", move |clean, amplitude| {
                difference(clean, samples(clean, |_, _, f| gain(f, amplitude), |_, _| 0.0))
            })
        }
        "response_order" => {
            let (hz, q) = (random.between(TWO_POLES_HZ[0], TWO_POLES_HZ[1]), random.between(TWO_POLES_Q[0], TWO_POLES_Q[1]));
            Effect::of_sines("response_order", "two more poles, in part", move |clean, amplitude| {
                let gain = |_: &CleanRun, _: usize, f: f64| {
                    let more = second_order(f, hz, q);
                    [1.0 + amplitude * (more[0] - 1.0), amplitude * more[1]]
                };
                difference(clean, samples(clean, gain, |_, _| 0.0))
            })
        }
        "clock_drift" => {
            let (bend, turns) = (random.between(-0.3, 0.3), random.between(0.5, 1.0));
            Effect::of_sines("clock_drift", "sample rate moves with time, bent", move |clean, amplitude| {
                let length_s = clean.count as f64 / clean.rate_hz;
                let moved = |clean: &CleanRun, n: usize| {
                    let u = clean.along(n);
                    amplitude * length_s * (u * u + bend * (TAU * turns * u).sin())
                };
                difference(clean, samples(clean, |_, _, _| [1.0, 0.0], moved))
            })
        }
        "lost_samples" => {
            Effect::of_sines("lost_samples", "stretches that were not recorded", |clean, _| vec![[0.0; 3]; clean.count])
                .of_nature()
        }
        _ => return None,
    };
    Some(effect)
}

/// Stretches that are missing, if that is hidden in the run.
pub fn lost(effects: &[String], clean: &CleanRun, seed: u64) -> Vec<Range<usize>> {
    if !effects.iter().any(|name| name == "lost_samples") {
        return Vec::new();
    }
    let mut random = Random::new(seed, "lost samples");
    let mut stretches = Vec::new();
    for plateau in &clean.plateaus {
        if random.chance(0.3) {
            let first = plateau.start + random.below(plateau.len() - 80);
            stretches.push(first..first + 18 + random.below(50));
        }
    }
    if stretches.is_empty() {
        stretches.push(clean.plateaus[20].start + 300..clean.plateaus[20].start + 340);
    }
    stretches
}
