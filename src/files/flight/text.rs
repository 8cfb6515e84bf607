//! Levels as text tables of fixed columns with a detached label in the style of PDS3: `RPCMAG_yymmdd_CLA_OB.TAB` and `.LBL`.

use super::levels::LevelRows;
use crate::data::error::Finding;
use crate::data::time::{LeapSeconds, date_of};
use crate::files::output::Folder;
use std::fmt::Write as _;
use std::io::Write as _;

/// 0 °C, K: archives keep temperatures in kelvin.
const KELVIN: f64 = 273.15;

/// What a label says of its table beside what its columns say.
const NOTE: &str = "the table has no uncertainties";

/// A column: name, unit, width, decimals, what it is.
#[derive(Clone, Copy)]
struct Field<'a> {
    name: &'a str,
    unit: &'static str,
    width: usize,
    decimals: Option<usize>,
    what: &'static str,
}

const fn field<'a>(name: &'a str, unit: &'static str, width: usize, decimals: Option<usize>, what: &'static str) -> Field<'a> {
    Field { name, unit, width, decimals, what }
}

const UTC: Field<'static> = field("TIME_UTC", "N/A", 29, None, "UTC, seconds 60 within a leap second");
const OBT: Field<'static> =
    field("TIME_OBT", "SECOND", 20, Some(9), "clock of the spacecraft, SI seconds since 2003-01-01T00:00:00 UTC");
const POSITION: [Field<'static>; 3] = [
    field("POSITION_X", "KILOMETER", 18, Some(3), "position in the frame of the field"),
    field("POSITION_Y", "KILOMETER", 18, Some(3), "position in the frame of the field"),
    field("POSITION_Z", "KILOMETER", 18, Some(3), "position in the frame of the field"),
];
const B: [Field<'static>; 3] = [
    field("BX", "NANOTESLA", 14, Some(5), "magnetic field; blank where there is no vector"),
    field("BY", "NANOTESLA", 14, Some(5), "magnetic field; blank where there is no vector"),
    field("BZ", "NANOTESLA", 14, Some(5), "magnetic field; blank where there is no vector"),
];
const T: Field<'static> = field("T", "KELVIN", 9, Some(3), "temperature of the sensor");
const COUNT: Field<'static> = field("COUNT", "N/A", 7, None, "vectors of the mean");
const QUALITY: Field<'static> = field("QUALITY", "N/A", 4, None, "quality as it was telemetered");
const FLAGS: Field<'static> = field("FLAGS", "N/A", 11, None, "flags of the vector, one bit each");

/// The stem of the names of the table and of its label.
#[must_use]
pub fn stem(instrument: &str, level: &str, sensor: &str, day: i32) -> String {
    let date = date_of(day);
    let name: String = instrument.chars().filter(char::is_ascii_alphanumeric).collect();
    format!("{}_{:02}{:02}{:02}_CL{level}_{sensor}", name.to_uppercase(), date.year() % 100, date.month(), date.day())
}

fn number(out: &mut String, value: f64, of: &Field) {
    let width = of.width;
    // A nan is no vector, which a blank says.
    let _ = match of.decimals {
        // The shortest number that reads back as the same one: more of its decimals are none of the clock.
        Some(decimals) if value.is_finite() && of.name == OBT.name => {
            let shortest = value.to_string();
            let own = shortest.split_once('.').map_or(0, |(_, own)| own.len()).min(decimals);
            let zeros = "0".repeat(decimals - own);
            let text = format!("{value:.own$}{}{zeros}", if own == 0 { "." } else { "" });
            write!(out, " {text:>width$}")
        }
        Some(decimals) if value.is_finite() => write!(out, " {value:width$.decimals$}"),
        _ => write!(out, " {:width$}", ""),
    };
}

fn fields(rows: &LevelRows<'_>) -> Vec<&'static Field<'static>> {
    let mut list = vec![&UTC, &OBT];
    list.extend(rows.position_km.iter().flat_map(|_| &POSITION));
    list.extend(&B);
    list.extend(rows.t_degc.iter().map(|_| &T));
    list.extend(rows.count.iter().map(|_| &COUNT));
    list.extend(rows.quality.iter().map(|_| &QUALITY));
    list.push(&FLAGS);
    list
}

/// Writes a level of a day as a table and its label; `says` are the keys and values of the Parquet file.
///
/// # Errors
/// What the operating system says, or a name that is taken.
pub fn write<'a>(
    folder: &Folder,
    stem: &str,
    groups: impl Iterator<Item = LevelRows<'a>>,
    leap: &LeapSeconds,
    says: &[(String, String)],
) -> Result<(), Finding> {
    let name = format!("{stem}.TAB");
    let mut file = folder.create(&name)?;
    let mut columns: Option<Vec<&'static Field<'static>>> = None;
    let mut records = 0;
    for rows in groups {
        let mut out = String::new();
        for row in 0..rows.time.len() {
            let _ = write!(out, "{}", leap.utc(rows.time[row]));
            number(&mut out, rows.obt_s[row], &OBT);
            for (position, of) in rows.position_km.iter().flatten().zip(&POSITION) {
                number(&mut out, position[row], of);
            }
            for (component, of) in rows.field_nt.iter().zip(&B) {
                number(&mut out, component[row], of);
            }
            if let Some(degc) = &rows.t_degc {
                number(&mut out, degc[row] + KELVIN, &T);
            }
            if let Some(count) = &rows.count {
                let _ = write!(out, " {:>1$}", count[row], COUNT.width);
            }
            if let Some(quality) = &rows.quality {
                let _ = write!(out, " {:>1$}", quality[row], QUALITY.width);
            }
            let _ = write!(out, " {:>1$}\r\n", rows.flags[row], FLAGS.width);
        }
        records += rows.time.len();
        file.write_all(out.as_bytes()).map_err(|e| Finding::error(&name, format!("cannot be written: {e}"), "check the disk"))?;
        columns.get_or_insert_with(|| fields(&rows));
    }
    // The label is there before the table has its name: by it the program knows the table as its own.
    folder.write(&format!("{stem}.LBL"), label(&name, &columns.unwrap_or_default(), records, says).as_bytes())?;
    file.finish().map(drop)
}

/// Housekeeping of a day, row by row in the order of time.
pub struct HousekeepingRows<'a> {
    /// Times.
    pub time: &'a [i64],
    /// Clock of the spacecraft, s.
    pub obt_s: &'a [f64],
    /// Quantities with their names: fields enT, temperatures degC, voltages V.
    pub numbers: &'a [(String, Vec<f64>)],
    /// Identifiers and settings with their names.
    pub whole: &'a [(String, Vec<i64>)],
}

/// Unit, decimals and meaning of a quantity of the housekeeping, by its name; temperatures are in kelvin as in all tables of text.
fn housekept(name: &str) -> Field<'_> {
    match name {
        _ if name.ends_with("_calibrated") => field(name, "KELVIN", 11, Some(3), "temperature with the offset of the thermistor"),
        _ if name.starts_with("t_") => field(name, "KELVIN", 11, Some(3), "temperature without the offset of the thermistor"),
        _ if name.ends_with("_voltage") => field(name, "VOLT", 11, Some(6), "voltage"),
        _ => field(name, "NANOTESLA", 14, Some(5), "reading of the field, engineering nanotesla, not calibrated"),
    }
}

/// Writes the housekeeping of a day as a table and its label; `says` are the keys and values of the Parquet file.
///
/// # Errors
/// What the operating system says, or a name that is taken.
pub fn write_housekeeping(
    folder: &Folder,
    stem: &str,
    rows: &HousekeepingRows<'_>,
    leap: &LeapSeconds,
    says: &[(String, String)],
) -> Result<(), Finding> {
    let name = format!("{stem}.TAB");
    let numbers: Vec<Field> = rows.numbers.iter().map(|(name, _)| housekept(name)).collect();
    let whole: Vec<Field> = rows.whole.iter().map(|(name, _)| field(name, "N/A", 11, None, "as it was telemetered")).collect();
    let mut out = String::new();
    for row in 0..rows.time.len() {
        let _ = write!(out, "{}", leap.utc(rows.time[row]));
        number(&mut out, rows.obt_s[row], &OBT);
        for ((_, values), of) in rows.numbers.iter().zip(&numbers) {
            number(&mut out, values[row] + if of.unit == "KELVIN" { KELVIN } else { 0.0 }, of);
        }
        for ((_, values), of) in rows.whole.iter().zip(&whole) {
            let _ = write!(out, " {:>1$}", values[row], of.width);
        }
        out.push_str("\r\n");
    }
    let columns: Vec<&Field> = [&UTC, &OBT].into_iter().chain(&numbers).chain(&whole).collect();
    let mut file = folder.create(&name)?;
    file.write_all(out.as_bytes()).map_err(|e| Finding::error(&name, format!("cannot be written: {e}"), "check the disk"))?;
    folder.write(&format!("{stem}.LBL"), label(&name, &columns, rows.time.len(), says).as_bytes())?;
    file.finish().map(drop)
}

fn label(table: &str, columns: &[&Field], records: usize, says: &[(String, String)]) -> String {
    // A blank before every column but the first, and the end of the line.
    let bytes: usize = columns.iter().map(|c| c.width + 1).sum::<usize>() + 1;
    let said = |key: &str| says.iter().find(|(k, _)| k == key).map_or("", |(_, value)| value.as_str()).replace('"', "'");
    let mut out = String::from("PDS_VERSION_ID = PDS3\r\n");
    let _ = write!(
        out,
        "/* {} */\r\nRECORD_TYPE = FIXED_LENGTH\r\nRECORD_BYTES = {bytes}\r\nFILE_RECORDS = {records}\r\n^TABLE = \"{table}\"\r\n",
        said("written_by")
    );
    for (key, of) in [
        ("MISSION_NAME", "mission"),
        ("INSTRUMENT_NAME", "instrument"),
        ("PROCESSING_LEVEL_DESC", "level"),
        ("DETECTOR_ID", "sensor"),
        ("COORDINATE_SYSTEM_DESC", "frame"),
    ] {
        let _ = write!(out, "{key} = \"{}\"\r\n", said(of));
    }
    // What the Parquet file says of its columns of uncertainty would describe columns that are not here.
    let _ = write!(out, "NOTE = \"{NOTE}\"\r\n");
    let _ = write!(
        out,
        "OBJECT = TABLE\r\n  INTERCHANGE_FORMAT = ASCII\r\n  ROWS = {records}\r\n  COLUMNS = {}\r\n  ROW_BYTES = {bytes}\r\n",
        columns.len()
    );
    let mut begin = 1;
    for column in columns {
        let kind = match (column.decimals, column.name) {
            (Some(_), _) => "ASCII_REAL",
            (None, "TIME_UTC") => "TIME",
            _ => "ASCII_INTEGER",
        };
        let _ = write!(
            out,
            "  OBJECT = COLUMN\r\n    NAME = {}\r\n    DATA_TYPE = {kind}\r\n    START_BYTE = {begin}\r\n    BYTES = {}\r\n    UNIT = \"{}\"\r\n    \
             DESCRIPTION = \"{}\"\r\n  END_OBJECT = COLUMN\r\n",
            column.name.to_uppercase(),
            column.width,
            column.unit,
            column.what
        );
        begin += column.width + 1;
    }
    out.push_str("END_OBJECT = TABLE\r\nEND\r\n");
    out
}
