//! Calibration tables of thermistors, CSV with a header line: `t_degc` and `u_volt` or `r_ohm`; and comparisons with a reference
//! thermometer: `reference_degc` and `u_volt` or `r_ohm`. Lines that begin with `#` are comments.

use super::source::{Digested, read_whole};
use super::text::{TableForm, TableRow, small_table};
use crate::data::error::Finding;
use crate::data::tables::ThermistorRow;
use std::path::Path;

/// Name of the temperature column of a calibration table.
pub const TABLE: &str = "t_degc";
/// Name of the temperature column of a comparison.
pub const REFERENCE: &str = "reference_degc";
/// Absolute zero: lower temperatures are refused.
const LEAST_DEGC: f64 = -273.15;

/// Reads a table whose temperatures stand in the column `temperature`; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, temperature: &str, findings: &mut Vec<Finding>) -> Result<(Vec<ThermistorRow>, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    Ok((parse(&path.display().to_string(), &bytes, temperature, findings)?, digested))
}

fn parse(file: &str, bytes: &[u8], temperature: &str, findings: &mut Vec<Finding>) -> Result<Vec<ThermistorRow>, Finding> {
    let form = TableForm {
        name: "the thermistor table",
        columns: &[temperature, "u_volt", "r_ohm"],
        required: 1,
        alternatives: 1,
        empty: ["the table holds no rows", "it needs a header line and one row per temperature"],
    };
    small_table(file, bytes, &form, findings, row)
}

fn row(row: &TableRow) -> Result<ThermistorRow, Finding> {
    let optional = |i: usize| row.optional(i).map(|v| v.unwrap_or(f64::NAN));
    let values = ThermistorRow { t_degc: row.number(0)?, u_volt: optional(1)?, r_ohm: optional(2)? };
    let rule = if values.t_degc < LEAST_DEGC {
        "a temperature lies below absolute zero"
    } else if values.r_ohm <= 0.0 {
        "a resistance must be positive"
    } else {
        return Ok(values);
    };
    Err(row.refuse(rule, "repair the value or take the row out"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Result<Vec<ThermistorRow>, Finding> {
        parse("t.csv", text.as_bytes(), TABLE, &mut Vec::new())
    }

    #[test]
    fn columns_are_found_by_name() {
        let rows = table("# nominal\r\nr_ohm,t_degc\r\n1000,0\r\n1039.14,10\r\n").unwrap();
        assert_eq!((rows[1].t_degc, rows[1].r_ohm), (10.0, 1039.14));
        assert!(rows[0].u_volt.is_nan());
    }

    #[test]
    fn damaged_tables_are_refused_with_their_place() {
        for (text, line, words) in [
            ("u_volt\n1\n", 1, "t_degc"),
            ("t_degc\n1\n", 1, "neither"),
            ("t_degc,u_volt\n1,x\n", 2, "u_volt"),
            ("t_degc,r_ohm\n1,1000\n2,-5\n", 3, "positive"),
            ("t_degc,r_ohm\n-300,5\n", 2, "absolute zero"),
        ] {
            let error = table(text).unwrap_err();
            assert_eq!(error.line, Some(line), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
        assert!(table("t_degc,u_volt\n").unwrap_err().to_string().contains("no rows"));
    }
}
