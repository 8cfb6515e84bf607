//! What happens inside the plateaus: displaced edges, transients after steps, periodic signals.

mod periodic;

use crate::fit::statistics::{median, two_sided_tail};
use crate::model::effects::in_samples::{self, InSamples};
use crate::model::effects::time_shift::{self, TimeShift};
use crate::model::effects::{Catalogue, EffectRef, Record, Row, Spec};
use crate::record::scene::{Samples, Scene};
use nalgebra::{DMatrix, DVector, Matrix2};
pub use periodic::periodic;
use rayon::prelude::*;

/// Probability that noise alone shows as much.
const SIGNIFICANT: f64 = 0.001;
/// A step of this many standard deviations of the samples shows where its edge is.
const CLEAR_STEP: f64 = 100.0;
/// Longest displacement that is looked for, s, and as a part of the shorter neighbour.
const MOST_SHIFT_S: f64 = 1.0;
/// Displacements are looked for again around the last one at most so often.
const MOST_ROUNDS: usize = 4;
/// Least displacement, in samples: data that are late by a part of a sample are what the low-pass of every sensor makes of an edge.
const LEAST_EARLY: f64 = 0.1;
const LEAST_LATE: f64 = 1.0;
/// Normal noise is within so many standard deviations in nine of ten cases.
const NORMAL_90: f64 = 1.644_853_626_951_472_2;
/// Samples whose columns are made at once.
const AT_ONCE: usize = 1 << 11;
/// Step of the derivative by the logarithm of a time constant.
const TAU_STEP: f64 = 0.01;

/// Something found in the samples.
#[derive(Clone, Debug)]
pub struct Inside {
    /// Effect.
    pub effect: EffectRef,
    /// Form and shape.
    pub spec: Spec,
    /// Values and standard uncertainties of the parameters, enT per unit column.
    pub values: Vec<(f64, f64)>,
    /// Standard uncertainty of the shape parameters that have one.
    pub shape_std: Vec<(String, f64)>,
    /// Signal to noise ratio.
    pub strength: f64,
    /// Probability that noise alone gives as much for this candidate.
    pub p_value: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// Other effects that the samples cannot tell from it.
    pub ambiguous_with: Vec<EffectRef>,
    /// Squares of what is left of the used samples around their plateaus before and after, over the noise, and their number.
    pub squares: [f64; 3],
    /// Root mean square of the samples of the axes before and after, enT.
    pub rms_ent: [[f64; 3]; 2],
}

impl Inside {
    /// An effect that is known from elsewhere.
    #[must_use]
    pub fn known(given: &crate::record::known::Given) -> Self {
        Inside {
            effect: given.effect,
            spec: given.spec.clone(),
            values: given.values.iter().map(|v| (*v, 0.0)).collect(),
            shape_std: Vec::new(),
            strength: 0.0,
            p_value: 1.0,
            trials: 0,
            ambiguous_with: Vec::new(),
            squares: [0.0; 3],
            rms_ent: [[0.0; 3]; 2],
        }
    }
}

/// Standard deviation of the samples of each component inside the plateaus, from differences of neighbours.
fn sample_std(samples: &Samples, windows: &[[usize; 2]]) -> [f64; 3] {
    let mut sums = [0.0; 3];
    let mut count = 0.0;
    for [from, to] in windows {
        for pair in samples.reading_ent[*from..*to].windows(2) {
            for a in 0..3 {
                sums[a] += (pair[1][a] - pair[0][a]).powi(2);
            }
            count += 1.0;
        }
    }
    sums.map(|s| (s / (2.0 * f64::max(count, 1.0))).sqrt())
}

/// The same from the ninetieth percentile of the differences, which edges inside the plateaus do not move; zero where most readings repeat.
fn quiet_std(samples: &Samples, windows: &[[usize; 2]]) -> [f64; 3] {
    [0, 1, 2].map(|a| {
        let pairs = windows.iter().flat_map(|[from, to]| samples.reading_ent[*from..*to].windows(2));
        let mut sizes: Vec<f64> = pairs.map(|pair| (pair[1][a] - pair[0][a]).abs()).collect();
        let place = sizes.len() * 9 / 10;
        if place >= sizes.len() {
            return 0.0;
        }
        *sizes.select_nth_unstable_by(place, f64::total_cmp).1 / (NORMAL_90 * std::f64::consts::SQRT_2)
    })
}

/// Time between samples, s.
fn interval_s(samples: &Samples) -> Option<f64> {
    let t_s = &samples.t_s;
    let mut gaps: Vec<f64> = t_s.windows(2).map(|w| w[1] - w[0]).take(1001).collect();
    if gaps.is_empty() {
        return None;
    }
    let usual = median(&mut gaps);
    // The mean over the record is exact where no samples are missing.
    let mean = (t_s[t_s.len() - 1] - t_s[0]) / (t_s.len() - 1) as f64;
    Some(if (mean / usual - 1.0).abs() < 0.01 { mean } else { usual }).filter(|dt| *dt > 0.0)
}

/// Displacement of every clear edge, s, looked for around a displacement that is known roughly.
fn edges_around(scene: &Scene, samples: &Samples, std: [f64; 3], dt: f64, around_s: f64) -> Vec<f64> {
    let steps = &scene.record.steps;
    let mut shifts = Vec::new();
    for (i, step) in steps.iter().enumerate() {
        let axis = (0..3).max_by(|a, b| step.change_ent[*a].abs().total_cmp(&step.change_ent[*b].abs())).unwrap_or(0);
        let change = step.change_ent[axis];
        let before = i.checked_sub(1).map_or(f64::INFINITY, |k| step.t_s - steps[k].t_s);
        let after = steps.get(i + 1).map_or(f64::INFINITY, |s| s.t_s - step.t_s);
        let half = (0.45 * before.min(after)).min(MOST_SHIFT_S);
        if change.abs() < CLEAR_STEP * std[axis] || half < 4.0 * dt {
            continue;
        }
        let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
        let edge_s = step.t_s + around_s;
        let (from, middle, to) = (at(edge_s - half), at(edge_s), at(edge_s + half));
        if middle < from + 3 || to < middle + 3 {
            continue;
        }
        // The levels on both sides come from the samples themselves, away from the edge.
        let third = ((middle - from) / 3).max(1).min((to - middle) / 3).max(1);
        let mean = |r: std::ops::Range<usize>| {
            let n = r.len() as f64;
            samples.reading_ent[r].iter().map(|v| v[axis]).sum::<f64>() / n
        };
        let (low, high) = (mean(from..from + third), mean(to - third..to));
        if (high - low - change).abs() > 0.3 * change.abs() {
            continue;
        }
        let sum: f64 =
            (from..to).map(|k| (high - samples.reading_ent[k][axis]) / (high - low) - if k < middle { 1.0 } else { 0.0 }).sum();
        shifts.push((sum + middle as f64 - at(step.t_s) as f64) * dt);
    }
    shifts.sort_by(f64::total_cmp);
    shifts
}

/// Whether data and settings step at different times.
#[must_use]
pub fn displaced(scene: &Scene, samples: &Samples) -> Option<Inside> {
    let std = quiet_std(samples, &scene.windows);
    let dt = interval_s(samples)?;
    let mut shifts = edges_around(scene, samples, std, dt, 0.0);
    // An edge far off stands in the stretches that tell the levels: once more around where it was seen.
    for _ in 0..MOST_ROUNDS {
        let around_s = *shifts.get(shifts.len() / 2)?;
        let closer = edges_around(scene, samples, std, dt, around_s);
        if closer.len() < shifts.len() / 2 {
            break;
        }
        shifts = closer;
        if (shifts[shifts.len() / 2] - around_s).abs() < 0.5 * dt {
            break;
        }
    }
    if shifts.len() < 6 {
        return None;
    }
    let shift_s = shifts[shifts.len() / 2];
    let spread = 1.4826 * {
        let mut away: Vec<f64> = shifts.iter().map(|s| (s - shift_s).abs()).collect();
        away.sort_by(f64::total_cmp);
        away[away.len() / 2]
    };
    // A displacement is only known to the sample where all edges agree.
    let std_s = (1.25 * spread / (shifts.len() as f64).sqrt()).max(0.29 * dt / (shifts.len() as f64).sqrt());
    let same = shifts.iter().filter(|s| s.signum() == shift_s.signum() && s.abs() > 0.3 * shift_s.abs()).count();
    let agrees = same as f64 > 0.8 * shifts.len() as f64;
    let least = if shift_s > 0.0 { LEAST_LATE } else { LEAST_EARLY };
    (shift_s.abs() > least * dt && shift_s.abs() > 6.0 * std_s && agrees).then(|| Inside {
        effect: EffectRef::new(&TimeShift),
        spec: time_shift::edges(shift_s),
        values: vec![(1.0, std_s / shift_s.abs())],
        shape_std: vec![(time_shift::SHIFT.to_owned(), std_s)],
        strength: shift_s.abs() / std_s,
        p_value: (-0.5 * (shift_s / std_s).powi(2)).exp().max(f64::MIN_POSITIVE),
        trials: 1,
        ambiguous_with: Vec::new(),
        squares: [0.0; 3],
        rms_ent: [[0.0; 3]; 2],
    })
}

/// Phases of a plateau for the stack: ends of bins in samples after its begin, closer where transients are fast.
pub(super) fn phases(samples: usize) -> Vec<usize> {
    let mut edges = vec![0usize];
    let mut width = 1usize;
    while edges[edges.len() - 1] + width <= samples {
        let last = edges[edges.len() - 1] + width;
        edges.push(last);
        if edges.len() % 2 == 0 {
            width = (width * 3).div_ceil(2);
        }
    }
    edges
}

/// Chi square, time constant, axes, amplitudes with uncertainties.
type Transient = (f64, f64, Vec<usize>, Vec<(f64, f64)>);

/// The clearest transient of all effects of a catalogue that make some.
#[must_use]
pub fn transient(scene: &Scene, samples: &Samples, settings: &[[f64; 2]], skip_s: f64, catalogue: &Catalogue) -> Option<Inside> {
    let of_effect = |effect: EffectRef| match effect.in_samples()? {
        InSamples::Transient(form) => transient_of(effect, form, scene, samples, settings, skip_s),
        _ => None,
    };
    catalogue.iter().filter_map(of_effect).max_by(|a, b| a.strength.total_cmp(&b.strength))
}

/// Whether a transient follows the steps: means over the phases of all settings, weighted with how they scatter between the settings. A sample
/// beside an edge, nearer than `skip_s` or the next one, does not count: the low-pass of every sensor shows in it.
fn transient_of(
    effect: EffectRef,
    form: in_samples::Transient,
    scene: &Scene,
    samples: &Samples,
    settings: &[[f64; 2]],
    skip_s: f64,
) -> Option<Inside> {
    let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
    let dt_s = interval_s(samples)?;
    let skip_s = skip_s.max(dt_s);
    let windows: Vec<[usize; 2]> = settings.iter().map(|[b, e]| [at(b + skip_s), at(e - skip_s)]).collect();
    let shortest = windows.iter().map(|w| w[1].saturating_sub(w[0])).min()?;
    let edges = phases(shortest);
    let bins = edges.len() - 1;
    let m = windows.len();
    if bins < 4 || m < 3 * bins {
        return None;
    }
    // One row per axis and plateau: means of the bins less that of the plateau.
    let rows = |mean_of: &(dyn Fn([usize; 2]) -> [f64; 3] + Sync)| -> [Vec<DVector<f64>>; 3] {
        let of_plateau = |w: &[usize; 2]| -> [DVector<f64>; 3] {
            let all = mean_of([w[0], w[0] + edges[bins]]);
            let each: Vec<[f64; 3]> = edges.windows(2).map(|e| mean_of([w[0] + e[0], w[0] + e[1]])).collect();
            [0, 1, 2].map(|a: usize| DVector::from_fn(bins, |k, _| each[k][a] - all[a]))
        };
        let plateaus: Vec<[DVector<f64>; 3]> = windows.par_iter().map(of_plateau).collect();
        let mut axes: [Vec<DVector<f64>>; 3] = Default::default();
        plateaus.into_iter().for_each(|plateau| axes.iter_mut().zip(plateau).for_each(|(axis, row)| axis.push(row)));
        axes
    };
    let data = rows(&|[from, to]| {
        let sum = |a: usize| samples.reading_ent[from..to].iter().map(|v| v[a]).sum::<f64>();
        [0, 1, 2].map(|a| sum(a) / (to - from) as f64)
    });
    // Settings with more noise count for less.
    let weights: [Vec<f64>; 3] = [0, 1, 2].map(|a: usize| {
        let sizes: Vec<f64> = data[a].iter().map(|d| d.norm_squared()).collect();
        let usual = median(&mut sizes.clone()).max(f64::MIN_POSITIVE);
        sizes.iter().map(|s| (2.0 * usual / (usual + s)).sqrt()).collect()
    });
    let mut best: Option<Transient> = None;
    let template = |tau: f64| {
        rows(&|[from, to]| {
            let ends_s = [samples.t_s[from], samples.t_s[to - 1]];
            (form.mean)(&scene.record.steps, ends_s, dt_s, tau).map(|v| -v)
        })
    };
    let inverse_scatter = |a: usize, template: &[DVector<f64>], amplitude: f64| -> Option<DMatrix<f64>> {
        let mut scatter = DMatrix::zeros(bins, bins);
        for ((d, t), w) in data[a].iter().zip(template).zip(&weights[a]) {
            let r = (d - t * amplitude) * *w;
            scatter += &r * r.transpose();
        }
        scatter /= m as f64;
        // The bins of a plateau sum to nothing: a little on the diagonal keeps the inverse.
        let ridge = 1e-3 * scatter.trace() / bins as f64;
        (0..bins).for_each(|k| scatter[(k, k)] += ridge);
        Some(scatter.cholesky()?.inverse())
    };
    let fit = |a: usize, template: &[DVector<f64>]| -> Option<(f64, f64)> {
        // Amplitude, then scatter about it, then amplitude.
        let mut amplitude = 0.0;
        let mut information = 0.0;
        for _ in 0..3 {
            let inverse = inverse_scatter(a, template, amplitude)?;
            let (mut top, mut bottom) = (0.0, 0.0);
            for ((d, t), w) in data[a].iter().zip(template).zip(&weights[a]) {
                let weighted = &inverse * t * (w * w);
                top += weighted.dot(d);
                bottom += weighted.dot(t);
            }
            amplitude = top / bottom;
            information = bottom * (m - bins - 1) as f64 / m as f64;
        }
        (information > 0.0).then(|| (amplitude, information.sqrt().recip()))
    };
    let consider = |tau: f64, best: &mut Option<Transient>| {
        let template = template(tau);
        let each: Vec<Option<(f64, f64)>> = (0..3).map(|a| fit(a, &template[a])).collect();
        let known: Vec<(usize, f64, f64)> = each.iter().enumerate().filter_map(|(a, f)| f.map(|(v, s)| (a, v, s))).collect();
        let weight: f64 = known.iter().map(|(_, _, s)| s.powi(-2)).sum();
        if known.len() == 3 {
            let common = known.iter().map(|(_, v, s)| v / (s * s)).sum::<f64>() / weight;
            let chi = common * common * weight;
            if best.as_ref().is_none_or(|b| chi > b.0) {
                *best = Some((chi, tau, vec![0, 1, 2], vec![(common, weight.sqrt().recip())]));
            }
        }
        for (a, v, s) in known {
            // A single axis needs to be much better: currents in a housing act on all.
            let chi = (v / s).powi(2) - 6.0;
            if best.as_ref().is_none_or(|b| chi > b.0) {
                *best = Some((chi, tau, vec![a], vec![(v, s)]));
            }
        }
    };
    let longest = settings.iter().map(|[b, e]| e - b).fold(f64::INFINITY, f64::min);
    let taus: Vec<f64> = form.taus_s.iter().copied().filter(|t| *t < longest).collect();
    for tau in &taus {
        consider(*tau, &mut best);
    }
    let trials = 4 * taus.len();
    let (chi, tau, ..) = best.clone()?;
    // Scatter of few plateaus has tails: the t distribution, by Bartlett's formula the other way round.
    let dof = (m - bins - 1) as f64;
    let effective = dof * (1.0 + chi.max(0.0) / dof).ln();
    let p_value = two_sided_tail(effective.max(0.0).sqrt()).max(f64::MIN_POSITIVE);
    if p_value * trials as f64 > SIGNIFICANT {
        return None;
    }
    let mut finer = best.clone();
    for step in [0.25, 0.12, 0.06, 0.03, 0.015] {
        let now = finer.as_ref().map_or(tau, |b| b.1);
        for factor in [1.0 - step, 1.0 + step] {
            consider(now * factor, &mut finer);
        }
    }
    let (chi, tau, axes, mut values) = finer?;
    // Amplitude and time constant go together: the information on both.
    let amplitude = values[0].0;
    let (now, later, sooner) = (template(tau), template(tau * (1.0 + TAU_STEP)), template(tau * (1.0 - TAU_STEP)));
    let mut information = Matrix2::zeros();
    for &a in &axes {
        let Some(inverse) = inverse_scatter(a, &now[a], amplitude) else { continue };
        for (((now, later), sooner), w) in now[a].iter().zip(&later[a]).zip(&sooner[a]).zip(&weights[a]) {
            let slope = (later - sooner) * (amplitude / (2.0 * TAU_STEP));
            let both = DMatrix::from_columns(&[now.clone(), slope]);
            information +=
                (both.transpose() * &inverse * &both * (w * w * (m - bins - 1) as f64 / m as f64)).fixed_view::<2, 2>(0, 0);
        }
    }
    let std = information.try_inverse().map(|c| [c[(0, 0)].sqrt(), tau * c[(1, 1)].sqrt()]);
    if let Some([of_amplitude, _]) = std {
        values[0].1 = of_amplitude;
    }
    Some(Inside {
        effect,
        spec: (form.term)(&axes, tau),
        values,
        shape_std: std.map(|s| (form.time_constant.to_owned(), s[1])).into_iter().collect(),
        strength: chi.max(0.0).sqrt(),
        p_value,
        trials,
        ambiguous_with: Vec::new(),
        squares: [0.0; 3],
        rms_ent: [[0.0; 3]; 2],
    })
}

/// Squares and scatter of the samples of whole settings around their means, without and with what was found before.
pub fn measure(scene: &Scene, samples: &Samples, settings: &[[f64; 2]], known: &[Inside], found: &mut Inside) {
    let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
    let windows: Vec<[usize; 2]> = settings.iter().map(|[b, e]| [at(*b), at(*e)]).collect();
    let noise = sample_std(samples, &scene.windows);
    let count: usize = windows.iter().map(|w| w[1].saturating_sub(w[0])).sum();
    let mut residual: [Vec<f64>; 3] = [0, 1, 2].map(|a| samples.reading_ent.iter().map(|r| r[a]).collect());
    for signal in known {
        remove_raw(&mut residual, &scene.record, samples, &windows, signal);
    }
    demean(&mut residual, &windows);
    found.rms_ent[0] = rms(&residual, &windows);
    remove(&mut residual, &scene.record, samples, &windows, found);
    found.rms_ent[1] = rms(&residual, &windows);
    let chi = |rms: [f64; 3]| (0..3).map(|a| (rms[a] / noise[a].max(f64::MIN_POSITIVE)).powi(2) * count as f64).sum::<f64>();
    found.squares = [chi(found.rms_ent[0]), chi(found.rms_ent[1]), 3.0 * count as f64];
}

pub(super) fn demean(residual: &mut [Vec<f64>; 3], windows: &[[usize; 2]]) {
    residual.par_iter_mut().for_each(|values| {
        for [from, to] in windows {
            let part = &mut values[*from..*to];
            let mean = part.iter().sum::<f64>() / part.len().max(1) as f64;
            part.iter_mut().for_each(|v| *v -= mean);
        }
    });
}

/// Takes a signal off the samples of the windows.
pub(super) fn remove_raw(
    residual: &mut [Vec<f64>; 3],
    record: &Record,
    samples: &Samples,
    windows: &[[usize; 2]],
    signal: &Inside,
) {
    // Times and steps only.
    let bare = Record {
        rows: Vec::new(),
        sensor: None,
        coil: None,
        rack: None,
        variometer: None,
        thermistors: Vec::new(),
        others: Vec::new(),
        ..record.clone()
    };
    let row = |k: usize| Row {
        run: 0,
        used_s: [samples.t_s[k]; 2],
        field_coil_nt: [0.0; 3],
        previous_coil_nt: [0.0; 3],
        linear_ent: [0.0; 3],
    };
    let parts: Vec<[usize; 2]> = windows
        .iter()
        .flat_map(|[from, to]| (*from..*to).step_by(AT_ONCE).map(|begin| [begin, (begin + AT_ONCE).min(*to)]))
        .collect();
    let contributions: Vec<Option<Vec<[f64; 3]>>> = parts
        .par_iter()
        .map(|[from, to]| {
            let record = Record { rows: (*from..*to).map(row).collect(), ..bare.clone() };
            let columns = signal.effect.columns(&record, &signal.spec)?;
            let of_row = |row: usize| {
                let sum = |a: usize| columns.iter().zip(&signal.values).map(|(c, (value, _))| value * c.values[row][a]).sum();
                [0, 1, 2].map(sum)
            };
            Some((0..to - from).map(of_row).collect())
        })
        .collect();
    for ([from, _], own) in parts.iter().zip(&contributions) {
        for (k, contribution) in own.iter().flatten().enumerate() {
            residual.iter_mut().zip(contribution).for_each(|(values, part)| values[from + k] -= part);
        }
    }
}

pub(super) fn remove(residual: &mut [Vec<f64>; 3], record: &Record, samples: &Samples, windows: &[[usize; 2]], signal: &Inside) {
    remove_raw(residual, record, samples, windows, signal);
    demean(residual, windows);
}

fn rms(residual: &[Vec<f64>; 3], windows: &[[usize; 2]]) -> [f64; 3] {
    [0, 1, 2].map(|a: usize| {
        let (mut sum, mut count) = (0.0, 0.0);
        for [from, to] in windows {
            sum += residual[a][*from..*to].iter().map(|v| v * v).sum::<f64>();
            count += (to - from) as f64;
        }
        (sum / f64::max(count, 1.0)).sqrt()
    })
}
