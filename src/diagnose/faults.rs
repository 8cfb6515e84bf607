//! Damaged data, kept apart from physics.

use super::result::{Gap, Parameter, Step};
use crate::model::effects::{Family, Spec};
use crate::plateau::median;
use crate::run::{Run, SlowTable};
use nalgebra::DMatrix;

/// A jump of this many times the usual size of such steps, in standard deviations.
const JUMP: f64 = 9.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides.
const SIDES: usize = 6;

/// Most jumps of one channel.
const MOST_JUMPS: usize = 6;

/// Temperature channels that jump between two times (s since the run's start), and the temperatures without the jumps: a model that
/// believed them would need effects that do not exist.
#[must_use]
pub fn thermistors(run: &Run, span_s: [f64; 2]) -> (Vec<Step>, SlowTable) {
    let mut mended = run.temperatures.clone();
    let mut steps = Vec::new();
    for (index, name) in run.temperatures.names.iter().enumerate() {
        let mut jumps: Vec<(f64, f64)> = Vec::new();
        while jumps.len() < MOST_JUMPS {
            let found = mended.channel(name).and_then(|series| jump(&series));
            let Some((t_s, size)) = found.filter(|(t, _)| (span_s[0]..=span_s[1]).contains(t)) else { break };
            let from = mended.t_s.partition_point(|t| *t < t_s);
            mended.values[index][from..].iter_mut().for_each(|value| *value -= size);
            jumps.push((t_s, size));
        }
        steps.extend((!jumps.is_empty()).then(|| step(name, &jumps, mended.t_s.len())));
    }
    (steps, mended)
}

fn step(name: &str, jumps: &[(f64, f64)], readings: usize) -> Step {
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
        effect: "bad_thermistor".to_owned(),
        axes: Vec::new(),
        ambiguous_with: Vec::new(),
        form: Spec::new("jump", &[]).with("time", jumps[0].0, "s"),
        further: Vec::new(),
        parameters: jumps.iter().enumerate().map(parameter).collect(),
        place: format!("channel {name} jumps {list}"),
        p_value: f64::MIN_POSITIVE,
        trials: readings,
        p_value_corrected: f64::MIN_POSITIVE,
        gap_before: gap,
        gap_after: gap,
        strength_k: jumps[0].1.abs() / LEAST_JUMP_K,
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
