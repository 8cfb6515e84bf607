//! COIL_SCALAR, COIL_RESIDUAL, COIL_TILT: the facility's own calibration.

use super::Body;
use super::field::contradicts;
use super::kind::Naming;
use super::quantity::Shape::{Pairs, Scalar, Vector};
use super::quantity::{COIL, Entry, Quantities, Validity};
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::model::facility::FacilityParameters;
use crate::model::facility_calibration::{ResidualFound, ScalarFound, TiltFound};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilConvention {
    /// Equation of the model.
    pub model: String,
    /// Frames and units.
    pub frames: String,
    /// What `std` and `covariance` are.
    pub uncertainty: String,
}

impl CoilConvention {
    /// Of a scalar calibration.
    #[must_use]
    pub fn scalar() -> Self {
        Self::of(
            "F = |C (S u) + o|, S the scale factors, u the settings, o the offset fields, C the unit vectors along the coils as columns; S changes by the factor 1 + per_k dT, o by per_k dT",
            "standard uncertainties, coverage factor 1, from the scatter of the moduli (Student's factor for quality.degrees_of_freedom) and, where it is larger, of the calibrations; where no coefficients of the coil temperature are found, with those of CH-GFZ-TR-2601 section 6 times its movement during the settings (type B); the scale of the scalar magnetometer and its heading error are not included",
        )
    }

    /// Of residual fields.
    #[must_use]
    pub fn residual() -> Self {
        Self::of(
            "residual field = (F at plus - F at minus) / 2 per coil axis, less half the difference of the settings' magnitudes",
            "standard uncertainties, coverage factor 1, from the scatter of repeated pairs, from std_nt of the table, or from the resolution of the moduli; scale factors and angles are not measured and taken as ideal",
        )
    }

    /// Of a sensor in several orientations.
    #[must_use]
    pub fn tilt() -> Self {
        Self::of(
            "apparent sensitivity of sensor axis i along coil axis k with sign s: sigma_i (1 - ds_k); apparent offset: o_i + s db_k; apparent angle: xi_ij + s_i s_j da_kl; first order, every orientation counts once; corrections ds relative, db nT, da degrees",
            "standard uncertainties, coverage factor 1 (Student's factor for degrees_of_freedom), from what the orientations still differ by; undetermined combinations not included",
        )
    }

    /// The frames are the same for all; model and uncertainty are those of the method.
    fn of(model: &str, uncertainty: &str) -> Self {
        Self {
            model: model.to_owned(),
            frames: "settings EU along the coils, fields nT in coil coordinates: X_c along the coil X, Y_c in the plane of the coils X and Y; angles between the coils XY, XZ, YZ in degrees; per_k relative (scale) or nT (offset) per kelvin from the reference temperature".to_owned(),
            uncertainty: uncertainty.to_owned(),
        }
    }
}

/// The scalar calibration of the coil system.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilScalar {
    /// What the numbers mean.
    pub convention: CoilConvention,
    /// What was found.
    #[serde(flatten)]
    pub found: ScalarFound,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for CoilScalar {
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        has_axes(path, &self.found.facility)
    }
    const FORMAT: &'static str = "COIL_SCALAR";
    const NAMING: Naming = Naming::Begin("COIL_SCALAR__");
    const MAY_LACK: &'static [&'static str] = &["std", "period"];
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &[],
        entries: &[
            Entry::of("scale", Vector, "/facility/scale_nt_per_eu", "/std/scale_nt_per_eu", "nT/EU", COIL),
            Entry::of("offset", Vector, "/facility/offset_nt", "/std/offset_nt", "nT", COIL),
            Entry::of("angle", Pairs, "/facility/angles_deg", "/std/angles_deg", "deg", "between coil axes"),
            Entry::of("scale_per_k", Vector, "/facility/scale_per_k", "/std/scale_per_k", "1/K", COIL),
            Entry::of("offset_per_k", Vector, "/facility/offset_nt_per_k", "/std/offset_nt_per_k", "nT/K", COIL),
            Entry::of("reference_temperature", Scalar(""), "/facility/reference_degc", "", "degC", "coil system"),
            Entry::of("rack_scale_per_k", Vector, "/facility/rack_scale_per_k", "/std/rack_scale_per_k", "1/K", COIL),
            Entry::of("rack_offset_per_k", Vector, "/facility/rack_offset_nt_per_k", "/std/rack_offset_nt_per_k", "nT/K", COIL),
            Entry::of("rack_reference_temperature", Scalar(""), "/facility/rack_reference_degc", "", "degC", "rack"),
        ],
        valid_degc: Some(Validity::Between(["/valid/coil_degc/0", "/valid/coil_degc/1"])),
    });
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.found.used)
    }
}

/// Residual fields from moduli at plus and minus F.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilResidual {
    /// What the numbers mean.
    pub convention: CoilConvention,
    /// What was found.
    #[serde(flatten)]
    pub found: ResidualFound,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for CoilResidual {
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        has_axes(path, &self.found.facility)
    }
    const FORMAT: &'static str = "COIL_RESIDUAL";
    const NAMING: Naming = Naming::Begin("COIL_RESIDUAL__");
    const MAY_LACK: &'static [&'static str] = &["std"];
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.found.used)
    }
}

/// Sensor and facility from runs in several orientations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CoilTilt {
    /// What the numbers mean.
    pub convention: CoilConvention,
    /// What was found.
    #[serde(flatten)]
    pub found: TiltFound,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for CoilTilt {
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        has_axes(path, &self.found.facility)
    }
    const FORMAT: &'static str = "COIL_TILT";
    const NAMING: Naming = Naming::Begin("COIL_TILT__");
    const MAY_LACK: &'static [&'static str] = &["std", "sensor_std", "residual_std", "covariance"];
    fn file_name(&self) -> String {
        name(Self::FORMAT, &self.found.used)
    }
}

/// Refuses a facility whose coils have angles that no three axes have between them.
fn has_axes(path: &Path, facility: &FacilityParameters) -> Result<(), Finding> {
    if facility.coil().axes().is_some() {
        return Ok(());
    }
    Err(contradicts(path, "facility.angles_deg are angles that no three axes have between them"))
}

/// Name of the file for the first of some runs.
fn name(format: &str, used: &[String]) -> String {
    format!("{format}__{}.toml", used.first().map_or("none", String::as_str))
}
