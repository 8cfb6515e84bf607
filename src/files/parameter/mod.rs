//! Parameter files: TOML with a common head and one body per kind.
//!
//! Numbers are written with as many digits as it takes to read the same number back. `content_sha256` is the hash of the file
//! without its `created` and `content_sha256` lines, so that equal results have equal hashes and a damaged file shows.

mod centre;
mod coil;
mod cpf;
mod domains;
mod emit;
mod field;
mod fpf;
mod kept;
mod kind;
mod linearisation;
mod model;
mod null;
mod opf;
mod point;
mod quantity;
mod sound;
mod thermal;
mod thermistor;

pub use centre::{CentreConvention, OffCentrePart, Tcf};
pub use coil::{CoilConvention, CoilResidual, CoilScalar, CoilTilt};
pub use cpf::{Convention, Cpf, alone_of};
pub use emit::toml;
use field::contradicts;
pub(in crate::files) use field::matrix_of;
pub use field::{FieldPart, HeldIn};
pub use fpf::{Fpf, FrequencyConvention};
pub use kept::Kept;
pub use kind::{FileKind, KINDS, Naming, files_of, is_named};
pub use linearisation::{LinearisationConvention, LinearisationFile, linearisation_file_name};
pub use model::{Model, ModelEffect, ModelParameter};
pub use null::{Npf, NullConvention};
pub use opf::{OffsetConvention, Opf};
pub use point::{Point, read_point};
pub use quantity::{Argument, Entry, Polynomial, Quantities, Shape, Validity};
pub(in crate::files) use sound::{is_covariance, is_sound_table};
pub use thermal::{
    CommonCoefficients, JointPart, NO_CHANNEL, NoisePart, SweepPart, Taf, ThermalConvention, ThermalHead, Tof, Tpf,
};
pub use thermistor::{ThermistorConvention, ThermistorFile};

use super::source::{hex, read_whole};
use crate::data::apply::Apply;
use crate::data::error::Finding;
use crate::data::note::Told;
use crate::data::provenance::{Input, Provenance};
use crate::model::field_calibration::Frame;
use serde::{Deserialize, Serialize, de::DeserializeOwned};
use sha2::{Digest, Sha256};
use std::path::Path;
use toml_edit::DocumentMut;

/// What a kind of parameter file holds. Its line in [`KINDS`] makes it known to all commands.
pub trait Body: Serialize + DeserializeOwned {
    /// Value of `format`.
    const FORMAT: &'static str;
    /// How its files are named.
    const NAMING: Naming;
    /// Where its quantities stand for the exports that list them.
    const QUANTITIES: Option<&'static Quantities> = None;
    /// Its part in analyses across temperatures.
    const POINT: Option<Point> = None;
    /// Keys whose lists may hold nan, which stands for a value that was not determined.
    const MAY_LACK: &'static [&'static str] = &[];
    /// Keys that stand in every file, with nan where their value is not known.
    const KEPT: &'static [Kept] = &[];
    /// Version of the layout that is written.
    const VERSION: u32 = 1;
    /// Why files of an earlier version are refused; without a reason they are read.
    const REFUSED_BEFORE: Option<&'static str> = None;
    /// File name for a run.
    fn file_name(&self) -> String;
    /// How the coefficients are applied; `None` for a kind that is not applied to readings.
    fn apply(&self) -> Option<Apply> {
        None
    }
    /// Its part in the way from a reading to the field in a frame; `None` for a kind that is not applied to readings.
    fn field(&self, _frame: Frame) -> Option<FieldPart> {
        None
    }
    /// Looks at what the types alone do not tell.
    ///
    /// # Errors
    /// An impossible value.
    fn validate(&self, _path: &Path) -> Result<(), Finding> {
        Ok(())
    }
}

#[derive(Deserialize)]
struct Head {
    format: String,
    version: u32,
    provenance: Provenance,
    #[serde(flatten)]
    told: Told,
}

/// A parameter file as it was read.
#[derive(Clone, Debug)]
pub struct ParameterFile<B> {
    /// The file itself, under its name.
    pub input: Input,
    /// Where it comes from.
    pub provenance: Provenance,
    /// What a person should know of it.
    pub told: Told,
    /// What it holds.
    pub body: B,
}

/// The text of a parameter file.
///
/// # Errors
/// Values that have no TOML form.
pub fn to_text<B: Body>(body: &B, provenance: &Provenance) -> Result<String, serde_json::Error> {
    let mut document = serde_json::Map::new();
    document.insert("format".to_owned(), B::FORMAT.into());
    document.insert("version".to_owned(), B::VERSION.into());
    let mut head = serde_json::to_value(provenance)?;
    if let Some(table) = head.as_object_mut() {
        table.insert("content_sha256".to_owned(), "".into());
    }
    document.insert("provenance".to_owned(), head);
    if let Some(apply) = body.apply() {
        document.insert("apply".to_owned(), serde_json::to_value(apply)?);
    }
    if let serde_json::Value::Object(table) = serde_json::to_value(body)? {
        document.extend(table);
    }
    if document.iter().any(|(key, value)| !B::MAY_LACK.contains(&key.as_str()) && holds_gap(value)) {
        return Err(serde::ser::Error::custom("a value is not finite"));
    }
    kept::put_in(&mut document, B::KEPT);
    let text = format!("# calfit {} parameter file\n{}", B::FORMAT, emit::toml_keeping(&document, &kept::numbers(B::KEPT)));
    let hash = content_hash(&text);
    Ok(text.replacen("content_sha256 = \"\"", &format!("content_sha256 = \"{hash}\""), 1))
}

/// A null within a list is a number that was not finite; a null key is one that is absent.
fn holds_gap(value: &serde_json::Value) -> bool {
    match value {
        serde_json::Value::Array(list) => list.iter().any(|v| v.is_null() || holds_gap(v)),
        serde_json::Value::Object(table) => table.values().any(holds_gap),
        _ => false,
    }
}

pub(in crate::files) fn content_hash(text: &str) -> String {
    let mut hash = Sha256::new();
    for line in text.lines().filter(|l| !l.starts_with("created = ") && !l.starts_with("content_sha256 = ")) {
        hash.update(line.as_bytes());
        hash.update(b"\n");
    }
    hex(&hash.finalize())
}

/// A parameter file of any kind.
#[derive(Clone, Debug)]
pub struct AnyFile {
    /// The file itself, under its name.
    pub input: Input,
    /// Where it comes from.
    pub provenance: Provenance,
    /// What a person should know of it.
    pub told: Told,
    /// All of it.
    pub document: DocumentMut,
}

/// Text and head of a parameter file whose hash is right; the text is without the keys whose values are not known.
fn open(path: &Path) -> Result<(String, DocumentMut, Head, Input), Finding> {
    let (bytes, digested) = read_whole(path)?;
    let file = path.display().to_string();
    let refuse = |rule: String, remedy: &str| Finding::error(&file, rule, remedy);
    let text = String::from_utf8(bytes)
        .map_err(|_| refuse("the file is not UTF-8 text".to_owned(), "take it from the archive again"))?;
    let head: Head = toml_edit::de::from_str(&text)
        .map_err(|e| refuse(format!("is not a parameter file of this program: {}", e.message()), "check the file"))?;
    kind::readable_version(&head.format, head.version).map_err(|(rule, remedy)| refuse(rule, remedy))?;
    let stated = text.lines().find_map(|l| l.strip_prefix("content_sha256 = "));
    if stated.is_none_or(|s| s.trim_matches('"') != content_hash(&text)) {
        return Err(refuse(
            "was changed after it was written: its hash is missing or does not match".to_owned(),
            "take the original, or fit again",
        ));
    }
    let document: DocumentMut = text
        .parse()
        .map_err(|e: toml_edit::TomlError| refuse(format!("is not TOML: {}", e.message()), "take it from the archive again"))?;
    let kind = FileKind::of_format(&head.format);
    let own = kept::without_unknown(&document, kind.map_or(&[], |kind| kind.kept));
    sound::is_sound(path, own.as_ref().unwrap_or(&document), kind.map_or(&[], |kind| kind.may_lack))?;
    let known = own.map_or(text, |own| own.to_string());
    let name = path.file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or_default();
    Ok((known, document, head, digested.input(name)))
}

/// Reads a parameter file of any kind and checks its hash.
///
/// # Errors
/// What is wrong with it: not TOML, without the head of a parameter file, another version, a hash that does not match.
pub fn read_any(path: &Path) -> Result<AnyFile, Finding> {
    let (text, document, head, input) = open(path)?;
    if let Some(kind) = FileKind::of_format(&head.format) {
        (kind.is_sound)(path, &text)?;
    }
    Ok(AnyFile { input, provenance: head.provenance, told: head.told, document })
}

/// Reads a parameter file of a known kind and checks its hash.
///
/// # Errors
/// As [`read_any`], and another kind or a key that is missing.
pub fn read<B: Body>(path: &Path) -> Result<ParameterFile<B>, Finding> {
    let (text, _, head, input) = open(path)?;
    if head.format != B::FORMAT {
        let rule = format!("holds format {}, not {}", head.format, B::FORMAT);
        return Err(Finding::error(&path.display().to_string(), rule, "name a file of the right kind"));
    }
    Ok(ParameterFile { input, provenance: head.provenance, told: head.told, body: body(path, &text)? })
}

/// What the text of a file of a known kind holds, if that can be.
fn body<B: Body>(path: &Path, text: &str) -> Result<B, Finding> {
    let body: B = toml_edit::de::from_str(text).map_err(|e| {
        let rule = format!("is not a {} file: {}", B::FORMAT, e.message());
        Finding::error(&path.display().to_string(), rule, "check the file")
    })?;
    is_consistent(&body, path, text)?;
    Ok(body)
}

/// Refuses an impossible value, and a table `[apply]`, by which other programs go, that is not that of the coefficients.
fn is_consistent<B: Body>(body: &B, path: &Path, text: &str) -> Result<(), Finding> {
    #[derive(Deserialize)]
    struct Stated {
        version: u32,
        apply: Option<Apply>,
    }
    body.validate(path)?;
    // A table that is none of this program is told by its words.
    let stated: Stated =
        toml_edit::de::from_str(text).map_err(|e| contradicts(path, format!("apply cannot be followed: {}", e.message())))?;
    let own = body.apply();
    let agrees = |stated: Apply| own.is_some_and(|own| stated.agrees_with(&own));
    if stated.version == B::VERSION && stated.apply.is_some_and(|stated| !agrees(stated)) {
        return Err(contradicts(path, "apply says another way from the reading to the field than the coefficients"));
    }
    Ok(())
}
