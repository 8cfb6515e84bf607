//! The Python package: it reads what the program writes, and applies it; and the tools for flight data.

use crate::common;

use calfit::files::parameter::KINDS;
use common::Gauss;
use common::check::{Case, calfit, data, text};
use common::python::Environment;
use serde_json::{Value, json};
use std::fmt::Write;
use std::fs;
use std::path::{Path, PathBuf};

/// Copies a folder with its folders.
fn copied(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap().map(Result::unwrap) {
        let to = to.join(entry.file_name());
        if entry.path().is_dir() {
            copied(&entry.path(), &to);
        } else {
            fs::copy(entry.path(), to).unwrap();
        }
    }
}

/// Every kind of parameter file that can be had from a small campaign, and the twins and ground calibration files made of them. The
/// campaign's own orders of the polynomials describe the twin; a ground calibration file holds straight lines only.
fn files(case: &Case) {
    let inputs = Case::new();
    let campaign = inputs.campaign();
    copied(&data("tests/data/version-1/campaign"), &campaign);
    let mut told = fs::read_to_string(campaign.join("campaign.toml")).unwrap();
    told.push_str(
        "\n[[reference]]\nsensor = \"FGM\"\nrotation = [[0.0, 0.6, 0.8], [0.0, -0.8, 0.6], [1.0, 0.0, 0.0]]\nstd_deg = 0.02\n",
    );
    fs::write(campaign.join("campaign.toml"), told).unwrap();
    let reference = data("tests/data/version-1/inputs/reference.csv");
    let model = data("tests/data/version-1/inputs/model.toml");
    let run = |name: &str| campaign.join("26-03-02").join(name);
    let polynomials = "THERMAL_PARAMETER__26-03-02-08-00-00.TPF";
    let centre = "26-03-02_08-00-00/PARAMETER_TEMPLIN__26-03-02_08-00-00.CPF";
    let tcf = "THERMAL_CENTRE_PARAMETER__26-03-02-08-00-00.TCF";

    let thermal = case.made("thermal", &["thermal"], &[&campaign]);
    let offset = thermal.join("26-03-02_08-05-00/OFF_PARAMETER__26-03-02-08-05-00.OPF");
    let of = |folder: &Path| [folder.join(polynomials), folder.join(centre)];
    let [tpf, cpf] = of(&thermal);
    let at_centre = case.made("centre", &["thermal"], &[&tpf, Path::new("--centre"), &cpf, Path::new("--offset"), &offset]);
    let line = case.made("line", &["thermal", "--order", "b_or=1", "--order", "b_off=1"], &[&campaign]);
    let [line_tpf, line_cpf] = of(&line);
    let line_centre = case.made("line_centre", &["thermal"], &[&line_tpf, Path::new("--centre"), &line_cpf]);
    let thermistor = case.made(
        "thermistor",
        &["thermistor", "--signal", "u", "--order", "3"],
        &[&data("tests/data/rosetta/pt1000_table.csv"), Path::new("--reference"), &reference],
    );
    case.made("linearise", &["lin", "--linearise", "--order", "0"], &[&data("runs/champ-1998")]);
    case.made("model", &["lin"], &[&data("tests/data/cases/26-05-02.CCR.gz"), Path::new("--model"), &model]);
    case.made("null", &["null"], &[&campaign]);
    case.made("scalar", &["coil", "scalar"], &[&run("07-00-00.CCR.gz")]);
    case.made("residual", &["coil", "residual"], &[&run("07-30-00.CCR.gz")]);

    let tof = |folder: &Path| folder.join("THERMAL_OFF_PARAMETER__26-03-02-08-05-00.TOF");
    let table = thermistor.join("THERMISTOR__pt1000_table.toml");
    case.made("rpcmag", &["export", "--format", "rpcmag"], &[&line_centre.join(tcf), &tof(&line), &table]);
    case.made("json", &["export", "--format", "json"], &[&tpf, &tof(&thermal), &cpf, &offset, &at_centre.join(tcf)]);
    linearised(case);
}

/// Polynomials of linearised readings, beside the centre and at it, made of calibrations as another program may write them.
fn linearised(case: &Case) {
    let cpf = |run: &str, t: f64| {
        format!(
            "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"FM\"\nmode = \"m\"\ntemperature_degc = {t:?}\n[matrix]\n\
             omega_convention = \"BepiColombo\"\nr_nom = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n\
             sigma = [[{:?}, 0.0, 0.0], [0.0, {:?}, 0.0], [0.0, 0.0, 1.01]]\n\
             [angle_deg]\nxi_xy = {:?}\nxi_xz = 89.8\nxi_yz = 90.1\n[offset]\nb_or_ent = [{:?}, -20.0, 30.0]\n\
             [std]\nsigma = [4e-6, 5e-6, 6e-6]\nxi_deg = [4e-4, 5e-4, 6e-4]\nb_or_ent = [0.05, 0.06, 0.07]\n\
             [valid]\nfield_coil_nt = [[-9000.0, 8000.0], [-9500.0, 9000.0], [-8000.0, 9500.0]]\n\
             [linearisation]\nfile = \"LINEARISATION.toml\"\n[linearisation.applied]\n\
             c2_per_ent = [2e-9, -1e-9, 0.0]\nc2_std_per_ent = [1e-10, 1e-10, 1e-10]\n\
             c3_per_ent2 = [3e-13, 0.0, -2e-13]\nc3_std_per_ent2 = [1e-14, 1e-14, 1e-14]\n\
             reading_ent = [[-7000.0, 7500.0], [-9500.0, 9500.0], [-9500.0, 9500.0]]\n",
            1.02 + 2e-5 * t,
            0.99 - 1e-5 * t,
            90.3 + 1e-4 * t,
            10.0 + 0.1 * t
        )
    };
    let opf = "format = \"OPF\"\nversion = 1\noffset_ent = [4.0, -3.0, 2.0]\noffset_std_ent = [0.05, 0.06, 0.07]\n[run]\n\
               id = \"26-06-05_00-00-00\"\nsensor = \"FM\"\nmode = \"m\"\ntemperature_degc = 15.0\n";
    // In a folder of their own, since they are not what the program writes.
    let inputs = Case::new();
    let runs = [("26-06-01_00-00-00", -30.0), ("26-06-02_00-00-00", 15.0), ("26-06-03_00-00-00", 55.0)];
    let runs = runs.map(|(run, t)| inputs.put(&format!("{run}.CPF"), cpf(run, t)));
    let centre = inputs.put("CENTRE.CPF", cpf("26-06-04_00-00-00", 15.0));
    let offset = inputs.put("TURNED.OPF", opf);
    let line = ["thermal", "--order", "sigma=1", "--order", "xi=1", "--order", "b_or=1"];
    let made = case.made("linearised", &line, &runs.each_ref().map(PathBuf::as_path));
    let tpf = made.join("THERMAL_PARAMETER__26-06-01-00-00-00.TPF");
    let at_centre: [&Path; 5] = [&tpf, Path::new("--centre"), &centre, Path::new("--offset"), &offset];
    case.made("linearised_centre", &["thermal"], &at_centre);
}

/// Below, within and above the ranges of all files, °C; nan is an empty cell.
const TEMPERATURES: [f64; 11] = [-60.0, -41.0, -29.0, 16.6, 18.5, 20.0, 20.01, 54.9, 79.9, 81.0, f64::NAN];

/// What `calfit apply` makes of readings inside and outside of what was calibrated, in `applied/NAME` and, with `--outside null`, in
/// `applied/NAME.null`; `applied/cases.json` says of which files and how.
fn applied(case: &Case) {
    let folder = case.path().join("applied");
    fs::create_dir_all(&folder).unwrap();
    let run = "26-03-02_08-00-00/PARAMETER_TEMPLIN__26-03-02_08-00-00.CPF";
    let [cpf, line] = [format!("thermal/{run}"), "linearise/98-03-23_00-00-04/PARAMETER_LIN__98-03-23_00-00-04.CPF".to_owned()];
    let model = "model/26-05-02_10-00-00/PARAMETER_LIN__26-05-02_10-00-00.CPF".to_owned();
    let polynomials = |folder: &str| format!("{folder}/THERMAL_PARAMETER__26-03-02-08-00-00.TPF");
    let centre = |folder: &str| format!("{folder}/THERMAL_CENTRE_PARAMETER__26-03-02-08-00-00.TCF");
    let tof = |folder: &str| format!("{folder}/THERMAL_OFF_PARAMETER__26-03-02-08-05-00.TOF");
    let opf = "thermal/26-03-02_08-05-00/OFF_PARAMETER__26-03-02-08-05-00.OPF".to_owned();
    let linearised = "linearised/THERMAL_PARAMETER__26-06-01-00-00-00.TPF".to_owned();
    let linearised_centre = "linearised_centre/THERMAL_CENTRE_PARAMETER__26-06-01-00-00-00.TCF".to_owned();
    let ground = "rpcmag/RPCMAG_GND_CALIB_FGM.TXT".to_owned();
    // The largest component of the readings, enT, beyond the fields that were applied.
    let cases: Vec<(&str, Vec<String>, &str, bool, f64)> = vec![
        ("CPF", vec![cpf.clone()], "sensor", false, 2600.0),
        ("CPF coil", vec![cpf.clone()], "coil", false, 2600.0),
        ("CPF reference", vec![cpf], "reference", false, 2600.0),
        ("CPF linearised", vec![line.clone()], "sensor", false, 70_000.0),
        ("CPF linearised coil", vec![line], "coil", false, 70_000.0),
        ("CPF model", vec![model], "sensor", true, 2600.0),
        ("TPF", vec![polynomials("thermal")], "sensor", false, 2600.0),
        ("TPF TOF", vec![polynomials("thermal"), tof("thermal")], "sensor", false, 2600.0),
        ("TPF TOF reference", vec![polynomials("thermal"), tof("thermal")], "reference", false, 2600.0),
        ("TPF OPF", vec![polynomials("thermal"), opf], "sensor", false, 2600.0),
        ("TPF linearised", vec![linearised], "sensor", false, 11_000.0),
        ("TCF", vec![centre("centre")], "sensor", false, 2600.0),
        ("TCF reference", vec![centre("centre")], "reference", false, 2600.0),
        ("TCF TOF", vec![centre("line_centre"), tof("line")], "sensor", false, 2600.0),
        ("TCF linearised", vec![linearised_centre], "sensor", false, 11_000.0),
        ("RPCMAG", vec![ground.clone()], "sensor", false, 2600.0),
        ("RPCMAG reference", vec![ground], "reference", false, 2600.0),
    ];
    let mut listed: Vec<Value> = Vec::new();
    let mut gauss = Gauss(17);
    for (name, files, frame, effects_taken_off, largest_ent) in cases {
        let mut table = "x,y,z,t_degc\n".to_owned();
        for row in 0..220 {
            let [x, y, z] = [(); 3].map(|()| largest_ent * gauss.uniform());
            let t = TEMPERATURES[row % TEMPERATURES.len()];
            let t = if t.is_nan() { String::new() } else { format!("{t:?}") };
            writeln!(table, "{x:?},{y:?},{z:?},{t}").unwrap();
        }
        let raw = folder.join("raw.csv");
        fs::write(&raw, table).unwrap();
        for (out, outside) in [(name.to_owned(), "flag"), (format!("{name}.null"), "null")] {
            let mut command = calfit();
            command.arg("apply").args(files.iter().map(|file| case.path().join(file))).arg(&raw).arg("-o").arg(folder.join(&out));
            command.args(["--frame", frame, "--outside", outside]).args(effects_taken_off.then_some("--effects-taken-off"));
            let output = command.output().unwrap();
            assert_eq!(output.status.code(), Some(0), "{out}: {}", text(&output.stderr));
        }
        listed.push(json!({"name": name, "files": files, "frame": frame, "effects_taken_off": effects_taken_off}));
    }
    fs::write(folder.join("cases.json"), serde_json::to_string(&listed).unwrap()).unwrap();
}

#[test]
fn the_package_reads_and_applies_what_the_program_writes() {
    let Some(environment) = Environment::of("calfit", &["numpy", "pytest"], &["python"]) else { return };
    let case = Case::new();
    files(&case);
    applied(&case);
    let output = environment
        .python()
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"])
        .arg(data("python/tests"))
        .env("CALFIT_FILES", case.path())
        .env("CALFIT_KINDS", KINDS.iter().map(|kind| kind.format).collect::<Vec<_>>().join(" "))
        .output()
        .unwrap();
    let said = text(&output.stdout);
    assert!(output.status.success(), "{said}{}", text(&output.stderr));
    // With the files of the program and the project around it nothing is left out.
    assert!(said.contains(" passed") && !said.contains("skipped"), "{said}");
}

#[test]
fn the_tools_for_flight_data_do_what_they_promise() {
    let packages = ["cdflib", "distributed", "numpy", "pyarrow", "pytest", "spiceypy"];
    let Some(environment) = Environment::of("tools", &packages, &[]) else { return };
    let output = environment
        .python()
        .args(["-m", "pytest", "-q", "-rs", "-p", "no:cacheprovider"])
        .arg(data("tools/tests"))
        .output()
        .unwrap();
    let said = text(&output.stdout);
    assert!(output.status.success(), "{said}{}", text(&output.stderr));
    assert!(said.contains(" passed") && !said.contains("skipped"), "{said}");
}
