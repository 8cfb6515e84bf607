//! The joint fit: one temperature-dependent sensor for the plateaus of all runs at once.
//!
//! `B_r = σ(T)⁻¹ ω(ξ(T))⁻¹ ρ⁻¹ R_nom⁻¹ B_c + offset(τ)`, the model of BC-MAG-TR-0085 section 15.1 with `σ_i` and `ξ_ij`
//! polynomials of the temperature at each plateau, so that a temperature which moves within a run counts as it was. Each run has
//! its own rotation ρ, since a sensor is mounted anew, and its own offset trend, since the residual field is part of it. The two
//! steps, runs first and polynomials through their parameters after, are the start and the comparison.
//!
//! Offset trends are linear parameters: projecting them out of readings and derivatives (variable projection) leaves the
//! polynomials and three angles per run. Levenberg-Marquardt leads to the minimum, Gauss-Newton steps to its last digits. The
//! factorisations are plain `f64`: the columns are scaled and the temperature mapped to \[-1, 1\], and thousands of rows by a
//! hundred columns in higher precision would take seconds for digits below the noise.

use crate::data::convention::base_vectors;
use crate::fit::linear::check_condition;
use crate::fit::{FitError, Limits, order};
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::SplitError;
use levenberg_marquardt::{LeastSquaresProblem, LevenbergMarquardt};
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Dyn, Matrix3, Owned, Rotation3, Vector3};
use thiserror::Error;

/// The quantities with a polynomial, in the order of every array: sensitivities, nT/enT, then angles between the axes, degrees.
pub const QUANTITIES: [&str; 6] = ["sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz"];
/// Highest order of an offset trend.
const HIGHEST_TREND: usize = 2;
/// Evaluations of the search per parameter and one more. The start is so close that a handful in all is usual.
const PATIENCE: usize = 20;
/// In place of residuals where no three axes have the angles between them: the search turns back.
const WALL: f64 = 1e150;
/// Gauss-Newton steps after the search.
const MAX_STEPS: usize = 30;
/// A step of this share of the standard deviations ends them.
const FINISHED: f64 = 1e-9;
/// Where steps no longer shrink, this share is a minimum.
const SETTLED: f64 = 1e-4;
/// So is this multiple of the rounding of the largest reading, which is all there is where the noise is near zero.
const ROUNDING: f64 = 1e2 * f64::EPSILON;

/// Why there is no joint fit.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum JointError {
    /// Nothing to fit.
    #[error("no runs to fit")]
    NoRuns,
    /// Results that were read from files, without their plateaus.
    #[error("the plateaus of {} are not at hand; name the runs in place of the files", files.join(", "))]
    NotAtHand {
        /// The files.
        files: Vec<String>,
    },
    /// A trend that is not fitted.
    #[error("run {run}: offset trend of order {order}; 0 to {HIGHEST_TREND} are fitted")]
    Trend {
        /// The run.
        run: String,
        /// The order asked for.
        order: usize,
    },
    /// Not enough plateaus for the offset trend and a field.
    #[error("run {run}: {plateaus} plateaus cannot carry an offset trend of order {order} and the response to the field")]
    TooFewPlateaus {
        /// The run.
        run: String,
        /// Plateaus given.
        plateaus: usize,
        /// Order of the trend.
        order: usize,
    },
    /// A plateau with a value that is none.
    #[error("run {run}: plateau {plateau} has a field, reading, temperature or time that is not finite")]
    NotFinite {
        /// The run.
        run: String,
        /// The plateau in the list given, counted from one.
        plateau: usize,
    },
    /// A noise that cannot weigh.
    #[error("run {run}: the noise of a plateau mean must be positive, not {noise_ent} enT")]
    Noise {
        /// The run.
        run: String,
        /// The value at fault.
        noise_ent: f64,
    },
    /// A polynomial to start from is missing or not finite.
    #[error("{quantity} has no polynomial to start from")]
    Start {
        /// The quantity.
        quantity: &'static str,
    },
    /// Axes in one plane or a sensitivity of zero.
    #[error("the polynomials to start from describe no sensor at the temperature of some plateau")]
    NoSensor,
    /// The fit has no answer.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// One plateau.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointPlateau {
    /// Applied field, nT, coil axes.
    pub field_coil_nt: [f64; 3],
    /// Mean reading, enT.
    pub reading_ent: [f64; 3],
    /// Temperature of the sensor at this plateau, °C.
    pub temperature_degc: f64,
    /// Its time, s from any origin of the run.
    pub t_s: f64,
}

/// One run: its plateaus and what the first of the two steps found.
#[derive(Clone, Debug, PartialEq)]
pub struct JointRun {
    /// Its name, for messages.
    pub run: String,
    /// Nominal orientation, nominal sensor to coil coordinates.
    pub r_nom: Matrix3<f64>,
    /// Rotation of the real against the nominal orientation, from the run alone; a proper rotation.
    pub rho: Matrix3<f64>,
    /// Plateaus to use.
    pub plateaus: Vec<JointPlateau>,
    /// Order of the offset trend, 0 to 2.
    pub trend_order: usize,
    /// Standard deviation of a plateau mean per component, enT.
    pub noise_ent: [f64; 3],
}

/// What the joint fit says of one run.
#[derive(Clone, Debug, PartialEq)]
pub struct JointRunResult {
    /// Its name.
    pub run: String,
    /// Rotation of the real against the nominal orientation.
    pub rho: Matrix3<f64>,
    /// Angles λ, μ, ν between each real and nominal sensor axis, degrees.
    pub rotation_deg: [f64; 3],
    /// Their standard deviations, degrees.
    pub rotation_std_deg: [f64; 3],
    /// Angle between this rotation and that of the run alone, degrees.
    pub turned_deg: f64,
    /// Offset, mean over the plateaus, enT: that of the sensor and the residual field.
    pub b_or_ent: [f64; 3],
    /// Its standard deviations, enT.
    pub b_or_std_ent: [f64; 3],
    /// Standard deviation of the residuals per component, enT, for the degrees of freedom which the fit leaves to this run.
    pub residual_std_ent: [f64; 3],
    /// Reading minus model, enT, one per plateau.
    pub residual_ent: Vec<[f64; 3]>,
    /// Lowest, mean and highest temperature of the plateaus, °C.
    pub temperature_degc: [f64; 3],
}

/// How far the runs scatter about the polynomial of one quantity.
///
/// The noise of thousands of readings hides a sensor that differs from run to run by many standard deviations, so the overall χ²
/// cannot tell. Here every run gets its own value of all six quantities and a rotation: its step away from the polynomial.
#[derive(Clone, Debug, PartialEq)]
pub struct Between {
    /// Value of each run alone minus the polynomial, nT/enT or degrees; NaN where the run alone does not determine all nine.
    pub deviation: Vec<f64>,
    /// Standard deviations of the values from the noise, the same units; infinite where there is no value.
    pub std: Vec<f64>,
    /// Sum of the squared ratios.
    pub chi2: f64,
    /// Runs that determine the quantity minus coefficients. Intervals of inflated standard deviations are Student's for these.
    pub dof: usize,
    /// Factor on the standard deviations of the coefficients: `sqrt(χ²/dof)` where χ² exceeds its 99 % quantile, otherwise 1.
    pub inflation: f64,
}

/// The joint fit.
#[derive(Clone, Debug, PartialEq)]
pub struct Joint {
    /// Polynomials as in [`QUANTITIES`]; their covariance includes the inflation of [`Between`] and by the scatter within runs.
    pub polynomials: [TemperaturePolynomial; 6],
    /// Coefficients minus those of the start, in the same units.
    pub change: [Vec<f64>; 6],
    /// The runs, in the order given.
    pub runs: Vec<JointRunResult>,
    /// Sum of squared residuals over the squared noise.
    pub chi2: f64,
    /// Readings minus all parameters, those of the trends included.
    pub dof: usize,
    /// χ² of the start, with the rotations of the runs alone.
    pub start_chi2: f64,
    /// What the runs say against each polynomial, as in [`QUANTITIES`].
    pub between: [Between; 6],
    /// Factor on the given noise for the scatter within the runs: `sqrt(χ²/dof)` of what a sensor free in every run would leave,
    /// where that χ² exceeds its 99 % quantile, otherwise 1. No standard deviation is without it.
    pub inflation_within: f64,
    /// Condition number of the derivatives with columns of unit norm.
    pub condition: f64,
    /// Points at which the model was evaluated.
    pub evaluations: usize,
}

/// Fits the sensor to all plateaus of all runs.
///
/// `start` are the coefficients of [`QUANTITIES`], lowest order first, from the polynomials through the parameters of the runs;
/// their numbers are the orders that are fitted.
///
/// # Errors
/// [`JointError`]: input that does not fit together, and parameters which the runs do not determine, by name.
pub fn joint(runs: &[JointRun], start: &[Vec<f64>; 6], limits: &Limits) -> Result<Joint, JointError> {
    runs.iter().try_for_each(check_run)?;
    let layout = Layout::over(runs, start)?;
    let data: Vec<Data> = runs.iter().map(|run| Data::of(run, &layout)).collect();
    let mut point = Point { layout: &layout, data: &data, parameters: layout.start(start), residuals: None, evaluations: 0 };
    point.evaluate();
    let Some(start_chi2) = point.residuals.as_ref().map(DVector::norm_squared) else {
        return Err(JointError::NoSensor);
    };
    // However the search ends: whether it found a minimum is seen there.
    let (mut end, _) = LevenbergMarquardt::new().with_patience(PATIENCE).minimize(point);
    let (jacobian, r) = end.polish(limits)?;
    report(runs, start, &end, &jacobian, &r, start_chi2, limits)
}

fn check_run(run: &JointRun) -> Result<(), JointError> {
    let name = || run.run.clone();
    if run.trend_order > HIGHEST_TREND {
        return Err(JointError::Trend { run: name(), order: run.trend_order });
    }
    // Three elements of a response per component besides the trend.
    if run.plateaus.len() < run.trend_order + 4 {
        return Err(JointError::TooFewPlateaus { run: name(), plateaus: run.plateaus.len(), order: run.trend_order });
    }
    if let Some(noise_ent) = run.noise_ent.into_iter().find(|noise| !(noise.is_finite() && *noise > 0.0)) {
        return Err(JointError::Noise { run: name(), noise_ent });
    }
    let is_finite = |p: &JointPlateau| {
        let scalars = [p.temperature_degc, p.t_s];
        p.field_coil_nt.iter().chain(&p.reading_ent).chain(&scalars).all(|value| value.is_finite())
    };
    match run.plateaus.iter().position(|p| !is_finite(p)) {
        Some(index) => Err(JointError::NotFinite { run: name(), plateau: index + 1 }),
        None => Ok(()),
    }
}

/// Where the parameters stand: the coefficients of the quantities in powers of the mapped temperature, angles in radians, then
/// for each run the rotation vector from its start, radians.
struct Layout {
    /// First coefficient of each quantity, and the end of the last.
    starts: [usize; 7],
    centre_degc: f64,
    half_range_degc: f64,
    span_degc: [f64; 2],
    runs: usize,
    rows: usize,
    names: Vec<String>,
}

impl Layout {
    fn over(runs: &[JointRun], start: &[Vec<f64>; 6]) -> Result<Self, JointError> {
        if runs.is_empty() {
            return Err(JointError::NoRuns);
        }
        let temperatures = || runs.iter().flat_map(|run| &run.plateaus).map(|p| p.temperature_degc);
        let low = temperatures().fold(f64::INFINITY, f64::min);
        let high = temperatures().fold(f64::NEG_INFINITY, f64::max);
        let mut starts = [0; 7];
        let mut names = Vec::new();
        for (i, (coefficients, quantity)) in start.iter().zip(QUANTITIES).enumerate() {
            if coefficients.is_empty() || coefficients.iter().any(|c| !c.is_finite()) {
                return Err(JointError::Start { quantity });
            }
            let order = coefficients.len() - 1;
            if order > order::HIGHEST_ORDER {
                return Err(FitError::OrderTooHigh { order, highest: order::HIGHEST_ORDER }.into());
            }
            starts[i + 1] = starts[i] + coefficients.len();
            names.extend((0..=order).map(|k| format!("{quantity} T^{k}")));
        }
        for run in runs {
            names.extend(["x", "y", "z"].map(|axis| format!("the rotation of run {} about {axis}", run.run)));
        }
        Ok(Layout {
            starts,
            centre_degc: 0.5 * (low + high),
            half_range_degc: if high > low { 0.5 * (high - low) } else { 1.0 },
            span_degc: [low, high],
            runs: runs.len(),
            rows: runs.iter().map(|run| 3 * run.plateaus.len()).sum(),
            names,
        })
    }

    fn count(&self) -> usize {
        self.starts[6] + 3 * self.runs
    }

    fn range(&self, quantity: usize) -> std::ops::Range<usize> {
        self.starts[quantity]..self.starts[quantity + 1]
    }

    /// Factor from the unit in which a quantity is fitted to the one it is given in.
    fn unit(quantity: usize) -> f64 {
        if quantity < 3 { 1.0 } else { 1f64.to_degrees() }
    }

    /// Column k holds `((T - centre) / half range)^k` in powers of T.
    fn to_raw(&self, count: usize) -> DMatrix<f64> {
        powers_of_line(count, -self.centre_degc / self.half_range_degc, 1.0 / self.half_range_degc)
    }

    /// The start in mapped powers; the rotations start at zero.
    fn start(&self, start: &[Vec<f64>; 6]) -> DVector<f64> {
        let mut parameters = DVector::zeros(self.count());
        for (i, coefficients) in start.iter().enumerate() {
            let to_mapped = powers_of_line(coefficients.len(), self.centre_degc, self.half_range_degc);
            let mapped = to_mapped * DVector::from_column_slice(coefficients) / Self::unit(i);
            parameters.rows_mut(self.starts[i], coefficients.len()).copy_from(&mapped);
        }
        parameters
    }
}

/// Column k holds the coefficients of `(constant + slope x)^k`.
fn powers_of_line(count: usize, constant: f64, slope: f64) -> DMatrix<f64> {
    let mut map = DMatrix::zeros(count, count);
    map[(0, 0)] = 1.0;
    for k in 1..count {
        for j in 0..=k {
            let shifted = if j > 0 { map[(j - 1, k - 1)] } else { 0.0 };
            map[(j, k)] = slope * shifted + constant * map[(j, k - 1)];
        }
    }
    map
}

/// A run made ready.
struct Data {
    /// The applied field along the sensor axes of the start were they orthogonal, `ρ⁻¹ R_nom⁻¹ B_c`, nT.
    fields: Vec<Vector3<f64>>,
    readings: Vec<[f64; 3]>,
    /// Mapped temperatures.
    mapped: Vec<f64>,
    /// Orthonormal columns that span the offset trend.
    trend: DMatrix<f64>,
    noise: [f64; 3],
}

impl Data {
    fn of(run: &JointRun, layout: &Layout) -> Self {
        let to_sensor = run.rho.transpose() * run.r_nom.transpose();
        let plateaus = || run.plateaus.iter();
        let begin = plateaus().map(|p| p.t_s).fold(f64::INFINITY, f64::min);
        let end = plateaus().map(|p| p.t_s).fold(f64::NEG_INFINITY, f64::max);
        let tau = |t_s: f64| if end > begin { 2.0 * (t_s - begin) / (end - begin) - 1.0 } else { 0.0 };
        let powers = DMatrix::from_fn(run.plateaus.len(), run.trend_order + 1, |k, j| tau(run.plateaus[k].t_s).powi(j as i32));
        Data {
            fields: plateaus().map(|p| to_sensor * Vector3::from(p.field_coil_nt)).collect(),
            readings: plateaus().map(|p| p.reading_ent).collect(),
            mapped: plateaus().map(|p| (p.temperature_degc - layout.centre_degc) / layout.half_range_degc).collect(),
            trend: QR::new(powers).q(),
            noise: run.noise_ent,
        }
    }

    fn len(&self) -> usize {
        self.fields.len()
    }

    /// Takes the part along the trend out of a column, one value per plateau.
    fn project(&self, column: &mut [f64]) {
        for direction in self.trend.column_iter() {
            let share: f64 = direction.iter().zip(column.iter()).map(|(a, b)| a * b).sum();
            column.iter_mut().zip(direction.iter()).for_each(|(value, d)| *value -= share * d);
        }
    }
}

/// Columns of `Q(ξ)`, the sensor axes, and the derivatives of the second by ξ_xy and of the third by ξ_xy, ξ_xz, ξ_yz.
struct Axes {
    axes: [Vector3<f64>; 3],
    y_by_xy: Vector3<f64>,
    z_by: [Vector3<f64>; 3],
}

impl Axes {
    fn at(xi: [f64; 3]) -> Result<Self, SplitError> {
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
fn right_jacobian(theta: &Vector3<f64>) -> Matrix3<f64> {
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
struct Point<'a> {
    layout: &'a Layout,
    data: &'a [Data],
    parameters: DVector<f64>,
    /// Modelled minus read, over the noise, trends projected out; rows by run, component, plateau. None outside of the domain.
    residuals: Option<DVector<f64>>,
    evaluations: usize,
}

impl Point<'_> {
    fn polynomial(&self, quantity: usize, mapped: f64) -> f64 {
        self.parameters.as_slice()[self.layout.range(quantity)].iter().rev().fold(0.0, |sum, c| sum * mapped + c)
    }

    fn rotation_vector(&self, run: usize) -> Vector3<f64> {
        self.parameters.fixed_rows::<3>(self.layout.starts[6] + 3 * run).into_owned()
    }

    /// The model without the trend for each plateau of a run, enT.
    fn model(&self, run: usize) -> Option<Vec<[f64; 3]>> {
        let back = Rotation3::new(self.rotation_vector(run)).inverse();
        let data = &self.data[run];
        data.fields
            .iter()
            .zip(&data.mapped)
            .map(|(field, &mapped)| {
                let axes = Axes::at(std::array::from_fn(|i| self.polynomial(3 + i, mapped))).ok()?;
                let field = back * field;
                Some(std::array::from_fn(|i| axes.axes[i].dot(&field) / self.polynomial(i, mapped)))
            })
            .collect()
    }

    fn evaluate(&mut self) {
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
                data.project(column);
                row += data.len();
            }
        }
        self.residuals = residuals.iter().all(|value| value.is_finite()).then_some(residuals);
    }

    /// Derivatives of the model over the noise, trends left in. Rows as the residuals.
    fn derivatives(&self) -> Option<DMatrix<f64>> {
        let layout = self.layout;
        let mut jacobian = DMatrix::zeros(layout.rows, layout.count());
        let mut first = 0;
        for (run, data) in self.data.iter().enumerate() {
            let theta = self.rotation_vector(run);
            let (back, right) = (Rotation3::new(theta).inverse(), right_jacobian(&theta));
            let rotation = layout.starts[6] + 3 * run;
            for (k, (field, &mapped)) in data.fields.iter().zip(&data.mapped).enumerate() {
                let axes = Axes::at(std::array::from_fn(|i| self.polynomial(3 + i, mapped))).ok()?;
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
                    (0..3).for_each(|j| jacobian[(row, rotation + j)] = by_rotation[j]);
                }
            }
            first += 3 * data.len();
        }
        jacobian.iter().all(|value| value.is_finite()).then_some(jacobian)
    }

    /// Takes the trends out of the derivatives.
    fn project(&self, jacobian: &mut DMatrix<f64>) {
        let rotations = self.layout.starts[6];
        let mut row = 0;
        for (run, data) in self.data.iter().enumerate() {
            let own = rotations + 3 * run..rotations + 3 * run + 3;
            for component in 0..3 {
                // Columns of another component or run are zero here.
                let angles = match component {
                    0 => 0..0,
                    1 => self.layout.range(3),
                    _ => self.layout.starts[3]..rotations,
                };
                for j in self.layout.range(component).chain(angles).chain(own.clone()) {
                    data.project(&mut jacobian.column_mut(j).as_mut_slice()[row..row + data.len()]);
                }
                row += data.len();
            }
        }
    }

    /// Gauss-Newton steps while they lead closer; the derivatives at the end and their triangular factor.
    fn polish(&mut self, limits: &Limits) -> Result<(DMatrix<f64>, DMatrix<f64>), JointError> {
        let not_settled = |evaluations| FitError::NotSettled { what: "joint fit", iterations: evaluations };
        let largest = self.data.iter().flat_map(|data| {
            data.readings.iter().map(|read| (0..3).map(|i| (read[i] / data.noise[i]).abs()).fold(0.0, f64::max))
        });
        let rounding = ROUNDING * largest.fold(0.0, f64::max) * (self.layout.rows as f64).sqrt();
        let mut last: Option<Before> = None;
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
            last = Some(Before { size, jacobian, r, parameters: self.parameters.clone() });
            self.parameters -= step;
            self.evaluate();
        }
        Err(not_settled(self.evaluations).into())
    }
}

/// Where a Gauss-Newton step came from.
struct Before {
    size: f64,
    jacobian: DMatrix<f64>,
    r: DMatrix<f64>,
    parameters: DVector<f64>,
}

impl LeastSquaresProblem<f64, Dyn, Dyn> for Point<'_> {
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

fn report(
    runs: &[JointRun],
    start: &[Vec<f64>; 6],
    end: &Point,
    jacobian: &DMatrix<f64>,
    r: &DMatrix<f64>,
    start_chi2: f64,
    limits: &Limits,
) -> Result<Joint, JointError> {
    let layout = end.layout;
    let count = layout.count();
    let condition = check_condition(r, &layout.names, limits)?;
    let not_settled = || FitError::NotSettled { what: "joint fit", iterations: end.evaluations };
    let residuals = end.residuals.as_ref().ok_or_else(not_settled)?;
    let inverse = r.solve_upper_triangular(&DMatrix::identity(count, count)).ok_or_else(not_settled)?;
    let unscaled = &inverse * inverse.transpose();
    let trends: usize = runs.iter().map(|run| 3 * (run.trend_order + 1)).sum();
    let parameters = count + trends;
    if layout.rows < parameters {
        return Err(FitError::TooFewRows { rows: layout.rows, parameters }.into());
    }
    let (chi2, dof) = (residuals.norm_squared(), layout.rows - parameters);
    let steps: Vec<Option<RunStep>> =
        (0..runs.len()).map(|run| RunStep::of(run, end.data, layout, jacobian, residuals)).collect();
    // Elements which the runs alone would have beyond the parameters of the joint fit.
    let own_chi2: f64 = steps.iter().flatten().map(|step| step.chi2).sum();
    let own_dof = (9 * steps.iter().flatten().count()).saturating_sub(count);
    let inflation_within = order::excess(chi2 - own_chi2, dof.saturating_sub(own_dof));
    let between: [Between; 6] = std::array::from_fn(|i| Between::of(i, &steps, layout.range(i).len(), inflation_within));
    // A run turns for what its angles lack, so that the rotations are no surer than those.
    let angles = between[3..].iter().map(|b| b.inflation).fold(1.0, f64::max);
    let inflation = DVector::from_fn(count, |j, _| {
        let quantity = (0..6).find(|i| layout.range(*i).contains(&j));
        inflation_within * quantity.map_or(angles, |i| between[i].inflation)
    });
    let covariance = unscaled.component_mul(&(&inflation * inflation.transpose()));

    let polynomials: [TemperaturePolynomial; 6] = std::array::from_fn(|i| {
        let range = layout.range(i);
        let map = layout.to_raw(range.len()) * Layout::unit(i);
        let own = covariance.view((range.start, range.start), (range.len(), range.len()));
        TemperaturePolynomial {
            coefficients: (&map * end.parameters.rows(range.start, range.len())).as_slice().to_vec(),
            covariance: &map * own * map.transpose(),
            valid_degc: layout.span_degc,
        }
    });
    let change =
        std::array::from_fn(|i| polynomials[i].coefficients.iter().zip(&start[i]).map(|(found, start)| found - start).collect());
    let leverage = jacobian * &inverse;
    let derivatives = end.derivatives().ok_or_else(not_settled)?;
    let mut first = 0;
    let mut results = Vec::with_capacity(runs.len());
    for (index, run) in runs.iter().enumerate() {
        let data = &end.data[index];
        let n = data.len();
        let model = end.model(index).ok_or_else(not_settled)?;
        let rows = |component: usize| (first + component * n, n);
        let theta = end.rotation_vector(index);
        let rho = run.rho * Rotation3::new(theta).matrix();
        let at = layout.starts[6] + 3 * index;
        // Turning is about the axes of the rotation found: ρ exp(J dθ).
        let right = right_jacobian(&theta);
        let turning = right * covariance.fixed_view::<3, 3>(at, at) * right.transpose();
        let (rotation_deg, rotation_std_deg) = rotation_angles(&rho, &turning);
        let mean = |component: usize| {
            let values = model.iter().zip(&data.readings).map(|(model, read)| read[component] - model[component]);
            values.sum::<f64>() / n as f64
        };
        let offset_std = |component: usize| {
            let (row, n) = rows(component);
            let mean = derivatives.rows(row, n).row_mean() * data.noise[component];
            let noise = inflation_within.powi(2) * data.noise[component].powi(2) / n as f64;
            ((&mean * &covariance * mean.transpose())[0] + noise).sqrt()
        };
        let residual_std = |component: usize| {
            let (row, n) = rows(component);
            let sum = residuals.rows(row, n).norm_squared() * data.noise[component].powi(2);
            let free = (n - run.trend_order - 1) as f64 - leverage.rows(row, n).norm_squared();
            if free > 0.0 { (sum / free).sqrt() } else { f64::NAN }
        };
        let residual_ent = (0..n).map(|k| std::array::from_fn(|c| -residuals[rows(c).0 + k] * data.noise[c])).collect();
        let temperatures = || run.plateaus.iter().map(|p| p.temperature_degc);
        results.push(JointRunResult {
            run: run.run.clone(),
            rho,
            rotation_deg,
            rotation_std_deg,
            turned_deg: theta.norm().to_degrees(),
            b_or_ent: std::array::from_fn(mean),
            b_or_std_ent: std::array::from_fn(offset_std),
            residual_std_ent: std::array::from_fn(residual_std),
            residual_ent,
            temperature_degc: [
                temperatures().fold(f64::INFINITY, f64::min),
                temperatures().sum::<f64>() / n as f64,
                temperatures().fold(f64::NEG_INFINITY, f64::max),
            ],
        });
        first += 3 * n;
    }
    Ok(Joint {
        polynomials,
        change,
        runs: results,
        chi2,
        dof,
        start_chi2,
        between,
        inflation_within,
        condition,
        evaluations: end.evaluations,
    })
}

/// The step of one run from the joint fit to what it alone would give: six quantities and three angles.
struct RunStep {
    step: DVector<f64>,
    variance: DVector<f64>,
    /// The χ² it takes away.
    chi2: f64,
}

impl RunStep {
    /// None where the run alone does not determine all nine.
    fn of(run: usize, data: &[Data], layout: &Layout, jacobian: &DMatrix<f64>, residuals: &DVector<f64>) -> Option<Self> {
        let first: usize = data[..run].iter().map(|data| 3 * data.len()).sum();
        let rows = 3 * data[run].len();
        let rotation = layout.starts[6] + 3 * run;
        // The lowest coefficient moves a quantity as a whole.
        let columns: Vec<usize> = layout.starts[..6].iter().copied().chain(rotation..rotation + 3).collect();
        let own = DMatrix::from_fn(rows, columns.len(), |row, j| jacobian[(first + row, columns[j])]);
        let factors = QR::new(own);
        let r = factors.r();
        check_condition(&r, &vec![String::new(); columns.len()], &Limits::default()).ok()?;
        let mut projected = residuals.rows(first, rows).into_owned();
        factors.q_tr_mul(&mut projected);
        let projected = projected.rows(0, columns.len()).into_owned();
        let inverse = r.solve_upper_triangular(&DMatrix::identity(columns.len(), columns.len()))?;
        Some(RunStep {
            step: -(&inverse * &projected),
            variance: DVector::from_fn(columns.len(), |j, _| inverse.row(j).norm_squared()),
            chi2: projected.norm_squared(),
        })
    }
}

impl Between {
    fn of(quantity: usize, steps: &[Option<RunStep>], coefficients: usize, inflation_within: f64) -> Self {
        let unit = Layout::unit(quantity);
        let deviation = steps.iter().map(|step| step.as_ref().map_or(f64::NAN, |step| unit * step.step[quantity])).collect();
        let std = |step: &RunStep| unit * inflation_within * step.variance[quantity].sqrt();
        let known = || steps.iter().flatten();
        let chi2 = known().map(|step| (unit * step.step[quantity] / std(step)).powi(2)).sum();
        let dof = known().count().saturating_sub(coefficients);
        Between {
            deviation,
            std: steps.iter().map(|step| step.as_ref().map_or(f64::INFINITY, std)).collect(),
            chi2,
            dof,
            inflation: order::excess(chi2, dof),
        }
    }
}

/// λ, μ, ν and their standard deviations, degrees, from the covariance of a small turn about the sensor axes, radians².
///
/// First order, except where an axis is turned by less than its uncertainty: there the angle behaves like a length, and the root
/// mean square of its two components is taken.
fn rotation_angles(rho: &Matrix3<f64>, turning: &Matrix3<f64>) -> ([f64; 3], [f64; 3]) {
    let mut angles = [(0.0, 0.0); 3];
    for (i, (angle, std)) in angles.iter_mut().enumerate() {
        let unit = Vector3::from_fn(|row, _| f64::from(u8::from(row == i)));
        // Column i moves by ρ (dθ x e_i).
        let by_turn = rho * -unit.cross_matrix();
        let column = rho.column(i);
        let aside: Vec<usize> = (0..3).filter(|row| *row != i).collect();
        let sine = aside.iter().map(|row| column[*row].powi(2)).sum::<f64>().sqrt();
        *angle = sine.atan2(column[i]);
        let variance = |row: usize| (by_turn.row(row) * turning * by_turn.row(row).transpose())[0];
        let floor = (0.5 * aside.iter().map(|row| variance(*row)).sum::<f64>()).sqrt();
        *std = if *angle > 3.0 * floor {
            let outward =
                aside.iter().fold(-by_turn.row(i) * sine, |sum, row| sum + by_turn.row(*row) * (column[*row] * column[i] / sine));
            (outward * turning * outward.transpose())[0].sqrt()
        } else {
            floor
        };
    }
    (angles.map(|(angle, _)| angle.to_degrees()), angles.map(|(_, std)| std.to_degrees()))
}

#[cfg(test)]
mod tests;
