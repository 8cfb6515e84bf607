//! Where a sensor stood (`[[at]]`) and how it stands in its reference cube (`[[reference]]`): what `campaign.toml` may say, what is refused
//! by name, and what follows from it.

use crate::common;

use calfit::data::convention::{Alignment, Convention};
use common::check::{Case, calfit, cpf, number, numbers, parameters, says, text, three};
use nalgebra::Matrix3;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

/// Two linearity runs of the sample campaign, with something behind its `campaign.toml`.
fn sample(more: &str) -> Case {
    let case = Case::new();
    for run in ["26-01-15/09-00-00.CCR", "26-01-16/09-00-00.CCR"] {
        case.put(run, std::fs::read(repository("runs/sample").join(run)).unwrap());
    }
    let toml = std::fs::read_to_string(repository("runs/sample/campaign.toml")).unwrap();
    case.put("campaign.toml", format!("{toml}\n{more}"));
    case
}

/// The status and the messages of a command on the campaign.
fn told(case: &Case, command: &str) -> (Option<i32>, String) {
    let output = calfit().arg(command).arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
    (output.status.code(), text(&output.stderr))
}

/// Keys that are not known are kept with a warning; a slip is the likeliest reason, and the warning says of which key.
#[test]
fn a_misspelt_table_is_named_with_the_nearest_key() {
    let case = sample("[[positon]]\nid = 5\naxes = [\"-X\", \"-Y\", \"+Z\"]\n");
    let (status, said) = told(&case, "lin");
    assert_eq!(status, Some(0), "{said}");
    says(&said, &["campaign.toml", "the key `positon` is not known and was not used; the nearest known key is `position`"]);
}

/// A key that is no slip of another one is not said to be near one.
#[test]
fn a_key_that_resembles_none_is_told_with_those_that_are_known() {
    let case = sample("[[requirement]]\nmax = 1.0\n");
    let (status, said) = told(&case, "lin");
    assert_eq!(status, Some(0), "{said}");
    says(&said, &["the key `requirement` is not known and was not used; known keys here are", "`position`", "`exclude`"]);
    assert!(!said.contains("nearest"), "{said}");
}

/// What a TOML file is follows from its name, or from keys that only one kind has.
#[test]
fn check_takes_no_toml_for_a_campaign_file_that_is_not_named_so() {
    let case = Case::new();
    let telemetry = repository("configs/rosetta-telemetry.toml");
    let output = calfit().arg("check").arg(&telemetry).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(!text(&output.stderr).contains("is not known"), "{}", text(&output.stderr));
    // The twin names the one of the ground, and that its programmes.
    for entry in std::fs::read_dir(repository("configs")).unwrap() {
        let path = entry.unwrap().path();
        case.put(path.file_name().unwrap().to_str().unwrap(), std::fs::read_to_string(&path).unwrap());
    }
    let wrong = case.put("twin.toml", std::fs::read_to_string(&telemetry).unwrap().replace("truth_every", "truth_evry"));
    for (path, words) in [
        (wrong, vec!["truth_evry", "truth_every"]),
        (case.put("other.toml", "foo = 1\n"), vec!["other.toml", "is no TOML file that calfit knows", "campaign.toml"]),
        (case.put("broken.toml", "foo = \n"), vec!["broken.toml"]),
    ] {
        let output = calfit().arg("check").arg(&path).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", path.display());
        says(&text(&output.stderr), &words);
    }
    let campaign = case.put("campaign.toml", "name = \"A\"\n");
    assert_eq!(calfit().arg("check").arg(&campaign).output().unwrap().status.code(), Some(0));
}

#[test]
fn a_list_of_runs_that_names_none_is_named() {
    let case = sample("[lin]\nruns = [\"26-01-15_09-00-99\"]\n");
    let (status, said) = told(&case, "lin");
    assert_eq!(status, Some(2), "{said}");
    says(&said, &["holds no linearity run that `runs` of [lin] in campaign.toml names", "correct the ids there"]);
}

#[test]
fn a_location_that_cannot_be_is_refused_by_name() {
    let refused = [
        ("[[at]]\nruns = [\"26-01-15_09-00-01\"]\nlocation = \"off-centre\"", ["26-01-15_09-00-01", "none of the campaign"]),
        ("[[at]]\nruns = [\"26-01-15_09-00-00\"]\nlocation = \"off-center\"", ["`at.location`", "\"off-centre\""]),
        ("[[at]]\nruns = [\"26-01-15_09-00-00\", \"26-01-15_09-00-00\"]", ["26-01-15_09-00-00", "a second time"]),
        (
            "[[at]]\nruns = [\"26-01-15_09-00-00\"]\n[[at]]\nruns = [\"26-01-15_09-00-00\"]\nlocation = \"off-centre\"",
            ["26-01-15_09-00-00", "a second time"],
        ),
        ("[[at]]\nlocation = \"off-centre\"", ["`at.runs`", "missing"]),
        // The entry that lacks it is named by its line.
        (
            "[[at]]\nruns = [\"26-01-15_09-00-00\"]\n[[at]]\nlocation = \"off-centre\"",
            ["campaign.toml:38: the key `at.runs`", "missing"],
        ),
    ];
    for (more, words) in refused {
        let case = sample(more);
        for command in ["lin", "thermal", "report"] {
            let (status, messages) = told(&case, command);
            assert_eq!(status, Some(2), "{more}: {messages}");
            says(&messages, &["campaign.toml"]);
            says(&messages, &words);
            assert!(!case.out().join("INDEX.json").exists() && !case.out().join("REPORT.md").exists());
        }
        let checked = calfit().arg("check").arg(case.campaign()).output().unwrap();
        assert_eq!(checked.status.code(), Some(1), "{more}");
        says(&text(&checked.stderr), &words);
    }
}

const THIRD: &str = "[[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]";

#[test]
fn a_rotation_that_is_none_is_refused_by_name() {
    let entry = |rotation: &str, more: &str| format!("[[reference]]\nsensor = \"BS_11\"\nrotation = {rotation}\n{more}\n");
    let mirror = "[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, -1.0]]";
    let long = "[[1.0, 0.0, 0.0], [0.0, 1.001, 0.0], [0.0, 0.0, 1.0]]";
    let refused = [
        (entry(mirror, "std_deg = 0.01"), ["sensor BS_11", "is no rotation"]),
        (entry(long, "std_deg = 0.01"), ["sensor BS_11", "is no rotation"]),
        (entry("[[1.0, 0.0], [0.0, 1.0]]", "std_deg = 0.01"), ["`reference.rotation`", "three rows"]),
        (entry(THIRD, ""), ["`reference.std_deg`", "missing"]),
        (entry(THIRD, "std_deg = -0.01"), ["`reference.std_deg`", "negative"]),
        (entry(THIRD, "std_deg = 0.01\nconvention = \"champ\""), ["`reference.convention`", "\"rosetta\""]),
        (entry(THIRD, "std_deg = 0.01").repeat(2), ["`reference.sensor`", "has a reference already"]),
    ];
    for (more, words) in refused {
        let (status, messages) = told(&sample(&more), "lin");
        assert_eq!(status, Some(2), "{more}: {messages}");
        says(&messages, &words);
    }
    let other = entry(THIRD, "std_deg = 0.01").replace("BS_11", "BS_12");
    let (status, messages) = told(&sample(&other), "lin");
    assert_eq!(status, Some(0), "{messages}");
    says(&messages, &["[[reference]] sensor = \"BS_12\" goes with no run"]);
}

#[test]
fn a_place_changes_no_number_of_a_run_and_stands_in_its_file() {
    let (plain, beside) = (sample(""), sample("[[at]]\nruns = [\"26-01-15_09-00-00\"]\nlocation = \"off-centre\""));
    for case in [&plain, &beside] {
        let (status, messages) = told(case, "lin");
        assert_eq!(status, Some(0), "{messages}");
    }
    let [a, b] = [&plain, &beside].map(|case| cpf(&case.out(), "26-01-15_09-00-00"));
    assert!(a["run"].get("location").is_none());
    assert_eq!(b["run"]["location"].as_str(), Some("off-centre"));
    assert_eq!(numbers(&a), numbers(&b).replace("location = \"off-centre\"\n", ""));
    assert_eq!(numbers(&cpf(&plain.out(), "26-01-16_09-00-00")), numbers(&cpf(&beside.out(), "26-01-16_09-00-00")));
    // Runs at two places are no group: neither of the two temperatures has polynomials.
    let (status, messages) = told(&plain, "thermal");
    assert_eq!(status, Some(0), "{messages}");
    let (status, messages) = told(&beside, "thermal");
    assert_eq!(status, Some(0));
    says(&messages, &["BS_11 science mode 0, off-centre: its linearity runs", "at 1 different temperature"]);
}

fn rows(document: &DocumentMut) -> Matrix3<f64> {
    let rows: [[f64; 3]; 3] = std::array::from_fn(|r| three(document, &format!("reference.rotation.{r}")));
    Matrix3::from_fn(|r, c| rows[r][c])
}

/// σ and ξ of a calibration.
fn alignment(file: &DocumentMut) -> Alignment {
    let xi_deg = ["xi_xy", "xi_xz", "xi_yz"].map(|key| number(file, &format!("angle_deg.{key}")));
    Alignment { convention: Convention::BepiColombo, sigma: common::check::sigma(file), xi_deg }
}

/// σ and ξ of polynomials at a temperature.
fn polynomials(file: &DocumentMut, degc: f64) -> Alignment {
    let at = |key: &str| {
        let coefficients = file[key].as_array().unwrap().iter().map(|v| v.as_float().unwrap());
        coefficients.enumerate().map(|(k, c)| c * degc.powi(k as i32)).sum::<f64>()
    };
    let (sigma, xi_deg) = (["sigma_x", "sigma_y", "sigma_z"].map(at), ["xi_xy", "xi_xz", "xi_yz"].map(at));
    Alignment { convention: Convention::BepiColombo, sigma, xi_deg }
}

#[test]
fn a_reference_is_carried_into_every_file_in_the_frame_of_the_file() {
    let stated = Matrix3::new(0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 0.0);
    let entry = format!("[[reference]]\nsensor = \"BS_11\"\nrotation = {THIRD}\nstd_deg = 0.02\n");
    for (convention, key) in [(Convention::BepiColombo, ""), (Convention::Rosetta, "convention = \"rosetta\"\n")] {
        let case = sample(&format!("{entry}{key}"));
        for command in ["lin", "thermal"] {
            let (status, messages) = told(&case, command);
            assert_eq!(status, Some(0), "{messages}");
        }
        let file = cpf(&case.out(), "26-01-15_09-00-00");
        let tpf = parameters(&case.out().join("THERMAL_PARAMETER__26-01-15-09-00-00.TPF"));
        // The frame is the one that [apply] names, in a CPF before it goes on to coil axes.
        assert_eq!(tpf["reference"]["from"].as_str(), tpf["apply"]["frame"].as_str());
        assert!(file["apply"]["frame"].as_str().unwrap().ends_with(file["reference"]["from"].as_str().unwrap()));
        for file in [&file, &tpf] {
            assert_eq!(number(file, "reference.std_deg"), 0.02);
        }
        if convention == Convention::BepiColombo {
            assert_eq!((rows(&file), rows(&tpf)), (stated, stated));
            continue;
        }
        // One reading is one field in the cube: R_rosetta ω_R σ_R = R_file ω_B σ_B.
        let own = alignment(&file);
        let rosetta = own.to_other().unwrap().alignment;
        let difference = stated * rosetta.transfer().unwrap() - rows(&file) * own.transfer().unwrap();
        assert!(difference.amax() < 1e-12, "{difference}");
        assert!((rows(&file) - stated).amax() > 1e-5, "the frames are not one");
        // The same for the polynomials at the mean temperature of the runs.
        let degc: Vec<f64> = (0..2).map(|i| number(&tpf, &format!("temperature_degc.{i}"))).collect();
        let own = polynomials(&tpf, (degc[0] + degc[1]) / 2.0);
        let rosetta = own.to_other().unwrap().alignment;
        let difference = stated * rosetta.transfer().unwrap() - rows(&tpf) * own.transfer().unwrap();
        assert!(difference.amax() < 1e-12, "{difference}");
        assert!((rows(&tpf) - rows(&file)).amax() > 1e-6, "the frames turn with the temperature");
        for file in ["THERMAL_PARAMETER__26-01-15-09-00-00.TPF", "26-01-15_09-00-00/PARAMETER_LIN__26-01-15_09-00-00.CPF"] {
            let output = calfit().arg("verify").arg(case.out().join(file)).arg(case.campaign()).output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        }
    }
}
