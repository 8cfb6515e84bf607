//! Options that several commands share, and their values.

use crate::data::error::Finding;
use crate::data::plateau::{LEAST_COVERAGE, Settling};
use crate::data::provenance::Input;
use crate::files::parameter::{self, Cpf};
use clap::Args;
use std::path::PathBuf;

/// Which part of a plateau is used.
#[derive(Args, Clone, Debug)]
pub(super) struct Cut {
    /// Time to leave out after every step, s, or `auto` to find it in the data.
    #[arg(long, value_name = "S", default_value = "auto", value_parser = settling)]
    pub settling: Settling,
    /// Least part of a plateau's samples that must be there.
    #[arg(long, value_name = "PART", default_value_t = LEAST_COVERAGE, value_parser = part)]
    pub coverage: f64,
}

/// Reads the linear calibration of `--cpf`, whose sensitivities give nT.
pub(super) fn sensitivities(path: Option<&PathBuf>) -> Result<Option<(Input, Box<Cpf>)>, Finding> {
    let Some(path) = path else { return Ok(None) };
    let file = parameter::read::<Cpf>(path)?;
    Ok(Some((file.input, Box::new(file.body))))
}

pub(super) fn settling(text: &str) -> Result<Settling, String> {
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
