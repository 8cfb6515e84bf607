//! Edges of all heaters in one interval, with the background they are found against.

use nalgebra::Vector3;

use super::background::Background;
use super::cells::Cells;
use super::edges::{Edge, Evidence, Normal};
use super::states::{self, Chain, Dwell, Ends};
use super::{HeaterOn, HeaterOptions, PRESENCE, REACH_STDS};

/// What was found in one interval.
#[derive(Clone, Debug)]
pub(super) struct Course {
    /// In order of time.
    pub edges: Vec<Edge>,
    /// What they were found with.
    pub background: Background,
}

/// Background from a course and the course from that background; with `same` only the heaters that switch already may do so.
pub(super) fn next(
    increments: &[Vector3<f64>],
    before: &Course,
    vectors_nt: &[Vector3<f64>],
    dwells: &[Dwell],
    same: bool,
    ends: Ends,
    options: &HeaterOptions,
) -> Course {
    let profile = options.profile();
    let evidence = Evidence { increments, background: &before.background, profile };
    let background = Background::of(&evidence.without(&before.edges, vectors_nt), options.order);
    let present: Vec<usize> =
        (0..vectors_nt.len()).filter(|&heater| before.edges.iter().any(|edge| edge.heater == heater)).collect();
    let evidence = Evidence { increments, background: &background, profile };
    let (_, edges) = most_probable(&evidence, vectors_nt, dwells, same.then_some(&present[..]), ends);
    Course { edges, background }
}

/// Whether the field without the heaters is more probable than the field as it is, each with its own background.
pub(super) fn better(increments: &[Vector3<f64>], course: &Course, vectors_nt: &[Vector3<f64>], options: &HeaterOptions) -> bool {
    let likelihood = |increments: &[Vector3<f64>]| Background::of(increments, options.order).log_likelihood(increments);
    let evidence = Evidence { increments, background: &course.background, profile: options.profile() };
    likelihood(&evidence.without(&course.edges, vectors_nt)) > likelihood(increments) + PRESENCE
}

/// The most probable course of all heaters, or of those `present`: pairs of them at a time, the others as they are. Gives the
/// logarithm of its probability over that of the course without the last pair, which with two heaters is no heater.
pub(super) fn most_probable(
    evidence: &Evidence,
    vectors_nt: &[Vector3<f64>],
    dwells: &[Dwell],
    present: Option<&[usize]>,
    ends: Ends,
) -> (f64, Vec<Edge>) {
    let allowed = |heater: &usize| vectors_nt[*heater].norm() > 0.0 && present.is_none_or(|present| present.contains(heater));
    let heaters: Vec<usize> = (0..vectors_nt.len()).filter(allowed).collect();
    let pairs: Vec<Vec<usize>> = match heaters.len() {
        0 => return (0.0, Vec::new()),
        1 | 2 => vec![heaters.clone()],
        _ => (0..heaters.len())
            .flat_map(|i| (0..i).map(move |j| vec![j, i]))
            .map(|pair| pair.iter().map(|&i| heaters[i]).collect())
            .collect(),
    };
    let sweeps = if pairs.len() > 1 { 2 } else { 1 };
    let mut edges: Vec<Edge> = Vec::new();
    let mut score = 0.0;
    for pair in std::iter::repeat_n(&pairs, sweeps).flatten() {
        let others: Vec<Edge> = edges.iter().filter(|edge| !pair.contains(&edge.heater)).copied().collect();
        let innovations = evidence.background.innovations(&evidence.without(&others, vectors_nt));
        let mut subsets = vec![pair.clone()];
        if pair.len() == 2 && present.is_none() {
            subsets.extend(pair.iter().map(|&heater| vec![heater]));
        }
        let mut best = (0.0, Vec::new());
        for subset in subsets {
            let chains: Vec<Chain> =
                subset.iter().map(|&heater| Chain { heater, vector_nt: vectors_nt[heater], dwell: &dwells[heater] }).collect();
            let (gain, found) = states::most_probable(&innovations, evidence.background, evidence.profile, &chains, ends);
            let gain = gain - PRESENCE * subset.len() as f64;
            if gain > best.0 {
                best = (gain, found);
            }
        }
        score = best.0;
        edges = others;
        edges.extend(best.1);
        edges.sort_by(|a, b| a.cell.total_cmp(&b.cell));
    }
    (score, edges)
}

/// The course with edges that are given: background first without, then with the class vectors.
pub(super) fn given(increments: &[Vector3<f64>], edges: &[Edge], vectors_nt: &[Vector3<f64>], options: &HeaterOptions) -> Course {
    let profile = options.profile();
    let plain = Background::of(increments, 0);
    let evidence = Evidence { increments, background: &plain, profile };
    let mut vectors_nt = vectors_nt.to_vec();
    if vectors_nt.iter().all(|vector| vector.norm() == 0.0) {
        let mut normal = Normal::new(vectors_nt.len());
        normal.add(&evidence, edges);
        let solved = normal.solve();
        vectors_nt.iter_mut().zip(solved).for_each(|(vector, solved)| *vector = solved.map_or(*vector, |(vector, _)| vector));
    }
    let background = Background::of(&evidence.without(edges, &vectors_nt), options.order);
    let mut edges = edges.to_vec();
    let std = options.table_std_s / options.cell_s;
    if std > 0.0 {
        Evidence { increments, background: &background, profile }.refine(&mut edges, &vectors_nt, std, REACH_STDS * std);
    }
    Course { edges, background }
}

/// The edges of a table within an interval.
pub(super) fn of_table(table: &[HeaterOn], cells: &Cells, options: &HeaterOptions) -> Vec<Edge> {
    let length = cells.field_nt.len() as f64;
    let half = options.profile().half_cells();
    let mut edges: Vec<Edge> = table
        .iter()
        .flat_map(|row| [(row.from_tt2000, true), (row.to_tt2000, false)].map(|(time, on)| (row.class, time, on)))
        .map(|(heater, time, on)| Edge { heater, cell: cells.place(time), on, std_cells: options.table_std_s / options.cell_s })
        .filter(|edge| (-half..length + half).contains(&edge.cell))
        .collect();
    edges.sort_by(|a, b| a.cell.total_cmp(&b.cell));
    edges
}
