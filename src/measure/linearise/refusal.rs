//! Why runs have no linearisation, and what to do about it.

use crate::fit::FitError;
use crate::model::linearisation::LEAST_SLOPE;
use thiserror::Error;

/// Largest condition number of square and cube with the runs' own parameters projected out, columns of unit norm.
pub(super) const MOST_CONDITION: f64 = 1e4;

/// Why there is no linearisation.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LineariseError {
    /// No run is long enough.
    #[error("no run has more plateaus than response, offset trend, square and cube have parameters")]
    NoRuns,
    /// The settings do not determine a coefficient.
    #[error(
        "the runs do not determine {} of component {component} beside sensitivity and offset (condition number {condition:.1e}, at \
         most {MOST_CONDITION:.0e} is accepted)",
        parameters.join(" and ")
    )]
    Undetermined {
        /// Component of the reading.
        component: &'static str,
        /// What is not determined.
        parameters: Vec<String>,
        /// Condition number.
        condition: f64,
    },
    /// No small correction.
    #[error(
        "the polynomial of component {component} has a slope below {LEAST_SLOPE} within the readings: that is no small correction"
    )]
    NotMonotone {
        /// Component of the reading.
        component: &'static str,
    },
    /// Another failure of the fit.
    #[error("component {component}: the fit failed: {error}")]
    Fit {
        /// Component of the reading.
        component: &'static str,
        /// The failure.
        error: FitError,
    },
}

impl LineariseError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            LineariseError::NoRuns => "use a longer programme, or fit without --linearise",
            LineariseError::Undetermined { .. } => {
                "add runs with at least four different fields along every sensor axis, both signs among them, or fit without --linearise"
            }
            LineariseError::NotMonotone { .. } => {
                "look at the residuals of the runs for outliers and saturation, and use at least four different fields along every axis"
            }
            LineariseError::Fit { .. } => "check the plateaus of the runs fitted without --linearise",
        }
    }
}
