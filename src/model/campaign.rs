//! What a campaign says of its runs beside their headers: positions, temperature channels, field limits, orders.

use super::position::Position;
use crate::data::reference::StatedReference;
use crate::data::run::{Header, Location};
use std::collections::BTreeMap;

/// Channel of the sensor temperature where nothing else is said.
pub const SENSOR_CHANNEL: &str = "T59";
/// Channel of the coil temperature where nothing else is said.
pub const COIL_CHANNEL: &str = "T29";
/// Channel of the temperature of the facility's electronics rack where nothing else is said (CH-GFZ-TR-2601 section 6).
pub const RACK_CHANNEL: &str = "T55";

/// Channels of a sensor.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SensorChannels {
    /// Name as in the run headers.
    pub name: String,
    /// Channel of the sensor temperature.
    pub temperature_channel: Option<String>,
    /// Channel of the coil system's temperature.
    pub coil_temperature_channel: Option<String>,
    /// Channels of the temperatures of the coils X, Y and Z.
    pub coil_temperature_channels: Option<[String; 3]>,
}

/// Field limits of a sensor and mode.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldLimits {
    /// Sensor; `None` is any.
    pub sensor: Option<String>,
    /// Mode; `None` is any.
    pub mode: Option<String>,
    /// Largest magnitude along the nominal sensor axes, nT.
    pub max_field_nt: [f64; 3],
}

/// Runs that are compared across temperatures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermalEntry {
    /// Sensor; `None` is any.
    pub sensor: Option<String>,
    /// Mode; `None` is any.
    pub mode: Option<String>,
    /// Run ids; `None` is all of sensor and mode.
    pub runs: Option<Vec<String>>,
    /// Polynomial order per quantity, `sigma`, `sigma_x`, `xi`, `b_or`, `b_off`, `f_3db` for example.
    pub orders: Vec<(String, u32)>,
}

/// Quantities of a thermal analysis, and the names under which several share one order.
pub const THERMAL_QUANTITIES: [&str; 24] = [
    "sigma",
    "xi",
    "b_or",
    "b_off",
    "f_3db",
    "f_3db_igep",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "xi_xy",
    "xi_xz",
    "xi_yz",
    "b_or_x",
    "b_or_y",
    "b_or_z",
    "b_off_x",
    "b_off_y",
    "b_off_z",
    "f_3db_x",
    "f_3db_y",
    "f_3db_z",
    "f_3db_igep_x",
    "f_3db_igep_y",
    "f_3db_igep_z",
];
/// Largest order of a temperature polynomial.
pub const MOST_THERMAL_ORDER: u32 = 5;

/// How large the slopes of a sensor with its temperature can be: standard uncertainties about zero.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SlopeBounds {
    /// Of sensitivities, nT/enT/K.
    pub sigma_per_k: Option<f64>,
    /// Of angles between the sensor axes, degrees/K.
    pub xi_deg_per_k: Option<f64>,
    /// Of offsets, enT/K.
    pub offset_ent_per_k: Option<f64>,
}

/// The largest slope of a sensitivity in the report of a calibration of a fluxgate, nT/enT/K (BC-MAG-TR-0085, section 12: 9.93e-4).
pub const LARGEST_SIGMA_PER_K: f64 = 1e-3;
/// The largest slope of an angle there, degrees/K (1.48e-3).
pub const LARGEST_XI_DEG_PER_K: f64 = 1.5e-3;

impl SlopeBounds {
    /// What is stated, and for sensitivities and angles else the largest slopes that are published of fluxgates.
    #[must_use]
    pub fn or_published(self) -> Self {
        Self {
            sigma_per_k: self.sigma_per_k.or(Some(LARGEST_SIGMA_PER_K)),
            xi_deg_per_k: self.xi_deg_per_k.or(Some(LARGEST_XI_DEG_PER_K)),
            ..self
        }
    }

    /// Whether the slopes of sensitivities and of angles are stated.
    #[must_use]
    pub fn is_complete(&self) -> bool {
        self.sigma_per_k.is_some() && self.xi_deg_per_k.is_some()
    }

    /// Whether the slopes of sensitivities or of angles are stated.
    #[must_use]
    pub fn is_stated(&self) -> bool {
        self.sigma_per_k.is_some() || self.xi_deg_per_k.is_some()
    }
}

/// What a campaign says of its runs beside their headers.
#[derive(Clone, Debug, PartialEq)]
pub struct Instructions {
    /// Name and instrument, or what is assumed without a campaign file.
    pub description: String,
    /// Order of the offset trend in linearity runs.
    pub offset_trend_order: Option<u32>,
    /// Channel of the sensor temperature for all sensors.
    pub temperature_channel: Option<String>,
    /// Channel of the coil temperature for all sensors.
    pub coil_temperature_channel: Option<String>,
    /// Channels of the temperatures of the coils X, Y and Z for all sensors.
    pub coil_temperature_channels: Option<[String; 3]>,
    /// Channel of the temperature of the facility's electronics rack.
    pub rack_temperature_channel: Option<String>,
    /// Positions with the id that settings use, in the order of the file.
    pub positions: Vec<(u32, Position)>,
    /// Channels of single sensors.
    pub sensors: Vec<SensorChannels>,
    /// Field limits.
    pub limits: Vec<FieldLimits>,
    /// Thermal groups; without any they follow from sensor, mode and location.
    pub thermal: Vec<ThermalEntry>,
    /// Where the sensor stood, by run id; the centre where nothing is said.
    pub at: BTreeMap<String, Location>,
    /// How sensors stand in their reference cubes, by sensor.
    pub references: BTreeMap<String, StatedReference>,
    /// How large the slopes of sensors with their temperature can be.
    pub slope_bounds: SlopeBounds,
}

impl Default for Instructions {
    /// Without a campaign file.
    fn default() -> Self {
        Self {
            description: format!(
                "no campaign.toml: position 1 is +X +Y +Z, channels {SENSOR_CHANNEL} and {COIL_CHANNEL}, no field limits"
            ),
            offset_trend_order: None,
            temperature_channel: None,
            coil_temperature_channel: None,
            coil_temperature_channels: None,
            rack_temperature_channel: None,
            positions: vec![(1, Position::STANDARD)],
            sensors: Vec::new(),
            limits: Vec::new(),
            thermal: Vec::new(),
            at: BTreeMap::new(),
            references: BTreeMap::new(),
            slope_bounds: SlopeBounds::default(),
        }
    }
}

impl Instructions {
    /// The position with this id.
    #[must_use]
    pub fn position(&self, id: u32) -> Option<Position> {
        self.positions.iter().find(|(own, _)| *own == id).map(|(_, position)| *position)
    }

    /// Where the sensor stood in a run.
    #[must_use]
    pub fn location(&self, run: &str) -> Location {
        self.at.get(run).copied().unwrap_or_default()
    }

    /// The channels of sensor and coil temperature for a run. Where the coils have a channel each and the coil system has none, that of
    /// the coil X stands for it.
    #[must_use]
    pub fn channels(&self, header: &Header) -> (String, String) {
        let sensor = self.sensor(header);
        let own = sensor.and_then(|s| s.temperature_channel.as_ref()).or(self.temperature_channel.as_ref());
        let one = |one: &Option<String>, three: &Option<[String; 3]>| one.clone().or_else(|| Some(three.as_ref()?[0].clone()));
        let coil = sensor
            .and_then(|s| one(&s.coil_temperature_channel, &s.coil_temperature_channels))
            .or_else(|| one(&self.coil_temperature_channel, &self.coil_temperature_channels));
        (own.cloned().unwrap_or_else(|| SENSOR_CHANNEL.to_owned()), coil.unwrap_or_else(|| COIL_CHANNEL.to_owned()))
    }

    /// The channels of the temperatures of the coils X, Y and Z for a run: one each where the campaign names three, else that of the coil
    /// system for all. What is said of the sensor goes before what is said of all.
    #[must_use]
    pub fn coil_channels(&self, header: &Header) -> [String; 3] {
        let all = |one: &Option<String>, three: &Option<[String; 3]>| {
            three.clone().or_else(|| one.as_ref().map(|one| std::array::from_fn(|_| one.clone())))
        };
        self.sensor(header)
            .and_then(|s| all(&s.coil_temperature_channel, &s.coil_temperature_channels))
            .or_else(|| all(&self.coil_temperature_channel, &self.coil_temperature_channels))
            .unwrap_or_else(|| std::array::from_fn(|_| COIL_CHANNEL.to_owned()))
    }

    /// What is said of the sensor of a run.
    fn sensor(&self, header: &Header) -> Option<&SensorChannels> {
        self.sensors.iter().find(|s| s.name == header.sensor)
    }

    /// The highest order that the campaign gives the polynomials of sensitivities and angles of a run's sensor and mode.
    #[must_use]
    pub fn order_of_sensor(&self, header: &Header) -> Option<usize> {
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let own = self.thermal.iter().filter(|e| applies(&e.sensor, &header.sensor) && applies(&e.mode, &header.mode));
        let orders = own.flat_map(|e| &e.orders).filter(|(name, _)| name.starts_with("sigma") || name.starts_with("xi"));
        orders.map(|(_, order)| *order as usize).max()
    }

    /// The channel of the rack temperature; the facility has one rack, whichever the sensor.
    #[must_use]
    pub fn rack_channel(&self) -> &str {
        self.rack_temperature_channel.as_deref().unwrap_or(RACK_CHANNEL)
    }

    /// The field limits of a run along its nominal sensor axes, nT.
    #[must_use]
    pub fn limits_nt(&self, header: &Header) -> [Option<f64>; 3] {
        let applies = |wanted: &Option<String>, is: &str| wanted.as_deref().is_none_or(|w| w == is);
        let mut limits = [None; 3];
        for entry in self.limits.iter().filter(|l| applies(&l.sensor, &header.sensor) && applies(&l.mode, &header.mode)) {
            for (limit, new) in limits.iter_mut().zip(entry.max_field_nt) {
                *limit = Some(limit.map_or(new, |old: f64| old.min(new)));
            }
        }
        limits
    }
}
