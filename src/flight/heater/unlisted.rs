//! Whether heaters switch at times that their table does not have.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::background::Background;
use super::cells::Cells;
use super::courses;
use super::edges::Evidence;
use super::{HeaterClass, HeaterMethod, HeaterOptions, edge_s, vectors};

/// Places in a cell at which a step is looked for.
const PLACES_PER_CELL: usize = 2;
/// Logarithm of the probability by which the step of a heater is better than none: e¹⁵ is a hundred times the places and heaters of a day.
const CLEAR: f64 = 15.0;
/// What is left of such a step, in squares of its standard deviation: three normal numbers have more once in a thousand steps.
const MOST_LEFT: f64 = 16.3;
/// Cells between two steps, at least: one step reaches over two cells and what is predicted from them.
const APART_CELLS: usize = 3;

/// Times in intervals of operation at which the field steps as one of these heaters does, and the table has nothing.
#[must_use]
pub fn unlisted(records: &[Cells], classes: &[HeaterClass], options: &HeaterOptions) -> Vec<i64> {
    let HeaterMethod::Table(table) = &options.method else { return Vec::new() };
    let options = &options.with_edges(edge_s(classes));
    let vectors = vectors(classes);
    let of_one = |cells: &Cells| -> Vec<i64> {
        let increments = cells.increments();
        if increments.is_empty() {
            return Vec::new();
        }
        let course = courses::given(&increments, &courses::of_table(table, cells, options), &vectors, options);
        let evidence = Evidence { increments: &increments, background: &course.background, profile: options.profile() };
        let left = evidence.without(&course.edges, &vectors);
        // Steps that are not in the table have made the background larger than it is.
        let background = Background::of(&left, options.order);
        let innovations = background.innovations(&left);
        let evidence = Evidence { background: &background, ..evidence };
        let mut places: Vec<(usize, f64, f64)> = (0..PLACES_PER_CELL * increments.len())
            .filter_map(|place| {
                let cell = place as f64 / PLACES_PER_CELL as f64;
                gain(&evidence, cell, &innovations, &vectors).map(|gain| (place / PLACES_PER_CELL, cell, gain))
            })
            .collect();
        places.sort_by(|a, b| b.2.total_cmp(&a.2));
        let mut found: Vec<(usize, f64)> = Vec::new();
        for (own, cell, _) in places {
            if found.iter().all(|(other, _)| own.abs_diff(*other) >= APART_CELLS) {
                found.push((own, cell));
            }
        }
        found.into_iter().map(|(_, cell)| cells.time_tt2000(cell)).collect()
    };
    let mut all: Vec<i64> = records.par_iter().flat_map_iter(of_one).collect();
    all.sort_unstable();
    all
}

/// Logarithm of the probability that the step of a heater at a place gains over none, for the best heater; `None` where it is not clear, or where
/// the step is not that of the heater.
fn gain(evidence: &Evidence, cell: f64, innovations: &[Vector3<f64>], vectors: &[Vector3<f64>]) -> Option<f64> {
    let (precision, right) = evidence.one_edge(cell, innovations);
    let height = precision.try_inverse()? * right;
    let signed = vectors.iter().filter(|vector| vector.norm() > 0.0).flat_map(|vector| [*vector, -vector]);
    let of = |vector: Vector3<f64>| {
        let other = height - vector;
        let gain = vector.dot(&right) - 0.5 * vector.dot(&(precision * vector));
        (gain > CLEAR && other.dot(&(precision * other)) < MOST_LEFT).then_some(gain)
    };
    signed.filter_map(of).max_by(f64::total_cmp)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flight::heater::simulated::Switching;
    use crate::flight::heater::{HeaterOn, learn};

    #[test]
    fn switching_without_a_row_of_the_table_is_seen() {
        let Switching { time, field_nt, table, interval } = Switching::new(8, [0.8, -0.1, 0.4], 1200);
        let of = |is_kept: &dyn Fn(usize) -> bool| {
            let kept: Vec<HeaterOn> = table.iter().enumerate().filter(|(k, _)| is_kept(*k)).map(|(_, row)| *row).collect();
            let lost = table.len() - kept.len();
            let options = HeaterOptions::new(vec!["h".into()], HeaterMethod::Table(kept));
            let records = [Cells::of(&time, &field_nt, interval, &options).unwrap()];
            let classes = learn(&records, &options).unwrap();
            (unlisted(&records, &classes, &options).len(), 2 * lost)
        };
        assert_eq!(of(&|_| true), (0, 0));
        for is_kept in [&(|k: usize| k.is_multiple_of(2)) as &dyn Fn(usize) -> bool, &|k| !(10..14).contains(&k)] {
            let (found, lost) = of(is_kept);
            assert!(10 * found >= 7 * lost && found <= lost, "{found} of {lost}");
        }
    }
}
