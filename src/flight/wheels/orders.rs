//! Waves along the phases of the wheels, fitted to the vectors and subtracted: what R 4.9 calls the reaction wheel signature, without a
//! spectrum.
//!
//! The model of a component is `natural field + Σ_k (a_k cos φ_k + b_k sin φ_k)`, k the multiples of the wheels' rates, and lines of
//! constant frequency. The amplitudes are linear between knots 256 vectors apart, which follows attitude and phase errors, and all
//! knots of a mode are fitted at once:
//!
//! * **Natural field.** Where an alias comes near 0 Hz the wheel looks like the field itself. Residuals are therefore weighted by the
//!   spectrum of the field: they are filtered by an autoregressive model (order 8 on first differences) found from the cleaned vectors. The
//!   differences take the place of a polynomial: a constant field has no weight. Of a filtered vector all of its predecessors must
//!   be there; missing vectors are left out, not filled.
//! * **Knowledge from before and after.** From knot to knot amplitudes wander: with the resolution of the table of rates mostly along
//!   the phase, in all components by one angle. Amplitudes are thus a random walk of two sizes, along the phase and in all other
//!   directions, both found from the data. Along the phase it is wider where the table shows the same rate for long, since the
//!   error of rounding then adds up. So a wheel that passes 0 Hz, another wheel or a line keeps the amplitude that it had,
//!   and the design is never singular.

use super::chain::{Chain, Smoother};
use super::rates::{Place, seconds};
use super::{Day, Stretch, Wave, in_parallel};
use crate::fit::statistics::{central_median, median};
use std::f64::consts::TAU;
use std::ops::Range;

/// Vectors between knots at most: on half a minute of burst mode, 12.8 s, the phase errors of a table in steps of 0.1 revolutions per
/// minute are linear to a few per mille of the amplitude.
const KNOT_STEPS: usize = 256;
/// Order of the autoregressive model of the differences.
const ORDER: usize = 8;
/// Intervals on either side whose scatter counts for the weight of one.
const NEAR_INTERVALS: usize = 8;
/// Scatter of the vectors below which a smaller one would change nothing, nT.
const LEAST_SCATTER_NT: f64 = 1e-10;
/// Filtered residuals beyond that many standard deviations do not count: steps of the field and bad vectors, not noise.
const OUTLIER: f64 = 8.0;
/// Median of the square of a standard normal number.
const MEDIAN_SQUARE: f64 = 0.454_936_423_119_572_8;
/// Variance per second with which the random walk of a wheel begins, nT²/s; the data change it.
const WHEEL_WALK: f64 = 1e-5;
/// The same for a line.
const LINE_WALK: f64 = 1e-9;
/// No walk is smaller than that, nT²/s.
const LEAST_WALK: f64 = 1e-14;
/// Share of a walk that does not ask for a direction, with which its parts along the phase and across begin.
const FIRST_PARTS: [f64; 2] = [5.0, 0.05];
/// Rows of equal rates in the table after which the walk along the phase becomes no wider.
const LONGEST_RUN: usize = 32;
/// Steps of expectation and maximisation with walks of one size, and with two.
const WALK_STEPS: [usize; 2] = [4, 2];
/// Times that all wheels and lines are fitted in turn, the others known.
const SWEEPS: usize = 2;

/// The result of [`removal`].
pub(super) struct Fitted {
    /// What is removed from every vector of the stretches, in their order.
    pub removed: Vec<[f64; 3]>,
    pub waves: Vec<Wave>,
    pub lines_nt: Vec<f64>,
}

/// The vectors between two knots.
struct Interval<'a> {
    stretch: &'a Stretch,
    /// Place of the first vector of the stretch among all of them.
    offset: usize,
    slots: Range<usize>,
    knot: usize,
}

#[derive(Default)]
struct Buffers {
    basis: Vec<f64>,
    seen: Vec<f64>,
    hat: Vec<f64>,
    filtered: Vec<f64>,
    readings: [Vec<f64>; 3],
    readings_filtered: [Vec<f64>; 3],
    complete: Vec<bool>,
    present: Vec<bool>,
    row: Vec<f64>,
}

/// Variances per second of the random walks, nT²/s.
struct Walks {
    /// One for every wave and line.
    any: Vec<f64>,
    /// Of every wave, along the phase and across.
    parts: Vec<[f64; 2]>,
}

/// Fits and evaluates all waves and lines.
pub(super) fn removal(day: &Day, stretches: &[Stretch]) -> Fitted {
    let orders: Vec<(usize, u32)> =
        (0..day.table.wheels()).flat_map(|wheel| day.options.harmonics.iter().map(move |h| (wheel, *h))).collect();
    let lines = day.mode.lines_hz.len();
    let Some(first) = stretches.first() else {
        return Fitted { removed: Vec::new(), waves: Vec::new(), lines_nt: Vec::new() };
    };
    let start = day.times[first.rows[0] as usize];
    let problem = Problem { day, orders, start };
    let (intervals, steps_s) = problem.intervals(stretches);
    let states = problem.states();
    let persistence: Vec<Vec<f64>> =
        (0..day.table.wheels()).map(|wheel| problem.persistence(wheel, &intervals, steps_s.len())).collect();

    let mut walks = Walks { any: vec![WHEEL_WALK; problem.orders.len()], parts: Vec::new() };
    walks.any.resize(problem.orders.len() + lines, LINE_WALK);
    let mut smoother = Smoother::default();
    let mut removed = vec![[0.0; 3]; stretches.iter().map(|s| s.rows.len()).sum()];
    // First against the differences alone, then with the spectrum of what the first pass left.
    for pass in 0..2 {
        let filter = if pass == 0 { vec![1.0] } else { problem.filter(&intervals, &removed) };
        let chain = problem.equations(&intervals, &steps_s, &filter, &removed);
        for step in 0..=WALK_STEPS[0] {
            walk_in_any_direction(&chain, &mut smoother, &mut walks.any, step < WALK_STEPS[0]);
        }
        if pass == 1 {
            walks.parts = walks.any[..problem.orders.len()].iter().map(|any| FIRST_PARTS.map(|part| part * any)).collect();
            for _ in 0..SWEEPS {
                for (wave, (wheel, _)) in problem.orders.iter().enumerate() {
                    walk_along_phase(&chain, &mut smoother.values, wave, &persistence[*wheel], &mut walks.parts[wave]);
                }
                let of_lines = 2 * problem.orders.len()..states;
                if of_lines.is_empty() {
                    continue;
                }
                let mut part = Smoother::default();
                let rest = conditional(&chain, &smoother.values, of_lines.clone());
                walk_in_any_direction(&rest, &mut part, &mut walks.any[problem.orders.len()..], false);
                put(&mut smoother.values, &part.values, of_lines, states);
            }
        }
        let parts = in_parallel(&intervals, |buffers: &mut Buffers, interval| problem.wave(interval, &smoother.values, buffers));
        for (interval, part) in intervals.iter().zip(parts) {
            let begin = interval.offset + interval.stretch.entries(interval.slots.clone()).start;
            removed[begin..begin + part.len()].copy_from_slice(&part);
        }
    }

    let amplitude = |pair: usize| {
        let of = |knot: &[f64]| knot[6 * pair..6 * pair + 6].iter().map(|v| v * v).sum::<f64>().sqrt();
        central_median(&mut smoother.values.chunks_exact(3 * states).map(of).collect::<Vec<_>>())
    };
    let waves = problem.orders.iter().enumerate().map(|(wave, &(wheel, harmonic))| Wave {
        wheel,
        harmonic,
        amplitude_nt: amplitude(wave),
        wander_nt_per_root_s: walks.parts[wave].map(f64::sqrt),
    });
    Fitted { removed, waves: waves.collect(), lines_nt: (0..lines).map(|line| amplitude(problem.orders.len() + line)).collect() }
}

struct Problem<'a> {
    day: &'a Day<'a>,
    /// Wheel and multiple of every wave.
    orders: Vec<(usize, u32)>,
    /// Where the phases of lines begin.
    start: i64,
}

impl Problem<'_> {
    /// Unknowns of a knot: cosine and sine of every wave and line.
    fn states(&self) -> usize {
        2 * (self.orders.len() + self.day.mode.lines_hz.len())
    }

    /// Equal intervals of every stretch, and the steps between the knots at their ends.
    fn intervals<'b>(&self, stretches: &'b [Stretch]) -> (Vec<Interval<'b>>, Vec<f64>) {
        let (mut intervals, mut steps_s) = (Vec::new(), Vec::new());
        let step_s = 1.0 / self.day.mode.rate_hz;
        let (mut offset, mut knot) = (0, 0);
        for (index, stretch) in stretches.iter().enumerate() {
            if let Some(before) = index.checked_sub(1).map(|i| &stretches[i]) {
                let time = |row: Option<&u32>| row.map_or(0, |row| self.day.times[*row as usize]);
                let pause_s = seconds(time(stretch.rows.first()) - time(before.rows.last())).max(step_s);
                steps_s.push(if before.table_gaps == stretch.table_gaps { pause_s } else { f64::INFINITY });
                knot += 1;
            }
            let length = stretch.length();
            let count = length.div_ceil(KNOT_STEPS);
            for i in 0..count {
                let slots = i * length / count..(i + 1) * length / count;
                steps_s.push(slots.len() as f64 * step_s);
                intervals.push(Interval { stretch, offset, slots, knot });
                knot += 1;
            }
            offset += stretch.rows.len();
        }
        (intervals, steps_s)
    }

    /// Rows for which the error of a rate stays the same, for every step between knots.
    fn persistence(&self, wheel: usize, intervals: &[Interval], steps: usize) -> Vec<f64> {
        let mut rows = vec![1.0; steps];
        let mut near = 0;
        for interval in intervals {
            let middle = interval.stretch.entries(0..interval.slots.start.midpoint(interval.slots.end)).end;
            let row = interval.stretch.rows[middle.min(interval.stretch.rows.len() - 1)];
            if let Some((place, _)) = self.day.table.place(self.day.times[row as usize], near) {
                near = place.row();
                rows[interval.knot] = self.day.table.equal_rows(wheel, place).min(LONGEST_RUN) as f64;
            }
        }
        rows
    }

    /// Cosines and sines of all waves and lines at a time in the table.
    fn basis(&self, time: i64, near: &mut usize, row: &mut Vec<f64>) {
        row.clear();
        let place: Option<Place> = self.day.table.place(time, *near).map(|found| found.0);
        if let Some(place) = place {
            *near = place.row();
            for &(wheel, harmonic) in &self.orders {
                let turns = (self.day.table.turns(wheel, place) * f64::from(harmonic)).fract();
                let (sine, cosine) = (TAU * turns).sin_cos();
                row.extend([cosine, sine]);
            }
        }
        let since_s = seconds(time - self.start);
        for line in &self.day.mode.lines_hz {
            let (sine, cosine) = (TAU * (line * since_s).fract()).sin_cos();
            row.extend([cosine, sine]);
        }
    }

    /// Readings of an interval and of `lead` slots before it, less `removed`; marks what is there. Constants are taken away.
    fn read(&self, interval: &Interval, lead: usize, removed: Option<&[[f64; 3]]>, buffers: &mut Buffers) -> Range<usize> {
        let slots = interval.slots.start.saturating_sub(lead)..interval.slots.end;
        let entries = interval.stretch.entries(slots.clone());
        buffers.present.clear();
        buffers.present.resize(slots.len(), false);
        for i in entries.clone() {
            buffers.present[interval.stretch.slots[i] as usize - slots.start] = true;
        }
        for (c, readings) in buffers.readings.iter_mut().enumerate() {
            readings.clear();
            readings.resize(slots.len(), 0.0);
            let value = |i: usize| {
                let reading = self.day.field[c][interval.stretch.rows[i] as usize];
                removed.map_or(reading, |removed| reading - removed[interval.offset + i][c])
            };
            let first = entries.clone().next().map_or(0.0, value);
            for i in entries.clone() {
                readings[interval.stretch.slots[i] as usize - slots.start] = value(i) - first;
            }
        }
        slots
    }

    /// Autoregressive filter of what is left of the vectors: predecessors times these are the best forecast.
    fn filter(&self, intervals: &[Interval], removed: &[[f64; 3]]) -> Vec<f64> {
        let products = in_parallel(intervals, |buffers: &mut Buffers, interval| {
            let slots = self.read(interval, ORDER + 1, Some(removed), buffers);
            let own = interval.slots.start - slots.start;
            let mut sums = [0.0; ORDER + 1];
            for readings in &buffers.readings {
                buffers.hat.clear();
                buffers.hat.push(0.0);
                buffers.hat.extend((1..readings.len()).map(|i| {
                    let both = buffers.present[i] && buffers.present[i - 1];
                    if both { readings[i] - readings[i - 1] } else { 0.0 }
                }));
                for (lag, sum) in sums.iter_mut().enumerate() {
                    let from = own.max(lag);
                    *sum += dot(&buffers.hat[from..], &buffers.hat[from - lag..buffers.hat.len() - lag]);
                }
            }
            sums
        });
        // Quiet and disturbed times count alike.
        let mut mean = [0.0; ORDER + 1];
        for sums in products.iter().filter(|sums| sums[0] > 0.0) {
            for (mean, sum) in mean.iter_mut().zip(sums) {
                *mean += sum / sums[0];
            }
        }
        let forecast = levinson(&mean);
        // The forecast of the differences as one of the values: (1 - B)(1 - Σ a B^k) = 1 - Σ f B^k.
        let a = |k: usize| if k == 0 { -1.0 } else { forecast.get(k - 1).copied().unwrap_or(0.0) };
        (1..=ORDER + 1).map(|k| a(k) - a(k - 1)).collect()
    }

    /// Variance of the filtered readings of every interval, from those near it.
    fn scatter(&self, intervals: &[Interval], filter: &[f64], removed: &[[f64; 3]]) -> Vec<f64> {
        let of_one = in_parallel(intervals, |buffers: &mut Buffers, interval| {
            self.read(interval, filter.len(), Some(removed), buffers);
            find_complete(&buffers.present, filter.len(), &mut buffers.complete);
            let mut squares = Vec::new();
            for readings in &buffers.readings {
                apply(filter, readings, &buffers.complete, &mut buffers.hat);
                let complete = buffers.hat.iter().zip(&buffers.complete[filter.len()..]).filter(|(_, complete)| **complete);
                squares.extend(complete.map(|(value, _)| value * value));
            }
            median(&mut squares)
        });
        let near = |i: usize| i.saturating_sub(NEAR_INTERVALS)..(i + NEAR_INTERVALS + 1).min(of_one.len());
        let of_near = |i: usize| of_one[near(i)].iter().copied().filter(|v| v.is_finite()).collect::<Vec<f64>>();
        let variance = |i: usize| central_median(&mut of_near(i)) / MEDIAN_SQUARE;
        (0..of_one.len()).map(|i| variance(i).max(LEAST_SCATTER_NT * LEAST_SCATTER_NT)).collect()
    }

    /// Normal equations of all knots, components as right-hand sides.
    fn equations(&self, intervals: &[Interval], steps_s: &[f64], filter: &[f64], removed: &[[f64; 3]]) -> Chain {
        let scatter = self.scatter(intervals, filter, removed);
        let mut chain = Chain::new(self.states(), 3, steps_s.to_vec());
        // By portions, so that not all blocks are in memory twice.
        for (portion, scatter) in intervals.chunks(1024).zip(scatter.chunks(1024)) {
            let work: Vec<(&Interval, f64)> = portion.iter().zip(scatter.iter().copied()).collect();
            let blocks = in_parallel(&work, |buffers: &mut Buffers, (interval, variance)| {
                self.find_usable(interval, filter, removed, *variance, buffers);
                self.block(interval, filter, buffers)
            });
            for ((interval, variance), (lower, right)) in work.into_iter().zip(blocks) {
                chain.add(interval.knot, &lower, &right, 1.0 / variance);
            }
        }
        chain
    }

    /// Marks the readings of an interval that are complete and no outliers.
    fn find_usable(&self, interval: &Interval, filter: &[f64], removed: &[[f64; 3]], variance: f64, buffers: &mut Buffers) {
        self.read(interval, filter.len(), Some(removed), buffers);
        find_complete(&buffers.present, filter.len(), &mut buffers.complete);
        let limit = OUTLIER * variance.sqrt();
        for readings in &buffers.readings {
            apply(filter, readings, &buffers.complete, &mut buffers.hat);
            for (complete, value) in buffers.complete[filter.len().min(readings.len())..].iter_mut().zip(&buffers.hat) {
                *complete &= value.abs() <= limit;
            }
        }
    }

    /// What the usable readings of an interval say about the knots at its ends: the lower triangle of a matrix and its right-hand sides.
    fn block(&self, interval: &Interval, filter: &[f64], buffers: &mut Buffers) -> (Vec<f64>, Vec<f64>) {
        let states = self.states();
        let slots = self.read(interval, filter.len(), None, buffers);
        let length = slots.len();
        buffers.basis.clear();
        buffers.basis.resize(states * length, 0.0);
        let mut near = 0;
        let mut row = std::mem::take(&mut buffers.row);
        for i in interval.stretch.entries(slots.clone()) {
            self.basis(self.day.times[interval.stretch.rows[i] as usize], &mut near, &mut row);
            let at = interval.stretch.slots[i] as usize - slots.start;
            for (k, value) in row.iter().enumerate() {
                buffers.basis[k * length + at] = *value;
            }
        }
        buffers.row = row;
        // Vectors before the interval, which the filter reaches back to, see its straight line extended.
        let [begin, steps] = [interval.slots.start as f64 - slots.start as f64, interval.slots.len() as f64];
        let rows = length.saturating_sub(filter.len());
        buffers.filtered.clear();
        for end in 0..2 {
            for k in 0..states {
                let wave = &buffers.basis[k * length..(k + 1) * length];
                let share = |i: usize| if end == 0 { 1.0 - (i as f64 - begin) / steps } else { (i as f64 - begin) / steps };
                buffers.seen.clear();
                buffers.seen.extend(wave.iter().enumerate().map(|(i, b)| share(i) * b));
                apply(filter, &buffers.seen, &buffers.complete, &mut buffers.hat);
                buffers.filtered.extend_from_slice(&buffers.hat);
            }
        }
        for (readings, out) in buffers.readings.iter().zip(&mut buffers.readings_filtered) {
            apply(filter, readings, &buffers.complete, out);
        }
        let column = |k: usize| &buffers.filtered[k * rows..(k + 1) * rows];
        let mut lower = vec![0.0; 4 * states * states];
        let mut right = vec![0.0; 6 * states];
        for i in 0..2 * states {
            for j in 0..=i {
                lower[i * 2 * states + j] = dot(column(i), column(j));
            }
            for (c, readings) in buffers.readings_filtered.iter().enumerate() {
                right[3 * i + c] = dot(column(i), readings);
            }
        }
        (lower, right)
    }

    /// Waves and lines at the vectors of an interval.
    fn wave(&self, interval: &Interval, values: &[f64], buffers: &mut Buffers) -> Vec<[f64; 3]> {
        let size = 3 * self.states();
        let ends = [0, 1].map(|end| &values[(interval.knot + end) * size..(interval.knot + end + 1) * size]);
        let mut near = 0;
        let entries = interval.stretch.entries(interval.slots.clone());
        entries
            .map(|i| {
                self.basis(self.day.times[interval.stretch.rows[i] as usize], &mut near, &mut buffers.row);
                let u = (interval.stretch.slots[i] as usize - interval.slots.start) as f64 / interval.slots.len() as f64;
                let mut sum = [0.0; 3];
                for (k, b) in buffers.row.iter().enumerate() {
                    for c in 0..3 {
                        sum[c] += b * ((1.0 - u) * ends[0][3 * k + c] + u * ends[1][3 * k + c]);
                    }
                }
                sum
            })
            .collect()
    }
}

/// Solves a chain of pairs of states whose walks have one size in all directions, and finds those sizes anew where asked to.
fn walk_in_any_direction(chain: &Chain, smoother: &mut Smoother, walks: &mut [f64], learn: bool) {
    let (m, sides) = (chain.states, chain.sides);
    let given = walks.to_vec();
    let mut sums = vec![0.0; walks.len()];
    let mut count = 0;
    let expected = |_: usize, weight: &mut [f64]| (0..m).for_each(|i| weight[i * m + i] = 1.0 / given[i / 2]);
    smoother.solve(chain, expected, |knot, increment, covariance| {
        count += 1;
        for i in 0..m {
            let square = increment[i * sides..(i + 1) * sides].iter().map(|d| d * d).sum::<f64>() / sides as f64;
            sums[i / 2] += 0.5 * (square + covariance[i * m + i]) / chain.steps_s[knot];
        }
    });
    if learn && count > 0 {
        for (walk, sum) in walks.iter_mut().zip(sums) {
            *walk = (sum / f64::from(count)).max(LEAST_WALK);
        }
    }
}

/// Fits one wave again with the others as they are: its walk has one size along the phase, which is common to the components, times
/// the `persistence` of the step, and one across.
fn walk_along_phase(chain: &Chain, values: &mut [f64], wave: usize, persistence: &[f64], parts: &mut [f64; 2]) {
    let states = chain.states;
    let pair = 2 * wave..2 * wave + 2;
    let rest = conditional(chain, values, pair.clone());
    // The six numbers of a knot in one state: cosine x, y, z, sine x, y, z.
    let mut joint = Chain::new(6, 1, chain.steps_s.clone());
    for (from, to) in [(&rest.own, &mut joint.own), (&rest.next, &mut joint.next)] {
        for (from, to) in from.chunks_exact(4).zip(to.chunks_exact_mut(36)) {
            for (i, j, c) in (0..12).map(|n| (n / 6, n / 3 % 2, n % 3)) {
                to[(3 * i + c) * 6 + 3 * j + c] = from[2 * i + j];
            }
        }
    }
    joint.right.copy_from_slice(&rest.right);
    // A turn of the phase by δ adds δ (b cos φ - a sin φ) to a cos φ + b sin φ.
    let directions: Vec<[f64; 6]> = (0..chain.steps_s.len())
        .map(|knot| {
            let value = |i: usize| values[knot * 3 * states + 6 * wave + i] + values[(knot + 1) * 3 * states + 6 * wave + i];
            let turned: [f64; 6] = std::array::from_fn(|i| if i < 3 { value(i + 3) } else { -value(i - 3) });
            let norm = turned.iter().map(|v| v * v).sum::<f64>().sqrt();
            turned.map(|v| if norm > 0.0 { v / norm } else { 0.0 })
        })
        .collect();
    let mut smoother = Smoother::default();
    for step in 0..=WALK_STEPS[1] {
        let [along, across] = *parts;
        let expected = |knot: usize, weight: &mut [f64]| {
            let (d, along) = (&directions[knot], along * persistence[knot]);
            for (i, j) in (0..36).map(|n| (n / 6, n % 6)) {
                weight[i * 6 + j] = (1.0 / along - 1.0 / across) * d[i] * d[j] + if i == j { 1.0 / across } else { 0.0 };
            }
        };
        let mut sums = [0.0; 2];
        let mut count = 0;
        smoother.solve(&joint, expected, |knot, increment, covariance| {
            let d = &directions[knot];
            let moment = |i: usize, j: usize| increment[i] * increment[j] + covariance[i * 6 + j];
            let turned: f64 = (0..36).map(|n| d[n / 6] * d[n % 6] * moment(n / 6, n % 6)).sum();
            let all: f64 = (0..6).map(|i| moment(i, i)).sum();
            sums[0] += turned / persistence[knot] / chain.steps_s[knot];
            sums[1] += (all - turned) / 5.0 / chain.steps_s[knot];
            count += 1;
        });
        if step < WALK_STEPS[1] && count > 0 {
            *parts = sums.map(|sum| (sum / f64::from(count)).max(LEAST_WALK));
        }
    }
    put(values, &smoother.values, pair, states);
}

/// The chain of some of the states, the values of the others given.
fn conditional(chain: &Chain, values: &[f64], states: Range<usize>) -> Chain {
    let (m, n, sides) = (chain.states, states.len(), chain.sides);
    let mut part = Chain::new(n, sides, chain.steps_s.clone());
    for knot in 0..chain.knots() {
        let own = &chain.own[knot * m * m..(knot + 1) * m * m];
        let before = knot.checked_sub(1).map(|k| &chain.next[k * m * m..(k + 1) * m * m]);
        let next = chain.next.get(knot * m * m..(knot + 1) * m * m);
        for (i, state) in states.clone().enumerate() {
            for (j, other) in states.clone().enumerate() {
                part.own[(knot * n + i) * n + j] = own[state * m + other];
                if let Some(next) = next {
                    part.next[(knot * n + i) * n + j] = next[state * m + other];
                }
            }
            for c in 0..sides {
                let mut sum = chain.right[(knot * m + state) * sides + c];
                for other in (0..m).filter(|other| !states.contains(other)) {
                    let value = |knot: usize| values[(knot * m + other) * sides + c];
                    sum -= own[state * m + other] * value(knot);
                    sum -= next.map_or(0.0, |next| next[state * m + other] * value(knot + 1));
                    sum -= before.map_or(0.0, |before| before[other * m + state] * value(knot - 1));
                }
                part.right[(knot * n + i) * sides + c] = sum;
            }
        }
    }
    part
}

/// Puts the values of some states among those of all, three components each.
fn put(values: &mut [f64], part: &[f64], states: Range<usize>, all: usize) {
    for (knot, part) in values.chunks_exact_mut(3 * all).zip(part.chunks_exact(3 * states.len())) {
        knot[3 * states.start..3 * states.end].copy_from_slice(part);
    }
}

/// Marks the readings whose predecessors, as many as the filter takes, are all there.
fn find_complete(present: &[bool], taps: usize, complete: &mut Vec<bool>) {
    complete.clear();
    let mut run = 0;
    complete.extend(present.iter().map(|here| {
        run = if *here { run + 1 } else { 0 };
        run > taps
    }));
}

/// Readings less their forecasts, from the first that has all predecessors within `readings`; 0 where one of them is missing.
fn apply(filter: &[f64], readings: &[f64], complete: &[bool], out: &mut Vec<f64>) {
    let taps = filter.len();
    out.clear();
    out.extend(readings.iter().skip(taps));
    for (k, weight) in filter.iter().enumerate() {
        for (value, before) in out.iter_mut().zip(&readings[taps - 1 - k..]) {
            *value -= weight * before;
        }
    }
    for (value, complete) in out.iter_mut().zip(complete.iter().skip(taps)) {
        if !complete {
            *value = 0.0;
        }
    }
}

/// Weights of the best linear forecast from the products of a series with itself at lags from 0 on (Levinson 1946, Durbin 1960); none
/// where the series is zero.
fn levinson(products: &[f64]) -> Vec<f64> {
    let mut weights = vec![0.0; products.len() - 1];
    let mut error = products[0] * (1.0 + 1e-6);
    for k in 0..weights.len() {
        if error <= 0.0 {
            break;
        }
        let forecast: f64 = (0..k).map(|i| weights[i] * products[k - i]).sum();
        let reflection = (products[k + 1] - forecast) / error;
        let before = weights.clone();
        for i in 0..k {
            weights[i] -= reflection * before[k - 1 - i];
        }
        weights[k] = reflection;
        error *= 1.0 - reflection * reflection;
    }
    weights
}

/// Scalar product in lanes side by side, which takes a fraction of the time of one after the other.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    const LANES: usize = 8;
    let mut lanes = [0.0; LANES];
    let whole = a.len().min(b.len()) / LANES * LANES;
    for (x, y) in a[..whole].chunks_exact(LANES).zip(b[..whole].chunks_exact(LANES)) {
        for (lane, (x, y)) in lanes.iter_mut().zip(x.iter().zip(y)) {
            *lane += x * y;
        }
    }
    lanes.iter().sum::<f64>() + a[whole..].iter().zip(&b[whole..]).map(|(x, y)| x * y).sum::<f64>()
}
