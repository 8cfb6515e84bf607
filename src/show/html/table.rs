//! Tables, in a size at which they fit on paper.

use super::{escape, inline};
use crate::show::document::{Cell, Table};
use std::fmt::Write;

/// Words of tables that are longer may be broken anywhere on paper.
const LONG_WORD: usize = 18;
/// Columns of texts up to this length are not wrapped, those of longer ones keep some width.
const BRIEF: usize = 18;
const WORDS: usize = 60;
/// Tables of so many rows are not cut between pages.
const SHORT: usize = 15;

/// A table as HTML.
pub(super) fn table(table: &Table) -> String {
    let numeric: Vec<bool> = (0..table.head.len()).map(|i| is_numeric(table, i)).collect();
    let columns: Vec<Column> = (0..table.head.len()).map(|i| Column::of(table, i, numeric[i])).collect();
    let short = if table.rows.len() <= SHORT { " short" } else { "" };
    // Digits on a line of A4: 88 upright in the size of tables, 118 in small type, 150 and 205 across.
    let (class, focus) = match width(table, &numeric, false) {
        0..=88 => ("", ""),
        89..=118 => (" tight", " tabindex=\"0\""),
        119..=150 => (" wide", " tabindex=\"0\""),
        _ if width(table, &numeric, true) <= 205 => (" wide dense", " tabindex=\"0\""),
        // Words and numbers are broken anywhere rather than lost beyond the edge of the paper.
        _ => (" wide dense crammed", " tabindex=\"0\""),
    };
    let mut out = format!("<div class=\"scroll{short}{class}\"{focus}>\n<table>\n");
    if table.head.iter().any(|name| !name.is_empty()) {
        out.push_str("<thead>\n<tr>");
        for (name, column) in table.head.iter().zip(&columns) {
            let _ = write!(out, "<th scope=\"col\"{}>{}</th>", column.class_of(name, true), escape(name));
        }
        out.push_str("</tr>\n</thead>\n");
    }
    for (i, row) in table.rows.iter().enumerate() {
        out.push_str(if i == 0 { "<tbody>\n<tr>" } else { "<tr>" });
        for (cell, column) in row.iter().zip(&columns) {
            let html = if let Cell::Text(text) = cell { inline(text) } else { escape(&cell.plain()) };
            let _ = write!(out, "<td{}>{html}</td>", column.class_of(&cell.plain(), false));
        }
        out.push_str("</tr>\n");
    }
    if !table.rows.is_empty() {
        out.push_str("</tbody>\n");
    }
    out + "</table>\n</div>\n"
}

/// Whether a column is set right, so that its digits stand below each other: one of numbers alone, whose unit stands in the head.
fn is_numeric(table: &Table, column: usize) -> bool {
    let cells = || table.rows.iter().filter_map(|row| row.get(column));
    let bare = |cell: &Cell| matches!(cell, Cell::Number(number) if number.unit.is_empty());
    cells().any(bare) && cells().all(|cell| bare(cell) || matches!(cell, Cell::Missing(_)))
}

/// Width on paper in digits. Words are wrapped; numbers are not, unless `split` lets `a ± b` and every other text break at its blanks.
fn width(table: &Table, numeric: &[bool], split: bool) -> usize {
    let wanted = |text: &str, number: bool| {
        let length = text.chars().count();
        match (number, split) {
            (true, false) => length,
            (true, true) => text.split(' ').map(|part| part.chars().count()).max().unwrap_or(0),
            (false, false) => longest_word(text).min(LONG_WORD).max(length.min(20)),
            (false, true) => longest_word(text).min(LONG_WORD),
        }
    };
    let column = |i: usize| {
        let head = table.head.get(i).map(|name| wanted(name, false));
        let cells = table.rows.iter().filter_map(|row| row.get(i));
        let widths = cells.map(|cell| wanted(&cell.plain(), numeric[i] && matches!(cell, Cell::Number(_))));
        head.into_iter().chain(widths).max().unwrap_or(0) + if split { 1 } else { 2 }
    };
    (0..numeric.len()).map(column).sum()
}

/// How the cells of a column are set.
struct Column {
    numeric: bool,
    /// All its cells are short.
    brief: bool,
    /// It has sentences.
    words: bool,
}

impl Column {
    fn of(table: &Table, column: usize, numeric: bool) -> Self {
        let lengths = table.rows.iter().filter_map(|row| row.get(column)).map(|cell| cell.plain().chars().count());
        let longest = lengths.max().unwrap_or(0);
        Self { numeric, brief: longest <= BRIEF, words: longest > WORDS }
    }

    fn class_of(&self, plain: &str, head: bool) -> String {
        let words = [
            ("number", self.numeric),
            ("brief", self.brief && !self.numeric && !head),
            ("words", self.words && head),
            ("long", longest_word(plain) > LONG_WORD),
        ];
        let names: Vec<&str> = words.into_iter().filter(|(_, is)| *is).map(|(name, _)| name).collect();
        if names.is_empty() { String::new() } else { format!(" class=\"{}\"", names.join(" ")) }
    }
}

/// Length of the longest piece of a text that is not wrapped.
fn longest_word(text: &str) -> usize {
    text.split([' ', '-', '/']).map(|word| word.chars().count()).max().unwrap_or(0)
}
