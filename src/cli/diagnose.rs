//! `calfit diagnose`: find what the model misses.

use super::output::{Terminal, json};
use super::{Common, Status, open, report_failures, status};
use crate::diagnose::{self, Options};
use crate::error::Finding;
use crate::formats::output::Folder;
use crate::workflow::{Diagnosed, Failure, diagnose_run, facility, jobs, publish_diagnosis, publish_model, read_model};
use clap::Args;
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Effects that are known already.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Write the known effects and those that are found into a model file.
    #[arg(long, value_name = "FILE")]
    write_model: Option<PathBuf>,
    /// Facility that turns settings into applied fields.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
}

/// What `--json` prints for several runs.
#[derive(Serialize)]
struct Listing<'a> {
    diagnoses: Vec<&'a Diagnosed>,
    failed: Vec<&'a Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let campaigns = open(&arguments.paths, terminal)?;
    let model = arguments.model.as_ref().map(|path| read_model(path)).transpose()?;
    let facility = facility(arguments.facility.as_ref())?;
    let mut inputs = Vec::new();
    inputs.extend(model.as_ref().map(|(file, _)| file.input.clone()));
    inputs.extend(facility.as_ref().map(|f| f.input.clone()));
    let options = Options { facility, given: model.as_ref().map(|(_, given)| given.clone()).unwrap_or_default() };
    let (mut jobs, unmatched) = jobs(&campaigns, None);
    terminal.unmatched(&unmatched);
    jobs.retain(|job| job.named || job.header.as_ref().is_none_or(|h| diagnose::takes(h.kind)));
    if jobs.is_empty() {
        let shown: Vec<String> = arguments.paths.iter().map(|p| p.display().to_string()).collect();
        let rule = "holds no run with steps, sines, a sweep or zero field".to_owned();
        return Err(Finding::error(&shown.join(", "), rule, "list the runs with `calfit inspect`"));
    }
    Folder::open(&common.out, common.force)?;
    let desk = common.desk();
    let bar = terminal.progress(jobs.len());
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<Result<Diagnosed, Failure>> = jobs
        .par_iter()
        .map(|job| {
            let made = diagnose_run(job, &desk, &options, &inputs, two_threads).and_then(|made| {
                let folder = common.out.join(made.diagnosis.runs.first().map_or("", String::as_str));
                publish_diagnosis(&made, &folder, &desk).map_err(Failure::Refused)?;
                Ok(made)
            });
            bar.inc(1);
            made
        })
        .collect();
    bar.finish_and_clear();
    let total = results.len();
    let mut done = Vec::new();
    let mut failures = Vec::new();
    for (job, result) in jobs.iter().zip(results) {
        match result {
            Ok(made) => {
                made.diagnosis.warnings.iter().for_each(|w| terminal.warning(&format!("{}: {w}", job.recorded)));
                done.push(made);
            }
            Err(failure) => failures.push((job.recorded.clone(), failure)),
        }
    }
    let all: Vec<&Diagnosed> = done.iter().collect();
    if common.json {
        let failed: Vec<&Finding> = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        let text = match (all.as_slice(), failed.as_slice()) {
            ([one], []) => json(one)?,
            _ => json(&Listing { diagnoses: all.clone(), failed })?,
        };
        terminal.print(&text);
    } else {
        for made in &all {
            let id = made.diagnosis.runs.first().map_or("", String::as_str);
            terminal.tell(&format!(
                "{}  -> {}\n",
                crate::report::diagnose::summary(&made.diagnosis),
                common.out.join(id).display()
            ));
        }
    }
    if let Some(path) = &arguments.write_model {
        let given = model.map(|(file, _)| file.body.effect).unwrap_or_default();
        publish_model(path, &all, &given, common.force)?;
        if !common.json {
            terminal.tell(&format!("model -> {}\n", path.display()));
        }
    }
    report_failures(terminal, &failures, total);
    Ok(status(done.len(), failures.iter().map(|(_, f)| f)))
}
