//! Parts of a periodic signal that were left out of the means of the plateaus as if they were spikes.

use super::Inside;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateaus;
use crate::model::effects::in_samples::InSamples;

/// Spikes are no more than this part of all samples; where there are more beside a periodic signal, they are parts of it.
const FEW: f64 = 0.005;

/// What is to be known where means of the plateaus are without parts of a periodic signal.
pub(in crate::diagnose) fn cut(plateaus: &Plateaus, inside: &[Inside]) -> Option<Note> {
    let periodic = inside.iter().find(|found| found.effect.in_samples().is_some_and(InSamples::is_periodic))?;
    let spikes: u64 = plateaus.list.iter().map(|p| p.spike_samples).sum();
    let used: u64 = plateaus.list.iter().filter_map(|p| p.count).sum();
    let is_cut = spikes as f64 > FEW * (spikes + used) as f64;
    is_cut.then(|| {
        let text = format!(
            "{spikes} samples that stand far off their plateaus were left out of the means as spikes, and {} is there: the means have other parts of it than are \
             taken off them, and nothing that is found in them is certain",
            periodic.effect
        );
        Note::new(NoteKind::Data, text).with_remedy("measure without it, or take it off the samples first")
    })
}
