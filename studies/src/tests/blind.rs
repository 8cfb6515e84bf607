//! The blind study in short: its strengths mean what they say, its noise is whitened with its true covariance, its score counts right,
//! and it comes out the same however many threads make it. The full tables are in `reports`.

use super::{Size, too_many};
use crate::blind;

use blind::kinds::{Measure, generate, nuisance, plateau_cells, sample_cells};
use blind::noise::{Cell, Family, Noise, Random, Whitener};
use blind::report::report;
use blind::score::{Purpose, Score, Share, family, plan, plan_from, run};
use blind::sensor::{CleanRun, Kind, Sensor};
use blind::{Amplitude, Blind, Options, TrueParameter, Verdict, VerdictStep, effects, judge, picture, poles};
use calfit::diagnose::candidate::{Accepted, Threshold};
use calfit::diagnose::means::Means;
use calfit::diagnose::problem::Problem;
use calfit::fit::statistics::central_median;
use calfit::model::effects::Catalogue;
use calfit::record::plan::Plan;
use calfit::record::prepared::PreparedRun;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::distribution::{Binomial, DiscreteCDF};
use std::collections::BTreeSet;

/// A position in which the first axis of the sensor stands along the third one of the coils.
const TURNED: u32 = 3;

/// Covariance of the means by the double sum over the samples, from the autocorrelation of each process.
fn covariance(noise: &Noise, clean: &CleanRun, component: usize, cells: &[Cell]) -> DMatrix<f64> {
    let unit = noise.white_ent[component];
    DMatrix::from_fn(cells.len(), cells.len(), |i, j| {
        let (a, b) = (cells[i], cells[j]);
        // The field along the axis of the sensor, which stands turned.
        let factor = |cell: Cell| {
            let (axis, field) = (clean.towards[component], clean.field_nt[cell.first]);
            (axis[0] * field[0] + axis[1] * field[1] + axis[2] * field[2]) / clean.range_nt()
        };
        let slow: f64 = noise
            .slow
            .iter()
            .map(|r| {
                let mut sum = 0.0;
                for s in a.first..a.first + a.count {
                    for t in b.first..b.first + b.count {
                        sum += (-(s.abs_diff(t) as f64) / (r.tau_s * clean.rate_hz)).exp();
                    }
                }
                let both = if r.proportional { factor(a) * factor(b) } else { 1.0 };
                both * r.variance_ent2 * unit * unit * sum / (a.count * b.count) as f64
            })
            .sum();
        slow + if i == j { unit * unit / a.count as f64 } else { 0.0 }
    })
}

#[test]
fn whitening_is_that_of_the_true_covariance() {
    for family in [Family::PowerLaw, Family::Autoregressive, Family::Telegraph, Family::ProportionalFlicker] {
        let mut random = Random::new(5, family.name());
        let clean = CleanRun::drawn(Kind::Lin, Sensor::drawn(Kind::Lin, &mut random), TURNED, &mut random);
        let noise = Noise::drawn(family, &clean, &mut random);
        let cells: Vec<Cell> =
            clean.plateaus.iter().take(14).map(|p| Cell { first: p.start, count: p.len() - 50 * random.below(3) }).collect();
        let column: Vec<f64> = cells.iter().map(|_| random.normal()).collect();
        let white = Whitener::new(&noise, &clean, 0, &cells).apply(&column);
        let length = white.iter().map(|v| v * v).sum::<f64>();
        let x = DVector::from_column_slice(&column);
        let expected = (x.transpose() * covariance(&noise, &clean, 0, &cells).cholesky().unwrap().solve(&x))[0];
        assert!((length / expected - 1.0).abs() < 1e-6, "{}: {length} {expected}", family.name());
    }
}

/// A matched filter over draws of the noise: its mean is the strength, its standard deviation one. With 60 draws the mean scatters by
/// 0.13 and the deviation by 0.09; the limits are four of them.
#[test]
fn a_strength_is_what_a_matched_filter_measures() {
    const DRAWS: u64 = 60;
    let cases = [
        (Kind::Lin, "cubic_nonlinearity", Family::PowerLaw),
        (Kind::Lin, "settling", Family::GrowsWithField),
        (Kind::Sweep, "thermal_lag", Family::HeavyTails),
        (Kind::Positions, "facility_angle", Family::White),
    ];
    for (kind, name, family) in cases {
        let options = Options { effects: vec![name.to_owned()], strength_k: 6.0, noise: Some(family), ..Options::default() };
        // Some lags are of nature's own size and have no strength that was asked for.
        let scaled = |blind: &Blind| !blind.truth.effects[0].natural_size;
        let blind = (3..20).map(|seed| generate(seed, kind, &options).unwrap()).find(scaled).unwrap();
        let effect = &blind.truth.effects[0];
        assert!((effect.strength_k - 6.0).abs() < 1e-5, "{name}: {}", effect.strength_k);
        let cells = if effect.seen_inside_plateaus { sample_cells(&blind.clean_runs) } else { plateau_cells(&blind.clean_runs) };
        let own = nuisance(&blind.clean_runs, &cells);
        let measure = Measure::new(&blind.clean_runs, &blind.truth.noise, cells, &own);
        let (_, template) = measure.white(&blind.hidden_ent[0]);
        let norm = template.iter().map(|v| v * v).sum::<f64>().sqrt();
        let values: Vec<f64> = (0..DRAWS)
            .map(|draw| {
                let mut random = Random::new(draw, "matched filter");
                let mut records: Vec<Vec<[f64; 3]>> =
                    blind.clean_runs.iter().map(|s| blind.truth.noise.record(s, &mut random)).collect();
                for (record, hidden) in records.iter_mut().zip(&blind.hidden_ent[0]) {
                    record.iter_mut().zip(hidden).for_each(|(r, h)| (0..3).for_each(|i| r[i] += h[i]));
                }
                measure.white(&records).1.iter().zip(&template).map(|(a, b)| a * b).sum::<f64>() / norm
            })
            .collect();
        let mean = values.iter().sum::<f64>() / DRAWS as f64;
        let std = (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (DRAWS - 1) as f64).sqrt();
        assert!((mean - 6.0).abs() < 4.0 * 0.13, "{name}: {mean}");
        assert!((std - 1.0).abs() < 4.0 * 0.09, "{name}: {std}");
    }
}

/// Edges displaced by up to half of the second between the settings, either way, so that some stand inside the plateaus: all within three
/// standard uncertainties. From half of it on the field between the settings cannot be told from that of the setting before or after.
#[test]
fn edges_far_from_their_settings_are_measured() {
    let options =
        Options { effects: vec!["time_shift".to_owned()], strength_k: 8.0, noise: Some(Family::White), ..Options::default() };
    let made: Vec<(u64, f64, Verdict)> = (0..24_u64)
        .into_par_iter()
        .filter_map(|seed| {
            let blind = generate(seed, Kind::Lin, &options).unwrap();
            let truth = blind.truth.effects[0].parameters[0].value;
            (truth.abs() <= 0.5).then(|| (seed, truth, judge::judge(&blind)))
        })
        .collect();
    let mut far = 0;
    for (seed, truth, verdict) in made {
        let step = verdict.steps.first().unwrap_or_else(|| panic!("{seed}: {truth} s was not found"));
        assert_eq!(step.effect, "time_shift", "{seed}: {truth} s");
        let said = step.amplitudes.iter().find(|a| a.name == "dt").unwrap();
        assert!((said.value - truth).abs() < 3.0 * said.std, "{seed}: {truth} s, said {} +- {} s", said.value, said.std);
        far += usize::from(truth.abs() > 0.3);
    }
    assert!(far >= 3, "{far}");
}

/// Fraction and time constant of a transient: standard uncertainties contain that they go together. Of sixteen values at most three lie
/// beyond two of them, which sixteen of normal noise exceed in one of two hundred sets.
#[test]
fn a_transient_and_its_time_constant_have_honest_uncertainties() {
    let options =
        Options { effects: vec!["settling".to_owned()], strength_k: 30.0, noise: Some(Family::White), ..Options::default() };
    let exact = (0..).map(|seed| generate(seed, Kind::Lin, &options).unwrap()).filter(|b| b.truth.effects[0].exact_form);
    let exact: Vec<Blind> = exact.take(8).collect();
    let verdicts: Vec<Verdict> = exact.par_iter().map(judge::judge).collect();
    let mut off = Vec::new();
    for (blind, verdict) in exact.iter().zip(&verdicts) {
        let step = verdict.steps.iter().find(|s| s.effect == "settling").unwrap();
        for parameter in &blind.truth.effects[0].parameters {
            let name = if parameter.name == "tau_s" { "tau" } else { &parameter.name };
            let said = step.amplitudes.iter().find(|a| a.name == name).unwrap();
            off.push((said.value - parameter.value) / said.std);
        }
    }
    assert_eq!(off.len(), 16);
    assert!(off.iter().filter(|z| z.abs() > 2.0).count() <= 3, "{off:?}");
}

/// Each of the two looks like slow noise beside the other one, and neither stands out alone.
#[test]
fn two_effects_that_are_noise_to_each_other_are_found() {
    let cases = [
        (12_168_934_219_992, ["offset_step", "rack_temperature"], Family::White),
        (12_168_934_219_354, ["rack_temperature", "sensor_temperature_offset"], Family::Autoregressive),
    ];
    cases.into_par_iter().for_each(|(seed, names, family)| {
        let effects = names.map(str::to_owned).to_vec();
        let blind =
            generate(seed, Kind::Lin, &Options { effects, strength_k: 8.0, noise: Some(family), ..Options::default() }).unwrap();
        let mut said: Vec<String> = judge::judge(&blind).steps.into_iter().map(|s| s.effect).collect();
        said.sort();
        assert_eq!(said, names, "{seed}");
    });
}

/// Readings that follow the rack late, through a low-pass, are readings that follow the rack: no drift stands in for it, or beside it.
#[test]
fn a_late_rack_is_no_drift() {
    let options = Options {
        effects: vec!["rack_temperature".to_owned()],
        strength_k: 30.0,
        noise: Some(Family::White),
        ..Options::default()
    };
    (0..8_u64).into_par_iter().for_each(|seed| {
        let steps = judge::judge(&generate(seed, Kind::Lin, &options).unwrap()).steps;
        let said: Vec<&str> = steps.iter().map(|s| s.effect.as_str()).collect();
        assert_eq!(said, ["rack_temperature"], "{seed}");
    });
}

/// A sensor that follows its thermistor by minutes is no line in the lag, and splines of the temperature follow that line better than the
/// line does: the lag has to be named all the same, with its time constant within a tenth.
#[test]
fn long_lags_are_no_curves_of_the_temperature() {
    let options =
        Options { effects: vec!["thermal_lag".to_owned()], strength_k: 6.0, noise: Some(Family::White), ..Options::default() };
    let of_nature = (0..).filter_map(|seed| {
        let blind = generate(seed, Kind::Sweep, &options).unwrap();
        let effect = &blind.truth.effects[0];
        let tau_s = effect.parameters[0].value;
        (effect.natural_size && tau_s > 600.0).then_some((seed, tau_s, blind))
    });
    let of_nature: Vec<(u64, f64, Blind)> = of_nature.take(Size::asked().of(3, 5)).collect();
    of_nature.into_par_iter().for_each(|(seed, tau_s, blind)| {
        let steps = judge::judge(&blind).steps;
        assert_eq!(steps[0].effect, "thermal_lag", "{seed}: {tau_s} s");
        let said = &steps[0].amplitudes.iter().find(|a| a.name == "lag").unwrap();
        assert!((said.value / tau_s - 1.0).abs() < 0.1, "{seed}: {tau_s} s, said {} s", said.value);
    });
}

/// Without an effect the two names come as often whichever was drawn: their shares of right ones make 100 % within four standard
/// deviations of 2000 draws each. Far beyond the difference of the signatures every name is right.
#[test]
fn names_of_poles_are_told_by_strength_alone() {
    let [one, two] = poles::told_apart(&[1e-6, 500.0]);
    let none = one[0] + two[0];
    assert!((none - 100.0).abs() < 4.0 * (2.0_f64 * 2500.0 / 2000.0).sqrt(), "{none}");
    assert!(one[1] > 99.0 && two[1] > 99.0);
}

/// Says what is true, as a perfect diagnosis would.
fn knows(blind: &Blind) -> Verdict {
    let truth = &blind.truth.effects;
    let step = |e: &blind::TrueEffect| VerdictStep {
        effect: e.effect.clone(),
        axes: e.axes.clone(),
        family: family(&e.effect).to_owned(),
        covariate: e.covariates.first().cloned(),
        strength_k: e.strength_k,
        amplitudes: e.parameters.iter().map(|p| Amplitude { name: p.name.clone(), value: p.value, std: p.value.abs() }).collect(),
        ..VerdictStep::default()
    };
    Verdict {
        steps: truth.iter().filter(|e| e.identifiable).map(step).collect(),
        not_identifiable: truth.iter().filter(|e| !e.identifiable).map(|e| e.effect.clone()).collect(),
        ..Verdict::default()
    }
}

#[test]
fn the_score_of_one_who_knows_and_of_one_who_is_silent() {
    let kinds = [Kind::Lin, Kind::Sweep, Kind::Positions];
    let cases = plan(4, 40, &kinds);
    assert_eq!(cases.len(), 44);
    let known = Score::of(&run(&cases, knows, || {}).unwrap());
    let all = |share: &Share| share.hits == share.of;
    assert!(known.found.values().chain(known.first_exact.values()).chain(known.set_holds.values()).all(all));
    assert!(known.two_exact.values().chain(known.outside_covariate.values()).chain(known.absorbed_said.values()).all(all));
    assert!(known.axes_right.values().chain(known.first_family.values()).all(all));
    assert!(known.outside_wrong.values().chain(known.false_alarms.values()).all(|share| share.hits == 0));
    assert!(known.confusion.iter().all(|((truth, name), _)| truth == name));
    assert_eq!(known.interval.hits, known.interval.of);
    assert!(known.interval.of > 0 && known.further_terms.iter().all(|n| *n == 0.0));
    let count = |purpose: Purpose| cases.iter().filter(|c| c.purpose == purpose).count() as u64;
    let of = |shares: Vec<&Share>| shares.iter().map(|s| s.of).sum::<u64>();
    assert_eq!(of(known.false_alarms.values().collect()), count(Purpose::Null));
    assert_eq!(of(known.absorbed_said.values().collect()), count(Purpose::Absorbed));

    let silent = Score::of(&run(&cases, |_| Verdict::default(), || {}).unwrap());
    assert!(silent.found.values().chain(silent.two_exact.values()).all(|share| share.hits == 0));
    assert!(silent.first_exact.is_empty());
    assert!(report(&silent, "command", 44).contains("| first name right at k = 6 | ≥ 90 % | - | not measured |"));
    assert!(picture::power(&known).is_ok() && picture::confusion(&known).is_ok());
}

#[test]
fn equal_seeds_make_equal_runs_whatever_the_threads() {
    let cases = plan(1, 2, &[Kind::Lin]);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let seen = |blind: &Blind| {
            let sum = blind.runs.iter().flat_map(|(_, v)| v).map(|v| v.reading.0[0]).sum::<f64>();
            let blocks = blind.runs.iter().flat_map(|(r, _)| &r.blocks).map(|b| b.mean.0[0]).sum::<f64>();
            Verdict { oracle_chi2: Some([sum, blocks]), ..judge::judge(blind) }
        };
        let judged = pool.install(|| run(&cases, seen, || {})).unwrap();
        judged.iter().map(|j| format!("{:?}", j.verdict)).collect::<Vec<_>>()
    };
    assert_eq!(with(1), with(2));
}

/// The true model closes about k² of the gap; with fitted amplitudes and predictions of stretches somewhat less.
#[test]
fn the_true_model_closes_the_gap_that_its_effect_made() {
    let ratios: Vec<f64> = (0..12)
        .map(|seed| {
            let options = Options {
                effects: vec!["quadratic_nonlinearity".to_owned()],
                strength_k: 20.0,
                noise: Some(Family::White),
                ..Options::default()
            };
            let [before, after] = blind::score::oracle(&generate(seed, Kind::Lin, &options).unwrap()).unwrap();
            (before - after) / 400.0
        })
        .collect();
    let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
    // χ² of 400 has a standard deviation of 40, a tenth; the held-out prediction adds parts of the nuisance parameters to the gap.
    assert!((0.7..1.5).contains(&mean), "{ratios:?}");
}

/// No hits in n trials: the limit is 1 - 0.05^(1/n); all hits: 0.05^(1/n).
#[test]
fn limits_of_shares_are_those_of_clopper_and_pearson() {
    let none = Share { hits: 0, of: 2000 };
    assert!((none.upper_percent() - 100.0 * (1.0 - 0.05_f64.powf(1.0 / 2000.0))).abs() < 1e-6);
    let all = Share { hits: 30, of: 30 };
    assert!((all.lower_percent() - 100.0 * 0.05_f64.powf(1.0 / 30.0)).abs() < 1e-6);
    // Of two trials one: 2p - p² = 0.95 and p² = 0.95 in turn.
    let half = Share { hits: 1, of: 2 };
    assert!((half.lower_percent() - 100.0 * (1.0 - 0.95_f64.sqrt())).abs() < 1e-6);
    assert!((half.upper_percent() - 100.0 * 0.95_f64.sqrt()).abs() < 1e-6);
}

/// The short form of the study: 1 % of false alarms and 98 % of right names, each of which would fail once in 150 studies.
#[test]
fn a_short_study_is_silent_on_noise_and_names_what_is_strong() {
    let size = Size::asked();
    let count: u64 = size.of(16, 72);
    let nulls = plan(count, 0, &[Kind::Lin, Kind::Sweep]);
    let score = Score::of(&run(&nulls, judge::judge, || {}).unwrap());
    let alarms: u64 = score.false_alarms.values().map(|share| share.hits).sum();
    assert!(alarms < too_many(count, 0.01), "{alarms} false alarms of {count}");

    let cases: Vec<(u64, &str)> = effects::visible(Kind::Lin)
        .iter()
        .enumerate()
        .flat_map(|(i, name)| (5..size.of(6, 7)).map(move |set| (1000 * set + i as u64, *name)))
        .collect();
    let said: Vec<String> = cases
        .par_iter()
        .map(|(seed, name)| {
            let options = Options { effects: vec![(*name).to_owned()], strength_k: 15.0, noise: None, ..Options::default() };
            let verdict = judge::judge(&generate(*seed, Kind::Lin, &options).unwrap());
            verdict.steps.first().map_or_else(String::new, |s| s.effect.clone())
        })
        .collect();
    let wrong: Vec<_> = cases.iter().zip(&said).filter(|((_, name), said)| name != said).collect();
    assert!((wrong.len() as u64) < too_many(cases.len() as u64, 0.02), "{wrong:?}");
}

/// First names of single effects in white noise, far beyond what noise makes; the first runs that are `wanted`.
fn first_names(effect: &str, kind: Kind, strength_k: f64, wanted: impl Fn(&Blind) -> bool) -> Vec<String> {
    let options = Options { effects: vec![effect.to_owned()], strength_k, noise: Some(Family::White), ..Options::default() };
    let first: Vec<Blind> = (7000..).map(|seed| generate(seed, kind, &options).unwrap()).filter(wanted).take(4).collect();
    first.par_iter().map(|blind| judge::judge(blind).steps.first().map_or_else(String::new, |s| s.effect.clone())).collect()
}

/// A signal whose period is longer than the 6 s of a plateau shows by what is left of it around the means.
#[test]
fn signals_slower_than_a_plateau_are_found() {
    let slow = |b: &Blind| b.truth.effects[0].parameters.iter().any(|p| p.name == "period" && p.value > 7.0);
    assert_eq!(first_names("heater_pwm", Kind::Lin, 25.0, slow), ["heater_pwm"; 4]);
}

/// Of the settings of a linearity run a dozen have more than one component: few for a curve, enough for a line.
#[test]
fn products_of_components_are_told_with_their_covariate() {
    (8000..8006_u64).into_par_iter().for_each(|seed| {
        let options =
            Options { effects: vec!["product".to_owned()], strength_k: 20.0, noise: Some(Family::White), ..Options::default() };
        let blind = generate(seed, Kind::Lin, &options).unwrap();
        let verdict = judge::judge(&blind);
        let step = verdict.steps.first().unwrap_or_else(|| panic!("seed {seed}: nothing was found"));
        let right = step.covariate.as_ref().is_some_and(|c| blind.truth.effects[0].covariates.contains(c));
        assert!(step.effect == "unknown" && right, "seed {seed}: {} {:?}", step.effect, step.covariate);
    });
}

/// Sizes of what follows a temperature are neither too small nor too large: of values that are named for standing out some were lucky, but slow noise that
/// may stand in for an effect is no luck of its size, and a thermistor's noise makes sizes small.
#[test]
fn sizes_of_temperatures_have_no_bias() {
    let cases: Vec<(&str, u64)> = ["coil_temperature", "sensor_temperature_offset"]
        .into_iter()
        .flat_map(|e| (8300..8324).map(move |seed| (e, seed)))
        .collect();
    // Value minus truth over the standard uncertainty, positive away from zero.
    let off = |(effect, seed): (&str, u64)| {
        let options = Options { effects: vec![effect.to_owned()], strength_k: 12.0, ..Options::default() };
        let blind = generate(seed, Kind::Lin, &options).unwrap();
        let truth = &blind.truth.effects[0];
        let steps = if truth.exact_form { judge::judge(&blind).steps } else { Vec::new() };
        let named = steps.into_iter().find(|s| s.effect == effect);
        let amplitudes = named.map_or_else(Vec::new, |s| s.amplitudes);
        let of = |p: &TrueParameter| {
            amplitudes.iter().find(|a| a.name == p.name).map(|a| (a.value - p.value) * p.value.signum() / a.std)
        };
        truth.parameters.iter().filter_map(of).collect::<Vec<f64>>()
    };
    let all: Vec<f64> = cases.into_par_iter().flat_map(off).collect();
    let count = all.len() as f64;
    let mean = all.iter().sum::<f64>() / count;
    assert!(count > 20.0 && mean.abs() < 3.0 / count.sqrt(), "{mean} of {count}: {all:.1?}");
}

/// A hysteresis that remembers the largest field of its axis, which fades, is in no catalogue: a jump of the offset or a memory of the setting before may
/// come near it, and are not certain then. A jump that is none is.
#[test]
fn the_memory_of_the_largest_field_is_no_certain_step() {
    let certain = |name: &str, strength_k: f64| -> Vec<(u64, String)> {
        let options = Options { effects: vec![name.to_owned()], strength_k, ..Options::default() };
        let of = |seed: u64| {
            let verdict = judge::judge(&generate(seed, Kind::Lin, &options).unwrap());
            let certain = verdict.steps.into_iter().filter(|s| s.confident && s.effect != "unknown");
            certain.map(|s| (seed, s.effect)).collect::<Vec<_>>()
        };
        (8100..8108_u64).into_par_iter().flat_map(of).collect()
    };
    let of_hysteresis = certain("extreme", 20.0);
    assert!(of_hysteresis.is_empty(), "{of_hysteresis:?}");
    let of_steps = certain("offset_step", 30.0);
    assert!(of_steps.len() >= 6 && of_steps.iter().all(|(_, effect)| effect == "offset_step"), "{of_steps:?}");
}

/// The squares of the components of a field of one size add up to a constant: beside the square of the axis itself those of the two others are the same
/// curve. Which one acts is not certain then, and is where nothing else is named.
#[test]
fn which_field_across_acts_is_not_certain_beside_an_even_curve() {
    // Of 8205, 8207, 8210 and 8211 the wrong one is the better one.
    let seeds = Size::asked().of(8204..8208_u64, 8200..8212);
    let named = |effects: &[&str]| -> Vec<(u64, String, Verdict)> {
        let effects: Vec<String> = effects.iter().map(|name| (*name).to_owned()).collect();
        let options = Options { effects, strength_k: 15.0, ..Options::default() };
        let of = |seed: u64| {
            let blind = generate(seed, Kind::Sweep, &options).unwrap();
            let across = blind.truth.effects.iter().find(|e| e.effect == "transverse_field").unwrap();
            (seed, format!("from_{}", across.form.chars().last().unwrap()), judge::judge(&blind))
        };
        seeds.clone().into_par_iter().map(of).collect()
    };
    let certain = |verdict: &Verdict| {
        let is_it = |s: &&VerdictStep| s.effect == "transverse_field" && s.confident;
        verdict.steps.iter().find(is_it).map(|s| s.amplitudes[0].name.clone())
    };
    for (seed, from, verdict) in named(&["quadratic_nonlinearity", "transverse_field"]) {
        // A single term that explains both is the simpler explanation, and may be certain.
        let name = certain(&verdict).filter(|_| verdict.steps.len() > 1);
        assert!(name.as_ref().is_none_or(|name| name.ends_with(&from)), "{seed}: {name:?} for {from}");
    }
    let alone: Vec<bool> =
        named(&["transverse_field"]).iter().filter_map(|(_, from, verdict)| Some(certain(verdict)?.ends_with(from))).collect();
    assert!(2 * alone.len() >= seeds.count() && alone.iter().all(|is_right| *is_right), "{alone:?}");
}

/// A wave is a drift although its period changes by up to 30 %.
#[test]
fn slow_waves_are_drifts() {
    let wave = |b: &Blind| b.truth.effects[0].form.contains("wave");
    assert_eq!(first_names("offset_drift", Kind::ZeroField, 50.0, wave), ["offset_drift"; 4]);
}

/// A run of the study of all kinds of runs, and the names that the diagnosis gives.
fn named_in_the_study(seed: u64) -> (Blind, BTreeSet<String>) {
    const FIRST: u64 = 3_000_000;
    let cases = plan_from(FIRST, 2000, 4200, &[Kind::Lin, Kind::Sweep, Kind::ZeroField, Kind::Positions, Kind::Frequency]);
    let case = cases.iter().find(|case| case.seed == seed).unwrap();
    let blind = generate(seed, case.kind, &case.options).unwrap();
    let named = judge::judge(&blind).steps.into_iter().map(|s| s.effect).collect();
    (blind, named)
}

/// A rack whose temperature goes to and fro resembles a drift that does: the drift is no rack, and the rack no drift. Cases of the study of all kinds
/// of runs, in which the rack was named for both.
#[test]
fn a_drift_that_goes_to_and_fro_is_not_called_the_rack() {
    let wanted = [(12_168_937_199_525, false), (12_168_937_198_307, true), (12_168_937_201_107, true)];
    wanted.into_par_iter().for_each(|(seed, is_rack)| {
        let (blind, named) = named_in_the_study(seed);
        let hidden = |name: &str| blind.truth.effects.iter().any(|e| e.effect == name);
        assert_eq!([hidden("offset_drift"), hidden("rack_temperature")], [!is_rack, is_rack], "{seed}");
        assert_eq!([named.contains("offset_drift"), named.contains("rack_temperature")], [!is_rack, is_rack], "{seed}");
    });
}

/// A low-pass of a third of a sample interval beside noise seems to decay within an interval and a little: that is no settling.
#[test]
fn what_may_be_the_low_pass_of_the_sensor_is_no_settling() {
    [12_168_937_198_694, 12_168_937_197_487].into_par_iter().for_each(|seed| {
        let (blind, named) = named_in_the_study(seed);
        assert!(blind.truth.effects.iter().all(|e| named.contains(&e.effect)), "{seed}: {named:?}");
        assert!(!named.contains("settling"), "{seed}: {named:?}");
    });
}

/// A linearity run with white noise and effects of k = 50.
fn strong(seed: u64, effects: &[&str]) -> PreparedRun {
    let effects = effects.iter().map(|name| (*name).to_owned()).collect();
    let options = Options { effects, strength_k: 50.0, noise: Some(Family::White), ..Options::default() };
    judge::prepared(&generate(seed, Kind::Lin, &options).unwrap()).unwrap()
}

fn means(prepared: &PreparedRun) -> Means<'_> {
    Means::new(prepared, prepared.readings.clone(), &Catalogue::default(), Vec::new())
}

/// Beside the noise and the uncertainty of their predictions readings that were left out are off by chi square one, whether much or little is
/// near them: of six runs with 1620 readings the mean is within four standard deviations of 0.035. An effect of k = 50 adds most of its 2500 to
/// those 270 readings.
#[test]
fn predictions_fail_where_an_effect_is_missing() {
    let mut silent = Vec::new();
    for seed in 0..6 {
        let [without, with] = [strong(seed, &[]), strong(seed, &["cubic_nonlinearity"])];
        let noise = means(&without).model(&[]).unwrap().noise;
        silent.extend(means(&without).surprise(&noise, &[]));
        let missing: f64 = means(&with).surprise(&noise, &[]).iter().sum();
        assert!(missing > 3.0 + 0.5 * 2500.0 / 90.0, "{seed}: {missing}");
    }
    let mean = silent.iter().sum::<f64>() / silent.len() as f64;
    assert!((mean - 1.0).abs() < 0.14, "{silent:?}");
}

/// A cube that was ruled out is named no more, but what is named in its place may be it.
#[test]
fn what_was_ruled_out_stays_a_rival() {
    for seed in 0..4 {
        let prepared = strong(seed, &["cubic_nonlinearity"]);
        let mut means = means(&prepared);
        let without = means.fitted(&[]).unwrap();
        let forms = means.candidates.iter().filter(|c| c.effect.as_str() == "cubic_nonlinearity").cloned();
        for candidate in forms.collect::<Vec<_>>() {
            means.rule_out(&Accepted { candidate, p_global: 0.0, trials: 1, threshold: Threshold::Strength(4.0) });
        }
        let named = means.evident(&without, &[]).unwrap();
        assert!(!named.is_empty() && named.iter().all(|t| t.candidate.effect.as_str() != "cubic_nonlinearity"), "seed {seed}");
        let first = &named[..1];
        let facts = means.describe(&means.fitted(first).unwrap(), first, 0, 1).facts;
        assert!(
            facts.ambiguous_with.iter().any(|e| e.as_str() == "cubic_nonlinearity"),
            "seed {seed}: {:?}",
            facts.ambiguous_with
        );
        assert!(!facts.is_certain(), "seed {seed}");
    }
}

/// A thermistor that jumps is a fault of the data; nothing is made up to explain the readings with its temperatures.
#[test]
fn a_thermistor_that_jumps_brings_nothing_else() {
    (5100..5106_u64).into_par_iter().for_each(|seed| {
        let options = Options { effects: vec!["bad_thermistor".to_owned()], noise: Some(Family::White), ..Options::default() };
        let verdict = judge::judge(&generate(seed, Kind::Sweep, &options).unwrap());
        let names: Vec<&str> = verdict.steps.iter().map(|s| s.effect.as_str()).collect();
        assert_eq!(names, ["bad_thermistor"], "seed {seed}");
    });
}

/// What is proposed is measured with the same sensor, its effect and new noise: the name stands alone then, in more than 85 of 100, and the
/// effect is as strong as forecast. Of those whose forecast for what no rival can take is 6 or more.
#[test]
fn a_proposed_measurement_tells_what_it_is_said_to_tell() {
    let names = ["coil_temperature", "rack_temperature", "sensor_temperature_sensitivity", "remanence", "cubic_nonlinearity"];
    let cases: Vec<(u64, &str)> = names.into_iter().flat_map(|name| (9000..9004).map(move |seed| (seed, name))).collect();
    let carried_out: Vec<(f64, bool)> = cases
        .into_par_iter()
        .filter_map(|(seed, name)| {
            let options =
                Options { effects: vec![name.to_owned()], strength_k: 8.0, noise: Some(Family::White), ..Options::default() };
            let verdict = judge::judge(&generate(seed, Kind::Lin, &options).unwrap());
            let step = verdict.steps.first().filter(|s| s.effect == name)?;
            let best = step.next.iter().find(|p| p.plan != Plan::TestSignal).filter(|p| p.apart_k >= 6.0)?;
            let then = judge::judge(&generate(seed, Kind::Lin, &Options { then: Some(best.plan), ..options }).unwrap());
            let after = then.steps.iter().find(|s| s.effect == name);
            let resolved = after.is_some_and(|s| s.ambiguous_with.is_empty());
            Some((after.map_or(0.0, |s| s.strength_k) / best.strength_k, resolved))
        })
        .collect();
    let count = carried_out.len();
    assert!(count >= 10, "{count}");
    // So few tell a share of 85 % only within chance: fewer than this are seen in one of twenty such sets.
    let resolved = carried_out.iter().filter(|c| c.1).count();
    let chance = Binomial::new(0.85, count as u64).unwrap().cdf(resolved as u64);
    assert!(chance > 0.05, "{resolved} of {count}: {carried_out:?}");
    // An effect of k = 8 is known to an eighth.
    let mut ratios: Vec<f64> = carried_out.iter().map(|c| c.0).collect();
    assert!((central_median(&mut ratios) - 1.0).abs() < 0.2, "{ratios:?}");
}
