//! Coil, box or housing attenuates alternating fields.

use super::{About, Column, Effect, Family, Record, Spec};

/// Coil, box or housing attenuates alternating fields.
pub struct EddyCurrentAttenuation;

impl Effect for EddyCurrentAttenuation {
    fn id(&self) -> &'static str {
        "eddy_current_attenuation"
    }

    fn about(&self) -> About {
        About {
            summary: "coil, box or sensor housing attenuates AC",
            formula: "response times 1/sqrt(1 + (f/f_c)²)",
            family: Family::Response,
            seen_in: "freq",
            needs: "amplitudes of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "the frequency run without box, and with another sensor",
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
