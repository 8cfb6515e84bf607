//! TOML keys with the place of every complaint.

use crate::data::error::{Finding, Severity};
use std::ops::Range;
use toml_edit::{Document, Item, Table, TableLike, Value};

/// Where the lines of a text begin, found once: a text may have as many complaints as lines.
struct Lines {
    /// Number of the first line.
    first: u64,
    /// Byte offsets of the ends of the lines, rising.
    ends: Vec<usize>,
}

impl Lines {
    fn of(text: &str, first: u64) -> Self {
        Self { first, ends: memchr::memchr_iter(b'\n', text.as_bytes()).collect() }
    }

    /// Line and column, the column from 1, of a byte offset.
    fn place(&self, offset: usize) -> (u64, u64) {
        let before = self.ends.partition_point(|end| *end < offset);
        let begin = before.checked_sub(1).map_or(0, |last| self.ends[last] + 1);
        (self.first + before as u64, (offset - begin) as u64 + 1)
    }
}

/// TOML keys of a file or of a file's head, read with the place of every complaint.
pub struct Keys {
    file: String,
    lines: Lines,
    document: Document<String>,
}

impl Keys {
    /// Parses TOML text that begins at `first_line` of `file`.
    ///
    /// # Errors
    /// Text that is not TOML, with line and column.
    pub fn parse(file: &str, first_line: u64, text: String) -> Result<Self, Finding> {
        let lines = Lines::of(&text, first_line);
        match Document::parse(text.clone()) {
            Ok(document) => Ok(Self { file: file.to_owned(), lines, document }),
            Err(error) => {
                let span = error.span().unwrap_or(0..0);
                let (line, column) = lines.place(span.start.min(text.len()));
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
        Group { keys: self, name: String::new(), table: self.document.as_table(), begin: None }
    }

    /// All keys as a table of TOML.
    #[must_use]
    pub fn table(&self) -> &Table {
        self.document.as_table()
    }

    fn complaint(&self, item: &Item, rule: String, remedy: &str) -> Finding {
        let finding = Finding::error(&self.file, rule, remedy);
        match item.span() {
            Some(span) => {
                let (line, column) = self.lines.place(span.start);
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
    /// Byte offset of its begin; that of all keys has none.
    begin: Option<usize>,
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
        let rule = format!("the key `{}` is missing", self.full(key));
        if self.name.is_empty() {
            return Finding::error(&self.keys.file, rule, "add it before the first section").at(self.keys.lines.first, 0);
        }
        let finding = Finding::error(&self.keys.file, rule, format!("add it to the section `{}`", self.name));
        // Sections of one name are told apart by their lines.
        match self.begin {
            Some(begin) => finding.at(self.keys.lines.place(begin).0, 0),
            None => finding,
        }
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

    /// A list of texts, or one that stands for a list of one.
    ///
    /// # Errors
    /// A value of another type.
    pub fn texts_or_one(&self, key: &str) -> Result<Option<Vec<String>>, Finding> {
        match self.value(key) {
            Some((_, Some(Value::Array(_)))) => self.texts(key),
            _ => Ok(self.text(key)?.map(|text| vec![text])),
        }
    }

    /// Rows of texts or numbers, the numbers as they are written.
    ///
    /// # Errors
    /// Something else stands there.
    pub fn text_rows(&self, key: &str) -> Result<Option<Vec<Vec<String>>>, Finding> {
        let cell = |value: &Value| match value {
            Value::String(text) => Some(text.value().clone()),
            Value::Integer(_) | Value::Float(_) => Some(value.to_string().trim().to_owned()),
            _ => None,
        };
        self.list(key, "a list of rows of texts or numbers", |v| v.as_array()?.iter().map(cell).collect())
    }

    /// A list of finite numbers.
    ///
    /// # Errors
    /// A value of another type.
    pub fn numbers(&self, key: &str) -> Result<Option<Vec<f64>>, Finding> {
        self.list(key, "a list of finite numbers", as_number)
    }

    /// A list of finite numbers, or one that stands for a list of one.
    ///
    /// # Errors
    /// A value of another type.
    pub fn numbers_or_one(&self, key: &str) -> Result<Option<Vec<f64>>, Finding> {
        match self.value(key) {
            Some((_, Some(Value::Array(_)))) => self.numbers(key),
            _ => Ok(self.number(key)?.map(|value| vec![value])),
        }
    }

    /// Rows of finite numbers.
    ///
    /// # Errors
    /// Something else stands there.
    pub fn rows(&self, key: &str) -> Result<Option<Vec<Vec<f64>>>, Finding> {
        self.list(key, "a list of rows of finite numbers", |v| v.as_array()?.iter().map(as_number).collect())
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

    /// Three rows of three finite numbers.
    ///
    /// # Errors
    /// A value of another type or length.
    pub fn three_rows(&self, key: &str) -> Result<Option<[[f64; 3]; 3]>, Finding> {
        let expected = "three rows of three finite numbers";
        let row = |v: &Value| -> Option<[f64; 3]> {
            let numbers: Vec<f64> = v.as_array()?.iter().map(as_number).collect::<Option<_>>()?;
            numbers.try_into().ok()
        };
        let rows = self.list(key, expected, row)?;
        let three =
            |rows: Vec<[f64; 3]>| rows.try_into().map_err(|_| self.refuse(key, &format!("must be {expected}"), "add rows"));
        rows.map(three).transpose()
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
                    .map(|table| Group {
                        keys: self.keys,
                        name: self.full(key),
                        table,
                        begin: item.span().map(|span| span.start),
                    })
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
        let tables: Vec<(&'a dyn TableLike, Option<Range<usize>>)> = if let Some(tables) = item.as_array_of_tables() {
            tables.iter().map(|t| (t as &dyn TableLike, t.span())).collect()
        } else if let Some(array) = item.as_array() {
            let table = |v: &'a Value| v.as_inline_table().map(|t| (t as &dyn TableLike, t.span()));
            let tables: Option<Vec<_>> = array.iter().map(table).collect();
            tables.ok_or_else(|| self.wrong(item, key, "an array of tables, `[[...]]`"))?
        } else {
            return Err(self.wrong(item, key, "an array of tables, `[[...]]`"));
        };
        let name = self.full(key);
        let group = |(table, span): (&'a dyn TableLike, Option<Range<usize>>)| Group {
            keys: self.keys,
            name: name.clone(),
            table,
            begin: span.map(|span| span.start),
        };
        Ok(tables.into_iter().map(group).collect())
    }

    /// Names of the keys in their order.
    #[must_use]
    pub fn names(&self) -> Vec<&'a str> {
        self.table.iter().map(|(name, _)| name).collect()
    }

    /// Refuses keys that are not in `known`.
    ///
    /// # Errors
    /// The first of them, with the nearest known one.
    pub fn only(&self, known: &[&str]) -> Result<(), Finding> {
        let Some(name) = self.names().into_iter().find(|name| !known.contains(name)) else { return Ok(()) };
        Err(self.refuse(name, "is not known", &nearest(name, known)))
    }

    /// A warning for every key that is not in `known`, with the nearest known one.
    #[must_use]
    pub fn unknown(&self, known: &[&str]) -> Vec<Finding> {
        self.table
            .iter()
            .filter(|(key, _)| !known.contains(key))
            .map(|(key, item)| {
                let rule = format!("the key `{}` is not known and was not used", self.full(key));
                self.keys.complaint(item, rule, &nearest(key, known)).weighing(Severity::Warning)
            })
            .collect()
    }
}

/// What the remedy says of a key that is nearly a known one.
pub const NEAREST: &str = "the nearest known key";

/// The remedy for a key that is not known.
fn nearest(name: &str, known: &[&str]) -> String {
    let nearest = known.iter().map(|key| (distance(name, key), *key)).min_by_key(|(letters, _)| *letters);
    match nearest {
        // A slip changes a letter of three at most; other keys have nothing to do with it.
        Some((letters, key)) if 3 * letters <= name.chars().count().max(3) => format!("{NEAREST} is `{key}`"),
        _ => format!("known keys here are {}", known.iter().map(|key| format!("`{key}`")).collect::<Vec<_>>().join(", ")),
    }
}

/// Letters to change, add or take away to come from one word to another (Levenshtein).
fn distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, letter) in a.chars().enumerate() {
        let mut before = i;
        row[0] = i + 1;
        for (k, other) in b.iter().enumerate() {
            let here = (before + usize::from(letter != *other)).min(row[k] + 1).min(row[k + 1] + 1);
            before = row[k + 1];
            row[k + 1] = here;
        }
    }
    row[b.len()]
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

#[cfg(test)]
mod tests {
    use super::Lines;

    #[test]
    fn places_are_those_of_counting() {
        let text = "a = 1\n\nlong = [\n1,\n 2]\n";
        let lines = Lines::of(text, 7);
        for offset in 0..text.len() {
            let before = &text[..offset];
            let column = before.rsplit('\n').next().unwrap().len() + 1;
            assert_eq!(lines.place(offset), (7 + before.matches('\n').count() as u64, column as u64), "offset {offset}");
        }
    }
}
