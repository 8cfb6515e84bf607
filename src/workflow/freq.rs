//! Frequency measurements as files, figures and text.

use super::{Ingredients, Made, PerRun, Refusal, RunResult, Shown};
use crate::data::across::CalibratedRun;
use crate::data::error::Finding;
use crate::data::frequency::SineAmplitude;
use crate::data::note::{Note, Told};
use crate::data::provenance::{Input, Provenance, Role};
use crate::data::recipe::Recipe;
use crate::data::result::{RowsUsed, RunHead};
use crate::data::run::{Kind, Run};
use crate::data::tables::AmplitudeRow;
use crate::files::amplitudes;
use crate::files::campaign::Campaign;
use crate::files::parameter::{Fpf, FrequencyConvention};
#[cfg(feature = "tables")]
use crate::files::table::Table;
use crate::measure::corner::Corner;
use crate::measure::freq::{Freq, Options, Sines, Stretch, freq, from_table};
use crate::model::campaign::Instructions;
use crate::model::facility::Facility;
use crate::plot;
use crate::record::conditions::Temperatures;
use crate::record::known::Known;
use crate::show;
use serde::Serialize;
use std::path::Path;

impl PerRun for Options {
    const ANALYSIS: &'static str = "freq";
    const COMMAND: &'static str = "freq";
    const KIND: Kind = Kind::Frequency;
    const STEM: &'static str = "FREQ";
    const TAKES_MODEL: bool = true;
    // All samples of the sines, and what is cut from them.
    const MEMORY_PER_BYTE: u64 = 4;
    type Sink = Sines;
    type Result = Freq;

    fn sink(&self, _figures: bool) -> Self::Sink {
        Sines::default()
    }

    fn analyse(&self, run: &Run, sines: Self::Sink, campaign: &Campaign) -> Result<Freq, Refusal> {
        freq(run, &sines, &campaign.file.instructions, self).map_err(|e| Refusal { rule: e.to_string(), remedy: e.remedy() })
    }

    fn inputs(&self) -> Vec<Input> {
        self.model.iter().map(|m| m.input.clone()).collect()
    }

    fn model(&self) -> Option<&Known> {
        self.model.as_ref()
    }

    fn with_corrections(self, _facility: Option<&Facility>, model: Option<&Known>) -> Self {
        Self { model: model.cloned(), ..self }
    }

    fn with_files(self, files: &Ingredients) -> Result<Self, Finding> {
        Ok(Self { model: files.model()?, ..self })
    }
}

/// The response from a table of amplitudes; its name without `freq_` is the run id. Warnings go to `findings`.
///
/// # Errors
/// The table cannot be read, or its name cannot be a run id.
pub fn of_table(path: &Path, findings: &mut Vec<Finding>) -> Result<Made<Freq>, Finding> {
    let (rows, id, provenance) = amplitude_table("freq", path, findings)?;
    Ok(Made {
        result: from_table(&rows, &id),
        provenance,
        run: None,
        options: Options::default(),
        instructions: Instructions::default(),
        in_group: false,
    })
}

/// The rows of a table of amplitudes, its run id, and the provenance of what an analysis makes of it.
pub(super) fn amplitude_table(
    analysis: &str,
    path: &Path,
    findings: &mut Vec<Finding>,
) -> Result<(Vec<AmplitudeRow>, String, Provenance), Finding> {
    let (rows, digested) = amplitudes::read(path, findings)?;
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let stem = path.file_stem().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let id = stem.strip_prefix("freq_").unwrap_or(&stem);
    if !crate::files::ccr::run_id_is_safe(id) {
        return Err(Finding::error(&path.display().to_string(), "its name cannot be a run id", "rename it to freq_<run id>.csv")
            .found(id.as_bytes()));
    }
    let input = digested.input(name).with_role(Role::Amplitudes);
    let provenance = Provenance::new(Recipe::plain(analysis), vec![input]);
    Ok((rows, id.to_owned(), provenance))
}

/// A frequency measurement as `--json` prints it.
#[derive(Serialize)]
struct FreqView<'a> {
    parameters: Fpf,
    corner: &'a Corner,
    stretches: &'a [Stretch],
    temperatures: &'a Temperatures,
}

impl RunResult for Freq {
    type Analysis = Options;
    type Parameters = Fpf;
    const NAME: &'static str = "AC-analysis";
    const TITLE: &'static str = "Frequency measurements";
    const HEADLINE: fn(&Self) -> String = show::freq::headline;
    const SHOWN: Shown<Self> =
        Shown { figures: plot::freq::figures, sections: show::freq::sections, summary: show::freq::summary };

    fn head(&self) -> &RunHead {
        &self.found.run
    }
    fn notes(&self) -> &[Note] {
        &self.notes
    }
    fn rows(&self) -> Option<RowsUsed> {
        let (used, rejected): (Vec<&SineAmplitude>, Vec<&SineAmplitude>) = self.amplitude.iter().partition(|row| row.used);
        let reason = |row: &&SineAmplitude| if row.remark.is_empty() { "not detected".to_owned() } else { row.remark.clone() };
        Some(RowsUsed::new(used.len(), self.amplitude.len(), rejected.iter().map(reason)))
    }
    fn point(&self) -> Option<CalibratedRun> {
        Some((&self.parameters()).into())
    }
    fn parameters(&self) -> Fpf {
        Fpf {
            values: self.values.clone(),
            convention: FrequencyConvention::default(),
            found: self.found.clone(),
            effects: self.effects.clone(),
            amplitude: self.amplitude.clone(),
            conditions: self.temperatures.conditions.clone(),
            told: Told::of(&self.notes),
        }
    }
    fn view(&self) -> impl Serialize + '_ {
        FreqView {
            parameters: self.parameters(),
            corner: &self.corner,
            stretches: &self.stretches,
            temperatures: &self.temperatures,
        }
    }
    #[cfg(feature = "tables")]
    fn tables(&self) -> Vec<(&'static str, String, Table)> {
        let id = &self.found.run.id;
        let note = format!(
            "freq, run {id}: one row per applied frequency; amplitudes half peak to peak, enT, sensor axes; phases at phase_counter"
        );
        vec![("FREQ_AMPLITUDES", note, show::freq::amplitude_table(self))]
    }
    #[cfg(feature = "tables")]
    fn campaign_table(all: &[Self::Parameters]) -> Option<(&'static str, Table)> {
        Some(("frequencies in Hz", show::freq::parameter_table(all)))
    }
}
