//! The response falls steeper than the model.

use super::in_sine::{
    CORNER, InSine, OWN_QUALITY, PART, PartThroughPoles, Poles, QUALITY, SineRun, SineTerm, TOGETHER_AND_SINGLY, known_part,
};
use super::{About, Acts, Changes, Effect, Family, Spec, Unseen};
use crate::data::run::Kind;
use std::sync::Arc;

/// Its form.
pub const TWO_POLES: &str = "two poles in part";
/// The same where the sines tell the quality of the poles, too.
pub const OF_OWN_QUALITY: &str = "two poles of their own quality in part";

/// The response falls steeper than the model.
pub struct ResponseOrder;

impl Effect for ResponseOrder {
    fn id(&self) -> &'static str {
        "response_order"
    }

    fn about(&self) -> About {
        About {
            summary: "response falls steeper than the model",
            formula: "phasor times 1 + p (1/(1 - x² + i x/Q) - 1), x = f/f_c, Q = 0.65 where the sines do not tell it; p = 1: two further poles",
            family: Family::Response,
            seen_in: "freq",
            needs: "amplitudes of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "more frequencies above the corner",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Sines]
    }

    fn changes(&self) -> Changes {
        Changes::Response
    }

    fn is_of_the_response(&self) -> bool {
        true
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind != Kind::Frequency).then_some(Unseen::NeedsSines)
    }

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        if ![TWO_POLES, OF_OWN_QUALITY].contains(&spec.form.as_str()) {
            return None;
        }
        let [part, corner_hz] = [PART, CORNER].map(&mut *value);
        let quality = if spec.form == TWO_POLES { QUALITY } else { value(OWN_QUALITY) };
        Some(InSine::Poles { poles: Poles::Two { quality }, on: spec.on(), part, corner_hz })
    }

    fn sine_terms(&self, _run: &SineRun, corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        TOGETHER_AND_SINGLY.map(|on| two_poles(on, corner_hz)).into()
    }

    fn known_sine_term(&self, known: &InSine, _run: &SineRun) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        known_part(known, TWO_POLES, Some(OF_OWN_QUALITY))
    }
}

/// A part of the field passes two poles on some axes. They are no lower than the corner of the response: what ends below it makes no response
/// fall steeper.
#[must_use]
pub fn two_poles(on: [bool; 3], corner_hz: f64) -> Arc<dyn SineTerm> {
    let poles = Poles::Two { quality: QUALITY };
    Arc::new(PartThroughPoles { poles, on, lowest_hz: corner_hz, form: TWO_POLES, freed_form: Some(OF_OWN_QUALITY) })
}
