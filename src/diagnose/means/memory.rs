//! A hysteresis that remembers the largest field, in place of what a term says. Each axis keeps the last extreme of its own field, which fades with every
//! setting until a field exceeds what is left of it: where one does for the first time in many settings it looks like an offset that jumps, and where
//! nothing exceeds it like a drift, or like a memory of the setting before.

use super::chosen::Chosen;
use crate::diagnose::APART;
use crate::diagnose::candidate::Candidate;
use crate::diagnose::result::RunnerUp;
use crate::model::effects::{Column, Record, Row, Spec, UNKNOWN};

/// What is left of an extreme after one setting, of those that are tried; the last never forgets.
const KEPT: [f64; 6] = [0.7, 0.8, 0.85, 0.9, 0.95, 1.0];
/// Its name among the rivals.
const LARGEST: &str = "memory of the largest field";

/// The memory on the axes of a term, the best of all that are tried, where it describes the data as well.
pub(super) fn rival(chosen: &Chosen) -> Option<RunnerUp> {
    let record = &chosen.means.prepared.record;
    let candidate = chosen.candidate;
    if !record.has_fields() || candidate.effect.is_unknown() {
        return None;
    }
    let of = |kept: f64| {
        let column = |axis: &usize| {
            let levels = levels(record, *axis, kept);
            Column::on("h", *axis, "enT/enT", record, |row, _| levels[row])
        };
        let columns = candidate.spec.axes.iter().map(column).collect();
        let memory = Candidate::of_readings(UNKNOWN, Spec::new(LARGEST, &candidate.spec.axes), columns);
        chosen.rival(&memory, KEPT.len()).filter(|r| r.log_ratio > -APART)
    };
    KEPT.into_iter().filter_map(of).max_by(|a, b| a.log_ratio.total_cmp(&b.log_ratio))
}

/// What an axis remembers in every row, enT, if `kept` of it is left after one setting.
fn levels(record: &Record, axis: usize, kept: f64) -> Vec<f64> {
    let remembered = |level: &mut f64, row: &Row| {
        let now = row.linear_ent[axis];
        let left = *level * kept;
        *level = if now.abs() > left.abs() { now } else { left };
        Some(*level)
    };
    record.rows.iter().scan(0.0, remembered).collect()
}
