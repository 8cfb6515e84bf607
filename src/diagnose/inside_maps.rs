//! What happens inside the plateaus as means for the pictures: transients over the time since the step, edges, folded signals.

use super::result::{InsideBin, InsideMap};
use super::samples::{Inside, demean, phases, remove_raw, windows_of};
use crate::model::effects::in_samples::InSamples;
use crate::model::effects::time_shift::SHIFT;
use crate::record::prepared::{PreparedRun, Samples};
use rayon::prelude::*;

/// Bins of a period.
const FOLDS: usize = 40;
/// Windows that are folded at once.
const WINDOWS_AT_ONCE: usize = 16;
/// Bins around an edge.
const EDGE_BINS: usize = 60;
/// An edge is shown this many displacements to either side.
const EDGE_SHIFTS: f64 = 4.0;
/// Steps below this part of the largest say little about an edge.
const LEAST_STEP: f64 = 0.2;

/// Samples of one bin and one component: `weight` times what is looked for, and noise.
#[derive(Clone, Copy, Default)]
struct Sum {
    x: f64,
    count: f64,
    weights: f64,
    before: f64,
    after: f64,
    after_squares: f64,
}

impl Sum {
    fn each(&mut self) -> [&mut f64; 6] {
        [&mut self.x, &mut self.count, &mut self.weights, &mut self.before, &mut self.after, &mut self.after_squares]
    }
}

#[derive(Clone, Default)]
struct Cell([Sum; 3]);

impl Cell {
    fn add(&mut self, axis: usize, x: f64, weight: f64, before: f64, after: f64) {
        let sum = &mut self.0[axis];
        sum.x += x;
        sum.count += 1.0;
        sum.weights += weight * weight;
        sum.before += weight * before;
        sum.after += weight * after;
        sum.after_squares += after * after;
    }

    /// With the samples of another one.
    fn join(&mut self, other: &Self) {
        for (sum, mut other) in self.0.iter_mut().zip(other.0) {
            sum.each().into_iter().zip(other.each()).for_each(|(sum, other)| *sum += *other);
        }
    }

    fn bin(&self, factor: f64) -> InsideBin {
        let count: f64 = self.0.iter().map(|s| s.count).sum();
        let of = |value: fn(&Sum) -> f64| self.0.map(|s| if s.weights > 0.0 { factor * value(&s) } else { f64::NAN });
        InsideBin {
            x: self.0.iter().map(|s| s.x).sum::<f64>() / count,
            before: of(|s| s.before / s.weights),
            after: of(|s| s.after / s.weights),
            // From the scatter about what is left with the effect.
            std: of(|s| ((s.after_squares - s.after * s.after / s.weights).max(0.0) / s.count / s.weights).sqrt()),
        }
    }
}

fn bins(cells: &[Cell], factor: f64) -> Vec<InsideBin> {
    cells.iter().filter(|c| c.0.iter().any(|s| s.count > 1.0)).map(|c| c.bin(factor)).collect()
}

/// The pictures of what was found in the samples after the first `known` of all signals, the earlier ones taken off each. The
/// first of them has the number `step`.
#[must_use]
pub fn of(
    prepared: &PreparedRun,
    samples: &Samples,
    settings: &[[f64; 2]],
    all: &[Inside],
    known: usize,
    step: usize,
) -> Vec<InsideMap> {
    let mut left: Option<Left> = None;
    let map = |(index, found): (usize, &Inside)| -> Option<InsideMap> {
        let windows = windows(prepared, samples, settings, found)?;
        // From signal to signal on the same windows there is one more to take off.
        let mut now = left.take().filter(|left| left.windows == windows).unwrap_or_else(|| Left::new(samples, windows));
        now.take_off(prepared, samples, &all[..known + index]);
        let is_periodic = found.effect.in_samples().is_some_and(InSamples::is_periodic);
        let map =
            if is_periodic { periodic } else { of_steps }(prepared, samples, &mut now, &all[..=known + index], step + index);
        left = Some(now);
        map
    };
    all[known..].iter().enumerate().filter_map(map).collect()
}

/// The windows of the samples that the picture of something shows.
fn windows(prepared: &PreparedRun, samples: &Samples, settings: &[[f64; 2]], found: &Inside) -> Option<Vec<[usize; 2]>> {
    Some(match found.effect.in_samples()? {
        InSamples::Transient(_) => windows_of(samples, settings, found.beside_s).into_iter().filter(|w| w[1] > w[0]).collect(),
        InSamples::Edges => vec![[0, samples.t_s.len()]],
        _ => prepared.windows.clone(),
    })
}

/// Readings of some windows without the first signals.
struct Left {
    windows: Vec<[usize; 2]>,
    values: [Vec<f64>; 3],
    /// How many signals were taken off.
    count: usize,
}

impl Left {
    fn new(samples: &Samples, windows: Vec<[usize; 2]>) -> Self {
        Self { windows, values: std::array::from_fn(|a| samples.reading_ent.iter().map(|r| r[a]).collect()), count: 0 }
    }

    /// Takes off those of some signals that were not yet.
    fn take_off(&mut self, prepared: &PreparedRun, samples: &Samples, signals: &[Inside]) {
        for signal in &signals[self.count..] {
            remove_raw(&mut self.values, &prepared.record, samples, &self.windows, signal);
        }
        self.count = signals.len();
    }

    /// Cells of a period, to which every sample is added by the time within the period and the values around the means of its window.
    fn folded(&self, samples: &Samples, period_s: f64, add: impl Fn(&mut Cell, f64, [f64; 3]) + Sync) -> Vec<Cell> {
        let of_windows = |windows: &[[usize; 2]]| {
            let mut cells = vec![Cell::default(); FOLDS];
            for [from, to] in windows {
                let own = self.values.each_ref().map(|values| &values[*from..*to]);
                let means = own.map(|values| values.iter().sum::<f64>() / values.len().max(1) as f64);
                for (k, t_s) in samples.t_s[*from..*to].iter().enumerate() {
                    let turns = t_s / period_s;
                    let phase = turns - turns.floor();
                    let cell = &mut cells[((phase * FOLDS as f64) as usize).min(FOLDS - 1)];
                    add(cell, phase * period_s, std::array::from_fn(|a| own[a][k] - means[a]));
                }
            }
            cells
        };
        // Added up in the order of the windows, whatever the threads.
        let parts: Vec<Vec<Cell>> = self.windows.par_chunks(WINDOWS_AT_ONCE).map(of_windows).collect();
        let mut cells = vec![Cell::default(); FOLDS];
        parts.iter().for_each(|part| cells.iter_mut().zip(part).for_each(|(cell, part)| cell.join(part)));
        cells
    }
}

/// The picture of the last of some signals, which follows the steps of the field and is taken off.
fn of_steps(prepared: &PreparedRun, samples: &Samples, left: &mut Left, signals: &[Inside], step: usize) -> Option<InsideMap> {
    let found = signals.last()?;
    let mut before = left.values.clone();
    left.take_off(prepared, samples, signals);
    let mut after = left.values.clone();
    if matches!(found.effect.in_samples()?, InSamples::Edges) {
        return edges(prepared, samples, &before, &after, found, step);
    }
    demean(&mut before, &left.windows);
    demean(&mut after, &left.windows);
    transients(prepared, samples, &left.windows, [&before, &after], step)
}

/// The same of one that comes again: means over its period.
fn periodic(prepared: &PreparedRun, samples: &Samples, left: &mut Left, signals: &[Inside], step: usize) -> Option<InsideMap> {
    let found = signals.last()?;
    let period_s = found.effect.period_s(&found.spec).filter(|p| *p > 0.0)?;
    // A weight of enT per nT makes nT of readings; the mean over a bin is the sum over the number.
    let weights = prepared.nt_per_ent.map(f64::recip);
    let mut cells = left.folded(samples, period_s, |cell, x, values| {
        (0..3).for_each(|a| cell.add(a, x, weights[a], values[a], 0.0));
    });
    left.take_off(prepared, samples, signals);
    let after = left.folded(samples, period_s, |cell, _, values| {
        for ((sum, value), weight) in cell.0.iter_mut().zip(values).zip(weights) {
            sum.after += weight * value;
            sum.after_squares += value * value;
        }
    });
    cells.iter_mut().zip(&after).for_each(|(cell, after)| cell.join(after));
    Some(InsideMap {
        step,
        covariate: format!("time within the period of {period_s:.5} s, s"),
        quantity: "mean around the plateau, nT".to_owned(),
        bins: bins(&cells, 1.0),
    })
}

/// Means over the time since the step, relative to the step.
fn transients(
    prepared: &PreparedRun,
    samples: &Samples,
    windows: &[[usize; 2]],
    [before, after]: [&[Vec<f64>; 3]; 2],
    step: usize,
) -> Option<InsideMap> {
    let shortest = windows.iter().map(|w| w[1] - w[0]).min()?;
    let edges = phases(shortest);
    let mut cells = vec![Cell::default(); edges.len().saturating_sub(1)];
    let steps = &prepared.record.steps;
    for [from, _] in windows {
        // The last step up to the first sample made this plateau.
        let Some(last) = steps.partition_point(|s| s.t_s <= samples.t_s[*from] + 1e-9).checked_sub(1) else { continue };
        for (cell, edge) in cells.iter_mut().zip(edges.windows(2)) {
            for k in from + edge[0]..from + edge[1] {
                for a in 0..3 {
                    cell.add(a, samples.t_s[k] - steps[last].t_s, steps[last].change_ent[a], before[a][k], after[a][k]);
                }
            }
        }
    }
    Some(InsideMap {
        step,
        covariate: "time since the step, s".to_owned(),
        quantity: "around the plateau, nT per 1000 nT of the step".to_owned(),
        bins: bins(&cells, 1000.0),
    })
}

/// The mean edge: readings around the steps as a part of the step.
fn edges(
    prepared: &PreparedRun,
    samples: &Samples,
    before: &[Vec<f64>; 3],
    after: &[Vec<f64>; 3],
    found: &Inside,
    step: usize,
) -> Option<InsideMap> {
    let steps = &prepared.record.steps;
    let half_s = EDGE_SHIFTS * found.spec.get(SHIFT)?.abs();
    let most: [f64; 3] = std::array::from_fn(|a| steps.iter().map(|s| s.change_ent[a].abs()).fold(f64::MIN_POSITIVE, f64::max));
    let mut cells = vec![Cell::default(); EDGE_BINS];
    for (i, edge) in steps.iter().enumerate() {
        let gap_before = i.checked_sub(1).map_or(f64::INFINITY, |k| edge.t_s - steps[k].t_s);
        let gap_after = steps.get(i + 1).map_or(f64::INFINITY, |s| s.t_s - edge.t_s);
        if gap_before.min(gap_after) < 1.5 * half_s {
            continue;
        }
        let at = |t: f64| samples.t_s.partition_point(|x| *x < t - 1e-9);
        let (from, middle, to) = (at(edge.t_s - half_s), at(edge.t_s), at(edge.t_s + half_s));
        let third = ((middle - from) / 3).min((to - middle) / 3);
        if third == 0 {
            continue;
        }
        for a in (0..3).filter(|a| edge.change_ent[*a].abs() > LEAST_STEP * most[*a]) {
            let mean = |r: std::ops::Range<usize>| before[a][r.clone()].iter().sum::<f64>() / r.len() as f64;
            let (low, high) = (mean(from..from + third), mean(to - third..to));
            for k in from..to {
                let x = samples.t_s[k] - edge.t_s;
                let cell = (((x / half_s + 1.0) * 0.5 * EDGE_BINS as f64).max(0.0) as usize).min(EDGE_BINS - 1);
                let part = |values: &[Vec<f64>; 3]| (values[a][k] - low) / (high - low);
                cells[cell].add(a, x, 1.0, part(before), part(after));
            }
        }
    }
    Some(InsideMap {
        step,
        covariate: "time since the step of the settings, s".to_owned(),
        quantity: "part of the step, %".to_owned(),
        bins: bins(&cells, 100.0),
    })
}
