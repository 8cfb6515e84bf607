//! TPF, TOF, TAF: temperature polynomials of a sensor in one mode.

mod noise;

pub use noise::NoisePart;

use super::field::{contradicts, stated_polynomial};
use super::kind::Naming;
use super::quantity::Shape::Scalar;
use super::quantity::{Entry, LINEARISATION_C2, LINEARISATION_C3, OF_TEMPERATURE, POLYNOMIALS, Quantities, VALID_DEGC};
use super::{Body, FieldPart, Kept};
use crate::data::across::{
    AppliedLag, CommonChange, LinearScope, RunModelErrors, RunResidualFields, RunRotations, ThermistorLag,
};
use crate::data::apply::{Apply, OffsetQuantity};
use crate::data::convention::{Alignment, Convention};
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::provenance::Input;
use crate::data::quantity::QuantityFound;
use crate::data::reference::{Reference, StatedReference};
use crate::data::result::Covariance;
use crate::data::run::Location;
use crate::fit::order::Reason;
use crate::model::field_calibration::Frame;
use crate::model::polynomial::{TemperaturePolynomial, value};
use crate::model::sensor_polynomials::SensorPolynomials;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;

/// What the numbers mean.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermalConvention {
    /// Equation of the model.
    pub model: String,
    /// Units.
    pub units: String,
    /// What the uncertainties are, and what must not be done.
    pub uncertainty: String,
}

impl Default for ThermalConvention {
    fn default() -> Self {
        Self {
            model: "p(T) = sum over k of p_k T^k, coefficients lowest order first".to_owned(),
            units: "T degC of the channel; sigma nT/enT, xi degrees between sensor axes, b_or and b_off enT along the sensor axes, f_3db Hz".to_owned(),
            uncertainty: "covariances of the coefficients, coverage factor 1; outside valid_degc the polynomials are extrapolations without a stated uncertainty".to_owned(),
        }
    }
}

/// What all thermal files state.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermalHead {
    /// Parameter files of the runs.
    pub used: Vec<String>,
    /// Channel of the sensor temperature.
    pub channel: String,
    /// Lowest and highest temperature for which all polynomials of the file hold, °C.
    pub valid_degc: [f64; 2],
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// Where the sensor stood.
    #[serde(default, skip_serializing_if = "Location::is_centre")]
    pub location: Location,
    /// Run ids, in the order of `used`.
    pub runs: Vec<String>,
    /// Mean sensor temperature of every run, °C.
    pub temperature_degc: Vec<f64>,
    /// Mean coil-system temperature of every run, °C; nan where there is none.
    pub coil_temperature_degc: Vec<f64>,
    /// What the numbers mean.
    pub convention: ThermalConvention,
    /// Covariance of the coefficients of every quantity, type A.
    pub covariance: BTreeMap<String, Vec<Vec<f64>>>,
    /// What the uncertainty of the facility adds, which all runs share: type B; empty where it is not stated.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub covariance_b: BTreeMap<String, Vec<Vec<f64>>>,
    /// The covariance of both types; empty where no type B is stated.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub covariance_combined: BTreeMap<String, Vec<Vec<f64>>>,
    /// What the runs share, source by source: `covariance_b` is the sum of what they give. Empty where it is not stated.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub common: Vec<CommonCoefficients>,
    /// How every polynomial was found.
    pub quantity: Vec<QuantityFound>,
    /// What a person should know.
    #[serde(flatten)]
    pub told: Told,
}

/// How the coefficients of all quantities change, together and with their signs, by one standard deviation of something that the runs share.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommonCoefficients {
    /// What it is, in the words of the files of the runs.
    pub source: String,
    /// The changes by the names of the quantities, lowest order first.
    #[serde(flatten)]
    pub change: BTreeMap<String, Vec<f64>>,
}

/// What stands for the channel of the temperature if no run tells it.
pub const NO_CHANNEL: &str = "not stated";

/// Keys of the head whose lists may hold nan.
const MAY_LACK: &[&str] = &["coil_temperature_degc", "quantity", "rotation", "residual_field", "joint", "sweep"];

/// Temperature polynomials of the linear calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tpf {
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
    /// Offset and residual field of x, enT.
    pub b_or_x: Vec<f64>,
    /// Offset and residual field of y, enT.
    pub b_or_y: Vec<f64>,
    /// Offset and residual field of z, enT.
    pub b_or_z: Vec<f64>,
    /// Group, covariances and fits.
    #[serde(flatten)]
    pub head: ThermalHead,
    /// How the sensor stands in its reference cube at the mean temperature of the runs, if that is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
    /// What the coefficients hold for, beside temperatures.
    #[serde(flatten)]
    pub scope: LinearScope,
    /// Covariance of all coefficients together, type A; only where one fit gave all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<Covariance>,
    /// The same of both types; absent where no type B is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together_combined: Option<Covariance>,
    /// Rotation of the sensor against its nominal orientation in every run.
    pub rotation: RunRotations,
    /// What the polynomials leave of the applied fields in every run, with its own rotation and offset; absent for parameter files.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model_error: Option<RunModelErrors>,
    /// The fit of the temperature-dependent model to the plateaus of all runs at once.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub joint: Option<JointPart>,
    /// How the polynomials were found, if they are those of one continuous sweep.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sweep: Option<SweepPart>,
    /// What the runs show of the noise of their plateaus together, a table per component: the prior of runs that are calibrated with this
    /// file. Absent where they do not tell.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub noise: Vec<NoisePart>,
}

/// A continuous sweep: one fit of the temperature-dependent model to all its settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SweepPart {
    /// Settings used.
    pub settings_used: usize,
    /// Settings in the run.
    pub settings_total: usize,
    /// Settings left out because the temperature moved too fast.
    pub settings_too_fast: usize,
    /// Length of the sliding window whose values stand in `quantity`.
    pub window: String,
    /// Root mean square of applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: [f64; 3],
    /// Order of the polynomials of the temperature that the rotation of the sensor follows; absent in files from before they were told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_order: Option<usize>,
    /// Angle between the orientations at the highest and at the lowest temperature, degrees; absent likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_change_deg: Option<f64>,
    /// Its standard uncertainty, type A, degrees; absent likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rotation_change_std_deg: Option<f64>,
    /// The lag that the temperatures of the polynomials have; absent likewise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub applied_lag: Option<AppliedLag>,
    /// How the sensor follows every thermistor that moves, beside polynomials of one order higher.
    pub lag: Vec<ThermistorLag>,
    /// The facility that turned settings into the reference field; absent if the settings were taken as the field.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub facility: Option<crate::model::facility::FacilityApplied>,
    /// The known effects that were taken off the readings; absent if none were.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<crate::model::applied::ModelApplied>,
}

/// The joint fit beside the two-step one: sensitivities and angles as polynomials, rotation and offset of every run free.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct JointPart {
    /// Coefficients per quantity, lowest order first.
    pub coefficients: BTreeMap<String, Vec<f64>>,
    /// Covariance of the coefficients per quantity, type A.
    pub covariance: BTreeMap<String, Vec<Vec<f64>>>,
    /// What the uncertainty of the facility adds, type B; empty where it is not stated.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub covariance_b: BTreeMap<String, Vec<Vec<f64>>>,
    /// The covariance of both types; empty likewise.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub covariance_combined: BTreeMap<String, Vec<Vec<f64>>>,
    /// Covariance of all coefficients together, type A.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub together: Option<Covariance>,
    /// Chi-square of all plateaus.
    pub chi_square: f64,
    /// Its degrees of freedom.
    pub degrees_of_freedom: usize,
    /// Factor by which the uncertainties were widened.
    pub widened: f64,
    /// Evaluations of the model.
    pub evaluations: usize,
}

/// The change of coefficients whose square is a covariance, positive at a temperature; `None` where it is not that of one change.
fn change_of(covariance: &[Vec<f64>], degc: f64) -> Option<Vec<f64>> {
    const ROUNDING: f64 = 1e-6;
    let n = covariance.len();
    let variance = |k: usize| covariance[k][k];
    let largest = (0..n).max_by(|a, b| variance(*a).total_cmp(&variance(*b))).filter(|k| variance(*k) > 0.0)?;
    let mut change: Vec<f64> = (0..n).map(|k| covariance[k][largest] / variance(largest).sqrt()).collect();
    let is_one = |(i, k): (usize, usize)| {
        (covariance[i][k] - change[i] * change[k]).abs() <= ROUNDING * (variance(i) * variance(k)).sqrt().max(f64::MIN_POSITIVE)
    };
    let all = (0..n).flat_map(|i| (0..n).map(move |k| (i, k))).all(is_one);
    if value(&change, degc) < 0.0 {
        change.iter_mut().for_each(|c| *c = -*c);
    }
    all.then_some(change)
}

/// The first sensitivity or angle that has the order 0 because the runs show no slope: neither was it given, nor are the values free of
/// scatter.
fn without_slope(quantities: &[QuantityFound]) -> Option<String> {
    let is_known = |q: &QuantityFound| matches!(q.order_by, Reason::Given | Reason::Exact);
    let is_of_response = |q: &QuantityFound| q.name.starts_with("sigma_") || q.name.starts_with("xi_");
    quantities.iter().find(|q| is_of_response(q) && q.order == 0 && !is_known(q)).map(|q| q.name.clone())
}

impl Tpf {
    /// The sensitivities with the covariances that the file states, nT/enT; a covariance of size zero is not known.
    #[must_use]
    pub fn sigma(&self) -> [TemperaturePolynomial; 3] {
        self.head.polynomials([("sigma_x", &self.sigma_x), ("sigma_y", &self.sigma_y), ("sigma_z", &self.sigma_z)])
    }

    /// The angles between the sensor axes, degrees, likewise.
    #[must_use]
    pub fn xi_deg(&self) -> [TemperaturePolynomial; 3] {
        self.head.polynomials([("xi_xy", &self.xi_xy), ("xi_xz", &self.xi_xz), ("xi_yz", &self.xi_yz)])
    }

    /// Offset and residual field together, enT, likewise.
    #[must_use]
    pub fn b_or_ent(&self) -> [TemperaturePolynomial; 3] {
        self.head.polynomials([("b_or_x", &self.b_or_x), ("b_or_y", &self.b_or_y), ("b_or_z", &self.b_or_z)])
    }

    /// Sensitivities and angles with their covariances of type A alone.
    #[must_use]
    pub fn of_type_a(&self) -> ([TemperaturePolynomial; 3], [TemperaturePolynomial; 3]) {
        let head = &self.head;
        let of =
            |name: &str, coefficients: &Vec<f64>| stated_polynomial(coefficients, head.covariance.get(name), head.valid_degc);
        let sigma = [("sigma_x", &self.sigma_x), ("sigma_y", &self.sigma_y), ("sigma_z", &self.sigma_z)];
        let xi = [("xi_xy", &self.xi_xy), ("xi_xz", &self.xi_xz), ("xi_yz", &self.xi_yz)];
        (sigma.map(|(name, c)| of(name, c)), xi.map(|(name, c)| of(name, c)))
    }

    /// How the coefficients of sensitivities and angles, sigma_x to xi_yz, change by one standard deviation of everything that the runs share;
    /// `None` where the file does not state it, and neither as one change per quantity.
    #[must_use]
    pub fn of_facility(&self) -> Option<Vec<(String, [Vec<f64>; 6])>> {
        const NAMES: [&str; 6] = ["sigma_x", "sigma_y", "sigma_z", "xi_xy", "xi_xz", "xi_yz"];
        let coefficients = [&self.sigma_x, &self.sigma_y, &self.sigma_z, &self.xi_xy, &self.xi_xz, &self.xi_yz];
        let none = || coefficients.map(|own| vec![0.0; own.len()]);
        if !self.head.common.is_empty() {
            let of = |source: &CommonCoefficients| {
                let mut change = none();
                for (own, name) in change.iter_mut().zip(NAMES) {
                    let stated = source.change.get(name)?;
                    own.clone_from(Some(stated).filter(|stated| stated.len() == own.len())?);
                }
                Some((source.source.clone(), change))
            };
            return self.head.common.iter().map(of).collect();
        }
        // Files that do not tell the sources: one for each quantity.
        let degc = self.mean_degc();
        let one = |(k, name): (usize, &&str)| {
            let mut change = none();
            change[k] = change_of(self.head.covariance_b.get(*name)?, degc)?;
            Some((CommonChange::source_of(name), change))
        };
        NAMES.iter().enumerate().map(one).collect()
    }

    /// Everything that the parameters of a run follow of the sensor temperature.
    #[must_use]
    pub fn polynomials(&self, input: Input) -> SensorPolynomials {
        let head = &self.head;
        SensorPolynomials {
            input,
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            channel: Some(head.channel.clone()).filter(|channel| channel != NO_CHANNEL),
            lag: self.lag(),
            valid_degc: head.valid_degc,
            sigma: self.sigma(),
            xi_deg: self.xi_deg(),
            b_or_ent: self.b_or_ent(),
            without_slope: without_slope(&head.quantity),
            noise: NoisePart::together(&self.noise),
        }
    }

    /// Mean sensor temperature of the runs, °C, at which the rotation to the reference cube holds.
    #[must_use]
    pub fn mean_degc(&self) -> f64 {
        let known: Vec<f64> = self.head.temperature_degc.iter().copied().filter(|t| t.is_finite()).collect();
        known.iter().sum::<f64>() / known.len() as f64
    }

    /// Sensitivities and angles at the mean temperature of the runs.
    #[must_use]
    pub fn mean_alignment(&self) -> Alignment {
        let t = self.mean_degc();
        let at = |p: TemperaturePolynomial| value(&p.coefficients, t);
        Alignment { convention: Convention::BepiColombo, sigma: self.sigma().map(at), xi_deg: self.xi_deg().map(at) }
    }

    /// How the sensor stands in its reference cube, as it was stated.
    #[must_use]
    pub fn stated_reference(&self) -> Option<StatedReference> {
        self.reference.as_ref()?.stated(&self.mean_alignment()).ok()
    }
}

impl Body for Tpf {
    fn apply(&self) -> Option<Apply> {
        let apply = Apply::to_sensor_frame(Convention::BepiColombo, Some(OffsetQuantity::BOr));
        Some(if self.scope.linearisation.is_some() { apply.of_linearised_readings() } else { apply })
    }
    fn field(&self, _frame: Frame) -> Option<FieldPart> {
        Some(self.part())
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        NoisePart::are_sound(&self.noise, path)?;
        self.is_consistent(path)
    }
    const FORMAT: &'static str = "TPF";
    const NAMING: Naming = Naming::Extension;
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        entries: &[
            LINEARISATION_C2,
            LINEARISATION_C3,
            Entry::of(
                "lag",
                Scalar(""),
                "/sweep/applied_lag/lag_s",
                "/sweep/applied_lag/std_s",
                "s",
                "temperature of the sensor against that of the channel",
            ),
        ],
        polynomials: &OF_TEMPERATURE,
        valid_degc: VALID_DEGC,
    });
    const MAY_LACK: &'static [&'static str] = MAY_LACK;
    fn file_name(&self) -> String {
        format!("THERMAL_PARAMETER__{}.TPF", self.head.first_run())
    }
}

/// Temperature polynomials of the sensor offset. A component without values is absent, and nan in files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Tof {
    /// Offset of x, enT.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_x: Vec<f64>,
    /// Offset of y, enT.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_y: Vec<f64>,
    /// Offset of z, enT.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub b_off_z: Vec<f64>,
    /// Group, covariances and fits.
    #[serde(flatten)]
    pub head: ThermalHead,
    /// Residual field of the coil system in every run.
    pub residual_field: RunResidualFields,
}

impl Body for Tof {
    fn apply(&self) -> Option<Apply> {
        Some(Apply::offset_alone(OffsetQuantity::BOff))
    }
    fn field(&self, _frame: Frame) -> Option<FieldPart> {
        Some(self.part())
    }
    const FORMAT: &'static str = "TOF";
    const NAMING: Naming = Naming::Extension;
    const KEPT: &'static [Kept] = &[
        Kept::coefficients("b_off_x"),
        Kept::coefficients("b_off_y"),
        Kept::coefficients("b_off_z"),
        Kept::covariance("covariance.b_off_x"),
        Kept::covariance("covariance.b_off_y"),
        Kept::covariance("covariance.b_off_z"),
    ];
    const QUANTITIES: Option<&'static Quantities> = Some(&POLYNOMIALS);
    const MAY_LACK: &'static [&'static str] = MAY_LACK;
    fn file_name(&self) -> String {
        format!("THERMAL_OFF_PARAMETER__{}.TOF", self.head.first_run())
    }
}

/// Temperature polynomials of the -3 dB frequency. A component without values is absent, and nan in files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Taf {
    /// -3 dB frequency of x, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_x: Vec<f64>,
    /// -3 dB frequency of y, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_y: Vec<f64>,
    /// -3 dB frequency of z, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_z: Vec<f64>,
    /// -3 dB frequency of x by interpolation between neighbouring amplitudes, as the reports of BepiColombo print it, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_igep_x: Vec<f64>,
    /// The same of y, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_igep_y: Vec<f64>,
    /// The same of z, Hz.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub f_3db_igep_z: Vec<f64>,
    /// Mean over the runs of the sampling frequency, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_sample_rate_hz: Option<f64>,
    /// Mean over the runs of the standard uncertainty of the sampling frequency, Hz.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub mean_std_sample_rate_hz: Option<f64>,
    /// Which -3 dB frequency the polynomials without `igep` in their names are of: `model` or `igep`.
    pub corner: String,
    /// Sampling frequency of every run, Hz; nan where it is not known.
    pub f_s_hz: Vec<f64>,
    /// Its standard uncertainty, Hz.
    pub f_s_std_hz: Vec<f64>,
    /// Group, covariances and fits.
    #[serde(flatten)]
    pub head: ThermalHead,
}

impl Body for Taf {
    fn apply(&self) -> Option<Apply> {
        let formula = "f_3db(T) = sum over k of f_3db_k T^k, T degC of the channel, per component; f_3db_igep the same";
        Some(Apply::evaluated(formula, "-3 dB frequency, Hz, along the sensor axes"))
    }
    fn validate(&self, path: &Path) -> Result<(), Finding> {
        if ["model", "igep"].contains(&self.corner.as_str()) {
            return Ok(());
        }
        Err(contradicts(path, format!("corner is `{}`, neither `model` nor `igep`", self.corner)))
    }
    const FORMAT: &'static str = "TAF";
    const NAMING: Naming = Naming::Extension;
    const KEPT: &'static [Kept] = &[
        Kept::coefficients("f_3db_x"),
        Kept::coefficients("f_3db_y"),
        Kept::coefficients("f_3db_z"),
        Kept::covariance("covariance.f_3db_x"),
        Kept::covariance("covariance.f_3db_y"),
        Kept::covariance("covariance.f_3db_z"),
        Kept::number("mean_sample_rate_hz"),
        Kept::number("mean_std_sample_rate_hz"),
    ];
    const QUANTITIES: Option<&'static Quantities> = Some(&Quantities {
        polynomials: &OF_TEMPERATURE,
        entries: &[Entry::of("mean_f_s", Scalar(""), "/mean_sample_rate_hz", "/mean_std_sample_rate_hz", "Hz", "facility clock")],
        valid_degc: VALID_DEGC,
    });
    const MAY_LACK: &'static [&'static str] =
        &["coil_temperature_degc", "quantity", "rotation", "residual_field", "joint", "f_s_hz", "f_s_std_hz"];
    fn file_name(&self) -> String {
        format!("THERMAL_AC_PARAMETER__{}.TAF", self.head.first_run())
    }
}

impl ThermalHead {
    /// The covariance that users of a polynomial need: of both types where type B is stated.
    fn whole_covariance(&self, name: &str) -> Option<&Vec<Vec<f64>>> {
        self.covariance_combined.get(name).or_else(|| self.covariance.get(name))
    }

    /// Polynomials with the covariances that the file states; a covariance of size zero is not known.
    pub(super) fn polynomials(&self, named: [(&str, &Vec<f64>); 3]) -> [TemperaturePolynomial; 3] {
        named.map(|(name, coefficients)| stated_polynomial(coefficients, self.whole_covariance(name), self.valid_degc))
    }

    /// Id of the first run as it stands in file names.
    #[must_use]
    pub fn first_run(&self) -> String {
        self.runs.first().map_or_else(String::new, |id| id.replace('_', "-"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An order that was given is taken at its word; one that the runs chose for want of points tells nothing of the slope.
    #[test]
    fn a_constant_is_a_slope_of_zero_only_where_it_was_given_or_is_exact() {
        let quantity = |name: &str, order: usize, reason: Reason| QuantityFound {
            name: name.to_owned(),
            unit: String::new(),
            runs: Vec::new(),
            valid_degc: [0.0, 1.0],
            degrees_of_freedom: 1,
            factor_95: 1.96,
            order,
            order_by: reason,
            aicc: Vec::new(),
            leave_one_out: Vec::new(),
            value: Vec::new(),
            std: Vec::new(),
            residual: Vec::new(),
            scatter: 0.0,
            widened: 1.0,
            min_error: 0.0,
            max_error: 0.0,
        };
        let known = [
            quantity("sigma_x", 1, Reason::LeastAicc),
            quantity("sigma_y", 0, Reason::Given),
            quantity("sigma_z", 0, Reason::Exact),
            quantity("b_or_x", 0, Reason::TooFewPoints),
        ];
        assert_eq!(without_slope(&known), None);
        for reason in [Reason::TooFewPoints, Reason::LeastAicc, Reason::LeaveOneOut] {
            let all = [known.as_slice(), &[quantity("xi_xz", 0, reason)]].concat();
            assert_eq!(without_slope(&all).as_deref(), Some("xi_xz"));
        }
    }
}
