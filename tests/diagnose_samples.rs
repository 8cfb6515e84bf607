//! Diagnosis of runs with all their samples, simulated by the forward model of the tests: what moves inside a setting because the temperature
//! moves, and what the low-pass of the sensor makes of an edge, are no effects; what is hidden beside them is found.

use crate::common;

use common::check::{Case, calfit, says, text};
use common::{Gauss, Plan, RUN_ID, Run, Setting, in_positions, offset_fields, programme, sines};
use serde_json::Value;
use std::f64::consts::{PI, TAU};
use std::fs;

/// Diagnoses a run: `diagnosis.json`.
pub(crate) fn diagnosed(run: &Run) -> Value {
    let case = Case::of(run.text());
    let output = case.run("diagnose", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&fs::read(case.out().join(RUN_ID).join("diagnosis.json")).unwrap()).unwrap()
}

/// Effects that are named.
pub(crate) fn named(diagnosis: &Value) -> Vec<&str> {
    diagnosis["steps"].as_array().unwrap().iter().map(|s| s["effect"].as_str().unwrap()).collect()
}

pub(crate) fn parameter(step: &Value, name: &str) -> [f64; 2] {
    let all = step["parameters"].as_array().unwrap();
    let found = all.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name} in {all:?}"));
    ["value", "std"].map(|key| found[key].as_f64().unwrap())
}

const SWEEP_S: f64 = 12_000.0;

/// Sensor temperature of the sweep, °C: down from 20 to -30 and up again, at most 47 K/h.
fn degc(t_s: f64) -> f64 {
    20.0 - 50.0 * (PI * t_s.clamp(0.0, SWEEP_S) / SWEEP_S).sin().powi(2)
}

/// 300 settings of 40 s at 4 Hz in all directions, every fifth in nearly the same one; the sensor reads 1/50000 more for every kelvin of
/// the temperature some time ago, so that it moves by half a nanotesla inside a setting, beside white noise of 0.3 enT. Its low-pass takes
/// 3 ms, and the counter is slow by so much that samples pass the edges. On x is a tone.
fn sweep(lag_s: f64, tone_ent: f64) -> Run {
    let field = |i: usize| {
        let (turn, along) = (TAU * (0.2 + 0.001) * i as f64, (0.37 * i as f64).sin());
        [40_000.0 * turn.cos(), 40_000.0 * turn.sin(), 40_000.0 * along]
    };
    let settings: Vec<Setting> =
        (0..300).map(|i| Setting::constant(40.0 * i as f64, 40.0 * (i + 1) as f64, field(i), 1)).collect();
    let plan = Plan { settings, rate_hz: 4.0, rate_factor: 1.0 - 1e-5, noise_ent: 0.0, ..Plan::default() };
    let truth = plan.truth.clone();
    let mut run = plan.run().key("kind", "\"sweep\"").key("configuration", "\"RANDOM40000.MAG\"");
    let mut gauss = Gauss(7);
    for sample in &mut run.samples {
        let at = ((sample.t / 40.0) as usize).min(299);
        let passed = (-(sample.t - 40.0 * at as f64) / 0.003).exp();
        let level = |i: usize| truth.reading(run.settings[i].field);
        let (now, before) = (level(at), if at > 0 { level(at - 1) } else { [0.0; 3] });
        let gain = 1.0 + 2e-5 * (degc(sample.t - lag_s) - 20.0);
        sample.reading = std::array::from_fn(|i| gain * (now[i] + (before[i] - now[i]) * passed) + 0.3 * gauss.normal());
        sample.reading[0] += tone_ent * (TAU * 0.7 * sample.t).sin();
    }
    run.temperatures = (0..=600).map(|i| 20.0 * f64::from(i)).map(|t| (t, [Some(17.0), Some(degc(t))])).collect();
    run
}

#[test]
fn what_the_temperature_moves_inside_a_setting_is_no_signal() {
    assert_eq!(named(&diagnosed(&sweep(0.0, 0.0))), [""; 0]);
}

/// A tone of a frequency whose waves fit into the settings: neither their slopes nor their scatter may take a part of it.
#[test]
fn a_tone_is_found_in_a_sweep() {
    for amplitude_ent in [0.05, 0.5] {
        let found = diagnosed(&sweep(0.0, amplitude_ent));
        assert_eq!(named(&found), ["interference_tone"], "{amplitude_ent}");
        let step = &found["steps"][0];
        let [[hz, std_hz], [sin, std_sin], [cos, std_cos]] = ["frequency", "s_x", "c_x"].map(|name| parameter(step, name));
        // The times of samples follow the time tags with a memory of 1024 samples of 0.25 s: of a counter that is slow by a part in 100 000 they are 2.56 ms behind.
        let cos = cos - amplitude_ent * (TAU * 0.7 * 2.56e-3).sin();
        assert!((hz - 0.7).abs() < 4.0 * std_hz, "{hz} +- {std_hz}");
        assert!(
            (sin - amplitude_ent).abs() < 4.0 * std_sin && cos.abs() < 4.0 * std_cos,
            "{sin} +- {std_sin}, {cos} +- {std_cos}"
        );
        // 0.3 enT of noise in 48 000 samples over 12 000 s: in the middle each part is known to 0.3 √(2 / 48 000), the frequency to
        // 0.3 √24 / (2π · 12 000 s · amplitude √48 000), and the phase at the begin, by which the cosine differs, to twice that of the middle.
        let std = 0.3 * (2.0_f64 / 48_000.0).sqrt();
        let wanted_hz = 0.3 * 24.0_f64.sqrt() / (TAU * SWEEP_S * amplitude_ent * 48_000.0_f64.sqrt());
        for (found, wanted) in [(std_sin, std), (std_cos, 2.0 * std), (std_hz, wanted_hz)] {
            assert!((found / wanted - 1.0).abs() < 0.4, "{found} {wanted}");
        }
    }
}

#[test]
fn a_lag_is_no_signal_inside_the_settings() {
    let found = diagnosed(&sweep(900.0, 0.0));
    assert_eq!(named(&found), ["thermal_lag"]);
    let [lag_s, std_s] = parameter(&found["steps"][0], "lag");
    assert!((lag_s - 900.0).abs() < 4.0 * std_s && std_s < 20.0, "{lag_s} +- {std_s}");
}

/// A thermistor that reads more from one moment on makes of a sweep what a step of the sensitivity makes. Its own readings, which scatter by 0.01 K, tell
/// 0.2 K; they have room for 0.05 K; and where the sensitivity steps they have room for nothing of that size.
#[test]
fn a_small_jump_of_the_thermistor_is_no_step_of_the_sensitivity() {
    const JUMP_S: f64 = 4010.0;
    for (by_k, part) in [(0.2, 0.0), (0.05, 0.0), (0.0, 4e-6)] {
        let mut run = sweep(0.0, 0.0);
        let mut gauss = Gauss(21);
        for (t_s, values) in &mut run.temperatures {
            let jump_k = if *t_s > JUMP_S { by_k } else { 0.0 };
            values[1] = values[1].map(|degc| degc + jump_k + 0.01 * gauss.normal());
        }
        run.samples.iter_mut().filter(|s| s.t > JUMP_S).for_each(|s| s.reading = s.reading.map(|r| r * (1.0 + part)));
        let found = diagnosed(&run);
        let step = &found["steps"][0];
        let said = [&step["effect"], &step["wording"]].map(|word| word.as_str().unwrap_or_default());
        if by_k > 0.1 {
            assert_eq!(said, ["bad_thermistor", "is"], "{found}");
            let jump_k = step["parameters"][0]["value"].as_f64().unwrap();
            assert!((jump_k - by_k).abs() < 0.05 && named(&found).len() == 1, "{found}");
        } else if by_k > 0.0 {
            assert_eq!(said, ["sensitivity_step", "consistent with"], "{found}");
            assert!(step["ambiguous_with"].to_string().contains("bad_thermistor"), "{step}");
        } else {
            assert_eq!(said, ["sensitivity_step", "is"], "{found}");
        }
    }
}

/// A periodic signal with a signal to noise ratio of about 20 on x, half of it on y, in 33 settings of 4 s at 32 Hz.
fn periodic(signal: impl Fn(f64) -> f64) -> Run {
    let levels = [-9000.0, -7000.0, -5000.0, -3000.0, -1000.0, 1000.0, 3000.0, 5000.0, 7000.0, 9000.0];
    let plan = Plan { settings: programme(&levels, 4.0), rate_hz: 32.0, ..Plan::default() };
    let mut run = plan.run();
    let rms = (run.samples.iter().map(|s| signal(s.t).powi(2)).sum::<f64>() / run.samples.len() as f64).sqrt();
    let size = 20.0 * plan.noise_ent / (run.samples.len() as f64).sqrt() / rms;
    for sample in &mut run.samples {
        let now = size * signal(sample.t);
        sample.reading[0] += now;
        sample.reading[1] += 0.5 * now;
    }
    run
}

/// Harmonics above half the sample rate are folded: a tone above a quarter of it has none, a switched current shows them.
#[test]
fn tones_and_switched_currents_are_told_apart_at_every_frequency() {
    for hz in [2.3, 8.7, 13.7] {
        let found = diagnosed(&periodic(|t| (TAU * hz * t + 1.0).sin()));
        assert_eq!(named(&found), ["interference_tone"], "{hz} Hz");
        let [said_hz, std_hz] = parameter(&found["steps"][0], "frequency");
        assert!((said_hz - hz).abs() < 4.0 * std_hz, "{said_hz} +- {std_hz}");
    }
    for period_s in [0.15, 3.1] {
        let found = diagnosed(&periodic(|t| if (t / period_s + 0.2).fract() < 0.3 { 0.7 } else { -0.3 }));
        assert_eq!(named(&found), ["heater_pwm"], "{period_s} s");
        let [said_s, std_s] = parameter(&found["steps"][0], "period");
        assert!((said_s - period_s).abs() < 4.0 * std_s, "{said_s} +- {std_s}");
    }
}

/// A heater current on x in 1500 s of zero field: what has no settings is cut at no multiple of its period.
#[test]
fn a_heater_in_zero_field_has_its_period_and_its_size() {
    for (period_s, duty) in [(7.3, 0.25), (22.0, 0.5), (23.7, 0.4)] {
        let plan = Plan {
            settings: vec![Setting::constant(0.0, 1500.0, [0.0; 3], 1)],
            rate_hz: 16.0,
            noise_ent: 0.1,
            ..Plan::default()
        };
        let mut run = plan.run().key("kind", "\"zero-field\"").without_section("@FIELDS");
        for sample in &mut run.samples {
            sample.reading[0] += if (sample.t / period_s).fract() < duty { 0.2 } else { 0.0 };
        }
        let found = diagnosed(&run);
        assert_eq!(named(&found), ["heater_pwm"], "{period_s} s");
        let step = &found["steps"][0];
        for (name, truth) in [("period", period_s), ("a_x", 0.2)] {
            let [said, std] = parameter(step, name);
            // Of equal halves either is on.
            assert!((said.abs() - truth).abs() < 4.0 * std, "{period_s} s: {name} {said} +- {std}");
        }
    }
}

/// A heater current on x beside 150 plateaus of one length: what their means take of a current that is slower than they are comes again at their
/// rate, and is no signal of its own.
#[test]
fn a_heater_beside_plateaus_of_one_length_has_its_period_and_its_size() {
    let field = |i: usize| [0.7, 1.9, 3.1].map(|turn: f64| 2000.0 * (turn * (i * i) as f64).sin());
    for (plateau_s, pause_s, period_s, duty) in
        [(7.5, 0.0, 22.0, 0.5), (7.0, 0.5, 23.7, 0.4), (7.5, 0.0, 37.0, 0.3), (7.0, 0.5, 37.0, 0.3), (12.0, 3.0, 3.3, 0.3)]
    {
        let begin = |i: usize| 1.0 + (plateau_s + pause_s) * i as f64;
        let settings = (0..150).map(|i| Setting::constant(begin(i), begin(i) + plateau_s, field(i), 1)).collect();
        let mut run = Plan { settings, rate_hz: 16.0, noise_ent: 0.1, ..Plan::default() }.run();
        for sample in &mut run.samples {
            sample.reading[0] += if (sample.t / period_s).fract() < duty { 0.2 } else { 0.0 };
        }
        let found = diagnosed(&run);
        assert_eq!(named(&found), ["heater_pwm"], "{plateau_s} s, {period_s} s: {}", found["steps"]);
        let step = &found["steps"][0];
        for (name, truth) in [("period", period_s), ("a_x", 0.2)] {
            let [said, std] = parameter(step, name);
            assert!((said.abs() - truth).abs() < 4.0 * std, "{period_s} s: {name} {said} +- {std}");
        }
    }
}

/// The first sample after an edge is a third on its way; three samples are another matter.
#[test]
fn a_sample_on_the_edge_is_no_displacement() {
    let levels = [-9000.0, -7000.0, -5000.0, -3000.0, -1000.0, 1000.0, 3000.0, 5000.0, 7000.0, 9000.0];
    let plan = Plan { settings: programme(&levels, 4.0), rate_hz: 32.0, ..Plan::default() };
    let late = |samples: f64| {
        let mut run = plan.run();
        let (whole, part) = (samples.floor() as usize, samples.fract());
        let readings: Vec<[f64; 3]> = run.samples.iter().map(|s| s.reading).collect();
        for (k, sample) in run.samples.iter_mut().enumerate() {
            let [a, b] = [whole, whole + 1].map(|late| readings[k.saturating_sub(late)]);
            sample.reading = std::array::from_fn(|i| (1.0 - part) * a[i] + part * b[i]);
        }
        diagnosed(&run)
    };
    assert_eq!(named(&late(0.35)), [""; 0]);
    let found = late(3.25);
    assert_eq!(named(&found), ["time_shift"]);
    let [shift_s, std_s] = parameter(&found["steps"][0], "shift");
    assert!((shift_s - 3.25 / 32.0).abs() < 4.0 * std_s && std_s < 0.01, "{shift_s} +- {std_s}");
}

/// Levels on each axis in turn, settings of 4 s with pauses of 1 s between them.
fn with_pauses() -> Vec<Setting> {
    let levels = [-2000.0, -1400.0, -700.0, 700.0, 1400.0, 2000.0];
    let settings = programme(&levels, 4.0).into_iter().enumerate();
    settings.map(|(i, s)| Setting::constant(1.5 + 5.0 * i as f64, 5.5 + 5.0 * i as f64, s.field, 1)).collect()
}

/// Settings with pauses repeat a line of the spectrum at distances of one over five seconds; a tone that is hundreds of times as strong as the
/// noise stands out in all of them.
#[test]
fn a_strong_tone_has_its_own_frequency() {
    for hz in [3.3, 8.71, 13.13] {
        let plan = Plan { settings: with_pauses(), rate_hz: 32.0, ..Plan::default() };
        let mut run = plan.run();
        let size = 500.0 * plan.noise_ent * (2.0 / run.samples.len() as f64).sqrt();
        for sample in &mut run.samples {
            let now = size * (TAU * hz * sample.t + 1.0).sin();
            sample.reading[0] += now;
            sample.reading[1] += 0.5 * now;
        }
        let found = diagnosed(&run);
        assert_eq!(named(&found), ["interference_tone"], "{hz} Hz");
        let [said_hz, std_hz] = parameter(&found["steps"][0], "frequency");
        assert!((said_hz - hz).abs() < 4.0 * std_hz, "{hz}: {said_hz} +- {std_hz}");
    }
}

/// Settings that say another time than the data, by parts of the pauses between them and of either sign; no field in the pauses. An edge is
/// known to a sample, and all lie alike between two samples: a standard uncertainty of 1/√12 of 1/32 s.
#[test]
fn displaced_settings_are_named_with_sign_and_size() {
    let plan = Plan { settings: with_pauses(), rate_hz: 32.0, ..Plan::default() };
    for late_s in [-0.92, -0.8, -0.48, -0.2, 0.2, 0.48, 0.8, 0.92] {
        let found = diagnosed(&plan.run().shift_settings(-late_s));
        assert_eq!(named(&found), ["time_shift"], "{late_s}");
        assert_eq!(found["steps"][0]["wording"], "is", "{late_s}");
        let [shift_s, std_s] = parameter(&found["steps"][0], "shift");
        assert!((shift_s - late_s).abs() < 3.0 * std_s, "{late_s}: {shift_s} +- {std_s}");
        assert!((std_s * 32.0 * 12.0_f64.sqrt() - 1.0).abs() < 0.1, "{late_s}: {std_s}");
    }
}

/// Edges between two samples: of a displacement that is known to a third of a sample a part of every step is left beside the edge, again and
/// again with the settings, which is no signal.
#[test]
fn what_displaced_edges_leave_is_no_signal() {
    let plan = Plan { settings: with_pauses(), rate_hz: 32.0, ..Plan::default() };
    for late_s in [-0.47, 0.083] {
        let mut run = plan.run().shift_settings(-late_s);
        let readings: Vec<[f64; 3]> = run.samples.iter().map(|s| s.reading).collect();
        for (k, sample) in run.samples.iter_mut().enumerate().skip(1) {
            sample.reading = std::array::from_fn(|i| 0.4 * readings[k - 1][i] + 0.6 * readings[k][i]);
        }
        assert_eq!(named(&diagnosed(&run)), ["time_shift"], "{late_s}");
    }
}

/// What happens between the settings displaces none of them: here the coils go to the next field in the middle of every pause.
#[test]
fn a_field_that_changes_between_the_settings_is_no_displacement() {
    let plan = Plan { settings: with_pauses(), rate_hz: 32.0, ..Plan::default() };
    let mut run = plan.run();
    let mut gauss = Gauss(12);
    for sample in &mut run.samples {
        let next = plan.settings.iter().rposition(|s| s.t_start - 0.5 <= sample.t).unwrap_or(0);
        sample.reading = plan.truth.reading(plan.settings[next].field).map(|r| r + 0.05 * gauss.normal());
    }
    assert_eq!(named(&diagnosed(&run)), [""; 0]);
}

/// A run whose offsets follow the temperature by 0.02 enT/K, and a thermistor that is read every 2 s; where it says nothing there is no reading.
fn in_temperatures(degc: impl Fn(f64) -> f64, says_degc: impl Fn(f64) -> Option<f64>) -> Run {
    let levels = [-9000.0, -7000.0, -5000.0, -3000.0, -1000.0, 1000.0, 3000.0, 5000.0, 7000.0, 9000.0];
    let plan = Plan { settings: programme(&levels, 4.0), rate_hz: 16.0, ..Plan::default() };
    let mut run = plan.run();
    run.samples.iter_mut().for_each(|s| s.reading = s.reading.map(|r| r + 0.02 * degc(s.t)));
    let mut gauss = Gauss(3);
    let times = (0..=68).map(|i| 2.0 * f64::from(i));
    let read = times.filter_map(|t| Some((t, [Some(20.5), Some(says_degc(t)? + 0.02 * gauss.normal())])));
    run.temperatures = read.collect();
    run
}

/// Heated by 30 K from 50 s on.
fn heated(t_s: f64) -> f64 {
    20.0 + 30.0 * (1.0 - (-(t_s - 50.0).max(0.0) / 20.0).exp())
}

#[test]
fn a_gap_while_the_sensor_is_heated_is_no_fault_of_the_thermistor() {
    for gap_s in [[53.0, 79.0], [61.0, 91.0]] {
        let found = diagnosed(&in_temperatures(heated, |t| (t < gap_s[0] || t > gap_s[1]).then(|| heated(t))));
        assert!(named(&found).contains(&"sensor_temperature_offset"), "{found}");
        assert!(!named(&found).contains(&"bad_thermistor"), "{found}");
    }
}

/// A thermistor that repeats its last reading while the sensor is heated tells nothing then: neither a jump nor an effect is made of it.
#[test]
fn a_thermistor_that_sticks_while_the_sensor_is_heated_is_no_jump() {
    for stuck_s in [[55.0, 85.0], [62.0, 100.0]] {
        let last = |t: f64| if t > stuck_s[0] && t < stuck_s[1] { stuck_s[0] } else { t };
        let mut run = in_temperatures(heated, |t| Some(heated(last(t))));
        let at_begin = run.temperatures.iter().rfind(|(t, _)| *t <= stuck_s[0]).unwrap().1;
        run.temperatures
            .iter_mut()
            .filter(|(t, _)| *t > stuck_s[0] && *t < stuck_s[1])
            .for_each(|(_, values)| *values = at_begin);
        let found = diagnosed(&run);
        assert!(named(&found).contains(&"sensor_temperature_offset"), "{found}");
        assert!(!named(&found).contains(&"bad_thermistor"), "{found}");
        says(&found["warnings"].to_string(), &["T59", "stands still"]);
    }
}

/// What the channel shows is weighed against what the readings show: they confirm a jump, say nothing of it, or follow it.
#[test]
fn a_jump_of_a_thermistor_is_weighed_against_the_readings() {
    let jump_k = |t: f64| if t > 100.0 { 20.0 } else { 0.0 };
    for (degc, wording) in [(heated as fn(f64) -> f64, "is"), (|_| 20.0, "consistent with")] {
        let found = diagnosed(&in_temperatures(degc, |t| Some(degc(t) + jump_k(t))));
        let step = &found["steps"][0];
        assert_eq!((&step["effect"], &step["wording"]), (&"bad_thermistor".into(), &wording.into()), "{found}");
        let all = step["parameters"].as_array().unwrap();
        assert!(all.len() == 1 && (all[0]["value"].as_f64().unwrap() - 20.0).abs() < 0.5, "{all:?}");
        let [before, after] = ["gap_before", "gap_after"].map(|gap| step[gap]["chi2_per_dof"].as_f64().unwrap());
        assert!(if wording == "is" { after < 0.8 * before } else { after > 0.5 }, "{before} {after}");
    }
    let there_and_back = |t: f64| if (40.0..90.0).contains(&t) { 25.0 } else { 20.0 };
    let found = diagnosed(&in_temperatures(there_and_back, |t| Some(there_and_back(t))));
    assert_eq!(named(&found), ["sensor_temperature_offset"]);
    let notes = found["warnings"].to_string();
    says(&notes, &["temperature channel T59 changes by", "the readings follow it"]);
    assert!(!notes.contains("T59 jumps"), "{notes}");
}

/// A sine beside the notch of a boxcar, at 126 Hz: seen from above the notch a response has another minimum than from below.
#[test]
fn a_notch_is_found_from_either_side() {
    let frequencies_hz: Vec<f64> =
        (-10..=27).map(|k| 10.0_f64.powf(0.1 * f64::from(k))).map(|f| (100.0 * f).round() / 100.0).collect();
    let mut settings = sines(&frequencies_hz, 1000.0);
    settings.iter_mut().for_each(|s| s.field = [800.0, 900.0, 1000.0]);
    let plan = Plan { settings, noise_ent: 0.0, ..Plan::default() };
    let (notch_hz, f0_hz, q) = ([127.1, 122.6, 112.9], [81.5, 80.8, 74.9], 0.88);
    let (response, offset) = (plan.truth.response(), plan.truth.offset_ent);
    let mut run = plan.run().key("kind", "\"frequency\"").key("configuration", "\"FREQ1000.MAG\"");
    let mut gauss = Gauss(11);
    for sample in &mut run.samples {
        let on = run.settings.iter().find(|s| s.t_start <= sample.t && sample.t < s.t_end);
        sample.reading = std::array::from_fn(|i| {
            let sine = on.map_or(0.0, |setting| {
                let full: f64 = (0..3).map(|j| response[i][j] * setting.field[j]).sum();
                // A mean over 1/notch: sin(πx)/(πx), late by half of it; then two poles.
                let f = setting.frequency;
                let (u, x) = (PI * f / notch_hz[i], f / f0_hz[i]);
                let (real, imaginary) = (1.0 - x * x, x / q);
                let gain = u.sin() / u / real.hypot(imaginary);
                full * gain * ((TAU * f * sample.t) - u - imaginary.atan2(real)).sin()
            });
            offset[i] + sine + 0.3 * gauss.normal()
        });
    }
    let found = diagnosed(&run);
    assert_eq!(named(&found), [""; 0]);
    let response = found["response"].as_str().unwrap();
    says(response, &["boxcar x second order"]);
    let chi: f64 = response.split("chi²/dof ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    // About 200 values: one standard deviation is 0.1.
    assert!((chi - 1.0).abs() < 0.3, "{response}");
}

/// A run that turns the sensor has more than one response.
#[test]
fn a_run_in_several_positions_is_refused() {
    let plan = Plan { settings: in_positions(&[1, 2], &offset_fields(), 4.0), ..Plan::default() };
    let case = Case::of(plan.run().key("kind", "\"offset\"").text());
    let output = calfit().arg("diagnose").arg(case.file()).arg("-o").arg(case.out()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["positions 1, 2", "a diagnosis needs one position"]);
    assert!(!case.out().join(RUN_ID).exists());
}

/// What decays within a sample interval is the sensor's own low-pass, however many samples a large step shows it in. The low-pass takes 3 ms at
/// 128 Hz; beside the sensor a part of every step comes 0.8 s later.
#[test]
fn the_low_pass_of_a_sensor_is_no_transient_and_hides_none() {
    let levels = [-2000.0, 1500.0, -1000.0, 500.0, 2000.0, -500.0, 1000.0, -1500.0, 250.0, -250.0];
    let plan = Plan { settings: programme(&levels, 6.0), rate_hz: 128.0, noise_ent: 0.3, ..Plan::default() };
    let diagnosis = |part: f64| diagnosed(&plan.run().behind(&plan.truth, &[(1.0, 0.003), (part, 0.8)]));
    assert_eq!(named(&diagnosis(0.0)), [""; 0]);
    let found = diagnosis(3e-4);
    assert_eq!(named(&found), ["settling"]);
    let step = &found["steps"][0];
    for (name, wanted) in [("fraction", 3e-4), ("tau", 0.8)] {
        let [value, std] = parameter(step, name);
        assert!((value - wanted).abs() < 4.0 * std && std < 0.2 * wanted, "{name}: {value} +- {std}");
    }
}

/// Fields in all directions up to 2000 nT, settings of 6 s with pauses of 1 s, in the middle of which the coils go on to the next field.
pub(crate) fn in_all_directions(count: usize) -> Vec<Setting> {
    let mut gauss = Gauss(41);
    let field = |i: usize, gauss: &mut Gauss| {
        if i.is_multiple_of(12) { [0.0; 3] } else { std::array::from_fn(|_| 2000.0 * gauss.uniform()) }
    };
    let at = |i: usize| 1.0 + 7.0 * i as f64;
    (0..count).map(|i| Setting::constant(at(i), at(i) + 6.0, field(i, &mut gauss), 1)).collect()
}

/// A run of such settings in noise of 0.3 enT, with the field at a time as the coils make it and what the table of settings says.
fn as_made(settings: &[Setting], said: Vec<Setting>, field: impl Fn(usize, f64) -> [f64; 3]) -> Run {
    // The record goes on for a while.
    let end = settings[settings.len() - 1].t_end;
    let all = [settings, &[Setting::constant(end, end + 3.0, [0.0; 3], 1)]].concat();
    let plan = Plan { settings: all, rate_hz: 32.0, noise_ent: 0.0, ..Plan::default() };
    let mut run = plan.run();
    let mut gauss = Gauss(43);
    for sample in &mut run.samples {
        let now = settings.iter().rposition(|s| s.t_start - 0.5 <= sample.t).unwrap_or(0);
        sample.reading = plan.truth.reading(field(now, sample.t)).map(|r| r + 0.3 * gauss.normal());
    }
    run.settings = said;
    run
}

fn wordings<'a>(diagnosis: &'a Value, effect: &str) -> Vec<&'a str> {
    let steps = diagnosis["steps"].as_array().unwrap().iter();
    steps.filter(|s| s["effect"] == effect).map(|s| s["wording"].as_str().unwrap()).collect()
}

/// The field rings after every step, with 0.3 Hz and a time constant of 3 s: what is left of that in the means is no certain memory of the sensor.
#[test]
fn a_field_that_rings_is_no_certain_memory() {
    let settings = in_all_directions(120);
    let run = as_made(&settings, settings.clone(), |now, t| {
        let since = |i: usize| t - (settings[i].t_start - 0.5);
        let rings = |i: usize| 1e-3 * (-since(i) / 3.0).exp() * (TAU * 0.3 * since(i)).cos();
        let mut field = settings[now].field;
        for i in [now, now.saturating_sub(1)].into_iter().filter(|i| *i > 0 && since(*i) < 8.0) {
            (0..3).for_each(|a| field[a] += rings(i) * (settings[i].field[a] - settings[i - 1].field[a]));
        }
        field
    });
    let found = diagnosed(&run);
    says(&found["warnings"].to_string(), &["the readings still follow the step before a setting"]);
    assert!(wordings(&found, "remanence").iter().all(|said| *said == "consistent with"), "{}", found["steps"]);
    for step in found["steps"].as_array().unwrap().iter().filter(|s| s["effect"] == "remanence") {
        assert!(step["ambiguous_with"].to_string().contains("settling"), "{step}");
    }
}

/// The second half of the table says times that are late by 1.5 s, of which the settings show a second: half of the edges stand elsewhere than the others,
/// and no one displacement is certain.
#[test]
fn half_of_a_table_that_is_late_is_no_displacement_of_all() {
    let settings = in_all_directions(84);
    let late = |(i, s): (usize, &Setting)| {
        let by_s = if i < 42 { 0.0 } else { 1.5 };
        Setting { t_start: s.t_start + by_s, t_end: s.t_end + by_s, ..*s }
    };
    let said = settings.iter().enumerate().map(late).collect();
    let found = diagnosed(&as_made(&settings, said, |now, _| settings[now].field));
    assert_ne!(found["verdict_kind"], "none", "{}", found["verdict"]);
    assert!(!found["left"].is_null(), "{}", found["verdict"]);
    assert!(wordings(&found, "time_shift").iter().all(|said| *said == "consistent with"), "{}", found["steps"]);
    says(&found["warnings"].to_string(), &["edges that are to be seen stand 1.00 s"]);
}

/// Every fourth setting comes 61 samples late: their means hold, and it is told all the same.
#[test]
fn some_settings_that_come_late_are_told() {
    let settings = in_all_directions(90);
    let is_late = |i: usize| i % 4 == 1;
    let found = diagnosed(&as_made(&settings, settings.clone(), |now, t| {
        let shows_before = is_late(now) && t < settings[now].t_start + 61.0 / 32.0 - 1e-6;
        settings[if shows_before { now - 1 } else { now }].field
    }));
    assert_ne!(found["verdict_kind"], "none", "{}", found["verdict"]);
    assert!(!found["left"].is_null(), "{}", found["verdict"]);
    // 61 samples at 32 Hz; the settings with numbers 1 and 5 are the first of them.
    let words = "edges that are to be seen stand 1.91 s later than the others, the begins of the settings that begin at 8, 36";
    says(&found["warnings"].to_string(), &[words]);
}

/// A converter that hangs for 160 s of zero field: the verdict says so, and nothing is certain on its axis.
#[test]
fn a_component_that_stands_still_is_no_clean_run() {
    let plan =
        Plan { settings: vec![Setting::constant(0.0, 1500.0, [0.0; 3], 1)], rate_hz: 16.0, noise_ent: 0.1, ..Plan::default() };
    // Beside its mean by half of the standard deviation of a row, and by that of two samples.
    for beside_ent in [0.005, 0.2] {
        let mut run = plan.run().key("kind", "\"zero-field\"").without_section("@FIELDS");
        let held = plan.truth.offset_ent[0] + beside_ent;
        run.samples.iter_mut().filter(|s| s.t > 400.0 && s.t < 560.0).for_each(|s| s.reading[0] = held);
        let found = diagnosed(&run);
        assert_ne!(found["verdict_kind"], "none", "{}", found["verdict"]);
        says(&found["warnings"].to_string(), &["component x is stuck from 400.0 to 560.0 s"]);
        assert!(!found["left"].is_null(), "{}", found["verdict"]);
        let mut on_x = found["steps"].as_array().unwrap().iter().filter(|s| s["axes"].to_string().contains('x'));
        assert!(on_x.all(|s| s["wording"] == "consistent with"), "{}", found["steps"]);
    }
}

/// The first three samples of every setting are at the end of the range: what is made of them is no certain drift, and no certain signal.
#[test]
fn saturated_begins_of_settings_make_no_certain_drift() {
    const END_ENT: f64 = 2200.0;
    let levels = [-2000.0, -1400.0, -700.0, 700.0, 1400.0, 2000.0, -1700.0, 300.0, -300.0, 1100.0];
    let settings: Vec<Setting> = programme(&levels, 6.0)
        .into_iter()
        .enumerate()
        .map(|(i, s)| Setting::constant(1.0 + 7.0 * i as f64, 7.0 + 7.0 * i as f64, s.field, 1))
        .collect();
    let mut run = as_made(&settings, settings.clone(), |now, _| settings[now].field);
    for i in 0..settings.len() {
        let first = run.samples_of(i).start;
        run.samples[first..first + 3].iter_mut().for_each(|s| s.reading = s.reading.map(|r| END_ENT.copysign(r)));
    }
    let found = diagnosed(&run);
    let warnings = found["warnings"].to_string();
    for name in ["x", "y", "z"] {
        says(&warnings, &[&format!("component {name} rests at 2200.0 enT")]);
    }
    let is_certain =
        |s: &&Value| s["wording"] == "is" && !["saturation", "cubic_nonlinearity"].contains(&s["effect"].as_str().unwrap());
    assert_eq!(found["steps"].as_array().unwrap().iter().find(is_certain), None);
}

/// A tone within a percent of half of the sample rate, which is no line, and one whose size follows the field: the verdict says in which band they are.
#[test]
fn what_is_no_line_is_told_with_its_band() {
    let plan =
        Plan { settings: vec![Setting::constant(0.0, 1500.0, [0.0; 3], 1)], rate_hz: 16.0, noise_ent: 0.1, ..Plan::default() };
    let mut run = plan.run().key("kind", "\"zero-field\"").without_section("@FIELDS");
    run.samples.iter_mut().for_each(|s| s.reading[0] += 0.05 * (TAU * 7.95 * s.t + 0.3).sin());
    let found = diagnosed(&run);
    assert_eq!((&found["verdict_kind"], named(&found).len()), (&"undecided".into(), 0), "{}", found["verdict"]);
    says(found["left"]["where"].as_str().unwrap(), &["x, 7.", "to 8.00 Hz"]);
    // In parts of 64 samples the last line has most of the tone, 0.05²/2 enT², and the noise of half of a line, 0.1²/64 enT²; with the line before it the
    // noise is three times as large.
    let times = found["left"]["times_noise"].as_f64().unwrap();
    assert!((1.8..3.1).contains(&times), "{times}");

    let settings = in_all_directions(120);
    let found = diagnosed(&as_made(&settings, settings.clone(), |now, t| {
        settings[now].field.map(|b| b * (1.0 + 3e-4 * (TAU * 3.3 * t).sin()))
    }));
    assert_ne!(found["verdict_kind"], "none", "{}", found["verdict"]);
    assert!(!found["left"].is_null(), "{}", found["verdict"]);
}
