//! Faults of temperature channels, of all that a run holds and not only of those in use: jumps, readings that stand still, other units,
//! disagreement with a neighbour. All is judged in time: what happens while nothing was recorded is no fault.

mod channel;
mod jumps;
mod level;
mod still;

pub use jumps::{Jumps, jumps_of, largest_jump_s, left_out_text, may_jump, off_level, readings, small_jump, without_jumps};
pub use still::{Still, without_still};

use crate::data::note::{Note, NoteKind};
use crate::data::run::Run;
use crate::model::campaign::Instructions;
use channel::Channel;

/// Temperatures outside are no temperatures of a sensor or coil.
pub const PLAUSIBLE_DEGC: std::ops::RangeInclusive<f64> = -200.0..=200.0;

/// Standard deviation of the difference of two thermistors of one body, K: uncalibrated ones of the campaign of 2013 differ by up to 1.5 K.
const AGREEMENT_K: f64 = 1.5;

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
    /// A channel of a room that reads no temperature of one, while a channel of the sensor does.
    Exchanged {
        /// Median of the readings, °C.
        read: f64,
        /// The channel of the sensor, and the median of its readings, °C.
        other: (String, f64),
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
            Fault::Exchanged { read, other: (other, degc) } => format!(
                "temperature channel {channel} of a room reads {read:.1} °C and {other} {degc:.1} °C, as if the two were exchanged (probability \
                 of such a room {chance})"
            ),
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
    let (sensor, _) = instructions.channels(&run.header);
    let channels = Channel::all(table);
    let mut found: Vec<ChannelFault> = Vec::new();
    for channel in &channels {
        let others: Vec<&Channel> = channels.iter().filter(|c| c.name != channel.name).collect();
        let in_room = rooms.iter().any(|room| room == channel.name);
        let of_sensor: Option<&&Channel> = others.iter().find(|o| in_room && o.name == sensor);
        let exchanged = || of_sensor.and_then(|of_sensor| channel.exchanged(of_sensor));
        found.extend(channel.unit(&others, in_room).or_else(exchanged).or_else(|| channel.apart(&others)));
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
                    ", without the jumps within the settings and as if right at the first level with more than a few readings"
                }
                _ => "",
            };
            let kind = if rests.is_empty() { NoteKind::Temperature } else { NoteKind::TemperatureFault };
            Note::new(kind, fault.text() + rests + mended).about(name.as_str()).with_remedy(remedy)
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
