//! A result as files: its figures, its report, its parameter file, and the tables of all runs of a kind.

use super::{Desk, Made, PerRun, RunResult};
use crate::data::error::Finding;
#[cfg(feature = "tables")]
use crate::data::index::Index;
use crate::data::note::Note;
use crate::data::provenance::Provenance;
use crate::files::ledger::Origin;
#[cfg(feature = "tables")]
use crate::files::ledger::WrittenFiles;
use crate::files::output::Folder;
use crate::files::parameter::{self, Body};
#[cfg(feature = "tables")]
use crate::files::source::digest;
use crate::plot::{self, Named};
use crate::show::document::Section;
use crate::show::{self, Drawn, markdown};
use rayon::prelude::*;

/// Draws the figures that hold data in parallel and writes them in their order.
///
/// # Errors
/// A figure cannot be drawn or written.
pub fn draw(folder: &Folder, figures: &[Named], name: impl Fn(&str) -> String + Sync) -> Result<Vec<Drawn>, Finding> {
    let with_data = |named: &Named| Some(Named { stem: named.stem, figure: named.figure.clone().with_data()? });
    let figures: Vec<Named> = figures.iter().filter_map(with_data).collect();
    let pictures: Vec<Result<Vec<u8>, plot::PlotError>> = figures.par_iter().map(|named| plot::render(&named.figure)).collect();
    figures
        .iter()
        .zip(pictures)
        .map(|(named, picture)| {
            let file = name(named.stem);
            let shown = folder.path().join(&file).display().to_string();
            let picture = picture.map_err(|e| Finding::error(&shown, e.to_string(), "run again with --no-plots"))?;
            folder.write(&file, &picture)?;
            Ok(Drawn { file, title: named.figure.title.clone(), caption: named.figure.caption.clone() })
        })
        .collect()
}

/// The text of a parameter file.
///
/// # Errors
/// A value without a text form, which would be an error of this program.
pub fn parameter_text<B: Body>(name: &str, body: &B, provenance: &Provenance) -> Result<String, Finding> {
    parameter::to_text(body, provenance)
        .map_err(|e| Finding::error(name, format!("the result has no text form: {e}"), "report this"))
}

/// Writes the results of one run into its folder, the parameter file last; returns the figures.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish<A: PerRun>(made: &Made<A::Result>, desk: &Desk, parameter_name: &str) -> Result<Vec<Drawn>, Finding> {
    let result = &made.result;
    let id = &result.head().id;
    let folder = desk.folder(id, Origin::of(&made.provenance).telling(result.notes()))?;
    folder.check(parameter_name)?;
    let drawn = if desk.plots {
        draw(&folder, &(A::Result::SHOWN.figures)(result), |stem| format!("{}_{stem}__{id}.png", A::STEM))?
    } else {
        Vec::new()
    };
    #[cfg(feature = "tables")]
    for (stem, note, table) in result.tables() {
        folder.write(&format!("{stem}__{id}.csv"), &table.csv(&note)?)?;
    }
    let outcome = Outcome {
        name: parameter_name,
        parameters: desk.parameter_text(id, parameter_name, &result.parameters(), &made.provenance)?,
        report: format!("REPORT_{}__{id}.md", A::STEM),
        title: format!("{}, run {id}", A::Result::TITLE),
        notes: result.notes(),
        sections: (A::Result::SHOWN.sections)(result, parameter_name),
        provenance: &made.provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok(drawn)
}

/// Report and parameter file of a result.
pub struct Outcome<'a> {
    /// Name of the parameter file.
    pub name: &'a str,
    /// Its text.
    pub parameters: String,
    /// Name of the report.
    pub report: String,
    /// Title of the report.
    pub title: String,
    /// What a person should know.
    pub notes: &'a [Note],
    /// Sections of the report.
    pub sections: Vec<Section>,
    /// Where the result comes from.
    pub provenance: &'a Provenance,
}

impl Outcome<'_> {
    /// Writes the report with its figures, then the parameter file: what that rests on is safe on disk before it, and its own name after
    /// it.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn write(self, folder: &Folder, drawn: &[Drawn]) -> Result<(), Finding> {
        let figures = Drawn::number(drawn, "", &mut 0);
        let document = show::standalone(&self.title, self.notes, self.sections, figures, self.provenance);
        folder.write(&self.report, markdown::page(&document).as_bytes())?;
        folder.sync()?;
        folder.write(self.name, self.parameters.as_bytes())?;
        folder.sync()
    }
}

/// Writes the table of all runs of one kind, as CSV and Parquet, if the command wrote a parameter file of the kind: from all parameter files
/// of the folder that are as the index says, where a run has two from that of its thermal group unless the other one was made again
/// since.
///
/// # Errors
/// What cannot be written; a file that is as the index says and cannot be read.
#[cfg(feature = "tables")]
pub fn publish_table<A: PerRun>(now: &Index, written: &WrittenFiles, desk: &Desk) -> Result<(), Finding> {
    type Parameters<A> = <<A as PerRun>::Result as RunResult>::Parameters;
    let is_one = |path: &str| parameter::is_named::<Parameters<A>>(std::path::Path::new(path));
    if !written.keys().any(|path| is_one(path)) {
        return Ok(());
    }
    let mut paths: Vec<&str> =
        now.files.iter().filter(|f| f.mark.is_none() && is_one(&f.path)).map(|f| f.path.as_str()).collect();
    let replaced: Vec<String> = paths
        .iter()
        .filter_map(|path| Some((*path, parameter::alone_of(path)?)))
        .filter(|(_, alone)| paths.contains(&alone.as_str()))
        .map(|(path, alone)| if now.is_overtaken(path) { path.to_owned() } else { alone })
        .collect();
    paths.retain(|path| !replaced.iter().any(|r| r == path));
    let as_stated = |path: &&str| -> Result<Option<(String, Parameters<A>)>, Finding> {
        let is_stated = |sha256: &str| now.file(path).is_some_and(|entry| entry.sha256 == sha256);
        let there = desk.out.join(path);
        match parameter::read::<Parameters<A>>(&there) {
            Ok(file) => Ok(is_stated(&file.input.sha256).then_some((path.to_string(), file.body))),
            // What was changed or taken away by hand is told by `verify`.
            Err(_) if !there.exists() => Ok(None),
            Err(finding) => match digest(&there) {
                Ok(other) if !is_stated(&other.sha256) => Ok(None),
                _ => Err(finding),
            },
        }
    };
    let read: Vec<Option<(String, Parameters<A>)>> = paths.iter().map(as_stated).collect::<Result<_, _>>()?;
    let (used, rows): (Vec<String>, Vec<Parameters<A>>) = read.into_iter().flatten().unzip();
    let Some((note, table)) = A::Result::campaign_table(&rows) else { return Ok(()) };
    if rows.is_empty() {
        return Ok(());
    }
    let origin = Origin { command: format!("calfit {}", A::COMMAND), ..Origin::default() };
    let folder = desk.folder("", origin.using(used))?;
    let [csv, parquet] = table_names(A::STEM);
    folder.write(&csv, &table.csv(&format!("{}: one row per run; {note}", A::COMMAND))?)?;
    folder.write(&parquet, &table.parquet()?)?;
    folder.sync()
}

/// Names of the tables of all runs of one kind.
#[must_use]
pub fn table_names(stem: &str) -> [String; 2] {
    ["csv", "parquet"].map(|end| format!("{stem}_PARAMETERS.{end}"))
}
