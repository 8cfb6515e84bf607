//! The offset moves with the sensor temperature inside a run.

use super::coil_temperature::moves;
use super::record::centred;
use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

/// Its forms; the bent one as the offsets of fluxgates are over wide ranges of temperature.
const FORMS: [&str; 2] = ["linear", "quadratic"];

/// The offset moves with the sensor temperature inside a run.
pub struct SensorTemperatureOffset;

impl Effect for SensorTemperatureOffset {
    fn id(&self) -> &'static str {
        "sensor_temperature_offset"
    }

    fn about(&self) -> About {
        About {
            summary: "offset moves with the sensor temperature inside a run",
            formula: "x_i += b_i (T - T_0), or b_i (T - T_0) + b2_i (T - T_0)²; T_0 is the mean over the run",
            family: Family::Thermal,
            seen_in: "lin, sweep, zero-field",
            needs: "sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "zero field while the sensor alone is heated and cooled",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        moves(record.sensor.as_ref(), "sensor temperature")?;
        Ok(FORMS.iter().flat_map(|form| singly_and_together(form)).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = centred(record.sensor.as_ref()?);
        let of = |name: &str, unit, power: i32| -> Vec<Column> {
            spec.axes.iter().map(|&a| Column::on(name, a, unit, record, |i, _| deviation[i].powi(power))).collect()
        };
        let order = FORMS.iter().position(|form| *form == spec.form)?;
        let names = [("b", "enT/K"), ("b2", "enT/K^2")];
        let columns =
            names.into_iter().zip(1..).take(order + 1).flat_map(|((name, unit), power)| of(name, unit, power)).collect();
        Some(columns)
    }
}
