//! Time tags of vectors and settings differ.

use super::in_samples::InSamples;
use super::in_sine::{InSine, SineParameter, SineRun, SineTerm, Triple};
use super::{About, Acts, Column, Effect, Family, Record, ShapeParameter, Spec, Unseen};
use crate::data::units::three_digits;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Its form in sines.
pub const DELAY: &str = "delay";

/// Its form in readings.
const EDGES: &str = "edges";
/// Shape in readings and parameter in sines, s, positive where the vectors are late.
pub const SHIFT: &str = "shift";

/// Least displacement of sines, in samples: a hundredth of a sample is the delay of a response and no displacement of time tags.
const LEAST_SHIFT: f64 = 0.02;

/// Time tags of vectors and settings differ.
pub struct TimeShift;

impl Effect for TimeShift {
    fn id(&self) -> &'static str {
        "time_shift"
    }

    fn about(&self) -> About {
        About {
            summary: "time tags of vectors and settings differ",
            formula: "the field of a vector at t is that of the settings at t - Δt",
            family: Family::Periodic,
            seen_in: "lin, freq",
            needs: "samples around the steps",
            source: "BC-MAG-TR-0085 section 7",
            best_measurement: "large steps at full rate, and a pulse per second in both records",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::Samples, Acts::Sines]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::fixed(SHIFT, "s")] }
    }

    fn in_samples(&self) -> Option<InSamples> {
        Some(InSamples::Edges)
    }

    fn place_in_samples(&self, _spec: &Spec) -> String {
        "all axes, at the edges of the plateaus".to_owned()
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if !record.has_samples {
            return Err(Unseen::MeansOnly("at the edges of the plateaus"));
        }
        record.require_fields()?;
        Ok(vec![edges(0.0)])
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        // The field around an edge is that of the other side for the time of the shift.
        let shift_s = spec.get(SHIFT)?;
        let wrong = |used_s: [f64; 2]| -> [f64; 3] {
            let mut sum = [0.0; 3];
            let [begin, end] = [used_s[0] - shift_s.abs(), used_s[1] + shift_s.abs()];
            let near = record.steps.partition_point(|s| s.t_s < begin)..record.steps.partition_point(|s| s.t_s <= end);
            for step in &record.steps[near] {
                let [from, to] = if shift_s > 0.0 { [step.t_s, step.t_s + shift_s] } else { [step.t_s + shift_s, step.t_s] };
                let inside = if used_s[1] > used_s[0] {
                    (used_s[1].min(to) - used_s[0].max(from)).max(0.0) / (used_s[1] - used_s[0])
                } else if (from..to).contains(&used_s[0]) {
                    1.0
                } else {
                    0.0
                };
                for a in 0..3 {
                    sum[a] -= shift_s.signum() * inside * step.change_ent[a];
                }
            }
            sum
        };
        Some(vec![Column::of("part", "1", record, |_, r| wrong(r.used_s))])
    }

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        (spec.form == DELAY).then(|| InSine::Delay(value(SHIFT)))
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(edges(0.4))
    }

    fn unseen_in_sines(&self, run: &SineRun) -> Option<Unseen> {
        if !run.begins_known {
            Some(Unseen::Stated("the phase of the field at the begin of a setting is not known"))
        } else if run.tags_are_rounded {
            let reason = "the time tags are rounded: a shift of all samples against the settings is fitted and not judged";
            Some(Unseen::Stated(reason))
        } else {
            None
        }
    }

    fn sine_terms(&self, run: &SineRun, _corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        if run.begins_known { vec![delay()] } else { Vec::new() }
    }

    fn known_sine_term(&self, known: &InSine, _run: &SineRun) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        let InSine::Delay(late_s) = known else { return None };
        Some((delay(), vec![1e6 * late_s]))
    }
}

/// The term of a displacement of all axes.
#[must_use]
pub fn edges(shift_s: f64) -> Spec {
    Spec::new(EDGES, &[0, 1, 2]).with(SHIFT, shift_s, "s")
}

/// The data are displaced against the settings. Parameter in µs, positive if the data are late.
#[derive(Clone, Debug)]
struct Delayed;

/// The term of a displacement in sines, with its parameter in µs.
#[must_use]
pub fn delay() -> Arc<dyn SineTerm> {
    Arc::new(Delayed)
}

impl SineTerm for Delayed {
    fn kind(&self) -> &'static str {
        DELAY
    }

    fn form(&self) -> String {
        DELAY.to_owned()
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, _i: usize, to: &mut Triple) {
        to[1] -= TAU * run.settings[j].frequency_hz * 1e-6 * p[0];
    }

    fn is_reported(&self, p: &[f64], run: &SineRun) -> bool {
        1e-6 * p[0].abs() > LEAST_SHIFT / run.rate_hz
    }

    fn report(
        &self,
        _run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        _correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        let shift = SineParameter::new(SHIFT, 1e-6 * p[0], std(0).map(|s| 1e-6 * s), "s");
        (Spec::new(DELAY, &self.axes()), vec![shift])
    }

    fn limit(&self, _run: &SineRun, least: f64, _hz: f64) -> String {
        format!("shift = {} s", three_digits(1e-6 * least))
    }
}
