//! The figures of the facility's own calibration.

use super::parts::{COIL, Named, SENSOR, STYLES, panels};
use super::{Band, Figure, Marks, Panel, Scale, Series, Style};
use crate::measure::coil::{Residual, Scalar, Tilt};
use crate::model::facility_calibration::SensorValues;

const ARCSEC: f64 = 3600.0;

/// Residuals of the moduli against the settings of the three axes.
#[must_use]
pub fn scalar(result: &Scalar) -> Vec<Named> {
    let p = &result.found;
    let std_nt = p.quality.residual_std_nt;
    let figure = |axis: usize| {
        Figure {
        title: format!("Moduli, measured minus modelled, against the {} setting, {}", COIL[axis], p.used.join(", ")),
        caption:
            "What the nine parameters of the coil system leave of the moduli. Without a trend it is the noise of the scalar magnetometer; a \
                  trend can come from a heading error or from currents that are not proportional to the settings. Crosses mark rows that stand out and are not used."
                .to_owned(),
        x_label: format!("{} setting, EU", COIL[axis]),
        x_scale: Scale::Linear,
        panels: vec![Panel {
            y_label: "residual of the modulus, nT".to_owned(),
            y_scale: Scale::Linear,
            series: vec![
                Series {
                    label: "used".to_owned(),
                    style: STYLES[axis],
                    marks: Marks::Points(points(result, axis, true).into_iter().map(|(x, y)| (x, y, None)).collect()),
                },
                Series {
                    label: if p.outlier.is_empty() { String::new() } else { "not used".to_owned() },
                    style: STYLES[axis],
                    marks: Marks::Rejected(points(result, axis, false)),
                },
            ],
            bands: vec![Band { label: format!("±1 standard deviation, {std_nt:.3} nT"), low: -std_nt, high: std_nt }],
        }],
    }
    };
    let [x, y, z] = [0, 1, 2].map(figure);
    vec![
        Named { stem: "residuals_x", figure: x },
        Named { stem: "residuals_y", figure: y },
        Named { stem: "residuals_z", figure: z },
    ]
}

fn points(result: &Scalar, axis: usize, used: bool) -> Vec<(f64, f64)> {
    result.rows.iter().filter(|r| r.used == used).map(|r| (r.setting_eu[axis], r.residual_nt)).collect()
}

/// Names in place of the numbers of the x axis.
fn named(names: &[(f64, String)]) -> Series {
    Series { label: String::new(), style: Style::Reference, marks: Marks::Names(names.to_vec()) }
}

/// Residual fields state by state.
#[must_use]
pub fn residual(result: &Residual) -> Vec<Named> {
    let p = &result.found;
    let names: Vec<(f64, String)> = p.state.iter().enumerate().map(|(i, s)| (i as f64 + 1.0, s.name.clone())).collect();
    let figure = Figure {
        title: format!("Residual field of the coil system, {}", p.used.join(", ")),
        caption: "Half the difference of the moduli at plus and minus F per coil axis, with its standard uncertainty.".to_owned(),
        x_label: "state of the facility".to_owned(),
        x_scale: Scale::Linear,
        panels: panels(|axis| Panel {
            y_label: format!("{} field, nT", COIL[axis]),
            y_scale: Scale::Linear,
            series: vec![
                named(&names),
                Series {
                    label: format!("{} coil axis", COIL[axis]),
                    style: STYLES[axis],
                    marks: Marks::Points(
                        p.state
                            .iter()
                            .enumerate()
                            .flat_map(|(i, s)| s.axis.iter().map(move |a| (i as f64 + 1.0, a)))
                            .filter(|(_, a)| a.axis == COIL[axis])
                            .map(|(x, a)| (x, a.residual_nt, Some(a.std_nt)))
                            .collect(),
                    ),
                },
            ],
            bands: vec![],
        }),
    };
    vec![Named { stem: "fields", figure }]
}

/// Sensor parameters of the orientations against their mean, before and after the correction of the facility.
#[must_use]
pub fn tilt(result: &Tilt) -> Vec<Named> {
    let p = &result.found;
    let names: Vec<(f64, String)> = p.orientation.iter().enumerate().map(|(g, o)| (g as f64 + 1.0, o.axes.clone())).collect();
    let figure = |what: &str, unit: &str, std: f64, components: [&str; 3], get: &dyn Fn(&SensorValues, usize) -> f64| Figure {
        title: format!("{what} of sensor {} in {} orientations", p.sensor, p.orientation.len()),
        caption: format!(
            "Deviation from the mean of the used orientations with the facility as it was and with the corrected facility; bars are the \
             standard deviation of one value of one orientation. {}",
            if p.orientation.iter().all(|o| o.used) {
                "All orientations are used."
            } else {
                "Crosses mark orientations that are not used."
            }
        ),
        x_label: "orientation: sensor axes along the coil axes X, Y, Z".to_owned(),
        x_scale: Scale::Linear,
        panels: panels(|i| {
            let series = |label: &str, style: Style, of: &dyn Fn(usize) -> SensorValues| {
                let values: Vec<f64> = (0..p.orientation.len()).map(|g| get(&of(g), i)).collect();
                let used: Vec<f64> = values.iter().zip(&p.orientation).filter(|(_, o)| o.used).map(|(v, _)| *v).collect();
                let mean = used.iter().sum::<f64>() / used.len() as f64;
                let points = |wanted: bool| {
                    let all = values.iter().enumerate().filter(move |(g, _)| p.orientation[*g].used == wanted);
                    all.map(move |(g, v)| (g as f64 + 1.0, v - mean))
                };
                let bars = points(true).map(|(x, y)| (x, y, Some(std).filter(|s| s.is_finite()))).collect();
                [
                    Series { label: label.to_owned(), style, marks: Marks::Points(bars) },
                    Series { label: String::new(), style, marks: Marks::Rejected(points(false).collect()) },
                ]
            };
            Panel {
                y_label: format!("{}, {unit}", components[i]),
                y_scale: Scale::Linear,
                series: [named(&names)]
                    .into_iter()
                    .chain(series("facility as it was", Style::Second, &|g| p.orientation[g].before))
                    .chain(series("facility corrected", Style::Single, &|g| p.orientation[g].after))
                    .collect(),
                bands: vec![],
            }
        }),
    };
    let [scale, offset, angle] = p.residual_std;
    vec![
        Named { stem: "sensitivity", figure: figure("Sensitivity", "1e-6", 1e6 * scale, SENSOR, &|v, i| 1e6 * v.scale[i]) },
        Named { stem: "offset", figure: figure("Offset", "nT", offset, SENSOR, &|v, i| v.offset_nt[i]) },
        Named {
            stem: "angles",
            figure: figure("Angles", "arc seconds", ARCSEC * angle, ["xy", "xz", "yz"], &|v, i| ARCSEC * v.angles_deg[i]),
        },
    ]
}
