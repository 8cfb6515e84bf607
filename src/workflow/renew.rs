//! Results of a folder that rest on what has changed, made again: those of analyses that a report does not make itself.

use super::{Desk, Ingredients, again};
use crate::data::error::Finding;
use crate::data::index::{FileEntry, Index};
use crate::data::provenance::{Input, Provenance};
use crate::data::run_state::RunState;
use crate::files::output::is_gone;
use crate::files::parameter::{FileKind, read_any};
use serde::Deserialize;
use std::path::{Path, PathBuf};

/// The result of a diagnosis, the one result with a recipe that is no parameter file.
pub(super) const DIAGNOSIS_FILE: &str = "diagnosis.json";

/// Analyses that a report does not make: their results are as old as what they were made from.
const BESIDE_REPORT: [&str; 4] = ["diagnose", "linearise", "coil tilt", "freq"];

/// A file that was made again, by its path inside the folder for results.
pub struct Renewed {
    /// The path.
    pub path: String,
    /// What went wrong.
    pub made: Result<(), Finding>,
}

/// Makes again what is stale in the folder for results and belongs to no analysis of a report, with the options that it was made with, what
/// others rest on before them. What rests on a run without a result, or on a file that is not where it was, stays as it is.
///
/// # Errors
/// A result that says of itself how it was made cannot be read.
pub fn renew(desk: &Desk) -> Result<Vec<Renewed>, Finding> {
    let mut all: Vec<Renewed> = Vec::new();
    loop {
        let index = desk.results.now();
        let is_stale = |path: &str| index.file(path).is_some_and(|file| file.stale);
        let mut next = index.files.iter().filter(|file| {
            let is_ready = !file.from.iter().any(|from| is_stale(&from.path)) && !rests_on_no_result(file, &index);
            file.stale && file.mark.is_none() && is_ready && !all.iter().any(|one| one.path == file.path)
        });
        let made = next.find_map(|file| one(file, &index, desk).transpose()).transpose()?;
        match made {
            Some(made) => all.push(made),
            None => return Ok(all),
        }
    }
}

/// Makes a file again; `None` if it does not say how, or a report makes it.
fn one(file: &FileEntry, index: &Index, desk: &Desk) -> Result<Option<Renewed>, Finding> {
    let Some(mut provenance) = origin(&desk.out.join(&file.path))? else { return Ok(None) };
    let Ok(recipe) = provenance.recipe() else { return Ok(None) };
    if !BESIDE_REPORT.contains(&recipe.analysis.as_str()) {
        return Ok(None);
    }
    let found = provenance.input.into_iter().map(|input| Some((input.clone(), locate(&input, index, &desk.out)?)));
    let Some(found) = found.collect::<Option<Vec<(Input, PathBuf)>>>() else { return Ok(None) };
    let made = again(&recipe, &Ingredients::of(found), desk)
        .map_err(|e| Finding::error(&file.path, e.to_string(), format!("run `{}` on its inputs to see why", file.command)));
    Ok(Some(Renewed { path: file.path.clone(), made }))
}

/// How a result says that it was made; `None` for figures, tables and reports, which come with one that does, and for one that was deleted.
fn origin(path: &Path) -> Result<Option<Provenance>, Finding> {
    if is_gone(path) {
        return Ok(None);
    }
    #[derive(Deserialize)]
    struct Made {
        provenance: Provenance,
    }
    if path.file_name().is_some_and(|name| name == DIAGNOSIS_FILE) {
        let text = std::fs::read_to_string(path).map_err(|e| Finding::io(path, "read", &e))?;
        let made: Made = serde_json::from_str(&text).map_err(|e| {
            let shown = path.display().to_string();
            Finding::error(&shown, format!("is no diagnosis: {e}"), "delete it, and run `calfit diagnose` again")
        })?;
        return Ok(Some(made.provenance));
    }
    if FileKind::of_name(path).is_none() {
        return Ok(None);
    }
    Ok(Some(read_any(path)?.provenance))
}

/// Whether a run that a file was made from is gone, left out or refused now.
fn rests_on_no_result(file: &FileEntry, index: &Index) -> bool {
    let over = |state| matches!(state, RunState::Gone | RunState::Excluded | RunState::Refused);
    file.from.iter().any(|from| index.run_of(&from.path).is_some_and(|(_, run)| over(run.state)))
}

/// Where an input lies now, whatever it holds: in the folder for results, or in a place of the campaign.
fn locate(input: &Input, index: &Index, out: &Path) -> Option<PathBuf> {
    let own = index.files.iter().filter(|file| file.name() == input.path).map(|file| out.join(&file.path));
    let placed = index.campaign.places.iter().map(|place| out.join(place).join(&input.path));
    own.chain(placed).find(|path| path.is_file())
}
