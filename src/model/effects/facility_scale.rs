//! The scale factors of the coil calibration are wrong.

use super::{About, Column, Effect, Family, Record, Spec};

/// The scale factors of the coil calibration are wrong.
pub struct FacilityScale;

impl Effect for FacilityScale {
    fn id(&self) -> &'static str {
        "facility_scale"
    }

    fn about(&self) -> About {
        About {
            summary: "scale factors of the coil calibration are wrong",
            formula: "B_k (1 + s_k) on coil axis k: σ of the sensor axis along k appears as σ (1 - s_k)",
            family: Family::Facility,
            seen_in: "several positions",
            needs: "runs of one sensor in several positions",
            source: "CH-GFZ-TR-2601 sections 7 and 9",
            best_measurement: "the sensor turned so that every axis looks along two coil axes",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("absorbed by the sensitivities in one position".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
