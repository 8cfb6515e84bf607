//! Estimators on matrices: they know rows, columns and noise, and no magnetometer.
//!
//! * [`linear`]: the weighted least-squares solver behind every linear fit, refined to the last digit of its input. It
//!   refuses designs which do not determine their parameters and names those parameters.
//! * [`contaminated`]: the same with outliers and unknown scatter, by a likelihood models can be compared by.
//! * [`choice`]: the criterion to compare them by.
//! * [`sine`]: one sine in samples at counted instants, and the sample rate that many of them share.
//! * [`partitioned`]: parameters that several data sets share, beside those each has of its own.
//! * [`polynomial`]: polynomials of any degree the data carry, in raw powers.
//! * [`order`]: the order of a polynomial, given or chosen from the data.
//! * [`nonlinear`]: Levenberg-Marquardt for models with a Jacobian or without, polished to the last digits of the model.
//! * [`robust`]: Huber weights for rows which do not belong.
//! * [`noise`]: the noise of the rows, white, slow or growing with the field, and what it does to the coefficients.
//! * [`scan`]: which of many groups of columns explains what a model leaves, paid for by simulation.
//! * [`statistics`]: quantiles and tails of distributions, medians and extremes.
//! * [`step`]: the row from which on something counts more or less.
//! * [`scalar`]: minima and roots of functions of one number.
//! * [`spectrum`]: amplitude densities of long records, piece by piece, and lines in them.
//! * [`smooth`]: a slow quantity out of noisy readings of it.
//! * [`allan`]: Allan deviations with confidence limits.
//! * [`propagate`](mod@propagate): covariance through functions of the coefficients.
//!
//! Everything is deterministic and nothing panics on data: what cannot be estimated is a [`FitError`].

pub mod allan;
pub mod choice;
pub mod contaminated;
mod double_double;
pub mod linear;
pub mod noise;
pub mod nonlinear;
pub mod order;
pub mod partitioned;
pub mod polynomial;
pub mod propagate;
#[cfg(test)]
pub(crate) mod random;
pub mod robust;
pub mod scalar;
pub mod scan;
pub mod sine;
pub mod smooth;
pub mod spectrum;
pub mod statistics;
pub mod step;

pub use choice::aicc;
pub use contaminated::Contaminated;
pub use linear::{Design, Limits, Solution, solve};
pub use noise::NoiseModel;
pub use noise::dense::DenseNoise;
pub use nonlinear::{Model, NonlinearSolution};
pub use order::{Chosen, choose};
pub use polynomial::Polynomial;
pub use propagate::{Propagated, propagate};
pub use robust::Robust;
pub use statistics::{NORMAL_95, student_95, student_factor};

/// Why a fit has no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum FitError {
    /// There are fewer rows of positive weight than parameters.
    #[error("{rows} rows cannot determine {parameters} parameters")]
    TooFewRows { rows: usize, parameters: usize },
    /// The columns are dependent, or so nearly that noise decides the answer.
    #[error("the data do not determine {} (condition {condition:.1e})", parameters.join(", "))]
    Undetermined {
        /// The parameters which trade against each other, in the order of the design.
        parameters: Vec<String>,
        /// Condition number of the design with columns of unit norm, infinite for a zero column.
        condition: f64,
    },
    /// Two inputs which belong together differ in length.
    #[error("{what}: {found} given, {expected} needed")]
    Length { what: &'static str, expected: usize, found: usize },
    /// An input holds a NaN or an infinity, or a result overflowed.
    #[error("{what}: row {row} is not finite")]
    NotFinite {
        what: &'static str,
        /// Its first such row, counted from zero.
        row: usize,
    },
    /// A weight is negative.
    #[error("the weight of row {row} is negative")]
    NegativeWeight {
        /// The row, counted from zero.
        row: usize,
    },
    /// A standard deviation is zero or negative.
    #[error("the standard deviation of row {row} is not positive")]
    NotPositive {
        /// The row, counted from zero.
        row: usize,
    },
    /// A polynomial of this order needs more different points than there are.
    #[error("order {order} needs {} different points; there are {distinct}", order + 1)]
    TooFewPoints { order: usize, distinct: usize },
    /// A polynomial of this order is beyond what is fitted.
    #[error("order {order} is higher than {highest}, the highest that is fitted")]
    OrderTooHigh { order: usize, highest: usize },
    /// All rows were measured at the same time, or no degree of freedom is left to see noise in.
    #[error("the residuals carry no information about noise: {why}")]
    NoNoise { why: &'static str },
    /// An iteration did not settle.
    #[error("{what} did not settle within {iterations} iterations")]
    NotSettled { what: &'static str, iterations: usize },
}

/// Refuses a slice or matrix with a value that is not finite; `rows` is the number of rows in column-major order.
fn require_finite(what: &'static str, values: &[f64], rows: usize) -> Result<(), FitError> {
    match values.iter().position(|value| !value.is_finite()) {
        Some(index) => Err(FitError::NotFinite { what, row: index % rows }),
        None => Ok(()),
    }
}

/// Refuses a length other than the one needed.
fn require_length(what: &'static str, expected: usize, found: usize) -> Result<(), FitError> {
    if found == expected { Ok(()) } else { Err(FitError::Length { what, expected, found }) }
}
