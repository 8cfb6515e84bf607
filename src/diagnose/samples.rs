//! What happens inside the plateaus: displaced edges, transients after steps, periodic signals.

mod coarse;
mod cut;
mod edges;
mod end_of_range;
mod loud;
mod narrow;
mod periodic;
mod scatter;
mod still;
mod transients;

use crate::data::plateau::{Plateau, Plateaus};
use crate::fit::statistics::{median, robust_std};
use crate::model::effects::in_samples::{InSamples, Line};
use crate::model::effects::{EffectRef, Record, Row, Spec};
use crate::record::prepared::{PreparedRun, Samples};
pub(super) use coarse::{Coarse, coarse};
pub(super) use cut::cut;
pub(super) use edges::apart;
pub use edges::displaced;
pub(super) use end_of_range::at_end;
pub use loud::loud;
pub(super) use narrow::narrow;
pub use periodic::{AroundMeans, Periodic, periodic};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;
pub(super) use still::still;
pub(super) use transients::phases;
pub use transients::transient;

/// Probability that noise alone shows as much, all trials counted: a tenth of the false alarms of a run, as in reports/blind-study.md.
const SIGNIFICANT: f64 = 0.001;
/// Samples whose columns are evaluated at once, so that memory does not grow with the run.
const AT_ONCE: usize = 1 << 11;

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
    /// Other effects that the samples cannot distinguish from it.
    pub ambiguous_with: Vec<EffectRef>,
    /// Squares of what is left of the used samples around their plateaus before and after, over the noise, and their number.
    pub squares: [f64; 3],
    /// Root mean square of the samples of the axes before and after, enT.
    pub rms_ent: [[f64; 3]; 2],
    /// Samples nearer than this to the begin or end of a setting do not count, s.
    pub beside_s: f64,
}

impl Inside {
    /// Something with a form of which nothing else is known yet.
    fn new(effect: EffectRef, spec: Spec) -> Self {
        Inside {
            effect,
            spec,
            values: Vec::new(),
            shape_std: Vec::new(),
            strength: 0.0,
            p_value: 1.0,
            trials: 0,
            ambiguous_with: Vec::new(),
            squares: [0.0; 3],
            rms_ent: [[0.0; 3]; 2],
            beside_s: 0.0,
        }
    }

    /// The same with the other sign.
    fn negative(&self) -> Self {
        Inside { values: self.values.iter().map(|(value, std)| (-value, *std)).collect(), ..self.clone() }
    }

    /// What it is a line of, and its frequency, Hz; `None` if it is none.
    fn line(&self) -> Option<(Line, f64)> {
        let Some(InSamples::Line(line)) = self.effect.in_samples() else { return None };
        Some((line, self.spec.get(line.frequency)?))
    }

    /// Sizes of sine and cosine of a line on each component, enT.
    fn sin_and_cos(&self) -> [[f64; 2]; 3] {
        [0, 1, 2].map(|a| match of_axis(&self.spec, a, 2, &self.values) {
            [(sin, _), (cos, _)] => [*sin, *cos],
            _ => [0.0; 2],
        })
    }

    /// An effect that is known from elsewhere.
    #[must_use]
    pub fn known(given: &crate::record::known::Given) -> Self {
        Inside { values: given.values.iter().map(|v| (*v, 0.0)).collect(), ..Self::new(given.effect, given.spec.clone()) }
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

/// The same, of which edges and spikes inside the plateaus are no part; where most neighbours are equal it says nothing, and they are.
pub(super) fn usual_std(samples: &Samples, windows: &[[usize; 2]]) -> [f64; 3] {
    let usual = |a: usize| {
        let readings = |[from, to]: &[usize; 2]| &samples.reading_ent[*from..*to];
        let steps = windows.iter().map(readings).flat_map(|own| own.windows(2)).map(|pair| pair[1][a] - pair[0][a]);
        robust_std(steps) / SQRT_2
    };
    let mut std = sample_std(samples, windows);
    std.par_iter_mut().enumerate().for_each(|(a, std)| *std = Some(usual(a)).filter(|usual| *usual > 0.0).unwrap_or(*std));
    std
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

/// The samples of each setting that are not nearer than `beside_s` to its begin or its end.
pub(super) fn windows_of(samples: &Samples, settings: &[[f64; 2]], beside_s: f64) -> Vec<[usize; 2]> {
    let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
    settings
        .iter()
        .map(|[begin, end]| [at(begin + beside_s), at(end - beside_s)])
        .map(|[from, to]| [from, to.max(from)])
        .collect()
}

/// The settings of constant fields, each with all of its samples.
fn of_settings<'a>(samples: &Samples, plateaus: &'a Plateaus) -> Vec<(&'a Plateau, [usize; 2])> {
    let steady: Vec<&Plateau> = plateaus.list.iter().filter(|p| p.setting.frequency_hz == 0.0).collect();
    let settings: Vec<[f64; 2]> = steady.iter().map(|p| [p.setting.t_start_s, p.setting.t_end_s]).collect();
    steady.into_iter().zip(windows_of(samples, &settings, 0.0)).collect()
}

/// Level of the samples in a part of a setting, in quarters of it: what happens in less than half of them does not move it. `None` of too few.
fn level(samples: &Samples, [from, to]: [usize; 2], quarters: [usize; 2]) -> Option<[f64; 3]> {
    const FEWEST: usize = 4;
    let at = |quarter: usize| from + quarter * to.saturating_sub(from) / 4;
    let part = samples.reading_ent.get(at(quarters[0])..at(quarters[1])).filter(|part| part.len() >= FEWEST)?;
    Some([0, 1, 2].map(|a: usize| median(&mut part.iter().map(|v| v[a]).collect::<Vec<f64>>())))
}

/// Squares and scatter of the samples of the settings around their means, without and with what was found before.
pub fn measure(prepared: &PreparedRun, samples: &Samples, settings: &[[f64; 2]], known: &[Inside], found: &mut Inside) {
    let windows = windows_of(samples, settings, found.beside_s);
    let noise = sample_std(samples, &prepared.windows);
    let count: usize = windows.iter().map(|w| w[1].saturating_sub(w[0])).sum();
    let mut residual: [Vec<f64>; 3] = [0, 1, 2].map(|a| samples.reading_ent.iter().map(|r| r[a]).collect());
    for signal in known {
        remove_raw(&mut residual, &prepared.record, samples, &windows, signal);
    }
    demean(&mut residual, &windows);
    found.rms_ent[0] = rms(&squares_of_all(&residual, &windows), &windows);
    remove(&mut residual, &prepared.record, samples, &windows, found);
    found.rms_ent[1] = rms(&squares_of_all(&residual, &windows), &windows);
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

/// Parts of the samples of all axes, which lie one after the other, for threads that change them beside each other. What two
/// parts share belongs to the later one.
fn parts_mut(axes: &mut [Vec<f64>; 3], parts: impl DoubleEndedIterator<Item = [usize; 2]>) -> Vec<[&mut [f64]; 3]> {
    let mut left = axes.each_mut().map(Vec::as_mut_slice);
    let last = |[from, to]: [usize; 2]| {
        left.each_mut().map(|left| {
            let all = std::mem::take(left);
            let (before, own) = all.split_at_mut(from.min(all.len()));
            *left = before;
            let count = to.saturating_sub(from).min(own.len());
            &mut own[..count]
        })
    };
    let mut all: Vec<[&mut [f64]; 3]> = parts.rev().map(last).collect();
    all.reverse();
    all
}

/// Takes a signal off the samples of the windows.
pub(super) fn remove_raw(
    residual: &mut [Vec<f64>; 3],
    record: &Record,
    samples: &Samples,
    windows: &[[usize; 2]],
    signal: &Inside,
) {
    let parts: Vec<[usize; 2]> = windows
        .iter()
        .flat_map(|[from, to]| (*from..*to).step_by(AT_ONCE).map(|begin| [begin, (begin + AT_ONCE).min(*to)]))
        .collect();
    let own = parts_mut(residual, parts.iter().copied());
    if let Some((line, frequency_hz)) = signal.line() {
        let sizes = signal.sin_and_cos();
        parts.par_iter().zip(own).for_each(|([from, to], [x, y, z])| {
            for (((t_s, x), y), z) in samples.t_s[*from..*to].iter().zip(x).zip(y).zip(z) {
                let (sin, cos) = (line.wave)(frequency_hz, [*t_s; 2]);
                [x, y, z].into_iter().zip(sizes).for_each(|(value, [s, c])| *value -= s * sin + c * cos);
            }
        });
        return;
    }
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
        earlier_coil_nt: Default::default(),
        linear_ent: [0.0; 3],
    };
    // What comes again has one course on all of its axes, which is asked for once.
    let course = signal.effect.period_s(&signal.spec).and(signal.spec.axes.first());
    let course = course.map(|axis| (*axis, Spec { axes: vec![*axis], ..signal.spec.clone() }));
    parts.par_iter().zip(own).for_each(|([from, to], axes)| {
        let record = Record { rows: (*from..*to).map(row).collect(), ..bare.clone() };
        let Some(columns) = signal.effect.columns(&record, course.as_ref().map_or(&signal.spec, |(_, one)| one)) else { return };
        for (a, values) in axes.into_iter().enumerate() {
            let (component, sizes) = match &course {
                Some((axis, _)) => (*axis, of_axis(&signal.spec, a, columns.len(), &signal.values)),
                None => (a, &signal.values[..]),
            };
            for (column, (size, _)) in columns.iter().zip(sizes) {
                values.iter_mut().zip(&column.values).for_each(|(value, by)| *value -= size * by[component]);
            }
        }
    });
}

/// Of the parameters of a term, so many per axis, those of an axis; none where it does not act.
fn of_axis<'a>(spec: &Spec, axis: usize, per_axis: usize, values: &'a [(f64, f64)]) -> &'a [(f64, f64)] {
    let place = spec.axes.iter().position(|a| *a == axis);
    place.and_then(|k| values.get(k * per_axis..(k + 1) * per_axis)).unwrap_or_default()
}

pub(super) fn remove(residual: &mut [Vec<f64>; 3], record: &Record, samples: &Samples, windows: &[[usize; 2]], signal: &Inside) {
    remove_raw(residual, record, samples, windows, signal);
    demean(residual, windows);
}

/// Sum of the squares of each window.
fn squares(values: &[f64], windows: &[[usize; 2]]) -> Vec<f64> {
    windows.par_iter().map(|[from, to]| values[*from..*to].iter().map(|v| v * v).sum()).collect()
}

/// The same of each component.
fn squares_of_all(residual: &[Vec<f64>; 3], windows: &[[usize; 2]]) -> [Vec<f64>; 3] {
    residual.each_ref().map(|values| squares(values, windows))
}

/// Root mean squares of the components by the squares of the windows.
fn rms(squares: &[Vec<f64>; 3], windows: &[[usize; 2]]) -> [f64; 3] {
    let count: f64 = windows.iter().map(|[from, to]| (to - from) as f64).sum();
    squares.each_ref().map(|own| (own.iter().fold(0.0, |sum, own| sum + own) / f64::max(count, 1.0)).sqrt())
}
