//! A switched heater current.

use super::in_samples::{Comb, InSamples};
use super::{About, Acts, BESIDE_THE_SINES, Column, Effect, Family, Record, ShapeParameter, Spec, Unseen};
use crate::data::run::Kind;
use std::f64::consts::{PI, TAU};

/// Its form.
const SQUARE: &str = "square";
/// Shape: the period, the part of it in which the current flows, and when it first begins.
const PERIOD: &str = "period";
const DUTY: &str = "duty";
const DELAY: &str = "delay";

/// A switched heater current.
pub struct HeaterPwm;

impl Effect for HeaterPwm {
    fn id(&self) -> &'static str {
        "heater_pwm"
    }

    fn about(&self) -> About {
        About {
            summary: "switched heater current",
            formula: "x_i += a_i while the heater is on: a square wave of period, duty and delay, its mean taken off",
            family: Family::Periodic,
            seen_in: "lin, zero-field (samples)",
            needs: "samples",
            source: "RO-IGEP-TR0028, LEVEL_K",
            best_measurement: "zero field with the heater on, off, and at another duty",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Samples]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::fixed(PERIOD, "s"), ShapeParameter::fixed(DUTY, "1"), ShapeParameter::fixed(DELAY, "s")] }
    }

    fn is_of_one_run(&self, _form: &str) -> bool {
        true
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(BESIDE_THE_SINES)
    }

    fn in_samples(&self) -> Option<InSamples> {
        Some(InSamples::Comb(Comb { period: PERIOD, term: square, harmonic }))
    }

    fn period_s(&self, spec: &Spec) -> Option<f64> {
        spec.get(PERIOD)
    }

    fn place_in_samples(&self, spec: &Spec) -> String {
        let period_s = spec.get(PERIOD).unwrap_or(f64::NAN);
        format!("{}, everywhere inside the plateaus with a period of {period_s:.4} s", spec.axis_names().join(", "))
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if record.has_samples {
            // Period, duty and delay are found in the spectrum of the samples.
            Ok(Vec::new())
        } else {
            Err(Unseen::MeansOnly("in the samples"))
        }
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let (period_s, duty, delay_s) = (spec.get(PERIOD)?, spec.get(DUTY)?, spec.get(DELAY)?);
        let on = |used_s: [f64; 2]| pulse(period_s, duty, delay_s, used_s) - duty;
        Some(spec.axes.iter().map(|&a| Column::on("a", a, "enT", record, |_, r| on(r.used_s))).collect())
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(square(&[0], 2.5, 0.3, 0.4))
    }
}

/// The term of a square wave.
fn square(axes: &[usize], period_s: f64, duty: f64, delay_s: f64) -> Spec {
    Spec::new(SQUARE, axes).with(PERIOD, period_s, "s").with(DUTY, duty, "1").with(DELAY, delay_s, "s")
}

/// Part of a time in which a square wave is on.
#[must_use]
pub fn pulse(period_s: f64, duty: f64, delay_s: f64, used_s: [f64; 2]) -> f64 {
    // Time on since the first edge.
    let on = |t: f64| {
        let phase = (t - delay_s) / period_s;
        period_s * (phase.floor() * duty + phase.rem_euclid(1.0).min(duty))
    };
    let [begin, end] = used_s;
    if end > begin {
        (on(end) - on(begin)) / (end - begin)
    } else if ((begin - delay_s) / period_s).rem_euclid(1.0) < duty {
        1.0
    } else {
        0.0
    }
}

/// Sine and cosine part of a harmonic of the square wave, for an amplitude of one and sine and cosine of `2π harmonic t / period`.
#[must_use]
pub fn harmonic(order: usize, duty: f64, delay_part: f64) -> (f64, f64) {
    let n = order as f64;
    let size = 2.0 * (PI * n * duty).sin() / (PI * n);
    let angle = TAU * n * (delay_part + 0.5 * duty);
    (size * angle.sin(), size * angle.cos())
}
