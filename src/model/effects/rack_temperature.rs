//! The electronics of the facility follow the temperature of their rack.

use super::coil_temperature::{LAG, deviation, moving, now_and_later, scale_columns};
use super::offset_drift::OffsetDrift;
use super::{
    About, Acts, Column, Effect, Family, GAIN_WITH, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen, one,
    singly_and_together,
};
use crate::data::run::Kind;
use crate::data::units::COMPONENTS;

/// Form: a field along each coil axis.
const OFFSET: &str = "offset";
/// Form: a scale factor for each coil axis.
const SCALE: &str = "scale";
/// Form: one scale factor for all.
const COMMON: &str = "common scale";

/// The electronics of the facility follow the temperature of their rack.
pub struct RackTemperature;

impl Effect for RackTemperature {
    fn id(&self) -> &'static str {
        "rack_temperature"
    }

    fn about(&self) -> About {
        About {
            summary: "facility electronics follow the rack temperature",
            formula: "B_k += β_k (T_rack - T_0) (offset) or B_k (1 + β_k (T_rack - T_0)) (scale) on coil axis k; T_0 is the mean over the run; T_rack at the time t, or at t - lag",
            family: Family::Facility,
            seen_in: "lin, sweep, zero-field",
            needs: "rack temperature",
            source: "CH-GFZ-TR-2601 section 6",
            best_measurement: "zero and full field by turns while the rack warms up, the coils at one temperature",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(LAG, "s")] }
    }

    /// A rack that goes to and fro is no likelier than a drift that does, of which more is asked beside noise.
    fn among_effects(&self, trend_order: Option<usize>) -> f64 {
        OffsetDrift.prior(trend_order)
    }

    fn shown_along(&self, spec: &Spec) -> Option<String> {
        let gain = if spec.form == OFFSET { "" } else { GAIN_WITH };
        Some(format!("{gain}rack temperature"))
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let rack = moving(record.rack.as_ref(), "rack temperature")?;
        let mut specs = singly_and_together(OFFSET);
        if record.has_fields() {
            specs.extend(singly_and_together(SCALE));
            specs.push(Spec::new(COMMON, &[0, 1, 2]));
        }
        Ok(now_and_later(specs, rack, record))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = deviation(record.rack.as_ref()?, record, spec);
        if spec.form != OFFSET {
            return Some(scale_columns(record, spec, spec.form == COMMON, "scale", &deviation));
        }
        let column = |&k: &usize| {
            Column::of(format!("offset_{}", COMPONENTS[k]), "nT/K", record, |i, _| record.reading(one(k, deviation[i])))
        };
        Some(spec.axes.iter().map(column).collect())
    }
}

#[cfg(test)]
mod tests {
    use super::super::example;
    use super::*;

    /// The rack of the example turns three times, `24 + cos(3 · 2π t/length)` °C: 60 s later the readings have what it was 60 s ago. An eighth
    /// of its period are 67 s: 15 and 60 s are tried on it, 240 s are not.
    #[test]
    fn a_late_rack_is_what_it_was() {
        let record = example::of(&RackTemperature).unwrap().record;
        let mut lags: Vec<f64> = RackTemperature.specs(&record).unwrap().iter().filter_map(|s| s.get(LAG)).collect();
        lags.dedup();
        assert_eq!(lags, [15.0, 60.0]);
        let spec = Spec::new(OFFSET, &[1]).with(LAG, 60.0, "s");
        let column = &RackTemperature.columns(&record, &spec).unwrap()[0];
        let length_s = record.span_s[1] - record.span_s[0];
        for (row, value) in record.rows.iter().zip(&column.values).filter(|(row, _)| row.t_s() > 60.0) {
            let then = (3.0 * std::f64::consts::TAU * (row.t_s() - 60.0) / length_s).cos();
            let mean = record.rack.as_ref().unwrap().mean - 24.0;
            // Readings of the rack stand 4 s apart, between which the line lies below the wave by 5e-4 at most.
            assert!((value[1] - (then - mean)).abs() < 6e-4 && value[0] == 0.0, "{} s: {value:?}", row.t_s());
        }
    }
}
