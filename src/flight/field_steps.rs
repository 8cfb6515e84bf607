//! Steps of the field from one vector to the next that are far beyond all others of a day and that no table states: counts of another range, gain or
//! sign from a moment on. A shock of the solar wind is none: behind it the field goes on to change by a part of its jump from vector to vector.

use super::Block;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::data::units::COMPONENTS;
use crate::fit::statistics::median;
use nalgebra::Vector3;
use std::ops::Range;

/// Vectors that are further apart are no neighbours, ns: the field outside goes on in a longer gap.
const NEIGHBOURS_NS: i64 = 128 * SECOND_NS;
/// A step stays: the medians of so many vectors on either side differ by it.
const SIDE: usize = 5;
/// It is so many times the largest one of the others. In simulated days without faults the largest is up to 1.6 times the next one, a sign or a factor of 2
/// that changes makes 70 to 300 times as much.
const OUTSTANDING: f64 = 15.0;
/// Smaller ones are not told, nT: where noise is below the steps of the converter, others may be zero.
const LEAST_NT: f64 = 5.0;
/// More than so many are no steps that stand out.
const MOST_STEPS: usize = 10;
/// Vectors beside a step belong to it.
const BESIDE: usize = 3;
/// The largest steps from vector to vector that are looked at.
const PLACES: usize = 100;
/// Of fewer vectors nothing is said.
const LEAST_VECTORS: usize = 100;
/// What a table states happens within this of the time that it states, ns: longer ones would hide what happens by itself.
const STATED_NS: i64 = 10 * SECOND_NS;
/// Components that change by less than this part of the largest one are not named.
const NAMED_PART: f64 = 0.1;

/// A pair of neighbours.
struct Place {
    /// The vector behind it, counted from the first one of the stretch.
    order: usize,
    /// The block and row of that vector.
    block: usize,
    row: usize,
    /// Square of the step from vector to vector, nT².
    step_nt2: f64,
    /// Ranges before and behind it.
    ranges: [u8; 2],
}

/// A step that stays.
struct FieldStep {
    /// The smaller one of the steps from vector to vector and of the medians, nT.
    size_nt: f64,
    /// That of the medians, nT.
    step_nt: Vector3<f64>,
    /// Time of the first vector behind it.
    time: Tt2000,
    /// Ranges before and behind it.
    ranges: [u8; 2],
}

/// A note on steps of the field in axes of the sensor that stand out of all others of a stretch; `stated` are the times at which a table states that the
/// field in these axes changes.
#[must_use]
pub fn unstated_steps(blocks: &[Block], span: &Range<Tt2000>, stated: &[Tt2000], leap: &LeapSeconds) -> Option<String> {
    let places = largest(blocks, span, stated)?;
    let mut steps: Vec<FieldStep> = places.iter().map(|place| lasting(blocks, span, place)).collect();
    steps.sort_by(|a, b| b.size_nt.total_cmp(&a.size_nt));
    let stands_out = |count: &usize| {
        let (last, next) = (steps.get(count - 1), steps.get(*count));
        last.zip(next).is_some_and(|(last, next)| last.size_nt > LEAST_NT && last.size_nt > OUTSTANDING * next.size_nt)
    };
    let count = (1..=MOST_STEPS).rev().find(stands_out)?;
    let (most, others_nt) = (steps.first()?, steps.get(count)?.size_nt);
    let named = |i: &usize| most.step_nt[*i].abs() >= NAMED_PART * most.step_nt.amax();
    let sizes: Vec<String> = (0..3).filter(named).map(|i| format!("{:+.1} nT in {}", most.step_nt[i], COMPONENTS[i])).collect();
    let times = if count == 1 { String::new() } else { format!(" {count} times, most") };
    let cause = match most.ranges {
        [before, behind] if before != behind => {
            format!("the range changes from {before} to {behind} there: check factor, matrix and offset of both")
        }
        _ => "no table states a change there: the counts have another range, gain or sign before it or behind it, or something on the spacecraft switched"
            .to_owned(),
    };
    Some(format!(
        "the field of the sensor steps{times} by {} at {}, and by no more than {others_nt:.1} nT from vector to vector elsewhere in the day; {cause}",
        sizes.join(", "),
        leap.utc(most.time)
    ))
}

/// The largest steps from vector to vector, without those beside a larger one; `None` of too few vectors.
fn largest(blocks: &[Block], span: &Range<Tt2000>, stated: &[Tt2000]) -> Option<Vec<Place>> {
    let is_stated = |from: Tt2000, to: Tt2000| stated.iter().any(|at| (from - STATED_NS..=to + STATED_NS).contains(at));
    let mut places: Vec<Place> = Vec::new();
    let (mut order, mut least_nt2) = (0, 0.0);
    let mut last: Option<(Tt2000, Vector3<f64>, u8)> = None;
    for (index, block) in blocks.iter().enumerate() {
        for row in block.rows_in(span) {
            let (time, vector) = (block.time[row], block.vector(row));
            if !vector.sum().is_finite() {
                continue;
            }
            let range = block.range.get(row).copied().unwrap_or_default();
            if let Some((before, own, range_before)) = last {
                let step_nt2 = (vector - own).norm_squared();
                if step_nt2 > least_nt2 && time - before <= NEIGHBOURS_NS && !is_stated(before, time) {
                    places.push(Place { order, block: index, row, step_nt2, ranges: [range_before, range] });
                }
                if places.len() == 2 * PLACES {
                    keep_largest(&mut places);
                    least_nt2 = places.last().map_or(0.0, |place| place.step_nt2);
                }
            }
            last = Some((time, vector, range));
            order += 1;
        }
    }
    if order < LEAST_VECTORS {
        return None;
    }
    keep_largest(&mut places);
    let mut apart: Vec<Place> = Vec::new();
    for place in places {
        if apart.iter().all(|own| own.order.abs_diff(place.order) > BESIDE) {
            apart.push(place);
        }
    }
    Some(apart)
}

fn keep_largest(places: &mut Vec<Place>) {
    places.sort_by(|a, b| b.step_nt2.total_cmp(&a.step_nt2));
    places.truncate(PLACES);
}

/// By how much the field differs on the two sides of a place; by nothing where a side has not enough vectors.
fn lasting(blocks: &[Block], span: &Range<Tt2000>, place: &Place) -> FieldStep {
    let is_finite = |(_, vector): &(Tt2000, Vector3<f64>)| vector.sum().is_finite();
    let behind = blocks[place.block..].iter().enumerate().flat_map(|(k, block)| {
        let rows = block.rows_in(span);
        let from = if k == 0 { place.row } else { rows.start };
        (from..rows.end).map(move |row| (block.time[row], block.vector(row)))
    });
    let before = blocks[..=place.block].iter().rev().enumerate().flat_map(|(k, block)| {
        let rows = block.rows_in(span);
        let to = if k == 0 { place.row } else { rows.end };
        (rows.start..to).rev().map(move |row| (block.time[row], block.vector(row)))
    });
    let behind: Vec<(Tt2000, Vector3<f64>)> = behind.filter(is_finite).take(SIDE).collect();
    let before: Vec<(Tt2000, Vector3<f64>)> = before.filter(is_finite).take(SIDE).collect();
    let is_whole = |side: &[(Tt2000, Vector3<f64>)]| {
        side.len() == SIDE && side.windows(2).all(|pair| (pair[1].0 - pair[0].0).abs() <= NEIGHBOURS_NS)
    };
    let middle = |side: &[(Tt2000, Vector3<f64>)]| {
        Vector3::from_fn(|i, _| median(&mut side.iter().map(|(_, vector)| vector[i]).collect::<Vec<f64>>()))
    };
    let is_step = is_whole(&before) && is_whole(&behind);
    let step_nt = if is_step { middle(&behind) - middle(&before) } else { Vector3::zeros() };
    let size_nt = step_nt.norm().min(place.step_nt2.sqrt());
    FieldStep { size_nt, step_nt, time: blocks[place.block].time[place.row], ranges: place.ranges }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    const SECONDS: i64 = 2000;

    /// Half an hour of a field of hundreds of nT that walks, with noise; what a fault makes of it by the second, in two blocks, and a spike.
    fn found(fault: &dyn Fn(i64, Vector3<f64>) -> Vector3<f64>, stated: &[Tt2000]) -> Option<String> {
        let mut random = Random::seeded(5);
        let mut field = Vector3::new(120.0, -250.0, 500.0);
        let mut blocks = [Block::default(), Block::default()];
        for second in 0..SECONDS {
            field += Vector3::from_fn(|_, _| 0.2 * random.gaussian());
            let spike = if second == 300 { 4000.0 } else { 0.0 };
            let vector = fault(second, field + Vector3::from_fn(|_, _| 0.05 * random.gaussian())) + Vector3::x() * spike;
            let block = &mut blocks[usize::from(second >= 1001)];
            block.time.push(second * SECOND_NS);
            block.range.push(u8::from(second >= 1500));
            (0..3).for_each(|i| block.field[i].push(vector[i]));
        }
        unstated_steps(&blocks, &(0..SECONDS * SECOND_NS), stated, &LeapSeconds::default())
    }

    #[test]
    fn a_gain_or_a_sign_that_changes_is_told_and_spikes_and_what_a_table_states_are_not() {
        assert_eq!(found(&|_, v| v, &[]), None);
        let signed = |at: i64| move |second: i64, v: Vector3<f64>| if second >= at { Vector3::new(v.x, v.y, -v.z) } else { v };
        // The first vector of the second block is the second one behind the step; 1000 s behind 2000-01-01T12:00:00 TT, 64.184 s before UTC.
        let note = found(&signed(1000), &[]).unwrap();
        assert!(
            note.starts_with("the field of the sensor steps by -") && note.contains(" nT in z at 2000-01-01T12:15:35.816"),
            "{note}"
        );
        assert!(!note.contains(" in x") && !note.contains(" in y") && note.contains("no table states a change there"), "{note}");
        assert_eq!(found(&signed(1000), &[1005 * SECOND_NS]), None);
        assert!(found(&signed(1500), &[]).unwrap().contains("the range changes from 0 to 1 there"));
        // For five minutes, with all three components.
        let half = |second: i64, v: Vector3<f64>| if (600..900).contains(&second) { 0.5 * v } else { v };
        let note = found(&half, &[]).unwrap();
        assert!(
            note.contains("steps 2 times, most by") && [" in x", " in y", " in z"].iter().all(|c| note.contains(c)),
            "{note}"
        );
    }

    #[test]
    fn a_shock_behind_which_the_field_is_rough_is_none() {
        // The field jumps by 20 nT, and then changes by a tenth of that from vector to vector.
        let shock = |second: i64, v: Vector3<f64>| {
            let rough = Vector3::new(2.0, 0.0, -2.0) * f64::from(u8::from((second / 7) % 2 == 1));
            if second >= 1200 { v + Vector3::new(12.0, 16.0, 0.0) + rough } else { v }
        };
        assert_eq!(found(&shock, &[]), None);
    }
}
