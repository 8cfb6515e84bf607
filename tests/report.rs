//! `calfit report` and `calfit thermal` on a campaign with runs of every kind.

#[path = "common/browser.rs"]
mod browser;
mod common;

use common::campaign::{self, TEMPERATURES_DEGC, id};
use common::check::{Case, calfit, number, parameters, says, text, tree};
use std::fs;
use toml_edit::DocumentMut;

/// Value of a polynomial of a parameter file at a temperature, and its standard uncertainty.
fn evaluate(document: &DocumentMut, name: &str, degc: f64) -> (f64, f64) {
    let list = |item: &toml_edit::Item| -> Vec<f64> { item.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect() };
    let coefficients = list(&document[name]);
    let powers: Vec<f64> = (0..coefficients.len()).map(|k| degc.powi(k as i32)).collect();
    let covariance: Vec<Vec<f64>> = document["covariance"][name]
        .as_array()
        .unwrap()
        .iter()
        .map(|row| row.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect())
        .collect();
    let value = coefficients.iter().zip(&powers).map(|(c, p)| c * p).sum();
    let variance: f64 =
        (0..powers.len()).map(|i| (0..powers.len()).map(|j| powers[i] * covariance[i][j] * powers[j]).sum::<f64>()).sum();
    (value, variance.sqrt())
}

#[track_caller]
fn within(document: &DocumentMut, name: &str, truth: impl Fn(f64) -> f64) {
    for degc in TEMPERATURES_DEGC {
        let (value, std) = evaluate(document, name, degc);
        assert!(
            std > 0.0 && (value - truth(degc)).abs() < 4.0 * std,
            "{name} at {degc} °C: {value} ± {std} is not {}",
            truth(degc)
        );
    }
}

#[test]
fn the_report_of_a_campaign_with_all_kinds_of_runs_shows_in_a_browser() {
    let case = Case::new();
    campaign::write(&case);
    let output = calfit()
        .arg("report")
        .arg(case.campaign())
        .arg("-o")
        .arg(case.out())
        .args(["--order", "b_or=2", "--order", "b_off=2"])
        .timeout(std::time::Duration::from_secs(300))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));

    // The truth comes back through all kinds of files.
    let out = case.out();
    let tpf = parameters(&out.join(format!("THERMAL_PARAMETER__{}.TPF", id(8, 0).replace('_', "-"))));
    let tof = parameters(&out.join(format!("THERMAL_OFF_PARAMETER__{}.TOF", id(9, 0).replace('_', "-"))));
    let taf = parameters(&out.join(format!("THERMAL_AC_PARAMETER__{}.TAF", id(10, 0).replace('_', "-"))));
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        within(&tpf, &format!("sigma_{axis}"), |t| campaign::truth(t).sigma[i]);
        within(&tof, &format!("b_off_{axis}"), |t| campaign::truth(t).offset_ent[i]);
        within(&taf, &format!("f_3db_{axis}"), |t| campaign::corner_hz(t)[i]);
    }
    for (i, pair) in ["xy", "xz", "yz"].into_iter().enumerate() {
        within(&tpf, &format!("xi_{pair}"), |t| campaign::truth(t).xi_deg[i]);
    }
    assert!((number(&taf, "mean_sample_rate_hz") - 128.0 * campaign::RATE_FACTOR).abs() < 1e-5);
    assert_eq!(tpf["used"].as_array().unwrap().len(), TEMPERATURES_DEGC.len());
    for name in tpf["used"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()) {
        let run = name.trim_start_matches("PARAMETER_TEMPLIN__").trim_end_matches(".CPF");
        assert!(out.join(run).join(name).is_file(), "{name}");
    }
    // Offsets in nT come with the sensitivities of the nearest calibration.
    let opf = parameters(&out.join(id(9, 1)).join(format!("OFF_PARAMETER__{}.OPF", id(9, 1).replace('_', "-"))));
    assert_eq!(opf["scaled"]["cpf"].as_str(), Some(format!("PARAMETER_LIN__{}.CPF", id(8, 1)).as_str()));

    let markdown = fs::read_to_string(out.join("REPORT.md")).unwrap();
    says(
        &markdown,
        &[
            "# Ground calibration of a test magnetometer",
            "## 1 Introduction",
            "## 2 Measurements on April 3, 2013",
            "NULL.MAG",
            "RANDOM50000.MAG",
            "## 6 Combined measurements",
            "temperature calibration of the AC transfer function",
            "Joint fit",
            "## 7 Complete temperature profile",
            "## 8 Mathematical description",
            "## 9 Nomenclature",
            "## 10 Origin and uncertainty",
            "coverage factor 1",
        ],
    );
    let html = out.join("REPORT.html");
    let page = fs::read_to_string(&html).unwrap();
    assert_eq!(page.matches("<img").count(), markdown.matches("\n![").count());
    assert!(!page.contains("http://") && !page.contains("src=\"http"), "the page loads nothing");
    let keep = std::env::var_os("CALFIT_SCREENS").map(std::path::PathBuf::from);
    let screens = keep.unwrap_or_else(|| case.path().join("screens"));
    fs::create_dir_all(&screens).unwrap();
    browser::screens(&html, &screens);
}

#[test]
fn the_report_is_the_same_with_one_and_two_threads() {
    let case = Case::new();
    campaign::write(&case);
    let run = |threads: &str| {
        let out = case.path().join(threads);
        let output = calfit()
            .arg("report")
            .arg(case.campaign())
            .arg("-o")
            .arg(&out)
            .args(["--no-plots", "--threads", threads])
            .timeout(std::time::Duration::from_secs(300))
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        tree(&out)
    };
    assert!(run("1") == run("2"));
}

/// Values that the comments of the sample runs state: temperature, σ.
const SAMPLE_SIGMA: [(f64, [f64; 3]); 3] =
    [(-60.0, [0.973690, 0.997436, 0.990245]), (70.0, [0.971350, 0.995356, 0.987645]), (140.0, [0.970090, 0.994236, 0.986245])];

#[test]
fn the_sample_campaign_gives_what_its_comments_state() {
    let out = tempfile::tempdir().unwrap();
    let sample = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("runs/sample");
    let output = calfit()
        .args(["report", "--no-plots", "-o"])
        .args([out.path(), sample.as_path()])
        .timeout(std::time::Duration::from_secs(300))
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let tpf = parameters(&out.path().join("THERMAL_PARAMETER__26-01-15-09-00-00.TPF"));
    for (degc, sigma) in SAMPLE_SIGMA {
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let (value, std) = evaluate(&tpf, &format!("sigma_{axis}"), degc);
            // The comments are rounded to six decimals.
            assert!((value - sigma[i]).abs() < 4.0 * std + 5e-7, "σ_{axis} at {degc} °C: {value} ± {std} is not {}", sigma[i]);
        }
    }
    let tof = parameters(&out.path().join("THERMAL_OFF_PARAMETER__26-01-15-09-30-00.TOF"));
    // 1.5, -0.8 and 2.4 nT along the coil axes; z shows that of X_c with the other sign.
    for (key, residual) in [("x_ent", 1.5), ("y_ent", -0.8), ("z_ent", -1.5)] {
        for i in 0..4 {
            let found = number(&tof, &format!("residual_field.{key}.{i}"));
            assert!((found - residual).abs() < 0.15, "{key} {i}: {found}");
        }
    }
}
