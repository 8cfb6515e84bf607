//! The electronics of the facility follow the temperature of their rack.

use super::coil_temperature::{moves, scale_columns};
use super::record::centred;
use super::{About, Column, Effect, Family, Record, Spec, one, singly_and_together};
use crate::units::COMPONENTS;

/// The electronics of the facility follow the temperature of their rack.
pub struct RackTemperature;

impl Effect for RackTemperature {
    fn id(&self) -> &'static str {
        "rack_temperature"
    }

    fn about(&self) -> About {
        About {
            summary: "facility electronics follow the rack temperature",
            formula: "B_k += β_k (T_rack - T_0) (offset) or B_k (1 + β_k (T_rack - T_0)) (scale) on coil axis k; T_0 is the mean over the run",
            family: Family::Facility,
            seen_in: "lin, sweep",
            needs: "rack temperature",
            source: "CH-GFZ-TR-2601 section 6",
            best_measurement: "zero and full field by turns while the rack warms up, the coils at one temperature",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        moves(record.rack.as_ref(), "rack temperature")?;
        let mut specs = singly_and_together("offset");
        if record.has_fields() {
            specs.extend(singly_and_together("scale"));
            specs.push(Spec::new("common scale", &[0, 1, 2]));
        }
        Ok(specs)
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = centred(record.rack.as_ref()?);
        if spec.form != "offset" {
            return Some(scale_columns(record, spec, "scale", &deviation));
        }
        let column = |&k: &usize| {
            Column::of(format!("offset_{}", COMPONENTS[k]), "nT/K", record, |i, _| record.reading(one(k, deviation[i])))
        };
        Some(spec.axes.iter().map(column).collect())
    }
}
