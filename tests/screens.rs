//! Damage that a run itself shows is refused or told in every kind of run with applied fields, not in linearity runs alone.

use crate::common;

use common::check::{Case, calfit, refused, says, text};
use common::{Plan, Run, Setting, programme, sines, with_rows};

/// 360 settings of 1000 nT in all directions, a second each, while the sensor warms up by 80 K.
fn sweep() -> Run {
    let field = |i: usize| {
        let (u, v) = ((i * 137 % 360) as f64 / 360.0, (i * 61 % 360) as f64 / 360.0);
        let (z, angle) = (2.0 * u - 1.0, std::f64::consts::TAU * v);
        let r = (1.0 - z * z).sqrt();
        [1000.0 * r * angle.cos(), 1000.0 * r * angle.sin(), 1000.0 * z].map(f64::round)
    };
    let settings = (0..360).map(|i| Setting::constant(i as f64, i as f64 + 1.0, field(i), 1)).collect();
    let mut run = Plan { settings, rate_hz: 8.0, ..Plan::default() }.run().key("kind", "\"sweep\"");
    run.temperatures = (0..=36).map(|i| (10.0 * f64::from(i), [Some(20.0), Some(-20.0 + 80.0 * f64::from(i) / 36.0)])).collect();
    run
}

/// The messages of `calfit thermal` about a run that it may not pass over in silence, and its status.
fn thermal(run: &Run) -> (Option<i32>, String) {
    let output = Case::of(run.text()).run("thermal", &["--no-plots"]);
    (output.status.code(), text(&output.stderr))
}

#[test]
fn a_sweep_without_damage_is_done_without_a_word_about_its_readings() {
    let (status, told) = thermal(&sweep());
    assert_eq!(status, Some(0), "{told}");
    assert!(!told.contains("AXES") && !told.contains("follow the applied field"), "{told}");
}

/// Readings under two ids are those of one measurement.
#[test]
fn check_tells_a_run_whose_readings_are_those_of_another() {
    let run = include_str!("../runs/sample/26-01-15/09-00-00.CCR");
    let checked = |other: String| {
        let case = Case::new();
        case.put("26-01-15/09-00-00.CCR", run);
        case.put("26-01-16/09-00-00.CCR", other);
        let output = calfit().arg("check").arg(case.campaign()).output().unwrap();
        (output.status.code(), text(&output.stdout) + &text(&output.stderr))
    };
    let copy = run.replace("26-01-15", "26-01-16").replace("2026-01-15", "2026-01-16");
    let (status, messages) = checked(copy.clone());
    assert_eq!(status, Some(0), "{messages}");
    says(&messages, &["26-01-16/09-00-00.CCR: holds the same readings as", "it would count twice"]);
    // One reading that differs in its last digit makes another run, most of whose readings are those of the first all the same.
    let other = copy.replace(",-9.912\n@END", ",-9.913\n@END");
    assert_ne!(other, copy);
    let (_, messages) = checked(other);
    assert!(!messages.contains("same readings"), "{messages}");
    says(&messages, &["100 % of its readings stand in ", "both are of one recording"]);
}

/// A second export of a run that lacks its last second, and a run that begins before the one before it ends.
#[test]
fn check_tells_runs_that_share_readings_or_overlap() {
    let run = include_str!("../runs/sample/26-01-15/09-00-00.CCR");
    let checked = |files: &[(&str, String)]| {
        let case = Case::new();
        files.iter().for_each(|(name, content)| drop(case.put(name, content)));
        let output = calfit().arg("check").arg(case.campaign()).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stdout) + &text(&output.stderr)
    };
    let lines: Vec<&str> = run.lines().collect();
    let (end, rows) = lines.split_last().unwrap();
    let shorter = format!("{}\n{end}\n", rows[..rows.len() - 128].join("\n"));
    let again = shorter.replace("26-01-15", "26-01-16").replace("2026-01-15", "2026-01-16");
    let messages = checked(&[("26-01-15/09-00-00.CCR", run.to_owned()), ("26-01-16/09-00-00.CCR", again)]);
    says(&messages, &["26-01-16/09-00-00.CCR: 100 % of its readings stand in ", "it would count twice"]);
    assert!(!messages.contains("of the same sensor goes on"), "{messages}");
    // Other readings, half a minute after the start of the first.
    let turned = with_rows(run, "@VECTORS", |cells| match cells {
        [n, t, x, y, z] if *x != "x" => format!("{n},{t},{},{y},{z}", x.parse::<f64>().unwrap() + 0.001),
        _ => cells.join(","),
    });
    let turned = turned.replace("26-01-15_09-00-00", "26-01-15_09-00-30").replace("T09:00:00", "T09:00:30");
    let messages = checked(&[("26-01-15/09-00-00.CCR", run.to_owned()), ("26-01-15/09-00-30.CCR", turned)]);
    says(&messages, &["26-01-15/09-00-30.CCR: begins while ", "26-01-15/09-00-00.CCR of the same sensor goes on"]);
    assert!(!messages.contains("stand in"), "{messages}");
}

#[test]
fn a_sweep_in_another_unit_is_refused() {
    for factor in [1000.0, 1e-3, 10.0, 2.0, 0.5] {
        let (status, told) = thermal(&sweep().each(|r| r.map(|v| factor * v)));
        assert_eq!(status, Some(1), "{factor}: {told}");
        says(&told, &["sensitivity of component x", "nominal_factor", "--allow gain"]);
    }
}

#[test]
fn a_sweep_with_components_exchanged_or_reversed_is_told() {
    for (damaged, words) in [
        (sweep().reverse(0), ["component x looks along the nominal -x axis", "left-handed"]),
        (sweep().swap(0, 1), ["component x looks along the nominal +y axis", "component y looks along the nominal +x axis"]),
        (
            sweep().reverse(0).reverse(1).reverse(2),
            ["component x looks along the nominal -x axis", "component z looks along the nominal -z axis"],
        ),
    ] {
        says(&thermal(&damaged).1, &words);
    }
}

#[test]
fn a_sweep_with_settings_of_another_run_is_refused() {
    // The fields of the settings are those of the settings after them.
    let mut shifted = sweep();
    let fields: Vec<[f64; 3]> = shifted.settings.iter().map(|s| s.field).collect();
    let count = fields.len();
    for (i, setting) in shifted.settings.iter_mut().enumerate() {
        setting.field = fields[(i + 1) % count];
    }
    let (status, told) = thermal(&shifted);
    assert_eq!(status, Some(1), "{told}");
    assert!(told.contains("does not follow the applied field") || told.contains("do not step where the settings do"), "{told}");
}

#[test]
fn a_stuck_component_is_called_that() {
    let (status, told) = thermal(&sweep().stick(0, 123.4));
    assert_eq!(status, Some(1), "{told}");
    says(&told, &["component x is stuck at 123.4"]);
    refused(Plan::default().run().stick(0, 123.4).text(), &[]).by_analysis().says(&["component x is stuck at 123.4"]);
}

#[test]
fn a_gain_that_is_allowed_is_used() {
    let doubled = sweep().each(|r| r.map(|v| 2.0 * v));
    let output = Case::of(doubled.text()).run("thermal", &["--no-plots", "--allow", "gain"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[test]
fn sines_in_another_unit_are_refused() {
    let plan = Plan { settings: sines(&[1.0, 3.0, 8.0, 20.0, 70.0], 1000.0), ..Plan::default() };
    let run = || plan.run().key("kind", "\"frequency\"");
    let measured = |run: &Run, options: &[&str]| {
        let output = Case::of(run.text()).run("freq", &[&["--no-plots"], options].concat());
        (output.status.code(), text(&output.stderr))
    };
    assert_eq!(measured(&run(), &[]).0, Some(0));
    for factor in [1000.0, 1e-3, 10.0] {
        let damaged = run().each(|r| r.map(|v| factor * v));
        let (status, told) = measured(&damaged, &[]);
        assert_eq!(status, Some(1), "{factor}: {told}");
        says(&told, &["enT per nT, far from 1", "nominal_factor"]);
    }
    let allowed = run().each(|r| r.map(|v| 10.0 * v));
    assert_eq!(measured(&allowed, &["--allow", "gain"]).0, Some(0));
}

#[test]
fn a_mistyped_frequency_is_left_out_at_once() {
    let mut run =
        Plan { settings: sines(&[1.0, 3.0, 8.0, 20.0, 70.0], 1000.0), ..Plan::default() }.run().key("kind", "\"frequency\"");
    run.settings[2].frequency = 99_999_999.0;
    let output = Case::of(run.text()).run("freq", &["--no-plots"]);
    says(&text(&output.stderr), &["99999999 Hz was refused", "times the sample rate"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[test]
fn a_stuck_component_of_a_zero_field_run_is_told() {
    let quiet = Plan { settings: vec![Setting::constant(0.0, 60.0, [0.0; 3], 1)], ..Plan::default() };
    let run = quiet.run().key("kind", "\"zero-field\"");
    let told = |run: &Run| text(&Case::of(run.text()).run("null", &["--no-plots"]).stderr);
    assert!(!told(&run).contains("stuck"));
    says(&told(&run.stick(0, 123.4)), &["component x is stuck at 123.4"]);
}

#[test]
fn a_moving_run_with_settings_of_another_is_refused() {
    let mut run = Plan { settings: programme(&[-2000.0, -1200.0, -400.0, 400.0, 1200.0, 2000.0], 2.0), ..Plan::default() }.run();
    let end = run.settings.last().map_or(0.0, |s| s.t_end);
    run.temperatures = (0..=20).map(|i| (end * f64::from(i) / 20.0, [Some(20.0), Some(10.0 + f64::from(i))])).collect();
    let fields: Vec<[f64; 3]> = run.settings.iter().map(|s| s.field).collect();
    let count = fields.len();
    for (i, setting) in run.settings.iter_mut().enumerate() {
        setting.field = fields[(i + 7) % count];
    }
    refused(run.text(), &[]).by_analysis();
}
