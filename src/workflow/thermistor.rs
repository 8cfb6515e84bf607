//! Calibration tables of thermistors as files, figures and text.

use super::{Desk, Outcome, draw, notes_of, parameter_text};
use crate::data::error::Finding;
use crate::data::provenance::Provenance;
use crate::files::ccr::run_id_is_safe;
use crate::files::output::Folder;
use crate::files::parameter::Body;
use crate::files::thermistor::{REFERENCE, TABLE, read};
use crate::measure::thermistor::{Options, Thermistor, thermistor};
use crate::plot;
use crate::show::{self, Drawn};
use std::path::Path;

/// A thermistor's polynomial with its origin.
pub struct ThermistorMade {
    /// The result.
    pub result: Thermistor,
    /// Its origin.
    pub provenance: Provenance,
}

/// The polynomial of a calibration table, compared with a reference thermometer where there are readings beside one. Warnings of the
/// reader go to `findings`.
///
/// # Errors
/// A table that cannot be read or fitted, or whose name cannot be that of a result.
pub fn thermistor_of(
    path: &Path,
    reference: Option<&Path>,
    options: &Options,
    findings: &mut Vec<Finding>,
) -> Result<ThermistorMade, Finding> {
    let shown = path.display().to_string();
    let file_name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    if !run_id_is_safe(&stem) {
        let remedy = "rename it: letters, digits, `-`, `_` and `.` only";
        return Err(Finding::error(&shown, "its name cannot be that of a result", remedy).found(stem.as_bytes()));
    }
    let (rows, digested) = read(path, TABLE, findings)?;
    let mut input = vec![digested.input(file_name(path))];
    let mut command = recorded(options);
    let beside = reference.map(|path| read(path, REFERENCE, findings)).transpose()?;
    let beside = reference.zip(beside).map(|(path, (rows, digested))| {
        command.push_str(&format!(" --reference {}", file_name(path)));
        input.push(digested.input(file_name(path)));
        rows
    });
    let result =
        thermistor(&stem, &rows, beside.as_deref(), options).map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
    Ok(ThermistorMade { result, provenance: Provenance::new(command, input) })
}

/// The command with the options that have an influence on the numbers.
fn recorded(options: &Options) -> String {
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
    text
}

/// Writes figures, report and parameter file, the last one last; returns the name of the parameter file and the figures.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish_thermistor(made: &ThermistorMade, desk: &Desk) -> Result<(String, Vec<Drawn>), Finding> {
    let p = &made.result.parameters;
    let folder = Folder::open(&desk.out, desk.force)?;
    let name = p.file_name();
    folder.check(&name)?;
    let stem = &p.table;
    let drawn = if desk.plots {
        draw(&folder, &plot::thermistor::figures(&made.result), |figure| format!("THERMISTOR_{figure}__{stem}.png"))?
    } else {
        Vec::new()
    };
    let outcome = Outcome {
        name: &name,
        parameters: parameter_text(&name, p, &made.provenance)?,
        report: format!("REPORT_THERMISTOR__{stem}.md"),
        title: show::thermistor::title(&made.result),
        notes: &notes_of(&p.warnings),
        sections: show::thermistor::sections(&made.result),
        provenance: &made.provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok((name, drawn))
}
