//! The response of the instrument, fitted to the amplitudes.

use crate::data::frequency::SineAmplitude;
use crate::data::note::{Note, NoteKind};
use crate::data::units::COMPONENTS;
use crate::measure::corner::{self, Amplitude, Corner};

/// Weight in the response fit from which an amplitude counts as used.
const USED: f64 = 0.5;

fn add_remark(part: &mut SineAmplitude, remark: String) {
    part.remark = if part.remark.is_empty() { remark } else { format!("{}; {remark}", part.remark) };
}

/// Fits the response to the amplitudes.
pub(super) fn respond(measured: &mut [SineAmplitude], notes: &mut Vec<Note>) -> Corner {
    let table: Vec<Amplitude> = measured
        .iter()
        .map(|a| Amplitude {
            frequency_hz: a.frequency_hz,
            // What is not detected is no amplitude, and a fit of noise would find a corner in it.
            amplitude_ent: std::array::from_fn(|i| if a.detected[i] { a.b_ent[i] } else { f64::NAN }),
            std_ent: a.b_std_ent,
            usable: a.used && a.detected.contains(&true),
        })
        .collect();
    let corner = corner::corner(&table, &corner::Options::default());
    for (row, part) in measured.iter_mut().enumerate() {
        part.used &= part.detected.contains(&true);
        part.weight = std::array::from_fn(|i| {
            let fitted = corner.components[i].model.as_ref().and_then(|m| m.weight.get(row)).copied();
            fitted.unwrap_or(f64::from(u8::from(part.used)))
        });
        let outlying: Vec<&str> =
            (0..3).filter(|i| part.used && part.detected[*i] && part.weight[*i] < USED).map(|i| COMPONENTS[i]).collect();
        if !outlying.is_empty() {
            add_remark(part, format!("{} does not follow the response and has little weight in it", outlying.join(", ")));
        }
        part.used = part.used && (0..3).all(|i| !part.detected[i] || part.weight[i] >= USED);
        let silent: Vec<&str> =
            (0..3).filter(|i| part.b_ent[*i].is_finite() && !part.detected[*i]).map(|i| COMPONENTS[i]).collect();
        if !silent.is_empty() {
            add_remark(part, format!("not detected in {}", silent.join(", ")));
        }
    }
    for (name, component) in COMPONENTS.into_iter().zip(&corner.components) {
        let reasons = [(&component.igep_refusal, "by interpolation"), (&component.model_refusal, "by a model")];
        for (refusal, how) in reasons {
            if let Some(refusal) = refusal {
                let text = format!("{name} has no -3 dB frequency {how}: {refusal}");
                notes.push(Note::new(NoteKind::Method, text).about(name));
            }
        }
    }
    corner
}
