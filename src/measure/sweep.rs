//! Fields of constant modulus and random direction while the temperature moves (CH-GFZ-TR-2601 section 8; mathematics.md section 4).
//!
//! The nine parameters are followed by a sliding window of settings, and fitted as polynomials of the temperature to all settings at
//! once: `B_r = A(T) B_c + B_or(T)`, the elements of `A` and `B_or` polynomials of the temperature at each setting, which is linear. Sensitivities and angles
//! follow from `A` at as many temperatures as their polynomials have coefficients.
//!
//! A thermistor shows the temperature of the part that matters earlier or later. The heating and the cooling branch then split; the lag is the one
//! that makes them one: either a delay, or the time constant of a body that is heated through its surface (first order).

use super::lin::{apply_limits, the_position};
use super::structure;
use super::thermal::{QuantityFit, band};
use crate::data::across::{LagForm, RunRotations, ThermistorLag};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{LEAST_COVERAGE, Plateau, Plateaus, Settling};
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run, interpolate};
use crate::fit::order::Reason;
use crate::fit::smooth::Course;
use crate::fit::statistics::extremes;
use crate::fit::{FitError, Limits, NORMAL_95, aicc, propagate};
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::model::facility::{Facility, FacilityApplied};
use crate::model::lag::{self, Lag};
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::{Linear, Split, split};
use crate::record::baseline::Baseline;
use crate::record::conditions::{self, Temperatures};
use crate::record::known::{self, Known};
use nalgebra::{DMatrix, Matrix3};
use serde::Serialize;
use std::fmt;
use thiserror::Error;

/// Settings of a window where nothing else is said, as in 1998.
pub const WINDOW: usize = 18;
/// Orders that are tried where none is given.
const ORDERS: std::ops::RangeInclusive<usize> = 1..=3;
/// Longest lag that is looked for, s, and as a part of the sweep.
const MOST_LAG_S: f64 = 2400.0;
const MOST_LAG_PART: f64 = 0.125;
/// A lag below this many standard uncertainties is not significant.
const SIGNIFICANT: f64 = 4.0;
/// A thermistor must move by this much to tell anything, K.
const LEAST_RANGE_K: f64 = 5.0;
/// Half of the time over which the rate of a thermistor is taken, s.
const RATE_S: f64 = 300.0;
/// Largest condition number of a window.
const MOST_CONDITION: f64 = 1e4;

/// Length of the sliding window.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Window {
    /// So many settings.
    Settings(usize),
    /// Settings of so many minutes.
    Minutes(f64),
}

impl fmt::Display for Window {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Window::Settings(n) => write!(f, "{n} settings"),
            Window::Minutes(m) => write!(f, "{m} min"),
        }
    }
}

/// How a sweep is analysed.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Settling after a step.
    pub settling: Settling,
    /// Least part of the expected samples of a plateau.
    pub least_coverage: f64,
    /// Sliding window.
    pub window: Window,
    /// Settings at which the temperature moves faster are left out, K/min.
    pub most_k_per_min: Option<f64>,
    /// Orders of the polynomials of `sigma` (and `xi`) and of `b_or`, where given.
    pub orders: Vec<(String, usize)>,
    /// The facility that turns settings into the reference field; `None` takes the settings as the field.
    pub facility: Option<Facility>,
    /// Known effects, which are taken off the readings; a lag of the thermistor among them is used.
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            settling: Settling::Found,
            least_coverage: LEAST_COVERAGE,
            window: Window::Settings(WINDOW),
            most_k_per_min: None,
            orders: Vec::new(),
            facility: None,
            model: None,
        }
    }
}

/// Why a sweep has no result.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum SweepError {
    /// Not a sweep.
    #[error("the run is of kind {0}, not sweep")]
    Kind(Kind),
    /// Several positions or one without axes.
    #[error("{0}")]
    Position(String),
    /// No thermistor moves.
    #[error("no temperature channel moves by {LEAST_RANGE_K} K during the settings")]
    NoTemperature,
    /// Too few settings.
    #[error("{used} usable settings of {total} cannot determine {parameters} parameters per component")]
    TooFew {
        /// Usable settings.
        used: usize,
        /// All settings.
        total: usize,
        /// Parameters.
        parameters: usize,
    },
    /// The fit has no answer.
    #[error("the fit failed: {0}")]
    Fit(#[from] FitError),
    /// The response is none of a sensor.
    #[error("the response at {degc:.1} °C belongs to no sensor with three axes")]
    NoSensor {
        /// Temperature, °C.
        degc: f64,
    },
}

impl SweepError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            SweepError::Kind(_) => "use the command for that kind",
            SweepError::Position(_) => "sweep in one position, and name its axes in campaign.toml",
            SweepError::NoTemperature => "check the temperature channels of the run",
            SweepError::TooFew { .. } => "sweep longer, or with lower orders",
            SweepError::Fit(_) | SweepError::NoSensor { .. } => "check the directions of the fields and the readings",
        }
    }
}

/// Slope of the straight line through the readings around a time, K/s: how fast the temperature moves.
fn rate_k_per_s(series: &[(f64, f64)], t_s: f64) -> f64 {
    let from = series.partition_point(|(t, _)| *t < t_s - RATE_S);
    let to = series.partition_point(|(t, _)| *t <= t_s + RATE_S);
    let near = &series[from..to];
    let n = near.len() as f64;
    let (mt, mv) = near.iter().fold((0.0, 0.0), |(a, b), (t, v)| (a + t / n, b + v / n));
    let (tv, tt) = near.iter().fold((0.0, 0.0), |(a, b), (t, v)| (a + (t - mt) * (v - mv), b + (t - mt).powi(2)));
    if tt > 0.0 { tv / tt } else { 0.0 }
}

/// The parameters of one window.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct WindowFit {
    /// Middle, s since the run's start.
    pub t_s: f64,
    /// Mean reading of the thermistor that was used, without and with the lag, °C.
    pub temperature_degc: [f64; 2],
    /// The temperature rises.
    pub heating: bool,
    /// σ_x, σ_y, σ_z nT/enT; ξ_xy, ξ_xz, ξ_yz degrees; B_or of x, y, z enT.
    pub values: [f64; 9],
    /// Their standard uncertainties.
    pub std: [f64; 9],
    /// Standard deviation of applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
}

/// One setting in the light of the joint fit.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SweepBlock {
    /// Middle, s since the run's start.
    pub t_s: f64,
    /// Temperature with its lag, °C.
    pub temperature_degc: f64,
    /// Applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
}

/// A sweep with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Sweep {
    /// Run and conditions.
    pub run: RunHead,
    /// File of the run.
    pub file: String,
    /// Thermistor that the polynomials are of.
    pub channel: String,
    /// Lowest and highest temperature of the settings, with the lag, °C.
    pub valid_degc: [f64; 2],
    /// The nine polynomials, with the values of windows that share no settings beside them.
    pub quantities: Vec<QuantityFit>,
    /// Rotation of the sensor against its nominal orientation.
    pub rotation: RunRotations,
    /// Settings used, in the run, and left out because the temperature moved too fast.
    pub settings: SettingCounts,
    /// Sliding window.
    pub window: Window,
    /// Root mean square of applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
    /// How the sensor follows every thermistor that moves.
    pub lags: Vec<ThermistorLag>,
    /// The facility that turned settings into the reference field; absent if the settings were taken as the field.
    pub facility: Option<FacilityApplied>,
    /// The known effects that were taken off the readings; absent if none were.
    pub model: Option<ModelApplied>,
    /// What a person should know.
    pub notes: Vec<Note>,
    /// Sliding windows in time order.
    pub windows: Vec<WindowFit>,
    /// The settings that were used.
    pub blocks: Vec<SweepBlock>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
}

/// Numbers of settings of a sweep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SettingCounts {
    /// Used.
    pub used: usize,
    /// In the run.
    pub total: usize,
    /// Left out because the temperature moved too fast.
    pub too_fast: usize,
}

/// Names and units of the nine quantities.
const QUANTITIES: [(&str, &str, &str); 9] = [
    ("sigma_x", "x", "nT/enT"),
    ("sigma_y", "y", "nT/enT"),
    ("sigma_z", "z", "nT/enT"),
    ("xi_xy", "xy", "deg"),
    ("xi_xz", "xz", "deg"),
    ("xi_yz", "yz", "deg"),
    ("b_or_x", "x", "enT"),
    ("b_or_y", "y", "enT"),
    ("b_or_z", "z", "enT"),
];

/// Orders of the polynomials: of the response and of the offset.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Orders {
    response: usize,
    offset: usize,
}

impl Orders {
    fn count(self) -> usize {
        3 * (self.response + 1) + self.offset + 1
    }
}

/// The mean readings of the settings that are used, and their fields.
struct Means {
    fields_nt: Vec<[f64; 3]>,
    t_s: Vec<f64>,
    readings_ent: DMatrix<f64>,
}

impl Means {
    fn of(used: &[&Plateau]) -> Self {
        Self {
            fields_nt: used.iter().map(|p| p.setting.field.0).collect(),
            t_s: used.iter().map(|p| p.t_s()).collect(),
            readings_ent: DMatrix::from_fn(used.len(), 3, |row, i| used[row].mean.0[i]),
        }
    }

    fn baseline(&self, degc: &[f64], orders: Orders) -> Baseline {
        Baseline::in_temperature(degc, orders.response, orders.offset)
    }

    /// Minus twice the log likelihood of temperatures of the settings: components count by their own noise.
    fn deviance(&self, degc: &[f64], orders: Orders) -> f64 {
        let n = degc.len() as f64;
        let squares = self.baseline(degc, orders).squares_ent2(&self.fields_nt, degc, &self.readings_ent);
        squares.iter().map(|s| n * (s / n).ln()).sum()
    }

    /// Temperatures of the settings by a series, (s, °C).
    fn degc(&self, series: &[(f64, f64)]) -> Vec<f64> {
        self.t_s.iter().map(|t| interpolate(series, *t)).collect()
    }
}

/// One sweep.
///
/// # Errors
/// [`SweepError`]: the run is refused, with the reason and what to do.
pub fn sweep(run: &Run, plateaus: &Plateaus, instructions: &Instructions, options: &Options) -> Result<Sweep, SweepError> {
    if run.header.kind != Kind::Sweep {
        return Err(SweepError::Kind(run.header.kind));
    }
    let (_, position) = the_position(plateaus, instructions).map_err(|e| SweepError::Position(e.to_string()))?;
    let mut list = plateaus.list.clone();
    apply_limits(&mut list, position, &instructions.limits_nt(&run.header));
    let mut notes: Vec<Note> = Vec::new();
    let facility = options.facility.as_ref().map(|f| conditions::apply_facility(f, run, instructions, &mut list, &mut notes));
    let facility = facility.transpose().map_err(|e| SweepError::Position(e.to_string()))?;
    let model = options.model.as_ref().map(|m| known::apply(m, run, plateaus, &mut list, instructions, &mut notes));
    let used: Vec<&Plateau> = list.iter().filter(|p| p.dropped.is_none()).collect();
    let span_s = [used.first().map_or(0.0, |p| p.used_s[0]), used.last().map_or(0.0, |p| p.used_s[1])];
    let temperatures = Temperatures::of(run, instructions, span_s, &mut Vec::<Note>::new());
    let (own, coil) = instructions.channels(&run.header);
    let channels: Vec<(String, Vec<(f64, f64)>)> = run
        .temperatures
        .names
        .iter()
        .filter(|name| **name != coil)
        .filter_map(|name| Some((name.clone(), run.temperatures.channel(name)?)))
        .filter(|(_, series)| {
            let seen: Vec<f64> = used.iter().map(|p| interpolate(series, p.t_s())).collect();
            let [low, high] = extremes(seen.iter().copied());
            high - low > LEAST_RANGE_K
        })
        .collect();
    if channels.is_empty() {
        return Err(SweepError::NoTemperature);
    }
    let slow = |p: &&&Plateau| {
        let series = channels.iter().find(|(name, _)| *name == own).unwrap_or(&channels[0]);
        options.most_k_per_min.is_none_or(|most| 60.0 * rate_k_per_s(&series.1, p.t_s()).abs() <= most)
    };
    let used: Vec<&Plateau> = used.iter().filter(slow).copied().collect();
    let left_out = list.iter().filter(|p| p.dropped.is_none()).count() - used.len();
    // What the analyst asks for now goes before what the campaign says.
    let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
    let entries = instructions.thermal.iter();
    let entry = entries.filter(|e| applies(&e.sensor, &run.header.sensor) && applies(&e.mode, &run.header.mode));
    let asked: Vec<(String, usize)> = options
        .orders
        .iter()
        .cloned()
        .chain(entry.flat_map(|e| e.orders.iter().map(|(n, o)| (n.clone(), *o as usize))))
        .collect();
    let given = |name: &str| asked.iter().find(|(n, _)| n == name).map(|(_, order)| *order);
    let first = Orders { response: given("sigma").unwrap_or(2), offset: given("b_or").unwrap_or(2) };
    if used.len() < 2 * first.count() {
        return Err(SweepError::TooFew { used: used.len(), total: list.len(), parameters: first.count() });
    }

    let means = Means::of(&used);
    // Every thermistor with its best lag of both forms.
    let mut parts: Vec<ThermistorLag> = Vec::new();
    for (name, series) in &channels {
        parts.push(find_lag(name, series, &means, first));
    }
    let known_lag = options.model.as_ref().and_then(Known::thermal_lag);
    // The one the campaign names, or the one that the sensor follows best.
    let best = parts.iter().min_by(|a, b| a.residual_std_ent.total_cmp(&b.residual_std_ent)).map(|p| p.channel.clone());
    let named = parts.iter().any(|p| p.channel == own);
    let channel = if named { own.clone() } else { best.clone().unwrap_or_default() };
    if !named {
        let text = format!("the run has no moving channel {own}; {channel}, which the sensor follows best, is used");
        notes.push(Note::new(NoteKind::Temperature, text).about(&own));
    } else if best.as_ref() != Some(&channel) {
        let text = format!("the sensor follows {} better than {channel}", best.unwrap_or_default());
        notes.push(Note::new(NoteKind::Temperature, text).about(&channel));
    }
    let chosen = parts.iter().position(|p| p.channel == channel).unwrap_or_default();
    if known_lag.is_some() {
        parts[chosen].form = LagForm::OfTheModel;
    }
    let (part, series) = (&parts[chosen], &channels[chosen].1);
    let lag = match part.form {
        LagForm::None => None,
        LagForm::Delay => Some(Lag::Delay(part.delay_s)),
        LagForm::FirstOrder => Some(Lag::time_constant(part.time_constant_s)),
        LagForm::OfTheModel => known_lag,
    };
    let moved = lag.map_or_else(|| series.clone(), |lag| lag.of(&Course::smooth(series)));
    let degc = means.degc(&moved);

    let orders = match (given("sigma"), given("b_or")) {
        (Some(response), Some(offset)) => Orders { response, offset },
        (response, offset) => choose_orders(&means, &degc, response, offset),
    };
    let joint = means.baseline(&degc, orders);
    let limits = Limits { max_condition: MOST_CONDITION };
    let solution = joint.fit(&means.fields_nt, &degc, &means.readings_ent, &limits)?;
    let stacked = solution.coefficients.as_slice().to_vec();
    let noise = conditions::noise(&solution, &used)?;
    let r_nom = position.r_nom();
    let nodes = |order: usize| -> Vec<f64> {
        // Where interpolation errs least.
        (0..=order)
            .map(|k| joint.middle() + joint.half() * (std::f64::consts::PI * (k as f64 + 0.5) / (order + 1) as f64).cos())
            .collect()
    };
    let (response_nodes, offset_nodes) = (nodes(orders.response), nodes(orders.offset));
    let sensor = |stacked: &[f64], degc: f64| -> Option<Split> { split(&joint.at(stacked, degc).0.try_inverse()?, &r_nom).ok() };
    if let Some(degc) = response_nodes.iter().find(|t| sensor(&stacked, **t).is_none()) {
        return Err(SweepError::NoSensor { degc: *degc });
    }
    // All coefficients of the nine polynomials, one after the other, then the rotation at the middle temperature.
    let coefficients = |stacked: &[f64]| -> Vec<f64> {
        let splits: Vec<Option<Split>> = response_nodes.iter().map(|t| sensor(stacked, *t)).collect();
        let of = |get: &dyn Fn(&Split) -> f64| {
            let values: Vec<f64> = splits.iter().map(|s| s.as_ref().map_or(f64::NAN, get)).collect();
            through(&response_nodes, &values)
        };
        let mut all: Vec<f64> = (0..3).flat_map(|i| of(&|s| s.sigma[i])).collect();
        all.extend((0..3).flat_map(|i| of(&|s| s.xi_deg[i])));
        for i in 0..3 {
            let values: Vec<f64> = offset_nodes.iter().map(|t| joint.at(stacked, *t).1[i]).collect();
            all.extend(through(&offset_nodes, &values));
        }
        all.extend(sensor(stacked, joint.middle()).map_or([f64::NAN; 3], |s| s.rotation_deg));
        all
    };
    let found = propagate(coefficients, &stacked, &noise.covariance())?;
    let valid_degc = extremes(degc.iter().copied());
    let mut polynomials: Vec<TemperaturePolynomial> = Vec::new();
    let mut from = 0;
    for k in 0..QUANTITIES.len() {
        let count = if k < 6 { orders.response } else { orders.offset } + 1;
        polynomials.push(TemperaturePolynomial {
            coefficients: found.values[from..from + count].to_vec(),
            covariance: found.covariance.view((from, from), (count, count)).into_owned(),
            valid_degc,
        });
        from += count;
    }

    let windows = windows(&used, series, &moved, &r_nom, options.window);
    let blocks: Vec<SweepBlock> = used
        .iter()
        .zip(&degc)
        .map(|(p, degc)| {
            let (response, b_or) = joint.at(&stacked, *degc);
            let modelled = response.try_inverse().and_then(|phi| Linear::new(phi).ok()).map(|s| s.field(p.mean, b_or).0);
            let residual_nt = modelled.map_or([f64::NAN; 3], |m| std::array::from_fn(|k| p.setting.field.0[k] - m[k]));
            SweepBlock { t_s: p.t_s(), temperature_degc: *degc, residual_nt }
        })
        .collect();

    conditions::warn_of_plateaus(&mut notes, run, plateaus);
    conditions::warn_of_run(&mut notes, run);
    let columns = joint.columns(&means.fields_nt, &degc);
    // The temperature with its lag: what the polynomials are of.
    notes.extend(structure::note(&structure::Rows::of(&list, &used, &moved, &columns, &noise)));
    let mut head = conditions::head(run, instructions, &temperatures);
    head.temperature_degc = Some(degc.iter().sum::<f64>() / degc.len() as f64);
    let quantities = QUANTITIES
        .iter()
        .enumerate()
        .map(|(k, quantity)| {
            let family = if k < 6 { "sigma" } else { "b_or" };
            describe(*quantity, k, &polynomials[k], &windows, given(family).is_some(), used.len())
        })
        .collect();
    let rotation = |k: usize| (vec![found.values[from + k]], vec![found.std[from + k]]);
    let [(lambda, lambda_std), (mu, mu_std), (nu, nu_std)] = [rotation(0), rotation(1), rotation(2)];
    let rms = |of: &dyn Fn(&SweepBlock) -> f64| (blocks.iter().map(|b| of(b).powi(2)).sum::<f64>() / blocks.len() as f64).sqrt();
    Ok(Sweep {
        run: head,
        file: run.input.path.clone(),
        channel,
        valid_degc,
        quantities,
        rotation: RunRotations {
            lambda_x_deg: lambda,
            mu_y_deg: mu,
            nu_z_deg: nu,
            lambda_x_std_deg: lambda_std,
            mu_y_std_deg: mu_std,
            nu_z_std_deg: nu_std,
            initial: None,
        },
        settings: SettingCounts { used: used.len(), total: list.len(), too_fast: left_out },
        window: options.window,
        residual_nt: std::array::from_fn(|k| rms(&|b: &SweepBlock| b.residual_nt[k])),
        lags: parts,
        facility,
        model: model.map(|m| m.part),
        notes,
        windows,
        blocks,
        temperatures,
    })
}

/// Coefficients of the polynomial through as many points, lowest order first: Newton's divided differences.
fn through(x: &[f64], y: &[f64]) -> Vec<f64> {
    let mut differences = y.to_vec();
    for k in 1..x.len() {
        for i in (k..x.len()).rev() {
            differences[i] = (differences[i] - differences[i - 1]) / (x[i] - x[i - k]);
        }
    }
    let mut coefficients: Vec<f64> = Vec::new();
    for (difference, x) in differences.iter().zip(x).rev() {
        // Times (T - x), plus the difference.
        let mut next = vec![0.0; coefficients.len() + 1];
        for (k, c) in coefficients.iter().enumerate() {
            next[k + 1] += c;
            next[k] -= c * x;
        }
        next[0] += difference;
        coefficients = next;
    }
    coefficients.truncate(x.len());
    coefficients
}

/// The orders with the least AICc, summed over the components.
fn choose_orders(means: &Means, degc: &[f64], response: Option<usize>, offset: Option<usize>) -> Orders {
    let mut best: Option<(f64, Orders)> = None;
    for p in ORDERS.filter(|p| response.is_none_or(|r| r == *p)) {
        for q in ORDERS.filter(|q| offset.is_none_or(|o| o == *q)) {
            let orders = Orders { response: p, offset: q };
            let value = aicc(means.deviance(degc, orders), 3 * orders.count() + 3, 3 * degc.len());
            if let Some(value) = value.filter(|v| best.is_none_or(|(least, _)| *v < least)) {
                best = Some((value, orders));
            }
        }
    }
    let usual = Orders { response: response.unwrap_or(2), offset: offset.unwrap_or(2) };
    best.map_or(usual, |(_, orders)| orders)
}

/// Delay and time constant with which the sensor follows a thermistor.
fn find_lag(channel: &str, series: &[(f64, f64)], means: &Means, orders: Orders) -> ThermistorLag {
    let course = Course::smooth(series);
    let deviance = |lag: Lag| means.deviance(&means.degc(&lag.of(&course)), orders);
    let none = deviance(Lag::Delay(0.0));
    let span_s = means.t_s.last().unwrap_or(&0.0) - means.t_s.first().unwrap_or(&0.0);
    let [delay, time_constant] = lag::search(MOST_LAG_S.min(MOST_LAG_PART * span_s), deviance);
    let (best, form) =
        if delay.deviance <= time_constant.deviance { (delay, LagForm::Delay) } else { (time_constant, LagForm::FirstOrder) };
    let gain = none - best.deviance;
    let is_significant = best.lag.seconds().abs() > SIGNIFICANT * best.std_s && gain > SIGNIFICANT * SIGNIFICANT;
    let left = if is_significant { best.deviance } else { none };
    ThermistorLag {
        channel: channel.to_owned(),
        form: if is_significant { form } else { LagForm::None },
        delay_s: delay.lag.seconds(),
        delay_std_s: delay.std_s,
        time_constant_s: match time_constant.lag {
            Lag::InverseFirstOrder(tau_s) => -tau_s,
            lag => lag.seconds(),
        },
        time_constant_std_s: time_constant.std_s,
        gain,
        delay_over_first_order: time_constant.deviance - delay.deviance,
        // Geometric mean of the components.
        residual_std_ent: (0.5 * left / (3.0 * means.t_s.len() as f64)).exp(),
    }
}

/// Sliding windows; those that do not determine the nine parameters are passed over.
fn windows(
    used: &[&Plateau],
    series: &[(f64, f64)],
    moved: &[(f64, f64)],
    r_nom: &Matrix3<f64>,
    window: Window,
) -> Vec<WindowFit> {
    let end_of = |from: usize| match window {
        Window::Settings(n) => from + n,
        Window::Minutes(minutes) => used.partition_point(|p| p.t_s() <= used[from].t_s() + 60.0 * minutes),
    };
    (0..used.len())
        .filter(|from| end_of(*from) <= used.len())
        .filter_map(|from| {
            let own = &used[from..end_of(from)];
            let means = Means::of(own);
            let baseline = Baseline::in_time(extremes(means.t_s.iter().copied()), 0);
            let limits = Limits { max_condition: MOST_CONDITION };
            let fit = baseline.fit(&means.fields_nt, &means.t_s, &means.readings_ent, &limits).ok()?;
            let phi = |x: &[f64]| baseline.responses(x).first()?.try_inverse();
            let quantities = |x: &[f64]| -> Vec<f64> {
                let parts = phi(x).and_then(|phi| split(&phi, r_nom).ok());
                parts.map_or(vec![f64::NAN; 9], |s| [s.sigma, s.xi_deg, [x[3], x[7], x[11]]].concat())
            };
            let covariance = DMatrix::from_fn(12, 12, |r, c| {
                if r / 4 == c / 4 { fit.unscaled_covariance[(r % 4, c % 4)] * fit.residual_std[r / 4].powi(2) } else { 0.0 }
            });
            let stacked = fit.coefficients.as_slice().to_vec();
            let found = propagate(quantities, &stacked, &covariance).ok()?;
            let phi = phi(&stacked)?;
            let residual_nt = std::array::from_fn(|k| {
                let squares = (0..own.len()).map(|r| (0..3).map(|i| phi[(k, i)] * fit.residuals[(r, i)]).sum::<f64>().powi(2));
                (squares.sum::<f64>() / fit.dof.max(1) as f64).sqrt()
            });
            let mean = |series: &[(f64, f64)]| own.iter().map(|p| interpolate(series, p.t_s())).sum::<f64>() / own.len() as f64;
            let t_s = own.iter().map(|p| p.t_s()).sum::<f64>() / own.len() as f64;
            Some(WindowFit {
                t_s,
                temperature_degc: [mean(series), mean(moved)],
                heating: rate_k_per_s(series, t_s) > 0.0,
                values: found.values.try_into().ok()?,
                std: found.std.try_into().ok()?,
                residual_nt,
            })
        })
        .collect()
}

/// A quantity with its polynomial. Windows that follow each other share settings: those stand beside it that share none.
fn describe(
    (name, component, unit): (&str, &str, &'static str),
    k: usize,
    polynomial: &TemperaturePolynomial,
    windows: &[WindowFit],
    given: bool,
    settings: usize,
) -> QuantityFit {
    let apart: Vec<&WindowFit> = windows.iter().step_by(WINDOW).collect();
    let residual: Vec<f64> = apart.iter().map(|w| w.values[k] - polynomial.evaluate(w.temperature_degc[1]).0).collect();
    QuantityFit {
        name: name.to_owned(),
        component: component.to_owned(),
        unit,
        runs: Vec::new(),
        points: apart.iter().map(|w| [w.temperature_degc[1], w.values[k], w.std[k]]).collect(),
        std_known: true,
        error_range: extremes(residual.iter().copied()),
        residual,
        degrees_of_freedom: settings.saturating_sub(polynomial.coefficients.len()),
        factor_95: NORMAL_95,
        order_by: if given { Reason::Given } else { Reason::LeastAicc },
        aicc: Vec::new(),
        leave_one_out: Vec::new(),
        widened: 1.0,
        polynomial: polynomial.clone(),
        band: band(polynomial.valid_degc, |t| polynomial.evaluate(t)),
        joint_band: Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_through_points_has_their_coefficients() {
        let cubic = |t: f64| 2.0 - 0.5 * t + 0.25 * t * t - 0.125 * t * t * t;
        let x = [-3.0, -1.0, 0.5, 4.0];
        let found = through(&x, &x.map(cubic));
        for (found, expected) in found.iter().zip([2.0, -0.5, 0.25, -0.125]) {
            assert!((found - expected).abs() < 1e-13, "{found}");
        }
        assert_eq!(through(&[7.0], &[3.0]), [3.0]);
    }

    #[test]
    fn the_rate_of_a_ramp_is_its_slope() {
        let ramp: Vec<(f64, f64)> = (0..400).map(|i| (30.0 * f64::from(i), 0.01 * 30.0 * f64::from(i))).collect();
        assert!((rate_k_per_s(&ramp, 5000.0) - 0.01).abs() < 1e-12);
        assert!(interpolate(&ramp, -5.0) == 0.0 && (interpolate(&ramp, 1e9) - 119.7).abs() < 1e-12);
    }
}
