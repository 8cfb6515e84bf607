//! Housekeeping telemetry to physical units (RO-IGEP-TR0028 section 4.2.2), and whether it agrees with the telemetry.

use crate::data::time::{SECOND_NS, Tt2000};
use std::ops::Range;

/// Unsigned telemetry counts of `bits` bits, whose middle is zero, as counts from the lowest value.
#[must_use]
pub fn wrap(count: f64, bits: u32) -> f64 {
    let half = 2.0_f64.powi(bits as i32 - 1);
    if count < half { count + half } else { count - half }
}

/// Signed value of a byte; 80h is -128.
#[must_use]
pub fn signed8(count: f64) -> f64 {
    if count >= 128.0 { count - 256.0 } else { count }
}

/// Field of the housekeeping, enT, not calibrated.
#[must_use]
pub fn field_ent(count: f64) -> f64 {
    wrap(count, 16) * 32_768.0 / 65_535.0 - 16_384.0
}

/// Reference voltage, V, behind its divider.
#[must_use]
pub fn reference_v(count: f64) -> f64 {
    (wrap(count, 20) * 5.0 / 1_048_575.0 - 2.5) / (100_016.0 / 200_016.0)
}

/// Positive supply, V: what its byte tells of the difference from 5 V.
#[must_use]
pub fn positive_v(count: f64) -> f64 {
    5.0 + signed8(count) * 512.0 * 2.4996 / (1_048_575.0 * 90_956.0 / 190_928.0)
}

/// Negative supply, V.
#[must_use]
pub fn negative_v(count: f64) -> f64 {
    -5.0 + signed8(count) * 256.0 * 2.4996 / (1_048_575.0 * 27_400.0 / 127_424.0)
}

/// Of fewer readings nothing is said.
const LEAST_READINGS: usize = 20;
/// Two channels agree of which at most this part of the readings differ: the field turns within seconds when a boom moves.
const MOST_APART: f64 = 0.1;

/// Of a part of a day in which two channels differ this part of the readings does,
const APART: f64 = 0.9;
/// and so many readings are outside of it, where they agree.
const LEAST_OUTSIDE: usize = 5;

fn is_apart([own, telemetry]: &[f64; 2], floor: f64, part: f64) -> bool {
    (own - telemetry).abs() > floor + part * telemetry.abs()
}

/// Readings of the housekeeping that differ from those of the telemetry beside them by more than `floor` and a part of these; how many, and by how
/// much at most. `None` where the two agree, or are too few to say it.
#[must_use]
pub fn differing(pairs: &[[f64; 2]], floor: f64, part: f64) -> Option<(usize, f64)> {
    let differences = pairs.iter().filter(|pair| is_apart(pair, floor, part));
    let (count, most) = differences.fold((0, 0.0_f64), |(n, most), [own, telemetry]| (n + 1, most.max((own - telemetry).abs())));
    let is_enough = pairs.len() >= LEAST_READINGS && count as f64 >= MOST_APART * pairs.len() as f64;
    is_enough.then_some((count, most))
}

/// The readings, in the order of their times, in which one of some channels differs from the telemetry, where these are a part of a day and both agree
/// outside of it: another gain or sign from a moment on, or for some time. `None` where there is no such part; the channels have the same times.
#[must_use]
pub fn part_apart(channels: &[Vec<[f64; 2]>], floor: f64, part: f64) -> Option<Range<usize>> {
    let count = channels.iter().map(Vec::len).min()?;
    let apart: Vec<bool> = (0..count).map(|row| channels.iter().any(|list| is_apart(&list[row], floor, part))).collect();
    // The part with the most readings that differ, less those that agree.
    let (mut best, mut most) = (0..0, 0);
    let (mut from, mut sum) = (0, 0);
    for (row, is_apart) in apart.iter().enumerate() {
        if sum <= 0 {
            (from, sum) = (row, 0);
        }
        sum += if *is_apart { 1 } else { -1 };
        if sum > most {
            (best, most) = (from..row + 1, sum);
        }
    }
    let inside = apart[best.clone()].iter().filter(|own| **own).count();
    let outside = apart.iter().filter(|own| **own).count() - inside;
    let (length, rest) = (best.len(), count - best.len());
    let is_part = length >= LEAST_READINGS && inside as f64 >= APART * length as f64;
    (is_part && rest >= LEAST_OUTSIDE && outside as f64 <= MOST_APART * rest as f64).then_some(best)
}

/// The factor by which all three components of the housekeeping are those of the telemetry; `None` without one.
#[must_use]
pub fn common_factor(pairs: &[Vec<[f64; 2]>], floor: f64, part: f64) -> Option<f64> {
    let (products, squares) = pairs
        .iter()
        .flatten()
        .fold((0.0, 0.0), |(products, squares), [own, telemetry]| (products + own * telemetry, squares + telemetry * telemetry));
    let factor = products / squares;
    let scaled = |list: &Vec<[f64; 2]>| list.iter().map(|[own, telemetry]| [*own, factor * telemetry]).collect::<Vec<_>>();
    let is_large = pairs.iter().flatten().filter(|[own, _]| own.abs() > 2.0 * floor).count() >= LEAST_READINGS;
    (is_large && pairs.iter().all(|list| differing(&scaled(list), floor, part).is_none())).then_some(factor)
}

/// A thermistor that keeps one count for longer, ns, has to be at rest,
const STILL_NS: i64 = 3600 * SECOND_NS;
/// and one that is at rest has counts in the housekeeping that differ by less than this: noise and rounding of two converters.
const AT_REST_COUNTS: f64 = 10.0;

/// The readings, in the order of their times, of the longest stretch over which a channel of the telemetry keeps one count while that of the housekeeping
/// moves, and by how many counts that moves. Pairs are of housekeeping and telemetry.
#[must_use]
pub fn still_while_moving(times: &[Tt2000], pairs: &[[f64; 2]]) -> Option<(Range<usize>, f64)> {
    let mut best: Option<(Range<usize>, f64)> = None;
    let lasted = |rows: &Range<usize>| times[rows.end - 1] - times[rows.start];
    let mut begin = 0;
    for stretch in pairs.chunk_by(|a, b| a[1] == b[1]) {
        let rows = begin..begin + stretch.len();
        begin = rows.end;
        let (low, high) =
            stretch.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), own| (low.min(own[0]), high.max(own[0])));
        let is_longest = best.as_ref().is_none_or(|(longest, _)| lasted(&rows) > lasted(longest));
        if lasted(&rows) >= STILL_NS && high - low >= AT_REST_COUNTS && is_longest {
            best = Some((rows, high - low));
        }
    }
    best
}

/// Delays that are tried, s, from one to the next and up to the longest one.
const DELAY_STEP_S: i64 = 16;
const LONGEST_DELAY_S: i64 = 1808;
/// Readings that are compared are so far apart, ns.
const LEAST_APART_NS: i64 = 60 * SECOND_NS;
/// Variance of the difference of two whole numbers that are rounded each.
const ROUNDING: f64 = 1.0 / 6.0;
/// Logarithm of the probability by which a delay is better than none: e¹⁵ is a thousand times the delays and days of a year.
const CLEAR: f64 = 15.0;

/// By how much the counts of a channel in the housekeeping come later than the same in the telemetry, s, to a step of 16 s; negative if they are
/// earlier. `None` where they agree, or where they change too little to say it. Readings may differ by a constant.
#[must_use]
pub fn late_s(housekept: &[(Tt2000, f64)], telemetry: &dyn Fn(Tt2000) -> Option<f64>) -> Option<f64> {
    // A temperature changes little within a minute: more readings tell nothing more.
    let mut sorted = housekept.to_vec();
    sorted.sort_by_key(|(time, _)| *time);
    let mut apart: Vec<(Tt2000, f64)> = Vec::new();
    for own in sorted {
        if apart.last().is_none_or(|last| own.0 - last.0 >= LEAST_APART_NS) {
            apart.push(own);
        }
    }
    let without: Vec<(Tt2000, f64, f64)> =
        apart.iter().filter_map(|(time, count)| Some((*time, *count, count - telemetry(*time)?))).collect();
    let gain = |by_s: i64| -> f64 {
        let moved = |(time, count, without): &(Tt2000, f64, f64)| Some([count - telemetry(time - by_s * SECOND_NS)?, *without]);
        let both: Vec<[f64; 2]> = without.iter().filter_map(moved).collect();
        if both.len() < LEAST_READINGS {
            return 0.0;
        }
        let n = both.len() as f64;
        let [with, without] = [0, 1].map(|k| {
            let mean = both.iter().map(|own| own[k]).sum::<f64>() / n;
            both.iter().map(|own| (own[k] - mean).powi(2)).sum::<f64>() + ROUNDING * n
        });
        0.5 * n * (without / with).ln()
    };
    let steps = LONGEST_DELAY_S / DELAY_STEP_S;
    let all = (-steps..=steps).map(|step| step * DELAY_STEP_S).map(|by_s| (by_s, gain(by_s)));
    let (by_s, best) = all.max_by(|a, b| a.1.total_cmp(&b.1))?;
    (best > CLEAR).then_some(by_s as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thermistor_that_keeps_a_count_while_the_housekeeping_moves_is_found() {
        // A reading every minute over two hours; the housekeeping warms by a count every two minutes.
        let times: Vec<Tt2000> = (0..120).map(|i| i * 60 * SECOND_NS).collect();
        let of = |telemetry: &dyn Fn(usize) -> f64, housekept: &dyn Fn(usize) -> f64| {
            let pairs: Vec<[f64; 2]> = (0..120).map(|i| [housekept(i), telemetry(i)]).collect();
            still_while_moving(&times, &pairs)
        };
        let warming = |i: usize| 500.0 + (i / 2) as f64;
        assert_eq!(of(&warming, &warming), None);
        // At rest, with the noise of a count.
        assert_eq!(of(&|_| 500.0, &|i| 500.0 + (i % 3) as f64), None);
        // From the 20th reading on, and for half an hour.
        let stuck = |i: usize| warming(i.min(20));
        assert_eq!(of(&stuck, &warming), Some((20..120, 49.0)));
        assert_eq!(of(&|i| if i < 50 { warming(i.min(20)) } else { warming(i) }, &warming), None);
    }

    #[test]
    fn times_of_a_thermistor_are_told_by_its_course() {
        // A temperature that swings by 40 counts in three hours, read every 32 s, and every 64 s by the housekeeping with another offset.
        let count = |time: Tt2000| (20.0 * (time as f64 * 1e-9 / 1700.0).sin()).round();
        let telemetry = |time: Tt2000| (0..7200 * SECOND_NS).contains(&time).then(|| count(time - time % (32 * SECOND_NS)));
        let late = |by_s: i64| {
            let rows: Vec<(Tt2000, f64)> =
                (0..112).map(|k| (64 * k + 11) * SECOND_NS).map(|time| (time + by_s * SECOND_NS, count(time) + 3.0)).collect();
            late_s(&rows, &telemetry)
        };
        assert_eq!(late(0), None);
        for by_s in [1200, -1200] {
            assert!((late(by_s).unwrap() - by_s as f64).abs() <= 48.0, "{:?}", late(by_s));
        }
        // A temperature that stands tells nothing.
        let still: Vec<(Tt2000, f64)> = (0..112).map(|k| (64 * k * SECOND_NS, 5.0)).collect();
        assert_eq!(late_s(&still, &|_| Some(5.0)), None);
    }

    #[test]
    fn the_factors_are_those_that_the_report_prints() {
        assert!((positive_v(1.0) - 5.0 - 0.002_562_0).abs() < 5e-8);
        assert!((negative_v(1.0) + 5.0 - 0.002_838_0).abs() < 5e-8);
        // 80h is the lowest value of both.
        assert!((positive_v(128.0) - (5.0 - 128.0 * 0.002_562_0)).abs() < 1e-5);
        assert!((positive_v(127.0) - 5.325).abs() < 1e-3);
        // Counts that begin with 8 are negative fields.
        assert!((field_ent(32_768.0) + 16_384.0).abs() < 1e-9 && (field_ent(32_767.0) - 16_384.0).abs() < 1e-9);
        assert!((field_ent(0.0) - 0.25).abs() < 1e-3);
        assert!((reference_v(0.0)).abs() < 1e-5);
    }

    #[test]
    fn readings_that_differ_now_and_then_are_not_told() {
        // Of 40 readings some have another scale.
        let pairs = |wrong: usize| (0..40).map(|k| [if k < wrong { 220.0 } else { 205.0 }, 200.0]).collect::<Vec<[f64; 2]>>();
        assert_eq!(differing(&pairs(4), 5.0, 0.05), Some((4, 20.0)));
        assert_eq!(differing(&pairs(3), 5.0, 0.05), None);
        assert_eq!(differing(&pairs(40), 10.0, 0.05), None);
        assert_eq!(differing(&pairs(40)[..19], 5.0, 0.05), None);
    }

    #[test]
    fn a_part_of_a_day_is_one_outside_of_which_the_channels_agree() {
        // 80 readings of a channel, and another one that agrees.
        let part = |is_wrong: &dyn Fn(usize) -> bool| {
            let own = (0..80).map(|row| [if is_wrong(row) { 400.0 } else { 201.0 }, 200.0]).collect::<Vec<[f64; 2]>>();
            part_apart(&[vec![[50.0, 51.0]; 80], own], 10.0, 0.05)
        };
        assert_eq!(part(&|row| row >= 50), Some(50..80));
        assert_eq!(part(&|row| row < 30 && row != 11), Some(0..30));
        assert_eq!(part(&|row| (30..55).contains(&row) || row == 70), Some(30..55));
        // Too short, all day, and now and then.
        assert_eq!(part(&|row| row >= 61), None);
        assert_eq!(part(&|_| true), None);
        assert_eq!(part(&|row| row % 3 == 0), None);
        assert_eq!(part(&|_| false), None);
    }

    #[test]
    fn a_factor_is_one_of_all_components() {
        let pairs = |by: [f64; 3]| {
            let one = |i: usize| {
                (0..40).map(|k| [by[i] * f64::from(100 * (i as i32 + 1) + k % 3), f64::from(100 * (i as i32 + 1))]).collect()
            };
            [0, 1, 2].map(one)
        };
        let of = |by: [f64; 3]| common_factor(&pairs(by), 10.0, 0.05);
        assert!((of([-1.0; 3]).unwrap() + 1.0).abs() < 0.02 && (of([10.0; 3]).unwrap() - 10.0).abs() < 0.2);
        assert_eq!(of([0.57, 0.97, 0.61]), None);
    }
}
