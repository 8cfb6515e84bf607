//! Results as tables for people. Reads result structs and computes nothing about the sensor.

pub mod centre;
pub mod coil;
pub mod diagnose;
pub mod freq;
pub mod html;
pub mod lin;
pub mod linearise;
pub mod null;
pub mod offset;
pub mod protocol;
pub mod runs;
pub mod sweep;
pub mod thermal;
pub mod thermistor;

use crate::data::provenance::Provenance;
use crate::data::result::{Dropped, RunHead};
use crate::data::units::with_uncertainty;
use std::fmt::Write;

/// A Markdown table; the first row is its head.
#[must_use]
pub fn table(rows: &[Vec<String>]) -> String {
    let mut out = String::new();
    for (i, row) in rows.iter().enumerate() {
        let cells: Vec<String> = row.iter().map(|c| c.replace('|', "\\|")).collect();
        out.push_str(&format!("| {} |\n", cells.join(" | ")));
        if i == 0 {
            out.push_str(&format!("|{}\n", "---|".repeat(row.len())));
        }
    }
    out
}

/// Text for a value that may be missing.
#[must_use]
pub fn or_not_stated(text: &str) -> &str {
    if text.is_empty() { "not stated" } else { text }
}

/// A temperature that may be missing.
#[must_use]
pub fn degc(value: Option<f64>) -> String {
    value.map_or_else(|| "not recorded".to_owned(), |v| format!("{v:.1} °C"))
}

/// Run, sensor, mode and temperature in one line.
#[must_use]
pub fn run_line(run: &RunHead) -> String {
    let temperature = run.temperature_degc.map_or_else(String::new, |t| format!(", {t:.1} °C"));
    format!("{}  {} {}{temperature}", run.id, run.sensor, run.mode)
}

/// The block of the used file with the name of the parameter file.
#[must_use]
pub fn used_file(run: &RunHead, parameter_file: &str, level: usize) -> String {
    let rows = [
        ["run", "configuration", "sensor", "mode", "start", "sensor temperature"].map(str::to_owned).to_vec(),
        vec![
            run.id.clone(),
            or_not_stated(&run.configuration).to_owned(),
            or_not_stated(&run.sensor).to_owned(),
            or_not_stated(&run.mode).to_owned(),
            run.start.clone(),
            degc(run.temperature_degc),
        ],
    ];
    format!("{} Used measurement\n\n{}\nParameter file: `{parameter_file}`.\n\n", "#".repeat(level), table(&rows))
}

/// A figure as it was written.
#[derive(Clone, Debug)]
pub struct Drawn {
    /// File name.
    pub file: String,
    /// Title.
    pub title: String,
    /// Caption.
    pub caption: String,
}

/// A figure that a report shows.
pub struct FigureLink {
    /// Path of the picture from the report.
    pub file: String,
    /// Number in the report, from 1.
    pub number: usize,
    /// What it shows.
    pub title: String,
    /// What to see in it.
    pub caption: String,
}

impl FigureLink {
    /// Numbers figures on from the last number used; `folder` leads to them from the report and is empty or ends with `/`.
    #[must_use]
    pub fn number(drawn: &[Drawn], folder: &str, last: &mut usize) -> Vec<FigureLink> {
        let link = |d: &Drawn| {
            *last += 1;
            FigureLink { file: format!("{folder}{}", d.file), number: *last, title: d.title.clone(), caption: d.caption.clone() }
        };
        drawn.iter().map(link).collect()
    }
}

/// Figures with their captions.
#[must_use]
pub fn figures(links: &[FigureLink]) -> String {
    let mut out = String::new();
    for FigureLink { file, number, title, caption } in links {
        // The caption is drawn in the picture; here it is for those who cannot see it.
        let (caption, title) = (caption.replace(['[', ']'], ""), title.replace('"', "'"));
        let _ = writeln!(out, "![{caption}]({file} \"Figure {number}: {title}\")\n");
    }
    out
}

/// A report of its own: warnings that concern the result as a whole, its sections, its figures and its origin.
#[must_use]
pub fn standalone(title: &str, warnings: &[String], sections: &str, links: &[FigureLink], provenance: &Provenance) -> String {
    let mut out = format!("<!-- written by calfit {} -->\n# {title}\n\n", provenance.tool_version);
    for warning in warnings.iter().filter(|w| w.starts_with("AXES") || w.starts_with("FIT")) {
        let _ = writeln!(out, "> **WARNING** {warning}\n");
    }
    out.push_str(sections);
    if !links.is_empty() {
        let _ = writeln!(out, "## Figures\n\n{}", figures(links));
    }
    let mut inputs = vec![["input", "bytes", "SHA-256"].map(str::to_owned).to_vec()];
    inputs.extend(provenance.input.iter().map(|i| vec![i.path.clone(), i.size_bytes.to_string(), format!("`{}`", i.sha256)]));
    let _ = writeln!(
        out,
        "## Origin\n\n{}\n---\nMade by {} {} ({}), `{}`, {}.",
        table(&inputs),
        provenance.tool,
        provenance.tool_version,
        provenance.build,
        provenance.command,
        provenance.created
    );
    out
}

/// The list of remarks under a heading; nothing without remarks.
#[must_use]
pub fn remarks(warnings: &[String], level: usize) -> String {
    if warnings.is_empty() {
        return String::new();
    }
    let list: Vec<String> = warnings.iter().map(|w| format!("- {w}")).collect();
    format!("{} Remarks\n\n{}\n\n", "#".repeat(level), list.join("\n"))
}

/// The plateaus that were not used under a heading; nothing if all were.
#[must_use]
pub fn not_used(dropped: &[Dropped], level: usize) -> String {
    if dropped.is_empty() {
        return String::new();
    }
    let mut rows = vec![["block", "begin, s", "X, nT", "Y, nT", "Z, nT", "not used because"].map(str::to_owned).to_vec()];
    for d in dropped {
        let [x, y, z] = d.field_coil_nt.map(|v| format!("{v:.2}"));
        rows.push(vec![d.block.to_string(), format!("{:.1}", d.t_start_s), x, y, z, d.reason.clone()]);
    }
    format!("{} Plateaus not used\n\n{}\n", "#".repeat(level), table(&rows))
}

/// The first columns of a table with one row per run.
#[cfg(feature = "tables")]
pub fn head_columns<'a>(table: &mut crate::files::table::Table, runs: impl Iterator<Item = &'a RunHead>) {
    use crate::files::table::Values;
    let runs: Vec<&RunHead> = runs.collect();
    let text = |get: fn(&RunHead) -> &str| Values::Text(runs.iter().map(|r| get(r).to_owned()).collect());
    let degc = |get: fn(&RunHead) -> Option<f64>| Values::Numbers(runs.iter().map(|r| get(r).unwrap_or(f64::NAN)).collect());
    table.push("run", text(|r| &r.id));
    table.push("sensor", text(|r| &r.sensor));
    table.push("mode", text(|r| &r.mode));
    table.push("temperature_degc", degc(|r| r.temperature_degc));
    table.push("coil_temperature_degc", degc(|r| r.coil_temperature_degc));
}

/// Three values with their standard uncertainties in one line.
#[must_use]
pub fn triple(values: &[f64; 3], std: &[f64; 3]) -> String {
    (0..3).map(|i| value(values[i], std[i])).collect::<Vec<_>>().join(", ")
}

/// A value with its standard uncertainty; either may be missing.
#[must_use]
pub fn value(value: f64, std: f64) -> String {
    match (value.is_finite(), std.is_finite()) {
        (true, true) => with_uncertainty(value, std),
        (true, false) => format!("{value:.2} (uncertainty not known)"),
        (false, _) => NOT_DETERMINED.to_owned(),
    }
}

/// A number with some decimals; it may be missing.
#[must_use]
pub fn number(value: f64, decimals: usize) -> String {
    if value.is_finite() { format!("{value:.decimals$}") } else { NOT_DETERMINED.to_owned() }
}

const NOT_DETERMINED: &str = "not determined";
