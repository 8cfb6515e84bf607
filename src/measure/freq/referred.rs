//! Amplitudes of sines that were not all applied alike.
//!
//! A response compares what a component reads at one frequency with what it reads at another. Sines of different amplitudes are referred to one,
//! by the fields that the run states; of sines along different directions a component sees different parts, which the run does not tell, so
//! that only those along one direction are compared.

use crate::data::frequency::SineAmplitude;
use crate::data::note::{Note, NoteKind};
use crate::data::run::Setting;
use crate::data::units::COMPONENTS;
use crate::fit::statistics::extremes;
use nalgebra::Vector3;

/// Directions with a larger cosine between them, of either sign, are the same: half a degree.
const SAME_DIRECTION: f64 = 0.99996;
/// Applied amplitudes that differ by more than this part are told.
const DIFFERENT: f64 = 1e-3;

/// What the amplitudes of a run refer to.
pub(super) struct Referred {
    /// Amplitude of the applied field, nT; `None` where the run states none.
    pub applied_nt: Option<f64>,
    /// Whether each amplitude is compared with the others, per component.
    pub compared: Vec<[bool; 3]>,
    /// What there is to say.
    pub notes: Vec<Note>,
}

/// Refers amplitudes to the median of the applied fields and says which of them can be compared.
pub(super) fn refer(measured: &mut [SineAmplitude], settings: &[Setting]) -> Referred {
    let applied_nt: Vec<f64> = settings.iter().map(|s| Vector3::from(s.field.0).norm()).collect();
    let mut sorted: Vec<f64> = applied_nt.iter().copied().filter(|nt| *nt > 0.0).collect();
    sorted.sort_by(f64::total_cmp);
    let Some(common_nt) = sorted.get(sorted.len() / 2).copied() else {
        return Referred { applied_nt: None, compared: vec![[true; 3]; measured.len()], notes: Vec::new() };
    };
    for (part, own_nt) in measured.iter_mut().zip(&applied_nt) {
        part.applied_nt = Some(*own_nt);
        // Without a field there is nothing to refer to, and nothing to compare.
        let factor = if *own_nt > 0.0 { common_nt / own_nt } else { 1.0 };
        part.b_ent = part.b_ent.map(|b| b * factor);
        part.b_std_ent = part.b_std_ent.map(|std| std * factor);
    }
    let mut notes = Vec::new();
    let [least, most] = extremes(sorted.iter().copied());
    if most > (1.0 + DIFFERENT) * least {
        let text = format!("the sines were applied with {least:.4} to {most:.4} nT; amplitudes are those at {common_nt:.4} nT");
        notes.push(Note::new(NoteKind::Method, text));
    }
    let directions = directions(settings, &applied_nt);
    let count = directions.iter().flatten().max().map_or(1, |last| last + 1);
    let told_by = [0, 1, 2].map(|i: usize| {
        let total = |direction: usize| -> f64 {
            let own = measured.iter().zip(&directions).filter(|(_, d)| **d == Some(direction));
            own.map(|(a, _)| a.b_ent[i]).filter(|b| b.is_finite()).sum()
        };
        (0..count).max_by(|a, b| total(*a).total_cmp(&total(*b)).then(b.cmp(a)))
    });
    let compared: Vec<[bool; 3]> = directions.iter().map(|own| told_by.map(|wanted| *own == wanted)).collect();
    if count > 1 {
        for (part, compared) in measured.iter_mut().zip(&compared) {
            let others: Vec<&str> = (0..3).filter(|i| !compared[*i] && part.used).map(|i| COMPONENTS[i]).collect();
            if !others.is_empty() {
                part.add_remark(&format!("along another direction than the sines that tell {}", others.join(", ")));
            }
        }
        let text = format!(
            "the sines are along {count} directions; each component is told by those of the direction along which it reads most"
        );
        notes.push(Note::new(NoteKind::Method, text));
    }
    Referred { applied_nt: Some(common_nt), compared, notes }
}

/// The direction of every setting, by number; `None` without a field.
fn directions(settings: &[Setting], applied_nt: &[f64]) -> Vec<Option<usize>> {
    let mut known: Vec<Vector3<f64>> = Vec::new();
    let of = |(setting, nt): (&Setting, &f64)| {
        if *nt <= 0.0 {
            return None;
        }
        let own = Vector3::from(setting.field.0) / *nt;
        known.iter().position(|other| other.dot(&own).abs() > SAME_DIRECTION).or_else(|| {
            known.push(own);
            Some(known.len() - 1)
        })
    };
    settings.iter().zip(applied_nt).map(of).collect()
}
