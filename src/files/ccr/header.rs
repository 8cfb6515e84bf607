//! The keys at the head of a run file.

use crate::data::error::{Finding, Severity};
use crate::data::run::{Header, Kind, ReadingUnit, time_of_id};
use crate::data::start::{NoStart, Start};
use crate::files::text::Keys;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;

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

/// A run id tells the start of its run to this, s: files get their names some time before the first sample or after it, and clocks differ.
const NEAR_S: f64 = 300.0;

/// By how much the start of a run is later than the time that its id tells, s, where the two contradict each other. An id tells the time in UTC,
/// or in the zone in which the start is written.
pub(super) fn later_than_id(run: &str, start: &Start) -> Option<f64> {
    let seconds = |time: DateTime| Some(time.to_zoned(TimeZone::UTC).ok()?.timestamp().as_second() as f64);
    // Two digits of the year: others are names of other kinds.
    let told = time_of_id(run).filter(|_| run.find('-') == Some(2)).and_then(seconds)?;
    let in_its_zone =
        start.as_str().get(.."2013-04-03T09:22:38".len()).and_then(|text| text.parse::<DateTime>().ok()).and_then(seconds);
    let later = [Some(start.seconds()), in_its_zone].into_iter().flatten().map(|s| s - told);
    later.min_by(|a, b| a.abs().total_cmp(&b.abs())).filter(|s| s.abs() > NEAR_S)
}

/// A length of time in words.
pub(super) fn length(seconds: f64) -> String {
    match seconds.abs() {
        s if s < 2.0 * 3600.0 => format!("{:.0} min", s / 60.0),
        s if s < 2.0 * 86_400.0 => format!("{:.1} h", s / 3600.0),
        s => format!("{:.0} days", s / 86_400.0),
    }
}

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
    if let Some(later_s) = later_than_id(&run, &start) {
        let rule = format!(
            "is {start}, {} {} than the run id {run} tells",
            length(later_s),
            if later_s > 0.0 { "later" } else { "earlier" }
        );
        let remedy = "correct the wrong one of the two: the periods of the facility and the order of the runs follow `start`";
        findings.push(root.refuse("start", &rule, remedy).weighing(Severity::Warning));
    }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_start_that_contradicts_the_run_id_is_told_with_its_distance() {
        let told = |run: &str, start: &str| later_than_id(run, &start.parse().unwrap()).map(|s| (s > 0.0, length(s)));
        let later = |words: &str| Some((true, words.to_owned()));
        // The examples of the formats, UTC and a zone of its own.
        assert_eq!(told("13-04-03_09-22-38", "2013-04-03T09:22:38Z"), None);
        assert_eq!(told("13-04-03_09-22-38", "2013-04-03T11:22:38+02:00"), None);
        assert_eq!(told("13-04-03_11-22-38", "2013-04-03T11:22:38+02:00"), None);
        assert_eq!(told("98-03-23_00-00-04", "1998-03-23T00:00:04.25Z"), None);
        assert_eq!(told("13-04-03_09-22-38", "2013-04-03T09:24:00Z"), None);
        // Summer time, a slip of a century's half, the wrong day; ids that tell no time.
        assert_eq!(told("26-03-03_11-00-00", "2026-03-03T12:00:00+00:00"), later("60 min"));
        assert_eq!(told("26-03-03_11-00-00", "2026-03-03T10:00:00Z"), Some((false, "60 min".to_owned())));
        // 36 years of which nine are leap years.
        assert_eq!(told("26-03-03_11-00-00", "2062-03-03T11:00:00Z"), later("13149 days"));
        assert_eq!(told("26-03-03_11-00-00", "2026-03-04T11:00:00Z"), later("24.0 h"));
        for other in ["RUN_7", "2026-03-03_11-00-00", "26-03-03", "26-13-03_11-00-00"] {
            assert_eq!(told(other, "2030-01-01T00:00:00Z"), None, "{other}");
        }
    }
}
