//! Every kind of parameter file goes the whole way: written, read, checked, verified, exported. A kind that is added to the table and
//! not to the commands here fails.

use crate::common;

use calfit::data::run::Kind;
use calfit::files::parameter::{FileKind, KINDS};
use calfit::workflow::RUN_KINDS;
use common::check::{Case, calfit, data, says, text};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

/// A small campaign with runs of every kind, the same sensor turned, and other inputs; see `tests/data/README.md`.
const INPUTS: &str = "tests/data/version-1";
/// Run of the campaign at the temperature that takes polynomials to the centre.
const CENTRE: &str = "26-03-02_08-00-00";

fn run(arguments: &[&str], paths: &[&Path]) -> Output {
    calfit().args(arguments).args(paths).output().unwrap()
}

/// The parameter files of every kind that commands make.
fn files_of_every_kind(case: &Case) -> Vec<PathBuf> {
    let inputs = |name: &str| data(INPUTS).join(name);
    let campaign = inputs("campaign");
    let thermal = case.made("thermal", &["thermal", "--order", "xi=1", "--order", "b_or=1", "--order", "b_off=1"], &[&campaign]);
    let centre = thermal.join(CENTRE).join(format!("PARAMETER_TEMPLIN__{CENTRE}.CPF"));
    let polynomials = thermal.join("THERMAL_PARAMETER__26-03-02-08-00-00.TPF");
    let model = case.path().join("model.toml");
    let reference = inputs("inputs/reference.csv");
    let folders = [
        case.made("centre", &["thermal"], &[&polynomials, Path::new("--centre"), &centre]),
        case.made("null", &["null"], &[&campaign]),
        case.made("linearise", &["lin", "--linearise", "--order", "0"], &[&data("runs/champ-1998")]),
        case.made(
            "thermistor",
            &["thermistor"],
            &[&data("tests/data/rosetta/pt1000_table.csv"), Path::new("--reference"), &reference],
        ),
        case.made("scalar", &["coil", "scalar"], &[&campaign.join("26-03-02/07-00-00.CCR.gz")]),
        case.made("residual", &["coil", "residual"], &[&campaign.join("26-03-02/07-30-00.CCR.gz")]),
        case.made("tilt", &["coil", "tilt"], &[&inputs("turned")]),
        case.made("diagnosis", &["diagnose"], &[&data("tests/data/cases/26-05-02.CCR.gz"), Path::new("--write-model"), &model]),
        thermal,
    ];
    let in_folders = |folder: &PathBuf| -> Vec<PathBuf> {
        let tree = common::check::tree(folder).into_keys().map(|name| folder.join(name));
        tree.filter(|path| FileKind::of_name(path).is_some()).collect()
    };
    folders.iter().flat_map(in_folders).chain([model]).collect()
}

#[test]
fn every_kind_of_parameter_file_is_read_checked_verified_and_exported() {
    let case = Case::new();
    let files = files_of_every_kind(&case);
    let mut formats = BTreeSet::new();
    let places = [data(INPUTS), data("tests/data"), data("runs"), case.path().join("thermal")];
    let verify: Vec<&Path> = files.iter().chain(&places).map(PathBuf::as_path).collect();
    let verdicts: serde_json::Value = serde_json::from_slice(&run(&["verify", "--json"], &verify).stdout).unwrap();
    let changed = case.path().join("changed");
    fs::create_dir(&changed).unwrap();
    for path in &files {
        let shown = path.display();
        let kind = FileKind::of_file(path).unwrap_or_else(|| panic!("{shown} is of no kind of the table"));
        let written = fs::read_to_string(path).unwrap();
        assert!(written.contains(&format!("format = \"{}\"", kind.format)), "{shown} is named like a {kind:?}");
        // What was read is written as it was.
        kind.check(path).unwrap();
        assert_eq!(kind.rewritten(path).unwrap(), written, "{shown}");
        let output = run(&["check"], &[path]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        // No other kind takes it.
        for other in KINDS.iter().filter(|other| *other != kind) {
            says(&other.check(path).unwrap_err().to_string(), &[&format!("holds format {}, not {}", kind.format, other.format)]);
        }

        let own = verdicts.as_array().unwrap().iter().find(|v| v["file"] == shown.to_string()).unwrap();
        if kind.format == "MODEL" {
            // A diagnosis is not made again: its model file is complete with what it says of its inputs.
            says(&own["problems"].to_string(), &["makes no parameter file"]);
        } else {
            assert_eq!((own["ok"].as_bool(), own["largest_difference"].as_f64()), (Some(true), Some(0.0)), "{own}");
            assert!(own["values"].as_u64().unwrap() > 20, "{own}");
        }

        for format in ["json", "csv", "dcc"] {
            let output = run(&["export", "--format", format, "-o"], &[&case.path().join("export"), path]);
            if format == "json" || kind.quantities.is_some() {
                assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
            } else {
                assert_eq!(output.status.code(), Some(2));
                says(&text(&output.stderr), &["whose quantities have no list", "--format json"]);
            }
        }

        // A file that was changed is no file of its kind any more.
        let changed = changed.join(path.file_name().unwrap());
        fs::write(&changed, written.replacen("version = ", "added = 1\nversion = ", 1)).unwrap();
        says(&kind.check(&changed).unwrap_err().to_string(), &["was changed after it was written"]);
        let output = run(&["check"], &[&changed]);
        assert_eq!(output.status.code(), Some(1));
        formats.insert(kind.format);
    }
    let all: BTreeSet<&str> = KINDS.iter().map(|kind| kind.format).collect();
    assert_eq!(all.len(), KINDS.len(), "two kinds have the same format");
    assert_eq!(formats, all, "a kind of the table is not made here");
}

#[test]
fn a_parameter_file_is_no_run() {
    let cpf = data(INPUTS).join("files/lin/PARAMETER_LIN__26-03-02_08-00-00.CPF");
    let output = run(&["inspect"], &[&cpf]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["is a CPF parameter file and no run", "calfit check"]);
}

#[test]
fn every_kind_of_run_has_one_analysis_or_is_analysed_with_others() {
    for (kind, name) in Kind::NAMES {
        let analyses = RUN_KINDS.iter().filter(|line| line.kind == kind).count();
        assert_eq!(analyses, usize::from(kind != Kind::Scalar), "{name}");
    }
    let names: BTreeSet<&str> = RUN_KINDS.iter().map(|line| line.analysis).collect();
    assert_eq!(names.len(), RUN_KINDS.len(), "two kinds of runs have the same analysis");
}
