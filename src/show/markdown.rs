//! Documents as Markdown.
//!
//! Words are written as they are: a report is read as plain text as often as through a viewer.

use super::document::{Block, Cell, Document, Figure, Inline, Section, Table, Text};
use std::fmt::Write;

/// The whole document with the mark of this program in its first line.
#[must_use]
pub fn page(document: &Document) -> String {
    let mut out = format!("<!-- written by calfit {} -->\n# {}\n\n", env!("CARGO_PKG_VERSION"), document.title);
    document.front.iter().for_each(|b| block(&mut out, b));
    document.sections.iter().for_each(|s| section(&mut out, s, 2));
    if let Some(colophon) = &document.colophon {
        let _ = writeln!(out, "---\n{}", text(colophon));
    }
    out
}

/// A table, legible as plain text as well: cells are padded so that columns stand below each other.
#[must_use]
pub fn aligned_table(table: &Table) -> String {
    let mut rows = rows(table);
    for column in 0..table.head.len() {
        let width = rows.iter().filter_map(|r| r.get(column)).map(|c| c.chars().count()).max().unwrap_or(0);
        for cell in rows.iter_mut().filter_map(|r| r.get_mut(column)) {
            let missing = width - cell.chars().count();
            cell.push_str(&" ".repeat(missing));
        }
    }
    table_of(&rows)
}

fn section(out: &mut String, section: &Section, level: usize) {
    let number = section.number.as_ref().map_or_else(String::new, |number| format!("{number} "));
    let _ = writeln!(out, "{} {number}{}\n", "#".repeat(level), text(&section.title));
    section.blocks.iter().for_each(|b| block(out, b));
    section.sections.iter().for_each(|s| self::section(out, s, level + 1));
}

/// A block and the empty line after it.
fn block(out: &mut String, block: &Block) {
    match block {
        // An empty paragraph is one more empty line.
        Block::Text(words) if words.0.is_empty() => {}
        Block::Text(words) => {
            let _ = writeln!(out, "{}", text(words));
        }
        Block::List(items) => items.iter().for_each(|item| {
            let _ = writeln!(out, "- {}", text(item));
        }),
        Block::Table(table) => out.push_str(&table_of(&rows(table))),
        Block::Code(lines) => lines.lines().for_each(|line| {
            let _ = writeln!(out, "    {line}");
        }),
        Block::Note(note) => {
            let _ = writeln!(out, "> **WARNING** {note}");
        }
        Block::Figure(figure) => picture(out, figure),
    }
    out.push('\n');
}

fn picture(out: &mut String, Figure { file, number, title, caption }: &Figure) {
    // The caption is drawn in the picture; here it is for those who cannot see it.
    let (caption, title) = (caption.replace(['[', ']'], ""), title.replace('"', "'"));
    let _ = writeln!(out, "![{caption}]({file} \"Figure {number}: {title}\")");
}

fn text(text: &Text) -> String {
    let mut out = String::new();
    for inline in &text.0 {
        let _ = match inline {
            Inline::Plain(words) => write!(out, "{words}"),
            Inline::Code(code) => write!(out, "`{code}`"),
            Inline::Strong(words) => write!(out, "**{words}**"),
            Inline::Link { words, to } => write!(out, "[{words}]({to})"),
        };
    }
    out
}

/// The head and the rows of a table as text.
fn rows(table: &Table) -> Vec<Vec<String>> {
    let cell = |cell: &Cell| if let Cell::Text(words) = cell { text(words) } else { cell.plain() };
    let rows = table.rows.iter().map(|row| row.iter().map(cell).collect());
    std::iter::once(table.head.clone()).chain(rows).collect()
}

/// A table; the first row is its head.
fn table_of(rows: &[Vec<String>]) -> String {
    let mut out = String::new();
    for (i, row) in rows.iter().enumerate() {
        let cells: Vec<String> = row.iter().map(|c| c.replace('|', "\\|")).collect();
        let _ = writeln!(out, "| {} |", cells.join(" | "));
        if i == 0 {
            let _ = writeln!(out, "|{}", "---|".repeat(row.len()));
        }
    }
    out
}
