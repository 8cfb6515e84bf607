//! What `lin`, `offset`, `freq` and `null` do alike: every run of a kind on its own, in parallel, and a table of all.

use super::options::{Excluded, Excluding, without_excluded};
use super::output::{Terminal, json};
use super::{Common, Status, jobs_of, open_without, refused, report_failures, status};
use crate::data::error::Finding;
use crate::files::output::Folder;
use crate::files::parameter::{Body, LinearisationFile};
use crate::measure::linearise::Linearised;
use crate::show;
use crate::workflow::{Failure, LinearisedView, Made, PerRun, RunMade, RunResult, make, publish, table_names};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;

/// What `--json` prints.
#[derive(Serialize)]
struct Listing<'a> {
    runs: Vec<Value>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    linearisation: Vec<LinearisedView<'a>>,
    #[serde(skip_serializing_if = "<[Excluded]>::is_empty")]
    excluded: &'a [Excluded],
    failed: Vec<&'a Finding>,
}

/// A result, or why there is none.
pub(super) type Attempt<A> = Result<Made<<A as PerRun>::Result>, Failure>;

/// The results of some runs, by their files, beside the runs that are left out by hand.
pub(super) struct Results<A: PerRun> {
    pub of_runs: Vec<(String, Attempt<A>)>,
    pub excluded: Vec<Excluded>,
}

/// Analyses every run of the analysis' kind among the paths and writes its files.
pub(super) fn run<A: PerRun>(
    analysis: &A,
    paths: &[PathBuf],
    excluding: &Excluding,
    common: &Common,
    terminal: &Terminal,
) -> Result<Status, Finding> {
    let campaigns = open_without(paths, excluding, common, terminal)?;
    let (jobs, excluded) = without_excluded(jobs_of(&campaigns, paths, A::KIND, terminal)?, &common.results);
    let folder = Folder::open(&common.out, common.force)?;
    table_names(A::STEM).iter().try_for_each(|name| folder.check(name))?;
    let desk = common.desk_without(excluding);
    let bar = terminal.progress(jobs.len(), "analysed");
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<Attempt<A>> = jobs
        .par_iter()
        .map(|job| {
            bar.of(&job.id(), || {
                let made = make(analysis, job, &desk, two_threads)?;
                publish::<A>(&made, &desk, &made.result.parameters().file_name()).map_err(Failure::Refused)?;
                Ok(made)
            })
        })
        .collect();
    bar.finish();
    let results = Results { of_runs: jobs.iter().map(|j| j.recorded.clone()).zip(results).collect(), excluded };
    finish::<A>(results, &[], common, terminal)
}

/// Prints results, linearisations that they share, and failures, and writes the table of all runs.
pub(super) fn finish<A: PerRun>(
    Results { of_runs, excluded }: Results<A>,
    linearisation: &[Linearised],
    common: &Common,
    terminal: &Terminal,
) -> Result<Status, Finding> {
    let total = of_runs.len() + excluded.len();
    let mut done: Vec<Made<A::Result>> = Vec::new();
    let mut failures = Vec::new();
    for (name, result) in of_runs {
        match result {
            Ok(made) => {
                made.result.notes().iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
                common.results.done(made.result.head(), &made.provenance);
                done.push(made);
            }
            Err(failure) => {
                common.results.outcome(&name, refused(&failure));
                failures.push((name, failure));
            }
        }
    }
    if common.json {
        let failed = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        let runs = done.iter().map(RunMade::view).collect::<Result<_, _>>()?;
        let linearisation = linearisation.iter().map(LinearisedView::from).collect();
        terminal.print(&json(&Listing { runs, linearisation, excluded: &excluded, failed })?);
    } else {
        for result in linearisation {
            let file = common.out.join(LinearisationFile::from(result).file_name());
            terminal.tell(&format!("{}  -> {}\n", show::linearise::summary(result), file.display()));
        }
        for result in done.iter().map(|made| &made.result) {
            terminal.tell(&format!("{}  -> {}\n", result.summary(), common.out.join(&result.head().id).display()));
        }
    }
    if !common.json {
        excluded.iter().for_each(|one| terminal.tell(&one.told()));
    }
    if let Err(finding) = common.results.renew_tables(&common.desk()) {
        failures.push((format!("{}_PARAMETERS", A::STEM), Failure::Refused(finding)));
    }
    report_failures(terminal, &failures, total);
    let partial = if done.iter().any(|made| made.result.is_partial()) { Status::Partly } else { Status::Done };
    Ok(status(done.len(), failures.iter().map(|(_, f)| f)).max(partial))
}
