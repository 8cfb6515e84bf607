//! Tables of any laboratory: the mapping that says what their columns mean, and the tables as columns of text, numbers or moments.

mod csv;
mod guess;
pub mod mapping;
mod table;
pub mod time;

pub use csv::{Dialect, Separator};
pub use guess::guess;
pub use mapping::Mapping;
pub use table::{Cells, ForeignTable};
pub use time::{TimeFormat, Times, Zone};

use std::path::Path;

/// The formats of tables.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// Text with a separator between the cells.
    Csv,
    /// Apache Parquet.
    Parquet,
    /// Apache Arrow IPC, also called Feather version 2.
    Ipc,
}

impl Format {
    /// The format of a file by the end of its name.
    #[must_use]
    pub fn of_name(path: &Path) -> Option<Self> {
        match path.extension()?.to_string_lossy().to_ascii_lowercase().as_str() {
            "csv" => Some(Format::Csv),
            "parquet" | "pq" => Some(Format::Parquet),
            "arrow" | "feather" | "ipc" => Some(Format::Ipc),
            _ => None,
        }
    }

    /// Whether a path is named as a file of this format.
    #[must_use]
    pub fn is_of(self, path: &Path) -> bool {
        Self::of_name(path) == Some(self)
    }

    /// The binary format that a file begins with, whatever its name.
    #[must_use]
    pub fn of_begin(bytes: &[u8]) -> Option<Self> {
        match bytes {
            [b'P', b'A', b'R', b'1', ..] => Some(Format::Parquet),
            [b'A', b'R', b'R', b'O', b'W', b'1', ..] => Some(Format::Ipc),
            _ => None,
        }
    }

    /// Its name in a mapping.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Format::Csv => "csv",
            Format::Parquet => "parquet",
            Format::Ipc => "ipc",
        }
    }

    /// The format of this name.
    #[must_use]
    pub fn from_name(name: &str) -> Option<Self> {
        [Format::Csv, Format::Parquet, Format::Ipc].into_iter().find(|f| f.name() == name)
    }
}

/// What a file is that was given where a run file is wanted, by its name and its first bytes: absent if nothing tells.
#[must_use]
pub fn foreign_kind(name: &str, begin: &[u8]) -> Option<&'static str> {
    if begin.starts_with(b"PK\x03\x04") {
        return Some("a compressed archive, as spreadsheets are, which are to be saved as CSV first,");
    }
    let by_begin = match Format::of_begin(begin) {
        Some(Format::Parquet) => Some("a Parquet table"),
        Some(Format::Ipc) => Some("an Arrow table"),
        _ => None,
    };
    let ending = Path::new(name).extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    by_begin.or(match ending.as_deref() {
        Some("csv") => Some("a CSV table"),
        Some("tsv" | "txt" | "dat") => Some("a table of text"),
        Some("parquet" | "pq") => Some("a Parquet table"),
        Some("arrow" | "feather" | "ipc") => Some("an Arrow table"),
        Some("xlsx" | "xls" | "ods") => Some("a spreadsheet, which is to be saved as CSV first,"),
        _ => None,
    })
}
