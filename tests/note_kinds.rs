//! Programs read what is wrong with a run from the kinds of its notes, whatever kind the run is of.

use crate::common;

use common::check::{Case, text};
use common::{Plan, Run, Setting, offset_fields, programme, sines};
use serde_json::Value;

/// The parameters of a run as `--json` prints them, and the kinds of its notes.
#[track_caller]
fn found(run: &Run, command: &str, options: &[&str]) -> (Value, Vec<String>) {
    let output = Case::of(run.text()).run(command, &[&["--no-plots", "--json"], options].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let view: Value = serde_json::from_slice(&output.stdout).unwrap();
    let parameters = view["runs"][0]["parameters"].clone();
    let list = |key: &str| parameters[key].as_array().cloned().unwrap_or_default();
    assert_eq!(list("warnings").len(), list("warning_kinds").len());
    let kinds = list("warning_kinds").iter().map(|k| k.as_str().unwrap().to_owned()).collect();
    (parameters, kinds)
}

#[track_caller]
fn has(run: &Run, command: &str, options: &[&str], kind: &str) {
    let (parameters, kinds) = found(run, command, options);
    assert!(kinds.iter().any(|k| k == kind), "{kind} is not among {kinds:?}: {}", parameters["warnings"]);
}

/// Levels up and down again, so that a moment in time is no level of the field.
fn linearity() -> Run {
    let levels = [-2000.0, -800.0, 400.0, 1200.0, 2000.0, 1600.0, -400.0, -1200.0];
    Plan { settings: programme(&levels, 2.0), ..Plan::default() }.run()
}

fn quiet() -> Run {
    let settings = vec![Setting::constant(0.0, 120.0, [0.0; 3], 1)];
    Plan { settings, rate_hz: 32.0, ..Plan::default() }.run().key("kind", "\"zero-field\"")
}

/// The readings of the part of a run from `from` on, times a factor.
fn amplified(mut run: Run, from: f64, factor: f64) -> Run {
    let first = (from * run.samples.len() as f64) as usize;
    run.samples[first..].iter_mut().for_each(|s| s.reading = s.reading.map(|v| factor * v));
    run
}

#[test]
fn runs_without_damage_have_no_notes_about_readings() {
    assert_eq!(found(&linearity(), "lin", &[]).1, Vec::<String>::new());
    // Its few temperatures are none of the readings.
    assert!(found(&quiet(), "null", &[]).1.iter().all(|kind| kind == "temperature"));
}

#[test]
fn axes_are_of_a_kind_of_their_own() {
    has(&linearity().reverse(1), "lin", &[], "reversed_axis");
    has(&linearity().swap(0, 2), "lin", &[], "swapped_axes");
}

#[test]
fn what_was_allowed_is_told() {
    has(&linearity().each(|r| r.map(|v| 2.0 * v)), "lin", &["--allow", "gain"], "gain");
    let mut other = linearity();
    let fields: Vec<[f64; 3]> = other.settings.iter().map(|s| s.field).collect();
    let count = fields.len();
    other.settings.iter_mut().enumerate().for_each(|(i, s)| s.field = fields[(count - i) % count]);
    has(&other, "lin", &["--allow", "mismatch", "--allow", "gain"], "mismatch");
}

#[test]
fn a_gain_that_jumps_inside_a_run_is_named() {
    has(&amplified(linearity(), 0.45, 1.001), "lin", &[], "gain_jump");
    let run =
        Plan { settings: sines(&[1.0, 3.0, 8.0, 20.0, 50.0], 1000.0), ..Plan::default() }.run().key("kind", "\"frequency\"");
    // Inside the third of the five sines.
    has(&amplified(run, 0.5, 1.002), "freq", &[], "gain_jump");
}

#[test]
fn losses_and_spikes_are_named() {
    let all = linearity();
    let third = all.samples_of(9);
    has(&linearity().lose(third.start + 10..third.start + 12), "lin", &[], "losses");
    has(&linearity().spike(third.start + 120, 0, 500.0), "lin", &[], "spikes");
}

#[test]
fn a_cell_of_a_long_record_that_cannot_be_does_not_become_its_mean() {
    let (undamaged, _) = found(&quiet(), "null", &[]);
    for (place, by_ent) in [(0, 1e6), (777, 1e29), (1500, 30.0), (3839, -200.0)] {
        let damaged = quiet().spike(place, 1, by_ent);
        has(&damaged, "null", &[], "spikes");
        let (parameters, _) = found(&damaged, "null", &[]);
        let value = |of: &Value, key: &str| of["offset"][key][1].as_f64().unwrap();
        let off = (value(&parameters, "mean_ent") - value(&undamaged, "mean_ent")).abs();
        assert!(off < value(&undamaged, "mean_std_ent"), "{place}: the mean is off by {off}");
        let density = |of: &Value| of["density"]["ent_per_root_hz"][1].as_f64().unwrap();
        assert!((density(&parameters) / density(&undamaged) - 1.0).abs() < 0.05, "{place}");
    }
}

#[test]
fn a_component_that_stands_still_for_a_while_is_stuck() {
    let mut run = quiet();
    run.samples[2000..].iter_mut().for_each(|s| s.reading[2] = 12.5);
    has(&run, "null", &[], "stuck");
}

#[test]
fn an_offset_run_in_another_unit_is_refused() {
    for factor in [2.0, 0.5] {
        let fields = offset_fields();
        let positions = common::POSITIONS;
        let plan = Plan {
            settings: common::in_positions(&[1, 2, 3, 4], &fields, 2.0),
            positions: positions.to_vec(),
            ..Plan::default()
        };
        let case = Case::of(plan.run().key("kind", "\"offset\"").each(|r| r.map(|v| factor * v)).text());
        let table = common::position_table(&positions);
        case.put("campaign.toml", format!("name = \"n\"\ninstrument = \"i\"\n{table}"));
        let output = case.run("offset", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(1), "{factor}: {}", text(&output.stderr));
        common::check::says(&text(&output.stderr), &["responds with", "--allow mismatch"]);
    }
}
