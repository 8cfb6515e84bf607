//! The sampling frequency moves during the run.

use super::{About, Column, Effect, Family, Record, Spec};

/// The sampling frequency moves during the run.
pub struct ClockDrift;

impl Effect for ClockDrift {
    fn id(&self) -> &'static str {
        "clock_drift"
    }

    fn about(&self) -> About {
        About {
            summary: "f_s moves during the run",
            formula: "f_s (1 + d (t - t_0))",
            family: Family::Periodic,
            seen_in: "freq",
            needs: "phases of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "the first frequency once more at the end",
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
