//! A switched heater current.

use super::{About, Column, Effect, Family, Record, Spec};
use std::f64::consts::{PI, TAU};

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if record.has_samples {
            // Period, duty and delay are found in the spectrum of the samples.
            Ok(Vec::new())
        } else {
            Err("it shows in the samples, and the file brings means only".to_owned())
        }
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let (period_s, duty, delay_s) = (spec.get("period")?, spec.get("duty")?, spec.get("delay")?);
        let on = |used_s: [f64; 2]| pulse(period_s, duty, delay_s, used_s) - duty;
        Some(spec.axes.iter().map(|&a| Column::on("a", a, "enT", record, |_, r| on(r.used_s))).collect())
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(Spec::new("square", &[0]).with("period", 2.5, "s").with("duty", 0.3, "1").with("delay", 0.4, "s"))
    }
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
