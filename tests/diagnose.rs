//! `calfit diagnose` names what was hidden and is silent where nothing was, on runs of an independent generator; `calfit effects`.

use crate::common;

use common::check::{Case, calfit, parameters, process, says, text, three, tree};
use flate2::read::GzDecoder;
use serde_json::Value;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};
use std::process::Output;

/// A diagnosis without optimisation takes a while on a busy machine.
const PATIENCE: std::time::Duration = std::time::Duration::from_secs(600);

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases").join(name)
}

fn truth(case: &str) -> Value {
    serde_json::from_slice(&fs::read(data(&format!("{case}.json"))).unwrap()).unwrap()
}

/// Diagnoses a case into a folder.
fn diagnose(case: &str, out: &Path, arguments: &[&str]) -> Output {
    let file = data(&format!("{case}.CCR.gz"));
    calfit().arg("diagnose").arg(file).arg("-o").arg(out).args(arguments).output().unwrap()
}

/// The diagnosis of a case as it was written.
fn diagnosis(case: &str) -> Value {
    let dir = Case::new();
    let output = diagnose(case, &dir.out(), &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    written(case, &dir.out())
}

fn written(case: &str, out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join(format!("{case}_10-00-00/diagnosis.json"))).unwrap()).unwrap()
}

fn steps(diagnosis: &Value) -> &Vec<Value> {
    diagnosis["steps"].as_array().unwrap()
}

/// Effects of the steps with their axes.
fn named(diagnosis: &Value) -> Vec<(String, String)> {
    let axes = |s: &Value| s["axes"].as_array().unwrap().iter().map(|a| a.as_str().unwrap()).collect::<String>();
    steps(diagnosis).iter().map(|s| (s["effect"].as_str().unwrap().to_owned(), axes(s))).collect()
}

fn is(found: &[(String, String)], wanted: &[(&str, &str)]) {
    let found: Vec<(&str, &str)> = found.iter().map(|(e, a)| (e.as_str(), a.as_str())).collect();
    assert_eq!(found, wanted);
}

/// Value and standard uncertainty of a parameter of a step.
fn parameter(step: &Value, name: &str) -> (f64, f64, String) {
    let all = step["parameters"].as_array().unwrap();
    let found = all.iter().find(|p| p["name"] == name).unwrap_or_else(|| panic!("no {name} in {all:?}"));
    (found["value"].as_f64().unwrap(), found["std"].as_f64().unwrap(), found["unit"].as_str().unwrap().to_owned())
}

/// Within four standard uncertainties, and what the generator leaves open.
#[track_caller]
fn near(step: &Value, name: &str, unit: &str, wanted: f64, open: f64) {
    let (value, std, own) = parameter(step, name);
    assert_eq!(own, unit, "{name}");
    assert!((value - wanted).abs() <= 4.0 * std + open, "{name} = {value} ± {std} is not {wanted}");
}

/// The slow noise of this run hides a drift, which is no effect but has to be said.
#[test]
fn a_report_shows_the_notes_that_the_diagnosis_holds() {
    let (case, dir) = ("26-05-01", Case::new());
    let output = diagnose(case, &dir.out(), &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let found = written(case, &dir.out());
    let [note] = found["warnings"].as_array().unwrap().as_slice() else { panic!("{}", found["warnings"]) };
    let note = note.as_str().unwrap();
    assert!(note.starts_with("the offset of z drifts in order 3 of time, p3 = "), "{note}");
    assert!(text(&output.stderr).contains(note), "{}", text(&output.stderr));
    let folder = dir.out().join(format!("{case}_10-00-00"));
    let page = fs::read_to_string(folder.join(format!("REPORT_DIAGNOSIS__{case}_10-00-00.md"))).unwrap();
    let remarks = page.split_once("## Remarks").unwrap_or_else(|| panic!("{page}")).1;
    assert!(remarks.split("\n## ").next().unwrap().contains(note), "{remarks}");
}

#[test]
fn runs_without_an_effect_are_silent() {
    for case in ["26-05-01", "26-05-05"] {
        let found = diagnosis(case);
        is(&named(&found), &[]);
        assert_eq!(found["verdict"], "no missing effect", "{case}");
        assert!(!found["detection_limits"].as_array().unwrap().is_empty(), "{case}");
    }
}

#[test]
fn a_cubic_of_one_axis_is_named() {
    let found = diagnosis("26-05-02");
    is(&named(&found), &[("cubic_nonlinearity", "x")]);
    let truth = truth("26-05-02");
    // x + c x³ in nT is r + c σ² r³ in enT.
    let sigma = truth["parameters"]["sigma"][0].as_f64().unwrap();
    let c3 = truth["effects"]["cubic_nonlinearity"]["c3_per_nt2"].as_f64().unwrap() * sigma * sigma;
    near(&steps(&found)[0], "c3_x", "enT/enT^3", c3, 0.0);
    // A smooth function of the field along the axis predicts it best.
    assert_eq!((&found["where"][0]["axis"], &found["where"][0]["covariate"]), (&"x".into(), &"field x".into()));
}

/// A case with its rack temperature under a channel that `campaign.toml` names, in a folder of its own.
fn with_rack_channel(case: &str, channel: &str) -> Case {
    let dir = Case::new();
    let mut run = String::new();
    GzDecoder::new(fs::File::open(data(&format!("{case}.CCR.gz"))).unwrap()).read_to_string(&mut run).unwrap();
    dir.put(&format!("{case}/10-00-00.CCR"), run.replace("t,T59,T29,T55", &format!("t,T59,T29,{channel}")));
    dir.put("campaign.toml", format!("rack_temperature_channel = \"{channel}\"\n"));
    dir
}

/// Runs a command on the folder, which must succeed; its messages.
fn on_folder(dir: &Case, command: &str, arguments: &[&str]) -> String {
    let mut calfit = calfit();
    let calfit = calfit.arg(command).arg(dir.campaign()).arg("-o").arg(dir.out()).arg("--no-plots");
    let output = calfit.args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stderr)
}

/// The rack temperature is what the campaign says it is: no thermistor of the sensor, and a covariate like that of the usual channel.
#[test]
fn the_channel_of_the_rack_temperature_is_that_of_the_campaign() {
    let with = |channel: &str| {
        let dir = with_rack_channel("26-05-02", channel);
        on_folder(&dir, "diagnose", &[]);
        let mut found = written("26-05-02", &dir.out());
        found.as_object_mut().unwrap().remove("provenance").unwrap();
        serde_json::from_str::<Value>(&found.to_string().replace(channel, "RACK")).unwrap()
    };
    let (usual, named) = (with("T55"), with("T70"));
    assert_eq!(usual, named);
    assert!(usual["detection_limits"].as_array().unwrap().iter().any(|l| l["effect"] == "rack_temperature"));
}

#[test]
fn a_known_influence_of_the_rack_is_taken_off_by_the_channel_of_the_campaign() {
    let named = with_rack_channel("26-05-04", "T70");
    let model = named.path().join("model.toml").display().to_string();
    on_folder(&named, "diagnose", &["--write-model", &model]);
    let offset = |dir: &Case| {
        let messages = on_folder(dir, "lin", &["--model", &model]);
        assert!(!messages.contains("not taken off"), "{messages}");
        let file = dir.out().join("26-05-04_10-00-00/PARAMETER_LIN__26-05-04_10-00-00.CPF");
        three(&parameters(&file), "offset.b_or_ent")
    };
    assert_eq!(offset(&with_rack_channel("26-05-04", "T55")), offset(&named));
}

#[test]
fn a_transient_is_named_with_its_time_constant() {
    let found = diagnosis("26-05-03");
    is(&named(&found), &[("settling", "xyz")]);
    let truth = &truth("26-05-03")["effects"]["settling"];
    near(&steps(&found)[0], "tau", "s", truth["tau_s"].as_f64().unwrap(), 0.0);
    near(&steps(&found)[0], "fraction", "1", truth["fraction"].as_f64().unwrap(), 0.0);
}

#[test]
fn the_rack_temperature_is_named() {
    let found = diagnosis("26-05-04");
    is(&named(&found), &[("rack_temperature", "xyz")]);
    let truth = &truth("26-05-04")["effects"]["rack_temperature"]["offset_nt_per_k"];
    for (k, axis) in ["x", "y", "z"].iter().enumerate() {
        near(&steps(&found)[0], &format!("offset_{axis}"), "nT/K", truth[k].as_f64().unwrap(), 0.0);
    }
}

#[test]
fn a_sensor_that_follows_its_thermistor_is_named() {
    let found = diagnosis("26-05-06");
    is(&named(&found), &[("thermal_lag", "xyz")]);
    let lag_s = truth("26-05-06")["effects"]["thermal_lag"]["tau_s"].as_f64().unwrap();
    // The file has a reading of the thermistor every 30 s; what lies between two of them is open by half of that.
    near(&steps(&found)[0], "lag", "s", lag_s, 15.0);
    assert_eq!(steps(&found)[0]["form"]["form"], "first order");
}

#[test]
fn two_effects_are_told_apart() {
    let found = diagnosis("26-05-09");
    is(&named(&found), &[("heater_pwm", "xyz"), ("transverse_field", "z")]);
    let all = truth("26-05-09");
    let heater = &all["effects"]["heater_pwm"];
    let step = &steps(&found)[0];
    near(step, "period", "s", heater["period_s"].as_f64().unwrap(), 0.0);
    for (i, axis) in ["x", "y", "z"].iter().enumerate() {
        near(step, &format!("a_{axis}"), "enT", heater["amplitude_ent"][i].as_f64().unwrap(), 0.0);
    }
    // c per nT² of the field is c σ² per enT² of the reading that it makes.
    let sigma = all["parameters"]["sigma"][1].as_f64().unwrap();
    let c = all["effects"]["transverse_field"]["ent_per_nt2"].as_f64().unwrap() * sigma * sigma;
    near(&steps(&found)[1], "c_z_from_y", "enT/enT^2", c, 0.0);
}

#[test]
fn what_the_catalogue_does_not_have_is_told_with_its_covariate_and_shape() {
    let found = diagnosis("26-05-10");
    is(&named(&found), &[("unknown", "z")]);
    let step = &steps(&found)[0];
    assert_eq!(step["covariate"], "field modulus");
    let shape = step["shape"].as_array().unwrap();
    assert!(shape.len() > 3 && shape.iter().all(|p| p["residual_nt"].is_f64() && p["std_nt"].as_f64().unwrap() > 0.0));
    // Most of the disagreement is on that axis before anything is named.
    assert_eq!(found["where"][0]["axis"], "z");
}

#[test]
fn a_diagnosis_has_all_keys_of_its_format() {
    let found = diagnosis("26-05-02");
    let keys = ["format", "version", "runs", "noise_floor_nt", "steps", "not_identifiable", "detection_limits", "verdict"];
    assert!(keys.iter().all(|k| found.get(k).is_some()));
    assert_eq!((found["format"].as_str(), found["version"].as_u64()), (Some("diagnosis"), Some(1)));
    assert_eq!(found["runs"][0], "26-05-02_10-00-00");
    assert_eq!(found["noise_floor_nt"].as_array().unwrap().len(), 3);
    let step = &steps(&found)[0];
    for key in [
        "effect",
        "axes",
        "ambiguous_with",
        "parameters",
        "where",
        "p_value",
        "trials",
        "p_value_corrected",
        "gap_before",
        "gap_after",
        "strength_k",
        "family",
        "next_measurement",
    ] {
        assert!(step.get(key).is_some(), "no {key}");
    }
    for gap in ["gap_before", "gap_after"] {
        assert_eq!(step[gap]["rms_nt"].as_array().unwrap().len(), 3);
        assert!(step[gap]["chi2_per_dof"].is_f64() && step[gap]["max_nt"].is_f64());
    }
    assert!(step["gap_after"]["chi2_per_dof"].as_f64() < step["gap_before"]["chi2_per_dof"].as_f64());
    assert!(found["not_identifiable"].as_array().unwrap().iter().all(|n| n["effect"].is_string() && n["reason"].is_string()));
    let limits = found["detection_limits"].as_array().unwrap();
    assert!(limits.iter().all(|l| l["effect"].is_string() && l["axis"].is_string() && l["amplitude_nt"].as_f64().unwrap() > 0.0));
}

#[test]
fn with_the_written_model_nothing_is_missing_and_results_may_be_written_over() {
    for case in ["26-05-02", "26-05-09"] {
        let dir = Case::new();
        let model = dir.path().join("model.toml");
        let model = model.to_str().unwrap();
        let first = diagnose(case, &dir.out(), &["--no-plots", "--write-model", model]);
        assert_eq!(first.status.code(), Some(0), "{}", text(&first.stderr));
        let second = diagnose(case, &dir.out(), &["--no-plots", "--model", model]);
        assert_eq!(second.status.code(), Some(0), "{}", text(&second.stderr));
        let second = written(case, &dir.out());
        assert_eq!(second["verdict"], "no missing effect", "{case}");
        assert_eq!(second["provenance"]["command"], "calfit diagnose --model model.toml", "{case}");
    }
}

/// Figures and reports included.
#[test]
fn one_thread_and_two_give_the_same_bytes() {
    let with = |threads: &str| {
        let dir = Case::new();
        let mut command = process();
        command.arg("diagnose").arg(data("26-05-09.CCR.gz")).arg("-o").arg(dir.out()).args(["--threads", threads]);
        let output = command.timeout(PATIENCE).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        tree(&dir.out())
    };
    let (one, two) = (with("1"), with("2"));
    let names: Vec<&str> = one.keys().map(|k| k.rsplit('/').next().unwrap()).collect();
    for stem in ["where", "step_1_inside", "step_2", "step_2_evidence", "residuals"] {
        assert!(names.contains(&format!("DIAGNOSIS_{stem}__26-05-09_10-00-00.png").as_str()), "no {stem} in {names:?}");
    }
    assert!(one == two);
    let (_, report) = one.iter().find(|(name, _)| name.ends_with(".md")).unwrap();
    says(&text(report), &["## Where the data disagree", "## Step 1: heater_pwm", "Figure 1: ", "## Detection limits"]);
}

fn effects(arguments: &[&str]) -> Output {
    calfit().arg("effects").args(arguments).output().unwrap()
}

#[test]
fn the_catalogue_is_listed_and_every_effect_explained() {
    let listed: Value = serde_json::from_slice(&effects(&["--json"]).stdout).unwrap();
    let listed = listed.as_array().unwrap();
    // The 29 names of the contract, and the jump of the sensitivity.
    assert_eq!(listed.len(), 30);
    let plain = text(&effects(&[]).stdout);
    for effect in listed {
        let id = effect["effect"].as_str().unwrap();
        says(&plain, &[id, effect["summary"].as_str().unwrap(), effect["seen_in"].as_str().unwrap()]);
        let output = effects(&[id]);
        assert_eq!(output.status.code(), Some(0), "{id}");
        says(&text(&output.stdout), &[id, effect["formula"].as_str().unwrap(), effect["best_measurement"].as_str().unwrap()]);
    }
}

/// The example's points as (covariate, contribution on an axis).
fn signature(id: &str, axis: usize) -> Vec<(f64, f64)> {
    let explained: Value = serde_json::from_slice(&effects(&[id, "--json"]).stdout).unwrap();
    let points = explained["example"]["points"].as_array().unwrap().clone();
    points.iter().map(|p| (p["covariate"].as_f64().unwrap(), p["contribution_nt"][axis].as_f64().unwrap())).collect()
}

#[test]
fn signatures_are_those_of_the_formulas() {
    // 1 nT in the largest field of 2000 nT.
    let cubic = signature("cubic_nonlinearity", 0);
    assert!(cubic.len() > 50 && cubic.iter().all(|(b, y)| (y - (b / 2000.0).powi(3)).abs() < 1e-12), "{cubic:?}");
    // Exponential with 0.8 s; the first step is from nothing to nothing and the remains of one step are e^-6.
    let settling = signature("settling", 0);
    let first = settling.iter().find(|(t, y)| *t == 0.0 && *y != 0.0).unwrap().1;
    let after: Vec<&(f64, f64)> = settling.iter().filter(|(t, y)| *t < 1.0 && *y != 0.0).collect();
    assert!(after.len() > 100);
    assert!(after.iter().all(|(t, y)| (y.abs() - first.abs() * (-t / 0.8).exp()).abs() < 0.01), "{after:?}");
}

#[test]
fn the_picture_of_an_effect_is_drawn_where_it_is_wanted() {
    let dir = Case::new();
    let out = dir.out();
    let drawn = effects(&["heater_pwm", "-o", out.to_str().unwrap()]);
    assert_eq!(drawn.status.code(), Some(0), "{}", text(&drawn.stderr));
    let names: Vec<String> = tree(&out).into_keys().collect();
    assert_eq!(names, ["EFFECT_heater_pwm_covariate.png", "EFFECT_heater_pwm_time.png"]);
    let none = effects(&["facility_angle", "-o", out.to_str().unwrap()]);
    says(&text(&none.stderr), &["no picture", "several positions"]);
    let unknown = effects(&["cubic_linearity"]);
    assert_eq!(unknown.status.code(), Some(2));
    says(&text(&unknown.stderr), &["cubic_linearity", "no effect of the catalogue", "cubic_nonlinearity", "calfit effects"]);
}
