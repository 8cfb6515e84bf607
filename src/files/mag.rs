//! MAG: a field programme.

use super::source::read_whole;
use super::text::{Cell, Columns, Keys, columns, decode, fixed, quoted};
use crate::data::error::Finding;
use crate::data::run::Kind;
use crate::data::units::FieldCoil;
use serde::Serialize;
use std::io::{self, Write};
use std::path::Path;

/// One step of a programme.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Duration, s.
    pub duration_s: f64,
    /// Field, or amplitude of the sine (half peak to peak), nT, coil coordinates.
    pub field: FieldCoil,
    /// Frequency of the sine, Hz; 0 is a constant field.
    pub frequency_hz: f64,
    /// Id of the position.
    pub position: u32,
}

/// A field programme.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Programme {
    /// Name, as in the `configuration` of runs.
    pub name: String,
    /// Kind of the runs made with it.
    pub kind: Kind,
    /// Steps in order.
    pub steps: Vec<Step>,
}

impl Programme {
    /// The shortest step, s; infinite without steps.
    #[must_use]
    pub fn shortest_s(&self) -> f64 {
        self.steps.iter().map(|step| step.duration_s).fold(f64::INFINITY, f64::min)
    }

    /// How long it takes with a pause after every step, s.
    #[must_use]
    pub fn lasts_s(&self, pause_s: f64) -> f64 {
        self.steps.iter().map(|step| step.duration_s + pause_s).sum()
    }
}

const COLUMNS: [&str; 6] = ["duration", "bx", "by", "bz", "frequency", "position"];
const SECTION: &str = "@STEPS";

/// Reads a programme; warnings go to `findings`.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn read(path: &Path, findings: &mut Vec<Finding>) -> Result<Programme, Finding> {
    let (bytes, _) = read_whole(path)?;
    parse(&path.display().to_string(), &bytes, findings)
}

/// As [`read`], from text that is in memory; `file` is its name in messages.
///
/// # Errors
/// The first fault of the file, with its place.
pub fn parse(file: &str, bytes: &[u8], findings: &mut Vec<Finding>) -> Result<Programme, Finding> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut lines = bytes.split(|b| *b == b'\n').map(|line| line.strip_suffix(b"\r").unwrap_or(line)).zip(1u64..);
    let refuse =
        |line: u64, text: &[u8], rule: &str, remedy: &str| Err(Finding::error(file, rule, remedy).at(line, 1).found(text));
    match lines.next() {
        Some((b"MAG 1", _)) => {}
        other => {
            return refuse(
                1,
                other.map_or(b"", |(l, _)| l),
                "the file is not a field programme",
                "the first line must be `MAG 1`",
            );
        }
    }
    let mut head = String::new();
    let mut names: Option<Columns> = None;
    let mut in_section = false;
    let mut ended = false;
    let mut steps = Vec::new();
    for (line, number) in lines {
        if let Some(at) = line.iter().position(|b| *b < 0x20 && *b != b'\t') {
            let byte = line.get(at).copied().unwrap_or_default();
            let finding = Finding::error(file, format!("the line holds a control byte (0x{byte:02x})"), "take it out");
            return Err(finding.at(number, at as u64 + 1).found(line));
        }
        match (in_section, ended) {
            _ if line.trim_ascii().is_empty() && (in_section || ended) => {}
            (_, true) => return refuse(number, line, "text stands after @END", "take it out"),
            (false, _) if line == SECTION.as_bytes() => in_section = true,
            (_, _) if line == b"@END" => ended = true,
            (false, _) if line.starts_with(b"@") => {
                return refuse(number, line, "the section is not known", "a programme has @STEPS only");
            }
            (false, _) => {
                head.push_str(&decode(line));
                head.push('\n');
            }
            (true, _) if line.starts_with(b"#") => {}
            (true, _) => match &names {
                None => {
                    let found = columns(file, number, line, SECTION, &COLUMNS, COLUMNS.len())?;
                    findings.extend(found.unknown(file, number, SECTION, &COLUMNS));
                    names = Some(found);
                }
                Some(columns) => {
                    let mut cells = Vec::new();
                    columns.row(file, number, line, SECTION, &mut cells)?;
                    steps.push(step(file, number, line, columns, &cells)?);
                }
            },
        }
    }
    if !ended {
        return Err(Finding::error(file, "the file ends without @END", "take it from the archive again"));
    }
    let keys = Keys::parse(file, 2, head)?;
    let root = keys.root();
    findings.extend(root.unknown(&["name", "kind"]));
    let kind = root.text("kind")?.ok_or_else(|| root.missing("kind"))?;
    Ok(Programme {
        name: root.text("name")?.ok_or_else(|| root.missing("name"))?,
        kind: Kind::from_name(&kind)
            .ok_or_else(|| root.refuse("kind", "is not a kind of run", "use one of those of run files"))?,
        steps,
    })
}

fn step(file: &str, number: u64, line: &[u8], columns: &Columns, cells: &[Cell]) -> Result<Step, Finding> {
    let mut values = [0.0; 6];
    for (i, value) in values.iter_mut().enumerate() {
        *value = columns.required(file, number, cells, i)?;
    }
    let [duration_s, bx, by, bz, frequency_hz, position] = values;
    let rule = if duration_s <= 0.0 {
        Some("the duration must be positive")
    } else if frequency_hz < 0.0 {
        Some("the frequency is negative")
    } else if position < 0.0 || position.fract() != 0.0 || position > f64::from(u32::MAX) {
        Some("the position must be a whole number, 0 or more")
    } else {
        None
    };
    if let Some(rule) = rule {
        return Err(Finding::error(file, rule, "repair the value").at(number, 1).found(line));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "checked just above")]
    let position = position as u32;
    Ok(Step { duration_s, field: FieldCoil([bx, by, bz]), frequency_hz, position })
}

/// Writes a programme.
///
/// # Errors
/// An error of the writer.
pub fn write(out: &mut impl Write, programme: &Programme) -> io::Result<()> {
    let name = quoted(&programme.name);
    writeln!(out, "MAG 1\nname = {name}\nkind = \"{}\"\n{SECTION}\n{}", programme.kind, COLUMNS.join(","))?;
    for s in &programme.steps {
        let [bx, by, bz] = s.field.0.map(|b| fixed(b, 2));
        writeln!(out, "{},{bx},{by},{bz},{},{}", s.duration_s, s.frequency_hz, s.position)?;
    }
    writeln!(out, "@END")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_programme_survives_writing_and_reading() {
        let programme = Programme {
            name: "TEST.MAG\n@END \"of two lines\"".to_owned(),
            kind: Kind::Linearity,
            steps: vec![Step { duration_s: 24.5, field: FieldCoil([-2000.0, 0.25, 1.0]), frequency_hz: 0.316, position: 4 }],
        };
        let mut text = Vec::new();
        write(&mut text, &programme).unwrap();
        assert_eq!(parse("f", &text, &mut Vec::new()).unwrap(), programme);
    }

    #[test]
    fn mistakes_are_named_with_their_line() {
        let text = b"MAG 1\nname = \"T\"\nkind = \"offset\"\n@STEPS\nduration,bx,by,bz,frequency,position\n24,0,0,0,0,1\n24,0,x,0,0,1\n@END\n";
        let error = parse("f", text, &mut Vec::new()).unwrap_err();
        assert_eq!((error.line, error.column, error.found.as_deref()), (Some(7), Some(6), Some("x")));
        assert!(parse("f", b"MAG 1\nname = \"T\"\n", &mut Vec::new()).is_err());
    }
}
