//! The angles of the coil calibration are wrong.

use super::between::{BetweenRuns, Runs, calibration};
use super::{About, Acts, Effect, Family, PART_OF_THE_AMPLITUDE, Unseen};
use crate::data::run::Kind;
use crate::model::position::Class;

/// Why one run cannot show it.
const ABSORBED: Unseen = Unseen::Stated("absorbed by rotation and misalignment in one position");

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::BetweenRuns]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        Some(if kind == Kind::Frequency { PART_OF_THE_AMPLITUDE } else { ABSORBED })
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        Some(calibration(runs, Class::Angle, "angle", "deg"))
    }
}
