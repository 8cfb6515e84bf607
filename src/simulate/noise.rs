//! Random numbers of the simulation: white noise, 1/f noise, and a stream of its own for every purpose.

use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use sha2::{Digest, Sha256};

/// Ratio of neighbouring time constants: the sum of relaxations then follows 1/f within 0.3 %.
const RATIO: f64 = 4.0;
/// Steps of a slow relaxation per time constant; between them it is a straight line.
const STEPS: f64 = 16.0;
/// Shortest time constant, samples.
const SHORTEST: f64 = 0.25;

/// Random numbers for one purpose.
#[derive(Clone, Debug)]
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// The stream of a purpose: equal seeds and names give equal numbers, different ones have nothing in common.
    #[must_use]
    pub fn new(seed: u64, names: &[&str]) -> Self {
        let mut hash = Sha256::new();
        hash.update(seed.to_le_bytes());
        for name in names {
            hash.update((name.len() as u64).to_le_bytes());
            hash.update(name.as_bytes());
        }
        Self(Xoshiro256PlusPlus::from_seed(hash.finalize().into()))
    }

    /// Mean 0, standard deviation 1.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Uniform in [0, 1).
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }
}

/// One relaxation: an autoregressive process of first order, stepped every so many samples.
#[derive(Clone, Copy, Debug)]
struct Relaxation {
    value: f64,
    slope: f64,
    decay: f64,
    kick: f64,
    period: u32,
}

/// Noise with a power density of `a²/f` between a lowest frequency and a tenth of the sample rate (above, aliases add up to the same again), as
/// the sum of relaxations with time constants in equal ratios.
#[derive(Clone, Debug)]
pub struct Flicker {
    relaxations: Vec<Relaxation>,
    sample: u64,
    value: f64,
    slope: f64,
}

impl Flicker {
    /// `a`: amplitude density at 1 Hz in the unit of the noise per √Hz.
    #[must_use]
    pub fn new(a: f64, rate_hz: f64, lowest_hz: f64, random: &mut Random) -> Self {
        let relaxations: Vec<Relaxation> = relaxations(a, rate_hz, lowest_hz)
            .into_iter()
            .map(|(variance, time_constant_s)| {
                let (std, time_constant) = (variance.sqrt(), time_constant_s * rate_hz);
                // Periods are powers of four, so that the trailing zeros of the sample number tell which relaxations step.
                let power = (time_constant / STEPS).max(1.0).log(4.0).floor() as u32;
                let period = 4u32.pow(power);
                let decay = (-f64::from(period) / time_constant).exp();
                Relaxation { value: std * random.normal(), slope: 0.0, decay, kick: std * (1.0 - decay * decay).sqrt(), period }
            })
            .collect();
        Self { value: relaxations.iter().map(|r| r.value).sum(), slope: 0.0, relaxations, sample: 0 }
    }

    /// The noise at the next sample.
    #[inline]
    pub fn next(&mut self, random: &mut Random) -> f64 {
        if self.relaxations.is_empty() {
            return 0.0;
        }
        // Relaxations stand in the order of falling periods: those at the end step at every sample.
        let trailing = self.sample.trailing_zeros();
        for relaxation in self.relaxations.iter_mut().rev() {
            if relaxation.period.trailing_zeros() > trailing {
                break;
            }
            let next = relaxation.value * relaxation.decay + relaxation.kick * random.normal();
            let slope = (next - relaxation.value) / f64::from(relaxation.period);
            self.slope += slope - relaxation.slope;
            relaxation.slope = slope;
            relaxation.value = next;
        }
        let value = self.value;
        self.value += self.slope;
        self.sample += 1;
        value
    }
}

/// The relaxations that make up [`Flicker`]: variance and time constant, s, the longest first.
///
/// The (one-sided) density of relaxations of variance v with time constants in the ratio r is `v / (f ln r)`.
#[must_use]
pub fn relaxations(a: f64, rate_hz: f64, lowest_hz: f64) -> Vec<(f64, f64)> {
    let longest = (rate_hz / (std::f64::consts::TAU * lowest_hz)).max(SHORTEST);
    let count = if a > 0.0 { (longest / SHORTEST).log(RATIO).round() as i32 + 1 } else { 0 };
    (0..count).map(|k| (a * a * RATIO.ln(), longest / RATIO.powi(k) / rate_hz)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_the_same_every_time_and_differ_by_name() {
        let first = |names: &[&str]| Random::new(7, names).uniform();
        assert_eq!(first(&["a", "b"]), first(&["a", "b"]));
        assert_ne!(first(&["a", "b"]), first(&["ab", ""]));
        assert_ne!(first(&["a"]), Random::new(8, &["a"]).uniform());
    }

    /// Power density from periodograms over records of a power of two, averaged in octaves: nothing of the generator's form.
    #[test]
    fn flicker_has_a_density_that_falls_with_the_frequency() {
        let (rate, a, length) = (128.0, 0.02, 4096usize);
        let mut random = Random::new(3, &["flicker"]);
        let mut flicker = Flicker::new(a, rate, 1e-4, &mut random);
        let records = 60;
        let mut octaves = [(0.0, 0u32); 9];
        for _ in 0..records {
            let samples: Vec<f64> = (0..length).map(|_| flicker.next(&mut random)).collect();
            for (octave, (sum, count)) in octaves.iter_mut().enumerate() {
                // Ten frequencies of the octave by Goertzel's sums, with a Hann window against leakage from below.
                for k in (0..10).map(|k| (4usize << octave) + k * (4 << octave) / 10) {
                    let f = k as f64 / length as f64;
                    let (mut re, mut im) = (0.0, 0.0);
                    for (n, y) in samples.iter().enumerate() {
                        let window = 1.0 - (std::f64::consts::TAU * n as f64 / length as f64).cos();
                        let (s, c) = (std::f64::consts::TAU * f * n as f64).sin_cos();
                        re += window * y * c;
                        im += window * y * s;
                    }
                    // The mean square of this window is 3/2.
                    let density = 2.0 * (re * re + im * im) / (1.5 * length as f64 * rate);
                    *sum += density * f * rate / (a * a);
                    *count += 1;
                }
            }
        }
        for (octave, (sum, count)) in octaves.into_iter().enumerate() {
            let ratio = sum / f64::from(count);
            // 600 exponential values have a standard error of 4 %; aliases lift what is above a tenth of the rate.
            let tolerance = [0.15, 0.3, 0.6, 1.2][usize::saturating_sub(octave, 5)];
            assert!((ratio - 1.0).abs() < tolerance, "octave {octave}: {ratio}");
        }
    }
}
