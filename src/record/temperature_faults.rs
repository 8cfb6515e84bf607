//! Faults of temperature channels, of all that a run holds and not only of those in use: jumps, readings that stand still, other units,
//! disagreement with a neighbour. All is judged in time: what happens while nothing was recorded is no fault.

use crate::data::note::{Note, NoteKind};
use crate::data::run::{Run, SlowTable, interpolate};
use crate::fit::statistics::{extremes, median, two_sided_tail};
use crate::model::campaign::Instructions;
use nalgebra::DMatrix;

/// A jump of this many times the usual size of such steps, in standard deviations.
const JUMP: f64 = 9.0;
/// Smallest jump, K.
const LEAST_JUMP_K: f64 = 0.3;
/// Readings on both sides.
const SIDES: usize = 6;

/// Most jumps of one channel.
const MOST_JUMPS: usize = 6;

/// An interval between readings of this many usual ones is a gap.
const GAP: f64 = 3.0;
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
/// Another channel that moves by this part of it at the same time shows that the step is real.
const SHARED: f64 = 0.3;
/// Equal readings one after the other that noise makes less often than this stand still.
const LEAST_PROBABILITY: f64 = 1e-9;
/// Noise of so many last digits shows that equal readings are no rounding.
const DIGITS: f64 = 2.0;
/// Fewer readings do not tell that a channel has no scatter at all.
const LEAST_STILL: usize = 20;
/// While a channel stands still its neighbour moves by this much, K.
const NEIGHBOUR_MOVED_K: f64 = 3.0;
/// Standard deviation of the difference of two thermistors of one body, K: uncalibrated ones of the campaign of 2013 differ by up to 1.5 K.
const AGREEMENT_K: f64 = 1.5;
/// One may follow the other so much later, s.
const LATER_S: f64 = 120.0;
/// Neighbours that agree as little as this by chance do not, two-sided.
const LEAST_AGREEMENT: f64 = 1e-6;
/// Zero of the Celsius scale in kelvin.
const KELVIN: f64 = 273.15;
/// Readings above are no °C of an instrument: mean and standard deviation of what instruments are brought to, from -71 to 180 °C.
const INSTRUMENT_DEGC: [f64; 2] = [20.0, 70.0];
/// The same of coil systems and racks, which stand in a room.
const ROOM_DEGC: [f64; 2] = [20.0, 6.0];
/// Readings above this are no °C whatever the instrument.
const LEAST_KELVIN: f64 = 200.0;
/// A reading in another unit makes sense if it is no rarer than this.
const SENSIBLE: f64 = 1e-3;

/// A temperature channel that jumps.
#[derive(Clone, Debug, PartialEq)]
pub struct Jumps {
    /// The channel.
    pub channel: String,
    /// Every jump, the largest first: time, s since the run's start, and size, K.
    pub jumps: Vec<(f64, f64)>,
    /// Readings of the channel.
    pub readings: usize,
    /// Probability that noise of the channel makes the largest one.
    pub probability: f64,
}

impl Jumps {
    /// The largest jump in units of the smallest that counts.
    #[must_use]
    pub fn strength(&self) -> f64 {
        self.jumps[0].1.abs() / LEAST_JUMP_K
    }

    /// Takes the jumps before a time, s, off a reading, °C.
    fn take_off(&self, t_s: f64, value: &mut f64) {
        self.jumps.iter().filter(|(at_s, _)| t_s >= *at_s).for_each(|(_, size)| *value -= size);
    }
}

/// What is wrong with a temperature channel.
#[derive(Clone, Debug, PartialEq)]
pub enum Fault {
    /// Steps between neighbouring readings that are impossible at the rate at which it moves otherwise.
    Jumps {
        /// Number of jumps.
        count: usize,
        /// Time of the largest one, s since the run's start.
        t_s: f64,
        /// Its size, K.
        size_k: f64,
    },
    /// Equal readings one after the other.
    StandsStill {
        /// Begin and end, s since the run's start.
        time_s: [f64; 2],
        /// The reading, °C.
        degc: f64,
        /// A channel of the same body that moves meanwhile, and by how much, K.
        neighbour: Option<(String, f64)>,
    },
    /// Readings that make sense in another unit.
    Unit {
        /// The unit.
        unit: &'static str,
        /// Median of the readings as they are.
        read: f64,
        /// The same in °C if it has this unit.
        degc: f64,
    },
    /// Another temperature than a channel of the same body.
    Apart {
        /// That channel.
        neighbour: String,
        /// Median difference, K.
        by_k: f64,
        /// Whether other channels tell which of the two is wrong.
        decided: bool,
    },
}

/// A fault of a temperature channel.
#[derive(Clone, Debug, PartialEq)]
pub struct ChannelFault {
    /// The channel.
    pub channel: String,
    /// What is wrong.
    pub fault: Fault,
    /// Probability that noise or an honest difference of two thermistors looks like this.
    pub probability: f64,
}

impl ChannelFault {
    /// What is the case, in words.
    #[must_use]
    pub fn text(&self) -> String {
        let channel = &self.channel;
        let chance = match self.probability {
            p if p < 1e-12 => "below 1e-12".to_owned(),
            p => format!("{p:.0e}"),
        };
        match &self.fault {
            Fault::Jumps { count, t_s, size_k } => {
                let times = if *count == 1 { "once".to_owned() } else { format!("{count} times, most") };
                format!(
                    "temperature channel {channel} jumps {times} by {size_k:+.1} K at {t_s:.0} s (probability of noise {chance})"
                )
            }
            Fault::StandsStill { time_s: [from, until], degc, neighbour: None } => format!(
                "temperature channel {channel} stands still at {degc} °C from {from:.0} to {until:.0} s (probability of noise {chance})"
            ),
            Fault::StandsStill { time_s: [from, until], degc, neighbour: Some((other, moved_k)) } => format!(
                "temperature channel {channel} stands still at {degc} °C from {from:.0} to {until:.0} s while {other} moves by {moved_k:.1} K \
                 (probability of noise {chance})"
            ),
            Fault::Unit { unit, read, degc } => {
                format!(
                    "temperature channel {channel} reads {read:.1}, as if in {unit}: {degc:.1} °C (probability that it is in °C {chance})"
                )
            }
            Fault::Apart { neighbour, by_k, decided } => {
                let which = if *decided { "" } else { "; which of the two is wrong is not known" };
                format!(
                    "temperature channel {channel} differs from {neighbour} by {by_k:+.1} K (probability for two thermistors of one body \
                     {chance}){which}"
                )
            }
        }
    }
}

/// The faults of all temperature channels of a run.
#[must_use]
pub fn faults(run: &Run, instructions: &Instructions) -> Vec<ChannelFault> {
    let table = &run.temperatures;
    let rooms = rooms(run, instructions);
    let channels: Vec<Channel> = table.names.iter().filter_map(|name| Channel::of(table, name)).collect();
    let mut found: Vec<ChannelFault> = Vec::new();
    for channel in &channels {
        let others: Vec<&Channel> = channels.iter().filter(|c| c.name != channel.name).collect();
        let in_room = rooms.iter().any(|room| room == channel.name);
        found.extend(channel.unit(&others, in_room).or_else(|| channel.apart(&others)));
        found.extend(channel.jumps(&others));
        found.extend(channel.stands_still(&others));
    }
    found
}

/// The channels of coil system and rack, which stand in a room.
fn rooms(run: &Run, instructions: &Instructions) -> Vec<String> {
    let mut rooms = instructions.coil_channels(&run.header).to_vec();
    rooms.extend([instructions.channels(&run.header).1, instructions.rack_channel().to_owned()]);
    rooms
}

/// Notes on the faults of all temperature channels of a run, with what rests on the channel and which others could serve.
#[must_use]
pub fn notes(run: &Run, instructions: &Instructions) -> Vec<Note> {
    told(run, instructions).into_iter().map(|(_, note)| note).collect()
}

/// The faults of all temperature channels of a run, each with the note on it.
#[must_use]
pub fn told(run: &Run, instructions: &Instructions) -> Vec<(ChannelFault, Note)> {
    let found = faults(run, instructions);
    let (sensor, _) = instructions.channels(&run.header);
    let rack = instructions.rack_channel();
    let rooms = rooms(run, instructions);
    let is_used = |name: &str| name == sensor || rooms.iter().any(|room| room == name);
    let is_sound = |name: &&String| found.iter().all(|f| f.channel != **name) && !is_used(name);
    let notes: Vec<Note> = found
        .iter()
        .map(|fault| {
            let name = &fault.channel;
            let rests = if *name == sensor {
                "; the sensor temperature of the result rests on it"
            } else if name == rack {
                "; the rack temperature rests on it"
            } else if rooms.contains(name) {
                "; the coil temperature of the result rests on it"
            } else {
                ""
            };
            let neighbours: Vec<&str> = run
                .temperatures
                .names
                .iter()
                .filter(is_sound)
                .filter(|other| is_neighbour(name, other))
                .map(String::as_str)
                .collect();
            let others: Vec<&str> = run.temperatures.names.iter().filter(is_sound).map(String::as_str).collect();
            let remedy = match (rests.is_empty(), neighbours.as_slice(), others.as_slice()) {
                (true, ..) => "do not use it".to_owned(),
                (false, [], []) => "the run has no other channel for it: do not use the temperature".to_owned(),
                (false, [], others) => {
                    format!("name another channel in campaign.toml if it saw the same body: {}", others.join(", "))
                }
                (false, neighbours, _) => format!("name its neighbour in campaign.toml: {}", neighbours.join(", ")),
            };
            let mended = match &fault.fault {
                Fault::Jumps { .. } if !rests.is_empty() => {
                    ", without the jumps within the settings and as if right before the first one"
                }
                _ => "",
            };
            Note::new(NoteKind::Temperature, fault.text() + rests + mended).about(name.as_str()).with_remedy(remedy)
        })
        .collect();
    found.into_iter().zip(notes).collect()
}

/// Whether two channels are thermistors of one body by their names, which differ in the last digit only: T_OB-1 and T_OB-2.
fn is_neighbour(a: &str, b: &str) -> bool {
    let stem = |name: &str| -> Option<String> {
        let stem = name.strip_suffix(|c: char| c.is_ascii_digit())?;
        let letters = stem.chars().filter(char::is_ascii_alphabetic).count();
        (letters >= 2 && stem.ends_with(['-', '_', '.', ' '])).then(|| stem.to_owned())
    };
    a != b && stem(a).is_some_and(|stem_a| stem(b).is_some_and(|stem_b| stem_a == stem_b))
}

/// A channel with its readings.
struct Channel<'a> {
    name: &'a str,
    series: Vec<(f64, f64)>,
    interval_s: f64,
    median: f64,
}

impl<'a> Channel<'a> {
    /// `None` if it has too few readings to be judged.
    fn of(table: &SlowTable, name: &'a str) -> Option<Self> {
        const LEAST_READINGS: usize = 4;
        let series = table.channel(name).filter(|s| s.len() >= LEAST_READINGS)?;
        let interval_s = usual_interval_s(&series);
        let median = median(&mut series.iter().map(|(_, v)| *v).collect::<Vec<f64>>());
        Some(Self { name, series, interval_s, median })
    }

    fn fault(&self, fault: Fault, probability: f64) -> ChannelFault {
        ChannelFault { channel: self.name.to_owned(), fault, probability: probability.min(1.0) }
    }

    /// Changes between readings that follow each other: place of the second one, size, K, and size per usual interval.
    fn changes(&self) -> Vec<(usize, f64, f64)> {
        let longest_s = GAP * self.interval_s;
        let pairs = self.series.windows(2).enumerate();
        pairs
            .map(|(i, w)| (i + 1, w[1].1 - w[0].1, w[1].0 - w[0].0))
            .filter(|(_, _, dt_s)| *dt_s > 0.0 && *dt_s <= longest_s)
            .map(|(place, by_k, dt_s)| (place, by_k, by_k * self.interval_s / dt_s))
            .collect()
    }

    /// Standard deviation of the changes from reading to reading by noise, K: from what they differ by from the usual one, or from those beside
    /// them where the channel rises and falls. Of white noise the latter has 5/2 of their variance.
    fn noise_of_changes_k(&self, changes: &[(usize, f64, f64)]) -> f64 {
        let usual = median(&mut changes.iter().map(|(_, _, rate)| *rate).collect::<Vec<f64>>());
        let deviation = |off: &mut Vec<f64>| if off.is_empty() { f64::INFINITY } else { 1.4826 * median(off) };
        let about = deviation(&mut changes.iter().map(|(_, _, rate)| (rate - usual).abs()).collect());
        let beside = changes.windows(3).map(|w| (w[1].2 - 0.5 * (w[0].2 + w[2].2)).abs());
        about.min(deviation(&mut beside.collect()) / 2.5f64.sqrt())
    }

    fn jumps(&self, others: &[&Channel]) -> Option<ChannelFault> {
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
        if let Some((t_s, _)) = step(&self.series) {
            // A smaller step that stands alone.
            let alone = changes.iter().position(|(place, ..)| self.series[*place].0 == t_s);
            places.extend(alone.filter(|i| !places.contains(i)));
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

    fn stands_still(&self, others: &[&Channel]) -> Option<ChannelFault> {
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
        let noise_k = 1.4826 * median(&mut bends.iter().map(|b| b.abs()).collect::<Vec<f64>>()) / 6f64.sqrt();
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

    fn unit(&self, others: &[&Channel], in_room: bool) -> Option<ChannelFault> {
        let read = self.median;
        let is_of = |degc: f64, [mean, std]: [f64; 2]| two_sided_tail((degc - mean).abs() / std);
        let usual = if in_room { ROOM_DEGC } else { INSTRUMENT_DEGC };
        let from_kelvin = read - KELVIN;
        if read > LEAST_KELVIN && is_of(from_kelvin, usual) > SENSIBLE {
            return Some(self.fault(Fault::Unit { unit: "K", read, degc: from_kelvin }, is_of(read, usual)));
        }
        let from_fahrenheit = (read - 32.0) / 1.8;
        let fahrenheit = |probability| self.fault(Fault::Unit { unit: "°F", read, degc: from_fahrenheit }, probability);
        if in_room && is_of(read, ROOM_DEGC) < LEAST_AGREEMENT && is_of(from_fahrenheit, ROOM_DEGC) > SENSIBLE {
            return Some(fahrenheit(is_of(read, ROOM_DEGC)));
        }
        let like = |other: &Channel, degc: f64| is_of(degc, [other.median, AGREEMENT_K]);
        let agrees = |other: &&&Channel| {
            is_neighbour(self.name, other.name) && like(other, read) < LEAST_AGREEMENT && like(other, from_fahrenheit) > SENSIBLE
        };
        let other = others.iter().find(agrees)?;
        Some(fahrenheit(like(other, read)))
    }

    fn apart(&self, others: &[&Channel]) -> Option<ChannelFault> {
        let neighbour = others.iter().find(|o| is_neighbour(self.name, o.name))?;
        let rate_k_per_s = |channel: &Channel| {
            let changes = channel.changes();
            let mut rates: Vec<f64> = changes.iter().map(|(_, _, rate)| rate.abs() / channel.interval_s).collect();
            if rates.is_empty() { 0.0 } else { median(&mut rates) }
        };
        let mut differences: Vec<f64> = self.series.iter().map(|(t, v)| v - interpolate(&neighbour.series, *t)).collect();
        let by_k = median(&mut differences);
        let beyond_k = (by_k.abs() - LATER_S * rate_k_per_s(self).max(rate_k_per_s(neighbour))).max(0.0);
        let probability = two_sided_tail(beyond_k / AGREEMENT_K);
        if probability >= LEAST_AGREEMENT {
            return None;
        }
        // The one that stands farther from all others is the wrong one.
        let from_others = |channel: &Channel| {
            let away = |o: &&&Channel| !is_neighbour(self.name, o.name) && o.name != self.name;
            others.iter().filter(away).map(|o| (o.median - channel.median).abs()).fold(f64::INFINITY, f64::min)
        };
        let (own, its) = (from_others(self), from_others(neighbour));
        let decided = own.is_finite() && (own - its).abs() > AGREEMENT_K;
        if decided && own < its {
            return None;
        }
        Some(self.fault(Fault::Apart { neighbour: neighbour.name.to_owned(), by_k, decided }, probability))
    }

    /// The jumps between two times, s since the run's start; `None` where there is none.
    fn jumps_between(&self, all: &[Channel], span_s: [f64; 2]) -> Option<Jumps> {
        let others: Vec<&Channel> = all.iter().filter(|c| c.name != self.name).collect();
        let changes = self.changes();
        let places = self.places_of_jumps(&changes, &others);
        let sized = |i: &usize| {
            let place = changes[*i].0;
            let is_alone = places.iter().all(|other| other == i || changes[*other].0.abs_diff(place) > SIDES);
            let by_cubic = if is_alone { step_at(&self.series, place) } else { None };
            Some((self.series[place].0, by_cubic.or_else(|| far_faster_k(&changes, *i))?))
        };
        let mut jumps: Vec<(f64, f64)> = places.iter().filter_map(sized).collect();
        jumps.retain(|(t_s, _)| (span_s[0]..=span_s[1]).contains(t_s));
        jumps.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
        jumps.truncate(MOST_JUMPS);
        let (_, largest_k) = jumps.first().copied()?;
        let probability = self.probability_of(&changes, largest_k);
        Some(Jumps { channel: self.name.to_owned(), jumps, readings: self.series.len(), probability })
    }
}

/// By how much a change exceeds what the channel does in the same time before and after it, K, if that is far more. The last one of a record or
/// before a gap is not judged: a body that begins to be heated looks like it.
fn far_faster_k(changes: &[(usize, f64, f64)], i: usize) -> Option<f64> {
    let (place, by_k, rate) = changes[i];
    if changes.get(i + 1).is_none_or(|(next, ..)| next - place > 1) {
        return None;
    }
    let usual = |range: std::ops::Range<usize>| {
        let mut rates: Vec<f64> = changes[range].iter().map(|(_, _, rate)| *rate).collect();
        if rates.is_empty() { None } else { Some(median(&mut rates)) }
    };
    let after = usual(i + 1..changes.len().min(i + 1 + RATES))?;
    let before = usual(i.saturating_sub(RATES)..i).unwrap_or(0.0);
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

/// Median of the intervals between readings, s.
fn usual_interval_s(series: &[(f64, f64)]) -> f64 {
    let mut intervals: Vec<f64> = series.windows(2).map(|w| w[1].0 - w[0].0).collect();
    if intervals.is_empty() { 0.0 } else { median(&mut intervals) }
}

/// A channel that stands still for a part of the run: begin and end, s since the run's start.
pub struct Still {
    /// The channel.
    pub channel: String,
    /// Its last true reading, and the last that repeats it.
    pub time_s: [f64; 2],
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

/// Temperature channels that jump between two times (s since the run's start), and the temperatures without the jumps: a model that
/// believed them would need effects that do not exist.
#[must_use]
pub fn without_jumps(table: &SlowTable, span_s: [f64; 2]) -> (Vec<Jumps>, SlowTable) {
    let mut mended = table.clone();
    let mut found_in = Vec::new();
    let channels: Vec<Channel> = table.names.iter().filter_map(|name| Channel::of(table, name)).collect();
    for channel in &channels {
        let Some(found) = channel.jumps_between(&channels, span_s) else { continue };
        let index = table.names.iter().position(|name| name == channel.name).unwrap_or(0);
        mended.t_s.iter().zip(&mut mended.values[index]).for_each(|(t_s, value)| found.take_off(*t_s, value));
        found_in.push(found);
    }
    (found_in, mended)
}

/// The readings of a slow channel, (s since the run's start, °C), without the jumps between two times (s): what it read before the first one is
/// taken as right.
#[must_use]
pub fn readings(run: &Run, name: &str, span_s: [f64; 2]) -> Option<Vec<(f64, f64)>> {
    let mut series = run.slow_channel(name)?;
    let table = &run.temperatures;
    let channels: Vec<Channel> = table.names.iter().filter_map(|name| Channel::of(table, name)).collect();
    let found = channels.iter().find(|c| c.name == name).and_then(|own| own.jumps_between(&channels, span_s));
    if let Some(found) = found {
        series.iter_mut().for_each(|(t_s, value)| found.take_off(*t_s, value));
    }
    Some(series)
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

/// Time and size of the largest jump of a channel: a step beside a cubic over the readings around it, against what such steps are elsewhere.
fn step(series: &[(f64, f64)]) -> Option<(f64, f64)> {
    if series.len() < 4 * SIDES {
        return None;
    }
    let longest_s = GAP * usual_interval_s(series);
    let step = step_weights()?;
    let size = |w: &[(f64, f64)]| if follow(w, longest_s) { w.iter().zip(&step).map(|((_, v), c)| v * c).sum() } else { 0.0 };
    let sizes: Vec<f64> = series.windows(2 * SIDES).map(size).collect();
    let mut usual: Vec<f64> = sizes.iter().map(|s| s.abs()).collect();
    let usual = 1.4826 * median(&mut usual);
    let largest = (0..sizes.len()).max_by(|a, b| sizes[*a].abs().total_cmp(&sizes[*b].abs()))?;
    let size = sizes[largest];
    (size.abs() > LEAST_JUMP_K && size.abs() > JUMP * usual).then(|| (series[largest + SIDES].0, size))
}
