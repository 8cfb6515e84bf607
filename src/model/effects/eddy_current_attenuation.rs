//! Coil, box or housing attenuates alternating fields.

use super::in_sine::{InSine, Poles};
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
            formula: "phasor times 1 + p (1/(1 + i f/f_c) - 1); p = 1: a further pole",
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

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        let mut poles = || InSine::Poles { poles: Poles::One, on: spec.on(), part: value("part"), corner_hz: value("f_c") };
        (spec.form == "pole in part").then(&mut poles)
    }
}
