//! Zero-field runs as files, figures and text.

use super::{Ingredients, PerRun, Refusal, RunResult, Shown};
use crate::data::calibration::Sensitivities;
use crate::data::envelope::Envelope;
use crate::data::error::Finding;
use crate::data::note::{Note, Told};
use crate::data::provenance::Input;
use crate::data::result::RunHead;
use crate::data::run::{Kind, Run};
use crate::files::campaign::Campaign;
use crate::files::parameter::{Npf, NullConvention};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::null::{Null, Options, Record, Row, null};
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::show;
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

/// A zero-field run as `--json` prints it.
#[derive(Serialize)]
struct NullView<'a> {
    parameters: Npf,
    rows: &'a [Row],
    channels: &'a [(String, Vec<f64>)],
    temperatures: &'a Temperatures,
}

impl RunResult for Null {
    type Analysis = Options;
    type Parameters = Npf;
    const NAME: &'static str = "Zero-field measurement";
    const TITLE: &'static str = "Offset drift and noise in zero field";
    const HEADLINE: fn(&Self) -> String = show::null::headline;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::null::figures, sections: show::null::sections, summary: show::null::summary };
    const SCALE: Option<fn(&mut Self, &str, &Sensitivities)> = Some(Null::scale);

    fn head(&self) -> &RunHead {
        &self.found.run
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn parameters(&self) -> Npf {
        Npf {
            convention: NullConvention::default(),
            found: self.found.clone(),
            conditions: self.temperatures.conditions.clone(),
            told: Told::of(&self.notes),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        NullView { parameters: self.parameters(), rows: &self.rows, channels: &self.channels, temperatures: &self.temperatures }
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[Self::Parameters]) -> Option<(&'static str, Table)> {
        Some(("readings enT, sensor axes; densities enT/sqrt(Hz)", show::null::parameter_table(all)))
    }
}
