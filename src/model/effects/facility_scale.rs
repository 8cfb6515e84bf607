//! The scale factors of the coil calibration are wrong.

use super::between::{BetweenRuns, Runs, calibration};
use super::{About, Acts, Effect, Family, PART_OF_THE_AMPLITUDE, Unseen};
use crate::data::run::Kind;
use crate::model::position::Class;

/// What of it no set of orientations shows.
const COMMON_SCALE: Unseen =
    Unseen::Stated("of its three factors two ratios: the common scale of coil system and sensor is seen by no orientation");
/// Why one run cannot show it.
const ABSORBED: Unseen = Unseen::Stated("absorbed by the sensitivities in one position");

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::BetweenRuns]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        Some(if kind == Kind::Frequency { PART_OF_THE_AMPLITUDE } else { ABSORBED })
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let made = calibration(runs, Class::Scale, "scale", "");
        let unseen = made.unseen.or(Some(COMMON_SCALE));
        Some(BetweenRuns { unseen, ..made })
    }
}
