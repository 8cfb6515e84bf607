//! The offsets of the coil calibration are wrong.

use super::between::{BetweenRuns, Runs, calibration};
use super::{About, Acts, Effect, Family, PART_OF_THE_AMPLITUDE, Unseen};
use crate::data::run::Kind;
use crate::model::position::Class;

/// Why one run cannot show it.
const ABSORBED: Unseen = Unseen::Stated("absorbed by the offset in one position");

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::BetweenRuns]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        Some(if kind == Kind::Frequency { PART_OF_THE_AMPLITUDE } else { ABSORBED })
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        Some(calibration(runs, Class::Offset, "offset", "nT"))
    }
}
