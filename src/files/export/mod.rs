//! Parameter files in the forms of other programs: one file and one line of [`FORMATS`] per form.

mod csv;
mod dcc;
mod json;
mod quantity;
pub mod rpcmag;

use super::parameter::{AnyFile, Body, ParameterFile, read, read_any};
use crate::data::error::Finding;
use crate::data::note::Note;
use crate::data::provenance::Provenance;
use crate::data::run::Location;
use std::path::{Path, PathBuf};

/// Writes parameter files in one form.
pub type Write = fn(&[Source], &Options) -> Result<Vec<Exported>, Finding>;

/// The forms by their names on the command line.
pub const FORMATS: [(&str, Write); 4] =
    [("rpcmag", rpcmag::export_all), ("json", json::export), ("csv", csv::export), ("dcc", dcc::export)];

/// What the forms need beside the files.
#[derive(Clone, Debug)]
pub struct Options {
    /// Origin of the exported file; its inputs are the parameter files.
    pub provenance: Provenance,
    /// The polynomials of a TPF were measured at the centre of the coil system, so that K is the identity.
    pub at_centre: bool,
    /// Entries of `[report]` of a campaign file, label and text: laboratory, item and persons.
    pub report: Vec<(&'static str, String)>,
}

/// A parameter file to export.
#[derive(Clone, Debug)]
pub struct Source {
    path: PathBuf,
    file: AnyFile,
    /// All of it; a number that is none is null.
    value: serde_json::Value,
}

/// A sentence about the values of a file.
struct Told {
    /// What it is about, in a word.
    name: &'static str,
    text: String,
}

/// A file in another form.
#[derive(Clone, Debug, PartialEq)]
pub struct Exported {
    /// Its name.
    pub name: String,
    /// Its content.
    pub text: String,
}

impl Source {
    /// Reads a parameter file of any kind and checks its hash.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn read(path: &Path) -> Result<Self, Finding> {
        let file = read_any(path)?;
        let value = toml_edit::de::from_document(file.document.clone()).map_err(|e| {
            Finding::error(&path.display().to_string(), format!("has no JSON form: {}", e.message()), "check the file")
        })?;
        Ok(Self { path: path.to_owned(), file, value })
    }

    /// What it is, with its hash.
    #[must_use]
    pub fn input(&self) -> &crate::data::provenance::Input {
        &self.file.input
    }

    /// What qualifies its values.
    #[must_use]
    pub fn notes(&self) -> Vec<Note> {
        self.file.told.with_values_of(self.name())
    }

    /// What a person must know to use its values, beside the values.
    fn told(&self) -> Vec<Told> {
        let mut list = Vec::new();
        let mut tell = |name: &'static str, text: String| list.push(Told { name, text });
        if ["/location", "/run/location"].into_iter().any(|at| self.location(at) == Some(Location::OffCentre)) {
            let text = "the sensor stood beside the centre of the coil system, whose field there is not that of its settings: the sensitivities \
                        and angles are not those at the centre, which a TCF file has";
            tell("location", text.to_owned());
        }
        if let Some((form, seconds)) = self.text("/sweep/applied_lag/form").zip(self.number("/sweep/applied_lag/lag_s"))
            && seconds != 0.0
        {
            let channel = self.text("/channel").unwrap_or("the thermistor");
            let text = format!(
                "the temperatures of the polynomials are those of {channel} with a lag ({form}) of {seconds:?} s: where the temperature moves, \
                 take those of {channel} with this lag, not as they are read"
            );
            tell("lag", text);
        }
        let of_model = self.text("/model/file").into_iter();
        let known = self.value.get("known_effects").and_then(serde_json::Value::as_array);
        let effects: Vec<&str> = known.into_iter().flatten().filter_map(|v| v.as_str()).chain(of_model).collect();
        if !effects.is_empty() {
            let text = format!("the values hold for readings from which the effects of {} were taken off", effects.join(", "));
            tell("known effects", text);
        }
        self.notes().iter().for_each(|note| tell("warning", Note { of: None, ..note.clone() }.to_string()));
        list
    }

    fn location(&self, pointer: &str) -> Option<Location> {
        Location::from_name(self.text(pointer)?)
    }

    /// Whether uncertainties of both types together stand in it.
    fn has_combined(&self) -> bool {
        ["std_combined", "covariance_combined", "together_combined"].into_iter().any(|key| self.value.get(key).is_some())
    }

    fn name(&self) -> &str {
        &self.file.input.path
    }

    fn format(&self) -> &str {
        self.value["format"].as_str().unwrap_or_default()
    }

    fn text(&self, pointer: &str) -> Option<&str> {
        self.value.pointer(pointer).and_then(serde_json::Value::as_str)
    }

    fn number(&self, pointer: &str) -> Option<f64> {
        self.value.pointer(pointer).and_then(serde_json::Value::as_f64)
    }

    fn refuse(&self, rule: impl Into<Box<str>>, remedy: impl Into<Box<str>>) -> Finding {
        Finding::error(&self.path.display().to_string(), rule, remedy)
    }

    /// The file as what its format says.
    fn typed<B: Body>(&self) -> Result<ParameterFile<B>, Finding> {
        read::<B>(&self.path)
    }
}
