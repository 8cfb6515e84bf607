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
