//! A mapping for a table that nobody has described: what the names, the texts and the numbers of its columns tell.

mod dialect;
mod print;
mod roles;

use super::table::{binary, whole};
use super::{Cells, Dialect, ForeignTable, Format, TimeFormat, Zone, time};
use crate::data::error::Finding;

use std::path::Path;

/// Patterns of times that are tried where ISO 8601 does not fit. Where day and month can be told from each other by no row, the first one
/// that fits is taken, and the mapping says so.
const PATTERNS: [&str; 11] = [
    "%d.%m.%Y %H:%M:%S%.f",
    "%d.%m.%y %H:%M:%S%.f",
    "%Y/%m/%d %H:%M:%S%.f",
    "%d/%m/%Y %H:%M:%S%.f",
    "%m/%d/%Y %H:%M:%S%.f",
    "%m/%d/%Y %I:%M:%S%.f %p",
    "%d/%m/%Y %I:%M:%S%.f %p",
    "%d-%b-%Y %H:%M:%S%.f",
    "%d %b %Y %H:%M:%S%.f",
    "%Y%m%d %H%M%S%.f",
    "%d.%m.%Y %H:%M",
];

/// A column of numbers.
pub(super) struct Numeric {
    name: String,
    values: Vec<f64>,
}

/// A column of texts that is the same in all rows or changes a few times.
pub(super) struct Textual {
    name: String,
    distinct: usize,
}

/// The column of the time.
pub(super) struct Time {
    column: String,
    /// The column of the dates, where the times are those of a day.
    date: Option<String>,
    format: Option<TimeFormat>,
    /// Whether the texts state their zone.
    zoned: bool,
    ns: Vec<i64>,
}

/// What a table holds.
pub(super) struct Contents {
    file: String,
    format: Format,
    dialect: Dialect,
    time: Time,
    numbers: Vec<Numeric>,
    texts: Vec<Textual>,
    /// Columns of which nothing is known.
    others: Vec<String>,
}

/// A mapping for a table, with comments that say why and what is to be checked.
///
/// # Errors
/// A table that cannot be read, or without a column of times or three columns of readings.
pub fn guess(path: &Path) -> Result<String, Finding> {
    let by_name = Format::of_name(path).unwrap_or(Format::Csv);
    let (format, dialect) = match binary(path)? {
        Some(format) => (format, Dialect::default()),
        None if by_name == Format::Csv => (Format::Csv, dialect::found(&path.display().to_string(), &whole(path)?.0)?),
        None => (by_name, Dialect::default()),
    };
    let table = ForeignTable::read(path, Some(format), &dialect)?;
    let contents = contents(&table, format, dialect)?;
    let roles = roles::found(&contents)?;
    Ok(print::mapping(path, &contents, &roles))
}

/// Sorts the columns into numbers, texts and the time.
fn contents(table: &ForeignTable, format: Format, dialect: Dialect) -> Result<Contents, Finding> {
    let (mut numbers, mut texts, mut others, mut times) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for name in table.names().iter().filter(|n| !n.is_empty()) {
        let is_number = table.numbers(name).ok().filter(|v| v.iter().any(|x| x.is_finite()));
        if let Some(values) = is_number {
            numbers.push(Numeric { name: name.clone(), values });
            continue;
        }
        match table.cells(name)? {
            Cells::Moments { .. } | Cells::Texts(_) => match text_time(table, name, None) {
                Some(time) => times.push(time),
                None => {
                    let mut distinct = table.texts(name)?;
                    distinct.dedup();
                    texts.push(Textual { name: name.clone(), distinct: distinct.len() });
                }
            },
            _ => others.push(name.clone()),
        }
    }
    if times.is_empty() {
        times.extend(date_and_time(table, &texts));
    }
    let number_times: Vec<&Numeric> = numbers.iter().filter(|n| roles::is_time_name(&n.name)).collect();
    let best_number = number_times.iter().find_map(|n| number_time(table, n));
    let mut times = times.into_iter();
    let time = match (times.next(), best_number) {
        (Some(time), _) | (None, Some(time)) => time,
        (None, None) => {
            let any = numbers.iter().find_map(|n| rises(n).then(|| number_time(table, n)).flatten());
            any.ok_or_else(|| {
                let rule = "no column was found that could be the time: none has a usual name of one, or values that rise with every row";
                Finding::error(table.file(), rule, "write the mapping by hand; `docs/import.md` has an example to begin with")
            })?
        }
    };
    numbers.retain(|n| n.name != time.column);
    texts.retain(|text: &Textual| text.name != time.column && Some(&text.name) != time.date.as_ref());
    others.extend(times.map(|other| other.column));
    Ok(Contents { file: table.file().to_owned(), format, dialect, time, numbers, texts, others })
}

/// Whether the numbers rise, row by row.
fn rises(column: &Numeric) -> bool {
    column.values.len() > 2 && column.values.windows(2).all(|w| w[1] > w[0])
}

fn number_time(table: &ForeignTable, column: &Numeric) -> Option<Time> {
    let first = column.values.first().copied()?;
    let format = if first > 1e11 {
        TimeFormat::UnixMs
    } else if first > 1e8 {
        TimeFormat::Unix
    } else {
        TimeFormat::Seconds
    };
    in_order(table, &column.name, None, Some(format), true)
}

/// The two columns of texts of which one holds dates and the other times of the day.
fn date_and_time(table: &ForeignTable, texts: &[Textual]) -> Option<Time> {
    let names = || texts.iter().map(|text| text.name.as_str());
    let mut pairs = names().flat_map(|date| names().filter(move |name| *name != date).map(move |name| (name, date)));
    pairs.find_map(|(name, date)| text_time(table, name, Some(date)))
}

/// A column of texts or moments as times, with the dates of another column before them where there is one, in the first format that all its
/// cells have and in which they do not go back.
fn text_time(table: &ForeignTable, name: &str, date: Option<&str>) -> Option<Time> {
    if let Ok(Cells::Moments { utc, .. }) = table.cells(name) {
        return in_order(table, name, None, None, utc);
    }
    // Behind the date a sign is one of the zone.
    let clock = if date.is_some() { 0 } else { 10 };
    let zoned = table
        .texts(name)
        .ok()?
        .first()
        .is_some_and(|t| t.ends_with('Z') || t.get(clock..).is_some_and(|r| r.contains(['+', '-'])));
    let iso = in_order(table, name, date, Some(TimeFormat::Iso8601), zoned);
    iso.or_else(|| PATTERNS.iter().find_map(|p| in_order(table, name, date, Some(TimeFormat::Pattern((*p).to_owned())), false)))
}

fn in_order(table: &ForeignTable, name: &str, date: Option<&str>, format: Option<TimeFormat>, zoned: bool) -> Option<Time> {
    let times = time::read(table, name, date, format.as_ref(), &Zone::utc(), &mut Vec::new()).ok()?;
    let ordered = times.ns.windows(2).all(|w| w[1] >= w[0]) && times.ns.first() < times.ns.last();
    ordered.then(|| Time { column: name.to_owned(), date: date.map(str::to_owned), format, zoned, ns: times.ns })
}
