//! What the linear calibration of one run gives.

use crate::data::calibration::LinearCalibration;
use crate::data::envelope::Column;
use crate::data::linearisation::LinearisationApplied;
use crate::data::note::Note;
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::result::Dropped;
use crate::data::units::FieldCoil;
use crate::fit::noise::dense::Candidate;
use crate::model::applied::ModelApplied;
use crate::model::facility::FacilityApplied;
use crate::record::conditions::Temperatures;
use nalgebra::DMatrix;
use serde::Serialize;

/// One plateau in the light of the fit.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Block {
    /// The plateau, its mean reading as it was fitted.
    pub plateau: Plateau,
    /// Applied field minus modelled measurement `B_c - Φ B_m`, nT, coil axes; absent without a mean.
    pub residual_coil_nt: Option<FieldCoil>,
    /// Standard error of the plateau mean from the scatter of its samples, taken as independent, carried to coil axes, nT;
    /// absent if the file brings means only.
    pub standard_error_coil_nt: Option<[f64; 3]>,
    /// What was taken off its mean reading to refer it to the stated sensor temperature, enT; absent where nothing was.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub referred_ent: Option<[f64; 3]>,
    /// Weight in a robust fit; 1 otherwise, 0 for plateaus that were not used.
    pub weight: f64,
}

impl Block {
    /// The mean reading at the temperature of the plateau, enT.
    #[must_use]
    pub fn reading_ent(&self) -> [f64; 3] {
        let referred = self.referred_ent.unwrap_or_default();
        std::array::from_fn(|a| self.plateau.mean.0[a] + referred[a])
    }
}

/// A linear calibration with what is needed to judge it.
#[derive(Clone, Debug, PartialEq)]
pub struct Lin {
    /// What the run says of its sensor.
    pub calibration: LinearCalibration,
    /// The facility that turned settings into the reference field; absent if the settings were taken as the field.
    pub facility: Option<FacilityApplied>,
    /// The linearisation of the readings; absent if they were taken as they are.
    pub linearisation: Option<LinearisationApplied>,
    /// The known effects that were taken off the readings; absent if none were.
    pub model: Option<ModelApplied>,
    /// Plateaus that were not used.
    pub dropped: Vec<Dropped>,
    /// What a person should know.
    pub notes: Vec<Note>,
    /// Every plateau of the run.
    pub blocks: Vec<Block>,
    /// Columns of offset and response with the temperature of the sensor, a row per used plateau, where it moves and the slopes with it were found in
    /// the run.
    pub with_temperature: Option<DMatrix<f64>>,
    /// Temperatures during the run.
    pub temperatures: Temperatures,
    /// The plateaus that were given, with settings and readings as they are in the file, for another fit.
    pub given: Plateaus,
    /// What was tried for the noise of every component, with its likelihood, for comparison with other runs; absent where samples do not
    /// tell the noise.
    pub noise_tried: Option<Vec<Vec<Candidate>>>,
    /// Extremes of the raw readings, for the figure of the measured data.
    pub samples: Option<Vec<Column>>,
}
