//! Linear calibrations as files, figures and text.

use super::{Ingredients, Made, PerRun, Refusal, RunResult, Shown};
use crate::data::across::CalibratedRun;
use crate::data::envelope::Envelope;
use crate::data::error::Finding;
use crate::data::note::{Note, Told};
use crate::data::plateau::{self, Accumulator};
use crate::data::provenance::Input;
use crate::data::result::{RowsUsed, RunHead};
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{Convention, Cpf};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::lin::{Block, Lin, Options, lin};
use crate::model::facility::Facility;
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::record::known::Known;
use crate::show;
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "lin";
    const COMMAND: &'static str = "lin";
    const KIND: Kind = Kind::Linearity;
    const STEM: &'static str = "LIN";
    const TAKES_MODEL: bool = true;
    type Sink = (Accumulator, Option<Envelope>);
    type Result = Lin;

    fn sink(&self, figures: bool) -> Self::Sink {
        (Accumulator::default(), figures.then(Envelope::default))
    }

    fn analyse(&self, run: &Run, (accumulator, envelope): Self::Sink, campaign: &Campaign) -> Result<Lin, Refusal> {
        let plateaus = plateau::of_run(run, accumulator, self.cut);
        let mut result = lin(run, &plateaus, &campaign.file.instructions, self)
            .map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })?;
        result.samples = envelope.filter(|_| run.blocks.is_empty()).map(|e| e.columns());
        Ok(result)
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| &f.input);
        let linearisation = self.linearisation.iter().map(|l| &l.input);
        let model = self.model.iter().map(|m| &m.input);
        let temperature = self.temperature.iter().map(|t| &t.input);
        facility.chain(linearisation).chain(model).chain(temperature).cloned().collect()
    }

    fn settled(&self, result: &Lin) -> Self {
        Self { trend_order: Some(result.calibration.offset.trend_order), ..self.clone() }
    }

    fn model(&self) -> Option<&Known> {
        self.model.as_ref()
    }

    fn with_corrections(self, facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self { facility: facility.cloned(), model: model.cloned(), ..self }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self {
            facility: files.facility()?,
            linearisation: files.linearisation()?,
            model: files.model()?,
            temperature: files.temperature()?,
            ..self
        })
    }
}

impl Made<Lin> {
    /// The run fitted once more with other options.
    ///
    /// # Errors
    /// The run is refused.
    pub fn again(&self, options: &Options) -> Result<Lin, Finding> {
        let before = &self.result;
        let Some(run) = &self.run else {
            return Err(Finding::error(&before.calibration.run.id, "was not kept for a second fit", "report this"));
        };
        let mut after = lin(run, &before.given, &self.instructions, options)
            .map_err(|e| Finding::error(&run.input.path, e.to_string(), e.remedy()))?;
        after.samples.clone_from(&before.samples);
        Ok(after)
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
    type Analysis = Options;
    type Parameters = Cpf;
    const NAME: &'static str = "DC-analysis";
    const TITLE: &'static str = "Calibration on 3 linear axes";
    const HEADLINE: fn(&Self) -> String = show::lin::headline;
    const SHOWN: Shown<Self> = Shown { figures: plot::lin::figures, sections: show::lin::sections, summary: show::lin::summary };

    fn head(&self) -> &RunHead {
        &self.calibration.run
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn has_type_b(&self) -> bool {
        self.calibration.of_facility.is_some()
    }
    fn rows(&self) -> Option<RowsUsed> {
        let quality = &self.calibration.quality;
        Some(RowsUsed::of_settings(quality.blocks_used, quality.blocks_total, &self.dropped))
    }
    fn name_in_group(&self) -> Option<String> {
        Some(self.parameters().thermal_file_name())
    }
    fn point(&self) -> Option<CalibratedRun> {
        Some((&self.parameters()).into())
    }
    fn parameters(&self) -> Cpf {
        let convention = Convention::new(self.has_type_b());
        let convention = if self.linearisation.is_some() { convention.linearised() } else { convention };
        let convention = if self.model.is_some() { convention.without_effects() } else { convention };
        Cpf {
            convention: if self.calibration.slopes.is_some() { convention.at_one_temperature() } else { convention },
            calibration: self.calibration.clone(),
            conditions: self.temperatures.conditions.clone(),
            facility: self.facility.clone(),
            linearisation: self.linearisation.clone(),
            model: self.model.clone(),
            dropped: self.dropped.clone(),
            told: Told::of(&self.notes),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        LinView { parameters: self.parameters(), blocks: &self.blocks, temperatures: &self.temperatures }
    }
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        let id = &self.calibration.run.id;
        let readings = if self.linearisation.is_some() { "linearised readings" } else { "readings" };
        let referred = match &self.calibration.slopes {
            Some(slopes) => format!(" referred to {} degC", slopes.at_degc),
            None => String::new(),
        };
        let note = format!(
            "lin, run {id}: one row per block; fields nT, coil axes; {readings}{referred} enT, sensor axes; times s since the run's start"
        );
        vec![("LIN_BLOCKS", note, show::lin::block_table(self))]
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[Self::Parameters]) -> Option<(&'static str, Table)> {
        Some(("readings enT, sensor axes; sensitivities nT/enT; angles in degrees", show::lin::parameter_table(all)))
    }
}
