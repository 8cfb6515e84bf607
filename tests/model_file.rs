//! A model file does in every command what its effects say: formulas written out here, readings from the forward model of `common`,
//! which is not the tool's.

use crate::common;

use calfit::data::plateau::{Accumulator, from_blocks};
use calfit::data::provenance::Provenance;
use calfit::files::campaign::Campaign;
use calfit::files::ccr;
use calfit::files::parameter::{self, Model, ModelEffect, ModelParameter};
use calfit::measure::lin::{Lin, Options, lin};
use calfit::measure::sweep;
use calfit::model::campaign::Instructions;
use calfit::record::known::Known;
use calfit::record::prepared::PreparedRun;
use calfit::workflow::{known, read_model};
use common::check::{Case, calfit, number, parameters, says, text};
use common::{POSITIONS, Plan, Truth, in_positions, offset_fields, position_table, programme};
use std::fs;
use std::path::{Path, PathBuf};
use toml_edit::DocumentMut;

const RUN: &str = "13-04-03_09-22-38";
/// 0.4 enT at 2000 enT.
const C3: f64 = 5e-11;

fn parameter(name: &str, value: f64, std: Option<f64>, unit: &str) -> ModelParameter {
    ModelParameter { name: name.to_owned(), value, std, unit: unit.to_owned() }
}

fn effect(id: &str, form: &str, axes: &[&str], parameters: Vec<ModelParameter>, shape: Vec<ModelParameter>) -> ModelEffect {
    ModelEffect {
        id: id.to_owned(),
        form: form.to_owned(),
        axes: axes.iter().map(|a| (*a).to_owned()).collect(),
        run: Some(RUN.to_owned()),
        reading_ent: None,
        parameter: parameters,
        shape,
    }
}

fn cubic(value: f64) -> ModelEffect {
    effect("cubic_nonlinearity", "cubic", &["z"], vec![parameter("c3_z", value, Some(0.02 * value), "enT/enT^3")], Vec::new())
}

fn write_model(case: &Case, effects: Vec<ModelEffect>) -> PathBuf {
    write_model_of(case, effects, None)
}

/// The same with sensor and mode.
fn write_model_of(case: &Case, effects: Vec<ModelEffect>, of: Option<[&str; 2]>) -> PathBuf {
    let [sensor, mode] = of.map_or([None, None], |of| of.map(|name| Some(name.to_owned())));
    let model = Model { used: vec![RUN.to_owned()], convention: "as printed".to_owned(), sensor, mode, effect: effects };
    let text = parameter::to_text(&model, &Provenance::new(calfit::data::recipe::Recipe::plain("diagnose"), Vec::new())).unwrap();
    let path = case.path().join("model.toml");
    fs::write(&path, text).unwrap();
    path
}

/// 52 plateaus of 2 s at 128 Hz, x += C3 x³ on z, x the reading without its offset.
fn bent() -> common::Run {
    let levels: Vec<f64> = (-8..=8).filter(|k| *k != 0).map(|k| 250.0 * f64::from(k)).collect();
    let zero = Truth::default().offset_ent;
    Plan { settings: programme(&levels, 2.0), ..Plan::default() }.run().each(|mut r| {
        r[2] += C3 * (r[2] - zero[2]).powi(3);
        r
    })
}

fn fit(path: &Path, model: Option<Known>) -> Lin {
    let campaign = Campaign::open(&[path.to_owned()], &mut Vec::new()).unwrap().remove(0);
    let mut accumulator = Accumulator::default();
    let run = ccr::read(path, &ccr::Options::default(), &mut accumulator).unwrap();
    let options = Options { model, trend_order: Some(0), ..Options::default() };
    let plateaus = accumulator.finish(options.cut);
    lin(&run, &plateaus, &campaign.file.instructions, &options).unwrap()
}

#[test]
fn a_known_effect_is_taken_off_and_the_truth_comes_back() {
    let case = Case::of(bent().text());
    let path = write_model(&case, vec![cubic(C3)]);
    let truth = Truth::default().sigma[2];
    let away = |lin: &Lin| (lin.calibration.matrix.sigma[2][2] - truth) / lin.calibration.std.sigma[2];

    let without = fit(&case.file(), None);
    // The straight line through x + C3 x³ at the levels: a' = a + C3 a³ ΣB⁴/ΣB², with a = 1/σ.
    let sum = |power: i32| (1..=8).map(|k| (250.0 * f64::from(k)).powi(power)).sum::<f64>();
    let bent = 1.0 / (1.0 / truth + C3 * truth.powi(-3) * sum(4) / sum(2));
    let (found, std) = (without.calibration.matrix.sigma[2][2], without.calibration.std.sigma[2]);
    assert!((found - bent).abs() < 3.0 * std, "{found} {bent} {std}");
    assert!(away(&without).abs() > 3.0, "{}", away(&without));
    let warned = |lin: &Lin| lin.notes.iter().any(|n| n.to_string().contains("run calfit diagnose"));
    assert!(warned(&without), "{:?}", without.notes);

    let with = fit(&case.file(), known(Some(&path)).unwrap());
    assert!(away(&with).abs() < 3.0, "{}", away(&with));
    assert!(!warned(&with), "{:?}", with.notes);
    let applied = with.model.as_ref().unwrap();
    // Largest reading of z is 2000 nT over σ; its contribution in nT has σ once more.
    let wanted = C3 * (2000.0 / truth).powi(3) * truth;
    let largest_nt = applied.effect[0].largest_nt.unwrap();
    assert!((largest_nt / wanted - 1.0).abs() < 0.01, "{largest_nt} {wanted}");
    // The uncertainty of the parameter is carried: 2 % of the bias that the effect has.
    let bias = without.calibration.matrix.sigma[2][2] - truth;
    let own = fit(
        &case.file(),
        known(Some(&write_model(
            &case,
            vec![ModelEffect { parameter: vec![parameter("c3_z", C3, None, "enT/enT^3")], ..cubic(C3) }],
        )))
        .unwrap(),
    );
    let grown = (with.calibration.std.sigma[2].powi(2) - own.calibration.std.sigma[2].powi(2)).sqrt();
    assert!((grown / (0.02 * bias).abs() - 1.0).abs() < 0.1, "{grown} {bias}");
}

#[test]
fn the_command_states_the_model_and_verify_repeats_it() {
    let case = Case::of(bent().text());
    let path = write_model(&case, vec![cubic(C3)]);
    let stderr = case.done(&["--order", "0", "--model", &path.display().to_string()]);
    assert!(!stderr.contains("FIT"), "{stderr}");
    let cpf = case.cpf();
    assert_eq!(cpf["model"]["file"].as_str(), Some("model.toml"));
    assert!(cpf["provenance"]["command"].as_str().unwrap().contains("--model model.toml"));
    assert_eq!(cpf["model"]["effect"][0]["id"].as_str(), Some("cubic_nonlinearity"));
    let report = fs::read_to_string(case.out().join(RUN).join(format!("REPORT_LIN__{RUN}.md"))).unwrap();
    assert!(report.contains("cubic_nonlinearity on z"), "{report}");
    let verified = calfit().arg("verify").args([case.out(), case.campaign(), case.path().to_owned()]).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}

#[test]
fn what_belongs_to_another_run_or_goes_beyond_is_said() {
    let case = Case::of(bent().text());
    let step = |run: &str, onset: f64| ModelEffect {
        run: Some(run.to_owned()),
        ..effect(
            "offset_step",
            "step",
            &["x"],
            vec![parameter("c_x", 3.0, None, "enT")],
            vec![parameter("onset", onset, None, "s")],
        )
    };
    // The effect is on z, and what it says of the readings of the other axes does not matter.
    let narrow = ModelEffect { reading_ent: Some(vec![[-9.0, 9.0], [-8.0, 8.0], [-900.0, 900.0]]), ..cubic(C3) };
    let path = write_model(&case, vec![narrow, step("13-04-04_00-00-00", 40.0), step(RUN, 1e5)]);
    let lin = fit(&case.file(), known(Some(&path)).unwrap());
    let warnings = lin.notes.iter().map(ToString::to_string).collect::<Vec<_>>().join("\n");
    for words in ["from -900 to 900 enT", "13-04-04_00-00-00", "outside of the run"] {
        assert!(warnings.contains(words), "{warnings}");
    }
    assert!(!warnings.contains("from -9 to") && !warnings.contains("from -8 to"), "{warnings}");
    let applied = lin.model.unwrap();
    assert_eq!((applied.effect.len(), applied.left_out.len()), (1, 2));
    assert!((lin.calibration.offset.b_or_ent[0] - Truth::default().offset_ent[0]).abs() < 0.05);
}

/// A quarter of an hour of zero field. The variometer goes up by 20 nT on its x, half of which the x of the sensor reads.
#[test]
fn what_leaks_into_zero_field_is_taken_off_its_samples() {
    const SPAN_S: f64 = 900.0;
    let (kappa, rise_nt) = (0.5, 20.0);
    let settings = vec![common::Setting::constant(0.0, SPAN_S, [0.0; 3], 1)];
    let mut run = Plan { settings, rate_hz: 16.0, noise_ent: 0.05, ..Plan::default() }.run();
    run = run.key("kind", "\"zero-field\"").key("configuration", "\"NULL.MAG\"");
    // About its mean over the run, for which the offset holds.
    run.samples.iter_mut().for_each(|s| s.reading[0] += kappa * rise_nt * (s.t / SPAN_S - 0.5));
    let rows: String =
        (0..=90).map(|k| format!("{},{},0.5,{}\n", 10 * k, rise_nt * f64::from(k) / 90.0, 0.01 * f64::from(k))).collect();
    let case = Case::of(run.text().replace("@END\n", &format!("@CHANNELS\nt,VARX,VARY,VARZ\n{rows}@END\n")));
    let analysed = |arguments: &[&str]| {
        let output = case.run("null", &[&["--no-plots", "--force"], arguments].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        (parameters(&case.out().join(format!("{RUN}/NULL_PARAMETER__{RUN}.toml"))), text(&output.stderr))
    };
    let drift = |p: &DocumentMut| ["offset.drift_ent_per_h.0.0", "offset.drift_std_ent_per_h.0.0"].map(|key| number(p, key));
    let wanted = kappa * rise_nt / SPAN_S * 3600.0;
    let (plain, _) = analysed(&[]);
    let [found, std] = drift(&plain);
    assert!((found - wanted).abs() < 4.0 * std && std < 0.05 * wanted && plain.get("model").is_none(), "{found} ± {std}");
    let leak = effect("earthfield_leakage", "own axis", &["x"], vec![parameter("kappa_x", kappa, None, "nT/nT")], Vec::new());
    // The step belongs to the times of another run.
    let of_another = ModelEffect {
        run: Some("13-04-04_00-00-00".to_owned()),
        ..effect(
            "offset_step",
            "step",
            &["x"],
            vec![parameter("c_x", 3.0, None, "enT")],
            vec![parameter("onset", 40.0, None, "s")],
        )
    };
    let path = write_model(&case, vec![leak, of_another]).display().to_string();
    let (with, said) = analysed(&["--model", &path]);
    let [found, std] = drift(&with);
    assert!(found.abs() < 4.0 * std && std < 0.05 * wanted, "{found} ± {std}");
    says(&said, &["mean variometer reading of the run", "not taken off", "13-04-04_00-00-00"]);
    let mean = |p: &DocumentMut| number(p, "offset.mean_ent.0");
    assert!((mean(&with) - mean(&plain)).abs() < 0.02, "{} {}", mean(&with), mean(&plain));
    assert_eq!(with["model"]["file"].as_str(), Some("model.toml"));
    assert_eq!(with["model"]["left_out"].as_array().unwrap().len(), 1);
    let applied = with["model"]["effect"].as_array_of_tables().unwrap().get(0).unwrap();
    assert!((applied["largest_nt"].as_float().unwrap() - 0.5 * kappa * rise_nt).abs() < 0.1, "{applied}");
    assert!(with["provenance"]["command"].as_str().unwrap().contains("--model model.toml"));
    let verified = calfit().arg("verify").args([case.out(), case.campaign(), case.path().to_owned()]).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}

#[test]
fn a_model_of_another_sensor_or_mode_is_refused() {
    let case = Case::of(bent().text());
    let header = bent().text();
    let key = |name: &str| {
        header.lines().find_map(|l| l.strip_prefix(&format!("{name} = \""))).unwrap().trim_end_matches('"').to_owned()
    };
    let (sensor, mode) = (key("sensor"), key("mode"));
    let with = |of: Option<[&str; 2]>| {
        let model = write_model_of(&case, vec![cubic(C3)], of);
        case.lin(&["--order", "0", "--no-plots", "--force", "--model", model.to_str().unwrap()])
    };
    for of in [["another", mode.as_str()], [sensor.as_str(), "another"]] {
        let output = with(Some(of));
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        says(&text(&output.stderr), &["model.toml holds effects of", "another", "name the model of this sensor and mode"]);
    }
    let output = with(Some([&sensor, &mode]));
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert!(!text(&output.stderr).contains("of which sensor"), "{}", text(&output.stderr));
    // An earlier file does not tell, which is said. An effect of the facility is the same for every sensor.
    says(&text(&with(None).stderr), &["model.toml does not tell of which sensor and mode"]);
}

#[test]
fn a_model_file_comes_back_as_it_was_written() {
    let case = Case::new();
    let tone = effect(
        "interference_tone",
        "sine",
        &["x"],
        // Not in the order of the catalogue: parameters are told by their names.
        vec![parameter("c_x", 0.25, Some(0.01), "enT"), parameter("s_x", -0.5, None, "enT")],
        vec![parameter("frequency", 11.0, None, "Hz")],
    );
    let effects = vec![cubic(C3), tone];
    let (file, known) = read_model(&write_model(&case, effects.clone())).unwrap();
    assert_eq!(file.body.effect, effects);
    assert_eq!(known.effects[1].given.values, [-0.5, 0.25]);
    assert_eq!(known.effects[1].std, [0.0, 0.01]);
}

#[test]
fn mistakes_in_a_model_are_named_with_line_and_remedy() {
    let case = Case::new();
    let refused = |wrong: ModelEffect, key: &str, words: &[&str]| {
        let path = write_model(&case, vec![cubic(C3), wrong]);
        let finding = read_model(&path).unwrap_err();
        let shown = finding.to_string();
        words.iter().for_each(|w| assert!(shown.contains(w), "{shown}"));
        let text = fs::read_to_string(&path).unwrap();
        let lines = text.lines().enumerate().filter(|(_, l)| l.starts_with(key)).map(|(i, _)| i as u64 + 1);
        assert_eq!(finding.line, lines.last(), "{shown}");
    };
    refused(ModelEffect { id: "cubic".to_owned(), ..cubic(C3) }, "id = ", &["no effect of the catalogue", "`calfit effects`"]);
    refused(ModelEffect { axes: vec!["w".to_owned()], ..cubic(C3) }, "axes = ", &["\"x\", \"y\", \"z\""]);
    refused(ModelEffect { axes: vec!["x".to_owned()], ..cubic(C3) }, "id = ", &["`c3_x`", "calfit effects cubic_nonlinearity"]);
    refused(ModelEffect { form: "quartic".to_owned(), ..cubic(C3) }, "form = ", &["is none of cubic"]);
    let onset = effect("offset_step", "step", &["x"], vec![parameter("c_x", 1.0, None, "enT")], Vec::new());
    refused(onset, "id = ", &["shape parameter", "calfit effects offset_step"]);
}

/// A twin of one run without noise.
fn twin(noise: &str, mag: &str) -> String {
    format!(
        r#"
seed = 7
[campaign]
name = "Twin"
[[campaign.position]]
id = 1
axes = ["+X", "+Y", "+Z"]
[electronics]
sample_rate_hz = 32.0
range_ent = 4000.0
resolution_ent = 0.001
[[sensor]]
name = "FGM"
mode = "normal"
real_sample_rate_hz = 32.0
rotation_deg = [0.4, -0.7, 0.25]
sigma_x = [0.98]
sigma_y = [1.02]
sigma_z = [0.995]
xi_xy = [89.8]
xi_xz = [90.3]
xi_yz = [90.05]
b_off_x = [12.5]
b_off_y = [-8.25]
b_off_z = [3.75]
f_3db_x = [20.0]
f_3db_y = [25.0]
f_3db_z = [15.0]
response = "first order"
white_ent = [{noise}, {noise}, {noise}]
[facility]
[box]
start_degc = 20.0
[temperatures]
interval_s = 10.0
coil = {{ mean_degc = 17.0 }}
rack = {{ mean_degc = 31.0 }}
[[temperatures.thermistor]]
channel = "T59"
of = "sensor"
[[run]]
start = "2026-01-02T10:00:00Z"
programme = "{mag}"
sensor = "FGM"
mode = "normal"
"#
    )
}

fn simulated(case: &Case, noise: &str, arguments: &[&str], out: &str) -> PathBuf {
    let mut steps = "MAG 1\nname = \"LIN.MAG\"\nkind = \"linearity\"\n@STEPS\nduration,bx,by,bz,frequency,position\n".to_owned();
    for axis in 0..3 {
        for k in -10..=10 {
            let mut field = [0.0; 3];
            // Up and down in leaps, so that the field is no function of time.
            field[axis] = 200.0 * f64::from((8 * k) % 21 - if (8 * k) % 21 > 10 { 21 } else { 0 });
            steps += &format!("4,{},{},{},0,1\n", field[0], field[1], field[2]);
        }
    }
    fs::write(case.path().join("LIN.MAG"), steps + "@END\n").unwrap();
    fs::write(case.path().join("twin.toml"), twin(noise, "LIN.MAG")).unwrap();
    let out = case.path().join(out);
    let output =
        calfit().arg("simulate").arg(case.path().join("twin.toml")).arg("-o").arg(&out).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    assert_eq!(text(&output.stderr), "");
    out.join("26-01-02/10-00-00.CCR")
}

fn samples(path: &Path) -> Vec<[f64; 3]> {
    let text = fs::read_to_string(path).unwrap();
    let rows = text.lines().skip_while(|l| *l != "@VECTORS").skip(2).take_while(|l| !l.starts_with('@'));
    rows.map(|l| l.split(',').map(|c| c.parse().unwrap()).collect::<Vec<f64>>()).map(|r| [r[2], r[3], r[4]]).collect()
}

#[test]
fn simulated_samples_have_the_effects_of_the_model() {
    let case = Case::new();
    let (period, duty, delay) = (3.0, 0.3, 0.5);
    let pulse = effect(
        "heater_pwm",
        "square",
        &["x"],
        vec![parameter("a_x", 2.0, None, "enT")],
        vec![parameter("period", period, None, "s"), parameter("duty", duty, None, "1"), parameter("delay", delay, None, "s")],
    );
    let model = write_model(&case, vec![cubic(C3), pulse]).display().to_string();
    let without = samples(&simulated(&case, "0.0", &[], "without"));
    let with = samples(&simulated(&case, "0.0", &["--model", &model], "with"));
    assert_eq!((without.len(), with.len()), (8064, 8064));
    for (n, (a, b)) in without.iter().zip(&with).enumerate() {
        let t = (n as f64 + 0.5) / 32.0;
        // The step of the field is followed within a quarter of a second; before that x is between two settings.
        if t % 4.0 < 1.0 {
            continue;
        }
        let on = ((t - delay) / period).rem_euclid(1.0) < duty;
        let wanted = [2.0 * (f64::from(u8::from(on)) - duty), 0.0, C3 * (a[2] - 3.75).powi(3)];
        for i in 0..3 {
            // Both readings are rounded to 0.001, and c3 takes the fitted response for the true one.
            assert!((b[i] - a[i] - wanted[i]).abs() < 0.0015, "{t} {i}: {} {}", b[i] - a[i], wanted[i]);
        }
    }
}

#[test]
fn the_diagnosis_finds_a_simulated_effect_again() {
    let case = Case::new();
    let model = write_model(&case, vec![cubic(C3)]).display().to_string();
    let run = simulated(&case, "0.1", &["--model", &model], "campaign");
    let found = case.path().join("found.toml");
    let output = calfit()
        .arg("diagnose")
        .arg(&run)
        .args(["--no-plots", "-o"])
        .arg(case.out())
        .arg("--write-model")
        .arg(&found)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let (file, known) = read_model(&found).unwrap();
    let entry = file.body.effect.iter().find(|e| e.id == "cubic_nonlinearity").expect("the effect");
    assert_eq!(entry.run.as_deref(), Some("26-01-02_10-00-00"));
    let c3 = entry.parameter.iter().find(|p| p.name == "c3_z").expect("its parameter");
    assert!((c3.value - C3).abs() < 4.0 * c3.std.unwrap(), "{c3:?}");
    // Taken off with what was found, the truth comes back.
    let lin = fit(&run, Some(known));
    assert!((lin.calibration.matrix.sigma[2][2] - 0.995).abs() < 3.0 * lin.calibration.std.sigma[2]);
}

#[test]
fn a_sweep_uses_the_lag_of_the_model() {
    let case = Case::new();
    common::campaign::write(&case);
    let path = case.campaign().join(format!("{}.CCR", common::campaign::id(12, 0).replace('_', "/")));
    let lag = effect("thermal_lag", "delay", &["x", "y", "z"], Vec::new(), vec![parameter("lag", 8.0, None, "s")]);
    let model = known(Some(&write_model(&case, vec![lag]))).unwrap();
    let campaign = Campaign::open(std::slice::from_ref(&path), &mut Vec::new()).unwrap().remove(0);
    let mut accumulator = Accumulator::default();
    let run = ccr::read(&path, &ccr::Options::default(), &mut accumulator).unwrap();
    let options = sweep::Options { model, ..sweep::Options::default() };
    let plateaus = accumulator.finish(options.cut);
    let swept = sweep::sweep(&run, &plateaus, &campaign.file.instructions, &options).unwrap();
    // Half a kelvin per second from -60 °C on, eight seconds late.
    let last = swept.blocks.last().unwrap();
    assert!((last.temperature_degc - (-60.0 + 0.5 * (last.t_s - 8.0))).abs() < 1e-6, "{last:?}");
    assert_eq!(swept.model.unwrap().file, "model.toml");
}

/// The effects of a model are taken off by the temperatures that the fit of the sweep has, whatever the form of the lag.
#[test]
fn the_lag_of_a_model_makes_one_series_of_temperatures() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases/26-05-06.CCR.gz");
    let instructions = Instructions { temperature_channel: Some("TCSC".to_owned()), ..Instructions::default() };
    let run = ccr::read(&path, &ccr::Options::default(), &mut Accumulator::default()).unwrap();
    // The file brings means.
    let plateaus = from_blocks(&run.blocks);
    for form in ["delay", "first order", "inverse first order"] {
        let case = Case::new();
        let lag = effect("thermal_lag", form, &["x", "y", "z"], Vec::new(), vec![parameter("lag", 480.0, None, "s")]);
        let model = known(Some(&write_model(&case, vec![lag]))).unwrap().unwrap();
        let mut prepared = PreparedRun::new(&run, &plateaus, None, &instructions, None).ok().unwrap();
        prepared.follow(model.thermal_lag().unwrap());
        let options = sweep::Options { model: Some(model), ..sweep::Options::default() };
        let swept = sweep::sweep(&run, &plateaus, &instructions, &options).unwrap();
        let degc = prepared.record.thermal.unwrap().degc;
        // The thermistor moves at its first reading: the fit leaves out what the begin of a first order decides, and the twelve settings of 40 s
        // of which a delay says nothing; a diagnosis looks at them.
        let begin = degc.len() - swept.blocks.len();
        let expected = match form {
            "first order" => 1..150,
            "delay" => 12..13,
            _ => 0..1,
        };
        assert!(expected.contains(&begin), "{form}: {begin}");
        for (degc, block) in degc[begin..].iter().zip(&swept.blocks) {
            assert!((degc - block.temperature_degc).abs() < 1e-12, "{form}: {degc} {block:?}");
        }
    }
}

const FREQUENCIES_HZ: [f64; 18] =
    [901.0, 501.0, 251.0, 158.0, 126.0, 100.0, 79.4, 63.1, 50.1, 39.8, 31.6, 25.1, 19.9, 10.0, 5.01, 2.51, 1.26, 0.631];
/// Part of the field that passes a pole of this frequency, Hz, on x and y; delay of the readings, s.
const PART: f64 = 0.6;
const POLE_HZ: f64 = 45.0;
const LATE_S: f64 = 1.5e-3;
/// Counter at the begin of the run, which is any.
const FIRST: u64 = 500_000;
/// f_s = rate + drift t + bend t².
const DRIFT: f64 = 3e-6;
const BEND: f64 = -2e-9;

/// Modulus and phase of 1 - p + p / (1 + i f/f_c), by real numbers.
fn attenuated(f: f64) -> (f64, f64) {
    let x = f / POLE_HZ;
    let (re, im) = (1.0 - PART + PART / (1.0 + x * x), -PART * x / (1.0 + x * x));
    (re.hypot(im), im.atan2(re))
}

fn of_sines() -> Vec<ModelEffect> {
    vec![
        effect(
            "eddy_current_attenuation",
            "pole in part",
            &["x", "y"],
            vec![parameter("part", PART, Some(0.003), "1"), parameter("correlation", 0.5, None, "1")],
            vec![parameter("f_c", POLE_HZ, Some(0.2), "Hz")],
        ),
        effect(
            "clock_drift",
            "polynomial in run time of degree 2",
            &["x", "y", "z"],
            vec![parameter("drift_1", DRIFT, None, "Hz/s"), parameter("drift_2", BEND, None, "Hz/s^2")],
            Vec::new(),
        ),
        effect("time_shift", "delay", &["x", "y", "z"], vec![parameter("shift", LATE_S, None, "s")], Vec::new()),
        effect(
            "response_order",
            "two poles in part",
            &["x"],
            vec![parameter("part", 0.1, None, "1")],
            vec![parameter("f_c", 70.0, None, "Hz")],
        ),
    ]
}

/// Run time at which the counter has reached n, by fixed-point iteration on n = ∫ f_s dt.
fn time_of(n: f64, rate: f64) -> f64 {
    let step = |t: f64| (n - DRIFT * t * t / 2.0 - BEND * t.powi(3) / 3.0) / rate;
    (0..8).fold(n / rate, |t, _| step(t))
}

#[test]
fn sines_without_a_known_attenuation_delay_and_drift_give_the_sensor_back() {
    let plan = Plan {
        settings: common::sines(&FREQUENCIES_HZ, 1000.0),
        rate_factor: 127.9987 / 128.0,
        corner_hz: Some([58.0, 61.0, 55.0]),
        seed: 21,
        ..Plan::default()
    };
    let (rate, corner) = (127.9987, plan.corner_hz.unwrap());
    let mut run = plan.run();
    let mut gauss = common::Gauss(5);
    let response = plan.truth.response();
    for sample in &mut run.samples {
        let t = time_of(sample.n as f64, rate);
        sample.t = t;
        sample.n += FIRST;
        let setting = plan.settings.iter().find(|s| s.t_start <= t && t < s.t_end);
        sample.reading = std::array::from_fn(|i| {
            let sine = setting.map_or(0.0, |s| {
                let x = s.frequency / corner[i];
                let (gain, turn) = if i < 2 { attenuated(s.frequency) } else { (1.0, 0.0) };
                let phase = std::f64::consts::TAU * (s.frequency * (t - LATE_S)).fract() - x.atan() + turn;
                response[i][1] * 1000.0 * gain / (1.0 + x * x).sqrt() * phase.sin()
            });
            plan.truth.offset_ent[i] + sine + 0.05 * gauss.normal()
        });
    }
    let case = Case::of(run.key("kind", "\"frequency\"").text());
    let model = write_model(&case, of_sines()).display().to_string();
    let id = "13-04-03-09-22-38";
    let file = case.out().join(format!("13-04-03_09-22-38/FREQ_PARAMETER__{id}.FPF"));
    let measured = |arguments: &[&str]| {
        let output = case.run("freq", arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        (common::check::parameters(&file), text(&output.stderr))
    };
    let number = common::check::number;
    let (without, _) = measured(&["--no-plots", "--force"]);
    let (with, said) = measured(&["--no-plots", "--force", "--model", &model]);
    assert!(said.contains("response_order belongs to the response that is fitted here"), "{said}");
    for i in 0..3 {
        let (hz, std) = (number(&with, &format!("f_3db_model_hz.{i}")), number(&with, &format!("f_3db_model_std_hz.{i}")));
        assert!((hz - corner[i]).abs() < 4.0 * std, "{i}: {hz} ± {std}");
        let (off, own) = (number(&without, &format!("f_3db_model_hz.{i}")), number(&without, &format!("f_3db_model_std_hz.{i}")));
        if i < 2 {
            assert!((off - corner[i]).abs() > 10.0 && std > 2.0 * own.min(0.05), "{i}: {off} ± {own}, {hz} ± {std}");
        }
        // The phases, without delay, attenuation and drift.
        for (row, f) in FREQUENCIES_HZ.iter().enumerate() {
            let cell = |key: &str| with["amplitude"][row][key][i].as_float().unwrap();
            let n = with["amplitude"][row]["phase_counter"].as_integer().unwrap() as f64 - FIRST as f64;
            let truth = 360.0 * (f * time_of(n, rate)).fract() - (f / corner[i]).atan().to_degrees()
                + if response[i][1] < 0.0 { 180.0 } else { 0.0 };
            let difference = cell("phase_deg") - truth;
            let difference = difference - 360.0 * (difference / 360.0).round();
            assert!(difference.abs() < 4.5 * cell("phase_std_deg"), "{f} Hz, {i}: {difference}°");
        }
    }
    // f_s holds at a time that the file states, and nothing of the drift is left.
    let t = number(&with, "clock.reference_s") - FIRST as f64 / rate;
    let f_s = rate + DRIFT * t + BEND * t * t;
    assert!((number(&with, "mean_f_s_hz") - f_s).abs() < 4.0 * number(&with, "mean_f_s_std_hz"), "{with}");
    assert!((rate - f_s).abs() > 10.0 * number(&with, "mean_f_s_std_hz"));
    assert_eq!(with["clock"]["drift_is_significant"].as_bool(), Some(false));
    let effects = with["effects"]["effect"].as_array_of_tables().unwrap();
    let largest: Vec<f64> = effects.iter().map(|e| e["largest_part"].as_float().unwrap()).collect();
    assert_eq!(effects.len(), 3);
    // 0.6 of the field is nearly gone at 901 Hz.
    assert!((largest[0] - PART).abs() < 0.01, "{largest:?}");
    let verify = calfit().arg("verify").arg(&file).output().unwrap();
    assert_eq!(verify.status.code(), Some(0), "{}{}", text(&verify.stdout), text(&verify.stderr));
}

/// A twin of a run of sines; `arguments` follow `simulate`.
fn simulated_sines(case: &Case, noise: &str, arguments: &[&str], out: &str) -> PathBuf {
    let mut steps = "MAG 1\nname = \"FREQ.MAG\"\nkind = \"frequency\"\n@STEPS\nduration,bx,by,bz,frequency,position\n".to_owned();
    for f in FREQUENCIES_HZ {
        steps += &format!("{},1000,800,900,{f},1\n", (5.0 / f).max(30.0));
    }
    fs::write(case.path().join("FREQ.MAG"), steps + "@END\n").unwrap();
    let twin = twin(noise, "FREQ.MAG").replace("sample_rate_hz = 32.0", "sample_rate_hz = 64.0");
    fs::write(case.path().join("twin.toml"), twin).unwrap();
    let out = case.path().join(out);
    let output =
        calfit().arg("simulate").arg(case.path().join("twin.toml")).arg("-o").arg(&out).args(arguments).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    out.join("26-01-02/10-00-00.CCR")
}

#[test]
fn simulated_sines_have_the_effects_of_the_model() {
    let case = Case::new();
    let mut effects = of_sines();
    effects.pop();
    effects.iter_mut().for_each(|e| e.run = Some("26-01-02_10-00-00".to_owned()));
    let model = write_model(&case, effects).display().to_string();
    let plain = samples(&simulated_sines(&case, "0", &[], "plain"));
    let with = samples(&simulated_sines(&case, "0", &["--model", &model], "with"));
    assert_eq!(plain.len(), with.len());
    let tau = std::f64::consts::TAU;
    let rate = 64.0;
    let mut begin_s = 0.0;
    for f in FREQUENCIES_HZ {
        let end_s = begin_s + (5.0_f64 / f).max(30.0);
        for i in 0..3 {
            // Amplitude and phase by least squares over the setting, with the true time of every sample.
            let phasor = |readings: &[[f64; 3]], lead: &dyn Fn(f64) -> f64| {
                let (mut normal, mut right) = (nalgebra::Matrix3::zeros(), nalgebra::Vector3::zeros());
                for (n, reading) in readings.iter().enumerate() {
                    let t = (n as f64 + 0.5) / rate;
                    if t < begin_s + 0.5 || t > end_s - 0.5 {
                        continue;
                    }
                    let angle = tau * (f * (t - lead(t) - begin_s)).fract();
                    let row = nalgebra::Vector3::new(angle.sin(), angle.cos(), 1.0);
                    normal += row * row.transpose();
                    right += row * reading[i];
                }
                let solved = normal.try_inverse().unwrap() * right;
                (solved[0].hypot(solved[1]), solved[1].atan2(solved[0]))
            };
            let lead = |t: f64| (DRIFT * t * t / 2.0 + BEND * t.powi(3) / 3.0) / rate;
            let ((a, p), (b, q)) = (phasor(&plain, &|_| 0.0), phasor(&with, &lead));
            let (gain, turn) = if i < 2 { attenuated(f) } else { (1.0, 0.0) };
            let turned = q - p - turn + tau * f * LATE_S;
            let turned = turned - tau * (turned / tau).round();
            // Readings are rounded to 0.001 enT, amplitudes are hundreds of enT at low and a few at high frequencies.
            assert!((b / a / gain - 1.0).abs() < 1e-3 / a && turned.abs() < 1e-3 / a, "{f} Hz, {i}: {} {turned}", b / a / gain);
        }
        begin_s = end_s;
    }
}

#[test]
fn the_diagnosis_of_sines_is_silent_with_what_it_found() {
    let case = Case::new();
    let mut attenuation: Vec<ModelEffect> = of_sines().into_iter().take(1).collect();
    attenuation[0].axes = ["x", "y", "z"].map(str::to_owned).to_vec();
    let model = write_model(&case, attenuation).display().to_string();
    let run = simulated_sines(&case, "0.1", &["--model", &model], "campaign");
    let found = case.path().join("found.toml").display().to_string();
    let diagnose = |arguments: &[&str], out: &str| {
        let out = case.path().join(out);
        let output = calfit().arg("diagnose").arg(&run).args(["--no-plots", "-o"]).arg(&out).args(arguments).output().unwrap();
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let json = fs::read_to_string(out.join("26-01-02_10-00-00/diagnosis.json")).unwrap();
        let made: serde_json::Value = serde_json::from_str(&json).unwrap();
        made["steps"].as_array().unwrap().iter().map(|s| s["effect"].as_str().unwrap().to_owned()).collect::<Vec<_>>()
    };
    assert_eq!(diagnose(&["--write-model", &found], "first"), ["eddy_current_attenuation"]);
    assert_eq!(diagnose(&["--model", &found], "second"), [""; 0]);
    let (file, _) = read_model(Path::new(&found)).unwrap();
    let value = |name: &str| {
        let e = &file.body.effect[0];
        let p = e.parameter.iter().chain(&e.shape).find(|p| p.name == name).unwrap();
        (p.value, p.std.unwrap_or(0.0))
    };
    let ((part, part_std), (hz, hz_std)) = (value("part"), value("f_c"));
    assert!((part - PART).abs() < 4.0 * part_std && (hz - POLE_HZ).abs() < 4.0 * hz_std, "{part} ± {part_std}, {hz} ± {hz_std}");
}

/// An even term of x in an offset run: of eight settings in every position two drive x by 200 nT, so that the zero level of x rises by
/// c2 (200 nT / σ)² / 4 in all of them, as an offset would.
#[test]
fn effects_of_the_reading_are_taken_off_offset_runs_and_others_are_named() {
    const C2: f64 = 1e-5;
    let zero = Truth::default().offset_ent;
    let fields = [offset_fields(), vec![[0.0; 3]]].concat();
    let plan = Plan {
        settings: in_positions(&[1, 2, 3, 4], &fields, 2.0),
        positions: POSITIONS.to_vec(),
        residual_nt: [4.0, -7.0, 11.0],
        ..Plan::default()
    };
    let clean = plan.run().key("kind", "\"offset\"");
    let run = clean.clone().each(|mut r| {
        r[0] += C2 * (r[0] - zero[0]).powi(2);
        r
    });
    let case = Case::of(clean.text());
    case.put("campaign.toml", position_table(&POSITIONS));
    let even = vec![parameter("c2_x", C2, Some(0.1 * C2), "enT/enT^2")];
    let drift = vec![parameter("p3_x", 1.0, None, "enT"), parameter("p4_x", 1.0, None, "enT")];
    let effects = vec![
        effect("quadratic_nonlinearity", "quadratic", &["x"], even, Vec::new()),
        effect("offset_drift", "polynomial", &["x"], drift, Vec::new()),
    ];
    let model = write_model(&case, effects);
    let offsets = |more: &[&str]| {
        let output = case.run("offset", &[&["--no-plots"], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let file = parameters(&case.out().join(RUN).join(format!("OFF_PARAMETER__{}.OPF", RUN.replace('_', "-"))));
        (file, text(&output.stderr))
    };
    let x = |file: &DocumentMut| (number(file, "offset_ent.0") - zero[0], number(file, "offset_std_ent.0"));

    let (_, std_ent) = x(&offsets(&[]).0);
    fs::write(case.file(), run.text()).unwrap();
    let (plain, _) = offsets(&[]);
    let (off_ent, _) = x(&plain);
    let level_ent = C2 * (200.0 / Truth::default().sigma[0]).powi(2) / 4.0;
    assert!(level_ent > 20.0 * std_ent && (off_ent - level_ent).abs() < 3.0 * std_ent, "{off_ent} ± {std_ent}, {level_ent}");
    assert!(plain.get("model").is_none());

    let (without, said) = offsets(&["--model", &model.display().to_string()]);
    let (off_ent, widened_ent) = x(&without);
    assert!(off_ent.abs() < 3.0 * std_ent, "{off_ent} ± {std_ent}");
    let expected_ent = std_ent.hypot(0.1 * level_ent);
    assert!((widened_ent / expected_ent - 1.0).abs() < 0.1, "{widened_ent} is not {expected_ent}");
    let covariance = |file: &DocumentMut| number(file, "covariance.matrix.0.0").sqrt();
    assert!((covariance(&without) / widened_ent - 1.0).abs() < 1e-9);
    says(&said, &["not taken off", "offset_drift"]);
    says(&without.to_string(), &["id = \"quadratic_nonlinearity\"", "left_out = [\"offset_drift x\"]"]);
    says(&without["convention"].to_string(), &["the effects of [model] were taken off B_r"]);
    let largest_nt = without["model"]["effect"][0]["largest_nt"].as_float().unwrap();
    // The residual field adds up to 11 nT to the fields, along x in two of the positions.
    let truth_nt = C2 * (211.0 / Truth::default().sigma[0]).powi(2) * Truth::default().sigma[0];
    assert!((largest_nt / truth_nt - 1.0).abs() < 0.01, "{largest_nt} is not {truth_nt}");
    // The file comes back from what it names.
    let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).arg(model.parent().unwrap()).output().unwrap();
    assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
}
