//! Damaged data, kept apart from physics.

use crate::data::run::{Run, SlowTable};
use crate::fit::statistics::median;
use nalgebra::DMatrix;

/// A jump of this many times the usual size of such steps, in standard deviations.
const JUMP: f64 = 9.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides.
const SIDES: usize = 6;

/// Most jumps of one channel.
const MOST_JUMPS: usize = 6;

/// A temperature channel that jumps.
#[derive(Clone, Debug, PartialEq)]
pub struct Jumps {
    /// The channel.
    pub channel: String,
    /// Every jump, the largest first: time, s since the run's start, and size, K.
    pub jumps: Vec<(f64, f64)>,
    /// Readings of the channel.
    pub readings: usize,
}

impl Jumps {
    /// The largest jump in units of the smallest that counts.
    #[must_use]
    pub fn strength(&self) -> f64 {
        self.jumps[0].1.abs() / LEAST_JUMP_K
    }
}

/// Temperature channels that jump between two times (s since the run's start), and the temperatures without the jumps: a model that
/// believed them would need effects that do not exist.
#[must_use]
pub fn thermistors(run: &Run, span_s: [f64; 2]) -> (Vec<Jumps>, SlowTable) {
    let mut mended = run.temperatures.clone();
    let mut found_in = Vec::new();
    for (index, name) in run.temperatures.names.iter().enumerate() {
        let mut jumps: Vec<(f64, f64)> = Vec::new();
        while jumps.len() < MOST_JUMPS {
            let found = mended.channel(name).and_then(|series| jump(&series));
            let Some((t_s, size)) = found.filter(|(t, _)| (span_s[0]..=span_s[1]).contains(t)) else { break };
            let from = mended.t_s.partition_point(|t| *t < t_s);
            mended.values[index][from..].iter_mut().for_each(|value| *value -= size);
            jumps.push((t_s, size));
        }
        if !jumps.is_empty() {
            found_in.push(Jumps { channel: name.clone(), jumps, readings: mended.t_s.len() });
        }
    }
    (found_in, mended)
}

/// Time and size of the largest jump of a channel: a step beside a cubic over the readings around it, against what such steps are elsewhere.
fn jump(series: &[(f64, f64)]) -> Option<(f64, f64)> {
    if series.len() < 4 * SIDES {
        return None;
    }
    let design = DMatrix::from_fn(2 * SIDES, 5, |i, j| {
        let x = (i as f64 - SIDES as f64 + 0.5) / SIDES as f64;
        if j < 4 {
            x.powi(j as i32)
        } else if i < SIDES {
            -0.5
        } else {
            0.5
        }
    });
    let inverse = design.pseudo_inverse(1e-12).ok()?;
    let step = inverse.row(4);
    let sizes: Vec<f64> = series.windows(2 * SIDES).map(|w| w.iter().zip(step.iter()).map(|((_, v), c)| v * c).sum()).collect();
    let mut usual: Vec<f64> = sizes.iter().map(|s| s.abs()).collect();
    let usual = 1.4826 * median(&mut usual);
    let largest = (0..sizes.len()).max_by(|a, b| sizes[*a].abs().total_cmp(&sizes[*b].abs()))?;
    let size = sizes[largest];
    (size.abs() > LEAST_JUMP_K && size.abs() > JUMP * usual).then(|| (series[largest + SIDES].0, size))
}
