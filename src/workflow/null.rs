//! Zero-field runs as files, figures and text.

use super::{PerRun, Refusal, RunReport, RunResult, notes_of};
use crate::data::envelope::Envelope;
use crate::data::note::Note;
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::Npf;
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::null::{Null, Options, Record, null};
use crate::plot::{self, Named};
use crate::show::{self, document::Section};
use serde::Serialize;

impl PerRun for Options {
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

    fn recorded(&self, _result: &Null) -> String {
        let cpf = self.cpf.as_ref().map_or_else(String::new, |(input, _)| format!(" --cpf {}", input.path));
        format!(" --order {}{cpf}", self.order)
    }
}

impl RunReport for Null {
    fn head(&self) -> &RunHead {
        &self.parameters.run
    }
    fn notes(&self) -> Vec<Note> {
        notes_of(&self.parameters.warnings)
    }
    fn figures(&self) -> Vec<Named> {
        plot::null::figures(self)
    }
    fn title(&self) -> String {
        format!("Offset drift and noise in zero field, run {}", self.parameters.run.id)
    }
    fn sections(&self) -> Vec<Section> {
        show::null::sections(self)
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

impl RunResult for Null {
    type Parameters = Npf;

    fn parameters(&self) -> Npf {
        self.parameters.clone()
    }
    fn view(&self) -> impl Serialize + '_ {
        self
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[&Self]) -> (&'static str, Table) {
        ("readings enT, sensor axes; densities enT/sqrt(Hz)", show::null::parameter_table(all))
    }
}
