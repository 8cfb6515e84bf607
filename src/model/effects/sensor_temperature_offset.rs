//! The offset moves with the sensor temperature inside a run.

use super::between::{BetweenRuns, Runs, sensor_temperature};
use super::coil_temperature::moving;
use super::{
    About, Acts, Column, Effect, Family, PART_OF_THE_OFFSETS, Record, ShapeParameter, Spec, Unseen, singly_and_together,
};
use crate::data::run::Kind;
use crate::model::position::Class;

/// The bent form, as the offsets of fluxgates are over wide ranges of temperature.
const BENT: &str = "quadratic";

/// The straight form.
const STRAIGHT: &str = "linear";
/// Shape of the bent form: the temperature to which its slope belongs.
const REFERENCE: &str = "t_0";

/// The offset moves with the sensor temperature inside a run.
pub struct SensorTemperatureOffset;

impl Effect for SensorTemperatureOffset {
    fn id(&self) -> &'static str {
        "sensor_temperature_offset"
    }

    fn about(&self) -> About {
        About {
            summary: "offset moves with the sensor temperature inside a run",
            formula: "x_i += b_i (T - T_0), or b_i (T - T_0) + b2_i (T - T_0)²; T_0 is the mean over the run in which it was found",
            family: Family::Thermal,
            seen_in: "lin, sweep, zero-field",
            needs: "sensor temperature",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "zero field while the sensor alone is heated and cooled",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::fixed(REFERENCE, "degC")] }
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some("sensor temperature".to_owned())
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_OFFSETS)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let mean = moving(record.sensor.as_ref(), "sensor temperature")?.mean;
        // The slope of a bent curve holds at a temperature, which goes with it to other runs.
        let bent = singly_and_together(BENT).into_iter().map(|spec| spec.with(REFERENCE, mean, "degC"));
        Ok(singly_and_together(STRAIGHT).into_iter().chain(bent).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let channel = record.sensor.as_ref()?;
        let bent = spec.form == BENT;
        let reference = if bent { spec.get(REFERENCE)? } else { channel.mean };
        let of = |name: &str, unit, power: i32| -> Vec<Column> {
            let value = |i: usize| (channel.values[i] - reference).powi(power);
            spec.axes.iter().map(|&a| Column::on(name, a, unit, record, |i, _| value(i))).collect()
        };
        let mut columns = of("b", record.scale.per_kelvin(), 1);
        if bent {
            columns.extend(of("b2", record.scale.per_kelvin_squared(), 2));
        }
        Some(columns)
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        Some(sensor_temperature(runs, Class::Offset, "b", "nT/K"))
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    /// What a bent curve adds at 31 °C does not depend on the mean temperature of the run that asks.
    #[test]
    fn the_reference_temperature_of_a_bent_curve_goes_with_it() {
        let spec = Spec::new(BENT, &[0]).with(REFERENCE, 20.0, "degC");
        let at_31_degc = |shift_k: f64| {
            let mut record = example::of(&SensorTemperatureOffset).unwrap().record;
            let sensor = record.sensor.as_mut().unwrap();
            sensor.values.iter_mut().for_each(|v| *v += shift_k);
            sensor.mean += shift_k;
            sensor.values[3] = 31.0;
            let columns = SensorTemperatureOffset.columns(&record, &spec).unwrap();
            [columns[0].values[3][0], columns[1].values[3][0]]
        };
        assert_eq!(at_31_degc(0.0), [11.0, 121.0]);
        assert_eq!(at_31_degc(-40.0), [11.0, 121.0]);
    }
}
