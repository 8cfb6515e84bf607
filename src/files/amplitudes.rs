//! Tables of amplitudes against frequency, CSV with a header line: `frequency_hz,bx_ent,by_ent,bz_ent` and optionally the standard
//! uncertainties `bx_std_ent,by_std_ent,bz_std_ent`. Lines that begin with `#` are comments.

use super::source::{Digested, read_whole};
use super::text::{TableForm, TableRow, small_table};
use crate::data::error::{Finding, Severity};
use crate::data::tables::AmplitudeRow;
use std::collections::HashSet;
use std::path::Path;

const COLUMNS: [&str; 7] = ["frequency_hz", "bx_ent", "by_ent", "bz_ent", "bx_std_ent", "by_std_ent", "bz_std_ent"];
const FORM: TableForm = TableForm {
    name: "the table of amplitudes",
    columns: &COLUMNS,
    required: 4,
    alternatives: COLUMNS.len(),
    empty: ["the table holds no amplitudes", "it needs a header line and one row per frequency"],
};

/// Reads a table; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(Vec<AmplitudeRow>, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    Ok((parse(&path.display().to_string(), &bytes, findings)?, digested))
}

fn parse(file: &str, bytes: &[u8], findings: &mut Vec<Finding>) -> Result<Vec<AmplitudeRow>, Finding> {
    let (mut seen, mut twice) = (HashSet::new(), Vec::new());
    let rows = small_table(file, bytes, &FORM, findings, |line| {
        let row = row(line)?;
        if !seen.insert(row.frequency_hz.to_bits()) {
            let remedy = "take one out if they are the same measurement";
            twice.push(line.refuse("the frequency stands twice; both rows count", remedy).weighing(Severity::Warning));
        }
        Ok(row)
    });
    findings.extend(twice);
    rows
}

fn row(row: &TableRow) -> Result<AmplitudeRow, Finding> {
    let mut values = [f64::NAN; COLUMNS.len()];
    for (i, value) in values.iter_mut().enumerate() {
        *value = if i < FORM.required { row.number(i)? } else { row.optional(i)?.unwrap_or(f64::NAN) };
    }
    let [frequency_hz, bx, by, bz, sx, sy, sz] = values;
    let rule = if frequency_hz <= 0.0 {
        Some("a frequency must be positive")
    } else if [bx, by, bz].iter().any(|b| *b < 0.0) {
        Some("an amplitude must not be negative")
    } else if [sx, sy, sz].iter().any(|s| *s < 0.0) {
        Some("a standard uncertainty must not be negative")
    } else {
        None
    };
    match rule {
        Some(rule) => Err(row.refuse(rule, "repair the value or take the row out")),
        None => Ok(AmplitudeRow { frequency_hz, amplitude_ent: [bx, by, bz], std_ent: [sx, sy, sz] }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str) -> Result<Vec<AmplitudeRow>, Finding> {
        parse("t.csv", text.as_bytes(), &mut Vec::new())
    }

    #[test]
    fn columns_are_found_by_name() {
        let rows = table("# made by hand\r\nbz_ent,frequency_hz,by_ent,bx_ent,bx_std_ent\r\n3,0.1,2,1,0.5\r\n").unwrap();
        assert_eq!((rows[0].frequency_hz, rows[0].amplitude_ent), (0.1, [1.0, 2.0, 3.0]));
        assert!(rows[0].std_ent[0] == 0.5 && rows[0].std_ent[1].is_nan());
    }

    #[test]
    fn damaged_tables_are_refused_with_their_place() {
        for (text, line, words) in [
            ("frequency_hz,bx_ent,by_ent\n1,2,3\n", 1, "bz_ent"),
            ("frequency_hz,bx_ent,by_ent,bz_ent\n1,2,3\n", 2, "cells"),
            ("frequency_hz,bx_ent,by_ent,bz_ent\n1,2,nan,4\n", 2, "by_ent"),
            ("frequency_hz,bx_ent,by_ent,bz_ent\n1,2,3,4\n0,2,3,4\n", 3, "positive"),
            ("frequency_hz,bx_ent,by_ent,bz_ent\n1,2,-3,4\n", 2, "negative"),
        ] {
            let error = table(text).unwrap_err();
            assert_eq!(error.line, Some(line), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
        assert!(table("frequency_hz,bx_ent,by_ent,bz_ent\n").unwrap_err().to_string().contains("no amplitudes"));
        assert!(table("").is_err());
    }
}
