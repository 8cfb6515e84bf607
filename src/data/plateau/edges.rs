//! Where the samples of a setting stop to show the step before it, and where they begin to show the one after it.

use super::inside::spiky_bins;
use super::{Accumulator, BINS, Bin, Course, Displacement, displacement};
use crate::data::run::Setting;
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Bins that settling and a late edge may take at most.
const MOST_SETTLING: usize = 48;
/// Bins that show the level of a setting undisturbed by its ends: free of data that are late by up to three eighths or early
/// by up to a quarter of a plateau.
pub(super) const REFERENCE: Range<usize> = 3 * BINS / 8..3 * BINS / 4;

/// How much of a neighbouring step a bin shows.
#[derive(Clone, Copy, Debug)]
struct Response {
    fraction: f64,
    z: f64,
}

/// A part of a step that is too small to matter for a sensitivity.
pub(super) const NEGLIGIBLE: f64 = 1e-7;
/// Standard errors above which a part of a step is no noise.
pub(super) const SIGNIFICANT: f64 = 4.0;

/// How many slots from the begin show the step: up to the first two that do not. `None`: they all do. Significant is what exceeds four
/// standard errors, so that sixty-four slots raise a false alarm in one run of two hundred and fifty, and `least` of the step.
fn followed(responses: impl Iterator<Item = Response>, least: f64) -> Option<usize> {
    let follows: Vec<bool> = responses.map(|r| r.z > SIGNIFICANT && r.fraction.abs() > least).collect();
    follows.windows(2).position(|pair| !pair[0] && !pair[1])
}

/// Mean reading over bins, if they hold any sample.
fn mean<'a>(bins: impl IntoIterator<Item = &'a Bin>, reference: [f64; 3]) -> Option<[f64; 3]> {
    let mut total = Bin::EMPTY;
    bins.into_iter().for_each(|bin| total.merge(bin));
    (total.count > 0).then(|| std::array::from_fn(|axis| reference[axis] + total.mean(axis)))
}

#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Edges {
    pub(super) settling_s: f64,
    pub(super) still_settling: bool,
    pub(super) early_end_s: f64,
    pub(super) shift_s: f64,
}

impl Accumulator {
    /// Finds how many bins follow the step before a setting, and how many already follow the step after it: the deviation of every
    /// bin from the setting's middle is regressed on the step, over all settings and components at once.
    /// `middle` are the levels over [`REFERENCE`].
    pub(super) fn find_edges(&self, middle: &[Option<[f64; 3]>], resolution: &impl Fn() -> [f64; 3]) -> Edges {
        // All settings share one clock after a step, whatever their length.
        let slot_s = self.median_duration_s() / BINS as f64;
        // Data that step too early show at least one whole sample of the next setting.
        let one_sample = 1.0 / (slot_s * self.sample_rate_hz).max(1.0);
        let early = (0..BINS - REFERENCE.end).map(|slot| self.response(middle, slot, slot_s, false));
        let early_slots = followed(early, 0.5 * one_sample);
        // The level that a decay goes to is best seen at the end.
        let end = BINS - early_slots.map_or(BINS - REFERENCE.end, |slots| if slots == 0 { 0 } else { slots + 1 });
        let last = self.levels(end - BINS / 4..end, resolution);
        let late = (0..MOST_SETTLING).map(|slot| self.response(&last, slot, slot_s, true));
        let late_slots = followed(late, NEGLIGIBLE);
        // A decay that has just become too small to be seen still biases the mean; half as long again makes it negligible.
        let wanted = late_slots.map(|slots| if slots == 0 { 0 } else { slots + slots / 2 + 1 });
        let settling = wanted.map_or(MOST_SETTLING, |slots| slots.min(MOST_SETTLING));
        Edges {
            settling_s: settling as f64 * slot_s,
            still_settling: wanted.is_none_or(|slots| slots > MOST_SETTLING),
            early_end_s: (BINS - end) as f64 * slot_s,
            shift_s: self.displacement().map_or(0.0, |d| d.shift_s),
        }
    }

    /// What the readings lose of the step before a setting from the first half of its used bins to the second, as a part of the step, with its
    /// standard uncertainty: a slow decay shows in no single slot, but in the halves of all settings together. What readings do in proportion to
    /// the field itself, as where the temperature moves the sensitivity, is not in it. `None` where it cannot be told.
    pub(super) fn following(&self, used: &[Range<usize>]) -> Option<[f64; 2]> {
        let levels: Vec<Option<[f64; 3]>> = used.iter().enumerate().map(|(i, bins)| self.level(i, bins.clone())).collect();
        let mut rows: Vec<(Vector3<f64>, f64)> = Vec::new();
        for (i, bins) in used.iter().enumerate().skip(1) {
            let middle = bins.start.midpoint(bins.end);
            let (Some(before), Some(here)) = (levels[i - 1], levels[i]) else { continue };
            let (Some(first), Some(second)) = (self.level(i, bins.start..middle), self.level(i, middle..bins.end)) else {
                continue;
            };
            rows.extend((0..3).map(|a| (Vector3::new(before[a] - here[a], here[a], 1.0), first[a] - second[a])));
        }
        // Means of components differ by their offsets alone, which the constant takes.
        let normal = rows.iter().map(|(x, _)| x * x.transpose()).sum::<Matrix3<f64>>();
        let scale = normal.diagonal().map(|d| 1.0 / d.max(f64::MIN_POSITIVE).sqrt());
        let inverse = Matrix3::from_fn(|r, c| normal[(r, c)] * scale[r] * scale[c]).try_inverse()?;
        let solution =
            (inverse * rows.iter().map(|(x, d)| x.component_mul(&scale) * *d).sum::<Vector3<f64>>()).component_mul(&scale);
        let left: f64 = rows.iter().map(|(x, d)| (d - x.dot(&solution)).powi(2)).sum();
        let variance = left / rows.len().checked_sub(3).filter(|dof| *dof > 0)? as f64 * inverse[(0, 0)] * scale[0].powi(2);
        (variance > 0.0).then(|| [solution[0], variance.sqrt()])
    }

    /// Mean reading of a setting over some of its bins.
    fn level(&self, setting: usize, bins: Range<usize>) -> Option<[f64; 3]> {
        let (all, reference) = (self.bins.get(setting)?, (*self.references.get(setting)?)?);
        mean(all.get(bins)?, reference)
    }

    /// The same of every setting, without bins that hold a spike: a single one would be seen in what every other bin has beside this level.
    pub(super) fn levels(&self, bins: Range<usize>, resolution: &impl Fn() -> [f64; 3]) -> Vec<Option<[f64; 3]>> {
        let level = |(all, reference): (&[Bin; BINS], &Option<[f64; 3]>)| {
            let (own, reference) = (all.get(bins.clone())?, (*reference)?);
            let spiky = spiky_bins(own, reference, resolution);
            mean(own.iter().zip(spiky).filter(|(_, is_spiky)| !is_spiky).map(|(bin, _)| bin), reference)
        };
        self.bins.iter().zip(&self.references).map(level).collect()
    }

    /// How the data step inside the settings, bin by bin.
    fn displacement(&self) -> Option<Displacement> {
        let course = |(setting, bins): (&Setting, &[Bin; BINS]), reference: &Option<[f64; 3]>| {
            let mean = |bin: &Bin, reference: [f64; 3]| std::array::from_fn(|axis| reference[axis] + bin.mean(axis));
            let values = reference.filter(|_| setting.frequency_hz == 0.0);
            Course {
                begin_s: setting.t_start_s,
                end_s: setting.t_end_s,
                is_zero: setting.field.0 == [0.0; 3],
                interval_s: (setting.t_end_s - setting.t_start_s) / BINS as f64,
                beside_s: [0.0; 2],
                values: values.map_or_else(Vec::new, |r| bins.iter().map(|bin| mean(bin, r)).collect()).into(),
            }
        };
        let settings = self.settings.iter().zip(&self.bins).zip(&self.references);
        let courses: Vec<Course> = settings.map(|(setting, reference)| course(setting, reference)).collect();
        displacement(&courses, self.sample_rate_hz.recip())
    }

    /// How much of the step before and of the step after a setting its data show at a time after its begin (or before its end), from
    /// a regression on both steps over all settings and components.
    fn response(&self, middle: &[Option<[f64; 3]>], slot: usize, slot_s: f64, after_begin: bool) -> Response {
        let (mut pp, mut pn, mut nn, mut pd, mut nd, mut dd, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, (setting, bins)) in self.settings.iter().zip(&self.bins).enumerate() {
            let level = |i: Option<usize>| i.and_then(|i| middle.get(i)).copied().flatten();
            let (Some(here), Some(Some(reference))) = (level(Some(i)), self.references.get(i)) else { continue };
            let (before, after) = (level(i.checked_sub(1)), level(Some(i + 1)));
            let (Some(before), Some(after)) = (before.or(after.map(|_| here)), after.or(before.map(|_| here))) else { continue };
            let bin_s = (setting.t_end_s - setting.t_start_s) / BINS as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates at BINS")]
            let index = ((slot as f64 + 0.5) * slot_s / bin_s) as usize;
            let Some(bin) = bins.get(if after_begin { index } else { (BINS - 1).wrapping_sub(index) }).filter(|b| b.count > 0)
            else {
                continue;
            };
            for axis in 0..3 {
                let (p, n) = (before[axis] - here[axis], after[axis] - here[axis]);
                let d = reference[axis] + bin.mean(axis) - here[axis];
                pp += p * p;
                pn += p * n;
                nn += n * n;
                pd += p * d;
                nd += n * d;
                dd += d * d;
                count += 1.0;
            }
        }
        let (own, own_d) = if after_begin { (pp, pd) } else { (nn, nd) };
        if count < 6.0 || own <= 0.0 {
            return Response { fraction: 0.0, z: 0.0 };
        }
        let determinant = pp * nn - pn * pn;
        let (fraction, explained, weight) = if determinant > 1e-6 * pp * nn {
            let of_before = (pd * nn - nd * pn) / determinant;
            let of_after = (nd * pp - pd * pn) / determinant;
            let explained = of_before * pd + of_after * nd;
            if after_begin { (of_before, explained, nn / determinant) } else { (of_after, explained, pp / determinant) }
        } else {
            // Both steps are the same one, as where two fields alternate.
            (own_d / own, own_d * own_d / own, 1.0 / own)
        };
        let std = ((dd - explained).max(0.0) / (count - 2.0) * weight).sqrt();
        Response { fraction, z: if std > 0.0 { fraction.abs() / std } else { 0.0 } }
    }
}
