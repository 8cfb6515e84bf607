//! One day of one sensor: telemetry in, levels out.

use super::derived;
use super::near::Near;
use super::steps::{Steps, thermometer};
use super::{Carry, Level, Prepared, compare, day_name, housekeeping};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::provenance::Input;
use crate::data::time::{SECOND_NS, Tt2000};
use crate::files::flight::edited::{self, BEYOND_NS, EditedFile, Rows};
use crate::files::flight::mission::Mission;
use crate::files::table::long::GROUP_ROWS;
use crate::fit::spectrum::Density;
use crate::flight::assemble::{RowCounts, assemble, blocks};
use crate::flight::comparison::Course;
use crate::flight::field_steps::unstated_steps;
use crate::flight::made::DayMade;
use crate::flight::means::{Means, means};
use crate::flight::screens;
use crate::flight::temperature::smooth;
use crate::flight::{Block, Series, Stage};
use rayon::prelude::*;
use std::cell::RefCell;
use std::collections::BTreeSet;
use std::ops::Range;

/// What a day is made of, as far as it is the same for all of its levels.
pub struct Context<'a> {
    /// The mission.
    pub prepared: &'a Prepared,
    /// The first pass.
    pub carry: &'a Carry,
    /// The sensor's place in the mission.
    pub index: usize,
    /// Day, counted from 1970-01-01.
    pub day: i32,
    /// The levels that are wanted.
    pub wanted: &'a BTreeSet<Level>,
    /// Spectra before and after wheels were taken off, by mode, once that is done.
    pub spectra: RefCell<Vec<(String, Density, Density)>>,
    /// The course of the field in axes of the spacecraft, once it is made; absent if it is not wanted.
    pub course: Option<RefCell<Course>>,
}

/// A level of a day.
pub enum Product<'a> {
    /// Single vectors in blocks, some of them perhaps of the neighbouring days.
    Vectors(&'a [Block]),
    /// Means with the blocks that they are of.
    Means(&'a Means, &'a [Block]),
}

/// What takes the levels of a day.
pub type Sink<'a> = dyn FnMut(Level, Product<'_>, &[Input], &mut DayMade) -> Result<(), Finding> + 'a;

impl<'a> Context<'a> {
    /// A sensor and day.
    #[must_use]
    pub fn new(prepared: &'a Prepared, carry: &'a Carry, index: usize, day: i32, wanted: &'a BTreeSet<Level>) -> Self {
        Self { prepared, carry, index, day, wanted, spectra: RefCell::new(Vec::new()), course: None }
    }

    fn wants_any(&self, levels: &[Level]) -> bool {
        levels.iter().any(|level| self.wanted.contains(level))
    }

    /// The time of the day.
    pub fn span(&self) -> Range<Tt2000> {
        self.prepared.leap.day(self.day)
    }

    /// The time that the day needs: its own, what wheels need beyond its ends, and whole intervals of heaters that reach into it.
    pub fn reach(&self) -> Range<Tt2000> {
        let mut span = self.span();
        if self.wants_any(&[Level::H, Level::I]) {
            span = span.start - BEYOND_NS..span.end + BEYOND_NS;
        }
        if self.has_heater() {
            for interval in derived::heater_intervals(self.prepared, &span) {
                span = span.start.min(interval.from)..span.end.max(interval.to);
            }
        }
        span
    }

    /// Whether heater jumps are taken off for something that is wanted.
    fn has_heater(&self) -> bool {
        self.wanted.iter().any(|level| level.needs_heater()) && !derived::heater_intervals(self.prepared, &self.span()).is_empty()
    }

    /// Makes the levels that are wanted and hands each to the sink; `None` for a day without vectors.
    ///
    /// # Errors
    /// What is wrong with the telemetry, the daily model of the day, or what the sink says.
    pub fn make(&self, sink: &mut Sink<'_>) -> Result<Option<DayMade>, Finding> {
        let prepared = self.prepared;
        let mission = &prepared.mission;
        let sensor = &mission.sensors[self.index];
        let day = self.span();
        if self.wants_any(&[Level::H, Level::I]) {
            derived::one_role(prepared, &day)?;
        }
        let new = |rows| DayMade { sensor: sensor.name.clone(), day: day_name(self.day), rows, ..DayMade::default() };
        let last = self.last_stage();
        let told = |file: &String| format!("{file} has no rows: the vectors of this day are missing");
        let Read { counts, without_rows, vectors } = read(prepared, self.carry, self.index, self.day, &self.reach(), last)?;
        let Some(Vectors { mut blocks, steps, counts, mut inputs, beside }) = vectors else {
            let mut made = new(counts);
            made.notes.extend(without_rows.iter().map(told));
            if made.rows.rejected > 0 {
                made.notes.push("all of its rows are rejected by their quality: there are no levels".to_owned());
            }
            return Ok(Some(made).filter(|made| !made.notes.is_empty()));
        };
        if counts.read == 0 {
            return Ok(None);
        }
        let mut made = new(counts);
        made.notes.extend(without_rows.iter().map(|file| format!("{file} has no rows")));
        made.notes.extend(screens::notes(&blocks, &day, ["bx", "by", "bz", &sensor.thermistor_column]));
        if !mission.roles.change_within(&day) {
            let role = mission.roles.of(&sensor.name, day.start);
            let modes: Vec<(&str, Option<f64>)> =
                mission.modes.iter().map(|mode| (mode.sid.as_str(), mode.rates[role].map(|rate| rate.rate_hz))).collect();
            made.notes.extend(screens::cadences(&blocks, &day, &modes));
        }
        if let Some(thermometer) = thermometer(prepared, self.index) {
            let packet_ns: Vec<i64> = mission.modes.iter().map(|mode| ns(mode.packet_s)).collect();
            let (name, leap) = (&sensor.thermistor_column, &prepared.leap);
            made.notes.extend(screens::temperature_jumps(&mut blocks, &day, name, thermometer, &packet_ns, leap));
        }
        made.notes
            .extend(beside.iter().map(|file| format!("{file} cannot be read: vectors that it may hold of this day are missing")));
        made.notes.extend(housekeeping::against_telemetry(prepared, self.index, self.day, &blocks));
        made.notes.extend(steps.notes.iter().cloned());
        if made.rows.contradicting > 0 {
            let count = made.rows.contradicting;
            made.notes.push(format!("{count} vectors of {} have the quality bit of the other sensor", sensor.name));
        }
        if made.rows.conflicts > 0 {
            let count = made.rows.conflicts;
            made.notes.push(format!(
                "repeated rows with other counts than the first of their time and mode: {count}; the first was taken, and which is right is open"
            ));
        }
        if let Some(model) = prepared.daily(sensor, self.day)? {
            inputs.push(model.input);
            made.continuity_nt = Some(self.carry.continuity(mission, &sensor.name, self.day)?.sum_nt);
            if let Some(before) = self.carry.broken_off(mission, &sensor.name, self.day) {
                let [x, y, z] = before.continuity.sum_nt;
                made.notes.push(format!(
                    "the constants that join the daily models begin anew at zero, behind a gap in the telemetry that is longer than reset_gap_s; they \
                     were {x:+.2}, {y:+.2}, {z:+.2} nT on {}: the field may step",
                    day_name(before.day)
                ));
            }
        }
        self.count_modes(&blocks, &mut made);
        let through = |stage: Stage, blocks: &mut Vec<Block>| blocks.par_iter_mut().for_each(|b| steps.apply(stage, b));
        through(Stage::A, &mut blocks);
        // In axes of the sensor the field changes where its boom moves, and where an offset jumps that is taken off behind them.
        let spans = sensor.rotations.iter().map(|state| state.span).chain(sensor.jumps.iter().map(|jump| jump.span));
        let stated: Vec<Tt2000> = spans.flat_map(|span| [span.from, span.to]).collect();
        made.notes.extend(unstated_steps(&blocks, &day, &stated, &prepared.leap));
        self.hand_on(Level::A, Level::E, &blocks, &inputs, &mut made, sink)?;
        if let Some(place) = &self.course {
            let course = in_spacecraft(Course::of(&blocks, &day), &steps);
            made.notes.extend(compare::steps_of_tables(prepared, &course, sensor, &day));
            place.replace(course);
        }
        if last == Stage::A {
            self.count(&blocks, &mut made);
            return Ok(Some(made));
        }
        through(Stage::B, &mut blocks);
        let mut without_heater = if self.has_heater() { Some(derived::without_heater(self, &blocks, &mut made)?) } else { None };
        if let Some(own) = &without_heater {
            self.count_flags(own, &[Flags::HEATER], &mut made);
        }
        if self.wanted.contains(&Level::B) {
            sink(Level::B, Product::Vectors(&blocks), &inputs, &mut made)?;
        }
        if let Some(own) = &without_heater
            && self.wanted.contains(&Level::K)
        {
            sink(Level::K, Product::Vectors(own), &inputs, &mut made)?;
        }
        self.hand_on_means(Level::F, without_heater.as_ref().unwrap_or(&blocks), &inputs, &mut made, sink)?;
        if last == Stage::B {
            self.count(&blocks, &mut made);
            return Ok(Some(made));
        }
        if self.wanted.contains(&Level::C) || without_heater.is_none() {
            through(Stage::C, &mut blocks);
        }
        if self.wanted.contains(&Level::C) {
            sink(Level::C, Product::Vectors(&blocks), &inputs, &mut made)?;
        }
        self.count(&blocks, &mut made);
        if let Some(own) = &mut without_heater {
            through(Stage::C, own);
            if self.wanted.contains(&Level::L) {
                sink(Level::L, Product::Vectors(own), &inputs, &mut made)?;
            }
        }
        let mut best = without_heater.unwrap_or(blocks);
        self.hand_on_means(Level::G, &best, &inputs, &mut made, sink)?;
        if self.wants_any(&[Level::H, Level::I]) && mission.roles.of(&sensor.name, day.start) == 0 {
            self.spectra.replace(derived::without_wheels(self, &mut best, &mut made)?);
            self.count_flags(&best, &[Flags::WHEEL, Flags::NOT_CLEANED], &mut made);
            self.hand_on(Level::H, Level::I, &best, &inputs, &mut made, sink)?;
        }
        Ok(Some(made))
    }

    fn last_stage(&self) -> Stage {
        self.wanted.iter().map(|level| level.stage()).max().unwrap_or(Stage::A)
    }

    fn hand_on(
        &self,
        level: Level,
        of_means: Level,
        blocks: &[Block],
        inputs: &[Input],
        made: &mut DayMade,
        sink: &mut Sink<'_>,
    ) -> Result<(), Finding> {
        if self.wanted.contains(&level) {
            sink(level, Product::Vectors(blocks), inputs, made)?;
        }
        self.hand_on_means(of_means, blocks, inputs, made, sink)
    }

    fn hand_on_means(
        &self,
        level: Level,
        blocks: &[Block],
        inputs: &[Input],
        made: &mut DayMade,
        sink: &mut Sink<'_>,
    ) -> Result<(), Finding> {
        if !self.wanted.contains(&level) {
            return Ok(());
        }
        let means = means(&Series::of(blocks), &self.span(), self.prepared.mission.mean_ns);
        sink(level, Product::Means(&means, blocks), inputs, made)
    }

    fn count_modes(&self, blocks: &[Block], made: &mut DayMade) {
        let span = self.span();
        for block in blocks {
            let rows = block.rows_in(&span);
            made.written += rows.len();
            for mode in &block.mode[rows] {
                *made.modes.entry(self.prepared.mission.modes[usize::from(*mode)].sid.clone()).or_default() += 1;
            }
        }
    }

    /// Counts the vectors of the day that are null, and those with each flag.
    fn count(&self, blocks: &[Block], made: &mut DayMade) {
        let span = self.span();
        let mut ends: Option<[f64; 2]> = None;
        for block in blocks {
            let rows = block.rows_in(&span);
            made.null += block.field[0][rows.clone()].iter().filter(|v| v.is_nan()).count();
            for t in block.t_degc[rows].iter().filter(|t| t.is_finite()) {
                ends = Some(ends.map_or([*t, *t], |[a, b]| [a.min(*t), b.max(*t)]));
            }
        }
        made.degc = ends;
        self.count_flags(blocks, &Flags::ALL.map(|(flag, _)| flag), made);
    }

    /// Counts the vectors of the day with each of these flags.
    fn count_flags(&self, blocks: &[Block], wanted: &[Flags], made: &mut DayMade) {
        let span = self.span();
        for (flag, words) in Flags::ALL.into_iter().filter(|(flag, _)| wanted.contains(flag)) {
            let own = |block: &Block| block.flags[block.rows_in(&span)].iter().filter(|f| Flags(**f).any_of(flag)).count();
            let count: usize = blocks.iter().map(own).sum();
            if count > 0 {
                *made.flags.entry(words.to_owned()).or_default() += count;
            }
        }
    }
}

/// A course in axes of the sensor in those of the spacecraft.
fn in_spacecraft(course: Course, steps: &Steps) -> Course {
    let n = course.time.len();
    let mut block = Block { time: course.time, field: course.field_nt, flags: vec![0; n], range: vec![0; n], ..Block::default() };
    steps.apply(Stage::B, &mut block);
    Course { time: block.time, field_nt: block.field, mode: course.mode }
}

/// Vectors of a stretch before their steps.
pub struct Vectors {
    /// The vectors.
    pub blocks: Vec<Block>,
    /// Their steps.
    pub steps: Steps,
    /// What was made of the rows of the day.
    pub counts: RowCounts,
    /// The files of telemetry.
    pub inputs: Vec<Input>,
    /// Files of the days beside it that cannot be read.
    pub beside: Vec<String>,
}

/// The rows of a file with tags in a stretch that a day needs.
fn read_file(prepared: &Prepared, index: usize, day: i32, file: &EditedFile, tags: &Range<Tt2000>) -> Result<Rows, Finding> {
    if let Some(rows) = Near::beside(prepared, index, file, day, tags)? {
        return Ok(rows);
    }
    let (mission, leap) = (&prepared.mission, &prepared.leap);
    let [rows] = edited::read(file, &mission.sensors[index], mission, leap, [tags])?;
    let own = leap.day(day);
    if file.day == Some(day) && tags.start <= own.start - BEYOND_NS && own.end + BEYOND_NS <= tags.end {
        prepared.near.take(prepared, file, day, &rows);
    }
    Ok(rows)
}

/// Reads the vectors of a sensor in a stretch that a day needs, with their steps up to a stage; `None` where there is none.
///
/// # Errors
/// What is wrong with the telemetry of the day, or with its daily model.
pub fn vectors(
    prepared: &Prepared,
    carry: &Carry,
    index: usize,
    day: i32,
    reach: &Range<Tt2000>,
    last: Stage,
) -> Result<Option<Vectors>, Finding> {
    read(prepared, carry, index, day, reach, last).map(|read| read.vectors)
}

/// Seconds as whole nanoseconds.
#[expect(clippy::cast_possible_truncation, reason = "lengths of packets and windows")]
fn ns(s: f64) -> i64 {
    (s * SECOND_NS as f64) as i64
}

/// Length of the longest packet, and of the window over which the thermistor is smoothed, ns; 0 for the window of a mission that does not
/// smooth it.
fn smoothing_ns(mission: &Mission) -> [i64; 2] {
    let packet_s = mission.modes.iter().map(|mode| mode.packet_s).fold(0.0, f64::max);
    [packet_s, mission.smooth_s.max(0.0)].map(ns)
}

/// Vectors of a stretch, and what is known of a day also where no vectors are left.
struct Read {
    /// What was made of the rows of the day.
    counts: RowCounts,
    /// Files of the day that have no rows.
    without_rows: Vec<String>,
    /// The vectors.
    vectors: Option<Vectors>,
}

/// The same with what is known of the day also where no vectors are left.
fn read(prepared: &Prepared, carry: &Carry, index: usize, day: i32, reach: &Range<Tt2000>, last: Stage) -> Result<Read, Finding> {
    let mission = &prepared.mission;
    let sensor = &mission.sensors[index];
    let own_day = prepared.leap.day(day);
    let [packet_ns, window_ns] = smoothing_ns(mission);
    // Temperatures of the day are smoothed over the same packets whatever its levels reach for.
    let aside_ns = if window_ns > 0 { window_ns / 2 + packet_ns } else { 0 };
    let around = own_day.start - aside_ns..own_day.end + aside_ns;
    let holds_day = reach.start <= own_day.start && own_day.end <= reach.end;
    let read_span =
        if holds_day && window_ns > 0 { reach.start.min(around.start)..reach.end.max(around.end) } else { reach.clone() };
    let tags = read_span.start - BEYOND_NS..read_span.end + BEYOND_NS;
    let first_day = prepared.leap.utc(tags.start).day;
    let is_continued = prepared.catalogue.of(&sensor.name).iter().any(|file| file.day.is_some_and(|day| day < first_day));
    let mut rows = Rows { is_continued, ..Rows::default() };
    let mut inputs = Vec::new();
    let (mut beside, mut without_rows) = (Vec::new(), Vec::new());
    for file in prepared.files(&sensor.name, &tags) {
        let name = || file.path.strip_prefix(&mission.folder).unwrap_or(&file.path).to_string_lossy().into_owned();
        let read = match read_file(prepared, index, day, file, &tags) {
            // A neighbour that cannot be read fails on its own day; what it would add to this one is lost there too.
            Err(_) if file.day.is_some_and(|own| own != day) => {
                beside.push(name());
                continue;
            }
            other => other?,
        };
        if !read.tag.is_empty() {
            inputs.push(prepared.near.input(file, name())?);
        } else if file.day == Some(day) && !read.is_continued {
            without_rows.push(name());
        }
        rows.append(read);
    }
    let shifts = mission.steps.iter().any(|s| s == "shift");
    let vectors_in = |span: &Range<Tt2000>| {
        assemble(&rows, &sensor.name, mission, &prepared.leap, span, &own_day, shifts)
            .map_err(|e| Finding::error(&sensor.name, e.to_string(), "state it in [[mode]]"))
    };
    let mut assembled = vectors_in(reach)?;
    if assembled.counts.read == 0 || assembled.vectors.is_empty() {
        return Ok(Read { counts: assembled.counts, without_rows, vectors: None });
    }
    let own = assembled.vectors.rows_in(&own_day);
    if let (Some(first), Some(last)) = (assembled.vectors.time[own.clone()].first(), assembled.vectors.time[own.clone()].last())
        && holds_day
    {
        carry.is_of(&sensor.name, day, *first, *last)?;
    }
    if window_ns > 0 {
        let vectors = &mut assembled.vectors;
        smooth(&vectors.time, &mut vectors.thermistor, packet_ns, window_ns);
        if holds_day {
            let mut wide = vectors_in(&around)?.vectors;
            smooth(&wide.time, &mut wide.thermistor, packet_ns, window_ns);
            vectors.thermistor[own].copy_from_slice(&wide.thermistor[wide.rows_in(&own_day)]);
        }
    }
    drop(rows);
    let days = prepared.leap.utc(reach.start).day..prepared.leap.utc(reach.end - 1).day + 1;
    // The course of the field in axes of the spacecraft is compared between sensors, whatever the levels.
    let steps = Steps::make(prepared, carry, index, day, &days, last.max(Stage::B))?;
    let blocks = blocks(assembled.vectors, GROUP_ROWS, mission.uncertainty);
    let counts = assembled.counts;
    Ok(Read { counts: counts.clone(), without_rows, vectors: Some(Vectors { blocks, steps, counts, inputs, beside }) })
}

/// Puts the field and the flags of a series back into its blocks.
pub fn put_back(series: &Series, blocks: &mut [Block]) {
    let mut begin = 0;
    for block in blocks {
        let rows = begin..begin + block.len();
        (0..3).for_each(|i| block.field[i].copy_from_slice(&series.field_nt[i][rows.clone()]));
        block.flags.copy_from_slice(&series.flags[rows]);
        begin += block.len();
    }
}
