//! Tables of moduli at plus and minus F on one coil axis, CSV with a header line: `axis,state,plus_nt,minus_nt` and optionally
//! `std_nt`, the standard uncertainty of a modulus. `state` names the state of the facility, `before nulling` for example.

use super::source::{Digested, read_whole};
use super::text::{TableForm, TableRow, small_table};
use crate::data::error::Finding;
use crate::data::tables::ModulusRow;
use std::path::Path;

const COLUMNS: [&str; 5] = ["axis", "state", "plus_nt", "minus_nt", "std_nt"];
const FORM: TableForm = TableForm {
    name: "the table of moduli",
    columns: &COLUMNS,
    required: 4,
    alternatives: COLUMNS.len(),
    empty: ["the table of moduli holds no rows", "it needs a header line and at least one row"],
};

/// Reads a table; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(Vec<ModulusRow>, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    Ok((parse(&path.display().to_string(), &bytes, findings)?, digested))
}

fn parse(file: &str, bytes: &[u8], findings: &mut Vec<Finding>) -> Result<Vec<ModulusRow>, Finding> {
    small_table(file, bytes, &FORM, findings, row)
}

fn row(row: &TableRow) -> Result<ModulusRow, Finding> {
    let axis = row.text(0);
    let axis = ["X", "Y", "Z"]
        .iter()
        .position(|name| axis.eq_ignore_ascii_case(name))
        .ok_or_else(|| row.refuse("the axis is not X, Y or Z", "name the coil axis that was driven"))?;
    let (plus_nt, minus_nt, std_nt) = (row.number(2)?, row.number(3)?, row.optional(4)?);
    if plus_nt <= 0.0 || minus_nt <= 0.0 {
        return Err(row.refuse("a modulus must be positive", "repair the value or take the row out"));
    }
    if std_nt.is_some_and(|s| s <= 0.0) {
        return Err(row.refuse("a standard uncertainty must be positive", "repair the value, or leave the cell empty"));
    }
    Ok(ModulusRow { axis, state: row.text(1), plus_nt, minus_nt, std_nt })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_and_their_faults_are_told() {
        let read = |text: &str| parse("m.csv", text.as_bytes(), &mut Vec::new());
        let rows = read("# printed\naxis,state,plus_nt,minus_nt\nX,before,49002,49007\nz,after,1,2\n").unwrap();
        assert_eq!((rows[0].axis, rows[0].plus_nt, rows[1].axis, rows[1].std_nt), (0, 49002.0, 2, None));
        for (text, line, words) in [
            ("axis,state,plus_nt\nX,a,1\n", 1, "minus_nt"),
            ("axis,state,plus_nt,minus_nt\nX,a,1,2\nW,a,1,2\n", 3, "not X, Y or Z"),
            ("axis,state,plus_nt,minus_nt\nX,a,-1,2\n", 2, "positive"),
            ("axis,state,plus_nt,minus_nt\nX,a,one,2\n", 2, "plus_nt"),
        ] {
            let error = read(text).unwrap_err();
            assert_eq!(error.line, Some(line), "{error}");
            assert!(error.to_string().contains(words), "{error}");
        }
    }
}
