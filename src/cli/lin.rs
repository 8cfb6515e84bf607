//! `calfit lin`: the linear calibration of every linearity run.

use super::each::Attempt;
use super::options::{Cut, Excluding, ValueError, without_excluded};
use super::output::Terminal;
use super::{Allow, Common, Status, each, jobs_of, open_without, refused};
use crate::data::error::Finding;
use crate::files::output::Folder;
use crate::files::parameter::{Body, LinearisationFile};
use crate::measure::lin::Options;
use crate::workflow::{
    Failure, First, PerRun, RunResult, by_sensor_and_mode, facility, known, linearisation, linearise_group, make, publish,
    table_names, temperature,
};
use clap::Args;
use rayon::prelude::*;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Find the polynomial of third order per sensor axis that all runs of a sensor and mode share, and fit every run with it:
    /// the non-linearity of the readings → LINEARISATION.
    #[arg(long, conflicts_with_all = ["robust", "linearisation"])]
    linearise: bool,
    /// Linearise the readings with the polynomials of a LINEARISATION file.
    #[arg(long, value_name = "FILE")]
    linearisation: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
    #[command(flatten)]
    fit: FitOptions,
}

/// Options of the linear fit, here and in the commands that contain it.
#[derive(Args, Clone, Debug)]
pub(super) struct FitOptions {
    /// Order of the offset trend, 0 to 2 [default: that of campaign.toml, or 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=2))]
    order: Option<u8>,
    /// Leave out fields beyond this limit along a nominal sensor axis, x=1900 for example; replaces the limit of campaign.toml.
    #[arg(long, value_name = "AXIS=NT", value_parser = axis_limit)]
    max_field: Vec<(usize, f64)>,
    /// Give outlying plateaus less weight (Huber).
    #[arg(long)]
    robust: bool,
    /// Facility (COIL_SCALAR, COIL_TILT, or keys scale_nt_per_eu, offset_nt, angles_deg) that turns settings into the reference
    /// field, in place of the settings themselves.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: its effects are taken off the readings before the fit.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Polynomials of the sensor (TPF): what sensitivities, angles and offset follow of a sensor temperature that moves during a run. Without
    /// them it is found in the run itself, with wider uncertainties.
    #[arg(long, value_name = "TPF")]
    temperature: Option<PathBuf>,
    #[command(flatten)]
    cut: Cut,
}

fn axis_limit(text: &str) -> Result<(usize, f64), ValueError> {
    let (axis, limit) = text.split_once('=').ok_or(ValueError::Limit)?;
    let axis = ["x", "y", "z"].iter().position(|a| a.eq_ignore_ascii_case(axis)).ok_or(ValueError::LimitAxis)?;
    let limit: f64 = limit.parse().map_err(|_| ValueError::LimitNumber)?;
    if limit.is_finite() && limit > 0.0 { Ok((axis, limit)) } else { Err(ValueError::LimitSign) }
}

impl FitOptions {
    /// The files that the options name.
    pub(super) fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.facility.iter().chain(&self.model).chain(&self.temperature)
    }

    pub(super) fn options(&self, common: &Common) -> Result<Options, Finding> {
        let mut max_field_nt = [None; 3];
        for (axis, limit) in &self.max_field {
            max_field_nt[*axis] = Some(*limit);
        }
        Ok(Options {
            trend_order: self.order.map(usize::from),
            max_field_nt,
            robust: self.robust,
            cut: self.cut.into(),
            allow_gain: common.allows(Allow::Gain),
            allow_mismatch: common.allows(Allow::Mismatch),
            facility: facility(self.facility.as_ref())?,
            linearisation: None,
            model: known(self.model.as_ref())?,
            temperature: temperature(self.temperature.as_ref())?,
        })
    }
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.results.places(arguments.fit.files().chain(&arguments.linearisation));
    let linearisation = linearisation(arguments.linearisation.as_ref())?;
    let options = Options { linearisation, ..arguments.fit.options(common)? };
    if arguments.linearise {
        linearise(&options, &arguments.paths, &arguments.excluding, common, terminal)
    } else {
        each::run(&options, &arguments.paths, &arguments.excluding, common, terminal)
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
    let bar = terminal.progress(jobs.len());
    let two_threads = jobs.len() < rayon::current_num_threads();
    let first: Vec<Attempt<Options>> = jobs
        .par_iter()
        .map(|job| {
            let made = make(options, job, &desk, two_threads);
            bar.inc(1);
            made
        })
        .collect();
    bar.finish_and_clear();
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
                let published: Vec<(String, Attempt<Options>)> = runs
                    .into_par_iter()
                    .map(|(job, made)| {
                        let made = made.and_then(|made| {
                            publish::<Options>(&made, &desk, &made.result.parameters().file_name())?;
                            Ok(made)
                        });
                        (job.recorded.clone(), made.map_err(Failure::Refused))
                    })
                    .collect();
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
