//! What the text formats share: TOML keys with their place, CSV rows by column name, strict decimal numbers.

mod keys;
mod rows;

pub use keys::{Group, Keys, NEAREST};
pub use rows::{Cell, Columns, TableForm, TableRow, cells, columns, not_a_number, small_table};

use crate::data::plain::one_line;
use std::borrow::Cow;

/// Longest accepted line, bytes: a longer one is refused, so that memory stays bounded.
pub const LONGEST_LINE: usize = 1 << 20;

/// Bytes as text: UTF-8, or Latin-1 where they are not UTF-8 (old notes with a degree sign).
#[must_use]
pub fn decode(bytes: &[u8]) -> Cow<'_, str> {
    match std::str::from_utf8(bytes) {
        Ok(text) => Cow::Borrowed(text),
        Err(_) => Cow::Owned(bytes.iter().map(|b| char::from(*b)).collect()),
    }
}

/// A finite decimal number: sign, digits, point, digits, exponent with `e` or `E`. Nothing else: no `nan`, `inf`, hexadecimal,
/// `1D+02`, decimal comma or Unicode minus.
#[must_use]
pub fn number(text: &[u8]) -> Option<f64> {
    let unsigned = text.strip_prefix(b"-").or_else(|| text.strip_prefix(b"+")).unwrap_or(text);
    let (mantissa, exponent) = match unsigned.iter().position(|b| matches!(b, b'e' | b'E')) {
        Some(at) => (&unsigned[..at], Some(&unsigned[at + 1..])),
        None => (unsigned, None),
    };
    let digits = mantissa.iter().filter(|b| b.is_ascii_digit()).count();
    let points = mantissa.iter().filter(|b| **b == b'.').count();
    if digits == 0 || points > 1 || digits + points != mantissa.len() {
        return None;
    }
    if let Some(exponent) = exponent {
        let power = exponent.strip_prefix(b"-").or_else(|| exponent.strip_prefix(b"+")).unwrap_or(exponent);
        if power.is_empty() || !power.iter().all(u8::is_ascii_digit) {
            return None;
        }
    }
    let value: f64 = std::str::from_utf8(text).ok()?.parse().ok()?;
    value.is_finite().then_some(value)
}

/// Why a text is not a [`number`], and what to do.
#[must_use]
pub fn number_rule(text: &[u8]) -> (&'static str, &'static str) {
    let lower = text.to_ascii_lowercase();
    if text.is_empty() {
        ("is empty where a number is required", "write the value, or take the row out")
    } else if lower.windows(3).any(|w| w == b"nan" || w == b"inf") {
        ("is not finite", "take the row out or repair the value")
    } else if text.contains(&b';') || text.contains(&b',') {
        ("has a decimal comma or semicolons", "write numbers with a decimal point, cells separated by commas")
    } else if number_like_overflow(text) {
        ("is beyond the range of numbers", "repair the value")
    } else {
        ("is not a decimal number", "repair the value or take the row out")
    }
}

fn number_like_overflow(text: &[u8]) -> bool {
    std::str::from_utf8(text).ok().and_then(|t| t.parse::<f64>().ok()).is_some_and(f64::is_infinite)
}

/// Numbers as a TOML list, each the shortest text that is read back as the same number.
#[must_use]
pub fn listed<'a>(values: impl IntoIterator<Item = &'a f64>) -> String {
    let list: Vec<String> = values.into_iter().map(|v| format!("{v:?}")).collect();
    format!("[{}]", list.join(", "))
}

/// A text as a TOML string on one line: formats that are read line by line hold it.
#[must_use]
pub fn quoted(text: &str) -> String {
    if !text.contains(['\n', '\r']) {
        return toml_edit::Value::from(text).to_string().trim().to_owned();
    }
    let mut out = String::from("\"");
    for c in text.chars() {
        match c {
            '"' => out.push_str("\\\""),
            '\\' => out.push_str("\\\\"),
            '\n' => out.push_str("\\n"),
            '\r' => out.push_str("\\r"),
            c if c.is_control() => out.push_str(&format!("\\u{:04X}", u32::from(c))),
            c => out.push(c),
        }
    }
    out.push('"');
    out
}

/// A text as a spreadsheet may open it: on one line, and with a single quote before what would be a formula there. A sign before a name, as
/// of an axis, makes none.
#[must_use]
pub fn harmless(text: &str) -> Cow<'_, str> {
    let text = one_line(text);
    let is_formula = match text.chars().next() {
        Some('=' | '@') => true,
        Some('+' | '-') => text.chars().skip(1).any(|c| !c.is_alphanumeric() && !". _".contains(c)),
        _ => false,
    };
    if is_formula { Cow::Owned(format!("'{text}")) } else { text }
}

/// The same as a cell of CSV, in quotes where it needs them.
#[must_use]
pub fn csv_cell(text: &str) -> String {
    let text = harmless(text);
    if text.contains([',', '"']) { format!("\"{}\"", text.replace('"', "\"\"")) } else { text.into_owned() }
}

/// A number with a fixed number of decimals, without a negative zero.
#[must_use]
pub fn fixed(value: f64, decimals: usize) -> String {
    let text = format!("{value:.decimals$}");
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|b| matches!(b, b'0' | b'.')) => rest.to_owned(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_decimal_numbers_are_numbers() {
        for (text, value) in [("1", 1.0), ("-0.5", -0.5), ("+2.", 2.0), (".25", 0.25), ("1e3", 1000.0), ("-1.5E-2", -0.015)] {
            assert_eq!(number(text.as_bytes()), Some(value), "{text}");
        }
        for text in [
            "",
            "-",
            ".",
            "nan",
            "NaN",
            "inf",
            "-Infinity",
            "1e999",
            "0x64",
            "1D+02",
            "\u{2212}5",
            "1,5",
            "1.2.3",
            "***",
            "ERR",
            "1e",
            "1e+",
            "--1",
            "1 2",
        ] {
            assert_eq!(number(text.as_bytes()), None, "{text}");
        }
    }

    #[test]
    fn many_digits_are_rounded_correctly() {
        assert_eq!(number(b"0.1000000000000000055511151231257827"), Some(0.1));
        assert_eq!(number(b"9007199254740993"), Some(9_007_199_254_740_992.0));
    }

    #[test]
    fn keys_are_reported_with_their_place() {
        let keys = Keys::parse("f", 2, "a = 1\nb = \"x\"\n".to_owned()).unwrap();
        let error = keys.root().number("b").unwrap_err();
        assert_eq!((error.line, error.column), (Some(3), Some(5)));
        let error = Keys::parse("f", 2, "a = 1\nb = \n".to_owned()).err().unwrap();
        assert_eq!(error.line, Some(3));
    }

    #[test]
    fn quoted_texts_stand_on_one_line() {
        for text in ["plain", "with \"quotes\"", "two\nlines \\ \"a\"\r\n@END\u{7}\u{7f}\tµ", "\n", ""] {
            let line = quoted(text);
            assert!(!line.contains('\n'), "{line}");
            let keys = Keys::parse("f", 1, format!("a = {line}\n")).unwrap();
            assert_eq!(keys.root().text("a").unwrap().as_deref(), Some(text));
        }
    }

    #[test]
    fn no_cell_is_a_formula() {
        for (text, cell) in [
            ("=cmd|' /C calc'!A0", "'=cmd|' /C calc'!A0"),
            ("@SUM(1,2)", "\"'@SUM(1,2)\""),
            ("+cmd|x", "'+cmd|x"),
            ("-2+3", "'-2+3"),
            ("-X", "-X"),
            ("+17.5", "+17.5"),
            ("a\n=b\u{1b}", "a\\n=b\\u{1b}"),
            ("a, \"b\"", "\"a, \"\"b\"\"\""),
        ] {
            assert_eq!(csv_cell(text), cell);
        }
    }

    #[test]
    fn latin_1_is_kept() {
        assert_eq!(decode(b"17 \xb0C"), "17 °C");
    }
}
