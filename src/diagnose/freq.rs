//! Frequency runs: what amplitudes and phases of sines tell beside a simple response and a steady clock.
//!
//! Every undamaged setting becomes three numbers per component ([`sines`]): amplitude, phase, and how fast the phase runs away. A response
//! of at most two parameters is fitted to all of them ([`model`]; mathematics section 3), with a sampling frequency per component. Where the
//! phase of the field at the begin of a setting is not known, only differences of the phases between components count. Then the effects of
//! the catalogue are tried beside it, on noise that was seen near every sine. Lost samples are no term of a response: they are seen in
//! the counters and in stretches that do not follow their sine.

mod bank;
mod lost;
pub mod model;
pub mod sines;
mod table;

pub use table::table;

use super::result::{DetectionLimit, Diagnosis, Gap, Map, NotIdentifiable, Parameter, Pictures, RunnerUp, Step};
use super::{APART, CERTAIN, DiagnoseError, FOUND_90, Options, steps, words};
use crate::data::run::{Run, Vector, VectorSink};
use crate::data::units::{COMPONENTS, Reading};
use crate::files::campaign::Campaign;
use crate::fit::aicc;
use crate::fit::statistics::median;
use crate::measure::freq::{self as analysis, Freq, Sines as Sink};
use crate::model::effects::eddy_current_attenuation::{EddyCurrentAttenuation, one_pole};
use crate::model::effects::in_sine::SineParameter;
use crate::model::effects::response_order::{ResponseOrder, two_poles};
use crate::model::effects::{Catalogue, EffectRef};
use crate::model::response::{RESPONSES, Response};
use crate::record::faults;
use crate::record::scene::Samples;
use bank::{Bank, Entry, Refined, refined};
use lost::lost;
use model::{Fit, Model, Term};
use nalgebra::DVector;
use rayon::prelude::*;
use sines::Sines;

/// Responses of so many parameters are simple: what is missing beside them is an effect.
const SIMPLE: usize = 2;
/// As many of them, the best by their amplitudes, are fitted.
const BASES: usize = 3;
/// Chi-square over degrees of freedom from which the base itself is doubted.
const DOUBTFUL: f64 = 1.5;
/// Probability of a false alarm per run.
const FALSE_ALARM: f64 = 0.005;
/// Most effects beside the response.
const MOST_STEPS: usize = 3;
/// Settings that are held out at once.
const STRETCH: usize = 3;

/// Diagnoses a run with sines.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(run: &Run, samples: Option<&Samples>, campaign: &Campaign, options: &Options) -> Result<Diagnosis, DiagnoseError> {
    let samples = samples.filter(|s| !s.t_s.is_empty()).ok_or(DiagnoseError::NoSamples)?;
    let mut sink = Sink::default();
    sink.begin(&run.header, &run.settings);
    for ((n, t_s), reading) in samples.n.iter().zip(&samples.t_s).zip(&samples.reading_ent) {
        sink.vector(Vector { n: *n, t_s: *t_s, reading: Reading(*reading) });
    }
    let freq = analysis::freq(run, &sink, &campaign.file.instructions, &analysis::Options::default())?;
    drop(sink);
    let span_s = [samples.t_s[0], samples.t_s[samples.t_s.len() - 1]];
    let (faults, _) = faults::thermistors(run, span_s);
    let mut steps: Vec<Step> = faults.iter().map(steps::fault_step).collect();
    steps.extend(lost(run, samples, &freq));
    let mut warnings = Vec::new();

    let mut sines = Sines::new(samples, &freq, &run.temperatures)?;
    let mut base = base(&freq, &mut sines)?;
    let given: Vec<(Term, Vec<f64>)> = known_terms(run, options, &sines, &mut warnings);
    let shift = Term::shift();
    // Where the record begins is known to a part of a sample: a small delay belongs to the model and is no effect.
    if sines.run.begins_known
        && !base.model.terms.iter().any(|t| t.is_like(&shift))
        && let Some(with) = base.with(&shift, &[0.0], &sines)
        && with.p.last().is_some_and(|us| !shift.is_told(&[*us], &sines.run))
    {
        base = with;
    }
    if !sines.run.begins_known {
        warnings.push(
            "the phases of the field are not those of sines that begin with their settings: phases count between components and within \
             settings only"
                .to_owned(),
        );
    }
    let with_given = |fit: Fit, sines: &Sines| {
        given.iter().fold(fit, |fit, (term, values)| {
            let wanted = !fit.model.terms.iter().any(|t| t.is_same(term));
            wanted.then(|| fit.with(term, values, sines)).flatten().unwrap_or(fit)
        })
    };
    base = with_given(base, &sines);
    let mut found: Vec<Found> = Vec::new();
    let mut doubted = false;
    let mut bank;
    loop {
        bank = Bank::new(&base, &sines, &options.catalogue, &found);
        let Some(hit) = bank.best(&base).filter(|_| found.len() < MOST_STEPS) else { break };
        if bank.corrected(hit.p_value) >= FALSE_ALARM {
            break;
        }
        let all = refined(&base, &bank, &sines);
        let Some(best) = all.first() else { break };
        if !doubted && found.is_empty() && base.chi2 > DOUBTFUL * base.dof() {
            doubted = true;
            if let Some(other) = another_base(&freq, best, &sines) {
                base = with_given(other, &sines);
                continue;
            }
        }
        let chosen = &best.fit;
        if bank.corrected(base.p_value_of(chosen)) >= FALSE_ALARM {
            break;
        }
        let scale = (chosen.chi2 / chosen.dof()).max(1.0);
        let ambiguous: Vec<&Refined> =
            all[1..].iter().filter(|r| r.aicc - best.aicc < 2.0 * APART && r.effect() != best.effect()).collect();
        found.push(Found {
            term: best.term.clone(),
            p_value: hit.p_value,
            trials: bank.entries.len(),
            corrected: bank.corrected(hit.p_value),
            strength: ((base.chi2 - chosen.chi2) / scale).max(0.0).sqrt(),
            before: base.clone(),
            ambiguous: ambiguous.iter().map(|r| r.effect()).collect(),
            runners_up: all[1..]
                .iter()
                .map(|r| RunnerUp {
                    effect: r.effect().to_string(),
                    log_ratio: 0.5 * (best.aicc - r.aicc),
                    correlation: Bank::alike(&base, best, r, &sines),
                })
                .collect(),
        });
        base = best.fit.clone();
        drop_superfluous(&mut found, &mut base, &bank, &sines);
    }
    let mut maps = Vec::new();
    let number = steps.len();
    let before = base.model.terms.len().saturating_sub(found.len());
    for (k, found) in found.iter().enumerate() {
        steps.push(step(found, before + k, &base, &sines, number + k, &mut maps));
    }
    let noise_floor_nt = std::array::from_fn(|i| {
        median(&mut sines.list.iter().map(|s| s.tones[i].std[0] * s.tones[i].log_amplitude.exp()).collect::<Vec<f64>>())
    });
    let held = base.held_out(&sines, STRETCH);
    let left = (0..3).map(|axis| map(&sines, axis, false, &held, &held, 0)).collect();
    let (not_identifiable, detection_limits) = limits(&bank, &sines, &steps, &options.catalogue);
    let pictures = Pictures { left, ..Pictures::default() };
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![run.header.run.clone()],
        noise_floor_nt,
        noise: None,
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits,
        response: Some(response_words(&base, &sines)),
        warnings,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures,
    })
}

/// Takes out what was found first and is not needed beside what was found since.
fn drop_superfluous(found: &mut Vec<Found>, base: &mut Fit, bank: &Bank, sines: &Sines) {
    let first = base.model.terms.len() - found.len();
    let mut k = 0;
    while k + 1 < found.len() {
        match base.without(first + k, sines) {
            Some(without) if bank.corrected(without.p_value_of(base)) >= FALSE_ALARM => {
                *base = without;
                found.remove(k);
            }
            _ => k += 1,
        }
    }
}

/// The known effects that act on the sines of this run, with their values; what the run cannot have is warned about.
fn known_terms(run: &Run, options: &Options, sines: &Sines, warnings: &mut Vec<String>) -> Vec<(Term, Vec<f64>)> {
    let of_this_run = options.given.iter().filter(|g| g.of_another(&run.header.run).is_none());
    of_this_run
        .filter_map(|given| {
            let term = given.effect.known_sine_term(given.in_sine.as_ref()?, &sines.run);
            let term = term.map(|(form, values)| (Term::new(given.effect, form), values));
            if term.is_none() {
                warnings.push(format!("{} ({}) needs a temperature that the run does not have", given.effect, given.spec.form));
            }
            term
        })
        .collect()
}

/// The simple response that describes the run best, without any effect.
fn base(freq: &Freq, sines: &mut Sines) -> Result<Fit, DiagnoseError> {
    let simple = |name: &str| Response::named(name).filter(|r| r.freedom() <= SIMPLE);
    let mut order: Vec<(f64, Response, [f64; 3])> = freq
        .corner
        .candidates
        .iter()
        .filter_map(|c| Some((c.aicc?, simple(c.model)?, c.f_3db_hz.map(|f| f.unwrap_or(f64::NAN)))))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fits: Vec<(f64, Fit)> =
        order.iter().take(BASES).filter_map(|(_, response, corners)| fitted(*response, *corners, freq, sines)).collect();
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = fits.into_iter().next().ok_or(DiagnoseError::NoResponse)?.1;
    let shapes = best.model.shapes(&best.p);
    let settings = sines.clone();
    sines.see_begins(|j, i| best.model.triple(&best.p, &shapes, &settings, j, i));
    if !sines.run.begins_known {
        return Ok(best);
    }
    let known = best.model.fit(&best.p, sines).ok_or(DiagnoseError::NoPhases)?;
    // Where rounded time tags leave the time of the counter open, it is a parameter of the base.
    if sines.run.tags_are_rounded { known.with(&Term::shift(), &[0.0], sines).ok_or(DiagnoseError::NoPhases) } else { Ok(known) }
}

/// AICc and fit of a response whose corners are near the given ones. Beside a notch a logarithm has more than one minimum: what the amplitudes
/// by themselves have told is a start as well.
fn fitted(response: Response, corner_hz: [f64; 3], freq: &Freq, sines: &Sines) -> Option<(f64, Fit)> {
    let model = Model { response, terms: Vec::new() };
    let by_amplitudes = freq.corner.components.each_ref().map(|c| {
        let parameters = c.model.iter().flat_map(|m| &m.parameters);
        parameters.map(|p| p.value).collect::<Vec<f64>>()
    });
    let is_the_same = freq.corner.model == Some(response.name) && freq.corner.components.iter().all(|c| c.model.is_some());
    let starts = model.starts(corner_hz).into_iter().chain(is_the_same.then_some(by_amplitudes));
    let fits = starts.filter_map(|shapes| model.fit(&model.start(sines, &shapes), sines));
    let best = fits.min_by(|a, b| a.chi2.total_cmp(&b.chi2))?;
    Some((aicc(best.chi2, best.p.len(), best.residual.len())?, best))
}

/// Where a simple response does not describe the run: another one that does so with an effect, or a rich one without, if it is better than the
/// best so far beyond doubt.
fn another_base(freq: &Freq, best: &Refined, sines: &Sines) -> Option<Fit> {
    let corners: [f64; 3] = std::array::from_fn(|i| freq.f_3db_igep_hz[i]);
    let known = corners.iter().copied().filter(|c| c.is_finite()).fold(f64::NAN, f64::min);
    let corners = corners.map(|c| if c.is_finite() { c } else { known });
    let all: Vec<(f64, Fit)> = RESPONSES
        .par_iter()
        .filter_map(|response| {
            let (aicc_alone, alone) = fitted(*response, corners, freq, sines)?;
            if response.freedom() > SIMPLE {
                return Some((aicc_alone, alone));
            }
            let all = [true; 3];
            let one = Term::new(EffectRef::new(&EddyCurrentAttenuation), one_pole(all));
            let two = Term::new(EffectRef::new(&ResponseOrder), two_poles(all, alone.model.corner_hz(&alone.p)));
            let with = [one, two].into_iter().flat_map(|term| {
                let alone = &alone;
                [0.5, 1.0].into_iter().filter_map(move |part| alone.with(&term, &[part, 300_f64.ln()], sines))
            });
            let least = with.filter_map(|f| aicc(f.chi2, f.p.len(), f.residual.len())).fold(aicc_alone, f64::min);
            Some((least, alone))
        })
        .collect();
    let scale = (best.fit.chi2 / best.fit.dof()).max(1.0);
    let least = all.into_iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
    let now = aicc(best.fit.chi2, best.fit.p.len(), best.fit.residual.len())?;
    let other = Some(least.1).filter(|f| (now - least.0) / scale > 2.0 * APART && f.model.response != best.fit.model.response)?;
    if sines.run.begins_known && sines.run.tags_are_rounded { other.with(&Term::shift(), &[0.0], sines) } else { Some(other) }
}

/// An effect that was accepted.
struct Found {
    term: Term,
    p_value: f64,
    trials: usize,
    corrected: f64,
    strength: f64,
    before: Fit,
    ambiguous: Vec<EffectRef>,
    runners_up: Vec<RunnerUp>,
}

/// Held-out residuals as a gap; amplitudes are those of the readings, nT for sensors that read enT nearly.
fn gap(sines: &Sines, held: &DVector<f64>, parameters: usize, timing: bool) -> Gap {
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
    let at = |(j, s): (usize, &sines::SineOf)| {
        let tone = &s.tones[axis];
        let (row, size) = if timing { (rows - 3, tone.std[2] * 0.5 * s.length_s) } else { (0, tone.std[0]) };
        held[j * rows + row + axis] * size * tone.log_amplitude.exp()
    };
    sines.list.iter().enumerate().map(at).collect()
}

fn map(sines: &Sines, axis: usize, timing: bool, before: &DVector<f64>, after: &DVector<f64>, step: usize) -> Map {
    let x = |s: &sines::SineOf| if timing { s.middle_s } else { s.setting.frequency_hz };
    let noise = |s: &sines::SineOf| {
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
    }
}

/// A step of the response or of the clock; `k` is its number among the terms of the fit.
fn step(found: &Found, k: usize, fit: &Fit, sines: &Sines, number: usize, maps: &mut Vec<Map>) -> Step {
    let begin = fit.model.begin(k);
    let values = &fit.p[begin..begin + found.term.count()];
    let covariance = fit.covariance();
    let scale = (fit.chi2 / fit.dof()).max(1.0).sqrt();
    let std = |n: usize| covariance.as_ref().map(|c| scale * c[(begin + n, begin + n)].max(0.0).sqrt());
    let correlation = |a: usize, b: usize| {
        let c = covariance.as_ref()?;
        let of = |a: usize, b: usize| c[(begin + a, begin + b)];
        Some(of(a, b) / (of(a, a) * of(b, b)).sqrt()).filter(|r| r.is_finite())
    };
    let (effect, timing, axes) = (found.term.effect, found.term.is_of_timing(), found.term.axes());
    let (form, reported) = found.term.report(&sines.run, values, &std, &correlation);
    let parameter = |p: SineParameter| Parameter { name: p.name, value: p.value, std: p.std, unit: p.unit };
    let parameters = reported.into_iter().map(parameter).collect();
    let before = found.before.held_out(sines, STRETCH);
    // The gap is that of this effect alone: with all that was found beside it.
    let before = fit.without(k, sines).map_or(before, |f| f.held_out(sines, STRETCH));
    let after = fit.held_out(sines, STRETCH);
    let without = fit.p.len() - found.term.count();
    let (gap_before, gap_after) = (gap(sines, &before, without, timing), gap(sines, &after, fit.p.len(), timing));
    // Where the held-out squares shrink most.
    let rows = sines.rows();
    let gained = |j: usize| before.rows(j * rows, rows).norm_squared() - after.rows(j * rows, rows).norm_squared();
    let mut order: Vec<usize> = (0..sines.list.len()).collect();
    order.sort_by(|a, b| gained(*b).total_cmp(&gained(*a)));
    let most: Vec<String> = order
        .iter()
        .take(3)
        .map(|j| {
            let s = &sines.list[*j].setting;
            format!("{} Hz ({:.0} to {:.0} s)", s.frequency_hz, s.t_start_s, s.t_end_s)
        })
        .collect();
    let axis = axes.iter().copied().max_by(|a, b| gap_before.rms_nt[*a].total_cmp(&gap_before.rms_nt[*b])).unwrap_or(0);
    let names: Vec<&str> = axes.iter().filter_map(|a| COMPONENTS.get(*a).copied()).collect();
    let what = if timing { "phases" } else { "amplitudes and phases" };
    let drawn = map(sines, axis, timing, &before, &after, number);
    let noise_nt = drawn.noise_nt;
    maps.push(drawn);
    let place = format!(
        "{}, {what} of the sines, most at {}: up to {:.4} nT ({:.1} noise)",
        names.join(", "),
        most.join(", "),
        gap_before.max_nt,
        gap_before.max_nt / noise_nt
    );
    let certain = found.ambiguous.is_empty() && found.strength > CERTAIN;
    let mut step = Step {
        effect,
        axes: names.into_iter().map(str::to_owned).collect(),
        ambiguous_with: found.ambiguous.clone(),
        form,
        further: Vec::new(),
        parameters,
        place,
        p_value: found.p_value,
        trials: found.trials,
        p_value_corrected: found.corrected,
        gap_before,
        gap_after,
        strength_k: found.strength,
        family: effect.about().family.name(),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: found.runners_up.clone(),
        next_measurement: words::next_measurement(effect, &found.ambiguous),
        sentence: String::new(),
        covariate: None,
        shape: Vec::new(),
    };
    step.sentence = words::sentence(&step);
    step
}

/// The response in words, with its -3 dB frequencies.
fn response_words(fit: &Fit, sines: &Sines) -> String {
    let shapes = fit.model.shapes(&fit.p);
    let response = fit.model.response;
    let all: Vec<String> = (0..3)
        .map(|i| {
            let corner = response.corner_hz(&shapes[i]).map_or_else(|| "none".to_owned(), |c| format!("{c:.3} Hz"));
            format!("{} {corner}", COMPONENTS[i])
        })
        .collect();
    format!(
        "{}, -3 dB at {}; chi²/dof {:.2} over {} settings",
        response.name,
        all.join(", "),
        fit.chi2 / fit.dof(),
        sines.list.len()
    )
}

/// What cannot be shown, and how small an effect of the rest would have been found.
fn limits(bank: &Bank, sines: &Sines, steps: &[Step], catalogue: &Catalogue) -> (Vec<NotIdentifiable>, Vec<DetectionLimit>) {
    let found = |effect: EffectRef| steps.iter().any(|s| s.effect == effect);
    let none = catalogue
        .iter()
        .filter(|effect| !found(*effect))
        .filter_map(|effect| Some(NotIdentifiable { effect, reason: effect.unseen_in_sines(&sines.run)?.to_string() }))
        .collect();
    let mut limits = Vec::new();
    for effect in bank.effects() {
        if found(effect) {
            continue;
        }
        let is_one = |e: &&Entry| e.term.axes().len() == 3 && e.base.ncols() == 1 && e.term.has_limit();
        let own = bank.entries.iter().filter(|e| e.term.effect == effect).filter(is_one);
        let Some(best) = own.max_by(|a, b| a.norm.total_cmp(&b.norm)) else { continue };
        let least = FOUND_90 / best.norm;
        let (parameter, timing) = (best.term.limit(&sines.run, least, best.hz), best.term.is_of_timing());
        let noise = |s: &sines::SineOf| s.tones[0].std[usize::from(timing)] * s.tones[0].log_amplitude.exp();
        let noise_nt = median(&mut sines.list.iter().map(noise).collect::<Vec<f64>>());
        limits.push(DetectionLimit {
            effect,
            axis: "x, y, z".to_owned(),
            // Of a part that is spread over all settings as the noise is.
            amplitude_nt: FOUND_90 * noise_nt / (sines.list.len() as f64).sqrt(),
            parameter,
        });
    }
    (none, limits)
}
