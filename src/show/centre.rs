//! The report of temperature polynomials that were taken to the centre of the coil system.

use super::{degc, remarks, table, value};
use crate::data::units::{COMPONENTS, scientific_with_uncertainty};
use crate::files::parameter::{Body, CentreRun, Tcf};
use std::fmt::Write;

const PAIRS: [&str; 3] = ["xy", "xz", "yz"];

/// Its title.
#[must_use]
pub fn title(tcf: &Tcf) -> String {
    format!("Temperature calibration at the centre of the coil system, {} {}", tcf.sensor, tcf.mode)
}

/// The blocks of the report with headings of the given level.
#[must_use]
pub fn sections(tcf: &Tcf, level: usize) -> String {
    let head = "#".repeat(level);
    let mut out = format!(
        "{head} Pair of linear calibrations\n\nT1 = {}. Parameter file: `{}`. ω is in the Rosetta convention: the matrix Q(ξ) of direction \
         cosines.\n\n",
        degc(Some(tcf.reference_degc)),
        tcf.file_name()
    );
    let mut rows = vec![["", "file", "temperature", "σ x, y, z, nT/enT", "ξ xy, xz, yz, deg"].map(str::to_owned).to_vec()];
    for (name, run) in [("centre", &tcf.centre), ("off-centre", &tcf.off_centre.at_reference)] {
        rows.push(pair_row(name, run));
    }
    let _ = writeln!(out, "{}\n{head} Geometry factors\n\n`k = σ¹(T1)/σ⁰(T1)`, `K = ω⁰(T1)⁻¹ ω¹(T1)`.\n", table(&rows));
    let mut rows = vec![["component", "k", "K⁻¹ row, x", "K⁻¹ row, y", "K⁻¹ row, z"].map(str::to_owned).to_vec()];
    for i in 0..3 {
        let mut row = vec![COMPONENTS[i].to_owned(), value(tcf.k[i], tcf.k_std.map_or(f64::NAN, |s| s[i]))];
        row.extend((0..3).map(|c| format!("{:+.7}", tcf.k_inverse[i][c])));
        rows.push(row);
    }
    let _ = writeln!(out, "{}", table(&rows));
    let quantities = [
        ("sigma", COMPONENTS, [&tcf.sigma_x, &tcf.sigma_y, &tcf.sigma_z]),
        ("xi", PAIRS, [&tcf.xi_xy, &tcf.xi_xz, &tcf.xi_yz]),
        ("b_off", COMPONENTS, [&tcf.b_off_x, &tcf.b_off_y, &tcf.b_off_z]),
    ];
    let mut rows = vec![["quantity", "k", "coefficient of T^k"].map(str::to_owned).to_vec()];
    for (family, components, polynomials) in quantities {
        for (component, polynomial) in components.iter().zip(polynomials) {
            let name = format!("{family}_{component}");
            for (k, p) in polynomial.iter().enumerate() {
                let std = tcf.covariance.get(&name).map_or(f64::NAN, |c| c[k][k].sqrt());
                rows.push(vec![name.clone(), k.to_string(), scientific_with_uncertainty(*p, std)]);
            }
        }
    }
    let [low, high] = tcf.valid_degc;
    let _ = writeln!(out, "{head} Polynomials at the centre\n\nThey hold from {low:.1} to {high:.1} °C.\n\n{}", table(&rows));
    if let Some(field) = &tcf.residual_field {
        let std = field.b_res_std_ent.unwrap_or([f64::NAN; 3]);
        let _ = writeln!(
            out,
            "{head} Residual field\n\nB_res = {} enT, from the offset of {} at {}.\n",
            super::triple(&field.b_res_ent, &std),
            field.file,
            degc(Some(field.temperature_degc))
        );
    }
    out.push_str(&remarks(&tcf.warnings, level));
    out
}

fn pair_row(name: &str, run: &CentreRun) -> Vec<String> {
    let three = |v: [f64; 3]| v.map(|v| format!("{v:.6}")).join(", ");
    vec![name.to_owned(), run.file.clone(), degc(run.temperature_degc), three(run.sigma), three(run.xi_deg)]
}

/// The result in two lines for the terminal.
#[must_use]
pub fn summary(tcf: &Tcf) -> String {
    let k = tcf.k.map(|k| format!("{k:.6}")).join(", ");
    format!(
        "{}  {} {}, centre of the coil system, T1 {:.2} °C\n  k  {k}\n",
        tcf.runs.first().map_or("", String::as_str),
        tcf.sensor,
        tcf.mode,
        tcf.reference_degc
    )
}
