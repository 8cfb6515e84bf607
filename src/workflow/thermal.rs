//! Analyses across temperatures as files, figures and text.

mod options;

pub use options::ThermalOptions;

use super::all::{copies, told_of_copies};
use super::centre::Member;
use super::{CentreMade, Desk, Failure, Measured, Outcome, PairFiles, draw, each};
use crate::data::across::{CalibratedRun, LinearScope, RunRotations, RunValues};
use crate::data::error::Finding;
use crate::data::exclusion::{ExcludedPart, Exclusion};
use crate::data::note::{Note, NoteKind, Told};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::reference::StatedReference;
use crate::data::result::Covariance;
use crate::data::run::Location;
use crate::files::ledger::Origin;
use crate::files::parameter::{
    Body, CommonCoefficients, JointPart, NO_CHANNEL, NoisePart, Taf, ThermalConvention, ThermalHead, Tof, Tpf, read, read_point,
};
use crate::files::source::hex;
use crate::measure::centre::together;
use crate::measure::joint::{JointFit, QUANTITIES};
use crate::measure::lin::Lin;
use crate::measure::thermal::{
    Corner, Kind, LinAcross, OfKind, QuantityFit, RunGroup, RunsUsed, SamplingAcross, Thermal, ThermalError, groups, thermal,
};
use crate::model::campaign::ThermalEntry;
use crate::model::sensor_polynomials::SensorPolynomials;
use crate::plot;
use crate::show::{self, Drawn};
use nalgebra::DMatrix;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, HashMap};
use std::path::{Path, PathBuf};

/// What analyses across temperatures rest on: results of single runs, with the inputs of each.
#[derive(Default)]
pub struct ThermalInput {
    points: Vec<CalibratedRun>,
    /// By the names of the parameter files.
    inputs: HashMap<String, Vec<Input>>,
}

impl ThermalInput {
    /// Takes the parameter file of a run; notes on it go to `findings`. Where there is an earlier one of the same run, that is used and its
    /// name returned.
    ///
    /// # Errors
    /// What is wrong with the file.
    pub fn file(&mut self, path: &Path, findings: &mut Vec<Finding>) -> Result<Option<String>, Finding> {
        let (point, digested) = read_point(path, findings)?;
        if let Some(twin) = self.points.iter().find(|p| p.run.id == point.run.id && same_kind(p, &point)) {
            return Ok(Some(twin.file.clone()));
        }
        self.inputs.insert(point.file.clone(), vec![digested.input(point.file.clone())]);
        self.points.push(point);
        Ok(None)
    }

    /// Takes what runs gave.
    pub fn measured(&mut self, measured: &[Measured]) {
        let copies = copies(measured);
        for one in measured {
            let Some(point) = one.point() else { continue };
            self.inputs.extend(one.provenance().map(|p| (point.file.clone(), p.input.clone())));
            self.points.push(told_of_copies(point, &copies));
        }
    }

    /// Leaves out the files of a run that is excluded; their names are returned.
    ///
    /// # Errors
    /// Only a part of the run is excluded, which its file holds already.
    pub fn leave_out(&mut self, exclusion: &Exclusion) -> Result<Vec<String>, Finding> {
        let is_of = |p: &&CalibratedRun| p.run.id == exclusion.run;
        let files: Vec<String> = self.points.iter().filter(is_of).map(|p| p.file.clone()).collect();
        if let (Some(file), true) = (files.first(), exclusion.part != ExcludedPart::Run) {
            let rule = format!("is a part of a run whose result {file} holds already");
            let remedy = "exclude the whole run, or name the runs in place of their files";
            return Err(Finding::error(&format!("--exclude {exclusion}"), rule, remedy));
        }
        self.points.retain(|p| p.run.id != exclusion.run);
        Ok(files)
    }

    /// Leaves out the run at the centre, which is none of those beside it, also where its file lies in their folder.
    pub fn leave_out_centre(&mut self, pair: &PairFiles) {
        let centre = pair.pair().centre;
        self.points.retain(|p| !(same_kind(p, centre) && p.run.id == centre.run.id));
    }

    /// The results of single runs.
    #[must_use]
    pub fn points(&self) -> &[CalibratedRun] {
        &self.points
    }

    /// The inputs of some points, each once, in the order of the points.
    fn inputs(&self, used: &[&CalibratedRun]) -> Vec<Input> {
        let mut list: Vec<Input> = Vec::new();
        for input in used.iter().filter_map(|p| self.inputs.get(&p.file)).flatten() {
            if !list.contains(input) {
                list.push(input.clone());
            }
        }
        list
    }

    /// All thermal analyses that the runs allow, each published or with the reason why not.
    pub fn groups(
        &self,
        lins: &[&Lin],
        entries: &[ThermalEntry],
        options: &ThermalOptions,
        desk: &Desk,
    ) -> Vec<Result<ThermalShown, NoThermal>> {
        let groups = groups(&self.points, entries, &options.orders);
        let tasks: Vec<(&RunGroup, Kind)> =
            groups.iter().flat_map(|g| Kind::ALL.into_iter().filter(|k| g.has(*k)).map(move |k| (g, k))).collect();
        each(tasks, |(group, kind)| {
            let result = thermal(group, kind, lins, options.joint).map_err(|e| {
                let finding = Finding::error(&group.name(), e.to_string(), e.remedy());
                match e {
                    ThermalError::TooFew { .. } if self.goes_with_a_cycle(group) => NoThermal::OfPair,
                    ThermalError::TooFew { .. } if !group.is_listed => NoThermal::OneTemperature(finding),
                    _ => NoThermal::Refused(finding),
                }
            })?;
            let file = ThermalFile::of(&result);
            let used: Vec<&CalibratedRun> = group.points.iter().filter(|p| result.runs.files.contains(&p.file)).collect();
            let provenance = Provenance::new(options.recipe(desk), self.inputs(&used));
            let (written, figures) = publish(&result, &file, &provenance, desk).map_err(NoThermal::Refused)?;
            Ok(ThermalShown { thermal: result, file, provenance, written, figures })
        })
    }

    /// Whether the runs of a group were made at the centre, and linearity runs of the same sensor and mode beside it.
    fn goes_with_a_cycle(&self, group: &RunGroup) -> bool {
        let beside = |p: &CalibratedRun| {
            matches!(p.values, RunValues::Lin { .. })
                && p.run.location == Location::OffCentre
                && (&p.run.sensor, &p.run.mode) == (&group.sensor, &group.mode)
        };
        group.location.is_centre() && self.points.iter().any(beside)
    }

    /// Polynomials that were measured beside the centre, taken to it with the linearity and offset runs at the centre of the same sensor
    /// and mode; nothing for polynomials without a linearity run there.
    pub fn to_own_centre(
        &self,
        done: &[ThermalShown],
        options: &ThermalOptions,
        desk: &Desk,
    ) -> Vec<Result<CentreMade, Failure>> {
        let polynomials = done.iter().filter_map(|one| match &one.file {
            ThermalFile::Tpf(tpf) if tpf.head.location == Location::OffCentre => Some(tpf),
            _ => None,
        });
        let made = polynomials.filter_map(|tpf| {
            let pair = self.own_pair(tpf)?;
            let used: Vec<&CalibratedRun> = self.points.iter().filter(|p| tpf.head.used.contains(&p.file)).collect();
            Some(pair.publish(tpf, options, self.inputs(&used), desk).map_err(Failure::Refused))
        });
        made.collect()
    }

    /// Says of polynomials measured beside the centre which stay there, for want of a linearity run at the centre.
    #[must_use]
    pub fn without_centre(&self, done: &[ThermalShown]) -> Vec<Note> {
        let stays = done.iter().filter_map(|one| match &one.file {
            ThermalFile::Tpf(tpf) if tpf.head.location == Location::OffCentre && self.own_pair(tpf).is_none() => Some(tpf),
            _ => None,
        });
        let note = |tpf: &Tpf| {
            let ThermalHead { sensor, mode, .. } = &tpf.head;
            let text = format!(
                "{} holds beside the centre of the coil system only: there is no linearity run of {sensor} {mode} at the centre with a \
                 sensor temperature",
                tpf.file_name()
            );
            Note::new(NoteKind::LeftOut, text).about(tpf.file_name())
        };
        stays.map(|tpf| note(tpf)).collect()
    }

    /// The runs at the centre that go with polynomials measured beside it.
    fn own_pair(&self, tpf: &Tpf) -> Option<PairFiles> {
        let at_centre = |of: fn(&RunValues) -> bool| -> Vec<&CalibratedRun> {
            let own = |p: &&CalibratedRun| (&p.run.sensor, &p.run.mode) == (&tpf.head.sensor, &tpf.head.mode);
            let mut runs: Vec<&CalibratedRun> =
                self.points.iter().filter(|p| p.run.location.is_centre() && of(&p.values)).filter(own).collect();
            runs.sort_by(|a, b| a.run.id.cmp(&b.run.id));
            // What stands in another run as well would count twice.
            let is_counted = |p: &&CalibratedRun| !runs.iter().any(|other| p.copy_of.as_ref() == Some(&other.run.id));
            runs.iter().copied().filter(is_counted).collect()
        };
        let mut notes = Vec::new();
        let mut member = |runs: Vec<&CalibratedRun>, near_degc: Option<f64>| {
            let (point, files, note) = together(&runs, near_degc)?;
            notes.extend(note);
            let used: Vec<&CalibratedRun> = runs.into_iter().filter(|p| files.contains(&p.file)).collect();
            Some(Member { point, inputs: self.inputs(&used), files })
        };
        let centre = member(at_centre(|v| matches!(v, RunValues::Lin { .. })), None)?;
        // An offset of which a component is missing tells no residual field.
        let offsets =
            at_centre(|v| matches!(v, RunValues::Offset { offset_ent, .. } if offset_ent.iter().all(|o| o.is_finite())));
        let offset = member(offsets, centre.point.run.temperature_degc);
        Some(PairFiles::of_campaign(centre, offset, notes))
    }

    /// Polynomials taken to the centre: those of the groups of the pair's sensor and mode, and those of files.
    pub fn to_centre(
        &self,
        pair: &PairFiles,
        files: &[PathBuf],
        done: &[ThermalShown],
        options: &ThermalOptions,
        desk: &Desk,
    ) -> Vec<Result<CentreMade, Failure>> {
        let mut results = Vec::new();
        let fits = |one: &&ThermalShown| match &one.file {
            ThermalFile::Tpf(tpf) => pair.pair().fits(&tpf.head.sensor, &tpf.head.mode),
            _ => false,
        };
        // Polynomials that say that they were measured beside the centre go before those that say nothing.
        let is_beside = |one: &ThermalShown| one.thermal.runs.location == Location::OffCentre;
        let any_beside = done.iter().filter(fits).any(is_beside);
        for one in done.iter().filter(fits).filter(|one| !any_beside || is_beside(one)) {
            if let ThermalFile::Tpf(tpf) = &one.file {
                let used: Vec<&CalibratedRun> = self.points.iter().filter(|p| tpf.head.used.contains(&p.file)).collect();
                results.push(pair.publish(tpf, options, self.inputs(&used), desk).map_err(Failure::Refused));
            }
        }
        let mut unreadable = Vec::new();
        for path in files {
            match read::<Tpf>(path) {
                Ok(file) if pair.pair().fits(&file.body.head.sensor, &file.body.head.mode) => {
                    let made = pair.publish(&file.body, &ThermalOptions::default(), vec![file.input], desk);
                    results.push(made.map_err(Failure::Refused));
                }
                Ok(_) => {}
                Err(finding) => unreadable.push(Err(Failure::Unreadable(vec![finding]))),
            }
        }
        if results.is_empty() {
            let run = &pair.pair().centre.run;
            let rule = format!("no polynomials are of its sensor `{}` and mode `{}`", run.sensor, run.mode);
            let remedy = "name runs, CPF or TPF files of that sensor and mode measured beside the centre";
            results.push(Err(Failure::Refused(Finding::error(&pair.pair().centre.file, rule, remedy))));
        }
        unreadable.into_iter().chain(results).collect()
    }
}

/// Why there is no analysis across temperatures.
#[derive(Clone, Debug)]
pub enum NoThermal {
    /// The runs were made at the centre at one temperature, and belong to a temperature cycle beside it.
    OfPair,
    /// The runs were made at one temperature, and nobody asked for polynomials.
    OneTemperature(Finding),
    /// The runs are refused, or the result cannot be written.
    Refused(Finding),
}

/// Whether two results are of the same analysis.
fn same_kind(a: &CalibratedRun, b: &CalibratedRun) -> bool {
    std::mem::discriminant::<RunValues>(&a.values) == std::mem::discriminant(&b.values)
}

/// A thermal analysis with its file and figures.
pub struct ThermalShown {
    /// The result.
    pub thermal: Thermal,
    /// What its parameter file holds.
    pub file: ThermalFile,
    /// Its origin.
    pub provenance: Provenance,
    /// That file as an input of what rests on it.
    pub written: Input,
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
            provenance: &self.provenance,
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
    provenance: &'a Provenance,
    curves: Vec<CurveView<'a>>,
}

/// A polynomial with the runs it rests on, as `--json` prints it.
#[derive(Serialize)]
pub(super) struct CurveView<'a> {
    name: &'a str,
    component: &'a str,
    unit: &'a str,
    runs: &'a [usize],
    points: Vec<[f64; 3]>,
    factor_95: f64,
    coefficients: &'a [f64],
    band: &'a [[f64; 3]],
    joint: &'a [[f64; 3]],
}

impl<'a> From<&'a QuantityFit> for CurveView<'a> {
    fn from(fit: &'a QuantityFit) -> Self {
        Self {
            name: &fit.found.name,
            component: &fit.component,
            unit: &fit.found.unit,
            runs: &fit.runs,
            points: fit.points(),
            factor_95: fit.found.factor_95,
            coefficients: &fit.polynomial.coefficients,
            band: &fit.band,
            joint: &fit.joint_band,
        }
    }
}

impl ThermalFile {
    pub(super) fn of(result: &Thermal) -> Self {
        let head = head(result);
        let coefficients = |name: &str| coefficients(&result.quantities, name);
        match &result.of_kind {
            OfKind::Lin(lin) => {
                let LinAcross { rotation, model_error, joint, scope, noise } = lin.as_ref();
                ThermalFile::Tpf(Box::new(Tpf {
                    model_error: model_error.clone(),
                    joint: joint.as_ref().map(|joint| joint_part(joint, &result.quantities)),
                    noise: noise.as_ref().map(NoisePart::of).unwrap_or_default(),
                    ..tpf(&result.quantities, head, rotation.clone(), scope.clone(), result.runs.reference)
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
                    f_3db_igep_x: coefficients("f_3db_igep_x"),
                    f_3db_igep_y: coefficients("f_3db_igep_y"),
                    f_3db_igep_z: coefficients("f_3db_igep_z"),
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

    fn text(&self, provenance: &Provenance, desk: &Desk) -> Result<String, Finding> {
        let name = self.file_name();
        match self {
            ThermalFile::Tpf(body) => desk.parameter_text("", &name, body.as_ref(), provenance),
            ThermalFile::Tof(body) => desk.parameter_text("", &name, body.as_ref(), provenance),
            ThermalFile::Taf(body) => desk.parameter_text("", &name, body.as_ref(), provenance),
        }
    }
}

/// Reads the polynomials of `--temperature`.
///
/// # Errors
/// The file holds no such polynomials, or their covariance is not stated.
pub fn temperature(path: Option<&PathBuf>) -> Result<Option<SensorPolynomials>, Finding> {
    let Some(path) = path else { return Ok(None) };
    let file = read::<Tpf>(path)?;
    let polynomials = file.body.polynomials(file.input.with_role(Role::Temperature));
    if let Some(name) = polynomials.without_covariance() {
        let rule =
            format!("states no covariance of {name}, so that the uncertainty of a run could not contain that of its slope");
        return Err(Finding::error(&path.display().to_string(), rule, "take polynomials with covariances"));
    }
    Ok(Some(polynomials))
}

/// The coefficients of a quantity; none if it is not determined.
fn coefficients(quantities: &[QuantityFit], name: &str) -> Vec<f64> {
    quantities.iter().find(|q| q.found.name == name).map_or_else(Vec::new, |q| q.polynomial.coefficients.clone())
}

/// The file of polynomials of a linear calibration, without what only one kind of analysis has.
pub(super) fn tpf(
    quantities: &[QuantityFit],
    head: ThermalHead,
    rotation: RunRotations,
    scope: LinearScope,
    reference: Option<StatedReference>,
) -> Tpf {
    let coefficients = |name: &str| coefficients(quantities, name);
    let mut file = Tpf {
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
        scope,
        together: None,
        together_combined: None,
        rotation,
        reference: None,
        model_error: None,
        joint: None,
        sweep: None,
        noise: Vec::new(),
    };
    file.reference = reference.and_then(|stated| stated.in_frame_of(&file.mean_alignment()).ok());
    file
}

fn head(result: &Thermal) -> ThermalHead {
    let RunsUsed { files, ids, sensor, mode, location, channel, temperature_degc, coil_temperature_degc, .. } =
        result.runs.clone();
    let [covariance_b, covariance_combined] = covariances_with_type_b(&result.quantities);
    ThermalHead {
        used: files,
        channel: channel.unwrap_or_else(|| NO_CHANNEL.to_owned()),
        valid_degc: result.valid_degc,
        sensor,
        mode,
        location,
        temperature_degc,
        coil_temperature_degc,
        convention: ThermalConvention::default(),
        covariance: covariances(&result.quantities),
        covariance_b,
        covariance_combined,
        common: common(&result.quantities),
        quantity: result.quantities.iter().map(|q| q.found.clone()).collect(),
        runs: ids,
        told: Told::of(&result.notes),
    }
}

/// What the facility adds to the covariance of the coefficients of every quantity, and both together; empty where it is not stated.
pub(super) fn covariances_with_type_b(quantities: &[QuantityFit]) -> [BTreeMap<String, Vec<Vec<f64>>>; 2] {
    with_type_b(quantities.iter().map(|q| (q.found.name.as_str(), &q.polynomial.covariance, q.covariance_b())))
}

/// The same of any polynomials: their names, covariances of type A and B.
fn with_type_b<'a>(
    all: impl Iterator<Item = (&'a str, &'a DMatrix<f64>, Option<DMatrix<f64>>)>,
) -> [BTreeMap<String, Vec<Vec<f64>>>; 2] {
    let mut both = [BTreeMap::new(), BTreeMap::new()];
    for (name, own, of_facility) in all.filter_map(|(name, own, b)| Some((name, own, b?))) {
        both[0].insert(name.to_owned(), rows(&of_facility));
        if own.shape() == of_facility.shape() {
            both[1].insert(name.to_owned(), rows(&(own + of_facility)));
        }
    }
    both
}

/// Changes of the coefficients of all quantities by what the runs share, source after source; empty where one of them does not tell.
pub(super) fn common(quantities: &[QuantityFit]) -> Vec<CommonCoefficients> {
    let Some(all) = quantities.iter().map(|q| Some((&q.found.name, q.common.as_ref()?))).collect::<Option<Vec<_>>>() else {
        return Vec::new();
    };
    let mut sources: Vec<CommonCoefficients> = Vec::new();
    for (name, common) in all {
        for (source, change) in common {
            let place = sources.iter().position(|s| s.source == *source).unwrap_or_else(|| {
                sources.push(CommonCoefficients { source: source.clone(), change: BTreeMap::new() });
                sources.len() - 1
            });
            sources[place].change.insert(name.clone(), change.clone());
        }
    }
    sources
}

/// Covariance of the coefficients of every quantity.
pub(super) fn covariances(quantities: &[QuantityFit]) -> BTreeMap<String, Vec<Vec<f64>>> {
    quantities.iter().map(|q| (q.found.name.clone(), rows(&q.polynomial.covariance))).collect()
}

/// A field that is not what was set moves the polynomials of both fits alike: the orders are the same, and so are the runs.
fn joint_part(joint: &JointFit, quantities: &[QuantityFit]) -> JointPart {
    let named = || QUANTITIES.iter().map(|name| (*name).to_owned()).zip(&joint.polynomials);
    let of_facility = |name: &str| quantities.iter().find(|q| q.found.name == name)?.covariance_b();
    let own = QUANTITIES.iter().zip(&joint.polynomials).map(|(name, p)| (*name, &p.covariance, of_facility(name)));
    let [covariance_b, covariance_combined] = with_type_b(own);
    let counts = joint.polynomials.each_ref().map(|p| p.coefficients.len());
    let units = ["nT/enT", "nT/enT", "nT/enT", "deg", "deg", "deg"];
    let parameters: Vec<_> = (0..6).map(|i| (QUANTITIES[i], units[i], counts[i])).collect();
    JointPart {
        together: Some(covariance_together(&parameters, &joint.covariance)),
        covariance_b,
        covariance_combined,
        coefficients: named().map(|(name, p)| (name, p.coefficients.clone())).collect(),
        covariance: named().map(|(name, p)| (name, rows(&p.covariance))).collect(),
        chi_square: joint.chi2,
        degrees_of_freedom: joint.dof,
        widened: joint.inflation_within,
        evaluations: joint.evaluations,
    }
}

/// A covariance of the coefficients of several polynomials, each with its name, its unit and their number.
pub(super) fn covariance_together(polynomials: &[(&str, &str, usize)], covariance: &DMatrix<f64>) -> Covariance {
    let all = || polynomials.iter().flat_map(|(name, unit, count)| (0..*count).map(move |k| (*name, *unit, k)));
    Covariance {
        parameters: all().map(|(name, _, k)| format!("{name}.{k}")).collect(),
        units: all().map(|(_, unit, k)| if k == 0 { unit.to_owned() } else { format!("{unit}/degC^{k}") }).collect(),
        matrix: rows(covariance),
    }
}

/// A matrix as its rows.
pub(super) fn rows(matrix: &DMatrix<f64>) -> Vec<Vec<f64>> {
    matrix.row_iter().map(|row| row.iter().copied().collect()).collect()
}

/// Begin of the names of figures and report.
fn stem(kind: Kind) -> &'static str {
    match kind {
        Kind::Lin => "THERMAL",
        Kind::Offset => "THERMAL_OFF",
        Kind::Freq => "THERMAL_AC",
    }
}

/// Writes figures, report and parameter file, the last one last; returns that as an input, and the figures.
fn publish(result: &Thermal, file: &ThermalFile, provenance: &Provenance, desk: &Desk) -> Result<(Input, Vec<Drawn>), Finding> {
    let name = file.file_name();
    let first = result.runs.ids.first().map_or_else(String::new, |id| id.replace('_', "-"));
    let folder = desk.folder("", Origin::of(provenance).using(result.runs.files.clone()).telling(&result.notes))?;
    folder.check(&name)?;
    let begin = stem(result.kind());
    let drawn = if desk.plots {
        draw(&folder, &plot::thermal::figures(result), |stem| format!("{begin}_{stem}__{first}.png"))?
    } else {
        Vec::new()
    };
    let outcome = Outcome {
        name: &name,
        parameters: file.text(provenance, desk)?,
        report: format!("REPORT_{begin}__{first}.md"),
        title: {
            let RunsUsed { sensor, mode, location, .. } = &result.runs;
            format!("{}, {sensor} {mode}{}", show::thermal::title(result.kind()), location.suffix())
        },
        notes: &result.notes,
        sections: show::thermal::sections(result, &name),
        provenance,
    };
    let (size_bytes, sha256) = (outcome.parameters.len() as u64, hex(&Sha256::digest(outcome.parameters.as_bytes())));
    outcome.write(&folder, &drawn)?;
    Ok((Input { path: name, size_bytes, sha256, ..Input::default() }, drawn))
}
