//! Frequency runs: amplitudes, phases, -3 dB frequencies and sampling frequency, with their smallest standard deviations.

use super::{CLEAR, Estimate, Noise, drawn, response, simulated};
use calfit::files::mag::Step;
use calfit::files::twin::Twin;
use calfit::fit::NORMAL_95;
use calfit::measure::freq::{self, Sines};
use calfit::simulate::noise::Random;
use nalgebra::{DMatrix, DVector, Vector3};
use std::f64::consts::TAU;

/// Variance of the white noise that would be as dense as the noise at a frequency or its alias: the spectrum of sampled relaxations.
fn local_variance(twin: &Twin, noise: Noise, f: f64) -> f64 {
    let sensor = &twin.sensors[0];
    let slow = noise.relaxations(sensor.rate_hz, sensor.flicker_lowest_hz).into_iter().map(|(variance, tau_s)| {
        let decay = (-1.0 / (tau_s * sensor.rate_hz)).exp();
        variance * (1.0 - decay * decay) / (1.0 - 2.0 * decay * (TAU * f / sensor.rate_hz).cos() + decay * decay)
    });
    noise.white_ent.powi(2) + slow.sum::<f64>()
}

/// Truth and smallest standard deviation of the -3 dB frequency of a component, from all sines of the programme; a response with its
/// amplitudes at frequencies of the sines, and the smallest variance of each amplitude.
pub(super) struct Tones {
    pub corner: (f64, f64),
    /// Frequency, amplitude, its smallest variance, samples.
    pub amplitudes: Vec<(f64, f64, f64, f64)>,
}

impl Tones {
    pub fn of(twin: &Twin, noise: Noise, degc: f64, i: usize, samples: impl Fn(&Step) -> Option<f64>) -> Self {
        let sensor = &twin.sensors[0];
        let (shape, shapes) = (sensor.model.response, sensor.model.response_at(degc).unwrap());
        let full = full_ent(twin, degc, i).abs();
        let mut fisher = DMatrix::zeros(1 + shapes[i].len(), 1 + shapes[i].len());
        let mut amplitudes = Vec::new();
        for step in &twin.programmes[2].steps {
            let (Some(n), f) = (samples(step), step.frequency_hz) else { continue };
            let variance = 2.0 * local_variance(twin, noise, f) / n;
            let (value, slopes) = shape.value_and_slopes(f, &shapes[i]);
            let row = DVector::from_fn(fisher.nrows(), |k, _| full * if k == 0 { value } else { slopes[k - 1] });
            fisher += &row * row.transpose() / variance;
            amplitudes.push((f, full * value, variance, n));
        }
        let corner = shape.corner_hz(&shapes[i]).unwrap();
        let slopes = shape.corner_slopes(corner, &shapes[i]);
        let row = DVector::from_fn(fisher.nrows(), |k, _| if k == 0 { 0.0 } else { slopes[k - 1] * corner });
        let bound = (row.transpose() * fisher.try_inverse().unwrap() * row)[0].sqrt();
        Self { corner: (corner, bound), amplitudes }
    }
}

/// Amplitude of a component at low frequencies, enT, with its sign.
fn full_ent(twin: &Twin, degc: f64, i: usize) -> f64 {
    (response(twin, 5, degc) * Vector3::new(0.0, 1000.0, 0.0))[i]
}

pub(super) fn of_freq(base: &Twin, noise: Noise, seed: u64) -> Vec<Estimate> {
    let twin = drawn(base, noise, 2, &mut Random::new(seed, &["freq"]));
    let degc = twin.thermal_box.start_degc;
    let result = simulated(&twin, seed, |run| {
        let mut sines = Sines::default();
        let run = noise.play(run, twin.sensors[0].flicker_lowest_hz, seed, &mut sines);
        freq::freq(&run, &sines, &twin.campaign.instructions, &freq::Options::default()).unwrap()
    });
    let p = &result;
    let sensor = &twin.sensors[0];
    let (shape, shapes) = (sensor.model.response, sensor.model.response_at(degc).unwrap());
    let mut estimates = Vec::new();
    let mut information = [0.0; 3];
    let components = ["x", "y", "z"];
    for (i, component) in components.into_iter().enumerate() {
        let used = |f: f64| p.amplitude.iter().find(|a| a.frequency_hz == f);
        let tones = Tones::of(&twin, noise, degc, i, |step| Some(used(step.frequency_hz)?.samples? as f64));
        for (f, truth, variance, n) in &tones.amplitudes {
            let Some(a) = used(*f) else { continue };
            // The phase of a stretch has the variance of the amplitude over its square; its slope is that of a straight line.
            information[i] += truth * truth / variance * (TAU * f / sensor.rate_hz.powi(2)).powi(2) * (n * n - 1.0) / 12.0;
            estimates.push(Estimate {
                name: format!("amplitude at {f:07.3} Hz"),
                value: a.b_ent[i],
                std: a.b_std_ent[i],
                factor_95: NORMAL_95,
                truth: *truth,
                bound: variance.sqrt(),
            });
            // Phases of amplitudes near the noise have no normal distribution.
            let clear = *truth > CLEAR * variance.sqrt();
            if let (true, Some(phase_deg), Some(std_deg), Some(counter)) = (clear, a.phase_deg, a.phase_std_deg, a.phase_counter)
            {
                let sign: f64 = if full_ent(&twin, degc, i) < 0.0 { 180.0 } else { 0.0 };
                let t_s = (counter as f64 + 0.5) / sensor.rate_hz - start_of(&twin, *f);
                let wanted = 360.0 * (f * t_s).fract() + shape.phase_rad(*f, &shapes[i]).to_degrees() + sign;
                let turns = ((phase_deg[i] - wanted) / 360.0).round();
                estimates.push(Estimate {
                    name: format!("phase at {f:07.3} Hz"),
                    value: phase_deg[i] - 360.0 * turns,
                    std: std_deg[i],
                    factor_95: NORMAL_95,
                    truth: wanted,
                    bound: (variance.sqrt() / truth).to_degrees(),
                });
            }
        }
        estimates.push(Estimate {
            name: format!("f_3db_{component}"),
            value: p.values.f_3db_model_hz[i],
            std: p.values.f_3db_model_std_hz[i],
            factor_95: NORMAL_95,
            truth: tones.corner.0,
            bound: tones.corner.1,
        });
    }
    let (f_s_hz, f_s_std_hz) = (p.values.f_s_hz.unwrap(), p.values.f_s_std_hz.unwrap());
    for i in 0..3 {
        estimates.push(Estimate {
            name: format!("f_s_{}", components[i]),
            value: f_s_hz[i],
            std: f_s_std_hz[i],
            factor_95: NORMAL_95,
            truth: sensor.rate_hz,
            bound: information[i].powf(-0.5),
        });
    }
    estimates.push(Estimate {
        name: "f_s mean".to_owned(),
        value: p.values.mean_f_s_hz.unwrap(),
        std: p.values.mean_f_s_std_hz.unwrap(),
        factor_95: NORMAL_95,
        truth: sensor.rate_hz,
        bound: information.iter().sum::<f64>().powf(-0.5),
    });
    estimates
}

/// Begin of the setting with a frequency, s.
fn start_of(twin: &Twin, f: f64) -> f64 {
    twin.programmes[2].steps.iter().take_while(|s| s.frequency_hz != f).map(|s| s.duration_s).sum()
}
