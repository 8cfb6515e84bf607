//! Whether two sensors of a spacecraft see the same field: an axis that is reversed, exchanged or of another scale in one of them alone shows in
//! how their changes go together, and so do times that are wrong in one of them.
//!
//! Changes from minute to minute are compared, in axes of the first sensor: errors of an offset are not in them, noise is averaged, and the
//! external field changes more than what the spacecraft adds to each sensor.

use super::Block;
use super::two_sensors::common_times;
use crate::data::time::{SECOND_NS, Tt2000};
use crate::fit::statistics::median;
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Changes are those from one of these stretches to the next, ns.
const STRETCH_NS: i64 = 60 * SECOND_NS;
/// Changes of more times the usual one are left out: jumps, bad readings.
const OUTSTANDING: f64 = 3.0;
/// Of fewer changes nothing is said.
const LEAST_CHANGES: usize = 20;
/// A component disagrees whose changes follow those of the other sensor in another way than one to one: the part of the squares that this leaves
/// is so many times smaller,
const FEWER_SQUARES: f64 = 2.5;
/// it leaves no more than this part of the changes themselves,
const UNEXPLAINED: f64 = 0.7;
/// the logarithm of its likelihood is so much larger,
const CLEAR: f64 = 15.0;
/// and one of the three factors differs by so much: what a spacecraft adds to one sensor more than to the other is less.
const GROSS: f64 = 0.4;
/// Sensors are unrelated if the difference of their changes has so many times the squares of either, in every component.
const UNRELATED: f64 = 1.3;

/// Means over seconds.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Begin of the second.
    pub time: Vec<Tt2000>,
    /// nT.
    pub field_nt: [Vec<f64>; 3],
    /// Index of the mode of the first vector; empty if it is not wanted.
    pub mode: Vec<u8>,
}

impl Course {
    /// Of the vectors of a stretch.
    #[must_use]
    pub fn of(blocks: &[Block], span: &Range<Tt2000>) -> Self {
        let mut out = Self::default();
        let mut count = 0.0;
        for block in blocks {
            for row in block.rows_in(span).filter(|row| block.field.iter().all(|c| c[*row].is_finite())) {
                let second = block.time[row] - (block.time[row] - span.start) % SECOND_NS;
                if out.time.last() != Some(&second) {
                    out.divide(count);
                    out.time.push(second);
                    out.field_nt.iter_mut().for_each(|c| c.push(0.0));
                    out.mode.extend(block.mode.get(row));
                    count = 0.0;
                }
                count += 1.0;
                let last = out.time.len() - 1;
                (0..3).for_each(|i| out.field_nt[i][last] += block.field[i][row]);
            }
        }
        out.divide(count);
        out
    }

    fn divide(&mut self, count: f64) {
        self.field_nt.iter_mut().filter_map(|c| c.last_mut()).for_each(|sum| *sum /= count);
    }

    /// The seconds of one mode.
    #[must_use]
    pub fn of_mode(&self, mode: u8) -> Self {
        let rows: Vec<usize> = (0..self.mode.len()).filter(|row| self.mode[*row] == mode).collect();
        Self {
            time: rows.iter().map(|row| self.time[*row]).collect(),
            field_nt: self.field_nt.each_ref().map(|list| rows.iter().map(|row| list[*row]).collect()),
            mode: vec![mode; rows.len()],
        }
    }

    pub(super) fn vector(&self, row: usize) -> Vector3<f64> {
        Vector3::from_fn(|i, _| self.field_nt[i][row])
    }
}

/// How two sensors disagree.
#[derive(Clone, Debug, PartialEq)]
pub enum Disagreement {
    /// They do not change together.
    Unrelated,
    /// Components of the second one, in axes of the first, with the factors by which they follow the components of the first.
    Components(Vec<(usize, [f64; 3])>),
}

/// Compares the courses of two sensors in axes of the spacecraft, and how they disagree; `axes` turns these at a time to the axes of the first
/// sensor.
#[must_use]
pub fn compare(first: &Course, second: &Course, axes: &dyn Fn(Tt2000) -> Option<Matrix3<f64>>) -> Option<Disagreement> {
    let mut stretches: Vec<(i64, f64, [Vector3<f64>; 2])> = Vec::new();
    for [i, j] in common_times(&first.time, &second.time) {
        let Some(turn) = axes(first.time[i]) else { continue };
        let stretch = first.time[i].div_euclid(STRETCH_NS);
        if stretches.last().is_none_or(|(own, ..)| *own != stretch) {
            stretches.push((stretch, 0.0, [Vector3::zeros(); 2]));
        }
        if let Some((_, count, sums)) = stretches.last_mut() {
            *count += 1.0;
            sums[0] += turn * first.vector(i);
            sums[1] += turn * second.vector(j);
        }
    }
    let change = |pair: &[(i64, f64, [Vector3<f64>; 2])]| -> Option<[Vector3<f64>; 2]> {
        let of = |k: usize| pair[1].2[k] / pair[1].1 - pair[0].2[k] / pair[0].1;
        (pair[1].0 == pair[0].0 + 1).then(|| [of(0), of(1)])
    };
    let mut changes: Vec<[Vector3<f64>; 2]> = stretches.windows(2).filter_map(change).collect();
    let usual = [0, 1].map(|k| median(&mut changes.iter().map(|own| own[k].norm()).collect::<Vec<f64>>()));
    changes.retain(|own| (0..2).all(|k| own[k].norm() <= OUTSTANDING * usual[k]));
    if changes.len() < LEAST_CHANGES {
        return None;
    }
    let sum = |of: &dyn Fn(&[Vector3<f64>; 2]) -> Vector3<f64>| {
        changes.iter().fold(Vector3::zeros(), |sum, own| sum + of(own).component_mul(&of(own)))
    };
    let (of_first, of_second, of_difference) = (sum(&|own| own[0]), sum(&|own| own[1]), sum(&|own| own[1] - own[0]));
    if (0..3).all(|i| of_difference[i] > UNRELATED * of_first[i].max(of_second[i])) && !follows(&changes, of_second) {
        return Some(Disagreement::Unrelated);
    }
    let matrix = factors(&changes)?;
    let left = sum(&|own| own[1] - matrix * own[0]);
    let n = changes.len() as f64;
    let disagrees = |i: &usize| {
        let fewer = of_difference[*i] / left[*i];
        let gross = (0..3).any(|k| (matrix[(*i, k)] - f64::from(u8::from(*i == k))).abs() > GROSS);
        gross && fewer > FEWER_SQUARES && 0.5 * n * fewer.ln() > CLEAR && left[*i] < UNEXPLAINED * of_second[*i]
    };
    let list: Vec<(usize, [f64; 3])> = (0..3).filter(disagrees).map(|i| (i, [0, 1, 2].map(|k| matrix[(i, k)]))).collect();
    (!list.is_empty()).then_some(Disagreement::Components(list))
}

/// The matrix by which changes of the second sensor follow those of the first, by least squares.
fn factors(changes: &[[Vector3<f64>; 2]]) -> Option<Matrix3<f64>> {
    let zero = (Matrix3::zeros(), Matrix3::zeros());
    let (squares, products) =
        changes.iter().fold(zero, |(squares, products), [a, b]| (squares + a * a.transpose(), products + b * a.transpose()));
    Some(products * squares.try_inverse()?)
}

/// Whether changes of the second sensor follow those of the first in some way.
fn follows(changes: &[[Vector3<f64>; 2]], of_second: Vector3<f64>) -> bool {
    let Some(matrix) = factors(changes) else { return false };
    let left = changes.iter().fold(Vector3::zeros(), |sum, [a, b]| {
        let left = b - matrix * a;
        sum + left.component_mul(&left)
    });
    (0..3).any(|i| left[i] < UNEXPLAINED * of_second[i])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    /// Two hours of a field that walks by 0.05 nT a second, with noise of either sensor and a disturbance that the second one sees 1.6 times as
    /// strong as the first; both stand turned to the spacecraft, and the first is turned once.
    fn courses(fault: &dyn Fn(usize, Vector3<f64>) -> Vector3<f64>, late: usize) -> Option<Disagreement> {
        const SECONDS: usize = 7200;
        let mut random = Random::seeded(11);
        let mut noise = |std: f64| Vector3::from_fn(|_, _| std * random.gaussian());
        let (mut field, mut source) = (Vector3::zeros(), Vector3::zeros());
        let mut both: [Vec<Vector3<f64>>; 2] = Default::default();
        for _ in 0..SECONDS {
            field += noise(0.05);
            source = 0.99 * source + noise(0.01);
            both[0].push(field + source + noise(0.02));
            both[1].push(field + 1.6 * source + noise(0.1) + Vector3::new(3.0, -8.0, 1.0));
        }
        let turn = |row: usize| {
            let angle = if row < SECONDS / 2 { 0.7 } else { 1.4 };
            *nalgebra::Rotation3::from_euler_angles(angle, 0.3, -0.2).matrix()
        };
        let to_sc = |list: &[Vector3<f64>], fault: &dyn Fn(usize, Vector3<f64>) -> Vector3<f64>| {
            let vector = |row: usize| turn(row) * fault(row, turn(row).transpose() * list[row.saturating_sub(late)]);
            let rows: Vec<Vector3<f64>> = (0..SECONDS).map(vector).collect();
            Course {
                time: (0..SECONDS as i64).map(|k| k * SECOND_NS).collect(),
                field_nt: [0, 1, 2].map(|i| rows.iter().map(|v| v[i]).collect()),
                ..Course::default()
            }
        };
        let second = Course {
            time: (0..SECONDS as i64).map(|k| k * SECOND_NS).collect(),
            field_nt: [0, 1, 2].map(|i| both[1].iter().map(|v| v[i]).collect()),
            ..Course::default()
        };
        let axes = |time: Tt2000| Some(turn((time / SECOND_NS) as usize).transpose());
        compare(&to_sc(&both[0], fault), &second, &axes)
    }

    #[test]
    fn gross_faults_of_one_sensor_are_seen_and_disturbances_are_none() {
        assert_eq!(courses(&|_, v| v, 0), None);
        // A jump, and readings of nonsense for a minute.
        let bad = |row: usize, v: Vector3<f64>| {
            let by = if (600..660).contains(&row) { 500.0 } else { f64::from(u8::from(row > 3000)) * 40.0 };
            v + Vector3::x() * by
        };
        assert_eq!(courses(&bad, 0), None);
        let found = |of: Option<Disagreement>| match of {
            Some(Disagreement::Components(list)) => list,
            other => panic!("{other:?}"),
        };
        let is = |found: &[(usize, [f64; 3])], wanted: &[(usize, [f64; 3])]| {
            assert_eq!(found.len(), wanted.len(), "{found:?}");
            for ((axis, own), (wanted_axis, wanted)) in found.iter().zip(wanted) {
                assert_eq!(axis, wanted_axis);
                (0..3).for_each(|k| assert!((own[k] - wanted[k]).abs() < 0.2, "{found:?}"));
            }
        };
        is(&found(courses(&|_, v| Vector3::new(v.x, -v.y, v.z), 0)), &[(1, [0.0, -1.0, 0.0])]);
        is(&found(courses(&|_, v| Vector3::new(2.0 * v.x, v.y, v.z), 0)), &[(0, [0.5, 0.0, 0.0])]);
        is(&found(courses(&|_, v| Vector3::new(v.y, v.x, v.z), 0)), &[(0, [0.0, 1.0, 0.0]), (1, [1.0, 0.0, 0.0])]);
        is(&found(courses(&|_, v| -v, 0)), &[(0, [-1.0, 0.0, 0.0]), (1, [0.0, -1.0, 0.0]), (2, [0.0, 0.0, -1.0])]);
        // Ten minutes late.
        assert_eq!(courses(&|_, v| v, 600), Some(Disagreement::Unrelated));
    }

    #[test]
    fn vectors_become_means_of_their_seconds() {
        let half = SECOND_NS / 2;
        let blocks = [vec![0, 1, 2], vec![3, 7]].map(|halves: Vec<i64>| {
            let x: Vec<f64> = halves.iter().map(|h| if *h == 7 { f64::NAN } else { *h as f64 }).collect();
            let n = halves.len();
            Block {
                time: halves.iter().map(|h| 100 + h * half).collect(),
                field: [x, vec![2.0; n], vec![-1.0; n]],
                ..Block::default()
            }
        });
        let found = Course::of(&blocks, &(100..100 + 60 * SECOND_NS));
        assert_eq!(found.time, [100, 100 + SECOND_NS]);
        assert_eq!(found.field_nt, [vec![0.5, 2.5], vec![2.0; 2], vec![-1.0; 2]]);
        let modes = Course { mode: vec![3, 1], ..found };
        assert_eq!((modes.of_mode(1).time, modes.of_mode(1).field_nt[0].clone()), (vec![100 + SECOND_NS], vec![2.5]));
        assert_eq!(modes.of_mode(2), Course::default());
    }
}
