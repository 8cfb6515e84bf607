//! A protocol as one page for a browser: the Markdown text with its pictures inside, contents, and a style sheet for A4 paper.
//!
//! The page needs no other file, no network and no script. Nothing of the text is taken for HTML, and the page forbids the
//! browser to run or to load anything, so that a remark copied from a data file stays a remark. Numbers of chapters and figures
//! are those of the text; the page prints them and counts nothing.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use pulldown_cmark::{Alignment, CodeBlockKind, Event, LinkType, Options, Parser, Tag, TagEnd};
use std::collections::HashSet;
use std::fmt::Write;

const STYLE: &str = include_str!("page.css");
/// Target of the links "contents".
const CONTENTS: &str = "contents";
/// Words of tables that are longer may be broken anywhere on paper.
const LONG_WORD: usize = 18;

/// Turns the Markdown of a protocol into one self-contained HTML page.
///
/// `#` is the title of the document, `##` begins a chapter, `###` a section. `picture` is asked for the bytes of a picture by the
/// path that the Markdown gives; it is only asked for paths that stay inside the folder of the Markdown. What it does not find, or
/// what is not a whole PNG, JPEG, GIF, WebP or SVG picture, is replaced by a note. The caption of a picture is the title of the
/// Markdown image, which brings the number of the figure with it (`Figure 3: ...`), and else its alternative text.
///
/// A block quote that begins with `**WARNING**` is made conspicuous. HTML comments are left out, other HTML is printed as text.
/// `title` is the title of the browser window and of the printed pages. Equal input gives equal bytes.
#[must_use]
pub fn page(markdown: &str, title: &str, picture: &mut dyn FnMut(&str) -> Option<Vec<u8>>) -> String {
    let events: Vec<Event> = Parser::new_ext(markdown, Options::ENABLE_TABLES).collect();
    let headings = headings(&events);
    let version = env!("CARGO_PKG_VERSION");
    let shown = escape(title);
    let mut body = Body::new(&headings, picture);
    for (i, event) in events.iter().enumerate() {
        body.event(event, &events[i + 1..]);
    }
    let main = body.finish(&shown);
    // The mark stands in front of the document type, as in all files of the tool. Browsers allow comments there.
    format!(
        "<!-- written by calfit {version} -->\n<!DOCTYPE html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta http-equiv=\"Content-Security-Policy\" content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'; \
         base-uri 'none'; form-action 'none'\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{shown}</title>\n\
         <meta name=\"generator\" content=\"calfit {version}\">\n<style>\n{STYLE}@page {{ @top-left {{ content: \"{}\" }} }}\n</style>\n\
         </head>\n<body>\n<main>\n{main}</main>\n</body>\n</html>\n",
        style_string(title)
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

struct Heading {
    level: u8,
    id: String,
    /// Its text as HTML without links.
    html: String,
    /// Whether it begins a chapter.
    chapter: bool,
}

/// The headings outside of lists and block quotes, which make up the structure of the page.
fn headings(events: &[Event]) -> Vec<Heading> {
    let mut found: Vec<Heading> = Vec::new();
    let mut used = HashSet::from([CONTENTS.to_owned()]);
    let mut nested = 0;
    for (i, event) in events.iter().enumerate() {
        match event {
            Event::Start(Tag::BlockQuote(_) | Tag::List(_)) => nested += 1,
            Event::End(TagEnd::BlockQuote(_) | TagEnd::List(_)) => nested -= 1,
            Event::Start(Tag::Heading { level, .. }) if nested == 0 => {
                let inside = events[i + 1..].iter().take_while(|e| !matches!(e, Event::End(TagEnd::Heading(_))));
                let (html, plain) = heading_text(inside);
                let level = *level as u8;
                let first_title = level == 1 && !found.iter().any(|h| h.level == 1);
                // A title after the first chapter cannot stand above it any more.
                let chapter = level == 2 || level == 1 && (!first_title || found.iter().any(|h| h.chapter));
                found.push(Heading { level, id: unique(&slug(&plain), &mut used), html, chapter });
            }
            _ => {}
        }
    }
    found
}

/// A heading as HTML and as plain text.
fn heading_text<'e>(events: impl Iterator<Item = &'e Event<'e>>) -> (String, String) {
    let (mut html, mut plain, mut in_image) = (String::new(), String::new(), 0);
    for event in events {
        match event {
            Event::Start(Tag::Image { .. }) => in_image += 1,
            Event::End(TagEnd::Image) => in_image -= 1,
            _ if in_image > 0 => {}
            Event::Text(text) => {
                html.push_str(&escape(text));
                plain.push_str(text);
            }
            Event::Code(text) => {
                let _ = write!(html, "<code>{}</code>", escape(text));
                plain.push_str(text);
            }
            Event::InlineHtml(text) if !is_comment(text) => {
                html.push_str(&escape(text));
                plain.push_str(text);
            }
            Event::SoftBreak | Event::HardBreak => {
                html.push(' ');
                plain.push(' ');
            }
            Event::Start(Tag::Emphasis) => html.push_str("<em>"),
            Event::End(TagEnd::Emphasis) => html.push_str("</em>"),
            Event::Start(Tag::Strong) => html.push_str("<strong>"),
            Event::End(TagEnd::Strong) => html.push_str("</strong>"),
            _ => {}
        }
    }
    // Contents and headings set the number apart from the words.
    if let Some(number) = number_of(&plain).filter(|n| html.starts_with(*n)) {
        html = format!("<span class=\"count\">{number}</span><span>{}</span>", &html[number.len()..]);
    }
    (html, plain)
}

/// The number with which a heading begins: `3`, `3.2`, `3.2.1.`, `A.1`.
fn number_of(heading: &str) -> Option<&str> {
    let (number, _) = heading.split_once(' ')?;
    let mut parts = number.strip_suffix('.').unwrap_or(number).split('.');
    let digits = |part: &str| !part.is_empty() && part.bytes().all(|b| b.is_ascii_digit());
    let first = parts.next()?;
    let rest: Vec<&str> = parts.collect();
    let letter = first.len() == 1 && first.bytes().all(|b| b.is_ascii_uppercase()) && !rest.is_empty();
    ((letter || digits(first)) && rest.into_iter().all(digits)).then_some(number)
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

fn is_comment(html: &str) -> bool {
    html.starts_with("<!--")
}

/// HTML without its closed comments.
fn without_comments(html: &str) -> String {
    let (mut out, mut rest) = (String::new(), html);
    while let Some((before, comment)) = rest.split_once("<!--") {
        let Some((_, after)) = comment.split_once("-->") else { break };
        out.push_str(before);
        rest = after;
    }
    out + rest
}

/// Whether a link leads to a place in the text, to a file beside it, to a web page or to a mailbox, and not to a program.
fn is_harmless(link: &str) -> bool {
    let scheme = link.split(['/', '?', '#']).next().unwrap_or_default().split_once(':').map(|(scheme, _)| scheme);
    !link.starts_with("//")
        && !link.contains('\\')
        && !link.chars().any(char::is_control)
        && scheme.is_none_or(|s| ["http", "https", "mailto"].iter().any(|known| s.eq_ignore_ascii_case(known)))
}

/// Whether a path leads to a file in the folder of the text or below.
fn stays_inside(path: &str) -> bool {
    !path.is_empty() && !path.starts_with('/') && !path.contains([':', '\\']) && path.split('/').all(|part| part != "..")
}

/// Media type of a whole picture, with its width and height where those are at hand.
fn picture_kind(bytes: &[u8]) -> Option<(&'static str, Option<[u32; 2]>)> {
    if bytes.starts_with(b"\x89PNG\r\n\x1a\n") {
        let number = |at: usize| bytes.get(at..at + 4).and_then(|b| b.try_into().ok()).map(u32::from_be_bytes);
        let size = [number(16)?, number(20)?];
        // An interrupted copy has no end mark.
        return (bytes.get(12..16)? == b"IHDR" && bytes.ends_with(b"IEND\xaeB`\x82")).then_some(("image/png", Some(size)));
    }
    if bytes.starts_with(b"\xff\xd8\xff") {
        return Some(("image/jpeg", None));
    }
    if bytes.starts_with(b"GIF8") {
        return Some(("image/gif", None));
    }
    if bytes.starts_with(b"RIFF") && bytes.get(8..12)? == b"WEBP" {
        return Some(("image/webp", None));
    }
    let text = std::str::from_utf8(bytes).ok()?.trim_start();
    let drawing = text.starts_with("<svg") || text.starts_with("<?xml") && text.contains("<svg");
    drawing.then_some(("image/svg+xml", None))
}

/// Whether a cell holds a number: plain, `a ± b`, or an angle in degrees, minutes and seconds.
fn is_number(cell: &str) -> bool {
    let one = |text: &str| {
        let text = text.trim().replace('−', "-");
        let digits = text.strip_prefix(['+', '-']).unwrap_or(&text);
        let angle = digits.contains('°') && digits.chars().all(|c| c.is_ascii_digit() || ".°'\"′″".contains(c));
        digits.starts_with(|c: char| c.is_ascii_digit() || c == '.') && (angle || text.parse::<f64>().is_ok())
    };
    cell.split('±').count() <= 2 && cell.split('±').all(one)
}

/// Whether a cell says that there is no number.
fn is_gap(cell: &str) -> bool {
    matches!(cell, "" | "-" | "–" | "—" | "n/a") || cell.starts_with("not ") || cell.eq_ignore_ascii_case("nan")
}

/// Length of the longest piece of a text that is not wrapped.
fn longest_word(text: &str) -> usize {
    text.split([' ', '-', '/']).map(|word| word.chars().count()).max().unwrap_or(0)
}

#[derive(Default)]
struct Cell {
    html: String,
    plain: String,
}

#[derive(Default)]
struct Table {
    alignments: Vec<Alignment>,
    rows: Vec<Vec<Cell>>,
}

impl Table {
    fn is_numeric(&self, column: usize) -> bool {
        let mut cells = self.rows.iter().skip(1).filter_map(|row| row.get(column)).map(|cell| cell.plain.trim());
        cells.clone().any(is_number) && cells.all(|cell| is_number(cell) || is_gap(cell))
    }

    /// Width on paper in digits. Words are wrapped; numbers are not, unless `split` lets `a ± b` and every other text break at its blanks.
    fn width(&self, numeric: &[bool], split: bool) -> usize {
        let column = |i: usize| {
            let wanted = self.rows.iter().enumerate().filter_map(|(row, cells)| {
                let text = cells.get(i)?.plain.trim();
                let length = text.chars().count();
                let number = row > 0 && numeric[i] && is_number(text);
                Some(match (number, split) {
                    (true, false) => length,
                    (true, true) => text.split(' ').map(|part| part.chars().count()).max().unwrap_or(0),
                    (false, false) => longest_word(text).min(LONG_WORD).max(length.min(20)),
                    (false, true) => longest_word(text).min(LONG_WORD),
                })
            });
            wanted.max().unwrap_or(0) + if split { 1 } else { 2 }
        };
        (0..numeric.len()).map(column).sum()
    }

    fn html(&self) -> String {
        let columns = self.alignments.len();
        let numeric: Vec<bool> = (0..columns).map(|i| self.is_numeric(i)).collect();
        // Digits on a line of A4: 88 upright in the size of tables, 118 in small type, 150 and 205 across.
        let (class, focus) = match self.width(&numeric, false) {
            0..=88 => ("", ""),
            89..=118 => (" tight", " tabindex=\"0\""),
            119..=150 => (" wide", " tabindex=\"0\""),
            _ if self.width(&numeric, true) <= 205 => (" wide dense", " tabindex=\"0\""),
            // Words and numbers are broken anywhere rather than lost beyond the edge of the paper.
            _ => (" wide dense crammed", " tabindex=\"0\""),
        };
        let mut out = format!("<div class=\"scroll{class}\"{focus}>\n<table>\n");
        // Markdown has no tables without a head.
        let headless = self.rows.first().is_some_and(|head| head.iter().all(|cell| cell.html.is_empty()));
        for (row, cells) in self.rows.iter().enumerate().skip(usize::from(headless)) {
            out.push_str(match row {
                0 => "<thead>\n<tr>",
                1 => "<tbody>\n<tr>",
                _ => "<tr>",
            });
            for (i, cell) in cells.iter().enumerate() {
                let aligned = match self.alignments.get(i) {
                    Some(Alignment::Center) => "middle",
                    Some(Alignment::Right) => "number",
                    Some(Alignment::None) if numeric[i] => "number",
                    _ => "",
                };
                let long = if longest_word(&cell.plain) > LONG_WORD { "long" } else { "" };
                let class = match format!("{aligned} {long}").trim() {
                    "" => String::new(),
                    class => format!(" class=\"{class}\""),
                };
                let (tag, scope) = if row == 0 { ("th", " scope=\"col\"") } else { ("td", "") };
                let _ = write!(out, "<{tag}{scope}{class}>{}</{tag}>", cell.html);
            }
            out.push_str(if row == 0 { "</tr>\n</thead>\n" } else { "</tr>\n" });
        }
        if self.rows.len() > 1 {
            out.push_str("</tbody>\n");
        }
        out + "</table>\n</div>\n"
    }
}

struct Image {
    path: String,
    caption: String,
    alt: String,
    /// Images may stand in the alternative text of an image.
    depth: usize,
}

struct Body<'a> {
    headings: &'a [Heading],
    picture: &'a mut dyn FnMut(&str) -> Option<Vec<u8>>,
    out: String,
    /// Headings begun.
    begun: usize,
    /// Heading of the chapter that is open.
    chapter: Option<usize>,
    /// Lists and block quotes around the place.
    nested: usize,
    paragraph: usize,
    in_heading: bool,
    raw: String,
    table: Table,
    /// The page so far, while a cell or a heading is written.
    outside: String,
    plain: String,
    image: Option<Image>,
    /// Figures to be set after the block in which they are named.
    figures: String,
    links: Vec<bool>,
}

impl<'a> Body<'a> {
    fn new(headings: &'a [Heading], picture: &'a mut dyn FnMut(&str) -> Option<Vec<u8>>) -> Self {
        Self {
            headings,
            picture,
            out: String::new(),
            begun: 0,
            chapter: None,
            nested: 0,
            paragraph: 0,
            in_heading: false,
            raw: String::new(),
            table: Table::default(),
            outside: String::new(),
            plain: String::new(),
            image: None,
            figures: String::new(),
            links: Vec::new(),
        }
    }

    fn event(&mut self, event: &Event, following: &[Event]) {
        if self.image.is_some() {
            return self.alternative(event);
        }
        match event {
            Event::Start(tag) => self.start(tag, following),
            Event::End(tag) => self.end(*tag),
            Event::Text(text) | Event::InlineMath(text) | Event::DisplayMath(text) => {
                self.out.push_str(&escape(text));
                self.plain.push_str(text);
            }
            Event::Code(text) => {
                let _ = write!(self.out, "<code>{}</code>", escape(text));
                self.plain.push_str(text);
            }
            Event::Html(text) => self.raw.push_str(text),
            Event::InlineHtml(text) if is_comment(text) => {}
            // The only way to begin a line in a cell.
            Event::InlineHtml(text) if matches!(text.as_ref(), "<br>" | "<br/>" | "<br />") => self.out.push_str("<br>"),
            Event::InlineHtml(text) => {
                self.out.push_str(&escape(text));
                self.plain.push_str(text);
            }
            Event::SoftBreak => self.out.push('\n'),
            Event::HardBreak => self.out.push_str("<br>\n"),
            Event::Rule => self.out.push_str("<hr>\n"),
            Event::FootnoteReference(_) | Event::TaskListMarker(_) => {}
        }
    }

    fn start(&mut self, tag: &Tag, following: &[Event]) {
        match tag {
            Tag::Paragraph => {
                self.paragraph = self.out.len();
                self.out.push_str("<p>");
            }
            Tag::Heading { .. } => {
                if self.nested == 0 {
                    self.structure();
                } else {
                    self.out.push_str("<h4>");
                }
                self.in_heading = true;
                // Its text has been made with the contents; what is written meanwhile counts only inside of a list or quote.
                self.outside = std::mem::take(&mut self.out);
            }
            Tag::BlockQuote(_) => {
                self.nested += 1;
                let text = following.iter().find_map(|e| if let Event::Text(text) = e { Some(text.as_ref()) } else { None });
                let strong = matches!(following, [Event::Start(Tag::Paragraph), Event::Start(Tag::Strong), ..]);
                let warning = strong && text.is_some_and(|t| t.trim_end_matches(':').trim() == "WARNING");
                self.out.push_str(if warning { "<blockquote class=\"warning\">\n" } else { "<blockquote>\n" });
            }
            Tag::CodeBlock(kind) => {
                let language = match kind {
                    CodeBlockKind::Fenced(language) if !language.is_empty() => {
                        format!(" class=\"language-{}\"", escape(language))
                    }
                    _ => String::new(),
                };
                let _ = write!(self.out, "<pre><code{language}>");
            }
            Tag::HtmlBlock => self.raw.clear(),
            Tag::List(first) => {
                self.nested += 1;
                match first {
                    None => self.out.push_str("<ul>\n"),
                    Some(1) => self.out.push_str("<ol>\n"),
                    Some(first) => {
                        let _ = writeln!(self.out, "<ol start=\"{first}\">");
                    }
                }
            }
            Tag::Item => self.out.push_str("<li>"),
            Tag::Table(alignments) => self.table = Table { alignments: alignments.clone(), rows: Vec::new() },
            Tag::TableHead | Tag::TableRow => self.table.rows.push(Vec::new()),
            Tag::TableCell => {
                self.outside = std::mem::take(&mut self.out);
                self.plain.clear();
            }
            Tag::Emphasis => self.out.push_str("<em>"),
            Tag::Strong => self.out.push_str("<strong>"),
            Tag::Link { link_type, dest_url, .. } => {
                let mail = if *link_type == LinkType::Email { "mailto:" } else { "" };
                let shown = !self.in_heading && is_harmless(dest_url);
                if shown {
                    let _ = write!(self.out, "<a href=\"{mail}{}\">", escape(dest_url));
                }
                self.links.push(shown);
            }
            Tag::Image { dest_url, title, .. } => {
                self.image = Some(Image { path: dest_url.to_string(), caption: title.to_string(), alt: String::new(), depth: 1 });
            }
            _ => {}
        }
    }

    fn end(&mut self, tag: TagEnd) {
        match tag {
            TagEnd::Paragraph => {
                if self.out[self.paragraph..].trim() == "<p>" {
                    self.out.truncate(self.paragraph);
                } else {
                    self.out.push_str("</p>\n");
                }
                self.set_figures();
            }
            TagEnd::Heading(_) => {
                let text = std::mem::replace(&mut self.out, std::mem::take(&mut self.outside));
                if self.nested == 0 {
                    if let Some(h) = self.headings.get(self.begun - 1) {
                        let _ = writeln!(self.out, "<h{} id=\"{}\">{}</h{}>", h.level, escape(&h.id), h.html, h.level);
                    }
                } else {
                    let _ = writeln!(self.out, "{text}</h4>");
                }
                self.in_heading = false;
                self.set_figures();
            }
            TagEnd::BlockQuote(_) => {
                self.nested -= 1;
                self.out.push_str("</blockquote>\n");
            }
            TagEnd::CodeBlock => self.out.push_str("</code></pre>\n"),
            TagEnd::HtmlBlock => {
                let text = without_comments(&self.raw);
                if !text.trim().is_empty() {
                    let _ = writeln!(self.out, "<pre><code>{}</code></pre>", escape(text.trim()));
                }
            }
            TagEnd::List(ordered) => {
                self.nested -= 1;
                self.out.push_str(if ordered { "</ol>\n" } else { "</ul>\n" });
            }
            TagEnd::Item => {
                self.set_figures();
                self.out.push_str("</li>\n");
            }
            TagEnd::Table => {
                let table = std::mem::take(&mut self.table);
                self.out.push_str(&table.html());
                self.set_figures();
            }
            TagEnd::TableCell => {
                let html = std::mem::replace(&mut self.out, std::mem::take(&mut self.outside));
                if let Some(row) = self.table.rows.last_mut() {
                    row.push(Cell { html, plain: std::mem::take(&mut self.plain) });
                }
            }
            TagEnd::Emphasis => self.out.push_str("</em>"),
            TagEnd::Strong => self.out.push_str("</strong>"),
            TagEnd::Link if self.links.pop() == Some(true) => self.out.push_str("</a>"),
            _ => {}
        }
    }

    /// What stands between the brackets of an image is its alternative text.
    fn alternative(&mut self, event: &Event) {
        let Some(image) = &mut self.image else { return };
        match event {
            Event::Text(text) | Event::Code(text) | Event::InlineHtml(text) => image.alt.push_str(text),
            Event::SoftBreak | Event::HardBreak => image.alt.push(' '),
            Event::Start(Tag::Image { .. }) => image.depth += 1,
            Event::End(TagEnd::Image) => {
                image.depth -= 1;
                if image.depth == 0
                    && let Some(image) = self.image.take()
                {
                    self.figure(&image);
                }
            }
            _ => {}
        }
    }

    fn figure(&mut self, image: &Image) {
        let bytes = if stays_inside(&image.path) { (self.picture)(&image.path) } else { None };
        let (path, alt) = (escape(&image.path), escape(&image.alt));
        self.figures.push_str("<figure>\n");
        match bytes.as_deref().map(|b| (b, picture_kind(b))) {
            Some((bytes, Some((kind, size)))) => {
                let size = size.map_or_else(String::new, |[w, h]| format!(" width=\"{w}\" height=\"{h}\""));
                let _ = write!(self.figures, "<img alt=\"{alt}\"{size} src=\"data:{kind};base64,");
                STANDARD.encode_string(bytes, &mut self.figures);
                self.figures.push_str("\">\n");
            }
            Some((_, None)) => {
                let _ = writeln!(
                    self.figures,
                    "<p class=\"missing\">The picture <code>{path}</code> is damaged or of an unknown kind: {alt}</p>"
                );
            }
            None => {
                let _ = writeln!(self.figures, "<p class=\"missing\">The picture <code>{path}</code> is missing: {alt}</p>");
            }
        }
        let caption = if image.caption.is_empty() { &image.alt } else { &image.caption };
        match caption.split_once(':') {
            Some((name, text))
                if name.strip_prefix("Figure ").is_some_and(|n| n.bytes().all(|b| b.is_ascii_digit() || b == b'.')) =>
            {
                let _ = writeln!(self.figures, "<figcaption><b>{}:</b>{}</figcaption>", escape(name), escape(text));
            }
            _ if caption.is_empty() => {}
            _ => {
                let _ = writeln!(self.figures, "<figcaption>{}</figcaption>", escape(caption));
            }
        }
        self.figures.push_str("</figure>\n");
    }

    /// A figure cannot stand inside of a paragraph or of a heading: it follows after it.
    fn set_figures(&mut self) {
        if self.table.rows.is_empty() {
            self.out.push_str(&std::mem::take(&mut self.figures));
        }
    }

    /// Ends and begins chapters and their parts where a heading stands. A part is what belongs to one heading; one with a wide table
    /// is printed across.
    fn structure(&mut self) {
        let at = self.begun;
        self.begun += 1;
        let Some(heading) = self.headings.get(at) else { return };
        if heading.chapter {
            self.end_chapter();
            let _ = writeln!(
                self.out,
                "<section class=\"chapter\" aria-labelledby=\"{}\">\n<div class=\"part\">",
                escape(&heading.id)
            );
            self.chapter = Some(at);
        } else if heading.level == 3 {
            self.out.push_str("</div>\n<div class=\"part\">\n");
        }
    }

    fn end_chapter(&mut self) {
        let Some(at) = self.chapter.take() else {
            // What stands in front of the first chapter.
            let front = std::mem::take(&mut self.out);
            let _ = write!(self.out, "<div class=\"front\">\n<div class=\"part\">\n{front}</div>\n</div>\n");
            self.out.push_str(&contents(self.headings));
            return;
        };
        let before = self.headings[..at].iter().rev().find(|h| h.chapter || h.level == 1);
        let after = self.headings[at + 1..].iter().find(|h| h.chapter);
        let link = |name: &str, heading: Option<&Heading>| {
            heading.map_or_else(
                || "<span></span>".to_owned(),
                |h| format!("<a class=\"{name}\" href=\"#{}\"><b>{name}</b> {}</a>", escape(&h.id), h.html),
            )
        };
        let _ = write!(
            self.out,
            "</div>\n<nav class=\"turn\" aria-label=\"Chapters\">\n{}\n<a href=\"#{CONTENTS}\"><b>contents</b></a>\n{}\n</nav>\n</section>\n",
            link("previous", before),
            link("next", after)
        );
    }

    fn finish(mut self, title: &str) -> String {
        self.end_chapter();
        if self.headings.iter().any(|h| h.level == 1) { self.out } else { format!("<h1>{title}</h1>\n{}", self.out) }
    }
}

/// The table of contents: chapters, and below them their sections.
fn contents(headings: &[Heading]) -> String {
    let mut out = format!("<nav class=\"contents\" id=\"{CONTENTS}\" aria-label=\"Contents\">\n");
    let entry = |h: &Heading| format!("<a href=\"#{}\">{}</a>", escape(&h.id), h.html);
    if let Some(title) = headings.iter().find(|h| h.level == 1 && !h.chapter) {
        let _ = writeln!(out, "<p class=\"title\">{}</p>", entry(title));
    }
    out.push_str("<ol>\n");
    let (mut item, mut below) = (false, false);
    for h in headings.iter().filter(|h| h.chapter || h.level == 3) {
        if h.chapter || !item {
            out.push_str(if below { "</ol>\n" } else { "" });
            out.push_str(if item { "</li>\n" } else { "" });
            let _ = write!(out, "<li>{}", entry(h));
            // A section in front of the first chapter has nothing below it.
            (item, below) = (h.chapter, false);
            out.push_str(if item { "" } else { "</li>\n" });
        } else {
            out.push_str(if below { "" } else { "\n<ol>\n" });
            let _ = writeln!(out, "<li>{}</li>", entry(h));
            below = true;
        }
    }
    out.push_str(if below { "</ol>\n" } else { "" });
    out.push_str(if item { "</li>\n" } else { "" });
    out + "</ol>\n</nav>\n"
}

#[cfg(test)]
mod tests {
    use super::*;

    const PIXEL: &[u8] = b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR\0\0\0\x02\0\0\0\x03\x08\0\0\0\0\0\0\0\0\0\0\0\0IEND\xaeB`\x82";

    fn shown(markdown: &str) -> String {
        page(markdown, "T", &mut |path| path.ends_with("there.png").then(|| PIXEL.to_vec()))
    }

    #[test]
    fn nothing_of_the_text_is_taken_for_html() {
        let attack = "# <script>a</script>\n\n## <b>x</b> & \"y\"\n\n<img src=x onerror=alert(1)>\n\ninline <i>z</i> `<u>`\n\n\
                      | <a> |\n|---|\n| <s> |\n\n![<p>](\"><q> \"<r>\")\n\n![<p>](<\"><q>.png> \"<r>\")\n\n[j](javascript:alert(1)) \
                      <javascript:alert(1)>\n\n```\"><h1>\n</code><h2>\n```\n\n> **WARNING** <h3>\n";
        let page = page(attack, "</title></style><script>", &mut |_| None);
        for tag in ["<script", "<b>x", "<i>", "<u>", "<s>", "<img", "<q>", "<r>", "<h2>\n", "<h3>", "href=\"j", "</style><"] {
            assert!(!page.contains(tag), "{tag} in {page}");
        }
        assert!(page.contains("&lt;img src=x onerror=alert(1)&gt;"));
        assert_eq!(page.matches("</style>").count(), 1);
    }

    #[test]
    fn comments_are_left_out_and_an_open_one_loses_no_text() {
        let page = shown("<!-- written by calfit 0 -->\n# A\n\n<!-- a\n\nb -->c\n\nd <!-- e --> f\n\n<!-- g\n");
        assert!(page.contains("<h1 id=\"a\">A</h1>"));
        assert!(page.contains("<p>d  f</p>") && page.contains("<code>c</code>") && page.contains("&lt;!-- g"), "{page}");
        assert_eq!(page.matches("<!--").count(), 1);
        assert!(page.starts_with("<!-- written by calfit "));
    }

    #[test]
    fn headings_have_ids_of_their_own_and_stand_in_the_contents() {
        let page = shown("# T\n## 1 A\n### 1.1 X `y`\n### Same\n## 2 B\n### Same\n## Contents\n> ## no heading\n");
        for id in ["t", "1-a", "11-x-y", "same", "2-b", "same-1", "contents-1"] {
            assert_eq!(page.matches(&format!(" id=\"{id}\"")).count(), 1, "{id}");
            assert!(page.contains(&format!("href=\"#{id}\"")), "{id}");
        }
        assert!(page.contains("<h3 id=\"11-x-y\"><span class=\"count\">1.1</span><span> X <code>y</code></span></h3>"));
        assert_eq!(page.matches("<section class=\"chapter\"").count(), 3);
        assert_eq!(page.matches("class=\"previous\"").count(), 3);
        assert_eq!(page.matches("class=\"next\"").count(), 2);
        for tag in ["div", "section", "nav", "ol", "li", "main", "h4"] {
            assert_eq!(page.matches(&format!("<{tag}")).count(), page.matches(&format!("</{tag}>")).count(), "{tag}");
        }
    }

    #[test]
    fn numbers_of_headings_are_told_from_words() {
        for (heading, number) in [("3 A", Some("3")), ("3.2. A", Some("3.2.")), ("A.1 B", Some("A.1")), ("A run", None)] {
            assert_eq!(number_of(heading), number, "{heading}");
        }
        assert_eq!(number_of("98-03-23 a"), None);
        assert_eq!(number_of("3.x a"), None);
    }

    #[test]
    fn pictures_are_inside_and_missing_ones_are_named() {
        let page = shown(
            "Text ![alt](a/there.png \"Figure 7: It\") more\n\n![gone](a/lost.png \"Figure 8: Lost\")\n\n- ![in a list](there.png)\n",
        );
        assert!(page.contains(
            "<p>Text  more</p>\n<figure>\n<img alt=\"alt\" width=\"2\" height=\"3\" src=\"data:image/png;base64,iVBOR"
        ));
        assert!(page.contains("<figcaption><b>Figure 7:</b> It</figcaption>"));
        assert!(page.contains("<code>a/lost.png</code> is missing: gone"));
        assert_eq!((page.matches("<img").count(), page.matches("<figure>").count()), (2, 3));
        let cut = super::page("![a](b.png)", "", &mut |_| Some(PIXEL[..30].to_vec()));
        assert!(cut.contains("is damaged or of an unknown kind"));
    }

    #[test]
    fn pictures_outside_of_the_folder_are_not_asked_for() {
        for path in ["/etc/there.png", "../there.png", "a/../../there.png", "http://a/there.png", "file:there.png"] {
            assert!(shown(&format!("![a]({path})")).contains("is missing"), "{path}");
        }
    }

    #[test]
    fn columns_of_numbers_are_set_right() {
        let page = shown(
            "| a | b | c | d |\n|---|---|---|---|\n| 1 | +1.5 ± 0.2 | x | +89°47'17'' |\n| -2.5e-3 | - | 3 | not determined |\n",
        );
        let cells = ["1", "+1.5 ± 0.2", "+89°47'17''", "-2.5e-3", "-", "not determined"];
        assert!(cells.iter().all(|c| page.contains(&format!("<td class=\"number\">{c}</td>"))), "{page}");
        assert!(page.contains("<td>x</td>") && page.contains("<td>3</td>"));
    }

    #[test]
    fn warnings_are_told_from_quotes() {
        assert!(shown("> **WARNING** a\n").contains("<blockquote class=\"warning\">"));
        assert!(!shown("> **Remark** a\n").contains("<blockquote class"));
        assert!(!shown("> WARNING a\n").contains("<blockquote class"));
    }

    #[test]
    fn links_into_the_text_stay_and_programs_do_not() {
        let page =
            shown("## 4 Heat\n[a](#4-heat) [b](run.md) [c](https://a.example/) [d](data:text/html,x) [e](//x/y) <a@b.example>\n");
        for href in ["#4-heat", "run.md", "https://a.example/", "mailto:a@b.example"] {
            assert!(page.contains(&format!("<a href=\"{href}\">")), "{href}");
        }
        assert!(!page.contains("href=\"data:") && !page.contains("href=\"//"));
    }

    #[test]
    fn any_text_gives_a_page() {
        for text in [
            "",
            "text",
            "###### a",
            "|a|\n|-|",
            "> - # x\n> ```",
            "# a\n# b\n## c\n# d\n",
            "### a\n## b\n",
            "![![x](y)](z)",
            "\u{1}<",
        ] {
            let page = shown(text);
            assert_eq!(page, shown(text));
            assert!(page.ends_with("</html>\n") && page.contains("<h1"), "{text}");
            assert_eq!(page.matches("<div").count(), page.matches("</div>").count(), "{text}");
        }
    }
}
