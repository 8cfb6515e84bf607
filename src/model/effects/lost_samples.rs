//! Stretches of samples are missing or overlap.

use super::{About, Column, Effect, Family, Record, Spec};

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("needs a frequency run".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
