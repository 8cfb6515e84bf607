//! The sampling frequency of every component from the phase progress within all settings together.

use super::refusal::FreqError;
use super::rounding::{self, Rounded};
use super::samples::Record;
use crate::data::run::Setting;
use crate::data::units::COMPONENTS;
use crate::fit::sine::{self, CommonRate, Packet, RateRefusal, Sine};
use rayon::prelude::*;
use std::ops::Range;

/// Largest relative uncertainty of a sampling frequency that is one: beyond it a setting does not keep its phase.
const KNOWN_RATE: f64 = 1e-3;

/// Rounds in which the errors of rounding follow the rate.
const ROUNDS: usize = 2;

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
            let packets = records.iter().zip(settings).zip(ranges).map(|((record, setting), range)| Packet {
                n: &record.n[range.clone()],
                y: &record.y[component][range.clone()],
                frequency_hz: setting.frequency_hz,
                least_std: 0.0,
            });
            rate(packets.collect(), start_hz)
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

/// The rate of packets, whose readings may be rounded: what that leaves is asked for with the rate that is found without, and with that found then.
fn rate(mut packets: Vec<Packet>, start_hz: f64) -> Result<CommonRate, RateRefusal> {
    let first = sine::common_rate(&packets, start_hz)?;
    let Some(step) = rounding::resolution(packets.iter().map(|packet| packet.y)) else { return Ok(first) };
    // As in most runs: the noise averages the rounding, and no sine has to be fitted once more to see it.
    if first.packets.iter().all(|packet| packet.residual_std.is_nan() || packet.residual_std > step) {
        return Ok(first);
    }
    let mut found = first;
    for _ in 0..ROUNDS {
        let sines: Vec<Option<Sine>> =
            packets.iter().map(|packet| sine::three(packet.n, packet.y, packet.frequency_hz, found.rate_hz).ok()).collect();
        let rounded = packets.iter().zip(&sines).map(|(packet, sine)| {
            let Packet { n, frequency_hz, .. } = *packet;
            Some(Rounded { n, frequency_hz, rate_hz: found.rate_hz, sine: sine.as_ref()? })
        });
        let stds = rounding::amplitude_stds(step, &rounded.collect::<Vec<_>>());
        // White noise of the readings that does the same to the amplitude, and so to the phase.
        packets.iter_mut().zip(stds).for_each(|(packet, std)| packet.least_std = std * (0.5 * packet.n.len() as f64).sqrt());
        found = sine::common_rate(&packets, start_hz)?;
    }
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;
    use std::f64::consts::TAU;

    /// Cross axes of a few steps at frequencies with simple ratios to the nominal rate: their readings look the same for ever.
    #[test]
    fn rounded_readings_tell_the_sampling_frequency_no_better_than_they_can() {
        const HZ: [f64; 11] = [0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 12.8, 25.6, 42.667, 51.2];
        let n: Vec<u64> = (0..2560).collect();
        for true_hz in [127.9989, 127.9999] {
            let mut pulls = Vec::new();
            for seed in 0..20 {
                let mut random = Random::seeded(seed);
                let mut rates = Vec::new();
                for amplitude in [13.0, 90.0, 1000.0] {
                    let readings: Vec<Vec<f64>> = HZ
                        .iter()
                        .map(|hz| {
                            let phase = TAU * random.uniform();
                            let field = |n: &u64| amplitude * (sine::phase(*hz, true_hz, *n) + phase).sin();
                            n.iter().map(|n| 8.0 * ((field(n) + 0.4 * random.gaussian()) / 8.0).round()).collect()
                        })
                        .collect();
                    let packets =
                        readings.iter().zip(HZ).map(|(y, frequency_hz)| Packet { n: &n, y, frequency_hz, least_std: 0.0 });
                    let rate = rate(packets.collect(), 128.0).expect("a rate");
                    pulls.push((rate.rate_hz - true_hz) / rate.std_hz);
                    rates.push(Some(rate));
                }
                let found: [Option<CommonRate>; 3] = rates.try_into().expect("three");
                let mean = Rates { found, refused: Vec::new() }.mean_hz();
                assert!((mean - true_hz).abs() < 1e-4, "{true_hz} {seed}: {mean}");
            }
            let rms = (pulls.iter().map(|pull| pull * pull).sum::<f64>() / pulls.len() as f64).sqrt();
            // Phases that come again have the same errors at both ends of a setting, so that they are less than that.
            assert!((0.25..1.1).contains(&rms) && pulls.iter().all(|pull| pull.abs() < 3.0), "{true_hz}: {rms}");
        }
    }
}
