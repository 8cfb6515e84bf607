//! Noise of a series of means that is white, slow, or grows with the applied field, and its whitening.
//!
//! The covariance is `white_i δ_ij (1 + field u_i²) + slow C_ij + slow_field u_i u_j C_ij`, all times a variance per component, with `C` that
//! of noise with a power density `f^-a`, and `u` the size of the field relative to the largest. Shares and exponent are those of the largest
//! restricted likelihood (REML), common to all components; the variance is that of each component.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use serde::Serialize;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Slow noise that is tried: exponent of the power density, and the time after which it forgets, in rows; 0 where it never does.
const SHAPES: [(f64, f64); 7] = [(0.5, 0.0), (1.0, 0.0), (1.5, 0.0), (2.0, 0.0), (2.0, 1.5), (2.0, 4.0), (2.0, 12.0)];
/// Ratios of slow to white variance of one mean that are tried first.
const RATIOS: [f64; 8] = [0.0, 0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 300.0];
/// Ratios of the variances that grow with the field, at the largest field, to the white variance.
const FIELD_RATIOS: [f64; 5] = [0.3, 1.0, 3.0, 10.0, 30.0];
/// Noise that grows with the field is rare: logarithms of its prior, for white and for slow noise.
const RARE: [f64; 2] = [1.5, 3.0];
/// Waves that make up the slow noise, per factor of two in frequency.
const WAVES_PER_OCTAVE: f64 = 3.0;
/// Longest period of the slow noise, in lengths of the series.
const LONGEST: f64 = 4.0;
/// Rows up to which the whitening is exact.
const EXACT: usize = 256;
/// Rows before a row on which it is conditioned in a longer series: the nearest, and others further and further away.
const NEAR: usize = 8;

/// What is known of the rows of a component before the noise is.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    /// Middle of each row, s; ascending.
    pub t_s: Vec<f64>,
    /// White variance of each row relative to the others.
    pub white: Vec<f64>,
    /// Applied field of each component relative to the largest, -1 to 1.
    pub field: Vec<[f64; 3]>,
}

/// Shares and exponent of the noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Colour {
    /// Exponent `a` of the power density `f^-a` of the slow noise.
    pub exponent: f64,
    /// Rows after which the slow noise is forgotten; 0 where it never is.
    pub memory_rows: f64,
    /// Variance of the slow noise over that of the white noise of one mean.
    pub slow: f64,
    /// White variance at the largest field over that without field.
    pub white_field: f64,
    /// Variance of slow noise of the gain, at the largest field, over the white variance.
    pub slow_field: f64,
}

impl Colour {
    fn shape(&self) -> usize {
        SHAPES.iter().position(|s| *s == (self.exponent, self.memory_rows)).unwrap_or(0)
    }

    fn with_shape(self, (exponent, memory_rows): (f64, f64)) -> Self {
        Colour { exponent, memory_rows, ..self }
    }

    /// Logarithm of the prior.
    fn prior(&self) -> f64 {
        let of = |share: f64, prior: f64| if share > 0.0 { -prior } else { 0.0 };
        of(self.white_field, RARE[0]) + of(self.slow_field, RARE[1])
    }

    /// White noise.
    pub const WHITE: Colour = Colour { exponent: 1.0, memory_rows: 0.0, slow: 0.0, white_field: 0.0, slow_field: 0.0 };
}

/// Correlations of slow noise between all rows, one matrix per exponent: they depend on the times only.
pub struct Correlations {
    rows: Rows,
    slow: Vec<DMatrix<f64>>,
}

/// A row conditioned on others: which, their coefficients, and the inverse of what remains.
type Conditioned = (Vec<usize>, Vec<f64>, f64);

/// The whitening of one component.
#[derive(Clone)]
enum Whitener {
    Exact(Arc<Cholesky<f64, Dyn>>),
    Sparse(Arc<Vec<Conditioned>>),
}

/// Noise of all three components.
#[derive(Clone)]
pub struct Noise {
    /// Shares and exponent.
    pub colour: Colour,
    /// Standard deviation of the white part of a row of relative variance one, per component.
    pub white_std: [f64; 3],
    whiteners: Vec<Whitener>,
    rows: usize,
}

impl Correlations {
    /// Of rows at these times.
    #[must_use]
    pub fn new(rows: Rows) -> Self {
        let n = rows.t_s.len();
        let span = (rows.t_s[n - 1] - rows.t_s[0]).max(f64::MIN_POSITIVE);
        let mut gaps: Vec<f64> = rows.t_s.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        let gap = gaps.get(gaps.len() / 2).copied().unwrap_or(span).max(span * 1e-9);
        let (lowest, highest) = (1.0 / (LONGEST * span), 0.5 / gap);
        let waves = ((highest / lowest).log2() * WAVES_PER_OCTAVE).ceil().max(2.0);
        let frequencies: Vec<f64> = (0..=waves as usize).map(|i| lowest * (highest / lowest).powf(i as f64 / waves)).collect();
        // A mean over the gap smooths the fastest of them.
        let slow = SHAPES
            .iter()
            .map(|(a, memory)| {
                if *memory > 0.0 {
                    let of = |i: usize, j: usize| (-(rows.t_s[i] - rows.t_s[j]).abs() / (memory * gap)).exp();
                    return DMatrix::from_fn(n, n, of);
                }
                let weights: Vec<f64> = frequencies
                    .iter()
                    .map(|f| {
                        let x = 0.5 * TAU * f * gap;
                        f.powf(1.0 - a) * (x.sin() / x).powi(2)
                    })
                    .collect();
                let sum: f64 = weights.iter().sum();
                // Cosines of sums come from sines and cosines of the rows: n k in place of n² k evaluations.
                let waves: Vec<DVector<f64>> = frequencies
                    .iter()
                    .zip(&weights)
                    .flat_map(|(f, w)| {
                        let size = (w / sum).sqrt();
                        let of = |part: fn(f64) -> f64| DVector::from_fn(n, |i, _| size * part(TAU * f * rows.t_s[i]));
                        [of(f64::sin), of(f64::cos)]
                    })
                    .collect();
                let basis = DMatrix::from_columns(&waves);
                &basis * basis.transpose()
            })
            .collect();
        Self { rows, slow }
    }

    fn element(&self, colour: &Colour, slow: &DMatrix<f64>, component: usize, i: usize, j: usize) -> f64 {
        let (u, v) = (self.rows.field[i][component], self.rows.field[j][component]);
        let correlated = (colour.slow + colour.slow_field * u * v) * slow[(i, j)];
        if i == j { correlated + self.rows.white[i] * (1.0 + colour.white_field * u * u) } else { correlated }
    }

    fn whitener(&self, colour: &Colour, component: usize) -> Option<Whitener> {
        let slow = &self.slow[colour.shape()];
        let n = self.rows.t_s.len();
        let element = |i: usize, j: usize| self.element(colour, slow, component, i, j);
        if n <= EXACT {
            return DMatrix::from_fn(n, n, element).cholesky().map(|c| Whitener::Exact(Arc::new(c)));
        }
        let mut rows = Vec::with_capacity(n);
        for i in 0..n {
            let near = i.saturating_sub(NEAR)..i;
            let mut others: Vec<usize> = Vec::new();
            let mut back = 2 * NEAR;
            while colour.slow + colour.slow_field > 0.0 && back <= i {
                others.push(i - back);
                back *= 2;
            }
            others.reverse();
            others.extend(if colour.slow + colour.slow_field > 0.0 { near } else { i..i });
            let among = DMatrix::from_fn(others.len(), others.len(), |a, b| element(others[a], others[b]));
            let with = DVector::from_fn(others.len(), |a, _| element(i, others[a]));
            let coefficients = if others.is_empty() { with.clone() } else { among.cholesky()?.solve(&with) };
            let left = element(i, i) - coefficients.dot(&with);
            if left <= 0.0 {
                return None;
            }
            rows.push((others, coefficients.as_slice().to_vec(), left.sqrt().recip()));
        }
        Some(Whitener::Sparse(Arc::new(rows)))
    }

    /// Log likelihood of a colour up to a constant, restricted or not, with the white standard deviation of each component; `None` where
    /// it has none.
    fn likelihood(&self, colour: &Colour, data: &Data, restricted: bool) -> Option<(f64, [f64; 3], Vec<Whitener>)> {
        let mut sum = 0.0;
        let mut std = [0.0; 3];
        let mut whiteners = Vec::with_capacity(3);
        for component in 0..3 {
            // Without a share that grows with the field all components have the same covariance.
            let whitener = match whiteners.last() {
                Some(same) if colour.white_field + colour.slow_field == 0.0 => Whitener::clone(same),
                _ => self.whitener(colour, component)?,
            };
            let left = fit(&whitener, &data.readings.column(component).into_owned(), &data.designs[component])?;
            sum -= 0.5
                * if restricted {
                    left.freedom * left.squares.ln() + left.log_covariance + left.log_normal
                } else {
                    data.readings.nrows() as f64 * left.squares.ln() + left.log_covariance
                };
            std[component] = (left.squares / left.freedom).sqrt();
            whiteners.push(whitener);
        }
        sum.is_finite().then_some((sum, std, whiteners))
    }

    /// Log likelihood of readings with the most likely noise near that of `from`, or without its slow part: how well a model does with a
    /// noise of its own. It compares models of different columns.
    #[must_use]
    pub fn profile(&self, from: &Colour, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> f64 {
        let data = Data { readings, designs };
        let value =
            |colour: &Colour| self.likelihood(colour, &data, false).map_or(f64::NEG_INFINITY, |(l, _, _)| l + colour.prior());
        let mut best = (value(from), *from);
        let consider = |colour: Colour, best: &mut (f64, Colour)| {
            let likelihood = value(&colour);
            if likelihood > best.0 {
                *best = (likelihood, colour);
            }
        };
        consider(Colour::WHITE, &mut best);
        for factor in [0.03, 0.1, 0.3] {
            consider(Colour { slow: from.slow * factor, slow_field: from.slow_field * factor, ..*from }, &mut best);
        }
        for colour in [
            Colour { slow_field: 0.0, ..*from },
            Colour { white_field: 0.0, ..*from },
            Colour { exponent: 1.0, memory_rows: 0.0, slow: from.slow.min(1.0), slow_field: 0.0, ..*from },
        ] {
            if colour != *from {
                consider(colour, &mut best);
            }
        }
        for factor in [0.55, 1.8, 0.75, 1.35] {
            let now = best.1;
            for colour in [
                Colour { slow: now.slow * factor, ..now },
                Colour { white_field: now.white_field * factor, ..now },
                Colour { slow_field: now.slow_field * factor, ..now },
            ] {
                if colour != now {
                    consider(colour, &mut best);
                }
            }
        }
        best.0
    }

    /// Noise of a given colour, its variances from residuals about a linear model.
    #[must_use]
    pub fn with_colour(&self, colour: Colour, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> Option<Noise> {
        let (_, white_std, whiteners) = self.likelihood(&colour, &Data { readings, designs }, true)?;
        Some(Noise { colour, white_std, whiteners, rows: self.rows.t_s.len() })
    }

    /// The most likely noise of residuals about a linear model: `readings` has a column per component, `designs` the columns that were
    /// fitted to each.
    #[must_use]
    pub fn estimate(&self, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> Option<Noise> {
        let data = Data { readings, designs };
        let value =
            |colour: &Colour| self.likelihood(colour, &data, true).map_or(f64::NEG_INFINITY, |(l, _, _)| l + colour.prior());
        let mut best = (value(&Colour::WHITE), Colour::WHITE);
        let consider = |colour: Colour, best: &mut (f64, Colour)| {
            let likelihood = value(&colour);
            if likelihood > best.0 {
                *best = (likelihood, colour);
            }
        };
        for slow in &RATIOS[1..] {
            for shape in SHAPES {
                consider(Colour { slow: *slow, ..Colour::WHITE }.with_shape(shape), &mut best);
            }
        }
        // What grows with the field, beside what does not or in its place.
        let base = best.1;
        for ratio in FIELD_RATIOS {
            for slow in [base.slow, 0.0] {
                consider(Colour { white_field: ratio, slow, ..base }, &mut best);
                let own = [(base.exponent, base.memory_rows)];
                let shapes = if slow > 0.0 { &own[..] } else { &[(0.5, 0.0), (1.0, 0.0), (2.0, 0.0), (2.0, 4.0)] };
                for shape in shapes {
                    consider(Colour { slow_field: ratio, slow, ..base }.with_shape(*shape), &mut best);
                }
            }
        }
        // Closer, one share after the other.
        let mut factor: f64 = 1.8;
        for _ in 0..3 {
            for f in [factor, 1.0 / factor] {
                let now = best.1;
                consider(Colour { slow: now.slow * f, ..now }, &mut best);
                let now = best.1;
                consider(Colour { white_field: now.white_field * f, ..now }, &mut best);
                let now = best.1;
                consider(Colour { slow_field: now.slow_field * f, ..now }, &mut best);
            }
            factor = factor.sqrt();
        }
        for shape in SHAPES {
            let now = best.1;
            consider(now.with_shape(shape), &mut best);
        }
        let (_, white_std, whiteners) = self.likelihood(&best.1, &data, true)?;
        Some(Noise { colour: best.1, white_std, whiteners, rows: self.rows.t_s.len() })
    }

    /// Standard deviation of every row, per component.
    #[must_use]
    pub fn std(&self, noise: &Noise) -> Vec<[f64; 3]> {
        let slow = &self.slow[noise.colour.shape()];
        let one = |i: usize, a: usize| noise.white_std[a] * self.element(&noise.colour, slow, a, i, i).sqrt();
        (0..self.rows.t_s.len()).map(|i| std::array::from_fn(|a| one(i, a))).collect()
    }

    /// Covariance of some rows of a component.
    #[must_use]
    pub fn covariance(&self, noise: &Noise, component: usize, rows: &[usize]) -> DMatrix<f64> {
        let slow = &self.slow[noise.colour.shape()];
        let variance = noise.white_std[component].powi(2);
        DMatrix::from_fn(rows.len(), rows.len(), |a, b| variance * self.element(&noise.colour, slow, component, rows[a], rows[b]))
    }
}

impl Noise {
    /// Number of rows of a component.
    #[must_use]
    pub fn rows(&self) -> usize {
        self.rows
    }

    /// Whitens the columns of a component in place: independent values of variance one.
    pub fn whiten(&self, component: usize, columns: &mut DMatrix<f64>) {
        whiten(&self.whiteners[component], columns);
        *columns /= self.white_std[component];
    }
}

fn whiten(whitener: &Whitener, columns: &mut DMatrix<f64>) {
    match whitener {
        Whitener::Exact(cholesky) => {
            cholesky.l_dirty().solve_lower_triangular_mut(columns);
        }
        Whitener::Sparse(rows) => {
            for mut column in columns.column_iter_mut() {
                for i in (0..rows.len()).rev() {
                    let (others, coefficients, scale) = &rows[i];
                    let expected: f64 = others.iter().zip(coefficients).map(|(j, c)| c * column[*j]).sum();
                    column[i] = (column[i] - expected) * scale;
                }
            }
        }
    }
}

/// Readings, and the columns that are fitted to each component.
struct Data<'a> {
    readings: &'a DMatrix<f64>,
    designs: &'a [DMatrix<f64>; 3],
}

/// What a whitened fit leaves.
struct Left {
    squares: f64,
    /// Logarithms of the determinants of covariance and normal matrix.
    log_covariance: f64,
    log_normal: f64,
    freedom: f64,
}

fn fit(whitener: &Whitener, reading: &DVector<f64>, design: &DMatrix<f64>) -> Option<Left> {
    let (n, p) = design.shape();
    let mut all = DMatrix::zeros(n, p + 1);
    all.columns_mut(0, p).copy_from(design);
    all.column_mut(p).copy_from(reading);
    whiten(whitener, &mut all);
    let log_covariance = match whitener {
        Whitener::Exact(cholesky) => 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>(),
        Whitener::Sparse(rows) => -2.0 * rows.iter().map(|(_, _, scale)| scale.ln()).sum::<f64>(),
    };
    let normal = all.columns(0, p).tr_mul(&all.columns(0, p));
    let cholesky = normal.cholesky()?;
    let rhs = all.columns(0, p).tr_mul(&all.column(p));
    let squares = all.column(p).norm_squared() - rhs.dot(&cholesky.solve(&rhs));
    let log_normal = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
    let freedom = n.checked_sub(p).filter(|f| *f > 1)? as f64;
    (squares > 0.0).then_some(Left { squares, log_covariance, log_normal, freedom })
}
