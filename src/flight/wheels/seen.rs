//! Whether waves are in the data where the table of rates and the list of lines have them.

use super::rates::alias_range_hz;
use super::{Day, Stretch, in_parallel, seconds};
use crate::fit::statistics::central_median;
use realfft::num_complex::Complex;
use std::f64::consts::TAU;
use std::ops::Range;

/// Steps of a window.
const WINDOW: usize = 512;
/// Windows of a mode that are looked at, at most; they are spread over it.
const MOST_WINDOWS: usize = 100;
/// Share of the steps of a window that have a vector, at least.
const LEAST_PRESENT: f64 = 0.8;
/// Frequencies of the transform on either side of a wave that are compared with it. Those next to it, up to [`NEXT`], are its own.
const BESIDE: i32 = 24;
const NEXT: i32 = 2;
/// Waves that are nearer than so many of them draw each other's maximum.
const APART: i32 = 8;
/// A wave is so many such frequencies away from zero, so that the spectrum of the field is even about it, and from half the sample rate, so
/// that its own image is not beside it.
const ASIDE: [f64; 2] = [72.0, 14.0];
/// A wave is seen that has so many times the power of the noise beside it: noise has it once in 1e4 windows.
const SEEN: f64 = 6.0;
/// A line beside it stands out that has so many times the power of the noise.
const STRONG: f64 = 30.0;

/// Windows that say how late a table is, at least,
const LEAST_OFFSETS: usize = 20;
/// and by so many standard uncertainties and so much, s: rates of a table are linear between rows of some seconds.
const STDS: f64 = 5.0;
const LEAST_LATE_S: f64 = 10.0;
/// Windows with more times the usual distance from the others are left out: another line is beside the wave there.
const OUTSTANDING: f64 = 3.0;

/// How late the rates of a table are.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct RatesLate {
    /// By so much, s; negative if they are early.
    pub late_s: f64,
    /// Standard uncertainty, s.
    pub std_s: f64,
}

/// The frequency of a wave less that of the table, and how fast the rate changes.
#[derive(Clone, Copy, Debug)]
struct Offset {
    offset_hz: f64,
    hz_per_s: f64,
}

/// In how many windows of a mode a wave was looked for, and what was found there.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Seen {
    /// Windows that were looked at.
    pub windows: usize,
    /// Of these, with the wave above the noise.
    pub seen: usize,
    /// Of these, with a strong line close beside it that is left.
    pub beside: usize,
}

/// A wave of a wheel, or a line.
enum Wave {
    Wheel(usize, u32),
    Line(f64),
}

/// What is found of a wave in a window.
#[derive(Clone, Copy)]
struct InWindow {
    /// It is above the noise.
    seen: bool,
    /// A strong line is left close beside it.
    beside: bool,
    /// Of a strong wave of a wheel.
    offset: Option<Offset>,
}

/// Looks for every wave of the wheels and every line, in this order, and how late the rates are; `removed` is what is taken off the vectors of the
/// stretches.
pub(super) fn seen(day: &Day, stretches: &[Stretch], removed: &[[f64; 3]]) -> (Vec<Seen>, Option<RatesLate>) {
    let wheels = (0..day.table.wheels()).flat_map(|wheel| day.options.harmonics.iter().map(move |h| Wave::Wheel(wheel, *h)));
    let waves: Vec<Wave> = wheels.chain(day.mode.lines_hz.iter().map(|hz| Wave::Line(*hz))).collect();
    let mut windows: Vec<(&Stretch, usize, usize)> = Vec::new();
    let mut offset = 0;
    for stretch in stretches {
        windows.extend((0..stretch.length() / WINDOW).map(|index| (stretch, offset, index * WINDOW)));
        offset += stretch.rows.len();
    }
    let is_counted = |(stretch, _, begin): &(&Stretch, usize, usize)| {
        let row = stretch.rows.get(stretch.entries(*begin..begin + WINDOW / 2).end);
        let counts = |row: &u32| day.options.counted.as_ref().is_none_or(|span| span.contains(&day.times[*row as usize]));
        row.is_some_and(counts)
    };
    windows.retain(is_counted);
    let stride = windows.len().div_ceil(MOST_WINDOWS).max(1);
    let windows: Vec<_> = windows.into_iter().step_by(stride).collect();
    let found = in_parallel(&windows, |(): &mut (), (stretch, offset, begin)| {
        let entries = stretch.entries(*begin..begin + WINDOW);
        let of = |wave| of_window(day, stretch, (wave, &waves), *begin, entries.clone(), &removed[*offset..]);
        (0..waves.len()).map(of).collect::<Vec<_>>()
    });
    let mut all = vec![Seen::default(); waves.len()];
    for (index, all) in all.iter_mut().enumerate() {
        for own in found.iter().filter_map(|own| own[index]) {
            all.windows += 1;
            all.seen += usize::from(own.seen);
            all.beside += usize::from(own.beside);
        }
    }
    let offsets = found.iter().flatten().flatten().filter_map(|own| own.offset).collect();
    (all, rates_late(offsets))
}

/// A table that is late has the rates of some time before: waves are off by what the rates change in that time.
fn rates_late(mut offsets: Vec<Offset>) -> Option<RatesLate> {
    let late = |list: &[Offset]| {
        let [products, squares] = list.iter().fold([0.0, 0.0], |[products, squares], own| {
            [products + own.offset_hz * own.hz_per_s, squares + own.hz_per_s * own.hz_per_s]
        });
        (products / squares, squares)
    };
    let left = |own: &Offset, late_s: f64| (own.offset_hz - late_s * own.hz_per_s).abs();
    let (first_s, _) = late(&offsets);
    let usual = central_median(&mut offsets.iter().map(|own| left(own, first_s)).collect::<Vec<f64>>());
    offsets.retain(|own| left(own, first_s) <= OUTSTANDING * usual);
    if offsets.len() < LEAST_OFFSETS {
        return None;
    }
    let (late_s, squares) = late(&offsets);
    let sum: f64 = offsets.iter().map(|own| left(own, late_s).powi(2)).sum();
    let std_s = (sum / (offsets.len() - 1) as f64 / squares).sqrt();
    (late_s.abs() > LEAST_LATE_S && late_s.abs() > STDS * std_s).then_some(RatesLate { late_s, std_s })
}

/// Lowest and highest frequency of a wave between two times, and by how much it changes.
fn range_hz(day: &Day, wave: &Wave, ends: [i64; 2]) -> Option<([f64; 2], f64)> {
    match wave {
        Wave::Line(hz) => Some(([*hz, *hz], 0.0)),
        Wave::Wheel(wheel, harmonic) => {
            let [from, to] = [day.table.place(ends[0], 0)?.0, day.table.place(ends[1], 0)?.0];
            let change_hz = day.table.rate_hz(*wheel, to) - day.table.rate_hz(*wheel, from);
            let times = f64::from(*harmonic);
            Some((day.table.rates_between(*wheel, from, to).map(|hz| hz * times), change_hz * times))
        }
    }
}

/// What is found of a wave, one of all, in a window; `None` where that cannot be told.
fn of_window(
    day: &Day,
    stretch: &Stretch,
    (wave, waves): (usize, &[Wave]),
    begin: usize,
    entries: Range<usize>,
    removed: &[[f64; 3]],
) -> Option<InWindow> {
    if (entries.len() as f64) < LEAST_PRESENT * WINDOW as f64 {
        return None;
    }
    let rate_hz = day.mode.rate_hz;
    let time = |entry: usize| day.times[stretch.rows[entry] as usize];
    let ends = [time(entries.start), time(entries.end - 1)];
    let others = waves.iter().enumerate().filter(|(index, _)| *index != wave).map(|(_, other)| other);
    let wave = &waves[wave];
    let (own_hz, change_hz) = range_hz(day, wave, ends)?;
    let [low, high] = alias_range_hz(own_hz, rate_hz);
    let aside_hz = ASIDE.map(|aside| aside * rate_hz / WINDOW as f64);
    if low < aside_hz[0] || high > 0.5 * rate_hz - aside_hz[1] {
        return None;
    }
    let mean =
        |c: usize| entries.clone().map(|entry| day.field[c][stretch.rows[entry] as usize]).sum::<f64>() / entries.len() as f64;
    let mean: [f64; 3] = std::array::from_fn(mean);
    let count = (2 * BESIDE + 1) as usize;
    // Of the readings, and of what is left of them.
    let mut sums = [vec![[Complex::new(0.0, 0.0); 3]; count], vec![[Complex::new(0.0, 0.0); 3]; count]];
    let mut near = 0;
    for entry in entries {
        let turns = match wave {
            Wave::Line(hz) => hz * seconds(time(entry) - ends[0]),
            Wave::Wheel(wheel, harmonic) => {
                let place = day.table.place(time(entry), near)?.0;
                near = place.row();
                day.table.turns(*wheel, place) * f64::from(*harmonic)
            }
        };
        let part = (stretch.slots[entry] as usize - begin) as f64 / WINDOW as f64;
        let weight = 1.0 - (TAU * part).cos();
        let step = Complex::from_polar(1.0, -TAU * part);
        let mut turn = Complex::from_polar(weight, -TAU * (turns - f64::from(BESIDE) * part).fract());
        for k in 0..count {
            for c in 0..3 {
                let reading = day.field[c][stretch.rows[entry] as usize] - mean[c];
                sums[0][k][c] += turn * reading;
                sums[1][k][c] += turn * (reading - removed[entry][c]);
            }
            turn *= step;
        }
    }
    let [readings, left] =
        sums.map(|list| list.iter().map(|of| of.iter().map(|c| c.norm_sqr()).sum::<f64>()).collect::<Vec<f64>>());
    let is_own = |k: &usize| (*k as i32 - BESIDE).abs() <= NEXT;
    let mut beside: Vec<f64> = (0..count).filter(|k| !is_own(k)).map(|k| left[k]).collect();
    let strongest = beside.iter().copied().fold(0.0, f64::max);
    let noise = central_median(&mut beside);
    let own = (0..count).filter(is_own).map(|k| readings[k]).fold(0.0, f64::max);
    let is_strong = own > STRONG * noise && strongest <= STRONG * noise;
    let apart_hz = f64::from(APART) * rate_hz / WINDOW as f64;
    let is_apart = |other: &Wave| {
        let range = range_hz(day, other, ends).map(|(range_hz, _)| alias_range_hz(range_hz, rate_hz));
        range.is_none_or(|[from, to]| from > high + apart_hz || to < low - apart_hz)
    };
    let offset = (is_strong && others.into_iter().all(is_apart) && change_hz != 0.0).then(|| Offset {
        offset_hz: peak(&readings) * rate_hz / WINDOW as f64,
        hz_per_s: change_hz / seconds(ends[1] - ends[0]),
    });
    Some(InWindow { seen: own > SEEN * noise, beside: strongest > STRONG * noise, offset })
}

/// Where a line in the powers of a transform with the taper of Hann lies, in its frequencies from the middle one: from the two largest of those in
/// the middle, the exact place of a line without noise.
fn peak(powers: &[f64]) -> f64 {
    let middle = BESIDE as usize;
    let near = middle - NEXT as usize..=middle + NEXT as usize;
    let top = near.max_by(|a, b| powers[*a].total_cmp(&powers[*b])).unwrap_or(middle);
    let (side, next) = if powers[top + 1] > powers[top - 1] { (1.0, powers[top + 1]) } else { (-1.0, powers[top - 1]) };
    let ratio = (next / powers[top]).sqrt();
    top as f64 - middle as f64 + side * (2.0 * ratio - 1.0) / (1.0 + ratio)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    #[test]
    fn rates_that_are_late_are_told_from_those_of_the_right_time() {
        // Four wheels with rates that rise and fall by some tenths of a Hz an hour; every tenth window has another line beside it.
        let found = |by_s: f64| {
            let mut random = Random::seeded(4);
            let one = |k: usize| {
                let hz_per_s = [0.4, -0.5, -0.3, 0.2][k % 4] / 3600.0;
                let strange = if k % 10 == 9 { 0.03 } else { 0.0 };
                Offset { offset_hz: by_s * hz_per_s + 5e-4 * random.gaussian() + strange, hz_per_s }
            };
            rates_late((0..80).map(one).collect())
        };
        assert_eq!(found(0.0), None);
        for by_s in [32.184, -60.0] {
            let late = found(by_s).unwrap();
            assert!((late.late_s - by_s).abs() < 4.0 * late.std_s && late.std_s < 1.5, "{late:?}");
        }
    }

    #[test]
    fn the_place_of_a_line_is_between_frequencies_of_the_transform() {
        for place in [-1.4, -0.2, 0.0, 0.07, 0.5, 1.3] {
            let power = |k: i32| {
                let transform = |bin: f64| -> Complex<f64> {
                    let step = |n: usize| {
                        let part = n as f64 / WINDOW as f64;
                        Complex::from_polar(1.0 - (TAU * part).cos(), TAU * (place - bin) * part)
                    };
                    (0..WINDOW).map(step).sum()
                };
                transform(f64::from(k)).norm_sqr()
            };
            let powers: Vec<f64> = (-BESIDE..=BESIDE).map(power).collect();
            assert!((peak(&powers) - place).abs() < 1e-4, "{place}: {}", peak(&powers));
        }
    }
}
