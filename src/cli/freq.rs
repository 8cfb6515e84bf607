//! `calfit freq`: sampling frequency and frequency response of every frequency run.

use super::options::{Excluding, settling};
use super::output::Terminal;
use super::{Allow, Common, Status, each};
use crate::data::error::Finding;
use crate::data::plateau::Settling;
use crate::files::parameter::Body;
use crate::measure::freq::Options;
use crate::workflow::{Failure, RunResult, known, of_table, publish};
use clap::Args;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder, or run files.
    #[arg(required_unless_present = "amplitudes", value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// A table of amplitudes in place of runs: frequency_hz,bx_ent,by_ent,bz_ent. Its name without freq_ is the run id.
    #[arg(long, value_name = "TABLE.csv", conflicts_with_all = ["paths", "exclude"])]
    amplitudes: Vec<PathBuf>,
    /// Time to leave out after every change of frequency, s, or `auto`.
    #[arg(long, value_name = "S", default_value = "auto", value_parser = settling)]
    settling: Settling,
    /// Model file of `calfit diagnose --write-model`: its effects are taken off the sines before the response is fitted.
    #[arg(long, value_name = "FILE", conflicts_with = "amplitudes")]
    model: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.results.accept_tables(&arguments.amplitudes)?;
    common.results.places(&arguments.model);
    let options =
        Options { settling: arguments.settling, allow_gain: common.allows(Allow::Gain), model: known(arguments.model.as_ref())? };
    if arguments.amplitudes.is_empty() {
        return each::run(&options, &arguments.paths, &arguments.excluding, common, terminal);
    }
    let desk = common.desk();
    let mut results = Vec::new();
    let mut seen: Vec<String> = Vec::new();
    for path in &arguments.amplitudes {
        let mut findings = Vec::new();
        let made = of_table(path, &mut findings).map_err(|f| Failure::Unreadable(vec![f])).and_then(|made| {
            let id = made.result.head().id.clone();
            if seen.contains(&id) {
                let shown = path.display().to_string();
                let rule = format!("gives the run id {id}, as an earlier table does");
                return Err(Failure::Refused(Finding::error(&shown, rule, "rename one of the two")));
            }
            seen.push(id);
            publish::<Options>(&made, &desk, &made.result.parameters().file_name()).map_err(Failure::Refused)?;
            Ok(made)
        });
        findings.iter().for_each(|f| terminal.finding(f));
        results.push((path.display().to_string(), made));
    }
    each::finish::<Options>(each::Results { of_runs: results, excluded: Vec::new() }, &[], common, terminal)
}
