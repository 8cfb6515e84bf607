//! `calfit null`: offset drift, noise and correlations of every zero-field run.

use super::options::Excluding;
use super::output::Terminal;
use super::{Common, Status, each};
use crate::data::error::Finding;
use crate::measure::null::Options;
use crate::workflow::{known, sensitivities};
use clap::Args;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder, or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Order of the drift in time, 0 to 3.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u8).range(0..=3))]
    order: u8,
    /// Linear calibration of the same sensor and mode: its sensitivities give reading, drift and noise in nT as well.
    #[arg(long, value_name = "FILE")]
    cpf: Option<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: its effects are taken off the samples.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.results.places(arguments.cpf.iter().chain(&arguments.model));
    let options = Options {
        order: usize::from(arguments.order),
        cpf: sensitivities(arguments.cpf.as_ref())?,
        model: known(arguments.model.as_ref())?,
    };
    each::run(&options, &arguments.paths, &arguments.excluding, common, terminal)
}
