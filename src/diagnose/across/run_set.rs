//! The runs as one model: what every sensor has for itself, and how much the values scatter.

use super::values::RunValues;
use super::{CLASSES, CONTRADICTED, axis_of};
use crate::data::note::{Note, NoteKind};
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::Gap;
use crate::fit::scan::{Fitted, Group};
use crate::fit::statistics::chi2_tail;
use crate::model::effects::between::{Cause, Conditions, Runs};
use nalgebra::{DMatrix, DVector};
use std::ops::Deref;

/// Values without parameters that stand for known uncertainties: those of a run are known to a tenth or so themselves.
const MOST_ANCHORS: f64 = 40.0;
/// Uncertainties of runs within this factor are pooled: each for itself is known to some ten percent.
const ALIKE_STD: f64 = 4.0;

/// Something that may make runs disagree. Its columns have a row per value, class after class, run after run.
#[derive(Clone)]
pub struct RunCandidate {
    /// The term.
    pub candidate: Candidate,
    /// What makes the runs disagree; `None` if that is not known.
    pub cause: Option<Cause>,
    /// The runs that it concerns alone: those of an orientation, or a single one.
    pub alone: Option<Vec<usize>>,
}

impl RunCandidate {
    /// Whether both are one explanation in the same form.
    pub fn is_same_term(&self, other: &RunCandidate) -> bool {
        self.key == other.key && self.spec == other.spec
    }
}

impl Deref for RunCandidate {
    type Target = Candidate;

    fn deref(&self) -> &Candidate {
        &self.candidate
    }
}

/// The runs with what is fitted before anything is named.
pub struct RunSet<'a> {
    pub runs: &'a [RunValues],
    /// Their conditions, as effects read them.
    pub conditions: Runs,
    /// Orientation of each run, sensor by sensor.
    pub orientation: Vec<usize>,
    pub y: DVector<f64>,
    pub std: DVector<f64>,
    pub nuisance: DMatrix<f64>,
    pub anchors: [usize; 3],
}

/// Indices of equal things, in the order of their first appearance.
pub fn numbered<T: PartialEq>(all: impl Iterator<Item = T>) -> Vec<usize> {
    let mut seen: Vec<T> = Vec::new();
    all.map(|one| {
        seen.iter().position(|s| *s == one).unwrap_or_else(|| {
            seen.push(one);
            seen.len() - 1
        })
    })
    .collect()
}

pub fn count(numbers: &[usize]) -> usize {
    numbers.iter().max().map_or(0, |m| m + 1)
}

impl<'a> RunSet<'a> {
    pub fn new(runs: &'a [RunValues]) -> Self {
        let n = runs.len();
        let at = |class: usize, run: usize, i: usize| (class * n + run) * 3 + i;
        let (mut y, mut std) = (DVector::zeros(9 * n), DVector::zeros(9 * n));
        for (r, run) in runs.iter().enumerate() {
            for class in 0..3 {
                for i in 0..3 {
                    y[at(class, r, i)] = run.of(class)[i];
                    std[at(class, r, i)] = run.std_of(class)[i];
                }
            }
        }
        let sensors = numbered(runs.iter().map(|r| r.sensor.as_str()));
        let sets = numbered(runs.iter().map(|r| r.set.as_str()));
        let conditions = |(r, run): (usize, &RunValues)| Conditions {
            sensor: sensors[r],
            set: sets[r],
            position: run.position,
            start_s: run.time,
            sensor_degc: run.sensor_degc,
            coil_degc: run.coil_degc,
        };
        let conditions = Runs(runs.iter().enumerate().map(conditions).collect());
        for sensor in 0..count(&sensors) {
            for value in 0..9 {
                let rows: Vec<usize> = (0..n).filter(|r| sensors[*r] == sensor).map(|r| at(value / 3, r, value % 3)).collect();
                let (low, high) = rows.iter().fold((f64::INFINITY, 0.0_f64), |(l, h), r| (l.min(std[*r]), h.max(std[*r])));
                if high < ALIKE_STD * low {
                    let pooled = (rows.iter().map(|r| std[*r] * std[*r]).sum::<f64>() / rows.len() as f64).sqrt();
                    rows.iter().for_each(|r| std[*r] = pooled);
                }
            }
        }
        let mut columns = Vec::new();
        for sensor in 0..count(&sensors) {
            let order = conditions.thermal_order(sensor);
            let u = conditions.scaled_temperature(sensor);
            for class in 0..3 {
                for i in 0..3 {
                    for power in 0..=order {
                        let mut column = DVector::zeros(9 * n);
                        for r in (0..n).filter(|r| sensors[*r] == sensor) {
                            column[at(class, r, i)] = if power == 0 { 1.0 } else { u(r).powi(power as i32) };
                        }
                        columns.push(column);
                    }
                }
            }
        }
        let orientation = numbered(runs.iter().map(|r| (r.sensor.as_str(), r.position.orientation())));
        let nuisance = DMatrix::from_columns(&columns);
        Self { runs, conditions, orientation, y, std, nuisance, anchors: [0; 3] }
    }

    pub fn count(&self) -> usize {
        self.runs.len()
    }

    /// Divided by the uncertainties, with the rows of the anchors.
    fn whiten(&self, columns: &DMatrix<f64>, anchor: f64) -> DMatrix<f64> {
        let (edges, n) = (self.edges(), 3 * self.count());
        let mut out = DMatrix::from_element(edges[3], columns.ncols(), anchor);
        for class in 0..3 {
            for r in 0..n {
                for c in 0..columns.ncols() {
                    out[(edges[class] + r, c)] = columns[(class * n + r, c)] / self.std[class * n + r];
                }
            }
        }
        out
    }

    fn edges(&self) -> [usize; 4] {
        let mut edges = [0; 4];
        for class in 0..3 {
            edges[class + 1] = edges[class] + 3 * self.count() + self.anchors[class];
        }
        edges
    }

    pub fn model(&self, terms: &[&RunCandidate]) -> DMatrix<f64> {
        let mut columns: Vec<DVector<f64>> = self.nuisance.column_iter().map(|c| c.into_owned()).collect();
        columns.extend(terms.iter().flat_map(|t| t.columns.column_iter().map(|c| c.into_owned())));
        DMatrix::from_columns(&columns)
    }

    pub fn fitted(&self, terms: &[&RunCandidate]) -> Fitted {
        let y = DMatrix::from_column_slice(self.y.len(), 1, self.y.as_slice());
        Fitted::new(&self.whiten(&y, 1.0).column(0).into_owned(), &self.whiten(&self.model(terms), 0.0), self.edges())
    }

    pub fn group(&self, fitted: &Fitted, candidate: &Candidate) -> Group {
        fitted.group(&self.whiten(&candidate.columns, 0.0))
    }

    /// Squares of what a model leaves of a class in units of the uncertainties, anchors not counted, and its degrees of freedom.
    pub fn left(&self, class: usize, terms: &[&RunCandidate]) -> (f64, f64) {
        let n = 3 * self.count();
        let part = |m: &DMatrix<f64>| DMatrix::from_fn(n, m.ncols(), |r, c| m[(class * n + r, c)] / self.std[class * n + r]);
        let y = part(&DMatrix::from_column_slice(self.y.len(), 1, self.y.as_slice())).column(0).into_owned();
        let fitted = Fitted::new(&y, &part(&self.model(terms)), [0, n, n, n]);
        (fitted.residual.norm_squared(), fitted.freedom()[0])
    }

    /// Believes the uncertainties of those classes whose scatter does not contradict them.
    pub fn anchor(&mut self, candidates: &[RunCandidate], notes: &mut Vec<Note>) {
        let known = self.runs.iter().all(|r| r.std.is_some());
        let number = self.runs.iter().map(|r| r.freedom.max(0.0)).sum::<f64>().clamp(4.0, MOST_ANCHORS) as usize;
        let facility: Vec<&RunCandidate> =
            candidates.iter().filter(|c| c.cause == Some(Cause::Calibration) && c.spec.axes.len() == 3).collect();
        for class in 0..3 {
            // A single further effect is allowed for, so that what is looked for does not pass as noise.
            let mut best: Option<f64> = None;
            let mut squares = (f64::INFINITY, 0.0);
            for further in std::iter::once(None).chain(candidates.iter().map(Some)) {
                let terms: Vec<&RunCandidate> = facility.iter().copied().chain(further).collect();
                let (sum, freedom) = self.left(class, &terms);
                let p = if freedom < 0.5 { 1.0 } else { chi2_tail(sum, freedom) };
                if best.is_none_or(|b| p > b) {
                    best = Some(p);
                    squares = (sum, freedom);
                }
                if further.is_none() && freedom < 0.5 {
                    break;
                }
            }
            let agrees = best.is_some_and(|p| p > CONTRADICTED) && (known || squares.1 > 0.5);
            if agrees {
                self.anchors[class] = number;
            } else if known {
                let text = format!(
                    "{}: the runs scatter {:.1} times as much as their own uncertainties; the scatter itself is taken as noise",
                    CLASSES[class],
                    (squares.0 / squares.1.max(1.0)).sqrt()
                );
                notes.push(Note::new(NoteKind::Method, text).about(CLASSES[class]));
            }
        }
    }

    /// Standard deviation of each class in units of the uncertainties.
    pub fn scales(&self, fitted: &Fitted) -> [f64; 3] {
        let (edges, freedom) = (self.edges(), fitted.freedom());
        std::array::from_fn(|c| {
            let squares = fitted.residual.rows(edges[c], edges[c + 1] - edges[c]).norm_squared();
            (squares / freedom[c].max(1.0)).sqrt().max(f64::MIN_POSITIVE)
        })
    }

    /// Deviations of every run from a model that has not seen it, in the units of the values.
    pub fn held_out(&self, terms: &[&RunCandidate], scales: &[f64; 3]) -> DVector<f64> {
        let n = self.count();
        let p = self.nuisance.ncols();
        let weighted = |r: usize, v: f64| v / (self.std[r] * scales[r / (3 * n)]);
        let columns = self.model(terms);
        let mut out = DVector::zeros(9 * n);
        for run in 0..n {
            let of = |r: &usize| (r / 3) % n == run;
            let train: Vec<usize> = (0..9 * n).filter(|r| !of(r)).collect();
            let mut design = DMatrix::from_fn(train.len(), columns.ncols(), |i, c| weighted(train[i], columns[(train[i], c)]));
            let y = DVector::from_fn(train.len(), |i, _| weighted(train[i], self.y[train[i]]));
            let norms: Vec<f64> = design.column_iter().map(|c| c.norm()).map(|n| if n > 0.0 { n } else { 1.0 }).collect();
            for (c, norm) in norms.iter().enumerate() {
                design.column_mut(c).scale_mut(1.0 / norm);
            }
            // The shortest solution for the terms: what the others do not determine of them is not predicted.
            let (own, further) = (design.columns(0, p).into_owned(), design.columns(p, columns.ncols() - p).into_owned());
            let sensor = Fitted::new(&y, &own, [0, train.len(), train.len(), train.len()]);
            let size = if further.ncols() == 0 {
                DVector::zeros(0)
            } else {
                sensor
                    .beside(&further)
                    .svd(true, true)
                    .solve(&sensor.residual, 1e-6)
                    .unwrap_or_else(|_| DVector::zeros(further.ncols()))
            };
            let Ok(base) = own.svd(true, true).solve(&(&y - &further * &size), 1e-9) else { continue };
            for r in (0..9 * n).filter(of) {
                let coefficient = |c: usize| if c < p { base[c] } else { size[c - p] };
                let model: f64 = (0..columns.ncols()).map(|c| columns[(r, c)] * coefficient(c) / norms[c]).sum();
                out[r] = self.y[r] - model;
            }
        }
        out
    }

    /// Classes of values on which terms act.
    pub fn classes(&self, terms: &[&RunCandidate]) -> [bool; 3] {
        let n = 3 * self.count();
        std::array::from_fn(|c| terms.iter().any(|t| t.columns.rows(c * n, n).norm() > 0.0))
    }

    /// Weighted squares of held-out deviations over the runs that `terms` do not concern alone.
    pub fn gap(&self, deviations: &DVector<f64>, scales: &[f64; 3], terms: &[&RunCandidate], classes: [bool; 3]) -> (Gap, f64) {
        let n = self.count();
        let shared: Vec<usize> =
            (0..n).filter(|r| terms.iter().all(|t| t.alone.as_ref().is_none_or(|own| !own.contains(r)))).collect();
        let (mut sum, mut number, mut most, mut squares) = (0.0, 0.0, 0.0_f64, [0.0; 3]);
        for class in (0..3).filter(|c| classes[*c]) {
            for r in &shared {
                for i in 0..3 {
                    let row = (class * n + r) * 3 + i;
                    let nt = deviations[row] * self.runs[*r].nt_per_unit(class);
                    sum += (deviations[row] / (self.std[row] * scales[class])).powi(2);
                    number += 1.0;
                    squares[axis_of(class, i)] += nt * nt;
                    most = most.max(nt.abs());
                }
            }
        }
        let rms_nt = squares.map(|s| (s / shared.len().max(1) as f64).sqrt());
        (Gap { rms_nt, chi2_per_dof: sum / f64::max(number, 1.0), max_nt: most }, sum)
    }
}
