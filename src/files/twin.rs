//! A twin: what a simulated campaign is made of. README.md has its keys by example; `configs/demo.toml` has them all.

mod read;
#[cfg(feature = "tables")]
pub mod telemetry;

pub use read::read;

use super::campaign::file::CampaignFile;
use super::mag::Programme;
use crate::data::run::Location;
use crate::model::coil::Coil;
use crate::model::position::Position;
use crate::model::thermal::ThermalSensor;
use jiff::Timestamp;
use std::collections::BTreeMap;

/// A sensor in one mode, with the electronics that read it.
#[derive(Clone, Debug)]
pub struct SensorTwin {
    /// Name as in the run headers.
    pub name: String,
    /// Mode as in the run headers.
    pub mode: String,
    /// Where in the coil system the sensor reads as described; the runs of `[[campaign.at]]` tell where they were made.
    pub location: Location,
    /// Parameters against temperature, and the AC response.
    pub model: ThermalSensor,
    /// Rotation vector of the sensor out of its nominal orientation at 0 °C, degrees, along X_m, Y_m, Z_m.
    pub rotation_deg: [f64; 3],
    /// Its change with the sensor temperature, degrees per K.
    pub rotation_per_k_deg: [f64; 3],
    /// Nominal sample rate, Hz.
    pub nominal_rate_hz: f64,
    /// Real sample rate, Hz.
    pub rate_hz: f64,
    /// Readings end at plus and minus this, enT.
    pub range_ent: f64,
    /// Distance of neighbouring readings, enT.
    pub resolution_ent: f64,
    /// Standard deviation of white noise in a sample per component, enT.
    pub white_ent: [f64; 3],
    /// Amplitude density of 1/f noise at 1 Hz per component, enT/√Hz.
    pub flicker_ent: [f64; 3],
    /// The 1/f noise becomes white below this frequency, Hz.
    pub flicker_lowest_hz: f64,
    /// Samples of a packet, which get lost together.
    pub packet_samples: u32,
    /// Probability that a packet is lost.
    pub packet_loss: f64,
}

/// A residual field that holds from a time on.
#[derive(Clone, Copy, Debug)]
pub struct Residual {
    /// From when.
    pub from: Timestamp,
    /// Field, nT, coil axes.
    pub field_nt: [f64; 3],
}

/// The facility.
#[derive(Clone, Debug)]
pub struct FacilityTwin {
    /// Source of the field, for the headers.
    pub field_source: String,
    /// Whether coil parameters are corrected, for the headers.
    pub coil_correction: Option<bool>,
    /// Earth-field compensation per axis, for the headers.
    pub compensation: Vec<String>,
    /// The coil system, which turns settings into fields.
    pub coil: Coil,
    /// Scatter of the source from setting to setting per axis, nT.
    pub setting_scatter_nt: [f64; 3],
    /// Residual fields in time order; none before the first.
    pub residual: Vec<Residual>,
    /// Amplitude of the daily variation of the external field, nT, coil axes.
    pub daily_nt: [f64; 3],
    /// Standard deviation of its irregular part, which wanders within an hour, nT.
    pub irregular_nt: [f64; 3],
    /// Part of the variation that the compensation leaves.
    pub leakage: [f64; 3],
    /// Noise of the variometer, nT.
    pub variometer_noise_nt: f64,
    /// Noise of the scalar magnetometer, nT.
    pub scalar_noise_nt: f64,
}

/// A phase of the thermal box.
#[derive(Clone, Copy, Debug)]
pub struct Phase {
    /// Its begin.
    pub from: Timestamp,
    /// Temperature it leads to, °C.
    pub target_degc: f64,
    /// How it goes there.
    pub approach: Approach,
}

/// How the box approaches a temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Approach {
    /// Controlled, with this rate, K/h, and held afterwards.
    Rate(f64),
    /// Left to itself, with this time constant, h.
    Time(f64),
}

/// Heater current that makes a field, while no setting is active.
#[derive(Clone, Copy, Debug)]
pub struct Heater {
    /// Field, nT, coil axes.
    pub field_nt: [f64; 3],
    /// Longest pulse, s.
    pub longest_s: f64,
    /// Time between the end of a setting and a pulse, s.
    pub delay_s: f64,
}

/// The thermal box.
#[derive(Clone, Debug)]
pub struct BoxTwin {
    /// Temperature before the first phase, °C.
    pub start_degc: f64,
    /// Time constant of the sensor in the box, s.
    pub sensor_time_constant_s: f64,
    /// Phases in time order.
    pub phases: Vec<Phase>,
    /// Heater.
    pub heater: Option<Heater>,
}

/// A temperature that depends on the day and its time.
#[derive(Clone, Debug, PartialEq)]
pub struct Climate {
    /// Mean, °C, where there are no readings.
    pub mean_degc: f64,
    /// Temperatures that are known at times, °C, in time order: straight lines between them, held beyond them, in place of the mean.
    pub readings: Vec<(Timestamp, f64)>,
    /// Amplitude of its daily change, K; highest at 15 h.
    pub daily_k: f64,
}

/// A jump of a thermistor.
#[derive(Clone, Copy, Debug)]
pub struct Jump {
    /// Begin.
    pub from: Timestamp,
    /// End.
    pub until: Timestamp,
    /// Smallest and largest change of the reading, K: a new one in between every minute or so.
    pub by_k: [f64; 2],
}

/// The body that a thermistor is attached to.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Body {
    /// The sensor.
    Sensor,
    /// The thermal box.
    Box,
    /// The coil system.
    Coil,
    /// The electronics of the facility.
    Rack,
}

impl Body {
    /// All bodies with their names in files.
    pub const NAMES: [(Body, &'static str); 4] =
        [(Body::Sensor, "sensor"), (Body::Box, "box"), (Body::Coil, "coil"), (Body::Rack, "rack")];
}

/// A thermistor.
#[derive(Clone, Debug)]
pub struct Thermistor {
    /// Channel.
    pub channel: String,
    /// What it is attached to.
    pub of: Body,
    /// Time constant, s: it follows its body that much later.
    pub time_constant_s: f64,
    /// Constant error, K.
    pub offset_k: f64,
    /// Standard deviation of a reading, K.
    pub noise_k: f64,
    /// Stretches in which it cannot be trusted.
    pub jumps: Vec<Jump>,
}

/// A run of the programme.
#[derive(Clone, Debug)]
pub struct RunTwin {
    /// Run id.
    pub id: String,
    /// Begin.
    pub start: Timestamp,
    /// Its field programme.
    pub programme: usize,
    /// Its sensor and mode.
    pub sensor: usize,
    /// Position in place of those of the programme.
    pub position: Option<u32>,
    /// Zero field after every setting, s.
    pub pause_s: f64,
    /// It ends after this time, s.
    pub longest_s: Option<f64>,
    /// Nominal sample rate in place of the sensor's, Hz.
    pub nominal_rate_hz: Option<f64>,
    /// How often the programme is run through.
    pub repeat: u32,
    /// Fields of the programme are multiplied by this.
    pub field_factor: f64,
}

/// The whole twin.
#[derive(Clone, Debug)]
pub struct Twin {
    /// Seed of the random numbers unless the command gives another one.
    pub seed: u64,
    /// Text of the `campaign.toml` of the simulated campaign.
    pub campaign_toml: String,
    /// The same, read.
    pub campaign: CampaignFile,
    /// Positions by id: nominal orientation, and the rotation vector by which it is missed, degrees.
    pub places: BTreeMap<u32, (Position, [f64; 3])>,
    /// Sensors and modes.
    pub sensors: Vec<SensorTwin>,
    /// Facility.
    pub facility: FacilityTwin,
    /// Thermal box.
    pub thermal_box: BoxTwin,
    /// Temperature of the coil system.
    pub coil_climate: Climate,
    /// Temperature of the rack.
    pub rack_climate: Climate,
    /// Thermistors.
    pub thermistors: Vec<Thermistor>,
    /// Interval of temperatures and slow channels, s.
    pub slow_interval_s: f64,
    /// Field programmes.
    pub programmes: Vec<Programme>,
    /// Runs in time order.
    pub runs: Vec<RunTwin>,
}
