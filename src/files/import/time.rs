//! Columns of times: seconds, Unix times, ISO 8601 and patterns, in UTC or in the time of a zone.

use super::table::{Cells, ForeignTable};
use crate::data::error::{Finding, Severity};
use jiff::Timestamp;
use jiff::civil::DateTime;
use jiff::fmt::strtime::BrokenDownTime;
use jiff::tz::{AmbiguousOffset, Offset, TimeZone};

/// How times are written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum TimeFormat {
    /// Seconds since the run's start.
    Seconds,
    /// Seconds since 1970, UTC.
    Unix,
    /// Milliseconds since 1970, UTC.
    UnixMs,
    /// `2026-03-01T08:00:00.25Z`, the zone and the fraction may lack.
    Iso8601,
    /// A pattern of strftime.
    Pattern(String),
}

impl TimeFormat {
    /// The format of this name in a mapping; what holds a `%` is a pattern.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        Some(match name {
            "seconds" => TimeFormat::Seconds,
            "unix" => TimeFormat::Unix,
            "unix_ms" => TimeFormat::UnixMs,
            "iso8601" => TimeFormat::Iso8601,
            pattern if pattern.contains('%') => TimeFormat::Pattern(pattern.to_owned()),
            _ => return None,
        })
    }

    /// Its name in a mapping.
    #[must_use]
    pub fn name(&self) -> &str {
        match self {
            TimeFormat::Seconds => "seconds",
            TimeFormat::Unix => "unix",
            TimeFormat::UnixMs => "unix_ms",
            TimeFormat::Iso8601 => "iso8601",
            TimeFormat::Pattern(pattern) => pattern,
        }
    }
}

/// The zone of times that state none.
#[derive(Clone, Debug, PartialEq)]
pub struct Zone {
    /// As it was written.
    pub name: String,
    zone: TimeZone,
}

impl Zone {
    /// UTC.
    #[must_use]
    pub fn utc() -> Self {
        Self { name: "UTC".to_owned(), zone: TimeZone::UTC }
    }

    /// `UTC`, `+02:00`, `Europe/Berlin`.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        let zone = match name {
            "UTC" | "Z" | "utc" => TimeZone::UTC,
            _ if name.starts_with(['+', '-']) => fixed(name)?,
            _ => TimeZone::get(name).ok()?,
        };
        Some(Self { name: name.to_owned(), zone })
    }
}

/// `+02:00` and `+0200`.
fn fixed(name: &str) -> Option<TimeZone> {
    let digits: String = name[1..].chars().filter(|c| *c != ':').collect();
    if digits.len() != 4 || !digits.bytes().all(|b| b.is_ascii_digit()) {
        return None;
    }
    let (hours, minutes): (i32, i32) = (digits[..2].parse().ok()?, digits[2..].parse().ok()?);
    let seconds = 3600 * hours + 60 * minutes;
    let seconds = if name.starts_with('-') { -seconds } else { seconds };
    (minutes < 60).then_some(())?;
    Offset::from_seconds(seconds).ok().map(|offset| offset.to_time_zone())
}

/// Times, ns.
#[derive(Clone, Debug, PartialEq)]
pub struct Times {
    /// Since 1970 if they are absolute, else since the run's start.
    pub ns: Vec<i64>,
    /// Whether they tell the date.
    pub absolute: bool,
}

/// Smaller numbers are no Unix times (1973), larger ones no seconds of a run.
const LEAST_UNIX_S: f64 = 1e8;
/// Larger numbers are no Unix times in seconds (the year 5138).
const MOST_UNIX_S: f64 = 1e11;
/// The end of 2099: runs are older, and nanoseconds are counted up to the year 2262 only.
const END_UNIX_S: f64 = 4_102_444_800.0;

/// Why a cell is no time, and what to do.
pub type Wrong = (String, String);

fn wrong(rule: impl Into<String>, remedy: impl Into<String>) -> Wrong {
    (rule.into(), remedy.into())
}

/// Reads a column of times, with the dates of another column before them where there is one; what a person should know goes to `findings`.
///
/// # Errors
/// No such column, or a cell that is no time of this format.
pub fn read(
    table: &ForeignTable,
    column: &str,
    date: Option<&str>,
    format: Option<&TimeFormat>,
    zone: &Zone,
    findings: &mut Vec<Finding>,
) -> Result<Times, Finding> {
    let cells = match (date, table.cells(column)?) {
        (None, cells) => cells,
        (Some(date), Cells::Texts(times)) => with_dates(table, date, &times, matches!(format, Some(TimeFormat::Pattern(_))))?,
        (Some(_), _) => {
            let rule = format!("column `{column}` holds no text, so that the dates of another column cannot stand before it");
            return Err(Finding::error(table.file(), rule, "take `date` out of [time], or write the times of the day as text"));
        }
    };
    let refuse = |row: usize, (rule, remedy): Wrong| table.refuse(row, Some(column), &rule, &remedy);
    let mut clock = Clock::new(zone);
    let (ns, absolute): (Vec<i64>, bool) = match cells {
        Cells::Moments { ns, utc } => {
            let each = ns.iter().enumerate().map(|(row, ns)| {
                let ns = ns.ok_or_else(|| refuse(row, empty()))?;
                if utc { Ok(ns) } else { clock.wall(civil_of(ns)).map_err(|w| refuse(row, w)) }
            });
            (each.collect::<Result<_, _>>()?, true)
        }
        Cells::Numbers(values) => {
            let format = format.cloned().unwrap_or(TimeFormat::Seconds);
            let each = values.iter().enumerate().map(|(row, v)| of_number(*v, &format).map_err(|w| refuse(row, w)));
            (each.collect::<Result<_, _>>()?, format != TimeFormat::Seconds)
        }
        Cells::Texts(texts) => {
            let is_number = |t: &String| table.number(0, column, t).is_ok_and(f64::is_finite);
            let guessed = || if texts.first().is_some_and(is_number) { TimeFormat::Seconds } else { TimeFormat::Iso8601 };
            let format = format.cloned().unwrap_or_else(guessed);
            let each = texts.iter().enumerate().map(|(row, text)| match &format {
                _ if text.is_empty() => Err(refuse(row, empty())),
                TimeFormat::Iso8601 => clock.iso(text).map_err(|w| refuse(row, w)),
                TimeFormat::Pattern(pattern) => clock.pattern(text, pattern).map_err(|w| refuse(row, w)),
                _ => {
                    let is_date = text.len() > 5 && text.bytes().filter(|b| matches!(b, b'-' | b':' | b'/')).count() > 1;
                    if is_date {
                        let rule = format!("the time is a date, not a number as `format = \"{}\"` says", format.name());
                        return Err(refuse(row, wrong(rule, "set `format` under [time] to \"iso8601\" or a pattern")));
                    }
                    let value = table.number(row, column, text)?;
                    exact(&text.replace(',', "."), value, &format).map_err(|w| refuse(row, w))
                }
            });
            (each.collect::<Result<_, _>>()?, format != TimeFormat::Seconds)
        }
        Cells::Other(what) => {
            let rule = format!("column `{column}` holds {what}, not times");
            return Err(Finding::error(table.file(), rule, "name another column under [time]"));
        }
    };
    findings.extend(clock.told(table, column));
    Ok(Times { ns, absolute })
}

/// The dates of a column before times of the day, with a blank between them for a pattern.
fn with_dates(table: &ForeignTable, date: &str, times: &[String], has_pattern: bool) -> Result<Cells, Finding> {
    let Cells::Texts(dates) = table.cells(date)? else {
        let rule = format!("column `{date}` holds no text");
        return Err(Finding::error(table.file(), rule, "take `date` out of [time] if the other column tells the date"));
    };
    let between = if has_pattern { ' ' } else { 'T' };
    let joined = |(date, time): (&String, &String)| {
        if date.is_empty() || time.is_empty() { String::new() } else { format!("{date}{between}{time}") }
    };
    Ok(Cells::Texts(dates.iter().zip(times).map(joined).collect()))
}

fn empty() -> Wrong {
    wrong("the time is empty", "write it, or take the row out")
}

/// One time as it is written in a cell of a table of settings or in a mapping; whether it tells the date.
///
/// # Errors
/// Why it is no time.
pub fn one(text: &str, format: Option<&TimeFormat>, zone: &Zone) -> Result<(i64, bool), Wrong> {
    let text = text.trim();
    let plain = crate::files::text::number(text.as_bytes());
    let pattern = match format {
        Some(TimeFormat::Pattern(pattern)) => Some(pattern),
        _ => None,
    };
    match (plain, format) {
        (Some(v), Some(f @ (TimeFormat::Unix | TimeFormat::UnixMs))) if v >= LEAST_UNIX_S => Ok((exact(text, v, f)?, true)),
        (Some(v), _) => Ok((exact(text, v, &TimeFormat::Seconds)?, false)),
        (None, _) => {
            let mut clock = Clock::new(zone);
            let of_pattern = pattern.and_then(|p| clock.pattern(text, p).ok());
            of_pattern.map_or_else(|| clock.iso(text), Ok).map(|ns| (ns, true))
        }
    }
}

/// A number of seconds or milliseconds. Unix times as floating point numbers are good to a quarter of a microsecond.
fn of_number(value: f64, format: &TimeFormat) -> Result<i64, Wrong> {
    if value.is_nan() {
        return Err(empty());
    }
    let seconds = if *format == TimeFormat::UnixMs { value / 1e3 } else { value };
    plausible(seconds, value, format)?;
    if value.fract() == 0.0 && *format == TimeFormat::UnixMs {
        return Ok((value as i64).saturating_mul(1_000_000));
    }
    let far = seconds.abs() >= 1e6;
    Ok(if far { (seconds * 1e6).round() as i64 * 1000 } else { (seconds * 1e9).round() as i64 })
}

/// The same from text, to the last digit.
fn exact(text: &str, value: f64, format: &TimeFormat) -> Result<i64, Wrong> {
    let places = if *format == TimeFormat::UnixMs { 6 } else { 9 };
    let seconds = if *format == TimeFormat::UnixMs { value / 1e3 } else { value };
    if value.is_nan() {
        return Err(empty());
    }
    plausible(seconds, value, format)?;
    let (sign, digits) = text.strip_prefix('-').map_or((1, text.trim_start_matches('+')), |rest| (-1, rest));
    let (whole, fraction) = digits.split_once('.').unwrap_or((digits, ""));
    let fraction: String = fraction.chars().chain(std::iter::repeat('0')).take(places).collect();
    let all = format!("{whole}{fraction}");
    match all.parse::<i64>() {
        Ok(ns) if all.bytes().all(|b| b.is_ascii_digit()) => Ok(sign * ns),
        // With an exponent.
        _ => of_number(value, format),
    }
}

/// The size of a number shows whether it is what the mapping says.
fn plausible(seconds: f64, value: f64, format: &TimeFormat) -> Result<(), Wrong> {
    match format {
        TimeFormat::Seconds if seconds.abs() >= LEAST_UNIX_S => {
            let other = if seconds.abs() >= MOST_UNIX_S { "unix_ms" } else { "unix" };
            let rule = format!("{value} s after the run's start is more than three years");
            Err(wrong(rule, format!("set `format = \"{other}\"` under [time] if these are times since 1970")))
        }
        TimeFormat::Unix if !(LEAST_UNIX_S..MOST_UNIX_S).contains(&seconds) => {
            let remedy = if seconds >= MOST_UNIX_S {
                "set `format = \"unix_ms\"` under [time]"
            } else {
                "set `format = \"seconds\"` under [time]"
            };
            Err(wrong(format!("{value} is no time in seconds since 1970"), remedy))
        }
        TimeFormat::UnixMs if !(LEAST_UNIX_S..MOST_UNIX_S).contains(&seconds) => {
            let rule = format!("{value} is no time in milliseconds since 1970");
            Err(wrong(rule, "set `format = \"unix\"` or \"seconds\" under [time]"))
        }
        TimeFormat::Unix | TimeFormat::UnixMs if seconds >= END_UNIX_S => Err(wrong(
            format!("{value} is a time after 2099"),
            "repair the time, or say with `format` under [time] what the number is",
        )),
        _ => Ok(()),
    }
}

/// The reading of a clock on some wall that stands for ns since 1970.
fn civil_of(ns: i64) -> DateTime {
    Timestamp::from_nanosecond(i128::from(ns)).map_or(DateTime::MIN, |t| Offset::UTC.to_datetime(t))
}

/// Turns readings of wall clocks into moments, one after the other: the hour that comes twice in autumn is told by what stands before.
struct Clock<'a> {
    zone: &'a Zone,
    last: Option<i64>,
    rows: usize,
    /// First row whose time comes twice, and how many there are.
    twice: Option<(usize, usize)>,
    /// First row with an offset of its own that is not that of the zone.
    other_offset: Option<usize>,
}

impl<'a> Clock<'a> {
    fn new(zone: &'a Zone) -> Self {
        Self { zone, last: None, rows: 0, twice: None, other_offset: None }
    }

    fn keep(&mut self, moment: Timestamp) -> Result<i64, Wrong> {
        self.rows += 1;
        let ns = i64::try_from(moment.as_nanosecond())
            .map_err(|_| wrong("the year is not between 1678 and 2262", "correct the time"))?;
        self.last = Some(ns);
        Ok(ns)
    }

    fn wall(&mut self, civil: DateTime) -> Result<i64, Wrong> {
        let ambiguous = self.zone.zone.to_ambiguous_timestamp(civil);
        let at = |offset: Offset| offset.to_timestamp(civil).map_err(|_| wrong("the time is beyond the calendar", "correct it"));
        let zone = &self.zone.name;
        match ambiguous.offset() {
            AmbiguousOffset::Unambiguous { offset } => self.keep(at(offset)?),
            AmbiguousOffset::Gap { .. } => Err(wrong(
                format!("clocks of {zone} never show {civil}: summer time begins there"),
                "set `zone` under [time] to what the computer really used, \"UTC\" or \"+01:00\" for example",
            )),
            AmbiguousOffset::Fold { before, after } => {
                let [first, second] = [at(before)?, at(after)?];
                let Some(last) = self.last else {
                    return Err(wrong(
                        format!("clocks of {zone} show {civil} twice, and nothing before tells which of the two is meant"),
                        "set `zone` under [time] to a fixed one, \"+02:00\" for example",
                    ));
                };
                let (row, count) = self.twice.unwrap_or((self.rows, 0));
                self.twice = Some((row, count + 1));
                let goes_on = first.as_nanosecond() >= i128::from(last);
                self.keep(if goes_on { first } else { second })
            }
        }
    }

    fn iso(&mut self, text: &str) -> Result<i64, Wrong> {
        let text = text.trim().replace(',', ".");
        let ends_in_zone = text.ends_with(['Z', 'z']) || text.get(10..).is_some_and(|rest| rest.contains(['+', '-']));
        let wrong_text = || {
            wrong(
                "the cell is no date and time of ISO 8601",
                "set `format` under [time] to the pattern of these times, \"%d.%m.%Y %H:%M:%S\" for example",
            )
        };
        if ends_in_zone {
            let moment: Timestamp = text.parse().map_err(|_| wrong_text())?;
            if self.other_offset.is_none()
                && self.zone.zone != TimeZone::UTC
                && self.zone.zone.to_offset(moment) != own_offset(&text)
            {
                self.other_offset = Some(self.rows);
            }
            return self.keep(moment);
        }
        // A date alone would be midnight.
        let civil: DateTime = text.parse().ok().filter(|_| text.contains(':')).ok_or_else(wrong_text)?;
        self.wall(civil)
    }

    fn pattern(&mut self, text: &str, pattern: &str) -> Result<i64, Wrong> {
        // Fractions of seconds go with a point in patterns.
        let pointed = if pattern.contains("%.") && !pattern.contains(',') { text.replace(',', ".") } else { text.to_owned() };
        let parsed = BrokenDownTime::parse(pattern, &pointed).map_err(|error| {
            wrong(format!("the time does not go with the pattern `{pattern}`: {error}"), "correct `format` under [time]")
        })?;
        if parsed.offset().is_some() {
            let moment = parsed.to_timestamp().map_err(|error| wrong(format!("{error}"), "correct the time"))?;
            return self.keep(moment);
        }
        let civil = parsed.to_datetime().map_err(|error| {
            wrong(
                format!("`{pattern}` does not tell date and time: {error}"),
                "the pattern needs year, month, day, hour, minute and second",
            )
        })?;
        self.wall(civil)
    }

    /// What a person should know of the zone.
    fn told(&self, table: &ForeignTable, column: &str) -> Vec<Finding> {
        let mut list = Vec::new();
        if let Some((row, count)) = self.twice {
            let rule = format!(
                "{count} times stand in the hour that clocks of {} show twice; each was taken so that time goes on",
                self.zone.name
            );
            list.push(table.refuse(row, Some(column), &rule, "write UTC into the table to be sure"));
        }
        if let Some(row) = self.other_offset {
            let rule = format!(
                "the times have an offset of their own, which is not that of `zone = \"{}\"`; their own was used",
                self.zone.name
            );
            list.push(table.refuse(row, Some(column), &rule, "take `zone` out of [time]"));
        }
        list.into_iter().map(|f| f.weighing(Severity::Warning)).collect()
    }
}

/// The offset that a text of ISO 8601 ends with.
fn own_offset(text: &str) -> Offset {
    let at = text.rfind(['+', '-']).filter(|at| *at > 10);
    let digits: String = at.and_then(|at| text.get(at + 1..)).unwrap_or_default().chars().filter(|c| *c != ':').collect();
    let part = |range: std::ops::Range<usize>| digits.get(range).and_then(|d| d.parse::<i32>().ok()).unwrap_or(0);
    let seconds = 3600 * part(0..2) + 60 * part(2..4);
    let negative = at.is_some_and(|at| text.as_bytes()[at] == b'-');
    Offset::from_seconds(if negative { -seconds } else { seconds }).unwrap_or(Offset::UTC)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::time::SECOND_NS;

    fn iso(text: &str, zone: &str) -> Result<i64, Wrong> {
        Clock::new(&Zone::from_name(zone).unwrap()).iso(text)
    }

    #[test]
    fn iso_times_are_moments() {
        // 2026-03-01 00:00 UTC is 1 772 323 200 s after 1970 (20 513 days).
        let midnight = 20_513 * 86_400 * SECOND_NS;
        for (text, zone, hours) in [
            ("2026-03-01T00:00:00Z", "UTC", 0),
            ("2026-03-01 02:00:00", "UTC", 2),
            ("2026-03-01T02:00:00", "+02:00", 0),
            ("2026-03-01T02:00:00+01:00", "UTC", 1),
            ("2026-03-01 02:00:00", "Europe/Berlin", 1),
        ] {
            assert_eq!(iso(text, zone).unwrap(), midnight + hours * 3600 * SECOND_NS, "{text} {zone}");
        }
        assert_eq!(iso("2026-03-01T00:00:00,0625", "UTC").unwrap(), midnight + 62_500_000);
        for text in ["2026-03-01", "noon", "2026-13-01T00:00:00", ""] {
            assert!(iso(text, "UTC").is_err(), "{text}");
        }
    }

    #[test]
    fn unix_times_beyond_what_is_counted_are_refused() {
        // The end of 2099 is 47 482 days after 1970; 72 004 217 200 s is the year 4251.
        let end = 47_482_i64 * 86_400;
        for (value, format, is_time) in [
            (end as f64 - 1.0, TimeFormat::Unix, true),
            (end as f64, TimeFormat::Unix, false),
            (72_004_217_200.0, TimeFormat::Unix, false),
            (72_004_217_200e3, TimeFormat::UnixMs, false),
        ] {
            assert_eq!(of_number(value, &format).is_ok(), is_time, "{value}");
            assert_eq!(one(&format!("{value}"), Some(&format), &Zone::from_name("UTC").unwrap()).is_ok(), is_time, "{value}");
        }
    }

    #[test]
    fn summer_time_is_not_guessed() {
        let zone = Zone::from_name("Europe/Berlin").unwrap();
        let mut clock = Clock::new(&zone);
        assert!(clock.iso("2026-03-29 02:30:00").unwrap_err().0.contains("never show"));
        assert!(clock.iso("2026-10-25 02:30:00").unwrap_err().0.contains("twice"));
        let mut clock = Clock::new(&zone);
        let times =
            ["01:59:00", "02:30:00", "02:59:00", "02:01:00", "03:00:00"].map(|t| clock.iso(&format!("2026-10-25 {t}")).unwrap());
        // 01:59 is 23:59 UTC; the second 02:01 is 01:01 UTC.
        let minutes = times.map(|t| (t - times[0]) / 60 / SECOND_NS);
        assert_eq!(minutes, [0, 31, 60, 62, 121]);
        assert_eq!(clock.twice, Some((1, 3)));
    }

    #[test]
    fn patterns_and_numbers_are_read_to_the_last_digit() {
        let utc = Zone::utc();
        let midnight = 20_513 * 86_400 * SECOND_NS;
        let pattern = |text: &str, pattern: &str| Clock::new(&utc).pattern(text, pattern).unwrap();
        assert_eq!(pattern("01.03.2026 00:00:01.5", "%d.%m.%Y %H:%M:%S%.f"), midnight + 1_500_000_000);
        assert_eq!(exact("1772323200.0078", 1_772_323_200.007_8, &TimeFormat::Unix).unwrap(), midnight + 7_800_000);
        assert_eq!(of_number(1_772_323_200.007_8, &TimeFormat::Unix).unwrap(), midnight + 7_800_000);
        assert_eq!(exact("1772323200007.8", 1_772_323_200_007.8, &TimeFormat::UnixMs).unwrap(), midnight + 7_800_000);
        assert_eq!(exact("-0.5", -0.5, &TimeFormat::Seconds).unwrap(), -500_000_000);
        assert_eq!(exact("1.5e1", 15.0, &TimeFormat::Seconds).unwrap(), 15 * SECOND_NS);
        assert!(exact("1772323200", 1_772_323_200.0, &TimeFormat::Seconds).is_err());
        assert!(exact("1772323200000", 1_772_323_200_000.0, &TimeFormat::Unix).is_err());
        assert!(exact("1772323200", 1_772_323_200.0, &TimeFormat::UnixMs).is_err());
    }

    #[test]
    fn zones_have_names() {
        for name in ["UTC", "+02:00", "-0330", "Europe/Berlin"] {
            assert!(Zone::from_name(name).is_some(), "{name}");
        }
        for name in ["+2", "+02:90", "Europe/Bärlin", "MESZ", ""] {
            assert!(Zone::from_name(name).is_none(), "{name}");
        }
    }
}
