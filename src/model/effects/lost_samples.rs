//! Stretches of samples are missing or overlap.

use super::{About, Acts, Effect, Family, Unseen};
use crate::data::run::Kind;

/// Stretches of samples are missing or overlap.
pub struct LostSamples;

impl Effect for LostSamples {
    fn id(&self) -> &'static str {
        "lost_samples"
    }

    fn about(&self) -> About {
        About {
            summary: "stretches missing or overlapping",
            formula: "amplitude or phase breaks inside a setting",
            family: Family::DataFault,
            seen_in: "freq",
            needs: "samples of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "the damaged settings once more",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Sines]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind != Kind::Frequency).then_some(Unseen::NeedsSines)
    }
}
