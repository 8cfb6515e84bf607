//! Amplitude densities of records of any length by Welch's method, and lines in them.
//!
//! Segments of a record overlap by half, lose their straight line and are weighted by Hann's window; the mean of their periodograms is
//! the one-sided density `S(f) = 2 |Σ w x exp(-2πift)|² / (f_s Σ w²)` (Welch 1967). A long record is halved in rate again and again
//! ([`Halfband`]), and what is left gives the low frequencies with long segments.
//!
//! The mean of n neighbouring bins over K segments has a χ² distribution with ν degrees of freedom, nearly: `ν = 2 K n / V`, where V
//! holds the squared correlations that Hann's window makes between neighbouring bins (2/3, 1/6) and overlapping segments
//! (1/6, 4/(9π), 1/12, 4/(45π)).

use super::Limits;
use super::statistics::{chi2_quantile, median};
use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::PI;
use std::sync::Arc;

/// Squared correlation of periodograms one and two bins apart.
const BESIDE: [f64; 2] = [4.0 / 9.0, 1.0 / 36.0];
/// The same in the next segment, from the same bin to the third beside it.
const NEXT: [f64; 4] = [1.0 / 36.0, 0.020_01, 1.0 / 144.0, 0.000_80];
/// The lowest bin that the straight line taken away and the window leave alone.
pub const FIRST_BIN: usize = 3;
/// Bin of a longer segment from which on a shorter one is fine enough.
pub const NEXT_BIN: usize = 8;

/// Sums periodograms of three components.
pub struct Welch {
    window: Vec<f64>,
    plan: Arc<dyn RealToComplex<f64>>,
    work: Vec<f64>,
    scratch: Vec<Complex<f64>>,
    spectrum: Vec<Complex<f64>>,
    sums: [Vec<f64>; 3],
    count: usize,
}

impl Welch {
    /// For segments of `length` samples, an even number.
    #[must_use]
    pub fn new(length: usize) -> Self {
        let plan = RealFftPlanner::new().plan_fft_forward(length);
        Self {
            window: (0..length).map(|i| 0.5 - 0.5 * (2.0 * PI * (i as f64 + 0.5) / length as f64).cos()).collect(),
            work: plan.make_input_vec(),
            scratch: plan.make_scratch_vec(),
            spectrum: plan.make_output_vec(),
            sums: std::array::from_fn(|_| vec![0.0; length / 2 + 1]),
            plan,
            count: 0,
        }
    }

    /// Samples of a segment.
    #[must_use]
    pub fn length(&self) -> usize {
        self.window.len()
    }

    /// Adds a segment; all three have the length of the window.
    pub fn add(&mut self, segment: [&[f64]; 3]) {
        let n = self.window.len() as f64;
        for (samples, sums) in segment.into_iter().zip(&mut self.sums) {
            let middle = 0.5 * (n - 1.0);
            let (sum, moment) = (sum(samples), sum_of(samples, |i, x| (i as f64 - middle) * x));
            let (mean, slope) = (sum / n, 12.0 * moment / (n * (n * n - 1.0)));
            let from = mean - slope * middle;
            for (i, ((work, x), w)) in self.work.iter_mut().zip(samples).zip(&self.window).enumerate() {
                *work = (x - from - slope * i as f64) * w;
            }
            // Fails only for buffers of other lengths than the plan made them.
            if self.plan.process_with_scratch(&mut self.work, &mut self.spectrum, &mut self.scratch).is_ok() {
                for (sum, value) in sums.iter_mut().zip(&self.spectrum) {
                    *sum += value.norm_sqr();
                }
            }
        }
        self.count += 1;
    }

    /// The mean of what was added; `None` without a segment.
    #[must_use]
    pub fn density(&self, rate_hz: f64) -> Option<Density> {
        let power: f64 = self.window.iter().map(|w| w * w).sum();
        let scale = 2.0 / (rate_hz * power * self.count as f64);
        (self.count > 0).then(|| Density {
            step_hz: rate_hz / self.window.len() as f64,
            segments: self.count,
            power: self.sums.each_ref().map(|sums| sums.iter().map(|s| s * scale).collect()),
        })
    }
}

/// Terms summed side by side, which takes a fraction of the time of one after the other.
const LANES: usize = 8;

/// Sum of samples.
#[must_use]
pub fn sum(samples: &[f64]) -> f64 {
    sum_of(samples, |_, x| x)
}

fn sum_of(samples: &[f64], term: impl Fn(usize, f64) -> f64) -> f64 {
    let mut lanes = [0.0; LANES];
    let chunks = samples.chunks_exact(LANES);
    let rest = chunks.remainder();
    let whole = samples.len() - rest.len();
    for (k, chunk) in chunks.enumerate() {
        for (j, (lane, x)) in lanes.iter_mut().zip(chunk).enumerate() {
            *lane += term(k * LANES + j, *x);
        }
    }
    lanes.iter().sum::<f64>() + rest.iter().enumerate().map(|(j, x)| term(whole + j, *x)).sum::<f64>()
}

/// Welch's density of a stored record, NaN where samples are missing: segments of `length` samples with few gaps, which straight lines
/// bridge. `None` if no segment is complete enough.
#[must_use]
pub fn of_record(record: [&[f64]; 3], rate_hz: f64, length: usize) -> Option<Density> {
    let rows = record[0].len();
    let mut welch = Welch::new(length);
    let mut begin = 0;
    while begin + length <= rows {
        let part = record.map(|r| &r[begin..begin + length]);
        let missing = part[0].iter().filter(|v| v.is_nan()).count();
        if missing == 0 {
            welch.add(part);
        } else if missing * 50 <= length {
            let bridged = part.map(bridge);
            welch.add(bridged.each_ref().map(Vec::as_slice));
        }
        begin += length / 2;
    }
    welch.density(rate_hz)
}

/// Straight lines over missing samples, the nearest sample at the ends.
fn bridge(samples: &[f64]) -> Vec<f64> {
    let known: Vec<usize> = (0..samples.len()).filter(|i| samples[*i].is_finite()).collect();
    let mut out = samples.to_vec();
    let (Some(&first), Some(&last)) = (known.first(), known.last()) else { return out };
    out[..first].fill(samples[first]);
    out[last..].fill(samples[last]);
    for pair in known.windows(2) {
        let (a, b) = (pair[0], pair[1]);
        for i in a + 1..b {
            out[i] = samples[a] + (samples[b] - samples[a]) * (i - a) as f64 / (b - a) as f64;
        }
    }
    out
}

/// The longest segment for which three fit into `rows` samples, with small factors only.
#[must_use]
pub fn longest_segment(rows: usize) -> usize {
    let half = rows / 2;
    let step = 1usize << half.max(32).ilog2().saturating_sub(4);
    half / step * step / 2 * 2
}

/// A density in bins of equal width.
#[derive(Clone, Debug)]
pub struct Density {
    /// Width of a bin, Hz.
    pub step_hz: f64,
    /// Segments, overlapping by half.
    pub segments: usize,
    /// One-sided power density per component from 0 Hz on, squared unit per Hz.
    pub power: [Vec<f64>; 3],
}

impl Density {
    /// Degrees of freedom of the mean of `bins` neighbouring bins.
    #[must_use]
    pub fn degrees_of_freedom(&self, bins: usize) -> f64 {
        let (n, k) = (bins as f64, self.segments as f64);
        let share = |lag: usize| (1.0 - lag as f64 / n).max(0.0);
        let beside: f64 = BESIDE.iter().enumerate().map(|(i, c)| 2.0 * share(i + 1) * c).sum();
        let next: f64 = NEXT.iter().enumerate().map(|(i, c)| if i == 0 { *c } else { 2.0 * share(i) * c }).sum();
        2.0 * k * n / (1.0 + beside + 2.0 * (k - 1.0) / k * next)
    }
}

/// A part of a spectrum: the bins of one density.
#[derive(Clone, Debug)]
pub struct Stage {
    /// The density.
    pub density: Density,
    /// First bin and the one after the last.
    pub bins: [usize; 2],
}

/// Mean density over a band.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Point {
    /// Middle of the bins, Hz.
    pub frequency_hz: f64,
    /// Lowest and highest bin, Hz.
    pub band_hz: [f64; 2],
    /// One-sided power density, squared unit per Hz.
    pub power: [f64; 3],
    /// Degrees of freedom of the density.
    pub degrees_of_freedom: f64,
}

impl Point {
    /// Amplitude density of a component, unit per √Hz.
    #[must_use]
    pub fn amplitude(&self, component: usize) -> f64 {
        self.power[component].sqrt()
    }

    /// Limits of 95 % of an amplitude density, as factors on it.
    #[must_use]
    pub fn limits(&self) -> [f64; 2] {
        limits(self.degrees_of_freedom)
    }
}

/// Limits of 95 % of an amplitude estimated with some degrees of freedom, as factors on it: `sqrt(ν / χ²)`.
#[must_use]
pub fn limits(degrees_of_freedom: f64) -> [f64; 2] {
    [0.975, 0.025].map(|probability| (degrees_of_freedom / chi2_quantile(degrees_of_freedom, probability)).sqrt())
}

/// Mean densities in bands of equal ratio, `per_decade` of them in a decade, single bins where bins are wider; bins of lines are left
/// out.
#[must_use]
pub fn bands(stages: &[Stage], per_decade: f64, lines: &[Line]) -> Vec<Point> {
    let mut points = Vec::new();
    for stage in stages {
        let step = stage.density.step_hz;
        let shown: Vec<[f64; 2]> = lines.iter().map(|l| [l.frequency_hz, l.reach_hz(step)]).collect();
        let is_line = |bin: usize| shown.iter().any(|[line_hz, reach_hz]| (line_hz - bin as f64 * step).abs() <= *reach_hz);
        let mut at = stage.bins[0];
        while at < stage.bins[1] {
            let ratio = 10f64.powf(1.0 / per_decade);
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "a bin of the density")]
            let end = ((at as f64 * ratio).round() as usize).clamp(at + 1, stage.bins[1]);
            let used: Vec<usize> = (at..end).filter(|bin| !is_line(*bin)).collect();
            if let (Some(first), Some(last)) = (used.first(), used.last()) {
                points.push(mean(&stage.density, &used, [*first, *last]));
            }
            at = end;
        }
    }
    points
}

fn mean(density: &Density, bins: &[usize], ends: [usize; 2]) -> Point {
    let n = bins.len() as f64;
    Point {
        frequency_hz: bins.iter().map(|b| *b as f64).sum::<f64>() / n * density.step_hz,
        band_hz: ends.map(|b| b as f64 * density.step_hz),
        power: std::array::from_fn(|c| bins.iter().map(|b| density.power[c][*b]).sum::<f64>() / n),
        degrees_of_freedom: density.degrees_of_freedom(bins.len()),
    }
}

/// A line above the density beside it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Component.
    pub component: usize,
    /// Frequency, Hz; it may be an alias.
    pub frequency_hz: f64,
    /// Width of a bin, Hz: the frequency is known better than that.
    pub step_hz: f64,
    /// Amplitude, half peak to peak.
    pub amplitude: f64,
    /// Its standard uncertainty.
    pub amplitude_std: f64,
    /// Power density at the line over that beside it.
    pub ratio: f64,
}

impl Line {
    /// How far on either side a density with bins of `step_hz` shows the line, Hz: over the main lobe of Hann's window, and the side lobes as far as they
    /// are above [`LEAKAGE`] of the density beside the line; by no less than its frequency is known to.
    fn reach_hz(&self, step_hz: f64) -> f64 {
        // A line has the same power in fewer bins. A line between two bins is higher than either.
        let ratio = BETWEEN_BINS * self.ratio * self.step_hz / step_hz;
        // At d bins from a line the envelope of the window is 1 / (π d (d² - 1)) of its peak.
        let root = ((ratio / LEAKAGE).sqrt() / PI).cbrt();
        let main_lobe = LOBE as f64 + 0.5;
        ((root + 1.0 / (3.0 * root)).max(main_lobe) * step_hz).max(main_lobe * self.step_hz)
    }
}

/// Part of the density beside a line that leaks from it into bins that are used.
const LEAKAGE: f64 = 0.05;
/// Power of a line over that of the bin nearest to it, at most, with Hann's window.
const BETWEEN_BINS: f64 = 1.4;

/// Bins on either side of a line that hold it: the main lobe of Hann's window.
const LOBE: usize = 2;
/// Bins on either side from which the density beside a line is estimated.
const BESIDE_BINS: usize = 24;
const LEAST_BESIDE: usize = 6;
/// Probability that a bin exceeds the threshold by chance: small, since the level beside a bin is uncertain too.
const LINE_PROBABILITY: f64 = 1e-9;
/// Fewest segments that tell lines: the level beside a line is that of many bins, so that their number counts through the threshold alone.
const LEAST_SEGMENTS: usize = 3;
/// A line stands out by this factor of power, whatever the number of segments.
const LEAST_RATIO: f64 = 1.5;

/// Lines in the bins of a stage: bins above what chance makes of the median beside them.
///
/// The amplitude follows from the power in the lobe of the window, `A²/2 = Σ (S - S_beside) df`; its uncertainty from the noise of the
/// density beside it.
#[must_use]
pub fn lines(stage: &Stage) -> Vec<Line> {
    let density = &stage.density;
    let [begin, end] = stage.bins;
    let single = density.degrees_of_freedom(1);
    if density.segments < LEAST_SEGMENTS {
        return Vec::new();
    }
    // The bins beside one need not be of this stage; the first ones have too few below them.
    let begin = begin.max(NEXT_BIN);
    let threshold = (chi2_quantile(single, 1.0 - LINE_PROBABILITY) / single).max(LEAST_RATIO);
    // The median of χ² over its mean.
    let median_share = chi2_quantile(single, 0.5) / single;
    let mut found = Vec::new();
    for (component, power) in density.power.iter().enumerate() {
        let mut bin = begin;
        while bin < end {
            // Where the density falls steeply the lower side is above the upper one: a line stands above both.
            let reach = (bin / 2).clamp(LEAST_BESIDE, BESIDE_BINS);
            let lower = bin.saturating_sub(LOBE + reach).max(FIRST_BIN)..bin.saturating_sub(LOBE);
            let upper = (bin + LOBE + 1).min(power.len() - 1)..(bin + LOBE + 1 + reach).min(power.len() - 1);
            let sides = [lower, upper].map(|side| power[side.start.min(side.end)..side.end].to_vec());
            let [a, b] = sides.map(|mut side| (!side.is_empty()).then(|| median(&mut side) / median_share));
            let (Some(highest), Some(level)) =
                (a.into_iter().chain(b).reduce(f64::max), a.zip(b).map(|(a, b)| 0.5 * (a + b)).or(a).or(b))
            else {
                break;
            };
            let is_highest =
                (bin.saturating_sub(LOBE).max(1)..=(bin + LOBE).min(power.len() - 1)).all(|i| power[i] <= power[bin]);
            if power[bin] <= threshold * highest || !is_highest || level <= 0.0 {
                bin += 1;
                continue;
            }
            let lobe = bin.saturating_sub(LOBE).max(1)..=(bin + LOBE).min(power.len() - 1);
            let excess: Vec<(f64, f64)> = lobe.map(|i| (i as f64, power[i] - level)).collect();
            let sum: f64 = excess.iter().map(|(_, e)| e).sum();
            if sum > 0.0 {
                let line_power = sum * density.step_hz;
                let amplitude = (2.0 * line_power).sqrt();
                let duration_s = (density.segments as f64 + 1.0) / (2.0 * density.step_hz);
                let bins = excess.len() as f64;
                // The line beats with the noise, and the noise of the lobe's bins scatters.
                let variance = 2.0 * line_power * level / duration_s
                    + (level * density.step_hz * bins).powi(2) * 2.0 / density.degrees_of_freedom(excess.len());
                found.push(Line {
                    component,
                    frequency_hz: excess.iter().map(|(i, e)| i * e.max(0.0)).sum::<f64>()
                        / excess.iter().map(|(_, e)| e.max(0.0)).sum::<f64>()
                        * density.step_hz,
                    step_hz: density.step_hz,
                    amplitude,
                    amplitude_std: variance.sqrt() / amplitude,
                    ratio: power[bin] / level,
                });
            }
            bin += LOBE + 1;
        }
    }
    found
}

/// Half of the taps of a half-band filter of 15 taps beside the middle one, which is 1/2: `sin(πk/2) / (πk)` for k = 1, 3, 5, 7,
/// weighted by Blackman's window.
fn taps() -> [f64; 4] {
    let raw: [f64; 4] = std::array::from_fn(|i| {
        let k = (2 * i + 1) as f64;
        let x = PI * k / 8.0;
        (0.5 * PI * k).sin() / (PI * k) * (0.42 + 0.5 * x.cos() + 0.08 * (2.0 * x).cos())
    });
    let sum: f64 = raw.iter().sum();
    raw.map(|h| 0.25 * h / sum)
}

/// Taps of the filter on either side of the middle.
const REACH: usize = 7;

/// Halves the sample rate of three components: frequencies below 0.07 of the input rate pass, those that would fold onto them are taken
/// away to 1e-3 of their amplitude or better.
#[derive(Clone, Debug)]
pub struct Halfband {
    taps: [f64; 4],
    kept: [Vec<f64>; 3],
}

impl Default for Halfband {
    fn default() -> Self {
        Self { taps: taps(), kept: Default::default() }
    }
}

impl Halfband {
    /// Forgets what came before.
    pub fn clear(&mut self) {
        self.kept.iter_mut().for_each(Vec::clear);
    }

    /// Takes samples and appends every second filtered one to `out`.
    pub fn push(&mut self, samples: [&[f64]; 3], out: &mut [Vec<f64>; 3]) {
        let [h1, h3, h5, h7] = self.taps;
        for ((kept, new), out) in self.kept.iter_mut().zip(samples).zip(out) {
            kept.extend_from_slice(new);
            let count = if kept.len() > 2 * REACH { (kept.len() - 2 * REACH - 1) / 2 + 1 } else { 0 };
            for x in kept.windows(2 * REACH + 1).step_by(2).take(count) {
                out.push(0.5 * x[7] + h1 * (x[6] + x[8]) + h3 * (x[4] + x[10]) + h5 * (x[2] + x[12]) + h7 * (x[0] + x[14]));
            }
            kept.drain(..(2 * count).min(kept.len()));
        }
    }
}

/// White noise and 1/f noise: `S(f) = W + A / f`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WhiteAndSlow {
    /// White power density, squared unit per Hz.
    pub white: f64,
    /// Its standard uncertainty.
    pub white_std: f64,
    /// Power density of the 1/f noise at 1 Hz.
    pub slow: f64,
    /// Its standard uncertainty.
    pub slow_std: f64,
    /// Corner A/W where both are equal, Hz; NaN without white noise.
    pub corner_hz: f64,
    /// Its standard uncertainty.
    pub corner_std_hz: f64,
    /// χ² of the points over its degrees of freedom; far above 1 where the noise is something else.
    pub chi_square_per_degree: f64,
}

/// Fits [`WhiteAndSlow`] to points of one component by weights from the model itself, which is maximum likelihood for χ² of many degrees
/// of freedom. Uncertainties are widened by a χ² above 1. `None` where the points are too few or do not determine it.
#[must_use]
pub fn white_and_slow(points: &[&Point], component: usize) -> Option<WhiteAndSlow> {
    use nalgebra::DMatrix;
    let y: Vec<f64> = points.iter().map(|p| p.power[component]).collect();
    if points.len() < 6 || !y.iter().all(|v| *v > 0.0) {
        return None;
    }
    let names = vec!["white".to_owned(), "slow".to_owned()];
    let columns = DMatrix::from_fn(points.len(), 2, |i, j| if j == 0 { 1.0 } else { 1.0 / points[i].frequency_hz });
    let design = super::Design::new(names, columns.clone()).ok()?;
    let rhs = DMatrix::from_column_slice(y.len(), 1, &y);
    let mut model = y.clone();
    let mut solution = None;
    for _ in 0..20 {
        let weights: Vec<f64> = points.iter().zip(&model).map(|(p, m)| p.degrees_of_freedom / (2.0 * m * m)).collect();
        let found = super::solve(&design, &rhs, Some(&weights), &Limits::default()).ok()?;
        let [white, slow] = [found.coefficients[0], found.coefficients[1]];
        let least = 1e-6 * y.iter().copied().fold(f64::INFINITY, f64::min);
        model = points.iter().map(|p| (white.max(0.0) + slow.max(0.0) / p.frequency_hz).max(least)).collect();
        solution = Some(found);
    }
    let solution = solution?;
    let [white, slow] = [solution.coefficients[0], solution.coefficients[1]];
    let chi_square_per_degree = solution.residual_std[0].powi(2);
    let widened = chi_square_per_degree.max(1.0);
    let covariance = &solution.unscaled_covariance * widened;
    // A negative density is not physical; without white noise there is no corner.
    let corner_hz = if white > 0.0 { slow.max(0.0) / white } else { f64::NAN };
    let variance = (covariance[(1, 1)] - 2.0 * corner_hz * covariance[(0, 1)] + corner_hz * corner_hz * covariance[(0, 0)])
        / (white * white);
    Some(WhiteAndSlow {
        white,
        white_std: covariance[(0, 0)].sqrt(),
        slow,
        slow_std: covariance[(1, 1)].sqrt(),
        corner_hz,
        corner_std_hz: variance.sqrt(),
        chi_square_per_degree,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(f: f64) -> f64 {
        let tone: Vec<f64> = (0..4000).map(|i| (2.0 * PI * f * f64::from(i)).sin()).collect();
        let mut out: [Vec<f64>; 3] = Default::default();
        let mut filter = Halfband::default();
        for part in tone.chunks(37) {
            filter.push([part, part, part], &mut out);
        }
        assert_eq!(out[0].len(), (4000 - 2 * REACH - 1) / 2 + 1, "pieces give what the whole gives");
        (2.0 * out[2].iter().map(|v| v * v).sum::<f64>() / out[2].len() as f64).sqrt()
    }

    #[test]
    fn half_band_filter_passes_low_frequencies_and_keeps_their_aliases_out() {
        for f in [0.013, 0.0413, 0.0617] {
            assert!((through(f) - 1.0).abs() < 2e-3, "{f} {}", through(f));
            assert!(through(0.5 - f) < 1.5e-3, "{f} {}", through(0.5 - f));
        }
    }

    #[test]
    fn limits_are_those_of_chi_square() {
        // χ² of 10 degrees of freedom: 3.247 and 20.483; of 200: 162.73 and 241.06.
        for (dof, low, high) in [(10.0f64, 20.483, 3.247), (200.0, 241.06, 162.73)] {
            let [a, b] = limits(dof);
            assert!((a - (dof / low).sqrt()).abs() < 8e-3 && (b - (dof / high).sqrt()).abs() < 8e-3, "{a} {b}");
        }
    }

    #[test]
    fn longest_segments_leave_room_for_three_and_are_even() {
        for rows in [200, 3375, 108_000, 131_072] {
            let length = longest_segment(rows);
            assert!(length.is_multiple_of(2) && 2 * length <= rows && length > rows / 2 * 15 / 16, "{rows} {length}");
        }
    }
}
