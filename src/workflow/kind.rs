//! The kinds of runs that are analysed one by one, one line each, and what a run gave whatever its kind. Scalar runs are analysed together
//! (`coil`).

use super::again::{AgainError, runs};
use super::{Desk, Failure, Ingredients, Job, Made, PerRun, RunResult, make, publish};
use crate::data::across::CalibratedRun;
use crate::data::calibration::Sensitivities;
use crate::data::error::Finding;
use crate::data::index::Index;
use crate::data::note::Note;
use crate::data::provenance::{Input, Provenance};
use crate::data::recipe::Recipe;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::ledger::WrittenFiles;
use crate::measure::{freq, lin, null, offset, sweep};
use crate::model::facility::Facility;
use crate::record::known::Known;
use crate::show::Drawn;
use crate::show::protocol::AnalysisPart;
use serde_json::Value;
use std::any::Any;

/// All kinds of runs that are analysed one by one, in the order of their tables.
pub static RUN_KINDS: &[RunKind] = &[
    RunKind::of::<lin::Options>(),
    RunKind::of::<offset::Options>(),
    RunKind::of::<freq::Options>(),
    RunKind::of::<null::Options>(),
    RunKind::of::<sweep::Options>(),
];

/// A kind of runs with its analysis.
pub struct RunKind {
    /// The kind.
    pub kind: Kind,
    /// Name of the analysis in recipes.
    pub analysis: &'static str,
    usual: fn(Option<&Facility>, Option<&Known>) -> Box<dyn RunAnalysis>,
    again: fn(&Recipe, &Ingredients, &Desk) -> Result<(), AgainError>,
    table: fn(&Index, &WrittenFiles, &Desk) -> Result<(), Finding>,
}

impl RunKind {
    const fn of<A: PerRun>() -> Self {
        Self {
            kind: A::KIND,
            analysis: A::ANALYSIS,
            usual: |facility, model| Box::new(A::default().with_corrections(facility, model)),
            again: runs::<A>,
            #[cfg(feature = "tables")]
            table: super::publish_table::<A>,
            #[cfg(not(feature = "tables"))]
            table: |_, _, _| Ok(()),
        }
    }

    /// The usual options of the analysis, with a facility and known effects where it takes them.
    #[must_use]
    pub fn usual(&self, facility: Option<&Facility>, model: Option<&Known>) -> Box<dyn RunAnalysis> {
        (self.usual)(facility, model)
    }

    /// Follows a recipe of the analysis.
    ///
    /// # Errors
    /// See [`again`](super::again).
    pub fn again(&self, recipe: &Recipe, with: &Ingredients, desk: &Desk) -> Result<(), AgainError> {
        (self.again)(recipe, with, desk)
    }

    /// Writes the table of all runs of the kind, if a parameter file of the kind is among those that were written.
    ///
    /// # Errors
    /// What cannot be written.
    pub(super) fn publish_table(&self, now: &Index, written: &WrittenFiles, desk: &Desk) -> Result<(), Finding> {
        (self.table)(now, written, desk)
    }
}

/// The analysis of a kind of runs with its options.
pub trait RunAnalysis: Send + Sync {
    /// The kind of runs.
    fn kind(&self) -> Kind;
    /// Reads and analyses one run.
    ///
    /// # Errors
    /// The file cannot be read, or the analysis refuses it.
    fn make(&self, job: &Job, desk: &Desk, two_threads: bool) -> Result<Box<dyn RunMade>, Failure>;
}

impl<A: PerRun> RunAnalysis for A {
    fn kind(&self) -> Kind {
        A::KIND
    }
    fn make(&self, job: &Job, desk: &Desk, two_threads: bool) -> Result<Box<dyn RunMade>, Failure> {
        Ok(Box::new(make(self, job, desk, two_threads)?))
    }
}

/// What a run gave, whatever its kind.
pub trait RunMade: Send + Sync {
    /// Whether known effects are taken off the readings of such runs.
    fn takes_model(&self) -> bool;
    /// The run.
    fn head(&self) -> &RunHead;
    /// The run as it was read.
    fn run(&self) -> Option<&Run>;
    /// Where the result comes from.
    fn provenance(&self) -> &Provenance;
    /// What a person should know.
    fn notes(&self) -> &[Note];
    /// The result as the command of the analysis prints it with `--json`, with its provenance.
    ///
    /// # Errors
    /// A value without a JSON form, which would be an error of this program.
    fn view(&self) -> Result<Value, Finding>;
    /// Part of what was asked for is refused.
    fn is_partial(&self) -> bool;
    /// Its part in an analysis across temperatures.
    fn point(&self) -> Option<CalibratedRun>;
    /// Its part in the protocol, with the figures that were drawn.
    fn part<'a>(&'a self, figures: &'a [Drawn]) -> AnalysisPart<'a>;
    /// Writes its files, under their names in a thermal group or those of a single run; returns the figures.
    ///
    /// # Errors
    /// What cannot be drawn or written.
    fn publish(&self, desk: &Desk, in_group: bool) -> Result<Vec<Drawn>, Finding>;
    /// Whether [`RunMade::scale`] gives it in nT as well.
    fn is_scalable(&self) -> bool;
    /// Gives it in nT as well, with the sensitivities of a linear calibration, whose file becomes an input.
    fn scale(&mut self, cpf: Input, sensitivities: &Sensitivities);
    /// Itself, for who knows the analysis and takes it.
    fn into_any(self: Box<Self>) -> Box<dyn Any>;
    /// Itself, for who knows the analysis.
    fn as_any(&self) -> &dyn Any;
    /// Itself, for who knows the analysis and changes it.
    fn as_any_mut(&mut self) -> &mut dyn Any;
}

impl<R: RunResult> RunMade for Made<R> {
    fn takes_model(&self) -> bool {
        R::Analysis::TAKES_MODEL
    }
    fn head(&self) -> &RunHead {
        self.result.head()
    }
    fn run(&self) -> Option<&Run> {
        self.run.as_ref()
    }
    fn provenance(&self) -> &Provenance {
        &self.provenance
    }
    fn notes(&self) -> &[Note] {
        self.result.notes()
    }
    fn view(&self) -> Result<Value, Finding> {
        let name = self.file_name();
        let refuse = |e: serde_json::Error| Finding::error(&name, format!("the result has no JSON form: {e}"), "report this");
        let mut view = serde_json::to_value(self.result.view()).map_err(refuse)?;
        if let Value::Object(table) = &mut view {
            table.insert("analysis".to_owned(), R::Analysis::ANALYSIS.into());
            table.insert("parameter_file".to_owned(), name.as_str().into());
            table.insert("provenance".to_owned(), serde_json::to_value(&self.provenance).map_err(refuse)?);
        }
        Ok(view)
    }
    fn is_partial(&self) -> bool {
        self.result.is_partial()
    }
    fn point(&self) -> Option<CalibratedRun> {
        self.result.point()
    }
    fn part<'a>(&'a self, figures: &'a [Drawn]) -> AnalysisPart<'a> {
        AnalysisPart {
            name: R::NAME,
            head: self.result.head(),
            headline: R::HEADLINE(&self.result),
            has_type_b: self.result.has_type_b(),
            rows: self.result.rows(),
            remarks: self.result.notes().iter().map(Note::to_string).collect(),
            sections: (R::SHOWN.sections)(&self.result, &self.file_name()),
            figures,
        }
    }
    fn publish(&self, desk: &Desk, in_group: bool) -> Result<Vec<Drawn>, Finding> {
        let other = self.result.name_in_group().filter(|_| in_group);
        publish::<R::Analysis>(self, desk, &other.unwrap_or_else(|| self.file_name()))
    }
    fn is_scalable(&self) -> bool {
        R::SCALE.is_some()
    }
    fn scale(&mut self, cpf: Input, sensitivities: &Sensitivities) {
        if let Some(scale) = R::SCALE {
            scale(&mut self.result, &cpf.path, sensitivities);
            self.provenance = self.provenance.clone().with_input(cpf);
        }
    }
    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
    fn as_any(&self) -> &dyn Any {
        self
    }
    fn as_any_mut(&mut self) -> &mut dyn Any {
        self
    }
}
