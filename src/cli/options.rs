//! Options that several commands share, and their values.

use crate::data::exclusion::Exclusion;
use crate::data::plateau::{self, LEAST_COVERAGE, Settling};
use crate::data::run::Header;
use crate::data::run_state::{Outcome, RunState};
use crate::data::thermistor::HIGHEST_ORDER;
use crate::model::campaign::{MOST_THERMAL_ORDER, THERMAL_QUANTITIES};
use crate::workflow::{Job, Results};
use clap::Args;
use serde::Serialize;

/// Which part of a plateau is used.
#[derive(Args, Clone, Copy, Debug)]
pub(super) struct Cut {
    /// Time to leave out after every step, s, or `auto` to find it in the data.
    #[arg(long, value_name = "S", default_value = "auto", value_parser = settling)]
    pub settling: Settling,
    /// Least part of a plateau's samples that must be there.
    #[arg(long, value_name = "PART", default_value_t = LEAST_COVERAGE, value_parser = part)]
    pub coverage: f64,
}

impl From<Cut> for plateau::Cut {
    fn from(cut: Cut) -> Self {
        Self { settling: cut.settling, least_coverage: cut.coverage }
    }
}

/// What is left out by hand.
#[derive(Args, Clone, Debug, Default)]
pub(super) struct Excluding {
    /// Leave out a run, a setting of it by its number from 1, or a stretch in seconds since its start, and say why: the reason stands in
    /// the results. Repeatable; `[[exclude]]` of campaign.toml says the same.
    #[arg(long, value_name = "RUN[#SETTING|:FROM-UNTIL]=REASON")]
    pub exclude: Vec<Exclusion>,
}

/// A run that is left out by hand.
#[derive(Serialize)]
pub(super) struct Excluded {
    /// Run id.
    pub run: String,
    /// Why.
    pub reason: String,
    /// What its file says at its head, if that can be read.
    #[serde(skip)]
    pub header: Option<Header>,
}

impl Excluded {
    /// A line for the terminal.
    pub fn told(&self) -> String {
        format!("{}: left out by hand: {}\n", self.run, self.reason)
    }
}

/// The runs that are to be analysed, and those that are left out by hand, which the index of the results names.
pub(super) fn without_excluded<'a>(jobs: Vec<Job<'a>>, results: &Results) -> (Vec<Job<'a>>, Vec<Excluded>) {
    let mut excluded = Vec::new();
    let stays = |job: &Job| match &job.excluded {
        Some(reason) => {
            results.outcome(&job.recorded, Outcome::new(RunState::Excluded, reason.clone()));
            excluded.push(Excluded { run: job.id(), reason: reason.clone(), header: job.header.clone() });
            false
        }
        None => true,
    };
    let jobs = jobs.into_iter().filter(stays).collect();
    (jobs, excluded)
}

/// Why the value of an option is refused: what to write in its place.
#[derive(Clone, Copy, Debug, thiserror::Error)]
pub(super) enum ValueError {
    #[error("write a number of seconds, 0 or more, or `auto`")]
    Settling,
    #[error("write a number from 0 to 1")]
    Part,
    #[error("write AXIS=NT, x=1900 for example")]
    Limit,
    #[error("the axis is x, y or z")]
    LimitAxis,
    #[error("the limit is a number of nT")]
    LimitNumber,
    #[error("the limit is a positive number of nT")]
    LimitSign,
    #[error("write QUANTITY=N, sigma=1 for example")]
    Order,
    #[error("the quantity is one of {}", THERMAL_QUANTITIES.join(", "))]
    OrderQuantity,
    #[error("the order is a number from 0 to {MOST_THERMAL_ORDER}")]
    OrderNumber,
    #[error("write a number of settings above 4, or of minutes, 12min for example")]
    Window,
    #[error("write auto, none, a number of seconds, or first-order=SECONDS or inverse=SECONDS with a positive number")]
    Lag,
    #[error("write a positive number of K/min")]
    Rate,
    #[error("write 2 to {} numbers with commas between them", HIGHEST_ORDER + 1)]
    Coefficients,
    #[error("write V,OHM, 2.5,1000 for example")]
    Divider,
    #[error("write a positive number")]
    Positive,
}

pub(super) fn settling(text: &str) -> Result<Settling, ValueError> {
    if text == "auto" {
        return Ok(Settling::Found);
    }
    match text.parse::<f64>() {
        Ok(s) if s.is_finite() && s >= 0.0 => Ok(Settling::Given(s)),
        _ => Err(ValueError::Settling),
    }
}

fn part(text: &str) -> Result<f64, ValueError> {
    match text.parse::<f64>() {
        Ok(p) if (0.0..=1.0).contains(&p) => Ok(p),
        _ => Err(ValueError::Part),
    }
}
