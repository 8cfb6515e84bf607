//! Harmonics of one period, fitted together: beside the means of the plateaus they are not at right angles, least of all where the plateaus are
//! equally long and the means repeat what is slow at the rate of the plateaus.

use super::HARMONICS;
use super::spectrum::{REPEATED, Spectrum, Stretch};
use super::waves::{Band, Sums, Switched, Wave, Waves, evidence, phase, sum_of_wave};
use crate::model::effects::in_samples::Comb;
use nalgebra::{DMatrix, DVector};
use realfft::num_complex::Complex;

/// Steps of a base, as parts of the resolution of the record: of the last harmonic this is no more than half of it.
const BASE_STEP: f64 = 0.06;
const BASE_STEPS: i32 = 4;
/// Rounds of closer steps of period, duty and delay.
const POLISHED: usize = 8;
/// Duties that are tried, 0.05 apart.
const DUTIES: usize = 19;
/// What a wave may have more than the nearest line of the spectrum, twice as close as the record resolves, and the part that windows take of it.
const MORE_THAN_LINE: f64 = 1.25;

/// Harmonics of a period as they are seen in the samples.
pub struct Harmonics {
    /// Period that the sums were made for, as a frequency.
    base_hz: f64,
    orders: Vec<usize>,
    bands: Vec<Band>,
    /// Sums of products of two harmonics, and of one with the conjugate of the other, pair after pair, per stretch.
    products: Vec<Vec<[Complex<f64>; 2]>>,
}

/// What the samples say of the sines and cosines of harmonics, in turn, where the noise of each harmonic is its own.
pub struct Joint {
    orders: Vec<usize>,
    axes: [Axis; 3],
}

/// Of the normal equations `N x = r` of white noise and the reciprocal noise `D` of the harmonics beside it, `D r` has the covariance `N`.
struct Axis {
    /// Chi square of all harmonics with any sizes and phases, `(D r)ᵀ N⁻¹ D r`.
    explained: f64,
    /// What a shape p is multiplied with for its part of `D r`: `N D N⁻¹ D r`.
    shown: DVector<f64>,
    /// Its own square, `N D N⁻¹ D N`.
    metric: DMatrix<f64>,
}

impl Axis {
    fn of(normal: DMatrix<f64>, right: &DVector<f64>, per_noise: &[f64]) -> Self {
        let Some(cholesky) = normal.clone().cholesky() else {
            return Self { explained: 0.0, shown: right * 0.0, metric: normal * 0.0 };
        };
        let right = DVector::from_fn(right.len(), |k, _| per_noise[k / 2] * right[k]);
        let solved = cholesky.solve(&right);
        let mut by_shape = normal;
        by_shape.row_iter_mut().enumerate().for_each(|(k, mut row)| row *= per_noise[k / 2]);
        Self {
            explained: right.dot(&solved),
            shown: by_shape.tr_mul(&solved),
            metric: by_shape.tr_mul(&cholesky.solve(&by_shape)),
        }
    }
}

impl Harmonics {
    /// Harmonics of a period; `None` where none is seen.
    pub fn new(waves: &Waves, base_hz: f64) -> Option<Self> {
        let bands = waves.bands(base_hz, HARMONICS);
        let orders: Vec<usize> = bands.iter().map(|band| (band.hz / base_hz).round() as usize).collect();
        let t_s = &waves.grid.samples.t_s;
        let of_stretch = |stretch: &Stretch| {
            let count = stretch.to - stretch.from;
            let of = |hz: f64| ((hz * t_s[stretch.from]).fract(), (hz * stretch.dt_s).fract());
            pairs(&orders)
                .map(|(i, j)| {
                    let ((a, b), (c, d)) = (of(bands[i].hz), of(bands[j].hz));
                    [sum_of_wave(a + c, b + d, count), sum_of_wave(a - c, b - d, count)]
                })
                .collect()
        };
        let products = waves.grid.stretches.iter().map(of_stretch).collect();
        (!orders.is_empty()).then_some(Self { base_hz, orders, bands, products })
    }

    /// Whether a single harmonic is seen, as of a tone.
    pub fn is_single(&self) -> bool {
        self.orders.len() == 1
    }

    /// Normal equations for a period nearby.
    pub fn at(&self, waves: &Waves, base_hz: f64) -> Joint {
        let (t_s, stretches) = (&waves.grid.samples.t_s, &waves.grid.stretches);
        let (n, by_hz) = (self.orders.len(), base_hz - self.base_hz);
        let mut axes = [0, 1, 2].map(|_| (DMatrix::<f64>::zeros(2 * n, 2 * n), DVector::<f64>::zeros(2 * n)));
        let mut at = 0;
        for plateau in stretches.chunk_by(|a, b| a.window == b.window) {
            let mut own = vec![Sums::default(); n];
            let mut products = vec![[Complex::<f64>::ZERO; 2]; n * (n + 1) / 2];
            let mut count = 0.0;
            for stretch in plateau {
                let turn = |order: i32| phase(f64::from(order) * by_hz * 0.5 * (t_s[stretch.from] + t_s[stretch.to - 1]));
                // Phases of all orders from that of the first, as powers.
                let first = turn(1);
                let powers: Vec<Complex<f64>> =
                    std::iter::successors(Some(Complex::new(1.0, 0.0)), |z| Some(z * first)).take(2 * HARMONICS + 1).collect();
                count += (stretch.to - stretch.from) as f64;
                for ((own, band), order) in own.iter_mut().zip(&self.bands).zip(&self.orders) {
                    let (sums, turn) = (&band.stretches[at], powers[*order]);
                    own.wave += sums.wave * turn;
                    for a in 0..3 {
                        own.along[a] += sums.along[a] * turn;
                        own.residual[a] += sums.residual[a];
                    }
                }
                for (k, (i, j)) in pairs(&self.orders).enumerate() {
                    let [sum, difference] = self.products[at][k];
                    let (i, j) = (self.orders[i], self.orders[j]);
                    products[k][0] += sum * powers[i + j];
                    products[k][1] += difference * if i >= j { powers[i - j] } else { powers[j - i].conj() };
                }
                at += 1;
            }
            for (a, (normal, right)) in axes.iter_mut().enumerate() {
                let weight = waves.noise.weights[a][plateau[0].window];
                for (k, (i, j)) in pairs(&self.orders).enumerate() {
                    let (w, v) = (own[i].wave, own[j].wave);
                    let sum = (products[k][0] - w * v / count) * (0.5 * weight);
                    let difference = (products[k][1] - w * v.conj() / count) * (0.5 * weight);
                    normal[(2 * i, 2 * j)] += difference.re - sum.re;
                    normal[(2 * i + 1, 2 * j + 1)] += difference.re + sum.re;
                    normal[(2 * i, 2 * j + 1)] += sum.im + difference.im;
                    normal[(2 * i + 1, 2 * j)] += if i == j { 0.0 } else { sum.im - difference.im };
                }
                for (i, own) in own.iter().enumerate() {
                    let along = own.along[a] - own.wave * (own.residual[a] / count);
                    right[2 * i] += weight * along.im;
                    right[2 * i + 1] += weight * along.re;
                }
            }
        }
        let mut axes = axes.into_iter().enumerate().map(|(a, (mut normal, right))| {
            for i in 0..2 * n {
                for j in 0..i {
                    normal[(i, j)] = normal[(j, i)];
                }
            }
            let noise = |i: usize| {
                // That of the bands, whatever the period: see [`Waves::refine`].
                let line = waves.grid.line(self.bands[i].hz);
                // Means taken off the plateaus lower the level of slow noise as much as the waves.
                let size = 0.5 * (normal[(2 * i, 2 * i)] + normal[(2 * i + 1, 2 * i + 1)]);
                (2.0 * size / waves.noise.level(a, line)).sqrt()
            };
            let per_noise: Vec<f64> = (0..n).map(noise).collect();
            Axis::of(normal, &right, &per_noise)
        });
        Joint { orders: self.orders.clone(), axes: std::array::from_fn(|_| axes.next().expect("three axes")) }
    }
}

/// Duties that are tried.
fn duties() -> impl Iterator<Item = f64> {
    (1..=DUTIES).map(|d| 0.05 * d as f64)
}

/// Pairs of harmonics, the earlier one first.
fn pairs(orders: &[usize]) -> impl Iterator<Item = (usize, usize)> + use<> {
    let n = orders.len();
    (0..n).flat_map(move |i| (i..n).map(move |j| (i, j)))
}

impl Joint {
    /// Chi square of all harmonics with any sizes and phases.
    fn explained(&self) -> f64 {
        self.axes.iter().map(|axis| axis.explained).sum()
    }

    /// Chi square of a switched signal and its amplitudes with uncertainties.
    pub fn matched(&self, form: &Comb, duty: f64, delay: f64) -> (f64, [(f64, f64); 3]) {
        let parts = self.orders.iter().flat_map(|order| {
            let (sin, cos) = (form.harmonic)(*order, duty, delay);
            [sin, cos]
        });
        let shape = DVector::from_vec(parts.collect());
        let mut gain = 0.0;
        let values = self.axes.each_ref().map(|axis| {
            let top = shape.dot(&axis.shown);
            let bottom = shape.dot(&(&axis.metric * &shape));
            if bottom <= 0.0 {
                // Nothing is seen of such a signal.
                return (0.0, f64::INFINITY);
            }
            gain += top * top / bottom;
            (top / bottom, bottom.sqrt().recip())
        });
        (gain, values)
    }
}

/// What is seen of a line: the waves of it and of its harmonics, and the spectrum without them.
pub struct Seen<'a> {
    pub waves: &'a [Wave],
    pub spectrum: &'a Spectrum,
}

impl Waves<'_> {
    /// No less than the evidence of any switched signal of a period whose harmonic of this order was seen: as if all harmonics that are seen had the phases of
    /// its own. Where a plateau has only a few periods they are not at right angles, and nothing is known of it.
    pub fn most_evidence(&self, seen: &Seen, form: &Comb, base_hz: f64, order: f64) -> f64 {
        if base_hz * self.grid.longest_s() < REPEATED {
            return f64::INFINITY;
        }
        let strength = |order: usize| -> [f64; 3] {
            let hz = order as f64 * base_hz;
            let own = seen.waves.iter().find(|wave| (wave.hz - hz).abs() < self.grid.apart_hz());
            let of_line = || seen.spectrum.strength(self.grid.line(hz), self.noise).map(|s| MORE_THAN_LINE * s);
            // The noise is that beside the waves, which they were not measured in; the means of the plateaus take none of them here.
            let std = |a: usize| (2.0 * self.noise.level(a, self.grid.line(hz))).sqrt() / self.grid.used as f64;
            own.map_or_else(of_line, |wave| std::array::from_fn(|a| wave.sin[a].hypot(wave.cos[a]) / std(a)))
        };
        let all: Vec<(usize, [f64; 3])> =
            self.orders(base_hz, HARMONICS).into_iter().map(|order| (order, strength(order))).collect();
        let chi = |duty: f64| -> f64 {
            let of_axis = |a: usize| {
                let (mut along, mut square) = (0.0, f64::MIN_POSITIVE);
                for (order, strength) in &all {
                    let (sin, cos) = (form.harmonic)(*order, duty, 0.0);
                    let size = sin.hypot(cos) / self.noise.level(a, self.grid.line(*order as f64 * base_hz)).sqrt();
                    along += size * strength[a];
                    square += size * size;
                }
                along * along / square
            };
            (0..3).map(of_axis).sum()
        };
        evidence(duties().map(chi).fold(0.0, f64::max), 3.0) - order.ln()
    }

    /// The switched signal of a period whose harmonic of this order was seen.
    pub fn switched(&self, form: &Comb, base_hz: f64, order: f64) -> Option<Switched> {
        let harmonics = Harmonics::new(self, base_hz)?;
        // The line of one harmonic is known to a part of the resolution, and less well beside others.
        let step_hz = self.grid.rate_hz / self.grid.length as f64 * BASE_STEP;
        let near = (-BASE_STEPS..=BASE_STEPS).map(|k| base_hz + f64::from(k) * step_hz);
        let all = near.map(|base_hz| (base_hz, harmonics.at(self, base_hz)));
        let (base_hz, joint) = all.max_by(|a, b| a.1.explained().total_cmp(&b.1.explained()))?;
        let all: Vec<(f64, f64, f64)> = duties()
            .flat_map(|duty| (0..64).map(move |d| (duty, d as f64 / 64.0)))
            .map(|(duty, delay)| (joint.matched(form, duty, delay).0, duty, delay))
            .collect();
        let (gain, duty, delay) = *all.iter().max_by(|a, b| a.0.total_cmp(&b.0))?;
        let most = evidence(gain, 3.0);
        let mean = all.iter().map(|one| (evidence(one.0, 3.0) - most).exp()).sum::<f64>() / all.len() as f64;
        let single = harmonics.is_single();
        Some(Switched { base_hz, evidence: most + mean.ln() - order.ln(), single, gain, duty, delay })
    }

    /// Period, duty and delay, closer, with the amplitudes of the axes and their uncertainties.
    pub fn polish(&self, form: &Comb, found: &Switched) -> Option<(Switched, [(f64, f64); 3])> {
        let mut best = found.clone();
        let better = |best: &mut Switched, joint: &Joint, base_hz: f64, duty: f64, delay: f64| {
            let (duty, delay) = (duty.clamp(0.02, 0.98), delay.rem_euclid(1.0));
            let gain = joint.matched(form, duty, delay).0;
            if gain > best.gain {
                *best = Switched { base_hz, gain, duty, delay, ..*best };
            }
        };
        let harmonics = Harmonics::new(self, found.base_hz)?;
        let (mut df, mut dd, mut dl) = (0.3 * self.grid.step_hz(), 0.025, 1.0 / 128.0);
        for _ in 0..POLISHED {
            for sign in [-1.0, 1.0] {
                let base_hz = best.base_hz + sign * df;
                let joint = harmonics.at(self, base_hz);
                // A changed period moves the delay over the record: it is looked for again.
                for shift in [-2.0, -1.0, 0.0, 1.0, 2.0] {
                    let (duty, delay) = (best.duty, best.delay + shift * dl);
                    better(&mut best, &joint, base_hz, duty, delay);
                }
            }
            let base_hz = best.base_hz;
            let joint = harmonics.at(self, base_hz);
            for sign in [-1.0, 1.0] {
                for (d, l) in [(sign * dd, 0.0), (0.0, sign * dl), (sign * dd, -0.5 * sign * dd)] {
                    let (duty, delay) = (best.duty + d, best.delay + l);
                    better(&mut best, &joint, base_hz, duty, delay);
                }
            }
            df *= 0.5;
            dd *= 0.6;
            dl *= 0.6;
        }
        let values = harmonics.at(self, best.base_hz).matched(form, best.duty, best.delay).1;
        Some((best, values))
    }
}
