//! Jumps of temperature channels: where they are, how large, and the readings without them.

use super::channel::{Channel, GAP, usual_interval_s};
use super::{ChannelFault, Fault, PLAUSIBLE_DEGC};
use crate::data::run::{Run, SlowTable, interpolate};
use crate::fit::statistics::{median, robust_std, two_sided_tail};
use nalgebra::DMatrix;

/// A jump of this many times the usual size of such steps, in standard deviations.
const JUMP: f64 = 9.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides.
const SIDES: usize = 6;
/// Most jumps of one channel.
const MOST_JUMPS: usize = 6;
/// Readings on either side that say how fast a channel moves otherwise.
const RATES: usize = 5;
/// Readings on either side in which a body that takes up heat goes on.
const NEAR: usize = 2;
/// A channel that jumps again and again does so by this much at least, K: below, a step has to stand alone, see [`LEAST_JUMP_K`].
const LEAST_REPEATED_K: f64 = 1.0;
/// It changes by this many times what it does otherwise in the same time. A body that takes up heat with a time constant of half an interval
/// shows 86 % of a step in the first one and 12 % in the second: 7 times.
const FASTER: f64 = 8.0;
/// The course of a body is known to half of what its rate changes by from before to after; a jump exceeds it by this many times the whole.
const OF_COURSE: f64 = 4.0;
/// A change by noise is smaller than this many of its standard deviations.
const NOISES: f64 = 4.0;
/// A change of a channel that jumps is one of its level if it has this part of its smallest jump.
const LIKE: f64 = 0.7;
/// What happens in a gap is the course of the body up to so many times what it does otherwise.
const COURSE: f64 = 3.0;
/// Readings are written to this, K.
const RESOLUTION_K: f64 = 1e-3;
/// Another channel that moves by this part of it at the same time shows that the step is real.
const SHARED: f64 = 0.3;

/// A temperature channel that jumps.
#[derive(Clone, Debug, PartialEq)]
pub struct Jumps {
    /// The channel.
    pub channel: String,
    /// Every jump, the largest first: time, s since the run's start, and size, K.
    pub jumps: Vec<(f64, f64)>,
    /// The level, against that of before the first jump, that is taken as right, K: the first one on which more than a few readings are.
    pub usual_k: f64,
    /// Readings of the channel.
    pub readings: usize,
    /// Probability that noise of the channel makes the largest one.
    pub probability: f64,
    /// Standard deviation of its changes from reading to reading by noise, K.
    pub noise_k: f64,
}

impl Jumps {
    /// Signal to noise ratio of the largest jump.
    #[must_use]
    pub fn strength(&self) -> f64 {
        self.jumps[0].1.abs() / self.noise_k.max(RESOLUTION_K)
    }

    /// Puts a reading, °C, at a time, s, on the level that is taken as right.
    fn take_off(&self, t_s: f64, value: &mut f64) {
        *value += self.usual_k - level_k(&self.jumps, t_s);
    }

    /// Puts the readings of its channel in a table on the level that is taken as right.
    pub fn take_off_of(&self, table: &mut SlowTable) {
        if let Some(index) = table.names.iter().position(|name| *name == self.channel) {
            table.t_s.iter().zip(&mut table.values[index]).for_each(|(t_s, value)| self.take_off(*t_s, value));
        }
    }
}

/// The level of a channel at a time, s, against that of before the first of its jumps, K.
fn level_k(jumps: &[(f64, f64)], t_s: f64) -> f64 {
    jumps.iter().filter(|(at_s, _)| t_s >= *at_s).map(|(_, size_k)| size_k).sum()
}

/// The level that is taken as right, K: the first on which as many readings are as tell a level, or that of most.
fn usual_level_k(series: &[(f64, f64)], jumps: &[(f64, f64)]) -> f64 {
    let least_k = jumps.iter().map(|(_, size_k)| size_k.abs()).fold(f64::INFINITY, f64::min);
    let levels: Vec<f64> = series.iter().map(|(t_s, _)| level_k(jumps, *t_s)).collect();
    let count = |level: f64| levels.iter().filter(|other| (*other - level).abs() <= (1.0 - LIKE) * least_k).count();
    let stretches: Vec<(f64, usize)> = levels.chunk_by(|a, b| a == b).map(|stretch| (stretch[0], count(stretch[0]))).collect();
    let first = stretches.iter().find(|(_, count)| *count >= SIDES);
    first.or(stretches.iter().max_by_key(|(_, count)| *count)).map_or(0.0, |(level, _)| *level)
}

impl Channel<'_> {
    pub(super) fn jumps(&self, others: &[&Channel]) -> Option<ChannelFault> {
        let changes = self.changes();
        let jumps = self.places_of_jumps(&changes, others);
        let of = |i: usize| (self.series[changes[i].0].0, changes[i].1);
        let largest = jumps.iter().map(|i| of(*i)).max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()))?;
        let fault = Fault::Jumps { count: jumps.len(), t_s: largest.0, size_k: largest.1 };
        let over_k = jumps.iter().filter_map(|i| far_faster_k(&changes, *i)).fold(0.0, |most: f64, k| most.max(k.abs()));
        Some(self.fault(fault, self.probability_of(&changes, over_k)))
    }

    /// Probability that noise makes a change as large as this one anywhere.
    fn probability_of(&self, changes: &[(usize, f64, f64)], by_k: f64) -> f64 {
        let noise_k = self.noise_of_changes_k(changes);
        (changes.len() as f64 * if noise_k > 0.0 { two_sided_tail(by_k.abs() / noise_k) } else { 0.0 }).min(1.0)
    }

    /// The changes that are jumps.
    fn places_of_jumps(&self, changes: &[(usize, f64, f64)], others: &[&Channel]) -> Vec<usize> {
        if changes.is_empty() {
            return Vec::new();
        }
        let noise_k = self.noise_of_changes_k(changes);
        // What the course of the body does not make of it.
        let is_large = |i: &usize| {
            far_faster_k(changes, *i).is_some_and(|over_k| over_k.abs() > LEAST_REPEATED_K && over_k.abs() > JUMP * noise_k)
        };
        let mut places: Vec<usize> = (0..changes.len()).filter(is_large).collect();
        for t_s in steps(&self.series, LEAST_JUMP_K) {
            // A smaller step that stands alone, or there and back.
            let alone = changes.iter().position(|(place, ..)| self.series[*place].0 == t_s);
            places.extend(alone.filter(|i| !places.contains(i)));
        }
        for i in 0..changes.len() {
            // A single reading aside is two jumps, there and back; each of them shows the other.
            if aside_k(changes, i).is_some_and(|k| k.abs() > LEAST_JUMP_K && k.abs() > JUMP * noise_k) {
                places.extend([i, i + 1].into_iter().filter(|i| !places.contains(i)).collect::<Vec<usize>>());
            }
        }
        let is_shared = |i: usize, over_k: f64| {
            let [before_s, after_s] = [self.series[changes[i].0 - 1].0, self.series[changes[i].0].0];
            others.iter().any(|o| o.moves_along(before_s, after_s, over_k))
        };
        places.retain(|i| far_faster_k(changes, *i).is_some_and(|over_k| !is_shared(*i, over_k)));
        places
    }

    /// Whether it moves with a step of another channel, beyond what it does before and after.
    fn moves_along(&self, before_s: f64, after_s: f64, by_k: f64) -> bool {
        let at = |t_s: f64| interpolate(&self.series, t_s);
        let aside_s = RATES as f64 * self.interval_s;
        let beside = 0.5 * (at(before_s) - at(before_s - aside_s) + at(after_s + aside_s) - at(after_s)) / aside_s;
        let moved = at(after_s) - at(before_s) - beside * (after_s - before_s);
        moved * by_k.signum() >= SHARED * by_k.abs()
    }

    /// The jumps between two times, s since the run's start; `None` where there is none.
    fn jumps_between(&self, all: &[Channel], span_s: [f64; 2]) -> Option<Jumps> {
        let others: Vec<&Channel> = all.iter().filter(|c| c.name != self.name).collect();
        let changes = self.changes();
        let places = self.places_of_jumps(&changes, &others);
        let sized = |i: &usize| {
            let place = changes[*i].0;
            // There and back by the same, so that nothing of a single reading aside stays in those behind it.
            if let Some(k) = aside_k(&changes, *i) {
                return Some((self.series[place].0, k));
            }
            if let Some(k) = i.checked_sub(1).and_then(|before| aside_k(&changes, before)) {
                return Some((self.series[place].0, -k));
            }
            let is_alone = places.iter().all(|other| other == i || changes[*other].0.abs_diff(place) > SIDES);
            let by_cubic = if is_alone { step_at(&self.series, place) } else { None };
            Some((self.series[place].0, by_cubic.or_else(|| far_faster_k(&changes, *i))?))
        };
        self.found(&changes, places.iter().filter_map(sized), span_s)
    }

    /// Jumps (s, K) of which some are between two times, s since the run's start; `None` where none is.
    fn found(&self, changes: &[(usize, f64, f64)], jumps: impl Iterator<Item = (f64, f64)>, span_s: [f64; 2]) -> Option<Jumps> {
        let mut jumps: Vec<(f64, f64)> = jumps.filter(|(t_s, _)| (span_s[0]..=span_s[1]).contains(t_s)).collect();
        jumps.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        jumps.truncate(MOST_JUMPS);
        let (_, largest_k) = jumps.first().copied()?;
        let probability = self.probability_of(changes, largest_k);
        let usual_k = usual_level_k(&self.series, &jumps);
        let noise_k = self.noise_of_changes_k(changes);
        Some(Jumps { channel: self.name.to_owned(), jumps, usual_k, readings: self.series.len(), probability, noise_k })
    }
}

/// Temperature channels that jump between two times (s since the run's start), and the temperatures without the jumps: a model that
/// believed them would need effects that do not exist.
#[must_use]
pub fn without_jumps(table: &SlowTable, span_s: [f64; 2]) -> (Vec<Jumps>, SlowTable) {
    let mut mended = table.clone();
    let mut found_in = Vec::new();
    let channels = Channel::all(table);
    for channel in &channels {
        let Some(found) = channel.jumps_between(&channels, span_s) else { continue };
        found.take_off_of(&mut mended);
        found_in.push(found);
    }
    (found_in, mended)
}

/// The readings of a slow channel, (s since the run's start, °C), without those that are no temperatures of a sensor or coil and without the
/// jumps between two times (s): the first level on which more than a few readings are is taken as right.
#[must_use]
pub fn readings(run: &Run, name: &str, span_s: [f64; 2]) -> Option<Vec<(f64, f64)>> {
    let mut series = run.slow_channel(name)?;
    if let Some(found) = jumps_in(run, name, span_s) {
        series.iter_mut().for_each(|(t_s, value)| found.take_off(*t_s, value));
    }
    series.retain(|(_, degc)| PLAUSIBLE_DEGC.contains(degc));
    Some(series)
}

/// What is said of readings that are no temperatures of a sensor or coil, and were left out.
#[must_use]
pub fn left_out_text(count: usize, channel: &str) -> String {
    let [low, high] = [PLAUSIBLE_DEGC.start(), PLAUSIBLE_DEGC.end()];
    format!("{count} readings of channel {channel} outside {low} to {high} °C were left out")
}

/// The time of the first reading behind the largest of these jumps, s since the run's start.
#[must_use]
pub fn largest_jump_s(run: &Run, name: &str, span_s: [f64; 2]) -> Option<f64> {
    jumps_in(run, name, span_s)?.jumps.first().map(|(t_s, _)| *t_s)
}

/// The jumps of a slow channel between two times, s since the run's start, the largest first.
fn jumps_in(run: &Run, name: &str, span_s: [f64; 2]) -> Option<Jumps> {
    let table = &run.temperatures;
    let channels = Channel::all(table);
    channels.iter().find(|c| c.name == name)?.jumps_between(&channels, span_s)
}

/// A jump of a channel between two times, s since the run's start, that is too small to be believed by its readings alone; `None` where there is none.
/// A channel with a larger one is not looked at.
#[must_use]
pub fn small_jump(table: &SlowTable, name: &str, span_s: [f64; 2]) -> Option<Jumps> {
    let channels = Channel::all(table);
    let channel = channels.iter().find(|c| c.name == name)?;
    if channel.jumps_between(&channels, span_s).is_some() {
        return None;
    }
    let others: Vec<&Channel> = channels.iter().filter(|c| c.name != name).collect();
    let jump = |t_s: f64| {
        let place = channel.series.iter().position(|(at_s, _)| *at_s == t_s)?;
        let size_k = step_at(&channel.series, place)?;
        let is_shared = others.iter().any(|o| o.moves_along(channel.series[place - 1].0, t_s, size_k));
        (!is_shared).then_some((t_s, size_k))
    };
    channel.found(&channel.changes(), steps(&channel.series, 0.0).into_iter().filter_map(jump), span_s)
}

/// All jumps of the readings of one thermistor (s, °C), in order of time: the time of the first reading behind each, s, and its size, K. Across a
/// gap nothing is known.
#[must_use]
pub fn jumps_of(series: Vec<(f64, f64)>) -> Vec<(f64, f64)> {
    let (t_s, values) = series.into_iter().unzip();
    let table = SlowTable { names: vec![String::new()], t_s, values: vec![values] };
    let Some(channel) = Channel::of(&table, "") else { return Vec::new() };
    let changes = channel.changes();
    let mut places = channel.places_of_jumps(&changes, &[]);
    places.sort_unstable();
    places.into_iter().filter_map(|i| Some((channel.series[changes[i].0].0, far_faster_k(&changes, i)?))).collect()
}

/// Whether the readings of a thermistor (s, °C) leave room for a jump of a size, K, right before the one at a time, s: without it the change there
/// would be one of those between its rates before and after, to within noise and what the size is uncertain by, K. Where it turns, that is much; on a straight ramp next to nothing.
#[must_use]
pub fn may_jump(series: &[(f64, f64)], t_s: f64, [size_k, std_k]: [f64; 2]) -> bool {
    let (t, values) = series.iter().copied().unzip();
    let table = SlowTable { names: vec![String::new()], t_s: t, values: vec![values] };
    let Some(channel) = Channel::of(&table, "") else { return false };
    let changes = channel.changes();
    let Some(i) = changes.iter().position(|(place, ..)| channel.series[*place].0 == t_s) else { return false };
    let (place, by_k, _) = changes[i];
    let part = (channel.series[place].0 - channel.series[place - 1].0) / channel.interval_s;
    let [Some(before), Some(after)] = [usual(&changes, i.saturating_sub(RATES)..i), usual(&changes, i + 1..i + 1 + RATES)] else {
        return false;
    };
    let room = NOISES * channel.noise_of_changes_k(&changes).hypot(std_k / part);
    let course = (by_k - size_k) / part;
    (before.min(after) - room..=before.max(after) + room).contains(&course)
}

/// Median of some of the changes, K per usual interval.
fn usual(changes: &[(usize, f64, f64)], range: std::ops::Range<usize>) -> Option<f64> {
    let mut rates: Vec<f64> =
        changes[range.start..range.end.min(changes.len()).max(range.start)].iter().map(|(_, _, rate)| *rate).collect();
    if rates.is_empty() { None } else { Some(median(&mut rates)) }
}

/// Stretches in which the readings of one thermistor (s, °C) that jumps stand on another level than most of them: begin and end, s; without end
/// where it stays there. `jumps` are those of [`jumps_of`].
///
/// Once a channel is known to jump, every change of a like size is a change of its level, also the last one before a gap. After a gap it stands
/// on the level of before unless it changed by more than its course makes of the time.
#[must_use]
pub fn off_level(series: &[(f64, f64)], jumps: &[(f64, f64)]) -> Vec<(f64, Option<f64>)> {
    let Some(least_k) = jumps.iter().map(|(_, by_k)| by_k.abs()).reduce(f64::min) else { return Vec::new() };
    let (change_k, interval_s) = (LIKE * least_k, usual_interval_s(series));
    let steps = || series.windows(2).map(|w| (w[1].0 - w[0].0, w[1].1 - w[0].1));
    let follows = |dt_s: f64| dt_s <= GAP * interval_s;
    let (time_s, moved_k) = steps()
        .filter(|(dt_s, by_k)| follows(*dt_s) && by_k.abs() < change_k)
        .fold((0.0, 0.0), |(time_s, moved_k), (dt_s, by_k)| (time_s + dt_s, moved_k + by_k.abs()));
    let rate = if time_s > 0.0 { moved_k / time_s } else { 0.0 };
    // The levels with the readings on each, and level and first reading of every stretch.
    let mut levels: Vec<(f64, usize)> = vec![(0.0, 1)];
    let mut stretches: Vec<(usize, usize)> = vec![(0, 0)];
    let mut level = 0;
    for (at, (dt_s, by_k)) in steps().enumerate() {
        let most_k = if follows(dt_s) { change_k } else { change_k.max(COURSE * rate * dt_s) };
        if by_k.abs() >= most_k {
            let new_k = levels[level].0 + by_k;
            let known = levels.iter().position(|(own_k, _)| (own_k - new_k).abs() <= (1.0 - LIKE) * least_k);
            level = known.unwrap_or(levels.len());
            if known.is_none() {
                levels.push((new_k, 0));
            }
            stretches.push((level, at + 1));
        }
        levels[level].1 += 1;
    }
    let most = levels.iter().map(|(_, count)| *count).max();
    let usual = levels.iter().position(|(_, count)| Some(*count) == most);
    let mut off: Vec<(f64, Option<f64>)> = Vec::new();
    for (level, begin) in stretches {
        let (t_s, is_off) = (series[begin].0, Some(level) != usual);
        match off.last_mut().filter(|(_, end)| end.is_none()) {
            Some((_, end)) if !is_off => *end = Some(t_s),
            None if is_off => off.push((t_s, None)),
            _ => {}
        }
    }
    off
}

/// By how much a change exceeds what the channel does in the same time before and after it, K, if that is far more. The last one of a record or
/// before a gap is not judged: a body that begins to be heated looks like it.
fn far_faster_k(changes: &[(usize, f64, f64)], i: usize) -> Option<f64> {
    let (place, by_k, rate) = changes[i];
    if changes.get(i + 1).is_none_or(|(next, ..)| next - place > 1) {
        return None;
    }
    let after = usual(changes, i + 1..i + 1 + RATES)?;
    let before = usual(changes, i.saturating_sub(RATES)..i).unwrap_or(0.0);
    // What both sides have in common is the course of the body; where they differ nothing is known of it but that it changes.
    let (course, change) = (0.5 * (before + after), (before - after).abs());
    // A body that takes up heat goes on in the same direction, ever slower.
    let goes_on = changes[i.saturating_sub(NEAR)..changes.len().min(i + 1 + NEAR)]
        .iter()
        .filter(|(other, ..)| *other != place && other.abs_diff(place) <= NEAR)
        .filter(|(_, _, other)| (other - course) * (rate - course) > 0.0)
        .map(|(_, _, other)| (other - course).abs())
        .fold(0.0, f64::max);
    ((rate - course).abs() > (OF_COURSE * change).max(FASTER * goes_on)).then(|| by_k * (rate - course) / rate)
}

/// By how much the reading behind a change stands aside from its neighbours, K, where it alone does: the next change takes it back.
fn aside_k(changes: &[(usize, f64, f64)], i: usize) -> Option<f64> {
    let [(place, _, there), (next, _, back)] = *changes.get(i..i + 2)?.first_chunk()?;
    let (before, after) = (usual(changes, i.saturating_sub(RATES)..i)?, usual(changes, i + 2..i + 2 + RATES)?);
    let course = 0.5 * (before + after);
    let [there, back] = [there - course, back - course];
    let is_alone = next == place + 1 && (there + back).abs() <= (1.0 - LIKE) * there.abs().min(back.abs());
    (is_alone && there.abs() > OF_COURSE * (before - after).abs()).then_some(0.5 * (there - back))
}

/// Weights of the readings around a step that give its size beside a cubic.
fn step_weights() -> Option<Vec<f64>> {
    let design = DMatrix::from_fn(2 * SIDES, 5, |i, j| {
        let x = (i as f64 - SIDES as f64 + 0.5) / SIDES as f64;
        if j < 4 {
            x.powi(j as i32)
        } else if i < SIDES {
            -0.5
        } else {
            0.5
        }
    });
    let inverse = design.pseudo_inverse(1e-12).ok()?;
    Some(inverse.row(4).iter().copied().collect())
}

/// Whether readings follow each other in time: across a gap nothing is known of the way between two of them.
fn follow(readings: &[(f64, f64)], longest_s: f64) -> bool {
    readings.windows(2).all(|pair| pair[1].0 - pair[0].0 <= longest_s)
}

/// Size of a step before a reading, beside a cubic over the readings around it; `None` where they do not follow each other.
fn step_at(series: &[(f64, f64)], place: usize) -> Option<f64> {
    let window = series.get(place.checked_sub(SIDES)?..place + SIDES)?;
    let weights = step_weights()?;
    follow(window, GAP * usual_interval_s(series)).then(|| window.iter().zip(&weights).map(|((_, v), c)| v * c).sum())
}

/// Times of the largest jump of a channel and of the one that takes it back, if there is one: steps of this size, K, at least beside a cubic over
/// the readings around them, against what such steps are elsewhere.
fn steps(series: &[(f64, f64)], least_k: f64) -> Vec<f64> {
    let Some(weights) = step_weights().filter(|_| series.len() >= 4 * SIDES) else { return Vec::new() };
    let longest_s = GAP * usual_interval_s(series);
    let size = |w: &[(f64, f64)]| if follow(w, longest_s) { w.iter().zip(&weights).map(|((_, v), c)| v * c).sum() } else { 0.0 };
    let sizes: Vec<f64> = series.windows(2 * SIDES).map(size).collect();
    let usual = robust_std(sizes.iter().copied());
    let is_step = |at: &usize| sizes[*at].abs() > least_k && sizes[*at].abs() > JUMP * usual;
    let largest_of = |places: &mut dyn Iterator<Item = usize>| places.max_by(|a, b| sizes[*a].abs().total_cmp(&sizes[*b].abs()));
    let Some(largest) = largest_of(&mut (0..sizes.len())).filter(is_step) else { return Vec::new() };
    let takes_back = |at: &usize| {
        at.abs_diff(largest) > 2 * SIDES && (sizes[*at] + sizes[largest]).abs() <= (1.0 - LIKE) * sizes[largest].abs()
    };
    let back = largest_of(&mut (0..sizes.len()).filter(is_step).filter(takes_back));
    [Some(largest), back].into_iter().flatten().map(|at| series[at + SIDES].0).collect()
}
