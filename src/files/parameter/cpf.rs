//! CPF: the linear calibration of one run.

use super::kind::Naming;
use super::point::{self, Point};
use super::quantity::Shape::{Diagonal, Matrix, Scalar, Vector};
use super::quantity::{BETWEEN, Entry, LINEARISATION_C2, LINEARISATION_C3, Quantities, SENSOR, Validity};
use super::{Body, FieldPart, Kept};
use crate::data::apply::{Apply, OffsetQuantity};
use crate::data::calibration::LinearCalibration;
use crate::data::convention as data_convention;
use crate::data::error::Finding;
use crate::data::linearisation::LinearisationApplied;
use crate::data::note::Told;
use crate::data::result::{Conditions, Dropped};
use crate::model::applied::ModelApplied;
use crate::model::facility::FacilityApplied;
use crate::model::field_calibration::Frame;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Convention {
    /// Equation of the model.
    pub model: String,
    /// Frames and units.
    pub frames: String,
    /// Sign of the residuals.
    pub residual: String,
    /// What `std` and `covariance` are.
    pub uncertainty: String,
}

/// What the uncertainties of a run are without those of the coil system.
const SCATTER: &str = "standard uncertainties, coverage factor 1, from the scatter of the samples within and of the means between the plateaus, slow noise included: 1.96 of them make an interval of 95 % (with plateau means only, Student's factor for quality.degrees_of_freedom)";

impl Convention {
    /// Of readings as they are; `has_type_b`: the file states what the coil system adds.
    #[must_use]
    pub fn new(has_type_b: bool) -> Self {
        let of_facility = if has_type_b {
            "those of std and covariance are of type A, without coil constants and coil angles; what these add as far as the facility file states it is in std_b, and both together in std_combined and covariance_combined"
        } else {
            "coil constants and coil angles not included"
        };
        Self {
            model: "B_c = phi (B_r - B_or), phi = r_nom rho omega sigma, phi_tilde = omega sigma".to_owned(),
            frames: "B_c nT in coil coordinates; B_r, B_or enT along the sensor axes; matrices nT/enT; r_nom takes nominal sensor to coil coordinates; times s since the run's start".to_owned(),
            residual: "applied field minus modelled measurement, B_c - phi (B_r - B_or)".to_owned(),
            uncertainty: format!("{SCATTER}; {of_facility}"),
        }
    }

    /// For linearised readings, and parameters that hold for those alone.
    #[must_use]
    pub fn linearised(self) -> Self {
        Self {
            model: format!(
                "{}; B_r is the linearised reading, raw reading r + c2 r^2 + c3 r^3 with the coefficients of [linearisation]",
                self.model
            ),
            uncertainty: format!("{}; that of the linearisation included", self.uncertainty),
            ..self
        }
    }

    /// For a run whose readings were referred to one sensor temperature.
    #[must_use]
    pub fn at_one_temperature(self) -> Self {
        Self {
            model: format!(
                "{}; everything holds at slopes.at_degc, to which B_r was referred with [slopes]: sigma_i and xi_ij move with the sensor temperature, the sensor does not turn in its mount",
                self.model
            ),
            uncertainty: format!("{}; that of the slopes included", self.uncertainty),
            ..self
        }
    }

    /// For readings from which known effects were taken off.
    #[must_use]
    pub fn without_effects(self) -> Self {
        let (model, uncertainty) = without_effects(&self.model, &self.uncertainty);
        Self { model, uncertainty, ..self }
    }
}

/// Equation and uncertainties of a convention for readings from which known effects were taken off.
pub(super) fn without_effects(model: &str, uncertainty: &str) -> (String, String) {
    (
        format!("{model}; the effects of [model] were taken off B_r"),
        format!("{uncertainty}; that of the parameters of [model] included, taken as independent"),
    )
}

/// Begin of the name of the calibration of a run alone.
const ALONE: &str = "PARAMETER_LIN__";
/// Begin of the name of the calibration of a run as it is used in a thermal group.
const IN_GROUP: &str = "PARAMETER_TEMPLIN__";

/// Path of the calibration of the run alone, in whose place that of a thermal group with this path stands; `None` for any other file.
#[must_use]
pub fn alone_of(path: &str) -> Option<String> {
    let (folder, name) = path.rsplit_once('/').map_or(("", path), |(folder, name)| (folder, name));
    let rest = name.strip_prefix(IN_GROUP)?;
    Some(if folder.is_empty() { format!("{ALONE}{rest}") } else { format!("{folder}/{ALONE}{rest}") })
}

/// Frame of the rotation angles.
const TURNED: &str = "real against nominal sensor axis";

/// A linear calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cpf {
    /// What the numbers mean.
    pub convention: Convention,
    /// What the run says of its sensor.
    #[serde(flatten)]
    pub calibration: LinearCalibration,
    /// Temperatures during the run.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub conditions: Option<Conditions>,
    /// The facility that turned settings into the reference field; absent if the settings were taken as the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facility: Option<FacilityApplied>,
    /// The linearisation of the readings; absent if they were taken as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linearisation: Option<LinearisationApplied>,
    /// The known effects that were taken off the readings; absent if none were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<ModelApplied>,
    /// Plateaus that were not used.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub dropped: Vec<Dropped>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

impl Body for Cpf {
    fn apply(&self) -> Option<Apply> {
        let apply = Apply::to_sensor_frame(data_convention::Convention::BepiColombo, Some(OffsetQuantity::BOr)).on_to_coil_axes();
        Some(if self.linearisation.is_some() { apply.of_linearised_readings() } else { apply })
    }
    fn field(&self, frame: Frame) -> Option<FieldPart> {
        Some(self.part(frame))
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        self.is_consistent(path)
    }
    const FORMAT: &'static str = "CPF";
    const NAMING: Naming = Naming::Extension;
    const POINT: Option<Point> = Some(point::cpf);
    const KEPT: &'static [Kept] = &[
        Kept::number("run.temperature_degc"),
        Kept::spread("quality.raw_std_ent"),
        Kept::vector("slopes.b_or_ent"),
        Kept::vector("slopes.std.b_or_ent"),
    ];
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &[],
        entries: &[
            LINEARISATION_C2,
            LINEARISATION_C3,
            Entry::of("sigma", Diagonal, "/matrix/sigma", "/std/sigma", "nT/enT", SENSOR),
            Entry::of("xi", Scalar("xy"), "/angle_deg/xi_xy", "/std/xi_deg/0", "deg", BETWEEN),
            Entry::of("xi", Scalar("xz"), "/angle_deg/xi_xz", "/std/xi_deg/1", "deg", BETWEEN),
            Entry::of("xi", Scalar("yz"), "/angle_deg/xi_yz", "/std/xi_deg/2", "deg", BETWEEN),
            Entry::of("lambda", Scalar("x"), "/angle_deg/lambda_x", "/std/lambda_mu_nu_deg/0", "deg", TURNED),
            Entry::of("mu", Scalar("y"), "/angle_deg/mu_y", "/std/lambda_mu_nu_deg/1", "deg", TURNED),
            Entry::of("nu", Scalar("z"), "/angle_deg/nu_z", "/std/lambda_mu_nu_deg/2", "deg", TURNED),
            Entry::of("b_or", Vector, "/offset/b_or_ent", "/std/b_or_ent", "enT", SENSOR),
            Entry::of("phi", Matrix, "/matrix/phi", "/std/phi", "nT/enT", "sensor axes to coil axes"),
            Entry::of(
                "phi_tilde",
                Matrix,
                "/matrix/phi_tilde",
                "/std/phi_tilde",
                "nT/enT",
                "sensor axes to orthogonal sensor system",
            ),
            Entry::of("temperature", Scalar(""), "/run/temperature_degc", "", "degC", "sensor"),
        ],
        valid_degc: Some(Validity::Between(["/valid/temperature_degc/0", "/valid/temperature_degc/1"])),
    });
    fn file_name(&self) -> String {
        format!("{ALONE}{}.CPF", self.calibration.run.id)
    }
}

impl Cpf {
    /// Name of the file that a thermal group rests on.
    #[must_use]
    pub fn thermal_file_name(&self) -> String {
        format!("{IN_GROUP}{}.CPF", self.calibration.run.id)
    }
}
