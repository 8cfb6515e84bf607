//! `calfit apply`: what the files state and nothing else turns a reading into the field, the uncertainty holds, and nothing outside of a
//! calibration passes without its flag.

use crate::common;

use calfit::data::provenance::Provenance;
use calfit::data::recipe::Recipe;
use calfit::files::parameter::{self, Model, ModelEffect, ModelParameter};
use common::check::{Case, calfit, data, number, parameters, says, text, three};
use common::{Gauss, Plan, RUN_ID, Truth};
use nalgebra::{Matrix3, Vector3};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use toml_edit::DocumentMut;

const CYCLE_DEGC: [f64; 9] = [-60.0, -45.0, -30.0, -15.0, 0.0, 15.0, 30.0, 45.0, 60.0];
const FIVE_DEGC: [f64; 5] = [-55.0, -20.0, 3.0, 25.0, 58.0];
/// Standard uncertainties of σ, nT/enT, ξ, degrees, and offsets, enT, of every run.
const SIGMA_STD: f64 = 4e-6;
const XI_STD: f64 = 4e-4;
const OFFSET_STD: f64 = 0.05;

fn sigma(t: f64) -> [f64; 3] {
    [1.09 - 1.4e-5 * t, 1.094 - 9e-6 * t, 0.98 + 2e-5 * t]
}

fn xi_deg(t: f64) -> [f64; 3] {
    [90.5 - 8e-5 * t, 89.4 + 3e-5 * t, 90.6 + 1.2e-4 * t]
}

fn b_off_ent(t: f64) -> [f64; 3] {
    [114.3 - 0.565 * t, -119.8 + 0.7 * t, 494.0]
}

/// Residual field of the coil system, enT, where the runs were made.
const B_RES: [f64; 3] = [3.0, -2.0, 5.0];

fn b_or_ent(t: f64) -> [f64; 3] {
    std::array::from_fn(|i| b_off_ent(t)[i] + B_RES[i])
}

/// Values with noise.
fn noisy(values: [f64; 3], std: f64, gauss: &mut Gauss) -> [f64; 3] {
    values.map(|v| v + std * gauss.normal())
}

/// A linear calibration of a run as another program may write it.
fn cpf(run: &str, t: f64, gauss: &mut Gauss) -> String {
    let [x, y, z] = noisy(sigma(t), SIGMA_STD, gauss);
    let [xy, xz, yz] = noisy(xi_deg(t), XI_STD, gauss);
    let offset = noisy(b_or_ent(t), OFFSET_STD, gauss);
    format!(
        "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"IB\"\nmode = \"m\"\ntemperature_degc = {t:?}\n[matrix]\n\
         omega_convention = \"BepiColombo\"\nr_nom = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n\
         sigma = [[{x:?}, 0.0, 0.0], [0.0, {y:?}, 0.0], [0.0, 0.0, {z:?}]]\n[angle_deg]\nxi_xy = {xy:?}\nxi_xz = {xz:?}\nxi_yz = {yz:?}\n\
         [offset]\nb_or_ent = {offset:?}\n[std]\nsigma = {:?}\nxi_deg = {:?}\nb_or_ent = {:?}\n\
         [valid]\nfield_coil_nt = [[-12000.0, 12000.0], [-12000.0, 12000.0], [-12000.0, 11000.0]]\n",
        [SIGMA_STD; 3], [XI_STD; 3], [OFFSET_STD; 3]
    )
}

fn opf(run: &str, t: f64, gauss: &mut Gauss) -> String {
    let offset = noisy(b_off_ent(t), OFFSET_STD, gauss);
    format!(
        "format = \"OPF\"\nversion = 1\noffset_ent = {offset:?}\noffset_std_ent = {:?}\n[run]\nid = \"{run}\"\nsensor = \"IB\"\n\
         mode = \"m\"\ntemperature_degc = {t:?}\n",
        [OFFSET_STD; 3]
    )
}

#[track_caller]
fn done(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stderr)
}

/// The files of a sensor that was calibrated over temperature, with runs at the centre of the coil system that differ from those beside
/// it by their noise alone.
struct Made {
    case: Case,
    tpf: PathBuf,
    tof: PathBuf,
    tcf: PathBuf,
    ground: PathBuf,
}

fn made(seed: u64) -> Made {
    made_saying(seed, "")
}

/// The same with more keys in the parameter file of the first linear calibration.
fn made_saying(seed: u64, said: &str) -> Made {
    let gauss = &mut Gauss(seed);
    let case = Case::new();
    for (i, t) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        let said = if i == 0 { said } else { "" };
        case.put(&format!("{run}.CPF"), cpf(&run, t, gauss).replace("version = 1\n", &format!("version = 1\n{said}")));
        case.put(&format!("{run}.OPF"), opf(&run, t, gauss));
    }
    let put = |name: &str, content: String| {
        let path = case.path().join(name);
        fs::write(&path, content).unwrap();
        path
    };
    let centre = put("CENTRE.CPF", cpf("01-06-18_09-00-00", 17.39, gauss));
    let turned = put("TURNED.OPF", opf("01-06-19_09-00-00", 17.39, gauss));
    let mut command = calfit();
    command.arg("thermal").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots");
    command.args(["--order", "sigma=1", "--order", "xi=1", "--order", "b_or=1", "--order", "b_off=1"]);
    done(&command.arg("--centre").arg(&centre).arg("--offset").arg(&turned).output().unwrap());
    let pt1000 = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosetta/pt1000_table.csv");
    let reference = put("reference.csv", "reference_degc,u_volt\n0.1,1.0\n50.2,1.2\n".to_owned());
    let mut command = calfit();
    command.arg("thermistor").arg(pt1000).args(["--order", "3", "--no-plots", "-o"]).arg(case.out());
    done(&command.arg("--reference").arg(reference).output().unwrap());
    let file = |name: &str| case.out().join(name);
    let tcf = file("THERMAL_CENTRE_PARAMETER__01-06-01-09-00-00.TCF");
    let export = calfit()
        .args(["export", "--format", "rpcmag", "-o"])
        .arg(case.out())
        .arg(&tcf)
        .arg(file("THERMISTOR__pt1000_table.toml"))
        .output();
    done(&export.unwrap());
    Made {
        tpf: file("THERMAL_PARAMETER__01-06-01-09-00-00.TPF"),
        tof: file("THERMAL_OFF_PARAMETER__01-06-01-09-00-00.TOF"),
        ground: file("RPCMAG_GND_CALIB_IB.TXT"),
        tcf,
        case,
    }
}

/// Q(ξ) as the files write it out in words.
fn q([xy, xz, yz]: [f64; 3]) -> Matrix3<f64> {
    let [xy, xz, yz] = [xy, xz, yz].map(f64::to_radians);
    let middle = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    Matrix3::new(1.0, xy.cos(), xz.cos(), 0.0, xy.sin(), middle, 0.0, 0.0, (xz.sin().powi(2) - middle * middle).sqrt())
}

/// A stranger's applicator: reads `[apply]` and the values, and knows nothing else. The file of an offset stands behind that of the
/// matrix.
fn applicator(files: &[&DocumentMut], coil: bool, reading: [f64; 3], t: f64) -> Vector3<f64> {
    let (first, last) = (files[0], files[files.len() - 1]);
    let matrix = |name: &str| Matrix3::from_fn(|row, column| three(first, &format!("{name}.{row}"))[column]);
    let line = |file: &DocumentMut, name: &str| {
        let coefficients: Vec<f64> = file[name].as_array().unwrap().iter().map(|c| c.as_float().unwrap()).collect();
        coefficients.iter().rev().fold(0.0, |sum, c| sum * t + c)
    };
    let has = |name: &str| first.get(name).is_some();
    let lines = |names: [&str; 3]| Vector3::from(names.map(|name| line(first, name)));
    let ground = |zero: &str, one: &str| Vector3::from(three(first, zero)) + Vector3::from(three(first, one)) * t;
    let mut b = Vector3::from(reading);
    for step in first["apply"]["steps"].as_array().unwrap() {
        b = match step.as_str().unwrap() {
            "subtract_offset" => {
                b - match last["apply"]["offset"]["quantity"].as_str().unwrap() {
                    _ if has("A_0") => ground("A_0", "A_1") - Vector3::from(three(first, "B_RES")),
                    "b_or" if has("matrix") => Vector3::from(three(first, "offset.b_or_ent")),
                    quantity => Vector3::from(["x", "y", "z"].map(|c| line(last, &format!("{quantity}_{c}")))),
                }
            }
            "sigma" if has("matrix") => matrix("matrix.sigma") * b,
            "sigma" if has("A_0") => ground("SIGMA_00", "SIGMA_01").component_mul(&b),
            "sigma" => lines(["sigma_x", "sigma_y", "sigma_z"]).component_mul(&b),
            "omega" if has("matrix") => matrix("matrix.omega") * b,
            "omega" => match first["apply"]["omega_formula"].as_str().unwrap() {
                "omega = inverse(transpose(Q(xi)))" => {
                    q(lines(["xi_xy", "xi_xz", "xi_yz"]).into()).transpose().try_inverse().unwrap() * b
                }
                "omega = Q(xi)" => q(lines(["xi_xy", "xi_xz", "xi_yz"]).into()) * b,
                _ => q(ground("XI_10", "XI_11").into()) * Matrix3::from_fn(|r, c| three(first, &format!("K_{r}"))[c]) * b,
            },
            "rho" if coil => matrix("matrix.rho") * b,
            "r_nom" if coil => matrix("matrix.r_nom") * b,
            _ => b,
        };
    }
    b
}

/// A field along the axes of the sensor frame of the BepiColombo convention, nT, as readings of a sensor whose axes have the angles ξ
/// between them, enT: each axis reads the field along itself over its sensitivity.
fn readings(field_nt: [f64; 3], t: f64, offset_ent: [f64; 3]) -> [f64; 3] {
    let axes = q(xi_deg(t));
    std::array::from_fn(|i| axes.column(i).dot(&Vector3::from(field_nt)) / sigma(t)[i] + offset_ent[i])
}

/// The same field in the sensor frame of the Rosetta convention, whose x lies along the first column of `ω σ` and y in the plane of the
/// first two.
fn in_rosetta_frame(field_nt: [f64; 3], t: f64) -> Vector3<f64> {
    let m = q(xi_deg(t)).transpose().try_inverse().unwrap();
    let x = m.column(0).normalize();
    let y = (m.column(1) - x * x.dot(&m.column(1))).normalize();
    let b = Vector3::from(field_nt);
    Vector3::new(x.dot(&b), y.dot(&b), x.cross(&y).dot(&b))
}

/// Fields of 10 000 nT.
fn fields(count: usize, seed: u64) -> Vec<[f64; 3]> {
    let mut gauss = Gauss(seed);
    let direction = |_| Vector3::from_fn(|_, _| gauss.normal()).normalize() * 10_000.0;
    (0..count).map(direction).map(Into::into).collect()
}

/// Columns of a table of calibrated vectors: field, uncertainty, flags; nan for an empty cell.
struct Calibrated {
    field: Vec<[f64; 3]>,
    std: Vec<[f64; 3]>,
    flags: Vec<u32>,
    columns: Vec<String>,
}

fn calibrated(path: &Path) -> Calibrated {
    let content = fs::read_to_string(path).unwrap();
    assert!(content.starts_with("# calfit {\"written_by\""), "{content:.100}");
    let mut lines = content.lines().skip(1);
    let columns: Vec<String> = lines.next().unwrap().split(',').map(str::to_owned).collect();
    let at = |name: &str| columns.iter().position(|c| c == name).unwrap();
    let rows: Vec<Vec<&str>> = lines.map(|l| l.split(',').collect()).collect();
    // Counted from the end, since a word may hold a comma.
    let text = |row: &[&str], name: &str| row[row.len() - (columns.len() - at(name))].to_owned();
    let cell = |row: &[&str], name: &str| text(row, name).parse().unwrap_or(f64::NAN);
    let vectors = |names: [&str; 3]| rows.iter().map(|row| names.map(|name| cell(row, name))).collect();
    Calibrated {
        field: vectors(["bx_nt", "by_nt", "bz_nt"]),
        std: vectors(["u_bx_nt", "u_by_nt", "u_bz_nt"]),
        flags: rows.iter().map(|row| text(row, "flags").parse().unwrap()).collect(),
        columns,
    }
}

fn csv(rows: &[Row]) -> String {
    let line = |(i, (r, t)): (usize, &([f64; 3], f64))| format!("{i},{:?},{:?},{:?},{t:?},\"a, {i}\"\n", r[0], r[1], r[2]);
    format!("t,x,y,z,t_degc,word\n{}", rows.iter().enumerate().map(line).collect::<String>())
}

fn apply(files: &[&Path], data: &Path, out: &Path, more: &[&str]) -> Output {
    calfit().arg("apply").args(files).arg(data).arg("-o").arg(out).args(more).output().unwrap()
}

/// Applies files to readings with their temperatures by the command.
fn by_command(files: &[&Path], rows: &[Row], case: &Case, more: &[&str]) -> Calibrated {
    let data = case.path().join("raw.csv");
    fs::write(&data, csv(rows)).unwrap();
    let out = case.path().join("applied");
    done(&apply(files, &data, &out, more));
    calibrated(&out.join("raw.calibrated.csv"))
}

#[track_caller]
fn equal(found: &[[f64; 3]], wanted: &[Vector3<f64>]) {
    assert_eq!(found.len(), wanted.len());
    for (found, wanted) in found.iter().zip(wanted) {
        let difference = (Vector3::from(*found) - wanted).amax();
        assert!(difference <= 1e-12 * wanted.amax(), "{found:?} {wanted}");
    }
}

#[test]
fn the_command_gives_what_the_files_state() {
    let made = made(1);
    let rows: Vec<Row> = fields(40, 2)
        .into_iter()
        .enumerate()
        .map(|(i, field)| (readings(field, FIVE_DEGC[i % 5], b_off_ent(FIVE_DEGC[i % 5])), FIVE_DEGC[i % 5]))
        .collect();
    for files in [vec![&made.tpf], vec![&made.tpf, &made.tof], vec![&made.tcf], vec![&made.ground]] {
        let documents: Vec<DocumentMut> = files.iter().map(|path| parameters(path)).collect();
        let documents: Vec<&DocumentMut> = documents.iter().collect();
        let wanted: Vec<Vector3<f64>> = rows.iter().map(|(r, t)| applicator(&documents, false, *r, *t)).collect();
        let files: Vec<&Path> = files.into_iter().map(PathBuf::as_path).collect();
        let found = by_command(&files, &rows, &made.case, &[]);
        equal(&found.field, &wanted);
        assert_eq!(found.flags, vec![0; rows.len()]);
        assert_eq!(found.columns[..6], ["t", "x", "y", "z", "t_degc", "word"]);
    }
    // The statement beside the table says what was done and what was not.
    let statement = fs::read_to_string(made.case.path().join("applied/raw.calibrated.json")).unwrap();
    says(&statement, &["group delay", "frequency response", "RPCMAG_GND_CALIB_IB.TXT", "sensor (Rosetta)", "\"rows\": 40"]);

    let case = Case::of(Plan::default().run().text());
    case.done(&[]);
    let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let document = case.cpf();
    for coil in [false, true] {
        let wanted: Vec<Vector3<f64>> = rows.iter().map(|(r, t)| applicator(&[&document], coil, *r, *t)).collect();
        let found = by_command(&[&path], &rows, &case, if coil { &["--frame", "coil"] } else { &[] });
        equal(&found.field, &wanted);
    }
}

/// A reading, enT, and its temperature, °C.
type Row = ([f64; 3], f64);

/// What an exported table or certificate states: how it is applied, numbers with name, component and standard uncertainty, correlations.
#[derive(Default)]
struct Stated {
    apply: serde_json::Value,
    numbers: Vec<(String, String, f64, f64)>,
    correlations: Vec<([String; 2], f64)>,
}

impl Stated {
    fn correlation(&mut self, names: &str, value: f64) {
        let (a, b) = names.split_once(" * ").unwrap();
        self.correlations.push(([a.to_owned(), b.to_owned()], value));
    }

    fn of_table(text: &str) -> Self {
        let mut lines = text.lines();
        let (_, apply) = lines.next().unwrap().split_once("; apply = ").unwrap();
        let mut stated = Self { apply: serde_json::from_str(apply).unwrap(), ..Self::default() };
        for line in lines.skip(1) {
            let cells: Vec<&str> = line.split(',').collect();
            let value = cells[2].parse().unwrap_or(f64::NAN);
            if cells[0] == "correlation" {
                stated.correlation(cells[1], value);
            } else {
                stated.numbers.push((cells[0].to_owned(), cells[1].to_owned(), value, cells[3].parse().unwrap_or(f64::NAN)));
            }
        }
        stated
    }

    fn of_certificate(xml: &str) -> Self {
        let between = |text: &str, begin: &str, end: &str| -> Option<String> {
            let (_, tail) = text.split_once(begin)?;
            Some(tail.split_once(end)?.0.to_owned())
        };
        let content = |text: &str| between(text, "<dcc:content lang=\"en\">", "</dcc:content>").unwrap();
        let statement = xml.split("<dcc:statement>").find(|s| content(s) == "apply").unwrap();
        let apply = between(statement, "<dcc:description><dcc:content lang=\"en\">", "</dcc:content>").unwrap();
        let mut stated = Self { apply: serde_json::from_str(&apply).unwrap(), ..Self::default() };
        for result in xml.split("<dcc:result>").skip(1) {
            let name = content(result);
            let value: f64 = between(result, "<si:value>", "</si:value>").unwrap().parse().unwrap();
            let number = |element: &str| -> f64 {
                between(result, &format!("<si:{element}>"), &format!("</si:{element}>")).map_or(f64::NAN, |v| v.parse().unwrap())
            };
            let std = number("valueExpandedMU") / number("coverageFactor");
            match name.strip_prefix("correlation ") {
                Some(names) => stated.correlation(names, value),
                None => {
                    let (name, component) = name.split_once(' ').unwrap_or((&name, ""));
                    stated.numbers.push((name.to_owned(), component.to_owned(), value, std));
                }
            }
        }
        stated
    }

    /// As a file of polynomials; a quantity of one run is one of order zero.
    fn document(&self) -> DocumentMut {
        let mut tree = serde_json::Map::new();
        tree.insert("apply".to_owned(), self.apply.clone());
        for (name, component, value, _) in &self.numbers {
            let name = name.trim_end_matches(|c: char| c.is_ascii_digit());
            let key = format!("{}_{component}", name.strip_suffix("_T").unwrap_or(name));
            tree.entry(key).or_insert_with(|| serde_json::json!([])).as_array_mut().unwrap().push((*value).into());
        }
        toml_edit::ser::to_document(&tree).unwrap()
    }

    /// Uncertainty of a field, nT, by central differences of the applicator.
    fn std_nt(&self, reading: [f64; 3], t: f64) -> Vector3<f64> {
        let names: Vec<String> = self.numbers.iter().map(|(name, component, ..)| format!("{name} {component}")).collect();
        let mut by: Vec<Vector3<f64>> = Vec::new();
        for (i, (_, _, _, std)) in self.numbers.iter().enumerate() {
            if !std.is_finite() || *std == 0.0 {
                by.push(Vector3::zeros());
                continue;
            }
            let moved = |sign: f64| {
                let mut numbers = self.numbers.clone();
                numbers[i].2 += sign * std;
                let moved = Stated { numbers, apply: self.apply.clone(), correlations: Vec::new() };
                applicator(&[&moved.document()], false, reading, t)
            };
            by.push((moved(1.0) - moved(-1.0)) / 2.0);
        }
        let mut variance = by.iter().map(|b| b.component_mul(b)).sum::<Vector3<f64>>();
        for (pair, r) in &self.correlations {
            let at = |name: &String| names.iter().position(|n| n == name);
            if let [Some(a), Some(b)] = pair.each_ref().map(at) {
                variance += 2.0 * *r * by[a].component_mul(&by[b]);
            }
        }
        variance.map(f64::sqrt)
    }
}

#[test]
fn exported_files_are_applied_like_the_parameter_files() {
    let made = made(11);
    let out = made.case.path().join("exported");
    let rows: Vec<Row> = fields(5, 12).into_iter().zip(FIVE_DEGC).map(|(b, t)| (readings(b, t, b_off_ent(t)), t)).collect();
    for path in [&made.tpf, &made.tcf] {
        let found = by_command(&[path], &rows, &made.case, &[]);
        let name = path.file_name().unwrap().to_string_lossy().into_owned();
        let exported = |format: &str, end: &str| {
            done(&calfit().args(["export", "--format", format]).arg(path).arg("-o").arg(&out).output().unwrap());
            fs::read_to_string(out.join(format!("{name}.{end}"))).unwrap()
        };
        let json: serde_json::Value = serde_json::from_str(&exported("json", "json")).unwrap();
        // Numbers that are none are null; no list of coefficients has one.
        let known = json.as_object().unwrap().iter().filter(|(_, value)| !value.to_string().contains("null"));
        let known: serde_json::Map<String, serde_json::Value> = known.map(|(k, v)| (k.clone(), v.clone())).collect();
        let json = toml_edit::ser::to_document(&known).unwrap();
        let wanted = |document: &DocumentMut| -> Vec<Vector3<f64>> {
            rows.iter().map(|(r, t)| applicator(&[document], false, *r, *t)).collect()
        };
        equal(&found.field, &wanted(&json));
        for stated in [Stated::of_table(&exported("csv", "csv")), Stated::of_certificate(&exported("dcc", "xml"))] {
            equal(&found.field, &wanted(&stated.document()));
            if name.ends_with("TPF") {
                for (i, (r, t)) in rows.iter().enumerate() {
                    let std = stated.std_nt(*r, *t);
                    (0..3).for_each(|c| assert!((found.std[i][c] / std[c] - 1.0).abs() < 1e-6, "{name} {t} {c}"));
                }
            }
        }
    }
    let case = Case::of(Plan::default().run().text());
    case.done(&[]);
    let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let found = by_command(&[&path], &rows, &case, &[]);
    done(&calfit().args(["export", "--format", "csv"]).arg(&path).arg("-o").arg(&out).output().unwrap());
    let table = fs::read_to_string(out.join(format!("PARAMETER_LIN__{RUN_ID}.CPF.csv"))).unwrap();
    let document = Stated::of_table(&table).document();
    let wanted: Vec<Vector3<f64>> = rows.iter().map(|(r, t)| applicator(&[&document], false, *r, *t)).collect();
    equal(&found.field, &wanted);
}

/// Root mean square of errors over stated uncertainties.
fn rms(ratios: &[f64]) -> f64 {
    (ratios.iter().map(|r| r * r).sum::<f64>() / ratios.len() as f64).sqrt()
}

#[test]
fn errors_are_as_large_as_the_uncertainties_say() {
    const SEEDS: u64 = 60;
    // One direction per seed, temperature and kind of file: 900 components, whose rms is known to 3 % if a third of them is independent.
    let mut ratios = [const { Vec::new() }; 4];
    for seed in 0..SEEDS {
        let made = made(100 + seed);
        let directions = fields(FIVE_DEGC.len(), 1000 + seed);
        let pairs: Vec<Row> = directions.into_iter().zip(FIVE_DEGC).collect();
        let kinds: [(&[&Path], bool, bool); 4] = [
            (&[&made.tpf], true, false),
            (&[&made.tpf, &made.tof], false, false),
            (&[&made.tcf], false, true),
            (&[&made.ground], false, true),
        ];
        for ((files, with_residual, rosetta), ratios) in kinds.into_iter().zip(&mut ratios) {
            let offset = if with_residual { b_or_ent } else { b_off_ent };
            let rows: Vec<Row> = pairs.iter().map(|(field, t)| (readings(*field, *t, offset(*t)), *t)).collect();
            let found = by_command(files, &rows, &made.case, &[]);
            for (i, (field, t)) in pairs.iter().enumerate() {
                let truth = if rosetta { in_rosetta_frame(*field, *t) } else { Vector3::from(*field) };
                ratios.extend((0..3).map(|c| (found.field[i][c] - truth[c]) / found.std[i][c]));
            }
        }
    }
    for (ratios, kind) in ratios.iter().zip(["TPF", "TPF and TOF", "TCF", "ground calibration file"]) {
        let found = rms(ratios);
        println!("{kind}: rms of error over uncertainty {found:.3} of {}", ratios.len());
        assert!((0.9..=1.1).contains(&found), "{kind}: {found}");
    }
}

#[test]
fn a_calibration_of_one_run_has_the_uncertainty_that_it_states() {
    let truth = Truth::default();
    let mut ratios = [Vec::new(), Vec::new()];
    for seed in 0..120 {
        let case = Case::of(Plan { seed: 500 + seed, ..Plan::default() }.run().text());
        case.done(&[]);
        let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
        let field = fields(1, seed)[0];
        // Between the temperatures of the run.
        let rows = [(truth.reading(field), 24.5)];
        // In coil axes, and in the frame of the sensor, to which the true rotation leads.
        let turned = Matrix3::from_fn(|r, c| truth.rotation()[r][c]).transpose() * Vector3::from(field);
        for (i, (more, wanted)) in [(&["--frame", "coil"][..], Vector3::from(field)), (&[], turned)].into_iter().enumerate() {
            let found = by_command(&[&path], &rows, &case, more);
            ratios[i].extend((0..3).map(|c| (found.field[0][c] - wanted[c]) / found.std[0][c]));
            // The runs went to 2000 nT.
            assert_eq!(found.flags, [1 << 16]);
        }
    }
    for (ratios, frame) in ratios.iter().zip(["coil", "sensor"]) {
        let found = rms(ratios);
        println!("CPF, {frame} frame: rms of error over uncertainty {found:.3} of {}", ratios.len());
        assert!((0.9..=1.1).contains(&found), "{frame}: {found}");
    }
}

#[test]
fn nothing_outside_passes_without_its_flag() {
    let made = made(3);
    let inside = readings([3000.0, -2000.0, 1000.0], 20.0, b_off_ent(20.0));
    let strong = readings([0.0, 0.0, 11_500.0], 20.0, b_off_ent(20.0));
    let rows = [(inside, 20.0), (inside, 61.0), (strong, 20.0), (inside, f64::NAN), ([f64::NAN, 0.0, 0.0], 20.0)];
    let files: [&Path; 2] = [&made.tpf, &made.tof];
    let found = by_command(&files, &rows, &made.case, &[]);
    assert_eq!(found.flags, [0, 1, 1 << 16, 1 << 17, 1 << 18]);
    let is_empty = |c: &Calibrated| -> Vec<bool> { (0..5).map(|i| c.field[i][0].is_nan() && c.std[i][2].is_nan()).collect() };
    assert_eq!(is_empty(&found), [false, false, false, true, true]);
    // At temperatures outside of the calibration the field is given, and no uncertainty of it.
    assert_eq!([0, 1, 2].map(|i| found.std[i].iter().all(|u| u.is_nan())), [false, true, false]);
    let found = by_command(&files, &rows, &made.case, &["--outside", "null"]);
    assert_eq!(found.flags, [0, 1, 1 << 16, 1 << 17, 1 << 18]);
    assert_eq!(is_empty(&found), [false, true, true, true, true]);
    let found = by_command(&files, &rows, &made.case, &["--temperature", "20"]);
    assert_eq!(found.flags, [0, 0, 1 << 16, 0, 1 << 18]);

    let data = made.case.path().join("raw.csv");
    let out = made.case.path().join("refused");
    let output = apply(&files, &data, &out, &["--outside", "error"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["raw.csv", "vector 2 at 61 °C", "temperature outside the range"]);
    assert!(!out.join("raw.calibrated.csv").exists());
    let output = apply(&files, &data, &out, &["--temperature-column", "warmth"]);
    says(&text(&output.stderr), &["has no column `warmth`", "t, x, y, z, t_degc, word"]);
}

/// A parameter file whose stated hash is that of its content.
pub fn with_its_hash(content: &str) -> String {
    use sha2::{Digest, Sha256};
    let mut hash = Sha256::new();
    for line in content.lines().filter(|l| !l.starts_with("created = ") && !l.starts_with("content_sha256 = ")) {
        hash.update(line.as_bytes());
        hash.update(b"\n");
    }
    let hash: String = hash.finalize().iter().map(|byte| format!("{byte:02x}")).collect();
    let line =
        |l: &str| if l.starts_with("content_sha256 = ") { format!("content_sha256 = \"{hash}\"\n") } else { format!("{l}\n") };
    content.lines().map(line).collect()
}

#[test]
fn what_makes_no_calibration_is_refused() {
    let made = made(4);
    let put = |name: &str, content: String| {
        let path = made.case.path().join(name);
        fs::write(&path, content).unwrap();
        path
    };
    let data = put("raw.csv", csv(&[([1.0, 2.0, 3.0], 20.0)]));
    let out = made.case.path().join("refused");
    let refused = |files: &[&Path], more: &[&str], words: &[&str]| {
        let output = apply(files, &data, &out, more);
        assert_eq!(output.status.code(), Some(2), "{words:?}");
        says(&text(&output.stderr), words);
        assert!(!out.join("raw.calibrated.csv").exists());
    };
    refused(&[&made.tof], &[], &[".TOF: states no sensitivities and angles"]);
    refused(&[&made.tpf, &made.tcf], &[], &["states sensitivities and angles, and so does"]);
    refused(&[&made.tcf, &made.tof], &[], &["states the offset, and so does"]);
    refused(&[&made.tof, &made.tof, &made.tpf], &[], &["states the offset, and so does"]);
    refused(&[&made.tpf], &["--frame", "coil"], &["does not say how the sensor stood"]);
    refused(&[&made.ground], &["--frame", "coil"], &["does not say how the sensor stood"]);
    refused(&[&made.case.out().join("THERMISTOR__pt1000_table.toml")], &[], &["THERMISTOR", "nothing is applied"]);
    // Another sensor: a file of the same runs under another name.
    let other = Case::new();
    for (i, t) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        other.put(&format!("{run}.OPF"), opf(&run, t, &mut Gauss(5)).replace("IB", "OB"));
    }
    done(&other.run("thermal", &["--no-plots"]));
    let tof = other.out().join("THERMAL_OFF_PARAMETER__01-06-01-09-00-00.TOF");
    refused(&[&made.tpf, &tof], &[], &["is of OB m", "of IB m", "one sensor in one mode"]);
    // A changed file, and a file of version 1 with the wrong signs.
    let tcf = fs::read_to_string(&made.tcf).unwrap();
    refused(&[&put("CHANGED.TCF", tcf.replacen("sigma_x = [1", "sigma_x = [2", 1))], &[], &["was changed after it was written"]);
    refused(
        &[&put("OLD.TCF", tcf.replacen("version = 2", "version = 1", 1))],
        &[],
        &["TCF file of version 1", "every misalignment has the wrong sign"],
    );
    // Files that contradict themselves: a sensitivity and a rotation that are not those of the matrices.
    let case = Case::of(Plan::default().run().text());
    case.done(&[]);
    let good = fs::read_to_string(case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"))).unwrap();
    let signed = |name: &str, key: &str, by: &dyn Fn(f64) -> f64| {
        let mut document: DocumentMut = good.parse().unwrap();
        let table = document["matrix"][key].as_array_mut().unwrap();
        let row = table.get_mut(1).unwrap().as_array_mut().unwrap();
        let value = row.get(1).unwrap().as_float().unwrap();
        row.replace(1, by(value));
        // The hash of what stands in the file now, as somebody would make it who changes a file on purpose.
        put(name, with_its_hash(&document.to_string()))
    };
    refused(&[&signed("A.CPF", "sigma", &|s| s + 1e-3)], &[], &["matrix.phi_tilde is not omega sigma"]);
    refused(&[&signed("B.CPF", "rho", &|r| r - 1e-3)], &[], &["matrix.rho is no rotation"]);
    refused(&[&signed("C.CPF", "r_nom", &|r| -r)], &[], &["matrix.r_nom is no rotation"]);
    let bad = put("bad.csv", "x,y,z,t_degc\n1,2,3,20\n1,b,3,20\n".to_owned());
    let output = apply(&[&made.tpf], &bad, &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["bad.csv", "row 2", "column `y`", "`b`"]);
    let twice = put("twice.csv", "x,y,z,bx_nt\n1,2,3,20\n".to_owned());
    says(&text(&apply(&[&made.tpf], &twice, &out, &[]).stderr), &["has a column `bx_nt` already"]);
}

#[test]
fn an_offset_whose_uncertainties_are_not_those_of_its_covariance_is_refused() {
    let case = Case::new();
    let good = fs::read_to_string(data("tests/data/version-1/files/offset/OFF_PARAMETER__26-03-02-08-05-00.OPF")).unwrap();
    for (key, words) in [
        ("offset_std_ent", "offset_std_ent is not the root of the variance of offset_x"),
        ("residual_coil_std_nt", "residual_coil_std_nt is not the root of the variance of residual_coil_x"),
    ] {
        for of in [|std: f64| std / 10.0, |_| f64::NAN] {
            let mut document: DocumentMut = good.parse().unwrap();
            let list = document[key].as_array_mut().unwrap();
            let std = list.get(0).unwrap().as_float().unwrap();
            list.replace(0, of(std));
            let path = case.path().join("OFF_PARAMETER__forged.OPF");
            fs::write(&path, with_its_hash(&document.to_string())).unwrap();
            let output = calfit().arg("check").arg(&path).output().unwrap();
            assert_eq!(output.status.code(), Some(1), "{key}");
            says(&text(&output.stderr), &[words]);
        }
    }
}

#[test]
fn every_format_gives_the_same_field() {
    use polars::prelude::{Column, DataFrame, IpcWriter, ParquetReader, ParquetWriter, SerReader, SerWriter};
    let made = made(6);
    let rows: Vec<Row> = fields(1000, 7)
        .into_iter()
        .enumerate()
        .map(|(i, b)| (readings(b, 10.0, b_off_ent(10.0)), i as f64 / 10.0 - 40.0))
        .collect();
    let by_csv = by_command(&[&made.tcf], &rows, &made.case, &[]);
    let column = |name: &str, of: &dyn Fn(&Row) -> f64| Column::new(name.into(), rows.iter().map(of).collect::<Vec<f64>>());
    let columns = vec![column("x", &|r| r.0[0]), column("y", &|r| r.0[1]), column("z", &|r| r.0[2]), column("warmth", &|r| r.1)];
    let mut frame = DataFrame::new(rows.len(), columns).unwrap();
    let path = |name: &str| made.case.path().join(name);
    ParquetWriter::new(fs::File::create(path("p.parquet")).unwrap()).with_row_group_size(Some(300)).finish(&mut frame).unwrap();
    IpcWriter::new(fs::File::create(path("i.arrow")).unwrap()).finish(&mut frame).unwrap();
    for (data, result) in [("p.parquet", "p.calibrated.parquet"), ("i.arrow", "i.calibrated.parquet")] {
        let out = path("applied");
        done(&apply(&[&made.tcf], &path(data), &out, &["--temperature-column", "warmth"]));
        let found = ParquetReader::new(fs::File::open(out.join(result)).unwrap()).finish().unwrap();
        assert_eq!(found.height(), rows.len());
        for (name, i) in [("bx_nt", 0), ("by_nt", 1), ("bz_nt", 2)] {
            let values: Vec<f64> = found.column(name).unwrap().f64().unwrap().iter().map(Option::unwrap).collect();
            assert!(values.iter().zip(&by_csv.field).all(|(a, b)| *a == b[i]), "{data} {name}");
        }
        let flags: Vec<u32> = found.column("flags").unwrap().u32().unwrap().iter().map(Option::unwrap).collect();
        assert_eq!(flags, by_csv.flags);
    }
}

#[test]
fn a_run_is_calibrated_at_the_temperature_of_its_thermistor() {
    let plan = Plan::default();
    let case = Case::of(plan.run().warming().text());
    case.done(&[]);
    let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let out = case.path().join("applied");
    let shown =
        calfit().arg("apply").arg(&path).arg(case.file()).arg("-o").arg(&out).args(["--frame", "coil", "--json"]).output();
    let shown = shown.unwrap();
    done(&shown);
    let shown: serde_json::Value = serde_json::from_slice(&shown.stdout).unwrap();
    assert_eq!(shown["files"][0]["rows"], plan.run().samples.len());
    let table = calfit::files::table::Table::from_parquet(&fs::read(out.join("09-22-38.calibrated.parquet")).unwrap()).unwrap();
    let column = |name: &str| match &table.columns.iter().find(|(n, _)| n == name).unwrap().1 {
        calfit::files::table::Values::Numbers(values) => values.clone(),
        other => panic!("{other:?}"),
    };
    // 24 to 25 °C from the begin to the end, straight between the readings.
    let end_s = plan.settings.last().unwrap().t_end;
    for (t, degc) in column("t").iter().zip(column("t_degc")) {
        assert!((degc - (24.0 + t / end_s)).abs() < 1e-9, "{t} {degc}");
    }
    // The field that the coils made, within the noise of a sample and the trend of the offset.
    let (t, bx) = (column("t"), column("bx_nt"));
    for (i, setting) in plan.settings.iter().enumerate() {
        let own: Vec<f64> =
            t.iter().zip(&bx).filter(|(t, _)| (setting.t_start..setting.t_end).contains(t)).map(|(_, b)| *b).collect();
        let mean = own.iter().sum::<f64>() / own.len() as f64;
        assert!((mean - setting.field[0]).abs() < 0.1, "{i}: {mean} for {:?}", setting.field);
    }
    let other = Case::of(plan.run().key("sensor", "\"BS_12\"").text());
    let output = apply(&[&path], &other.file(), &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["is of sensor BS_12", "BS_11"]);
}

#[test]
fn polynomials_are_taken_at_the_temperatures_of_their_own_thermistor() {
    let made = made(6);
    let of_channel = |channel: &str| {
        let content = fs::read_to_string(&made.tpf).unwrap();
        let line = content.lines().find(|l| l.starts_with("channel = ")).unwrap();
        let path = made.case.path().join(format!("{channel}.TPF"));
        fs::write(&path, with_its_hash(&content.replace(line, &format!("channel = \"{channel}\"")))).unwrap();
        path
    };
    let plan = Plan::default();
    let mut run = plan.run().key("sensor", "\"IB\"").key("mode", "\"m\"");
    let end_s = plan.settings.last().unwrap().t_end;
    // T29 jumps by 5 K in the middle; T59 stays at 24 °C.
    run.temperatures = (0..=60)
        .map(|i| {
            let scatter = 0.02 * f64::from(i * 7 % 5) - 0.04;
            (f64::from(i) * end_s / 60.0, [Some(20.5 + scatter + if i < 30 { 0.0 } else { 5.0 }), Some(24.0 - scatter)])
        })
        .collect();
    let case = Case::of(run.text());
    let out = case.path().join("applied");
    let applied = |tpf: &Path, more: &[&str]| apply(&[tpf], &case.file(), &out, more);
    let degc = || {
        let table = fs::read(out.join("09-22-38.calibrated.parquet")).unwrap();
        let table = calfit::files::table::Table::from_parquet(&table).unwrap();
        match &table.columns.iter().find(|(name, _)| name == "t_degc").unwrap().1 {
            calfit::files::table::Values::Numbers(values) => values[0],
            other => panic!("{other:?}"),
        }
    };
    let told = done(&applied(&of_channel("T29"), &[]));
    assert!((degc() - 20.5).abs() < 0.1, "{}", degc());
    says(&told, &["temperature channel T29 jumps once by +"]);
    let told = done(&applied(&of_channel("T29"), &["--temperature-column", "T59"]));
    assert!((degc() - 24.0).abs() < 0.1, "{}", degc());
    says(&told, &["the temperatures are those of T59; the calibration was made of those of T29"]);
    let output = applied(&of_channel("T7"), &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["has no channel `T7`", "--temperature-column"]);

    // A third of the readings is missing: between a reading's distance after the last and as much before the next nothing is known.
    let step_s = end_s / 60.0;
    run.temperatures.retain(|(t_s, _)| *t_s < 20.5 * step_s || *t_s > 39.5 * step_s);
    let case = Case::of(run.text());
    let told = done(&apply(&[&of_channel("T59")], &case.file(), &out, &[]));
    says(&told, &["its temperature channel T59 has no reading from", "the temperature is not known there"]);
    let table = fs::read(out.join("09-22-38.calibrated.parquet")).unwrap();
    let table = calfit::files::table::Table::from_parquet(&table).unwrap();
    let [t_s, t_degc, bx_nt] =
        ["t", "t_degc", "bx_nt"].map(|name| match &table.columns.iter().find(|(own, _)| own == name).unwrap().1 {
            calfit::files::table::Values::Numbers(values) => values.clone(),
            other => panic!("{other:?}"),
        });
    for ((t_s, degc), b) in t_s.iter().zip(&t_degc).zip(&bx_nt) {
        let steps = t_s / step_s;
        if (21.01..38.99).contains(&steps) {
            assert!(degc.is_nan() && b.is_nan(), "{t_s} {degc} {b}");
        } else if !(20.99..39.01).contains(&steps) {
            assert!((degc - 24.0).abs() < 0.1 && b.is_finite(), "{t_s} {degc} {b}");
        }
    }
}

#[test]
fn a_run_that_is_cut_is_unreadable_unless_it_is_allowed() {
    let made = made(7);
    let whole = Plan::default().run().key("sensor", "\"IB\"").key("mode", "\"m\"").text();
    let cut = whole.len() * 2 / 3;
    let case = Case::of(&whole[..whole[..cut].rfind('\n').unwrap() + 1]);
    let out = case.path().join("applied");
    let output = apply(&[&made.tpf], &case.file(), &out, &[]);
    assert_eq!(output.status.code(), Some(2), "{}", text(&output.stderr));
    let told = done(&apply(&[&made.tpf], &case.file(), &out, &["--allow", "truncated"]));
    says(&told, &["09-22-38.CCR", "@END"]);
    let statement = fs::read_to_string(out.join("09-22-38.calibrated.json")).unwrap();
    says(&statement, &["--allow truncated", "@END"]);
}

/// Rows of the result are found in the run again by the counter of the samples.
#[test]
fn the_counter_of_a_run_passes_on() {
    let made = made(7);
    let run = Plan::default().run().key("sensor", "\"IB\"").key("mode", "\"m\"").lose(100..103);
    let case = Case::of(run.text());
    let out = case.path().join("applied");
    done(&apply(&[&made.tpf], &case.file(), &out, &[]));
    let table = calfit::files::table::Table::from_parquet(&fs::read(out.join("09-22-38.calibrated.parquet")).unwrap()).unwrap();
    let names: Vec<&str> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(names[..6], ["n", "t", "x", "y", "z", "t_degc"]);
    let column = |name: &str| match &table.columns.iter().find(|(own, _)| own == name).unwrap().1 {
        calfit::files::table::Values::Numbers(values) => values.clone(),
        other => panic!("{other:?}"),
    };
    assert_eq!(column("n"), run.samples.iter().map(|sample| sample.n as f64).collect::<Vec<_>>());
    // The first time is the tag itself, which the run has in tenths of a millisecond; the statement says what the others are.
    assert_eq!(column("t")[0], (run.samples[0].t * 1e4).round() / 1e4);
    let statement = fs::read_to_string(out.join("09-22-38.calibrated.json")).unwrap();
    says(&statement, &["\"n\"", "counter of the sample", "\"t\"", "over the sample rate"]);
    let checked = calfit().arg("check").arg(out.join("09-22-38.calibrated.json")).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
}

/// A statement is of one result: that of another table of the same name is not lost.
#[test]
fn the_statement_of_another_result_stays() {
    let made = made(7);
    let rows: Vec<Row> = vec![(readings([1000.0, 2000.0, 3000.0], 20.0, b_off_ent(20.0)), 20.0)];
    by_command(&[&made.tcf], &rows, &made.case, &[]);
    let out = made.case.path().join("applied");
    let csv_again = by_command(&[&made.tcf], &rows, &made.case, &[]);
    let before = fs::read_to_string(out.join("raw.calibrated.json")).unwrap();
    // Field, then uncertainties, behind the columns of the data.
    assert_eq!(csv_again.columns[6..], ["bx_nt", "by_nt", "bz_nt", "u_bx_nt", "u_by_nt", "u_bz_nt", "flags"]);
    let run = Case::of(Plan::default().run().key("sensor", "\"IB\"").key("mode", "\"m\"").text());
    let other = made.case.path().join("raw.CCR");
    fs::copy(run.file(), &other).unwrap();
    let output = apply(&[&made.tcf], &other, &out, &["--temperature", "20"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["raw.calibrated.json would replace that of raw.calibrated.csv", "-o"]);
    assert_eq!(fs::read_to_string(out.join("raw.calibrated.json")).unwrap(), before);
    assert!(!out.join("raw.calibrated.parquet").exists());
    // It is free once the older result is gone.
    fs::remove_file(out.join("raw.calibrated.csv")).unwrap();
    done(&apply(&[&made.tcf], &other, &out, &["--temperature", "20"]));
}

/// The uncertainty against a Monte Carlo: coefficients drawn from the covariance that the file states, through the applicator.
#[test]
fn the_uncertainty_is_that_of_a_monte_carlo() {
    let made = made(8);
    let stated = parameters(&made.ground);
    let names: Vec<String> =
        stated["covariance"]["parameters"].as_array().unwrap().iter().map(|n| n.as_str().unwrap().to_owned()).collect();
    let n = names.len();
    let c = nalgebra::DMatrix::from_fn(n, n, |i, k| number(&stated, &format!("covariance.matrix.{i}.{k}")));
    // Correlations of one make the matrix singular, so that its root is taken by eigenvalues.
    let eigen = c.symmetric_eigen();
    let root = &eigen.eigenvectors * nalgebra::DMatrix::from_diagonal(&eigen.eigenvalues.map(|v| v.max(0.0).sqrt()));
    let (t, raw) = (40.0, readings([4000.0, -7000.0, 5000.0], 40.0, b_off_ent(40.0)));
    let mut gauss = Gauss(9);
    let mut sums = [Vector3::zeros(), Vector3::zeros()];
    let draws = 20_000;
    let centre = applicator(&[&stated], false, raw, t);
    let mut drawn = stated.clone();
    for _ in 0..draws {
        let by = &root * nalgebra::DVector::from_fn(n, |_, _| gauss.normal());
        for (name, by) in names.iter().zip(by.iter()) {
            let (label, component) = name.rsplit_once('_').unwrap();
            let place = match component {
                "x" | "xy" => 0,
                "y" | "xz" => 1,
                _ => 2,
            };
            let value = stated[label][place].as_float().unwrap() + by;
            drawn[label].as_array_mut().unwrap().replace(place, value);
        }
        let off = applicator(&[&drawn], false, raw, t) - centre;
        sums[0] += off;
        sums[1] += off.component_mul(&off);
    }
    let found = by_command(&[&made.ground], &[(raw, t)], &made.case, &[]);
    for i in 0..3 {
        let std = (sums[1][i] / f64::from(draws)).sqrt();
        // 20 000 draws give a standard deviation to half a per cent.
        assert!((found.std[0][i] / std - 1.0).abs() < 0.02, "{i}: {} {std}", found.std[0][i]);
        assert!((sums[0][i] / f64::from(draws)).abs() < 0.05 * std);
    }
}

#[test]
fn the_reference_cube_is_the_sensor_frame_turned() {
    let case = Case::of(Plan::default().run().text());
    case.put(
        "campaign.toml",
        "[[position]]\nid = 1\naxes = [\"+X\", \"+Y\", \"+Z\"]\n[[reference]]\nsensor = \"BS_11\"\nstd_deg = 0.02\n\
         rotation = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]\n",
    );
    case.done(&[]);
    let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let rows: Vec<Row> = fields(6, 13).into_iter().map(|b| (Truth::default().reading(b), 24.5)).collect();
    let sensor = by_command(&[&path], &rows, &case, &[]);
    let cube = by_command(&[&path], &rows, &case, &["--frame", "reference"]);
    for i in 0..rows.len() {
        let ([x, y, z], [a, b, c]) = (sensor.field[i], cube.field[i]);
        assert!([a - y, b - z, c - x].iter().all(|d| d.abs() < 1e-9), "{i}");
        // A turn by 0.02 degrees about the other two axes moves a component by what stands across it.
        let turned = |own: f64, across: f64| (own * own + (0.02_f64.to_radians() * across).powi(2)).sqrt();
        let wanted =
            [turned(sensor.std[i][1], x.hypot(z)), turned(sensor.std[i][2], x.hypot(y)), turned(sensor.std[i][0], y.hypot(z))];
        (0..3).for_each(|k| assert!((cube.std[i][k] / wanted[k] - 1.0).abs() < 1e-9, "{i} {k}"));
    }
    let without = made(14);
    let data = without.case.path().join("raw.csv");
    fs::write(&data, csv(&rows)).unwrap();
    let output = apply(&[&without.tcf], &data, &without.case.path().join("refused"), &["--frame", "reference"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["TCF", "does not say how the sensor stands in its reference cube", "[[reference]]"]);
}

#[test]
fn known_effects_are_taken_off_readings_or_the_file_is_refused() {
    // A cubic of the reading without offset on x, as a model file that another run told: c3 = 2e-10 /enT², 1.6 enT at 2000 enT.
    let c3 = 2e-10;
    let truth = Truth::default();
    let bent = |r: [f64; 3]| {
        let linear = r[0] - truth.offset_ent[0];
        [r[0] + c3 * linear.powi(3), r[1], r[2]]
    };
    let case = Case::of(Plan::default().run().each(bent).text());
    let model = case.path().join("cubic.toml");
    let number = ModelParameter { name: "c3_x".to_owned(), value: c3, std: Some(1e-12), unit: "enT/enT^3".to_owned() };
    let effect = ModelEffect {
        id: "cubic_nonlinearity".to_owned(),
        form: "cubic".to_owned(),
        axes: vec!["x".to_owned()],
        run: None,
        reading_ent: Some(vec![[-2100.0, 2100.0]; 3]),
        parameter: vec![number],
        shape: Vec::new(),
    };
    let body = Model { used: Vec::new(), convention: "as printed".to_owned(), sensor: None, mode: None, effect: vec![effect] };
    let origin = Provenance::new(Recipe::plain("diagnose"), Vec::new());
    fs::write(&model, parameter::to_text(&body, &origin).unwrap()).unwrap();
    case.done(&["--model", model.to_str().unwrap()]);
    let path = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let field = [1900.0, -1500.0, 800.0];
    let rows = [(bent(truth.reading(field)), 24.5)];
    let data = case.path().join("raw.csv");
    fs::write(&data, csv(&rows)).unwrap();
    let out = case.path().join("refused");
    let output = apply(&[&path], &data, &out, &["--frame", "coil"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["effects of cubic.toml were taken off", "--model"]);
    let model = model.to_str().unwrap();
    let found = by_command(&[&path], &rows, &case, &["--frame", "coil", "--model", model]);
    // 1.3 nT of the cubic; the noise of the calibration leaves a hundredth of it.
    (0..3).for_each(|i| assert!((found.field[0][i] - field[i]).abs() < 5.0 * found.std[0][i], "{i}: {:?}", found.field));
    // The same by hand.
    let by_hand = [(truth.reading(field), 24.5)];
    let linear = by_command(&[&path], &by_hand, &case, &["--frame", "coil", "--effects-taken-off"]);
    (0..3).for_each(|i| assert!((found.field[0][i] - linear.field[0][i]).abs() < 2e-3, "{i}"));
    // The same model under another name is the same model; another one under its name is none of the file.
    let copy = case.path().join("copy.toml");
    fs::copy(model, &copy).unwrap();
    let of_copy = by_command(&[&path], &rows, &case, &["--frame", "coil", "--model", copy.to_str().unwrap()]);
    assert_eq!(of_copy.field, found.field);
    let mut changed = body.clone();
    changed.effect[0].parameter[0].value = 10.0 * c3;
    fs::create_dir(case.path().join("other")).unwrap();
    let of_other = case.path().join("other/cubic.toml");
    fs::write(&of_other, parameter::to_text(&changed, &origin).unwrap()).unwrap();
    let output = apply(&[&path], &data, &out, &["--frame", "coil", "--model", of_other.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["CPF", "was made with the known effects of cubic.toml of the SHA-256", "and cubic.toml has"]);
    // Its uncertainty, 1e-12 times the cube of 1935 enT along x, beside that of the coefficients.
    let own = 1e-12 * (truth.reading(field)[0] - truth.offset_ent[0]).powi(3) * truth.sigma[0];
    let ratio = found.std[0][0] / linear.std[0][0].hypot(own);
    assert!((ratio - 1.0).abs() < 1e-2, "{ratio}");

    let other = Case::of(Plan::default().run().text());
    other.done(&[]);
    let plain = other.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let output = apply(&[&plain], &data, &out, &["--model", model]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["was made without known effects, not with those of cubic.toml"]);
}

#[test]
fn the_covariance_in_the_other_convention_is_that_of_a_monte_carlo() {
    use calfit::data::convention::{Alignment, Convention};
    use nalgebra::{Matrix6, Vector6};
    let mut gauss = Gauss(21);
    for convention in [Convention::BepiColombo, Convention::Rosetta] {
        // Misalignments of up to three degrees, and a covariance with correlations of up to a half.
        let sensor = Alignment {
            convention,
            sigma: std::array::from_fn(|_| 1.0 + 0.1 * gauss.uniform()),
            xi_deg: std::array::from_fn(|_| 90.0 + 3.0 * gauss.uniform()),
        };
        let scale = Matrix6::from_diagonal(&Vector6::new(2e-6, 3e-6, 4e-6, 3e-4, 5e-4, 4e-4));
        let root = scale * Matrix6::from_fn(|r, c| if r == c { 1.0 } else { 0.2 * gauss.uniform() });
        let covariance = root * root.transpose();
        let to = sensor.to_other().unwrap();
        let numbers = |a: &Alignment| Vector6::from_iterator(a.sigma.into_iter().chain(a.xi_deg));
        let (before, after) = (numbers(&sensor), numbers(&to.alignment));
        let draws = 40_000;
        let mut sum = Matrix6::zeros();
        for _ in 0..draws {
            let drawn = before + root * Vector6::from_fn(|_, _| gauss.normal());
            let one =
                Alignment { convention, sigma: std::array::from_fn(|i| drawn[i]), xi_deg: std::array::from_fn(|i| drawn[3 + i]) };
            let off = numbers(&one.to_other().unwrap().alignment) - after;
            sum += off * off.transpose();
        }
        let (found, wanted) = (to.covariance(&covariance), sum / f64::from(draws));
        for r in 0..6 {
            for c in 0..6 {
                // A covariance of 40 000 draws is known to half a per cent of the product of both standard deviations.
                let scale = (wanted[(r, r)] * wanted[(c, c)]).sqrt();
                assert!((found[(r, c)] - wanted[(r, c)]).abs() < 0.02 * scale, "{convention:?} {r} {c}: {found} {wanted}");
            }
        }
    }
}

/// Nothing that was applied to is no result: means of plateaus hold no vectors, and neither does a header line.
#[test]
fn a_file_without_vectors_is_refused() {
    let made = made(9);
    let out = made.case.path().join("applied");
    let means = data("runs/champ-1998/98-03-23/00-00-04.CCR");
    let case = Case::new();
    done(&calfit().arg("lin").arg(&means).args(["--no-plots", "-o"]).arg(case.out()).output().unwrap());
    let cpf = case.out().join("98-03-23_00-00-04/PARAMETER_LIN__98-03-23_00-00-04.CPF");
    let empty = made.case.path().join("empty.csv");
    fs::write(&empty, "x,y,z,t_degc\n").unwrap();
    for (file, data, words) in [(&cpf, &means, "plateau means (@BLOCKS) and no vectors"), (&made.tpf, &empty, "holds no vectors")]
    {
        let output = apply(&[file], data, &out, &[]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        says(&text(&output.stderr), &[words, "nothing was applied", "@VECTORS"]);
        let left: Vec<_> = fs::read_dir(&out).unwrap().filter_map(Result::ok).map(|e| e.file_name()).collect();
        assert!(left.iter().all(|name| !name.to_string_lossy().contains("calibrated")), "{left:?}");
    }
}

/// The temperature that was used stands beside the field, and a column that was not used is named.
#[test]
fn one_temperature_for_all_takes_the_place_of_the_column() {
    let made = made(9);
    let raw = made.case.path().join("warm.csv");
    fs::write(&raw, "t_degc,x,y,z\n45.0,3000,-2000,1000\n45.5,3000,-2000,1000\n").unwrap();
    let out = made.case.path().join("applied");
    let told = done(&apply(&[&made.tcf], &raw, &out, &["--temperature", "20"]));
    says(&told, &["warm.csv: its column `t_degc` was not used", "20 °C of --temperature"]);
    assert_eq!(told.matches("was not used").count(), 1, "{told}");
    let table = fs::read_to_string(out.join("warm.calibrated.csv")).unwrap();
    let rows: Vec<Vec<&str>> = table.lines().skip(1).map(|line| line.split(',').collect()).collect();
    assert_eq!(rows[0][..4], ["t_degc", "x", "y", "z"]);
    assert_eq!(rows[1..].iter().map(|row| row[0].parse::<f64>().unwrap()).collect::<Vec<_>>(), [20.0, 20.0]);
    assert_eq!(rows[1][1], "3000");
    // The same of a run, whose thermistor stays at 24 °C.
    let case = Case::of(Plan::default().run().key("sensor", "\"IB\"").key("mode", "\"m\"").text());
    let told = done(&apply(&[&made.tcf], &case.file(), &out, &["--temperature", "20"]));
    says(&told, &["temperature channel", "was not used", "20 °C of --temperature"]);
    // A table without temperatures has none to pass over.
    fs::write(&raw, "x,y,z\n3000,-2000,1000\n").unwrap();
    let told = done(&apply(&[&made.tcf], &raw, &out, &["--temperature", "20"]));
    assert!(!told.contains("was not used"), "{told}");
}

#[test]
fn a_calibration_that_needs_a_temperature_says_how_to_name_it() {
    let made = made(9);
    let raw = made.case.path().join("cold.csv");
    fs::write(&raw, "x,y,z\n3000,-2000,1000\n").unwrap();
    let out = made.case.path().join("applied");
    let output = apply(&[&made.tcf], &raw, &out, &[]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["cold.csv", "has no column `t_degc`", "--temperature-column", "--temperature"]);
    assert!(!out.join("cold.calibrated.csv").exists());
}

#[test]
fn a_table_with_semicolons_is_told_what_apply_reads() {
    let made = made(9);
    let out = made.case.path().join("applied");
    let output = apply(&[&made.tcf], &data("runs/laboratory/plateaus.csv"), &out, &["--temperature", "20"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["plateaus.csv:1", "semicolons", "commas between cells", "calfit import"]);
    let twice = made.case.path().join("twice.csv");
    fs::write(&twice, "t,x,y,z,x\n0,1,2,3,4\n").unwrap();
    let output = apply(&[&made.tcf], &twice, &out, &["--temperature", "20"]);
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["twice.csv:1", "two columns `x`", "rename one"]);
}

#[test]
fn what_a_run_says_against_its_values_goes_with_them() {
    let said = "warnings = [\"the gain of x jumps\", \"FIT: the residuals bend\", \"a row is repeated\"]\n\
                warning_kinds = [\"gain_jump\", \"fit\", \"data\"]\n";
    let made = made_saying(11, said);
    let jump = "run 01-06-01_09-00-00: the gain of x jumps";
    let bend = "run 01-06-01_09-00-00: the residuals bend";
    for path in [&made.tpf, &made.tcf, &made.ground] {
        let file = fs::read_to_string(path).unwrap();
        says(&file, &[jump, bend, "\"gain_jump\"", "\"fit\""]);
        assert!(!file.contains("a row is repeated"), "{file}");
    }
    assert!(!fs::read_to_string(&made.tof).unwrap().contains("the gain of x"), "its runs say nothing");
    let readings: Vec<Row> = vec![(readings([1000.0, 2000.0, 3000.0], 20.0, b_off_ent(20.0)), 20.0)];
    let data = made.case.path().join("raw.csv");
    fs::write(&data, csv(&readings)).unwrap();
    for (place, files) in [("polynomials", vec![made.tpf.as_path(), &made.tof]), ("ground", vec![&made.ground])] {
        let out = made.case.path().join(place);
        let warned = done(&apply(&files, &data, &out, &[]));
        let statement = fs::read_to_string(out.join("raw.calibrated.json")).unwrap();
        for words in [jump, bend] {
            assert_eq!(warned.matches(words).count(), 1, "{warned}");
            says(&statement, &[words]);
        }
    }
    for format in ["csv", "dcc"] {
        let out = made.case.path().join(format);
        let export = calfit().args(["export", "--format", format, "-o"]).arg(&out).arg(&made.tpf).output().unwrap();
        says(&done(&export), &[jump, bend]);
        let end = if format == "csv" { "csv" } else { "xml" };
        let name = format!("{}.{end}", made.tpf.file_name().unwrap().to_string_lossy());
        let exported = fs::read_to_string(out.join(name)).unwrap();
        says(&exported, &["the gain of x jumps", "FIT: run 01-06-01_09-00-00: the residuals bend"]);
    }
}

/// The matrix of a run turns to coil axes from the position of this run. In position 2 the sensor stands turned by 180° about its z axis, so that
/// the field along X_c would come out with the wrong sign.
#[test]
fn coil_axes_are_not_given_for_settings_in_another_position() {
    let case = Case::of(Plan::default().run().text());
    case.put(
        "campaign.toml",
        "[[position]]\nid = 1\naxes = [\"+X\", \"+Y\", \"+Z\"]\n[[position]]\nid = 2\naxes = [\"-X\", \"-Y\", \"+Z\"]\n\
         [[position]]\nid = 3\naxes = [\"+X\", \"+Y\", \"+Z\"]\n",
    );
    case.done(&[]);
    let cpf = case.out().join(RUN_ID).join(format!("PARAMETER_LIN__{RUN_ID}.CPF"));
    let in_positions = |positions: &[u32]| {
        let mut run = Plan::default().run().named("13-04-03_12-00-00");
        let last = run.settings.len() - 1;
        for (i, position) in positions.iter().enumerate() {
            run.settings[last - i].position = *position;
        }
        case.put("13-04-03/12-00-00.CCR", run.text())
    };
    let out = case.path().join("applied");
    let result = out.join("12-00-00.calibrated.parquet");
    for (positions, words) in [(&[2][..], "position 2,"), (&[2, 4, 2][..], "positions 2, 4,")] {
        let run = in_positions(positions);
        let output = apply(&[&cpf], &run, &out, &["--frame", "coil"]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        let told = text(&output.stderr);
        says(
            &told,
            &["12-00-00.CCR", "settings in ", words, "from position 1, +X +Y +Z, alone", "--frame sensor", "the CPF of a run"],
        );
        assert!(!result.exists());
        done(&apply(&[&cpf], &run, &out, &[]));
        assert!(result.exists());
        fs::remove_file(&result).unwrap();
    }
    // A position of another id with the same axes is the same one.
    done(&apply(&[&cpf], &in_positions(&[3]), &out, &["--frame", "coil"]));
    assert!(result.exists());
}

/// The coil system stands in a room: 90 °C in its channel and 17 °C in that of the sensor are columns that were exchanged.
#[test]
fn exchanged_columns_of_temperatures_are_told() {
    let made = made(9);
    let mut run = Plan::default().run().key("sensor", "\"IB\"").key("mode", "\"m\"");
    let mut told = |channels: [f64; 2]| {
        // Fewer than four readings are not judged.
        run.temperatures = (0..8).map(|i| (10.0 * f64::from(i), channels.map(Some))).collect();
        let case = Case::of(run.text());
        done(&apply(&[&made.tpf, &made.tof], &case.file(), &case.path().join("applied"), &[]))
    };
    let words = "as if the two were exchanged";
    let right = told([17.0, 58.0]);
    assert!(!right.contains(words), "{right}");
    let exchanged = told([130.0, 17.0]);
    says(&exchanged, &["warning: ", "temperature channel T29 of a room reads 130.0 °C and T59 17.0 °C", words]);
    assert_eq!(exchanged.matches(words).count(), 1, "{exchanged}");
}

/// One reading of 85 °C between those of 20 °C, and a thermistor that is lost half-way; a course of the temperature and steps of a chamber are
/// no jumps, nor are rows in any order.
#[test]
fn jumps_of_the_temperatures_of_a_table_are_told() {
    let made = made(9);
    let out = made.case.path().join("applied");
    let told = |name: &str, rows: usize, at: &dyn Fn(usize) -> (f64, f64)| {
        let row = |i: usize| {
            let (t_s, degc) = at(i);
            format!("{t_s:?},{},{},{},{degc:?}\n", 1000 + 7 * i, -500 + (i * i % 7) as i64, 200 + i % 3)
        };
        let path = made.case.path().join(name);
        fs::write(&path, format!("t,x,y,z,t_degc\n{}", (0..rows).map(row).collect::<String>())).unwrap();
        done(&apply(&[&made.tpf, &made.tof], &path, &out, &[]))
    };
    let second = |i: usize| i as f64;
    let aside = told("aside.csv", 20, &|i| (second(i), if i == 10 { 85.0 } else { 20.0 }));
    says(&aside, &["aside.csv: its column `t_degc` jumps 2 times, most by ", "65.0 K", "correct them if they are wrong"]);
    let lost = told("lost.csv", 20, &|i| (second(i), if i < 10 { 20.0 + 0.01 * i as f64 } else { 0.0 }));
    says(&lost, &["lost.csv: its column `t_degc` jumps once by -20.1 K at 10 s"]);
    // A long table, of which not all rows are looked at: 40 000 rows with a level of 30 K.
    let level = |i: usize, first: usize| if i < first { 20.0 } else { 50.0 };
    let long = told("long.csv", 40_000, &|i| (second(i), level(i, 25_000) + 0.01 * (i % 7) as f64));
    says(&long, &["long.csv: its column `t_degc` jumps once by +30.0 K at 25000 s"]);
    type Rows<'a> = &'a dyn Fn(usize) -> (f64, f64);
    let quiet: [(&str, Rows); 3] = [
        ("ramp.csv", &|i| (second(i), 20.0 + 0.1 * second(i))),
        ("held.csv", &|i| (second(i), 20.0 + 2.0 * second(i / 20))),
        ("other.csv", &|i| (second(i * 7 % 13), level(i, 150))),
    ];
    for (name, at) in quiet {
        let said = told(name, 300, at);
        assert!(!said.contains("jumps"), "{name}: {said}");
    }
}

/// What is told of the readings as a whole stands in the head of the table as well, and its rows stay as they are.
#[test]
fn what_is_told_of_the_readings_stands_in_the_head_of_the_table() {
    let made = made(11);
    let raw = made.case.path().join("still.csv");
    let rows: String = (0..40).map(|i| format!("{}.5,-2000,{}.25,20.0\n", 3000 + i, 1000 - i)).collect();
    fs::write(&raw, format!("x,y,z,t_degc\n{rows}")).unwrap();
    let out = made.case.path().join("applied");
    let told = done(&apply(&[&made.tcf], &raw, &out, &[]));
    let note = "component y stands still: all of its readings are -2000";
    says(&told, &[note]);
    let table = fs::read_to_string(out.join("still.calibrated.csv")).unwrap();
    let head: serde_json::Value = serde_json::from_str(table.lines().next().unwrap().strip_prefix("# calfit ").unwrap()).unwrap();
    assert!(head["notes"].as_array().unwrap().iter().any(|own| own == note), "{head}");
    assert!(table.lines().nth(1).unwrap().starts_with("x,y,z,t_degc,bx_nt,"), "{table:.300}");
    assert_eq!(table.lines().count(), 2 + 40);
    assert_eq!(calibrated(&out.join("still.calibrated.csv")).field.len(), 40);
}
