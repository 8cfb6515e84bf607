//! Whether the residuals of a fit depend on something: one pass over a few squares, cubes and trends, to say that a diagnosis is worth
//! while. It names no effect and changes no value.
//!
//! Every trial column is freed of the columns of the fit; its product with the residuals is compared with what the noise of the fit,
//! white and slow, lets expect of it.

use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::run::interpolate;
use crate::data::units::COMPONENTS;
use crate::fit::DenseNoise;
use crate::fit::statistics::student_tail;
use nalgebra::{DMatrix, DVector};
use std::collections::HashMap;

/// Probability that noise alone is as large for the largest of all trials.
const SIGNIFICANT: f64 = 1e-3;
/// A trial column of which less than this part is left beside the fit says nothing.
const LEFT: f64 = 0.02;
/// Fewer degrees of freedom than these tell no dependence from noise.
const LEAST_FREEDOM: usize = 12;

/// What is known of the rows of a fit.
pub(super) struct Rows<'a> {
    /// Begin and end, s since the run's start.
    pub used_s: Vec<[f64; 2]>,
    /// Mean readings, enT: a row per row, a column per component.
    pub readings_ent: DMatrix<f64>,
    /// Applied fields of the rows before, nT.
    pub previous_nt: Vec<[f64; 3]>,
    /// Sensor temperature, °C, if it moves.
    pub degc: Option<Vec<f64>>,
    /// The columns of the fit.
    pub columns: &'a DMatrix<f64>,
    /// Noise of the fit.
    pub noise: &'a DenseNoise,
}

impl<'a> Rows<'a> {
    /// Of plateaus that were used, among all of `list`; `sensor` is the record of the sensor temperature, (s, °C).
    pub fn of(
        list: &[Plateau],
        used: &[&Plateau],
        sensor: &[(f64, f64)],
        columns: &'a DMatrix<f64>,
        noise: &'a DenseNoise,
    ) -> Self {
        let places: HashMap<usize, usize> = list.iter().enumerate().map(|(place, p)| (p.index, place)).collect();
        let before = |p: &&Plateau| {
            let place = places.get(&p.index).and_then(|i| i.checked_sub(1));
            place.map_or([0.0; 3], |i| list[i].setting.field.0)
        };
        Rows {
            used_s: used.iter().map(|p| p.used_s).collect(),
            readings_ent: DMatrix::from_fn(used.len(), 3, |i, a| used[i].mean.0[a]),
            previous_nt: used.iter().map(before).collect(),
            degc: (sensor.len() > 1).then(|| used.iter().map(|p| interpolate(sensor, p.t_s())).collect()),
            columns,
            noise,
        }
    }
}

/// The note about residuals that depend on something, naming the dependence with the least probability of being noise.
pub(super) fn note(rows: &Rows) -> Option<Note> {
    let n = rows.readings_ent.nrows();
    let freedom = n.checked_sub(rows.columns.ncols() + 1).filter(|f| *f >= LEAST_FREEDOM)?;
    let norms: Vec<f64> = rows.columns.column_iter().map(|column| column.norm()).collect();
    let scaled =
        DMatrix::from_fn(n, rows.columns.ncols(), |i, j| if norms[j] > 0.0 { rows.columns[(i, j)] / norms[j] } else { 0.0 });
    let base = scaled.qr().q();
    let free = |mut column: DVector<f64>| {
        // Twice: readings are four orders larger than what is left of them.
        for _ in 0..2 {
            column -= &base * base.tr_mul(&column);
        }
        column
    };
    let middle = |u: &[f64; 2]| 0.5 * (u[0] + u[1]);
    let (begin, end) = (middle(rows.used_s.first()?), middle(rows.used_s.last()?));
    let tau = |i: usize| if end > begin { 2.0 * (middle(&rows.used_s[i]) - begin) / (end - begin) - 1.0 } else { 0.0 };
    let x = |i: usize, a: usize| rows.readings_ent[(i, a)];
    let moves = rows.degc.as_ref().filter(|degc| degc.iter().all(|v| v.is_finite()));

    let mut trials = 0usize;
    let mut best: Option<(f64, &str, usize)> = None;
    for a in 0..3 {
        let (b, c) = ((a + 1) % 3, (a + 2) % 3);
        let residual = free(rows.readings_ent.column(a).into_owned());
        let noise = rows.noise.without_growth(a);
        let mut attempt = |what: &'static str, value: &dyn Fn(usize) -> f64| {
            let raw = DVector::from_fn(n, |i, _| value(i));
            let before = raw.add_scalar(-raw.mean()).norm();
            let column = free(raw);
            let size = column.norm();
            if size.is_nan() || size <= LEFT * before || size == 0.0 {
                return;
            }
            trials += 1;
            let column = column / size;
            let score = column.dot(&residual).abs() / noise.variance_of(&column).sqrt();
            if score.is_finite() && best.is_none_or(|(most, ..)| score > most) {
                best = Some((score, what, a));
            }
        };
        attempt("the reading of the axis", &|i| x(i, a).powi(2));
        attempt("the reading of the axis", &|i| x(i, a).powi(3));
        attempt("the field across the axis", &|i| x(i, b).powi(2));
        attempt("the field across the axis", &|i| x(i, c).powi(2));
        attempt("the field across the axis", &|i| x(i, a) * x(i, b).powi(2));
        attempt("the field across the axis", &|i| x(i, a) * x(i, c).powi(2));
        for k in 0..3 {
            attempt("the previous field", &|i| rows.previous_nt[i][k]);
        }
        attempt("the time", &|i| tau(i).powi(3));
        attempt("the time", &|i| tau(i) * x(i, a));
        if let Some(degc) = moves {
            attempt("the sensor temperature", &|i| degc[i]);
            attempt("the sensor temperature", &|i| (degc[i] - degc[0]) * x(i, a));
        }
    }
    let (score, what, axis) = best?;
    let p = 2.0 * student_tail(score, freedom)? * trials as f64;
    (p < SIGNIFICANT).then(|| {
        let name = COMPONENTS[axis];
        let text = format!("the residuals of {name} depend on {what} ({score:.1} standard deviations): run calfit diagnose");
        Note::new(NoteKind::Fit, text).about(name)
    })
}
