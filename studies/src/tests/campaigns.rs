//! Short forms of the studies: coverage and efficiency over few runs, the closed loop on one sensor and mode. The full
//! tables are in `reports`.

use super::Size;
use crate::{closed_loop, coverage, repository};
use calfit::files::twin;
use coverage::{NOISES, Tally, study};
use std::collections::BTreeMap;

/// Share of intervals that hold the truth, stated over real errors, and variance over its bound, of all parameters with a name that
/// begins so.
fn pooled(tallies: &BTreeMap<String, Tally>, begin: &str) -> [f64; 3] {
    let chosen: Vec<&Tally> = tallies.iter().filter(|(name, _)| name.starts_with(begin)).map(|(_, tally)| tally).collect();
    assert!(!chosen.is_empty(), "{begin}");
    let mean = |of: fn(&Tally) -> f64| chosen.iter().map(|t| of(t)).sum::<f64>() / chosen.len() as f64;
    [mean(Tally::coverage), mean(Tally::width), mean(Tally::loss)]
}

/// The limits are four standard deviations of independent runs and components: a coverage of 95 % with 120 values scatters by 2 %, a
/// variance by 13 %.
#[test]
fn intervals_of_lin_and_offset_hold_the_truth_with_white_and_with_slow_noise() {
    for (name, begins) in [("lin", ["sigma", "xi", "b_or"]), ("offset", ["offset", "residual_coil", "residual_"])] {
        for noise in [NOISES[0], NOISES[2]] {
            let tallies = study(name, noise, 40);
            for begin in begins {
                let [coverage, width, loss] = pooled(&tallies, begin);
                assert!((0.7..1.4).contains(&width), "{name}, {}, {begin}: {width}", noise.name);
                assert!((0.87..=1.0).contains(&coverage), "{name}, {}, {begin}: {coverage}", noise.name);
                if noise.corner_hz == 0.0 {
                    assert!((0.48..1.52).contains(&loss), "{name}, {begin}: {loss}");
                }
            }
        }
    }
}

/// Gains and angles, which change sign quickly and do not see the slowest noise, hold with every noise, within four standard deviations of the
/// 240 or 480 values.
#[test]
fn intervals_of_gains_and_angles_hold_the_truth_with_every_noise() {
    let (runs, scatter) = Size::asked().of((40, 0.0141), (80, 0.01));
    for noise in NOISES {
        let tallies = study("lin", noise, runs);
        let all = ["sigma", "xi"].map(|begin| pooled(&tallies, begin)[0]);
        let coverage = 0.5 * (all[0] + all[1]);
        assert!((coverage - 0.95).abs() <= 4.0 * scatter, "{}: {coverage}", noise.name);
    }
}

#[test]
fn intervals_of_freq_hold_the_truth_with_white_and_with_slow_noise() {
    for noise in [NOISES[0], NOISES[3]] {
        let tallies = study("freq", noise, 6);
        // 18 values: 5 % and 33 %; amplitudes and phases of 30 frequencies more.
        for (begin, least) in [("amplitude", 0.91), ("phase", 0.91), ("f_3db", 0.74), ("f_s_", 0.74)] {
            let [coverage, _, loss] = pooled(&tallies, begin);
            assert!((least..=1.0).contains(&coverage), "{}, {begin}: {coverage}", noise.name);
            assert!((0.2..2.4).contains(&loss), "{}, {begin}: {loss}", noise.name);
        }
    }
}

#[test]
fn the_printed_polynomials_of_one_sensor_come_back_from_the_simulated_campaign() {
    let mut twin = twin::read(&repository("configs/magnetsrode-2013.toml"), &mut Vec::new()).unwrap();
    let group = twin.campaign.instructions.thermal[0].runs.clone().unwrap();
    twin.runs.retain(|run| group.contains(&run.id));
    let printed = std::fs::read_to_string(repository("tests/data/bepicolombo/thermal.toml")).unwrap();
    let rows = closed_loop::compare(&twin, &printed, 5).unwrap();
    // Two coefficients each of sigma, xi and f_3db, four each of b_or and b_off, three components.
    assert_eq!(rows.len(), 3 * (2 + 2 + 2 + 4 + 4));
    let held = rows.iter().filter(|row| row.covered()).count();
    // The coefficients of one polynomial go together: some fifteen independent intervals.
    assert!(held * 100 >= 78 * rows.len(), "{held} of {}", rows.len());
    for row in &rows {
        assert!(row.z().abs() < 4.5, "{} {} power {}: {}", row.sensor, row.quantity, row.power, row.z());
        // The digits that are printed, and what the printed offsets state as their uncertainty.
        let digits = [("sigma", 1e-5), ("xi", 1e-3), ("b_o", 0.1), ("f_3db", 0.1)];
        let most = digits.iter().find(|(name, _)| row.quantity.starts_with(name)).unwrap().1;
        assert!(row.std > 0.0 && (row.power > 0 || row.std < most), "{} {}", row.quantity, row.std);
    }
    let mode = &rows[0].mode;
    assert!(rows.iter().all(|row| row.mode == *mode && row.sensor == "BS_11"));
}
