//! `calfit inspect`: the run list of a campaign.

use super::output::{Terminal, json};
use super::{Common, Status, open, report_failures, status};
use crate::data::error::Finding;
use crate::files::ccr;
use crate::files::parameter::FileKind;
use crate::show::markdown::aligned_table;
use crate::show::runs::{RunLine, run_list};
use crate::workflow::{Failure, jobs};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders or run files, or a configuration of flight processing or its folder.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

#[derive(Serialize)]
struct Listing<'a> {
    runs: &'a [RunLine],
    failed: Vec<&'a Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if let Some((path, kind)) = arguments.paths.iter().find_map(|path| Some((path, FileKind::of_file(path)?))) {
        let rule = format!("is a {} parameter file and no run", kind.format);
        return Err(Finding::error(&path.display().to_string(), rule, "look at it with `calfit check` or `calfit verify`"));
    }
    #[cfg(feature = "tables")]
    if let Some(file) = arguments.paths.iter().find_map(|path| super::flight::configuration(path)) {
        if arguments.paths.len() > 1 {
            let rule = "is a configuration of flight processing, and other paths are named beside it";
            return Err(Finding::error(&file.display().to_string(), rule, "look at it alone"));
        }
        return super::flight::inspect(&file, common, terminal);
    }
    if let Some(path) = arguments.paths.iter().find(|path| is_of_other_kind(path)) {
        let rule = "is no run, and no configuration of flight processing";
        return Err(Finding::error(&path.display().to_string(), rule, "look at it with `calfit check`"));
    }
    let campaigns = open(&arguments.paths, common, terminal)?;
    let (jobs, unmatched) = jobs(&campaigns, None);
    terminal.unmatched(&unmatched);
    let bar = terminal.progress(jobs.len(), "read");
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<_> = jobs
        .par_iter()
        .map(|job| {
            let reading = common.desk().reading(&job.recorded, two_threads);
            bar.of(&job.id(), || ccr::read(&job.path, &reading, &mut ())).map(|run| (RunLine::of(&run), run.findings))
        })
        .collect();
    bar.finish();
    let mut lines = Vec::new();
    let mut failures = Vec::new();
    for (job, result) in jobs.iter().zip(results) {
        match result {
            Ok((line, findings)) => {
                findings.iter().for_each(|f| terminal.finding(f));
                lines.push(line);
            }
            Err(findings) => failures.push((job.recorded.clone(), Failure::Unreadable(findings))),
        }
    }
    if common.json {
        let failed = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        terminal.print(&json(&Listing { runs: &lines, failed })?);
    } else if !lines.is_empty() {
        terminal.print(&aligned_table(&run_list(&lines)));
    }
    report_failures(terminal, &failures, jobs.len());
    Ok(status(lines.len(), failures.iter().map(|(_, f)| f)))
}

/// Whether a file has a name that no run has.
fn is_of_other_kind(path: &Path) -> bool {
    let end = path.extension().unwrap_or_default();
    path.is_file() && ["toml", "json", "mag"].iter().any(|other| end.eq_ignore_ascii_case(other))
}
