//! The ground calibration file of a sensor from the files that a campaign gave.

use super::Desk;
use crate::data::error::Finding;
use crate::data::provenance::Provenance;
use crate::data::recipe::Recipe;
use crate::files::export::{Exported, Options, Source, rpcmag};
use crate::files::ledger::Origin;
use serde::Serialize;
use std::path::PathBuf;

/// What the recipe of an exported file says.
#[derive(Serialize)]
pub struct ExportRecipe {
    /// Name of the form.
    pub format: &'static str,
    /// The polynomials of a TPF were measured at the centre of the coil system.
    pub at_centre: bool,
}

/// Why there is no ground calibration file.
#[derive(Clone, Debug)]
pub enum NoGround {
    /// What it lacks, in words, or why a file does not fit.
    Lacking(Finding),
    /// A file cannot be read or written.
    Failed(Finding),
}

/// The ground calibration file of the sensor of a TCF in the folder for results, with the other files there that it takes: offsets across
/// temperatures where the TCF has none, the thermistor; returns its name.
///
/// # Errors
/// [`NoGround`]
pub fn ground_calibration(tcf: &str, tof: Option<&str>, thermistor: Option<&str>, desk: &Desk) -> Result<String, NoGround> {
    let names = [Some(tcf), tof, thermistor];
    let paths = names.into_iter().flatten().map(|name| desk.out.join(name)).collect::<Vec<PathBuf>>();
    let read = paths.iter().map(|path| Source::read(path)).collect::<Result<Vec<Source>, Finding>>();
    let sources = read.map_err(NoGround::Failed)?;
    let input = sources.iter().map(|source| source.input().clone()).collect();
    let recipe = Recipe::new("export", &ExportRecipe { format: "rpcmag", at_centre: false });
    let options = Options { provenance: Provenance::new(recipe, input), at_centre: false, report: Vec::new() };
    let file = rpcmag::export(&sources, &options).map_err(NoGround::Lacking)?;
    write(&file, Origin::of(&options.provenance), desk).map_err(NoGround::Failed)?;
    Ok(file.name)
}

fn write(file: &Exported, origin: Origin, desk: &Desk) -> Result<(), Finding> {
    let folder = desk.folder("", origin)?;
    folder.check(&file.name)?;
    folder.write(&file.name, file.text.as_bytes())?;
    folder.sync()
}
