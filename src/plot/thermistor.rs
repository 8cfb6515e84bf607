//! The figure of a thermistor's calibration table.

use super::parts::Named;
use super::{Band, Figure, Marks, Panel, Scale, Series, Style};
use crate::data::thermistor::FittedTableRow;
use crate::measure::thermistor::Thermistor;

/// A value with its standard uncertainty, if the row has one.
type Shown = Option<(f64, Option<f64>)>;

/// Residuals against temperature: those of the polynomial, and above them those of the one given for comparison.
#[must_use]
pub fn figures(thermistor: &Thermistor) -> Vec<Named> {
    let p = thermistor;
    let series = |label: String, style: Style, get: &dyn Fn(&FittedTableRow) -> Shown| {
        let points = p.row.iter().filter_map(|r| get(r).map(|(value, std)| (r.t_degc, value, std))).collect();
        Series { label, style, marks: Marks::Points(points) }
    };
    let mut panels = Vec::new();
    let mut caption = format!("Temperature of the table minus polynomial in {}.", p.polynomial.signal_unit);
    if let Some(c) = &p.compared {
        let order = c.coefficients.len() - 1;
        panels.push(Panel {
            y_label: "residual, °C".to_owned(),
            y_scale: Scale::Linear,
            series: vec![
                series(format!("given, order {order}"), Style::Second, &|r| r.compared_residual_degc.map(|v| (v, None))),
                Series {
                    label: format!("best, order {order}"),
                    style: Style::Reference,
                    marks: Marks::Line(p.row.iter().filter_map(|r| r.best_residual_degc.map(|v| (r.t_degc, v))).collect()),
                },
            ],
            bands: vec![],
        });
        caption.push_str(&format!(
            " The given polynomial leaves up to {:.3} °C, the best one of its order {:.3} °C.",
            c.residual_max_degc, c.best_max_degc
        ));
    }
    panels.push(Panel {
        y_label: "residual, °C".to_owned(),
        y_scale: Scale::Linear,
        series: vec![series(format!("order {} ± its uncertainty", p.polynomial.order), Style::X, &|r| {
            Some((r.residual_degc, Some(r.std_degc).filter(|s| s.is_finite())))
        })],
        bands: vec![Band {
            label: format!("±{} °C", p.polynomial.within_degc),
            low: -p.polynomial.within_degc,
            high: p.polynomial.within_degc,
        }],
    });
    caption.push_str(&format!(" Order {} leaves up to {:.4} °C.", p.polynomial.order, p.polynomial.residual_max_degc));
    let figure = Figure {
        title: format!("Residuals of the thermistor table {}", p.polynomial.table),
        caption,
        x_label: "temperature, °C".to_owned(),
        x_scale: Scale::Linear,
        panels,
    };
    vec![Named { stem: "residuals", figure }]
}
