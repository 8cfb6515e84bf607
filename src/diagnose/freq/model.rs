//! A response with what may be missing in it, fitted to amplitudes and phases.

use super::sines::Sines;
use crate::fit::scan::orthonormal;
use crate::fit::statistics::std_of;
use crate::model::effects::EffectRef;
use crate::model::effects::in_sine::{POLES_HZ, SineTerm, Triple};
use crate::model::effects::time_shift::{self, TimeShift};
use crate::model::response::Response;
use nalgebra::{DMatrix, DVector};
use std::f64::consts::TAU;
use std::ops::Deref;
use std::sync::Arc;

/// Step of numeric derivatives, in logarithms, parts, 1e-6 and µs alike.
const STEP: f64 = 1e-4;
/// Steps of a fit, and the decrease of chi-square that ends it.
const MOST_STEPS: usize = 60;
const FINISHED: f64 = 1e-4;
/// Halvings of an interval that ends at a standard uncertainty, which is wanted to a part in 10⁶ of the interval and more.
const HALVED: usize = 40;
/// A column of which less than this part is left beside others is one of them.
const INDEPENDENT: f64 = 1e-9;
/// Largest part of the field behind a pole.
const MOST_PART: f64 = 1.5;

/// What may be missing: a term of an effect.
#[derive(Clone, Debug)]
pub struct EffectTerm {
    /// The effect.
    pub effect: EffectRef,
    form: Arc<dyn SineTerm>,
}

impl EffectTerm {
    /// A term of an effect.
    pub fn new(effect: EffectRef, form: Arc<dyn SineTerm>) -> Self {
        Self { effect, form }
    }

    /// The term of a displacement.
    pub fn shift() -> Self {
        Self::new(EffectRef::new(&TimeShift), time_shift::delay())
    }

    /// The same with what it takes for given as a parameter, and all its parameters; `None` where nothing is given.
    pub fn freed(&self, p: &[f64]) -> Option<(EffectTerm, Vec<f64>)> {
        let (form, values) = self.form.freed(p)?;
        Some((Self::new(self.effect, form), values))
    }

    /// Whether it is a part that passes poles.
    pub fn has_pole(&self) -> bool {
        self.pole_range_hz().is_some()
    }

    /// Whether both are of one kind on the same axes, so that one of them is enough.
    pub fn is_like(&self, other: &EffectTerm) -> bool {
        self.effect == other.effect && self.kind() == other.kind() && self.axes() == other.axes()
    }

    /// Whether both are of one form on the same axes.
    pub fn is_same(&self, other: &EffectTerm) -> bool {
        self.is_like(other) && self.form() == other.form()
    }
}

impl Deref for EffectTerm {
    type Target = dyn SineTerm;

    fn deref(&self) -> &Self::Target {
        &*self.form
    }
}

/// A response with terms: per component the logarithms of DC amplitude and parameters of the response and the relative deviation of the
/// sampling frequency in 1e-6, then the parameters of the terms.
#[derive(Clone, Debug)]
pub struct Model {
    /// Response of the instrument.
    pub response: Response,
    /// What it has beside.
    pub terms: Vec<EffectTerm>,
}

impl Model {
    /// Parameters of one component.
    fn own(&self) -> usize {
        2 + self.response.parameters().len()
    }

    /// All parameters.
    pub fn count(&self) -> usize {
        3 * self.own() + self.terms.iter().map(|t| t.count()).sum::<usize>()
    }

    /// Where the parameters of a term begin.
    pub fn begin(&self, term: usize) -> usize {
        3 * self.own() + self.terms[..term].iter().map(|t| t.count()).sum::<usize>()
    }

    /// What component i shows of setting j.
    pub fn triple(&self, p: &[f64], shapes: &[Vec<f64>; 3], sines: &Sines, j: usize, i: usize) -> Triple {
        let own = &p[i * self.own()..(i + 1) * self.own()];
        let sine = &sines.list[j];
        let f = sine.setting.frequency_hz;
        let deviation = 1e-6 * own[self.own() - 1];
        let mut triple = [
            own[0] + self.response.value(f, &shapes[i]).max(f64::MIN_POSITIVE).ln(),
            self.response.phase_rad(f, &shapes[i]) - TAU * f * sine.middle_s * deviation,
            -TAU * f * deviation,
        ];
        for (k, term) in self.terms.iter().enumerate() {
            term.add(&p[self.begin(k)..], &sines.run, j, i, &mut triple);
        }
        triple
    }

    /// The lowest -3 dB frequency of a component, Hz, within the range of poles; its lower end where none falls as far.
    pub fn corner_hz(&self, p: &[f64]) -> f64 {
        let corners = self.shapes(p);
        let lowest = corners.iter().filter_map(|shape| self.response.corner_hz(shape)).reduce(f64::min);
        lowest.unwrap_or(0.0).clamp(POLES_HZ[0], POLES_HZ[1])
    }

    /// Parameters of the response per component.
    pub fn shapes(&self, p: &[f64]) -> [Vec<f64>; 3] {
        std::array::from_fn(|i| p[i * self.own() + 1..(i + 1) * self.own() - 1].iter().map(|l| l.exp()).collect())
    }

    fn residual(&self, p: &[f64], sines: &Sines) -> DVector<f64> {
        let shapes = self.shapes(p);
        sines.residual(|j, i| self.triple(p, &shapes, sines, j, i))
    }

    /// Derivatives of the prediction, whitened.
    fn jacobian(&self, p: &[f64], sines: &Sines) -> DMatrix<f64> {
        let by = |k: usize| {
            let [less, more] = [-STEP, STEP].map(|step| {
                let mut moved = p.to_vec();
                moved[k] += step;
                (self.shapes(&moved), moved)
            });
            let axes = self.axes_of(k);
            sines.whiten(|j, i| {
                if !axes[i] {
                    return [0.0; 3];
                }
                let [less, more] = [&less, &more].map(|(shapes, moved)| self.triple(moved, shapes, sines, j, i));
                std::array::from_fn(|what| (more[what] - less[what]) / (2.0 * STEP))
            })
        };
        DMatrix::from_columns(&(0..p.len()).map(by).collect::<Vec<DVector<f64>>>())
    }

    /// The components that a parameter moves.
    fn axes_of(&self, parameter: usize) -> [bool; 3] {
        let own = parameter / self.own();
        let term = (0..self.terms.len()).rev().find(|term| self.begin(*term) <= parameter);
        std::array::from_fn(|i| term.map_or(own == i, |term| self.terms[term].axes().contains(&i)))
    }

    /// Weighted least squares from a start.
    pub fn fit(&self, start: &[f64], sines: &Sines) -> Option<Fit> {
        let mut p = self.inside(start.to_vec());
        let mut residual = self.residual(&p, sines);
        let mut chi2 = residual.norm_squared();
        if !chi2.is_finite() {
            return None;
        }
        let mut damping = 1e-6;
        for _ in 0..MOST_STEPS {
            let j = self.jacobian(&p, sines);
            let (normal, right) = (j.tr_mul(&j), j.tr_mul(&residual));
            let mut better = false;
            for _ in 0..12 {
                let mut damped = normal.clone();
                for k in 0..p.len() {
                    damped[(k, k)] += damping * normal[(k, k)].max(1e-12);
                }
                let moved = self.step(damped, right.clone(), &p);
                let new = moved.filter(|m| self.allowed(m)).map(|m| (self.residual(&m, sines), m));
                match new {
                    Some((r, m)) if r.norm_squared() < chi2 => {
                        let gain = chi2 - r.norm_squared();
                        (p, residual, chi2) = (m, r, chi2 - gain);
                        damping = (0.1 * damping).max(1e-12);
                        better = gain > FINISHED;
                        break;
                    }
                    _ => damping = (10.0 * damping).max(1e-9),
                }
            }
            if !better {
                break;
            }
        }
        let jacobian = self.jacobian(&p, sines);
        Some(Fit { model: self.clone(), p, residual, jacobian, chi2 })
    }

    /// Frequencies and qualities of poles, as logarithms: where they stand, and their lowest and highest value.
    fn limits(&self) -> impl Iterator<Item = (usize, [f64; 2])> {
        self.terms.iter().enumerate().flat_map(|(k, term)| {
            let ranges = [term.pole_range_hz(), term.quality_range()].into_iter().zip(self.begin(k) + 1..);
            ranges.filter_map(|(range, at)| Some((at, range?.map(f64::ln))))
        })
    }

    /// With the poles where they may be.
    fn inside(&self, mut p: Vec<f64>) -> Vec<f64> {
        self.limits().for_each(|(k, [low, high])| p[k] = p[k].clamp(low, high));
        p
    }

    /// One step of the normal equations; what would leave its limits goes to them, and all others are solved for that.
    fn step(&self, mut normal: DMatrix<f64>, mut right: DVector<f64>, p: &[f64]) -> Option<Vec<f64>> {
        loop {
            let step = normal.clone().cholesky()?.solve(&right);
            let leaves = |(k, [low, high]): &(usize, [f64; 2])| {
                // To rounding, what goes to its limit is there.
                let to = p[*k] + step[*k];
                to < low - 1e-9 || to > high + 1e-9
            };
            let Some((k, [low, high])) = self.limits().find(leaves) else {
                return Some(self.inside(p.iter().zip(step.iter()).map(|(a, b)| a + b).collect()));
            };
            let by = (p[k] + step[k]).clamp(low, high) - p[k];
            right.axpy(-by, &normal.column(k).into_owned(), 1.0);
            normal.column_mut(k).fill(0.0);
            normal.row_mut(k).fill(0.0);
            normal[(k, k)] = 1.0;
            right[k] = by;
        }
    }

    fn allowed(&self, p: &[f64]) -> bool {
        let parts_fine = self.terms.iter().enumerate().all(|(k, t)| !t.has_pole() || p[self.begin(k)].abs() < MOST_PART);
        parts_fine && self.shapes(p).iter().flatten().all(|s| (1e-3..1e6).contains(s))
    }

    /// Shapes of the components to start from, near whose -3 dB frequencies the given ones lie: one per set of [`Response::starts`].
    pub fn starts(&self, corner_hz: [f64; 3]) -> Vec<[Vec<f64>; 3]> {
        let sets = corner_hz.map(|c| self.response.starts(c));
        (0..sets[0].len()).map(|k| sets.each_ref().map(|set| set[k].clone())).collect()
    }

    /// Parameters with the shapes of the components, the amplitudes of the lowest frequency and a steady clock.
    pub fn start(&self, sines: &Sines, shapes: &[Vec<f64>; 3]) -> Vec<f64> {
        let lowest = sines.list.iter().min_by(|a, b| a.setting.frequency_hz.total_cmp(&b.setting.frequency_hz));
        let of = |(i, shape): (usize, &Vec<f64>)| {
            let amplitude = lowest.map_or(0.0, |s| s.tones[i].log_amplitude);
            std::iter::once(amplitude).chain(shape.iter().map(|v| v.ln())).chain([0.0]).collect::<Vec<f64>>()
        };
        shapes.iter().enumerate().flat_map(of).collect()
    }
}

/// A fitted model.
#[derive(Clone, Debug)]
pub struct Fit {
    /// The model.
    pub model: Model,
    /// Its parameters.
    pub p: Vec<f64>,
    /// Measured less fitted, whitened.
    pub residual: DVector<f64>,
    /// Derivatives of the prediction, whitened.
    pub jacobian: DMatrix<f64>,
    /// Squares of the residuals.
    pub chi2: f64,
}

impl Fit {
    /// Rows less parameters.
    pub fn dof(&self) -> f64 {
        self.residual.len().saturating_sub(self.p.len()).max(1) as f64
    }

    /// With a further term from some of its values.
    pub fn with(&self, term: &EffectTerm, values: &[f64], sines: &Sines) -> Option<Fit> {
        let mut model = self.model.clone();
        model.terms.push(term.clone());
        let mut p = self.p.clone();
        p.extend_from_slice(values);
        model.fit(&p, sines)
    }

    /// Without one of its terms.
    pub fn without(&self, term: usize, sines: &Sines) -> Option<Fit> {
        let (begin, count) = (self.model.begin(term), self.model.terms[term].count());
        let mut model = self.model.clone();
        model.terms.remove(term);
        let p: Vec<f64> = self.p[..begin].iter().chain(&self.p[begin + count..]).copied().collect();
        model.fit(&p, sines)
    }

    /// Covariance of the parameters.
    pub fn covariance(&self) -> Option<DMatrix<f64>> {
        let normal = self.jacobian.tr_mul(&self.jacobian);
        let scale: Vec<f64> = (0..normal.nrows()).map(|k| normal[(k, k)].sqrt().max(f64::MIN_POSITIVE)).collect();
        let unit = DMatrix::from_fn(scale.len(), scale.len(), |a, b| normal[(a, b)] / (scale[a] * scale[b]));
        let inverse = unit.pseudo_inverse(1e-12).ok()?;
        Some(DMatrix::from_fn(scale.len(), scale.len(), |a, b| inverse[(a, b)] / (scale[a] * scale[b])))
    }

    /// Standard uncertainty of a parameter at noise of 1. Where the prediction bends, as it does with a part of the field of nearly 1 of which
    /// amplitudes show the square of what is left, no slope tells it: it is no more than what makes a chi square of 1, all others fitted again.
    pub fn std(&self, parameter: usize, sines: &Sines) -> Option<f64> {
        let by_slope = std_of(self.covariance()?[(parameter, parameter)]);
        let others = orthonormal(&self.jacobian.clone().remove_column(parameter), None, INDEPENDENT);
        let chi2 = |by: f64| {
            let mut moved = self.p.clone();
            moved[parameter] += by;
            let change = self.model.residual(&moved, sines) - &self.residual;
            (&change - &others * others.tr_mul(&change)).norm_squared()
        };
        // From far outside, where chi square may be anything, to the first place where it is less than 1.
        let side = |sign: f64| {
            let [mut inside, mut outside] = [0.0, by_slope];
            for _ in 0..HALVED {
                let middle = 0.5 * (inside + outside);
                let chi2 = chi2(sign * middle);
                if chi2 < 1.0 { inside = middle } else { outside = middle }
            }
            outside
        };
        Some(side(1.0).max(side(-1.0)))
    }

    /// Derivatives of the prediction by the amplitudes of a term that is not in the model; of one with poles `values` are its parameters, of which the
    /// part does not matter.
    pub fn columns(&self, term: &EffectTerm, values: &[f64], sines: &Sines) -> Vec<DVector<f64>> {
        let linear = if term.has_pole() { 1 } else { term.count() };
        (0..linear)
            .map(|k| {
                let at = |size: f64| {
                    let mut p = vec![0.0; term.count()];
                    if term.has_pole() {
                        p[1..].copy_from_slice(&values[1..]);
                    }
                    p[k] = size;
                    sines.whiten(|j, i| {
                        let mut triple = [0.0; 3];
                        term.add(&p, &sines.run, j, i, &mut triple);
                        triple
                    })
                };
                (at(STEP) - at(-STEP)) / (2.0 * STEP)
            })
            .collect()
    }

    /// Residuals of settings predicted by a fit that did not see them, whitened: one stretch of `stretch` settings after the other.
    pub fn held_out(&self, sines: &Sines, stretch: usize) -> DVector<f64> {
        let (rows, n) = (sines.rows(), sines.list.len());
        let (whole, right) = (self.jacobian.tr_mul(&self.jacobian), self.jacobian.tr_mul(&self.residual));
        let mut out = self.residual.clone();
        for first in (0..n).step_by(stretch) {
            let (from, count) = (first * rows, rows * (n - first).min(stretch));
            let (j, r) = (self.jacobian.rows(from, count), self.residual.rows(from, count));
            let mut normal = &whole - j.tr_mul(&j);
            for k in 0..normal.nrows() {
                normal[(k, k)] *= 1.0 + 1e-10;
            }
            let Some(cholesky) = normal.cholesky() else { continue };
            let moved = cholesky.solve(&(&right - j.tr_mul(&r)));
            out.rows_mut(from, count).copy_from(&(r - j * moved));
        }
        out
    }
}
