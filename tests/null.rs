//! `calfit null`: offset, drift and noise of zero-field runs come back, and what stops is told. `calfit thermistor`: polynomials of tables.

use crate::common;

use common::check::{Case, calfit, number, parameters, says, text, tree};
use common::{Plan, Run, Setting};
use std::process::Output;

const RATE_HZ: f64 = 16.0;
const NOISE_ENT: f64 = 0.4;
const DRIFT_ENT_PER_H: [f64; 3] = [3.0, 0.0, -1.5];

/// An hour of zero field with a drift.
fn night() -> Run {
    let plan = Plan {
        settings: vec![Setting::constant(0.0, 3600.0, [0.0; 3], 1)],
        rate_hz: RATE_HZ,
        noise_ent: NOISE_ENT,
        ..Plan::default()
    };
    let mut run = plan.run().key("kind", "\"zero-field\"").key("configuration", "\"NULL.MAG\"");
    for sample in &mut run.samples {
        for (value, drift) in sample.reading.iter_mut().zip(DRIFT_ENT_PER_H) {
            *value += drift * sample.t / 3600.0;
        }
    }
    run
}

fn analysed(run: &Run, arguments: &[&str]) -> (Case, Output) {
    let case = Case::of(run.text());
    let output = case.run("null", arguments);
    (case, output)
}

const FILE: &str = "13-04-03_09-22-38/NULL_PARAMETER__13-04-03_09-22-38.toml";

#[test]
fn offset_drift_and_noise_come_back_from_a_file_and_verify() {
    let (case, output) = analysed(&night(), &[]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let p = parameters(&case.out().join(FILE));
    let offset = Plan::default().truth.offset_ent;
    // One-sided white density s sqrt(2/f_s).
    let density = NOISE_ENT * (2.0 / RATE_HZ).sqrt();
    for c in 0..3 {
        let at = |path: &str| number(&p, &format!("{path}.{c}"));
        let mean = offset[c] + 0.5 * DRIFT_ENT_PER_H[c];
        assert!((at("offset.mean_ent") - mean).abs() < 3.0 * at("offset.mean_std_ent"), "{c}");
        let (drift, std) = (at("offset.drift_ent_per_h.0"), at("offset.drift_std_ent_per_h.0"));
        assert!((drift - DRIFT_ENT_PER_H[c]).abs() < 3.0 * std && std < 0.05, "{c}: {drift} ± {std}");
        assert!((at("density.ent_per_root_hz") - density).abs() < 3.5 * at("density.std_ent_per_root_hz"), "{c}");
        assert!((at("corner.white_ent_per_root_hz") / density - 1.0).abs() < 0.02, "{c}");
    }
    // What the uncertainties hold for, with the length of the record.
    let [begin, end] = [0, 1].map(|k| number(&p, &format!("record.time_s.{k}")));
    let lasting = format!("noise that changes within the {:.0} s of the record", end - begin);
    says(
        p["offset"]["std_covers"].as_str().unwrap(),
        &[&lasting, "shows in no residual", "compare the offsets of several runs", "residual field"],
    );
    assert!(p.get("stop").is_none());
    let names: Vec<String> = tree(&case.out()).into_keys().collect();
    for stem in ["NULL_drift", "NULL_amplitude_density", "NULL_allan_deviation", "NULL_measured_data", "REPORT_NULL"] {
        assert!(names.iter().any(|n| n.contains(stem)), "{stem} is not in {names:?}");
    }
    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
    let checked = calfit().arg("check").arg(case.out().join(FILE)).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
}

/// A line within the band around 1 Hz is a line and no noise, also in a record of a quarter of an hour.
#[test]
fn a_line_in_a_short_record_is_not_in_the_density() {
    let mut run = night();
    run.samples.retain(|s| s.t < 900.0);
    run.settings[0].t_end = 900.0;
    run.samples.iter_mut().for_each(|s| s.reading[0] += 2.0 * (std::f64::consts::TAU * 1.03 * s.t).sin());
    let (case, output) = analysed(&run, &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let p = parameters(&case.out().join(FILE));
    let line = p["line"].as_array_of_tables().unwrap().get(0).unwrap();
    assert!((line["frequency_hz"].as_float().unwrap() - 1.03).abs() < 0.01, "{line}");
    let density = NOISE_ENT * (2.0 / RATE_HZ).sqrt();
    let [found, std] = ["ent_per_root_hz", "std_ent_per_root_hz"].map(|key| number(&p, &format!("density.{key}.0")));
    assert!((found - density).abs() < 3.5 * std && std < 0.1 * density, "{found} ± {std}, not {density}");
}

/// A step of a quarter of the noise of a sample is forty times what half an hour leaves of it; without it the drift describes the record.
#[test]
fn a_step_in_the_record_is_no_drift_without_a_word() {
    let said = |step_ent: f64, at_s: f64| {
        let mut run = night();
        run.samples.iter_mut().filter(|s| s.t > at_s).for_each(|s| s.reading[1] += step_ent);
        text(&analysed(&run, &["--no-plots"]).1.stderr)
    };
    // Wherever it is.
    for at_s in [700.0, 1330.0, 1800.0, 2570.0] {
        let said = said(0.1, at_s);
        says(&said, &["the means of y do not follow a drift of order 1", "a step at about "]);
        let (_, told) = said.split_once("a step at about ").unwrap();
        let told_s: f64 = told.split(' ').next().unwrap().parse().unwrap();
        assert!((told_s - at_s).abs() < 90.0, "{told_s} for {at_s}");
    }
    assert!(!said(0.0, 1800.0).contains("do not follow"));
}

#[test]
fn a_record_that_ends_in_the_night_is_told() {
    let mut run = night();
    run.samples.retain(|s| s.t < 2500.0 && !(1000.0..1200.0).contains(&s.t));
    let (case, output) = analysed(&run, &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["the data end before the setting does", "samples are missing"]);
    let p = parameters(&case.out().join(FILE));
    let stops = p["stop"].as_array_of_tables().unwrap();
    let times = |i: usize| ["from_s", "until_s"].map(|key| stops.get(i).unwrap()[key].as_float().unwrap());
    for (i, wanted) in [[1000.0, 1200.0], [2500.0, 3600.0]].into_iter().enumerate() {
        let found = times(i);
        assert!((found[0] - wanted[0]).abs() < 0.2 && (found[1] - wanted[1]).abs() < 0.2, "{found:?} {wanted:?}");
    }
}

#[test]
fn other_runs_are_refused_with_rule_and_remedy() {
    let case = Case::of(common::good().text());
    let output = calfit().arg("null").arg(case.file()).arg("-o").arg(case.out()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["09-22-38.CCR", "the run is of kind linearity, not zero-field; use `calfit lin`"]);
    let output = case.run("null", &[]);
    assert_eq!(output.status.code(), Some(0));
    says(&text(&output.stderr), &["holds no zero-field run"]);
}

#[test]
fn the_pt1000_table_shows_the_printed_cubic_beside_the_best_one() {
    let case = Case::new();
    let table = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/data/rosetta/pt1000_table.csv");
    // Made of the printed cubic less T_O = -1.5 °C at two voltages.
    let reference = case.put("reference.csv", "u_volt,reference_degc\n1.25,1.7159\n1.25,1.7161\n");
    let output = calfit()
        .args(["thermistor", table, "--order", "3", "--compare=-368.61072,458.49304,-356.02890,180.00644", "--reference"])
        .arg(&reference)
        .arg("-o")
        .arg(case.out())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stdout), &["given  up to 0.6266 °C, best of its order 0.6266 °C", "order 5 is the lowest within 0.01 °C"]);
    let p = parameters(&case.out().join("THERMISTOR__pt1000_table.toml"));
    for (k, printed) in [-368.61072, 458.49304, -356.02890, 180.00644].into_iter().enumerate() {
        assert!((number(&p, &format!("coefficients.{k}")) - printed).abs() < 2e-3, "{k}");
    }
    let raw = -368.61072 + 1.25 * (458.49304 + 1.25 * (-356.02890 + 1.25 * 180.00644));
    assert!((number(&p, "reference.offset_degc") - (raw - 1.716)).abs() < 1e-4);
    let folder = table.trim_end_matches("/pt1000_table.csv");
    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).arg(folder).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}

#[test]
fn damaged_tables_are_refused_with_their_line() {
    let case = Case::new();
    let table = case.put("t.csv", "t_degc,u_volt\n0,1.25\n10,1,27\n");
    let output = calfit().arg("thermistor").arg(&table).arg("-o").arg(case.out()).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["t.csv:3:1", "cells"]);
    assert!(!case.out().exists() || tree(&case.out()).is_empty());
}

#[test]
fn a_linear_calibration_gives_nanotesla() {
    let calibrated = Plan::default().run().named("13-04-03_08-00-00");
    let case = Case::of(night().text());
    case.put("13-04-03/08-00-00.CCR", calibrated.text());
    case.done(&[]);
    let cpf = "13-04-03_08-00-00/PARAMETER_LIN__13-04-03_08-00-00.CPF";
    let cpf = case.out().join(cpf);
    let output = case.run("null", &["--no-plots", "--cpf", cpf.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let p = parameters(&case.out().join(FILE));
    let sigma = common::check::sigma(&parameters(&cpf));
    for (nt, ent) in [
        ("mean_nt", "offset.mean_ent"),
        ("mean_std_nt", "offset.mean_std_ent"),
        ("drift_nt_per_h.0", "offset.drift_ent_per_h.0"),
        ("drift_std_nt_per_h.0", "offset.drift_std_ent_per_h.0"),
        ("nt_per_root_hz", "density.ent_per_root_hz"),
        ("std_nt_per_root_hz", "density.std_ent_per_root_hz"),
    ] {
        for c in 0..3 {
            let (nt, ent) = (number(&p, &format!("scaled.{nt}.{c}")), number(&p, &format!("{ent}.{c}")));
            assert!((nt - sigma[c] * ent).abs() <= 1e-12 * nt.abs(), "{nt} {ent}");
        }
    }
    let report = std::fs::read_to_string(case.out().join("13-04-03_09-22-38/REPORT_NULL__13-04-03_09-22-38.md")).unwrap();
    says(&report, &["With the sensitivities of `PARAMETER_LIN__13-04-03_08-00-00.CPF`", "drift, nT/h", "nT/√Hz"]);
    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}
