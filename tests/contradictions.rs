//! Results of one campaign that contradict each other are told, whatever analyses they come from.

use crate::common;

use common::campaign::{self, TEMPERATURES_DEGC, id};
use common::check::{Case, says, text};
use common::with_rows;
use std::fs;
use std::path::PathBuf;

/// What a difference is told with.
const TOLD: &str = "standard uncertainties of the difference";

fn file(case: &Case, hour: usize, index: usize) -> PathBuf {
    case.campaign().join(format!("{}.CCR", id(hour, index).replace('_', "/")))
}

/// The campaign without its sweep, in which the sensor does not follow the temperature.
fn sound() -> Case {
    let case = Case::new();
    campaign::write(&case);
    fs::remove_file(file(&case, 12, 0)).unwrap();
    case
}

/// Changes the readings of a run: component after component.
fn change(case: &Case, hour: usize, index: usize, of: impl Fn(usize, f64) -> f64) {
    let path = file(case, hour, index);
    let changed = with_rows(&fs::read_to_string(&path).unwrap(), "@VECTORS", |cells| {
        let row = cells.iter().enumerate().map(|(k, cell)| match (k.checked_sub(2), cell.parse::<f64>()) {
            (Some(component), Ok(value)) if component < 3 => format!("{:.5}", of(component, value)),
            _ => (*cell).to_owned(),
        });
        row.collect::<Vec<_>>().join(",")
    });
    fs::write(&path, changed).unwrap();
}

/// The lines of a report that tell differences.
fn told(case: &Case) -> Vec<String> {
    let output = case.run("report", &["--no-plots", "--order", "b_or=2", "--order", "b_off=2"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let lines: Vec<String> = text(&output.stderr).lines().filter(|line| line.contains(TOLD)).map(str::to_owned).collect();
    let page = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    assert_eq!(page.contains(TOLD), !lines.is_empty(), "{lines:?}");
    lines
}

#[test]
fn a_sound_campaign_does_not_contradict_itself() {
    assert_eq!(told(&sound()), [""; 0]);
}

/// A sensor that does not follow the temperature during the sweep, and does between the runs.
#[test]
fn a_sweep_that_contradicts_the_runs_is_told() {
    let case = Case::new();
    campaign::write(&case);
    let told = told(&case);
    let [line] = told.as_slice() else { panic!("{told:?}") };
    says(
        line,
        &["sigma_", " °C of the runs 13-04-03_08-00-00 to 13-04-06_08-00-00 and of the sweep 13-04-03_12-00-00 differ by"],
    );
}

/// An offset that is 10 enT larger in x in one offset run, and a zero-field run in µT.
#[test]
fn offsets_that_differ_are_told() {
    let case = sound();
    change(&case, 9, 1, |component, reading| reading + if component == 0 { 10.0 } else { 0.0 });
    change(&case, 11, 0, |_, reading| reading / 1000.0);
    let told = told(&case);
    let [offset, zero] = told.as_slice() else { panic!("{told:?}") };
    says(offset, &["offset with residual field of x", &format!("of {} and of {} differ by -9.9", id(8, 1), id(9, 1))]);
    says(zero, &["offset with residual field of ", &format!("of {} and of {} differ by", id(8, 0), id(11, 0))]);
}

/// Two linearity runs at one temperature, the second with a gain that is 0.4 % smaller; a third one that is the first again says nothing.
#[test]
fn sensitivities_of_one_temperature_that_differ_are_told() {
    let case = sound();
    for index in 1..TEMPERATURES_DEGC.len() {
        for hour in 8..=10 {
            fs::remove_file(file(&case, hour, index)).unwrap();
        }
    }
    let first = fs::read_to_string(file(&case, 8, 0)).unwrap();
    let again = |hour: usize| {
        fs::write(
            file(&case, hour, 0),
            first.replace("_08-00-00", &format!("_{hour}-00-00")).replace("T08:00:00", &format!("T{hour}:00:00")),
        )
    };
    again(14).unwrap();
    change(&case, 14, 0, |_, reading| reading + 0.01 * (100.0 * reading).sin());
    assert_eq!(told(&case), [""; 0]);
    again(15).unwrap();
    change(&case, 15, 0, |_, reading| 0.996 * reading);
    let told = told(&case);
    let [line] = told.as_slice() else { panic!("{told:?}") };
    says(line, &["sigma_", &id(15, 0), "nT/enT", "1 other pair of them differ as clearly"]);
}

/// One run names the mode with a capital: it is left out of its group, which has to be said.
#[test]
fn names_that_are_nearly_equal_are_told() {
    let case = sound();
    let path = file(&case, 8, 1);
    let text_of_run = fs::read_to_string(&path).unwrap();
    let line = text_of_run.lines().find(|line| line.starts_with("mode = ")).unwrap();
    fs::write(&path, text_of_run.replacen(line, &line.to_uppercase().replace("MODE = ", "mode = "), 1)).unwrap();
    let output = case.run("report", &["--no-plots"]);
    says(&text(&output.stderr), &["whose names are nearly equal", "write the names in one way"]);
}

/// A second export of a run that lacks its last samples: it counts once in the polynomials, and the report says so.
#[test]
fn a_run_that_is_a_part_of_another_one_counts_once() {
    let case = sound();
    let first = fs::read_to_string(file(&case, 8, 2)).unwrap();
    let (rows, _) = first.rsplit_once("@END").unwrap();
    let lines: Vec<&str> = rows.lines().collect();
    let again = format!("{}\n@END\n", lines[..lines.len() - 20].join("\n"));
    assert!(lines[lines.len() - 20].matches(',').count() == 4, "the samples stand last");
    let again = again.replace("_08-00-00", "_14-00-00").replace("T08:00:00", "T14:00:00");
    fs::write(file(&case, 14, 2), again).unwrap();
    let output = case.run("report", &["--no-plots", "--order", "b_or=2", "--order", "b_off=2"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let [kept, copy] = [8, 14].map(|hour| id(hour, 2));
    let told = text(&output.stderr);
    says(&told, &[&format!("run {copy} was left out: most of its readings stand in run {kept} as well")]);
    says(&told, &[&format!("run {copy}: "), &format!(" of its readings stand in run {kept} as well, one after the other")]);
    let polynomials =
        fs::read_to_string(case.out().join(format!("THERMAL_PARAMETER__{}.TPF", id(8, 0).replace('_', "-")))).unwrap();
    assert!(polynomials.contains(&format!("__{kept}.CPF")) && !polynomials.contains(&format!("__{copy}.CPF")), "{polynomials}");
}

/// An offset run that begins while the linearity run of the same sensor goes on.
#[test]
fn runs_of_one_sensor_at_the_same_time_are_told() {
    let case = sound();
    let path = file(&case, 9, 1);
    let run = fs::read_to_string(&path).unwrap();
    let [first, second] = [id(8, 1), id(9, 1)];
    let moved = run.replace("T09:00:00", "T08:00:10");
    assert_ne!(moved, run);
    fs::write(&path, moved).unwrap();
    let output = case.run("report", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &[&format!("run {second} begins while run {first} of the same sensor goes on")]);
}
