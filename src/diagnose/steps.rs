//! What was found in one run, as steps of its diagnosis.

use super::result::{Evidence, Gap, Map, Parameter, Pictures, RunnerUp, ShapePoint, Step};
use super::samples::Inside;
use super::search::{Candidate, Explanation, HeldOut, Search, State, Term};
use super::{ALIKE, APART, CERTAIN, selection, words};
use crate::data::units::{COMPONENTS, six_digits};
use crate::fit::scan::{Fitted, Group};
use crate::model::effects::bad_thermistor::{BadThermistor, JUMP, JUMP_TIME};
use crate::model::effects::{EffectRef, Family, Spec};
use crate::record::faults::Jumps;
use crate::record::scene::Scene;

/// Rivals of a step whose evidence is drawn.
const RIVALS: usize = 7;

/// A step found in the samples.
pub(super) fn inside_step(found: &Inside, scene: &Scene) -> Step {
    let about = found.effect.about();
    let columns = found.effect.columns(&scene.record, &found.spec).unwrap_or_default();
    let shape_std = |name: &str| found.shape_std.iter().find(|(n, _)| n == name).map(|(_, s)| *s);
    let mut parameters: Vec<Parameter> = columns
        .iter()
        .zip(&found.values)
        .map(|(c, (value, std))| Parameter { name: c.name.clone(), value: *value, std: Some(*std), unit: c.unit.to_owned() })
        .collect();
    parameters.extend(found.spec.shape.iter().map(|(name, value, unit)| Parameter {
        name: name.clone(),
        value: *value,
        std: shape_std(name),
        unit: unit.clone(),
    }));
    let nt = |ent: [f64; 3]| std::array::from_fn(|a| ent[a] * scene.nt_per_ent[a]);
    let gap = |k: usize| Gap {
        rms_nt: nt(found.rms_ent[k]),
        chi2_per_dof: found.squares[k] / found.squares[2].max(1.0),
        max_nt: nt(found.rms_ent[k]).into_iter().fold(0.0, f64::max),
    };
    let certain = found.ambiguous_with.is_empty() && found.strength > CERTAIN;
    let mut step = Step {
        effect: found.effect,
        axes: found.spec.axis_names().into_iter().map(str::to_owned).collect(),
        ambiguous_with: found.ambiguous_with.clone(),
        form: found.spec.clone(),
        further: Vec::new(),
        parameters,
        place: found.effect.place_in_samples(&found.spec),
        p_value: found.p_value,
        trials: found.trials,
        p_value_corrected: (found.p_value * found.trials as f64).clamp(f64::MIN_POSITIVE, 1.0),
        gap_before: gap(0),
        gap_after: gap(1),
        strength_k: found.strength,
        family: about.family.name(),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: Vec::new(),
        next_measurement: (!certain).then(|| about.best_measurement.to_owned()),
        sentence: String::new(),
        covariate: None,
        shape: Vec::new(),
    };
    step.sentence = words::sentence(&step);
    step
}

/// A step found in the means.
#[expect(clippy::too_many_arguments, reason = "what the search knows of one of its terms")]
pub(super) fn term_step(
    search: &Search,
    state: &State,
    all: &[&Candidate],
    at: usize,
    term: &Term,
    row_std: &[[f64; 3]],
    number: usize,
    maps: &mut Vec<Map>,
    pictures: &mut Pictures,
) -> Step {
    let scene = search.scene;
    let nt_per_ent = scene.nt_per_ent;
    let others: Vec<&Candidate> = all.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, c)| *c).collect();
    let candidate = all[at];
    // The evidence of everything else in place of this term, with the noise of the full model.
    let without = search.state_beside(state, &others);
    let groups = search.groups(&without);
    let explanations = search.explanations(&without, &groups);
    let own_group = search.group(&without, candidate);
    let score = without.fitted.score(&own_group);
    let own =
        explanations.iter().find(|e| e.key == candidate.key).map_or(score.evidence, |e| e.evidence).max(score.evidence - 3.0);
    pictures.evidence.push(bars(search, &explanations, &candidate.key, own, number));
    let mut ambiguous: Vec<EffectRef> = Vec::new();
    for e in explanations.iter().filter(|e| e.key != candidate.key) {
        let effect = search.bank[e.best].effect;
        let twin = Fitted::correlation(&groups[e.best], &own_group) > ALIKE
            && groups[e.best].count() == own_group.count()
            && !effect.is_unknown();
        if (e.evidence > own - APART || twin) && effect != candidate.effect && !ambiguous.contains(&effect) {
            ambiguous.push(effect);
        }
    }
    let values = search.estimate(state, all, at).unwrap_or_default();
    let shown = selection::corrected(
        &values[..candidate.parameters.len().min(values.len())],
        score.strength,
        term.least * score.strength,
    );
    let mut parameters: Vec<Parameter> = candidate
        .parameters
        .iter()
        .zip(&shown)
        .map(|((name, unit), (value, std))| Parameter {
            name: name.clone(),
            value: *value,
            std: Some(*std),
            unit: (*unit).to_owned(),
        })
        .collect();
    let shape_value = values.get(candidate.parameters.len());
    if !candidate.effect.is_unknown() {
        parameters.extend(candidate.spec.shape.iter().map(|(name, value, unit)| Parameter {
            name: name.clone(),
            value: *value,
            std: shape_value.filter(|(v, _)| v == value).map(|(_, s)| *s),
            unit: unit.clone(),
        }));
    }
    let amplitudes = nalgebra::DVector::from_fn(candidate.stacked.ncols(), |j, _| values.get(j).map_or(0.0, |v| v.0));
    let contribution = &candidate.stacked * amplitudes;
    let before = search.held_out(&state.noise, &others);
    let after = search.held_out(&state.noise, all);
    let n = scene.readings.nrows();
    // Drawn over the covariate which the contribution follows best, on the axis on which it is largest.
    let axis = (0..3)
        .max_by(|a, b| {
            let size = |a: usize| contribution.rows(a * n, n).norm() * nt_per_ent[a];
            size(*a).total_cmp(&size(*b))
        })
        .unwrap_or(0);
    // What the parameters of the linear model take of it is no disagreement.
    let q = scene.design.clone().qr().q();
    let own_part = contribution.rows(axis * n, n).into_owned();
    let own_part: Vec<f64> = (&own_part - &q * q.tr_mul(&own_part)).iter().copied().collect();
    let (covariate, unit, x) = words::follows(&scene.record, &own_part, candidate.covariate());
    let nt = |held: &HeldOut| held.residual_ent.column(axis).iter().map(|r| r * nt_per_ent[axis]).collect::<Vec<f64>>();
    let noise_nt = row_std.iter().map(|s| s[axis]).sum::<f64>() / n as f64 * nt_per_ent[axis];
    let most = (0..n).max_by(|i, j| own_part[*i].abs().total_cmp(&own_part[*j].abs())).unwrap_or(0);
    let size_nt = own_part[most].abs() * nt_per_ent[axis];
    let place = format!(
        "{}, where the {covariate} is {} {unit}: up to {size_nt:.3} nT ({:.1} noise)",
        COMPONENTS[axis],
        six_digits(x[most]),
        size_nt / noise_nt.max(f64::MIN_POSITIVE)
    );
    let shape = if candidate.effect.is_unknown() {
        words::shape(&x, &own_part, nt_per_ent[axis], &after, axis, row_std)
    } else {
        Vec::<ShapePoint>::new()
    };
    maps.push(Map {
        covariate: covariate.clone(),
        unit: unit.to_owned(),
        axis,
        x,
        before_nt: nt(&before),
        after_nt: nt(&after),
        noise_nt,
        step: number,
    });
    let about = candidate.effect.about();
    let certain = ambiguous.is_empty() && score.strength > CERTAIN;
    let next_measurement = words::next_measurement(candidate.effect, &ambiguous);
    let axes: Vec<String> = candidate.spec.axis_names().into_iter().map(str::to_owned).collect();
    let mut step = Step {
        effect: candidate.effect,
        axes,
        ambiguous_with: ambiguous,
        form: candidate.spec.clone(),
        further: Vec::new(),
        parameters,
        place,
        p_value: score.p_value(),
        trials: term.trials,
        p_value_corrected: term.p_global,
        gap_before: gap(&before, nt_per_ent),
        gap_after: gap(&after, nt_per_ent),
        strength_k: score.strength,
        family: about.family.name(),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: runners(search, &groups, &explanations, &candidate.key),
        next_measurement,
        sentence: String::new(),
        covariate: candidate.covariate().map(str::to_owned),
        shape,
    };
    step.sentence = words::sentence(&step);
    step
}

pub(super) fn gap(held: &HeldOut, nt_per_ent: [f64; 3]) -> Gap {
    let n = held.residual_ent.nrows();
    let rms_nt: [f64; 3] =
        std::array::from_fn(|a| (held.residual_ent.column(a).norm_squared() / n as f64).sqrt() * nt_per_ent[a]);
    let max_nt = (0..3).map(|a| held.residual_ent.column(a).amax() * nt_per_ent[a]).fold(0.0, f64::max);
    Gap { rms_nt, chi2_per_dof: held.sum / (3 * n) as f64, max_nt }
}

pub(super) fn runners(search: &Search, groups: &[Group], explanations: &[Explanation], own: &str) -> Vec<RunnerUp> {
    let Some(reference) = explanations.iter().find(|e| e.key == own) else { return Vec::new() };
    let others = explanations.iter().filter(|e| e.key != own && e.evidence > reference.evidence - 60.0).take(5);
    others
        .map(|e| RunnerUp {
            effect: search.bank[e.best].key.clone(),
            log_ratio: e.evidence - reference.evidence,
            correlation: Fitted::correlation(&groups[e.best], &groups[reference.best]),
        })
        .collect()
}

/// Evidence of a step and of the rivals that explain anything at all.
pub(super) fn bars(search: &Search, explanations: &[Explanation], key: &str, own: f64, step: usize) -> Evidence {
    let rivals = explanations.iter().filter(|e| e.key != key && e.evidence > 0.0).take(RIVALS);
    let named = std::iter::once((key.to_owned(), own));
    Evidence { step, bars: named.chain(rivals.map(|e| (search.bank[e.best].key.clone(), e.evidence))).collect(), apart: APART }
}

/// One step per effect, whatever the number of its forms, and where each step went; none for one that joined another.
pub(super) fn joined(steps: Vec<Step>) -> (Vec<Step>, Vec<Option<usize>>) {
    let mut all: Vec<Step> = Vec::new();
    let mut places = Vec::with_capacity(steps.len());
    for step in steps {
        let same = |s: &&mut Step| s.effect == step.effect && s.covariate == step.covariate && !s.form.axes.is_empty();
        let Some(first) = all.iter_mut().find(same).filter(|_| step.family != Family::Periodic.name()) else {
            places.push(Some(all.len()));
            all.push(step);
            continue;
        };
        places.push(None);
        for axis in &step.axes {
            if !first.axes.contains(axis) {
                first.axes.push(axis.clone());
            }
        }
        first.axes.sort();
        first.further.push((step.form.clone(), step.parameters.clone()));
        first.ambiguous_with.retain(|a| step.ambiguous_with.contains(a));
        first.gap_after = step.gap_after;
        first.strength_k = first.strength_k.hypot(step.strength_k);
        first.sentence = words::sentence(first);
    }
    (all, places)
}

/// Names are no longer certain where something unknown was left over on the same axes.
pub(super) fn sufficient(steps: &mut [Step]) {
    let left: Vec<Vec<String>> = steps.iter().filter(|s| s.effect.is_unknown()).map(|s| s.axes.clone()).collect();
    for step in steps.iter_mut().filter(|s| !s.effect.is_unknown() && s.wording == "is") {
        if left.iter().any(|axes| axes.iter().any(|a| step.axes.contains(a))) {
            step.wording = "consistent with";
        }
    }
}

/// The step that tells of a thermistor that jumps.
pub fn fault_step(fault: &Jumps) -> Step {
    let Jumps { channel: name, jumps, readings } = fault;
    let list: Vec<String> = jumps.iter().map(|(t_s, size)| format!("by {size:+.2} K at {t_s:.0} s")).collect();
    let list = list.join(", ");
    let parameter = |(k, (_, size)): (usize, &(f64, f64))| Parameter {
        name: if k == 0 { format!("jump of {name}") } else { format!("jump {} of {name}", k + 1) },
        value: *size,
        std: None,
        unit: "K".to_owned(),
    };
    let gap = Gap::default();
    Step {
        effect: EffectRef::new(&BadThermistor),
        axes: Vec::new(),
        ambiguous_with: Vec::new(),
        form: Spec::new(JUMP, &[]).with(JUMP_TIME, jumps[0].0, "s"),
        further: Vec::new(),
        parameters: jumps.iter().enumerate().map(parameter).collect(),
        place: format!("channel {name} jumps {list}"),
        p_value: f64::MIN_POSITIVE,
        trials: *readings,
        p_value_corrected: f64::MIN_POSITIVE,
        gap_before: gap,
        gap_after: gap,
        strength_k: fault.strength(),
        family: Family::DataFault.name(),
        wording: "is",
        runners_up: Vec::new(),
        next_measurement: None,
        sentence: format!(
            "The temperature channel {name} jumps {list} and was not to be trusted there; all else was looked for with the jumps taken off."
        ),
        covariate: None,
        shape: Vec::new(),
    }
}
