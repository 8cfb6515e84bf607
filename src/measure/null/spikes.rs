//! Samples of a long record that stand out of those beside them, and components that stand still, told while the record is read.

use crate::data::run::Vector;
use crate::data::units::Reading;
use crate::fit::statistics::median;

/// Samples from which the usual difference of neighbours is told.
const FIRST: usize = 32;
/// Of noise, neighbours differ by this many of their mean differences once in 1e40 samples: thirteen standard deviations of a sample.
const OUTSTANDING: f64 = 12.0;
/// More samples in a row at another level are no spike.
const WIDEST: usize = 3;
/// Samples over which the mean difference is taken.
const MEMORY: f64 = 256.0;
/// Mean over median of the modulus of a normal deviate.
const MEAN_OVER_MEDIAN: f64 = 1.183;
/// Probability of noise below which equal readings stand still.
const LEAST_PROBABILITY: f64 = 1e-12;

/// What was left out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spikes {
    /// Samples.
    pub count: u64,
    /// Time of the first, s since the run's start.
    pub t_s: f64,
    /// Its reading, enT.
    pub reading_ent: [f64; 3],
}

/// Lets samples pass that do not stand out of those beside them.
#[derive(Clone, Debug, Default)]
pub(super) struct Gate {
    first: Vec<Vector>,
    is_open: bool,
    last: [f64; 3],
    /// Usual modulus of the difference of neighbours, and the smallest there is.
    usual: [f64; 3],
    smallest: [f64; 3],
    held: Vec<Vector>,
    spikes: Option<Spikes>,
}

impl Gate {
    #[inline(always)]
    pub fn vector(&mut self, vector: Vector, pass: &mut impl FnMut(Vector)) {
        if self.is_open { self.judge(vector, pass) } else { self.wait(vector, pass) }
    }

    #[cold]
    fn wait(&mut self, vector: Vector, pass: &mut impl FnMut(Vector)) {
        self.first.push(vector);
        if self.first.len() == FIRST {
            self.open(pass);
        }
    }

    /// Deals with the first samples, by their medians.
    #[cold]
    fn open(&mut self, pass: &mut impl FnMut(Vector)) {
        self.is_open = true;
        let first = std::mem::take(&mut self.first);
        for c in 0..3 {
            let of = |v: &Vector| v.reading.0[c];
            let steps: Vec<f64> = first.windows(2).map(|w| (of(&w[1]) - of(&w[0])).abs()).collect();
            self.smallest[c] = steps.iter().copied().filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min);
            self.usual[c] = MEAN_OVER_MEDIAN * median(&mut steps.clone());
            self.last[c] = median(&mut first.iter().map(of).collect::<Vec<f64>>());
        }
        first.into_iter().for_each(|v| self.judge(v, pass));
    }

    #[inline(always)]
    fn judge(&mut self, vector: Vector, pass: &mut impl FnMut(Vector)) {
        let Reading(r) = vector.reading;
        let mut stands_out = false;
        for c in 0..3 {
            let step = (r[c] - self.last[c]).abs();
            let least = if self.smallest[c] < self.usual[c] { self.usual[c] } else { self.smallest[c] };
            // Where readings never differed there is nothing to compare with.
            stands_out |= step > OUTSTANDING * least;
        }
        if stands_out { self.hold(vector, pass) } else { self.accept(vector, pass) }
    }

    #[inline(always)]
    fn accept(&mut self, vector: Vector, pass: &mut impl FnMut(Vector)) {
        if !self.held.is_empty() {
            self.leave_out();
        }
        self.follow(vector);
        pass(vector);
    }

    #[inline(always)]
    fn follow(&mut self, vector: Vector) {
        let Reading(r) = vector.reading;
        for c in 0..3 {
            let step = (r[c] - self.last[c]).abs();
            if step > 0.0 && step < self.smallest[c] {
                self.smallest[c] = step;
            }
            // Readings that stand still tell nothing of the noise: behind them every sample would stand out.
            if step > 0.0 {
                let most = 4.0 * if self.usual[c] > 0.0 { self.usual[c] } else { step };
                self.usual[c] += (step.min(most) - self.usual[c]) / MEMORY;
            }
        }
        self.last = r;
    }

    #[cold]
    fn hold(&mut self, vector: Vector, pass: &mut impl FnMut(Vector)) {
        self.held.push(vector);
        if self.held.len() > WIDEST {
            // Another level, and no spike.
            for vector in std::mem::take(&mut self.held) {
                self.follow(vector);
                pass(vector);
            }
        }
    }

    #[cold]
    fn leave_out(&mut self) {
        for Vector { t_s, reading: Reading(reading_ent), .. } in std::mem::take(&mut self.held) {
            self.spikes.get_or_insert(Spikes { count: 0, t_s, reading_ent }).count += 1;
        }
    }

    /// Lets the last samples pass; what was left out.
    pub fn finish(mut self, pass: &mut impl FnMut(Vector)) -> Option<Spikes> {
        if !self.is_open && self.first.len() > 2 {
            self.open(pass);
        }
        self.leave_out();
        self.spikes
    }
}

/// Equal readings of one component one after the other.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Stills {
    last: f64,
    since_s: f64,
    now_s: f64,
    length: u64,
    best: u64,
    best_s: [f64; 2],
    equal: u64,
    count: u64,
}

impl Stills {
    #[inline(always)]
    pub fn add(&mut self, t_s: f64, value: f64) {
        self.count += 1;
        if value == self.last && self.count > 1 {
            self.length += 1;
            self.equal += 1;
        } else {
            self.end();
            (self.since_s, self.length, self.last) = (t_s, 0, value);
        }
        self.now_s = t_s;
    }

    #[inline(always)]
    fn end(&mut self) {
        if self.length > self.best {
            (self.best, self.best_s) = (self.length, [self.since_s, self.now_s]);
        }
    }

    /// Begin and end of the longest stretch, if the other readings are equal too seldom for it to be noise; none if there are no others.
    pub fn longest(mut self) -> Option<[f64; 2]> {
        self.end();
        let others = self.count.saturating_sub(self.best + 1);
        if others < FIRST as u64 || self.best < FIRST as u64 {
            return None;
        }
        let share = (self.equal - self.best) as f64 / others as f64;
        // With one more equal pair than there was, so that none at all is no certainty.
        let chance = (share + 1.0 / others as f64).min(1.0).powf(self.best as f64) * self.count as f64;
        (chance < LEAST_PROBABILITY).then_some(self.best_s)
    }
}
