//! Effects beside the linear sensor: the catalogue that simulation, calibration and diagnosis share.
//!
//! An effect adds a term to the reading, `δB_r = Σ_p a_p X_p(covariates; shape)`, enT, linear in its parameters `a` once its shape
//! (a time constant, an onset, a period) is given. The terms are small, so they add to the reading of the linear sensor and to each
//! other. An effect knows covariates and formulas and no statistics; whether it is there is asked in `diagnose`.

mod bad_thermistor;
pub mod clock_drift;
mod coil_temperature;
mod cubic_nonlinearity;
mod earthfield_leakage;
mod eddy_current_attenuation;
pub mod example;
mod facility_angle;
mod facility_offset;
mod facility_scale;
mod heater_pwm;
pub mod in_sine;
mod interference_tone;
mod lost_samples;
mod off_centre;
mod offset_drift;
mod offset_step;
mod quadratic_nonlinearity;
mod rack_temperature;
pub mod record;
mod remanence;
mod response_order;
mod rotation_drift;
mod saturation;
mod sensor_temperature_offset;
mod sensor_temperature_sensitivity;
pub mod settling;
mod thermal_curvature;
pub mod thermal_lag;
pub mod time_shift;
mod transverse_field;
mod unknown;

pub use heater_pwm::harmonic as pulse_harmonic;
pub use record::{Record, Row, Thermal};
pub use unknown::{Covariate, columns as unknown_columns, spline};

use crate::data::units::COMPONENTS;
use in_sine::InSine;
use serde::Serialize;

/// Where an effect belongs: effects of one family look alike.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub enum Family {
    /// Odd function of the reading of the axis itself.
    #[serde(rename = "static odd nonlinearity")]
    StaticOdd,
    /// Even function of the reading of the axis itself.
    #[serde(rename = "static even nonlinearity")]
    StaticEven,
    /// Function of the field across the axis.
    #[serde(rename = "cross-field")]
    CrossField,
    /// Follows a temperature of the sensor.
    #[serde(rename = "thermal")]
    Thermal,
    /// Follows the facility.
    #[serde(rename = "facility")]
    Facility,
    /// Function of time.
    #[serde(rename = "time")]
    Time,
    /// Remembers earlier settings.
    #[serde(rename = "history")]
    History,
    /// Periodic in time, or in the timing itself.
    #[serde(rename = "timing and periodic")]
    Periodic,
    /// Response to alternating fields.
    #[serde(rename = "frequency response")]
    Response,
    /// Damaged data.
    #[serde(rename = "data fault")]
    DataFault,
    /// Not in the catalogue.
    #[serde(rename = "unknown")]
    Unknown,
}

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
            Family::Unknown => "unknown",
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

/// An effect of the catalogue.
pub trait Effect: Sync {
    /// Name in files.
    fn id(&self) -> &'static str;

    /// In words.
    fn about(&self) -> About;

    /// The terms that are tried on a record, shape grids included.
    ///
    /// # Errors
    /// Why a record of this kind cannot show the effect, whatever its size.
    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String>;

    /// The columns of a term on a record; `None` if the record lacks what the term needs.
    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>>;

    /// What a form of it does to sines, by the values of its parameters; `None` if nothing, or if the form is none.
    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        let _ = (spec, value);
        None
    }

    /// A term to show what the effect looks like, with an ordinary shape.
    fn example(&self, record: &Record) -> Option<Spec> {
        self.specs(record).ok()?.into_iter().next()
    }
}

/// The catalogue, in the order of the families.
pub const CATALOGUE: [&dyn Effect; 29] = [
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
    &unknown::Unknown,
];

/// An effect by its id.
#[must_use]
pub fn named(id: &str) -> Option<&'static dyn Effect> {
    CATALOGUE.into_iter().find(|e| e.id() == id)
}

/// Every axis by itself, then all of them together.
#[must_use]
pub fn singly_and_together(form: &str) -> Vec<Spec> {
    [&[0][..], &[1], &[2], &[0, 1, 2]].map(|axes| Spec::new(form, axes)).to_vec()
}
