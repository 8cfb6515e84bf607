//! The whitening of one component by a Kalman filter.

use nalgebra::DMatrix;
use std::ops::Range;

/// Columns that go through the filter together; of the rest half as many, then a quarter.
const LANES: usize = 8;

/// One kind of slow noise: relaxations, and what each row has of them.
pub(super) struct Part<'a> {
    /// Variance of all its relaxations.
    pub size: f64,
    /// Parts of it, one per relaxation; the sum is one.
    pub variance: &'a [f64],
    /// What is left of each relaxation from the row before, row after row.
    pub keep: &'a [f64],
    /// What it adds to a row, per unit; one where nothing is given.
    pub load: Option<&'a dyn Fn(usize) -> f64>,
}

/// The filter for some rows, beginning anew at the first.
pub(super) struct Whitener {
    states: usize,
    /// Per row: one over the standard deviation of what is new in it.
    pub scale: Vec<f64>,
    /// Per row and state: what it adds to the row, what is left of it from the row before, its gain.
    steps: Vec<[f64; 3]>,
}

impl Whitener {
    /// Of rows with a white variance each and slow noise; `None` where a variance is none.
    pub fn new(rows: Range<usize>, white: impl Fn(usize) -> f64, parts: &[Part]) -> Option<Self> {
        let variance: Vec<f64> = parts.iter().flat_map(|p| p.variance.iter().map(move |v| p.size * v)).collect();
        let states = variance.len();
        let mut whitener = Self { states, scale: Vec::with_capacity(rows.len()), steps: Vec::with_capacity(rows.len() * states) };
        let mut covariance = vec![0.0; states * states];
        for (k, v) in variance.iter().enumerate() {
            covariance[k * states + k] = *v;
        }
        let mut keep = vec![0.0; states];
        let mut load = vec![1.0; states];
        // Covariance of the states with the reading of the row before and of this one, and the gain of the row before.
        let (mut before, mut now, mut gain) = (vec![0.0; states], vec![0.0; states], vec![0.0; states]);
        for i in rows {
            let mut at = 0;
            for part in parts {
                let kinds = part.variance.len();
                keep[at..at + kinds].copy_from_slice(&part.keep[i * kinds..(i + 1) * kinds]);
                if let Some(of_row) = part.load {
                    load[at..at + kinds].fill(of_row(i));
                }
                at += kinds;
            }
            // What the row before told, what is forgotten since, and what is new: in one pass over the rows of the covariance.
            std::mem::swap(&mut before, &mut now);
            now.fill(0.0);
            for (k, row) in covariance.chunks_exact_mut(states.max(1)).enumerate() {
                let (gain, own, load) = (gain[k], keep[k], load[k]);
                let others = before.iter().zip(&keep);
                for ((value, now), (before, keep)) in row.iter_mut().zip(now.iter_mut()).zip(others) {
                    *value = (*value - gain * before) * (own * keep);
                    *now += *value * load;
                }
                let new = variance[k] * (1.0 - own * own);
                row[k] += new;
                now[k] += new * load;
            }
            let new = white(i) + load.iter().zip(&now).map(|(h, c)| h * c).sum::<f64>();
            if new.is_nan() || new <= 0.0 {
                return None;
            }
            gain.iter_mut().zip(&now).for_each(|(gain, c)| *gain = c / new);
            whitener.steps.extend(load.iter().zip(&keep).zip(&gain).map(|((load, keep), gain)| [*load, *keep, *gain]));
            whitener.scale.push(new.sqrt().recip());
        }
        Some(whitener)
    }

    /// Whitens columns in place.
    pub fn whiten(&self, columns: &mut DMatrix<f64>) {
        let n = columns.nrows();
        // Columns of nothing stay nothing.
        let used: Vec<usize> = (0..columns.ncols()).filter(|j| columns.column(*j).iter().any(|v| *v != 0.0)).collect();
        let all = columns.as_mut_slice();
        let rest = self.chunks::<LANES>(all, n, &used);
        let rest = self.chunks::<{ LANES / 2 }>(all, n, rest);
        let rest = self.chunks::<{ LANES / 4 }>(all, n, rest);
        self.chunks::<1>(all, n, rest);
    }

    /// So many columns at a time; those that are left.
    fn chunks<'c, const L: usize>(&self, all: &mut [f64], n: usize, columns: &'c [usize]) -> &'c [usize] {
        let mut chunks = columns.chunks_exact(L);
        chunks.by_ref().for_each(|chunk| self.lanes::<L>(all, n, chunk));
        chunks.remainder()
    }

    /// Columns of `n` rows, given by their numbers.
    fn lanes<const L: usize>(&self, all: &mut [f64], n: usize, columns: &[usize]) {
        let mut state = vec![[0.0; L]; self.states];
        let mut steps = self.steps.chunks_exact(self.states.max(1));
        let begins: [usize; L] = std::array::from_fn(|lane| columns[lane] * n);
        for (i, scale) in self.scale.iter().enumerate() {
            let mut new: [f64; L] = std::array::from_fn(|lane| all[begins[lane] + i]);
            if let Some(step) = steps.next() {
                for (state, [load, keep, _]) in state.iter_mut().zip(step) {
                    for (s, new) in state.iter_mut().zip(&mut new) {
                        *s *= keep;
                        *new -= load * *s;
                    }
                }
                for (state, [_, _, gain]) in state.iter_mut().zip(step) {
                    for (s, new) in state.iter_mut().zip(&new) {
                        *s += gain * new;
                    }
                }
            }
            for (begin, new) in begins.iter().zip(new) {
                all[begin + i] = new * scale;
            }
        }
    }

    /// Logarithm of the determinant of the covariance.
    pub fn log_covariance(&self) -> f64 {
        -2.0 * self.scale.iter().map(|s| s.ln()).sum::<f64>()
    }
}
