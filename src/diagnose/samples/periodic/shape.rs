//! Period, duty and delay of a switched signal by all samples, with all of its harmonics: edges are told by the high ones.

use super::waves::Waves;
use crate::diagnose::samples::{Inside, remove_raw};
use crate::model::effects::in_samples::Comb;
use crate::model::effects::{EffectRef, Record};
use crate::record::prepared::Samples;
use rayon::prelude::*;

/// Phases at which the signal is known, over one period.
const PHASES: usize = 1 << 15;
/// First steps of an edge, as parts of the period, and of the period, in turns over the record; both are halved where they bring no more, as often as this,
/// down to the distance of the phases.
const EDGE: f64 = 0.02;
const TURNS: f64 = 0.1;
const HALVED: usize = 10;
/// Passes over all steps at most.
const MOST_PASSES: usize = 30;
/// What changes chi square by less than this is the same.
const SAME: f64 = 0.1;
/// Shortest part of a period that is on or off.
const LEAST_PART: f64 = 0.02;

/// A switched signal by its period, and by the parts of it that are on and that have passed at the middle of the record when it goes on.
#[derive(Clone, Copy)]
struct Shape {
    period_s: f64,
    duty: f64,
    begin: f64,
}

impl Shape {
    /// With period, duty and delay, s.
    fn from([period_s, duty, delay_s]: [f64; 3], middle_s: f64) -> Self {
        Self { period_s, duty, begin: ((delay_s - middle_s) / period_s).rem_euclid(1.0) }
    }

    fn delay_s(self, middle_s: f64) -> f64 {
        (middle_s + self.begin * self.period_s).rem_euclid(self.period_s)
    }

    /// Beside it: one edge or both moved by a step, or the period.
    fn beside(self, step: f64, turns: f64) -> impl Iterator<Item = Shape> {
        [-1.0, 1.0].into_iter().flat_map(move |sign| {
            let (step, turns) = (sign * step, sign * turns);
            let moved = |begin: f64, duty: f64| Shape { begin: self.begin + begin, duty: self.duty + duty, ..self };
            [moved(step, 0.0), moved(step, -step), moved(0.0, step), Shape { period_s: self.period_s * (1.0 + turns), ..self }]
        })
    }
}

/// Period, duty and delay, s, with which the signal explains most of the residuals.
pub fn sharpened(waves: &Waves, record: &Record, effect: EffectRef, form: &Comb, shape: [f64; 3]) -> [f64; 3] {
    let t_s = &waves.grid.samples.t_s;
    let (begin_s, end_s) = (t_s[0], t_s[t_s.len() - 1]);
    let middle_s = 0.5 * (begin_s + end_s);
    let mut best = Shape::from(shape, middle_s);
    let variance = waves.noise.variance(waves.grid);
    let (mut table, mut duty) = (over_a_period(record, effect, form, best.duty), best.duty);
    let mut gain_of = |shape: Shape| {
        if !(LEAST_PART..=1.0 - LEAST_PART).contains(&shape.duty) {
            return f64::NEG_INFINITY;
        }
        if shape.duty != duty {
            (table, duty) = (over_a_period(record, effect, form, shape.duty), shape.duty);
        }
        gain(waves, variance, &table, shape.period_s, middle_s + shape.begin * shape.period_s)
    };
    let mut most = gain_of(best);
    // A period that is longer by this part has one turn less over the record.
    let turn = best.period_s / (end_s - begin_s).max(best.period_s);
    let (mut step, mut turns) = (EDGE, TURNS * turn);
    let mut halved = 0;
    for _ in 0..MOST_PASSES {
        let (before, mut least) = (most, most);
        for shape in best.beside(step, turns).collect::<Vec<Shape>>() {
            let gain = gain_of(shape);
            least = least.min(gain);
            if gain > most {
                (best, most) = (shape, gain);
            }
        }
        if most - least < SAME || (most - before < SAME && halved == HALVED) {
            break;
        }
        if most - before < SAME {
            (step, turns, halved) = (0.5 * step, 0.5 * turns, halved + 1);
        }
    }
    [best.period_s, best.duty, best.delay_s(middle_s)]
}

/// The signal of unit size at equal phases over one period.
fn over_a_period(record: &Record, effect: EffectRef, form: &Comb, duty: f64) -> Vec<f64> {
    let t_s = (0..PHASES).map(|k| (k as f64 + 0.5) / PHASES as f64).collect();
    let samples = Samples { t_s, ..Samples::default() };
    let unit = Inside { values: vec![(-1.0, 0.0)], ..Inside::new(effect, (form.term)(&[0], 1.0, duty, 0.0)) };
    let mut signal: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; PHASES]);
    remove_raw(&mut signal, record, &samples, &[[0, PHASES]], &unit);
    let [signal, ..] = signal;
    signal
}

/// What a signal that begins at a time explains of the residuals: squares over this variance of a sample, the means of the plateaus taken off it as well.
fn gain(waves: &Waves, variance: [f64; 3], table: &[f64], period_s: f64, begin_s: f64) -> f64 {
    let (t_s, per_s) = (&waves.grid.samples.t_s, period_s.recip());
    let of_plateau = |(k, [from, to]): (usize, &[usize; 2])| {
        let (mut sum, mut square, mut along) = (0.0, 0.0, [0.0; 3]);
        for i in *from..*to {
            let turns = (t_s[i] - begin_s) * per_s;
            let value = table[((turns - turns.floor()) * PHASES as f64) as usize % PHASES];
            sum += value;
            square += value * value;
            along.iter_mut().zip(waves.residual).for_each(|(along, residual)| *along += value * residual[i]);
        }
        let square = square - sum * sum / (to - from).max(1) as f64;
        [0, 1, 2].map(|a: usize| {
            let weight = waves.noise.weights[a][k];
            [weight * along[a], weight * square]
        })
    };
    let add = |a: [[f64; 2]; 3], b: [[f64; 2]; 3]| [0, 1, 2].map(|k: usize| [a[k][0] + b[k][0], a[k][1] + b[k][1]]);
    // In the order of the plateaus, whatever the threads.
    let all: Vec<[[f64; 2]; 3]> = waves.grid.windows.par_iter().enumerate().map(of_plateau).collect();
    let sums = all.into_iter().fold([[0.0; 2]; 3], add);
    (0..3).map(|a| sums[a][0].powi(2) / sums[a][1].max(f64::MIN_POSITIVE) / variance[a].max(f64::MIN_POSITIVE)).sum()
}
