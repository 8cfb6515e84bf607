//! The report of a thermal analysis: the blocks of BC-MAG-TR-0085 sections 12 and 13 in their order.

use super::{degc, number, remarks, table};
use crate::data::units::{degrees_minutes_seconds, scientific_with_uncertainty, with_uncertainty};
use crate::files::parameter::{QuantityPart, ThermalHead, Tpf};
use crate::measure::thermal::{File, Kind, Thermal};
use std::fmt::Write;

/// Title of a section on one kind of runs.
#[must_use]
pub fn title(kind: Kind) -> &'static str {
    match kind {
        Kind::Lin => "Temperature calibration on linear axes",
        Kind::Offset => "Temperature calibration of the sensor offset",
        Kind::Freq => "Temperature calibration of the AC transfer function",
    }
}

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(thermal: &Thermal, level: usize) -> String {
    let head_data = thermal.file.head();
    let head = "#".repeat(level);
    let mut out = used(thermal, &head);
    match &thermal.file {
        File::Tpf(tpf) => {
            facility(&mut out, tpf, &head);
            family(&mut out, thermal, "sigma", "Sensitivity σ against temperature", "nT/enT, °C", &head);
            family(&mut out, thermal, "xi", "Misalignment angles ξ against temperature", "deg, °C", &head);
            family(&mut out, thermal, "b_or", "Offset and residual field B_or against temperature", "enT, °C", &head);
            quality(&mut out, head_data, &head);
            model_error(&mut out, tpf);
            joint(&mut out, thermal, tpf, &head);
        }
        File::Tof(tof) => {
            family(&mut out, thermal, "b_off", "Sensor offset B_off against temperature", "enT, °C", &head);
            quality(&mut out, head_data, &head);
            let axes = if tof.residual_field.seen_along.is_empty() {
                String::new()
            } else {
                let axes: Vec<String> =
                    ["X", "Y", "Z"].iter().zip(&tof.residual_field.seen_along).map(|(m, c)| format!("{m}_m = {c}_c")).collect();
                format!(" The axes of this table are {}.", axes.join(", "))
            };
            let mut rows = vec![["run", "B_res x, enT", "B_res y, enT", "B_res z, enT"].map(str::to_owned).to_vec()];
            for (i, run) in head_data.runs.iter().enumerate() {
                let f = &tof.residual_field;
                let mut row = vec![run.clone()];
                row.extend([f.x_ent[i], f.y_ent[i], f.z_ent[i]].map(|v| number(v, 3)));
                rows.push(row);
            }
            let _ = writeln!(
                out,
                "{head} Coil system residual field\n\nIn the coordinates of the sensor in its normal position, not in coil coordinates.{axes}\n\n{}",
                table(&rows)
            );
        }
        File::Taf(taf) => {
            let how = if taf.corner == "model" { "of the response models" } else { "by interpolation (igep)" };
            family(&mut out, thermal, "f_3db", &format!("-3 dB corner frequency {how} against temperature"), "Hz, °C", &head);
            quality(&mut out, head_data, &head);
            let _ = writeln!(out, "{head} Instrument sampling frequency\n");
            if let (Some(mean), Some(std)) = (taf.mean_sample_rate_hz, taf.mean_std_sample_rate_hz) {
                let mut rows = vec![["run", "sensor temperature", "f_s, Hz"].map(str::to_owned).to_vec()];
                for (i, run) in head_data.runs.iter().enumerate() {
                    let f_s = with_uncertainty(taf.f_s_hz[i], taf.f_s_std_hz[i]);
                    rows.push(vec![run.clone(), degc(Some(head_data.temperature_degc[i])), f_s]);
                }
                let _ = writeln!(
                    out,
                    "{}\nMean sample rate {mean:.6} Hz, mean standard uncertainty of the sample rate {std:.1e} Hz.\n",
                    table(&rows)
                );
            } else {
                let _ = writeln!(out, "The files tell no sampling frequency.\n");
            }
        }
    }
    out.push_str(&remarks(&head_data.warnings, level));
    out
}

fn used(thermal: &Thermal, head: &str) -> String {
    let h = thermal.file.head();
    let mut rows =
        vec![["calibration parameter file", "sensor temperature", "coil system temperature"].map(str::to_owned).to_vec()];
    for (i, file) in h.used.iter().enumerate() {
        rows.push(vec![
            format!("`{file}`"),
            degc(Some(h.temperature_degc[i])),
            degc(Some(h.coil_temperature_degc[i]).filter(|t| t.is_finite())),
        ]);
    }
    format!(
        "{head} Used temperature measurements\n\n{}\nThermal parameter file: `{}`. Sensor-temperature channel {}, valid from {:.1} to {:.1} °C; beyond \
         it the polynomials are extrapolations.\n\n",
        table(&rows),
        thermal.file.file_name(),
        h.channel,
        h.valid_degc[0],
        h.valid_degc[1]
    )
}

fn facility(out: &mut String, tpf: &Tpf, head: &str) {
    let r = &tpf.rotation;
    if let Some(rho) = &r.initial {
        let _ =
            writeln!(out, "{head} Facility parameter\n\nCalculated initial sensor rotation `ρ`:\n\n{}", super::lin::matrix(rho));
    }
    let mut rows =
        vec![["run", "sensor temperature", "λ_x", "μ_y", "ν_z", "standard uncertainty, degrees"].map(str::to_owned).to_vec()];
    for (i, run) in tpf.head.runs.iter().enumerate() {
        let mut row = vec![run.clone(), degc(Some(tpf.head.temperature_degc[i]))];
        row.extend([r.lambda_x_deg[i], r.mu_y_deg[i], r.nu_z_deg[i]].map(degrees_minutes_seconds));
        let std = [r.lambda_x_std_deg[i], r.mu_y_std_deg[i], r.nu_z_std_deg[i]];
        row.push(if std.iter().all(|s| s.is_finite()) {
            std.map(|s| format!("{s:.1e}")).join(", ")
        } else {
            "not known".to_owned()
        });
        rows.push(row);
    }
    let _ = writeln!(out, "Rotation of the sensor in every run:\n\n{}", table(&rows));
}

fn coefficients<'a>(thermal: &'a Thermal, name: &str) -> &'a [f64] {
    thermal.curves.iter().find(|c| c.name == name).map_or(&[], |c| &c.coefficients)
}

/// Coefficients with their standard uncertainties, and how the order was found.
fn family(out: &mut String, thermal: &Thermal, family: &str, title: &str, units: &str, head: &str) {
    let h = thermal.file.head();
    let quantities: Vec<&QuantityPart> = h.quantity.iter().filter(|q| q.name.starts_with(family)).collect();
    if quantities.is_empty() {
        let _ = writeln!(out, "{head} {title}\n\nNot determined.\n");
        return;
    }
    let most = quantities.iter().map(|q| q.order).max().unwrap_or(0);
    let mut rows = vec![std::iter::once("quantity".to_owned()).chain((0..=most).map(|k| format!("T^{k}"))).collect::<Vec<_>>()];
    for q in &quantities {
        let covariance = h.covariance.get(&q.name).map(Vec::as_slice).unwrap_or_default();
        let mut row = vec![q.name.clone()];
        for k in 0..=most {
            row.push(coefficients(thermal, &q.name).get(k).map_or_else(String::new, |value| {
                let variance = covariance.get(k).and_then(|r| r.get(k)).copied().unwrap_or(f64::NAN);
                scientific_with_uncertainty(*value, variance.sqrt())
            }));
        }
        rows.push(row);
    }
    let _ = writeln!(out, "{head} {title}\n\n`p(T) = Σ p_k T^k` [{units}], standard uncertainties:\n\n{}", table(&rows));
    let orders = quantities.iter().map(|q| q.aicc.len().max(q.leave_one_out.len())).max().unwrap_or(0);
    let mut rows = vec![
        ["quantity", "order", "chosen by"]
            .map(str::to_owned)
            .into_iter()
            .chain((0..orders).map(|k| format!("order {k}")))
            .collect::<Vec<_>>(),
    ];
    for q in &quantities {
        let mut row = vec![q.name.clone(), q.order.to_string(), q.order_by.clone()];
        for k in 0..orders {
            let cell = |list: &[f64], form: &dyn Fn(f64) -> String| {
                list.get(k).filter(|v| v.is_finite()).map_or_else(|| "-".to_owned(), |v| form(*v))
            };
            row.push(format!("{} / {}", cell(&q.aicc, &|v| format!("{v:.1}")), cell(&q.leave_one_out, &|v| format!("{v:.1e}"))));
        }
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "How the orders were found; AICc / leave-one-out error of every order that was compared:\n\n{}",
        table(&rows)
    );
}

fn quality(out: &mut String, h: &ThermalHead, head: &str) {
    let mut rows = vec![
        ["quantity", "unit", "runs", "valid, °C", "smallest error", "largest error", "widened by", "95 % factor"]
            .map(str::to_owned)
            .to_vec(),
    ];
    for q in &h.quantity {
        rows.push(vec![
            q.name.clone(),
            q.unit.clone(),
            q.runs.len().to_string(),
            format!("{:.1} to {:.1}", q.valid_degc[0], q.valid_degc[1]),
            format!("{:.2e}", q.min_error),
            format!("{:.2e}", q.max_error),
            format!("{:.1}", q.widened),
            if q.factor_95.is_finite() { format!("{:.2}", q.factor_95) } else { "-".to_owned() },
        ]);
    }
    let _ = writeln!(
        out,
        "{head} Model quality\n\nValue of a run minus polynomial. An interval of 95 % is the standard uncertainty times the factor, which is \
         larger where the scatter of a few runs told the uncertainty:\n\n{}",
        table(&rows)
    );
}

fn model_error(out: &mut String, tpf: &Tpf) {
    let Some(error) = &tpf.model_error else { return };
    let mut rows = vec![["run", "sensor temperature", "X, nT", "Y, nT", "Z, nT"].map(str::to_owned).to_vec()];
    for (i, run) in tpf.head.runs.iter().enumerate() {
        let mut row = vec![run.clone(), degc(Some(tpf.head.temperature_degc[i]))];
        row.extend((0..3).map(|axis| format!("{:.3} to {:.3}", error.min_nt[i][axis], error.max_nt[i][axis])));
        rows.push(row);
    }
    let _ = writeln!(
        out,
        "Minimum and maximum error of the model against temperature, applied field minus modelled measurement, coil axes:\n\n{}",
        table(&rows)
    );
}

fn joint(out: &mut String, thermal: &Thermal, tpf: &Tpf, head: &str) {
    let Some(joint) = &tpf.joint else { return };
    let mut rows =
        vec![["quantity", "k", "two steps", "joint fit", "difference, standard uncertainties"].map(str::to_owned).to_vec()];
    for (name, coefficients) in &joint.coefficients {
        let std = |covariance: Option<&Vec<Vec<f64>>>, k: usize| {
            covariance.and_then(|c| c.get(k)).and_then(|r| r.get(k)).map_or(f64::NAN, |v| v.max(0.0).sqrt())
        };
        let two_steps = self::coefficients(thermal, name);
        for (k, value) in coefficients.iter().enumerate() {
            let (two, std_two) = (two_steps.get(k).copied().unwrap_or(f64::NAN), std(tpf.head.covariance.get(name), k));
            let std_joint = std(joint.covariance.get(name), k);
            rows.push(vec![
                name.clone(),
                k.to_string(),
                scientific_with_uncertainty(two, std_two),
                scientific_with_uncertainty(*value, std_joint),
                format!("{:+.1}", (value - two) / std_joint),
            ]);
        }
    }
    let _ = writeln!(
        out,
        "{head} Joint fit\n\nThe temperature-dependent model fitted to the plateaus of all runs at once, with the temperature at every plateau; \
         rotation and offset of every run are free. Chi-square {:.0} with {} degrees of freedom, {} evaluations; uncertainties widened by {:.1}.\n\n{}",
        joint.chi_square,
        joint.degrees_of_freedom,
        joint.evaluations,
        joint.widened,
        table(&rows)
    );
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(thermal: &Thermal) -> String {
    let h = thermal.file.head();
    let orders: Vec<String> = h.quantity.iter().map(|q| format!("{} {}", q.name, q.order)).collect();
    format!(
        "{} {}  {} {} runs, {:.1} to {:.1} °C\n  orders {}\n",
        h.sensor,
        h.mode,
        h.runs.len(),
        thermal.kind.name(),
        h.valid_degc[0],
        h.valid_degc[1],
        orders.join(", ")
    )
}
