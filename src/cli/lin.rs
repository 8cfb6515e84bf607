//! `calfit lin`: the linear calibration of every linearity run.

use super::each::Attempt;
use super::options::{Corrections, Cut, Excluding, Linear, Linearise, without_excluded};
use super::output::Terminal;
use super::{Allow, Common, Status, each, jobs_of, open_without, refused};
use crate::data::error::Finding;
use crate::files::output::Folder;
use crate::files::parameter::{Body, LinearisationFile};
use crate::measure::lin::Options;
use crate::workflow::{
    Failure, First, PerRun, RunResult, by_sensor_and_mode, each, known, linearisation, linearise_group, make, publish,
    table_names, temperature,
};
use clap::Args;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder, or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    #[command(flatten)]
    linearise: Linearise,
    #[command(flatten)]
    excluding: Excluding,
    /// Order of the offset trend, 0 to 2 [default: that of campaign.toml, or 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=2))]
    order: Option<u8>,
    #[command(flatten)]
    linear: Linear,
    #[command(flatten)]
    corrections: Corrections,
    /// Polynomials of the sensor (TPF): what sensitivities, angles and offset follow of a sensor temperature that moves during a run. Without
    /// them it is found in the run itself, with wider uncertainties.
    #[arg(long, value_name = "TPF")]
    temperature: Option<PathBuf>,
    #[command(flatten)]
    cut: Cut,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let corrections = arguments.corrections.facility.iter().chain(&arguments.corrections.model);
    common.results.places(corrections.chain(&arguments.temperature).chain(&arguments.linear.linearisation));
    let options = arguments.options(common, terminal)?;
    if arguments.linearise.linearise {
        linearise(&options, &arguments.paths, &arguments.excluding, common, terminal)
    } else {
        each::run(&options, &arguments.paths, &arguments.excluding, common, terminal)
    }
}

impl Arguments {
    fn options(&self, common: &Common, terminal: &Terminal) -> Result<Options, Finding> {
        Ok(Options {
            trend_order: self.order.map(usize::from),
            max_field_nt: self.linear.max_field_nt(),
            robust: self.linear.robust,
            cut: self.cut.into(),
            allow_gain: common.allows(Allow::Gain),
            allow_mismatch: common.allows(Allow::Mismatch),
            facility: terminal.facility(self.corrections.facility.as_ref())?,
            linearisation: linearisation(self.linear.linearisation.as_ref())?,
            model: known(self.corrections.model.as_ref())?,
            temperature: temperature(self.temperature.as_ref())?,
        })
    }
}

/// Fits every run, then those of each sensor and mode together, and writes what was found together before the runs that rest on it.
fn linearise(
    options: &Options,
    paths: &[PathBuf],
    excluding: &Excluding,
    common: &Common,
    terminal: &Terminal,
) -> Result<Status, Finding> {
    let campaigns = open_without(paths, excluding, common, terminal)?;
    let (jobs, excluded) = without_excluded(jobs_of(&campaigns, paths, Options::KIND, terminal)?, &common.results);
    let folder = Folder::open(&common.out, common.force)?;
    table_names(Options::STEM).iter().try_for_each(|name| folder.check(name))?;
    let desk = common.desk_without(excluding);
    let bar = terminal.progress(jobs.len(), "analysed");
    let two_threads = jobs.len() < rayon::current_num_threads();
    let first: Vec<Attempt<Options>> = each(&jobs, |job| bar.of(&job.id(), || make(options, job, &desk, two_threads)));
    bar.finish();
    let mut results: Vec<(String, Attempt<Options>)> = Vec::new();
    let mut runs = Vec::new();
    for (job, made) in jobs.iter().zip(first) {
        match made {
            Ok(made) => runs.push(First { job, made }),
            Err(failure) => results.push((job.recorded.clone(), Err(failure))),
        }
    }
    let mut found = Vec::new();
    for group in by_sensor_and_mode(runs) {
        let names: Vec<String> = group.iter().map(|f| f.job.recorded.clone()).collect();
        match linearise_group(group, options, &desk) {
            Ok((result, runs)) => {
                let name = LinearisationFile::from(&result).file_name();
                result.notes.iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
                found.push(result);
                let published: Vec<(String, Attempt<Options>)> = each(runs, |(job, made)| {
                    let made = made.and_then(|made| {
                        publish::<Options>(&made, &desk, &made.result.parameters().file_name())?;
                        Ok(made)
                    });
                    (job.recorded.clone(), made.map_err(Failure::Refused))
                });
                results.extend(published);
            }
            // Without the linearisation there are no parameters as they were asked for, of none of its runs.
            Err(finding) => {
                let failure = Failure::Refused(finding);
                names.iter().for_each(|name| common.results.outcome(name, refused(&failure)));
                results.push((names.join(", "), Err(failure)));
            }
        }
    }
    each::finish::<Options>(each::Results { of_runs: results, excluded }, &found, common, terminal)
}
