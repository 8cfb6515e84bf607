//! Effects between runs: what they do to the parameters of several linear calibrations beside each other.
//!
//! Every run gives nine values, class after class ([`Class`]): ln σ (3), offset (3, nT) and ξ (3, degrees). A term adds
//! `Σ_p a_p X_p(class, run, value)` to them, with the conditions of the runs as covariates.

use super::{Spec, Unseen};
use crate::data::units::COMPONENTS;
use crate::fit::statistics::extent;
use crate::model::position::{Class, Position};

/// Sensor temperatures that span more than this are part of the sensor's model, K.
const LEAST_SPAN_K: f64 = 5.0;
/// Temperatures within this are the same, K.
const SAME_K: f64 = 1.0;
/// Temperatures that span less than this show nothing, K.
const LEAST_SHOWN_K: f64 = 0.2;
/// All axes together, then every axis by itself.
pub const TOGETHER_AND_SINGLY: [&[usize]; 4] = [&[0, 1, 2], &[0], &[1], &[2]];
/// The form of an effect that is looked for between runs alone.
pub const BETWEEN_RUNS: &str = "between runs";

/// Why effects of time are not seen.
pub(super) const NO_TIMES: &str = "the runs bring no times";

/// The conditions of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct Conditions {
    /// The sensor, by its number.
    pub sensor: usize,
    /// Set of runs that was made in one place, by its number.
    pub set: usize,
    /// How the sensor axes lie along the coil axes.
    pub position: Position,
    /// Start, s since an epoch common to the runs.
    pub start_s: Option<f64>,
    /// Mean sensor temperature, °C.
    pub sensor_degc: Option<f64>,
    /// Mean temperature of the coil system, °C.
    pub coil_degc: Option<f64>,
}

/// The conditions of the runs that are compared.
#[derive(Clone, Debug, PartialEq)]
pub struct Runs(pub Vec<Conditions>);

/// What makes runs disagree, in the order in which it is tried.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Cause {
    /// The calibration of the facility: what a sensor axis sees of it depends on the orientation.
    Calibration,
    /// The temperature of the sensor.
    SensorTemperature,
    /// The temperature of the coils.
    CoilTemperature,
    /// The order of the sensor's model in its temperature.
    ThermalModel,
    /// The place of the sensor.
    Place,
    /// Time.
    Time,
}

/// What an effect may be between runs.
#[derive(Clone, Debug)]
pub struct BetweenRuns {
    /// What makes the runs disagree.
    pub cause: Cause,
    /// The terms that are tried.
    pub terms: Vec<Term>,
    /// What of it these runs cannot show; without terms, all of it.
    pub unseen: Option<Unseen>,
}

impl BetweenRuns {
    /// Terms.
    #[must_use]
    pub fn tried(cause: Cause, terms: Vec<Term>) -> Self {
        Self { cause, terms, unseen: None }
    }

    /// These runs cannot show the effect.
    #[must_use]
    pub fn unseen(cause: Cause, reason: &'static str) -> Self {
        Self { cause, terms: Vec::new(), unseen: Some(Unseen::Stated(reason)) }
    }
}

/// A term: its form and axes, and its columns.
#[derive(Clone, Debug)]
pub struct Term {
    /// Form, axes and shape.
    pub spec: Spec,
    /// One column per parameter.
    pub columns: Vec<Column>,
}

/// One linear parameter of a term and what it is multiplied with.
#[derive(Clone, Debug)]
pub struct Column {
    /// Name of the parameter.
    pub name: String,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Change of the values per unit of the parameter: class after class, run after run, value after value.
    pub values: Vec<f64>,
}

impl Column {
    /// From a function of class, run and value.
    #[must_use]
    pub fn of(name: String, unit: &'static str, runs: &Runs, value: impl Fn(Class, usize, usize) -> f64) -> Self {
        let n = runs.0.len();
        let values = (0..9 * n).map(|row| value(Class::ALL[row / (3 * n)], (row / 3) % n, row % 3)).collect();
        Self { name, unit, values }
    }

    /// One per axis on the values of a class that belong to the axis: `value` times a function of the run.
    #[must_use]
    pub fn per_axis(
        stem: &str,
        unit: &'static str,
        axes: &[usize],
        class: Class,
        runs: &Runs,
        value: impl Fn(usize) -> f64,
    ) -> Vec<Self> {
        let column = |&axis: &usize| {
            let name = format!("{stem}_{}", COMPONENTS[axis]);
            Self::of(name, unit, runs, |c, run, i| if c == class && i == axis { value(run) } else { 0.0 })
        };
        axes.iter().map(column).collect()
    }
}

impl Runs {
    /// Number of sensors.
    #[must_use]
    pub fn sensors(&self) -> usize {
        self.0.iter().map(|r| r.sensor + 1).max().unwrap_or(0)
    }

    /// The runs of a sensor.
    pub fn of_sensor(&self, sensor: usize) -> impl Iterator<Item = usize> + '_ {
        (0..self.0.len()).filter(move |r| self.0[*r].sensor == sensor)
    }

    /// Most orientations that a sensor has.
    #[must_use]
    pub fn orientations(&self) -> usize {
        let of = |sensor: usize| {
            let mut all: Vec<Position> = Vec::new();
            for r in self.of_sensor(sensor) {
                if !all.contains(&self.0[r].position) {
                    all.push(self.0[r].position);
                }
            }
            all.len()
        };
        (0..self.sensors()).map(of).max().unwrap_or(0)
    }

    /// A temperature of every run less the mean of the runs, K; `None` if a run has none or all are the same.
    #[must_use]
    pub fn deviations_k(&self, of: impl Fn(&Conditions) -> Option<f64>) -> Option<Vec<f64>> {
        let all: Vec<f64> = self.0.iter().map(of).collect::<Option<_>>()?;
        let mean = all.iter().sum::<f64>() / self.0.len() as f64;
        (extent(all.iter().copied()) > LEAST_SHOWN_K).then(|| all.iter().map(|t| t - mean).collect())
    }

    /// Order of the polynomials of the temperature that the model of a sensor has.
    #[must_use]
    pub fn thermal_order(&self, sensor: usize) -> usize {
        let own: Option<Vec<f64>> = self.of_sensor(sensor).map(|r| self.0[r].sensor_degc).collect();
        let Some(mut own) = own else { return 0 };
        if extent(own.iter().copied()) <= LEAST_SPAN_K {
            return 0;
        }
        own.sort_by(f64::total_cmp);
        let mut distinct = 0;
        let mut last = f64::NEG_INFINITY;
        for t in own {
            if t > last + SAME_K {
                distinct += 1;
                last = t;
            }
        }
        match distinct {
            0..=2 => 0,
            3 | 4 => 1,
            _ => 2,
        }
    }

    /// Temperature of the runs of a sensor from -1 to 1; zero where it is not known.
    pub fn scaled_temperature(&self, sensor: usize) -> impl Fn(usize) -> f64 + '_ {
        let own: Vec<f64> = self.of_sensor(sensor).filter_map(|r| self.0[r].sensor_degc).collect();
        let (low, high) = own.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let half = (0.5 * (high - low)).max(f64::MIN_POSITIVE);
        move |r| self.0[r].sensor_degc.map_or(0.0, |t| (t - 0.5 * (low + high)) / half)
    }

    /// Start of every run, s; `None` if a run has none or all are the same.
    #[must_use]
    pub fn starts_s(&self) -> Option<Vec<f64>> {
        let all: Vec<f64> = self.0.iter().map(|r| r.start_s).collect::<Option<_>>()?;
        (extent(all.iter().copied()) > 0.0).then_some(all)
    }
}

/// Wrong parameters of one class of the coil calibration, as the runs see them (docs/mathematics.md, "The coil system").
#[must_use]
pub fn calibration(runs: &Runs, class: Class, stem: &str, unit: &'static str) -> BetweenRuns {
    if runs.orientations() < 2 {
        return BetweenRuns::unseen(Cause::Calibration, "every sensor has one orientation: its own parameters take it up");
    }
    let suffix = if class == Class::Angle { ["xy", "xz", "yz"] } else { COMPONENTS };
    let term = |axes: &[usize]| {
        let column = |&axis: &usize| {
            Column::of(format!("{stem}_{}", suffix[axis]), unit, runs, |c, run, i| {
                let (along, factor) = class.sees(&runs.0[run].position, i);
                if c == class && along == axis { factor } else { 0.0 }
            })
        };
        Term { spec: Spec::new(BETWEEN_RUNS, axes), columns: axes.iter().map(column).collect() }
    };
    BetweenRuns::tried(Cause::Calibration, TOGETHER_AND_SINGLY.map(term).into())
}

/// Values of a class that follow a temperature of the sensor, where the model of the sensor does not have it already.
#[must_use]
pub fn sensor_temperature(runs: &Runs, class: Class, stem: &str, unit: &'static str) -> BetweenRuns {
    let cause = Cause::SensorTemperature;
    if (0..runs.sensors()).any(|s| runs.thermal_order(s) > 0) {
        return BetweenRuns::unseen(cause, "part of the model: the sensor is a polynomial of its temperature");
    }
    let Some(kelvin) = runs.deviations_k(|r| r.sensor_degc) else {
        return BetweenRuns::unseen(cause, "the runs bring no sensor temperatures that differ");
    };
    let term = |axes: &[usize]| Term {
        spec: Spec::new(BETWEEN_RUNS, axes),
        columns: Column::per_axis(stem, unit, axes, class, runs, |run| kelvin[run]),
    };
    BetweenRuns::tried(cause, TOGETHER_AND_SINGLY.map(term).into())
}
