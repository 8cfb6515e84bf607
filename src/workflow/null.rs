//! Zero-field runs as files, figures and text.

use super::{Desk, Failure, Ingredients, Job, PerRun, Refusal, RunResult, Shown, read};
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
use crate::measure::null::{Cleaned, Null, Options, Row, null};
use crate::model::facility::Facility;
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::record::known::{Known, OffSamples};
use crate::show;
use serde::Serialize;

impl PerRun for Options {
    const ANALYSIS: &'static str = "null";
    const COMMAND: &'static str = "null";
    const KIND: Kind = Kind::ZeroField;
    const STEM: &'static str = "NULL";
    const TAKES_MODEL: bool = true;
    type Sink = (Cleaned, Option<Envelope>);
    type Result = Null;

    fn sink(&self, figures: bool) -> Self::Sink {
        (Cleaned::default(), figures.then(Envelope::default))
    }

    fn sink_of(&self, job: &Job, desk: &Desk, two_threads: bool) -> Result<Self::Sink, Failure> {
        let (plain, envelope) = self.sink(desk.plots);
        let Some(known) = &self.model else { return Ok((plain, envelope)) };
        // Channels and temperatures stand behind the samples in the file, and what they say belongs into the samples.
        let (run, ()) = read(job, desk, two_threads, ())?;
        let mut notes = Vec::new();
        let effects = OffSamples::new(known, &run, &job.campaign.file.instructions, &mut notes);
        Ok((Cleaned::without(effects, notes), envelope))
    }

    fn analyse(&self, run: &Run, (cleaned, envelope): Self::Sink, campaign: &Campaign) -> Result<Null, Refusal> {
        let (record, taken_off) = cleaned.finish();
        let mut result = null(run, record, &campaign.file.instructions, self)
            .map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })?;
        result.samples = envelope.map(|e| e.columns());
        if let Some((model, notes)) = taken_off {
            result.model = Some(model);
            result.notes.extend(notes);
        }
        Ok(result)
    }

    fn inputs(&self) -> Vec<Input> {
        let model = self.model.iter().map(|m| m.input.clone());
        self.cpf.iter().map(|(input, _)| input.clone()).chain(model).collect()
    }

    fn model(&self) -> Option<&Known> {
        self.model.as_ref()
    }

    fn with_corrections(self, _facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self { model: model.cloned(), ..self }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { cpf: files.sensitivities()?, model: files.model()?, ..self })
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
        let convention = NullConvention::default();
        Npf {
            convention: if self.model.is_some() { convention.without_effects() } else { convention },
            found: self.found.clone(),
            conditions: self.temperatures.conditions.clone(),
            model: self.model.clone(),
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
