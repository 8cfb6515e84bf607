//! Diagnosis of frequency runs: right on those of the cases and on the amplitude tables of 2013. Runs of the blind generator are those of
//! the studies.

use crate::common;

use common::check::{Case, calfit, text};
use common::{Gauss, Plan, RUN_ID, Run, sines};
use std::f64::consts::TAU;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

#[test]
fn the_cases_give_what_is_hidden_in_them() {
    for (name, expected) in [("26-05-07", None), ("26-05-08", Some("lost_samples"))] {
        let case = Case::new();
        case.put(&format!("{name}/10-00-00.CCR.gz"), fs::read(data(&format!("cases/{name}.CCR.gz"))).unwrap());
        let output = case.run("diagnose", &[]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let json = fs::read_to_string(case.out().join(format!("{name}_10-00-00/diagnosis.json"))).unwrap();
        let made: serde_json::Value = serde_json::from_str(&json).unwrap();
        let steps = made["steps"].as_array().unwrap();
        assert_eq!(steps.first().map(|s| s["effect"].as_str().unwrap()), expected, "{json}");
        assert_eq!(steps.len(), expected.iter().count());
        assert!(made["response"].as_str().unwrap().starts_with("second order"), "{}", made["response"]);
        let verdict = expected.map_or_else(|| "no missing effect".to_owned(), |name| format!("1 effect found: {name}"));
        assert_eq!(made["verdict"], verdict);
        if expected.is_none() {
            continue;
        }
        let truth: serde_json::Value = serde_json::from_slice(&fs::read(data(&format!("cases/{name}.json"))).unwrap()).unwrap();
        let blocks = truth["effects"]["lost_samples"]["blocks"].as_array().unwrap();
        assert_eq!(steps[0]["parameters"][0]["value"].as_f64().unwrap(), blocks.len() as f64);
        let place = steps[0]["where"].as_str().unwrap();
        for block in blocks {
            let words = format!("{} Hz: {} samples missing", block[0].as_f64().unwrap(), block[1]);
            assert!(place.contains(&words), "{words} is not in {place}");
        }
    }
}

/// A run whose axes see the field with other signs, as a sensor that is turned over does.
fn turned_over(ccr: &str, signs: [bool; 3]) -> String {
    let (head, vectors) = ccr.split_once("@VECTORS\nn,t,x,y,z\n").unwrap();
    let turned = |line: &str| {
        let mut cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        for (cell, _) in cells.iter_mut().skip(2).zip(signs).filter(|(_, turned)| *turned) {
            *cell = cell.strip_prefix('-').map_or_else(|| format!("-{cell}"), str::to_owned);
        }
        cells.join(",")
    };
    let lines: Vec<String> = vectors.lines().map(turned).collect();
    format!("{head}@VECTORS\nn,t,x,y,z\n{}\n", lines.join("\n"))
}

/// The sign with which an axis sees the field is no response: whatever it is, the run says the same.
#[test]
fn an_axis_may_see_the_field_with_either_sign() {
    let mut ccr = String::new();
    flate2::read::GzDecoder::new(fs::read(data("cases/26-05-07.CCR.gz")).unwrap().as_slice()).read_to_string(&mut ccr).unwrap();
    let response = |signs: [bool; 3]| {
        let case = Case::of(turned_over(&ccr, signs));
        let output = case.run("diagnose", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let json = fs::read_to_string(case.out().join("26-05-07_10-00-00/diagnosis.json")).unwrap();
        let made: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(made["verdict"], "no missing effect", "{signs:?}: {}", made["verdict"]);
        made["response"].as_str().unwrap().to_owned()
    };
    let upright = response([false; 3]);
    for signs in [[true, false, false], [false, false, true], [true; 3]] {
        assert_eq!(response(signs), upright, "{signs:?}");
    }
}

/// Readings of the twelve frequencies lie far below those of their neighbours in the printed table; in the other two every amplitude above
/// -10 dB follows its neighbours.
#[test]
fn the_amplitude_tables_of_2013_name_their_outliers_and_the_response() {
    const LOW_HZ: [f64; 12] = [0.126, 0.158, 0.199, 0.251, 0.398, 1.0, 1.99, 6.31, 19.9, 31.6, 39.8, 79.4];
    let out = tempfile::tempdir().unwrap();
    for name in ["13-04-03-12-59-48", "13-04-03-14-41-31", "13-04-09-12-26-36"] {
        let path = data(&format!("bepicolombo/freq_{name}.csv"));
        let output =
            calfit().args(["diagnose", "--no-plots", "--amplitudes"]).arg(&path).arg("-o").arg(out.path()).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let json = fs::read_to_string(out.path().join(name).join("diagnosis.json")).unwrap();
        let made: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert!(made["response"].as_str().unwrap().starts_with("boxcar"), "{}", made["response"]);
        let steps = made["steps"].as_array().unwrap();
        let named: Vec<f64> =
            steps.iter().flat_map(|s| s["form"]["shape"].as_array().unwrap()).map(|p| p[1].as_f64().unwrap()).collect();
        if name == "13-04-03-14-41-31" {
            assert_eq!((steps.len(), steps[0]["effect"].as_str()), (1, Some("lost_samples")));
            assert_eq!(named, LOW_HZ);
        } else {
            assert!(named.iter().all(|hz| *hz > 100.0), "{name}: {named:?}");
        }
    }
}

/// Any response follows a handful of amplitudes, so that nothing could stand out of them: that is no clean bill of health.
#[test]
fn a_table_of_a_handful_of_amplitudes_is_refused_by_name() {
    let whole = fs::read_to_string(data("bepicolombo/freq_13-04-03-12-59-48.csv")).unwrap();
    let is_row = |line: &&str| line.starts_with(|c: char| c.is_ascii_digit());
    let head: Vec<&str> = whole.lines().take_while(|line| !is_row(line)).collect();
    let rows: Vec<&str> = whole.lines().filter(is_row).collect();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("freq_few.csv");
    for count in [1, 2, 4] {
        let few = rows.iter().step_by(rows.len() / count).take(count).copied();
        fs::write(&path, head.iter().copied().chain(few).map(|line| format!("{line}\n")).collect::<String>()).unwrap();
        let output =
            calfit().args(["diagnose", "--no-plots", "--amplitudes"]).arg(&path).arg("-o").arg(folder.path()).output().unwrap();
        let told = text(&output.stderr);
        assert_ne!(output.status.code(), Some(0), "{count} rows: {told}");
        assert!(told.contains("amplitudes") && told.contains("measure more frequencies"), "{count} rows: {told}");
        assert!(!folder.path().join("few/diagnosis.json").exists(), "{count} rows");
    }
}

/// Sines on all axes, each setting with a phase of its own, through a second order of 50, 55 and 60 Hz and one pole more at `pole_hz`;
/// `time_s` is what a clock with the time tags of the run has passed.
fn with_sines(seed: u64, pole_hz: f64, time_s: impl Fn(f64) -> f64) -> Run {
    of_sines(&FREQUENCIES_HZ, seed, pole_hz, time_s, |_| 1.0)
}

/// In an order without pattern.
const FREQUENCIES_HZ: [f64; 14] = [890.0, 13.0, 1.7, 350.0, 61.0, 5.3, 610.0, 29.0, 150.0, 0.7, 97.0, 240.0, 470.0, 42.0];

/// The same with frequencies in an order, and a field that changes with the time by a factor.
fn of_sines(frequencies_hz: &[f64], seed: u64, pole_hz: f64, time_s: impl Fn(f64) -> f64, field: impl Fn(f64) -> f64) -> Run {
    let mut plan = Plan { settings: sines(frequencies_hz, 1000.0), ..Plan::default() };
    plan.settings.iter_mut().for_each(|setting| setting.field = [1000.0; 3]);
    let (truth, mut gauss) = (plan.truth.clone(), Gauss(seed));
    let mut run = plan.run().key("kind", "\"frequency\"").key("configuration", "\"FREQ1000.MAG\"");
    run.reading_decimals = 4;
    let (zero, full) = (truth.reading([0.0; 3]), truth.reading([1000.0; 3]));
    for sample in &mut run.samples {
        sample.reading = zero;
        let t = time_s(sample.t);
        if let Some((k, setting)) = run.settings.iter().enumerate().find(|(_, s)| (s.t_start..s.t_end).contains(&t)) {
            let f = setting.frequency;
            for (i, own_hz) in [50.0, 55.0, 60.0].into_iter().enumerate() {
                let (ratio, pole) = (f / own_hz, f / pole_hz);
                let (re, im) = (1.0 - ratio * ratio, ratio / 0.7);
                let gain = (re.hypot(im) * pole.hypot(1.0)).recip();
                let phase = f * (t - setting.t_start) + (k * k) as f64 * 0.13;
                let angle = TAU * phase.fract() - im.atan2(re) - pole.atan();
                sample.reading[i] += (full[i] - zero[i]) * field(t) * gain * angle.sin();
            }
        }
        (0..3).for_each(|i| sample.reading[i] += 0.3 * gauss.normal());
    }
    run
}

/// `diagnosis.json` of a run.
fn diagnosed(run: &Run) -> serde_json::Value {
    let case = Case::of(run.text());
    let output = case.run("diagnose", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    serde_json::from_slice(&fs::read(case.out().join(RUN_ID).join("diagnosis.json")).unwrap()).unwrap()
}

/// A source gets weaker by a hundredth while the frequencies go down: that looks like a response, and is no certain one.
#[test]
fn a_source_that_drifts_is_no_certain_response() {
    let mut down_hz = FREQUENCIES_HZ;
    down_hz.sort_by(|a, b| b.total_cmp(a));
    for (seed, part) in [(1, 0.01), (2, -0.01), (3, 0.003)] {
        let run = of_sines(&down_hz, seed, f64::INFINITY, |t| t, |t| 1.0 - part * t / 180.0);
        let found = diagnosed(&run);
        let certain: Vec<&str> = found["steps"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|s| s["wording"] == "is")
            .map(|s| s["effect"].as_str().unwrap())
            .collect();
        assert!(certain.is_empty(), "{part}: {certain:?}");
        assert_ne!(found["verdict_kind"], "none", "{part}");
    }
}

/// A clock that drifts by 2e-5 over the run has the wrong frequency in most settings, by a tenth of a turn at their ends: nothing is lost.
#[test]
fn a_clock_that_drifts_loses_no_samples() {
    let found = diagnosed(&with_sines(3, f64::INFINITY, |t| t - 1e-5 * t * (t / 180.0 - 1.0)));
    let certain = found["steps"].as_array().unwrap().iter().filter(|s| s["wording"] == "is");
    assert_eq!(certain.map(|s| s["effect"].as_str().unwrap()).collect::<Vec<&str>>(), ["clock_drift"]);
}

/// Where amplitudes alone tell a further pole, the square of what does not pass it counts, and no slope tells its uncertainty.
#[test]
fn a_further_pole_has_an_uncertainty_in_every_run() {
    for seed in 1..5 {
        let found = diagnosed(&with_sines(seed, 150.0, |t| t));
        let step = &found["steps"].as_array().unwrap()[0];
        assert_eq!(step["effect"], "eddy_current_attenuation", "{seed}");
        let part = step["parameters"].as_array().unwrap().iter().find(|p| p["name"] == "part").unwrap();
        let [value, std] = ["value", "std"].map(|key| part[key].as_f64().unwrap());
        assert!((value - 1.0).abs() < 4.0 * std && std < 0.1, "{seed}: {value} +- {std}");
    }
}
