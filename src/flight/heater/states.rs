//! The most probable course of the states of one or two heaters (Viterbi), given what the background does.
//!
//! A heater is off or on, knows how long it has been so, and, while an edge still shows in the innovations, at which part of a
//! cell it switched. Each step has two halves, one per heater, so that the number of transitions is the sum and not the product
//! of theirs.

use nalgebra::Vector3;

use super::background::Background;
use super::cells::Profile;
use super::edges::{Edge, shares};

/// Parts of a cell in which an edge can lie.
const PHASES: usize = 4;
/// The longest time in a state that is counted, in cells.
const LONGEST_CELLS: usize = 48;
/// Share of the times in a state that follow no rule.
const IRREGULAR: f64 = 0.03;

/// How long a heater stays off and on: logarithms of the probabilities to stay and to switch, against the cells since the last
/// edge.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Dwell {
    /// Of off and on.
    stay: [Vec<f64>; 2],
    switch: [Vec<f64>; 2],
}

impl Dwell {
    /// The same chance to switch at every time.
    pub fn constant(hazard: f64) -> Self {
        let table = |value: f64| [vec![value], vec![value]];
        Dwell { stay: table((-hazard).ln_1p()), switch: table(hazard.ln()) }
    }

    /// From mean and standard deviation of the times off and on, in cells. Times beyond what is counted leave a constant chance.
    pub fn of([off, on]: [[f64; 2]; 2]) -> Self {
        let tables = [off, on].map(|[mean, std]| {
            let cells = (mean + 4.0 * std).ceil() as usize + 2;
            if !(mean.is_finite() && cells <= LONGEST_CELLS) {
                let hazard = if mean.is_finite() { 1.0 / mean.max(4.0) } else { 0.05 };
                return (vec![(-hazard).ln_1p()], vec![hazard.ln()]);
            }
            let normal = |cell: usize| (-0.5 * ((cell as f64 - mean) / std).powi(2)).exp();
            let sum: f64 = (1..=4 * LONGEST_CELLS).map(normal).sum();
            let rate = 1.0 / mean;
            let share = |cell: usize| (1.0 - IRREGULAR) * normal(cell) / sum + IRREGULAR * rate * (-rate * cell as f64).exp();
            let mut left: f64 = (1..=40 * LONGEST_CELLS).map(share).sum();
            let hazards: Vec<f64> = (1..=cells)
                .map(|cell| {
                    let hazard = (share(cell) / left).clamp(1e-9, 0.9);
                    left -= share(cell);
                    hazard
                })
                .collect();
            (hazards.iter().map(|hazard| (-hazard).ln_1p()).collect(), hazards.iter().map(|hazard| hazard.ln()).collect())
        });
        let [off, on] = tables;
        Dwell { stay: [off.0, on.0], switch: [off.1, on.1] }
    }

    fn cells(&self) -> usize {
        self.stay[0].len().max(self.stay[1].len())
    }
}

/// What is known of the states at the beginning and at the end of an interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Ends {
    /// All heaters are off.
    Off,
    /// Nothing.
    Free,
}

/// One heater in the search.
pub(super) struct Chain<'a> {
    /// Its index.
    pub heater: usize,
    /// Field of the heater that is on.
    pub vector_nt: Vector3<f64>,
    /// How long it stays off and on.
    pub dwell: &'a Dwell,
}

/// The states of one heater as rows of a table: edges by direction, age and phase, then off and on by age.
struct Rows {
    /// Ages at which an edge still shows.
    ages: usize,
    /// Ages beyond, the last of which stands for all older ones.
    calm: usize,
    /// Logarithms of the chance to stay and to switch by direction (off, on) and age.
    stay: [Vec<f32>; 2],
    switch: [Vec<f32>; 2],
    /// Age from which on the heater may switch again.
    earliest: usize,
}

impl Rows {
    fn new(ages: usize, earliest: usize, dwell: &Dwell) -> Self {
        let calm = dwell.cells().saturating_sub(ages).max(2);
        let spread = |table: &Vec<f64>| (0..ages + calm).map(|age| table[age.min(table.len() - 1)] as f32).collect();
        let both = |tables: &[Vec<f64>; 2]| [spread(&tables[0]), spread(&tables[1])];
        Rows { ages, calm, stay: both(&dwell.stay), switch: both(&dwell.switch), earliest }
    }

    fn count(&self) -> usize {
        2 * (self.ages * PHASES + self.calm)
    }

    /// Rows in which an edge shows; they come first.
    fn showing(&self) -> usize {
        2 * self.ages * PHASES
    }

    fn edge(&self, direction: usize, age: usize, phase: usize) -> usize {
        (direction * self.ages + age) * PHASES + phase
    }

    fn calm(&self, direction: usize, older: usize) -> usize {
        self.showing() + direction * self.calm + older
    }

    /// One step of this heater for every state of the other, which are the columns. `back` takes what is needed to go back: per
    /// direction the phase that becomes calm, whether the oldest was the oldest before, and the row an edge starts from.
    fn step(&self, table: &[f32], next: &mut [f32], back: &mut [u16], columns: usize, work: &mut [Vec<f32>; 2]) {
        let row = |index: usize| &table[index * columns..(index + 1) * columns];
        for direction in 0..2 {
            let stay = &self.stay[direction];
            let mut carry = |from: usize, to: usize, cost: f32| {
                let target = &mut next[to * columns..(to + 1) * columns];
                target.iter_mut().zip(row(from)).for_each(|(next, old)| *next = old + cost);
            };
            for age in 1..self.ages {
                for phase in 0..PHASES {
                    carry(self.edge(direction, age - 1, phase), self.edge(direction, age, phase), stay[age - 1]);
                }
            }
            for older in 1..self.calm - 1 {
                carry(self.calm(direction, older - 1), self.calm(direction, older), stay[self.ages + older - 1]);
            }
            let mut choose = |sources: &mut dyn Iterator<Item = (usize, f32, f32)>, slot: usize, gain: f32, targets: &[usize]| {
                let [best, which] = work.each_mut();
                best.fill(f32::NEG_INFINITY);
                which.fill(0.0);
                for (from, name, cost) in sources {
                    for ((old, best), which) in row(from).iter().zip(best.iter_mut()).zip(which.iter_mut()) {
                        let value = old + cost;
                        let better = value > *best;
                        *best = if better { value } else { *best };
                        *which = if better { name } else { *which };
                    }
                }
                let start = (3 * direction + slot) * columns;
                back[start..start + columns].iter_mut().zip(which.iter()).for_each(|(back, which)| *back = *which as u16);
                for &to in targets {
                    let target = &mut next[to * columns..(to + 1) * columns];
                    target.iter_mut().zip(best.iter()).for_each(|(next, best)| *next = best + gain);
                }
            };
            let last = self.ages - 1;
            let mut phases = (0..PHASES).map(|phase| (self.edge(direction, last, phase), phase as f32, stay[last]));
            choose(&mut phases, 0, 0.0, &[self.calm(direction, 0)]);
            let oldest = self.calm - 1;
            let mut two = [(oldest - 1, 0.0), (oldest, 1.0)]
                .into_iter()
                .map(|(older, name)| (self.calm(direction, older), name, stay[self.ages + older]));
            choose(&mut two, 1, 0.0, &[self.calm(direction, oldest)]);
            let other = 1 - direction;
            let switch = &self.switch[other];
            let showing = (self.earliest..self.ages).flat_map(|age| (0..PHASES).map(move |phase| (age, phase)));
            let mut all = showing
                .map(|(age, phase)| (self.edge(other, age, phase), switch[age]))
                .chain((0..self.calm).map(|older| (self.calm(other, older), switch[self.ages + older])))
                .map(|(from, cost)| (from, from as f32, cost));
            let starts: Vec<usize> = (0..PHASES).map(|phase| self.edge(direction, 0, phase)).collect();
            choose(&mut all, 2, -(PHASES as f32).ln(), &starts);
        }
    }

    /// The row before a row, and the edge that starts between the two: its direction and phase.
    fn before(&self, row: usize, back: &[u16], columns: usize, column: usize) -> (usize, Option<(usize, usize)>) {
        let choice = |direction: usize, slot: usize| usize::from(back[(3 * direction + slot) * columns + column]);
        if row < self.showing() {
            let (direction, age, phase) = (row / (self.ages * PHASES), row / PHASES % self.ages, row % PHASES);
            return match age {
                0 => (choice(direction, 2), Some((direction, phase))),
                _ => (row - PHASES, None),
            };
        }
        let (direction, older) = ((row - self.showing()) / self.calm, (row - self.showing()) % self.calm);
        let before = match older {
            0 => self.edge(direction, self.ages - 1, choice(direction, 0)),
            older if older + 1 == self.calm && choice(direction, 1) == 1 => row,
            _ => row - 1,
        };
        (before, None)
    }

    /// Whether the heater is off in a row.
    fn off(&self, row: usize) -> bool {
        if row < self.showing() { row < self.ages * PHASES } else { row < self.showing() + self.calm }
    }
}

/// What the edges of one heater look like in the innovations of one part of the interval, per row that shows.
struct Shapes {
    innovation: Vec<Vector3<f64>>,
    weighted: Vec<Vector3<f64>>,
    half_energy: Vec<f64>,
}

/// The most probable course of one or two heaters, with the logarithm of its probability over that of no heater at all, edges in
/// order of time.
///
/// `innovations` are those of the field; NaN says nothing.
pub(super) fn most_probable(
    innovations: &[Vector3<f64>],
    background: &Background,
    profile: Profile,
    chains: &[Chain],
    ends: Ends,
) -> (f64, Vec<Edge>) {
    let earliest = (2.0 * profile.half_cells()).ceil() as usize + 1;
    let ages = earliest + background.order();
    let rows: Vec<Rows> = chains.iter().map(|chain| Rows::new(ages, earliest, chain.dwell)).collect();
    let counts: Vec<usize> = rows.iter().map(Rows::count).collect();
    let total: usize = counts.iter().product();
    let (mut table, mut next, mut spare) = (vec![f32::NEG_INFINITY; total], vec![0.0; total], vec![0.0; total]);
    // The heater of the rows; the columns are the states of the other one.
    let mut front = 0;
    let begin: Vec<Vec<usize>> = rows
        .iter()
        .map(|rows| (0..if ends == Ends::Off { 1 } else { 2 }).map(|direction| rows.calm(direction, rows.calm - 1)).collect())
        .collect();
    let columns = |front: usize| if chains.len() == 2 { counts[1 - front] } else { 1 };
    for first in &begin[0] {
        for second in begin.get(1).map_or(&[0][..], |second| &second[..]) {
            table[first * columns(0) + second] = 0.0;
        }
    }
    let widest = counts.iter().copied().max().unwrap_or(1);
    let mut work = [vec![0.0; widest], vec![0.0; widest]];
    // What is needed to go back, per cell and half step in the order of time: (heater, choices).
    let mut history: Vec<(usize, Vec<u16>)> = Vec::with_capacity(innovations.len() * chains.len());
    let mut taken = 0.0;
    let mut known: Option<(usize, Vec<Shapes>, Vec<f32>)> = None;
    for (cell, innovation) in innovations.iter().enumerate() {
        for half in 0..chains.len() {
            if half == 1 {
                transpose(&table, &mut spare, counts[front], counts[1 - front]);
                std::mem::swap(&mut table, &mut spare);
                front = 1 - front;
            }
            let width = columns(front);
            let mut back = vec![0; 6 * width];
            let mut part = work.each_mut().map(std::mem::take);
            part.iter_mut().for_each(|buffer| buffer.resize(width, 0.0));
            rows[front].step(&table, &mut next, &mut back, width, &mut part);
            work = part;
            std::mem::swap(&mut table, &mut next);
            history.push((front, back));
        }
        if innovation.x.is_nan() {
            continue;
        }
        let index = background.index(cell);
        if known.as_ref().is_none_or(|(of, _, _)| *of != index) {
            let shapes: Vec<Shapes> = chains.iter().map(|chain| shapes(chain, background, cell, profile, ages)).collect();
            let cross = if let [a, b] = &shapes[..] {
                a.innovation.iter().flat_map(|x| b.weighted.iter().map(move |y| x.dot(y) as f32)).collect()
            } else {
                Vec::new()
            };
            known = Some((index, shapes, cross));
        }
        let Some((_, shapes, cross)) = &known else { continue };
        let gain = |heater: usize| -> Vec<f32> {
            let Shapes { weighted, half_energy, .. } = &shapes[heater];
            weighted.iter().zip(half_energy).map(|(weighted, energy)| (weighted.dot(innovation) - energy) as f32).collect()
        };
        let width = columns(front);
        let own = gain(front);
        let others = if chains.len() == 2 { gain(1 - front) } else { Vec::new() };
        for (row, values) in table.chunks_exact_mut(width).enumerate() {
            if let Some(&gain) = own.get(row) {
                values.iter_mut().for_each(|value| *value += gain);
                for (column, (value, other)) in values.iter_mut().zip(&others).enumerate() {
                    let place = if front == 0 { row * others.len() + column } else { column * own.len() + row };
                    *value += other - cross[place];
                }
            } else {
                values.iter_mut().zip(&others).for_each(|(value, other)| *value += other);
            }
        }
        // Single precision is enough near zero.
        let highest = table.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        table.iter_mut().for_each(|value| *value -= highest);
        taken += f64::from(highest);
    }
    let width = columns(front);
    let ended = |place: usize| {
        let state = [place / width, place % width];
        ends == Ends::Free || rows[front].off(state[0]) && (chains.len() == 1 || rows[1 - front].off(state[1]))
    };
    let best = (0..total).filter(|&place| ended(place)).max_by(|&a, &b| table[a].total_cmp(&table[b])).unwrap_or(0);
    let mut state = [0; 2];
    state[front] = best / width;
    state[1 - front] = best % width;
    let mut edges = Vec::new();
    for (step, (heater, back)) in history.iter().enumerate().rev() {
        let column = if chains.len() == 2 { state[1 - heater] } else { 0 };
        let (before, started) = rows[*heater].before(state[*heater], back, columns(*heater), column);
        state[*heater] = before;
        if let Some((direction, phase)) = started {
            let cell = (step / chains.len()) as f64 - 1.0 + profile.half_cells() + (phase as f64 + 0.5) / PHASES as f64;
            edges.push(Edge { heater: chains[*heater].heater, cell, on: direction == 1, std_cells: 0.5 / PHASES as f64 });
        }
    }
    edges.sort_by(|a, b| a.cell.total_cmp(&b.cell));
    (taken + f64::from(table[best]), edges)
}

/// The shapes of one heater around a cell.
fn shapes(chain: &Chain, background: &Background, cell: usize, profile: Profile, ages: usize) -> Shapes {
    let predictor = background.at(cell);
    let mut innovation = Vec::with_capacity(2 * ages * PHASES);
    for sign in [-1.0, 1.0] {
        for age in 0..ages {
            for phase in 0..PHASES {
                let (_, shares) = shares(profile, profile.half_cells() - 1.0 + (phase as f64 + 0.5) / PHASES as f64);
                let share = |lag: usize| age.checked_sub(lag).and_then(|at| shares.get(at)).copied().unwrap_or(0.0);
                let own = chain.vector_nt * share(0);
                let lags = predictor.coefficients.iter().enumerate();
                innovation.push(sign * lags.fold(own, |sum, (lag, matrix)| sum - matrix * chain.vector_nt * share(lag + 1)));
            }
        }
    }
    let weighted: Vec<_> = innovation.iter().map(|shape| predictor.precision * shape).collect();
    let half_energy = innovation.iter().zip(&weighted).map(|(a, b)| 0.5 * a.dot(b)).collect();
    Shapes { innovation, weighted, half_energy }
}

/// Exchanges rows and columns.
fn transpose(table: &[f32], out: &mut [f32], rows: usize, columns: usize) {
    const BLOCK: usize = 16;
    for row in (0..rows).step_by(BLOCK) {
        for column in (0..columns).step_by(BLOCK) {
            for i in row..(row + BLOCK).min(rows) {
                for j in column..(column + BLOCK).min(columns) {
                    out[j * rows + i] = table[i * columns + j];
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use crate::flight::heater::edges::Evidence;

    const PROFILE: Profile = Profile { edge_cells: 1.0, mean_cells: 1.0 };

    /// White increments of 0.05 nT with edges.
    fn increments(seed: u64, cells: usize, edges: &[Edge], vectors: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut random = Random::seeded(seed);
        let noise: Vec<_> = (0..cells).map(|_| Vector3::from_fn(|_, _| 0.05 * random.gaussian())).collect();
        let background = Background::of(&noise, 0);
        let turned: Vec<_> = vectors.iter().map(|vector| -vector).collect();
        Evidence { increments: &noise, background: &background, profile: PROFILE }.without(edges, &turned)
    }

    fn edge(heater: usize, cell: f64, on: bool) -> Edge {
        Edge { heater, cell, on, std_cells: 0.0 }
    }

    #[test]
    fn two_heaters_come_back_also_where_both_switch_at_once() {
        let vectors = [Vector3::new(0.6, 0.0, 0.2), Vector3::new(0.8, 0.5, -0.3)];
        // Both up together, one up as the other goes down, both down together.
        let truth = [
            edge(0, 40.3, true),
            edge(1, 40.4, true),
            edge(0, 56.8, false),
            edge(1, 70.1, false),
            edge(0, 70.2, true),
            edge(1, 84.9, true),
            edge(1, 99.2, false),
            edge(0, 99.3, false),
        ];
        for order in [0, 3] {
            let field = increments(7, 800, &truth, &vectors);
            let quiet = increments(7, 800, &[], &vectors);
            let background = Background::of(&quiet, order);
            let dwell = Dwell::of([[15.0, 3.0], [15.0, 3.0]]);
            let chains = [0, 1].map(|heater| Chain { heater, vector_nt: vectors[heater], dwell: &dwell });
            let (score, found) = most_probable(&background.innovations(&field), &background, PROFILE, &chains, Ends::Off);
            assert!(score > 100.0);
            for heater in 0..2 {
                let own = |edges: &[Edge]| edges.iter().filter(|edge| edge.heater == heater).copied().collect::<Vec<_>>();
                let (found, truth) = (own(&found), own(&truth));
                assert_eq!(found.len(), truth.len(), "{found:?}");
                for (found, truth) in found.iter().zip(&truth) {
                    assert!(found.on == truth.on && (found.cell - truth.cell).abs() < 0.5, "{found:?} {truth:?}");
                }
            }
        }
    }

    #[test]
    fn nothing_is_found_in_noise_and_open_ends_tell_the_polarity() {
        let vectors = [Vector3::new(0.6, 0.0, 0.2)];
        let dwell = Dwell::constant(0.05);
        let quiet = increments(3, 800, &[], &vectors);
        let background = Background::of(&quiet, 0);
        let chain = |vector_nt: Vector3<f64>| [Chain { heater: 0, vector_nt, dwell: &dwell }];
        let innovations = background.innovations(&quiet);
        let (_, none) = most_probable(&innovations, &background, PROFILE, &chain(vectors[0]), Ends::Off);
        assert_eq!(none, []);
        let truth: Vec<Edge> = (0..20).map(|k| edge(0, 50.3 + 15.0 * f64::from(k), k % 2 == 0)).collect();
        let innovations = background.innovations(&increments(3, 800, &truth, &vectors));
        for sign in [1.0, -1.0] {
            let (_, found) = most_probable(&innovations, &background, PROFILE, &chain(vectors[0] * sign), Ends::Free);
            assert_eq!((found.len(), found[0].on, found[19].on), (20, sign > 0.0, sign < 0.0));
        }
    }

    #[test]
    fn chances_follow_from_the_times_in_a_state() {
        // The chance to be off for 20 cells is the product of those to stay; with times of 15 ± 1 it is what follows no rule.
        let dwell = Dwell::of([[15.0, 1.0], [1000.0, 1.0]]);
        let stay: f64 = dwell.stay[0][..20].iter().sum();
        assert!((stay.exp() / (IRREGULAR * (-20.0_f64 / 15.0).exp()) - 1.0).abs() < 0.05, "{}", stay.exp());
        // Times that are too long to count have a constant chance.
        assert_eq!(dwell.switch[1], [(0.001_f64).ln()]);
    }

    #[test]
    fn a_transposed_table_is_the_table() {
        let table: Vec<f32> = (0..7 * 40).map(|value| value as f32).collect();
        let (mut there, mut back) = (vec![0.0; 280], vec![0.0; 280]);
        transpose(&table, &mut there, 7, 40);
        assert_eq!(there[3 * 7 + 2], table[2 * 40 + 3]);
        transpose(&there, &mut back, 40, 7);
        assert_eq!(back, table);
    }
}
