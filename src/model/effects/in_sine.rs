//! What effects of the response and of the clock do to a sine.

use nalgebra::Complex;
use std::f64::consts::TAU;

/// Quality of the two poles of `response_order`: between those of Bessel and Butterworth.
const QUALITY: f64 = 0.65;

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
