//! The sensor turns in its mount with time or temperature.

use super::coil_temperature::moving;
use super::record::centred;
use super::{About, Column, Effect, Family, Record, Spec, one, singly_and_together};
use crate::data::units::COMPONENTS;
use nalgebra::Vector3;

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        record.require_fields()?;
        let mut specs = singly_and_together("time");
        if record.thermal.is_none() && moving(record.sensor.as_ref(), "sensor temperature").is_ok() {
            specs.extend(singly_and_together("temperature"));
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let with_temperature = spec.form == "temperature";
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
