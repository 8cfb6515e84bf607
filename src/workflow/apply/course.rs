//! The temperatures of a table over its times, which show whether they can be those of a sensor.

use crate::record::temperature_faults::jumps_of;

/// Temperatures of a table in the order of their times: all of them in a short table, every second, fourth and so on in a longer one.
pub(super) struct Course {
    /// Readings, (s, °C).
    series: Vec<(f64, f64)>,
    /// One row of so many is kept.
    stride: usize,
    /// Rows so far.
    rows: usize,
    /// Whether the times go on from row to row. Without times, or where they go back, the rows are no course.
    pub(super) is_ordered: bool,
}

/// Temperatures of a table that are kept.
const MOST_KEPT: usize = 1 << 15;
/// A column that changes more often than this, and by jumps in half of the changes, is of a temperature that is stepped, or read now and then.
const MOST_STEPS: usize = 8;

impl Course {
    pub(super) fn new() -> Self {
        Self { series: Vec::new(), stride: 1, rows: 0, is_ordered: true }
    }

    pub(super) fn take(&mut self, t_s: &[f64], degc: &[f64]) {
        for (t_s, degc) in t_s.iter().copied().zip(degc.iter().copied()) {
            let is_kept = self.rows.is_multiple_of(self.stride);
            self.rows += 1;
            if !is_kept || !t_s.is_finite() || !degc.is_finite() {
                continue;
            }
            self.is_ordered &= self.series.last().is_none_or(|(before_s, _)| t_s > *before_s);
            if !self.is_ordered {
                return;
            }
            self.series.push((t_s, degc));
            if self.series.len() >= MOST_KEPT {
                let mut keep = false;
                self.series.retain(|_| {
                    keep = !keep;
                    keep
                });
                self.stride *= 2;
            }
        }
    }

    /// What is said of jumps that no thermistor of a sensor makes.
    pub(super) fn jumps(self, column: &str) -> Option<String> {
        if !self.is_ordered {
            return None;
        }
        let changes = self.series.windows(2).filter(|pair| pair[0].1 != pair[1].1).count();
        let jumps = jumps_of(self.series);
        let (t_s, by_k) = jumps.iter().copied().max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        if changes > MOST_STEPS && 2 * jumps.len() >= changes {
            return None;
        }
        let times = if jumps.len() == 1 { "once".to_owned() } else { format!("{} times, most", jumps.len()) };
        Some(format!(
            "its column `{column}` jumps {times} by {by_k:+.1} K at {t_s} s, faster than a sensor changes its temperature; the field is \
             computed with these temperatures, correct them if they are wrong"
        ))
    }
}
