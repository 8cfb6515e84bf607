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
    /// Why it is stale.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reason: Option<String>,
    /// State of the run that it is named after, if that run has no results any more: it is gone from the campaign, refused or left out.
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
        let stem = self.name().rsplit_once('.').map_or(self.name(), |(stem, _)| stem);
        let of_name = stem.split_once("__").is_some_and(|(_, id)| id == run || id == run.replace('_', "-"));
        of_name || self.path.split_once('/').is_some_and(|(folder, _)| folder == run)
    }

    /// What files of groups of one kind share: the name up to the run, the ending, and the command. Those of a run lie in its folder.
    fn kind_of_group(&self) -> Option<(&str, &str, &str)> {
        if self.path.contains('/') {
            return None;
        }
        let (stem, ending) = self.path.rsplit_once('.').unwrap_or((&self.path, ""));
        Some((stem.split_once("__").map_or(stem, |(kind, _)| kind), ending, &self.command))
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

    /// Says of every file anew whether it is stale and whether its run has no results any more.
    pub fn judge(&mut self) {
        let over: Vec<(&String, &RunEntry)> = self
            .runs
            .iter()
            .filter(|(_, run)| matches!(run.state, RunState::Gone | RunState::Excluded | RunState::Refused))
            .collect();
        let marks: Vec<Option<RunState>> =
            self.files.iter().map(|file| over.iter().find(|(id, _)| file.is_named_after(id)).map(|(_, run)| run.state)).collect();
        self.files.iter_mut().zip(&marks).for_each(|(file, mark)| file.mark = *mark);
        let runs: HashMap<&str, (&String, &RunEntry)> =
            self.runs.iter().filter_map(|(id, run)| Some((run.path.as_deref()?, (id, run)))).collect();
        let outdated = |file: &FileEntry| self.outdated(file, |path| runs.get(path).copied());
        let mut reasons: Vec<Option<String>> =
            self.files.iter().zip(&marks).map(|(file, mark)| mark.map_or_else(|| outdated(file), |_| None)).collect();
        // What rests on a stale file is stale, and polynomials and the calibrations of their runs rest on each other.
        loop {
            let is_old = |i: &usize| reasons[*i].is_some() || marks[*i].is_some();
            let old: BTreeMap<&str, usize> =
                (0..self.files.len()).filter(is_old).map(|i| (self.files[i].path.as_str(), i)).collect();
            let next: Vec<(usize, String)> = (0..self.files.len())
                .filter(|i| !is_old(i))
                .filter_map(|i| {
                    let (path, at) = self.files[i].from.iter().find_map(|v| old.get_key_value(v.path.as_str()))?;
                    Some((
                        i,
                        marks[*at]
                            .map_or_else(|| format!("{path} is stale"), |state| format!("{path} is of a run that is {state}")),
                    ))
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
            file.stale = reason.is_some();
            file.reason = reason;
        }
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
        let looks = LOOKING.iter().any(|command| file.command.starts_with(command));
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
                RunState::Gone => Some(format!("run {id} is gone from the campaign")),
                RunState::Excluded if !looks => Some(format!("run {id} is left out now")),
                RunState::Refused if !looks => Some(format!("run {id} is refused now")),
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

    /// Whether the calibration of a run alone is younger than that of the thermal group, which stands in its place and has this path.
    #[must_use]
    pub fn is_overtaken(&self, path: &str) -> bool {
        self.file(path).is_some_and(|file| self.remade(file).is_some())
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
