//! Levels as Parquet, `level=A/sensor=OB/date=YYYY-MM-DD/calfit-A-OB-YYYYMMDD.parquet`.

use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, Tt2000, date_of};
use crate::files::output::Folder;
use crate::files::table::long::{Column, LongWriter};
use std::path::{Path, PathBuf};

/// A group of rows of a level.
#[derive(Clone, Debug, Default)]
pub struct LevelRows {
    /// Corrected times.
    pub time: Vec<Tt2000>,
    /// Clock of the spacecraft, s since 2003.
    pub obt_s: Vec<f64>,
    /// nT; nan is null.
    pub field_nt: [Vec<f64>; 3],
    /// Sensor temperature, °C; in levels that have it.
    pub t_degc: Option<Vec<f64>>,
    /// Position, km; in levels that have it.
    pub position_km: Option<[Vec<f64>; 3]>,
    /// Modes.
    pub mode: Vec<u8>,
    /// Vectors of a mean; in levels of means.
    pub count: Option<Vec<u32>>,
    /// Standard uncertainty, independent from vector to vector, then common, nT.
    pub std_nt: Option<[[Vec<f32>; 3]; 2]>,
    /// Quality as it was read; in levels of single vectors.
    pub quality: Option<Vec<u8>>,
    /// Flags.
    pub flags: Vec<u32>,
}

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

/// Writes a level of a day, group by group, under its name once it is complete; `metadata` is what it says of itself.
///
/// # Errors
/// What the operating system says, or a name that is taken.
pub fn write(
    folder: &Folder,
    name: &str,
    groups: impl Iterator<Item = LevelRows>,
    sids: &[String],
    leap: &LeapSeconds,
    metadata: Vec<(String, String)>,
) -> Result<(), Finding> {
    let mut file = folder.create(name)?;
    let mut writer: Option<LongWriter<_>> = None;
    let mut target = Some((&mut file, metadata));
    for rows in groups {
        let utc: Vec<i64> = rows.time.iter().map(|t| leap.utc(*t).timestamp_ns()).collect();
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
        if let Some(writer) = &mut writer {
            writer.write(&columns)?;
        }
    }
    if let Some(writer) = writer {
        writer.finish()?;
    }
    file.finish().map(drop)
}
