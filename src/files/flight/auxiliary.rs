//! Auxiliary tables of flight processing: attitude, positions, wheels, heater states, offsets, calm times.

use super::mission::{Celestial, Jump, OffsetFrame, Span};
use super::times::TimeRule;
use crate::data::error::Finding;
use crate::data::provenance::Input;
use crate::data::time::{LeapSeconds, Tt2000};
use crate::files::source::digest;
use crate::files::table::series::SeriesTable;
use nalgebra::Vector3;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// No wheel turns faster, Hz: ten times the fastest flywheels.
const MOST_HZ: f64 = 1e4;
/// How far the norm of a quaternion may be from 1.
const NORM: f64 = 1e-6;

/// Orientation of the spacecraft over time: unit quaternions (w, x, y, z) from the spacecraft to the celestial frame.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Attitude {
    /// Times, rising.
    pub time: Vec<Tt2000>,
    /// Quaternions.
    pub wxyz: Vec<[f64; 4]>,
}

/// Positions of the spacecraft over time, km.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Positions {
    /// Times, rising.
    pub time: Vec<Tt2000>,
    /// x, y, z, km.
    pub km: Vec<[f64; 3]>,
}

/// Rates of the reaction wheels over time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WheelRates {
    /// Times, rising.
    pub time_tt2000: Vec<Tt2000>,
    /// Rotations per second, wheel by wheel; nan where a rate is not known.
    pub rate_hz: Vec<Vec<f64>>,
}

/// A heater that is on within `[from, to)`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeaterOn {
    /// Switched on.
    pub from_tt2000: Tt2000,
    /// Switched off.
    pub to_tt2000: Tt2000,
    /// Its index among the names of the configuration.
    pub class: usize,
}

fn input(path: &Path) -> Result<Input, Finding> {
    Ok(digest(path)?.input(path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default()))
}

fn refuse(path: &Path, row: usize, rule: &str, remedy: &str) -> Finding {
    Finding::error(&path.display().to_string(), format!("row {}: {rule}", row + 1), remedy)
}

/// The times of the rows that are read, which must rise.
fn times(table: &SeriesTable, path: &Path, rule: TimeRule, leap: &LeapSeconds) -> Result<Vec<Tt2000>, Finding> {
    let time = rule.beside(table).times(table, path, leap)?;
    match time.windows(2).position(|pair| pair[0] >= pair[1]) {
        Some(row) => Err(not_rising(path, table.before() + row + 1)),
        None => Ok(time),
    }
}

fn not_rising(path: &Path, row: usize) -> Finding {
    refuse(path, row, "the times do not rise", "sort the table, and leave repeated rows out")
}

/// Rows of a table over time.
pub trait Timed: Sized {
    /// What the configuration says of the table.
    type Stated;

    /// Reads the rows that a table is narrowed to, whose times are known.
    ///
    /// # Errors
    /// What is wrong with the table, with its row.
    fn read(table: &SeriesTable, time: Vec<Tt2000>, path: &Path, stated: &Self::Stated) -> Result<Self, Finding>;

    /// The times of the rows.
    fn times(&self) -> &[Tt2000];
}

/// A table over time of which only stretches are read: an archive of years is longer than the memory.
#[derive(Debug)]
pub struct Timeline<T: Timed> {
    path: PathBuf,
    stated: T::Stated,
    rule: TimeRule,
    groups: Vec<Group>,
    /// The groups that were read last: the sensors of a day, and the days of a month, lie in the same ones.
    kept: Mutex<Option<(Range<usize>, Arc<T>)>>,
}

/// A group of rows of a table.
#[derive(Clone, Copy, Debug)]
struct Group {
    begin: usize,
    rows: usize,
    first: Tt2000,
    last: Tt2000,
}

/// Rows beside a stretch that interpolation needs on either side.
const MARGIN_ROWS: usize = 2;

impl<T: Timed> Timeline<T> {
    /// Opens a table and looks at all of its rows, group by group.
    ///
    /// # Errors
    /// What is wrong with the table, with its row; a table without rows.
    pub fn open(path: &Path, stated: T::Stated, rule: TimeRule, leap: &LeapSeconds) -> Result<(Self, Input), Finding> {
        let mut table = SeriesTable::open(path)?;
        let mut groups: Vec<Group> = Vec::new();
        let mut begin = 0;
        for rows in table.group_rows() {
            table.narrow(begin..begin + rows);
            let part = T::read(&table, times(&table, path, rule, leap)?, path, &stated)?;
            if let (Some(first), Some(last)) = (part.times().first(), part.times().last()) {
                if groups.last().is_some_and(|group| group.last >= *first) {
                    return Err(not_rising(path, begin));
                }
                groups.push(Group { begin, rows, first: *first, last: *last });
            }
            begin += rows;
        }
        if groups.is_empty() {
            return Err(Finding::error(&path.display().to_string(), "has no rows", "make the table again"));
        }
        Ok((Self { path: path.to_owned(), stated, rule, groups, kept: Mutex::default() }, input(path)?))
    }

    /// The rows of the groups that a stretch lies in, with some beside it.
    ///
    /// # Errors
    /// What the operating system says; what is wrong with a table that was changed since it was opened.
    pub fn over(&self, span: &Range<Tt2000>, leap: &LeapSeconds) -> Result<Arc<T>, Finding> {
        let mut first = self.groups.partition_point(|group| group.last < span.start).min(self.groups.len() - 1);
        let mut behind = self.groups.partition_point(|group| group.first < span.end).max(first + 1);
        let count = |groups: &[Group]| groups.iter().map(|group| group.rows).sum::<usize>();
        let inside = first..behind;
        while first > 0 && count(&self.groups[first..inside.start]) < MARGIN_ROWS {
            first -= 1;
        }
        while behind < self.groups.len() && count(&self.groups[inside.end..behind]) < MARGIN_ROWS {
            behind += 1;
        }
        let wanted = first..behind;
        // Reading may lend this thread to other days, which ask for rows as well: the lock is free while it lasts.
        if let Some((_, rows)) = self.kept().as_ref().filter(|(groups, _)| *groups == wanted) {
            return Ok(Arc::clone(rows));
        }
        let last = self.groups[behind - 1];
        let mut table = SeriesTable::open(&self.path)?;
        table.narrow(self.groups[first].begin..last.begin + last.rows);
        let rows = Arc::new(T::read(&table, times(&table, &self.path, self.rule, leap)?, &self.path, &self.stated)?);
        *self.kept() = Some((wanted, Arc::clone(&rows)));
        Ok(rows)
    }

    /// The file.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// From its first time to behind its last one.
    #[must_use]
    pub fn span(&self) -> Span {
        let (from, last) = self.groups.first().zip(self.groups.last()).map_or((0, 0), |(a, b)| (a.first, b.last));
        Span { from, to: last + 1 }
    }

    fn kept(&self) -> MutexGuard<'_, Option<(Range<usize>, Arc<T>)>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Timed for Attitude {
    type Stated = Celestial;

    fn read(table: &SeriesTable, time: Vec<Tt2000>, path: &Path, celestial: &Celestial) -> Result<Self, Finding> {
        for (key, stated) in [
            ("frame", celestial.frame.as_str()),
            ("attitude_order", if celestial.scalar_first { "scalar-first" } else { "scalar-last" }),
            ("attitude_from_to", if celestial.from_sc { "sc to celestial" } else { "celestial to sc" }),
        ] {
            if let Some(own) = table.says(key).filter(|own| *own != stated) {
                let rule = format!("says `{key}` of itself as `{own}`, the configuration as `{stated}`");
                return Err(Finding::error(&path.display().to_string(), rule, "correct the one that is wrong"));
            }
        }
        let q = [table.numbers("q0")?, table.numbers("q1")?, table.numbers("q2")?, table.numbers("q3")?];
        let mut wxyz = Vec::with_capacity(time.len());
        for row in 0..time.len() {
            let stated = [q[0][row], q[1][row], q[2][row], q[3][row]];
            let norm = stated.iter().map(|v| v * v).sum::<f64>().sqrt();
            if norm.is_nan() || (norm - 1.0).abs() > NORM {
                let rule = format!("the quaternion has the length {norm:.6}, not 1");
                return Err(refuse(path, table.before() + row, &rule, "check the columns q0 to q3"));
            }
            let [w, x, y, z] = if celestial.scalar_first { stated } else { [stated[3], stated[0], stated[1], stated[2]] };
            // The inverse of a rotation is the conjugate.
            wxyz.push(if celestial.from_sc { [w, x, y, z] } else { [w, -x, -y, -z] });
        }
        Ok(Attitude { time, wxyz })
    }

    fn times(&self) -> &[Tt2000] {
        &self.time
    }
}

/// Refuses a table that says of itself that it is of another frame than the attitude.
fn is_of_frame(table: &SeriesTable, path: &Path, frame: &str, remedy: &str) -> Result<(), Finding> {
    match table.says("frame").filter(|own| *own != frame) {
        Some(own) => {
            let rule = format!("is of the frame {own}, the attitude of the configuration of {frame}");
            Err(Finding::error(&path.display().to_string(), rule, remedy))
        }
        None => Ok(()),
    }
}

impl Timed for Positions {
    /// The frame.
    type Stated = String;

    fn read(table: &SeriesTable, time: Vec<Tt2000>, path: &Path, frame: &String) -> Result<Self, Finding> {
        is_of_frame(table, path, frame, "take positions of the same frame")?;
        let [x, y, z] = [table.numbers("x_km")?, table.numbers("y_km")?, table.numbers("z_km")?];
        if let Some(row) = (0..time.len()).find(|row| ![x[*row], y[*row], z[*row]].iter().all(|v| v.is_finite())) {
            return Err(refuse(path, table.before() + row, "the position has no value", "leave the row out"));
        }
        let km = (0..time.len()).map(|row| [x[row], y[row], z[row]]).collect();
        Ok(Positions { time, km })
    }

    fn times(&self) -> &[Tt2000] {
        &self.time
    }
}

/// Every column whose name ends in `_hz` is a wheel.
impl Timed for WheelRates {
    type Stated = ();

    fn read(table: &SeriesTable, time: Vec<Tt2000>, path: &Path, (): &()) -> Result<Self, Finding> {
        let names: Vec<String> = table.names().into_iter().filter(|name| name.to_lowercase().ends_with("_hz")).collect();
        if names.is_empty() {
            let rule = "has no column of wheel rates";
            return Err(Finding::error(&path.display().to_string(), rule, "name them w1_hz, w2_hz, …, in rotations per second"));
        }
        let rate_hz: Vec<Vec<f64>> = names.iter().map(|name| table.numbers(name)).collect::<Result<_, _>>()?;
        for (name, rates) in names.iter().zip(&rate_hz) {
            if let Some(row) = rates.iter().position(|hz| hz.abs() > MOST_HZ) {
                let rule = format!("{name} = {:e} Hz is no rate of a wheel: none turns faster than {MOST_HZ} Hz", rates[row]);
                return Err(refuse(path, table.before() + row, &rule, "correct it, or take the table again"));
            }
        }
        Ok(WheelRates { time_tt2000: time, rate_hz })
    }

    fn times(&self) -> &[Tt2000] {
        &self.time_tt2000
    }
}

/// The field at the spacecraft by a model, nT, in the celestial frame of the configuration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ModelField {
    /// Times, rising.
    pub time: Vec<Tt2000>,
    /// nT.
    pub field_nt: Vec<[f64; 3]>,
}

impl Timed for ModelField {
    /// The frame.
    type Stated = String;

    fn read(table: &SeriesTable, time: Vec<Tt2000>, path: &Path, frame: &String) -> Result<Self, Finding> {
        is_of_frame(table, path, frame, "take a model of the same frame")?;
        let [x, y, z] = [table.numbers("bx")?, table.numbers("by")?, table.numbers("bz")?];
        if let Some(row) = (0..time.len()).find(|row| ![x[*row], y[*row], z[*row]].iter().all(|v| v.is_finite())) {
            return Err(refuse(path, table.before() + row, "the field has no value", "leave the row out"));
        }
        let field_nt = (0..time.len()).map(|row| [x[row], y[row], z[row]]).collect();
        Ok(ModelField { time, field_nt })
    }

    fn times(&self) -> &[Tt2000] {
        &self.time
    }
}

/// Begins and ends of the intervals of a table, `from_tt2000` and `to_tt2000` or `from` and `to`.
fn intervals(table: &SeriesTable, path: &Path, rule: TimeRule, leap: &LeapSeconds) -> Result<Vec<Span>, Finding> {
    let (from, to) = (rule.ends(table, "from", path, leap)?, rule.ends(table, "to", path, leap)?);
    if let Some(row) = (0..from.len()).find(|row| from[*row] >= to[*row]) {
        return Err(refuse(path, row, "the interval ends before it begins", "correct it"));
    }
    Ok(from.into_iter().zip(to).map(|(from, to)| Span { from, to }).collect())
}

/// Reads a table of calm times.
///
/// # Errors
/// What is wrong with the table, with its row; a table without rows.
pub fn calm(path: &Path, rule: TimeRule, leap: &LeapSeconds) -> Result<(Vec<Span>, Input), Finding> {
    let spans = intervals(&SeriesTable::open(path)?, path, rule, leap)?;
    if spans.is_empty() {
        return Err(Finding::error(&path.display().to_string(), "has no rows", "name the calm times, or leave --calm out"));
    }
    Ok((spans, input(path)?))
}

/// Reads the offsets of a sensor, to be subtracted in a frame, of a table with `from`, `to`, `x_nt`, `y_nt`, `z_nt` and, if it has them, `sensor`
/// and `range`. A row without range holds for all of them.
///
/// # Errors
/// What is wrong with the table, with its row: an interval that ends before it begins, a component that is no number, a range that is none, no
/// row of the sensor.
pub fn offsets(
    path: &Path,
    sensor: &str,
    frame: OffsetFrame,
    rule: TimeRule,
    leap: &LeapSeconds,
) -> Result<(Vec<Jump>, Input), Finding> {
    let table = SeriesTable::open(path)?;
    let names = table.names();
    let spans = intervals(&table, path, rule, leap)?;
    let has = |name: &str| names.iter().any(|n| n == name);
    let sensors = if has("sensor") { Some(table.words("sensor")?) } else { None };
    let ranges = if has("range") { Some(table.numbers("range")?) } else { None };
    let [x, y, z] = ["x_nt", "y_nt", "z_nt"].map(|name| table.numbers(name));
    let columns = [x?, y?, z?];
    let mut list = Vec::new();
    for (row, span) in spans.into_iter().enumerate() {
        if sensors.as_ref().is_some_and(|s| s.words[s.codes[row] as usize] != sensor) {
            continue;
        }
        let subtract_nt = Vector3::from(columns.each_ref().map(|c| c[row]));
        if !subtract_nt.iter().all(|v| v.is_finite()) {
            return Err(refuse(path, row, "has an offset that is no number", "correct it, or take the row out"));
        }
        let range = match ranges.as_ref().map(|r| r[row]).filter(|r| !r.is_nan()) {
            None => None,
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "looked at before")]
            Some(range) if (0.0..=255.0).contains(&range) && range.fract() == 0.0 => Some(range as u8),
            Some(range) => return Err(refuse(path, row, &format!("`range` is {range}, not 0 to 255"), "correct it")),
        };
        list.push(Jump { span, range, frame, subtract_nt });
    }
    if list.is_empty() {
        let rule = format!("has no row of sensor {sensor}");
        return Err(Finding::error(
            &path.display().to_string(),
            rule,
            "name the sensor as the configuration does, or leave `offsets` out",
        ));
    }
    Ok((list, input(path)?))
}

/// Reads a table of heater states.
///
/// # Errors
/// What is wrong with the table, with its row: an interval that ends before it begins, a class that the configuration does not name, two rows of a
/// heater for the same moment; a table without rows.
pub fn heater(path: &Path, classes: &[String], rule: TimeRule, leap: &LeapSeconds) -> Result<(Vec<HeaterOn>, Input), Finding> {
    let table = SeriesTable::open(path)?;
    let spans = intervals(&table, path, rule, leap)?;
    let words = table.words("cls")?;
    let mut list = Vec::with_capacity(spans.len());
    for (row, span) in spans.iter().enumerate() {
        let word = &words.words[words.codes[row] as usize];
        let Some(class) = classes.iter().position(|class| class == word) else {
            let remedy = "name all heaters in [heater] classes";
            return Err(refuse(path, row, &format!("the heater {word} is none of {}", classes.join(", ")), remedy));
        };
        list.push(HeaterOn { from_tt2000: span.from, to_tt2000: span.to, class });
    }
    if list.is_empty() {
        let remedy = "make the table again, or leave it out: heaters are then found in the field";
        return Err(Finding::error(&path.display().to_string(), "has no rows", remedy));
    }
    let mut order: Vec<usize> = (0..list.len()).collect();
    order.sort_by_key(|row| (list[*row].class, list[*row].from_tt2000));
    let is_double = |pair: &&[usize]| {
        let [first, second] = [list[pair[0]], list[pair[1]]];
        first.class == second.class && second.from_tt2000 < first.to_tt2000
    };
    if let Some(pair) = order.windows(2).find(is_double) {
        let (name, other) = (&classes[list[pair[0]].class], pair[0] + 1);
        let rule = format!("the heater {name} is on in row {other} and in this one at the same time");
        return Err(refuse(path, pair[1], &rule, "a heater has one row for every time that it is on: correct the table"));
    }
    Ok((list, input(path)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::time::SECOND_NS;
    use crate::files::table::long::{Column, LongWriter};

    #[test]
    fn groups_of_rows_are_read_once_and_those_of_another_stretch_anew() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("positions.parquet");
        // Three groups of four rows, a row a second.
        let (time, km): (Vec<i64>, Vec<f64>) = (0..12).map(|k| (i64::from(k) * SECOND_NS, f64::from(k))).unzip();
        let part = |begin: usize| {
            let km = Column::Numbers(&km[begin..begin + 4]);
            [("time_tt2000", Column::Whole(&time[begin..begin + 4])), ("x_km", km), ("y_km", km), ("z_km", km)]
        };
        let mut file = std::fs::File::create(&path).unwrap();
        let mut writer = LongWriter::new(&mut file, &part(0), Vec::new()).unwrap();
        [0, 4, 8].into_iter().for_each(|begin| writer.write(&part(begin)).unwrap());
        writer.finish().unwrap();

        let leap = LeapSeconds::default();
        let (table, _) = Timeline::<Positions>::open(&path, "ECLIPJ2000".to_owned(), TimeRule::default(), &leap).unwrap();
        let over = |from: i64, to: i64| table.over(&(from * SECOND_NS..to * SECOND_NS), &leap).unwrap();
        let seconds = |rows: &Positions| rows.time.iter().map(|t| t / SECOND_NS).collect::<Vec<i64>>();
        let first = over(1, 2);
        // With the group beside it, for interpolation at its end.
        assert_eq!(seconds(&first), (0..8).collect::<Vec<i64>>());
        assert!(Arc::ptr_eq(&first, &over(2, 3)), "the same groups are read again");
        let last = over(10, 11);
        assert_eq!(seconds(&last), (4..12).collect::<Vec<i64>>());
        assert_eq!(last.km[7], [11.0; 3]);
        assert_eq!(*over(1, 2), *first);
    }

    fn written(path: &Path, columns: &[(&str, Column<'_>)], rows: usize) {
        let mut file = std::fs::File::create(path).unwrap();
        let mut writer = LongWriter::new(&mut file, columns, Vec::new()).unwrap();
        if rows > 0 {
            writer.write(columns).unwrap();
        }
        writer.finish().unwrap();
    }

    #[test]
    fn tables_whose_times_contradict_each_other_are_refused_with_the_row() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wheels.parquet");
        let leap = LeapSeconds::default();
        let time: Vec<i64> = (0..3).map(|k| k * SECOND_NS).collect();
        let rule = TimeRule { tolerance_ns: 1_000_000, ..TimeRule::default() };
        for (late_ns, agrees) in [(900_000, true), (1_100_000, false)] {
            let stamp = |(k, t): (usize, &i64)| leap.utc(*t).timestamp_ns() + if k == 1 { late_ns } else { 0 };
            let utc: Vec<i64> = time.iter().enumerate().map(stamp).collect();
            let columns = [
                ("time_tt2000", Column::Whole(&time)),
                ("time_utc", Column::Timestamps(&utc)),
                ("w1_hz", Column::Numbers(&[20.0; 3])),
            ];
            written(&path, &columns, 3);
            let opened = Timeline::<WheelRates>::open(&path, (), rule, &leap);
            assert_eq!(opened.is_ok(), agrees, "{late_ns}");
            if let Err(finding) = opened {
                assert!(finding.to_string().contains("row 2: `time_tt2000` says"), "{finding}");
            }
        }
    }

    #[test]
    fn rates_that_no_wheel_has_are_refused_with_the_row() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("wheels.parquet");
        let leap = LeapSeconds::default();
        let time: Vec<i64> = (0..3).map(|k| k * SECOND_NS).collect();
        let read = |hz: f64| {
            let columns = [("time_tt2000", Column::Whole(&time)), ("w1_hz", Column::Numbers(&[20.0, hz, 20.0]))];
            written(&path, &columns, 3);
            let table = Timeline::<WheelRates>::open(&path, (), TimeRule::default(), &leap).map_err(|e| e.to_string());
            table.and_then(|(table, _)| table.over(&(0..3 * SECOND_NS), &leap).map_err(|e| e.to_string()).map(|_| ()))
        };
        assert_eq!(read(-9e3), Ok(()));
        for hz in [1e308, -2e4, f64::INFINITY] {
            let told = read(hz).unwrap_err();
            assert!(told.contains("row 2: w1_hz = ") && told.contains("is no rate of a wheel"), "{told}");
        }
    }

    #[test]
    fn a_heater_is_on_once_at_a_time() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("heaters.parquet");
        let (leap, classes) = (LeapSeconds::default(), ["h1".to_owned(), "h2".to_owned()]);
        let of = |rows: &[(i64, i64, u8)]| {
            let column = |of: fn(&(i64, i64, u8)) -> i64| rows.iter().map(of).collect::<Vec<i64>>();
            let (from, to) = (column(|row| row.0 * SECOND_NS), column(|row| row.1 * SECOND_NS));
            let codes: Vec<u8> = rows.iter().map(|row| row.2).collect();
            let columns = [
                ("from_tt2000", Column::Whole(&from)),
                ("to_tt2000", Column::Whole(&to)),
                ("cls", Column::Words(&codes, &classes)),
            ];
            written(&path, &columns, rows.len());
            heater(&path, &classes, TimeRule::default(), &leap).map(|(list, _)| list.len()).map_err(|finding| finding.to_string())
        };
        // Two heaters at once, and one that is switched on when it is switched off.
        assert_eq!(of(&[(20, 30, 0), (10, 20, 0), (15, 25, 1)]), Ok(3));
        let told = of(&[(10, 20, 0), (15, 25, 1), (18, 22, 0)]).unwrap_err();
        assert!(told.contains("row 3: the heater h1 is on in row 1 and in this one at the same time"), "{told}");
        assert!(of(&[]).unwrap_err().contains("has no rows"));
    }
}
