//! The mapping as text, with reasons.

use super::roles::{Roles, Triple, Unit};
use super::{Contents, TimeFormat};
use crate::files::import::mapping::TemperatureUnit;
use crate::files::import::{Format, Separator};
use crate::files::text::quoted;
use std::fmt::Write;
use std::path::Path;

/// Start of a run whose date nothing tells.
const NO_START: &str = "2000-01-01T00:00:00Z";

/// What no table tells for certain.
const QUESTIONS: &str = "# Which sensor is it, and in which mode? Are the columns of [field] the field along the axes of the coil system, or the setting of a
# source? Which unit has each? In which zone are the times?
";

/// The mapping.
pub(super) fn mapping(path: &Path, contents: &Contents, roles: &Roles) -> String {
    let one_line = |text: &str| text.replace(char::is_control, " ");
    let name = one_line(&path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default());
    let mut out = format!(
        "# A proposal for {name}, from its names and numbers. Every line with CHECK wants a look by somebody who knows the data.\n"
    );
    out.push_str(QUESTIONS);
    file(&mut out, contents);
    run(&mut out, path, contents, roles);
    time(&mut out, contents, roles);
    reading(&mut out, roles);
    field(&mut out, roles);
    channels(&mut out, roles);
    rows(&mut out, roles);
    let used: Vec<&str> = contents.texts.iter().filter(|t| run_key(&t.name).is_none()).map(|t| t.name.as_str()).collect();
    let left: Vec<&str> = used.into_iter().chain(contents.others.iter().map(String::as_str)).collect();
    if !left.is_empty() {
        let _ = writeln!(out, "\n# Not used: {}", one_line(&left.join(", ")));
    }
    out
}

/// A line with a key and why it is so.
fn line(out: &mut String, text: &str, why: &str) {
    let _ = if why.is_empty() { writeln!(out, "{text}") } else { writeln!(out, "{text:<40} # {why}") };
}

fn list(triple: &Triple) -> String {
    let names: Vec<String> = triple.names.iter().map(|n| quoted(n)).collect();
    format!("[{}]", names.join(", "))
}

fn file(out: &mut String, contents: &Contents) {
    out.push_str("\n[file]\n");
    line(out, &format!("format = \"{}\"", contents.format.name()), "");
    if contents.format != Format::Csv {
        return;
    }
    let separator = contents.dialect.separator.unwrap_or(Separator::Char(','));
    line(out, &format!("separator = {}", quoted(&separator.text())), "all rows have as many cells as the header line");
    let comma = contents.dialect.decimal_comma;
    line(out, &format!("decimal = \"{}\"", if comma { "," } else { "." }), "");
    if contents.dialect.skip_rows > 0 {
        line(out, &format!("skip_rows = {}", contents.dialect.skip_rows), "lines before the header line");
    }
    if contents.dialect.latin_1 {
        line(out, "encoding = \"latin-1\"", "the text is not UTF-8");
    }
}

/// The key of the head that a column of texts has by its name.
fn run_key(name: &str) -> Option<&'static str> {
    match name.to_lowercase().as_str() {
        "sensor" | "instrument" => Some("sensor"),
        "mode" => Some("mode"),
        "configuration" | "programme" | "program" => Some("configuration"),
        _ => None,
    }
}

fn run(out: &mut String, path: &Path, contents: &Contents, roles: &Roles) {
    out.push_str("\n[run]\n");
    let (kind, why) = if roles.field.is_none() {
        ("zero-field", "no columns of an applied field were found")
    } else if roles.field_is_zero {
        ("zero-field", "the field is zero in all rows")
    } else if roles.frequency.is_some() {
        ("frequency", "there is a column of frequencies")
    } else if roles.positions > 1 {
        ("offset", "the sensor stands in several positions")
    } else {
        ("linearity", "or sweep, if the temperature moves during the run")
    };
    line(out, &format!("kind = \"{kind}\""), &format!("CHECK: {why}"));
    for (key, stand_in) in [("sensor", "sensor 1"), ("mode", "science")] {
        match contents.texts.iter().find(|t| run_key(&t.name) == Some(key)) {
            Some(text) => line(out, &format!("{key} = {{ column = {} }}", quoted(&text.name)), ""),
            None => line(out, &format!("{key} = \"{stand_in}\""), "CHECK: a stand-in, the table does not tell"),
        }
    }
    let why = match roles.ratio {
        _ if roles.unit_named => "by the name of the columns".to_owned(),
        Some((ratio, _)) => {
            format!("CHECK: the readings change by {ratio:.4} of what the field changes, as they stand in the table")
        }
        None => "CHECK: nothing tells the unit".to_owned(),
    };
    match roles.reading_unit {
        Unit::MicroTesla => line(out, "unit = \"uT\"", &why),
        Unit::Counts(factor) => {
            line(out, "unit = \"counts\"", &why);
            line(
                out,
                &format!("nominal_factor = {factor:?}"),
                "CHECK: enT per count, so that the readings are about as large as the field",
            );
        }
        _ => line(out, "unit = \"nT\"", &why),
    }
    if contents.time.format == Some(TimeFormat::Seconds) {
        match start_of_name(path) {
            Some(start) => line(out, &format!("start = \"{start}\""), "CHECK: by the name of the file"),
            None => line(out, &format!("start = \"{NO_START}\""), "CHECK: a stand-in, the times do not tell the date"),
        }
    }
    match &roles.position {
        Some(name) => line(out, &format!("position = {{ column = {} }}", quoted(name)), ""),
        None => line(out, "position = 1", ""),
    }
    if let Some((count, gap_s)) = roles.pauses {
        line(out, &format!("split_gap_s = {gap_s}"), &format!("CHECK: {count} longer pauses; every one begins another run"));
    }
    if contents.texts.iter().any(|t| run_key(&t.name).is_some() && t.distinct > 1) {
        let name = contents.texts.iter().find(|t| run_key(&t.name).is_some() && t.distinct > 1).map_or("", |t| t.name.as_str());
        line(out, &format!("split_column = {}", quoted(name)), "its value changes: every change begins another run");
    }
}

/// The start that the name of a file tells: 26-01-15_09-00-00, 2026-01-15T09-00-00, 20260115_090000.
fn start_of_name(path: &Path) -> Option<String> {
    let stem = path.file_stem()?.to_string_lossy().into_owned();
    let digits: String = stem.chars().filter(char::is_ascii_digit).collect();
    let digits = if digits.len() == 12 { format!("20{digits}") } else { digits };
    if digits.len() != 14 {
        return None;
    }
    let part = |range: std::ops::Range<usize>| digits.get(range).unwrap_or_default().to_owned();
    let start = format!("{}-{}-{}T{}:{}:{}Z", part(0..4), part(4..6), part(6..8), part(8..10), part(10..12), part(12..14));
    start.parse::<crate::data::start::Start>().ok().map(|_| start)
}

fn time(out: &mut String, contents: &Contents, roles: &Roles) {
    out.push_str("\n[time]\n");
    let time = &contents.time;
    line(
        out,
        &format!("column = {}", quoted(&time.column)),
        &format!("does not go back; the usual step is {:.6} s", roles.step_s),
    );
    if let Some(date) = &time.date {
        line(out, &format!("date = {}", quoted(date)), "the dates that stand before these times");
    }
    if let Some(format) = &time.format {
        let slashes = format.name().contains("/%m/%Y") || format.name().contains("%m/%d/");
        let why = if slashes { "CHECK: which of the two is the day" } else { "" };
        line(out, &format!("format = {}", quoted(format.name())), why);
    }
    let needs_zone = !time.zoned && !matches!(time.format, Some(TimeFormat::Seconds | TimeFormat::Unix | TimeFormat::UnixMs));
    if needs_zone {
        line(out, "zone = \"UTC\"", "CHECK: the times do not tell their zone; \"+02:00\" or \"Europe/Berlin\" otherwise");
    }
    if let Some(counter) = &roles.counter {
        line(out, &format!("counter = {}", quoted(counter)), "goes on by one with every row, but for losses");
    }
}

fn reading(out: &mut String, roles: &Roles) {
    out.push_str("\n[reading]\n");
    let why = match roles.ratio {
        Some((_, part)) => format!("CHECK: order x, y, z; the field explains {:.1} % of their changes", 100.0 * part.min(1.0)),
        None => "CHECK: order x, y, z".to_owned(),
    };
    line(out, &format!("columns = {}", list(&roles.reading)), &why);
    if let (Some(std), Some(count)) = (&roles.std, &roles.count) {
        line(out, &format!("std = {}", list(std)), "standard deviations of the samples of a plateau, by their names");
        line(out, &format!("count = {}", quoted(count)), "samples of a plateau");
    }
}

fn field(out: &mut String, roles: &Roles) {
    let Some(field) = &roles.field else { return };
    out.push_str("\n[field]\n");
    let why = format!("rests in {:.0} % of the rows; CHECK: coil axes, and order x, y, z", 100.0 * field.still);
    line(out, &format!("columns = {}", list(field)), &why);
    match roles.field_unit {
        Unit::MicroTesla => line(out, "unit = \"uT\"", "CHECK"),
        Unit::Ampere(each) => {
            line(out, "unit = \"A\"", "CHECK");
            line(
                out,
                &format!("nt_per_a = {each:?}"),
                "CHECK: a stand-in that makes the field as large as the readings; write the coil constants",
            );
        }
        _ => line(out, "unit = \"nT\"", "CHECK"),
    }
    if let Some(frequency) = &roles.frequency {
        line(out, &format!("frequency = {}", quoted(frequency)), "Hz, 0 for a constant field");
    }
    if !roles.plateaus {
        line(out, "same_setting_within_nt = 0.5", "fields that differ by less are one setting");
    }
}

fn channels(out: &mut String, roles: &Roles) {
    if !roles.temperatures.is_empty() {
        out.push_str("\n[temperature]\n");
    }
    for t in &roles.temperatures {
        let why = match t.channel.as_str() {
            "T59" => "CHECK: T59 is taken for the temperature of the sensor",
            "T29" => "CHECK: T29 is taken for the temperature of the coil",
            _ => "",
        };
        let unit = match t.unit {
            TemperatureUnit::Celsius => None,
            TemperatureUnit::Kelvin => Some("K"),
            TemperatureUnit::Fahrenheit => Some("degF"),
        };
        let text = match unit {
            Some(unit) => format!("{} = {{ column = {}, unit = \"{unit}\" }}", t.channel, quoted(&t.column)),
            None => format!("{} = {}", t.channel, quoted(&t.column)),
        };
        let of_unit = match (t.unit_named, t.unit) {
            (true, _) => String::new(),
            (false, TemperatureUnit::Celsius) => {
                format!("CHECK: no name tells the unit; {:.1} is taken for degrees Celsius. ", t.middle)
            }
            (false, _) => format!("{:.1} would be no usual temperature in degrees Celsius. ", t.middle),
        };
        line(out, &text, &format!("{of_unit}{why}"));
    }
    if !roles.channels.is_empty() {
        out.push_str("\n[channel]\n");
    }
    for (channel, column) in &roles.channels {
        line(out, &format!("{channel} = {}", quoted(column)), "");
    }
}

fn rows(out: &mut String, roles: &Roles) {
    out.push_str("\n[rows]\n");
    if roles.plateaus {
        line(
            out,
            "are = \"plateaus\"",
            "CHECK: the field changes with almost every row; a row holds from its time to that of the next one",
        );
    } else {
        line(out, "are = \"samples\"", "");
    }
}
