//! `calfit import`: tables of any laboratory to runs.

use super::output::{Terminal, json};
use super::{Allow, Common, Status};
use crate::data::error::Finding;
use crate::workflow::{Import, ImportedRun};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};

#[derive(Args, Debug)]
#[command(after_help = "Examples:
  calfit import --guess lab.csv > lab.toml
  calfit import lab.toml lab.csv -o campaign
  calfit lin campaign

A mapping for a CSV file with `;`, decimal comma, and the field beside every reading:

  [file]
  separator = \";\"
  decimal = \",\"
  [run]
  kind = \"linearity\"
  sensor = \"FM 1\"
  mode = \"science\"
  unit = \"nT\"
  [time]
  column = \"time\"
  format = \"iso8601\"
  [reading]
  columns = [\"mx\", \"my\", \"mz\"]
  [field]
  columns = [\"bx\", \"by\", \"bz\"]
  unit = \"nT\"
  [temperature]
  T59 = \"t_sensor\"

Exit status: 0 done, 1 some tables were refused, 2 wrong usage, an unusable mapping, or no table that could be used.")]
pub(super) struct Arguments {
    /// The mapping (TOML), then tables: CSV, Parquet, Arrow IPC. With --guess one table and no mapping.
    #[arg(required = true, value_name = "FILE")]
    files: Vec<PathBuf>,
    /// Print a mapping for a table on standard output, with reasons and what is to be checked.
    #[arg(long)]
    guess: bool,
}

#[derive(Serialize)]
struct Listing<'a> {
    runs: &'a [ImportedRun],
    failed: &'a [Finding],
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let refuse = |rule: &str, remedy: &str| Err(Finding::error("calfit import", rule, remedy));
    let Some((mapping, tables)) = arguments.files.split_first() else {
        return refuse("no file was named", "name a mapping and tables");
    };
    if arguments.guess {
        if !tables.is_empty() {
            return refuse("--guess takes one table", "name a single table");
        }
        return guess(mapping, common, terminal);
    }
    if tables.is_empty() {
        return refuse(
            "no table was named beside the mapping",
            "calfit import MAPPING.toml TABLE... -o CAMPAIGN; `calfit import --guess TABLE` proposes a mapping",
        );
    }
    if !common.out_given {
        return refuse("no campaign folder was named", "name it with -o CAMPAIGN");
    }
    common.must_hold_no_results()?;
    let mut findings = Vec::new();
    let import = Import::open(mapping, &common.out, common.force, common.allows(Allow::Mismatch), &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let import = import?;
    let (mut runs, mut failed) = (Vec::new(), Vec::new());
    let bar = terminal.progress(tables.len(), "imported");
    for table in tables {
        let mut findings = Vec::new();
        let made = bar.of(&table.display().to_string(), || import.table(table, &mut findings));
        findings.iter().for_each(|f| terminal.finding(f));
        match made {
            Ok(made) => runs.extend(made),
            Err(finding) => {
                terminal.finding(&finding);
                failed.push(finding);
            }
        }
    }
    bar.finish();
    let begun = import.begin_campaign(&runs)?;
    if common.json {
        terminal.print(&json(&Listing { runs: &runs, failed: &failed })?);
    } else {
        tell(&runs, common, begun, terminal);
    }
    Ok(match (runs.is_empty(), failed.is_empty()) {
        (_, true) => Status::Done,
        (false, false) => Status::Partly,
        (true, false) => Status::Unusable,
    })
}

fn tell(runs: &[ImportedRun], common: &Common, begun: bool, terminal: &Terminal) {
    for run in runs {
        let rows = if run.samples > 0 {
            format!("{} settings, {} samples at {} Hz, {} lost", run.settings, run.samples, run.sample_rate_hz, run.lost)
        } else {
            format!("{} plateau means", run.settings)
        };
        terminal.tell(&format!("{}\n  {rows}\n  -> {}\n", run.table, common.out.join(&run.path).display()));
    }
    if begun {
        let path = common.out.join("campaign.toml");
        terminal.tell(&format!("  -> {}, begun; see that the axes of the sensor and the channels are right\n", path.display()));
    }
}

/// A proposal as `--json` prints it.
#[derive(Serialize)]
struct Proposal<'a> {
    table: String,
    /// The mapping, as TOML.
    mapping: &'a str,
}

fn guess(table: &Path, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let mapping = crate::files::import::guess(table)?;
    if common.json {
        terminal.print(&json(&Proposal { table: table.display().to_string(), mapping: &mapping })?);
    } else {
        terminal.print(&mapping);
    }
    Ok(Status::Done)
}
