//! A line, perhaps aliased.

use super::in_samples::{InSamples, Line};
use super::{About, Acts, BESIDE_THE_SINES, Column, Effect, Family, Record, ShapeParameter, Spec, Unseen};
use crate::data::run::Kind;
use std::f64::consts::{PI, TAU};

/// Its form.
const SINE: &str = "sine";
/// Shape.
const FREQUENCY: &str = "frequency";

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Samples]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::fixed(FREQUENCY, "Hz")] }
    }

    fn is_of_one_run(&self, _form: &str) -> bool {
        true
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(BESIDE_THE_SINES)
    }

    fn in_samples(&self) -> Option<InSamples> {
        Some(InSamples::Line(Line { frequency: FREQUENCY, term: sine, wave }))
    }

    fn period_s(&self, spec: &Spec) -> Option<f64> {
        spec.get(FREQUENCY).map(f64::recip)
    }

    fn place_in_samples(&self, spec: &Spec) -> String {
        let frequency_hz = spec.get(FREQUENCY).unwrap_or(f64::NAN);
        format!("{}, everywhere inside the plateaus at {frequency_hz:.4} Hz", spec.axis_names().join(", "))
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if record.has_samples {
            // The frequency is found in the spectrum of the samples.
            Ok(Vec::new())
        } else {
            Err(Unseen::MeansOnly("in the samples"))
        }
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let frequency_hz = spec.get(FREQUENCY)?;
        let waves: Vec<(f64, f64)> = record.rows.iter().map(|r| wave(frequency_hz, r.used_s)).collect();
        let columns = spec.axes.iter().flat_map(|&a| {
            [Column::on("s", a, "enT", record, |i, _| waves[i].0), Column::on("c", a, "enT", record, |i, _| waves[i].1)]
        });
        Some(columns.collect())
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(sine(&[0], 0.8))
    }
}

/// The term of a line.
fn sine(axes: &[usize], frequency_hz: f64) -> Spec {
    Spec::new(SINE, axes).with(FREQUENCY, frequency_hz, "Hz")
}

/// Means of sine and cosine of a frequency over a time.
#[must_use]
pub fn wave(frequency_hz: f64, used_s: [f64; 2]) -> (f64, f64) {
    let x = PI * frequency_hz * (used_s[1] - used_s[0]);
    let mean = if x.abs() > 1e-12 { x.sin() / x } else { 1.0 };
    let (sin, cos) = (TAU * (0.5 * frequency_hz * (used_s[0] + used_s[1])).fract()).sin_cos();
    (mean * sin, mean * cos)
}
