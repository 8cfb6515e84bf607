//! What a result folder does not take, and what it marks because the runs that are left do not give it any more.

use crate::common;
use crate::result_folder::{RUNS, TPF, cpf, done, index, report, rows, run, sample, stale, state};

use common::check::{Case, data, says, text, tree};
use serde_json::Value;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

/// Files that the index marks, with its reasons.
fn marked(out: &Path) -> BTreeMap<String, (String, Option<String>)> {
    let index = index(out);
    let files = index["files"].as_array().unwrap().iter().filter(|f| f["mark"].is_string());
    let told = |f: &Value| (f["mark"].as_str().unwrap().to_owned(), f["reason"].as_str().map(str::to_owned));
    files.map(|f| (f["path"].as_str().unwrap().to_owned(), told(f))).collect()
}

#[test]
fn what_the_runs_that_are_left_do_not_give_any_more_is_marked_and_out_of_the_tables() {
    let leave_out = |runs: &[usize]| -> Vec<String> {
        runs.iter().flat_map(|k| ["--exclude".to_owned(), format!("{}=door opened", RUNS[*k])]).collect()
    };
    let run_file = |k: usize| format!("{}.CCR", RUNS[k].replace('_', "/"));
    // One run is left: all others are left out; one is removed and two left out, among them that which the group is named after.
    for (removed, excluded, left) in [(None, [1, 2, 3].as_slice(), 0), (Some(1), &[0, 2], 3)] {
        let case = sample();
        let out = case.out();
        report(&case);
        let first = rows(&out, "LIN_PARAMETERS.csv");
        removed.iter().for_each(|k| fs::remove_file(case.campaign().join(run_file(*k))).unwrap());
        let options = leave_out(excluded);
        let arguments: Vec<&str> = std::iter::once("report").chain(options.iter().map(String::as_str)).collect();
        let said = done(&case, &arguments, &[&case.campaign()]);
        says(&said, &["marked: the runs that are left do not give", "INDEX.json says why"]);
        assert_eq!(stale(&out), BTreeSet::new());
        let marks = marked(&out);
        let own = cpf(RUNS[left], "TEMPLIN");
        assert_eq!(marks[TPF].0, "excluded");
        assert_eq!(marks[&own].0, "excluded");
        says(marks[&own].1.as_deref().unwrap(), &[TPF]);
        assert!(!marks.contains_key(&cpf(RUNS[left], "LIN")) && !marks.contains_key("REPORT.html"));
        // The table has the run alone, as in a folder that never held another one.
        let now = rows(&out, "LIN_PARAMETERS.csv");
        assert_eq!(now.keys().collect::<Vec<_>>(), [RUNS[left]]);
        assert_ne!(now[RUNS[left]], first[RUNS[left]]);
        let fresh = case.path().join("fresh");
        let output = run(&[&arguments[..], &["--no-plots", "-o"]].concat(), &[&fresh, &case.campaign()]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert_eq!(now, rows(&fresh, "LIN_PARAMETERS.csv"));
        says(&text(&run(&["check"], &[&out]).stderr), &[TPF, "cannot be made again"]);
        // Again it is told no more and stays so; other commands do not change it.
        let again = done(&case, &arguments, &[&case.campaign()]);
        assert!(!again.contains("marked: the runs"), "{again}");
        done(&case, &["freq"], &[&case.campaign()]);
        assert_eq!(marked(&out), marks);
        // All runs are back, and so is what rests on them.
        removed.iter().for_each(|k| {
            fs::copy(data("runs/sample").join(run_file(*k)), case.campaign().join(run_file(*k))).unwrap();
        });
        report(&case);
        assert_eq!((stale(&out), marked(&out)), (BTreeSet::new(), BTreeMap::new()));
        assert_eq!(rows(&out, "LIN_PARAMETERS.csv"), first);
    }
}

#[test]
fn runs_that_the_campaign_file_takes_out_are_marked_by_a_report() {
    let case = sample();
    let out = case.out();
    report(&case);
    let file = case.campaign().join("campaign.toml");
    let before = fs::read_to_string(&file).unwrap();
    fs::write(&file, format!("{before}\n[lin]\nruns = [\"{}\"]\n", RUNS[0])).unwrap();
    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());
    assert_eq!(rows(&out, "LIN_PARAMETERS.csv").keys().collect::<Vec<_>>(), [RUNS[0]]);
    assert_eq!(state(&out, RUNS[1]), "not_applicable");
    assert_eq!(marked(&out)[&cpf(RUNS[1], "LIN")].0, "not_applicable");
    assert!(marked(&out).contains_key(TPF));
    fs::write(&file, before).unwrap();
    report(&case);
    assert_eq!((stale(&out), marked(&out)), (BTreeSet::new(), BTreeMap::new()));
}

#[test]
fn a_folder_takes_no_tables_from_elsewhere_and_no_two_campaigns() {
    let case = Case::of(common::small().text());
    done(&case, &["lin"], &[&case.campaign()]);
    let before = tree(&case.out());
    let refused = |arguments: &[&str], paths: &[&Path], words: &[&str]| {
        let output = run(&[arguments, &["-o"]].concat(), &[&[case.out().as_path()], paths].concat());
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {}", text(&output.stderr));
        says(&text(&output.stderr), words);
        assert!(tree(&case.out()) == before, "something was written");
    };
    let another = ["holds results of another campaign", "choose another folder with -o"];
    let [residual, tilt] = ["bepicolombo/residual_field.csv", "champ/runs_ambient.csv"].map(|name| data("tests/data").join(name));
    refused(&["coil", "residual"], &[&residual], &another);
    refused(&["coil", "tilt"], &[&tilt], &another);
    refused(&["diagnose"], &[&tilt], &another);
    let amplitudes = case.path().join("freq_one.csv");
    fs::write(&amplitudes, "frequency_hz,bx_ent,by_ent,bz_ent\n").unwrap();
    refused(&["freq"], &[Path::new("--amplitudes"), &amplitudes], &another);
    let sample = data("runs/sample");
    refused(&["lin"], &[&sample, &case.campaign()], &another);
    // Also a new folder takes one campaign; a table that lies in the campaign belongs to it.
    let fresh = case.path().join("fresh");
    let output = run(&["lin", "-o"], &[&fresh, &sample, &data("runs/champ-1998")]);
    assert_eq!((output.status.code(), fresh.join("INDEX.json").exists()), (Some(2), false));
    says(&text(&output.stderr), &["takes the results of one campaign", "runs/sample", "runs/champ-1998"]);
    let own = case.campaign().join("residual_field.csv");
    fs::copy(&residual, &own).unwrap();
    done(&case, &["coil", "residual"], &[&own]);
    // A facility that lies elsewhere makes its folder no home of the campaign, nor of a table.
    let facility = data("tests/data/champ/facility.toml");
    let corrected = case.path().join("corrected");
    let output = run(&["lin", "--no-plots", "--facility"], &[&facility, Path::new("-o"), &corrected, &case.campaign()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = run(&["coil", "tilt", "--no-plots", "-o"], &[&corrected, &tilt]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    let tables = case.path().join("tables");
    let runs = case.campaign().join("runs_ambient.csv");
    fs::copy(&tilt, &runs).unwrap();
    let output = run(&["coil", "tilt", "--no-plots", "--facility"], &[&facility, Path::new("-o"), &tables, &runs]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = run(&["lin", "--no-plots", "-o"], &[&tables, &case.campaign()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    // Tables first, then a campaign in whose folder they are not.
    let output = run(&["coil", "residual", "--no-plots", "-o"], &[&fresh, &residual]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let output = run(&["lin", "-o"], &[&fresh, &case.campaign()]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["holds results of tables in", "bepicolombo", "choose another folder with -o"]);
}
