//! The figures of a zero-field run.

use super::parts::{Named, SENSOR, STYLES, TimeAxis, panels, temperatures};
use super::{Column, Figure, Marks, Panel, Scale, Series, Style};
use crate::measure::null::{Null, STATED_HZ};

/// Stems of the figures of the readings against channels.
const AGAINST: [&str; 4] = ["correlation_1", "correlation_2", "correlation_3", "correlation_4"];

/// All figures.
#[must_use]
pub fn figures(null: &Null) -> Vec<Named> {
    let p = null;
    let id = &p.found.run.id;
    let time = TimeAxis::of(p.found.record.time_s[1], p.found.run.start.as_ref());
    let mut list = vec![
        Named { stem: "measured_data", figure: measured(null, id, &time) },
        Named { stem: "drift", figure: drift(null, id, &time) },
        Named { stem: "amplitude_density", figure: density(null, id) },
        Named { stem: "allan_deviation", figure: allan(null, id) },
    ];
    // Sensor temperature and variometer; without them the first channels there are.
    let main: Vec<&str> = match &p.found.together {
        Some(t) => t.channels.iter().map(String::as_str).collect(),
        None => p.found.channel.iter().map(|c| c.name.as_str()).collect(),
    };
    for (stem, name) in AGAINST.into_iter().zip(main) {
        list.extend(against(null, id, name).map(|figure| Named { stem, figure }));
    }
    list.extend(temperatures(id, &null.temperatures, &time, "the offset may follow it"));
    list
}

fn line(label: &str, style: Style, points: Vec<(f64, f64)>) -> Series {
    Series { label: label.to_owned(), style, marks: Marks::Line(points) }
}

fn measured(null: &Null, id: &str, time: &TimeAxis) -> Figure {
    let o = &null.found.offset;
    Figure {
        title: format!("Readings in zero field, run {id}"),
        caption: format!(
            "Raw readings along the sensor axes, for every column of the picture the range of the samples, with the drift of order {}.",
            o.order
        ),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|c| {
            let columns = null.samples.iter().flatten().map(|s| Column { x: time.at(s.t_s), min: s.min.0[c], max: s.max.0[c] });
            let drift = null.rows.iter().map(|r| (time.at(r.t_s()), r.drift_ent[c][0])).collect();
            Panel {
                y_label: format!("{} reading, enT", SENSOR[c]),
                y_scale: Scale::Linear,
                series: vec![
                    Series {
                        label: format!("{} component", SENSOR[c]),
                        style: STYLES[c],
                        marks: Marks::Envelope(columns.collect()),
                    },
                    line("drift", Style::Single, drift),
                ],
                bands: vec![],
            }
        }),
    }
}

fn drift(null: &Null, id: &str, time: &TimeAxis) -> Figure {
    let o = &null.found.offset;
    let (span, count) = match (null.rows.first(), null.rows.len()) {
        (Some(row), count) => (row.interval_s[1] - row.interval_s[0], count),
        (None, _) => (f64::NAN, 0),
    };
    Figure {
        title: format!("Offset and drift, run {id}"),
        caption: format!(
            "{count} means over {span:.1} s with the drift of order {} and its 95 % band, slow noise included. Means that wander about the \
             drift follow something else, temperature for example.",
            o.order
        ),
        x_label: time.label.clone(),
        x_scale: Scale::Linear,
        panels: panels(|c| {
            let at = |r: &crate::measure::null::Row| time.at(r.t_s());
            let means = null.rows.iter().map(|r| (at(r), r.mean_ent[c], None)).collect();
            let band = null.rows.iter().map(|r| {
                let [value, std] = r.drift_ent[c];
                (at(r), value - 1.96 * std, value + 1.96 * std)
            });
            Panel {
                y_label: format!("{} mean, enT", SENSOR[c]),
                y_scale: Scale::Linear,
                series: vec![
                    Series { label: String::new(), style: Style::Reference, marks: Marks::Ribbon(band.collect()) },
                    Series { label: format!("{} means", SENSOR[c]), style: STYLES[c], marks: Marks::Points(means) },
                    line("drift", Style::Reference, null.rows.iter().map(|r| (at(r), r.drift_ent[c][0])).collect()),
                ],
                bands: vec![],
            }
        }),
    }
}

fn density(null: &Null, id: &str) -> Figure {
    let p = null;
    let s = &p.found.spectrum;
    let values = [&s.x_ent_per_root_hz, &s.y_ent_per_root_hz, &s.z_ent_per_root_hz];
    let stated = p.found.density.as_ref().map_or_else(String::new, |d| {
        let [x, y, z] = d.ent_per_root_hz.map(|v| format!("{v:.3e}"));
        format!(" The points mark {STATED_HZ} Hz: {x}, {y}, {z} enT/√Hz.")
    });
    Figure {
        title: format!("Amplitude density of the noise, run {id}"),
        caption: format!(
            "Welch's method with Hann windows of several lengths, and its 95 % band; lines are left out.{stated} The thin line is white and 1/f \
             noise fitted."
        ),
        x_label: "frequency, Hz".to_owned(),
        x_scale: Scale::Logarithmic,
        panels: panels(|c| {
            let f = || s.frequency_hz.iter().copied().enumerate();
            let band = f().map(|(i, f)| (f, values[c][i] * s.low_factor[i], values[c][i] * s.high_factor[i])).collect();
            let (white, slow) = (p.found.corner.white_ent_per_root_hz[c], p.found.corner.slow_ent_per_root_hz[c]);
            let mut series = vec![
                Series { label: String::new(), style: STYLES[c], marks: Marks::Ribbon(band) },
                line(SENSOR[c], STYLES[c], f().map(|(i, f)| (f, values[c][i])).collect()),
            ];
            if white.is_finite() && slow.is_finite() {
                let label = if c == 0 { "white and 1/f" } else { "" };
                let model = f().map(|(_, f)| (f, (white * white + slow * slow / f).sqrt())).collect();
                series.push(line(label, Style::Reference, model));
            }
            if let Some(d) = &p.found.density {
                let label = if c == 0 { "1 Hz" } else { "" };
                let point = (d.frequency_hz, d.ent_per_root_hz[c], None);
                series.push(Series { label: label.to_owned(), style: Style::Single, marks: Marks::Points(vec![point]) });
            }
            Panel { y_label: format!("{}, enT/√Hz", SENSOR[c]), y_scale: Scale::Logarithmic, series, bands: vec![] }
        }),
    }
}

fn allan(null: &Null, id: &str) -> Figure {
    let a = &null.found.allan;
    let values = [&a.x_ent, &a.y_ent, &a.z_ent];
    let tau = || a.tau_s.iter().copied().enumerate();
    let mut series = Vec::new();
    for c in 0..3 {
        let band = tau().map(|(i, t)| (t, values[c][i] * a.low_factor[i], values[c][i] * a.high_factor[i])).collect();
        series.push(Series { label: String::new(), style: STYLES[c], marks: Marks::Ribbon(band) });
    }
    for c in 0..3 {
        series.push(line(SENSOR[c], STYLES[c], tau().map(|(i, t)| (t, values[c][i])).collect()));
        let points = tau().map(|(i, t)| (t, values[c][i], None)).collect();
        series.push(Series { label: String::new(), style: STYLES[c], marks: Marks::Points(points) });
    }
    // White noise of the first value of the lowest component.
    let first = values.iter().filter_map(|v| v.first()).copied().fold(f64::INFINITY, f64::min);
    if let (Some(t0), true) = (a.tau_s.first(), first.is_finite()) {
        series.push(line("τ^-1/2, white noise", Style::Reference, tau().map(|(_, t)| (t, first * (t0 / t).sqrt())).collect()));
    }
    Figure {
        title: format!("Allan deviation, run {id}"),
        caption: "Deviation of neighbouring means over the averaging time with its 95 % band. White noise falls with the root of the time, 1/f \
                  noise is level, a drift rises with the time."
            .to_owned(),
        x_label: "averaging time τ, s".to_owned(),
        x_scale: Scale::Logarithmic,
        panels: vec![Panel { y_label: "Allan deviation, enT".to_owned(), y_scale: Scale::Logarithmic, series, bands: vec![] }],
    }
}

fn against(null: &Null, id: &str, name: &str) -> Option<Figure> {
    let part = null.found.channel.iter().find(|c| c.name == name)?;
    let values = &null.channels.iter().find(|(n, _)| n == name)?.1;
    let known: Vec<(f64, usize)> =
        values.iter().copied().enumerate().filter(|(_, v)| v.is_finite()).map(|(i, v)| (v, i)).collect();
    let centre = known.iter().map(|(v, _)| v).sum::<f64>() / known.len() as f64;
    let low = known.iter().map(|(v, _)| *v).fold(f64::INFINITY, f64::min);
    let high = known.iter().map(|(v, _)| *v).fold(f64::NEG_INFINITY, f64::max);
    let unit = if part.unit == "K" { "°C" } else { &part.unit };
    // What the other channels explain is taken off: a common trend in time would look like a dependence.
    let beside = null.found.together.as_ref().and_then(|t| Some((t, t.channels.iter().position(|c| c == name)?)));
    let others: Vec<(usize, &Vec<f64>, f64)> = beside.map_or_else(Vec::new, |(t, own)| {
        let of = |(k, channel): (usize, &String)| {
            let values = &null.channels.iter().find(|(n, _)| n == channel)?.1;
            let known: Vec<f64> = values.iter().copied().filter(|v| v.is_finite()).collect();
            Some((k, values, known.iter().sum::<f64>() / known.len() as f64))
        };
        t.channels.iter().enumerate().filter(|(k, _)| *k != own).filter_map(of).collect()
    });
    let freed = |i: usize, c: usize| {
        let explained = |(k, values, centre): &(usize, &Vec<f64>, f64)| {
            beside.map_or(0.0, |(t, _)| t.coefficient_ent[*k][c] * (values[i] - centre))
        };
        null.rows[i].mean_ent[c] - others.iter().map(explained).sum::<f64>()
    };
    let names: Vec<&str> = beside
        .iter()
        .flat_map(|(t, own)| t.channels.iter().enumerate().filter(move |(k, _)| k != own))
        .map(|(_, n)| n.as_str())
        .collect();
    let caption = if names.is_empty() {
        format!("Means of the readings against those of channel {name}, and the straight line of this channel alone.")
    } else {
        format!(
            "One fit of the readings has {name} together with {}. The means are drawn without what the fit gives to these, and the line is what it \
             gives to {name}. The legend has its slope and, behind \"alone\", that of a fit with {name} only, which takes a trend that the channels \
             share for its own.",
            names.join(", ")
        )
    };
    Some(Figure {
        title: format!("Readings against {name}, run {id}"),
        caption,
        x_label: format!("{name}, {unit}"),
        x_scale: Scale::Linear,
        panels: panels(|c| {
            let own: Vec<(f64, f64)> = known.iter().map(|(v, i)| (*v, freed(*i, c))).filter(|(_, y)| y.is_finite()).collect();
            let mean = own.iter().map(|(_, y)| y).sum::<f64>() / own.len() as f64;
            let (slope, std) = match beside {
                Some((t, k)) => (t.coefficient_ent[k][c], t.coefficient_std_ent[k][c]),
                None => (part.coefficient_ent[c], part.coefficient_std_ent[c]),
            };
            let at = |v: f64| (v, mean + slope * (v - centre));
            let alone = if beside.is_some() {
                format!("; alone {:+.2e} ± {:.1e}", part.coefficient_ent[c], part.coefficient_std_ent[c])
            } else {
                format!(", correlation {:+.2}", part.correlation[c])
            };
            let label = format!("{slope:+.2e} ± {std:.1e} enT/{}{alone}", part.unit);
            let points = own.into_iter().map(|(v, y)| (v, y, None)).collect();
            Panel {
                y_label: format!("{} mean, enT", SENSOR[c]),
                y_scale: Scale::Linear,
                series: vec![
                    Series { label: format!("{} means", SENSOR[c]), style: STYLES[c], marks: Marks::Points(points) },
                    line(&label, Style::Reference, vec![at(low), at(high)]),
                ],
                bands: vec![],
            }
        }),
    })
}
