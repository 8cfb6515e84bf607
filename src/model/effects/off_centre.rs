//! The sensor is not at the centre of the coils.

use super::{About, Column, Effect, Family, Record, Spec};

/// The sensor is not at the centre of the coils.
pub struct OffCentre;

impl Effect for OffCentre {
    fn id(&self) -> &'static str {
        "off_centre"
    }

    fn about(&self) -> About {
        About {
            summary: "sensor not at the coil centre",
            formula: "σ¹_i = k_i σ⁰_i, ω¹ = ω⁰ K",
            family: Family::Facility,
            seen_in: "two sets of runs",
            needs: "runs at the centre and beside it",
            source: "RO-IGEP-TR0028 section 3.2.2",
            best_measurement: "one linear calibration at the centre at the same temperature",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("absorbed by sensitivity and misalignment in one place".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
