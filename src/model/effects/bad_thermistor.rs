//! A temperature channel jumps or is offset.

use super::{About, Column, Effect, Family, Record, Spec};

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if record.sensor.is_none() && record.coil.is_none() && record.rack.is_none() {
            return Err("no temperature was recorded".to_owned());
        }
        // It shows in the channels themselves, not in the readings.
        Ok(Vec::new())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
