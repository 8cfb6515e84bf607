//! A line, perhaps aliased.

use super::{About, Column, Effect, Family, Record, Spec};
use std::f64::consts::{PI, TAU};

/// A line, perhaps aliased.
pub struct InterferenceTone;

impl Effect for InterferenceTone {
    fn id(&self) -> &'static str {
        "interference_tone"
    }

    fn about(&self) -> About {
        About {
            summary: "interference line, perhaps aliased",
            formula: "x_i += s_i sin(2πft) + c_i cos(2πft)",
            family: Family::Periodic,
            seen_in: "lin, zero-field (samples)",
            needs: "samples",
            source: "RO-IGEP-TR0028, LEVEL_H",
            best_measurement: "zero field at two sample rates: an alias moves, a line does not",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if record.has_samples {
            // The frequency is found in the spectrum of the samples.
            Ok(Vec::new())
        } else {
            Err("it shows in the samples, and the file brings means only".to_owned())
        }
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let frequency_hz = spec.get("frequency")?;
        let columns = spec.axes.iter().flat_map(|&a| {
            [("s", false), ("c", true)].map(|(name, even)| {
                Column::on(name, a, "enT", record, |_, r| {
                    let (sin, cos) = wave(frequency_hz, r.used_s);
                    if even { cos } else { sin }
                })
            })
        });
        Some(columns.collect())
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(Spec::new("sine", &[0]).with("frequency", 0.8, "Hz"))
    }
}

/// Means of sine and cosine of a frequency over a time.
#[must_use]
pub fn wave(frequency_hz: f64, used_s: [f64; 2]) -> (f64, f64) {
    let x = PI * frequency_hz * (used_s[1] - used_s[0]);
    let mean = if x.abs() > 1e-12 { x.sin() / x } else { 1.0 };
    let (sin, cos) = (TAU * (0.5 * frequency_hz * (used_s[0] + used_s[1])).fract()).sin_cos();
    (mean * sin, mean * cos)
}
