//! Why polynomials beside the centre cannot be taken to it.

use crate::data::across::LinearisedDifferently;
use crate::fit::FitError;
use thiserror::Error;

/// Why there are no polynomials at the centre.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CentreError {
    /// A file of another kind.
    #[error("{file} is no {wanted}")]
    Kind {
        /// The file.
        file: String,
        /// What it should be.
        wanted: &'static str,
    },
    /// A run without temperature.
    #[error("{0} states no sensor temperature")]
    NoTemperature(String),
    /// A run of another sensor or mode.
    #[error("{file} is of {found}, {centre} of {wanted}")]
    Other {
        /// The file.
        file: String,
        /// Its sensor and mode.
        found: String,
        /// The file at the centre.
        centre: String,
        /// Its sensor and mode.
        wanted: String,
    },
    /// Readings that were not linearised in one way.
    #[error("{centre} and the runs beside the centre: {error}")]
    Linearised {
        /// The file at the centre.
        centre: String,
        /// What is wrong.
        error: LinearisedDifferently,
    },
    /// Values of no sensor.
    #[error(
        "{0} and the values off-centre give no k and K: a sensitivity is zero, or no three axes have such angles between them"
    )]
    NoTransfer(String),
    /// The numbers do not work out.
    #[error("the polynomials cannot be taken to the centre: {0}")]
    Fit(#[from] FitError),
}

impl CentreError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            CentreError::Kind { .. } => "name CPF files with --centre and --off-centre, an OPF file with --offset",
            CentreError::NoTemperature(_) => "write temperature_degc into its [run], or name a run that has it",
            CentreError::Other { .. } => "name files of one sensor in one mode",
            CentreError::Linearised { .. } => "calibrate all of them with the same linearisation, or all without one",
            CentreError::NoTransfer(_) | CentreError::Fit(_) => "check the values of the files",
        }
    }
}
