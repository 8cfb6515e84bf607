//! `calfit check`: everything that is wrong with each file. Run files, programmes, tables of amplitudes, campaign files, mappings and parameter files are told
//! apart by their names or by a key of theirs, never by trial.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::{Finding, Severity};
use crate::files::campaign::Campaign;
use crate::files::export::rpcmag;
use crate::files::import::mapping;
use crate::files::parameter::FileKind;
use crate::files::{amplitudes, campaign, ccr, mag, twin};
use crate::model::campaign::Instructions;
use crate::record::temperature_faults::{self, ChannelFault};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders, run files (.CCR, .CCR.gz), programmes (.MAG), tables of amplitudes (.csv), campaign.toml, parameter files and model files of calfit, mappings of `import`, ground calibration files (RPCMAG*.TXT).
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

#[derive(Serialize)]
struct Checked {
    file: String,
    ok: bool,
    findings: Vec<Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let files = files(&arguments.paths)?;
    let bar = terminal.progress(files.len());
    let results: Vec<Checked> = files
        .par_iter()
        .map(|path| {
            let findings = check(path, common);
            bar.inc(1);
            let ok = findings.iter().all(|f| f.severity != Severity::Error);
            Checked { file: path.display().to_string(), ok, findings }
        })
        .collect();
    bar.finish_and_clear();
    let bad = results.iter().filter(|r| !r.ok).count();
    if common.json {
        terminal.print(&json(&results)?);
    } else {
        for result in &results {
            result.findings.iter().for_each(|f| terminal.finding(f));
            terminal.tell(&format!("{}: {}\n", result.file, if result.ok { "ok" } else { "refused" }));
        }
        if results.len() > 1 {
            terminal.tell(&format!("{} of {} files are in order\n", results.len() - bad, results.len()));
        }
    }
    Ok(if bad == 0 { Status::Done } else { Status::Partly })
}

/// The files to check: those named, and of a folder its runs and its `campaign.toml`.
fn files(paths: &[PathBuf]) -> Result<Vec<PathBuf>, Finding> {
    let mut files = Vec::new();
    for path in paths {
        let meta = std::fs::metadata(path).map_err(|e| Finding::io(path, "open", &e))?;
        if !meta.is_dir() {
            files.push(path.clone());
            continue;
        }
        let toml = path.join("campaign.toml");
        if toml.is_file() {
            files.push(toml);
        }
        files.extend(Campaign::run_files(path)?);
    }
    if files.is_empty() {
        let shown: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
        return Err(Finding::error(
            &shown.join(", "),
            "holds nothing to check",
            "name run files, programmes or a campaign folder",
        ));
    }
    files.sort();
    files.dedup();
    Ok(files)
}

fn check(path: &Path, common: &Common) -> Vec<Finding> {
    let shown = path.display().to_string();
    let name = shown.to_ascii_uppercase();
    let mut findings = Vec::new();
    let error = if let Some(kind) = FileKind::of_file(path) {
        kind.check(path).err()
    } else if name.ends_with(".MAG") {
        mag::read(path, &mut findings).err()
    } else if is_ground_calibration(path) {
        rpcmag::read(path, &mut findings).err()
    } else if name.ends_with(".TOML") && is_mapping(path) {
        mapping::read(path, &mut findings).err()
    } else if name.ends_with(".TOML") && is_twin(path) {
        twin::read(path, &mut findings).err()
    } else if name.ends_with(".TOML") {
        let checked = campaign::file::read(path, &mut findings).and_then(|(file, _)| match path.file_name() {
            Some(name) if name == "campaign.toml" => campaign::check_locations(path.parent().unwrap_or(path), &file),
            _ => Ok(()),
        });
        checked.err()
    } else if name.ends_with(".CSV") && is_of_amplitudes(path) {
        amplitudes::read(path, &mut findings).err()
    } else {
        let options = ccr::Options { collect: true, ..common.desk().reading(&shown, false) };
        match ccr::read(path, &options, &mut ()) {
            Ok(run) => {
                let fault = |f: ChannelFault| {
                    Finding::error(&shown, f.text(), "do not use the channel where it is wrong").weighing(Severity::Warning)
                };
                findings.extend(temperature_faults::faults(&run, &Instructions::default()).into_iter().map(fault));
                findings.extend(run.findings);
            }
            Err(errors) => findings.extend(errors),
        }
        None
    };
    findings.extend(error);
    findings
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
        let text = std::fs::read(path).unwrap_or_default();
        let lines = text.split(|b| *b == b'\n').take(100);
        lines.map(<[u8]>::trim_ascii).find(|l| !l.is_empty() && !l.starts_with(b"#")).map(<[u8]>::to_vec).unwrap_or_default()
    };
    name.starts_with("freq_") || memchr::memmem::find(&header(), b"frequency_hz").is_some()
}

/// By its keys: no other TOML file has those of a mapping of `import`.
fn is_mapping(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| mapping::is_mapping(&text))
}

/// By its keys: twins and campaigns are both TOML of any name, and only twins have electronics.
fn is_twin(path: &Path) -> bool {
    std::fs::read_to_string(path).is_ok_and(|text| text.lines().any(|line| line.trim() == "[electronics]"))
}
