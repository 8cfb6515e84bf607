//! CSV rows by column name, and small tables of them.

use super::{decode, number, number_rule};
use crate::data::error::{Finding, Severity};
use std::collections::HashSet;

/// A cell of a CSV row with its byte column, from 1.
#[derive(Clone, Copy, Debug)]
pub struct Cell<'a> {
    /// The text without the blanks around it.
    pub text: &'a [u8],
    /// Byte column of the first byte.
    pub column: u64,
}

/// The cells of a row.
pub fn cells(line: &[u8]) -> impl Iterator<Item = Cell<'_>> {
    let mut column = 1;
    line.split(|b| *b == b',').map(move |raw| {
        let text = raw.trim_ascii();
        let blanks = raw.len() - raw.trim_ascii_start().len();
        let cell = Cell { text, column: column + blanks as u64 };
        column += raw.len() as u64 + 1;
        cell
    })
}

/// The columns of a section: where each wanted column stands.
#[derive(Clone, Debug)]
pub struct Columns {
    /// Names in the order of the file.
    pub names: Vec<String>,
    /// Index of each wanted column, `None` for an optional one that is absent.
    pub wanted: Vec<Option<usize>>,
}

/// Reads a CSV header line against the wanted names; `required` of them (the first ones) must be there.
///
/// # Errors
/// A missing or repeated column, or a row of numbers in place of the header.
pub fn columns(
    file: &str,
    line_number: u64,
    line: &[u8],
    section: &str,
    wanted: &[&str],
    required: usize,
) -> Result<Columns, Finding> {
    refuse_semicolons(file, line_number, line, section)?;
    let mut names: Vec<String> = Vec::new();
    let mut seen = HashSet::new();
    for cell in cells(line) {
        let name = decode(cell.text).into_owned();
        let problem = if name.is_empty() {
            Some(("has no name", "name every column"))
        } else if number(cell.text).is_some() {
            Some(("is a number where a column name is required", "add the header line of the section"))
        } else if !seen.insert(name.clone()) {
            Some(("stands twice in the header line", "rename one of the two columns"))
        } else {
            None
        };
        if let Some((what, remedy)) = problem {
            return Err(Finding::error(file, format!("a column of {section} {what}"), remedy)
                .at(line_number, cell.column)
                .found(cell.text));
        }
        names.push(name);
    }
    let wanted_at: Vec<Option<usize>> = wanted.iter().map(|w| names.iter().position(|n| n == w)).collect();
    for (name, at) in wanted.iter().zip(&wanted_at).take(required) {
        if at.is_none() {
            let missing = Finding::error(
                file,
                format!("{section} has no column `{name}`"),
                format!("its columns are {}", wanted.join(",")),
            );
            return Err(missing.at(line_number, 1).found(line));
        }
    }
    Ok(Columns { names, wanted: wanted_at })
}

/// Semicolons between cells come with decimal commas.
fn refuse_semicolons(file: &str, line_number: u64, line: &[u8], section: &str) -> Result<(), Finding> {
    match line.iter().position(|b| *b == b';') {
        None => Ok(()),
        Some(at) => {
            let finding = Finding::error(
                file,
                format!("a line of {section} has semicolons, as files with a decimal comma do"),
                "write numbers with a decimal point and cells separated by commas",
            );
            Err(finding.at(line_number, at as u64 + 1).found(line))
        }
    }
}

/// A row of a small table: its line number and text, the columns, the cells.
pub struct TableRow<'a> {
    /// File.
    pub file: &'a str,
    /// Line, from 1.
    pub number: u64,
    /// Text of the line.
    pub line: &'a [u8],
    /// Where each wanted column stands.
    pub columns: &'a Columns,
    /// The cells.
    pub cells: &'a [Cell<'a>],
}

impl TableRow<'_> {
    /// The number in a wanted column.
    ///
    /// # Errors
    /// A cell that is not a number, or no such column.
    pub fn number(&self, wanted: usize) -> Result<f64, Finding> {
        self.columns.required(self.file, self.number, self.cells, wanted)
    }

    /// The number in a wanted column that may be absent or empty.
    ///
    /// # Errors
    /// A cell that is not a number.
    pub fn optional(&self, wanted: usize) -> Result<Option<f64>, Finding> {
        self.columns.number(self.file, self.number, self.cells, wanted)
    }

    /// The text in a wanted column; empty where it is absent.
    #[must_use]
    pub fn text(&self, wanted: usize) -> String {
        let at = self.columns.wanted.get(wanted).copied().flatten();
        at.and_then(|at| self.cells.get(at)).map_or_else(String::new, |cell| decode(cell.text).into_owned())
    }

    /// An error about this row.
    #[must_use]
    pub fn refuse(&self, rule: &str, remedy: &str) -> Finding {
        Finding::error(self.file, rule, remedy).at(self.number, 1).found(self.line)
    }
}

/// What a small table holds.
#[derive(Clone, Copy, Debug)]
pub struct TableForm<'a> {
    /// Name in messages.
    pub name: &'a str,
    /// Columns that are looked for.
    pub columns: &'a [&'a str],
    /// As many of the first ones must be there.
    pub required: usize,
    /// From this one on at least one must be there; none are looked at where it is the number of columns.
    pub alternatives: usize,
    /// Rule and remedy for a table without rows.
    pub empty: [&'a str; 2],
}

/// Reads a small CSV table: comments with `#`, a header line, and one value of `take` per row. Unknown columns become warnings.
///
/// # Errors
/// What is wrong with it, with its place; a table without rows.
pub fn small_table<T>(
    file: &str,
    bytes: &[u8],
    form: &TableForm,
    findings: &mut Vec<Finding>,
    mut take: impl FnMut(&TableRow) -> Result<T, Finding>,
) -> Result<Vec<T>, Finding> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut header: Option<Columns> = None;
    let mut rows = Vec::new();
    for (line, number) in bytes.split(|b| *b == b'\n').zip(1u64..) {
        let line = line.strip_suffix(b"\r").unwrap_or(line);
        if line.trim_ascii().is_empty() || line.starts_with(b"#") {
            continue;
        }
        let Some(columns) = &header else {
            let found = columns(file, number, line, form.name, form.columns, form.required)?;
            let (names, places) = (form.columns.get(form.alternatives..), found.wanted.get(form.alternatives..));
            if let (Some(names @ [_, ..]), Some(places)) = (names, places)
                && places.iter().all(Option::is_none)
            {
                let rule = format!("the table holds neither a column {}", names.join(" nor one "));
                return Err(Finding::error(file, rule, "name the columns in its header line").at(number, 1).found(line));
            }
            findings.extend(found.unknown(file, number, form.name, form.columns));
            header = Some(found);
            continue;
        };
        let mut cells = Vec::new();
        columns.row(file, number, line, form.name, &mut cells)?;
        rows.push(take(&TableRow { file, number, line, columns, cells: &cells })?);
    }
    if rows.is_empty() {
        let [rule, remedy] = form.empty;
        return Err(Finding::error(file, rule, remedy));
    }
    Ok(rows)
}

impl Columns {
    /// Splits a row and checks its number of cells.
    ///
    /// # Errors
    /// Too few or too many cells.
    pub fn row<'a>(
        &self,
        file: &str,
        line_number: u64,
        line: &'a [u8],
        section: &str,
        cells_out: &mut Vec<Cell<'a>>,
    ) -> Result<(), Finding> {
        refuse_semicolons(file, line_number, line, section)?;
        cells_out.clear();
        cells_out.extend(cells(line));
        if cells_out.len() == self.names.len() {
            return Ok(());
        }
        let hint = if cells_out.len() > self.names.len() {
            "take the extra cells out; a decimal comma also makes extra cells"
        } else {
            "complete the row or take it out"
        };
        Err(Finding::error(
            file,
            format!("a row of {section} has {} cells where the header line has {}", cells_out.len(), self.names.len()),
            hint,
        )
        .at(line_number, 1)
        .found(line))
    }

    /// The number in a wanted column of a row.
    ///
    /// # Errors
    /// A cell that is not a number, named with its column.
    pub fn number(&self, file: &str, line_number: u64, row: &[Cell], wanted: usize) -> Result<Option<f64>, Finding> {
        let Some(at) = self.wanted.get(wanted).copied().flatten() else { return Ok(None) };
        let (Some(cell), Some(name)) = (row.get(at), self.names.get(at)) else { return Ok(None) };
        number(cell.text).map(Some).ok_or_else(|| not_a_number(file, line_number, *cell, name))
    }

    /// As [`Columns::number`], for a column that must be there.
    ///
    /// # Errors
    /// A cell that is absent or not a number.
    pub fn required(&self, file: &str, line_number: u64, row: &[Cell], wanted: usize) -> Result<f64, Finding> {
        self.number(file, line_number, row, wanted)?.ok_or_else(|| {
            Finding::error(file, "a required column is absent", "see the header line of the section").at(line_number, 1)
        })
    }

    /// A warning that names the columns that are in the file and not wanted, or the first of them.
    #[must_use]
    pub fn unknown(&self, file: &str, line_number: u64, section: &str, wanted: &[&str]) -> Option<Finding> {
        const MOST_NAMED: usize = 10;
        let unknown: Vec<&str> = self.names.iter().map(String::as_str).filter(|n| !wanted.contains(n)).collect();
        let named = unknown.get(..MOST_NAMED).unwrap_or(&unknown).iter().map(|n| format!("`{n}`")).collect::<Vec<_>>().join(", ");
        let more = unknown.len().saturating_sub(MOST_NAMED);
        let rest = if more > 0 { format!(" and {more} more") } else { String::new() };
        let finding = Finding::error(
            file,
            format!("columns of {section} are not known and were not used: {named}{rest}"),
            "check their spelling",
        );
        (!unknown.is_empty()).then(|| finding.at(line_number, 0).weighing(Severity::Warning))
    }
}

/// The error for a cell that is not a number.
#[must_use]
pub fn not_a_number(file: &str, line_number: u64, cell: Cell, column: &str) -> Finding {
    let (what, remedy) = number_rule(cell.text);
    Finding::error(file, format!("column `{column}` {what}"), remedy).at(line_number, cell.column).found(cell.text)
}
