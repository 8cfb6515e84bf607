//! The sampling frequency moves during the run.

use super::in_sine::{InSine, SineParameter, SineRun, SineTerm, Triple};
use super::{About, Acts, Changes, Effect, Family, Spec, Unseen};
use crate::data::run::{Kind, interpolate};
use crate::data::units::three_digits;
use std::f64::consts::TAU;
use std::sync::Arc;

/// Its form in time; the degree follows.
pub const IN_TIME: &str = "polynomial in run time of degree ";
/// Its form with temperature; the channel follows.
pub const WITH_TEMPERATURE: &str = "linear in ";

/// Highest degree of a polynomial that is looked for.
const HIGHEST_DEGREE: usize = 3;
/// A temperature with fewer readings tells nothing of a clock.
const LEAST_READINGS: usize = 8;

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

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Sines]
    }

    fn changes(&self) -> Changes {
        Changes::Clock
    }

    fn is_of_one_run(&self, form: &str) -> bool {
        form.starts_with(IN_TIME)
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind != Kind::Frequency).then_some(Unseen::NeedsSines)
    }

    fn in_sine(&self, spec: &Spec, value: &mut dyn FnMut(&str) -> f64) -> Option<InSine> {
        if let Some(degree) = spec.form.strip_prefix(IN_TIME) {
            let degree: usize = degree.parse().ok().filter(|d| (1..=9).contains(d))?;
            return Some(InSine::Clock((1..=degree).map(|k| value(&format!("drift_{k}"))).collect()));
        }
        let channel = spec.form.strip_prefix(WITH_TEMPERATURE)?.to_owned();
        Some(InSine::ClockTemperature { channel, hz_per_k: value("drift") })
    }

    fn sine_terms(&self, run: &SineRun, _corner_hz: f64) -> Vec<Arc<dyn SineTerm>> {
        let in_time = (1..=HIGHEST_DEGREE).map(|degree| Arc::new(InTime(degree)) as Arc<dyn SineTerm>);
        let names = run.temperatures.names.iter();
        let with_temperature = names.filter_map(|name| Some(Arc::new(WithTemperature::new(run, name)?) as Arc<dyn SineTerm>));
        in_time.chain(with_temperature).collect()
    }

    fn known_sine_term(&self, known: &InSine, run: &SineRun) -> Option<(Arc<dyn SineTerm>, Vec<f64>)> {
        let ppm = 1e6 / run.rate_hz;
        match known {
            InSine::Clock(drift) => {
                let relative = |(k, c): (usize, &f64)| ppm * c * run.length_s.powi(k as i32 + 1);
                Some((Arc::new(InTime(drift.len())), drift.iter().enumerate().map(relative).collect()))
            }
            InSine::ClockTemperature { channel, hz_per_k } => {
                Some((Arc::new(WithTemperature::new(run, channel)?), vec![ppm * hz_per_k]))
            }
            InSine::Poles { .. } | InSine::Delay(_) => None,
        }
    }
}

/// Relative change of the sampling frequency.
#[derive(Clone, Debug)]
pub enum Clock {
    /// `Σ c_k t^k`, from k = 1.
    Polynomial(Vec<f64>),
    /// In proportion to a temperature: times in s, relative changes there, and their integrals until there, s.
    Series(Vec<(f64, f64)>, Vec<(f64, f64)>),
}

impl Clock {
    /// In proportion to the deviation of a temperature from the mean of its readings, (time, value) of at least one.
    pub fn proportional(series: &[(f64, f64)], per_k: f64) -> Self {
        let mean = series.iter().map(|s| s.1).sum::<f64>() / series.len() as f64;
        let values: Vec<(f64, f64)> = series.iter().map(|(t, v)| (*t, per_k * (v - mean))).collect();
        // The integral counts from 0, which may lie before the first reading.
        let mut integrals = vec![(0.0, 0.0)];
        for (t, v) in values.iter().filter(|(t, _)| *t > 0.0) {
            let (before_s, sum) = integrals[integrals.len() - 1];
            integrals.push((*t, sum + (t - before_s) * 0.5 * (interpolate(&values, before_s) + v)));
        }
        Clock::Series(values, integrals)
    }

    /// At a run time.
    pub fn at(&self, t_s: f64) -> f64 {
        match self {
            Clock::Polynomial(c) => c.iter().rev().fold(0.0, |sum, c| (sum + c) * t_s),
            Clock::Series(values, _) => interpolate(values, t_s),
        }
    }

    /// Integral from 0, s.
    pub fn lead_s(&self, t_s: f64) -> f64 {
        match self {
            Clock::Polynomial(c) => c.iter().enumerate().map(|(k, c)| c * t_s.powi(k as i32 + 2) / (k as f64 + 2.0)).sum(),
            Clock::Series(values, integrals) => {
                let last = integrals.partition_point(|(t, _)| *t <= t_s).saturating_sub(1);
                let (begin_s, sum) = integrals.get(last).copied().unwrap_or_default();
                // Straight between the readings.
                sum + (t_s - begin_s) * 0.5 * (interpolate(values, begin_s) + interpolate(values, t_s))
            }
        }
    }
}

/// The sampling frequency changes with run time: its relative change `Σ c_k u^k` with u the time over the length of the run, k up to the
/// degree. Parameters c_1.. in 1e-6.
#[derive(Clone, Debug)]
struct InTime(usize);

impl SineTerm for InTime {
    fn kind(&self) -> &'static str {
        IN_TIME
    }

    fn form(&self) -> String {
        format!("{IN_TIME}{}", self.0)
    }

    fn count(&self) -> usize {
        self.0
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, _i: usize, to: &mut Triple) {
        let f = run.settings[j].frequency_hz;
        let (length, u) = (run.length_s, run.settings[j].middle_s / run.length_s);
        for (k, c) in p.iter().take(self.0).enumerate() {
            let power = (k + 1) as i32;
            to[1] -= TAU * f * 1e-6 * c * length * u.powi(power + 1) / f64::from(power + 1);
            to[2] -= TAU * f * 1e-6 * c * u.powi(power);
        }
    }

    fn report(
        &self,
        run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        _correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        let parameter = |(k, c): (usize, &f64)| {
            let size = run.rate_hz * 1e-6 / run.length_s.powi(k as i32 + 1);
            let unit = if k == 0 { "Hz/s".to_owned() } else { format!("Hz/s^{}", k + 1) };
            SineParameter::new(&format!("drift_{}", k + 1), c * size, std(k).map(|s| s * size), &unit)
        };
        (Spec::new(&self.form(), &self.axes()), p.iter().enumerate().map(parameter).collect())
    }

    fn limit(&self, run: &SineRun, least: f64, _hz: f64) -> String {
        format!("drift = {} Hz/s", three_digits(least * 1e-6 * run.rate_hz / run.length_s))
    }
}

/// The sampling frequency changes with the temperature of a channel. Parameter in 1e-6/K.
#[derive(Clone, Debug)]
struct WithTemperature {
    channel: String,
    /// Deviation of the temperature from its mean, K, and its integral, K s, at the middle of every setting.
    values: Vec<[f64; 2]>,
}

impl WithTemperature {
    fn new(run: &SineRun, name: &str) -> Option<Self> {
        let series = run.temperatures.channel(name)?;
        let (first, last) = (series.first()?.0, series.last()?.0);
        if series.len() < LEAST_READINGS || last <= first {
            return None;
        }
        let clock = Clock::proportional(&series, 1.0);
        let values = run.settings.iter().map(|s| [clock.at(s.middle_s), clock.lead_s(s.middle_s)]).collect();
        Some(Self { channel: name.to_owned(), values })
    }
}

impl SineTerm for WithTemperature {
    fn kind(&self) -> &'static str {
        WITH_TEMPERATURE
    }

    fn form(&self) -> String {
        format!("{WITH_TEMPERATURE}{}", self.channel)
    }

    fn add(&self, p: &[f64], run: &SineRun, j: usize, _i: usize, to: &mut Triple) {
        let f = run.settings[j].frequency_hz;
        let [now, integral] = self.values[j];
        to[1] -= TAU * f * 1e-6 * p[0] * integral;
        to[2] -= TAU * f * 1e-6 * p[0] * now;
    }

    /// The limit of a drift in time is told.
    fn has_limit(&self) -> bool {
        false
    }

    fn report(
        &self,
        run: &SineRun,
        p: &[f64],
        std: &dyn Fn(usize) -> Option<f64>,
        _correlation: &dyn Fn(usize, usize) -> Option<f64>,
    ) -> (Spec, Vec<SineParameter>) {
        let size = 1e-6 * run.rate_hz;
        let drift = SineParameter::new("drift", p[0] * size, std(0).map(|s| s * size), "Hz/K");
        (Spec::new(&self.form(), &self.axes()), vec![drift])
    }

    fn limit(&self, run: &SineRun, least: f64, _hz: f64) -> String {
        format!("drift = {} Hz/K", three_digits(least * 1e-6 * run.rate_hz))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_integral_of_a_polynomial_is_its_closed_form() {
        let clock = Clock::Polynomial(vec![2e-9, -3e-13]);
        let t: f64 = 1234.5;
        assert!((clock.at(t) - (2e-9 * t - 3e-13 * t * t)).abs() < 1e-18);
        assert!((clock.lead_s(t) - (1e-9 * t * t - 1e-13 * t.powi(3))).abs() < 1e-15);
    }

    #[test]
    fn the_integral_of_a_temperature_that_rises_steadily_is_a_parabola() {
        // T - T_mean = 0.01 (t - 1000) K, known from 100 s on, 2e-8 per K.
        let series: Vec<(f64, f64)> = (0..=18).map(|i| 100.0 + 100.0 * f64::from(i)).map(|t| (t, 20.0 + 0.01 * t)).collect();
        let clock = Clock::proportional(&series, 2e-8);
        assert!((clock.at(1450.0) - 2e-8 * 4.5).abs() < 1e-16);
        let lead = |t: f64| 2e-10 * (0.5 * t * t - 1000.0 * t);
        // Before the first reading the first one holds: 100 s at -9 K instead of -9 to -10 K.
        let begin = -9.0 * 2e-8 * 100.0;
        for t in [100.0, 512.0, 1900.0] {
            assert!((clock.lead_s(t) - (begin + lead(t) - lead(100.0))).abs() < 1e-14, "{t}");
        }
    }
}
