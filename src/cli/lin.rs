//! `calfit lin`: the linear calibration of every linearity run.

use super::options::Cut;
use super::output::Terminal;
use super::{Allow, Common, Status, each};
use crate::analysis::lin::Options;
use crate::error::Finding;
use crate::workflow::facility;
use clap::Args;
use std::path::PathBuf;

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Campaign folders or run files.
    #[arg(required = true, value_name = "PATH")]
    paths: Vec<PathBuf>,
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
    #[command(flatten)]
    cut: Cut,
}

fn axis_limit(text: &str) -> Result<(usize, f64), String> {
    let (axis, limit) = text.split_once('=').ok_or("write AXIS=NT, x=1900 for example")?;
    let axis = ["x", "y", "z"].iter().position(|a| a.eq_ignore_ascii_case(axis)).ok_or("the axis is x, y or z")?;
    let limit: f64 = limit.parse().map_err(|_| "the limit is a number of nT")?;
    if limit.is_finite() && limit > 0.0 { Ok((axis, limit)) } else { Err("the limit is a positive number of nT".to_owned()) }
}

impl FitOptions {
    pub(super) fn options(&self, common: &Common) -> Result<Options, Finding> {
        let mut max_field_nt = [None; 3];
        for (axis, limit) in &self.max_field {
            max_field_nt[*axis] = Some(*limit);
        }
        Ok(Options {
            trend_order: self.order.map(usize::from),
            max_field_nt,
            robust: self.robust,
            settling: self.cut.settling,
            least_coverage: self.cut.coverage,
            allow_gain: common.allows(Allow::Gain),
            allow_mismatch: common.allows(Allow::Mismatch),
            facility: facility(self.facility.as_ref())?,
        })
    }
}

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    each::run(&arguments.fit.options(common)?, &arguments.paths, common, terminal)
}
