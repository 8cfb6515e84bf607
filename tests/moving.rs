//! Runs during which the temperature of the sensor moves (docs/mathematics.md, "Temperature"): the parameters hold at the stated
//! temperature within their uncertainties, whether polynomials tell the slopes or the run itself, and what cannot be known is refused.

use crate::common;

use calfit::data::run::Kind;
use calfit::files::twin::{self, Approach, Phase, Twin};
use calfit::simulate::write_campaign;
use common::check::{Case, calfit, number, parameters, says, sigma, text, three};
use rayon::prelude::*;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

/// Seeds of the simulated campaigns.
const SEEDS: [u64; 3] = [1, 2, 3];
/// Runs of the campaign during which the sensor moves, by 7 to 51 K.
const MOVING: usize = 21;

/// A twin of `configs`.
fn read(name: &str) -> Twin {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs").join(name);
    twin::read(&path, &mut Vec::new()).unwrap()
}

/// The linearity runs of April 2013, of two sensors in two modes each.
fn april() -> Twin {
    let mut twin = read("magnetsrode-2013.toml");
    let programmes = twin.programmes.clone();
    twin.runs.retain(|run| programmes[run.programme].kind == Kind::Linearity);
    twin
}

/// Polynomials of BC-MAG-TR-0085 section 12, which the twin has as truth, σ in nT/enT and ξ in degrees: of BS_11 and BS_10 in science mode,
/// and of both in open loop.
const TRUTH: [(&str, &str, [&[f64]; 6]); 4] = [
    (
        "BS_11",
        "science mode 0",
        [
            &[0.972692, -1.801800e-05],
            &[0.99642, -1.566740e-05],
            &[0.989066, -1.968160e-05],
            &[89.789, -1.794800e-05],
            &[90.056, 4.547300e-05],
            &[90.013, -0.00011504],
        ],
    ),
    (
        "BS_11",
        "cal mode 4, open loop",
        [
            &[0.997312, 0.000841537, -2.340260e-06],
            &[1.01904, 0.000992588, -2.217680e-06],
            &[0.981879, 0.00066373, -1.408620e-06],
            &[90.578, 0.0014757, -5.183400e-06],
            &[89.782, -0.00040098, 2.533900e-06],
            &[90.109, -0.00048477, 5.573600e-07],
        ],
    ),
    (
        "BS_10",
        "science mode 0",
        [
            &[0.975788, -1.596950e-05],
            &[0.988057, -1.440240e-05],
            &[0.985916, -1.771120e-05],
            &[89.575, 5.894600e-05],
            &[89.942, 4.106100e-05],
            &[90.345, -1.651400e-05],
        ],
    ),
    (
        "BS_10",
        "cal mode 4, open loop",
        [
            &[1.01127, 0.00113608],
            &[1.02445, 0.00139015],
            &[0.974889, 0.000476147],
            &[90.177, 0.0010107],
            &[89.516, -0.00048192],
            &[90.554, -0.0017089],
        ],
    ),
];

/// The polynomials of the sensor and mode of a file.
fn truth(file: &DocumentMut) -> [&'static [f64]; 6] {
    let of = |key: &str| file["run"][key].as_str().unwrap().to_owned();
    let (sensor, mode) = (of("sensor"), of("mode"));
    TRUTH.iter().find(|(s, m, _)| (*s, *m) == (sensor.as_str(), mode.as_str())).unwrap().2
}

fn folder(case: &Case, run: &str) -> PathBuf {
    case.out().join(run)
}

/// Files of all runs whose names begin like this.
fn files(case: &Case, begin: &str) -> Vec<DocumentMut> {
    let mut runs: Vec<PathBuf> =
        std::fs::read_dir(case.out()).unwrap().map(|e| e.unwrap().path()).filter(|p| p.is_dir()).collect();
    runs.sort();
    let own = |run: &PathBuf| {
        let id = run.file_name().unwrap().to_string_lossy().into_owned();
        Some(run.join(format!("{begin}__{id}.CPF"))).filter(|p| p.is_file())
    };
    runs.iter().filter_map(own).map(|path| parameters(&path)).collect()
}

/// Sensitivities and angles minus the truth at the stated temperature, over their standard uncertainties.
fn pulls(file: &DocumentMut) -> [f64; 6] {
    let degc = number(file, "run.temperature_degc");
    let values = [sigma(file), ["xi_xy", "xi_xz", "xi_yz"].map(|k| number(file, &format!("angle_deg.{k}")))].concat();
    let std = [three(file, "std.sigma"), three(file, "std.xi_deg")].concat();
    let at = |coefficients: &[f64]| coefficients.iter().rev().fold(0.0, |sum, c| sum * degc + c);
    let truth = truth(file);
    std::array::from_fn(|i| (values[i] - at(truth[i])) / std[i])
}

fn is_moving(file: &DocumentMut) -> bool {
    file.get("conditions").and_then(|c| c.get("sensor_range_k")).is_some()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

#[test]
fn moving_runs_hold_within_their_uncertainties() {
    let twin = april();
    let campaigns: Vec<Case> = SEEDS
        .par_iter()
        .map(|seed| {
            let case = Case::new();
            write_campaign(&twin, *seed, &case.campaign(), false, || ()).unwrap();
            let output =
                calfit().arg("report").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
            // Some runs check an axis only, and are refused.
            assert!(output.status.code().unwrap() <= 1, "{}", text(&output.stderr));
            case
        })
        .collect();
    // With the polynomials of their group.
    let templin: Vec<DocumentMut> = campaigns.iter().flat_map(|case| files(case, "PARAMETER_TEMPLIN")).collect();
    let moving: Vec<&DocumentMut> = templin.iter().filter(|f| is_moving(f)).collect();
    assert_eq!(moving.len(), MOVING * SEEDS.len());
    let all: Vec<f64> = moving.iter().flat_map(|f| pulls(f)).collect();
    assert!((0.85..=1.15).contains(&rms(&all)), "{}", rms(&all));
    assert!(all.iter().all(|p| p.abs() < 5.0));
    // Their uncertainty is hardly wider than that of runs at rest.
    let mean = |of: &[&DocumentMut]| of.iter().map(|f| three(f, "std.sigma")[0]).sum::<f64>() / of.len() as f64;
    let steady: Vec<&DocumentMut> = templin.iter().filter(|f| !is_moving(f)).collect();
    assert!(mean(&moving) < 1.5 * mean(&steady), "{} {}", mean(&moving), mean(&steady));
    for file in &moving {
        assert!(file["slopes"]["source"].as_str().unwrap().ends_with(".TPF"));
        says(&file["warnings"].to_string(), &["temperature", "moved"]);
        let [low, high] = [0, 1].map(|i| number(file, &format!("valid.temperature_degc.{i}")));
        assert!(high - low <= 1.0 + 1e-9);
    }

    // By themselves, where the run tells the slopes: as true, and wider.
    let alone: Vec<DocumentMut> = campaigns.iter().flat_map(|case| files(case, "PARAMETER_LIN")).collect();
    let moving: Vec<&DocumentMut> = alone.iter().filter(|f| is_moving(f)).collect();
    assert_eq!(moving.len(), MOVING * SEEDS.len());
    let all: Vec<f64> = moving.iter().flat_map(|f| pulls(f)).collect();
    assert!((0.85..=1.15).contains(&rms(&all)), "{}", rms(&all));
    assert!(moving.iter().all(|f| f["slopes"]["source"].as_str() == Some("run")));
    assert!(mean(&moving) > 2.0 * mean(&steady));
    // A file is made again from what it states, the polynomials among it.
    let case = &campaigns[0];
    let name = "PARAMETER_TEMPLIN__13-04-03_10-15-00.CPF";
    let file = folder(case, "13-04-03_10-15-00").join(name);
    let output = calfit().arg("verify").arg(&file).arg(case.campaign()).output().unwrap();
    says(&text(&output.stdout), &[&format!("{name}: verified")]);
}

#[test]
fn the_report_has_the_files_of_the_runs_alone_beside_those_of_their_group() {
    let mut twin = april();
    twin.runs.retain(|run| run.sensor == 0);
    let case = Case::new();
    write_campaign(&twin, 7, &case.campaign(), false, || ()).unwrap();
    let output = calfit().arg("report").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let id = "13-04-03_10-15-00";
    let [alone, group] =
        ["PARAMETER_LIN", "PARAMETER_TEMPLIN"].map(|begin| parameters(&folder(&case, id).join(format!("{begin}__{id}.CPF"))));
    assert_eq!(alone["slopes"]["source"].as_str(), Some("run"));
    assert_eq!(group["slopes"]["source"].as_str(), Some("THERMAL_PARAMETER__13-04-03-09-22-38.TPF"));
    assert!(three(&group, "std.sigma")[0] < three(&alone, "std.sigma")[0]);
    // The protocol speaks of the file of the group.
    let protocol = std::fs::read_to_string(case.out().join("REPORT.md")).unwrap();
    says(&protocol, &["sensor temperature moved by", "PARAMETER_TEMPLIN__13-04-03_10-15-00.CPF"]);
    let output = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
}

/// A run of nine plateaus, each axis driven to +1000 and -1000 nT once, whose temperature goes from 10 °C to another; an orthogonal sensor
/// with sensitivities of `1 + 2e-5 (T - 10)` nT/enT and an offset of 5 enT.
fn short_run(to_degc: f64) -> String {
    let fields =
        [[0.0; 3], [1e3, 0.0, 0.0], [-1e3, 0.0, 0.0], [0.0; 3], [0.0, 1e3, 0.0], [0.0, -1e3, 0.0], [0.0; 3], [0.0, 0.0, 1e3]];
    let fields = [fields.as_slice(), &[[0.0, 0.0, -1e3]]].concat();
    let degc = |t_s: f64| 10.0 + (to_degc - 10.0) * t_s / 540.0;
    let mut blocks = String::new();
    for (i, field) in fields.iter().enumerate() {
        let (begin, end) = (60.0 * i as f64, 60.0 * i as f64 + 60.0);
        let sigma = 1.0 + 2e-5 * (degc(0.5 * (begin + end)) - 10.0);
        // A scatter of some thousandths of an enT, different in every row.
        let read = |a: usize| field[a] / sigma + 5.0 + 3e-3 * ((7 * i + 3 * a) as f64).sin();
        let [x, y, z] = [read(0), read(1), read(2)];
        blocks.push_str(&format!("{begin},{end},{},{},{},1,{x},{y},{z}\n", field[0], field[1], field[2]));
    }
    let temperatures: String = (0..=54).map(|k| format!("{},{},20\n", 10 * k, degc(f64::from(10 * k)))).collect();
    format!(
        "CCR 1\nrun = \"26-01-01_00-00-00\"\nstart = \"2026-01-01T00:00:00Z\"\nkind = \"linearity\"\nsensor = \"S\"\nmode = \"m\"\n\
         sample_rate = 10.0\nunit = \"enT\"\n@BLOCKS\nt_start,t_end,bx,by,bz,position,x,y,z\n{blocks}@TEMPERATURES\nt,T59,T29\n\
         {temperatures}@END\n"
    )
}

const ID: &str = "26-01-01_00-00-00";

#[test]
fn slopes_that_the_programme_does_not_determine_need_a_bound() {
    let case = Case::new();
    case.put("26-01-01/00-00-00.CCR", short_run(22.0));
    let lin = || calfit().arg("lin").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
    let output = lin();
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["the sensor temperature moves by", "slope_sigma", "--temperature TPF"]);

    let bound = |quantity: &str, std: f64, unit: &str| {
        format!("[[uncertainty]]\nquantity = \"{quantity}\"\nstd = {std}\nunit = \"{unit}\"\nsource = \"type test\"\n")
    };
    case.put("campaign.toml", bound("slope_sigma", 2e-5, "nT/enT/K") + &bound("slope_xi", 1e-4, "deg/K"));
    let output = lin();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let file = parameters(&folder(&case, ID).join(format!("PARAMETER_LIN__{ID}.CPF")));
    assert_eq!(file["slopes"]["source"].as_str(), Some("bound"));
    // The x axis is driven around 120 s, at 12.67 °C, and its sensitivity is asked for at 16 °C: the bound times that distance.
    let std = three(&file, "std.sigma");
    let far = [3.33, 0.67, -4.67].map(|k: f64| (2e-5 * k).abs());
    for i in 0..3 {
        assert!(std[i] > 0.9 * far[i], "{std:?}");
        assert!((sigma(&file)[i] - (1.0 + 2e-5 * 6.0)).abs() < 3.0 * std[i], "{:?} {std:?}", sigma(&file));
    }

    // A unit that is not that of the quantity is refused with its place.
    case.put("campaign.toml", bound("slope_sigma", 2e-5, "deg/K"));
    let output = lin();
    assert_eq!(output.status.code(), Some(2));
    says(&text(&output.stderr), &["campaign.toml:4", "nT/enT/K"]);
}

/// A value with a standard uncertainty and a bound about zero are two measurements of one thing: nearer to zero, and at least as certain as their
/// weighted mean; those of the other components add to it where they have something in common.
#[test]
fn a_bound_of_the_slope_of_the_offset_is_a_measurement_of_it() {
    let bound = |quantity: &str, std: f64, unit: &str| {
        format!("[[uncertainty]]\nquantity = \"{quantity}\"\nstd = {std}\nunit = \"{unit}\"\nsource = \"type test\"\n")
    };
    let weighed = |free: &DocumentMut, held: &DocumentMut, bound: f64| {
        let slopes = |file: &DocumentMut| (three(file, "slopes.b_or_ent"), three(file, "slopes.std.b_or_ent"));
        let ((value, std), (moved, held_std)) = (slopes(free), slopes(held));
        for a in 0..3 {
            let weighed_std = bound * std[a] / bound.hypot(std[a]);
            assert!(held_std[a] <= weighed_std * (1.0 + 1e-9), "{a}: {} {weighed_std}", held_std[a]);
            assert!(moved[a].abs() < value[a].abs(), "{a}: {} {}", moved[a], value[a]);
        }
        // The offset at the stated temperature can only become more certain.
        let [before, after] = [free, held].map(|file| three(file, "std.b_or_ent"));
        assert!((0..3).all(|a| after[a] <= before[a] * (1.0 + 1e-9)), "{before:?} {after:?}");
    };

    // A run that does not tell the slopes of the sensitivities, its temperature beside a constant offset.
    let case = Case::new();
    case.put("26-01-01/00-00-00.CCR", short_run(22.0));
    let lin = |of_offset: String| {
        let others = bound("slope_sigma", 2e-5, "nT/enT/K") + &bound("slope_xi", 1e-4, "deg/K");
        case.put("campaign.toml", format!("offset_trend_order = 0\n{others}{of_offset}"));
        let output = case.run("lin", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        assert!(!text(&output.stderr).contains("read and not used"), "{}", text(&output.stderr));
        parameters(&folder(&case, ID).join(format!("PARAMETER_LIN__{ID}.CPF")))
    };
    let free = lin(String::new());
    let typical = three(&free, "slopes.std.b_or_ent")[0];
    weighed(&free, &lin(bound("slope_offset", typical, "enT/K")), typical);

    // One that tells them all, which are found together.
    const RUN: &str = "13-04-03_10-15-00";
    let mut twin = april();
    twin.runs.retain(|run| run.id == RUN);
    let case = Case::new();
    write_campaign(&twin, 7, &case.campaign(), false, || ()).unwrap();
    let lin = || {
        let output = case.run("lin", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        parameters(&folder(&case, RUN).join(format!("PARAMETER_LIN__{RUN}.CPF")))
    };
    let free = lin();
    let typical = three(&free, "slopes.std.b_or_ent")[0];
    let written = std::fs::read_to_string(case.campaign().join("campaign.toml")).unwrap();
    case.put("campaign.toml", written + "\n" + &bound("slope_offset", typical, "enT/K"));
    let held = lin();
    assert_eq!(held["slopes"]["source"].as_str(), Some("run"));
    weighed(&free, &held, typical);
}

#[test]
fn a_group_whose_runs_show_no_slopes_leaves_a_moving_run_its_own() {
    let case = Case::new();
    let rest = short_run(10.4).replace(ID, "26-01-02_00-00-00").replace("2026-01-01T", "2026-01-02T");
    case.put("26-01-01/00-00-00.CCR", short_run(22.0));
    case.put("26-01-02/00-00-00.CCR", rest);
    let bound = |quantity: &str, std: f64, unit: &str| {
        format!("[[uncertainty]]\nquantity = \"{quantity}\"\nstd = {std}\nunit = \"{unit}\"\nsource = \"type test\"\n")
    };
    case.put("campaign.toml", bound("slope_sigma", 2e-5, "nT/enT/K") + &bound("slope_xi", 1e-4, "deg/K"));
    let made = |orders: &[&str]| {
        let output = calfit()
            .arg("thermal")
            .arg(case.campaign())
            .args(orders)
            .arg("-o")
            .arg(case.out())
            .arg("--no-plots")
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        parameters(&folder(&case, ID).join(format!("PARAMETER_TEMPLIN__{ID}.CPF")))
    };
    // Two runs have too few temperatures for a slope: a constant is no knowledge of it.
    let file = made(&[]);
    assert_eq!(file["slopes"]["source"].as_str(), Some("bound"));
    says(&file["warnings"].to_string(), &["tells no slope of sigma_x"]);
    // Orders that were given are taken at their word.
    let file = made(&["--order", "sigma=0", "--order", "xi=0"]);
    assert!(file["slopes"]["source"].as_str().unwrap().ends_with(".TPF"));
}

#[test]
fn a_run_at_rest_has_no_slopes_and_one_that_moves_a_little_room_for_them() {
    let made = |to_degc: f64| {
        let case = Case::new();
        case.put("26-01-01/00-00-00.CCR", short_run(to_degc));
        let output = calfit().arg("lin").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let file = parameters(&folder(&case, ID).join(format!("PARAMETER_LIN__{ID}.CPF")));
        assert!(!is_moving(&file));
        (file, text(&output.stderr))
    };
    let (still, said) = made(10.0);
    assert!(still.get("slopes").is_none() && !said.contains("moved by"), "{said}");

    // Nine settings do not tell the slopes: the largest that are published, 1e-3 nT/enT/K, times the distance of each axis from the mean.
    let (moved, said) = made(10.4);
    says(&said, &["the sensor temperature moved by", "its slopes are not known", "0.001 nT/enT/K", "--temperature", "bounds"]);
    assert_eq!(moved["slopes"]["source"].as_str(), Some("assumed"));
    let far_k = [2.5, 0.5, -3.5].map(|plateaus: f64| plateaus * 0.4 / 9.0);
    for (std, far_k) in three(&moved, "std.sigma").into_iter().zip(far_k) {
        let (by_slope, of_noise) = (1e-3 * f64::abs(far_k), 3e-6);
        assert!((std / by_slope.hypot(of_noise) - 1.0).abs() < 0.1, "{std} {by_slope}");
    }
}

/// The demonstration's first linearity run while the sensor warms by 0.85 K, with slopes as steep as the steepest that are published of a
/// fluxgate: the sensitivities hold at the mean temperature within their uncertainties.
#[test]
fn a_drift_of_less_than_a_kelvin_is_in_the_uncertainties() {
    const RUN: &str = "26-03-02_08-00-00";
    const SLOPES: [f64; 3] = [-9e-4, 8e-4, -1e-3];
    let mut twin = read("demo.toml");
    twin.runs.retain(|run| run.id == RUN);
    let from = "2026-03-02T07:30:00Z".parse().unwrap();
    twin.thermal_box.phases = vec![Phase { from, target_degc: 90.0, approach: Approach::Rate(1.8) }];
    let sigma_0 = twin.sensors[0].model.sigma.each_ref().map(|sigma| sigma[0]);
    twin.sensors[0].model.sigma = std::array::from_fn(|i| vec![sigma_0[i], SLOPES[i]]);
    let pulls: Vec<f64> = SEEDS
        .iter()
        .flat_map(|seed| {
            let case = Case::new();
            write_campaign(&twin, *seed, &case.campaign(), false, || ()).unwrap();
            let fitted = case.run("lin", &["--no-plots"]);
            says(&text(&fitted.stderr), &["the sensor temperature moved by", "its slopes are not known"]);
            let file = parameters(&folder(&case, RUN).join(format!("PARAMETER_LIN__{RUN}.CPF")));
            assert!(!is_moving(&file));
            let (degc, found, std) = (number(&file, "slopes.at_degc"), sigma(&file), three(&file, "std.sigma"));
            // The noise alone makes 4e-6 nT/enT; Y is driven around the mean temperature.
            assert!([std[0], std[2]].iter().all(|std| (8e-6..8e-5).contains(std)), "{std:?}");
            [0, 1, 2].map(|i| (found[i] - (sigma_0[i] + SLOPES[i] * degc)) / std[i])
        })
        .collect();
    // Fifteen values of a normal distribution: beyond it one time in a thousand.
    assert!(rms(&pulls) < 1.58, "{pulls:?}");
}

#[test]
fn polynomials_serve_a_diagnosis_and_only_their_own_sensor() {
    let mut twin = april();
    // One run of the other sensor.
    twin.runs.retain(|run| run.sensor == 0 || run.id == "13-04-09_11-24-12");
    let case = Case::new();
    write_campaign(&twin, 1, &case.campaign(), false, || ()).unwrap();
    let output = calfit().arg("thermal").arg(case.campaign()).arg("-o").arg(case.out()).arg("--no-plots").output().unwrap();
    let tpf = case.out().join("THERMAL_PARAMETER__13-04-03-09-22-38.TPF");
    assert!(tpf.is_file(), "{}", text(&output.stderr));
    let run = case.campaign().join("13-04-03/10-15-00.CCR");

    // What the sensitivities follow of the temperature is an effect, unless polynomials tell it.
    let found = |polynomials: Option<&Path>| {
        let mut call = calfit();
        call.arg("diagnose").arg(&run).arg("-o").arg(case.out()).arg("--no-plots");
        if let Some(path) = polynomials {
            call.arg("--temperature").arg(path);
        }
        let output = call.output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let json = std::fs::read_to_string(case.out().join("13-04-03_10-15-00/diagnosis.json")).unwrap();
        let diagnosis: serde_json::Value = serde_json::from_str(&json).unwrap();
        let steps = diagnosis["steps"].as_array().unwrap().clone();
        steps.iter().map(|step| step["effect"].as_str().unwrap().to_owned()).collect::<Vec<String>>()
    };
    let is_named = |effects: &[String]| effects.iter().any(|e| e == "sensor_temperature_sensitivity");
    assert!(is_named(&found(None)));
    assert!(!is_named(&found(Some(&tpf))));

    let other = case.campaign().join("13-04-09/11-24-12.CCR");
    for command in ["lin", "diagnose"] {
        let output = calfit().arg(command).arg(&other).arg("--temperature").arg(&tpf).arg("-o").arg(case.out()).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["THERMAL_PARAMETER__13-04-03-09-22-38.TPF", "BS_11", "BS_10"]);
    }
}
