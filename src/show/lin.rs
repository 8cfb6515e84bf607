//! The report table of a linear calibration: the blocks of BC-MAG-TR-0085 section 3.4.1 in their order.

use super::{degc, not_used, or_not_stated, remarks, run_line, table, triple, used_file};
use crate::data::units::{degrees_minutes_seconds, with_uncertainty};
use crate::files::parameter::{Body, Cpf};
use crate::measure::lin::Lin;
use std::fmt::Write;

const AXES: [&str; 3] = ["X", "Y", "Z"];

/// A matrix as indented text.
pub(super) fn matrix(rows: &[[f64; 3]; 3]) -> String {
    // What rounds to zero is printed without a sign of its own.
    let rows = rows.map(|row| row.map(|v| if v.abs() < 5e-7 { 0.0 } else { v }));
    let lines: Vec<String> = rows.iter().map(|r| format!("    {:+10.6}  {:+10.6}  {:+10.6}", r[0], r[1], r[2])).collect();
    format!("{}\n", lines.join("\n"))
}

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(lin: &Lin, level: usize) -> String {
    let p = &lin.parameters;
    let mut out = used_file(&p.run, &p.file_name(), level);
    let head = "#".repeat(level);
    facility(&mut out, p, &head);
    offset(&mut out, p, &head);
    raw_data(&mut out, p, &head);
    parameters(&mut out, p, &head);
    model_quality(&mut out, lin, &head);
    uncertainty(&mut out, p, &head);
    notes(&mut out, p, &head);
    out
}

/// The result in one line.
#[must_use]
pub fn headline(lin: &Lin) -> String {
    let p = &lin.parameters;
    format!("σ {} nT/enT", triple(&std::array::from_fn(|i| p.matrix.sigma[i][i]), &p.std.sigma))
}

/// A few lines for the terminal.
#[must_use]
pub fn summary(lin: &Lin) -> String {
    let p = &lin.parameters;
    let sigma: Vec<String> = (0..3).map(|i| with_uncertainty(p.matrix.sigma[i][i], p.std.sigma[i])).collect();
    let b_or: Vec<String> = (0..3).map(|i| with_uncertainty(p.offset.b_or_ent[i], p.std.b_or_ent[i])).collect();
    let residual = p.quality.residual_nt.std.map(|s| format!("{s:.3}"));
    format!(
        "{}  {} of {} blocks{}\n  σ     {}  nT/enT\n  B_or  {}  enT\n  residual standard deviation {}  nT (X, Y, Z)\n",
        run_line(&p.run),
        p.quality.blocks_used,
        p.quality.blocks_total,
        p.linearisation.as_ref().map_or_else(String::new, |l| format!(", linearised with {}", l.file))
            + &p.model.as_ref().map_or_else(String::new, |m| format!(", without the effects of {}", m.file)),
        sigma.join(", "),
        b_or.join(", "),
        residual.join(", "),
    )
}

fn facility(out: &mut String, p: &Cpf, head: &str) {
    let axes = &p.setup.position_axes;
    let _ = writeln!(
        out,
        "{head} Facility parameter\n\nNominal sensor setup, position {}: X_m = {}_c, Y_m = {}_c, Z_m = {}_c; `R_nom` takes nominal sensor coordinates to \
         coil coordinates:\n\n{}\nCalculated sensor rotation `ρ`:\n\n{}",
        p.setup.position,
        axes[0],
        axes[1],
        axes[2],
        matrix(&p.matrix.r_nom),
        matrix(&p.matrix.rho)
    );
    let angles = [p.angle_deg.lambda_x, p.angle_deg.mu_y, p.angle_deg.nu_z];
    let mut rows = vec![vec!["rotation angle".to_owned(), "value".to_owned(), "degrees ± standard uncertainty".to_owned()]];
    for (i, name) in ["(X_c, X_m): λ_x", "(Y_c, Y_m): μ_y", "(Z_c, Z_m): ν_z"].into_iter().enumerate() {
        rows.push(vec![
            name.to_owned(),
            degrees_minutes_seconds(angles[i]),
            with_uncertainty(angles[i], p.std.lambda_mu_nu_deg[i]),
        ]);
    }
    let _ = writeln!(out, "{}", table(&rows));
    let correction = match p.run.coil_correction {
        Some(true) => "used",
        Some(false) => "not used",
        None => "not stated",
    };
    let compensation = if p.run.earthfield_compensation.is_empty() {
        "not stated".to_owned()
    } else {
        AXES.iter().zip(&p.run.earthfield_compensation).map(|(a, c)| format!("{a} = {c}")).collect::<Vec<_>>().join(", ")
    };
    let rows = [
        ("Determinant of the rotation matrix", format!("{:.5}", p.quality.rotation_determinant)),
        ("Nominal field source", or_not_stated(&p.run.field_source).to_owned()),
        ("Campaign", p.run.campaign.clone()),
        ("Fields applied for", format!("{:.1} s", p.setup.field_duration_s)),
        ("Left out after a step", format!("{:.2} s", p.setup.settling_s)),
        ("Mean sensor temperature", degc(p.run.temperature_degc)),
        ("Mean coil system temperature", degc(p.run.coil_temperature_degc)),
        ("Automatic coil correction", correction.to_owned()),
        ("Earthfield compensation", compensation),
    ];
    let mut list = vec![vec!["condition".to_owned(), "value".to_owned()]];
    list.extend(rows.into_iter().map(|(name, value)| vec![name.to_owned(), value]));
    let _ = writeln!(out, "{}", table(&list));
}

fn offset(out: &mut String, p: &Cpf, head: &str) {
    let trend = match p.offset.trend_order {
        0 => "A constant offset was fitted together with the sensor model.".to_owned(),
        order => format!("A polynomial offset trend of order {order} was fitted together with the sensor model."),
    };
    let values: Vec<String> = (0..3)
        .map(|i| format!("{} = {} enT", ["x", "y", "z"][i], with_uncertainty(p.offset.b_or_ent[i], p.std.b_or_ent[i])))
        .collect();
    let _ = writeln!(
        out,
        "{head} Offset treatment\n\n{trend}\n\nMean coil system residual + sensor offset `B_or`, along the sensor axes: {}\n",
        values.join(", ")
    );
}

fn raw_data(out: &mut String, p: &Cpf, head: &str) {
    let _ = writeln!(out, "{head} Raw data quality\n");
    if let Some(linearisation) = &p.linearisation {
        let _ = writeln!(
            out,
            "The readings were linearised with `{}`, `r + c2 r² + c3 r³`; all parameters hold for linearised readings.\n",
            linearisation.file
        );
    }
    if let Some(model) = &p.model {
        let _ = writeln!(out, "{}\n", model.sentence());
    }
    match &p.quality.raw_std_ent {
        None => {
            let _ = writeln!(out, "The file brings plateau means without standard deviations.\n");
        }
        Some(s) => {
            let mut rows = vec![["values in enT", "s_x", "s_y", "s_z"].map(str::to_owned).to_vec()];
            for (name, v) in [("minimum", s.min), ("mean", s.mean), ("maximum", s.max)] {
                rows.push(vec![name.to_owned(), format!("{:.3}", v[0]), format!("{:.3}", v[1]), format!("{:.3}", v[2])]);
            }
            let _ = writeln!(out, "Standard deviation of the used raw data blocks:\n\n{}", table(&rows));
        }
    }
    let _ = writeln!(
        out,
        "{} of {} blocks used; {} samples lost, {} left out beside spikes.\n",
        p.quality.blocks_used, p.quality.blocks_total, p.quality.lost_samples, p.quality.spike_samples
    );
}

fn parameters(out: &mut String, p: &Cpf, head: &str) {
    let _ = writeln!(out, "{head} Calibration parameter\n");
    for (name, rows) in [
        ("Transfer matrix `Φ = R_nom ρ ω σ`, nT/enT", &p.matrix.phi),
        ("Reduced transfer matrix `φ̃ = ω σ`, nT/enT", &p.matrix.phi_tilde),
        ("Sensitivity `σ`, nT/enT", &p.matrix.sigma),
        ("Misalignment `ω` (BepiColombo convention)", &p.matrix.omega),
    ] {
        let _ = writeln!(out, "{name}:\n\n{}", matrix(rows));
    }
    let mut rows = vec![["sensor misalignment angle", "value", "degrees ± standard uncertainty"].map(str::to_owned).to_vec()];
    let angles = [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz];
    for (i, name) in ["ξ_xy", "ξ_xz", "ξ_yz"].into_iter().enumerate() {
        rows.push(vec![name.to_owned(), degrees_minutes_seconds(angles[i]), with_uncertainty(angles[i], p.std.xi_deg[i])]);
    }
    let _ = writeln!(out, "{}", table(&rows));
}

fn model_quality(out: &mut String, lin: &Lin, head: &str) {
    let q = &lin.parameters.quality.residual_nt;
    let mut rows = vec![["values in nT, coil axes", "X", "Y", "Z"].map(str::to_owned).to_vec()];
    for (name, v) in [("standard deviation", q.std), ("maximum error", q.max), ("minimum error", q.min)] {
        rows.push(vec![name.to_owned(), format!("{:.3}", v[0]), format!("{:.3}", v[1]), format!("{:.3}", v[2])]);
    }
    let _ = writeln!(out, "{head} Model quality\n\nApplied field minus modelled measurement, `B_c - Φ B_m`:\n\n{}", table(&rows));
}

fn uncertainty(out: &mut String, p: &Cpf, head: &str) {
    let mut rows = vec![["sensitivity", "nT/enT ± standard uncertainty"].map(str::to_owned).to_vec()];
    for i in 0..3 {
        rows.push(vec![format!("σ_{}", ["x", "y", "z"][i]), with_uncertainty(p.matrix.sigma[i][i], p.std.sigma[i])]);
    }
    let _ = writeln!(
        out,
        "{head} Uncertainty\n\n{}\nStandard uncertainties (coverage factor 1) from the scatter of the samples within the plateaus and of the plateau means about \
         the model, type A only: the uncertainty of the coil constants, of the coil angles and of the temperature is not in them. {} degrees of freedom per component, \
         condition number {:.2}. Noise of a plateau mean {:.3}, {:.3}, {:.3} enT, of which a part of {:.2}, {:.2}, {:.2} of the variance is \
         correlated from plateau to plateau ({:.0}, {:.0}, {:.0} effective plateaus). The full covariance is in the parameter file.\n",
        table(&rows),
        p.quality.degrees_of_freedom,
        p.quality.condition,
        p.noise.std_ent[0],
        p.noise.std_ent[1],
        p.noise.std_ent[2],
        p.noise.correlated_share[0],
        p.noise.correlated_share[1],
        p.noise.correlated_share[2],
        p.noise.effective_blocks[0],
        p.noise.effective_blocks[1],
        p.noise.effective_blocks[2],
    );
}

fn notes(out: &mut String, p: &Cpf, head: &str) {
    let field = p.valid.field_coil_nt.map(|[low, high]| format!("{low:.0} to {high:.0} nT"));
    let temperature =
        p.valid.temperature_degc.map_or_else(|| "not recorded".to_owned(), |[low, high]| format!("{low:.1} to {high:.1} °C"));
    let _ = writeln!(
        out,
        "{head} Validity\n\nFields X {}, Y {}, Z {} (coil axes); sensor temperature {temperature}. The results hold for the sensor and mode named above.\n",
        field[0], field[1], field[2]
    );
    out.push_str(&not_used(&p.dropped, head.len()));
    out.push_str(&remarks(&p.warnings, head.len()));
}

/// One row per run, for a campaign.
#[cfg(feature = "tables")]
#[must_use]
pub fn parameter_table(runs: &[&Lin]) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    let mut table = Table::default();
    let numbers = |get: &dyn Fn(&Cpf) -> f64| Values::Numbers(runs.iter().map(|l| get(&l.parameters)).collect());
    super::head_columns(&mut table, runs.iter().map(|l| &l.parameters.run));
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("sigma_{axis}"), numbers(&|p| p.matrix.sigma[i][i]));
        table.push(&format!("sigma_{axis}_std"), numbers(&|p| p.std.sigma[i]));
    }
    for (i, name) in ["xy", "xz", "yz"].into_iter().enumerate() {
        table.push(&format!("xi_{name}_deg"), numbers(&|p| [p.angle_deg.xi_xy, p.angle_deg.xi_xz, p.angle_deg.xi_yz][i]));
        table.push(&format!("xi_{name}_std_deg"), numbers(&|p| p.std.xi_deg[i]));
    }
    for (i, name) in ["lambda_x", "mu_y", "nu_z"].into_iter().enumerate() {
        table.push(&format!("{name}_deg"), numbers(&|p| [p.angle_deg.lambda_x, p.angle_deg.mu_y, p.angle_deg.nu_z][i]));
        table.push(&format!("{name}_std_deg"), numbers(&|p| p.std.lambda_mu_nu_deg[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("b_or_{axis}_ent"), numbers(&|p| p.offset.b_or_ent[i]));
        table.push(&format!("b_or_{axis}_std_ent"), numbers(&|p| p.std.b_or_ent[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_std_nt"), numbers(&|p| p.quality.residual_nt.std[i]));
    }
    table.push("blocks_used", Values::Counts(runs.iter().map(|l| l.parameters.quality.blocks_used as u64).collect()));
    table.push("blocks_total", Values::Counts(runs.iter().map(|l| l.parameters.quality.blocks_total as u64).collect()));
    table
}

/// One row per plateau of a run.
#[cfg(feature = "tables")]
#[must_use]
pub fn block_table(lin: &Lin) -> crate::files::table::Table {
    use crate::files::table::{Table, Values};
    use crate::measure::lin::Block;
    let mut table = Table::default();
    let numbers = |get: &dyn Fn(&Block) -> f64| Values::Numbers(lin.blocks.iter().map(get).collect());
    table.push("block", Values::Counts(lin.blocks.iter().map(|b| b.plateau.index as u64 + 1).collect()));
    table.push("used_from_s", numbers(&|b| b.plateau.used_s[0]));
    table.push("used_to_s", numbers(&|b| b.plateau.used_s[1]));
    table.push("samples", Values::Counts(lin.blocks.iter().map(|b| b.plateau.count.unwrap_or_default()).collect()));
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("b{axis}_nt"), numbers(&|b| b.plateau.setting.field.0[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("{axis}_ent"), numbers(&|b| b.plateau.mean.0[i]));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("std_{axis}_ent"), numbers(&|b| b.plateau.std_ent.map_or(f64::NAN, |s| s[i])));
    }
    for (i, axis) in ["x", "y", "z"].into_iter().enumerate() {
        table.push(&format!("residual_{axis}_nt"), numbers(&|b| b.residual_coil_nt.map_or(f64::NAN, |r| r.0[i])));
    }
    table.push("weight", numbers(&|b| b.weight));
    let reason = |b: &Block| b.plateau.dropped.as_ref().map_or_else(String::new, ToString::to_string);
    table.push("not_used_because", Values::Text(lin.blocks.iter().map(reason).collect()));
    table
}
