//! TCF: temperature polynomials at the centre of the coil system, from those of a position beside it (RO-IGEP-TR0028 section 3).

use super::kind::Naming;
use super::quantity::Shape::{Matrix, Vector};
use super::quantity::{Entry, LINEARISATION_C2, LINEARISATION_C3, OF_TEMPERATURE, Quantities, SENSOR, VALID_DEGC};
use super::{Body, FieldPart};
use crate::data::across::{CentreResidual, LinearScope, PairedCalibration};
use crate::data::apply::{Apply, OffsetQuantity};
use crate::data::convention::Convention;
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::reference::Reference;
use crate::data::result::{Covariance, Rows};
use crate::model::field_calibration::Frame;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CentreConvention {
    /// Which convention ω, K and K⁻¹ follow.
    pub omega: String,
    /// Equations of the model.
    pub model: String,
    /// Equations of the offset.
    pub offset: String,
    /// Units and frames.
    pub units: String,
    /// What the uncertainties are.
    pub uncertainty: String,
}

impl Default for CentreConvention {
    fn default() -> Self {
        Self {
            omega: "Rosetta: omega is the upper triangular matrix Q(xi) of direction cosines; every sigma, xi and K of this file is in this convention, those of the calibrations of single runs and of their polynomials (BepiColombo: omega = inverse(transpose(Q(xi)))) were converted exactly".to_owned(),
            model: "p(T) = sum over k of p_k T^k, coefficients lowest order first; superscript 1 off-centre, 0 at the centre: k_i = sigma1_i(T1) / sigma0_i(T1), sigma0_i(T) = sigma1_i(T) / k_i; K = omega0(T1)^-1 omega1(T1), omega0(T) = Q(xi1(T)) K^-1; the polynomials sigma and xi are lengths of and angles between the columns of omega0(T) sigma0(T); T1 is reference_degc".to_owned(),
            offset: "B_off(T) = b_or(T) - B_res, B_res = b_or(T2) - B_off(T2), B_off(T2) measured by turning the sensor at T2".to_owned(),
            units: "T degC of the channel; sigma nT/enT, xi degrees between sensor axes, b_or, b_off and b_res enT along the sensor axes; sigma, xi, b_off hold at the centre, off_centre.coefficients beside it; the polynomials sigma and xi miss the columns of omega0(T) sigma0(T) by sigma_remainder and xi_remainder_deg at most".to_owned(),
            uncertainty: "standard uncertainties and covariances of the coefficients, coverage factor 1; with the uncertainty of the facility where the files state it, as common to polynomials and runs; apart from it, polynomials and single runs are taken as independent, which makes sigma and xi at the centre too uncertain, not too certain, where the off-centre run is also one of the polynomials' runs; k and K are taken not to depend on temperature".to_owned(),
        }
    }
}

/// Temperature polynomials at the centre. Quantities without known uncertainty have no covariance.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tcf {
    /// Sensitivity of x, nT/enT.
    pub sigma_x: Vec<f64>,
    /// Sensitivity of y, nT/enT.
    pub sigma_y: Vec<f64>,
    /// Sensitivity of z, nT/enT.
    pub sigma_z: Vec<f64>,
    /// Angle between the sensor axes x and y, degrees.
    pub xi_xy: Vec<f64>,
    /// Angle between the sensor axes x and z, degrees.
    pub xi_xz: Vec<f64>,
    /// Angle between the sensor axes y and z, degrees.
    pub xi_yz: Vec<f64>,
    /// Offset of x, enT; absent without a measurement of the offset at the centre.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_x: Vec<f64>,
    /// Offset of y, enT.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_y: Vec<f64>,
    /// Offset of z, enT.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_z: Vec<f64>,
    /// Largest difference between the polynomials sigma and the lengths of the columns of ω⁰(T) σ⁰(T) over `valid_degc`, nT/enT.
    pub sigma_remainder: [f64; 3],
    /// Largest difference between the polynomials xi and the angles of ω⁰(T) over `valid_degc`, degrees.
    pub xi_remainder_deg: [f64; 3],
    /// `k_i`.
    pub k: [f64; 3],
    /// Standard uncertainty of `k_i`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_std: Option<[f64; 3]>,
    /// `K`, rows.
    pub k_matrix: Rows,
    /// `K⁻¹`, rows.
    pub k_inverse: Rows,
    /// Standard uncertainties of the elements of `K⁻¹`, rows.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub k_inverse_std: Option<Rows>,
    /// T1, the sensor temperature of the run at the centre, °C.
    pub reference_degc: f64,
    /// Lowest and highest temperature for which the polynomials hold, °C.
    pub valid_degc: [f64; 2],
    /// What the coefficients hold for, beside temperatures.
    #[serde(flatten)]
    pub scope: LinearScope,
    /// Channel of the sensor temperature.
    pub channel: String,
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Parameter files of the off-centre runs.
    pub used: Vec<String>,
    /// Run ids, in the order of `used`.
    pub runs: Vec<String>,
    /// What the numbers mean.
    pub convention: CentreConvention,
    /// Covariance of the coefficients of every quantity at the centre.
    pub covariance: BTreeMap<String, Vec<Vec<f64>>>,
    /// Covariance of sigma and xi at the centre, xi beside it, and k_inverse together; absent if one of them is not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<Covariance>,
    /// How the sensor stands in its reference cube, at the mean temperature of the off-centre runs, if that is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
    /// The run at the centre, in the Rosetta convention.
    pub centre: PairedCalibration,
    /// The polynomials beside the centre and what stands for them at T1.
    pub off_centre: OffCentrePart,
    /// Residual field; absent without a measurement of the offset at the centre.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_field: Option<CentreResidual>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

/// The position beside the centre.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffCentrePart {
    /// What stands for σ¹(T1) and ξ¹(T1).
    pub at_reference: PairedCalibration,
    /// Polynomials of sigma and xi in the Rosetta convention, and of b_or, lowest order first.
    pub coefficients: BTreeMap<String, Vec<f64>>,
    /// Their covariance.
    pub covariance: BTreeMap<String, Vec<Vec<f64>>>,
}

impl Body for Tcf {
    const VERSION: u32 = 2;
    const REFUSED_BEFORE: Option<&'static str> = Some(
        "its angles are those between the sensor axes in the formula of the other convention, so that every misalignment has the wrong sign",
    );
    fn apply(&self) -> Option<Apply> {
        let offset = (!self.b_off_x.is_empty()).then_some(OffsetQuantity::BOff);
        let apply = Apply::to_sensor_frame(Convention::Rosetta, offset);
        Some(if self.scope.linearisation.is_some() { apply.of_linearised_readings() } else { apply })
    }
    fn field(&self, _frame: Frame) -> Option<FieldPart> {
        Some(self.part())
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        self.is_consistent(path)
    }
    const FORMAT: &'static str = "TCF";
    const NAMING: Naming = Naming::Extension;
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &OF_TEMPERATURE,
        entries: &[
            LINEARISATION_C2,
            LINEARISATION_C3,
            Entry::of("k", Vector, "/k", "/k_std", "1", SENSOR),
            Entry::of("k_inverse", Matrix, "/k_inverse", "/k_inverse_std", "1", "orthogonal sensor system"),
            Entry::of("b_res", Vector, "/residual_field/b_res_ent", "/residual_field/b_res_std_ent", "enT", SENSOR),
        ],
        valid_degc: VALID_DEGC,
    });
    fn file_name(&self) -> String {
        let first = self.runs.first().map_or_else(String::new, |id| id.replace('_', "-"));
        format!("THERMAL_CENTRE_PARAMETER__{first}.TCF")
    }
}
