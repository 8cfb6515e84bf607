//! The response falls steeper than the model.

use super::in_sine::{InSine, Poles};
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
            formula: "phasor times 1 + p (1/(1 - x² + i x/0.65) - 1), x = f/f_c; p = 1: two further poles",
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

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        let mut poles = || InSine::Poles { poles: Poles::Two, on: spec.on(), part: value("part"), corner_hz: value("f_c") };
        (spec.form == "two poles in part").then(&mut poles)
    }
}
