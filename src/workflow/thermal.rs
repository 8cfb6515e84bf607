//! Analyses across temperatures as files, figures and text.

use super::{Desk, Outcome, draw, parameter_text};
use crate::data::across::{CalibratedRun, RunRotations};
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::provenance::{Input, Provenance};
use crate::files::output::Folder;
use crate::files::parameter::{Body, JointPart, QuantityPart, Taf, ThermalConvention, ThermalHead, Tof, Tpf};
use crate::measure::joint::{JointFit, QUANTITIES};
use crate::measure::lin::Lin;
use crate::measure::thermal::{
    Corner, Kind, LinAcross, OfKind, QuantityFit, RunGroup, RunsUsed, SamplingAcross, Thermal, ThermalError, groups, thermal,
};
use crate::model::campaign::ThermalEntry;
use crate::model::facility::Facility;
use crate::plot;
use crate::record::known::Known;
use crate::show::{self, Drawn};
use nalgebra::DMatrix;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// How thermal analyses are made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ThermalOptions {
    /// Order per quantity or family, in place of the choice.
    pub orders: Vec<(String, usize)>,
    /// Fit the plateaus of all runs at once as well.
    pub joint: bool,
    /// The facility that turns the settings of the runs into fields.
    pub facility: Option<Facility>,
    /// Known effects, which are taken off the readings of the runs.
    pub model: Option<Known>,
}

impl ThermalOptions {
    /// The orders as on the command line, each with a space before it.
    #[must_use]
    pub fn recorded_orders(&self) -> String {
        self.orders.iter().map(|(name, order)| format!(" --order {name}={order}")).collect()
    }

    /// All options as on the command line, each with a space before it.
    #[must_use]
    pub fn recorded(&self) -> String {
        let mut text = self.recorded_orders();
        if self.joint {
            text.push_str(" --joint");
        }
        if let Some(facility) = &self.facility {
            text.push_str(&facility.recorded());
        }
        if let Some(model) = &self.model {
            text.push_str(&model.recorded());
        }
        text
    }
}

/// A thermal analysis with its file and figures.
pub struct ThermalShown {
    /// The result.
    pub thermal: Thermal,
    /// What its parameter file holds.
    pub file: ThermalFile,
    /// Its figures.
    pub figures: Vec<Drawn>,
}

impl ThermalShown {
    /// The analysis as `--json` prints it.
    #[must_use]
    pub fn view(&self) -> impl Serialize + '_ {
        ThermalView {
            kind: self.thermal.kind(),
            file: &self.file,
            curves: self.thermal.quantities.iter().map(CurveView::from).collect(),
        }
    }
}

/// The parameter file of a thermal analysis.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub enum ThermalFile {
    /// Of linear calibrations.
    Tpf(Box<Tpf>),
    /// Of offset measurements.
    Tof(Box<Tof>),
    /// Of frequency measurements.
    Taf(Box<Taf>),
}

#[derive(Serialize)]
struct ThermalView<'a> {
    kind: Kind,
    file: &'a ThermalFile,
    curves: Vec<CurveView<'a>>,
}

/// A polynomial with the runs it rests on, as `--json` prints it.
#[derive(Serialize)]
pub(super) struct CurveView<'a> {
    name: &'a str,
    component: &'a str,
    unit: &'static str,
    runs: &'a [usize],
    points: &'a [[f64; 3]],
    factor_95: f64,
    coefficients: &'a [f64],
    band: &'a [[f64; 3]],
    joint: &'a [[f64; 3]],
}

impl<'a> From<&'a QuantityFit> for CurveView<'a> {
    fn from(fit: &'a QuantityFit) -> Self {
        Self {
            name: &fit.name,
            component: &fit.component,
            unit: fit.unit,
            runs: &fit.runs,
            points: &fit.points,
            factor_95: fit.factor_95,
            coefficients: &fit.polynomial.coefficients,
            band: &fit.band,
            joint: &fit.joint_band,
        }
    }
}

impl ThermalFile {
    fn of(result: &Thermal) -> Self {
        let head = head(result);
        let coefficients = |name: &str| coefficients(&result.quantities, name);
        match &result.of_kind {
            OfKind::Lin(lin) => {
                let LinAcross { rotation, model_error, joint } = lin.as_ref();
                ThermalFile::Tpf(Box::new(Tpf {
                    model_error: model_error.clone(),
                    joint: joint.as_ref().map(joint_part),
                    ..tpf(&result.quantities, head, rotation.clone())
                }))
            }
            OfKind::Offset(residual_field) => ThermalFile::Tof(Box::new(Tof {
                b_off_x: coefficients("b_off_x"),
                b_off_y: coefficients("b_off_y"),
                b_off_z: coefficients("b_off_z"),
                residual_field: residual_field.clone(),
                head,
            })),
            OfKind::Freq(sampling) => {
                let [mean_sample_rate_hz, mean_std_sample_rate_hz] = sampling.means_hz();
                let SamplingAcross { corner, f_s_hz, f_s_std_hz } = sampling.clone();
                ThermalFile::Taf(Box::new(Taf {
                    f_3db_x: coefficients("f_3db_x"),
                    f_3db_y: coefficients("f_3db_y"),
                    f_3db_z: coefficients("f_3db_z"),
                    mean_sample_rate_hz,
                    mean_std_sample_rate_hz,
                    corner: match corner {
                        Corner::Model => "model".to_owned(),
                        Corner::Interpolated => "igep".to_owned(),
                    },
                    f_s_hz,
                    f_s_std_hz,
                    head,
                }))
            }
        }
    }

    /// Its name.
    #[must_use]
    pub fn file_name(&self) -> String {
        match self {
            ThermalFile::Tpf(file) => file.file_name(),
            ThermalFile::Tof(file) => file.file_name(),
            ThermalFile::Taf(file) => file.file_name(),
        }
    }

    fn text(&self, provenance: &Provenance) -> Result<String, Finding> {
        let name = self.file_name();
        match self {
            ThermalFile::Tpf(body) => parameter_text(&name, body.as_ref(), provenance),
            ThermalFile::Tof(body) => parameter_text(&name, body.as_ref(), provenance),
            ThermalFile::Taf(body) => parameter_text(&name, body.as_ref(), provenance),
        }
    }
}

/// The coefficients of a quantity; none if it is not determined.
fn coefficients(quantities: &[QuantityFit], name: &str) -> Vec<f64> {
    quantities.iter().find(|q| q.name == name).map_or_else(Vec::new, |q| q.polynomial.coefficients.clone())
}

/// The file of polynomials of a linear calibration, without what only one kind of analysis has.
pub(super) fn tpf(quantities: &[QuantityFit], head: ThermalHead, rotation: RunRotations) -> Tpf {
    let coefficients = |name: &str| coefficients(quantities, name);
    Tpf {
        sigma_x: coefficients("sigma_x"),
        sigma_y: coefficients("sigma_y"),
        sigma_z: coefficients("sigma_z"),
        xi_xy: coefficients("xi_xy"),
        xi_xz: coefficients("xi_xz"),
        xi_yz: coefficients("xi_yz"),
        b_or_x: coefficients("b_or_x"),
        b_or_y: coefficients("b_or_y"),
        b_or_z: coefficients("b_or_z"),
        head,
        rotation,
        model_error: None,
        joint: None,
        sweep: None,
    }
}

fn head(result: &Thermal) -> ThermalHead {
    let RunsUsed { files, ids, sensor, mode, channel, temperature_degc, coil_temperature_degc } = result.runs.clone();
    ThermalHead {
        used: files,
        channel: channel.unwrap_or_else(|| "not stated".to_owned()),
        valid_degc: result.valid_degc,
        sensor,
        mode,
        temperature_degc,
        coil_temperature_degc,
        convention: ThermalConvention::default(),
        covariance: covariances(&result.quantities),
        quantity: result.quantities.iter().map(|q| quantity_part(q, q.runs.iter().map(|i| ids[*i].clone()).collect())).collect(),
        runs: ids,
        warnings: result.notes.iter().map(Note::to_string).collect(),
    }
}

/// Covariance of the coefficients of every quantity.
pub(super) fn covariances(quantities: &[QuantityFit]) -> BTreeMap<String, Vec<Vec<f64>>> {
    quantities.iter().map(|q| (q.name.clone(), rows(&q.polynomial.covariance))).collect()
}

/// How one polynomial was found, for the file; `runs` are the ids of the runs that determine it.
pub(super) fn quantity_part(fit: &QuantityFit, runs: Vec<String>) -> QuantityPart {
    QuantityPart {
        name: fit.name.clone(),
        unit: fit.unit.to_owned(),
        runs,
        valid_degc: fit.polynomial.valid_degc,
        degrees_of_freedom: fit.degrees_of_freedom,
        factor_95: fit.factor_95,
        order: fit.polynomial.order(),
        order_by: fit.order_by.to_string(),
        aicc: fit.aicc.clone(),
        leave_one_out: fit.leave_one_out.clone(),
        value: fit.points.iter().map(|[_, value, _]| *value).collect(),
        std: if fit.std_known { fit.points.iter().map(|[.., std]| *std).collect() } else { Vec::new() },
        residual: fit.residual.clone(),
        widened: fit.widened,
        min_error: fit.error_range[0],
        max_error: fit.error_range[1],
    }
}

fn joint_part(joint: &JointFit) -> JointPart {
    let named = || QUANTITIES.iter().map(|name| (*name).to_owned()).zip(&joint.polynomials);
    JointPart {
        coefficients: named().map(|(name, p)| (name, p.coefficients.clone())).collect(),
        covariance: named().map(|(name, p)| (name, rows(&p.covariance))).collect(),
        chi_square: joint.chi2,
        degrees_of_freedom: joint.dof,
        widened: joint.inflation_within,
        evaluations: joint.evaluations,
    }
}

/// A matrix as its rows.
pub(super) fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// All thermal analyses that a list of runs allows, each published or with the reason why not. `inputs` gives the inputs of the
/// points of a group.
pub fn thermals(
    points: &[CalibratedRun],
    lins: &[&Lin],
    entries: &[ThermalEntry],
    options: &ThermalOptions,
    desk: &Desk,
    inputs: impl Fn(&[&CalibratedRun]) -> Vec<Input> + Sync,
) -> Vec<Result<ThermalShown, Finding>> {
    let groups = groups(points, entries, &options.orders);
    let tasks: Vec<(&RunGroup, Kind)> =
        groups.iter().flat_map(|g| Kind::ALL.into_iter().filter(|k| g.has(*k)).map(move |k| (g, k))).collect();
    tasks
        .par_iter()
        .map(|(group, kind)| {
            let result = thermal(group, *kind, lins, options.joint).map_err(|e: ThermalError| {
                Finding::error(&format!("{} {}", group.sensor, group.mode), e.to_string(), e.remedy())
            })?;
            let file = ThermalFile::of(&result);
            let used: Vec<&CalibratedRun> = group.points.iter().filter(|p| result.runs.files.contains(&p.file)).collect();
            let provenance = Provenance::new(format!("calfit thermal{}", options.recorded()), inputs(&used));
            let figures = publish(&result, &file, &provenance, desk)?;
            Ok(ThermalShown { thermal: result, file, figures })
        })
        .collect()
}

/// Begin of the names of figures and report.
fn stem(kind: Kind) -> &'static str {
    match kind {
        Kind::Lin => "THERMAL",
        Kind::Offset => "THERMAL_OFF",
        Kind::Freq => "THERMAL_AC",
    }
}

/// Writes figures, report and parameter file, the last one last.
fn publish(result: &Thermal, file: &ThermalFile, provenance: &Provenance, desk: &Desk) -> Result<Vec<Drawn>, Finding> {
    let name = file.file_name();
    let first = result.runs.ids.first().map_or_else(String::new, |id| id.replace('_', "-"));
    let folder = Folder::open(&desk.out, desk.force)?;
    folder.check(&name)?;
    let begin = stem(result.kind());
    let drawn = if desk.plots {
        draw(&folder, &plot::thermal::figures(result), |stem| format!("{begin}_{stem}__{first}.png"))?
    } else {
        Vec::new()
    };
    let outcome = Outcome {
        name: &name,
        parameters: file.text(provenance)?,
        report: format!("REPORT_{begin}__{first}.md"),
        title: format!("{}, {} {}", show::thermal::title(result.kind()), result.runs.sensor, result.runs.mode),
        notes: &result.notes,
        sections: show::thermal::sections(result, &name),
        provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok(drawn)
}
