//! Diagnoses as files, figures and text.

use super::again::WRITE_MODEL;
use super::renew::DIAGNOSIS_FILE;
use super::{Desk, Failure, Job, draw, is_model_of, read};
use crate::data::error::Finding;
use crate::data::plateau::{self, Accumulator, Cut};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::recipe::Recipe;
use crate::diagnose::across::{RunValues, across};
use crate::diagnose::result::{Diagnosis, Parameter};
use crate::diagnose::{self, DiagnoseError, Options, Samples};
use crate::files::ledger::Origin;
use crate::files::orientations;
use crate::files::output::Folder;
use crate::files::parameter::{self, Cpf, Model, ModelEffect, ModelParameter, ParameterFile};
use crate::files::source::{content_size, read_whole, room_for};
use crate::files::text::{Keys, decode};
use crate::measure::lin;
use crate::model::effects::{Catalogue, EffectRef, Spec};
use crate::model::facility::{Facility, FacilityParameters};
use crate::model::sensor_polynomials::SensorPolynomials;
use crate::record::conditions;
use crate::record::known::Known;
use crate::show::{self, Drawn, html, markdown};
use serde::Serialize;
use std::path::{Path, PathBuf};

const WRITTEN_BY: &str = concat!("calfit ", env!("CARGO_PKG_VERSION"));

/// A diagnosis with what is known of its origin.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosed {
    /// Program and version: the mark of a file that may be written over.
    pub written_by: &'static str,
    /// What was found.
    #[serde(flatten)]
    pub diagnosis: Diagnosis,
    /// Its origin.
    pub provenance: Provenance,
    /// Sensor and mode of the run; absent for what is not of one run.
    #[serde(skip)]
    pub of: Option<[String; 2]>,
}

/// Files that a diagnosis is given beside the data.
#[derive(Clone, Debug, Default)]
pub struct DiagnosedWith {
    /// What turns settings into applied fields.
    pub facility: Option<Facility>,
    /// What a sensor follows of its temperature.
    pub temperature: Option<SensorPolynomials>,
    /// Known effects.
    pub model: Option<Known>,
}

impl Diagnosed {
    /// A diagnosis of this program.
    #[must_use]
    pub fn new(diagnosis: Diagnosis, provenance: Provenance) -> Self {
        Self { written_by: WRITTEN_BY, diagnosis, provenance, of: None }
    }
}

impl DiagnosedWith {
    /// The options of the diagnosis, with what only figures show or without it.
    #[must_use]
    pub fn options(&self, plots: bool) -> Options {
        Options {
            facility: self.facility.clone(),
            temperature: self.temperature.clone(),
            given: self.model.as_ref().map(Known::given).unwrap_or_default(),
            catalogue: Catalogue::default(),
            without_insides: !plots,
        }
    }

    /// The options of the linear fits whose parameters are looked at together.
    #[must_use]
    pub fn of_runs(&self) -> lin::Options {
        lin::Options { facility: self.facility.clone(), temperature: self.temperature.clone(), ..lin::Options::default() }
    }

    /// The files.
    #[must_use]
    pub fn inputs(&self) -> Vec<Input> {
        let model = self.model.iter().map(|known| &known.input);
        let facility = self.facility.iter().map(|facility| &facility.input);
        model.chain(facility).chain(self.temperature.iter().map(|polynomials| &polynomials.input)).cloned().collect()
    }
}

/// Reads and diagnoses one run.
///
/// # Errors
/// The file cannot be read, or the run cannot be looked at.
pub fn diagnose_run(job: &Job, desk: &Desk, with: &DiagnosedWith, two_threads: bool) -> Result<Diagnosed, Failure> {
    // All samples of the run, their residuals and their spectra.
    room_for(&job.path, MEMORY_PER_BYTE.saturating_mul(content_size(&job.path))).map_err(Failure::Refused)?;
    let (run, (accumulator, samples)) = read(job, desk, two_threads, (Accumulator::default(), Samples::default()))?;
    is_model_of(with.model.as_ref(), &run, job)?;
    let plateaus = plateau::of_run(&run, accumulator, Cut::default());
    let mut diagnosis = diagnose::run(&run, &plateaus, Some(&samples), job.campaign, &with.options(desk.plots))
        .map_err(|reason| Failure::Refused(refusal(&job.recorded, &reason)))?;
    diagnosis.notes.extend(conditions::excluded(&run));
    diagnosis.notes.extend(with.model.as_ref().and_then(Known::untold));
    let mut input = vec![Input::from(&run)];
    input.extend(job.campaign.input.clone());
    input.extend(with.inputs());
    let provenance = Provenance::new(Recipe::plain("diagnose").reading(desk.allowed_of(&run.header.run)), input);
    let of = Some([run.header.sensor.clone(), run.header.mode.clone()]);
    Ok(Diagnosed { of, ..Diagnosed::new(diagnosis, provenance) })
}

/// A refusal of a file or of several.
fn refusal(place: &str, reason: &DiagnoseError) -> Finding {
    Finding::error(place, reason.to_string(), reason.remedy())
}

/// Diagnoses a table of amplitudes; its name without `freq_` is the run id. Warnings go to `findings`.
///
/// # Errors
/// The table cannot be read, or its name cannot be a run id.
pub fn diagnose_table(path: &Path, findings: &mut Vec<Finding>) -> Result<Diagnosed, Finding> {
    let (rows, id, provenance) = super::freq::amplitude_table("diagnose", path, findings)?;
    let diagnosis = diagnose::freq::table(&rows, &id).map_err(|reason| refusal(&path.display().to_string(), &reason))?;
    Ok(Diagnosed::new(diagnosis, provenance))
}

/// Parameters of runs that are looked at together.
#[derive(Default)]
pub struct Across {
    values: Vec<RunValues>,
    inputs: Vec<Input>,
    /// Facilities that the parameters were found with.
    stated: Vec<Option<FacilityParameters>>,
}

impl Across {
    /// Takes the rows of a table of run results; warnings go to `findings`.
    ///
    /// # Errors
    /// The table cannot be read.
    pub fn table(&mut self, path: &Path, findings: &mut Vec<Finding>) -> Result<(), Finding> {
        let (rows, digested) = orientations::read(path, findings)?;
        let name = |part: Option<&std::ffi::OsStr>| part.map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
        let set = name(path.file_stem());
        self.values.extend(rows.iter().map(|row| RunValues::of_row(row, &set)));
        self.inputs.push(digested.input(name(path.file_name())));
        Ok(())
    }

    /// Takes a linear calibration.
    ///
    /// # Errors
    /// The file cannot be read, or its position is none.
    pub fn cpf(&mut self, path: &Path) -> Result<(), Finding> {
        let file = parameter::read::<Cpf>(path)?;
        let values =
            RunValues::of_calibration(&file.body.calibration).map_err(|reason| refusal(&path.display().to_string(), &reason))?;
        self.values.push(values);
        self.stated.push(file.body.facility.as_ref().map(|f| f.applied.clone()));
        self.inputs.push(file.input);
        Ok(())
    }

    /// Fits linearity runs and takes their parameters; what cannot be fitted goes to `failures`.
    pub fn runs(&mut self, jobs: &[&Job], options: &lin::Options, desk: &Desk, failures: &mut Vec<(String, Failure)>) {
        for job in jobs {
            let refuse = |reason: DiagnoseError| {
                Failure::Refused(Finding::error(&job.recorded, reason.to_string(), "see `calfit lin` for this run"))
            };
            let taken = read(job, desk, true, Accumulator::default()).and_then(|(run, accumulator)| {
                let plateaus = plateau::of_run(&run, accumulator, options.cut);
                let values = RunValues::of_run(&run, &plateaus, job.campaign, options).map_err(refuse)?;
                Ok((values, Input::from(&run)))
            });
            match taken {
                Ok((values, input)) => {
                    self.values.push(values);
                    let facility = options.facility.iter().map(|f| &f.input);
                    let temperature = options.temperature.iter().map(|t| &t.input);
                    for input in [input].iter().chain(&job.campaign.input).chain(facility).chain(temperature) {
                        if !self.inputs.contains(input) {
                            self.inputs.push(input.clone());
                        }
                    }
                }
                Err(failure) => failures.push((job.recorded.clone(), failure)),
            }
        }
    }

    /// Runs there are.
    #[must_use]
    pub fn count(&self) -> usize {
        self.values.len()
    }

    /// Diagnoses them together.
    ///
    /// # Errors
    /// The parameters were found with different facilities, or show nothing together.
    pub fn diagnose(self) -> Result<Diagnosed, Finding> {
        let shown: Vec<&str> = self.inputs.iter().map(|i| i.path.as_str()).collect();
        if self.stated.iter().any(|s| s != &self.stated[0]) {
            let rule = "the parameter files were made with different facilities";
            return Err(Finding::error(&shown.join(", "), rule, "fit the runs again with the same --facility"));
        }
        let diagnosis = across(&self.values, &Catalogue::default()).map_err(|reason| refusal(&shown.join(", "), &reason))?;
        Ok(Diagnosed::new(diagnosis, Provenance::new(Recipe::plain("diagnose"), self.inputs)))
    }
}

/// What a diagnosis holds in memory for a byte of the file: 1.1 GiB for 3.7 million vectors of 36 bytes.
const MEMORY_PER_BYTE: u64 = 8;

/// Writes a diagnosis into the folder of a run, or that of all results if `run` is empty: figures, the report as Markdown and HTML, and `diagnosis.json` last.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish_diagnosis(made: &Diagnosed, run: &str, desk: &Desk) -> Result<(), Finding> {
    let folder = desk.folder(run, Origin::of(&made.provenance).telling(&made.diagnosis.notes))?;
    folder.check(DIAGNOSIS_FILE)?;
    let name = made.diagnosis.runs.first().map_or("", String::as_str);
    let figures = crate::plot::diagnose::figures(&made.diagnosis);
    let drawn = if desk.plots { draw(&folder, &figures, |stem| figure_name(stem, name))? } else { Vec::new() };
    let title = show::diagnose::title(&made.diagnosis);
    let numbered = Drawn::number(&drawn, "", &mut 0);
    // Every figure stands in the section that it belongs to.
    let shown = |stem: &str| {
        let file = figure_name(stem, name);
        numbered.iter().find(|figure| figure.file == file).cloned()
    };
    let sections = show::diagnose::sections(&made.diagnosis, &shown);
    let document = show::standalone(&title, &made.diagnosis.notes, sections, Vec::new(), &made.provenance);
    folder.write(&format!("REPORT_DIAGNOSIS__{name}.md"), markdown::page(&document).as_bytes())?;
    let page = html::page(&document, &mut |file| std::fs::read(folder.path().join(file)).ok());
    folder.write(&format!("REPORT_DIAGNOSIS__{name}.html"), page.as_bytes())?;
    let json = serde_json::to_string_pretty(made)
        .map_err(|e| Finding::error(DIAGNOSIS_FILE, format!("the result has no text form: {e}"), "report this"))?;
    folder.sync()?;
    folder.write(DIAGNOSIS_FILE, format!("{json}\n").as_bytes())?;
    folder.sync()
}

fn figure_name(stem: &str, run: &str) -> String {
    format!("DIAGNOSIS_{stem}__{run}.png")
}

/// Reads a model file.
///
/// # Errors
/// As [`parameter::read`], and effects that the catalogue does not have, or without a parameter, with their lines.
pub fn read_model(path: &Path) -> Result<(ParameterFile<Model>, Known), Finding> {
    let file = parameter::read::<Model>(path)?;
    let (bytes, _) = read_whole(path)?;
    let keys = Keys::parse(&path.display().to_string(), 1, decode(&bytes).into_owned())?;
    let known =
        Known::of(file.input.clone().with_role(Role::Model), &file.body, &keys.root().groups("effect")?, &Catalogue::default())?;
    Ok((file, known))
}

/// Reads the model of `--model`.
///
/// # Errors
/// See [`read_model`].
pub fn known(path: Option<&PathBuf>) -> Result<Option<Known>, Finding> {
    path.map(|path| read_model(path).map(|(_, known)| known)).transpose()
}

/// Writes the effects of some diagnoses as a model file, beside those of a model that they were given.
///
/// # Errors
/// What cannot be written.
pub fn publish_model(path: &Path, all: &[&Diagnosed], given: Option<&Model>, force: bool) -> Result<(), Finding> {
    let mut effect: Vec<ModelEffect> = given.map(|model| model.effect.clone()).unwrap_or_default();
    // The sensors and modes of what is written.
    let mut of: Vec<Option<[String; 2]>> = given.iter().map(|model| Some([model.sensor.clone()?, model.mode.clone()?])).collect();
    for (diagnosed, step) in all.iter().flat_map(|d| d.diagnosis.steps.iter().map(move |s| (d, s))) {
        let diagnosis = &diagnosed.diagnosis;
        let further = step.further.iter().map(|one| (&one.form, &one.parameters, one.one_plateau_s));
        let forms = std::iter::once((&step.form, &step.parameters, step.one_plateau_s)).chain(further);
        // What may be one disturbed plateau is no effect that another reading has.
        for (form, parameters, _) in forms.filter(|(.., one_plateau_s)| one_plateau_s.is_none()) {
            // What is damaged or only seen between runs is no term of a reading.
            let Some(mut entry) = entry(step.effect, form, parameters) else { continue };
            entry.run = diagnosis.runs.first().cloned();
            let readings = diagnosis.reading_ent;
            entry.reading_ent = readings.iter().flatten().all(|v| v.is_finite()).then(|| readings.to_vec());
            let same = |e: &ModelEffect| e.id == entry.id && e.form == entry.form && e.axes == entry.axes;
            let has_shape = |e: &ModelEffect| e.shape.iter().map(|p| p.value).eq(entry.shape.iter().map(|p| p.value));
            // What belongs to the time of one run is there once for each; what does not is found in several with a shape of each. Twice in one run
            // it is two.
            let any_run = !step.effect.is_of_one_run(&entry.form);
            if !effect.iter().any(|e| same(e) && if e.run == entry.run { has_shape(e) } else { any_run }) {
                effect.push(entry);
                of.push(diagnosed.of.clone());
            }
        }
    }
    let one = of.first().cloned().flatten().filter(|first| of.iter().all(|other| other.as_ref() == Some(first)));
    let [sensor, mode] = one.map_or([None, None], |of| of.map(Some));
    let model = Model {
        sensor,
        mode,
        used: all.iter().flat_map(|d| d.diagnosis.runs.clone()).collect(),
        convention: "reading += parameter x column of the form (`calfit effects ID`), enT; fields nT in coil axes, times s from the run's start; \
                     sines: phasor x (1 + part (P(f/f_c) - 1)) with P one or two poles, f_s += drift_k t^k or drift (T - T_mean), readings late by shift"
            .to_owned(),
        effect,
    };
    let input = all.iter().flat_map(|d| d.provenance.input.clone()).collect();
    let provenance = Provenance::new(Recipe::new("diagnose", &serde_json::json!({ WRITE_MODEL: true })), input);
    let name = path.file_name().map_or_else(|| "model.toml".to_owned(), |n| n.to_string_lossy().into_owned());
    let text = super::parameter_text(&name, &model, &provenance)?;
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = Folder::open(parent, force)?;
    folder.write(&name, text.as_bytes())?;
    folder.sync()
}

fn entry(effect: EffectRef, form: &Spec, parameters: &[Parameter]) -> Option<ModelEffect> {
    let of = |p: &Parameter| ModelParameter { name: p.name.clone(), value: p.value, std: p.std, unit: p.unit.clone() };
    if form.axes.is_empty() {
        return None;
    }
    let is_shape = |name: &str| form.shape.iter().any(|(n, _, _)| n == name);
    let shape = form
        .shape
        .iter()
        .map(|(name, value, unit)| ModelParameter {
            name: name.clone(),
            value: *value,
            std: parameters.iter().find(|p| p.name == *name).and_then(|p| p.std),
            unit: unit.clone(),
        })
        .collect();
    Some(ModelEffect {
        id: effect.to_string(),
        form: form.form.clone(),
        axes: form.axis_names().into_iter().map(str::to_owned).collect(),
        run: None,
        reading_ent: None,
        parameter: parameters.iter().filter(|p| !is_shape(&p.name)).map(of).collect(),
        shape,
    })
}
