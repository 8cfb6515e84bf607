//! Tables of text in any dialect: separator, decimal comma, lines before the header line, encoding.

use crate::data::error::Finding;

/// What stands between two cells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Separator {
    /// One character.
    Char(char),
    /// Any number of blanks.
    Blanks,
}

impl Separator {
    /// Those that are looked for, the most telling first.
    pub const ALL: [Separator; 5] =
        [Separator::Char('\t'), Separator::Char(';'), Separator::Char('|'), Separator::Char(','), Separator::Blanks];

    /// The cells of a line with their places: begin and end, quotes included.
    #[must_use]
    pub fn cells(self, line: &str) -> Vec<(usize, usize)> {
        let mut cells = Vec::new();
        let (mut begin, mut quoted) = (0, false);
        for (at, c) in line.char_indices() {
            let ends = match self {
                Separator::Char(s) => c == s,
                Separator::Blanks => c == ' ' || c == '\t',
            };
            if c == '"' {
                quoted = !quoted;
            } else if ends && !quoted {
                if self != Separator::Blanks || at > begin {
                    cells.push((begin, at));
                }
                begin = at + c.len_utf8();
            }
        }
        if self != Separator::Blanks || begin < line.len() {
            cells.push((begin, line.len()));
        }
        cells
    }

    /// How it is written in a mapping.
    #[must_use]
    pub fn text(self) -> String {
        match self {
            Separator::Char(c) => c.to_string(),
            Separator::Blanks => " ".to_owned(),
        }
    }

    /// Its name in messages.
    #[must_use]
    pub fn name(self) -> String {
        match self {
            Separator::Char('\t') => "a tab".to_owned(),
            Separator::Char(c) => format!("`{c}`"),
            Separator::Blanks => "blanks".to_owned(),
        }
    }
}

/// How a table of text is written.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Dialect {
    /// What stands between cells; found where it is not given.
    pub separator: Option<Separator>,
    /// Whether numbers have a comma in place of the point.
    pub decimal_comma: bool,
    /// Lines before the header line.
    pub skip_rows: usize,
    /// Whether every byte is a character of ISO 8859-1.
    pub latin_1: bool,
}

/// A line of the table.
#[derive(Clone, Copy, Debug)]
pub(super) struct Line {
    /// Number, from 1.
    pub number: u64,
    begin: usize,
    end: usize,
}

/// A table of text: the lines of its rows.
#[derive(Clone, Debug)]
pub(super) struct TextTable {
    text: String,
    pub separator: Separator,
    pub names: Vec<String>,
    pub header_line: u64,
    pub rows: Vec<Line>,
}

/// A cell without blanks and quotes around it.
pub(super) fn bare(cell: &str) -> &str {
    let cell = cell.trim();
    cell.strip_prefix('"').and_then(|c| c.strip_suffix('"')).unwrap_or(cell).trim()
}

/// The text of the bytes of a file.
///
/// # Errors
/// Bytes that are no text of this encoding.
pub(super) fn decoded(file: &str, bytes: &[u8], latin_1: bool) -> Result<String, Finding> {
    if bytes.starts_with(&[0xff, 0xfe]) || bytes.starts_with(&[0xfe, 0xff]) {
        return Err(Finding::error(file, "the text is UTF-16", "convert it with `iconv -f UTF-16 -t UTF-8`").at(1, 1));
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    if let Some(at) = memchr::memchr(0, bytes) {
        let rule = "the file holds a NUL byte, which no table of text has";
        let line = memchr::memchr_iter(b'\n', &bytes[..at]).count() as u64 + 1;
        return Err(Finding::error(file, rule, "take the file from the archive again, or correct `file.format`").at(line, 0));
    }
    let text = if latin_1 {
        bytes.iter().map(|b| char::from(*b)).collect()
    } else {
        std::str::from_utf8(bytes)
            .map_err(|error| {
                let before = &bytes[..error.valid_up_to()];
                let line = memchr::memchr_iter(b'\n', before).count() as u64 + 1;
                let begin = memchr::memrchr(b'\n', before).map_or(0, |p| p + 1);
                let rest = bytes.get(begin..).unwrap_or_default();
                let end = memchr::memchr(b'\n', rest).unwrap_or(rest.len());
                Finding::error(file, "the line is no UTF-8 text", "set `encoding = \"latin-1\"` under [file]")
                    .at(line, (before.len() - begin) as u64 + 1)
                    .found(&rest[..end])
            })?
            .to_owned()
    };
    // Old software of one kind ends lines with CR alone.
    Ok(if text.contains('\n') { text } else { text.replace('\r', "\n") })
}

impl TextTable {
    /// Finds header line and rows.
    ///
    /// # Errors
    /// A file without a header line, or rows with another number of cells than it.
    pub fn parse(file: &str, bytes: &[u8], dialect: &Dialect) -> Result<Self, Finding> {
        let text = decoded(file, bytes, dialect.latin_1)?;
        let mut lines = Vec::new();
        let mut begin = 0;
        for (index, raw) in text.split('\n').enumerate() {
            let end = begin + raw.trim_end_matches('\r').len();
            if index >= dialect.skip_rows && !raw.trim().is_empty() && !raw.starts_with('#') {
                lines.push(Line { number: index as u64 + 1, begin, end });
            }
            begin += raw.len() + 1;
        }
        let Some(header) = lines.first().copied() else {
            let rule = if text.trim().is_empty() { "the file is empty" } else { "the table has no header line" };
            return Err(Finding::error(
                file,
                rule,
                "it needs a line with the names of the columns; see `skip_rows` under [file]",
            ));
        };
        let head = &text[header.begin..header.end];
        let separator = dialect.separator.unwrap_or_else(|| {
            let sample: Vec<&str> = lines.iter().take(SAMPLE).map(|l| &text[l.begin..l.end]).collect();
            found_separator(&sample, dialect.decimal_comma)
        });
        let names: Vec<String> = separator.cells(head).iter().map(|(b, e)| bare(&head[*b..*e]).to_owned()).collect();
        lines.remove(0);
        let table = Self { separator, names, header_line: header.number, rows: lines, text };
        table.check(file)?;
        Ok(table)
    }

    /// Every row has as many cells as the header line.
    fn check(&self, file: &str) -> Result<(), Finding> {
        let head = self.names.len();
        for row in &self.rows {
            let line = self.line(row);
            let count = self.separator.cells(line).len();
            // Some programs end every row, and not the header line, with a separator.
            let spare =
                count == head + 1 && line.trim_end().ends_with(&self.separator.text()) && self.separator != Separator::Blanks;
            if count != head && !spare {
                let rule =
                    format!("the row has {count} cells where the header line has {head}, with {} between", self.separator.name());
                let remedy = if count > head {
                    "correct the row; a decimal comma beside separating commas also makes cells: set `separator` and `decimal` under [file]"
                } else {
                    "complete the row or take it out; a line of units below the header line is skipped if it begins with #"
                };
                return Err(Finding::error(file, rule, remedy).at(row.number, 1).found(line.as_bytes()));
            }
        }
        Ok(())
    }

    /// The text of a row.
    pub fn line(&self, row: &Line) -> &str {
        self.text.get(row.begin..row.end).unwrap_or_default()
    }

    /// The cells of a column.
    pub fn column(&self, index: usize) -> impl Iterator<Item = &str> {
        self.rows.iter().map(move |row| {
            let line = self.line(row);
            let place = self.separator.cells(line).get(index).copied().unwrap_or((0, 0));
            bare(&line[place.0..place.1])
        })
    }

    /// Line, byte column from 1 and text of a cell.
    pub fn place(&self, row: usize, index: usize) -> Option<(u64, u64, &str)> {
        let row = self.rows.get(row)?;
        let line = self.line(row);
        let (begin, end) = self.separator.cells(line).get(index).copied()?;
        let cell = &line[begin..end];
        let blanks = cell.len() - cell.trim_start().len();
        Some((row.number, (begin + blanks) as u64 + 1, cell.trim()))
    }
}

/// Lines that are looked at for the separator.
const SAMPLE: usize = 50;

/// The separator that gives all lines the same number of cells; of several the one that gives most.
pub(super) fn found_separator(lines: &[&str], decimal_comma: bool) -> Separator {
    let score = |separator: &Separator| {
        let counts: Vec<usize> = lines.iter().map(|line| separator.cells(line).len()).collect();
        let first = counts.first().copied().unwrap_or(0);
        let equal = counts.iter().filter(|c| **c == first).count();
        (first > 1, equal, if *separator == Separator::Blanks { 0 } else { first })
    };
    let wanted = |s: &&Separator| !(decimal_comma && **s == Separator::Char(','));
    // The last of equals wins in `max_by_key`, the first one stands here before it.
    Separator::ALL.iter().rev().filter(wanted).max_by_key(|s| score(s)).copied().unwrap_or(Separator::Char(','))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(text: &str, dialect: &Dialect) -> Result<TextTable, Finding> {
        TextTable::parse("t.csv", text.as_bytes(), dialect)
    }

    #[test]
    fn separators_are_found() {
        for (text, separator) in [
            ("a;b\n1,5;2,5\n", Separator::Char(';')),
            ("a\tb c\n1\t2\n", Separator::Char('\t')),
            ("a,b\n1,2\n", Separator::Char(',')),
            ("a  b\n1    2\n", Separator::Blanks),
            ("a|b\n1|2\n", Separator::Char('|')),
            ("time, field x\n2026-01-01 00:00:00, 1\n2026-01-01 00:00:01, 2\n", Separator::Char(',')),
        ] {
            assert_eq!(table(text, &Dialect::default()).unwrap().separator, separator, "{text}");
        }
    }

    #[test]
    fn lines_before_the_header_comments_and_quotes_are_understood() {
        let dialect = Dialect { skip_rows: 1, ..Dialect::default() };
        let table = table("Lab 5; x\r\n# c\r\n\"t; s\";\"b\"\r\n1;\"2\"\r\n\r\n3;4\r\n", &dialect).unwrap();
        assert_eq!(table.names, ["t; s", "b"]);
        assert_eq!(table.column(1).collect::<Vec<_>>(), ["2", "4"]);
        assert_eq!((table.header_line, table.rows[1].number), (3, 6));
        assert_eq!(table.place(0, 1).unwrap(), (4, 3, "\"2\""));
    }

    #[test]
    fn rows_of_other_lengths_are_refused_with_their_line() {
        for (text, line) in [("a,b\n1,2\n3\n", 3), ("a,b\n1,2,3\n", 2), ("a;b\n1;2;3;\n", 2)] {
            assert_eq!(table(text, &Dialect::default()).unwrap_err().line, Some(line), "{text}");
        }
        assert!(table("a;b\n1;2;\n", &Dialect::default()).is_ok());
        for (text, words) in [("", "empty"), ("# only\n", "no header"), ("\u{0}a", "NUL")] {
            assert!(table(text, &Dialect::default()).unwrap_err().to_string().contains(words), "{text}");
        }
        let latin = TextTable::parse("t", b"t,\xb0C\n1,2\n", &Dialect::default()).unwrap_err();
        assert_eq!((latin.line, latin.column), (Some(1), Some(3)));
        let dialect = Dialect { latin_1: true, ..Dialect::default() };
        assert_eq!(TextTable::parse("t", b"t,\xb0C\n1,2\n", &dialect).unwrap().names[1], "°C");
    }
}
