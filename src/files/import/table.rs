//! A table of other software: its columns by name, every complaint with file, row and column.

use super::csv::TextTable;
use super::{Dialect, Format};
use crate::data::error::Finding;
use crate::files::source::{Digested, Piece, digest, open, read_pieces};
use crate::files::text::number;
use std::io::Read;
use std::path::Path;

/// A column of a table that knows the types of its cells.
#[derive(Clone, Debug, PartialEq)]
pub enum Cells {
    /// Numbers; NaN where there is none.
    Numbers(Vec<f64>),
    /// Text, empty where there is none.
    Texts(Vec<String>),
    /// Moments, ns since 1970.
    Moments {
        /// ns; absent where there is none.
        ns: Vec<Option<i64>>,
        /// Whether they are UTC; otherwise they are those of a clock on some wall.
        utc: bool,
    },
    /// Something else, named for people.
    Other(String),
}

enum Body {
    Text(TextTable),
    Columns { columns: Vec<Cells>, rows: usize },
}

/// A table of other software.
pub struct ForeignTable {
    file: String,
    format: Format,
    names: Vec<String>,
    body: Body,
    decimal_comma: bool,
    /// Size and hash.
    pub digested: Digested,
}

/// Texts that stand for a number that is not there.
const NOTHING: [&str; 6] = ["", "nan", "na", "n/a", "null", "none"];

impl ForeignTable {
    /// Reads a table whole.
    ///
    /// # Errors
    /// What the operating system says, or why the file is no table of its format.
    pub fn read(path: &Path, format: Option<Format>, dialect: &Dialect) -> Result<Self, Finding> {
        let file = path.display().to_string();
        let format = format.or_else(|| Format::of_name(path)).unwrap_or(Format::Csv);
        let (names, body, digested) = if format == Format::Csv {
            if let Some(other) = binary(path)? {
                let rule = format!("the file is read as text and begins as a table of the format {}", other.name());
                return Err(Finding::error(&file, rule, format!("set `format = \"{}\"` under [file]", other.name())));
            }
            let (bytes, digested) = whole(path)?;
            let table = TextTable::parse(&file, &bytes, dialect)?;
            (table.names.clone(), Body::Text(table), digested)
        } else {
            let digested = digest(path)?;
            let (names, columns) = typed(path, format)?.into_iter().unzip::<_, _, Vec<_>, Vec<Cells>>();
            let length = |c: &Cells| match c {
                Cells::Numbers(v) => Some(v.len()),
                Cells::Texts(v) => Some(v.len()),
                Cells::Moments { ns, .. } => Some(ns.len()),
                Cells::Other(_) => None,
            };
            let rows = columns.iter().find_map(length).unwrap_or(0);
            (names, Body::Columns { columns, rows }, digested)
        };
        let table = Self { file, format, names, body, decimal_comma: dialect.decimal_comma, digested };
        if table.rows() == 0 {
            let rule = "the table has a header line and no rows";
            return Err(Finding::error(&table.file, rule, "take the file from the archive again"));
        }
        Ok(table)
    }

    /// The file as the user named it.
    #[must_use]
    pub fn file(&self) -> &str {
        &self.file
    }

    /// Its format.
    #[must_use]
    pub fn format(&self) -> Format {
        self.format
    }

    /// Names of the columns.
    #[must_use]
    pub fn names(&self) -> &[String] {
        &self.names
    }

    /// Number of rows.
    #[must_use]
    pub fn rows(&self) -> usize {
        match &self.body {
            Body::Text(table) => table.rows.len(),
            Body::Columns { rows, .. } => *rows,
        }
    }

    /// Where a row stands, for people: its line in a text, its number from 1 elsewhere.
    #[must_use]
    pub fn row_name(&self, row: usize) -> String {
        match &self.body {
            Body::Text(table) => format!("line {}", table.rows.get(row).map_or(0, |r| r.number)),
            Body::Columns { .. } => format!("row {}", row + 1),
        }
    }

    /// A complaint about a row and, where one is named, a column.
    #[must_use]
    pub fn refuse(&self, row: usize, column: Option<&str>, rule: &str, remedy: &str) -> Finding {
        let rule = match column {
            Some(name) => format!("column `{name}`: {rule}"),
            None => rule.to_owned(),
        };
        match &self.body {
            Body::Text(table) => {
                let finding = Finding::error(&self.file, rule, remedy);
                let index = column.and_then(|name| self.names.iter().position(|n| n == name));
                match (index.and_then(|i| table.place(row, i)), table.rows.get(row)) {
                    (Some((line, at, text)), _) => finding.at(line, at).found(text.as_bytes()),
                    (None, Some(line)) => finding.at(line.number, 1).found(table.line(line).as_bytes()),
                    (None, None) => finding,
                }
            }
            Body::Columns { .. } => Finding::error(&self.file, format!("row {}: {rule}", row + 1), remedy),
        }
    }

    /// The index of a column.
    ///
    /// # Errors
    /// No such column, or several.
    fn index(&self, name: &str) -> Result<usize, Finding> {
        let mut all = self.names.iter().enumerate().filter(|(_, n)| *n == name).map(|(i, _)| i);
        let line = |finding: Finding| match &self.body {
            Body::Text(table) => finding.at(table.header_line, 0),
            Body::Columns { .. } => finding,
        };
        match (all.next(), all.next()) {
            (Some(index), None) => Ok(index),
            (Some(_), Some(_)) => {
                let rule = format!("two columns have the name `{name}`");
                Err(line(Finding::error(&self.file, rule, "rename one of the two")))
            }
            (None, _) => {
                let names: Vec<String> = self.names.iter().map(|n| format!("`{n}`")).collect();
                let rule = format!("the table has no column `{name}`; it has {}", names.join(", "));
                let remedy = match &self.body {
                    Body::Text(table) if self.names.len() < 2 => {
                        format!(
                            "cells were taken to have {} between them: set `separator` or `skip_rows` under [file]",
                            table.separator.name()
                        )
                    }
                    _ => "correct the name in the mapping".to_owned(),
                };
                Err(line(Finding::error(&self.file, rule, remedy)))
            }
        }
    }

    /// Whether there is a column of this name.
    #[must_use]
    pub fn has(&self, name: &str) -> bool {
        self.names.iter().any(|n| n == name)
    }

    /// A column as the table holds it: text of a text table.
    ///
    /// # Errors
    /// No such column.
    pub fn cells(&self, name: &str) -> Result<Cells, Finding> {
        let index = self.index(name)?;
        Ok(match &self.body {
            Body::Text(table) => Cells::Texts(table.column(index).map(str::to_owned).collect()),
            Body::Columns { columns, .. } => columns[index].clone(),
        })
    }

    /// A column as numbers; NaN where a cell is empty or says so.
    ///
    /// # Errors
    /// No such column, or a cell that is no number.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>, Finding> {
        let index = self.index(name)?;
        let texts = |cells: &mut dyn Iterator<Item = &str>| -> Result<Vec<f64>, Finding> {
            cells.enumerate().map(|(row, cell)| self.number(row, name, cell)).collect()
        };
        match &self.body {
            Body::Text(table) => texts(&mut table.column(index)),
            Body::Columns { columns, .. } => match &columns[index] {
                Cells::Numbers(values) => match values.iter().position(|v| v.is_infinite()) {
                    Some(row) => {
                        Err(self.refuse(row, Some(name), "the number is not finite", "take the row out, or empty the cell"))
                    }
                    None => Ok(values.clone()),
                },
                Cells::Texts(values) => texts(&mut values.iter().map(String::as_str)),
                Cells::Moments { .. } => Err(self.no_numbers(name, "moments in time")),
                Cells::Other(what) => Err(self.no_numbers(name, what)),
            },
        }
    }

    fn no_numbers(&self, name: &str, what: &str) -> Finding {
        Finding::error(
            &self.file,
            format!("column `{name}` holds {what}, not numbers"),
            "name a column of numbers in the mapping",
        )
    }

    /// The number in a cell; NaN where there is none.
    ///
    /// # Errors
    /// Text that is no number.
    pub fn number(&self, row: usize, name: &str, cell: &str) -> Result<f64, Finding> {
        let text = cell.trim();
        if NOTHING.contains(&text.to_ascii_lowercase().as_str()) {
            return Ok(f64::NAN);
        }
        let parsed = if self.decimal_comma {
            (!text.contains('.')).then(|| text.replace(',', ".")).and_then(|t| number(t.as_bytes()))
        } else {
            number(text.as_bytes())
        };
        parsed.ok_or_else(|| {
            let as_comma =
                !self.decimal_comma && text.matches(',').count() == 1 && number(text.replace(',', ".").as_bytes()).is_some();
            let as_point = self.decimal_comma && number(text.as_bytes()).is_some();
            let (rule, remedy) = if as_comma {
                ("the number has a decimal comma", "set `decimal = \",\"` under [file]")
            } else if as_point {
                ("the number has a decimal point where `decimal = \",\"` is set", "take `decimal` out of [file]")
            } else {
                ("the cell is no number", "correct it, or leave the cell empty where there is no reading")
            };
            self.refuse(row, Some(name), rule, remedy)
        })
    }

    /// A column as texts; numbers as they are usually written.
    ///
    /// # Errors
    /// No such column, or one of another type.
    pub fn texts(&self, name: &str) -> Result<Vec<String>, Finding> {
        match self.cells(name)? {
            Cells::Texts(texts) => Ok(texts),
            Cells::Numbers(numbers) => {
                Ok(numbers.iter().map(|v| if v.is_finite() { v.to_string() } else { String::new() }).collect())
            }
            Cells::Moments { ns, .. } => Ok(ns
                .iter()
                .map(|v| {
                    v.and_then(|ns| jiff::Timestamp::from_nanosecond(i128::from(ns)).ok())
                        .map_or_else(String::new, |t| t.to_string())
                })
                .collect()),
            Cells::Other(what) => {
                let rule = format!("column `{name}` holds {what}, not text");
                Err(Finding::error(&self.file, rule, "name another column in the mapping"))
            }
        }
    }
}

/// The binary format that a file begins with; absent for text.
pub(super) fn binary(path: &Path) -> Result<Option<Format>, Finding> {
    let mut begin = Vec::new();
    let file = open(path)?;
    file.take(BEGIN).read_to_end(&mut begin).map_err(|e| Finding::io(path, "read", &e))?;
    Ok(Format::of_begin(&begin))
}

/// Bytes that tell the format of a file.
const BEGIN: u64 = 8;

/// The bytes of a text of any size.
pub(super) fn whole(path: &Path) -> Result<(Vec<u8>, Digested), Finding> {
    let mut bytes = Vec::new();
    let digested = read_pieces(path, false, |piece| {
        let (Piece::Lines(new) | Piece::Rest(new) | Piece::Overlong(new)) = piece;
        bytes.try_reserve(new.len()).map_err(|e| Finding::io(path, "read", &std::io::Error::from(e)))?;
        bytes.extend_from_slice(new);
        let name = path.display().to_string();
        let overlong = matches!(piece, Piece::Overlong(_));
        let refuse = || Finding::error(&name, "a line is longer than any row of a table", "check that this is a table of text");
        if overlong { Err(refuse()) } else { Ok(()) }
    })?;
    Ok((bytes, digested))
}

#[cfg(feature = "tables")]
fn typed(path: &Path, format: Format) -> Result<Vec<(String, Cells)>, Finding> {
    crate::files::table::columns::read(path, format)
}

#[cfg(not(feature = "tables"))]
fn typed(path: &Path, format: Format) -> Result<Vec<(String, Cells)>, Finding> {
    let rule = format!("this calfit was built without the feature `tables` and cannot read {}", format.name());
    Err(Finding::error(&path.display().to_string(), rule, "build it with `--features tables`, or export the table as CSV"))
}
