//! `calfit lin`: the linear calibration of every linearity run.

use super::output::{Terminal, json};
use super::{Allow, Common, Failure, Job, Status, jobs, open, report_failures};
use crate::analysis::lin::{Lin, Options, lin};
use crate::envelope::Envelope;
use crate::error::Finding;
use crate::formats::output::Folder;
use crate::formats::parameter::Body;
use crate::formats::{ccr, parameter};
use crate::plateau::{self, Accumulator, Settling};
use crate::provenance::{Input, Provenance};
use crate::run::Kind;
use crate::units::with_uncertainty;
use crate::{plot, report};
use clap::{Args, ValueEnum};
use rayon::prelude::*;
use serde::Serialize;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Order of the offset trend, 0 to 2 [default: that of campaign.toml, or 2].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=2))]
    order: Option<u8>,
    /// Leave out fields beyond this limit along a nominal sensor axis, x=1900 for example; replaces the limit of campaign.toml.
    #[arg(long, value_name = "AXIS=NT", value_parser = axis_limit)]
    max_field: Vec<(usize, f64)>,
    /// Give outlying plateaus less weight (Huber).
    #[arg(long)]
    robust: bool,
    /// Time to leave out after every step, s, or `auto` to find it in the data.
    #[arg(long, value_name = "S", default_value = "auto", value_parser = settling)]
    settling: Settling,
    /// Least part of a plateau's samples that must be there.
    #[arg(long, value_name = "PART", default_value_t = 0.9, value_parser = part)]
    coverage: f64,
}

fn axis_limit(text: &str) -> Result<(usize, f64), String> {
    let (axis, limit) = text.split_once('=').ok_or("write AXIS=NT, x=1900 for example")?;
    let axis = ["x", "y", "z"].iter().position(|a| a.eq_ignore_ascii_case(axis)).ok_or("the axis is x, y or z")?;
    let limit: f64 = limit.parse().map_err(|_| "the limit is a number of nT")?;
    if limit.is_finite() && limit > 0.0 { Ok((axis, limit)) } else { Err("the limit is a positive number of nT".to_owned()) }
}

fn settling(text: &str) -> Result<Settling, String> {
    if text == "auto" {
        return Ok(Settling::Found);
    }
    match text.parse::<f64>() {
        Ok(s) if s.is_finite() && s >= 0.0 => Ok(Settling::Given(s)),
        _ => Err("write a number of seconds, 0 or more, or `auto`".to_owned()),
    }
}

fn part(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(p) if (0.0..=1.0).contains(&p) => Ok(p),
        _ => Err("write a number from 0 to 1".to_owned()),
    }
}

impl Arguments {
    fn options(&self, common: &Common) -> Options {
        let mut max_field_nt = [None; 3];
        for (axis, limit) in &self.max_field {
            max_field_nt[*axis] = Some(*limit);
        }
        Options {
            trend_order: self.order.map(usize::from),
            max_field_nt,
            robust: self.robust,
            settling: self.settling,
            least_coverage: self.coverage,
            allow_gain: common.allows(Allow::Gain),
            allow_mismatch: common.allows(Allow::Mismatch),
        }
    }

    /// The command as it is recorded: what has an influence on the numbers, and no paths.
    fn recorded(&self, options: &Options, common: &Common, order: usize) -> String {
        let mut text = format!("calfit lin --order {order}");
        for (axis, limit) in ["x", "y", "z"].into_iter().zip(options.max_field_nt) {
            if let Some(limit) = limit {
                text.push_str(&format!(" --max-field {axis}={limit}"));
            }
        }
        if options.robust {
            text.push_str(" --robust");
        }
        if let Settling::Given(s) = options.settling {
            text.push_str(&format!(" --settling {s}"));
        }
        if options.least_coverage != 0.9 {
            text.push_str(&format!(" --coverage {}", options.least_coverage));
        }
        for problem in common.allowed() {
            if let Some(value) = problem.to_possible_value() {
                text.push_str(&format!(" --allow {}", value.get_name()));
            }
        }
        text
    }
}

/// The tables of all runs of one call.
const TABLES: [&str; 2] = ["LIN_PARAMETERS.csv", "LIN_PARAMETERS.parquet"];

/// What `--json` prints.
#[derive(Serialize)]
struct Listing<'a> {
    runs: Vec<&'a Lin>,
    failed: Vec<&'a Finding>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let options = arguments.options(common);
    let campaigns = open(&arguments.paths, terminal)?;
    let jobs = jobs(&campaigns, Some(Kind::Linearity), |c| c.file.lin_runs.as_ref(), terminal);
    if jobs.is_empty() {
        let shown: Vec<String> = arguments.paths.iter().map(|p| p.display().to_string()).collect();
        return Err(Finding::error(&shown.join(", "), "holds no linearity run", "list the runs with `calfit inspect`"));
    }
    let folder = Folder::open(&common.out, common.force)?;
    TABLES.iter().try_for_each(|name| folder.check(name))?;
    let bar = terminal.progress(jobs.len());
    let two_threads = jobs.len() < rayon::current_num_threads();
    let results: Vec<Result<Lin, Failure>> = jobs
        .par_iter()
        .map(|job| {
            let result = unique(job).and_then(|()| one(job, arguments, &options, common, two_threads));
            bar.inc(1);
            result
        })
        .collect();
    bar.finish_and_clear();

    let mut done: Vec<Lin> = Vec::new();
    let mut failures = Vec::new();
    for (job, result) in jobs.iter().zip(results) {
        match result {
            Ok(lin) => {
                lin.parameters.warnings.iter().for_each(|w| terminal.warning(&format!("{}: {w}", job.recorded)));
                done.push(lin);
            }
            Err(failure) => failures.push((job.recorded.clone(), failure)),
        }
    }
    if common.json {
        let failed = failures.iter().flat_map(|(_, f)| f.errors()).collect();
        terminal.print(&json(&Listing { runs: done.iter().collect(), failed })?);
    } else {
        done.iter().for_each(|lin| terminal.tell(&summary(lin, &common.out.join(&lin.parameters.run.id).display().to_string())));
    }
    #[cfg(feature = "tables")]
    if !done.is_empty() {
        let table = report::lin::parameter_table(&done);
        let csv = table.csv("calfit lin: one row per run; readings enT, sensor axes; sensitivities nT/enT; angles in degrees")?;
        for (name, bytes) in TABLES.into_iter().zip([csv, table.parquet()?]) {
            if let Err(finding) = folder.write(name, &bytes) {
                failures.push((name.to_owned(), Failure::Refused(finding)));
            }
        }
    }
    report_failures(terminal, &failures, jobs.len());
    Ok(Failure::status(done.len(), failures.iter().map(|(_, f)| f)))
}

/// Results are named after the run id, so two files with one id cannot both have theirs.
fn unique(job: &Job) -> Result<(), Failure> {
    match &job.same_run_as {
        None => Ok(()),
        Some(other) => Err(Failure::Refused(Finding::error(
            &job.recorded,
            format!("has the same run id as {other}"),
            "correct `run` in one of the two",
        ))),
    }
}

/// Reads, fits and writes one run.
fn one(job: &Job, arguments: &Arguments, options: &Options, common: &Common, two_threads: bool) -> Result<Lin, Failure> {
    let envelope = (!common.no_plots).then(Envelope::default);
    let mut sinks = (Accumulator::default(), envelope);
    let run = ccr::read(&job.path, &common.read_options(&job.recorded, two_threads), &mut sinks).map_err(Failure::Unreadable)?;
    let (accumulator, envelope) = sinks;
    let plateaus = if run.blocks.is_empty() {
        accumulator.finish(options.settling, options.least_coverage)
    } else {
        plateau::from_blocks(&run.blocks)
    };
    let lin = lin(&run, &plateaus, job.campaign, options)
        .map_err(|e| Failure::Refused(Finding::error(&job.recorded, e.to_string(), e.remedy())))?;

    let mut input = vec![Input::from(&run.input)];
    input.extend(job.campaign.input.clone());
    let command = arguments.recorded(options, common, lin.parameters.offset.trend_order);
    let provenance = Provenance::new(command, input);
    let samples = envelope.filter(|_| run.blocks.is_empty()).map(|e| e.columns());
    write(&lin, &provenance, samples.as_deref(), common).map_err(Failure::Refused)?;
    Ok(lin)
}

/// Writes the results of one run, the parameter file last.
fn write(
    lin: &Lin,
    provenance: &Provenance,
    samples: Option<&[crate::envelope::Column]>,
    common: &Common,
) -> Result<(), Finding> {
    let id = &lin.parameters.run.id;
    let folder = Folder::open(&common.out.join(id), common.force)?;
    let parameter_name = lin.parameters.file_name();
    folder.check(&parameter_name)?;
    let mut links = Vec::new();
    if !common.no_plots {
        let figures = plot::lin::figures(lin, samples);
        let drawn: Vec<(String, Result<Vec<u8>, plot::PlotError>)> =
            figures.par_iter().map(|named| (format!("LIN_{}__{id}.png", named.stem), plot::render(&named.figure))).collect();
        for (named, (file, picture)) in figures.iter().zip(drawn) {
            let shown = folder.path().join(&file).display().to_string();
            let picture = picture.map_err(|e| Finding::error(&shown, e.to_string(), "run again with --no-plots"))?;
            folder.write(&file, &picture)?;
            links.push(report::lin::FigureLink { file, title: named.figure.title.clone() });
        }
    }
    #[cfg(feature = "tables")]
    {
        let note = format!(
            "calfit lin, run {id}: one row per block; fields nT, coil axes; readings enT, sensor axes; times s since the run's start"
        );
        folder.write(&format!("LIN_BLOCKS__{id}.csv"), &report::lin::block_table(lin).csv(&note)?)?;
    }
    folder.write(&format!("REPORT_LIN__{id}.md"), report::lin::markdown(lin, provenance, &links).as_bytes())?;
    // What the parameter file rests on is safe on disk before it, and its own name after it.
    folder.sync()?;
    let text = parameter::to_text(&lin.parameters, provenance)
        .map_err(|e| Finding::error(&parameter_name, format!("the result has no text form: {e}"), "report this"))?;
    folder.write(&parameter_name, text.as_bytes())?;
    folder.sync()
}

/// A few lines for a person.
fn summary(lin: &Lin, folder: &str) -> String {
    let p = &lin.parameters;
    let temperature = p.run.temperature_degc.map_or_else(String::new, |t| format!(", {t:.1} °C"));
    let sigma: Vec<String> = (0..3).map(|i| with_uncertainty(p.matrix.sigma[i][i], p.std.sigma[i])).collect();
    let b_or: Vec<String> = (0..3).map(|i| with_uncertainty(p.offset.b_or_ent[i], p.std.b_or_ent[i])).collect();
    let residual = p.quality.residual_nt.std.map(|s| format!("{s:.3}"));
    format!(
        "{}  {} {}{temperature}  {} of {} blocks\n  σ     {}  nT/enT\n  B_or  {}  enT\n  residual standard deviation {}  nT (X, Y, Z)\n  -> {folder}\n",
        p.run.id,
        p.run.sensor,
        p.run.mode,
        p.quality.blocks_used,
        p.quality.blocks_total,
        sigma.join(", "),
        b_or.join(", "),
        residual.join(", "),
    )
}
