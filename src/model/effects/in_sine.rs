//! What effects of the response and of the clock do to sines, and the terms with which they are looked for.

use super::Spec;
use crate::data::run::SlowTable;
use nalgebra::Complex;
use std::f64::consts::TAU;
use std::fmt::Debug;
use std::sync::Arc;

/// Quality of the two poles of a response that falls steeper: between those of Bessel and Butterworth.
const QUALITY: f64 = 0.65;
/// Poles that are tried, Hz: the first, their ratio, and their number.
const FIRST_POLE_HZ: f64 = 3.0;
const POLE_RATIO: f64 = 1.6;
const POLES: i32 = 16;
/// Poles are looked for between these frequencies, Hz.
pub const POLES_HZ: [f64; 2] = [0.5, 2e4];
/// All axes together, then every axis by itself.
pub const TOGETHER_AND_SINGLY: [[bool; 3]; 4] = [[true; 3], [true, false, false], [false, true, false], [false, false, true]];
/// Parameter of a part of the field that passes poles: the part.
pub const PART: &str = "part";
/// Parameter of the same: the frequency of the poles, Hz.
pub const CORNER: &str = "f_c";
/// The parameter that tells how the two others of an effect go together.
pub const CORRELATION: &str = "correlation";

/// A prediction or a measurement of the sine of one component: logarithm of the amplitude, phase in rad, its slope in rad/s.
pub type Triple = [f64; 3];

/// The sine of one setting.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SineSetting {
    /// Frequency of the field, Hz.
    pub frequency_hz: f64,
    /// Middle of its samples, s since the run's start.
    pub middle_s: f64,
}

/// What effects read of a run with sines.
#[derive(Clone, Debug)]
pub struct SineRun {
    /// The settings in the order of the run.
    pub settings: Vec<SineSetting>,
    /// Sampling frequency to which phases refer, Hz.
    pub rate_hz: f64,
    /// Length of the run, s.
    pub length_s: f64,
    /// Phases of the field are those of a sine that begins with its setting; otherwise every setting has one of its own.
    pub begins_known: bool,
    /// Time tags are rounded, so that a shift of all samples against the settings is a parameter of the fit.
    pub tags_are_rounded: bool,
    /// Temperatures of the run.
    pub temperatures: SlowTable,
}

/// A term that is tried in the sines of a run.
pub trait SineTerm: Debug + Send + Sync {
    /// The form without what differs between terms of one kind, as the degree of a polynomial: of one kind one is looked for.
    fn kind(&self) -> &'static str;

    /// The form.
    fn form(&self) -> String;

    /// Number of parameters. Of a term with poles the second one is the logarithm of their frequency in Hz, of all others they are linear.
    fn count(&self) -> usize {
        1
    }

    /// Axes on which it acts.
    fn axes(&self) -> Vec<usize> {
        vec![0, 1, 2]
    }

    /// What it adds to the sine of component `i` in setting `j`; `p` begins with its parameters.
    fn add(&self, p: &[f64], run: &SineRun, j: usize, i: usize, to: &mut Triple);

    /// Between which frequencies its poles are looked for, Hz; `None` without poles.
    fn pole_range_hz(&self) -> Option<[f64; 2]> {
        None
    }

    /// Frequencies of poles that are tried, Hz.
    fn poles_hz(&self) -> Vec<f64> {
        Vec::new()
    }

    /// Whether it changes the times of the samples and not the response.
    fn is_of_timing(&self) -> bool {
        true
    }

    /// Whether a detection limit is told for it: for one form of an effect.
    fn has_limit(&self) -> bool {
        true
    }

    /// Whether these parameters are more than what every response has of it.
    fn is_reported(&self, p: &[f64], run: &SineRun) -> bool {
        let _ = (p, run);
        true
    }

    /// Form and parameters for people and files; `std` and `correlation` are those of the parameters by their numbers.
    fn report(
        &self,
        run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>);

    /// The first parameter in words, for a detection limit; `hz` is the pole.
    fn limit(&self, run: &SineRun, least: f64, hz: f64) -> String;
}

/// A parameter of a term as it is reported.
#[derive(Clone, Debug, PartialEq)]
pub struct SineParameter {
    /// Name.
    pub name: String,
    /// Value.
    pub value: f64,
    /// Standard uncertainty.
    pub std: Option<f64>,
    /// Unit.
    pub unit: String,
}

impl SineParameter {
    /// A parameter.
    #[must_use]
    pub fn new(name: &str, value: f64, std: Option<f64>, unit: &str) -> Self {
        Self { name: name.to_owned(), value, std, unit: unit.to_owned() }
    }
}

/// A part of the field passes poles: `1 + p (P(f/f_c) - 1)`; with p = 1 further poles. Parameters p and ln f_c.
#[derive(Clone, Debug)]
pub struct PartThroughPoles {
    /// How many.
    pub poles: Poles,
    /// Axes.
    pub on: [bool; 3],
    /// Lowest frequency of the poles, Hz.
    pub lowest_hz: f64,
    /// Form.
    pub form: &'static str,
}

impl SineTerm for PartThroughPoles {
    fn kind(&self) -> &'static str {
        self.form
    }

    fn form(&self) -> String {
        self.form.to_owned()
    }

    fn count(&self) -> usize {
        2
    }

    fn axes(&self) -> Vec<usize> {
        (0..3).filter(|i| self.on[*i]).collect()
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, i: usize, to: &mut Triple) {
        if !self.on[i] {
            return;
        }
        let factor = passed(self.poles, p[0], run.settings[j].frequency_hz / p[1].exp());
        to[0] += factor.norm().max(f64::MIN_POSITIVE).ln();
        to[1] += factor.arg();
    }

    fn pole_range_hz(&self) -> Option<[f64; 2]> {
        Some([self.lowest_hz, POLES_HZ[1]])
    }

    fn poles_hz(&self) -> Vec<f64> {
        (0..POLES).map(|k| FIRST_POLE_HZ * POLE_RATIO.powi(k)).filter(|hz| *hz >= self.lowest_hz).collect()
    }

    fn is_of_timing(&self) -> bool {
        false
    }

    fn report(
        &self,
        _run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        let hz = p[1].exp();
        let parameters = vec![
            SineParameter::new(PART, p[0], std(0), "1"),
            SineParameter::new(CORNER, hz, std(1).map(|s| s * hz), "Hz"),
            SineParameter::new(CORRELATION, correlation(0, 1).unwrap_or(0.0), None, "1"),
        ];
        (Spec::new(self.form, &self.axes()).with(CORNER, hz, "Hz"), parameters)
    }

    fn limit(&self, _run: &SineRun, least: f64, hz: f64) -> String {
        format!("part = {} at f_c = {hz:.0} Hz", crate::data::units::three_digits(least))
    }
}

/// A known part through poles as a term that is fitted again, with its parameters.
#[must_use]
pub fn known_part(known: &InSine, form: &'static str) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
    let InSine::Poles { poles, on, part, corner_hz } = known else { return None };
    let term = PartThroughPoles { poles: *poles, on: *on, lowest_hz: POLES_HZ[0], form };
    Some((Arc::new(term), vec![*part, corner_hz.ln()]))
}

/// What an effect does to the sine of a setting.
#[derive(Clone, Debug, PartialEq)]
pub enum InSine {
    /// A part of the field passes one pole, or two, of this frequency; see [`passed`].
    Poles {
        /// How many.
        poles: Poles,
        /// Sensor axes on which it acts.
        on: [bool; 3],
        /// The part.
        part: f64,
        /// Frequency, Hz.
        corner_hz: f64,
    },
    /// The sampling frequency is `f_s + Σ c_k t^k`, t the run time in s; c_1.. in Hz/s^k.
    Clock(Vec<f64>),
    /// The sampling frequency is `f_s + c (T - T_mean)` with the temperatures of a channel and their mean in the run.
    ClockTemperature {
        /// Name of the channel.
        channel: String,
        /// Hz/K.
        hz_per_k: f64,
    },
    /// The readings are late by this time, s.
    Delay(f64),
}

/// Poles of an attenuation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Poles {
    /// `1 / (1 + i x)`.
    One,
    /// `1 / (1 - x² + i x / Q)`.
    Two,
}

/// What is left of a phasor of unit size if a part of the field passes poles; x is the frequency over that of the poles:
/// `1 + part (P(x) - 1)`. With part 1 a further pole, or two.
#[must_use]
pub fn passed(poles: Poles, part: f64, x: f64) -> Complex<f64> {
    let through = match poles {
        Poles::One => Complex::new(1.0, x).inv(),
        Poles::Two => Complex::new(1.0 - x * x, x / QUALITY).inv(),
    };
    Complex::from(1.0) + (through - 1.0) * part
}

impl InSine {
    /// The factor of the phasor of component i at a frequency.
    #[must_use]
    pub fn factor(&self, frequency_hz: f64, i: usize) -> Complex<f64> {
        match self {
            InSine::Poles { poles, on, part, corner_hz } if on[i] => passed(*poles, *part, frequency_hz / corner_hz),
            InSine::Delay(late_s) => Complex::from_polar(1.0, -TAU * frequency_hz * late_s),
            _ => Complex::from(1.0),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pole_halves_the_power_at_its_frequency_and_turns_by_45_degrees() {
        let one = InSine::Poles { poles: Poles::One, on: [true, false, true], part: 1.0, corner_hz: 40.0 };
        let at = one.factor(40.0, 0);
        assert!((at.norm_sqr() - 0.5).abs() < 1e-14 && (at.arg() + TAU / 8.0).abs() < 1e-14, "{at}");
        assert_eq!(one.factor(40.0, 1), Complex::from(1.0));
        // Half of the field beside it: 1 - 0.5 + 0.5 (0.5 - 0.5 i).
        let half = passed(Poles::One, 0.5, 1.0);
        assert!((half - Complex::new(0.75, -0.25)).norm() < 1e-15, "{half}");
    }

    #[test]
    fn two_poles_turn_by_90_degrees_at_their_frequency_and_fall_with_the_square() {
        let at = passed(Poles::Two, 1.0, 1.0);
        assert!((at - Complex::new(0.0, -QUALITY)).norm() < 1e-15, "{at}");
        assert!((passed(Poles::Two, 1.0, 1e3).norm() * 1e6 - 1.0).abs() < 1e-5);
    }

    #[test]
    fn a_delay_turns_back() {
        let factor = InSine::Delay(2.5e-3).factor(100.0, 2);
        assert!((factor - Complex::new(0.0, -1.0)).norm() < 1e-12, "{factor}");
    }
}
