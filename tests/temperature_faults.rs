//! Faults of temperature channels: what no body can do is named with its channel, what a body does is none.

use crate::common;

use calfit::data::run::{Header, InputFile, Kind, ReadingUnit, Run, SlowTable, VectorAccount};
use calfit::model::campaign::Instructions;
use calfit::record::temperature_faults::{ChannelFault, Fault, faults, notes};
use common::Gauss;
use common::check::{Case, calfit, number, says, text};
use common::{Plan, programme, with_rows};

/// A run that holds temperatures only, one row every so many seconds.
fn run(interval_s: f64, channels: &[(&str, Vec<f64>)]) -> Run {
    let count = channels[0].1.len();
    Run {
        header: Header {
            run: "13-04-10_08-18-43".to_owned(),
            start: "2013-04-10T08:18:43Z".parse().unwrap(),
            kind: Kind::Linearity,
            configuration: String::new(),
            sensor: String::new(),
            mode: String::new(),
            sample_rate_hz: 1.0,
            unit: ReadingUnit::Ent,
            field_source: String::new(),
            coil_correction: None,
            earthfield_compensation: Vec::new(),
        },
        settings: Vec::new(),
        blocks: Vec::new(),
        temperatures: SlowTable {
            names: channels.iter().map(|(name, _)| (*name).to_owned()).collect(),
            t_s: (0..count).map(|i| interval_s * i as f64).collect(),
            values: channels.iter().map(|(_, degc)| degc.clone()).collect(),
        },
        channels: SlowTable::default(),
        scalar: Vec::new(),
        vectors: VectorAccount::default(),
        input: InputFile { path: "test".to_owned(), size_bytes: 0, sha256: String::new() },
        findings: Vec::new(),
        exclusions: Vec::new(),
    }
}

fn of(run: &Run) -> Vec<ChannelFault> {
    faults(run, &Instructions::default())
}

/// Readings of a course with noise, in digits of 0.001 K.
fn readings(count: usize, noise_k: f64, gauss: &mut Gauss, course: impl Fn(f64) -> f64) -> Vec<f64> {
    (0..count).map(|i| (1e3 * (course(i as f64) + noise_k * gauss.normal())).round() / 1e3).collect()
}

#[test]
fn what_a_body_does_is_no_fault() {
    let mut gauss = Gauss(44);
    let mut runs = 0;
    for seed in 0..40 {
        for noise_k in [0.0, 0.005, 0.02, 0.1] {
            for count in [4, 25, 88, 400] {
                let at = f64::from(seed % 7) * 0.1 * count as f64;
                // Steady, a ramp that begins, a box that is heated with a time constant of 0.6 to 40 readings, a day, a heater that switches.
                let courses: [Box<dyn Fn(f64) -> f64>; 5] = [
                    Box::new(|_| 17.0),
                    Box::new(move |i: f64| 17.0 - 0.4 * (i - at).max(0.0)),
                    Box::new(move |i: f64| 17.0 + 60.0 * (1.0 - (-(i - at).max(0.0) / (0.6 + f64::from(seed))).exp())),
                    Box::new(move |i: f64| 17.0 + 5.0 * (0.02 * (i - at)).sin()),
                    Box::new(move |i: f64| 80.0 + 1.5 * (2.0 / std::f64::consts::PI) * (0.4 * (i - at)).sin().asin()),
                ];
                for course in courses {
                    let both = [
                        ("T_OB-1", readings(count, noise_k, &mut gauss, &course)),
                        ("T_OB-2", readings(count, noise_k, &mut gauss, |i| 0.7 + course(i - 0.5))),
                        ("T29", readings(count, 0.02, &mut gauss, |_| 16.9)),
                    ];
                    let found = of(&run(20.0, &both));
                    assert!(
                        found.is_empty(),
                        "{seed} {noise_k} {count}: {:?}",
                        found.iter().map(ChannelFault::text).collect::<Vec<_>>()
                    );
                    runs += 1;
                }
            }
        }
    }
    println!("{runs} runs of three channels without a fault: no alarm");
    // Rounded to 0.1 K and as steady as that; a channel of its own that is warm is another body.
    let rounded = run(20.0, &[("T59", vec![21.3; 88]), ("T_BOX", vec![48.2; 88]), ("T_FM 2", vec![60.0; 88])]);
    assert!(of(&rounded).is_empty());
}

/// A channel without any scatter in digits of a hundredth, and one of the coil system that was exchanged for that of the sensor.
#[test]
fn a_channel_without_scatter_and_exchanged_channels_are_named() {
    let mut gauss = Gauss(50);
    let still = of(&run(20.0, &[("T59", vec![17.25; 1081])]));
    assert!(matches!(still.as_slice(), [ChannelFault { fault: Fault::StandsStill { .. }, .. }]), "{still:?}");
    for degc in [-60.0, 130.0] {
        let both = [("T59", readings(88, 0.02, &mut gauss, |_| 16.8)), ("T29", readings(88, 0.02, &mut gauss, |_| degc))];
        let found = of(&run(20.0, &both));
        let [ChannelFault { channel, fault: Fault::Exchanged { other, .. }, .. }] = found.as_slice() else { panic!("{found:?}") };
        assert_eq!((channel.as_str(), other.0.as_str()), ("T29", "T59"));
    }
}

#[test]
fn a_change_while_nothing_was_recorded_is_no_jump() {
    let mut gauss = Gauss(45);
    let mut gap = run(20.0, &[("T59", readings(88, 0.02, &mut gauss, |i| if i < 44.0 { 17.0 } else { 25.0 }))]);
    assert_eq!(of(&gap).len(), 1);
    for t_s in &mut gap.temperatures.t_s[44..] {
        *t_s += 3600.0;
    }
    assert!(of(&gap).is_empty(), "{:?}", of(&gap));
    // A step that another thermistor shows as well is a step of the temperature.
    let step = |i: f64| if i < 44.0 { 17.0 } else { 25.0 };
    let both = [("T59", readings(88, 0.02, &mut gauss, step)), ("T61", readings(88, 0.02, &mut gauss, |i| 0.6 * step(i)))];
    assert!(of(&run(20.0, &both)).is_empty());
}

/// The record stops while the body is heated, soon after the heater was switched on: what it began to do it may go on with.
#[test]
fn a_gap_while_a_body_is_heated_is_no_jump() {
    let mut gauss = Gauss(48);
    for begin in [40.2, 41.0, 41.6, 42.5, 43.1] {
        let heated = |i: f64| 17.0 + 40.0 * (1.0 - (-(i - begin).max(0.0) / 12.0).exp());
        let mut run = run(20.0, &[("T59", readings(120, 0.02, &mut gauss, heated))]);
        run.temperatures.values[0].drain(44..74);
        run.temperatures.t_s.drain(44..74);
        assert!(of(&run).is_empty(), "{begin}: {:?}", of(&run));
    }
}

/// A jump on the way up: the course of the body is none of it.
#[test]
fn a_jump_of_a_heated_channel_is_found() {
    let mut gauss = Gauss(49);
    let heated = |i: f64| 17.0 + 0.5 * i + if i < 49.5 { 0.0 } else { 2.0 };
    let found = of(&run(20.0, &[("T59", readings(88, 0.02, &mut gauss, heated))]));
    assert!(
        matches!(found.as_slice(), [ChannelFault { fault: Fault::Jumps { count: 1, t_s, size_k }, .. }] if *t_s == 1000.0 && (size_k - 2.5).abs() < 0.2),
        "{found:?}"
    );
}

#[test]
fn jumps_are_named_with_time_and_size() {
    let mut gauss = Gauss(46);
    for seed in 0..20 {
        // T_SENS_2 of 10 April 2013: 39 to 48 °C where its neighbour shows 22 °C, in a box that warms up.
        let wild: Vec<f64> = (0..30).map(|_| 9.0 + 9.0 * (0.5 + 0.5 * (gauss.normal()).tanh())).collect();
        let course = |i: f64| 22.0 + 0.02 * i;
        let bad = readings(88, 0.1, &mut gauss, |i| course(i) + wild[(i / 3.0) as usize]);
        let run = run(
            20.0,
            &[
                ("T59", readings(88, 0.02, &mut gauss, course)),
                ("T_SENS_1", readings(88, 0.1, &mut gauss, course)),
                ("T_SENS_2", bad),
            ],
        );
        let found = of(&run);
        assert!(found.iter().all(|f| f.channel == "T_SENS_2"), "{found:?}");
        assert!(found.iter().any(|f| matches!(f.fault, Fault::Jumps { count, .. } if count >= 3)), "{seed}: {found:?}");
        assert!(found.iter().any(|f| matches!(&f.fault, Fault::Apart { neighbour, by_k, decided: true } if neighbour == "T_SENS_1" && (9.0..18.0).contains(by_k))), "{found:?}");
        assert!(found.iter().all(|f| f.probability < 1e-6));
    }
    // A small step that stands alone, at the 50th reading.
    let small = run(20.0, &[("T59", readings(88, 0.02, &mut gauss, |i| 17.0 + 0.01 * i + if i < 49.5 { 0.0 } else { 0.6 }))]);
    let found = of(&small);
    assert!(
        matches!(found.as_slice(), [ChannelFault { fault: Fault::Jumps { count: 1, t_s, size_k }, .. }] if *t_s == 1000.0 && (size_k - 0.6).abs() < 0.1),
        "{found:?}"
    );
}

/// A small jump and the one that takes it back are both found, also where the channel moves by half as much from reading to reading.
#[test]
fn a_small_jump_there_and_back_is_two() {
    let mut gauss = Gauss(51);
    for rate_k in [0.0, 0.3] {
        let there = |i: f64| if (50.5..120.5).contains(&i) { 0.7 } else { 0.0 };
        let found = of(&run(20.0, &[("T59", readings(200, 0.01, &mut gauss, |i| 17.0 + rate_k * i + there(i)))]));
        assert!(matches!(found.as_slice(), [ChannelFault { fault: Fault::Jumps { count: 2, .. }, .. }]), "{rate_k}: {found:?}");
    }
}

/// One wrong reading, also the first one, moves none of the others: at rest, and on a ramp of 0.3 K from reading to reading.
#[test]
fn a_single_wrong_reading_is_no_level() {
    let mut gauss = Gauss(47);
    for (count, rate_k) in [(29, 0.0), (200, 0.3), (200, -0.3)] {
        for (place, off_k) in [(0, -3.0), (0, 3.0), (count / 2, -3.0), (count / 2, -1.0), (count / 2, 1.0), (count / 3, 5.0)] {
            for _ in 0..10 {
                let course = |i: f64| 21.0 + rate_k * i;
                let mut degc = readings(count, 0.01, &mut gauss, course);
                degc[place] += off_k;
                let run = run(30.0, &[("T59", degc)]);
                let found = calfit::record::temperature_faults::readings(&run, "T59", [0.0, 30.0 * count as f64]).unwrap();
                let others = found.iter().enumerate().filter(|(i, _)| *i != place);
                let worst = others.map(|(i, (_, degc))| (degc - course(i as f64)).abs()).fold(0.0, f64::max);
                assert!(worst < 0.1, "{count} readings, {rate_k} K each, {off_k} K at {place}: {worst}");
                let told = of(&run);
                assert!(
                    told.len() == 1 && matches!(told[0].fault, Fault::Jumps { .. }),
                    "{count} {rate_k} {place} {off_k}: {told:?}"
                );
            }
        }
    }
}

#[test]
fn a_channel_that_stands_still_or_has_another_unit_is_named() {
    let mut gauss = Gauss(47);
    let stuck = readings(88, 0.02, &mut gauss, |i| 17.0 + 0.05 * i)
        .iter()
        .enumerate()
        .map(|(i, v)| if i < 40 { *v } else { 19.01 })
        .collect();
    let found = of(&run(20.0, &[("T59", stuck)]));
    assert!(
        matches!(found.as_slice(), [ChannelFault { fault: Fault::StandsStill { time_s: [from, until], .. }, .. }] if *from == 800.0 && *until == 1740.0),
        "{found:?}"
    );
    let moving = readings(88, 0.1, &mut gauss, |i| 17.0 + 0.1 * i);
    let found = of(&run(20.0, &[("T_OB-1", vec![17.0; 88]), ("T_OB-2", moving)]));
    assert!(
        found.iter().any(|f| matches!(&f.fault, Fault::StandsStill { neighbour: Some((name, _)), .. } if name == "T_OB-2")),
        "{found:?}"
    );
    for (unit, scale, zero) in [("K", 1.0, 273.15), ("°F", 1.8, 32.0)] {
        for degc in [-60.0, 21.0, 80.0] {
            let good = readings(88, 0.1, &mut gauss, |_| degc);
            let bad = good.iter().map(|v| scale * v + zero).collect();
            let run = run(20.0, &[("T59", good.clone()), ("T_OB-1", good), ("T_OB-2", bad)]);
            let found = of(&run);
            assert!(
                found
                    .iter()
                    .any(|f| f.channel == "T_OB-2" && matches!(f.fault, Fault::Unit { unit: found, .. } if found == unit)),
                "{degc}: {found:?}"
            );
        }
        // The coil system stands in a room: it needs no neighbour.
        let coil = readings(88, 0.02, &mut gauss, |_| scale * 17.0 + zero);
        let run = run(20.0, &[("T59", readings(88, 0.02, &mut gauss, |_| 80.0)), ("T29", coil)]);
        let found = notes(&run, &Instructions::default());
        assert_eq!(found.len(), 1, "{found:?}");
        says(
            &found[0].to_string(),
            &["temperature channel T29", unit, "17.0 °C", "the coil temperature of the result rests on it"],
        );
    }
}

#[test]
fn check_and_the_analyses_name_the_channel_and_its_neighbour() {
    let plan = Plan { settings: programme(&[-1000.0, 1000.0], 2.0), ..Plan::default() };
    let mut made = plan.run();
    made.temperatures = (0..=40).map(|i| (0.5 * f64::from(i), [Some(20.5), Some(24.0)])).collect();
    let jumping = |cells: &[&str]| match cells[0].parse::<f64>() {
        Ok(t_s) => {
            let degc = if t_s < 9.0 { 24.1 } else { 44.1 };
            format!("{},{},{degc},24.{}", cells[0], cells[1], (2.0 * t_s) as u32 % 5)
        }
        Err(_) => format!("{},T_SENS_1,T_SENS_2", cells[..cells.len() - 1].join(",")),
    };
    let case = Case::of(with_rows(&made.text(), "@TEMPERATURES", jumping));
    case.put("campaign.toml", "temperature_channel = \"T_SENS_1\"\n");
    let messages = case.done(&["--order", "0"]);
    says(
        &messages,
        &[
            "temperature channel T_SENS_1 jumps once by +20.0 K at 9 s",
            "the sensor temperature of the result rests on it",
            "without the jumps within the settings and as if right at the first level with more than a few readings",
            "name its neighbour in campaign.toml: T_SENS_2",
        ],
    );
    // With the jump it was 34 °C, which the sensor never had.
    let degc = number(&case.cpf(), "run.temperature_degc");
    assert!((degc - 24.1).abs() < 0.1, "{degc}");
    let output = calfit().arg("check").arg(case.campaign()).output().unwrap();
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    says(&text(&output.stderr), &["temperature channel T_SENS_1 jumps once by +20.0 K"]);
}
