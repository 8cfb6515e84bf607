//! Displaced edges: data and settings that step at different times.

use super::{Inside, interval_s};
use crate::model::effects::EffectRef;
use crate::model::effects::time_shift::{self, TimeShift};
use crate::record::prepared::{PreparedRun, Samples};

/// A step of this many standard deviations of the samples shows where its edge is.
const CLEAR_STEP: f64 = 100.0;
/// Longest displacement that is looked for, s, and as a part of the shorter neighbour.
const MOST_SHIFT_S: f64 = 1.0;
const MOST_PART: f64 = 0.45;
/// Most rounds in which displacements are looked for again around the last one.
const MOST_ROUNDS: usize = 4;
/// Fewest clear edges.
const LEAST_EDGES: usize = 6;
/// Least displacement, in samples: data that are late by a part of a sample are what the low-pass of every sensor makes of an edge.
const LEAST_EARLY: f64 = 0.1;
const LEAST_LATE: f64 = 1.0;
/// Least displacement in standard uncertainties.
const SIGNIFICANT: f64 = 6.0;
/// An edge agrees if its displacement has the sign of the median and at least this part of it; this part of all edges has to.
const AGREES: f64 = 0.3;
const AGREEING: f64 = 0.8;
/// The levels beside an edge are those of the settings if their difference is within this part of the step.
const SAME_STEP: f64 = 0.3;
/// Standard deviation of a median over that of a mean, about.
const OF_MEDIAN: f64 = 1.25;
/// Standard deviation of a rounded value, in units of the last place.
const ROUNDING: f64 = 0.29;
/// Normal noise is within so many standard deviations in nine of ten cases.
const NORMAL_90: f64 = 1.644_853_626_951_472_2;

/// Standard deviation of the samples of each component inside the plateaus, from the ninetieth percentile of the differences of neighbours,
/// which edges inside the plateaus do not move; zero where most readings repeat.
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

/// Displacement of every clear edge, s, looked for around a displacement that is known roughly.
fn edges_around(prepared: &PreparedRun, samples: &Samples, std: [f64; 3], dt: f64, around_s: f64) -> Vec<f64> {
    let steps = &prepared.record.steps;
    let mut shifts = Vec::new();
    for (i, step) in steps.iter().enumerate() {
        let axis = (0..3).max_by(|a, b| step.change_ent[*a].abs().total_cmp(&step.change_ent[*b].abs())).unwrap_or(0);
        let change = step.change_ent[axis];
        let before = i.checked_sub(1).map_or(f64::INFINITY, |k| step.t_s - steps[k].t_s);
        let after = steps.get(i + 1).map_or(f64::INFINITY, |s| s.t_s - step.t_s);
        let half = (MOST_PART * before.min(after)).min(MOST_SHIFT_S);
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
        if (high - low - change).abs() > SAME_STEP * change.abs() {
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
pub fn displaced(prepared: &PreparedRun, samples: &Samples) -> Option<Inside> {
    let std = quiet_std(samples, &prepared.windows);
    let dt = interval_s(samples)?;
    let mut shifts = edges_around(prepared, samples, std, dt, 0.0);
    // An edge that is far off lies within the stretches from which the levels are taken: it is looked for once more around where it was seen.
    for _ in 0..MOST_ROUNDS {
        let around_s = *shifts.get(shifts.len() / 2)?;
        let closer = edges_around(prepared, samples, std, dt, around_s);
        if closer.len() < shifts.len() / 2 {
            break;
        }
        shifts = closer;
        if (shifts[shifts.len() / 2] - around_s).abs() < 0.5 * dt {
            break;
        }
    }
    if shifts.len() < LEAST_EDGES {
        return None;
    }
    let shift_s = shifts[shifts.len() / 2];
    let spread = 1.4826 * {
        let mut away: Vec<f64> = shifts.iter().map(|s| (s - shift_s).abs()).collect();
        away.sort_by(f64::total_cmp);
        away[away.len() / 2]
    };
    // Where all edges agree, a displacement is known no better than to the rounding of its edges to samples.
    let std_s = (OF_MEDIAN * spread / (shifts.len() as f64).sqrt()).max(ROUNDING * dt / (shifts.len() as f64).sqrt());
    let same = shifts.iter().filter(|s| s.signum() == shift_s.signum() && s.abs() > AGREES * shift_s.abs()).count();
    let agrees = same as f64 > AGREEING * shifts.len() as f64;
    let least = if shift_s > 0.0 { LEAST_LATE } else { LEAST_EARLY };
    (shift_s.abs() > least * dt && shift_s.abs() > SIGNIFICANT * std_s && agrees).then(|| Inside {
        values: vec![(1.0, std_s / shift_s.abs())],
        shape_std: vec![(time_shift::SHIFT.to_owned(), std_s)],
        strength: shift_s.abs() / std_s,
        p_value: (-0.5 * (shift_s / std_s).powi(2)).exp().max(f64::MIN_POSITIVE),
        trials: 1,
        ..Inside::new(EffectRef::new(&TimeShift), time_shift::edges(shift_s))
    })
}
