//! Waves and switched signals, fitted to the samples inside the plateaus.

use super::spectrum::{Grid, Noise, Stretch};
use crate::diagnose::samples::parts_mut;
use crate::fit::statistics::log_sum;
use rayon::prelude::*;
use realfft::num_complex::Complex;
use std::f64::consts::{PI, TAU};

/// Highest frequency at which sine and cosine are told apart, as a part of half the sample rate.
const HIGHEST: f64 = 0.98;
/// Parabolas by which the largest chi square is found, each ten times as narrow as the one before.
const PARABOLAS: usize = 3;
/// Phases of a tone that are tried, over half a turn: the other half has the other sign.
const PHASES: usize = 32;
/// Sine and cosine of three axes.
pub const TONE_PARAMETERS: f64 = 6.0;
/// Standard uncertainty of the frequency of a sine in white noise for a chi square of one, in units of one over the record: √3/π.
const OF_FREQUENCY: f64 = 0.551;
/// Squares of the expected signal to noise ratio, per parameter, of the evidence.
const EXPECTED: f64 = 20.0;

/// Readings around the means of their plateaus, with their noise.
pub struct Waves<'a> {
    pub grid: &'a Grid<'a>,
    pub noise: &'a Noise,
    pub residual: &'a [Vec<f64>; 3],
}

/// The best switched signal of a period.
#[derive(Clone)]
pub struct Switched {
    pub base_hz: f64,
    /// Mean over all duties and delays: that they are free is paid for.
    pub evidence: f64,
    /// Whether a single harmonic is seen, as of a tone.
    pub single: bool,
    /// Chi square.
    pub gain: f64,
    /// Parts of the period.
    pub duty: f64,
    pub delay: f64,
}

/// Amplitudes of one frequency.
pub struct Wave {
    pub hz: f64,
    pub sin: [f64; 3],
    pub cos: [f64; 3],
    pub std: [f64; 3],
    /// Weighted squares of the residuals that it explains.
    pub explained: [f64; 3],
    /// Chi square that it explains on all axes.
    pub chi: f64,
}

/// Sums over stretches that are short against the record, for a frequency: those for frequencies nearby follow from them, each stretch
/// turned by the phase at its middle.
pub struct Band {
    pub hz: f64,
    pub stretches: Vec<Sums>,
}

/// Sums over a stretch: of the wave of unit size, of its square, of the residuals times it, and of the residuals.
#[derive(Clone, Copy, Default)]
pub struct Sums {
    pub wave: Complex<f64>,
    square: Complex<f64>,
    pub along: [Complex<f64>; 3],
    pub residual: [f64; 3],
}

/// A wave of unit size after so many cycles.
pub fn phase(cycles: f64) -> Complex<f64> {
    Complex::from_polar(1.0, TAU * cycles.fract())
}

/// The wave of unit size over a stretch.
fn unit_wave(hz: f64, stretch: &Stretch, t_s: &[f64]) -> impl Iterator<Item = Complex<f64>> {
    let turn = phase(hz * stretch.dt_s);
    std::iter::successors(Some(phase(hz * t_s[stretch.from])), move |z| Some(z * turn)).take(stretch.to - stretch.from)
}

/// Sum of a wave of unit size over `count` samples, of which the first has the phase `first` and each the phase of the one before plus `step`,
/// in cycles: a geometric series.
pub fn sum_of_wave(first: f64, step: f64, count: usize) -> Complex<f64> {
    let half = PI * (step - step.round());
    let n = count as f64;
    let size = if half.sin().abs() < f64::EPSILON { n } else { (n * half).sin() / half.sin() };
    Complex::from_polar(size, TAU * first.fract() + (n - 1.0) * half)
}

impl Band {
    /// The same of the residuals with a wave of its frequency, whose sine and cosine parts are given for each component.
    pub fn with(mut self, grid: &Grid, sizes: [[f64; 2]; 3]) -> Self {
        let i = Complex::<f64>::i();
        for (sums, stretch) in self.stretches.iter_mut().zip(&grid.stretches) {
            let count = (stretch.to - stretch.from) as f64;
            // Products of the sine and the cosine with the wave of unit size.
            let (of_sin, of_cos) = ((sums.square - count) * -0.5 * i, (sums.square + count) * 0.5);
            for ((along, residual), [sin, cos]) in sums.along.iter_mut().zip(&mut sums.residual).zip(sizes) {
                *along += of_sin * sin + of_cos * cos;
                *residual += sums.wave.im * sin + sums.wave.re * cos;
            }
        }
        self
    }
}

impl Waves<'_> {
    /// The sums for waves of about this frequency.
    pub fn band(&self, hz: f64) -> Band {
        let [stretches] = self.sums([hz]);
        Band { hz, stretches }
    }

    /// The sums of all stretches for several frequencies, with one pass through the readings.
    fn sums<const N: usize>(&self, hz: [f64; N]) -> [Vec<Sums>; N] {
        let of_stretch = |stretch: &Stretch| -> [Sums; N] {
            let first_s = self.grid.samples.t_s[stretch.from];
            let (mut z, turn) = (hz.map(|f| phase(f * first_s)), hz.map(|f| phase(f * stretch.dt_s)));
            let mut along = [[Complex::<f64>::ZERO; N]; 3];
            let mut residual = [0.0; 3];
            let [x, y, w] = [0, 1, 2].map(|a: usize| &self.residual[a][stretch.from..stretch.to]);
            for ((x, y), w) in x.iter().zip(y).zip(w) {
                for (a, value) in [*x, *y, *w].into_iter().enumerate() {
                    residual[a] += value;
                    for l in 0..N {
                        along[a][l].re += z[l].re * value;
                        along[a][l].im += z[l].im * value;
                    }
                }
                for l in 0..N {
                    let next = z[l].re * turn[l].re - z[l].im * turn[l].im;
                    z[l].im = z[l].re * turn[l].im + z[l].im * turn[l].re;
                    z[l].re = next;
                }
            }
            let count = stretch.to - stretch.from;
            std::array::from_fn(|l| {
                let (first, step) = ((hz[l] * first_s).fract(), (hz[l] * stretch.dt_s).fract());
                let along = [0, 1, 2].map(|a: usize| along[a][l]);
                Sums {
                    wave: sum_of_wave(first, step, count),
                    square: sum_of_wave(2.0 * first, 2.0 * step, count),
                    along,
                    residual,
                }
            })
        };
        let all: Vec<[Sums; N]> = self.grid.stretches.par_iter().map(of_stretch).collect();
        std::array::from_fn(|l| all.iter().map(|sums| sums[l]).collect())
    }

    /// Sine and cosine parts of the residuals at a frequency near that of a band, by least squares with the means of the plateaus taken off
    /// the waves as well.
    pub fn wave(&self, band: &Band, hz: f64) -> Option<Wave> {
        let t_s = &self.grid.samples.t_s;
        // Of the wave `z` around its means: |z|², z² and the residuals times z, with the weights of the plateaus.
        let (mut sizes, mut squares, mut along) = ([0.0; 3], [Complex::<f64>::ZERO; 3], [Complex::<f64>::ZERO; 3]);
        let mut sums = band.stretches.iter();
        for plateau in self.grid.stretches.chunk_by(|a, b| a.window == b.window) {
            let (mut all, mut count) = (Sums::default(), 0.0);
            for (stretch, own) in plateau.iter().zip(sums.by_ref()) {
                let middle_s = 0.5 * (t_s[stretch.from] + t_s[stretch.to - 1]);
                let turn = phase((hz - band.hz) * middle_s);
                count += (stretch.to - stretch.from) as f64;
                all.wave += own.wave * turn;
                all.square += own.square * turn * turn;
                for a in 0..3 {
                    all.along[a] += own.along[a] * turn;
                    all.residual[a] += own.residual[a];
                }
            }
            let mean = all.wave / count;
            for a in 0..3 {
                let weight = self.noise.weights[a][plateau[0].window];
                sizes[a] += weight * count * (1.0 - mean.norm_sqr());
                squares[a] += (all.square - mean * mean * count) * weight;
                along[a] += (all.along[a] - mean * all.residual[a]) * weight;
            }
        }
        // That of the band: levels from line to line are those of noise, which would move the largest chi square of a strong line.
        let line = self.grid.line(band.hz);
        let mut wave = Wave { hz, sin: [0.0; 3], cos: [0.0; 3], std: [0.0; 3], explained: [0.0; 3], chi: 0.0 };
        for a in 0..3 {
            // Squares and products of sine and cosine.
            let (ss, sc, cc) = (0.5 * (sizes[a] - squares[a].re), 0.5 * squares[a].im, 0.5 * (sizes[a] + squares[a].re));
            let determinant = ss * cc - sc * sc;
            if determinant < 1e-6 * (self.grid.used as f64).powi(2) {
                return None;
            }
            wave.sin[a] = (along[a].im * cc - along[a].re * sc) / determinant;
            wave.cos[a] = (along[a].re * ss - along[a].im * sc) / determinant;
            wave.explained[a] = wave.sin[a] * along[a].im + wave.cos[a] * along[a].re;
            // Means taken off the plateaus lower the level of slow noise as much as the waves.
            wave.std[a] = (2.0 * self.noise.level(a, line)).sqrt() / (ss + cc);
            // Not the squares of its parts: sine and cosine are no more at right angles than a part of the record lets them be, which moves the frequency.
            wave.chi += wave.explained[a] * (ss + cc) / self.noise.level(a, line);
        }
        Some(wave)
    }

    /// Takes waves off the used samples.
    pub fn take_off(&self, values: &mut [Vec<f64>; 3], waves: &[Wave]) {
        let stretches = &self.grid.stretches;
        let parts = parts_mut(values, stretches.iter().map(|stretch| [stretch.from, stretch.to]));
        stretches.par_iter().zip(parts).for_each(|(stretch, [x, y, w])| {
            for wave in waves {
                let own = unit_wave(wave.hz, stretch, &self.grid.samples.t_s);
                for (((x, y), w), z) in x.iter_mut().zip(y.iter_mut()).zip(w.iter_mut()).zip(own) {
                    for (a, value) in [x, y, w].into_iter().enumerate() {
                        *value -= wave.sin[a] * z.im + wave.cos[a] * z.re;
                    }
                }
            }
        });
    }

    /// Evidence of a tone: half of it for one phase on all axes, which is free as that of a switched signal is, half for a phase of each.
    pub fn tone_evidence(wave: &Wave) -> f64 {
        let common = (0..PHASES).map(|k| {
            let (sin, cos) = (PI * k as f64 / PHASES as f64).sin_cos();
            let chi = (0..3).map(|a| ((wave.sin[a] * cos + wave.cos[a] * sin) / wave.std[a]).powi(2)).sum();
            evidence(chi, 3.0) - (PHASES as f64).ln()
        });
        let free = evidence(wave.chi, TONE_PARAMETERS);
        log_sum(common.chain([free])) - std::f64::consts::LN_2
    }

    /// Orders of the harmonics of a wave that are seen, where the samples fold those above half their rate to. A harmonic that they fold onto a lower
    /// one, or to where no wave is seen, is none.
    pub fn orders(&self, hz: f64, count: usize) -> Vec<usize> {
        let (highest_hz, lowest_hz) = (HIGHEST * 0.5 * self.grid.rate_hz, self.grid.lowest_hz());
        let mut seen_hz: Vec<f64> = Vec::new();
        let mut orders = Vec::new();
        for order in 1..=count {
            let f = self.grid.seen_hz(order as f64 * hz);
            let is_apart = seen_hz.iter().all(|g| (f - g).abs() > self.grid.apart_hz());
            if f < highest_hz && (order == 1 || f >= lowest_hz) && is_apart {
                seen_hz.push(f);
                orders.push(order);
            }
        }
        orders
    }

    /// Bands of a wave and its harmonics.
    pub fn bands(&self, hz: f64, count: usize) -> Vec<Band> {
        let hz: Vec<f64> = self.orders(hz, count).into_iter().map(|order| order as f64 * hz).collect();
        let (fours, rest) = hz.as_chunks::<4>();
        let together =
            fours.iter().flat_map(|four| four.iter().zip(self.sums(*four)).map(|(hz, stretches)| Band { hz: *hz, stretches }));
        together.chain(rest.iter().map(|hz| self.band(*hz))).collect()
    }

    /// A wave and its harmonics.
    pub fn harmonics(&self, hz: f64, count: usize) -> Option<Vec<Wave>> {
        let waves: Vec<Wave> = self.bands(hz, count).iter().filter_map(|band| self.wave(band, band.hz)).collect();
        (!waves.is_empty()).then_some(waves)
    }

    /// The frequency of what a line shows. Where the plateaus come at one rate, their means repeat at this rate what they take of a wave that is
    /// too slow to be looked for by itself: that wave explains more of the readings than the line.
    pub fn unrepeated(&self, hz: f64) -> f64 {
        let Some(rate_hz) = self.grid.plateaus_hz() else { return hz };
        let [slowest_hz, lowest_hz] = [self.grid.slowest_hz(), self.grid.lowest_hz()];
        let explained = |hz: f64| {
            let line = self.grid.line(hz);
            // Slow noise explains as much there as it is above the rest; means taken off the plateaus make it no less.
            let level = |a: usize| self.noise.level(a, line).max(self.noise.usual_level(a));
            let of_axis = |(a, squares): (usize, f64)| squares / level(a);
            self.wave(&self.band(hz), hz).map_or(0.0, |wave| wave.explained.into_iter().enumerate().map(of_axis).sum())
        };
        let around = (lowest_hz / rate_hz).ceil() as i32;
        let nearest = (hz / rate_hz).round();
        let slow = (-around..=around).map(|k| (hz - (nearest + f64::from(k)) * rate_hz).abs());
        let slow = slow.filter(|f| (slowest_hz..lowest_hz).contains(f)).map(|f| self.refine(f));
        let all = std::iter::once(hz).chain(slow).map(|hz| (explained(hz), hz));
        all.max_by(|a, b| a.0.total_cmp(&b.0)).map_or(hz, |(_, hz)| hz)
    }

    /// The frequency near a line at which chi square is largest.
    pub fn refine(&self, hz: f64) -> f64 {
        self.refined(&self.band(hz), hz)
    }

    /// The same by the sums of a band.
    pub fn refined(&self, band: &Band, hz: f64) -> f64 {
        let chi = |f: f64| self.wave(band, f).map_or(f64::NEG_INFINITY, |wave| wave.chi);
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
        // So near to the largest value chi square is a parabola, the more so the nearer it is.
        for _ in 0..PARABOLAS {
            let [low, high] = [-width, width].map(|by| chi(best.1 + by));
            let bend = low + high - 2.0 * best.0;
            if bend >= 0.0 {
                break;
            }
            let hz = best.1 + (0.5 * width * (low - high) / bend).clamp(-width, width);
            best = (chi(hz), hz);
            width *= 0.1;
        }
        best.1
    }
}

/// Standard uncertainty of the frequency of a wave by its chi square, Hz: that of a sine in white noise.
pub fn frequency_std_hz(grid: &Grid, chi: f64) -> f64 {
    OF_FREQUENCY * grid.rate_hz / grid.length as f64 / chi.sqrt()
}

/// Logarithm of the evidence of so many free parts, from their chi square.
pub fn evidence(chi: f64, count: f64) -> f64 {
    let g = EXPECTED;
    0.5 * (g / (1.0 + g) * chi - count * (1.0 + g).ln())
}

#[cfg(test)]
mod tests {
    use super::super::super::demean;
    use super::super::spectrum::{Grid, Spectrum};
    use super::{Waves, frequency_std_hz};
    use crate::fit::random::Random;
    use crate::record::prepared::Samples;
    use std::f64::consts::TAU;

    const RATE_HZ: f64 = 32.0;

    /// 90 plateaus of 6 s every 7 s, a packet of 16 samples missing in the fifth, and what a signal leaves around their means, plus and minus
    /// 0.1 in turn.
    fn residual(signal: impl Fn(f64) -> f64) -> (Samples, Vec<[usize; 2]>, [Vec<f64>; 3]) {
        let lost = 4 * 224 + 50..4 * 224 + 66;
        let kept: Vec<usize> = (0..90 * 224).filter(|k| !lost.contains(k)).collect();
        let samples = Samples { t_s: kept.iter().map(|k| 3.0 + *k as f64 / RATE_HZ).collect(), ..Samples::default() };
        let place = |n: usize| kept.partition_point(|k| *k < n);
        let windows: Vec<[usize; 2]> = (0..90).map(|i| [place(224 * i), place(224 * i + 192)]).collect();
        let of = |a: f64| -> Vec<f64> {
            kept.iter().map(|k| signal(3.0 + *k as f64 / RATE_HZ) * a + if k % 2 == 0 { 0.1 } else { -0.1 }).collect()
        };
        let mut residual = [of(1.0), of(-2.0), of(0.0)];
        demean(&mut residual, &windows);
        (samples, windows, residual)
    }

    /// `0.5 sin + 0.3 cos`, for frequencies of a few cycles per plateau, quick ones, and slow ones of which the means take a part: the wave of a
    /// band that was summed up at another frequency, four lines off, has its amplitudes, and nothing of it is left when it is taken off.
    #[test]
    fn waves_beside_the_frequency_of_a_band_have_the_right_size() {
        for hz in [0.09, 0.7, 4.321, 14.9] {
            let (samples, windows, residual) = residual(|t| 0.5 * (TAU * hz * t).sin() + 0.3 * (TAU * hz * t).cos());
            let grid = Grid::new(&samples, &windows, RATE_HZ).expect("a grid");
            let mut spectrum = Spectrum::new(&grid);
            let noise = spectrum.take(&grid, &residual).expect("a spectrum");
            let waves = Waves { grid: &grid, noise: &noise, residual: &residual };
            for off in [0.0, 4.0] {
                let wave = waves.wave(&waves.band(hz - off * grid.step_hz()), hz).expect("a wave");
                for (a, size) in [(0, 1.0), (1, -2.0), (2, 0.0)] {
                    // The alternating part is orthogonal to the waves but for a few parts in a thousand.
                    assert!((wave.sin[a] - 0.5 * size).abs() < 3e-3, "{hz} {off} {a}: {}", wave.sin[a]);
                    assert!((wave.cos[a] - 0.3 * size).abs() < 3e-3, "{hz} {off} {a}: {}", wave.cos[a]);
                }
            }
            let wave = waves.wave(&waves.band(hz), hz).expect("a wave");
            let mut left = residual.clone();
            waves.take_off(&mut left, &[wave]);
            demean(&mut left, &windows);
            for values in left {
                let most = windows.iter().flat_map(|[from, to]| &values[*from..*to]).fold(0.0, |m: f64, v| m.max(v.abs()));
                assert!((most - 0.1).abs() < 5e-3, "{hz}: {most}");
            }
        }
    }

    /// Tones of 100 times the noise on 40 records, of frequencies at which the nearest line of the spectrum changes, and with it the level of the noise: the
    /// frequency, and the phase in the middle of the record, are off by what their uncertainties say.
    #[test]
    fn a_strong_tone_is_off_by_its_uncertainty() {
        let (samples, windows, _) = residual(|_| 0.0);
        let grid = Grid::new(&samples, &windows, RATE_HZ).expect("a grid");
        let middle_s = 0.5 * (samples.t_s[0] + samples.t_s[samples.t_s.len() - 1]);
        let (mut of_frequency, mut of_phase) = (0.0, 0.0);
        for seed in 0..40 {
            let mut random = Random::seeded(seed);
            let mut noise_of = || samples.t_s.iter().map(|_| random.gaussian()).collect::<Vec<f64>>();
            let mut quiet = [noise_of(), noise_of(), noise_of()];
            let hz = (6000.0 + 100.0 * seed as f64 + 0.5) * grid.step_hz();
            let mut loud = quiet.clone();
            for values in &mut loud {
                values.iter_mut().zip(&samples.t_s).for_each(|(v, t)| *v += 100.0 * (TAU * hz * (t - middle_s)).sin());
            }
            demean(&mut quiet, &windows);
            demean(&mut loud, &windows);
            let noise = Spectrum::new(&grid).take(&grid, &quiet).expect("a spectrum");
            let waves = Waves { grid: &grid, noise: &noise, residual: &loud };
            let found_hz = waves.refine(hz + 0.7 * grid.step_hz());
            let wave = waves.wave(&waves.band(found_hz), found_hz).expect("a wave");
            of_frequency += ((found_hz - hz) / frequency_std_hz(&grid, wave.chi)).powi(2);
            let turned = TAU * (found_hz * middle_s).fract();
            let quarter = wave.cos[0] * turned.cos() + wave.sin[0] * turned.sin();
            of_phase += (quarter / wave.std[0]).powi(2);
        }
        // Of 40 normal numbers the mean square has a standard deviation of 0.22.
        for mean_square in [of_frequency / 40.0, of_phase / 40.0] {
            assert!((0.34..1.66).contains(&mean_square), "{of_frequency} {of_phase}");
        }
    }
}
