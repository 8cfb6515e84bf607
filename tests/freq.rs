//! `calfit freq`: sampling frequency, amplitudes and -3 dB corners come back, from waveforms and from tables.

use crate::common;

use common::check::{Case, calfit, number, parameters, process, says, text, three};
use common::{Gauss, Plan, Run, Setting, sines};
use std::fs;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// The parameter file of a table of amplitudes.
fn table(path: &Path, out: &Path) -> DocumentMut {
    let output = calfit().args(["freq", "--no-plots", "--amplitudes"]).arg(path).arg("-o").arg(out).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let id = path.file_stem().unwrap().to_str().unwrap().trim_start_matches("freq_").to_owned();
    parameters(&out.join(&id).join(format!("FREQ_PARAMETER__{id}.FPF")))
}

fn measure(run: &Run) -> (Case, DocumentMut) {
    let case = Case::of(run.clone().key("kind", "\"frequency\"").text());
    let output = case.run("freq", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let fpf = parameters(&case.out().join("13-04-03_09-22-38/FREQ_PARAMETER__13-04-03-09-22-38.FPF"));
    (case, fpf)
}

#[track_caller]
fn within(found: f64, truth: f64, std: f64, times: f64) {
    assert!(std > 0.0 && (found - truth).abs() < times * std, "{found} is not {truth} within {times} times {std}");
}

#[test]
fn the_nine_printed_corners_come_out_of_the_printed_amplitudes() {
    let printed: DocumentMut = fs::read_to_string(data("bepicolombo/frequency.toml")).unwrap().parse().unwrap();
    let out = tempfile::tempdir().unwrap();
    for run in printed["run"].as_array_of_tables().unwrap() {
        let name = run["name"].as_str().unwrap();
        let fpf = table(&data(&format!("bepicolombo/freq_{name}.csv")), out.path());
        for i in 0..3 {
            let expected = run["f_3db_hz"][i].as_float().unwrap();
            let igep = number(&fpf, &format!("f_3db_igep_hz.{i}"));
            assert!((igep - expected).abs() <= 0.06, "{name} {i}: {igep} is not {expected}");
            let (model, std) = (number(&fpf, &format!("f_3db_model_hz.{i}")), number(&fpf, &format!("f_3db_model_std_hz.{i}")));
            assert!(std > 0.0 && (model - expected).abs() < 5.0, "{name} {i}: model {model} ± {std}");
        }
        assert!(fpf["model"]["name"].as_str().unwrap() != "none" && number(&fpf, "f_s_hz.0").is_nan());
    }
}

#[test]
fn the_frequency_cases_give_their_sampling_frequency_and_corners() {
    for name in ["26-05-07", "26-05-08"] {
        let case = Case::new();
        case.put(&format!("{name}/10-00-00.CCR.gz"), fs::read(data(&format!("cases/{name}.CCR.gz"))).unwrap());
        let output = case.run("freq", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let report = case.out().join(format!("{name}_10-00-00/REPORT_FREQ__{name}_10-00-00.md"));
        assert!(!fs::read_to_string(&report).unwrap().contains("\\n"), "{}", report.display());
        let fpf = parameters(&case.out().join(format!("{name}_10-00-00/FREQ_PARAMETER__{name}-10-00-00.FPF")));
        let truth: serde_json::Value = serde_json::from_slice(&fs::read(data(&format!("cases/{name}.json"))).unwrap()).unwrap();
        let f_s = truth["parameters"]["f_s_hz"].as_f64().unwrap();
        for i in 0..3 {
            let found = number(&fpf, &format!("f_s_hz.{i}"));
            within(found, f_s, number(&fpf, &format!("f_s_std_hz.{i}")), 3.0);
            assert!((found - f_s).abs() < 1e-4, "{name}: {found} is not {f_s}");
            let corner = truth["parameters"]["f_3db_hz"][i].as_f64().unwrap();
            within(number(&fpf, &format!("f_3db_model_hz.{i}")), corner, number(&fpf, &format!("f_3db_model_std_hz.{i}")), 3.0);
        }
        within(number(&fpf, "mean_f_s_hz"), f_s, number(&fpf, "mean_f_s_std_hz"), 3.0);
        assert_eq!(fpf["model"]["name"].as_str(), Some("second order"));
    }
}

const FREQUENCIES_HZ: [f64; 16] =
    [1000.0, 501.0, 251.0, 158.0, 126.0, 79.4, 63.1, 50.1, 31.6, 19.9, 10.0, 5.01, 2.51, 1.26, 0.631, 0.501];

fn plan(seed: u64) -> Plan {
    Plan {
        settings: sines(&FREQUENCIES_HZ, 1000.0),
        rate_factor: 127.9987 / 128.0,
        corner_hz: Some([58.0, 61.0, 55.0]),
        seed,
        ..Plan::default()
    }
}

#[test]
fn amplitudes_and_corners_are_those_of_the_forward_model() {
    let plan = plan(3);
    let (_, fpf) = measure(&plan.run());
    let response = plan.truth.response();
    for i in 0..3 {
        within(number(&fpf, &format!("f_s_hz.{i}")), 127.9987, number(&fpf, &format!("f_s_std_hz.{i}")), 3.5);
        for (row, f) in FREQUENCIES_HZ.iter().enumerate() {
            let gain = 1.0 / (1.0 + (f / plan.corner_hz.unwrap()[i]).powi(2)).sqrt();
            let truth = (1000.0 * response[i][1] * gain).abs();
            let amplitude = |key: &str| fpf["amplitude"][row][key][i].as_float().unwrap();
            within(amplitude("b_ent"), truth, amplitude("b_std_ent"), 4.5);
        }
        // The first-order corner is known in closed form.
        within(
            number(&fpf, &format!("f_3db_model_hz.{i}")),
            plan.corner_hz.unwrap()[i],
            number(&fpf, &format!("f_3db_model_std_hz.{i}")),
            4.0,
        );
    }
    assert_eq!(fpf["model"]["name"].as_str(), Some("first order"));
    // 1000 Hz at 127.9987 samples per second is seen at 8 f_s - 1000 Hz.
    assert!((fpf["amplitude"][0]["alias_hz"].as_float().unwrap() - (8.0 * 127.9987 - 1000.0)).abs() < 1e-3);
}

#[test]
fn a_temperature_that_moves_is_said() {
    let mut run = plan(3).run();
    let moved = |fpf: &DocumentMut| fpf["warnings"].to_string().contains("the sensor temperature moved by");
    assert!(!moved(&measure(&run).1));
    for (i, (_, [coil, sensor])) in run.temperatures.iter_mut().enumerate() {
        (*coil, *sensor) = (Some(20.5), Some(24.0 + 3.0 * i as f64));
    }
    let (case, fpf) = measure(&run);
    assert!(moved(&fpf), "{}", fpf["warnings"]);
    drop(case);
}

#[test]
fn phases_are_those_of_the_forward_model() {
    let plan = plan(5);
    let (_, fpf) = measure(&plan.run());
    let corner = plan.corner_hz.unwrap();
    let sign = plan.truth.response().map(|row| row[1].signum());
    let rate = plan.rate_hz * plan.rate_factor;
    for (row, f) in FREQUENCIES_HZ.iter().enumerate() {
        let n = fpf["amplitude"][row]["phase_counter"].as_integer().unwrap() as f64;
        for i in 0..3 {
            let (phase, std) = (&fpf["amplitude"][row]["phase_deg"][i], &fpf["amplitude"][row]["phase_std_deg"][i]);
            let (phase, std) = (phase.as_float().unwrap(), std.as_float().unwrap());
            // Samples stand half a period after their counter; a component that looks the other way shows the sine reversed.
            let driven = 360.0 * (f * (n + 0.5) / rate).fract();
            let truth = driven - (f / corner[i]).atan().to_degrees() + if sign[i] < 0.0 { 180.0 } else { 0.0 };
            let difference = phase - truth;
            let difference = difference - 360.0 * (difference / 360.0).round();
            assert!(difference.abs() < 4.5 * std, "{f} Hz, {i}: {difference}° ± {std}°");
        }
    }
}

#[test]
fn a_drift_of_the_sampling_frequency_is_found_where_there_is_one() {
    let steady = measure(&plan(7).run()).1;
    assert_eq!(steady["clock"]["drift_is_significant"].as_bool(), Some(false));
    // The settings are repeated, so that high frequencies tell the sampling frequency early and late.
    let mut settings = sines(&[1000.0, 631.0, 251.0, 100.0, 1000.0, 631.0, 251.0, 100.0], 1000.0);
    settings.truncate(8);
    let plan = Plan { settings, rate_factor: 1.0, noise_ent: 0.0, ..plan(7) };
    let mut run = plan.run();
    let (rate, drift) = (127.9987, 2e-6);
    let mut gauss = Gauss(11);
    let response = plan.truth.response();
    for sample in &mut run.samples {
        // n = rate t + drift t² / 2 gives the time of a sample.
        let n = sample.n as f64;
        let t = n / rate - drift * (n / rate).powi(2) / (2.0 * rate);
        sample.t = t;
        let setting = plan.settings.iter().find(|s| s.t_start <= t && t < s.t_end);
        sample.reading = std::array::from_fn(|i| {
            let sine =
                setting.map_or(0.0, |s| response[i][1] * 1000.0 * (std::f64::consts::TAU * (s.frequency * t).fract()).sin());
            plan.truth.offset_ent[i] + sine + 0.05 * gauss.normal()
        });
    }
    let (_, fpf) = measure(&run);
    assert_eq!(fpf["clock"]["drift_is_significant"].as_bool(), Some(true));
    // y looks along the driven axis and tells most.
    within(number(&fpf, "clock.drift_hz_per_s.1"), drift, number(&fpf, "clock.drift_std_hz_per_s.1"), 4.0);
    says(&fpf["warnings"].to_string(), &["drifts by"]);
}

#[test]
fn one_table_gives_the_same_file_with_one_and_two_threads() {
    let out = tempfile::tempdir().unwrap();
    let bytes = |threads: &str| {
        let folder = out.path().join(threads);
        let table = data("bepicolombo/freq_13-04-09-12-26-36.csv");
        let run = process()
            .args(["freq", "--no-plots", "--threads", threads, "--amplitudes"])
            .arg(table)
            .arg("-o")
            .arg(&folder)
            .output()
            .unwrap();
        assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
        common::check::tree(&folder)
    };
    assert!(bytes("1") == bytes("2"));
}

/// Sines of a quarter of the amplitude above 20 Hz, and those of three axes one after the other: a response compares readings of like fields.
#[test]
fn sines_that_were_not_applied_alike_are_referred_to_one_field() {
    let alike = plan(3);
    let weaker = Plan {
        settings: alike
            .settings
            .iter()
            .map(|s| Setting { field: s.field.map(|b| if s.frequency > 20.0 { 0.25 * b } else { b }), ..*s })
            .collect(),
        ..plan(3)
    };
    let (_, fpf) = measure(&weaker.run());
    let truth = alike.corner_hz.unwrap();
    for (i, truth) in truth.into_iter().enumerate() {
        let [found, std] = ["f_3db_model_hz", "f_3db_model_std_hz"].map(|key| three(&fpf, key)[i]);
        within(found, truth, std, 4.0);
        assert!(std < 0.2, "{std}");
        within(three(&fpf, "f_3db_igep_hz")[i], truth, 1.0, 1.0);
    }
    let rows = fpf["amplitude"].as_array_of_tables().unwrap();
    for row in rows {
        let [hz, applied_nt] = ["frequency_hz", "applied_nt"].map(|key| row[key].as_float().unwrap());
        assert_eq!(applied_nt, if hz > 20.0 { 250.0 } else { 1000.0 });
    }

    // Along one coil axis after the other: what the run does not tell is how much of each a component sees.
    let mut settings: Vec<Setting> = Vec::new();
    for axis in 0..3 {
        let begin = settings.last().map_or(0.0, |s| s.t_end);
        settings.extend(alike.settings.iter().map(|s| {
            let mut field = [0.0; 3];
            field[axis] = 1000.0;
            Setting { t_start: begin + s.t_start, t_end: begin + s.t_end, field, ..*s }
        }));
    }
    let (_, fpf) = measure(&Plan { settings, ..plan(3) }.run());
    for (i, truth) in truth.into_iter().enumerate() {
        let [found, std] = ["f_3db_model_hz", "f_3db_model_std_hz"].map(|key| three(&fpf, key)[i]);
        within(found, truth, std, 4.0);
        assert!(std < 0.2, "{std}");
    }
}
