//! A result folder tells the truth: its index names every file with its hash and what it rests on, one campaign and one process use it at
//! a time, and what is older than what it was made from is marked.

use crate::common;

use calfit::files::lock::{FolderLock, LOCK_FILE};
use common::check::{Case, calfit, copy, data, process, says, text, tree};
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Output, Stdio};
use std::time::{Duration, Instant};

/// Linearity runs of the sample campaign.
pub(crate) const RUNS: [&str; 4] = ["26-01-15_09-00-00", "26-01-16_09-00-00", "26-01-17_09-00-00", "26-01-18_09-00-00"];
pub(crate) const TPF: &str = "THERMAL_PARAMETER__26-01-15-09-00-00.TPF";
const TOF: &str = "THERMAL_OFF_PARAMETER__26-01-15-09-30-00.TOF";
const TAF: &str = "THERMAL_AC_PARAMETER__26-01-15-10-00-00.TAF";

/// A copy of the sample campaign: linearity and offset runs at four temperatures, frequency runs at three.
pub(crate) fn sample() -> Case {
    let case = Case::new();
    copy(&data("runs/sample"), &case.campaign());
    case
}

pub(crate) fn run(arguments: &[&str], paths: &[&Path]) -> Output {
    calfit().args(arguments).args(paths).output().unwrap()
}

/// A command into the result folder of a case, which must succeed; its messages.
#[track_caller]
pub(crate) fn done(case: &Case, arguments: &[&str], paths: &[&Path]) -> String {
    let output = run(&[arguments, &["--no-plots", "-o"]].concat(), &[&[case.out().as_path()], paths].concat());
    assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
    truthful(&case.out());
    text(&output.stderr)
}

pub(crate) fn report(case: &Case) -> String {
    done(case, &["report"], &[&case.campaign()])
}

pub(crate) fn index(out: &Path) -> Value {
    serde_json::from_slice(&fs::read(out.join("INDEX.json")).unwrap()).unwrap()
}

fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|b| format!("{b:02x}")).collect()
}

/// Holds the index of a folder against the contract and against the files that are there.
#[track_caller]
fn truthful(out: &Path) {
    let index = index(out);
    assert_eq!((&index["format"], &index["version"]), (&"INDEX".into(), &1.into()));
    assert!(index["written_by"].as_str().unwrap().starts_with("calfit "));
    assert!(!index["campaign"]["name"].as_str().unwrap().is_empty());
    let states = ["done", "refused", "excluded", "gone", "not_applicable"];
    for (id, run) in index["runs"].as_object().unwrap() {
        assert!(states.contains(&run["state"].as_str().unwrap()), "{id}: {run}");
        for key in ["reason", "sha256", "start", "sensor"] {
            assert!(run.as_object().unwrap().contains_key(key), "{id} has no {key}");
        }
        assert!(run["state"] == "done" || run["reason"].is_string(), "{id}: {run}");
    }
    let mut files = tree(out);
    assert!(!files.contains_key(LOCK_FILE), "the lock was not given back");
    files.remove("INDEX.json");
    let entries = index["files"].as_array().unwrap();
    let paths: Vec<&str> = entries.iter().map(|f| f["path"].as_str().unwrap()).collect();
    assert!(paths.is_sorted());
    assert_eq!(paths, files.keys().map(String::as_str).collect::<Vec<_>>());
    for entry in entries {
        let path = entry["path"].as_str().unwrap();
        assert_eq!(entry["sha256"].as_str().unwrap(), sha256(&files[path]), "{path}");
        assert!(entry["stale"].is_boolean() && entry["command"].is_string(), "{entry}");
        let from = entry["from"].as_array().unwrap();
        assert!(!from.is_empty(), "{path} rests on nothing");
        for version in from.iter().chain(entry["replaces"].as_array().unwrap()) {
            let hash = version["sha256"].as_str().unwrap();
            assert!(hash.len() == 64 && hash.bytes().all(|b| b.is_ascii_hexdigit()), "{version}");
        }
        // What is not stale rests on the files that are there.
        if entry["stale"] == false && entry.get("mark").is_none() {
            for version in from {
                let there = files.get(version["path"].as_str().unwrap()).map(|bytes| sha256(bytes));
                assert!(there.is_none_or(|there| version["sha256"] == *there), "{path} rests on {version}");
            }
        }
    }
}

pub(crate) fn stale(out: &Path) -> BTreeSet<String> {
    let index = index(out);
    let files = index["files"].as_array().unwrap().iter().filter(|f| f["stale"] == true);
    files.map(|f| f["path"].as_str().unwrap().to_owned()).collect()
}

fn entry(out: &Path, path: &str) -> Value {
    let index = index(out);
    let found = index["files"].as_array().unwrap().iter().find(|f| f["path"] == path);
    found.unwrap_or_else(|| panic!("no {path} in the index")).clone()
}

pub(crate) fn state(out: &Path, id: &str) -> String {
    index(out)["runs"][id]["state"].as_str().unwrap().to_owned()
}

fn verify(out: &Path) -> (Option<i32>, String) {
    let output = run(&["verify"], &[out]);
    (output.status.code(), text(&output.stdout) + &text(&output.stderr))
}

/// The rows of a table of all runs by their run ids.
pub(crate) fn rows(out: &Path, table: &str) -> BTreeMap<String, String> {
    let text = fs::read_to_string(out.join(table)).unwrap();
    let lines = text.lines().filter(|line| !line.starts_with('#')).skip(1);
    lines.map(|line| (line.split(',').next().unwrap().to_owned(), line.to_owned())).collect()
}

pub(crate) fn cpf(id: &str, begin: &str) -> String {
    format!("{id}/PARAMETER_{begin}__{id}.CPF")
}

#[test]
fn a_command_that_is_repeated_changes_nothing_whatever_the_time() {
    let campaign = data("tests/data/version-1/campaign");
    let rosetta = data("tests/data/version-1/turned");
    let commands: [(&str, &[&str], &[&Path]); 9] = [
        ("lin", &["lin"], &[&campaign]),
        ("offset", &["offset"], &[&campaign]),
        ("freq", &["freq"], &[&campaign]),
        ("null", &["null"], &[&campaign]),
        ("thermal", &["thermal", "--order", "xi=1", "--order", "b_or=1", "--order", "b_off=1"], &[&campaign]),
        ("scalar", &["coil", "scalar"], &[&campaign.join("26-03-02/07-00-00.CCR.gz")]),
        ("tilt", &["coil", "tilt"], &[&rosetta]),
        ("diagnose", &["diagnose"], &[&data("tests/data/cases/26-05-02.CCR.gz")]),
        ("report", &["report"], &[&campaign]),
    ];
    let case = Case::new();
    for (name, arguments, paths) in commands {
        let out = case.path().join(name);
        let once = |time: &str| {
            let mut command = process();
            command.args(arguments).args(["--no-plots", "-o"]).arg(&out).args(paths).env("SOURCE_DATE_EPOCH", time);
            let output = command.output().unwrap();
            assert!(output.status.code() < Some(2), "{name}: {}", text(&output.stderr));
            truthful(&out);
            (output.status.code(), tree(&out))
        };
        let first = once("1365000000");
        assert!(first == once("1365000000"), "{name} again");
        assert!(first == once("1396000000"), "{name} a year later");
        assert!(stale(&out).is_empty(), "{name}: {:?}", stale(&out));
    }
}

#[test]
fn one_run_again_renews_the_table_and_makes_what_rests_on_it_stale() {
    let case = sample();
    let out = case.out();
    report(&case);
    let before = rows(&out, "LIN_PARAMETERS.csv");
    assert_eq!(before.keys().map(String::as_str).collect::<Vec<_>>(), RUNS);
    let earlier = entry(&out, &cpf(RUNS[1], "LIN"))["sha256"].clone();
    // That of the group stands in the place of that of the run alone, and says so.
    assert_eq!(entry(&out, &cpf(RUNS[1], "TEMPLIN"))["replaces"][0]["path"], cpf(RUNS[1], "LIN"));
    assert_eq!(entry(&out, &cpf(RUNS[1], "TEMPLIN"))["replaces"][0]["sha256"], earlier);
    assert_eq!(verify(&out).0, Some(0));

    let said = done(&case, &["lin", "--order", "0"], &[&case.campaign().join("26-01-16/09-00-00.CCR")]);
    says(&said, &["stale", "INDEX.json", "calfit report"]);
    let now = rows(&out, "LIN_PARAMETERS.csv");
    assert!(now.keys().eq(before.keys()));
    let changed: Vec<&String> = now.iter().filter(|(id, row)| before[*id] != **row).map(|(id, _)| id).collect();
    assert_eq!(changed, [RUNS[1]]);
    let stale_now = stale(&out);
    let opf = "26-01-16_09-30-00/OFF_PARAMETER__26-01-16-09-30-00.OPF";
    // The rows of the other runs are those of their calibrations in the group, which the report makes again.
    let table = "LIN_PARAMETERS.csv";
    for path in [TPF, TOF, "REPORT.md", "REPORT.html", opf, &cpf(RUNS[1], "TEMPLIN"), &cpf(RUNS[0], "TEMPLIN"), table] {
        assert!(stale_now.contains(path), "{path} is not stale: {stale_now:?}");
    }
    // Frequencies rest on no linear calibration, and the calibration of another run alone on none of this run.
    for path in [TAF, &cpf(RUNS[0], "LIN"), &cpf(RUNS[1], "LIN"), "FREQ_PARAMETERS.csv"] {
        assert!(!stale_now.contains(path), "{path} is stale");
    }
    // The document that the new one replaces is named by its hash.
    assert_eq!(entry(&out, &cpf(RUNS[1], "LIN"))["replaces"][0]["sha256"], earlier);
    let (status, said) = verify(&out);
    assert_eq!(status, Some(1));
    says(&said, &[TPF, "is stale", "was made again"]);
    let check = run(&["check"], &[&out]);
    assert_eq!(check.status.code(), Some(0));
    says(&text(&check.stderr), &["REPORT.html", "is stale"]);
    says(
        &text(&check.stdout),
        &[&format!("files are without errors; {} files of the result folder are stale", stale(&out).len())],
    );

    report(&case);
    assert!(!text(&run(&["check"], &[&out]).stdout).contains("stale"));
    assert_eq!(stale(&out), BTreeSet::new());
    assert_eq!(rows(&out, "LIN_PARAMETERS.csv"), before);
    assert_eq!(verify(&out).0, Some(0), "{}", verify(&out).1);
}

#[test]
fn what_is_of_a_run_that_is_gone_is_marked_and_stays() {
    let case = sample();
    let out = case.out();
    report(&case);
    let kept = fs::read(out.join(cpf(RUNS[2], "LIN"))).unwrap();
    fs::remove_file(case.campaign().join("26-01-17/09-00-00.CCR")).unwrap();
    done(&case, &["lin"], &[&case.campaign()]);
    assert_eq!(state(&out, RUNS[2]), "gone");
    assert_eq!(fs::read(out.join(cpf(RUNS[2], "LIN"))).unwrap(), kept);
    assert_eq!(entry(&out, &cpf(RUNS[2], "LIN"))["mark"], "gone");
    assert!(stale(&out).contains(TPF) && stale(&out).contains("REPORT.html"));
    assert!(!rows(&out, "LIN_PARAMETERS.csv").contains_key(RUNS[2]));

    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());
    assert_eq!(entry(&out, &cpf(RUNS[2], "LIN"))["mark"], "gone");
    let (status, said) = verify(&out);
    assert_eq!(status, Some(1));
    says(&said, &[&format!("run {} is gone from the campaign", RUNS[2]), "nothing to compare with"]);
    assert!(said.contains(&format!("{TPF}: verified")), "{said}");

    // A run that comes back is one of the campaign again.
    fs::copy(data("runs/sample/26-01-17/09-00-00.CCR"), case.campaign().join("26-01-17/09-00-00.CCR")).unwrap();
    report(&case);
    assert_eq!(state(&out, RUNS[2]), "done");
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn an_option_or_the_campaign_file_that_changes_makes_the_rest_stale() {
    let case = sample();
    let out = case.out();
    report(&case);
    done(&case, &["freq", "--settling", "1"], &[&case.campaign()]);
    assert!(stale(&out).contains(TAF) && !stale(&out).contains(TPF), "{:?}", stale(&out));
    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());
    let file = case.campaign().join("campaign.toml");
    fs::write(&file, fs::read_to_string(&file).unwrap() + "\n# looked through\n").unwrap();
    done(&case, &["lin"], &[&case.campaign()]);
    assert!(stale(&out).contains(TAF) && !stale(&out).contains(&cpf(RUNS[0], "LIN")), "{:?}", stale(&out));
    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn a_report_renews_what_other_commands_made() {
    let case = sample();
    let out = case.out();
    report(&case);
    let one = case.campaign().join("26-01-15/09-00-00.CCR");
    done(&case, &["diagnose"], &[&one]);
    let cpfs: Vec<PathBuf> = RUNS.iter().map(|id| out.join(cpf(id, "TEMPLIN"))).collect();
    done(&case, &["diagnose"], &cpfs.iter().map(PathBuf::as_path).collect::<Vec<_>>());
    done(&case, &["lin", "--linearise"], &[&case.campaign()]);
    let linearisation = format!("LINEARISATION__{}.toml", RUNS[0]);
    let own = format!("{}/diagnosis.json", RUNS[0]);
    let paths = [own.as_str(), "diagnosis.json", &linearisation];
    let command = |path: &str| entry(&out, path)["command"].clone();
    let commands = paths.map(command);
    let file = case.campaign().join("campaign.toml");
    fs::write(&file, fs::read_to_string(&file).unwrap() + "\n# looked through\n").unwrap();
    done(&case, &["lin"], &[&case.campaign()]);
    paths.iter().for_each(|path| assert!(stale(&out).contains(*path), "{path}: {:?}", stale(&out)));
    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());
    // As they were asked for, from the file as it is now.
    assert_eq!(paths.map(command), commands);
    let now = sha256(&fs::read(&file).unwrap());
    for path in [&own, &linearisation] {
        let from = entry(&out, path)["from"].clone();
        assert!(from.as_array().unwrap().iter().any(|version| version["sha256"] == *now), "{path}: {from}");
    }
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn stale_files_that_are_deleted_are_not_missed() {
    let case = sample();
    let out = case.out();
    // Short runs are enough.
    for day in fs::read_dir(case.campaign()).unwrap().map(|day| day.unwrap().path()).filter(|day| day.is_dir()) {
        let runs = fs::read_dir(day).unwrap().map(|run| run.unwrap().path());
        runs.filter(|run| fs::metadata(run).unwrap().len() > 20_000).for_each(|run| fs::remove_file(run).unwrap());
    }
    let report = || report(&case);
    // The group of offsets lacks its first run for a while, and is named after the second.
    let (first, away) = (case.campaign().join("26-01-15/09-30-00.CCR"), case.campaign().join("away"));
    fs::rename(&first, &away).unwrap();
    report();
    fs::rename(&away, &first).unwrap();
    report();
    let old = stale(&out);
    assert!(old.iter().any(|path| path.ends_with(".TOF")), "{old:?}");
    old.iter().for_each(|path| fs::remove_file(out.join(path)).unwrap());
    report();
    assert_eq!(stale(&out), BTreeSet::new());
    truthful(&out);
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn a_run_that_is_refused_now_keeps_its_older_results_with_a_mark() {
    let case = sample();
    let out = case.out();
    done(&case, &["lin"], &[&case.campaign()]);
    let path = case.campaign().join("26-01-16/09-00-00.CCR");
    let good = fs::read_to_string(&path).unwrap();
    fs::write(&path, good.replace("kind = \"linearity\"", "kind = \"linearity\"\nunit_of_nothing = 1").replace("@END", ""))
        .unwrap();
    let output = run(&["lin", "--no-plots", "-o"], &[&out, &case.campaign()]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    truthful(&out);
    assert_eq!(state(&out, RUNS[1]), "refused");
    assert_eq!(entry(&out, &cpf(RUNS[1], "LIN"))["mark"], "refused");
    assert!(!rows(&out, "LIN_PARAMETERS.csv").contains_key(RUNS[1]));
}

#[test]
fn a_run_that_is_left_out_by_hand_is_told_and_its_older_results_are_marked() {
    let case = sample();
    let out = case.out();
    report(&case);
    let left_out = format!("{}=door opened", RUNS[2]);
    done(&case, &["lin", "--exclude", &left_out], &[&case.campaign()]);
    let run = index(&out)["runs"][RUNS[2]].clone();
    assert_eq!(run["state"], "excluded");
    says(run["reason"].as_str().unwrap(), &["door opened"]);
    assert_eq!(entry(&out, &cpf(RUNS[2], "LIN"))["mark"], "excluded");
    assert!(stale(&out).contains(TPF) && !rows(&out, "LIN_PARAMETERS.csv").contains_key(RUNS[2]));
    done(&case, &["report", "--exclude", &left_out], &[&case.campaign()]);
    assert_eq!(stale(&out), BTreeSet::new());
    let used = common::check::parameters(&out.join(TPF))["used"].to_string();
    assert!(!used.contains(RUNS[2]), "{used}");
    report(&case);
    assert_eq!(state(&out, RUNS[2]), "done");
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn results_of_another_campaign_are_refused_before_anything_is_written() {
    let case = Case::of(common::small().text());
    done(&case, &["lin"], &[&case.campaign()]);
    let before = tree(&case.out());
    let refused = |arguments: &[&str], path: &Path, words: &[&str]| {
        let output = run(&[arguments, &["-o"]].concat(), &[&case.out(), path]);
        assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["holds results of another campaign", "choose another folder with -o"]);
        says(&text(&output.stderr), words);
        assert!(tree(&case.out()) == before, "something was written");
    };
    let id = common::RUN_ID;
    let start = common::small().key("start", "\"2014-04-03T09:22:38Z\"").text();
    let other_start = Case::of(start);
    refused(&["lin"], &other_start.campaign(), &[id, "2013-04-03T09:22:38Z", "2014-04-03T09:22:38Z"]);
    let other_sensor = Case::of(common::small().key("sensor", "\"another one\"").text());
    refused(&["lin"], &other_sensor.campaign(), &[id, "another one"]);
    refused(&["report"], &data("runs/sample"), &["no run in common", "Sample campaign"]);
    refused(&["diagnose"], &data("tests/data/cases/26-05-02.CCR.gz"), &["no run in common"]);
    // The same campaign in another place is the same campaign, and a further run of it alone is one of it.
    let moved = Case::of(common::small().text());
    moved.put("13-04-03/10-00-00.CCR", common::small().named("13-04-03_10-00-00").text());
    done(&case, &["lin"], &[&moved.campaign().join("13-04-03/10-00-00.CCR")]);
    assert_eq!(rows(&case.out(), "LIN_PARAMETERS.csv").len(), 2);
}

#[test]
fn a_folder_of_an_older_version_is_adopted_and_a_foreign_index_is_left() {
    let case = sample();
    let out = case.out();
    report(&case);
    fs::remove_file(out.join("INDEX.json")).unwrap();
    let output = run(&["lin", "-o"], &[&out, &data("runs/champ-1998")]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["holds results of another campaign"]);
    assert!(!out.join("INDEX.json").exists());
    // What is not renewed is in the index all the same, by what the files say.
    let output = run(&["lin", "--order", "0", "--no-plots", "-o"], &[&out, &case.campaign().join("26-01-16/09-00-00.CCR")]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let names: BTreeSet<String> = tree(&out).into_keys().filter(|name| name != "INDEX.json").collect();
    let indexed: BTreeSet<String> =
        index(&out)["files"].as_array().unwrap().iter().map(|f| f["path"].as_str().unwrap().to_owned()).collect();
    assert_eq!(indexed, names);
    assert_eq!(rows(&out, "LIN_PARAMETERS.csv").len(), RUNS.len());
    assert_eq!(state(&out, "26-01-18_10-00-00"), "done");
    report(&case);
    assert_eq!(stale(&out), BTreeSet::new());

    let foreign = Case::of(common::small().text());
    fs::create_dir_all(foreign.out()).unwrap();
    fs::write(foreign.out().join("INDEX.json"), "{\"mine\": true}").unwrap();
    let output = foreign.lin(&["--no-plots"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["INDEX.json", "was not written by calfit", "--force"]);
    assert_eq!(tree(&foreign.out()).len(), 1);
    foreign.done(&["--force"]);
    truthful(&foreign.out());
}

#[test]
fn files_that_were_changed_or_taken_away_are_named() {
    let case = Case::of(common::small().text());
    let out = case.out();
    let output = case.lin(&[]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    truthful(&out);
    let (status, said) = verify(&out);
    assert_eq!(status, Some(0), "{said}");
    // It says what it compared with.
    says(&said, &["campaign/13-04-03/09-22-38.CCR", "figures, tables and reports are as they were written"]);
    let check = run(&["check"], &[&out, &case.campaign()]);
    assert_eq!(check.status.code(), Some(0), "{}", text(&check.stderr));
    let table = run(&["check"], &[&out.join("LIN_PARAMETERS.parquet")]);
    assert_eq!(table.status.code(), Some(0), "{}", text(&table.stderr));
    // The run, the index, the parameter file.
    says(&text(&check.stdout), &["INDEX.json: ok", ".CPF: ok", "09-22-38.CCR: ok", "3 of 3 files are without errors"]);

    let figure = tree(&out).into_keys().find(|name| name.ends_with(".png")).unwrap();
    let good = fs::read(out.join(&figure)).unwrap();
    fs::write(out.join(&figure), [good.as_slice(), b"\0"].concat()).unwrap();
    for command in ["verify", "check"] {
        let output = run(&[command], &[&out]);
        assert_eq!(output.status.code(), Some(1), "{command}");
        says(&text(&output.stderr), &[&figure, "was changed after it was written", "SHA-256"]);
    }
    fs::remove_file(out.join(&figure)).unwrap();
    for command in ["verify", "check"] {
        let output = run(&[command], &[&out]);
        assert_eq!(output.status.code(), Some(1), "{command}");
        says(&text(&output.stderr), &[&figure, "is missing"]);
    }
    // A copy of the run in another campaign is none of the inputs.
    let elsewhere = case.path().join("copy");
    fs::rename(case.campaign(), &elsewhere).unwrap();
    let (status, said) = verify(&out);
    assert_eq!(status, Some(1));
    says(&said, &["09-22-38.CCR is not found", "name its campaign folder"]);
    let cpf = out.join(cpf(common::RUN_ID, "LIN"));
    assert_eq!(run(&["verify"], &[&cpf, &elsewhere]).status.code(), Some(0));
}

#[test]
fn the_calibrations_of_a_thermal_group_are_taken_where_there_are_both() {
    let case = sample();
    report(&case);
    let thermal = case.path().join("thermal");
    let output = run(&["thermal", "--no-plots", "-o"], &[&thermal, &case.out()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let used = common::check::parameters(&thermal.join(TPF))["used"].to_string();
    assert!(RUNS.iter().all(|id| used.contains(&format!("PARAMETER_TEMPLIN__{id}.CPF"))), "{used}");
    assert!(!used.contains("PARAMETER_LIN__"), "{used}");
    // What is stale gives way to what was made last.
    done(&case, &["lin", "--order", "0"], &[&case.campaign().join("26-01-16/09-00-00.CCR")]);
    let output = run(&["thermal", "--no-plots", "-o"], &[&thermal, &case.out()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let used = common::check::parameters(&thermal.join(TPF))["used"].to_string();
    says(&used, &[&format!("PARAMETER_LIN__{}.CPF", RUNS[1])]);
}

#[test]
fn sensitivities_and_facilities_that_do_not_belong_to_the_run_are_refused_by_name() {
    let case = sample();
    let champ = case.made("champ", &["lin"], &[&data("runs/champ-1998")]);
    let cpf = tree(&champ).into_keys().find(|name| name.ends_with(".CPF")).unwrap();
    let output = run(&["offset", "--no-plots", "-o"], &[&case.out(), &case.campaign(), Path::new("--cpf"), &champ.join(&cpf)]);
    assert_eq!(output.status.code(), Some(1));
    let name = cpf.rsplit('/').next().unwrap();
    says(&text(&output.stderr), &[name, "BS_11", "leave --cpf out"]);
    assert!(!tree(&case.out()).into_keys().any(|name| name.ends_with(".OPF")));

    let facility = case.put(
        "facility.toml",
        "scale_nt_per_eu = [1.0, 1.0, 1.0]\noffset_nt = [0.0, 0.0, 0.0]\nangles_deg = [90.0, 90.0, 90.0]\n",
    );
    let files: Vec<PathBuf> = tree(&champ).into_keys().filter(|n| n.ends_with(".CPF")).map(|n| champ.join(n)).collect();
    let files: Vec<&Path> = files.iter().map(PathBuf::as_path).chain([Path::new("--facility"), facility.as_path()]).collect();
    let output = run(&["coil", "tilt", "-o"], &[&[case.path().join("tilt").as_path()], files.as_slice()].concat());
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["made without a facility", "facility.toml", "leave --facility out"]);
}

#[test]
fn a_folder_in_use_is_refused_at_once_and_a_killed_process_leaves_no_lock() {
    let case = sample();
    let out = case.out();
    let held = FolderLock::take(&out).unwrap();
    for command in ["lin", "report", "diagnose"] {
        let output = process().arg(command).arg(case.path().join("there is none")).arg("-o").arg(&out).output().unwrap();
        assert_eq!(output.status.code(), Some(2));
        says(&text(&output.stderr), &["out", "is in use by another calfit process"]);
    }
    drop(held);
    assert!(!out.exists());

    let mut child = std::process::Command::new(env!("CARGO_BIN_EXE_calfit"))
        // Figures do not say what they rest on, and those of a killed process come again with figures only.
        .args(["report", "--no-plots", "-o"])
        .args([&out, &case.campaign()])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let begun = Instant::now();
    // The first result shows that the work is under way.
    while tree(&out).len() < 2 {
        assert!(begun.elapsed() < Duration::from_secs(60) && child.try_wait().unwrap().is_none(), "nothing was begun");
        std::thread::sleep(Duration::from_millis(1));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(out.join(LOCK_FILE).exists() && !out.join("INDEX.json").exists());
    report(&case);
    assert_eq!(verify(&out).0, Some(0));
}

#[test]
fn of_two_processes_at_once_each_does_all_or_nothing() {
    let case = Case::of(common::small().text());
    let alone = {
        let out = case.path().join("alone");
        let status = process().arg("lin").arg(case.campaign()).args(["--no-plots", "-o"]).arg(&out).output().unwrap().status;
        assert_eq!(status.code(), Some(0));
        tree(&out)
    };
    for pair in 0..50 {
        let out = case.path().join(format!("pair-{pair}"));
        let start = || {
            let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_calfit"));
            command.env("SOURCE_DATE_EPOCH", "1365000000").arg("lin").arg(case.campaign()).args(["--no-plots", "-o"]).arg(&out);
            command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap()
        };
        let ended = [start(), start()].map(|child| child.wait_with_output().unwrap());
        assert!(ended.iter().any(|o| o.status.code() == Some(0)), "pair {pair}");
        for output in ended.iter().filter(|o| o.status.code() != Some(0)) {
            assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
            says(&text(&output.stderr), &["is in use by another calfit process"]);
        }
        assert!(tree(&out) == alone, "pair {pair}");
    }
}
