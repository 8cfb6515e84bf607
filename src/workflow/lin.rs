//! Linear calibrations as files, figures and text.

use super::{Ingredients, PerRun, Refusal, RunReport, RunResult};
use crate::data::envelope::Envelope;
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::plateau::{self, Accumulator};
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{Body, Convention, Cpf};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::lin::{Block, Lin, Options, lin};
use crate::plot::{self, Named};
use crate::record::conditions::Temperatures;
use crate::show::{self, document::Section};
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "lin";
    const COMMAND: &'static str = "lin";
    const KIND: Kind = Kind::Linearity;
    const STEM: &'static str = "LIN";
    type Sink = (Accumulator, Option<Envelope>);
    type Result = Lin;

    fn sink(&self, figures: bool) -> Self::Sink {
        (Accumulator::default(), figures.then(Envelope::default))
    }

    fn analyse(&self, run: &Run, (accumulator, envelope): Self::Sink, campaign: &Campaign) -> Result<Lin, Refusal> {
        let plateaus = plateau::of_run(run, accumulator, self.settling, self.least_coverage);
        let mut result = lin(run, &plateaus, &campaign.file.instructions, self)
            .map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })?;
        result.samples = envelope.filter(|_| run.blocks.is_empty()).map(|e| e.columns());
        Ok(result)
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| &f.input);
        let linearisation = self.linearisation.iter().map(|l| &l.input);
        facility.chain(linearisation).chain(self.model.iter().map(|m| &m.input)).cloned().collect()
    }

    fn settled(&self, result: &Lin) -> Self {
        Self { trend_order: Some(result.calibration.offset.trend_order), ..self.clone() }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { facility: files.facility()?, linearisation: files.linearisation()?, model: files.model()?, ..self })
    }
}

impl RunReport for Lin {
    fn head(&self) -> &RunHead {
        &self.calibration.run
    }
    fn notes(&self) -> Vec<Note> {
        self.notes.clone()
    }
    fn figures(&self) -> Vec<Named> {
        plot::lin::figures(self)
    }
    fn title(&self) -> String {
        format!("Calibration on 3 linear axes, run {}", self.calibration.run.id)
    }
    fn sections(&self) -> Vec<Section> {
        show::lin::sections(self, &self.parameters().file_name())
    }
    fn analysis(&self) -> &'static str {
        "DC-analysis"
    }
    fn headline(&self) -> String {
        show::lin::headline(self)
    }
    fn summary(&self) -> String {
        show::lin::summary(self)
    }
}

/// A linear calibration as `--json` prints it.
#[derive(Serialize)]
struct LinView<'a> {
    parameters: Cpf,
    blocks: &'a [Block],
    temperatures: &'a Temperatures,
}

impl RunResult for Lin {
    type Parameters = Cpf;

    fn parameters(&self) -> Cpf {
        let convention = if self.linearisation.is_some() { Convention::linearised() } else { Convention::default() };
        Cpf {
            convention: if self.model.is_some() { convention.without_effects() } else { convention },
            calibration: self.calibration.clone(),
            conditions: self.temperatures.conditions.clone(),
            facility: self.facility.clone(),
            linearisation: self.linearisation.clone(),
            model: self.model.clone(),
            dropped: self.dropped.clone(),
            warnings: self.notes.iter().map(Note::to_string).collect(),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        LinView { parameters: self.parameters(), blocks: &self.blocks, temperatures: &self.temperatures }
    }
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        let id = &self.calibration.run.id;
        let readings = if self.linearisation.is_some() { "linearised readings" } else { "readings" };
        let note = format!(
            "calfit lin, run {id}: one row per block; fields nT, coil axes; {readings} enT, sensor axes; times s since the run's start"
        );
        vec![("LIN_BLOCKS", note, show::lin::block_table(self))]
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[&Self]) -> (&'static str, Table) {
        ("readings enT, sensor axes; sensitivities nT/enT; angles in degrees", show::lin::parameter_table(all))
    }
}
