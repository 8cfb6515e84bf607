//! Long records in zero field: offset drift, noise, its Allan deviation, what the offset follows, and where the data stop.
//!
//! While the file is read a [`Record`] keeps, in bounded memory, the sums of equal bins, periodograms of the full sample rate, and the
//! record at a 64th of that rate or less for the low frequencies. Drift and coefficients are least-squares fits to at most
//! [`ROWS`] means; what slow noise does to them is told from inside the means and between them
//! ([`crate::fit::noise`]). Spectrum and Allan deviation are those of [`crate::fit::spectrum`] and [`crate::fit::allan`].

mod cleaned;
mod drift;
mod noise;
mod record;
mod refusal;
mod rows;
mod spikes;
mod stops;

pub use cleaned::Cleaned;
pub use noise::STATED_HZ;
pub use record::{BLOCK, CHUNK, MOST_FILLED, Record};
pub use refusal::{LEAST_SAMPLES, NullError};
pub use rows::{Level, ROWS, Row};

use crate::data::calibration::Sensitivities;
use crate::data::envelope;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::run::{Kind, Run, Setting};
use crate::data::units::COMPONENTS;
use crate::data::zero_field::{ChannelDependence, RecordExtent, ScaledZeroField, ZeroFieldFound};
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::record::conditions::{self, Temperatures};
use crate::record::known::Known;
use drift::Fitter;
use noise::Noise;
use record::Kept;
use rows::{channel_rows, octaves, rows, unit};
use serde::{Deserialize, Serialize};
use spikes::Spikes;
use stops::stops;

/// How a zero-field run is analysed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Order of the drift, 0 to 3.
    pub order: usize,
    /// Linear calibration whose sensitivities give the results in nT as well, with its file.
    #[serde(skip)]
    pub cpf: Option<(Input, Sensitivities)>,
    /// Effects that are known: taken off the samples before anything is made of them.
    #[serde(skip)]
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self { order: 1, cpf: None, model: None }
    }
}

/// The result of a zero-field run. Values that are not determined are nan.
#[derive(Clone, Debug)]
pub struct Null {
    /// What was found.
    pub found: ZeroFieldFound,
    /// The means with the drift.
    pub rows: Vec<Row>,
    /// Mean of every channel over every row; NaN where it has no reading.
    pub channels: Vec<(String, Vec<f64>)>,
    /// Temperatures.
    pub temperatures: Temperatures,
    /// Extent of the raw data.
    pub samples: Option<Vec<envelope::Column>>,
    /// Known effects that were taken off the samples.
    pub model: Option<ModelApplied>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

/// Analyses a zero-field run.
///
/// # Errors
/// Why the run has no result.
pub fn null(run: &Run, record: Record, instructions: &Instructions, options: &Options) -> Result<Null, NullError> {
    let span_s = check(run)?;
    if let Some((input, sensitivities)) = &options.cpf {
        sensitivities.must_fit(&input.path, &run.header)?;
    }
    let mut notes = Vec::new();
    let rate_hz = run.vectors.measured_rate_hz.unwrap_or(run.header.sample_rate_hz);
    let record = record.finish();
    let stop = stops(run, &record, span_s, rate_hz);
    for s in &stop {
        let text = format!("STOP {} from {:.1} to {:.1} s, {:.0} s", s.what, s.from_s, s.until_s, s.until_s - s.from_s);
        notes.push(Note::new(NoteKind::Data, text));
    }
    notes.extend(stuck(&record));
    notes.extend(record.spikes.map(spikes_left_out));
    let temperatures = Temperatures::of(run, instructions, span_s, &mut notes);

    let bin_s = record.bin_samples as f64 / rate_hz;
    let (mut rows, width) = rows(&record, span_s[0], bin_s);
    let octaves = octaves(&record.bins, width, bin_s, record.bin_samples);
    let fitter = Fitter { rows: &rows, octaves: &octaves };
    let drift = fitter.drift(options.order, 0.5 * (span_s[0] + span_s[1]), 0.5 * (span_s[1] - span_s[0]))?;
    let channels = channel_rows(run, &rows);
    let channel: Vec<ChannelDependence> =
        channels.iter().filter_map(|(name, values)| fitter.channel(name, unit(run, name), values)).collect();
    let sensor_channel = instructions.channels(&run.header).0;
    let main: Vec<&(String, Vec<f64>)> = channels
        .iter()
        .filter(|(name, _)| (*name == sensor_channel || name.starts_with("VAR")) && channel.iter().any(|c| c.name == *name))
        .collect();
    let together = if main.len() > 1 { fitter.together(&main) } else { None };
    notes.extend(drift.note);
    for (row, level) in rows.iter_mut().zip(drift.levels) {
        row.drift_ent = level;
    }

    let noise = Noise::of(&record, rate_hz);
    notes.extend(noise.notes(rate_hz));
    conditions::warn_of_run(&mut notes, run, instructions);
    let found = ZeroFieldFound {
        run: conditions::head(run, instructions, &temperatures),
        record: RecordExtent {
            samples: run.vectors.count - run.vectors.excluded,
            lost: run.vectors.lost,
            gaps: run.vectors.gap_count,
            bridged: record.filled,
            time_s: span_s,
            sample_rate_hz: rate_hz,
        },
        offset: drift.offset,
        density: noise.density,
        scaled: None,
        corner: noise.corner,
        line: noise.line,
        spectrum: noise.spectrum,
        allan: noise.allan,
        channel,
        together,
        stop,
    };
    let mut result = Null { found, rows, channels, temperatures, samples: None, model: None, notes };
    if let Some((input, sensitivities)) = &options.cpf {
        result.scale(&input.path, sensitivities);
    }
    Ok(result)
}

/// Components that give one reading all the time. Bins hold the sums of readings minus the first one.
fn stuck(record: &Kept) -> impl Iterator<Item = Note> {
    let still = |c: &usize| record.bins.iter().all(|bin| bin.sum[*c] == 0.0);
    (0..3).filter_map(move |c| {
        let text = match record.stills[c] {
            _ if still(&c) => {
                format!("component {} is stuck at {} enT: it has neither noise nor drift", COMPONENTS[c], record.reference[c])
            }
            // A stop of all three is told by itself.
            Some([from_s, until_s]) if record.frozen_s.is_none_or(|s| s != [from_s, until_s]) => {
                format!("component {} is stuck from {from_s:.1} to {until_s:.1} s", COMPONENTS[c])
            }
            _ => return None,
        };
        Some(Note::new(NoteKind::Stuck, text).about(COMPONENTS[c]).with_remedy("check the component and its wiring"))
    })
}

/// Samples that stand out of those beside them.
fn spikes_left_out(spikes: Spikes) -> Note {
    let Spikes { count, t_s, reading_ent: [x, y, z] } = spikes;
    let text = format!(
        "{count} samples that stand out of those beside them by more than noise does were left out, the first at {t_s:.3} s: {x}, {y}, {z} enT"
    );
    Note::new(NoteKind::Spikes, text)
}

/// First and last sample, s since the run's start, of a run that is a record in zero field.
fn check(run: &Run) -> Result<[f64; 2], NullError> {
    if run.header.kind != Kind::ZeroField {
        return Err(NullError::Kind(run.header.kind));
    }
    let applies = |s: &Setting| s.frequency_hz > 0.0 || s.field.0.iter().any(|b| *b != 0.0);
    if let Some(index) = run.settings.iter().position(applies) {
        return Err(NullError::Field(index + 1));
    }
    if run.settings.windows(2).any(|pair| pair[0].position != pair[1].position) {
        return Err(NullError::Positions);
    }
    let count = run.vectors.count - run.vectors.excluded;
    match run.vectors.span_s {
        Some(span_s) if count >= LEAST_SAMPLES => Ok(span_s),
        _ => Err(NullError::TooShort(count)),
    }
}

impl Null {
    /// Gives reading, drift and density in nT as well, with the sensitivities of a linear calibration; `name` is that of its file.
    pub fn scale(&mut self, name: &str, of: &Sensitivities) {
        self.notes.extend(of.of_another_temperature(name, &self.found.run));
        let each = |list: &[[f64; 3]]| list.iter().map(|ent| of.to_nt(ent)).collect();
        self.found.scaled = Some(ScaledZeroField {
            cpf: name.to_owned(),
            sigma: of.sigma_nt_per_ent,
            mean_nt: of.to_nt(&self.found.offset.mean_ent),
            mean_std_nt: of.to_nt(&self.found.offset.mean_std_ent),
            drift_nt_per_h: each(&self.found.offset.drift_ent_per_h),
            drift_std_nt_per_h: each(&self.found.offset.drift_std_ent_per_h),
            nt_per_root_hz: self.found.density.as_ref().map(|d| of.to_nt(&d.ent_per_root_hz)),
            std_nt_per_root_hz: self.found.density.as_ref().map(|d| of.to_nt(&d.std_ent_per_root_hz)),
        });
    }
}

#[cfg(test)]
mod tests;
