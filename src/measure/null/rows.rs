//! The means of a long record, and the slow channels beside them.

use super::record::Kept;
use crate::data::run::{Run, SlowTable};
use crate::fit::allan::Bin;
use crate::fit::noise::dense::Octave;
use serde::Serialize;

/// Means to which drift and coefficients are fitted, at most.
pub const ROWS: usize = 128;
/// Part of a mean's samples that must be there.
const LEAST_COVERAGE: f64 = 0.5;

/// Value and standard uncertainty per component.
pub type Level = [[f64; 2]; 3];

/// Mean of a stretch of the record.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Begin and end, s since the run's start.
    pub interval_s: [f64; 2],
    /// Mean reading, enT.
    pub mean_ent: [f64; 3],
    /// Samples.
    pub count: u64,
    /// The drift that was fitted, and its standard uncertainty, enT.
    pub drift_ent: Level,
}

impl Row {
    /// Its middle, s.
    #[must_use]
    pub fn t_s(&self) -> f64 {
        0.5 * (self.interval_s[0] + self.interval_s[1])
    }
}

/// Means of bins side by side, and the number of bins in each.
pub(super) fn rows(record: &Kept, begin_s: f64, bin_s: f64) -> (Vec<Row>, usize) {
    let width = record.bins.len().div_ceil(ROWS).max(1);
    let rows = record.bins.chunks(width).enumerate().filter_map(|(i, bins)| {
        let count: u64 = bins.iter().map(|b| u64::from(b.count)).sum();
        let full = (width as u64 * record.bin_samples) as f64;
        let begin = begin_s + (i * width) as f64 * bin_s;
        let row = Row {
            interval_s: [begin, begin + bins.len() as f64 * bin_s],
            mean_ent: std::array::from_fn(|c| record.reference[c] + bins.iter().map(|b| b.sum[c]).sum::<f64>() / count as f64),
            count,
            drift_ent: [[f64::NAN; 2]; 3],
        };
        (count as f64 >= LEAST_COVERAGE * full).then_some(row)
    });
    (rows.collect(), width)
}

/// Contrasts of neighbouring parts within the rows, from one bin up to half a row.
pub(super) fn octaves(bins: &[Bin], width: usize, bin_s: f64, bin_samples: u64) -> Vec<Octave> {
    let mut octaves = Vec::new();
    let mut length = 1;
    while 2 * length <= width {
        let mut octave = Octave {
            length: length as f64 * bin_s,
            count: 0.0,
            white: 2.0 / (length as f64 * bin_samples as f64),
            squares: vec![0.0; 3],
        };
        for row in bins.chunks(width) {
            for pair in row.chunks_exact(2 * length) {
                if pair.iter().all(|b| u64::from(b.count) == bin_samples) {
                    let mean = |part: &[Bin], c: usize| part.iter().map(|b| b.sum[c]).sum::<f64>();
                    let (a, b) = pair.split_at(length);
                    for c in 0..3 {
                        octave.squares[c] += ((mean(b, c) - mean(a, c)) / (length as f64 * bin_samples as f64)).powi(2);
                    }
                    octave.count += 1.0;
                }
            }
        }
        if octave.count > 0.0 {
            octaves.push(octave);
        }
        length *= 2;
    }
    octaves
}

/// Unit of the readings of a channel in a coefficient.
pub(super) fn unit(run: &Run, channel: &str) -> &'static str {
    if run.temperatures.names.iter().any(|n| n == channel) {
        "K"
    } else if channel.starts_with("VAR") {
        "nT"
    } else {
        "unit of the channel"
    }
}

/// Means of the slow channels over the rows; between readings a straight line.
pub(super) fn channel_rows(run: &Run, rows: &[Row]) -> Vec<(String, Vec<f64>)> {
    let of = |table: &SlowTable| -> Vec<(String, Vec<f64>)> {
        table
            .names
            .iter()
            .filter_map(|name| Some((name.clone(), table.channel(name)?)))
            .map(|(name, series)| (name, rows.iter().map(|row| mean_over(&series, row)).collect()))
            .collect()
    };
    let mut list = of(&run.temperatures);
    for (name, values) in of(&run.channels) {
        if !list.iter().any(|(n, _)| *n == name) {
            list.push((name, values));
        }
    }
    list
}

fn mean_over(series: &[(f64, f64)], row: &Row) -> f64 {
    let [from, until] = row.interval_s;
    let first = series.partition_point(|(t, _)| *t < from);
    let after = series.partition_point(|(t, _)| *t <= until);
    if after > first {
        return series[first..after].iter().map(|(_, v)| v).sum::<f64>() / (after - first) as f64;
    }
    match (first.checked_sub(1).and_then(|i| series.get(i)), series.get(first)) {
        (Some((t0, v0)), Some((t1, v1))) => v0 + (v1 - v0) * (row.t_s() - t0) / (t1 - t0),
        _ => f64::NAN,
    }
}
