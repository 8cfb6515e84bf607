//! Options that several commands share, and their values.

use super::output::Terminal;
use super::{Allow, Common};
use crate::data::error::Finding;
use crate::data::exclusion::{ExcludedPart, Exclusion};
use crate::data::plateau::{self, LEAST_COVERAGE, Settling};
use crate::data::run::Header;
use crate::data::run_state::{Outcome, RunState};
use crate::data::thermistor::HIGHEST_ORDER;
use crate::files::campaign::{Campaign, RunFile};
use crate::files::ccr;
use crate::measure::sweep::{self, LagChoice, Window};
use crate::model::campaign::{MOST_THERMAL_ORDER, THERMAL_QUANTITIES};
use crate::workflow::{Job, Results, ThermalOptions, known, linearisation};
use clap::Args;
use serde::Serialize;
use std::path::PathBuf;

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

/// What turns settings into fields, and what is taken off the readings.
#[derive(Args, Clone, Debug)]
pub(super) struct Corrections {
    /// Facility (COIL_SCALAR, COIL_TILT, or keys scale_nt_per_eu, offset_nt, angles_deg) that turns settings into the reference
    /// field, in place of the settings themselves.
    #[arg(long, value_name = "FILE")]
    pub facility: Option<PathBuf>,
    /// Model file of `calfit diagnose --write-model`: its effects are taken off the readings of linearity runs and sweeps and off sines,
    /// those that are functions of the reading off offset runs, those of zero field off the samples of zero-field runs.
    #[arg(long, value_name = "FILE")]
    pub model: Option<PathBuf>,
}

/// How linearity runs are fitted, wherever they are.
#[derive(Args, Clone, Debug)]
pub(super) struct Linear {
    /// Leave out fields beyond this limit along a nominal sensor axis, x=1900 for example; replaces the limit of campaign.toml.
    #[arg(long, value_name = "AXIS=NT", value_parser = axis_limit)]
    pub max_field: Vec<(usize, f64)>,
    /// Give outlying plateaus less weight (Huber).
    #[arg(long)]
    pub robust: bool,
    /// Linearise the readings with the polynomials of a LINEARISATION file.
    #[arg(long, value_name = "FILE")]
    pub linearisation: Option<PathBuf>,
}

impl Linear {
    /// The limits of the axes.
    pub fn max_field_nt(&self) -> [Option<f64>; 3] {
        let mut limits = [None; 3];
        for (axis, limit) in &self.max_field {
            limits[*axis] = Some(*limit);
        }
        limits
    }
}

/// Finding the linearisation itself, which is no part of a robust fit or of one with a given linearisation.
#[derive(Args, Clone, Debug)]
pub(super) struct Linearise {
    /// Find the polynomial of third order per sensor axis that all runs of a sensor and mode share, and fit every run with it:
    /// the non-linearity of the readings → LINEARISATION.
    #[arg(long, conflicts_with_all = ["robust", "linearisation"])]
    pub linearise: bool,
}

/// How the runs of a campaign are analysed on the way to what is made of several.
#[derive(Args, Clone, Debug)]
pub(super) struct Runs {
    /// N: order of the offset trend of linearity runs, 0 to 2. null=N: of the drift of zero-field runs, 0 to 3. QUANTITY=N: of the polynomial
    /// of a quantity or family, sigma=1, b_or_x=3, f_3db=2, f_3db_igep=1 for example; others are chosen by AICc and leave-one-out error, in
    /// a sweep one above what AICc prefers.
    #[arg(long, value_name = "N|null=N|QUANTITY=N", value_parser = order)]
    pub order: Vec<Order>,
    #[command(flatten)]
    pub linear: Linear,
    #[command(flatten)]
    pub corrections: Corrections,
    #[command(flatten)]
    pub cut: Cut,
}

/// A value of `--order` where runs of several kinds are analysed.
#[derive(Clone, Debug)]
pub(super) enum Order {
    /// Of the offset trend.
    Trend(usize),
    /// Of the drift of zero-field runs.
    Drift(usize),
    /// Of the polynomial of a quantity.
    Quantity(String, usize),
}

impl Runs {
    /// The files that the options name.
    pub fn files(&self) -> impl Iterator<Item = &PathBuf> {
        self.corrections.facility.iter().chain(&self.corrections.model).chain(&self.linear.linearisation)
    }

    /// How the runs are analysed and compared across temperatures.
    pub fn options(&self, joint: bool, common: &Common, terminal: &Terminal) -> Result<ThermalOptions, Finding> {
        let mut options = ThermalOptions {
            joint,
            max_field_nt: self.linear.max_field_nt(),
            robust: self.linear.robust,
            cut: self.cut.into(),
            allow_gain: common.allows(Allow::Gain),
            allow_mismatch: common.allows(Allow::Mismatch),
            facility: terminal.facility(self.corrections.facility.as_ref())?,
            linearisation: linearisation(self.linear.linearisation.as_ref())?,
            model: known(self.corrections.model.as_ref())?,
            ..ThermalOptions::default()
        };
        for order in &self.order {
            match order {
                Order::Trend(order) => options.trend_order = Some(*order),
                Order::Drift(order) => options.drift_order = Some(*order),
                Order::Quantity(name, order) => options.orders.push((name.clone(), *order)),
            }
        }
        Ok(options)
    }
}

/// A value of `--order`.
fn order(text: &str) -> Result<Order, ValueError> {
    let Some((name, number)) = text.split_once('=') else {
        return match text.parse::<usize>() {
            Ok(order) if order <= MOST_TREND_ORDER => Ok(Order::Trend(order)),
            _ => Err(ValueError::Order),
        };
    };
    let order = number.parse::<usize>().map_err(|_| ValueError::OrderNumber)?;
    match name {
        "null" if order <= MOST_DRIFT_ORDER => Ok(Order::Drift(order)),
        "null" => Err(ValueError::DriftOrder),
        quantity if !THERMAL_QUANTITIES.contains(&quantity) => Err(ValueError::OrderQuantity),
        _ if order > MOST_THERMAL_ORDER as usize => Err(ValueError::OrderNumber),
        quantity => Ok(Order::Quantity(quantity.to_owned(), order)),
    }
}

/// Highest order of the offset trend of a linearity run, and of the drift of a zero-field run.
const MOST_TREND_ORDER: usize = 2;
const MOST_DRIFT_ORDER: usize = 3;

/// The forms of `--lag`.
const LAG: &str = "auto|none|SECONDS|first-order=SECONDS|inverse=SECONDS";

/// How continuous sweeps are analysed.
#[derive(Args, Clone, Debug)]
pub(super) struct Sweeping {
    /// Sliding window of a continuous sweep: a number of settings, or of minutes (`12min`).
    #[arg(long, value_name = "N", default_value = "18", value_parser = window)]
    pub window: Window,
    /// Leave out settings of a continuous sweep at which the temperature moves faster, K/min.
    #[arg(long, value_name = "K_PER_MIN", value_parser = rate)]
    pub max_rate: Option<f64>,
    /// Lag of the sensor behind the thermistor of a continuous sweep: `auto` finds one that is significant beside polynomials of one order
    /// higher, `none` takes none; SECONDS of a delay, negative where the sensor is earlier; a time constant with which the sensor follows the
    /// thermistor (`first-order=480`) or the thermistor the sensor (`inverse=480`).
    #[arg(long, value_name = LAG, default_value = "auto", allow_negative_numbers = true, value_parser = lag)]
    pub lag: LagChoice,
}

impl Sweeping {
    /// What only sweeps have.
    pub fn options(&self) -> sweep::Options {
        sweep::Options { window: self.window, most_k_per_min: self.max_rate, lag: self.lag, ..sweep::Options::default() }
    }
}

fn window(text: &str) -> Result<Window, ValueError> {
    let minutes = text.strip_suffix("min").map(|number| number.trim().parse::<f64>());
    match (minutes, text.parse::<usize>()) {
        (Some(Ok(minutes)), _) if minutes.is_finite() && minutes > 0.0 => Ok(Window::Minutes(minutes)),
        (None, Ok(settings)) if settings > 4 => Ok(Window::Settings(settings)),
        _ => Err(ValueError::Window),
    }
}

fn lag(text: &str) -> Result<LagChoice, ValueError> {
    text.parse().map_err(|_| ValueError::Lag)
}

fn rate(text: &str) -> Result<f64, ValueError> {
    text.parse::<f64>().ok().filter(|r| r.is_finite() && *r > 0.0).ok_or(ValueError::Rate)
}

fn axis_limit(text: &str) -> Result<(usize, f64), ValueError> {
    let (axis, limit) = text.split_once('=').ok_or(ValueError::Limit)?;
    let axis = ["x", "y", "z"].iter().position(|a| a.eq_ignore_ascii_case(axis)).ok_or(ValueError::LimitAxis)?;
    let limit: f64 = limit.parse().map_err(|_| ValueError::LimitNumber)?;
    if limit.is_finite() && limit > 0.0 { Ok((axis, limit)) } else { Err(ValueError::LimitSign) }
}

/// Refuses the first of some options that was given where it would change nothing.
///
/// # Errors
/// That option with the rule and the remedy.
pub(super) fn refuse_given(options: &[(&str, bool)], rule: &str, remedy: &str) -> Result<(), Finding> {
    match options.iter().find(|(_, is_given)| *is_given) {
        Some((option, _)) => Err(Finding::error(option, rule, remedy)),
        None => Ok(()),
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

impl Excluding {
    /// Refuses what would leave out nothing: the data that a slip in a name or number leaves in are worse than no result.
    ///
    /// # Errors
    /// The first run that is none of the campaigns, setting that is none of its run, or stretch without any of it.
    pub fn check(&self, campaigns: &[Campaign]) -> Result<(), Finding> {
        for exclusion in &self.exclude {
            let option = format!("--exclude {exclusion}");
            let files = campaigns.iter().flat_map(|c| &c.runs);
            let is_of = |file: &&RunFile| match ccr::peek(&file.path) {
                Ok(header) => header.run == exclusion.run,
                Err(_) => RunFile::id(&file.recorded) == exclusion.run,
            };
            let Some(file) = files.into_iter().find(is_of) else {
                let rule = format!("would leave out nothing: there is no run {}", exclusion.run);
                return Err(Finding::error(&option, rule, "correct the run's id; `calfit inspect` lists the runs"));
            };
            if exclusion.part == ExcludedPart::Run {
                continue;
            }
            // What is wrong with a file that cannot be read is told where it is analysed.
            let reading = ccr::Options { allow_truncated: true, allow_duplicates: true, ..ccr::Options::default() };
            let Ok(run) = ccr::read(&file.path, &reading, &mut ()) else { continue };
            if let Some(rule) = exclusion.misses(&run) {
                return Err(Finding::error(
                    &option,
                    format!("would leave out nothing: {rule}"),
                    "correct the number or the times",
                ));
            }
        }
        Ok(())
    }
}

/// A run that is left out by hand.
#[derive(Serialize)]
pub(super) struct Excluded {
    /// Run id.
    pub run: String,
    /// Why.
    pub reason: String,
    /// File inside the campaign.
    #[serde(skip)]
    pub file: String,
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
            let (file, header) = (job.recorded.clone(), job.header.clone());
            excluded.push(Excluded { run: job.id(), reason: reason.clone(), file, header });
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
    #[error(
        "write N from 0 to {MOST_TREND_ORDER} for the offset trend, null=N for the drift, or QUANTITY=N, sigma=1 for example"
    )]
    Order,
    #[error("the order of a drift is a number from 0 to {MOST_DRIFT_ORDER}")]
    DriftOrder,
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
