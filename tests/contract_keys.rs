//! The keys on which other programs rely stand in every parameter file, with nan where a value is not known (docs/reference/files.md).

use crate::common;

use common::check::{Case, calfit, data, parameters, text};
use common::{campaign, programme};
use std::fs;
use std::path::Path;
use toml_edit::{DocumentMut, Item, Value};

const ALL: [&str; 8] = [
    "format",
    "version",
    "provenance.tool",
    "provenance.tool_version",
    "provenance.command",
    "provenance.created",
    "provenance.input.path",
    "provenance.input.sha256",
];
const CPF: [&str; 34] = [
    "run.id",
    "run.sensor",
    "run.mode",
    "run.temperature_degc",
    "matrix.r_nom",
    "matrix.rho",
    "matrix.omega",
    "matrix.sigma",
    "matrix.phi",
    "matrix.phi_tilde",
    "angle_deg.xi_xy",
    "angle_deg.xi_xz",
    "angle_deg.xi_yz",
    "angle_deg.lambda_x",
    "angle_deg.mu_y",
    "angle_deg.nu_z",
    "offset.b_or_ent",
    "offset.trend_order",
    "quality.raw_std_ent.min",
    "quality.raw_std_ent.mean",
    "quality.raw_std_ent.max",
    "quality.residual_nt.std",
    "quality.residual_nt.max",
    "quality.residual_nt.min",
    "quality.blocks_used",
    "quality.blocks_total",
    "std.sigma",
    "std.xi_deg",
    "std.b_or_ent",
    "std.lambda_mu_nu_deg",
    "apply.steps",
    "apply.omega",
    "apply.omega_formula",
    "apply.offset.quantity",
];
const MOVING: [&str; 6] = [
    "conditions.sensor_range_k",
    "conditions.sensor_rate_k_per_h",
    "slopes.sigma",
    "slopes.xi_deg",
    "slopes.b_or_ent",
    "slopes.source",
];
const OPF: [&str; 9] = [
    "offset_ent",
    "offset_std_ent",
    "residual_ent",
    "run.temperature_degc",
    "run.coil_temperature_degc",
    "std.offset_ent",
    "std.residual_ent",
    "apply.steps",
    "apply.offset.quantity",
];
const FPF: [&str; 12] = [
    "f_s_hz",
    "f_s_std_hz",
    "mean_f_s_hz",
    "mean_f_s_std_hz",
    "f_3db_igep_hz",
    "f_3db_model_hz",
    "f_3db_model_std_hz",
    "model.name",
    "amplitude.frequency_hz",
    "amplitude.b_ent",
    "amplitude.b_std_ent",
    "amplitude.used",
];
const TPF: [&str; 22] = [
    "used",
    "channel",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "xi_xy",
    "xi_xz",
    "xi_yz",
    "b_or_x",
    "b_or_y",
    "b_or_z",
    "covariance.sigma_x",
    "covariance.sigma_y",
    "covariance.sigma_z",
    "covariance.xi_xy",
    "covariance.xi_xz",
    "covariance.xi_yz",
    "covariance.b_or_x",
    "covariance.b_or_y",
    "covariance.b_or_z",
    "valid_degc",
    "apply.steps",
];
const TOF: [&str; 10] = [
    "used",
    "channel",
    "b_off_x",
    "b_off_y",
    "b_off_z",
    "covariance.b_off_x",
    "covariance.b_off_y",
    "covariance.b_off_z",
    "valid_degc",
    "apply.steps",
];
const TAF: [&str; 12] = [
    "used",
    "channel",
    "f_3db_x",
    "f_3db_y",
    "f_3db_z",
    "covariance.f_3db_x",
    "covariance.f_3db_y",
    "covariance.f_3db_z",
    "mean_sample_rate_hz",
    "mean_std_sample_rate_hz",
    "valid_degc",
    "apply.steps",
];

fn item<'a>(file: &'a DocumentMut, key: &str) -> Option<&'a Item> {
    key.split('.').try_fold(file.as_item(), |item, part| match item {
        Item::ArrayOfTables(list) => list.get(0)?.get(part),
        item => item.get(part),
    })
}

#[track_caller]
fn has(file: &DocumentMut, format: &str, keys: &[&str]) {
    assert_eq!(file["format"].as_str(), Some(format));
    let missing: Vec<&&str> = ALL.iter().chain(keys).filter(|key| item(file, key).is_none()).collect();
    assert!(missing.is_empty(), "{format} lacks {missing:?}");
}

/// The numbers under a key are nan, all of them.
#[track_caller]
fn unknown(file: &DocumentMut, keys: &[&str]) {
    fn all(value: &Value) -> bool {
        match value {
            Value::Array(list) => !list.is_empty() && list.iter().all(all),
            value => value.as_float().is_some_and(f64::is_nan),
        }
    }
    for key in keys {
        assert!(item(file, key).and_then(Item::as_value).is_some_and(all), "{key} is not nan");
    }
}

#[test]
fn every_kind_of_file_of_a_campaign_has_the_keys() {
    let case = Case::new();
    campaign::write(&case);
    let out = case.made("thermal", &["thermal"], &[&case.campaign()]);
    let dashed = |hour: usize| campaign::id(hour, 0).replace('_', "-");
    let of_run = |hour: usize, name: String| parameters(&out.join(campaign::id(hour, 0)).join(name));
    has(&of_run(8, format!("PARAMETER_TEMPLIN__{}.CPF", campaign::id(8, 0))), "CPF", &CPF);
    has(&of_run(9, format!("OFF_PARAMETER__{}.OPF", dashed(9))), "OPF", &OPF);
    has(&of_run(10, format!("FREQ_PARAMETER__{}.FPF", dashed(10))), "FPF", &FPF);
    has(&parameters(&out.join(format!("THERMAL_PARAMETER__{}.TPF", dashed(8)))), "TPF", &TPF);
    has(&parameters(&out.join(format!("THERMAL_OFF_PARAMETER__{}.TOF", dashed(9)))), "TOF", &TOF);
    has(&parameters(&out.join(format!("THERMAL_AC_PARAMETER__{}.TAF", dashed(10)))), "TAF", &TAF);
}

/// A run of means of an orthogonal sensor without errors of its own, with temperatures that go up by some kelvin, or without any.
fn means(rise_k: Option<f64>) -> String {
    let settings = programme(&[-1000.0, -500.0, 500.0, 1000.0], 60.0);
    let end = settings.last().unwrap().t_end;
    let mut blocks = String::new();
    for (i, s) in settings.iter().enumerate() {
        // A scatter of some thousandths of an enT, different in every row.
        let read = |a: usize| s.field[a] + 5.0 + 3e-3 * ((7 * i + 3 * a) as f64).sin();
        let [bx, by, bz] = s.field;
        blocks.push_str(&format!("{},{},{bx},{by},{bz},1,{},{},{}\n", s.t_start, s.t_end, read(0), read(1), read(2)));
    }
    let degc = |k: f64| 20.0 + rise_k.unwrap_or(0.0) * k / 100.0;
    let rows: String = (0..=100).map(f64::from).map(|k| format!("{},{},20\n", end * k / 100.0, degc(k))).collect();
    let temperatures = if rise_k.is_some() { format!("@TEMPERATURES\nt,T59,T29\n{rows}") } else { String::new() };
    format!(
        "CCR 1\nrun = \"26-01-01_00-00-00\"\nstart = \"2026-01-01T00:00:00Z\"\nkind = \"linearity\"\nsensor = \"S\"\nmode = \"m\"\n\
         sample_rate = 10.0\nunit = \"enT\"\n@BLOCKS\nt_start,t_end,bx,by,bz,position,x,y,z\n{blocks}{temperatures}@END\n"
    )
}

fn linear(case: &Case, run: String) -> (DocumentMut, String) {
    case.put("26-01-01/00-00-00.CCR", run);
    let out = case.made("lin", &["lin", "--force"], &[&case.campaign()]);
    let path = out.join("26-01-01_00-00-00/PARAMETER_LIN__26-01-01_00-00-00.CPF");
    (parameters(&path), path.display().to_string())
}

/// What is read back from such files is what was written: `check`, `verify`, and the analyses that take them.
#[track_caller]
fn is_read(path: &str) {
    for arguments in [["check", path], ["verify", path]] {
        let output = calfit().args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
    }
}

#[test]
fn a_calibration_of_means_without_temperature_says_nan() {
    let case = Case::new();
    let (file, path) = linear(&case, means(None));
    has(&file, "CPF", &CPF);
    unknown(&file, &["run.temperature_degc", "quality.raw_std_ent.min", "quality.raw_std_ent.mean", "quality.raw_std_ent.max"]);
    is_read(&path);
    let output = calfit().args(["export", "--format", "json", "-o"]).arg(case.out()).arg(&path).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let exported = fs::read_to_string(case.out().join("PARAMETER_LIN__26-01-01_00-00-00.CPF.json")).unwrap();
    let exported: serde_json::Value = serde_json::from_str(&exported).unwrap();
    assert_eq!(exported["run"].get("temperature_degc"), Some(&serde_json::Value::Null));
}

#[test]
fn a_run_whose_temperature_moves_has_the_slope_of_the_offset() {
    let case = Case::new();
    let bound = |quantity: &str, std: f64, unit: &str| {
        format!("[[uncertainty]]\nquantity = \"{quantity}\"\nstd = {std}\nunit = \"{unit}\"\nsource = \"type test\"\n")
    };
    case.put("campaign.toml", bound("slope_sigma", 2e-5, "nT/enT/K") + &bound("slope_xi", 1e-4, "deg/K"));
    let (file, path) = linear(&case, means(Some(10.0)));
    has(&file, "CPF", &[CPF.as_slice(), &MOVING].concat());
    is_read(&path);
}

#[test]
fn a_table_of_amplitudes_tells_no_sampling_frequency_and_says_so() {
    let case = Case::new();
    let table = data("tests/data/bepicolombo/freq_13-04-03-12-59-48.csv");
    let out = case.made("freq", &["freq"], &[Path::new("--amplitudes"), &table]);
    let file = parameters(&out.join("13-04-03-12-59-48/FREQ_PARAMETER__13-04-03-12-59-48.FPF"));
    has(&file, "FPF", &FPF);
    unknown(&file, &["f_s_hz", "f_s_std_hz", "mean_f_s_hz", "mean_f_s_std_hz"]);
}

#[test]
fn a_component_without_offset_is_nan_in_polynomials() {
    let case = Case::new();
    let folder = case.path().join("files");
    fs::create_dir_all(&folder).unwrap();
    for (i, degc) in [-50.0, 20.0, 110.0].into_iter().enumerate() {
        let body = format!(
            "format = \"OPF\"\nversion = 1\noffset_ent = [{:?}, nan, {:?}]\n[run]\nid = \"13-04-0{}_09-00-00\"\nsensor = \"A\"\n\
             mode = \"m\"\ntemperature_degc = {degc:?}\n",
            0.1 + 1e-3 * degc,
            0.3 - 2e-3 * degc,
            i + 1
        );
        fs::write(folder.join(format!("OFF_PARAMETER__{i}.OPF")), body).unwrap();
    }
    let out = case.made("thermal", &["thermal"], &[&folder]);
    let path = out.join("THERMAL_OFF_PARAMETER__13-04-01-09-00-00.TOF");
    let file = parameters(&path);
    has(&file, "TOF", &TOF);
    unknown(&file, &["b_off_y", "covariance.b_off_y"]);
    is_read(path.to_str().unwrap());
}

#[test]
fn a_campaign_without_runs_of_a_kind_is_one_to_which_the_analysis_does_not_apply() {
    let case = Case::of(common::good().text());
    for arguments in [&["offset"][..], &["freq"], &["null"], &["coil", "scalar"], &["coil", "residual"]] {
        let output = calfit().args(arguments).arg(case.campaign()).args(["--json", "-o"]).arg(case.out()).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        let listing: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert_eq!(listing, serde_json::json!({ "runs": [], "failed": [] }), "{arguments:?}");
        assert!(text(&output.stderr).contains("the analysis does not apply to it"), "{arguments:?}");
    }
}
