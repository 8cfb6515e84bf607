//! `calfit thermal --centre` on the values of Rosetta RPC-MAG (RO-IGEP-TR0028 section 3.3): a temperature cycle beside the centre of the
//! coil system, a run at the centre, and the results that the report prints.

use crate::common;

use common::check::{Case, calfit, close, number, parameters, says, text, three};
use nalgebra::Matrix3;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;
use toml_edit::DocumentMut;

const T1: f64 = 17.39;
const CYCLE_DEGC: [f64; 5] = [-60.0, -30.0, 0.0, 30.0, 60.0];
const TCF: &str = "THERMAL_CENTRE_PARAMETER__01-06-01-09-00-00.TCF";
const TPF: &str = "THERMAL_PARAMETER__01-06-01-09-00-00.TPF";

fn published() -> DocumentMut {
    parameters(&Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/rosetta/ground_calibration.toml"))
}

/// A linear calibration as far as the transfer reads it, in the convention of the report.
#[derive(Clone)]
struct Linear {
    sigma: [f64; 3],
    xi_deg: [f64; 3],
    b_or_ent: [f64; 3],
    degc: Option<f64>,
    /// Standard uncertainties of σ, nT/enT, and ξ, degrees.
    std: Option<[f64; 2]>,
    sensor: &'static str,
}

impl Linear {
    fn text(&self, run: &str) -> String {
        let Linear { sigma: [x, y, z], xi_deg: [xy, xz, yz], b_or_ent, sensor, .. } = self;
        let degc = self.degc.map_or_else(String::new, |t| format!("temperature_degc = {t:?}\n"));
        let std = self.std.map_or_else(String::new, |[s, a]| {
            format!("[std]\nsigma = [{s:?}, {s:?}, {s:?}]\nxi_deg = [{a:?}, {a:?}, {a:?}]\nb_or_ent = [0.5, 0.5, 0.5]\n")
        });
        format!(
            "format = \"CPF\"\nversion = 1\n[run]\nid = \"{run}\"\nsensor = \"{sensor}\"\nmode = \"m\"\n{degc}[matrix]\n\
             omega_convention = \"Rosetta\"\nsigma = [[{x:?}, 0.0, 0.0], [0.0, {y:?}, 0.0], [0.0, 0.0, {z:?}]]\n[angle_deg]\nxi_xy = {xy:?}\nxi_xz = {xz:?}\nxi_yz = {yz:?}\n\
             [offset]\nb_or_ent = {b_or_ent:?}\n{std}"
        )
    }
}

/// The cycle of a sensor beside the centre by the printed polynomials, and the printed values at the centre.
struct Sensor {
    document: DocumentMut,
    name: &'static str,
}

impl Sensor {
    fn new(name: &'static str) -> Self {
        Self { document: published(), name }
    }

    fn printed(&self, key: &str) -> [f64; 3] {
        three(&self.document, &format!("{}.{key}", self.name))
    }

    fn line(&self, constant: &str, slope: &str, degc: f64) -> [f64; 3] {
        let (p0, p1) = (self.printed(constant), self.printed(slope));
        std::array::from_fn(|i| p0[i] + p1[i] * degc)
    }

    fn off_centre(&self, degc: f64, std: Option<[f64; 2]>) -> Linear {
        Linear {
            sigma: self.line("sigma_off_centre_0", "sigma_off_centre_1_per_k", degc),
            xi_deg: self.line("xi_off_centre_0_deg", "xi_off_centre_1_deg_per_k", degc),
            b_or_ent: self.line("a0_nt", "a1_nt_per_k", degc),
            degc: Some(degc),
            std,
            sensor: self.name,
        }
    }

    fn centre(&self, std: Option<[f64; 2]>) -> Linear {
        let (sigma, xi_deg) = (self.printed("sigma_reference"), self.printed("xi_reference_deg"));
        Linear { sigma, xi_deg, ..self.off_centre(T1, std) }
    }

    /// The offset as turning the sensor would have shown it at T1.
    fn offset(&self, std: &str) -> String {
        let (sum, b_res) = (self.off_centre(T1, None).b_or_ent, self.printed("b_res_nt"));
        let offset: [f64; 3] = std::array::from_fn(|i| sum[i] - b_res[i]);
        format!(
            "format = \"OPF\"\nversion = 1\noffset_ent = {offset:?}\n{std}[run]\nid = \"01-06-09_09-00-00\"\nsensor = \"{}\"\n\
             mode = \"m\"\ntemperature_degc = {T1:?}\n",
            self.name
        )
    }

    /// Puts the cycle into a folder.
    fn cycle(&self, case: &Case, std: Option<[f64; 2]>) {
        for (i, degc) in CYCLE_DEGC.into_iter().enumerate() {
            let run = format!("01-06-0{}_09-00-00", i + 1);
            case.put(&format!("{run}.CPF"), self.off_centre(degc, std).text(&run));
        }
    }
}

fn put(case: &Case, name: &str, content: &str) -> PathBuf {
    let path = case.path().join(name);
    fs::write(&path, content).unwrap();
    path
}

fn transfer(case: &Case, named: &[(&str, &Path)]) -> Output {
    let mut command = calfit();
    command.arg("thermal").arg(case.campaign()).arg("-o").arg(case.out()).args(["--no-plots"]);
    for order in ["sigma=1", "xi=1", "b_or=1"] {
        command.args(["--order", order]);
    }
    for (option, path) in named {
        command.arg(option).arg(path);
    }
    command.output().unwrap()
}

fn done(output: &Output) -> String {
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stderr)
}

/// Q(ξ) of RO-IGEP-TR0028 section 3.2.2.3.
fn q([xy, xz, yz]: [f64; 3]) -> Matrix3<f64> {
    let [xy, xz, yz] = [xy, xz, yz].map(f64::to_radians);
    let middle = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    let last = (xz.sin().powi(2) - middle * middle).sqrt();
    Matrix3::new(1.0, xy.cos(), xz.cos(), 0.0, xy.sin(), middle, 0.0, 0.0, last)
}

/// A number of at most `digits` significant digits, as it is printed.
fn rounded(value: f64, digits: usize) -> f64 {
    format!("{value:.*e}", digits - 1).parse().unwrap()
}

#[test]
fn the_printed_factors_and_coefficients_come_back_from_the_printed_inputs() {
    for name in ["ib", "ob"] {
        let sensor = Sensor::new(name);
        let case = Case::new();
        sensor.cycle(&case, None);
        let centre = put(&case, "CENTRE.CPF", &sensor.centre(None).text("01-06-08_09-00-00"));
        let offset = put(&case, "OFFSET.OPF", &sensor.offset(""));
        done(&transfer(&case, &[("--centre", &centre), ("--offset", &offset)]));
        let found = parameters(&case.out().join(TCF));
        says(found["convention"]["omega"].as_str().unwrap(), &["Rosetta"]);
        assert_eq!(number(&found, "reference_degc"), T1);
        // The report cuts some of its k off (0.9995993 is printed as 0.99959) and rounds others: one unit of its last digit.
        close(three(&found, "k"), sensor.printed("k"), 1e-5);
        for row in 0..3 {
            let printed = three(&sensor.document, &format!("{name}.k_matrix_inverse.{row}"));
            close(three(&found, &format!("k_inverse.{row}")), printed, 1e-5);
        }
        for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
            let sigma = |k: usize| number(&found, &format!("sigma_{component}.{k}"));
            assert_eq!(rounded(sigma(0), 6), sensor.printed("sigma_centre_0")[i], "{name} {component}");
            // -8.55e-6 / 0.9992973 = -8.556e-6, which the report cuts off to the value off-centre, -8.55e-6, instead of rounding it.
            let printed = if (name, component) == ("ib", "z") { -8.56e-6 } else { sensor.printed("sigma_centre_1_per_k")[i] };
            assert_eq!(rounded(sigma(1), 3), printed, "{name} {component}");
            let b_off = |k: usize| number(&found, &format!("b_off_{component}.{k}"));
            // Rounding of numbers below a thousand in a few steps.
            assert!((b_off(0) - (sensor.printed("a0_nt")[i] - sensor.printed("b_res_nt")[i])).abs() < 1e-10);
            assert!((b_off(1) - sensor.printed("a1_nt_per_k")[i]).abs() < 1e-12);
        }
        close(three(&found, "residual_field.b_res_ent"), sensor.printed("b_res_nt"), 1e-10);
        // ω⁰(T) by the formula of the report, whose column angles the polynomials ξ⁰ have to be.
        let at = |t: f64| sensor.off_centre(t, None).xi_deg;
        let k_inverse = (q(sensor.centre(None).xi_deg).try_inverse().unwrap() * q(at(T1))).try_inverse().unwrap();
        for t in [-60.0, -12.0, T1, 60.0] {
            let omega = q(at(t)) * k_inverse;
            let angle = |a: usize, b: usize| omega.column(a).normalize().dot(&omega.column(b).normalize()).acos().to_degrees();
            let wanted = [angle(0, 1), angle(0, 2), angle(1, 2)];
            let polynomials: [f64; 3] = std::array::from_fn(|i| {
                let name = ["xi_xy", "xi_xz", "xi_yz"][i];
                number(&found, &format!("{name}.0")) + number(&found, &format!("{name}.1")) * t
            });
            for i in 0..3 {
                let most = number(&found, &format!("xi_remainder_deg.{i}"));
                assert!((polynomials[i] - wanted[i]).abs() <= most + 1e-11, "{t} {polynomials:?} {wanted:?}");
                assert!(most < 1e-6, "{most}");
            }
        }
    }
}

fn std_at(found: &DocumentMut, name: &str, t: f64) -> f64 {
    let c = |i: usize, k: usize| number(found, &format!("covariance.{name}.{i}.{k}"));
    (c(0, 0) + 2.0 * t * c(0, 1) + t * t * c(1, 1)).sqrt()
}

#[test]
fn uncertainties_have_their_closed_forms() {
    let sensor = Sensor::new("ib");
    let case = Case::new();
    let [cycle_std, centre_std, off_std] = [[2e-6, 3e-4], [5e-6, 7e-4], [4e-6, 6e-4]];
    sensor.cycle(&case, Some(cycle_std));
    let centre = put(&case, "CENTRE.CPF", &sensor.centre(Some(centre_std)).text("01-06-08_09-00-00"));
    let off = put(&case, "OFF.CPF", &sensor.off_centre(T1, Some(off_std)).text("01-06-07_09-00-00"));
    let offset = put(&case, "OFFSET.OPF", &sensor.offset("offset_std_ent = [0.3, 0.3, 0.3]\n"));
    let reference = sensor.centre(None).sigma;

    // The values go through the other convention and back, where a sensitivity takes the misalignment times the uncertainty of an angle:
    // 1e-3 of 1.2e-5 rad beside 5e-6, which is 1e-5 of a standard uncertainty, in several terms.
    let second_order = 1e-4;
    // The polynomials stand for the run: at T1 the values are those of the run at the centre, and so is their uncertainty.
    done(&transfer(&case, &[("--centre", &centre), ("--offset", &offset)]));
    let found = parameters(&case.out().join(TCF));
    for name in ["sigma_x", "sigma_y", "sigma_z"] {
        assert!((std_at(&found, name, T1) / centre_std[0] - 1.0).abs() < second_order, "{name}");
    }
    for name in ["xi_xy", "xi_xz", "xi_yz"] {
        assert!((std_at(&found, name, T1) / centre_std[1] - 1.0).abs() < 1e-4, "{name} {}", std_at(&found, name, T1));
    }
    // B_off at T1 is the measured one.
    assert!((std_at(&found, "b_off_x", T1) / 0.3 - 1.0).abs() < 1e-6);
    // Away from it the line may turn, s² / 9000 (T - T1)², and a residual field that is constant in nT follows the sensitivity in readings.
    let followed = {
        let [at, beside] = [T1, T1 + 1.0].map(|degc| sensor.off_centre(degc, None).sigma[0]);
        sensor.printed("b_res_nt")[0] * (beside / at - 1.0)
    };
    let turned = |away: f64| 0.3f64.hypot(away * (0.5 / 9000.0f64.sqrt()).hypot(followed));
    assert!(followed.abs() > 1e-6, "nothing follows");
    for degc in [-60.0, 60.0] {
        assert!((std_at(&found, "b_off_x", degc) / turned(degc - T1) - 1.0).abs() < 1e-6, "{degc}");
    }
    // Equal weights at -60, -30, 0, 30, 60 °C: variance of the line s² (1/5 + T²/9000).
    let line = |std: f64| std * (0.2 + T1 * T1 / 9000.0f64).sqrt();
    let b_res = (line(0.5).powi(2) + 0.09).sqrt();
    assert!((number(&found, "residual_field.b_res_std_ent.0") / b_res - 1.0).abs() < 1e-6);

    // A run of its own: three independent relative variances.
    done(&transfer(&case, &[("--centre", &centre), ("--off-centre", &off)]));
    let found = parameters(&case.out().join(TCF));
    let off_sigma = sensor.off_centre(T1, None).sigma;
    for i in 0..3 {
        let relative = (off_std[0] / off_sigma[i]).hypot(centre_std[0] / reference[i]);
        let k = number(&found, &format!("k.{i}"));
        assert!((number(&found, &format!("k_std.{i}")) / (k * relative) - 1.0).abs() < second_order);
        let sigma = reference[i] * relative.hypot(line(cycle_std[0]) / off_sigma[i]);
        assert!((std_at(&found, ["sigma_x", "sigma_y", "sigma_z"][i], T1) / sigma - 1.0).abs() < second_order);
    }
    // For nearly right angles the elements of K⁻¹ above the diagonal are differences of angles.
    let between = off_std[1].hypot(centre_std[1]).to_radians();
    assert!((number(&found, "k_inverse_std.0.1") / between - 1.0).abs() < 2e-3);
    assert!(found.get("residual_field").is_none() && found.get("b_off_x").is_none());
}

#[test]
fn files_of_polynomials_do_as_well_and_everything_is_verified_and_checked() {
    let sensor = Sensor::new("ob");
    let case = Case::new();
    sensor.cycle(&case, Some([2e-6, 3e-4]));
    // In the folder of the cycle, as it may well lie there; it must not become a run of the cycle.
    let centre = case.put("CENTRE.CPF", sensor.centre(Some([5e-6, 7e-4])).text("01-06-08_09-00-00"));
    let off = put(&case, "OFF.CPF", &sensor.off_centre(T1, Some([5e-6, 7e-4])).text("01-06-07_09-00-00"));
    let named: [(&str, &Path); 2] = [("--centre", &centre), ("--off-centre", &off)];
    done(&transfer(&case, &named));
    let first = parameters(&case.out().join(TCF));
    assert_eq!(first["used"].as_array().unwrap().len(), 5);
    let again = case.path().join("again");
    let mut command = calfit();
    command.arg("thermal").arg(case.out().join(TPF)).arg("-o").arg(&again);
    let output = command.arg("--centre").arg(&centre).arg("--off-centre").arg(&off).output().unwrap();
    done(&output);
    assert_eq!(common::check::numbers(&first), common::check::numbers(&parameters(&again.join(TCF))));
    for file in [case.out().join(TCF), again.join(TCF)] {
        let output = calfit().arg("verify").arg(&file).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let output = calfit().arg("check").arg(&file).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    }
    let output = calfit().arg("thermal").arg(case.out().join(TPF)).arg("-o").arg(&again).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["holds polynomials already", "--centre"]);
}

#[test]
fn what_does_not_belong_together_is_said() {
    let sensor = Sensor::new("ib");
    let case = Case::new();
    sensor.cycle(&case, Some([2e-6, 3e-4]));
    let good = sensor.centre(Some([5e-6, 7e-4]));
    let centre = put(&case, "CENTRE.CPF", &good.text("01-06-08_09-00-00"));
    let warm = put(&case, "WARM.CPF", &sensor.off_centre(T1 + 10.0, Some([5e-6, 7e-4])).text("01-06-07_09-00-00"));
    let messages = done(&transfer(&case, &[("--centre", &centre), ("--off-centre", &warm)]));
    // The steepest slope is that of x: 1.42e-5 / 1.09 per K, 130 ppm in 10 K; of the angles 1.20e-4 degrees per K, 4.32''.
    says(&messages, &["the pair is not at one temperature", "27.39", "17.39", "130.", "4.32''"]);
    let warning = parameters(&case.out().join(TCF))["warnings"].to_string();
    says(&warning, &["not at one temperature"]);
    let near = put(&case, "NEAR.CPF", &sensor.off_centre(T1 + 0.2, Some([5e-6, 7e-4])).text("01-06-07_09-00-00"));
    assert!(!done(&transfer(&case, &[("--centre", &centre), ("--off-centre", &near)])).contains("one temperature"));

    let unsure = put(&case, "UNSURE.CPF", &sensor.centre(None).text("01-06-08_09-00-00"));
    says(&done(&transfer(&case, &[("--centre", &unsure)])), &["the uncertainty of sigma_x, sigma_y, sigma_z, xi_xy"]);
    assert!(parameters(&case.out().join(TCF)).get("k_std").is_none());
    let hot = put(&case, "HOT.CPF", &Linear { degc: Some(90.0), ..good.clone() }.text("01-06-08_09-00-00"));
    says(&done(&transfer(&case, &[("--centre", &hot)])), &["T1 = 90.00 °C lies outside"]);

    let refused = [
        ("COLD.CPF", Linear { degc: None, ..good.clone() }, 1, "COLD.CPF states no sensor temperature"),
        ("OTHER.CPF", Linear { sensor: "ob", ..good.clone() }, 1, "no polynomials are of its sensor `ob`"),
        ("FLAT.CPF", Linear { xi_deg: [10.0, 10.0, 170.0], ..good.clone() }, 2, "no three axes have such angles"),
    ];
    // Angles of no sensor make a file that cannot be read at all.
    for (name, linear, status, message) in refused {
        let path = put(&case, name, &linear.text("01-06-08_09-00-00"));
        let output = transfer(&case, &[("--centre", &path)]);
        assert_eq!(output.status.code(), Some(status), "{name}");
        says(&text(&output.stderr), &[message]);
    }
    let offset = put(&case, "OFFSET.OPF", &sensor.offset(""));
    let output = transfer(&case, &[("--centre", &centre), ("--off-centre", &offset)]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["OFFSET.OPF is no linear calibration (CPF)"]);
}

/// A field in the coils, nT, as readings of a sensor whose axes have the angles ξ between them, enT. Written from the definition: the
/// axes are unit vectors, x along x, y in the plane of x and y; each reads the field along itself over its sensitivity.
fn readings(field_nt: [f64; 3], sigma: [f64; 3], xi_deg: [f64; 3], offset_ent: [f64; 3]) -> [f64; 3] {
    let [xy, xz, yz] = xi_deg.map(f64::to_radians);
    let y = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    let axes = [[1.0, 0.0, 0.0], [xy.cos(), xy.sin(), 0.0], [xz.cos(), y, (1.0 - xz.cos().powi(2) - y * y).sqrt()]];
    let along = |i: usize| (0..3).map(|k| axes[i][k] * field_nt[k]).sum::<f64>();
    std::array::from_fn(|i| along(i) / sigma[i] + offset_ent[i])
}

/// What the table `[apply]` of a file says, word by word.
fn applied(document: &DocumentMut, steps: &[&str], omega: &str, formula: &str) {
    let apply = &document["apply"];
    let found: Vec<&str> = apply["steps"].as_array().unwrap().iter().map(|s| s.as_str().unwrap()).collect();
    assert_eq!(found, steps);
    assert_eq!(apply["omega"].as_str(), Some(omega));
    says(apply["omega_formula"].as_str().unwrap(), &[formula]);
    assert_eq!(apply["offset"]["acts"].as_str(), Some("before the matrix"));
    assert_eq!(apply["offset"]["sign"].as_str(), Some("subtracted"));
    assert_eq!(apply["offset"]["unit"].as_str(), Some("enT"));
}

/// Misalignments of half a degree, wrong by their sign, are 12 nT in 10 000 nT. The modulus does not depend on the frame.
#[test]
fn the_field_comes_back_from_the_files_alone() {
    let sigma = |t: f64| [1.09 - 1.4e-5 * t, 1.094 - 9e-6 * t, 0.98 + 2e-5 * t];
    let xi_deg = |t: f64| [90.5 - 8e-5 * t, 89.4 + 3e-5 * t, 90.6 + 1.2e-4 * t];
    let offset = |t: f64| [114.3 - 0.565 * t, -119.8 + 0.7 * t, 494.0];
    let case = Case::new();
    let sensor = |t: f64, run: &str| {
        let linear = Linear {
            sigma: sigma(t),
            xi_deg: xi_deg(t),
            b_or_ent: offset(t),
            degc: Some(t),
            std: Some([2e-6, 3e-4]),
            sensor: "ib",
        };
        // The angles are those between the sensor axes.
        linear.text(run).replace("\"Rosetta\"", "\"BepiColombo\"")
    };
    for (i, t) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        case.put(&format!("{run}.CPF"), sensor(t, &run));
    }
    let centre = put(&case, "CENTRE.CPF", &sensor(T1, "01-06-08_09-00-00"));
    let b_off: Vec<String> = offset(T1).iter().map(|b| format!("{b:?}")).collect();
    let opf = format!(
        "format = \"OPF\"\nversion = 1\noffset_ent = [{}]\noffset_std_ent = [0.1, 0.1, 0.1]\n[run]\nid = \"01-06-09_09-00-00\"\n\
         sensor = \"ib\"\nmode = \"m\"\ntemperature_degc = {T1:?}\n",
        b_off.join(", ")
    );
    let turned = put(&case, "OFFSET.OPF", &opf);
    done(&transfer(&case, &[("--centre", &centre), ("--offset", &turned)]));
    let tcf = parameters(&case.out().join(TCF));
    let tpf = parameters(&case.out().join(TPF));
    assert_eq!(tcf["version"].as_integer(), Some(2));
    applied(&tcf, &["subtract_offset", "sigma", "omega"], "rosetta", "omega = Q(xi)");
    assert_eq!(tcf["apply"]["offset"]["quantity"].as_str(), Some("b_off"));
    applied(&tpf, &["subtract_offset", "sigma", "omega"], "bepicolombo", "omega = inverse(transpose(Q(xi)))");
    assert_eq!(tpf["apply"]["offset"]["quantity"].as_str(), Some("b_or"));

    let at = |file: &DocumentMut, name: &str, t: f64| number(file, &format!("{name}.0")) + number(file, &format!("{name}.1")) * t;
    let three_at = |file: &DocumentMut, names: [&str; 3], t: f64| names.map(|name| at(file, name, t));
    for t in [-60.0, -25.0, 0.0, T1, 60.0] {
        for field in [
            [10_000.0, 0.0, 0.0],
            [0.0, 10_000.0, 0.0],
            [0.0, 0.0, 10_000.0],
            [5773.5, -5773.5, 5773.5],
            [-3000.0, 9000.0, 3162.0],
        ] {
            let modulus = field.iter().map(|b: &f64| b * b).sum::<f64>().sqrt();
            let raw = readings(field, sigma(t), xi_deg(t), offset(t));
            let calibrated = |file: &DocumentMut, omega: Matrix3<f64>, offset: [&str; 3]| {
                let (s, o) = (three_at(file, ["sigma_x", "sigma_y", "sigma_z"], t), three_at(file, offset, t));
                omega * nalgebra::Vector3::from_fn(|i, _| s[i] * (raw[i] - o[i]))
            };
            let q_of = |file: &DocumentMut| q(three_at(file, ["xi_xy", "xi_xz", "xi_yz"], t));
            // The TPF gives the field itself: its frame is that of the axes above.
            let found = calibrated(&tpf, q_of(&tpf).transpose().try_inverse().unwrap(), ["b_or_x", "b_or_y", "b_or_z"]);
            (0..3).for_each(|i| assert!((found[i] - field[i]).abs() < 1e-6, "TPF at {t}: {found} for {field:?}"));
            // The TCF gives it in the frame of the other convention, to the remainder that it states.
            let found = calibrated(&tcf, q_of(&tcf), ["b_off_x", "b_off_y", "b_off_z"]);
            let remainder: f64 = (0..3)
                .map(|i| {
                    number(&tcf, &format!("xi_remainder_deg.{i}")).to_radians() + number(&tcf, &format!("sigma_remainder.{i}"))
                })
                .sum();
            assert!(
                (found.norm() - modulus).abs() < 2.0 * remainder * modulus + 1e-6,
                "TCF at {t}: {} for {modulus}",
                found.norm()
            );
            assert!(remainder * modulus < 1e-3, "{remainder}");
        }
    }
}

/// The text of a run of the cycle, which says that it was made beside the centre.
fn beside(text: &str) -> String {
    text.replacen("mode = \"m\"\n", "mode = \"m\"\nlocation = \"off-centre\"\n", 1)
}

/// `thermal` on the folder of all files.
fn paired(case: &Case) -> (DocumentMut, String) {
    let messages = done(&transfer(case, &[]));
    (parameters(&case.out().join(TCF)), messages)
}

#[test]
fn files_that_say_where_they_were_made_find_each_other() {
    let sensor = Sensor::new("ib");
    let named = Case::new();
    sensor.cycle(&named, Some([2e-6, 3e-4]));
    let at_centre = sensor.centre(Some([5e-6, 7e-4])).text("01-06-08_09-00-00");
    let turned = sensor.offset("offset_std_ent = [0.3, 0.3, 0.3]\n");
    let (centre, offset) = (put(&named, "CENTRE.CPF", &at_centre), put(&named, "OFFSET.OPF", &turned));
    done(&transfer(&named, &[("--centre", &centre), ("--offset", &offset)]));

    let own = Case::new();
    for (i, degc) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        own.put(&format!("{run}.CPF"), beside(&sensor.off_centre(degc, Some([2e-6, 3e-4])).text(&run)));
    }
    own.put("CENTRE.CPF", &at_centre);
    own.put("OFFSET.OPF", &turned);
    // Another sensor and another mode at the centre are none of its runs.
    own.put("OTHER.CPF", at_centre.replacen("\"ib\"", "\"ob\"", 1).replacen("01-06-08", "01-06-07", 1));
    own.put("MODE.CPF", at_centre.replacen("mode = \"m\"", "mode = \"n\"", 1).replacen("01-06-08", "01-06-06", 1));
    let output = transfer(&own, &[]);
    // The other two are at one temperature and belong to no cycle: told, and no failure.
    assert_eq!(output.status.code(), Some(0));
    says(&text(&output.stderr), &["ob m: its linearity runs (OTHER.CPF)", "ib n: its linearity runs (MODE.CPF)"]);
    let [by_name, by_place] = [&named, &own].map(|case| parameters(&case.out().join(TCF)));
    assert_eq!(common::check::numbers(&by_name), common::check::numbers(&by_place));
    let tpf = parameters(&own.out().join(TPF));
    assert_eq!(tpf["location"].as_str(), Some("off-centre"));
    assert_eq!(tpf["used"].as_array().unwrap().len(), 5);
    for file in [TCF, TPF] {
        let output = calfit().arg("verify").arg(own.out().join(file)).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    }

    // Without a run at the centre the polynomials stay where they are, and that is said.
    for file in ["CENTRE.CPF", "OTHER.CPF", "MODE.CPF", "OFFSET.OPF"] {
        fs::remove_file(own.campaign().join(file)).unwrap();
    }
    fs::remove_file(own.out().join(TCF)).unwrap();
    says(&done(&transfer(&own, &[])), &[TPF, "no linearity run of ib m at the centre"]);
    assert!(!own.out().join(TCF).exists());
}

#[test]
fn several_runs_at_the_centre_count_by_their_uncertainties() {
    let sensor = Sensor::new("ib");
    let case = Case::new();
    for (i, degc) in CYCLE_DEGC.into_iter().enumerate() {
        let run = format!("01-06-0{}_09-00-00", i + 1);
        case.put(&format!("{run}.CPF"), beside(&sensor.off_centre(degc, Some([2e-6, 3e-4])).text(&run)));
    }
    // Two of them agree within their uncertainties, 3e-6 and 4e-6: weights 16 to 9, uncertainty 3 · 4 / 5. The third is warmer.
    let good = sensor.centre(None);
    let run = |shift: f64, std: f64, degc: f64, id: &str| {
        let sigma = good.sigma.map(|s| s + shift);
        Linear { sigma, std: Some([std, 100.0 * std]), degc: Some(degc), ..good.clone() }.text(id)
    };
    case.put("A.CPF", run(9e-7, 3e-6, T1, "01-06-06_09-00-00"));
    case.put("B.CPF", run(-16e-7, 4e-6, T1 + 0.1, "01-06-07_09-00-00"));
    case.put("WARM.CPF", run(1e-3, 3e-6, T1 + 20.0, "01-06-08_09-00-00"));
    // Two centre temperatures make polynomials there as well.
    let (found, _) = paired(&case);
    assert_eq!(found["centre"]["file"].as_str(), Some("A.CPF, B.CPF"));
    assert!((number(&found, "reference_degc") - (T1 + 0.05)).abs() < 1e-12);
    says(&found["warnings"].to_string(), &["WARM.CPF took no part"]);
    for i in 0..3 {
        // The misalignment of 1e-3 carries the mean of the angles into the other convention and back.
        assert!((number(&found, &format!("centre.sigma.{i}")) - good.sigma[i]).abs() < 1e-11);
        assert!((number(&found, &format!("centre.sigma_std.{i}")) / 2.4e-6 - 1.0).abs() < 1e-4);
    }
    assert_eq!(parameters(&case.out().join(TPF))["used"].as_array().unwrap().len(), 5);

    // Runs that scatter by more than that: 9e-6 and -16e-6 differ by 25e-6, which is one standard deviation if 300e-12 is added to the squares of both
    // uncertainties, 9e-12 and 16e-12: they are 309e-12 and 316e-12 then.
    case.put("A.CPF", run(9e-6, 3e-6, T1, "01-06-06_09-00-00"));
    case.put("B.CPF", run(-16e-6, 4e-6, T1, "01-06-07_09-00-00"));
    let (found, _) = paired(&case);
    assert!((number(&found, "centre.sigma_std.0") / (309e-12_f64 * 316e-12 / 625e-12).sqrt() - 1.0).abs() < 1e-4);
}
