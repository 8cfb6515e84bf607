//! Residuals on what a design cannot explain, and their restricted likelihood for white and slow noise.
//!
//! Few rows: one reduction of the slow covariance to tridiagonal form, at a cost of the cube of the rows, makes every likelihood after it a
//! pass over them. Many rows: the likelihood is calculated at ratios of slow to white noise in equal steps of their logarithm, each at a cost in
//! proportion to the rows ([`Relaxations::whiten`]), and interpolated between them; it changes over a decade of the ratio.

use super::Fitted;
use super::likelihood::Likelihood;
use super::relaxations::Relaxations;
use nalgebra::linalg::{QR, SymmetricTridiagonal};
use nalgebra::{DMatrix, DVector, Dyn};
use std::cell::RefCell;
use std::collections::BTreeMap;

/// Most rows for which the tridiagonal form costs less.
const FEW_ROWS: usize = 400;
/// Ratios of slow to white noise per factor of e, and how many of them an interpolation uses.
const STEPS: f64 = 4.0;
const NODES: i32 = 6;

/// White noise of a given spread between the rows and slow noise, as they act on what the design cannot explain.
pub(super) struct Projected {
    form: Form,
    /// What the deviance has besides that of these coordinates: logarithms of the determinants of the spread and of the normal matrix.
    pub log_scale: f64,
}

enum Form {
    /// Coordinates in which white noise is white and slow noise tridiagonal.
    Tridiagonal {
        diagonal: DVector<f64>,
        off_diagonal: DVector<f64>,
        data: DMatrix<f64>,
    },
    Series(Series),
}

impl Projected {
    pub fn of(fitted: &Fitted, spread: &DVector<f64>, slow: &Relaxations) -> Self {
        Self::with(fitted, spread, slow, fitted.columns.nrows() <= FEW_ROWS)
    }

    /// White noise alone, whose likelihood has no slow one: one pass over the rows.
    pub fn white(fitted: &Fitted, spread: &DVector<f64>) -> Self {
        let (n, p) = fitted.columns.shape();
        let White { factors, unexplained: mut data, log_scale, .. } = White::of(fitted, spread);
        factors.q_tr_mul(&mut data);
        let data = data.rows(p, n - p).into_owned();
        let form = Form::Tridiagonal { diagonal: DVector::zeros(n - p), off_diagonal: DVector::zeros(n - p), data };
        Self { form, log_scale }
    }

    pub(super) fn with(fitted: &Fitted, spread: &DVector<f64>, slow: &Relaxations, few: bool) -> Self {
        let (n, p) = fitted.columns.shape();
        let White { roots, factors, unexplained, log_scale } = White::of(fitted, spread);
        let slow = slow.scaled(|row| roots[row]);
        if !few {
            let form = Form::Series(Series::new(slow, &factors.q(), &unexplained));
            return Self { form, log_scale };
        }
        // Qᵀ F Q: its lower right corner acts on what the design cannot explain.
        let mut rotated = slow.dense();
        factors.q_tr_mul(&mut rotated);
        rotated.transpose_mut();
        factors.q_tr_mul(&mut rotated);
        let mut data = unexplained;
        factors.q_tr_mul(&mut data);
        let (q, diagonal, off_diagonal) = SymmetricTridiagonal::new(rotated.view((p, p), (n - p, n - p)).into_owned()).unpack();
        Self { form: Form::Tridiagonal { diagonal, off_diagonal, data: q.tr_mul(&data.rows(p, n - p)) }, log_scale }
    }

    /// The likelihood of one right-hand side.
    pub fn likelihood(&self, a: usize) -> Likelihood<'_> {
        match &self.form {
            Form::Tridiagonal { diagonal, off_diagonal, data } => {
                let n = data.nrows();
                Likelihood::Tridiagonal {
                    diagonal: diagonal.as_slice(),
                    off_diagonal: off_diagonal.as_slice(),
                    data: &data.as_slice()[a * n..(a + 1) * n],
                }
            }
            Form::Series(series) => Likelihood::Series { series, component: a },
        }
    }
}

/// Design and residuals in rows of unit white variance.
struct White {
    /// Factors on the rows.
    roots: DVector<f64>,
    factors: QR<f64, Dyn, Dyn>,
    unexplained: DMatrix<f64>,
    log_scale: f64,
}

impl White {
    fn of(fitted: &Fitted, spread: &DVector<f64>) -> Self {
        let roots = spread.map(|s| s.sqrt().recip());
        let scaled = |matrix: &DMatrix<f64>| {
            let mut scaled = matrix.clone();
            for (mut row, root) in scaled.row_iter_mut().zip(&roots) {
                row *= *root;
            }
            scaled
        };
        let factors = scaled(&fitted.columns).qr();
        let normal: f64 = factors.r().diagonal().iter().map(|d| d.abs().ln()).sum();
        let log_scale = spread.iter().map(|s| s.ln()).sum::<f64>() + 2.0 * normal;
        Self { unexplained: scaled(&fitted.residuals), roots, factors, log_scale }
    }
}

/// Many rows in the order of time.
pub(super) struct Series {
    slow: Relaxations,
    /// An orthonormal basis of the design, p columns, and the residuals beside it.
    columns: DMatrix<f64>,
    explained: usize,
    /// Right-hand sides whose residuals are all zero.
    silent: Vec<bool>,
    /// What was calculated, by the logarithm of the ratio of slow to white noise in steps.
    nodes: RefCell<BTreeMap<i32, Vec<[f64; 2]>>>,
}

impl Series {
    fn new(slow: Relaxations, basis: &DMatrix<f64>, residuals: &DMatrix<f64>) -> Self {
        let (n, p, m) = (basis.nrows(), basis.ncols(), residuals.ncols());
        let columns = DMatrix::from_fn(n, p + m, |i, j| if j < p { basis[(i, j)] } else { residuals[(i, j - p)] });
        let silent = residuals.column_iter().map(|column| column.iter().all(|v| *v == 0.0)).collect();
        Self { slow, columns, explained: p, silent, nodes: RefCell::default() }
    }

    /// Degrees of freedom of the residuals.
    pub fn freedom(&self) -> usize {
        self.columns.nrows() - self.explained
    }

    /// Whether a right-hand side has no residuals.
    pub fn is_silent(&self, component: usize) -> bool {
        self.silent[component]
    }

    /// Logarithm of the determinant of `white I + slow F` on what the design cannot explain, and the residuals through its inverse.
    pub fn reduce(&self, component: usize, white: f64, slow: f64) -> (f64, f64) {
        if slow == 0.0 {
            let [log_determinant, squares] = self.calculate(1.0, 0.0)[component];
            return (log_determinant + self.freedom() as f64 * white.ln(), squares.exp() / white);
        }
        let x = STEPS * (slow / white).ln();
        let first = x.floor() as i32 - (NODES / 2 - 1);
        let (mut log_determinant, mut squares) = (0.0, 0.0);
        for i in first..first + NODES {
            let others = (first..first + NODES).filter(|j| *j != i);
            let weight: f64 = others.map(|j| (x - f64::from(j)) / f64::from(i - j)).product();
            let [l, s] = self.node(i, component);
            log_determinant += weight * l;
            squares += weight * s;
        }
        let sum = white + slow;
        (log_determinant + self.freedom() as f64 * sum.ln(), squares.exp() / sum)
    }

    fn node(&self, at: i32, component: usize) -> [f64; 2] {
        if let Some(found) = self.nodes.borrow().get(&at) {
            return found[component];
        }
        let ratio = (f64::from(at) / STEPS).exp();
        let calculated = self.calculate(1.0 / (1.0 + ratio), ratio / (1.0 + ratio));
        let own = calculated[component];
        self.nodes.borrow_mut().insert(at, calculated);
        own
    }

    /// Logarithms of the determinant and of the squares of every right-hand side.
    fn calculate(&self, white: f64, slow: f64) -> Vec<[f64; 2]> {
        let (p, all) = (self.explained, self.columns.ncols());
        let impossible = || vec![[f64::INFINITY, 0.0]; all - p];
        let Some((columns, log_determinant)) = self.slow.whiten(white, slow, &self.columns) else { return impossible() };
        let products = columns.tr_mul(&columns);
        let Some(normal) = products.view((0, 0), (p, p)).into_owned().cholesky() else { return impossible() };
        let log_normal = 2.0 * normal.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
        let of = |a: usize| {
            let crossed = products.view((0, a), (p, 1)).into_owned();
            let explained = crossed.dot(&normal.solve(&crossed));
            [log_determinant + log_normal, (products[(a, a)] - explained).max(f64::MIN_POSITIVE).ln()]
        };
        (p..all).map(of).collect()
    }
}
