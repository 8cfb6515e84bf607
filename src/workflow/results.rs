//! The result folder of a command: its lock, the campaign that it belongs to, what is written into it, and its index.

use super::renew::DIAGNOSIS_FILE;
use super::{Desk, RUN_KINDS};
use crate::data::error::Finding;
use crate::data::index::{FileEntry, INDEX_FILE, Index, RunEntry, Version};
use crate::data::provenance::Provenance;
use crate::data::result::RunHead;
use crate::data::run::Header;
use crate::data::run_state::{Outcome, RunState};
use crate::files::campaign::Campaign;
use crate::files::import::Format;
use crate::files::ledger::{Ledger, Origin, Written, WrittenFiles};
use crate::files::lock::FolderLock;
use crate::files::output::{Folder, is_gone};
use crate::files::parameter::{self, FileKind, alone_of};
use crate::files::{ccr, index};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The result folder of a command; by default that of a command whose files belong to no campaign, which has neither lock nor index.
#[derive(Clone, Debug, Default)]
pub struct Results(Option<Arc<Open>>);

/// A result folder that this process holds.
#[derive(Debug)]
struct Open {
    out: PathBuf,
    force: bool,
    /// The index as it was, or what the files of a folder without one say; `None` for a new folder.
    before: Option<Index>,
    ledger: Ledger,
    seen: Mutex<Seen>,
    _lock: FolderLock,
}

/// What a command saw of its inputs.
#[derive(Debug, Default)]
struct Seen {
    campaigns: Vec<SeenCampaign>,
    places: BTreeSet<PathBuf>,
    outcomes: BTreeMap<String, RunEntry>,
    /// The command has made everything that the campaign gives: what is stale and was not made cannot be made again.
    all_made: bool,
}

/// A campaign that the command was given, whole or in part.
#[derive(Debug)]
struct SeenCampaign {
    name: String,
    is_whole: bool,
    /// SHA-256 of `campaign.toml`.
    sha256: Option<String>,
    /// Its run files by their paths inside it, as far as the command was given them; without a head that can be read there is no header.
    runs: BTreeMap<String, Option<Header>>,
    /// Paths of runs that the campaign takes out.
    unused: BTreeSet<String>,
}

/// Files of a result folder that rest on what has changed, after a command.
#[derive(Debug, Default)]
pub struct Left {
    /// Those that can be made again.
    pub stale: Vec<String>,
    /// Those of which the command found that they cannot.
    pub given_up: Vec<String>,
}

impl Results {
    /// Takes a result folder into possession, before anything else is looked at.
    ///
    /// # Errors
    /// Another process uses the folder, it cannot be made or written, or its index cannot be read.
    pub fn open(out: &Path, force: bool) -> Result<Self, Finding> {
        let lock = FolderLock::take(out)?;
        Folder::open(out, force)?.check(INDEX_FILE)?;
        let before = match index::read(out) {
            Ok(Some(index)) => Some(index),
            Ok(None) => index::adopt(out)?,
            // Who writes over the files of others loses what they say.
            Err(_) if force => index::adopt(out)?,
            Err(finding) => return Err(finding),
        };
        let (ledger, seen) = (Ledger::default(), Mutex::default());
        Ok(Self(Some(Arc::new(Open { out: out.to_owned(), force, before, ledger, seen, _lock: lock }))))
    }

    /// Where the files of the command are noted.
    #[must_use]
    pub fn ledger(&self) -> Option<Ledger> {
        self.0.as_ref().map(|open| open.ledger.clone())
    }

    /// Takes the campaigns that a command is given.
    ///
    /// # Errors
    /// The folder holds results of another campaign, or these are several.
    pub fn accept(&self, campaigns: &[Campaign]) -> Result<(), Finding> {
        let Some(open) = &self.0 else { return Ok(()) };
        // Runs without a campaign file may lie anywhere, in several folders as well.
        let is_campaign = |c: &&Campaign| c.input.is_some();
        let roots: Vec<String> = campaigns.iter().filter(is_campaign).map(|c| c.root.display().to_string()).collect();
        if roots.len() > 1 {
            let rule = format!("takes the results of one campaign, and {} are given: {}", roots.len(), roots.join(", "));
            let remedy = "run the command on one after the other, each with a folder of its own (-o)";
            return Err(Finding::error(&open.out.display().to_string(), rule, remedy));
        }
        for campaign in campaigns {
            let seen = SeenCampaign::of(campaign);
            open.compare(campaign, &seen)?;
            let mut all = open.seen();
            all.places.insert(campaign.root.clone());
            all.campaigns.push(seen);
        }
        Ok(())
    }

    /// Takes parameter files of single runs that a command is given.
    ///
    /// # Errors
    /// The folder holds results of another campaign.
    pub fn accept_files(&self, files: &[PathBuf]) -> Result<(), Finding> {
        let Some(open) = &self.0 else { return Ok(()) };
        self.places(files);
        let runs: Vec<(String, RunEntry)> =
            files.iter().filter_map(|file| index::run_of(&parameter::read_any(file).ok()?.document)).collect();
        let mut in_common = false;
        for (id, run) in &runs {
            in_common |= open.agrees(id, run.start.as_deref(), run.sensor.as_deref())?;
        }
        let shown: Vec<String> = files.iter().map(|f| f.display().to_string()).collect();
        if runs.is_empty() || in_common { Ok(()) } else { open.refuse_strangers(&shown.join(", ")) }
    }

    /// Takes tables that a command is given in place of runs. A table says of no campaign that it belongs to it but by where it lies.
    ///
    /// # Errors
    /// The folder holds results of a campaign in whose folder a table does not lie.
    pub fn accept_tables<'a>(&self, tables: impl IntoIterator<Item = &'a PathBuf>) -> Result<(), Finding> {
        let Some(open) = &self.0 else { return Ok(()) };
        let tables: Vec<&PathBuf> = tables.into_iter().collect();
        if open.knows_runs() {
            let homes = open.homes_of_runs();
            for table in tables.iter().filter_map(|table| table.canonicalize().ok()) {
                if !homes.iter().any(|home| table.starts_with(home)) {
                    open.refuse_strangers(&table.display().to_string())?;
                }
            }
        }
        self.places(tables);
        Ok(())
    }

    /// Notes where files lie that a command is given, for those who look for them later.
    pub fn places<'a>(&self, files: impl IntoIterator<Item = &'a PathBuf>) {
        let Some(open) = &self.0 else { return };
        let parents = files.into_iter().filter_map(|file| file.canonicalize().ok()?.parent().map(Path::to_owned));
        open.seen().places.extend(parents);
    }

    /// A run or a table in its place that was analysed.
    pub fn done(&self, head: &RunHead, provenance: &Provenance) {
        let Some(open) = &self.0 else { return };
        let input = provenance.input.first();
        let entry = RunEntry {
            state: RunState::Done,
            reason: None,
            sha256: input.map(|i| i.sha256.clone()),
            start: head.start.as_ref().map(|s| s.as_str().to_owned()),
            sensor: Some(head.sensor.clone()).filter(|s| !s.is_empty()),
            path: input.map(|i| i.path.clone()),
        };
        open.seen().outcomes.insert(head.id.clone(), entry);
    }

    /// What became of the run whose file has this path inside its campaign. A path of no run is passed over.
    pub fn outcome(&self, path: &str, outcome: Outcome) {
        let Some(open) = &self.0 else { return };
        let mut seen = open.seen();
        let header = seen.campaigns.iter().find_map(|c| c.runs.get(path)?.clone());
        if let Some(header) = header {
            let mut entry = entry_of(&header, path);
            entry.set(outcome);
            seen.outcomes.insert(header.run, entry);
        }
    }

    /// What an analysis that only looks at a run says of it: it counts where no other has said anything.
    pub fn looked(&self, path: &str, outcome: Outcome) {
        let Some(open) = &self.0 else { return };
        let said = open.before.as_ref().and_then(|before| before.run_of(path));
        if said.is_none_or(|(_, run)| run.state == RunState::NotApplicable) {
            self.outcome(path, outcome);
        }
    }

    /// The folder as it is now: the index that the command leaves if it ends here.
    #[must_use]
    pub fn now(&self) -> Index {
        self.0.as_ref().map(|open| open.now()).unwrap_or_default()
    }

    /// Says that the command has made everything that the campaign, as it is now, gives.
    pub fn all_made(&self) {
        if let Some(open) = &self.0 {
            open.seen().all_made = true;
        }
    }

    /// Writes the tables of all runs of every kind of which the command wrote a result, from everything that is there.
    ///
    /// # Errors
    /// What cannot be written.
    pub fn renew_tables(&self, desk: &Desk) -> Result<(), Finding> {
        let Some(open) = &self.0 else { return Ok(()) };
        let (now, written) = (open.now(), open.ledger.written());
        RUN_KINDS.iter().try_for_each(|kind| kind.publish_table(&now, &written, desk))
    }

    /// Writes the index; the files that need a look are returned. Without a result and without an index there is none afterwards either.
    ///
    /// # Errors
    /// The index cannot be written.
    pub fn close(&self) -> Result<Left, Finding> {
        let Some(open) = &self.0 else { return Ok(Left::default()) };
        let nothing = open.seen().outcomes.is_empty() && open.ledger.written().is_empty();
        let is_new = !open.out.join(INDEX_FILE).exists() && open.ledger.written().is_empty();
        if nothing || is_new {
            return Ok(Left::default());
        }
        let now = open.now();
        index::write(&Folder::open(&open.out, open.force)?, &now)?;
        let was_given_up =
            |path: &str| open.before.as_ref().and_then(|before| before.file(path)).is_some_and(FileEntry::is_given_up);
        let paths =
            |is_one: &dyn Fn(&FileEntry) -> bool| now.files.iter().filter(|f| is_one(f)).map(|f| f.path.clone()).collect();
        Ok(Left { stale: paths(&|f| f.stale), given_up: paths(&|f| f.is_given_up() && !was_given_up(&f.path)) })
    }
}

impl SeenCampaign {
    fn of(campaign: &Campaign) -> Self {
        let is_whole = campaign.runs.iter().any(|run| !run.named);
        let heads: Vec<Option<Header>> = campaign.runs.par_iter().map(|run| ccr::peek(&run.path).ok()).collect();
        let unused = campaign.runs.iter().zip(&heads).filter(|(_, head)| head.as_ref().is_some_and(|h| !campaign.uses(h)));
        let folder = campaign.root.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        Self {
            name: campaign.file.name.clone().unwrap_or(folder),
            is_whole,
            sha256: campaign.input.as_ref().map(|i| i.sha256.clone()),
            unused: unused.map(|(run, _)| run.recorded.clone()).collect(),
            runs: campaign.runs.iter().map(|run| run.recorded.clone()).zip(heads).collect(),
        }
    }
}

impl Open {
    fn seen(&self) -> MutexGuard<'_, Seen> {
        self.seen.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Refuses a campaign that is another one than that of the results.
    fn compare(&self, campaign: &Campaign, seen: &SeenCampaign) -> Result<(), Finding> {
        let agree = |header: &Header| self.agrees(&header.run, Some(header.start.as_str()), Some(&header.sensor));
        let mut in_common = false;
        for header in seen.runs.values().flatten() {
            in_common |= agree(header)?;
        }
        if in_common {
            return Ok(());
        }
        if !self.knows_runs() {
            // Tables in place of runs belong to the campaign in whose folder they lie.
            let homes = self.homes_of_tables();
            return match homes.first().filter(|_| !homes.iter().any(|home| home.starts_with(&campaign.root))) {
                Some(home) => Err(self.refusal(format!(
                    "holds results of tables in {}, which are not in the folder of {}",
                    home.display(),
                    seen.name
                ))),
                None => Ok(()),
            };
        }
        // Single runs may be the first ones of their campaign.
        let others = if seen.is_whole { Vec::new() } else { Campaign::run_files(&campaign.root).unwrap_or_default() };
        for header in others.par_iter().filter_map(|path| ccr::peek(path).ok()).collect::<Vec<Header>>() {
            in_common |= agree(&header)?;
        }
        if in_common { Ok(()) } else { self.refuse_strangers(&seen.name) }
    }

    /// The folders in which runs of the results of before lie, as far as they are there. Models and facilities may lie in others.
    fn homes_of_runs(&self) -> Vec<PathBuf> {
        let runs = self.before.iter().flat_map(|before| before.runs.values());
        self.homes_of(&runs.filter_map(|run| run.path.as_deref()).collect::<Vec<_>>())
    }

    /// The folders in which tables of the results of before lie.
    fn homes_of_tables(&self) -> Vec<PathBuf> {
        let from = self.before.iter().flat_map(|before| &before.files).flat_map(|file| &file.from);
        let tables: Vec<&str> = from.map(|from| from.path.as_str()).filter(|p| Format::Csv.is_of(Path::new(p))).collect();
        self.homes_of(&tables)
    }

    fn homes_of(&self, files: &[&str]) -> Vec<PathBuf> {
        let places = self.before.iter().flat_map(|before| &before.campaign.places);
        let there = places.filter_map(|place| self.out.join(place).canonicalize().ok());
        there.filter(|place| files.iter().any(|file| place.join(file).is_file())).collect()
    }

    /// Whether there is anything by which a campaign can be told.
    fn knows_runs(&self) -> bool {
        self.before.as_ref().is_some_and(|before| before.runs.values().any(|run| run.start.is_some()))
    }

    /// Whether a run is one of those of the results.
    fn agrees(&self, id: &str, start: Option<&str>, sensor: Option<&str>) -> Result<bool, Finding> {
        let Some(run) = self.before.as_ref().and_then(|before| before.runs.get(id)) else { return Ok(false) };
        let sensor = sensor.filter(|s| !s.is_empty());
        if !run.contradicts(start, sensor) {
            return Ok(true);
        }
        let told = |start: Option<&str>, sensor: Option<&str>| {
            format!("{} with sensor {}", start.unwrap_or("at an unknown time"), sensor.unwrap_or("not stated"))
        };
        Err(self.refusal(format!(
            "holds results of another campaign: its run {id} began {}, the one given {}",
            told(run.start.as_deref(), run.sensor.as_deref()),
            told(start, sensor)
        )))
    }

    fn refuse_strangers(&self, given: &str) -> Result<(), Finding> {
        match &self.before {
            Some(before) if self.knows_runs() => {
                let name = &before.campaign.name;
                let of = if name.is_empty() { String::new() } else { format!(", {name}") };
                Err(self.refusal(format!("holds results of another campaign{of}: it has no run in common with {given}")))
            }
            _ => Ok(()),
        }
    }

    fn refusal(&self, rule: String) -> Finding {
        let remedy = "choose another folder with -o, or move the older results away";
        Finding::error(&self.out.display().to_string(), rule, remedy)
    }

    fn now(&self) -> Index {
        let seen = self.seen();
        let written = self.ledger.written();
        let mut index = self.before.clone().unwrap_or_default();
        index.written_by = Index::default().written_by;
        self.name(&seen, &mut index);
        let entries: Vec<FileEntry> = {
            let known = Known::of(&index, &written);
            written.iter().map(|(path, file)| known.entry_for(path, file)).collect()
        };
        entries.into_iter().for_each(|entry| index.put(entry));
        self.runs(&seen, &written, &mut index);
        index.judge();
        if seen.all_made {
            index.give_up(|path| written.contains_key(path));
        }
        index.forget_deleted(|path| !is_gone(&self.out.join(path)));
        index
    }

    /// Name, file and places of the campaign.
    fn name(&self, seen: &Seen, index: &mut Index) {
        let names: Vec<&str> = seen.campaigns.iter().map(|c| c.name.as_str()).collect();
        if !names.is_empty() {
            index.campaign.name = names.join(", ");
            // What several campaigns state is not one file.
            index.campaign.sha256 = match seen.campaigns.as_slice() {
                [one] => one.sha256.clone(),
                _ => None,
            };
        }
        let Ok(out) = self.out.canonicalize() else { return };
        let mut places: BTreeSet<String> = index.campaign.places.drain(..).filter(|p| out.join(p).is_dir()).collect();
        places.extend(seen.places.iter().map(|place| relative(&out, place)));
        index.campaign.places = places.into_iter().collect();
    }

    /// What became of the runs.
    fn runs(&self, seen: &Seen, written: &WrittenFiles, index: &mut Index) {
        let whole = || seen.campaigns.iter().filter(|c| c.is_whole);
        for (campaign, path, header) in
            whole().flat_map(|c| c.runs.iter().filter_map(move |(path, header)| Some((c, path, header.as_ref()?))))
        {
            let reason = if campaign.unused.contains(path) {
                "campaign.toml takes it out".to_owned()
            } else {
                format!("nothing was asked for that takes {} runs", header.kind)
            };
            let run = index.runs.entry(header.run.clone()).or_insert_with(|| {
                let mut entry = entry_of(header, path);
                entry.set(Outcome::new(RunState::NotApplicable, reason.clone()));
                entry
            });
            run.path = Some(path.clone());
            if run.state == RunState::Done && seen.all_made && campaign.unused.contains(path) {
                run.set(Outcome::new(RunState::NotApplicable, reason));
            } else if run.state == RunState::Gone {
                let back = if run.sha256.is_some() { Outcome::done() } else { Outcome::new(RunState::NotApplicable, reason) };
                run.set(back);
            }
        }
        for (id, outcome) in &seen.outcomes {
            let known = index.runs.get(id).and_then(|run| run.sha256.clone());
            index.runs.insert(id.clone(), RunEntry { sha256: outcome.sha256.clone().or(known), ..outcome.clone() });
        }
        let inputs = inputs_of(written);
        for run in index.runs.values_mut() {
            let Some((sha256, is_used)) = run.path.as_ref().and_then(|path| inputs.get(path.as_str()).cloned()) else { continue };
            run.sha256 = Some(sha256);
            if is_used && matches!(run.state, RunState::NotApplicable | RunState::Gone) {
                run.set(Outcome::done());
            }
        }
        if whole().next().is_none() {
            return;
        }
        let is_there = |path: &str| {
            let listed = whole().any(|c| c.runs.contains_key(path));
            listed || index.campaign.places.iter().any(|place| self.out.join(place).join(path).is_file())
        };
        let gone: Vec<(String, String)> = index
            .runs
            .iter()
            .filter_map(|(id, run)| Some((id.clone(), run.path.clone()?)))
            .filter(|(_, path)| !is_there(path))
            .collect();
        for (id, path) in gone {
            if let Some(run) = index.runs.get_mut(&id) {
                run.set(Outcome::new(RunState::Gone, format!("its file {path} is not in the campaign any more")));
            }
        }
    }
}

/// The hashes of the inputs of the files that were written, and whether anything beside the list of all runs in the protocol rests on each.
fn inputs_of(written: &WrittenFiles) -> HashMap<&str, (String, bool)> {
    let mut inputs: HashMap<&str, (String, bool)> = HashMap::new();
    let mut seen: Option<&Arc<Origin>> = None;
    for file in written.values() {
        // The files of one result have their origin in common, and most stand one after the other.
        if seen.is_some_and(|seen| Arc::ptr_eq(seen, &file.origin)) {
            continue;
        }
        seen = Some(&file.origin);
        let is_used = !file.origin.lists_all_runs;
        for input in &file.origin.from {
            inputs.entry(&input.path).or_insert_with(|| (input.sha256.clone(), false)).1 |= is_used;
        }
    }
    inputs
}

fn entry_of(header: &Header, path: &str) -> RunEntry {
    RunEntry {
        state: RunState::Done,
        reason: None,
        sha256: None,
        start: Some(header.start.as_str().to_owned()),
        sensor: Some(header.sensor.clone()).filter(|s| !s.is_empty()),
        path: Some(path.to_owned()),
    }
}

fn name(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// The files of a folder, those of before and those that were written, found by path, name or origin.
struct Known<'a> {
    index: &'a Index,
    written: &'a WrittenFiles,
    /// Paths by the names of the files.
    named: HashMap<&'a str, Vec<&'a str>>,
    /// Parameter files by their origin.
    of_origin: HashMap<*const Origin, Vec<&'a str>>,
}

impl<'a> Known<'a> {
    fn of(index: &'a Index, written: &'a WrittenFiles) -> Self {
        let mut named: HashMap<&str, Vec<&str>> = HashMap::new();
        for path in written.keys().map(String::as_str).chain(index.files.iter().map(|f| f.path.as_str())) {
            named.entry(name(path)).or_default().push(path);
        }
        let mut of_origin: HashMap<*const Origin, Vec<&str>> = HashMap::new();
        for (path, file) in written.iter().filter(|(path, _)| is_parameter_file(path)) {
            of_origin.entry(Arc::as_ptr(&file.origin)).or_default().push(path);
        }
        Self { index, written, named, of_origin }
    }

    /// A file as it is now.
    fn now(&self, path: &str) -> Option<Version> {
        let new = self.written.get(path).map(|w| &w.sha256);
        new.or_else(|| self.index.file(path).map(|f| &f.sha256))
            .map(|sha256| Version { path: path.to_owned(), sha256: sha256.clone() })
    }

    /// Files of a name as they are now.
    fn called(&self, name: &str) -> impl Iterator<Item = Version> {
        self.named.get(name).into_iter().flatten().filter_map(|path| self.now(path))
    }

    /// An input of the folder under its path there; one from elsewhere must not be taken for it.
    fn placed(&self, input: &Version) -> Version {
        let own = self.called(name(&input.path)).find(|v| v.sha256 == input.sha256);
        own.unwrap_or_else(|| match self.now(&input.path) {
            Some(_) => Version { path: format!("../{}", input.path), ..input.clone() },
            None => input.clone(),
        })
    }

    /// The entry of a file that was written.
    fn entry_for(&self, path: &str, file: &Written) -> FileEntry {
        let mut from: Vec<Version> = file.origin.from.iter().map(|input| self.placed(input)).collect();
        for used in &file.origin.uses {
            from.extend(self.now(used).or_else(|| self.called(used).next()));
        }
        let has_notes = is_parameter_file(path) || name(path) == DIAGNOSIS_FILE;
        // Figures, tables and reports show what the parameter file of the same result holds.
        if !is_parameter_file(path) {
            let same = self.of_origin.get(&Arc::as_ptr(&file.origin)).into_iter().flatten();
            from.extend(same.filter_map(|path| self.now(path)));
        }
        let mut seen = BTreeSet::new();
        from.retain(|version| version.path != path && seen.insert(version.clone()));
        FileEntry {
            path: path.to_owned(),
            sha256: file.sha256.clone(),
            from,
            command: file.origin.command.clone(),
            stale: false,
            reason: None,
            mark: None,
            warning_kinds: if has_notes { file.origin.kinds.iter().copied().collect() } else { Vec::new() },
            replaces: alone_of(path).as_deref().and_then(|alone| self.now(alone)).into_iter().collect(),
        }
    }
}

fn is_parameter_file(path: &str) -> bool {
    FileKind::of_name(Path::new(path)).is_some()
}

/// The way from a folder to another, both real, with forward slashes.
fn relative(from: &Path, to: &Path) -> String {
    let (from, to): (Vec<Component>, Vec<Component>) = (from.components().collect(), to.components().collect());
    let same = from.iter().zip(&to).take_while(|(a, b)| a == b).count();
    let up = std::iter::repeat_n("..".to_owned(), from.len() - same);
    let down = to[same..].iter().map(|c| c.as_os_str().to_string_lossy().into_owned());
    let way: Vec<String> = up.chain(down).collect();
    if way.is_empty() { ".".to_owned() } else { way.join("/") }
}
