//! A run file to its result, and a result to its files: what the commands for single runs, the thermal analysis, the protocol and the
//! verification have in common.

mod again;
mod all;
#[cfg(feature = "tables")]
mod apply;
mod centre;
mod coil;
mod diagnose;
mod each;
#[cfg(feature = "tables")]
pub mod flight;
mod freq;
mod ground;
mod import;
mod kind;
mod like;
mod lin;
mod linearise;
mod null;
mod offset;
mod publish;
mod renew;
mod results;
mod settle;
mod sweep;
mod thermal;
mod thermistor;

pub use again::{AgainError, Ingredients, again, sensitivities};
pub use all::{Analyses, Measured, contradictions, publish_alone, publish_thermal_names, scale_to_nt};
#[cfg(feature = "tables")]
pub use apply::{Applied, AppliedFile, ApplyOptions, Flagged, Outside, applied, apply_to, stem};
pub use centre::{CentreMade, PairFiles};
pub use coil::{
    CoilMade, CoilResult, CoilRun, TiltInput, coil_runs, facility, publish_coil, residual_of, residual_of_table, scalar_of,
};
pub use diagnose::{
    Across, Diagnosed, DiagnosedWith, diagnose_run, diagnose_table, known, publish_diagnosis, publish_model, read_model,
};
pub use each::each;
pub use freq::of_table;
pub use ground::{ExportRecipe, NoGround, ground_calibration};
pub use import::{Import, ImportedRun};
pub use kind::{RUN_KINDS, RunKind, RunMade};
pub use like::{OwnParameters, own_parameters};
pub use linearise::{First, LinearisedView, Refitted, by_sensor_and_mode, linearisation, linearise_group};
#[cfg(feature = "tables")]
pub use publish::publish_table;
pub use publish::{Outcome, draw, parameter_text, publish, table_names};
pub use renew::{Renewed, renew};
pub use results::{Left, Results};
pub use settle::{Alone, alone, refer, settle};
pub use thermal::{NoThermal, ThermalFile, ThermalInput, ThermalOptions, ThermalShown, temperature};
pub use thermistor::{ThermistorMade, publish_thermistor, thermistor_of};

use crate::data::across::CalibratedRun;
use crate::data::calibration::Sensitivities;
use crate::data::error::{Finding, Severity};
use crate::data::exclusion::{ExcludedPart, Exclusion, Without};
use crate::data::note::Note;
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::{Reading, Recipe};
use crate::data::result::{RowsUsed, RunHead};
use crate::data::run::{Header, Kind, Run, VectorSink};
use crate::data::sketch::Sketch;
use crate::files::campaign::{Campaign, RunFile};
use crate::files::ccr;
use crate::files::ledger::{Origin, same_but_dates};
use crate::files::output::Folder;
use crate::files::parameter::Body;
use crate::files::source::{content_size, room_for};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::model::campaign::Instructions;
use crate::model::facility::Facility;
use crate::plot::Named;
use crate::record::known::{Known, OtherSensor};
use crate::show::document::Section;
use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::path::PathBuf;

/// An analysis of single runs: its options are the value, what it keeps while a file is read is its sink.
pub trait PerRun: Clone + Default + Serialize + DeserializeOwned + Send + Sync + 'static {
    /// Name of the analysis in recipes.
    const ANALYSIS: &'static str;
    /// Name of the command.
    const COMMAND: &'static str;
    /// Kind of runs.
    const KIND: Kind;
    /// Begin of the names of figures, tables and reports.
    const STEM: &'static str;
    /// Takes the vectors.
    type Sink: VectorSink;
    /// What comes out.
    type Result: RunResult<Analysis = Self>;
    /// What it holds in memory for a byte of the file, beyond what does not grow with it.
    const MEMORY_PER_BYTE: u64 = 0;
    /// Whether known effects are taken off its readings.
    const TAKES_MODEL: bool = false;

    /// A sink for a run; with `figures` it also keeps what they show of the raw data.
    fn sink(&self, figures: bool) -> Self::Sink;

    /// The same for the run of a job, where something of the run must be known before its first vector.
    ///
    /// # Errors
    /// The file cannot be read.
    fn sink_of(&self, _job: &Job, desk: &Desk, _two_threads: bool) -> Result<Self::Sink, Failure> {
        Ok(self.sink(desk.plots))
    }

    /// The result of a run that was read.
    ///
    /// # Errors
    /// The rule that the run breaks, and what to do.
    fn analyse(&self, run: &Run, sink: Self::Sink, campaign: &Campaign) -> Result<Self::Result, Refusal>;

    /// Inputs beside the run and the campaign file.
    fn inputs(&self) -> Vec<Input> {
        Vec::new()
    }

    /// The known effects that are taken off the readings.
    fn model(&self) -> Option<&Known> {
        None
    }

    /// The options with what the analysis chose where they leave it open.
    fn settled(&self, _result: &Self::Result) -> Self {
        self.clone()
    }

    /// The same options with a facility that turns settings into fields and known effects, as far as the analysis takes them.
    fn with_corrections(self, _facility: Option<&Facility>, _model: Option<&Known>) -> Self {
        self
    }

    /// The same options with the files that they name.
    ///
    /// # Errors
    /// A file that is none of its kind.
    fn with_files(self, files: &Ingredients) -> Result<Self, Finding>;
}

/// Why an analysis refuses a run.
#[derive(Clone, Debug)]
pub struct Refusal {
    /// The rule.
    pub rule: String,
    /// What to do.
    pub remedy: &'static str,
}

/// How people see a result.
pub struct Shown<R> {
    /// The figures in their order.
    pub figures: fn(&R) -> Vec<Named>,
    /// The sections of the report; the name is that of the parameter file.
    pub sections: fn(&R, &str) -> Vec<Section>,
    /// A few lines for the terminal.
    pub summary: fn(&R) -> String,
}

/// The result of one run: for people, for programs, and for other analyses.
pub trait RunResult: Sized + Send + Sync + 'static {
    /// The analysis that it comes from.
    type Analysis: PerRun<Result = Self>;
    /// The parameter file.
    type Parameters: Body;
    /// Name of the analysis in the protocol.
    const NAME: &'static str;
    /// Title of the report, which the run id follows.
    const TITLE: &'static str;
    /// The result in one line.
    const HEADLINE: fn(&Self) -> String;
    /// Figures and text.
    const SHOWN: Shown<Self>;
    /// Gives it in nT as well, with the sensitivities of the linear calibration of the same sensor and mode whose file is named; absent
    /// where there is nothing in enT alone.
    const SCALE: Option<fn(&mut Self, &str, &Sensitivities)> = None;

    /// The run.
    fn head(&self) -> &RunHead;
    /// What a person should know.
    fn notes(&self) -> &[Note];
    /// Whether its uncertainties hold what a facility file states of its own.
    fn has_type_b(&self) -> bool {
        false
    }
    /// Part of what was asked for is refused; the notes say what.
    fn is_partial(&self) -> bool {
        false
    }
    /// How many rows of the run it rests on; `None` where every vector is one.
    fn rows(&self) -> Option<RowsUsed> {
        None
    }
    /// What goes into the parameter file.
    fn parameters(&self) -> Self::Parameters;
    /// Name of the parameter file in a thermal group, where it is another one there.
    fn name_in_group(&self) -> Option<String> {
        None
    }
    /// Its part in an analysis across temperatures.
    fn point(&self) -> Option<CalibratedRun> {
        None
    }
    /// The result as `--json` prints it.
    fn view(&self) -> impl Serialize + '_;
    /// A few lines for the terminal.
    fn summary(&self) -> String {
        (Self::SHOWN.summary)(self)
    }
    /// Tables beside the report: begin of the file name, note, table.
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        Vec::new()
    }
    /// One row per run, with a note; absent for a kind of which there is no such table.
    #[cfg(feature = "tables")]
    fn campaign_table(_all: &[Self::Parameters]) -> Option<(&'static str, Table)> {
        None
    }
}

/// Where results go, and what is allowed.
#[derive(Clone, Debug)]
pub struct Desk {
    /// Folder for results.
    pub out: PathBuf,
    /// Write over files of others.
    pub force: bool,
    /// Draw figures.
    pub plots: bool,
    /// Read files that end before `@END`.
    pub allow_truncated: bool,
    /// Read files with many repeated rows.
    pub allow_duplicates: bool,
    /// What is left out by hand beside what campaign files say.
    pub exclude: Vec<Exclusion>,
    /// What is noted of the folder for results, if it is that of a campaign.
    pub results: Results,
}

impl Desk {
    /// A folder for results that nobody looks at, without figures.
    #[must_use]
    pub fn plain(out: PathBuf) -> Self {
        Self {
            out,
            force: false,
            plots: false,
            allow_truncated: false,
            allow_duplicates: false,
            exclude: Vec::new(),
            results: Results::default(),
        }
    }

    /// The folder of a run below the folder for results, or that itself if `run` is empty, for files of one origin.
    ///
    /// # Errors
    /// See [`Folder::open`].
    pub fn folder(&self, run: &str, origin: Origin) -> Result<Folder, Finding> {
        let folder = Folder::open_below(&self.out, run, self.force)?;
        Ok(match self.results.ledger() {
            Some(ledger) => folder.recording(&ledger, run, origin),
            None => folder,
        })
    }

    /// The text of a parameter file. Where the folder of the run holds it already, but for its date, it is the text that is there, so that
    /// what rests on the file does not change.
    ///
    /// # Errors
    /// A value without a text form, which would be an error of this program.
    pub fn parameter_text<B: Body>(&self, run: &str, name: &str, body: &B, provenance: &Provenance) -> Result<String, Finding> {
        let text = parameter_text(name, body, provenance)?;
        let there = self.results.ledger().and_then(|_| std::fs::read_to_string(self.out.join(run).join(name)).ok());
        Ok(there.filter(|there| same_but_dates(there.as_bytes(), text.as_bytes(), &provenance.created)).unwrap_or(text))
    }

    /// What is allowed of run files and left out of them, for the recipe.
    #[must_use]
    pub fn allowed(&self) -> Reading {
        Reading { allow_truncated: self.allow_truncated, allow_duplicates: self.allow_duplicates, exclude: self.exclude.clone() }
    }

    /// The same for one run.
    fn allowed_of(&self, run: &str) -> Reading {
        let mut reading = self.allowed();
        reading.exclude.retain(|e| e.run == run);
        reading
    }

    /// How a run file is read.
    #[must_use]
    pub fn reading(&self, recorded: &str, two_threads: bool) -> ccr::Options {
        ccr::Options {
            allow_truncated: self.allow_truncated,
            allow_duplicates: self.allow_duplicates,
            collect: false,
            two_threads,
            recorded_path: Some(recorded.to_owned()),
        }
    }
}

/// A file to work on, with its campaign.
pub struct Job<'a> {
    /// The campaign.
    pub campaign: &'a Campaign,
    /// Path to open.
    pub path: PathBuf,
    /// Path that is recorded.
    pub recorded: String,
    /// What the file says at its head; absent if that cannot be read.
    pub header: Option<Header>,
    /// The user named the file, so it is used whatever the campaign says.
    pub named: bool,
    /// An earlier file with the same run id.
    pub same_run_as: Option<String>,
    /// Why the whole run is left out by hand, if it is.
    pub excluded: Option<String>,
}

/// Why one of several runs or files has no result.
#[derive(Clone, Debug)]
pub enum Failure {
    /// The file cannot be read or is damaged.
    Unreadable(Vec<Finding>),
    /// The analysis refuses the run, or its results cannot be written.
    Refused(Finding),
}

impl Failure {
    /// The errors, without the warnings that came before them.
    pub fn errors(&self) -> impl Iterator<Item = &Finding> {
        let findings = match self {
            Failure::Unreadable(findings) => findings,
            Failure::Refused(finding) => std::slice::from_ref(finding),
        };
        findings.iter().filter(|f| f.severity == Severity::Error)
    }
}

/// All files of the campaigns, or those of a kind: files that the user named are always among them, so that one of the wrong kind
/// is refused and not passed over. A file whose head cannot be read is among them too, for its error to be reported. The second
/// list names what stands in `campaign.toml` and goes with no run.
#[must_use]
pub fn jobs<'a>(campaigns: &'a [Campaign], kind: Option<Kind>) -> (Vec<Job<'a>>, Vec<String>) {
    let files: Vec<(&Campaign, &RunFile)> = campaigns.iter().flat_map(|c| c.runs.iter().map(move |f| (c, f))).collect();
    let headers: Vec<Option<Header>> = files.par_iter().map(|(_, file)| ccr::peek(&file.path).ok()).collect();
    let mut unmatched = Vec::new();
    for campaign in campaigns.iter().filter(|c| c.runs.iter().all(|r| !r.named)) {
        let own = |(c, _): &(&Campaign, &RunFile)| std::ptr::eq(*c, campaign);
        let known: Vec<&Header> = files.iter().zip(&headers).filter(|(f, _)| own(f)).filter_map(|(_, h)| h.as_ref()).collect();
        let without_head = files.iter().zip(&headers).filter(|(f, h)| own(f) && h.is_none());
        let unread: Vec<String> = without_head.map(|((_, file), _)| RunFile::id(&file.recorded)).collect();
        unmatched.extend(campaign.unmatched(&known, &unread).into_iter().map(|entry| format!("campaign.toml: {entry}")));
    }
    let mut first: HashMap<String, String> = HashMap::new();
    let mut jobs = Vec::new();
    for ((campaign, file), header) in files.into_iter().zip(headers) {
        let wanted = match (&header, kind) {
            (Some(header), Some(kind)) if !file.named => header.kind == kind && campaign.uses(header),
            _ => true,
        };
        if wanted {
            let same_run_as = header.as_ref().and_then(|h| match first.entry(h.run.clone()) {
                Entry::Occupied(earlier) => Some(earlier.get().clone()),
                Entry::Vacant(free) => {
                    free.insert(file.recorded.clone());
                    None
                }
            });
            let mut job = Job {
                campaign,
                path: file.path.clone(),
                recorded: file.recorded.clone(),
                header,
                named: file.named,
                same_run_as,
                excluded: None,
            };
            let id = job.id();
            let mut whole = campaign.exclusions(&id).filter(|e| e.part == ExcludedPart::Run);
            job.excluded = whole.next().map(|e| e.reason.clone());
            jobs.push(job);
        }
    }
    (jobs, unmatched)
}

impl Job<'_> {
    /// The run id, or what the file's name tells of it where its head cannot be read.
    #[must_use]
    pub fn id(&self) -> String {
        self.header.as_ref().map_or_else(|| RunFile::id(&self.recorded), |h| h.run.clone())
    }

    /// Results are named after the run id, so two files with one id cannot both have theirs.
    ///
    /// # Errors
    /// There is an earlier file with the same id.
    pub fn unique(&self) -> Result<(), Failure> {
        let Some(other) = &self.same_run_as else { return Ok(()) };
        // The same place with another ending: one file is the other one compressed.
        let remedy = if RunFile::id(other) == RunFile::id(&self.recorded) {
            "take one of the two out of the campaign: one is the other compressed, or an older state of it"
        } else {
            "correct `run` in one of the two"
        };
        Err(Failure::Refused(Finding::error(&self.recorded, format!("has the same run id as {other}"), remedy)))
    }
}

/// A result with what is known of its origin.
pub struct Made<R: RunResult> {
    /// The result.
    pub result: R,
    /// Its origin.
    pub provenance: Provenance,
    /// The run as it was read, without its vectors; absent for a table of amplitudes.
    pub run: Option<Run>,
    /// How it was made.
    pub options: R::Analysis,
    /// What the campaign says of its runs.
    pub instructions: Instructions,
    /// It was made with results of its thermal group, and its file has the name of one there.
    pub in_group: bool,
}

impl<R: RunResult> Made<R> {
    /// Name of the parameter file.
    #[must_use]
    pub fn file_name(&self) -> String {
        let other = self.result.name_in_group().filter(|_| self.in_group);
        other.unwrap_or_else(|| self.result.parameters().file_name())
    }
}

/// Reads a run without what is left out of it by hand; the sink gets its vectors.
///
/// # Errors
/// The file cannot be read, or another one has the same run id.
fn read<S: VectorSink>(job: &Job, desk: &Desk, two_threads: bool, sink: S) -> Result<(Run, S), Failure> {
    job.unique()?;
    let id = job.header.as_ref().map_or("", |h| h.run.as_str());
    let parts = job.campaign.exclusions(id).filter(|e| e.part != ExcludedPart::Run);
    let mut sink = Without::new((sink, Sketch::default()), parts.cloned().collect());
    let mut run = ccr::read(&job.path, &desk.reading(&job.recorded, two_threads), &mut sink).map_err(Failure::Unreadable)?;
    if job.header.is_none() {
        // What is done with a run follows from its head; one that comes late would be left out of everything without a word.
        let rule = "its head could not be read at first, and can be now";
        return Err(Failure::Refused(Finding::error(
            &job.recorded,
            rule,
            "see to the disk, or to what writes the file, and run again",
        )));
    }
    let (sink, sketch) = sink.finish(&mut run);
    run.vectors.sketch = sketch;
    Ok((run, sink))
}

/// Reads and analyses one run.
///
/// # Errors
/// The file cannot be read, or the analysis refuses it.
pub fn make<A: PerRun>(analysis: &A, job: &Job, desk: &Desk, two_threads: bool) -> Result<Made<A::Result>, Failure> {
    room_for(&job.path, A::MEMORY_PER_BYTE.saturating_mul(content_size(&job.path))).map_err(Failure::Refused)?;
    let sink = analysis.sink_of(job, desk, two_threads)?;
    let (run, sink) = read(job, desk, two_threads, sink)?;
    is_model_of(analysis.model(), &run, job)?;
    let result = analysis
        .analyse(&run, sink, job.campaign)
        .map_err(|refusal| Failure::Refused(Finding::error(&job.recorded, refusal.rule, refusal.remedy)))?;
    let mut input = vec![Input::from(&run)];
    input.extend(job.campaign.input.clone());
    input.extend(analysis.inputs());
    let provenance = Provenance::new(recipe(analysis, &result, desk), input);
    let instructions = job.campaign.file.instructions.clone();
    Ok(Made { result, provenance, run: Some(run), options: analysis.clone(), instructions, in_group: false })
}

/// Refuses a run of another sensor or mode than the known effects are of.
fn is_model_of(model: Option<&Known>, run: &Run, job: &Job) -> Result<(), Failure> {
    let holds = model.map_or(Ok(()), |known| known.holds_for(&run.header.sensor, &run.header.mode));
    holds.map_err(|other| Failure::Refused(Finding::error(&job.recorded, other.to_string(), OtherSensor::REMEDY)))
}

/// What a result is made with.
fn recipe<A: PerRun>(analysis: &A, result: &A::Result, desk: &Desk) -> Recipe {
    Recipe::new(A::ANALYSIS, &analysis.settled(result)).reading(desk.allowed_of(&result.head().id))
}
