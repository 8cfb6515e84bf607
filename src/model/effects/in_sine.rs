//! What effects of the response and of the clock do to sines, and the terms with which they are looked for.

use super::Spec;
use crate::data::run::SlowTable;
use nalgebra::Complex;
use std::f64::consts::TAU;
use std::fmt::Debug;
use std::sync::Arc;

/// Quality of the two poles of a response that falls steeper, where the sines do not tell it: between those of Bessel and Butterworth.
pub const QUALITY: f64 = 0.65;
/// Where they do it is looked for in this range: below a half the poles are two single ones, of which the lower one alone is another effect; above, they
/// make a resonance.
const QUALITIES: [f64; 2] = [0.5, 2.0];
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
/// Parameter of two poles whose quality is known from the sines: the quality.
pub const OWN_QUALITY: &str = "quality";
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

    /// Number of parameters. Of a term with poles the second one is the logarithm of their frequency in Hz, a third one that of their quality; of all
    /// others they are linear.
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

    /// Between which values the quality of its poles is looked for; `None` where it is taken for given.
    fn quality_range(&self) -> Option<[f64; 2]> {
        None
    }

    /// The same term with what it takes for given as a parameter, and all parameters, those of it in `p`; `None` where nothing is given.
    fn freed(&self, p: &[f64]) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        let _ = p;
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

/// A part of the field passes poles: `1 + p (P(f/f_c) - 1)`; with p = 1 further poles. Parameters p, ln f_c, and ln Q where the quality is free.
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
    /// The form of two poles with a quality of their own; `None` where it is this form, or there is one pole.
    pub freed_form: Option<&'static str>,
}

impl PartThroughPoles {
    fn has_own_quality(&self) -> bool {
        matches!(self.poles, Poles::Two { .. }) && self.freed_form.is_none()
    }
}

impl SineTerm for PartThroughPoles {
    fn kind(&self) -> &'static str {
        match self.poles {
            Poles::One => "one pole",
            Poles::Two { .. } => "two poles",
        }
    }

    fn form(&self) -> String {
        self.form.to_owned()
    }

    fn count(&self) -> usize {
        2 + usize::from(self.has_own_quality())
    }

    fn axes(&self) -> Vec<usize> {
        (0..3).filter(|i| self.on[*i]).collect()
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, i: usize, to: &mut Triple) {
        if !self.on[i] {
            return;
        }
        let poles = if self.has_own_quality() { Poles::Two { quality: p[2].exp() } } else { self.poles };
        let factor = passed(poles, p[0], run.settings[j].frequency_hz / p[1].exp());
        to[0] += factor.norm().max(f64::MIN_POSITIVE).ln();
        to[1] += factor.arg();
    }

    fn pole_range_hz(&self) -> Option<[f64; 2]> {
        Some([self.lowest_hz, POLES_HZ[1]])
    }

    fn quality_range(&self) -> Option<[f64; 2]> {
        self.has_own_quality().then_some(QUALITIES)
    }

    fn freed(&self, p: &[f64]) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        let Poles::Two { quality } = self.poles else { return None };
        let term = PartThroughPoles { form: self.freed_form?, freed_form: None, ..self.clone() };
        Some((Arc::new(term), vec![p[0], p[1], quality.ln()]))
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
        let mut parameters =
            vec![SineParameter::new(PART, p[0], std(0), "1"), SineParameter::new(CORNER, hz, std(1).map(|s| s * hz), "Hz")];
        let mut spec = Spec::new(self.form, &self.axes()).with(CORNER, hz, "Hz");
        if self.has_own_quality() {
            let quality = p[2].exp();
            parameters.push(SineParameter::new(OWN_QUALITY, quality, std(2).map(|s| s * quality), "1"));
            spec = spec.with(OWN_QUALITY, quality, "1");
        } else {
            parameters.push(SineParameter::new(CORRELATION, correlation(0, 1).unwrap_or(0.0), None, "1"));
        }
        (spec, parameters)
    }

    fn limit(&self, _run: &SineRun, least: f64, hz: f64) -> String {
        format!("part = {} at f_c = {hz:.0} Hz", crate::data::units::three_digits(least))
    }
}

/// A known part through poles as a term that is fitted again, with its parameters: of one form, or of another one with a quality of its own.
#[must_use]
pub fn known_part(known: &InSine, form: &'static str, freed_form: Option<&'static str>) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
    let InSine::Poles { poles, on, part, corner_hz } = known else { return None };
    let term = PartThroughPoles { poles: *poles, on: *on, lowest_hz: POLES_HZ[0], form, freed_form };
    let p = vec![*part, corner_hz.ln()];
    match poles {
        Poles::Two { quality } if *quality != QUALITY => term.freed(&p),
        _ => Some((Arc::new(term), p)),
    }
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
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Poles {
    /// `1 / (1 + i x)`.
    One,
    /// `1 / (1 - x² + i x / Q)`.
    Two {
        /// Q.
        quality: f64,
    },
}

/// What is left of a phasor of unit size if a part of the field passes poles; x is the frequency over that of the poles:
/// `1 + part (P(x) - 1)`. With part 1 a further pole, or two.
#[must_use]
pub fn passed(poles: Poles, part: f64, x: f64) -> Complex<f64> {
    let through = match poles {
        Poles::One => Complex::new(1.0, x).inv(),
        Poles::Two { quality } => Complex::new(1.0 - x * x, x / quality).inv(),
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
        let two = Poles::Two { quality: 0.8 };
        let at = passed(two, 1.0, 1.0);
        assert!((at - Complex::new(0.0, -0.8)).norm() < 1e-15, "{at}");
        assert!((passed(two, 1.0, 1e3).norm() * 1e6 - 1.0).abs() < 1e-5);
    }

    /// With the quality that is taken for given the freed term is the same, and with another one it is the formula with that.
    #[test]
    fn a_freed_term_has_its_quality_as_a_parameter() {
        let poles = Poles::Two { quality: QUALITY };
        let term = PartThroughPoles { poles, on: [true; 3], lowest_hz: 10.0, form: "given", freed_form: Some("free") };
        let p = [0.3, 50.0_f64.ln()];
        let (freed, mut values) = term.freed(&p).unwrap();
        assert!(freed.form() == "free" && freed.count() == 3 && freed.freed(&values).is_none());
        let run = SineRun {
            settings: vec![SineSetting { frequency_hz: 40.0, middle_s: 0.0 }],
            rate_hz: 128.0,
            length_s: 10.0,
            begins_known: true,
            tags_are_rounded: false,
            temperatures: SlowTable::default(),
        };
        let added = |term: &dyn SineTerm, p: &[f64]| {
            let mut to = [0.0; 3];
            term.add(p, &run, 0, 1, &mut to);
            to
        };
        let close = |a: Triple, b: Triple| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-14);
        assert!(close(added(&term, &p), added(&*freed, &values)));
        values[2] = 0.9_f64.ln();
        let x: f64 = 40.0 / 50.0;
        let factor = Complex::from(0.7) + Complex::new(1.0 - x * x, x / 0.9).inv() * 0.3;
        assert!(close([factor.norm().ln(), factor.arg(), 0.0], added(&*freed, &values)));
    }

    #[test]
    fn a_delay_turns_back() {
        let factor = InSine::Delay(2.5e-3).factor(100.0, 2);
        assert!((factor - Complex::new(0.0, -1.0)).norm() < 1e-12, "{factor}");
    }
}
