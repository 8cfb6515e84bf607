//! Where the inputs of a parameter file lie: what the index of its result folder says, and what the user named. Nowhere else is looked, so
//! that a copy in another campaign is not taken for the input.

use crate::data::error::Finding;
use crate::data::index::{FileEntry, Index};
use crate::data::provenance::Input;
use crate::data::run_state::RunState;
use crate::files::index;
use crate::files::source::digest;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// A result folder with its index.
pub(super) struct Home {
    /// The folder.
    pub root: PathBuf,
    /// Its index.
    pub index: Index,
}

/// The result folders of the files that are verified, each read once.
#[derive(Default)]
pub(super) struct Homes(BTreeMap<PathBuf, Option<Home>>);

impl Homes {
    /// The folder with its index; `None` if it has none.
    ///
    /// # Errors
    /// The index cannot be read.
    pub fn of_folder(&mut self, folder: &Path) -> Result<Option<&Home>, Finding> {
        if !self.0.contains_key(folder) {
            let home = index::read(folder)?.map(|index| Home { root: folder.to_owned(), index });
            self.0.insert(folder.to_owned(), home);
        }
        Ok(self.0.get(folder).and_then(Option::as_ref))
    }

    /// The result folder that a file lies in, itself or in the folder of a run, and what its index says of the file.
    ///
    /// # Errors
    /// The index cannot be read.
    pub fn of_file(&mut self, file: &Path) -> Result<Option<(&Home, &FileEntry)>, Finding> {
        let real = file.canonicalize().unwrap_or_else(|_| file.to_owned());
        for folder in real.ancestors().skip(1).take(2) {
            let Ok(inside) = real.strip_prefix(folder) else { continue };
            let inside: Vec<String> = inside.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect();
            let path = inside.join("/");
            if self.of_folder(folder)?.is_some_and(|home| home.index.file(&path).is_some()) {
                let home = self.0.get(folder).and_then(Option::as_ref);
                return Ok(home.and_then(|home| Some((home, home.index.file(&path)?))));
            }
        }
        Ok(None)
    }
}

impl Home {
    /// Why a file cannot be compared with what it was made from: the run is gone, or what it was made from was made again.
    pub fn obstacle(&self, file: &FileEntry) -> Option<String> {
        if file.mark == Some(RunState::Gone) && file.is_given_up() {
            return file.reason.as_deref().map(|reason| format!("cannot be made again: {reason}; take it away"));
        }
        if file.mark == Some(RunState::Gone) {
            let (id, run) = self.index.runs.iter().find(|(id, run)| run.state == RunState::Gone && file.is_named_after(id))?;
            let why = run.reason.as_deref().unwrap_or("its file is not there");
            return Some(format!("run {id} is gone from the campaign, so that there is nothing to compare with: {why}"));
        }
        let reason = file.reason.as_deref().filter(|_| file.stale)?;
        Some(format!("is stale: {reason}; {}", self.index.remedy(file)))
    }
}

/// Why an input is not there.
#[derive(Debug, thiserror::Error)]
pub(super) enum NotFound {
    #[error(
        "the input {} is not what the file was made from: {} has another SHA-256 than {}; name the folder that holds the input as it was, or make the result again",
        input.path,
        found.display(),
        input.sha256.get(..16).unwrap_or_default()
    )]
    Another { input: Box<Input>, found: PathBuf },
    #[error("the input {0} is not found; name its campaign folder as a further PATH")]
    Absent(String),
}

/// The input with the recorded path and hash: in the result folder, in the places of its index, in the named folders and the folders in
/// them, or beside the file.
pub(super) fn locate(input: &Input, file: &Path, home: Option<&Home>, named: &[PathBuf]) -> Result<PathBuf, NotFound> {
    let mut candidates: Vec<PathBuf> = Vec::new();
    if let Some(home) = home {
        let own = home.index.file_named(&input.path, &input.sha256);
        candidates.extend(own.map(|entry| home.root.join(&entry.path)));
        candidates.extend(home.index.campaign.places.iter().map(|place| home.root.join(place).join(&input.path)));
    }
    for folder in named {
        let children = std::fs::read_dir(folder).into_iter().flatten().flatten().map(|e| e.path()).filter(|p| p.is_dir());
        let mut folders: Vec<PathBuf> = children.collect();
        folders.sort();
        candidates.extend(std::iter::once(folder.clone()).chain(folders).map(|folder| folder.join(&input.path)));
    }
    candidates.extend(file.parent().map(|folder| folder.join(&input.path)));
    let mut other = None;
    for candidate in candidates.into_iter().filter(|path| path.is_file()) {
        match digest(&candidate) {
            Ok(digested) if digested.sha256 == input.sha256 => return Ok(candidate),
            _ => other = other.or(Some(candidate)),
        }
    }
    Err(match other {
        Some(found) => NotFound::Another { input: Box::new(input.clone()), found },
        None => NotFound::Absent(input.path.clone()),
    })
}
