//! What is around the program: outputs that are closed or full, limits of memory and of the size of files, names that files bring, links and
//! pipes. What comes out does not depend on where and when it runs.

use crate::common;

use common::check::{Case, calfit, copy, cpf, data, process, says, text, tree};
use common::{Plan, RUN_ID, good};
use std::collections::BTreeMap;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::process::Output;
use std::time::Duration;

/// The program in a shell that prepares its surroundings; `$@` is the program with its arguments.
fn in_shell(script: &str, arguments: &[&str], paths: &[&Path]) -> Output {
    assert_cmd::Command::new("sh")
        .args(["-c", script, "sh", env!("CARGO_BIN_EXE_calfit")])
        .args(arguments)
        .args(paths)
        .timeout(Duration::from_secs(60))
        .output()
        .unwrap()
}

#[test]
fn an_output_that_takes_nothing_is_an_error_where_it_was_asked_for() {
    let case = Case::of(good().text());
    let campaign = case.campaign();
    let lin = |script: &str, out: &str, more: &[&str]| {
        let out = case.path().join(out);
        (in_shell(script, &[&["lin", "--no-plots"], more].concat(), &[&campaign, Path::new("-o"), &out]), out)
    };
    // Closed: said before the work.
    let (output, out) = lin("exec \"$@\" >&-", "closed", &["--json"]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["standard output: cannot be written"]);
    assert!(tree(&out).is_empty());
    // Full: the results are there, and the status says that nobody was told.
    let (output, out) = lin("exec \"$@\" >/dev/full", "full", &["--json"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["cannot write to standard output"]);
    cpf(&out, RUN_ID);
    // Who wants no output has none.
    assert_eq!(lin("exec \"$@\" >&-", "quiet", &[]).0.status.code(), Some(0));
    assert_eq!(lin("exec \"$@\" >/dev/null", "null", &["--json"]).0.status.code(), Some(0));
    for arguments in [&["--help"][..], &["lin", "--help"], &["--version"]] {
        for script in ["exec \"$@\" >/dev/full", "exec \"$@\" >&-"] {
            let output = in_shell(script, arguments, &[]);
            assert_eq!(output.status.code(), Some(1), "{arguments:?} {script}");
            says(&text(&output.stderr), &["cannot write to standard output"]);
        }
    }
}

// row 36
#[test]
fn a_file_beyond_the_limit_of_its_size_is_an_error_and_leaves_nothing() {
    let case = Case::of(good().text());
    let out = case.out();
    let output = in_shell("ulimit -f 2; exec \"$@\"", &["lin", "--no-plots"], &[&case.campaign(), Path::new("-o"), &out]);
    assert!(matches!(output.status.code(), Some(1 | 2)), "{:?}: {}", output.status, text(&output.stderr));
    says(&text(&output.stderr), &["cannot write", "ulimit -f"]);
    assert!(tree(&out).keys().all(|name| !name.contains("partial") && !name.ends_with(".CPF")), "{:?}", tree(&out).keys());
}

// row 37
#[test]
fn a_file_that_needs_more_memory_than_there_is_is_refused_before_it_is_read() {
    let case = Case::of(good().text());
    // A file of holes takes no place on the disk.
    fs::File::options().write(true).open(case.file()).unwrap().set_len(1 << 40).unwrap();
    let output = calfit().args(["diagnose", "--no-plots", "-o"]).arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["09-22-38.CCR: needs about", "MB of memory, which are not to be had"]);
}

// row 37
#[test]
fn a_report_that_needs_more_memory_than_there_is_is_refused_before_it_begins() {
    let case = Case::of(good().text());
    let day = case.file().parent().unwrap().to_owned();
    for number in 0..6000 {
        let (hour, minute, second) = (10 + number / 3600, number / 60 % 60, number % 60);
        fs::write(day.join(format!("{hour:02}-{minute:02}-{second:02}.CCR")), "").unwrap();
    }
    let out = case.out();
    let output = in_shell("ulimit -v 600000; exec \"$@\"", &["report", "--no-plots"], &[&case.campaign(), Path::new("-o"), &out]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["campaign: needs about", "MB of memory, which are not to be had"]);
}

// rows 41, 47
#[test]
fn nothing_is_written_or_read_through_links_and_pipes_in_a_result_folder() {
    for (name, is_link) in [(".calfit.lock", true), (".calfit.lock", false), ("INDEX.json", false)] {
        let case = Case::of(good().text());
        fs::create_dir(case.out()).unwrap();
        let elsewhere = case.path().join("elsewhere");
        let place = case.out().join(name);
        if is_link {
            symlink(&elsewhere, &place).unwrap();
        } else {
            assert!(std::process::Command::new("mkfifo").arg(&place).status().unwrap().success());
        }
        let output =
            in_shell("exec timeout 20 \"$@\"", &["lin", "--no-plots"], &[&case.campaign(), Path::new("-o"), &case.out()]);
        assert_eq!(output.status.code(), Some(2), "{name}: {}", text(&output.stderr));
        says(&text(&output.stderr), &[name]);
        assert!(!elsewhere.exists());
    }
}

// row 41
#[test]
fn a_campaign_names_no_files_outside_of_it_unless_it_says_so() {
    let case = Case::of(good().text());
    let table = fs::read_to_string(data("tests/data/rosetta/pt1000_table.csv")).unwrap();
    fs::write(case.path().join("outside.csv"), &table).unwrap();
    case.put("inside.csv", &table);
    symlink(case.path().join("outside.csv"), case.campaign().join("link.csv")).unwrap();
    let absolute = case.path().join("outside.csv").display().to_string();
    let report = |toml: &str| {
        case.put("campaign.toml", toml);
        let checked = calfit().arg("check").arg(case.campaign().join("campaign.toml")).output().unwrap();
        (case.run("report", &["--no-plots"]), checked)
    };
    for name in ["../outside.csv", &absolute, "link.csv"] {
        for toml in [format!("[report]\nthermistors = [\"{name}\"]\n"), format!("[[thermistor]]\ntable = \"{name}\"\n")] {
            let (output, checked) = report(&toml);
            for output in [output, checked] {
                assert_ne!(output.status.code(), Some(0), "{toml}");
                says(&text(&output.stderr), &["names a file outside the campaign", "outside = true"]);
            }
            assert!(tree(&case.out()).keys().all(|file| !file.starts_with("THERMISTOR")));
        }
    }
    for toml in ["[[thermistor]]\ntable = \"../outside.csv\"\noutside = true\n", "[report]\nthermistors = [\"inside.csv\"]\n"] {
        let (output, checked) = report(toml);
        assert_eq!((output.status.code(), checked.status.code()), (Some(0), Some(0)), "{}", text(&output.stderr));
    }
}

// row 48
#[test]
fn names_from_files_act_neither_on_terminals_nor_on_viewers_nor_on_spreadsheets() {
    const NAME: &str = "=cmd|\u{1b}[31m\u{9b}<script>alert(1)</script>\u{202e}](javascript:x) `a`";
    let case = Case::of(good().key("sensor", &toml_edit::Value::from(NAME).to_string()).text());
    case.put("campaign.toml", format!("name = {}\n[report]\ntitle = {0}\n", toml_edit::Value::from(NAME)));
    let output = case.run("report", &["--no-plots", "-v"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let is_bare = |text: &str| !text.contains(|c: char| (c.is_control() && c != '\n' && c != '\t') || c == '\u{202e}');
    let mut shown = BTreeMap::from([("stdout".to_owned(), output.stdout), ("stderr".to_owned(), output.stderr)]);
    for (name, arguments) in [("inspect", &["inspect"][..]), ("inspect --json", &["inspect", "--json"]), ("check", &["check"])] {
        let output = calfit().args(arguments).arg(case.campaign()).output().unwrap();
        shown.insert(name.to_owned(), output.stdout);
        shown.insert(format!("{name}, messages"), output.stderr);
    }
    let is_read_by_people = |name: &str| [".md", ".html", ".csv"].iter().any(|end| name.ends_with(end));
    shown.extend(tree(&case.out()).into_iter().filter(|(name, _)| is_read_by_people(name)));
    for (name, bytes) in &shown {
        let text = String::from_utf8(bytes.clone()).unwrap();
        assert!(is_bare(&text), "{name}: {text}");
        if name.ends_with(".html") {
            assert!(!text.contains("<script"), "{name}");
        }
        if name.ends_with(".md") {
            // Behind a backslash it is text, and between backticks.
            let marked = text.replace("\\<script", "");
            assert!(marked.lines().all(|line| !line.contains("<script") || line.contains("``")), "{name}: {text}");
        }
        if name.ends_with(".csv") {
            let cells = text.lines().flat_map(|line| line.split(','));
            assert!(cells.clone().all(|cell| !cell.trim_matches('"').starts_with(['=', '@'])), "{name}: {text}");
        }
    }
    assert!(shown.keys().any(|name| name.ends_with(".csv")) && shown.keys().any(|name| name.ends_with("REPORT.html")));
    serde_json::from_slice::<serde_json::Value>(&shown["inspect --json"]).unwrap();
}

#[test]
fn output_does_not_depend_on_the_time_zone_the_folder_and_the_order_of_the_files() {
    let runs = [("09-22-38", 1), ("10-00-00", 2), ("11-00-00", 3)];
    let made = |order: &[usize], folder: &str, zone: &str, by_name: bool| {
        let case = Case::new();
        let root = case.path().join(folder);
        for &i in order {
            let (time, seed) = runs[i];
            let run = Plan { seed, ..Plan::default() }.run().named(&format!("13-04-03_{time}"));
            case.put(&format!("13-04-03/{time}.CCR"), run.text());
        }
        fs::create_dir_all(root.parent().unwrap()).unwrap();
        copy(&case.campaign(), &root.join("campaign"));
        let mut command = process();
        command.env("TZ", zone).env("SOURCE_DATE_EPOCH", "1700000000").current_dir(&root).args(["lin", "--json", "-o", "out"]);
        if by_name {
            let names = order.iter().map(|&i| format!("campaign/13-04-03/{}.CCR", runs[i].0));
            command.args(names);
        } else {
            command.arg("campaign");
        }
        let output = command.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        (tree(&root.join("out")), output.stdout)
    };
    let first = made(&[0, 1, 2], "a", "UTC", false);
    assert!(first.0.keys().any(|name| name.ends_with(".png")));
    assert!(first == made(&[2, 0, 1], "b/c d", "Asia/Kathmandu", false));
    let (named, stdout) = made(&[1, 2, 0], "e", "America/St_Johns", true);
    assert!(named.keys().eq(first.0.keys()) && stdout == first.1);
    assert!(named.iter().all(|(name, bytes)| name == "INDEX.json" || first.0[name] == *bytes));
}
