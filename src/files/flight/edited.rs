//! EDITED telemetry: signed counts with time tags, thermistor counts, quality and mode (RO-IGEP-TR0028 section 4.1.2).

use super::mission::{Counts, Mission, Sensor};
use super::times::TimeColumn;
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, SECOND_NS, Tt2000, day_of};
use crate::files::source::{Digested, digest};
use crate::files::table::series::{SeriesTable, Words};
use crate::files::table::stream::{Format, Reader};
use jiff::civil::Date;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Shifts move vectors by so much at most, so that a day is read so far beyond its ends, ns.
pub const BEYOND_NS: i64 = 1800 * SECOND_NS;

/// One file of telemetry.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct EditedFile {
    /// Day of its partition, counted from 1970-01-01; absent for a file that stands in none.
    pub day: Option<i32>,
    /// The file.
    pub path: PathBuf,
}

/// The files of telemetry by sensor, those of a day in the order of their names.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Catalogue {
    sensors: BTreeMap<String, Vec<EditedFile>>,
}

/// Rows of one file, in its order.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Rows {
    /// Time tags.
    pub tag: Vec<Tt2000>,
    /// The clock of the spacecraft, s since 2003.
    pub obt_s: Vec<f64>,
    /// Counts along the three axes.
    pub counts: [Vec<f64>; 3],
    /// Counts of the thermistor.
    pub thermistor: Vec<f64>,
    /// Quality bits.
    pub quality: Vec<u8>,
    /// Index of the mode in the mission.
    pub mode: Vec<u8>,
    /// Range index.
    pub range: Vec<u8>,
    /// Whether the sensor has telemetry before all that was asked for.
    pub is_continued: bool,
}

impl Rows {
    /// Those with time tags in a stretch.
    #[must_use]
    pub fn within(&self, tags: &std::ops::Range<Tt2000>) -> Rows {
        let kept: Vec<usize> = (0..self.tag.len()).filter(|row| tags.contains(&self.tag[*row])).collect();
        fn pick<T: Copy>(list: &[T], kept: &[usize]) -> Vec<T> {
            kept.iter().map(|row| list[*row]).collect()
        }
        Rows {
            tag: pick(&self.tag, &kept),
            obt_s: pick(&self.obt_s, &kept),
            counts: self.counts.each_ref().map(|c| pick(c, &kept)),
            thermistor: pick(&self.thermistor, &kept),
            quality: pick(&self.quality, &kept),
            mode: pick(&self.mode, &kept),
            range: pick(&self.range, &kept),
            is_continued: self.is_continued || self.tag.iter().any(|tag| *tag < tags.start),
        }
    }

    /// The same with further rows behind them.
    pub fn append(&mut self, mut other: Rows) {
        if self.tag.is_empty() {
            other.is_continued |= self.is_continued;
            *self = other;
            return;
        }
        self.is_continued |= other.is_continued;
        self.tag.append(&mut other.tag);
        self.obt_s.append(&mut other.obt_s);
        self.counts.iter_mut().zip(&mut other.counts).for_each(|(own, more)| own.append(more));
        self.thermistor.append(&mut other.thermistor);
        self.quality.append(&mut other.quality);
        self.mode.append(&mut other.mode);
        self.range.append(&mut other.range);
    }
}

/// Unsigned counts of 16 bits.
const THERMISTOR_COUNTS: std::ops::RangeInclusive<f64> = 0.0..=65_535.0;

fn is_table(path: &Path) -> bool {
    path.extension().is_some_and(|end| ["parquet", "pq", "csv"].iter().any(|known| end.eq_ignore_ascii_case(known)))
}

fn listed(folder: &Path) -> Result<Vec<PathBuf>, Finding> {
    let entries = std::fs::read_dir(folder).map_err(|e| Finding::io(folder, "list the folder", &e))?;
    let mut paths: Vec<PathBuf> = entries
        .map(|entry| entry.map(|e| e.path()).map_err(|e| Finding::io(folder, "list the folder", &e)))
        .collect::<Result<_, _>>()?;
    // Temporary files and marks of other programs begin so.
    paths.retain(|path| path.file_name().is_some_and(|n| !n.to_string_lossy().starts_with(['.', '_'])));
    paths.sort_unstable();
    Ok(paths)
}

fn partition<'a>(path: &'a Path, key: &str) -> Option<&'a str> {
    path.file_name()?.to_str()?.strip_prefix(key)?.strip_prefix('=')
}

/// The day of a folder `date=YYYY-MM-DD`.
fn partition_day(path: &Path) -> Result<Option<i32>, Finding> {
    let Some(date) = partition(path, "date") else { return Ok(None) };
    let parsed: Result<Date, _> = date.parse();
    parsed
        .map(|date| Some(day_of(date)))
        .map_err(|_| Finding::error(&path.display().to_string(), "the partition is no date", "name it date=YYYY-MM-DD"))
}

/// The files of tables in the partitions of days of a folder.
///
/// # Errors
/// A folder that cannot be listed, a partition that is no date.
pub fn day_files(folder: &Path) -> Result<Vec<EditedFile>, Finding> {
    let mut files = Vec::new();
    for path in listed(folder)? {
        if path.is_dir() {
            let Some(day) = partition_day(&path)? else {
                let rule = "is no partition of a day, so that nothing in it is read";
                return Err(Finding::error(&path.display().to_string(), rule, "name it date=YYYY-MM-DD, or take it away"));
            };
            for table in listed(&path)? {
                if !is_table(&table) {
                    let rule = "is no table of telemetry, Parquet or CSV";
                    return Err(Finding::error(&table.display().to_string(), rule, "convert it, or take it away"));
                }
                files.push(EditedFile { day: Some(day), path: table });
            }
        } else if is_table(&path) {
            files.push(EditedFile { day: None, path });
        }
    }
    files.sort_unstable();
    Ok(files)
}

impl Catalogue {
    /// Lists the telemetry of a mission; a file that tells no sensor by its place or its columns is of the one `asked` for.
    ///
    /// # Errors
    /// A folder that cannot be listed, a partition that is no date or of no sensor, a file that does not tell its sensor.
    pub fn open(mission: &Mission, asked: Option<&str>) -> Result<Self, Finding> {
        let mut catalogue = Self::default();
        for path in listed(&mission.input)? {
            if path.is_dir() {
                let Some(name) = partition(&path, "sensor") else {
                    let rule = "is no partition of a sensor, so that nothing in it is read";
                    return Err(Finding::error(&path.display().to_string(), rule, "name it sensor=NAME, or take it away"));
                };
                let Some(sensor) = mission.sensors.iter().find(|s| s.name == name) else {
                    let rule = format!("holds telemetry of sensor {name}, which is none of the configuration");
                    return Err(Finding::error(
                        &path.display().to_string(),
                        rule,
                        "add it as [[sensor]], or take the folder away",
                    ));
                };
                catalogue.sensors.entry(sensor.name.clone()).or_default().extend(day_files(&path)?);
            } else if is_table(&path) {
                let name = sensor_of(&path, mission, asked)?;
                catalogue.sensors.entry(name).or_default().push(EditedFile { day: None, path });
            }
        }
        Ok(catalogue)
    }

    /// The files of a sensor.
    #[must_use]
    pub fn of(&self, sensor: &str) -> &[EditedFile] {
        self.sensors.get(sensor).map_or(&[], Vec::as_slice)
    }
}

/// Names without case, with `_` for `.`.
#[must_use]
pub fn plain(name: &str) -> String {
    name.to_lowercase().replace('.', "_")
}

/// The sensor of a file that stands in no partition, by the ends of the names of its columns, `BX_OB`, or else the one that is asked
/// for.
fn sensor_of(path: &Path, mission: &Mission, asked: Option<&str>) -> Result<String, Finding> {
    let names: Vec<String> = SeriesTable::open(path)?.names().iter().map(|n| plain(n)).collect();
    let has = |sensor: &&Sensor| names.contains(&format!("bx_{}", sensor.name.to_lowercase()));
    let mut found = mission.sensors.iter().filter(has);
    match (found.next(), found.next(), mission.sensors.as_slice()) {
        (Some(sensor), None, _) | (None, None, [sensor]) => Ok(sensor.name.clone()),
        (None, None, sensors) if sensors.iter().any(|sensor| asked == Some(sensor.name.as_str())) => {
            Ok(asked.unwrap_or_default().to_owned())
        }
        _ => {
            let rule = "does not tell of which sensor it is";
            Err(Finding::error(
                &path.display().to_string(),
                rule,
                "move it to sensor=NAME/date=YYYY-MM-DD, name a column BX_NAME, or name the sensor with --sensor",
            ))
        }
    }
}

/// A file of telemetry that is open.
struct Open<'a> {
    table: SeriesTable,
    /// The names of the table by their plain form.
    names: BTreeMap<String, String>,
    path: &'a Path,
    leap: &'a LeapSeconds,
}

/// The column of a name among names by their plain form, with the name of the sensor behind it or without.
fn column_of<'a>(names: &'a BTreeMap<String, String>, name: &str, sensor: &Sensor) -> Option<&'a str> {
    let suffixed = format!("{name}_{}", sensor.name.to_lowercase());
    names.get(name).or_else(|| names.get(&suffixed)).map(String::as_str)
}

/// That a table has no column of a name among those that it has.
pub fn lacks<'a>(path: &Path, name: &str, names: impl Iterator<Item = &'a String>) -> Finding {
    let list: Vec<&str> = names.map(String::as_str).collect();
    let rule = format!("has no column `{name}`; it has {}", list.join(", "));
    Finding::error(&path.display().to_string(), rule, "rename the column, or name another one")
}

/// The names of the columns of a table by their plain form; rows are not decoded.
///
/// # Errors
/// A file that cannot be read or is no table of the format that its name tells.
pub fn columns(path: &Path) -> Result<BTreeMap<String, String>, Finding> {
    let names = match Format::of_name(path) {
        Some(Format::Csv) => Reader::open(path)?.next_batch()?.map(|batch| batch.names()).unwrap_or_default(),
        _ => SeriesTable::open(path)?.names(),
    };
    Ok(names.into_iter().map(|name| (plain(&name), name)).collect())
}

/// Checks that a file of telemetry has the columns without which none of its vectors can be made; no vectors are read.
///
/// # Errors
/// A file that is no table; the first column that it lacks.
pub fn check_columns(file: &EditedFile, sensor: &Sensor, mission: &Mission) -> Result<(), Finding> {
    let names = columns(&file.path)?;
    let lacks = |name: &str| lacks(&file.path, name, names.values());
    let times: Vec<&str> = match mission.time_rule.primary {
        Some(column) => vec![column.name()],
        None => TimeColumn::ALL.into_iter().map(TimeColumn::name).collect(),
    };
    if !times.iter().any(|name| names.contains_key(*name)) {
        return Err(lacks(&times.join("` or `")));
    }
    let thermistor = plain(&sensor.thermistor_column);
    let needed = ["bx", "by", "bz", "quality"].into_iter().chain((!sensor.ground.is_empty()).then_some(thermistor.as_str()));
    for name in needed {
        column_of(&names, name, sensor).ok_or_else(|| lacks(name))?;
    }
    let has_mode = mission.sid.is_some() || !mission.mode_spans.is_empty();
    if !has_mode && column_of(&names, "sid", sensor).is_none() {
        let rule = "has no column `sid`, and nothing else says the mode of its vectors";
        let remedy = "add the column, or state `from` and `to` in [[mode]], or [edited] sid";
        return Err(Finding::error(&file.path.display().to_string(), rule, remedy));
    }
    Ok(())
}

impl Open<'_> {
    fn column(&self, name: &str, sensor: &Sensor) -> Option<&str> {
        column_of(&self.names, name, sensor)
    }

    fn needed(&self, name: &str, sensor: &Sensor) -> Result<&str, Finding> {
        self.column(name, sensor).ok_or_else(|| lacks(self.path, name, self.table.names().iter()))
    }

    fn refuse(&self, row: usize, rule: &str, remedy: &str) -> Finding {
        let row = self.table.before() + row + 1;
        Finding::error(&self.path.display().to_string(), format!("row {row}: {rule}"), remedy)
    }
}

fn open<'a>(path: &'a Path, leap: &'a LeapSeconds) -> Result<Open<'a>, Finding> {
    let table = SeriesTable::open(path)?;
    let names = table.names().into_iter().map(|name| (plain(&name), name)).collect();
    Ok(Open { table, names, path, leap })
}

/// Reads of a file of a sensor the rows with time tags in some ranges; for each only the groups of rows that they stand in are read.
///
/// # Errors
/// What is wrong with the file, with its row: a column that is missing or of another type, times that contradict each other or lie outside
/// of the day of the partition, counts that the converter does not have, a mode that the mission does not state.
pub fn read<const N: usize>(
    file: &EditedFile,
    sensor: &Sensor,
    mission: &Mission,
    leap: &LeapSeconds,
    wanted: [&std::ops::Range<Tt2000>; N],
) -> Result<[Rows; N], Finding> {
    let mut open = open(&file.path, leap)?;
    let all_tags = mission.time_rule.times(&open.table, &file.path, leap)?;
    if let Some(day) = file.day {
        let span = leap.day(day);
        let inside = span.start - BEYOND_NS..span.end + BEYOND_NS;
        if let Some(row) = all_tags.iter().position(|tag| !inside.contains(tag)) {
            let rule = format!("the time {} is not of the day of the partition", leap.utc(all_tags[row]));
            return Err(open.refuse(row, &rule, "move the vector to its day"));
        }
    }
    let mut found: [Rows; N] = std::array::from_fn(|_| Rows::default());
    for (rows, wanted) in found.iter_mut().zip(wanted) {
        let is_continued = all_tags.iter().any(|tag| *tag < wanted.start);
        rows.is_continued = is_continued;
        let first = all_tags.iter().position(|tag| wanted.contains(tag));
        let last = all_tags.iter().rposition(|tag| wanted.contains(tag));
        let (Some(first), Some(last)) = (first, last) else { continue };
        open.table.narrow(first..last + 1);
        let tags = &all_tags[open.table.before()..open.table.before() + open.table.rows()];
        *rows = Rows { is_continued, ..open.rows(tags, sensor, mission, wanted)? };
    }
    Ok(found)
}

/// The time tags of a file with quality and thermistor counts, for what a day needs of its neighbours.
///
/// # Errors
/// As [`read`].
pub fn read_times(file: &EditedFile, mission: &Mission, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
    mission.time_rule.times(&SeriesTable::open(&file.path)?, &file.path, leap)
}

/// The times of a table beside the telemetry: by the column that counts there or, if the table does not have it, by the first one it has.
///
/// # Errors
/// As [`read`].
pub fn times_beside(path: &Path, mission: &Mission, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
    let table = SeriesTable::open(path)?;
    mission.time_rule.beside(&table).times(&table, path, leap)
}

/// The modes of the rows of a file with time tags in a range, in the order of their first row; of the time tags and modes alone.
///
/// # Errors
/// As [`read`].
pub fn modes_in(
    file: &EditedFile,
    sensor: &Sensor,
    mission: &Mission,
    leap: &LeapSeconds,
    wanted: &std::ops::Range<Tt2000>,
) -> Result<Vec<u8>, Finding> {
    let open = open(&file.path, leap)?;
    let tags = mission.time_rule.times(&open.table, &file.path, leap)?;
    let mut found = Vec::new();
    for (mode, _) in open.modes(&tags, sensor, mission)?.into_iter().zip(&tags).filter(|(_, tag)| wanted.contains(tag)) {
        if found.last() != Some(&mode) && !found.contains(&mode) {
            found.push(mode);
        }
    }
    Ok(found)
}

/// Size and hash of a file.
///
/// # Errors
/// What the operating system says.
pub fn hash(file: &EditedFile) -> Result<Digested, Finding> {
    digest(&file.path)
}

impl Open<'_> {
    fn rows(
        &self,
        tags: &[Tt2000],
        sensor: &Sensor,
        mission: &Mission,
        wanted: &std::ops::Range<Tt2000>,
    ) -> Result<Rows, Finding> {
        let table = &self.table;
        let clock = self.names.get("time_obt").map(|name| table.numbers(name)).transpose()?;
        let names = ["bx", "by", "bz"].map(|name| self.needed(name, sensor));
        let [x, y, z] = names;
        let counts = [table.numbers(x?)?, table.numbers(y?)?, table.numbers(z?)?];
        let thermistor = match self.column(&plain(&sensor.thermistor_column), sensor) {
            Some(name) => table.numbers(name)?,
            None if sensor.ground.is_empty() => vec![f64::NAN; tags.len()],
            None => {
                return Err(self
                    .needed(&plain(&sensor.thermistor_column), sensor)
                    .err()
                    .unwrap_or_else(|| self.refuse(0, "", "")));
            }
        };
        let quality = Some(
            self.small("quality", sensor)?
                .ok_or_else(|| self.needed("quality", sensor).err().unwrap_or_else(|| self.refuse(0, "", "")))?,
        );
        let range = self.small("range", sensor)?;
        let modes = self.modes(tags, sensor, mission)?;
        let [low, high] = sensor.counts.limits();
        let mut rows = Rows::default();
        for row in (0..tags.len()).filter(|row| wanted.contains(&tags[*row])) {
            let vector = [counts[0][row], counts[1][row], counts[2][row]];
            let quality = quality.as_ref().map_or(0, |q| q[row]);
            if let Some(count) = vector.iter().find(|c| !(low..=high).contains(*c))
                && (quality & mission.reject_mask == 0 || count.is_finite())
            {
                let rule = if count.is_nan() {
                    "a count has no value".to_owned()
                } else {
                    format!("the count {count} is none of the converter, {low} to {high}")
                };
                return Err(self.refuse(row, &rule, "correct it, or state the bits of the converter with adc_bits"));
            }
            if quality & mission.reject_mask == 0 && !sensor.ground.is_empty() && !THERMISTOR_COUNTS.contains(&thermistor[row]) {
                let rule = if thermistor[row].is_nan() {
                    "the thermistor count has no value".to_owned()
                } else {
                    format!("the thermistor count {} is none of 16 bits", thermistor[row])
                };
                return Err(self.refuse(row, &rule, "correct it, or reject the vector by its quality"));
            }
            let own_range = range.as_ref().map_or(0, |r| r[row]);
            if let Counts::Factor { ent_per_count, .. } = &sensor.counts
                && ent_per_count.len() > 1
                && usize::from(own_range) >= ent_per_count.len()
            {
                let rule = format!("range {own_range} has no factor");
                return Err(self.refuse(row, &rule, "state one factor per range in ent_per_count, the first for range 0"));
            }
            rows.tag.push(tags[row]);
            #[expect(clippy::cast_precision_loss, reason = "the clock has microseconds")]
            let from_time = || (tags[row] - self.leap.clock_begin()) as f64 / SECOND_NS as f64;
            rows.obt_s.push(clock.as_ref().map_or_else(from_time, |c| c[row]));
            (0..3).for_each(|i| rows.counts[i].push(vector[i]));
            rows.thermistor.push(thermistor[row]);
            rows.quality.push(quality);
            rows.mode.push(modes[row]);
            rows.range.push(own_range);
        }
        Ok(rows)
    }

    /// A column of small whole numbers, if it is there.
    fn small(&self, name: &str, sensor: &Sensor) -> Result<Option<Vec<u8>>, Finding> {
        let Some(column) = self.column(name, sensor) else { return Ok(None) };
        let values = self.table.whole(column)?;
        let byte = |(row, value): (usize, &i64)| {
            let wrong = |_| self.refuse(row, &format!("`{name}` is {value}, not 0 to 255"), "correct it");
            u8::try_from(*value).map_err(wrong)
        };
        values.iter().enumerate().map(byte).collect::<Result<Vec<u8>, _>>().map(Some)
    }

    /// The mode of every row.
    fn modes(&self, tags: &[Tt2000], sensor: &Sensor, mission: &Mission) -> Result<Vec<u8>, Finding> {
        let unknown = |row: usize, sid: &str| {
            let rule = if sid.is_empty() { "its mode is not known".to_owned() } else { format!("its mode {sid} is not stated") };
            self.refuse(row, &rule, "state every mode that occurs as [[mode]]")
        };
        #[expect(clippy::cast_possible_truncation, reason = "a mission has few modes")]
        let index = |sid: &str| mission.mode(sid).map(|mode| mode as u8);
        if let Some(name) = self.column("sid", sensor) {
            let Words { words, codes } = self.table.words(name)?;
            let known: Vec<Option<u8>> = words.iter().map(|word| index(word)).collect();
            let mode = |(row, code): (usize, &u32)| known[*code as usize].ok_or_else(|| unknown(row, &words[*code as usize]));
            return codes.iter().enumerate().map(mode).collect();
        }
        let mode = |(row, tag): (usize, &Tt2000)| {
            let by_time = mission.mode_spans.iter().find(|(span, _)| span.holds(*tag)).map(|(_, sid)| sid);
            by_time.or(mission.sid.as_ref()).and_then(|sid| index(sid)).ok_or_else(|| unknown(row, ""))
        };
        tags.iter().enumerate().map(mode).collect()
    }
}
