//! The sampling frequency of every component from the phase progress within all settings together.

use super::refusal::FreqError;
use super::samples::Record;
use crate::data::run::Setting;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, CommonRate, Packet, RateRefusal};
use rayon::prelude::*;
use std::ops::Range;

/// Largest relative uncertainty of a sampling frequency that is one: beyond it a setting does not keep its phase.
const KNOWN_RATE: f64 = 1e-3;

/// The sampling frequency of every component, or why it has none.
pub(super) struct Rates {
    pub found: [Option<CommonRate>; 3],
    pub refused: Vec<String>,
}

impl Rates {
    /// Weighted mean of the components, Hz.
    pub fn mean_hz(&self) -> f64 {
        let weighted = |get: fn(&CommonRate) -> f64| self.found.iter().flatten().map(|r| get(r) / r.std_hz.powi(2)).sum::<f64>();
        weighted(|r| r.rate_hz) / weighted(|_| 1.0)
    }
}

/// The sampling frequency of every component; an error if none has one. A component that sees nothing of the field tells none.
pub(super) fn rates(
    records: &[&Record],
    settings: &[Setting],
    ranges: &[Range<usize>],
    start_hz: f64,
) -> Result<Rates, FreqError> {
    let results: Vec<Result<CommonRate, RateRefusal>> = (0..3)
        .into_par_iter()
        .map(|component| {
            let packets: Vec<Packet> = records
                .iter()
                .zip(settings)
                .zip(ranges)
                .map(|((record, setting), range)| Packet {
                    n: &record.n[range.clone()],
                    y: &record.y[component][range.clone()],
                    frequency_hz: setting.frequency_hz,
                })
                .collect();
            sine::common_rate(&packets, start_hz)
        })
        .collect();
    // A rate beyond this is that of noise.
    let is_known = |rate: &CommonRate| rate.std_hz.is_finite() && rate.std_hz > 0.0 && rate.std_hz < KNOWN_RATE * rate.rate_hz;
    let mut rates = Rates { found: [None, None, None], refused: Vec::new() };
    let mut first = None;
    for (component, result) in results.into_iter().enumerate() {
        let why = match result {
            Ok(rate) if is_known(&rate) => {
                rates.found[component] = Some(rate);
                continue;
            }
            Ok(rate) => format!("it is {:.4} Hz with an uncertainty of {:.4} Hz", rate.rate_hz, rate.std_hz),
            Err(refusal) => refusal.to_string(),
        };
        rates.refused.push(format!("component {} tells no sampling frequency: {why}", COMPONENTS[component]));
        first.get_or_insert(FreqError::NoRate { component: COMPONENTS[component], why });
    }
    match first {
        Some(error) if rates.found.iter().all(Option::is_none) => Err(error),
        _ => Ok(rates),
    }
}
