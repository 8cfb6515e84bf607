//! Whether the field switches when the table of heaters says so.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::background::Background;
use super::cells::Cells;
use super::courses;
use super::edges::{Edge, Evidence, Normal};
use super::{HeaterMethod, HeaterOptions};

/// How far a table is moved in the search for times that fit the field, cells, and by which steps.
const MOST_CELLS: f64 = 120.0;
const STEP_CELLS: f64 = 0.5;
/// Of fewer edges nothing is said.
const LEAST_EDGES: usize = 10;
/// Logarithm of the probability by which other times must be better, or the times of the table better than none: e²⁵, more than there are times
/// to try and numbers to fit.
const CLEAR: f64 = 25.0;

/// What the field says of the times of a table.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum TableTimes {
    /// It switches then.
    Right,
    /// It switches so many seconds later.
    Later(f64),
    /// It does not switch by more than noise, neither then nor so many seconds before or after.
    Unseen(f64),
}

/// Compares the times of the table with the field of some intervals; `None` without a table, or where it has
/// few edges between vectors of them.
#[must_use]
pub fn table_times(records: &[Cells], options: &HeaterOptions) -> Option<TableTimes> {
    let HeaterMethod::Table(table) = &options.method else { return None };
    let profile = options.profile();
    let intervals: Vec<(Vec<Edge>, Vec<Vector3<f64>>, Background)> = records
        .par_iter()
        .map(|cells| {
            let increments = cells.increments();
            let background = Background::of(&increments, 0);
            (courses::of_table(table, cells, options), increments, background)
        })
        .collect();
    // An edge between vectors that are far apart tells nothing.
    let is_within = |increments: &[Vector3<f64>], edge: &Edge| {
        increments.get(edge.cell.round().max(0.0) as usize).is_some_and(|own| own.x.is_finite())
    };
    let of_one = |(edges, increments, _): &(Vec<Edge>, Vec<Vector3<f64>>, Background)| {
        edges.iter().filter(|edge| is_within(increments, edge)).count()
    };
    if intervals.iter().map(of_one).sum::<usize>() < LEAST_EDGES {
        return None;
    }
    // Half of what the fields of the heaters take off the sum of squares, each in units of its variance.
    let gain = |by_cells: f64| -> f64 {
        let of_one = |(edges, increments, background): &(Vec<Edge>, Vec<Vector3<f64>>, Background)| {
            let edges: Vec<Edge> = edges.iter().map(|edge| Edge { cell: edge.cell + by_cells, ..*edge }).collect();
            let mut normal = Normal::new(options.classes.len());
            normal.add(&Evidence { increments, background, profile }, &edges);
            normal
        };
        let all = intervals.iter().map(of_one);
        0.5 * all.fold(Normal::new(options.classes.len()), |sum, own| sum.merge(&own)).explained()
    };
    let steps = (MOST_CELLS / STEP_CELLS) as i32;
    // Of times that fit as well the nearest one.
    let mut tried: Vec<(f64, f64)> =
        (-steps..=steps).into_par_iter().map(|step| f64::from(step) * STEP_CELLS).map(|by| (by, gain(by))).collect();
    tried.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    let as_is = tried[0].1;
    let (by_cells, best) = tried.into_iter().reduce(|best, next| if next.1 > best.1 { next } else { best })?;
    Some(if best > as_is + CLEAR {
        TableTimes::Later(by_cells * options.cell_s)
    } else if as_is < CLEAR {
        TableTimes::Unseen(MOST_CELLS * options.cell_s)
    } else {
        TableTimes::Right
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::heater::simulated::{SECOND, Switching};
    use crate::flight::heater::{HeaterInterval, HeaterOn};

    #[test]
    fn times_of_a_table_that_are_late_or_of_another_day_are_seen() {
        let Switching { time, field_nt, table, .. } = Switching::new(5, [0.5, -0.1, 0.2], 600);
        let of = |add_s: i64, interval: [i64; 2]| {
            let moved = |row: &HeaterOn| HeaterOn {
                from_tt2000: row.from_tt2000 + add_s * SECOND,
                to_tt2000: row.to_tt2000 + add_s * SECOND,
                ..*row
            };
            let method = HeaterMethod::Table(table.iter().map(moved).collect());
            let options = HeaterOptions::new(vec!["h".into()], method);
            let interval = HeaterInterval { from_tt2000: interval[0] * SECOND, to_tt2000: interval[1] * SECOND };
            table_times(&[Cells::of(&time, &field_nt, interval, &options).unwrap()], &options)
        };
        assert_eq!(of(0, [0, 600]), Some(TableTimes::Right));
        for late_s in [1, 10, -45] {
            assert_eq!(of(late_s, [0, 600]), Some(TableTimes::Later(-late_s as f64)), "{late_s}");
        }
        assert_eq!(of(0, [0, 15]), None);
        // Another table: its times say nothing of the field.
        let other: Vec<HeaterOn> = (0..20)
            .map(|k| HeaterOn { from_tt2000: (k * 29 + 3) * SECOND, to_tt2000: (k * 29 + 14 + k % 5) * SECOND, class: 0 })
            .collect();
        let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Table(other));
        let interval = HeaterInterval { from_tt2000: 0, to_tt2000: 600 * SECOND };
        let found = table_times(&[Cells::of(&time, &field_nt, interval, &options).unwrap()], &options);
        assert_eq!(found, Some(TableTimes::Unseen(120.0)));
    }
}
