//! The dynamic compensation of the Earth field is imperfect.

use super::coil_temperature::moves;
use super::record::centred;
use super::{About, Column, Effect, Family, Record, Spec, one, singly_and_together};
use crate::units::COMPONENTS;

/// The dynamic compensation of the Earth field is imperfect.
pub struct EarthfieldLeakage;

impl Effect for EarthfieldLeakage {
    fn id(&self) -> &'static str {
        "earthfield_leakage"
    }

    fn about(&self) -> About {
        About {
            summary: "imperfect dynamic compensation of the Earth field",
            formula: "B_k += κ_k variometer_k on coil axis k",
            family: Family::Facility,
            seen_in: "lin, zero-field",
            needs: "variometer",
            source: "BC-MAG-TR-0085 section 8",
            best_measurement: "zero field during a disturbed night, with the variometer recorded",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let variometer = record.variometer.as_ref().ok_or("no variometer was recorded")?;
        variometer.iter().try_for_each(|channel| moves(Some(channel), "variometer"))?;
        Ok(singly_and_together("own axis"))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let variometer = record.variometer.as_ref()?;
        let deviations = [0, 1, 2].map(|k: usize| centred(&variometer[k]));
        let column = |&k: &usize| {
            Column::of(format!("kappa_{}", COMPONENTS[k]), "nT/nT", record, |i, _| record.reading(one(k, deviations[k][i])))
        };
        Some(spec.axes.iter().map(column).collect())
    }
}
