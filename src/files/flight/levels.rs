//! Levels as Parquet, `level=A/sensor=OB/date=YYYY-MM-DD/calfit-A-OB-YYYYMMDD.parquet`.

use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, Tt2000, date_of};
use crate::files::output::{Folder, Pending};
use crate::files::table::long::{Column, Encoded, LongWriter};
use std::borrow::Cow;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// A group of rows of a level.
#[derive(Clone, Debug, Default)]
pub struct LevelRows<'a> {
    /// Corrected times.
    pub time: Cow<'a, [Tt2000]>,
    /// Clock of the spacecraft, s since 2003.
    pub obt_s: Cow<'a, [f64]>,
    /// nT; nan is null.
    pub field_nt: [Cow<'a, [f64]>; 3],
    /// Sensor temperature, °C; in levels that have it.
    pub t_degc: Option<Cow<'a, [f64]>>,
    /// Position, km; in levels that have it.
    pub position_km: Option<[Vec<f64>; 3]>,
    /// Modes.
    pub mode: Cow<'a, [u8]>,
    /// Vectors of a mean; in levels of means.
    pub count: Option<Cow<'a, [u32]>>,
    /// Standard uncertainty, independent from vector to vector, then common, nT.
    pub std_nt: Option<[[Vec<f32>; 3]; 2]>,
    /// Quality as it was read; in levels of single vectors.
    pub quality: Option<Cow<'a, [u8]>>,
    /// Flags.
    pub flags: Cow<'a, [u32]>,
}

/// Columns that the levels of a day mostly share, group by group: encoded once, they stand in all files.
#[derive(Default)]
pub struct Shared {
    groups: Vec<SharedGroup>,
}

/// What a group holds, and its columns as they stand in a file.
#[derive(Default)]
struct SharedGroup {
    time: Vec<Tt2000>,
    obt_s: Vec<f64>,
    t_degc: Vec<f64>,
    mode: Vec<u8>,
    quality: Vec<u8>,
    flags: Vec<u32>,
    columns: BTreeMap<&'static str, Arc<Encoded>>,
}

impl SharedGroup {
    fn of(rows: &LevelRows<'_>) -> Self {
        Self {
            time: rows.time.to_vec(),
            obt_s: rows.obt_s.to_vec(),
            t_degc: rows.t_degc.as_deref().unwrap_or_default().to_vec(),
            mode: rows.mode.to_vec(),
            quality: rows.quality.as_deref().unwrap_or_default().to_vec(),
            flags: rows.flags.to_vec(),
            columns: BTreeMap::new(),
        }
    }

    /// The column of a name, if these rows have the same values.
    fn column(&self, name: &str, rows: &LevelRows<'_>) -> Option<Arc<Encoded>> {
        let known = self.columns.get(name)?;
        let is_same = match name {
            "time_tt2000" | "time_utc" => *self.time == *rows.time,
            "time_obt" => *self.obt_s == *rows.obt_s,
            "t_degc" => rows.t_degc.as_deref().is_some_and(|own| *self.t_degc == *own),
            "sid" => *self.mode == *rows.mode,
            "quality" => rows.quality.as_deref().is_some_and(|own| *self.quality == *own),
            "flags" => *self.flags == *rows.flags,
            _ => false,
        };
        is_same.then(|| Arc::clone(known))
    }
}

const SHARED: [&str; 7] = ["time_tt2000", "time_utc", "time_obt", "t_degc", "sid", "quality", "flags"];

/// The partition of a level, sensor and day inside a folder of results.
#[must_use]
pub fn partition(level: &str, sensor: &str, day: i32) -> PathBuf {
    let date = date_of(day);
    let date = format!("date={:04}-{:02}-{:02}", date.year(), date.month(), date.day());
    Path::new(&format!("level={level}")).join(format!("sensor={sensor}")).join(date)
}

/// The name of the file of a level, sensor and day.
#[must_use]
pub fn file_name(level: &str, sensor: &str, day: i32) -> String {
    let date = date_of(day);
    format!("calfit-{level}-{sensor}-{:04}{:02}{:02}.parquet", date.year(), date.month(), date.day())
}

const POSITION: [&str; 3] = ["position_x_km", "position_y_km", "position_z_km"];
const STD: [[&str; 3]; 2] = [["ua_x", "ua_y", "ua_z"], ["uc_x", "uc_y", "uc_z"]];

/// Writes a level of a day, group by group, under a name that it has to be given; `metadata` is what it says of itself. Levels of single
/// vectors of one day are given what they share.
///
/// # Errors
/// What the operating system says, or a name that is taken.
pub fn write<'a>(
    folder: &Folder,
    name: &str,
    groups: impl Iterator<Item = LevelRows<'a>>,
    sids: &[String],
    leap: &LeapSeconds,
    metadata: Vec<(String, String)>,
    mut shared: Option<&mut Shared>,
) -> Result<Pending, Finding> {
    let mut file = folder.create(name)?;
    let mut writer: Option<LongWriter<_>> = None;
    let mut target = Some((&mut file, metadata));
    for (group, rows) in groups.enumerate() {
        let of_day = shared.as_ref().and_then(|shared| shared.groups.get(group));
        let known_column = |name: &str| of_day.and_then(|of_day| of_day.column(name, &rows));
        let utc: Vec<i64> = match known_column("time_utc") {
            Some(_) => Vec::new(),
            None => rows.time.iter().map(|t| leap.utc(*t).timestamp_ns()).collect(),
        };
        let mut columns = vec![
            ("time_tt2000", Column::Whole(&rows.time)),
            ("time_utc", Column::Timestamps(&utc)),
            ("time_obt", Column::Numbers(&rows.obt_s)),
        ];
        columns.extend(["bx", "by", "bz"].into_iter().zip(&rows.field_nt).map(|(n, c)| (n, Column::Numbers(c))));
        columns.extend(rows.t_degc.as_ref().map(|c| ("t_degc", Column::Repeated(c))));
        if let Some(position) = &rows.position_km {
            columns.extend(POSITION.into_iter().zip(position).map(|(n, c)| (n, Column::Numbers(c))));
        }
        columns.push(("sid", Column::Words(&rows.mode, sids)));
        columns.extend(rows.count.as_ref().map(|c| ("count", Column::Bits(c))));
        if let Some(std) = &rows.std_nt {
            for (names, parts) in STD.into_iter().zip(std) {
                columns.extend(names.into_iter().zip(parts).map(|(n, c)| (n, Column::Single(c))));
            }
        }
        columns.extend(rows.quality.as_ref().map(|c| ("quality", Column::Bytes(c))));
        columns.push(("flags", Column::Bits(&rows.flags)));
        if let Some((file, metadata)) = target.take() {
            writer = Some(LongWriter::new(file, &columns, metadata)?);
        }
        let Some(writer) = &mut writer else { continue };
        let known: Vec<Option<Arc<Encoded>>> = columns.iter().map(|(name, _)| known_column(name)).collect();
        let encoded = writer.write_with(&columns, &known)?;
        if let Some(shared) = shared.as_deref_mut().filter(|shared| shared.groups.len() == group) {
            let mut own = SharedGroup::of(&rows);
            for ((name, _), column) in columns.iter().zip(encoded) {
                if let Some(name) = SHARED.into_iter().find(|shared| shared == name) {
                    own.columns.insert(name, column);
                }
            }
            shared.groups.push(own);
        }
    }
    if let Some(writer) = writer {
        writer.finish()?;
    }
    Ok(file)
}
