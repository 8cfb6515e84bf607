//! `calfit apply`: raw readings to calibrated field.

use super::output::{Terminal, json};
use super::{Common, Status, status};
use crate::data::error::Finding;
use crate::data::units::counted;
use crate::files::field::is_parameter_file;
use crate::files::output::Folder;
use crate::model::field_calibration::Frame;
use crate::workflow::{AppliedFile, ApplyOptions, Outside, applied, apply_to, known, stem};
use clap::{Args, ValueEnum};
use serde::Serialize;
use std::collections::HashMap;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Parameter files, then files of vectors: CCR, CSV, Parquet, Arrow IPC.
    #[arg(required = true, num_args = 2.., value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Frame of the field: that of the sensor, its reference cube, or coil axes (with a CPF).
    #[arg(long, value_enum, default_value_t = FrameName::Sensor)]
    frame: FrameName,
    /// What becomes of vectors outside of the temperatures and fields of the calibration.
    #[arg(long, value_enum, default_value_t = OutsideName::Flag)]
    outside: OutsideName,
    /// Column of a table, or channel of a run, with the sensor temperature, °C.
    #[arg(long, value_name = "NAME", conflicts_with = "temperature")]
    temperature_column: Option<String>,
    /// One sensor temperature for all vectors.
    #[arg(long, value_name = "DEGC", allow_negative_numbers = true)]
    temperature: Option<f64>,
    /// The model file whose effects were taken off the runs of the calibration: they are taken off these readings as well.
    #[arg(long, value_name = "FILE", conflicts_with = "effects_taken_off")]
    model: Option<PathBuf>,
    /// The known effects that were taken off the runs of the calibration are taken off these readings as well.
    #[arg(long)]
    effects_taken_off: bool,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum FrameName {
    Sensor,
    Reference,
    Coil,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum OutsideName {
    /// The field is given, with a flag.
    Flag,
    /// The field is left empty, with a flag.
    Null,
    /// The file is refused.
    Error,
}

#[derive(Serialize)]
struct Shown<'a> {
    sensor: &'a str,
    mode: &'a str,
    frame: &'a str,
    notes: Vec<String>,
    files: &'a [AppliedFile],
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let (parameters, data): (Vec<PathBuf>, Vec<PathBuf>) =
        arguments.files.iter().cloned().partition(|path| is_parameter_file(path));
    for (list, what, remedy) in [
        (&parameters, "no parameter file among them", "name a CPF, TPF or TCF file, or a ground calibration file"),
        (&data, "no file of vectors among them", "name run files or tables beside the parameter files"),
    ] {
        if list.is_empty() {
            let names: Vec<String> = arguments.files.iter().map(|p| p.display().to_string()).collect();
            return Err(Finding::error(&names.join(", "), what, remedy));
        }
    }
    let mut first: HashMap<String, &PathBuf> = HashMap::new();
    for path in &data {
        if let Some(other) = first.insert(stem(path), path) {
            let rule = format!("its result would have the name of that of {}", other.display());
            return Err(Finding::error(
                &path.display().to_string(),
                rule,
                "apply them one by one into different folders with -o",
            ));
        }
    }
    let options = ApplyOptions {
        frame: match arguments.frame {
            FrameName::Sensor => Frame::Sensor,
            FrameName::Reference => Frame::Reference,
            FrameName::Coil => Frame::Coil,
        },
        outside: match arguments.outside {
            OutsideName::Flag => Outside::Flag,
            OutsideName::Null => Outside::Null,
            OutsideName::Error => Outside::Error,
        },
        temperature_column: arguments.temperature_column.clone(),
        temperature_degc: arguments.temperature,
        effects_taken_off: arguments.effects_taken_off,
    };
    let model = known(arguments.model.as_ref())?;
    let mut findings = Vec::new();
    let calibration = applied(&parameters, model.as_ref(), &options, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let calibration = calibration?;
    for note in &calibration.notes {
        // What the files say against their own values is a warning of whatever is made with them.
        match &note.of {
            Some(_) => terminal.warning(&note.to_string()),
            None if !common.json => terminal.tell(&format!("note: {note}\n")),
            None => {}
        }
    }
    let folder = Folder::open(&common.out, common.force)?;
    let allowed = common.desk().allowed();
    let (mut done, mut failures) = (Vec::new(), Vec::new());
    for path in &data {
        match apply_to(path, &calibration, &options, &allowed, &folder) {
            Ok(file) => {
                file.notes.iter().for_each(|note| terminal.warning(&format!("{}: {note}", file.data)));
                if !common.json {
                    terminal.tell(&told(&file, &common.out));
                }
                done.push(file);
            }
            Err(failure) => {
                failure.errors().for_each(|finding| terminal.finding(finding));
                failures.push(failure);
            }
        }
    }
    folder.sync()?;
    if common.json {
        let (sensor, mode, frame) = (&calibration.sensor, &calibration.mode, &calibration.frame);
        let notes = calibration.notes.iter().map(ToString::to_string).collect();
        terminal.print(&json(&Shown { sensor, mode, frame, notes, files: &done })?);
    } else if !done.is_empty() {
        let frame = &calibration.frame;
        terminal.tell(&format!("frame: {frame}; group delay and frequency response are not applied\n"));
    }
    Ok(status(done.len(), &failures))
}

/// What was made of a file, in a few lines.
fn told(file: &AppliedFile, out: &std::path::Path) -> String {
    let mut text = format!("{}: {}", file.data, counted(file.rows as u64, "vector"));
    if file.without_field > 0 {
        text.push_str(&format!(", {} without field", file.without_field));
    }
    for flagged in file.flagged.iter().filter(|f| f.rows > 0) {
        text.push_str(&format!("\n  {} of them: {}", flagged.rows, flagged.meaning));
    }
    format!("{text}\n  -> {}\n", out.join(&file.file).display())
}
