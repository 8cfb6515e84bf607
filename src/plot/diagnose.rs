//! Figures of a diagnosis: what disagrees, and what is left of it with the effect that was named.

use super::parts::Named;
use super::{Band, Figure, Marks, Panel, Scale, Series, Style};
use crate::diagnose::result::{Diagnosis, Map};
use crate::units::COMPONENTS;

const STEMS: [&str; 8] = ["step_1", "step_2", "step_3", "step_4", "step_5", "step_6", "step_7", "step_8"];

/// One figure per step: residuals of held-out stretches without the effect above, with it below. One of the axes where nothing is missing.
#[must_use]
pub fn figures(diagnosis: &Diagnosis) -> Vec<Named> {
    if diagnosis.steps.is_empty() {
        return quiet(diagnosis).into_iter().collect();
    }
    diagnosis.maps.iter().filter_map(|map| step(diagnosis, map)).collect()
}

fn panel(map: &Map, y_label: String, values: &[f64], style: Style, label: &str) -> Panel {
    let points = map.x.iter().zip(values).map(|(x, y)| (*x, *y, None)).collect();
    Panel {
        y_label,
        y_scale: Scale::Linear,
        series: vec![Series { label: label.to_owned(), style, marks: Marks::Points(points) }],
        bands: vec![Band {
            label: format!("±2 noise, {:.3} nT", 2.0 * map.noise_nt),
            low: -2.0 * map.noise_nt,
            high: 2.0 * map.noise_nt,
        }],
    }
}

fn x_label(map: &Map) -> String {
    if map.unit.is_empty() { map.covariate.clone() } else { format!("{}, {}", map.covariate, map.unit) }
}

fn step(diagnosis: &Diagnosis, map: &Map) -> Option<Named> {
    let step = diagnosis.steps.get(map.step)?;
    let axis = COMPONENTS[map.axis].to_uppercase();
    let figure = Figure {
        title: format!("Run {}: {} on {axis}", diagnosis.runs.first().map_or("", String::as_str), step.effect),
        caption: format!(
            "Measured minus modelled reading on the sensor axis {axis}, every point predicted by a fit that did not see it: above without {}, \
             below with it. Root mean square {:.3} and {:.3} nT; the band is twice the noise of a mean.",
            step.effect, step.gap_before.rms_nt[map.axis], step.gap_after.rms_nt[map.axis]
        ),
        x_label: x_label(map),
        x_scale: Scale::Linear,
        panels: vec![
            panel(map, "without, nT".to_owned(), &map.before_nt, Style::Y, "without the effect"),
            panel(map, "with, nT".to_owned(), &map.after_nt, Style::X, "with the effect"),
        ],
    };
    STEMS.get(map.step).map(|stem| Named { stem, figure })
}

fn quiet(diagnosis: &Diagnosis) -> Option<Named> {
    let first = diagnosis.maps.first()?;
    let styles = [Style::X, Style::Y, Style::Z];
    let figure = Figure {
        title: format!("Run {}: no missing effect", diagnosis.runs.first().map_or("", String::as_str)),
        caption: "Measured minus modelled reading along the sensor axes, every point predicted by a fit that did not see it; the bands are twice \
                  the noise of a mean."
            .to_owned(),
        x_label: x_label(first),
        x_scale: Scale::Linear,
        panels: diagnosis
            .maps
            .iter()
            .map(|map| {
                let axis = COMPONENTS[map.axis].to_uppercase();
                panel(map, format!("{axis}, nT"), &map.before_nt, styles[map.axis], &axis)
            })
            .collect(),
    };
    Some(Named { stem: "residuals", figure })
}
