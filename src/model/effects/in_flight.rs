//! What the difference of two sensors in flight, or of a sensor and a model of the field, may follow beside time and the temperature of the
//! sensor: heaters, wheels, the temperature of the other sensor, the rates of temperatures, the field itself. They are no part of a ground campaign, so that the
//! standard catalogue does not have them; [`catalogue`] does.

use super::offset_drift::OffsetDrift;
use super::offset_step::OffsetStep;
use super::record::{Channel, centred};
use super::sensor_temperature_offset::SensorTemperatureOffset;
use super::{About, Acts, Catalogue, Column, Effect, Family, Record, Spec, Unseen, singly_and_together};

/// How the channels of heaters begin: the share of a row in which one is on.
pub const HEATER: &str = "heater ";
/// How the channels of wheels begin: rotations per second.
pub const WHEEL: &str = "wheel ";
/// How the channels of temperatures of other sensors begin, °C.
pub const TEMPERATURE: &str = "temperature ";
/// How the channels of the rates of temperatures begin, K/s.
pub const RATE: &str = "rate of temperature ";
/// How the channels of the components of the field begin, nT.
pub const FIELD: &str = "field ";

/// A reading that follows a channel of the spacecraft in proportion, or along a parabola.
struct Follows {
    id: &'static str,
    begin: &'static str,
    unit: &'static str,
    /// Unit of the curvature, where it may follow a parabola.
    bent: Option<&'static str>,
    about: About,
}

const SOURCE: &str = "RO-IGEP-TR0028 section 4";

static HEATER_FIELD: Follows = Follows {
    id: "heater_field",
    begin: HEATER,
    unit: "nT",
    bent: None,
    about: About {
        summary: "field of a heater, or of what is switched with it",
        formula: "B_i += h_i s, s the share of the time in which the heater is on",
        family: Family::Facility,
        seen_in: "flight",
        needs: "table of heater states",
        source: SOURCE,
        best_measurement: "the heater switched by itself while all else stays",
    },
};
static WHEEL_FIELD: Follows = Follows {
    id: "wheel_field",
    begin: WHEEL,
    unit: "nT/Hz",
    bent: None,
    about: About {
        summary: "field that changes with the rate of a reaction wheel",
        formula: "B_i += w_i (f - f_0), f the rotations per second, f_0 their mean",
        family: Family::Facility,
        seen_in: "flight",
        needs: "table of wheel rates",
        source: SOURCE,
        best_measurement: "one wheel at several rates while the others stay",
    },
};
static OTHER_TEMPERATURE: Follows = Follows {
    id: "other_sensor_temperature",
    begin: TEMPERATURE,
    unit: "nT/K",
    bent: Some("nT/K^2"),
    about: About {
        summary: "offset of the other sensor moves with its temperature",
        formula: "B_i += b_i (T - T_0), or b_i (T - T_0) + b2_i (T - T_0)²; T is the temperature of the other sensor, T_0 its mean",
        family: Family::Thermal,
        seen_in: "flight",
        needs: "temperatures of both sensors",
        source: SOURCE,
        best_measurement: "a time in which the temperatures of both sensors move apart",
    },
};
static TEMPERATURE_RATE: Follows = Follows {
    id: "temperature_rate",
    begin: RATE,
    unit: "nT s/K",
    bent: None,
    about: About {
        summary: "offset follows the thermistor late or early: it is read at another moment, or warms before or after the sensor",
        formula: "B_i += r_i dT/dt, dT/dt the rate of the temperature; r_i is the slope of the offset times the delay",
        family: Family::Thermal,
        seen_in: "flight",
        needs: "temperature of a sensor",
        source: SOURCE,
        best_measurement: "a time in which the temperature moves fast beside one in which it rests",
    },
};
static FIELD_DIFFERENCE: Follows = Follows {
    id: "field_difference",
    begin: FIELD,
    unit: "nT/nT",
    bent: None,
    about: About {
        summary: "sensitivity or axes differ from those that the model of the field is compared in",
        formula: "B_i += m_ik (B_k - B_0k), B_k a component of the field, B_0k its mean",
        family: Family::Facility,
        seen_in: "flight",
        needs: "a field that changes",
        source: SOURCE,
        best_measurement: "a large field that turns, as near a planet or in a slew",
    },
};

/// Behind the name of a channel, the form that is a parabola.
const BENT: &str = ", bent";
/// Before what the names of channels begin with, the form of all of them: in the difference of two sensors both act at once.
const EVERY: &str = "every ";

/// The effects that the difference of two sensors, or of a sensor and a model, may have in flight.
#[must_use]
pub fn catalogue() -> Catalogue {
    Catalogue::of(&[
        &SensorTemperatureOffset,
        &OTHER_TEMPERATURE,
        &TEMPERATURE_RATE,
        &HEATER_FIELD,
        &WHEEL_FIELD,
        &FIELD_DIFFERENCE,
        &OffsetDrift,
        &OffsetStep,
    ])
}

fn moves(channel: &Channel) -> bool {
    channel.values.iter().any(|v| *v != channel.values[0]) && channel.values.iter().all(|v| v.is_finite())
}

impl Effect for Follows {
    fn id(&self) -> &'static str {
        self.id
    }

    fn about(&self) -> About {
        self.about
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let own: Vec<&Channel> = record.others.iter().filter(|c| c.name.starts_with(self.begin) && moves(c)).collect();
        if own.is_empty() {
            return Err(Unseen::Stated("what it follows is not given, or does not change"));
        }
        let forms = |channel: &Channel| {
            let bent = self.bent.map(|_| format!("{}{BENT}", channel.name));
            std::iter::once(channel.name.clone()).chain(bent)
        };
        let every = (own.len() > 1).then(|| format!("{EVERY}{}", self.begin.trim_end()));
        Ok(own.into_iter().flat_map(forms).chain(every).flat_map(|form| singly_and_together(&form)).collect())
    }

    /// One heater, one wheel, one temperature is an explanation.
    fn follows(&self, spec: &Spec) -> Option<String> {
        Some(spec.form.strip_suffix(BENT).unwrap_or(&spec.form).to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let straight = spec.form.strip_suffix(BENT);
        let (name, of_all) = (straight.unwrap_or(&spec.form), spec.form.strip_prefix(EVERY));
        let is_meant = |channel: &&Channel| match of_all {
            Some(begin) => channel.name.starts_with(begin) && moves(channel),
            None => channel.name == name,
        };
        let mut columns = Vec::new();
        for channel in record.others.iter().filter(is_meant) {
            let values = centred(channel);
            let of = |name: &str, unit, power: i32| -> Vec<Column> {
                spec.axes.iter().map(|&a| Column::on(name, a, unit, record, |i, _| values[i].powi(power))).collect()
            };
            columns.extend(of(&channel.name, self.unit, 1));
            if let Some(unit) = self.bent.filter(|_| straight.is_some()) {
                columns.extend(of(&format!("{} squared", channel.name), unit, 2));
            }
        }
        (!columns.is_empty()).then_some(columns)
    }
}
