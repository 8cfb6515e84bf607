//! Offset measurements as files, figures and text.

use super::lin::recorded_cut;
use super::{PerRun, Refusal, RunReport, RunResult, notes_of};
use crate::data::note::Note;
use crate::data::plateau::{self, Accumulator};
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::Opf;
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::offset::{Offset, Options, offset};
use crate::plot::{self, Named};
use crate::record::conditions::apply_facility;
use crate::show::{self, document::Section};
use serde::Serialize;

impl PerRun for Options {
    const COMMAND: &'static str = "offset";
    const KIND: Kind = Kind::Offset;
    const STEM: &'static str = "OFFSET";
    type Sink = Accumulator;
    type Result = Offset;

    fn sink(&self, _figures: bool) -> Self::Sink {
        Accumulator::default()
    }

    fn analyse(&self, run: &Run, accumulator: Self::Sink, campaign: &Campaign) -> Result<Offset, Refusal> {
        let mut plateaus = plateau::of_run(run, accumulator, self.settling, self.least_coverage);
        let mut warnings: Vec<String> = Vec::new();
        let applied = self
            .facility
            .as_ref()
            .map(|f| apply_facility(&f.without_offset(), run, &campaign.file.instructions, &mut plateaus.list, &mut warnings))
            .transpose()
            .map_err(|e| Refusal { rule: e.to_string(), remedy: "correct the facility" })?;
        let mut result = offset(run, &plateaus, &campaign.file.instructions, self)
            .map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })?;
        result.parameters.facility = applied;
        result.parameters.warnings.extend(warnings);
        Ok(result)
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| f.input.clone());
        self.cpf.iter().map(|(input, _)| input.clone()).chain(facility).collect()
    }

    fn recorded(&self, _result: &Offset) -> String {
        let mut text = self.cpf.as_ref().map_or_else(String::new, |(input, _)| format!(" --cpf {}", input.path));
        if let Some(facility) = &self.facility {
            text.push_str(&facility.recorded());
        }
        text.push_str(&recorded_cut(self.settling, self.least_coverage));
        if self.allow_mismatch {
            text.push_str(" --allow mismatch");
        }
        text
    }
}

impl RunReport for Offset {
    fn head(&self) -> &RunHead {
        &self.parameters.run
    }
    fn notes(&self) -> Vec<Note> {
        notes_of(&self.parameters.warnings)
    }
    fn is_partial(&self) -> bool {
        !self.parameters.refused.is_empty()
    }
    fn figures(&self) -> Vec<Named> {
        plot::offset::figures(self)
    }
    fn title(&self) -> String {
        format!("Offset calculation, run {}", self.parameters.run.id)
    }
    fn sections(&self) -> Vec<Section> {
        show::offset::sections(self)
    }
    fn analysis(&self) -> &'static str {
        "Offset calculation"
    }
    fn headline(&self) -> String {
        show::offset::headline(self)
    }
    fn summary(&self) -> String {
        show::offset::summary(self)
    }
}

impl RunResult for Offset {
    type Parameters = Opf;

    fn parameters(&self) -> Opf {
        self.parameters.clone()
    }
    fn view(&self) -> impl Serialize + '_ {
        self
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[&Self]) -> (&'static str, Table) {
        ("offsets and residual fields enT, sensor axes; coil residual nT, coil axes", show::offset::parameter_table(all))
    }
}
