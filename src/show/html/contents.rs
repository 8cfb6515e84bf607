//! Headings with their places, and the table of contents.

use super::{escape, inline};
use crate::show::document::{Document, Inline, Section, Text};
use std::collections::HashSet;
use std::fmt::Write;

/// Target of the links "contents".
pub(super) const CONTENTS: &str = "contents";

/// A heading of the page.
pub(super) struct Heading {
    /// 1 for the title, 2 for a chapter, 3 and more for what is below.
    pub level: usize,
    /// Its place in the page.
    pub id: String,
    /// Its text as HTML without links.
    pub html: String,
}

/// The title and the headings of all sections, in the order of the document.
pub(super) fn headings(document: &Document) -> Vec<Heading> {
    let mut used = HashSet::from([CONTENTS.to_owned()]);
    let title = Heading { level: 1, id: unique(&slug(&document.title), &mut used), html: escape(&document.title) };
    let mut found = vec![title];
    document.sections.iter().for_each(|section| add(section, 2, &mut found, &mut used));
    found
}

fn add(section: &Section, level: usize, found: &mut Vec<Heading>, used: &mut HashSet<String>) {
    let words = Text(section.title.0.iter().map(without_link).collect());
    let html = match &section.number {
        // Contents and headings set the number apart from the words.
        Some(number) => format!("<span class=\"count\">{}</span><span> {}</span>", escape(number), inline(&words)),
        None => inline(&words),
    };
    found.push(Heading { level, id: unique(&slug(&section.heading()), used), html });
    section.sections.iter().for_each(|below| add(below, level + 1, found, used));
}

/// A heading stands inside of links to it, where another link cannot stand.
fn without_link(inline: &Inline) -> Inline {
    match inline {
        Inline::Link { words, .. } => Inline::Plain(words.clone()),
        other => other.clone(),
    }
}

/// The name that common Markdown viewers give to a heading, so that links inside the text hold there and here.
fn slug(plain: &str) -> String {
    let lower = plain.trim().to_lowercase();
    let kept = lower.chars().filter(|c| c.is_alphanumeric() || matches!(c, ' ' | '-' | '_'));
    kept.map(|c| if c == ' ' { '-' } else { c }).collect()
}

fn unique(name: &str, used: &mut HashSet<String>) -> String {
    let name = if name.is_empty() { "section" } else { name };
    let mut id = name.to_owned();
    let mut count = 0;
    while !used.insert(id.clone()) {
        count += 1;
        id = format!("{name}-{count}");
    }
    id
}

/// The table of contents: chapters, and below them their sections.
pub(super) fn contents(headings: &[Heading]) -> String {
    let mut out = format!("<nav class=\"contents\" id=\"{CONTENTS}\" aria-label=\"Contents\">\n");
    let entry = |h: &Heading| format!("<a href=\"#{}\">{}</a>", escape(&h.id), h.html);
    let (mut chapter, mut below) = (false, false);
    for h in headings {
        match h.level {
            1 => {
                let _ = write!(out, "<p class=\"title\">{}</p>\n<ol>\n", entry(h));
            }
            2 => {
                out.push_str(if below { "</ol>\n" } else { "" });
                out.push_str(if chapter { "</li>\n" } else { "" });
                let _ = write!(out, "<li>{}", entry(h));
                (chapter, below) = (true, false);
            }
            3 => {
                out.push_str(if below { "" } else { "\n<ol>\n" });
                let _ = writeln!(out, "<li>{}</li>", entry(h));
                below = true;
            }
            _ => {}
        }
    }
    out.push_str(if below { "</ol>\n" } else { "" });
    out.push_str(if chapter { "</li>\n" } else { "" });
    out + "</ol>\n</nav>\n"
}
