//! The method of R 4.9: stripes of the spectrum take the level of the bins beside them.

use super::rates::alias_range_hz;
use super::{Day, Stretch, in_parallel};
use crate::fit::statistics::central_median;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use realfft::num_complex::Complex;
use realfft::{ComplexToReal, RealFftPlanner, RealToComplex};
use std::collections::BTreeMap;
use std::f64::consts::TAU;
use std::ops::Range;
use std::sync::Arc;

/// Vectors of a window (R 4.9).
const WINDOW: usize = 1024;
/// From the begin of a window to that of the next one: windows overlap by 25 % (R 4.9).
const HOP: usize = 768;
/// Bins on either side of a stripe whose level it takes.
const BESIDE: usize = 6;
/// Scatter of the magnitudes that a stripe takes: R adds "some appropriate noise".
const SCATTER: f64 = 0.3;

type Plans = BTreeMap<usize, (Arc<dyn RealToComplex<f64>>, Arc<dyn ComplexToReal<f64>>)>;

struct Window {
    stretch: usize,
    slots: Range<usize>,
}

#[derive(Default)]
struct Buffers {
    samples: Vec<f64>,
    spectrum: Vec<Complex<f64>>,
    stripes: Vec<Range<usize>>,
    level: Vec<f64>,
}

/// What is removed from every vector of the stretches, in their order.
pub(super) fn removal(day: &Day, stretches: &[Stretch]) -> Vec<[f64; 3]> {
    let of = |(stretch, s): (usize, &Stretch)| windows(s.length()).into_iter().map(move |slots| Window { stretch, slots });
    let windows: Vec<Window> = stretches.iter().enumerate().flat_map(of).collect();
    let mut planner = RealFftPlanner::new();
    let mut plans = Plans::new();
    for window in &windows {
        let length = window.slots.len();
        plans.entry(length).or_insert_with(|| (planner.plan_fft_forward(length), planner.plan_fft_inverse(length)));
    }
    let parts = in_parallel(&windows, |buffers, window| of_window(day, &stretches[window.stretch], window, &plans, buffers));

    let mut removed = Vec::new();
    let mut parts = windows.iter().zip(parts).peekable();
    for (index, stretch) in stretches.iter().enumerate() {
        let first = removed.len();
        removed.resize(first + stretch.rows.len(), [0.0; 3]);
        let mut covered = 0;
        while let Some((window, part)) = parts.next_if(|(window, _)| window.stretch == index) {
            let overlap = covered - window.slots.start.min(covered);
            for (i, new) in stretch.entries(window.slots.clone()).zip(part) {
                let since = stretch.slots[i] as usize - window.slots.start;
                let share = if since < overlap { (since as f64 + 0.5) / overlap as f64 } else { 1.0 };
                let sum = &mut removed[first + i];
                for c in 0..3 {
                    sum[c] += share * (new[c] - sum[c]);
                }
            }
            covered = window.slots.end;
        }
    }
    removed
}

/// Windows of a stretch: one where it is shorter than that, else the last one ends with the stretch.
fn windows(length: usize) -> Vec<Range<usize>> {
    let last = length.saturating_sub(WINDOW);
    (0..last).step_by(HOP).chain([last]).map(|begin| begin..length.min(begin + WINDOW)).collect()
}

/// What is removed from the vectors of a window.
fn of_window(day: &Day, stretch: &Stretch, window: &Window, plans: &Plans, buffers: &mut Buffers) -> Vec<[f64; 3]> {
    let length = window.slots.len();
    let entries = stretch.entries(window.slots.clone());
    let mut removed = vec![[0.0; 3]; entries.len()];
    find_stripes(day, stretch, entries.clone(), length, &mut buffers.stripes);
    let (Some((forward, inverse)), Some(first)) = (plans.get(&length), entries.clone().next()) else { return removed };
    if buffers.stripes.is_empty() {
        return removed;
    }
    // The time of the window names it and its day.
    let name = day.times[stretch.rows[first] as usize] as u64;
    let mut random = Xoshiro256PlusPlus::seed_from_u64(name.wrapping_add(day.options.seed.wrapping_mul(0x9e37_79b9_7f4a_7c15)));
    for c in 0..3 {
        fill(&mut buffers.samples, &day.field[c], stretch, window.slots.clone());
        buffers.spectrum.resize(length / 2 + 1, Complex::default());
        // Fails only for buffers of other lengths than the plan's.
        if forward.process(&mut buffers.samples, &mut buffers.spectrum).is_err() {
            continue;
        }
        replace(&mut buffers.spectrum, length, &buffers.stripes, &mut buffers.level, &mut random);
        if inverse.process(&mut buffers.spectrum, &mut buffers.samples).is_err() {
            continue;
        }
        for (part, i) in removed.iter_mut().zip(entries.clone()) {
            part[c] = buffers.samples[stretch.slots[i] as usize - window.slots.start] / length as f64;
        }
    }
    removed
}

/// One component of a window, missing vectors on straight lines.
fn fill(samples: &mut Vec<f64>, field: &[f64], stretch: &Stretch, slots: Range<usize>) {
    samples.clear();
    samples.resize(slots.len(), 0.0);
    let known = |i: usize| (stretch.slots[i] as usize, field[stretch.rows[i] as usize]);
    let entries = stretch.entries(slots.clone());
    // From the vector before the window to the one behind it, so that lines over its ends are known.
    let (first, last) = (entries.start.saturating_sub(1), entries.end.min(stretch.slots.len() - 1));
    let mut before = known(first);
    for i in first..=last {
        let here = known(i);
        for slot in (before.0 + 1).max(slots.start)..here.0.min(slots.end) {
            let share = (slot - before.0) as f64 / (here.0 - before.0) as f64;
            samples[slot - slots.start] = before.1 + share * (here.1 - before.1);
        }
        if slots.contains(&here.0) {
            samples[here.0 - slots.start] = here.1;
        }
        before = here;
    }
}

/// Ranges of bins with interference, from low to high, without bin 0: all bins of which a part, half of a bin to either side, is in a
/// stripe.
fn find_stripes(day: &Day, stretch: &Stretch, entries: Range<usize>, length: usize, stripes: &mut Vec<Range<usize>>) {
    stripes.clear();
    let (rate_hz, width_hz) = (day.mode.rate_hz, day.mode.half_width_hz.unwrap_or(0.0));
    let bin_hz = rate_hz / length as f64;
    let mut add = |[low, high]: [f64; 2]| {
        let begin = ((low - width_hz) / bin_hz).round().max(1.0) as usize;
        let end = ((high + width_hz) / bin_hz).round().min((length / 2) as f64) as usize;
        if begin <= end {
            stripes.push(begin..end + 1);
        }
    };
    day.mode.lines_hz.iter().for_each(|line| add([*line; 2]));
    let time = |i: usize| day.times[stretch.rows[i] as usize];
    let ends = [entries.start, entries.end.saturating_sub(1)].map(|i| day.table.place(time(i), 0));
    if let [Some((from, _)), Some((to, _))] = ends {
        for wheel in 0..day.table.wheels() {
            let rates = day.table.rates_between(wheel, from, to);
            for harmonic in &day.options.harmonics {
                add(alias_range_hz(rates.map(|rate| rate * f64::from(*harmonic)), rate_hz));
            }
        }
    }
    stripes.sort_by_key(|stripe| stripe.start);
    stripes.dedup_by(|later, stripe| {
        let joined = later.start <= stripe.end;
        if joined {
            stripe.end = stripe.end.max(later.end);
        }
        joined
    });
}

/// Leaves in the spectrum what is removed from it: in stripes the difference to random numbers of the level beside them, else nothing.
fn replace(
    spectrum: &mut [Complex<f64>],
    length: usize,
    stripes: &[Range<usize>],
    level: &mut Vec<f64>,
    random: &mut Xoshiro256PlusPlus,
) {
    // What is taken away is collected behind the spectrum's own values, which stripes further up still look at.
    let is_free = |bin: usize| !stripes.iter().any(|stripe| stripe.contains(&bin));
    let levels: Vec<Option<f64>> = stripes
        .iter()
        .map(|stripe| {
            let below = (1..stripe.start).rev().filter(|bin| is_free(*bin)).take(BESIDE);
            let above = (stripe.end..spectrum.len()).filter(|bin| is_free(*bin)).take(BESIDE);
            level.clear();
            level.extend(below.chain(above).map(|bin| spectrum[bin].norm()));
            (!level.is_empty()).then(|| central_median(level))
        })
        .collect();
    let mut done = 0;
    for (stripe, level) in stripes.iter().zip(levels) {
        spectrum[done..stripe.start].fill(Complex::default());
        done = stripe.end;
        let Some(level) = level else {
            spectrum[stripe.clone()].fill(Complex::default());
            continue;
        };
        for bin in stripe.clone() {
            let scatter: f64 = StandardNormal.sample(random);
            let turn: f64 = StandardUniform.sample(random);
            let mut new = Complex::from_polar(level * (1.0 + SCATTER * scatter).abs(), TAU * turn);
            if 2 * bin == length {
                // The bin at half of the rate is real.
                new = Complex::new(new.norm() * if turn < 0.5 { 1.0 } else { -1.0 }, 0.0);
            }
            spectrum[bin] -= new;
        }
    }
    spectrum[done..].fill(Complex::default());
}
