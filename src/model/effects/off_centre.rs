//! The sensor is not at the centre of the coils.

use super::between::{BetweenRuns, Cause, Column, Runs, Term};
use super::{About, Acts, Effect, Family, PART_OF_THE_AMPLITUDE, Spec, Unseen};
use crate::data::run::Kind;
use crate::model::position::Class;
use std::collections::BTreeSet;

/// Form: factors of the sensitivities.
const FACTORS: &str = "k";
/// Form: the same, and changes of the angles.
const FACTORS_AND_ANGLES: &str = "k and K";
/// Why one run cannot show it.
const ABSORBED: Unseen = Unseen::Stated("absorbed by sensitivity and misalignment in one place");

/// The sensor is not at the centre of the coils.
pub struct OffCentre;

impl Effect for OffCentre {
    fn id(&self) -> &'static str {
        "off_centre"
    }

    fn about(&self) -> About {
        About {
            summary: "sensor not at the coil centre",
            formula: "σ¹_i = k_i σ⁰_i, ω¹ = ω⁰ K",
            family: Family::Facility,
            seen_in: "two sets of runs",
            needs: "runs at the centre and beside it",
            source: "RO-IGEP-TR0028 section 3.2.2",
            best_measurement: "one linear calibration at the centre at the same temperature",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::BetweenRuns]
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        Some(if kind == Kind::Frequency { PART_OF_THE_AMPLITUDE } else { ABSORBED })
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let sets = |sensor: usize| runs.of_sensor(sensor).map(|r| runs.0[r].set).collect::<BTreeSet<usize>>().len();
        let two: Vec<usize> = (0..runs.sensors()).filter(|s| sets(*s) == 2).collect();
        if two.is_empty() {
            let reason = "needs two sets of runs of one sensor, told apart by their campaigns";
            return Some(BetweenRuns::unseen(Cause::Place, reason));
        }
        let factors = |sensor: usize| Column::per_axis("k", "", &[0, 1, 2], Class::Scale, runs, elsewhere(runs, sensor));
        let angles =
            |sensor: usize| {
                let elsewhere = elsewhere(runs, sensor);
                ["xi_xy", "xi_xz", "xi_yz"].into_iter().enumerate().map(move |(angle, name)| {
                    Column::of(name.to_owned(), "deg", runs, |class, run, i| {
                        if class == Class::Angle && i == angle { elsewhere(run) } else { 0.0 }
                    })
                })
            };
        let only_factors = two.iter().map(|&s| Term { spec: Spec::new(FACTORS, &[0, 1, 2]), columns: factors(s) });
        let both = two.iter().map(|&s| Term {
            spec: Spec::new(FACTORS_AND_ANGLES, &[0, 1, 2]),
            columns: factors(s).into_iter().chain(angles(s)).collect(),
        });
        Some(BetweenRuns::tried(Cause::Place, only_factors.chain(both).collect()))
    }
}

/// 1 for the runs of a sensor that were not made in the place of its first one.
fn elsewhere(runs: &Runs, sensor: usize) -> impl Fn(usize) -> f64 {
    let first = runs.of_sensor(sensor).next().map(|r| runs.0[r].set);
    move |run| if runs.0[run].sensor == sensor && Some(runs.0[run].set) != first { 1.0 } else { 0.0 }
}
