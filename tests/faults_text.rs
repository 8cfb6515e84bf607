//! Damaged text: cut files, foreign bytes, line ends, encodings, numbers that are none, columns. The rows are those of the table of
//! faults that the tool promises to handle.

use crate::common;

use calfit::data::error::Severity;
use calfit::files::ccr;
use calfit::measure::lin;
use common::check::{Case, Keep, bits, error_of, fit, fit_with, numbers, read, refused, says, with_seconds_of_work};
use common::{good, line, line_of, small, with_cell, with_line, with_rows};
use proptest::prelude::*;

fn few(cases: u32) -> ProptestConfig {
    ProptestConfig { cases, failure_persistence: None, ..ProptestConfig::default() }
}

/// Numbers of a text's calibration, by the binary.
#[track_caller]
fn numbers_of(bytes: impl AsRef<[u8]>) -> String {
    let case = Case::of(bytes);
    case.done(&[]);
    numbers(&case.cpf())
}

// row 1
#[test]
fn a_cut_last_line_is_refused_and_named() {
    let text = small().text();
    let last = text.lines().count() as u64 - 1;
    for missing in ["\n@END\n".len(), "\n@END\n".len() + 2] {
        let cut = &text[..text.len() - missing];
        refused(cut, &[]).unreadable().at(last, 1).found(cut.lines().last().unwrap()).says(&[
            "the file ends inside a line",
            &format!("last good row is line {}", last - 1),
            "--allow-truncated",
        ]);
    }
}

// row 1
#[test]
fn a_file_without_end_names_its_last_good_row() {
    let text = good().text();
    for rows in [1, 500, 5000] {
        let last = line_of(&text, "@VECTORS", rows);
        let cut: String = text.split_inclusive('\n').take(last as usize).collect();
        refused(cut, &[]).unreadable().in_line(last).says(&["without @END", &format!("last good row is line {last}")]);
    }
}

// row 1
#[test]
fn a_complete_last_line_needs_no_line_end() {
    let text = good().text();
    assert_eq!(numbers_of(text.trim_end()), numbers_of(&text));
}

// row 1
#[test]
fn a_truncated_file_is_read_when_that_is_allowed_and_the_result_says_so() {
    let text = good().text();
    for spelling in [&["--allow-truncated"][..], &["--allow", "truncated"]] {
        let case = Case::of(&text[..text.len() - 20]);
        let stderr = case.done(spelling);
        says(&stderr, &["warning: ", "@END"]);
        let cpf = case.cpf();
        says(cpf["provenance"]["command"].as_str().unwrap(), &["--allow truncated"]);
        says(&cpf["warnings"].to_string(), &["@END"]);
    }
}

// row 2
#[test]
fn a_file_cut_anywhere_is_refused_or_gives_the_same_result() {
    let text = small().text();
    let full = bits(&fit(&text).unwrap());
    let case = Case::new();
    let end = text.len() - 1;
    for at in 0..=text.len() {
        let path = case.put("13-04-03/09-22-38.CCR", &text[..at]);
        let result = fit_with(&path, &ccr::Options::default(), &lin::Options::default());
        if at >= end {
            // The hash of the file differs, the numbers do not.
            assert_eq!(bits(&result.unwrap()), full);
        } else {
            let message = result.err().unwrap_or_else(|| panic!("cut at {at}: accepted"));
            let known = ["ends inside a line", "ends without @END", "is empty", "not a run file", "version of the format"];
            assert!(known.iter().any(|k| message.contains(k)), "cut at {at}: {message}");
        }
    }
}

// row 2
#[test]
fn a_truncated_file_that_is_allowed_never_gives_a_silent_result() {
    let text = small().text();
    let full = bits(&fit(&text).unwrap());
    let case = Case::new();
    let options = ccr::Options { allow_truncated: true, ..ccr::Options::default() };
    let mut results = 0;
    for at in 0..text.len() - 1 {
        let path = case.put("13-04-03/09-22-38.CCR", &text[..at]);
        if let Ok(lin) = fit_with(&path, &options, &lin::Options::default()) {
            results += 1;
            assert_ne!(bits(&lin), full);
            assert!(lin.notes.iter().any(|n| n.to_string().contains("@END")), "cut at {at}: {:?}", lin.notes);
        }
    }
    assert!(results > 100, "{results}");
}

// row 3
#[test]
fn a_tail_of_nul_bytes_is_refused_at_the_first_one() {
    let text = good().text();
    let row = line_of(&text, "@VECTORS", 2000);
    let begin = text.split_inclusive('\n').take(row as usize - 1).map(str::len).sum::<usize>();
    for (into_line, tail) in [(7, 3000), (0, 3000), (7, 3 << 20)] {
        let mut bytes = text.as_bytes()[..begin + into_line].to_vec();
        bytes.resize(begin + into_line + tail, 0);
        for arguments in [&[][..], &["--allow-truncated"]] {
            refused(&bytes, arguments)
                .unreadable()
                .at(row, into_line as u64 + 1)
                .found(&line(&text, row)[..into_line])
                .says(&["NUL", "0x00"]);
        }
    }
}

// row 4
#[test]
fn control_bytes_in_data_are_refused_with_their_value() {
    let text = good().text();
    for (byte, words) in [(0x00, "0x00"), (0x01, "0x01"), (0x07, "0x07"), (0x1a, "0x1a"), (0x1b, "0x1b")] {
        for section in ["@VECTORS", "@FIELDS", "@TEMPERATURES"] {
            let row = line_of(&text, section, 3);
            let new = format!("{}{}{}", &line(&text, row)[..3], char::from(byte), &line(&text, row)[3..]);
            let finding = error_of(with_line(&text, row, &new));
            assert_eq!((finding.line, finding.column), (Some(row), Some(4)), "{finding}");
            says(&finding.to_string(), &[words]);
        }
    }
    let row = line_of(&text, "@VECTORS", 10);
    refused(with_line(&text, row, "9,0.07\x1a03,1,2,3"), &[]).unreadable().at(row, 7).says(&["Ctrl-Z", "0x1a", "\\u{1a}"]);
}

// row 4
#[test]
fn a_ctrl_z_after_the_end_is_refused() {
    let text = good().text();
    refused(format!("{text}\x1a"), &[]).unreadable().in_line(text.lines().count() as u64 + 1).says(&["0x1a"]);
}

proptest! {
    #![proptest_config(few(8))]

    // row 5
    #[test]
    fn lf_crlf_and_mixed_line_ends_give_the_same_bits(seed in any::<u64>()) {
        let text = good().text();
        let mut gauss = common::Gauss(seed);
        let mixed: String = text.lines().map(|l| format!("{l}{}", if gauss.uniform() < 0.0 { "\r\n" } else { "\n" })).collect();
        prop_assert_eq!(bits(&fit(mixed).unwrap()), bits(&fit(&text).unwrap()));
    }
}

// row 5
#[test]
fn crlf_gives_the_same_parameter_file() {
    let text = good().text();
    assert_eq!(numbers_of(text.replace('\n', "\r\n")), numbers_of(text));
}

// row 6
#[test]
fn cr_line_ends_are_refused_by_name() {
    let text = small().text();
    let long = text.replace("@VECTORS\n", &format!("@VECTORS\n{}", "# a remark\n".repeat(200_000)));
    for text in [text, long] {
        refused(text.replace('\n', "\r"), &[]).unreadable().in_line(1).says(&["CR line ends", "convert"]);
    }
}

// row 6
#[test]
fn a_cr_inside_a_line_is_refused() {
    let text = good().text();
    let row = line_of(&text, "@VECTORS", 5);
    let joined = format!("{}\r{}", line(&text, row), line(&text, row + 1));
    refused(with_line(&text, row, &joined), &[]).unreadable().in_line(row).says(&["CR"]);
}

// row 7
#[test]
fn a_byte_order_mark_is_ignored() {
    let text = good().text();
    assert_eq!(numbers_of(format!("\u{feff}{text}")), numbers_of(text));
}

// row 8
#[test]
fn utf_16_is_refused_by_name() {
    let text = small().text();
    let little = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect::<Vec<u8>>();
    let big = |text: &str| text.encode_utf16().flat_map(u16::to_be_bytes).collect::<Vec<u8>>();
    let marked = format!("\u{feff}{text}");
    for bytes in [little(&marked), big(&marked), little(&text), big(&text)] {
        refused(bytes, &[]).unreadable().in_line(1).says(&["UTF-16", "convert"]);
    }
}

// row 9
#[test]
fn latin_1_in_remarks_and_quotes_is_kept_and_never_an_error() {
    // DEGREE SIGN and MICRO SIGN as single bytes, beside a UTF-8 one in another line.
    let run = good().key("mode", "\"17 LATINC\"").key("sensor", "\"BS_11 µ\"");
    let text = run.text().replace("@FIELDS\n", "# coil at 20 LATINC, noise in LATINT\n@FIELDS\n# 20 LATINC\n");
    let text = with_rows(&text, "@TEMPERATURES", |cells| match cells {
        ["t", ..] => "t,T29,T59,TLATIN".to_owned(),
        _ => format!("{},1", cells.join(",")),
    });
    let mut bytes = Vec::new();
    for piece in text.split_inclusive("LATIN") {
        bytes.extend(piece.strip_suffix("LATIN").unwrap_or(piece).bytes());
        bytes.extend(piece.ends_with("LATIN").then_some(0xb0));
    }
    let case = Case::of(bytes);
    case.done(&[]);
    let cpf = case.cpf();
    assert_eq!(cpf["run"]["mode"].as_str(), Some("17 °C"));
    assert_eq!(cpf["run"]["sensor"].as_str(), Some("BS_11 µ"));
}

const COLUMNS: [(&str, &str); 9] = [
    ("@VECTORS", "n"),
    ("@VECTORS", "t"),
    ("@VECTORS", "x"),
    ("@VECTORS", "z"),
    ("@FIELDS", "t_end"),
    ("@FIELDS", "by"),
    ("@FIELDS", "frequency"),
    ("@TEMPERATURES", "t"),
    ("@TEMPERATURES", "T59"),
];

proptest! {
    #![proptest_config(few(48))]

    // row 10
    #[test]
    fn numbers_that_are_not_finite_are_refused_with_their_column(
        place in 0..COLUMNS.len(),
        row in 1_usize..5,
        sign in prop::sample::select(vec!["", "-", "+"]),
        word in prop::sample::select(vec!["nan", "NaN", "NAN", "inf", "Inf", "INF", "infinity", "Infinity", "1e999", "9e308", "1.#INF"]),
    ) {
        let (section, column) = COLUMNS[place];
        let value = format!("{sign}{word}");
        let edit = with_cell(&small().text(), section, row, column, &value);
        let finding = error_of(&edit.text);
        prop_assert_eq!((finding.line, finding.column), (Some(edit.line), Some(edit.column)));
        prop_assert_eq!(finding.found.as_deref(), Some(value.as_str()));
        let message = finding.to_string();
        prop_assert!(message.contains(&format!("`{column}`")), "{}", message);
        prop_assert!(message.contains("finite") || message.contains("range"), "{}", message);
    }
}

// row 10
#[test]
fn keys_that_are_not_finite_are_refused() {
    for (key, value) in [("sample_rate", "nan"), ("sample_rate", "inf"), ("sample_rate", "1e999"), ("nominal_factor", "inf")] {
        let text = good().in_counts(0.5).key(key, value).text();
        let at = text.lines().position(|l| l.starts_with(key)).unwrap() as u64 + 1;
        refused(text, &[]).unreadable().at(at, key.len() as u64 + 4).found(value).says(if value == "1e999" {
            &["overflow"]
        } else {
            &["finite"]
        });
    }
}

// row 11
#[test]
fn texts_that_are_no_numbers_are_refused_with_their_column() {
    for value in ["", "***", "ERR", "0x64", "1D+02", "\u{2212}5", "1_000", "1 2", "--1", "1.2.3", "1e", "٣"] {
        for (section, column) in COLUMNS {
            if value.is_empty() && (section, column) == ("@TEMPERATURES", "T59") {
                continue;
            }
            let edit = with_cell(&small().text(), section, 4, column, value);
            let finding = error_of(&edit.text);
            assert_eq!((finding.line, finding.column), (Some(edit.line), Some(edit.column)), "{finding}");
            assert_eq!(finding.found.as_deref(), Some(value));
            says(&finding.rule, &[&format!("`{column}`")]);
        }
    }
    let edit = with_cell(&good().text(), "@VECTORS", 3000, "y", "***");
    refused(edit.text, &[]).unreadable().at(edit.line, edit.column).found("***").says(&["`y`", "not a decimal number", "repair"]);
    let edit = with_cell(&good().text(), "@VECTORS", 3000, "x", "");
    refused(edit.text, &[]).unreadable().at(edit.line, edit.column).says(&["`x`", "empty"]);
}

// row 11
#[test]
fn an_empty_cell_of_a_temperature_is_no_reading() {
    let mut run = good();
    run.temperatures[2].1[1] = None;
    let case = Case::of(run.text());
    case.done(&[]);
    // 24, 24.25, 24.75 and 25 remain.
    assert_eq!(common::check::number(&case.cpf(), "run.temperature_degc"), 24.5);
}

/// The text with decimal commas, cells separated by `;`.
fn german(cells: &[&str]) -> String {
    cells.iter().map(|c| c.replace('.', ",")).collect::<Vec<_>>().join(";")
}

// row 12
#[test]
fn decimal_commas_with_semicolons_are_refused_by_name() {
    let text = good().text();
    let header = line_of(&text, "@VECTORS", 0);
    let rows = with_rows(&text, "@VECTORS", german);
    refused(with_line(&rows, header, "n,t,x,y,z"), &[]).unreadable().in_line(header + 1).says(&["decimal comma"]);
    refused(rows, &[]).unreadable().in_line(header).says(&["decimal comma"]);
}

// row 12
#[test]
fn a_single_row_with_semicolons_is_refused_by_name() {
    let text = good().text();
    let row = line_of(&text, "@VECTORS", 100);
    for new in ["99;0,7734;1,5;2,5;3,5", "99;0,7734;1;2;3", "99;0.7734;1.5;2.5;3.5"] {
        refused(with_line(&text, row, new), &[]).unreadable().in_line(row).says(&["decimal comma"]);
    }
}

// row 13
#[test]
fn decimal_commas_between_commas_are_refused_by_their_cells() {
    let text = good().text();
    let row = line_of(&text, "@VECTORS", 100);
    refused(with_line(&text, row, "99,0.7734,1,5,2,5,3,5"), &[])
        .unreadable()
        .in_line(row)
        .found("99,0.7734,1,5,2,5,3,5")
        .says(&["8 cells", "5", "decimal comma"]);
}

// row 15
#[test]
fn rows_with_missing_or_extra_cells_are_refused_with_their_line() {
    let text = good().text();
    for section in ["@VECTORS", "@FIELDS", "@TEMPERATURES"] {
        let row = line_of(&text, section, 3);
        let whole = line(&text, row);
        for new in [whole.rsplit_once(',').unwrap().0.to_owned(), format!("{whole},0"), format!("{whole},")] {
            let count = format!("{} cells", new.split(',').count());
            refused(with_line(&text, row, &new), &[]).unreadable().in_line(row).found(&new).says(&[section, &count]);
        }
    }
}

// row 16
#[test]
fn a_section_without_column_names_is_refused_and_no_row_is_lost() {
    let text = good().text();
    for section in ["@VECTORS", "@FIELDS", "@TEMPERATURES"] {
        let header = line_of(&text, section, 0);
        refused(with_line(&text, header, ""), &[]).unreadable().in_line(header).says(&[section, "column name"]);
        let remark = format!("{section} # of the morning");
        refused(with_line(&text, header - 1, &remark), &[]).unreadable().in_line(header - 1).says(&[
            section,
            "more on its line than its name",
            "alone on its line",
        ]);
    }
}

// row 16
#[test]
fn repeated_column_names_are_refused() {
    let text = good().text();
    let row = line_of(&text, "@VECTORS", 700);
    refused(with_line(&text, row, "n,t,x,y,z"), &[]).unreadable().at(row, 1).found("n").says(&["`n`"]);
    let header = line_of(&text, "@VECTORS", 0);
    refused(with_line(&text, header, "n,t,x,x,z"), &[]).unreadable().at(header, 7).found("x").says(&["twice"]);
}

// row 16
#[test]
fn a_missing_column_is_refused_by_name() {
    let text = good().text();
    let header = line_of(&text, "@VECTORS", 0);
    refused(with_line(&text, header, "n,t,x,y,w"), &[]).unreadable().in_line(header).says(&["@VECTORS", "`z`"]);
}

// row 16
#[test]
fn unknown_columns_sections_and_keys_are_warnings() {
    let plain = good().text();
    let text = good().key("operator", "\"N.N.\"").text();
    let text = with_rows(&text, "@VECTORS", |cells| match cells {
        ["n", ..] => "n,t,x,y,z,status".to_owned(),
        _ => format!("{},ok", cells.join(",")),
    });
    let text = text.replace("@VECTORS\n", "@HUMIDITY\nt,percent,***\n1,2\nany text\n@VECTORS\n");
    let case = Case::of(&text);
    let stderr = case.done(&[]);
    for unknown in ["operator", "@HUMIDITY", "status"] {
        let warned = stderr.lines().any(|l| l.starts_with("warning: ") && l.contains(unknown) && l.contains("09-22-38.CCR"));
        assert!(warned, "no warning for {unknown}: {stderr}");
    }
    let run = read(&case.file(), &mut Keep::default()).unwrap();
    assert_eq!(run.findings.iter().filter(|f| f.severity == Severity::Warning).count(), 3);
    let mut with = case.cpf();
    with["warnings"] = toml_edit::value(toml_edit::Array::new());
    with.remove("warning_kinds");
    let case = Case::of(plain);
    case.done(&[]);
    assert_eq!(numbers(&with), numbers(&case.cpf()));
}

// row 17
#[test]
fn columns_in_another_order_are_taken_by_name() {
    let text = good().text();
    let turned = with_rows(&text, "@VECTORS", |c| [c[3], c[0], c[4], c[2], c[1]].join(","));
    let turned = with_rows(&turned, "@FIELDS", |c| [c[6], c[4], c[3], c[2], c[5], c[1], c[0]].join(","));
    let turned = with_rows(&turned, "@TEMPERATURES", |c| [c[2], c[1], c[0]].join(","));
    assert_ne!(turned, text);
    assert_eq!(numbers_of(turned), numbers_of(text));
}

// row 17
#[test]
fn a_column_without_a_name_is_refused() {
    let text = good().text();
    let header = line_of(&text, "@VECTORS", 0);
    refused(with_line(&text, header, "n,t,x,,z"), &[]).unreadable().at(header, 7).says(&["@VECTORS", "name"]);
}

// row 32
#[test]
fn numbers_of_any_length_are_rounded_correctly() {
    let half = "1.00000000000000011102230246251565404236316680908203125";
    let largest = "179769313486231570814527423731704356798070567525844996598917476803157260780028538760589558632766878171540458953514382464234321326889464182768467546703537516986049910576551282076245490090389328944075868508455133942304583236903222948165808559332123347764797926207144723168738177180919299881250404026184124858368";
    let cases = [
        ("0.1000000000000000055511151231257827".to_owned(), 0x3fb9_9999_9999_999a),
        // Halfway between two numbers: to the even one, and up as soon as there is more, however far behind.
        ("9007199254740993".to_owned(), 0x4340_0000_0000_0000),
        ("9007199254740993.00000000000000000000000001".to_owned(), 0x4340_0000_0000_0001),
        (half.to_owned(), 0x3ff0_0000_0000_0000),
        (format!("{half}{}1", "0".repeat(900)), 0x3ff0_0000_0000_0001),
        ("2.2250738585072011e-308".to_owned(), 0x000f_ffff_ffff_ffff),
        ("4.9e-324".to_owned(), 0x0000_0000_0000_0001),
        (largest.to_owned(), 0x7fef_ffff_ffff_ffff),
        ("123456789012345678".to_owned(), 0x437b_69b4_ba63_0f35),
        (format!("0.{}1", "0".repeat(500)), 0),
    ];
    let text = small().text();
    for (number, wanted) in cases {
        let case = Case::of(with_cell(&text, "@VECTORS", 7, "y", &number).text);
        let mut vectors = Keep::default();
        read(&case.file(), &mut vectors).unwrap();
        assert_eq!(vectors.0[6].reading.0[1].to_bits(), wanted, "{number}");
    }
}

proptest! {
    #![proptest_config(few(64))]

    // row 32
    #[test]
    fn every_decimal_is_read_to_the_last_bit(numbers in prop::collection::vec("-?[0-9]{1,20}(\\.[0-9]{1,20})?", 60)) {
        let mut run = small();
        run.samples.truncate(60);
        let mut text = run.text();
        for (i, number) in numbers.iter().enumerate() {
            text = with_cell(&text, "@VECTORS", i + 1, ["x", "y", "z"][i % 3], number).text;
        }
        let case = Case::of(text);
        let mut vectors = Keep::default();
        read(&case.file(), &mut vectors).unwrap();
        for (i, number) in numbers.iter().enumerate() {
            let wanted: f64 = number.parse().unwrap();
            prop_assert_eq!(vectors.0[i].reading.0[i % 3].to_bits(), wanted.to_bits(), "{}", number);
        }
    }
}

// row 32
#[test]
fn a_row_of_a_million_columns_is_refused() {
    let text = small().text();
    let row = line_of(&text, "@VECTORS", 3);
    refused(with_line(&text, row, &"1,".repeat(1_000_000)), &[]).unreadable().at(row, 1).found("1,1,1,").says(&["longer"]);
    refused(with_line(&text, row, &",".repeat(1_000_000)), &[]).unreadable().in_line(row).found(",,,").says(&["1000001 cells"]);
}

// row 32
#[test]
fn a_header_line_of_very_many_columns_ends_in_good_time() {
    // More than a hundred thousand names, all different, and one of them twice.
    let names: Vec<String> = (0..130_000).map(|i| format!("c{i}")).collect();
    let text = small().text();
    let header = line_of(&text, "@TEMPERATURES", 0);
    let case = Case::of(with_line(&text, header, &format!("t,{},c0", names.join(","))));
    // Comparing every name with every other takes minutes.
    let output = with_seconds_of_work(10).arg("check").arg(case.campaign()).output().unwrap();
    assert!(output.status.code().is_some_and(|code| code != 0), "{}", output.status);
    says(&(common::check::text(&output.stdout) + &common::check::text(&output.stderr)), &["twice", "`c0`"]);
}

/// Clocks and names of files differ by minutes; summer time, another zone and a wrong year are more.
#[test]
fn a_start_that_contradicts_the_run_id_is_told_by_check_and_by_the_analysis() {
    let at = |start: &str| Case::of(good().key("start", &format!("\"{start}\"")).text());
    for (start, words) in [
        ("2013-04-03T10:22:38+00:00", "60 min later"),
        ("2013-04-03T08:22:38Z", "60 min earlier"),
        ("2013-04-03T14:52:38Z", "5.5 h later"),
        ("2049-04-03T09:22:38Z", "13149 days later"),
    ] {
        let case = at(start);
        let told = format!("{start}, {words} than the run id 13-04-03_09-22-38 tells");
        let said = [told.as_str(), "correct the wrong one of the two"];
        says(&case.done(&[]), &said);
        let check = common::check::calfit().arg("check").arg(case.campaign()).output().unwrap();
        assert_eq!(check.status.code(), Some(0));
        says(&common::check::text(&check.stderr), &["09-22-38.CCR:3:", "warning: ", said[0], said[1]]);
        says(&case.cpf()["warnings"].to_string(), &said);
    }
    for start in ["2013-04-03T09:22:38Z", "2013-04-03T11:22:38+02:00", "2013-04-03T09:22:38+02:00", "2013-04-03T09:24:00Z"] {
        let said = at(start).done(&[]);
        assert!(!said.contains("than the run id"), "{start}: {said}");
    }
}
