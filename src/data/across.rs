//! What an analysis across temperatures takes of every run, and what it says of every run.
//!
//! Parameter files hold these types as they are, so that each is defined here only.

use super::linearisation::LinearisationApplied;
use super::note::Note;
use super::reference::StatedReference;
use super::result::{Rows, RunHead};
use super::run::Location;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A run and its temperatures.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct RunAtTemperature {
    /// Run id.
    pub id: String,
    /// Sensor.
    #[serde(default)]
    pub sensor: String,
    /// Mode.
    #[serde(default)]
    pub mode: String,
    /// Where the sensor stood.
    #[serde(default)]
    pub location: Location,
    /// Mean sensor temperature, °C.
    pub temperature_degc: Option<f64>,
    /// Mean coil-system temperature, °C.
    pub coil_temperature_degc: Option<f64>,
}

impl From<&RunHead> for RunAtTemperature {
    fn from(head: &RunHead) -> Self {
        Self {
            id: head.id.clone(),
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            location: head.location,
            temperature_degc: head.temperature_degc,
            coil_temperature_degc: head.coil_temperature_degc,
        }
    }
}

/// What the sensitivities, angles and offsets of linear calibrations hold for, beside temperatures.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LinearScope {
    /// Lowest and highest field along each nominal sensor axis that every run covered, nT; absent where a run does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub valid_field_nt: Option<[[f64; 2]; 3]>,
    /// The linearisation of the readings; absent if they were taken as they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linearisation: Option<LinearisationApplied>,
    /// Model files whose effects were taken off the readings before.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub known_effects: Vec<String>,
    /// How the part of the sensor whose temperature the coefficients follow goes after its thermistor; absent where both are taken as the same.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub thermistor_lag: Option<FollowedThermistor>,
}

/// How a part of a sensor goes after a thermistor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FollowedThermistor {
    /// `delay`, `first order` or `inverse first order`.
    pub form: String,
    /// Delay or time constant, s; a negative delay where the part is earlier than the thermistor.
    pub lag_s: f64,
}

impl FollowedThermistor {
    /// Of the lag of a sweep; nothing where that is none.
    #[must_use]
    pub fn of(applied: &AppliedLag) -> Option<Self> {
        (applied.form != LagForm::None.name() && applied.lag_s != 0.0)
            .then(|| Self { form: applied.form.clone(), lag_s: applied.lag_s })
    }
}

/// Calibrations of readings that were linearised in different ways, or some of them not at all.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("the readings of the runs were not linearised in one way")]
pub struct LinearisedDifferently;

impl LinearScope {
    /// The limits along the nominal sensor axes of those along the coil axes; `r_nom` takes the former to the latter.
    #[must_use]
    pub fn along_sensor_axes(coil_nt: &[[f64; 2]; 3], r_nom: &Rows) -> [[f64; 2]; 3] {
        std::array::from_fn(|axis| {
            let corner = |end: usize| (0..3).map(|coil| r_nom[coil][axis] * coil_nt[coil][end]).sum::<f64>();
            [corner(0).min(corner(1)), corner(0).max(corner(1))]
        })
    }

    /// What several calibrations together hold for.
    ///
    /// # Errors
    /// Readings that were not linearised in one way.
    pub fn common<'a>(scopes: impl IntoIterator<Item = &'a Self>) -> Result<Self, LinearisedDifferently> {
        let mut scopes = scopes.into_iter();
        let Some(first) = scopes.next() else { return Ok(Self::default()) };
        scopes.try_fold(first.clone(), |common, next| {
            let coefficients = |s: &Self| s.linearisation.as_ref().map(|l| [l.applied.c2_per_ent, l.applied.c3_per_ent2]);
            if coefficients(&common) != coefficients(next) {
                return Err(LinearisedDifferently);
            }
            let both = common.valid_field_nt.zip(next.valid_field_nt);
            let valid_field_nt = both.map(|(a, b)| std::array::from_fn(|i| [a[i][0].max(b[i][0]), a[i][1].min(b[i][1])]));
            let mut known_effects = [common.known_effects.as_slice(), &next.known_effects].concat();
            known_effects.sort();
            known_effects.dedup();
            Ok(Self { valid_field_nt, known_effects, ..common })
        })
    }
}

/// How the values of a run change by one standard deviation of something that it shares with other runs, such as the scale factor of a coil:
/// with the same sign in all of them, however many there are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CommonChange {
    /// What it is; runs with the same words share it.
    pub source: String,
    /// Of the sensitivities, nT/enT.
    pub sigma: [f64; 3],
    /// Of ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
    /// Of offset and residual field, enT.
    pub b_or_ent: [f64; 3],
}

impl CommonChange {
    /// σ, ξ and B_or in turn.
    #[must_use]
    pub fn all(&self) -> [[f64; 3]; 3] {
        [self.sigma, self.xi_deg, self.b_or_ent]
    }

    /// Changes of a file that states standard uncertainties of type B alone, of σ, ξ and B_or: one of each value, in the same direction in all
    /// runs of such files.
    #[must_use]
    pub fn of_std(std_b: [Option<[f64; 3]>; 3]) -> Vec<Self> {
        const NAMES: [[&str; 3]; 3] =
            [["sigma_x", "sigma_y", "sigma_z"], ["xi_xy", "xi_xz", "xi_yz"], ["b_or_x", "b_or_y", "b_or_z"]];
        let one = |(which, i): (usize, usize)| {
            let mut all = [[0.0; 3]; 3];
            // What is not stated is not known.
            all[which][i] = std_b[which].map_or(f64::NAN, |std| std[i]);
            let [sigma, xi_deg, b_or_ent] = all;
            Self { source: Self::source_of(NAMES[which][i]), sigma, xi_deg, b_or_ent }
        };
        (0..9).map(|k| one((k / 3, k % 3))).collect()
    }

    /// What stands for the source of the uncertainty of a quantity in files that do not tell it.
    #[must_use]
    pub fn source_of(quantity: &str) -> String {
        format!("type B of {quantity}")
    }

    /// Standard uncertainties of σ, ξ and B_or from all of them; nan where one is not known.
    #[must_use]
    pub fn std_of(all: &[Self]) -> [[f64; 3]; 3] {
        let square = |which: usize, i: usize| all.iter().map(|change| change.all()[which][i].powi(2)).sum::<f64>();
        std::array::from_fn(|which| std::array::from_fn(|i| square(which, i).sqrt()))
    }
}

/// Values of one run that depend on temperature.
#[derive(Clone, Debug, PartialEq)]
pub enum RunValues {
    /// Of a linear calibration.
    Lin {
        /// Sensitivity, nT/enT.
        sigma: [f64; 3],
        /// ξ_xy, ξ_xz, ξ_yz, degrees.
        xi_deg: [f64; 3],
        /// Offset and residual field, enT.
        b_or_ent: [f64; 3],
        /// Standard uncertainties of the three in turn; `None` if the file does not tell.
        std: [Option<[f64; 3]>; 3],
        /// Their degrees of freedom, where only the scatter of plateau means told them: Student's factor belongs to an interval then.
        freedom: Option<usize>,
        /// Those of type B, as changes by everything that runs share; `None` if the file does not tell.
        common: Option<Vec<CommonChange>>,
        /// λ_x, μ_y, ν_z, degrees; nan where the file does not tell.
        rotation_deg: [f64; 3],
        /// Their standard uncertainties, degrees; nan where the file does not tell.
        rotation_std_deg: [f64; 3],
        /// Rotation matrix.
        rho: Option<Rows>,
        /// Nominal axes of the sensor in coil axes, along which `b_or_ent` saw the residual field; `None` if the file does not tell.
        r_nom: Option<Box<Rows>>,
        /// What they hold for.
        scope: Box<LinearScope>,
    },
    /// Of an offset measurement.
    Offset {
        /// Offset, enT.
        offset_ent: [f64; 3],
        /// Its standard uncertainty, enT.
        std: Option<[f64; 3]>,
        /// That of type B, which runs with one facility share; `None` if the file states none.
        std_b: Option<[f64; 3]>,
        /// Temperatures at which the offsets hold, °C, where they are not that of the run.
        degc: Option<[f64; 3]>,
        /// Residual field, enT.
        residual_ent: [f64; 3],
        /// Its standard uncertainty, enT; nan where the file does not tell.
        residual_std: [f64; 3],
        /// Coil axes along which the components saw it.
        seen_along: Vec<String>,
    },
    /// Of a frequency measurement.
    Freq {
        /// -3 dB frequency of the model, Hz.
        model_hz: Option<[f64; 3]>,
        /// Its standard uncertainty, Hz.
        model_std_hz: Option<[f64; 3]>,
        /// Temperatures at which the components hold, °C, where the sensor temperature moved.
        model_degc: Option<[f64; 3]>,
        /// -3 dB frequency from the neighbouring amplitudes, Hz.
        igep_hz: Option<[f64; 3]>,
        /// Mean sampling frequency, Hz.
        f_s_hz: Option<f64>,
        /// Its standard uncertainty, Hz.
        f_s_std_hz: Option<f64>,
    },
}

/// One calibrated run in an analysis across temperatures.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibratedRun {
    /// Name of its parameter file.
    pub file: String,
    /// The run.
    pub run: RunAtTemperature,
    /// Channel of the sensor temperature, if the file tells it.
    pub channel: Option<String>,
    /// Its values.
    pub values: RunValues,
    /// How the sensor stands in its reference cube, if the file tells it.
    pub reference: Option<StatedReference>,
    /// What qualifies its values.
    pub notes: Vec<Note>,
    /// The run that holds most of its readings as well, where they are of one recording.
    pub copy_of: Option<String>,
}

/// Rotation angles of every run, degrees; nan where a file does not tell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunRotations {
    /// λ_x.
    pub lambda_x_deg: Vec<f64>,
    /// μ_y.
    pub mu_y_deg: Vec<f64>,
    /// ν_z.
    pub nu_z_deg: Vec<f64>,
    /// Standard uncertainty of λ_x.
    pub lambda_x_std_deg: Vec<f64>,
    /// Standard uncertainty of μ_y.
    pub mu_y_std_deg: Vec<f64>,
    /// Standard uncertainty of ν_z.
    pub nu_z_std_deg: Vec<f64>,
    /// Rotation matrix of the first run, as rows; absent if its file does not tell.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub initial: Option<Rows>,
}

/// Extremes of applied field minus modelled measurement per run and coil axis, nT.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunModelErrors {
    /// Smallest, one row per run.
    pub min_nt: Vec<[f64; 3]>,
    /// Largest, one row per run.
    pub max_nt: Vec<[f64; 3]>,
}

/// Residual field of the coil system in every run, along the sensor axes in their normal position, enT; nan where it is not known.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunResidualFields {
    /// x.
    pub x_ent: Vec<f64>,
    /// y.
    pub y_ent: Vec<f64>,
    /// z.
    pub z_ent: Vec<f64>,
    /// Standard uncertainty of x, enT.
    pub x_std_ent: Vec<f64>,
    /// Standard uncertainty of y, enT.
    pub y_std_ent: Vec<f64>,
    /// Standard uncertainty of z, enT.
    pub z_std_ent: Vec<f64>,
    /// Coil axes along which x, y and z saw it in the first run; empty if its file does not tell.
    pub seen_along: Vec<String>,
}

/// A linear calibration that took part in the pair.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairedCalibration {
    /// Parameter file; for the polynomials in place of a run, `polynomials`.
    pub file: String,
    /// Sensor temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<f64>,
    /// Sensitivities, nT/enT.
    pub sigma: [f64; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
    /// Standard uncertainties of the sensitivities, nT/enT.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sigma_std: Option<[f64; 3]>,
    /// Standard uncertainties of the angles, degrees.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub xi_std_deg: Option<[f64; 3]>,
}

/// Residual field of the coil system where the temperature cycle was measured.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CentreResidual {
    /// Parameter file of the offset measurement.
    pub file: String,
    /// Its sensor temperature T2, °C.
    pub temperature_degc: f64,
    /// Its offset, enT.
    pub b_off_ent: [f64; 3],
    /// `B_res`, enT, along the sensor axes.
    pub b_res_ent: [f64; 3],
    /// Its standard uncertainty, enT.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub b_res_std_ent: Option<[f64; 3]>,
}

/// What is applied of the lags of a thermistor.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LagForm {
    /// Neither: none is significant.
    #[serde(rename = "none")]
    None,
    /// The delay.
    #[serde(rename = "delay")]
    Delay,
    /// The time constant.
    #[serde(rename = "first order")]
    FirstOrder,
    /// The lag of a model file in their place.
    #[serde(rename = "of the model")]
    OfTheModel,
    /// A lag that was given in their place.
    #[serde(rename = "given")]
    Given,
}

impl LagForm {
    /// The word of files.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            LagForm::None => "none",
            LagForm::Delay => "delay",
            LagForm::FirstOrder => "first order",
            LagForm::OfTheModel => "of the model",
            LagForm::Given => "given",
        }
    }
}

/// How it was decided which lag the temperatures of a sweep have.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum LagDecision {
    /// It is significant beside polynomials of one order higher.
    #[serde(rename = "found")]
    Found,
    /// None is significant beside polynomials of one order higher.
    #[serde(rename = "none claimed")]
    NoneClaimed,
    /// None was asked for.
    #[serde(rename = "not looked for")]
    NotLookedFor,
    /// It was given.
    #[serde(rename = "given")]
    Given,
    /// That of a model file.
    #[serde(rename = "of the model")]
    OfTheModel,
}

/// The lag that the temperatures of a sweep have.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct AppliedLag {
    /// `delay`, `first order`, `inverse first order` or `none`.
    pub form: String,
    /// Delay or time constant, s; a negative delay where the sensor is earlier than the thermistor.
    pub lag_s: f64,
    /// Its standard uncertainty, which is in that of all coefficients; absent for a lag that was not fitted.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_s: Option<f64>,
    /// How it was decided.
    pub decision: LagDecision,
}

/// A number that was not determined has no key.
fn unknown() -> f64 {
    f64::NAN
}

/// How the sensor follows a thermistor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ThermistorLag {
    /// Channel.
    pub channel: String,
    /// What was applied if this channel was used.
    pub form: LagForm,
    /// Best delay, s: the sensor is that much later than the thermistor, or earlier if negative.
    #[serde(default = "unknown")]
    pub delay_s: f64,
    /// Its standard uncertainty.
    #[serde(default = "unknown")]
    pub delay_std_s: f64,
    /// Best time constant, s: the sensor follows the thermistor with it, or the thermistor the sensor if negative.
    #[serde(default = "unknown")]
    pub time_constant_s: f64,
    /// Its standard uncertainty.
    #[serde(default = "unknown")]
    pub time_constant_std_s: f64,
    /// Deviance (twice the log likelihood) that the better of both gains over no lag.
    pub gain: f64,
    /// Deviance by which the delay is better than the time constant.
    pub delay_over_first_order: f64,
    /// Standard deviation of the readings about the model with the lag, geometric mean of the components, enT.
    pub residual_std_ent: f64,
}
