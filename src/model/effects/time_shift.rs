//! Time tags of vectors and settings differ.

use super::in_sine::InSine;
use super::{About, Column, Effect, Family, Record, Spec};

/// Its form in sines.
pub const DELAY: &str = "delay";

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

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        if !record.has_samples {
            return Err("it shows at the edges of the plateaus, and the file brings means only".to_owned());
        }
        record.require_fields()?;
        Ok(vec![Spec::new("edges", &[0, 1, 2]).with("shift", 0.0, "s")])
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        // The field around an edge is that of the other side for the time of the shift.
        let shift_s = spec.get("shift")?;
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
        (spec.form == DELAY).then(|| InSine::Delay(value("shift")))
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(Spec::new("edges", &[0, 1, 2]).with("shift", 0.4, "s"))
    }
}
