//! Damaged data, kept apart from physics.

use super::result::{Gap, Step};
use super::scene::Scene;
use crate::model::effects::{Family, Spec};
use crate::plateau::median;
use crate::run::Run;
use nalgebra::DMatrix;

/// A jump of this many times the usual size of such steps, in standard deviations.
const JUMP: f64 = 9.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides.
const SIDES: usize = 6;

/// Temperature channels that jump.
#[must_use]
pub fn thermistors(run: &Run, scene: &Scene) -> Vec<Step> {
    thermistors_within(run, scene.record.span_s)
}

/// Temperature channels that jump between two times, s since the run's start.
#[must_use]
pub fn thermistors_within(run: &Run, span_s: [f64; 2]) -> Vec<Step> {
    let mut steps = Vec::new();
    for name in &run.temperatures.names {
        let Some(series) = run.temperatures.channel(name) else { continue };
        let inside = |t: f64| (span_s[0]..=span_s[1]).contains(&t);
        let Some((t_s, size)) = jump(&series).filter(|(t, _)| inside(*t)) else { continue };
        let spec = Spec::new("jump", &[]).with("time", t_s, "s");
        let gap = Gap::default();
        steps.push(Step {
            effect: "bad_thermistor".to_owned(),
            axes: Vec::new(),
            ambiguous_with: Vec::new(),
            form: spec,
            further: Vec::new(),
            parameters: vec![super::result::Parameter {
                name: format!("jump of {name}"),
                value: size,
                std: None,
                unit: "K".to_owned(),
            }],
            place: format!("channel {name} jumps by {size:+.2} K at {t_s:.0} s"),
            p_value: f64::MIN_POSITIVE,
            trials: series.len(),
            p_value_corrected: f64::MIN_POSITIVE,
            gap_before: gap,
            gap_after: gap,
            strength_k: size.abs() / LEAST_JUMP_K,
            family: Family::DataFault.name(),
            wording: "is",
            runners_up: Vec::new(),
            next_measurement: None,
            sentence: format!(
                "The temperature channel {name} jumps by {size:+.2} K at {t_s:.0} s and was not to be trusted there."
            ),
            covariate: None,
            shape: Vec::new(),
        });
    }
    steps
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
