//! A transient after a step of the field.

use super::in_samples::{InSamples, Transient};
use super::record::Step;
use super::{About, Acts, Column, Effect, Family, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen};
use crate::data::run::Kind;

/// Time constants that are tried, s.
const TAUS_S: [f64; 8] = [0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4];
/// A transient is over after so many time constants.
const OVER: f64 = 30.0;

/// Its form.
const EXPONENTIAL: &str = "exponential";
/// Shape.
const TIME_CONSTANT: &str = "tau";

/// A transient after a step of the field.
pub struct Settling;

impl Effect for Settling {
    fn id(&self) -> &'static str {
        "settling"
    }

    fn about(&self) -> About {
        About {
            summary: "transient after a field step (eddy currents)",
            formula: "x -= Σ_steps c ΔB exp(-(t - t_step)/τ), c common or per axis",
            family: Family::History,
            seen_in: "lin (samples)",
            needs: "steps of the field, samples",
            source: "BC-MAG-TR-0085 section 8",
            best_measurement: "long plateaus after large steps at full rate",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::Samples]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(TIME_CONSTANT, "s")] }
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn in_samples(&self) -> Option<InSamples> {
        Some(InSamples::Transient(Transient {
            taus_s: &TAUS_S,
            time_constant: TIME_CONSTANT,
            term: exponential,
            mean: sampled_transient,
        }))
    }

    fn place_in_samples(&self, spec: &Spec) -> String {
        format!("{}, the first seconds after every step", spec.axis_names().join(", "))
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        if !record.has_samples {
            return Err(Unseen::MeansOnly("inside the plateaus"));
        }
        record.require_fields()?;
        Ok(TAUS_S.into_iter().map(|tau_s| exponential(&[0, 1, 2], tau_s)).collect())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let tau_s = spec.get(TIME_CONSTANT).filter(|tau| *tau > 0.0)?;
        let transient = |used_s: [f64; 2]| -> [f64; 3] { transient(&record.steps, used_s, tau_s) };
        let all: Vec<[f64; 3]> = record.rows.iter().map(|r| transient(r.used_s)).collect();
        Some(match spec.axes.as_slice() {
            [a] => vec![Column::on("fraction", *a, "1", record, |i, _| -all[i][*a])],
            _ => vec![Column::of("fraction", "1", record, |i, _| all[i].map(|v| -v))],
        })
    }

    fn example(&self, _record: &Record) -> Option<Spec> {
        Some(exponential(&[0, 1, 2], 0.8))
    }
}

/// The term of a time constant.
fn exponential(axes: &[usize], tau_s: f64) -> Spec {
    Spec::new(EXPONENTIAL, axes).with(TIME_CONSTANT, tau_s, "s")
}

/// Mean over a time of the transients of all steps before it, enT, for a time constant.
#[must_use]
pub fn transient(steps: &[Step], used_s: [f64; 2], tau_s: f64) -> [f64; 3] {
    let [begin, end] = used_s;
    let mut sum = [0.0; 3];
    let upto = steps.partition_point(|s| s.t_s <= begin);
    for step in steps[..upto].iter().rev().take_while(|s| begin - s.t_s < OVER * tau_s) {
        let first = (-(begin - step.t_s) / tau_s).exp();
        let share = if end > begin { first * tau_s / (end - begin) * -(-(end - begin) / tau_s).exp_m1() } else { first };
        for a in 0..3 {
            sum[a] += share * step.change_ent[a];
        }
    }
    sum
}

/// Mean of equidistant samples from the first to the last time, no step between them, of the same transients, enT. It is the mean over the time
/// from half an interval before them to half an interval after them, times `x / sinh x` with half an interval over the time constant as x: both
/// are geometric sums.
#[must_use]
pub fn sampled_transient(steps: &[Step], ends_s: [f64; 2], dt_s: f64, tau_s: f64) -> [f64; 3] {
    let x = 0.5 * dt_s / tau_s;
    transient(steps, [ends_s[0] - 0.5 * dt_s, ends_s[1] + 0.5 * dt_s], tau_s).map(|v| v * x / x.sinh())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_of_samples_are_their_sums() {
        let step = |t_s: f64, change_ent: [f64; 3]| Step { t_s, change_ent };
        let steps = [step(0.0, [100.0, 0.0, -40.0]), step(3.0, [-50.0, 20.0, 0.0])];
        for (tau_s, dt_s, count) in [(0.05, 0.25, 8), (0.8, 0.25, 1), (0.8, 1.0 / 128.0, 100), (6.4, 0.25, 12)] {
            let times: Vec<f64> = (0..count).map(|k| 3.3 + f64::from(k) * dt_s).collect();
            let mean = sampled_transient(&steps, [times[0], times[times.len() - 1]], dt_s, tau_s);
            for (a, mean) in mean.into_iter().enumerate() {
                let at = |t: f64| steps.iter().map(|s| s.change_ent[a] * (-(t - s.t_s) / tau_s).exp()).sum::<f64>();
                let expected = times.iter().map(|t| at(*t)).sum::<f64>() / f64::from(count);
                assert!((mean - expected).abs() < 1e-9, "{tau_s} {dt_s} {a}: {mean} is not {expected}");
            }
        }
    }
}
