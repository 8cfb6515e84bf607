//! `calfit verify`: re-reads the inputs of parameter files, compares their hashes, fits again and compares the values; of a result folder it
//! also compares the hashes of all other files.

mod differences;
mod places;

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::recipe::Recipe;
use crate::files::parameter::{AnyFile, FileKind, files_of, read_any};
use crate::files::source::digest;
use crate::workflow::{Desk, Ingredients, again};
use clap::Args;
use differences::Differences;
use places::{Homes, locate};
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Parameter files, result folders and other folders that hold them, and folders in which their inputs are looked for. Without such a
    /// folder they are looked for where the index of the result folder says that they were.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Largest relative difference of a value that counts as equal; 0 asks for the same bits.
    #[arg(long, value_name = "X", default_value_t = 1e-9)]
    tolerance: f64,
}

/// What was found about one file.
#[derive(Serialize)]
struct Verdict {
    file: String,
    ok: bool,
    /// Inputs whose hashes match.
    inputs: usize,
    /// The files that were compared with the recorded inputs.
    compared_with: Vec<String>,
    /// Values compared.
    values: usize,
    /// Largest relative difference.
    largest_difference: f64,
    /// What is wrong.
    problems: Vec<String>,
}

impl Verdict {
    /// Nothing is wrong yet.
    fn on(file: &Path) -> Self {
        Self {
            file: file.display().to_string(),
            ok: true,
            inputs: 0,
            compared_with: Vec::new(),
            values: 0,
            largest_difference: 0.0,
            problems: Vec::new(),
        }
    }
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let mut files = Vec::new();
    let mut places = Vec::new();
    let (mut homes, mut others) = (Homes::default(), Vec::new());
    for path in &arguments.paths {
        let meta = std::fs::metadata(path).map_err(|e| Finding::io(path, "open", &e))?;
        if meta.is_dir() {
            files.extend(files_of(path)?);
            others.extend(without_inputs(path, &mut homes)?);
            places.push(path.clone());
        } else {
            files.push(path.clone());
        }
    }
    if files.is_empty() && others.is_empty() {
        let shown: Vec<String> = arguments.paths.iter().map(|p| p.display().to_string()).collect();
        return Err(Finding::error(
            &shown.join(", "),
            "holds no parameter file",
            "name parameter files of calfit, or folders that hold them",
        ));
    }
    let bar = terminal.progress(files.len(), "verified");
    let name = |file: &Path| file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut verdicts: Vec<Verdict> = Vec::new();
    for file in &files {
        verdicts.push(bar.of(&name(file), || {
            let mut verdict = Verdict::on(file);
            if let Err(problems) = compare(file, &places, &mut homes, arguments.tolerance, &mut verdict) {
                verdict.problems.extend(problems);
            }
            verdict.ok = verdict.problems.is_empty();
            verdict
        }));
    }
    bar.finish();
    let all_ok = verdicts.iter().chain(&others).all(|v| v.ok);
    tell(verdicts, others, common, terminal)?;
    Ok(if all_ok { Status::Done } else { Status::Partly })
}

/// Prints what was found: a line for every parameter file, the rest of a result folder in one.
fn tell(mut verdicts: Vec<Verdict>, others: Vec<Verdict>, common: &Common, terminal: &Terminal) -> Result<(), Finding> {
    if common.json {
        verdicts.extend(others);
        terminal.print(&json(&verdicts)?);
        return Ok(());
    }
    for v in verdicts.iter().chain(&others) {
        v.problems.iter().for_each(|p| terminal.error(&format!("{}: {p}", v.file)));
    }
    for v in verdicts.iter().filter(|v| v.ok) {
        terminal.tell(&format!(
            "{}: verified, {} inputs unchanged, {} values equal (largest relative difference {:.1e}), compared with {}\n",
            v.file,
            v.inputs,
            v.values,
            v.largest_difference,
            shortened(&v.compared_with)
        ));
    }
    if !others.is_empty() {
        let good = others.iter().filter(|v| v.ok).count();
        terminal.tell(&format!("{good} of {} figures, tables and reports are as they were written\n", others.len()));
    }
    Ok(())
}

/// A path without steps to a parent and back, as far as nothing of it is a link.
fn plain(path: &Path) -> PathBuf {
    path.canonicalize().unwrap_or_else(|_| path.to_owned())
}

/// The first of some files, and how many more there are.
fn shortened(files: &[String]) -> String {
    const MOST: usize = 3;
    let first = files.iter().take(MOST).map(String::as_str).collect::<Vec<_>>().join(", ");
    if files.len() > MOST { format!("{first} and {} more", files.len() - MOST) } else { first }
}

/// The files of a result folder that are no parameter files, or are not there, each with the hash that its index states.
fn without_inputs(folder: &Path, homes: &mut Homes) -> Result<Vec<Verdict>, Finding> {
    let Some(home) = homes.of_folder(folder)? else { return Ok(Vec::new()) };
    let mut verdicts = Vec::new();
    for entry in &home.index.files {
        let path = folder.join(&entry.path);
        let is_parameter_file = FileKind::of_name(&path).is_some();
        let mut verdict = Verdict::on(&path);
        if !path.is_file() {
            verdict
                .problems
                .push("is missing: the index of the folder names it; `calfit report` of the campaign makes it again".to_owned());
        } else if is_parameter_file {
            continue;
        } else {
            if digest(&path)?.sha256 != entry.sha256 {
                verdict.problems.push(CHANGED.to_owned());
            }
            verdict.problems.extend(home.obstacle(entry));
        }
        verdict.ok = verdict.problems.is_empty();
        verdicts.push(verdict);
    }
    Ok(verdicts)
}

/// A file whose hash is not that of the index.
const CHANGED: &str = "was changed after it was written: it has another SHA-256 than the index of its folder states; take the original, or make it again";

fn compare(file: &Path, places: &[PathBuf], homes: &mut Homes, tolerance: f64, verdict: &mut Verdict) -> Result<(), Vec<String>> {
    let one = |f: Finding| vec![format!("{}; {}", f.rule, f.remedy)];
    let mut stated = read_any(file).map_err(one)?;
    let home = homes.of_file(file).map_err(one)?;
    if let Some((home, entry)) = home {
        if entry.sha256 != stated.input.sha256 {
            verdict.problems.push(CHANGED.to_owned());
        }
        if let Some(obstacle) = home.obstacle(entry) {
            return Err(vec![obstacle]);
        }
    }
    let home = home.map(|(home, _)| home);
    let recipe = stated.provenance.recipe().map_err(|e| vec![e.to_string()])?;
    let (mut found, mut problems) = (Vec::new(), Vec::new());
    for input in &stated.provenance.input {
        match locate(input, file, home, places) {
            Ok(path) => found.push((input.clone(), path)),
            Err(problem) => problems.push(problem.to_string()),
        }
    }
    // People read the command; it must be that of the recipe.
    let command = &stated.provenance.command;
    if stated.provenance.recipe.is_some() && *command != recipe.command(&stated.provenance.input) {
        problems.push(format!("the command `{command}` does not say what the recipe says"));
    }
    if !problems.is_empty() {
        return Err(problems);
    }
    verdict.inputs = found.len();
    verdict.compared_with = found.iter().map(|(_, path)| plain(path).display().to_string()).collect();
    if is_of_earlier_sweep(&stated.document) {
        let text = "its polynomials are from before those of a sweep were fitted as polynomials of the model itself, and do not come back; \
                    make the file again from its inputs";
        return Err(vec![text.to_owned()]);
    }
    let made = make_again(file, &stated, &recipe, &Ingredients::of(found))?;
    let differences = Differences::of(&stated.document, &made.document, tolerance);
    verdict.values = differences.values;
    verdict.largest_difference = differences.largest;
    if differences.list.is_empty() {
        return Ok(());
    }
    const MOST: usize = 5;
    let more = differences.list.len().saturating_sub(MOST);
    let mut problems: Vec<String> = differences.list.into_iter().take(MOST).collect();
    if more > 0 {
        problems.push(format!("{more} more values differ"));
    }
    Err(problems)
}

/// Whether a file is of a sweep and from before files said how the lag was decided, with which the fit came.
fn is_of_earlier_sweep(document: &toml_edit::DocumentMut) -> bool {
    document.get("sweep").and_then(toml_edit::Item::as_table_like).is_some_and(|sweep| !sweep.contains_key("applied_lag"))
}

/// Makes the result again in a folder of its own.
fn make_again(file: &Path, stated: &AnyFile, recipe: &Recipe, with: &Ingredients) -> Result<AnyFile, Vec<String>> {
    let folder = tempfile::tempdir().map_err(|e| vec![format!("no temporary folder: {e}")])?;
    let desk = Desk::plain(folder.path().to_owned());
    again(recipe, with, &desk).map_err(|e| vec![e.to_string()])?;
    let paths = files_of(folder.path()).map_err(|f| vec![f.to_string()])?;
    let read = paths.iter().map(|path| read_any(path)).collect::<Result<Vec<AnyFile>, Finding>>();
    let made = read.map_err(|f| vec![f.to_string()])?;
    // The file may have another name by now, or that of a run in a thermal group.
    let name = file.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let format = |file: &AnyFile| file.document.get("format").and_then(|f| f.as_str()).map(str::to_owned);
    let same = made.iter().position(|one| one.input.path == name);
    match same.or_else(|| made.iter().position(|one| format(one) == format(stated))) {
        Some(index) => Ok(made[index].clone()),
        None => Err(vec!["fitting again gave no result; run the recorded command on the inputs to see why".to_owned()]),
    }
}
