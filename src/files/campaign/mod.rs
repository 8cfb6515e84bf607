//! A folder to runs, positions, channels and limits.

pub mod file;
pub mod stated;

use crate::data::error::Finding;
use crate::data::exclusion::Exclusion;
use crate::data::provenance::{Input, Role};
use crate::data::run::Header;
use crate::files::ccr;
use file::{CampaignFile, ThermistorEntry, read};
use std::collections::{BTreeMap, BTreeSet};
use std::io::ErrorKind;
use std::path::{Component, Path, PathBuf};

/// A run file of a campaign.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RunFile {
    /// Path inside the campaign, with forward slashes; this is what is recorded.
    pub recorded: String,
    /// Path to open.
    pub path: PathBuf,
    /// The user named this file, so it takes precedence over the one of the campaign.
    pub named: bool,
}

impl RunFile {
    /// The run id that a recorded path tells; it is that of the file's head, where that can be read.
    #[must_use]
    pub fn id(recorded: &str) -> String {
        let place = recorded.replace('/', "_");
        place.split('.').next().unwrap_or_default().to_owned()
    }
}

/// A campaign: one folder, or single run files of it.
#[derive(Clone, Debug, Default)]
pub struct Campaign {
    /// The folder.
    pub root: PathBuf,
    /// What `campaign.toml` says.
    pub file: CampaignFile,
    /// `campaign.toml` as an input, if there is one.
    pub input: Option<Input>,
    /// Run files in the order of their recorded paths.
    pub runs: Vec<RunFile>,
    /// What is left out by hand beside what `campaign.toml` says.
    pub exclude: Vec<Exclusion>,
}

impl Campaign {
    /// The campaigns that a list of folders and run files belongs to; warnings go to `findings`.
    ///
    /// # Errors
    /// A path that does not exist, a folder without runs, or a damaged `campaign.toml`.
    pub fn open(paths: &[PathBuf], findings: &mut Vec<Finding>) -> Result<Vec<Campaign>, Finding> {
        let mut by_root: BTreeMap<PathBuf, Vec<(PathBuf, bool)>> = BTreeMap::new();
        for path in paths {
            // The place of a run decides on its campaign, so names such as `.` are followed to the real folder.
            let real = path.canonicalize().map_err(|e| Finding::io(path, "open", &e))?;
            if real.is_dir() {
                let files = Self::run_files(&real)?;
                if files.is_empty() {
                    let shown = path.display().to_string();
                    return Err(Finding::error(&shown, "the folder holds no run files", "a campaign has YY-MM-DD/hh-mm-ss.CCR"));
                }
                by_root.entry(root_of(&real)?).or_default().extend(files.into_iter().map(|f| (f, false)));
            } else {
                by_root.entry(root_of(&parent(&real))?).or_default().push((real, true));
            }
        }
        by_root.into_iter().map(|(root, files)| Self::of(root, files, findings)).collect()
    }

    /// The same, with more that is left out by hand than the campaigns say.
    ///
    /// # Errors
    /// See [`Campaign::open`].
    pub fn open_without(paths: &[PathBuf], exclude: &[Exclusion], findings: &mut Vec<Finding>) -> Result<Vec<Campaign>, Finding> {
        let mut campaigns = Self::open(paths, findings)?;
        campaigns.iter_mut().for_each(|campaign| campaign.exclude = exclude.to_vec());
        Ok(campaigns)
    }

    /// A campaign without a folder, for runs that are made and not read.
    #[must_use]
    pub fn in_memory(file: CampaignFile) -> Campaign {
        Campaign { file, ..Campaign::default() }
    }

    /// The run files of a folder and of the folders in it.
    ///
    /// # Errors
    /// An error of the operating system.
    pub fn run_files(folder: &Path) -> Result<Vec<PathBuf>, Finding> {
        let mut files = Vec::new();
        collect(folder, 0, &mut files)?;
        Ok(files)
    }

    fn of(root: PathBuf, files: Vec<(PathBuf, bool)>, findings: &mut Vec<Finding>) -> Result<Campaign, Finding> {
        let toml = root.join("campaign.toml");
        let (file, input) = if has_campaign_file(&root)? {
            let (file, digested) = read(&toml, findings)?;
            // Who names single runs may have no others.
            if files.iter().any(|(_, named)| !named) {
                check_locations(&root, &file)?;
            }
            let input = digested.input("campaign.toml".to_owned()).with_role(Role::Campaign);
            (file, Some(input))
        } else {
            (CampaignFile::default(), None)
        };
        let mut runs: Vec<RunFile> =
            files.into_iter().map(|(path, named)| RunFile { recorded: recorded(&root, &path), path, named }).collect();
        runs.sort();
        runs.dedup_by(|later, kept| {
            let same = later.path == kept.path;
            kept.named |= same && later.named;
            same
        });
        Ok(Campaign { root, file, input, runs, exclude: Vec::new() })
    }

    /// What stands in `campaign.toml` and goes with none of the campaign's runs, most likely because of a slip in a name. A run whose head
    /// cannot be read, and of which only the id is known, may be of any sensor and mode.
    #[must_use]
    pub fn unmatched(&self, headers: &[&Header], unread: &[String]) -> Vec<String> {
        let sensor = |name: &str| !unread.is_empty() || headers.iter().any(|h| h.sensor == name);
        let mode = |name: &str| !unread.is_empty() || headers.iter().any(|h| h.mode == name);
        let mut list = Vec::new();
        for entry in self.file.instructions.sensors.iter().filter(|s| !sensor(&s.name)) {
            list.push(format!("[[sensor]] name = \"{}\"", entry.name));
        }
        for name in self.file.instructions.references.keys().filter(|name| !sensor(name)) {
            list.push(format!("[[reference]] sensor = \"{name}\""));
        }
        for entry in &self.file.instructions.limits {
            list.extend(entry.sensor.iter().filter(|s| !sensor(s)).map(|s| format!("[[limit]] sensor = \"{s}\"")));
            list.extend(entry.mode.iter().filter(|m| !mode(m)).map(|m| format!("[[limit]] mode = \"{m}\"")));
        }
        let known = |run: &String| unread.contains(run) || headers.iter().any(|h| h.run == *run);
        for (kind, runs) in &self.file.runs {
            let name = CampaignFile::ANALYSES.iter().find(|(_, k)| k == kind).map_or("?", |(name, _)| name);
            list.extend(runs.iter().filter(|r| !known(r)).map(|run| format!("[{name}] runs \"{run}\"")));
        }
        list.extend(self.file.exclude.iter().filter(|e| !known(&e.run)).map(|e| format!("[[exclude]] run = \"{}\"", e.run)));
        for entry in &self.file.instructions.thermal {
            list.extend(entry.sensor.iter().filter(|s| !sensor(s)).map(|s| format!("[[thermal]] sensor = \"{s}\"")));
            list.extend(entry.mode.iter().filter(|m| !mode(m)).map(|m| format!("[[thermal]] mode = \"{m}\"")));
            list.extend(entry.runs.iter().flatten().filter(|r| !known(r)).map(|run| format!("[[thermal]] runs \"{run}\"")));
        }
        list
    }

    /// What is left out of a run by hand.
    pub fn exclusions<'a>(&'a self, run: &'a str) -> impl Iterator<Item = &'a Exclusion> {
        self.file.exclude.iter().chain(&self.exclude).filter(move |e| e.run == run)
    }

    /// Whether the analysis of its kind uses a run.
    #[must_use]
    pub fn uses(&self, header: &Header) -> bool {
        let listed = self.file.runs.iter().find(|(kind, _)| *kind == header.kind);
        listed.is_none_or(|(_, runs)| runs.contains(&header.run))
    }
}

/// Refuses a run of `[[at]]` that the folder of a campaign does not have: a slip in its name would put the sensor to the centre.
///
/// # Errors
/// The first such run, or an error of the operating system.
pub fn check_locations(root: &Path, file: &CampaignFile) -> Result<(), Finding> {
    let at = &file.instructions.at;
    if at.is_empty() {
        return Ok(());
    }
    let mut known = BTreeSet::new();
    for path in Campaign::run_files(root)? {
        // The place tells the id of a run whose head cannot be read, which is not the fault of the list.
        known.insert(RunFile::id(&recorded(root, &path)));
        known.extend(ccr::peek(&path).ok().map(|header| header.run));
    }
    // A file that is looked at by itself has no runs beside it.
    match at.keys().find(|run| !known.is_empty() && !known.contains(*run)) {
        Some(run) => Err(Finding::error(
            &root.join("campaign.toml").display().to_string(),
            format!("`at.runs` name the run {run}, which is none of the campaign"),
            "correct its id, or take it out; `calfit inspect` lists the runs",
        )
        .found(run.as_bytes())),
        None => Ok(()),
    }
}

/// The path of a file that `campaign.toml` names, from the folder of the campaign. A campaign that comes from elsewhere must not have files
/// read that lie beside it, unless that is stated.
///
/// # Errors
/// A name, or a link, that leads out of the campaign.
pub fn named_file(root: &Path, name: &str, may_be_outside: bool) -> Result<PathBuf, Finding> {
    let path = root.join(name);
    let is_below = |path: &Path| path.components().all(|part| matches!(part, Component::Normal(_) | Component::CurDir));
    let leads_out = match (path.canonicalize(), root.canonicalize()) {
        (Ok(path), Ok(root)) => !path.starts_with(root),
        _ => false,
    };
    if may_be_outside || (is_below(Path::new(name)) && !leads_out) {
        return Ok(path);
    }
    Err(Finding::error(
        &root.join("campaign.toml").display().to_string(),
        "names a file outside the campaign",
        "copy it into the campaign; a `[[thermistor]]` may state `outside = true`",
    )
    .found(name.as_bytes()))
}

/// Refuses files that lead out of the folder of the campaign.
///
/// # Errors
/// The first of them.
pub fn check_files(root: &Path, file: &CampaignFile) -> Result<(), Finding> {
    let of = |entry: &'_ ThermistorEntry| {
        let names = std::iter::once(&entry.table).chain(&entry.reference);
        names.map(|name| named_file(root, name, entry.is_outside)).find_map(Result::err)
    };
    file.stated.photos.iter().try_for_each(|photo| named_file(root, &photo.file, false).map(drop))?;
    file.thermistors.iter().find_map(of).map_or(Ok(()), Err)
}

/// The campaign that a folder of run files belongs to: it or the folder above it with a `campaign.toml`, else the folder above the
/// folder of a day.
fn root_of(folder: &Path) -> Result<PathBuf, Finding> {
    let above = parent(folder);
    if has_campaign_file(folder)? {
        Ok(folder.to_owned())
    } else if has_campaign_file(&above)? || is_day(folder) {
        Ok(above)
    } else {
        Ok(folder.to_owned())
    }
}

/// Whether a folder has a `campaign.toml`. One that is there and cannot be read is not taken for none: what it says would be left out.
fn has_campaign_file(folder: &Path) -> Result<bool, Finding> {
    let path = folder.join("campaign.toml");
    match path.symlink_metadata() {
        Ok(_) => Ok(true),
        Err(e) if matches!(e.kind(), ErrorKind::NotFound | ErrorKind::NotADirectory) => Ok(false),
        Err(e) => Err(Finding::io(&path, "open", &e)),
    }
}

fn parent(path: &Path) -> PathBuf {
    path.parent().unwrap_or(path).to_owned()
}

/// Whether a folder is named after a day, YY-MM-DD.
fn is_day(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    name.len() == 8 && name.bytes().enumerate().all(|(i, b)| if i == 2 || i == 5 { b == b'-' } else { b.is_ascii_digit() })
}

/// The path of a run file inside its campaign, which is the same wherever the campaign lies.
fn recorded(root: &Path, path: &Path) -> String {
    let relative = path.strip_prefix(root).unwrap_or(path);
    relative.components().map(|c| c.as_os_str().to_string_lossy().into_owned()).collect::<Vec<_>>().join("/")
}

/// Run files of a folder and of the folders in it.
fn collect(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), Finding> {
    let listing = std::fs::read_dir(folder).map_err(|e| Finding::io(folder, "list the folder", &e))?;
    for entry in listing {
        let path = entry.map_err(|e| Finding::io(folder, "list the folder", &e))?.path();
        let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_uppercase()).unwrap_or_default();
        let is_folder = match path.metadata() {
            Ok(about) => about.is_dir(),
            // A link that leads nowhere is told where it is read as a run.
            Err(e) if e.kind() == ErrorKind::NotFound => false,
            Err(e) => return Err(Finding::io(&path, "open", &e)),
        };
        if is_folder {
            if depth == 0 {
                collect(&path, depth + 1, files)?;
            }
        } else if name.ends_with(".CCR") || name.ends_with(".CCR.GZ") {
            files.push(path);
        }
    }
    Ok(())
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn what_is_there_and_cannot_be_read_is_not_taken_for_absent() {
        for (name, target) in [("campaign.toml", "nowhere"), ("campaign.toml", "campaign.toml"), ("26-01-15", "26-01-15")] {
            let root = tempfile::tempdir().unwrap();
            let day = root.path().join("26-01-16");
            fs::create_dir(&day).unwrap();
            fs::write(day.join("09-00-00.CCR"), "").unwrap();
            symlink(target, root.path().join(name)).unwrap();
            let finding = Campaign::open(&[root.path().to_owned()], &mut Vec::new()).unwrap_err();
            assert!(finding.to_string().contains(name), "{name} -> {target}: {finding}");
        }
    }
}
