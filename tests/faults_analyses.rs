//! Data that are readable and wrong in offset and frequency measurements and in analyses across temperatures: what is left out is
//! said, what cannot be trusted is refused, and a refusal leaves nothing behind. The rows are those of the table of faults.

use crate::common;

use common::check::{Case, calfit, close, number, parameters, says, text, three, tree};
use common::{POSITIONS, Plan, RUN_FILE, Run, Setting, Truth, good, in_positions, offset_fields, position_table, programme};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::process::Output;
use toml_edit::{DocumentMut, Table};

/// Standard uncertainties within which every one of hundreds of undisturbed numbers is expected.
const FAR: f64 = 4.5;

// What holds for every refusal.

struct Refusal {
    status: i32,
    stderr: String,
}

/// Standard error without the remark on parameter files that were written by hand, which names every one of them.
fn messages(output: &Output) -> String {
    text(&output.stderr).lines().filter(|l| !l.contains("carries no hash")).map(|l| format!("{l}\n")).collect()
}

/// Has a command refused: the named file, a rule and a remedy are told, no file is left, and older results stay as they were.
#[track_caller]
fn refused(case: &Case, name: &str, older: &[&str], run: impl Fn(&[&str]) -> Output) -> Refusal {
    let first = run(&[]);
    let stderr = messages(&first);
    assert_ne!(first.status.code(), Some(0), "accepted: {stderr}{}", text(&first.stdout));
    assert_eq!(tree(&case.out()).keys().collect::<Vec<_>>(), Vec::<&String>::new(), "files were left: {stderr}");
    for file in older {
        let path = case.out().join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, format!("calfit wrote {file} before")).unwrap();
    }
    let before = tree(&case.out());
    let second = run(&["--json"]);
    assert!(tree(&case.out()) == before, "older results were changed");
    assert_eq!(second.status.code(), first.status.code());
    says(&stderr, &["error: ", name]);
    // A command that finds nothing to work on has no listing.
    if !second.stdout.is_empty() {
        let listing: serde_json::Value = serde_json::from_slice(&second.stdout).unwrap();
        let errors = listing["failed"].as_array().unwrap();
        let finding = errors.iter().find(|f| f["severity"] == "error").unwrap_or_else(|| panic!("no error in {listing}"));
        assert!(finding["file"].as_str().unwrap().ends_with(name), "{finding}");
        for part in ["rule", "remedy"] {
            let words = finding[part].as_str().unwrap();
            assert!(!words.is_empty(), "{finding}");
            says(&stderr, &[words]);
        }
    }
    Refusal { status: first.status.code().unwrap(), stderr }
}

impl Refusal {
    #[track_caller]
    fn unreadable(self) -> Self {
        assert_eq!(self.status, 2, "{}", self.stderr);
        self
    }

    #[track_caller]
    fn by_analysis(self) -> Self {
        assert_eq!(self.status, 1, "{}", self.stderr);
        self
    }

    #[track_caller]
    fn says(self, words: &[&str]) -> Self {
        says(&self.stderr, words);
        self
    }
}

/// Results of single runs that were there before.
const OLDER: [&str; 4] = [
    "13-04-03_09-22-38/OFF_PARAMETER__13-04-03-09-22-38.OPF",
    "13-04-03_09-22-38/OFFSET_readings__13-04-03_09-22-38.png",
    "13-04-03_09-22-38/FREQ_PARAMETER__13-04-03-09-22-38.FPF",
    "13-04-03_09-22-38/FREQ_frequency_response__13-04-03_09-22-38.png",
];

fn warnings(document: &DocumentMut) -> String {
    document["warnings"].to_string()
}

/// The report beside the parameter file.
fn report(case: &Case) -> String {
    let files = tree(&case.out());
    text(files.iter().find(|(name, _)| name.ends_with(".md")).unwrap().1)
}

// Offset measurements.

/// Zero field and ±200 nT on each axis in every position, plateaus of 2 s.
fn offset_plan() -> Plan {
    let fields = [offset_fields(), vec![[0.0; 3]]].concat();
    Plan {
        settings: in_positions(&[1, 2, 3, 4], &fields, 2.0),
        positions: POSITIONS.to_vec(),
        residual_nt: [4.0, -7.0, 11.0],
        rate_hz: 64.0,
        ..Plan::default()
    }
}

fn offset_run(plan: &Plan) -> Run {
    plan.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"")
}

fn offset_case(run: &Run) -> Case {
    let case = Case::of(run.text());
    case.put("campaign.toml", position_table(&POSITIONS));
    case
}

fn opf(case: &Case) -> DocumentMut {
    parameters(&case.out().join(OLDER[0]))
}

/// The offsets of a run that must be accepted, with the messages.
#[track_caller]
fn offsets(run: &Run, arguments: &[&str]) -> (Case, DocumentMut, String) {
    let case = offset_case(run);
    let output = case.run("offset", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let document = opf(&case);
    (case, document, text(&output.stderr))
}

#[track_caller]
fn offset_refused(run: &Run, arguments: &[&str]) -> Refusal {
    let case = offset_case(run);
    refused(&case, "09-22-38.CCR", &OLDER, |more| case.run("offset", &[arguments, more].concat()))
}

#[track_caller]
fn true_offsets(document: &DocumentMut) {
    for (i, truth) in Truth::default().offset_ent.into_iter().enumerate() {
        let (found, std) = (number(document, &format!("offset_ent.{i}")), number(document, &format!("offset_std_ent.{i}")));
        assert!(std > 0.0 && (found - truth).abs() < FAR * std, "component {i}: {found} ± {std} is not {truth}");
    }
}

/// Blocks that were not used, from 1, with the reasons.
fn dropped(document: &DocumentMut) -> Vec<(i64, String)> {
    let Some(list) = document.get("dropped").and_then(|d| d.as_array_of_tables()) else { return Vec::new() };
    list.iter().map(|d| (d["block"].as_integer().unwrap(), d["reason"].as_str().unwrap().to_owned())).collect()
}

// row 21
#[test]
fn an_offset_plateau_with_a_gap_is_dropped_and_listed() {
    let run = offset_run(&offset_plan());
    let samples = run.samples_of(5);
    let (case, opf, stderr) = offsets(&run.clone().lose(samples.start + 20..samples.start + 80), &[]);
    says(&stderr, &["60 samples are missing in 1 gap"]);
    let list = dropped(&opf);
    assert_eq!((list.len(), list[0].0), (1, 6));
    says(&list[0].1, &["53.1 % of the samples"]);
    says(&report(&case), &["53.1 %", "60 samples"]);
    let quality = ["blocks_used", "blocks_total", "lost_samples"].map(|k| number(&opf, &format!("quality.{k}")));
    assert_eq!(quality, [31.0, 32.0, 60.0]);
    true_offsets(&opf);
    // A short gap costs no plateau.
    let (_, opf, _) = offsets(&run.lose(samples.start + 20..samples.start + 24), &[]);
    assert!(dropped(&opf).is_empty());
    true_offsets(&opf);
}

// rows 21, 25
#[test]
fn a_position_lost_in_a_gap_costs_the_components_that_need_it() {
    let run = offset_run(&offset_plan());
    let lost = run.samples_of(16).start..run.samples_of(31).end;
    let case = offset_case(&run.lose(lost));
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["component z is refused", "no position shows it turned", "measure a position"]);
    let opf = opf(&case);
    assert!(number(&opf, "offset_ent.2").is_nan() && number(&opf, "offset_std_ent.2").is_nan());
    assert!((0..2).all(|i| number(&opf, &format!("offset_ent.{i}")).is_finite()));
    assert_eq!(dropped(&opf).len(), 16);
    assert!(dropped(&opf).iter().all(|d| d.1 == "no settled samples"));
}

// row 22
#[test]
fn a_wrong_sample_rate_of_an_offset_run_is_refused() {
    for rate_hz in [50.0, 62.0, 128.0] {
        let run = offset_run(&Plan { rate_hz, ..offset_plan() }).key("sample_rate", "64.0");
        offset_refused(&run, &[]).unreadable().says(&["64 Hz", "`sample_rate`"]);
    }
}

// row 23
#[test]
fn offset_settings_that_the_data_do_not_follow_are_refused() {
    let run = offset_run(&offset_plan());
    // By whole plateaus, by a whole position, and by parts of a plateau.
    for shift in [-16.0, -2.0, -1.0, -0.6, 0.6, 1.0, 2.0, 16.0] {
        offset_refused(&run.clone().shift_settings(shift), &[]).by_analysis().says(&["settings", "--allow mismatch"]);
    }
    let mut other = run.clone();
    let fields: Vec<[f64; 3]> = other.settings.iter().map(|s| s.field).collect();
    for (i, s) in other.settings.iter_mut().enumerate() {
        s.field = fields[(7 * i + 3) % fields.len()];
    }
    offset_refused(&other, &[]).by_analysis().says(&["position 1", "enT/nT", "settings", "--allow mismatch"]);
    offset_refused(&run.shift_settings(1000.0), &[]).by_analysis().says(&["none of the 32 plateaus", "no settled samples"]);
}

// row 23
#[test]
fn a_small_clock_offset_of_offset_settings_is_left_out_and_told() {
    for shift in [-0.2, 0.2] {
        let (_, opf, stderr) = offsets(&offset_run(&offset_plan()).shift_settings(shift), &[]);
        says(&stderr, &[&format!("the data step {:+.2} s after the settings do", -shift)]);
        says(&warnings(&opf), &["after the settings do"]);
        true_offsets(&opf);
    }
}

// row 23
#[test]
fn an_allowed_mismatch_of_an_offset_run_is_recorded() {
    let (_, opf, _) = offsets(&offset_run(&offset_plan()).shift_settings(1.0), &["--allow", "mismatch"]);
    says(opf["provenance"]["command"].as_str().unwrap(), &["--allow mismatch"]);
}

// row 24
#[test]
fn offset_plateaus_that_are_too_short_are_refused_with_a_remedy() {
    let run = offset_run(&offset_plan());
    offset_refused(&run, &["--settling", "2.5"]).by_analysis().says(&[
        "none of the 32 plateaus",
        "no settled samples",
        "--settling",
    ]);
    let (_, opf, _) = offsets(&run, &["--settling", "1.5"]);
    true_offsets(&opf);
    says(opf["provenance"]["command"].as_str().unwrap(), &["--settling 1.5"]);
}

// row 25
#[test]
fn an_offset_run_in_one_position_is_refused_for_every_component() {
    let mut plan = offset_plan();
    plan.settings.truncate(8);
    let refusal = offset_refused(&offset_run(&plan), &[]).by_analysis();
    says(&refusal.stderr, &["no component has an offset", "x:", "y:", "z:", "+X", "turned position"]);
}

// row 26
#[test]
fn a_stuck_component_of_an_offset_run_is_refused() {
    let run = offset_run(&offset_plan());
    for (component, name) in ["x", "y", "z"].into_iter().enumerate() {
        offset_refused(&run.clone().stick(component, 17.25), &[]).by_analysis().says(&[
            &format!("component {name}"),
            "stuck",
            "17.25",
        ]);
    }
    // Where no field was applied only the scatter tells.
    let mut plan = offset_plan();
    plan.settings.iter_mut().for_each(|s| s.field = [0.0; 3]);
    offset_refused(&offset_run(&plan).stick(1, 17.25), &[]).by_analysis().says(&["component y", "stuck"]);
}

// row 26
#[test]
fn saturated_offset_plateaus_are_dropped_and_counted() {
    let (case, opf, stderr) = offsets(&offset_run(&offset_plan()).saturate(1, 150.0), &[]);
    let list = dropped(&opf);
    assert_eq!(list.len(), 8, "{list:?}");
    assert!(list.iter().all(|d| d.1 == "y rests at the end of its range"), "{list:?}");
    says(&stderr, &["component y has no scatter at all in 8 plateaus"]);
    says(&report(&case), &["rests at the end of its range"]);
    true_offsets(&opf);
}

// row 26
#[test]
fn spikes_in_an_offset_run_are_left_out_and_counted() {
    let run = [5, 300, 1000, 2500].into_iter().fold(offset_run(&offset_plan()), |run, at| run.spike(at, 1, 500.0));
    let (_, opf, stderr) = offsets(&run, &[]);
    says(&stderr, &["samples in stretches with spikes were left out"]);
    says(&warnings(&opf), &["spikes"]);
    true_offsets(&opf);
}

// row 27
#[test]
fn swapped_and_reversed_components_of_an_offset_run_are_refused() {
    let run = offset_run(&offset_plan());
    offset_refused(&run.clone().swap(0, 1), &[]).by_analysis().says(&["component x", "wiring", "position table"]);
    offset_refused(&run.clone().reverse(2), &[]).by_analysis().says(&["component z", "-1.0", "wiring"]);
    offset_refused(&run.reverse(0).reverse(1), &[]).by_analysis().says(&["component x", "wiring"]);
}

// row 27
#[test]
fn positions_that_are_not_what_the_table_says_are_refused() {
    let run = offset_run(&offset_plan());
    for (a, b) in [(0, 1), (1, 2), (2, 3), (0, 3)] {
        let case = Case::of(run.text());
        let mut positions = POSITIONS;
        (positions[a].1, positions[b].1) = (positions[b].1, positions[a].1);
        case.put("campaign.toml", position_table(&positions));
        let refusal = refused(&case, "09-22-38.CCR", &OLDER, |more| case.run("offset", more)).by_analysis();
        says(&refusal.stderr, &[&format!("in position {}", a + 1), "component ", "enT/nT", "position table"]);
    }
    // The sensor stayed where it was.
    let mut plan = offset_plan();
    plan.settings.iter_mut().for_each(|s| s.position = 1);
    let mut stayed = offset_run(&plan);
    stayed.settings = offset_plan().settings;
    offset_refused(&stayed, &[]).by_analysis().says(&["in position 2", "component x", "-X field"]);
    let mut unknown = run;
    unknown.settings.iter_mut().filter(|s| s.position == 3).for_each(|s| s.position = 7);
    offset_refused(&unknown, &[]).by_analysis().says(&["position 7", "campaign.toml"]);
}

// row 18
#[test]
fn offset_readings_in_another_unit_are_refused() {
    let run = offset_run(&offset_plan()).each(|r| r.map(|v| 16.0 * v));
    offset_refused(&run, &[]).by_analysis().says(&["component x", "16.3", "enT/nT", "settings"]);
}

// row 30
#[test]
fn an_absent_or_short_temperature_of_an_offset_run_is_told() {
    let run = offset_run(&offset_plan()).warming();
    let (_, opf, stderr) = offsets(&run.clone().without_section("@TEMPERATURES"), &[]);
    says(&stderr, &["no sensor temperature", "T59", "no coil system temperature", "T29"]);
    says(&warnings(&opf), &["no sensor temperature"]);
    assert!(["run.temperature_degc", "run.coil_temperature_degc"].iter().all(|key| number(&opf, key).is_nan()));
    let mut short = run;
    short.temperatures.truncate(3);
    let (_, opf, stderr) = offsets(&short, &[]);
    says(&stderr, &["T59", "from 0 to 32 s only"]);
    says(&warnings(&opf), &["from 0 to 32 s only"]);
    assert_eq!(number(&opf, "run.temperature_degc"), 24.25);
    assert_eq!([0, 2].map(|i| number(&opf, &format!("conditions.sensor_degc.{i}"))), [24.0, 24.5]);
}

// row 31
#[test]
fn offset_runs_without_data_have_messages_of_their_own() {
    let run = offset_run(&offset_plan());
    let case = offset_case(&run);
    case.put(RUN_FILE, "");
    refused(&case, "09-22-38.CCR", &OLDER, |more| case.run("offset", more)).unreadable().says(&["the file is empty"]);
    let constant = run.clone().each(|_| [1.0, 2.0, 3.0]);
    offset_refused(&constant, &[]).by_analysis().says(&["component x", "stuck"]);
    let mut none = run.clone();
    none.samples.clear();
    offset_refused(&none, &[]).by_analysis().says(&["none of the 32 plateaus", "no settled samples"]);
    none.samples = run.samples[..1].to_vec();
    offset_refused(&none, &[]).by_analysis().says(&["none of the 32 plateaus"]);
    offset_refused(&run.clone().without_section("@VECTORS"), &[]).by_analysis().says(&["none of the 32 plateaus"]);
    offset_refused(&run.clone().without_section("@FIELDS"), &[]).by_analysis().says(&["no plateaus"]);
    let mut unset = run;
    unset.settings.clear();
    offset_refused(&unset, &[]).by_analysis().says(&["no plateaus"]);
}

// row 31
#[test]
fn offset_readings_without_any_noise_still_have_offsets() {
    let (_, opf, stderr) = offsets(&offset_run(&Plan { noise_ent: 0.0, ..offset_plan() }), &[]);
    says(&stderr, &["no scatter"]);
    close(three(&opf, "offset_ent"), Truth::default().offset_ent, 1e-3);
    assert!(three(&opf, "offset_std_ent").iter().all(|std| *std > 0.0));
}

// row 31
#[test]
fn a_campaign_without_runs_of_the_kind_is_told_and_a_run_of_another_kind_refused() {
    let case = Case::of(good().text());
    for (command, kind) in [("offset", "offset"), ("freq", "frequency")] {
        let output = case.run(command, &[]);
        assert_eq!(output.status.code(), Some(0));
        says(&text(&output.stderr), &[&format!("holds no {kind} run"), "calfit inspect"]);
        let file = || calfit().arg(command).arg(case.file()).arg("-o").arg(case.out()).output().unwrap();
        let refusal = refused(&case, "09-22-38.CCR", &[], |_| file()).by_analysis();
        says(&refusal.stderr, &[&format!("kind linearity, not {kind}")]);
    }
}

// Frequency measurements.

/// Low, middle and high frequencies, two of them above half of the sampling frequency.
const FREQUENCIES_HZ: [f64; 7] = [1.5, 3.0, 7.9, 19.9, 39.8, 79.4, 158.0];
const RATE_FACTOR: f64 = 127.9991 / 128.0;

/// Sines of 4 s on all coil axes with pauses of a quarter of a second, by an instrument that does not damp them.
fn tones(frequencies_hz: &[f64]) -> Plan {
    let setting = |(i, frequency): (usize, &f64)| Setting {
        t_start: 4.25 * i as f64 + 0.25,
        t_end: 4.25 * (i + 1) as f64,
        field: [600.0, 800.0, -500.0],
        frequency: *frequency,
        position: 1,
    };
    let settings = frequencies_hz.iter().enumerate().map(setting).collect();
    Plan { settings, rate_factor: RATE_FACTOR, ..Plan::default() }
}

fn freq_run(plan: &Plan) -> Run {
    plan.run().key("kind", "\"frequency\"").key("configuration", "\"FREQ2000.MAG\"")
}

fn good_tones() -> Run {
    freq_run(&tones(&FREQUENCIES_HZ))
}

/// The amplitudes without noise, enT.
fn true_amplitude(field: [f64; 3]) -> [f64; 3] {
    Truth::default().response().map(|row| (0..3).map(|j| row[j] * field[j]).sum::<f64>().abs())
}

fn fpf(case: &Case) -> DocumentMut {
    parameters(&case.out().join(OLDER[2]))
}

/// The frequency response of a run that must be accepted, with the messages.
#[track_caller]
fn response(run: &Run, arguments: &[&str]) -> (Case, DocumentMut, String) {
    let case = Case::of(run.text());
    let output = case.run("freq", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let document = fpf(&case);
    (case, document, text(&output.stderr))
}

#[track_caller]
fn freq_refused(run: &Run, arguments: &[&str]) -> Refusal {
    let case = Case::of(run.text());
    refused(&case, "09-22-38.CCR", &OLDER, |more| case.run("freq", &[arguments, &["--threads", "1"], more].concat()))
}

fn amplitudes(document: &DocumentMut) -> Vec<Table> {
    document["amplitude"].as_array_of_tables().unwrap().iter().cloned().collect()
}

fn of_three(table: &Table, key: &str) -> [f64; 3] {
    std::array::from_fn(|i| table[key].as_array().unwrap().get(i).unwrap().as_float().unwrap())
}

fn detected(table: &Table) -> [bool; 3] {
    std::array::from_fn(|i| table["detected"].as_array().unwrap().get(i).unwrap().as_bool().unwrap())
}

fn remark(table: &Table) -> &str {
    table.get("remark").map_or("", |r| r.as_str().unwrap())
}

/// What is wrong with the amplitudes and the sampling frequency beyond their uncertainties. Refused frequencies are not.
fn wrong(document: &DocumentMut, run: &Run, rate_hz: f64) -> Vec<String> {
    let mut list = Vec::new();
    for (table, setting) in amplitudes(document).iter().zip(&run.settings).filter(|(t, _)| t["used"].as_bool().unwrap()) {
        let (found, std, truth) = (of_three(table, "b_ent"), of_three(table, "b_std_ent"), true_amplitude(setting.field));
        for i in 0..3 {
            if std[i] <= 0.0 || (found[i] - truth[i]).abs() >= FAR * std[i] {
                list.push(format!("{} Hz: {} ± {} is not {}", setting.frequency, found[i], std[i], truth[i]));
            }
        }
    }
    for i in 0..3 {
        let (found, std) = (number(document, &format!("f_s_hz.{i}")), number(document, &format!("f_s_std_hz.{i}")));
        if std <= 0.0 || (found - rate_hz).abs() >= FAR * std {
            list.push(format!("{found} ± {std} Hz is not {rate_hz} Hz"));
        }
    }
    list
}

#[track_caller]
fn right(document: &DocumentMut, run: &Run, rate_hz: f64) {
    let wrong = wrong(document, run, rate_hz);
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

/// The frequencies that were refused, each with its reason in the file, on standard error and in the warnings.
#[track_caller]
fn refused_frequencies(document: &DocumentMut, stderr: &str) -> BTreeMap<String, String> {
    let mut list = BTreeMap::new();
    for table in amplitudes(document).iter().filter(|t| of_three(t, "b_ent").iter().any(|b| b.is_nan())) {
        let frequency = table["frequency_hz"].as_float().unwrap();
        assert_eq!(table["used"].as_bool(), Some(false), "{frequency} Hz");
        assert_eq!(detected(table), [false; 3]);
        assert!(!remark(table).is_empty(), "{frequency} Hz has no reason");
        for place in [stderr, &warnings(document)] {
            says(place, &[&format!("{frequency} Hz was refused: {}", remark(table))]);
        }
        list.insert(frequency.to_string(), remark(table).to_owned());
    }
    list
}

/// No text form of a number that is none, and no table row with more or fewer cells than its header.
#[track_caller]
fn clean(case: &Case) {
    for (name, bytes) in tree(&case.out()).into_iter().filter(|(name, _)| !name.ends_with(".parquet")) {
        if name.ends_with(".png") {
            continue;
        }
        let content = text(&bytes);
        let tokens: Vec<&str> = content.split(|c: char| !c.is_ascii_alphanumeric()).collect();
        assert!(!tokens.iter().any(|t| ["inf", "Infinity"].contains(t)), "an infinity in {name}:\n{content}");
        if name.ends_with(".md") {
            assert!(!tokens.iter().any(|t| ["nan", "NaN"].contains(t)), "a nan in {name}:\n{content}");
            let lines: Vec<&str> = content.lines().collect();
            for pair in lines.windows(2).filter(|p| p.iter().all(|l| l.starts_with('|'))) {
                assert_eq!(pair[0].matches('|').count(), pair[1].matches('|').count(), "{name}:\n{}\n{}", pair[0], pair[1]);
            }
        }
    }
}

#[test]
fn undisturbed_sines_come_back() {
    let run = good_tones();
    let (case, fpf, _) = response(&run, &[]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
    assert!(amplitudes(&fpf).iter().all(|a| a["used"].as_bool().unwrap() && detected(a) == [true; 3] && remark(a).is_empty()));
    clean(&case);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 8, failure_persistence: None, ..ProptestConfig::default() })]

    // row 21
    #[test]
    fn a_counted_gap_changes_neither_amplitudes_nor_sampling_frequency(
        setting in 0_usize..7,
        from in 20_usize..300,
        lost in 1_usize..200,
    ) {
        let whole = good_tones();
        let first = whole.samples_of(setting).start + from;
        let (_, undisturbed, _) = response(&whole, &[]);
        let (_, gap, stderr) = response(&whole.clone().lose(first..first + lost), &[]);
        prop_assert!(stderr.contains(&format!("{lost} samples are missing in 1 gap")), "{}", stderr);
        prop_assert!(warnings(&gap).contains("samples are missing"));
        for (a, b) in amplitudes(&undisturbed).iter().zip(amplitudes(&gap)) {
            let (before, after, std) = (of_three(a, "b_ent"), of_three(&b, "b_ent"), of_three(&b, "b_std_ent"));
            for i in 0..3 {
                let change = (before[i] - after[i]).abs();
                prop_assert!(change < 3.0 * std[i], "{} Hz: {} after {}", a["frequency_hz"], after[i], before[i]);
            }
        }
        for i in 0..3 {
            let [before, after, std] = [(&undisturbed, "f_s_hz"), (&gap, "f_s_hz"), (&gap, "f_s_std_hz")]
                .map(|(document, key)| number(document, &format!("{key}.{i}")));
            prop_assert!((before - after).abs() < 3.0 * std, "{} Hz after {} Hz", after, before);
        }
        prop_assert!(wrong(&gap, &whole, 128.0 * RATE_FACTOR).is_empty());
    }
}

// row 21
#[test]
fn an_uncounted_slip_in_a_setting_is_left_out_and_told() {
    let whole = good_tones();
    for setting in [3, 4, 5, 6] {
        let first = whole.samples_of(setting).start + 200;
        let mut run = whole.clone().lose(first..first + 1);
        run.samples[first..].iter_mut().for_each(|s| s.n -= 1);
        let (case, fpf, stderr) = response(&run, &[]);
        let told = format!("{} Hz: ", FREQUENCIES_HZ[setting]);
        says(&stderr, &[&told, "% of the setting is damaged and was left out"]);
        says(&warnings(&fpf), &[&told, "left out"]);
        for (i, table) in amplitudes(&fpf).iter().enumerate() {
            assert_eq!(remark(table).contains("damaged"), i == setting, "{} Hz: {}", table["frequency_hz"], remark(table));
        }
        right(&fpf, &run, 128.0 * RATE_FACTOR);
        says(&report(&case), &["is damaged and was left out"]);
    }
}

// row 21
#[test]
fn an_uncounted_loss_does_not_spoil_the_settings_after_it() {
    // Time tags that follow the counter put everything after the loss a tenth of a second early.
    let whole = good_tones();
    let first = whole.samples_of(1).start + 200;
    let mut run = whole.clone().lose(first..first + 13);
    for sample in &mut run.samples[first..] {
        sample.n -= 13;
        sample.t -= 13.0 / (128.0 * RATE_FACTOR);
    }
    let (_, fpf, stderr) = response(&run, &[]);
    says(&stderr, &["3 Hz: ", "damaged and was left out"]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
    // Uncertainties that have grown a thousandfold are no result either.
    let largest = amplitudes(&fpf).iter().flat_map(|a| of_three(a, "b_std_ent")).fold(0.0, f64::max);
    assert!(largest < 0.1, "± {largest} enT");
}

// row 21
#[test]
fn a_setting_overwritten_by_the_next_sine_keeps_its_own_half() {
    let mut plan = tones(&FREQUENCIES_HZ);
    let middle = plan.settings[3].t_start + 2.0;
    (plan.settings[3].t_end, plan.settings[4].t_start) = (middle, middle);
    let mut run = freq_run(&plan);
    run.settings = tones(&FREQUENCIES_HZ).settings;
    let (_, fpf, stderr) = response(&run, &[]);
    says(&stderr, &["19.9 Hz: 5", "% of the setting is damaged and was left out"]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
    let [from, to] = [0, 1].map(|i| amplitudes(&fpf)[3]["used_s"].as_array().unwrap().get(i).unwrap().as_float().unwrap());
    assert!(run.settings[3].t_start < from && to < middle + 0.1, "{from} to {to} s");
}

// row 22
#[test]
fn a_wrong_sample_rate_of_a_frequency_run_is_refused() {
    for rate_hz in [100.0, 127.0, 256.0] {
        let run = freq_run(&Plan { rate_hz, ..tones(&FREQUENCIES_HZ) }).key("sample_rate", "128.0");
        freq_refused(&run, &[]).unreadable().says(&["128 Hz", "`sample_rate`"]);
    }
}

// row 22
#[test]
fn a_clock_that_is_off_has_its_sampling_frequency_found() {
    for factor in [0.9991, 1.0009] {
        let run = freq_run(&Plan { rate_factor: factor, ..tones(&FREQUENCIES_HZ) });
        right(&response(&run, &[]).1, &run, 128.0 * factor);
    }
}

// row 22
#[test]
fn coarse_time_tags_do_not_disturb_the_sampling_frequency() {
    let run = good_tones().coarse(0.1);
    let (_, fpf, stderr) = response(&run, &[]);
    says(&stderr, &["time column"]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
}

// row 23
#[test]
fn displaced_settings_of_sines_are_refused_or_told_and_give_no_wrong_amplitudes() {
    let mut list = Vec::new();
    for shift in [-2.0, -1.0, -0.3, -0.05, 0.05, 0.3, 1.0, 2.0, 4.25] {
        let run = good_tones().shift_settings(shift);
        let case = Case::of(run.text());
        let output = case.run("freq", &["--no-plots"]);
        let stderr = text(&output.stderr);
        if output.status.code() == Some(1) {
            says(&stderr, &["settings"]);
            continue;
        }
        let wrong = wrong(&fpf(&case), &run, 128.0 * RATE_FACTOR);
        list.extend(
            wrong.first().map(|w| format!("displaced by {shift:+} s: {} numbers are wrong, the first: {w}", wrong.len())),
        );
        // Twentieths of a second at the begin are within the settling time.
        if shift != -0.05 && !stderr.contains("settings") && !stderr.contains("of the setting is damaged") {
            list.push(format!("displaced by {shift:+} s: nothing is said"));
        }
    }
    assert!(list.is_empty(), "{}", list.join("\n"));
}

// row 23
#[test]
fn sine_settings_of_another_run_are_refused() {
    // All frequencies are wrong, and all but one.
    for (factor, shift) in [(1, 1), (3, 1)] {
        let mut run = good_tones();
        for (i, s) in run.settings.iter_mut().enumerate() {
            s.frequency = FREQUENCIES_HZ[(factor * i + shift) % 7];
        }
        freq_refused(&run, &[]).by_analysis().says(&["frequencies", "settings"]);
    }
}

// row 23
#[test]
fn sine_settings_of_another_time_are_refused() {
    freq_refused(&good_tones().shift_settings(1000.0), &[]).by_analysis().says(&["no samples", "times of the settings"]);
}

// row 24
#[test]
fn sines_without_enough_samples_are_refused_one_by_one() {
    let whole = good_tones();
    let samples = whole.samples_of(3);
    let (_, fpf, stderr) = response(&whole.clone().lose(samples.clone()), &[]);
    let refused = refused_frequencies(&fpf, &stderr);
    assert_eq!(refused.keys().collect::<Vec<_>>(), ["19.9"]);
    right(&fpf, &whole, 128.0 * RATE_FACTOR);
    // Three samples of one setting.
    let (_, fpf, stderr) = response(&whole.clone().lose(samples.start..samples.end - 3), &[]);
    assert_eq!(refused_frequencies(&fpf, &stderr).keys().collect::<Vec<_>>(), ["19.9"]);
    right(&fpf, &whole, 128.0 * RATE_FACTOR);
}

// row 24
#[test]
fn a_settling_time_longer_than_the_sines_is_refused_with_a_remedy() {
    let refusal = freq_refused(&good_tones(), &["--settling", "10"]).by_analysis();
    assert!(["--settling", "longer"].iter().any(|r| refusal.stderr.contains(r)), "no remedy in: {}", refusal.stderr);
}

// row 26
#[test]
fn a_stuck_component_of_a_frequency_run_is_refused() {
    for (component, name) in ["x", "y", "z"].into_iter().enumerate() {
        let refusal = freq_refused(&good_tones().stick(component, 17.25), &[]).by_analysis();
        says(&refusal.stderr, &[&format!("component {name}"), "stuck"]);
    }
}

// row 26
#[test]
fn a_saturated_component_of_a_frequency_run_is_refused_or_told() {
    let run = good_tones().saturate(1, 600.0);
    let case = Case::of(run.text());
    let output = case.run("freq", &["--no-plots"]);
    let stderr = text(&output.stderr);
    let told = ["range", "saturat", "damaged", "disturbed"].iter().any(|w| stderr.contains(w));
    let wrong = if output.status.code() == Some(0) { wrong(&fpf(&case), &run, 128.0 * RATE_FACTOR) } else { Vec::new() };
    assert!(told && wrong.is_empty(), "said: {stderr:?}\n{}", wrong.join("\n"));
}

// row 26
#[test]
fn spikes_in_sines_are_left_out_and_told() {
    let whole = good_tones();
    let samples = whole.samples_of(3);
    let run = whole.clone().spike(samples.start + 120, 0, 500.0);
    let (_, fpf, stderr) = response(&run, &[]);
    says(&stderr, &["19.9 Hz: ", "% of the setting is damaged and was left out"]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
    // Everywhere in a setting.
    let run = samples.step_by(40).fold(whole, |run, at| run.spike(at, 1, 3000.0));
    let (_, fpf, stderr) = response(&run, &[]);
    let refused = refused_frequencies(&fpf, &stderr);
    assert_eq!(refused.keys().collect::<Vec<_>>(), ["19.9"]);
    says(&refused["19.9"], &["component y", "disturbed"]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
}

// row 28
#[test]
fn frequencies_that_the_samples_cannot_show_are_refused_and_the_others_continue() {
    // Onto 0, onto half of the sampling frequency, less than a cycle, and just more than one.
    let all = [1.5, 128.0, 3.0, 64.0, 7.9, 256.0, 19.9, 192.0, 39.8, 0.2, 79.4, 0.27, 158.0];
    let run = freq_run(&Plan { rate_factor: 1.0, ..tones(&all) });
    let (case, fpf, stderr) = response(&run, &[]);
    let refused = refused_frequencies(&fpf, &stderr);
    assert_eq!(refused.keys().collect::<Vec<_>>(), ["0.2", "128", "192", "256", "64"]);
    for alias in ["64", "128", "192", "256"] {
        says(&refused[alias], &["looks like", "sine and cosine cannot be told apart"]);
    }
    says(&refused["0.2"], &["0.77 cycles", "at least 1"]);
    right(&fpf, &run, 128.0);
    says(&report(&case), &["128", "cannot be told apart", "0.77 cycles"]);
    clean(&case);
}

// row 28
#[test]
fn a_run_of_frequencies_that_the_samples_cannot_show_is_refused() {
    let run = freq_run(&Plan { rate_factor: 1.0, ..tones(&[128.0, 64.0, 256.0, 192.0]) });
    freq_refused(&run, &[]).by_analysis().says(&["128 Hz", "sine and cosine cannot be told apart"]);
    let run = freq_run(&tones(&[0.05, 0.1, 0.2]));
    freq_refused(&run, &[]).by_analysis().says(&["0.05 Hz", "cycles"]);
}

// row 28
#[test]
fn a_wrong_frequency_in_the_table_is_refused_and_the_others_continue() {
    for (setting, stated) in [(2, 9.9), (2, 7.95), (6, 157.0), (0, 3.0)] {
        let mut run = good_tones();
        run.settings[setting].frequency = stated;
        let (_, fpf, stderr) = response(&run, &[]);
        let refused = refused_frequencies(&fpf, &stderr);
        assert_eq!(refused.len(), 1, "{refused:?}");
        says(&refused[&stated.to_string()], &["follows a sine of this frequency"]);
        right(&fpf, &run, 128.0 * RATE_FACTOR);
    }
}

// row 29
#[test]
fn an_amplitude_below_the_noise_is_reported_with_its_uncertainty() {
    let mut plan = tones(&FREQUENCIES_HZ);
    plan.settings[2].field = [0.0; 3];
    let run = freq_run(&plan);
    let (case, fpf, stderr) = response(&run, &[]);
    let silent = &amplitudes(&fpf)[2];
    assert_eq!(detected(silent), [false; 3]);
    says(remark(silent), &["not detected in x, y, z"]);
    for (amplitude, std) in of_three(silent, "b_ent").into_iter().zip(of_three(silent, "b_std_ent")) {
        // The noise of 500 readings.
        assert!(amplitude < 3.0 * std && (0.002..0.006).contains(&std), "{amplitude} ± {std}");
    }
    assert!(of_three(silent, "phase_deg").iter().all(|p| p.is_nan()), "a phase of nothing");
    assert!(refused_frequencies(&fpf, &stderr).is_empty());
    assert!(wrong(&fpf, &run, 128.0 * RATE_FACTOR).iter().all(|w| w.starts_with("7.9 Hz")));
    says(&report(&case), &["not detected"]);
    clean(&case);
}

/// A first-order low-pass at 57 Hz in a table of amplitudes.
fn table(frequencies_hz: &[f64], dc: [f64; 3]) -> String {
    let row = |f: &f64| {
        let [x, y, z] = dc.map(|dc| dc / (1.0 + (f / 57.0).powi(2)).sqrt());
        format!("{f},{x:.6},{y:.6},{z:.6}\n")
    };
    format!("{HEADER}{}", frequencies_hz.iter().map(row).collect::<String>())
}

const HEADER: &str = "frequency_hz,bx_ent,by_ent,bz_ent\n";
const TABLE_HZ: [f64; 6] = [1.0, 12.0, 40.0, 55.0, 80.0, 160.0];
const TABLE: &str = "freq_13-04-03_09-22-38.csv";

fn of_table(case: &Case, content: &str, arguments: &[&str]) -> Output {
    let path = case.path().join(TABLE);
    fs::write(&path, content).unwrap();
    calfit().arg("freq").arg("--amplitudes").arg(path).arg("-o").arg(case.out()).args(arguments).output().unwrap()
}

#[track_caller]
fn response_of_table(content: &str) -> (Case, DocumentMut, String) {
    let case = Case::new();
    let output = of_table(&case, content, &[]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let document = fpf(&case);
    (case, document, text(&output.stderr))
}

// row 29
#[test]
fn a_component_that_is_never_detected_has_no_corner_and_spoils_none() {
    // A sensor on the coil axes sees a field along y in y only.
    let mut plan = Plan { corner_hz: Some([58.0, 57.0, 54.0]), ..tones(&[3.0, 19.9, 39.8, 50.1, 79.4, 158.0]) };
    plan.truth = Truth { xi_deg: [90.0; 3], turned_deg: [0.0; 3], ..Truth::default() };
    plan.settings.iter_mut().for_each(|s| s.field = [0.0, 1000.0, 0.0]);
    let (case, fpf, _) = response(&freq_run(&plan), &[]);
    assert!(amplitudes(&fpf).iter().all(|a| detected(a) == [false, true, false] && remark(a) == "not detected in x, z"));
    let [found, std] = ["f_3db_model_hz", "f_3db_model_std_hz"].map(|key| three(&fpf, key));
    assert!(found[0].is_nan() && found[2].is_nan(), "corners of noise: {found:?} ± {std:?} Hz");
    assert!((found[1] - 57.0).abs() < 0.05 && std[1] < 0.05, "{} ± {} Hz", found[1], std[1]);
    says(&warnings(&fpf), &["x has no -3 dB frequency", "z has no -3 dB frequency"]);
    clean(&case);
}

// row 29
#[test]
fn a_column_of_zeros_in_a_table_of_amplitudes_is_not_detected_and_the_others_continue() {
    let (case, fpf, stderr) = response_of_table(&table(&TABLE_HZ, [0.0, 600.0, 500.0]));
    says(&stderr, &["x has no -3 dB frequency", "no amplitude is positive"]);
    for table in amplitudes(&fpf) {
        assert_eq!(detected(&table), [false, true, true]);
        assert_eq!(of_three(&table, "b_ent")[0], 0.0);
        says(remark(&table), &["not detected in x"]);
    }
    for key in ["f_3db_model_hz", "f_3db_igep_hz"] {
        let [x, y, z] = three(&fpf, key);
        assert!(x.is_nan() && (y - 57.0).abs() < 0.5 && (z - 57.0).abs() < 0.5, "{key}: {x} {y} {z}");
    }
    assert!(tree(&case.out()).keys().any(|name| name.ends_with(".png")));
    for name in ["values", "std", "residual_std"] {
        assert_eq!(fpf["model"][name].as_array().unwrap().len(), 3, "{name} has no entry for every component");
    }
}

// row 29
#[test]
fn the_report_of_a_table_with_a_column_of_zeros_holds_no_nan_and_no_ragged_row() {
    let case = Case::new();
    let output = of_table(&case, &table(&TABLE_HZ, [0.0, 600.0, 500.0]), &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    clean(&case);
}

// row 29
#[test]
fn zeros_in_a_table_of_amplitudes_have_no_logarithm() {
    let (case, fpf, stderr) = response_of_table(&table(&TABLE_HZ, [0.0; 3]));
    says(&stderr, &["x has no -3 dB frequency", "y has no -3 dB frequency", "z has no -3 dB frequency"]);
    assert!(three(&fpf, "f_3db_model_hz").iter().chain(&three(&fpf, "f_3db_igep_hz")).all(|f| f.is_nan()));
    assert!(amplitudes(&fpf).iter().all(|a| detected(a) == [false; 3]));
    clean(&case);
    let zero = |f: f64| {
        table(&TABLE_HZ, [600.0; 3]).lines().fold(String::new(), |out, l| {
            let row = if l.starts_with(&format!("{f},")) { format!("{f},0,0,0") } else { l.to_owned() };
            out + &row + "\n"
        })
    };
    for f in [12.0, 160.0] {
        let (case, fpf, _) = response_of_table(&zero(f));
        close(three(&fpf, "f_3db_model_hz"), [57.0; 3], 0.5);
        let tables = amplitudes(&fpf);
        let row = tables.iter().find(|a| a["frequency_hz"].as_float() == Some(f)).unwrap();
        assert_eq!((detected(row), row["used"].as_bool()), ([false; 3], Some(false)));
        says(remark(row), &["not detected in x, y, z"]);
        clean(&case);
    }
}

// row 30
#[test]
fn an_absent_or_short_temperature_of_a_frequency_run_is_told() {
    let (_, fpf, stderr) = response(&good_tones().without_section("@TEMPERATURES"), &[]);
    says(&stderr, &["no sensor temperature", "T59", "no coil system temperature", "T29"]);
    says(&warnings(&fpf), &["no sensor temperature"]);
    assert!(fpf["run"].get("temperature_degc").is_none());
    let mut short = good_tones();
    short.temperatures = (0..=4).map(|i| (0.5 + 2.0 * f64::from(i), [Some(20.5), Some(24.0)])).collect();
    let (_, fpf, stderr) = response(&short, &[]);
    says(&stderr, &["T59", "from 0.5 to 8.5 s only"]);
    says(&warnings(&fpf), &["s only"]);
    let (_, fpf, stderr) = response_of_table(&table(&TABLE_HZ[..2], [600.0; 3]));
    says(&stderr, &["neither sensor, mode nor temperature"]);
    assert!(fpf["run"].get("temperature_degc").is_none());
}

// row 31
#[test]
fn frequency_runs_without_data_have_messages_of_their_own() {
    let run = good_tones();
    let case = Case::of("");
    let file = || calfit().arg("freq").arg(case.file()).arg("-o").arg(case.out()).output().unwrap();
    refused(&case, "09-22-38.CCR", &OLDER, |_| file()).unreadable().says(&["the file is empty"]);
    let mut none = run.clone();
    none.samples.clear();
    freq_refused(&none, &[]).by_analysis().says(&["no samples"]);
    none.samples = run.samples[100..101].to_vec();
    freq_refused(&none, &[]).by_analysis().says(&["sample"]);
    freq_refused(&run.clone().without_section("@VECTORS"), &[]).by_analysis().says(&["no samples"]);
    freq_refused(&run.clone().without_section("@FIELDS"), &[]).by_analysis().says(&["no setting is a sine"]);
    let mut constant = run;
    constant.settings.iter_mut().for_each(|s| s.frequency = 0.0);
    freq_refused(&constant, &[]).by_analysis().says(&["no setting is a sine", "frequencies in @FIELDS are all 0"]);
}

// row 31
#[test]
fn constant_readings_of_a_frequency_run_are_refused() {
    freq_refused(&good_tones().each(|_| [1.0, 2.0, 3.0]), &[]).by_analysis().says(&["component x", "stuck"]);
}

// rows 31, 42
#[test]
fn a_refusal_does_not_depend_on_threads() {
    let case = Case::of(good_tones().each(|_| [1.0, 2.0, 3.0]).text());
    let told = |threads: &str| text(&case.run("freq", &["--threads", threads]).stderr);
    let one = told("1");
    for _ in 0..40 {
        assert_eq!(told("3"), one);
    }
}

// row 31
#[test]
fn sines_without_any_noise_still_have_a_sampling_frequency() {
    let run = freq_run(&Plan { noise_ent: 0.0, ..tones(&FREQUENCIES_HZ) });
    let (case, fpf, _) = response(&run, &[]);
    right(&fpf, &run, 128.0 * RATE_FACTOR);
    clean(&case);
}

// row 31
#[test]
fn tables_without_amplitudes_are_refused() {
    for content in ["", "\n\n", "# a remark\n", HEADER, "# a remark\r\nfrequency_hz,bx_ent,by_ent,bz_ent\r\n"] {
        let case = Case::new();
        let refusal = refused(&case, TABLE, &OLDER, |more| of_table(&case, content, more)).unreadable();
        says(&refusal.stderr, &["holds no amplitudes", "a header line and one row per frequency"]);
    }
    for (content, words) in [
        ("frequency_hz,bx_ent,by_ent\n1,2,3\n", "bz_ent"),
        ("frequency_hz,bx_ent,by_ent,bz_ent\n0,1,2,3\n", "must be positive"),
        ("frequency_hz,bx_ent,by_ent,bz_ent\n1,nan,2,3\n", "bx_ent"),
        ("frequency_hz,bx_ent,by_ent,bz_ent\n1,-1,2,3\n", "must not be negative"),
    ] {
        let case = Case::new();
        refused(&case, TABLE, &OLDER, |more| of_table(&case, content, more)).unreadable().says(&[words]);
    }
}

// row 31
#[test]
fn tables_that_determine_no_corner_say_why() {
    for content in [format!("{HEADER}1,2,3,4\n"), table(&TABLE_HZ[..2], [600.0; 3])] {
        let (case, fpf, stderr) = response_of_table(&content);
        says(
            &stderr,
            &["x has no -3 dB frequency by interpolation", "do not fall below -3 dB", "z has no -3 dB frequency by a model"],
        );
        assert!(three(&fpf, "f_3db_model_hz").iter().all(|f| f.is_nan()));
        clean(&case);
    }
}

// Analyses across temperatures.

const DEGC: [f64; 4] = [-60.0, 0.0, 60.0, 120.0];

fn id(index: usize) -> String {
    format!("13-04-{:02}_08-00-00", 3 + index)
}

fn head(index: usize, degc: Option<f64>) -> String {
    let degc = degc.map_or_else(String::new, |t| format!("temperature_degc = {t:?}\n"));
    format!("[run]\nid = \"{}\"\nsensor = \"BS_11\"\nmode = \"science mode 0\"\n{degc}", id(index))
}

fn list(values: [f64; 3]) -> String {
    let cells = values.map(|v| if v.is_nan() { "nan".to_owned() } else { format!("{v:?}") });
    format!("[{}]", cells.join(", "))
}

/// A linear calibration with sensitivities and an angle that depend on temperature, as another program might have written it.
fn cpf_at(index: usize, degc: Option<f64>, scatter: f64) -> (String, String) {
    let t = degc.unwrap_or(20.0);
    let (noise, [x, y, z]) =
        (1e-6 * [0.3, -0.5, 0.8, -0.7][index % 4] * scatter, [0.98 - 2e-5 * t, 1.02 - 1e-5 * t, 0.99 + 1e-5 * t]);
    let content = format!(
        "format = \"CPF\"\nversion = 1\n{}[matrix]\nsigma = [{}, {}, {}]\n[angle_deg]\nxi_xy = {:?}\nxi_xz = 90.2\nxi_yz = 90.1\n\
         [offset]\nb_or_ent = [1.0, 2.0, 3.0]\n[std]\nsigma = [1e-6, 1e-6, 1e-6]\n\
         xi_deg = [1e-4, 1e-4, 1e-4]\nb_or_ent = [0.01, 0.01, 0.01]\n",
        head(index, degc),
        list([x + noise, 0.0, 0.0]),
        list([0.0, y - noise, 0.0]),
        list([0.0, 0.0, z + noise]),
        89.8 + 1e-5 * t,
    );
    (format!("PARAMETER_LIN__{}.CPF", id(index)), content)
}

fn opf_at(index: usize, degc: Option<f64>, offset_ent: [f64; 3]) -> (String, String) {
    let std = offset_ent.map(|v| if v.is_nan() { v } else { 0.01 });
    let content = format!(
        "format = \"OPF\"\nversion = 1\noffset_ent = {}\noffset_std_ent = {}\n{}",
        list(offset_ent),
        list(std),
        head(index, degc)
    );
    (format!("OFF_PARAMETER__{}.OPF", id(index).replace('_', "-")), content)
}

fn fpf_at(index: usize, degc: Option<f64>, corner_hz: [f64; 3]) -> (String, String) {
    let (value, std) = (list(corner_hz), list(corner_hz.map(|v| if v.is_nan() { v } else { 0.01 })));
    let content = format!(
        "format = \"FPF\"\nversion = 1\nf_3db_model_hz = {value}\nf_3db_model_std_hz = {std}\nf_3db_igep_hz = {value}\n{}",
        head(index, degc)
    );
    (format!("FREQ_PARAMETER__{}.FPF", id(index).replace('_', "-")), content)
}

/// A folder of parameter files.
fn folder(files: &[(String, String)]) -> Case {
    let case = Case::new();
    fs::create_dir_all(case.campaign()).unwrap();
    for (name, content) in files {
        case.put(name, content);
    }
    case
}

const TPF: &str = "THERMAL_PARAMETER__13-04-03-08-00-00.TPF";
const TOF: &str = "THERMAL_OFF_PARAMETER__13-04-03-08-00-00.TOF";
const TAF: &str = "THERMAL_AC_PARAMETER__13-04-03-08-00-00.TAF";
const OLDER_THERMAL: [&str; 4] = [TPF, TOF, TAF, "THERMAL_sensitivity__13-04-03-08-00-00.png"];

#[track_caller]
fn thermal(case: &Case, arguments: &[&str], file: &str) -> (DocumentMut, String) {
    let output = case.run("thermal", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    (parameters(&case.out().join(file)), messages(&output))
}

#[track_caller]
fn thermal_refused(files: &[(String, String)], name: &str, arguments: &[&str]) -> Refusal {
    let case = folder(files);
    refused(&case, name, &OLDER_THERMAL, |more| case.run("thermal", &[arguments, more].concat()))
}

const GROUP: &str = "BS_11 science mode 0";

/// Runs at one temperature have no polynomials, which is told and is no failure.
fn at_one_temperature(files: &[(String, String)], arguments: &[&str], words: &[&str]) {
    let case = folder(files);
    let output = case.run("thermal", &[&["--no-plots"], arguments].concat());
    let messages = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{messages}");
    says(&messages, &["warning: ", GROUP, "are at 1 different temperature, polynomials need two"]);
    says(&messages, words);
    assert!(tree(&case.out()).iter().all(|(name, _)| !name.contains("PARAMETER")), "{messages}");
}

fn listed(document: &DocumentMut, key: &str) -> Vec<String> {
    document[key].as_array().unwrap().iter().map(|v| v.as_str().unwrap().to_owned()).collect()
}

#[test]
fn parameter_files_of_four_temperatures_give_polynomials() {
    let case = folder(&(0..4).map(|i| cpf_at(i, Some(DEGC[i]), 1.0)).collect::<Vec<_>>());
    let (tpf, _) = thermal(&case, &[], TPF);
    assert_eq!([0, 1].map(|i| number(&tpf, &format!("valid_degc.{i}"))), [-60.0, 120.0]);
    assert_eq!(listed(&tpf, "used").len(), 4);
    assert!((number(&tpf, "sigma_x.1") + 2e-5).abs() < 1e-7);
    says(tpf["convention"]["uncertainty"].as_str().unwrap(), &["outside valid_degc", "extrapolations"]);
    clean(&case);
}

// row 25
#[test]
fn runs_at_one_temperature_have_no_polynomials() {
    let files: Vec<_> = (0..3).map(|i| cpf_at(i, Some(20.0), 1.0)).collect();
    at_one_temperature(&files, &[], &["need two", "measure at further temperatures"]);
    at_one_temperature(&files[..1], &[], &["its linearity runs"]);
    let files: Vec<_> = (0..3).map(|i| opf_at(i, Some(20.0), [1.0, 2.0, 3.0])).collect();
    at_one_temperature(&files, &[], &[]);
    let files: Vec<_> = (0..3).map(|i| fpf_at(i, Some(20.0), [58.0, 57.0, 56.0])).collect();
    at_one_temperature(&files, &[], &[]);
}

// row 25
#[test]
fn temperatures_that_differ_by_nothing_but_rounding_are_one() {
    let files: Vec<_> = (0..3).map(|i| cpf_at(i, Some(20.0 + 1e-12 * i as f64), 1.0)).collect();
    for arguments in [&[][..], &["--order", "sigma=1"]] {
        at_one_temperature(&files, arguments, &[]);
    }
}

// row 25
#[test]
fn runs_with_equal_temperature_readings_are_at_one_temperature() {
    // The mean of seven equal readings and that of fewer differ in the last digit.
    let run = |(i, count): (usize, i32)| {
        let mut run = run_at(i, None);
        let end = run.settings.last().unwrap().t_end;
        run.temperatures = (0..count).map(|k| (end * f64::from(k) / f64::from(count - 1), [Some(20.1), Some(20.1)])).collect();
        run.text()
    };
    let case = campaign(&[3, 5, 7].into_iter().enumerate().map(run).collect::<Vec<_>>());
    let output = case.run("thermal", &["--no-plots", "--order", "sigma=1"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stdout));
    says(&text(&output.stderr), &["are at 1 different temperature, polynomials need two"]);
    assert!(!case.out().join(TPF).exists());
}

// row 25
#[test]
fn an_order_too_high_for_the_temperatures_is_refused() {
    let files: Vec<_> = (0..4).map(|i| cpf_at(i, Some(DEGC[i.min(2)]), 1.0)).collect();
    let refusal = thermal_refused(&files, GROUP, &["--order", "sigma=3"]).by_analysis();
    says(&refusal.stderr, &["sigma_x", "order 3 needs 4 different points; there are 3", "lower order", "--order"]);
    // The others follow from their own orders.
    let case = folder(&files);
    let (tpf, _) = thermal(&case, &["--order", "sigma=2"], TPF);
    assert_eq!(tpf["sigma_x"].as_array().unwrap().len(), 3);
    for order in ["sigma=9", "sigma=-1", "sigma", "beta=1"] {
        let output = folder(&files).run("thermal", &["--order", order]);
        assert_eq!(output.status.code(), Some(2), "{order}");
        says(&text(&output.stderr), &["error: ", order]);
    }
}

// The common rule.
#[test]
fn the_refusal_of_a_group_names_its_files_and_says_nothing_twice() {
    let files: Vec<_> = (0..3).map(|i| cpf_at(i, (i < 2).then_some(20.0), 1.0)).collect();
    let refusal = thermal_refused(&files, GROUP, &[]).by_analysis();
    let first = refusal.stderr.lines().find(|l| l.starts_with("error: ")).unwrap();
    assert_eq!(first.matches(GROUP).count(), 1, "{first}");
    for (name, _) in &files {
        says(&refusal.stderr, &[name.as_str()]);
    }
}

/// A run of a thermal group; no temperature leaves the cells empty.
fn run_at(index: usize, degc: Option<f64>) -> Run {
    let settings = programme(&[-2000.0, -1000.0, 1000.0, 2000.0], 1.0);
    let plan = Plan { settings, rate_hz: 32.0, seed: index as u64 + 1, ..Plan::default() };
    let mut run = plan.run().named(&id(index));
    run.temperatures.iter_mut().for_each(|t| t.1 = [Some(20.0), degc]);
    run
}

fn campaign(runs: &[String]) -> Case {
    let case = Case::new();
    for (index, run) in runs.iter().enumerate() {
        case.put(&format!("{}.CCR", id(index).replace('_', "/")), run);
    }
    case
}

// rows 22, 26, 31
#[test]
fn a_bad_run_of_a_thermal_group_is_named_and_the_others_are_used() {
    let runs: Vec<Run> = (0..4).map(|i| run_at(i, Some(DEGC[i]))).collect();
    for (bad, words) in [
        (runs[1].clone().stick(0, 1.0).text(), "component x is stuck"),
        (runs[1].clone().key("sample_rate", "40.0").text(), "`sample_rate`"),
        (String::new(), "the file is empty"),
    ] {
        let case = campaign(&[runs[0].text(), bad, runs[2].text(), runs[3].text()]);
        let output = case.run("thermal", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["error: 13-04-04/08-00-00.CCR", words, "1 of 4 failed: 13-04-04/08-00-00.CCR"]);
        let tpf = parameters(&case.out().join(TPF));
        assert_eq!(listed(&tpf, "runs"), [id(0), id(2), id(3)]);
        assert_eq!(listed(&tpf, "used").len(), 3);
        assert!(!case.out().join(id(1)).join(format!("PARAMETER_TEMPLIN__{}.CPF", id(1))).exists());
    }
}

// row 27
#[test]
fn a_run_with_swapped_axes_in_a_thermal_group_is_warned_of_loudly() {
    let runs = [run_at(0, Some(-60.0)).text(), run_at(1, Some(0.0)).swap(0, 1).text(), run_at(2, Some(60.0)).text()];
    let case = campaign(&runs);
    let (tpf, stderr) = thermal(&case, &[], TPF);
    says(&stderr, &["13-04-04/08-00-00.CCR: AXES", "left-handed", "nominal +y axis"]);
    says(&warnings(&tpf), &["sigma_x: the runs scatter by", "was added to those of all runs"]);
}

// row 30
#[test]
fn a_run_without_temperature_is_left_out_of_a_thermal_group_with_its_name() {
    let runs: Vec<String> = (0..4).map(|i| run_at(i, (i != 3).then_some(DEGC[i])).text()).collect();
    let case = campaign(&runs);
    let (tpf, stderr) = thermal(&case, &[], TPF);
    let left_out = format!("PARAMETER_TEMPLIN__{}.CPF states no sensor temperature and was left out", id(3));
    for place in [&stderr, &warnings(&tpf)] {
        says(place, &[&left_out]);
    }
    says(&stderr, &["13-04-06/08-00-00.CCR: no sensor temperature"]);
    assert_eq!(listed(&tpf, "runs"), [id(0), id(1), id(2)]);
    assert_eq!([0, 1].map(|i| number(&tpf, &format!("valid_degc.{i}"))), [-60.0, 60.0]);
    says(&text(tree(&case.out()).iter().find(|(n, _)| n.starts_with("REPORT_THERMAL")).unwrap().1), &[&left_out]);
}

// row 30
#[test]
fn a_group_that_is_refused_for_want_of_temperatures_names_the_runs_that_have_none() {
    let files: Vec<_> = (0..3).map(|i| cpf_at(i, (i == 0).then_some(20.0), 1.0)).collect();
    let refusal = thermal_refused(&files, GROUP, &[]).by_analysis();
    says(&refusal.stderr, &["are at 1 different temperature, polynomials need two", "temperature channel"]);
    for (name, _) in &files[1..] {
        says(&refusal.stderr, &[name.as_str()]);
    }
}

// row 30
#[test]
fn a_table_of_amplitudes_without_sensor_and_temperature_is_left_out_with_its_name() {
    let mut files = vec![fpf_at(0, Some(-60.0), [58.0; 3]), fpf_at(1, Some(0.0), [57.9; 3])];
    let (name, content) = fpf_at(2, None, [58.0; 3]);
    files.push((name.clone(), content.replace("BS_11", "").replace("science mode 0", "")));
    let case = folder(&files);
    let output = case.run("thermal", &["--no-plots"]);
    assert_eq!(listed(&parameters(&case.out().join(TAF)), "used").len(), 2);
    says(&messages(&output), &[&name, "temperature"]);
}

// row 30
#[test]
fn a_temperature_record_shorter_than_a_run_is_told_in_a_thermal_analysis() {
    let mut run = run_at(1, Some(0.0));
    run.temperatures.truncate(2);
    let case = campaign(&[run_at(0, Some(-60.0)).text(), run.text()]);
    let (_, stderr) = thermal(&case, &[], TPF);
    says(&stderr, &["13-04-04/08-00-00.CCR: the sensor temperature (channel T59) covers the time from 0 to 4 s only"]);
}

// row 30
#[test]
fn temperatures_from_different_channels_are_told() {
    let mut files: Vec<_> = (0..3).map(|i| cpf_at(i, Some(DEGC[i]), 1.0)).collect();
    for ((_, content), channel) in files.iter_mut().zip(["T59", "T59", "T11"]) {
        content.push_str(&format!("[conditions]\nsensor_channel = \"{channel}\"\n"));
    }
    let (tpf, stderr) = thermal(&folder(&files), &[], TPF);
    for place in [&stderr, &warnings(&tpf)] {
        says(place, &["different channels: T11, T59"]);
    }
}

// row 30
#[test]
fn a_polynomial_does_not_claim_temperatures_at_which_its_quantity_was_not_measured() {
    let nan = f64::NAN;
    let mut list = Vec::new();
    // The component is not determined in the warmest run, or in all but one.
    for missing in [&[2][..], &[1, 2]] {
        let at = |i: usize, v: [f64; 3]| if missing.contains(&i) { [v[0], v[1], nan] } else { v };
        let off: Vec<_> = (0..3).map(|i| opf_at(i, Some(DEGC[i]), at(i, [1.0, 2.0, 3.0 + 0.1 * i as f64]))).collect();
        let freq: Vec<_> = (0..3).map(|i| fpf_at(i, Some(DEGC[i]), at(i, [58.0, 57.0, 55.0 - 0.1 * i as f64]))).collect();
        for (files, file, quantity) in [(off, TOF, "b_off_z"), (freq, TAF, "f_3db_z")] {
            let (document, _) = thermal(&folder(&files), &[], file);
            // The file holds where all its polynomials hold; a component without one is nan.
            let is_there = !number(&document, &format!("{quantity}.0")).is_nan();
            let warmest = if is_there { 0.0 } else { 60.0 };
            assert_eq!([0, 1].map(|i| number(&document, &format!("valid_degc.{i}"))), [-60.0, warmest]);
            let told = listed(&document, "warnings").iter().any(|w| w.contains(quantity) && !w.contains("scatter"));
            let restricted = document.to_string().matches("valid_degc = ").count() > 1;
            if is_there && !told && !restricted {
                list.push(format!("{quantity} is missing in runs {missing:?}: {} for -60 to 60 °C", document[quantity]));
            }
        }
    }
    assert!(list.is_empty(), "{}", list.join("\n"));
}

// row 30
#[test]
fn a_component_that_no_run_determines_has_no_polynomial_and_is_told() {
    let files: Vec<_> = (0..3).map(|i| opf_at(i, Some(DEGC[i]), [1.0, 2.0, f64::NAN])).collect();
    let case = folder(&files);
    let (tof, stderr) = thermal(&case, &[], TOF);
    says(&stderr, &["b_off_z is not determined in enough of the runs"]);
    assert!(number(&tof, "b_off_z.0").is_nan() && tof.get("b_off_x").is_some());
    clean(&case);
}

// rows 10, 31
#[test]
fn a_parameter_file_with_a_nan_is_refused_or_told() {
    let mut files: Vec<_> = (0..3).map(|i| cpf_at(i, Some(DEGC[i]), 1.0)).collect();
    files[1].1 = files[1].1.replace("xi_xz = 90.2", "xi_xz = nan");
    let case = folder(&files);
    let stderr = messages(&case.run("thermal", &["--no-plots"]));
    let about_it = stderr.contains(&files[1].0) || stderr.contains("xi_xz");
    assert!(about_it, "nothing is said of it: {stderr}");
}

// row 31
#[test]
fn folders_and_parameter_files_without_content_are_refused() {
    thermal_refused(&[], "campaign", &[]).unreadable().says(&["neither runs nor parameter files", "check the path"]);
    let other = ("README.txt".to_owned(), "nothing".to_owned());
    thermal_refused(&[other], "campaign", &[]).unreadable().says(&["neither runs nor parameter files"]);
    for (content, words) in [
        ("", "`format`"),
        ("format = \"CPF\"\nversion = 1\n", "`run`"),
        ("format = \"CPF\"\nversion = 2\n", "version 2"),
        ("format = \"TPF\"\nversion = 1\n", "format TPF"),
        ("CCR 1\n", "not a parameter file"),
    ] {
        let file = (format!("PARAMETER_LIN__{}.CPF", id(0)), content.to_owned());
        thermal_refused(std::slice::from_ref(&file), &file.0, &[]).unreadable().says(&[words]);
    }
    let (name, content) = cpf_at(0, Some(20.0), 1.0);
    let changed = (name.clone(), content.replace("version = 1\n", "version = 1\ncontent_sha256 = \"00\"\n"));
    thermal_refused(&[changed], &name, &[]).unreadable().says(&["changed after it was written"]);
    let case = Case::new();
    let missing = case.path().join("nothing");
    let run = |_: &[&str]| calfit().arg("thermal").arg(&missing).arg("-o").arg(case.out()).output().unwrap();
    refused(&case, "nothing", &OLDER_THERMAL, run).unreadable().says(&["No such file"]);
}

// row 31
#[test]
fn a_bad_parameter_file_is_named_and_the_others_are_used() {
    let mut files: Vec<_> = (0..4).map(|i| cpf_at(i, Some(DEGC[i]), 1.0)).collect();
    files[3].1.clear();
    let case = folder(&files);
    let output = case.run("thermal", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["error: ", &files[3].0, "`format`", "1 of 4"]);
    let tpf = parameters(&case.out().join(TPF));
    assert_eq!([0, 1].map(|i| number(&tpf, &format!("valid_degc.{i}"))), [-60.0, 60.0]);
    assert_eq!(listed(&tpf, "used").len(), 3);
}

// row 31
#[test]
fn quantities_that_do_not_change_have_constant_polynomials() {
    let files: Vec<_> = (0..4).map(|i| opf_at(i, Some(DEGC[i]), [1.0, 2.0, 3.0])).collect();
    let case = folder(&files);
    let (tof, _) = thermal(&case, &[], TOF);
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        let coefficients = tof[&format!("b_off_{axis}")].as_array().unwrap();
        assert_eq!(coefficients.len(), 1);
        assert!((coefficients.get(0).unwrap().as_float().unwrap() - [1.0, 2.0, 3.0][i]).abs() < 1e-12);
    }
    clean(&case);
}
