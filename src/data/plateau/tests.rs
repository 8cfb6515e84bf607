//! Settling, edges and saturation on made samples.

use super::*;
use crate::data::run::{Kind, ReadingUnit};
use crate::data::units::FieldCoil;

const RATE_HZ: f64 = 128.0;
const LENGTH_S: f64 = 8.0;

/// Settings of ±1900, ±1000 nT and zero on one axis after the other without pauses, seen by an ideal sensor at 128 Hz behind a
/// first-order lag, with a little noise, `late_s` after the settings, clipped at `clip_ent`.
fn made(lag_s: f64, late_s: f64, clip_ent: f64) -> Accumulator {
    made_late(lag_s, |_| late_s, clip_ent)
}

/// The same with a delay, s, of every setting of its own.
fn made_late(lag_s: f64, late_s: impl Fn(usize) -> f64, clip_ent: f64) -> Accumulator {
    let mut settings = Vec::new();
    for axis in 0..3 {
        for step in [0.0, 1900.0, -1000.0, 0.0, -1900.0, 1000.0, 1900.0, 0.0, -1900.0] {
            let mut field = [0.0; 3];
            field[axis] = step;
            let t_start_s = settings.len() as f64 * LENGTH_S;
            settings.push(Setting {
                t_start_s,
                t_end_s: t_start_s + LENGTH_S,
                field: FieldCoil(field),
                frequency_hz: 0.0,
                position: 1,
            });
        }
    }
    let header = Header {
        run: "r".to_owned(),
        start: "2026-01-01T00:00:00Z".parse().unwrap(),
        kind: Kind::Linearity,
        configuration: String::new(),
        sensor: String::new(),
        mode: String::new(),
        sample_rate_hz: RATE_HZ,
        unit: ReadingUnit::Ent,
        field_source: String::new(),
        coil_correction: None,
        earthfield_compensation: Vec::new(),
    };
    let mut accumulator = Accumulator::default();
    accumulator.begin(&header, &settings);
    let mut state = 7u64;
    let mut level = [0.0; 3];
    for n in 0..(settings.len() as f64 * LENGTH_S * RATE_HZ) as u64 {
        // Samples in the middle of their periods, so that none lies on an edge.
        let t_s = (n as f64 + 0.5) / RATE_HZ;
        let index =
            ((t_s - late_s((t_s / LENGTH_S) as usize)) / LENGTH_S).floor().clamp(0.0, settings.len() as f64 - 1.0) as usize;
        let keep = if lag_s > 0.0 { (-1.0 / (RATE_HZ * lag_s)).exp() } else { 0.0 };
        let reading = std::array::from_fn(|axis| {
            level[axis] = settings[index].field.0[axis] * (1.0 - keep) + level[axis] * keep;
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let noise = ((state >> 11) as f64 / (1u64 << 53) as f64 - 0.5) * 0.5;
            (level[axis] + noise).clamp(-clip_ent, clip_ent)
        });
        accumulator.vector(Vector { n, t_s, reading: Reading(reading) });
    }
    accumulator
}

fn saturated(plateaus: &Plateaus) -> usize {
    plateaus.list.iter().filter(|p| matches!(p.dropped, Some(Drop::Saturated { .. }))).count()
}

#[test]
fn nothing_is_left_out_where_the_field_is_there_at_once() {
    let p = made(0.0, 0.0, 1e9).finish(Cut::default());
    assert_eq!((p.settling_s, p.early_end_s, p.edge_shift_s, p.outside), (0.0, 0.0, 0.0, 0));
    assert!(p.list.iter().all(|p| p.dropped.is_none() && p.count == Some(1024)));
}

/// Where a sample falls on the edge and its time rounds across it, it shows the setting before, in two of the settings: it is no spike, and not in the
/// mean.
#[test]
fn a_sample_across_the_edge_is_left_out_and_is_no_spike() {
    let late_s = |setting: usize| if [2, 20].contains(&setting) { 1.0 / RATE_HZ } else { 0.0 };
    let p = made_late(0.0, late_s, 1e9).finish(Cut::default());
    assert_eq!((p.settling_s, p.list.iter().map(|p| p.spike_samples).sum::<u64>()), (0.0, 0));
    for p in &p.list {
        let off = (0..3).map(|axis| (p.mean.0[axis] - p.setting.field.0[axis]).abs()).fold(0.0, f64::max);
        // The noise of a sample is at most 0.25.
        assert!(off < 0.05 && p.count >= Some(1008), "{off} {:?}", p.count);
    }
    // A reading in the first bin that no setting beside it has is one.
    let mut spiked = made(0.0, 0.0, 1e9);
    spiked.bins[5][0].max[1] = 5000.0;
    assert_eq!(spiked.finish(Cut::default()).list[5].spike_samples, 16);
}

#[test]
fn a_decay_is_left_out_until_it_is_lost_in_the_noise() {
    let p = made(0.2, 0.0, 1e9).finish(Cut::default());
    // 1900 nT fall below the 0.01 enT that a bin can show after twelve time constants.
    assert!((1.6..6.0).contains(&p.settling_s), "{}", p.settling_s);
    assert!(p.list.iter().all(|p| (p.mean.0[0] - p.setting.field.0[0]).abs() < 0.05));
    assert!(!p.still_settling);
}

#[test]
fn a_decay_that_does_not_end_is_told() {
    assert!(made(1.5, 0.0, 1e9).finish(Cut::default()).still_settling);
    assert!(!made(1.5, 0.0, 1e9).finish(Cut { settling: Settling::Given(7.0), ..Cut::default() }).still_settling);
}

#[test]
fn displaced_data_are_measured_and_their_edges_left_out() {
    for late_s in [0.4, 1.1, -0.4, -1.1] {
        for settling in [Settling::Found, Settling::Given(0.0)] {
            let p = made(0.0, late_s, 1e9).finish(Cut { settling, ..Cut::default() });
            assert!((p.edge_shift_s - late_s).abs() < 0.02, "{late_s}: {}", p.edge_shift_s);
        }
        let p = made(0.0, late_s, 1e9).finish(Cut::default());
        let worst = p.list.iter().map(|p| (p.mean.0[0] - p.setting.field.0[0]).abs()).fold(0.0, f64::max);
        assert!(worst < 0.05, "{late_s}: {worst}");
    }
    let p = made(0.0, 3.0, 1e9).finish(Cut::default());
    assert!(p.edge_shift_s > p.tolerable_shift_s);
}

#[test]
fn every_plateau_at_the_end_of_the_range_is_dropped_whatever_came_before_it() {
    for (lag_s, clip_ent) in [(0.0, 1800.0), (0.05, 1800.123), (0.05, 1850.0)] {
        assert_eq!(saturated(&made(lag_s, 0.0, clip_ent).finish(Cut::default())), 12, "{lag_s} s, {clip_ent} enT");
    }
    assert_eq!(saturated(&made(0.05, 0.0, 1e9).finish(Cut::default())), 0);
}
