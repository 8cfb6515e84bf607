//! Something in a narrow band of the spectrum inside the plateaus that is no line of it: a tone near half of the sample rate, of which the means of the
//! plateaus leave no sine and cosine; one whose frequency moves, or whose size follows the field; and what signals that were found leave.
//!
//! The spectra of short parts of the samples, each over its own mean so that a loud part counts no more than a quiet one, are averaged, and every band
//! is compared with those beside it. White noise has one level, and slow noise of every kind, whether 1/f, of a first order or a telegraph, falls with the
//! frequency: in a band that stands above both of its neighbours there is none of them. At half of the sample rate, where the spectrum is its own
//! mirror, a band has one neighbour. How far bands scatter is seen in groups of parts, whatever the distribution of the noise. Since a band has to
//! stand out twice, white noise does so less often than the probability says.

use super::interval_s;
use super::periodic::AroundMeans;
use crate::data::units::{COMPONENTS, three_digits};
use crate::diagnose::result::{Left, LeftLike};
use crate::fit::statistics::student_tail;
use crate::record::prepared::{PreparedRun, Samples};
use rayon::prelude::*;
use realfft::RealFftPlanner;
use realfft::num_complex::Complex;

/// Samples of a part: the first length of which there are enough.
const LENGTHS: [usize; 2] = [64, 32];
const FEWEST_PARTS: usize = 24;
/// Groups of parts, of at least two each.
const MOST_GROUPS: usize = 48;
const LEAST_IN_GROUP: usize = 2;
/// Lines of a band; its neighbours have as many, and at least two.
const WIDTHS: [usize; 8] = [1, 2, 3, 4, 6, 8, 12, 16];
const LEAST_BESIDE: usize = 2;
/// Widest band at half of the sample rate.
const WIDEST_AT_HALF: usize = 2;
/// A band is told if its level is so many times that of its neighbours: filters of converters have ripples; and at half of the sample rate, to which
/// the noise of some rises.
const LEAST: f64 = 1.1;
const LEAST_AT_HALF: f64 = 1.25;
/// Probability that noise alone shows as much, all bands and axes counted.
const SIGNIFICANT: f64 = 1e-4;
/// The three axes and their mean.
const SERIES: usize = 4;

/// What periodic signals leave in a narrow band, if it is no noise.
pub(in crate::diagnose) fn narrow(prepared: &PreparedRun, samples: &Samples, (windows, residual): &AroundMeans) -> Option<Left> {
    let interval_s = interval_s(samples)?;
    if !(0..3).all(|a| changes(samples, &prepared.windows, a)) {
        return None;
    }
    let found = strongest(&samples.t_s, windows, residual, interval_s)?;
    let axes: Vec<usize> = if found.series < 3 { vec![found.series] } else { vec![0, 1, 2] };
    let nt = |a: usize| found.rms_ent[a] * prepared.nt_per_ent[a];
    let [from_hz, to_hz] = found.band_hz.map(three_digits);
    let names: Vec<&str> = axes.iter().map(|a| COMPONENTS[*a]).collect();
    Some(Left {
        place: format!("{}, {from_hz} to {to_hz} Hz", names.join(", ")),
        rms_nt: axes.into_iter().map(nt).fold(0.0, f64::max),
        times_noise: found.ratio.sqrt(),
        like: LeftLike::Band,
    })
}

/// Whether a component changes from most samples to the next: of one that rests on a step of its converter what is left are the steps, which come in a
/// rhythm where it rises evenly.
fn changes(samples: &Samples, windows: &[[usize; 2]], axis: usize) -> bool {
    let pairs = || windows.iter().flat_map(|[from, to]| samples.reading_ent[*from..*to].windows(2));
    2 * pairs().filter(|pair| pair[0][axis] != pair[1][axis]).count() > pairs().count()
}

/// A band that stands above its neighbours.
#[derive(Clone, Copy, Debug)]
struct Found {
    /// Where it is, Hz.
    band_hz: [f64; 2],
    /// The axis on which it is seen best, or 3 for the mean of all.
    series: usize,
    /// Its level over that of the higher one of its neighbours, both over the mean level of their parts.
    ratio: f64,
    /// Root mean square of the samples of each axis in the band, enT.
    rms_ent: [f64; 3],
    /// Probability that noise makes any band stand out as far.
    p_value: f64,
}

/// Lines, from 1, of a band and of its neighbours; there is none above half of the sample rate.
struct Band {
    own: [usize; 2],
    below: [usize; 2],
    above: Option<[usize; 2]>,
}

/// The bands of so many lines.
fn bands(lines: usize) -> Vec<Band> {
    let of = |width: usize, first: usize| -> Option<Band> {
        let last = first + width - 1;
        let beside = width.max(LEAST_BESIDE);
        let below = [first.saturating_sub(beside).max(1), first - 1];
        let is_at_half = last == lines;
        let above = [last + 1, (last + beside).min(lines)];
        let is_enough = |[from, to]: [usize; 2]| to + 1 >= from + LEAST_BESIDE;
        let is_one = is_enough(below) && if is_at_half { width <= WIDEST_AT_HALF } else { is_enough(above) };
        is_one.then(|| Band { own: [first, last], below, above: (!is_at_half).then_some(above) })
    };
    let of_width = |width: usize| (2..=(lines + 1).saturating_sub(width)).filter_map(move |first| of(width, first));
    WIDTHS.into_iter().flat_map(of_width).collect()
}

/// Averaged spectra of groups of parts: sums of the lines up to each, from 0, of every series.
struct Spectra {
    groups: Vec<[Vec<f64>; SERIES]>,
    /// Mean variance of the samples of each axis in every line, from the first on, enT².
    variance_ent2: [Vec<f64>; 3],
}

impl Spectra {
    /// Of parts of so many samples that begin there.
    fn new(begins: &[usize], length: usize, residual: &[Vec<f64>; 3]) -> Option<Self> {
        let fft = RealFftPlanner::<f64>::new().plan_fft_forward(length);
        let of_part = |(input, lines): &mut (Vec<f64>, Vec<Complex<f64>>), begin: &usize| -> Option<[Vec<f64>; 3]> {
            let mut part: [Vec<f64>; 3] = Default::default();
            for a in 0..3 {
                input.copy_from_slice(residual[a].get(*begin..begin + length)?);
                fft.process(input, lines).ok()?;
                part[a] = lines[1..].iter().map(|line| line.norm_sqr()).collect();
            }
            Some(part)
        };
        let memory = || (fft.make_input_vec(), fft.make_output_vec());
        let mut parts: Vec<[Vec<f64>; 3]> = begins.par_iter().map_init(memory, of_part).collect::<Option<_>>()?;
        let mut variance_ent2: [Vec<f64>; 3] = std::array::from_fn(|_| vec![0.0; length / 2]);
        // Every line but that of half of the sample rate has a twin at its negative frequency.
        let twins = |line: usize| if line + 1 < length / 2 { 2.0 } else { 1.0 };
        parts.retain_mut(|part| {
            let means = part.each_ref().map(|powers| powers.iter().sum::<f64>() / powers.len() as f64);
            // A component that does not move has no spectrum.
            if !means.iter().all(|mean| *mean > 0.0) {
                return false;
            }
            for (a, powers) in part.iter_mut().enumerate() {
                for (line, power) in powers.iter_mut().enumerate() {
                    variance_ent2[a][line] += twins(line) * *power / (length * length) as f64;
                    *power /= means[a];
                }
            }
            true
        });
        if parts.len() < FEWEST_PARTS {
            return None;
        }
        variance_ent2.iter_mut().flatten().for_each(|sum| *sum /= parts.len() as f64);
        let count = MOST_GROUPS.min(parts.len() / LEAST_IN_GROUP);
        let of_group = |group: usize| -> [Vec<f64>; SERIES] {
            let own = &parts[group * parts.len() / count..(group + 1) * parts.len() / count];
            std::array::from_fn(|series| {
                let axes = if series < 3 { series..series + 1 } else { 0..3 };
                let weight = 1.0 / (own.len() * axes.len()) as f64;
                let level = |line: usize| own.iter().flat_map(|part| &part[axes.clone()]).map(|powers| powers[line]).sum::<f64>();
                let mut sums = vec![0.0; length / 2 + 1];
                (0..length / 2).for_each(|line| sums[line + 1] = sums[line] + weight * level(line));
                sums
            })
        };
        Some(Self { groups: (0..count).map(of_group).collect(), variance_ent2 })
    }

    /// Mean level of some lines over the groups.
    fn level(&self, series: usize, lines: [usize; 2]) -> f64 {
        self.groups.iter().map(|group| level(&group[series], lines)).sum::<f64>() / self.groups.len() as f64
    }

    /// By how many standard uncertainties the level of some lines is above that of others, as the groups scatter.
    fn above(&self, series: usize, lines: [usize; 2], others: [usize; 2]) -> f64 {
        let count = self.groups.len() as f64;
        let by: Vec<f64> = self.groups.iter().map(|group| level(&group[series], lines) - level(&group[series], others)).collect();
        let mean = by.iter().sum::<f64>() / count;
        let variance = by.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (count - 1.0);
        if variance > 0.0 { mean / (variance / count).sqrt() } else { 0.0 }
    }
}

/// Mean of some lines by their sums.
fn level(sums: &[f64], [first, last]: [usize; 2]) -> f64 {
    (sums[last] - sums[first - 1]) / (last + 1 - first) as f64
}

/// The band that stands out most, if it is no noise.
fn strongest(t_s: &[f64], windows: &[[usize; 2]], residual: &[Vec<f64>; 3], interval_s: f64) -> Option<Found> {
    let mut all = LENGTHS.into_iter().map(|length| (length, parts_of(t_s, windows, length, interval_s)));
    let (length, begins) = all.find(|(_, begins)| begins.len() >= FEWEST_PARTS)?;
    let spectra = Spectra::new(&begins, length, residual)?;
    let lines = length / 2;
    let all = bands(lines);
    let trials = (SERIES * all.len()) as f64;
    let of = |band: &Band, series: usize| -> Option<Found> {
        let beside = || std::iter::once(band.below).chain(band.above);
        let own = spectra.level(series, band.own);
        let ratio = own / beside().map(|others| spectra.level(series, others)).fold(f64::MIN_POSITIVE, f64::max);
        let least = if band.above.is_some() { LEAST } else { LEAST_AT_HALF };
        if ratio < least {
            return None;
        }
        let times = beside().map(|others| spectra.above(series, band.own, others)).fold(f64::INFINITY, f64::min);
        let p_value = trials * student_tail(times, spectra.groups.len() - 1)?;
        let variance_ent2 = |a: usize| spectra.variance_ent2[a][band.own[0] - 1..band.own[1]].iter().sum::<f64>();
        let line_hz = 1.0 / (length as f64 * interval_s);
        let [first, last] = band.own.map(|line| line as f64);
        (p_value < SIGNIFICANT).then(|| Found {
            band_hz: [(first - 0.5) * line_hz, ((last + 0.5) * line_hz).min(0.5 / interval_s)],
            series,
            ratio,
            rms_ent: [0, 1, 2].map(|a: usize| variance_ent2(a).sqrt()),
            p_value,
        })
    };
    let of = &of;
    let found = all.iter().flat_map(|band| (0..SERIES).filter_map(move |series| of(band, series)));
    found.min_by(|a, b| a.p_value.total_cmp(&b.p_value).then(b.ratio.total_cmp(&a.ratio)))
}

/// First samples of the parts of the windows that have so many samples, none missing.
fn parts_of(t_s: &[f64], windows: &[[usize; 2]], length: usize, interval_s: f64) -> Vec<usize> {
    let longest_s = (length as f64 - 0.5) * interval_s;
    let of_window = |[from, to]: &[usize; 2]| {
        let (from, to) = (*from, (*to).min(t_s.len()));
        (from..to).step_by(length).filter(move |begin| begin + length <= to)
    };
    windows.iter().flat_map(of_window).filter(|begin| t_s[begin + length - 1] - t_s[*begin] < longest_s).collect()
}

#[cfg(test)]
mod tests {
    use super::{Found, bands, strongest};
    use crate::diagnose::samples::demean;
    use crate::fit::random::Random;
    use std::f64::consts::TAU;

    const RATE_HZ: f64 = 32.0;
    const PLATEAUS: usize = 90;
    const SAMPLES: usize = 160;
    const NOISE: f64 = 0.3;

    /// What stands out in 90 plateaus of 5 s every 7 s with white noise and a signal, which may depend on the plateau.
    fn found(seed: u64, mut signal: impl FnMut(f64, usize, &mut Random) -> f64) -> Option<Found> {
        let mut random = Random::seeded(seed);
        let t_s: Vec<f64> = (0..PLATEAUS).flat_map(|i| (0..SAMPLES).map(move |k| 7.0 * i as f64 + k as f64 / RATE_HZ)).collect();
        let windows: Vec<[usize; 2]> = (0..PLATEAUS).map(|i| [SAMPLES * i, SAMPLES * (i + 1)]).collect();
        let mut residual: [Vec<f64>; 3] = Default::default();
        for axis in &mut residual {
            for (k, t_s) in t_s.iter().enumerate() {
                let noise = NOISE * random.gaussian();
                axis.push(noise + signal(*t_s, k / SAMPLES, &mut random));
            }
        }
        demean(&mut residual, &windows);
        strongest(&t_s, &windows, &residual, 1.0 / RATE_HZ)
    }

    /// Every band has a neighbour below it, and one above it unless it ends at half of the sample rate.
    #[test]
    fn bands_have_neighbours_on_both_sides() {
        for lines in [16, 32] {
            let all = bands(lines);
            assert!(all.len() > 2 * lines);
            for band in all {
                let [first, last] = band.own;
                assert!(band.below[0] >= 1 && band.below[1] + 1 == first && band.below[1] > band.below[0]);
                assert_eq!(band.above.is_none(), last == lines);
                assert!(band.above.is_none_or(|[from, to]| from == last + 1 && to > from && to <= lines));
            }
        }
    }

    /// White noise, slow noise of a first order, a telegraph that switches every 2 s, noise that grows with the field of a plateau, and single readings that
    /// are ten times as far off.
    #[test]
    fn noise_has_no_narrow_band() {
        for seed in 0..12 {
            assert!(found(seed, |_, _, _| 0.0).is_none(), "white {seed}");
            let mut slow = 0.0;
            let of_first_order = found(seed, |_, _, random| {
                slow = 0.9 * slow + 0.2 * random.gaussian();
                slow
            });
            assert!(of_first_order.is_none(), "slow {seed}: {of_first_order:?}");
            let mut is_on = false;
            let telegraph = found(seed, |_, _, random| {
                is_on ^= random.uniform() < 1.0 / (2.0 * RATE_HZ);
                if is_on { 1.0 } else { 0.0 }
            });
            assert!(telegraph.is_none(), "telegraph {seed}: {telegraph:?}");
            let of_field = found(seed, |_, i, random| 0.2 * (i % 11) as f64 * random.gaussian());
            assert!(of_field.is_none(), "field {seed}: {of_field:?}");
            let tails = found(seed, |_, _, random| if random.uniform() < 0.01 { 3.0 * random.gaussian() } else { 0.0 });
            assert!(tails.is_none(), "tails {seed}: {tails:?}");
        }
    }

    /// A tone within a percent of half of the sample rate, one of which the size follows the field of the plateau, and one of which the frequency moves from
    /// 5 to 6 Hz: the band holds them, and its root mean square is that of the signal and of the noise in it.
    #[test]
    fn what_is_no_line_is_found_where_it_is() {
        let expected = |signal_rms: f64, f: &Found| {
            let share = (f.band_hz[1] - f.band_hz[0]) / (0.5 * RATE_HZ);
            (signal_rms.powi(2) + share * NOISE * NOISE).sqrt()
        };
        let check = |name: &str, found: Option<Found>, hz: [f64; 2], signal_rms: f64| {
            let found = found.unwrap_or_else(|| panic!("{name}"));
            let [from, to] = found.band_hz;
            assert!(from < hz[1] && to > hz[0] && to - from < 2.0 + hz[1] - hz[0], "{name}: {found:?}");
            // Parts of two seconds spread some of it beside the band.
            for rms in found.rms_ent {
                let ratio = rms / expected(signal_rms, &found);
                assert!((0.65..1.2).contains(&ratio), "{name}: {ratio} {found:?}");
            }
        };
        let size = 0.15;
        let rms = size / 2.0_f64.sqrt();
        check("half", found(21, |t, _, _| size * (TAU * 15.9 * t + 0.4).sin()), [15.9, 15.9], rms);
        let field = |i: usize| ((i * i) % 7) as f64 / 3.0 - 1.0;
        // Squares of whole numbers leave 0, 1, 4, 2, 2, 4 and 1 of seven: the squares of the field are 1, 4/9, 1/9, 1/9, 1/9, 1/9 and 4/9, a third in the mean.
        let of_field = rms * (1.0_f64 / 3.0).sqrt();
        check("field", found(22, |t, i, _| 2.0 * size * field(i) * (TAU * 3.3 * t).sin()), [3.3, 3.3], 2.0 * of_field);
        let moving = |t: f64| TAU * (5.0 * t + 0.5 * t * t / 630.0);
        check("moving", found(23, |t, _, _| 1.5 * size * moving(t).sin()), [5.0, 6.0], 1.5 * rms);
    }
}
