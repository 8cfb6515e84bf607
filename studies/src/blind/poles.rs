//! One pole or two in a part of the field: how often they could be distinguished by someone who knows the distribution from which the generator
//! draws them.
//! Signatures in the response are linear in the part, noise is white.

use super::freq::{self, multiply, one_pole, second_order};
use super::noise::Random;
use super::sensor::{CleanRun, Kind, Sensor};
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::f64::consts::TAU;

/// Sensors per truth, and draws of noise per sensor.
const SENSORS: u64 = 100;
const DRAWS: usize = 20;
/// Frequencies of one pole and of two poles, and values of Q, that stand for the ranges of the generator.
const GRID: [usize; 3] = [60, 11, 4];

/// Signatures of one sensor beside its own parameters.
struct Sines {
    base: Vec<[f64; 2]>,
    frequencies_hz: Vec<f64>,
    weights: Vec<f64>,
    own: DMatrix<f64>,
}

impl Sines {
    fn new(clean: &CleanRun) -> Self {
        let truth = freq::truth(clean);
        let frequencies_hz: Vec<f64> = clean.settings.iter().map(|s| s.frequency_hz).collect();
        let weights = clean.settings.iter().map(|s| (s.t_end_s - s.t_start_s).sqrt()).collect();
        let of = |f: f64, i: usize, change: [f64; 2]| second_order(f, truth.f0_hz[i] * change[0], truth.q[i] * change[1]);
        let base = (0..3).flat_map(|i| frequencies_hz.iter().map(move |f| (*f, i))).map(|(f, i)| of(f, i, [1.0, 1.0])).collect();
        let mut sines = Self { base, frequencies_hz, weights, own: DMatrix::zeros(0, 0) };
        let n = sines.frequencies_hz.len();
        let middle_s: Vec<f64> = clean.settings.iter().map(|s| 0.5 * (s.t_start_s + s.t_end_s)).collect();
        let mut columns = Vec::new();
        for i in 0..3 {
            let own = |value: &dyn Fn(usize) -> [f64; 2]| {
                let all: Vec<[f64; 2]> = (0..3 * n).map(|k| if k / n == i { value(k % n) } else { [0.0; 2] }).collect();
                sines.column(&all)
            };
            let now = |j: usize| sines.base[i * n + j];
            let moved = |j: usize, change: [f64; 2]| {
                let to = of(sines.frequencies_hz[j], i, change);
                [1e5 * (to[0] - now(j)[0]), 1e5 * (to[1] - now(j)[1])]
            };
            columns.push(own(&now));
            columns.push(own(&|j| moved(j, [1.0 + 1e-5, 1.0])));
            columns.push(own(&|j| moved(j, [1.0, 1.0 + 1e-5])));
            // The sample rate.
            columns.push(own(&|j| multiply(now(j), [0.0, -1e-3 * TAU * sines.frequencies_hz[j] * middle_s[j]])));
        }
        // A common delay.
        let late: Vec<[f64; 2]> =
            (0..3 * n).map(|k| multiply(sines.base[k], [0.0, -1e-2 * TAU * sines.frequencies_hz[k % n]])).collect();
        columns.push(sines.column(&late));
        sines.own = DMatrix::from_columns(&columns).qr().q();
        sines
    }

    fn column(&self, values: &[[f64; 2]]) -> DVector<f64> {
        let n = self.frequencies_hz.len();
        DVector::from_iterator(2 * values.len(), values.iter().enumerate().flat_map(|(k, v)| v.map(|v| v * self.weights[k % n])))
    }

    fn beside_own(&self, column: &DVector<f64>) -> DVector<f64> {
        column - &self.own * self.own.tr_mul(column)
    }

    /// Unit signature of a part of the field that passes a response.
    fn signature(&self, response: impl Fn(f64) -> [f64; 2]) -> DVector<f64> {
        let n = self.frequencies_hz.len();
        let change = |k: usize| {
            let [re, im] = response(self.frequencies_hz[k % n]);
            multiply(self.base[k], [re - 1.0, im])
        };
        let all: Vec<[f64; 2]> = (0..3 * n).map(change).collect();
        self.beside_own(&self.column(&all)).normalize()
    }
}

/// Logarithm of the evidence up to a constant: any signature of a list is as likely, any size is.
fn evidence(signatures: &[DVector<f64>], data: &DVector<f64>) -> f64 {
    let halves: Vec<f64> = signatures.iter().map(|s| 0.5 * s.dot(data).powi(2)).collect();
    let most = halves.iter().fold(0.0, |m: f64, h| m.max(*h));
    most + (halves.iter().map(|h| (h - most).exp()).sum::<f64>() / halves.len() as f64).ln()
}

/// Shares of right names at each strength: hidden is one pole, and two poles; %.
pub fn told_apart(strengths: &[f64]) -> [Vec<f64>; 2] {
    [true, false].map(|one| {
        let right: Vec<Vec<usize>> = (0..SENSORS)
            .into_par_iter()
            .map(|seed| {
                let mut random = Random::new(seed, "poles");
                let clean = freq::clean_run(Sensor::drawn(Kind::Frequency, &mut random), &mut random);
                let sines = Sines::new(&clean);
                let between = |[low, high]: [f64; 2], part: f64| low + (high - low) * part;
                let place = |j: usize, of: usize| (j as f64 + 0.5) / of as f64;
                let low_high = freq::ONE_POLE_HZ.map(f64::ln);
                let single: Vec<DVector<f64>> =
                    (0..GRID[0]).map(|j| sines.signature(|f| one_pole(f, between(low_high, place(j, GRID[0])).exp()))).collect();
                let double: Vec<DVector<f64>> = (0..GRID[1] * GRID[2])
                    .map(|j| {
                        let hz = between(freq::TWO_POLES_HZ, place(j / GRID[2], GRID[1]));
                        let q = between(freq::TWO_POLES_Q, place(j % GRID[2], GRID[2]));
                        sines.signature(|f| second_order(f, hz, q))
                    })
                    .collect();
                let truth = if one {
                    let hz = random.log_between(freq::ONE_POLE_HZ[0], freq::ONE_POLE_HZ[1]);
                    sines.signature(|f| one_pole(f, hz))
                } else {
                    let hz = random.between(freq::TWO_POLES_HZ[0], freq::TWO_POLES_HZ[1]);
                    let q = random.between(freq::TWO_POLES_Q[0], freq::TWO_POLES_Q[1]);
                    sines.signature(|f| second_order(f, hz, q))
                };
                let noises: Vec<DVector<f64>> =
                    (0..DRAWS).map(|_| sines.beside_own(&DVector::from_fn(truth.len(), |_, _| random.normal()))).collect();
                let right = |k: f64, noise: &DVector<f64>| {
                    let data = &truth * k + noise;
                    (evidence(&single, &data) > evidence(&double, &data)) == one
                };
                strengths.iter().map(|k| noises.iter().filter(|noise| right(*k, noise)).count()).collect()
            })
            .collect();
        let share = |at: usize| right.iter().map(|r| r[at]).sum::<usize>() as f64 / (SENSORS as usize * DRAWS) as f64;
        (0..strengths.len()).map(|at| 100.0 * share(at)).collect()
    })
}
