//! Offset measurements as files, figures and text.

use super::{Ingredients, PerRun, Refusal, RunResult, Shown};
use crate::data::across::CalibratedRun;
use crate::data::calibration::Sensitivities;
use crate::data::error::Finding;
use crate::data::note::{Note, Told};
use crate::data::plateau::{self, Accumulator, Plateau};
use crate::data::provenance::Input;
use crate::data::result::{RowsUsed, RunHead};
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{OffsetConvention, Opf};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::offset::{Offset, Options, offset};
use crate::model::facility::Facility;
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::record::known::Known;
use crate::show;
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "offset";
    const COMMAND: &'static str = "offset";
    const KIND: Kind = Kind::Offset;
    const STEM: &'static str = "OFFSET";
    const TAKES_MODEL: bool = true;
    type Sink = Accumulator;
    type Result = Offset;

    fn sink(&self, _figures: bool) -> Self::Sink {
        Accumulator::default()
    }

    fn analyse(&self, run: &Run, accumulator: Self::Sink, campaign: &Campaign) -> Result<Offset, Refusal> {
        let plateaus = plateau::of_run(run, accumulator, self.cut);
        offset(run, &plateaus, &campaign.file.instructions, self).map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })
    }

    fn inputs(&self) -> Vec<Input> {
        let facility = self.facility.iter().map(|f| f.input.clone());
        let model = self.model.iter().map(|m| m.input.clone());
        self.cpf.iter().map(|(input, _)| input.clone()).chain(facility).chain(model).collect()
    }

    fn model(&self) -> Option<&Known> {
        self.model.as_ref()
    }

    fn with_corrections(self, facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self { facility: facility.cloned(), model: model.cloned(), ..self }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { cpf: files.sensitivities()?, facility: files.facility()?, model: files.model()?, ..self })
    }
}

/// An offset measurement as `--json` prints it.
#[derive(Serialize)]
struct OffsetView<'a> {
    parameters: Opf,
    plateaus: &'a [Plateau],
    temperatures: &'a Temperatures,
}

impl RunResult for Offset {
    type Analysis = Options;
    type Parameters = Opf;
    const NAME: &'static str = "Offset calculation";
    const TITLE: &'static str = "Offset calculation";
    const HEADLINE: fn(&Self) -> String = show::offset::headline;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::offset::figures, sections: show::offset::sections, summary: show::offset::summary };
    const SCALE: Option<fn(&mut Self, &str, &Sensitivities)> = Some(Offset::scale);

    fn head(&self) -> &RunHead {
        &self.found.run
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn rows(&self) -> Option<RowsUsed> {
        let quality = &self.found.quality;
        Some(RowsUsed::of_settings(quality.blocks_used, quality.blocks_total, &self.dropped))
    }
    fn has_type_b(&self) -> bool {
        self.found.of_facility.is_some()
    }
    fn is_partial(&self) -> bool {
        !self.found.refused.is_empty()
    }
    fn point(&self) -> Option<CalibratedRun> {
        Some((&self.parameters()).into())
    }
    fn parameters(&self) -> Opf {
        let convention = OffsetConvention::default();
        Opf {
            values: self.values,
            convention: if self.model.is_some() { convention.without_effects() } else { convention },
            std: Some(self.values.std()),
            found: self.found.clone(),
            conditions: self.temperatures.conditions.clone(),
            facility: self.facility.clone(),
            model: self.model.clone(),
            dropped: self.dropped.clone(),
            told: Told::of(&self.notes),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        OffsetView { parameters: self.parameters(), plateaus: &self.plateaus, temperatures: &self.temperatures }
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[Self::Parameters]) -> Option<(&'static str, Table)> {
        Some(("offsets and residual fields enT, sensor axes; coil residual nT, coil axes", show::offset::parameter_table(all)))
    }
}
