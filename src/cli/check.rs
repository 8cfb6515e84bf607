//! `calfit check`: everything that is wrong with each file. Run files, programmes, tables of amplitudes, campaign files, facility files, mappings,
//! parameter files and the index of a result folder are told apart by their names or by a key of theirs, never by trial.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::{Finding, Severity};
use crate::data::index::INDEX_FILE;
use crate::data::note::Note;
use crate::data::run::{Gap, Kind, Vector, VectorAccount, VectorSink};
use crate::data::sketch::Sketch;
use crate::data::units::counted;
use crate::files::campaign::Campaign;
use crate::files::export::rpcmag;
use crate::files::import::mapping;
use crate::files::output::is_own;
use crate::files::parameter::FileKind;
use crate::files::source::{digest, read_whole, small_text};
#[cfg(feature = "tables")]
use crate::files::table::columns;
use crate::files::text::Keys;
use crate::files::{amplitudes, campaign, ccr, facility, index, mag, twin};
use crate::measure::recordings::{self, Copied, Overlap, Recording};
use crate::model::campaign::Instructions;
use crate::record::temperature_faults::{self, ChannelFault};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;
use std::hash::{DefaultHasher, Hasher};
use std::path::{Path, PathBuf};

/// Name of the configuration of flight processing in a folder.
pub(super) const FLIGHT_FILE: &str = "flight.toml";

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders, result folders, run files (.CCR, .CCR.gz), programmes (.MAG), tables of amplitudes (.csv), tables of calfit (.parquet), campaign.toml, twins, facility files, parameter files and model files of calfit, mappings of `import`, configurations of `flight`, daily offset models, ground calibration files (RPCMAG*.TXT), JSON that calfit wrote.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

#[derive(Serialize)]
struct Checked {
    file: String,
    ok: bool,
    findings: Vec<Finding>,
    /// Files that an index says to be stale.
    #[serde(skip)]
    stale: usize,
    /// What a run file holds.
    #[serde(skip)]
    run: Option<CheckedRun>,
}

/// What is compared of run files.
struct CheckedRun {
    /// What distinguishes its readings; `None` of too few.
    readings: Option<u64>,
    recording: Recording,
    /// Folder of its campaign.
    root: PathBuf,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let files = files(&arguments.paths)?;
    let bar = terminal.progress(files.len(), "checked");
    let mut results: Vec<Checked> = files
        .par_iter()
        .map(|path| {
            let mut run = None;
            let (findings, stale) = bar.of(&path.display().to_string(), || check(path, common, &mut run));
            let ok = findings.iter().all(|f| f.severity != Severity::Error);
            Checked { file: path.display().to_string(), ok, findings, stale, run }
        })
        .collect();
    bar.finish();
    tell_copies(&mut results);
    tell_recordings(&mut results);
    let bad = results.iter().filter(|r| !r.ok).count();
    if common.json {
        terminal.print(&json(&results)?);
    } else {
        for result in &results {
            result.findings.iter().for_each(|f| terminal.finding(f));
            let warnings = result.findings.iter().filter(|f| f.severity == Severity::Warning).count();
            let verdict = match (result.ok, warnings) {
                (false, _) => "refused".to_owned(),
                (true, 0) => "ok".to_owned(),
                (true, 1) => "ok, 1 warning".to_owned(),
                (true, n) => format!("ok, {n} warnings"),
            };
            terminal.tell(&format!("{}: {verdict}\n", result.file));
        }
        let stale: usize = results.iter().map(|r| r.stale).sum();
        if results.len() > 1 || stale > 0 {
            let of_index = match stale {
                0 => String::new(),
                1 => "; 1 file of the result folder is stale and was made from what has changed since".to_owned(),
                n => format!("; {n} files of the result folder are stale and were made from what has changed since"),
            };
            terminal.tell(&format!("{} of {} files are without errors{of_index}\n", results.len() - bad, results.len()));
        }
    }
    Ok(if bad == 0 { Status::Done } else { Status::Partly })
}

/// Says of run files whose readings are those of an earlier one that they are copies of it.
fn tell_copies(results: &mut [Checked]) {
    for later in 1..results.len() {
        let (before, own) = results.split_at_mut(later);
        let mark = |one: &Checked| one.run.as_ref().and_then(|run| run.readings);
        let is_same = |other: &&Checked| mark(other).is_some() && mark(other) == mark(&own[0]);
        if let Some(first) = before.iter().find(is_same) {
            let rule = format!("holds the same readings as {}, one after the other: it is a copy under another name", first.file);
            let remedy = "take one of the two away, it would count twice";
            own[0].findings.push(Finding::error(&own[0].file, rule, remedy).weighing(Severity::Warning));
        }
    }
}

/// Says of the run files of every campaign which are copies of a part of another one, and which overlap with one in time.
fn tell_recordings(results: &mut [Checked]) {
    let mut roots: Vec<PathBuf> = results.iter().filter_map(|one| Some(one.run.as_ref()?.root.clone())).collect();
    roots.sort_unstable();
    roots.dedup();
    let mut told: Vec<(usize, String, &str)> = Vec::new();
    for root in roots {
        let own = results.iter().enumerate().filter_map(|(place, one)| {
            let run = one.run.as_ref().filter(|run| run.root == root)?;
            Some((place, run.readings, run.recording.clone()))
        });
        let own: Vec<(usize, Option<u64>, Recording)> = own.collect();
        let all: Vec<Recording> = own.iter().map(|(_, _, recording)| recording.clone()).collect();
        let copies = recordings::copies(&all);
        let file = |index: usize| results[own[index].0].file.as_str();
        for copied in &copies {
            // Those that are copies from the first to the last reading are told already.
            let marks = [copied.copy, copied.of].map(|index| own[index].1);
            if marks[0].is_none() || marks[0] != marks[1] {
                told.push((own[copied.copy].0, copied.text(file(copied.of)), Copied::REMEDY));
            }
        }
        for overlap in recordings::overlaps(&all, &copies) {
            told.push((own[overlap.second].0, overlap.text(file(overlap.first)), Overlap::REMEDY));
        }
    }
    for (place, rule, remedy) in told {
        let one = &mut results[place];
        one.findings.push(Finding::error(&one.file, rule, remedy).weighing(Severity::Warning));
    }
}

/// Mixes the readings of a run as they pass, so that two runs with the same ones show. Times and settings do not count: they may have been changed.
#[derive(Default)]
struct Readings {
    mixed: DefaultHasher,
    count: u64,
}

impl Readings {
    fn take(&mut self, reading: &[f64]) {
        self.count += 1;
        reading.iter().for_each(|value| self.mixed.write_u64(value.to_bits()));
    }

    /// What distinguishes them; `None` of too few, which may be the same by chance.
    fn mark(&self) -> Option<u64> {
        const LEAST: u64 = 8;
        (self.count >= LEAST).then(|| self.mixed.finish())
    }
}

impl VectorSink for Readings {
    fn vector(&mut self, vector: Vector) {
        self.take(&vector.reading.0);
    }
}

/// The files to check: those named, of a campaign folder its runs and its `campaign.toml`, of a folder of telemetry its `flight.toml`, of a
/// result folder its index and its parameter files.
fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Finding> {
    let mut files = Vec::new();
    for path in paths {
        let meta = std::fs::metadata(path).map_err(|e| Finding::io(path, "open", &e))?;
        if !meta.is_dir() {
            files.push(path.clone());
            continue;
        }
        let named = ["campaign.toml", FLIGHT_FILE].map(|name| path.join(name));
        files.extend(named.into_iter().filter(|file| file.is_file()));
        files.extend(Campaign::run_files(path)?);
        if path.join(INDEX_FILE).is_file() {
            files.push(path.join(INDEX_FILE));
        }
        let own = index::own_files(path)?.into_iter().map(|name| path.join(name));
        files.extend(own.filter(|file| FileKind::of_name(file).is_some()));
    }
    if files.is_empty() {
        let shown: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        return Err(Finding::error(
            &shown.join(", "),
            "holds nothing to check",
            "name run files, programmes, a campaign folder, a result folder, or a folder with a flight.toml",
        ));
    }
    files.sort();
    files.dedup();
    Ok(files)
}

/// What is wrong with a file, and how many files it says to be stale; `read` is what a run file holds.
fn check(path: &Path, common: &Common, read: &mut Option<CheckedRun>) -> (Vec<Finding>, usize) {
    let mut stale = 0;
    let shown = path.display().to_string();
    let name = shown.to_ascii_uppercase();
    let mut findings = Vec::new();
    let error = if path.file_name().is_some_and(|name| name == INDEX_FILE) {
        check_index(path, &mut findings).map(|of_index| stale = of_index).err()
    } else if let Some(kind) = FileKind::of_file(path) {
        kind.check(path).err()
    } else if name.ends_with(".MAG") {
        mag::read(path, &mut findings).err()
    } else if is_ground_calibration(path) {
        rpcmag::read(path, &mut findings).err()
    } else if name.ends_with(".TOML") {
        check_toml(path, &mut findings).err()
    } else if name.ends_with(".JSON") {
        check_json(path).err()
    } else if name.ends_with(".PARQUET") && is_own(path).unwrap_or(false) {
        check_table(path).err()
    } else if name.ends_with(".CSV") && is_of_amplitudes(path) {
        amplitudes::read(path, &mut findings).err()
    } else {
        let options = ccr::Options { collect: true, ..common.desk().reading(&shown, false) };
        let mut sinks = (Readings::default(), Sketch::default());
        match ccr::read(path, &options, &mut sinks) {
            Ok(mut run) => {
                let (mut own, sketch) = sinks;
                run.vectors.sketch = sketch;
                run.blocks.iter().for_each(|block| own.take(&block.mean.0));
                run.scalar.iter().for_each(|row| own.take(&[row.modulus_nt]));
                let fault = |f: ChannelFault| {
                    Finding::error(&shown, f.text(), "do not use the channel where it is wrong").weighing(Severity::Warning)
                };
                // The channels of coils and rack are those that the campaign of the run names.
                let campaigns = Campaign::open(&[path.to_owned()], &mut Vec::new()).unwrap_or_default();
                let instructions = campaigns.first().map_or_else(Instructions::default, |c| c.file.instructions.clone());
                let root = campaigns.first().map(|campaign| campaign.root.clone()).unwrap_or_default();
                *read = Some(CheckedRun { readings: own.mark(), recording: Recording::of(&run), root });
                findings.extend(temperature_faults::faults(&run, &instructions).into_iter().map(fault));
                findings.extend(gaps(&shown, &run.vectors));
                let needs_settings = matches!(run.header.kind, Kind::Linearity | Kind::Offset | Kind::Frequency | Kind::Sweep);
                if needs_settings && run.settings.is_empty() && run.blocks.is_empty() {
                    let rule = format!("has no setting, without which a run of the kind {} gives nothing", run.header.kind);
                    let remedy = "add @FIELDS with the settings, or @BLOCKS with means";
                    findings.push(Finding::error(&shown, rule, remedy).weighing(Severity::Warning));
                }
                findings.extend(run.findings);
            }
            Err(errors) => findings.extend(errors),
        }
        None
    };
    findings.extend(error);
    (findings, stale)
}

/// Gaps of a run that are told one by one.
const MOST_GAPS: usize = 5;

/// Samples that the counter says to be missing, each gap at the first row behind it.
fn gaps(file: &str, vectors: &VectorAccount) -> Vec<Finding> {
    let warning = |rule: String| {
        let remedy = "see whether the recording lost them; what is computed goes by the counter and leaves them out";
        Finding::error(file, rule, remedy).weighing(Severity::Warning)
    };
    let are = |samples: u64| if samples == 1 { "is" } else { "are" };
    let one = |gap: &Gap| {
        let (samples, t_s) = (gap.lost, gap.t_s);
        warning(format!("{} {} missing before this row, at {t_s} s", counted(samples, "sample"), are(samples))).at(gap.line, 1)
    };
    let told = &vectors.gaps[..vectors.gaps.len().min(MOST_GAPS)];
    let mut list: Vec<Finding> = told.iter().map(one).collect();
    let more = vectors.gap_count - told.len() as u64;
    if more > 0 {
        let samples = vectors.lost - told.iter().map(|gap| gap.lost).sum::<u64>();
        list.push(warning(format!(
            "{} {} missing in {} behind these",
            counted(samples, "sample"),
            are(samples),
            counted(more, "gap")
        )));
    }
    list
}

/// Configurations of `flight`, mappings, twins and facility files are TOML of any name, told apart by keys that only they have; a campaign
/// file is told by its name.
fn check_toml(path: &Path, findings: &mut Vec<Finding>) -> Result<(), Finding> {
    let text = small_text(path).unwrap_or_default();
    let is_campaign = path.file_name().is_some_and(|name| name == "campaign.toml");
    if !is_campaign && is_telemetry(path)? {
        check_telemetry(path, findings)
    } else if is_flight(path) {
        findings.extend(check_flight(path));
        Ok(())
    } else if !is_campaign && is_daily(path) {
        check_daily(path)
    } else if mapping::is_mapping(&text) {
        mapping::read(path, findings).map(drop)
    } else if is_twin(&text) {
        twin::read(path, findings).map(drop)
    } else if facility::is_facility(&text) {
        let shown = path.display().to_string();
        let told = |note: &Note| {
            let remedy = note.remedy.as_deref().unwrap_or("look at it before the file is used");
            Finding::error(&shown, note.text.as_str(), remedy).weighing(Severity::Warning)
        };
        let facility = facility::read(path, findings)?;
        findings.extend(facility.notes.iter().map(told));
        Ok(())
    } else if !is_campaign {
        let shown = path.display().to_string();
        let keys = Keys::parse(&shown, 1, text)?;
        let rule = match keys.root().text("format")? {
            Some(format) => format!("states the format `{format}`, which is none that calfit knows"),
            None => "is no TOML file that calfit knows: it is not named campaign.toml, has no `format`, and no keys of a twin, a facility, a mapping or a configuration of flight".to_owned(),
        };
        Err(Finding::error(&shown, rule, "check its name, or the spelling of its keys"))
    } else {
        let (file, _) = campaign::file::read(path, findings)?;
        let root = path.parent().unwrap_or(path);
        campaign::check_files(root, &file).and_then(|()| campaign::check_locations(root, &file))
    }
}

/// JSON of calfit is told by its key `format`, that of an export by the format of the parameter file that it is of; the record of a day
/// of flight processing has none.
fn check_json(path: &Path) -> Result<(), Finding> {
    const REMEDY: &str = "check its name, or take the file of calfit again";
    let shown = path.display().to_string();
    let (bytes, _) = read_whole(path)?;
    let value: Value = serde_json::from_slice(&bytes).map_err(|e| {
        let rule = format!("is no JSON: {e}");
        Finding::error(&shown, rule, REMEDY).at(e.line() as u64, e.column() as u64)
    })?;
    let needed: &[&str] = match value.get("format").map(Value::as_str) {
        Some(Some("diagnosis")) => &["written_by", "version", "runs", "steps", "verdict"],
        Some(Some("APPLIED")) => &["written_by", "sensor", "mode", "frame", "columns", "counts"],
        Some(Some(format)) if FileKind::of_format(format).is_some() => &["written_by", "version"],
        None if is_day_of_flight(&value) => return check_day_of_flight(path),
        Some(Some(format)) => {
            let rule = format!("states the format `{format}`, which is none of the JSON that calfit knows");
            return Err(Finding::error(&shown, rule, REMEDY));
        }
        _ => return Err(Finding::error(&shown, "is JSON of no kind that calfit knows: it has no `format`", REMEDY)),
    };
    match needed.iter().find(|key| value.get(**key).is_none()) {
        Some(key) => Err(Finding::error(&shown, format!("the key `{key}` is missing"), REMEDY)),
        None => Ok(()),
    }
}

/// The record of a day of flight processing, by keys that only it has.
fn is_day_of_flight(value: &Value) -> bool {
    ["notes_of_mission", "sensor", "day"].iter().all(|key| value.get(*key).is_some())
}

#[cfg(feature = "tables")]
fn check_day_of_flight(path: &Path) -> Result<(), Finding> {
    crate::workflow::flight::check_day(path)
}

#[cfg(not(feature = "tables"))]
fn check_day_of_flight(_path: &Path) -> Result<(), Finding> {
    Ok(())
}

#[cfg(feature = "tables")]
fn is_telemetry(path: &Path) -> Result<bool, Finding> {
    twin::telemetry::is_telemetry(path)
}

#[cfg(feature = "tables")]
fn check_telemetry(path: &Path, findings: &mut Vec<Finding>) -> Result<(), Finding> {
    twin::telemetry::read(path, findings).map(drop)
}

#[cfg(not(feature = "tables"))]
fn is_telemetry(_path: &Path) -> Result<bool, Finding> {
    Ok(false)
}

#[cfg(not(feature = "tables"))]
fn check_telemetry(_path: &Path, _findings: &mut Vec<Finding>) -> Result<(), Finding> {
    Ok(())
}

#[cfg(feature = "tables")]
fn is_daily(path: &Path) -> bool {
    crate::files::flight::daily::is_daily(path)
}

#[cfg(feature = "tables")]
fn check_daily(path: &Path) -> Result<(), Finding> {
    crate::files::flight::daily::check(path)
}

#[cfg(not(feature = "tables"))]
fn is_daily(_path: &Path) -> bool {
    false
}

#[cfg(not(feature = "tables"))]
fn check_daily(_path: &Path) -> Result<(), Finding> {
    Ok(())
}

#[cfg(feature = "tables")]
fn is_flight(path: &Path) -> bool {
    crate::files::flight::is_mission(path)
}

/// Tables that calfit wrote: levels and what a day needs of those before it, tables of all runs, calibrated readings.
#[cfg(feature = "tables")]
fn check_table(path: &Path) -> Result<(), Finding> {
    columns::check_parquet(path)
}

#[cfg(not(feature = "tables"))]
fn check_table(_path: &Path) -> Result<(), Finding> {
    Ok(())
}

#[cfg(feature = "tables")]
fn check_flight(path: &Path) -> Vec<Finding> {
    crate::workflow::flight::check(path)
}

#[cfg(not(feature = "tables"))]
fn is_flight(_path: &Path) -> bool {
    false
}

#[cfg(not(feature = "tables"))]
fn check_flight(_path: &Path) -> Vec<Finding> {
    Vec::new()
}

/// The index of a result folder: every file that it names must be there as it was written, and nothing of calfit beside them. The number of
/// files that it says to be stale.
fn check_index(path: &Path, findings: &mut Vec<Finding>) -> Result<usize, Finding> {
    let folder = path.parent().unwrap_or(Path::new("."));
    let Some(index) = index::read(folder)? else { return Ok(0) };
    let renew = "`calfit report` of the campaign renews it";
    let mut say = |file: &str, severity: Severity, rule: String, remedy: &str| {
        let shown = folder.join(file).display().to_string();
        findings.push(Finding::error(&shown, rule, remedy).weighing(severity));
    };
    for entry in &index.files {
        let file = folder.join(&entry.path);
        if !file.is_file() {
            say(&entry.path, Severity::Error, "is missing: the index of the folder names it".to_owned(), renew);
        } else if digest(&file)?.sha256 != entry.sha256 {
            let rule = "was changed after it was written: it has another SHA-256 than the index of its folder states";
            say(&entry.path, Severity::Error, rule.to_owned(), renew);
        }
        if entry.stale {
            let rule = format!("is stale: {}", entry.reason.as_deref().unwrap_or("what it was made from has changed"));
            say(&entry.path, Severity::Warning, rule, index.remedy(entry));
        }
        if let Some(state) = entry.mark {
            let rule = match &entry.reason {
                Some(reason) => format!("cannot be made again: {reason}"),
                None => format!("is of a run that is {state}"),
            };
            say(&entry.path, Severity::Warning, rule, "leave it out, or take it away");
        }
    }
    for name in index::own_files(folder)?.iter().filter(|name| index.file(name).is_none()) {
        let rule = "is a file of calfit that the index of the folder does not name";
        say(name, Severity::Warning, rule.to_owned(), "take it away, or run its command into this folder again");
    }
    Ok(index.files.iter().filter(|entry| entry.stale).count())
}

/// A ground calibration file of `calfit export`, by its name.
fn is_ground_calibration(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_uppercase()).unwrap_or_default();
    name.starts_with("RPCMAG") && name.ends_with(".TXT")
}

/// By its name, or by its first column: tables of amplitudes are CSV as other tables are.
fn is_of_amplitudes(path: &Path) -> bool {
    let name = path.file_name().map(|n| n.to_string_lossy().to_ascii_lowercase()).unwrap_or_default();
    let header = || {
        let text = small_text(path).unwrap_or_default().into_bytes();
        let lines = text.split(|b| *b == b'\n').take(100);
        lines.map(<[u8]>::trim_ascii).find(|l| !l.is_empty() && !l.starts_with(b"#")).map(<[u8]>::to_vec).unwrap_or_default()
    };
    name.starts_with("freq_") || memchr::memmem::find(&header(), b"frequency_hz").is_some()
}

/// Only twins have electronics.
fn is_twin(text: &str) -> bool {
    text.lines().any(|line| line.trim() == "[electronics]")
}
