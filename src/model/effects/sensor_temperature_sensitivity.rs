//! The sensitivity moves with the sensor temperature inside a run.

use super::between::{BetweenRuns, Runs, sensor_temperature};
use super::coil_temperature::moving;
use super::record::centred;
use super::{About, Acts, Column, Effect, Family, GAIN_WITH, PART_OF_THE_AMPLITUDE, Record, Spec, Unseen, singly_and_together};
use crate::data::run::Kind;
use crate::model::position::Class;

/// The sensitivity moves with the sensor temperature inside a run.
pub struct SensorTemperatureSensitivity;

impl Effect for SensorTemperatureSensitivity {
    fn id(&self) -> &'static str {
        "sensor_temperature_sensitivity"
    }

    fn about(&self) -> About {
        About {
            summary: "σ moves with the sensor temperature inside a run",
            formula: "σ_i (1 + a_i (T - T_0)): x_i += -a_i (T - T_0) x_i; T_0 is the mean over the run",
            family: Family::Thermal,
            seen_in: "lin, sweep",
            needs: "sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "the same settings at two sensor temperatures",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some(format!("{GAIN_WITH}sensor temperature"))
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        moving(record.sensor.as_ref(), "sensor temperature")?;
        Ok(singly_and_together("linear"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = centred(record.sensor.as_ref()?);
        Some(spec.axes.iter().map(|&a| Column::on("a", a, "1/K", record, |i, r| -deviation[i] * r.linear_ent[a])).collect())
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        Some(sensor_temperature(runs, Class::Scale, "a", "1/K"))
    }
}
