//! TOML text of a tree of values: keys first, then tables, in the order they come; numbers to their last digit. A null in a list is
//! a number that is none, nan.

use crate::files::text::quoted;
use serde_json::{Map, Value};
use std::fmt::Write;

/// TOML text of a table. Nulls are left out, as TOML has none.
#[must_use]
pub fn toml(table: &Map<String, Value>) -> String {
    toml_keeping(table, &[])
}

/// The same with the nulls under some keys, each with the tables above it, as nan.
pub(super) fn toml_keeping(table: &Map<String, Value>, kept: &[&str]) -> String {
    let mut out = String::new();
    write_table(&mut out, "", table, kept);
    out
}

fn is_table_list(value: &Value) -> bool {
    value.as_array().is_some_and(|list| !list.is_empty() && list.iter().all(Value::is_object))
}

fn write_table(out: &mut String, path: &str, table: &Map<String, Value>, kept: &[&str]) {
    let full = |key: &str| if path.is_empty() { quoted_key(key) } else { format!("{path}.{}", quoted_key(key)) };
    for (key, value) in table {
        let is_written = !value.is_null() || kept.contains(&full(key).as_str());
        if is_written && !value.is_object() && !is_table_list(value) {
            let _ = writeln!(out, "{} = {}", quoted_key(key), inline(value, true));
        }
    }
    for (key, value) in table {
        let full = full(key);
        if let Some(inner) = value.as_object() {
            let _ = writeln!(out, "\n[{full}]");
            write_table(out, &full, inner, kept);
        } else if is_table_list(value) {
            for inner in value.as_array().into_iter().flatten().filter_map(Value::as_object) {
                let _ = writeln!(out, "\n[[{full}]]");
                write_table(out, &full, inner, kept);
            }
        }
    }
}

fn quoted_key(key: &str) -> String {
    let bare = !key.is_empty() && key.bytes().all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
    if bare { key.to_owned() } else { quoted(key) }
}

fn inline(value: &Value, top: bool) -> String {
    match value {
        Value::Null => "nan".to_owned(),
        Value::Bool(b) => b.to_string(),
        Value::Number(n) => match n.as_f64() {
            // `{:?}` is the shortest text that reads back as the same number, with an exponent where one is short.
            Some(f) if n.is_f64() => format!("{f:?}"),
            _ => n.to_string(),
        },
        Value::String(s) => quoted(s),
        Value::Array(list) => {
            let items: Vec<String> = list.iter().map(|v| inline(v, false)).collect();
            if top && list.iter().any(Value::is_array) {
                format!("[\n  {},\n]", items.join(",\n  "))
            } else {
                format!("[{}]", items.join(", "))
            }
        }
        Value::Object(inner) => {
            let items: Vec<String> = inner
                .iter()
                .filter(|(_, v)| !v.is_null())
                .map(|(k, v)| format!("{} = {}", quoted_key(k), inline(v, false)))
                .collect();
            format!("{{ {} }}", items.join(", "))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_read_back_to_the_last_bit() {
        let values = [1e-12, 0.1 + 0.2, -1.0 / 3.0, 12_345.678_9, 1e300, 0.0, 7.0];
        let table =
            serde_json::json!({ "a": values, "m": [[1.0, 2.0], [3.0, 4.0]], "t": { "x y": "q\"\n", "n": 3 }, "none": null });
        let text = toml(table.as_object().unwrap());
        let back: toml_edit::DocumentMut = text.parse().unwrap();
        let read: Vec<f64> = back["a"].as_array().unwrap().iter().map(|v| v.as_float().unwrap()).collect();
        assert_eq!(read, values);
        assert_eq!(back["t"]["x y"].as_str(), Some("q\"\n"));
        assert_eq!(back["t"]["n"].as_integer(), Some(3));
        assert_eq!(back["m"][1][0].as_float(), Some(3.0));
    }
}
