//! The search of the joint fit: the model and its derivatives at a point, and the Gauss-Newton steps to the last digits.

use super::JointError;
use super::layout::{Layout, RunRows};
use crate::data::convention::base_vectors;
use crate::fit::linear::check_condition;
use crate::fit::{FitError, Limits};
use crate::model::sensor::SplitError;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Owned, Rotation3, Vector3};

/// Evaluations of the search per parameter and one more. The start is close to the minimum: a handful in all is usual, so that a
/// search which needs more than these has no minimum to find.
const PATIENCE: usize = 20;
/// Stands for the residuals where no three axes have the angles between them, so that the search turns back.
const WALL: f64 = 1e150;
/// Gauss-Newton steps after the search.
const MAX_STEPS: usize = 30;
/// They end with a step below this share of the standard deviations: nine digits below what the noise leaves open.
const FINISHED: f64 = 1e-9;
/// Where the steps no longer shrink, a step below this share of the standard deviations is accepted as the minimum.
const SETTLED: f64 = 1e-4;
/// A step below this multiple of the rounding of the largest reading is accepted too; it decides where the noise is near zero.
const ROUNDING: f64 = 1e2 * f64::EPSILON;

/// Columns of `Q(ξ)`, the sensor axes, and the derivatives of the second by ξ_xy and of the third by ξ_xy, ξ_xz, ξ_yz.
pub(super) struct Axes {
    pub(super) axes: [Vector3<f64>; 3],
    pub(super) y_by_xy: Vector3<f64>,
    pub(super) z_by: [Vector3<f64>; 3],
}

impl Axes {
    pub(super) fn at(xi: [f64; 3]) -> Result<Self, SplitError> {
        let q = base_vectors(xi.map(f64::to_degrees))?;
        let axes: [Vector3<f64>; 3] = std::array::from_fn(|i| q.column(i).into_owned());
        let [xy, xz, yz] = xi;
        let [_, second, third] = axes;
        // The third axis is (cos ξxz, q, height) with q = (cos ξyz - cos ξxy cos ξxz) / sin ξxy, height² = sin² ξxz - q².
        let by = |first: f64, q: f64, squared: f64| Vector3::new(first, q, (0.5 * squared - third.y * q) / third.z);
        Ok(Axes {
            axes,
            y_by_xy: Vector3::new(-second.y, second.x, 0.0),
            z_by: [
                by(0.0, xz.cos() - third.y * xy.cos() / xy.sin(), 0.0),
                by(-xz.sin(), xy.cos() * xz.sin() / xy.sin(), (2.0 * xz).sin()),
                by(0.0, -yz.sin() / xy.sin(), 0.0),
            ],
        })
    }
}

/// The matrix J with `exp(θ + δ) = exp(θ) exp(J δ)` to first order in δ.
pub(super) fn right_jacobian(theta: &Vector3<f64>) -> Matrix3<f64> {
    let (angle, cross) = (theta.norm(), theta.cross_matrix());
    // Below, the next terms of the series are smaller than the last digit.
    let (a, b) = if angle < 1e-3 {
        let square = angle * angle;
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        ((1.0 - angle.cos()) / angle.powi(2), (angle - angle.sin()) / angle.powi(3))
    };
    Matrix3::identity() - cross * a + cross * cross * b
}

/// The problem at a point.
#[derive(Clone)]
pub(super) struct SearchPoint<'a> {
    pub(super) layout: &'a Layout,
    pub(super) data: &'a [RunRows],
    pub(super) parameters: DVector<f64>,
    /// Modelled minus read, over the noise, trends projected out; rows by run, component, plateau. None outside of the domain.
    pub(super) residuals: Option<DVector<f64>>,
    pub(super) evaluations: usize,
}

/// Where the search ended.
pub(super) struct Minimum<'a> {
    pub(super) end: SearchPoint<'a>,
    /// Derivatives there, and their triangular factor.
    pub(super) jacobian: DMatrix<f64>,
    pub(super) r: DMatrix<f64>,
    /// Sum of the squared residuals at the start.
    pub(super) start_chi2: f64,
}

impl<'a> SearchPoint<'a> {
    /// The polynomials of the start, and the rotations that the runs bring.
    pub(super) fn start(layout: &'a Layout, data: &'a [RunRows], start: &[Vec<f64>; 6]) -> Self {
        let mut point = Self { layout, data, parameters: layout.start(start), residuals: None, evaluations: 0 };
        point.evaluate();
        point
    }

    /// The minimum that this start leads to.
    pub(super) fn minimum(self, limits: &Limits) -> Result<Minimum<'a>, JointError> {
        let start_chi2 = self.residuals.as_ref().map(DVector::norm_squared).ok_or(JointError::NoSensor)?;
        // However the search ends: whether it found a minimum is seen there.
        let (mut end, _) = LevenbergMarquardt::new().with_patience(PATIENCE).minimize(self);
        let (jacobian, r) = end.polish(limits)?;
        Ok(Minimum { end, jacobian, r, start_chi2 })
    }
}

impl SearchPoint<'_> {
    pub(super) fn polynomial(&self, quantity: usize, mapped: f64) -> f64 {
        self.parameters.as_slice()[self.layout.range(quantity)].iter().rev().fold(0.0, |sum, c| sum * mapped + c)
    }

    /// The rotation vector of a run at a mapped temperature, from its start, radians.
    pub(super) fn rotation_vector(&self, run: usize, mapped: f64) -> Vector3<f64> {
        let vectors = self.layout.turn(run).step_by(3).rev();
        vectors.fold(Vector3::zeros(), |sum, at| sum * mapped + self.parameters.fixed_rows::<3>(at))
    }

    /// The rotation of a run as a function of its mapped temperature, worked out once where it does not change.
    fn turning<T: Copy>(&self, run: usize, of: impl Fn(&Vector3<f64>) -> T) -> impl Fn(f64) -> T {
        let constant = (self.layout.turn(run).len() == 3).then(|| of(&self.rotation_vector(run, 0.0)));
        move |mapped| constant.unwrap_or_else(|| of(&self.rotation_vector(run, mapped)))
    }

    /// The model without the trend for each plateau of a run, enT.
    pub(super) fn model(&self, run: usize) -> Option<Vec<[f64; 3]>> {
        self.model_at(run, &self.data[run].mapped)
    }

    /// The same if the plateaus had other mapped temperatures.
    pub(super) fn model_at(&self, run: usize, mapped: &[f64]) -> Option<Vec<[f64; 3]>> {
        let back = self.turning(run, |theta| Rotation3::new(*theta).inverse());
        self.data[run]
            .fields
            .iter()
            .zip(mapped)
            .map(|(field, &mapped)| {
                let axes = Axes::at(std::array::from_fn(|i| self.polynomial(3 + i, mapped))).ok()?;
                let field = back(mapped) * field;
                Some(std::array::from_fn(|i| axes.axes[i].dot(&field) / self.polynomial(i, mapped)))
            })
            .collect()
    }

    pub(super) fn evaluate(&mut self) {
        self.evaluations += 1;
        let mut residuals = DVector::zeros(self.layout.rows);
        let mut row = 0;
        self.residuals = None;
        for (run, data) in self.data.iter().enumerate() {
            let Some(model) = self.model(run) else { return };
            for component in 0..3 {
                let column = &mut residuals.as_mut_slice()[row..row + data.len()];
                for (value, (model, read)) in column.iter_mut().zip(model.iter().zip(&data.readings)) {
                    *value = (model[component] - read[component]) / data.noise[component];
                }
                data.project(component, column);
                row += data.len();
            }
        }
        self.residuals = residuals.iter().all(|value| value.is_finite()).then_some(residuals);
    }

    /// Derivatives of the model over the noise, trends left in. Rows as the residuals.
    pub(super) fn derivatives(&self) -> Option<DMatrix<f64>> {
        let layout = self.layout;
        let mut jacobian = DMatrix::zeros(layout.rows, layout.count());
        let mut first = 0;
        for (run, data) in self.data.iter().enumerate() {
            let turning = self.turning(run, |theta| (Rotation3::new(*theta).inverse(), right_jacobian(theta)));
            let rotation = layout.turn(run);
            for (k, (field, &mapped)) in data.fields.iter().zip(&data.mapped).enumerate() {
                let axes = Axes::at(std::array::from_fn(|i| self.polynomial(3 + i, mapped))).ok()?;
                let (back, right) = turning(mapped);
                let field = back * field;
                // A rotation by dθ turns the field the other way: dv = v x (J dθ).
                let turned = field.cross_matrix() * right;
                for component in 0..3 {
                    let row = first + component * data.len() + k;
                    let sigma = self.polynomial(component, mapped);
                    let scale = 1.0 / (sigma * data.noise[component]);
                    let mut fill = |quantity: usize, derivative: f64| {
                        layout.range(quantity).fold(derivative, |value, column| {
                            jacobian[(row, column)] = value;
                            value * mapped
                        });
                    };
                    fill(component, -axes.axes[component].dot(&field) / sigma * scale);
                    match component {
                        1 => fill(3, axes.y_by_xy.dot(&field) * scale),
                        2 => (0..3).for_each(|i| fill(3 + i, axes.z_by[i].dot(&field) * scale)),
                        _ => {}
                    }
                    let by_rotation = turned.transpose() * axes.axes[component] * scale;
                    rotation.clone().step_by(3).fold(by_rotation, |vector, at| {
                        (0..3).for_each(|j| jacobian[(row, at + j)] = vector[j]);
                        vector * mapped
                    });
                }
            }
            first += 3 * data.len();
        }
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }

    /// Takes the trends out of the derivatives.
    pub(super) fn project(&self, jacobian: &mut DMatrix<f64>) {
        let mut row = 0;
        for (run, data) in self.data.iter().enumerate() {
            let own = self.layout.turn(run);
            for component in 0..3 {
                // Columns of another component or run are zero here.
                let angles = match component {
                    0 => 0..0,
                    1 => self.layout.range(3),
                    _ => self.layout.starts[3]..self.layout.starts[6],
                };
                for j in self.layout.range(component).chain(angles).chain(own.clone()) {
                    data.project(component, &mut jacobian.column_mut(j).as_mut_slice()[row..row + data.len()]);
                }
                row += data.len();
            }
        }
    }

    /// Gauss-Newton steps while they lead closer; the derivatives at the end and their triangular factor.
    pub(super) fn polish(&mut self, limits: &Limits) -> Result<(DMatrix<f64>, DMatrix<f64>), JointError> {
        let not_settled = |evaluations| FitError::NotSettled { what: "joint fit", iterations: evaluations };
        let largest = self.data.iter().flat_map(|data| {
            data.readings.iter().map(|read| (0..3).map(|i| (read[i] / data.noise[i]).abs()).fold(0.0, f64::max))
        });
        let rounding = ROUNDING * largest.fold(0.0, f64::max) * (self.layout.rows as f64).sqrt();
        let mut last: Option<PreviousStep> = None;
        for _ in 0..MAX_STEPS {
            let (Some(residuals), Some(jacobian)) = (&self.residuals, self.jacobian()) else {
                return Err(not_settled(self.evaluations).into());
            };
            let factors = QR::new(jacobian.clone());
            let r = factors.r();
            check_condition(&r, &self.layout.names, limits)?;
            let mut projected = residuals.clone();
            factors.q_tr_mul(&mut projected);
            let projected = projected.rows(0, self.layout.count()).into_owned();
            // The length of the step in standard deviations for noise as given.
            let size = projected.norm();
            if let Some(before) = last.take()
                && size > 0.5 * before.size
            {
                if before.size > SETTLED.max(rounding) {
                    break;
                }
                self.parameters = before.parameters;
                self.evaluate();
                return Ok((before.jacobian, before.r));
            }
            if size <= FINISHED {
                return Ok((jacobian, r));
            }
            let Some(step) = r.solve_upper_triangular(&projected) else { break };
            last = Some(PreviousStep { size, jacobian, r, parameters: self.parameters.clone() });
            self.parameters -= step;
            self.evaluate();
        }
        Err(not_settled(self.evaluations).into())
    }
}

/// Where a Gauss-Newton step came from.
pub(super) struct PreviousStep {
    pub(super) size: f64,
    pub(super) jacobian: DMatrix<f64>,
    pub(super) r: DMatrix<f64>,
    pub(super) parameters: DVector<f64>,
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for SearchPoint<'_> {
    type ResidualStorage = Owned<f64, Dyn>;
    type JacobianStorage = Owned<f64, Dyn, Dyn>;
    type ParameterStorage = Owned<f64, Dyn>;

    fn set_params(&mut self, parameters: &DVector<f64>) {
        self.parameters.copy_from(parameters);
        self.evaluate();
    }

    fn params(&self) -> DVector<f64> {
        self.parameters.clone()
    }

    fn residuals(&self) -> Option<DVector<f64>> {
        Some(self.residuals.clone().unwrap_or_else(|| DVector::from_element(self.layout.rows, WALL)))
    }

    fn jacobian(&self) -> Option<DMatrix<f64>> {
        let mut jacobian = self.derivatives()?;
        self.project(&mut jacobian);
        Some(jacobian)
    }
}
