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
/// A wave is so many such frequencies away from zero, so that the spectrum of the field is even about it, and from half the sample rate, so
/// that its own image is not beside it.
const ASIDE: [f64; 2] = [72.0, 14.0];
/// A wave is seen that has so many times the power of the noise beside it: noise has it once in 1e4 windows.
const SEEN: f64 = 6.0;
/// A line beside it stands out that has so many times the power of the noise.
const STRONG: f64 = 30.0;

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

/// Looks for every wave of the wheels and every line, in this order; `removed` is what is taken off the vectors of the stretches.
pub(super) fn seen(day: &Day, stretches: &[Stretch], removed: &[[f64; 3]]) -> Vec<Seen> {
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
        waves.iter().map(|wave| of_window(day, stretch, wave, *begin, entries.clone(), &removed[*offset..])).collect::<Vec<_>>()
    });
    let mut all = vec![Seen::default(); waves.len()];
    for (index, all) in all.iter_mut().enumerate() {
        for (seen, beside) in found.iter().filter_map(|own| own[index]) {
            all.windows += 1;
            all.seen += usize::from(seen);
            all.beside += usize::from(beside);
        }
    }
    all
}

/// Whether a wave is seen in a window, and a line beside it is left there; `None` where that cannot be told.
fn of_window(
    day: &Day,
    stretch: &Stretch,
    wave: &Wave,
    begin: usize,
    entries: Range<usize>,
    removed: &[[f64; 3]],
) -> Option<(bool, bool)> {
    if (entries.len() as f64) < LEAST_PRESENT * WINDOW as f64 {
        return None;
    }
    let rate_hz = day.mode.rate_hz;
    let time = |entry: usize| day.times[stretch.rows[entry] as usize];
    let ends = [time(entries.start), time(entries.end - 1)];
    let range_hz = match wave {
        Wave::Line(hz) => [*hz, *hz],
        Wave::Wheel(wheel, harmonic) => {
            let [from, to] = [day.table.place(ends[0], 0)?.0, day.table.place(ends[1], 0)?.0];
            day.table.rates_between(*wheel, from, to).map(|hz| hz * f64::from(*harmonic))
        }
    };
    let [low, high] = alias_range_hz(range_hz, rate_hz);
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
    Some((own > SEEN * noise, strongest > STRONG * noise))
}
