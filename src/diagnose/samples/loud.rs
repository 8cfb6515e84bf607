//! Plateaus inside which the samples scatter far more than inside the others: something came and went that is no effect of all the run.

use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Plateau, Plateaus};
use crate::data::units::{COMPONENTS, first_times};
use crate::fit::statistics::{median, robust_std};

/// Fewer plateaus, or samples inside them, tell no usual scatter.
const FEWEST: usize = 12;
const FEWEST_SAMPLES: u64 = 8;
/// Their logarithms of the variance are so many robust standard deviations from the usual one.
const FAR_OUT: f64 = 8.0;
/// So many are told one by one.
const MOST_TOLD: usize = 6;

/// Says where they are. Single spikes, which are left out of the samples, are told elsewhere.
pub fn loud(plateaus: &Plateaus) -> Vec<Note> {
    let is_told = |p: &&Plateau| p.dropped.is_none() && p.spike_samples == 0 && p.count.is_some_and(|n| n >= FEWEST_SAMPLES);
    let usable: Vec<&Plateau> = plateaus.list.iter().filter(is_told).collect();
    let of_axis = |axis: usize| {
        let logarithms: Vec<(f64, &Plateau)> =
            usable.iter().filter_map(|p| Some((2.0 * p.std_ent?[axis].ln(), *p))).filter(|(v, _)| v.is_finite()).collect();
        if logarithms.len() < FEWEST {
            return None;
        }
        let usual = median(&mut logarithms.iter().map(|(v, _)| *v).collect::<Vec<f64>>());
        // No estimate of a variance is better than that of independent samples.
        let fewest = logarithms.iter().filter_map(|(_, p)| p.count).min().unwrap_or(FEWEST_SAMPLES);
        let std = robust_std(logarithms.iter().map(|(v, _)| v - usual)).max((2.0 / (fewest - 1) as f64).sqrt());
        let mut far: Vec<(f64, &Plateau)> = logarithms.into_iter().filter(|(v, _)| v - usual > FAR_OUT * std).collect();
        far.sort_by(|a, b| b.0.total_cmp(&a.0));
        let most = (0.5 * (far.first()?.0 - usual)).exp();
        let name = COMPONENTS[axis];
        let text = format!(
            "the samples of {name} inside the plateaus at {} scatter by up to {most:.1} times as much as inside the others: a disturbance of a part of the \
             run, which no effect explains",
            first_times(far.iter().map(|(_, p)| p.t_s()), MOST_TOLD)
        );
        Some(
            Note::new(NoteKind::Data, text)
                .about(name)
                .with_remedy("look at the samples there, and leave the part out with --exclude"),
        )
    };
    (0..3).filter_map(of_axis).collect()
}
