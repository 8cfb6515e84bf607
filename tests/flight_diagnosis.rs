//! `calfit diagnose flight.toml` on telemetry of a twin: what is named is what was hidden, with its size, and nothing else.

use crate::common::check::calfit;
use crate::telemetry_twin::calm_twin;
use calfit::files::table::series::SeriesTable;
use serde_json::Value;
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

/// The diagnosis of a mission, as JSON.
fn diagnosed(config: &Path, arguments: &[&str]) -> Value {
    let out = config.parent().unwrap().join("diagnosis");
    let output =
        calfit().args(["diagnose", "--json", "--no-plots"]).arg(config).args(arguments).arg("-o").arg(out).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    serde_json::from_slice(&output.stdout).unwrap()
}

fn effects(diagnosis: &Value) -> Vec<(&str, Vec<&str>)> {
    let steps = diagnosis["steps"].as_array().unwrap().iter();
    steps
        .map(|s| (s["effect"].as_str().unwrap(), s["axes"].as_array().unwrap().iter().map(|a| a.as_str().unwrap()).collect()))
        .collect()
}

/// The calm twin with one boom state, since what a sensor has of its own turns with the boom, and with sensors whose temperatures swing by so much.
fn calm_twin_of_one_boom(dir: &Path, swing_k: f64) -> PathBuf {
    let path = calm_twin(dir);
    let mut twin: DocumentMut = fs::read_to_string(&path).unwrap().parse().unwrap();
    for sensor in twin["sensor"].as_array_of_tables_mut().unwrap().iter_mut() {
        sensor["temperature"]["swing_k"] = toml_edit::value(swing_k);
        let booms = sensor["rotation"].as_array_of_tables_mut().unwrap();
        while booms.len() > 1 {
            booms.remove(1);
        }
        booms.get_mut(0).unwrap()["to"] = toml_edit::value("2015-07-01T03:00:00Z");
    }
    fs::write(&path, twin.to_string()).unwrap();
    path
}

/// Telemetry of a twin that is the calm one with changes.
fn simulated(dir: &Path, name: &str, swing_k: f64, change: impl Fn(&mut DocumentMut)) -> PathBuf {
    let twin = calm_twin_of_one_boom(dir, swing_k);
    let mut text: DocumentMut = fs::read_to_string(&twin).unwrap().parse().unwrap();
    change(&mut text);
    fs::write(&twin, text.to_string()).unwrap();
    let telemetry = dir.join(name);
    let output = calfit().arg("simulate").arg(twin).arg("-o").arg(&telemetry).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    telemetry.join("flight.toml")
}

/// Values and standard uncertainties of the parameters of a step.
fn parameters(step: &Value) -> Vec<(f64, f64)> {
    let all = step["parameters"].as_array().unwrap().iter();
    all.map(|p| (p["value"].as_f64().unwrap(), p["std"].as_f64().unwrap())).collect()
}

#[test]
fn a_diagnosis_of_two_sensors_finds_what_was_not_taken_off_and_nothing_else() {
    let dir = tempfile::tempdir().unwrap();
    // With all models of the truth, noise alone is left.
    let none = diagnosed(&simulated(dir.path(), "still", 0.0, |_| ()), &[]);
    assert_eq!(effects(&none), [], "{}", none["verdict"]);
    assert_eq!(none["runs"], serde_json::json!(["OB-IB"]));
    // Temperatures that move leave what follows their rate: thermistors are read at other times than the vectors of their packets belong to, by
    // the shifts of the filters, 8 s at one sensor and 32 s at the other. With one temperature of both, their difference would be the rounding
    // of the thermistors, which the levels hold too.
    let config = simulated(dir.path(), "moving", 8.0, |twin| {
        let other = twin["sensor"].as_array_of_tables_mut().unwrap().get_mut(1).unwrap();
        other["temperature"]["period_h"] = toml_edit::value(3.9);
    });
    let found = diagnosed(&config, &[]);
    let all = effects(&found);
    assert!(!all.is_empty() && all.iter().all(|(effect, _)| *effect == "temperature_rate"), "{all:?}");
    // Without the daily model of OB its offset follows its temperature, in the truth of the twin by [1.5, 0.05, 4e-3] and [-0.8, -0.04] nT.
    let text = fs::read_to_string(&config).unwrap();
    let line = text.lines().find(|line| line.starts_with("daily = ") && line.contains("_OB")).unwrap();
    fs::write(&config, text.replacen(line, "", 1)).unwrap();
    let found = diagnosed(&config, &[]);
    let steps = effects(&found);
    assert!(!steps.is_empty(), "{}", found["verdict"]);
    assert_eq!(steps[0].0, "sensor_temperature_offset", "{steps:?}");
    assert!(steps[1..].iter().all(|(effect, _)| *effect == "temperature_rate"), "{steps:?}");
    // The report speaks of what was compared and in which axes.
    let report = fs::read_to_string(config.parent().unwrap().join("diagnosis/OB-IB/REPORT_DIAGNOSIS__OB-IB.md")).unwrap();
    assert!(report.contains("# Diagnosis of difference OB-IB") && report.contains("axes of the spacecraft"), "{report}");
    assert!(!report.contains("plateau") && !report.contains("sensor ax"), "{report}");
    // The curvature of the model of the truth, turned into axes of the spacecraft, in nT as the levels have it.
    let truth = fs::read(config.parent().unwrap().join("truth/truth.json")).unwrap();
    let truth: Value = serde_json::from_slice(&truth).unwrap();
    let curvature = truth["sensors"][0]["daily_nt"][0]["polynomials"][0][2].as_f64().unwrap();
    let flight: DocumentMut = text.parse().unwrap();
    let rows = flight["sensor"].as_array_of_tables().unwrap().get(0).unwrap()["rotation"].as_array_of_tables().unwrap();
    let rows = rows.get(0).unwrap()["uvw_to_sc"].as_array().unwrap();
    for (axis, name) in ["x", "y", "z"].into_iter().enumerate() {
        let wanted = curvature * rows.get(axis).unwrap().as_array().unwrap().get(0).unwrap().as_float().unwrap();
        let all = found["steps"][0]["parameters"].as_array().unwrap();
        let own = all.iter().find(|p| p["name"].as_str() == Some(&format!("b2_{name}"))).unwrap();
        assert_eq!(own["unit"], "nT/K^2");
        let (value, std) = (own["value"].as_f64().unwrap(), own["std"].as_f64().unwrap());
        assert!((value - wanted).abs() < 4.0 * std && std < 2e-4, "{name}: {value} ± {std}, {wanted}");
    }
}

/// Twelve hours of two days in a slow mode, in a field that changes, with a heater that is on and off for minutes.
fn heated(twin: &mut DocumentMut) {
    let item = |text: &str| toml_edit::value(text.parse::<toml_edit::Value>().unwrap());
    let [from, to] = ["\"2015-06-30T17:00:00Z\"", "\"2015-07-01T05:30:00Z\""];
    twin["telemetry"]["to"] = item(to);
    let interval = twin["interval"].as_array_of_tables_mut().unwrap().get_mut(0).unwrap();
    for (key, text) in [("sid", "\"SID5\""), ("from", from), ("to", to)] {
        interval[key] = item(text);
    }
    for sensor in twin["sensor"].as_array_of_tables_mut().unwrap().iter_mut() {
        sensor["rotation"].as_array_of_tables_mut().unwrap().get_mut(0).unwrap()["to"] = item("\"2015-07-03T00:00:00Z\"");
    }
    twin["external"]["scatter_nt"] = item("[2.0, 2.0, 2.0]");
    let heaters: DocumentMut = format!(
        "[heaters]\ninterval = [{{ from = \"2015-06-30T20:00:00Z\", to = \"2015-06-30T23:00:00Z\" }}, \
         {{ from = \"2015-07-01T01:00:00Z\", to = \"2015-07-01T04:00:00Z\" }}]\n\
         [[heaters.class]]\nname = \"h1\"\nfield_nt = {HEATER_NT:?}\non_s = [400.0, 900.0]\noff_s = [300.0, 800.0]\n"
    )
    .parse()
    .unwrap();
    twin["heaters"] = heaters["heaters"].clone();
}

const HEATER_NT: [f64; 3] = [0.112, -0.074, 0.058];
/// Rates of a wheel that turns faster while the heater is on, Hz.
const WHEEL_HZ: [f64; 2] = [20.0, 25.0];

#[test]
fn a_sensor_is_compared_with_a_model_of_the_field_over_two_days() {
    let dir = tempfile::tempdir().unwrap();
    let config = simulated(dir.path(), "days", 0.0, heated);
    let telemetry = config.parent().unwrap();
    // The model is the field of the truth in celestial axes, once as it is and once too large by a fiftieth.
    for (name, factor) in [("model.csv", 1.0), ("large.csv", 1.02)] {
        let mut text = "time_tt2000,bx,by,bz\n".to_owned();
        for day in ["2015-06-30", "2015-07-01"] {
            let path = telemetry.join(format!("truth/sensor=OB/date={day}/truth.parquet"));
            let truth = SeriesTable::open(&path).unwrap();
            let (time, good) = (truth.whole("time_tt2000").unwrap(), truth.whole("good").unwrap());
            let [x, y, z] = ["ext_x", "ext_y", "ext_z"].map(|name| truth.numbers(name).unwrap());
            for i in (0..time.len()).filter(|i| good[*i] == 1) {
                writeln!(text, "{},{:.6},{:.6},{:.6}", time[i], x[i] * factor, y[i] * factor, z[i] * factor).unwrap();
            }
        }
        fs::write(telemetry.join(name), text).unwrap();
    }
    let model = telemetry.join("model.csv").display().to_string();
    let found = diagnosed(&config, &["--field", &model]);
    assert_eq!(found["runs"], serde_json::json!(["OB-model"]));
    assert_eq!(effects(&found), [("heater_field", vec!["x", "y", "z"])], "{}", found["verdict"]);
    for ((value, std), wanted) in parameters(&found["steps"][0]).into_iter().zip(HEATER_NT) {
        assert!((value - wanted).abs() < 4.0 * std && std < 0.01, "{value} ± {std}: {wanted}");
    }
    // Where the model is too large, the difference falls with every component of the field.
    let large = telemetry.join("large.csv").display().to_string();
    let found = diagnosed(&config, &["--field", &large, "--sensor", "OB"]);
    let mut names: Vec<&str> = effects(&found).into_iter().map(|(effect, _)| effect).collect();
    names.dedup();
    names.sort_unstable();
    assert_eq!(names, ["field_difference", "heater_field"], "{}", found["verdict"]);
    let step = found["steps"].as_array().unwrap().iter().find(|step| step["effect"] == "field_difference").unwrap();
    let (value, std) = parameters(step)[0];
    assert!((value - (1.0 / 1.02 - 1.0)).abs() < 4.0 * std && std < 0.002, "{value} ± {std}");
    // Without the table of heaters, and with a wheel that turns faster when they are on, it is the wheel.
    let states = SeriesTable::open(&telemetry.join("heater/romap.parquet")).unwrap();
    let mut rows = "time_tt2000,w1_hz\n488894000000000000,20.0\n".to_owned();
    for (from, to) in states.whole("from_tt2000").unwrap().into_iter().zip(states.whole("to_tt2000").unwrap()) {
        let [off, on] = WHEEL_HZ;
        for (edge, before, behind) in [(from, off, on), (to, on, off)] {
            writeln!(rows, "{},{before}\n{},{behind}", edge - 500_000_000, edge + 500_000_000).unwrap();
        }
    }
    writeln!(rows, "489120000000000000,20.0").unwrap();
    fs::write(telemetry.join("wheels.csv"), rows).unwrap();
    let text = fs::read_to_string(&config).unwrap();
    let without = text[..text.find("\n[heater]").unwrap()].to_owned();
    fs::write(&config, format!("{without}\n[wheels]\ntable = \"wheels.csv\"\nhalf_width_hz = {{ SID3 = 0.03 }}\n")).unwrap();
    let found = diagnosed(&config, &["--field", &model]);
    assert_eq!(effects(&found), [("wheel_field", vec!["x", "y", "z"])], "{}", found["verdict"]);
    for ((value, std), heater) in parameters(&found["steps"][0]).into_iter().zip(HEATER_NT) {
        let wanted = heater / (WHEEL_HZ[1] - WHEEL_HZ[0]);
        assert!((value - wanted).abs() < 4.0 * std && std < 0.002, "{value} ± {std}: {wanted}");
    }
}
