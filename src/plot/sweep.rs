//! The figures of a continuous temperature sweep.

use super::parts::{COIL, Named, STYLES, TimeAxis, panels};
use super::thermal::polynomials;
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
    let time = TimeAxis::of(end_s);
    let figure = |family: &str, title: &str, symbol: &str| {
        let curves: Vec<&QuantityFit> = sweep.quantities.iter().filter(|c| c.found.name.starts_with(family)).collect();
        polynomials(&curves, Some(&sweep.channel), "sliding windows", &format!("{title}, {of}"), symbol)
    };
    vec![
        Named { stem: "branches", figure: branches(sweep, &of) },
        Named { stem: "sensitivities", figure: figure("sigma", "Sensitivities", "σ") },
        Named { stem: "misalignment", figure: figure("xi", "Misalignment angles", "ξ") },
        Named { stem: "offset_and_residual_field", figure: figure("b_or", "Offset and residual field", "B_or") },
        Named { stem: "temperature", figure: temperature(sweep, &of, time) },
        Named { stem: "residuals", figure: residuals(sweep, &of, time) },
    ]
}

/// Heating and cooling before and after the lag: how far the sensitivities are from their polynomials.
fn branches(sweep: &Sweep, of: &str) -> Figure {
    let curves: Vec<&QuantityFit> = sweep.quantities.iter().filter(|c| c.found.name.starts_with("sigma")).collect();
    let points = |which: usize, heating: bool| -> Vec<(f64, f64, Option<f64>)> {
        let off = |w: &WindowFit| {
            let t = w.temperature_degc[which];
            let each = curves.iter().enumerate().map(|(i, c)| 1e6 * (w.values[i] / value(&c.polynomial.coefficients, t) - 1.0));
            (t, each.sum::<f64>() / curves.len() as f64, None)
        };
        sweep.windows.iter().step_by(6).filter(|w| w.heating == heating).map(off).collect()
    };
    let panel = |which: usize, label: &str| Panel {
        y_label: format!("σ - polynomial {label}, 1e-6"),
        y_scale: Scale::Linear,
        series: vec![
            Series { label: "heating".to_owned(), style: Style::Y, marks: Marks::Points(points(which, true)) },
            Series { label: "cooling".to_owned(), style: Style::X, marks: Marks::Points(points(which, false)) },
        ],
        bands: vec![],
    };
    let (with, panels) = if has_lag(sweep) {
        ("the reading of channel {} and with its lag", vec![panel(0, "without lag"), panel(1, "with lag")])
    } else {
        ("the reading of channel {}, for which no lag is claimed", vec![panel(0, "as read")])
    };
    Figure {
        title: format!("Heating and cooling, {of}"),
        caption: format!(
            "Sensitivities of sliding windows against their polynomials, mean of the components, with {}. A lag splits the branches; the right \
             one joins them.",
            with.replace("{}", &sweep.channel)
        ),
        x_label: format!("sensor temperature {}, °C", sweep.channel),
        x_scale: Scale::Linear,
        panels,
    }
}

/// Whether the temperatures of the polynomials have a lag.
fn has_lag(sweep: &Sweep) -> bool {
    sweep.lag.form != LagForm::None.name()
}

fn temperature(sweep: &Sweep, of: &str, time: TimeAxis) -> Figure {
    let line = |which: usize| sweep.windows.iter().map(|w| (time.at(w.t_s), w.temperature_degc[which])).collect();
    let mut series = vec![Series { label: "as read".to_owned(), style: Style::Single, marks: Marks::Line(line(0)) }];
    let caption = if has_lag(sweep) {
        series.push(Series { label: "with lag".to_owned(), style: Style::Second, marks: Marks::Line(line(1)) });
        format!("Channel {}, means of the sliding windows, as read and with the lag.", sweep.channel)
    } else {
        format!("Channel {}, means of the sliding windows; no lag is claimed.", sweep.channel)
    };
    Figure {
        title: format!("Temperature of the sensor, {of}"),
        caption,
        x_label: time.label.to_owned(),
        x_scale: Scale::Linear,
        panels: vec![Panel { y_label: "temperature, °C".to_owned(), y_scale: Scale::Linear, series, bands: vec![] }],
    }
}

fn residuals(sweep: &Sweep, of: &str, time: TimeAxis) -> Figure {
    Figure {
        title: format!("Residuals of the joint fit, {of}"),
        caption: "Applied field minus modelled measurement, coil coordinates, one point per setting.".to_owned(),
        x_label: time.label.to_owned(),
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
