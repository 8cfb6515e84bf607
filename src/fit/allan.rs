//! Allan deviation of means over an averaging time.
//!
//! `σ²(τ) = ⟨(ȳ₂ - ȳ₁)²⟩ / 2` for neighbouring means over τ. White noise of standard deviation s per sample gives `s / sqrt(m)` for m
//! samples, a drift of rate d gives `d τ / √2`, 1/f noise of density `A/f` gives `sqrt(2 ln2 A)`. Degrees of freedom after NIST SP 1065,
//! section 5.4: the smaller one of those for white and for 1/f noise of the readings.

use super::spectrum;

/// Allan deviation at one averaging time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Deviation {
    /// Averaging time, s.
    pub tau_s: f64,
    /// Deviation per component.
    pub deviation: [f64; 3],
    /// Degrees of freedom.
    pub degrees_of_freedom: f64,
    /// Limits of 95 %, as factors on the deviation.
    pub limits: [f64; 2],
}

/// Sums over equal stretches of a record.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Bin {
    /// Sum of the samples.
    pub sum: [f64; 3],
    /// Number of samples.
    pub count: u32,
}

/// Squared differences of neighbouring means over powers of two of samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Differences {
    /// Sums of the squares.
    pub squares: [f64; 3],
    /// Number of differences.
    pub count: u64,
}

impl Differences {
    /// Adds those of a whole number of pairs of parts of `length` samples of one component; the caller counts.
    pub fn add(levels: &mut [Differences], component: usize, chunk: &[f64], work: &mut Vec<f64>) {
        work.clear();
        work.extend_from_slice(chunk);
        for level in levels {
            let half = work.len() / 2;
            let mut squares = 0.0;
            for i in 0..half {
                let (a, b) = (work[2 * i], work[2 * i + 1]);
                squares += (b - a) * (b - a);
                work[i] = 0.5 * (a + b);
            }
            work.truncate(half);
            level.squares[component] += squares;
        }
    }
}

/// Degrees of freedom of the overlapping estimate with m of N rows (NIST SP 1065, table 5), white and 1/f noise.
fn overlapping_freedom(rows: f64, m: f64) -> f64 {
    // In the table N counts phases, one more than rows.
    let n = rows + 1.0;
    let white = (3.0 * (n - 1.0) / (2.0 * m) - 2.0 * (n - 2.0) / n) * 4.0 * m * m / (4.0 * m * m + 5.0);
    let slow = if m < 1.5 { 2.0 * (n - 2.0).powi(2) / (2.3 * n - 4.9) } else { 5.0 * n * n / (4.0 * m * (n + 3.0 * m)) };
    white.min(slow).max(1.0)
}

/// Deviations at all powers of two of a sample: from differences within chunks, and overlapping ones from complete bins of `bin_samples`
/// samples up to a quarter of the record.
#[must_use]
pub fn deviations(within: &[Differences], bins: &[Bin], bin_samples: u64, rate_hz: f64) -> Vec<Deviation> {
    let mut out = Vec::new();
    for (level, differences) in within.iter().enumerate() {
        // Pairs that do not overlap carry one degree of freedom each when the noise is white; 1/f noise ties them a little.
        let degrees_of_freedom = 0.8 * differences.count as f64;
        if degrees_of_freedom >= 1.0 {
            out.push(Deviation {
                tau_s: (1u64 << level) as f64 / rate_hz,
                deviation: differences.squares.map(|s| (0.5 * s / differences.count as f64).sqrt()),
                degrees_of_freedom,
                limits: spectrum::limits(degrees_of_freedom),
            });
        }
    }
    let full = |bin: &Bin| u64::from(bin.count) == bin_samples;
    let mut sums = vec![[0.0; 3]];
    let mut complete = vec![0usize];
    for bin in bins {
        let (last, known) = (sums[sums.len() - 1], complete[complete.len() - 1]);
        sums.push(if full(bin) { std::array::from_fn(|c| last[c] + bin.sum[c]) } else { last });
        complete.push(known + usize::from(full(bin)));
    }
    let mut m = 1;
    while 4 * m <= bins.len() {
        let mut squares = [0.0; 3];
        let mut count = 0u64;
        for i in 0..=bins.len() - 2 * m {
            if complete[i + 2 * m] - complete[i] == 2 * m {
                for c in 0..3 {
                    let d = (sums[i + 2 * m][c] - 2.0 * sums[i + m][c] + sums[i][c]) / (m as f64 * bin_samples as f64);
                    squares[c] += d * d;
                }
                count += 1;
            }
        }
        if count > 0 {
            let rows = (count as usize + 2 * m - 1) as f64;
            let degrees_of_freedom = overlapping_freedom(rows, m as f64);
            out.push(Deviation {
                tau_s: m as f64 * bin_samples as f64 / rate_hz,
                deviation: squares.map(|s| (0.5 * s / count as f64).sqrt()),
                degrees_of_freedom,
                limits: spectrum::limits(degrees_of_freedom),
            });
        }
        m *= 2;
    }
    out
}
