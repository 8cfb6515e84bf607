//! How effects that act inside the plateaus are looked for in the samples.

use super::Spec;
use super::record::Step;

/// How an effect is looked for inside the plateaus.
#[derive(Clone, Copy)]
pub enum InSamples {
    /// The edges of the plateaus stand beside those of the settings.
    Edges,
    /// A transient follows every step of the field.
    Transient(Transient),
    /// A line of the spectrum.
    Line(Line),
    /// A comb of lines of one period.
    Comb(Comb),
}

impl InSamples {
    /// Whether the record has to tell the steps of the field.
    #[must_use]
    pub fn follows_steps(self) -> bool {
        matches!(self, InSamples::Edges | InSamples::Transient(_))
    }

    /// Whether it comes again with a period.
    #[must_use]
    pub fn is_periodic(self) -> bool {
        matches!(self, InSamples::Line(_) | InSamples::Comb(_))
    }
}

/// A transient with one time constant, in proportion to the step.
#[derive(Clone, Copy)]
pub struct Transient {
    /// Time constants that are tried, s.
    pub taus_s: &'static [f64],
    /// The name of the time constant among the shape parameters.
    pub time_constant: &'static str,
    /// The term on some axes with a time constant, s.
    pub term: fn(axes: &[usize], tau_s: f64) -> Spec,
    /// Mean of equidistant samples between two times that stand `dt_s` apart, no step between them, per unit of the parameter without its
    /// sign, enT: steps, first and last time, `dt_s` and time constant, s.
    pub mean: fn(steps: &[Step], ends_s: [f64; 2], dt_s: f64, tau_s: f64) -> [f64; 3],
}

/// A sine of a frequency, with a sine and a cosine part per axis.
#[derive(Clone, Copy)]
pub struct Line {
    /// The name of the frequency among the shape parameters.
    pub frequency: &'static str,
    /// The term on some axes with a frequency, Hz.
    pub term: fn(axes: &[usize], frequency_hz: f64) -> Spec,
    /// Means of sine and cosine of a frequency, Hz, over a time, s.
    pub wave: fn(frequency_hz: f64, used_s: [f64; 2]) -> (f64, f64),
}

/// Sine and cosine part of a harmonic of a wave, by its order, duty and delay.
pub type Harmonic = fn(order: usize, duty: f64, delay: f64) -> (f64, f64);

/// A wave of one shape with a duty and a delay, both as parts of its period.
#[derive(Clone, Copy)]
pub struct Comb {
    /// The name of the period among the shape parameters.
    pub period: &'static str,
    /// The term on some axes with period, s, duty, and delay, s.
    pub term: fn(axes: &[usize], period_s: f64, duty: f64, delay_s: f64) -> Spec,
    /// Sine and cosine part of a harmonic for an amplitude of one, by duty and delay.
    pub harmonic: Harmonic,
}
