//! Known effects in the sines of a frequency run: factors of their phasors, and the course of the sampling frequency.

use super::{Known, KnownEffect};
use crate::data::run::{Run, Setting, interpolate};
use crate::model::applied::AppliedEffect;
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

/// Relative change of the sampling frequency.
#[derive(Clone, Debug)]
pub enum Clock {
    /// `Σ c_k t^k`, from k = 1.
    Polynomial(Vec<f64>),
    /// In proportion to a temperature: times in s, relative changes there, and their integrals until there, s.
    Series(Vec<(f64, f64)>, Vec<(f64, f64)>),
}

impl Clock {
    /// In proportion to the deviation of a temperature from the mean of its readings, (time, value) of at least one.
    pub fn proportional(series: &[(f64, f64)], per_k: f64) -> Self {
        let mean = series.iter().map(|s| s.1).sum::<f64>() / series.len() as f64;
        let values: Vec<(f64, f64)> = series.iter().map(|(t, v)| (*t, per_k * (v - mean))).collect();
        // The integral counts from 0, which may lie before the first reading.
        let mut integrals = vec![(0.0, 0.0)];
        for (t, v) in values.iter().filter(|(t, _)| *t > 0.0) {
            let (before_s, sum) = integrals[integrals.len() - 1];
            integrals.push((*t, sum + (t - before_s) * 0.5 * (interpolate(&values, before_s) + v)));
        }
        Clock::Series(values, integrals)
    }

    /// At a run time.
    pub fn at(&self, t_s: f64) -> f64 {
        match self {
            Clock::Polynomial(c) => c.iter().rev().fold(0.0, |sum, c| (sum + c) * t_s),
            Clock::Series(values, _) => interpolate(values, t_s),
        }
    }

    /// Integral from 0, s.
    pub fn lead_s(&self, t_s: f64) -> f64 {
        match self {
            Clock::Polynomial(c) => c.iter().enumerate().map(|(k, c)| c * t_s.powi(k as i32 + 2) / (k as f64 + 2.0)).sum(),
            Clock::Series(values, integrals) => {
                let last = integrals.partition_point(|(t, _)| *t <= t_s).saturating_sub(1);
                let (begin_s, sum) = integrals.get(last).copied().unwrap_or_default();
                // Straight between the readings.
                sum + (t_s - begin_s) * 0.5 * (interpolate(values, begin_s) + interpolate(values, t_s))
            }
        }
    }
}

/// Why an effect of a model does not act on the sines of a run.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
enum NotInSines {
    #[error("{0} changes no sines")]
    NoSines(String),
    #[error("{0}")]
    AnotherRun(String),
    #[error("{0} belongs to the response that is fitted here")]
    Response(String),
    #[error("{effect} on {} is there twice, and the first one counts", axes.join(", "))]
    Twice { effect: String, axes: Vec<String> },
    #[error("{effect} needs the temperature {channel}, which the run does not have")]
    NoTemperature { effect: String, channel: String },
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
    pub fn new(known: &Known, run: &Run, responses: Responses, warnings: &mut Vec<String>) -> Self {
        let mut found = Self::default();
        for effect in &known.effects {
            if let Err(refusal) = found.add(effect, run, responses) {
                warnings.push(format!("MODEL: not in the sines of run {}: {refusal}", run.header.run));
                found.left_out.push(effect.name());
            }
        }
        found
    }

    fn add(&mut self, effect: &KnownEffect, run: &Run, responses: Responses) -> Result<(), NotInSines> {
        let (id, form) = (effect.given.id, effect.given.spec.form.as_str());
        let sine = effect.given.in_sine.as_ref().ok_or_else(|| NotInSines::NoSines(id.to_owned()))?;
        if let Some(reason) = effect.given.of_another(&run.header.run).filter(|_| responses == Responses::OfTheInstrument) {
            return Err(NotInSines::AnotherRun(reason));
        }
        if id == "response_order" && responses == Responses::OfTheInstrument {
            return Err(NotInSines::Response(id.to_owned()));
        }
        let axes: Vec<String> = effect.given.spec.axis_names().into_iter().map(str::to_owned).collect();
        if self.names.iter().any(|n| n.id == id && n.axes.iter().any(|a| axes.contains(a))) {
            return Err(NotInSines::Twice { effect: id.to_owned(), axes });
        }
        let rate_hz = run.header.sample_rate_hz;
        let size: Box<dyn Fn(&Setting) -> f64> = match sine {
            InSine::Clock(drift) => self.moved(Clock::Polynomial(drift.iter().map(|c| c / rate_hz).collect())),
            InSine::ClockTemperature { channel, hz_per_k } => {
                let series = run.temperatures.channel(channel.as_str()).filter(|s| s.len() > 1);
                let refused = || NotInSines::NoTemperature { effect: id.to_owned(), channel: channel.to_string() };
                let series = series.ok_or_else(refused)?;
                self.moved(Clock::proportional(&series, hz_per_k / rate_hz))
            }
            InSine::Poles { .. } | InSine::Delay(_) => {
                self.factors.push((sine.clone(), effect.sine_variants.clone()));
                Box::new(|s| (0..3).map(|i| (sine.factor(s.frequency_hz, i) - 1.0).norm()).fold(0.0, f64::max))
            }
        };
        let largest_part = run.settings.iter().filter(|s| s.frequency_hz > 0.0).map(size).fold(0.0, f64::max);
        let (id, form) = (id.to_owned(), form.to_owned());
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_integral_of_a_polynomial_is_its_closed_form() {
        let clock = Clock::Polynomial(vec![2e-9, -3e-13]);
        let t: f64 = 1234.5;
        assert!((clock.at(t) - (2e-9 * t - 3e-13 * t * t)).abs() < 1e-18);
        assert!((clock.lead_s(t) - (1e-9 * t * t - 1e-13 * t.powi(3))).abs() < 1e-15);
    }

    #[test]
    fn the_integral_of_a_temperature_that_rises_steadily_is_a_parabola() {
        // T - T_mean = 0.01 (t - 1000) K, known from 100 s on, 2e-8 per K.
        let series: Vec<(f64, f64)> = (0..=18).map(|i| 100.0 + 100.0 * f64::from(i)).map(|t| (t, 20.0 + 0.01 * t)).collect();
        let clock = Clock::proportional(&series, 2e-8);
        assert!((clock.at(1450.0) - 2e-8 * 4.5).abs() < 1e-16);
        let lead = |t: f64| 2e-10 * (0.5 * t * t - 1000.0 * t);
        // Before the first reading the first one holds: 100 s at -9 K instead of -9 to -10 K.
        let begin = -9.0 * 2e-8 * 100.0;
        for t in [100.0, 512.0, 1900.0] {
            assert!((clock.lead_s(t) - (begin + lead(t) - lead(100.0))).abs() < 1e-14, "{t}");
        }
    }
}
