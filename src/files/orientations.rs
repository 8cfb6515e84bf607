//! Tables of run results of sensors in several orientations, CSV with a header line:
//! `run,orientation,sx_nt_per_eu,..,x0_nt,..,xi_xy_deg,..` and optionally `sensor`. `orientation` names the sensor axes along the coil
//! axes X, Y, Z, `-Y +X +Z` for example; rows without it are passed over.

use super::source::{Digested, read_whole};
use super::text::{TableForm, TableRow, small_table};
use crate::data::error::{Finding, Severity};
use crate::model::position::{OrientedRun, Position};
use std::path::Path;

const COLUMNS: [&str; 14] = [
    "run",
    "orientation",
    "sx_nt_per_eu",
    "sy_nt_per_eu",
    "sz_nt_per_eu",
    "x0_nt",
    "y0_nt",
    "z0_nt",
    "xi_xy_deg",
    "xi_xz_deg",
    "xi_yz_deg",
    "sensor",
    "settings",
    "field_ut",
];
const FORM: TableForm = TableForm {
    name: "the table of run results",
    columns: &COLUMNS,
    required: 11,
    alternatives: COLUMNS.len(),
    empty: ["the table of run results holds no rows", "it needs a header line and at least one row"],
};

/// Reads a table; warnings and passed-over rows go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<(Vec<OrientedRun>, Digested), Finding> {
    let (bytes, digested) = read_whole(path)?;
    Ok((parse(&path.display().to_string(), &bytes, findings)?, digested))
}

fn parse(file: &str, bytes: &[u8], findings: &mut Vec<Finding>) -> Result<Vec<OrientedRun>, Finding> {
    let mut passed_over = Vec::new();
    let rows = small_table(file, bytes, &FORM, findings, |row| {
        if row.text(1).is_empty() {
            let rule = format!("run {} has no orientation and was passed over", row.text(0));
            let remedy = "name the sensor axes along the coil axes X, Y, Z, if they lie along them";
            passed_over.push(row.refuse(&rule, remedy).weighing(Severity::Warning));
            return Ok(None);
        }
        one(row).map(Some)
    })?;
    findings.extend(passed_over);
    Ok(rows.into_iter().flatten().collect())
}

fn one(row: &TableRow) -> Result<OrientedRun, Finding> {
    let run = row.text(0);
    if !super::ccr::run_id_is_safe(&run) {
        return Err(row.refuse("the run cannot be part of a file name", "use letters, digits, `-`, `_` and `.`"));
    }
    let position = Position::from_orientation(&row.text(1))
        .map_err(|e| row.refuse(&e.to_string(), "name the sensor axes along the coil axes X, Y, Z, as in `-Y +X +Z`"))?;
    let three =
        |from: usize| -> Result<[f64; 3], Finding> { Ok([row.number(from)?, row.number(from + 1)?, row.number(from + 2)?]) };
    let (sigma, offset_nt, xi_deg) = (three(2)?, three(5)?, three(8)?);
    if sigma.iter().any(|s| *s <= 0.0) {
        return Err(row.refuse("a sensitivity must be positive", "repair the value or take the row out"));
    }
    if xi_deg.iter().any(|xi| !(1.0..179.0).contains(xi)) {
        return Err(row.refuse("an angle between sensor axes must lie between 1 and 179 degrees", "write angles in degrees"));
    }
    let field_nt = if row.text(13).is_empty() { None } else { Some(1000.0 * row.number(13)?) };
    Ok(OrientedRun { run, sensor: row.text(11), mode: None, position, rho: None, sigma, offset_nt, xi_deg, field_nt })
}

#[cfg(test)]
mod tests {
    use super::*;

    const HEAD: &str =
        "run,sensor,orientation,sx_nt_per_eu,sy_nt_per_eu,sz_nt_per_eu,x0_nt,y0_nt,z0_nt,xi_xy_deg,xi_xz_deg,xi_yz_deg";

    #[test]
    fn rows_without_orientation_are_passed_over_and_faults_have_their_place() {
        let mut findings = Vec::new();
        let read = |rows: &str, findings: &mut Vec<Finding>| parse("t.csv", format!("{HEAD}\n{rows}").as_bytes(), findings);
        let rows = read("5,A,-Y +X +Z,1,2,3,4,5,6,90,90,90\n6,A,,1,2,3,4,5,6,90,90,90\n", &mut findings).unwrap();
        assert_eq!((rows.len(), rows[0].position.orientation().as_str(), rows[0].sigma), (1, "-Y +X +Z", [1.0, 2.0, 3.0]));
        assert!(findings.len() == 1 && findings[0].line == Some(3), "{findings:?}");
        for (row, words) in [
            ("5,A,+X +Y -Z,1,2,3,4,5,6,90,90,90", "left-handed"),
            ("5,A,+X +Y,1,2,3,4,5,6,90,90,90", "three axes"),
            ("5,A,+X +Y +Z,0,2,3,4,5,6,90,90,90", "positive"),
            ("5,A,+X +Y +Z,1,2,3,4,5,6,1.57,90,190", "179"),
            ("a/b,A,+X +Y +Z,1,2,3,4,5,6,90,90,90", "file name"),
        ] {
            let error = read(row, &mut findings).unwrap_err();
            assert!(error.line == Some(2) && error.to_string().contains(words), "{error}");
        }
    }
}
