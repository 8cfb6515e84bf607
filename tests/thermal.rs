//! `calfit thermal` on parameter files: polynomials come back, groups are kept apart, and what is missing is said.

use crate::common;

use common::check::{Case, calfit, parameters, says, text};
use std::fs;
use std::path::Path;
use toml_edit::{DocumentMut, Table};

/// The runs are not said to be at certain temperatures; seven that span the range of the campaign.
const TEMPERATURES_DEGC: [f64; 7] = [17.3, -71.0, -40.5, 0.25, 60.0, 120.0, 180.0];

fn published() -> DocumentMut {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/bepicolombo/thermal.toml");
    fs::read_to_string(path).unwrap().parse().unwrap()
}

fn coefficients(file: &Table, name: &str) -> Vec<f64> {
    file[name].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect()
}

fn evaluate(file: &Table, name: &str, degc: f64) -> f64 {
    coefficients(file, name).iter().rev().fold(0.0, |sum, c| sum * degc + c)
}

/// A parameter file with only the keys that other programs rely on, at the values of a published polynomial.
fn parameter_file(file: &Table, used: &str, degc: f64) -> String {
    let three = |names: [&str; 3]| -> Vec<f64> { names.iter().map(|n| evaluate(file, n, degc)).collect() };
    let run = used.split("__").nth(1).unwrap().split('.').next().unwrap();
    let head = |format: &str, keys: String| {
        format!(
            "format = \"{format}\"\nversion = 1\n{keys}\n[run]\nid = \"{run}\"\nsensor = \"OB\"\nmode = \"cal mode 0\"\n\
             temperature_degc = {degc:?}\n"
        )
    };
    if used.ends_with(".CPF") {
        let [x, y, z] = <[f64; 3]>::try_from(three(["sigma_x", "sigma_y", "sigma_z"])).unwrap();
        let [xy, xz, yz] = <[f64; 3]>::try_from(three(["xi_xy", "xi_xz", "xi_yz"])).unwrap();
        let b_or = three(["b_or_x", "b_or_y", "b_or_z"]);
        head("CPF", String::new())
            + &format!(
                "[matrix]\nsigma = [[{x:?}, 0.0, 0.0], [0.0, {y:?}, 0.0], [0.0, 0.0, {z:?}]]\n\
                 [angle_deg]\nxi_xy = {xy:?}\nxi_xz = {xz:?}\nxi_yz = {yz:?}\n[offset]\nb_or_ent = {b_or:?}\n"
            )
    } else if used.ends_with(".OPF") {
        head("OPF", format!("offset_ent = {:?}", three(["b_off_x", "b_off_y", "b_off_z"])))
    } else {
        head("FPF", format!("f_3db_igep_hz = {:?}", three(["f_3db_x", "f_3db_y", "f_3db_z"])))
    }
}

#[test]
fn the_published_polynomials_come_back_from_parameter_files_written_by_hand() {
    let document = published();
    for file in document["file"].as_array_of_tables().unwrap() {
        let name = file["name"].as_str().unwrap();
        let case = Case::new();
        for (used, degc) in file["used"].as_array().unwrap().iter().zip(TEMPERATURES_DEGC) {
            let used = used.as_str().unwrap();
            case.put(used, parameter_file(file, used, degc));
        }
        let output = case.run("thermal", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{name}: {}", text(&output.stderr));
        let first = file["used"][0].as_str().unwrap().split("__").nth(1).unwrap().split('.').next().unwrap().replace('_', "-");
        let kind = name.split("__").next().unwrap();
        let found = parameters(&case.out().join(format!("{kind}__{first}.{}", name.split('.').nth(1).unwrap())));
        for (key, _) in file.iter().filter(|(k, v)| k.contains('_') && v.is_array() && *k != "used") {
            let expected = coefficients(file, key);
            let got: Vec<f64> = found[key].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect();
            assert_eq!(got.len(), expected.len(), "{name} {key}: {got:?}");
            for (g, e) in got.iter().zip(&expected) {
                assert!(((g - e) / e).abs() < 1e-9, "{name} {key}: {got:?} is not {expected:?}");
            }
            assert!(found["covariance"].get(key).is_some());
        }
        let used: Vec<&str> = found["used"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
        let mut expected: Vec<&str> = file["used"].as_array().unwrap().iter().map(|v| v.as_str().unwrap()).collect();
        expected.sort_unstable();
        assert_eq!(used, expected);
        let span = &TEMPERATURES_DEGC[..used.len()];
        assert_eq!(found["valid_degc"][0].as_float(), span.iter().copied().reduce(f64::min));
        assert_eq!(found["valid_degc"][1].as_float(), span.iter().copied().reduce(f64::max));
    }
}

fn opf(run: &str, sensor: &str, degc: Option<f64>, offset: f64) -> String {
    let temperature = degc.map_or_else(String::new, |t| format!("temperature_degc = {t:?}\n"));
    format!(
        "format = \"OPF\"\nversion = 1\noffset_ent = [{offset:?}, 1.0, -1.0]\noffset_std_ent = [0.01, 0.01, 0.01]\n\
         [run]\nid = \"{run}\"\nsensor = \"{sensor}\"\nmode = \"m\"\n{temperature}"
    )
}

#[test]
fn sensors_are_kept_apart_and_runs_without_temperature_are_named() {
    let case = Case::new();
    for (i, degc) in [-50.0, 0.0, 50.0, 100.0].into_iter().enumerate() {
        let id = format!("13-04-0{}_09-00-00", i + 1);
        case.put(&format!("A{i}.OPF"), opf(&id, "A", Some(degc), 0.1 + 1e-3 * degc));
        case.put(&format!("B{i}.OPF"), opf(&id.replace("_09", "_10"), "B", Some(degc), -5.0));
    }
    case.put("C.OPF", opf("13-04-09_09-00-00", "A", None, 99.0));
    // The readings of the third run of A once more.
    case.put("D.OPF", opf("13-04-08_09-00-00", "A", Some(50.0), 0.1 + 1e-3 * 50.0));
    let output = case.run("thermal", &["--no-plots", "--order", "b_off_x=1", "--order", "b_off=0"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["C.OPF states no sensor temperature and was left out"]);
    let copy =
        "run 13-04-08_09-00-00 was left out: its values and its temperature are those of run 13-04-03_09-00-00 to the last digit";
    says(&text(&output.stderr), &[copy]);
    let a = parameters(&case.out().join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF"));
    let b = parameters(&case.out().join("THERMAL_OFF_PARAMETER__13-04-01-10-00-00.TOF"));
    let first = |document: &DocumentMut| {
        document["b_off_x"].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect::<Vec<_>>()
    };
    assert!((first(&a)[0] - 0.1).abs() < 1e-12 && (first(&a)[1] - 1e-3).abs() < 1e-14);
    assert!((first(&b)[0] + 5.0).abs() < 1e-12 && first(&b)[1].abs() < 1e-14);
    assert_eq!(a["b_off_y"].as_array().unwrap().len(), 1, "the order of the family");
    assert_eq!(a["used"].as_array().unwrap().len(), 4);
}

#[test]
fn too_few_temperatures_and_too_high_orders_are_refused_by_name_and_other_groups_go_on() {
    let case = Case::new();
    for (i, degc) in [-50.0, 50.0].into_iter().enumerate() {
        case.put(&format!("A{i}.OPF"), opf(&format!("13-04-0{}_09-00-00", i + 1), "A", Some(degc), 0.1));
    }
    case.put("B.OPF", opf("13-04-01_10-00-00", "B", Some(20.0), 0.1));
    let output = case.run("thermal", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0));
    says(&text(&output.stderr), &["B m: its offset runs (B.OPF) are at 1 different temperature"]);
    assert!(case.out().join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF").is_file());
    let output = case.run("thermal", &["--no-plots", "--order", "b_off=2"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["b_off_x", "order 2 needs 3 different points; there are 2", "--order"]);
}

/// Straight line with weights: intercept, slope, their variances, and the weighted squares that are left, by the normal equations.
fn weighted_line(t: &[f64], y: &[f64], weights: &[f64]) -> [f64; 5] {
    let sum = |of: &dyn Fn(usize) -> f64| (0..t.len()).map(|i| weights[i] * of(i)).sum::<f64>();
    let [s, st, stt] = [sum(&|_| 1.0), sum(&|i| t[i]), sum(&|i| t[i] * t[i])];
    let [sy, sty] = [sum(&|i| y[i]), sum(&|i| t[i] * y[i])];
    let determinant = s * stt - st * st;
    let [a, b] = [(stt * sy - st * sty) / determinant, (s * sty - st * sy) / determinant];
    [a, b, stt / determinant, s / determinant, sum(&|i| (y[i] - a - b * t[i]).powi(2))]
}

/// Two of six runs are known a hundred times better than the others, and all scatter by more than any of them says: with the scatter added to each, as
/// much as leaves squares of their number, all count nearly alike. With a common factor the two would decide everything.
#[test]
fn a_scatter_between_runs_is_the_same_for_all_of_them() {
    let case = Case::new();
    let degc = [-40.0, -20.0, 0.0, 20.0, 40.0, 60.0];
    let std = [0.01, 0.0001, 0.01, 0.01, 0.0001, 0.01];
    let off = [0.04, -0.05, 0.01, -0.03, 0.06, -0.02];
    let value: Vec<f64> = degc.iter().zip(off).map(|(t, off)| 5.0 + 1e-3 * t + off).collect();
    for i in 0..6 {
        let text = opf(&format!("13-04-0{}_09-00-00", i + 1), "A", Some(degc[i]), value[i]);
        let own = format!("offset_std_ent = [{:?}, 0.01, 0.01]", std[i]);
        case.put(&format!("A{i}.OPF"), text.replace("offset_std_ent = [0.01, 0.01, 0.01]", &own));
    }
    let output = case.run("thermal", &["--no-plots", "--order", "b_off=1"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["b_off_x: the runs scatter by", "was added to those of all runs"]);
    let found = parameters(&case.out().join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF"));
    // The scatter with which the squares are as many as degrees of freedom, by halving.
    let of = |scatter: f64| weighted_line(&degc, &value, &std.map(|s| 1.0 / (s * s + scatter * scatter)));
    let [mut low, mut high] = [0.0, 1.0];
    for _ in 0..60 {
        let middle = 0.5 * (low + high);
        if of(middle)[4] > 4.0 { low = middle } else { high = middle }
    }
    let [a, b, var_a, var_b, _] = of(high);
    let number = |path: &str| common::check::number(&found, path);
    let first = found["quantity"].as_array_of_tables().unwrap().get(0).unwrap();
    let of_first = |key: &str| first[key].as_float().unwrap();
    assert!((of_first("scatter") / high - 1.0).abs() < 1e-6, "{high}");
    assert!((number("b_off_x.0") / a - 1.0).abs() < 1e-9 && (number("b_off_x.1") / b - 1.0).abs() < 1e-7);
    assert!((number("covariance.b_off_x.0.0") / var_a - 1.0).abs() < 1e-6);
    assert!((number("covariance.b_off_x.1.1") / var_b - 1.0).abs() < 1e-6);
    // Four degrees of freedom told it.
    assert!((of_first("factor_95") - 2.776_445).abs() < 1e-5);
}

/// The same of twelve runs, every other one known a hundred times better, without a given order: a polynomial of a high order that runs through the
/// six is no answer.
#[test]
fn a_scatter_is_told_from_a_polynomial_of_high_order() {
    let mut gauss = common::Gauss(31);
    for group in 0..6 {
        let case = Case::new();
        for i in 0..12 {
            let degc = -60.0 + 10.0 * f64::from(i);
            let value = 5.0 + 1e-3 * degc + 0.1 * gauss.normal();
            let text = opf(&format!("13-04-{:02}_09-00-00", i + 1), "A", Some(degc), value);
            let std = if i % 2 == 0 { 0.1 } else { 0.001 };
            case.put(&format!("A{i}.OPF"), text.replace("offset_std_ent = [0.01", &format!("offset_std_ent = [{std:?}")));
        }
        let output = case.run("thermal", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let found = parameters(&case.out().join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF"));
        let first = found["quantity"].as_array_of_tables().unwrap().get(0).unwrap();
        let scatter = first.get("scatter").and_then(toml_edit::Item::as_float).unwrap_or(0.0);
        assert!((0.04..0.2).contains(&scatter), "{group}: {scatter}");
        assert!(first["order"].as_integer().unwrap() <= 2, "{group}: {first}");
    }
}

/// Of four runs one is wrong: left out by its id it is in no polynomial; an option of runs and an id of nothing are refused.
#[test]
fn files_are_left_out_by_the_id_of_their_run_and_options_of_runs_are_refused() {
    let case = Case::new();
    for (i, degc) in [-50.0, 0.0, 50.0, 100.0].into_iter().enumerate() {
        let offset = if i == 2 { 7.0 } else { 0.1 + 1e-3 * degc };
        case.put(&format!("A{i}.OPF"), opf(&format!("13-04-0{}_09-00-00", i + 1), "A", Some(degc), offset));
    }
    let output = case.run("thermal", &["--no-plots", "--order", "b_off=1", "--exclude", "13-04-03_09-00-00=door open"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["A2.OPF is left out: door open"]);
    let found = parameters(&case.out().join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF"));
    assert_eq!(found["used"].as_array().unwrap().len(), 3);
    let slope = found["b_off_x"][1].as_float().unwrap();
    assert!((slope - 1e-3).abs() < 1e-14, "{slope}");
    for (options, words) in [
        (["--exclude", "13-04-09_09-00-00=x"].as_slice(), "would leave out nothing"),
        (&["--exclude", "13-04-03_09-00-00#2=x"], "is a part of a run whose result"),
        (&["--robust"], "--robust: changes nothing where only parameter files are named"),
        (&["--lag", "none"], "--lag: changes nothing where only parameter files are named"),
        (&["--settling", "3"], "--settling: changes nothing"),
        (&["--order", "2"], "--order N: changes nothing"),
    ] {
        let output = case.run("thermal", options);
        assert_eq!(output.status.code(), Some(2), "{options:?}");
        says(&text(&output.stderr), &[words]);
    }
}

#[test]
fn a_file_that_was_changed_is_refused_and_one_without_a_hash_is_warned_about() {
    let case = Case::of(common::good().text());
    assert_eq!(case.run("lin", &["--no-plots"]).status.code(), Some(0));
    let cpf = case.out().join(common::RUN_ID).join(format!("PARAMETER_LIN__{}.CPF", common::RUN_ID));
    let folder = case.path().join("files");
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("A.CPF"), fs::read_to_string(&cpf).unwrap().replacen("xi_xy = 8", "xi_xy = 9", 1)).unwrap();
    fs::write(folder.join("A.OPF"), opf("13-04-01_09-00-00", "A", Some(1.0), 0.0)).unwrap();
    let output = calfit().arg("thermal").arg(&folder).arg("-o").arg(case.path().join("t")).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["A.CPF", "was changed after it was written", "A.OPF", "carries no hash"]);
}

#[test]
fn both_corners_have_polynomials_and_that_between_amplitudes_is_the_printed_one() {
    let document = published();
    let of_sines = |file: &&Table| file["name"].as_str().unwrap().ends_with(".TAF");
    let mut files = 0;
    for file in document["file"].as_array_of_tables().unwrap().iter().filter(of_sines) {
        let case = Case::new();
        // The corners of the models lie lower, on a line of their own.
        let model = |i: usize, degc: f64| 50.0 + i as f64 - 0.03 * degc;
        for (used, degc) in file["used"].as_array().unwrap().iter().zip(TEMPERATURES_DEGC) {
            let used = used.as_str().unwrap();
            let hz: Vec<f64> = (0..3).map(|i| model(i, degc)).collect();
            let text = parameter_file(file, used, degc);
            let more = format!("f_3db_model_hz = {hz:?}\nf_3db_model_std_hz = [0.1, 0.1, 0.1]\nf_3db_igep_hz");
            case.put(used, text.replacen("f_3db_igep_hz", &more, 1));
        }
        let order = coefficients(file, "f_3db_x").len() - 1;
        let output = case.run("thermal", &["--no-plots", "--order", "f_3db=1", "--order", &format!("f_3db_igep={order}")]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let first = file["used"][0].as_str().unwrap().split("__").nth(1).unwrap().split('.').next().unwrap();
        let found = parameters(&case.out().join(format!("THERMAL_AC_PARAMETER__{first}.TAF")));
        assert_eq!(found["corner"].as_str(), Some("model"));
        for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
            let list =
                |key: String| -> Vec<f64> { found[&key].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect() };
            let printed = coefficients(file, &format!("f_3db_{component}"));
            let igep = list(format!("f_3db_igep_{component}"));
            assert_eq!(igep.len(), printed.len());
            for (g, e) in igep.iter().zip(&printed) {
                assert!(((g - e) / e).abs() < 1e-9, "{component}: {igep:?} is not {printed:?}");
            }
            let own = list(format!("f_3db_{component}"));
            assert!((own[0] - 50.0 - i as f64).abs() < 1e-9 && (own[1] + 0.03).abs() < 1e-11, "{own:?}");
            assert!(found["covariance"].get(format!("f_3db_igep_{component}")).is_some());
        }
        // Without an order of its own the corner between amplitudes takes that of the other.
        let output = case.run("thermal", &["--no-plots", "--order", "f_3db=0"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let found = parameters(&case.out().join(format!("THERMAL_AC_PARAMETER__{first}.TAF")));
        assert_eq!(found["f_3db_igep_x"].as_array().unwrap().len(), 1);
        files += 1;
    }
    assert_eq!(files, 4);
}

/// Ordinary least squares of a straight line, by its closed form.
fn line(t: &[f64], y: &[f64]) -> [f64; 2] {
    let n = t.len() as f64;
    let (st, sy) = (t.iter().sum::<f64>(), y.iter().sum::<f64>());
    let (stt, sty) = (t.iter().map(|t| t * t).sum::<f64>(), t.iter().zip(y).map(|(t, y)| t * y).sum::<f64>());
    let slope = (n * sty - st * sy) / (n * stt - st * st);
    [(sy - slope * st) / n, slope]
}

/// Runs that share two things: one moves all of them alike, the other only those of its period, with signs that change.
#[test]
fn what_runs_share_moves_the_polynomials_with_its_signs() {
    let degc = [-40.0, -10.0, 20.0, 50.0, 80.0];
    let by = [[2e-5; 5], [0.0, 0.0, 3e-5, -1e-5, 4e-5]];
    let case = Case::new();
    let mut files = Vec::new();
    for (i, t) in degc.into_iter().enumerate() {
        let run = format!("01-01-0{}_00-00-00", i + 1);
        let common = |source: &str, sigma_x: f64, xi_yz: f64| {
            format!(
                "[[common]]\nsource = \"{source}\"\nsigma = [{sigma_x:e}, 0.0, 0.0]\nxi_deg = [0.0, 0.0, {xi_yz:e}]\nb_or_ent = [0.0, 0.0, 0.0]\n"
            )
        };
        let second = if by[1][i] == 0.0 { String::new() } else { common("later", by[1][i], -by[1][i]) };
        let s = 1.0 + 1e-5 * t + 1e-7 * f64::from(i as u32 % 2);
        files.push(case.put(
            &format!("{run}.CPF"),
            format!(
                "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"S\"\nmode = \"m\"\ntemperature_degc = {t:?}\n\
                 [matrix]\nsigma = [[{s:?}, 0.0, 0.0], [0.0, {s:?}, 0.0], [0.0, 0.0, {s:?}]]\n[angle_deg]\nxi_xy = 90.0\nxi_xz = 90.0\n\
                 xi_yz = {:?}\n[offset]\nb_or_ent = [1.0, 2.0, {s:?}]\n[std]\nsigma = [1e-6, 1e-6, 1e-6]\nxi_deg = [1e-4, 1e-4, 1e-4]\n\
                 b_or_ent = [0.1, 0.1, 0.1]\n[std_b]\nsigma = [2e-5, 0.0, 0.0]\nxi_deg = [0.0, 0.0, 1e-5]\nb_or_ent = [0.0, 0.0, 0.0]\n{}{second}",
                90.0 + 1e-6 * t,
                common("all", by[0][i], 0.0)
            ),
        ));
    }
    let output = calfit()
        .arg("thermal")
        .args(&files)
        .args(["--no-plots", "--order", "sigma=1", "--order", "xi=1", "--order", "b_or=1", "-o"])
        .arg(case.out())
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let tpf = parameters(&case.out().join("THERMAL_PARAMETER__01-01-01-00-00-00.TPF"));
    let moved = by.map(|by| line(&degc, &by));
    let entry = |name: &str, r: usize, c: usize| tpf["covariance_b"][name][r][c].as_float().unwrap();
    let near = |found: f64, wanted: f64, size: f64| assert!((found - wanted).abs() < 1e-9 * size, "{found:e} {wanted:e}");
    for r in 0..2 {
        for c in 0..2 {
            let size = (0..2).map(|k| (moved[k][r] * moved[k][c]).abs()).sum::<f64>();
            near(entry("sigma_x", r, c), moved[0][r] * moved[0][c] + moved[1][r] * moved[1][c], size);
            near(entry("xi_yz", r, c), moved[1][r] * moved[1][c], size);
            assert_eq!(entry("sigma_y", r, c), 0.0);
        }
    }
    // The changes themselves, so that what uses several quantities knows how they go together.
    let common = tpf["common"].as_array_of_tables().unwrap();
    let sources: Vec<&str> = common.iter().map(|one| one["source"].as_str().unwrap()).collect();
    assert_eq!(sources, ["all", "later"]);
    for k in 0..2 {
        near(common.get(1).unwrap()["sigma_x"][k].as_float().unwrap(), moved[1][k], moved[1][k].abs());
        near(common.get(1).unwrap()["xi_yz"][k].as_float().unwrap(), -moved[1][k], moved[1][k].abs());
    }
}

/// A sensor that was turned by half a turn about z for some runs: the residual field of the coils changes its sign in B_or.
#[test]
fn offset_and_residual_field_are_those_of_one_position() {
    let case = Case::new();
    let degc = [-40.0, -10.0, 20.0, 50.0, 80.0];
    let b_off = |t: f64| 3.0 + 0.01 * t;
    let residual = 5.0;
    let mut files = Vec::new();
    for (i, t) in degc.into_iter().enumerate() {
        // The two warmest runs are of the turned sensor.
        let sign = if i < 3 { 1.0 } else { -1.0 };
        let run = format!("01-01-0{}_00-00-00", i + 1);
        let b_or = b_off(t) + sign * residual;
        files.push(case.put(
            &format!("{run}.CPF"),
            format!(
                "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"S\"\nmode = \"m\"\ntemperature_degc = {t:?}\n\
                 [matrix]\nr_nom = [[{sign:?}, 0.0, 0.0], [0.0, {sign:?}, 0.0], [0.0, 0.0, 1.0]]\n\
                 sigma = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]\n[angle_deg]\nxi_xy = 90.0\nxi_xz = 90.0\nxi_yz = 90.0\n\
                 [offset]\nb_or_ent = [{b_or:?}, {b_or:?}, 1.0]\n"
            ),
        ));
    }
    let output = calfit().arg("thermal").args(&files).args(["--no-plots", "-o"]).arg(case.out()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let tpf = parameters(&case.out().join("THERMAL_PARAMETER__01-01-01-00-00-00.TPF"));
    let b_or = |k: usize| tpf["b_or_x"][k].as_float().unwrap();
    assert!((b_or(0) - (3.0 + residual)).abs() < 1e-9 && (b_or(1) - 0.01).abs() < 1e-12, "{}", tpf["b_or_x"]);
    assert_eq!(tpf["valid_degc"][1].as_float(), Some(20.0));
    says(&tpf["warnings"].to_string(), &["several positions", "without 01-01-04_00-00-00, 01-01-05_00-00-00"]);
}
