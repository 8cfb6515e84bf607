//! What a report tells on the terminal and as JSON.

use super::super::output::json;
use super::super::{Common, Status};
use super::{FILES, Work};
use crate::data::error::Finding;
use crate::data::run_state::{Outcome, RunCounts};
use crate::show;
use crate::show::protocol::RunPart;
use crate::workflow::{CentreMade, Failure, Measured, ThermalShown};
use serde::Serialize;
use serde_json::{Map, Value};
use std::path::Path;

/// What a report tells.
pub(super) struct Told<'a> {
    pub runs: Vec<RunTold>,
    pub thermal: &'a [ThermalShown],
    pub centres: &'a [CentreMade],
    pub ground: Vec<String>,
    pub coil: Vec<String>,
    pub thermistors: Vec<String>,
    /// Files of other commands that were made again, because what they rest on has changed.
    pub renewed: Vec<String>,
}

/// A run as `--json` prints it.
#[derive(Serialize)]
pub(super) struct RunTold {
    run: String,
    file: String,
    #[serde(flatten)]
    outcome: Outcome,
}

impl From<&RunPart<'_>> for RunTold {
    fn from(part: &RunPart) -> Self {
        Self { run: part.id.clone(), file: part.file.clone(), outcome: part.outcome.clone() }
    }
}

/// A run with what its analysis gave.
#[derive(Serialize)]
struct RunView<'a> {
    #[serde(flatten)]
    told: &'a RunTold,
    /// The result as the command of the analysis prints it, with its provenance.
    #[serde(skip_serializing_if = "Option::is_none")]
    result: Option<Value>,
}

/// What `--json` prints.
#[derive(Serialize)]
struct Listing<'a, G, C> {
    counts: RunCounts,
    runs: Vec<RunView<'a>>,
    thermal: Vec<G>,
    #[serde(skip_serializing_if = "Vec::is_empty")]
    centre: Vec<C>,
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    ground: &'a [String],
    coil: &'a [String],
    thermistors: &'a [String],
    /// The parameter files of coil system and thermistors, with their provenance, by name.
    #[serde(skip_serializing_if = "Map::is_empty")]
    other: Map<String, Value>,
    #[serde(skip_serializing_if = "<[String]>::is_empty")]
    renewed: &'a [String],
    protocol: [&'static str; 2],
    failed: Vec<&'a Finding>,
}

impl Told<'_> {
    /// Prints what was made, then the errors; the exit status.
    pub fn tell(&self, measured: &[Measured], work: &Work, common: &Common) -> Result<Status, Finding> {
        let counts: RunCounts = self.runs.iter().map(|run| run.outcome.state).collect();
        let of_runs = work.refused.iter().map(|one| &one.failure);
        let failures: Vec<&Failure> = of_runs.chain(work.failures.iter().map(|(_, failure)| failure)).collect();
        if common.json {
            let failed = failures.iter().flat_map(|f| f.errors()).collect();
            let result = |told: &RunTold| {
                let made = measured.iter().find(|one| one.run().is_some_and(|run| run.input.path == told.file))?.made()?;
                (told.outcome == Outcome::done()).then(|| made.view())
            };
            let runs = self.runs.iter().map(|told| Ok(RunView { told, result: result(told).transpose()? }));
            work.terminal.print(&json(&Listing {
                counts,
                runs: runs.collect::<Result<_, Finding>>()?,
                thermal: self.thermal.iter().map(ThermalShown::view).collect(),
                centre: self.centres.iter().map(CentreMade::view).collect(),
                ground: &self.ground,
                coil: &self.coil,
                thermistors: &self.thermistors,
                other: self
                    .coil
                    .iter()
                    .chain(&self.thermistors)
                    .map(|name| of_file(&common.out, name))
                    .collect::<Result<_, Finding>>()?,
                renewed: &self.renewed,
                protocol: FILES,
                failed,
            })?);
        } else {
            self.print(&counts, work, common);
        }
        failures.iter().flat_map(|f| f.errors()).for_each(|f| work.terminal.finding(f));
        let refused: Vec<&str> = work.refused.iter().map(|one| one.file.as_str()).collect();
        if !refused.is_empty() {
            work.terminal.error(&format!("{} of {} refused: {}", counts.refused, runs(counts.runs), refused.join(", ")));
        }
        let partial = if measured.iter().any(Measured::is_partial) { Status::Partly } else { Status::Done };
        Ok(super::super::status(counts.done, failures).max(partial))
    }

    fn print(&self, counts: &RunCounts, work: &Work, common: &Common) {
        let tell = |text: &str| work.terminal.tell(text);
        work.excluded.iter().for_each(|one| tell(&one.told()));
        self.thermal.iter().for_each(|one| tell(&show::thermal::summary(&one.thermal)));
        self.centres.iter().for_each(|made| tell(&show::centre::summary(&made.result)));
        self.renewed.iter().for_each(|path| tell(&format!("{path}  made again, since what it rests on has changed\n")));
        let analyses = match self.thermal.len() {
            0 => "no thermal analysis".to_owned(),
            1 => "1 thermal analysis".to_owned(),
            n => format!("{n} thermal analyses"),
        };
        tell(&format!("{counts}; {analyses}\n  -> {}\n", common.out.join(FILES[1]).display()));
    }
}

/// A parameter file that was written, as JSON.
fn of_file(folder: &Path, name: &str) -> Result<(String, Value), Finding> {
    let path = folder.join(name);
    let text = std::fs::read_to_string(&path).map_err(|e| Finding::io(&path, "read", &e))?;
    let value =
        toml_edit::de::from_str(&text).map_err(|e| Finding::error(&path.display().to_string(), e.to_string(), "report this"))?;
    Ok((name.to_owned(), value))
}

fn runs(count: usize) -> String {
    if count == 1 { "1 run".to_owned() } else { format!("{count} runs") }
}
