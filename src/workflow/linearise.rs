//! Linearisations as files, figures and text, and the runs fitted once more with them.

use super::{Desk, Job, Made, Outcome, draw, recipe};
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::recipe::Recipe;
use crate::files::ledger::Origin;
use crate::files::linearisation;
use crate::files::parameter::{Body, LinearisationConvention, LinearisationFile, linearisation_file_name};
use crate::files::source::hex;
use crate::measure::lin::{Lin, Options};
use crate::measure::linearise::{Linearised, PanelData, linearise};
use crate::model::linearisation::Linearisation;
use crate::plot;
use crate::show;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::path::PathBuf;

/// A run that was fitted as it is, with its file.
pub struct First<'a> {
    /// The file.
    pub job: &'a Job<'a>,
    /// Its linear calibration without a linearisation.
    pub made: Made<Lin>,
}

/// A run that was fitted with the linearisation, with its file, or why there is no such fit.
pub type Refitted<'a> = (&'a Job<'a>, Result<Made<Lin>, Finding>);

/// A linearisation as `--json` prints it.
#[derive(Serialize)]
pub struct LinearisedView<'a> {
    parameters: LinearisationFile,
    panels: &'a [PanelData],
}

impl<'a> From<&'a Linearised> for LinearisedView<'a> {
    fn from(result: &'a Linearised) -> Self {
        Self { parameters: result.into(), panels: &result.panels }
    }
}

impl From<&Linearised> for LinearisationFile {
    fn from(result: &Linearised) -> Self {
        Self { convention: LinearisationConvention::default(), shared: result.shared.clone(), told: Told::of(&result.notes) }
    }
}

/// Reads the linearisation of `--linearisation`.
///
/// # Errors
/// The file is no linearisation.
pub fn linearisation(path: Option<&PathBuf>) -> Result<Option<Linearisation>, Finding> {
    path.map(|path| linearisation::read(path)).transpose()
}

/// Runs of one sensor and mode together, in the order of their first runs; runs of a group in time order.
#[must_use]
pub fn by_sensor_and_mode(mut runs: Vec<First>) -> Vec<Vec<First>> {
    runs.sort_by(|a, b| {
        let key = |f: &First| (f.made.result.calibration.run.start.clone(), f.made.result.calibration.run.id.clone());
        key(a).cmp(&key(b))
    });
    let mut groups: Vec<Vec<First>> = Vec::new();
    for run in runs {
        let of = |f: &First| (f.made.result.calibration.run.sensor.clone(), f.made.result.calibration.run.mode.clone());
        match groups.iter_mut().find(|g| g.first().is_some_and(|f| of(f) == of(&run))) {
            Some(group) => group.push(run),
            None => groups.push(vec![run]),
        }
    }
    groups
}

/// Finds the linearisation that the runs of a group share, fits each with it, and writes the linearisation. The runs are not written:
/// their parameter files rest on that of the linearisation and have to follow it.
///
/// # Errors
/// The runs do not determine it, or it cannot be written.
pub fn linearise_group<'a>(
    group: Vec<First<'a>>,
    options: &Options,
    desk: &Desk,
) -> Result<(Linearised, Vec<Refitted<'a>>), Finding> {
    let before: Vec<&Lin> = group.iter().map(|f| &f.made.result).collect();
    let names: Vec<&str> = group.iter().map(|f| f.job.recorded.as_str()).collect();
    let mut estimate = linearise(&before).map_err(|e| Finding::error(&names.join(", "), e.to_string(), e.remedy()))?;
    estimate.linearisation.input.path = linearisation_file_name(&estimate.shared.used);
    let mut options_with = Options { linearisation: Some(estimate.linearisation.clone()), ..options.clone() };
    let after: Vec<Result<Lin, Finding>> = group.iter().map(|f| f.made.again(&options_with)).collect();
    let fitted: Vec<Option<&Lin>> = after.iter().map(|a| a.as_ref().ok()).collect();
    let result = estimate.complete(&before, &fitted);

    let mut input: Vec<Input> = Vec::new();
    for one in group.iter().flat_map(|f| &f.made.provenance.input) {
        if !input.contains(one) {
            input.push(one.clone());
        }
    }
    // The runs come first, as in every result of several runs.
    input.sort_by_key(|i| i.path.ends_with(".toml"));
    let orders: Vec<usize> = before.iter().map(|l| l.calibration.offset.trend_order).collect();
    // Orders that differ come from the campaigns, which are inputs.
    let shared = orders.first().copied().filter(|first| orders.iter().all(|o| o == first));
    let recorded = Options { trend_order: shared.or(options.trend_order), ..options.clone() };
    let linearise = Recipe::new("linearise", &recorded).reading(desk.allowed());
    let written = publish(&result, &Provenance::new(linearise, input), desk)?;
    // Now the file has a hash, by which the parameter files of the runs refer to it.
    if let Some(linearisation) = &mut options_with.linearisation {
        linearisation.input = written;
    }
    let runs = group.into_iter().zip(after).map(|(first, after)| {
        let made = after.map(|result| {
            let mut input = first.made.provenance.input.clone();
            input.extend(options_with.linearisation.iter().map(|l| l.input.clone()));
            let provenance = Provenance::new(recipe(&options_with, &result, desk), input);
            Made { result, provenance, options: options_with.clone(), ..first.made }
        });
        (first.job, made)
    });
    let runs = runs.collect();
    Ok((result, runs))
}

/// Writes figures, report and file of a linearisation, the last one last; returns the file as an input.
fn publish(result: &Linearised, provenance: &Provenance, desk: &Desk) -> Result<Input, Finding> {
    let p = LinearisationFile::from(result);
    let name = p.file_name();
    let stem = name.trim_end_matches(".toml");
    let (begin, first) = stem.split_once("__").unwrap_or((stem, ""));
    let folder = desk.folder("", Origin::of(provenance).telling(&result.notes))?;
    folder.check(&name)?;
    let figures = if desk.plots { plot::linearise::figures(result) } else { Vec::new() };
    let drawn = draw(&folder, &figures, |figure| format!("{begin}_{figure}__{first}.png"))?;
    let outcome = Outcome {
        name: &name,
        parameters: desk.parameter_text("", &name, &p, provenance)?,
        report: format!("REPORT_{stem}.md"),
        title: format!("Linearisation of {} {}", show::or_not_stated(&p.shared.sensor), show::or_not_stated(&p.shared.mode)),
        notes: &result.notes,
        sections: show::linearise::sections(result, &name),
        provenance,
    };
    let (size_bytes, sha256) = (outcome.parameters.len() as u64, hex(&Sha256::digest(outcome.parameters.as_bytes())));
    outcome.write(&folder, &drawn)?;
    Ok(Input { path: name, size_bytes, sha256, role: Some(Role::Linearisation), ..Input::default() })
}
