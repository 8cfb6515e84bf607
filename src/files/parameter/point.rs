//! What an analysis across temperatures needs of the parameter file of one run. Only these keys must be there, so that files of
//! other programs can take part.

use super::{Cpf, Fpf, Opf, content_hash};
use crate::data::error::{Finding, Severity};
use crate::data::result::{Rows, RunHead};
use crate::files::source::{Digested, read_whole};
use serde::Deserialize;
use std::path::Path;

/// Run and temperature.
#[derive(Clone, Debug, PartialEq, Deserialize)]
pub struct RunPoint {
    /// Run id.
    pub id: String,
    /// Sensor.
    #[serde(default)]
    pub sensor: String,
    /// Mode.
    #[serde(default)]
    pub mode: String,
    /// Mean sensor temperature, °C.
    pub temperature_degc: Option<f64>,
    /// Mean coil-system temperature, °C.
    pub coil_temperature_degc: Option<f64>,
}

/// Values of one run that depend on temperature.
#[derive(Clone, Debug, PartialEq)]
pub enum Values {
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
        /// λ_x, μ_y, ν_z, degrees; nan where the file does not tell.
        rotation_deg: [f64; 3],
        /// Their standard uncertainties, degrees; nan where the file does not tell.
        rotation_std_deg: [f64; 3],
        /// Rotation matrix.
        rho: Option<Rows>,
    },
    /// Of an offset measurement.
    Offset {
        /// Offset, enT.
        offset_ent: [f64; 3],
        /// Its standard uncertainty, enT.
        std: Option<[f64; 3]>,
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
        /// -3 dB frequency from the neighbouring amplitudes, Hz.
        igep_hz: Option<[f64; 3]>,
        /// Mean sampling frequency, Hz.
        f_s_hz: Option<f64>,
        /// Its standard uncertainty, Hz.
        f_s_std_hz: Option<f64>,
    },
}

/// One run in an analysis across temperatures.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Name of the parameter file.
    pub file: String,
    /// The run.
    pub run: RunPoint,
    /// Channel of the sensor temperature, if the file tells it.
    pub channel: Option<String>,
    /// Its values.
    pub values: Values,
}

#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
}

#[derive(Deserialize)]
struct ConditionsKeys {
    sensor_channel: Option<String>,
}

#[derive(Deserialize)]
struct CpfKeys {
    run: RunPoint,
    matrix: MatrixKeys,
    angle_deg: AngleKeys,
    offset: OffsetKeys,
    #[serde(default)]
    std: StdKeys,
    conditions: Option<ConditionsKeys>,
}

#[derive(Deserialize)]
struct MatrixKeys {
    sigma: Rows,
    rho: Option<Rows>,
}

#[derive(Deserialize)]
struct AngleKeys {
    xi_xy: f64,
    xi_xz: f64,
    xi_yz: f64,
    lambda_x: Option<f64>,
    mu_y: Option<f64>,
    nu_z: Option<f64>,
}

#[derive(Deserialize)]
struct OffsetKeys {
    b_or_ent: [f64; 3],
}

#[derive(Default, Deserialize)]
struct StdKeys {
    sigma: Option<[f64; 3]>,
    xi_deg: Option<[f64; 3]>,
    b_or_ent: Option<[f64; 3]>,
    lambda_mu_nu_deg: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct OpfKeys {
    run: RunPoint,
    offset_ent: [f64; 3],
    offset_std_ent: Option<[f64; 3]>,
    residual_ent: Option<[f64; 3]>,
    residual_std_ent: Option<[f64; 3]>,
    method: Option<MethodKeys>,
    conditions: Option<ConditionsKeys>,
}

#[derive(Deserialize)]
struct MethodKeys {
    normal_axis: Option<Vec<String>>,
}

#[derive(Deserialize)]
struct FpfKeys {
    run: RunPoint,
    f_3db_model_hz: Option<[f64; 3]>,
    f_3db_model_std_hz: Option<[f64; 3]>,
    f_3db_igep_hz: Option<[f64; 3]>,
    mean_f_s_hz: Option<f64>,
    mean_f_s_std_hz: Option<f64>,
    conditions: Option<ConditionsKeys>,
}

const NONE: [f64; 3] = [f64::NAN; 3];

/// Reads what is needed of a CPF, OPF or FPF; notes on the file go to `findings`.
///
/// # Errors
/// Not TOML, another format, a missing key, or a hash that does not match.
pub fn read_point(path: &Path, findings: &mut Vec<Finding>) -> Result<(Point, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let shown = path.display().to_string();
    let refuse = |rule: String, remedy: &str| Finding::error(&shown, rule, remedy);
    let text = String::from_utf8(bytes)
        .map_err(|_| refuse("the file is not UTF-8 text".to_owned(), "take it from the archive again"))?;
    let wrong = |e: toml_edit::de::Error| refuse(format!("is not a parameter file: {}", e.message()), "check the file");
    let head: Head = toml_edit::de::from_str(&text).map_err(wrong)?;
    if head.version != super::VERSION {
        return Err(refuse(format!("holds version {}, not {}", head.version, super::VERSION), "use the program that wrote it"));
    }
    match text.lines().find_map(|l| l.strip_prefix("content_sha256 = ")) {
        None => findings.push(
            Finding::error(
                &shown,
                "carries no hash of its content, so that a change would not show",
                "nothing to do if it was written by hand",
            )
            .weighing(Severity::Warning),
        ),
        Some(stated) if stated.trim_matches('"') == content_hash(&text) => {}
        Some(_) => {
            return Err(refuse(
                "was changed after it was written: its hash does not match".to_owned(),
                "take the original, or fit again",
            ));
        }
    }
    let file = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let channel = |c: Option<ConditionsKeys>| c.and_then(|c| c.sensor_channel);
    let point = match head.format.as_str() {
        "CPF" => {
            let CpfKeys { run, matrix, angle_deg: a, offset, std, conditions } = toml_edit::de::from_str(&text).map_err(wrong)?;
            let or_nan = |v: Option<f64>| v.unwrap_or(f64::NAN);
            let values = Values::Lin {
                sigma: std::array::from_fn(|i| matrix.sigma[i][i]),
                xi_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
                b_or_ent: offset.b_or_ent,
                std: [std.sigma, std.xi_deg, std.b_or_ent],
                rotation_deg: [or_nan(a.lambda_x), or_nan(a.mu_y), or_nan(a.nu_z)],
                rotation_std_deg: std.lambda_mu_nu_deg.unwrap_or(NONE),
                rho: matrix.rho,
            };
            Point { file, run, channel: channel(conditions), values }
        }
        "OPF" => {
            let keys: OpfKeys = toml_edit::de::from_str(&text).map_err(wrong)?;
            let values = Values::Offset {
                offset_ent: keys.offset_ent,
                std: keys.offset_std_ent,
                residual_ent: keys.residual_ent.unwrap_or(NONE),
                residual_std: keys.residual_std_ent.unwrap_or(NONE),
                seen_along: keys.method.and_then(|m| m.normal_axis).unwrap_or_default(),
            };
            Point { file, run: keys.run, channel: channel(keys.conditions), values }
        }
        "FPF" => {
            let keys: FpfKeys = toml_edit::de::from_str(&text).map_err(wrong)?;
            let values = Values::Freq {
                model_hz: keys.f_3db_model_hz,
                model_std_hz: keys.f_3db_model_std_hz,
                igep_hz: keys.f_3db_igep_hz,
                f_s_hz: keys.mean_f_s_hz,
                f_s_std_hz: keys.mean_f_s_std_hz,
            };
            Point { file, run: keys.run, channel: channel(keys.conditions), values }
        }
        other => {
            return Err(refuse(
                format!("holds format {other}, which is not the result of a single run"),
                "name CPF, OPF or FPF files",
            ));
        }
    };
    Ok((point, digested))
}

impl From<&RunHead> for RunPoint {
    fn from(head: &RunHead) -> Self {
        Self {
            id: head.id.clone(),
            sensor: head.sensor.clone(),
            mode: head.mode.clone(),
            temperature_degc: head.temperature_degc,
            coil_temperature_degc: head.coil_temperature_degc,
        }
    }
}

impl Point {
    /// A linear calibration under the name of its file in a thermal group.
    #[must_use]
    pub fn of_lin(cpf: &Cpf) -> Self {
        let a = &cpf.angle_deg;
        Self {
            file: cpf.thermal_file_name(),
            run: (&cpf.run).into(),
            channel: cpf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: Values::Lin {
                sigma: std::array::from_fn(|i| cpf.matrix.sigma[i][i]),
                xi_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
                b_or_ent: cpf.offset.b_or_ent,
                std: [Some(cpf.std.sigma), Some(cpf.std.xi_deg), Some(cpf.std.b_or_ent)],
                rotation_deg: [a.lambda_x, a.mu_y, a.nu_z],
                rotation_std_deg: cpf.std.lambda_mu_nu_deg,
                rho: Some(cpf.matrix.rho),
            },
        }
    }

    /// An offset measurement.
    #[must_use]
    pub fn of_offset(opf: &Opf) -> Self {
        use super::Body;
        Self {
            file: opf.file_name(),
            run: (&opf.run).into(),
            channel: opf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: Values::Offset {
                offset_ent: opf.offset_ent,
                std: Some(opf.offset_std_ent),
                residual_ent: opf.residual_ent,
                residual_std: opf.residual_std_ent,
                seen_along: opf.method.normal_axis.to_vec(),
            },
        }
    }

    /// A frequency measurement.
    #[must_use]
    pub fn of_freq(fpf: &Fpf) -> Self {
        use super::Body;
        Self {
            file: fpf.file_name(),
            run: (&fpf.run).into(),
            channel: fpf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: Values::Freq {
                model_hz: Some(fpf.f_3db_model_hz),
                model_std_hz: Some(fpf.f_3db_model_std_hz),
                igep_hz: Some(fpf.f_3db_igep_hz),
                f_s_hz: fpf.mean_f_s_hz,
                f_s_std_hz: fpf.mean_f_s_std_hz,
            },
        }
    }
}
