//! `calfit verify`: re-reads the inputs of parameter files, compares their hashes, fits again and compares the values.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::data::recipe::Recipe;
use crate::files::parameter::{AnyFile, FileKind, read_any};
use crate::files::source::read_pieces;
use crate::workflow::{Desk, Ingredients, again};
use clap::Args;
use serde::Serialize;
use std::borrow::Cow;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Parameter files, folders that hold them, and folders in which their inputs are looked for: campaigns and result folders.
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
    /// Values compared.
    values: usize,
    /// Largest relative difference.
    largest_difference: f64,
    /// What is wrong.
    problems: Vec<String>,
}

/// Folders above a parameter file, or above the working folder, in which inputs are looked for.
const LEVELS_ABOVE: usize = 4;

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let mut files = Vec::new();
    let mut places = Vec::new();
    for path in &arguments.paths {
        let meta = std::fs::metadata(path).map_err(|e| Finding::io(path, "open", &e))?;
        if meta.is_dir() {
            collect(path, 0, &mut files)?;
            places.push(path.clone());
        } else {
            files.push(path.clone());
        }
    }
    if files.is_empty() {
        let shown: Vec<String> = arguments.paths.iter().map(|p| p.display().to_string()).collect();
        return Err(Finding::error(
            &shown.join(", "),
            "holds no parameter file",
            "name parameter files of calfit, or folders that hold them",
        ));
    }
    let bar = terminal.progress(files.len());
    let verdicts: Vec<Verdict> = files
        .iter()
        .map(|file| {
            let verdict = verify(file, &places, arguments.tolerance);
            bar.inc(1);
            verdict
        })
        .collect();
    bar.finish_and_clear();
    if common.json {
        terminal.print(&json(&verdicts)?);
    } else {
        for v in &verdicts {
            v.problems.iter().for_each(|p| terminal.error(&format!("{}: {p}", v.file)));
            if v.ok {
                terminal.tell(&format!(
                    "{}: verified, {} inputs unchanged, {} values equal (largest relative difference {:.1e})\n",
                    v.file, v.inputs, v.values, v.largest_difference
                ));
            }
        }
    }
    Ok(if verdicts.iter().all(|v| v.ok) { Status::Done } else { Status::Partly })
}

fn collect(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), Finding> {
    let mut entries: Vec<PathBuf> = std::fs::read_dir(folder)
        .map_err(|e| Finding::io(folder, "list the folder", &e))?
        .flatten()
        .map(|entry| entry.path())
        .collect();
    entries.sort();
    for path in entries {
        if path.is_dir() {
            if depth == 0 {
                collect(&path, depth + 1, files)?;
            }
        } else if FileKind::of_name(&path).is_some() {
            files.push(path);
        }
    }
    Ok(())
}

fn verify(file: &Path, places: &[PathBuf], tolerance: f64) -> Verdict {
    let mut verdict = Verdict {
        file: file.display().to_string(),
        ok: false,
        inputs: 0,
        values: 0,
        largest_difference: 0.0,
        problems: Vec::new(),
    };
    if let Err(problems) = compare(file, places, tolerance, &mut verdict) {
        verdict.problems.extend(problems);
    }
    verdict.ok = verdict.problems.is_empty();
    verdict
}

fn compare(file: &Path, places: &[PathBuf], tolerance: f64, verdict: &mut Verdict) -> Result<(), Vec<String>> {
    let one = |f: Finding| vec![format!("{}; {}", f.rule, f.remedy)];
    let mut stated = read_any(file).map_err(one)?;
    let recipe = stated.provenance.recipe().map_err(|e| vec![e.to_string()])?;
    let (mut found, mut problems) = (Vec::new(), Vec::new());
    for input in &stated.provenance.input {
        match locate(input, file, places) {
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

/// Why an input is not there.
#[derive(Debug, thiserror::Error)]
enum NotFound {
    #[error(
        "the input {} is not what the file was made from: {} has another SHA-256 than {}",
        input.path,
        found.display(),
        input.sha256.get(..16).unwrap_or_default()
    )]
    Another { input: Input, found: PathBuf },
    #[error("the input {0} is not found; name its campaign folder as a further PATH")]
    Absent(String),
}

/// The input with the recorded path and hash: beside the file, in the named places, or in the folders above.
fn locate(input: &Input, file: &Path, places: &[PathBuf]) -> Result<PathBuf, NotFound> {
    let real = file.canonicalize().unwrap_or_else(|_| file.to_owned());
    let work = std::env::current_dir().unwrap_or_default();
    let above = |path: &Path| path.ancestors().take(LEVELS_ABOVE + 1).map(Path::to_owned).collect::<Vec<PathBuf>>();
    let mut roots: Vec<PathBuf> = places.to_vec();
    roots.extend(above(real.parent().unwrap_or(&real)));
    roots.extend(above(&work));
    let mut other = None;
    for root in roots {
        let children = std::fs::read_dir(&root).into_iter().flatten().flatten().map(|e| e.path()).filter(|p| p.is_dir());
        let mut folders: Vec<PathBuf> = children.collect();
        folders.sort();
        for folder in std::iter::once(root).chain(folders) {
            let candidate = folder.join(&input.path);
            if candidate.is_file() {
                match read_pieces(&candidate, true, |_| Ok(())) {
                    Ok(digested) if digested.sha256 == input.sha256 => return Ok(candidate),
                    _ => other = Some(candidate),
                }
            }
        }
    }
    Err(match other {
        Some(found) => NotFound::Another { input: input.clone(), found },
        None => NotFound::Absent(input.path.clone()),
    })
}

/// Makes the result again in a folder of its own.
fn make_again(file: &Path, stated: &AnyFile, recipe: &Recipe, with: &Ingredients) -> Result<AnyFile, Vec<String>> {
    let folder = tempfile::tempdir().map_err(|e| vec![format!("no temporary folder: {e}")])?;
    let desk = Desk::plain(folder.path().to_owned());
    again(recipe, with, &desk).map_err(|e| vec![e.to_string()])?;
    let mut paths = Vec::new();
    collect(folder.path(), 0, &mut paths).map_err(|f| vec![f.to_string()])?;
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

/// Keys that files of earlier versions of the program do not have.
const LATER_KEYS: [&str; 9] = [
    "apply",
    "valid_field_nt",
    "linearisation",
    "known_effects",
    "hypothesis",
    "std_b",
    "std_combined",
    "covariance_b",
    "covariance_combined",
];

/// Values of two parameter files side by side.
#[derive(Default)]
struct Differences {
    values: usize,
    largest: f64,
    list: Vec<String>,
}

impl Differences {
    fn of(stated: &toml_edit::DocumentMut, again: &toml_edit::DocumentMut, tolerance: f64) -> Self {
        let mut differences = Self::default();
        // Files of the time before the polynomials of both corners have those of one.
        let again = one_corner(stated, again);
        let (mut a, mut b) = (Vec::new(), Vec::new());
        flatten("", stated.as_item(), &mut a);
        flatten("", again.as_item(), &mut b);
        let earlier: Vec<&str> = LATER_KEYS.into_iter().filter(|key| stated.get(key).is_none()).collect();
        let compared = |key: &str| {
            let table = key.split('.').next().unwrap_or(key);
            table != "provenance" && !earlier.contains(&table)
        };
        let own = |list: Vec<(String, String)>| list.into_iter().filter(|(k, _)| compared(k)).collect::<Vec<_>>();
        let (a, b) = (own(a), own(b));
        for (key, value) in &a {
            differences.values += 1;
            let Some((_, other)) = b.iter().find(|(k, _)| k == key) else {
                differences.list.push(format!("{key} = {value} does not come back"));
                continue;
            };
            let same = match (value.parse::<f64>(), other.parse::<f64>()) {
                (Ok(x), Ok(y)) if x.is_nan() && y.is_nan() => true,
                (Ok(x), Ok(y)) => {
                    let difference = if x == y { 0.0 } else { (x - y).abs() / x.abs().max(y.abs()) };
                    differences.largest = differences.largest.max(difference);
                    difference <= tolerance
                }
                _ => value == other,
            };
            if !same {
                differences.list.push(format!("{key} = {value} comes back as {other}"));
            }
        }
        for (key, value) in b.iter().filter(|(k, _)| !a.iter().any(|(other, _)| other == k)) {
            differences.list.push(format!("{key} = {value} is not in the file"));
        }
        differences
    }
}

/// Begin of what a TAF holds of the corner between neighbouring amplitudes.
const INTERPOLATED: &str = "f_3db_igep";

/// A file that was made again, without the corner between neighbouring amplitudes where the stated one has nothing of it.
fn one_corner<'a>(stated: &toml_edit::DocumentMut, again: &'a toml_edit::DocumentMut) -> Cow<'a, toml_edit::DocumentMut> {
    let of_corner = |name: &str| name.starts_with(INTERPOLATED);
    if stated.iter().any(|(key, _)| of_corner(key)) || !again.iter().any(|(key, _)| of_corner(key)) {
        return Cow::Borrowed(again);
    }
    let mut made = again.clone();
    made.retain(|key, _| !of_corner(key));
    if let Some(covariance) = made.get_mut("covariance").and_then(|c| c.as_table_mut()) {
        covariance.retain(|key, _| !of_corner(key));
    }
    if let Some(quantities) = made.get_mut("quantity").and_then(|q| q.as_array_of_tables_mut()) {
        quantities.retain(|table| !table.get("name").and_then(|n| n.as_str()).is_some_and(of_corner));
    }
    if let Some(warnings) = made.get_mut("warnings").and_then(|w| w.as_array_mut()) {
        warnings.retain(|warning| !warning.as_str().is_some_and(of_corner));
    }
    Cow::Owned(made)
}

/// Every value with its path.
fn flatten(path: &str, item: &toml_edit::Item, list: &mut Vec<(String, String)>) {
    use toml_edit::{Item, Value};
    fn value(path: &str, v: &Value, list: &mut Vec<(String, String)>) {
        match v {
            Value::Array(a) => a.iter().enumerate().for_each(|(i, v)| value(&format!("{path}.{i}"), v, list)),
            Value::InlineTable(t) => t.iter().for_each(|(k, v)| value(&format!("{path}.{k}"), v, list)),
            Value::String(s) => list.push((path.to_owned(), s.value().clone())),
            Value::Float(f) => list.push((path.to_owned(), format!("{:?}", f.value()))),
            other => list.push((path.to_owned(), other.to_string().trim().to_owned())),
        }
    }
    let join = |key: &str| if path.is_empty() { key.to_owned() } else { format!("{path}.{key}") };
    match item {
        Item::None => {}
        Item::Value(v) => value(path, v, list),
        Item::Table(t) => t.iter().for_each(|(k, v)| flatten(&join(k), v, list)),
        Item::ArrayOfTables(a) => {
            for (i, t) in a.iter().enumerate() {
                t.iter().for_each(|(k, v)| flatten(&join(&format!("{i}.{k}")), v, list));
            }
        }
    }
}
