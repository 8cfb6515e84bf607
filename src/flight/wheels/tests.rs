//! Both methods against interference whose truth is a closed form.

use super::*;
use crate::fit::random::Random;
use std::f64::consts::TAU;

const S: i64 = 1_000_000_000;
const START: i64 = 488_894_467_934_000_000;

/// A day of one mode: times, and waves whose phases are known.
struct Case {
    times: Vec<i64>,
    modes: Vec<WheelMode>,
    wheels: WheelRates,
}

impl Case {
    /// `count` vectors at `rate_hz`; wheels begin at a rate and change it linearly (Hz, Hz/s).
    fn new(rate_hz: f64, count: usize, lines_hz: &[f64], wheels: &[[f64; 2]]) -> Self {
        let step = (1e9 / rate_hz).round() as i64;
        let times: Vec<i64> = (0..count as i64).map(|i| START + i * step).collect();
        let table: Vec<i64> = (-1..=(times[count - 1] - START) / (8 * S) + 1).map(|i| START + 8 * S * i).collect();
        let rates = |[rate, slope]: &[f64; 2]| table.iter().map(|t| rate + slope * seconds(t - START)).collect();
        let modes = vec![WheelMode { rate_hz, half_width_hz: Some(0.0015 * rate_hz), lines_hz: lines_hz.to_vec() }];
        Self { wheels: WheelRates { rate_hz: wheels.iter().map(rates).collect(), time_tt2000: table }, times, modes }
    }

    /// Zero plus what a function of the component and the seconds since the start says.
    fn field(&self, value: impl Fn(usize, f64) -> f64) -> [Vec<f64>; 3] {
        std::array::from_fn(|c| self.times.iter().map(|t| value(c, seconds(t - START))).collect())
    }

    fn clean(&self, method: Method, field: &mut [Vec<f64>; 3]) -> (Vec<u32>, WheelReport) {
        let options = WheelOptions { method, ..WheelOptions::default() };
        let mut flags = vec![0; self.times.len()];
        let modes = vec![0; self.times.len()];
        let report = clean(&self.times, &modes, &self.modes, &self.wheels, &options, field, &mut flags).unwrap();
        (flags, report)
    }
}

fn wave(rate_hz: f64, slope: f64, t: f64) -> f64 {
    TAU * (rate_hz * t + 0.5 * slope * t * t).fract()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

/// Field of white and slow noise, equal for equal seeds.
fn natural(count: usize, seed: u64) -> Vec<f64> {
    let mut random = Random::seeded(seed);
    let mut slow = 0.0;
    (0..count)
        .map(|_| {
            slow += 0.01 * random.gaussian();
            slow + 0.03 * random.gaussian()
        })
        .collect()
}

#[test]
fn waves_alone_are_fitted_to_the_last_digits() {
    // Two wheels that cross each other and the line, one of them through the alias 0, without any noise: amplitudes are constant.
    let case = Case::new(20.0, 20_000, &[3.1], &[[22.0, 2e-3], [19.5, 1e-3]]);
    let truth = |c: usize, t: f64| {
        let turn = c as f64;
        let first = 0.6 * (wave(22.0, 2e-3, t) + turn).cos();
        first + 0.4 * (wave(19.5, 1e-3, t) + 2.0 * turn).sin() + 0.2 * (TAU * 3.1 * t + turn).sin()
    };
    let mut field = case.field(truth);
    let (flags, report) = case.clean(Method::Fit, &mut field);
    for b in &field {
        assert!(b.iter().all(|v| v.abs() < 1e-6), "{}", rms(b));
    }
    assert!(flags.iter().all(|f| *f == WHEEL));
    let [mode] = report.modes.as_slice() else { panic!() };
    assert_eq!((mode.vectors, mode.changed, mode.stretches), (20_000, 20_000, 1));
    // Amplitudes of three components: √3 times that of one.
    let found = [mode.waves[0].amplitude_nt, mode.waves[1].amplitude_nt, mode.lines_nt[0]];
    for (found, one) in found.into_iter().zip([0.6, 0.4, 0.2]) {
        assert!((found / (one * 3f64.sqrt()) - 1.0).abs() < 1e-5, "{found}");
    }
}

#[test]
fn a_wheel_whose_alias_stops_at_zero_leaves_the_field_alone() {
    // The alias comes from 0.6 Hz, stays below 0.05 Hz for three minutes, and goes.
    let case = Case::new(20.0, 24_000, &[], &[[19.4, 1e-3]]);
    let natural: [Vec<f64>; 3] = std::array::from_fn(|c| natural(24_000, c as u64));
    let waves = case.field(|c, t| 0.5 * (wave(19.4, 1e-3, t) + c as f64).cos());
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural[c].iter().zip(&waves[c]).map(|(a, b)| a + b).collect());
    case.clean(Method::Fit, &mut field);
    for c in 0..3 {
        let error: Vec<f64> = field[c].iter().zip(&natural[c]).map(|(a, b)| a - b).collect();
        assert!(rms(&error) < 0.01, "{c}: {}", rms(&error));
        assert!(rms(&error[11_000..13_000]) < 0.02, "{c}: {}", rms(&error[11_000..13_000]));
    }
}

#[test]
fn a_natural_wave_at_the_frequency_of_a_wheel_stays() {
    // A wave of constant frequency and a wheel that sweeps over it.
    let case = Case::new(20.0, 30_000, &[], &[[22.0, 4e-4]]);
    let own: [Vec<f64>; 3] = std::array::from_fn(|c| natural(30_000, 7 + c as u64));
    let waves = case.field(|_, t| 0.5 * wave(22.0, 4e-4, t).cos());
    let natural = case.field(|c, t| 0.3 * (TAU * 2.3 * t + c as f64).cos());
    let mut field: [Vec<f64>; 3] =
        std::array::from_fn(|c| (0..30_000).map(|i| own[c][i] + waves[c][i] + natural[c][i]).collect());
    case.clean(Method::Fit, &mut field);
    for c in 0..3 {
        let product: f64 = (0..30_000).map(|i| (field[c][i] - own[c][i]) * natural[c][i]).sum();
        let kept = product / natural[c].iter().map(|v| v * v).sum::<f64>();
        assert!((kept - 1.0).abs() < 0.01, "{c}: {kept}");
    }
}

#[test]
fn the_amplitude_turns_with_the_spacecraft() {
    // A slew by 0.03 degrees per second turns the wave from x to y.
    let case = Case::new(20.0, 20_000, &[], &[[23.0, 5e-4]]);
    let angle = |t: f64| (0.03 * t).to_radians();
    let waves = case.field(|c, t| [angle(t).cos(), angle(t).sin(), 0.0][c] * 0.6 * wave(23.0, 5e-4, t).sin());
    let natural: [Vec<f64>; 3] = std::array::from_fn(|c| natural(20_000, c as u64));
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural[c].iter().zip(&waves[c]).map(|(a, b)| a + b).collect());
    case.clean(Method::Fit, &mut field);
    for c in 0..3 {
        let error: Vec<f64> = field[c].iter().zip(&natural[c]).map(|(a, b)| a - b).collect();
        assert!(rms(&error) < 0.005, "{c}: {}", rms(&error));
    }
}

#[test]
fn wheels_that_are_not_seen_cost_little() {
    let case = Case::new(20.0, 20_000, &[3.1, 7.7], &[[23.0, 5e-4], [31.0, -5e-4], [17.0, 4e-4], [27.0, 1e-4]]);
    let before: [Vec<f64>; 3] = std::array::from_fn(|c| natural(20_000, c as u64));
    let mut field = before.clone();
    let (_, report) = case.clean(Method::Fit, &mut field);
    for c in 0..3 {
        let removed = report.modes[0].removed_rms_nt[c];
        assert!(removed > 0.0 && removed < 0.1 * 0.03, "{c}: {removed}");
    }
}

#[test]
fn what_is_not_at_the_rates_of_the_table_is_told() {
    let count = 20_000;
    let noise = [1, 2, 3].map(|seed| natural(count, seed));
    for method in [Method::Fit, Method::Stripe] {
        // A wheel of 0.5 nT at 33 Hz that is seen at 7 Hz, and a line at 4 Hz, in noise of 0.03 nT.
        let seen = |rate: f64, line: f64| {
            let case = Case::new(20.0, count, &[line], &[[rate, 1e-5]]);
            let mut field =
                case.field(|c, t| 0.5 * (wave(33.0, 1e-5, t) + c as f64).cos() + 0.2 * (TAU * (4.0 * t).fract()).sin());
            (0..3).for_each(|c| field[c].iter_mut().zip(&noise[c]).for_each(|(b, n)| *b += n));
            case.clean(method, &mut field).1.modes[0].seen.clone()
        };
        let right = seen(33.0, 4.0);
        assert!(right.iter().all(|s| s.windows == 39 && s.seen == 39 && s.beside == 0), "{method:?} {right:?}");
        // 2 Hz off nothing is there; 0.3 Hz off the line itself is seen beside it.
        let off = seen(35.0, 4.0);
        assert!(off[0].windows == 39 && off[0].seen <= 3 && off[1].seen == 39, "{method:?} {off:?}");
        let near = seen(33.3, 4.0);
        assert!(near[0].beside * 2 >= near[0].windows, "{method:?} {near:?}");
        let other = seen(33.0, 5.5);
        assert!(other[0].seen == 39 && other[1].seen * 10 <= other[1].windows, "{method:?} {other:?}");
    }
}

#[test]
fn steps_and_bad_vectors_do_not_reach_the_waves() {
    let case = Case::new(20.0, 20_000, &[], &[[23.0, 5e-4]]);
    let waves = case.field(|c, t| 0.6 * (wave(23.0, 5e-4, t) + c as f64).sin());
    let natural: [Vec<f64>; 3] = std::array::from_fn(|c| {
        let step = |i: usize| if (7000..9000).contains(&i) { 40.0 } else { 0.0 };
        let spike = |i: usize| if i == 12_345 { 1e4 } else { 0.0 };
        natural(20_000, c as u64).iter().enumerate().map(|(i, b)| b + step(i) + spike(i)).collect()
    });
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural[c].iter().zip(&waves[c]).map(|(a, b)| a + b).collect());
    case.clean(Method::Fit, &mut field);
    for c in 0..3 {
        let error = field[c].iter().zip(&natural[c]).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        assert!(error < 0.03, "{c}: {error}");
    }
}

#[test]
fn without_wheels_and_lines_nothing_changes_and_neither_do_other_modes() {
    let mut case = Case::new(20.0, 3000, &[], &[]);
    let before: [Vec<f64>; 3] = std::array::from_fn(|c| natural(3000, c as u64));
    for method in [Method::Fit, Method::Stripe] {
        let mut field = before.clone();
        let (flags, report) = case.clean(method, &mut field);
        assert_eq!(field, before);
        assert!(flags.iter().all(|f| *f == 0) && report.modes[0].changed == 0);
    }
    // Every second vector is of a mode that passes.
    case.modes[0].lines_hz = vec![3.1];
    case.modes[0].rate_hz = 10.0;
    case.modes.push(WheelMode { half_width_hz: None, ..case.modes[0].clone() });
    let mode_of_row: Vec<u8> = (0..3000).map(|i| (i % 2) as u8).collect();
    for method in [Method::Fit, Method::Stripe] {
        let (mut field, mut flags) = (before.clone(), vec![4; 3000]);
        let options = WheelOptions { method, ..WheelOptions::default() };
        let report = clean(&case.times, &mode_of_row, &case.modes, &case.wheels, &options, &mut field, &mut flags).unwrap();
        assert_eq!((report.modes[0].changed, report.modes[1].changed, report.modes[1].vectors), (1500, 0, 1500));
        for i in 0..3000 {
            let changed = field[1][i].to_bits() != before[1][i].to_bits();
            assert_eq!((changed, flags[i]), if i % 2 == 0 { (true, 4 | WHEEL) } else { (false, 4) }, "{i}");
        }
    }
}

#[test]
fn stretches_end_at_long_gaps_and_at_the_ends_of_the_table() {
    let mut case = Case::new(20.0, 4000, &[], &[[23.0, 0.0]]);
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural(4000, c as u64));
    // Four nulls are passed over; five end a stretch, and 127 vectors behind them are too few.
    field[1][1000..1004].fill(f64::NAN);
    field[0][2000..2005].fill(f64::NAN);
    field[2][2132..2137].fill(f64::NAN);
    // The table ends 30 s before the vectors.
    let end = case.times[4000 - 600];
    let rows = case.wheels.time_tt2000.partition_point(|t| *t <= end);
    case.wheels.time_tt2000.truncate(rows);
    case.wheels.rate_hz[0].truncate(rows);
    let last = case.wheels.time_tt2000[rows - 1];
    let outside = case.times.iter().filter(|t| **t > last).count();
    for method in [Method::Fit, Method::Stripe] {
        let mut cleaned = field.clone();
        let (flags, report) = case.clean(method, &mut cleaned);
        let mode = &report.modes[0];
        assert_eq!((mode.vectors, mode.stretches, mode.in_short_stretches), (4000 - 14, 2, 127));
        assert_eq!((mode.outside_table, mode.changed), (outside, 4000 - 14 - 127 - outside));
        for i in 0..4000 {
            let null = field.iter().any(|b| b[i].is_nan());
            let kept = (2005..2132).contains(&i) || case.times[i] > last;
            assert_eq!(
                flags[i],
                if null {
                    0
                } else if kept {
                    NOT_CLEANED
                } else {
                    WHEEL
                },
                "{i}"
            );
            if null || kept {
                assert!((0..3).all(|c| cleaned[c][i].to_bits() == field[c][i].to_bits()), "{i}");
            }
        }
    }
}

#[test]
fn a_gap_of_the_table_is_not_bridged() {
    let mut case = Case::new(20.0, 6000, &[], &[[23.0, 0.0]]);
    let table = &mut case.wheels;
    table.time_tt2000.drain(15..25);
    table.rate_hz[0].drain(15..25);
    let (from, to) = (table.time_tt2000[14], table.time_tt2000[15]);
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural(6000, c as u64));
    let (flags, report) = case.clean(Method::Fit, &mut field);
    assert_eq!(report.modes[0].stretches, 2);
    for (time, flag) in case.times.iter().zip(flags) {
        assert_eq!(flag, if (from + 1..to).contains(time) { NOT_CLEANED } else { WHEEL });
    }
}

#[test]
fn only_vectors_of_the_stated_times_are_counted() {
    let case = Case::new(20.0, 3000, &[], &[[23.0, 0.0]]);
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural(3000, c as u64));
    let mut flags = vec![0; 3000];
    let counted = Some(case.times[1000]..case.times[1400]);
    let options = WheelOptions { counted, ..WheelOptions::default() };
    let report = clean(&case.times, &vec![0; 3000], &case.modes, &case.wheels, &options, &mut field, &mut flags).unwrap();
    assert_eq!((report.modes[0].vectors, report.modes[0].changed), (400, 400));
    // All are cleaned, counted or not.
    assert!(flags.iter().all(|f| *f == WHEEL));
}

#[test]
fn stripes_take_the_level_beside_them_and_the_mean_stays() {
    let case = Case::new(20.0, 1024, &[5.0], &[]);
    let mut random = Random::seeded(2);
    let noise: [Vec<f64>; 3] = std::array::from_fn(|_| (0..1024).map(|_| 0.03 * random.gaussian()).collect());
    // 5 Hz is bin 256 of 1024.
    let line = case.field(|c, t| 0.5 * (TAU * 5.0 * t + c as f64).sin() + 40.0);
    let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| (0..1024).map(|i| noise[c][i] + line[c][i]).collect());
    let before = field.clone();
    case.clean(Method::Stripe, &mut field);
    for c in 0..3 {
        let removed: Vec<f64> = before[c].iter().zip(&field[c]).map(|(a, b)| a - b).collect();
        let bin = |values: &[f64], k: usize| {
            let term = |i: usize| TAU * ((i * k) % 1024) as f64 / 1024.0;
            let sum = |f: fn(f64) -> f64| values.iter().enumerate().map(|(i, v)| v * f(term(i))).sum::<f64>();
            sum(f64::cos).hypot(sum(f64::sin))
        };
        // Half a width of 0.03 Hz is 1.5 bins: bins 254 to 258 have a part in it.
        for k in [0, 200, 252, 253, 259, 260, 512] {
            assert!(bin(&removed, k) < 1e-9, "{c} {k}");
        }
        let mut beside: Vec<f64> = (248..254).chain(259..265).map(|k| bin(&before[c], k)).collect();
        beside.sort_by(f64::total_cmp);
        let level = 0.5 * (beside[5] + beside[6]);
        for k in 254..259 {
            let found = bin(&field[c], k) / level;
            assert!((found - 1.0).abs() < 5.0 * 0.3 && (found - 1.0).abs() > 1e-6, "{c} {k}: {found}");
        }
    }
}

#[test]
fn stripes_repeat_with_their_seed() {
    let case = Case::new(20.0, 3000, &[5.0], &[[23.0, 1e-3]]);
    let mut fields = Vec::new();
    for seed in [1, 1, 2] {
        let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural(3000, c as u64));
        let options = WheelOptions { method: Method::Stripe, seed, ..WheelOptions::default() };
        clean(&case.times, &[0; 3000], &case.modes, &case.wheels, &options, &mut field, &mut [0; 3000]).unwrap();
        fields.push(field);
    }
    assert!(fields[0] == fields[1] && fields[0] != fields[2]);
}

#[test]
fn the_number_of_threads_does_not_matter() {
    let case = Case::new(20.0, 9000, &[5.0], &[[23.0, 1e-3], [31.0, -1e-3]]);
    for method in [Method::Fit, Method::Stripe] {
        let [one, three] = [1, 3].map(|threads| {
            let mut field: [Vec<f64>; 3] = std::array::from_fn(|c| natural(9000, c as u64));
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| case.clean(method, &mut field));
            field
        });
        assert_eq!(one, three);
    }
}

#[test]
fn what_does_not_fit_together_is_refused() {
    let case = Case::new(20.0, 10, &[3.1], &[[23.0, 0.0]]);
    let run = |modes: &[WheelMode], mode_of_row: &[u8], times: &[i64]| {
        let mut field: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; 10]);
        clean(times, mode_of_row, modes, &case.wheels, &WheelOptions::default(), &mut field, &mut [0; 10]).unwrap_err()
    };
    let error = run(&case.modes, &[0; 9], &case.times);
    assert_eq!(error, WheelError::Rows { what: "the modes", found: 9, rows: 10 });
    let error = run(&case.modes, &[0, 0, 0, 1, 0, 0, 0, 0, 0, 0], &case.times);
    assert_eq!(error, WheelError::Mode { row: 3, mode: 1, modes: 1 });
    let mut turned = case.times.clone();
    turned.swap(4, 5);
    assert_eq!(run(&case.modes, &[0; 10], &turned), WheelError::Vectors { row: 5 });
    for (rate_hz, width, line) in [(0.0, 0.03, 3.1), (20.0, 0.0, 3.1), (20.0, 0.03, 10.0)] {
        let modes = [WheelMode { rate_hz, half_width_hz: Some(width), lines_hz: vec![line] }];
        assert!(matches!(run(&modes, &[0; 10], &case.times), WheelError::Frequency { mode: 0, .. }));
    }
}
