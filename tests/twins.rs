//! The twins of CHAMP, March 1998, and Rosetta: the printed numbers that went in come back through the commands.

use crate::common;

use calfit::files::twin::{self, Twin};
use calfit::simulate::write_campaign;
use common::check::{Case, calfit, cpf, number, parameters, says, sigma, text, three};
use nalgebra::Matrix3;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

type Three = [f64; 3];

fn repository(path: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join(path)
}

fn read(name: &str) -> Twin {
    let mut findings = Vec::new();
    let twin = twin::read(&repository(&format!("configs/{name}.toml")), &mut findings).unwrap();
    assert!(findings.is_empty(), "{findings:?}");
    twin
}

/// A campaign of the runs of a twin.
fn simulated(twin: &Twin) -> Case {
    let case = Case::new();
    write_campaign(twin, twin.seed, &case.campaign(), false, || ()).unwrap();
    case
}

/// A command on the campaign; its warnings.
fn done(case: &Case, command: &[&str], facility: bool) -> String {
    let mut call = calfit();
    call.args(command).arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots");
    if facility {
        call.arg("--facility").arg(repository("tests/data/champ/facility.toml"));
    }
    let output = call.output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    text(&output.stderr)
}

fn printed(path: &str) -> DocumentMut {
    std::fs::read_to_string(repository(path)).unwrap().parse().unwrap()
}

/// Value of a polynomial with a coefficient list under `name`, and its standard uncertainty where the file states a covariance.
fn at(file: &DocumentMut, name: &str, degc: f64) -> (f64, f64) {
    let list = |item: &toml_edit::Item| -> Vec<f64> { item.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect() };
    let coefficients = list(&file[name]);
    let powers: Vec<f64> = (0..coefficients.len()).map(|k| degc.powi(k as i32)).collect();
    let value = coefficients.iter().zip(&powers).map(|(c, p)| c * p).sum();
    let cell = |i: usize, j: usize| {
        file["covariance"][name].as_array().unwrap().get(i).unwrap().as_array().unwrap().get(j).unwrap().as_float().unwrap()
    };
    let variance: f64 = (0..powers.len())
        .flat_map(|i| (0..powers.len()).map(move |j| (i, j)))
        .map(|(i, j)| powers[i] * cell(i, j) * powers[j])
        .sum();
    (value, variance.sqrt())
}

#[track_caller]
fn near(what: &str, found: f64, wanted: f64, most: f64) {
    assert!((found - wanted).abs() < most, "{what}: {found} is not {wanted} within {most}");
}

/// Sensitivities of the second thermal cycle, figure 8-10.
const CHAMP_SIGMA: [Three; 3] = [
    [0.99951080, -2.9848009e-05, -3.5301105e-08],
    [1.0023193, -3.0604868e-05, -3.6868521e-08],
    [0.99989731, -3.0735406e-05, -3.9794076e-08],
];
/// Angles of the second thermal cycle, figure 8-12.
const CHAMP_XI_DEG: [Three; 3] = [
    [89.974283, 2.6189937e-06, -7.8158079e-08],
    [89.937707, -1.3656065e-05, -1.0217733e-07],
    [89.960619, 2.3074083e-06, 1.9621062e-08],
];

fn polynomial(coefficients: &Three, degc: f64) -> f64 {
    coefficients[0] + degc * (coefficients[1] + degc * coefficients[2])
}

#[test]
fn the_feedback_coils_of_champ_lie_between_the_two_thermistors() {
    let mut champ = read("champ-1998");
    champ.runs.retain(|run| run.id == "98-03-26_13-01-00");
    // Cooling and the begin of the recovery: both branches.
    champ.runs[0].longest_s = Some(8.0 * 3600.0);
    let case = simulated(&champ);
    done(&case, &["thermal"], true);
    let file = parameters(&case.out().join("98-03-26_13-01-00/THERMAL_PARAMETER__98-03-26-13-01-00.TPF"));
    let lags = file["sweep"]["lag"].as_array_of_tables().unwrap();
    assert_eq!(lags.len(), 2);
    // Section 8: 8 min behind T_CSC, 8 min ahead of T_sens. The twin's lags are time constants; where a temperature decays with H, a time
    // constant τ is a delay of -H ln(1 - τ/H), 8.1 and 8.7 min here.
    for (channel, minutes) in [("T_CSC", 8.0), ("T_SENS", -8.0)] {
        let part = lags.iter().find(|p| p["channel"].as_str() == Some(channel)).unwrap();
        for key in ["time_constant_s", "delay_s"] {
            near(&format!("{channel} {key}"), part[key].as_float().unwrap() / 60.0, minutes, 1.0);
        }
    }
    for degc in [-40.0, -20.0, -10.0] {
        for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
            let (value, std) = at(&file, &format!("sigma_{axis}"), degc);
            near(&format!("sigma_{axis} at {degc}"), value, polynomial(&CHAMP_SIGMA[i], degc), 3.5 * std);
        }
    }
}

/// Coefficients of the coil system, section 6.
const SCALE: Three = [0.99988, 0.99993, 0.99994];
const SCALE_PER_K: Three = [1.90e-5, 1.65e-5, 1.75e-5];
const RACK_SCALE_PER_K: f64 = -8e-7;
const OFFSET_PER_K: Three = [0.35, 0.0, 0.80];
const RACK_OFFSET_PER_K: Three = [0.075, 0.0, 0.2];

/// Temperature coefficients of the scalar calibrations of a campaign against the printed ones, in three standard uncertainties.
fn coefficients(case: &Case, axes: &[usize]) -> (DocumentMut, String) {
    let warnings = done(case, &["coil", "scalar"], false);
    let file = parameters(&case.out().join("COIL_SCALAR__98-03-23_10-49-00.toml"));
    let compare = |key: &str, wanted: Three, axes: &[usize]| {
        let (found, std) = (three(&file, &format!("facility.{key}")), three(&file, &format!("std.{key}")));
        axes.iter().for_each(|k| near(&format!("{key} {k}"), found[*k], wanted[*k], 3.0 * std[*k]));
    };
    compare("scale_per_k", SCALE_PER_K, &[0, 1, 2]);
    compare("rack_scale_per_k", [RACK_SCALE_PER_K; 3], &[0, 1, 2]);
    compare("offset_nt_per_k", OFFSET_PER_K, axes);
    compare("rack_offset_nt_per_k", RACK_OFFSET_PER_K, axes);
    (file, warnings)
}

#[test]
fn four_scalar_calibrations_give_the_printed_temperature_coefficients() {
    let mut champ = read("champ-1998");
    champ.runs.retain(|run| champ.programmes[run.programme].name == "SCALAR_83.MAG");
    assert_eq!(champ.runs.len(), 4);
    // The offset field of Y changed between the second and the third: a step, and no coefficient.
    let (file, warnings) = coefficients(&simulated(&champ), &[0, 1, 2]);
    says(&warnings, &["the offset field of Y stepped between the calibrations 98-03-23_11-44-00 and 98-03-25_12-24-00"]);
    assert_eq!(file["step"].as_array_of_tables().unwrap().len(), 1, "{}", file["step"]);
    for (place, wanted_nt) in [(0, -2.2), (1, -4.4)] {
        let of = |table: &str| {
            file["period"][place].get(table).map_or(&file["period"][place], |t| t)["offset_nt"][1].as_float().unwrap()
        };
        near("offset of Y", of("facility"), wanted_nt, 3.5 * of("std"));
    }
    let scale_std = three(&file, "std.scale_per_k");
    assert!(scale_std.iter().zip(SCALE_PER_K).all(|(std, value)| *std < 0.25 * value), "{scale_std:?}");

    // Without that change and with a quiet source the small coefficients of the rack are significant, too.
    champ.facility.residual.clear();
    champ.facility.setting_scatter_nt = [0.0; 3];
    let (file, warnings) = coefficients(&simulated(&champ), &[0, 1, 2]);
    assert!(!warnings.contains("FIT"), "{warnings}");
    let rack_std = three(&file, "std.rack_scale_per_k");
    assert!(rack_std.iter().all(|std| *std < -0.25 * RACK_SCALE_PER_K), "{rack_std:?}");
    let [coil_k, rack_k] =
        [number(&file, "facility.reference_degc") - 16.5, number(&file, "facility.rack_reference_degc") - 32.0];
    let (found, std) = (three(&file, "facility.scale_nt_per_eu"), three(&file, "std.scale_nt_per_eu"));
    for k in 0..3 {
        let wanted = SCALE[k] * (1.0 + SCALE_PER_K[k] * coil_k) * (1.0 + RACK_SCALE_PER_K * rack_k);
        near(&format!("scale {k}"), found[k], wanted, 3.0 * std[k]);
    }
}

#[test]
fn champ_is_the_same_sensor_in_four_orientations_in_the_field_of_the_facility() {
    let mut champ = read("champ-1998");
    let runs = ["98-03-23_18-02-00", "98-03-23_21-12-00", "98-03-24_07-53-00", "98-03-27_09-21-00"];
    champ.runs.retain(|run| runs.contains(&run.id.as_str()));
    let case = simulated(&champ);
    done(&case, &["lin"], true);
    for run in runs {
        let file = cpf(&case.out(), run);
        let (found, std) = (sigma(&file), three(&file, "std.sigma"));
        let degc = number(&file, "run.temperature_degc");
        for i in 0..3 {
            // A tenth of a kelvin of the coils is 1.9e-6.
            near(&format!("{run} sigma {i}"), found[i], polynomial(&CHAMP_SIGMA[i], degc), 4.0 * std[i] + 1.9e-6);
            let (key, std) = (["xi_xy", "xi_xz", "xi_yz"][i], three(&file, "std.xi_deg")[i]);
            near(
                &format!("{run} {key}"),
                number(&file, &format!("angle_deg.{key}")),
                polynomial(&CHAMP_XI_DEG[i], degc),
                4.0 * std,
            );
        }
    }
    // Settings taken as fields are wrong by the scale factors of the coils, another one for X_m in another orientation.
    done(&case, &["lin", "--force"], false);
    let x: Vec<f64> = runs.iter().map(|run| sigma(&cpf(&case.out(), run))[0]).collect();
    near("sigma_x along east less along north", x[1] - x[0], SCALE[1].recip() - SCALE[0].recip(), 1e-5);
}

/// Sensitivities and angles in the form of Rosetta: lengths of the columns of ω σ, and the angles between them, from those of the
/// sensor axes, which are the rows of its inverse (section 3.2.1).
fn rosetta(sigma: Three, xi_deg: Three) -> (Three, Three) {
    let [xy, xz, yz] = xi_deg.map(f64::to_radians);
    let y = (yz.cos() - xy.cos() * xz.cos()) / xy.sin();
    let axes = Matrix3::new(1.0, 0.0, 0.0, xy.cos(), xy.sin(), 0.0, xz.cos(), y, (xz.sin().powi(2) - y * y).sqrt());
    let rows = Matrix3::from_fn(|r, c| axes[(r, c)] / sigma[r]);
    let columns = rows.try_inverse().unwrap();
    let angle = |a: usize, b: usize| columns.column(a).angle(&columns.column(b)).to_degrees();
    (std::array::from_fn(|i| columns.column(i).norm()), [angle(0, 1), angle(0, 2), angle(1, 2)])
}

/// Reference temperature, section 3.3.1.2.
const T1_DEGC: f64 = 17.39;

#[test]
fn rosetta_runs_through_lin_offset_and_thermal() {
    let case = simulated(&read("rosetta-ground"));
    for command in ["lin", "offset", "thermal"] {
        let warnings = done(&case, &[command], false);
        assert!(!warnings.contains("AXES") && !warnings.contains("error"), "{warnings}");
    }
    let printed = printed("tests/data/rosetta/ground_calibration.toml");
    for (sensor, day) in [("ib", "11"), ("ob", "13")] {
        let of = |key: &str| three(&printed, &format!("{sensor}.{key}"));
        let (a0, a1, b_res) = (of("a0_nt"), of("a1_nt_per_k"), of("b_res_nt"));
        let centre = cpf(&case.out(), &format!("01-06-{day}_07-00-00"));
        let std = (three(&centre, "std.sigma"), three(&centre, "std.xi_deg"));
        let angles = ["xi_xy", "xi_xz", "xi_yz"];
        let (at_centre, xi) = rosetta(sigma(&centre), angles.map(|key| number(&centre, &format!("angle_deg.{key}"))));
        let opf = parameters(&case.out().join(format!("01-06-{day}_07-35-00/OFF_PARAMETER__01-06-{day}-07-35-00.OPF")));
        let (coil_nt, coil_std_nt) = (three(&opf, "residual_coil_nt"), three(&opf, "residual_coil_std_nt"));
        for i in 0..3 {
            // Sensitivities are printed to 1e-5, angles to 1e-4 degrees, each in two places.
            near(&format!("{sensor} sigma {i} at the centre"), at_centre[i], of("sigma_reference")[i], 4.0 * std.0[i] + 1e-5);
            near(&format!("{sensor} xi {i} at the centre"), xi[i], of("xi_reference_deg")[i], 4.0 * std.1[i] + 1e-4);
            let (found, std) = (three(&opf, "offset_ent")[i], three(&opf, "offset_std_ent")[i]);
            near(&format!("{sensor} offset {i}"), found, a0[i] + a1[i] * T1_DEGC - b_res[i], 4.0 * std);
            // The residual field as the sensor shows it: ω σ is upper triangular, with the printed angles off the diagonal.
            let cos = |k: usize| of("xi_reference_deg")[k].to_radians().cos();
            let s = of("sigma_reference");
            let field = [
                s[0] * b_res[0] + s[1] * cos(0) * b_res[1] + s[2] * cos(1) * b_res[2],
                s[1] * b_res[1] + s[2] * cos(2) * b_res[2],
                s[2] * b_res[2],
            ];
            near(&format!("{sensor} residual field {i}"), coil_nt[i], field[i], 4.0 * coil_std_nt[i]);
        }

        // At the centre, from the polynomials beside it and the two runs there, which find each other by their places.
        let tcf = parameters(&case.out().join(format!("THERMAL_CENTRE_PARAMETER__01-06-{day}-09-00-00.TCF")));
        for i in 0..3 {
            // k is cut off to 1e-5, K is printed to 1e-5.
            near(&format!("{sensor} k {i}"), three(&tcf, "k")[i], of("k")[i], 4.0 * three(&tcf, "k_std")[i] + 1e-5);
            for c in 0..3 {
                let [found, wanted, std] = ["k_inverse", "k_matrix_inverse", "k_inverse_std"].map(|key| {
                    if key == "k_matrix_inverse" {
                        three(&printed, &format!("{sensor}.{key}.{i}"))[c]
                    } else {
                        three(&tcf, &format!("{key}.{i}"))[c]
                    }
                });
                near(&format!("{sensor} K inverse {i} {c}"), found, wanted, 4.0 * std + 1e-5);
            }
            for degc in [-55.0, T1_DEGC, 100.0] {
                let (value, std) = at(&tcf, ["sigma_x", "sigma_y", "sigma_z"][i], degc);
                let wanted = of("sigma_centre_0")[i] + of("sigma_centre_1_per_k")[i] * degc;
                near(&format!("{sensor} sigma {i} at the centre at {degc}"), value, wanted, 4.0 * std + 1e-5);
            }
            // The residual field as the sensor reads it beside the centre, up to the variation that is left, as below.
            let (b_res_ent, std) = (three(&tcf, "residual_field.b_res_ent")[i], three(&tcf, "residual_field.b_res_std_ent")[i]);
            near(&format!("{sensor} B_res {i}"), b_res_ent, b_res[i], 4.0 * std + 0.035);
        }

        let file = parameters(&case.out().join(format!("THERMAL_PARAMETER__01-06-{day}-09-00-00.TPF")));
        assert_eq!(file["used"].as_array().unwrap().len(), 6);
        for degc in [-55.0, T1_DEGC, 100.0] {
            let three_at = |names: [&str; 3]| names.map(|name| at(&file, name, degc));
            let (sigmas, xis) = (three_at(["sigma_x", "sigma_y", "sigma_z"]), three_at(angles));
            let (found, xi) = rosetta(sigmas.map(|v| v.0), xis.map(|v| v.0));
            for i in 0..3 {
                let line = |constant: &str, slope: &str| of(constant)[i] + of(slope)[i] * degc;
                let what = |name: &str| format!("{sensor} {name} {i} at {degc}");
                // Printed slopes have two or three digits, which the twin takes from the same place.
                near(&what("sigma"), found[i], line("sigma_off_centre_0", "sigma_off_centre_1_per_k"), 4.0 * sigmas[i].1);
                near(&what("xi"), xi[i], line("xi_off_centre_0_deg", "xi_off_centre_1_deg_per_k"), 4.0 * xis[i].1);
                // Section 3.2.2.1, first method. Beside the centre the residual field reads 8e-4 of 20 enT differently, and up to 35 nT of
                // variation leave 5e-4 of themselves.
                let (b_or, b_or_std) = at(&file, ["b_or_x", "b_or_y", "b_or_z"][i], degc);
                near(&what("offset"), b_or, a0[i] + a1[i] * degc, 4.0 * b_or_std + 0.035);
                if degc == T1_DEGC {
                    near(&what("k"), found[i] / at_centre[i], of("k")[i], 4.0 * sigmas[i].1.hypot(std.0[i]) + 1e-5);
                }
            }
        }
    }
}

#[test]
fn the_report_of_rosetta_ends_with_ground_calibration_files() {
    let mut twin = read("rosetta-ground");
    // The first sensor has a thermistor, the printed cubic 1.5 degrees below a reference thermometer, and both have a reference cube.
    twin.campaign_toml.push_str(
        "\n[[thermistor]]\nsensor = \"FM-IB\"\ntable = \"tables/ib.csv\"\nreference = \"tables/beside.csv\"\norder = 3\n\
         [[reference]]\nsensor = \"FM-IB\"\nrotation = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]\nstd_deg = 0.01\n\
         convention = \"rosetta\"\n",
    );
    let case = simulated(&twin);
    let cubic = |u: f64| -368.61072 + u * (458.49304 + u * (-356.0289 + u * 180.00644));
    let table = |head: &str, shift: f64| -> String {
        let rows: String =
            (0..12).map(|i| 0.9 + 0.05 * f64::from(i)).map(|u| format!("{:?},{u:?}\n", cubic(u) + shift)).collect();
        format!("{head},u_volt\n{rows}")
    };
    case.put("tables/ib.csv", table("t_degc", 0.0));
    case.put("tables/beside.csv", table("reference_degc", 1.5));
    let messages = done(&case, &["report"], false);
    assert!(!messages.contains("error"), "{messages}");
    let lacking = ["there is no ground calibration file of FM-OB burst", "T_0 to T_3 and T_OFF lack a THERMISTOR file"];
    says(&messages, &lacking);
    let protocol = std::fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(&protocol, &["Calibration at the centre of the coil system", "RPCMAG_GND_CALIB_FM-IB.TXT", "FM-OB burst, off-centre"]);
    says(&protocol, &lacking);
    assert!(!protocol.contains("failed or were refused") && !protocol.contains("No polynomials"));
    assert!(!case.out().join("RPCMAG_GND_CALIB_FM-OB.TXT").exists());

    let path = case.out().join("RPCMAG_GND_CALIB_FM-IB.TXT");
    let (ground, _) = calfit::files::export::rpcmag::read(&path, &mut Vec::new()).unwrap();
    let printed = printed("tests/data/rosetta/ground_calibration.toml");
    let of = |key: &str| three(&printed, &format!("ib.{key}"));
    let std = |label: &str| -> Three { ground.std[label].clone().try_into().unwrap() };
    for i in 0..3 {
        near("A_0", ground.a[0][i], of("a0_nt")[i], 4.0 * std("A_0")[i] + 0.035);
        near("A_1", ground.a[1][i], of("a1_nt_per_k")[i], 4.0 * std("A_1")[i] + 0.035 / 55.0);
        near("B_RES", ground.b_res_ent[i], of("b_res_nt")[i], 4.0 * std("B_RES")[i] + 0.035);
        near("SIGMA_00", ground.sigma[0][i], of("sigma_centre_0")[i], 4.0 * std("SIGMA_00")[i] + 1e-5);
        near("SIGMA_01", ground.sigma[1][i], of("sigma_centre_1_per_k")[i], 4.0 * std("SIGMA_01")[i] + 1e-8);
        near("XI_10", ground.xi[0][i], of("xi_off_centre_0_deg")[i], 4.0 * std("XI_10")[i] + 1e-4);
        near("XI_11", ground.xi[1][i], of("xi_off_centre_1_deg_per_k")[i], 4.0 * std("XI_11")[i] + 1e-6);
    }
    near("T_3", ground.thermistor[3], 180.00644, 1e-6);
    near("T_OFF", ground.t_off_degc, -1.5, 1e-9);
    // It was stated for the sensor frame of the file, and is carried as it is; the file of a run has the other frame.
    let stated = [[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
    let reference = ground.reference.unwrap();
    let most = |rows: [Three; 3]| (0..9).map(|i| (rows[i / 3][i % 3] - stated[i / 3][i % 3]).abs()).fold(0.0, f64::max);
    assert!(most(reference.rotation) < 1e-12 && reference.std_deg == 0.01, "{reference:?}");
    let run = cpf(&case.out(), "01-06-11_07-00-00");
    // Between the frames lie misalignments of some hundredths of a degree.
    let apart = most(std::array::from_fn(|r| three(&run, &format!("reference.rotation.{r}"))));
    assert!((1e-5..1e-2).contains(&apart), "{apart}");
    assert!(cpf(&case.out(), "01-06-13_07-00-00").get("reference").is_none());
    // The offset at the centre is scaled with the run at the centre.
    let opf = parameters(&case.out().join("01-06-11_07-35-00/OFF_PARAMETER__01-06-11-07-35-00.OPF"));
    says(&opf.to_string(), &["PARAMETER_LIN__01-06-11_07-00-00.CPF"]);

    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
    let checked = calfit().arg("check").arg(&path).arg(case.campaign()).output().unwrap();
    assert_eq!(checked.status.code(), Some(0), "{}", text(&checked.stderr));
}

#[test]
fn champ_has_no_polynomials_across_runs_and_nothing_failed() {
    let mut champ = read("champ-1998");
    // Linearity runs at one temperature and a sweep; the campaign takes its polynomials from the sweeps alone.
    let kept = ["98-03-23_18-02-00", "98-03-23_21-12-00", "98-03-26_13-01-00"];
    champ.runs.retain(|run| kept.contains(&run.id.as_str()));
    champ.runs[2].longest_s = Some(3.0 * 3600.0);
    let case = simulated(&champ);
    let anew = || std::fs::remove_dir_all(case.out()).unwrap();
    for (i, command) in ["thermal", "report"].into_iter().enumerate() {
        (i > 0).then(anew);
        let messages = done(&case, &[command], false);
        assert!(!messages.contains("no sensor temperature") && !messages.contains("error"), "{messages}");
    }
    assert!(case.out().join("98-03-26_13-01-00/THERMAL_PARAMETER__98-03-26-13-01-00.TPF").is_file());
    // Without that instruction, runs at one temperature are no failure of a report, which nobody asked for polynomials through them.
    let toml = std::fs::read_to_string(case.campaign().join("campaign.toml")).unwrap();
    case.put("campaign.toml", toml.replace("runs = []\n", ""));
    anew();
    let messages = done(&case, &["report"], false);
    assert!(!messages.contains("error"), "{messages}");
    let protocol = std::fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(&protocol, &["No polynomials: CSC1 EM electronics: its linearity runs", "at 1 different temperature"]);
}
