//! Why runs cannot be diagnosed.

use crate::measure::freq::FreqError;
use crate::measure::lin::LinError;
use crate::model::position::PositionError;
use crate::record::screens::Implausible;
use thiserror::Error;

/// Why a run, or several runs together, cannot be diagnosed.
#[derive(Debug, Error)]
pub enum DiagnoseError {
    /// The plateaus of the run make no record that can be fitted.
    #[error("{0}")]
    Record(String),
    /// The readings cannot be those of the settings.
    #[error(transparent)]
    Implausible(#[from] Implausible),
    /// The residuals of the plateau means do not determine their noise.
    #[error("the noise of the means has no estimate")]
    NoNoise,
    /// A frequency run is diagnosed with its samples.
    #[error("the run has no samples")]
    NoSamples,
    /// The frequency analysis refuses the run.
    #[error(transparent)]
    Frequency(#[from] FreqError),
    /// No sine determines the sampling frequency.
    #[error("the run has no sampling frequency")]
    NoSamplingFrequency,
    /// Too few sines stand out of the noise.
    #[error("{found} settings hold sines that stand out of the noise, {needed} are needed")]
    FewSines {
        /// Settings with such sines.
        found: usize,
        /// Least number of them.
        needed: usize,
    },
    /// A table of amplitudes that any response would follow.
    #[error("{found} amplitudes of a component stand out of the noise, {needed} are needed: fewer follow any response")]
    FewAmplitudes {
        /// Largest number of a component.
        found: usize,
        /// Least number of them.
        needed: usize,
    },
    /// None of the responses of few parameters fits.
    #[error("no simple response fits the amplitudes")]
    NoResponse,
    /// The phases of the sines cannot be fitted.
    #[error("the phases have no fit")]
    NoPhases,
    /// Every sensor has a single run.
    #[error("no sensor has several runs: nothing can disagree")]
    SingleRuns,
    /// The sensors' own parameters take up all values.
    #[error("the runs have as many values as parameters")]
    NoFreedom,
    /// A parameter file states a position that is none.
    #[error(transparent)]
    Position(#[from] PositionError),
    /// The run has no linear calibration.
    #[error(transparent)]
    Linear(#[from] LinError),
}

impl DiagnoseError {
    /// Where the reason lies.
    #[must_use]
    pub fn place(&self) -> &'static str {
        match self {
            Self::Record(_) | Self::Implausible(_) | Self::NoNoise | Self::Linear(_) => "plateau means",
            Self::NoSamples => "samples",
            Self::Frequency(_) | Self::NoSamplingFrequency | Self::FewSines { .. } => "sines",
            Self::NoResponse | Self::FewAmplitudes { .. } => "amplitudes",
            Self::NoPhases => "phases",
            Self::SingleRuns | Self::NoFreedom => "runs",
            Self::Position(_) => "position",
        }
    }

    /// What to do about it.
    #[must_use]
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::SingleRuns | Self::NoFreedom => "add runs of the same sensor: repeats, other orientations, other temperatures",
            Self::NoResponse | Self::FewAmplitudes { .. } => "measure more frequencies, from far below the corner to beyond it",
            Self::Implausible(_) => {
                "check that the settings and their times are those of this run and that the component works, or leave out what is wrong with --exclude"
            }
            Self::Position(_) => "fit the run again",
            Self::Linear(_) => "see `calfit lin` for this run",
            _ => "diagnose runs with steps, sweeps, sines or zero field",
        }
    }
}
