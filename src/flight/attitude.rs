//! From the spacecraft to the celestial frame (RO-IGEP-TR0028 section 4.4), and its position there.

use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::files::flight::auxiliary::Attitude;
use crate::fit::statistics::median;
use nalgebra::{Matrix3, Quaternion, UnitQuaternion};
use std::ops::Range;
use std::sync::Arc;

/// An attitude that turns by so much from one row to the next, radians (5°), and by so many times what it does otherwise, jumps.
const JUMP_RAD: f64 = 0.087_266;
const OFTEN: f64 = 10.0;
/// Rows on either side that say how fast it turns otherwise.
const ROWS_BESIDE: usize = 3;
/// Rows between two jumps are wrong if they are at most so many, and the rows on both sides of them agree within this part of the jumps.
const MOST_WRONG: usize = 10;
const AGREE: f64 = 0.3;
/// A jump that is not taken back is told from here on, radians (20°): a spacecraft that begins and ends to turn between two rows looks like it.
const TOLD_RAD: f64 = 0.349_066;

/// From the spacecraft to the celestial frame.
#[derive(Clone, Debug, PartialEq)]
pub struct AttitudeStep {
    /// The orientation over time.
    pub table: Arc<Attitude>,
    /// Neighbours further apart are not interpolated, ns.
    pub max_gap_ns: i64,
    /// Standard uncertainty of the attitude about every axis, radians.
    pub std_rad: f64,
    /// Rows of the table that are not believed: beside them there is no attitude.
    pub wrong: Vec<usize>,
}

/// Rows of a table of attitude that cannot be right.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AttitudeFaults {
    /// Rows that are turned against those on both sides, which agree with each other.
    pub wrong: Vec<usize>,
    /// The largest such turn, radians.
    pub most_rad: f64,
    /// Jumps that are not taken back: the row before, and the turn to the next one, radians.
    pub jumps: Vec<(usize, f64)>,
}

impl AttitudeFaults {
    /// Of a table whose rows further apart than `max_gap_ns` have a gap between them.
    #[must_use]
    pub fn of(table: &Attitude, max_gap_ns: i64) -> Self {
        let turn = |a: usize, b: usize| angle(&table.wxyz[a], &table.wxyz[b]);
        let follow = |rows: &Range<usize>| table.time[rows.end] - table.time[rows.start] <= max_gap_ns;
        let turns: Vec<f64> =
            (1..table.time.len()).map(|row| if follow(&(row - 1..row)) { turn(row - 1, row) } else { 0.0 }).collect();
        let is_jump = |row: &usize| {
            let beside = turns[row.saturating_sub(ROWS_BESIDE)..*row].iter().chain(turns[row + 1..].iter().take(ROWS_BESIDE));
            let mut beside: Vec<f64> = beside.copied().collect();
            turns[*row] > JUMP_RAD && !beside.is_empty() && turns[*row] > OFTEN * median(&mut beside)
        };
        let places: Vec<usize> = (0..turns.len()).filter(is_jump).collect();
        let mut out = Self::default();
        let mut next = 0;
        while let Some(&from) = places.get(next) {
            let takes_back = |to: &&usize| {
                **to - from <= MOST_WRONG
                    && (from..**to).all(|row| follow(&(row..row + 1)))
                    && turn(from, **to + 1) < AGREE * turns[from].min(turns[**to])
            };
            match places[next + 1..].iter().find(takes_back) {
                Some(&to) => {
                    out.wrong.extend(from + 1..=to);
                    out.most_rad = out.most_rad.max(turns[from]);
                    next += 1 + places[next + 1..].iter().take_while(|place| **place <= to).count();
                }
                None => {
                    if turns[from] > TOLD_RAD {
                        out.jumps.push((from, turns[from]));
                    }
                    next += 1;
                }
            }
        }
        out
    }

    /// What is to be known of them within a stretch.
    #[must_use]
    pub fn notes(&self, table: &Attitude, span: &Range<Tt2000>, leap: &LeapSeconds) -> Vec<String> {
        let own = |row: &&usize| span.contains(&table.time[**row]);
        let wrong: Vec<&usize> = self.wrong.iter().filter(own).collect();
        let mut notes = Vec::new();
        if let Some(first) = wrong.first() {
            notes.push(format!(
                "the attitude of {} rows, the first of {}, is turned by up to {:.1}° against the rows on both sides, which agree: vectors beside \
                 them have no attitude",
                wrong.len(),
                leap.utc(table.time[**first]),
                self.most_rad.to_degrees()
            ));
        }
        for (row, by_rad) in self.jumps.iter().filter(|(row, _)| own(&row)) {
            notes.push(format!(
                "the attitude turns by {:.1}° from {} to the next row, and hardly before and after it; nothing was done about it",
                by_rad.to_degrees(),
                leap.utc(table.time[*row])
            ));
        }
        notes
    }
}

/// Angle between two attitudes, radians; both signs of a quaternion are the same one.
fn angle(a: &[f64; 4], b: &[f64; 4]) -> f64 {
    let chord = |sign: f64| a.iter().zip(b).map(|(a, b)| (a - sign * b) * (a - sign * b)).sum::<f64>().sqrt();
    4.0 * (0.5 * chord(1.0).min(chord(-1.0))).min(1.0).asin()
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
        let is_last = || next == times.len() || times[next] - times[before] > self.max_gap_ns;
        if times[before] == time && is_last() && self.wrong.binary_search(&before).is_err() {
            let q = wxyz[before];
            return Some(Between { begin: time, end: time + 1, from: q, to: q, angle: 0.0, sine: 0.0 });
        }
        let (begin, end) = (times[before], *times.get(next)?);
        if end - begin > self.max_gap_ns || [before, next].iter().any(|row| self.wrong.binary_search(row).is_ok()) {
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

/// Further from the origin, km, no spacecraft has ever been, and none was faster, km/s, by far: the first is 200 times the distance of the Earth from the Sun,
/// the second more than twice the speed of the fastest.
const FURTHEST_KM: f64 = 3e10;
const FASTEST_KM_PER_S: f64 = 500.0;

/// What rows of a table of positions have that no position in km can: a distance, or a speed from one row to the next.
#[must_use]
pub fn impossible_positions(table_time: &[Tt2000], table_km: &[[f64; 3]]) -> Option<String> {
    let norm = |v: [f64; 3]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
    let far = table_km.iter().map(|km| norm(*km)).filter(|km| *km > FURTHEST_KM);
    let (count, most_km) = far.fold((0_usize, 0.0_f64), |(count, most), km| (count + 1, most.max(km)));
    if count > 0 {
        return Some(format!(
            "{count} of {} positions of the table are up to {most_km:.1e} km from the origin, further than any spacecraft: the table is hardly in km",
            table_km.len()
        ));
    }
    let speed = |(time, km): (&[Tt2000], &[[f64; 3]])| {
        let apart_km = norm([0, 1, 2].map(|i| km[1][i] - km[0][i]));
        #[expect(clippy::cast_precision_loss, reason = "differences of times")]
        let apart_s = (time[1] - time[0]) as f64 / SECOND_NS as f64;
        apart_km / apart_s
    };
    let fast = table_time.windows(2).zip(table_km.windows(2)).map(speed).filter(|speed| *speed > FASTEST_KM_PER_S);
    let (count, most) = fast.fold((0_usize, 0.0_f64), |(count, most), speed| (count + 1, most.max(speed)));
    (count > 0).then(|| {
        format!(
            "{count} steps of the table of positions take up to {most:.1e} km/s, faster than any spacecraft: rows of it are hardly in km, or have wrong times"
        )
    })
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
        let step = AttitudeStep { table: table.into(), max_gap_ns: 60, std_rad: 0.0, wrong: Vec::new() };
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
    fn positions_that_are_in_no_km_are_told() {
        // A circle around the Earth, a row every minute.
        let time: Vec<Tt2000> = (0..90).map(|k| k * 60 * SECOND_NS).collect();
        let km: Vec<[f64; 3]> = (0..90)
            .map(|k| (f64::from(k) / 90.0 * std::f64::consts::TAU).sin_cos())
            .map(|(s, c)| [6800.0 * c, 6800.0 * s, 0.0])
            .collect();
        assert_eq!(impossible_positions(&time, &km), None);
        let in_m = |rows: std::ops::Range<usize>| -> Vec<[f64; 3]> {
            km.iter().enumerate().map(|(k, own)| own.map(|x| if rows.contains(&k) { 1000.0 * x } else { x })).collect()
        };
        let note = impossible_positions(&time, &in_m(0..90)).unwrap();
        assert!(note.starts_with("89 steps of the table of positions take up to 7.9e3 km/s"), "{note}");
        // One part of it: into it and out of it.
        let note = impossible_positions(&time, &in_m(40..41)).unwrap();
        assert!(note.starts_with("2 steps of the table of positions take up to 1.1e5 km/s"), "{note}");
        // About the Sun at three times the distance of the Earth.
        let far = [[4.5e8, 0.0, 0.0], [4.5e8, 900.0, 0.0]];
        assert_eq!(impossible_positions(&time[..2], &far), None);
        let note = impossible_positions(&time[..2], &far.map(|own| own.map(|x| 1000.0 * x))).unwrap();
        assert!(note.starts_with("2 of 2 positions of the table are up to 4.5e11 km from the origin"), "{note}");
    }

    /// A spacecraft that turns evenly, in rows of 10 ns; angles of single rows are wrong.
    #[test]
    fn rows_of_another_attitude_are_told_and_not_used_and_turns_are_none() {
        const ROWS: usize = 60;
        let about_z = |angle: f64| [(0.5 * angle).cos(), 0.0, 0.0, (0.5 * angle).sin()];
        let table = |angle: &dyn Fn(usize) -> f64| Attitude {
            time: (0..ROWS as i64).map(|k| 10 * k).collect(),
            wxyz: (0..ROWS).map(|k| about_z(angle(k))).collect(),
        };
        let of = |angle: &dyn Fn(usize) -> f64| AttitudeFaults::of(&table(angle), 60);
        let slow = |k: usize| 1e-3 * k as f64;
        assert_eq!(of(&slow), AttitudeFaults::default());
        // One turn in six rows, as of a spinning one; a slew of 90° that begins and ends within some rows.
        assert_eq!(of(&|k| k as f64 * std::f64::consts::PI / 3.0), AttitudeFaults::default());
        let slew = |k: usize| (k as f64 - 20.0).clamp(0.0, 10.0) * 9.0_f64.to_radians();
        assert_eq!(of(&slew), AttitudeFaults::default());
        let faulty = |k: usize| slow(k) + if k == 30 || k == 45 || k == 46 { 40.0_f64.to_radians() } else { 0.0 };
        let found = of(&faulty);
        assert_eq!((found.wrong.as_slice(), found.jumps.len()), ([30, 45, 46].as_slice(), 0));
        assert!((found.most_rad.to_degrees() - 40.0).abs() < 0.1);
        let notes = found.notes(&table(&faulty), &(0..400), &LeapSeconds::default());
        assert!(
            notes.len() == 1 && notes[0].starts_with("the attitude of 1 rows, the first of 2000-01-01T11:58:55"),
            "{notes:?}"
        );
        // It turns at once and stays there.
        let found = of(&|k| slow(k) + if k > 30 { 1.0 } else { 0.0 });
        assert_eq!((found.wrong.len(), found.jumps.len(), found.jumps[0].0), (0, 1, 30));

        let step = AttitudeStep { table: table(&faulty).into(), max_gap_ns: 60, std_rad: 0.0, wrong: of(&faulty).wrong };
        let times: Vec<Tt2000> = vec![290, 291, 300, 309, 310, 440, 460, 469, 470];
        let n = times.len();
        let mut block = Block { time: times, field: [(); 3].map(|()| vec![1.0; n]), flags: vec![0; n], ..Block::default() };
        step.apply(&mut block);
        let without: Vec<usize> = (0..n).filter(|row| block.flags[*row] & Flags::ATTITUDE.0 != 0).collect();
        assert_eq!(without, [0, 1, 2, 3, 5, 6, 7]);
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
