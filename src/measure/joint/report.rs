//! What the joint fit says at the end of its search: polynomials, their covariances, the scatter between the runs, and the runs.

use super::layout::{Layout, RunRows};
use super::search::{SearchPoint, right_jacobian};
use super::{BetweenRuns, JointError, JointFit, JointRun, JointRunResult};
use crate::fit::linear::check_condition;
use crate::fit::{FitError, Limits, order};
use crate::model::polynomial::TemperaturePolynomial;
use nalgebra::linalg::QR;
use nalgebra::{DMatrix, DVector, Matrix3, Rotation3, Vector3};

/// The result at the end of the search: covariances with their inflation, polynomials in powers of °C, and the runs.
pub(super) fn report(
    runs: &[JointRun],
    start: &[Vec<f64>; 6],
    end: &SearchPoint,
    jacobian: &DMatrix<f64>,
    r: &DMatrix<f64>,
    start_chi2: f64,
    limits: &Limits,
) -> Result<JointFit, JointError> {
    let layout = end.layout;
    let count = layout.count();
    let condition = check_condition(r, &layout.names, limits)?;
    let not_settled = || FitError::NotSettled { what: "joint fit", iterations: end.evaluations };
    let residuals = end.residuals.as_ref().ok_or_else(not_settled)?;
    let inverse = r.solve_upper_triangular(&DMatrix::identity(count, count)).ok_or_else(not_settled)?;
    let unscaled = &inverse * inverse.transpose();
    let trends: usize = runs.iter().map(|run| run.trend.count()).sum();
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
    let between: [BetweenRuns; 6] = std::array::from_fn(|i| BetweenRuns::of(i, &steps, layout.range(i).len(), inflation_within));
    // A run whose angles disagree turns to make up for it: its rotation is as uncertain as the angles are.
    let angles = between[3..].iter().map(|b| b.inflation).fold(1.0, f64::max);
    let inflation = DVector::from_fn(count, |j, _| {
        let quantity = (0..6).find(|i| layout.range(*i).contains(&j));
        inflation_within * quantity.map_or(angles, |i| between[i].inflation)
    });
    let covariance = unscaled.component_mul(&(&inflation * inflation.transpose()));

    let coefficients = layout.starts[6];
    let mut told = DMatrix::zeros(coefficients, coefficients);
    for i in 0..6 {
        let range = layout.range(i);
        let own = layout.to_raw(range.len()) * Layout::unit(i);
        told.view_mut((range.start, range.start), own.shape()).copy_from(&own);
    }
    let values = &told * end.parameters.rows(0, coefficients);
    let of_coefficients = &told * covariance.view((0, 0), (coefficients, coefficients)) * told.transpose();
    let polynomials: [TemperaturePolynomial; 6] = std::array::from_fn(|i| {
        let range = layout.range(i);
        TemperaturePolynomial {
            coefficients: values.as_slice()[range.clone()].to_vec(),
            covariance: of_coefficients.view((range.start, range.start), (range.len(), range.len())).into_owned(),
            valid_degc: layout.span_degc,
        }
    });
    let change =
        std::array::from_fn(|i| polynomials[i].coefficients.iter().zip(&start[i]).map(|(found, start)| found - start).collect());
    let results = RunReport { end, runs, covariance: &covariance, leverage: jacobian * &inverse, inflation_within }.all()?;
    Ok(JointFit {
        polynomials,
        covariance: of_coefficients,
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

/// What the result of one run is made from.
struct RunReport<'a> {
    end: &'a SearchPoint<'a>,
    runs: &'a [JointRun],
    /// Of all parameters, inflated.
    covariance: &'a DMatrix<f64>,
    /// Derivatives times the inverse of their triangular factor: the squared norm of a row is the leverage of that reading.
    leverage: DMatrix<f64>,
    inflation_within: f64,
}

impl RunReport<'_> {
    /// The results of all runs in their order.
    fn all(&self) -> Result<Vec<JointRunResult>, JointError> {
        let not_settled = || FitError::NotSettled { what: "joint fit", iterations: self.end.evaluations };
        let residuals = self.end.residuals.as_ref().ok_or_else(not_settled)?;
        let derivatives = self.end.derivatives().ok_or_else(not_settled)?;
        let mut first = 0;
        let mut results = Vec::with_capacity(self.runs.len());
        for index in 0..self.runs.len() {
            let model = self.end.model(index).ok_or_else(not_settled)?;
            results.push(self.one(index, first, &model, residuals, &derivatives));
            first += 3 * self.end.data[index].len();
        }
        Ok(results)
    }

    /// The result of one run, whose rows begin at `first`.
    fn one(
        &self,
        index: usize,
        first: usize,
        model: &[[f64; 3]],
        residuals: &DVector<f64>,
        derivatives: &DMatrix<f64>,
    ) -> JointRunResult {
        let (run, data) = (&self.runs[index], &self.end.data[index]);
        let n = data.len();
        let rows = |component: usize| (first + component * n, n);
        let theta = self.end.rotation_vector(index, 0.0);
        let rho = run.rho * Rotation3::new(theta).matrix();
        let at = self.end.layout.turn(index).start;
        // The rotation found is turned about its own axes: ρ exp(J dθ).
        let right = right_jacobian(&theta);
        let turning = right * self.covariance.fixed_view::<3, 3>(at, at) * right.transpose();
        let (rotation_deg, rotation_std_deg) = rotation_angles(&rho, &turning);
        let mean = |component: usize| {
            let values = model.iter().zip(&data.readings).map(|(model, read)| read[component] - model[component]);
            values.sum::<f64>() / n as f64
        };
        let offset_std = |component: usize| {
            let (row, n) = rows(component);
            let mean = derivatives.rows(row, n).row_mean() * data.noise[component];
            let noise = self.inflation_within.powi(2) * data.noise[component].powi(2) / n as f64;
            ((&mean * self.covariance * mean.transpose())[0] + noise).sqrt()
        };
        let residual_std = |component: usize| {
            let (row, n) = rows(component);
            let sum = residuals.rows(row, n).norm_squared() * data.noise[component].powi(2);
            let free = (n - run.trend.order(component) - 1) as f64 - self.leverage.rows(row, n).norm_squared();
            if free > 0.0 { (sum / free).sqrt() } else { f64::NAN }
        };
        let temperatures = || run.plateaus.iter().map(|p| p.temperature_degc);
        JointRunResult {
            run: run.run.clone(),
            rho,
            rotation_deg,
            rotation_std_deg,
            turned_deg: theta.norm().to_degrees(),
            b_or_ent: std::array::from_fn(mean),
            b_or_std_ent: std::array::from_fn(offset_std),
            residual_std_ent: std::array::from_fn(residual_std),
            residual_ent: (0..n).map(|k| std::array::from_fn(|c| -residuals[rows(c).0 + k] * data.noise[c])).collect(),
            temperature_degc: [
                temperatures().fold(f64::INFINITY, f64::min),
                temperatures().sum::<f64>() / n as f64,
                temperatures().fold(f64::NEG_INFINITY, f64::max),
            ],
        }
    }
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
    fn of(run: usize, data: &[RunRows], layout: &Layout, jacobian: &DMatrix<f64>, residuals: &DVector<f64>) -> Option<Self> {
        let first: usize = data[..run].iter().map(|data| 3 * data.len()).sum();
        let rows = 3 * data[run].len();
        let rotation = layout.turn(run).start;
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

impl BetweenRuns {
    fn of(quantity: usize, steps: &[Option<RunStep>], coefficients: usize, inflation_within: f64) -> Self {
        let unit = Layout::unit(quantity);
        let deviation = steps.iter().map(|step| step.as_ref().map_or(f64::NAN, |step| unit * step.step[quantity])).collect();
        let std = |step: &RunStep| unit * inflation_within * step.variance[quantity].sqrt();
        let known = || steps.iter().flatten();
        let chi2 = known().map(|step| (unit * step.step[quantity] / std(step)).powi(2)).sum();
        let dof = known().count().saturating_sub(coefficients);
        BetweenRuns {
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
pub(super) fn rotation_angles(rho: &Matrix3<f64>, turning: &Matrix3<f64>) -> ([f64; 3], [f64; 3]) {
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
