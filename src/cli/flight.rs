//! `calfit flight`: telemetry to calibrated levels.

use super::check::FLIGHT_FILE;
use super::options::refuse_given;
use super::output::{Terminal, json};
use super::{Common, Status};
use crate::data::error::{Finding, Severity};
use crate::data::note::{Note, NoteKind};
use crate::data::time::day_of;
use crate::data::units::counted;
use crate::files::campaign::Campaign;
use crate::files::flight::is_mission;
use crate::flight::made::DayMade;
use crate::workflow::flight::{
    Carry, CarryRow, Covered, DailyOptions, DayFailed, Flight, FlightMade, FlightOptions, Gap, Inspected, Levels, day_name,
    make_carry, make_daily, make_report,
};
use clap::Args;
use jiff::civil::Date;
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

#[derive(Args, Debug)]
pub(super) struct Arguments {
    /// Levels by their letters without separators, such as ABC, or `all`; or `carry`: what every day needs of the others, as a table; or `daily`: the daily offset models, from calm times; or `report`: the report of the days that stand in the folder.
    #[arg(value_name = "LEVELS")]
    what: String,
    /// The configuration of the mission.
    #[arg(value_name = "FLIGHT.TOML")]
    config: PathBuf,
    /// Only this sensor; `common` is what two sensors share, levels D and J.
    #[arg(long, value_name = "NAME")]
    sensor: Option<String>,
    /// First day, YYYY-MM-DD, UTC.
    #[arg(long, value_name = "DATE")]
    from: Option<Date>,
    /// Last day, YYYY-MM-DD, UTC.
    #[arg(long, value_name = "DATE")]
    to: Option<Date>,
    /// The table that `calfit flight carry` wrote, so that days can be made in any order and place.
    #[arg(long, value_name = "FILE")]
    carry: Option<PathBuf>,
    /// Housekeeping in physical units as well.
    #[arg(long)]
    hk: bool,
    /// With `daily`: the highest order of a model, 3 without it.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=5))]
    order: Option<u8>,
    /// With `daily`: a table of calm times, `from` and `to`; without it they are found.
    #[arg(long, value_name = "TABLE")]
    calm: Option<PathBuf>,
}

const CARRY: &str = "carry";
const DAILY: &str = "daily";
/// The highest order of a daily model that is tried if none is stated (RO-IGEP-TR0028 section 4.2.3.3).
const MOST_ORDER: usize = 3;
const REPORT: &str = "report";

/// Days of sensors that are made at the same time: reading and sorting one has a single thread, and every one needs its memory.
const AT_ONCE: usize = 2;

pub(super) fn run(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    if let (Some(from), Some(to)) = (arguments.from, arguments.to)
        && from > to
    {
        let rule = format!("--from {from} is after --to {to}");
        return Err(Finding::error("calfit flight", rule, "name the first day with --from and the last one with --to"));
    }
    if arguments.what == CARRY || arguments.what == REPORT {
        refuse_of_levels(arguments)?;
    }
    if arguments.what == CARRY {
        return carry(arguments, common, terminal);
    }
    if arguments.what == DAILY {
        return daily(arguments, common, terminal);
    }
    if arguments.order.is_some() || arguments.calm.is_some() {
        let remedy = "take them away, or write `calfit flight daily`";
        return Err(Finding::error("calfit flight", "--order and --calm are options of `daily`", remedy));
    }
    if arguments.what == REPORT {
        let mut findings = Vec::new();
        let made = make_report(&arguments.config, &common.out, common.force, &mut findings);
        findings.iter().for_each(|f| terminal.finding(f));
        let file = made?.display().to_string();
        if common.json {
            terminal.print(&json(&ReportShown { file })?);
        } else {
            terminal.tell(&format!("  -> {file}\n"));
        }
        return Ok(Status::Done);
    }
    let levels =
        Levels::parse(&arguments.what, arguments.hk).map_err(|e| Finding::error("calfit flight", e.to_string(), e.remedy()))?;
    let options = FlightOptions {
        levels,
        sensor: arguments.sensor.clone(),
        days: [arguments.from.map(day_of), arguments.to.map(day_of)],
        carry: arguments.carry.clone(),
        out: common.out.clone(),
        force: common.force,
        plots: !common.no_plots,
    };
    let mut findings = Vec::new();
    let flight = Flight::open(&arguments.config, options, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let flight = flight?;
    let jobs = flight.jobs()?;
    let mut made = FlightMade { notes: flight.notes(), ..FlightMade::default() };
    let bar = terminal.progress(jobs.len(), "made");
    // Each takes the next day once it is done with one.
    let (next, results) = (AtomicUsize::new(0), Mutex::new(BTreeMap::new()));
    (0..AT_ONCE).into_par_iter().with_max_len(1).for_each(|_| {
        while let Some((place, job)) =
            Some(next.fetch_add(1, Ordering::Relaxed)).and_then(|place| Some((place, jobs.get(place)?)))
        {
            let (sensor, day) = flight.name(*job);
            let found = bar.of(&format!("{sensor} {day}"), || flight.make(*job));
            results.lock().unwrap_or_else(PoisonError::into_inner).insert(place, (sensor, day, found));
        }
    });
    for (sensor, day, found) in results.into_inner().unwrap_or_else(PoisonError::into_inner).into_values() {
        match found {
            Ok(found) => made.days.extend(found),
            Err(error) => {
                terminal.finding(&error);
                made.failed.push(DayFailed { sensor, day, error });
            }
        }
    }
    bar.finish();
    made.notes.extend(made.days_missing());
    made.notes.extend(flight.comparisons());
    flight.finish()?;
    made.notes.extend(flight.beside(&made.days));
    if made.days.is_empty() && made.failed.is_empty() {
        // Within the telemetry a day may have none, which is no fault of the one who asks for it.
        if jobs.is_empty() {
            return Err(no_vectors(arguments));
        }
        made.notes.push(Note::new(NoteKind::Losses, "there are no vectors in these days, and nothing was made"));
    }
    if common.json {
        terminal.print(&json(&made)?);
    } else {
        made.notes.iter().for_each(|note| terminal.tell(&format!("note: {note}\n")));
        made.days.iter().for_each(|day| terminal.tell(&told(day)));
        for failed in &made.failed {
            terminal.error(&format!("{} {} was not made", failed.sensor, failed.day));
        }
    }
    Ok(if made.failed.is_empty() { Status::Done } else { Status::Partly })
}

/// Nothing was made, of these days.
fn no_vectors(arguments: &Arguments) -> Finding {
    let rule = "gives no vectors in these days";
    Finding::error(&arguments.config.display().to_string(), rule, "see `input`, --from, --to and --sensor")
}

/// `carry` and `report` are of all sensors and days.
fn refuse_of_levels(arguments: &Arguments) -> Result<(), Finding> {
    let given = [
        ("--sensor", arguments.sensor.is_some()),
        ("--from", arguments.from.is_some()),
        ("--to", arguments.to.is_some()),
        ("--carry", arguments.carry.is_some()),
        ("--hk", arguments.hk),
    ];
    let rule = format!("changes nothing of `{}`, which is of all sensors and days", arguments.what);
    refuse_given(&given, &rule, "leave it out")
}

/// What `report` prints with `--json`.
#[derive(Serialize)]
struct ReportShown {
    file: String,
}

/// What `carry` prints with `--json`.
#[derive(Serialize)]
struct CarryShown<'a> {
    file: String,
    days: Vec<CarryDay<'a>>,
    unknown: Vec<UnknownDay<'a>>,
}

/// A row of the table of the first pass.
#[derive(Serialize)]
struct CarryDay<'a> {
    sensor: &'a str,
    day: String,
    first_tt2000: i64,
    last_tt2000: i64,
    t_first_degc: f64,
    t_last_degc: f64,
    /// As in the day table of `calfit flight`.
    continuity_nt: [f64; 3],
    modes: Vec<&'a str>,
    reset: bool,
    /// A daily model acts on it that is joined to those of other days.
    daily_model: bool,
}

/// A day that cannot be made with the table.
#[derive(Serialize)]
struct UnknownDay<'a> {
    sensor: &'a str,
    day: String,
    reason: &'a str,
}

impl<'a> CarryShown<'a> {
    fn of(carry: &'a Carry, file: &Path) -> Self {
        let day = |row: &'a CarryRow| CarryDay {
            sensor: &row.sensor,
            day: day_name(row.day),
            first_tt2000: row.time[0],
            last_tt2000: row.time[1],
            t_first_degc: row.degc[0],
            t_last_degc: row.degc[1],
            continuity_nt: row.continuity.sum_nt,
            modes: row.modes.split(' ').filter(|sid| !sid.is_empty()).collect(),
            reset: row.continuity.joined.is_none(),
            daily_model: row.has_model,
        };
        let unknown = carry.unknown.iter().map(|((sensor, day), reason)| UnknownDay { sensor, day: day_name(*day), reason });
        Self { file: file.display().to_string(), days: carry.rows.iter().map(day).collect(), unknown: unknown.collect() }
    }
}

fn carry(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let out = if common.out_given { common.out.clone() } else { PathBuf::from("carry.parquet") };
    let mut findings = Vec::new();
    let carry = make_carry(&arguments.config, &out, common.force, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let carry = carry?;
    for ((sensor, day), reason) in &carry.unknown {
        terminal.error(&format!("{sensor} {}: how the model goes on at midnight is not known: {reason}", day_name(*day)));
    }
    if common.json {
        terminal.print(&json(&CarryShown::of(&carry, &out))?);
    } else {
        terminal.tell(&format!("{} days of sensors\n  -> {}\n", carry.rows.len(), out.display()));
    }
    Ok(if carry.unknown.is_empty() { Status::Done } else { Status::Partly })
}

fn daily(arguments: &Arguments, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let options = DailyOptions {
        order: arguments.order.map_or(MOST_ORDER, usize::from),
        calm: arguments.calm.clone(),
        sensor: arguments.sensor.clone(),
        days: [arguments.from.map(day_of), arguments.to.map(day_of)],
        out: if common.out_given { common.out.clone() } else { PathBuf::from(DAILY) },
        force: common.force,
        plots: !common.no_plots,
    };
    let mut findings = Vec::new();
    let made = make_daily(&arguments.config, &options, &mut findings);
    findings.iter().for_each(|f| terminal.finding(f));
    let made = made?;
    made.failed.iter().for_each(|failed| terminal.finding(&failed.error));
    if common.json {
        terminal.print(&json(&made)?);
    } else {
        for model in &made.models {
            let [x, y, z] = model.order;
            let share = |c: usize| model.explained[c].map_or("unknown".to_owned(), |share| format!("{:.1} %", 100.0 * share));
            terminal.tell(&format!(
                "{} {}: orders {x} {y} {z} of {} calm minutes from {:.1} to {:.1} °C; explained in hours left out: {}, {}, {}\n  -> {}\n",
                model.sensor,
                model.day,
                model.minutes,
                model.valid_degc[0],
                model.valid_degc[1],
                share(0),
                share(1),
                share(2),
                options.out.join(&model.file).display()
            ));
            model.notes.iter().for_each(|note| terminal.tell(&format!("  note: {note}\n")));
        }
        made.failed.iter().for_each(|failed| terminal.error(&format!("{} {} has no model", failed.sensor, failed.day)));
    }
    if made.models.is_empty() && made.failed.is_empty() {
        return Err(no_vectors(arguments));
    }
    Ok(if made.failed.is_empty() { Status::Done } else { Status::Partly })
}

/// The configuration of flight processing that a path names: that file, or the one in a folder without runs.
pub(super) fn configuration(path: &Path) -> Option<PathBuf> {
    let file = if path.is_dir() { path.join(FLIGHT_FILE) } else { path.to_owned() };
    let is_toml = file.extension().is_some_and(|end| end == "toml");
    let has_runs = || path.is_dir() && Campaign::run_files(path).is_ok_and(|runs| !runs.is_empty());
    (is_toml && is_mission(&file) && !has_runs()).then_some(file)
}

/// `calfit inspect flight.toml`: days, sensors, modes, vectors, what is rejected, what tables do not cover.
pub(super) fn inspect(path: &Path, common: &Common, terminal: &Terminal) -> Result<Status, Finding> {
    let mut findings = Vec::new();
    let days = crate::workflow::flight::inspect(path, &mut findings)?;
    findings.iter().for_each(|f| terminal.finding(f));
    if common.json {
        terminal.print(&json(&days)?);
    } else {
        for Inspected { day, tables, gaps } in &days {
            let modes: Vec<String> = day.modes.iter().map(|(mode, count)| format!("{count} {mode}")).collect();
            let degc = day.degc.map_or(String::new(), |[low, high]| format!("; {low:.1} to {high:.1} °C"));
            let tables = tables.iter().map(covered).collect::<Vec<_>>().join(", ");
            let tables = if tables.is_empty() { tables } else { format!("\n  tables: {tables}") };
            let gap = |gap: &Gap| format!("{:.1} s from {}", gap.seconds, gap.from);
            let more = if gaps.len() > MOST_GAPS { ", ..." } else { "" };
            let gaps = gaps.iter().take(MOST_GAPS).map(gap).collect::<Vec<_>>().join(", ");
            let gaps = if gaps.is_empty() { gaps } else { format!("\n  longest gaps: {gaps}{more}") };
            terminal.print(&format!("{}\n  modes: {}{degc}{gaps}{tables}\n", found(day), modes.join(", ")));
        }
    }
    Ok(if findings.iter().any(|f| f.severity == Severity::Error) { Status::Partly } else { Status::Done })
}

/// Gaps of a day that are named.
const MOST_GAPS: usize = 3;

/// How much of a day a table holds, in words; with its ends where that is not all of it.
fn covered(table: &Covered) -> String {
    let share = format!("{} {:.1} %", table.table, 100.0 * table.covered);
    match (&table.from, &table.to) {
        (Some(from), Some(to)) if table.covered < 1.0 => format!("{share} ({from} to {to})"),
        _ => share,
    }
}

/// What was made of a day, in a few lines.
fn told(day: &DayMade) -> String {
    let levels = if day.levels.is_empty() { "no level".to_owned() } else { format!("level {}", day.levels.join(", ")) };
    format!("{}\n  -> {levels}\n", found(day))
}

/// What there is in the telemetry of a day, in a few lines.
fn found(day: &DayMade) -> String {
    let rows = &day.rows;
    let mut text = format!("{} {}: {}", day.sensor, day.day, counted(day.written as u64, "vector"));
    for (count, what) in [
        (rows.duplicates, "repeated"),
        (rows.conflicts, "of these with other counts"),
        (rows.rejected, "rejected by their quality"),
        (rows.contradicting, "with the bit of another sensor"),
        (day.null, "null"),
    ] {
        if count > 0 {
            text.push_str(&format!(", {count} {what}"));
        }
    }
    let flags: Vec<String> = day.flags.iter().map(|(words, count)| format!("{count} {words}")).collect();
    if !flags.is_empty() {
        text.push_str(&format!("\n  flags: {}", flags.join(", ")));
    }
    day.notes.iter().for_each(|note| text.push_str(&format!("\n  note: {note}")));
    text
}
