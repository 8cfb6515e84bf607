//! Frequency runs: what amplitudes and phases of sines tell beside a simple response and a steady clock.
//!
//! Every undamaged setting becomes three numbers per component ([`sines`]): amplitude, phase, and how fast the phase runs away. A response
//! of at most two parameters is fitted to all of them ([`model`]; mathematics section 3), with a sampling frequency per component. Where the
//! phase of the field at the begin of a setting is not known, only differences of the phases between components count. Then the effects of
//! the catalogue are tried beside it, on noise that was seen near every sine. Lost samples are no term of a response: they are seen in
//! the counters and in stretches that do not follow their sine.

pub mod model;
pub mod sines;

use super::known::CORRELATION;
use super::result::{DetectionLimit, Diagnosis, Gap, Map, NotIdentifiable, Parameter, Pictures, RunnerUp, Step};
use super::scene::Samples;
use super::{APART, CERTAIN, FOUND_90, Options, faults, words};
use crate::analysis::freq::{self as analysis, Freq, Sines as Sink};
use crate::campaign::Campaign;
use crate::fit::aicc;
use crate::fit::scan::orthonormal;
use crate::fit::sine::{self, Oscillator};
use crate::formats::amplitudes::Row;
use crate::model::effects::clock_drift::{IN_TIME, WITH_TEMPERATURE};
use crate::model::effects::time_shift::DELAY;
use crate::model::effects::{CATALOGUE, Spec, named};
use crate::model::response::{RESPONSES, Response};
use crate::plateau::median;
use crate::run::{Run, Vector, VectorSink};
use crate::units::{COMPONENTS, Reading};
use model::{Fit, Model, Term, clock_temperature};
use nalgebra::{DMatrix, DVector};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rayon::prelude::*;
use sines::Sines;
use statrs::distribution::{ContinuousCDF, FisherSnedecor};
use std::ops::Range;

/// Responses of so many parameters are simple: what is missing beside them is an effect.
const SIMPLE: usize = 2;
/// As many of them, the best by their amplitudes, are fitted.
const BASES: usize = 3;
/// Chi-square over degrees of freedom from which the base itself is doubted.
const DOUBTFUL: f64 = 1.5;
/// Poles that are tried, Hz: the first, their ratio, and their number.
const FIRST_POLE_HZ: f64 = 3.0;
const POLE_RATIO: f64 = 1.6;
const POLES: i32 = 16;
/// Draws of noise for the price of the trials.
const DRAWS: usize = 1000;
/// Probability of a false alarm per run.
const FALSE_ALARM: f64 = 0.01;
/// Most effects beside the response.
const MOST_STEPS: usize = 3;
/// Settings that are held out at once.
const STRETCH: usize = 3;
/// A column of which less than this part is left beside others is one of them.
const ROUNDING: f64 = 1e-6;
/// Least displacement of time tags that is one, in samples.
const LEAST_SHIFT: f64 = 0.02;
/// A setting of which more than this part follows no sine is damaged.
const DAMAGED_PART: f64 = 0.05;
/// A stretch follows a sine if the median of its residuals is within this factor of that of another one.
const FOLLOWS: f64 = 2.0;
/// Rows of a table with less weight in the response are outliers.
const OUTLIER: f64 = 0.5;

/// Diagnoses a run with sines.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(run: &Run, samples: Option<&Samples>, campaign: &Campaign, options: &Options) -> Result<Diagnosis, String> {
    let samples = samples.filter(|s| !s.t_s.is_empty()).ok_or("the run has no samples")?;
    let mut sink = Sink::default();
    sink.begin(&run.header, &run.settings);
    for ((n, t_s), reading) in samples.n.iter().zip(&samples.t_s).zip(&samples.reading_ent) {
        sink.vector(Vector { n: *n, t_s: *t_s, reading: Reading(*reading) });
    }
    let freq = analysis::freq(run, &sink, campaign, &analysis::Options::default()).map_err(|e| e.to_string())?;
    drop(sink);
    let span_s = [samples.t_s[0], samples.t_s[samples.t_s.len() - 1]];
    let (mut steps, _) = faults::thermistors(run, span_s);
    steps.extend(lost(run, samples, &freq));
    let mut warnings = Vec::new();

    let mut sines = Sines::new(samples, &freq)?;
    let mut base = base(&freq, &mut sines)?;
    let given: Vec<(Term, Vec<f64>)> =
        options.given.iter().filter_map(|g| Term::of(g.in_sine.as_ref()?, &sines, &run.temperatures)).collect();
    // Where the record begins is known to a part of a sample: a small delay belongs to the model and is no effect.
    if sines.begins_known
        && !base.model.terms.contains(&Term::Shift)
        && let Some(with) = base.with(&Term::Shift, &[0.0], &sines)
        && with.p.last().is_some_and(|us| 1e-6 * us.abs() <= LEAST_SHIFT / sines.rate_hz)
    {
        base = with;
    }
    if !sines.begins_known {
        warnings.push(
            "the phases of the field are not those of sines that begin with their settings: phases count between components and within \
             settings only"
                .to_owned(),
        );
    }
    let with_given = |fit: Fit, sines: &Sines| {
        given.iter().fold(fit, |fit, (term, values)| {
            let wanted = !fit.model.terms.contains(term);
            wanted.then(|| fit.with(term, values, sines)).flatten().unwrap_or(fit)
        })
    };
    base = with_given(base, &sines);
    let clocks: Vec<Term> =
        run.temperatures.names.iter().filter_map(|n| clock_temperature(&sines, &run.temperatures, n)).collect();
    let mut found: Vec<Found> = Vec::new();
    let mut doubted = false;
    let mut bank;
    loop {
        bank = Bank::new(&base, &sines, &clocks, &found);
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
        let scale = (chosen.chi2 / chosen.dof()).max(1.0);
        let ambiguous: Vec<&Refined> =
            all[1..].iter().filter(|r| r.aicc - best.aicc < 2.0 * APART && r.id() != best.id()).collect();
        found.push(Found {
            term: best.term.clone(),
            p_value: hit.p_value,
            trials: bank.entries.len(),
            corrected: bank.corrected(hit.p_value),
            strength: ((base.chi2 - chosen.chi2) / scale).max(0.0).sqrt(),
            before: base.clone(),
            ambiguous: ambiguous.iter().map(|r| r.id().to_owned()).collect(),
            runners_up: all[1..]
                .iter()
                .map(|r| RunnerUp {
                    effect: r.id().to_owned(),
                    log_ratio: 0.5 * (best.aicc - r.aicc),
                    correlation: Bank::alike(&base, best, r, &sines),
                })
                .collect(),
        });
        base = best.fit.clone();
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
    let (not_identifiable, detection_limits) = limits(&bank, &sines, &steps);
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

/// Diagnoses a table of amplitudes; `id` names it.
#[must_use]
pub fn table(rows: &[Row], id: &str) -> Diagnosis {
    let freq = analysis::from_table(rows, id);
    let part = &freq.parameters.model;
    let mut maps = Vec::new();
    let mut noise_floor_nt = [f64::NAN; 3];
    let mut outlying: Vec<(usize, String)> = Vec::new();
    for (row, amplitude) in rows.iter().enumerate() {
        let parts: Vec<String> = (0..3)
            .filter_map(|i| {
                let model = freq.corner.components[i].model.as_ref()?;
                let is_out = freq.parameters.amplitude[row].detected[i] && model.weight[row] < OUTLIER;
                is_out.then(|| {
                    format!("{} {:.2} instead of {:.2} enT", COMPONENTS[i], amplitude.amplitude_ent[i], model.fitted_ent[row])
                })
            })
            .collect();
        if !parts.is_empty() {
            outlying.push((row, format!("{} Hz ({})", amplitude.frequency_hz, parts.join(", "))));
        }
    }
    let (mut before, mut after) = (Gap::default(), Gap::default());
    for (i, component) in freq.corner.components.iter().enumerate() {
        let Some(model) = &component.model else { continue };
        noise_floor_nt[i] = model.residual_std_ent;
        let of = |keep: &dyn Fn(usize) -> bool| -> Vec<f64> {
            model.residual_ent.iter().enumerate().filter(|(k, r)| r.is_finite() && keep(*k)).map(|(_, r)| *r).collect()
        };
        let (all, kept) = (of(&|_| true), of(&|k| !outlying.iter().any(|(row, _)| *row == k)));
        for (gap, residuals) in [(&mut before, &all), (&mut after, &kept)] {
            let squares = residuals.iter().map(|r| r * r).sum::<f64>();
            gap.rms_nt[i] = (squares / residuals.len().max(1) as f64).sqrt();
            gap.max_nt = residuals.iter().fold(gap.max_nt, |m, r| m.max(r.abs()));
            gap.chi2_per_dof += squares / (3.0 * residuals.len().max(1) as f64 * model.residual_std_ent.powi(2));
        }
        maps.push(Map {
            covariate: "frequency".to_owned(),
            unit: "Hz".to_owned(),
            axis: i,
            x: rows.iter().map(|r| r.frequency_hz).collect(),
            before_nt: model.residual_ent.clone(),
            after_nt: (0..rows.len())
                .map(|k| if outlying.iter().any(|(row, _)| *row == k) { f64::NAN } else { model.residual_ent[k] })
                .collect(),
            noise_nt: model.residual_std_ent,
            step: 0,
        });
    }
    let steps: Vec<Step> = if outlying.is_empty() {
        Vec::new()
    } else {
        let largest = outlying
            .iter()
            .flat_map(|(row, _)| freq.corner.components.iter().filter_map(|c| Some(c.model.as_ref()?.residual_ent[*row])))
            .fold(0.0_f64, |m, r| if r.abs() > m.abs() { r } else { m });
        let floor = noise_floor_nt.iter().copied().fold(f64::INFINITY, f64::min);
        let list: Vec<String> = outlying.iter().map(|(_, words)| words.clone()).collect();
        vec![Step {
            effect: "lost_samples".to_owned(),
            axes: COMPONENTS.map(str::to_owned).to_vec(),
            ambiguous_with: Vec::new(),
            form: outlying
                .iter()
                .fold(Spec::new("outliers", &[]), |spec, (row, _)| spec.with("frequency", rows[*row].frequency_hz, "Hz")),
            further: Vec::new(),
            parameters: vec![Parameter {
                name: "outlying amplitudes".to_owned(),
                value: outlying.len() as f64,
                std: None,
                unit: "1".to_owned(),
            }],
            place: list.join("; "),
            p_value: f64::MIN_POSITIVE,
            trials: rows.len(),
            p_value_corrected: f64::MIN_POSITIVE,
            gap_before: before,
            gap_after: after,
            strength_k: largest.abs() / floor,
            family: named("lost_samples").map_or("", |e| e.about().family.name()),
            wording: "consistent with",
            runners_up: Vec::new(),
            next_measurement: Some("the runs with these amplitudes as waveforms, or these frequencies once more".to_owned()),
            sentence: format!(
                "{} of {} frequencies do not follow the response, as amplitudes of stretches with lost samples or of two settings do not.",
                outlying.len(),
                rows.len()
            ),
            covariate: None,
            shape: Vec::new(),
        }]
    };
    let corners: Vec<String> = (0..3)
        .map(|i| {
            format!(
                "{} {:.2} ± {:.2} Hz",
                COMPONENTS[i], freq.parameters.f_3db_model_hz[i], freq.parameters.f_3db_model_std_hz[i]
            )
        })
        .collect();
    let reason = "a table of amplitudes has neither samples nor times nor uncertainties; what the response leaves is the only measure of noise";
    let not_identifiable = CATALOGUE
        .iter()
        .filter(|e| !["unknown", "lost_samples"].contains(&e.id()))
        .map(|e| NotIdentifiable { effect: e.id().to_owned(), reason: reason.to_owned() })
        .collect();
    let pictures = Pictures { left: if steps.is_empty() { maps.clone() } else { Vec::new() }, ..Pictures::default() };
    Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![id.to_owned()],
        noise_floor_nt,
        noise: None,
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits: Vec::new(),
        response: Some(format!("{}, -3 dB at {}", part.name, corners.join(", "))),
        warnings: freq.parameters.warnings.clone(),
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        pictures,
    }
}

/// The simple response that describes the run best, without any effect.
fn base(freq: &Freq, sines: &mut Sines) -> Result<Fit, String> {
    let simple = |name: &str| Response::named(name).filter(|r| r.freedom() <= SIMPLE);
    let mut order: Vec<(f64, Response, [f64; 3])> = freq
        .corner
        .candidates
        .iter()
        .filter_map(|c| Some((c.aicc?, simple(c.model)?, c.f_3db_hz.map(|f| f.unwrap_or(f64::NAN)))))
        .collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut fits: Vec<(f64, Fit)> =
        order.iter().take(BASES).filter_map(|(_, response, corners)| fitted(*response, *corners, sines)).collect();
    fits.sort_by(|a, b| a.0.total_cmp(&b.0));
    let best = fits.into_iter().next().ok_or("no simple response fits the amplitudes")?.1;
    let shapes = best.model.shapes(&best.p);
    let settings = sines.clone();
    sines.see_begins(|j, i| best.model.triple(&best.p, &shapes, &settings, j, i));
    if !sines.begins_known {
        return Ok(best);
    }
    let known = best.model.fit(&best.p, sines).ok_or("the phases have no fit")?;
    // Where rounded time tags leave the time of the counter open, it is a parameter of the base.
    if sines.tags_are_rounded() {
        known.with(&Term::Shift, &[0.0], sines).ok_or_else(|| "the phases have no fit".to_owned())
    } else {
        Ok(known)
    }
}

/// AICc and fit of a response.
fn fitted(response: Response, corner_hz: [f64; 3], sines: &Sines) -> Option<(f64, Fit)> {
    let model = Model { response, terms: Vec::new() };
    let fits = model.starts(sines, corner_hz).into_iter().filter_map(|start| model.fit(&start, sines));
    let best = fits.min_by(|a, b| a.chi2.total_cmp(&b.chi2))?;
    Some((aicc(best.chi2, best.p.len(), best.residual.len())?, best))
}

/// Where a simple response does not describe the run: another one that does so with an effect, or a rich one without, if it is better than the
/// best so far beyond doubt.
fn another_base(freq: &Freq, best: &Refined, sines: &Sines) -> Option<Fit> {
    let corners: [f64; 3] = std::array::from_fn(|i| freq.parameters.f_3db_igep_hz[i]);
    let known = corners.iter().copied().filter(|c| c.is_finite()).fold(f64::NAN, f64::min);
    let corners = corners.map(|c| if c.is_finite() { c } else { known });
    let all: Vec<(f64, Fit)> = RESPONSES
        .par_iter()
        .filter_map(|response| {
            let (aicc_alone, alone) = fitted(*response, corners, sines)?;
            if response.freedom() > SIMPLE {
                return Some((aicc_alone, alone));
            }
            let with =
                [Term::Pole([true; 3]), Term::Order([true; 3], alone.model.corner_hz(&alone.p))].into_iter().flat_map(|term| {
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
    if sines.begins_known && sines.tags_are_rounded() { other.with(&Term::Shift, &[0.0], sines) } else { Some(other) }
}

/// A candidate with what the base leaves of its columns.
struct Entry {
    term: Term,
    hz: f64,
    /// Columns without what the base takes of them, at right angles and of unit length.
    base: DMatrix<f64>,
    /// Length of the first column after that.
    norm: f64,
}

/// All candidates beside a fit, and the price of trying them.
struct Bank {
    entries: Vec<Entry>,
    /// Independent trials that make as many false alarms.
    independent: f64,
}

/// A candidate by its score.
struct Hit {
    p_value: f64,
}

impl Bank {
    fn new(base: &Fit, sines: &Sines, clocks: &[Term], found: &[Found]) -> Self {
        let mut terms: Vec<(Term, f64)> = Vec::new();
        let new = |id: &str| !found.iter().any(|f| f.term.id() == id) && !base.model.terms.iter().any(|t| t.id() == id);
        let corner_hz = base.model.corner_hz(&base.p);
        for on in [[true; 3], [true, false, false], [false, true, false], [false, false, true]] {
            for k in 0..POLES {
                let hz = FIRST_POLE_HZ * POLE_RATIO.powi(k);
                let poles = [(Term::Pole(on), hz), (Term::Order(on, corner_hz), hz)];
                let tried = |(t, hz): &(Term, f64)| new(t.id()) && (matches!(t, Term::Pole(_)) || *hz >= corner_hz);
                terms.extend(poles.into_iter().filter(tried));
            }
        }
        if new("clock_drift") {
            terms.extend((1..=3).map(|degree| (Term::Clock(degree), 0.0)));
            terms.extend(clocks.iter().map(|t| (t.clone(), 0.0)));
        }
        if sines.begins_known && new("time_shift") {
            terms.push((Term::Shift, 0.0));
        }
        let taken = orthonormal(&base.jacobian, None, ROUNDING);
        let entries: Vec<Entry> = terms
            .into_par_iter()
            .map(|(term, hz)| {
                let columns = DMatrix::from_columns(&base.columns(&term, hz, sines));
                let left = &columns - &taken * taken.tr_mul(&columns);
                let norm = left.column(0).norm();
                Entry { term, hz, base: orthonormal(&left, Some(&columns), ROUNDING), norm }
            })
            .filter(|e| e.base.ncols() > 0)
            .collect();
        let mut bank = Self { entries, independent: 1.0 };
        let rows = base.residual.len();
        let mut least: Vec<f64> = (0..DRAWS)
            .into_par_iter()
            .map(|draw| {
                let mut random = Xoshiro256PlusPlus::seed_from_u64(draw as u64);
                let noise = DVector::from_fn(rows, |_, _| StandardNormal.sample(&mut random));
                let left = &noise - &taken * taken.tr_mul(&noise);
                let dof = base.dof();
                // The largest of equally many columns has the least probability.
                let mut largest = [0.0_f64; 4];
                bank.entries
                    .iter()
                    .for_each(|e| largest[e.base.ncols().min(3)] = largest[e.base.ncols().min(3)].max(e.drop(&left)));
                let squares = left.norm_squared();
                (1..=3).map(|count| tail(largest[count], count as f64, squares, dof)).fold(1.0, f64::min)
            })
            .collect();
        least.sort_by(f64::total_cmp);
        let at = (FALSE_ALARM * DRAWS as f64) as usize;
        bank.independent = (FALSE_ALARM / least[at].max(f64::MIN_POSITIVE)).max(1.0);
        bank
    }

    fn best(&self, base: &Fit) -> Option<Hit> {
        let all = self.entries.iter().map(|e| e.p_value(&base.residual, base.dof()));
        all.min_by(f64::total_cmp).map(|p_value| Hit { p_value })
    }

    /// Probability that noise alone gives any candidate as small a probability.
    fn corrected(&self, p_value: f64) -> f64 {
        (-(self.independent * (-p_value).ln_1p()).exp_m1()).max(p_value).clamp(f64::MIN_POSITIVE, 1.0)
    }

    /// How much two fitted candidates look alike beside the base.
    fn alike(base: &Fit, a: &Refined, b: &Refined, sines: &Sines) -> f64 {
        let change = |r: &Refined| {
            let taken = orthonormal(&base.jacobian, None, ROUNDING);
            let values = &r.fit.p[base.p.len()..];
            let hz = values.get(1).map_or(0.0, |l| l.exp());
            let columns = base.columns(&r.term, hz, sines);
            let sum = columns.iter().zip(values).fold(DVector::zeros(base.residual.len()), |s, (c, v)| s + c * *v);
            let left = &sum - &taken * taken.tr_mul(&sum);
            left.normalize()
        };
        change(a).dot(&change(b)).abs()
    }
}

impl Entry {
    /// Decrease of chi-square with it.
    fn drop(&self, residual: &DVector<f64>) -> f64 {
        self.base.tr_mul(residual).norm_squared()
    }

    fn p_value(&self, residual: &DVector<f64>, dof: f64) -> f64 {
        tail(self.drop(residual), self.base.ncols() as f64, residual.norm_squared(), dof)
    }
}

/// Probability that noise alone decreases its squares as much by so many columns.
fn tail(drop: f64, count: f64, squares: f64, dof: f64) -> f64 {
    let f = drop / count / ((squares - drop).max(f64::MIN_POSITIVE) / (dof - count));
    FisherSnedecor::new(count, dof - count).map_or(1.0, |d| d.sf(f)).max(f64::MIN_POSITIVE)
}

/// A candidate that was fitted with everything else.
struct Refined {
    term: Term,
    fit: Fit,
    /// In units of the noise that the best of them leaves.
    aicc: f64,
}

impl Refined {
    fn id(&self) -> &'static str {
        self.term.id()
    }
}

/// The best form of every effect, fitted with all parameters, best effect first.
fn refined(base: &Fit, bank: &Bank, sines: &Sines) -> Vec<Refined> {
    let ids = ["eddy_current_attenuation", "response_order", "clock_drift", "time_shift"];
    let strong = base.chi2 > DOUBTFUL * base.dof();
    let mut all: Vec<Refined> = ids
        .par_iter()
        .flat_map_iter(|id| {
            let mut own: Vec<(f64, &Entry)> =
                bank.entries.iter().filter(|e| e.term.id() == *id).map(|e| (e.p_value(&base.residual, base.dof()), e)).collect();
            own.sort_by(|a, b| a.0.total_cmp(&b.0));
            let fits = own.iter().take(3).flat_map(move |(_, entry)| {
                let mut starts: Vec<Vec<f64>> = vec![vec![0.0; entry.term.count()]];
                if entry.hz > 0.0 {
                    let column = &base.columns(&entry.term, entry.hz, sines)[0];
                    let size = entry.base.column(0).dot(&base.residual) / entry.base.column(0).dot(column);
                    starts[0] = vec![size.clamp(-0.9, 1.2), entry.hz.ln()];
                    if strong {
                        starts.extend([60.0_f64, 200.0, 800.0, 3000.0].map(|hz| vec![1.0, hz.ln()]));
                    }
                }
                starts
                    .into_iter()
                    .filter_map(|s| Some((entry.term.clone(), base.with(&entry.term, &s, sines)?)))
                    .collect::<Vec<_>>()
            });
            // A hundredth of a sample is the delay of a response and no displacement of time tags.
            let told =
                |term: &Term, fit: &Fit| *term != Term::Shift || 1e-6 * fit.p[base.p.len()].abs() > LEAST_SHIFT / sines.rate_hz;
            let fits = fits.filter(|(term, fit)| told(term, fit));
            let scored = fits.filter_map(|(term, fit)| Some((aicc(fit.chi2, fit.p.len(), fit.residual.len())?, term, fit)));
            let best = scored.min_by(|a, b| a.0.total_cmp(&b.0));
            best.map(|(aicc, term, fit)| Refined { term, fit, aicc }).into_iter()
        })
        .collect();
    let scale = all.iter().map(|r| r.fit.chi2 / r.fit.dof()).fold(f64::INFINITY, f64::min).max(1.0);
    for r in &mut all {
        r.aicc = aicc(r.fit.chi2 / scale, r.fit.p.len(), r.fit.residual.len()).unwrap_or(f64::INFINITY);
    }
    all.sort_by(|a, b| a.aicc.total_cmp(&b.aicc));
    all
}

/// An effect that was accepted.
struct Found {
    term: Term,
    p_value: f64,
    trials: usize,
    corrected: f64,
    strength: f64,
    before: Fit,
    ambiguous: Vec<String>,
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
    let id = found.term.id();
    let timing = matches!(found.term, Term::Clock(_) | Term::ClockTemperature(..) | Term::Shift);
    let axes = found.term.axes();
    let mut form = Spec::new("", &axes);
    let mut parameters = Vec::new();
    let mut push = |name: String, value: f64, std: Option<f64>, unit: &str| {
        parameters.push(Parameter { name, value, std, unit: unit.to_owned() });
    };
    match &found.term {
        Term::Pole(_) | Term::Order(..) => {
            form.form = if id == "response_order" { "two poles in part" } else { "pole in part" }.to_owned();
            let hz = values[1].exp();
            form = form.with("f_c", hz, "Hz");
            push("part".to_owned(), values[0], std(0), "1");
            push("f_c".to_owned(), hz, std(1).map(|s| s * hz), "Hz");
            let correlation = covariance.as_ref().map(|c| {
                let of = |a: usize, b: usize| c[(begin + a, begin + b)];
                of(0, 1) / (of(0, 0) * of(1, 1)).sqrt()
            });
            push(CORRELATION.to_owned(), correlation.filter(|r| r.is_finite()).unwrap_or(0.0), None, "1");
        }
        Term::Clock(degree) => {
            form.form = format!("{IN_TIME}{degree}");
            for (n, c) in values.iter().enumerate() {
                let unit = sines.rate_hz * 1e-6 / sines.length_s.powi(n as i32 + 1);
                let name = if n == 0 { "Hz/s".to_owned() } else { format!("Hz/s^{}", n + 1) };
                push(format!("drift_{}", n + 1), c * unit, std(n).map(|s| s * unit), &name);
            }
        }
        Term::ClockTemperature(channel, _) => {
            form.form = format!("{WITH_TEMPERATURE}{channel}");
            let unit = 1e-6 * sines.rate_hz;
            push("drift".to_owned(), values[0] * unit, std(0).map(|s| s * unit), "Hz/K");
        }
        Term::Shift => {
            form.form = DELAY.to_owned();
            push("shift".to_owned(), 1e-6 * values[0], std(0).map(|s| 1e-6 * s), "s");
        }
    }
    let before = found.before.held_out(sines, STRETCH);
    let without: Vec<f64> = fit.p[..begin].iter().chain(&fit.p[begin + found.term.count()..]).copied().collect();
    let mut model = fit.model.clone();
    model.terms.remove(k);
    // The gap is that of this effect alone: with all that was found beside it.
    let before = model.fit(&without, sines).map_or(before, |f| f.held_out(sines, STRETCH));
    let after = fit.held_out(sines, STRETCH);
    let (gap_before, gap_after) = (gap(sines, &before, without.len(), timing), gap(sines, &after, fit.p.len(), timing));
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
        effect: id.to_owned(),
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
        family: named(id).map_or("", |e| e.about().family.name()),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: found.runners_up.clone(),
        next_measurement: words::next_measurement(id, &found.ambiguous),
        sentence: String::new(),
        covariate: None,
        shape: Vec::new(),
    };
    step.sentence = words::sentence(&step);
    step
}

/// Settings with missing samples, or with stretches that do not follow their sine.
fn lost(run: &Run, samples: &Samples, freq: &Freq) -> Option<Step> {
    let mut damaged: Vec<(usize, String)> = Vec::new();
    let mut missing = 0;
    let rate_hz = freq.parameters.mean_f_s_hz.unwrap_or(run.header.sample_rate_hz);
    for (k, part) in freq.stretches.iter().enumerate() {
        let setting = &part.setting;
        let from = samples.t_s.partition_point(|t| *t < setting.t_start_s);
        let to = samples.t_s.partition_point(|t| *t < setting.t_end_s);
        let gaps: Vec<String> = (from + 1..to)
            .filter(|i| samples.n[*i] > samples.n[i - 1] + 1)
            .map(|i| {
                let lost = samples.n[i] - samples.n[i - 1] - 1;
                missing += lost;
                format!("{lost} samples missing at {:.1} s", samples.t_s[i - 1])
            })
            .collect();
        let length_s = setting.t_end_s - setting.t_start_s;
        let mut words = gaps;
        match part.used_s {
            // The begin of the used stretch holds the settling, at most a second.
            Some(used_s)
                if length_s - (used_s[1] - used_s[0]) > DAMAGED_PART * length_s + 1.0
                    && !follows(samples, from..to, used_s, setting.frequency_hz, rate_hz) =>
            {
                let [first, last] = used_s;
                words.push(format!("only {first:.1} to {last:.1} s follow one sine"));
            }
            None if length_s * setting.frequency_hz >= 2.0 => {
                let remark = freq.parameters.amplitude.get(k).map_or("", |a| a.remark.as_str());
                words.push(remark.to_owned());
            }
            _ => {}
        }
        if !words.is_empty() {
            damaged.push((k, format!("{} Hz: {}", setting.frequency_hz, words.join(", "))));
        }
    }
    if damaged.is_empty() {
        return None;
    }
    let list: Vec<String> = damaged.iter().map(|(_, words)| words.clone()).collect();
    let form = damaged
        .iter()
        .fold(Spec::new("stretches", &[]), |spec, (k, _)| spec.with("frequency", freq.stretches[*k].setting.frequency_hz, "Hz"));
    let count = |name: &str, value: f64| Parameter { name: name.to_owned(), value, std: None, unit: "1".to_owned() };
    Some(Step {
        effect: "lost_samples".to_owned(),
        axes: COMPONENTS.map(str::to_owned).to_vec(),
        ambiguous_with: Vec::new(),
        form,
        further: Vec::new(),
        parameters: vec![count("damaged settings", damaged.len() as f64), count("missing samples", missing as f64)],
        place: list.join("; "),
        p_value: f64::MIN_POSITIVE,
        trials: freq.stretches.len(),
        p_value_corrected: f64::MIN_POSITIVE,
        gap_before: Gap::default(),
        gap_after: Gap::default(),
        // Every one of them is seen by itself.
        strength_k: CERTAIN + damaged.len() as f64,
        family: named("lost_samples").map_or("", |e| e.about().family.name()),
        wording: "is",
        runners_up: Vec::new(),
        next_measurement: None,
        sentence: format!(
            "In {} of {} settings of run {} stretches are missing or do not follow their sine; amplitudes and phases rest on the rest.",
            damaged.len(),
            freq.stretches.len(),
            run.header.run
        ),
        covariate: None,
        shape: Vec::new(),
    })
}

/// Whether most of what a setting has beside its used stretch follows the sine of that: then single readings are far off, and nothing is
/// missing.
fn follows(samples: &Samples, setting: Range<usize>, used_s: [f64; 2], frequency_hz: f64, rate_hz: f64) -> bool {
    let is_used = |i: &usize| (used_s[0]..=used_s[1]).contains(&samples.t_s[*i]);
    let used: Vec<usize> = setting.clone().filter(is_used).collect();
    let others: Vec<usize> = setting.filter(|i| !is_used(i)).collect();
    (0..3).all(|component| {
        let readings = |of: &[usize]| -> Vec<f64> { of.iter().map(|i| samples.reading_ent[*i][component]).collect() };
        let counters: Vec<u64> = used.iter().map(|i| samples.n[*i]).collect();
        let Ok(fit) = sine::three(&counters, &readings(&used), frequency_hz, rate_hz) else { return false };
        let mut oscillator = Oscillator::new(frequency_hz, rate_hz);
        let mut off: Vec<f64> = others
            .iter()
            .zip(readings(&others))
            .map(|(i, y)| {
                let [sin, cos] = oscillator.at(samples.n[*i]);
                (y - fit.offset - fit.sin * sin - fit.cos * cos).abs()
            })
            .collect();
        let mut own: Vec<f64> = fit.residuals.iter().map(|r| r.abs()).collect();
        !off.is_empty() && median(&mut off) < FOLLOWS * median(&mut own)
    })
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
fn limits(bank: &Bank, sines: &Sines, steps: &[Step]) -> (Vec<NotIdentifiable>, Vec<DetectionLimit>) {
    let found = |id: &str| steps.iter().any(|s| s.effect == id);
    let reason = |id: &str| -> Option<&'static str> {
        match id {
            "unknown" | "lost_samples" | "bad_thermistor" | "eddy_current_attenuation" | "response_order" | "clock_drift" => None,
            "time_shift" if sines.begins_known && sines.tags_are_rounded() => {
                Some("the time tags are rounded: a shift of all samples against the settings is fitted and not judged")
            }
            "time_shift" if sines.begins_known => None,
            "time_shift" => Some("the phase of the field at the begin of a setting is not known"),
            "offset_drift" | "offset_step" | "sensor_temperature_offset" | "earthfield_leakage" => {
                Some("every setting has an offset of its own beside its sine")
            }
            "interference_tone" | "heater_pwm" => {
                Some("beside a sine only noise near its frequency is looked at; a run in zero field shows it")
            }
            _ => Some("one field direction with one amplitude: it is part of the amplitude"),
        }
    };
    let none = CATALOGUE
        .iter()
        .filter(|e| !found(e.id()))
        .filter_map(|e| Some(NotIdentifiable { effect: e.id().to_owned(), reason: reason(e.id())?.to_owned() }))
        .collect();
    let mut limits = Vec::new();
    for id in ["eddy_current_attenuation", "response_order", "clock_drift", "time_shift"] {
        if found(id) {
            continue;
        }
        let is_one =
            |e: &&Entry| e.term.axes().len() == 3 && e.base.ncols() == 1 && !matches!(e.term, Term::ClockTemperature(..));
        let own = bank.entries.iter().filter(|e| e.term.id() == id).filter(is_one);
        let Some(best) = own.max_by(|a, b| a.norm.total_cmp(&b.norm)) else { continue };
        let least = FOUND_90 / best.norm;
        let (parameter, timing) = match &best.term {
            Term::Clock(_) | Term::ClockTemperature(..) => {
                (format!("drift = {:.2e} Hz/s", least * 1e-6 * sines.rate_hz / sines.length_s), true)
            }
            Term::Shift => (format!("shift = {:.2e} s", 1e-6 * least), true),
            _ => (format!("part = {least:.2e} at f_c = {:.0} Hz", best.hz), false),
        };
        let noise = |s: &sines::SineOf| s.tones[0].std[usize::from(timing)] * s.tones[0].log_amplitude.exp();
        let noise_nt = median(&mut sines.list.iter().map(noise).collect::<Vec<f64>>());
        limits.push(DetectionLimit {
            effect: id.to_owned(),
            axis: "x, y, z".to_owned(),
            // Of a part that is spread over all settings as the noise is.
            amplitude_nt: FOUND_90 * noise_nt / (sines.list.len() as f64).sqrt(),
            parameter,
        });
    }
    (none, limits)
}
