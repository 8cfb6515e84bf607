//! Whether the field goes on where a table of offsets or boom states changes: an offset of the wrong sign or a change at the wrong time makes a step
//! that the readings do not have.

use super::comparison::Course;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::fit::statistics::median;
use nalgebra::{Matrix3, Vector3};

/// The field before and behind an edge is the mean over so long, ns.
const SIDE_NS: i64 = 60 * SECOND_NS;
/// Seconds with vectors that a side needs.
const LEAST_SECONDS: usize = 10;
/// A step is one of the table that is so many times what the field usually changes between two such means,
const OUTSTANDING: f64 = 8.0;
/// and so many times the step without the change of the table: an offset of the wrong sign makes twice the step.
const MORE: f64 = 1.5;
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

/// Notes on edges at which the course of a day in axes of the spacecraft steps because of the table.
#[must_use]
pub fn steps_at_edges(course: &Course, edges: &[TableEdge], leap: &LeapSeconds) -> Vec<String> {
    let mean = |from: Tt2000, to: Tt2000| -> Option<Vector3<f64>> {
        let rows = course.time.partition_point(|t| *t < from)..course.time.partition_point(|t| *t < to);
        let count = rows.len();
        (count >= LEAST_SECONDS).then(|| rows.map(|row| course.vector(row)).sum::<Vector3<f64>>() / count as f64)
    };
    let sides = |at: Tt2000| Some((mean(at - SIDE_NS, at)?, mean(at, at + SIDE_NS)?));
    let (Some(first), Some(last)) = (course.time.first(), course.time.last()) else { return Vec::new() };
    let mut usual: Vec<f64> = (0..=(last - first) / SIDE_NS)
        .filter_map(|k| sides(first + k * SIDE_NS).map(|(before, behind)| (behind - before).norm()))
        .collect();
    if usual.len() < LEAST_PAIRS {
        return Vec::new();
    }
    let least_nt = OUTSTANDING * median(&mut usual);
    let told = |edge: &TableEdge| {
        let (before, behind) = sides(edge.time)?;
        let step_nt = (behind - before).norm();
        let without_nt = (edge.turn * behind + edge.add_nt - before).norm();
        (step_nt > least_nt && step_nt > MORE * without_nt).then(|| {
            format!(
                "the field steps by {step_nt:.2} nT at {}, where {} changes, and by {without_nt:.2} nT without that change: check its sign and time",
                leap.utc(edge.time),
                edge.what
            )
        })
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
            let course = Course { time: (0..SECONDS as i64).map(|k| k * SECOND_NS).collect(), field_nt };
            let edge = TableEdge { time: at, what: "the table of offsets", turn: Matrix3::identity(), add_nt: sign * jump };
            steps_at_edges(&course, &[edge], &LeapSeconds::default())
        };
        assert!(notes(1.0, 1800).is_empty());
        let found = notes(-1.0, 1800);
        assert!(found.len() == 1 && found[0].starts_with("the field steps by 12."), "{found:?}");
        // Ten minutes late, and a jump that is not in the table: the table does not make that one.
        assert_eq!(notes(1.0, 1200).len(), 1);
        assert!(notes(0.0, 1800).is_empty());
    }
}
