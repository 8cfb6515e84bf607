//! `calfit export`: every format holds what the parameter file holds, and a ground calibration file loses nothing.

use crate::common;

use calfit::data::convention::Convention;
use calfit::data::note::{Note, NoteKind, Told};
use calfit::data::provenance::Provenance;
use calfit::data::recipe::Recipe;
use calfit::data::reference::Reference;
use calfit::data::result::Covariance;
use calfit::files::export::rpcmag::{RpcMag, parse, read};
use common::check::{Case, calfit, number, parameters, says, text, three};
use proptest::prelude::*;
use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

fn export(format: &str, files: &[&Path], out: &Path, more: &[&str]) -> Output {
    calfit().args(["export", "--format", format]).args(files).arg("-o").arg(out).args(more).output().unwrap()
}

#[track_caller]
fn done(output: &Output) {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

/// Any number that a file may hold, up to 1e30, subnormal and negative zero included.
fn finite() -> impl Strategy<Value = f64> {
    let number = any::<u64>().prop_map(f64::from_bits).prop_filter("finite", |v| v.is_finite());
    number.prop_map(|v| if v.abs() > 1e30 { 1.0 / v } else { v })
}

fn three_of() -> impl Strategy<Value = [f64; 3]> {
    proptest::array::uniform3(finite())
}

/// A rotation about z.
fn rotation(deg: f64) -> [[f64; 3]; 3] {
    let (sin, cos) = deg.to_radians().sin_cos();
    [[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]]
}

prop_compose! {
    fn calibration()(
        sensor in "[ -~°ξ\n\"\\\\]{1,12}",
        a in [three_of(), three_of()],
        b_res_ent in three_of(),
        // Sensitivities are positive and three axes have the angles at every temperature from -300 to 300.
        sigma_0 in proptest::array::uniform3(1.0..1e30f64),
        sigma_1 in proptest::array::uniform3(-1e-3..1e-3f64),
        xi in [proptest::array::uniform3(80.0..100.0f64), proptest::array::uniform3(-1e-3..1e-3f64)],
        k in three_of(),
        diagonal in proptest::array::uniform3(1e-30..1e30f64),
        thermistor in proptest::array::uniform4(finite()),
        t_off_degc in finite(),
        std in three_of().prop_map(|std| std.map(f64::abs)),
        variance in finite().prop_map(f64::abs),
        field_nt in proptest::option::of(three_of().prop_map(|field| field.map(f64::abs))),
        low in -273.0..0.0f64,
        high in 0.0..300.0f64,
        turn_deg in proptest::option::of(-180.0..180.0f64),
    ) -> RpcMag {
        RpcMag {
            mode: sensor.chars().rev().collect(),
            sensor,
            valid_degc: [low, high],
            a,
            b_res_ent,
            sigma: [sigma_0, sigma_1],
            xi,
            k_inverse: [[diagonal[0], k[0], k[1]], [0.0, diagonal[1], k[2]], [0.0, 0.0, diagonal[2]]],
            thermistor,
            t_off_degc,
            std: BTreeMap::from([("A_1".to_owned(), std.to_vec()), ("K_2".to_owned(), std.to_vec()), ("T_OFF".to_owned(), vec![std[0]])]),
            reference: turn_deg.map(|deg| Reference {
                stated_rotation: None,
                rotation: rotation(deg),
                std_deg: deg.abs(),
                from: Convention::Rosetta.sensor_frame().to_owned(),
                stated_for: Convention::BepiColombo,
            }),
            covariance: field_nt.map(|_| Covariance {
                parameters: vec!["A_0_x".to_owned()],
                units: vec!["enT".to_owned()],
                matrix: vec![vec![variance]],
            }),
            known_effects: field_nt.iter().map(|_| "a \"model\".toml".to_owned()).collect(),
            valid_field_nt: field_nt.map(|limits| limits.map(|b| [-b, b])),
            told: Told::of(&field_nt.iter().map(|_| Note::new(NoteKind::GainJump, "a \"jump\"")).collect::<Vec<_>>()),
        }
    }
}

proptest! {
    #[test]
    fn a_ground_calibration_file_read_back_holds_every_bit(file in calibration()) {
        let text = file.to_text(&Provenance::new(Recipe::plain("export"), Vec::new())).unwrap();
        let mut findings = Vec::new();
        let back = parse("file", &text, &mut findings).unwrap();
        prop_assert_eq!(format!("{:?}", back), format!("{:?}", file));
        prop_assert!(findings.is_empty());
    }
}

const CYCLE_DEGC: [f64; 4] = [-60.0, -20.0, 20.0, 60.0];

fn cpf(run: &str, degc: f64, off_centre: f64) -> String {
    let sigma: [f64; 3] = [1.09 - 1.42e-5 * degc, 1.094 - 9e-6 * degc, 1.0937].map(|s| s * (1.0 - off_centre));
    let [x, y, z] = sigma;
    format!(
        "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"IB\"\nmode = \"m\"\ntemperature_degc = {degc:?}\n[matrix]\n\
         sigma = [[{x:?}, 0.0, 0.0], [0.0, {y:?}, 0.0], [0.0, 0.0, {z:?}]]\n\
         [angle_deg]\nxi_xy = {:?}\nxi_xz = {:?}\nxi_yz = 89.95\n[offset]\nb_or_ent = [{:?}, -119.8, 494.0]\n\
         [std]\nsigma = [2e-6, 2e-6, 2e-6]\nxi_deg = [1e-4, 1e-4, 1e-4]\nb_or_ent = [0.5, 0.5, 0.5]\n",
        90.03 + 8.54e-5 * degc + 10.0 * off_centre,
        89.94 + 20.0 * off_centre,
        114.3 - 0.565 * degc
    )
}

fn opf(run: &str, degc: f64) -> String {
    format!(
        "format = \"OPF\"\nversion = 1\noffset_ent = [{:?}, -121.8, 509.0]\noffset_std_ent = [0.2, 0.2, 0.2]\n[run]\nid = \"{run}\"\n\
         sensor = \"IB\"\nmode = \"m\"\ntemperature_degc = {degc:?}\n",
        116.3 - 0.565 * degc
    )
}

/// Results of a sensor that `calfit` itself made.
struct Made {
    case: Case,
    tcf: PathBuf,
    tpf: PathBuf,
    tof: PathBuf,
    thermistor: PathBuf,
}

fn made(tcf_with_offset: bool) -> Made {
    let case = Case::new();
    for (i, degc) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        case.put(&format!("{run}.CPF"), cpf(&run, degc, 1e-3));
        case.put(&format!("{run}.OPF"), opf(&run, degc));
    }
    let put = |name: &str, content: String| {
        let path = case.path().join(name);
        fs::write(&path, content).unwrap();
        path
    };
    let centre = put("CENTRE.CPF", cpf("01-06-08_09-00-00", 17.39, 0.0));
    let offset = put("OFFSET.OPF", opf("01-06-09_09-00-00", 17.39));
    let mut command = calfit();
    command.arg("thermal").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").arg("--centre").arg(&centre);
    if tcf_with_offset {
        command.arg("--offset").arg(&offset);
    }
    done(&command.args(["--order", "sigma=1", "--order", "xi=1", "--order", "b_or=1", "--order", "b_off=1"]).output().unwrap());

    let pt1000 = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosetta/pt1000_table.csv");
    // U and T of the printed cubic, 1.5 °C below the reference thermometer.
    let cubic = |u: f64| -368.61072 + u * (458.49304 + u * (-356.0289 + u * 180.00644));
    let rows: String = [1.0, 1.2, 1.4].map(|u| format!("{:?},{u:?}\n", cubic(u) + 1.5)).concat();
    let reference = put("reference.csv", format!("reference_degc,u_volt\n{rows}"));
    let mut command = calfit();
    command.arg("thermistor").arg(pt1000).args(["--order", "3", "--no-plots", "-o"]).arg(case.out());
    done(&command.arg("--reference").arg(reference).output().unwrap());
    let file = |name: &str| case.out().join(name);
    Made {
        tcf: file("THERMAL_CENTRE_PARAMETER__01-06-01-09-00-00.TCF"),
        tpf: file("THERMAL_PARAMETER__01-06-01-09-00-00.TPF"),
        tof: file("THERMAL_OFF_PARAMETER__01-06-01-09-00-00.TOF"),
        thermistor: file("THERMISTOR__pt1000_table.toml"),
        case,
    }
}

const NAME: &str = "RPCMAG_GND_CALIB_IB.TXT";

#[test]
fn a_ground_calibration_file_holds_the_values_of_its_parameter_files() {
    let made = made(true);
    let out = made.case.path().join("rpcmag");
    done(&export("rpcmag", &[&made.tcf, &made.thermistor], &out, &[]));
    let (file, _) = read(&out.join(NAME), &mut Vec::new()).unwrap();
    let (tcf, thermistor) = (parameters(&made.tcf), parameters(&made.thermistor));
    for (i, c) in ["x", "y", "z"].into_iter().enumerate() {
        let pair = ["xy", "xz", "yz"][i];
        for k in 0..2 {
            assert_eq!(file.sigma[k][i], number(&tcf, &format!("sigma_{c}.{k}")));
            assert_eq!(file.xi[k][i], number(&tcf, &format!("off_centre.coefficients.xi_{pair}.{k}")));
            assert_eq!(file.a[k][i], number(&tcf, &format!("off_centre.coefficients.b_or_{c}.{k}")));
            let variance = number(&tcf, &format!("covariance.sigma_{c}.{k}.{k}"));
            assert_eq!(file.std[["SIGMA_00", "SIGMA_01"][k]][i], variance.sqrt());
        }
        assert_eq!(file.k_inverse[i], three(&tcf, &format!("k_inverse.{i}")));
    }
    assert_eq!(file.b_res_ent, three(&tcf, "residual_field.b_res_ent"));
    assert!((file.b_res_ent[0] + 2.0).abs() < 1e-9 && (file.b_res_ent[2] + 15.0).abs() < 1e-9);
    assert_eq!(file.thermistor, std::array::from_fn(|k| number(&thermistor, &format!("coefficients.{k}"))));
    assert_eq!(file.t_off_degc, number(&thermistor, "reference.offset_degc"));
    // The best cubic of the table is the printed one to a few thousandths of a degree.
    assert!((file.t_off_degc + 1.5).abs() < 0.01);
    assert_eq!((file.sensor.as_str(), file.valid_degc), ("IB", [-60.0, 60.0]));

    // An offset of the turned sensor holds no residual field.
    done(&export("rpcmag", &[&made.tcf, &made.tof, &made.thermistor], &out, &[]));
    let (file, _) = read(&out.join(NAME), &mut Vec::new()).unwrap();
    assert_eq!((file.b_res_ent, file.a[0][0]), ([0.0; 3], number(&parameters(&made.tof), "b_off_x.0")));
    done(&export("rpcmag", &[&made.tpf, &made.tof, &made.thermistor], &out, &["--at-centre"]));
    let (file, _) = read(&out.join(NAME), &mut Vec::new()).unwrap();
    assert_eq!(file.k_inverse, [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]);
    // The polynomials of the TPF are in the other convention: to first order in the misalignment the same sensitivities, and 180 degrees
    // minus the angles; squares of misalignments of a thousandth are left.
    let tpf = parameters(&made.tpf);
    assert!((file.sigma[0][0] / number(&tpf, "sigma_x.0") - 1.0).abs() < 2e-6);
    assert!((file.xi[0][0] + number(&tpf, "xi_xy.0") - 180.0).abs() < 1e-3);
    assert!((file.xi[1][0] + number(&tpf, "xi_xy.1")).abs() < 1e-7);

    let check = |name: &str, content: &str| {
        let path = made.case.path().join(name);
        fs::write(&path, content).unwrap();
        let output = calfit().arg("check").arg(&path).output().unwrap();
        (output.status.code(), text(&output.stderr))
    };
    let good = fs::read_to_string(out.join(NAME)).unwrap();
    let (status, told) = check("RPCMAG_A.TXT", &good);
    assert_eq!(status, Some(0));
    // What the calibration of the thermistor leaves of its table goes with its coefficients.
    says(&told, &["FIT: THERMISTOR__pt1000_table.toml: the polynomial of order 3 leaves"]);
    assert_eq!(told.lines().count(), 1, "{told}");
    let unsigned: String = good.lines().filter(|l| !l.starts_with("content_sha256")).map(|l| format!("{l}\n")).collect();
    assert_eq!(check("RPCMAG_A.TXT", &unsigned).0, Some(0), "files by hand have no hash");
    let line = |label: &str| unsigned.lines().find(|l| l.starts_with(&format!("{label} = "))).unwrap().to_owned();
    for (from, to, message) in [
        (good.clone(), good.replacen("XI_10 = [8", "XI_10 = [7", 1), "was changed after it was written"),
        (unsigned.clone(), unsigned.replace(&line("T_3"), ""), "the key `T_3` is missing"),
        (unsigned.clone(), unsigned.replace(&line("T_OFF"), "T_OFF = nan"), "`T_OFF` must be a finite number"),
        (unsigned.clone(), unsigned.replace(&line("A_1"), "A_1 = [1.0, 2.0]"), "`A_1` must be 3 numbers"),
        (unsigned.clone(), unsigned.replace(&line("K_1"), "K_1 = [1e-4, 1.0, 0.0]"), "`K_1` must be zero before the diagonal"),
        (unsigned.clone(), unsigned.replace("\"Rosetta\"", "\"BepiColombo\""), "`omega_convention` is not `Rosetta`"),
        (unsigned.clone(), unsigned.replace("T_2 = ", "T_1 = "), "duplicate key"),
        (unsigned.clone(), unsigned.split_inclusive('\n').take(30).collect(), "is missing"),
    ] {
        assert_ne!(from, to, "{message}");
        let (code, messages) = check("RPCMAG_B.TXT", &to);
        assert_eq!(code, Some(1), "{message}");
        says(&messages, &["RPCMAG_B.TXT", message]);
    }
}

#[test]
fn what_a_ground_calibration_file_lacks_is_named() {
    let made = made(false);
    let out = made.case.path().join("rpcmag");
    let refused = |files: &[&Path], more: &[&str], messages: &[&str]| {
        let output = export("rpcmag", files, &out, more);
        assert_eq!(output.status.code(), Some(2), "{messages:?}");
        says(&text(&output.stderr), messages);
        assert!(!out.join(NAME).exists());
    };
    refused(
        &[&made.tof],
        &[],
        &["SIGMA_00, SIGMA_01, XI_10, XI_11 lack a TCF", "K_0, K_1, K_2 lack a TCF", "T_OFF lack a THERMISTOR"],
    );
    refused(&[&made.tpf, &made.tof, &made.thermistor], &[], &["K_0, K_1, K_2 lack a TCF", "--at-centre"]);
    refused(&[&made.tcf, &made.thermistor], &[], &["A_0, A_1 lack a TOF file, or a TCF file made with --offset"]);
    refused(&[&made.tcf, &made.tof], &[], &["T_0 to T_3 and T_OFF lack a THERMISTOR file"]);
    refused(&[&made.tcf, &made.tcf], &[], &["is a second TCF file"]);
    refused(&[&made.tcf, &made.tpf], &[], &["is not needed beside the TCF"]);
    refused(&[&made.tcf], &["--at-centre"], &["comes from a position beside the centre"]);
    let beside = Case::new();
    for (i, degc) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        beside
            .put(&format!("{run}.CPF"), cpf(&run, degc, 1e-3).replace("mode = \"m\"", "mode = \"m\"\nlocation = \"off-centre\""));
    }
    let mut command = calfit();
    command.arg("thermal").arg(beside.campaign()).args(["--order", "sigma=1", "--order", "xi=1", "--no-plots", "-o"]);
    done(&command.arg(beside.out()).output().unwrap());
    let tpf = beside.out().join("THERMAL_PARAMETER__01-06-01-09-00-00.TPF");
    refused(&[&tpf, &made.tof, &made.thermistor], &["--at-centre"], &["beside the centre", "thermal --centre"]);
    // What says that it was measured beside the centre is none at the centre, and one result is no pair.
    let own = beside.campaign().join("01-06-01_09-00-00.CPF");
    let centre = made.case.path().join("CENTRE.CPF");
    let pair = |arguments: &[&Path]| {
        let mut command = calfit();
        command.arg("thermal").arg(&tpf).args(arguments).arg("-o").arg(beside.path().join("pair"));
        let output = command.output().unwrap();
        assert_ne!(output.status.code(), Some(0));
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let flag = Path::new;
    says(
        &pair(&[flag("--centre"), &own]),
        &["01-06-01_09-00-00.CPF", "beside the centre", "name the result of a run at the centre"],
    );
    says(
        &pair(&[flag("--centre"), &centre, flag("--off-centre"), &centre]),
        &["CENTRE.CPF", "the same as the result at the centre"],
    );
    // The other forms say it with the values.
    for (format, end) in [("csv", "csv"), ("dcc", "xml")] {
        done(&export(format, &[&tpf], &beside.path().join(format), &[]));
        let name = format!("THERMAL_PARAMETER__01-06-01-09-00-00.TPF.{end}");
        says(&fs::read_to_string(beside.path().join(format).join(name)).unwrap(), &["location", "beside the centre"]);
    }
    refused(&[&made.case.campaign().join("01-06-01_09-00-00.CPF")], &[], &["01-06-01_09-00-00.CPF"]);
    let table = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosetta/pt1000_table.csv");
    let fifth = made.case.path().join("fifth");
    done(&calfit().arg("thermistor").arg(table).args(["--no-plots", "-o"]).arg(&fifth).output().unwrap());
    let fifth = fifth.join("THERMISTOR__pt1000_table.toml");
    refused(&[&made.tcf, &made.tof, &fifth], &[], &["is of order 5 in V", "--order 3"]);
}

/// Rows of an exported table by name and component.
fn table(path: &Path) -> BTreeMap<(String, String), Vec<String>> {
    let content = fs::read_to_string(path).unwrap();
    let mut lines = content.lines();
    assert!(lines.next().unwrap().starts_with("# calfit "));
    assert_eq!(lines.next(), Some("name,component,value,standard_uncertainty,unit,frame,valid_from,valid_to,valid_unit"));
    let mut rows = BTreeMap::new();
    for line in lines {
        let cells: Vec<String> = line.split(',').map(str::to_owned).collect();
        assert_eq!(cells.len(), 9, "{line}");
        assert!(rows.insert((cells[0].clone(), cells[1].clone()), cells).is_none(), "{line} is there twice");
    }
    rows
}

/// A linear calibration of a synthetic run.
fn lin() -> (Case, PathBuf) {
    let case = Case::of(common::good().text());
    assert_eq!(case.run("lin", &["--no-plots"]).status.code(), Some(0));
    let path = case.out().join(common::RUN_ID).join(format!("PARAMETER_LIN__{}.CPF", common::RUN_ID));
    (case, path)
}

#[test]
fn json_holds_every_key_and_number() {
    let (case, cpf) = lin();
    let made = made(true);
    let out = case.path().join("json");
    done(&export("json", &[&cpf, &made.tcf, &made.thermistor], &out, &[]));
    for file in [&cpf, &made.tcf, &made.thermistor] {
        let name = format!("{}.json", file.file_name().unwrap().to_string_lossy());
        let mut tree: serde_json::Value = serde_json::from_str(&fs::read_to_string(out.join(name)).unwrap()).unwrap();
        assert!(tree.as_object_mut().unwrap().remove("written_by").is_some());
        let toml: serde_json::Value = toml_edit::de::from_document(parameters(file)).unwrap();
        assert_eq!(tree, toml);
    }
    // What was written may be written again; what others wrote may not.
    done(&export("json", &[&cpf], &out, &[]));
    fs::write(out.join(format!("{}.json", cpf.file_name().unwrap().to_string_lossy())), "{}").unwrap();
    let output = export("json", &[&cpf], &out, &[]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["was not written by calfit"]);
}

#[test]
fn a_table_has_one_row_per_quantity() {
    let (case, cpf) = lin();
    let made = made(true);
    let out = case.path().join("csv");
    done(&export("csv", &[&cpf, &made.tpf, &made.tof, &made.tcf, &made.thermistor], &out, &[]));
    let rows = |file: &Path| table(&out.join(format!("{}.csv", file.file_name().unwrap().to_string_lossy())));
    let value = |row: &[String], at: usize| row[at].parse::<f64>().unwrap();
    let quantities = |all: &BTreeMap<(String, String), Vec<String>>| all.keys().filter(|(name, _)| name != "correlation").count();
    let document = parameters(&cpf);
    let all = rows(&cpf);
    // σ, ξ, λ μ ν, B_or, two matrices, the temperature.
    assert_eq!(quantities(&all), 3 + 3 + 3 + 3 + 9 + 9 + usize::from(document["run"].get("temperature_degc").is_some()));
    let row = &all[&("sigma".to_owned(), "y".to_owned())];
    assert_eq!((value(row, 2), value(row, 3)), (number(&document, "matrix.sigma.1.1"), number(&document, "std.sigma.1")));
    assert_eq!((row[4].as_str(), row[5].as_str()), ("nT/enT", "sensor axes"));
    let row = &all[&("phi".to_owned(), "23".to_owned())];
    assert_eq!((value(row, 2), value(row, 3)), (number(&document, "matrix.phi.1.2"), number(&document, "std.phi.1.2")));

    let document = parameters(&made.tpf);
    let all = rows(&made.tpf);
    assert_eq!(quantities(&all), 18);
    let c = |i: usize, k: usize| number(&document, &format!("covariance.xi_xz.{i}.{k}"));
    let row = &all[&("correlation".to_owned(), "xi_T0 xz * xi_T1 xz".to_owned())];
    assert!((value(row, 2) - c(0, 1) / (c(0, 0) * c(1, 1)).sqrt()).abs() < 1e-15);
    assert_eq!(row[4], "1");
    let head = fs::read_to_string(out.join(format!("{}.csv", made.tpf.file_name().unwrap().to_string_lossy()))).unwrap();
    let (_, apply) = head.lines().next().unwrap().split_once("; apply = ").unwrap();
    let apply: serde_json::Value = serde_json::from_str(apply).unwrap();
    assert_eq!(apply["steps"], serde_json::json!(["subtract_offset", "sigma", "omega"]));
    let row = &all[&("xi_T1".to_owned(), "xz".to_owned())];
    assert_eq!(value(row, 2), number(&document, "xi_xz.1"));
    assert_eq!(value(row, 3), number(&document, "covariance.xi_xz.1.1").sqrt());
    assert_eq!(row[4..].join(","), "deg/degC,between sensor axes,-60.0,60.0,degC");
    assert_eq!(quantities(&rows(&made.tof)), 6);
    let row = &rows(&made.thermistor)[&("c_3".to_owned(), String::new())];
    assert_eq!((row[4].as_str(), row[8].as_str()), ("degC/V^3", "V"));
    // Polynomials at the centre, k, K⁻¹, residual field.
    assert_eq!(quantities(&rows(&made.tcf)), 18 + 3 + 9 + 3);
}

/// The text of every element of a name, in the order of a well-formed document; anything else is a panic.
fn elements(xml: &str, name: &str) -> Vec<String> {
    let body = xml.strip_prefix("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n").unwrap();
    let (mut open, mut found, mut rest): (Vec<(String, String)>, Vec<String>, &str) = (Vec::new(), Vec::new(), body);
    while let Some(at) = rest.find('<') {
        let (before, tail) = rest.split_at(at);
        assert!(!before.contains('>'), "{before}");
        for piece in before.split('&').skip(1) {
            assert!(["amp;", "lt;", "gt;"].iter().any(|entity| piece.starts_with(entity)), "{before}");
        }
        if let Some((_, text)) = open.last_mut() {
            text.push_str(before);
        } else {
            assert_eq!(before.trim(), "");
        }
        let end = tail.find('>').unwrap();
        let tag = &tail[1..end];
        rest = &tail[end + 1..];
        if tag.starts_with("!--") {
            assert!(tag.ends_with("--"));
        } else if let Some(closing) = tag.strip_prefix('/') {
            let (opened, text) = open.pop().unwrap();
            assert_eq!(opened, closing);
            if opened == name {
                found.push(text);
            }
        } else {
            open.push((tag.split(' ').next().unwrap().to_owned(), String::new()));
        }
    }
    assert!(open.is_empty() && rest.trim().is_empty());
    found
}

/// Two coefficients through four runs whose files state no uncertainty: Student's factor for two degrees of freedom.
#[test]
fn a_certificate_covers_95_percent_where_few_runs_tell_the_uncertainty() {
    let case = Case::new();
    // The sensitivities scatter by some 1e-6 about a straight line.
    for (i, (degc, scatter)) in CYCLE_DEGC.into_iter().zip([1e-6, -2e-6, 1.5e-6, -0.5e-6]).enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        let text = cpf(&run, degc, scatter);
        case.put(&format!("{run}.CPF"), &text[..text.find("[std]").unwrap()]);
    }
    let mut command = calfit();
    command.arg("thermal").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").args(["--order", "sigma=1"]);
    done(&command.output().unwrap());
    let tpf = case.out().join("THERMAL_PARAMETER__01-06-01-09-00-00.TPF");
    let out = case.path().join("exported");
    let output = export("dcc", &[&tpf], &out, &[]);
    done(&output);
    says(&text(&output.stderr), &["the certificate states neither laboratory", "--campaign"]);
    let xml = fs::read_to_string(out.join("THERMAL_PARAMETER__01-06-01-09-00-00.TPF.xml")).unwrap();
    let first = |name: &str| -> f64 { elements(&xml, name)[0].parse().unwrap() };
    let std = number(&parameters(&tpf), "covariance.sigma_x.0.0").sqrt();
    assert!((first("si:coverageFactor") - 4.302_653).abs() < 1e-6, "{}", first("si:coverageFactor"));
    assert!((first("si:valueExpandedMU") / (4.302_653 * std) - 1.0).abs() < 1e-6);
}

#[test]
fn a_certificate_is_well_formed_and_states_twice_the_standard_uncertainty() {
    let (case, cpf) = lin();
    let out = case.path().join("dcc");
    let campaign = case.path().join("campaign.toml");
    fs::write(
        &campaign,
        "[report]\nlaboratory = \"Coils & <Fields>\"\nresponsible = \"A. B.\"\nchecked_by = \"C. D.\"\ntraceability = \"certificate 7\"\n\
         maker = \"Maker & Co\"\nfirmware = \"2000 nT, 3.1\"\ncondition = \"as received\"\n",
    )
    .unwrap();
    done(&export("dcc", &[&cpf], &out, &["--campaign", campaign.to_str().unwrap()]));
    let xml = fs::read_to_string(out.join(format!("{}.xml", cpf.file_name().unwrap().to_string_lossy()))).unwrap();
    assert_eq!(elements(&xml, "dcc:digitalCalibrationCertificate").len(), 1);
    let contents = elements(&xml, "dcc:content");
    let item = "Range and firmware: 2000 nT, 3.1; Condition of the instrument: as received";
    for stated in ["Coils &amp; &lt;Fields&gt;", "A. B.", "C. D.", "certificate 7", "Maker &amp; Co", item, "sigma x"] {
        assert!(contents.iter().any(|c| c == stated), "{stated}");
    }
    assert_eq!(elements(&xml, "dcc:role"), ["checked by"]);
    assert_eq!(elements(&xml, "dcc:beginPerformanceDate"), ["2013-04-03"]);
    let document = parameters(&cpf);
    // Conditions, which stand before the results, have numbers too.
    let results = alone(&xml[xml.find("<dcc:results>").unwrap()..xml.find("</dcc:measurementResult>").unwrap()]);
    let numbers = |name: &str| -> Vec<f64> { elements(&results, name).iter().map(|v| v.parse().unwrap()).collect() };
    assert_eq!(numbers("si:value")[0], number(&document, "matrix.sigma.0.0"));
    assert_eq!(numbers("si:valueExpandedMU")[0], 2.0 * number(&document, "std.sigma.0"));
    assert!(numbers("si:coverageFactor").iter().all(|k| *k == 2.0));
    assert_eq!(elements(&results, "si:unit")[0], "\\one");
    let made = made(true);
    done(&export("dcc", &[&made.tcf, &made.thermistor], &out, &[]));
    let xml = fs::read_to_string(out.join("THERMISTOR__pt1000_table.toml.xml")).unwrap();
    assert_eq!(elements(&xml, "si:unit")[..3], ["\\degreecelsius", "\\kelvin\\volt\\tothe{-1}", "\\kelvin\\volt\\tothe{-2}"]);
    let output = export("csv", &[&cpf], &out, &["--campaign", campaign.to_str().unwrap()]);
    says(&text(&output.stderr), &["--campaign: changes nothing with --format csv"]);
}

/// A part of a document as a document.
fn alone(part: &str) -> String {
    format!("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<part>{part}</part>")
}

/// Name and description of every condition of a certificate, with its numbers and their units.
fn conditions(xml: &str) -> Vec<(String, Vec<f64>, Vec<String>)> {
    let one = |piece: &str| {
        let part = alone(&piece[..piece.find("</dcc:influenceCondition>").unwrap()]);
        let words = elements(&part, "dcc:content");
        let numbers = elements(&part, "si:value").iter().map(|v| v.parse().unwrap()).collect();
        (format!("{}: {}", words[0], words[1]), numbers, elements(&part, "si:unit"))
    };
    xml.split("<dcc:influenceCondition>").skip(1).map(one).collect()
}

#[track_caller]
fn has_condition(xml: &str, name: &str, expected: &[f64], unit: &str) {
    let all = conditions(xml);
    let found = all.iter().find(|(own, ..)| own == name).unwrap_or_else(|| panic!("no {name} in {all:?}"));
    assert_eq!(found.1.len(), expected.len(), "{found:?}");
    assert!(found.1.iter().zip(expected).all(|(own, other)| (own - other).abs() < 1e-9), "{found:?}");
    assert!(found.2.iter().all(|own| own == unit), "{found:?}");
}

#[test]
fn a_certificate_states_the_conditions_under_which_the_data_were_measured() {
    let (case, cpf) = lin();
    let out = case.path().join("dcc");
    let certificate = |file: &Path| {
        done(&export("dcc", &[file], &out, &[]));
        fs::read_to_string(out.join(format!("{}.xml", file.file_name().unwrap().to_string_lossy()))).unwrap()
    };
    let xml = certificate(&cpf);
    // The place that the schema has for them.
    let places = ["</dcc:usedMethods>", "<dcc:influenceConditions>", "<dcc:results>"].map(|tag| xml.find(tag).unwrap());
    assert!(places.is_sorted(), "{places:?}");
    // The run has 24.5 °C at the sensor and 20.5 °C at the coils all the time.
    has_condition(&xml, "temperature of the sensor: during the run, channel T59", &[24.5; 3], "\\degreecelsius");
    has_condition(&xml, "temperature of the coil system: during the run, channel T29", &[20.5; 3], "\\degreecelsius");
    let document = parameters(&cpf);
    let scatter =
        ["mean.0", "max.0", "mean.1", "max.1", "mean.2", "max.2"].map(|k| number(&document, &format!("quality.raw_std_ent.{k}")));
    let stability =
        "stability of the field: standard deviation of the samples within a setting, sensor axes: field and sensor together";
    has_condition(&xml, stability, &scatter, "\\nano\\tesla");
    says(&xml, &["DYNAMIC, DYNAMIC, DYNAMIC", "FLDS"]);
    // Polynomials: the temperatures of all runs; those of the coils are not known.
    let made = made(true);
    let xml = certificate(&made.tpf);
    has_condition(&xml, "temperature of the sensor: over all runs, channel not stated", &[-60.0, 60.0], "\\degreecelsius");
    assert_eq!(conditions(&xml).len(), 1, "{:?}", conditions(&xml));
    // A table of a thermistor was not measured under any that it states, and the schema has no place for an empty list.
    assert!(!certificate(&made.thermistor).contains("influenceCondition"));
}

/// A run of 22 settings of 2 s that begins ten seconds before midnight.
fn over_midnight(case: &Case) {
    let run = common::good().named("13-04-03_23-59-50").key("start", "\"2013-04-03T23:59:50Z\"");
    case.put("13-04-03/23-59-50.CCR", run.text());
}

#[test]
fn a_certificate_ends_on_the_day_on_which_the_data_end() {
    let case = Case::new();
    over_midnight(&case);
    let out = case.made("lin", &["lin"], &[&case.campaign()]);
    let cpf = out.join("13-04-03_23-59-50/PARAMETER_LIN__13-04-03_23-59-50.CPF");
    let certificate = case.path().join("certificate");
    let output = calfit().args(["export", "--format", "dcc", "-o"]).arg(&certificate).arg(&cpf).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let xml = fs::read_to_string(certificate.join("PARAMETER_LIN__13-04-03_23-59-50.CPF.xml")).unwrap();
    says(
        &xml,
        &[
            "<dcc:beginPerformanceDate>2013-04-03</dcc:beginPerformanceDate>",
            "<dcc:endPerformanceDate>2013-04-04</dcc:endPerformanceDate>",
        ],
    );
}

#[test]
fn a_protocol_states_the_end_of_the_measurements_and_the_rows_that_are_used() {
    let case = Case::new();
    over_midnight(&case);
    let door = "13-04-03_23-59-50#3=door opened";
    let out = case.made("report", &["report", "--exclude", door], &[&case.campaign()]);
    let report = fs::read_to_string(out.join("REPORT.md")).unwrap();
    says(&report, &["from 2013-04-03T23:59:50Z to 2013-04-04T00:00:34Z", "| 21 of 22 |", "Rows of the runs"]);
    let is_row = |line: &&str| line.contains("| 21 | 22 |");
    says(report.lines().find(is_row).unwrap_or("no row"), &["13-04-03_23-59-50", "door opened"]);
    // The input itself says when its data begin and end.
    let cpf = parameters(&out.join("13-04-03_23-59-50/PARAMETER_LIN__13-04-03_23-59-50.CPF"));
    let input = cpf["provenance"]["input"].as_array_of_tables().unwrap().get(0).unwrap();
    assert_eq!(input["from"].as_str(), Some("2013-04-03T23:59:50Z"));
    assert_eq!(input["until"].as_str(), Some("2013-04-04T00:00:34Z"));
}
