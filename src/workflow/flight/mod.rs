//! Flight processing: a mission's telemetry to levels, day by day, with everything that a day needs of the others known before.

mod beside;
mod carry;
mod compare;
mod daily_models;
mod day;
mod derived;
mod difference;
mod ground;
mod housekeeping;
mod levels;
mod look;
mod near;
mod picture;
mod steps;
mod write;

pub use carry::{Carry, CarryRow};
pub use daily_models::{DailyModels, DailyOptions, make_daily};
pub use difference::{DifferenceOptions, diagnose_flight};
pub use ground::Ground;
pub use levels::{Level, Levels, NoLevels};
pub use look::{Covered, Gap, Inspected, check, inspect};
pub use picture::check_day;

use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::time::{LeapSeconds, Tt2000};
use crate::files::flight::auxiliary::{self, Attitude, HeaterOn, Positions, Timeline, WheelRates};
use crate::files::flight::daily::{self, DailyModel};
use crate::files::flight::edited::{BEYOND_NS, Catalogue, EditedFile};
use crate::files::flight::mission::{Mission, Sensor, overlap};
use crate::files::flight::read_mission;
use crate::files::output::Folder;
use crate::files::source::hex;
use crate::flight::made::DayMade;
use crate::flight::stage_of;
use compare::Courses;
use day::Context;
use jiff::civil::Date;
use near::Near;
use picture::Pictures;
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::cell::{Cell, RefCell};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use write::{DayWriter, Written};

/// What is processed, and where it goes.
#[derive(Clone, Debug)]
pub struct FlightOptions {
    /// Levels that are written.
    pub levels: Levels,
    /// Only this sensor.
    pub sensor: Option<String>,
    /// First and last day, counted from 1970-01-01.
    pub days: [Option<i32>; 2],
    /// What the first pass found, from a file.
    pub carry: Option<PathBuf>,
    /// Folder of the results.
    pub out: PathBuf,
    /// Foreign files are written over.
    pub force: bool,
    /// Figures are drawn.
    pub plots: bool,
}

/// A mission with everything that its configuration names, read and checked.
pub struct Prepared {
    /// The configuration.
    pub mission: Mission,
    /// Leap seconds.
    pub leap: LeapSeconds,
    /// Files of telemetry.
    pub catalogue: Catalogue,
    /// Ground calibrations, sensor by sensor; absent for matrices.
    pub ground: Vec<Option<Ground>>,
    /// Attitude.
    pub attitude: Option<Timeline<Attitude>>,
    /// Positions.
    pub positions: Option<Timeline<Positions>>,
    /// Wheels.
    pub wheels: Option<Timeline<WheelRates>>,
    /// Heater states.
    pub heater: Option<Vec<HeaterOn>>,
    /// The configuration and all tables, by what they are.
    pub inputs: Vec<Input>,
    /// What was read near the midnights.
    near: Near,
    /// What a person should know of the mission as a whole.
    notes: Vec<Note>,
    /// SHA-256 over the configuration and everything that it names but telemetry and daily models.
    pub configuration: String,
}

/// A day that was not made.
#[derive(Clone, Debug, Serialize)]
pub struct DayFailed {
    /// Sensor, or HK.
    pub sensor: String,
    /// Day, `YYYY-MM-DD`.
    pub day: String,
    /// Why.
    pub error: Finding,
}

/// What flight processing made.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FlightMade {
    /// Days of sensors that were made.
    pub days: Vec<DayMade>,
    /// Days that were not.
    pub failed: Vec<DayFailed>,
    /// What a person should know.
    pub notes: Vec<Note>,
}

impl FlightMade {
    /// Notes on days without vectors between days that have some: an archive may have lost them.
    #[must_use]
    pub fn days_missing(&self) -> Vec<Note> {
        let mut days: BTreeMap<&str, Vec<Date>> = BTreeMap::new();
        // What two sensors share lacks where one of them does, which says so.
        for made in self.days.iter().filter(|made| made.rows.read > 0 && made.sensor != derived::COMMON) {
            days.entry(made.sensor.as_str()).or_default().extend(made.day.parse::<Date>());
        }
        // A day that failed has said why.
        for failed in &self.failed {
            days.entry(failed.sensor.as_str()).or_default().extend(failed.day.parse::<Date>());
        }
        let mut notes = Vec::new();
        for (sensor, mut own) in days {
            own.sort_unstable();
            for pair in own.windows(2) {
                let (Ok(first), Ok(last)) = (pair[0].tomorrow(), pair[1].yesterday()) else { continue };
                if first <= last {
                    let when = if first == last { format!("on {first}") } else { format!("from {first} to {last}") };
                    let text = format!("{sensor} has no vectors {when}, between days that have some");
                    notes.push(Note::new(NoteKind::Losses, text).about(sensor));
                }
            }
        }
        notes
    }
}

/// A part of the work that can be done by itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
enum Task {
    /// The levels of a sensor.
    Levels(usize),
    /// What both sensors share.
    Common,
    /// Housekeeping.
    Housekeeping,
}

/// A day of a sensor, or of the housekeeping.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Job {
    day: i32,
    task: Task,
}

/// Reads a mission and what its configuration names; vectors are not read.
///
/// # Errors
/// What is wrong with it; where that is several things, all but the last go to `findings`.
pub fn prepare(path: &Path, findings: &mut Vec<Finding>) -> Result<Prepared, Finding> {
    prepare_of(path, None, findings)
}

/// The same where one sensor is asked for, of which telemetry is that does not tell its sensor itself.
fn prepare_of(path: &Path, sensor: Option<&str>, findings: &mut Vec<Finding>) -> Result<Prepared, Finding> {
    let leap = LeapSeconds::default();
    let (mut mission, digested) = read_mission(path, &leap)?;
    check_steps(path, &mission)?;
    let name = |path: &Path| path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let mut wrong: Vec<Finding> = Vec::new();
    let mut inputs = vec![digested.input(name(path))];
    let mut ground = Vec::new();
    for sensor in &mission.sensors {
        let read = if sensor.ground.is_empty() { None } else { take(ground::read(sensor, findings), &mut wrong) };
        if let Some(read) = &read {
            inputs.extend(read.inputs.clone());
        }
        ground.push(read);
    }
    let rule = mission.time_rule;
    let mut table = |input: Input| inputs.push(input);
    for sensor in &mut mission.sensors {
        let Some((path, frame)) = &sensor.offsets else { continue };
        let read = auxiliary::offsets(path, &sensor.name, *frame, rule, &leap).and_then(|(further, input)| {
            let all = [sensor.jumps.clone(), further].concat();
            match overlap(all.iter().map(|jump| (jump.span, jump.range))) {
                Some(at) => {
                    let rule = format!("two offsets of the sensor hold at {}", leap.utc(at));
                    let remedy =
                        "intervals are half-open, [from, to), one for every moment and range; [[sensor.jump]] counts with the table";
                    Err(Finding::error(&path.display().to_string(), rule, remedy))
                }
                None => Ok((all, input)),
            }
        });
        if let Some((all, input)) = take(read, &mut wrong) {
            table(input);
            sensor.jumps = all;
        }
    }
    let celestial = mission.celestial.as_ref();
    let attitude =
        celestial.and_then(|c| take(Timeline::open(&c.attitude, c.clone(), rule, &leap), &mut wrong)).map(|(read, input)| {
            table(input);
            read
        });
    let with_positions = celestial.and_then(|c| Some((c.position.as_ref()?, c.frame.clone())));
    let positions = with_positions.and_then(|(path, frame)| take(Timeline::open(path, frame, rule, &leap), &mut wrong)).map(
        |(read, input)| {
            table(input);
            read
        },
    );
    let wheels =
        mission.wheels.as_ref().and_then(|w| take(Timeline::open(&w.table, (), rule, &leap), &mut wrong)).map(|(read, input)| {
            table(input);
            read
        });
    let states = mission.heater.as_ref().and_then(|h| h.table.as_ref().map(|path| (h, path)));
    let heater =
        states.and_then(|(h, path)| take(auxiliary::heater(path, &h.classes, rule, &leap), &mut wrong)).map(|(read, input)| {
            table(input);
            read
        });
    let notes = derived::turning_coupling(&mission.common).into_iter().chain(look::slips(&mission)).collect();
    let catalogue = take(Catalogue::open(&mission, sensor), &mut wrong);
    let last = wrong.pop();
    findings.append(&mut wrong);
    match (last, catalogue) {
        (None, Some(catalogue)) => {
            let configuration = together(&inputs);
            let near = Near::default();
            Ok(Prepared {
                configuration,
                mission,
                leap,
                catalogue,
                ground,
                attitude,
                positions,
                wheels,
                heater,
                inputs,
                near,
                notes,
            })
        }
        (Some(finding), _) => Err(finding),
        (None, None) => Err(Finding::error(&path.display().to_string(), "names no telemetry", "see `input`")),
    }
}

/// A hash over the hashes of files.
fn together(inputs: &[Input]) -> String {
    let mut hash = Sha256::new();
    inputs.iter().for_each(|input| hash.update(input.sha256.as_bytes()));
    hex(&hash.finalize())
}

/// A result, or nothing with what is wrong put to the rest.
fn take<T>(result: Result<T, Finding>, wrong: &mut Vec<Finding>) -> Option<T> {
    result.map_err(|finding| wrong.push(finding)).ok()
}

/// The steps must be known, each once, and lead from level to level.
fn check_steps(path: &Path, mission: &Mission) -> Result<(), Finding> {
    let refuse = |rule: String, remedy: &str| Err(Finding::error(&path.display().to_string(), rule, remedy));
    let mut before = None;
    for (index, step) in mission.steps.iter().enumerate() {
        let Some(stage) = stage_of(step) else {
            return refuse(
                format!("`pipeline.steps` names `{step}`, which is no step"),
                "the steps are counts, temperature, ground, daily, shift, disturbance, rotate, offsets, attitude",
            );
        };
        if mission.steps[..index].contains(step) {
            return refuse(format!("`pipeline.steps` names `{step}` twice"), "every step acts once");
        }
        if before.is_some_and(|b| b > stage) {
            let rule = format!("`pipeline.steps` names `{step}` behind a step of a later level");
            return refuse(rule, "first the steps in axes of the sensor, then those of the spacecraft, then the attitude");
        }
        before = Some(stage);
    }
    let place = |name: &str| mission.steps.iter().position(|s| s == name);
    let has_files = mission.sensors.iter().any(|sensor| !sensor.ground.is_empty());
    for (needed, is_needed) in [("counts", true), ("temperature", has_files), ("ground", true)] {
        if is_needed && place(needed).is_none() {
            let rule = format!("`pipeline.steps` lacks `{needed}`, without which there is no field");
            return refuse(rule, "name counts, temperature and ground");
        }
    }
    for [first, second] in [["counts", "ground"], ["temperature", "ground"], ["ground", "daily"], ["ground", "disturbance"]] {
        if place(first).zip(place(second)).is_some_and(|(a, b)| a > b) {
            return refuse(format!("`pipeline.steps` names `{second}` before `{first}`"), "put them in their order");
        }
    }
    Ok(())
}

impl Prepared {
    /// The model of a sensor and day; `None` where there is none.
    ///
    /// # Errors
    /// What is wrong with its file; a day without one that must have one.
    fn daily(&self, sensor: &Sensor, day: i32) -> Result<Option<DailyModel>, Finding> {
        let Some(pattern) = &sensor.daily else { return Ok(None) };
        if !self.mission.steps.iter().any(|s| s == "daily") || sensor.daily_to.is_some_and(|to| self.leap.day(day).start >= to) {
            return Ok(None);
        }
        let path = daily::path_of(&self.mission.folder, pattern, day);
        if !path.exists() && sensor.daily_may_lack {
            return Ok(None);
        }
        daily::read(&path, &sensor.name, day).map(Some)
    }

    /// What a person should know of the ground calibrations, of one sensor or of all, and of the mission as a whole.
    fn notes_of(&self, sensor: Option<&str>) -> Vec<Note> {
        let grounds = self.mission.sensors.iter().zip(&self.ground).filter(|(own, _)| sensor.is_none_or(|name| name == own.name));
        let of_ground = grounds.filter_map(|(_, ground)| ground.as_ref()).flat_map(|ground| &ground.notes);
        of_ground.chain(&self.notes).cloned().collect()
    }

    /// The files of a sensor whose rows may have corrected times in a stretch.
    fn files(&self, sensor: &str, span: &std::ops::Range<Tt2000>) -> Vec<&EditedFile> {
        let reaches = |file: &&EditedFile| {
            file.day.is_none_or(|day| {
                let own = self.leap.day(day);
                own.start - BEYOND_NS < span.end && span.start < own.end + BEYOND_NS
            })
        };
        self.catalogue.of(sensor).iter().filter(reaches).collect()
    }

    /// The days of a sensor that may have vectors, counted from 1970-01-01.
    ///
    /// # Errors
    /// A file outside of all partitions whose times cannot be read.
    fn days(&self, sensor: &Sensor) -> Result<std::ops::Range<i32>, Finding> {
        let mut ends: Option<(i32, i32)> = None;
        let mut reach = |first: i32, last: i32| {
            ends = Some(ends.map_or((first, last), |(a, b)| (a.min(first), b.max(last))));
        };
        for file in self.catalogue.of(&sensor.name) {
            match file.day {
                Some(day) => reach(day - 1, day + 1),
                None => {
                    let tags = crate::files::flight::edited::read_times(file, &self.mission, &self.leap)?;
                    for tag in [tags.iter().min(), tags.iter().max()].into_iter().flatten() {
                        reach(self.leap.utc(tag - BEYOND_NS).day, self.leap.utc(tag + BEYOND_NS).day);
                    }
                }
            }
        }
        Ok(ends.map_or(0..0, |(first, last)| first..last + 1))
    }
}

/// The name of a day, `YYYY-MM-DD`.
#[must_use]
pub fn day_name(day: i32) -> String {
    let date = crate::data::time::date_of(day);
    format!("{:04}-{:02}-{:02}", date.year(), date.month(), date.day())
}

/// Flight processing of a mission, ready to make its days.
pub struct Flight {
    prepared: Prepared,
    carry: Carry,
    options: FlightOptions,
    wanted: BTreeSet<Level>,
    folder: Folder,
    courses: Courses,
}

impl Flight {
    /// Reads the configuration and everything that all days need.
    ///
    /// # Errors
    /// What is wrong with it, a level that cannot be made, a sensor that it does not have.
    pub fn open(path: &Path, options: FlightOptions, findings: &mut Vec<Finding>) -> Result<Self, Finding> {
        let prepared = prepare_of(path, options.sensor.as_deref(), findings)?;
        let shown = path.display().to_string();
        options
            .levels
            .can_be_made(&prepared, options.sensor.as_ref().is_some_and(|name| name != derived::COMMON))
            .map_err(|e| Finding::error(&shown, e.to_string(), e.remedy()))?;
        if let Some(name) = &options.sensor
            && name != derived::COMMON
            && !prepared.mission.sensors.iter().any(|s| s.name == *name)
        {
            let remedy = "name one of its [[sensor]], or `common` for what is made of two";
            return Err(Finding::error(&shown, format!("has no sensor {name}"), remedy));
        }
        let asked = prepared.mission.sensors.iter().filter(|s| options.sensor.as_ref().is_none_or(|name| *name == s.name));
        findings.extend(asked.filter_map(|s| look::no_telemetry(&prepared, &s.name, path)));
        let carry = match &options.carry {
            Some(file) => {
                let carry = Carry::read(file)?;
                if carry.configuration != prepared.configuration {
                    let rule = "was made of another configuration, or of other files that it names";
                    let remedy = "make it again with `calfit flight carry`";
                    return Err(Finding::error(&file.display().to_string(), rule, remedy));
                }
                carry
            }
            None => Carry::find(&prepared, options.levels.of(&prepared).iter().any(|level| level.needs_heater()))?,
        };
        let wanted = options.levels.of(&prepared);
        if options.sensor.as_deref() == Some(derived::COMMON) && !wanted.iter().any(|level| level.is_of_two()) {
            let rule = "what two sensors share is in levels D and J, and none of them is asked for";
            return Err(Finding::error(&shown, rule, "name D or J, or a sensor"));
        }
        let folder = Folder::open(&options.out, options.force)?;
        Ok(Self { prepared, carry, options, wanted, folder, courses: Courses::default() })
    }

    /// What is to be made, day by day, the sensors of a day after each other.
    ///
    /// # Errors
    /// A file outside of all partitions whose times cannot be read.
    pub fn jobs(&self) -> Result<Vec<Job>, Finding> {
        let [first, last] = self.options.days;
        let wanted = |day: i32| first.is_none_or(|first| day >= first) && last.is_none_or(|last| day <= last);
        let mut jobs = Vec::new();
        let is_of = |name: &str| self.options.sensor.as_deref().is_none_or(|of| of == name);
        let mut days_of_all = BTreeSet::new();
        for (index, sensor) in self.prepared.mission.sensors.iter().enumerate() {
            let days = self.prepared.days(sensor)?.filter(|day| wanted(*day));
            days_of_all.extend(days.clone());
            if is_of(&sensor.name) {
                jobs.extend(days.map(|day| Job { day, task: Task::Levels(index) }));
            }
        }
        if self.wanted.iter().any(|level| level.is_of_two()) && is_of(derived::COMMON) {
            jobs.extend(days_of_all.into_iter().map(|day| Job { day, task: Task::Common }));
        }
        if self.options.levels.hk {
            let days = housekeeping::days(&self.prepared)?.into_iter().filter(|day| wanted(*day));
            jobs.extend(days.map(|day| Job { day, task: Task::Housekeeping }));
        }
        jobs.sort_unstable();
        Ok(jobs)
    }

    /// The name of a job, for messages: sensor and day.
    #[must_use]
    pub fn name(&self, job: Job) -> (String, String) {
        let sensor = match job.task {
            Task::Levels(index) => self.prepared.mission.sensors[index].name.clone(),
            Task::Common => derived::COMMON.to_owned(),
            Task::Housekeeping => housekeeping::NAME.to_owned(),
        };
        (sensor, day_name(job.day))
    }

    /// Makes the files of a job; `None` for a day without vectors.
    ///
    /// # Errors
    /// What is wrong with the day.
    pub fn make(&self, job: Job) -> Result<Option<DayMade>, Finding> {
        match job.task {
            Task::Levels(index) => self.levels(index, job.day),
            Task::Common => self.common(job.day),
            Task::Housekeeping => housekeeping::make(&self.prepared, &self.options, job.day),
        }
    }

    fn writer<'a>(&'a self, sensor: &'a str, uvw: &'a str, day: i32) -> Result<DayWriter<'a>, Finding> {
        let leap = &self.prepared.leap;
        let table = self.prepared.positions.as_ref().filter(|_| self.wanted.iter().any(|level| level.is_celestial()));
        let positions = table.map(|table| table.over(&leap.day(day), leap)).transpose()?;
        let (out, force) = (self.options.out.as_path(), self.options.force);
        let (shared, closing, told) = (RefCell::default(), RefCell::default(), Cell::default());
        Ok(DayWriter { prepared: &self.prepared, positions, told, out, force, sensor, uvw, day, shared, closing })
    }

    /// The levels of one sensor.
    fn levels(&self, index: usize, day: i32) -> Result<Option<DayMade>, Finding> {
        let prepared = &self.prepared;
        let mut context = Context::new(prepared, &self.carry, index, day, &self.wanted);
        context.course = Level::B.lacks(prepared).is_none().then(RefCell::default);
        let uvw = prepared.ground[index].as_ref().map_or("sensor axes", |g| g.frame.as_str());
        let sensor = &prepared.mission.sensors[index].name;
        let writer = self.writer(sensor, uvw, day)?;
        let mut pictures = self.pictures(sensor, uvw, day);
        let made = context.make(&mut |level, product, inputs, made| {
            if self.options.plots {
                pictures.take(level, &product);
            }
            writer.take(level, &product, inputs, made)
        });
        // Levels that were made stand under their names, whatever a later one says.
        writer.finish()?;
        let made = made?;
        if let Some(course) = context.course.take().filter(|_| self.compares()) {
            self.courses.take(prepared, day, index, course.into_inner());
        }
        if let Some(made) = &made {
            if self.options.plots {
                pictures.facts(made, &context.spectra.borrow());
            }
            pictures.write(made, &self.options.out, self.options.force)?;
        }
        Ok(made)
    }

    fn pictures<'a>(&'a self, sensor: &'a str, uvw: &'a str, day: i32) -> Pictures<'a> {
        let celestial = self.prepared.mission.celestial.as_ref().map_or("", |c| c.frame.as_str());
        Pictures::new(&self.prepared, sensor, [uvw, "spacecraft", celestial], day)
    }

    /// What both sensors share, and their difference.
    fn common(&self, day: i32) -> Result<Option<DayMade>, Finding> {
        let mut made = DayMade { sensor: derived::COMMON.to_owned(), day: day_name(day), ..DayMade::default() };
        let mut pictures = self.pictures(derived::COMMON, "", day);
        if self.wanted.contains(&Level::D) && self.options.plots {
            let start = self.prepared.leap.day(day).start;
            let mission = &self.prepared.mission;
            let place = |role: usize| mission.sensors.iter().position(|s| mission.roles.of(&s.name, start) == role);
            let of = |index: usize| derived::means_of(&self.prepared, &self.carry, index, day, Level::F, &mut Vec::new());
            if let (Some(first), Some(second)) = (place(0), place(1))
                && let (Some((a, _)), Some((b, _))) = (of(first)?, of(second)?)
            {
                pictures.difference([&mission.sensors[first].name, &mission.sensors[second].name], &a, &b);
                made.levels.push(Level::D.letter().to_owned());
            }
        }
        if self.wanted.contains(&Level::J)
            && let Some(parts) = derived::common(&self.prepared, &self.carry, day)?
        {
            made.shared.clone_from(&parts.axes);
            made.rows.read = parts.means_read;
            for (name, rows) in parts.tables {
                let writer = self.writer(&name, "", day)?;
                let written = Written::of(rows.field_nt[0].iter().copied().zip(rows.flags.iter().copied()));
                made.written = written.rows;
                made.null = written.null.values().sum();
                let mut metadata = writer.metadata(Level::J, &parts.inputs, &made, &written);
                let mark = metadata.pop();
                metadata.retain(|(key, _)| parts.says.iter().all(|(own, _)| own != key));
                metadata.extend(parts.says.iter().cloned());
                metadata.extend(mark);
                writer.write(Level::J, rows, metadata)?;
                writer.finish()?;
            }
            made.levels.push(Level::J.letter().to_owned());
        }
        if made.levels.is_empty() {
            return Ok(None);
        }
        pictures.write(&made, &self.options.out, self.options.force)?;
        Ok(Some(made))
    }

    /// Whether the days of two sensors are compared: these are made side by side, and their axes are known.
    fn compares(&self) -> bool {
        self.prepared.mission.sensors.len() == 2 && self.options.sensor.is_none() && Level::B.lacks(&self.prepared).is_none()
    }

    /// What a person should know of the sensors against each other, once all days are made.
    #[must_use]
    pub fn comparisons(&self) -> Vec<Note> {
        self.courses.notes()
    }

    /// What a person should know of the mission as a whole, and of what was asked for.
    #[must_use]
    pub fn notes(&self) -> Vec<Note> {
        let of_one = self.options.sensor.as_deref().filter(|name| *name != derived::COMMON);
        let of_two = of_one.is_some() && self.wanted.iter().any(|level| level.is_of_two());
        let text = "levels D and J are made of two sensors, and are left out with --sensor";
        let remedy = "make them without --sensor, or with --sensor common";
        let note = of_two.then(|| Note::new(NoteKind::Method, text.to_owned()).with_remedy(remedy));
        self.prepared.notes_of(of_one).into_iter().chain(note).collect()
    }

    /// Writes the report of all days that stand in the folder, and makes the names of what was written last through a power loss. A part
    /// of a larger work, which names what the first pass found, leaves the report to a command of its own.
    ///
    /// # Errors
    /// What the operating system says.
    pub fn finish(&self) -> Result<(), Finding> {
        if self.options.carry.is_none() {
            picture::report(&self.prepared, &self.comparisons(), &self.options.out, self.options.force)?;
        }
        self.folder.sync()
    }
}

/// The report of all days that stand in a folder of results.
///
/// # Errors
/// What is wrong with the configuration; what the operating system says.
pub fn make_report(path: &Path, out: &Path, force: bool, findings: &mut Vec<Finding>) -> Result<PathBuf, Finding> {
    picture::report(&prepare(path, findings)?, &[], out, force)?.ok_or_else(|| {
        let rule = "holds no days of flight processing";
        Finding::error(&out.display().to_string(), rule, "name the folder of the levels with -o, or make them first")
    })
}

/// The first pass alone, written as a table; it names the days whose continuity is not known, which cannot be made with it.
///
/// # Errors
/// What is wrong with the configuration, a file of telemetry or a daily model; what the operating system says.
pub fn make_carry(path: &Path, out: &Path, force: bool, findings: &mut Vec<Finding>) -> Result<Carry, Finding> {
    let prepared = prepare(path, findings)?;
    let mut carry = Carry::find(&prepared, true)?;
    carry.find_others(&prepared)?;
    carry.find_modes(&prepared)?;
    let name = out.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    let parent = out.parent().filter(|p| !p.as_os_str().is_empty()).map_or(Path::new("."), |p| p);
    carry.write(&Folder::open(parent, force)?, &name)?;
    Ok(carry)
}
