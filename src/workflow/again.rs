//! A result made once more from its recipe: what `calfit verify` compares a parameter file with.

use super::coil::{TiltInput, coil_runs, publish_coil, residual_of, residual_of_table, scalar_of};
use super::diagnose::{Across, DiagnosedWith, diagnose_run, diagnose_table, known, publish_diagnosis};
use super::linearise::{First, by_sensor_and_mode, linearisation, linearise_group};
use super::settle::{refer, settle};
use super::thermal::{ThermalInput, temperature};
use super::thermistor::{publish_thermistor, thermistor_of};
use super::{
    CoilMade, CoilResult, Desk, Failure, Job, NoThermal, PairFiles, PerRun, RUN_KINDS, RunResult, ThermalOptions, facility, jobs,
    make, of_table, publish,
};
use crate::data::calibration::Sensitivities;
use crate::data::error::Finding;
use crate::data::provenance::{Input, Role};
use crate::data::recipe::{Recipe, RecipeError};
use crate::data::run::Kind;
use crate::files::campaign::Campaign;
use crate::files::ccr;
use crate::files::import::Format;
use crate::files::parameter::{self, Body, Cpf, Tpf, is_named};
use crate::measure::{freq, lin, sweep, thermistor};
use crate::model::facility::Facility;
use crate::model::linearisation::Linearisation;
use crate::model::sensor_polynomials::SensorPolynomials;
use crate::record::known::Known;
use std::path::{Path, PathBuf};
use thiserror::Error;

/// Why a result cannot be made again.
#[derive(Debug, Error)]
pub enum AgainError {
    /// The recipe is not one of this version.
    #[error(transparent)]
    Recipe(#[from] RecipeError),
    /// Another kind of result.
    #[error("the recorded analysis `{0}` makes no parameter file that can be made again")]
    NoParameters(String),
    /// The analysis refuses the inputs, or they cannot be read.
    #[error("fitting again failed: {0}")]
    Failed(Box<Finding>),
}

impl From<Finding> for AgainError {
    fn from(finding: Finding) -> Self {
        Self::Failed(Box::new(finding))
    }
}

impl From<Failure> for AgainError {
    fn from(failure: Failure) -> Self {
        let first = failure.errors().next().cloned();
        first
            .unwrap_or_else(|| Finding::error("the inputs", "cannot be analysed", "run the recorded command on them to see why"))
            .into()
    }
}

/// The option of a diagnosis that makes a model file.
pub(super) const WRITE_MODEL: &str = "write_model";

/// The files that a recipe is followed with.
#[derive(Clone, Debug, Default)]
pub struct Ingredients {
    /// What is analysed, in the recorded order.
    pub data: Vec<PathBuf>,
    /// What else is needed, by what it is for.
    pub files: Vec<(Role, PathBuf)>,
}

impl Ingredients {
    /// The files of recorded inputs, each with the place where it was found.
    pub fn of(found: impl IntoIterator<Item = (Input, PathBuf)>) -> Self {
        let mut all = Self::default();
        for (input, path) in found {
            match input.role {
                Some(role) => all.files.push((role, path)),
                None => all.data.push(path),
            }
        }
        all
    }

    fn file(&self, role: Role) -> Option<&PathBuf> {
        self.files.iter().find(|(r, _)| *r == role).map(|(_, path)| path)
    }

    /// The facility.
    ///
    /// # Errors
    /// The file is no facility.
    pub fn facility(&self) -> Result<Option<Facility>, Finding> {
        facility(self.file(Role::Facility), &mut Vec::new())
    }

    /// The linearisation.
    ///
    /// # Errors
    /// The file is no linearisation.
    pub fn linearisation(&self) -> Result<Option<Linearisation>, Finding> {
        linearisation(self.file(Role::Linearisation))
    }

    /// The known effects.
    ///
    /// # Errors
    /// The file is no model.
    pub fn model(&self) -> Result<Option<Known>, Finding> {
        known(self.file(Role::Model))
    }

    /// What the parameters follow of the sensor temperature.
    ///
    /// # Errors
    /// The file holds no such polynomials.
    pub fn temperature(&self) -> Result<Option<SensorPolynomials>, Finding> {
        temperature(self.file(Role::Temperature))
    }

    /// The linear calibration that gives nT.
    ///
    /// # Errors
    /// The file is no linear calibration.
    pub fn sensitivities(&self) -> Result<Option<(Input, Sensitivities)>, Finding> {
        sensitivities(self.file(Role::Cpf))
    }

    fn pair(&self) -> Result<Option<PairFiles>, Finding> {
        let read =
            |centre: &PathBuf| PairFiles::read(centre, self.file(Role::OffCentre), self.file(Role::Offset), &mut Vec::new());
        self.file(Role::Centre).map(read).transpose()
    }
}

/// Reads the linear calibration of `--cpf`, whose sensitivities give nT.
///
/// # Errors
/// The file is no linear calibration.
pub fn sensitivities(path: Option<&PathBuf>) -> Result<Option<(Input, Sensitivities)>, Finding> {
    let Some(path) = path else { return Ok(None) };
    let file = parameter::read::<Cpf>(path)?;
    Ok(Some((file.input.with_role(Role::Cpf), (&file.body.calibration).into())))
}

/// Follows a recipe: what it makes is written into the folder for results.
///
/// # Errors
/// A recipe that is not one of this version, or makes no parameter file; inputs that cannot be read or are refused.
pub fn again(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    let desk = &Desk {
        allow_truncated: recipe.reading.allow_truncated,
        allow_duplicates: recipe.reading.allow_duplicates,
        exclude: recipe.reading.exclude.clone(),
        ..desk.clone()
    };
    match recipe.analysis.as_str() {
        "freq" if with.file(Role::Amplitudes).is_some() => amplitudes(with, desk),
        // Recorded without a recipe, a sweep is told by its run.
        "thermal" if is_sweep(with) => runs::<sweep::Options>(recipe, with, desk),
        "thermal" => thermal(recipe, with, desk),
        "linearise" => linearise(recipe, with, desk),
        // A model file is made of several diagnoses, which the command line alone brings together.
        "diagnose" if !recipe.options.contains_key(WRITE_MODEL) => diagnose(with, desk),
        "thermistor" => thermistor(recipe, with, desk),
        "coil scalar" | "coil residual" | "coil tilt" => coil(recipe, with, desk),
        other => match RUN_KINDS.iter().find(|kind| kind.analysis == other) {
            Some(kind) => kind.again(recipe, with, desk),
            None => Err(AgainError::NoParameters(other.to_owned())),
        },
    }
}

/// Analyses runs, each on its own.
pub(super) fn runs<A: PerRun>(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    let options = recipe.options::<A>()?.with_files(with)?;
    of_runs(&with.data, A::KIND, desk, |jobs| {
        for job in jobs {
            let made = make(&options, job, desk, false)?;
            publish::<A>(&made, desk, &made.result.parameters().file_name())?;
        }
        Ok(())
    })
}

/// Opens the campaigns of run files, of which the same is left out as before.
fn campaigns(paths: &[PathBuf], desk: &Desk) -> Result<Vec<Campaign>, Finding> {
    if paths.is_empty() {
        return Ok(Vec::new());
    }
    Campaign::open_without(paths, &desk.exclude, &mut Vec::new())
}

/// Opens the campaigns of run files and hands the runs of a kind over.
fn of_runs(
    paths: &[PathBuf],
    kind: Kind,
    desk: &Desk,
    follow: impl FnOnce(&[Job]) -> Result<(), AgainError>,
) -> Result<(), AgainError> {
    let campaigns = campaigns(paths, desk)?;
    follow(&jobs(&campaigns, Some(kind)).0)
}

fn amplitudes(with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    for (_, table) in with.files.iter().filter(|(role, _)| *role == Role::Amplitudes) {
        let made = of_table(table, &mut Vec::new())?;
        publish::<freq::Options>(&made, desk, &made.result.parameters().file_name())?;
    }
    Ok(())
}

fn linearise(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    let options = recipe.options::<lin::Options>()?.with_files(with)?;
    of_runs(&with.data, Kind::Linearity, desk, |jobs| {
        let mut first = Vec::new();
        for job in jobs {
            first.push(First { job, made: make(&options, job, desk, false)? });
        }
        for group in by_sensor_and_mode(first) {
            linearise_group(group, &options, desk)?;
        }
        Ok(())
    })
}

fn diagnose(with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    for (_, table) in with.files.iter().filter(|(role, _)| *role == Role::Amplitudes) {
        let made = diagnose_table(table, &mut Vec::new())?;
        publish_diagnosis(&made, &made.diagnosis.runs.concat(), desk)?;
    }
    let given = DiagnosedWith { facility: with.facility()?, temperature: with.temperature()?, model: with.model()? };
    let mut together = Across::default();
    let mut runs = Vec::new();
    for path in &with.data {
        if Format::Csv.is_of(path) {
            together.table(path, &mut Vec::new())?;
        } else if is_named::<Cpf>(path) {
            together.cpf(path)?;
        } else {
            runs.push(path.clone());
        }
    }
    let campaigns = campaigns(&runs, desk)?;
    let (jobs, _) = jobs(&campaigns, None);
    if let ([job], 0) = (jobs.as_slice(), together.count()) {
        let made = diagnose_run(job, desk, &given, false)?;
        publish_diagnosis(&made, made.diagnosis.runs.first().map_or("", String::as_str), desk)?;
    } else if !with.data.is_empty() {
        let mut failures = Vec::new();
        together.runs(&jobs.iter().collect::<Vec<_>>(), &given.of_runs(), desk, &mut failures);
        none_failed(failures)?;
        publish_diagnosis(&together.diagnose()?, "", desk)?;
    }
    Ok(())
}

/// Whether what is analysed is one run, of a sweep.
fn is_sweep(with: &Ingredients) -> bool {
    matches!(with.data.as_slice(), [one] if ccr::peek(one).is_ok_and(|header| header.kind == Kind::Sweep))
}

fn thermal(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    let (facility, linearisation, model) = (with.facility()?, with.linearisation()?, with.model()?);
    let options = ThermalOptions { facility, linearisation, model, ..recipe.options()? };
    let (polynomials, rest): (Vec<&PathBuf>, Vec<&PathBuf>) = with.data.iter().partition(|path| is_named::<Tpf>(path));
    let (files, runs): (Vec<&PathBuf>, Vec<&PathBuf>) =
        rest.into_iter().partition(|path| parameter::FileKind::of_name(path).is_some());
    let mut input = ThermalInput::default();
    for file in files {
        input.file(file, &mut Vec::new())?;
    }
    let paths: Vec<PathBuf> = runs.into_iter().cloned().collect();
    let campaigns = campaigns(&paths, desk)?;
    let analyses = options.analyses(sweep::Options::default());
    let mut measured = Vec::new();
    for job in jobs(&campaigns, None).0 {
        measured.push(analyses.make(&job, desk, false)?);
    }
    let entries: Vec<_> = campaigns.iter().flat_map(|c| c.file.instructions.thermal.iter().cloned()).collect();
    settle(&mut measured, &entries, &options.orders);
    input.measured(&measured);
    let pair = with.pair()?;
    if let Some(pair) = &pair {
        input.leave_out_centre(pair);
    }
    let lins: Vec<&lin::Lin> = measured.iter().filter_map(|m| m.lin()).map(|made| &made.result).collect();
    let mut groups = Vec::new();
    for group in input.groups(&lins, &entries, &options, desk) {
        match group {
            Ok(group) => groups.push(group),
            Err(NoThermal::OfPair) => {}
            Err(NoThermal::OneTemperature(finding) | NoThermal::Refused(finding)) => return Err(finding.into()),
        }
    }
    let made = match &pair {
        Some(pair) => input.to_centre(pair, &polynomials.into_iter().cloned().collect::<Vec<_>>(), &groups, &options, desk),
        None => input.to_own_centre(&groups, &options, desk),
    };
    for one in made {
        one?;
    }
    refer(&mut measured, Vec::new(), &groups, desk);
    for one in &measured {
        one.publish(desk, true)?;
    }
    Ok(())
}

/// The table that is analysed.
fn table(with: &Ingredients) -> Result<&Path, Finding> {
    let none =
        || Finding::error("the recipe", "names no table among its inputs", "run the recorded command on the inputs to see why");
    with.data.first().map(PathBuf::as_path).ok_or_else(none)
}

fn thermistor(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    let options: thermistor::Options = recipe.options()?;
    let reference = with.file(Role::Reference).map(PathBuf::as_path);
    publish_thermistor(&thermistor_of(table(with)?, reference, &options, &mut Vec::new())?, desk)?;
    Ok(())
}

fn coil(recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
    match recipe.analysis.as_str() {
        "coil scalar" => {
            let options = recipe.options()?;
            of_runs(&with.data, Kind::Scalar, desk, |jobs| publish_made(scalar_of(read(jobs, desk)?, &options, desk)?, desk))
        }
        "coil residual" if table(with).is_ok_and(|path| Format::Csv.is_of(path)) => {
            publish_made(Some(residual_of_table(table(with)?, &mut Vec::new())?), desk)
        }
        "coil residual" => {
            of_runs(&with.data, Kind::Scalar, desk, |jobs| publish_made(residual_of(read(jobs, desk)?, desk)?, desk))
        }
        _ => {
            let facility = with.facility()?;
            let mut input = TiltInput::default();
            let mut runs = Vec::new();
            for path in &with.data {
                if Format::Csv.is_of(path) {
                    input.table(path, &mut Vec::new())?;
                } else if is_named::<Cpf>(path) {
                    input.cpf(path)?;
                } else {
                    runs.push(path.clone());
                }
            }
            let options = lin::Options { facility: facility.clone(), ..lin::Options::default() };
            of_runs(&runs, Kind::Linearity, desk, |jobs| {
                let mut failures = Vec::new();
                input.runs(jobs, &options, desk, &mut failures);
                none_failed(failures)?;
                publish_made(Some(input.solve(facility.as_ref(), &recipe.options()?)?), desk)
            })
        }
    }
}

/// Reads scalar runs, all of which were read before.
fn read<'a>(jobs: &[Job<'a>], desk: &Desk) -> Result<Vec<super::CoilRun<'a>>, AgainError> {
    let mut failures = Vec::new();
    let runs = coil_runs(jobs, desk, &mut failures);
    none_failed(failures)?;
    Ok(runs)
}

fn none_failed(failures: Vec<(String, Failure)>) -> Result<(), AgainError> {
    failures.into_iter().next().map_or(Ok(()), |(_, failure)| Err(failure.into()))
}

fn publish_made<R: CoilResult>(made: Option<CoilMade<R>>, desk: &Desk) -> Result<(), AgainError> {
    if let Some(made) = made {
        publish_coil(&made, desk)?;
    }
    Ok(())
}
