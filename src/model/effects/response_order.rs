//! The response falls steeper than the model.

use super::{About, Column, Effect, Family, Record, Spec};

/// The response falls steeper than the model.
pub struct ResponseOrder;

impl Effect for ResponseOrder {
    fn id(&self) -> &'static str {
        "response_order"
    }

    fn about(&self) -> About {
        About {
            summary: "response falls steeper than the model",
            formula: "a response model of higher order",
            family: Family::Response,
            seen_in: "freq",
            needs: "amplitudes of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "more frequencies above the corner",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("needs a frequency run".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }
}
