//! Sets of runs in several positions with a hidden error of the facility: silent where there is none, right where it is strong.

use super::{Size, too_many};
use crate::blind::kinds::generate;
use crate::blind::noise::Family;
use crate::blind::sensor::Kind;
use crate::blind::{Blind, Options};
use calfit::data::plateau::{self, Accumulator, Cut};
use calfit::data::run::VectorSink;
use calfit::diagnose::across::{RunValues, across};
use calfit::diagnose::result::Diagnosis;
use calfit::measure::lin;
use calfit::model::effects::Catalogue;
use rayon::prelude::*;

fn diagnosed(blind: &Blind) -> Result<Diagnosis, String> {
    let values: Vec<RunValues> = blind
        .runs
        .iter()
        .map(|(run, vectors)| {
            let mut accumulator = Accumulator::default();
            accumulator.begin(&run.header, &run.settings);
            vectors.iter().for_each(|v| accumulator.vector(*v));
            let plateaus = plateau::of_run(run, accumulator, Cut::default());
            RunValues::of_run(run, &plateaus, &blind.campaign, &lin::Options::default())
        })
        .collect::<Result<_, _>>()
        .map_err(|rule| rule.to_string())?;
    across(&values, &Catalogue::default()).map_err(|rule| rule.to_string())
}

/// Among some sets: how often something is found, how often the effect is named first, and what else is said.
#[derive(Default)]
struct Score {
    found: u64,
    named: u64,
    words: Vec<String>,
}

fn score(effect: Option<&str>, strength_k: f64, noise: Option<Family>, seeds: std::ops::Range<u64>) -> Score {
    let options = Options { effects: effect.iter().map(|e| (*e).to_owned()).collect(), strength_k, noise, ..Options::default() };
    let made: Vec<(Family, Result<Diagnosis, String>)> = seeds
        .clone()
        .into_par_iter()
        .map(|seed| {
            let blind = generate(seed, Kind::Positions, &options).unwrap();
            (blind.truth.noise.family, diagnosed(&blind))
        })
        .collect();
    let mut score = Score::default();
    for (seed, (family, diagnosis)) in seeds.zip(made) {
        match diagnosis {
            Err(rule) => score.words.push(format!("{seed}: {rule}")),
            Ok(diagnosis) => {
                let Some(first) = diagnosis.steps.first() else { continue };
                let right = Some(first.effect.as_str()) == effect;
                score.found += 1;
                score.named += u64::from(right);
                if !right {
                    score.words.push(format!("{seed} {}: {} {}", family.name(), diagnosis.verdict, first.place));
                }
            }
        }
    }
    score
}

const ERRORS: [&str; 3] = ["facility_scale", "facility_offset", "facility_angle"];

/// Nothing hidden, nothing found; at k = 10 every kind of error of the facility is named. One false alarm of 8 sets has a probability of
/// 8 % at the nominal 1 %, two of 16 one of 1 %; naming at k = 10 has a floor of 95 % (two misses of 6: 3 %, three of 12: 2 %).
#[test]
fn silent_without_an_error_and_right_about_strong_ones() {
    let size = Size::asked();
    let Score { found, words, .. } = score(None, 0.0, None, 0..size.of(8, 16));
    assert!(found <= 1, "{words:?}");
    for effect in ERRORS {
        let Score { named, words, .. } = score(Some(effect), 10.0, Some(Family::White), 100..100 + size.of(6, 12));
        assert!(named >= size.of(5, 10), "{effect}: {named} {words:?}");
    }
}

/// The same for every family of noise and at three strengths; the full form prints the figures of the study. Names have a floor of 95 %
/// at k = 10 in any noise; at less strength they are counted only.
#[test]
fn errors_by_noise_and_strength() {
    let size = Size::asked();
    let sets = size.of(1, 26);
    let mut alarms = 0;
    for family in Family::WITHOUT_SPIKES {
        let Score { found, words, .. } = score(None, 0.0, Some(family), 1000..1000 + sets);
        println!("null {}: {found} of {sets} {words:?}", family.name());
        alarms += found;
    }
    let trials = sets * Family::WITHOUT_SPIKES.len() as u64;
    assert!(alarms < too_many(trials, 0.01), "{alarms} false alarms of {trials}");
    let sets = size.of(1, 40);
    let mut missed = 0;
    for effect in ERRORS {
        for strength_k in size.of(vec![10.0], vec![6.0, 8.0, 10.0]) {
            let Score { found, named, words } = score(Some(effect), strength_k, None, 2000..2000 + sets);
            println!("{effect} k = {strength_k}: found {found}, named {named} of {sets} {words:?}");
            if strength_k == 10.0 {
                missed += sets - named;
            }
        }
    }
    let trials = sets * ERRORS.len() as u64;
    assert!(missed < too_many(trials, 0.05), "{missed} of {trials} are not named");
}
