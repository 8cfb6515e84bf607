//! The angles of the coil calibration are wrong.

use super::{About, Column, Effect, Family, Record, Spec};

/// The angles of the coil calibration are wrong.
pub struct FacilityAngle;

impl Effect for FacilityAngle {
    fn id(&self) -> &'static str {
        "facility_angle"
    }

    fn about(&self) -> About {
        About {
            summary: "angles between the coil axes are wrong",
            formula: "the angles between the sensor axes appear changed by those of the coil axes along which they look",
            family: Family::Facility,
            seen_in: "several positions",
            needs: "runs of one sensor in several positions",
            source: "CH-GFZ-TR-2601 sections 7 and 9",
            best_measurement: "the sensor turned so that every pair of its axes looks along two pairs of coil axes",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("absorbed by rotation and misalignment in one position".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
