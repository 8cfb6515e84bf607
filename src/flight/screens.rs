//! What the counts of a day show by themselves that cannot be right: a component or a thermistor that stands still, single counts far from
//! those beside them. Nothing is changed by it.

use super::Block;
use crate::data::flags::Flags;
use crate::data::time::{SECOND_NS, Tt2000};
use std::ops::Range;

/// As many equal counts in a row stand still: noise and rotation change some of them.
const LEAST_STILL: usize = 1000;
/// A thermistor has one reading for many vectors, and steps of 0.03 K: at rest it may keep one count for so long, ns.
const THERMISTOR_STILL_NS: i64 = 2 * 3600 * SECOND_NS;
/// A count stands out that differs from both neighbours, in the same direction, by so many times what neighbours usually differ by, and by so
/// many counts at least.
const OUTSTANDING: f64 = 50.0;
const LEAST_COUNTS: f64 = 20.0;
/// Its neighbours agree with each other within this part of it.
const AGREE: f64 = 0.1;
/// Every so many differences are enough to know their usual size.
const STRIDE: usize = 13;

/// Notes on the vectors of a stretch, which are counts as they came.
#[must_use]
pub fn notes(blocks: &[Block], span: &Range<Tt2000>, names: [&str; 4]) -> Vec<String> {
    let rows: Vec<(&Block, Range<usize>)> = blocks.iter().map(|b| (b, b.rows_in(span))).collect();
    let mut notes = Vec::new();
    let of = |column: fn(&Block, usize) -> &[f64], k: usize| -> Vec<&[f64]> {
        rows.iter().map(|(block, own)| &column(block, k)[own.clone()]).collect()
    };
    let times: Vec<&[Tt2000]> = rows.iter().map(|(block, own)| &block.time[own.clone()]).collect();
    for (k, name) in names.into_iter().enumerate() {
        let parts = if k < 3 { of(|b, k| &b.field[k], k) } else { of(|b, _| &b.thermistor, k) };
        let least_ns = if k < 3 { 0 } else { THERMISTOR_STILL_NS };
        if let Some((count, value)) = longest_still(&parts, &times, least_ns) {
            notes.push(format!("`{name}` stands still: {count} vectors one after the other have the count {value}"));
        }
        if k < 3 {
            let usual = usual(&parts);
            let found: usize = rows.iter().map(|(block, own)| outstanding(block, own, k, usual)).sum();
            if found > 0 {
                notes.push(format!("{found} counts of `{name}` stand out of those on either side; nothing was done about them"));
            }
        }
    }
    notes
}

/// The longest run of equal values, if it is long enough to say something, also in time, and takes at least half of all.
fn longest_still(parts: &[&[f64]], times: &[&[Tt2000]], least_ns: i64) -> Option<(usize, f64)> {
    let (mut last, mut run, mut begin) = (f64::NAN, 0, 0);
    let (mut best, mut lasted_ns) = ((0, f64::NAN), 0);
    for (value, time) in parts.iter().copied().flatten().zip(times.iter().copied().flatten()) {
        if *value == last {
            run += 1;
        } else {
            (run, begin) = (1, *time);
        }
        last = *value;
        if run > best.0 {
            (best, lasted_ns) = ((run, last), time - begin);
        }
    }
    let all: usize = parts.iter().map(|part| part.len()).sum();
    Some(best).filter(|(count, _)| *count >= LEAST_STILL && 2 * count >= all && lasted_ns >= least_ns)
}

/// How much neighbours usually differ.
fn usual(parts: &[&[f64]]) -> f64 {
    let pairs = parts.iter().flat_map(|part| part.windows(2).step_by(STRIDE));
    let mut steps: Vec<f64> = pairs.map(|w| (w[1] - w[0]).abs()).filter(|d| d.is_finite()).collect();
    if steps.is_empty() {
        return f64::INFINITY;
    }
    let middle = steps.len() / 2;
    *steps.select_nth_unstable_by(middle, f64::total_cmp).1
}

fn outstanding(block: &Block, rows: &Range<usize>, component: usize, usual: f64) -> usize {
    let least = (OUTSTANDING * usual).max(LEAST_COUNTS);
    let values = &block.field[component][rows.clone()];
    let is_one = |i: usize| {
        let (from, to) = (values[i] - values[i - 1], values[i] - values[i + 1]);
        from * to > 0.0
            && from.abs().min(to.abs()) > least
            && (from - to).abs() < AGREE * from.abs().min(to.abs())
            && !Flags(block.flags[rows.start + i]).any_of(Flags::GAP)
            && !Flags(block.flags[rows.start + i + 1]).any_of(Flags::GAP)
            && block.mode[rows.start + i - 1] == block.mode[rows.start + i + 1]
    };
    (1..values.len().saturating_sub(1)).filter(|i| is_one(*i)).count()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(x: impl Fn(usize) -> f64, n: usize) -> Block {
        let noise = |i: usize| ((i * 7919) % 11) as f64;
        Block {
            time: (0..n as i64).collect(),
            field: [(0..n).map(x).collect(), (0..n).map(noise).collect(), (0..n).map(|i| 3.0 * noise(i)).collect()],
            thermistor: (0..n).map(|i| 500.0 + (i % 3) as f64).collect(),
            flags: vec![0; n],
            mode: vec![0; n],
            ..Block::default()
        }
    }

    #[test]
    fn what_stands_still_or_out_is_told_and_nothing_else() {
        let names = ["bx", "by", "bz", "t_ob"];
        let of = |block: Block| notes(&[block], &(0..i64::MAX), names);
        let wave = |i: usize| 1000.0 * (i as f64 / 30.0).sin() + (i % 5) as f64;
        assert!(of(block(wave, 4000)).is_empty());
        assert_eq!(of(block(|_| 17.0, 4000)), ["`bx` stands still: 4000 vectors one after the other have the count 17"]);
        let spiky = of(block(|i| if i % 1500 == 700 { 90_000.0 } else { wave(i) }, 4000));
        assert_eq!(spiky, ["3 counts of `bx` stand out of those on either side; nothing was done about them"]);
        // A thermistor at rest keeps its count for minutes, not for hours.
        let at_rest = |step_ns: i64| Block {
            time: (0..4000).map(|i| i * step_ns).collect(),
            thermistor: vec![500.0; 4000],
            ..block(wave, 4000)
        };
        assert!(of(at_rest(SECOND_NS)).is_empty());
        assert_eq!(of(at_rest(2 * SECOND_NS)), ["`t_ob` stands still: 4000 vectors one after the other have the count 500"]);
        // A step stands out of nothing.
        assert!(of(block(|i| if i < 2000 { wave(i) } else { 90_000.0 + wave(i) }, 4000)).is_empty());
    }
}
