//! The nine polynomials, fitted to all settings at once.

use super::means::{Means, deviance};
use super::orders::Orders;
use super::refusal::SweepError;
use super::result::{SweepBlock, Turning};
use super::step::Step;
use super::{ANGLES, QUANTITIES};
use crate::data::across::RunRotations;
use crate::data::plateau::Plateau;
use crate::fit::linear::check_condition;
use crate::fit::statistics::std_of;
use crate::fit::{DenseNoise, Design, FitError, Limits};
use crate::measure::joint::{JointPlateau, JointRun, SensorFit, Trend, one_run};
use crate::model::polynomial::TemperaturePolynomial;
use crate::model::sensor::{Split, split};
use crate::record::baseline::Baseline;
use crate::record::conditions::{self, Within};
use nalgebra::{DMatrix, DVector, Matrix3, Vector3};

/// Limits of a fit.
pub(super) const LIMITS: Limits = Limits { max_condition: 1e4 };

/// The settings and what is known of them.
pub(super) struct Problem<'a> {
    /// The run.
    pub run: &'a str,
    /// Nominal orientation.
    pub r_nom: Matrix3<f64>,
    /// The settings that are used.
    pub used: &'a [&'a Plateau],
    /// Their means.
    pub means: &'a Means,
    /// A jump that was taken off the thermistor.
    pub step: Option<Step>,
}

impl Problem<'_> {
    /// Number of settings.
    pub fn settings(&self) -> usize {
        self.used.len()
    }

    /// The fit at temperatures of the settings, °C.
    pub fn fit(&self, degc: &[f64], orders: Orders) -> Result<SensorFit, SweepError> {
        let linear = self.means.baseline(degc, orders.linear());
        let start = Start::of(&linear.design(&self.means.fields_nt, degc)?, &self.means.readings_ent)?;
        let stacked = start.coefficients.as_slice();
        let sensor = |degc: f64| -> Result<Split, SweepError> {
            let parts = linear.at(stacked, degc).0.try_inverse().and_then(|phi| split(&phi, &self.r_nom).ok());
            parts.ok_or(SweepError::NoSensor { degc })
        };
        let mut polynomials: [Vec<f64>; ANGLES.end] = std::array::from_fn(|_| Vec::new());
        for (i, coefficients) in polynomials.iter_mut().enumerate() {
            let degc = nodes(&linear, orders.quantities[i]);
            let value = |t: &f64| sensor(*t).map(|s| if i < ANGLES.start { s.sigma[i] } else { s.xi_deg[i - ANGLES.start] });
            *coefficients = through(&degc, &degc.iter().map(value).collect::<Result<Vec<f64>, _>>()?);
        }
        let plateau = |(i, p): (usize, &&Plateau)| JointPlateau {
            field_coil_nt: self.means.fields_nt[i],
            reading_ent: p.mean.0,
            temperature_degc: degc[i],
            t_s: p.t_s(),
        };
        let offsets = std::array::from_fn(|i| orders.quantities[ANGLES.end + i]);
        let run = JointRun {
            run: self.run.to_owned(),
            r_nom: self.r_nom,
            rho: sensor(linear.middle())?.rho,
            plateaus: self.used.iter().enumerate().map(plateau).collect(),
            trend: Trend::Temperature(offsets),
            rotation_order: orders.rotation,
            noise_ent: start.noise_ent,
        };
        Ok(one_run(&run, &polynomials, &LIMITS)?)
    }

    /// Minus twice the log likelihood of a fit.
    pub fn deviance(&self, fit: &SensorFit) -> f64 {
        deviance(std::array::from_fn(|i| fit.residual_ent.column(i).norm_squared()), self.settings())
    }

    /// The noise of the settings, from what happens within them and from what a fit leaves: to first order its parameters are those of a
    /// linear model with polynomials of the same orders.
    pub fn noise(&self, fit: &SensorFit, degc: &[f64], orders: Orders) -> Result<DenseNoise, FitError> {
        let linear = self.means.baseline(degc, orders.linear());
        let mut solution = linear.fit(&self.means.fields_nt, degc, &self.means.readings_ent, &LIMITS)?;
        let std = |i: usize| fit.residual_ent.column(i).norm() / (solution.dof as f64).sqrt();
        solution.residual_std = (0..3).map(std).collect();
        solution.residuals.copy_from(&fit.residual_ent);
        conditions::noise(&solution, self.used, Within::Drift)
    }

    /// The settings with what a fit leaves of them.
    pub fn blocks(&self, fit: &SensorFit, degc: &[f64]) -> Vec<SweepBlock> {
        let block = |(p, degc): (&&Plateau, &f64)| {
            let modelled = fit.sensor(*degc).map(|(sensor, b_or)| sensor.field(p.mean, b_or).0);
            let residual_nt = modelled.map_or([f64::NAN; 3], |m| std::array::from_fn(|k| p.setting.field.0[k] - m[k]));
            SweepBlock { t_s: p.t_s(), temperature_degc: *degc, residual_nt }
        };
        self.used.iter().zip(degc).map(block).collect()
    }
}

/// Where the search for the polynomials starts: a linear model in plain numbers, whose last digits do not matter.
struct Start {
    coefficients: DMatrix<f64>,
    /// What it leaves of a component.
    noise_ent: [f64; 3],
}

impl Start {
    fn of(design: &Design, readings_ent: &DMatrix<f64>) -> Result<Self, FitError> {
        let (rows, parameters) = design.columns().shape();
        if rows <= parameters {
            return Err(FitError::TooFewRows { rows, parameters });
        }
        let factors = design.columns().clone().qr();
        let r = factors.r();
        check_condition(&r, design.names(), &LIMITS)?;
        let mut turned = readings_ent.clone();
        factors.q_tr_mul(&mut turned);
        let undetermined = || FitError::Undetermined { parameters: design.names().to_vec(), condition: f64::INFINITY };
        let coefficients = r.solve_upper_triangular(&turned.rows(0, parameters)).ok_or_else(undetermined)?;
        let left = |i: usize| turned.column(i).rows(parameters, rows - parameters).norm();
        Ok(Self { coefficients, noise_ent: std::array::from_fn(|i| left(i) / ((rows - parameters) as f64).sqrt()) })
    }
}

/// Changes of the parameters of a fit by what the facility does not know better, type B, a column each: `moved_nt` are changes of the fields of
/// the settings, nT, coil axes, each by one standard deviation that is independent of the others. The lag stays.
pub(super) fn of_facility(fit: &SensorFit, degc: &[f64], moved_nt: &[Vec<[f64; 3]>]) -> Result<DMatrix<f64>, SweepError> {
    let influence = fit.influence(None)?;
    let response =
        |degc: &f64| fit.sensor(*degc).map(|(sensor, _)| *sensor.response()).map_err(|_| SweepError::NoSensor { degc: *degc });
    let responses: Vec<Matrix3<f64>> = degc.iter().map(response).collect::<Result<_, _>>()?;
    let mut all = DMatrix::zeros(fit.count(), moved_nt.len());
    for (place, moved) in moved_nt.iter().enumerate() {
        // The readings stay and the fields move, which is as if the readings of the same fields had moved.
        let changes: Vec<Vector3<f64>> = responses.iter().zip(moved).map(|(a, nt)| a * Vector3::from(*nt)).collect();
        let mut parameters = DVector::zeros(fit.count());
        for (component, rows) in influence.iter().enumerate() {
            parameters += rows * DVector::from_iterator(changes.len(), changes.iter().map(|c| c[component]));
        }
        all.set_column(place, &parameters);
    }
    Ok(all)
}

/// The polynomials of a fit in the order of [`QUANTITIES`], with the covariance of all its parameters.
pub(super) fn polynomials(fit: &SensorFit, covariance: &DMatrix<f64>) -> [TemperaturePolynomial; QUANTITIES.len()] {
    std::array::from_fn(|k| {
        let own = fit.range(k);
        TemperaturePolynomial {
            coefficients: fit.coefficients(k),
            covariance: covariance.view((own.start, own.start), (own.len(), own.len())).into_owned(),
            valid_degc: fit.valid_degc,
        }
    })
}

/// Covariance of the coefficients of all polynomials, one after the other, from that of all parameters of a fit.
pub(super) fn together(fit: &SensorFit, covariance: &DMatrix<f64>) -> DMatrix<f64> {
    let places: Vec<usize> = (0..QUANTITIES.len()).flat_map(|k| fit.range(k)).collect();
    DMatrix::from_fn(places.len(), places.len(), |row, column| covariance[(places[row], places[column])])
}

/// Rotation at the middle temperature.
pub(super) fn rotation(fit: &SensorFit, covariance: &DMatrix<f64>) -> RunRotations {
    let (angle, std) = fit.rotation_deg(covariance);
    RunRotations {
        lambda_x_deg: vec![angle[0]],
        mu_y_deg: vec![angle[1]],
        nu_z_deg: vec![angle[2]],
        lambda_x_std_deg: vec![std[0]],
        mu_y_std_deg: vec![std[1]],
        nu_z_std_deg: vec![std[2]],
        initial: None,
    }
}

/// How the sensor is turned at the highest temperature against the lowest.
pub(super) fn turning(fit: &SensorFit, covariance: &DMatrix<f64>, order: usize) -> Turning {
    let [low, high] = fit.valid_degc.map(|degc| fit.rho(degc));
    let difference = low.transpose() * high - Matrix3::identity();
    // The sine of half the angle of a rotation is its distance from none over √8.
    let angle = 2.0 * (difference.norm() / 8f64.sqrt()).min(1.0).asin();
    // The mapped temperature goes from -1 to 1, so that odd powers change by 2 times their rotation vector, and to first order the angle by
    // what moves them along the axis of the turn.
    let (at, values) = (fit.turn().start, fit.values());
    let odd: Vec<usize> = (1..=order).step_by(2).map(|power| at + 3 * power).collect();
    let turned: Vector3<f64> = odd.iter().map(|k| values.fixed_rows::<3>(*k).into_owned()).sum();
    let axis = turned.try_normalize(0.0).unwrap_or_else(Vector3::x);
    let block = |row: usize, column: usize| axis.dot(&(covariance.fixed_view::<3, 3>(row, column) * axis));
    let variance: f64 =
        odd.iter().flat_map(|row| odd.iter().map(move |column| (*row, *column))).map(|(r, c)| 4.0 * block(r, c)).sum();
    Turning { order, angle_deg: angle.to_degrees(), std_deg: std_of(variance).to_degrees() }
}

/// Temperatures through which a polynomial goes that errs least between them, °C.
fn nodes(baseline: &Baseline, order: usize) -> Vec<f64> {
    let angle = |k: usize| std::f64::consts::PI * (k as f64 + 0.5) / (order + 1) as f64;
    (0..=order).map(|k| baseline.middle() + baseline.half() * angle(k).cos()).collect()
}

/// Coefficients of the polynomial through as many points, lowest order first: Newton's divided differences.
fn through(x: &[f64], y: &[f64]) -> Vec<f64> {
    let mut differences = y.to_vec();
    for k in 1..x.len() {
        for i in (k..x.len()).rev() {
            differences[i] = (differences[i] - differences[i - 1]) / (x[i] - x[i - k]);
        }
    }
    let mut coefficients: Vec<f64> = Vec::new();
    for (difference, x) in differences.iter().zip(x).rev() {
        // Times (T - x), plus the difference.
        let mut next = vec![0.0; coefficients.len() + 1];
        for (k, c) in coefficients.iter().enumerate() {
            next[k + 1] += c;
            next[k] -= c * x;
        }
        next[0] += difference;
        coefficients = next;
    }
    coefficients.truncate(x.len());
    coefficients
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polynomial_through_points_has_their_coefficients() {
        let cubic = |t: f64| 2.0 - 0.5 * t + 0.25 * t * t - 0.125 * t * t * t;
        let x = [-3.0, -1.0, 0.5, 4.0];
        let found = through(&x, &x.map(cubic));
        for (found, expected) in found.iter().zip([2.0, -0.5, 0.25, -0.125]) {
            assert!((found - expected).abs() < 1e-13, "{found}");
        }
        assert_eq!(through(&[7.0], &[3.0]), [3.0]);
    }
}
