//! A temperature channel jumps or is offset.

use super::offset_step::part_after;
use super::{About, Acts, Column, Effect, Family, Record, Spec, Unseen};
use crate::data::run::Kind;

/// The form of it that a diagnosis finds.
pub const JUMP: &str = "jump";
/// Shape: when the channel jumps for the first time.
pub const JUMP_TIME: &str = "time";

/// A temperature channel jumps or is offset.
pub struct BadThermistor;

impl Effect for BadThermistor {
    fn id(&self) -> &'static str {
        "bad_thermistor"
    }

    fn about(&self) -> About {
        About {
            summary: "a temperature channel jumps or is offset",
            formula: "channel disagrees with its neighbours",
            family: Family::DataFault,
            seen_in: "all",
            needs: "temperature channels",
            source: "CH-GFZ-TR-2601 section 8",
            best_measurement: "a second thermistor at the same place",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        // It shows in the temperature channels and not in the readings.
        &[]
    }

    fn unseen_by(&self, _kind: Kind) -> Option<Unseen> {
        None
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if record.sensor.is_none() && record.coil.is_none() && record.rack.is_none() {
            return Err(Unseen::NotRecorded("temperature"));
        }
        Ok(Vec::new())
    }
}

/// What a jump of the thermistor by one kelvin at a time, s, leaves in the readings of a sweep, whose model is a polynomial of what it reads; `None` where
/// the model is none.
#[must_use]
pub fn jump(record: &Record, onset_s: f64) -> Option<Column> {
    let thermal = record.thermal.as_ref()?;
    let jump = |row: usize, field_nt: [f64; 3], used_s: [f64; 2]| {
        thermal.slope(row, field_nt).map(|slope| -slope * part_after(onset_s, used_s))
    };
    Some(Column::of(JUMP, "K", record, |i, row| jump(i, row.field_coil_nt, row.used_s)))
}
