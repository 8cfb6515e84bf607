//! Periodic signals in the samples: lines of the spectrum, and combs of lines that switched signals make.

use super::{APART, Inside, SIGNIFICANT, demean, remove, remove_raw, rms, two_sided};
use crate::diagnose::scene::{Samples, Scene};
use crate::fit::scan::{log_tail, orthonormal};
use crate::model::effects::{Record, Spec, pulse_harmonic};
use nalgebra::{DMatrix, DVector};
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Periodic signals that are looked for at most.
const MOST_SIGNALS: usize = 4;
/// Independent trials per sample of the record, counted on noise: frequencies on each axis and on all together, and for combs phases and
/// duties, of which there are the more the stronger a signal is.
const TONES: usize = 12;
const COMBS: usize = 7500;
/// Longest period, in plateaus: their means are taken off, and of a slower signal little is left.
const SLOWEST: f64 = 2.5;
/// Smallest variance of a plateau's samples that is believed, over the median of all.
const LEAST_VARIANCE: f64 = 0.2;
/// Cosines that slow changes are made of.
const SLOW: usize = 12;
/// Half of the width over which the level of the spectrum is taken, lines.
const LEVEL: usize = 120;
/// Harmonics of a switched signal.
const HARMONICS: usize = 8;
/// Squares of the expected signal to noise ratio, per parameter, of the evidence.
const EXPECTED: f64 = 20.0;
/// Parts of a line in which the fundamental of a comb is looked for.
const PARTS: usize = 8;
/// Combs that are looked at with phases.
const PROMISING: usize = 24;
/// Harmonics that are added up to find them.
const ADDED: [usize; 4] = [2, 3, 5, 8];

/// A line this near to a harmonic of a known one, as a part of its frequency, is what the known one has beside a pure period.
const SAME_LINE: f64 = 0.005;

/// Periodic signals in what the plateau means leave.
pub fn periodic(scene: &Scene, samples: &Samples, known: &[Inside]) -> Vec<Inside> {
    let mut found: Vec<Inside> = Vec::new();
    let Some(rate_hz) = rate_of(samples) else { return found };
    let mut residual = around_means(scene, samples, known);
    for _ in 0..MOST_SIGNALS {
        let Some(signal) = strongest(&scene.record, samples, &scene.windows, &residual, rate_hz) else { break };
        remove(&mut residual, &scene.record, samples, &scene.windows, &signal);
        // A signal that comes again with the settings had lost a slope that was its own.
        residual.iter_mut().for_each(|values| level(values, samples, &scene.windows));
        if !known.iter().chain(&found).any(|k| belongs(&signal, k, rate_hz)) {
            found.push(signal);
        }
    }
    found
}

/// Whether a signal lies on a harmonic of a known one, seen at the sampling frequency.
fn belongs(signal: &Inside, known: &Inside, rate_hz: f64) -> bool {
    let fundamental_hz = |i: &Inside| i.spec.get("frequency").or_else(|| i.spec.get("period").map(f64::recip));
    let (Some(own_hz), Some(known_hz)) = (fundamental_hz(signal), fundamental_hz(known)) else { return false };
    let seen_hz = |f: f64| (f - rate_hz * (f / rate_hz).round()).abs();
    (1..=HARMONICS).any(|k| (seen_hz(k as f64 * known_hz) - seen_hz(own_hz)).abs() < SAME_LINE * known_hz)
}

fn rate_of(samples: &Samples) -> Option<f64> {
    let mut gaps: Vec<f64> = samples.t_s.windows(2).map(|w| w[1] - w[0]).take(1001).collect();
    if gaps.len() < 100 {
        return None;
    }
    gaps.sort_by(f64::total_cmp);
    let gap = gaps[gaps.len() / 2];
    (gap > 0.0).then(|| {
        // The mean over the record is exact where no samples are lost.
        let mean = (samples.t_s[samples.t_s.len() - 1] - samples.t_s[0]) / (samples.t_s.len() - 1) as f64;
        if (mean / gap - 1.0).abs() < 0.01 { mean.recip() } else { gap.recip() }
    })
}

/// Readings of the used samples around the means of their plateaus, without what is known already and without slow changes.
fn around_means(scene: &Scene, samples: &Samples, known: &[Inside]) -> [Vec<f64>; 3] {
    let mut residual: [Vec<f64>; 3] = [0, 1, 2].map(|a| samples.reading_ent.iter().map(|r| r[a]).collect());
    for signal in known {
        remove_raw(&mut residual, &scene.record, samples, &scene.windows, signal);
    }
    demean(&mut residual, &scene.windows);
    residual.iter_mut().for_each(|values| level(values, samples, &scene.windows));
    residual
}

/// Takes slow changes off plateaus whose means are zero: they would be a saw at the rate of the settings. Their slopes follow cosines over the
/// run; where these are no more than noise, nothing is taken.
fn level(values: &mut [f64], samples: &Samples, windows: &[[usize; 2]]) {
    let count = SLOW.min(windows.len() / 4);
    if count == 0 {
        return;
    }
    let middles_s: Vec<f64> = windows.iter().map(|[from, to]| mean(&samples.t_s[*from..*to])).collect();
    let (begin_s, end_s) = (middles_s[0], middles_s[middles_s.len() - 1]);
    let along = |i: usize, k: usize| samples.t_s[k] - middles_s[i];
    // Squares of the time of each plateau, and slopes in units of their standard deviation at noise of 1.
    let squares: Vec<f64> =
        windows.iter().enumerate().map(|(i, [from, to])| (*from..*to).map(|k| along(i, k).powi(2)).sum::<f64>()).collect();
    let slopes = DVector::from_fn(windows.len(), |i, _| {
        let [from, to] = windows[i];
        (from..to).map(|k| values[k] * along(i, k)).sum::<f64>() / squares[i].max(f64::MIN_POSITIVE).sqrt()
    });
    let cosine = |i: usize, m: usize| (PI * m as f64 * (middles_s[i] - begin_s) / (end_s - begin_s)).cos();
    let design = DMatrix::from_fn(windows.len(), count, |i, m| squares[i].sqrt() * cosine(i, m));
    let base = orthonormal(&design, None, 1e-9);
    let fitted = &base * base.tr_mul(&slopes);
    // Slopes that do not follow tell their noise.
    let noise = (slopes - &fitted).norm_squared() / (windows.len() - count) as f64;
    if log_tail(fitted.norm_squared() / noise, count as f64) < SIGNIFICANT.ln() {
        for (i, [from, to]) in windows.iter().enumerate() {
            let slope = fitted[i] / squares[i].max(f64::MIN_POSITIVE).sqrt();
            (*from..*to).for_each(|k| values[k] -= slope * along(i, k));
        }
    }
}

fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len().max(1) as f64
}

/// The strongest line of the spectra of all components together, as a tone or as a switched signal.
fn strongest(
    record: &Record,
    samples: &Samples,
    windows: &[[usize; 2]],
    residual: &[Vec<f64>; 3],
    rate_hz: f64,
) -> Option<Inside> {
    let t0 = samples.t_s[0];
    let length = ((samples.t_s[samples.t_s.len() - 1] - t0) * rate_hz).round() as usize + 1;
    let size = (2 * length).next_power_of_two();
    let used: usize = windows.iter().map(|w| w[1].saturating_sub(w[0])).sum();
    if used < 200 {
        return None;
    }
    let fft = RealFftPlanner::<f64>::new().plan_fft_forward(size);
    let weighted = |values: &[f64], weights: &[f64]| -> Option<Vec<Complex<f64>>> {
        let mut input = fft.make_input_vec();
        for ([from, to], weight) in windows.iter().zip(weights) {
            for k in *from..*to {
                let at = ((samples.t_s[k] - t0) * rate_hz).round() as usize;
                if let Some(cell) = input.get_mut(at) {
                    *cell = weight * values[k];
                }
            }
        }
        let mut output = fft.make_output_vec();
        fft.process(&mut input, &mut output).ok()?;
        Some(output)
    };
    let spectrum = |residual: &[Vec<f64>; 3]| -> Option<([Vec<f64>; 3], Vec<Vec<Complex<f64>>>, Vec<Vec<f64>>)> {
        let weights = [0, 1, 2].map(|a: usize| weights(&residual[a], windows));
        let lines: Option<Vec<Vec<Complex<f64>>>> = residual.iter().zip(&weights).map(|(v, w)| weighted(v, w)).collect();
        let levels = lines.as_ref()?.iter().map(|l| level_of(&l.iter().map(|c| c.norm_sqr()).collect::<Vec<f64>>())).collect();
        Some((weights, lines?, levels))
    };
    let (weights, lines, levels) = spectrum(residual)?;
    let step_hz = rate_hz / size as f64;
    let longest_s = windows.iter().map(|w| samples.t_s[w[1].max(1) - 1] - samples.t_s[w[0]]).fold(1.0 / rate_hz, f64::max);
    let first = (1.0 / (SLOWEST * longest_s) / step_hz).ceil() as usize;
    let rows = Rows { samples, windows, residual, weights: &weights, levels: &levels, step_hz, used };
    let spectra =
        Spectra { lines: &lines, levels: &levels, middle_lines: length as f64 / size as f64 / 2.0, first: first.max(2) };
    let (peak, tone_p) = spectra.tone()?;
    let trials = TONES * length;
    let is_tone = tone_p + (trials as f64).ln() < SIGNIFICANT.ln();
    let comb_log_trials = (COMBS as f64 * length as f64).ln();
    let comb = spectra.comb().filter(|c| c.log_p + comb_log_trials < SIGNIFICANT.ln());
    let (line_hz, p_value) = match &comb {
        _ if is_tone => (peak as f64 * step_hz, tone_p.exp()),
        Some(c) => (c.strongest as f64 * c.base * step_hz, (c.log_p + comb_log_trials - (trials as f64).ln()).exp()),
        None => return None,
    };
    let line_hz = rows.refine(line_hz);
    // A signal is no noise: weights and levels are those of what is left without it, and it is measured with them.
    let mut quiet = residual.clone();
    rows.harmonics(line_hz, HARMONICS)?.iter().for_each(|wave| rows.take_off(&mut quiet, wave));
    demean(&mut quiet, windows);
    let (weights, _, levels) = spectrum(&quiet)?;
    let rows = Rows { samples, windows, residual, weights: &weights, levels: &levels, step_hz, used };
    let line_hz = rows.refine(line_hz);
    let sines = rows.harmonics(line_hz, 1)?;
    let wave = sines.first()?;
    let tone = Rows::chi(wave);
    let tone_evidence = evidence(tone, 6.0);
    // The line may be a harmonic of a switched signal.
    let orders = (1..=4).map(|order| (order as f64, line_hz / order as f64));
    let switched = orders
        .chain(comb.map(|c| (c.strongest as f64, c.base * step_hz)))
        .filter_map(|(order, base_hz)| rows.switched(base_hz, order))
        .max_by(|a, b| a.evidence.total_cmp(&b.evidence));
    let axes_of = |values: &[(f64, f64)]| -> Vec<usize> {
        (0..3).filter(|a| values[*a].0.abs() > 3.0 * values[*a].1 || values.iter().all(|v| v.0.abs() <= 3.0 * v.1)).collect()
    };
    let tone_axes: Vec<usize> = {
        let sizes: Vec<(f64, f64)> = (0..3).map(|a| (wave.sin[a].hypot(wave.cos[a]), wave.std[a] * 1.41)).collect();
        axes_of(&sizes)
    };
    let frequency_std = step_hz * size as f64 / length as f64 * 0.55 / (tone / 2.0).sqrt();
    // The phase is known best in the middle of the record; at the run's start the frequency has its part in it.
    let phase_std = TAU * frequency_std * mean(&samples.t_s);
    let as_tone = || Inside {
        id: "interference_tone",
        spec: Spec::new("sine", &tone_axes).with("frequency", line_hz, "Hz"),
        values: tone_axes
            .iter()
            .flat_map(|a| {
                let (sin, cos, std) = (wave.sin[*a], wave.cos[*a], wave.std[*a]);
                [(sin, std.hypot(cos * phase_std)), (cos, std.hypot(sin * phase_std))]
            })
            .collect(),
        shape_std: vec![("frequency".to_owned(), frequency_std)],
        strength: tone.sqrt(),
        p_value: p_value.max(f64::MIN_POSITIVE),
        trials,
        ambiguous_with: Vec::new(),
        squares: [0.0; 3],
        rms_ent: [[0.0; 3]; 2],
    };
    let mut inside = match switched {
        Some(found) if found.evidence > tone_evidence => {
            let (_, base_hz, duty, delay) = rows.polish(found.gain, found.base_hz, found.duty, found.delay);
            // On and off cannot be told apart: the shorter part is called on.
            let (duty, delay) = if duty > 0.5 { (1.0 - duty, (delay + duty).rem_euclid(1.0)) } else { (duty, delay) };
            let waves = rows.harmonics(base_hz, HARMONICS)?;
            let (gain, values) = rows.matched(&waves, base_hz, duty, delay);
            // Lines of a spectrum lie beside the harmonics; the fit has to confirm what they showed.
            if !is_tone && log_p_of_switched(values.map(|v| (v.0 / v.1).powi(2))) + comb_log_trials >= SIGNIFICANT.ln() {
                return None;
            }
            let axes = axes_of(&values);
            let period_s = base_hz.recip();
            Inside {
                id: "heater_pwm",
                spec: Spec::new("square", &axes).with("period", period_s, "s").with("duty", duty, "1").with(
                    "delay",
                    delay * period_s,
                    "s",
                ),
                values: axes.iter().map(|a| values[*a]).collect(),
                shape_std: vec![(
                    "period".to_owned(),
                    period_s * period_s * 0.55 / (length as f64 / rate_hz) / (gain / 2.0).sqrt(),
                )],
                strength: gain.sqrt(),
                ambiguous_with: if found.evidence - tone_evidence < APART { vec!["interference_tone"] } else { Vec::new() },
                ..as_tone()
            }
        }
        Some(other) if tone_evidence - other.evidence < APART => Inside { ambiguous_with: vec!["heater_pwm"], ..as_tone() },
        _ => as_tone(),
    };
    let before = rows.squares(residual);
    let mut after = residual.clone();
    remove(&mut after, record, samples, windows, &inside);
    let left = rows.squares(&after);
    inside.squares = [before, left, 3.0 * used as f64];
    inside.rms_ent = [rms(residual, windows), rms(&after, windows)];
    Some(inside)
}

/// Spectra of the axes, with the level of the noise.
struct Spectra<'a> {
    lines: &'a [Vec<Complex<f64>>],
    levels: &'a [Vec<f64>],
    /// Cycles per line from the begin of the record to its middle, which phases refer to.
    middle_lines: f64,
    /// First line that is looked at.
    first: usize,
}

/// A comb of lines that a switched signal would make.
struct Comb {
    /// Fundamental, in lines.
    base: f64,
    /// Harmonic with the largest power.
    strongest: usize,
    /// Logarithm of the probability that noise makes as much at this place.
    log_p: f64,
}

/// Logarithm of the probability that noise makes as much along a switched signal, on an axis or on all: from the chi squares of the axes.
fn log_p_of_switched(gains: [f64; 3]) -> f64 {
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

impl Spectra<'_> {
    fn power(&self, axis: usize, line: usize) -> f64 {
        self.lines[axis][line].norm_sqr() / self.levels[axis][line]
    }

    fn end(&self) -> usize {
        self.lines[0].len() - 1
    }

    /// The line that noise makes most seldom, on an axis or on all together, and the logarithm of that probability.
    fn tone(&self) -> Option<(usize, f64)> {
        let log_p = |line: usize| {
            let each = [0, 1, 2].map(|a| self.power(a, line));
            log_gamma_tail(3, each.iter().sum()).min(-each.iter().fold(0.0, |m: f64, p| m.max(*p)))
        };
        (self.first..self.end()).map(|line| (line, log_p(line))).min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// The comb that noise makes most seldom. Powers of harmonics are added up first; the best places are looked at with phases.
    fn comb(&self) -> Option<Comb> {
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

fn evidence(chi: f64, count: f64) -> f64 {
    let g = EXPECTED;
    0.5 * (g / (1.0 + g) * chi - count * (1.0 + g).ln())
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

struct Rows<'a> {
    samples: &'a Samples,
    windows: &'a [[usize; 2]],
    residual: &'a [Vec<f64>; 3],
    /// Of each axis and plateau.
    weights: &'a [Vec<f64>; 3],
    /// Of the spectra of weighted readings.
    levels: &'a [Vec<f64>],
    step_hz: f64,
    used: usize,
}

/// The best switched signal of a period.
struct Switched {
    base_hz: f64,
    /// Mean over all duties and delays: that they are free is paid for.
    evidence: f64,
    /// Chi square.
    gain: f64,
    /// Parts of the period.
    duty: f64,
    delay: f64,
}

/// Amplitudes of one frequency.
struct Wave {
    hz: f64,
    sin: [f64; 3],
    cos: [f64; 3],
    std: [f64; 3],
}

impl Rows<'_> {
    /// Sine and cosine parts of the residuals at a frequency, by least squares with the means of the plateaus taken off the waves as well.
    fn wave(&self, hz: f64) -> Option<Wave> {
        // Squares and products of the waves, and of the waves and residuals.
        let (mut squares, mut along) = ([[0.0; 3]; 3], [[0.0; 2]; 3]);
        let mut waves: Vec<(f64, f64)> = Vec::new();
        for (w, [from, to]) in self.windows.iter().enumerate() {
            waves.clear();
            waves.extend((*from..*to).map(|k| (TAU * (hz * self.samples.t_s[k]).fract()).sin_cos()));
            let n = waves.len().max(1) as f64;
            let (ms, mc) = waves.iter().fold((0.0, 0.0), |(a, b), (s, c)| (a + s / n, b + c / n));
            let (mut own_squares, mut own_along) = ([0.0; 3], [[0.0; 2]; 3]);
            for (k, (s, c)) in (*from..*to).zip(&waves) {
                let (s, c) = (s - ms, c - mc);
                own_squares[0] += s * s;
                own_squares[1] += s * c;
                own_squares[2] += c * c;
                for (own, residual) in own_along.iter_mut().zip(self.residual) {
                    own[0] += residual[k] * s;
                    own[1] += residual[k] * c;
                }
            }
            for a in 0..3 {
                let weight = self.weights[a][w];
                squares[a].iter_mut().zip(own_squares).for_each(|(sum, own)| *sum += weight * own);
                along[a].iter_mut().zip(own_along[a]).for_each(|(sum, own)| *sum += weight * own);
            }
        }
        let line = ((hz / self.step_hz).round() as usize).min(self.levels[0].len() - 1);
        let mut wave = Wave { hz, sin: [0.0; 3], cos: [0.0; 3], std: [0.0; 3] };
        for a in 0..3 {
            let ([ss, sc, cc], [ys, yc]) = (squares[a], along[a]);
            let determinant = ss * cc - sc * sc;
            if determinant < 1e-6 * (self.used as f64).powi(2) {
                return None;
            }
            wave.sin[a] = (ys * cc - yc * sc) / determinant;
            wave.cos[a] = (yc * ss - ys * sc) / determinant;
            // Means taken off the plateaus lower the level of slow noise as much as the waves.
            wave.std[a] = (2.0 * self.levels[a][line]).sqrt() / (ss + cc);
        }
        Some(wave)
    }

    /// Takes a wave off the used samples.
    fn take_off(&self, values: &mut [Vec<f64>; 3], wave: &Wave) {
        for k in self.windows.iter().flat_map(|[from, to]| *from..*to) {
            let (sin, cos) = (TAU * (wave.hz * self.samples.t_s[k]).fract()).sin_cos();
            (0..3).for_each(|a| values[a][k] -= wave.sin[a] * sin + wave.cos[a] * cos);
        }
    }

    /// Weighted squares of residuals over the variance of a sample, which is the median level of the spectrum.
    fn squares(&self, residual: &[Vec<f64>; 3]) -> f64 {
        let of_axis = |a: usize| {
            let variance = crate::plateau::median(&mut self.levels[a].clone()) / self.used as f64;
            let of = |[from, to]: &[usize; 2]| residual[a][*from..*to].iter().map(|v| v * v).sum::<f64>();
            self.windows.iter().zip(&self.weights[a]).map(|(window, weight)| weight * of(window)).sum::<f64>() / variance
        };
        (0..3).map(of_axis).sum()
    }

    /// Chi square of a wave.
    fn chi(wave: &Wave) -> f64 {
        (0..3).map(|a| (wave.sin[a].powi(2) + wave.cos[a].powi(2)) / wave.std[a].powi(2)).sum()
    }

    fn harmonics(&self, hz: f64, count: usize) -> Option<Vec<Wave>> {
        let highest = self.step_hz * (self.levels[0].len() - 1) as f64;
        let waves: Vec<Wave> =
            (1..=count).map(|h| h as f64 * hz).take_while(|f| *f < 0.98 * highest).filter_map(|f| self.wave(f)).collect();
        (!waves.is_empty()).then_some(waves)
    }

    /// The frequency near a line at which chi square is largest.
    fn refine(&self, hz: f64) -> f64 {
        let chi = |f: f64| self.wave(f).map_or(f64::NEG_INFINITY, |w| Self::chi(&w));
        let mut best = (f64::NEG_INFINITY, hz);
        let mut width = self.step_hz;
        for _ in 0..3 {
            let centre = best.1;
            for k in -2..=2 {
                let f = centre + 0.4 * width * f64::from(k);
                let chi = chi(f);
                if chi > best.0 {
                    best = (chi, f);
                }
            }
            width *= 0.4;
        }
        // So near to the largest value chi square is a parabola.
        let [low, high] = [-width, width].map(|by| chi(best.1 + by));
        let bend = low + high - 2.0 * best.0;
        if bend < 0.0 { best.1 + (0.5 * width * (low - high) / bend).clamp(-width, width) } else { best.1 }
    }

    /// Chi square of a square wave and its amplitudes with uncertainties.
    fn matched(&self, waves: &[Wave], base_hz: f64, duty: f64, delay: f64) -> (f64, [(f64, f64); 3]) {
        let mut gain = 0.0;
        let values = [0, 1, 2].map(|a: usize| {
            let (mut top, mut bottom) = (0.0, 0.0);
            for wave in waves {
                let order = (wave.hz / base_hz).round() as usize;
                let (s, c) = pulse_harmonic(order, duty, delay);
                let weight = wave.std[a].powi(-2);
                top += weight * (s * wave.sin[a] + c * wave.cos[a]);
                bottom += weight * (s * s + c * c);
            }
            gain += top * top / bottom;
            (top / bottom, bottom.sqrt().recip())
        });
        (gain, values)
    }

    /// The switched signal of a period whose harmonic of this order was seen.
    fn switched(&self, base_hz: f64, order: f64) -> Option<Switched> {
        let waves = self.harmonics(base_hz, HARMONICS)?;
        let duties = (1..20).map(|d| 0.05 * d as f64);
        let all: Vec<(f64, f64, f64)> = duties
            .flat_map(|duty| (0..64).map(move |d| (duty, d as f64 / 64.0)))
            .map(|(duty, delay)| (self.matched(&waves, base_hz, duty, delay).0, duty, delay))
            .collect();
        let (gain, duty, delay) = *all.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let most = evidence(gain, 3.0);
        let mean = all.iter().map(|one| (evidence(one.0, 3.0) - most).exp()).sum::<f64>() / all.len() as f64;
        Some(Switched { base_hz, evidence: most + mean.ln() - order.ln(), gain, duty, delay })
    }

    /// Period, duty and delay, closer.
    fn polish(&self, gain: f64, base_hz: f64, duty: f64, delay: f64) -> (f64, f64, f64, f64) {
        let mut best = (gain, base_hz, duty, delay);
        let (mut df, mut dd, mut dl) = (0.3 * self.step_hz, 0.025, 1.0 / 128.0);
        for _ in 0..6 {
            for sign in [-1.0, 1.0] {
                let f = best.1 + sign * df;
                if let Some(waves) = self.harmonics(f, HARMONICS) {
                    // A changed period moves the delay over the record: it is looked for again.
                    for shift in [-2.0, -1.0, 0.0, 1.0, 2.0] {
                        let delay = (best.3 + shift * dl).rem_euclid(1.0);
                        let gain = self.matched(&waves, f, best.2, delay).0;
                        if gain > best.0 {
                            best = (gain, f, best.2, delay);
                        }
                    }
                }
                if let Some(waves) = self.harmonics(best.1, HARMONICS) {
                    for (d, l) in [(sign * dd, 0.0), (0.0, sign * dl), (sign * dd, -0.5 * sign * dd)] {
                        let (duty, delay) = ((best.2 + d).clamp(0.02, 0.98), (best.3 + l).rem_euclid(1.0));
                        let gain = self.matched(&waves, best.1, duty, delay).0;
                        if gain > best.0 {
                            best = (gain, best.1, duty, delay);
                        }
                    }
                }
            }
            df *= 0.5;
            dd *= 0.6;
            dl *= 0.6;
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::{demean, level, weights};
    use crate::diagnose::scene::Samples;

    /// 90 plateaus of 6 s every 7 s at 32 Hz.
    fn plateaus() -> (Samples, Vec<[usize; 2]>) {
        let samples = Samples { t_s: (0..90 * 224).map(|k| k as f64 / 32.0).collect(), ..Samples::default() };
        (samples, (0..90).map(|i| [224 * i, 224 * i + 192]).collect())
    }

    fn squares(values: &[f64]) -> f64 {
        values.iter().map(|v| v * v).sum()
    }

    /// A wave of 400 s leaves a saw of its slopes, and of that its bends: over 6 s with slope `w` and bend `w²` of a unit wave the saw has a
    /// root mean square of `w · 6 / √12`, the bends `w² · 36 / √720`, each times the mean of a squared cosine.
    #[test]
    fn slow_changes_are_taken_off_the_plateaus() {
        let (samples, windows) = plateaus();
        let omega = std::f64::consts::TAU / 400.0;
        let mut values = [0, 1, 2].map(|a| samples.t_s.iter().map(|t| (omega * t + f64::from(a)).sin()).collect::<Vec<f64>>());
        demean(&mut values, &windows);
        for values in &mut values {
            let within = |v: &[f64]| windows.iter().map(|[from, to]| squares(&v[*from..*to])).sum::<f64>() / (90.0 * 192.0);
            let before = within(values);
            assert!((before.sqrt() / (omega * 6.0 / 24.0_f64.sqrt()) - 1.0).abs() < 0.05, "{before}");
            level(values, &samples, &windows);
            let bends = omega * omega * 36.0 / (2.0 * 720.0_f64).sqrt();
            // What the cosines do not follow at the ends of the run adds to the bends.
            assert!(within(values).sqrt() < 0.05 * before.sqrt() + bends, "{}", within(values).sqrt());
        }
    }

    /// A saw that changes its sign from plateau to plateau is no slow change.
    #[test]
    fn what_is_quick_stays() {
        let (samples, windows) = plateaus();
        let mut values = vec![0.0; samples.t_s.len()];
        for (i, [from, to]) in windows.iter().enumerate() {
            let sign = if i % 2 == 0 { 1.0 } else { -1.0 };
            (*from..*to).for_each(|k| values[k] = sign * (samples.t_s[k] - samples.t_s[*from] - 191.0 / 64.0));
        }
        let before = values.clone();
        level(&mut values, &samples, &windows);
        assert_eq!(values, before);
    }

    /// Weights go with the reciprocal variance, their mean over the samples is 1, and a plateau that stands still does not count for all.
    #[test]
    fn noisy_plateaus_count_for_less() {
        let (_, windows) = plateaus();
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
