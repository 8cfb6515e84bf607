//! What is left out by hand is left out, and nothing else: results are those of a file without the rows, the reason stands in the results,
//! and `verify` leaves the same out.

use crate::common::{self, RUN_ID, campaign};

use common::Run;
use common::check::{Case, calfit, cpf, number, parameters, says, text};
use std::fs;
use std::path::Path;
use toml_edit::DocumentMut;

/// Values of a linear calibration that follow from the readings.
const LINEAR: [&str; 14] = [
    "matrix.sigma.0.0",
    "matrix.sigma.1.1",
    "matrix.sigma.2.2",
    "angle_deg.xi_xy",
    "angle_deg.xi_xz",
    "angle_deg.xi_yz",
    "angle_deg.lambda_x",
    "offset.b_or_ent.0",
    "offset.b_or_ent.1",
    "std.sigma.0",
    "std.sigma.2",
    "std.b_or_ent.0",
    "quality.residual_nt.std.0",
    "quality.blocks_used",
];

/// Values are equal but for the time of the samples, which is found from counter and time tags of all rows that are there.
#[track_caller]
fn equal(a: &DocumentMut, b: &DocumentMut, paths: &[&str]) {
    for path in paths {
        let (a, b) = (number(a, path), number(b, path));
        assert!((a - b).abs() <= 1e-9 * b.abs().max(1e-3), "{path}: {a} is not {b}");
    }
}

#[track_caller]
fn differ(a: &DocumentMut, b: &DocumentMut, path: &str) {
    assert!(number(a, path) != number(b, path), "{path}");
}

/// The calibration of a run by `calfit lin` with some options.
fn calibrated(run: &Run, toml: &str, options: &[&str]) -> (Case, DocumentMut) {
    let case = Case::of(run.text());
    case.put("campaign.toml", toml);
    case.done(options);
    let document = case.cpf();
    (case, document)
}

/// The run with one setting, and with a stretch of time, spoiled.
fn disturbed(samples: std::ops::Range<usize>) -> Run {
    let mut run = common::good();
    run.samples[samples].iter_mut().for_each(|s| s.reading[0] += 20.0);
    run
}

#[track_caller]
fn verified(case: &Case, file: &Path) {
    let output = calfit().arg("verify").args([file, case.campaign().as_path()]).output().unwrap();
    let said = text(&output.stdout) + &text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    says(&said, &[": verified, "]);
}

#[test]
fn a_setting_that_is_left_out_is_as_if_its_samples_were_not_there() {
    let setting = 4;
    let samples = common::good().samples_of(setting - 1);
    let run = disturbed(samples.clone());
    let (_, without) = calibrated(&run.clone().lose(samples), "", &[]);
    let (_, with) = calibrated(&run, "", &[]);
    differ(&with, &without, "matrix.sigma.0.0");

    let toml = format!("[[exclude]]\nrun = \"{RUN_ID}\"\nsetting = {setting}\nreason = \"door opened\"\n");
    let option = format!("--exclude={RUN_ID}#{setting}=door opened");
    for (toml, options) in [(toml.as_str(), vec![]), ("", vec![option.as_str()])] {
        let (case, document) = calibrated(&run, toml, &options);
        equal(&document, &without, &LINEAR);
        let dropped = document["dropped"].as_array_of_tables().unwrap();
        assert_eq!(dropped.len(), 1);
        let dropped = dropped.get(0).unwrap();
        assert_eq!(dropped["block"].as_integer(), Some(setting as i64));
        assert_eq!(dropped["reason"].as_str(), Some("left out by hand: door opened"));
        let folder = case.out().join(RUN_ID);
        let report = fs::read_to_string(folder.join(format!("REPORT_LIN__{RUN_ID}.md"))).unwrap();
        says(&report, &["setting 4 was left out by hand: door opened", "Plateaus not used"]);
        verified(&case, &folder.join(format!("PARAMETER_LIN__{RUN_ID}.CPF")));
    }
}

#[test]
fn a_stretch_of_time_takes_its_samples_and_leaves_the_rest_of_the_setting() {
    // A tenth of a second of the second setting, which keeps the rest, and most of the sixth.
    let (short, long) = ([3.0, 3.1], [10.2, 11.9]);
    let good = common::good();
    let within =
        |[from, until]: [f64; 2]| good.samples.partition_point(|s| s.t < from)..good.samples.partition_point(|s| s.t < until);
    let mut run = disturbed(within(short));
    run.samples[within(long)].iter_mut().for_each(|s| s.reading[1] -= 30.0);
    let (_, without) = calibrated(&run.clone().lose(within(long)).lose(within(short)), "", &[]);
    let options = [format!("--exclude={RUN_ID}:3.0-3.1=crane"), format!("--exclude={RUN_ID}:10.2-11.9=door")];
    let (case, document) = calibrated(&run, "", &[&options[0], &options[1]]);
    equal(&document, &without, &LINEAR);
    let dropped = document["dropped"].as_array_of_tables().unwrap();
    assert_eq!(dropped.len(), 1);
    assert_eq!(dropped.get(0).unwrap()["block"].as_integer(), Some(6));
    assert_eq!(dropped.get(0).unwrap()["reason"].as_str(), Some("left out by hand: door"));
    let file = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    says(&fs::read_to_string(&file).unwrap(), &["3 to 3.1 s was left out by hand: crane"]);
    verified(&case, &file);
}

#[test]
fn a_run_that_is_left_out_gives_nothing_and_is_no_failure() {
    let case = Case::of(common::good().text());
    let other = "13-04-03_11-00-00";
    case.put("13-04-03/11-00-00.CCR", common::good().named(other).key("start", "\"2013-04-03T11:00:00Z\"").text());
    let output = case.run("lin", &["--no-plots", &format!("--exclude={RUN_ID}=wrong programme")]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stdout), &[&format!("{RUN_ID}: left out by hand: wrong programme")]);
    assert!(!case.out().join(RUN_ID).exists());
    verified(&case, &case.out().join(other).join(format!("PARAMETER_LIN__{other}.CPF")));

    let output = case.run("lin", &["--json", &format!("--exclude={RUN_ID}=wrong programme")]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(json["excluded"], serde_json::json!([{ "run": RUN_ID, "reason": "wrong programme" }]));
    assert_eq!(json["runs"].as_array().unwrap().len(), 1);

    // Nothing is left, and nothing failed.
    let all = [format!("--exclude={RUN_ID}=a"), format!("--exclude={other}=b")];
    assert_eq!(case.run("lin", &[&all[0], &all[1]]).status.code(), Some(0));
}

#[test]
fn an_exclusion_without_a_reason_is_refused_and_one_of_nothing_is_named() {
    let case = Case::of(common::small().text());
    let output = case.run("lin", &[&format!("--exclude={RUN_ID}#2")]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["the reason is missing"]);
    case.put("campaign.toml", format!("[[exclude]]\nrun = \"{RUN_ID}\"\n"));
    let output = case.run("lin", &[]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["campaign.toml", "`exclude.reason` is missing"]);

    case.put("campaign.toml", "[[exclude]]\nrun = \"13-04-04_00-00-00\"\nreason = \"a slip\"\n");
    let output = case.run("lin", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0));
    says(&text(&output.stderr), &["[[exclude]] run = \"13-04-04_00-00-00\" goes with no run"]);
    case.put("campaign.toml", format!("[[exclude]]\nrun = \"{RUN_ID}\"\nsetting = 99\nreason = \"a slip\"\n"));
    let output = case.run("lin", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0));
    says(&text(&output.stderr), &["the setting 99 that is to be left out by hand is none of the 10 of the run"]);
}

/// On the command line a slip in a name or a number would leave data in that somebody wants out: that is wrong usage.
#[test]
fn an_option_that_would_leave_out_nothing_is_wrong_usage() {
    let case = Case::of(common::small().text());
    for (place, words) in [
        ("13-04-05_00-00-00".to_owned(), "there is no run 13-04-05_00-00-00"),
        (format!("{RUN_ID}#99"), "the setting 99 that is to be left out by hand is none of the 10 of the run"),
        (format!("{RUN_ID}:5000-6000"), "holds nothing of the run, which has data from"),
    ] {
        for command in ["lin", "diagnose", "report", "thermal"] {
            let output = case.run(command, &["--no-plots", &format!("--exclude={place}=a slip")]);
            assert_eq!(output.status.code(), Some(2), "{command} {place}");
            says(&text(&output.stderr), &["--exclude", "would leave out nothing", words]);
            assert!(!case.out().join(RUN_ID).exists());
        }
    }
}

#[test]
fn every_analysis_leaves_out_what_it_is_told_to() {
    let case = Case::new();
    campaign::write(&case);
    for day in ["13-04-05", "13-04-06"] {
        fs::remove_dir_all(case.campaign().join(day)).unwrap();
    }
    let [offset, freq, null, left_out] = [campaign::id(9, 0), campaign::id(10, 0), campaign::id(11, 0), campaign::id(9, 1)];
    let options = [
        format!("--exclude={offset}#2=door opened"),
        format!("--exclude={freq}#3=generator off"),
        format!("--exclude={null}:20-30=crane"),
        format!("--exclude={left_out}=wrong position"),
    ];
    let options: Vec<&str> = options.iter().map(String::as_str).chain(["--no-plots"]).collect();
    let output = case.run("report", &options);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let file = |run: &str, stem: &str, end: &str| case.out().join(run).join(format!("{stem}{end}"));
    let opf = file(&offset, &format!("OFF_PARAMETER__{}", offset.replace('_', "-")), ".OPF");
    let fpf = file(&freq, &format!("FREQ_PARAMETER__{}", freq.replace('_', "-")), ".FPF");
    let dropped = parameters(&opf);
    assert_eq!(
        dropped["dropped"].as_array_of_tables().unwrap().get(0).unwrap()["reason"].as_str(),
        Some("left out by hand: door opened")
    );
    let sines = parameters(&fpf);
    let third = sines["amplitude"].as_array_of_tables().unwrap().get(2).unwrap();
    assert_eq!((third["used"].as_bool(), third["remark"].as_str()), (Some(false), Some("left out by hand: generator off")));
    let record = parameters(&file(&null, &format!("NULL_PARAMETER__{null}"), ".toml"));
    assert_eq!(number(&record, "record.samples"), 60.0 * 128.0 - 1280.0);
    assert!(!case.out().join(&left_out).exists());
    let report = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(&report, &["Left out by hand", "wrong position", "generator off", "20 to 30 s", "left out by hand: wrong position"]);
    for path in [&opf, &fpf] {
        verified(&case, path);
    }
    // What the other runs give is not touched.
    let other = campaign::id(8, 0);
    let touched = cpf(&case.out(), &other);
    let again = case.path().join("again");
    let output = calfit().args(["report", "--no-plots", "-o"]).args([again.as_path(), &case.campaign()]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    equal(&touched, &cpf(&again, &other), &LINEAR);
}
