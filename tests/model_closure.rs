//! What a model says is in a run is not missing: a measured run simulated once more with effects of a model, and diagnosed with it.

use crate::common;

use calfit::data::provenance::Provenance;
use calfit::data::recipe::Recipe;
use calfit::files::parameter::{self, Cpf, Model, ModelEffect, ModelParameter};
use common::check::{Case, calfit, data, text};
use flate2::read::GzDecoder;
use serde_json::Value;
use std::fs;
use std::io::Read;
use std::path::{Path, PathBuf};

const RUN: &str = "26-05-01_10-00-00";

/// One effect: id, form, axes, linear parameters and shape parameters with their units.
type Said = (&'static str, &'static str, &'static str, &'static [Value3], &'static [Value3]);
type Value3 = (&'static str, f64, &'static str);

/// Effects of all families that a linearity run shows, each ten to thirty times the noise, in models whose effects are told from each other.
const MODELS: [&[Said]; 3] = [
    &[
        ("cubic_nonlinearity", "cubic", "x", &[("c3_x", 5e-11, "enT/enT^3")], &[]),
        ("coil_temperature", "per axis", "y", &[("alpha_y", 3e-4, "1/K")], &[]),
        ("rack_temperature", "offset", "z", &[("offset_z", 0.05, "nT/K")], &[]),
        ("remanence", "own axis", "x", &[("c_x", 1e-4, "enT/enT")], &[]),
        ("offset_step", "step", "y", &[("c_y", 0.2, "enT")], &[("onset", 300.0, "s")]),
        ("time_shift", "edges", "xyz", &[("part", 1.0, "1")], &[("shift", 0.2, "s")]),
    ],
    &[
        ("quadratic_nonlinearity", "quadratic", "y", &[("c2_y", 6e-8, "enT/enT^2")], &[]),
        ("transverse_field", "odd", "x", &[("c_x_from_y", 4e-10, "enT/enT^3")], &[("from", 1.0, "sensor axis, 0 to 2")]),
        ("sensor_temperature_sensitivity", "linear", "z", &[("a_z", 1e-3, "1/K")], &[]),
        ("earthfield_leakage", "own axis", "x", &[("kappa_x", 0.1, "nT/nT")], &[]),
        ("settling", "exponential", "xyz", &[("fraction", 3e-4, "1")], &[("tau", 0.8, "s")]),
    ],
    &[
        ("saturation", "knee", "z", &[("c_z", 4e-4, "enT/enT")], &[("onset", 1500.0, "enT")]),
        ("rotation_drift", "time", "x", &[("theta_x", 4e-4, "rad")], &[]),
        ("offset_drift", "cycle", "x", &[("s_x", 0.1, "enT"), ("c_x", 0.05, "enT")], &[("period", 300.0, "s")]),
        ("heater_pwm", "square", "y", &[("a_y", 0.2, "enT")], &[("period", 3.3, "s"), ("duty", 0.4, "1"), ("delay", 0.5, "s")]),
    ],
];

fn entry((id, form, axes, values, shape): &Said) -> ModelEffect {
    let all = |list: &[Value3]| -> Vec<ModelParameter> {
        let one = |(name, value, unit): &Value3| ModelParameter {
            name: (*name).to_owned(),
            value: *value,
            std: None,
            unit: (*unit).to_owned(),
        };
        list.iter().map(one).collect()
    };
    ModelEffect {
        id: (*id).to_owned(),
        form: (*form).to_owned(),
        axes: axes.chars().map(String::from).collect(),
        run: Some(RUN.to_owned()),
        reading_ent: None,
        parameter: all(values),
        shape: all(shape),
    }
}

fn done(arguments: &[&Path]) -> String {
    let output = calfit().args(arguments).arg("--no-plots").output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stderr)
}

fn named(run: &Path, out: &Path, model: Option<&Path>) -> (String, Vec<String>) {
    let mut arguments = vec![Path::new("diagnose"), run, Path::new("--force"), Path::new("-o"), out];
    arguments.extend(model.into_iter().flat_map(|m| [Path::new("--model"), m]));
    done(&arguments);
    let found: Value = serde_json::from_slice(&fs::read(out.join(RUN).join("diagnosis.json")).unwrap()).unwrap();
    let steps = found["steps"].as_array().unwrap().iter().map(|s| s["effect"].as_str().unwrap().to_owned()).collect();
    (found["verdict_kind"].as_str().unwrap().to_owned(), steps)
}

/// Sensitivities of a linear calibration with their standard uncertainties.
fn sigma(file: &Path) -> [[f64; 2]; 3] {
    let calibration = parameter::read::<Cpf>(file).unwrap().body.calibration;
    std::array::from_fn(|i| [calibration.matrix.sigma[i][i], calibration.std.sigma[i]])
}

#[test]
fn what_a_model_brings_into_a_simulated_run_the_diagnosis_takes_out_with_it() {
    let case = Case::new();
    let measured = case.path().join("26-05-01").join("10-00-00.CCR");
    fs::create_dir_all(measured.parent().unwrap()).unwrap();
    let mut run = Vec::new();
    GzDecoder::new(fs::File::open(data("tests/data/cases/26-05-01.CCR.gz")).unwrap()).read_to_end(&mut run).unwrap();
    fs::write(&measured, run).unwrap();
    let out = case.out();
    done(&[Path::new("lin"), &measured, Path::new("-o"), &out]);
    let of_run = |out: &Path| -> PathBuf { out.join(RUN).join(format!("PARAMETER_LIN__{RUN}.CPF")) };
    for (k, effects) in MODELS.iter().enumerate() {
        let model = Model {
            sensor: None,
            mode: None,
            used: vec![RUN.to_owned()],
            convention: "as printed".to_owned(),
            effect: effects.iter().map(entry).collect(),
        };
        let model_text = parameter::to_text(&model, &Provenance::new(Recipe::plain("diagnose"), Vec::new())).unwrap();
        let model = case.path().join(format!("model_{k}.toml"));
        fs::write(&model, model_text).unwrap();
        let twin = case.path().join(format!("twin_{k}"));
        let simulate = ["simulate", "--like"].map(Path::new);
        let parameters = of_run(&out);
        let rest: [&Path; 6] = [Path::new("--parameters"), &parameters, Path::new("--model"), &model, Path::new("-o"), &twin];
        done(&[&simulate[..], &[measured.as_path()], &rest].concat());
        let simulated = twin.join("26-05-01/10-00-00.CCR");
        let results = case.path().join(format!("out_{k}"));
        let (kind, steps) = named(&simulated, &results, None);
        assert!(kind == "found" && steps.len() >= 2, "without model {k}: {steps:?}");
        let (kind, steps) = named(&simulated, &results, Some(&model));
        assert!(kind == "none" && steps.is_empty(), "with model {k}: {kind} {steps:?}");
        done(&[Path::new("lin"), &simulated, Path::new("--model"), &model, Path::new("-o"), &results]);
        for (axis, (known, found)) in sigma(&of_run(&out)).iter().zip(sigma(&of_run(&results))).enumerate() {
            assert!(
                (found[0] - known[0]).abs() < 4.0 * found[1],
                "sigma {axis} with model {k}: {found:?}, simulated with {known:?}"
            );
        }
    }
}
