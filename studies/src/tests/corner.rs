//! The -3 dB corner from tables of amplitudes.

use super::Size;
use crate::repository;
use calfit::measure::corner::{Amplitude, Corner, Options, Refusal, corner, igep_corner_hz};
use calfit::model::response::{RESPONSES, Response};
use rayon::prelude::*;
use std::path::PathBuf;
use toml_edit::DocumentMut;

const RUNS: [&str; 3] = ["13-04-03-12-59-48", "13-04-03-14-41-31", "13-04-09-12-26-36"];
/// f0 in Hz, Q and DC amplitude in enT of the cases 26-05-07 and 26-05-08.
const CASES: [[[f64; 3]; 3]; 2] = [
    [
        [64.22726376514524, 0.7299393385384997, 601.8696170750053],
        [62.65794372169357, 0.6827991414892671, 589.2837443946179],
        [61.57023956384585, 0.6901824541573822, 604.843455003313],
    ],
    [
        [59.92670242831897, 0.623285980818146, 610.6478458742472],
        [63.09988501131932, 0.735394283283138, 569.5223606058036],
        [64.321007142718, 0.6509367659308746, 586.3375281290406],
    ],
];
/// Their f_3dB, Hz.
const CASE_CORNERS: [[f64; 3]; 2] =
    [[66.23435030265819, 60.43016750191437, 60.06135576676249], [52.01326126469763, 65.52352237584282, 58.812324573894934]];

fn data(name: &str) -> PathBuf {
    repository("tests/data/bepicolombo").join(name)
}

/// A printed table of amplitudes.
fn table(run: &str) -> Vec<Amplitude> {
    let text = std::fs::read_to_string(data(&format!("freq_{run}.csv"))).unwrap();
    let row = |line: &str| {
        let values: Vec<f64> = line.split(',').map(|value| value.parse().unwrap()).collect();
        plain(values[0], values[1..4].try_into().unwrap())
    };
    text.lines().skip(1).map(row).collect()
}

fn plain(frequency_hz: f64, amplitude_ent: [f64; 3]) -> Amplitude {
    Amplitude { frequency_hz, amplitude_ent, std_ent: [f64::NAN; 3], t_s: f64::NAN, usable: true }
}

/// The frequencies of 2013.
fn frequencies() -> Vec<f64> {
    table(RUNS[0]).iter().map(|row| row.frequency_hz).collect()
}

/// Rows without noise.
fn synthetic(response: &str, dc: [f64; 3], parameters: [&[f64]; 3]) -> Vec<Amplitude> {
    let response = Response::named(response).unwrap();
    let amplitudes = |f: f64| std::array::from_fn(|c| dc[c] * response.value(f, parameters[c]));
    frequencies().into_iter().map(|f| plain(f, amplitudes(f))).collect()
}

fn case(index: usize) -> Vec<Amplitude> {
    let [x, y, z] = &CASES[index];
    synthetic("second order", [x[2], y[2], z[2]], [&x[..2], &y[..2], &z[..2]])
}

/// Deterministic noise.
struct Random(u64);

impl Random {
    fn uniform(&mut self) -> f64 {
        // SplitMix64.
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }

    fn gaussian(&mut self) -> f64 {
        (-2.0 * (1.0 - self.uniform()).ln()).sqrt() * (std::f64::consts::TAU * self.uniform()).cos()
    }

    /// Noise of this share of each amplitude.
    fn disturb(&mut self, table: &mut [Amplitude], share: f64) {
        table.iter_mut().flat_map(|row| &mut row.amplitude_ent).for_each(|amplitude| *amplitude *= 1.0 + share * self.gaussian());
    }

    /// Lowers a dozen rows in all components, as lost samples do.
    fn damage(&mut self, table: &mut [Amplitude]) {
        let mut hit = Vec::new();
        while hit.len() < 12 {
            let row = (self.uniform() * table.len() as f64) as usize;
            if !hit.contains(&row) {
                hit.push(row);
                let factor = 0.3 + 0.6 * self.uniform();
                table[row].amplitude_ent.iter_mut().for_each(|amplitude| *amplitude *= factor);
            }
        }
    }
}

/// Value and standard deviation of the model corners, Hz.
fn model_corners(corner: &Corner) -> [[f64; 2]; 3] {
    std::array::from_fn(|c| {
        let model = corner.components[c].model.as_ref().unwrap();
        [model.f_3db_model_hz, model.f_3db_model_std_hz]
    })
}

fn find(table: &[Amplitude]) -> Corner {
    corner(table, &Options::default())
}

fn without_jackknife(table: &[Amplitude]) -> Corner {
    corner(table, &Options { jackknife: false, ..Options::default() })
}

#[test]
fn the_printed_corners_of_2013() {
    let text = std::fs::read_to_string(data("frequency.toml")).unwrap();
    let document: DocumentMut = text.parse().unwrap();
    let mut count = 0;
    for run in document["run"].as_array_of_tables().unwrap() {
        let rows = table(run["name"].as_str().unwrap());
        for (c, printed) in run["f_3db_hz"].as_array().unwrap().iter().enumerate() {
            let points: Vec<(f64, f64)> = rows.iter().map(|row| (row.frequency_hz, row.amplitude_ent[c])).collect();
            let difference = igep_corner_hz(&points).unwrap() - printed.as_float().unwrap();
            println!("{} {c} {difference:+.4}", run["name"].as_str().unwrap());
            assert!(difference.abs() < 0.06);
            count += 1;
        }
    }
    assert_eq!(count, 9);
}

/// In short every third amplitude of every run is left out.
#[test]
fn no_single_amplitude_moves_the_corner_by_three_standard_deviations() {
    let step = Size::asked().of(3, 1);
    let mut worst: f64 = 0.0;
    for run in RUNS {
        let rows = table(run);
        let start = std::time::Instant::now();
        let full = find(&rows);
        let elapsed = start.elapsed();
        let stated = model_corners(&full);
        println!("{run} {:?} {stated:.3?} {elapsed:.1?}", full.model);
        let without = |left_out: usize| {
            let mut fewer = rows.clone();
            fewer.remove(left_out);
            (left_out, without_jackknife(&fewer))
        };
        let all: Vec<(usize, Corner)> = (0..rows.len()).into_par_iter().step_by(step).map(without).collect();
        for (left_out, found) in &all {
            for (c, ([value, _], [all, std])) in model_corners(found).into_iter().zip(stated).enumerate() {
                let moved = (value - all).abs() / std;
                assert!(moved < 3.0, "{run} {c} without {} Hz: {value} for {all} ± {std}", rows[*left_out].frequency_hz);
                worst = worst.max(moved);
            }
        }
    }
    println!("largest move: {worst:.2} standard deviations");
}

#[test]
fn low_readings_of_2013_are_told_apart() {
    let found = without_jackknife(&table(RUNS[1]));
    for component in &found.components {
        let weight = &component.model.as_ref().unwrap().weight;
        assert_eq!(component.model.as_ref().unwrap().neighbours_left_out, 2);
        let out: Vec<f64> = frequencies().into_iter().zip(weight).filter(|(_, w)| **w < 0.5).map(|(f, _)| f).collect();
        assert_eq!(out, [0.126, 0.158, 0.199, 0.251, 0.398, 1.0, 1.99, 6.31, 19.9, 31.6, 39.8, 79.4]);
    }
}

#[test]
fn exact_data_come_back() {
    let size = Size::asked();
    for response in RESPONSES {
        let parameters = response.starts(60.0).remove(0);
        let rows = synthetic(response.name, [600.0, 500.0, 400.0], [&parameters; 3]);
        let truth = response.corner_hz(&parameters).unwrap();
        let responses = size.of(vec![*response], RESPONSES.to_vec());
        let found = corner(&rows, &Options { responses, jackknife: false });
        for [value, std] in model_corners(&found) {
            assert!((value / truth - 1.0).abs() < 1e-6, "{} as {:?}: {value} ± {std} for {truth}", response.name, found.model);
        }
        // A Butterworth response of order 2 is one of second order with Q² = 1/2.
        let same = if response.name == "Butterworth 2" { "second order" } else { response.name };
        assert!([Some(response.name), Some(same)].contains(&found.model), "{} as {:?}", response.name, found.model);
    }
    for index in 0..2 {
        let found = corner(&case(index), &Options { jackknife: size.of(false, true), ..Options::default() });
        for ([value, std], truth) in model_corners(&found).into_iter().zip(CASE_CORNERS[index]) {
            assert!((value - truth).abs() < 1e-6 && std < 1e-3, "{value} ± {std} for {truth}");
        }
    }
}

/// Errors of f_3dB in stated standard deviations for so many seeds of one case, and names of the responses chosen.
fn trials(index: usize, seeds: u64, damaged: bool) -> (Vec<f64>, Vec<&'static str>) {
    let trial = |seed: u64| {
        let mut random = Random(1000 * seed + index as u64);
        let mut rows = case(index);
        random.disturb(&mut rows, 0.001);
        if damaged {
            random.damage(&mut rows);
        }
        find(&rows)
    };
    let all: Vec<Corner> = (0..seeds).into_par_iter().map(trial).collect();
    let mut errors = Vec::new();
    for (seed, found) in all.iter().enumerate() {
        for (c, ([value, std], truth)) in model_corners(found).into_iter().zip(CASE_CORNERS[index]).enumerate() {
            let error = (value - truth) / std;
            if error.abs() > 3.0 {
                println!("case {index} seed {seed} {c} {:?}: {value:.3} ± {std:.3} for {truth:.3}", found.model);
            }
            errors.push(error);
        }
    }
    (errors, all.iter().map(|found| found.model.unwrap()).collect())
}

fn report(name: &str, errors: &[f64], names: &[&str]) {
    let share = |limit: f64| errors.iter().filter(|e| e.abs() <= limit).count() as f64 / errors.len() as f64;
    let rms = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
    let largest = errors.iter().fold(0.0_f64, |a, e| a.max(e.abs()));
    let right = names.iter().filter(|n| **n == "second order").count();
    println!(
        "{name}: within 1.96 {:.3}, rms {rms:.3}, largest {largest:.2}, second order {right} of {}",
        share(1.96),
        names.len()
    );
}

#[test]
fn noise_and_damage_are_within_the_uncertainty() {
    for index in 0..2 {
        for damaged in [false, true] {
            let (errors, names) = trials(index, Size::asked().of(1, 8), damaged);
            report(&format!("case {index}, damaged {damaged}"), &errors, &names);
            assert!(errors.iter().all(|e| e.abs() < 3.5), "{errors:?}");
        }
    }
}

/// Four standard deviations about 95 %, of values that go together in threes; with one seed the share says little.
#[test]
fn intervals_of_95_percent_hold_the_truth() {
    let (seeds, limits) = Size::asked().of((1, 0.3..=1.0), (150, 0.93..=0.995));
    for index in 0..2 {
        for damaged in [false, true] {
            let (errors, names) = trials(index, seeds, damaged);
            report(&format!("case {index}, damaged {damaged}"), &errors, &names);
            let covered = errors.iter().filter(|e| e.abs() <= 1.96).count() as f64 / errors.len() as f64;
            assert!(limits.contains(&covered), "{covered}");
        }
    }
}

#[test]
fn order_and_unusable_rows_do_not_matter() {
    let rows = table(RUNS[0]);
    let expected = without_jackknife(&rows);
    let mut turned: Vec<Amplitude> = rows.iter().rev().copied().collect();
    turned.insert(3, Amplitude { usable: false, ..plain(64.0, [1.0; 3]) });
    turned.insert(9, plain(f64::NAN, [600.0; 3]));
    turned.insert(12, plain(10.0, [f64::NAN; 3]));
    let found = without_jackknife(&turned);
    assert_eq!(found.model, expected.model);
    for (a, b) in found.components.iter().zip(&expected.components) {
        assert_eq!(a.f_3db_igep_hz, b.f_3db_igep_hz);
        let (a, b) = (a.model.as_ref().unwrap(), b.model.as_ref().unwrap());
        assert_eq!(a.f_3db_model_hz, b.f_3db_model_hz);
        assert_eq!([a.weight[3], a.weight[9], a.weight[12]], [0.0; 3]);
    }
}

#[test]
fn what_is_below_the_noise_is_flagged() {
    let mut rows = case(0);
    rows.iter_mut().for_each(|row| row.std_ent = [4.0; 3]);
    let found = without_jackknife(&rows);
    for (c, component) in found.components.iter().enumerate() {
        for (row, undetected) in rows.iter().zip(&component.undetected) {
            assert_eq!(*undetected, row.amplitude_ent[c] < 12.0);
        }
        assert!(component.undetected.iter().filter(|u| **u).count() > 3);
        assert!((component.f_3db_igep_hz.unwrap() - CASE_CORNERS[0][c]).abs() < 2.0);
        let model = component.model.as_ref().unwrap();
        assert!((model.f_3db_model_hz - CASE_CORNERS[0][c]).abs() < 0.5 && model.f_3db_model_std_hz > 0.05);
    }
}

#[test]
fn what_has_no_corner_says_why() {
    let refusals = |rows: &[Amplitude]| {
        let found = find(rows);
        assert_eq!(found.model, None);
        assert!(found.candidates.iter().all(|candidate| candidate.aicc.is_none()));
        serde_json::to_string(&found).unwrap();
        let [x, _, _] = found.components;
        assert!(x.model.is_none() && (x.f_3db_igep_hz.is_none() == x.igep_refusal.is_some()));
        (x.f_3db_igep_hz.ok_or(x.igep_refusal), x.model_refusal.unwrap())
    };
    let no_crossing = Refusal::NoCrossing { highest_hz: 1000.0 };
    let all = |value: f64| -> Vec<Amplitude> { frequencies().into_iter().map(|f| plain(f, [value; 3])).collect() };
    assert_eq!(refusals(&[]), (Err(Some(Refusal::NoAmplitude)), Refusal::NoAmplitude));
    assert_eq!(refusals(&all(0.0)), (Err(Some(Refusal::NoAmplitude)), Refusal::NoAmplitude));
    assert_eq!(refusals(&all(f64::NAN)), (Err(Some(Refusal::NoAmplitude)), Refusal::NoAmplitude));
    assert_eq!(refusals(&all(-1.0)), (Err(Some(Refusal::NoAmplitude)), Refusal::NoAmplitude));
    assert_eq!(refusals(&all(600.0)), (Err(Some(no_crossing.clone())), no_crossing));
    let one = Refusal::NoCrossing { highest_hz: 1.0 };
    assert_eq!(refusals(&[plain(1.0, [600.0; 3])]), (Err(Some(one.clone())), one));
    let (igep, model) = refusals(&[plain(1.0, [600.0; 3]), plain(101.0, [300.0; 3])]);
    assert!((igep.unwrap() - (1.0 + 300.0 / (20.0 * 2f64.log10()))).abs() < 1e-9);
    assert!(matches!(model, Refusal::NoModel { .. } | Refusal::TooFew { rows: 2, .. }), "{model}");
    // Two rows at one frequency.
    let (igep, _) = refusals(&[plain(50.0, [600.0; 3]), plain(50.0, [300.0; 3])]);
    assert_eq!(igep, Ok(50.0));
}

#[test]
fn a_component_without_amplitudes_leaves_the_others() {
    let mut rows = table(RUNS[0]);
    rows.iter_mut().for_each(|row| row.amplitude_ent[1] = f64::NAN);
    let found = without_jackknife(&rows);
    assert_eq!(found.components[1].model_refusal, Some(Refusal::NoAmplitude));
    assert!((found.components[0].model.as_ref().unwrap().f_3db_model_hz - 65.2).abs() < 0.5);
}
