//! `calfit thermistor`: temperature from voltage or resistance, from a calibration table.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::analysis::thermistor::{HIGHEST_ORDER, Options, Signal, thermistor};
use crate::error::Finding;
use crate::formats::ccr::run_id_is_safe;
use crate::formats::output::Folder;
use crate::formats::parameter::Body;
use crate::formats::thermistor::{REFERENCE, TABLE, read};
use crate::plot;
use crate::provenance::Provenance;
use crate::report;
use crate::workflow::{Outcome, draw, parameter_text};
use clap::{Args, ValueEnum};
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// The table: t_degc and u_volt or r_ohm.
    #[arg(value_name = "TABLE.csv")]
    table: PathBuf,
    /// Order of the polynomial [default: by AICc and leave-one-out error, up to 5].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=HIGHEST_ORDER as i64))]
    order: Option<u8>,
    /// What the polynomial takes [default: the voltage if there is one].
    #[arg(long, value_enum)]
    signal: Option<SignalName>,
    /// Reference voltage, V, and series resistance, ohm, of the divider: U = U_ref / (R_ser/R + 1).
    #[arg(long, value_name = "V,OHM", value_parser = divider)]
    divider: Option<[f64; 2]>,
    /// Coefficients of a polynomial to compare with, lowest first, in degrees Celsius.
    #[arg(long, value_name = "C0,C1,...", value_parser = coefficients, allow_hyphen_values = true)]
    compare: Option<Coefficients>,
    /// Readings beside a reference thermometer, reference_degc and u_volt or r_ohm: the offset T_O.
    #[arg(long, value_name = "TABLE.csv")]
    reference: Option<PathBuf>,
    /// Residual that the table asks for, degrees Celsius: the lowest order that reaches it is named.
    #[arg(long, value_name = "DEGC", default_value_t = 0.01, value_parser = positive)]
    within: f64,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum SignalName {
    /// Voltage, V.
    U,
    /// Resistance, ohm.
    R,
}

#[derive(Clone, Debug)]
struct Coefficients(Vec<f64>);

fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(',').map(|t| t.trim().parse::<f64>().ok().filter(|v| v.is_finite())).collect()
}

fn coefficients(text: &str) -> Result<Coefficients, String> {
    numbers(text)
        .filter(|c| (2..=HIGHEST_ORDER + 1).contains(&c.len()))
        .map(Coefficients)
        .ok_or_else(|| format!("write 2 to {} numbers with commas between them", HIGHEST_ORDER + 1))
}

fn divider(text: &str) -> Result<[f64; 2], String> {
    match numbers(text).as_deref() {
        Some([v, ohm]) if *v > 0.0 && *ohm > 0.0 => Ok([*v, *ohm]),
        _ => Err("write V,OHM, 2.5,1000 for example".to_owned()),
    }
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0).ok_or_else(|| "write a positive number".to_owned())
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let shown = arguments.table.display().to_string();
    let file_name = |path: &PathBuf| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = arguments.table.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    if !run_id_is_safe(&stem) {
        let remedy = "rename it: letters, digits, `-`, `_` and `.` only";
        return Err(Finding::error(&shown, "its name cannot be that of a result", remedy).found(stem.as_bytes()));
    }
    let mut findings = Vec::new();
    let table = read(&arguments.table, TABLE, &mut findings);
    let reference = arguments.reference.as_ref().map(|path| read(path, REFERENCE, &mut findings)).transpose();
    findings.iter().for_each(|f| terminal.finding(f));
    let ((rows, digested), reference) = (table?, reference?);
    let mut input = vec![digested.input(file_name(&arguments.table))];
    if let (Some(path), Some((_, digested))) = (&arguments.reference, &reference) {
        input.push(digested.clone().input(file_name(path)));
    }
    let options = Options {
        order: arguments.order.map(usize::from),
        signal: arguments.signal.map(|s| match s {
            SignalName::U => Signal::Voltage,
            SignalName::R => Signal::Resistance,
        }),
        divider: arguments.divider,
        compare: arguments.compare.as_ref().map(|c| c.0.clone()),
        within_degc: arguments.within,
    };
    let result = thermistor(&stem, &rows, reference.as_ref().map(|(rows, _)| rows.as_slice()), &options)
        .map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
    let provenance = Provenance::new(recorded(arguments, &options), input);
    let p = &result.parameters;
    p.warnings.iter().for_each(|w| terminal.warning(&format!("{shown}: {w}")));

    let folder = Folder::open(&common.out, common.force)?;
    let name = p.file_name();
    folder.check(&name)?;
    let drawn = if common.no_plots {
        Vec::new()
    } else {
        draw(&folder, &plot::thermistor::figures(&result), |figure| format!("THERMISTOR_{figure}__{stem}.png"))?
    };
    let outcome = Outcome {
        name: &name,
        parameters: parameter_text(&name, p, &provenance)?,
        report: format!("REPORT_THERMISTOR__{stem}.md"),
        title: report::thermistor::title(&result),
        warnings: &p.warnings,
        sections: report::thermistor::sections(&result, 2),
        provenance: &provenance,
    };
    outcome.write(&folder, &drawn)?;
    if common.json {
        terminal.print(&json(&result)?);
    } else {
        terminal.tell(&format!("{}  -> {}\n", report::thermistor::summary(&result), common.out.join(name).display()));
    }
    Ok(Status::Done)
}

/// The command with the options that have an influence on the numbers.
fn recorded(arguments: &Arguments, options: &Options) -> String {
    let joined = |list: &[f64]| list.iter().map(|v| format!("{v:?}")).collect::<Vec<_>>().join(",");
    let mut text = "calfit thermistor".to_owned();
    if let Some(order) = options.order {
        text.push_str(&format!(" --order {order}"));
    }
    if let Some(signal) = options.signal {
        text.push_str(&format!(" --signal {}", signal.name()));
    }
    if let Some(divider) = &options.divider {
        text.push_str(&format!(" --divider {}", joined(divider)));
    }
    if let Some(compare) = &options.compare {
        text.push_str(&format!(" --compare {}", joined(compare)));
    }
    text.push_str(&format!(" --within {:?}", options.within_degc));
    if let Some(name) = arguments.reference.as_ref().and_then(|p| p.file_name()) {
        text.push_str(&format!(" --reference {}", name.to_string_lossy()));
    }
    text
}
