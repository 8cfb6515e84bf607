//! Temperatures of a campaign: the thermal box and the sensor in it, coil system and rack, and what thermistors show of them.

use super::noise::Random;
use crate::data::run::SlowTable;
use crate::files::twin::{Approach, Body, BoxTwin, Climate, Phase, Thermistor, Twin};
use crate::model::lag;
use jiff::Timestamp;

/// Step of the temperature history, s.
const STEP_S: f64 = 10.0;
/// Hour of the day (UTC) at which coil system and rack are warmest.
const WARMEST_H: f64 = 15.0;
/// A thermistor that cannot be trusted keeps a wrong value for this long, s.
const JUMP_S: f64 = 60.0;

/// Values against time, on a grid from time zero.
#[derive(Clone, Debug)]
pub(super) struct History {
    pub(super) step_s: f64,
    pub(super) values: Vec<f64>,
}

impl History {
    /// The value at a time; the first or the last one outside of the grid.
    pub(super) fn at(&self, t_s: f64) -> f64 {
        let place = (t_s / self.step_s).max(0.0);
        let index = (place as usize).min(self.values.len().saturating_sub(1));
        let here = self.values.get(index).copied().unwrap_or(f64::NAN);
        let next = self.values.get(index + 1).copied().unwrap_or(here);
        here + (next - here) * (place - index as f64).min(1.0)
    }

    /// The temperature of a body that follows this one with a time constant.
    fn delayed(&self, time_constant_s: f64) -> Self {
        if time_constant_s <= 0.0 {
            return self.clone();
        }
        let x = self.step_s / time_constant_s;
        let mut value = self.values.first().copied().unwrap_or(f64::NAN);
        let mut values = vec![value];
        for pair in self.values.windows(2) {
            value = lag::follow(value, pair[0], pair[1], x);
            values.push(value);
        }
        Self { values, ..*self }
    }
}

/// All temperatures of a campaign.
#[derive(Clone, Debug)]
pub struct Temperatures {
    origin: Timestamp,
    bodies: [(Body, History); 4],
    thermistors: Vec<History>,
}

impl Temperatures {
    /// From an hour before the first to an hour after the last of `times`.
    #[must_use]
    pub fn of(twin: &Twin, times: [Timestamp; 2]) -> Self {
        let [begin, end] = times;
        let first_phase = twin.thermal_box.phases.first().map_or(begin, |p| p.from);
        let origin = begin.min(first_phase);
        let count = (seconds(origin, end) / STEP_S).ceil() as usize + 1;
        let box_history = box_history(&twin.thermal_box, origin, count);
        let climate = |climate: &Climate| {
            let midnight_s = (origin.as_second().rem_euclid(86_400)) as f64;
            let value = |i: usize| {
                let now_s = i as f64 * STEP_S;
                let day = (midnight_s + now_s - WARMEST_H * 3600.0) / 86_400.0;
                without_day(climate, origin, now_s) + climate.daily_k * (std::f64::consts::TAU * day).cos()
            };
            History { step_s: STEP_S, values: (0..count).map(value).collect() }
        };
        let sensor = box_history.delayed(twin.thermal_box.sensor_time_constant_s);
        let bodies = [
            (Body::Sensor, sensor),
            (Body::Box, box_history),
            (Body::Coil, climate(&twin.coil_climate)),
            (Body::Rack, climate(&twin.rack_climate)),
        ];
        let of = |body: Body| bodies.iter().find(|(b, _)| *b == body).map(|(_, history)| history);
        let thermistors = twin
            .thermistors
            .iter()
            .map(|t| {
                of(t.of).map_or(History { step_s: STEP_S, values: Vec::new() }, |history| history.delayed(t.time_constant_s))
            })
            .collect();
        Self { origin, bodies, thermistors }
    }

    /// Temperature of a body some time after the start of a run, °C.
    #[must_use]
    pub fn body_degc(&self, body: Body, start: Timestamp, t_s: f64) -> f64 {
        let history = self.bodies.iter().find(|(b, _)| *b == body);
        history.map_or(f64::NAN, |(_, history)| history.at(seconds(self.origin, start) + t_s))
    }

    /// Readings of the thermistors during a run; `random` is a stream of the run.
    #[must_use]
    pub fn table(&self, thermistors: &[Thermistor], start: Timestamp, t_s: &[f64], random: &mut Random) -> SlowTable {
        let begin_s = seconds(self.origin, start);
        let values = thermistors.iter().zip(&self.thermistors).map(|(thermistor, history)| {
            let mut jump = (f64::NEG_INFINITY, 0.0);
            t_s.iter()
                .map(|t| {
                    let mut value = history.at(begin_s + t) + thermistor.offset_k + thermistor.noise_k * random.normal();
                    let now_s = |moment: Timestamp| seconds(start, moment);
                    if let Some(j) = thermistor.jumps.iter().find(|j| (now_s(j.from)..now_s(j.until)).contains(t)) {
                        if t - jump.0 >= JUMP_S {
                            jump = (*t, j.by_k[0] + (j.by_k[1] - j.by_k[0]) * random.uniform());
                        }
                        value += jump.1;
                    }
                    value
                })
                .collect()
        });
        let values = values.collect();
        SlowTable { names: thermistors.iter().map(|t| t.channel.clone()).collect(), t_s: t_s.to_vec(), values }
    }
}

/// A climate without its daily change: between its readings on a straight line, beyond them the nearest; the mean without any.
fn without_day(climate: &Climate, origin: Timestamp, now_s: f64) -> f64 {
    let at_s = |reading: &(Timestamp, f64)| seconds(origin, reading.0);
    let next = climate.readings.partition_point(|r| at_s(r) <= now_s);
    match (next.checked_sub(1).and_then(|i| climate.readings.get(i)), climate.readings.get(next)) {
        (Some(last), Some(next)) => last.1 + (next.1 - last.1) * (now_s - at_s(last)) / (at_s(next) - at_s(last)),
        (Some((_, degc)), None) | (None, Some((_, degc))) => *degc,
        (None, None) => climate.mean_degc,
    }
}

/// Seconds from one time to another.
#[must_use]
pub fn seconds(from: Timestamp, to: Timestamp) -> f64 {
    to.duration_since(from).as_secs_f64()
}

fn box_history(twin: &BoxTwin, origin: Timestamp, count: usize) -> History {
    let mut value = twin.start_degc;
    let mut phases: Vec<(f64, &Phase)> = twin.phases.iter().map(|p| (seconds(origin, p.from), p)).collect();
    phases.reverse();
    let mut current: Option<&Phase> = None;
    let values = (0..count).map(|i| {
        let now_s = i as f64 * STEP_S;
        if let Some(phase) = current {
            let left = phase.target_degc - value;
            value += match phase.approach {
                Approach::Rate(k_per_h) => left.signum() * left.abs().min(k_per_h * STEP_S / 3600.0),
                Approach::Time(hours) => left * (1.0 - (-STEP_S / 3600.0 / hours).exp()),
            };
        }
        while phases.last().is_some_and(|(from_s, _)| *from_s <= now_s) {
            current = phases.pop().map(|(_, phase)| phase);
        }
        value
    });
    History { step_s: STEP_S, values: values.collect() }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ramp_is_followed_at_the_distance_of_the_time_constant() {
        let history = History { step_s: STEP_S, values: (0..2000).map(|i| f64::from(i) * 0.1).collect() };
        let delayed = history.delayed(600.0);
        // Rate 0.01 K/s: the lag is 6 K (1 - exp(-t / 600 s)).
        for t in [100.0, 1000.0, 10_000.0] {
            let expected = 0.01 * (t - 600.0 * (1.0 - f64::exp(-t / 600.0)));
            assert!((delayed.at(t) - expected).abs() < 1e-9, "{t}");
        }
        assert_eq!(history.delayed(0.0).at(55.0), 0.55);
    }

    #[test]
    fn a_climate_goes_through_its_readings() {
        let at = |h: i64| Timestamp::from_second(3600 * h).unwrap();
        let climate = Climate { mean_degc: 9.0, readings: vec![(at(2), 16.0), (at(4), 17.0)], daily_k: 0.0 };
        for (hours, expected) in [(0.0, 16.0), (2.0, 16.0), (3.0, 16.5), (3.5, 16.75), (9.0, 17.0)] {
            assert_eq!(without_day(&climate, at(0), 3600.0 * hours), expected, "{hours}");
        }
        assert_eq!(without_day(&Climate { readings: Vec::new(), ..climate }, at(0), 60.0), 9.0);
    }

    #[test]
    fn the_box_ramps_holds_and_drifts() {
        let at = |h: f64| Timestamp::from_second((h * 3600.0) as i64).unwrap();
        let phases = vec![
            Phase { from: at(1.0), target_degc: -40.0, approach: Approach::Rate(60.0) },
            Phase { from: at(4.0), target_degc: 20.0, approach: Approach::Time(2.0) },
        ];
        let twin = BoxTwin { start_degc: 20.0, sensor_time_constant_s: 0.0, phases, heater: None };
        let history = box_history(&twin, at(0.0), 3000);
        for (hours, expected) in [(0.5, 20.0), (1.5, -10.0), (3.0, -40.0), (6.0, 20.0 - 60.0 * f64::exp(-1.0))] {
            assert!((history.at(hours * 3600.0) - expected).abs() < 1e-9, "{hours}: {}", history.at(hours * 3600.0));
        }
    }
}
