//! The offset jumps once.

use super::{About, Column, Effect, Family, Record, Row, Spec};

/// Rows before the first and after the last onset.
const EDGE: usize = 3;
/// Most onsets that are tried.
const MOST_ONSETS: usize = 48;

/// The offset jumps once.
pub struct OffsetStep;

impl Effect for OffsetStep {
    fn id(&self) -> &'static str {
        "offset_step"
    }

    fn about(&self) -> About {
        About {
            summary: "offset jumps once",
            formula: "x_i += c for t > onset",
            family: Family::Time,
            seen_in: "all",
            needs: "time",
            source: "BC-MAG-TR-0085, remarks",
            best_measurement: "zero fields between the settings, and the run once more",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let times: Vec<f64> = record.rows.iter().map(Row::t_s).collect();
        let inner = times.len().saturating_sub(2 * EDGE);
        let stride = (inner / MOST_ONSETS).max(1);
        let onsets = (EDGE..times.len().saturating_sub(EDGE)).step_by(stride).map(|i| 0.5 * (times[i - 1] + times[i]));
        let axes = [&[0][..], &[1], &[2], &[0, 1, 2]];
        Ok(onsets.flat_map(|onset| axes.map(|a| Spec::new("step", a).with("onset", onset, "s"))).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let onset_s = spec.get("onset")?;
        let after = |t: f64| if t > onset_s { 1.0 } else { 0.0 };
        Some(spec.axes.iter().map(|&a| Column::on("c", a, "enT", record, |_, r| after(r.t_s()))).collect())
    }
}
