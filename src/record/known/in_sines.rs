//! Known effects in the sines of a frequency run: factors of their phasors, and the course of the sampling frequency.

use super::{Known, KnownEffect};
use crate::data::note::{Note, NoteKind};
use crate::data::run::{Run, Setting};
use crate::model::applied::AppliedEffect;
use crate::model::effects::EffectRef;
use crate::model::effects::clock_drift::Clock;
use crate::model::effects::in_sine::InSine;
use nalgebra::Complex;

/// What a model does to the sines of one run.
#[derive(Clone, Debug, Default)]
pub struct InSines {
    /// Each with its variants by the uncertainties of its parameters.
    factors: Vec<(InSine, Vec<InSine>)>,
    clocks: Vec<Clock>,
    names: Vec<AppliedEffect>,
    /// Effects of the model that have no influence, by name.
    pub left_out: Vec<String>,
}

/// Why an effect of a model does not act on the sines of a run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum NotInSines {
    #[error("{0} changes no sines")]
    NoSines(EffectRef),
    #[error("{0}")]
    AnotherRun(String),
    #[error("{0} belongs to the response that is fitted here")]
    Response(EffectRef),
    #[error("{effect} on {} is there twice, and the first one counts", axes.join(", "))]
    Twice { effect: EffectRef, axes: Vec<String> },
    #[error("{effect} needs the temperature {channel}, which the run does not have")]
    NoTemperature { effect: EffectRef, channel: String },
}

/// Whose response is looked at.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Responses {
    /// The instrument is fitted: what belongs to its response stays.
    OfTheInstrument,
    /// All that acts on a sine.
    All,
}

impl InSines {
    /// What of a model acts on the sines of a run. What does not is warned about.
    #[must_use]
    pub fn new(known: &Known, run: &Run, responses: Responses, notes: &mut impl Extend<Note>) -> Self {
        if responses == Responses::OfTheInstrument {
            notes.extend(known.untold());
        }
        let mut found = Self::default();
        for effect in &known.effects {
            if let Err(refusal) = found.add(effect, run, responses) {
                notes.extend([Note::new(NoteKind::Model, format!("not in the sines of run {}: {refusal}", run.header.run))
                    .about(effect.name())]);
                found.left_out.push(effect.name());
            }
        }
        found
    }

    fn add(&mut self, effect: &KnownEffect, run: &Run, responses: Responses) -> Result<(), NotInSines> {
        let (id, form) = (effect.given.effect, effect.given.spec.form.as_str());
        let sine = effect.given.in_sine.as_ref().ok_or(NotInSines::NoSines(id))?;
        if let Some(reason) = effect.given.of_another(&run.header.run).filter(|_| responses == Responses::OfTheInstrument) {
            return Err(NotInSines::AnotherRun(reason));
        }
        if id.is_of_the_response() && responses == Responses::OfTheInstrument {
            return Err(NotInSines::Response(id));
        }
        let axes: Vec<String> = effect.given.spec.axis_names().into_iter().map(str::to_owned).collect();
        if self.names.iter().any(|n| id == n.id.as_str() && n.axes.iter().any(|a| axes.contains(a))) {
            return Err(NotInSines::Twice { effect: id, axes });
        }
        let rate_hz = run.header.sample_rate_hz;
        let size: Box<dyn Fn(&Setting) -> f64> = match sine {
            InSine::Clock(drift) => self.moved(Clock::Polynomial(drift.iter().map(|c| c / rate_hz).collect())),
            InSine::ClockTemperature { channel, hz_per_k } => {
                let series = run.temperatures.channel(channel.as_str()).filter(|s| s.len() > 1);
                let refused = || NotInSines::NoTemperature { effect: id, channel: channel.to_string() };
                let series = series.ok_or_else(refused)?;
                self.moved(Clock::proportional(&series, hz_per_k / rate_hz))
            }
            InSine::Poles { .. } | InSine::Delay(_) => {
                self.factors.push((sine.clone(), effect.sine_variants.clone()));
                Box::new(|s| (0..3).map(|i| (sine.factor(s.frequency_hz, i) - 1.0).norm()).fold(0.0, f64::max))
            }
        };
        let largest_part = run.settings.iter().filter(|s| s.frequency_hz > 0.0).map(size).fold(0.0, f64::max);
        let (id, form) = (id.to_string(), form.to_owned());
        self.names.push(AppliedEffect { id, form, axes, largest_nt: None, largest_part: Some(largest_part) });
        Ok(())
    }

    /// Adds a course of the sampling frequency, and gives its size in a setting.
    fn moved(&mut self, clock: Clock) -> Box<dyn Fn(&Setting) -> f64> {
        self.clocks.push(clock.clone());
        Box::new(move |s| clock.at(0.5 * (s.t_start_s + s.t_end_s)).abs())
    }

    /// Whether nothing acts.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.names.is_empty()
    }

    /// Whether the sampling frequency moves.
    #[must_use]
    pub fn moves_clock(&self) -> bool {
        !self.clocks.is_empty()
    }

    /// What acts, for the parameter file.
    #[must_use]
    pub fn applied(&self) -> Vec<AppliedEffect> {
        self.names.clone()
    }

    /// Factor of the phasor of component i at a frequency.
    #[must_use]
    pub fn factor(&self, frequency_hz: f64, i: usize) -> Complex<f64> {
        self.factors.iter().map(|(sine, _)| sine.factor(frequency_hz, i)).product()
    }

    /// Standard uncertainty of the logarithm of that factor's modulus and of its phase, rad.
    #[must_use]
    pub fn factor_std(&self, frequency_hz: f64, i: usize) -> [f64; 2] {
        let mut squares = [0.0; 2];
        for (sine, variants) in &self.factors {
            for variant in variants {
                let ratio = variant.factor(frequency_hz, i) / sine.factor(frequency_hz, i);
                squares[0] += ratio.norm().ln().powi(2);
                squares[1] += ratio.arg().powi(2);
            }
        }
        squares.map(f64::sqrt)
    }

    /// Relative change of the sampling frequency at a run time.
    #[must_use]
    pub fn clock(&self, t_s: f64) -> f64 {
        self.clocks.iter().map(|c| c.at(t_s)).sum()
    }

    /// Its integral since the begin of the run, s: a counter is ahead by so much.
    #[must_use]
    pub fn lead_s(&self, t_s: f64) -> f64 {
        self.clocks.iter().map(|c| c.lead_s(t_s)).sum()
    }
}
