//! CPF: the linear calibration of one run.

use super::{Body, Conditions, Dropped, FacilityApplied, LinearisationApplied, ModelApplied, Rows, RunHead};
use serde::{Deserialize, Serialize};

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

impl Default for Convention {
    fn default() -> Self {
        Self {
            model: "B_c = phi (B_r - B_or), phi = r_nom rho omega sigma, phi_tilde = omega sigma".to_owned(),
            frames: "B_c nT in coil coordinates; B_r, B_or enT along the sensor axes; matrices nT/enT; r_nom takes nominal sensor to coil coordinates; times s since the run's start".to_owned(),
            residual: "applied field minus modelled measurement, B_c - phi (B_r - B_or)".to_owned(),
            uncertainty: "standard uncertainties, coverage factor 1, from the scatter of the samples within and of the means between the plateaus, slow noise included: 1.96 of them make an interval of 95 % (with plateau means only, Student's factor for quality.degrees_of_freedom); coil constants and coil angles not included".to_owned(),
        }
    }
}

impl Convention {
    /// For linearised readings, and parameters that hold for those alone.
    #[must_use]
    pub fn linearised() -> Self {
        let plain = Self::default();
        Self {
            model: format!(
                "{}; B_r is the linearised reading, raw reading r + c2 r^2 + c3 r^3 with the coefficients of [linearisation]",
                plain.model
            ),
            uncertainty: format!("{}; that of the linearisation included", plain.uncertainty),
            ..plain
        }
    }

    /// For readings from which known effects were taken off.
    #[must_use]
    pub fn without_effects(self) -> Self {
        Self {
            model: format!("{}; the effects of [model] were taken off B_r", self.model),
            uncertainty: format!("{}; that of the parameters of [model] included, taken as independent", self.uncertainty),
            ..self
        }
    }
}

/// A linear calibration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cpf {
    /// What the numbers mean.
    pub convention: Convention,
    /// The run.
    pub run: RunHead,
    /// Position and timing.
    pub setup: Setup,
    /// `Φ` and its parts.
    pub matrix: Matrices,
    /// Angles, degrees.
    pub angle_deg: Angles,
    /// Offset and residual field.
    pub offset: Offset,
    /// Quality of data and model.
    pub quality: Quality,
    /// Standard uncertainties (coverage factor 1).
    pub std: Std,
    /// Covariance of the fitted quantities.
    pub covariance: Covariance,
    /// Noise of the plateau means.
    pub noise: Noise,
    /// Where the calibration holds.
    pub valid: Validity,
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
    #[serde(default)]
    pub warnings: Vec<String>,
}

impl Body for Cpf {
    const FORMAT: &'static str = "CPF";
    fn file_name(&self) -> String {
        format!("PARAMETER_LIN__{}.CPF", self.run.id)
    }
}

impl Cpf {
    /// Name of the file that a thermal group rests on.
    #[must_use]
    pub fn thermal_file_name(&self) -> String {
        format!("PARAMETER_TEMPLIN__{}.CPF", self.run.id)
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
pub struct Offset {
    /// Mean over the used plateaus, enT, sensor axes.
    pub b_or_ent: [f64; 3],
    /// Order of the polynomial trend fitted together with `Φ`.
    pub trend_order: usize,
    /// Coefficients of the trend in `tau`, per component, lowest order first, enT.
    pub trend_ent: [Vec<f64>; 3],
    /// The two times, s since the run's start, at which `tau` is -1 and +1.
    pub tau_span_s: [f64; 2],
}

/// Smallest, mean and largest of a quantity per component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Spread {
    /// Smallest.
    pub min: [f64; 3],
    /// Mean.
    pub mean: [f64; 3],
    /// Largest.
    pub max: [f64; 3],
}

/// Standard deviation and extremes per component.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Standard deviation (divided by the number of values).
    pub std: [f64; 3],
    /// Largest.
    pub max: [f64; 3],
    /// Smallest.
    pub min: [f64; 3],
}

/// Quality of data and model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quality {
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
pub struct Std {
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

/// Covariance of `Φ` (nine elements, row by row) and `B_or` (three).
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Covariance {
    /// Names of rows and columns.
    pub parameters: Vec<String>,
    /// Units of the parameters.
    pub units: Vec<String>,
    /// Rows.
    pub matrix: Vec<Vec<f64>>,
}

/// Noise of the plateau means, per component of the reading.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Noise {
    /// Standard deviation, enT.
    pub std_ent: [f64; 3],
    /// Part of the variance that is correlated from plateau to plateau.
    pub correlated_share: [f64; 3],
    /// Effective number of independent plateaus.
    pub effective_blocks: [f64; 3],
}

/// Where the calibration holds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Validity {
    /// Smallest and largest applied field of the used plateaus per coil axis, nT.
    pub field_coil_nt: [[f64; 2]; 3],
    /// Smallest and largest sensor temperature, °C.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub temperature_degc: Option<[f64; 2]>,
    /// First and last used time, s since the run's start.
    pub time_s: [f64; 2],
}
