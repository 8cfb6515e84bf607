//! `INDEX.json` of a result folder, and what the files of a folder without one say of themselves.

use super::output::{Folder, is_own};
use super::parameter::{FileKind, read_any};
use super::source::{digest, open};
use crate::data::error::Finding;
use crate::data::index::{FileEntry, INDEX_FILE, INDEX_FORMAT, INDEX_VERSION, Index, RunEntry, Version};
use crate::data::note::NoteKind;
use crate::data::run_state::RunState;
use serde::Deserialize;
use serde::de::value::StrDeserializer;
use std::collections::BTreeSet;
use std::fs::DirEntry;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What every index has, of any version.
#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
}

/// The index of a folder; `None` where there is none.
///
/// # Errors
/// The file cannot be read, is not of this program, or of a later version.
pub fn read(folder: &Path) -> Result<Option<Index>, Finding> {
    let path = folder.join(INDEX_FILE);
    let mut text = String::new();
    match std::fs::symlink_metadata(&path) {
        Ok(_) => open(&path)?.read_to_string(&mut text).map_err(|e| Finding::io(&path, "read", &e))?,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
        Err(error) => return Err(Finding::io(&path, "read", &error)),
    };
    let refuse = |rule: String| {
        let remedy = "move it away: what the files of calfit say of themselves is taken in its place";
        Finding::error(&path.display().to_string(), rule, remedy)
    };
    let head: Head = serde_json::from_str(&text).map_err(|e| refuse(format!("is no index of a result folder: {e}")))?;
    if head.format != INDEX_FORMAT || head.version == 0 {
        return Err(refuse("is no index of a result folder".to_owned()));
    }
    if head.version > INDEX_VERSION {
        return Err(refuse(format!("holds version {}, not {INDEX_VERSION}, of a later calfit", head.version)));
    }
    let mut index: Index = serde_json::from_str(&text).map_err(|e| refuse(format!("is a damaged index: {e}")))?;
    index.files.sort_by(|a, b| a.path.cmp(&b.path));
    Ok(Some(index))
}

/// Writes the index of a folder.
///
/// # Errors
/// A foreign file of its name, or what the operating system says.
pub fn write(folder: &Folder, index: &Index) -> Result<(), Finding> {
    let text = serde_json::to_string_pretty(index)
        .map_err(|e| Finding::error(INDEX_FILE, format!("the index has no text form: {e}"), "report this"))?;
    folder.write(INDEX_FILE, format!("{text}\n").as_bytes())?;
    folder.sync()
}

/// Files in a folder and in the folders in it that calfit wrote, by their marks, in the order of their paths inside it.
///
/// # Errors
/// An error of the operating system.
pub fn own_files(folder: &Path) -> Result<Vec<String>, Finding> {
    let mut list = Vec::new();
    for path in entries(folder)? {
        let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        if path.is_dir() {
            for file in entries(&path)? {
                if is_known_own(&file)? {
                    list.push(format!("{name}/{}", file.file_name().unwrap_or_default().to_string_lossy()));
                }
            }
        } else if name != INDEX_FILE && is_known_own(&path)? {
            list.push(name);
        }
    }
    list.sort();
    Ok(list)
}

/// Whether this tool wrote a file. Of one that cannot be read nobody knows: it is neither its own nor a foreign one.
fn is_known_own(path: &Path) -> Result<bool, Finding> {
    is_own(path).map_err(|e| Finding::io(path, "read", &e))
}

fn entries(folder: &Path) -> Result<Vec<PathBuf>, Finding> {
    let listing = match std::fs::read_dir(folder) {
        Ok(listing) => listing,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(Vec::new()),
        Err(error) => return Err(Finding::io(folder, "list the folder", &error)),
    };
    let path = |entry: std::io::Result<DirEntry>| entry.map(|e| e.path()).map_err(|e| Finding::io(folder, "list the folder", &e));
    listing.map(path).collect()
}

/// An index of what the files of a folder say of themselves; `None` if calfit wrote none of them.
///
/// # Errors
/// An error of the operating system.
pub fn adopt(folder: &Path) -> Result<Option<Index>, Finding> {
    let own = own_files(folder)?;
    if own.is_empty() {
        return Ok(None);
    }
    let mut index = Index::default();
    for path in &own {
        let file = folder.join(path);
        let sha256 = digest(&file)?.sha256;
        let mut entry = FileEntry {
            path: path.clone(),
            sha256,
            from: Vec::new(),
            command: String::new(),
            stale: false,
            reason: None,
            mark: None,
            warning_kinds: Vec::new(),
            replaces: Vec::new(),
        };
        if let Some(stated) = FileKind::of_name(&file).and_then(|_| read_any(&file).ok()) {
            let input = &stated.provenance.input;
            entry.from = input.iter().map(|i| Version { path: i.path.clone(), sha256: i.sha256.clone() }).collect();
            entry.command = stated.provenance.command.clone();
            entry.warning_kinds = kinds_of(&stated.document);
            let of_run = input.iter().find(|i| i.is_run());
            if let (Some((id, mut run)), Some(input)) = (run_of(&stated.document), of_run) {
                run.sha256 = Some(input.sha256.clone());
                run.path = Some(input.path.clone());
                index.runs.insert(id, run);
            }
        }
        index.put(entry);
    }
    index.judge();
    Ok(Some(index))
}

/// The kinds of the notes of a parameter file, each once.
fn kinds_of(document: &toml_edit::DocumentMut) -> Vec<NoteKind> {
    let names = document.get("warning_kinds").and_then(|v| v.as_array()).into_iter().flatten().filter_map(|v| v.as_str());
    let kind = |name: &str| NoteKind::deserialize(StrDeserializer::<serde::de::value::Error>::new(name)).ok();
    names.filter_map(kind).collect::<BTreeSet<NoteKind>>().into_iter().collect()
}

/// The run that a parameter file of a single run is of.
#[must_use]
pub fn run_of(document: &toml_edit::DocumentMut) -> Option<(String, RunEntry)> {
    let run = document.get("run")?.as_table_like()?;
    let text = |key: &str| run.get(key).and_then(|v| v.as_str()).filter(|t| !t.is_empty()).map(str::to_owned);
    let entry =
        RunEntry { state: RunState::Done, reason: None, sha256: None, start: text("start"), sensor: text("sensor"), path: None };
    Some((text("id")?, entry))
}
