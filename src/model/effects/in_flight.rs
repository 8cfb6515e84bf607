//! What the difference of two sensors in flight, or of a sensor and a model of the field, may follow beside time and the temperature of the
//! sensor: heaters, wheels, the temperature of the other sensor, the field itself. They are no part of a ground campaign, so that the
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
/// How the channels of the components of the field begin, nT.
pub const FIELD: &str = "field ";

/// A reading that follows a channel of the spacecraft in proportion.
struct Follows {
    id: &'static str,
    begin: &'static str,
    unit: &'static str,
    about: About,
}

const SOURCE: &str = "RO-IGEP-TR0028 section 4";

static HEATER_FIELD: Follows = Follows {
    id: "heater_field",
    begin: HEATER,
    unit: "nT",
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
    about: About {
        summary: "offset of the other sensor moves with its temperature",
        formula: "B_i += b_i (T - T_0), T the temperature of the other sensor, T_0 its mean",
        family: Family::Thermal,
        seen_in: "flight",
        needs: "temperatures of both sensors",
        source: SOURCE,
        best_measurement: "a time in which the temperatures of both sensors move apart",
    },
};
static FIELD_DIFFERENCE: Follows = Follows {
    id: "field_difference",
    begin: FIELD,
    unit: "nT/nT",
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

/// The effects that the difference of two sensors, or of a sensor and a model, may have in flight.
#[must_use]
pub fn catalogue() -> Catalogue {
    Catalogue::of(&[
        &SensorTemperatureOffset,
        &OTHER_TEMPERATURE,
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
        Ok(own.into_iter().flat_map(|channel| singly_and_together(&channel.name)).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let channel = record.others.iter().find(|channel| channel.name == spec.form)?;
        let values = centred(channel);
        Some(spec.axes.iter().map(|&a| Column::on(&channel.name, a, self.unit, record, |i, _| values[i])).collect())
    }
}
