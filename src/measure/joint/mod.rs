//! The joint fit: one temperature-dependent sensor for the plateaus of all runs at once.
//!
//! `B_r = σ(T)⁻¹ ω(ξ(T))⁻¹ ρ⁻¹ R_nom⁻¹ B_c + offset(τ)`, the model of BC-MAG-TR-0085 section 15.1 with `σ_i` and `ξ_ij`
//! polynomials of the temperature at each plateau, so that a temperature which moves within a run counts as it was. Each run has
//! its own rotation ρ, since a sensor is mounted anew, and its own offset trend, since the residual field is part of it. The two
//! steps, runs first and polynomials through their parameters after, are the start and the comparison.
//!
//! Offset trends are linear parameters: projecting them out of readings and derivatives (variable projection) leaves the
//! polynomials and three angles per run. A continuous sweep is one run of this kind whose offset is a polynomial of the temperature as
//! well, and whose rotation may be one ([`one_run`](fn@one_run)). Levenberg-Marquardt leads to the minimum, Gauss-Newton steps to its last digits. The
//! factorisations are plain `f64`: the columns are scaled and the temperature mapped to \[-1, 1\], and thousands of rows by a
//! hundred columns in higher precision would take seconds for digits below the noise.

mod layout;
mod one_run;
mod report;
mod search;

use crate::fit::{FitError, Limits};
use crate::model::polynomial::TemperaturePolynomial;
use layout::{Layout, RunRows};
use nalgebra::{DMatrix, Matrix3};
pub use one_run::{SensorFit, one_run};
use report::report;
use search::{Minimum, SearchPoint};
use thiserror::Error;

/// The quantities with a polynomial, in the order of every array: sensitivities, nT/enT, then angles between the axes, degrees.
pub const QUANTITIES: [&str; 6] = ["sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz"];
/// Highest order of an offset trend.
const HIGHEST_TREND: usize = 2;

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

/// What the offset of a run is a polynomial of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Trend {
    /// Of the time, of an order 0 to 2: the drift of a run that is short beside changes of the temperature.
    Time(usize),
    /// Of the temperature at each plateau, with the order of each component.
    Temperature([usize; 3]),
}

impl Trend {
    /// The order of a component.
    fn order(self, component: usize) -> usize {
        match self {
            Trend::Time(order) => order,
            Trend::Temperature(orders) => orders[component],
        }
    }

    /// The highest order of the components.
    fn highest(self) -> usize {
        (0..3).map(|component| self.order(component)).fold(0, usize::max)
    }

    /// Coefficients of all components.
    fn count(self) -> usize {
        (0..3).map(|component| self.order(component) + 1).sum()
    }
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
    /// The offset.
    pub trend: Trend,
    /// Order of the polynomials of the temperature that the rotation vector from `rho` is, for a mount that turns with it.
    pub rotation_order: usize,
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
pub struct BetweenRuns {
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
pub struct JointFit {
    /// Polynomials as in [`QUANTITIES`]; their covariance includes the inflation of [`BetweenRuns`] and by the scatter within runs.
    pub polynomials: [TemperaturePolynomial; 6],
    /// Covariance of all their coefficients, one quantity after the other.
    pub covariance: DMatrix<f64>,
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
    pub between: [BetweenRuns; 6],
    /// Factor on the given noise for the scatter within the runs: `sqrt(χ²/dof)` of what a sensor free in every run would leave,
    /// where that χ² exceeds its 99 % quantile, otherwise 1. No standard deviation is without it.
    pub inflation_within: f64,
    /// Condition number of the derivatives with columns of unit norm.
    pub condition: f64,
    /// Points at which the model was evaluated.
    pub evaluations: usize,
}

impl JointFit {
    /// With the uncertainties of the polynomials wider by a factor each: what polynomials leave out whose orders were chosen elsewhere shows in no
    /// residual of them.
    #[must_use]
    pub fn widened(mut self, factors: &[f64; 6]) -> Self {
        let of: Vec<f64> =
            self.polynomials.iter().zip(factors).flat_map(|(p, factor)| vec![*factor; p.coefficients.len()]).collect();
        self.polynomials.iter_mut().zip(factors).for_each(|(p, factor)| p.covariance *= factor * factor);
        self.covariance = DMatrix::from_fn(of.len(), of.len(), |r, c| self.covariance[(r, c)] * of[r] * of[c]);
        self
    }
}

/// Fits the sensor to all plateaus of all runs at once.
///
/// `start` are the coefficients of [`QUANTITIES`], lowest order first, from the polynomials through the parameters of the runs;
/// their numbers are the orders that are fitted.
///
/// # Errors
/// [`JointError`]: input that does not fit together, and parameters which the runs do not determine, by name.
pub fn joint(runs: &[JointRun], start: &[Vec<f64>; 6], limits: &Limits) -> Result<JointFit, JointError> {
    runs.iter().try_for_each(check_run)?;
    let layout = Layout::over(runs, start)?;
    let data: Vec<RunRows> = runs.iter().map(|run| RunRows::of(run, &layout)).collect();
    let found = SearchPoint::start(&layout, &data, start).minimum(limits)?;
    let Minimum { end, jacobian, r, start_chi2 } = &found;
    report(runs, start, end, jacobian, r, *start_chi2, limits)
}

fn check_run(run: &JointRun) -> Result<(), JointError> {
    let name = || run.run.clone();
    if let Trend::Time(order) = run.trend
        && order > HIGHEST_TREND
    {
        return Err(JointError::Trend { run: name(), order });
    }
    // Three elements of a response per component besides the trend.
    let order = run.trend.highest();
    if run.plateaus.len() < order + 4 {
        return Err(JointError::TooFewPlateaus { run: name(), plateaus: run.plateaus.len(), order });
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

#[cfg(test)]
mod tests;
