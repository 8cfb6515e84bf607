//! The kinds of parameter files, one line each: what every command that takes parameter files needs to know of them.

use super::point::Point;
use super::quantity::Quantities;
use super::{
    Body, CoilResidual, CoilScalar, CoilTilt, Cpf, FieldPart, Fpf, Kept, LinearisationFile, Model, Npf, Opf, Taf, Tcf,
    ThermistorFile, Tof, Tpf, is_consistent, read, to_text,
};
use crate::data::error::Finding;
use crate::data::provenance::{Input, Role};
use crate::files::source::small_text;
use crate::model::field_calibration::Frame;
use std::fmt;
use std::path::{Path, PathBuf};

/// All kinds of parameter files.
pub static KINDS: &[FileKind] = &[
    FileKind::of::<Cpf>(),
    FileKind::of::<Opf>(),
    FileKind::of::<Fpf>(),
    FileKind::of::<Tpf>(),
    FileKind::of::<Tof>(),
    FileKind::of::<Taf>(),
    FileKind::of::<Tcf>(),
    FileKind::of::<Npf>(),
    FileKind::of::<LinearisationFile>(),
    FileKind::of::<ThermistorFile>(),
    FileKind::of::<CoilScalar>(),
    FileKind::of::<CoilResidual>(),
    FileKind::of::<CoilTilt>(),
    FileKind::of::<Model>(),
];

/// How files of a kind are named.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Naming {
    /// The part after the last point is the format, in letters of any case.
    Extension,
    /// TOML whose name begins with this.
    Begin(&'static str),
    /// TOML of any name; the key `format` tells the kind.
    Free,
}

/// Reads the part of a file in the way from a reading to the field.
type ReadField = fn(&Path, Frame) -> Result<(Option<FieldPart>, Input), Finding>;

/// A kind of parameter file.
pub struct FileKind {
    /// Value of the key `format`.
    pub format: &'static str,
    /// Version of the layout that is written; earlier ones are read unless `refused_before` says why not.
    version: u32,
    refused_before: Option<&'static str>,
    naming: Naming,
    /// Keys whose lists may hold nan.
    pub(super) may_lack: &'static [&'static str],
    /// Keys that stand in every file, with nan where their value is not known.
    pub(super) kept: &'static [Kept],
    /// Whether the text of a file of the kind holds what can be.
    pub(super) is_sound: fn(&Path, &str) -> Result<(), Finding>,
    check: fn(&Path) -> Result<(), Finding>,
    rewritten: fn(&Path) -> Result<String, Finding>,
    field: ReadField,
    /// Where its quantities stand for the exports that list them; absent for a kind without such a list.
    pub quantities: Option<&'static Quantities>,
    /// Its part in analyses across temperatures; absent for a kind that takes no part.
    pub point: Option<Point>,
}

impl FileKind {
    const fn of<B: Body>() -> Self {
        Self {
            format: B::FORMAT,
            version: B::VERSION,
            refused_before: B::REFUSED_BEFORE,
            naming: B::NAMING,
            may_lack: B::MAY_LACK,
            kept: B::KEPT,
            // A key that is missing is told where a file of the kind is wanted.
            is_sound: |path, text| toml_edit::de::from_str::<B>(text).map_or(Ok(()), |body| is_consistent(&body, path, text)),
            check: check::<B>,
            rewritten: rewritten::<B>,
            field: field::<B>,
            quantities: B::QUANTITIES,
            point: B::POINT,
        }
    }

    /// The kind with this value of the key `format`.
    #[must_use]
    pub fn of_format(format: &str) -> Option<&'static Self> {
        KINDS.iter().find(|kind| kind.format == format)
    }

    /// The kind whose files are named like this one.
    #[must_use]
    pub fn of_name(path: &Path) -> Option<&'static Self> {
        let name = path.file_name()?.to_string_lossy().to_ascii_uppercase();
        KINDS.iter().find(|kind| match kind.naming {
            Naming::Extension => name.rsplit_once('.').is_some_and(|(_, end)| end == kind.format),
            Naming::Begin(begin) => name.starts_with(begin) && name.ends_with(".TOML"),
            Naming::Free => false,
        })
    }

    /// The kind of a file by its name, or, of TOML of any name, by its key `format`.
    #[must_use]
    pub fn of_file(path: &Path) -> Option<&'static Self> {
        if let Some(kind) = Self::of_name(path) {
            return Some(kind);
        }
        if !path.extension().is_some_and(|end| end.eq_ignore_ascii_case("toml")) {
            return None;
        }
        let text = small_text(path)?;
        let document: toml_edit::DocumentMut = text.parse().ok()?;
        Self::of_format(document.get("format")?.as_str()?)
    }

    /// Whether files of the kind are named like this one.
    #[must_use]
    pub fn names(&self, path: &Path) -> bool {
        Self::of_name(path) == Some(self)
    }

    /// Reads a file as one of this kind.
    ///
    /// # Errors
    /// What is wrong with it: no such file, another format, a hash that does not match, a missing key, an impossible value.
    pub fn check(&self, path: &Path) -> Result<(), Finding> {
        (self.check)(path)
    }

    /// Its part in the way from a reading to the field, in a frame; `None` for a kind that is not applied to readings.
    ///
    /// # Errors
    /// As [`FileKind::check`].
    pub(in crate::files) fn field(&self, path: &Path, frame: Frame) -> Result<(Option<FieldPart>, Input), Finding> {
        (self.field)(path, frame)
    }

    /// The text of a file of this kind as it is written from what was read.
    ///
    /// # Errors
    /// As [`FileKind::check`], or values that have no text form.
    pub fn rewritten(&self, path: &Path) -> Result<String, Finding> {
        (self.rewritten)(path)
    }
}

impl PartialEq for FileKind {
    fn eq(&self, other: &Self) -> bool {
        self.format == other.format
    }
}

impl Eq for FileKind {}

impl fmt::Debug for FileKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.format)
    }
}

/// Whether a version of a format can be read. A format that is not in the table is left to the reader, which knows what it wants.
///
/// # Errors
/// The rule that the version breaks, and what to do.
pub(super) fn readable_version(format: &str, version: u32) -> Result<(), (String, &'static str)> {
    let Some(kind) = FileKind::of_format(format) else { return Ok(()) };
    match kind.refused_before {
        Some(reason) if version < kind.version => {
            Err((format!("is a {format} file of version {version}: {reason}"), "make it again from the files that it names"))
        }
        _ if version == 0 || version > kind.version => {
            Err((format!("holds version {version}, not {}", kind.version), "use the program that wrote it"))
        }
        _ => Ok(()),
    }
}

/// Whether a file is named like those of a kind.
#[must_use]
pub fn is_named<B: Body>(path: &Path) -> bool {
    FileKind::of_name(path).is_some_and(|kind| kind.format == B::FORMAT)
}

/// Parameter files of a folder and of the folders in it, by the names of both.
///
/// # Errors
/// A folder cannot be listed.
pub fn files_of(folder: &Path) -> Result<Vec<PathBuf>, Finding> {
    let mut files = Vec::new();
    collect(folder, 0, &mut files)?;
    Ok(files)
}

fn collect(folder: &Path, depth: usize, files: &mut Vec<PathBuf>) -> Result<(), Finding> {
    let wrong = |e: std::io::Error| Finding::io(folder, "list the folder", &e);
    let entries = std::fs::read_dir(folder).map_err(wrong)?.map(|entry| entry.map(|e| e.path()));
    let mut entries: Vec<PathBuf> = entries.collect::<Result<_, _>>().map_err(wrong)?;
    entries.sort();
    for path in entries {
        if path.is_dir() {
            if depth == 0 {
                collect(&path, depth + 1, files)?;
            }
        } else if FileKind::of_name(&path).is_some() {
            files.push(path);
        }
    }
    Ok(())
}

fn check<B: Body>(path: &Path) -> Result<(), Finding> {
    read::<B>(path).map(drop)
}

fn field<B: Body>(path: &Path, frame: Frame) -> Result<(Option<FieldPart>, Input), Finding> {
    let file = read::<B>(path)?;
    let models: Vec<Input> = file.provenance.input.iter().filter(|input| input.role == Some(Role::Model)).cloned().collect();
    let notes = file.told.with_values_of(&file.input.path);
    Ok((file.body.field(frame).map(|part| FieldPart { models, notes, ..part }), file.input))
}

fn rewritten<B: Body>(path: &Path) -> Result<String, Finding> {
    let file = read::<B>(path)?;
    to_text(&file.body, &file.provenance)
        .map_err(|e| Finding::error(&path.display().to_string(), format!("has no text form: {e}"), "check the file"))
}
