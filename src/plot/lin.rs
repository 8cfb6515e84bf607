//! The figures of a linear calibration, in the order of BC-MAG-TR-0085 section 3.4.1 (figures 7 to 14).

use super::parts::{COIL, Named, SENSOR, STYLES, TimeAxis, panels, temperatures};
use super::{Band, Column, Figure, Marks, Panel, Scale, Series};
use crate::measure::lin::{Block, Lin};
use std::collections::BTreeMap;

/// All eight figures.
#[must_use]
pub fn figures(lin: &Lin) -> Vec<Named> {
    let id = &lin.calibration.run.id;
    let end_s = lin.blocks.iter().map(|b| b.plateau.setting.t_end_s).fold(0.0, f64::max);
    let time = TimeAxis::of(end_s, lin.calibration.run.start.as_ref());
    let [x, y, z] = [0, 1, 2].map(|axis| residuals_against_field(lin, axis));
    let mut list = vec![
        Named { stem: "applied_fields", figure: applied(lin, id, &time) },
        Named { stem: "measured_data", figure: measured(lin, id, &time) },
        Named { stem: "differences", figure: differences(lin, id, &time) },
        Named { stem: "residuals_field_x", figure: x },
        Named { stem: "residuals_field_y", figure: y },
        Named { stem: "residuals_field_z", figure: z },
    ];
    list.extend(temperatures(id, &lin.temperatures, &time, "the calibration holds for its mean"));
    list
}

fn applied(lin: &Lin, id: &str, time: &TimeAxis) -> Figure {
    let used = lin.calibration.quality.blocks_used;
    Figure {
        title: format!("Applied fields, run {id}"),
        caption: if used == lin.blocks.len() {
            format!("Reference field in coil coordinates; all {used} settings are used.")
        } else {
            format!(
                "Reference field in coil coordinates; {used} of {} settings are used, crosses mark the others.",
                lin.blocks.len()
            )
        },
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|axis| {
            let setting = |b: &Block| {
                let s = &b.plateau.setting;
                (time.at(s.t_start_s), time.at(s.t_end_s), s.field.0[axis])
            };
            Panel {
                y_label: format!("{} field, nT", COIL[axis]),
                y_scale: Scale::Linear,
                series: vec![
                    Series {
                        label: format!("{} coil axis", COIL[axis]),
                        style: STYLES[axis],
                        marks: Marks::Steps(lin.blocks.iter().map(setting).collect()),
                    },
                    rejected(lin, |b| Some((time.at(b.plateau.t_s()), b.plateau.setting.field.0[axis])), axis),
                ],
                bands: vec![],
            }
        }),
    }
}

/// Plateaus that are not used; nothing if there are none.
fn rejected(lin: &Lin, at: impl Fn(&Block) -> Option<(f64, f64)>, axis: usize) -> Series {
    let points: Vec<(f64, f64)> = lin.blocks.iter().filter(|b| b.plateau.dropped.is_some()).filter_map(at).collect();
    let label = if points.is_empty() { String::new() } else { "not used".to_owned() };
    Series { label, style: STYLES[axis], marks: Marks::Rejected(points) }
}

fn measured(lin: &Lin, id: &str, time: &TimeAxis) -> Figure {
    let samples = lin.samples.as_deref();
    let caption = match samples {
        Some(_) => {
            "Raw readings along the sensor axes; for every column of the picture the range from the smallest to the largest sample."
        }
        None if lin.linearisation.is_some() => {
            "Mean linearised readings of the plateaus along the sensor axes; the file brings no samples."
        }
        None => "Mean raw readings of the plateaus along the sensor axes; the file brings no samples.",
    };
    Figure {
        title: format!("Measured data, run {id}"),
        caption: caption.to_owned(),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|axis| {
            let marks = match samples {
                Some(columns) => Marks::Envelope(
                    columns.iter().map(|c| Column { x: time.at(c.t_s), min: c.min.0[axis], max: c.max.0[axis] }).collect(),
                ),
                None => Marks::Points(
                    lin.blocks
                        .iter()
                        .map(|b| (time.at(b.plateau.t_s()), b.plateau.mean.0[axis], b.plateau.std_ent.map(|s| s[axis])))
                        .collect(),
                ),
            };
            Panel {
                y_label: format!("{} reading, enT", SENSOR[axis]),
                y_scale: Scale::Linear,
                series: vec![Series { label: format!("{} component", SENSOR[axis]), style: STYLES[axis], marks }],
                bands: vec![],
            }
        }),
    }
}

/// Residuals of one coil component with their noise and the band of one standard deviation.
fn residual_panel(lin: &Lin, axis: usize, x: impl Fn(&Block) -> f64) -> Panel {
    let std_nt = lin.calibration.quality.residual_nt.std[axis];
    let used = lin.blocks.iter().filter(|b| b.plateau.dropped.is_none());
    let points: Vec<(f64, f64, Option<f64>)> =
        used.filter_map(|b| Some((x(b), b.residual_coil_nt?.0[axis], b.standard_error_coil_nt.map(|e| e[axis])))).collect();
    // As much room above zero as below.
    let farthest = points.iter().map(|(_, y, error)| y.abs() + error.unwrap_or(0.0)).fold(std_nt, f64::max);
    let places: Vec<f64> = points.iter().map(|p| p.0).collect();
    let both_sides = places.first().map(|x| vec![(*x, -farthest), (*x, farthest)]).unwrap_or_default();
    Panel {
        y_label: format!("{} residual, nT", COIL[axis]),
        y_scale: Scale::Linear,
        series: vec![
            Series { label: String::new(), style: STYLES[axis], marks: Marks::Points(points) },
            Series { label: String::new(), style: STYLES[axis], marks: Marks::Shown(both_sides) },
            rejected(lin, |b| Some((x(b), b.residual_coil_nt?.0[axis])), axis),
        ],
        bands: vec![Band { label: format!("±1 standard deviation, {std_nt:.3} nT"), low: -std_nt, high: std_nt }],
    }
}

/// What the bars of residuals are, if there are any.
fn bars(lin: &Lin) -> &'static str {
    if lin.blocks.iter().any(|b| b.standard_error_coil_nt.is_some()) {
        " Bars are standard errors of the means by the samples, often smaller than the marks."
    } else {
        ""
    }
}

fn differences(lin: &Lin, id: &str, time: &TimeAxis) -> Figure {
    Figure {
        title: format!("Differences of applied field and model, run {id}"),
        caption: format!(
            "Applied field minus modelled measurement, coil coordinates; the residuals of a diagnosis have the other sign. Points that follow one another without scatter show a \
             drift that the offset trend does not describe.{}",
            bars(lin)
        ),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|axis| residual_panel(lin, axis, |b| time.at(b.plateau.t_s()))),
    }
}

fn residuals_against_field(lin: &Lin, field_axis: usize) -> Figure {
    let axis = COIL[field_axis];
    let (aside, spread) = side_by_side(lin, field_axis);
    let spread = if spread {
        " Settings with one field are spread over 4 % of the axis, so that they do not hide each other; how they are spread says nothing."
    } else {
        ""
    };
    Figure {
        title: format!("Residuals against the {axis} field, run {}", lin.calibration.run.id),
        caption: format!(
            "Applied field minus modelled measurement, which has the other sign than the residuals of a diagnosis, against the applied {axis} \
             field. A curve means non-linearity, in another \
             component than {axis} a transverse effect.{spread}{}",
            bars(lin)
        ),
        x_label: format!("applied {axis} field, nT"),
        x_scale: Scale::Linear,
        panels: panels(|component| {
            residual_panel(lin, component, |b| {
                b.plateau.setting.field.0[field_axis] + aside.get(&b.plateau.index).unwrap_or(&0.0)
            })
        }),
    }
}

/// From so many settings with one field on they are drawn side by side.
const PILE: usize = 8;
/// Half of the width that they take, as a part of the range of fields.
const PILE_WIDTH: f64 = 0.02;

/// How far from its field a setting is drawn, nT, by its index: most settings of a programme that drives one axis after another have no
/// field along two of them, and their points would lie on each other. And whether any is.
fn side_by_side(lin: &Lin, field_axis: usize) -> (BTreeMap<usize, f64>, bool) {
    let field = |b: &Block| b.plateau.setting.field.0[field_axis];
    let fields = || lin.blocks.iter().map(field).filter(|f| f.is_finite());
    let (low, high) = (fields().fold(f64::INFINITY, f64::min), fields().fold(f64::NEG_INFINITY, f64::max));
    let mut piles: BTreeMap<u64, Vec<usize>> = BTreeMap::new();
    for block in &lin.blocks {
        // Plus and minus zero are one field.
        piles.entry((field(block) + 0.0).to_bits()).or_default().push(block.plateau.index);
    }
    let mut aside = BTreeMap::new();
    for pile in piles.values().filter(|pile| pile.len() >= PILE && high > low) {
        for (k, index) in pile.iter().enumerate() {
            // In the order of time a drift of the offset would pass for a dependence on the field: places follow one another here and there.
            let place = f64::from(u32::try_from(k).unwrap_or(u32::MAX).reverse_bits()) / f64::from(u32::MAX) * 2.0 - 1.0;
            aside.insert(*index, PILE_WIDTH * (high - low) * place);
        }
    }
    let any = !aside.is_empty();
    (aside, any)
}
