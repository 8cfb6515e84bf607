//! `calfit thermistor`: temperature from voltage or resistance, from a calibration table.

use super::options::ValueError;
use super::output::{Printed, Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::thermistor::HIGHEST_ORDER;
use crate::measure::thermistor::{Options, Signal, WITHIN_DEGC};
use crate::show;
use crate::workflow::{publish_thermistor, thermistor_of};
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
    #[arg(long, value_name = "DEGC", default_value_t = WITHIN_DEGC, value_parser = positive)]
    within: f64,
    /// Sensor in which the thermistor sits: files of another sensor are then refused beside it.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
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

fn coefficients(text: &str) -> Result<Coefficients, ValueError> {
    numbers(text).filter(|c| (2..=HIGHEST_ORDER + 1).contains(&c.len())).map(Coefficients).ok_or(ValueError::Coefficients)
}

fn divider(text: &str) -> Result<[f64; 2], ValueError> {
    match numbers(text).as_deref() {
        Some([v, ohm]) if *v > 0.0 && *ohm > 0.0 => Ok([*v, *ohm]),
        _ => Err(ValueError::Divider),
    }
}

fn positive(text: &str) -> Result<f64, ValueError> {
    text.parse::<f64>().ok().filter(|v| v.is_finite() && *v > 0.0).ok_or(ValueError::Positive)
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let options = Options {
        order: arguments.order.map(usize::from),
        signal: arguments.signal.map(|s| match s {
            SignalName::U => Signal::Voltage,
            SignalName::R => Signal::Resistance,
        }),
        divider: arguments.divider,
        compare: arguments.compare.as_ref().map(|c| c.0.clone()),
        within_degc: arguments.within,
        sensor: arguments.sensor.clone(),
    };
    let mut findings = Vec::new();
    let made = thermistor_of(&arguments.table, arguments.reference.as_deref(), &options, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let made = made?;
    let shown = arguments.table.display();
    made.result.notes.iter().for_each(|w| terminal.warning(&format!("{shown}: {w}")));
    let (name, _) = publish_thermistor(&made, &common.desk())?;
    if common.json {
        terminal.print(&json(&Printed { result: made.view(), parameter_file: &name, provenance: &made.provenance })?);
    } else {
        let summary = show::thermistor::summary(&made.result);
        terminal.tell(&format!("{summary}  -> {}\n", common.out.join(name).display()));
    }
    Ok(Status::Done)
}
