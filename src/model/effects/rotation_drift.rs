//! The sensor turns in its mount with time or temperature.

use super::coil_temperature::moving;
use super::record::centred;
use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, Spec, Unseen, one, singly_and_together};
use crate::data::run::Kind;
use crate::data::units::COMPONENTS;
use nalgebra::Vector3;

/// Form: the angles grow with time.
const IN_TIME: &str = "time";
/// Form: the angles follow the temperature of the sensor.
const WITH_TEMPERATURE: &str = "temperature";

/// The sensor turns in its mount with time or temperature.
pub struct RotationDrift;

impl Effect for RotationDrift {
    fn id(&self) -> &'static str {
        "rotation_drift"
    }

    fn about(&self) -> About {
        About {
            summary: "the sensor turns in its mount with time or temperature",
            formula: "B_c is turned by small angles θ_k v about the coil axes k, v = time from -1 to 1 over the run (time) or T - T_0 (temperature)",
            family: Family::Time,
            seen_in: "lin, sweep",
            needs: "time or sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "the first settings once more at the end, or at another temperature",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn is_of_one_run(&self, form: &str) -> bool {
        form == IN_TIME
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        let mut specs = singly_and_together(IN_TIME);
        if record.thermal.is_none() && moving(record.sensor.as_ref(), "sensor temperature").is_ok() {
            specs.extend(singly_and_together(WITH_TEMPERATURE));
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let with_temperature = spec.form == WITH_TEMPERATURE;
        let deviation = if with_temperature { centred(record.sensor.as_ref()?) } else { Vec::new() };
        let unit = if with_temperature { "rad/K" } else { "rad" };
        let column = |&k: &usize| {
            Column::of(format!("theta_{}", COMPONENTS[k]), unit, record, |i, r| {
                let v = if with_temperature { deviation[i] } else { record.tau(r.t_s()) };
                let turned = Vector3::from(one(k, v)).cross(&Vector3::from(r.field_coil_nt));
                record.reading(turned.into())
            })
        };
        Some(spec.axes.iter().map(column).collect())
    }
}
