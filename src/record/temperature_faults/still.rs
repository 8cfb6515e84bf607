//! Temperature channels that stand still.

use super::channel::{Channel, GAP};
use super::{AGREEMENT_K, ChannelFault, Fault, faults, is_neighbour};
use crate::data::run::{Run, SlowTable};
use crate::fit::statistics::{extremes, robust_std, two_sided_tail};
use crate::model::campaign::Instructions;

/// Equal readings one after the other that noise makes less often than this stand still.
const LEAST_PROBABILITY: f64 = 1e-9;
/// Noise of so many last digits shows that equal readings are no rounding.
const DIGITS: f64 = 2.0;
/// Fewer readings do not tell that a channel has no scatter at all.
const LEAST_STILL: usize = 20;
/// The same of a channel beside which none scatters.
const LEAST_ALONE: usize = 60;
/// While a channel stands still its neighbour moves by this much, K.
const NEIGHBOUR_MOVED_K: f64 = 3.0;

/// A channel that stands still for a part of the run: begin and end, s since the run's start.
pub struct Still {
    /// The channel.
    pub channel: String,
    /// Its last true reading, and the last that repeats it.
    pub time_s: [f64; 2],
}

impl Channel<'_> {
    pub(super) fn stands_still(&self, others: &[&Channel]) -> Option<ChannelFault> {
        // The longest stretch of equal readings without a gap.
        let longest_s = GAP * self.interval_s;
        let (mut best, mut from) = (0..1, 0);
        for i in 1..=self.series.len() {
            let goes_on = i < self.series.len()
                && self.series[i].1 == self.series[i - 1].1
                && self.series[i].0 - self.series[i - 1].0 <= longest_s;
            if !goes_on {
                if i - from > best.len() {
                    best = from..i;
                }
                from = i;
            }
        }
        let (first, last) = (self.series[best.start], self.series[best.end - 1]);
        let time_s = [first.0, last.0];
        let moved = |other: &&Channel| {
            let [low, high] = extremes(other.series.iter().filter(|(t, _)| (time_s[0]..=time_s[1]).contains(t)).map(|(_, v)| *v));
            (other.name.to_owned(), high - low)
        };
        let neighbours = others.iter().filter(|o| best.len() >= LEAST_STILL && is_neighbour(self.name, o.name));
        if let Some(neighbour) = neighbours.map(moved).find(|(_, moved_k)| *moved_k >= NEIGHBOUR_MOVED_K) {
            let probability = two_sided_tail(neighbour.1 / AGREEMENT_K);
            return Some(self.fault(Fault::StandsStill { time_s, degc: first.1, neighbour: Some(neighbour) }, probability));
        }
        if let (true, Some(probability)) = (best.len() == self.series.len(), self.still_beside(others)) {
            return Some(self.fault(Fault::StandsStill { time_s, degc: first.1, neighbour: None }, probability));
        }
        // A channel without any scatter, which nothing else tells of: were it that of the last digit, two in a row would be equal as often as below.
        // One that is read to a tenth of a kelvin may rest.
        let is_of_tenths = (10.0 * first.1 - (10.0 * first.1).round()).abs() < 1e-3;
        if best.len() == self.series.len() && best.len() >= LEAST_ALONE && !is_of_tenths {
            let probability = (2.0 * std::f64::consts::PI.sqrt()).recip().powf((best.len() - 1) as f64);
            return Some(self.fault(Fault::StandsStill { time_s, degc: first.1, neighbour: None }, probability));
        }
        // What the readings scatter by elsewhere, against their last digit: two in a row are equal by chance with digit / (2 s sqrt(pi)).
        let elsewhere: Vec<&[(f64, f64)]> = self
            .series
            .windows(3)
            .enumerate()
            .filter(|(i, w)| (i + 2 < best.start || *i >= best.end) && w[2].0 - w[0].0 <= 2.0 * longest_s)
            .map(|(_, w)| w)
            .collect();
        if elsewhere.len() < LEAST_STILL {
            return None;
        }
        let digit = elsewhere.iter().map(|w| (w[1].1 - w[0].1).abs()).filter(|d| *d > 1e-9).fold(f64::INFINITY, f64::min);
        let bends: Vec<f64> = elsewhere.iter().map(|w| w[2].1 - 2.0 * w[1].1 + w[0].1).collect();
        // Noise bends to and fro, a course that is curved does not: two neighbouring bends of white noise have other signs in three of four.
        let turns = bends.windows(2).filter(|pair| pair[0] * pair[1] < 0.0).count();
        let noise_k = robust_std(bends.iter().copied()) / 6f64.sqrt();
        if !digit.is_finite() || noise_k < DIGITS * digit || 2 * turns < bends.len() {
            return None;
        }
        let equal = digit / (2.0 * noise_k * std::f64::consts::PI.sqrt());
        let probability = self.series.len() as f64 * equal.powf((best.len() - 1) as f64);
        (probability < LEAST_PROBABILITY)
            .then(|| self.fault(Fault::StandsStill { time_s, degc: first.1, neighbour: None }, probability))
    }

    /// Probability that all readings are equal where they scatter like those of the other channel that repeats itself most; none if that
    /// is no wonder.
    fn still_beside(&self, others: &[&Channel]) -> Option<f64> {
        let pairs = self.series.len() - 1;
        let repeats = |other: &&&Channel| {
            let equal = other.series.windows(2).filter(|w| w[0].1 == w[1].1).count();
            (equal + 1) as f64 / other.series.len() as f64
        };
        let enough = others.iter().filter(|o| o.series.len() >= LEAST_STILL && pairs >= LEAST_STILL);
        let most = enough.map(|o| repeats(&o)).max_by(f64::total_cmp)?;
        Some(most.min(1.0).powf(pairs as f64)).filter(|p| *p < LEAST_PROBABILITY)
    }
}

/// Temperature channels that stand still for a part of the run, and the temperatures without the readings that are repeated there: they say
/// nothing.
#[must_use]
pub fn without_still(run: &Run, instructions: &Instructions) -> (Vec<Still>, SlowTable) {
    let mut table = run.temperatures.clone();
    let mut all = Vec::new();
    for ChannelFault { channel, fault, .. } in faults(run, instructions) {
        let Fault::StandsStill { time_s, .. } = fault else { continue };
        let Some(values) = table.names.iter().position(|name| *name == channel).and_then(|at| table.values.get_mut(at)) else {
            continue;
        };
        let is_repeated = |t_s: f64| t_s > time_s[0] && t_s <= time_s[1];
        if !table.t_s.iter().zip(&*values).any(|(t, v)| v.is_finite() && !is_repeated(*t) && *t != time_s[0]) {
            // All of it stands still: nothing better is known.
            continue;
        }
        table.t_s.iter().zip(values).filter(|(t, _)| is_repeated(**t)).for_each(|(_, value)| *value = f64::NAN);
        all.push(Still { channel, time_s });
    }
    (all, table)
}
