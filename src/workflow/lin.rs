//! Linear calibrations as files, figures and text.

use super::{PerRun, Refusal, RunReport, RunResult};
use crate::data::envelope::Envelope;
use crate::data::note::Note;
use crate::data::plateau::{self, Accumulator, Settling};
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

    fn recorded(&self, result: &Lin) -> String {
        let mut text = format!(" --order {}", result.calibration.offset.trend_order);
        for (axis, limit) in ["x", "y", "z"].into_iter().zip(self.max_field_nt) {
            if let Some(limit) = limit {
                text.push_str(&format!(" --max-field {axis}={limit}"));
            }
        }
        if self.robust {
            text.push_str(" --robust");
        }
        if let Some(facility) = &self.facility {
            text.push_str(&facility.recorded());
        }
        if let Some(linearisation) = &self.linearisation {
            text.push_str(&linearisation.recorded());
        }
        if let Some(model) = &self.model {
            text.push_str(&model.recorded());
        }
        text.push_str(&recorded_cut(self.settling, self.least_coverage));
        for (allowed, name) in [(self.allow_gain, "gain"), (self.allow_mismatch, "mismatch")] {
            if allowed {
                text.push_str(&format!(" --allow {name}"));
            }
        }
        text
    }
}

/// Options that say which part of a plateau is used.
pub(super) fn recorded_cut(settling: Settling, least_coverage: f64) -> String {
    let mut text = String::new();
    if let Settling::Given(s) = settling {
        text.push_str(&format!(" --settling {s}"));
    }
    if least_coverage != plateau::LEAST_COVERAGE {
        text.push_str(&format!(" --coverage {least_coverage}"));
    }
    text
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
