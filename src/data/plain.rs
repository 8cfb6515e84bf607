//! Text that comes from files, as it may be shown: without characters that act on a terminal or turn the order of what stands beside them.

use std::borrow::Cow;
use std::fmt::Write;

/// Whether a character is none that is seen: a control character, or one that changes the direction of the text after it.
#[must_use]
pub fn is_unseen(c: char) -> bool {
    c.is_control() || matches!(c, '\u{200e}' | '\u{200f}' | '\u{2028}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
}

/// The text with everything unseen written as `\u{1b}`, but for the ends of its lines and tabulators.
#[must_use]
pub fn shown(text: &str) -> Cow<'_, str> {
    escaped(text, |c| is_unseen(c) && c != '\n' && c != '\t')
}

/// The same on one line: names and titles have no ends of lines.
#[must_use]
pub fn one_line(text: &str) -> Cow<'_, str> {
    escaped(text, is_unseen)
}

/// The text of a JSON document with the same characters as JSON escapes them; what is below a blank is escaped there already.
#[must_use]
pub fn json(text: String) -> String {
    let is_raw = |c: char| is_unseen(c) && c != '\n';
    if !text.contains(is_raw) {
        return text;
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_raw(c) {
            let _ = write!(out, "\\u{:04x}", u32::from(c));
        } else {
            out.push(c);
        }
    }
    out
}

fn escaped(text: &str, is_one: impl Fn(char) -> bool) -> Cow<'_, str> {
    if !text.contains(&is_one) {
        return Cow::Borrowed(text);
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        if is_one(c) {
            out.extend(c.escape_default());
        } else {
            out.push(c);
        }
    }
    Cow::Owned(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nothing_unseen_is_left() {
        assert_eq!(shown("a\u{1b}[31m\u{9b}b\n\tc\u{202e}"), "a\\u{1b}[31m\\u{9b}b\n\tc\\u{202e}");
        assert_eq!(one_line("a\nb\r"), "a\\nb\\r");
        assert!(matches!(shown("σ ± °C\n"), Cow::Borrowed(_)));
    }

    #[test]
    fn json_stays_json() {
        let value = serde_json::json!({"name": "a\u{1b}\u{7f}\u{9b}\u{202e}b\n"});
        let text = json(serde_json::to_string_pretty(&value).unwrap());
        assert!(!text.contains(|c| is_unseen(c) && c != '\n'), "{text:?}");
        assert_eq!(serde_json::from_str::<serde_json::Value>(&text).unwrap(), value);
    }
}
