//! The sensors of a mission against each other: days of both that are made side by side.

use super::{Prepared, day_name};
use crate::data::note::{Note, NoteKind};
use crate::flight::comparison::{Course, Disagreement, compare};
use std::collections::BTreeMap;
use std::sync::{Mutex, PoisonError};

/// Days before the last one whose other sensor may still come: two days are made at a time.
const DAYS_BEFORE: i32 = 2;
const AXES: [&str; 3] = ["x", "y", "z"];

/// Courses of days of which one sensor is made, and what was found of the others.
#[derive(Debug, Default)]
pub struct Courses {
    waiting: Mutex<BTreeMap<i32, (usize, Course)>>,
    notes: Mutex<BTreeMap<i32, Note>>,
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
        let Some(found) = compare(own, other, &axes) else { return };
        let [first, second] = [first, second].map(|index| mission.sensors[*index].name.as_str());
        let day_text = day_name(day);
        let text = match found {
            Disagreement::Unrelated => {
                format!("on {day_text} the field changes from minute to minute at {second} in another way than at {first}")
            }
            Disagreement::Components(list) => {
                let one = |(axis, factors): &(usize, [f64; 3])| {
                    let sum: Vec<String> =
                        factors.iter().zip(AXES).map(|(factor, axis)| format!("{factor:+.2} {axis}")).collect();
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
        let note = Note::new(NoteKind::Mismatch, text).about(second).with_remedy(remedy);
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).insert(day, note);
    }

    /// What was found, day by day.
    pub fn notes(&self) -> Vec<Note> {
        self.notes.lock().unwrap_or_else(PoisonError::into_inner).values().cloned().collect()
    }
}
