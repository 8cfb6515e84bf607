//! Whether the field goes on where a table of offsets or boom states changes: an offset of the wrong sign or a change at the wrong time makes a step
//! that the readings do not have, and one in other axes, or of the wrong size, leaves a part of theirs.

use super::comparison::Course;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use nalgebra::{Matrix3, Vector3};

/// The field before and behind an edge is the mean over so long, ns: the field outside changes little within the shorter one, where a mode has
/// enough vectors for it.
const SIDES_NS: [i64; 2] = [12 * SECOND_NS, 60 * SECOND_NS];
/// Seconds with vectors that a side needs.
const LEAST_SECONDS: usize = 10;
/// A step is one of the table that is so many times the change between two such means that this part of them stay below: heaters and the field
/// outside make larger ones now and then,
const USUAL_PART: f64 = 0.95;
const OUTSTANDING: f64 = 2.0;
/// and so many times the step without the change of the table: an offset of the wrong sign makes twice the step.
const MORE: f64 = 1.5;
/// A step remains, whatever it is without the change of the table, that is so many times the same change between means: the largest ones of a simulated
/// day without faults are 1.6 times it.
const REMAINING: f64 = 2.5;
/// Pairs of means that say what is usual.
const LEAST_PAIRS: usize = 10;

/// A moment at which a table changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TableEdge {
    /// When.
    pub time: Tt2000,
    /// What changes, in words.
    pub what: &'static str,
    /// The field `B` that stands behind it would be `turn B + add_nt` without the change of the table.
    pub turn: Matrix3<f64>,
    /// nT.
    pub add_nt: Vector3<f64>,
}

/// Notes on edges at which the course of a day in axes of the spacecraft steps because of the table, or still steps behind it.
#[must_use]
pub fn steps_at_edges(course: &Course, edges: &[TableEdge], leap: &LeapSeconds) -> Vec<String> {
    let mean = |from: Tt2000, to: Tt2000| -> Option<Vector3<f64>> {
        let rows = course.time.partition_point(|t| *t < from)..course.time.partition_point(|t| *t < to);
        let count = rows.len();
        (count >= LEAST_SECONDS).then(|| rows.map(|row| course.vector(row)).sum::<Vector3<f64>>() / count as f64)
    };
    let (Some(first), Some(last)) = (course.time.first(), course.time.last()) else { return Vec::new() };
    let sides = |at: Tt2000, side_ns: i64| Some((mean(at - side_ns, at)?, mean(at, at + side_ns)?));
    // What most steps stay below that are no edges.
    let usual_nt = SIDES_NS.map(|side_ns| {
        let step = |k: i64| sides(first + k * side_ns, side_ns).map(|(before, behind)| (behind - before).norm());
        let mut usual: Vec<f64> = (0..=(last - first) / side_ns).filter_map(step).collect();
        usual.sort_by(f64::total_cmp);
        let place = (USUAL_PART * usual.len() as f64) as usize;
        usual.get(place).filter(|_| usual.len() >= LEAST_PAIRS).copied().unwrap_or(f64::INFINITY)
    });
    let told = |edge: &TableEdge| {
        // The step at an edge and the one without its change, in units of the usual one.
        let steps = SIDES_NS.iter().zip(usual_nt).filter_map(|(side_ns, usual_nt)| {
            let (before, behind) = sides(edge.time, *side_ns)?;
            let step_nt = (behind - before).norm();
            let without_nt = (edge.turn * behind + edge.add_nt - before).norm();
            Some((step_nt, without_nt, step_nt / usual_nt))
        });
        let steps: Vec<(f64, f64, f64)> = steps.collect();
        let (at, what) = (leap.utc(edge.time), edge.what);
        let made = steps.iter().find(|(step_nt, without_nt, usual)| *usual > OUTSTANDING && *step_nt > MORE * without_nt);
        if let Some((step_nt, without_nt, _)) = made {
            return Some(format!(
                "the field steps by {step_nt:.2} nT at {at}, where {what} changes, and by {without_nt:.2} nT without that change: check its sign and time"
            ));
        }
        let (step_nt, without_nt, _) = steps.iter().find(|(_, _, usual)| *usual > REMAINING)?;
        Some(format!(
            "the field still steps by {step_nt:.2} nT at {at}, where {what} changes, and by {without_nt:.2} nT without that change: check its frame, the \
             sign of every component, its size and its time"
        ))
    };
    edges.iter().filter_map(told).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    #[test]
    fn steps_that_a_table_makes_are_told_and_those_that_it_takes_off_are_not() {
        const SECONDS: usize = 3600;
        let jump = Vector3::new(2.0, -5.0, 3.0);
        let at = 1800 * SECOND_NS;
        // A walk of 0.02 nT a second with noise, and a jump of the sensor that the table takes off with a sign and at a time.
        let notes = |sign: f64, real_s: usize| {
            let mut random = Random::seeded(3);
            let mut level = Vector3::zeros();
            let mut field_nt: [Vec<f64>; 3] = Default::default();
            for second in 0..SECONDS {
                let mut step = |std: f64| Vector3::from_fn(|_, _| std * random.gaussian());
                level += step(0.02);
                let real = if second >= real_s { jump } else { Vector3::zeros() };
                let taken = if second >= 1800 { sign * jump } else { Vector3::zeros() };
                let value = level + step(0.03) + real - taken;
                (0..3).for_each(|i| field_nt[i].push(value[i]));
            }
            let time = (0..SECONDS as i64).map(|k| k * SECOND_NS).collect();
            let course = Course { time, field_nt, ..Course::default() };
            let edge = TableEdge { time: at, what: "the table of offsets", turn: Matrix3::identity(), add_nt: sign * jump };
            steps_at_edges(&course, &[edge], &LeapSeconds::default())
        };
        assert!(notes(1.0, 1800).is_empty());
        let found = notes(-1.0, 1800);
        assert!(found.len() == 1 && found[0].starts_with("the field steps by 12."), "{found:?}");
        // Ten minutes late.
        assert_eq!(notes(1.0, 1200).len(), 1);
        // Six tenths of the jump of 6.16 nT are left.
        let found = notes(0.4, 1800);
        assert!(found.len() == 1 && found[0].starts_with("the field still steps by 3."), "{found:?}");
        assert!(notes(0.98, 1800).is_empty());
    }

    #[test]
    fn a_boom_state_that_changes_late_is_told_beside_heaters() {
        // A field of 4 nT that walks by 0.05 nT a second beside a heater of 1.2 nT, at a sensor that is turned by 70 degrees after 20 minutes.
        let at = |second: usize| second as i64 * SECOND_NS;
        let turned = *nalgebra::Rotation3::from_euler_angles(0.0, 0.7, 1.0).matrix();
        let notes = |real_s: usize, table_s: usize| {
            let mut random = Random::seeded(9);
            let mut field = Vector3::new(2.0, -3.0, 1.5);
            let mut field_nt: [Vec<f64>; 3] = Default::default();
            for second in 0..4800 {
                let heater = Vector3::new(1.1, 0.0, 0.5) * f64::from(u8::from(second / 19 % 2 == 1));
                field += Vector3::from_fn(|_, _| 0.05 * random.gaussian());
                let real = if second >= real_s { turned } else { Matrix3::identity() };
                let table = if second >= table_s { turned } else { Matrix3::identity() };
                let value = table * real.transpose() * (field + heater);
                (0..3).for_each(|i| field_nt[i].push(value[i]));
            }
            let course = Course { time: (0..4800).map(at).collect(), field_nt, ..Course::default() };
            let turn = turned.transpose();
            let edge = TableEdge { time: at(table_s), what: "the boom state", turn, add_nt: Vector3::zeros() };
            steps_at_edges(&course, &[edge], &LeapSeconds::default()).len()
        };
        assert_eq!([notes(1200, 1200), notes(1200, 1800)], [0, 1]);
    }
}
