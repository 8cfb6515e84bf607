//! The response alone, from a table of amplitudes.

use super::amplitudes::DETECTED;
use super::response::respond;
use super::result::Freq;
use crate::data::frequency::{FrequencyFound, SineAmplitude};
use crate::data::note::{Note, NoteKind};
use crate::data::result::RunHead;
use crate::data::run::Location;
use crate::data::tables::AmplitudeRow;
use crate::record::conditions::Temperatures;

/// The response alone, from a table of amplitudes; `id` names it.
#[must_use]
pub fn from_table(rows: &[AmplitudeRow], id: &str) -> Freq {
    let mut measured: Vec<SineAmplitude> = rows
        .iter()
        .map(|row| SineAmplitude {
            frequency_hz: row.frequency_hz,
            b_ent: row.amplitude_ent,
            b_std_ent: row.std_ent,
            applied_nt: None,
            phase_deg: None,
            phase_std_deg: None,
            phase_counter: None,
            used: true,
            weight: [1.0; 3],
            // Without an uncertainty a positive amplitude is taken for one.
            detected: std::array::from_fn(|i| {
                row.amplitude_ent[i] > if row.std_ent[i].is_finite() { DETECTED * row.std_ent[i] } else { 0.0 }
            }),
            alias_hz: None,
            used_s: None,
            samples: None,
            remark: String::new(),
        })
        .collect();
    let head = RunHead {
        id: id.to_owned(),
        sensor: String::new(),
        mode: String::new(),
        location: Location::Centre,
        temperature_degc: None,
        coil_temperature_degc: None,
        campaign: "a table of amplitudes, without a campaign".to_owned(),
        start: None,
        configuration: String::new(),
        field_source: String::new(),
        coil_correction: None,
        earthfield_compensation: Vec::new(),
    };
    let text = "the table tells neither sensor, mode nor temperature, and no sampling frequency";
    let mut notes = vec![Note::new(NoteKind::Method, text)];
    let compared = vec![[true; 3]; measured.len()];
    let corner = respond(&mut measured, &compared, &mut notes);
    Freq {
        values: corner.values(),
        found: FrequencyFound { run: head, applied_nt: None, model: corner.response(), clock: None },
        corner,
        effects: None,
        amplitude: measured,
        stretches: Vec::new(),
        temperatures: Temperatures::default(),
        notes,
    }
}
