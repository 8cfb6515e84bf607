//! Spectra of what the means of the plateaus leave: lines, and combs of lines, that noise makes seldom.

use super::{HARMONICS, SLOW};
use crate::diagnose::samples::squares;
use crate::fit::statistics::{log_chi2_tail, median, two_sided_tail};
use crate::model::effects::in_samples::Harmonic;
use crate::record::prepared::Samples;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use realfft::{RealFftPlanner, RealToComplex};
use std::f64::consts::TAU;
use std::sync::Arc;

/// Longest period, in plateaus: their means are taken off, and of a slower signal little is left.
const SLOWEST: f64 = 2.5;
/// The spectrum of a single plateau falls off within a few times the reciprocal of its length: so far a line is repeated.
pub const REPEATED: f64 = 8.0;
/// Fewest samples inside the plateaus.
const FEWEST: usize = 200;
/// Smallest variance of a plateau's samples that is believed, over the median of all.
const LEAST_VARIANCE: f64 = 0.2;
/// Half of the width over which the level of the spectrum is taken, lines.
const LEVEL: usize = 120;
/// The same where slow noise shows, at least.
const LEAST_LEVEL: usize = 24;
/// Lines from one level to the next.
const STRIDE: usize = LEVEL / 2;
/// Parts of a line in which the fundamental of a comb is looked for.
const PARTS: usize = 8;
/// Combs that are looked at with phases.
const PROMISING: usize = 24;
/// Standard deviations above which a sum of powers is looked at: what is significant with its phases lies beyond.
const FAR: f64 = 5.0;
/// Harmonics that are added up to find them.
const ADDED: [usize; 4] = [2, 3, 5, 8];
/// A stretch of a plateau is at most the record over this.
const STRETCHES: f64 = 500.0;
/// Frequencies are told apart that lie so many times the reciprocal length of the record apart.
const APART_LINES: f64 = 2.0;
/// Where two samples are further apart than this, in usual intervals, others are missing.
const GAP: f64 = 1.5;

/// Samples of a plateau at equal intervals, none missing.
pub struct Stretch {
    /// Plateau.
    pub window: usize,
    /// First sample, and one past the last.
    pub from: usize,
    pub to: usize,
    /// Interval, s.
    pub dt_s: f64,
}

/// The samples of the plateaus at equal times, with zeros between them.
pub struct Grid<'a> {
    pub samples: &'a Samples,
    pub windows: &'a [[usize; 2]],
    pub rate_hz: f64,
    /// Samples of the record, those between the plateaus included.
    pub length: usize,
    /// Samples inside the plateaus.
    pub used: usize,
    /// The same, as stretches, plateau after plateau.
    pub stretches: Vec<Stretch>,
    /// Lowest frequency that is looked at, Hz: that which the means of the plateaus leave.
    lowest_hz: f64,
    /// Samples of the transform.
    size: usize,
    /// Where each sample lies on the grid.
    places: Vec<usize>,
}

/// Noise of readings around the means of their plateaus.
pub struct Noise {
    /// What the samples of each plateau count for, of each axis and plateau.
    pub weights: [Vec<f64>; 3],
    /// Levels of the spectra of the axes at every [`STRIDE`]th line.
    levels: [Vec<f64>; 3],
}

/// Spectra of the axes.
pub struct Spectrum {
    fft: Arc<dyn RealToComplex<f64>>,
    axes: [Axis; 3],
    /// Cycles per line from the begin of the record to its middle, which phases refer to.
    middle_lines: f64,
    /// First line that is looked at.
    first: usize,
}

/// One axis of the spectra, and what its transform needs.
struct Axis {
    input: Vec<f64>,
    lines: Vec<Complex<f64>>,
    scratch: Vec<Complex<f64>>,
}

/// Powers of the lines of spectra over the noise.
pub struct Lines<'a> {
    spectrum: &'a Spectrum,
    noise: &'a Noise,
    /// Sums of powers of so many harmonics as [`ADDED`] says, beyond which it is worth to look.
    far: [[f64; 4]; 4],
}

/// A comb of lines that a switched signal would make.
pub struct Comb {
    /// Fundamental, in lines.
    pub base: f64,
    /// Harmonic with the largest power.
    pub strongest: usize,
    /// Logarithm of the probability that noise makes as much at this place.
    pub log_p: f64,
}

impl<'a> Grid<'a> {
    /// The grid of a record; `None` where there is too little.
    pub fn new(samples: &'a Samples, windows: &'a [[usize; 2]], rate_hz: f64) -> Option<Self> {
        let length = ((samples.t_s.last()? - samples.t_s.first()?) * rate_hz).round() as usize + 1;
        let used = windows.iter().map(|w| w[1].saturating_sub(w[0])).sum();
        let longest = ((length as f64 / STRETCHES) as usize).max(2);
        let place = |t_s: &f64| ((t_s - samples.t_s[0]) * rate_hz).round() as usize;
        (used >= FEWEST).then(|| Self {
            samples,
            windows,
            rate_hz,
            length,
            used,
            stretches: stretches(&samples.t_s, windows, longest, GAP / rate_hz),
            lowest_hz: 1.0 / (SLOWEST * longest_s(samples, windows, rate_hz)),
            size: (2 * length).next_power_of_two(),
            places: samples.t_s.par_iter().map(place).collect(),
        })
    }

    /// The same with the lowest frequency of other plateaus.
    pub fn over_rows(self, rows: &[[usize; 2]]) -> Self {
        Self { lowest_hz: 1.0 / (SLOWEST * longest_s(self.samples, rows, self.rate_hz)), ..self }
    }

    /// From line to line, Hz.
    pub fn step_hz(&self) -> f64 {
        self.rate_hz / self.size as f64
    }

    /// Frequencies are told apart that lie further apart than this, Hz.
    pub fn apart_hz(&self) -> f64 {
        APART_LINES * self.rate_hz / self.length as f64
    }

    /// The line of the spectra nearest to a frequency.
    pub fn line(&self, hz: f64) -> usize {
        (self.seen_hz(hz) / self.step_hz()).round() as usize
    }

    /// Where a frequency is seen, Hz: the samples fold what is above half their rate.
    pub fn seen_hz(&self, hz: f64) -> f64 {
        (hz - self.rate_hz * (hz / self.rate_hz).round()).abs()
    }

    /// Length of the longest plateau, s.
    pub fn longest_s(&self) -> f64 {
        longest_s(self.samples, self.windows, self.rate_hz)
    }

    /// Rate of the plateaus, Hz, as their begins tell it; those that are missing are counted.
    pub fn plateaus_hz(&self) -> Option<f64> {
        let begins_s: Vec<f64> = self.windows.iter().map(|[from, _]| self.samples.t_s[*from]).collect();
        let mut steps_s: Vec<f64> = begins_s.windows(2).map(|w| w[1] - w[0]).collect();
        let first_s = *begins_s.first()?;
        if steps_s.is_empty() {
            return None;
        }
        let usual_s = median(&mut steps_s.clone());
        let count: f64 = steps_s.drain(..).map(|step_s| (step_s / usual_s).round()).sum();
        Some(count / (begins_s.last()? - first_s)).filter(|hz| hz.is_finite() && *hz > 0.0)
    }

    /// Frequency below which a wave is a slow change of the plateaus, Hz.
    pub fn slowest_hz(&self) -> f64 {
        SLOW as f64 * self.rate_hz / self.length as f64
    }

    /// Lowest frequency that is looked at, Hz.
    pub fn lowest_hz(&self) -> f64 {
        self.lowest_hz
    }
}

/// Length of the longest of some plateaus, s.
fn longest_s(samples: &Samples, windows: &[[usize; 2]], rate_hz: f64) -> f64 {
    let t = &samples.t_s;
    windows.iter().map(|w| t[w[1].max(1) - 1] - t[w[0]]).fold(1.0 / rate_hz, f64::max)
}

/// The windows in stretches of at most so many samples, without intervals longer than this.
fn stretches(t_s: &[f64], windows: &[[usize; 2]], longest: usize, gap_s: f64) -> Vec<Stretch> {
    let mut all = Vec::new();
    for (window, [begin, end]) in windows.iter().enumerate() {
        let mut from = *begin;
        for k in *begin..*end {
            let to = k + 1;
            if to == *end || to - from == longest || t_s[to] - t_s[k] > gap_s {
                all.push(Stretch { window, from, to, dt_s: (t_s[k] - t_s[from]) / (k - from).max(1) as f64 });
                from = to;
            }
        }
    }
    all
}

/// Level at a line of a stride between the levels around it.
fn between([low, high]: [f64; 2], line: usize) -> f64 {
    let part = line as f64 / STRIDE as f64;
    low * (1.0 - part) + high * part
}

/// Axes of which a power is the sum: three for the last one.
fn parts_of(power: usize) -> usize {
    if power == 3 { 3 } else { 1 }
}

impl Noise {
    /// Level at a line, between those that are known.
    pub fn level(&self, axis: usize, line: usize) -> f64 {
        between(self.around(axis, line / STRIDE), line % STRIDE)
    }

    /// The known levels around the lines of a stride.
    fn around(&self, axis: usize, stride: usize) -> [f64; 2] {
        let levels = &self.levels[axis];
        let last = levels.len() - 1;
        [levels[stride.min(last)], levels[(stride + 1).min(last)]]
    }

    /// Median level of an axis.
    pub fn usual_level(&self, axis: usize) -> f64 {
        median(&mut self.levels[axis].clone())
    }

    /// Variance of a sample of each component, which is the median level of the spectrum, enT².
    pub fn variance(&self, grid: &Grid) -> [f64; 3] {
        [0, 1, 2].map(|a| self.usual_level(a) / grid.used as f64)
    }

    /// Squares of residuals by the components and plateaus, weighted, over the variance of a sample.
    pub fn weighted(&self, grid: &Grid, squares: &[Vec<f64>; 3]) -> f64 {
        let variance = self.variance(grid);
        let of_axis =
            |a: usize| squares[a].iter().zip(&self.weights[a]).map(|(square, weight)| weight * square).sum::<f64>() / variance[a];
        (0..3).map(of_axis).sum()
    }
}

impl Spectrum {
    /// Spectra on a grid, of nothing yet.
    pub fn new(grid: &Grid) -> Self {
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(grid.size);
        let axis = || Axis { input: fft.make_input_vec(), lines: fft.make_output_vec(), scratch: fft.make_scratch_vec() };
        let axes = [axis(), axis(), axis()];
        let first = (grid.lowest_hz() / grid.step_hz()).ceil() as usize;
        let middle_lines = grid.length as f64 / grid.size as f64 / 2.0;
        Self { fft, axes, middle_lines, first: first.max(2) }
    }

    /// Makes them those of readings, and determines the noise of these.
    pub fn take(&mut self, grid: &Grid, readings: &[Vec<f64>; 3]) -> Option<Noise> {
        let weights = [0, 1, 2].map(|a: usize| weights(&readings[a], grid.windows));
        let fft = &self.fft;
        let of_axis = |((axis, values), weights): ((&mut Axis, &Vec<f64>), &Vec<f64>)| -> Option<Vec<f64>> {
            axis.input.fill(0.0);
            for ([from, to], weight) in grid.windows.iter().zip(weights) {
                for (at, value) in grid.places[*from..*to].iter().zip(&values[*from..*to]) {
                    if let Some(cell) = axis.input.get_mut(*at) {
                        *cell = weight * value;
                    }
                }
            }
            fft.process_with_scratch(&mut axis.input, &mut axis.lines, &mut axis.scratch).ok()?;
            Some(levels_of(&axis.lines))
        };
        let levels: Vec<Vec<f64>> = self.axes.par_iter_mut().zip(readings).zip(&weights).map(of_axis).collect::<Option<_>>()?;
        Some(Noise { weights, levels: levels.try_into().ok()? })
    }

    /// Number of the last line.
    fn end(&self) -> usize {
        self.axes[0].lines.len() - 1
    }

    /// Signal to noise ratio of a line on each axis.
    pub fn strength(&self, line: usize, noise: &Noise) -> [f64; 3] {
        [0, 1, 2].map(|a: usize| (2.0 * self.axes[a].lines[line.min(self.end())].norm_sqr() / noise.level(a, line)).sqrt())
    }

    /// The lines over the noise.
    pub fn lines<'a>(&'a self, noise: &'a Noise) -> Lines<'a> {
        let far = ADDED.map(|harmonics| [0, 1, 2, 3].map(|k| (parts_of(k) * harmonics) as f64).map(|n| n + FAR * n.sqrt()));
        Lines { spectrum: self, noise, far }
    }
}

impl Lines<'_> {
    /// Powers of a line over the noise, of the three axes, and their sum.
    fn power(&self, line: usize) -> [f64; 4] {
        self.powers(line / STRIDE, [line, line + 1]).next().map_or([0.0; 4], |(_, power)| power)
    }

    /// The same of the lines of a stride that lie in a range, with their numbers.
    fn powers(&self, stride: usize, [from, to]: [usize; 2]) -> impl Iterator<Item = (usize, [f64; 4])> {
        let begin = stride * STRIDE;
        let lines = self.spectrum.axes.each_ref().map(|axis| axis.lines.as_slice());
        let around = [0, 1, 2].map(|a: usize| self.noise.around(a, stride));
        (from.max(begin)..to.min(begin + STRIDE)).map(move |line| {
            let [x, y, z] = [0, 1, 2].map(|a: usize| lines[a][line].norm_sqr() / between(around[a], line - begin));
            (line, [x, y, z, x + y + z])
        })
    }

    /// Logarithm of the probability that noise makes a line, on an axis or on all together.
    fn log_p(&self, line: usize) -> f64 {
        let [x, y, z, all] = self.power(line);
        log_gamma_tail(parts_of(3), all).min(-x.max(y).max(z))
    }

    /// The line that noise makes most seldom, and the logarithm of that probability.
    pub fn tone(&self) -> Option<(usize, f64)> {
        // It is the one with the largest power on an axis, or with the largest sum.
        let larger = |a: (f64, usize), b: (f64, usize)| if b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)).is_gt() { b } else { a };
        let range = [self.spectrum.first, self.spectrum.end()];
        let of_stride = |stride: usize| {
            let of_line = |(line, [x, y, z, all]): (usize, [f64; 4])| [(x.max(y).max(z), line), (all, line)];
            self.powers(stride, range).map(of_line).reduce(|a, b| [larger(a[0], b[0]), larger(a[1], b[1])])
        };
        let strides = (range[0] / STRIDE..range[1].div_ceil(STRIDE)).into_par_iter();
        let most = strides.filter_map(of_stride).reduce_with(|a, b| [larger(a[0], b[0]), larger(a[1], b[1])])?;
        let lines = most.map(|(_, line)| (line, self.log_p(line)));
        lines.into_iter().min_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)))
    }

    /// The line with the largest power among those around one that noise makes as seldom as `log_p`. The plateaus repeat a line at distances of
    /// one over their own, and a strong one lifts the level of the noise around it so far that its repetitions stand out as much.
    pub fn strongest_around(&self, grid: &Grid, line: usize, log_p: f64) -> usize {
        let reach = (REPEATED / (grid.longest_s() * grid.step_hz())) as usize;
        let usual = [0, 1, 2].map(|a| self.noise.usual_level(a));
        let power = |line: usize| (0..3).map(|a| self.spectrum.axes[a].lines[line].norm_sqr() / usual[a]).sum::<f64>();
        (line.saturating_sub(reach).max(self.spectrum.first)..self.spectrum.end().min(line + reach + 1))
            .filter(|other| self.log_p(*other) < log_p)
            .max_by(|a, b| power(*a).total_cmp(&power(*b)))
            .unwrap_or(line)
    }

    /// The comb that noise makes most seldom. Powers of harmonics are added up first; the best places are looked at with phases.
    pub fn comb(&self, shapes: &[Harmonic]) -> Option<Comb> {
        // Every line is asked for many times, and memory is what takes the time.
        let end = self.spectrum.end();
        let mut powers = vec![[0.0_f32; 4]; end];
        powers.par_chunks_mut(STRIDE).enumerate().for_each(|(stride, own)| {
            own.iter_mut()
                .zip(self.powers(stride, [0, end]))
                .for_each(|(own, (_, power))| *own = power.map(|power| power as f32));
        });
        let places = (PARTS * self.spectrum.first..PARTS * self.spectrum.end() / 2).into_par_iter();
        self.most_seldom(places.filter_map(|place| self.added(place, |line| powers[line].map(f64::from))).collect(), shapes)
    }

    /// The same of the combs that have a line.
    pub fn comb_of(&self, line: usize, shapes: &[Harmonic]) -> Option<Comb> {
        let around = |harmonic: usize| {
            let middle = PARTS * line / harmonic;
            middle.saturating_sub(PARTS / 2)..=middle + PARTS / 2
        };
        let mut places: Vec<usize> = (1..=HARMONICS).flat_map(around).collect();
        places.retain(|place| (PARTS * self.spectrum.first..PARTS * self.spectrum.end() / 2).contains(place));
        places.sort_unstable();
        places.dedup();
        self.most_seldom(places.into_iter().filter_map(|place| self.added(place, |line| self.power(line))).collect(), shapes)
    }

    /// Of combs by the logarithms of their probabilities without phases and their places, in the order of these, that which noise makes most seldom.
    fn most_seldom(&self, all: Vec<(f64, usize)>, shapes: &[Harmonic]) -> Option<Comb> {
        // The best of those that lie together.
        let mut places: Vec<(f64, usize)> = Vec::new();
        for (log_p, place) in all {
            match places.last_mut() {
                Some(last) if place - last.1 < PARTS / 2 => {
                    if log_p < last.0 {
                        *last = (log_p, place);
                    }
                }
                _ => places.push((log_p, place)),
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let combs = places.iter().take(PROMISING).filter_map(|(_, place)| self.with_phases(*place as f64 / PARTS as f64, shapes));
        combs.min_by(|a, b| a.log_p.total_cmp(&b.log_p))
    }

    /// Logarithm of the probability that noise makes as much at the harmonics of a place together, and the place; `None` where it is no more than
    /// noise makes.
    fn added(&self, place: usize, power: impl Fn(usize) -> [f64; 4]) -> Option<(f64, usize)> {
        let mut sums = [0.0; 4];
        let mut best = 0.0_f64;
        let mut harmonic = 0;
        'all: for (upto, far) in ADDED.into_iter().zip(&self.far) {
            while harmonic < upto {
                harmonic += 1;
                let line = (harmonic * place + PARTS / 2) / PARTS;
                if line >= self.spectrum.end() {
                    break 'all;
                }
                sums.iter_mut().zip(power(line)).for_each(|(sum, power)| *sum += power);
            }
            for k in (0..4).filter(|k| sums[*k] > far[*k]) {
                best = best.min(log_gamma_tail(parts_of(k) * upto, sums[k]));
            }
        }
        (best < 0.0).then_some((best, place))
    }

    /// A comb with the best shape, duty and delay.
    fn with_phases(&self, base: f64, shapes: &[Harmonic]) -> Option<Comb> {
        let waves: Vec<(usize, [Complex<f64>; 3])> = (1..=HARMONICS)
            .map(|h| (h, (h as f64 * base).round() as usize))
            .take_while(|(_, line)| *line < self.spectrum.end())
            .map(|(h, line)| {
                // In units of the noise of each part, with the phase at the middle of the record.
                let turn = Complex::from_polar(1.0, TAU * (line as f64 * self.spectrum.middle_lines).fract());
                let own = |a: usize| self.spectrum.axes[a].lines[line] * turn * (2.0 / self.noise.level(a, line)).sqrt();
                (h, [0, 1, 2].map(own))
            })
            .collect();
        let strength = |(_, w): &&(usize, [Complex<f64>; 3])| w.iter().map(|c| c.norm_sqr()).sum::<f64>();
        let strongest = waves.iter().max_by(|a, b| strength(a).total_cmp(&strength(b)))?.0;
        let mut log_p = 0.0_f64;
        let duties = (1..=10).map(|d| 0.05 * d as f64);
        for (shape, duty) in duties.flat_map(|duty| shapes.iter().map(move |shape| (shape, duty))) {
            for delay in (0..64).map(|d| d as f64 / 64.0) {
                let (mut along, mut size) = ([0.0; 3], [0.0; 3]);
                for (harmonic, wave) in &waves {
                    let (s, c) = shape(*harmonic, duty, delay);
                    for a in 0..3 {
                        along[a] += c * wave[a].re - s * wave[a].im;
                        size[a] += s * s + c * c;
                    }
                }
                let gains = [0, 1, 2].map(|a: usize| along[a] * along[a] / size[a]);
                log_p = log_p.min(log_p_of_switched(gains));
            }
        }
        Some(Comb { base, strongest, log_p })
    }
}

/// Logarithm of the probability that noise makes as much along a switched signal, on an axis or on all: from the chi squares of the axes.
pub fn log_p_of_switched(gains: [f64; 3]) -> f64 {
    let most = gains.iter().fold(0.0, |m: f64, g| m.max(*g));
    two_sided_tail(most.sqrt()).max(f64::MIN_POSITIVE).ln().min(log_chi2_tail(gains.iter().sum(), 3.0))
}

/// Logarithm of the probability that a sum of `count` exponential powers is larger than `x`: the finite sum of Erlang's distribution,
/// asked for at every line of a spectrum. The tail of statrs is less than a double can hold where a line is strong.
fn log_gamma_tail(count: usize, x: f64) -> f64 {
    let (mut term, mut sum) = (1.0, 1.0);
    for i in 1..count {
        term *= x / i as f64;
        sum += term;
    }
    f64::ln(sum) - x
}

/// What the samples of each plateau count for: noise may grow with the field or with temperature. Their mean over the samples is 1.
fn weights(values: &[f64], windows: &[[usize; 2]]) -> Vec<f64> {
    let counts: Vec<f64> = windows.iter().map(|[from, to]| to.saturating_sub(*from) as f64).collect();
    let mut variances: Vec<f64> = squares(values, windows).iter().zip(&counts).map(|(sum, n)| sum / n.max(1.0)).collect();
    // Readings that do not move say nothing about noise.
    let least = LEAST_VARIANCE * median(&mut variances.clone());
    variances.iter_mut().for_each(|v| *v = v.max(least).max(f64::MIN_POSITIVE));
    let mean = variances.iter().zip(&counts).map(|(v, n)| n / v).sum::<f64>() / counts.iter().sum::<f64>();
    variances.iter().map(|v| 1.0 / (v * mean)).collect()
}

/// Level of a spectrum of noise around every [`STRIDE`]th line, from medians: lines do not lift it.
fn levels_of(lines: &[Complex<f64>]) -> Vec<f64> {
    let n = lines.len();
    let within = |part: &mut Vec<u64>, centre: usize, half: usize| {
        let around = &lines[centre.saturating_sub(half)..(centre + half).min(n)];
        // Numbers that are not negative have the order of their bits, which are quicker to sort.
        part.clear();
        part.extend(around.iter().map(|line| line.norm_sqr().to_bits()));
        let middle = part.len() / 2;
        let median = f64::from_bits(*part.select_nth_unstable(middle).1);
        // The median of exponential powers is ln 2 of their mean.
        (median / std::f64::consts::LN_2).max(f64::MIN_POSITIVE)
    };
    // Slow noise around the means of plateaus is largest at periods of about a plateau: where that is a few lines, the width must be less.
    let level = |part: &mut Vec<u64>, centre: usize| {
        let wide = within(part, centre, LEVEL);
        if centre < 2 * LEVEL { wide.max(within(part, centre, (centre / 2).max(LEAST_LEVEL))) } else { wide }
    };
    (0..n.div_ceil(STRIDE)).into_par_iter().map_init(Vec::new, |part, k| level(part, k * STRIDE)).collect()
}

#[cfg(test)]
mod tests {
    use super::weights;

    /// Weights go with the reciprocal variance, their mean over the samples is 1, and a plateau that stands still does not count for all.
    #[test]
    fn noisy_plateaus_count_for_less() {
        let windows: Vec<[usize; 2]> = (0..90).map(|i| [224 * i, 224 * i + 192]).collect();
        let mut values = vec![0.0; 90 * 224];
        for (i, [from, to]) in windows.iter().enumerate() {
            let size = if i == 0 {
                0.0
            } else if i % 3 == 0 {
                2.0
            } else {
                1.0
            };
            (*from..*to).for_each(|k| values[k] = if k % 2 == 0 { size } else { -size });
        }
        let weights = weights(&values, &windows);
        assert!((weights.iter().sum::<f64>() / 90.0 - 1.0).abs() < 1e-12);
        assert!((weights[1] / weights[3] - 4.0).abs() < 1e-12);
        assert!((weights[0] / weights[1] - 1.0 / super::LEAST_VARIANCE).abs() < 1e-12);
    }
}
