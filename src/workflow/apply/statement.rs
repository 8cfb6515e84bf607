//! What a file of calibrated vectors says of itself.

use super::{AppliedFile, Work};
use crate::data::note::Note;
use crate::data::provenance::Provenance;
use serde::Serialize;

/// What a file of calibrated vectors says of itself, and its statement beside it.
#[derive(Serialize)]
pub(super) struct Statement<'a> {
    written_by: String,
    format: &'static str,
    sensor: &'a str,
    mode: &'a str,
    frame: &'a str,
    columns: Vec<(&'static str, &'static str)>,
    uncertainty: &'static str,
    not_applied: [&'static str; 2],
    notes: Vec<String>,
    provenance: &'a Provenance,
    #[serde(skip_serializing_if = "Option::is_none")]
    counts: Option<&'a AppliedFile>,
}

/// Columns of a run; those of a table are known to the one who made it.
pub(super) const COLUMNS_OF_RUN: [(&str, &str); 4] = [
    ("n", "counter of the sample, as in the run"),
    (
        "t",
        "time of the sample, s: its counter over the sample rate, joined to the mean of the time tags; the tag itself is rounded",
    ),
    ("x, y, z", "reading, enT"),
    ("t_degc", "temperature of the sensor at this time, degC"),
];
const COLUMNS: [(&str, &str); 3] = [
    ("bx_nt, by_nt, bz_nt", "field, nT, in the frame stated"),
    ("u_bx_nt, u_by_nt, u_bz_nt", "its standard uncertainty, nT"),
    ("flags", "bits: 1 temperature outside, 65536 field outside, 131072 no temperature, 262144 no reading"),
];
const UNCERTAINTY: &str = "standard uncertainty, coverage factor 1, from the covariance of the coefficients; it is common to all vectors and does not fall with averaging; the noise of the readings is not in it; empty for temperatures outside of the calibration, where none is stated; for fields outside it is that of a sensor that stays linear";
const NOT_APPLIED: [&str; 2] = ["group delay", "frequency response"];

impl Work<'_> {
    /// What is said of the vectors; with `counts` once all of them are there.
    pub(super) fn statement<'b>(&'b self, provenance: &'b Provenance, counts: Option<&'b AppliedFile>) -> Statement<'b> {
        Statement {
            written_by: format!("calfit {}", env!("CARGO_PKG_VERSION")),
            format: "APPLIED",
            sensor: &self.applied.sensor,
            mode: &self.applied.mode,
            frame: &self.applied.frame,
            columns: self.of_data.iter().chain(&COLUMNS).copied().collect(),
            uncertainty: UNCERTAINTY,
            not_applied: NOT_APPLIED,
            // Of the readings it has what is known by then: all of it once they are written.
            notes: self.applied.notes.iter().map(Note::to_string).chain(self.counts.notes.iter().cloned()).collect(),
            provenance,
            counts,
        }
    }
}
