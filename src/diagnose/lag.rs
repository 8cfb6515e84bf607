//! A lag of the thermistor, which changes the temperatures that the model of a sweep itself is a polynomial of.

use super::CERTAIN;
use super::branches;
use super::result::{Branches, Evidence, Parameter, Step};
use super::search::{Candidate, Search};
use super::steps::{bars, gap, runners};
use super::words;
use crate::data::run::interpolate;
use crate::data::units::COMPONENTS;
use crate::model::effects::thermal_lag::{self, ThermalLag};
use crate::model::effects::{Catalogue, EffectRef, Row};
use crate::model::lag::{self, Lag};
use crate::record::scene::Scene;
use nalgebra::DMatrix;

/// Longest lag that is looked for, as a part of the record: that of the terms of the catalogue.
const LONGEST_PART: f64 = 0.2;

/// Looks for a lag of the thermistor and, if there is one, gives the scene the temperatures of the part that matters.
pub(super) fn find(
    scene: &mut Scene,
    readings: &DMatrix<f64>,
    given: &[Candidate],
    number: usize,
    catalogue: &Catalogue,
) -> Option<(Step, Branches, Evidence)> {
    let course = scene.record.sensor.as_ref()?.course.clone();
    let series = &course.series;
    let times: Vec<f64> = scene.record.rows.iter().map(Row::t_s).collect();
    let degc = |lag: Lag| -> Vec<f64> {
        let lagged = lag.of(&course);
        times.iter().map(|t| interpolate(&lagged, *t)).collect()
    };
    let squares = |degc: Vec<f64>| scene.squares_with(readings, &degc);
    let search = Search::new(scene, readings.clone(), catalogue);
    let now: Vec<&Candidate> = given.iter().collect();
    let state = search.state(&now)?;
    let groups = search.groups(&state);
    let explanations = search.explanations(&state, &groups);
    let effect = EffectRef::new(&ThermalLag);
    let best = explanations.iter().find(|e| e.key == effect.as_str())?;
    if best.evidence < 12.0 {
        return None;
    }
    let rival = explanations.first().filter(|e| e.key != effect.as_str()).map(|e| &search.bank[e.best]);
    // All components count alike, with the noise that the model leaves.
    let freedom = (3 * readings.nrows()) as f64;
    let left = freedom - 3.0 * scene.design.ncols() as f64;
    let length = scene.record.span_s[1] - scene.record.span_s[0];
    let deviance = |lag: Lag| left * squares(degc(lag)).ln();
    let [delay, time_constant] = lag::search(LONGEST_PART * length, deviance);
    let most_likely = if delay.deviance <= time_constant.deviance { delay } else { time_constant };
    let (lag, lag_s) = (most_likely.lag, most_likely.lag.seconds());
    let (before, after) = (squares(degc(Lag::Delay(0.0))), squares(degc(lag)));
    if after >= before {
        return None;
    }
    // The instants of the thermistor's readings are known to one reading.
    let interval_s = (series[series.len() - 1].0 - series[0].0) / (series.len() - 1).max(1) as f64;
    let std_s = (most_likely.std_s.powi(2) + interval_s * interval_s / 12.0).sqrt();
    let strength = (freedom * (before / after).ln()).max(0.0).sqrt();
    let spec = thermal_lag::spec(lag);
    let held_before = search.held_out(&state.noise, &now);
    let p_value = best.score.p_value();
    let nt_per_ent = scene.nt_per_ent;
    let (n, runners_up) = (search.bank.len(), runners(&search, &groups, &explanations, effect.as_str()));
    let gap_before = gap(&held_before, nt_per_ent);
    let evidence = bars(&search, &explanations, effect.as_str(), best.evidence, number);
    let beside_rival = rival.and_then(|rival| {
        let with: Vec<&Candidate> = now.iter().copied().chain([rival]).collect();
        let noise = search.state(&with)?.noise;
        let sum = search.held_out(&noise, &with).sum;
        Some((noise, sum))
    });
    let mut lagged = scene.clone();
    lagged.with_temperatures(degc(lag));
    let search = Search::new(&lagged, readings.clone(), catalogue);
    // A strong lag is no line, so that what bends freely may follow its line better: the lag itself has to predict more.
    if beside_rival.is_some_and(|(noise, sum)| search.held_out(&noise, &now).sum >= sum) {
        return None;
    }
    let state = search.state(&now)?;
    let held_after = search.held_out(&state.noise, &now);
    let gap_after = gap(&held_after, nt_per_ent);
    let name = scene.record.sensor.as_ref().map_or_else(String::new, |c| c.name.clone());
    let row_std = search.row_std(&state, &now);
    let branches = branches::of(
        &branches::Side { record: &scene.record, residual_ent: &held_before.residual_ent },
        &branches::Side { record: &lagged.record, residual_ent: &held_after.residual_ent },
        row_std[0],
        &name,
        series,
        number,
    );
    let step = Step {
        effect,
        axes: COMPONENTS.map(str::to_owned).to_vec(),
        ambiguous_with: Vec::new(),
        parameters: vec![Parameter { name: thermal_lag::LAG.to_owned(), value: lag_s, std: Some(std_s), unit: "s".to_owned() }],
        place: format!("all axes, where {name} rises or falls: up to {:.2} nT", gap_before.max_nt),
        p_value,
        trials: n,
        p_value_corrected: (p_value * n as f64).clamp(f64::MIN_POSITIVE, 1.0),
        gap_before,
        gap_after,
        strength_k: strength,
        family: effect.about().family.name(),
        wording: if strength > CERTAIN { "is" } else { "consistent with" },
        runners_up,
        next_measurement: None,
        sentence: words::lag(&name, lag.form(), lag_s, std_s, &gap_before, &gap_after),
        covariate: None,
        shape: Vec::new(),
        form: spec,
        further: Vec::new(),
    };
    *scene = lagged;
    Some((step, branches, evidence))
}
