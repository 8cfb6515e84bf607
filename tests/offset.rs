//! `calfit offset`: offsets and residual fields come back with their signs, and what the positions do not tell is refused by name.

use crate::common;

use common::check::{Case, close, number, parameters, says, text, three};
use common::{POSITIONS, Plan, Setting, Truth, in_positions, offset_fields};
use toml_edit::DocumentMut;

/// Three orientations of the ambient runs of CH-GFZ-TR-2601.
const TILTS: [(u32, [&str; 3]); 3] = [(1, ["+X", "+Y", "+Z"]), (2, ["-Y", "+X", "+Z"]), (3, ["-Z", "+Y", "+X"])];

/// Zero field and, with steps, ±200 nT on each axis in every position, plateaus of 4 s.
fn programme(positions: &[u32], steps: bool) -> Vec<Setting> {
    let mut fields = if steps { offset_fields() } else { vec![[0.0; 3]] };
    fields.push([0.0; 3]);
    in_positions(positions, &fields, 4.0)
}

fn plan(positions: &[(u32, [&'static str; 3])], order: &[u32]) -> Plan {
    Plan {
        settings: programme(order, true),
        positions: positions.to_vec(),
        residual_nt: [4.0, -7.0, 11.0],
        noise_ent: 0.09,
        ..Plan::default()
    }
}

fn case(plan: &Plan) -> Case {
    let case = Case::of(plan.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"").text());
    let tables: Vec<String> =
        plan.positions.iter().map(|(id, axes)| format!("[[position]]\nid = {id}\naxes = {axes:?}\n")).collect();
    case.put("campaign.toml", tables.join("\n"));
    case
}

fn opf(case: &Case) -> DocumentMut {
    parameters(&case.out().join("13-04-03_09-22-38/OFF_PARAMETER__13-04-03-09-22-38.OPF"))
}

fn measure(plan: &Plan) -> DocumentMut {
    let case = case(plan);
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    opf(&case)
}

/// Half the difference of the residual field's readings in a normal and a turned position, from the forward model of the test.
fn residual_ent(plan: &Plan, component: usize, normal: u32, turned: u32) -> f64 {
    let read = |position: u32| {
        let axes = plan.positions.iter().find(|(id, _)| *id == position).unwrap().1;
        Truth { axes, ..plan.truth.clone() }.reading(plan.residual_nt)[component]
    };
    (read(normal) - read(turned)) / 2.0
}

#[track_caller]
fn within(found: f64, truth: f64, std: f64) {
    assert!(std > 0.0 && (found - truth).abs() < 3.0 * std, "{found} is not {truth} within three times {std}");
}

#[test]
fn four_positions_give_offset_and_residual_field_within_three_standard_deviations() {
    for seed in 1..=5 {
        let plan = Plan { seed, ..plan(&POSITIONS, &[1, 2, 3, 4]) };
        let opf = measure(&plan);
        for (i, (normal, turned)) in [(1, 2), (1, 2), (3, 4)].into_iter().enumerate() {
            within(
                number(&opf, &format!("offset_ent.{i}")),
                plan.truth.offset_ent[i],
                number(&opf, &format!("offset_std_ent.{i}")),
            );
            let std = number(&opf, &format!("residual_std_ent.{i}"));
            within(number(&opf, &format!("residual_ent.{i}")), residual_ent(&plan, i, normal, turned), std);
            assert!(std < 0.02, "the mean of seconds of data is known better than {std} enT");
            within(
                number(&opf, &format!("residual_coil_nt.{i}")),
                plan.residual_nt[i],
                number(&opf, &format!("residual_coil_std_nt.{i}")),
            );
        }
    }
}

#[test]
fn three_tilts_give_offset_and_residual_field_within_three_standard_deviations() {
    for seed in 1..=5 {
        let plan = Plan { seed, ..plan(&TILTS, &[1, 2, 3]) };
        let opf = measure(&plan);
        for i in 0..3 {
            within(
                number(&opf, &format!("offset_ent.{i}")),
                plan.truth.offset_ent[i],
                number(&opf, &format!("offset_std_ent.{i}")),
            );
            within(
                number(&opf, &format!("residual_coil_nt.{i}")),
                plan.residual_nt[i],
                number(&opf, &format!("residual_coil_std_nt.{i}")),
            );
            assert_eq!(opf["method"]["component"][i].as_str(), Some("tilted"));
        }
    }
}

#[test]
fn signs_are_those_of_the_definition() {
    let ideal = Truth { sigma: [1.0; 3], xi_deg: [90.0; 3], turned_deg: [0.0; 3], offset_ent: [0.0; 3], ..Truth::default() };
    // An offset shows in its own component and nowhere else.
    for axis in 0..3 {
        let mut offset_ent = [0.0; 3];
        offset_ent[axis] = 10.0;
        let truth = Truth { offset_ent, ..ideal.clone() };
        let opf = measure(&Plan { truth, residual_nt: [0.0; 3], ..plan(&POSITIONS, &[1, 2, 3, 4]) });
        close(three(&opf, "offset_ent"), offset_ent, 0.1);
        close(three(&opf, "residual_ent"), [0.0; 3], 0.1);
    }
    // A residual field on X_c shows in x with its sign, and in z with the other one, as Z_m = -X_c in position 3; one on Z_c in none.
    let seen = [[10.0, 0.0, -10.0], [0.0, 10.0, 0.0], [0.0, 0.0, 0.0]];
    for (axis, expected) in seen.into_iter().enumerate() {
        let mut residual_nt = [0.0; 3];
        residual_nt[axis] = 10.0;
        let opf = measure(&Plan { truth: ideal.clone(), residual_nt, ..plan(&POSITIONS, &[1, 2, 3, 4]) });
        close(three(&opf, "offset_ent"), [0.0; 3], 0.1);
        close(three(&opf, "residual_ent"), expected, 0.1);
        close(three(&opf, "residual_coil_nt"), residual_nt, 0.1);
        let axes: Vec<&str> = (0..3).map(|i| opf["method"]["normal_axis"][i].as_str().unwrap()).collect();
        assert_eq!(axes, ["+X", "+Y", "-X"]);
    }
}

#[test]
fn a_component_without_a_turned_position_is_refused_by_name_and_the_others_are_delivered() {
    let plan = plan(&POSITIONS, &[1, 2]);
    let case = case(&plan);
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["component z", "+Z", "turned", "the other way"]);
    let opf = opf(&case);
    assert!(number(&opf, "offset_ent.2").is_nan() && number(&opf, "residual_ent.2").is_nan());
    for i in 0..2 {
        // The residual field along Z_c stays unknown and enters with the small angles between the sensor and that axis: the
        // uncertainty holds it.
        let leak = Truth { axes: POSITIONS[0].1, ..plan.truth.clone() }.response()[i][2] * plan.residual_nt[2];
        let std = number(&opf, &format!("offset_std_ent.{i}"));
        within(number(&opf, &format!("offset_ent.{i}")), plan.truth.offset_ent[i], std);
        assert!(std > 0.5 * leak.abs(), "{std} does not hold {leak}");
        assert!(number(&opf, &format!("residual_std_ent.{i}")) > 0.0);
    }
    says(&opf["warnings"].to_string(), &["along Z_c is not determined", "enT per nT in x"]);
    assert_eq!(opf["refused"][0]["component"].as_str(), Some("z"));
}

#[test]
fn one_position_alone_is_refused() {
    let case = case(&plan(&POSITIONS, &[1]));
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["no component has an offset", "x:", "y:", "z:", "turned position"]);
    assert!(!case.out().join("13-04-03_09-22-38").exists());
}

#[test]
fn a_drift_between_positions_is_estimated_where_they_repeat() {
    let plan = plan(&POSITIONS, &[1, 2, 3, 4, 1, 2]);
    let per_s = [0.01, -0.02, 0.005];
    let run = plan.run();
    let samples = run.samples.clone();
    let mut drifting = run.key("kind", "\"offset\"");
    for (to, from) in drifting.samples.iter_mut().zip(samples) {
        to.reading = std::array::from_fn(|i| from.reading[i] + per_s[i] * from.t);
    }
    let case = case(&plan);
    case.put(common::RUN_FILE, drifting.text());
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let opf = opf(&case);
    for i in 0..3 {
        within(
            number(&opf, &format!("drift.ent_per_h.{i}")),
            3600.0 * per_s[i],
            number(&opf, &format!("drift.std_ent_per_h.{i}")),
        );
        let at_reference = plan.truth.offset_ent[i] + per_s[i] * number(&opf, "drift.reference_s");
        within(number(&opf, &format!("offset_ent.{i}")), at_reference, number(&opf, &format!("offset_std_ent.{i}")));
    }
}

#[test]
fn zero_field_alone_is_enough_for_a_sensor_on_the_nominal_axes() {
    // What a sensitivity is nobody knows where no field is applied: the residual field in nT is read with 1 nT/enT.
    let truth = Truth { xi_deg: [90.0; 3], turned_deg: [0.0; 3], sigma: [1.04, 0.97, 1.05], ..Truth::default() };
    let plan =
        Plan { truth, settings: programme(&[1, 2, 3, 4], false), residual_nt: [40.0, -70.0, 110.0], ..plan(&POSITIONS, &[1]) };
    let opf = measure(&plan);
    for i in 0..3 {
        within(number(&opf, &format!("offset_ent.{i}")), plan.truth.offset_ent[i], number(&opf, &format!("offset_std_ent.{i}")));
        let residual = |key: &str| number(&opf, &format!("{key}.{i}"));
        within(residual("residual_coil_nt"), plan.residual_nt[i], residual("residual_coil_std_nt"));
        let variance = number(&opf, &format!("covariance.matrix.{0}.{0}", 3 + i));
        assert!((variance.sqrt() / residual("residual_coil_std_nt") - 1.0).abs() < 1e-9);
    }
    says(&opf["warnings"].to_string(), &["fields were not applied along all axes", "sensitivities of 1 within 5 %"]);
}

/// A field that changes with every turn and comes back with its position: three visits to each position know no more of the offset than one.
#[test]
fn what_belongs_to_a_position_is_no_noise_of_its_visits() {
    let jumps_ent = [[2.0, -1.0, 1.5], [-1.5, 2.5, 0.5], [0.5, 1.5, -2.0], [-1.0, -2.0, 1.0]];
    let std_ent = |order: &[u32]| {
        let still = plan(&POSITIONS, order);
        let visit_s = still.settings.last().unwrap().t_end / order.len() as f64;
        let mut run = still.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"");
        for sample in &mut run.samples {
            let visit = ((sample.t / visit_s) as usize).min(order.len() - 1);
            for (value, jump) in sample.reading.iter_mut().zip(jumps_ent[order[visit] as usize - 1]) {
                *value += jump;
            }
        }
        let case = case(&still);
        case.put(common::RUN_FILE, run.text());
        let output = case.run("offset", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        three(&opf(&case), "offset_std_ent")
    };
    let (once, thrice) = (std_ent(&[1, 2, 3, 4]), std_ent(&[1, 2, 3, 4, 1, 2, 3, 4, 1, 2, 3, 4]));
    for (once, thrice) in once.into_iter().zip(thrice) {
        assert!((0.75..1.33).contains(&(thrice / once)), "{once} {thrice}");
    }
}

#[test]
fn offsets_in_nanotesla_follow_with_a_linear_calibration() {
    let plan = plan(&POSITIONS, &[1, 2, 3, 4]);
    let case = case(&plan);
    case.put("13-04-03/10-00-00.CCR", common::good().named("13-04-03_10-00-00").text());
    assert_eq!(case.run("lin", &["--no-plots"]).status.code(), Some(0));
    let cpf = case.out().join("13-04-03_10-00-00/PARAMETER_LIN__13-04-03_10-00-00.CPF");
    let output = case.run("offset", &["--no-plots", "--cpf", cpf.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let opf = opf(&case);
    let sigma = common::check::sigma(&parameters(&cpf));
    for i in 0..3 {
        let expected = sigma[i] * number(&opf, &format!("offset_ent.{i}"));
        assert!((number(&opf, &format!("scaled.offset_nt.{i}")) - expected).abs() < 1e-12);
    }
    assert!(!text(&output.stderr).contains("made with the sensitivities of"), "{}", text(&output.stderr));
    // The sensitivities of another temperature are not those of this run.
    let mut warmer = common::good().named("13-04-03_11-00-00");
    warmer.temperatures.iter_mut().for_each(|(_, [_, sensor])| *sensor = Some(80.0));
    case.put("13-04-03/11-00-00.CCR", warmer.text());
    assert_eq!(case.run("lin", &["--no-plots"]).status.code(), Some(0));
    let cpf = case.out().join("13-04-03_11-00-00/PARAMETER_LIN__13-04-03_11-00-00.CPF");
    let output = case.run("offset", &["--no-plots", "--cpf", cpf.to_str().unwrap()]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["made with the sensitivities of", "at 80.0 °C, 55.5 K from the temperature of this run"]);
}

#[test]
fn a_position_that_is_not_what_the_table_says_is_refused() {
    let plan = plan(&POSITIONS, &[1, 2, 3, 4]);
    let case = case(&plan);
    case.put(
        "campaign.toml",
        "position = [{id = 1, axes = [\"+X\",\"+Y\",\"+Z\"]}, {id = 2, axes = [\"+X\",\"+Y\",\"+Z\"]}, \
         {id = 3, axes = [\"-Z\",\"-Y\",\"-X\"]}, {id = 4, axes = [\"-Z\",\"+Y\",\"+X\"]}]",
    );
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(1));
    says(&text(&output.stderr), &["position 2", "component x", "enT/nT", "position table"]);
}

/// An offset has no single temperature where the sensor warms from one position to the next.
#[test]
fn an_offset_run_during_which_the_temperature_moves_says_so() {
    let moving = plan(&POSITIONS, &[1, 2, 3, 4]);
    let case = case(&moving);
    let said = |step_k: f64| {
        let mut run = moving.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"");
        run.temperatures.iter_mut().enumerate().for_each(|(i, t)| t.1 = [Some(20.5), Some(24.0 + step_k * i as f64)]);
        case.put(common::RUN_FILE, run.text());
        let output = case.run("offset", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    says(&said(3.0), &["the sensor temperature moved by", "K during the run"]);
    assert!(!said(0.2).contains("the sensor temperature moved"));
}

/// Offsets that follow a temperature which rises by 0.8 K in the run are told at the temperatures of the visits that show them: x in the first two of
/// four, y in the first three, z in the last two.
#[test]
fn an_offset_that_follows_the_temperature_holds_at_that_of_its_visits() {
    let slopes = [0.05, -0.03, 0.04];
    for seed in 1..=5 {
        let moving = Plan { seed, ..plan(&POSITIONS, &[1, 2, 3, 4]) };
        let end_s = moving.settings.last().unwrap().t_end;
        let mut run = moving.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"");
        for (t_s, degc) in &mut run.temperatures {
            *degc = [Some(20.5), Some(24.0 + 0.8 * *t_s / end_s)];
        }
        for sample in &mut run.samples {
            (0..3).for_each(|i| sample.reading[i] += slopes[i] * 0.8 * sample.t / end_s);
        }
        let case = case(&moving);
        case.put(common::RUN_FILE, run.text());
        let output = case.run("offset", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let opf = opf(&case);
        close(three(&opf, "offset_degc"), [24.2, 24.3, 24.6], 0.02);
        for i in 0..3 {
            let truth = moving.truth.offset_ent[i] + slopes[i] * (number(&opf, &format!("offset_degc.{i}")) - 24.0);
            within(number(&opf, &format!("offset_ent.{i}")), truth, number(&opf, &format!("offset_std_ent.{i}")));
        }
    }
}

/// What begins anew with every turn of the sensor is in every zero level alike, and no position tells it from an offset.
#[test]
fn a_change_that_begins_with_every_turn_is_told() {
    let still = plan(&POSITIONS, &[1, 2, 3, 4]);
    let visit_s = still.settings.last().unwrap().t_end / 4.0;
    let said = |size_ent: f64| {
        let mut run = still.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"");
        for sample in &mut run.samples {
            sample.reading[0] += size_ent * (-(sample.t % visit_s) / 20.0).exp();
        }
        let case = case(&still);
        case.put(common::RUN_FILE, run.text());
        let output = case.run("offset", &["--no-plots"]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        text(&output.stderr)
    };
    says(&said(0.1), &["the readings change within the visits", "enT/h in x", "wait after every turn"]);
    assert!(!said(0.0).contains("change within the visits"));
}

/// A thermometer that is logged every two seconds while it is still, and seldom while it moves from 20 to 20.9 °C in the last nine tenths of the run:
/// the mean in time is 20 + 0.9 · 0.45 °C, that of the readings 20.13.
#[test]
fn the_temperature_of_a_run_is_its_mean_in_time() {
    let still = plan(&POSITIONS, &[1, 2, 3, 4]);
    let end_s = still.settings.last().unwrap().t_end;
    let mut run = still.run().key("kind", "\"offset\"").key("configuration", "\"OFFSET_200.MAG\"");
    let begin_s = 0.1 * end_s;
    let at_rest = (0..20).map(|i| (begin_s * f64::from(i) / 20.0, 20.0));
    let moving = (0..=6).map(|i| f64::from(i) / 6.0).map(|part| (begin_s + 0.9 * end_s * part, 20.0 + 0.9 * part));
    run.temperatures = at_rest.chain(moving).map(|(t_s, degc)| (t_s, [Some(17.0), Some(degc)])).collect();
    let case = case(&still);
    case.put(common::RUN_FILE, run.text());
    let output = case.run("offset", &["--no-plots"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let degc = number(&opf(&case), "run.temperature_degc");
    assert!((degc - 20.405).abs() < 0.005, "{degc}");
}

/// Files say in words for which noise the uncertainties of their offsets hold: what changes within the time in which it was measured.
#[test]
fn files_say_for_which_noise_the_uncertainty_of_an_offset_holds() {
    let opf = measure(&plan(&POSITIONS, &[1, 2, 3, 4]));
    let covers = |file: &DocumentMut, table: &str, seconds: f64, lasting: &str| {
        let text = file[table]["std_covers"].as_str().unwrap().to_owned();
        let begin = format!("noise that changes within the {seconds:.0} s of {lasting}; ");
        assert!(text.starts_with(&begin), "{text:?} does not begin with {begin:?}");
        says(&text, &["what changes more slowly shows in no residual of one run", "compare the offsets of several runs"]);
    };
    let visits = opf["visit"].as_array_of_tables().unwrap();
    let length = |v: &toml_edit::Table| v["time_s"][1].as_float().unwrap() - v["time_s"][0].as_float().unwrap();
    covers(&opf, "method", visits.iter().map(length).fold(0.0, f64::max), "the longest visit of a position");

    let case = Case::of(Plan::default().run().text());
    case.done(&[]);
    let cpf = case.cpf();
    let [first, last] = [0, 1].map(|k| number(&cpf, &format!("valid.time_s.{k}")));
    covers(&cpf, "offset", last - first, "the run");
}
