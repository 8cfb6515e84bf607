//! Results as tables for people. Reads result structs and computes nothing about the sensor.

pub mod centre;
pub mod coil;
pub mod diagnose;
pub mod document;
#[cfg(feature = "tables")]
pub mod flight;
pub mod freq;
pub mod html;
pub mod lin;
pub mod linearise;
pub mod markdown;
pub mod null;
pub mod offset;
pub mod protocol;
pub mod runs;
pub mod sweep;
pub mod thermal;
pub mod thermistor;

use crate::data::note::Note;
use crate::data::provenance::{Input, Provenance};
use crate::data::result::{Dropped, RunHead};
use crate::data::run::Location;
use crate::data::start::Start;
use crate::data::units::with_uncertainty;
use crate::model::applied::ModelApplied;
use document::{Block, Cell, Document, Figure, NOT_DETERMINED, Section, Table, Text, cells};
use serde::{Deserialize, Serialize};

/// Text for a value that may be missing.
#[must_use]
pub fn or_not_stated(text: &str) -> &str {
    if text.is_empty() { "not stated" } else { text }
}

/// A mode that may be missing, with the location of the sensor where that is not the centre.
#[must_use]
pub fn mode_at(mode: &str, location: Location) -> String {
    format!("{}{}", or_not_stated(mode), location.suffix())
}

/// A temperature that may be missing.
#[must_use]
pub fn degc(value: Option<f64>) -> String {
    value.map_or_else(|| "not recorded".to_owned(), |v| format!("{v:.1} °C"))
}

/// Run, sensor, mode and temperature in one line.
#[must_use]
pub fn run_line(run: &RunHead) -> String {
    let temperature = run.temperature_degc.map_or_else(String::new, |t| format!(", {t:.1} °C"));
    format!("{}  {} {}{}{temperature}", run.id, run.sensor, run.mode, run.location.suffix())
}

/// The section on the used file with the name of the parameter file.
#[must_use]
pub fn used_file(run: &RunHead, parameter_file: &str) -> Section {
    let table = Table::new(["run", "configuration", "sensor", "mode", "start", "sensor temperature"]).with_rows([cells![
        &run.id,
        or_not_stated(&run.configuration),
        or_not_stated(&run.sensor),
        mode_at(&run.mode, run.location),
        run.start.as_ref().map_or("", Start::as_str),
        Cell::degc(run.temperature_degc),
    ]]);
    Section::new("Used measurement").with(table).with(self::parameter_file(parameter_file))
}

/// The name of the parameter file that a report goes with.
fn parameter_file(name: &str) -> Text {
    Text::from("Parameter file: ").code(name).and(".")
}

/// What was taken off the readings before a fit.
fn known_effects(model: &ModelApplied) -> Text {
    Text::of_note(&model.sentence())
}

fn yes_or_no(yes: bool) -> &'static str {
    if yes { "yes" } else { "no" }
}

/// A figure as it was written.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Drawn {
    /// File name.
    pub file: String,
    /// Title.
    pub title: String,
    /// Caption.
    pub caption: String,
}

impl Drawn {
    /// Numbers figures on from the last number used; `folder` leads to them from the report and is empty or ends with `/`.
    #[must_use]
    pub fn number(drawn: &[Drawn], folder: &str, last: &mut usize) -> Vec<Figure> {
        let figure = |d: &Drawn| {
            *last += 1;
            Figure { file: format!("{folder}{}", d.file), number: *last, title: d.title.clone(), caption: d.caption.clone() }
        };
        drawn.iter().map(figure).collect()
    }
}

/// A report of its own: notes that concern the result as a whole, its sections, its figures and its origin.
#[must_use]
pub fn standalone(
    title: &str,
    notes: &[Note],
    mut sections: Vec<Section>,
    figures: Vec<Figure>,
    provenance: &Provenance,
) -> Document {
    if !figures.is_empty() {
        // Reports have had one more empty line after their figures from the beginning.
        sections.push(Section::new("Figures").with_all(figures).with(""));
    }
    sections.push(Section::new("Origin").with(inputs(provenance)));
    let made = format!("Made by {} {} ({}), ", provenance.tool, provenance.tool_version, provenance.build);
    Document {
        title: title.to_owned(),
        front: notes.iter().filter(|n| n.comes_first()).cloned().map(Block::from).collect(),
        sections,
        colophon: Some(Text::from(made).code(&provenance.command).and(format!(", {}.", provenance.created))),
    }
}

/// The inputs with their hashes.
fn inputs(provenance: &Provenance) -> Table {
    let hash = |i: &Input| Text::default().code(&i.sha256);
    if provenance.input.iter().all(|i| i.from.is_none()) {
        let row = |i: &Input| cells![&i.path, i.size_bytes, hash(i)];
        return Table::new(["input", "bytes", "SHA-256"]).with_rows(provenance.input.iter().map(row));
    }
    let moment = |moment: &Option<Start>| moment.as_ref().map_or(Cell::Missing("-"), |at| at.as_str().into());
    let row = |i: &Input| cells![&i.path, moment(&i.from), moment(&i.until), i.size_bytes, hash(i)];
    Table::new(["input", "from, UTC", "until, UTC", "bytes", "SHA-256"]).with_rows(provenance.input.iter().map(row))
}

/// The section with all notes; nothing without notes.
#[must_use]
pub fn remarks(notes: &[Note]) -> Option<Section> {
    let items = || notes.iter().map(|note| Text::of_note(&note.to_string())).collect();
    (!notes.is_empty()).then(|| Section::new("Remarks").with(Block::List(items())))
}

/// The section with the plateaus that were not used; nothing if all were.
#[must_use]
pub fn not_used(dropped: &[Dropped]) -> Option<Section> {
    let row = |d: &Dropped| {
        let [x, y, z] = d.field_coil_nt.map(|v| Cell::fixed(v, 2));
        cells![d.block, Cell::fixed(d.t_start_s, 1), x, y, z, &d.reason]
    };
    let table =
        || Table::new(["block", "begin, s", "X, nT", "Y, nT", "Z, nT", "not used because"]).with_rows(dropped.iter().map(row));
    (!dropped.is_empty()).then(|| Section::new("Plateaus not used").with(table()))
}

/// The first columns of a table with one row per run.
#[cfg(feature = "tables")]
pub fn head_columns<'a>(table: &mut crate::files::table::Table, runs: impl Iterator<Item = &'a RunHead>) {
    use crate::files::table::Values;
    let runs: Vec<&RunHead> = runs.collect();
    let text = |get: fn(&RunHead) -> &str| Values::Text(runs.iter().map(|r| get(r).to_owned()).collect());
    let degc = |get: fn(&RunHead) -> Option<f64>| Values::Numbers(runs.iter().map(|r| get(r).unwrap_or(f64::NAN)).collect());
    table.push("run", text(|r| &r.id));
    table.push("sensor", text(|r| &r.sensor));
    table.push("mode", text(|r| &r.mode));
    if runs.iter().any(|r| !r.location.is_centre()) {
        let names = runs.iter().map(|r| Location::NAMES.iter().find(|(l, _)| *l == r.location).map_or("", |(_, name)| name));
        table.push("location", Values::Text(names.map(str::to_owned).collect()));
    }
    table.push("temperature_degc", degc(|r| r.temperature_degc));
    table.push("coil_temperature_degc", degc(|r| r.coil_temperature_degc));
}

/// Three values with their standard uncertainties in one line.
#[must_use]
pub fn triple(values: &[f64; 3], std: &[f64; 3]) -> String {
    (0..3).map(|i| value(values[i], std[i])).collect::<Vec<_>>().join(", ")
}

/// A value with its standard uncertainty; either may be missing.
#[must_use]
pub fn value(value: f64, std: f64) -> String {
    match (value.is_finite(), std.is_finite()) {
        (true, true) => with_uncertainty(value, std),
        (true, false) => format!("{value:.2} (uncertainty not known)"),
        (false, _) => NOT_DETERMINED.to_owned(),
    }
}

/// A number with some decimals; it may be missing.
#[must_use]
pub fn number(value: f64, decimals: usize) -> String {
    if value.is_finite() { format!("{value:.decimals$}") } else { NOT_DETERMINED.to_owned() }
}
