//! `calfit offset`: sensor offset and residual field of every offset run.

use super::options::{Cut, Excluding};
use super::output::Terminal;
use super::{Allow, Common, Status, each};
use crate::data::error::Finding;
use crate::measure::offset::Options;
use crate::workflow::{known, sensitivities};
use clap::Args;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// A campaign folder, or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
    /// Linear calibration of the same sensor and mode: its sensitivities give the offsets in nT as well.
    #[arg(long, value_name = "FILE")]
    cpf: Option<PathBuf>,
    /// Facility whose scale factors and angles turn settings into applied fields; its offset field is part of what is measured here.
    #[arg(long, value_name = "FILE")]
    facility: Option<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: those of its effects that are functions of the reading are taken off.
    #[arg(long, value_name = "FILE")]
    model: Option<PathBuf>,
    #[command(flatten)]
    excluding: Excluding,
    #[command(flatten)]
    cut: Cut,
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    common.results.places(arguments.cpf.iter().chain(&arguments.facility).chain(&arguments.model));
    let options = Options {
        cut: arguments.cut.into(),
        allow_mismatch: common.allows(Allow::Mismatch),
        cpf: sensitivities(arguments.cpf.as_ref())?,
        facility: terminal.facility(arguments.facility.as_ref())?,
        model: known(arguments.model.as_ref())?,
    };
    each::run(&options, &arguments.paths, &arguments.excluding, common, terminal)
}
