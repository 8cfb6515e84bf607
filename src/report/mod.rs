//! Results as tables for people. Reads result structs and computes nothing about the sensor.

pub mod lin;
pub mod runs;

/// A Markdown table; the first row is its head.
#[must_use]
pub fn table(rows: &[Vec<String>]) -> String {
    let mut out = String::new();
    for (i, row) in rows.iter().enumerate() {
        let cells: Vec<String> = row.iter().map(|c| c.replace('|', "\\|")).collect();
        out.push_str(&format!("| {} |\n", cells.join(" | ")));
        if i == 0 {
            out.push_str(&format!("|{}\n", "---|".repeat(row.len())));
        }
    }
    out
}

/// Text for a value that may be missing.
#[must_use]
pub fn or_not_stated(text: &str) -> &str {
    if text.is_empty() { "not stated" } else { text }
}
