//! `calfit report` and `calfit thermal` on a campaign with runs of every kind.

use crate::common::{self, browser};

use calfit::data::run::Kind;
use calfit::data::units::FieldCoil;
use calfit::files::{mag, twin};
use calfit::simulate::write_campaign;
use common::campaign::{self, TEMPERATURES_DEGC, id};
use common::check::{Case, calfit, number, parameters, process, says, text, tree};
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
    // Offsets in nT come with the sensitivities of the nearest calibration, as it was made with its group.
    let opf = parameters(&out.join(id(9, 1)).join(format!("OFF_PARAMETER__{}.OPF", id(9, 1).replace('_', "-"))));
    assert_eq!(opf["scaled"]["cpf"].as_str(), Some(format!("PARAMETER_TEMPLIN__{}.CPF", id(8, 1)).as_str()));

    let markdown = fs::read_to_string(out.join("REPORT.md")).unwrap();
    says(
        &markdown,
        &[
            "# Ground calibration of a test magnetometer",
            "## 1 Introduction",
            "## 2 Measurements on April 3, 2013",
            "NULL.MAG",
            "Zero-field measurement",
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
    // A caption names no figure that is not there.
    let mut named = 0;
    for (name, bytes) in tree(&out).iter().filter(|(name, _)| name.ends_with(".md")) {
        let page = text(bytes);
        if page.contains("the figure of the residuals shows them") {
            named += 1;
            assert!(page.contains("Residuals of the thermal model"), "{name}");
        }
    }
    assert!(named >= 2, "{named}");
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
        let output = process()
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
    let output = calfit().args(["report", "--no-plots", "-o"]).args([out.path(), sample.as_path()]).output().unwrap();
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

/// The twin of `configs/demo.toml` with a linearity, an offset and a scalar run, a short zero-field run, and a run of plus and minus F
/// on the coil axes.
fn twin_with_facility() -> twin::Twin {
    let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut twin = twin::read(&root.join("configs/demo.toml"), &mut Vec::new()).unwrap();
    let first = twin.runs.clone();
    twin.runs.retain(|run| {
        ["26-03-02_07-00-00", "26-03-02_08-00-00", "26-03-02_08-31-00", "26-03-02_16-00-00"].contains(&run.id.as_str())
    });
    twin.runs[3].longest_s = Some(1800.0);
    let axis = |k: usize, value: f64| std::array::from_fn(|i| if i == k { value } else { 0.0 });
    let steps = (0..3).flat_map(|k| [49_000.0, -49_000.0].map(|value| axis(k, value)));
    twin.programmes.push(mag::Programme {
        name: "RESIDUAL.MAG".to_owned(),
        kind: Kind::Scalar,
        steps: steps.map(|b| mag::Step { duration_s: 20.0, field: FieldCoil(b), frequency_hz: 0.0, position: 1 }).collect(),
    });
    let start = "2026-03-02T07:40:00Z".parse().unwrap();
    let programme = twin.programmes.len() - 1;
    twin.runs.push(twin::RunTwin { id: "26-03-02_07-40-00".to_owned(), start, programme, ..first[0].clone() });
    twin.campaign_toml =
        twin.campaign_toml.replace("[report]", "[report]\nthermistors = [\"tables/pt1000.csv\", \"tables/missing.csv\"]");
    twin
}

#[test]
fn the_protocol_takes_zero_field_runs_the_coil_system_and_thermistors_in() {
    let case = Case::new();
    let twin = twin_with_facility();
    write_campaign(&twin, 3, &case.campaign(), false, || ()).unwrap();
    let table = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosetta/pt1000_table.csv");
    case.put("tables/pt1000.csv", fs::read(table).unwrap());
    let output = calfit().arg("report").arg(case.campaign()).arg("-o").arg(case.out()).output().unwrap();
    // The table that is missing is told; all the rest is there.
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["tables/missing.csv"]);
    let markdown = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(
        &markdown,
        &[
            "Zero-field measurement at",
            "Offset and drift",
            "With the sensitivities of `PARAMETER_LIN__26-03-02_08-00-00.CPF`",
            "(26-03-02_16-00-00/NULL_drift__26-03-02_16-00-00.png",
            "Calibration of the coil system",
            "Scalar calibration of the coil system",
            "(COIL_SCALAR_residuals_x__26-03-02_07-00-00.png",
            "Residual field of the coil system",
            "(COIL_RESIDUAL_fields__26-03-02_07-40-00.png",
            "Thermistor calibration, table pt1000",
            "(THERMISTOR_",
            "| pt1000.csv |",
            "| `COIL_RESIDUAL__26-03-02_07-40-00.toml` |",
            "tables/missing.csv",
        ],
    );
    // The twin's coils are ideal; their residual field is that of the twin, -0.4, 0.2, -7 nT, from two moduli of 0.1 nT noise and
    // settings that scatter by 0.02 nT.
    let file = parameters(&case.out().join("COIL_RESIDUAL__26-03-02_07-40-00.toml"));
    common::check::close(common::check::three(&file, "facility.offset_nt"), [-0.4, 0.2, -7.0], 0.3);
    let file = parameters(&case.out().join("COIL_SCALAR__26-03-02_07-00-00.toml"));
    assert_eq!(file["used"].as_array().unwrap().len(), 1);
    common::check::close(common::check::three(&file, "facility.scale_nt_per_eu"), [1.0; 3], 2e-6);
    let page = fs::read_to_string(case.out().join("REPORT.html")).unwrap();
    assert_eq!(page.matches("<img").count(), markdown.matches("\n![").count());
    // Every parameter file comes back from its inputs.
    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}
