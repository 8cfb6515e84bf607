//! Diagnoses as files, figures and text.

use super::{Desk, Failure, Job, draw};
use crate::diagnose::result::{Diagnosis, Parameter};
use crate::diagnose::{self, Given, Options, Samples};
use crate::error::Finding;
use crate::formats::ccr;
use crate::formats::output::Folder;
use crate::formats::parameter::{self, Model, ModelEffect, ModelParameter, ParameterFile};
use crate::model::effects::{self, Spec};
use crate::plateau::{self, Accumulator, LEAST_COVERAGE, Settling};
use crate::provenance::{Input, Provenance};
use crate::report::{self, FigureLink};
use crate::units::COMPONENTS;
use serde::Serialize;
use std::path::Path;

/// A diagnosis with what is known of its origin.
#[derive(Clone, Debug, Serialize)]
pub struct Diagnosed {
    /// What was found.
    #[serde(flatten)]
    pub diagnosis: Diagnosis,
    /// Its origin.
    pub provenance: Provenance,
}

/// Reads and diagnoses one run.
///
/// # Errors
/// The file cannot be read, or the run cannot be looked at.
pub fn diagnose_run(
    job: &Job,
    desk: &Desk,
    options: &Options,
    inputs: &[Input],
    two_threads: bool,
) -> Result<Diagnosed, Failure> {
    job.unique()?;
    let mut sink = (Accumulator::default(), Samples::default());
    let run = ccr::read(&job.path, &desk.reading(&job.recorded, two_threads), &mut sink).map_err(Failure::Unreadable)?;
    let (accumulator, samples) = sink;
    let plateaus = plateau::of_run(&run, accumulator, Settling::Found, LEAST_COVERAGE);
    let diagnosis = diagnose::run(&run, &plateaus, Some(&samples), job.campaign, options).map_err(|rule| {
        Failure::Refused(Finding::error(&job.recorded, rule, "diagnose runs with steps, sweeps, sines or zero field"))
    })?;
    let mut input = vec![Input::from(&run.input)];
    input.extend(job.campaign.input.clone());
    input.extend(inputs.iter().cloned());
    let provenance = Provenance::new("calfit diagnose".to_owned(), input);
    Ok(Diagnosed { diagnosis, provenance })
}

/// Writes a diagnosis into a folder: figures, the report as Markdown and HTML, and `diagnosis.json` last.
///
/// # Errors
/// What cannot be drawn or written.
pub fn publish_diagnosis(made: &Diagnosed, folder: &Path, desk: &Desk) -> Result<(), Finding> {
    let folder = Folder::open(folder, desk.force)?;
    folder.check("diagnosis.json")?;
    let name = made.diagnosis.runs.first().map_or("", String::as_str);
    let figures = crate::plot::diagnose::figures(&made.diagnosis);
    let drawn = if desk.plots { draw(&folder, &figures, |stem| format!("DIAGNOSIS_{stem}__{name}.png"))? } else { Vec::new() };
    let title = report::diagnose::title(&made.diagnosis);
    let links: Vec<FigureLink> = FigureLink::number(&drawn, "", &mut 0);
    let sections = report::diagnose::sections(&made.diagnosis, 2);
    let text = report::standalone(&title, &made.diagnosis.warnings, &sections, &links, &made.provenance);
    folder.write(&format!("REPORT_DIAGNOSIS__{name}.md"), text.as_bytes())?;
    let page = report::html::page(&text, &title, &mut |file| std::fs::read(folder.path().join(file)).ok());
    folder.write(&format!("REPORT_DIAGNOSIS__{name}.html"), page.as_bytes())?;
    let json = serde_json::to_string_pretty(made)
        .map_err(|e| Finding::error("diagnosis.json", format!("the result has no text form: {e}"), "report this"))?;
    folder.sync()?;
    folder.write("diagnosis.json", format!("{json}\n").as_bytes())?;
    folder.sync()
}

/// Reads a model file.
///
/// # Errors
/// As [`parameter::read`], and effects that the catalogue does not have.
pub fn read_model(path: &Path) -> Result<(ParameterFile<Model>, Vec<Given>), Finding> {
    let file = parameter::read::<Model>(path)?;
    let given = file
        .body
        .effect
        .iter()
        .map(|e| {
            let refuse =
                |rule: String| Finding::error(&path.display().to_string(), rule, "list the catalogue with `calfit effects`");
            let effect = effects::named(&e.id).ok_or_else(|| refuse(format!("there is no effect {}", e.id)))?;
            let axes = e.axes.iter().map(|a| COMPONENTS.iter().position(|c| c == a));
            let axes: Option<Vec<usize>> = axes.collect();
            let axes = axes.ok_or_else(|| refuse(format!("an axis of {} is none of x, y, z", e.id)))?;
            let shape = e.shape.iter().map(|s| (s.name.clone(), s.value, s.unit.clone())).collect();
            Ok(Given {
                id: effect.id(),
                spec: Spec { form: e.form.clone(), axes, shape },
                values: e.parameter.iter().map(|p| p.value).collect(),
            })
        })
        .collect::<Result<Vec<Given>, Finding>>()?;
    Ok((file, given))
}

/// Writes the effects of some diagnoses as a model file.
///
/// # Errors
/// What cannot be written.
pub fn publish_model(path: &Path, all: &[&Diagnosed], given: &[ModelEffect], force: bool) -> Result<(), Finding> {
    let mut effect: Vec<ModelEffect> = given.to_vec();
    for step in all.iter().flat_map(|d| &d.diagnosis.steps) {
        let first = (step.form.clone(), step.parameters.clone());
        for (form, parameters) in std::iter::once(&first).chain(&step.further) {
            // What is damaged or only seen between runs is no term of a reading.
            let Some(entry) = entry(&step.effect, form, parameters) else { continue };
            if !effect.iter().any(|e| e.id == entry.id && e.form == entry.form && e.axes == entry.axes) {
                effect.push(entry);
            }
        }
    }
    let model = Model {
        used: all.iter().flat_map(|d| d.diagnosis.runs.clone()).collect(),
        convention: "reading += parameter x column of the form (`calfit effects ID`), enT; fields nT in coil axes, times s from the run's start"
            .to_owned(),
        effect,
    };
    let input = all.iter().flat_map(|d| d.provenance.input.clone()).collect();
    let provenance = Provenance::new("calfit diagnose --write-model".to_owned(), input);
    let name = path.file_name().map_or_else(|| "model.toml".to_owned(), |n| n.to_string_lossy().into_owned());
    let text = super::parameter_text(&name, &model, &provenance)?;
    let parent = path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    let folder = Folder::open(parent, force)?;
    folder.write(&name, text.as_bytes())?;
    folder.sync()
}

fn entry(effect: &str, form: &Spec, parameters: &[Parameter]) -> Option<ModelEffect> {
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
        id: effect.to_owned(),
        form: form.form.clone(),
        axes: form.axis_names().into_iter().map(str::to_owned).collect(),
        parameter: parameters.iter().filter(|p| !is_shape(&p.name)).map(of).collect(),
        shape,
    })
}
