//! The offset moves with the sensor temperature inside a run.

use super::coil_temperature::moves;
use super::record::centred;
use super::{About, Column, Effect, Family, Record, Spec, singly_and_together};

/// The offset moves with the sensor temperature inside a run.
pub struct SensorTemperatureOffset;

impl Effect for SensorTemperatureOffset {
    fn id(&self) -> &'static str {
        "sensor_temperature_offset"
    }

    fn about(&self) -> About {
        About {
            summary: "offset moves with the sensor temperature inside a run",
            formula: "x_i += b_i (T - T_0); T_0 is the mean over the run",
            family: Family::Thermal,
            seen_in: "lin, sweep, zero-field",
            needs: "sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "zero field while the sensor alone is heated and cooled",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        moves(record.sensor.as_ref(), "sensor temperature")?;
        Ok(singly_and_together("linear"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = centred(record.sensor.as_ref()?);
        Some(spec.axes.iter().map(|&a| Column::on("b", a, "enT/K", record, |i, _| deviation[i])).collect())
    }
}
