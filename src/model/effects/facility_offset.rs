//! The offsets of the coil calibration are wrong.

use super::{About, Column, Effect, Family, Record, Spec};

/// The offsets of the coil calibration are wrong.
pub struct FacilityOffset;

impl Effect for FacilityOffset {
    fn id(&self) -> &'static str {
        "facility_offset"
    }

    fn about(&self) -> About {
        About {
            summary: "offset fields of the coil calibration are wrong",
            formula: "B += b, coil axes: the offset of the sensor axis along k appears changed by b_k",
            family: Family::Facility,
            seen_in: "several positions",
            needs: "runs of one sensor in several positions",
            source: "CH-GFZ-TR-2601 sections 7 and 9",
            best_measurement: "the sensor turned by 180 degrees",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("absorbed by the offset in one position".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
