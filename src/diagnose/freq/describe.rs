//! The description of an effect in sines.

use super::STRETCH;
use super::model::Fit;
use super::problem::{SineSearch, Term};
use super::sines::{SineOf, Sines};
use crate::data::units::COMPONENTS;
use crate::diagnose::problem::Description;
use crate::diagnose::result::{Gap, Map, Parameter, Telling};
use crate::diagnose::steps::Facts;
use crate::fit::statistics::median;
use crate::model::effects::in_sine::SineParameter;
use crate::model::effects::{Spec, UNKNOWN};
use nalgebra::DVector;

/// Settings that are named where an effect shows most.
const NAMED: usize = 3;

/// The facts of an accepted term; `index` is its number among those of the search.
pub(super) fn describe(search: &SineSearch, fit: &Fit, found: &Term, index: usize, number: usize) -> Description {
    let sines = search.sines;
    let k = search.base.model.terms.len() + index;
    let (effect, timing, axes) = (found.term.effect, found.term.is_of_timing(), found.term.axes());
    let (form, parameters) = reported(found, k, fit, sines);
    // The gap is that of this effect alone: with all that was found beside it.
    let before = fit.without(k, sines).as_ref().unwrap_or(&found.before).held_out(sines, STRETCH);
    let after = fit.held_out(sines, STRETCH);
    let without = fit.p.len() - found.term.count();
    let gaps = [gap(sines, &before, without, timing), gap(sines, &after, fit.p.len(), timing)];
    let axis = axes.iter().copied().max_by(|a, b| gaps[0].rms_nt[*a].total_cmp(&gaps[0].rms_nt[*b])).unwrap_or(0);
    let names: Vec<&'static str> = axes.iter().filter_map(|a| COMPONENTS.get(*a).copied()).collect();
    let map = map(sines, axis, timing, &before, &after, number);
    let place = format!(
        "{}, {} of the sines, most at {}: up to {:.4} nT ({:.1} noise)",
        names.join(", "),
        if timing { "phases" } else { "amplitudes and phases" },
        most_gained(sines, &before, &after).join(", "),
        gaps[0].max_nt,
        gaps[0].max_nt / map.noise_nt
    );
    let remark = if found.ambiguous.contains(&UNKNOWN) {
        " A source whose amplitude drifts with time describes the sines as well: the frequencies go one way, or nearly so."
            .to_owned()
    } else {
        String::new()
    };
    let facts = Facts {
        axes: names,
        parameters,
        place,
        gaps,
        telling: Telling { own: None, remark },
        ambiguous_with: found.ambiguous.clone(),
        runners_up: found.runners_up.clone(),
        ..Facts::new(effect, form, found.significance)
    };
    Description { facts, map, evidence: None }
}

/// Form and parameters of term `k` of a fit, with uncertainties by the noise that the fit leaves.
fn reported(found: &Term, k: usize, fit: &Fit, sines: &Sines) -> (Spec, Vec<Parameter>) {
    let begin = fit.model.begin(k);
    let values = &fit.p[begin..begin + found.term.count()];
    let covariance = fit.covariance();
    let scale = (fit.chi2 / fit.dof()).max(1.0).sqrt();
    let std = |n: usize| Some(scale * fit.std(begin + n, sines)?);
    let correlation = |a: usize, b: usize| {
        let c = covariance.as_ref()?;
        let of = |a: usize, b: usize| c[(begin + a, begin + b)];
        Some(of(a, b) / (of(a, a) * of(b, b)).sqrt()).filter(|r| r.is_finite())
    };
    let (form, parameters) = found.term.report(&sines.run, values, &std, &correlation);
    let parameter = |p: SineParameter| Parameter { name: p.name, value: p.value, std: p.std, unit: p.unit };
    (form, parameters.into_iter().map(parameter).collect())
}

/// The settings whose held-out squares shrink most, in words.
fn most_gained(sines: &Sines, before: &DVector<f64>, after: &DVector<f64>) -> Vec<String> {
    let rows = sines.rows();
    let gained = |j: usize| before.rows(j * rows, rows).norm_squared() - after.rows(j * rows, rows).norm_squared();
    let mut order: Vec<usize> = (0..sines.list.len()).collect();
    order.sort_by(|a, b| gained(*b).total_cmp(&gained(*a)));
    let words = |j: &usize| {
        let s = &sines.list[*j].setting;
        format!("{} Hz ({:.0} to {:.0} s)", s.frequency_hz, s.t_start_s, s.t_end_s)
    };
    order.iter().take(NAMED).map(words).collect()
}

/// Held-out residuals as a gap; amplitudes are those of the readings, nT for sensors that read enT nearly.
pub(super) fn gap(sines: &Sines, held: &DVector<f64>, parameters: usize, timing: bool) -> Gap {
    let dof = held.len().saturating_sub(parameters).max(1) as f64;
    let mut gap = Gap { chi2_per_dof: held.norm_squared() / dof, ..Gap::default() };
    for i in 0..3 {
        let nt = in_nt(sines, held, i, timing);
        gap.rms_nt[i] = (nt.iter().map(|r| r * r).sum::<f64>() / nt.len() as f64).sqrt();
        gap.max_nt = nt.iter().fold(gap.max_nt, |m, r| m.max(r.abs()));
    }
    gap
}

/// Whitened residuals of the amplitudes, or of the phase at the end of a setting relative to its middle, as part of the reading, nT.
fn in_nt(sines: &Sines, held: &DVector<f64>, axis: usize, timing: bool) -> Vec<f64> {
    let rows = sines.rows();
    let at = |(j, s): (usize, &SineOf)| {
        let tone = &s.tones[axis];
        let (row, size) = if timing { (rows - 3, tone.std[2] * 0.5 * s.length_s) } else { (0, tone.std[0]) };
        held[j * rows + row + axis] * size * tone.log_amplitude.exp()
    };
    sines.list.iter().enumerate().map(at).collect()
}

/// Held-out residuals of one axis without and with a term.
pub(super) fn map(sines: &Sines, axis: usize, timing: bool, before: &DVector<f64>, after: &DVector<f64>, step: usize) -> Map {
    let x = |s: &SineOf| if timing { s.middle_s } else { s.setting.frequency_hz };
    let noise = |s: &SineOf| {
        let tone = &s.tones[axis];
        tone.log_amplitude.exp() * if timing { tone.std[2] * 0.5 * s.length_s } else { tone.std[0] }
    };
    Map {
        covariate: if timing { "time" } else { "frequency" }.to_owned(),
        unit: if timing { "s" } else { "Hz" }.to_owned(),
        axis,
        x: sines.list.iter().map(x).collect(),
        before_nt: in_nt(sines, before, axis, timing),
        after_nt: in_nt(sines, after, axis, timing),
        noise_nt: median(&mut sines.list.iter().map(noise).collect::<Vec<f64>>()),
        step,
        names: Vec::new(),
    }
}
