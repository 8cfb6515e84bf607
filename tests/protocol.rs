//! The protocol as a reader meets it: every run counts once, on the terminal, as JSON and in the protocol; its first page says what became of
//! the campaign and what the sensors are; messages name the real error.

use crate::common::{self, RUN_ID, campaign};

use campaign::id;
use common::check::{Case, calfit, cpf, data, number, parameters, says, text, tree};
use std::fs;
use std::io::Write;

/// The campaign at two temperatures.
fn two_temperatures() -> Case {
    let case = Case::new();
    campaign::write(&case);
    for day in ["13-04-05", "13-04-06"] {
        fs::remove_dir_all(case.campaign().join(day)).unwrap();
    }
    case
}

fn add_to_campaign_file(case: &Case, text: &str) {
    let old = fs::read_to_string(case.campaign().join("campaign.toml")).unwrap();
    case.put("campaign.toml", old + text);
}

/// What stands in front of the first chapter.
fn first_page(case: &Case) -> String {
    let markdown = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    markdown.split_once("\n## 1 Introduction").unwrap().0.to_owned()
}

#[test]
fn every_run_counts_once_wherever_runs_are_counted() {
    let case = two_temperatures();
    // Of ten runs one is cut off, one left out by hand, and one not named where its kind is listed.
    let cut = case.campaign().join(format!("{}.CCR", id(10, 1).replace('_', "/")));
    let text_of_run = fs::read_to_string(&cut).unwrap();
    fs::write(&cut, &text_of_run[..text_of_run.len() / 2]).unwrap();
    let (listed, unlisted, excluded) = (id(9, 0), id(9, 1), id(11, 0));
    add_to_campaign_file(
        &case,
        &format!("[offset]\nruns = [\"{listed}\"]\n[[exclude]]\nrun = \"{excluded}\"\nreason = \"lid was open\"\n"),
    );
    let counts = "8 runs: 5 analysed, 1 refused, 1 left out by hand, 1 not analysed";
    let output = case.run("report", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stdout), &[counts, &format!("{excluded}: left out by hand: lid was open")]);
    says(&text(&output.stderr), &["1 of 8 runs refused: 13-04-04/10-00-00.CCR"]);

    let page = first_page(&case);
    says(&page, &["**The calibration is incomplete.**", counts, "13-04-04/10-00-00.CCR: ", "left out by hand: lid was open"]);
    let markdown = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    let rows = |run: &str| markdown.lines().filter(|l| l.starts_with(&format!("| {run} |"))).collect::<Vec<_>>();
    says(rows(&id(10, 1))[0], &["refused: ", "the file ends"]);
    says(rows(&excluded).last().unwrap(), &["left out by hand: lid was open"]);
    says(rows(&unlisted)[0], &["not analysed: ", "campaign.toml does not name it"]);
    // The temperature of a run is one number in both tables of its day.
    let degc = |row: &str| row.split('|').map(|cell| cell.trim().trim_end_matches(" °C").to_owned()).collect::<Vec<_>>();
    let linear = rows(&id(8, 1));
    assert_eq!(degc(linear[0])[8], degc(linear[1])[5], "{linear:?}");

    let output = case.run("report", &["--no-plots", "--json"]);
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let expected = serde_json::json!({ "runs": 8, "done": 5, "refused": 1, "excluded": 1, "gone": 0, "not_applicable": 1 });
    assert_eq!(json["counts"], expected);
    let runs = json["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 8);
    let state = |run: &str| runs.iter().find(|r| r["run"] == run).unwrap()["state"].as_str().unwrap().to_owned();
    assert_eq!([state(&id(10, 1)), state(&excluded), state(&unlisted)], ["refused", "excluded", "not_applicable"]);
    // Every result is that of the analysis' own command, with where it comes from.
    let lin = &runs.iter().find(|r| r["run"] == id(8, 0).as_str()).unwrap()["result"];
    let sigma = lin["parameters"]["matrix"]["sigma"][0][0].as_f64().unwrap();
    assert_eq!(
        sigma,
        number(&parameters(&case.out().join(id(8, 0)).join(lin["parameter_file"].as_str().unwrap())), "matrix.sigma.0.0")
    );
    assert!(lin["provenance"]["input"][0]["sha256"].is_string());

    // The command of one analysis prints the origin of its results as well.
    let output = calfit()
        .args(["lin", "--json", "--no-plots"])
        .arg(case.campaign())
        .arg("-o")
        .arg(case.path().join("own"))
        .output()
        .unwrap();
    let json: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    for run in json["runs"].as_array().unwrap() {
        let file = case
            .path()
            .join("own")
            .join(run["parameters"]["run"]["id"].as_str().unwrap())
            .join(run["parameter_file"].as_str().unwrap());
        let stated = parameters(&file);
        let hash = stated["provenance"]["input"][0]["sha256"].as_str().unwrap();
        assert_eq!(run["provenance"]["input"][0]["sha256"].as_str(), Some(hash));
    }
}

#[test]
fn a_campaign_in_which_nothing_failed_ends_well_where_an_analysis_does_not_apply() {
    let out = tempfile::tempdir().unwrap();
    let output =
        calfit().args(["report", "--no-plots", "-o"]).args([out.path(), data("runs/champ-1998").as_path()]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stdout), &["1 run: 1 analysed; no thermal analysis"]);
    assert!(!text(&output.stderr).contains("error"), "{}", text(&output.stderr));
    // With one run the first page has the values of that.
    let markdown = fs::read_to_string(out.path().join("REPORT.md")).unwrap();
    let page = markdown.split_once("\n## 1 Introduction").unwrap().0;
    says(
        page,
        &["**Everything that applies to this campaign was done.**", "by the runs nearest to 20 °C", "run 98-03-23_00-00-04"],
    );
}

#[test]
fn the_first_page_says_what_the_sensors_are() {
    let case = two_temperatures();
    let output = case.run("report", &[]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let page = first_page(&case);
    says(
        &page,
        &[
            "**Everything that applies to this campaign was done.** 8 runs: 8 analysed; 3 analyses across temperatures",
            "| Laboratory | Coil facility |",
            "**BS_11 science mode 0** at -30.0 °C, the middle of the range of the polynomials, -60.0 to 0.0 °C, in which 20 °C is not",
            "| offset B_off, enT |",
            "| -3 dB frequency f_3dB, Hz |",
            "| 2 runs |",
        ],
    );
    assert!(!page.contains("not stated"), "{page}");
    assert_eq!(page.matches("\n![").count(), 4);
    let near = |page: &str, truth: [f64; 3]| {
        let rows: Vec<&str> = page.lines().filter(|l| l.starts_with("| sensitivity σ, nT/enT |")).collect();
        let [row] = rows.as_slice() else { panic!("{page}") };
        let cells: Vec<&str> = row.split('|').skip(2).take(3).collect();
        assert_eq!(cells.len(), 3);
        for (cell, truth) in cells.iter().zip(truth) {
            let (value, std) = cell.split_once('±').unwrap();
            let [value, std] = [value, std].map(|text| text.trim().parse::<f64>().unwrap());
            assert!(std > 0.0 && (value - truth).abs() < 4.0 * std, "{row} is not {truth}");
        }
    };
    near(&page, campaign::truth(-30.0).sigma);

    // The campaign states another temperature.
    let old = fs::read_to_string(case.campaign().join("campaign.toml")).unwrap();
    case.put("campaign.toml", old.replace("[report]", "[report]\nreference_temperature_degc = -10"));
    let output = case.run("report", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let page = first_page(&case);
    says(&page, &["at -10 °C, the reference temperature of campaign.toml; the polynomials hold from -60.0 to 0.0 °C"]);
    near(&page, campaign::truth(-10.0).sigma);
}

#[test]
fn a_report_takes_the_options_of_its_analyses_and_its_files_come_back() {
    let case = two_temperatures();
    let linear = ["--no-plots", "--robust", "--max-field", "x=1500", "--order", "1", "--settling", "0.25"];
    let more = ["--order", "null=2", "--order", "sigma=1", "--order", "xi=0"];
    let output = case.run("report", &[&linear[..], &more[..]].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let alone = case.made("lin", &[&["lin"], &linear[1..]].concat(), &[&case.campaign()]);
    let (report, lin) = (cpf(&case.out(), &id(8, 0)), cpf(&alone, &id(8, 0)));
    assert_eq!(common::check::numbers(&report), common::check::numbers(&lin));
    assert_eq!(report["provenance"]["recipe"].to_string(), lin["provenance"]["recipe"].to_string());
    assert_eq!(number(&lin, "offset.trend_order"), 1.0);
    let tpf = parameters(&case.out().join(format!("THERMAL_PARAMETER__{}.TPF", id(8, 0).replace('_', "-"))));
    assert_eq!([tpf["sigma_x"].as_array().unwrap().len(), tpf["xi_xy"].as_array().unwrap().len()], [2, 1]);
    let command = tpf["provenance"]["command"].as_str().unwrap();
    says(command, &["--robust", "--max-field x=1500", "--order 1", "--order null=2", "--order sigma=1", "--settling 0.25"]);
    let output = calfit().arg("verify").args([case.out(), case.campaign()]).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

#[test]
fn help_and_manual_pages_have_examples_exit_status_and_files() {
    let folder = tempfile::tempdir().unwrap();
    assert_eq!(calfit().arg("man").arg(folder.path()).output().unwrap().status.code(), Some(0));
    let commands =
        ["lin", "offset", "freq", "thermal", "null", "report", "diagnose", "verify", "check", "inspect", "coil", "export"];
    for command in commands {
        let output = calfit().args([command, "--help"]).output().unwrap();
        says(&text(&output.stdout), &["EXAMPLES:", &format!("calfit {command} "), "EXIT STATUS:", "FILES:"]);
        let page = fs::read_to_string(folder.path().join(format!("calfit-{command}.1"))).unwrap();
        says(&page, &["EXAMPLES:", "EXIT STATUS:", "FILES:"]);
    }
}

#[test]
fn messages_name_the_real_error() {
    // A key is missing: entries of campaign.toml that would go with the run are not to blame.
    let case = Case::of(common::small().without_key("unit").text());
    case.put("campaign.toml", "[[sensor]]\nname = \"BS_11\"\ntemperature_channel = \"T59\"\n");
    let output = case.run("lin", &[]);
    assert_eq!(output.status.code(), Some(2));
    let said = text(&output.stderr);
    says(&said, &["the key `unit` is missing"]);
    assert!(!said.contains("goes with no run"), "{said}");

    // One run, twice.
    let case = Case::of(common::small().text());
    let mut zipped = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    zipped.write_all(common::small().text().as_bytes()).unwrap();
    case.put("13-04-03/09-22-38.CCR.gz", zipped.finish().unwrap());
    let said = text(&case.run("lin", &["--no-plots"]).stderr);
    says(&said, &["has the same run id as", "take one of the two out of the campaign: one is the other compressed"]);
    assert_eq!(number(&cpf(&case.out(), RUN_ID), "quality.blocks_total"), 10.0);

    // What is no text has no line ends.
    let mut gauss = common::Gauss(7);
    let mut bytes: Vec<u8> = (0..4096).map(|_| (gauss.uniform() * 128.0 + 128.0) as u8).collect();
    // In one line, which begins like no other format.
    bytes.iter_mut().filter(|b| **b == b'\n').for_each(|b| *b = b'\r');
    bytes[0] = 0x80;
    let said = text(&Case::of(bytes).run("lin", &[]).stderr);
    says(&said, &["the file is no text"]);
    assert!(!said.contains("line ends"), "{said}");
}

/// A whole picture of two pixels.
fn png() -> Vec<u8> {
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, 2, 1);
    encoder.set_color(png::ColorType::Grayscale);
    encoder.write_header().unwrap().write_image_data(&[0, 255]).unwrap();
    bytes
}

#[test]
fn what_is_stated_of_persons_instrument_and_days_stands_in_the_protocol() {
    let case = two_temperatures();
    let (run, day) = (id(8, 0), id(8, 0)[..8].to_owned());
    fs::create_dir_all(case.campaign().join("photos")).unwrap();
    fs::write(case.campaign().join("photos/setup.png"), png()).unwrap();
    fs::write(case.campaign().join("photos/box.jpg"), b"\xff\xd8\xff\xe0 a picture \xff\xd9").unwrap();
    let plain = fs::read_to_string(case.campaign().join("campaign.toml")).unwrap();
    let stated = plain.replace(
        "[report]\n",
        "[report]\npersonnel = [\"A. Person, operation\", \"B. Person, heating\"]\nremarks = \"Demagnetised before.\"\n\
         signatures = [\"A. Person, responsible\"]\n",
    );
    let more = format!(
        "[[report.table]]\ntitle = \"Parameters of the instrument\"\nhead = [\"parameter\", \"sensor 1\"]\n\
         rows = [[\"excitation, mA\", 12.5], [\"heater\", \"off\"]]\n\
         [[report.photo]]\nfile = \"photos/setup.png\"\ncaption = \"The coil system\"\n\
         [[report.photo]]\nfile = \"photos/box.jpg\"\ncaption = \"The thermal box\"\n\
         [[remark]]\nrun = \"{run}\"\ntext = \"door opened\"\n[[remark]]\nday = \"{day}\"\ntext = \"Nitrogen ran out at noon.\"\n\
         [[remark]]\nrun = \"99-01-01_00-00-00\"\ntext = \"nothing\"\n"
    );
    case.put("campaign.toml", stated + &more);
    let output = case.run("report", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["the remark on 99-01-01_00-00-00 goes with no run of the campaign"]);
    let page = first_page(&case);
    says(&page, &["| Personnel | A. Person, operation; B. Person, heating |", "Demagnetised before."]);
    let markdown = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(
        &markdown,
        &[
            "Parameters of the instrument",
            "| excitation, mA | 12.5 |",
            "| heater | off |",
            "![The coil system](PHOTO_1.png \"",
            "![The thermal box](PHOTO_2.jpg \"",
            "Nitrogen ran out at noon.",
            "| analysed. door opened |",
            "| A. Person, responsible | ",
        ],
    );
    // The copies are whole pictures, which the page holds.
    let copy = fs::read(case.out().join("PHOTO_1.png")).unwrap();
    let mut reader = png::Decoder::new(std::io::Cursor::new(&copy)).read_info().unwrap();
    let mut pixels = vec![0; reader.output_buffer_size().unwrap()];
    reader.next_frame(&mut pixels).unwrap();
    assert_eq!(pixels, [0, 255]);
    let html = fs::read_to_string(case.out().join("REPORT.html")).unwrap();
    assert_eq!((html.matches("data:image/png").count(), html.matches("data:image/jpeg").count()), (1, 1));
    // They belong to the result: the index has them, and they are written again.
    assert_eq!(calfit().arg("verify").arg(case.out()).output().unwrap().status.code(), Some(0));
    let before = tree(&case.out());
    assert_eq!(case.run("report", &["--no-plots"]).status.code(), Some(0));
    assert_eq!(tree(&case.out()), before);
    fs::write(case.campaign().join("photos/box.jpg"), b"\xff\xd8\xff\xe0 another one \xff\xd9").unwrap();
    assert_eq!(case.run("report", &["--no-plots"]).status.code(), Some(0));
    assert_ne!(tree(&case.out())["PHOTO_2.jpg"], before["PHOTO_2.jpg"]);

    // Nothing of it is printed where it is not stated.
    case.put("campaign.toml", plain);
    assert_eq!(case.run("report", &["--no-plots"]).status.code(), Some(0));
    let markdown = fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    for word in ["Personnel", "Signatures", "Photographs", "PHOTO_", "door opened"] {
        assert!(!markdown.contains(word), "{word}");
    }
}
