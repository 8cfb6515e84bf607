//! Which of many groups of columns explains what a linear model leaves: scores on whitened residuals, paid for by simulation.
//!
//! The evidence of a group is its Bayes factor against no group, with a prior on its size (Zellner's g): on average over noise it is
//! one, so that evidences of groups of different size, of forms and of shapes compare and add. How often noise alone gives as much is
//! simulated over all groups at once.

use super::statistics::log_chi2_tail;
use nalgebra::{DMatrix, DMatrixView, DVector, DVectorView};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use rayon::prelude::*;
use std::ops::Range;

/// Squares of the signal to noise ratio that a group is expected to have, per column.
const EXPECTED: f64 = 60.0;
/// A group of which less than this part is left beside the model is absorbed by it.
pub const ABSORBED: f64 = 0.02;
/// A column that keeps less than this part of itself after projection on the other columns counts as dependent on them.
const INDEPENDENT: f64 = 1e-9;
/// Draws of noise for the largest evidence of all groups.
const DRAWS: usize = 500;
/// One in so many of them, the largest, are the tail.
const TAIL: usize = 25;
/// Draws of one thread at a time.
const BATCH: usize = 50;

/// A whitened linear model: what it leaves of the readings, and the space of its columns.
pub struct Fitted {
    /// Residuals, component after component.
    pub residual: DVector<f64>,
    /// Orthonormal base of the columns.
    base: Vec<Unit>,
    /// First row of each component, and the end.
    edges: [usize; 4],
    /// Degrees of freedom of each component.
    freedom: [f64; 3],
    /// Sums of squares from which the noise of each component is estimated in addition to the residuals.
    beside: [f64; 3],
}

/// A group of columns beside the model.
pub struct Group {
    /// Orthonormal base of what the model leaves of the columns.
    base: DMatrix<f64>,
    /// Part of the columns that the model leaves.
    pub surviving: f64,
    /// Norm of what is left of each column.
    pub norms: Vec<f64>,
    /// Components on which it acts.
    on: [bool; 3],
    /// Cross products of the base, component by component.
    cross: [DMatrix<f64>; 3],
}

/// How well a group of columns explains the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Score {
    /// Signal to noise ratio.
    pub strength: f64,
    /// Logarithm of the evidence.
    pub evidence: f64,
    /// Chi square with as many degrees of freedom as the group has columns, if there is noise only.
    pub chi_square: f64,
    /// Columns of the group.
    pub count: usize,
}

/// Logarithm of the evidence of a group that is expected to explain so many squares.
fn evidence(chi_square: f64, columns: usize, expected: f64) -> f64 {
    let count = columns.max(1) as f64;
    let g = expected / count;
    0.5 * (g / (1.0 + g) * chi_square - count * (1.0 + g).ln())
}

impl Score {
    /// From twice the logarithm of the likelihood ratio, the degrees of freedom of the components on which a group acts, and its columns.
    #[must_use]
    pub fn of(likelihood: f64, freedom: f64, columns: usize) -> Self {
        let count = columns as f64;
        // Bartlett's correction makes the likelihood ratio a chi square.
        let rest = (freedom - count).max(1.0);
        let strength = (rest * ((likelihood / freedom).exp() - 1.0)).max(0.0).sqrt();
        Score { strength, ..Score::known((rest + 0.5 * count - 1.0) * likelihood / freedom, columns) }
    }

    /// From the squares that a group explains where the size of the noise is known, and its columns.
    #[must_use]
    pub fn known(chi_square: f64, columns: usize) -> Self {
        let evidence = evidence(chi_square, columns, EXPECTED);
        Score { chi_square, strength: chi_square.max(0.0).sqrt(), evidence, count: columns }
    }

    /// Logarithm of the evidence if a strong group is expected to be as strong as it is: where noise of another kind explains as much, what is
    /// lost by the prior of the size must not decide.
    #[must_use]
    pub fn evidence_of_any_size(&self) -> f64 {
        evidence(self.chi_square, self.count, EXPECTED.max(self.chi_square))
    }

    /// The part of its strength with which its evidence would be less by `margin`.
    #[must_use]
    pub fn part_for(&self, margin: f64) -> f64 {
        let g = EXPECTED / self.count as f64;
        (1.0 - 2.0 * margin * (1.0 + g) / (g * self.chi_square)).max(0.0).sqrt()
    }

    /// Probability of a score as large for this group alone.
    #[must_use]
    pub fn p_value(&self) -> f64 {
        if self.count == 0 { 1.0 } else { log_chi2_tail(self.chi_square, self.count as f64).exp().max(f64::MIN_POSITIVE) }
    }
}

/// Orthonormal base of the columns. A column of which the others leave less than `least` is left out: of its own length, or of that of the
/// same column of `of`.
#[must_use]
pub fn orthonormal(columns: &DMatrix<f64>, of: Option<&DMatrix<f64>>, least: f64) -> DMatrix<f64> {
    let mut base = Vec::new();
    extend(&mut base, columns, of, least);
    joined(&base, columns.nrows())
}

/// A column of norm one. Most columns of a model act on one component of the readings: two thirds of their rows are zero and cost nothing.
struct Unit {
    values: DVector<f64>,
    /// Rows outside of which it is zero.
    rows: Range<usize>,
}

impl Unit {
    fn new(values: DVector<f64>) -> Self {
        let rows = extent(values.as_slice());
        Self { values, rows }
    }

    /// Whether it shares rows with something that is zero outside of these.
    fn meets(&self, rows: &Range<usize>) -> bool {
        self.rows.start < rows.end && rows.start < self.rows.end
    }

    fn values(&self) -> &[f64] {
        &self.values.as_slice()[self.rows.clone()]
    }

    /// Scalar product with another column.
    fn along(&self, column: &[f64]) -> f64 {
        let other = DVectorView::from_slice(&column[self.rows.clone()], self.rows.len());
        DVectorView::from_slice(self.values(), self.rows.len()).dot(&other)
    }

    /// Takes a multiple of it off another column.
    fn take_off(&self, along: f64, column: &mut [f64]) {
        column[self.rows.clone()].iter_mut().zip(self.values()).for_each(|(rest, value)| *rest -= along * value);
    }
}

/// A column, copied as one block of memory: thousands of rows one by one take longer.
fn copied(column: &DVectorView<f64>) -> DVector<f64> {
    DVector::from_column_slice(column.as_slice())
}

/// Rows outside of which a column is zero.
fn extent(column: &[f64]) -> Range<usize> {
    let is_not_zero = |v: &f64| *v != 0.0;
    let begin = column.iter().position(is_not_zero).unwrap_or(0);
    begin..column.iter().rposition(is_not_zero).map_or(begin, |last| last + 1)
}

fn extend(base: &mut Vec<Unit>, columns: &DMatrix<f64>, of: Option<&DMatrix<f64>>, least: f64) {
    for (k, column) in columns.column_iter().enumerate() {
        let mut rest = copied(&column);
        let norm = of.map_or_else(|| rest.norm(), |of| of.column(k).norm());
        let mut rows = extent(rest.as_slice());
        for _ in 0..2 {
            for unit in base.iter() {
                if unit.meets(&rows) {
                    unit.take_off(unit.along(rest.as_slice()), rest.as_mut_slice());
                    rows = rows.start.min(unit.rows.start)..rows.end.max(unit.rows.end);
                }
            }
        }
        if rest.norm() > least * norm && norm > 0.0 {
            rest.normalize_mut();
            base.push(Unit::new(rest));
        }
    }
}

/// What a base leaves of a column.
fn leave(base: &[Unit], column: &mut [f64]) {
    let rows = extent(column);
    let along: Vec<(&Unit, f64)> = base.iter().filter(|unit| unit.meets(&rows)).map(|unit| (unit, unit.along(column))).collect();
    along.into_iter().for_each(|(unit, along)| unit.take_off(along, column));
}

fn joined(base: &[Unit], rows: usize) -> DMatrix<f64> {
    let mut all = DMatrix::zeros(rows, base.len());
    all.column_iter_mut().zip(base).for_each(|(mut column, unit)| column.copy_from(&unit.values));
    all
}

impl Fitted {
    /// Fits whitened readings; `edges` are the first row of each component, and the end.
    #[must_use]
    pub fn new(readings: &DVector<f64>, columns: &DMatrix<f64>, edges: [usize; 4]) -> Self {
        let mut base = Vec::new();
        extend(&mut base, columns, None, INDEPENDENT);
        Self::beside_base(readings, base, edges)
    }

    /// The same, where each component has columns of its own beside those that all have in common.
    #[must_use]
    pub fn of_components(readings: &DVector<f64>, own: &[DMatrix<f64>; 3], common: &DMatrix<f64>, edges: [usize; 4]) -> Self {
        let mut base = Vec::new();
        for (a, columns) in own.iter().enumerate() {
            for part in orthonormal(columns, None, INDEPENDENT).column_iter() {
                let mut whole = DVector::zeros(readings.len());
                whole.rows_mut(edges[a], part.len()).copy_from(&part);
                base.push(Unit::new(whole));
            }
        }
        extend(&mut base, common, None, INDEPENDENT);
        Self::beside_base(readings, base, edges)
    }

    fn beside_base(readings: &DVector<f64>, base: Vec<Unit>, edges: [usize; 4]) -> Self {
        let mut residual = readings.clone();
        for _ in 0..2 {
            leave(&base, residual.as_mut_slice());
        }
        let freedom = std::array::from_fn(|a| {
            let rows = edges[a + 1] - edges[a];
            rows as f64 - base.iter().map(|unit| unit.values.rows(edges[a], rows).norm_squared()).sum::<f64>()
        });
        Self { residual, base, edges, freedom, beside: [0.0; 3] }
    }

    /// With squares of independent noise of each component beside the residuals, and their number.
    #[must_use]
    pub fn with_noise_beside(mut self, squares_and_count: [[f64; 2]; 3]) -> Self {
        for (a, [squares, count]) in squares_and_count.into_iter().enumerate() {
            self.beside[a] += squares;
            self.freedom[a] += count;
        }
        self
    }

    /// Degrees of freedom of each component.
    #[must_use]
    pub fn freedom(&self) -> [f64; 3] {
        self.freedom
    }

    /// What the model leaves of whitened columns.
    #[must_use]
    pub fn beside(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut left = columns.clone();
        left.as_mut_slice().chunks_mut(columns.nrows().max(1)).for_each(|column| leave(&self.base, column));
        left
    }

    /// The rows of a component.
    fn part<'m>(&self, columns: &'m DMatrix<f64>, component: usize) -> DMatrixView<'m, f64> {
        columns.rows(self.edges[component], self.edges[component + 1] - self.edges[component])
    }

    /// The products of columns with each other in each component.
    fn cross(&self, base: &DMatrix<f64>) -> [DMatrix<f64>; 3] {
        std::array::from_fn(|component| self.part(base, component).tr_mul(&self.part(base, component)))
    }

    /// A group of whitened columns beside this model.
    #[must_use]
    pub fn group(&self, columns: &DMatrix<f64>) -> Group {
        let before = columns.norm();
        let left = self.beside(columns);
        let surviving = if before > 0.0 { left.norm() / before } else { 0.0 };
        let base = if surviving > 1e-7 { orthonormal(&left, None, 1e-6) } else { DMatrix::zeros(columns.nrows(), 0) };
        let cross = self.cross(&base);
        let on = std::array::from_fn(|a| self.part(columns, a).norm() > 1e-3 * before);
        Group { norms: left.column_iter().map(|c| c.norm()).collect(), base, surviving, on, cross }
    }

    /// Two groups beside this model as one; what is left of a column beside the others is not known.
    #[must_use]
    pub fn both(&self, first: &Group, second: &Group) -> Group {
        let mut units: Vec<Unit> = first.base.column_iter().map(|column| Unit::new(copied(&column))).collect();
        extend(&mut units, &second.base, None, 1e-6);
        let base = joined(&units, self.residual.len());
        let surviving = base.columns_range(first.count()..).tr_mul(&second.base).norm() / (second.count().max(1) as f64).sqrt();
        let cross = self.cross(&base);
        let on = std::array::from_fn(|a| first.on[a] || second.on[a]);
        Group { norms: [first.norms.clone(), second.norms.clone()].concat(), surviving, base, on, cross }
    }

    fn squares(&self, residual: &DVector<f64>) -> [f64; 3] {
        std::array::from_fn(|a| self.beside[a] + residual.rows(self.edges[a], self.edges[a + 1] - self.edges[a]).norm_squared())
    }

    /// Score of a group on the residuals.
    #[must_use]
    pub fn score(&self, group: &Group) -> Score {
        let along = [0, 1, 2].map(|a| {
            let rows = self.edges[a]..self.edges[a + 1];
            group.base.rows(rows.start, rows.len()).tr_mul(&self.residual.rows(rows.start, rows.len()))
        });
        self.scored(group, &along, &self.squares(&self.residual))
    }

    fn scored(&self, group: &Group, along: &[DVector<f64>; 3], squares: &[f64; 3]) -> Score {
        let count = group.base.ncols() as f64;
        if count < 1.0 {
            return Score { strength: 0.0, evidence: f64::NEG_INFINITY, chi_square: 0.0, count: 0 };
        }
        let size = &along[0] + &along[1] + &along[2];
        let (mut likelihood, mut freedom) = (0.0, 0.0);
        for a in (0..3).filter(|a| group.on[*a]) {
            let after = squares[a] - 2.0 * along[a].dot(&size) + (&group.cross[a] * &size).dot(&size);
            likelihood += self.freedom[a] * (squares[a] / after.max(1e-9 * squares[a])).ln();
            freedom += self.freedom[a];
        }
        Score::of(likelihood, freedom, group.base.ncols())
    }

    /// Largest evidences that noise alone gives among explanations: groups with their prior weights (logarithms), those of equal numbers together.
    #[must_use]
    pub fn simulate(&self, groups: &[&Group], log_priors: &[f64], explanations: &[usize], seed: u64) -> Maxima {
        let n = self.residual.len();
        let count = explanations.iter().max().map_or(0, |last| last + 1);
        let batches: Vec<usize> = (0..DRAWS / BATCH).collect();
        // Components on which a group does not act have nothing to add.
        let acts = |g: &Group, a: usize| g.cross[a].trace() > 0.0;
        let all: Vec<DMatrix<f64>> = [0, 1, 2]
            .into_par_iter()
            .map(|a| {
                let columns: usize = groups.iter().filter(|g| acts(g, a)).map(|g| g.base.ncols()).sum();
                let mut joined = DMatrix::zeros(self.edges[a + 1] - self.edges[a], columns);
                let mut at = 0;
                for group in groups.iter().filter(|g| acts(g, a)) {
                    let width = group.base.ncols();
                    joined.columns_mut(at, width).copy_from(&self.part(&group.base, a));
                    at += width;
                }
                joined.transpose()
            })
            .collect();
        let base = joined(&self.base, n);
        let base_t = base.transpose();
        let mut maxima: Vec<f64> = batches
            .par_iter()
            .flat_map_iter(|batch| {
                let mut random = Xoshiro256PlusPlus::seed_from_u64(seed.wrapping_add(*batch as u64));
                let draws = DMatrix::from_fn(n, BATCH, |_, _| -> f64 { StandardNormal.sample(&mut random) });
                let residuals = &draws - &base * (&base_t * &draws);
                let along: Vec<DMatrix<f64>> =
                    (0..3).map(|a| &all[a] * residuals.rows(self.edges[a], self.edges[a + 1] - self.edges[a])).collect();
                (0..BATCH)
                    .map(|draw| {
                        let squares = self.squares(&residuals.column(draw).into_owned());
                        let mut at = [0; 3];
                        let mut evidences = vec![0.0; count];
                        for ((group, prior), explanation) in groups.iter().zip(log_priors).zip(explanations) {
                            let width = group.base.ncols();
                            let own = [0, 1, 2].map(|a| {
                                if !acts(group, a) {
                                    return DVector::zeros(width);
                                }
                                at[a] += width;
                                along[a].view((at[a] - width, draw), (width, 1)).column(0).into_owned()
                            });
                            evidences[*explanation] += (self.scored(group, &own, &squares).evidence + prior).exp();
                        }
                        evidences.into_iter().fold(0.0, f64::max).ln()
                    })
                    .collect::<Vec<f64>>()
            })
            .collect();
        maxima.sort_by(f64::total_cmp);
        Maxima(maxima)
    }

    /// Canonical correlation of two groups: how much one can stand in for the other.
    #[must_use]
    pub fn correlation(a: &Group, b: &Group) -> f64 {
        if a.base.ncols() == 0 || b.base.ncols() == 0 {
            return 0.0;
        }
        a.base.tr_mul(&b.base).singular_values().max()
    }
}

impl Group {
    /// Components on which it acts.
    #[must_use]
    pub fn components(&self) -> [bool; 3] {
        self.on
    }

    /// Number of columns that are left.
    #[must_use]
    pub fn count(&self) -> usize {
        self.base.ncols()
    }
}

/// Largest evidences that noise alone gives, ascending. Beyond the simulated ones the tail is exponential, which it is for evidences.
pub struct Maxima(Vec<f64>);

impl Maxima {
    /// Number of the largest ones, from where on they are a tail, and how fast it falls.
    fn tail(&self) -> (usize, f64, f64) {
        let n = self.0.len();
        let tail = (n / TAIL).max(1);
        let edge = self.0[n - tail];
        let excess = self.0[n - tail..].iter().map(|m| m - edge).sum::<f64>() / tail as f64;
        // Evidences are one on average over noise: their tail falls at least as fast.
        (tail, edge, (1.0 / excess.max(1e-6)).clamp(1.0, 2.0))
    }

    /// Probability that noise alone gives at least as much.
    #[must_use]
    pub fn global_p(&self, evidence: f64) -> f64 {
        let n = self.0.len();
        let above = n - self.0.partition_point(|m| *m < evidence);
        let (tail, edge, rate) = self.tail();
        if above > tail {
            return above as f64 / n as f64;
        }
        (tail as f64 / n as f64 * (-(evidence - edge) * rate).exp()).max(f64::MIN_POSITIVE)
    }

    /// Evidence that noise alone exceeds with a probability, which is one of the tail.
    #[must_use]
    pub fn evidence_at(&self, p: f64) -> f64 {
        let (tail, edge, rate) = self.tail();
        edge + (tail as f64 / self.0.len() as f64 / p).ln() / rate
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An explanation that is told twice, each time with half of its prior, is the same explanation; two of which either will do are at least as likely
    /// as the likelier one, with the prior of each.
    #[test]
    fn candidates_of_one_explanation_count_together() {
        const RARE: f64 = 0.01;
        let readings = DVector::from_fn(90, |i, _| (1.7 * i as f64).sin());
        let fitted = Fitted::new(&readings, &DMatrix::from_element(90, 1, 1.0), [0, 30, 60, 90]);
        let group = |turns: f64| fitted.group(&DMatrix::from_fn(90, 1, |i, _| (turns * i as f64).cos()));
        let [first, second] = [group(0.3), group(0.7)];
        let [half, quarter] = [0.5_f64.ln(), 0.25_f64.ln()];
        let apart = fitted.simulate(&[&first, &second], &[half, half], &[0, 1], 1).evidence_at(RARE);
        let twice = fitted.simulate(&[&first, &first, &second], &[quarter, quarter, half], &[0, 0, 1], 1).evidence_at(RARE);
        assert!((twice - apart).abs() < 1e-9, "{twice} {apart}");
        let together = fitted.simulate(&[&first, &second], &[half, half], &[0, 0], 1).evidence_at(RARE);
        assert!(together > apart && together < apart + 2.0_f64.ln(), "{together} {apart}");
    }
}
