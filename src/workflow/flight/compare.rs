//! The sensors of a mission against each other: days of both that are made side by side.

use super::{Prepared, day_name};
use crate::data::note::{Note, NoteKind};
use crate::data::time::Tt2000;
use crate::files::flight::mission::{OffsetFrame, Sensor};
use crate::flight::comparison::{Course, Disagreement, compare};
use crate::flight::delay::{Delay, delay, delays_of_modes};
use crate::flight::table_edges::{TableEdge, steps_at_edges};
use nalgebra::Vector3;
use std::collections::{BTreeMap, BTreeSet};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

/// Days before the last one whose other sensor may still come: two days are made at a time.
const DAYS_BEFORE: i32 = 2;
const AXES: [&str; 3] = ["x", "y", "z"];

/// Courses of days of which one sensor is made, and what was found of the others.
#[derive(Debug, Default)]
pub struct Courses {
    waiting: Mutex<BTreeMap<i32, (usize, Course)>>,
    notes: Mutex<BTreeMap<i32, Vec<Note>>>,
}

impl Courses {
    /// Takes the course of a sensor and day, and compares it with that of the other one if that has come before.
    pub fn take(&self, prepared: &Prepared, day: i32, index: usize, course: Course) {
        let other = {
            let mut waiting = self.waiting.lock().unwrap_or_else(PoisonError::into_inner);
            waiting.retain(|own, _| *own + DAYS_BEFORE >= day);
            match waiting.remove(&day) {
                Some(other) => other,
                None => {
                    waiting.insert(day, (index, course));
                    return;
                }
            }
        };
        let mission = &prepared.mission;
        let mut both = [(index, course), other];
        // The primary sensor first.
        both.sort_by_key(|(index, _)| (mission.roles.of(&mission.sensors[*index].name, prepared.leap.day(day).start), *index));
        let [(first, own), (second, other)] = &both;
        let axes = |time| {
            let state = mission.sensors[*first].rotations.iter().find(|state| state.span.holds(time));
            state.map(|state| state.uvw_to_sc.transpose())
        };
        let [first, second] = [first, second].map(|index| mission.sensors[*index].name.as_str());
        let modes: Vec<&str> = mission.modes.iter().map(|mode| mode.sid.as_str()).collect();
        let notes: Vec<Note> = late(own, other, [first, second], &modes, day)
            .into_iter()
            .chain(compare(own, other, &axes).map(|found| unlike(&found, [first, second], day)))
            .collect();
        if !notes.is_empty() {
            self.notes.lock().unwrap_or_else(PoisonError::into_inner).insert(day, notes);
        }
    }

    /// What was found, day by day.
    pub fn notes(&self) -> Vec<Note> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).values().flatten().cloned().collect()
    }
}

/// A note on changes of one sensor that are not those of the other.
fn unlike(found: &Disagreement, [first, second]: [&str; 2], day: i32) -> Note {
    let day_text = day_name(day);
    let text = match found {
        Disagreement::Unrelated => {
            format!("on {day_text} the field changes from minute to minute at {second} in another way than at {first}")
        }
        Disagreement::Components(list) => {
            let one = |(axis, factors): &(usize, [f64; 3])| {
                let sum: Vec<String> = factors.iter().zip(AXES).map(|(factor, axis)| format!("{factor:+.2} {axis}")).collect();
                format!("{} of {second} as {}", AXES[*axis], sum.join(" "))
            };
            let all: Vec<String> = list.iter().map(one).collect();
            format!(
                "on {day_text} changes from minute to minute, in axes of {first}, are not alike: {} of {first}",
                all.join(", ")
            )
        }
    };
    let remedy = "check axes, signs, scale, rotations and times of both; a source on the spacecraft that is stronger than the field \
                  outside changes the sizes as well";
    Note::new(NoteKind::Mismatch, text).about(second).with_remedy(remedy)
}

/// Notes on times of one sensor that are late against those of the other, of all modes or of single ones.
fn late(own: &Course, other: &Course, [first, second]: [&str; 2], modes: &[&str], day: i32) -> Vec<Note> {
    let note = |found: &Delay, mode: &str, remedy: &str| {
        let (early, late) = if found.second_late_s > 0.0 { (first, second) } else { (second, first) };
        let text = format!(
            "on {}{mode} the field changes {:.1} s +- {:.1} s later at {late} than at {early}, and it reaches both at once",
            day_name(day),
            found.second_late_s.abs(),
            found.std_s
        );
        Note::new(NoteKind::Mismatch, text).about(second).with_remedy(remedy)
    };
    if let Some(found) = delay(own, other) {
        return vec![note(&found, "", "check the time scale and the clock of both, and the shifts of their modes")];
    }
    let of_mode = |(mode, found): (u8, Delay)| {
        let sid = modes.get(usize::from(mode)).copied().unwrap_or_default();
        note(&found, &format!(" in mode {sid}"), "check `shift_s` of this mode of both: its sign, its size and its role")
    };
    delays_of_modes(own, other).into_iter().map(of_mode).collect()
}

/// Notes on steps of the field of a sensor in axes of the spacecraft where its boom states or its table of offsets change within a day.
pub fn steps_of_tables(prepared: &Prepared, course: &Course, sensor: &Sensor, day: &Range<Tt2000>) -> Vec<String> {
    let acts = |step: &str| prepared.mission.steps.iter().any(|own| own == step);
    if !acts("rotate") {
        return Vec::new();
    }
    let state = |time: Tt2000| sensor.rotations.iter().find(|state| state.span.holds(time)).map(|state| state.uvw_to_sc);
    let jumps = || sensor.jumps.iter().filter(|jump| acts("offsets") && jump.range.is_none());
    // What is taken off at a time, in axes of the spacecraft.
    let offset = |time: Tt2000| {
        let of =
            |frame: OffsetFrame| jumps().find(|jump| jump.frame == frame && jump.span.holds(time)).map(|jump| jump.subtract_nt);
        let uvw = of(OffsetFrame::Uvw).zip(state(time)).map(|(taken, turn)| turn * taken);
        match (of(OffsetFrame::Sc), uvw) {
            (Some(sc), Some(uvw)) => Some(sc + uvw),
            (one, other) => one.or(other),
        }
    };
    let spans = sensor.rotations.iter().map(|state| state.span).chain(jumps().map(|jump| jump.span));
    let times: BTreeSet<Tt2000> = spans.flat_map(|span| [span.from, span.to]).filter(|time| day.contains(time)).collect();
    let edge = |time: Tt2000| -> Option<TableEdge> {
        let (before, behind) = (state(time - 1)?, state(time)?);
        // Beside a time that the table leaves out nothing is known, and vectors there have their flag.
        let (taken_before, taken) = match (offset(time - 1), offset(time)) {
            (None, None) => (Vector3::zeros(), Vector3::zeros()),
            (own, next) => (own?, next?),
        };
        let what = if before == behind { "the table of offsets" } else { "the boom state" };
        // Without the change the readings would be turned as before, and have the offset of before taken off.
        let turn = before * behind.transpose();
        let add_nt = turn * taken - taken_before;
        (before != behind || add_nt != Vector3::zeros()).then_some(TableEdge { time, what, turn, add_nt })
    };
    let edges: Vec<TableEdge> = times.into_iter().filter_map(edge).collect();
    steps_at_edges(course, &edges, &prepared.leap)
}
