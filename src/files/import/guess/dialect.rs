//! How a table of text is written.

use crate::data::error::Finding;
use crate::files::import::csv::{bare, decoded};
use crate::files::import::{Dialect, Separator};
use crate::files::text::number;

/// Lines that are looked at.
const SAMPLE: usize = 200;

/// Finds encoding, header line, separator and decimal sign.
///
/// # Errors
/// Text without a line of names above rows of as many cells.
pub(super) fn found(file: &str, bytes: &[u8]) -> Result<Dialect, Finding> {
    let latin_1 = std::str::from_utf8(bytes).is_err();
    let text = decoded(file, bytes, latin_1)?;
    let lines: Vec<(usize, &str)> =
        text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty() && !line.starts_with('#')).take(SAMPLE).collect();
    let header = Separator::ALL.iter().find_map(|separator| Some((*separator, header_line(*separator, &lines)?)));
    let Some((separator, at)) = header else {
        let rule = "no line of column names was found above rows with as many cells";
        return Err(Finding::error(file, rule, "write the mapping by hand; `docs/import.md` has an example to begin with"));
    };
    let skip_rows = if at == 0 { 0 } else { lines[at].0 };
    let (mut commas, mut points) = (0, 0);
    for (_, line) in &lines[at + 1..] {
        for (begin, end) in separator.cells(line) {
            let cell = bare(&line[begin..end]);
            commas += usize::from(cell.matches(',').count() == 1 && number(cell.replace(',', ".").as_bytes()).is_some());
            points += usize::from(cell.contains('.') && number(cell.as_bytes()).is_some());
        }
    }
    let decimal_comma = separator != Separator::Char(',') && commas > points;
    Ok(Dialect { separator: Some(separator), decimal_comma, skip_rows, latin_1 })
}

/// The first line that names columns: all lines after it have as many cells, and more of them are numbers there than in it.
fn header_line(separator: Separator, lines: &[(usize, &str)]) -> Option<usize> {
    /// Most lines of a preamble.
    const LONGEST: usize = 60;
    let counts: Vec<usize> = lines.iter().map(|(_, line)| separator.cells(line).len()).collect();
    let numbers = |line: &str| {
        let is_number = |(begin, end): &(usize, usize)| number(bare(&line[*begin..*end]).replace(',', ".").as_bytes()).is_some();
        separator.cells(line).iter().filter(|place| is_number(place)).count()
    };
    (0..lines.len().saturating_sub(1).min(LONGEST)).find(|at| {
        let cells = counts[*at];
        let same = counts[at + 1..].iter().all(|c| *c == cells || *c == cells + 1);
        cells > 3 && same && numbers(lines[*at].1) == 0 && numbers(lines[at + 1].1) > 0
    })
}
