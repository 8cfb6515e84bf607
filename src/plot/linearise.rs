//! The figures of a linearisation: residuals of three sensor axes against the field along three coil axes (CH-GFZ-TR-2601 figure 7-2).

use super::parts::{COIL, Named, SENSOR, STYLES, panels};
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::measure::linearise::{BinMean, Linearised};

/// Nine panels: a figure per coil axis with a panel per sensor axis.
#[must_use]
pub fn figures(result: &Linearised) -> Vec<Named> {
    let stems = ["residuals_coil_x", "residuals_coil_y", "residuals_coil_z"];
    stems.into_iter().enumerate().map(|(coil, stem)| Named { stem, figure: against(result, coil) }).collect()
}

fn against(result: &Linearised, coil: usize) -> Figure {
    let p = &result.shared;
    let runs = match p.used.as_slice() {
        [one] => format!("run {one}"),
        several => format!("{} runs", several.len()),
    };
    let means = |label: &str, style: Style, bins: &[BinMean]| Series {
        label: label.to_owned(),
        style,
        marks: Marks::Points(bins.iter().map(|b| (b.field_nt, b.residual_nt, b.std_nt)).collect()),
    };
    Figure {
        title: format!("Residuals of {} {} against the {} field, {runs}", p.sensor, p.mode, COIL[coil]),
        caption: format!(
            "Applied field minus modelled measurement along the sensor axes, with the linearisation, and means ± standard errors over \
             parts of the {} field. What is left along the sensor axis itself is of higher order, across it a transverse effect.",
            COIL[coil]
        ),
        x_label: format!("applied {} field, nT", COIL[coil]),
        x_scale: Scale::Linear,
        panels: panels(|sensor| {
            let series = result.panels.get(3 * sensor + coil).map_or_else(Vec::new, |data| {
                vec![
                    Series {
                        label: format!("{} residual", SENSOR[sensor]),
                        style: STYLES[sensor],
                        marks: Marks::Points(data.points.iter().map(|[field, residual]| (*field, *residual, None)).collect()),
                    },
                    means("mean without linearisation", Style::Second, &data.before),
                    means("mean with it", Style::Single, &data.after),
                ]
            });
            Panel { y_label: format!("{} residual, nT", SENSOR[sensor]), y_scale: Scale::Linear, series, bands: vec![] }
        }),
    }
}
