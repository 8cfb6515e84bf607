//! What a command writes into a result folder, noted as it is written.

use crate::data::index::Version;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::{Input, Provenance};
use crate::data::start::Start;
use std::collections::{BTreeMap, BTreeSet};
use std::sync::{Arc, Mutex, PoisonError};

/// Where the files of one result come from.
#[derive(Clone, Debug, Default)]
pub struct Origin {
    /// The command that makes them.
    pub command: String,
    /// When they were made, as it stands in them.
    pub created: String,
    /// What they were made from.
    pub from: Vec<Version>,
    /// Names of files of the same result folder that they rest on as well, in the form in which they are there in the end.
    pub uses: Vec<String>,
    /// Kinds of what a person should know about the result, each once.
    pub kinds: BTreeSet<NoteKind>,
    /// They list all runs of a campaign, whether anything in them rests on a run or not.
    pub lists_all_runs: bool,
}

impl Origin {
    /// Of a result with this provenance.
    #[must_use]
    pub fn of(provenance: &Provenance) -> Self {
        let version = |input: &Input| Version { path: input.path.clone(), sha256: input.sha256.clone() };
        Self {
            command: provenance.command.clone(),
            created: provenance.created.clone(),
            from: provenance.input.iter().map(version).collect(),
            uses: Vec::new(),
            kinds: BTreeSet::new(),
            lists_all_runs: false,
        }
    }

    /// The same of files that list all runs of a campaign.
    #[must_use]
    pub fn listing_all_runs(self) -> Self {
        Self { lists_all_runs: true, ..self }
    }

    /// The same with the kinds of these notes.
    #[must_use]
    pub fn telling(self, notes: &[Note]) -> Self {
        Self { kinds: notes.iter().map(|note| note.kind).collect(), ..self }
    }

    /// The same with files of the result folder that it rests on.
    #[must_use]
    pub fn using(self, names: impl IntoIterator<Item = String>) -> Self {
        Self { uses: names.into_iter().collect(), ..self }
    }
}

/// A file that was written, or found there as it would have been written.
#[derive(Clone, Debug)]
pub struct Written {
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// Where it comes from; the files of one result have this in common.
    pub origin: Arc<Origin>,
}

/// Files that were written by their paths inside the result folder.
pub type WrittenFiles = BTreeMap<String, Written>;

/// All files of a command; every copy notes in the same list.
#[derive(Clone, Debug, Default)]
pub struct Ledger(Arc<Mutex<WrittenFiles>>);

impl Ledger {
    pub(super) fn note(&self, path: String, sha256: String, origin: &Arc<Origin>) {
        let written = Written { sha256, origin: Arc::clone(origin) };
        self.0.lock().unwrap_or_else(PoisonError::into_inner).insert(path, written);
    }

    /// What was written so far.
    #[must_use]
    pub fn written(&self) -> WrittenFiles {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Whether an earlier file and a new one differ by nothing but the date, which stands in the new one as `created`.
#[must_use]
pub fn same_but_dates(earlier: &[u8], new: &[u8], created: &str) -> bool {
    if earlier.len() != new.len() {
        return false;
    }
    let is_date = |bytes: &[u8]| std::str::from_utf8(bytes).is_ok_and(|text| text.parse::<Start>().is_ok());
    let mut done = 0;
    if !created.is_empty() {
        for at in memchr::memmem::find_iter(new, created) {
            let end = at + created.len();
            if earlier[done..at] != new[done..at] || !is_date(&earlier[at..end]) {
                return false;
            }
            done = end;
        }
    }
    earlier[done..] == new[done..]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_dates_may_differ() {
        let new = b"created = 2026-03-01T08:00:00Z, of 2026-03-01T08:00:00Z";
        let same = |earlier: &[u8]| same_but_dates(earlier, new, "2026-03-01T08:00:00Z");
        assert!(same(new));
        assert!(same(b"created = 2025-01-01T00:00:00Z, of 2025-01-01T00:00:00Z"));
        assert!(!same(b"created = 2025-01-01T00:00:0xZ, of 2025-01-01T00:00:00Z"));
        assert!(!same(b"created = 2025-01-01T00:00:00Z. of 2025-01-01T00:00:00Z"));
        assert!(!same(b"created = 2025-01-01T00:00:00Z, of 2025-01-01T00:00:00Z "));
        assert!(!same_but_dates(b"a", b"b", ""));
    }
}
