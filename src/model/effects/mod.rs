//! Effects beside the linear sensor: the catalogue that simulation, calibration and diagnosis share.
//!
//! An effect adds a term to the reading, `δB_r = Σ_p a_p X_p(covariates; shape)`, enT, linear in its parameters `a` once its shape
//! (a time constant, an onset, a period) is given. The terms are small, so they add to the reading of the linear sensor and to each
//! other. An effect knows covariates and formulas and no statistics; whether it is there is asked in `diagnose`.
//!
//! Everything that is particular to one effect stands in its own file: formula, forms, shape parameters, prior, words, where it acts and
//! why a kind of run cannot show it. A new effect is such a file, its `mod` line and its line in `STANDARD`.

pub mod bad_thermistor;
pub mod between;
mod catalogue;
pub mod clock_drift;
pub mod coil_temperature;
mod cubic_nonlinearity;
pub mod earthfield_leakage;
pub mod eddy_current_attenuation;
pub mod example;
pub mod facility_angle;
pub mod facility_offset;
pub mod facility_scale;
pub mod heater_pwm;
pub mod in_flight;
pub mod in_samples;
pub mod in_sine;
pub mod interference_tone;
pub mod lost_samples;
pub mod off_centre;
pub mod offset_drift;
pub mod offset_step;
mod quadratic_nonlinearity;
mod rack_temperature;
pub mod record;
pub mod remanence;
pub mod response_order;
pub mod rotation_drift;
mod saturation;
pub mod sensitivity_step;
pub mod sensor_temperature_offset;
pub mod sensor_temperature_sensitivity;
pub mod settling;
pub mod thermal_curvature;
pub mod thermal_lag;
pub mod time_shift;
mod transverse_field;
mod unknown;
mod unseen;

pub use catalogue::{Catalogue, EffectRef, IdTaken, UNKNOWN};
pub use record::{Record, Row, Thermal};
pub use unknown::{Covariate, GAIN_WITH, MODULUS, TIME, columns as unknown_columns, spline};
pub use unseen::Unseen;

use crate::data::run::Kind;
use crate::data::units::COMPONENTS;
use between::{BetweenRuns, Runs};
use in_samples::InSamples;
use in_sine::{InSine, SineRun, SineTerm};
use serde::{Serialize, Serializer};
use std::sync::Arc;

/// Where an effect belongs: effects of one family look alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Family {
    /// Odd function of the reading of the axis itself.
    StaticOdd,
    /// Even function of the reading of the axis itself.
    StaticEven,
    /// Function of the field across the axis.
    CrossField,
    /// Follows a temperature of the sensor.
    Thermal,
    /// Follows the facility.
    Facility,
    /// Function of time.
    Time,
    /// Remembers earlier settings.
    History,
    /// Periodic in time, or in the timing itself.
    Periodic,
    /// Response to alternating fields.
    Response,
    /// Damaged data.
    DataFault,
    /// Not in the catalogue.
    Unknown,
}

impl Serialize for Family {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.name())
    }
}

/// In what of a run, or of several, an effect acts and is looked for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Acts {
    /// In the means of the plateaus.
    Means,
    /// Inside the plateaus, in single samples.
    Samples,
    /// In amplitudes, phases or the clock of a run with sines.
    Sines,
    /// In the parameters of several runs beside each other.
    BetweenRuns,
}

/// What of a run an effect changes. Where effects of several kinds are listed together, those of the response come first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Changes {
    /// Amplitudes and phases of sines.
    Response,
    /// The sampling frequency.
    Clock,
    /// The temperatures of which the linear sensor is a function.
    Temperatures,
    /// The readings.
    Readings,
}

/// A shape parameter of an effect.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ShapeParameter {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Its best value is looked for between those that are tried; all others name a choice.
    pub continuous: bool,
}

impl ShapeParameter {
    /// One whose best value is looked for.
    #[must_use]
    pub const fn continuous(name: &'static str, unit: &'static str) -> Self {
        Self { name, unit, continuous: true }
    }

    /// One that names a choice, or is measured elsewhere.
    #[must_use]
    pub const fn fixed(name: &'static str, unit: &'static str) -> Self {
        Self { name, unit, continuous: false }
    }
}

/// What a frequency run cannot tell from the amplitude of its sines: whatever changes the reading of one field direction by a factor.
pub const PART_OF_THE_AMPLITUDE: Unseen = Unseen::Stated("one field direction with one amplitude: it is part of the amplitude");
/// What a frequency run cannot tell from the offsets of its settings.
pub const PART_OF_THE_OFFSETS: Unseen = Unseen::Stated("every setting has an offset of its own beside its sine");
/// What a frequency run does not look at.
pub const BESIDE_THE_SINES: Unseen =
    Unseen::Stated("beside a sine only noise near its frequency is looked at; a run in zero field shows it");

impl Family {
    /// Name for people and files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Family::StaticOdd => "static odd nonlinearity",
            Family::StaticEven => "static even nonlinearity",
            Family::CrossField => "cross-field",
            Family::Thermal => "thermal",
            Family::Facility => "facility",
            Family::Time => "time",
            Family::History => "history",
            Family::Periodic => "timing and periodic",
            Family::Response => "frequency response",
            Family::DataFault => "data fault",
            Family::Unknown => unknown::ID,
        }
    }
}

/// An effect in words.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct About {
    /// What it is.
    pub summary: &'static str,
    /// Its formula.
    pub formula: &'static str,
    /// Where it belongs.
    pub family: Family,
    /// Runs that can show it.
    pub seen_in: &'static str,
    /// Covariates it needs.
    pub needs: &'static str,
    /// Where it is described.
    pub source: &'static str,
    /// The measurement that shows it best.
    pub best_measurement: &'static str,
}

/// A term of an effect, complete but for the values of its linear parameters.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Spec {
    /// Which of the effect's forms.
    pub form: String,
    /// Axes it acts on: of the sensor, or of the coil system where the effect sits there.
    pub axes: Vec<usize>,
    /// Shape parameters: name, value, unit.
    pub shape: Vec<(String, f64, String)>,
}

impl Spec {
    /// A form without shape parameters.
    #[must_use]
    pub fn new(form: &str, axes: &[usize]) -> Self {
        Spec { form: form.to_owned(), axes: axes.to_vec(), shape: Vec::new() }
    }

    /// With a shape parameter.
    #[must_use]
    pub fn with(mut self, name: &str, value: f64, unit: &str) -> Self {
        self.shape.push((name.to_owned(), value, unit.to_owned()));
        self
    }

    /// A shape parameter by name.
    #[must_use]
    pub fn get(&self, name: &str) -> Option<f64> {
        self.shape.iter().find(|(n, _, _)| n == name).map(|(_, v, _)| *v)
    }

    /// Whether it acts on x, y, z.
    #[must_use]
    pub fn on(&self) -> [bool; 3] {
        std::array::from_fn(|i| self.axes.contains(&i))
    }

    /// Axes by name.
    #[must_use]
    pub fn axis_names(&self) -> Vec<&'static str> {
        self.axes.iter().filter_map(|a| COMPONENTS.get(*a).copied()).collect()
    }
}

/// One linear parameter of a term and what it is multiplied with.
#[derive(Clone, Debug, PartialEq)]
pub struct Column {
    /// Name of the parameter, as `c3_z`.
    pub name: String,
    /// Unit of the parameter.
    pub unit: &'static str,
    /// Change of the reading per unit of the parameter, enT, for every row.
    pub values: Vec<[f64; 3]>,
}

impl Column {
    /// From a function of the row.
    pub fn of(name: impl Into<String>, unit: &'static str, record: &Record, value: impl Fn(usize, &Row) -> [f64; 3]) -> Self {
        Column { name: name.into(), unit, values: record.rows.iter().enumerate().map(|(i, row)| value(i, row)).collect() }
    }

    /// On one axis of the sensor.
    pub fn on(name: &str, axis: usize, unit: &'static str, record: &Record, value: impl Fn(usize, &Row) -> f64) -> Self {
        Self::of(format!("{name}_{}", COMPONENTS[axis]), unit, record, |i, row| one(axis, value(i, row)))
    }
}

/// A vector with one component.
#[must_use]
pub fn one(axis: usize, value: f64) -> [f64; 3] {
    let mut vector = [0.0; 3];
    vector[axis] = value;
    vector
}

/// An effect: a cause, what it does to a run, and what is known of it beforehand.
pub trait Effect: Sync {
    /// Name in files, unlike that of any other effect.
    fn id(&self) -> &'static str;

    /// In words.
    fn about(&self) -> About;

    /// In what it acts.
    fn acts(&self) -> &'static [Acts];

    /// What it changes.
    fn changes(&self) -> Changes {
        Changes::Readings
    }

    /// Its shape parameters.
    fn shape(&self) -> &'static [ShapeParameter] {
        &[]
    }

    /// Prior weight relative to an effect of which nothing is known beforehand, beside an offset that is a polynomial in time of this order;
    /// `None` where time has no part in the model.
    fn prior(&self, trend_order: Option<usize>) -> f64 {
        let _ = trend_order;
        1.0
    }

    /// How many times as likely it is among other effects as beside noise: of another one that looks like it more may be asked there.
    fn among_effects(&self, trend_order: Option<usize>) -> f64 {
        let _ = trend_order;
        1.0
    }

    /// Whether a form belongs to the times of the run in which it was found, and holds for no other one.
    fn is_of_one_run(&self, form: &str) -> bool {
        let _ = form;
        false
    }

    /// Whether it is a property of the response that a frequency analysis fits, and not of facility or mounting.
    fn is_of_the_response(&self) -> bool {
        false
    }

    /// The covariate over which a term is drawn, by its name among [`Covariate::all`]; `None` for the one that it turns out to follow best.
    fn shown_along(&self, spec: &Spec) -> Option<String> {
        let _ = spec;
        None
    }

    /// From when on a term changes the readings, s since the run's start; `None` if always.
    fn begins_s(&self, spec: &Spec) -> Option<f64> {
        let _ = spec;
        None
    }

    /// Why a kind of run cannot show it. By default an effect without a term in means or sines states nothing and has no form there.
    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        let needed = if kind == Kind::Frequency { Acts::Sines } else { Acts::Means };
        (!self.acts().contains(&needed)).then_some(Unseen::NoForm(kind))
    }

    /// The terms that are tried on a record, shape grids included.
    ///
    /// # Errors
    /// Why a record of this kind cannot show the effect, whatever its size.
    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        self.unseen_by(record.kind).map_or(Ok(Vec::new()), Err)
    }

    /// What a form follows, where the effect may follow several things at once and each of them is an explanation of its own; by default all
    /// forms are one.
    fn follows(&self, spec: &Spec) -> Option<String> {
        let _ = spec;
        None
    }

    /// The columns of a term on a record; `None` if the record lacks what the term needs.
    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }

    /// Between which values a continuous shape parameter is looked for around one that was tried.
    fn shape_range(&self, record: &Record, spec: &Spec, name: &str, value: f64) -> [f64; 2] {
        let _ = (record, spec, name);
        around(value)
    }

    /// How it is looked for inside the plateaus; `None` if it does not act there.
    fn in_samples(&self) -> Option<InSamples> {
        None
    }

    /// The period of a term, s, that has the same course on each of its axes, one after the other; `None` if it has none.
    fn period_s(&self, spec: &Spec) -> Option<f64> {
        let _ = spec;
        None
    }

    /// Where inside the plateaus a term shows, in words.
    fn place_in_samples(&self, spec: &Spec) -> String {
        format!("{}, everywhere inside the plateaus", spec.axis_names().join(", "))
    }

    /// What a form of it does to sines, by the values of its parameters; `None` if nothing, or if the form is none.
    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        let _ = (spec, value);
        None
    }

    /// What it may be between runs; `None` if it does not act there.
    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let _ = runs;
        None
    }

    /// Why the sines of a run cannot show it.
    fn unseen_in_sines(&self, run: &SineRun) -> Option<Unseen> {
        let _ = run;
        self.unseen_by(Kind::Frequency)
    }

    /// The terms that are tried in the sines of a run, beside a response whose lowest -3 dB frequency is given.
    fn sine_terms(&self, run: &SineRun, corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        let _ = (run, corner_hz);
        Vec::new()
    }

    /// A known form of it as a term that is fitted again, with its parameters; `None` if the run does not have what it needs.
    fn known_sine_term(&self, known: &InSine, run: &SineRun) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        let _ = (known, run);
        None
    }

    /// A term to show what the effect looks like, with an ordinary shape.
    fn example(&self, record: &Record) -> Option<Spec> {
        self.specs(record).ok()?.into_iter().next()
    }
}

impl dyn Effect + '_ {
    /// Whether it acts there.
    #[must_use]
    pub fn acts_in(&self, what: Acts) -> bool {
        self.acts().contains(&what)
    }

    /// The continuous shape parameter of a term and its value.
    #[must_use]
    pub fn continuous<'a>(&self, spec: &'a Spec) -> Option<(&'a str, f64)> {
        let is_continuous = |name: &str| self.shape().iter().any(|p| p.continuous && p.name == name);
        spec.shape.iter().find(|(name, _, _)| is_continuous(name)).map(|(name, value, _)| (name.as_str(), *value))
    }
}

/// A factor of 1.6 to either side of a value, whatever its sign: shape grids have steps of a factor of two at most.
#[must_use]
pub fn around(value: f64) -> [f64; 2] {
    if value > 0.0 { [0.6 * value, 1.6 * value] } else { [1.6 * value, 0.6 * value] }
}

/// The effects of this program, in the order of the families; [`Catalogue::default`] has them.
const STANDARD: &[&dyn Effect] = &[
    &cubic_nonlinearity::CubicNonlinearity,
    &quadratic_nonlinearity::QuadraticNonlinearity,
    &saturation::Saturation,
    &transverse_field::TransverseField,
    &coil_temperature::CoilTemperature,
    &rack_temperature::RackTemperature,
    &sensor_temperature_sensitivity::SensorTemperatureSensitivity,
    &sensor_temperature_offset::SensorTemperatureOffset,
    &thermal_lag::ThermalLag,
    &thermal_curvature::ThermalCurvature,
    &rotation_drift::RotationDrift,
    &offset_drift::OffsetDrift,
    &offset_step::OffsetStep,
    &sensitivity_step::SensitivityStep,
    &remanence::Remanence,
    &settling::Settling,
    &time_shift::TimeShift,
    &earthfield_leakage::EarthfieldLeakage,
    &heater_pwm::HeaterPwm,
    &interference_tone::InterferenceTone,
    &facility_scale::FacilityScale,
    &facility_offset::FacilityOffset,
    &facility_angle::FacilityAngle,
    &off_centre::OffCentre,
    &eddy_current_attenuation::EddyCurrentAttenuation,
    &response_order::ResponseOrder,
    &clock_drift::ClockDrift,
    &lost_samples::LostSamples,
    &bad_thermistor::BadThermistor,
];

/// Every axis by itself, then all of them together.
#[must_use]
pub fn singly_and_together(form: &str) -> Vec<Spec> {
    [&[0][..], &[1], &[2], &[0, 1, 2]].map(|axes| Spec::new(form, axes)).to_vec()
}

#[cfg(test)]
mod tests;
