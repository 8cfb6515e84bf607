//! From the spacecraft to the celestial frame (RO-IGEP-TR0028 section 4.4), and its position there.

use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::Tt2000;
use crate::files::flight::auxiliary::Attitude;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion};
use std::sync::Arc;

/// From the spacecraft to the celestial frame.
#[derive(Clone, Debug, PartialEq)]
pub struct AttitudeStep {
    /// The orientation over time.
    pub table: Arc<Attitude>,
    /// Neighbours further apart are not interpolated, ns.
    pub max_gap_ns: i64,
    /// Standard uncertainty of the attitude about every axis, radians.
    pub std_rad: f64,
}

/// The two neighbours of a time, prepared for spherical linear interpolation.
struct Between {
    begin: Tt2000,
    end: Tt2000,
    from: [f64; 4],
    to: [f64; 4],
    angle: f64,
    sine: f64,
}

/// Below this sine the interpolation is a straight line to rounding.
const STRAIGHT: f64 = 1e-9;

impl AttitudeStep {
    fn between(&self, time: Tt2000) -> Option<Between> {
        let Attitude { time: times, wxyz } = &*self.table;
        let next = times.partition_point(|t| *t <= time);
        let before = next.checked_sub(1)?;
        if times[before] == time && (next == times.len() || times[next] - times[before] > self.max_gap_ns) {
            let q = wxyz[before];
            return Some(Between { begin: time, end: time + 1, from: q, to: q, angle: 0.0, sine: 0.0 });
        }
        let (begin, end) = (times[before], *times.get(next)?);
        if end - begin > self.max_gap_ns {
            return None;
        }
        let from = wxyz[before];
        let mut to = wxyz[next];
        let dot: f64 = from.iter().zip(&to).map(|(a, b)| a * b).sum();
        // Both signs of a quaternion are the same rotation; the shorter way is meant.
        if dot < 0.0 {
            to = to.map(|v| -v);
        }
        // Exact for small angles, where the arc cosine loses half of the digits.
        let chord: f64 = from.iter().zip(&to).map(|(a, b)| (a - b) * (a - b)).sum::<f64>().sqrt();
        let angle = 2.0 * (0.5 * chord).min(1.0).asin();
        Some(Between { begin, end, from, to, angle, sine: angle.sin() })
    }
}

impl Between {
    fn rotation(&self, time: Tt2000) -> Matrix3<f64> {
        #[expect(clippy::cast_precision_loss, reason = "differences of times")]
        let share = (time - self.begin) as f64 / (self.end - self.begin) as f64;
        let (a, b) = if self.sine < STRAIGHT {
            (1.0 - share, share)
        } else {
            (((1.0 - share) * self.angle).sin() / self.sine, (share * self.angle).sin() / self.sine)
        };
        let q: [f64; 4] = std::array::from_fn(|i| a * self.from[i] + b * self.to[i]);
        *UnitQuaternion::new_normalize(Quaternion::new(q[0], q[1], q[2], q[3])).to_rotation_matrix().matrix()
    }
}

impl Step for AttitudeStep {
    fn apply(&self, block: &mut Block) {
        let mut between: Option<Between> = None;
        for row in 0..block.len() {
            let time = block.time[row];
            if !between.as_ref().is_some_and(|b| (b.begin..b.end).contains(&time)) {
                between = self.between(time);
            }
            let Some(rotation) = between.as_ref().map(|b| b.rotation(time)) else {
                block.take_away(row, Flags::ATTITUDE);
                continue;
            };
            let vector = rotation * block.vector(row);
            block.put(row, &vector);
            block.turn_covariances(row, &rotation);
        }
    }
}

/// The polynomial through some rows of a table of positions: Newton's form about the first of them, component by component.
struct Through {
    /// Times of the rows but the last one, s from the first one.
    nodes_s: [f64; 3],
    /// Divided differences, km and s.
    differences: [[f64; 3]; 4],
}

impl Through {
    fn new(time: &[Tt2000], km: &[[f64; 3]]) -> Self {
        let mut table = [[0.0; 3]; 4];
        let mut at_s = [0.0; 4];
        for (k, (time_k, own)) in time.iter().zip(km).take(4).enumerate() {
            (at_s[k], table[k]) = (seconds(*time_k, time[0]), *own);
        }
        let count = km.len().min(4);
        for order in 1..count {
            for k in (order..count).rev() {
                let step = at_s[k] - at_s[k - order];
                table[k] = std::array::from_fn(|c| (table[k][c] - table[k - 1][c]) / step);
            }
        }
        Self { nodes_s: [at_s[0], at_s[1], at_s[2]], differences: table }
    }

    fn at(&self, s: f64) -> [f64; 3] {
        let mut sum = self.differences[3];
        for k in (0..3).rev() {
            let along = s - self.nodes_s[k];
            sum = std::array::from_fn(|c| sum[c] * along + self.differences[k][c]);
        }
        sum
    }
}

#[expect(clippy::cast_precision_loss, reason = "differences of times")]
fn seconds(a: Tt2000, b: Tt2000) -> f64 {
    (a - b) as f64 * 1e-9
}

/// Positions at times: a cubic through four rows of the table, a straight line in its first and last interval; nan outside.
#[must_use]
pub fn positions_km(table_time: &[Tt2000], table_km: &[[f64; 3]], times: &[Tt2000]) -> [Vec<f64>; 3] {
    let mut out = [const { Vec::new() }; 3].map(|_: Vec<f64>| Vec::with_capacity(times.len()));
    // The interval of the row before, with its first time and its polynomial: times rise.
    let mut last: Option<(std::ops::Range<Tt2000>, Tt2000, Through)> = None;
    for time in times {
        if !last.as_ref().is_some_and(|(interval, ..)| interval.contains(time)) {
            let next = table_time.partition_point(|t| t <= time);
            last = (next > 0 && next < table_time.len()).then(|| {
                let nodes = if next >= 2 && next + 1 < table_time.len() { next - 2..next + 2 } else { next - 1..next + 1 };
                let through = Through::new(&table_time[nodes.clone()], &table_km[nodes.clone()]);
                (table_time[next - 1]..table_time[next], table_time[nodes.start], through)
            });
        }
        let km = match &last {
            Some((_, begin, through)) => through.at(seconds(*time, *begin)),
            None if table_time.last() == Some(time) => table_km[table_km.len() - 1],
            None => [f64::NAN; 3],
        };
        (0..3).for_each(|c| out[c].push(km[c]));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rotation_goes_on_evenly_over_both_signs() {
        let about_z = |angle: f64, sign: f64| [sign * (0.5 * angle).cos(), 0.0, 0.0, sign * (0.5 * angle).sin()];
        let table = Attitude {
            time: vec![0, 10, 20, 500],
            wxyz: vec![about_z(0.0, 1.0), about_z(0.4, -1.0), about_z(0.5, 1.0), about_z(0.5, 1.0)],
        };
        let step = AttitudeStep { table: table.into(), max_gap_ns: 60, std_rad: 0.0 };
        let times = vec![0, 5, 10, 19, 20, 21, 500, 501];
        let n = times.len();
        let field = [vec![1.0; n], vec![0.0; n], vec![3.0; n]];
        let mut block = Block { time: times, field, flags: vec![0; n], ..Block::default() };
        step.apply(&mut block);
        for (row, angle) in [(0, 0.0), (1, 0.2), (2, 0.4), (3, 0.49), (4, 0.5_f64)] {
            let wanted = [angle.cos(), angle.sin(), 3.0];
            (0..3).for_each(|i| assert!((block.field[i][row] - wanted[i]).abs() < 1e-12, "{row}"));
        }
        // Within the gap and behind the table there is no attitude; at the last row there is.
        assert!([5, 7].iter().all(|row| block.field[0][*row].is_nan() && block.flags[*row] == Flags::ATTITUDE.0));
        assert!((block.field[0][6] - 0.5_f64.cos()).abs() < 1e-12);
    }

    #[test]
    fn positions_of_a_cubic_are_exact_inside() {
        let cubic = |s: f64| [s * s * s - 2.0 * s, 4.0 * s, 7.0];
        let time: Vec<Tt2000> = (0..6).map(|k| k * 1_000_000_000).collect();
        let km: Vec<[f64; 3]> = (0..6).map(|k| cubic(f64::from(k))).collect();
        let found = positions_km(&time, &km, &[-1, 2_500_000_000, 5_000_000_000, 5_000_000_001]);
        assert!((found[0][1] - cubic(2.5)[0]).abs() < 1e-12 && (found[1][1] - 10.0).abs() < 1e-12);
        assert!((found[0][2] - cubic(5.0)[0]).abs() < 1e-12);
        assert!(found[0][0].is_nan() && found[0][3].is_nan());
    }
}
