//! The mapping: what the columns of a table mean. TOML.

use super::time::{TimeFormat, Zone};
use super::{Dialect, Format, Separator};
use crate::data::error::Finding;
use crate::data::run::Kind;
use crate::files::source::{Digested, read_whole};
use crate::files::text::{Group, Keys, decode};
use std::path::{Path, PathBuf};

/// A value for all rows, or the column that holds it.
#[derive(Clone, Debug, PartialEq)]
pub enum Given<T> {
    /// For all rows.
    Value(T),
    /// In a column.
    Column(String),
}

/// What the head of the run says.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RunKeys {
    /// Kind of run.
    pub kind: Option<Given<String>>,
    /// Sensor.
    pub sensor: Option<Given<String>>,
    /// Mode of the instrument.
    pub mode: Option<Given<String>>,
    /// Name of the field programme.
    pub configuration: Option<Given<String>>,
    /// Source of the field.
    pub field_source: Option<Given<String>>,
    /// Start.
    pub start: Option<Given<String>>,
    /// Id of the position.
    pub position: Option<Given<u32>>,
    /// Sample rate, Hz.
    pub sample_rate_hz: Option<f64>,
    /// Whether the facility corrected the coil parameters.
    pub coil_correction: Option<bool>,
    /// Earth's field compensation per coil axis.
    pub earthfield_compensation: Vec<String>,
    /// A pause of the times longer than this begins another run, s.
    pub split_gap_s: Option<f64>,
    /// Another value in this column begins another run.
    pub split_column: Option<String>,
}

/// Unit of the readings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ReadingScale {
    /// Engineering nanotesla in so many per unit of the table.
    Ent(f64),
    /// Counts, with enT per count.
    Counts(f64),
}

/// Unit of the fields.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FieldScale {
    /// nT per unit of the table.
    Same(f64),
    /// nT per ampere of every coil axis.
    Current([f64; 3]),
}

/// The time of every row.
#[derive(Clone, Debug, PartialEq)]
pub struct TimeKeys {
    /// Column.
    pub column: String,
    /// Column of the dates, where the times are those of a day.
    pub date: Option<String>,
    /// Format; by the cells where it is not given.
    pub format: Option<TimeFormat>,
    /// Zone of times without one.
    pub zone: Zone,
    /// Column of the sample counter.
    pub counter: Option<String>,
}

/// The readings of every row.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingKeys {
    /// Columns of x, y, z.
    pub columns: [String; 3],
    /// Unit.
    pub scale: ReadingScale,
    /// Columns of the standard deviations of means.
    pub std: Option<[String; 3]>,
    /// Column of the number of samples of a mean.
    pub count: Option<String>,
}

/// The applied field.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldKeys {
    /// Columns of the three coil axes: in the table of readings, or in the table of settings.
    pub columns: Option<[String; 3]>,
    /// Unit.
    pub scale: FieldScale,
    /// Fields that differ by less are one setting, nT.
    pub same_setting_within_nt: f64,
    /// Column of the frequency of a sine, Hz.
    pub frequency: Option<String>,
    /// Table of settings.
    pub table: Option<PathBuf>,
}

/// A slow channel.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelKeys {
    /// Name in the run.
    pub name: String,
    /// Column.
    pub column: String,
    /// Unit of its values if it is a temperature; temperatures become °C.
    pub unit: TemperatureUnit,
}

/// A unit of temperatures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TemperatureUnit {
    /// °C.
    Celsius,
    /// K.
    Kelvin,
    /// °F.
    Fahrenheit,
}

/// What a row is.
#[derive(Clone, Debug, PartialEq)]
pub enum RowsAre {
    /// One sample.
    Samples,
    /// The mean of a plateau, with the columns of its begin and end where there are any.
    Plateaus {
        /// Begin.
        t_start: Option<String>,
        /// End.
        t_end: Option<String>,
    },
}

/// A mapping.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapping {
    /// Format of the table; by the name of the file where it is not given.
    pub format: Option<Format>,
    /// How text is written.
    pub dialect: Dialect,
    /// Head of the run.
    pub run: RunKeys,
    /// Times.
    pub time: TimeKeys,
    /// Readings.
    pub reading: ReadingKeys,
    /// Fields; absent where none is applied.
    pub field: Option<FieldKeys>,
    /// Temperatures.
    pub temperatures: Vec<ChannelKeys>,
    /// Other slow channels.
    pub channels: Vec<ChannelKeys>,
    /// Rows.
    pub rows: RowsAre,
}

/// Whether a text is a mapping, by the tables that every mapping has.
#[must_use]
pub fn is_mapping(text: &str) -> bool {
    ["[time]", "[reading]"].iter().all(|name| text.lines().any(|line| line.split('#').next().unwrap_or_default().trim() == *name))
}

/// Reads a mapping; warnings go to `findings`.
///
/// # Errors
/// The first fault, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(Mapping, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let mut mapping = parse(&path.display().to_string(), &bytes, findings)?;
    if let Some(table) = mapping.field.as_mut().and_then(|f| f.table.as_mut()) {
        *table = path.parent().unwrap_or(Path::new("")).join(&*table);
    }
    Ok((mapping, digested))
}

fn parse(file: &str, bytes: &[u8], findings: &mut Vec<Finding>) -> Result<Mapping, Finding> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if bytes.starts_with(b"PAR1") || bytes.starts_with(b"ARROW1") {
        return Err(Finding::error(
            file,
            "is a table, not a mapping",
            "name the mapping first: calfit import MAPPING.toml TABLE -o CAMPAIGN",
        ));
    }
    let keys = Keys::parse(file, 1, decode(bytes).into_owned()).map_err(|finding| {
        let table = Path::new(file).extension().is_none_or(|e| !e.eq_ignore_ascii_case("toml"));
        if table {
            return Finding::error(file, "is no mapping in TOML", "name the mapping first: calfit import MAPPING.toml TABLE -o CAMPAIGN; `calfit import --guess TABLE` proposes one");
        }
        finding
    })?;
    let root = keys.root();
    findings.extend(root.unknown(&["file", "run", "time", "reading", "field", "temperature", "channel", "rows"]));
    let (format, dialect) = file_keys(root.group("file")?, findings)?;
    let run_group = root.group("run")?;
    let run = run_keys(run_group.as_ref(), findings)?;
    let time = time_keys(&needed(&root, "time")?, findings)?;
    let reading_group = needed(&root, "reading")?;
    findings.extend(reading_group.unknown(&["columns", "std", "count"]));
    let reading = ReadingKeys {
        columns: three(&reading_group, "columns")?.ok_or_else(|| missing(&reading_group, "columns"))?,
        scale: reading_scale(run_group.as_ref())?,
        std: three(&reading_group, "std")?,
        count: reading_group.text("count")?,
    };
    let field = root.group("field")?.map(|group| field_keys(&group, findings)).transpose()?;
    let rows = rows_keys(root.group("rows")?, findings)?;
    let mapping = Mapping {
        format,
        dialect,
        run,
        time,
        reading,
        field,
        temperatures: channels(root.group("temperature")?, true)?,
        channels: channels(root.group("channel")?, false)?,
        rows,
    };
    agree(&root, &reading_group, &mapping)?;
    Ok(mapping)
}

/// What would contradict itself.
fn agree(root: &Group, reading: &Group, mapping: &Mapping) -> Result<(), Finding> {
    let samples = mapping.rows == RowsAre::Samples;
    if samples && (mapping.reading.std.is_some() || mapping.reading.count.is_some()) {
        let key = if mapping.reading.std.is_some() { "std" } else { "count" };
        return Err(reading.refuse(
            key,
            "belongs to means, and the rows are samples",
            "set `are = \"plateaus\"` under [rows], or take it out",
        ));
    }
    if mapping.reading.std.is_some() != mapping.reading.count.is_some() {
        return Err(reading.refuse("std", "and `reading.count` go together", "name both columns, or neither"));
    }
    if !samples && mapping.field.as_ref().is_none_or(|f| f.columns.is_none() || f.table.is_some()) {
        return Err(root.refuse(
            "field",
            "needs `columns` and no `table` where the rows are plateaus",
            "name the three columns of the applied field",
        ));
    }
    if !samples && mapping.field.as_ref().is_some_and(|f| f.frequency.is_some()) {
        return Err(root.refuse(
            "field",
            "has a frequency, and plateau means have none",
            "take `frequency` out, or import the samples",
        ));
    }
    Ok(())
}

fn missing(group: &Group, key: &str) -> Finding {
    group.refuse(key, "is missing", "add it; `calfit import --guess FILE` proposes a mapping")
}

fn needed<'a>(root: &Group<'a>, key: &str) -> Result<Group<'a>, Finding> {
    root.group(key)?
        .ok_or_else(|| root.refuse(key, "is missing", "add the table; `calfit import --guess FILE` proposes a mapping"))
}

/// Names of three columns.
fn three(group: &Group, key: &str) -> Result<Option<[String; 3]>, Finding> {
    let Some(names) = group.texts(key)? else { return Ok(None) };
    let wrong = |_| group.refuse(key, "must be three names of columns", "name those of x, y and z, in this order");
    let names: [String; 3] = names.try_into().map_err(wrong)?;
    if names[0] == names[1] || names[1] == names[2] || names[0] == names[2] {
        return Err(group.refuse(key, "names a column twice", "name three different columns"));
    }
    Ok(Some(names))
}

fn positive(group: &Group, key: &str) -> Result<Option<f64>, Finding> {
    let value = group.number(key)?;
    match value {
        Some(v) if v <= 0.0 => Err(group.refuse(key, "must be positive", "correct the value")),
        _ => Ok(value),
    }
}

fn file_keys(group: Option<Group>, findings: &mut Vec<Finding>) -> Result<(Option<Format>, Dialect), Finding> {
    let Some(group) = group else { return Ok((None, Dialect::default())) };
    findings.extend(group.unknown(&["format", "separator", "decimal", "skip_rows", "encoding"]));
    let format = group
        .text("format")?
        .map(|name| {
            Format::from_name(&name).ok_or_else(|| group.refuse("format", "is no format of tables", "use csv, parquet or ipc"))
        })
        .transpose()?;
    let separator = group
        .text("separator")?
        .map(|text| match text.as_str() {
            " " => Ok(Separator::Blanks),
            "\\t" => Ok(Separator::Char('\t')),
            other => match other.chars().collect::<Vec<char>>()[..] {
                [c] if c != '"' && !c.is_alphanumeric() => Ok(Separator::Char(c)),
                _ => Err(group.refuse(
                    "separator",
                    "must be one character",
                    "write \";\", \",\", \"\\t\", \"|\" or \" \" for any number of blanks",
                )),
            },
        })
        .transpose()?;
    let decimal_comma = match group.text("decimal")?.as_deref() {
        None | Some(".") => false,
        Some(",") => true,
        Some(_) => return Err(group.refuse("decimal", "must be a point or a comma", "write \".\" or \",\"")),
    };
    if decimal_comma && separator == Some(Separator::Char(',')) {
        return Err(group.refuse("separator", "is the same as the decimal comma", "correct `separator` or `decimal`"));
    }
    let latin_1 = match group.text("encoding")?.map(|t| t.to_ascii_lowercase()).as_deref() {
        None | Some("utf-8" | "utf8") => false,
        Some("latin-1" | "latin1" | "iso-8859-1") => true,
        Some(_) => return Err(group.refuse("encoding", "is not known", "use utf-8 or latin-1, or convert the file with iconv")),
    };
    let skip_rows = group.whole("skip_rows")?.unwrap_or(0) as usize;
    Ok((format, Dialect { separator, decimal_comma, skip_rows, latin_1 }))
}

/// A text, or the column of it.
fn given(group: &Group, key: &str) -> Result<Option<Given<String>>, Finding> {
    match group.group(key) {
        Ok(Some(inner)) => Ok(Some(Given::Column(inner.text("column")?.ok_or_else(|| missing(&inner, "column"))?))),
        Ok(None) => Ok(None),
        Err(_) => Ok(group.text(key)?.map(Given::Value)),
    }
}

fn run_keys(group: Option<&Group>, findings: &mut Vec<Finding>) -> Result<RunKeys, Finding> {
    let Some(group) = group else { return Ok(RunKeys::default()) };
    findings.extend(group.unknown(&[
        "kind",
        "sensor",
        "mode",
        "configuration",
        "field_source",
        "start",
        "position",
        "sample_rate",
        "unit",
        "nominal_factor",
        "coil_correction",
        "earthfield_compensation",
        "split_gap_s",
        "split_column",
    ]));
    let kind = given(group, "kind")?;
    if let Some(Given::Value(name)) = &kind {
        let names: Vec<&str> = Kind::NAMES.iter().filter(|(k, _)| *k != Kind::Scalar).map(|(_, name)| *name).collect();
        if !names.contains(&name.as_str()) {
            return Err(group.refuse(
                "kind",
                "is not a kind of run that is imported",
                &format!("use one of {}", names.join(", ")),
            ));
        }
    }
    let position = match group.group("position") {
        Ok(Some(inner)) => Some(Given::Column(inner.text("column")?.ok_or_else(|| missing(&inner, "column"))?)),
        Ok(None) => None,
        Err(_) => group.whole("position")?.map(Given::Value),
    };
    Ok(RunKeys {
        kind,
        sensor: given(group, "sensor")?,
        mode: given(group, "mode")?,
        configuration: given(group, "configuration")?,
        field_source: given(group, "field_source")?,
        start: given(group, "start")?,
        position,
        sample_rate_hz: positive(group, "sample_rate")?,
        coil_correction: group.truth("coil_correction")?,
        earthfield_compensation: group.texts("earthfield_compensation")?.unwrap_or_default(),
        split_gap_s: positive(group, "split_gap_s")?,
        split_column: group.text("split_column")?,
    })
}

fn reading_scale(run: Option<&Group>) -> Result<ReadingScale, Finding> {
    let Some(run) = run else { return Ok(ReadingScale::Ent(1.0)) };
    let factor = positive(run, "nominal_factor")?;
    match (run.text("unit")?.as_deref(), factor) {
        (Some("counts"), Some(factor)) => Ok(ReadingScale::Counts(factor)),
        (Some("counts"), None) => {
            Err(run.refuse("unit", "needs `nominal_factor`, enT per count", "add `nominal_factor` under [run]"))
        }
        (_, Some(_)) => Err(run.refuse("nominal_factor", "goes with `unit = \"counts\"` only", "correct `unit`, or take it out")),
        (None | Some("nT" | "enT"), None) => Ok(ReadingScale::Ent(1.0)),
        (Some("uT" | "µT" | "μT"), None) => Ok(ReadingScale::Ent(1000.0)),
        (Some(_), None) => {
            Err(run.refuse("unit", "is not a unit of readings", "use \"nT\", \"uT\", or \"counts\" with `nominal_factor`"))
        }
    }
}

fn time_keys(group: &Group, findings: &mut Vec<Finding>) -> Result<TimeKeys, Finding> {
    findings.extend(group.unknown(&["column", "date", "format", "zone", "counter"]));
    let format = group
        .text("format")?
        .map(|name| {
            let remedy = "use seconds, unix, unix_ms, iso8601, or a pattern such as \"%d.%m.%Y %H:%M:%S\"";
            TimeFormat::from_name(&name).ok_or_else(|| group.refuse("format", "is no format of times", remedy))
        })
        .transpose()?;
    let zone = match group.text("zone")? {
        None => Zone::utc(),
        Some(name) => Zone::from_name(&name).ok_or_else(|| {
            let remedy =
                "write \"UTC\", \"+02:00\", or a name of the time zone database of this computer such as \"Europe/Berlin\"";
            group.refuse("zone", "is not a known zone", remedy)
        })?,
    };
    let column = group.text("column")?.ok_or_else(|| missing(group, "column"))?;
    Ok(TimeKeys { column, date: group.text("date")?, format, zone, counter: group.text("counter")? })
}

fn field_keys(group: &Group, findings: &mut Vec<Finding>) -> Result<FieldKeys, Finding> {
    findings.extend(group.unknown(&["columns", "unit", "nt_per_a", "same_setting_within_nt", "frequency", "table"]));
    let per_ampere = group.three("nt_per_a")?;
    let scale = match (group.text("unit")?.as_deref(), per_ampere) {
        (Some("A"), Some(each)) => FieldScale::Current(each),
        (Some("A"), None) => {
            return Err(group.refuse("unit", "needs `nt_per_a`", "add `nt_per_a = [x, y, z]`, nT per ampere of every coil axis"));
        }
        (_, Some(_)) => return Err(group.refuse("nt_per_a", "goes with `unit = \"A\"` only", "correct `unit`, or take it out")),
        (None | Some("nT"), None) => FieldScale::Same(1.0),
        (Some("uT" | "µT" | "μT"), None) => FieldScale::Same(1000.0),
        (Some(_), None) => {
            return Err(group.refuse("unit", "is not a unit of fields", "use \"nT\", \"uT\", or \"A\" with `nt_per_a`"));
        }
    };
    let same = group.number("same_setting_within_nt")?.unwrap_or(SAME_SETTING_NT);
    if same < 0.0 {
        return Err(group.refuse(
            "same_setting_within_nt",
            "must not be negative",
            "write 0 where settings are written as they were asked for",
        ));
    }
    let (columns, table) = (three(group, "columns")?, group.text("table")?.map(PathBuf::from));
    if columns.is_none() && table.is_none() {
        return Err(missing(group, "columns"));
    }
    Ok(FieldKeys { columns, scale, same_setting_within_nt: same, frequency: group.text("frequency")?, table })
}

/// Settings that differ by less are one, unless the mapping says something else, nT: less than steps, more than the noise of a source.
pub const SAME_SETTING_NT: f64 = 0.5;

fn channels(group: Option<Group>, temperatures: bool) -> Result<Vec<ChannelKeys>, Finding> {
    let Some(group) = group else { return Ok(Vec::new()) };
    let mut list = Vec::new();
    for name in group.names() {
        if name == "t" || name.contains([',', '\n', '\r', '"']) || name.trim() != name || name.is_empty() {
            return Err(group.refuse(name, "is no name for a channel", "use letters, digits and `_`, and not `t` alone"));
        }
        let (column, unit) = match group.group(name) {
            Ok(Some(inner)) => (inner.text("column")?.ok_or_else(|| missing(&inner, "column"))?, inner.text("unit")?),
            _ => (group.text(name)?.unwrap_or_default(), None),
        };
        let unit = match unit.as_deref() {
            None => TemperatureUnit::Celsius,
            Some(_) if !temperatures => {
                return Err(group.refuse(name, "has a unit, which other channels than temperatures have not", "take `unit` out"));
            }
            Some("degC" | "°C" | "C") => TemperatureUnit::Celsius,
            Some("K") => TemperatureUnit::Kelvin,
            Some("degF" | "°F" | "F") => TemperatureUnit::Fahrenheit,
            Some(_) => {
                return Err(group.refuse(name, "has a unit that is none of temperatures", "use \"degC\", \"K\" or \"degF\""));
            }
        };
        list.push(ChannelKeys { name: name.to_owned(), column, unit });
    }
    Ok(list)
}

fn rows_keys(group: Option<Group>, findings: &mut Vec<Finding>) -> Result<RowsAre, Finding> {
    let Some(group) = group else { return Ok(RowsAre::Samples) };
    findings.extend(group.unknown(&["are", "t_start", "t_end"]));
    let (t_start, t_end) = (group.text("t_start")?, group.text("t_end")?);
    match group.text("are")?.as_deref() {
        None | Some("samples") => match (t_start, t_end) {
            (None, None) => Ok(RowsAre::Samples),
            (Some(_), _) => Err(group.refuse("t_start", "goes with plateaus only", "set `are = \"plateaus\"`, or take it out")),
            (None, Some(_)) => Err(group.refuse("t_end", "goes with plateaus only", "set `are = \"plateaus\"`, or take it out")),
        },
        Some("plateaus") => Ok(RowsAre::Plateaus { t_start, t_end }),
        Some(_) => Err(group.refuse("are", "is not known", "use \"samples\" or \"plateaus\"")),
    }
}
