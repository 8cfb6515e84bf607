//! One run whose temperature moves over the whole range while it lasts: sensitivities, angles and offsets are polynomials of the
//! temperature, and the mount may turn with it.
//!
//! Beside the coefficients stands how every one of them follows from every reading. Whoever knows the noise of the readings has the
//! covariance of all of them from that, and of what else the same readings tell, such as the lag of a thermistor.

use super::layout::{Layout, RunRows};
use super::report::rotation_angles;
use super::search::{SearchPoint, right_jacobian};
use super::{JointError, JointRun, QUANTITIES, check_run};
use crate::fit::{FitError, Limits};
use crate::model::sensor::{Linear, SplitError, compose};
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3};
use std::ops::Range;

/// Quantities with a polynomial: those of [`QUANTITIES`], then the offsets of x, y and z, enT.
const POLYNOMIALS: usize = 9;

/// The sensor of one run as a function of the temperature.
///
/// Its parameters are the coefficients of the six quantities in powers of °C, the rotation vectors per power of the temperature, and the
/// coefficients of the offsets of x, y and z in powers of °C.
pub struct SensorFit {
    layout: Layout,
    rows: [RunRows; 1],
    r_nom: Matrix3<f64>,
    rho: Matrix3<f64>,
    orders: [usize; 3],
    /// Polynomials of mapped temperatures, rotation vectors in radians.
    parameters: DVector<f64>,
    /// The offsets in powers of the mapped temperature, one component after the other.
    offsets_ent: DVector<f64>,
    /// Derivatives by parameters and offsets over the noise; rows by component, then plateau.
    jacobian: DMatrix<f64>,
    /// Reading minus model, enT: a row per plateau, a column per component.
    pub residual_ent: DMatrix<f64>,
    /// Lowest and highest temperature, °C.
    pub valid_degc: [f64; 2],
}

/// Fits the sensor of one run; `start` as for [`joint`](super::joint()). An offset in time takes part as polynomials of the temperature do.
///
/// # Errors
/// [`JointError`]: input that does not fit together, and parameters which the run does not determine, by name.
pub fn one_run(run: &JointRun, start: &[Vec<f64>; 6], limits: &Limits) -> Result<SensorFit, JointError> {
    check_run(run)?;
    let layout = Layout::over(std::slice::from_ref(run), start)?;
    let rows = [RunRows::of(run, &layout)];
    let orders = std::array::from_fn(|component| run.trend.order(component));
    let found = SearchPoint::start(&layout, &rows, start).minimum(limits)?;
    let not_settled = FitError::NotSettled { what: "joint fit", iterations: found.end.evaluations };
    let (Some(model), Some(derivatives)) = (found.end.model(0), found.end.derivatives()) else {
        return Err(not_settled.into());
    };
    let data = &rows[0];
    let n = data.len();
    let columns: usize = orders.iter().map(|order| order + 1).sum();
    if 3 * n <= layout.count() + columns {
        return Err(FitError::TooFewRows { rows: 3 * n, parameters: layout.count() + columns }.into());
    }
    let mut residual_ent = DMatrix::from_fn(n, 3, |k, c| data.readings[k][c] - model[k][c]);
    let mut jacobian = derivatives.resize_horizontally(layout.count() + columns, 0.0);
    let mut offsets_ent = DVector::zeros(columns);
    let mut first = 0;
    for (component, order) in orders.into_iter().enumerate() {
        let powers = DMatrix::from_fn(n, order + 1, |k, j| data.mapped[k].powi(j as i32));
        let factors = QR::new(powers.clone());
        let own = factors.r().solve_upper_triangular(&factors.q().tr_mul(&residual_ent.column(component)));
        let own = own.ok_or_else(|| not_settled.clone())?;
        let left = residual_ent.column(component) - &powers * &own;
        residual_ent.set_column(component, &left);
        offsets_ent.rows_mut(first, order + 1).copy_from(&own);
        let place = (component * n, layout.count() + first);
        jacobian.view_mut(place, powers.shape()).copy_from(&(powers / data.noise[component]));
        first += order + 1;
    }
    let parameters = found.end.parameters;
    let valid_degc = layout.span_degc;
    let (r_nom, rho) = (run.r_nom, run.rho);
    Ok(SensorFit { layout, rows, r_nom, rho, orders, parameters, offsets_ent, jacobian, residual_ent, valid_degc })
}

impl SensorFit {
    /// Number of parameters.
    #[must_use]
    pub fn count(&self) -> usize {
        self.jacobian.ncols()
    }

    /// Where the coefficients of a polynomial stand among the parameters: 0 to 5 as in [`QUANTITIES`], 6 to 8 the offsets.
    #[must_use]
    pub fn range(&self, polynomial: usize) -> Range<usize> {
        let Some(component) = polynomial.checked_sub(QUANTITIES.len()) else { return self.layout.range(polynomial) };
        let before: usize = self.orders[..component].iter().map(|order| order + 1).sum();
        let first = self.layout.count() + before;
        first..first + self.orders[component] + 1
    }

    /// Where the rotation vectors stand among the parameters: one per power of the mapped temperature, radians.
    #[must_use]
    pub fn turn(&self) -> Range<usize> {
        self.layout.turn(0)
    }

    /// From the parameters of the fit to those that are told.
    fn told(&self) -> DMatrix<f64> {
        let mut map = DMatrix::identity(self.count(), self.count());
        for polynomial in 0..POLYNOMIALS {
            let range = self.range(polynomial);
            let unit = if polynomial < QUANTITIES.len() { Layout::unit(polynomial) } else { 1.0 };
            let own = self.layout.to_raw(range.len()) * unit;
            map.view_mut((range.start, range.start), own.shape()).copy_from(&own);
        }
        map
    }

    fn fitted(&self) -> DVector<f64> {
        DVector::from_iterator(self.count(), self.parameters.iter().chain(self.offsets_ent.iter()).copied())
    }

    /// The parameters.
    #[must_use]
    pub fn values(&self) -> DVector<f64> {
        self.told() * self.fitted()
    }

    /// Coefficients of a polynomial in powers of °C, lowest order first.
    #[must_use]
    pub fn coefficients(&self, polynomial: usize) -> Vec<f64> {
        self.values().as_slice()[self.range(polynomial)].to_vec()
    }

    fn point(&self) -> SearchPoint<'_> {
        let parameters = self.parameters.clone();
        SearchPoint { layout: &self.layout, data: &self.rows, parameters, residuals: None, evaluations: 0 }
    }

    fn offset_ent(&self, component: usize, mapped: f64) -> f64 {
        let first = self.layout.count();
        let own = self.range(QUANTITIES.len() + component);
        self.offsets_ent.as_slice()[own.start - first..own.end - first].iter().rev().fold(0.0, |sum, c| sum * mapped + c)
    }

    /// What the plateaus would read at other temperatures, °C, enT: a row per plateau. `None` where there is no sensor.
    #[must_use]
    pub fn readings_ent(&self, degc: &[f64]) -> Option<DMatrix<f64>> {
        let mapped: Vec<f64> = degc.iter().map(|t| self.layout.mapped(*t)).collect();
        let model = self.point().model_at(0, &mapped)?;
        Some(DMatrix::from_fn(model.len(), 3, |k, c| model[k][c] + self.offset_ent(c, mapped[k])))
    }

    /// Rotation of the real against the nominal orientation at a temperature.
    #[must_use]
    pub fn rho(&self, degc: f64) -> Matrix3<f64> {
        self.rho * Rotation3::new(self.point().rotation_vector(0, self.layout.mapped(degc))).matrix()
    }

    /// The sensor at a temperature, with its offset, enT.
    ///
    /// # Errors
    /// Angles that no three axes have between them, or a sensitivity of zero.
    pub fn sensor(&self, degc: f64) -> Result<(Linear, [f64; 3]), SplitError> {
        let (point, mapped) = (self.point(), self.layout.mapped(degc));
        let sigma = std::array::from_fn(|i| point.polynomial(i, mapped));
        let xi_deg = std::array::from_fn(|i| point.polynomial(3 + i, mapped).to_degrees());
        let sensor = Linear::new(compose(&self.r_nom, &self.rho(degc), xi_deg, sigma)?)?;
        Ok((sensor, std::array::from_fn(|c| self.offset_ent(c, mapped))))
    }

    /// Angles λ, μ, ν between each real and nominal sensor axis at the middle temperature, degrees, and their standard deviations from
    /// the covariance of all parameters.
    #[must_use]
    pub fn rotation_deg(&self, covariance: &DMatrix<f64>) -> ([f64; 3], [f64; 3]) {
        let (theta, at) = (self.point().rotation_vector(0, 0.0), self.turn().start);
        let right = right_jacobian(&theta);
        let turning = right * covariance.fixed_view::<3, 3>(at, at) * right.transpose();
        rotation_angles(&self.rho(self.layout.centre_degc), &turning)
    }

    /// How the parameters follow from the readings: per component a row per parameter, a column per plateau. `beside` are the derivatives
    /// of the readings by one more parameter, a row per plateau and a column per component; it is the last one then.
    ///
    /// # Errors
    /// [`FitError::Undetermined`]: the parameter beside cannot be told from the others.
    pub fn influence(&self, beside: Option<&DMatrix<f64>>) -> Result<[DMatrix<f64>; 3], FitError> {
        let (n, noise) = (self.rows[0].len(), self.rows[0].noise);
        let mut jacobian = self.jacobian.clone();
        let mut told = self.told();
        if let Some(beside) = beside {
            let count = self.count();
            jacobian = jacobian.insert_column(count, 0.0);
            for component in 0..3 {
                let column = beside.column(component) / noise[component];
                jacobian.view_mut((component * n, count), (n, 1)).copy_from(&column);
            }
            told = told.resize(count + 1, count + 1, 0.0);
            told[(count, count)] = 1.0;
        }
        let scales = DVector::from_iterator(jacobian.ncols(), jacobian.column_iter().map(|c| c.norm()));
        let undetermined = || FitError::Undetermined { parameters: vec!["the lag".to_owned()], condition: f64::INFINITY };
        if scales.iter().any(|s| !(*s > 0.0 && s.is_finite())) {
            return Err(undetermined());
        }
        jacobian.column_iter_mut().zip(scales.iter()).for_each(|(mut column, s)| column /= *s);
        let factors = QR::new(jacobian);
        let mut pseudo_inverse =
            factors.r().solve_upper_triangular(&factors.q().transpose()).filter(|m| m.iter().all(|v| v.is_finite()));
        let pseudo_inverse = pseudo_inverse.as_mut().ok_or_else(undetermined)?;
        pseudo_inverse.row_iter_mut().zip(scales.iter()).for_each(|(mut row, s)| row /= *s);
        let all = told * &*pseudo_inverse;
        Ok(std::array::from_fn(|component| all.columns(component * n, n) / noise[component]))
    }

    /// Squared residuals over the noise per component if only some parameters were free and the others zero, to first order. Lower orders
    /// of a polynomial are its higher coefficients at zero. `None` where those that are free depend on each other.
    #[must_use]
    pub fn squares_with(&self, information: &DMatrix<f64>, free: &[bool]) -> Option<[f64; 3]> {
        let (n, noise) = (self.rows[0].len(), self.rows[0].noise);
        let kept: Vec<usize> = (0..free.len()).filter(|j| free[*j]).collect();
        let out: Vec<usize> = (0..free.len()).filter(|j| !free[*j]).collect();
        let fitted = self.fitted();
        let dropped = DVector::from_iterator(out.len(), out.iter().map(|j| fitted[*j]));
        let own = DMatrix::from_fn(kept.len(), kept.len(), |i, j| information[(kept[i], kept[j])]);
        let shared = DMatrix::from_fn(kept.len(), out.len(), |i, j| information[(kept[i], out[j])]);
        let moved = own.cholesky()?.solve(&(shared * &dropped));
        let mut step = DVector::zeros(free.len());
        kept.iter().zip(moved.iter()).for_each(|(j, v)| step[*j] = *v);
        out.iter().zip(dropped.iter()).for_each(|(j, v)| step[*j] = -*v);
        let change = &self.jacobian * step;
        let left = |c: usize| (0..n).map(|k| (self.residual_ent[(k, c)] / noise[c] - change[c * n + k]).powi(2)).sum();
        Some(std::array::from_fn(left))
    }

    /// `JᵀJ` of the derivatives over the noise.
    #[must_use]
    pub fn information(&self) -> DMatrix<f64> {
        self.jacobian.tr_mul(&self.jacobian)
    }
}
