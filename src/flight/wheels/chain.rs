//! Least squares for quantities that change slowly: values at knots, seen by data between two neighbouring knots, with increments
//! from knot to knot of a known size.
//!
//! The normal equations are block tridiagonal. They are solved from the first knot to the last and back, which is the Kalman smoother
//! (Rauch, Tung and Striebel 1965) in information form. The covariance of every increment comes with it, so that the size of the
//! increments can be found from the data (expectation and maximisation, Shumway and Stoffer 1982).

/// Inverse variance of an amplitude that nothing else determines, 1/nT²: a wheel at rest, or seen for an instant only, has less than 10 nT.
const LEAST_INFORMATION: f64 = 1e-2;

/// Normal equations of a chain of knots; matrices are stored by rows, one after the other.
#[derive(Clone, Debug)]
pub(super) struct Chain {
    /// Unknowns of a knot.
    pub states: usize,
    /// Right-hand sides, which share the matrices.
    pub sides: usize,
    /// Steps between the knots, s; infinite where nothing is known about the increment.
    pub steps_s: Vec<f64>,
    /// Information of the data on a knot, `states` x `states` each.
    pub own: Vec<f64>,
    /// Information between a knot (rows) and the next one (columns).
    pub next: Vec<f64>,
    /// Right-hand sides, `states` x `sides` each.
    pub right: Vec<f64>,
}

impl Chain {
    /// Without data.
    pub fn new(states: usize, sides: usize, steps_s: Vec<f64>) -> Self {
        let (knots, square) = (steps_s.len() + 1, states * states);
        Self {
            states,
            sides,
            own: vec![0.0; knots * square],
            next: vec![0.0; steps_s.len() * square],
            right: vec![0.0; knots * states * sides],
            steps_s,
        }
    }

    /// Number of knots.
    pub fn knots(&self) -> usize {
        self.steps_s.len() + 1
    }

    /// Adds what the data between the knots `knot` and `knot + 1` say about both: the lower triangle of a square matrix of twice the
    /// states and its right-hand sides, times `factor`.
    pub fn add(&mut self, knot: usize, lower: &[f64], right: &[f64], factor: f64) {
        let (m, square, part) = (self.states, self.states * self.states, self.states * self.sides);
        let entry = |i: usize, j: usize| factor * lower[i.max(j) * 2 * m + i.min(j)];
        for i in 0..m {
            for j in 0..m {
                self.own[knot * square + i * m + j] += entry(i, j);
                self.own[(knot + 1) * square + i * m + j] += entry(m + i, m + j);
                self.next[knot * square + i * m + j] += entry(i, m + j);
            }
        }
        for (sum, value) in self.right[knot * part..(knot + 2) * part].iter_mut().zip(right) {
            *sum += factor * value;
        }
    }
}

/// Buffers of the solution of a chain.
#[derive(Clone, Debug, Default)]
pub(super) struct Smoother {
    /// Values at the knots, `states` x `sides` each.
    pub values: Vec<f64>,
    inverses: Vec<f64>,
    gains: Vec<f64>,
    forward: Vec<f64>,
}

impl Smoother {
    /// Solves a chain.
    ///
    /// `expected` writes the inverse of the covariance of the increment after a knot, per second; `seen` is given that knot, the
    /// increment (`states` x `sides`) and its covariance, knots from the last to the first.
    pub fn solve(
        &mut self,
        chain: &Chain,
        mut expected: impl FnMut(usize, &mut [f64]),
        mut seen: impl FnMut(usize, &[f64], &[f64]),
    ) {
        let (m, r, knots) = (chain.states, chain.sides, chain.knots());
        let (square, part) = (m * m, m * r);
        self.inverses.resize(knots * square, 0.0);
        self.gains.resize(knots * square, 0.0);
        self.values.resize(knots * part, 0.0);
        self.forward.clear();
        self.forward.extend_from_slice(&chain.right);
        let mut information = chain.own[..square].to_vec();
        let mut weight = vec![0.0; square];
        let mut coupling = vec![0.0; square];
        for knot in 0..knots {
            for i in 0..m {
                information[i * m + i] += LEAST_INFORMATION;
            }
            let last = knot + 1 == knots;
            if !last {
                weight.fill(0.0);
                if chain.steps_s[knot].is_finite() {
                    expected(knot, &mut weight);
                    weight.iter_mut().for_each(|w| *w /= chain.steps_s[knot]);
                }
                for (sum, w) in information.iter_mut().zip(&weight) {
                    *sum += w;
                }
            }
            let inverse = &mut self.inverses[knot * square..(knot + 1) * square];
            invert(&mut information, inverse, m);
            if last {
                break;
            }
            for ((c, n), w) in coupling.iter_mut().zip(&chain.next[knot * square..]).zip(&weight) {
                *c = n - w;
            }
            let gain = &mut self.gains[knot * square..(knot + 1) * square];
            gain.fill(0.0);
            add_product(gain, inverse, &coupling, [m, m, m], 1.0);
            let (before, after) = self.forward.split_at_mut((knot + 1) * part);
            add_transposed_product(&mut after[..part], gain, &before[knot * part..], [m, m, r], -1.0);
            information.copy_from_slice(&chain.own[(knot + 1) * square..(knot + 2) * square]);
            for (sum, w) in information.iter_mut().zip(&weight) {
                *sum += w;
            }
            add_transposed_product(&mut information, &coupling, gain, [m, m, m], -1.0);
        }
        // Back again: values, their covariances, and what both say about the increments.
        let mut covariance = self.inverses[(knots - 1) * square..].to_vec();
        let mut crossed = vec![0.0; square];
        let mut here = vec![0.0; square];
        let mut increment = vec![0.0; part];
        for knot in (0..knots).rev() {
            let inverse = &self.inverses[knot * square..(knot + 1) * square];
            let (values, later) = self.values.split_at_mut((knot + 1) * part);
            let value = &mut values[knot * part..];
            value.fill(0.0);
            add_product(value, inverse, &self.forward[knot * part..(knot + 1) * part], [m, m, r], 1.0);
            if knot + 1 == knots {
                continue;
            }
            let gain = &self.gains[knot * square..(knot + 1) * square];
            add_product(value, gain, &later[..part], [m, m, r], -1.0);
            crossed.fill(0.0);
            add_product(&mut crossed, gain, &covariance, [m, m, m], 1.0);
            here.copy_from_slice(inverse);
            for i in 0..m {
                for j in 0..m {
                    let (a, b) = (&crossed[i * m..(i + 1) * m], &gain[j * m..(j + 1) * m]);
                    here[i * m + j] += a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
                }
            }
            for i in 0..m {
                for j in 0..m {
                    covariance[i * m + j] += here[i * m + j] + crossed[i * m + j] + crossed[j * m + i];
                }
            }
            for ((d, after), before) in increment.iter_mut().zip(&later[..part]).zip(&*value) {
                *d = after - before;
            }
            if chain.steps_s[knot].is_finite() {
                seen(knot, &increment, &covariance);
            }
            covariance.copy_from_slice(&here);
        }
    }
}

/// Adds `factor a b` for a of `[rows, inner, _]` and b of `[_, inner, columns]`.
fn add_product(sum: &mut [f64], a: &[f64], b: &[f64], [rows, inner, columns]: [usize; 3], factor: f64) {
    for (row, line) in sum.chunks_exact_mut(columns).take(rows).enumerate() {
        for k in 0..inner {
            let x = factor * a[row * inner + k];
            for (s, y) in line.iter_mut().zip(&b[k * columns..(k + 1) * columns]) {
                *s += x * y;
            }
        }
    }
}

/// Adds `factor aᵀ b` for a of `[inner, rows, _]` and b of `[inner, _, columns]`.
fn add_transposed_product(sum: &mut [f64], a: &[f64], b: &[f64], [inner, rows, columns]: [usize; 3], factor: f64) {
    for k in 0..inner {
        let from = &b[k * columns..(k + 1) * columns];
        for (row, line) in sum.chunks_exact_mut(columns).take(rows).enumerate() {
            let x = factor * a[k * rows + row];
            for (s, y) in line.iter_mut().zip(from) {
                *s += x * y;
            }
        }
    }
}

/// Inverse of a positive definite matrix of `m` rows by Cholesky's decomposition, which replaces the matrix. A direction without
/// information left by rounding counts as known: its variance is zero.
fn invert(matrix: &mut [f64], inverse: &mut [f64], m: usize) {
    for i in 0..m {
        for j in 0..=i {
            let (a, b) = (&matrix[i * m..i * m + j], &matrix[j * m..j * m + j]);
            let rest = matrix[i * m + j] - a.iter().zip(b).map(|(x, y)| x * y).sum::<f64>();
            matrix[i * m + j] = if i != j {
                rest * matrix[j * m + j]
            } else if rest > 0.0 {
                // The diagonal holds its inverse.
                1.0 / rest.sqrt()
            } else {
                0.0
            };
        }
    }
    // Rows of the inverse of the triangle, which is lower again.
    inverse.fill(0.0);
    for i in 0..m {
        inverse[i * m + i] = matrix[i * m + i];
        for k in 0..i {
            let x = -matrix[i * m + k] * matrix[i * m + i];
            let (before, row) = inverse.split_at_mut(i * m);
            for (s, y) in row[..=k].iter_mut().zip(&before[k * m..=k * m + k]) {
                *s += x * y;
            }
        }
    }
    matrix.copy_from_slice(inverse);
    inverse.fill(0.0);
    add_transposed_product(inverse, matrix, matrix, [m, m, m], 1.0);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use nalgebra::{DMatrix, DVector};

    fn filled(states: usize, sides: usize, steps_s: &[f64]) -> Chain {
        let mut random = Random::seeded(4);
        let mut chain = Chain::new(states, sides, steps_s.to_vec());
        for knot in 0..steps_s.len() {
            let design = DMatrix::from_fn(9, 2 * states, |_, _| random.gaussian());
            let rhs = DMatrix::from_fn(9, sides, |_, _| random.gaussian());
            let (gram, right) = (design.transpose() * &design, design.transpose() * rhs);
            chain.add(knot, gram.transpose().as_slice(), right.transpose().as_slice(), 0.7);
        }
        chain
    }

    /// The same normal equations as one matrix.
    fn whole(chain: &Chain, expected: &DMatrix<f64>) -> DMatrix<f64> {
        let (m, knots) = (chain.states, chain.knots());
        let mut all = DMatrix::identity(m * knots, m * knots) * LEAST_INFORMATION;
        for knot in 0..knots {
            for i in 0..m {
                for j in 0..m {
                    all[(knot * m + i, knot * m + j)] += chain.own[(knot * m + i) * m + j];
                    if knot + 1 < knots {
                        let step = chain.steps_s[knot];
                        let weight = if step.is_finite() { expected[(i, j)] / step } else { 0.0 };
                        let next = chain.next[(knot * m + i) * m + j] - weight;
                        all[(knot * m + i, (knot + 1) * m + j)] += next;
                        all[((knot + 1) * m + j, knot * m + i)] += next;
                        all[(knot * m + i, knot * m + j)] += weight;
                        all[((knot + 1) * m + i, (knot + 1) * m + j)] += weight;
                    }
                }
            }
        }
        all
    }

    #[test]
    fn the_chain_agrees_with_the_whole_matrix() {
        let chain = filled(3, 2, &[0.5, f64::INFINITY, 2.0, 1.0]);
        let expected = DMatrix::from_row_slice(3, 3, &[2.0, 0.3, 0.0, 0.3, 1.0, -0.2, 0.0, -0.2, 4.0]);
        let mut increments = Vec::new();
        let mut smoother = Smoother::default();
        let write = |_: usize, w: &mut [f64]| w.copy_from_slice(expected.as_slice());
        smoother.solve(&chain, write, |knot, d, c| increments.push((knot, d.to_vec(), c.to_vec())));
        let covariance = whole(&chain, &expected).try_inverse().unwrap();
        for side in 0..2 {
            let right = DVector::from_fn(15, |i, _| chain.right[i * 2 + side]);
            let truth = &covariance * right;
            for i in 0..15 {
                assert!((smoother.values[i * 2 + side] - truth[i]).abs() < 1e-12, "{i}");
            }
        }
        assert_eq!(increments.iter().map(|x| x.0).collect::<Vec<_>>(), [3, 2, 0]);
        for (knot, increment, found) in increments {
            for i in 0..3 {
                let at = |k: usize, i: usize| (knot + k) * 3 + i;
                assert_eq!(increment[i * 2], smoother.values[at(1, i) * 2] - smoother.values[at(0, i) * 2]);
                for j in 0..3 {
                    let of = |a, b| covariance[(at(a, i), at(b, j))];
                    let truth = of(0, 0) + of(1, 1) - of(0, 1) - of(1, 0);
                    assert!((found[i * 3 + j] - truth).abs() < 1e-12, "{knot} {i} {j}");
                }
            }
        }
    }

    #[test]
    fn one_knot_is_plain_least_squares() {
        let mut chain = Chain::new(1, 1, vec![]);
        (chain.own[0], chain.right[0]) = (3.0, 6.0);
        let mut smoother = Smoother::default();
        smoother.solve(&chain, |_, _| unreachable!(), |_, _, _| unreachable!());
        assert!((smoother.values[0] - 6.0 / (3.0 + LEAST_INFORMATION)).abs() < 1e-15);
    }
}
