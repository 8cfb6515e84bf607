//! Documents as Markdown.
//!
//! Words are written as they are: a report is read as plain text as often as through a viewer. Only what a viewer would take for HTML or for
//! a link, and what is not seen, is marked: names come from files.

use super::document::{Block, Cell, Document, Figure, Inline, Section, Table, Text};
use crate::data::plain::{one_line, shown};
use std::borrow::Cow;
use std::fmt::Write;

/// The whole document with the mark of this program in its first line.
#[must_use]
pub fn page(document: &Document) -> String {
    let mut out = format!("<!-- written by calfit {} -->\n# {}\n\n", env!("CARGO_PKG_VERSION"), words(&document.title));
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
            let _ = writeln!(out, "    {}", shown(line));
        }),
        Block::Note(note) => {
            let _ = writeln!(out, "> **WARNING** {}", text(&Text::of_note(&note.to_string())));
        }
        Block::Figure(figure) => picture(out, figure),
    }
    out.push('\n');
}

fn picture(out: &mut String, Figure { file, number, title, caption }: &Figure) {
    // The caption is drawn in the picture; here it is for those who cannot see it.
    let (caption, title) = (words(caption).replace(['[', ']'], ""), words(title).replace('"', "'"));
    let _ = writeln!(out, "![{caption}]({} \"Figure {number}: {title}\")", place(file));
}

/// Words in which a viewer sees neither HTML nor links.
fn words(text: &str) -> Cow<'_, str> {
    let text = one_line(text);
    let is_tag = |(at, _): &(usize, &str)| text[at + 1..].starts_with(|c: char| c.is_alphabetic() || "/!?".contains(c));
    if !text.contains("](") && !text.match_indices('<').any(|found| is_tag(&found)) {
        return text;
    }
    let mut out = text.replace("](", "]\\(");
    for (at, _) in text.match_indices('<').filter(is_tag).collect::<Vec<_>>().into_iter().rev() {
        let before = text[..at].matches("](").count();
        out.insert(at + before, '\\');
    }
    Cow::Owned(out)
}

/// Code between so many backticks that those in it do not end it.
fn code(text: &str) -> String {
    let text = one_line(text);
    let longest = text.split(|c| c != '`').map(str::len).max().unwrap_or(0);
    let fence = "`".repeat(longest + 1);
    if longest == 0 { format!("`{text}`") } else { format!("{fence} {text} {fence}") }
}

/// A place to which a link leads, without what would end it.
fn place(to: &str) -> String {
    let mut out = String::new();
    for c in to.chars() {
        if c.is_whitespace() || crate::data::plain::is_unseen(c) || "()<>".contains(c) {
            c.encode_utf8(&mut [0; 4]).bytes().for_each(|b| {
                let _ = write!(out, "%{b:02X}");
            });
        } else {
            out.push(c);
        }
    }
    out
}

fn text(text: &Text) -> String {
    let mut out = String::new();
    for inline in &text.0 {
        let _ = match inline {
            Inline::Plain(plain) => write!(out, "{}", words(plain)),
            Inline::Code(text) => write!(out, "{}", code(text)),
            Inline::Strong(plain) => write!(out, "**{}**", words(plain)),
            Inline::Link { words: plain, to } => write!(out, "[{}]({})", words(plain), place(to)),
        };
    }
    out
}

/// The head and the rows of a table as text.
fn rows(table: &Table) -> Vec<Vec<String>> {
    let cell = |cell: &Cell| if let Cell::Text(words) = cell { text(words) } else { words(&cell.plain()).into_owned() };
    let rows = table.rows.iter().map(|row| row.iter().map(cell).collect());
    let head = table.head.iter().map(|name| words(name).into_owned()).collect();
    std::iter::once(head).chain(rows).collect()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::note::{Note, NoteKind};
    use crate::show::document::cells;

    #[test]
    fn a_document_is_written_as_it_always_was() {
        let figure =
            Figure { file: "a/b.png".to_owned(), number: 7, title: "A \"slope\"".to_owned(), caption: "It [rises]".to_owned() };
        let table = Table::new(["a", "b"]).with_rows([cells![Text::default().code("x|y"), Cell::uncertain(1.5, 0.25)]]);
        let below = Section::new("Matrix").numbered("1.1").with(Block::Code("+1  +0\n+0  +1\n".to_owned())).with(table);
        let document = Document {
            title: "T".to_owned(),
            front: vec![Note::new(NoteKind::Fit, "the residuals follow the time").into()],
            sections: vec![
                Section::new("Sensor")
                    .numbered("1")
                    .with(Text::from("In ").code("run").and(", ").strong("twice").and(".").link("2", "#2-b"))
                    .with(Block::List(vec!["a".into(), "b".into()]))
                    .with_sections([below]),
                Section::new("B").with(figure).with(""),
            ],
            colophon: Some("Made.".into()),
        };
        let (_, text) = page(&document).split_once('\n').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        assert_eq!(
            text,
            "# T\n\n> **WARNING** FIT: the residuals follow the time\n\n## 1 Sensor\n\nIn `run`, **twice**.[2](#2-b)\n\n- a\n- b\n\n\
             ### 1.1 Matrix\n\n    +1  +0\n    +0  +1\n\n| a | b |\n|---|---|\n| `x\\|y` | +1.50 ± 0.25 |\n\n\
             ## B\n\n![It rises](a/b.png \"Figure 7: A 'slope'\")\n\n\n---\nMade.\n"
        );
    }

    #[test]
    fn columns_of_an_aligned_table_stand_below_each_other() {
        let table = Table::new(["file", "n"]).with_rows([cells!["Φ", 12_usize], cells!["longer", 3_usize]]);
        assert_eq!(aligned_table(&table), "| file   | n  |\n|---|---|\n| Φ      | 12 |\n| longer | 3  |\n");
    }
}
