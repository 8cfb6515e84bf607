//! A twin of facility, sensor and campaign: run files whose truth is known; and of a mission with these sensors: telemetry.
//!
//! The sensor, its AC response and the coil system are those of [`crate::model`], which the analyses fit; noise, temperatures, losses
//! and the programme live here. A twin is read by [`crate::files::twin`]. Every run draws its random numbers from streams of its own
//! (seed, run id, purpose), so that runs can be made in any order and one by one.

pub mod climate;
pub mod like;
pub mod noise;
pub mod run;
#[cfg(feature = "tables")]
pub mod telemetry;

use crate::data::error::Finding;
use crate::data::note::Note;
use crate::files::ccr::{Decimals, Section, Writer};
use crate::files::output::Folder;
use crate::files::twin::{RunTwin, Twin};
use crate::record::known::Known;
use climate::Temperatures;
use rayon::prelude::*;
use run::SimulatedRun;
use serde::Serialize;
use std::io::Write;
use std::path::Path;

/// A twin with its temperatures, ready to make runs.
#[derive(Clone, Debug)]
pub struct Simulation<'a> {
    twin: &'a Twin,
    climate: Temperatures,
    seed: u64,
}

impl<'a> Simulation<'a> {
    /// Works out the temperatures of the whole campaign.
    #[must_use]
    pub fn new(twin: &'a Twin, seed: u64) -> Self {
        let lasts =
            |run: &RunTwin| twin.programmes.get(run.programme).map_or(0.0, |p| f64::from(run.repeat) * p.lasts_s(run.pause_s));
        let first = twin.runs.iter().map(|r| r.start).min().unwrap_or_default();
        let ends = twin.runs.iter().map(|r| r.start.saturating_add(jiff::SignedDuration::from_secs(lasts(r) as i64 + 60)));
        let last = ends.filter_map(Result::ok).max().unwrap_or(first);
        Self { twin, climate: Temperatures::of(twin, [first, last]), seed }
    }

    /// One run of the twin.
    ///
    /// # Errors
    /// See [`SimulatedRun::new`].
    pub fn run(&self, run: &RunTwin) -> Result<SimulatedRun<'_>, Finding> {
        SimulatedRun::new(self.twin, run, &self.climate, self.seed)
    }
}

/// A file that was written.
#[derive(Clone, Debug, Serialize)]
pub struct Written {
    /// Path inside the campaign.
    pub path: String,
    /// Samples in it.
    pub vectors: u64,
    /// Its size.
    pub size_bytes: u64,
}

/// Writes the campaign of a twin into a folder, runs side by side, and `campaign.toml` last.
///
/// # Errors
/// A run that cannot be made, or an error of the operating system.
pub fn write_campaign(twin: &Twin, seed: u64, out: &Path, force: bool, done: impl Fn() + Sync) -> Result<Vec<Written>, Finding> {
    write_campaign_with(None, twin, seed, out, force, done, &mut Vec::new())
}

/// The same with known effects in the readings. Effects that a run cannot have give a warning.
///
/// # Errors
/// See [`write_campaign`].
pub fn write_campaign_with(
    model: Option<&Known>,
    twin: &Twin,
    seed: u64,
    out: &Path,
    force: bool,
    done: impl Fn() + Sync,
    notes: &mut Vec<Note>,
) -> Result<Vec<Written>, Finding> {
    let simulation = Simulation::new(twin, seed);
    let instructions = &twin.campaign.instructions;
    let prepare = |run| -> Result<(&RunTwin, SimulatedRun, Vec<Note>), Finding> {
        let (simulated, mut notes) = (simulation.run(run)?, Vec::new());
        let simulated = match model {
            Some(model) => simulated.with_effects(model, instructions, &mut notes),
            None => simulated,
        };
        Ok((run, simulated, notes))
    };
    // The error of the first run, whichever thread is the first.
    let each: Vec<_> = twin.runs.par_iter().map(prepare).collect();
    let all = each.into_iter().collect::<Result<Vec<_>, Finding>>()?;
    // The longest runs first, so that all cores finish at about the same time.
    let mut prepared: Vec<(&RunTwin, SimulatedRun)> = Vec::new();
    for (run, simulated, own) in all {
        notes.extend(own);
        prepared.push((run, simulated));
    }
    prepared.sort_by_key(|(_, simulated)| std::cmp::Reverse(simulated.samples()));
    let root = Folder::open(out, force)?;
    root.check("campaign.toml")?;
    let with = model.map_or_else(String::new, |m| format!(", with the effects of {}", m.input.path));
    let remark = format!("simulated by calfit {}, seed {seed}{with}", env!("CARGO_PKG_VERSION"));
    let written: Vec<Result<Written, Finding>> = prepared
        .par_iter()
        .with_max_len(1)
        .map(|(run, simulated)| {
            let (day, time) = run.id.split_once('_').unwrap_or(("", &run.id));
            let folder = Folder::open(&out.join(day), force)?;
            let one = write_run(simulated, &remark, &folder, &format!("{time}.CCR"))?;
            done();
            Ok(Written { path: format!("{day}/{}", one.path), ..one })
        })
        .collect();
    let mut written = written.into_iter().collect::<Result<Vec<Written>, Finding>>()?;
    written.sort_by(|a, b| a.path.cmp(&b.path));
    root.write("campaign.toml", format!("# calfit {}: {remark}\n{}", env!("CARGO_PKG_VERSION"), twin.campaign_toml).as_bytes())?;
    root.sync()?;
    Ok(written)
}

/// Writes one run; `remark` goes into its head.
///
/// # Errors
/// An error of the operating system.
pub fn write_run(run: &SimulatedRun, remark: &str, folder: &Folder, name: &str) -> Result<Written, Finding> {
    let mut file = folder.create(name)?;
    let failed = |e: std::io::Error| Finding::io(&folder.path().join(name), "write", &e);
    let mut vectors = 0;
    let mut write = || -> std::io::Result<()> {
        let decimals = Decimals { reading: run.decimals(), ..Decimals::default() };
        let mut writer = Writer::new(&mut file, &run.header, decimals)?;
        writer.remark(remark)?;
        if run.scalar.is_empty() {
            writer.fields(&run.settings)?;
        } else {
            writer.scalar(&run.scalar)?;
        }
        for (section, table) in [(Section::Temperatures, &run.temperatures), (Section::Channels, &run.channels)] {
            if !table.names.is_empty() {
                writer.slow(section, table)?;
            }
        }
        if run.scalar.is_empty() {
            writer.vectors(run.vectors().inspect(|_| vectors += 1))?;
        }
        writer.end()?.flush()
    };
    write().map_err(failed)?;
    let size_bytes = file.finish()?;
    Ok(Written { path: name.to_owned(), vectors, size_bytes })
}
