//! Coil, box or housing attenuates alternating fields.

use super::in_sine::{
    CORNER, InSine, PART, POLES_HZ, PartThroughPoles, Poles, SineRun, SineTerm, TOGETHER_AND_SINGLY, known_part,
};
use super::{About, Acts, Changes, Effect, Family, Spec, Unseen};
use crate::data::run::Kind;
use std::sync::Arc;

/// Its form.
pub const ONE_POLE: &str = "pole in part";

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Sines]
    }

    fn changes(&self) -> Changes {
        Changes::Response
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind != Kind::Frequency).then_some(Unseen::NeedsSines)
    }

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        let mut poles = || InSine::Poles { poles: Poles::One, on: spec.on(), part: value(PART), corner_hz: value(CORNER) };
        (spec.form == ONE_POLE).then(&mut poles)
    }

    fn sine_terms(&self, _run: &SineRun, _corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        TOGETHER_AND_SINGLY.map(one_pole).into()
    }

    fn known_sine_term(&self, known: &InSine, _run: &SineRun) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        known_part(known, ONE_POLE, None)
    }
}

/// A part of the field passes one pole on some axes.
#[must_use]
pub fn one_pole(on: [bool; 3]) -> Arc<dyn SineTerm> {
    Arc::new(PartThroughPoles { poles: Poles::One, on, lowest_hz: POLES_HZ[0], form: ONE_POLE, freed_form: None })
}
