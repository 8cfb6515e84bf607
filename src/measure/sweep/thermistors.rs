//! Which thermistor the sensor follows, and with which lag.

use super::means::{LinearOrders, Means};
use super::refusal::{LEAST_RANGE_K, SweepError};
use crate::data::across::{LagForm, ThermistorLag};
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::Plateau;
use crate::data::run::{Run, interpolate};
use crate::fit::smooth::Course;
use crate::fit::statistics::{extent, slope};
use crate::fit::{Limits, polynomial};
use crate::model::lag::{self, Lag};
use crate::record::temperature_faults;

/// Longest lag that is looked for, s, and as a part of the sweep.
const MOST_LAG_S: f64 = 2400.0;
const MOST_LAG_PART: f64 = 0.125;
/// A lag below this many standard uncertainties is not significant.
pub(super) const SIGNIFICANT: f64 = 4.0;
/// Readings beside the first and the last one that tell its course, and the order of that.
const BESIDE: usize = 6;
const COURSE_ORDER: usize = 2;
/// Half of the time over which the rate of a thermistor is taken, s.
const RATE_S: f64 = 300.0;

/// Readings of a temperature channel, (s since the run's start, °C).
pub(super) type Series = Vec<(f64, f64)>;

/// The temperature channels that move during the settings, with their names, without jumps; that of the coil system is none of them.
pub(super) fn moving(run: &Run, coil: &str, used: &[&Plateau]) -> Result<Vec<(String, Series)>, SweepError> {
    let names = run.temperatures.names.iter().filter(|name| *name != coil);
    let span_s = [used.first().map_or(0.0, |p| p.used_s[0]), used.last().map_or(0.0, |p| p.used_s[1])];
    let channels: Vec<(String, Series)> = names
        .filter_map(|name| Some((name.clone(), temperature_faults::readings(run, name, span_s)?)))
        .filter(|(_, series)| extent(used.iter().map(|p| interpolate(series, p.t_s()))) > LEAST_RANGE_K)
        .collect();
    if channels.is_empty() { Err(SweepError::NoTemperature) } else { Ok(channels) }
}

/// How the sensor follows the thermistors by a linear model, and which of them its polynomials are of.
pub(super) struct Followed {
    /// The channels, as they were given.
    pub lags: Vec<ThermistorLag>,
    /// The one that the polynomials are of.
    pub chosen: usize,
}

impl Followed {
    /// The one that the campaign names, `own`, or the one that the sensor follows best.
    pub fn of(channels: &[(String, Series)], own: &str, means: &Means, orders: LinearOrders, notes: &mut Vec<Note>) -> Self {
        let lags: Vec<ThermistorLag> = channels.iter().map(|(name, series)| find_lag(name, series, means, orders)).collect();
        let least = lags.iter().min_by(|a, b| a.residual_std_ent.total_cmp(&b.residual_std_ent));
        let best = least.map_or_else(String::new, |lag| lag.channel.clone());
        let is_there = lags.iter().any(|lag| lag.channel == own);
        let channel = if is_there { own.to_owned() } else { best.clone() };
        if !is_there {
            let text = format!("the run has no moving channel {own}; {channel}, which the sensor follows best, is used");
            notes.push(Note::new(NoteKind::Temperature, text).about(own));
        } else if best != channel {
            let text = format!("the sensor follows {best} better than {channel}");
            notes.push(Note::new(NoteKind::Temperature, text).about(&channel));
        }
        let chosen = lags.iter().position(|lag| lag.channel == channel).unwrap_or_default();
        Self { lags, chosen }
    }
}

/// Delay and time constant with which the sensor follows a thermistor.
pub(super) fn find_lag(channel: &str, series: &[(f64, f64)], means: &Means, orders: LinearOrders) -> ThermistorLag {
    let course = Course::smooth(series);
    let deviance = |lag: Lag| means.deviance(&means.degc(&lag.of(&course)), orders);
    let none = deviance(Lag::Delay(0.0));
    let span_s = means.t_s.last().unwrap_or(&0.0) - means.t_s.first().unwrap_or(&0.0);
    let [delay, time_constant] = lag::search(MOST_LAG_S.min(MOST_LAG_PART * span_s), deviance);
    let (best, form) =
        if delay.deviance <= time_constant.deviance { (delay, LagForm::Delay) } else { (time_constant, LagForm::FirstOrder) };
    let gain = none - best.deviance;
    let is_significant = best.lag.seconds().abs() > SIGNIFICANT * best.std_s && gain > SIGNIFICANT * SIGNIFICANT;
    let left = if is_significant { best.deviance } else { none };
    ThermistorLag {
        channel: channel.to_owned(),
        form: if is_significant { form } else { LagForm::None },
        delay_s: delay.lag.seconds(),
        delay_std_s: delay.std_s,
        time_constant_s: time_constant.lag.signed_seconds(),
        time_constant_std_s: time_constant.std_s,
        gain,
        delay_over_first_order: time_constant.deviance - delay.deviance,
        // Geometric mean of the components.
        residual_std_ent: (0.5 * left / (3.0 * means.t_s.len() as f64)).exp(),
    }
}

/// The readings with the first and the last one on the course of those beside them, where that explains the readings of the sensor clearly better:
/// such a reading is wrong. One inside is told by its neighbours on both sides (`record::temperature_faults`); at an end a course that changes looks the same.
/// A lag moves nothing here, since the course that a right reading is put on is its own.
pub(super) fn without_wrong_ends(
    channel: &str,
    series: &[(f64, f64)],
    means: &Means,
    orders: LinearOrders,
    notes: &mut Vec<Note>,
) -> Option<Series> {
    if series.len() <= 2 * BESIDE {
        return None;
    }
    let deviance = |series: &[(f64, f64)]| means.deviance(&means.degc(&Course::smooth(series).series), orders);
    let (mut mended, mut without) = (series.to_vec(), deviance(series));
    let last = series.len() - 1;
    for (place, beside) in [(0, 1..=BESIDE), (last, last - BESIDE..=last - 1)] {
        let (t_s, read) = series[place];
        let (times_s, values): (Vec<f64>, Vec<f64>) = series[beside].iter().copied().unzip();
        let Ok(course) = polynomial::fit(&times_s, &values, None, COURSE_ORDER, &Limits::default()) else { continue };
        let course = course.evaluate(t_s).0;
        let mut one = mended.clone();
        one[place].1 = course;
        let with = deviance(&one);
        if without - with > SIGNIFICANT * SIGNIFICANT {
            let text = format!(
                "the reading of {channel} at {t_s:.0} s is {:+.2} K off the course of those beside it, and the sensor follows that course: it is taken \
                 from there",
                read - course
            );
            notes.push(
                Note::new(NoteKind::Temperature, text)
                    .about(channel)
                    .with_remedy("look at the first and last readings of the channel"),
            );
            (mended, without) = (one, with);
        }
    }
    (mended != series).then_some(mended)
}

/// Slope of the straight line through the readings around a time, K/s: how fast the temperature moves.
pub(super) fn rate_k_per_s(series: &[(f64, f64)], t_s: f64) -> f64 {
    let from = series.partition_point(|(t, _)| *t < t_s - RATE_S);
    let to = series.partition_point(|(t, _)| *t <= t_s + RATE_S);
    slope(&series[from..to])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_of_a_ramp_is_its_slope() {
        let ramp: Vec<(f64, f64)> = (0..400).map(|i| (30.0 * f64::from(i), 0.01 * 30.0 * f64::from(i))).collect();
        assert!((rate_k_per_s(&ramp, 5000.0) - 0.01).abs() < 1e-12);
        assert!(interpolate(&ramp, -5.0) == 0.0 && (interpolate(&ramp, 1e9) - 119.7).abs() < 1e-12);
    }
}
