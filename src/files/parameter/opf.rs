//! OPF: sensor offset and residual field of the coil system from normal and turned positions.

use super::cpf::without_effects;
use super::kind::Naming;
use super::point::{self, Point};
use super::quantity::Shape::{Scalar, Vector};
use super::quantity::{COIL, Entry, Quantities, SENSOR, Validity};
use super::{Body, FieldPart, Kept};
use crate::data::apply::{Apply, OffsetQuantity};
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::offset::{OffsetFound, OffsetStd, OffsetValues};
use crate::data::result::{Conditions, Dropped};
use crate::model::applied::ModelApplied;
use crate::model::facility::FacilityApplied;
use crate::model::field_calibration::Frame;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetConvention {
    /// Equation of the model.
    pub model: String,
    /// Frames and units.
    pub frames: String,
    /// What `*_std_*` and `covariance` are.
    pub uncertainty: String,
}

impl Default for OffsetConvention {
    fn default() -> Self {
        Self {
            model: "B_r = B_off + A (B_c + B_res,c) in every position, A measured with the applied fields; in a turned pair B_off = (B_normal + B_turned)/2, residual_ent = (B_normal - B_turned)/2".to_owned(),
            frames: "offset_ent and residual_ent along the sensor axes (DUT coordinates), enT, in the normal position; residual_coil_nt in coil coordinates, nT; nan is not determined".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, from the scatter of the samples within and of the means between the plateaus, slow noise included: 1.96 of them make an interval of 95 %; the field between the positions is taken as constant but for the drift stated".to_owned(),
        }
    }
}

impl OffsetConvention {
    /// For readings from which known effects were taken off.
    #[must_use]
    pub fn without_effects(self) -> Self {
        let (model, uncertainty) = without_effects(&self.model, &self.uncertainty);
        Self { model, uncertainty, ..self }
    }
}

/// Offset and residual field. Components that the positions do not determine are nan and stand in `refused`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Opf {
    /// Offset and residual field.
    #[serde(flatten)]
    pub values: OffsetValues,
    /// What the numbers mean.
    pub convention: OffsetConvention,
    /// The same standard uncertainties under the names of their quantities, as those of type B and of both types stand; absent in files from
    /// before they did.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std: Option<OffsetStd>,
    /// How they were found.
    #[serde(flatten)]
    pub found: OffsetFound,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// The facility whose scale factors and angles turned settings into applied fields; absent if the settings were taken as fields.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facility: Option<FacilityApplied>,
    /// The known effects that were taken off the readings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelApplied>,
    /// Plateaus that were not used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<Dropped>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for Opf {
    fn apply(&self) -> Option<Apply> {
        Some(Apply::offset_alone(OffsetQuantity::BOff))
    }
    fn field(&self, _frame: Frame) -> Option<FieldPart> {
        Some(self.part())
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        self.is_consistent(path)
    }
    const FORMAT: &'static str = "OPF";
    const NAMING: Naming = Naming::Extension;
    const POINT: Option<Point> = Some(point::opf);
    const KEPT: &'static [Kept] = &[Kept::number("run.temperature_degc"), Kept::number("run.coil_temperature_degc")];
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &[],
        entries: &[
            Entry::of("b_off", Vector, "/offset_ent", "/offset_std_ent", "enT", SENSOR),
            Entry::of("b_res", Vector, "/residual_ent", "/residual_std_ent", "enT", "sensor axes in the normal position"),
            Entry::of("b_res_coil", Vector, "/residual_coil_nt", "/residual_coil_std_nt", "nT", COIL),
            Entry::of("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
        ],
        valid_degc: Some(Validity::OfRun("/conditions/sensor_degc")),
    });
    const MAY_LACK: &'static [&'static str] = &[
        "offset_ent",
        "offset_std_ent",
        "residual_ent",
        "residual_std_ent",
        "residual_coil_nt",
        "residual_coil_std_nt",
        "offset_degc",
        "scaled",
        "std",
        "std_b",
        "std_combined",
    ];
    fn file_name(&self) -> String {
        format!("OFF_PARAMETER__{}.OPF", self.found.run.dashed_id())
    }
}
