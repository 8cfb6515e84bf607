//! What the text formats share: TOML keys with their place, CSV rows by column name, strict decimal numbers.

use crate::data::error::{Finding, Severity};
use std::borrow::Cow;
use std::collections::HashSet;
use toml_edit::{Document, Item, TableLike, Value};

/// Longest line that is looked at; a longer one is refused, so memory stays bounded.
pub const LONGEST_LINE: usize = 1 << 20;

/// Bytes as text: UTF-8, or Latin-1 where they are not UTF-8 (old notes with a degree sign).
#[must_use]
pub fn decode(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|b| char::from(*b)).collect()),
    }
}

/// Line and column, both from 1, of a byte offset in `text`, which begins at `first_line`.
fn place(text: &str, offset: usize, first_line: u64) -> (u64, u64) {
    let before = &text.as_bytes()[..offset.min(text.len())];
    let newlines = memchr::memchr_iter(b'\n', before).count() as u64;
    let column = before.len() - memchr::memrchr(b'\n', before).map_or(0, |p| p + 1);
    (first_line + newlines, column as u64 + 1)
}

/// TOML keys of a file or of a file's head, read with the place of every complaint.
pub struct Keys {
    file: String,
    first_line: u64,
    document: Document<String>,
}

impl Keys {
    /// Parses TOML text that begins at `first_line` of `file`.
    ///
    /// # Errors
    /// Text that is not TOML, with line and column.
    pub fn parse(file: &str, first_line: u64, text: String) -> Result<Self, Finding> {
        match Document::parse(text.clone()) {
            Ok(document) => Ok(Self { file: file.to_owned(), first_line, document }),
            Err(error) => {
                let span = error.span().unwrap_or(0..0);
                let (line, column) = place(&text, span.start, first_line);
                let offending = text.get(span).unwrap_or_default().to_owned();
                let message = error.message().trim().replace('\n', ", ");
                Err(Finding::error(file, format!("not a TOML key: {message}"), "write `key = value`, text in double quotes")
                    .at(line, column)
                    .found(offending.as_bytes()))
            }
        }
    }

    /// The table of all keys.
    #[must_use]
    pub fn root(&self) -> Group<'_> {
        Group { keys: self, name: String::new(), table: self.document.as_table() }
    }

    fn complaint(&self, item: &Item, rule: String, remedy: &str) -> Finding {
        let finding = Finding::error(&self.file, rule, remedy);
        match item.span() {
            Some(span) => {
                let (line, column) = place(self.document.raw(), span.start, self.first_line);
                let text = self.document.raw().get(span).unwrap_or_default();
                finding.at(line, column).found(text.as_bytes())
            }
            None => finding,
        }
    }
}

/// One table of [`Keys`].
pub struct Group<'a> {
    keys: &'a Keys,
    name: String,
    table: &'a dyn TableLike,
}

impl<'a> Group<'a> {
    fn full(&self, key: &str) -> String {
        if self.name.is_empty() { key.to_owned() } else { format!("{}.{key}", self.name) }
    }

    fn wrong(&self, item: &Item, key: &str, expected: &str) -> Finding {
        self.keys.complaint(item, format!("`{}` must be {expected}", self.full(key)), "correct the value")
    }

    /// An error about the value of a key.
    #[must_use]
    pub fn refuse(&self, key: &str, rule: &str, remedy: &str) -> Finding {
        let item = self.table.get(key);
        let rule = format!("`{}` {rule}", self.full(key));
        match item {
            Some(item) => self.keys.complaint(item, rule, remedy),
            None => Finding::error(&self.keys.file, rule, remedy),
        }
    }

    /// An error about a key that must be there.
    #[must_use]
    pub fn missing(&self, key: &str) -> Finding {
        Finding::error(&self.keys.file, format!("the key `{}` is missing", self.full(key)), "add it before the first section")
            .at(self.keys.first_line, 0)
    }

    fn value(&self, key: &str) -> Option<(&'a Item, Option<&'a Value>)> {
        self.table.get(key).map(|item| (item, item.as_value()))
    }

    /// Text.
    ///
    /// # Errors
    /// A value of another type.
    pub fn text(&self, key: &str) -> Result<Option<String>, Finding> {
        self.value(key)
            .map(|(item, value)| {
                value.and_then(Value::as_str).map(str::to_owned).ok_or_else(|| self.wrong(item, key, "text in double quotes"))
            })
            .transpose()
    }

    /// A finite number, whole or not.
    ///
    /// # Errors
    /// A value of another type, infinite or NaN.
    pub fn number(&self, key: &str) -> Result<Option<f64>, Finding> {
        self.value(key)
            .map(|(item, value)| value.and_then(as_number).ok_or_else(|| self.wrong(item, key, "a finite number")))
            .transpose()
    }

    /// A whole number that is not negative.
    ///
    /// # Errors
    /// A value of another type or sign.
    pub fn whole(&self, key: &str) -> Result<Option<u32>, Finding> {
        self.value(key)
            .map(|(item, value)| {
                value
                    .and_then(Value::as_integer)
                    .and_then(|v| u32::try_from(v).ok())
                    .ok_or_else(|| self.wrong(item, key, "a whole number, 0 or more"))
            })
            .transpose()
    }

    /// True or false.
    ///
    /// # Errors
    /// A value of another type.
    pub fn truth(&self, key: &str) -> Result<Option<bool>, Finding> {
        self.value(key)
            .map(|(item, value)| value.and_then(Value::as_bool).ok_or_else(|| self.wrong(item, key, "true or false")))
            .transpose()
    }

    /// A list of texts.
    ///
    /// # Errors
    /// A value of another type.
    pub fn texts(&self, key: &str) -> Result<Option<Vec<String>>, Finding> {
        self.list(key, "a list of texts", |v| v.as_str().map(str::to_owned))
    }

    /// A list of finite numbers.
    ///
    /// # Errors
    /// A value of another type.
    pub fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, Finding> {
        self.list(key, "a list of finite numbers", as_number)
    }

    /// Three finite numbers.
    ///
    /// # Errors
    /// A value of another type or length.
    pub fn three(&self, key: &str) -> Result<Option<[f64; 3]>, Finding> {
        let three = |values: Vec<f64>| {
            let wrong = |_| self.refuse(key, "must be three numbers", "write one per component or coil axis");
            values.try_into().map_err(wrong)
        };
        self.numbers(key)?.map(three).transpose()
    }

    fn list<T>(&self, key: &str, expected: &str, convert: impl Fn(&Value) -> Option<T>) -> Result<Option<Vec<T>>, Finding> {
        self.value(key)
            .map(|(item, value)| {
                value
                    .and_then(Value::as_array)
                    .and_then(|array| array.iter().map(&convert).collect::<Option<Vec<T>>>())
                    .ok_or_else(|| self.wrong(item, key, expected))
            })
            .transpose()
    }

    /// A table below this one.
    ///
    /// # Errors
    /// A value of another type.
    pub fn group(&self, key: &str) -> Result<Option<Group<'a>>, Finding> {
        self.table
            .get(key)
            .map(|item| {
                item.as_table_like()
                    .map(|table| Group { keys: self.keys, name: self.full(key), table })
                    .ok_or_else(|| self.wrong(item, key, "a table"))
            })
            .transpose()
    }

    /// The tables of an array of tables, `[[key]]`; empty if there is none.
    ///
    /// # Errors
    /// A value of another type.
    pub fn groups(&self, key: &str) -> Result<Vec<Group<'a>>, Finding> {
        let Some(item) = self.table.get(key) else { return Ok(Vec::new()) };
        let tables: Vec<&'a dyn TableLike> = if let Some(tables) = item.as_array_of_tables() {
            tables.iter().map(|t| t as &dyn TableLike).collect()
        } else if let Some(array) = item.as_array() {
            let tables: Option<Vec<_>> = array.iter().map(|v| v.as_inline_table().map(|t| t as &dyn TableLike)).collect();
            tables.ok_or_else(|| self.wrong(item, key, "an array of tables, `[[...]]`"))?
        } else {
            return Err(self.wrong(item, key, "an array of tables, `[[...]]`"));
        };
        let name = self.full(key);
        Ok(tables.into_iter().map(|table| Group { keys: self.keys, name: name.clone(), table }).collect())
    }

    /// A warning for every key that is not in `known`.
    #[must_use]
    pub fn unknown(&self, known: &[&str]) -> Vec<Finding> {
        self.table
            .iter()
            .filter(|(key, _)| !known.contains(key))
            .map(|(key, item)| {
                self.keys
                    .complaint(item, format!("the key `{}` is not known and was not used", self.full(key)), "check its spelling")
                    .weighing(Severity::Warning)
            })
            .collect()
    }
}

fn as_number(value: &Value) -> Option<f64> {
    let number = match value {
        Value::Float(v) => *v.value(),
        #[expect(clippy::cast_precision_loss, reason = "a whole number in a header is far below 2^53")]
        Value::Integer(v) => *v.value() as f64,
        _ => return None,
    };
    number.is_finite().then_some(number)
}

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

/// A finite decimal number: sign, digits, point, digits, exponent with `e` or `E`. Nothing else: no `nan`, `inf`, hexadecimal,
/// `1D+02`, decimal comma or Unicode minus.
#[must_use]
pub fn number(text: &[u8]) -> Option<f64> {
    let unsigned = text.strip_prefix(b"-").or_else(|| text.strip_prefix(b"+")).unwrap_or(text);
    let (mantissa, exponent) = match unsigned.iter().position(|b| matches!(b, b'e' | b'E')) {
        Some(at) => (&unsigned[..at], Some(&unsigned[at + 1..])),
        None => (unsigned, None),
    };
    let digits = mantissa.iter().filter(|b| b.is_ascii_digit()).count();
    let points = mantissa.iter().filter(|b| **b == b'.').count();
    if digits == 0 || points > 1 || digits + points != mantissa.len() {
        return None;
    }
    if let Some(exponent) = exponent {
        let power = exponent.strip_prefix(b"-").or_else(|| exponent.strip_prefix(b"+")).unwrap_or(exponent);
        if power.is_empty() || !power.iter().all(u8::is_ascii_digit) {
            return None;
        }
    }
    let value: f64 = std::str::from_utf8(text).ok()?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// Why a text is not a [`number`], and what to do.
#[must_use]
pub fn number_rule(text: &[u8]) -> (&'static str, &'static str) {
    let lower = text.to_ascii_lowercase();
    if text.is_empty() {
        ("is empty where a number is required", "write the value, or take the row out")
    } else if lower.windows(3).any(|w| w == b"nan" || w == b"inf") {
        ("is not finite", "take the row out or repair the value")
    } else if text.contains(&b';') || text.contains(&b',') {
        ("has a decimal comma or semicolons", "write numbers with a decimal point, cells separated by commas")
    } else if number_like_overflow(text) {
        ("is beyond the range of numbers", "repair the value")
    } else {
        ("is not a decimal number", "repair the value or take the row out")
    }
}

fn number_like_overflow(text: &[u8]) -> bool {
    std::str::from_utf8(text).ok().and_then(|t| t.parse::<f64>().ok()).is_some_and(f64::is_infinite)
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

/// A number with a fixed number of decimals, without a negative zero.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_decimal_numbers_are_numbers() {
        for (text, value) in [("1", 1.0), ("-0.5", -0.5), ("+2.", 2.0), (".25", 0.25), ("1e3", 1000.0), ("-1.5E-2", -0.015)] {
            assert_eq!(number(text.as_bytes()), Some(value), "{text}");
        }
        for text in [
            "",
            "-",
            ".",
            "nan",
            "NaN",
            "inf",
            "-Infinity",
            "1e999",
            "0x64",
            "1D+02",
            "\u{2212}5",
            "1,5",
            "1.2.3",
            "***",
            "ERR",
            "1e",
            "1e+",
            "--1",
            "1 2",
        ] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn many_digits_are_rounded_correctly() {
        assert_eq!(number(b"0.1000000000000000055511151231257827"), Some(0.1));
        assert_eq!(number(b"9007199254740993"), Some(9_007_199_254_740_992.0));
    }

    #[test]
    fn keys_are_reported_with_their_place() {
        let keys = Keys::parse("f", 2, "a = 1\nb = \"x\"\n".to_owned()).unwrap();
        let error = keys.root().number("b").unwrap_err();
        assert_eq!((error.line, error.column), (Some(3), Some(5)));
        let error = Keys::parse("f", 2, "a = 1\nb = \n".to_owned()).err().unwrap();
        assert_eq!(error.line, Some(3));
    }

    #[test]
    fn latin_1_is_kept() {
        assert_eq!(decode(b"17 \xb0C"), "17 °C");
    }
}
