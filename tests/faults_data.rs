//! Data that are readable and wrong: units, clocks, losses, settings of another run, stuck and swapped axes. The rows are those of
//! the table of faults that the tool promises to handle.

use crate::common;

use calfit::data::error::Severity;
use calfit::data::plateau::{Cut, Settling};
use calfit::files::ccr;
use calfit::measure::lin;
use calfit::workflow::RunResult;
use common::check::{Case, cpf, error_of, fit, fit_with, fitted_sigma, number, read, refused, says, sigma, three};
use common::check::{calfit, close, numbers, text};
use common::{Plan, Run, Truth, good, line, line_of, programme, small, with_cell, with_line};
use proptest::prelude::*;

fn few(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// Noise of a plateau mean is 0.003 enT, so a sensitivity is known to 1e-6 and this is far outside.
const SIGMA_TOLERANCE: f64 = 1e-5;

/// The parameter file of a run that must be accepted, with the messages.
#[track_caller]
fn accepted(run: &Run, arguments: &[&str]) -> (toml_edit::DocumentMut, String) {
    let case = Case::of(run.text());
    let stderr = case.done(arguments);
    (case.cpf(), stderr)
}

fn dropped(document: &toml_edit::DocumentMut) -> Vec<(i64, String)> {
    let Some(list) = document.get("dropped").and_then(|d| d.as_array_of_tables()) else { return Vec::new() };
    list.iter().map(|d| (d["block"].as_integer().unwrap(), d["reason"].as_str().unwrap().to_owned())).collect()
}

#[test]
fn the_truth_comes_back_in_every_position() {
    for axes in [["+X", "+Y", "+Z"], ["-Z", "+Y", "+X"], ["-X", "-Y", "+Z"]] {
        let truth = Truth { axes, ..Truth::default() };
        let case = Case::of(Plan { truth: truth.clone(), ..Plan::default() }.run().text());
        case.put("campaign.toml", format!("[[position]]\nid = 1\naxes = {axes:?}\n"));
        case.done(&[]);
        let cpf = case.cpf();
        close(sigma(&cpf), truth.sigma, SIGMA_TOLERANCE);
        close(["xy", "xz", "yz"].map(|n| number(&cpf, &format!("angle_deg.xi_{n}"))), truth.xi_deg, 1e-3);
        let turned = ["lambda_x", "mu_y", "nu_z"].map(|n| number(&cpf, &format!("angle_deg.{n}")));
        close(turned, truth.rotation_angles_deg(), 1e-3);
        for row in 0..3 {
            close(three(&cpf, &format!("matrix.rho.{row}")), truth.rotation()[row], 2e-5);
        }
        close(three(&cpf, "offset.b_or_ent"), truth.offset_ent, 0.01);
        assert_eq!(number(&cpf, "quality.blocks_used"), 22.0);
        assert!(cpf["warnings"].as_array().unwrap().is_empty(), "{}", cpf["warnings"]);
    }
}

// row 18
#[test]
fn units_must_be_stated_and_known() {
    refused(good().without_key("unit").text(), &[]).unreadable().says(&["`unit`", "missing"]);
    for unit in ["uT", "nT", "V", "ENT", ""] {
        let text = good().key("unit", &format!("\"{unit}\"")).text();
        let at = text.lines().position(|l| l.starts_with("unit")).unwrap() as u64 + 1;
        refused(text, &[]).unreadable().at(at, 8).found(&format!("\"{unit}\"")).says(&["`unit`", "enT", "counts"]);
    }
    refused(good().key("unit", "\"counts\"").text(), &[]).unreadable().says(&["`nominal_factor`", "missing"]);
    for factor in ["0.0", "-0.5"] {
        refused(good().in_counts(0.5).key("nominal_factor", factor).text(), &[])
            .unreadable()
            .says(&["`nominal_factor`", "positive"]);
    }
    // A wrong rate is one fault, however often it comes to light.
    let case = Case::of(good().key("sample_rate", "100.0").text());
    let output = calfit().arg("check").arg(case.file()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(text(&output.stderr).matches("away from the sample counter").count(), 1, "{}", text(&output.stderr));
    refused(good().without_key("sample_rate").text(), &[]).unreadable().says(&["`sample_rate`", "missing"]);
    refused(good().key("sample_rate", "-128.0").text(), &[]).unreadable().says(&["`sample_rate`", "positive"]);
}

// row 18
#[test]
fn counts_with_their_factor_give_the_same_sensitivities() {
    let (cpf, _) = accepted(&good().in_counts(0.0625), &[]);
    close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
    close(three(&cpf, "offset.b_or_ent"), Truth::default().offset_ent, 0.01);
}

// row 18
#[test]
fn counts_that_are_called_ent_are_refused() {
    for factor in [0.0625, 0.5, 2.0, 1000.0] {
        let text = good().in_counts(factor).key("unit", "\"enT\"").text();
        refused(text, &[]).by_analysis().says(&["sensitivity", "far from 1", "`unit`", "--allow gain"]);
    }
}

// row 18
#[test]
fn settings_in_another_unit_are_refused() {
    let mut run = good();
    run.settings.iter_mut().for_each(|s| s.field = s.field.map(|b| b / 1000.0));
    refused(run.text(), &[]).by_analysis().says(&["sensitivity", "far from 1"]);
}

// row 18
#[test]
fn an_allowed_gain_is_recorded() {
    let run = good().in_counts(0.5).key("unit", "\"enT\"");
    let (cpf, _) = accepted(&run, &["--allow", "gain"]);
    close(sigma(&cpf), Truth::default().sigma.map(|s| 0.5 * s), SIGMA_TOLERANCE);
    says(cpf["provenance"]["command"].as_str().unwrap(), &["--allow gain"]);
}

/// Numbers of a fit without the sentences about it.
fn fitted(run: &Run) -> (String, Vec<String>) {
    let mut lin = fit(run.text()).unwrap();
    let warnings = std::mem::take(&mut lin.notes).iter().map(ToString::to_string).collect();
    (serde_json::to_string(&lin.view()).unwrap(), warnings)
}

proptest! {
    #![proptest_config(few(12))]

    // row 19
    #[test]
    fn a_few_repeated_rows_are_counted_named_and_left_out(places in prop::collection::btree_set(1_usize..5600, 1..=10)) {
        let run = places.iter().rev().fold(good(), |run, place| run.repeat(*place));
        let (with, warnings) = fitted(&run);
        let (without, _) = fitted(&good());
        prop_assert_eq!(with, without);
        let begin = line_of(&run.text(), "@VECTORS", 1);
        let warning = warnings.iter().find(|w| w.contains("repeat")).unwrap();
        prop_assert!(warning.contains(&format!("{} rows", places.len())), "{}", warning);
        // The second of two equal rows, below the repeated rows before it.
        for (before, place) in places.iter().enumerate().take(3) {
            let line = begin + (place + before) as u64 + 1;
            prop_assert!(warning.contains(&line.to_string()), "{} is not in {}", line, warning);
        }
    }

    // row 19
    #[test]
    fn many_repeated_rows_are_refused(places in prop::collection::btree_set(1_usize..5600, 11..60)) {
        let run = places.iter().rev().fold(good(), |run, place| run.repeat(*place));
        let finding = error_of(run.text());
        prop_assert!(finding.rule.contains(&format!("{} rows repeat", places.len())), "{}", finding);
        prop_assert!(finding.remedy.contains("--allow duplicates"), "{}", finding);
    }
}

// row 19
#[test]
fn many_repeated_rows_leave_no_output_unless_they_are_allowed() {
    let run = (0..40).fold(good(), |run, i| run.repeat(100 + 50 * i));
    refused(run.text(), &[]).unreadable().says(&["40 rows repeat", "--allow duplicates"]);
    let (cpf, stderr) = accepted(&run, &["--allow", "duplicates"]);
    says(&stderr, &["40 rows repeat"]);
    says(cpf["provenance"]["command"].as_str().unwrap(), &["--allow duplicates"]);
    close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
}

// row 19
#[test]
fn repeated_time_stamps_are_counted() {
    let mut run = good();
    for i in [500, 1500, 2500] {
        run.samples[i].t = run.samples[i - 1].t;
    }
    let (_, stderr) = accepted(&run, &[]);
    let warned =
        stderr.lines().any(|l| l.starts_with("warning: ") && l.contains('3') && (l.contains("time") || l.contains("stamp")));
    assert!(warned, "no warning about 3 repeated time stamps: {stderr:?}");
}

proptest! {
    #![proptest_config(few(16))]

    // row 20
    #[test]
    fn a_counter_or_a_time_that_goes_back_is_refused(at in 2_usize..5600, back in 2_usize..5000, clock_only in any::<bool>()) {
        let mut run = good();
        let back = back.min(at);
        for i in at..run.samples.len() {
            run.samples[i].t -= (back + 3) as f64 / 128.0;
            if !clock_only {
                run.samples[i].n -= back as u64;
            }
        }
        run.samples.iter_mut().for_each(|s| s.t += 100.0);
        let text = run.text();
        let finding = error_of(&text);
        prop_assert_eq!(finding.line, Some(line_of(&text, "@VECTORS", at + 1)));
        prop_assert!(finding.rule.contains("back"), "{}", finding);
        prop_assert!(finding.remedy.contains("split"), "{}", finding);
    }
}

// row 20
#[test]
fn two_files_joined_are_refused() {
    let text = good().text();
    let rows = line_of(&text, "@VECTORS", 1);
    let lines = text.lines().count() as u64;
    let begin = text.split_inclusive('\n').take(rows as usize - 1).map(str::len).sum::<usize>();
    let body = &text[begin..text.len() - "@END\n".len()];
    refused(format!("{}{body}@END\n", &text[..begin + body.len()]), &[])
        .unreadable()
        .at(lines, 1)
        .found(body.lines().next().unwrap())
        .says(&["goes back", "split"]);
    refused(format!("{text}{text}"), &[]).unreadable().in_line(lines + 1).found("CCR 1").says(&["after @END", "split"]);
}

proptest! {
    #![proptest_config(few(12))]

    // row 21
    #[test]
    fn gaps_are_counted_and_a_plateau_with_too_few_samples_is_dropped(
        plateau in 1_usize..21,
        from in 10_usize..40,
        much in any::<bool>(),
    ) {
        let lost = if much { 60 } else { 8 };
        let run = good();
        let first = run.samples_of(plateau).start + from;
        let time = run.samples[first + lost].t;
        let run = run.lose(first..first + lost);
        let text = run.text();
        let lin = fit(&text).unwrap();
        let quality = &lin.calibration.quality;
        prop_assert_eq!(quality.lost_samples, lost as u64);
        let warning = format!("{lost} samples are missing in 1 gap");
        prop_assert!(lin.notes.iter().any(|n| n.to_string().contains(&warning)));
        let blocks: Vec<usize> = lin.dropped.iter().map(|d| d.block).collect();
        prop_assert_eq!(blocks, if much { vec![plateau + 1] } else { vec![] });
        prop_assert_eq!(quality.blocks_used, if much { 21 } else { 22 });
        let case = Case::of(&text);
        let account = read(&case.file(), &mut ()).unwrap().vectors;
        prop_assert_eq!(account.gaps.len(), 1);
        prop_assert_eq!(account.gaps[0].line, line_of(&text, "@VECTORS", first + 1));
        prop_assert!((account.gaps[0].t_s - time).abs() < 1e-3);
        for (found, wanted) in fitted_sigma(&lin).into_iter().zip(Truth::default().sigma) {
            prop_assert!((found - wanted).abs() < SIGMA_TOLERANCE);
        }
    }
}

// row 21
#[test]
fn a_plateau_dropped_for_its_gaps_is_listed_in_the_output() {
    let run = good();
    let samples = run.samples_of(5);
    let case = Case::of(run.lose(samples.start + 20..samples.start + 120).text());
    says(&case.done(&[]), &["100 samples are missing in 1 gap"]);
    let cpf = case.cpf();
    let list = dropped(&cpf);
    assert_eq!((list.len(), list[0].0), (1, 6));
    says(&list[0].1, &["60.9 %"]);
    let files = common::check::tree(&case.out());
    let report = files.iter().find(|(name, _)| name.ends_with(".md")).unwrap().1;
    says(&common::check::text(report), &["60.9 %", "100 samples lost"]);
}

// row 21
#[test]
fn check_names_the_row_behind_every_gap() {
    // Six gaps of one to six samples; those that follow are made first, so that the numbers of the others stay.
    let begin = |k: usize| 100 + 300 * k;
    let text_of_run = (0..6).rev().fold(good(), |run, k| run.lose(begin(k)..begin(k) + k + 1)).text();
    let case = Case::of(&text_of_run);
    let output = calfit().arg("check").arg(case.file()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let stderr = text(&output.stderr);
    for k in 0..5 {
        let before: usize = (1..=k).sum();
        let row = line_of(&text_of_run, "@VECTORS", begin(k) - before + 1);
        let samples = if k == 0 { "1 sample is".to_owned() } else { format!("{} samples are", k + 1) };
        says(&stderr, &[&format!("09-22-38.CCR:{row}:1: {samples} missing before this row, at ")]);
    }
    says(&stderr, &["6 samples are missing in 1 gap behind these"]);
    let case = Case::of(good().text());
    let output = calfit().arg("check").arg(case.file()).output().unwrap();
    assert!(!text(&output.stderr).contains("missing"), "{}", text(&output.stderr));
}

// row 22
#[test]
fn a_wrong_sample_rate_is_measured_and_refused() {
    for true_rate in [100.0, 120.0, 127.0, 64.0, 256.0] {
        let run = Plan { rate_hz: true_rate, ..Plan::default() }.run().key("sample_rate", "128.0");
        let refusal = refused(run.text(), &[]).unreadable().says(&["128 Hz", "`sample_rate`"]);
        let rate: f64 = refusal.stderr.split("so far ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
        assert!((rate - true_rate).abs() < 0.02 * true_rate, "{}", refusal.stderr);
    }
}

// row 22
#[test]
fn a_wrong_sample_rate_behind_coarse_times_is_refused() {
    for (rate_hz, step) in [(100.0, 0.1), (100.0, 1.0), (120.0, 0.1), (120.0, 1.0)] {
        let run = Plan { rate_hz, ..Plan::default() }.run().coarse(step).key("sample_rate", "128.0");
        let message = fit(run.text()).expect_err(&format!("{rate_hz} Hz in steps of {step} s: accepted"));
        let told = message.contains("128 Hz") && message.contains("`sample_rate`");
        assert!(told, "{rate_hz} Hz in steps of {step} s: {message}");
    }
}

// row 22
#[test]
fn times_of_a_coarse_time_column_are_rebuilt_from_the_counter() {
    for (step, name) in [(0.1, "0.1"), (0.5, "0.5")] {
        let (cpf, stderr) = accepted(&good().coarse(step), &[]);
        let warned = stderr.lines().any(|l| l.starts_with("warning: ") && l.contains("time column") && l.contains(name));
        assert!(warned, "{stderr}");
        close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
    }
}

// row 23
#[test]
fn settings_of_another_run_are_refused() {
    let mut run = good();
    let fields: Vec<[f64; 3]> = run.settings.iter().map(|s| s.field).collect();
    for (i, s) in run.settings.iter_mut().enumerate() {
        s.field = fields[(7 * i + 3) % fields.len()];
    }
    refused(run.text(), &[]).by_analysis().says(&["does not follow the applied field", "settings", "--allow mismatch"]);
}

/// How many seconds the data come after the settings, as a message says.
#[track_caller]
fn stated_shift(message: &str) -> f64 {
    let words: Vec<&str> = message.split(' ').collect();
    let stated = words.windows(2).find(|w| w[0].starts_with(['+', '-']) && w[1].starts_with('s'));
    stated.unwrap_or_else(|| panic!("no shift in: {message}"))[0].parse().unwrap()
}

// row 23
#[test]
fn a_clock_offset_of_the_settings_is_found() {
    // Half a plateau, and a whole one, which no edge shows.
    for shift in [-2.0, -1.0, 1.0, 2.0] {
        refused(good().shift_settings(shift).text(), &[]).by_analysis().says(&["settings", "--allow mismatch"]);
    }
    for shift in [-0.6, 0.6] {
        let refusal = refused(good().shift_settings(shift).text(), &[]).by_analysis();
        // The data come earlier than the settings when those are late.
        assert!((stated_shift(&refusal.stderr) + shift).abs() < 0.1, "{}", refusal.stderr);
    }
}

// row 23
#[test]
fn no_clock_offset_gives_a_wrong_result() {
    let mut wrong = Vec::new();
    for tenths in (-20..=20).filter(|tenths| *tenths != 0) {
        let shift = f64::from(tenths) / 10.0;
        match fit(good().shift_settings(shift).text()) {
            Ok(lin) => {
                let worst = (0..3).map(|i| (fitted_sigma(&lin)[i] - Truth::default().sigma[i]).abs()).fold(0.0, f64::max);
                let told = lin.notes.iter().any(|n| n.to_string().contains("settings"));
                if worst > SIGMA_TOLERANCE || !told {
                    wrong.push(format!("{shift} s: accepted, off by {worst}, {:?}", lin.notes));
                }
            }
            Err(message) if message.contains("settings") && message.contains("--allow mismatch") => {}
            Err(message) => wrong.push(format!("{shift} s: {message}")),
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

// row 23
#[test]
fn an_allowed_mismatch_is_recorded() {
    let (cpf, _) = accepted(&good().shift_settings(2.0), &["--allow", "mismatch", "--allow", "gain"]);
    says(cpf["provenance"]["command"].as_str().unwrap(), &["--allow gain", "--allow mismatch"]);
}

// row 23
#[test]
fn a_small_clock_offset_is_left_out_and_told() {
    for shift in [-0.2, 0.2] {
        let (cpf, stderr) = accepted(&good().shift_settings(shift), &[]);
        assert!((stated_shift(&stderr) + shift).abs() < 0.05, "{stderr}");
        close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
    }
}

// row 23
#[test]
fn overlapping_and_reversed_settings_are_refused_with_their_line() {
    let text = good().text();
    let edit = with_cell(&text, "@FIELDS", 5, "t_start", "7.500");
    refused(edit.text, &[]).unreadable().in_line(edit.line).found("7.500,10.000").says(&["7.5", "8 s", "overlap"]);
    let edit = with_cell(&text, "@FIELDS", 5, "t_end", "8.000");
    refused(edit.text, &[]).unreadable().in_line(edit.line).found("8.000,8.000").says(&["ends before it begins"]);
    let row = line_of(&text, "@FIELDS", 5);
    let swapped = with_line(&with_line(&text, row, line(&text, row + 1)), row + 1, line(&text, row));
    refused(swapped, &[]).unreadable().in_line(row + 1).says(&["in order of time"]);
}

// row 23
#[test]
fn settings_after_the_end_of_the_data_are_dropped_or_refused() {
    let mut run = good();
    run.samples.truncate(18 * 256);
    let (cpf, _) = accepted(&run, &[]);
    let list = dropped(&cpf);
    assert_eq!(list.iter().map(|d| d.0).collect::<Vec<_>>(), [19, 20, 21, 22]);
    assert!(list.iter().all(|d| d.1.contains("no settled samples")), "{list:?}");
    let refusal = refused(good().shift_settings(1000.0).text(), &[]).by_analysis();
    says(&refusal.stderr, &["0 usable plateaus", "22 x no settled samples"]);
}

proptest! {
    #![proptest_config(few(12))]

    // row 24
    #[test]
    fn plateaus_without_samples_are_dropped_and_too_few_are_refused(empty in prop::collection::btree_set(0_usize..22, 1..=22)) {
        let run = empty.iter().rev().fold(good(), |run, setting| {
            let samples = run.samples_of(*setting);
            run.lose(samples)
        });
        let left = 22 - empty.len();
        match fit(run.text()) {
            Ok(lin) => {
                let blocks: Vec<usize> = lin.dropped.iter().map(|d| d.block - 1).collect();
                prop_assert_eq!(blocks, empty.into_iter().collect::<Vec<_>>());
                prop_assert_eq!(lin.calibration.quality.blocks_used, left);
                // Three responses, an offset, its slope and its curvature.
                prop_assert!(left > 6);
                // What few settings are left may know an axis badly; then its uncertainty must say so.
                let std = lin.calibration.std.sigma;
                for ((found, wanted), std) in fitted_sigma(&lin).into_iter().zip(Truth::default().sigma).zip(std) {
                    prop_assert!((found - wanted).abs() < 5.0 * std, "{} ± {} is not {}", found, std, wanted);
                }
            }
            // What is left may also miss an axis.
            Err(message) if left > 6 => prop_assert!(message.contains("does not determine"), "{}", message),
            Err(message) => prop_assert!(message.contains(&format!("{left} usable plateaus")), "{}", message),
        }
    }
}

// row 24
#[test]
fn plateaus_shorter_than_the_settling_time_are_refused_with_a_remedy() {
    let refusal = refused(good().text(), &["--settling", "2.5"]).by_analysis();
    says(&refusal.stderr, &["0 usable plateaus", "no settled samples"]);
    let remedies = ["--settling", "--coverage", "limits"];
    assert!(remedies.iter().any(|r| refusal.stderr.contains(r)), "no remedy in: {}", refusal.stderr);
}

/// A source or sensor that drifts by 4e-4 while one axis after the other is driven leaves a third of that in the sensitivities of every axis.
#[test]
fn a_gain_that_drifts_in_the_run_is_told() {
    let levels = [-2000.0, 1500.0, -1000.0, 500.0, 2000.0, -500.0, 1000.0, -1500.0];
    let plan = Plan { settings: programme(&levels, 8.0), rate_hz: 32.0, noise_ent: 0.3, ..Plan::default() };
    for (change, is_told) in [(0.0, false), (4e-4, true)] {
        let mut run = plan.run();
        let end_s = run.samples.last().unwrap().t;
        for sample in &mut run.samples {
            sample.reading = sample.reading.map(|reading| reading * (1.0 + change * sample.t / end_s));
        }
        let (_, stderr) = accepted(&run, &[]);
        assert_eq!(stderr.contains("grow with time in proportion to themselves"), is_told, "{stderr}");
    }
}

/// A decay as long as the settings and longer stays below the noise in every stretch of them, and moves the sensitivities by many of their
/// uncertainties; one that is seen for more than half of every setting leaves no plateau behind it.
#[test]
fn a_slow_decay_after_every_step_is_told_or_refused() {
    let levels = [-2000.0, 1500.0, -1000.0, 500.0, 2000.0, -500.0, 1000.0, -1500.0];
    let plan = Plan { settings: programme(&levels, 8.0), rate_hz: 32.0, noise_ent: 0.3, ..Plan::default() };
    let told = |stderr: &str| {
        ["the readings still follow the step before a setting", "depend on the steps of the field before"]
            .iter()
            .any(|words| stderr.contains(words))
    };
    let (_, stderr) = accepted(&plan.run(), &[]);
    assert!(!told(&stderr), "{stderr}");
    for (part, tau_s) in [(1e-4, 10.0), (1e-4, 20.0), (3e-4, 50.0)] {
        let (cpf, stderr) = accepted(&plan.run().behind(&plan.truth, &[(part, tau_s)]), &[]);
        assert!(told(&stderr), "{tau_s} s: {stderr}");
        let std = three(&cpf, "std.sigma");
        let off = |i: usize| (sigma(&cpf)[i] - plan.truth.sigma[i]).abs() / std[i];
        assert!((0..3).any(|i| off(i) > 5.0), "{tau_s} s: nothing to tell");
    }
    refused(plan.run().behind(&plan.truth, &[(3e-3, 2.0)]).text(), &[])
        .by_analysis()
        .says(&["still show the step before a setting", "--settling"]);
}

// row 25
#[test]
fn an_axis_that_is_never_driven_is_not_determined() {
    for axis in 0..3 {
        let mut settings = Plan::default().settings;
        settings.iter_mut().for_each(|s| s.field[axis] = 0.0);
        let run = Plan { settings, ..Plan::default() }.run();
        let name = ["X_c", "Y_c", "Z_c"][axis];
        let refusal = refused(run.text(), &[]).by_analysis().says(&["does not determine", name, "condition number"]);
        let others = ["X_c", "Y_c", "Z_c"].into_iter().filter(|n| *n != name);
        others.for_each(|n| assert!(!refusal.stderr.contains(n), "{}", refusal.stderr));
    }
}

// row 25
#[test]
fn axes_that_are_only_driven_together_are_not_determined() {
    let mut settings = Plan::default().settings;
    settings.iter_mut().for_each(|s| s.field[1] = s.field[0]);
    let run = Plan { settings, ..Plan::default() }.run();
    let refusal = refused(run.text(), &[]).by_analysis().says(&["does not determine", "condition number"]);
    assert!(refusal.stderr.contains("X_c") || refusal.stderr.contains("Y_c"), "{}", refusal.stderr);
}

// row 26
#[test]
fn a_stuck_axis_is_refused() {
    for component in 0..3 {
        let name = ["x", "y", "z"][component];
        refused(good().stick(component, 17.25).text(), &[]).by_analysis().says(&[&format!("component {name}"), "stuck"]);
    }
}

// row 26
#[test]
fn saturated_plateaus_are_dropped_and_counted() {
    // Levels of ±1200 and ±2000 nT are beyond the range.
    let (cpf, _) = accepted(&good().saturate(1, 900.0), &[]);
    let list = dropped(&cpf);
    assert_eq!(list.len(), 4, "{list:?}");
    assert!(list.iter().all(|d| d.1.contains("y rests at the end of its range")), "{list:?}");
    assert_eq!(number(&cpf, "quality.blocks_used"), 18.0);
    assert_eq!(number(&cpf, "quality.blocks_total"), 22.0);
    close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
}

// row 26
#[test]
fn a_single_saturated_plateau_at_either_end_is_flagged() {
    let (cpf, stderr) = accepted(&good().saturate(2, 1600.0), &[]);
    says(&stderr, &["component z", "2 plateaus"]);
    let listed = dropped(&cpf).len() == 2;
    assert!(listed || cpf["warnings"].to_string().contains("component z has no scatter"), "{stderr}");
}

proptest! {
    #![proptest_config(few(12))]

    // row 26
    #[test]
    fn spikes_are_left_out_and_counted(
        places in prop::collection::btree_set(0_usize..5632, 1..20),
        component in 0_usize..3,
        by in prop::sample::select(vec![-32768.0, -500.0, 500.0, 32768.0]),
    ) {
        let run = places.iter().fold(good(), |run, place| run.spike(*place, component, by));
        let lin = fit(run.text()).unwrap();
        let left_out = lin.calibration.quality.spike_samples;
        prop_assert!(left_out >= places.len() as u64, "{} of {}", left_out, places.len());
        prop_assert!(lin.notes.iter().any(|n| n.text.contains("spikes") && n.text.contains(&left_out.to_string())));
        for (found, wanted) in fitted_sigma(&lin).into_iter().zip(Truth::default().sigma) {
            prop_assert!((found - wanted).abs() < SIGMA_TOLERANCE, "{} is not {}", found, wanted);
        }
    }
}

// row 26
#[test]
fn a_spike_at_the_end_of_a_setting_is_no_slow_settling() {
    // The level that a setting settles to is that of its last quarter.
    let run = [0, 4058, 5568].into_iter().fold(good(), |run, place| run.spike(place, 2, -32768.0));
    let lin = fit(run.text()).unwrap();
    assert_eq!(lin.calibration.quality.blocks_used, fit(good().text()).unwrap().calibration.quality.blocks_used);
}

// row 26
#[test]
fn the_robust_option_is_recorded_and_resists_a_disturbed_plateau() {
    let run = good();
    let disturbed = run.samples_of(4).fold(run.clone(), |run, i| run.spike(i, 0, 40.0));
    let (plain, _) = accepted(&disturbed, &[]);
    assert!((sigma(&plain)[0] - 0.98).abs() > 1e-3, "the disturbance does not matter");
    assert!(plain["quality"].get("downweighted_blocks").is_none());
    let (robust, _) = accepted(&disturbed, &["--robust"]);
    says(robust["provenance"]["command"].as_str().unwrap(), &["--robust"]);
    assert!(number(&robust, "quality.downweighted_blocks") >= 1.0);
    close(sigma(&robust), Truth::default().sigma, 1e-4);
}

/// Warnings on standard error, in the parameter file and in the report.
#[track_caller]
fn warned_everywhere(run: &Run, words: &[&str]) {
    let case = Case::of(run.text());
    let stderr = case.done(&[]);
    let files = common::check::tree(&case.out());
    let report = files.iter().find(|(name, _)| name.ends_with(".md")).unwrap().1;
    for place in [&stderr, &case.cpf()["warnings"].to_string(), &common::check::text(report)] {
        says(place, words);
    }
}

// row 27
#[test]
fn swapped_and_reversed_axes_are_warned_of_loudly() {
    warned_everywhere(&good().swap(1, 2), &["AXES", "left-handed", "component y looks along the nominal +z axis"]);
    warned_everywhere(&good().reverse(0), &["AXES", "left-handed", "component x looks along the nominal -x axis"]);
    // Two signs make a proper rotation, which no determinant shows.
    warned_everywhere(&good().reverse(0).reverse(2), &["AXES", "component x looks along the nominal -x axis", "nominal -z axis"]);
    warned_everywhere(&good().swap(0, 1).swap(1, 2), &["AXES", "component x looks along the nominal +y axis"]);
}

// row 30
#[test]
fn an_absent_temperature_is_told_and_marks_no_range() {
    let mut empty = good();
    empty.temperatures.iter_mut().for_each(|t| t.1 = [None, None]);
    for run in [good().without_section("@TEMPERATURES"), empty] {
        let (cpf, stderr) = accepted(&run, &[]);
        says(&stderr, &["no sensor temperature", "T59", "no coil system temperature", "T29"]);
        says(&cpf["warnings"].to_string(), &["no sensor temperature"]);
        assert!(common::check::number(&cpf, "run.temperature_degc").is_nan());
        assert!(cpf["valid"].get("temperature_degc").is_none());
        close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
    }
}

// row 30
#[test]
fn a_temperature_record_shorter_than_the_run_is_told_and_its_range_marked() {
    let mut run = good().warming();
    run.temperatures.truncate(3);
    let (cpf, stderr) = accepted(&run, &[]);
    says(&stderr, &["T59", "0 to 22 s only"]);
    says(&cpf["warnings"].to_string(), &["0 to 22 s only"]);
    assert_eq!([0, 1].map(|i| number(&cpf, &format!("valid.temperature_degc.{i}"))), [24.0, 24.5]);
    assert_eq!(number(&cpf, "run.temperature_degc"), 24.25);
}

// row 31
#[test]
fn files_without_data_have_messages_of_their_own() {
    let text = good().text();
    let keys: String = text.lines().take_while(|l| !l.starts_with('@')).map(|l| format!("{l}\n")).collect();
    refused("", &[]).unreadable().says(&["the file is empty"]);
    for nothing in ["\n", "\n\n\n", " ", "# a remark\n"] {
        refused(nothing, &[]).unreadable().in_line(1).says(&["not a run file", "`CCR 1`"]);
    }
    refused("CCR 2\n@END\n", &[]).unreadable().at(1, 1).found("CCR 2").says(&["version"]);
    refused("CCR 1\n", &[]).unreadable().says(&["without @END"]);
    refused("CCR 1\n@END\n", &[]).unreadable().says(&["`run`", "missing"]);
    refused(&keys, &[]).unreadable().says(&["without @END"]);
    refused(format!("{keys}@END\n"), &[]).by_analysis().says(&["no plateaus", "@FIELDS", "@VECTORS"]);
}

// row 31
#[test]
fn sections_without_rows_have_messages_of_their_own() {
    let mut run = good();
    run.samples.clear();
    refused(run.text(), &[]).by_analysis().says(&["0 usable plateaus", "no settled samples", "@VECTORS", "with its samples"]);
    let mut run = good();
    run.samples.truncate(1);
    refused(run.text(), &[]).by_analysis().says(&["usable plateaus"]);
    let mut run = good();
    run.settings.clear();
    refused(run.text(), &[]).by_analysis().says(&["no plateaus"]);
    let mut run = good();
    run.settings.truncate(1);
    refused(run.text(), &[]).by_analysis().says(&["1 usable plateaus"]);
    refused(good().without_section("@VECTORS").text(), &[]).by_analysis().says(&["usable plateaus"]);
    refused(good().without_section("@FIELDS").text(), &[]).by_analysis().says(&["no plateaus"]);
    let (section, header) = (small().text(), "@VECTORS\nn,t,x,y,z\n");
    let cut = section.split_inclusive(header).next().unwrap().replace("n,t,x,y,z\n", "@END\n");
    refused(cut, &[]).says(&["09-22-38.CCR"]);
}

// row 31
#[test]
fn constant_readings_are_refused() {
    refused(good().each(|_| [1.0, 2.0, 3.0]).text(), &[]).by_analysis().says(&["component x", "stuck"]);
    refused(good().each(|_| [0.0; 3]).text(), &[]).by_analysis().says(&["component x", "stuck"]);
}

// row 31
#[test]
fn readings_without_any_noise_still_have_a_calibration() {
    let run = Plan { noise_ent: 0.0, ..Plan::default() }.run();
    let (cpf, stderr) = accepted(&run, &[]);
    says(&stderr, &["no scatter"]);
    close(sigma(&cpf), Truth::default().sigma, SIGMA_TOLERANCE);
    let numbers = numbers(&cpf);
    let bad: Vec<&str> = numbers.lines().filter(|l| l.contains(" nan") || l.contains("inf")).collect();
    assert!(bad.is_empty(), "{bad:?}");
}

// row 31
#[test]
fn a_zero_field_programme_determines_nothing() {
    let run = Plan { settings: programme(&[0.0, 0.0], 2.0), ..Plan::default() }.run();
    refused(run.text(), &[]).by_analysis().says(&["does not determine", "X_c", "Y_c", "Z_c"]);
}

// rows 19 to 26: what the library says and what the tool says is the same.
#[test]
fn options_of_the_library_and_of_the_command_agree() {
    let case = Case::of(good().text());
    case.done(&["--settling", "0.5", "--order", "1"]);
    let options = lin::Options {
        cut: Cut { settling: Settling::Given(0.5), ..Cut::default() },
        trend_order: Some(1),
        ..lin::Options::default()
    };
    let lin = fit_with(&case.file(), &ccr::Options::default(), &options).unwrap();
    assert_eq!(sigma(&cpf(&case.out(), common::RUN_ID)), fitted_sigma(&lin));
    assert!(read(&case.file(), &mut ()).unwrap().findings.iter().all(|f| f.severity == Severity::Note));
}
