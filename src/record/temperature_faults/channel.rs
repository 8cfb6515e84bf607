//! A temperature channel as its faults see it: its readings and how it moves between them.

use super::{ChannelFault, Fault};
use crate::data::run::SlowTable;
use crate::fit::statistics::{median, robust_std};

/// An interval between readings of this many usual ones is a gap.
pub(super) const GAP: f64 = 3.0;

/// A channel with its readings.
pub(super) struct Channel<'a> {
    pub(super) name: &'a str,
    pub(super) series: Vec<(f64, f64)>,
    pub(super) interval_s: f64,
    pub(super) median: f64,
}

impl<'a> Channel<'a> {
    /// `None` if it has too few readings to be judged.
    pub(super) fn of(table: &SlowTable, name: &'a str) -> Option<Self> {
        const LEAST_READINGS: usize = 4;
        let series = table.channel(name).filter(|s| s.len() >= LEAST_READINGS)?;
        let interval_s = usual_interval_s(&series);
        let median = median(&mut series.iter().map(|(_, v)| *v).collect::<Vec<f64>>());
        Some(Self { name, series, interval_s, median })
    }

    /// All of a table that can be judged.
    pub(super) fn all(table: &'a SlowTable) -> Vec<Self> {
        table.names.iter().filter_map(|name| Self::of(table, name)).collect()
    }

    pub(super) fn fault(&self, fault: Fault, probability: f64) -> ChannelFault {
        ChannelFault { channel: self.name.to_owned(), fault, probability: probability.min(1.0) }
    }

    /// Changes between readings that follow each other: place of the second one, size, K, and size per usual interval.
    pub(super) fn changes(&self) -> Vec<(usize, f64, f64)> {
        let longest_s = GAP * self.interval_s;
        let pairs = self.series.windows(2).enumerate();
        pairs
            .map(|(i, w)| (i + 1, w[1].1 - w[0].1, w[1].0 - w[0].0))
            .filter(|(_, _, dt_s)| *dt_s > 0.0 && *dt_s <= longest_s)
            .map(|(place, by_k, dt_s)| (place, by_k, by_k * self.interval_s / dt_s))
            .collect()
    }

    /// Standard deviation of the changes from reading to reading by noise, K: from what they differ by from the usual one, or from those beside
    /// them where the channel rises and falls. Of white noise the latter has 5/2 of their variance.
    pub(super) fn noise_of_changes_k(&self, changes: &[(usize, f64, f64)]) -> f64 {
        let usual = median(&mut changes.iter().map(|(_, _, rate)| *rate).collect::<Vec<f64>>());
        let about = robust_std(changes.iter().map(|(_, _, rate)| rate - usual));
        // Of fewer than three changes it is no number, and the smaller one is the other.
        let beside = robust_std(changes.windows(3).map(|w| w[1].2 - 0.5 * (w[0].2 + w[2].2)));
        about.min(beside / 2.5f64.sqrt())
    }
}

/// Median of the intervals between readings, s.
pub(super) fn usual_interval_s(series: &[(f64, f64)]) -> f64 {
    let mut intervals: Vec<f64> = series.windows(2).map(|w| w[1].0 - w[0].0).collect();
    if intervals.is_empty() { 0.0 } else { median(&mut intervals) }
}
