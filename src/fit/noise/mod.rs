//! The noise of the means that a fit explains, estimated from its residuals and from the samples inside the means.
//!
//! Two forms of the estimate stand behind one interface, [`NoiseModel`], with the same parameters, [`NoiseParameters`], and the same slow noise,
//! a sum of relaxations: they give the same likelihood for the same data. They differ in what they ask and at which cost:
//!
//! * [`dense`]: white noise that may grow with the reading, and slow noise of several exponents, with a dense covariance, averaged over what
//!   the residuals and the samples allow; it states the uncertainty of the coefficients of a calibration.
//! * [`state_space`]: white noise, slow noise of any exponent and noise that grows with the field, whitened by a Kalman filter at a cost in
//!   proportion to the rows; a diagnosis asks for it thousands of times.

pub mod dense;
mod parameters;
mod spectrum;
pub mod state_space;

pub use parameters::NoiseParameters;

use nalgebra::DMatrix;

/// The noise of the rows of a fit with several right-hand sides, the components.
pub trait NoiseModel {
    /// Number of rows.
    fn rows(&self) -> usize;

    /// Covariance of some rows of a component, in the order of `rows`.
    fn covariance_of_rows(&self, component: usize, rows: &[usize]) -> DMatrix<f64>;

    /// Whitens columns of all rows of a component in place: what has the noise of the component becomes independent values of variance
    /// one. Columns become NaN where the covariance is singular.
    fn whiten(&self, component: usize, columns: &mut DMatrix<f64>);

    /// Logarithm of the determinant of the covariance of all rows of a component.
    fn log_determinant(&self, component: usize) -> f64;

    /// Log likelihood of residuals of all rows of a component.
    fn log_likelihood(&self, component: usize, residuals: &[f64]) -> f64 {
        let mut white = DMatrix::from_column_slice(residuals.len(), 1, residuals);
        self.whiten(component, &mut white);
        -0.5 * (white.norm_squared() + self.log_determinant(component) + residuals.len() as f64 * std::f64::consts::TAU.ln())
    }
}
