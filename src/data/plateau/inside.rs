//! What the bins of a plateau tell of it: saturation, spikes, and how neighbouring parts differ.

use super::{Bin, Contrasts, Drop, Extremes, Plateau};
use crate::fit::statistics::median;

/// So many times as far as the farthest sample of a typical bin is a spike, for bins of one sample, of two, and of more. The farthest one of
/// three samples is 1.26 standard deviations away in half of the bins, of two 1.05 and of one 0.67: less than seven standard deviations
/// would be reached by noise once in thousands of settings.
const OUTSTANDING_OF: [f64; 3] = [10.4, 6.7, 6.0];
/// Expected samples of the shortest parts that are compared within a plateau.
const FEWEST_IN_PART: f64 = 4.0;

/// A component whose samples of a plateau are all equal, and equal to the largest or smallest reading of all plateaus, is at the end
/// of its range if that happens with different fields, or if most other plateaus of the component do scatter. Returns the number of
/// plateaus without scatter.
pub(super) fn drop_saturated(list: &mut [Plateau], extremes: &[Extremes]) -> [usize; 3] {
    let mut without_scatter = [0; 3];
    for (component, silent) in without_scatter.iter_mut().enumerate() {
        let used: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
        let is_still = |i: &usize| extremes[*i].min[component] == extremes[*i].max[component];
        let still: Vec<usize> = used.iter().copied().filter(is_still).collect();
        *silent = still.len();
        let low = used.iter().map(|i| extremes[*i].min[component]).fold(f64::INFINITY, f64::min);
        let high = used.iter().map(|i| extremes[*i].max[component]).fold(f64::NEG_INFINITY, f64::max);
        for end in [low, high] {
            let rests: Vec<usize> = still.iter().copied().filter(|i| extremes[*i].min[component] == end).collect();
            let differ = rests.iter().any(|i| list[*i].setting.field != list[rests[0]].setting.field);
            if low < high && (differ || 2 * (used.len() - still.len()) > used.len()) {
                for i in rests {
                    list[i].dropped = Some(Drop::Saturated { component });
                }
            }
        }
    }
    without_scatter
}

/// Bins with a sample that is more than some times as far from the plateau's level as the farthest sample of a typical bin, or, where
/// typical bins do not scatter at all, as the resolution of the data.
pub(super) fn spiky_bins(bins: &[Bin], reference: [f64; 3], resolution: &impl Fn() -> [f64; 3]) -> Vec<bool> {
    let mut spiky = vec![false; bins.len()];
    let mut counts: Vec<u64> = bins.iter().map(|b| b.count).filter(|count| *count > 0).collect();
    if counts.len() < 8 {
        return spiky;
    }
    let middle = counts.len() / 2;
    let (_, of_typical, _) = counts.select_nth_unstable(middle);
    let times = OUTSTANDING_OF[(*of_typical as usize).clamp(1, OUTSTANDING_OF.len()) - 1];
    let there = || bins.iter().filter(|b| b.count > 0);
    for axis in 0..3 {
        // No sample is farther from the level than the samples are apart, and in no bin is the farthest one nearer than half of what its own are.
        let [low, high] = [
            there().map(|b| b.min[axis]).fold(f64::INFINITY, f64::min),
            there().map(|b| b.max[axis]).fold(f64::NEG_INFINITY, f64::max),
        ];
        let nearest = there().map(|b| 0.5 * (b.max[axis] - b.min[axis])).fold(f64::INFINITY, f64::min);
        if nearest > 0.0 && high - low <= times * nearest {
            continue;
        }
        let level = reference[axis] + median(&mut there().map(|b| b.mean(axis)).collect::<Vec<f64>>());
        let reach = |b: &Bin| (b.max[axis] - level).max(level - b.min[axis]);
        let mut typical = median(&mut there().map(reach).collect::<Vec<f64>>());
        // Rounding leaves a little of what is nothing.
        if typical <= 1e-9 * level.abs().max(1.0) && bins.iter().any(|b| b.count > 0 && reach(b) > 1e-6 * level.abs().max(1.0)) {
            typical = resolution()[axis];
        }
        for (flag, bin) in spiky.iter_mut().zip(bins) {
            *flag |= bin.count > 0 && typical > 0.0 && reach(bin) > times * typical;
        }
    }
    spiky
}

/// Whether the samples of a bin lie between the readings of the setting, `whole`, and the level of the setting beside it, where they scatter alike.
pub(super) fn is_between(bin: &Bin, whole: &Bin, beside: [f64; 3]) -> bool {
    (0..3).all(|axis| {
        let span = whole.max[axis] - whole.min[axis];
        let (low, high) = (whole.min[axis].min(beside[axis]) - span, whole.max[axis].max(beside[axis]) + span);
        bin.min[axis] >= low && bin.max[axis] <= high
    })
}

/// Contrasts of neighbouring parts at every octave of length, from parts that hold a few samples up to half of the plateau. Bins
/// with a spike do not count, nor do pairs with a part that lost more than half of its samples.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
pub(super) fn contrasts(bins: &[Bin], spiky: &[bool], bin_s: f64, sample_rate_hz: f64) -> Vec<Contrasts> {
    let expected = bin_s * sample_rate_hz;
    let mut parts: Vec<Bin> = bins.iter().zip(spiky).map(|(bin, spiky)| if *spiky { Bin::EMPTY } else { *bin }).collect();
    let (mut length, mut list) = (1, Vec::new());
    while parts.len() > 1 {
        let least = 0.5 * expected * length as f64;
        let (mut count, mut inverse_samples, mut squares, mut sums) = (0, 0.0, [0.0; 3], [0.0; 3]);
        for pair in parts.chunks_exact(2).filter(|p| p.iter().all(|b| b.count as f64 >= least)) {
            count += 1;
            inverse_samples += 1.0 / pair[0].count as f64 + 1.0 / pair[1].count as f64;
            for (axis, (square, sum)) in squares.iter_mut().zip(&mut sums).enumerate() {
                let difference = pair[1].mean(axis) - pair[0].mean(axis);
                *square += difference.powi(2);
                *sum += difference;
            }
        }
        if count > 0 && least >= 0.5 * FEWEST_IN_PART {
            let pairs = count as f64;
            list.push(Contrasts {
                part_s: bin_s * length as f64,
                count,
                inverse_samples: inverse_samples / pairs,
                mean_square: squares.map(|s| s / pairs),
                mean: sums.map(|s| s / pairs),
            });
        }
        let joined = parts.chunks_exact(2).map(|pair| {
            let mut whole = pair[0];
            whole.merge(&pair[1]);
            whole
        });
        parts = joined.collect();
        length *= 2;
    }
    list
}
