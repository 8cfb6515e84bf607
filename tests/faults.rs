//! Files that are no files, that change, that are compressed; campaigns with a bad run; what must not depend on locale, threads or
//! the order of sections. The rows are those of the table of faults that the tool promises to handle.

use crate::common;

use calfit::data::plateau::Accumulator;
use calfit::data::run::{Vector, VectorSink};
use calfit::files::ccr;
use common::check::{
    Case, Keep, calfit, cpf, fit, numbers, process, read, refused, refused_file, says, sigma, text, three, tree,
};
use common::{Plan, RUN_FILE, RUN_ID, Truth, good, line_of, small, with_cell, with_line};
use flate2::{Compression, write::GzEncoder};
use std::fs::{self, File, OpenOptions};
use std::io::{Seek, SeekFrom, Write};
use std::path::Path;
use std::process::Output;
use std::time::{Duration, Instant};

fn gzip(bytes: &[u8]) -> Vec<u8> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::fast());
    encoder.write_all(bytes).unwrap();
    encoder.finish().unwrap()
}

/// The tool with less private memory than the input has bytes: 96 MiB.
fn in_little_memory(case: &Case, path: &Path) -> Output {
    let script = "ulimit -d 98304 && exec \"$@\"";
    let tool = env!("CARGO_BIN_EXE_calfit");
    let begin = Instant::now();
    let output = assert_cmd::Command::new("sh")
        .args(["-c", script, "sh", tool, "lin", "--threads", "2", "-o"])
        .arg(case.out())
        .arg(path)
        .timeout(Duration::from_secs(60))
        .output()
        .unwrap();
    assert!(begin.elapsed() < Duration::from_secs(30), "{:?}", begin.elapsed());
    assert!(tree(&case.out()).is_empty());
    output
}

#[track_caller]
fn unreadable(output: &Output, words: &[&str]) {
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    says(&text(&output.stderr), words);
}

// row 14
#[test]
fn output_does_not_depend_on_the_locale() {
    let case = Case::of(good().text());
    let locales = ["C", "de_DE.UTF-8", "tr_TR.UTF-8"];
    let outputs = locales.map(|locale| {
        let out = case.path().join(locale);
        let mut command = process();
        for name in ["LC_ALL", "LC_NUMERIC", "LANG"] {
            command.env(name, locale);
        }
        let output = command.arg("lin").arg(case.campaign()).arg("-o").arg(&out).arg("--json").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        (tree(&out), output.stdout)
    });
    assert!(outputs[0].0.len() > 3);
    assert!(outputs[1] == outputs[0] && outputs[2] == outputs[0]);
    // A file that is refused has the same message.
    let bad = Case::of(with_cell(&good().text(), "@VECTORS", 9, "x", "1,5").text);
    let messages = locales.map(|locale| {
        let output = process().env("LC_ALL", locale).arg("lin").arg(bad.campaign()).arg("-o").arg(bad.out()).output().unwrap();
        (output.status.code(), output.stderr)
    });
    assert!(messages[1] == messages[0] && messages[2] == messages[0]);
}

// row 32
#[test]
fn an_endless_line_is_refused_in_bounded_memory() {
    let small = small().text();
    let head = &small[..small.find("@VECTORS").unwrap() + "@VECTORS\nn,t,x,y,z\n".len()];
    for head in ["", head] {
        let case = Case::new();
        let path = case.put(RUN_FILE, head);
        let mut file = OpenOptions::new().append(true).open(&path).unwrap();
        for _ in 0..128 {
            file.write_all(&[b'7'; 1 << 20]).unwrap();
        }
        drop(file);
        let line = format!("09-22-38.CCR:{}:1", head.lines().count() + 1);
        unreadable(&in_little_memory(&case, &path), &[&line, "longer than", "`77777"]);
    }
}

// row 32
#[test]
fn an_endless_line_in_a_compressed_file_is_refused_in_bounded_memory() {
    // Two gigabytes in two megabytes.
    let case = Case::new();
    let path = case.put("13-04-03/09-22-38.CCR.gz", gzip(&[b'7'; 1 << 20]).repeat(2048));
    unreadable(&in_little_memory(&case, &path), &["09-22-38.CCR.gz:1", "longer than"]);
}

// row 33
#[test]
fn a_sparse_file_of_a_hundred_gigabytes_is_refused_at_once() {
    for head in ["", "CCR 1\n", &small().text()] {
        let case = Case::new();
        let path = case.put(RUN_FILE, head);
        File::options().append(true).open(&path).unwrap().set_len(100 << 30).unwrap();
        let place = format!("09-22-38.CCR:{}:1", head.lines().count() + 1);
        unreadable(&in_little_memory(&case, &path), &[&place, "NUL", "0x00"]);
    }
}

// row 33
#[test]
fn devices_and_pipes_are_refused_without_waiting() {
    let case = Case::new();
    unreadable(&in_little_memory(&case, Path::new("/dev/zero")), &["zero", "device", "not a regular file"]);
    unreadable(&in_little_memory(&case, Path::new("/dev/null")), &["null", "device", "not a regular file"]);
    let day = case.campaign().join("13-04-03");
    fs::create_dir_all(&day).unwrap();
    let pipe = day.join("09-22-38.CCR");
    assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    unreadable(&in_little_memory(&case, &pipe), &["09-22-38.CCR", "pipe", "not a regular file"]);
    // As one of a campaign, and behind a link.
    unreadable(&in_little_memory(&case, &case.campaign()), &["09-22-38.CCR", "not a regular file"]);
    fs::remove_file(&pipe).unwrap();
    std::os::unix::fs::symlink("/dev/zero", &pipe).unwrap();
    unreadable(&in_little_memory(&case, &case.campaign()), &["09-22-38.CCR", "not a regular file"]);
}

// row 33
#[test]
fn folders_without_runs_and_missing_files_are_refused() {
    let case = Case::new();
    fs::create_dir_all(case.campaign().join("13-04-03")).unwrap();
    unreadable(&in_little_memory(&case, &case.campaign()), &["campaign", "no run files"]);
    unreadable(&in_little_memory(&case, &case.campaign().join("13-04-04/01-02-03.CCR")), &["01-02-03.CCR", "check the path"]);
    // A folder with the name of a run.
    fs::create_dir_all(case.campaign().join("13-04-03/09-22-38.CCR")).unwrap();
    unreadable(&in_little_memory(&case, &case.campaign().join("13-04-03/09-22-38.CCR")), &["09-22-38.CCR"]);
}

/// Does something to the file at a certain vector.
struct Meddler<F> {
    at: u64,
    seen: u64,
    change: F,
}

impl<F: FnMut()> VectorSink for Meddler<F> {
    fn vector(&mut self, _vector: Vector) {
        self.seen += 1;
        if self.seen == self.at {
            (self.change)();
        }
    }
}

// row 34
#[test]
fn a_file_that_changes_while_it_is_read_is_refused() {
    // Longer than what is read at once.
    let plan = Plan { settings: common::programme(&[-2000.0, -1000.0, 1000.0, 2000.0], 8.0), ..Plan::default() };
    let long = plan.run().text();
    assert!(long.len() > 2 << 18, "{}", long.len());
    type Change = fn(&Path);
    let changes: [(&str, Change); 6] = [
        ("grows by a row", |path| OpenOptions::new().append(true).open(path).unwrap().write_all(b"1,1,1,1,1\n").unwrap()),
        ("grows by a line end", |path| OpenOptions::new().append(true).open(path).unwrap().write_all(b"\n").unwrap()),
        ("is cut", |path| {
            let file = OpenOptions::new().write(true).open(path).unwrap();
            file.set_len(file.metadata().unwrap().len() - 40).unwrap();
        }),
        ("is emptied", |path| OpenOptions::new().write(true).open(path).unwrap().set_len(0).unwrap()),
        ("is written over with equal length", |path| {
            let mut file = OpenOptions::new().write(true).open(path).unwrap();
            file.seek(SeekFrom::Start(3)).unwrap();
            file.write_all(b" ").unwrap();
        }),
        ("is replaced", |path| {
            let other = path.with_extension("new");
            fs::copy(path, &other).unwrap();
            fs::rename(&other, path).unwrap();
        }),
    ];
    for (name, change) in changes {
        for two_threads in [false, true] {
            let case = Case::of(&long);
            let path = case.file();
            // The clock of the file system has steps.
            std::thread::sleep(Duration::from_millis(30));
            let mut sink = Meddler { at: 10, seen: 0, change: || change(&path) };
            let options = ccr::Options { two_threads, ..ccr::Options::default() };
            let findings = ccr::read(&path, &options, &mut sink).expect_err(name);
            let all: Vec<String> = findings.iter().map(ToString::to_string).collect();
            // What is missing or too much may show before the file is at its end.
            let known = ["changed while it was read", "after @END", "ends inside a line", "ends without @END"];
            let told = all.iter().any(|f| known.iter().any(|k| f.contains(k)));
            assert!(told, "{name}: {all:?}");
            says(&all.join("\n"), &["09-22-38.CCR"]);
        }
    }
}

// row 34
#[test]
fn a_file_with_a_writer_is_refused_or_read_as_it_is() {
    let whole = good().text();
    let (begin, end) = whole.split_at(whole.len() - 2000);
    let case = Case::of(begin);
    let path = case.file();
    let writer = std::thread::spawn({
        let (path, end) = (path.clone(), end.to_owned());
        move || {
            let mut file = OpenOptions::new().append(true).open(path).unwrap();
            for piece in end.as_bytes().chunks(20) {
                file.write_all(piece).unwrap();
                std::thread::sleep(Duration::from_millis(2));
            }
        }
    });
    let mut refusals = 0;
    let complete = loop {
        match read(&path, &mut Accumulator::default()) {
            Ok(run) => break run,
            Err(_) => refusals += 1,
        }
        if writer.is_finished() {
            break read(&path, &mut Accumulator::default()).unwrap();
        }
    };
    writer.join().unwrap();
    assert!(refusals > 0);
    assert_eq!(complete.vectors.count, 22 * 256);
    assert_eq!(complete.input.size_bytes, whole.len() as u64);
}

#[test]
fn a_compressed_run_gives_the_same_numbers() {
    let plain = Case::of(good().text());
    plain.done(&[]);
    let bytes = good().text();
    let (a, b) = bytes.as_bytes().split_at(70_000);
    for zipped in [gzip(bytes.as_bytes()), [gzip(a), gzip(b)].concat()] {
        let case = Case::new();
        case.put("13-04-03/09-22-38.CCR.gz", zipped);
        case.done(&[]);
        assert_eq!(numbers(&case.cpf()), numbers(&plain.cpf()));
    }
}

#[test]
fn a_damaged_compressed_run_is_refused() {
    let case = Case::new();
    let zipped = gzip(small().text().as_bytes());
    for cut in 2..zipped.len() {
        let path = case.put("13-04-03/09-22-38.CCR.gz", &zipped[..cut]);
        let all =
            read(&path, &mut Accumulator::default()).expect_err("accepted").iter().map(ToString::to_string).collect::<String>();
        says(&all, &["09-22-38.CCR.gz", "decompressed", "archive"]);
    }
    let mut whole = Keep::default();
    read(&Case::of(small().text()).file(), &mut whole).unwrap();
    let trailer = zipped.len() - 8;
    for damaged in (0..trailer).step_by(7).chain(trailer..zipped.len()) {
        let mut bytes = zipped.clone();
        bytes[damaged] ^= 0x40;
        let path = case.put("13-04-03/09-22-38.CCR.gz", bytes);
        let mut vectors = Keep::default();
        if read(&path, &mut vectors).is_ok() {
            // Neither the time and the system in the head nor the last, unused bits of the data have an influence.
            assert!(damaged < trailer, "byte {damaged} of the checksum");
            assert!(vectors.0 == whole.0, "byte {damaged}");
        }
    }
    let case = Case::new();
    case.put("13-04-03/09-22-38.CCR.gz", &zipped[..zipped.len() - 20]);
    refused_file(&case, "09-22-38.CCR.gz", &[]).unreadable().says(&["decompressed", "archive"]);
}

#[test]
fn sections_may_come_in_any_order() {
    let mut run = good();
    let reference = Case::of(run.text());
    reference.done(&[]);
    for sections in [
        ["@VECTORS", "@FIELDS", "@TEMPERATURES"],
        ["@VECTORS", "@TEMPERATURES", "@FIELDS"],
        ["@TEMPERATURES", "@VECTORS", "@FIELDS"],
        ["@FIELDS", "@VECTORS", "@TEMPERATURES"],
    ] {
        run.sections = sections.to_vec();
        let case = Case::of(run.text());
        case.done(&[]);
        assert_eq!(numbers(&case.cpf()), numbers(&reference.cpf()));
    }
    run.sections = vec!["@VECTORS", "@FIELDS", "@FIELDS"];
    refused(run.text(), &[]).unreadable().says(&["@FIELDS", "twice"]);
}

#[test]
fn plateau_means_give_the_same_numbers_as_the_truth() {
    let truth = Truth::default();
    let blocks = Plan::default().settings.into_iter().fold(String::new(), |out, s| {
        let ([x, y, z], [rx, ry, rz]) = (s.field, truth.reading(s.field));
        out + &format!("{},{},{x},{y},{z},1,{rx:?},{ry:?},{rz:?}\n", s.t_start, s.t_end)
    });
    let mut run = good();
    run.sections = vec!["@TEMPERATURES"];
    let text = run.text().replace("@END", &format!("@BLOCKS\nt_start,t_end,bx,by,bz,position,x,y,z\n{blocks}@END"));
    let case = Case::of(&text);
    case.done(&[]);
    common::check::close(sigma(&case.cpf()), truth.sigma, 1e-12);
    common::check::close(three(&case.cpf(), "offset.b_or_ent"), truth.offset_ent, 1e-9);
    for (column, value) in [("x", "nan"), ("bx", "***"), ("z", "")] {
        let edit = with_cell(&text, "@BLOCKS", 5, column, value);
        refused(edit.text, &[]).unreadable().at(edit.line, edit.column).says(&[&format!("`{column}`")]);
    }
    let row = line_of(&text, "@BLOCKS", 4);
    refused(with_line(&text, row, "6,8,1,2,3,1,1,2"), &[]).unreadable().in_line(row).says(&["@BLOCKS", "8 cells"]);
}

#[test]
fn a_bad_file_leaves_the_results_of_a_good_one() {
    let text = good().text();
    let case = Case::of(&text);
    case.done(&[]);
    // The index alone says what became of the run since.
    let results = || {
        let mut tree = tree(&case.out());
        let index: serde_json::Value = serde_json::from_slice(&tree.remove("INDEX.json").unwrap()).unwrap();
        (tree, index["runs"][RUN_ID]["state"].clone())
    };
    let (before, state) = results();
    assert_eq!(state, "done");
    assert!(before.contains_key(&format!("{RUN_ID}/PARAMETER_LIN__{RUN_ID}.CPF")));
    for bad in [text[..text.len() - 30].to_owned(), good().stick(0, 1.0).text()] {
        case.put(RUN_FILE, bad);
        assert_ne!(case.lin(&[]).status.code(), Some(0));
        assert!(results() == (before.clone(), "refused".into()));
    }
}

/// Three runs of one day; the second one is damaged.
fn three_runs(second: &[u8]) -> Case {
    let case = Case::new();
    let run = |seed, id| Plan { seed, ..Plan::default() }.run().named(id).text();
    case.put("13-04-03/09-22-38.CCR", run(1, "13-04-03_09-22-38"));
    case.put("13-04-03/10-00-00.CCR", second);
    case.put("13-04-03/11-00-00.CCR", run(3, "13-04-03_11-00-00"));
    case
}

#[test]
fn a_campaign_with_a_bad_run_goes_on_and_lists_it() {
    let text_of = |run: common::Run| run.named("13-04-03_10-00-00").text().into_bytes();
    let cut = text_of(good()).split_last_chunk::<40>().unwrap().0.to_vec();
    let wrong_head = text_of(good().without_key("kind"));
    for bad in [cut, wrong_head, text_of(good().stick(2, 5.0)), Vec::new()] {
        let case = three_runs(&bad);
        let output = case.lin(&["--no-plots"]);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{stderr}");
        for (run, name) in [("13-04-03_09-22-38", "first"), ("13-04-03_11-00-00", "third")] {
            common::check::close(sigma(&cpf(&case.out(), run)), Truth::default().sigma, 1e-5);
            assert!(text(&output.stdout).contains(run), "the {name} run is not in the summary");
        }
        assert!(!case.out().join("13-04-03_10-00-00").exists());
        says(stderr.lines().last().unwrap(), &["error: ", "1 of 3", "10-00-00.CCR"]);
    }
}

#[test]
fn output_does_not_depend_on_the_number_of_threads() {
    let case = three_runs(Plan { seed: 2, ..Plan::default() }.run().named("13-04-03_10-00-00").text().as_bytes());
    let outputs = ["1", "2", "7"].map(|threads| {
        let out = case.path().join(threads);
        let output = process()
            .arg("lin")
            .arg(case.campaign())
            .arg("-o")
            .arg(&out)
            .args(["--json", "--threads", threads])
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        (tree(&out), output.stdout)
    });
    assert!(outputs[0].0.keys().any(|name| name.ends_with(".png")));
    assert_eq!(outputs[0].0.keys().filter(|name| name.ends_with(".CPF")).count(), 3);
    assert!(outputs[1] == outputs[0] && outputs[2] == outputs[0]);
}

#[test]
fn check_lists_several_errors_of_a_file_at_once() {
    let first = with_cell(&good().text(), "@FIELDS", 3, "by", "ERR");
    let second = with_cell(&first.text, "@VECTORS", 50, "x", "nan");
    let third = with_cell(&second.text, "@VECTORS", 4000, "z", "***");
    let case = Case::of(&third.text);
    let output = calfit().arg("check").arg(case.file()).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let stderr = text(&output.stderr);
    for (edit, value) in [(&first, "ERR"), (&second, "nan"), (&third, "***")] {
        says(&stderr, &[&format!(":{}:{}: found `{value}`", edit.line, edit.column)]);
    }
    says(&text(&output.stdout), &["refused"]);
    let output = calfit().arg("check").arg("--json").arg(case.file()).output().unwrap();
    let listing: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(listing[0]["ok"], false);
    assert!(listing[0]["findings"].as_array().unwrap().iter().filter(|f| f["severity"] == "error").count() >= 3);

    let good = Case::of(good().text());
    let output = calfit().arg("check").arg(good.campaign()).output().unwrap();
    assert_eq!((output.status.code(), text(&output.stdout).contains("ok")), (Some(0), true));
}

#[test]
fn json_is_the_only_thing_on_standard_output() {
    let bad = good().stick(1, 0.0).named("13-04-03_10-00-00").text();
    let case = three_runs(bad.as_bytes());
    let output = case.lin(&["--json", "--no-plots", "-v"]);
    let listing: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(listing["runs"].as_array().unwrap().len(), 2);
    assert_eq!(listing["failed"].as_array().unwrap().len(), 1);
    for (command, status) in [("inspect", 0), ("check", 0)] {
        let output = calfit().arg(command).arg(case.campaign()).args(["--json", "-v"]).output().unwrap();
        assert_eq!(output.status.code(), Some(status), "{}", text(&output.stderr));
        serde_json::from_slice::<serde_json::Value>(&output.stdout).unwrap();
    }
    let nothing = calfit().args(["lin", "--json", "nowhere"]).output().unwrap();
    assert_eq!((nothing.status.code(), nothing.stdout.len()), (Some(2), 0));
}

#[test]
fn a_run_is_refused_where_the_library_refuses_it() {
    // The table above runs the binary; loops run the library. Both say the same.
    for bad in [good().stick(0, 1.0).text(), with_cell(&good().text(), "@VECTORS", 9, "x", "nan").text] {
        let message = fit(&bad).unwrap_err();
        let rule = message.rsplit(": ").next().unwrap().to_owned();
        refused(&bad, &[]).says(&[rule.split(';').next().unwrap()]);
    }
}

#[cfg(unix)]
#[test]
fn a_link_in_place_of_the_folder_of_a_run_leads_nowhere() {
    let case = Case::of(common::good().text());
    let elsewhere = case.path().join("elsewhere");
    fs::create_dir_all(&elsewhere).unwrap();
    fs::create_dir_all(case.out()).unwrap();
    std::os::unix::fs::symlink(&elsewhere, case.out().join(common::RUN_ID)).unwrap();
    let output = case.lin(&["--no-plots"]);
    assert_eq!(output.status.code(), Some(1), "{}", common::check::text(&output.stderr));
    common::check::says(&common::check::text(&output.stderr), &["is a link that leads out of the output folder"]);
    assert_eq!(fs::read_dir(&elsewhere).unwrap().count(), 0);
}
