//! A temperature channel jumps or is offset.

use super::{About, Acts, Effect, Family, Record, Spec, Unseen};
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
