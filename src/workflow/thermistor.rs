//! Calibration tables of thermistors as files, figures and text.

use super::{Desk, Outcome, draw};
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::provenance::{Provenance, Role};
use crate::data::recipe::Recipe;
use crate::files::ccr::run_id_is_safe;
use crate::files::ledger::Origin;
use crate::files::parameter::{Body, ThermistorConvention, ThermistorFile};
use crate::files::thermistor::{REFERENCE, TABLE, read};
use crate::measure::thermistor::{Options, Thermistor, thermistor};
use crate::plot;
use crate::show::{self, Drawn};
use serde::Serialize;
use std::path::Path;

/// A thermistor's polynomial with its origin.
pub struct ThermistorMade {
    /// The result.
    pub result: Thermistor,
    /// Its origin.
    pub provenance: Provenance,
}

impl ThermistorMade {
    /// What goes into the parameter file.
    #[must_use]
    pub fn parameters(&self) -> ThermistorFile {
        ThermistorFile {
            polynomial: self.result.polynomial.clone(),
            convention: ThermistorConvention::default(),
            covariance: self.result.covariance.clone(),
            compared: self.result.compared.clone(),
            reference: self.result.reference.clone(),
            orders: self.result.orders.clone(),
            row: self.result.row.clone(),
            told: Told::of(&self.result.notes),
        }
    }

    /// The result as `--json` prints it.
    #[must_use]
    pub fn view(&self) -> impl Serialize {
        ThermistorView { parameters: self.parameters() }
    }
}

#[derive(Serialize)]
struct ThermistorView {
    parameters: ThermistorFile,
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
    let beside = reference.map(|path| read(path, REFERENCE, findings)).transpose()?;
    let beside = reference.zip(beside).map(|(path, (rows, digested))| {
        input.push(digested.input(file_name(path)).with_role(Role::Reference));
        rows
    });
    let result =
        thermistor(&stem, &rows, beside.as_deref(), options).map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
    Ok(ThermistorMade { result, provenance: Provenance::new(Recipe::new("thermistor", options), input) })
}

/// Writes figures, report and parameter file, the last one last; returns the name of the parameter file and the figures.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish_thermistor(made: &ThermistorMade, desk: &Desk) -> Result<(String, Vec<Drawn>), Finding> {
    let p = &made.parameters();
    let folder = desk.folder("", Origin::of(&made.provenance).telling(&made.result.notes))?;
    let name = p.file_name();
    folder.check(&name)?;
    let stem = &p.polynomial.table;
    let drawn = if desk.plots {
        draw(&folder, &plot::thermistor::figures(&made.result), |figure| format!("THERMISTOR_{figure}__{stem}.png"))?
    } else {
        Vec::new()
    };
    let outcome = Outcome {
        name: &name,
        parameters: desk.parameter_text("", &name, p, &made.provenance)?,
        report: format!("REPORT_THERMISTOR__{stem}.md"),
        title: show::thermistor::title(&made.result),
        notes: &made.result.notes,
        sections: show::thermistor::sections(&made.result, &name),
        provenance: &made.provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok((name, drawn))
}
