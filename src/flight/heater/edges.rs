//! Edges, what they look like in increments and innovations, and what the innovations say of class vectors and times.

use crate::fit::statistics::std_of;
use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

use super::background::Background;
use super::cells::Profile;

/// A heater that switches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Edge {
    /// Index of the heater.
    pub heater: usize,
    /// Middle of the edge, counted in cells from the middle of the first cell of the interval.
    pub cell: f64,
    /// It switches on.
    pub on: bool,
    /// Standard deviation of its place; what is beyond a cell says nothing.
    pub std_cells: f64,
}

impl Edge {
    /// 1 of an edge to on, -1 of one to off.
    pub fn sign(self) -> f64 {
        if self.on { 1.0 } else { -1.0 }
    }
}

/// Share of an edge in the increments, from the first cell it reaches: (first cell, shares).
pub(super) fn shares(profile: Profile, cell: f64) -> (i64, Vec<f64>) {
    let first = (cell - profile.half_cells()).floor() as i64 + 1;
    let last = (cell + profile.half_cells()).ceil() as i64;
    let share = |at: i64| profile.share(at as f64 - cell);
    (first, (first..=last).map(|at| share(at) - share(at - 1)).collect())
}

/// An interval with the predictors of its background, as the likelihood sees it.
pub(super) struct Evidence<'a> {
    pub increments: &'a [Vector3<f64>],
    pub background: &'a Background,
    pub profile: Profile,
}

impl Evidence<'_> {
    /// The matrices by which a class vector of an edge at a place enters the innovations: (cell, matrix), only where these are
    /// known.
    pub fn reach(&self, cell: f64, innovations: &[Vector3<f64>]) -> Vec<(usize, Matrix3<f64>)> {
        let (first, shares) = shares(self.profile, cell);
        let last = first + (shares.len() + self.background.order()) as i64;
        let range = first.max(0) as usize..(last.max(0) as usize).min(innovations.len());
        range
            .filter(|&at| innovations[at].x.is_finite())
            .map(|at| {
                let share =
                    |lag: usize| shares.get(usize::try_from(at as i64 - lag as i64 - first).unwrap_or(usize::MAX)).copied();
                let own = Matrix3::from_diagonal_element(share(0).unwrap_or(0.0));
                let coefficients = self.background.at(at).coefficients.iter().enumerate();
                (at, coefficients.fold(own, |sum, (lag, matrix)| sum - matrix * share(lag + 1).unwrap_or(0.0)))
            })
            .collect()
    }

    /// The increments without edges of these class vectors.
    pub fn without(&self, edges: &[Edge], vectors_nt: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let mut left = self.increments.to_vec();
        for edge in edges {
            let (first, shares) = shares(self.profile, edge.cell);
            for (offset, share) in shares.iter().enumerate() {
                if let Some(increment) = usize::try_from(first + offset as i64).ok().and_then(|at| left.get_mut(at)) {
                    *increment -= vectors_nt[edge.heater] * (edge.sign() * share);
                }
            }
        }
        left
    }

    /// Moves every edge to where the likelihood is largest, the others as they are, within `reach_cells` of where it is;
    /// `prior_std_cells` is the standard deviation of the times given, infinite where they are not known. Sets the standard
    /// deviations of the times.
    pub fn refine(&self, edges: &mut [Edge], vectors_nt: &[Vector3<f64>], prior_std_cells: f64, reach_cells: f64) {
        let mut left = self.background.innovations(&self.without(edges, vectors_nt));
        let given: Vec<f64> = edges.iter().map(|edge| edge.cell).collect();
        for _ in 0..REFINEMENTS {
            for (index, edge) in edges.iter_mut().enumerate() {
                let vector = vectors_nt[edge.heater] * edge.sign();
                let old = self.reach(edge.cell, &left);
                old.iter().for_each(|(at, matrix)| left[*at] += matrix * vector);
                let cost = |cell: f64| {
                    let of_data: f64 = self
                        .reach(cell, &left)
                        .iter()
                        .map(|(at, matrix)| {
                            let part = matrix * vector;
                            let precision = &self.background.at(*at).precision;
                            0.5 * part.dot(&(precision * part)) - part.dot(&(precision * left[*at]))
                        })
                        .sum();
                    of_data + 0.5 * ((cell - given[index]) / prior_std_cells).powi(2)
                };
                let (cell, curvature) = minimum(cost, edge.cell, [given[index] - reach_cells, given[index] + reach_cells]);
                edge.cell = cell;
                edge.std_cells = if curvature > 0.0 { curvature.sqrt().recip() } else { f64::INFINITY };
                self.reach(cell, &left).iter().for_each(|(at, matrix)| left[*at] -= matrix * vector);
            }
        }
    }

    /// Gives every edge the standard deviation of its place with those of the edges near it free: [`Self::refine`] states what it is with the others
    /// where they are, and of two heaters that switch together each may make up for what the other lacks.
    pub fn spread(&self, edges: &mut [Edge], vectors_nt: &[Vector3<f64>], innovations: &[Vector3<f64>]) {
        let slope = |edge: &Edge| self.slope(*edge, vectors_nt[edge.heater] * edge.sign(), innovations);
        let own: Vec<(usize, Vec<Vector3<f64>>)> = edges.iter().map(slope).collect();
        let product = |i: usize, j: usize| {
            let ((first, of_i), (other, of_j)) = (&own[i], &own[j]);
            let common = *first.max(other)..(first + of_i.len()).min(other + of_j.len());
            common.map(|at| of_i[at - first].dot(&(self.background.at(at).precision * of_j[at - other]))).sum::<f64>()
        };
        let spread: Vec<f64> = (0..edges.len())
            .map(|index| {
                let alone = edges[index].std_cells;
                let near: Vec<usize> = (0..edges.len()).filter(|&other| product(index, other) != 0.0).collect();
                let (true, Some(place)) = (alone.is_finite(), near.iter().position(|&other| other == index)) else {
                    return alone;
                };
                let precision = DMatrix::from_fn(near.len(), near.len(), |i, j| {
                    let shared = product(near[i], near[j]);
                    if i == j { shared.max(edges[near[i]].std_cells.powi(-2)) } else { shared }
                });
                let free = precision.cholesky().map(|cholesky| cholesky.inverse()[(place, place)].sqrt());
                free.filter(|std| std.is_finite()).map_or(f64::INFINITY, |std| alone.max(std))
            })
            .collect();
        edges.iter_mut().zip(spread).for_each(|(edge, std)| edge.std_cells = std);
    }

    /// What the innovations change by when an edge with a vector moves by a cell: (first cell, changes); zero where they are not known.
    fn slope(&self, edge: Edge, vector_nt: Vector3<f64>, innovations: &[Vector3<f64>]) -> (usize, Vec<Vector3<f64>>) {
        let [before, after] = [-STEP_CELLS, STEP_CELLS].map(|step| self.reach(edge.cell + step, innovations));
        let cells = || before.iter().chain(&after).map(|(at, _)| *at);
        let (Some(first), Some(last)) = (cells().min(), cells().max()) else { return (0, Vec::new()) };
        let mut slope = vec![Vector3::zeros(); last + 1 - first];
        for (sign, reach) in [(-1.0, before), (1.0, after)] {
            reach.iter().for_each(|(at, matrix)| slope[at - first] += matrix * vector_nt * (sign / (2.0 * STEP_CELLS)));
        }
        (first, slope)
    }

    /// The vector of one edge alone and its covariance; `innovations` are those without any edge of the class vectors.
    pub fn height(
        &self,
        edge: Edge,
        vector_nt: Vector3<f64>,
        innovations: &[Vector3<f64>],
    ) -> Option<(Vector3<f64>, Matrix3<f64>)> {
        let (precision, right) = self.one_edge(edge.cell, innovations);
        let covariance = precision.try_inverse()?;
        Some((vector_nt + covariance * right * edge.sign(), covariance))
    }

    /// Sums of least squares for the vector of an edge at a place: its precision, and that times the vector.
    pub fn one_edge(&self, cell: f64, innovations: &[Vector3<f64>]) -> (Matrix3<f64>, Vector3<f64>) {
        self.reach(cell, innovations).into_iter().fold(
            (Matrix3::zeros(), Vector3::zeros()),
            |(precision, right), (at, matrix)| {
                let weighted = matrix.transpose() * self.background.at(at).precision;
                (precision + weighted * matrix, right + weighted * innovations[at])
            },
        )
    }
}

/// Sweeps over the edges of an interval.
const REFINEMENTS: usize = 2;
/// Half of the distance over which derivatives by the place of an edge are taken, in cells.
const STEP_CELLS: f64 = 0.1;
/// Scatter of a time beyond which it is not averaged over.
const WIDEST_CELLS: f64 = 0.5;
/// Places, in standard deviations, and weights that give the expectation of polynomials up to the fifth order over a normal
/// distribution.
const NORMAL_NODES: [(f64, f64); 3] =
    [(-1.732_050_807_568_877_2, 1.0 / 6.0), (0.0, 2.0 / 3.0), (1.732_050_807_568_877_2, 1.0 / 6.0)];

/// The minimum of a smooth function of one number near a place by shrinking steps, and the curvature there.
fn minimum(cost: impl Fn(f64) -> f64, start: f64, [low, high]: [f64; 2]) -> (f64, f64) {
    let (mut best, mut step) = (start, 0.25_f64.min(0.5 * (high - low)));
    let mut least = cost(best);
    while step > 0.01 {
        let sides = [best - step, best + step].map(|at| (at, if (low..=high).contains(&at) { cost(at) } else { f64::INFINITY }));
        match sides.into_iter().min_by(|a, b| a.1.total_cmp(&b.1)) {
            Some((at, value)) if value < least => (best, least) = (at, value),
            _ => step *= 0.5,
        }
    }
    (best, (cost(best - STEP_CELLS) + cost(best + STEP_CELLS) - 2.0 * least) / (STEP_CELLS * STEP_CELLS))
}

/// Sums of generalised least squares for the class vectors of all heaters from the innovations of many intervals.
#[derive(Clone, Debug)]
pub(super) struct Normal {
    matrix: DMatrix<f64>,
    right: DVector<f64>,
}

impl Normal {
    /// Nothing known of so many heaters.
    pub fn new(heaters: usize) -> Self {
        Normal { matrix: DMatrix::zeros(3 * heaters, 3 * heaters), right: DVector::zeros(3 * heaters) }
    }

    /// Adds the edges of an interval. The time of an edge is known to its standard deviation only: sums are expectations over it,
    /// since an edge at its most probable time looks higher than it is, and one at a wrong time lower.
    pub fn add(&mut self, evidence: &Evidence, edges: &[Edge]) {
        let innovations = evidence.background.innovations(evidence.increments);
        let heaters = self.right.len() / 3;
        let mut design: BTreeMap<usize, Vec<Matrix3<f64>>> = BTreeMap::new();
        for edge in edges {
            let std = if edge.std_cells < WIDEST_CELLS { edge.std_cells } else { 0.0 };
            let mut means: BTreeMap<usize, Matrix3<f64>> = BTreeMap::new();
            let mut scatter = Matrix3::zeros();
            for (place, weight) in NORMAL_NODES {
                for (at, matrix) in evidence.reach(edge.cell + std * place, &innovations) {
                    *means.entry(at).or_insert_with(Matrix3::zeros) += matrix * weight;
                    scatter += matrix.transpose() * evidence.background.at(at).precision * matrix * weight;
                }
            }
            for (at, mean) in means {
                scatter -= mean.transpose() * evidence.background.at(at).precision * mean;
                design.entry(at).or_insert_with(|| vec![Matrix3::zeros(); heaters])[edge.heater] += mean * edge.sign();
            }
            let mut block = self.matrix.fixed_view_mut::<3, 3>(3 * edge.heater, 3 * edge.heater);
            block += scatter;
        }
        for (at, matrices) in design {
            let precision = &evidence.background.at(at).precision;
            for (i, a) in matrices.iter().enumerate() {
                let weighted = a.transpose() * precision;
                let mut right = self.right.fixed_rows_mut::<3>(3 * i);
                right += weighted * innovations[at];
                for (j, b) in matrices.iter().enumerate() {
                    let mut block = self.matrix.fixed_view_mut::<3, 3>(3 * i, 3 * j);
                    block += weighted * b;
                }
            }
        }
    }

    /// Adds what another one knows.
    pub fn merge(mut self, other: &Normal) -> Self {
        self.matrix += &other.matrix;
        self.right += &other.right;
        self
    }

    /// What the class vectors explain of the sum of squares of the innovations, each in units of its variance.
    pub fn explained(&self) -> f64 {
        let mut sum = 0.0;
        for (heater, solved) in self.solve().into_iter().enumerate() {
            if let Some((vector, _)) = solved {
                sum += vector.dot(&self.right.fixed_rows::<3>(3 * heater));
            }
        }
        sum
    }

    /// The class vectors and their standard deviations; `None` for heaters without edges.
    pub fn solve(&self) -> Vec<Option<(Vector3<f64>, Vector3<f64>)>> {
        let heaters = self.right.len() / 3;
        let known: Vec<usize> = (0..heaters).filter(|&heater| self.matrix[(3 * heater, 3 * heater)] > 0.0).collect();
        let rows: Vec<usize> = known.iter().flat_map(|&heater| 3 * heater..3 * heater + 3).collect();
        let part = DMatrix::from_fn(rows.len(), rows.len(), |i, j| self.matrix[(rows[i], rows[j])]);
        let right = DVector::from_fn(rows.len(), |i, _| self.right[rows[i]]);
        let mut solution = vec![None; heaters];
        if let Some(cholesky) = part.cholesky() {
            let (vector, covariance) = (cholesky.solve(&right), cholesky.inverse());
            for (place, &heater) in known.iter().enumerate() {
                let std = Vector3::from_fn(|c, _| std_of(covariance[(3 * place + c, 3 * place + c)]));
                solution[heater] = Some((vector.fixed_rows::<3>(3 * place).into_owned(), std));
            }
        }
        solution
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    const PROFILE: Profile = Profile { edge_cells: 1.0, mean_cells: 1.0 };

    /// Increments of a random walk of 0.05 nT per cell with two heaters that switch every 15 and 17 cells.
    fn record(seed: u64, vectors: &[Vector3<f64>; 2]) -> (Vec<Vector3<f64>>, Vec<Edge>) {
        let mut random = Random::seeded(seed);
        let mut edges = Vec::new();
        for (heater, half) in [(0, 15.0), (1, 17.0)] {
            for k in 2..100 {
                edges.push(Edge { heater, cell: half * k as f64 + 3.0 * random.uniform(), on: k % 2 == 0, std_cells: 0.0 });
            }
        }
        (with_edges(&edges, vectors, &mut random), edges)
    }

    /// 2000 increments of such a random walk with these edges.
    fn with_edges(edges: &[Edge], vectors: &[Vector3<f64>; 2], random: &mut Random) -> Vec<Vector3<f64>> {
        let mut increments: Vec<_> = (0..2000).map(|_| Vector3::from_fn(|_, _| 0.05 * random.gaussian())).collect();
        for edge in edges {
            let (first, shares) = shares(PROFILE, edge.cell);
            assert!((shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
            for (offset, share) in shares.iter().enumerate() {
                increments[first as usize + offset] += vectors[edge.heater] * edge.sign() * *share;
            }
        }
        increments
    }

    #[test]
    fn of_two_heaters_that_switch_together_either_time_is_uncertain_by_the_other() {
        let vectors = [Vector3::new(0.5, -0.2, 0.3), Vector3::new(0.55, -0.2, 0.3)];
        for (apart, on, together) in
            [(0.1, true, true), (0.1, false, true), (0.8, true, false), (0.8, false, false), (40.0, true, false)]
        {
            let mut edges =
                [(0, 100.3, true), (1, 100.3 + apart, on)].map(|(heater, cell, on)| Edge { heater, cell, on, std_cells: 0.0 });
            let increments = with_edges(&edges, &vectors, &mut Random::seeded(3));
            let background = Background::of(&with_edges(&[], &vectors, &mut Random::seeded(3)), 0);
            let evidence = Evidence { increments: &increments, background: &background, profile: PROFILE };
            // What both places are known to from the expected sum of squares alone: the inverse of its second derivatives.
            let before = evidence.without(&edges, &vectors);
            let squares = |by: [f64; 2]| {
                let mut moved = edges;
                moved.iter_mut().zip(by).for_each(|(edge, by)| edge.cell += by);
                let change: Vec<_> = evidence.without(&moved, &vectors).iter().zip(&before).map(|(a, b)| a - b).collect();
                change.iter().enumerate().map(|(at, change)| change.dot(&(background.at(at).precision * change))).sum::<f64>()
            };
            let h = 0.1;
            let [own, other] = [[h, 0.0], [0.0, h]].map(|by| 0.5 * (squares(by) + squares(by.map(|by| -by))) / (h * h));
            let both = (squares([h, h]) + squares([-h, -h]) - squares([h, -h]) - squares([-h, h])) / (8.0 * h * h);
            let factor = (1.0 - both * both / (own * other)).sqrt().recip();
            [edges[0].std_cells, edges[1].std_cells] = [own, other].map(|precision: f64| precision.sqrt().recip());
            let mut free = edges;
            evidence.spread(&mut free, &vectors, &background.innovations(&increments));
            for (alone, free) in edges.iter().zip(&free) {
                let found = free.std_cells / alone.std_cells;
                assert!((found / factor - 1.0).abs() < 1e-6, "{apart} {on}: {found} {factor}");
            }
            assert_eq!(factor > 2.0, together, "{apart} {factor}");
        }
    }

    #[test]
    fn class_vectors_and_times_come_back_within_their_standard_deviations() {
        let vectors = [Vector3::new(0.5, -0.2, 0.3), Vector3::new(0.2, 1.0, -0.4)];
        let (increments, mut edges) = record(1, &vectors);
        let clean = Evidence { increments: &increments, background: &Background::of(&increments, 0), profile: PROFILE };
        let clean = clean.without(&edges, &vectors);
        for order in [0, 2] {
            let background = Background::of(&clean, order);
            let evidence = Evidence { increments: &increments, background: &background, profile: PROFILE };
            let mut normal = Normal::new(3);
            normal.add(&evidence, &edges);
            let solved = normal.solve();
            assert!(solved[2].is_none());
            for heater in 0..2 {
                let (vector, std) = solved[heater].expect("98 edges determine a vector");
                assert!((vector - vectors[heater]).component_div(&std).abs().max() < 4.0, "{vector}");
                // An edge in white increments is known to the noise over the root of the sum of the squared shares, here about
                // 0.6.
                assert!((0.004..0.01).contains(&std.x), "{std}");
            }
            // Times put wrong by 0.2 cells come back.
            let truth: Vec<f64> = edges.iter().map(|edge| edge.cell).collect();
            edges.iter_mut().enumerate().for_each(|(index, edge)| edge.cell += if index % 2 == 0 { 0.2 } else { -0.2 });
            evidence.refine(&mut edges, &vectors, f64::INFINITY, 1.0);
            let squares: f64 = edges.iter().zip(&truth).map(|(edge, cell)| ((edge.cell - cell) / edge.std_cells).powi(2)).sum();
            assert!((0.6..1.5).contains(&(squares / edges.len() as f64)), "{squares}");
            edges.iter_mut().zip(&truth).for_each(|(edge, &cell)| (edge.cell, edge.std_cells) = (cell, 0.0));
        }
    }
}
