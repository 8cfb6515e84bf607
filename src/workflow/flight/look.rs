//! What is wrong with a configuration and the files that it names, and what there is in the telemetry.

use super::day::Context;
use super::{Carry, Level, Prepared, day_name, prepare};
use crate::data::error::{Finding, Severity};
use crate::data::note::{Note, NoteKind};
use crate::data::time::ns;
use crate::files::flight::edited::plain;
use crate::files::flight::mission::{Mission, Sensor};
use crate::flight::made::DayMade;
use std::collections::BTreeSet;
use std::path::Path;

/// Everything that is wrong with a configuration and with the files that it names; reads no vectors.
#[must_use]
pub fn check(path: &Path) -> Vec<Finding> {
    let mut findings = Vec::new();
    let prepared = match prepare(path, &mut findings) {
        Ok(prepared) => prepared,
        Err(finding) => {
            findings.push(finding);
            return findings;
        }
    };
    findings.extend(prepared.notes_of(None).into_iter().map(|note| {
        // What can be done better is more than what is to be known.
        let (weight, remedy) = match &note.remedy {
            Some(remedy) => (Severity::Warning, remedy.as_str()),
            None => (Severity::Note, "see that it is meant"),
        };
        let rule = Note { remedy: None, ..note.clone() }.to_string();
        Finding::error(&path.display().to_string(), rule, remedy).weighing(weight)
    }));
    for sensor in &prepared.mission.sensors {
        let mut days: Vec<i32> = prepared.catalogue.of(&sensor.name).iter().filter_map(|file| file.day).collect();
        days.dedup();
        findings.extend(no_telemetry(&prepared, &sensor.name, path));
        // A partition may hold a few vectors that belong to the day beside it, so that its model may lack.
        for day in days {
            if let Err(finding) = prepared.daily(sensor, day) {
                findings.push(finding.weighing(Severity::Warning));
            }
        }
    }
    findings
}

/// Says of a sensor that it has no telemetry, if it has none.
pub(super) fn no_telemetry(prepared: &Prepared, sensor: &str, path: &Path) -> Option<Finding> {
    prepared.catalogue.of(sensor).is_empty().then(|| {
        let rule = format!("there is no telemetry of {sensor} in {}", prepared.mission.input.display());
        Finding::error(&path.display().to_string(), rule, "see `input`").weighing(Severity::Warning)
    })
}

/// What there is in the telemetry of all days, as it would be processed, without writing anything; what is wrong with a day goes to
/// `findings`.
///
/// # Errors
/// What is wrong with the configuration or a file that all days need.
pub fn inspect(path: &Path, findings: &mut Vec<Finding>) -> Result<Vec<DayMade>, Finding> {
    let prepared: Prepared = prepare(path, findings)?;
    let carry = Carry::find(&prepared, false)?;
    let wanted: BTreeSet<Level> =
        [Level::A, Level::B, Level::C].into_iter().filter(|level| level.lacks(&prepared).is_none()).collect();
    let mut days = Vec::new();
    for (index, sensor) in prepared.mission.sensors.iter().enumerate() {
        for day in prepared.days(sensor)? {
            match Context::new(&prepared, &carry, index, day, &wanted).make(&mut |_, _, _, _| Ok(())) {
                Ok(made) => days.extend(made),
                Err(finding) => {
                    let rule = format!("{} {}: {}", sensor.name, day_name(day), finding.rule);
                    findings.push(Finding { rule: rule.into(), ..finding });
                }
            }
        }
    }
    days.sort_by(|a: &DayMade, b: &DayMade| (&a.day, &a.sensor).cmp(&(&b.day, &b.sensor)));
    Ok(days)
}

/// Notes on what a configuration states that is most likely a slip: a thermistor column that has the name of another sensor, a time shift that is
/// longer than a packet of its mode.
pub fn slips(mission: &Mission) -> Vec<Note> {
    let name = |sensor: &Sensor| plain(&sensor.name);
    let is_of = |column: &str, other: &Sensor| column.ends_with(&format!("_{}", name(other)));
    let of_other = |sensor: &Sensor| {
        let column = plain(&sensor.thermistor_column);
        let other = mission.sensors.iter().find(|other| name(other) != name(sensor) && is_of(&column, other))?;
        let text = format!(
            "`thermistor_column` of {} is `{}`, which has the name of {}",
            sensor.name, sensor.thermistor_column, other.name
        );
        let remedy = "name the thermistor of the sensor itself, unless it has none";
        Some(Note::new(NoteKind::Temperature, text).about(&sensor.name).with_remedy(remedy))
    };
    let mut notes: Vec<Note> = mission.sensors.iter().filter_map(of_other).collect();
    for mode in &mission.modes {
        let shifts = mode.rates.iter().flatten().filter_map(|rate| rate.shift_ns);
        if let Some(longest) = shifts.map(i64::abs).max().filter(|shift| *shift > ns(mode.packet_s)) {
            let text = format!(
                "a `shift_s` of mode {} is {:.2} s, longer than its packets of {} s",
                mode.sid,
                longest as f64 * 1e-9,
                mode.packet_s
            );
            notes.push(Note::new(NoteKind::Method, text).about(&mode.sid).with_remedy("see that it is in seconds"));
        }
    }
    notes
}
