//! The parts of a linear calibration of one run.
//!
//! The result of the analysis and its parameter file both hold them, and analyses of several runs take them from either, so that each
//! is defined here only.

use super::across::CommonChange;
use super::convention::{Alignment, Convention};
use super::note::{Note, NoteKind};
use super::reference::{Reference, StatedReference};
use super::result::{AT_REST_K, Covariance, Rows, RunHead, Spread, Summary};
use super::run::Header;
use serde::{Deserialize, Serialize};
use std::fmt;
use thiserror::Error;

/// What a run says of its sensor.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearCalibration {
    /// The run.
    pub run: RunHead,
    /// Position and timing.
    pub setup: Setup,
    /// `Φ` and its parts.
    pub matrix: Matrices,
    /// Angles, degrees.
    pub angle_deg: Angles,
    /// Offset and residual field.
    pub offset: OffsetTrend,
    /// Quality of data and model.
    pub quality: LinearQuality,
    /// Standard uncertainties (coverage factor 1), type A.
    pub std: LinearStd,
    /// Covariance of the fitted quantities, type A.
    pub covariance: Covariance,
    /// What the uncertainty of the facility adds; absent where it is not stated.
    #[serde(flatten)]
    pub of_facility: Option<LinearTypeB>,
    /// Noise of the plateau means.
    pub noise: PlateauNoise,
    /// Where the calibration holds.
    pub valid: LinearValidity,
    /// What the parameters follow of the sensor temperature; absent where it was at rest and nothing is known of it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub slopes: Option<TemperatureSlopes>,
    /// How the sensor stands in its reference cube, if that is stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reference: Option<Reference>,
}

impl LinearCalibration {
    /// The covariance that users of the calibration need: of both types where type B is stated.
    #[must_use]
    pub fn whole_covariance(&self) -> &Covariance {
        self.of_facility.as_ref().map_or(&self.covariance, |b| &b.covariance_combined)
    }

    /// The standard uncertainties that users of the calibration need: of both types where type B is stated.
    #[must_use]
    pub fn whole_std(&self) -> &LinearStd {
        self.of_facility.as_ref().map_or(&self.std, |b| &b.std_combined)
    }

    /// σ_x, σ_y, σ_z, nT/enT.
    #[must_use]
    pub fn sigma_nt_per_ent(&self) -> [f64; 3] {
        std::array::from_fn(|i| self.matrix.sigma[i][i])
    }

    /// Sensitivities and angles.
    #[must_use]
    pub fn alignment(&self) -> Alignment {
        let a = &self.angle_deg;
        let (sigma, xi_deg) = (self.sigma_nt_per_ent(), [a.xi_xy, a.xi_xz, a.xi_yz]);
        Alignment { convention: Convention::BepiColombo, sigma, xi_deg }
    }

    /// How the sensor stands in its reference cube, as it was stated.
    #[must_use]
    pub fn stated_reference(&self) -> Option<StatedReference> {
        self.reference.as_ref()?.stated(&self.alignment()).ok()
    }
}

/// How the run was made and cut.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Setup {
    /// Id of the position.
    pub position: u32,
    /// Sensor axes along coil axes.
    pub position_axes: [String; 3],
    /// Median time for which a field was applied, s.
    pub field_duration_s: f64,
    /// Time left out after every step, s.
    pub settling_s: f64,
    /// Time left out before every step, s.
    pub early_end_s: f64,
}

/// Matrices as rows.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Matrices {
    /// Which of the two conventions `omega` follows: `BepiColombo` (lower triangular) or `Rosetta`.
    pub omega_convention: String,
    /// Nominal sensor to coil coordinates.
    pub r_nom: Rows,
    /// Rotation.
    pub rho: Rows,
    /// Misalignment.
    pub omega: Rows,
    /// Sensitivity, diagonal, nT/enT.
    pub sigma: Rows,
    /// `R_nom ρ ω σ`, nT/enT.
    pub phi: Rows,
    /// `ω σ`, nT/enT.
    pub phi_tilde: Rows,
}

/// Angles, degrees.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Angles {
    /// Between sensor axes x and y.
    pub xi_xy: f64,
    /// Between sensor axes x and z.
    pub xi_xz: f64,
    /// Between sensor axes y and z.
    pub xi_yz: f64,
    /// Between the real and the nominal X axis.
    pub lambda_x: f64,
    /// Between the real and the nominal Y axis.
    pub mu_y: f64,
    /// Between the real and the nominal Z axis.
    pub nu_z: f64,
}

/// Offset and residual field, `B_or = B_off + B_res`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct OffsetTrend {
    /// Mean over the used plateaus, enT, sensor axes.
    pub b_or_ent: [f64; 3],
    /// Order of the polynomial trend fitted together with `Φ`.
    pub trend_order: usize,
    /// Coefficients of the trend in `tau`, per component, lowest order first, enT.
    pub trend_ent: [Vec<f64>; 3],
    /// The two times, s since the run's start, at which `tau` is -1 and +1.
    pub tau_span_s: [f64; 2],
    /// For which noise the uncertainties of the offset hold, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub std_covers: Option<String>,
}

/// Quality of data and model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearQuality {
    /// Plateaus used.
    pub blocks_used: usize,
    /// Plateaus in the run.
    pub blocks_total: usize,
    /// Samples lost.
    pub lost_samples: u64,
    /// Samples left out beside spikes.
    pub spike_samples: u64,
    /// Plateaus with reduced weight in the robust fit; absent if the fit was not robust.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub downweighted_blocks: Option<usize>,
    /// Condition number of the design with columns scaled to one.
    pub condition: f64,
    /// Degrees of freedom per component.
    pub degrees_of_freedom: usize,
    /// Determinant of the rotation matrix.
    pub rotation_determinant: f64,
    /// Standard deviation of the samples within blocks, enT, sensor axes; absent if the file has plateau means only.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub raw_std_ent: Option<Spread>,
    /// Applied field minus modelled measurement, nT, coil axes.
    pub residual_nt: Summary,
}

/// Standard uncertainties.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearStd {
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma: [f64; 3],
    /// ξ_xy, ξ_xz, ξ_yz, degrees.
    pub xi_deg: [f64; 3],
    /// `B_or`, enT.
    pub b_or_ent: [f64; 3],
    /// λ, μ, ν, degrees.
    pub lambda_mu_nu_deg: [f64; 3],
    /// `Φ`, nT/enT.
    pub phi: Rows,
    /// `φ̃`, nT/enT.
    pub phi_tilde: Rows,
}

/// Type B uncertainties of a linear calibration, and both types together.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearTypeB {
    /// Standard uncertainties, type B: those of the facility, common to all runs that use the same facility file.
    pub std_b: LinearStd,
    /// Standard uncertainties of both types.
    pub std_combined: LinearStd,
    /// Covariance of the fitted quantities, type B.
    pub covariance_b: Covariance,
    /// The same as changes by one standard deviation of everything that runs share; absent in files from before they were told.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub common: Vec<CommonChange>,
    /// The same of both types.
    pub covariance_combined: Covariance,
}

impl LinearTypeB {
    /// Those of type B with those of type A, which are independent of them.
    #[must_use]
    pub fn with(
        std_b: LinearStd,
        covariance_b: Covariance,
        common: Vec<CommonChange>,
        std: &LinearStd,
        covariance: &Covariance,
    ) -> Self {
        let (std_combined, covariance_combined) = (std.combined(&std_b), covariance.plus(&covariance_b));
        Self { std_combined, covariance_combined, std_b, covariance_b, common }
    }
}

impl LinearTypeB {
    /// The changes by what runs share; made of the standard uncertainties where the file does not tell them.
    #[must_use]
    pub fn changes(&self) -> Vec<CommonChange> {
        let b = &self.std_b;
        if self.common.is_empty() { CommonChange::of_std([b.sigma, b.xi_deg, b.b_or_ent].map(Some)) } else { self.common.clone() }
    }
}

impl LinearStd {
    /// Root sums of squares with independent ones.
    fn combined(&self, other: &Self) -> Self {
        let three = |a: &[f64; 3], b: &[f64; 3]| -> [f64; 3] { std::array::from_fn(|i| a[i].hypot(b[i])) };
        let rows = |a: &Rows, b: &Rows| -> Rows { std::array::from_fn(|i| three(&a[i], &b[i])) };
        Self {
            sigma: three(&self.sigma, &other.sigma),
            xi_deg: three(&self.xi_deg, &other.xi_deg),
            b_or_ent: three(&self.b_or_ent, &other.b_or_ent),
            lambda_mu_nu_deg: three(&self.lambda_mu_nu_deg, &other.lambda_mu_nu_deg),
            phi: rows(&self.phi, &other.phi),
            phi_tilde: rows(&self.phi_tilde, &other.phi_tilde),
        }
    }
}

/// Noise of the plateau means, per component of the reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlateauNoise {
    /// Standard deviation, enT.
    pub std_ent: [f64; 3],
    /// Part of the variance that is correlated from plateau to plateau.
    pub correlated_share: [f64; 3],
    /// Effective number of independent plateaus.
    pub effective_blocks: [f64; 3],
}

/// What the parameters of a run follow of the sensor temperature about the one at which they are stated.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TemperatureSlopes {
    /// Temperature at which the parameters are stated, °C.
    pub at_degc: f64,
    /// Highest power of the temperature in sensitivities and angles.
    pub order: usize,
    /// Of σ_x, σ_y, σ_z, nT/enT/K.
    pub sigma: [f64; 3],
    /// Of ξ_xy, ξ_xz, ξ_yz, degrees/K.
    pub xi_deg: [f64; 3],
    /// Of `B_or` beside the trend, enT/K; absent where the trend in time cannot be told from it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub b_or_ent: Option<[f64; 3]>,
    /// Where those of sensitivities and angles come from.
    pub source: SlopeSource,
    /// Standard uncertainties.
    pub std: SlopeStd,
}

/// Where slopes with the sensor temperature come from; one word, or the name of a file, in files.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub enum SlopeSource {
    /// Found in the run itself, `run`.
    Run,
    /// Held by bounds that the campaign states, `bound`.
    Bound,
    /// Not known: held by the largest that are published, `assumed`.
    Assumed,
    /// Those of polynomials: their file.
    Polynomials(String),
}

impl From<String> for SlopeSource {
    fn from(text: String) -> Self {
        match text.as_str() {
            "run" => Self::Run,
            "bound" => Self::Bound,
            "assumed" => Self::Assumed,
            _ => Self::Polynomials(text),
        }
    }
}

impl From<SlopeSource> for String {
    fn from(source: SlopeSource) -> Self {
        source.to_string()
    }
}

impl fmt::Display for SlopeSource {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Run => "run",
            Self::Bound => "bound",
            Self::Assumed => "assumed",
            Self::Polynomials(file) => file,
        })
    }
}

/// Standard uncertainties of slopes with the sensor temperature.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SlopeStd {
    /// nT/enT/K.
    pub sigma: [f64; 3],
    /// Degrees/K.
    pub xi_deg: [f64; 3],
    /// enT/K.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub b_or_ent: Option<[f64; 3]>,
}

/// Where the calibration holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearValidity {
    /// Smallest and largest applied field of the used plateaus per coil axis, nT.
    pub field_coil_nt: [[f64; 2]; 3],
    /// Smallest and largest sensor temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<[f64; 2]>,
    /// First and last used time, s since the run's start.
    pub time_s: [f64; 2],
}

/// Sensitivities that are not those of the sensor and mode of a run.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("the sensitivities of {file} are those of {own}, the run is of {of_run}")]
pub struct OfAnotherSensor {
    file: String,
    own: String,
    of_run: String,
}

impl OfAnotherSensor {
    /// What to do.
    pub const REMEDY: &'static str = "name the linear calibration of the sensor and mode of the run, or leave --cpf out";
}

/// The sensitivities of a sensor in a mode, which turn enT into nT.
#[derive(Clone, Debug, PartialEq)]
pub struct Sensitivities {
    /// Sensor.
    pub sensor: String,
    /// Mode.
    pub mode: String,
    /// σ_x, σ_y, σ_z, nT/enT.
    pub sigma_nt_per_ent: [f64; 3],
    /// Sensor temperature at which they hold, °C, if it is known.
    pub temperature_degc: Option<f64>,
}

impl From<&LinearCalibration> for Sensitivities {
    fn from(calibration: &LinearCalibration) -> Self {
        Self {
            sensor: calibration.run.sensor.clone(),
            mode: calibration.run.mode.clone(),
            sigma_nt_per_ent: calibration.sigma_nt_per_ent(),
            temperature_degc: calibration.run.temperature_degc,
        }
    }
}

impl Sensitivities {
    /// Refuses them for a run of another sensor or mode; `name` is that of their file.
    ///
    /// # Errors
    /// The sensor or the mode differs.
    pub fn must_fit(&self, name: &str, run: &Header) -> Result<(), OfAnotherSensor> {
        if (&self.sensor, &self.mode) == (&run.sensor, &run.mode) {
            return Ok(());
        }
        let told = |sensor: &str, mode: &str| format!("sensor `{sensor}`, mode `{mode}`");
        let (own, of_run) = (told(&self.sensor, &self.mode), told(&run.sensor, &run.mode));
        Err(OfAnotherSensor { file: name.to_owned(), own, of_run })
    }

    /// Says of a run at another temperature that values in nT are made with the sensitivities of this one; `name` is that of their file.
    #[must_use]
    pub fn of_another_temperature(&self, name: &str, own: &RunHead) -> Option<Note> {
        let (degc, own_degc) = self.temperature_degc.zip(own.temperature_degc)?;
        ((degc - own_degc).abs() > AT_REST_K).then(|| {
            let text = format!(
                "values in nT are made with the sensitivities of {name} at {degc:.1} °C, {:.1} K from the temperature of this run; what sensitivities \
                 follow of the temperature is not in them, nor in their uncertainties",
                (degc - own_degc).abs()
            );
            Note::new(NoteKind::Temperature, text).about(name)
        })
    }

    /// A quantity in enT along the sensor axes, or a multiple of it such as a drift or density, in nT.
    #[must_use]
    pub fn to_nt(&self, ent: &[f64; 3]) -> [f64; 3] {
        std::array::from_fn(|i| self.sigma_nt_per_ent[i] * ent[i])
    }
}
