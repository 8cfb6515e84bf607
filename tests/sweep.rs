//! `calfit thermal` on continuous sweeps of an independent generator: temperature coefficients and lags come back.

use crate::common;

use calfit::files::twin::{self, Body, Twin};
use calfit::simulate::write_campaign;
use common::Truth;
use common::check::{Case, calfit, number, parameters, says, text};
use std::fs;
use std::path::Path;
use toml_edit::DocumentMut;

/// Analyses a case; its truth and its parameter file.
fn made(name: &str, arguments: &[&str]) -> (serde_json::Value, toml_edit::DocumentMut, String) {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    let truth = serde_json::from_str(&fs::read_to_string(data.join(format!("{name}.json"))).unwrap()).unwrap();
    let case = Case::new();
    case.put(&format!("{name}/10-00-00.CCR.gz"), fs::read(data.join(format!("{name}.CCR.gz"))).unwrap());
    // A second time into the same folder: the program knows its own files.
    case.run("thermal", &[&["--no-plots"], arguments].concat());
    let output = case.run("thermal", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let file = case.out().join(format!("{name}_10-00-00/THERMAL_PARAMETER__{name}-10-00-00.TPF"));
    (truth, parameters(&file), text(&output.stdout))
}

/// Coefficients and their standard uncertainties against the truth, in multiples of the latter.
fn compare(truth: &serde_json::Value, file: &toml_edit::DocumentMut) {
    let of = |key: &str, i: usize| truth["parameters"][key][i].as_f64().unwrap();
    for (i, component) in ["x", "y", "z"].into_iter().enumerate() {
        let sigma = of("sigma_at_0c", i);
        let xi = ["xy", "xz", "yz"][i];
        let wanted = [
            (format!("sigma_{component}"), vec![sigma, sigma * of("dsigma1", i), sigma * of("dsigma2", i)]),
            (format!("xi_{xi}"), vec![of("xi_deg", i), 0.0]),
            (format!("b_or_{component}"), vec![of("offset_ent", i), 0.0]),
        ];
        for (name, coefficients) in wanted {
            for (k, wanted) in coefficients.into_iter().enumerate() {
                let found = number(file, &format!("{name}.{k}"));
                let row = file["covariance"][&name].as_array().unwrap().get(k).unwrap().as_array().unwrap();
                let std = row.get(k).unwrap().as_float().unwrap().sqrt();
                assert!((found - wanted).abs() < 3.0 * std, "{name} {k}: {found} is not {wanted} within 3 x {std}");
            }
        }
    }
}

/// A value of the first thermistor that a lag was looked for.
fn lag(file: &toml_edit::DocumentMut, channel: &str, key: &str) -> f64 {
    let parts = file["sweep"]["lag"].as_array_of_tables().unwrap();
    let part = parts.iter().find(|p| p["channel"].as_str() == Some(channel)).unwrap();
    part[key].as_float().unwrap()
}

#[test]
fn coefficients_come_back_and_no_lag_is_found_where_there_is_none() {
    let (truth, file, stdout) = made("26-05-05", &["--order", "sigma=2", "--order", "b_or=1"]);
    compare(&truth, &file);
    assert!(stdout.contains("no lag"), "{stdout}");
    assert!(lag(&file, "TCSC", "delay_s").abs() < 60.0 && lag(&file, "TCSC", "time_constant_s").abs() < 60.0);
    assert_eq!(file["channel"].as_str(), Some("TCSC"));
}

#[test]
fn the_time_constant_of_the_sensor_is_found() {
    let (truth, file, stdout) = made("26-05-06", &["--order", "sigma=2", "--order", "b_or=1"]);
    let expected = truth["effects"]["thermal_lag"]["tau_s"].as_f64().unwrap();
    assert!((lag(&file, "TCSC", "time_constant_s") - expected).abs() < 60.0);
    assert!(stdout.contains("time constant"), "{stdout}");
    // Its form is told from a delay, and the other thermistor follows worse.
    assert!(lag(&file, "TCSC", "delay_over_first_order") < -10.0);
    assert!(lag(&file, "TCSC", "residual_std_ent") < lag(&file, "TSENS", "residual_std_ent"));
    compare(&truth, &file);
}

#[test]
fn fast_parts_are_left_out_and_windows_have_the_length_asked_for() {
    let (_, file, _) = made("26-05-05", &["--max-rate", "0.2", "--window", "20min"]);
    let part = &file["sweep"];
    let [used, fast] = ["settings_used", "settings_too_fast"].map(|key| part[key].as_integer().unwrap());
    assert!(used + fast == 720 && fast > 50 && used > 200, "{used} {fast}");
    assert_eq!(part["window"].as_str(), Some("20 min"));
}

/// The twin of the README, its sweep alone: sensitivities and angles are straight lines over 150 K, and its mount turns with the temperature.
fn demo() -> Twin {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs/demo.toml");
    let mut demo = twin::read(&path, &mut Vec::new()).unwrap();
    demo.runs.retain(|run| run.id == SWEEP);
    demo
}

const SWEEP: &str = "26-03-03_16-00-00";
const DEGC: [f64; 4] = [-10.0, 30.0, 70.0, 120.0];
const NAMES: [&str; 9] = ["sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz", "b_or_x", "b_or_y", "b_or_z"];

/// The nine parameters of a twin at a temperature of its sensor, in the order of the names. The residual field is seen as any other one.
fn truth(twin: &Twin, degc: f64) -> [f64; 9] {
    let sensor = &twin.sensors[0];
    let at = |polynomials: &[Vec<f64>; 3]| -> [f64; 3] {
        std::array::from_fn(|i| polynomials[i].iter().rev().fold(0.0, |sum, c| sum * degc + c))
    };
    let (sigma, xi_deg) = (at(&sensor.model.sigma), at(&sensor.model.xi_deg));
    let turned_deg = std::array::from_fn(|i| sensor.rotation_deg[i] + sensor.rotation_per_k_deg[i] * degc);
    let real = Truth { sigma, xi_deg, turned_deg, offset_ent: at(&sensor.model.b_off_ent), ..Truth::default() };
    let b_or = real.reading(twin.facility.residual[0].field_nt);
    [sigma, xi_deg, b_or].concat().try_into().unwrap()
}

/// The campaign of a twin with a seed.
fn campaign(twin: &Twin, seed: u64) -> Case {
    let case = Case::new();
    write_campaign(twin, seed, &case.campaign(), false, || ()).unwrap();
    case
}

/// What the temperature does within a window is no noise of its settings.
#[test]
fn windows_scatter_about_the_truth_as_their_uncertainties_say() {
    let twin = demo();
    let case = campaign(&twin, 11);
    swept(&case, &["--order", "sigma=1", "--order", "xi=1", "--order", "b_or=2", "--lag", "none"]);
    let table = fs::read_to_string(case.out().join(format!("{SWEEP}/SWEEP_WINDOWS__{SWEEP}.csv"))).unwrap();
    let mut lines = table.lines().filter(|line| !line.starts_with('#'));
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let rows: Vec<Vec<f64>> = lines.map(|line| line.split(',').map(|cell| cell.parse().unwrap_or(f64::NAN)).collect()).collect();
    let cell = |row: &[f64], name: &str| row[names.iter().position(|n| *n == name).unwrap()];
    // Every so many windows share no settings.
    let apart: Vec<&Vec<f64>> = rows.iter().step_by(24).collect();
    let rms = |of: &dyn Fn(&[f64]) -> f64| (apart.iter().map(|row| of(row).powi(2)).sum::<f64>() / apart.len() as f64).sqrt();
    let off = |row: &[f64], i: usize| {
        let wanted = truth(&twin, cell(row, "temperature_degc"))[i];
        [cell(row, NAMES[i]) / wanted - 1.0, cell(row, &format!("{}_std", NAMES[i])) / wanted.abs()]
    };
    // Offsets wander with the slow noise of the electronics, which many windows share: some ten of the thirty are independent, and tell a root mean
    // square to a fifth.
    for (i, limits) in [0, 1, 2].map(|i| (i, 0.7..1.4)).into_iter().chain([6, 7, 8].map(|i| (i, 0.55..1.5))) {
        let ratio = rms(&|row| off(row, i)[0] / off(row, i)[1]);
        println!("{}: rms of error over uncertainty {ratio:.2} of {} windows", NAMES[i], apart.len());
        assert!(limits.contains(&ratio), "{}: {ratio}", NAMES[i]);
    }
    let mean = rms(&|row| {
        let all = [0, 1, 2].map(|i| off(row, i));
        all.iter().map(|[error, _]| error).sum::<f64>() / all.iter().map(|[_, std]| std * std).sum::<f64>().sqrt()
    });
    println!("mean of the three: {mean:.2}");
    assert!((0.7..1.4).contains(&mean), "{mean}");
}

/// The parameter file of its sweep, and what the terminal said.
fn swept(case: &Case, arguments: &[&str]) -> (DocumentMut, String) {
    let out = case.out();
    let _ = fs::remove_dir_all(&out);
    let output = case.run("thermal", &[&["--no-plots"], arguments].concat());
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let name = SWEEP.replace('_', "-");
    (parameters(&out.join(format!("{SWEEP}/THERMAL_PARAMETER__{name}.TPF"))), text(&output.stdout))
}

/// A list of numbers.
fn list(item: &toml_edit::Value) -> Vec<f64> {
    item.as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect()
}

/// A quantity at a temperature and its standard uncertainty, as the file says.
fn stated(file: &DocumentMut, name: &str, degc: f64) -> (f64, f64) {
    let coefficients = list(file[name].as_value().unwrap());
    let covariance: Vec<Vec<f64>> = file["covariance"][name].as_array().unwrap().iter().map(list).collect();
    let powers: Vec<f64> = (0..coefficients.len()).map(|k| degc.powi(k as i32)).collect();
    let value: f64 = coefficients.iter().zip(&powers).map(|(c, p)| c * p).sum();
    let row = |r: &Vec<f64>| r.iter().zip(&powers).map(|(c, p)| c * p).sum::<f64>();
    let variance: f64 = covariance.iter().zip(&powers).map(|(r, p)| p * row(r)).sum();
    (value, variance.sqrt())
}

/// What the file says minus the truth, in its own standard uncertainties: per quantity one value at each of the four temperatures.
fn pulls(file: &DocumentMut, twin: &Twin) -> [[f64; 4]; 9] {
    let truths = DEGC.map(|degc| truth(twin, degc));
    std::array::from_fn(|k| {
        std::array::from_fn(|t| {
            let (value, std) = stated(file, NAMES[k], DEGC[t]);
            (value - truths[t][k]) / std
        })
    })
}

fn rms<'a>(values: impl IntoIterator<Item = &'a f64>) -> f64 {
    let (n, sum) = values.into_iter().fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
    (sum / n).sqrt()
}

/// A text of the lag that was applied.
fn decided<'a>(file: &'a DocumentMut, key: &str) -> Option<&'a str> {
    file["sweep"]["applied_lag"].get(key)?.as_str()
}

/// A number of it.
fn applied_s(file: &DocumentMut, key: &str) -> Option<f64> {
    file["sweep"]["applied_lag"].get(key)?.as_float()
}

/// A straight line that is asked for is one in the file, and what bends in Φ⁻¹ is no lag. Sensitivities were 10 uncertainties off where the
/// elements of Φ⁻¹ were straight lines.
#[test]
fn the_sweep_of_the_readme_is_right_within_its_uncertainty() {
    let demo = demo();
    let (mut all, mut turns) = (Vec::new(), Vec::new());
    for seed in 1..=7 {
        let case = campaign(&demo, seed);
        let (file, stdout) = swept(&case, &[]);
        let orders = NAMES.map(|name| file[name].as_array().unwrap().len() - 1);
        assert_eq!(orders, [1, 1, 1, 1, 1, 1, 2, 2, 2]);
        assert_eq!(decided(&file, "decision"), Some("none claimed"), "{seed}");
        assert_eq!((decided(&file, "form"), applied_s(&file, "std_s")), (Some("none"), None));
        says(&stdout, &["no lag claimed"]);
        // The mount turns by 2e-5° per kelvin.
        let [turned, std] = ["rotation_change_deg", "rotation_change_std_deg"].map(|key| file["sweep"][key].as_float().unwrap());
        let degc = list(file["valid_degc"].as_value().unwrap());
        turns.push((turned - (degc[1] - degc[0]) * 2e-5) / std);
        let pulls = pulls(&file, &demo);
        assert!(pulls.as_flattened().iter().all(|p| p.abs() < 5.0), "{seed}: {pulls:?}");
        all.push(pulls);
    }
    for (k, name) in NAMES.into_iter().enumerate() {
        println!("{name}: {:.2}", rms(all.iter().flat_map(|p| &p[k])));
    }
    let whole = rms(all.iter().flat_map(|p| p.as_flattened()));
    assert!((0.8..1.3).contains(&whole), "{whole}");
    // The root mean square of seven values is outside of this once in a thousand times.
    assert!((0.29..1.87).contains(&rms(&turns)), "{turns:?}");
}

/// The sweep begins within a ramp: the sensor is behind its thermistor already, as no reading says. Without a word the sensitivities were off by
/// many uncertainties.
#[test]
fn a_sweep_that_begins_within_a_ramp_is_right_with_a_lag() {
    let mut twin = demo();
    twin.thermal_box.sensor_time_constant_s = 480.0;
    twin.thermistors[0].of = Body::Box;
    // An hour and a half earlier than the sweep.
    twin.thermal_box.phases.last_mut().unwrap().from = "2026-03-03T14:30:00Z".parse().unwrap();
    let mut all = Vec::new();
    for seed in 1..=3 {
        let case = campaign(&twin, seed);
        let (file, _) = swept(&case, &[]);
        assert_eq!((decided(&file, "form"), decided(&file, "decision")), (Some("first order"), Some("found")), "{seed}");
        says(&file.to_string(), &["moves already at its first reading", "came from is not known"]);
        let [lag_s, std_s] = ["lag_s", "std_s"].map(|key| applied_s(&file, key).unwrap());
        assert!((lag_s - 480.0).abs() < 3.0 * std_s && std_s < 8.0, "{seed}: {lag_s} {std_s}");
        // The sweep reaches from 100 °C down to -20 °C.
        all.extend(pulls(&file, &twin).map(|[cold, cool, warm, _]| [cold, cool, warm]));
    }
    let whole = rms(all.as_flattened());
    println!("rms {whole:.2}");
    assert!((0.7..1.3).contains(&whole), "{whole}");
}

/// The same with a sensor that is later than its thermistor by five minutes: the first five minutes look like a part that was in equilibrium, and the
/// delay like a first order, as long as they count.
#[test]
fn a_sweep_that_begins_within_a_ramp_is_right_with_a_delay() {
    const DELAY_S: f64 = 300.0;
    let mut twin = demo();
    twin.thermal_box.phases.last_mut().unwrap().from = "2026-03-03T14:30:00Z".parse().unwrap();
    let mut all = Vec::new();
    for seed in 1..=3 {
        let case = campaign(&twin, seed);
        let run = case.campaign().join("26-03-03/16-00-00.CCR");
        let before = fs::read_to_string(&run).unwrap();
        let (head, rest) = before.split_once("@TEMPERATURES\n").unwrap();
        let (names, rest) = rest.split_once('\n').unwrap();
        let (table, rest) = rest.split_once("@").unwrap();
        let sooner = table.lines().filter_map(|row| {
            let (t_s, values) = row.split_once(',').unwrap();
            let t_s = t_s.parse::<f64>().unwrap() - DELAY_S;
            (t_s >= 0.0).then(|| format!("{t_s},{values}\n"))
        });
        let sooner: String = sooner.collect();
        fs::write(&run, format!("{head}@TEMPERATURES\n{names}\n{sooner}@{rest}")).unwrap();
        let (file, _) = swept(&case, &[]);
        assert_eq!((decided(&file, "form"), decided(&file, "decision")), (Some("delay"), Some("found")), "{seed}");
        let [lag_s, std_s] = ["lag_s", "std_s"].map(|key| applied_s(&file, key).unwrap());
        assert!((lag_s - DELAY_S).abs() < 3.0 * std_s && std_s < 8.0, "{seed}: {lag_s} {std_s}");
        all.extend(pulls(&file, &twin).map(|[cold, cool, warm, _]| [cold, cool, warm]));
    }
    let whole = rms(all.as_flattened());
    println!("rms {whole:.2}");
    assert!((0.7..1.3).contains(&whole), "{whole}");
}

/// The polynomials of a case, applied to the sweep itself: median size of modulus minus applied modulus over the settings, nT. In some settings there
/// are pulses of the heater.
fn off_nt(case: &Case) -> f64 {
    let run = case.campaign().join("26-03-03/16-00-00.CCR");
    let tpf = case.out().join(SWEEP).join("THERMAL_PARAMETER__26-03-03-16-00-00.TPF");
    let out = case.path().join("applied");
    let output = calfit().arg("apply").arg(tpf).arg(&run).arg("-o").arg(&out).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let table = fs::read(out.join("16-00-00.calibrated.parquet")).unwrap();
    let table = calfit::files::table::Table::from_parquet(&table).unwrap();
    let [t_s, x, y, z] =
        ["t", "bx_nt", "by_nt", "bz_nt"].map(|name| match &table.columns.iter().find(|(own, _)| own == name).unwrap().1 {
            calfit::files::table::Values::Numbers(values) => values.clone(),
            other => panic!("{other:?}"),
        });
    let settings = calfit::files::ccr::read(&run, &calfit::files::ccr::Options::default(), &mut ()).unwrap().settings;
    let mut off = Vec::new();
    for setting in &settings {
        let own = t_s.partition_point(|t| *t < setting.t_start_s)..t_s.partition_point(|t| *t < setting.t_end_s);
        let moduli = own.clone().map(|i| (x[i] * x[i] + y[i] * y[i] + z[i] * z[i]).sqrt()).filter(|b| b.is_finite());
        let (sum, count) = moduli.fold((0.0, 0.0), |(sum, count), b| (sum + b, count + 1.0));
        if count == own.len() as f64 {
            let applied = setting.field.0.iter().map(|b| b * b).sum::<f64>().sqrt();
            off.push((sum / count - applied).abs());
        }
    }
    // All but the begin, where the temperature of the sensor is not known: 20 K/h in 480 s are 2.7 K, of which a tenth of 0.02 K is left after 7.2
    // time constants, 58 min of 8 h.
    assert!(off.len() > settings.len() * 7 / 8 - 5, "{}", off.len());
    off.sort_by(f64::total_cmp);
    off[off.len() / 2]
}

/// Eight minutes between sensor and thermistor, either way, are found, and the coefficients are as right as without; without the lag they are
/// not, and with the lag given they are right again.
#[test]
fn a_lag_of_eight_minutes_is_found_given_or_left_out() {
    let mut all = Vec::new();
    for (form, arguments) in [("first order", "first-order=480"), ("inverse first order", "inverse=480")] {
        let mut twin = demo();
        if form == "first order" {
            twin.thermal_box.sensor_time_constant_s = 480.0;
            twin.thermistors[0].of = Body::Box;
        } else {
            twin.thermistors[0].time_constant_s = 480.0;
        }
        for seed in 1..=3 {
            let case = campaign(&twin, seed);
            let (file, stdout) = swept(&case, &[]);
            assert_eq!((decided(&file, "form"), decided(&file, "decision")), (Some(form), Some("found")));
            let [lag_s, std_s] = ["lag_s", "std_s"].map(|key| applied_s(&file, key).unwrap());
            assert!((lag_s - 480.0).abs() < 3.0 * std_s && std_s < 5.0, "{form} {seed}: {lag_s} {std_s}");
            says(&stdout, &["time constant"]);
            let own = pulls(&file, &twin);
            println!("{form}, seed {seed}: {lag_s:.1} ± {std_s:.1} s, rms {:.2}", rms(own.as_flattened()));
            all.extend(own);
            if seed > 1 {
                continue;
            }
            // Noise of a mean and scatter of the source are 0.05 nT; 2.7 K more or less would be 2.4 nT.
            assert!(off_nt(&case) < 0.1, "{}", off_nt(&case));
            let (without, _) = swept(&case, &["--lag", "none"]);
            assert_eq!(decided(&without, "decision"), Some("not looked for"));
            says(
                &without["warnings"].to_string(),
                &["explains the readings, but --lag none was given", "times its stated uncertainty"],
            );
            assert!(rms(pulls(&without, &twin)[..3].as_flattened()) > 5.0);
            let (given, stdout) = swept(&case, &["--lag", arguments]);
            assert_eq!(decided(&given, "decision"), Some("given"));
            assert_eq!((applied_s(&given, "lag_s"), applied_s(&given, "std_s")), (Some(480.0), None));
            says(&stdout, &["8.000 min", "as given"]);
            assert!(pulls(&given, &twin).as_flattened().iter().all(|p| p.abs() < 5.0));
            // A lag that is exact leaves less open than one that is found.
            let sigma = |file: &DocumentMut| list(file["covariance"]["sigma_x"].as_array().unwrap().get(0).unwrap())[0];
            assert!(sigma(&given) < sigma(&file));
            let verified = calfit().arg("verify").arg(case.out()).arg(case.campaign()).output().unwrap();
            assert_eq!(verified.status.code(), Some(0), "{}", text(&verified.stderr));
        }
    }
    // One lag that is off moves all of them: the uncertainty must cover that.
    let whole = rms(all.as_flattened());
    assert!(whole < 1.3 && all.as_flattened().iter().all(|p| p.abs() < 5.0), "{whole}");
}

/// The sweep goes down for four hours and up again, and its thermistor reads half a kelvin more or less from there on. That passed for a lag, and the
/// sensitivities were off by many uncertainties.
#[test]
fn a_jump_of_the_thermistor_where_the_temperature_turns_is_no_lag() {
    const TURN_S: f64 = 4.0 * 3600.0;
    let mut twin = demo();
    let mut back = *twin.thermal_box.phases.last().unwrap();
    back.from = "2026-03-03T20:00:00Z".parse().unwrap();
    back.target_degc = 130.0;
    twin.thermal_box.phases.push(back);
    for (seed, by_k) in [(1, 0.5), (2, -0.5), (3, 0.0)] {
        let case = campaign(&twin, seed);
        change_thermistor(&case, |t_s, degc| degc + if t_s > TURN_S + 30.0 { by_k } else { 0.0 });
        let (file, _) = swept(&case, &[]);
        let told = file.to_string().contains("temperature channel T59 jumps");
        assert_eq!((told, decided(&file, "decision")), (by_k != 0.0, Some("none claimed")), "{by_k}");
        if told {
            says(&file.to_string(), &[if by_k > 0.0 { " by +0." } else { " by -0." }]);
        }
        // The sweep reaches from 130 °C down to 50 °C.
        let own = pulls(&file, &twin).map(|[.., warm, hot]| [warm, hot]);
        println!("{by_k} K: rms {:.2}", rms(own.as_flattened()));
        assert!(own.as_flattened().iter().all(|p| p.abs() < 5.0), "{by_k}: {own:?}");
    }
}

/// Changes the readings of the thermistor of the sweep, of the time (s) and the reading.
fn change_thermistor(case: &Case, change: impl Fn(f64, f64) -> f64) {
    let run = case.campaign().join("26-03-03/16-00-00.CCR");
    let before = fs::read_to_string(&run).unwrap();
    let (head, rest) = before.split_once("@TEMPERATURES\n").unwrap();
    let (names, rest) = rest.split_once('\n').unwrap();
    assert!(names.starts_with("t,T59,"), "{names}");
    let (table, rest) = rest.split_once('@').unwrap();
    let rows = table.lines().map(|row| {
        let [t_s, t59, others] = row.splitn(3, ',').collect::<Vec<_>>().try_into().unwrap();
        let number = |text: &str| text.parse::<f64>().unwrap();
        format!("{t_s},{:.3},{others}\n", change(number(t_s), number(t59)))
    });
    fs::write(&run, format!("{head}@TEMPERATURES\n{names}\n{}@{rest}", rows.collect::<String>())).unwrap();
}

/// A sensitivity that bends as that of CHAMP is asked for as a straight line: the line is off by many of its uncertainties, which must be said.
#[test]
fn orders_that_are_too_low_are_told() {
    let mut twin = demo();
    twin.sensors[0].model.sigma[0].push(-3.5e-8);
    let case = campaign(&twin, 3);
    let (file, _) = swept(&case, &["--order", "sigma=1", "--lag", "none"]);
    let warnings = file["warnings"].to_string();
    says(&warnings, &["the orders that were asked for are too low: the next coefficient of sigma_x is up to "]);
    assert!(pulls(&file, &twin)[0].iter().any(|pull| pull.abs() > 10.0));
    let (file, _) = swept(&case, &["--order", "sigma=2"]);
    assert!(!file.to_string().contains("orders that were asked for"));
    assert!(pulls(&file, &twin)[0].iter().all(|pull| pull.abs() < 5.0));
}

/// One of many settings that is off by 100 enT makes all uncertainties many times as large: which one it is must be said.
#[test]
fn a_disturbed_setting_is_told() {
    let twin = demo();
    let case = campaign(&twin, 3);
    let (sound, _) = swept(&case, &[]);
    assert!(!sound.to_string().contains("stand out"));
    let run = case.campaign().join("26-03-03/16-00-00.CCR");
    let before = fs::read_to_string(&run).unwrap();
    let (head, vectors) = before.split_once("@VECTORS\n").unwrap();
    let settings = head.split_once("@FIELDS\n").unwrap().1;
    let times = |row: &str| -> Option<[f64; 2]> {
        let mut cells = row.split(',').map(str::parse::<f64>);
        Some([cells.next()?.ok()?, cells.next()?.ok()?])
    };
    let [begin_s, end_s] = settings.lines().filter_map(times).nth(200).unwrap();
    let disturbed = vectors.lines().map(|line| {
        let cells: Vec<&str> = line.split(',').collect();
        let is_inside = cells.get(1).and_then(|t| t.parse().ok()).is_some_and(|t: f64| begin_s < t && t < end_s);
        match (is_inside, cells.as_slice()) {
            (true, [n, t, x, y, z]) => format!("{n},{t},{:.3},{y},{z}\n", x.parse::<f64>().unwrap() + 100.0),
            _ => format!("{line}\n"),
        }
    });
    fs::write(&run, format!("{head}@VECTORS\n{}", disturbed.collect::<String>())).unwrap();
    let (file, _) = swept(&case, &[]);
    let warnings = file["warnings"].to_string();
    let told = warnings.split_once("settings at ").unwrap().1.split_once(" s").unwrap().0;
    let at_s: f64 = told.parse().unwrap();
    assert!(begin_s < at_s && at_s < end_s, "{told}: {begin_s} to {end_s}");
}

/// The first reading of the thermistor, or the last one, is off by a kelvin while the temperature moves: it is taken from the course of the others, no
/// lag is claimed, and the polynomials are right.
#[test]
fn a_wrong_reading_at_an_end_is_no_lag() {
    let twin = demo();
    let case = campaign(&twin, 4);
    let (sound, _) = swept(&case, &[]);
    assert!(!sound.to_string().contains("off the course of those beside it"));
    for is_first in [true, false] {
        let case = campaign(&twin, 4);
        let times = std::cell::RefCell::new(Vec::new());
        change_thermistor(&case, |t_s, degc| {
            times.borrow_mut().push(t_s);
            degc
        });
        let times = times.into_inner();
        let wrong_s = if is_first { times[0] } else { times[times.len() - 1] };
        change_thermistor(&case, |t_s, degc| if t_s == wrong_s { degc - 1.0 } else { degc });
        let (file, _) = swept(&case, &[]);
        says(&file.to_string(), &[&format!("the reading of T59 at {wrong_s:.0} s is -"), "the sensor follows that course"]);
        assert_eq!(decided(&file, "decision"), decided(&sound, "decision"));
        assert!(pulls(&file, &twin).as_flattened().iter().all(|p| p.abs() < 5.0), "{is_first}");
    }
}

/// A thermistor that drifts by a kelvin while the temperature goes down and up again splits the branches as a lag does; it explains the readings better,
/// which is said, and no lag is claimed.
#[test]
fn a_thermistor_that_drifts_is_no_lag() {
    let mut twin = demo();
    let mut back = *twin.thermal_box.phases.last().unwrap();
    back.from = "2026-03-03T20:00:00Z".parse().unwrap();
    back.target_degc = 130.0;
    twin.thermal_box.phases.push(back);
    let case = campaign(&twin, 1);
    change_thermistor(&case, |t_s, degc| degc + t_s / (8.0 * 3600.0));
    let (file, _) = swept(&case, &[]);
    assert_eq!(decided(&file, "decision"), Some("none claimed"));
    says(&file.to_string(), &["T59 that drifts by ", "explains them better; the polynomials are without either"]);
}

#[test]
fn what_is_no_lag_is_refused() {
    let case = Case::new();
    for lag in ["late", "first-order=-480", "inverse=0", "nan"] {
        let output = case.run("thermal", &["--lag", lag]);
        assert_eq!(output.status.code(), Some(2), "{lag}");
        says(&text(&output.stderr), &["first-order=SECONDS"]);
    }
}

#[test]
fn the_uncertainty_of_the_facility_is_in_the_polynomials_of_a_sweep() {
    let data = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data/cases");
    let fitted = |scale: f64| {
        let case = Case::new();
        case.put("26-05-05/10-00-00.CCR.gz", fs::read(data.join("26-05-05.CCR.gz")).unwrap());
        // The three coils have one error: that of the scalar magnetometer, for example.
        let text = format!(
            "scale_nt_per_eu = [{scale:?}, {scale:?}, {scale:?}]\noffset_nt = [0.0, 0.0, 0.0]\nangles_deg = [90.0, 90.0, 90.0]\n[covariance]\n\
             parameters = [\"scale_x\", \"scale_y\", \"scale_z\"]\nmatrix = [[1e-10, 1e-10, 1e-10], [1e-10, 1e-10, 1e-10], [1e-10, 1e-10, 1e-10]]\n"
        );
        let facility = case.put("facility.toml", text);
        let arguments = ["--no-plots", "--order", "sigma=2", "--order", "b_or=1", "--facility", facility.to_str().unwrap()];
        let output = case.run("thermal", &arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text_of(&output));
        parameters(&case.out().join("26-05-05_10-00-00/THERMAL_PARAMETER__26-05-05-10-00-00.TPF"))
    };
    let (file, moved) = (fitted(1.0), fitted(1.0 + 1e-5));
    let together = |a: &str, b: &str| {
        let names = file["together_combined"]["parameters"].as_array().unwrap();
        let [row, column] = [a, b].map(|name| names.iter().position(|n| n.as_str() == Some(name)).unwrap());
        file["together_combined"]["matrix"][row][column].as_float().unwrap()
    };
    // Both sensitivities have the one error of the coils, which is far above their own and makes them go together.
    let correlation =
        together("sigma_x.0", "sigma_y.0") / (together("sigma_x.0", "sigma_x.0") * together("sigma_y.0", "sigma_y.0")).sqrt();
    let shared = |name: &str| {
        let entry = |table: &str| file[table][name][0][0].as_float().unwrap();
        (entry("covariance_b") / entry("covariance_combined")).sqrt()
    };
    assert!((correlation / (shared("sigma_x") * shared("sigma_y")) - 1.0).abs() < 0.05, "{correlation}");
    for component in ["x", "y", "z"] {
        let name = format!("sigma_{component}");
        // The square is 1e-13 of the sensitivity and no digit of the search.
        for k in 0..2 {
            let entry = |table: &str| {
                let row = file[table][&name].as_array().unwrap().get(k).unwrap().as_array().unwrap();
                row.get(k).unwrap().as_float().unwrap()
            };
            let by = number(&moved, &format!("{name}.{k}")) - number(&file, &format!("{name}.{k}"));
            assert!(
                (entry("covariance_b").sqrt() / by.abs() - 1.0).abs() < 0.02,
                "{name} {k}: {} {by}",
                entry("covariance_b").sqrt()
            );
            let sum = entry("covariance") + entry("covariance_b");
            assert!((entry("covariance_combined") / sum - 1.0).abs() < 1e-12);
            let coefficient = format!("{name}.{k}");
            assert!((together(&coefficient, &coefficient) / sum - 1.0).abs() < 1e-12);
        }
    }
}

fn text_of(output: &std::process::Output) -> String {
    text(&output.stderr)
}

/// Run 13 of the twin of March 1998: 24 hours in units of the facility, whose coils and rack take part in the temperatures of the hall, and a
/// sensor that follows its thermistor with eight minutes while dry ice cools it by a kelvin a minute.
#[test]
fn a_day_of_march_1998_is_right_with_its_facility() {
    const DEGC: [f64; 5] = [-30.0, -10.0, 0.0, 10.0, 25.0];
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut twin = twin::read(&root.join("configs/champ-1998.toml"), &mut Vec::new()).unwrap();
    twin.runs.retain(|run| run.id == "98-03-24_11-51-00");
    let facility = root.join("tests/data/champ/facility.toml");
    let (mut values, mut slopes) = (Vec::new(), Vec::new());
    for seed in 4..=6 {
        let case = campaign(&twin, seed);
        // The orders of section 8. Those of the angles are the program's choice: their squares are two standard uncertainties, and where the
        // choice left them out their slopes were off by 5.8.
        let orders = ["--order", "sigma=2", "--order", "b_or=3"];
        let arguments = [&["--no-plots", "--facility", facility.to_str().unwrap()], orders.as_slice()].concat();
        let output = case.run("thermal", &arguments);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let file = parameters(&case.out().join("98-03-24_11-51-00/THERMAL_PARAMETER__98-03-24-11-51-00.TPF"));
        assert_eq!(decided(&file, "form"), Some("first order"));
        let [lag_s, std_s] = ["lag_s", "std_s"].map(|key| applied_s(&file, key).unwrap());
        assert!((lag_s - 480.0).abs() < 3.0 * std_s, "{lag_s} {std_s}");
        // The gain that lags behind the thermistor in the fast cooling is no jump of it.
        assert!(!file["warning_kinds"].to_string().contains("gain_jump"), "{}", file["warnings"]);
        let model = &twin.sensors[0].model;
        let truths = [&model.sigma[..], &model.xi_deg[..]].concat();
        for (name, truth) in NAMES.into_iter().zip(&truths) {
            let coefficients = list(file[name].as_value().unwrap());
            let covariance: Vec<Vec<f64>> = file["covariance"][name].as_array().unwrap().iter().map(list).collect();
            let pull = |weight: &dyn Fn(i32) -> f64| {
                let weights: Vec<f64> = (0..coefficients.len() as i32).map(weight).collect();
                let off = |i: usize| coefficients[i] - truth.get(i).unwrap_or(&0.0);
                let sum: f64 = weights.iter().enumerate().map(|(i, w)| w * off(i)).sum();
                let row = |r: &Vec<f64>| r.iter().zip(&weights).map(|(c, w)| c * w).sum::<f64>();
                sum / covariance.iter().zip(&weights).map(|(r, w)| w * row(r)).sum::<f64>().sqrt()
            };
            values.extend(DEGC.map(|t| pull(&|i| t.powi(i))));
            slopes.extend(DEGC.map(|t| pull(&|i| if i == 0 { 0.0 } else { f64::from(i) * t.powi(i - 1) })));
        }
    }
    println!("values {:.2}, slopes {:.2}", rms(&values), rms(&slopes));
    for pulls in [values, slopes] {
        assert!((0.7..1.3).contains(&rms(&pulls)) && pulls.iter().all(|p| p.abs() < 5.0), "{pulls:?}");
    }
}

/// A lag of a minute in a ramp of 20 K/h that goes one way shifts all temperatures by a third of a kelvin, which no residual shows: the file says
/// what that does, and so much it does.
#[test]
fn a_lag_that_would_not_show_is_told_with_what_it_does() {
    let mut twin = demo();
    twin.thermal_box.sensor_time_constant_s = 60.0;
    twin.thermistors[0].of = Body::Box;
    // The ramp begins before the sweep and ends after it.
    let ramp = twin.thermal_box.phases.last_mut().unwrap();
    (ramp.from, ramp.target_degc) = ("2026-03-03T14:30:00Z".parse().unwrap(), -80.0);
    let case = campaign(&twin, 1);
    let (file, _) = swept(&case, &[]);
    assert_eq!(decided(&file, "decision"), Some("none claimed"));
    let warnings = file["warnings"].as_array().unwrap();
    let said = warnings.iter().find_map(|w| w.as_str()?.split_once("one of 60 s would change ")).unwrap().1;
    let (quantity, said) = said.split_once(" by ").unwrap();
    let told: f64 = said.split_once(" times its stated uncertainty").unwrap().0.parse().unwrap();
    let k = NAMES.iter().position(|name| *name == quantity).unwrap();
    assert!(k < 3, "{quantity}");
    // Five temperatures of the ramp, from its ends on.
    let stds = [100.0, 60.0, 20.0, -20.0, -60.0].map(|degc| stated(&file, quantity, degc).1);
    let least = stds.into_iter().fold(f64::INFINITY, f64::min);
    let expected = (twin.sensors[0].model.sigma[k][1] / 3.0).abs() / least;
    let own = pulls(&file, &twin)[k];
    println!("{quantity}: told {told}, expected {expected:.1}, off by {own:.1?}");
    assert!((told / expected - 1.0).abs() < 0.1, "{told} {expected}");
    // Without a word the sensitivity would be off by that, but for its noise.
    let most = own.iter().fold(0.0_f64, |most, pull| most.max(pull.abs()));
    assert!((most - told).abs() < 0.2 * told + 4.0, "{told} {own:?}");
    let (given, _) = swept(&case, &["--lag", "first-order=60"]);
    assert!(!given.to_string().contains("would change"));
    assert!(pulls(&given, &twin)[k].iter().all(|pull| pull.abs() < 5.0));
}
