//! Telemetry near the midnights: a day needs it of the files beside its own one, which are read for their own days as well.

use super::Prepared;
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::data::time::Tt2000;
use crate::files::flight::edited::{self, BEYOND_NS, EditedFile, Rows};
use crate::files::source::Digested;
use std::collections::BTreeMap;
use std::ops::Range;
use std::path::PathBuf;
use std::sync::{Arc, Mutex};

/// Rows that are kept at most, about 50 MB: an archive of years is longer than the memory.
const MOST_ROWS: usize = 1_000_000;
/// Days before the one that is made whose rows may still be asked for: two days are made at a time.
const DAYS_BEFORE: i32 = 2;

/// Rows of a file near the first and the last midnight of its day.
pub type Edges = Arc<[Rows; 2]>;

/// What was read of files near the midnights, as far as the memory allows, and their hashes.
#[derive(Debug, Default)]
pub struct Near {
    kept: Mutex<BTreeMap<PathBuf, (i32, Edges)>>,
    hashes: Mutex<BTreeMap<PathBuf, Digested>>,
}

/// The stretches about the midnights of a day that are kept.
fn about(day: &Range<Tt2000>) -> [Range<Tt2000>; 2] {
    [day.start, day.end].map(|at| at - 2 * BEYOND_NS..at + 2 * BEYOND_NS)
}

impl Near {
    /// The rows of a file of a sensor near the midnights of its day, from memory or from the file.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn edges(prepared: &Prepared, index: usize, file: &EditedFile, day: i32) -> Result<Edges, Finding> {
        let near = &prepared.near;
        if let Some((_, edges)) = near.kept.lock().ok().and_then(|kept| kept.get(&file.path).cloned()) {
            return Ok(edges);
        }
        let [begin, end] = about(&prepared.leap.day(day));
        let sensor = &prepared.mission.sensors[index];
        let edges = Arc::new(edited::read(file, sensor, &prepared.mission, &prepared.leap, [&begin, &end])?);
        near.keep(file, day, &edges);
        Ok(edges)
    }

    /// Those of a file of the day beside the one that is made, if all of its rows with tags in a stretch are among them.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn beside(
        prepared: &Prepared,
        index: usize,
        file: &EditedFile,
        day: i32,
        tags: &Range<Tt2000>,
    ) -> Result<Option<Rows>, Finding> {
        let Some(own) = file.day else { return Ok(None) };
        let [begin, end] = about(&prepared.leap.day(own));
        // A day is longer than what is kept of its ends.
        let side = match own - day {
            -1 if end.start <= tags.start => 1,
            1 if tags.end <= begin.end => 0,
            _ => return Ok(None),
        };
        Ok(Some(Self::edges(prepared, index, file, own)?[side].within(tags)))
    }

    /// Keeps what the days beside it need of a file that was read as a whole, and drops what no later day asks for.
    pub fn take(&self, prepared: &Prepared, file: &EditedFile, day: i32, rows: &Rows) {
        let begin = self.kept.lock().ok().map(|mut kept| {
            let folder = file.path.parent().and_then(|own| own.parent());
            kept.retain(|path, (own, _)| *own + DAYS_BEFORE >= day || path.parent().and_then(|p| p.parent()) != folder);
            kept.contains_key(&file.path)
        });
        if begin == Some(false) {
            let edges = Arc::new(about(&prepared.leap.day(day)).map(|stretch| rows.within(&stretch)));
            self.keep(file, day, &edges);
        }
    }

    fn keep(&self, file: &EditedFile, day: i32, edges: &Edges) {
        let rows = |edges: &Edges| edges.iter().map(|rows| rows.tag.len()).sum::<usize>();
        if let Ok(mut kept) = self.kept.lock() {
            let all: usize = kept.values().map(|(_, edges)| rows(edges)).sum();
            if all + rows(edges) <= MOST_ROWS {
                kept.insert(file.path.clone(), (day, Arc::clone(edges)));
            }
        }
    }

    /// A file as an input of a level, under a name.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn input(&self, file: &EditedFile, name: String) -> Result<Input, Finding> {
        if let Some(known) = self.hashes.lock().ok().and_then(|hashes| hashes.get(&file.path).cloned()) {
            return Ok(known.input(name));
        }
        let digested = edited::hash(file)?;
        if let Ok(mut hashes) = self.hashes.lock() {
            hashes.insert(file.path.clone(), digested.clone());
        }
        Ok(digested.input(name))
    }
}
