//! By how much the times of one sensor are late against those of another one.
//!
//! The external field and what the spacecraft makes reach both sensors at once, whatever the size of it at either. Changes over a few seconds are
//! compared, since errors of offsets and slow drifts are not in them, and are moved against each other second by second.

use super::comparison::Course;
use crate::data::time::{SECOND_NS, Tt2000};
use crate::fit::statistics::median;
use nalgebra::Vector3;
use std::collections::BTreeSet;

/// A change is that over at least so long, s: noise of single seconds is small beside it, and a delay of seconds is not,
const LEAST_CHANGE_S: i64 = 8;
/// and at most so long, s: a sensor in the background has a vector every 32 s, and some are lost.
const LONGEST_CHANGE_S: i64 = 128;
/// Delays that are tried, s. With longer ones the sensors have no changes in common, which [`super::comparison`] tells.
const MOST_S: i64 = 60;
/// Changes of more times the usual one are left out, and differences of more count as so many of it: jumps, bad readings.
const OUTSTANDING: f64 = 3.0;
/// Changes that are judged together, in a row; of fewer such blocks than these nothing is said.
const BLOCK: usize = 10;
const LEAST_BLOCKS: usize = 3;
/// A delay is told if this part of the blocks have smaller differences with it: a single disturbance of one sensor is in few of them,
const AGREEING: f64 = 0.75;
/// if the differences of all have so many times smaller squares,
const FEWER_SQUARES: f64 = 1.25;
/// the logarithm of its likelihood is so much larger,
const CLEAR: f64 = 15.0;
/// and it is so many times its standard uncertainty.
const STDS: f64 = 5.0;
/// Vectors of a mode may lie at other parts of their second in either sensor: with means of seconds that is up to 1 s of delay. One of a single mode is
/// told if it is so much, s.
const LEAST_OF_MODE_S: f64 = 2.0;

/// How late one sensor is against another one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Delay {
    /// The field of the second sensor comes so much later than that of the first one; negative if it comes earlier, s.
    pub second_late_s: f64,
    /// Standard uncertainty of it, s.
    pub std_s: f64,
}

/// A change of the second sensor, and the rows of its begin and end.
struct Change {
    nt: Vector3<f64>,
    times: [Tt2000; 2],
}

/// The delay between the courses of two sensors in axes of the spacecraft; `None` where it agrees with zero, or is not clear.
#[must_use]
pub fn delay(first: &Course, second: &Course) -> Option<Delay> {
    let begin = *first.time.first()?;
    // The row of the first sensor by the second of its time.
    let mut places: Vec<Option<usize>> = Vec::new();
    for (row, time) in first.time.iter().enumerate() {
        let place = usize::try_from((time - begin) / SECOND_NS).ok()?;
        places.resize(places.len().max(place + 1), None);
        places[place] = Some(row);
    }
    let at = |time: i64| usize::try_from((time - begin).div_euclid(SECOND_NS)).ok().and_then(|place| *places.get(place)?);
    let (changes, usual_nt) = changes(second);
    let most_nt2 = (OUTSTANDING * usual_nt).powi(2);
    // What is left of a change with a delay.
    let left = |change: &Change, by_s: i64| {
        let [from, to] = change.times.map(|time| at(time - by_s * SECOND_NS));
        Some((change.nt - (first.vector(to?) - first.vector(from?))).norm_squared().min(most_nt2))
    };
    // With a delay and without one, of the changes that both of them have.
    let both = |by_s: i64| changes.iter().filter_map(move |change| Some((change, left(change, by_s)?, left(change, 0)?)));
    let likelihood = |by_s: &i64| -> f64 {
        let (n, with, without) =
            both(*by_s).fold((0.0, 0.0, 0.0), |(n, a, b), (_, with, without)| (n + 1.0, a + with, b + without));
        if n < (LEAST_BLOCKS * BLOCK) as f64 { f64::NEG_INFINITY } else { 0.5 * n * f64::ln(without / with) }
    };
    let best = (-MOST_S..=MOST_S).max_by(|a, b| likelihood(a).total_cmp(&likelihood(b)))?;
    if best == 0 || best.abs() == MOST_S || likelihood(&best) <= CLEAR {
        return None;
    }
    let all: Vec<(&Change, f64, f64)> = both(best).collect();
    let [with, without] = [all.iter().map(|own| own.1).sum::<f64>(), all.iter().map(|own| own.2).sum::<f64>()];
    let blocks = all.chunks_exact(BLOCK);
    let count = blocks.len() as f64;
    let sum = |part: &[(&Change, f64, f64)], of: &dyn Fn(&(&Change, f64, f64)) -> f64| part.iter().map(of).sum::<f64>();
    let agreeing = blocks.filter(|part| sum(part, &|own| own.1) < sum(part, &|own| own.2)).count() as f64;
    // The squares lie on a parabola about the delay.
    let beside: Vec<[f64; 3]> =
        all.iter().filter_map(|(change, with, _)| Some([left(change, best - 1)?, *with, left(change, best + 1)?])).collect();
    let [before, least, behind] = [0, 1, 2].map(|k| beside.iter().map(|own| own[k]).sum::<f64>());
    let curvature = before - 2.0 * least + behind;
    let second_late_s = best as f64 + 0.5 * (before - behind) / curvature;
    let std_s = (2.0 * least / (3.0 * beside.len() as f64 * curvature)).sqrt();
    let is_clear = agreeing >= AGREEING * count && without > FEWER_SQUARES * with && second_late_s.abs() > STDS * std_s;
    is_clear.then_some(Delay { second_late_s, std_s })
}

/// The delays in those seconds that the first sensor has in one mode, with the mode: a time shift that is wrong is that of one mode, and the others of a
/// day hide it.
#[must_use]
pub fn delays_of_modes(first: &Course, second: &Course) -> Vec<(u8, Delay)> {
    let modes: BTreeSet<u8> = first.mode.iter().copied().collect();
    let of = |mode: u8| delay(&first.of_mode(mode), second).map(|found| (mode, found));
    modes.into_iter().filter_map(of).filter(|(_, found)| found.second_late_s.abs() >= LEAST_OF_MODE_S).collect()
}

/// The changes of a course, one after the other, without jumps, and the usual one, nT.
fn changes(course: &Course) -> (Vec<Change>, f64) {
    let mut changes: Vec<Change> = Vec::new();
    let mut from = 0;
    for row in 1..course.time.len() {
        let length_s = (course.time[row] - course.time[from]) / SECOND_NS;
        if length_s < LEAST_CHANGE_S {
            continue;
        }
        if length_s <= LONGEST_CHANGE_S {
            changes.push(Change { nt: course.vector(row) - course.vector(from), times: [course.time[from], course.time[row]] });
        }
        from = row;
    }
    let usual = median(&mut changes.iter().map(|own| own.nt.norm()).collect::<Vec<f64>>());
    changes.retain(|own| own.nt.norm() <= OUTSTANDING * usual);
    (changes, usual)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    /// An hour of a field that moves within a minute, with noise of either sensor, a heater that the second one sees 1.3 times as strong, an offset
    /// that jumps at either, and 100 s of readings that have nothing to do with it; the second one has a mean every so many seconds.
    fn courses(late_s: usize, every_s: usize) -> [Course; 2] {
        const SECONDS: usize = 3600;
        let mut random = Random::seeded(7);
        let mut noise = |std: f64| Vector3::from_fn(|_, _| std * random.gaussian());
        let (mut field, mut speed) = (Vector3::zeros(), Vector3::zeros());
        let mut both: [Vec<Vector3<f64>>; 2] = Default::default();
        for second in 0..SECONDS {
            speed = 0.97 * speed + noise(0.01);
            field = 0.998 * field + speed;
            let heater = Vector3::new(0.5, -0.1, 0.3) * f64::from(u8::from(second / 17 % 2 == 1));
            let wrong = if (2000..2100).contains(&second) { noise(3.0) } else { Vector3::zeros() };
            let jump = Vector3::new(0.0, 20.0, 0.0) * f64::from(u8::from(second > 1000));
            let other = Vector3::new(0.0, 0.0, 12.0) * f64::from(u8::from(second > 2600));
            both[0].push(field + heater + noise(0.02) + other);
            both[1].push(field + 1.3 * heater + noise(0.05) + wrong + jump);
        }
        let course = |rows: Vec<usize>, of: &dyn Fn(usize) -> Vector3<f64>| Course {
            time: rows.iter().map(|row| *row as i64 * SECOND_NS).collect(),
            field_nt: [0, 1, 2].map(|i| rows.iter().map(|row| of(*row)[i]).collect()),
            mode: rows.iter().map(|row| u8::from(*row >= 1200)).collect(),
        };
        let first = course((0..SECONDS).collect(), &|row| both[0][row]);
        let second = course((late_s..SECONDS).step_by(every_s).collect(), &|row| both[1][row - late_s]);
        [first, second]
    }

    fn found(late_s: usize, every_s: usize) -> Option<Delay> {
        let [first, second] = courses(late_s, every_s);
        delay(&first, &second)
    }

    #[test]
    fn a_time_shift_of_one_mode_is_told_though_the_others_hide_it() {
        // The first 20 minutes are of mode 0: the times of the first sensor are early there by 16 s, and right in the other 40.
        let with = |early_s: i64| {
            let [mut first, second] = courses(0, 8);
            let wrong = first.of_mode(0).time.len();
            first.time[..wrong].iter_mut().for_each(|time| *time -= early_s * SECOND_NS);
            delays_of_modes(&first, &second)
        };
        assert!(with(0).is_empty());
        let found = with(16);
        assert!(found.len() == 1 && found[0].0 == 0 && (found[0].1.second_late_s - 16.0).abs() < 0.5, "{found:?}");
    }

    #[test]
    fn times_that_are_late_in_one_sensor_are_told_and_disturbances_are_not() {
        for every_s in [1, 32] {
            assert_eq!(found(0, every_s), None, "every {every_s} s");
            for late_s in [10, 32] {
                let delay = found(late_s, every_s).unwrap();
                assert!((delay.second_late_s - late_s as f64).abs() < 0.5, "every {every_s} s, {late_s} s late: {delay:?}");
            }
        }
    }
}
