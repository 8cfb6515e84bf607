//! Noise of the samples: what the simulation has of its own, and what is added to its samples on the way to the analysis.

use super::RATE_HZ;
use calfit::data::run::{Header, Run, Setting, Vector, VectorSink};
use calfit::simulate::noise::{Random, relaxations};
use calfit::simulate::run::SimulatedRun;
use std::f64::consts::{PI, TAU};

/// Ratio of neighbouring time constants of slow noise that is not 1/f.
const RATIO: f64 = 4.0;
/// Steps of a relaxation per time constant; between them it is a straight line.
const STEPS: f64 = 16.0;

/// Noise of the samples.
#[derive(Clone, Copy)]
pub struct Noise {
    pub name: &'static str,
    /// Samples per second.
    pub rate_hz: f64,
    /// Standard deviation of a sample, enT.
    pub white_ent: f64,
    /// Frequency at which the slow noise is as dense as the white noise, Hz; 0 for none.
    pub corner_hz: f64,
    /// Exponent `a` of its power density `f^-a`.
    pub exponent: f64,
    /// Lowest frequency of the slow noise, Hz; otherwise its memory is as long as the run.
    pub lowest_hz: Option<f64>,
    /// White noise of a sample in proportion to its reading: standard deviation over the reading.
    pub of_reading: f64,
    /// White noise with the tails of Student's distribution with three degrees of freedom.
    pub heavy: bool,
    /// Scatter of every setting on every coil axis, nT.
    pub scatter_nt: f64,
}

const WHITE: Noise = Noise {
    name: "white",
    rate_hz: RATE_HZ,
    white_ent: 0.4,
    corner_hz: 0.0,
    exponent: 1.0,
    lowest_hz: None,
    of_reading: 0.0,
    heavy: false,
    scatter_nt: 0.0,
};

/// The cases of the full study. The last is that of the twin of 2013.
pub const NOISES: [Noise; 8] = [
    WHITE,
    Noise { name: "1/f, corner at 0.003 Hz", corner_hz: 0.003, ..WHITE },
    Noise { name: "1/f, corner at 0.1 Hz", corner_hz: 0.1, ..WHITE },
    Noise { name: "1/f, corner at 5 Hz", white_ent: 0.1, corner_hz: 5.0, ..WHITE },
    Noise { name: "f^-1.5, corner at 0.05 Hz", corner_hz: 0.05, exponent: 1.5, ..WHITE },
    Noise { name: "growing with the field", of_reading: 5e-4, ..WHITE },
    Noise { name: "heavy tails", heavy: true, ..WHITE },
    Noise {
        name: "settings that scatter, 1/f",
        white_ent: 0.5,
        corner_hz: 0.1,
        scatter_nt: 0.03,
        lowest_hz: Some(5e-4),
        ..WHITE
    },
];

impl Noise {
    /// The relaxations of the slow noise: variance, enT², and time constant, s.
    pub fn relaxations(&self, rate_hz: f64, lowest_hz: f64) -> Vec<(f64, f64)> {
        // The density of white noise is 2 σ² / rate.
        let density = 2.0 * self.white_ent.powi(2) / self.rate_hz * self.corner_hz.powf(self.exponent);
        if self.exponent == 1.0 {
            return relaxations(density.sqrt(), rate_hz, lowest_hz);
        }
        // The sum over variances c τ^(a-1) has the density c π / (2 sin(π a / 2)) 4 / ln r (2 π f)^-a.
        let scale = density * RATIO.ln() * TAU.powf(self.exponent) * (0.5 * PI * self.exponent).sin() / TAU;
        let longest = 1.0 / (TAU * lowest_hz);
        let count = (longest * rate_hz * 4.0).log(RATIO).round() as i32 + 1;
        (0..count).map(|k| longest / RATIO.powi(k)).map(|tau| (scale * tau.powf(self.exponent - 1.0), tau)).collect()
    }

    /// What the simulation itself makes: white noise of a sample and amplitude density of its 1/f noise at 1 Hz.
    pub fn own(&self) -> (f64, f64) {
        let flicker = if self.exponent == 1.0 { self.white_ent * (2.0 * self.corner_hz / self.rate_hz).sqrt() } else { 0.0 };
        // Heavy tails are added to readings that are rounded already: some noise before makes rounding errors independent of each other.
        (if self.heavy { 0.05 * self.white_ent } else { self.white_ent }, flicker)
    }

    /// Gives a run to an analysis with all noise.
    pub fn play<S: VectorSink>(&self, run: &SimulatedRun, lowest_hz: f64, seed: u64, sink: &mut S) -> Run {
        let mut random = Random::new(seed, &["added noise"]);
        let list = if self.exponent == 1.0 { Vec::new() } else { self.relaxations(self.rate_hz, lowest_hz) };
        let slow = std::array::from_fn(|_| list.iter().map(|r| Relaxation::new(*r, self.rate_hz, &mut random)).collect());
        run.play(&mut Noisy { sink, noise: self, slow, random })
    }
}

/// A process of first order, stepped every so many samples.
struct Relaxation {
    value: f64,
    slope: f64,
    left: u32,
    period: u32,
    decay: f64,
    kick: f64,
}

impl Relaxation {
    fn new((variance, tau_s): (f64, f64), rate_hz: f64, random: &mut Random) -> Self {
        let period = (tau_s * rate_hz / STEPS).max(1.0) as u32;
        let decay = (-f64::from(period) / (tau_s * rate_hz)).exp();
        let std = variance.sqrt();
        Self { value: std * random.normal(), slope: 0.0, left: 0, period, decay, kick: std * (1.0 - decay * decay).sqrt() }
    }

    fn next(&mut self, random: &mut Random) -> f64 {
        if self.left == 0 {
            let next = self.value * self.decay + self.kick * random.normal();
            self.slope = (next - self.value) / f64::from(self.period);
            self.left = self.period;
        }
        self.left -= 1;
        let value = self.value;
        self.value += self.slope;
        value
    }
}

/// Adds noise to samples on their way.
struct Noisy<'a, S> {
    sink: &'a mut S,
    noise: &'a Noise,
    slow: [Vec<Relaxation>; 3],
    random: Random,
}

impl<S: VectorSink> VectorSink for Noisy<'_, S> {
    fn needs_settings(&self) -> bool {
        self.sink.needs_settings()
    }

    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        self.sink.begin(header, settings);
    }

    fn vector(&mut self, mut vector: Vector) {
        let random = &mut self.random;
        for (value, slow) in vector.reading.0.iter_mut().zip(&mut self.slow) {
            let mut added = slow.iter_mut().map(|r| r.next(random)).sum::<f64>();
            if self.noise.of_reading > 0.0 {
                added += self.noise.of_reading * *value * random.normal();
            }
            if self.noise.heavy {
                let square = (0..3).map(|_| random.normal().powi(2)).sum::<f64>();
                // Student's distribution with three degrees of freedom has the variance three.
                added += self.noise.white_ent * random.normal() / square.sqrt();
            }
            *value += added;
        }
        self.sink.vector(vector);
    }
}
