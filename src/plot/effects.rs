//! Figures of an effect of the catalogue: its contribution to the readings of an example run.

use super::parts::Named;
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::data::units::{COMPONENTS, three_digits};
use crate::diagnose::signature::{Explained, Point, Signature};

/// The contribution against what it follows, and against time; none where the readings of one run do not show the effect.
#[must_use]
pub fn figures(explained: &Explained) -> Vec<Named> {
    let Some(signature) = &explained.example else { return Vec::new() };
    let over = if signature.unit.is_empty() {
        signature.covariate.clone()
    } else {
        format!("{}, {}", signature.covariate, signature.unit)
    };
    vec![
        Named { stem: "covariate", figure: figure(explained, signature, &signature.covariate, over, false, |p| p.covariate) },
        Named { stem: "time", figure: figure(explained, signature, "time", "time, s".to_owned(), true, |p| p.t_s) },
    ]
}

fn figure(
    explained: &Explained,
    signature: &Signature,
    over: &str,
    x_label: String,
    in_time: bool,
    x: impl Fn(&Point) -> f64,
) -> Figure {
    let values: Vec<String> = signature
        .parameters
        .iter()
        .map(|(name, value, unit)| format!("{name} = {} {unit}", three_digits(*value)))
        .chain(signature.form.shape.iter().map(|(name, value, unit)| format!("{name} = {value} {unit}")))
        .collect();
    let panel = |a: usize| {
        let own: Vec<(f64, f64)> = signature.points.iter().map(|p| (x(p), p.contribution_nt[a])).collect();
        let marks = if in_time && signature.sampled {
            Marks::Line(own)
        } else {
            Marks::Points(own.into_iter().map(|(x, y)| (x, y, None)).collect())
        };
        Panel {
            y_label: format!("{}, nT", COMPONENTS[a]),
            y_scale: Scale::Linear,
            series: vec![Series { label: COMPONENTS[a].to_owned(), style: [Style::X, Style::Y, Style::Z][a], marks }],
            bands: Vec::new(),
        }
    };
    // An axis on which nothing happens needs no panel.
    let acts = |a: &usize| signature.points.iter().any(|p| p.contribution_nt[*a] != 0.0);
    Figure {
        title: format!("{}: contribution to the readings against {over}", explained.effect),
        caption: format!(
            "Form `{}` along the sensor axes, 1 nT where it is largest: {}. Example run: {}.",
            signature.form.form,
            values.join(", "),
            signature.run
        ),
        x_label,
        x_scale: Scale::Linear,
        panels: (0..3).filter(acts).map(panel).collect(),
    }
}
