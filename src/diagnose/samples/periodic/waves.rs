//! Waves and switched signals, fitted to the samples inside the plateaus.

use super::HARMONICS;
use super::spectrum::{Grid, Spectrum};
use crate::model::effects::pulse_harmonic;
use std::f64::consts::TAU;

/// Squares of the expected signal to noise ratio, per parameter, of the evidence.
const EXPECTED: f64 = 20.0;

/// Readings around the means of their plateaus, with a spectrum that tells their noise.
pub struct Waves<'a> {
    pub grid: &'a Grid<'a>,
    pub spectrum: &'a Spectrum,
    pub residual: &'a [Vec<f64>; 3],
}

/// The best switched signal of a period.
#[derive(Clone)]
pub struct Switched {
    pub base_hz: f64,
    /// Mean over all duties and delays: that they are free is paid for.
    pub evidence: f64,
    /// Chi square.
    pub gain: f64,
    /// Parts of the period.
    pub duty: f64,
    pub delay: f64,
}

/// Amplitudes of one frequency.
pub struct Wave {
    hz: f64,
    pub sin: [f64; 3],
    pub cos: [f64; 3],
    pub std: [f64; 3],
}

impl Waves<'_> {
    /// Sine and cosine parts of the residuals at a frequency, by least squares with the means of the plateaus taken off the waves as well.
    fn wave(&self, hz: f64) -> Option<Wave> {
        // Squares and products of the waves, and of the waves and residuals.
        let (mut squares, mut along) = ([[0.0; 3]; 3], [[0.0; 2]; 3]);
        let mut waves: Vec<(f64, f64)> = Vec::new();
        for (w, [from, to]) in self.grid.windows.iter().enumerate() {
            waves.clear();
            waves.extend((*from..*to).map(|k| (TAU * (hz * self.grid.samples.t_s[k]).fract()).sin_cos()));
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
                let weight = self.spectrum.weights[a][w];
                squares[a].iter_mut().zip(own_squares).for_each(|(sum, own)| *sum += weight * own);
                along[a].iter_mut().zip(own_along[a]).for_each(|(sum, own)| *sum += weight * own);
            }
        }
        let line = ((hz / self.grid.step_hz()).round() as usize).min(self.spectrum.levels[0].len() - 1);
        let mut wave = Wave { hz, sin: [0.0; 3], cos: [0.0; 3], std: [0.0; 3] };
        for a in 0..3 {
            let ([ss, sc, cc], [ys, yc]) = (squares[a], along[a]);
            let determinant = ss * cc - sc * sc;
            if determinant < 1e-6 * (self.grid.used as f64).powi(2) {
                return None;
            }
            wave.sin[a] = (ys * cc - yc * sc) / determinant;
            wave.cos[a] = (yc * ss - ys * sc) / determinant;
            // Means taken off the plateaus lower the level of slow noise as much as the waves.
            wave.std[a] = (2.0 * self.spectrum.levels[a][line]).sqrt() / (ss + cc);
        }
        Some(wave)
    }

    /// Takes a wave off the used samples.
    pub fn take_off(&self, values: &mut [Vec<f64>; 3], wave: &Wave) {
        for k in self.grid.windows.iter().flat_map(|[from, to]| *from..*to) {
            let (sin, cos) = (TAU * (wave.hz * self.grid.samples.t_s[k]).fract()).sin_cos();
            (0..3).for_each(|a| values[a][k] -= wave.sin[a] * sin + wave.cos[a] * cos);
        }
    }

    /// Weighted squares of residuals over the variance of a sample, which is the median level of the spectrum.
    pub fn squares(&self, residual: &[Vec<f64>; 3]) -> f64 {
        let of_axis = |a: usize| {
            let variance = crate::plateau::median(&mut self.spectrum.levels[a].clone()) / self.grid.used as f64;
            let of = |[from, to]: &[usize; 2]| residual[a][*from..*to].iter().map(|v| v * v).sum::<f64>();
            self.grid.windows.iter().zip(&self.spectrum.weights[a]).map(|(window, weight)| weight * of(window)).sum::<f64>()
                / variance
        };
        (0..3).map(of_axis).sum()
    }

    /// Chi square of a wave.
    pub fn chi(wave: &Wave) -> f64 {
        (0..3).map(|a| (wave.sin[a].powi(2) + wave.cos[a].powi(2)) / wave.std[a].powi(2)).sum()
    }

    pub fn harmonics(&self, hz: f64, count: usize) -> Option<Vec<Wave>> {
        let highest = self.grid.step_hz() * (self.spectrum.levels[0].len() - 1) as f64;
        let waves: Vec<Wave> =
            (1..=count).map(|h| h as f64 * hz).take_while(|f| *f < 0.98 * highest).filter_map(|f| self.wave(f)).collect();
        (!waves.is_empty()).then_some(waves)
    }

    /// The frequency near a line at which chi square is largest.
    pub fn refine(&self, hz: f64) -> f64 {
        let chi = |f: f64| self.wave(f).map_or(f64::NEG_INFINITY, |w| Self::chi(&w));
        let mut best = (f64::NEG_INFINITY, hz);
        let mut width = self.grid.step_hz();
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
    pub fn matched(&self, waves: &[Wave], base_hz: f64, duty: f64, delay: f64) -> (f64, [(f64, f64); 3]) {
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
    pub fn switched(&self, base_hz: f64, order: f64) -> Option<Switched> {
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
    pub fn polish(&self, found: &Switched) -> Switched {
        let mut best = found.clone();
        let better = |best: &mut Switched, waves: &[Wave], base_hz: f64, duty: f64, delay: f64| {
            let (duty, delay) = (duty.clamp(0.02, 0.98), delay.rem_euclid(1.0));
            let gain = self.matched(waves, base_hz, duty, delay).0;
            if gain > best.gain {
                *best = Switched { base_hz, gain, duty, delay, ..*best };
            }
        };
        let (mut df, mut dd, mut dl) = (0.3 * self.grid.step_hz(), 0.025, 1.0 / 128.0);
        for _ in 0..6 {
            for sign in [-1.0, 1.0] {
                let base_hz = best.base_hz + sign * df;
                if let Some(waves) = self.harmonics(base_hz, HARMONICS) {
                    // A changed period moves the delay over the record: it is looked for again.
                    for shift in [-2.0, -1.0, 0.0, 1.0, 2.0] {
                        let (duty, delay) = (best.duty, best.delay + shift * dl);
                        better(&mut best, &waves, base_hz, duty, delay);
                    }
                }
                let base_hz = best.base_hz;
                if let Some(waves) = self.harmonics(base_hz, HARMONICS) {
                    for (d, l) in [(sign * dd, 0.0), (0.0, sign * dl), (sign * dd, -0.5 * sign * dd)] {
                        let (duty, delay) = (best.duty + d, best.delay + l);
                        better(&mut best, &waves, base_hz, duty, delay);
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

/// Logarithm of the evidence of so many free parts, from their chi square.
pub fn evidence(chi: f64, count: f64) -> f64 {
    let g = EXPECTED;
    0.5 * (g / (1.0 + g) * chi - count * (1.0 + g).ln())
}
