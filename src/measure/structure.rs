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
use crate::fit::noise::dense::EvenNoise;
use crate::fit::statistics::{median, student_tail};
use nalgebra::{DMatrix, DVector, DVectorView};
use std::collections::HashMap;

/// A setting whose residual is so many robust standard deviations from the others stands out.
pub(super) const OUTLIER: f64 = 8.0;
/// Probability that noise alone is as large for the largest of all trials.
const SIGNIFICANT: f64 = 1e-3;
/// A trial column of which less than this part is left beside the fit says nothing.
const LEFT: f64 = 0.02;
/// Fewer degrees of freedom than these tell no dependence from noise.
const LEAST_FREEDOM: usize = 12;

/// What all axes do alike stands out of the noise of the fit by so many standard deviations at least.
const BESIDE_NOISE: f64 = 3.0;
/// Time constants of what may follow the steps of the field, over the usual duration of a row.
const FOLLOWS: [f64; 5] = [0.5, 1.5, 5.0, 15.0, 50.0];

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

impl Rows<'_> {
    /// Middles of the rows, from -1 to 1.
    fn mapped_times(&self) -> DVector<f64> {
        let middle = |i: usize| 0.5 * (self.used_s[i][0] + self.used_s[i][1]);
        let n = self.used_s.len();
        let (begin, end) = (middle(0), middle(n - 1));
        DVector::from_fn(n, |i, _| if end > begin { 2.0 * (middle(i) - begin) / (end - begin) - 1.0 } else { 0.0 })
    }
}

/// Means over the rows of what a component still shows of all steps of its readings before, with a time constant in s.
fn follows(rows: &Rows, component: usize, tau_s: f64) -> Vec<f64> {
    let reading = |i: usize| rows.readings_ent[(i, component)];
    let mut shown = 0.0;
    (0..rows.used_s.len())
        .map(|i| {
            let [begin, end] = rows.used_s[i];
            if let Some(before) = i.checked_sub(1) {
                shown = shown * (-(begin - rows.used_s[before][0]) / tau_s).exp() + reading(i) - reading(before);
            }
            let lasts = (end - begin) / tau_s;
            if lasts > 0.0 { shown * -(-lasts).exp_m1() / lasts } else { shown }
        })
        .collect()
}

/// What a fit leaves of the readings of every component, and the noise that it has.
pub(super) struct Beside<'a> {
    base: DMatrix<f64>,
    /// Residuals, enT, and their noise, per component.
    components: Vec<(DVector<f64>, EvenNoise<'a>)>,
}

impl<'a> Beside<'a> {
    /// Of readings, a row per row and a column per component, and the columns that were fitted to each of them.
    pub fn of(columns: &DMatrix<f64>, readings_ent: &DMatrix<f64>, noise: &'a DenseNoise) -> Self {
        let norms: Vec<f64> = columns.column_iter().map(|column| column.norm()).collect();
        let scale = |i: usize, j: usize| if norms[j] > 0.0 { columns[(i, j)] / norms[j] } else { 0.0 };
        let base = DMatrix::from_fn(columns.nrows(), columns.ncols(), scale).qr().q();
        let mut beside = Self { base, components: Vec::new() };
        let left = |(a, readings): (usize, DVectorView<f64>)| (beside.free(readings.into_owned()), noise.without_growth(a));
        beside.components = readings_ent.column_iter().enumerate().map(left).collect();
        beside
    }

    /// What a column has beside those of the fit.
    fn free(&self, mut column: DVector<f64>) -> DVector<f64> {
        // Twice: readings are four orders larger than what is left of them.
        for _ in 0..2 {
            column -= &self.base * self.base.tr_mul(&column);
        }
        column
    }

    /// The residuals of a component along a trial column; none along one that says nothing.
    fn along(&self, component: usize, raw: DVector<f64>) -> Option<Along> {
        let before = raw.add_scalar(-raw.mean()).norm();
        let column = self.free(raw);
        let squares = column.norm_squared();
        if squares.is_nan() || squares <= (LEFT * before).powi(2) || squares == 0.0 {
            return None;
        }
        let (residual, noise) = &self.components[component];
        Some(Along {
            product: column.dot(residual),
            variance: noise.variance_of(&column),
            squares,
            residual: residual.norm_squared(),
            column,
        })
    }

    /// Part of the squares of the residuals of a component that each trial column explains; NaN for a column that says nothing.
    pub fn explained(&self, component: usize, trials: impl IntoIterator<Item = DVector<f64>>) -> Vec<f64> {
        let part =
            |raw| self.along(component, raw).map_or(f64::NAN, |along| along.product.powi(2) / along.squares / along.residual);
        trials.into_iter().map(part).collect()
    }

    /// How many standard deviations of the noise the residuals of a component have along trial columns; none for a column that says nothing.
    fn scores(&self, component: usize, trials: impl IntoIterator<Item = DVector<f64>>) -> Vec<Option<f64>> {
        let score = |raw| self.along(component, raw).map(|along| along.product.abs() / along.variance.sqrt());
        trials.into_iter().map(|raw| score(raw).filter(|score: &f64| score.is_finite())).collect()
    }
}

/// Residuals along a trial column beside the fit.
struct Along {
    /// Product of both, and its variance by the noise of the fit.
    product: f64,
    variance: f64,
    /// Squares of the column, and of the residuals.
    squares: f64,
    residual: f64,
    /// The column, beside the fit.
    column: DVector<f64>,
}

/// Whether noise makes the largest of so many scores seldom.
pub(super) fn is_no_noise(score: f64, freedom: usize, trials: usize) -> bool {
    freedom >= LEAST_FREEDOM && is_seldom(score, freedom, trials)
}

/// The same of however few degrees of freedom.
fn is_seldom(score: f64, freedom: usize, trials: usize) -> bool {
    student_tail(score, freedom).is_some_and(|tail| 2.0 * tail * (trials as f64) < SIGNIFICANT)
}

/// Notes about residuals that depend on something.
pub(super) fn notes(rows: &Rows) -> Vec<Note> {
    let freedom = rows.readings_ent.nrows().saturating_sub(rows.columns.ncols() + 1);
    if freedom < LEAST_FREEDOM {
        return Vec::new();
    }
    let beside = Beside::of(rows.columns, &rows.readings_ent, rows.noise);
    dependence(rows, &beside, freedom).into_iter().chain(history(rows, &beside, freedom)).collect()
}

/// What the residuals of all components have of one trial column each.
struct Alike {
    /// Standard deviations of what is left, and of the noise of the fit.
    score: f64,
    beside_noise: f64,
    /// Standard deviations of what is left in the rows where the columns are large, and its degrees of freedom.
    in_place: f64,
    freedom_in_place: usize,
    /// Part of the columns.
    part: f64,
}

impl Alike {
    /// Of trial columns of the components; none where they say nothing.
    fn of(beside: &Beside, freedom: usize, raw: impl Fn(usize) -> DVector<f64>) -> Option<Self> {
        let axes: Vec<(usize, Along)> = (0..3).filter_map(|a| Some((a, beside.along(a, raw(a))?))).collect();
        let sum = |value: fn(&Along) -> f64| axes.iter().map(|(_, along)| value(along)).sum::<f64>();
        let (product, variance) = (sum(|a| a.product), sum(|a| a.variance));
        let (squares, residual) = (sum(|a| a.squares), sum(|a| a.residual));
        let part = product / squares;
        // The noise of the fit may have taken the dependence for noise: that of what is left beside it tells more. Slow noise is in the former alone.
        let explained = product * part;
        let dof = (axes.len() * freedom) as f64;
        let score = (explained * dof / (residual - explained)).sqrt();
        // A source that is wrong by a part of its setting scatters where the columns are large.
        let (mut scatter, mut fourth) = (0.0, 0.0);
        for (a, along) in &axes {
            for (i, c) in along.column.iter().enumerate() {
                let taken = beside.base.row(i).norm_squared();
                let left = beside.components[*a].0[i] - part * c;
                scatter += (c * left).powi(2) / (1.0 - taken).max(LEFT);
                fourth += c.powi(4);
            }
        }
        let in_place = product.abs() / scatter.sqrt();
        let alike = Self {
            score,
            beside_noise: product.abs() / variance.sqrt(),
            in_place,
            freedom_in_place: (squares.powi(2) / fourth) as usize,
            part,
        };
        [alike.score, alike.in_place].iter().all(|s| s.is_finite()).then_some(alike)
    }

    /// Whether noise makes it seldom.
    fn is_seen(&self, freedom: usize) -> bool {
        self.beside_noise > BESIDE_NOISE
            && is_no_noise(self.score, 3 * freedom, FOLLOWS.len() + 1)
            && is_seldom(self.in_place, self.freedom_in_place, FOLLOWS.len() + 1)
    }
}

/// Says that the readings of all axes do something alike, which on one of them may be far below the noise and yet many times the uncertainty of a
/// sensitivity: they follow the steps of the field slowly, or grow with time in proportion to themselves.
fn history(rows: &Rows, beside: &Beside, freedom: usize) -> Option<Note> {
    let usual_s = median(&mut rows.used_s.iter().map(|[begin, end]| end - begin).collect::<Vec<f64>>());
    let following = |times: f64| {
        let tau_s = times * usual_s;
        Some((Alike::of(beside, freedom, |a| DVector::from_vec(follows(rows, a, tau_s)))?, tau_s))
    };
    let slow = FOLLOWS.into_iter().filter_map(following).max_by(|a, b| a.0.score.total_cmp(&b.0.score));
    let mapped = rows.mapped_times();
    let drift = Alike::of(beside, freedom, |a| rows.readings_ent.column(a).component_mul(&mapped));
    let seen = |alike: &Alike| alike.is_seen(freedom);
    let drifts = drift.filter(seen).filter(|d| slow.as_ref().is_none_or(|(s, _)| d.score > s.score));
    if let Some(Alike { score, part, .. }) = drifts {
        let text = format!(
            "the readings of all axes grow with time in proportion to themselves ({score:.1} standard deviations), by {:+.1e} in the run: source or \
             sensor drifts, and sensitivities of axes that were driven one after the other differ by a part of that which is in no uncertainty: run \
             calfit diagnose",
            2.0 * part
        );
        return Some(
            Note::new(NoteKind::Fit, text)
                .with_remedy("repeat the settings of the first axis at the end, and let the source warm up"),
        );
    }
    let (Alike { score, part, .. }, tau_s) = slow.filter(|(alike, _)| seen(alike))?;
    let text = format!(
        "the readings of all axes depend on the steps of the field before ({score:.1} standard deviations), as where {:+.1e} of every step comes \
         later with a time constant of about {tau_s:.0} s; what that does to the sensitivities is in no uncertainty: run calfit diagnose",
        -part
    );
    Some(Note::new(NoteKind::Fit, text).with_remedy("hold the fields longer"))
}

/// The note about residuals that depend on something, naming the dependence with the least probability of being noise.
fn dependence(rows: &Rows, beside: &Beside, freedom: usize) -> Option<Note> {
    let n = rows.readings_ent.nrows();
    let mapped = rows.mapped_times();
    let tau = |i: usize| mapped[i];
    let x = |i: usize, a: usize| rows.readings_ent[(i, a)];
    let moves = rows.degc.as_ref().filter(|degc| degc.iter().all(|v| v.is_finite()));

    let mut trials = 0;
    let mut best: Option<(f64, &str, usize)> = None;
    for a in 0..3 {
        let (b, c) = ((a + 1) % 3, (a + 2) % 3);
        let mut named: Vec<(&str, DVector<f64>)> = Vec::new();
        let mut attempt =
            |what: &'static str, value: &dyn Fn(usize) -> f64| named.push((what, DVector::from_fn(n, |i, _| value(i))));
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
        let (names, columns): (Vec<&str>, Vec<DVector<f64>>) = named.into_iter().unzip();
        for (what, score) in names.into_iter().zip(beside.scores(a, columns)) {
            let Some(score) = score else { continue };
            trials += 1;
            if best.is_none_or(|(most, ..)| score > most) {
                best = Some((score, what, a));
            }
        }
    }
    let (score, what, axis) = best.filter(|(score, ..)| is_no_noise(*score, freedom, trials))?;
    let name = COMPONENTS[axis];
    let text = format!("the residuals of {name} depend on {what} ({score:.1} standard deviations): run calfit diagnose");
    Some(Note::new(NoteKind::Fit, text).about(name))
}
