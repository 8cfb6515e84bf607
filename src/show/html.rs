//! Documents as one page for a browser: with the pictures inside, contents, and a style sheet for A4 paper.
//!
//! The page needs no other file, no network and no script. Nothing of the text is taken for HTML, and the page forbids the
//! browser to run or to load anything, so that a remark copied from a data file stays a remark. Numbers of chapters and figures
//! are those of the document; the page prints them and counts nothing.

mod contents;
mod picture;
mod table;

use super::document::{Block, Document, Inline, Section, Text};
use contents::{CONTENTS, Heading, contents, headings};
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");

/// Writes a document as one self-contained HTML page.
///
/// Sections of the document are chapters of the page, those below them begin a part of their own. `picture` is asked for the bytes
/// of a picture by the path that the figure gives; it is only asked for paths that stay inside the folder of the document. What it
/// does not find, or what is not a whole PNG, JPEG, GIF, WebP or SVG picture, is replaced by a note.
///
/// The title of the document is also that of the browser window and of the printed pages. Equal input gives equal bytes.
#[must_use]
pub fn page(document: &Document, picture: &mut dyn FnMut(&str) -> Option<Vec<u8>>) -> String {
    let headings = headings(document);
    let version = env!("CARGO_PKG_VERSION");
    let shown = escape(&document.title);
    let mut body = Body { headings: &headings, begun: 0, picture, out: String::new() };
    body.document(document);
    let main = body.out;
    // The mark stands in front of the document type, as in all files of the tool. Browsers allow comments there.
    format!(
        "<!-- written by calfit {version} -->\n<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
         base-uri 'none'; form-action 'none'\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{shown}</title>\n\
         <meta name=\"generator\" content=\"calfit {version}\">\n<style>\n{STYLE}@page {{ @top-left {{ content: \"{}\" }} }}\n</style>\n\
         </head>\n<body>\n<main>\n{main}</main>\n</body>\n</html>\n",
        style_string(&document.title)
    )
}

/// Text as HTML text or as the value of an attribute in double quotes.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out.push_str("&amp;"),
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '"' => out.push_str("&quot;"),
            '\n' | '\t' => out.push(c),
            // HTML allows no control characters.
            c if c.is_control() => out.push('\u{fffd}'),
            c => out.push(c),
        }
    }
    out
}

/// Text inside a string of a style sheet.
fn style_string(text: &str) -> String {
    let mut out = String::new();
    for c in text.chars() {
        if c.is_ascii_alphanumeric() || c == ' ' {
            out.push(c);
        } else if !c.is_control() {
            let _ = write!(out, "\\{:x} ", c as u32);
        }
    }
    out
}

/// Text inside a paragraph, a cell or a heading.
fn inline(text: &Text) -> String {
    let mut out = String::new();
    for inline in &text.0 {
        let _ = match inline {
            Inline::Plain(words) => write!(out, "{}", escape(words)),
            Inline::Code(code) => write!(out, "<code>{}</code>", escape(code)),
            Inline::Strong(words) => write!(out, "<strong>{}</strong>", escape(words)),
            Inline::Link { words, to } if is_harmless(to) => {
                write!(out, "<a href=\"{}\">{}</a>", escape(to), escape(words))
            }
            Inline::Link { words, .. } => write!(out, "{}", escape(words)),
        };
    }
    out
}

/// Whether a link leads to a place in the text, to a file beside it, to a web page or to a mailbox, and not to a program.
fn is_harmless(link: &str) -> bool {
    let scheme = link.split(['/', '?', '#']).next().unwrap_or_default().split_once(':').map(|(scheme, _)| scheme);
    !link.starts_with("//")
        && !link.contains('\\')
        && !link.chars().any(char::is_control)
        && scheme.is_none_or(|s| ["http", "https", "mailto"].iter().any(|known| s.eq_ignore_ascii_case(known)))
}

struct Body<'a> {
    headings: &'a [Heading],
    /// Headings written so far.
    begun: usize,
    picture: &'a mut dyn FnMut(&str) -> Option<Vec<u8>>,
    out: String,
}

impl Body<'_> {
    fn document(&mut self, document: &Document) {
        self.out.push_str("<div class=\"front\">\n<div class=\"part\">\n");
        self.heading();
        self.blocks(&document.front);
        if document.sections.is_empty() {
            self.colophon(document.colophon.as_ref());
        }
        self.out.push_str("</div>\n</div>\n");
        self.out.push_str(&contents(self.headings));
        let last = document.sections.len().saturating_sub(1);
        for (i, section) in document.sections.iter().enumerate() {
            self.chapter(section, document.colophon.as_ref().filter(|_| i == last));
        }
    }

    /// A chapter with links to its neighbours.
    fn chapter(&mut self, section: &Section, colophon: Option<&Text>) {
        let Some((before, [own, after @ ..])) = self.headings.split_at_checked(self.begun) else { return };
        let link = |name: &str, heading: Option<&Heading>| {
            heading.map_or_else(
                || "<span></span>".to_owned(),
                |h| format!("<a class=\"{name}\" href=\"#{}\"><b>{name}</b> {}</a>", escape(&h.id), h.html),
            )
        };
        let previous = link("previous", before.iter().rev().find(|h| h.level <= 2));
        let next = link("next", after.iter().find(|h| h.level == 2));
        let _ = writeln!(self.out, "<section class=\"chapter\" aria-labelledby=\"{}\">\n<div class=\"part\">", escape(&own.id));
        self.section(section);
        self.colophon(colophon);
        let _ = write!(
            self.out,
            "</div>\n<nav class=\"turn\" aria-label=\"Chapters\">\n{previous}\n<a href=\"#{CONTENTS}\"><b>contents</b></a>\n{next}\n</nav>\n</section>\n"
        );
    }

    /// A section with those below it. One of the third level begins a part; a part with a wide table is printed across.
    fn section(&mut self, section: &Section) {
        if self.headings.get(self.begun).is_some_and(|h| h.level == 3) {
            self.out.push_str("</div>\n<div class=\"part\">\n");
        }
        self.heading();
        self.blocks(&section.blocks);
        section.sections.iter().for_each(|below| self.section(below));
    }

    fn heading(&mut self) {
        if let Some(Heading { level, id, html }) = self.headings.get(self.begun) {
            // HTML knows six levels.
            let level = level.min(&6);
            let _ = writeln!(self.out, "<h{level} id=\"{}\">{html}</h{level}>", escape(id));
        }
        self.begun += 1;
    }

    fn colophon(&mut self, colophon: Option<&Text>) {
        if let Some(text) = colophon {
            let _ = writeln!(self.out, "<hr>\n<p>{}</p>", inline(text));
        }
    }

    fn blocks(&mut self, blocks: &[Block]) {
        for block in blocks {
            let out = &mut self.out;
            let _ = match block {
                Block::Text(text) if text.0.is_empty() => Ok(()),
                Block::Text(text) => writeln!(out, "<p>{}</p>", inline(text)),
                Block::List(items) => {
                    let items: String = items.iter().map(|item| format!("<li>{}</li>\n", inline(item))).collect();
                    writeln!(out, "<ul>\n{items}</ul>")
                }
                Block::Table(table) => write!(out, "{}", table::table(table)),
                Block::Code(lines) => writeln!(out, "<pre><code>{}\n</code></pre>", escape(lines.trim_end_matches('\n'))),
                Block::Note(note) => {
                    let text = inline(&Text::of_note(&format!(" {note}")));
                    writeln!(out, "<blockquote class=\"warning\">\n<p><strong>WARNING</strong>{text}</p>\n</blockquote>")
                }
                Block::Figure(figure) => {
                    picture::figure(out, figure, self.picture);
                    Ok(())
                }
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::note::{Note, NoteKind};
    use crate::show::document::{Cell, Figure, Table, cells};

    const PIXEL: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x02\0\0\0\x03\x08\0\0\0\0\0\0\0\0\0\0\0\0IEND\xaeB`\x82";

    fn shown(document: &Document) -> String {
        page(document, &mut |path| path.ends_with("there.png").then(|| PIXEL.to_vec()))
    }

    /// A document with a title and blocks in front of all sections.
    fn front(title: &str, front: Vec<Block>) -> Document {
        Document { title: title.to_owned(), front, ..Document::default() }
    }

    fn figure(number: usize, file: &str, title: &str, caption: &str) -> Block {
        Block::Figure(Figure { file: file.to_owned(), number, title: title.to_owned(), caption: caption.to_owned() })
    }

    #[test]
    fn nothing_of_the_text_is_taken_for_html() {
        let section = Section::new("<b>x</b> & \"y\"")
            .with("<img src=x onerror=alert(1)>")
            .with(Text::from("inline <i>z</i> ").code("<u>").strong("<i>").link("<i>", "\"><i>").link("j", "javascript:alert(1)"))
            .with(Table::new(["<a>"]).with_rows([cells!["<s>"]]))
            .with(figure(1, "\"><q>.png", "<r>", "<p>\""))
            .with(Block::Code("\"><h1>\n</code><h2>\n".to_owned()))
            .with(Block::List(vec!["<i>".into()]))
            .with(Note::new(NoteKind::Fit, "<h3>"));
        let mut document = front("</title></style><script>", Vec::new());
        document.sections.push(section);
        let page = page(&document, &mut |_| None);
        for tag in ["<script", "<b>x", "<i>", "<u>", "<s>", "<img", "<q>", "<r>", "<h2>\n", "<h3>", "href=\"j", "</style><"] {
            assert!(!page.contains(tag), "{tag} in {page}");
        }
        assert!(page.contains("&lt;img src=x onerror=alert(1)&gt;"));
        assert_eq!(page.matches("</style>").count(), 1);
    }

    #[test]
    fn comments_are_text_and_the_mark_stands_first() {
        let page = shown(&front("A", vec!["<!-- a -->c".into(), "d <!-- e".into()]));
        assert!(page.contains("<h1 id=\"a\">A</h1>"));
        assert!(page.contains("<p>&lt;!-- a --&gt;c</p>") && page.contains("<p>d &lt;!-- e</p>"), "{page}");
        assert_eq!(page.matches("<!--").count(), 1);
        assert!(page.starts_with("<!-- written by calfit "));
    }

    #[test]
    fn headings_have_ids_of_their_own_and_stand_in_the_contents() {
        let section = |number: &str, title: Text| Section::new(title).numbered(number);
        let document = Document {
            title: "T".to_owned(),
            sections: vec![
                section("1", "A".into()).with_sections([
                    section("1.1", Text::from("X ").code("y")),
                    Section::new("Same").with_sections([Section::new("Z")]),
                ]),
                section("2", "B".into()).with_sections([Section::new("Same")]),
                Section::new("Contents"),
            ],
            ..Document::default()
        };
        let page = shown(&document);
        for id in ["t", "1-a", "11-x-y", "same", "2-b", "same-1", "contents-1"] {
            assert_eq!(page.matches(&format!(" id=\"{id}\"")).count(), 1, "{id}");
            assert!(page.contains(&format!("href=\"#{id}\"")), "{id}");
        }
        assert!(page.contains("<h3 id=\"11-x-y\"><span class=\"count\">1.1</span><span> X <code>y</code></span></h3>"));
        assert!(page.contains("<h4 id=\"z\">Z</h4>") && !page.contains("href=\"#z\""));
        assert_eq!(page.matches("<section class=\"chapter\"").count(), 3);
        assert_eq!(page.matches("class=\"previous\"").count(), 3);
        assert_eq!(page.matches("class=\"next\"").count(), 2);
        for tag in ["div", "section", "nav", "ol", "li", "main", "h4"] {
            assert_eq!(page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
    }

    #[test]
    fn pictures_are_inside_and_missing_ones_are_named() {
        let blocks =
            vec!["Text".into(), figure(7, "a/there.png", "It", "alt"), figure(8, "a/lost.png", "Lost", "gone"), "more".into()];
        let page = shown(&front("T", blocks));
        // The picture leads to its file, where it can be enlarged.
        let link = "<a class=\"picture\" href=\"a/there.png\">";
        let image = "<img alt=\"alt\" width=\"2\" height=\"3\" src=\"data:image/png;base64,iVBOR";
        assert!(page.contains(&format!("<p>Text</p>\n<figure>\n{link}{image}")), "{page}");
        assert!(page.contains("<figcaption><b>Figure 7:</b> It</figcaption>"));
        assert!(page.contains("<code>a/lost.png</code> is missing: gone"));
        assert_eq!((page.matches("<img").count(), page.matches("<figure>").count()), (1, 2));
        let cut = super::page(&front("", vec![figure(1, "b.png", "", "a")]), &mut |_| Some(PIXEL[..30].to_vec()));
        assert!(cut.contains("is damaged or of an unknown kind"));
    }

    #[test]
    fn pictures_outside_of_the_folder_are_not_asked_for() {
        for path in ["/etc/there.png", "../there.png", "a/../../there.png", "http://a/there.png", "file:there.png"] {
            assert!(shown(&front("T", vec![figure(1, path, "a", "a")])).contains("is missing"), "{path}");
        }
    }

    #[test]
    fn columns_of_numbers_are_set_right() {
        let table = Table::new(["a", "b", "c", "d"]).with_rows([
            cells![1_usize, Cell::uncertain(1.5, 0.25), "x", Cell::angle(89.788_055_6)],
            cells![Cell::exponent(-2.5e-3, 1), Cell::Missing("-"), 3_usize, Cell::angle(f64::NAN)],
        ]);
        let page = shown(&front("T", vec![table.into()]));
        let cells = ["1", "+1.50 ± 0.25", "+89°47'17''", "-2.5e-3", "-", "not determined"];
        assert!(cells.iter().all(|c| page.contains(&format!("<td class=\"number\">{c}</td>"))), "{page}");
        assert!(page.contains("<td class=\"brief\">x</td>") && page.contains("<td class=\"brief\">3</td>"));
    }

    #[test]
    fn warnings_are_told_from_text() {
        let warning = shown(&front("T", vec![Note::new(NoteKind::Axes, "`+X` & `-X`").into()]));
        let text = "<blockquote class=\"warning\">\n<p><strong>WARNING</strong> AXES: <code>+X</code> &amp; <code>-X</code></p>";
        assert!(warning.contains(text), "{warning}");
        assert!(!shown(&front("T", vec![Text::default().strong("WARNING").and(" a").into()])).contains("<blockquote class"));
        assert!(!shown(&front("T", vec!["WARNING a".into()])).contains("<blockquote class"));
    }

    #[test]
    fn links_into_the_text_stay_and_programs_do_not() {
        let places = ["#4-heat", "run.md", "https://a.example/", "mailto:a@b.example"];
        let programs = ["data:text/html,x", "//x/y", "javascript:alert(1)"];
        let all = places.iter().chain(&programs).fold(Text::default(), |text, to| text.link("a", *to));
        let mut document = front("T", Vec::new());
        document.sections.push(Section::new("Heat").numbered("4").with(all));
        let page = shown(&document);
        for href in places {
            assert!(page.contains(&format!("<a href=\"{href}\">")), "{href}");
        }
        assert!(!page.contains("href=\"data:") && !page.contains("href=\"//") && !page.contains("href=\"java"));
    }

    #[test]
    fn any_document_gives_a_page() {
        let empty = Section::default().with("").with(Table::default()).with(Block::List(Vec::new()));
        let deep = (0..8).fold(Section::new("a"), |below, _| Section::new("b").with_sections([below]));
        let colophon = Some(Text::from("\u{1}<"));
        for document in [
            Document::default(),
            Document { colophon: colophon.clone(), ..Document::default() },
            Document { sections: vec![empty, deep], colophon, ..front("t", vec!["text".into()]) },
        ] {
            let page = shown(&document);
            assert_eq!(page, shown(&document));
            assert!(page.ends_with("</html>\n") && page.contains("<h1"));
            assert_eq!(page.matches("<div").count(), page.matches("</div>").count());
        }
    }
}
