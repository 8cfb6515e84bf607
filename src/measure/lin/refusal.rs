//! Why a run has no linear calibration, and what to do about it.

use crate::data::run::Kind;
use crate::fit::FitError;
use crate::model::facility::FacilityError;
use crate::model::sensor::SplitError;
use crate::record::position::PositionError;
use crate::record::screens::Implausible;
use thiserror::Error;

/// Largest condition number of the design with columns scaled to one. A programme that drives the three axes has less than ten; at
/// this value the uncertainty of a sensitivity is four orders worse than the same programme could give.
pub(super) const MOST_CONDITION: f64 = 1e4;

/// Why a run has no linear calibration.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum LinError {
    /// Not a linearity run.
    #[error("the run is of kind {0}, not linearity")]
    Kind(Kind),
    /// Nothing to fit.
    #[error("the run has no plateaus: neither @BLOCKS nor @FIELDS with @VECTORS")]
    NoPlateaus,
    /// Settings without a sample.
    #[error(
        "the run has 0 usable plateaus of {total}: there are no settled samples in them, since @VECTORS is missing or has no rows"
    )]
    NoSamples {
        /// Plateaus in the run.
        total: usize,
    },
    /// Several positions, or one without axes.
    #[error(transparent)]
    Position(#[from] PositionError),
    /// The trend order is not available.
    #[error("the offset trend must be of order 0, 1 or 2, not {0}")]
    Order(usize),
    /// No settled part.
    #[error("the data still show the step before a setting after {settling_s:.2} s")]
    Unsettled {
        /// Time over which the data were followed, s.
        settling_s: f64,
    },
    /// Not enough excitation.
    #[error("the excitation does not determine {}: {}", parameters.join(", "), condition_in_words(*condition))]
    Undetermined {
        /// What is not determined.
        parameters: Vec<String>,
        /// Condition number of the scaled design.
        condition: f64,
    },
    /// A temperature that moves, and a programme that does not tell what that does.
    #[error(
        "the sensor temperature moves by {range_k:.1} K, and the programme does not tell what the sensitivities and angles follow of it"
    )]
    Slopes {
        /// Highest minus lowest sensor temperature, K.
        range_k: f64,
    },
    /// Polynomials of something else.
    #[error("{file} holds polynomials of {of}, the run is of {run}")]
    OtherSensor {
        /// File of the polynomials.
        file: String,
        /// Sensor, mode and temperature channel of the polynomials.
        of: String,
        /// The same of the run.
        run: String,
    },
    /// The part of the sensor that counts was, in a part of the run, where the thermistor had been before the record began or was after it.
    #[error(
        "{file} is of a part of the sensor that goes after the thermistor with a lag of {lag_s:.0} s, and the record of the thermistor does not \
         tell the temperature of that part in all of the run"
    )]
    LagUnknown {
        /// File of the polynomials.
        file: String,
        /// Delay or time constant, s.
        lag_s: f64,
    },
    /// Too few plateaus.
    #[error(
        "{used} usable plateaus cannot determine {parameters} parameters per component ({})",
        dropped_in_words(*dropped, *total, reasons)
    )]
    TooFew {
        /// Plateaus that can be used.
        used: usize,
        /// Parameters per component.
        parameters: usize,
        /// Plateaus dropped.
        dropped: usize,
        /// Plateaus in the run.
        total: usize,
        /// Why, the most frequent reason first.
        reasons: String,
        /// Settling and early ends leave nothing of most of them.
        unsettled: bool,
    },
    /// Readings that cannot be right.
    #[error(transparent)]
    Implausible(#[from] Implausible),
    /// A facility that cannot turn the settings into fields.
    #[error(transparent)]
    Facility(#[from] FacilityError),
    /// The matrix cannot be split.
    #[error("{0}")]
    Split(#[from] SplitError),
    /// Another failure of the fit.
    #[error("the fit failed: {0}")]
    Fit(FitError),
}

impl LinError {
    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            LinError::Kind(kind) => kind.command(),
            LinError::NoPlateaus => "check the file with `calfit check`",
            LinError::NoSamples { .. } => "take the file again with its samples, or give the means of the settings in @BLOCKS",
            LinError::Position(error) => error.remedy(),
            LinError::Order(_) => "use the lowest order that the drift needs",
            LinError::Unsettled { .. } => "hold the fields longer, or say with --settling what can be accepted",
            LinError::Implausible(error) => error.remedy(),
            LinError::Undetermined { .. } => "drive that axis on its own",
            LinError::Slopes { .. } => {
                "name polynomials of the sensor with --temperature TPF, or state bounds of slope_sigma and slope_xi in campaign.toml, [[uncertainty]]"
            }
            LinError::OtherSensor { .. } => "name the polynomials of this sensor and mode, of the same temperature channel",
            LinError::LagUnknown { .. } => {
                "record the temperature from a lag before the first setting to one after the last, or leave out those settings with --exclude"
            }
            LinError::TooFew { unsettled: true, .. } => "hold the fields longer, or say with --settling what can be accepted",
            LinError::TooFew { .. } => "use a longer programme, or less strict limits",
            LinError::Facility(error) => error.remedy(),
            LinError::Split(_) => "check the excitation and the wiring of the components",
            LinError::Fit(_) => "check the plateaus in the table of blocks",
        }
    }
}

/// How many plateaus of a run were dropped, and why.
fn dropped_in_words(dropped: usize, total: usize, reasons: &str) -> String {
    if dropped == 0 { "the run has no more".to_owned() } else { format!("{dropped} of {total} were dropped: {reasons}") }
}

/// How badly a design is conditioned.
fn condition_in_words(condition: f64) -> String {
    if condition.is_finite() {
        format!("condition number {condition:.2e}, at most {MOST_CONDITION:.0e} is accepted")
    } else {
        "the condition number is infinite, nothing in the settings tells them from the others".to_owned()
    }
}
