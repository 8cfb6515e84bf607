//! The description of a term of the plateau means.

use super::chosen::Chosen;
use super::{HeldOut, Means, MeansModel, Term, each_axis, in_time, memory, other_form, thermistor};
use crate::data::units::{COMPONENTS, six_digits};
use crate::diagnose::candidate::{self, Candidate};
use crate::diagnose::next::{self, Named};
use crate::diagnose::problem::Description;
use crate::diagnose::result::{Gap, Map, Parameter, Telling};
use crate::diagnose::steps::{Facts, Name, Significance, linear_parameters, shape_parameters};
use crate::diagnose::{APART, selection, words};
use crate::model::effects::sensor_temperature_offset::SensorTemperatureOffset;
use crate::model::effects::{Family, GAIN_WITH, UNKNOWN};
use crate::record::prepared::PreparedRun;
use nalgebra::{DMatrix, DVector};
use std::ops::Range;

/// Rivals whose evidence (logarithm) is less than that of a term by more than this are not listed.
pub const HOPELESS: f64 = 60.0;

/// Of a term that does not rest on one row the others leave this part of its strength, or what noise makes less often than this.
const LEAST_OF_OTHERS: f64 = 0.5;
const SIGNIFICANT: f64 = 1e-3;

/// A size below this many of its standard uncertainties may as well be zero.
const LEAST_RATIO: f64 = 3.0;

/// What a term contributes to the means, where it disagrees most with the linear model.
struct Contribution {
    /// Axis on which it is largest.
    axis: usize,
    /// Contribution to the readings of that axis that the linear model cannot take, enT.
    own_ent: Vec<f64>,
    /// The covariate that it follows best.
    covariate: String,
    unit: &'static str,
    x: Vec<f64>,
}

impl Contribution {
    fn new(means: &Means, candidate: &Candidate, values: &[(f64, f64)]) -> Self {
        let prepared = means.prepared;
        let n = means.rows();
        let amplitudes = DVector::from_fn(candidate.columns.ncols(), |j, _| values.get(j).map_or(0.0, |v| v.0));
        let contribution = &candidate.columns * amplitudes;
        let size = |a: usize| contribution.rows(a * n, n).norm() * prepared.nt_per_ent[a];
        let axis = (0..3).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
        // What the parameters of the linear model take of it is no disagreement.
        let q = prepared.design.clone().qr().q();
        let own = contribution.rows(axis * n, n).into_owned();
        let own_ent: Vec<f64> = (&own - &q * q.tr_mul(&own)).iter().copied().collect();
        let own_covariate = candidate.covariate.clone().or_else(|| candidate.effect.shown_along(&candidate.spec));
        let remembers = candidate.effect.about().family == Family::History;
        let (covariate, unit, x) = words::follows(&prepared.record, &own_ent, own_covariate.as_deref(), remembers);
        Self { axis, own_ent, covariate, unit, x }
    }

    /// Where it is largest, in words; of what begins at a time, since when.
    fn place(&self, begins_s: Option<f64>, nt_per_ent: f64, noise_nt: f64) -> String {
        let largest = |i: &usize, j: &usize| self.own_ent[*i].abs().total_cmp(&self.own_ent[*j].abs());
        let most = (0..self.own_ent.len()).max_by(largest).unwrap_or(0);
        let size_nt = self.own_ent[most].abs() * nt_per_ent;
        let place = match begins_s {
            Some(begins_s) => format!("from {begins_s:.0} s on"),
            None => {
                let covariate = self.covariate.trim_start_matches(GAIN_WITH);
                format!("where the {covariate} is {} {}", six_digits(self.x[most]), self.unit)
            }
        };
        let axis = COMPONENTS[self.axis];
        format!("{axis}, {place}: up to {size_nt:.3} nT ({:.1} noise)", size_nt / noise_nt.max(f64::MIN_POSITIVE))
    }
}

/// The facts of a chosen term beside all others, with the noise of the full model.
pub(super) fn describe(means: &Means, model: &MeansModel, chosen: &[Term], index: usize, number: usize) -> Description {
    let term = &chosen[index];
    let all = means.all(chosen);
    let at = means.given.len() + index;
    let candidate = all[at];
    let others = candidate::without(&all, &[at]);
    let without = means.model_beside(model, &others);
    let own_group = means.group(&without, candidate);
    let scored = means.scored_as_rivals(&without, &own_group);
    let rivals = scored.rivals(candidate, &own_group);
    let score = rivals.score;
    let values = model.estimates(means, &all).get(at).cloned().unwrap_or_default();
    let [before, after] = [&others, &all].map(|terms| means.predicted(&model.noise, terms));
    let contribution = Contribution::new(means, candidate, &values);
    let axis = contribution.axis;
    let nt_per_ent = means.prepared.nt_per_ent[axis];
    let row_std = means.row_std(model, &all);
    let noise_nt = means.mean_noise_nt(&row_std)[axis];
    let reading_ent: Option<Vec<f64>> = contribution
        .covariate
        .starts_with(GAIN_WITH)
        .then(|| means.prepared.record.rows.iter().map(|row| row.linear_ent[axis]).collect());
    let shape = if candidate.effect.is_unknown() {
        let own_ent: Vec<f64> =
            contribution.own_ent.iter().zip(after.residual_ent.column(axis).iter()).map(|(own, left)| own + left).collect();
        let std_ent: Vec<f64> = row_std.iter().map(|std| std[axis]).collect();
        words::shape(&contribution.x, &own_ent, &std_ent, reading_ent.as_deref(), nt_per_ent)
    } else {
        Vec::new()
    };
    let significance = Significance {
        p_value: score.p_value(),
        trials: term.trials,
        p_value_corrected: term.p_global,
        strength_k: score.strength,
    };
    let beside = Chosen { means, without: &without, candidate, group: &own_group, score: &score };
    let by_form = by_form(&beside);
    let parameters = parameters(candidate, &values, score.strength, term.threshold.strength(score.strength), by_form);
    let (rival_keys, best) = rivals.indistinct().map(|e| (e.key.clone(), e.best)).unzip();
    let named = Named {
        candidate,
        others: others.clone(),
        values: parameters.iter().take(candidate.columns.ncols()).map(|p| p.value).collect(),
        rivals: rival_keys,
        best,
    };
    let mut runners_up = scored.runners_up(&candidate.key, HOPELESS);
    // The term has the best value of its shape, rivals those of a grid: with those of the grid for both, none may be near. An unknown function
    // has other unknown ones as rivals, too.
    let has_near_rival = runners_up.iter().any(|r| r.log_ratio > -APART);
    let mut in_time = in_time::rivals(&beside);
    in_time.extend(thermistor::rival(&beside, &others));
    let of_none = [
        (
            each_axis::rival(&beside),
            "The axes do not do it together: with a size of its own for each of them the data are described better.",
        ),
        (memory::rival(&beside), "A hysteresis that remembers the largest field describes the data as well."),
    ];
    let one_plateau_s = one_plateau_s(&beside, &others, &contribution);
    // Why the name is not certain where no rival that is listed says it.
    let doubts = [
        (!is_apart_from_zero(candidate, &parameters), "No size of its form stands out of its own uncertainty."),
        (rivals.has_family_twin(), "Another curve of the reading is so much like it that a real one may be either."),
        (
            has_twin_beside(candidate, &others),
            "Another curve of the same axis is named beside it: together they may stand for one that is neither.",
        ),
        (!is_constant(&beside, &others), "Its size is not the same in the beginning and the end of the run."),
        (
            candidate.effect.about().family == Family::Time && !means.prepared.faults.is_empty(),
            "A temperature channel is damaged: what follows the temperature looks the same.",
        ),
        (
            begins_beside_the_lag(means.prepared, candidate),
            "It begins where the thermistor, which is late or early, does not tell the temperature.",
        ),
    ];
    let doubts: Vec<&str> = doubts.into_iter().filter(|(is_so, _)| *is_so).map(|(_, why)| why).collect();
    let names: Vec<&str> = in_time.iter().map(|(_, r)| r.effect.as_str()).collect();
    let mut remark = match names.as_slice() {
        [] => String::new(),
        _ => format!(" These describe the data as well in its place: {}.", names.join(", ")),
    };
    if in_time.iter().any(|(effect, _)| effect.is(&SensorTemperatureOffset)) {
        remark.push_str(
            " The temperature with its rate is what an offset makes that follows the sensor while the thermistor is late.",
        );
    }
    if let Some(t_s) = one_plateau_s {
        remark.push_str(&format!(
            " Without the plateau at {t_s:.0} s little of it is left: a single plateau that was disturbed looks the same, and it goes into no model."
        ));
    }
    let mut in_its_place = in_time;
    for (rival, why) in of_none.into_iter().filter_map(|(rival, why)| Some((rival?, why))) {
        in_its_place.push((UNKNOWN, rival));
        remark.push_str(&format!(" {why}"));
    }
    let of_form = other_form::doubts(&beside, model, &all, at);
    remark.push_str(&of_form);
    doubts.iter().for_each(|why| remark.push_str(&format!(" {why}")));
    let is_doubted =
        has_near_rival || one_plateau_s.is_some() || !in_its_place.is_empty() || !of_form.is_empty() || !doubts.is_empty();
    let mut ambiguous_with = rivals.ambiguous();
    for (effect, _) in &in_its_place {
        if !candidate.effect.is_unknown() && !ambiguous_with.contains(effect) {
            ambiguous_with.push(*effect);
        }
    }
    let mut evidence = rivals.bars(number);
    let own = evidence.bars.first().map_or(score.evidence, |(_, own)| *own);
    evidence.bars.extend(in_its_place.iter().map(|(_, r)| (r.effect.clone(), own + r.log_ratio)));
    // The term itself stays the first one.
    if let Some((_, others)) = evidence.bars.split_first_mut() {
        others.sort_by(|a, b| b.1.total_cmp(&a.1));
    }
    runners_up.extend(in_its_place.into_iter().map(|(_, r)| r));
    runners_up.sort_by(|a, b| b.log_ratio.total_cmp(&a.log_ratio));
    let facts = Facts {
        parameters,
        name: if is_doubted { Name::Doubted } else { Name::ByStrength },
        place: contribution.place(candidate.effect.begins_s(&candidate.spec), nt_per_ent, noise_nt),
        gaps: [&before, &after].map(|held| gap(held, means.prepared.nt_per_ent)),
        ambiguous_with,
        runners_up,
        telling: Telling { own: None, remark },
        covariate: candidate.covariate.clone(),
        shape,
        one_plateau_s,
        ..Facts::new(candidate.effect, candidate.spec.clone(), significance)
    };
    let facts = if facts.is_certain() { facts } else { Facts { next_forecast: next::forecasts(means, model, &named), ..facts } };
    // What a gain makes of readings has their sign.
    let sign = |row: usize| reading_ent.as_ref().map_or(1.0, |all| if all[row] < 0.0 { -1.0 } else { 1.0 });
    let nt = |held: &HeldOut| -> Vec<f64> {
        held.residual_ent.column(axis).iter().enumerate().map(|(row, r)| sign(row) * r * nt_per_ent).collect()
    };
    let map = Map {
        covariate: contribution.covariate,
        unit: contribution.unit.to_owned(),
        axis,
        x: contribution.x,
        before_nt: nt(&before),
        after_nt: nt(&after),
        noise_nt,
        step: number,
        names: Vec::new(),
    };
    Description { facts, map, evidence: Some(evidence) }
}

/// When the plateau is without which nothing of a term is significant and little of it left, s: that on which most of it is, one beside which it begins,
/// or two of these, since a disturbance may lie across the border of two. What is left of two jumps within one row is that row alone.
fn one_plateau_s(chosen: &Chosen, others: &[&Candidate], contribution: &Contribution) -> Option<f64> {
    let Chosen { means, without, candidate, score, .. } = *chosen;
    let record = &means.prepared.record;
    let n = record.rows.len();
    let own = &contribution.own_ent;
    let largest = (0..n).max_by(|i, j| own[*i].abs().total_cmp(&own[*j].abs()))?;
    let begin = candidate.effect.begins_s(&candidate.spec).map(|s| record.rows.partition_point(|r| r.used_s[1] <= s));
    let near = || begin.into_iter().flat_map(|row| row.saturating_sub(1)..(row + 2).min(n));
    let single = std::iter::once(largest).chain(near()).map(|row| row..row + 1);
    let places: Vec<Range<usize>> = single.chain(near().map(|row| row.saturating_sub(1)..row + 1)).collect();
    let is_it = |place: &Range<usize>| {
        let rows: Vec<usize> = (0..3).flat_map(|a| place.clone().map(move |row| a * n + row)).collect();
        let alone = Candidate {
            columns: DMatrix::from_fn(3 * n, rows.len(), |i, j| f64::from(u8::from(i == rows[j]))),
            ..(*candidate).clone()
        };
        let with: Vec<&Candidate> = others.iter().copied().chain([&alone]).collect();
        let beside = means.model_with(without.noise.clone(), &with);
        let left = beside.fitted.score(&means.group(&beside, candidate));
        left.strength < LEAST_OF_OTHERS * score.strength && left.p_value() > SIGNIFICANT
    };
    let middle_s = |place: Range<usize>| place.clone().map(|row| record.rows[row].t_s()).sum::<f64>() / place.len() as f64;
    places.into_iter().find(is_it).map(middle_s)
}

/// Whether the size of a term that acts all along the run stays: times the time, it tells nothing more beside itself. What moves with time by itself, as
/// temperatures and drifts do, is not asked.
fn is_constant(chosen: &Chosen, others: &[&Candidate]) -> bool {
    let Chosen { means, without, candidate, .. } = *chosen;
    let family = candidate.effect.about().family;
    if !matches!(family, Family::StaticOdd | Family::StaticEven | Family::CrossField | Family::History) {
        return true;
    }
    let record = &means.prepared.record;
    let n = record.rows.len();
    let columns = DMatrix::from_fn(3 * n, candidate.columns.ncols(), |i, j| {
        candidate.columns[(i, j)] * record.tau(record.rows[i % n].t_s())
    });
    let moving = Candidate { columns, ..candidate.clone() };
    let with: Vec<&Candidate> = others.iter().copied().chain([candidate]).collect();
    let beside = means.model_with(without.noise.clone(), &with);
    let group = means.group(&beside, &moving);
    group.count() == 0 || beside.fitted.score(&group).p_value() > SIGNIFICANT
}

/// Whether any of the linear parameters of a term stands out of its uncertainty: a form whose shape is free can follow something that is not its
/// own with a size that it does not know.
fn is_apart_from_zero(candidate: &Candidate, parameters: &[Parameter]) -> bool {
    let is_apart = |p: &Parameter| p.std.is_none_or(|std| p.value.abs() >= LEAST_RATIO * std);
    parameters.iter().take(candidate.parameters.len()).any(is_apart)
}

/// Whether another term is a curve of the same axis too: together they stand for a curve that is neither.
fn has_twin_beside(candidate: &Candidate, others: &[&Candidate]) -> bool {
    let is_curve = |c: &Candidate| c.effect.about().family == Family::StaticOdd;
    is_curve(candidate)
        && others.iter().any(|other| is_curve(other) && other.spec.axes.iter().any(|axis| candidate.spec.axes.contains(axis)))
}

/// Whether something begins so near to the begin or end of the run that a lag of the thermistor reaches over it.
fn begins_beside_the_lag(prepared: &PreparedRun, candidate: &Candidate) -> bool {
    let [begin_s, end_s] = prepared.record.span_s;
    let is_beside = |onset_s: f64| onset_s - begin_s < prepared.lag_s || end_s - onset_s < prepared.lag_s;
    prepared.lag_s > 0.0 && candidate.effect.begins_s(&candidate.spec).is_some_and(is_beside)
}

/// By how much the shape of a term is another one in other forms of the effect that describe the data as well: the onset of a knee is higher than
/// that of a bend.
fn by_form(chosen: &Chosen) -> f64 {
    let Chosen { means, without, candidate, score, .. } = *chosen;
    let Some((name, value)) = candidate.effect.continuous(&candidate.spec) else { return 0.0 };
    let is_other = |c: &&Candidate| {
        c.key == candidate.key
            && c.spec.form != candidate.spec.form
            && c.spec.axes == candidate.spec.axes
            && c.effect.continuous(&c.spec).is_some_and(|(other, _)| other == name)
    };
    let evidence = |c: &Candidate| without.fitted.score(&means.group(without, c)).evidence;
    let mut best: Vec<(&Candidate, f64)> = Vec::new();
    for (other, evidence) in means.candidates.iter().filter(is_other).map(|c| (c, evidence(c))) {
        match best.iter_mut().find(|(known, _)| known.spec.form == other.spec.form) {
            Some(known) if known.1 >= evidence => {}
            Some(known) => *known = (other, evidence),
            None => best.push((other, evidence)),
        }
    }
    let refined = best.iter().map(|(other, _)| means.refined(without, other));
    let near = refined.filter(|other| evidence(other) > score.evidence - APART);
    near.filter_map(|other| Some((other.spec.get(name)? - value).abs())).fold(0.0, f64::max)
}

/// Linear parameters, corrected for having been selected, and those of the shape, of which the one that was refined has an uncertainty.
fn parameters(candidate: &Candidate, values: &[(f64, f64)], strength: f64, least: f64, by_form: f64) -> Vec<Parameter> {
    let linear = candidate.parameters.len();
    let shown = selection::corrected(&values[..linear.min(values.len())], strength, least);
    let mut parameters = linear_parameters(candidate.parameters.iter().map(|(name, unit)| (name.as_str(), *unit)), &shown);
    if !candidate.effect.is_unknown() {
        let refined = values.get(linear);
        let std = |_: &str, value: f64| refined.filter(|(v, _)| *v == value).map(|(_, std)| std.hypot(by_form));
        parameters.extend(shape_parameters(&candidate.spec, std));
    }
    parameters
}

/// Held-out residuals as a gap.
pub fn gap(held: &HeldOut, nt_per_ent: [f64; 3]) -> Gap {
    let n = held.residual_ent.nrows();
    let rms_nt: [f64; 3] =
        std::array::from_fn(|a| (held.residual_ent.column(a).norm_squared() / n as f64).sqrt() * nt_per_ent[a]);
    let max_nt = (0..3).map(|a| held.residual_ent.column(a).amax() * nt_per_ent[a]).fold(0.0, f64::max);
    Gap { rms_nt, chi2_per_dof: held.sum / (3 * n) as f64, max_nt }
}
