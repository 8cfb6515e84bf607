//! A lag of the thermistor, which changes the temperatures that the model of a sweep itself is a polynomial of.

use super::APART;
use super::branches::{self, Side};
use super::candidate::Candidate;
use super::explanations::Explanation;
use super::means::{HOPELESS, HeldOut, Means, MeansModel, gap};
use super::result::{Branches, Evidence, Parameter, RunnerUp, Telling};
use super::steps::{Facts, Significance};
use super::words;
use crate::data::run::interpolate;
use crate::data::units::COMPONENTS;
use crate::fit::scan::Fitted;
use crate::fit::smooth::Course;
use crate::model::effects::thermal_lag::{self, ThermalLag};
use crate::model::effects::{Catalogue, EffectRef, Row};
use crate::model::lag::{self, Lag};
use crate::record::prepared::PreparedRun;
use nalgebra::DMatrix;

/// Longest lag that is looked for, as a part of the record: that of the terms of the catalogue.
const LONGEST_PART: f64 = 0.2;
/// Evidence (logarithm) from which the temperatures themselves are changed: far beyond what noise gives, since all else rests on them.
const LEAST_EVIDENCE: f64 = 12.0;

/// Rivals that are compared with a lag.
const RIVALS: usize = 5;

/// A lag that was found.
pub(super) struct FoundLag {
    pub facts: Facts,
    pub branches: Branches,
    pub evidence: Evidence,
}

/// The most likely lag.
struct MostLikely {
    lag: Lag,
    std_s: f64,
    /// Signal to noise ratio.
    strength: f64,
}

/// What temperatures without and with the lag predict of held-out stretches.
struct Compared {
    without: HeldOut,
    with: HeldOut,
    /// Logarithms of the likelihood ratios of the rivals to the lag, on held-out stretches.
    log_ratios: Vec<f64>,
    /// Noise of every row with the lag, enT.
    row_std_ent: Vec<[f64; 3]>,
}

/// Looks for a lag of the thermistor and, if there is one, gives the run the temperatures of the part that matters.
pub(super) fn find(
    prepared: &mut PreparedRun,
    readings: &DMatrix<f64>,
    given: &[Candidate],
    number: usize,
    catalogue: &Catalogue,
) -> Option<FoundLag> {
    let sensor = prepared.record.sensor.clone()?;
    let effect = EffectRef::new(&ThermalLag);
    let means = Means::new(prepared, readings.clone(), catalogue, given.to_vec());
    let model = means.model(&means.all(&[]))?;
    let scored = means.scored(&model);
    let best = scored.explanation(effect.as_str()).filter(|e| e.evidence >= LEAST_EVIDENCE)?;
    let rivals: Vec<&Explanation> =
        scored.explanations.iter().filter(|e| e.key != effect.as_str() && e.beside_noise() > 0.0).take(RIVALS).collect();
    let MostLikely { lag, std_s, strength } = most_likely(prepared, readings, &sensor.course)?;
    let mut lagged = prepared.clone();
    lagged.follow(lag);
    let candidates: Vec<&Candidate> = rivals.iter().map(|e| &means.candidates[e.best]).collect();
    let Compared { without, with, log_ratios, row_std_ent } = compared(&means, &model, &candidates, &lagged, catalogue)?;
    let is_better = |(e, log_ratio): (&&Explanation, &f64)| *log_ratio >= if e.evidence > best.evidence { 0.0 } else { APART };
    if rivals.iter().zip(&log_ratios).any(is_better) {
        return None;
    }
    let runners_up = rivals.iter().zip(&log_ratios).map(|(e, log_ratio)| RunnerUp {
        effect: e.key.clone(),
        log_ratio: *log_ratio,
        correlation: Fitted::correlation(&scored.groups[e.best], &scored.groups[best.best]),
    });
    let near = candidates.iter().zip(&log_ratios).filter(|(_, log_ratio)| **log_ratio > -APART);
    let mut ambiguous_with: Vec<EffectRef> = Vec::new();
    near.for_each(|(candidate, _)| {
        if !ambiguous_with.contains(&candidate.effect) {
            ambiguous_with.push(candidate.effect)
        }
    });
    let gaps = [&without, &with].map(|held| gap(held, prepared.nt_per_ent));
    let significance = Significance::of_trials(best.score.p_value(), means.candidates.len(), strength);
    let (name, lag_s) = (&sensor.name, lag.seconds());
    let facts = Facts {
        axes: COMPONENTS.to_vec(),
        parameters: vec![Parameter { name: thermal_lag::LAG.to_owned(), value: lag_s, std: Some(std_s), unit: "s".to_owned() }],
        place: format!("all axes, where {name} rises or falls: up to {:.2} nT", gaps[0].max_nt),
        gaps,
        runners_up: runners_up.filter(|r| r.log_ratio > -HOPELESS).collect(),
        ambiguous_with,
        ..Facts::new(effect, thermal_lag::spec(lag), significance)
    };
    let sentence = |is_certain: bool| words::lag(name, lag.form(), [lag_s, std_s], &gaps, is_certain, &facts.ambiguous_with);
    let telling = Telling { own: Some([true, false].map(sentence)), remark: String::new() };
    let facts = Facts { telling, ..facts };
    let branches = branches::of(
        &Side { record: &prepared.record, residual_ent: &without.residual_ent },
        &Side { record: &lagged.record, residual_ent: &with.residual_ent },
        row_std_ent[0],
        name,
        &sensor.course.series,
        number,
    );
    let evidence = scored.bars(effect.as_str(), best.evidence, number);
    *prepared = lagged;
    Some(FoundLag { facts, branches, evidence })
}

/// The lag with which the model of the sweep leaves the smallest residuals; `None` where they are no smaller than without one. All components
/// count alike, with the noise that the model leaves.
fn most_likely(prepared: &PreparedRun, readings: &DMatrix<f64>, course: &Course) -> Option<MostLikely> {
    let series = &course.series;
    let times: Vec<f64> = prepared.record.rows.iter().map(Row::t_s).collect();
    let degc = |lag: Lag| -> Vec<f64> {
        let lagged = lag.of(course);
        times.iter().map(|t| interpolate(&lagged, *t)).collect()
    };
    let squares = |degc: &[f64]| prepared.squares_with(readings, degc);
    let values = (3 * readings.nrows()) as f64;
    let freedom = values - 3.0 * prepared.design.ncols() as f64;
    let length = prepared.record.span_s[1] - prepared.record.span_s[0];
    let [delay, time_constant] = lag::search(LONGEST_PART * length, |lag| freedom * squares(&degc(lag)).ln());
    let best = if delay.deviance <= time_constant.deviance { delay } else { time_constant };
    let (before, after) = (squares(&degc(Lag::Delay(0.0))), squares(&degc(best.lag)));
    if after >= before {
        return None;
    }
    // The times of the thermistor's readings are known to one interval between them.
    let interval_s = (series[series.len() - 1].0 - series[0].0) / (series.len() - 1).max(1) as f64;
    Some(MostLikely {
        lag: best.lag,
        std_s: (best.std_s.powi(2) + interval_s * interval_s / 12.0).sqrt(),
        strength: (values * (before / after).ln()).max(0.0).sqrt(),
    })
}

/// Held-out stretches without and with a lag, and how well its rivals predict them. The column by which a lag is scored is its first
/// order only. Of a strong lag a free function of a covariate may follow this column better than the lag does: the lag itself is compared.
fn compared(
    means: &Means,
    model: &MeansModel,
    rivals: &[&Candidate],
    lagged: &PreparedRun,
    catalogue: &Catalogue,
) -> Option<Compared> {
    let now = means.all(&[]);
    let with_lag = Means::new(lagged, means.readings.clone(), catalogue, means.given.clone());
    // With the noise that is left beside the rival.
    let log_ratio = |rival: &&Candidate| {
        let with: Vec<&Candidate> = now.iter().copied().chain([*rival]).collect();
        let noise = means.model(&with)?.noise;
        Some(0.5 * (with_lag.predicted(&noise, &now).sum - means.predicted(&noise, &with).sum))
    };
    let log_ratios: Vec<f64> = rivals.iter().map(|rival| log_ratio(rival).unwrap_or(f64::NEG_INFINITY)).collect();
    let model_with_lag = with_lag.model(&now)?;
    Some(Compared {
        without: means.predicted(&model.noise, &now),
        with: with_lag.predicted(&model_with_lag.noise, &now),
        log_ratios,
        row_std_ent: with_lag.row_std(&model_with_lag, &now),
    })
}
