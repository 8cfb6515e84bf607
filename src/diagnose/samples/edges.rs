//! Displaced edges: data and settings that step at different times, all of them or some.

use super::{Inside, interval_s, level, of_settings};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Displacement, Plateau, Plateaus};
use crate::data::units::{COMPONENTS, first_times};
use crate::diagnose::result::{Left, LeftLike};
use crate::fit::statistics::median;
use crate::model::effects::EffectRef;
use crate::model::effects::time_shift::{self, TimeShift};
use crate::record::prepared::{PreparedRun, Samples};
use rayon::prelude::*;

/// Least part of a setting that shows another level, in samples: one sample of it is what the low-pass of every sensor and the place of the samples
/// between the edges make.
const LEAST: f64 = 1.1;
/// Least displacement in standard uncertainties by the scatter of the edges.
const SIGNIFICANT: f64 = 6.0;

/// A step of this many standard deviations of a sample shows where its edge is, and a sample within this part of the step shows the level beyond it.
const CLEAR: f64 = 50.0;
const AT_LEVEL: f64 = 0.2;
/// An edge is looked for in half of a setting and so many samples beyond.
const BEYOND_HALF: usize = 3;
/// Edges agree within so many samples, or within this part of what they show.
const AGREE: f64 = 3.0;
const AGREE_PART: f64 = 0.1;
/// Fewest edges that agree among themselves and not with the others, and the part of all that they are.
const FEWEST: usize = 4;
const LEAST_PART: f64 = 0.03;
/// So many are told one by one.
const MOST_TOLD: usize = 6;

/// Whether data and settings step at different times.
#[must_use]
pub fn displaced(prepared: &PreparedRun, samples: &Samples) -> Option<Inside> {
    let interval_s = interval_s(samples)?;
    let Displacement { shift_s, std_s, scatter_s, shown_s, .. } = prepared.displacement?;
    let strength = shift_s.abs() / scatter_s;
    (shown_s > LEAST * interval_s && strength > SIGNIFICANT).then(|| Inside {
        values: vec![(1.0, std_s / shift_s.abs())],
        shape_std: vec![(time_shift::SHIFT.to_owned(), std_s)],
        strength,
        p_value: (-0.5 * strength * strength).exp().max(f64::MIN_POSITIVE),
        trials: 1,
        ..Inside::new(EffectRef::new(&TimeShift), time_shift::edges(shift_s))
    })
}

/// Edges of settings that stand elsewhere than the others, alike among themselves: a part of the table, or of the programme, is another one.
pub(in crate::diagnose) struct Apart {
    /// Begins of the settings that have them, s since the run's start.
    times_s: Vec<f64>,
    /// Edges that are to be seen.
    clear: usize,
    /// By how much these stand later than the others, s.
    later_s: f64,
    /// Whether they are those at the begins of settings.
    is_at_begin: bool,
    /// The component in which the field of the other setting differs most, the root mean square of this, enT, and the noise of a sample.
    axis: usize,
    step_ent: f64,
    noise_ent: f64,
}

impl Apart {
    /// Which edges these are.
    fn edges(&self) -> String {
        let ends = if self.is_at_begin { "begins" } else { "ends" };
        format!("{ends} of the settings that begin at {}", first_times(self.times_s.iter().copied(), MOST_TOLD))
    }

    /// The warning about them.
    pub fn note(&self) -> Note {
        let Self { times_s, clear, later_s, .. } = self;
        let beside = if *later_s > 0.0 { "later" } else { "earlier" };
        let text = format!(
            "{} of {clear} edges that are to be seen stand {:.2} s {beside} than the others, the {}: no displacement of all settings explains it",
            times_s.len(),
            later_s.abs(),
            self.edges()
        );
        Note::new(NoteKind::Mismatch, text).with_remedy(
            "compare the table of settings with the programme that ran, and leave out with --exclude what does not belong to it",
        )
    }

    /// The same as what is left.
    pub fn left(&self, prepared: &PreparedRun) -> Left {
        Left {
            place: format!("{}, {}", COMPONENTS[self.axis], self.edges()),
            rms_nt: self.step_ent * prepared.nt_per_ent[self.axis],
            times_noise: self.step_ent / self.noise_ent.max(f64::MIN_POSITIVE),
            like: LeftLike::Edges,
        }
    }
}

/// Where some edges stand elsewhere than the others, beside the noise of a sample of each component, enT.
pub(in crate::diagnose) fn apart(
    prepared: &PreparedRun,
    samples: &Samples,
    plateaus: &Plateaus,
    noise_ent: [f64; 3],
) -> Option<Apart> {
    let interval_s = interval_s(samples)?;
    let settings = of_settings(samples, plateaus);
    let least_ent = CLEAR * dot(noise_ent, noise_ent).sqrt();
    let zero_ent = level_of_zero(prepared);
    let of_side = |is_late: bool| -> Option<Apart> {
        // Either the setting beside goes on until there, or nothing is applied between them: what most edges show that show anything.
        let quarters = if is_late { [2, 3] } else { [1, 2] };
        let own: Vec<Option<[f64; 3]>> = settings.par_iter().map(|(_, window)| level(samples, *window, quarters)).collect();
        let both = [None, zero_ent].map(|between| edges_of(samples, &settings, &own, between, least_ent, is_late));
        let show = |edges: &Vec<Edge>| edges.iter().filter(|edge| edge.shown as f64 > AGREE).count();
        let [beside, between] = both;
        let mut edges = if show(&between) > show(&beside) { between } else { beside };
        // After a longer pause an edge stands elsewhere by itself.
        let usual_s = median(&mut edges.iter().map(|edge| edge.pause_s).collect::<Vec<f64>>());
        edges.retain(|edge| (edge.pause_s - usual_s).abs() <= interval_s);
        // What a displacement of all of them makes.
        let of_all = prepared.displacement.filter(|d| (d.shift_s > 0.0) == is_late).map_or(0.0, |d| d.shown_s / interval_s);
        let off = |edge: &Edge| edge.shown as f64 - of_all;
        let far: Vec<(f64, &Edge)> = edges.iter().map(|edge| (off(edge), edge)).collect();
        let far: Vec<(f64, &Edge)> = far.into_iter().filter(|(off, _)| off.abs() > AGREE.max(AGREE_PART * of_all)).collect();
        let middle = median(&mut far.iter().map(|(off, _)| *off).collect::<Vec<f64>>());
        let is_alike = |(off, _): &&(f64, &Edge)| (off - middle).abs() <= AGREE.max(AGREE_PART * middle.abs());
        let alike: Vec<&Edge> = far.iter().filter(is_alike).map(|(_, edge)| *edge).collect();
        let is_told =
            alike.len() >= FEWEST && alike.len() as f64 >= LEAST_PART * edges.len() as f64 && 2 * alike.len() >= far.len();
        if !is_told {
            return None;
        }
        let rms_ent = |a: usize| (alike.iter().map(|edge| edge.step_ent[a].powi(2)).sum::<f64>() / alike.len() as f64).sqrt();
        let axis = (0..3).max_by(|a, b| rms_ent(*a).total_cmp(&rms_ent(*b)))?;
        Some(Apart {
            times_s: alike.iter().map(|edge| edge.begin_s).collect(),
            clear: edges.len(),
            // A setting that shows the one before it for longer begins later, one that shows the one after it ends earlier.
            later_s: middle * interval_s * if is_late { 1.0 } else { -1.0 },
            is_at_begin: is_late,
            axis,
            step_ent: rms_ent(axis),
            noise_ent: noise_ent[axis],
        })
    };
    [true, false].into_iter().filter_map(of_side).max_by_key(|apart| apart.times_s.len())
}

/// An edge of a setting that is to be seen.
struct Edge {
    /// Begin of the setting, s.
    begin_s: f64,
    /// Time between the two settings of the edge, s.
    pause_s: f64,
    /// Samples of the setting that show what is beyond the edge.
    shown: usize,
    /// What is beyond it less the level of the setting, enT.
    step_ent: [f64; 3],
}

/// The edges that are to be seen at the begins of settings with their own levels, or at their ends; beyond them is the level of the setting there, or
/// the one that is given.
fn edges_of(
    samples: &Samples,
    settings: &[(&Plateau, [usize; 2])],
    own: &[Option<[f64; 3]>],
    between: Option<[f64; 3]>,
    least_ent: f64,
    is_late: bool,
) -> Vec<Edge> {
    let of = |i: usize| -> Option<Edge> {
        let (plateau, [from, to]) = settings[i];
        let next = if is_late { i.checked_sub(1)? } else { i + 1 };
        let (neighbour, _) = *settings.get(next)?;
        // One that is left out belongs to nothing.
        if plateau.dropped.is_some() {
            return None;
        }
        let here = own[i]?;
        let beyond = between.or(own[next])?;
        let step_ent = minus(beyond, here);
        if dot(step_ent, step_ent).sqrt() <= least_ent {
            return None;
        }
        let count = ((to - from) / 2 + BEYOND_HALF).min(to - from);
        let value = |k: usize| samples.reading_ent[if is_late { from + k } else { to - 1 - k }];
        let [earlier, later] = if is_late { [neighbour, plateau] } else { [plateau, neighbour] };
        Some(Edge {
            begin_s: plateau.setting.t_start_s,
            pause_s: later.setting.t_start_s - earlier.setting.t_end_s,
            shown: shown(&value, count, here, beyond)?,
            step_ent,
        })
    };
    (0..settings.len()).filter_map(of).collect()
}

/// How many of `count` samples from an edge on show the level beyond it; `None` where the readings creep: of what settles there is no edge.
fn shown(value: &dyn Fn(usize) -> [f64; 3], count: usize, own: [f64; 3], beyond: [f64; 3]) -> Option<usize> {
    let step = minus(beyond, own);
    let square = dot(step, step);
    let is_beyond = |k: &usize| {
        let off = minus(value(*k), beyond);
        dot(off, off) <= AT_LEVEL * AT_LEVEL * square
    };
    let shown = (0..count).take_while(is_beyond).count();
    let is_nearer = |k: &usize| dot(minus(value(*k), own), step) > 0.5 * square;
    let own_from = (0..count).rev().find(is_nearer).map_or(0, |last| last + 1);
    // One sample may lie on the edge itself.
    (own_from <= shown + 1).then_some(shown)
}

/// What the components read without a field, enT: their offsets.
fn level_of_zero(prepared: &PreparedRun) -> Option<[f64; 3]> {
    let rows = &prepared.record.rows;
    let offset = |a: usize| {
        let left = rows.iter().enumerate().map(|(i, row)| prepared.readings[(i, a)] - row.linear_ent[a]);
        median(&mut left.collect::<Vec<f64>>())
    };
    (!rows.is_empty()).then(|| [offset(0), offset(1), offset(2)])
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| a[i] - b[i])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| a[i] * b[i]).sum()
}

#[cfg(test)]
mod tests {
    use super::shown;

    /// A step of 1000 along one axis in 40 samples: seven show what is beyond it, or seven and one on the edge, or none. One that creeps with a time
    /// constant of six samples has no edge, and neither has one beyond which something else is.
    #[test]
    fn samples_beyond_an_edge_are_counted_and_what_creeps_has_none() {
        let of = |part: &dyn Fn(usize) -> f64| {
            let value = |k: usize| [5.0 + 1000.0 * part(k), -3.0, 0.1 * (k % 3) as f64];
            shown(&value, 40, [5.0, -3.0, 0.1], [1005.0, -3.0, 0.1])
        };
        assert_eq!(of(&|k| if k < 7 { 1.0 } else { 0.0 }), Some(7));
        assert_eq!(of(&|k| [1.0, 0.6, 0.0][usize::from(k >= 7) + usize::from(k > 7)]), Some(7));
        assert_eq!(of(&|_| 0.0), Some(0));
        assert_eq!(of(&|k| (-(k as f64) / 6.0).exp()), None);
        assert_eq!(of(&|k| if k < 7 { 3.0 } else { 0.0 }), None);
    }
}
