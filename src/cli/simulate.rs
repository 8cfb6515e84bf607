//! `calfit simulate`: a campaign from a twin, telemetry from a twin in flight, or a measured run once more.

use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::units::counted;
use crate::files::twin;
use crate::simulate::like::write_like;
#[cfg(feature = "tables")]
use crate::simulate::telemetry::Telemetry;
use crate::simulate::write_campaign_with;
use crate::workflow::{known, own_parameters};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// The twin: sensors, electronics, facility, thermal box, noise, programme.
    #[arg(value_name = "TWIN.toml", required_unless_present = "like", conflicts_with = "like")]
    twin: Option<PathBuf>,
    /// Simulate a measured run instead: the same programme and temperatures, readings from its parameter files.
    #[arg(long, value_name = "RUN")]
    like: Option<PathBuf>,
    /// Parameter files for --like: the CPF of a linearity run, OPF and CPF of an offset run, the FPF of a frequency run [default: those that the
    /// run itself gives; for an offset run also that of the linearity run of its sensor and mode in the campaign that is nearest in time].
    #[arg(long, value_name = "FILE", requires = "like", num_args = 1..)]
    parameters: Vec<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: its effects are added to the readings.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    /// Seed of the random numbers, in place of the twin's.
    #[arg(long, value_name = "N")]
    seed: Option<u64>,
    /// Coefficient files for a twin in flight, which its sensors are calibrated with in place of exact ones.
    #[cfg(feature = "tables")]
    #[arg(long, value_name = "FILE", requires = "twin", conflicts_with = "like", num_args = 1..)]
    ground: Vec<PathBuf>,
}

#[derive(Serialize)]
struct Listing<R> {
    seed: u64,
    runs: Vec<R>,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.must_hold_no_results()?;
    match (&arguments.like, &arguments.twin) {
        (Some(run), _) => like(run, arguments, common, terminal),
        (None, Some(twin)) => campaign(twin, arguments, common, terminal),
        (None, None) => Err(Finding::error("calfit simulate", "no twin was named", "name TWIN.toml, or a run with --like")),
    }
}

fn like(run: &Path, arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let seed = arguments.seed.unwrap_or(1);
    let (model, mut notes) = (known(arguments.model.as_ref())?, Vec::new());
    let own = match arguments.parameters.is_empty() {
        true => Some(own_parameters(run, model.as_ref())?),
        false => None,
    };
    if let Some(linearity) = own.as_ref().and_then(|own| own.linearity.as_ref()) {
        let text = format!("the sensitivities are those of the linearity run {linearity}");
        notes.push(Note::new(NoteKind::Method, text).about(run.display().to_string()));
    }
    let files = own.as_ref().map_or(arguments.parameters.as_slice(), |own| own.files.as_slice());
    let path = write_like(model.as_ref(), run, files, seed, &common.out, common.force, &mut notes)?;
    notes.iter().for_each(|w| terminal.warning(&w.to_string()));
    if common.json {
        terminal.print(&json(&Listing { seed, runs: vec![path] })?);
    } else {
        terminal.tell(&format!("{}, seed {seed}\n  -> {}\n", run.display(), common.out.join(path).display()));
    }
    Ok(Status::Done)
}

/// Telemetry of a twin in flight.
#[cfg(feature = "tables")]
fn telemetry(path: &Path, arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if arguments.model.is_some() {
        let rule = "changes nothing of a twin in flight";
        return Err(Finding::error("--model", rule, "leave it out"));
    }
    let mut findings = Vec::new();
    let twin = twin::telemetry::read(path, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let twin = twin?;
    let seed = arguments.seed.unwrap_or(twin.seed);
    let written = Telemetry::new(&twin, seed)?.write(&arguments.ground, &common.out, common.force)?;
    if common.json {
        terminal.print(&json(&written)?);
    } else {
        let rows: Vec<String> = written.rows.iter().map(|(name, rows)| format!("{name} {rows} vectors")).collect();
        terminal.tell(&format!("{}, seed {seed}\n  -> {}\n", rows.join(", "), written.config.display()));
    }
    Ok(Status::Done)
}

fn campaign(path: &Path, arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if path.extension().is_some_and(|end| end.eq_ignore_ascii_case("mag")) {
        let rule = "is a field programme (.MAG); `calfit simulate` takes a twin";
        let remedy =
            "name a TOML file with [electronics], whose [[run]] names the programme; docs/reference/twin.md has an example";
        return Err(Finding::error(&path.display().to_string(), rule, remedy));
    }
    #[cfg(feature = "tables")]
    if twin::telemetry::is_telemetry(path)? {
        return telemetry(path, arguments, common, terminal);
    } else if !arguments.ground.is_empty() {
        let rule = "changes nothing of a campaign on ground";
        return Err(Finding::error("--ground", rule, "leave it out, or name a twin in flight"));
    }
    let mut findings = Vec::new();
    let twin = twin::read(path, &mut findings)?;
    findings.iter().for_each(|f| terminal.finding(f));
    let seed = arguments.seed.unwrap_or(twin.seed);
    let bar = terminal.progress(twin.runs.len(), "written");
    let (model, mut notes) = (known(arguments.model.as_ref())?, Vec::new());
    let runs = write_campaign_with(model.as_ref(), &twin, seed, &common.out, common.force, || bar.of("", || ()), &mut notes)?;
    bar.finish();
    notes.iter().for_each(|w| terminal.warning(&w.to_string()));
    let (vectors, bytes) = runs.iter().fold((0, 0), |(v, b), run| (v + run.vectors, b + run.size_bytes));
    if common.json {
        terminal.print(&json(&Listing { seed, runs })?);
    } else {
        terminal.tell(&format!(
            "{}, {vectors} vectors, {:.1} MB, seed {seed}\n  -> {}\n",
            counted(twin.runs.len() as u64, "run"),
            bytes as f64 / 1e6,
            common.out.display()
        ));
    }
    Ok(Status::Done)
}
