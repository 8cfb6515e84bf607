//! Signals in the samples that are hundreds of times as strong as the noise of a sample, or stand beside each other: their sizes and shapes are off by what
//! their uncertainties say, which are a ten thousandth of them.

use crate::common::{Gauss, Plan, Run, Setting};
use crate::diagnose_samples::{diagnosed, in_all_directions, named, parameter};
use serde_json::Value;
use std::f64::consts::TAU;

/// The fields of settings in all directions without pauses.
fn all_at_once() -> Vec<Setting> {
    let fields = in_all_directions(90).into_iter().enumerate();
    fields.map(|(i, s)| Setting::constant(6.0 * i as f64, 6.0 * (i + 1) as f64, s.field, 1)).collect()
}

/// Settings at 32 Hz with noise of 0.3 enT, and a signal on the components.
fn with(seed: u64, settings: Vec<Setting>, signal: impl Fn(f64) -> [f64; 3]) -> Run {
    let plan = Plan { settings, rate_hz: 32.0, noise_ent: 0.0, ..Plan::default() };
    let mut run = plan.run();
    let mut gauss = Gauss(seed);
    for sample in &mut run.samples {
        let now = signal(sample.t);
        sample.reading = std::array::from_fn(|a| sample.reading[a] + now[a] + 0.3 * gauss.normal());
    }
    run
}

/// Values minus truths over standard uncertainties.
fn off(step: &Value, truths: &[(&str, f64)]) -> Vec<f64> {
    let of = |(name, truth): &(&str, f64)| {
        let [value, std] = parameter(step, name);
        (value - truth) / std
    };
    truths.iter().map(of).collect()
}

/// No one is off by more than four, and their mean square is one within three of its standard deviations where all are independent.
fn are_normal(name: &str, all: &[f64]) {
    let square = all.iter().map(|z| z * z).sum::<f64>() / all.len() as f64;
    let most = 1.0 + 3.0 * (2.0 / all.len() as f64).sqrt();
    assert!(all.iter().all(|z| z.abs() < 4.0) && square < most, "{name}: {square} {all:.1?}");
}

const PARTS: [f64; 3] = [1.0, 0.6, -0.3];

fn tone(hz: f64, size: f64, phase: f64) -> impl Fn(f64) -> [f64; 3] {
    move |t| PARTS.map(|part| size * part * (TAU * hz * t + phase).sin())
}

/// What a tone is to have as parameters.
fn of_tone(hz: f64, size: f64, phase: f64) -> Vec<(&'static str, f64)> {
    let (sin, cos) = phase.sin_cos();
    let sizes = [("s_x", cos, 0), ("c_x", sin, 0), ("s_y", cos, 1), ("c_y", sin, 1), ("s_z", cos, 2), ("c_z", sin, 2)];
    let sizes = sizes.into_iter().map(|(name, part, axis)| (name, size * PARTS[axis] * part));
    std::iter::once(("frequency", hz)).chain(sizes).collect()
}

#[test]
fn a_tone_of_a_hundred_times_the_noise() {
    let mut all = Vec::new();
    for (seed, hz) in (1..).zip([0.83, 3.217, 7.0911, 11.37, 13.9]) {
        let phase = 0.7 * seed as f64;
        let found = diagnosed(&with(seed, in_all_directions(90), tone(hz, 30.0, phase)));
        assert_eq!(named(&found), ["interference_tone"], "{hz} Hz");
        all.extend(off(&found["steps"][0], &of_tone(hz, 30.0, phase)));
    }
    are_normal("tone", &all);
}

/// Plateaus come every seven seconds: a seventh of a hertz beside a tone the other one repeats it.
#[test]
fn two_tones_beside_each_other() {
    let mut all = Vec::new();
    for (seed, beside_hz) in (1..).zip([0.02, 0.06, 1.0 / 7.0, 0.29]) {
        let tones = [(3.21, 1.2, 0.4 * seed as f64), (3.21 + beside_hz, 1.0, 2.0)];
        let [one, other] = tones.map(|(hz, size, phase)| tone(hz, size, phase));
        let found = diagnosed(&with(seed, in_all_directions(90), |t| std::array::from_fn(|a| one(t)[a] + other(t)[a])));
        assert_eq!(named(&found), ["interference_tone"; 2], "{beside_hz} Hz");
        for step in found["steps"].as_array().unwrap() {
            let [said_hz, _] = parameter(step, "frequency");
            let nearest = tones.into_iter().min_by(|a, b| (a.0 - said_hz).abs().total_cmp(&(b.0 - said_hz).abs()));
            let (hz, size, phase) = nearest.unwrap();
            all.extend(off(step, &of_tone(hz, size, phase)));
        }
    }
    are_normal("two tones", &all);
}

/// Of 180 edges not one stands on the wrong side of a sample that matters: nothing else is named for what is left.
#[test]
fn a_heater_of_a_hundred_times_the_noise() {
    for (seed, period_s, duty) in [(1, 3.823, 0.307), (2, 5.6847, 0.441), (3, 4.4056, 0.2092)] {
        let is_on = |t: f64| if ((t - 1.3) / period_s).rem_euclid(1.0) < duty { 1.0 } else { 0.0 };
        let found = diagnosed(&with(seed, in_all_directions(90), |t| PARTS.map(|part| 30.0 * part * is_on(t))));
        assert_eq!(named(&found), ["heater_pwm"], "{period_s} s");
        let step = &found["steps"][0];
        are_normal("heater", &off(step, &[("period", period_s), ("a_x", 30.0), ("a_y", 18.0), ("a_z", -9.0)]));
        // In the samples it is known to a thousandth, whatever the uncertainty says.
        let [size, _] = parameter(step, "a_x");
        assert!((size / 30.0 - 1.0).abs() < 1e-3, "{size}");
    }
}

/// A fiftieth of every step comes later, by a time constant that is no step of a search. One setting follows the other.
#[test]
fn a_transient_of_a_hundred_times_the_noise() {
    let mut all = Vec::new();
    for (seed, tau_s) in (1..).zip([0.3711, 0.5618, 0.8576, 1.0207]) {
        let found = diagnosed(&with(seed, all_at_once(), |_| [0.0; 3]).behind(&Plan::default().truth, &[(0.02, tau_s)]));
        assert_eq!(named(&found), ["settling"], "{tau_s} s");
        all.extend(off(&found["steps"][0], &[("fraction", 0.02), ("tau", tau_s)]));
    }
    are_normal("transient", &all);
}

/// The period of a heater comes again in settings that follow each other every seven seconds, and half of the samples stand so far off their plateaus that they
/// are left out of the means as spikes: what is left of the heater in them is no drift, and it is told.
#[test]
fn a_heater_that_passes_for_spikes_makes_nothing_certain() {
    let is_on = |t: f64| if (t / 6.69).fract() < 0.4253 { 1.0 } else { 0.0 };
    let found = diagnosed(&with(1, in_all_directions(90), |t| PARTS.map(|part| 30.0 * part * is_on(t))));
    let steps = found["steps"].as_array().unwrap();
    assert!(named(&found).contains(&"heater_pwm"), "{found}");
    let certain: Vec<&str> = steps.iter().filter(|s| s["wording"] == "is").map(|s| s["family"].as_str().unwrap()).collect();
    assert!(certain.iter().all(|family| *family == "timing and periodic"), "{certain:?}");
    assert!(found["warnings"].to_string().contains("were left out of the means as spikes, and heater_pwm is there"), "{found}");
}
