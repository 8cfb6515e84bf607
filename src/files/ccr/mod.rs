//! CCR: a run. A magic line, TOML keys, sections of CSV rows, `@END`.

mod header;
mod layout;
mod parse;
mod vectors;
mod write;

pub use header::run_id_is_safe;
pub use parse::{Options, peek, read};
pub use write::{Decimals, Writer};

/// The sections of a run file that are understood.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Section {
    /// Settings.
    Fields,
    /// Samples.
    Vectors,
    /// Temperatures, °C.
    Temperatures,
    /// Other slow channels.
    Channels,
    /// Plateau means, in place of settings and samples.
    Blocks,
    /// Scalar calibration rows.
    Scalar,
}

impl Section {
    /// All sections.
    pub const ALL: [Section; 6] =
        [Section::Fields, Section::Vectors, Section::Temperatures, Section::Channels, Section::Blocks, Section::Scalar];

    /// The name line.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Section::Fields => "@FIELDS",
            Section::Vectors => "@VECTORS",
            Section::Temperatures => "@TEMPERATURES",
            Section::Channels => "@CHANNELS",
            Section::Blocks => "@BLOCKS",
            Section::Scalar => "@SCALAR",
        }
    }

    /// Its columns, the required ones first, and how many of them are required.
    #[must_use]
    pub fn columns(self) -> (&'static [&'static str], usize) {
        match self {
            Section::Fields => (&["t_start", "t_end", "bx", "by", "bz", "frequency", "position"], 7),
            Section::Vectors => (&["n", "t", "x", "y", "z"], 5),
            Section::Temperatures | Section::Channels => (&["t"], 1),
            Section::Blocks => (&["t_start", "t_end", "bx", "by", "bz", "position", "x", "y", "z", "sx", "sy", "sz", "count"], 9),
            Section::Scalar => (&["t", "bx", "by", "bz", "f"], 5),
        }
    }
}
