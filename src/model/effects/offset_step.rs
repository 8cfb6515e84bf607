//! The offset jumps once.

use super::between::{self, BetweenRuns, Cause, Runs, TOGETHER_AND_SINGLY, Term};
use super::{About, Acts, Column, Effect, Family, PART_OF_THE_OFFSETS, Record, Row, ShapeParameter, Spec, TIME, Unseen};
use crate::data::run::Kind;
use crate::model::position::Class;

/// Rows before the first and after the last onset.
const EDGE: usize = 3;
/// Most onsets that are tried.
const MOST_ONSETS: usize = 48;

/// The best onset is looked for within this part of the run to either side of one that was tried: most of the way to the next one.
const FINER_PARTS: f64 = 40.0;
/// Its form.
const STEP: &str = "step";
/// Shape: when it jumps.
pub(super) const ONSET: &str = "onset";

/// The offset jumps once.
pub struct OffsetStep;

impl Effect for OffsetStep {
    fn id(&self) -> &'static str {
        "offset_step"
    }

    fn about(&self) -> About {
        About {
            summary: "offset jumps once",
            formula: "x_i += c for t > onset",
            family: Family::Time,
            seen_in: "all",
            needs: "time",
            source: "BC-MAG-TR-0085, remarks",
            best_measurement: "zero fields between the settings, and the run once more",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(ONSET, "s")] }
    }

    fn is_of_one_run(&self, _form: &str) -> bool {
        true
    }

    fn begins_s(&self, spec: &Spec) -> Option<f64> {
        spec.get(ONSET)
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some(TIME.to_owned())
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_OFFSETS)
    }

    fn shape_range(&self, record: &Record, _spec: &Spec, _name: &str, value: f64) -> [f64; 2] {
        near_onset(record, value)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        let axes = [&[0][..], &[1], &[2], &[0, 1, 2]];
        let steps = |onset_s: f64| axes.map(|a| Spec::new(STEP, a).with(ONSET, onset_s, "s"));
        Ok(onsets_s(record, MOST_ONSETS).into_iter().flat_map(steps).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let onset_s = spec.get(ONSET)?;
        let unit = record.scale.unit();
        Some(spec.axes.iter().map(|&a| Column::on("c", a, unit, record, |_, r| part_after(onset_s, r.used_s))).collect())
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let Some(starts_s) = runs.starts_s() else {
            return Some(BetweenRuns::unseen(Cause::Time, between::NO_TIMES));
        };
        let mut order = starts_s.clone();
        order.sort_by(f64::total_cmp);
        order.dedup();
        let middles_s = order.windows(2).map(|pair| 0.5 * (pair[0] + pair[1]));
        let terms = middles_s.flat_map(|middle_s| {
            let after = |run: usize| if starts_s[run] > middle_s { 1.0 } else { 0.0 };
            TOGETHER_AND_SINGLY.map(|axes| Term {
                spec: Spec::new(STEP, axes).with("tau_0", middle_s, "s"),
                columns: between::Column::per_axis("b", "nT", axes, Class::Offset, runs, after),
            })
        });
        Some(BetweenRuns::tried(Cause::Time, terms.collect()))
    }
}

/// Onsets that are tried, between rows of a record, s since the run's start; about so many.
pub(super) fn onsets_s(record: &Record, most: usize) -> Vec<f64> {
    let times: Vec<f64> = record.rows.iter().map(Row::t_s).collect();
    let inner = times.len().saturating_sub(2 * EDGE);
    let stride = (inner / most).max(1);
    (EDGE..times.len().saturating_sub(EDGE)).step_by(stride).map(|i| 0.5 * (times[i - 1] + times[i])).collect()
}

/// Where the best onset is looked for beside one that was tried, s.
pub(super) fn near_onset(record: &Record, onset_s: f64) -> [f64; 2] {
    let width_s = (record.span_s[1] - record.span_s[0]) / FINER_PARTS;
    [onset_s - width_s, onset_s + width_s]
}

/// The part of a time that lies after the onset: the mean of a plateau in which the offset jumps has a part of the step, which all of it or none
/// would make too small beside slow noise, that is told by neighbours.
pub(super) fn part_after(onset_s: f64, [begin, end]: [f64; 2]) -> f64 {
    if end > begin {
        ((end - onset_s) / (end - begin)).clamp(0.0, 1.0)
    } else if end > onset_s {
        1.0
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::part_after;

    #[test]
    fn a_plateau_has_the_part_of_a_step_that_lies_in_it() {
        assert_eq!([0.0, 10.0, 13.0, 16.0, 20.0].map(|onset_s| part_after(onset_s, [10.0, 16.0])), [1.0, 1.0, 0.5, 0.0, 0.0]);
        // A single reading has all of it or none.
        assert_eq!([9.9, 10.1].map(|onset_s| part_after(onset_s, [10.0, 10.0])), [1.0, 0.0]);
    }
}
