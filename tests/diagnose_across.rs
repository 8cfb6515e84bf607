//! Several runs together: what the facility gets wrong is named from runs in several orientations, and nothing where nothing is wrong.

use calfit::diagnose::across::{RunValues, across};
use calfit::files::orientations;
use calfit::model::effects::Catalogue;
use calfit::model::facility_calibration::SensorValues;
use calfit::model::position::Position;
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use std::path::Path;

fn champ() -> Vec<RunValues> {
    let table = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/champ/runs_ambient.csv");
    let (rows, _) = orientations::read(&table, &mut Vec::new()).unwrap();
    rows.iter().map(|row| RunValues::of_row(row, "runs_ambient")).collect()
}

/// CH-GFZ-TR-2601, Appendix A: four orientations of one sensor that differ by up to 9.5 nT in an offset. First-order least squares by
/// hand over the means of the orientations (numpy) leaves 2.09 of 3.28 nT of the offsets, 7.8e-6 of 1.17e-5 of the sensitivities and
/// 7.7e-4 of 1.34e-3 degrees of the angles with all four; 0.48 nT, 5.5e-6 and 4.3e-4 degrees without run 17.
#[test]
fn runs_of_champ_name_the_facility_and_that_an_orientation_does_not_agree() {
    let runs: Vec<RunValues> = champ();
    let found = across(&runs, &Catalogue::default()).unwrap();
    // Run 15 is the only one of another sensor, run 18 has no orientation.
    assert_eq!(found.runs.len(), 13);
    let names: Vec<&str> = found.steps.iter().map(|s| s.effect.as_str()).collect();
    for name in ["facility_scale", "facility_offset", "facility_angle"] {
        assert!(names.contains(&name), "{names:?}");
    }
    // Which orientation stands out depends on whether runs or orientations count once; that one does is the same for both.
    let alone = found.steps.iter().find(|s| s.effect == "unknown").expect("an orientation stands out");
    assert!(alone.form.form.starts_with("orientation"), "{}", alone.form.form);
    assert!(found.not_identifiable.iter().any(|e| e.effect == "facility_scale" && e.reason.contains("common scale")));
    // What remains exceeds the repeats, and is said.
    assert!(found.notes.iter().any(|n| n.text.contains("still differ")), "{:?}", found.notes);
    assert!(found.steps.iter().all(|s| s.p_value_corrected < 0.01 && s.gap_after.chi2_per_dof < s.gap_before.chi2_per_dof));
    // The chance that noise gives any of many candidates as much is no less than that of one, and the verdict says how little is left where
    // repeats of an orientation count once.
    assert!(found.steps.iter().all(|s| s.p_value_corrected >= s.p_value), "{:?}", found.steps);
    assert!(found.verdict.contains("consistent with facility_angle"), "{}", found.verdict);
    assert!(found.verdict.contains("where every orientation counts once, noise alone gives as much"), "{}", found.verdict);
    // The figure of a step shows a value that gains by it, with the names of the runs.
    let square = |values: &[f64]| values.iter().map(|v| v * v).sum::<f64>();
    for map in &found.maps {
        assert!(square(&map.after_nt) < square(&map.before_nt), "step {}: {map:?}", map.step + 1);
        assert_eq!(map.names.last().map(String::as_str), Some("17"));
    }
    assert_eq!(alone.shape_names.len(), alone.shape.len());
}

/// Runs without repeats whose parameters are drawn with known uncertainties.
fn drawn(seed: u64, orientations: &[&str], repeats: usize, wrong: &dyn Fn(&mut SensorValues, &Position)) -> Vec<RunValues> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
    let mut normal = move || -> f64 { StandardNormal.sample(&mut random) };
    let std = SensorValues { scale: [2e-6; 3], offset_nt: [0.01; 3], angles_deg: [1e-4; 3] };
    let mut runs = Vec::new();
    for (o, axes) in orientations.iter().enumerate() {
        for repeat in 0..repeats {
            let position = Position::from_orientation(axes).unwrap();
            let mut values =
                SensorValues { scale: [1.01, 0.99, 1.0], offset_nt: [5.0, -3.0, 1.0], angles_deg: [90.2, 89.8, 90.0] };
            wrong(&mut values, &position);
            for i in 0..3 {
                values.scale[i] += std.scale[i] * normal();
                values.offset_nt[i] += std.offset_nt[i] * normal();
                values.angles_deg[i] += std.angles_deg[i] * normal();
            }
            runs.push(RunValues {
                run: format!("{o}-{repeat}"),
                sensor: "DUT".to_owned(),
                set: "one".to_owned(),
                position,
                time: Some(86400.0 * (o * repeats + repeat) as f64),
                sensor_degc: None,
                coil_degc: None,
                field_nt: Some(2000.0),
                values,
                std: Some(std),
                freedom: 60.0,
            });
        }
    }
    runs
}

/// An offset field of the facility of (0.2, -0.1, 0.15) nT comes back within four of its standard uncertainties; 0.01 nT per value
/// make it twenty times the noise.
#[test]
fn an_offset_field_comes_back() {
    let field = [0.2, -0.1, 0.15];
    let runs = drawn(7, &["+X +Y +Z", "-Y +X +Z", "-Z +Y +X", "-Z +X -Y"], 2, &|v, p| {
        for i in 0..3 {
            let (k, sign) = p.along(i);
            v.offset_nt[i] += sign * field[k];
        }
    });
    let found = across(&runs, &Catalogue::default()).unwrap();
    assert_eq!(found.steps.len(), 1, "{}", found.verdict);
    let step = &found.steps[0];
    assert_eq!(step.effect, "facility_offset");
    for (k, parameter) in step.parameters.iter().enumerate() {
        assert!((parameter.value - field[k]).abs() < 4.0 * parameter.std.unwrap(), "{parameter:?}");
    }
    assert!(step.gap_after.chi2_per_dof < 0.1 * step.gap_before.chi2_per_dof);
}

/// One orientation cannot show the facility, and that is said.
#[test]
fn one_orientation_shows_no_facility() {
    let found = across(&drawn(3, &["+X +Y +Z"], 5, &|_, _| ()), &Catalogue::default()).unwrap();
    for id in ["facility_scale", "facility_offset", "facility_angle"] {
        assert!(found.not_identifiable.iter().any(|e| e.effect == id && e.reason.contains("one orientation")));
    }
    assert!(across(&drawn(3, &["+X +Y +Z"], 1, &|_, _| ()), &Catalogue::default()).is_err());
}

/// A run that stands out among repeats is named, and the others are not blamed.
#[test]
fn a_run_that_stands_out_is_named() {
    let mut runs = drawn(11, &["+X +Y +Z", "-Y +X +Z", "-Z +Y +X"], 4, &|_, _| ());
    runs[5].values.offset_nt = runs[5].values.offset_nt.map(|v| v + 0.2);
    let found = across(&runs, &Catalogue::default()).unwrap();
    assert_eq!(found.steps.len(), 1, "{}", found.verdict);
    assert_eq!(found.steps[0].form.form, "run 1-1");
}
