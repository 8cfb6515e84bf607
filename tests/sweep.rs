//! `calfit thermal` on continuous sweeps of an independent generator: temperature coefficients and lags come back.

use crate::common;

use common::check::{Case, number, parameters, text};
use std::fs;
use std::path::Path;

/// Analyses a case; its truth and its parameter file.
fn made(name: &str, arguments: &[&str]) -> (serde_json::Value, toml_edit::DocumentMut, String) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    let truth = serde_json::from_str(&fs::read_to_string(data.join(format!("{name}.json"))).unwrap()).unwrap();
    let case = Case::new();
    case.put(&format!("{name}/10-00-00.CCR.gz"), fs::read(data.join(format!("{name}.CCR.gz"))).unwrap());
    // A second time into the same folder: the program knows its own files.
    case.run("thermal", &[&["--no-plots"], arguments].concat());
    let output = case.run("thermal", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let file = case.out().join(format!("{name}_10-00-00/THERMAL_PARAMETER__{name}-10-00-00.TPF"));
    (truth, parameters(&file), text(&output.stdout))
}

/// Coefficients and their standard uncertainties against the truth, in multiples of the latter.
fn compare(truth: &serde_json::Value, file: &toml_edit::DocumentMut) {
    let of = |key: &str, i: usize| truth["parameters"][key][i].as_f64().unwrap();
    for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
        let sigma = of("sigma_at_0c", i);
        let xi = ["xy", "xz", "yz"][i];
        let wanted = [
            (format!("sigma_{component}"), vec![sigma, sigma * of("dsigma1", i), sigma * of("dsigma2", i)]),
            (format!("xi_{xi}"), vec![of("xi_deg", i), 0.0]),
            (format!("b_or_{component}"), vec![of("offset_ent", i), 0.0]),
        ];
        for (name, coefficients) in wanted {
            for (k, wanted) in coefficients.into_iter().enumerate() {
                let found = number(file, &format!("{name}.{k}"));
                let row = file["covariance"][&name].as_array().unwrap().get(k).unwrap().as_array().unwrap();
                let std = row.get(k).unwrap().as_float().unwrap().sqrt();
                assert!((found - wanted).abs() < 3.0 * std, "{name} {k}: {found} is not {wanted} within 3 x {std}");
            }
        }
    }
}

/// A value of the first thermistor that a lag was looked for.
fn lag(file: &toml_edit::DocumentMut, channel: &str, key: &str) -> f64 {
    let parts = file["sweep"]["lag"].as_array_of_tables().unwrap();
    let part = parts.iter().find(|p| p["channel"].as_str() == Some(channel)).unwrap();
    part[key].as_float().unwrap()
}

#[test]
fn coefficients_come_back_and_no_lag_is_found_where_there_is_none() {
    let (truth, file, stdout) = made("26-05-05", &["--order", "sigma=2", "--order", "b_or=1"]);
    compare(&truth, &file);
    assert!(stdout.contains("no lag"), "{stdout}");
    assert!(lag(&file, "TCSC", "delay_s").abs() < 60.0 && lag(&file, "TCSC", "time_constant_s").abs() < 60.0);
    assert_eq!(file["channel"].as_str(), Some("TCSC"));
}

#[test]
fn the_time_constant_of_the_sensor_is_found() {
    let (truth, file, stdout) = made("26-05-06", &["--order", "sigma=2", "--order", "b_or=1"]);
    let expected = truth["effects"]["thermal_lag"]["tau_s"].as_f64().unwrap();
    assert!((lag(&file, "TCSC", "time_constant_s") - expected).abs() < 60.0);
    assert!(stdout.contains("time constant"), "{stdout}");
    // Its form is told from a delay, and the other thermistor follows worse.
    assert!(lag(&file, "TCSC", "delay_over_first_order") < -10.0);
    assert!(lag(&file, "TCSC", "residual_std_ent") < lag(&file, "TSENS", "residual_std_ent"));
    compare(&truth, &file);
}

#[test]
fn fast_parts_are_left_out_and_windows_have_the_length_asked_for() {
    let (_, file, _) = made("26-05-05", &["--max-rate", "0.2", "--window", "20min"]);
    let part = &file["sweep"];
    let [used, fast] = ["settings_used", "settings_too_fast"].map(|key| part[key].as_integer().unwrap());
    assert!(used + fast == 720 && fast > 50 && used > 200, "{used} {fast}");
    assert_eq!(part["window"].as_str(), Some("20 min"));
}
