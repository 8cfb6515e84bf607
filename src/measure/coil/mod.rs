//! The facility's own calibration: from moduli of a scalar magnetometer, and from one sensor in several orientations.

pub mod residual;
pub mod scalar;
pub mod tilt;

pub use residual::{Residual, residual};
pub use scalar::{Scalar, scalar};
pub use tilt::{Tilt, tilt};

use crate::fit::FitError;
use thiserror::Error;

/// Names of the coil axes.
pub(crate) const AXES: [&str; 3] = ["X", "Y", "Z"];
/// Names of the angles between them.
pub(crate) const ANGLES: [&str; 3] = ["XY", "XZ", "YZ"];

/// Why a facility has no calibration.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum CoilError {
    /// No rows at all.
    #[error("holds no @SCALAR rows")]
    NoRows,
    /// Too few rows for the parameters.
    #[error("{rows} @SCALAR rows cannot determine the nine coil parameters")]
    TooFewRows {
        /// Rows there are.
        rows: usize,
    },
    /// Directions that do not determine a parameter.
    #[error("the directions of the settings do not determine {}: condition number {condition:.1e}, at most {most:.0e} is accepted", parameters.join(", "))]
    Undetermined {
        /// What is not determined.
        parameters: Vec<String>,
        /// Condition number of the design with columns scaled to one.
        condition: f64,
        /// The largest that is accepted.
        most: f64,
    },
    /// Moduli that are not those of the settings.
    #[error(
        "the moduli are not those of the settings: they differ from what any coil system makes of these by {residual_nt:.1} nT beside moduli of {modulus_nt:.1} nT"
    )]
    Unrelated {
        /// Standard deviation of the residuals, nT.
        residual_nt: f64,
        /// Median modulus, nT.
        modulus_nt: f64,
    },
    /// Moduli in several units.
    #[error("holds moduli of {least_nt} and of {most_nt} nT, which are hardly in one unit")]
    Units {
        /// Smallest modulus, nT.
        least_nt: f64,
        /// Largest modulus, nT.
        most_nt: f64,
    },
    /// No pairs of plus and minus.
    #[error("holds no settings of plus and minus F on one coil axis")]
    NoPairs,
    /// Only one orientation.
    #[error("holds {0} orientation of the sensor; facility and sensor cannot be told apart")]
    Orientations(usize),
    /// Several sensors.
    #[error("holds runs in several orientations of more than one sensor: {0}")]
    Sensors(String),
    /// No such sensor.
    #[error("holds no run of sensor {0}")]
    NoSensor(String),
    /// Several modes, which have sensitivities and offsets of their own.
    #[error("holds runs of sensor {sensor} in several modes: {modes}")]
    Modes {
        /// The sensor.
        sensor: String,
        /// Its modes.
        modes: String,
    },
    /// Another failure of the fit.
    #[error("the fit failed: {0}")]
    Fit(#[from] FitError),
}

impl CoilError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            CoilError::NoRows => "name scalar runs; `calfit inspect` lists the kinds",
            CoilError::TooFewRows { .. } => "use a longer programme, such as configs/SCALAR_83.MAG",
            CoilError::Undetermined { .. } => {
                "add settings in other directions: all three axes alone and together, with both signs, spread over the sphere"
            }
            CoilError::Unrelated { .. } => "check that settings and moduli stand in their own rows, with their signs and units",
            CoilError::Units { .. } => "give all moduli in nT, or those of different ranges in tables of their own",
            CoilError::NoPairs => "apply the same magnitude with both signs on one axis and zero on the others",
            CoilError::Orientations(_) => "add runs of the same sensor turned by 90° about two axes",
            CoilError::Sensors(_) => "choose one with --sensor",
            CoilError::Modes { .. } => "name the runs of one mode",
            CoilError::NoSensor(_) => "correct the name",
            CoilError::Fit(_) => "check the rows in the table of residuals",
        }
    }
}
