//! `calfit coil`: the facility's own calibration.

use super::output::{Printed, Terminal, json};
use super::{Common, Status, jobs_of, open, refused, report_failures, status};
use crate::data::error::Finding;
use crate::data::run::Kind;
use crate::files::import::Format;
use crate::files::output::Folder;
use crate::files::parameter::{Cpf, is_named};
use crate::measure::coil::{scalar, tilt};
use crate::measure::lin;
use crate::workflow::{
    CoilMade, CoilResult, Desk, Failure, Job, TiltInput, coil_runs, publish_coil, residual_of, residual_of_table, scalar_of,
};
use clap::{Args, Subcommand};
use std::collections::BTreeMap;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    #[command(subcommand)]
    method: Method,
}

#[derive(Debug, Subcommand)]
enum Method {
    /// Scale factors, offset fields and angles of the coils from settings and moduli of a scalar magnetometer.
    Scalar(ScalarArguments),
    /// Residual field per coil axis from moduli at plus and minus F.
    Residual(ResidualArguments),
    /// Sensor and facility from runs of one sensor in several orientations.
    Tilt(TiltArguments),
}

#[derive(Args, Debug)]
struct ScalarArguments {
    /// A campaign folder or run files with @SCALAR rows; several runs are several calibrations of one facility. From three on at
    /// different temperatures the coefficients of the coil temperature are found as well.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Channel of the rack temperature, whose coefficients are found from four calibrations on [default: `rack_temperature_channel`
    /// of campaign.toml, or T55].
    #[arg(long, value_name = "CHANNEL")]
    rack_channel: Option<String>,
}

#[derive(Args, Debug)]
struct ResidualArguments {
    /// A campaign folder or run files whose @SCALAR rows hold +F and -F on one axis, every run a state of the facility; or one table
    /// axis,state,plus_nt,minus_nt and optionally std_nt (.csv): axis X, Y or Z, state as `before nulling`, moduli at +F and -F.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
}

#[derive(Args, Debug)]
struct TiltArguments {
    /// Tables of run results (.csv) with the columns run, sensor, orientation, sx_nt_per_eu, sy_, sz_, x0_nt, y0_, z0_, xi_xy_deg,
    /// xi_xz_, xi_yz_, where orientation names the sensor axes along the coil axes X, Y, Z as in `-Y +X +Z`; linear calibrations
    /// (.CPF); a campaign folder or linearity runs.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// The facility that the runs were evaluated with: scale_nt_per_eu, offset_nt, angles_deg.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
    /// Sensor, where several were turned.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// Use orientations that do not agree with the others, too.
    #[arg(long)]
    keep_all: bool,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    // Refuse what cannot be written before the work begins.
    Folder::open(&common.out, common.force)?;
    match &arguments.method {
        Method::Scalar(own) => {
            let options = scalar::Options { rack_channel: own.rack_channel.clone() };
            let campaigns = open(&own.paths, common, terminal)?;
            let jobs = jobs_of(&campaigns, &own.paths, Kind::Scalar, terminal)?;
            if jobs.is_empty() {
                return nothing(common, terminal);
            }
            let (desk, mut failures) = (common.desk(), Vec::new());
            let made = scalar_of(coil_runs(&jobs, &desk, &mut failures), &options, &desk).transpose();
            finish(made, failures, &recorded(&jobs), jobs.len(), common, terminal)
        }
        Method::Residual(own) => residual_field(own, common, terminal),
        Method::Tilt(own) => orientations(own, common, terminal),
    }
}

fn residual_field(own: &ResidualArguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let desk = common.desk();
    if let [table] = own.paths.as_slice()
        && Format::Csv.is_of(table)
    {
        common.results.accept_tables([table])?;
        let mut findings = Vec::new();
        let made = residual_of_table(table, &mut findings)?;
        findings.iter().for_each(|f| terminal.finding(f));
        return finish(Some(Ok(made)), Vec::new(), &[], 1, common, terminal);
    }
    if let Some(table) = own.paths.iter().find(|p| Format::Csv.is_of(p)) {
        return Err(Finding::error(&table.display().to_string(), "is not the only PATH", "name one table alone, or runs"));
    }
    let campaigns = open(&own.paths, common, terminal)?;
    let jobs = jobs_of(&campaigns, &own.paths, Kind::Scalar, terminal)?;
    if jobs.is_empty() {
        return nothing(common, terminal);
    }
    let mut failures = Vec::new();
    let made = residual_of(coil_runs(&jobs, &desk, &mut failures), &desk).transpose();
    finish(made, failures, &recorded(&jobs), jobs.len(), common, terminal)
}

fn orientations(own: &TiltArguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let (cpfs, others): (Vec<PathBuf>, Vec<PathBuf>) = own.paths.iter().cloned().partition(|path| is_named::<Cpf>(path));
    common.results.accept_tables(others.iter().filter(|path| Format::Csv.is_of(path)))?;
    common.results.places(&own.facility);
    common.results.accept_files(&cpfs)?;
    let facility = terminal.facility(own.facility.as_ref())?;
    let mut input = TiltInput::default();
    let mut failures = Vec::new();
    let mut campaign_paths = Vec::new();
    for path in &own.paths {
        if Format::Csv.is_of(path) {
            let mut findings = Vec::new();
            let read = input.table(path, &mut findings);
            findings.iter().for_each(|f| terminal.finding(f));
            read?;
        } else if is_named::<Cpf>(path) {
            input.cpf(path)?;
        } else {
            campaign_paths.push(path.clone());
        }
    }
    let mut runs = Vec::new();
    let campaigns = if campaign_paths.is_empty() { Vec::new() } else { open(&campaign_paths, common, terminal)? };
    if !campaigns.is_empty() {
        let jobs = jobs_of(&campaigns, &campaign_paths, Kind::Linearity, terminal)?;
        if jobs.is_empty() && campaign_paths.len() == own.paths.len() {
            return nothing(common, terminal);
        }
        runs = recorded(&jobs);
        let options = lin::Options { facility: facility.clone(), ..lin::Options::default() };
        input.runs(&jobs, &options, &Desk { plots: false, ..common.desk() }, &mut failures);
    }
    let options = tilt::Options { sensor: own.sensor.clone(), keep_all: own.keep_all };
    let made = input.solve(facility.as_ref(), &options);
    finish(Some(made), failures, &runs, own.paths.len(), common, terminal)
}

/// The end of an analysis that does not apply to the campaigns: there is no run, and nothing failed.
fn nothing(common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if common.json {
        let none: [(); 0] = [];
        terminal.print(&json(&BTreeMap::from([("runs", none), ("failed", none)]))?);
    }
    Ok(Status::Done)
}

/// The paths of runs inside their campaigns.
fn recorded(jobs: &[Job]) -> Vec<String> {
    jobs.iter().map(|job| job.recorded.clone()).collect()
}

/// Writes and prints the result, and the errors of the `runs` that are not in it.
fn finish<R: CoilResult>(
    made: Option<Result<CoilMade<R>, Finding>>,
    mut failures: Vec<(String, Failure)>,
    runs: &[String],
    total: usize,
    common: &Common,
    terminal: &Terminal,
) -> Result<Status, Finding> {
    let published = made.map(|made| made.and_then(|made| publish_coil(&made, &common.desk()).map(|(name, _)| (made, name))));
    let mut together = None;
    let done = match published {
        Some(Ok((made, name))) => {
            made.result.notes().iter().for_each(|w| terminal.warning(&format!("{name}: {w}")));
            if common.json {
                terminal.print(&json(&Printed {
                    result: made.result.view(),
                    parameter_file: &name,
                    provenance: &made.provenance,
                })?);
            } else {
                terminal.tell(&format!("{}  -> {}\n", (R::SHOWN.summary)(&made.result), common.out.join(&name).display()));
            }
            1
        }
        Some(Err(finding)) => {
            // What is wrong with them together counts for those with which nothing is wrong alone.
            let name = finding.file.to_string();
            let failure = Failure::Refused(finding);
            let sound = runs.iter().filter(|run| failures.iter().all(|(name, _)| name != *run));
            sound.for_each(|run| common.results.looked(run, refused(&failure)));
            together = Some((name, failure));
            0
        }
        None => 0,
    };
    failures.iter().for_each(|(name, failure)| common.results.looked(name, refused(failure)));
    failures.extend(together);
    report_failures(terminal, &failures, total);
    Ok(status(done, failures.iter().map(|(_, f)| f)))
}
