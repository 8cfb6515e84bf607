//! What the counts of a day show by themselves that cannot be right: a component or a thermistor that stands still, single counts far from
//! those beside them, temperatures that jump. Nothing is changed by it but flags.

use super::Block;
use super::temperature::{Thermometer, packets};
use crate::data::flags::Flags;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::fit::statistics::median;
use crate::record::temperature_faults::{jumps_of, off_level};
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
/// The time between vectors is taken over so many of them at once, since tags are rounded.
const IN_ONE: usize = 16;
/// Of fewer such vectors of a mode nothing is said.
const LEAST_VECTORS: usize = 40;
/// Vectors of a mode are never closer than this part of its step.
const TOO_CLOSE: f64 = 0.8;
/// It may differ by this part from the rate that the mode states: clocks run wrong by less than a thousandth.
const OF_RATE: f64 = 5e-3;
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

/// Notes on modes whose vectors follow each other in another time than their rate has it; `modes` are the names and rates, Hz, of all modes, a
/// rate absent where it is not known.
#[must_use]
pub fn cadences(blocks: &[Block], span: &Range<Tt2000>, modes: &[(&str, Option<f64>)]) -> Vec<String> {
    let mut times: Vec<Vec<Tt2000>> = vec![Vec::new(); modes.len()];
    for block in blocks {
        block.rows_in(span).for_each(|row| times[usize::from(block.mode[row])].push(block.time[row]));
    }
    let told = |(times, (sid, rate_hz)): (&Vec<Tt2000>, &(&str, Option<f64>))| {
        let rate_hz = (*rate_hz)?;
        #[expect(clippy::cast_precision_loss, reason = "differences of times")]
        let seconds = |ns: i64| ns as f64 / SECOND_NS as f64;
        // Vectors one after the other, without gaps: rows of packets that are lost are no other cadence.
        let step_s = |window: &[Tt2000]| {
            let steps = || window.windows(2).map(|pair| pair[1] - pair[0]);
            let (shortest, longest) = (steps().min()?, steps().max()?);
            (2 * longest < 3 * shortest).then(|| seconds(window[IN_ONE] - window[0]) / IN_ONE as f64)
        };
        let is_other = |step_s: &f64| (step_s * rate_hz - 1.0).abs() > OF_RATE;
        let mut others: Vec<f64> = times.windows(IN_ONE + 1).filter_map(step_s).filter(is_other).collect();
        let close = times.windows(2).filter(|pair| seconds(pair[1] - pair[0]) * rate_hz < TOO_CLOSE).count();
        if others.len() >= LEAST_VECTORS {
            let step_s = median(&mut others);
            return Some(format!(
                "{} vectors of mode {sid} follow each other every {step_s:.4} s, and its rate has {:.4} s: their mode, and with it their time \
                 shift, or their times are wrong",
                others.len() + IN_ONE,
                1.0 / rate_hz
            ));
        }
        (close >= LEAST_VECTORS).then(|| {
            format!(
                "{close} vectors of mode {sid} come less than {TOO_CLOSE} of its step after the one before: packets have wrong times, or lie over \
                 each other"
            )
        })
    };
    times.iter().zip(modes).filter_map(told).collect()
}

/// Looks for jumps of the temperature from packet to packet that are more than a thermistor can do. The vectors of stretches between them that
/// stand on another level than most of the day get the flag TEMPERATURE; gives a note where there are some. `packet_ns` are the lengths of the
/// packets of every mode.
pub fn temperature_jumps(
    blocks: &mut [Block],
    span: &Range<Tt2000>,
    name: &str,
    thermometer: &Thermometer,
    packet_ns: &[i64],
    leap: &LeapSeconds,
) -> Option<String> {
    let rows = || blocks.iter().map(|block| (block, block.rows_in(span)));
    let times: Vec<Tt2000> = rows().flat_map(|(block, own)| block.time[own].iter().copied()).collect();
    let counts: Vec<f64> = rows().flat_map(|(block, own)| block.thermistor[own].iter().copied()).collect();
    let modes: Vec<u8> = rows().flat_map(|(block, own)| block.mode[own].iter().copied()).collect();
    let begin = *times.first()?;
    #[expect(clippy::cast_precision_loss, reason = "differences of times within a day")]
    let since_s = |time: Tt2000| (time - begin) as f64 / SECOND_NS as f64;
    let length_ns = |row: usize| packet_ns.get(usize::from(modes[row])).copied().unwrap_or(0);
    let readings = packets(&times, &counts, length_ns).into_iter().map(|rows| (since_s(times[rows.start]), counts[rows.start]));
    let readings = readings.map(|(t_s, count)| (t_s, thermometer.degc(count))).filter(|(_, degc)| degc.is_finite());
    let readings: Vec<(f64, f64)> = readings.collect();
    let jumps = jumps_of(readings.clone());
    let largest = jumps.iter().copied().reduce(|a, b| if b.1.abs() > a.1.abs() { b } else { a })?;
    let spans = off_level(&readings, &jumps);
    let (mut flagged, mut next) = (0, 0);
    for block in blocks.iter_mut() {
        for row in block.rows_in(span) {
            let t_s = since_s(block.time[row]);
            while spans.get(next).is_some_and(|(_, until)| until.is_some_and(|until| until <= t_s)) {
                next += 1;
            }
            if spans.get(next).is_some_and(|(from, _)| *from <= t_s) {
                block.flags[row] |= Flags::TEMPERATURE.0;
                flagged += 1;
            }
        }
    }
    #[expect(clippy::cast_possible_truncation, reason = "times within a day")]
    let at = |t_s: f64| leap.utc(begin + (t_s * SECOND_NS as f64).round() as i64);
    let (times, most) = if jumps.len() == 1 { ("once".to_owned(), "") } else { (format!("{} times", jumps.len()), "most ") };
    Some(format!(
        "`{name}` jumps {times} by more than a thermistor can do, {most}by {:+.1} K at {}: {flagged} vectors on another level than most have the flag \
         TEMPERATURE",
        largest.1,
        at(largest.0)
    ))
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

    /// A thermistor of 1 K per 100 counts that warms by 0.36 K an hour, in packets of 16 vectors and seconds.
    fn warming(add: impl Fn(usize) -> f64) -> Block {
        let thermistor = (0..4000).map(|i| ((i / 16 * 16) as f64 * 0.01).round() + add(i)).collect();
        Block { time: (0..4000).map(|i| i * SECOND_NS).collect(), thermistor, ..block(|_| 0.0, 4000) }
    }

    #[test]
    fn temperatures_that_jump_are_told_and_flagged_and_a_course_is_none() {
        let slope = 65_535.0 / 5.0 / 100.0;
        let thermometer = Thermometer { coefficients: vec![0.0, slope], t_off_degc: 0.0 };
        let found = |block: Block| {
            let mut blocks = [block];
            let note =
                temperature_jumps(&mut blocks, &(0..i64::MAX), "t_ob", &thermometer, &[16 * SECOND_NS], &LeapSeconds::default());
            let flagged: Vec<usize> = (0..4000).filter(|row| blocks[0].flags[*row] & Flags::TEMPERATURE.0 != 0).collect();
            (note, flagged)
        };
        assert_eq!(found(warming(|_| 0.0)), (None, Vec::new()));
        // A heater: the body follows with a time constant of ten minutes.
        let heated_s = |i: usize| (i.saturating_sub(1600) / 16 * 16) as f64;
        assert_eq!(found(warming(|i| (500.0 * (1.0 - (-heated_s(i) / 600.0).exp())).round())).0, None);
        // By 4 K for ten packets; in one packet; for good.
        let (note, flagged) = found(warming(|i| if (1600..1760).contains(&i) { 400.0 } else { 0.0 }));
        assert_eq!(flagged, (1600..1760).collect::<Vec<_>>());
        let note = note.unwrap();
        assert!(
            note.starts_with("`t_ob` jumps 2 times by more than a thermistor can do, most by +4.0 K at 2000-01-01T12:25:"),
            "{note}"
        );
        assert!(note.ends_with("160 vectors on another level than most have the flag TEMPERATURE"), "{note}");
        let (_, flagged) = found(warming(|i| if (1600..1616).contains(&i) || (2400..2416).contains(&i) { -1000.0 } else { 0.0 }));
        assert_eq!(flagged, (1600..1616).chain(2400..2416).collect::<Vec<_>>());
        let (note, flagged) = found(warming(|i| if i >= 3200 { 2000.0 } else { 0.0 }));
        assert_eq!(flagged, (3200..4000).collect::<Vec<_>>());
        assert!(note.unwrap().contains("jumps once by more than a thermistor can do, by +20.0 K"));
        // The first packet alone; the last one of the day and one of its middle; one before and one behind a gap of ten minutes.
        let (note, flagged) = found(warming(|i| if i < 16 { -1000.0 } else { 0.0 }));
        assert_eq!((flagged, note.is_some()), ((0..16).collect::<Vec<_>>(), true));
        let (_, flagged) = found(warming(|i| if i >= 3984 || (2400..2416).contains(&i) { -1000.0 } else { 0.0 }));
        assert_eq!(flagged, (2400..2416).chain(3984..4000).collect::<Vec<_>>());
        for bad in [1584..1600, 1600..1616] {
            let mut block = warming(|i| if bad.contains(&i) || (2400..2416).contains(&i) { 700.0 } else { 0.0 });
            block.time[1600..].iter_mut().for_each(|time| *time += 600 * SECOND_NS);
            assert_eq!(found(block).1, bad.chain(2400..2416).collect::<Vec<_>>());
        }
    }

    #[test]
    fn vectors_of_another_cadence_than_their_mode_are_told() {
        // 20 Hz with tags in whole milliseconds of a clock that is fast by 1e-4, 2 of 100 vectors lost, then 1 Hz, then few of 5 Hz.
        let times = |cadence_s: f64, back_ns: i64| -> Block {
            let fast = (0..2000).filter(|i| i % 50 != 3).map(|i| ((i as f64 * cadence_s * 1.0001 * 1e3).round() * 1e6) as i64);
            let fast = fast.enumerate().map(|(i, time)| if i < 1000 { time } else { time - back_ns });
            let slow = (0..100).map(|i| (300 + i) * SECOND_NS);
            let few = (0..30).map(|i| 500 * SECOND_NS + i * SECOND_NS);
            let mode = [0].repeat(1960).into_iter().chain([1].repeat(100)).chain([2].repeat(30));
            let mut time: Vec<i64> = fast.collect();
            time.sort_unstable();
            Block { time: time.into_iter().chain(slow).chain(few).collect(), mode: mode.collect(), ..Block::default() }
        };
        let of = |block: Block, slow_hz: Option<f64>| {
            let modes = [("SID3", Some(20.0)), ("SID2", slow_hz), ("SID4", Some(5.0))];
            cadences(&[block], &(0..i64::MAX), &modes)
        };
        assert!(of(times(0.05, 0), Some(1.0)).is_empty() && of(times(0.05, 0), None).is_empty());
        let found = of(times(0.0505, 0), Some(20.0));
        assert!(found.len() == 2 && found[0].contains("vectors of mode SID3 follow each other every 0.0505 s"), "{found:?}");
        assert!(
            found[1].contains("100 vectors of mode SID2 follow each other every 1.0000 s, and its rate has 0.0500 s"),
            "{found:?}"
        );
        // The few of another mode among many.
        let mut block = times(0.05, 0);
        block.mode[1960..2060].fill(0);
        assert!(of(block, Some(1.0))[0].starts_with("100 vectors of mode SID3 follow each other every 1.0000 s"));
        // The clock was set back by 10.017 s in the middle.
        let found = of(times(0.05, 10_017_000_000), Some(1.0));
        assert!(found.len() == 1 && found[0].contains("vectors of mode SID3 come less than 0.8 of its step"), "{found:?}");
    }

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
