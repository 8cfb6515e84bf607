//! The figures of an offset measurement.

use super::parts::{COIL, Named, SENSOR, STYLES, TimeAxis, panels, temperatures};
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::measure::offset::Offset;

/// Up to so many visits the axis has the names of the positions, otherwise the time.
const NAMED: usize = 12;

/// All figures.
#[must_use]
pub fn figures(offset: &Offset) -> Vec<Named> {
    let id = &offset.found.run.id;
    let end_s = offset.plateaus.iter().map(|p| p.setting.t_end_s).fold(0.0, f64::max);
    let time = TimeAxis::of(end_s, offset.found.run.start.as_ref());
    let mut list = vec![
        Named { stem: "applied_fields", figure: applied(offset, id, &time) },
        Named { stem: "zero_levels", figure: zero_levels(offset, id, &time) },
    ];
    list.extend(temperatures(id, &offset.temperatures, &time, "the offsets hold for its mean"));
    list
}

fn applied(offset: &Offset, id: &str, time: &TimeAxis) -> Figure {
    let positions: Vec<String> = offset.found.visit.iter().map(|v| format!("{} ({})", v.position, v.axes.join(" "))).collect();
    Figure {
        title: format!("Applied fields, run {id}"),
        caption: format!("Reference field in coil coordinates. Positions in turn: {}.", positions.join(", ")),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|axis| Panel {
            y_label: format!("{} field, nT", COIL[axis]),
            y_scale: Scale::Linear,
            series: vec![Series {
                label: format!("{} coil axis", COIL[axis]),
                style: STYLES[axis],
                marks: Marks::Steps(
                    offset
                        .plateaus
                        .iter()
                        .map(|p| (time.at(p.setting.t_start_s), time.at(p.setting.t_end_s), p.setting.field.0[axis]))
                        .collect(),
                ),
            }],
            bands: vec![],
        }),
    }
}

fn zero_levels(offset: &Offset, id: &str, time: &TimeAxis) -> Figure {
    let p = offset;
    let named = p.found.visit.len() <= NAMED;
    let turns = || p.found.visit.iter().enumerate();
    let names: Vec<(f64, String)> =
        turns().map(|(i, v)| (i as f64 + 1.0, format!("{}: {}", v.position, v.axes.join(" ")))).collect();
    Figure {
        title: format!("Readings at zero applied field, run {id}"),
        caption: format!(
            "Zero level in positions {} in turn (the coil axes along which x, y, z look), with its standard uncertainty, which may be smaller than \
             the mark, and the offset of the sensor. A level lies beside the offset by the residual field along the coil axis that the component looks \
             at, so that two levels along opposite directions of one axis stand on both sides of it; what a position that is not turned by exactly 180° \
             sees of the residual fields along the other axes comes to that.",
            p.found.visit.iter().map(|v| format!("{} ({})", v.position, v.axes.join(" "))).collect::<Vec<_>>().join(", ")
        ),
        x_label: if named { "visit, in the order of time".to_owned() } else { time.label.clone() },
        x_scale: Scale::Linear,
        panels: panels(|axis| {
            let place = |i: usize, t_s: f64| if named { i as f64 + 1.0 } else { time.at(t_s) };
            let levels =
                turns().map(|(i, v)| (place(i, 0.5 * (v.time_s[0] + v.time_s[1])), v.reading_ent[axis], Some(v.std_ent[axis])));
            let span = |value: f64| {
                let first = p.found.visit.first().map_or(0.0, |v| place(0, v.time_s[0]));
                let last = p.found.visit.last().map_or(0.0, |v| place(p.found.visit.len() - 1, v.time_s[1]));
                vec![(first, value), (last, value)]
            };
            Panel {
                y_label: format!("{} reading, enT", SENSOR[axis]),
                y_scale: Scale::Linear,
                series: vec![
                    Series {
                        label: format!("{} zero level", SENSOR[axis]),
                        style: STYLES[axis],
                        marks: Marks::Points(levels.collect()),
                    },
                    Series {
                        label: if p.values.offset_ent[axis].is_finite() { "offset".to_owned() } else { String::new() },
                        style: Style::Reference,
                        marks: Marks::Line(span(p.values.offset_ent[axis])),
                    },
                    Series {
                        label: String::new(),
                        style: Style::Reference,
                        marks: Marks::Names(if named { names.clone() } else { Vec::new() }),
                    },
                ],
                bands: vec![],
            }
        }),
    }
}
