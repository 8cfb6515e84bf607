//! Sampling frequency and frequency response from sines of known frequency (BC-MAG-TR-0085 section 3.6, mathematics section 3).
//!
//! The facility clock is the reference: a sine of frequency f has the phase `2π f n / f_s` at sample counter n. One `f_s` per component
//! follows from the phase progress within all settings together; frequencies above half the sampling frequency are seen as aliases
//! and tell it best. Stretches that no sine of the setting's frequency describes are left out, instead of letting them lower the
//! amplitude.

mod amplitudes;
mod applied;
mod clock;
mod effects;
mod moving;
mod rates;
mod referred;
mod refusal;
mod response;
mod result;
mod rounding;
mod samples;
mod table;
mod tones;

pub use refusal::FreqError;
pub use result::{Freq, Stretch};
pub use samples::Sines;
pub use table::from_table;

use crate::data::frequency::{FrequencyFound, FrequencyValues, SineAmplitude};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Settling;
use crate::data::run::{Kind, Run};
use crate::model::applied::ModelApplied;
use crate::model::campaign::Instructions;
use crate::record::conditions::{self, Temperatures};
use crate::record::known::Known;
use crate::record::known::in_sines::{InSines, Responses};
use crate::record::screens;
use amplitudes::amplitudes;
use applied::Applied;
use clock::Clock;
use effects::{take_off, widen};
use response::respond;
use serde::{Deserialize, Serialize};

/// How a frequency analysis is made.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Options {
    /// Time left out after a change of frequency.
    #[serde(rename = "settling_s")]
    pub settling: Settling,
    /// Go on when the amplitudes are far from those that were applied.
    #[serde(skip_serializing_if = "std::ops::Not::not")]
    pub allow_gain: bool,
    /// Effects that are known: taken off the sines before the response is fitted.
    #[serde(skip)]
    pub model: Option<Known>,
}

impl Default for Options {
    fn default() -> Self {
        Self { settling: Settling::Found, allow_gain: false, model: None }
    }
}

/// Sampling frequency, amplitudes and response of one run.
///
/// # Errors
/// [`FreqError`]: the run is refused. Single frequencies are refused in the result.
pub fn freq(run: &Run, sines: &Sines, instructions: &Instructions, options: &Options) -> Result<Freq, FreqError> {
    if run.header.kind != Kind::Frequency {
        return Err(FreqError::Kind(run.header.kind));
    }
    let mut notes: Vec<Note> = Vec::new();
    let known = options.model.as_ref();
    let known = known.map_or_else(InSines::default, |m| InSines::new(m, run, Responses::OfTheInstrument, &mut notes));
    let applied = Applied::of(run, sines, known)?;
    notes.extend(applied.notes.iter().cloned());
    let (tones, rough_hz) = applied.tones(run, options.settling)?;
    let rates = applied.rates(&tones, rough_hz)?;
    let clock = Clock::of(&rates);

    let (mut measured, jumps) = amplitudes(&tones, &applied.records, &clock);
    for (part, setting) in measured.iter_mut().zip(&applied.settings) {
        part.frequency_hz = setting.frequency_hz;
        // A sine of which nothing is left has that for a reason, and not its missing samples.
        if let Some(because) = run.excluded_because_at(setting).filter(|_| part.used_s.is_none()) {
            part.remark = format!("left out by hand: {because}");
        }
        take_off(&applied.known, part);
    }
    let modulus = |values: [f64; 3]| values.iter().filter(|v| v.is_finite()).map(|v| v * v).sum::<f64>().sqrt();
    let pairs = measured.iter().zip(&applied.settings).map(|(a, s)| (modulus(s.field.0), modulus(a.b_ent)));
    screens::judge(screens::amplitude(pairs), options.allow_gain, &mut notes)?;
    let referred = referred::refer(&mut measured, &applied.settings);
    notes.extend(referred.notes);
    notes.extend(clock.notes(&rates, &applied.settings));
    notes.extend(refusals_and_damage(&measured));
    notes.extend(jumps);

    let temperatures = Temperatures::of(run, instructions, span_s(&measured), &mut notes);
    conditions::warn_of_run(&mut notes, run, instructions);
    let stretches = measured.iter().zip(&applied.settings).map(|(a, s)| Stretch { setting: *s, used_s: a.used_s }).collect();
    let corner = respond(&mut measured, &referred.compared, &mut notes);
    let course = moving::course(&temperatures.sensor, temperatures.moved_k().is_none());
    let f_3db_model_degc =
        course.and_then(|course| temperatures.beside_the_mean(moving::of_corners(&corner, &measured, &course)));
    notes.extend(temperatures.moved_k().map(|range_k| moving::note(range_k, f_3db_model_degc.as_ref())));
    let f_3db_model_std_hz = widen(&applied.known, &mut measured, &corner);
    // The sampling frequency holds where the run tells it best.
    let moved = 1.0 + applied.known.clock(clock.centre_s + applied.begin_s(clock.mean_hz));
    let effects = options.model.as_ref().map(|model| ModelApplied {
        file: model.input.path.clone(),
        effect: applied.known.applied(),
        left_out: applied.known.left_out.clone(),
    });
    Ok(Freq {
        values: FrequencyValues { f_3db_model_std_hz, f_3db_model_degc, ..clock.values(moved, &corner) },
        found: FrequencyFound {
            run: conditions::head(run, instructions, &temperatures),
            applied_nt: referred.applied_nt,
            model: corner.response(),
            clock: Some(clock.drift(applied.known.moves_clock())),
        },
        corner,
        effects,
        amplitude: measured,
        stretches,
        temperatures,
        notes,
    })
}

/// First and last used time of all sines, s since the run's start.
fn span_s(measured: &[SineAmplitude]) -> [f64; 2] {
    let span = |join: fn(f64, f64) -> f64, end: usize| {
        measured.iter().filter_map(|a| a.used_s).map(|s| s[end]).reduce(join).unwrap_or_default()
    };
    [span(f64::min, 0), span(f64::max, 1)]
}

/// Frequencies that were refused, then those of which a part was left out.
fn refusals_and_damage(measured: &[SineAmplitude]) -> Vec<Note> {
    let about = |a: &SineAmplitude| format!("{} Hz", a.frequency_hz);
    let refused = measured
        .iter()
        .filter(|a| a.used_s.is_none())
        .map(|a| Note::new(NoteKind::Data, format!("{} Hz was refused: {}", a.frequency_hz, a.remark)).about(about(a)));
    let damaged = measured
        .iter()
        .filter(|a| a.used_s.is_some() && !a.remark.is_empty())
        .map(|a| Note::new(NoteKind::Data, format!("{} Hz: {}", a.frequency_hz, a.remark)).about(about(a)));
    refused.chain(damaged).collect()
}
