//! The keys at the head of a run file.

use crate::data::error::{Finding, Severity};
use crate::data::run::{Header, Kind, ReadingUnit};
use crate::data::start::{NoStart, Start};
use crate::files::text::Keys;

/// Whether a run id can be used in file names: letters, digits, `-`, `_` and `.`, not beginning with a point.
#[must_use]
pub fn run_id_is_safe(id: &str) -> bool {
    !id.is_empty()
        && id.len() <= 64
        && !id.starts_with('.')
        && id.bytes().all(|b| b.is_ascii_alphanumeric() || matches!(b, b'-' | b'_' | b'.'))
}

const KNOWN: [&str; 12] = [
    "run",
    "start",
    "kind",
    "configuration",
    "sensor",
    "mode",
    "sample_rate",
    "unit",
    "nominal_factor",
    "field_source",
    "coil_correction",
    "earthfield_compensation",
];

/// Reads the keys; warnings go to `findings`.
pub(super) fn parse(file: &str, text: String, findings: &mut Vec<Finding>) -> Result<Header, Finding> {
    let keys = Keys::parse(file, 2, text)?;
    let root = keys.root();
    findings.extend(root.unknown(&KNOWN));

    let run = root.text("run")?.ok_or_else(|| root.missing("run"))?;
    if !run_id_is_safe(&run) {
        return Err(root.refuse("run", "may hold letters, digits, `-`, `_` and `.` only", "write it as YY-MM-DD_hh-mm-ss"));
    }
    let start = root.text("start")?.ok_or_else(|| root.missing("start"))?;
    let start: Start = start.parse().map_err(|e: NoStart| root.refuse("start", &e.to_string(), NoStart::REMEDY))?;
    let kind_name = root.text("kind")?.ok_or_else(|| root.missing("kind"))?;
    let kind = Kind::from_name(&kind_name).ok_or_else(|| {
        let names: Vec<&str> = Kind::NAMES.iter().map(|(_, name)| *name).collect();
        root.refuse("kind", "is not a kind of run", &format!("use one of {}", names.join(", ")))
    })?;
    let unit = match root.text("unit")?.ok_or_else(|| root.missing("unit"))?.as_str() {
        "enT" => {
            if root.number("nominal_factor")?.is_some() {
                let unused = root.refuse(
                    "nominal_factor",
                    "stands beside unit = \"enT\" and was not used",
                    "use unit = \"counts\", or take it out",
                );
                findings.push(unused.weighing(Severity::Warning));
            }
            ReadingUnit::Ent
        }
        "counts" => {
            let ent_per_count = root.number("nominal_factor")?.ok_or_else(|| root.missing("nominal_factor"))?;
            if ent_per_count <= 0.0 {
                return Err(root.refuse("nominal_factor", "must be positive", "write enT per count"));
            }
            ReadingUnit::Counts { ent_per_count }
        }
        _ => return Err(root.refuse("unit", "is not a unit of readings", "use \"enT\", or \"counts\" with `nominal_factor`")),
    };
    let sample_rate_hz = root.number("sample_rate")?.ok_or_else(|| root.missing("sample_rate"))?;
    if sample_rate_hz <= 0.0 {
        return Err(root.refuse("sample_rate", "must be positive", "write the nominal sample rate in Hz"));
    }
    // Without sensor and mode runs of several cannot be told apart; the others are for the record.
    let mut optional = |key: &str, weight: Severity| -> Result<String, Finding> {
        let value = root.text(key)?;
        if value.is_none() {
            findings.push(root.missing(key).weighing(weight));
        }
        Ok(value.unwrap_or_default())
    };
    Ok(Header {
        run,
        start,
        kind,
        configuration: optional("configuration", Severity::Note)?,
        sensor: optional("sensor", Severity::Warning)?,
        mode: optional("mode", Severity::Warning)?,
        sample_rate_hz,
        unit,
        field_source: optional("field_source", Severity::Note)?,
        coil_correction: root.truth("coil_correction")?,
        earthfield_compensation: root.texts("earthfield_compensation")?.unwrap_or_default(),
    })
}
