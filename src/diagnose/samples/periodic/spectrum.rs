//! Spectra of what the means of the plateaus leave: lines, and combs of lines, that noise makes seldom.

use super::super::two_sided;
use super::HARMONICS;
use crate::diagnose::scene::Samples;
use crate::fit::scan::log_tail;
use crate::model::effects::pulse_harmonic;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Longest period, in plateaus: their means are taken off, and of a slower signal little is left.
const SLOWEST: f64 = 2.5;
/// Fewest samples inside the plateaus.
const FEWEST: usize = 200;
/// Smallest variance of a plateau's samples that is believed, over the median of all.
const LEAST_VARIANCE: f64 = 0.2;
/// Half of the width over which the level of the spectrum is taken, lines.
const LEVEL: usize = 120;
/// Parts of a line in which the fundamental of a comb is looked for.
const PARTS: usize = 8;
/// Combs that are looked at with phases.
const PROMISING: usize = 24;
/// Harmonics that are added up to find them.
const ADDED: [usize; 4] = [2, 3, 5, 8];

/// The samples of the plateaus at equal times, with zeros between them.
pub struct Grid<'a> {
    pub samples: &'a Samples,
    pub windows: &'a [[usize; 2]],
    pub rate_hz: f64,
    /// Samples of the record, those between the plateaus included.
    pub length: usize,
    /// Samples inside the plateaus.
    pub used: usize,
    /// Samples of the transform.
    size: usize,
}

/// Spectra of the axes, with what the samples of each plateau count for.
pub struct Spectrum {
    /// Of each axis and plateau.
    pub weights: [Vec<f64>; 3],
    lines: Vec<Vec<Complex<f64>>>,
    /// Level of the noise at every line.
    pub levels: Vec<Vec<f64>>,
    /// Cycles per line from the begin of the record to its middle, which phases refer to.
    middle_lines: f64,
    /// First line that is looked at.
    first: usize,
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
        (used >= FEWEST).then(|| Self { samples, windows, rate_hz, length, used, size: (2 * length).next_power_of_two() })
    }

    /// From line to line, Hz.
    pub fn step_hz(&self) -> f64 {
        self.rate_hz / self.size as f64
    }

    /// The spectra of readings.
    pub fn spectrum(&self, readings: &[Vec<f64>; 3]) -> Option<Spectrum> {
        let t = &self.samples.t_s;
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(self.size);
        let weights = [0, 1, 2].map(|a: usize| weights(&readings[a], self.windows));
        let of_axis = |(values, weights): (&Vec<f64>, &Vec<f64>)| -> Option<Vec<Complex<f64>>> {
            let mut input = fft.make_input_vec();
            for ([from, to], weight) in self.windows.iter().zip(weights) {
                for k in *from..*to {
                    let at = ((t[k] - t[0]) * self.rate_hz).round() as usize;
                    if let Some(cell) = input.get_mut(at) {
                        *cell = weight * values[k];
                    }
                }
            }
            let mut output = fft.make_output_vec();
            fft.process(&mut input, &mut output).ok()?;
            Some(output)
        };
        let lines: Vec<Vec<Complex<f64>>> = readings.iter().zip(&weights).map(of_axis).collect::<Option<_>>()?;
        let levels = lines.iter().map(|l| level_of(&l.iter().map(Complex::norm_sqr).collect::<Vec<f64>>())).collect();
        let longest_s = self.windows.iter().map(|w| t[w[1].max(1) - 1] - t[w[0]]).fold(1.0 / self.rate_hz, f64::max);
        let first = (1.0 / (SLOWEST * longest_s) / self.step_hz()).ceil() as usize;
        let middle_lines = self.length as f64 / self.size as f64 / 2.0;
        Some(Spectrum { weights, lines, levels, middle_lines, first: first.max(2) })
    }
}

impl Spectrum {
    fn power(&self, axis: usize, line: usize) -> f64 {
        self.lines[axis][line].norm_sqr() / self.levels[axis][line]
    }

    fn end(&self) -> usize {
        self.lines[0].len() - 1
    }

    /// The line that noise makes most seldom, on an axis or on all together, and the logarithm of that probability.
    pub fn tone(&self) -> Option<(usize, f64)> {
        let log_p = |line: usize| {
            let each = [0, 1, 2].map(|a| self.power(a, line));
            log_gamma_tail(3, each.iter().sum()).min(-each.iter().fold(0.0, |m: f64, p| m.max(*p)))
        };
        (self.first..self.end()).map(|line| (line, log_p(line))).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The comb that noise makes most seldom. Powers of harmonics are added up first; the best places are looked at with phases.
    pub fn comb(&self) -> Option<Comb> {
        let mut places: Vec<(f64, usize)> = Vec::new();
        for place in PARTS * self.first..PARTS * self.end() / 2 {
            let mut sums = [0.0; 4];
            let mut best = 0.0_f64;
            for harmonic in 1..=HARMONICS {
                let line = (harmonic * place + PARTS / 2) / PARTS;
                if line >= self.end() {
                    break;
                }
                for axis in 0..3 {
                    let power = self.power(axis, line);
                    sums[axis] += power;
                    sums[3] += power;
                }
                if ADDED.contains(&harmonic) {
                    for (k, sum) in sums.iter().enumerate() {
                        let count = if k == 3 { 3 * harmonic } else { harmonic };
                        // Far from what noise does only.
                        if *sum > count as f64 + 3.0 * (count as f64).sqrt() {
                            best = best.min(log_gamma_tail(count, *sum));
                        }
                    }
                }
            }
            match places.last_mut() {
                _ if best == 0.0 => {}
                Some(last) if place - last.1 < PARTS / 2 => {
                    if best < last.0 {
                        *last = (best, place);
                    }
                }
                _ => places.push((best, place)),
            }
        }
        places.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let combs = places.iter().take(PROMISING).filter_map(|(_, place)| self.with_phases(*place as f64 / PARTS as f64));
        combs.min_by(|a, b| a.log_p.total_cmp(&b.log_p))
    }

    /// A comb with the best duty and delay.
    fn with_phases(&self, base: f64) -> Option<Comb> {
        let waves: Vec<(usize, [Complex<f64>; 3])> = (1..=HARMONICS)
            .map(|h| (h, (h as f64 * base).round() as usize))
            .take_while(|(_, line)| *line < self.end())
            .map(|(h, line)| {
                // In units of the noise of each part, with the phase at the middle of the record.
                let turn = Complex::from_polar(1.0, TAU * (line as f64 * self.middle_lines).fract());
                (h, [0, 1, 2].map(|a: usize| self.lines[a][line] * turn * (2.0 / self.levels[a][line]).sqrt()))
            })
            .collect();
        let strength = |(_, w): &&(usize, [Complex<f64>; 3])| w.iter().map(|c| c.norm_sqr()).sum::<f64>();
        let strongest = waves.iter().max_by(|a, b| strength(a).total_cmp(&strength(b)))?.0;
        let mut log_p = 0.0_f64;
        for duty in (1..=10).map(|d| 0.05 * d as f64) {
            for delay in (0..64).map(|d| d as f64 / 64.0) {
                let (mut along, mut size) = ([0.0; 3], [0.0; 3]);
                for (harmonic, wave) in &waves {
                    let (s, c) = pulse_harmonic(*harmonic, duty, delay);
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
    two_sided(most.sqrt()).ln().min(log_tail(gains.iter().sum(), 3.0))
}

/// Logarithm of the probability that a sum of `count` exponential powers is larger than `x`.
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
    let squares = windows.iter().map(|[from, to]| values[*from..*to].iter().map(|v| v * v).sum::<f64>());
    let mut variances: Vec<f64> = squares.zip(&counts).map(|(sum, n)| sum / n.max(1.0)).collect();
    // Readings that do not move say nothing about noise.
    let least = LEAST_VARIANCE * crate::plateau::median(&mut variances.clone());
    variances.iter_mut().for_each(|v| *v = v.max(least).max(f64::MIN_POSITIVE));
    let mean = variances.iter().zip(&counts).map(|(v, n)| n / v).sum::<f64>() / counts.iter().sum::<f64>();
    variances.iter().map(|v| 1.0 / (v * mean)).collect()
}

/// Level of a spectrum of noise around each line, from medians: lines do not lift it.
fn level_of(power: &[f64]) -> Vec<f64> {
    let n = power.len();
    let stride = LEVEL / 2;
    let centres: Vec<usize> = (0..n).step_by(stride).collect();
    let medians: Vec<f64> = centres
        .iter()
        .map(|c| {
            let mut part = power[c.saturating_sub(LEVEL)..(c + LEVEL).min(n)].to_vec();
            let middle = part.len() / 2;
            // The median of exponential powers is ln 2 of their mean.
            (*part.select_nth_unstable_by(middle, f64::total_cmp).1 / std::f64::consts::LN_2).max(f64::MIN_POSITIVE)
        })
        .collect();
    (0..n)
        .map(|i| {
            let k = (i / stride).min(medians.len() - 1);
            let next = medians[(k + 1).min(medians.len() - 1)];
            let part = (i % stride) as f64 / stride as f64;
            medians[k] * (1.0 - part) + next * part
        })
        .collect()
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
