//! The figures of a continuous temperature sweep.

use super::parts::{COIL, Named, STYLES, TimeAxis, panels};
use super::thermal::{Points, polynomials};
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::data::across::LagForm;
use crate::measure::sweep::{Sweep, WindowFit};
use crate::measure::thermal::QuantityFit;
use crate::model::polynomial::value;

/// All figures.
#[must_use]
pub fn figures(sweep: &Sweep) -> Vec<Named> {
    let of = format!("run {}", sweep.run.id);
    let end_s = sweep.blocks.iter().map(|b| b.t_s).fold(0.0, f64::max);
    let time = TimeAxis::of(end_s, sweep.run.start.as_ref());
    let figure = |family: &str, title: &str, symbol: &str| {
        let curves: Vec<&QuantityFit> = sweep.quantities.iter().filter(|c| c.found.name.starts_with(family)).collect();
        let points = Points { words: "sliding windows", have_residuals: false };
        polynomials(&curves, Some(&sweep.channel), &points, &format!("{title}, {of}"), symbol)
    };
    vec![
        Named { stem: "branches", figure: branches(sweep, &of) },
        Named { stem: "sensitivities", figure: figure("sigma", "Sensitivities", "σ") },
        Named { stem: "misalignment", figure: figure("xi", "Misalignment angles", "ξ") },
        Named { stem: "offset_and_residual_field", figure: figure("b_or", "Offset and residual field", "B_or") },
        Named { stem: "temperature", figure: temperature(sweep, &of, &time) },
        Named { stem: "residuals", figure: residuals(sweep, &of, &time) },
    ]
}

/// Whether the temperature of the polynomials has a lag; without one it is smoothed alone.
fn has_lag(sweep: &Sweep) -> bool {
    sweep.lag.form != LagForm::None.name()
}

/// Heating and cooling before and after the lag: how far the sensitivities are from their polynomials.
fn branches(sweep: &Sweep, of: &str) -> Figure {
    let curves: Vec<&QuantityFit> = sweep.quantities.iter().filter(|c| c.found.name.starts_with("sigma")).collect();
    let points = |which: usize, heating: bool| -> Vec<(f64, f64, Option<f64>)> {
        let off = |w: &WindowFit| {
            let t = w.temperature_degc[which];
            let each = curves.iter().enumerate().map(|(i, c)| 1e6 * (w.values[i] / value(&c.polynomial.coefficients, t) - 1.0));
            let std = (0..curves.len()).map(|i| w.std[i] * w.std[i]).sum::<f64>().sqrt() / curves.len() as f64;
            (t, each.sum::<f64>() / curves.len() as f64, std.is_finite().then_some(1e6 * std))
        };
        sweep.windows.iter().step_by(6).filter(|w| w.heating == heating).map(off).collect()
    };
    let panel = |which: usize, label: &str| Panel {
        y_label: format!("σ / polynomial - 1{label}, 1e-6"),
        y_scale: Scale::Linear,
        series: vec![
            Series { label: "heating".to_owned(), style: Style::Y, marks: Marks::Points(points(which, true)) },
            Series { label: "cooling".to_owned(), style: Style::X, marks: Marks::Points(points(which, false)) },
        ],
        bands: vec![],
    };
    Figure {
        title: format!("Heating and cooling, {of}"),
        caption: if has_lag(sweep) {
            format!(
                "Sensitivities of sliding windows against their polynomials, mean of the three components with its standard uncertainty, with \
                 the reading of channel {} and with its lag. A lag splits heating and cooling; the right one joins them.",
                sweep.channel
            )
        } else {
            format!(
                "Sensitivities of sliding windows against their polynomials, mean of the three components with its standard uncertainty, with \
                 the reading of channel {}; no lag was found or taken. A lag would split heating and cooling.",
                sweep.channel
            )
        },
        x_label: format!("sensor temperature {}, °C", sweep.channel),
        x_scale: Scale::Linear,
        panels: if has_lag(sweep) { vec![panel(0, ", without lag"), panel(1, ", with lag")] } else { vec![panel(0, "")] },
    }
}

fn temperature(sweep: &Sweep, of: &str, time: &TimeAxis) -> Figure {
    let line =
        |of: &dyn Fn(&WindowFit) -> f64| -> Vec<(f64, f64)> { sweep.windows.iter().map(|w| (time.at(w.t_s), of(w))).collect() };
    let panel = |y_label: &str, label: &str, points: Vec<(f64, f64)>| Panel {
        y_label: y_label.to_owned(),
        y_scale: Scale::Linear,
        series: vec![Series { label: label.to_owned(), style: Style::Single, marks: Marks::Line(points) }],
        bands: vec![],
    };
    let read = panel("temperature, °C", &sweep.channel, line(&|w| w.temperature_degc[0]));
    let difference = panel("with lag - as read, K", "", line(&|w| w.temperature_degc[1] - w.temperature_degc[0]));
    Figure {
        title: format!("Temperature of the sensor, {of}"),
        caption: if has_lag(sweep) {
            format!("Channel {}, means of the sliding windows as read, and what the lag adds.", sweep.channel)
        } else {
            format!("Channel {}, means of the sliding windows as read; no lag was found or taken.", sweep.channel)
        },
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: if has_lag(sweep) { vec![read, difference] } else { vec![read] },
    }
}

fn residuals(sweep: &Sweep, of: &str, time: &TimeAxis) -> Figure {
    Figure {
        title: format!("Residuals of the joint fit, {of}"),
        caption: "Applied field minus modelled measurement, coil coordinates, one point per setting.".to_owned(),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|axis| Panel {
            y_label: format!("{} residual, nT", COIL[axis]),
            y_scale: Scale::Linear,
            series: vec![Series {
                label: format!("{} residual", COIL[axis]),
                style: STYLES[axis],
                marks: Marks::Points(sweep.blocks.iter().map(|b| (time.at(b.t_s), b.residual_nt[axis], None)).collect()),
            }],
            bands: vec![],
        }),
    }
}
