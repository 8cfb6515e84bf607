//! Figures, with the bytes of their pictures inside the page.

use super::escape;
use crate::show::document::Figure;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fmt::Write;

/// Writes a figure. What `picture` does not find, or what is not a whole picture of a known kind, is replaced by a note.
pub(super) fn figure(out: &mut String, figure: &Figure, picture: &mut dyn FnMut(&str) -> Option<Vec<u8>>) {
    let bytes = if stays_inside(&figure.file) { picture(&figure.file) } else { None };
    let (path, alt) = (escape(&figure.file), escape(&figure.caption));
    out.push_str("<figure>\n");
    match bytes.as_deref().map(|b| (b, picture_kind(b))) {
        Some((bytes, Some((kind, size)))) => {
            let size = size.map_or_else(String::new, |[w, h]| format!(" width=\"{w}\" height=\"{h}\""));
            // The file beside the page is as large as it was drawn.
            let _ = write!(out, "<a class=\"picture\" href=\"{path}\"><img alt=\"{alt}\"{size} src=\"data:{kind};base64,");
            STANDARD.encode_string(bytes, out);
            out.push_str("\"></a>\n");
        }
        Some((_, None)) => {
            let _ =
                writeln!(out, "<p class=\"missing\">The picture <code>{path}</code> is damaged or of an unknown kind: {alt}</p>");
        }
        None => {
            let _ = writeln!(out, "<p class=\"missing\">The picture <code>{path}</code> is missing: {alt}</p>");
        }
    }
    let _ = write!(out, "<figcaption><b>Figure {}:</b> {}</figcaption>\n</figure>\n", figure.number, escape(&figure.title));
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
