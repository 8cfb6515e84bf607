//! The sampling frequency moves during the run.

use super::in_sine::InSine;
use super::{About, Column, Effect, Family, Record, Spec};

/// Its form in time; the degree follows.
pub const IN_TIME: &str = "polynomial in run time of degree ";
/// Its form with temperature; the channel follows.
pub const WITH_TEMPERATURE: &str = "linear in ";

/// The sampling frequency moves during the run.
pub struct ClockDrift;

impl Effect for ClockDrift {
    fn id(&self) -> &'static str {
        "clock_drift"
    }

    fn about(&self) -> About {
        About {
            summary: "f_s moves during the run",
            formula: "f_s + Σ d_k t^k, or f_s + d (T - T_mean)",
            family: Family::Periodic,
            seen_in: "freq",
            needs: "phases of sines",
            source: "BC-MAG-TR-0085 section 11",
            best_measurement: "the first frequency once more at the end",
        }
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, String> {
        let _ = record;
        Err("needs a frequency run".to_owned())
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let _ = (record, spec);
        None
    }

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        if let Some(degree) = spec.form.strip_prefix(IN_TIME) {
            let degree: usize = degree.parse().ok().filter(|d| (1..=9).contains(d))?;
            return Some(InSine::Clock((1..=degree).map(|k| value(&format!("drift_{k}"))).collect()));
        }
        let channel = spec.form.strip_prefix(WITH_TEMPERATURE)?.to_owned();
        Some(InSine::ClockTemperature { channel, hz_per_k: value("drift") })
    }
}
