//! Diagnosis of frequency runs: silent on runs in which nothing is missing, right on those of the blind generator and of the cases, and
//! the amplitude tables of 2013.

use crate::common;

#[allow(dead_code)]
use crate::study::blind;

use blind::Options;
use blind::kinds::generate;
use blind::noise::Family;
use blind::sensor::Kind;
use calfit::data::plateau::{self, Accumulator, LEAST_COVERAGE, Settling};
use calfit::data::run::VectorSink;
use calfit::diagnose::result::Diagnosis;
use calfit::diagnose::{self, Samples};
use common::check::{Case, calfit, text};
use std::fs;
use std::path::{Path, PathBuf};

fn data(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data").join(name)
}

/// The diagnosis of a run with a hidden truth.
fn diagnosed(seed: u64, options: &Options) -> (Diagnosis, f64) {
    let blind = generate(seed, Kind::Frequency, options).unwrap();
    let (run, vectors) = &blind.runs[0];
    let mut samples = Samples::default();
    vectors.iter().for_each(|v| samples.vector(*v));
    let plateaus = plateau::of_run(run, Accumulator::default(), Settling::Found, LEAST_COVERAGE);
    let made = diagnose::run(run, &plateaus, Some(&samples), &blind.campaign, &diagnose::Options::default()).unwrap();
    (made, blind.truth.effects.first().map_or(0.0, |e| e.strength_k))
}

/// One run per family of noise. A false alarm has a probability of 1 % in each of them: eight runs are silent in 92 of 100 sets of seeds.
#[test]
fn runs_without_effects_are_silent() {
    for (seed, family) in Family::ALL.into_iter().enumerate() {
        let (made, _) = diagnosed(seed as u64, &Options { noise: Some(family), ..Options::default() });
        assert!(made.steps.is_empty(), "{}: {:?}", family.name(), made.steps);
        assert_eq!(made.verdict, "no missing effect");
        assert!(made.not_identifiable.iter().any(|n| n.effect == "facility_angle"));
        assert!(made.detection_limits.iter().any(|d| d.effect == "eddy_current_attenuation"));
    }
}

/// Far above the detection limit every effect is found, and its name stands in the set.
#[test]
fn strong_effects_are_found_and_named() {
    for (seed, effect) in ["eddy_current_attenuation", "response_order", "clock_drift", "lost_samples"].into_iter().enumerate() {
        let options = Options { effects: vec![effect.to_owned()], strength_k: 30.0, noise: Some(Family::White) };
        let (made, strength_k) = diagnosed(seed as u64, &options);
        let step = made.steps.first().unwrap_or_else(|| panic!("{effect} was not found at k = {strength_k}"));
        assert!(step.effect == effect || step.ambiguous_with.iter().any(|a| a == effect), "{effect}: {step:?}");
        if effect != "lost_samples" {
            assert!(step.p_value_corrected < 0.01 && step.gap_after.chi2_per_dof < step.gap_before.chi2_per_dof, "{step:?}");
        }
    }
}

/// A clock that drifts and a pole are two effects and no third one: a pole that stops at the end of its range must not keep a fit from its
/// minimum. Ten times the strength at which a name is certain.
#[test]
fn a_clock_that_drifts_and_a_pole_are_two_effects() {
    for (seed, pole) in ["eddy_current_attenuation", "response_order"].into_iter().cycle().take(4).enumerate() {
        let options =
            Options { effects: vec!["clock_drift".to_owned(), pole.to_owned()], strength_k: 60.0, noise: Some(Family::White) };
        let (made, _) = diagnosed(100 + seed as u64, &options);
        let said: Vec<&str> = made.steps.iter().map(|s| s.effect.as_str()).collect();
        assert!(said.len() == 2 && said.contains(&"clock_drift"), "{pole}: {said:?}");
        let other = made.steps.iter().find(|s| s.effect != "clock_drift").unwrap();
        assert!(other.effect == pole || other.ambiguous_with.iter().any(|a| a == pole), "{pole}: {other:?}");
        assert!(other.strength_k > 10.0, "{other:?}");
    }
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
        assert_eq!(made["verdict"], if expected.is_some() { "1 effect found" } else { "no missing effect" });
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
