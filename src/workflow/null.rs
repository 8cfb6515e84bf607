//! Zero-field runs as files, figures and text.

use super::{Ingredients, PerRun, Refusal, RunReport, RunResult};
use crate::data::envelope::Envelope;
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{Body, Npf, NullConvention};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::null::{Null, Options, Record, Row, null};
use crate::plot::{self, Named};
use crate::record::conditions::Temperatures;
use crate::show::{self, document::Section};
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "null";
    const COMMAND: &'static str = "null";
    const KIND: Kind = Kind::ZeroField;
    const STEM: &'static str = "NULL";
    type Sink = (Record, Option<Envelope>);
    type Result = Null;

    fn sink(&self, figures: bool) -> Self::Sink {
        (Record::default(), figures.then(Envelope::default))
    }

    fn analyse(&self, run: &Run, (record, envelope): Self::Sink, campaign: &Campaign) -> Result<Null, Refusal> {
        let mut result = null(run, record, &campaign.file.instructions, self)
            .map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })?;
        result.samples = envelope.map(|e| e.columns());
        Ok(result)
    }

    fn inputs(&self) -> Vec<Input> {
        self.cpf.iter().map(|(input, _)| input.clone()).collect()
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { cpf: files.sensitivities()?, ..self })
    }
}

impl RunReport for Null {
    fn head(&self) -> &RunHead {
        &self.found.run
    }
    fn notes(&self) -> Vec<Note> {
        self.notes.clone()
    }
    fn figures(&self) -> Vec<Named> {
        plot::null::figures(self)
    }
    fn title(&self) -> String {
        format!("Offset drift and noise in zero field, run {}", self.found.run.id)
    }
    fn sections(&self) -> Vec<Section> {
        show::null::sections(self, &self.parameters().file_name())
    }
    fn analysis(&self) -> &'static str {
        "Zero-field measurement"
    }
    fn headline(&self) -> String {
        show::null::headline(self)
    }
    fn summary(&self) -> String {
        show::null::summary(self)
    }
}

/// A zero-field run as `--json` prints it.
#[derive(Serialize)]
struct NullView<'a> {
    parameters: Npf,
    rows: &'a [Row],
    channels: &'a [(String, Vec<f64>)],
    temperatures: &'a Temperatures,
}

impl RunResult for Null {
    type Parameters = Npf;

    fn parameters(&self) -> Npf {
        Npf {
            convention: NullConvention::default(),
            found: self.found.clone(),
            conditions: self.temperatures.conditions.clone(),
            warnings: self.notes.iter().map(Note::to_string).collect(),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        NullView { parameters: self.parameters(), rows: &self.rows, channels: &self.channels, temperatures: &self.temperatures }
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[&Self]) -> (&'static str, Table) {
        ("readings enT, sensor axes; densities enT/sqrt(Hz)", show::null::parameter_table(all))
    }
}
