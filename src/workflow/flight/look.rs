//! What is wrong with a configuration and the files that it names, and what there is in the telemetry.

use super::day::{Context, Product};
use super::{Carry, Level, Prepared, day_name, housekeeping, prepare};
use crate::data::error::{Finding, Severity};
use crate::data::flags::Flags;
use crate::data::note::{Note, NoteKind};
use crate::data::time::{LeapSeconds, Tt2000, ns};
use crate::files::flight::edited::{EditedFile, check_columns, columns, day_files, lacks, plain};
use crate::files::flight::mission::{Mission, Sensor, Span};
use crate::flight::made::DayMade;
use serde::Serialize;
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
        let files = one_of_each_day(prepared.catalogue.of(&sensor.name));
        findings.extend(once(files.filter_map(|file| check_columns(file, sensor, &prepared.mission).err())));
    }
    findings.extend(check_housekeeping(&prepared));
    findings
}

/// The first file of every partition, and all that stand in none: the files of a day have the same columns.
fn one_of_each_day(files: &[EditedFile]) -> impl Iterator<Item = &EditedFile> {
    files
        .iter()
        .enumerate()
        .filter(|(at, file)| file.day.is_none() || *at == 0 || files[at - 1].day != file.day)
        .map(|(_, file)| file)
}

/// Of findings that say the same of many files that of the first one.
fn once(findings: impl Iterator<Item = Finding>) -> Vec<Finding> {
    let mut rules = BTreeSet::new();
    findings.filter(|finding| rules.insert(finding.rule.to_string())).collect()
}

/// What is wrong with the folder of the housekeeping and the columns that fields follow; no readings are read.
fn check_housekeeping(prepared: &Prepared) -> Vec<Finding> {
    let mission = &prepared.mission;
    let Some(folder) = &mission.hk else { return Vec::new() };
    let files = match day_files(folder) {
        Ok(files) => files,
        Err(finding) => return vec![finding],
    };
    if files.is_empty() {
        let rule = "holds no tables of housekeeping";
        return vec![Finding::error(&folder.display().to_string(), rule, "see `hk`").weighing(Severity::Warning)];
    }
    let faults = one_of_each_day(&files).flat_map(|file| match columns(&file.path) {
        Err(finding) => vec![finding],
        Ok(names) => {
            let stated = mission.disturbances.iter().map(|stated| stated.column.as_str());
            stated.filter(|name| !names.contains_key(&plain(name))).map(|name| lacks(&file.path, name, names.values())).collect()
        }
    });
    once(faults)
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
pub fn inspect(path: &Path, findings: &mut Vec<Finding>) -> Result<Vec<Inspected>, Finding> {
    let prepared: Prepared = prepare(path, findings)?;
    let carry = Carry::find(&prepared, false)?;
    let wanted: BTreeSet<Level> =
        [Level::A, Level::B, Level::C].into_iter().filter(|level| level.lacks(&prepared).is_none()).collect();
    // What is wrong with the housekeeping, `check` says.
    let hk_days = housekeeping::days(&prepared).unwrap_or_default();
    let mut days = Vec::new();
    for (index, sensor) in prepared.mission.sensors.iter().enumerate() {
        for day in prepared.days(sensor)? {
            let tables = tables_of(&prepared, sensor, day, &hk_days);
            let own = prepared.leap.day(day);
            let mut inside = vec![0; tables.len()];
            let (mut gaps, mut before) = (Vec::new(), None);
            let made = Context::new(&prepared, &carry, index, day, &wanted).make(&mut |level, product, _, _| {
                if let (Level::A, Product::Vectors(blocks)) = (level, product) {
                    for block in blocks {
                        let times = &block.time[block.rows_in(&own)];
                        inside.iter_mut().zip(&tables).for_each(|(count, table)| *count += table.held(times));
                        for row in block.rows_in(&own).filter(|row| Flags(block.flags[*row]).any_of(Flags::GAP)) {
                            let earlier = row.checked_sub(1).map(|row| block.time[row]).or(before);
                            gaps.extend(earlier.map(|from| (block.time[row] - from, from)));
                        }
                        before = block.time.last().copied().or(before);
                    }
                }
                Ok(())
            });
            match made {
                Ok(Some(made)) => {
                    let of = made.written;
                    let covered = |(table, count): (Table, usize)| table.covered(count, of, &prepared.leap);
                    let tables = tables.into_iter().zip(inside).filter(|_| of > 0).map(covered).collect();
                    days.push(Inspected { day: made, tables, gaps: longest(gaps, &prepared.leap) });
                }
                Ok(None) => {}
                Err(finding) => {
                    let rule = format!("{} {}: {}", sensor.name, day_name(day), finding.rule);
                    findings.push(Finding { rule: rule.into(), ..finding });
                }
            }
        }
    }
    days.sort_by(|a: &Inspected, b: &Inspected| (&a.day.day, &a.day.sensor).cmp(&(&b.day.day, &b.day.sensor)));
    Ok(days)
}

/// A day of a sensor with what its tables hold of it.
#[derive(Clone, Debug, Serialize)]
pub struct Inspected {
    /// What there is in the telemetry.
    #[serde(flatten)]
    pub day: DayMade,
    /// The tables that the configuration names; none of a day without vectors.
    pub tables: Vec<Covered>,
    /// The longest gaps between vectors of the day, the longest one first.
    pub gaps: Vec<Gap>,
}

/// A gap between two vectors.
#[derive(Clone, Debug, Serialize)]
pub struct Gap {
    /// Corrected time of the last vector before it, UTC.
    pub from: String,
    /// That of the first one behind it.
    pub to: String,
    /// Its length, s.
    pub seconds: f64,
}

/// The longest of some gaps, by length and begin in ns.
fn longest(mut gaps: Vec<(i64, Tt2000)>, leap: &LeapSeconds) -> Vec<Gap> {
    const MOST: usize = 100;
    gaps.sort_by_key(|(length, from)| (-length, *from));
    let shown = |(length, from): &(i64, Tt2000)| Gap {
        from: leap.utc(*from).to_string(),
        to: leap.utc(from + length).to_string(),
        seconds: *length as f64 * 1e-9,
    };
    gaps.iter().take(MOST).map(shown).collect()
}

/// How much of a day a table holds.
#[derive(Clone, Debug, Serialize)]
pub struct Covered {
    /// What the table is of.
    pub table: &'static str,
    /// The file; absent for entries of the configuration and for files of single days.
    pub file: Option<String>,
    /// First time of the table, UTC; absent for files of single days.
    pub from: Option<String>,
    /// Its last time, UTC, or the end of its last interval.
    pub to: Option<String>,
    /// Share of the vectors of the day between its ends, or in one of its intervals.
    pub covered: f64,
}

/// When a table holds.
struct Table {
    name: &'static str,
    file: Option<String>,
    /// First and last time; files of single days have none that a person should know.
    ends: Option<[Tt2000; 2]>,
    /// Stretches in order that do not meet.
    spans: Vec<Span>,
}

impl Table {
    fn new(name: &'static str, file: Option<String>, mut spans: Vec<Span>) -> Self {
        spans.sort_unstable();
        // Entries of several ranges hold at the same time.
        let mut apart: Vec<Span> = Vec::new();
        for span in spans {
            match apart.last_mut() {
                Some(last) if span.from <= last.to => last.to = last.to.max(span.to),
                _ => apart.push(span),
            }
        }
        let ends = apart.first().zip(apart.last()).map(|(first, last)| [first.from, last.to]);
        Self { name, file, ends, spans: apart }
    }

    /// One of rows, between the first and the last of which it holds.
    fn of_rows(name: &'static str, file: Option<String>, span: Span) -> Self {
        Self { name, file, ends: Some([span.from, span.to - 1]), spans: vec![span] }
    }

    /// One of a file for the day alone.
    fn of_day(name: &'static str, span: Option<Span>) -> Self {
        Self { name, file: None, ends: None, spans: span.into_iter().collect() }
    }

    /// How many of some times that rise it holds.
    fn held(&self, times: &[Tt2000]) -> usize {
        let before = |time: Tt2000| times.partition_point(|own| *own < time);
        self.spans.iter().map(|span| before(span.to) - before(span.from)).sum()
    }

    fn covered(self, count: usize, of: usize, leap: &LeapSeconds) -> Covered {
        let [from, to] = [0, 1].map(|end| self.ends.map(|ends| leap.utc(ends[end]).to_string()));
        #[expect(clippy::cast_precision_loss, reason = "a day has some millions of vectors")]
        let covered = count as f64 / of as f64;
        Covered { table: self.name, file: self.file, from, to, covered }
    }
}

/// The tables of a sensor and day that the configuration names.
fn tables_of(prepared: &Prepared, sensor: &Sensor, day: i32, hk_days: &BTreeSet<i32>) -> Vec<Table> {
    let mission = &prepared.mission;
    let shown = |path: &Path| Some(path.strip_prefix(&mission.folder).unwrap_or(path).to_string_lossy().into_owned());
    let whole = prepared.leap.day(day);
    let whole = Span { from: whole.start, to: whole.end };
    let mut list = Vec::new();
    if let Some(table) = &prepared.attitude {
        list.push(Table::of_rows("attitude", shown(table.path()), table.span()));
    }
    if let Some(table) = &prepared.positions {
        list.push(Table::of_rows("position", shown(table.path()), table.span()));
    }
    if let Some(table) = &prepared.wheels {
        list.push(Table::of_rows("wheels", shown(table.path()), table.span()));
    }
    if let Some(states) = &prepared.heater {
        let path = mission.heater.as_ref().and_then(|heater| heater.table.as_ref());
        let ends = states.iter().map(|on| on.from_tt2000).min().zip(states.iter().map(|on| on.to_tt2000).max());
        // Between two rows a heater is off, so that the table holds from its first to its last one.
        let span = ends.map(|(from, to)| Span { from, to });
        list.push(Table::new("heater", path.and_then(|path| shown(path)), span.into_iter().collect()));
    }
    if !sensor.rotations.is_empty() {
        list.push(Table::new("rotation", None, sensor.rotations.iter().map(|state| state.span).collect()));
    }
    if !sensor.jumps.is_empty() {
        let file = sensor.offsets.as_ref().and_then(|(path, _)| shown(path));
        list.push(Table::new("offsets", file, sensor.jumps.iter().map(|jump| jump.span).collect()));
    }
    if sensor.daily.is_some() {
        let is_there = prepared.daily(sensor, day).is_ok_and(|model| model.is_some());
        list.push(Table::of_day("daily", is_there.then_some(whole)));
    }
    if mission.hk.is_some() {
        list.push(Table::of_day("hk", hk_days.contains(&day).then_some(whole)));
    }
    list
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
