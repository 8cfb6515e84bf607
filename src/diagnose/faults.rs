//! Damaged data, kept apart from physics.

use super::result::{Gap, Step};
use super::scene::Scene;
use crate::model::effects::{Family, Spec};
use crate::plateau::median;
use crate::run::Run;

/// A jump of this many times the usual change between readings, in standard deviations.
const JUMP: f64 = 12.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides that agree among themselves.
const SIDES: usize = 4;

/// Temperature channels that jump.
#[must_use]
pub fn thermistors(run: &Run, scene: &Scene) -> Vec<Step> {
    let mut steps = Vec::new();
    for name in &run.temperatures.names {
        let Some(series) = run.temperatures.channel(name) else { continue };
        let inside = |t: f64| (scene.record.span_s[0]..=scene.record.span_s[1]).contains(&t);
        let Some((t_s, size)) = jump(&series).filter(|(t, _)| inside(*t)) else { continue };
        let spec = Spec::new("jump", &[]).with("time", t_s, "s");
        let gap = Gap::default();
        steps.push(Step {
            effect: "bad_thermistor".to_owned(),
            axes: Vec::new(),
            ambiguous_with: Vec::new(),
            form: spec,
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

/// Time and size of the largest jump of a channel, if it has one that no neighbour prepares.
fn jump(series: &[(f64, f64)]) -> Option<(f64, f64)> {
    if series.len() < 4 * SIDES {
        return None;
    }
    let changes: Vec<f64> = series.windows(2).map(|w| w[1].1 - w[0].1).collect();
    let largest = (SIDES..changes.len() - SIDES).max_by(|a, b| changes[*a].abs().total_cmp(&changes[*b].abs()))?;
    // Against the change of its neighbours: channels that swing have none that stands out.
    let mut sizes: Vec<f64> = changes.iter().map(|c| c.abs()).collect();
    let usual = 1.4826 * median(&mut sizes);
    let beside = changes[largest - SIDES..largest].iter().chain(&changes[largest + 1..=largest + SIDES]);
    let around = beside.map(|c| c.abs()).fold(0.0, f64::max);
    let size = changes[largest];
    let (low, high) = (&series[largest + 1 - SIDES..=largest], &series[largest + 1..=largest + SIDES]);
    let mean = |part: &[(f64, f64)]| part.iter().map(|(_, v)| v).sum::<f64>() / part.len() as f64;
    let stays = (mean(high) - mean(low)) / size > 0.5;
    (size.abs() > LEAST_JUMP_K && size.abs() > JUMP * usual && size.abs() > 3.0 * around && stays)
        .then(|| (series[largest + 1].0, size))
}
