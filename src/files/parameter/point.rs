//! What an analysis across temperatures needs of the parameter file of one run. Only these keys must be there, so that files of
//! other programs can take part.

use super::kept::taken_out;
use super::{Body, Cpf, FileKind, Fpf, Opf, content_hash};
use crate::data::across::{CalibratedRun, CommonChange, LinearScope, RunAtTemperature, RunValues};
use crate::data::calibration::LinearTypeB;
use crate::data::convention::{Alignment, Convention};
use crate::data::error::{Finding, Severity};
use crate::data::linearisation::LinearisationApplied;
use crate::data::note::{Note, Told};
use crate::data::reference::{Reference, StatedReference, is_rotation};
use crate::data::result::Rows;
use crate::files::source::{Digested, read_whole};
use serde::Deserialize;
use std::path::Path;

#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
    #[serde(flatten)]
    told: Told,
}

#[derive(Deserialize)]
struct ConditionsKeys {
    sensor_channel: Option<String>,
}

#[derive(Deserialize)]
struct CpfKeys {
    run: RunAtTemperature,
    matrix: MatrixKeys,
    angle_deg: AngleKeys,
    offset: OffsetKeys,
    #[serde(default)]
    std: StdKeys,
    #[serde(default)]
    std_b: StdKeys,
    common: Option<Vec<CommonChange>>,
    conditions: Option<ConditionsKeys>,
    reference: Option<Reference>,
    linearisation: Option<LinearisationApplied>,
    model: Option<ModelKeys>,
    #[serde(default)]
    valid: ValidKeys,
    quality: Option<QualityKeys>,
}

#[derive(Deserialize)]
struct ModelKeys {
    file: String,
}

#[derive(Default, Deserialize)]
struct ValidKeys {
    field_coil_nt: Option<[[f64; 2]; 3]>,
}

#[derive(Deserialize)]
struct MatrixKeys {
    sigma: Rows,
    rho: Option<Rows>,
    r_nom: Option<Rows>,
    omega_convention: Option<String>,
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
    run: RunAtTemperature,
    offset_ent: [f64; 3],
    offset_std_ent: Option<[f64; 3]>,
    offset_degc: Option<[f64; 3]>,
    residual_ent: Option<[f64; 3]>,
    residual_std_ent: Option<[f64; 3]>,
    std_b: Option<OffsetStdKeys>,
    method: Option<MethodKeys>,
    conditions: Option<ConditionsKeys>,
}

#[derive(Deserialize)]
struct OffsetStdKeys {
    offset_ent: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct MethodKeys {
    normal_axis: Option<Vec<String>>,
}

#[derive(Deserialize)]
struct QualityKeys {
    degrees_of_freedom: Option<usize>,
    raw_std_ent: Option<serde::de::IgnoredAny>,
}

#[derive(Deserialize)]
struct FpfKeys {
    run: RunAtTemperature,
    f_3db_model_hz: Option<[f64; 3]>,
    f_3db_model_std_hz: Option<[f64; 3]>,
    f_3db_model_degc: Option<[f64; 3]>,
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
pub fn read_point(path: &Path, findings: &mut Vec<Finding>) -> Result<(CalibratedRun, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let shown = path.display().to_string();
    let refuse = |rule: String, remedy: &str| Finding::error(&shown, rule, remedy);
    let text = String::from_utf8(bytes)
        .map_err(|_| refuse("the file is not UTF-8 text".to_owned(), "take it from the archive again"))?;
    let wrong = |e: toml_edit::de::Error| refuse(format!("is not a parameter file: {}", e.message()), "check the file");
    let head: Head = toml_edit::de::from_str(&text).map_err(wrong)?;
    super::kind::readable_version(&head.format, head.version).map_err(|(rule, remedy)| refuse(rule, remedy))?;
    match text.lines().find_map(|l| l.strip_prefix("content_sha256 = ")) {
        None => findings.push(
            Finding::error(
                &shown,
                "carries no hash of its content, so that a change would not show",
                "nothing to do if it was written by hand",
            )
            .weighing(Severity::Warning),
        ),
        Some(stated) if stated.trim_matches('"') == content_hash(&text) => {
            if let Some(kind) = FileKind::of_format(&head.format) {
                kind.check(path)?;
            }
        }
        Some(_) => {
            return Err(refuse(
                "was changed after it was written: its hash does not match".to_owned(),
                "take the original, or fit again",
            ));
        }
    }
    let file = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let kind = FileKind::of_format(&head.format);
    let Some((point, kept)) = kind.and_then(|kind| Some((kind.point?, kind.kept))) else {
        let rule = format!("holds format {}, which is not the result of a single run", head.format);
        return Err(refuse(rule, "name CPF, OPF or FPF files"));
    };
    let RunKeys { run, conditions, values, reference } = point(&taken_out(&text, kept)).map_err(wrong)?;
    let (channel, notes) = (conditions.and_then(|c| c.sensor_channel), qualifying(&head.told, &run.id));
    Ok((CalibratedRun { file, run, channel, values, reference, notes, copy_of: None }, digested))
}

/// What qualifies the values of a run.
fn qualifying(told: &Told, run: &str) -> Vec<Note> {
    told.with_values_of(&format!("run {run}"))
}

/// Reads what an analysis across temperatures needs of the text of a parameter file.
pub type Point = fn(&str) -> Result<RunKeys, toml_edit::de::Error>;

/// What every file of a single run has.
pub struct RunKeys {
    run: RunAtTemperature,
    conditions: Option<ConditionsKeys>,
    values: RunValues,
    reference: Option<StatedReference>,
}

/// The point of a linear calibration.
pub(super) fn cpf(text: &str) -> Result<RunKeys, toml_edit::de::Error> {
    let CpfKeys {
        run,
        matrix,
        angle_deg: a,
        offset,
        std,
        std_b,
        common,
        conditions,
        linearisation,
        model,
        valid,
        reference,
        quality,
    } = toml_edit::de::from_str(text)?;
    let or_nan = |v: Option<f64>| v.unwrap_or(f64::NAN);
    let convention = match matrix.omega_convention.as_deref() {
        None | Some("BepiColombo") => Convention::BepiColombo,
        Some("Rosetta") => Convention::Rosetta,
        Some(other) => {
            let rule = format!("`omega_convention` is `{other}`, neither `BepiColombo` nor `Rosetta`");
            return Err(serde::de::Error::custom(rule));
        }
    };
    let sigma = std::array::from_fn(|i| matrix.sigma[i][i]);
    let stated = Alignment { convention, sigma, xi_deg: [a.xi_xy, a.xi_xz, a.xi_yz] };
    let (alignment, [sigma_std, xi_std_deg]) = stated
        .in_convention(Convention::BepiColombo, [std.sigma, std.xi_deg])
        .map_err(|_| <toml_edit::de::Error as serde::de::Error>::custom("no three axes have such angles between them"))?;
    let [sigma_std_b, xi_std_b_deg] = stated
        .in_convention(Convention::BepiColombo, [std_b.sigma, std_b.xi_deg])
        .map_err(|_| <toml_edit::de::Error as serde::de::Error>::custom("no three axes have such angles between them"))?
        .1;
    let std_b = [sigma_std_b, xi_std_b_deg, std_b.b_or_ent];
    // Changes are those of the convention of the file.
    let common = common
        .filter(|_| convention == Convention::BepiColombo)
        .or_else(|| std_b.iter().any(Option::is_some).then(|| CommonChange::of_std(std_b)));
    // The frame is that of the file, whatever the convention that the analyses speak.
    let reference = match reference {
        Some(reference) if reference.from != convention.sensor_frame() || !is_rotation(&reference.rotation) => {
            let rule = "`[reference]` is no rotation from the sensor frame of the file";
            return Err(serde::de::Error::custom(rule));
        }
        reference => reference.and_then(|reference| reference.stated(&stated).ok()),
    };
    let values = RunValues::Lin {
        sigma: alignment.sigma,
        xi_deg: alignment.xi_deg,
        b_or_ent: offset.b_or_ent,
        std: [sigma_std, xi_std_deg, std.b_or_ent],
        freedom: quality.filter(|q| q.raw_std_ent.is_none()).and_then(|q| q.degrees_of_freedom),
        common,
        rotation_deg: [or_nan(a.lambda_x), or_nan(a.mu_y), or_nan(a.nu_z)],
        rotation_std_deg: std.lambda_mu_nu_deg.unwrap_or(NONE),
        rho: matrix.rho,
        r_nom: matrix.r_nom.map(Box::new),
        scope: Box::new(LinearScope {
            valid_field_nt: valid.field_coil_nt.zip(matrix.r_nom).map(|(nt, r)| LinearScope::along_sensor_axes(&nt, &r)),
            linearisation,
            known_effects: model.into_iter().map(|m| m.file).collect(),
            thermistor_lag: None,
        }),
    };
    Ok(RunKeys { run, conditions, values, reference })
}

/// The point of an offset measurement.
pub(super) fn opf(text: &str) -> Result<RunKeys, toml_edit::de::Error> {
    let keys: OpfKeys = toml_edit::de::from_str(text)?;
    let values = RunValues::Offset {
        offset_ent: keys.offset_ent,
        std: keys.offset_std_ent,
        std_b: keys.std_b.and_then(|b| b.offset_ent),
        degc: keys.offset_degc,
        residual_ent: keys.residual_ent.unwrap_or(NONE),
        residual_std: keys.residual_std_ent.unwrap_or(NONE),
        seen_along: keys.method.and_then(|m| m.normal_axis).unwrap_or_default(),
    };
    Ok(RunKeys { run: keys.run, conditions: keys.conditions, values, reference: None })
}

/// The point of a frequency measurement.
pub(super) fn fpf(text: &str) -> Result<RunKeys, toml_edit::de::Error> {
    let keys: FpfKeys = toml_edit::de::from_str(text)?;
    let values = RunValues::Freq {
        model_hz: keys.f_3db_model_hz,
        model_std_hz: keys.f_3db_model_std_hz,
        model_degc: keys.f_3db_model_degc,
        igep_hz: keys.f_3db_igep_hz,
        f_s_hz: keys.mean_f_s_hz,
        f_s_std_hz: keys.mean_f_s_std_hz,
    };
    Ok(RunKeys { run: keys.run, conditions: keys.conditions, values, reference: None })
}

/// A linear calibration under the name of its file in a thermal group.
impl From<&Cpf> for CalibratedRun {
    fn from(cpf: &Cpf) -> Self {
        let own = &cpf.calibration;
        let a = &own.angle_deg;
        Self {
            file: cpf.thermal_file_name(),
            run: (&own.run).into(),
            channel: cpf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: RunValues::Lin {
                sigma: own.sigma_nt_per_ent(),
                xi_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
                b_or_ent: own.offset.b_or_ent,
                std: [Some(own.std.sigma), Some(own.std.xi_deg), Some(own.std.b_or_ent)],
                freedom: own.quality.raw_std_ent.is_none().then_some(own.quality.degrees_of_freedom),
                common: own.of_facility.as_ref().map(LinearTypeB::changes),
                rotation_deg: [a.lambda_x, a.mu_y, a.nu_z],
                rotation_std_deg: own.std.lambda_mu_nu_deg,
                rho: Some(own.matrix.rho),
                r_nom: Some(Box::new(own.matrix.r_nom)),
                scope: Box::new(LinearScope {
                    valid_field_nt: Some(LinearScope::along_sensor_axes(&own.valid.field_coil_nt, &own.matrix.r_nom)),
                    linearisation: cpf.linearisation.clone(),
                    known_effects: cpf.model.iter().map(|m| m.file.clone()).collect(),
                    thermistor_lag: None,
                }),
            },
            reference: own.stated_reference(),
            notes: qualifying(&cpf.told, &own.run.id),
            copy_of: None,
        }
    }
}

impl From<&Opf> for CalibratedRun {
    fn from(opf: &Opf) -> Self {
        Self {
            file: opf.file_name(),
            run: (&opf.found.run).into(),
            channel: opf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: RunValues::Offset {
                offset_ent: opf.values.offset_ent,
                std: Some(opf.values.offset_std_ent),
                std_b: opf.found.of_facility.as_ref().map(|b| b.std_b.offset_ent),
                degc: opf.values.offset_degc,
                residual_ent: opf.values.residual_ent,
                residual_std: opf.values.residual_std_ent,
                seen_along: opf.found.method.normal_axis.to_vec(),
            },
            reference: None,
            notes: qualifying(&opf.told, &opf.found.run.id),
            copy_of: None,
        }
    }
}

impl From<&Fpf> for CalibratedRun {
    fn from(fpf: &Fpf) -> Self {
        Self {
            file: fpf.file_name(),
            run: (&fpf.found.run).into(),
            channel: fpf.conditions.as_ref().map(|c| c.sensor_channel.clone()),
            values: RunValues::Freq {
                model_hz: Some(fpf.values.f_3db_model_hz),
                model_std_hz: Some(fpf.values.f_3db_model_std_hz),
                model_degc: fpf.values.f_3db_model_degc,
                igep_hz: Some(fpf.values.f_3db_igep_hz),
                f_s_hz: fpf.values.mean_f_s_hz,
                f_s_std_hz: fpf.values.mean_f_s_std_hz,
            },
            reference: None,
            notes: qualifying(&fpf.told, &fpf.found.run.id),
            copy_of: None,
        }
    }
}
