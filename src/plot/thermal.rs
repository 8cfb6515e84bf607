//! The figures of a thermal analysis (BC-MAG-TR-0085 sections 12 and 13).

use super::parts::{Named, SENSOR, STYLES, panels};
use super::{Figure, Marks, Panel, Scale, Series, Style};
use crate::data::across::{RunModelErrors, RunRotations};
use crate::data::run::time_of_id;
use crate::measure::thermal::{OfKind, QuantityFit, RunsUsed, Thermal};

/// All figures of one kind of runs of a group.
#[must_use]
pub fn figures(thermal: &Thermal) -> Vec<Named> {
    let head = &thermal.runs;
    let of = format!("{} {}{}", head.sensor, head.mode, head.location.suffix());
    let mut list = vec![Named { stem: "temperature_profile", figure: profile(head, &of) }];
    let curves = |family: &str| thermal.quantities.iter().filter(|c| c.family() == family).collect::<Vec<&QuantityFit>>();
    let polynomial = |family: &str, title: &str, symbol: &str| {
        let points = Points { words: "runs", have_residuals: matches!(thermal.of_kind, OfKind::Lin(_)) };
        polynomials(&curves(family), head.channel.as_deref(), &points, &format!("{title}, {of}"), symbol)
    };
    match &thermal.of_kind {
        OfKind::Lin(lin) => {
            list.push(Named { stem: "sensitivities", figure: polynomial("sigma", "Sensitivities", "σ") });
            list.push(Named { stem: "misalignment", figure: polynomial("xi", "Misalignment angles", "ξ") });
            list.push(Named {
                stem: "offset_and_residual_field",
                figure: polynomial("b_or", "Offset and residual field", "B_or"),
            });
            list.push(Named { stem: "residuals", figure: residuals(thermal, &of) });
            if let Some(error) = &lin.model_error {
                list.push(Named { stem: "model_errors", figure: model_errors(error, head, &of) });
            }
            list.push(Named { stem: "rotation", figure: rotation(&lin.rotation, head, &of) });
        }
        OfKind::Offset(field) => {
            list.push(Named { stem: "offsets", figure: polynomial("b_off", "Sensor offsets", "B_off") });
            let seen = if field.seen_along.is_empty() {
                String::new()
            } else {
                let axes: Vec<String> =
                    ["X", "Y", "Z"].iter().zip(&field.seen_along).map(|(m, c)| format!("{m}_m = {c}_c")).collect();
                format!(" Seen along {}.", axes.join(", "))
            };
            list.push(Named {
                stem: "residual_field",
                figure: against_temperature(
                    head,
                    &format!("Residual field of the coil system, {of}"),
                    &format!("Along the sensor axes in their normal position, not in coil coordinates.{seen}"),
                    [
                        ("x residual field, enT", &field.x_ent, &field.x_std_ent),
                        ("y residual field, enT", &field.y_ent, &field.y_std_ent),
                        ("z residual field, enT", &field.z_ent, &field.z_std_ent),
                    ],
                ),
            });
        }
        OfKind::Freq(sampling) => {
            list.push(Named { stem: "corner_frequency", figure: polynomial("f_3db", "-3 dB corner frequency", "f_3dB") });
            // The frequencies differ by parts of a million: they are drawn from a round one on.
            let base_hz = sampling.means_hz()[0].map_or(0.0, |mean| (1e4 * mean).round() / 1e4);
            let points = (0..head.ids.len()).map(|i| {
                let std = sampling.f_s_std_hz[i];
                (head.temperature_degc[i], 1e6 * (sampling.f_s_hz[i] - base_hz), std.is_finite().then_some(1e6 * std))
            });
            list.push(Named {
                stem: "sampling_frequency",
                figure: Figure {
                    title: format!("Sampling frequency, {of}"),
                    caption: match sampling.means_hz() {
                        [Some(mean), Some(std)] => {
                            format!(
                                "Mean of the components per run with its standard uncertainty; mean of the runs {mean:.6} Hz, mean uncertainty {std:.1e} Hz."
                            )
                        }
                        _ => "The files tell no sampling frequency.".to_owned(),
                    },
                    x_label: temperature_label(head.channel.as_deref()),
                    x_scale: Scale::Linear,
                    panels: vec![Panel {
                        y_label: format!("f_s - {base_hz:.4} Hz, µHz"),
                        y_scale: Scale::Linear,
                        series: vec![Series {
                            label: "f_s ± standard uncertainty".to_owned(),
                            style: Style::Single,
                            marks: Marks::Points(points.collect()),
                        }],
                        bands: vec![],
                    }],
                },
            });
        }
    }
    list.push(Named { stem: "coil_temperature", figure: coil(head, &of) });
    list
}

fn temperature_label(channel: Option<&str>) -> String {
    match channel {
        None => "sensor temperature, °C".to_owned(),
        Some(channel) => format!("sensor temperature {channel}, °C"),
    }
}

/// Hours between the first run and every run, if the run ids tell.
fn hours(head: &RunsUsed) -> Option<Vec<f64>> {
    let times: Vec<_> = head.ids.iter().map(|id| time_of_id(id)).collect::<Option<_>>()?;
    let first = *times.first()?;
    Some(times.iter().map(|t| t.duration_since(first).as_secs_f64() / 3600.0).collect())
}

fn against_time(head: &RunsUsed, title: String, caption: &str, y_label: &str, values: &[f64]) -> Figure {
    let (x, x_label) = match hours(head) {
        Some(hours) => (hours, format!("time since run {}, h", head.ids[0])),
        None => ((0..values.len()).map(|i| i as f64 + 1.0).collect(), "run in the order of the group".to_owned()),
    };
    let points: Vec<(f64, f64, Option<f64>)> = x.iter().zip(values).map(|(x, v)| (*x, *v, None)).collect();
    Figure {
        title,
        caption: caption.to_owned(),
        x_label,
        x_scale: Scale::Linear,
        panels: vec![Panel {
            y_label: y_label.to_owned(),
            y_scale: Scale::Linear,
            series: vec![Series { label: "mean of a run".to_owned(), style: Style::Single, marks: Marks::Points(points) }],
            bands: vec![],
        }],
    }
}

fn profile(head: &RunsUsed, of: &str) -> Figure {
    against_time(
        head,
        format!("Temperature profile, {of}"),
        "Mean sensor temperature of the runs in the group; nothing is drawn between runs, where it is not known.",
        &format!("{}, °C", head.channel.as_deref().unwrap_or("not stated")),
        &head.temperature_degc,
    )
}

fn coil(head: &RunsUsed, of: &str) -> Figure {
    against_time(
        head,
        format!("Coil system temperature, {of}"),
        "Mean coil-system temperature of the runs, which the coil constants may follow.",
        "coil temperature, °C",
        &head.coil_temperature_degc,
    )
}

/// What the points of a figure of polynomials are.
pub(super) struct Points {
    /// In words.
    pub words: &'static str,
    /// Another figure shows what the polynomials leave of them.
    pub have_residuals: bool,
}

/// Quantities with their polynomials.
pub(super) fn polynomials(fits: &[&QuantityFit], channel: Option<&str>, points: &Points, title: &str, symbol: &str) -> Figure {
    let has_joint = fits.iter().any(|f| !f.joint_band.is_empty());
    let orders: Vec<String> = fits.iter().map(|f| format!("{} {}", f.found.name, f.polynomial.order())).collect();
    let has_common = fits.iter().any(|f| f.common.as_ref().is_some_and(|all| !all.is_empty()));
    let shared = if has_common { " What the runs share of the facility is in neither." } else { "" };
    let joint = if has_joint {
        " The joint fit is that to the plateaus of all runs; where the two agree its line lies below that of the polynomial."
    } else {
        ""
    };
    let shown = if points.have_residuals { ", and the figure of the residuals shows them" } else { "" };
    Figure {
        title: title.to_owned(),
        caption: format!(
            "Values of the {} with their standard uncertainty, polynomial and its 95 % band; where no bar or band is seen they are smaller than \
             marks and line{shown}. Orders: {}.{shared}{joint}",
            points.words,
            orders.join(", ")
        ),
        x_label: temperature_label(channel),
        x_scale: Scale::Linear,
        panels: fits
            .iter()
            .zip(STYLES)
            .map(|(curve, style)| {
                let mut series = Vec::new();
                // What is drawn first lies below.
                if !curve.joint_band.is_empty() {
                    series.push(Series {
                        label: "joint fit".to_owned(),
                        style: Style::Second,
                        marks: Marks::Line(curve.joint_band.iter().map(|[t, v, _]| (*t, *v)).collect()),
                    });
                }
                series.extend([
                    Series {
                        label: "95 % band".to_owned(),
                        style,
                        marks: Marks::Ribbon(
                            curve
                                .band
                                .iter()
                                .map(|[t, v, s]| (*t, v - curve.found.factor_95 * s, v + curve.found.factor_95 * s))
                                .collect(),
                        ),
                    },
                    Series {
                        label: "polynomial".to_owned(),
                        style,
                        marks: Marks::Line(curve.band.iter().map(|[t, v, _]| (*t, *v)).collect()),
                    },
                ]);
                series.push(Series {
                    label: format!("{symbol}_{}", curve.component),
                    style,
                    marks: Marks::Points(
                        curve.points().into_iter().map(|[t, v, s]| (t, v, s.is_finite().then_some(s))).collect(),
                    ),
                });
                Panel {
                    y_label: format!("{symbol}_{}, {}", curve.component, curve.found.unit),
                    y_scale: Scale::Linear,
                    series,
                    bands: vec![],
                }
            })
            .collect(),
    }
}

/// What the polynomials leave of the values of the runs.
fn residuals(thermal: &Thermal, of: &str) -> Figure {
    let head = &thermal.runs;
    let panel = |family: &str, y_label: &str, factor: f64| Panel {
        y_label: y_label.to_owned(),
        y_scale: Scale::Linear,
        series: thermal
            .quantities
            .iter()
            .filter(|c| c.found.name.starts_with(family))
            .zip(STYLES)
            .map(|(curve, style)| {
                let points = curve.points().into_iter().zip(&curve.found.residual);
                Series {
                    label: curve.component.clone(),
                    style,
                    marks: Marks::Points(
                        points.map(|([t, _, s], r)| (t, factor * r, s.is_finite().then_some(factor * s))).collect(),
                    ),
                }
            })
            .collect(),
        bands: vec![],
    };
    Figure {
        title: format!("Residuals of the thermal model, {of}"),
        caption: "Value of a run minus polynomial, with the standard uncertainty of the value.".to_owned(),
        x_label: temperature_label(head.channel.as_deref()),
        x_scale: Scale::Linear,
        panels: vec![panel("sigma", "σ, 1e-6 nT/enT", 1e6), panel("xi", "ξ, arcsec", 3600.0), panel("b_or", "B_or, enT", 1.0)],
    }
}

fn model_errors(error: &RunModelErrors, head: &RunsUsed, of: &str) -> Figure {
    Figure {
        title: format!("Errors of the thermal model, {of}"),
        caption: "Most negative and most positive difference, applied field minus modelled measurement, of every run, with the polynomials for sensitivity and angles and \
                  the run's own rotation and offset."
            .to_owned(),
        x_label: temperature_label(head.channel.as_deref()),
        x_scale: Scale::Linear,
        panels: panels(|axis| {
            let of = |rows: &[[f64; 3]]| {
                Marks::Points(rows.iter().zip(&head.temperature_degc).map(|(e, t)| (*t, e[axis], None)).collect())
            };
            Panel {
                y_label: format!("{} error, nT", ["X", "Y", "Z"][axis]),
                y_scale: Scale::Linear,
                series: vec![
                    Series { label: "most positive".to_owned(), style: STYLES[axis], marks: of(&error.max_nt) },
                    Series { label: "most negative".to_owned(), style: Style::Reference, marks: of(&error.min_nt) },
                ],
                bands: vec![],
            }
        }),
    }
}

fn rotation(r: &RunRotations, head: &RunsUsed, of: &str) -> Figure {
    against_temperature(
        head,
        &format!("Rotation of the sensor, {of}"),
        "Angle between each real and nominal sensor axis. A slow change can come from the mount, a step from handling.",
        [
            ("λ_x, °", &r.lambda_x_deg, &r.lambda_x_std_deg),
            ("μ_y, °", &r.mu_y_deg, &r.mu_y_std_deg),
            ("ν_z, °", &r.nu_z_deg, &r.nu_z_std_deg),
        ],
    )
}

/// Three quantities with their standard uncertainties, nan where not known, against the temperature of the runs.
fn against_temperature(head: &RunsUsed, title: &str, caption: &str, values: [(&str, &Vec<f64>, &Vec<f64>); 3]) -> Figure {
    let has_bars = values.iter().any(|(_, _, std)| std.iter().any(|s| s.is_finite()));
    let bars = if has_bars { " Bars are standard uncertainties; where none is seen it is smaller than the mark." } else { "" };
    Figure {
        title: title.to_owned(),
        caption: format!("{caption}{bars}"),
        x_label: temperature_label(head.channel.as_deref()),
        x_scale: Scale::Linear,
        panels: panels(|i| {
            let (label, values, std) = values[i];
            let points = head.temperature_degc.iter().zip(values.iter().zip(std));
            let points = points.map(|(t, (v, s))| (*t, *v, s.is_finite().then_some(*s))).collect();
            Panel {
                y_label: label.to_owned(),
                y_scale: Scale::Linear,
                series: vec![Series { label: SENSOR[i].to_owned(), style: STYLES[i], marks: Marks::Points(points) }],
                bands: vec![],
            }
        }),
    }
}
