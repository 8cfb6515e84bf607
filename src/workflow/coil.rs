//! The facility's own calibration as files, figures and text.

use super::{Desk, Failure, Job, Outcome, Shown, draw, make, read};
use crate::data::calibration::LinearCalibration;
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind, Told};
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::{Reading, Recipe};
use crate::data::run::Run;
use crate::files::campaign::Campaign;
use crate::files::facility;
use crate::files::ledger::Origin;
use crate::files::parameter::{self, Body, CoilConvention, CoilResidual, CoilScalar, CoilTilt, Cpf};
use crate::files::{ccr, moduli, orientations};
use crate::measure::coil::{CoilError, Residual, Scalar, Tilt, residual, scalar, tilt};
use crate::measure::lin;
use crate::model::campaign::Instructions;
use crate::model::facility::{Facility, FacilityParameters};
use crate::model::position::{OrientedRun, Position, PositionError};
use crate::model::sensor::split;
use crate::plot;
use crate::show::{self, Drawn};
use nalgebra::Matrix3;
use serde::Serialize;
use std::path::{Path, PathBuf};

/// A calibration of the facility for people and programs.
pub trait CoilResult: Sized {
    /// The parameter file.
    type Parameters: Body;
    /// Figures and text.
    const SHOWN: Shown<Self>;
    /// What goes into the parameter file.
    fn parameters(&self) -> Self::Parameters;
    /// The result as `--json` prints it.
    fn view(&self) -> impl Serialize + '_ {
        ParametersView { parameters: self.parameters() }
    }
    /// What a person should know.
    fn notes(&self) -> &[Note];
    /// Title of the report.
    fn title(&self) -> String;
}

/// A result that is its parameter file, as `--json` prints it.
#[derive(Serialize)]
struct ParametersView<P> {
    parameters: P,
}

/// A scalar calibration as `--json` prints it.
#[derive(Serialize)]
struct ScalarView<'a> {
    parameters: CoilScalar,
    rows: &'a [crate::measure::coil::scalar::RowResidual],
}

impl CoilResult for Scalar {
    type Parameters = CoilScalar;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::coil::scalar, sections: show::coil::scalar, summary: show::coil::scalar_summary };

    fn parameters(&self) -> CoilScalar {
        CoilScalar { convention: CoilConvention::scalar(), found: self.found.clone(), told: Told::of(&self.notes) }
    }
    fn view(&self) -> impl Serialize + '_ {
        ScalarView { parameters: self.parameters(), rows: &self.rows }
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn title(&self) -> String {
        "Scalar calibration of the coil system".to_owned()
    }
}

impl CoilResult for Residual {
    type Parameters = CoilResidual;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::coil::residual, sections: show::coil::residual, summary: show::coil::residual_summary };

    fn parameters(&self) -> CoilResidual {
        CoilResidual { convention: CoilConvention::residual(), found: self.found.clone(), told: Told::of(&self.notes) }
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn title(&self) -> String {
        "Residual field of the coil system".to_owned()
    }
}

impl CoilResult for Tilt {
    type Parameters = CoilTilt;
    const SHOWN: Shown<Self> = Shown { figures: plot::coil::tilt, sections: show::coil::tilt, summary: show::coil::tilt_summary };

    fn parameters(&self) -> CoilTilt {
        CoilTilt { convention: CoilConvention::tilt(), found: self.found.clone(), told: Told::of(&self.notes) }
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn title(&self) -> String {
        format!("Sensor {} and coil system from several orientations", show::or_not_stated(&self.found.sensor))
    }
}

/// A calibration of the facility with its origin.
pub struct CoilMade<R> {
    /// The result.
    pub result: R,
    /// Its origin.
    pub provenance: Provenance,
}

/// A run that was read without its vectors, with its campaign.
pub struct CoilRun<'a> {
    /// The run.
    pub run: Run,
    /// Its campaign.
    pub campaign: &'a Campaign,
}

/// Reads runs; those that cannot be read go to `failures`. The list is in time order.
pub fn coil_runs<'a>(jobs: &[Job<'a>], desk: &Desk, failures: &mut Vec<(String, Failure)>) -> Vec<CoilRun<'a>> {
    let mut list = Vec::new();
    for job in jobs.iter().filter(|job| job.excluded.is_none()) {
        match read(job, desk, false, ()) {
            Ok((run, ())) => list.push(CoilRun { run, campaign: job.campaign }),
            Err(failure) => failures.push((job.recorded.clone(), failure)),
        }
    }
    list.sort_by(|a, b| a.run.header.start.cmp(&b.run.header.start));
    list
}

fn inputs(runs: &[CoilRun]) -> Vec<Input> {
    let mut list: Vec<Input> = runs.iter().map(|r| Input::from(&r.run)).collect();
    for input in runs.iter().filter_map(|r| r.campaign.input.clone()) {
        if !list.contains(&input) {
            list.push(input);
        }
    }
    list
}

fn refuse(runs: &[CoilRun], error: &CoilError) -> Finding {
    let names: Vec<&str> = runs.iter().map(|r| r.run.input.path.as_str()).collect();
    Finding::error(&names.join(", "), error.to_string(), error.remedy())
}

/// The scalar calibration of some runs in time order; `None` without any. Runs with too few rows for it, such as those of a residual field, are passed over where others
/// have enough.
///
/// # Errors
/// The runs do not determine the facility.
pub fn scalar_of(mut runs: Vec<CoilRun>, options: &scalar::Options, desk: &Desk) -> Result<Option<CoilMade<Scalar>>, Finding> {
    const LEAST_ROWS: usize = 10;
    if runs.is_empty() {
        return Ok(None);
    }
    let mut notes: Vec<Note> = Vec::new();
    if runs.iter().any(|r| r.run.scalar.len() >= LEAST_ROWS) {
        runs.retain(|r| {
            let enough = r.run.scalar.len() >= LEAST_ROWS;
            if !enough {
                let id = &r.run.header.run;
                let text = format!("run {id} has {} @SCALAR rows and was not used", r.run.scalar.len());
                notes.push(Note::new(NoteKind::LeftOut, text).about(id.as_str()));
            }
            enough
        });
    }
    let given: Vec<(&Run, &Instructions)> = runs.iter().map(|r| (&r.run, &r.campaign.file.instructions)).collect();
    let mut result = scalar(&given, options).map_err(|e| refuse(&runs, &e))?;
    result.notes.extend(notes);
    let provenance = Provenance::new(Recipe::new("coil scalar", options).reading(desk.allowed()), inputs(&runs));
    Ok(Some(CoilMade { result, provenance }))
}

/// The residual field from scalar runs in time order; `None` without any.
///
/// # Errors
/// No run has settings of plus and minus F.
pub fn residual_of(mut runs: Vec<CoilRun>, desk: &Desk) -> Result<Option<CoilMade<Residual>>, Finding> {
    if runs.is_empty() {
        return Ok(None);
    }
    let given: Vec<&Run> = runs.iter().map(|r| &r.run).collect();
    let result = residual(&given).map_err(|e| refuse(&runs, &e))?;
    runs.retain(|r| result.found.used.contains(&r.run.header.run));
    Ok(Some(CoilMade {
        result,
        provenance: Provenance::new(Recipe::plain("coil residual").reading(desk.allowed()), inputs(&runs)),
    }))
}

/// File name without and with its end.
fn names(path: &Path) -> (String, String) {
    let text = |part: Option<&std::ffi::OsStr>| part.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    (text(path.file_stem()), text(path.file_name()))
}

/// The residual field from a table of moduli; its name is the run id. Warnings go to `findings`.
///
/// # Errors
/// The table cannot be read, or its name cannot be a run id.
pub fn residual_of_table(path: &Path, findings: &mut Vec<Finding>) -> Result<CoilMade<Residual>, Finding> {
    let (rows, digested) = moduli::read(path, findings)?;
    let (id, name) = names(path);
    let shown = path.display().to_string();
    if !ccr::run_id_is_safe(&id) {
        return Err(Finding::error(&shown, "its name cannot be a run id", "rename it").found(id.as_bytes()));
    }
    let result = residual::of_table(&rows, &id).map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
    let input = digested.input(name);
    Ok(CoilMade { result, provenance: Provenance::new(Recipe::plain("coil residual"), vec![input]) })
}

/// What a tilt calibration rests on.
#[derive(Default)]
pub struct TiltInput {
    results: Vec<OrientedRun>,
    inputs: Vec<Input>,
    /// What was allowed when runs were read.
    reading: Reading,
    /// Facilities that runs and parameter files were made with.
    stated: Vec<Option<FacilityParameters>>,
}

impl TiltInput {
    /// Takes the rows of a table; warnings go to `findings`.
    ///
    /// # Errors
    /// The table cannot be read.
    pub fn table(&mut self, path: &Path, findings: &mut Vec<Finding>) -> Result<(), Finding> {
        let (rows, digested) = orientations::read(path, findings)?;
        self.inputs.push(digested.input(names(path).1));
        self.results.extend(rows);
        Ok(())
    }

    /// Takes a linear calibration.
    ///
    /// # Errors
    /// The file cannot be read, or its position is none.
    pub fn cpf(&mut self, path: &Path) -> Result<(), Finding> {
        let file = parameter::read::<Cpf>(path)?;
        let result = of_calibration(&file.body.calibration)
            .map_err(|e| Finding::error(&path.display().to_string(), e.to_string(), "fit the run again"))?;
        self.inputs.push(file.input);
        self.stated.push(file.body.facility.as_ref().map(|f| f.applied.clone()));
        self.results.push(result);
        Ok(())
    }

    /// Fits linearity runs with the facility and takes the results; what cannot be fitted goes to `failures`.
    pub fn runs(&mut self, jobs: &[Job], options: &lin::Options, desk: &Desk, failures: &mut Vec<(String, Failure)>) {
        self.reading = desk.allowed();
        for job in jobs.iter().filter(|job| job.excluded.is_none()) {
            let made = make(options, job, desk, true).and_then(|made| {
                let result = of_calibration(&made.result.calibration).map_err(|e| {
                    Failure::Refused(Finding::error(&job.recorded, e.to_string(), "correct the position in campaign.toml"))
                })?;
                Ok((result, made.result.facility.map(|f| f.applied), made.provenance.input))
            });
            match made {
                Ok((result, stated, inputs)) => {
                    self.results.push(result);
                    self.stated.push(stated);
                    self.inputs.extend(inputs);
                }
                Err(failure) => failures.push((job.recorded.clone(), failure)),
            }
        }
    }

    /// Tells sensor and facility apart; `used` is the facility that the runs were evaluated with, unless the files say so.
    ///
    /// # Errors
    /// The orientations do not determine anything, or the files were made with different facilities.
    pub fn solve(self, used: Option<&Facility>, options: &tilt::Options) -> Result<CoilMade<Tilt>, Finding> {
        // Files of a campaign stand before its campaign.toml, which is an input of every one of them.
        let is_run = |path: &&str| !path.ends_with("campaign.toml");
        let mut shown: Vec<&str> = self.inputs.iter().map(|i| i.path.as_str()).filter(is_run).collect();
        shown.dedup();
        let shown = shown.join(", ");
        let mut notes: Vec<Note> = Vec::new();
        let stated = self.stated.first().cloned().flatten();
        if self.stated.iter().any(|s| *s != stated) {
            let rule = "the runs were evaluated with different facilities, or in different periods of one";
            return Err(Finding::error(&shown, rule, "fit the runs of one period with the same --facility"));
        }
        let before = match (used, stated) {
            (Some(file), Some(stated)) if file.periods.iter().all(|p| p.part != stated) => {
                let rule = format!("the parameter files were made with another facility than {}", file.input.path);
                return Err(Finding::error(&shown, rule, "leave --facility out, or name the file they were made with"));
            }
            (Some(file), None) if !self.stated.is_empty() => {
                let rule = format!("the parameter files were made without a facility, not with {}", file.input.path);
                return Err(Finding::error(&shown, rule, "leave --facility out, or fit the runs with it first"));
            }
            (_, Some(stated)) => stated,
            (Some(file), None) => match file.only_part() {
                Some(part) => part.clone(),
                None => {
                    let rule = format!("{} holds {}", file.input.path, file.periods_in_words());
                    return Err(Finding::error(
                        &shown,
                        rule,
                        "name a file with the values of one period: the table has no dates",
                    ));
                }
            },
            (None, None) => {
                let text = "no --facility: the runs were taken as evaluated with ideal coils";
                notes.push(Note::new(NoteKind::Facility, text));
                FacilityParameters::constant([1.0; 3], [0.0; 3], [90.0; 3])
            }
        };
        let covariance =
            used.and_then(|file| file.periods.iter().find(|p| p.part == before)).and_then(|period| period.covariance.as_ref());
        if covariance.is_none() && !self.stated.iter().all(Option::is_none) {
            let text = "what the orientations do not determine is without the uncertainty of the facility that the runs were evaluated with";
            let remedy = "name that facility with --facility, with its covariance";
            notes.push(Note::new(NoteKind::Facility, text).with_remedy(remedy));
        }
        let mut result =
            tilt(&self.results, &before, covariance, options).map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
        result.notes.extend(notes);
        let mut inputs: Vec<Input> = Vec::new();
        for input in self.inputs.into_iter().chain(used.map(|f| f.input.clone())) {
            if !inputs.contains(&input) {
                inputs.push(input);
            }
        }
        let recipe = Recipe::new("coil tilt", options).reading(self.reading);
        Ok(CoilMade { result, provenance: Provenance::new(recipe, inputs) })
    }
}

/// The result of a run in its orientation.
fn of_calibration(calibration: &LinearCalibration) -> Result<OrientedRun, PositionError> {
    let position = Position::from_axes(&calibration.setup.position_axes)?;
    let sigma = calibration.sigma_nt_per_ent();
    let a = &calibration.angle_deg;
    let phi = Matrix3::from_fn(|row, column| calibration.matrix.phi[row][column]);
    Ok(OrientedRun {
        run: calibration.run.id.clone(),
        sensor: calibration.run.sensor.clone(),
        mode: Some(calibration.run.mode.clone()),
        position,
        rho: split(&phi, &position.r_nom()).ok().map(|split| split.rho),
        sigma,
        offset_nt: std::array::from_fn(|i| sigma[i] * calibration.offset.b_or_ent[i]),
        xi_deg: [a.xi_xy, a.xi_xz, a.xi_yz],
        field_nt: None,
    })
}

/// Reads the facility of `--facility`; keys that are not known go to `findings` as warnings.
///
/// # Errors
/// The file is no facility.
pub fn facility(path: Option<&PathBuf>, findings: &mut Vec<Finding>) -> Result<Option<Facility>, Finding> {
    path.map(|path| facility::read(path, findings)).transpose()
}

/// Writes figures, report and parameter file, the last one last; returns the name of the parameter file and the figures.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish_coil<R: CoilResult>(made: &CoilMade<R>, desk: &Desk) -> Result<(String, Vec<Drawn>), Finding> {
    let result = &made.result;
    let parameters = result.parameters();
    let name = parameters.file_name();
    let stem = name.trim_end_matches(".toml").to_owned();
    let (begin, first) = stem.split_once("__").unwrap_or((&stem, ""));
    let folder = desk.folder("", Origin::of(&made.provenance).telling(result.notes()))?;
    folder.check(&name)?;
    let drawn = if desk.plots {
        draw(&folder, &(R::SHOWN.figures)(result), |figure| format!("{begin}_{figure}__{first}.png"))?
    } else {
        Vec::new()
    };
    let outcome = Outcome {
        name: &name,
        parameters: desk.parameter_text("", &name, &parameters, &made.provenance)?,
        report: format!("REPORT_{stem}.md"),
        title: result.title(),
        notes: result.notes(),
        sections: (R::SHOWN.sections)(result, &name),
        provenance: &made.provenance,
    };
    outcome.write(&folder, &drawn)?;
    Ok((name, drawn))
}
