//! The index of a result folder: which runs its results are of, what became of each, and what every file rests on.

use crate::data::note::NoteKind;
use crate::data::run_state::{Outcome, RunState};
use crate::data::start::Start;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet, HashMap};

/// Name of the index in a result folder.
pub const INDEX_FILE: &str = "INDEX.json";
/// Value of the key `format`.
pub const INDEX_FORMAT: &str = "INDEX";
/// Version of the layout that is written.
pub const INDEX_VERSION: u32 = 1;
/// Name under which the file of a campaign is recorded.
const CAMPAIGN_FILE: &str = "campaign.toml";
/// Analyses that look at runs of other analyses, whose word on a run does not count there.
const LOOKING: [&str; 2] = ["calfit diagnose", "calfit coil"];

/// A file at one time.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct Version {
    /// Path inside the result folder or the campaign, with forward slashes; with `../` before the name for another file that has the name
    /// of one in the result folder.
    pub path: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
}

/// The campaign that a result folder belongs to.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct CampaignEntry {
    /// Its name; that of its folder where nothing else is stated.
    pub name: String,
    /// SHA-256 of its `campaign.toml`; absent without one.
    #[serde(default)]
    pub sha256: Option<String>,
    /// Folders in which the inputs were found, from the result folder, with forward slashes.
    #[serde(default)]
    pub places: Vec<String>,
}

/// A run of the campaign.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct RunEntry {
    /// What became of it.
    pub state: RunState,
    /// Why; absent for a run that was analysed.
    pub reason: Option<String>,
    /// SHA-256 of its file as it was analysed last; absent if it never was.
    pub sha256: Option<String>,
    /// Start, UTC; absent for a table in place of a run.
    pub start: Option<String>,
    /// Sensor; absent if not stated.
    pub sensor: Option<String>,
    /// Path of its file inside the campaign; absent if only its parameter file was seen.
    #[serde(default)]
    pub path: Option<String>,
}

impl RunEntry {
    /// Whether a run of the same id can be another one: its start or its sensor differ.
    #[must_use]
    pub fn contradicts(&self, start: Option<&str>, sensor: Option<&str>) -> bool {
        let moment = |text: &str| text.parse::<Start>().map_or(f64::NAN, |s| s.seconds());
        let other_start = self.start.as_deref().zip(start).is_some_and(|(a, b)| a != b && moment(a) != moment(b));
        let other_sensor = self.sensor.as_deref().zip(sensor).is_some_and(|(a, b)| a != b);
        other_start || other_sensor
    }

    /// The same with another outcome.
    pub fn set(&mut self, outcome: Outcome) {
        self.state = outcome.state;
        self.reason = outcome.reason;
    }
}

/// A file of the result folder.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FileEntry {
    /// Path inside the result folder, with forward slashes.
    pub path: String,
    /// SHA-256 of its bytes, hexadecimal.
    pub sha256: String,
    /// What it was made from, each as it was then.
    pub from: Vec<Version>,
    /// The command that makes it; empty if it is not known.
    pub command: String,
    /// What it was made from is not there any more as it was then.
    pub stale: bool,
    /// Why it is stale, or why it cannot be made again.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// State of the run that it is named after, if that run has no results any more: it is gone from the campaign, refused or left out. With
    /// a reason that of a run that it rests on: what is left of the campaign gives no such file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mark: Option<RunState>,
    /// Kinds of what a person should know about it, each once, for parameter files and diagnoses.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub warning_kinds: Vec<NoteKind>,
    /// What it stands in the place of: an earlier file of its name, and the calibration of a run alone where it is that of a thermal group.
    pub replaces: Vec<Version>,
}

impl FileEntry {
    /// The file as something that others rest on.
    #[must_use]
    pub fn version(&self) -> Version {
        Version { path: self.path.clone(), sha256: self.sha256.clone() }
    }

    /// Whether it is named after a run, or lies in its folder.
    #[must_use]
    pub fn is_named_after(&self, run: &str) -> bool {
        self.run_names().any(|name| name == run || name == run.replace('_', "-"))
    }

    /// The run in its name, whose parts may be joined by dashes, and that in whose folder it lies.
    fn run_names(&self) -> impl Iterator<Item = &str> {
        let stem = self.name().rsplit_once('.').map_or(self.name(), |(stem, _)| stem);
        let of_name = stem.split_once("__").map(|(_, id)| id);
        of_name.into_iter().chain(self.path.split_once('/').map(|(folder, _)| folder))
    }

    /// Whether it is marked since a report of the campaign as it is could not make it.
    #[must_use]
    pub fn is_given_up(&self) -> bool {
        self.mark.is_some() && self.reason.is_some()
    }

    /// What files of groups of one kind share: the name up to the run, the ending, and the command. Those of a run lie in its folder.
    fn kind_of_group(&self) -> Option<(&str, &str, &str)> {
        if self.path.contains('/') {
            return None;
        }
        let (stem, ending) = self.path.rsplit_once('.').unwrap_or((&self.path, ""));
        Some((stem.split_once("__").map_or(stem, |(kind, _)| kind), ending, &self.command))
    }

    /// Whether an analysis made it that looks at runs of others.
    fn looks(&self) -> bool {
        LOOKING.iter().any(|command| self.command.starts_with(command))
    }

    /// Whether a run of this state gives it nothing now. Who looks at a run that the campaign does not use has a result all the same.
    fn lacks(&self, state: RunState) -> bool {
        state.is_over() && (state != RunState::NotApplicable || !self.looks())
    }

    /// What is wrong with it as something that others rest on.
    fn as_basis(&self) -> String {
        match self.mark {
            Some(_) if self.reason.is_some() => format!("{} cannot be made again", self.path),
            Some(state) => format!("{} is of a run that is {state}", self.path),
            None => format!("{} is stale", self.path),
        }
    }

    /// The last part of its path.
    #[must_use]
    pub fn name(&self) -> &str {
        self.path.rsplit('/').next().unwrap_or(&self.path)
    }
}

/// What a result folder holds.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Index {
    /// Program and version: the mark of a file that may be written over.
    pub written_by: String,
    /// `INDEX`.
    pub format: String,
    /// Version of the layout.
    pub version: u32,
    /// The campaign.
    pub campaign: CampaignEntry,
    /// The runs by their ids.
    pub runs: BTreeMap<String, RunEntry>,
    /// The files in the order of their paths.
    pub files: Vec<FileEntry>,
}

impl Default for Index {
    fn default() -> Self {
        Self {
            written_by: concat!("calfit ", env!("CARGO_PKG_VERSION")).to_owned(),
            format: INDEX_FORMAT.to_owned(),
            version: INDEX_VERSION,
            campaign: CampaignEntry::default(),
            runs: BTreeMap::new(),
            files: Vec::new(),
        }
    }
}

impl Index {
    /// The file with this path.
    #[must_use]
    pub fn file(&self, path: &str) -> Option<&FileEntry> {
        self.files.binary_search_by(|f| f.path.as_str().cmp(path)).ok().and_then(|at| self.files.get(at))
    }

    /// The file that has this name and these bytes.
    #[must_use]
    pub fn file_named(&self, name: &str, sha256: &str) -> Option<&FileEntry> {
        self.files.iter().find(|f| f.name() == name && f.sha256 == sha256)
    }

    /// The run whose file has this path inside the campaign.
    #[must_use]
    pub fn run_of(&self, path: &str) -> Option<(&String, &RunEntry)> {
        self.runs.iter().find(|(_, run)| run.path.as_deref() == Some(path))
    }

    /// Takes a file that was written: it stands in the place of an earlier one of its path.
    pub fn put(&mut self, mut entry: FileEntry) {
        match self.files.binary_search_by(|f| f.path.cmp(&entry.path)) {
            Ok(at) => {
                let before = &self.files[at];
                if entry.sha256 == before.sha256 {
                    entry.replaces.extend(before.replaces.iter().filter(|v| v.path == before.path).cloned());
                } else {
                    entry.replaces.push(before.version());
                }
                entry.replaces.sort();
                entry.replaces.dedup();
                self.files[at] = entry;
            }
            Err(at) => self.files.insert(at, entry),
        }
    }

    /// Says of every file anew whether it is stale, whether its run has no results any more, and of those that were given up whether they
    /// still are.
    pub fn judge(&mut self) {
        let given_up: BTreeSet<usize> = (0..self.files.len()).filter(|i| self.files[*i].is_given_up()).collect();
        let over = self.runs.iter().filter(|(_, run)| run.state.is_over());
        let over: BTreeMap<String, RunState> =
            over.flat_map(|(id, run)| [id.clone(), id.replace('_', "-")].map(|name| (name, run.state))).collect();
        let mark = |file: &FileEntry| {
            let state = *file.run_names().find_map(|name| over.get(name))?;
            file.lacks(state).then_some(state)
        };
        let marks: Vec<Option<RunState>> = self.files.iter().map(mark).collect();
        for (file, mark) in self.files.iter_mut().zip(marks) {
            (file.mark, file.reason) = (mark, None);
        }
        self.give_up_of(given_up);
        let runs = self.runs_by_path();
        let outdated = |file: &FileEntry| self.outdated(file, |path| runs.get(path).copied());
        let mut reasons: Vec<Option<String>> =
            self.files.iter().map(|file| if file.mark.is_some() { file.reason.clone() } else { outdated(file) }).collect();
        // What rests on a stale file is stale, and polynomials and the calibrations of their runs rest on each other.
        loop {
            let is_old = |i: &usize| reasons[*i].is_some() || self.files[*i].mark.is_some();
            let old: BTreeMap<&str, usize> =
                (0..self.files.len()).filter(is_old).map(|i| (self.files[i].path.as_str(), i)).collect();
            let next: Vec<(usize, String)> = (0..self.files.len())
                .filter(|i| !is_old(i))
                .filter_map(|i| {
                    let at = self.files[i].from.iter().find_map(|v| old.get(v.path.as_str()))?;
                    Some((i, self.files[*at].as_basis()))
                })
                .collect();
            if next.is_empty() {
                break;
            }
            for (i, reason) in next {
                reasons[i] = Some(reason);
            }
        }
        for (file, reason) in self.files.iter_mut().zip(reasons) {
            file.stale = reason.is_some() && file.mark.is_none();
            file.reason = reason;
        }
    }

    /// Marks stale files that a report of the whole campaign has not made again, since they rest on runs without results.
    pub fn give_up(&mut self, is_written: impl Fn(&str) -> bool) {
        let is_left = |file: &FileEntry| file.stale && !is_written(&file.path);
        self.give_up_of((0..self.files.len()).filter(|i| is_left(&self.files[*i])).collect());
        self.judge();
    }

    /// Marks those of some files that rest on runs without results, or on files that are marked.
    fn give_up_of(&mut self, mut candidates: BTreeSet<usize>) {
        loop {
            let runs = self.runs_by_path();
            let why = |file: &FileEntry| {
                file.from.iter().find_map(|from| {
                    let of_run = runs.get(from.path.as_str()).filter(|(_, run)| file.lacks(run.state));
                    let of_run = of_run.map(|(id, run)| (run.state, without_result(id, run.state)));
                    of_run.or_else(|| {
                        let basis = self.file(&from.path)?;
                        Some((basis.mark?, basis.as_basis()))
                    })
                })
            };
            let open = candidates.iter().filter(|i| self.files[**i].mark.is_none());
            let found: Vec<(usize, (RunState, String))> = open.filter_map(|i| Some((*i, why(&self.files[*i])?))).collect();
            if found.is_empty() {
                return;
            }
            for (i, (state, reason)) in found {
                candidates.remove(&i);
                (self.files[i].mark, self.files[i].reason, self.files[i].stale) = (Some(state), Some(reason), false);
            }
        }
    }

    /// The runs with their ids by the paths of their files.
    fn runs_by_path(&self) -> HashMap<&str, (&String, &RunEntry)> {
        self.runs.iter().filter_map(|(id, run)| Some((run.path.as_deref()?, (id, run)))).collect()
    }

    /// Passes over stale files, and those of runs without results, that were deleted, unless something that is there rests on them: nobody
    /// misses them. Other files that are not there are missing, which has to be told.
    pub fn forget_deleted(&mut self, is_there: impl Fn(&str) -> bool) {
        let is_over = |file: &&FileEntry| (file.stale || file.mark.is_some()) && !is_there(&file.path);
        let mut deleted: BTreeSet<String> = self.files.iter().filter(is_over).map(|file| file.path.clone()).collect();
        loop {
            let others = self.files.iter().filter(|file| !deleted.contains(&file.path));
            let used: Vec<String> =
                others.flat_map(|file| &file.from).filter(|v| deleted.contains(&v.path)).map(|v| v.path.clone()).collect();
            if used.is_empty() {
                break;
            }
            used.iter().for_each(|path| _ = deleted.remove(path));
        }
        self.files.retain(|file| !deleted.contains(&file.path));
    }

    /// The file that the same command has made of the same kind from the same runs and more: a group that lacked its first run for a while
    /// was named after another one then.
    #[must_use]
    pub fn made_from_more(&self, file: &FileEntry) -> Option<&FileEntry> {
        let kind = Some(file.kind_of_group()?);
        let of_kind = |other: &&FileEntry| other.mark.is_none() && other.kind_of_group() == kind && other.path != file.path;
        let mut others = self.files.iter().filter(of_kind).peekable();
        others.peek()?;
        let runs: BTreeSet<&str> = self.runs.values().filter_map(|run| run.path.as_deref()).collect();
        let runs_of = |file: &FileEntry| -> BTreeSet<&str> {
            file.from.iter().filter_map(|v| runs.get(v.path.as_str()).copied()).collect()
        };
        let own = runs_of(file);
        others.find(|other| !own.is_empty() && own != runs_of(other) && own.is_subset(&runs_of(other)))
    }

    /// What to do about a stale file.
    #[must_use]
    pub fn remedy(&self, file: &FileEntry) -> &'static str {
        match self.made_from_more(file) {
            Some(_) => "delete it",
            None => "make it again with `calfit report` or its own command",
        }
    }

    /// Why a file is stale by what it was made from itself; `run_of` finds a run by its path.
    fn outdated<'a>(&self, file: &FileEntry, run_of: impl Fn(&str) -> Option<(&'a String, &'a RunEntry)>) -> Option<String> {
        if let Some(replaced) = self.remade(file) {
            return Some(format!("{} was made again", replaced.path));
        }
        if let Some(larger) = self.made_from_more(file) {
            return Some(format!("{} has been made from the same runs and more", larger.path));
        }
        let looks = file.looks();
        file.from.iter().find_map(|from| {
            let path = &from.path;
            if let Some(now) = self.file(path) {
                return (now.sha256 != from.sha256).then(|| format!("{path} was made again"));
            }
            if path == CAMPAIGN_FILE {
                let changed = self.campaign.sha256.as_ref().is_some_and(|now| *now != from.sha256);
                return changed.then(|| format!("{path} was changed"));
            }
            let (id, run) = run_of(path)?;
            match run.state {
                RunState::Gone => Some(without_result(id, run.state)),
                RunState::Excluded | RunState::Refused if !looks => Some(without_result(id, run.state)),
                _ if run.sha256.as_ref().is_some_and(|now| *now != from.sha256) => Some(format!("{path} was changed")),
                _ => None,
            }
        })
    }

    /// The other file in whose place one stands, if that was made again since.
    fn remade<'a>(&self, file: &'a FileEntry) -> Option<&'a Version> {
        let changed = |v: &&Version| v.path != file.path && self.file(&v.path).is_some_and(|now| now.sha256 != v.sha256);
        file.replaces.iter().find(changed)
    }

    /// Whether the calibration of a run alone is younger than that of the thermal group, which stands in its place and has this path, or the
    /// group has no polynomials any more.
    #[must_use]
    pub fn is_overtaken(&self, path: &str) -> bool {
        self.file(path).is_some_and(|file| file.is_given_up() || self.remade(file).is_some())
    }
}

/// Why nothing can be made from a run again.
fn without_result(id: &str, state: RunState) -> String {
    match state {
        RunState::Gone => format!("run {id} is gone from the campaign"),
        RunState::Excluded => format!("run {id} is left out now"),
        RunState::Refused => format!("run {id} is refused now"),
        RunState::Done | RunState::NotApplicable => format!("run {id} is not analysed now"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn version(path: &str, sha256: &str) -> Version {
        Version { path: path.to_owned(), sha256: sha256.to_owned() }
    }

    fn entry(path: &str, sha256: &str, from: &[(&str, &str)]) -> FileEntry {
        FileEntry {
            path: path.to_owned(),
            sha256: sha256.to_owned(),
            from: from.iter().map(|(p, s)| version(p, s)).collect(),
            command: "calfit lin".to_owned(),
            stale: false,
            reason: None,
            mark: None,
            warning_kinds: Vec::new(),
            replaces: Vec::new(),
        }
    }

    fn run(path: &str, sha256: &str) -> RunEntry {
        RunEntry {
            state: RunState::Done,
            reason: None,
            sha256: Some(sha256.to_owned()),
            start: Some("2013-04-03T09:22:38Z".to_owned()),
            sensor: Some("A".to_owned()),
            path: Some(path.to_owned()),
        }
    }

    /// Two runs, their calibrations, polynomials of both, which rest on each other with one of them, and a report.
    fn folder() -> Index {
        let mut index = Index::default();
        index.runs.insert("13-04-03_08".to_owned(), run("a.CCR", "a"));
        index.runs.insert("13-04-03_09".to_owned(), run("b.CCR", "b"));
        index.put(entry("13-04-03_08/A.CPF", "ca", &[("a.CCR", "a"), ("T__13-04-03-08.TPF", "t")]));
        index.put(entry("13-04-03_09/B.CPF", "cb", &[("b.CCR", "b")]));
        index.put(entry("T__13-04-03-08.TPF", "t", &[("13-04-03_08/A.CPF", "ca"), ("13-04-03_09/B.CPF", "cb")]));
        index.put(entry("REPORT.md", "r", &[("T__13-04-03-08.TPF", "t"), ("b.CCR", "b")]));
        index.judge();
        index
    }

    fn stale(index: &Index) -> Vec<&str> {
        index.files.iter().filter(|f| f.stale).map(|f| f.path.as_str()).collect()
    }

    #[test]
    fn what_rests_on_a_file_that_was_made_again_is_stale_also_in_a_circle() {
        let mut index = folder();
        assert!(stale(&index).is_empty());
        index.put(entry("13-04-03_09/B.CPF", "cb2", &[("b.CCR", "b")]));
        index.judge();
        assert_eq!(stale(&index), ["13-04-03_08/A.CPF", "REPORT.md", "T__13-04-03-08.TPF"]);
        assert_eq!(index.file("13-04-03_09/B.CPF").unwrap().replaces, [version("13-04-03_09/B.CPF", "cb")]);
        assert_eq!(index.file("T__13-04-03-08.TPF").unwrap().reason.as_deref(), Some("13-04-03_09/B.CPF was made again"));
    }

    #[test]
    fn what_stands_in_the_place_of_a_file_that_was_made_again_is_stale() {
        let mut index = folder();
        index.put(FileEntry { replaces: vec![version("A.CPF", "alone")], ..entry("T.CPF", "group", &[]) });
        index.put(entry("A.CPF", "alone", &[]));
        index.judge();
        assert!(stale(&index).is_empty());
        index.put(entry("A.CPF", "another", &[]));
        index.judge();
        assert_eq!(stale(&index), ["T.CPF"]);
        assert!(index.is_overtaken("T.CPF") && !index.is_overtaken("A.CPF"));
    }

    #[test]
    fn what_is_of_a_run_that_is_gone_is_marked_and_the_rest_is_stale() {
        let mut index = folder();
        index.runs.get_mut("13-04-03_08").unwrap().set(Outcome::new(RunState::Gone, "no file"));
        index.judge();
        assert_eq!(stale(&index), ["REPORT.md"]);
        let marked: Vec<&str> = index.files.iter().filter(|f| f.mark.is_some()).map(|f| f.path.as_str()).collect();
        assert_eq!(marked, ["13-04-03_08/A.CPF", "T__13-04-03-08.TPF"]);
        let mut index = folder();
        index.runs.get_mut("13-04-03_09").unwrap().set(Outcome::new(RunState::Gone, "no file"));
        index.judge();
        assert_eq!(index.file("13-04-03_09/B.CPF").unwrap().mark, Some(RunState::Gone));
        assert!(index.file("REPORT.md").unwrap().stale);
    }

    #[test]
    fn what_no_report_can_make_again_is_marked_until_its_runs_are_back() {
        let mut index = folder();
        let set = |index: &mut Index, state| {
            index.runs.get_mut("13-04-03_09").unwrap().set(Outcome { state, reason: None });
            index.judge();
        };
        set(&mut index, RunState::Excluded);
        assert_eq!(stale(&index), ["13-04-03_08/A.CPF", "REPORT.md", "T__13-04-03-08.TPF"]);
        // The report itself was written.
        index.put(entry("REPORT.md", "r2", &[("a.CCR", "a")]));
        index.judge();
        index.give_up(|path| path == "REPORT.md");
        let given_up =
            |index: &Index| -> Vec<String> { index.files.iter().filter(|f| f.is_given_up()).map(|f| f.path.clone()).collect() };
        assert!(stale(&index).is_empty());
        assert_eq!(given_up(&index), ["13-04-03_08/A.CPF", "T__13-04-03-08.TPF"]);
        assert_eq!(index.file("T__13-04-03-08.TPF").unwrap().mark, Some(RunState::Excluded));
        assert_eq!(
            index.file("T__13-04-03-08.TPF").unwrap().reason.as_deref(),
            Some("13-04-03_09/B.CPF is of a run that is excluded")
        );
        assert!(index.is_overtaken("13-04-03_08/A.CPF"));
        // It stays so, and what is made from it is stale.
        index.put(entry("X.png", "x", &[("T__13-04-03-08.TPF", "t")]));
        index.judge();
        assert_eq!((stale(&index), given_up(&index).len()), (vec!["X.png"], 2));
        set(&mut index, RunState::Done);
        assert!(stale(&index).is_empty() && given_up(&index).is_empty());
    }

    #[test]
    fn a_group_that_lacked_a_run_for_a_while_leaves_a_stale_file() {
        let of = |path: &str, from: &[(&str, &str)]| FileEntry { command: "calfit report".to_owned(), ..entry(path, path, from) };
        let mut index = folder();
        index.runs.insert("13-04-03_10".to_owned(), run("c.CCR", "c"));
        index.runs.insert("13-04-03_11".to_owned(), run("d.CCR", "d"));
        let all = [("a.CCR", "a"), ("b.CCR", "b"), ("c.CCR", "c")];
        index.put(of("OFF__13-04-03-09.TOF", &all[1..]));
        index.put(of("AC__13-04-03-09.TAF", &all[1..]));
        index.judge();
        assert!(stale(&index).is_empty());
        index.put(of("OFF__13-04-03-08.TOF", &all));
        // Of another command, and of other runs.
        index.put(FileEntry { command: "calfit thermal --joint".to_owned(), ..of("AC__13-04-03-08.TAF", &all) });
        index.put(of("OFF__13-04-03-10.TOF", &[("c.CCR", "c"), ("d.CCR", "d")]));
        index.judge();
        assert_eq!(stale(&index), ["OFF__13-04-03-09.TOF"]);
        // Without its first run the smaller group is what there is.
        index.runs.get_mut("13-04-03_08").unwrap().set(Outcome::new(RunState::Refused, "unreadable"));
        index.judge();
        assert!(!index.file("OFF__13-04-03-09.TOF").unwrap().stale);
    }

    #[test]
    fn a_stale_file_that_was_deleted_is_not_missed_unless_another_rests_on_it() {
        let deleted = |gone: &[&str]| {
            let mut index = folder();
            index.put(entry("13-04-03_09/B.CPF", "cb2", &[("b.CCR", "b")]));
            index.judge();
            index.forget_deleted(|path| !gone.contains(&path));
            index.files.into_iter().map(|f| f.path).collect::<Vec<String>>()
        };
        assert_eq!(deleted(&["REPORT.md"]), ["13-04-03_08/A.CPF", "13-04-03_09/B.CPF", "T__13-04-03-08.TPF"]);
        // The polynomials and the calibration rest on each other, and the report on the polynomials.
        assert_eq!(deleted(&["REPORT.md", "T__13-04-03-08.TPF", "13-04-03_08/A.CPF"]), ["13-04-03_09/B.CPF"]);
        assert_eq!(deleted(&["T__13-04-03-08.TPF", "13-04-03_08/A.CPF"]).len(), 4);
        // What is not stale is missing.
        assert_eq!(deleted(&["13-04-03_09/B.CPF"]).len(), 4);
    }

    #[test]
    fn a_file_is_named_after_its_run_alone() {
        let of = |path: &str, run: &str| entry(path, "", &[]).is_named_after(run);
        assert!(of("13-04-03_08/A.CPF", "13-04-03_08") && of("T__13-04-03-08.TPF", "13-04-03_08"));
        assert!(of("THERMISTOR__pt.1000.toml", "pt.1000"));
        assert!(!of("REPORT.md", "R") && !of("13-04-03_08/A.CPF", "13-04-03_0") && !of("T__13-04-03-08.TPF", "13-04-03"));
    }

    #[test]
    fn runs_of_one_id_differ_by_start_or_sensor() {
        let own = run("a.CCR", "a");
        assert!(!own.contradicts(Some("2013-04-03T09:22:38Z"), Some("A")));
        assert!(!own.contradicts(None, None));
        assert!(own.contradicts(Some("2013-04-03T09:22:39Z"), Some("A")));
        assert!(own.contradicts(None, Some("B")));
    }
}
