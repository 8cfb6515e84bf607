//! Levels of a day that stand in the folder of results from before, made of other inputs than those that are made now.

use super::derived::COMMON;
use super::{Flight, Level};
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::time::day_of;
use crate::files::flight::levels::{file_name, partition};
use crate::files::table::series::SeriesTable;
use crate::flight::made::DayMade;
use jiff::civil::Date;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

impl Flight {
    /// What a person should know of levels in the folder that were not made now.
    #[must_use]
    pub fn beside(&self, made: &[DayMade]) -> Vec<Note> {
        of_other_inputs(&self.options.out, made)
    }
}

/// Notes on levels of the same days that were not made now and rest on another state of an input, sensor by sensor.
fn of_other_inputs(out: &Path, days: &[DayMade]) -> Vec<Note> {
    let mut found: BTreeMap<(&str, String), BTreeSet<&str>> = BTreeMap::new();
    for made in days {
        let Ok(day) = made.day.parse::<Date>().map(day_of) else { continue };
        let inputs = |level: &str, sensor: &str| {
            let path = out.join(partition(level, sensor, day)).join(file_name(level, sensor, day));
            path.is_file().then(|| inputs_of(&path)).flatten()
        };
        let Some(own) = made.levels.first().and_then(|level| inputs(level, &made.sensor)) else { continue };
        let is_other = |theirs: &[Input]| theirs.iter().any(|a| own.iter().any(|b| a.path == b.path && a.sha256 != b.sha256));
        for level in Level::ALL.map(Level::letter) {
            // What both sensors share is made by itself.
            for sensor in [made.sensor.as_str(), COMMON] {
                let is_made = days.iter().any(|d| d.sensor == sensor && d.day == made.day && d.levels.iter().any(|l| l == level));
                if !is_made && inputs(level, sensor).is_some_and(|theirs| is_other(&theirs)) {
                    found.entry((sensor, made.day.clone())).or_default().insert(level);
                }
            }
        }
    }
    let note = |((sensor, day), levels): ((&str, String), BTreeSet<&str>)| {
        let levels: Vec<&str> = levels.into_iter().collect();
        let text = format!(
            "level {} of {sensor} on {day} stands in the folder from before, made of other telemetry, tables or configuration than the levels made now",
            levels.join(", ")
        );
        let remedy = "make it again with `calfit flight all`, or take it away";
        Note::new(NoteKind::Mismatch, text).about(sensor).with_remedy(remedy)
    };
    found.into_iter().map(note).collect()
}

/// The inputs that a level says it was made of.
fn inputs_of(path: &Path) -> Option<Vec<Input>> {
    serde_json::from_str(SeriesTable::open(path).ok()?.says("inputs")?).ok()
}
