//! A coil system whose parameters are known: what a facility file states, and what was done with it to the settings of a run.

use super::coil::Coil;
use crate::data::provenance::Input;
use serde::{Deserialize, Serialize};

/// A facility as it was read.
#[derive(Clone, Debug, PartialEq)]
pub struct Facility {
    /// The file, under its name.
    pub input: Input,
    /// Its values.
    pub part: FacilityParameters,
}

impl Facility {
    /// The coil system with these parameters.
    #[must_use]
    pub fn coil(&self) -> Coil {
        self.part.coil()
    }

    /// The same without offset fields.
    #[must_use]
    pub fn without_offset(&self) -> Facility {
        let part =
            FacilityParameters { offset_nt: [0.0; 3], offset_nt_per_k: None, rack_offset_nt_per_k: None, ..self.part.clone() };
        Facility { input: self.input.clone(), part }
    }

    /// Whether its values depend on the rack temperature.
    #[must_use]
    pub fn follows_rack(&self) -> bool {
        let acts = |v: Option<[f64; 3]>| v.is_some_and(|v| v.iter().any(|v| *v != 0.0));
        acts(self.part.rack_scale_per_k) || acts(self.part.rack_offset_nt_per_k)
    }

    /// Whether its values depend on the coil temperature.
    #[must_use]
    pub fn follows_coil(&self) -> bool {
        let acts = |v: Option<[f64; 3]>| v.is_some_and(|v| v.iter().any(|v| *v != 0.0));
        acts(self.part.scale_per_k) || acts(self.part.offset_nt_per_k)
    }
}

/// Parameters of the facility, or their standard uncertainties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FacilityParameters {
    /// Scale factors, nT/EU.
    pub scale_nt_per_eu: [f64; 3],
    /// Offset fields, nT.
    pub offset_nt: [f64; 3],
    /// Angles between the coils XY, XZ, YZ, degrees.
    pub angles_deg: [f64; 3],
    /// Relative change of the scale factors with the coil temperature, 1/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale_per_k: Option<[f64; 3]>,
    /// Change of the offset fields with the coil temperature, nT/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub offset_nt_per_k: Option<[f64; 3]>,
    /// Coil temperature for which scale factors and offset fields hold, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference_degc: Option<f64>,
    /// Relative change of the scale factors with the rack temperature, 1/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_scale_per_k: Option<[f64; 3]>,
    /// Change of the offset fields with the rack temperature, nT/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_offset_nt_per_k: Option<[f64; 3]>,
    /// Rack temperature for which they hold, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_reference_degc: Option<f64>,
}

impl FacilityParameters {
    /// Scale factors, offset fields and angles that do not depend on temperature.
    #[must_use]
    pub fn constant(scale_nt_per_eu: [f64; 3], offset_nt: [f64; 3], angles_deg: [f64; 3]) -> Self {
        Self {
            scale_nt_per_eu,
            offset_nt,
            angles_deg,
            scale_per_k: None,
            offset_nt_per_k: None,
            reference_degc: None,
            rack_scale_per_k: None,
            rack_offset_nt_per_k: None,
            rack_reference_degc: None,
        }
    }

    /// The coil system with these parameters; what is not stated does not depend on temperature.
    #[must_use]
    pub fn coil(&self) -> Coil {
        Coil {
            scale_nt_per_eu: self.scale_nt_per_eu,
            offset_nt: self.offset_nt,
            angles_deg: self.angles_deg,
            scale_per_k: self.scale_per_k.unwrap_or_default(),
            offset_nt_per_k: self.offset_nt_per_k.unwrap_or_default(),
            rack_scale_per_k: self.rack_scale_per_k.unwrap_or_default(),
            rack_offset_nt_per_k: self.rack_offset_nt_per_k.unwrap_or_default(),
            reference_degc: self.reference_degc.unwrap_or(Coil::IDEAL.reference_degc),
            rack_reference_degc: self.rack_reference_degc.unwrap_or(Coil::IDEAL.rack_reference_degc),
        }
    }
}

/// The facility that turned the settings of a run into the reference field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FacilityApplied {
    /// File it came from, which is among the inputs.
    pub file: String,
    /// Coil temperature that was used, °C; absent if nothing depends on it or it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub coil_degc: Option<f64>,
    /// Rack temperature that was used, °C; absent if nothing depends on it or it is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rack_degc: Option<f64>,
    /// Its parameters.
    pub applied: FacilityParameters,
}
