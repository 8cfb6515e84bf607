//! Levels that need the neighbours of a vector or both sensors: without heater jumps (K, L), without wheels (H, I), what both sensors
//! share (J).

use super::day::{Context, Product, Vectors, put_back, vectors};
use super::write::stds_nt;
use super::{Carry, Level, Prepared, picture};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::data::note::{Note, NoteKind};
use crate::data::provenance::Input;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000};
use crate::data::units::counted;
use crate::files::flight::levels::LevelRows;
use crate::files::flight::mission::{Common, Heater, Span};
use crate::fit::spectrum::Density;
use crate::fit::statistics::median;
use crate::flight::heater::{self, Cells, HeaterClass, HeaterInterval, HeaterMethod, HeaterOptions, Jump, TableTimes};
use crate::flight::made::{DayMade, HeaterFound, JumpFound, SharedAxis, WheelsFound};
use crate::flight::means::Means;
use crate::flight::two_sensors::{self, Parts};
use crate::flight::wheels::{self, Method, Seen, WheelMode, WheelOptions};
use crate::flight::{Block, Series, Stage};
use std::borrow::Cow;
use std::collections::BTreeSet;
use std::ops::Range;

/// A jump without a vector for so long lies anywhere within, ns.
const UNSEEN_NS: i64 = 3 * SECOND_NS;

/// An edge of so many standard deviations is not missed.
const SEEN_STDS: f64 = 5.0;

/// Of fewer windows nothing is said of wheels; a wave that is seen in at most one of so many is no more than noise.
const LEAST_WINDOWS: usize = 10;

/// Steps like those of heaters at other times than those of the table, of fewer of which nothing is said: a lost row takes two of them away, and
/// the field outside steps now and then.
const LEAST_UNLISTED: usize = 3;

/// What stands in place of a sensor where both are meant.
pub const COMMON: &str = "common";

/// The intervals with heater operation that reach into a stretch.
pub fn heater_intervals(prepared: &Prepared, span: &Range<Tt2000>) -> Vec<Span> {
    let stretch = Span { from: span.start, to: span.end };
    let all = prepared.mission.heater.iter().flat_map(|heater| &heater.intervals);
    all.filter(|interval| interval.meets(&stretch)).copied().collect()
}

fn heater_options(prepared: &Prepared, stated: &Heater) -> HeaterOptions {
    let method = match (stated.from_table, &prepared.heater) {
        (true, Some(table)) => HeaterMethod::Table(table.clone()),
        _ => HeaterMethod::Found,
    };
    HeaterOptions { edge_s: stated.edge_s, ..HeaterOptions::new(stated.classes.clone(), method) }
}

fn interval_of(span: Span) -> HeaterInterval {
    HeaterInterval { from_tt2000: span.from, to_tt2000: span.to }
}

/// What the heaters of a mission add to the field of a sensor, from all intervals of their operation; `None` without heaters.
///
/// # Errors
/// What is wrong with options or tables. An interval whose telemetry cannot be read is left out; its own days say why.
pub fn heater_classes(prepared: &Prepared, carry: &Carry, index: usize) -> Result<Option<Vec<HeaterClass>>, Finding> {
    let Some(stated) = &prepared.mission.heater else { return Ok(None) };
    let options = heater_options(prepared, stated);
    let mut records = Vec::new();
    for span in &stated.intervals {
        let reach = span.from..span.to;
        let Ok(Some(Vectors { mut blocks, steps, .. })) =
            vectors(prepared, carry, index, prepared.leap.utc(span.from).day, &reach, Stage::B)
        else {
            continue;
        };
        for block in &mut blocks {
            steps.apply(Stage::A, block);
            steps.apply(Stage::B, block);
        }
        let all = Series::of(&blocks);
        records.extend(heater::Cells::of(&all.time, &all.field_nt, interval_of(*span), &options));
    }
    let refuse = |e: heater::HeaterError| Finding::error(&prepared.mission.sensors[index].name, e.to_string(), "see [heater]");
    heater::learn(&records, &options).map(Some).map_err(refuse)
}

/// Vectors without heater jumps.
///
/// # Errors
/// What is wrong with options or tables.
pub fn without_heater(context: &Context<'_>, blocks: &[Block], made: &mut DayMade) -> Result<Vec<Block>, Finding> {
    let mut out = blocks.to_vec();
    let Some(stated) = &context.prepared.mission.heater else { return Ok(out) };
    let spans = heater_intervals(context.prepared, &context.span());
    let intervals: Vec<HeaterInterval> = spans.into_iter().map(interval_of).collect();
    let options = heater_options(context.prepared, stated);
    let known = context.carry.heater.get(&made.sensor).map(Vec::as_slice);
    let mut all = Series::of(blocks);
    let cells: Vec<Cells> =
        intervals.iter().filter_map(|interval| Cells::of(&all.time, &all.field_nt, *interval, &options)).collect();
    let (classes, jumps) = heater::close_jumps(&all.time, &mut all.field_nt, &mut all.flags, &intervals, known, &options)
        .map_err(|e| Finding::error(&made.sensor, e.to_string(), "see [heater]"))?;
    made.heater = classes.iter().map(HeaterFound::of).collect();
    let day = context.span();
    for (index, interval) in intervals.iter().enumerate() {
        let own: Vec<&Jump> =
            jumps.iter().filter(|jump| jump.interval == index && (stated.from_table || jump.is_shown())).collect();
        let switches = |class: usize| {
            let is_of = own.iter().any(|jump| jump.class == class);
            is_seen(&classes[class]) && (is_of || !stated.from_table && would_show(&classes[class], &own))
        };
        let silent: Vec<usize> = (0..classes.len()).filter(|class| !switches(*class)).collect();
        // A table knows where a heater has no row; what its field is only vectors say.
        let is_unknown = |class: &usize| !stated.from_table || !is_seen(&classes[*class]);
        if silent.len() == classes.len() || silent.iter().any(is_unknown) {
            leave(&mut all, *interval, &classes, &silent, stated.from_table, &day, &context.prepared.leap, made);
        }
    }
    made.notes.extend(heater::table_times(&cells, &options).and_then(|times| match times {
        TableTimes::Right => None,
        TableTimes::Later(by_s) => {
            let side = if by_s > 0.0 { "after" } else { "before" };
            let by_s = by_s.abs();
            Some(format!(
                "the field switches {by_s:.1} s {side} the times of the heater table: what is taken off is not what the heaters made"
            ))
        }
        TableTimes::Unseen(most_s) => Some(format!(
            "at the times of the heater table, and up to {most_s:.0} s before and after, the field switches by no more than noise: what is taken \
             off is noise"
        )),
    }));
    let unlisted: Vec<Tt2000> =
        heater::unlisted(&cells, &classes, &options).into_iter().filter(|time| day.contains(time)).collect();
    if let Some(first) = unlisted.first().filter(|_| unlisted.len() >= LEAST_UNLISTED) {
        made.notes.push(format!(
            "the field steps as a heater does at {} times at which the heater table has no row, first at {}: rows are missing, and what these heaters \
             add stays",
            unlisted.len(),
            context.prepared.leap.utc(*first)
        ));
    }
    let short = || cells.iter().flat_map(|cells| &cells.short);
    short().for_each(|row| all.flags[*row] |= Flags::HEATER.0);
    let count = short().filter(|row| day.contains(&all.time[**row])).count();
    if count > 0 {
        made.notes.push(format!(
            "{count} vectors within heater intervals stand out of those on both sides for less than the shortest time a heater is on: they \
             tell nothing of heaters, and have the flag HEATER"
        ));
    }
    let steps = cells.iter().flat_map(|cells| heater::strange_steps(cells, &classes)).filter(|time| day.contains(time)).count();
    if !stated.from_table && steps > 0 {
        made.notes.push(format!(
            "{steps} steps of the field are far larger than those of all heaters: they are taken for none, and stay"
        ));
    }
    put_back(&all, &mut out);
    let own = jumps.iter().filter(|jump| day.contains(&jump.time_tt2000));
    // What a table says is known; what is found between vectors far apart has no time that could be told.
    let role = context.prepared.mission.roles.of(&made.sensor, day.start);
    let step_ns = |mode: u8| context.prepared.mission.modes[usize::from(mode)].rates[role].map_or(0.0, |r| 1e9 / r.rate_hz);
    let (seen, unseen): (Vec<&Jump>, Vec<&Jump>) =
        own.partition(|jump| stated.from_table || !is_in_gap(&all, jump.time_tt2000, &step_ns));
    made.jumps = seen.into_iter().map(|jump| JumpFound::of(jump, &stated.classes)).collect();
    if !unseen.is_empty() {
        let jumps = counted(unseen.len() as u64, "heater jump");
        made.notes.push(format!("{jumps} in gaps, where times are not known: closed and not listed"));
    }
    Ok(out)
}

/// Whether an edge of a heater would be seen among those of the others in an interval: where it does not switch there it is off, as outside.
fn would_show(class: &HeaterClass, others: &[&Jump]) -> bool {
    let squares = |jump: &&Jump| (0..3).map(|c| (class.vector_nt[c] / jump.std_nt[c]).powi(2)).sum::<f64>();
    let mut all: Vec<f64> = others.iter().map(squares).filter(|squares| squares.is_finite()).collect();
    !all.is_empty() && median(&mut all) > SEEN_STDS * SEEN_STDS
}

/// Whether vectors have told what a heater adds.
fn is_seen(class: &HeaterClass) -> bool {
    class.vector_nt.iter().any(|component| *component != 0.0)
}

/// Says that what some heaters add stays within an interval, where no switching of them was told from the field, or where the table has none: its
/// vectors may be disturbed.
#[expect(
    clippy::too_many_arguments,
    reason = "the vectors, the interval, what is known of its heaters, the day and where it is told"
)]
fn leave(
    all: &mut Series,
    interval: HeaterInterval,
    classes: &[HeaterClass],
    silent: &[usize],
    from_table: bool,
    day: &Range<Tt2000>,
    leap: &LeapSeconds,
    made: &mut DayMade,
) {
    let rows = interval.rows(&all.time);
    all.flags[rows.clone()].iter_mut().for_each(|flags| *flags |= Flags::HEATER.0);
    let own = all.time[rows].iter().filter(|time| day.contains(time)).count();
    if own == 0 {
        return;
    }
    let [from, to] = [interval.from_tt2000, interval.to_tt2000].map(|time| leap.utc(time));
    let which = if silent.len() == classes.len() {
        let why = match (from_table, classes.iter().all(is_seen)) {
            (true, true) => "the heater table has no row",
            (true, false) => "the vectors do not show what the heaters of the table add",
            (false, _) => "no switching of a heater is told from the field",
        };
        format!("{why} from {from} to {to}: its {own} vectors of the day stay as they are")
    } else {
        let names = silent.iter().map(|class| classes[*class].name.as_str()).collect::<Vec<&str>>().join(", ");
        let why = if from_table { "the vectors do not show what it adds" } else { "no switching is told from the field" };
        format!("of {names} {why} from {from} to {to}: what it adds where it is on stays in the {own} vectors of the day")
    };
    // Heaters have their names by what they add, so that one that is missing leaves its name to another.
    let mistaken = if !from_table && silent.len() < classes.len() && !classes.iter().all(is_seen) {
        ", and a heater that is found may have the name of one that is not"
    } else {
        ""
    };
    made.notes.push(format!("{which}, with the flag HEATER{mistaken}"));
}

/// Whether a time lies where vectors are missing for longer than its mode would have it.
fn is_in_gap(all: &Series, time: Tt2000, step_ns: &impl Fn(u8) -> f64) -> bool {
    let next = all.time.partition_point(|t| *t < time);
    let is_there = |row: &usize| !all.field_nt[0][*row].is_nan();
    let (before, behind) = ((0..next).rev().find(is_there), (next..all.time.len()).find(is_there));
    let (Some(before), Some(behind)) = (before, behind) else { return true };
    let gap_ns = all.time[behind] - all.time[before];
    gap_ns > UNSEEN_NS && gap_ns as f64 > 1.5 * step_ns(all.mode[before])
}

/// Takes wheels and lines off; spectra before and after by mode.
///
/// # Errors
/// What is wrong with rates, lines or tables.
pub fn without_wheels(
    context: &Context<'_>,
    blocks: &mut [Block],
    made: &mut DayMade,
) -> Result<Vec<(String, Density, Density)>, Finding> {
    let prepared = context.prepared;
    let (Some(stated), Some(table)) = (&prepared.mission.wheels, &prepared.wheels) else { return Ok(Vec::new()) };
    let role = prepared.mission.roles.of(&made.sensor, context.span().start);
    let mode = |mode: &crate::files::flight::mission::Mode| WheelMode {
        rate_hz: mode.rates[role].map_or(f64::NAN, |rate| rate.rate_hz),
        half_width_hz: stated.half_width_hz.get(&mode.sid).copied().filter(|_| mode.rates[role].is_some()),
        lines_hz: mode.lines_hz.clone(),
    };
    let modes: Vec<WheelMode> = prepared.mission.modes.iter().map(mode).collect();
    let options = WheelOptions {
        harmonics: stated.harmonics.clone(),
        method: if stated.stripe { Method::Stripe } else { Method::Fit },
        seed: stated.seed,
        counted: Some(context.span()),
        ..WheelOptions::default()
    };
    let before = Series::of(blocks);
    let mut all = before.clone();
    let table = table.over(&context.reach(), &prepared.leap)?;
    let report = wheels::clean(&all.time, &all.mode, &modes, &table, &options, &mut all.field_nt, &mut all.flags)
        .map_err(|e| Finding::error(&made.sensor, e.to_string(), "see [wheels] and [[mode]]"))?;
    put_back(&all, blocks);
    for (wheel, times) in wheels::leaps(&table, &context.span()) {
        made.notes.push(format!(
            "the rate of wheel {} leaps {} times from one row of the table to the next, first at {}: no wheel does, and what is taken off there is \
             wrong",
            wheel + 1,
            times.len(),
            prepared.leap.utc(times[0])
        ));
    }
    let mut spectra = Vec::new();
    for (index, (mode, found)) in prepared.mission.modes.iter().zip(&report.modes).enumerate() {
        let name = |place: usize| match place.checked_sub(table.rate_hz.len() * options.harmonics.len()) {
            Some(line) => format!("the line at {} Hz", mode.lines_hz.get(line).copied().unwrap_or(f64::NAN)),
            None => {
                let (wheel, harmonic) = (place / options.harmonics.len() + 1, options.harmonics[place % options.harmonics.len()]);
                if harmonic == 1 { format!("wheel {wheel}") } else { format!("{harmonic} times the rate of wheel {wheel}") }
            }
        };
        let told = |is: &dyn Fn(&Seen) -> bool, count: &dyn Fn(&Seen) -> usize| -> String {
            let looked_at = found.seen.iter().enumerate().filter(|(_, own)| own.windows >= LEAST_WINDOWS && is(own));
            let words = |(place, own): (usize, &Seen)| format!("{} ({} of {} windows)", name(place), count(own), own.windows);
            looked_at.map(words).collect::<Vec<_>>().join(", ")
        };
        let unseen = told(&|own| own.seen * LEAST_WINDOWS <= own.windows, &|own| own.windows - own.seen);
        if !unseen.is_empty() {
            made.notes.push(format!(
                "{}: no more than noise are {unseen}: what is taken off there is noise, and a wave at another rate stays",
                mode.sid
            ));
        }
        let beside = told(&|own| 2 * own.beside >= own.windows, &|own| own.beside);
        if !beside.is_empty() {
            made.notes.push(format!("{}: strong lines are left close to {beside}: check their rates", mode.sid));
        }
        if let Some(late) = found.rates_late {
            let side = if late.late_s > 0.0 { "late" } else { "early" };
            made.notes.push(format!(
                "{}: the waves of the wheels say that the table of their rates is {:.0} s +- {:.0} s {side}: check its times",
                mode.sid,
                late.late_s.abs(),
                late.std_s
            ));
        }
        let Some(found) = WheelsFound::of(found) else { continue };
        made.wheels.insert(mode.sid.clone(), found);
        let pair = u8::try_from(index)
            .ok()
            .and_then(|code| picture::spectra(&before, &all, &context.span(), code, modes[index].rate_hz));
        spectra.extend(pair.map(|(before, after)| (mode.sid.clone(), before, after)));
    }
    Ok(spectra)
}

/// What both sensors share on a day.
pub struct Shared {
    /// Name in place of the sensor, and rows.
    pub tables: Vec<(String, LevelRows<'static>)>,
    /// What the files say further of themselves.
    pub says: Vec<(String, String)>,
    /// Telemetry and daily models.
    pub inputs: Vec<Input>,
    /// Means of both sensors on the day, also those at times that the other one does not have.
    pub means_read: usize,
    /// The principal axes, component by component; none of a gradiometer.
    pub axes: Vec<SharedAxis>,
}

/// Means with their covariances, independent and common part, nT²; these are empty if they are not wanted.
pub type Uncertain = (Means, [Vec<[f64; 6]>; 2]);

/// The means of a sensor and day in a level.
pub fn means_of(
    prepared: &Prepared,
    carry: &Carry,
    index: usize,
    day: i32,
    level: Level,
    inputs: &mut Vec<Input>,
) -> Result<Option<Uncertain>, Finding> {
    let wanted = BTreeSet::from([level]);
    let mut found = None;
    let context = Context::new(prepared, carry, index, day, &wanted);
    context.make(&mut |_, product, own, _| {
        if let Product::Means(means, blocks) = product {
            found = Some((means.clone(), means.covariances_nt2(blocks)));
            inputs.extend_from_slice(own);
        }
        Ok(())
    })?;
    Ok(found)
}

/// What is to be known of a coupling that is applied in axes which turn against those of the spacecraft.
pub fn turning_coupling(stated: &Common) -> Option<Note> {
    let [primary, secondary] = stated.inputs;
    (stated.coupling.is_some() && stated.inputs != ['F', 'F']).then(|| {
        let text = format!(
            "the coupling of [pca] is applied to means of the levels {primary} and {secondary}, where it holds only while these axes \
             do not turn against the spacecraft, which makes the disturbance"
        );
        Note::new(NoteKind::Method, text).about("pca").with_remedy("take inputs = [\"F\", \"F\"], the axes of the spacecraft")
    })
}

/// Levels of whole days take the roles of the sensors from their begin: refuses a day in which these change.
///
/// # Errors
/// The primary sensor changes within the day.
pub fn one_role(prepared: &Prepared, day: &Range<Tt2000>) -> Result<(), Finding> {
    if !prepared.mission.roles.change_within(day) {
        return Ok(());
    }
    let rule = "changes the primary sensor within the day: levels H, I and J need one primary sensor for a whole day";
    Err(Finding::error("[[role.interval]]", rule, "make the other levels of this day, without H, I and J"))
}

/// Means of both sensors at their common times.
#[derive(Default)]
struct Pairs {
    time: Vec<Tt2000>,
    field_nt: [[Vec<f64>; 3]; 2],
    /// Independent and common part of each sensor, nT²; empty if they are not wanted.
    covariances_nt2: [[Vec<[f64; 6]>; 2]; 2],
    mode: Vec<u8>,
    count: Vec<u32>,
    flags: Vec<u32>,
}

impl Pairs {
    /// Puts the common times of a day behind those that it has, as far as they lie within a stretch.
    fn append(&mut self, sensors: &[Uncertain; 2], span: Option<Span>) {
        let [(first, _), (second, _)] = sensors;
        for pair in two_sensors::common_times(&first.time, &second.time) {
            if span.is_some_and(|span| !span.holds(first.time[pair[0]])) {
                continue;
            }
            self.time.push(first.time[pair[0]]);
            self.mode.push(first.mode[pair[0]]);
            self.count.push(first.count[pair[0]].min(second.count[pair[1]]));
            self.flags.push(first.flags[pair[0]] | second.flags[pair[1]]);
            for (side, (means, covariances)) in sensors.iter().enumerate() {
                (0..3).for_each(|c| self.field_nt[side][c].push(means.field_nt[c][pair[side]]));
                for (own, all) in self.covariances_nt2[side].iter_mut().zip(covariances) {
                    own.extend(all.get(pair[side]));
                }
            }
        }
    }
}

/// What the files of level J say of uncertainty.
const UNCERTAINTY: &str = "standard, k = 1, of the noise and the calibrations of both sensors, which are taken for independent of each other: \
    ua independent from vector to vector, uc common to all vectors; disturbances that do not fit the method, and the uncertainty of axes or \
    coupling, are not in it";

/// What both sensors share on a day; `None` where one of them has no means.
///
/// # Errors
/// What is wrong with the telemetry, the method, or the roles of the sensors.
pub fn common(prepared: &Prepared, carry: &Carry, day: i32) -> Result<Option<Shared>, Finding> {
    let mission = &prepared.mission;
    let stated = &mission.common;
    let own_day = prepared.leap.day(day);
    if stated.span.is_some_and(|span| !span.meets(&Span { from: own_day.start, to: own_day.end })) {
        return Ok(None);
    }
    // Principal axes are those of the whole stretch, also where it reaches over midnights.
    let days = match (stated.span, &stated.coupling) {
        (Some(span), None) => prepared.leap.utc(span.from).day..=prepared.leap.utc(span.to - 1).day,
        _ => day..=day,
    };
    let place = |role: usize| mission.sensors.iter().position(|s| mission.roles.of(&s.name, own_day.start) == role);
    let (Some(primary), Some(secondary)) = (place(0), place(1)) else { return Ok(None) };
    let mut inputs = Vec::new();
    let mut pairs = Pairs::default();
    let mut means_read = 0;
    for other in days {
        let span = prepared.leap.day(other);
        one_role(prepared, &span)?;
        if mission.roles.of(&mission.sensors[primary].name, span.start) != 0 {
            let rule = "reaches over a change of the primary sensor: level J needs one primary sensor for a whole interval";
            return Err(Finding::error("[pca]", rule, "let `from` and `to` lie between two changes of [[role.interval]]"));
        }
        let mut take = |index: usize, letter: char| -> Result<Option<Uncertain>, Finding> {
            let level = Level::ALL.into_iter().find(|level| level.letter().starts_with(letter)).unwrap_or(Level::G);
            // Wheels are taken off the primary sensor only.
            let level = if level == Level::I && index == secondary { Level::G } else { level };
            means_of(prepared, carry, index, other, level, &mut inputs)
        };
        if let (Some(first), Some(second)) = (take(primary, stated.inputs[0])?, take(secondary, stated.inputs[1])?) {
            if other == day {
                means_read = first.0.time.len() + second.0.time.len();
            }
            pairs.append(&[first, second], stated.span);
        }
    }
    let begin = pairs.time.partition_point(|t| *t < own_day.start);
    let own = begin..pairs.time.partition_point(|t| *t < own_day.end);
    if own.is_empty() {
        return Ok(None);
    }
    inputs.sort_by(|a, b| a.path.cmp(&b.path));
    inputs.dedup();
    let sides = pairs.field_nt.each_ref().map(|side| side.each_ref().map(Vec::as_slice));
    let refuse = |e: two_sensors::TwoSensorsError| Finding::error(COMMON, e.to_string(), "see [pca]");
    let mut says = vec![("uncertainty".to_owned(), UNCERTAINTY.to_owned())];
    let mut shared = Vec::new();
    let parts: Parts = match &stated.coupling {
        Some(m) => {
            says.push(("method".to_owned(), "gradiometer".to_owned()));
            let rows = [0, 1, 2].map(|row| [m[(row, 0)], m[(row, 1)], m[(row, 2)]]);
            two_sensors::gradiometer(sides[0], sides[1], rows).map_err(refuse)?
        }
        None => {
            let (parts, axes) = two_sensors::principal(sides[0], sides[1]).map_err(refuse)?;
            says.push(("method".to_owned(), "pca".to_owned()));
            for (axis, name) in axes.iter().zip(["x", "y", "z"]) {
                let [a, b] = axis.direction;
                let text = format!(
                    "direction {a:.9} {b:.9}, share of variance {:.6}, correlation {:.6}, {} pairs",
                    axis.share, axis.correlation, axis.pairs
                );
                says.push((format!("axis_{name}"), text));
                shared.push(SharedAxis { direction: axis.direction, share: axis.share, correlation: axis.correlation });
            }
            parts
        }
    };
    // Independent and common part, each of what is shared, of the rest of the primary sensor and of that of the secondary one.
    let [outboard, inboard] = &pairs.covariances_nt2;
    let covariances = [0, 1].map(|part| parts.covariances_nt2(&outboard[part], &inboard[part]));
    let time = &pairs.time[own.clone()];
    let rows = |field_nt: &[Vec<f64>; 3], which: usize| LevelRows {
        #[expect(clippy::cast_precision_loss, reason = "the clock of a spacecraft has microseconds")]
        obt_s: time.iter().map(|t| (t - prepared.leap.clock_begin()) as f64 * 1e-9).collect(),
        time: Cow::Owned(time.to_vec()),
        field_nt: field_nt.each_ref().map(|c| Cow::Owned(c[own.clone()].to_vec())),
        mode: Cow::Owned(pairs.mode[own.clone()].to_vec()),
        count: Some(Cow::Owned(pairs.count[own.clone()].to_vec())),
        flags: Cow::Owned(pairs.flags[own.clone()].to_vec()),
        std_nt: mission.uncertainty.then(|| covariances.each_ref().map(|of| stds_nt(&of[which][own.clone()]))),
        ..LevelRows::default()
    };
    let name = |index: usize| format!("own_{}", mission.sensors[index].name);
    let tables = vec![
        (COMMON.to_owned(), rows(&parts.common_nt, 0)),
        (name(primary), rows(&parts.own_outboard_nt, 1)),
        (name(secondary), rows(&parts.own_inboard_nt, 2)),
    ];
    Ok(Some(Shared { tables, says, inputs, means_read, axes: shared }))
}

#[cfg(test)]
mod tests {
    use super::would_show;
    use crate::flight::heater::{HeaterClass, Jump};

    /// 0.6 and 0.3 nT beside standard deviations of 0.12 and 0.17 nT: edges of 5.6 and 3.9 standard deviations.
    #[test]
    fn a_heater_whose_edges_would_be_seen_is_off_where_none_is() {
        let class = HeaterClass {
            name: "h1".to_owned(),
            vector_nt: [0.6, 0.0, 0.3],
            std_nt: [0.01; 3],
            off_s: [20.0, 1.0],
            on_s: [20.0, 1.0],
            edges: 100,
            edge_s: 1.0,
        };
        let other = |std_nt: f64| Jump {
            time_tt2000: 0,
            time_std_s: 0.1,
            interval: 0,
            class: 1,
            on: true,
            height_nt: [1.2, 0.0, 0.7],
            std_nt: [std_nt; 3],
        };
        assert!(would_show(&class, &[&other(0.12)]));
        assert!(!would_show(&class, &[&other(0.17)]));
        assert!(!would_show(&class, &[&other(f64::NAN)]));
        assert!(!would_show(&class, &[]));
    }
}
