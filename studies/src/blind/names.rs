//! How often a name can be right at all: two effects that resemble each other, weighed by someone who knows the true covariance of the noise, the
//! axes, and the distribution from which the generator draws the forms of both. No method that sees the readings alone is right more often.

use super::effects::{Effect, drawn};
use super::judge::judge;
use super::kinds::{Measure, generate, nuisance, plateau_cells};
use super::noise::Random;
use super::programme::Programme;
use super::sensor::{CleanRun, Kind};
use super::{Blind, Options};
use calfit::fit::scan::Score;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Effects that resemble each other in a run.
const PAIRS: [[&str; 2]; 3] = [
    ["offset_drift", "sensor_temperature_offset"],
    ["cubic_nonlinearity", "saturation"],
    ["coil_temperature", "sensor_temperature_sensitivity"],
];
/// Strengths that are looked at.
const STRENGTHS: [f64; 4] = [6.0, 8.0, 10.0, 15.0];
/// Forms that stand for all that the generator draws.
const FORMS: usize = 300;
/// Part of the runs that have another programme than the usual one, as in the study.
const OTHER_PROGRAMME: f64 = 0.6;

/// What one run gives.
struct Case {
    /// The effect, its rival, and the strength in tenths.
    of: (&'static str, &'static str, u64),
    /// Whether the evidence of the right effect is the larger one, and the logarithm of the ratio.
    is_right: bool,
    log_ratio: f64,
    /// What the diagnosis names first: the effect, its rival, or something else.
    said: Said,
}

enum Said {
    Right,
    Rival,
    Other,
}

/// What a form adds to every axis that it acts on, whitened, without what the run's own parameters take.
fn templates(measure: &Measure, clean: &CleanRun, effect: &Effect, axes: &[usize]) -> Vec<Vec<f64>> {
    let (_, left) = measure.white(&[effect.contribution(clean, 0, 1.0)]);
    let rows = left.len() / 3;
    axes.iter().map(|a| left[a * rows..(a + 1) * rows].to_vec()).collect()
}

/// Evidence of a form whose size on every axis is free.
fn evidence(readings: &[f64], templates: &[Vec<f64>], axes: &[usize]) -> f64 {
    let rows = readings.len() / 3;
    let explained = |(template, axis): (&Vec<f64>, &usize)| {
        let own = &readings[axis * rows..(axis + 1) * rows];
        let along: f64 = own.iter().zip(template).map(|(r, t)| r * t).sum();
        let size: f64 = template.iter().map(|t| t * t).sum();
        if size > 0.0 { along * along / size } else { 0.0 }
    };
    Score::known(templates.iter().zip(axes).map(explained).sum(), axes.len()).evidence
}

/// Evidence of an effect: the mean over its forms, those that act on the same axes.
fn of_effect(id: &str, measure: &Measure, clean: &CleanRun, readings: &[f64], axes: &[usize]) -> f64 {
    let mut random = Random::new(clean.count as u64, id);
    let mut all = Vec::with_capacity(FORMS);
    for _ in 0..FORMS {
        // The size on every axis is free, so that the axes of a form do not matter where it has more than one.
        let Some(effect) = drawn(id, clean, &mut random) else { break };
        let own: Vec<usize> = (0..3).filter(|a| effect.axes.contains(&["x", "y", "z"][*a])).collect();
        if axes.iter().all(|a| own.contains(a)) {
            all.push(evidence(readings, &templates(measure, clean, &effect, axes), axes));
        }
    }
    let most = all.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    most + (all.iter().map(|e| (e - most).exp()).sum::<f64>() / all.len().max(1) as f64).ln()
}

fn case(seed: u64, of: (&'static str, &'static str, f64)) -> Option<Case> {
    let (effect, rival, k) = of;
    let mut random = Random::new(seed, "names");
    let programme =
        if random.chance(OTHER_PROGRAMME) { Programme::ALL[random.below(Programme::ALL.len())] } else { Programme::default() };
    let options = Options { effects: vec![effect.to_owned()], strength_k: k, programme, ..Options::default() };
    let blind: Blind = generate(seed, Kind::Lin, &options).ok()?;
    let clean = &blind.clean_runs[0];
    let cells = plateau_cells(&blind.clean_runs);
    let own = nuisance(&blind.clean_runs, &cells);
    let measure = Measure::new(&blind.clean_runs, &blind.truth.noise, cells, &own);
    let record: Vec<[f64; 3]> = blind.runs[0].1.iter().map(|v| v.reading.0).collect();
    let (_, readings) = measure.white(&[record]);
    let truth = blind.truth.effects.first()?;
    let axes: Vec<usize> = (0..3).filter(|a| truth.axes.iter().any(|t| t == ["x", "y", "z"][*a])).collect();
    let log_ratio = of_effect(effect, &measure, clean, &readings, &axes) - of_effect(rival, &measure, clean, &readings, &axes);
    let said = match judge(&blind).steps.first().map(|s| s.effect.as_str()) {
        Some(name) if name == effect => Said::Right,
        Some(name) if name == rival => Said::Rival,
        _ => Said::Other,
    };
    Some(Case { of: (effect, rival, super::score::tenths(k)), is_right: log_ratio > 0.0, log_ratio, said })
}

/// A table of how often the names of effects can be right, and how often those of the diagnosis are; `runs` of each effect and strength.
pub fn table(first: u64, runs: u64) -> String {
    let mut all: Vec<(u64, (&'static str, &'static str, f64))> = Vec::new();
    for [a, b] in PAIRS {
        for k in STRENGTHS {
            all.extend((0..runs).flat_map(|run| [(first + run, (a, b, k)), (first + run, (b, a, k))]));
        }
    }
    let cases: Vec<Case> = all.into_par_iter().filter_map(|(seed, of)| case(seed, of)).collect();
    let mut by: BTreeMap<(&str, &str, u64), Vec<&Case>> = BTreeMap::new();
    cases.iter().for_each(|c| by.entry(c.of).or_default().push(c));
    let mut text = "| effect | rival | k | runs | the one who knows noise, axes and forms names the rival | his logarithm is within 4.6 | the diagnosis names the rival | something else, or nothing |\n|---|---|---|---|---|---|---|---|\n".to_owned();
    for ((effect, rival, k), cases) in by {
        let percent = |is: &dyn Fn(&Case) -> bool| 100.0 * cases.iter().filter(|c| is(c)).count() as f64 / cases.len() as f64;
        let _ = writeln!(
            text,
            "| {effect} | {rival} | {} | {} | {:.1} % | {:.1} % | {:.1} % | {:.1} % |",
            k as f64 / 10.0,
            cases.len(),
            percent(&|c| !c.is_right),
            percent(&|c| c.log_ratio.abs() < 4.605),
            percent(&|c| matches!(c.said, Said::Rival)),
            percent(&|c| matches!(c.said, Said::Other)),
        );
    }
    text
}
