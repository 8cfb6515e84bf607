//! Which vectors are telemetered when: packets of the modes, lost, repeated and swapped, with a reading of the thermistors each.

use super::thermistor::Thermistor;
use crate::data::time::{SECOND_NS, Tt2000, ns};
use crate::files::flight::mission::{Rate, Span};
use crate::files::twin::telemetry::{Course, TelemetryTwin};
use crate::simulate::noise::Random;

/// One row of telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Row {
    /// Time tag.
    pub tag: Tt2000,
    /// Corrected time, at which the field was measured.
    pub time: Tt2000,
    /// Index of the mode.
    pub mode: u8,
    /// Counts of the thermistors of both sensors.
    pub thermistor: [f64; 2],
    /// Quality bits of a bad vector; 0 for a good one.
    pub bad: u8,
    /// Whether the row repeats one before.
    pub repeated: bool,
}

/// Packets by what became of them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PacketCounts {
    /// Packets that arrived, each once.
    pub arrived: usize,
    /// Lost.
    pub lost: usize,
    /// Arrived twice.
    pub repeated: usize,
    /// Arrived behind the next one.
    pub swapped: usize,
}

/// The temperature at a time, °C.
#[must_use]
pub fn degc(course: &Course, start: Tt2000, time: Tt2000) -> f64 {
    let hours = hours(start, time);
    let phase = std::f64::consts::TAU * hours / course.period_h;
    course.start_degc + course.drift_k_per_h * hours + course.swing_k * phase.sin()
}

/// Hours from one time to another.
#[must_use]
pub fn hours(from: Tt2000, to: Tt2000) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "differences of times of days")]
    let hours = (to - from) as f64 / (3600.0 * SECOND_NS as f64);
    hours
}

/// The rows of a sensor in the order of the telemetry.
#[must_use]
pub fn rows(twin: &TelemetryTwin, sensor: usize, thermistors: &[Thermistor; 2], seed: u64) -> (Vec<Row>, PacketCounts) {
    let mut random = Random::new(seed, &["packets", &twin.sensors[sensor].name]);
    let mut counts = PacketCounts::default();
    let mut list: Vec<Packet> = Vec::new();
    for (span, index) in &twin.intervals {
        let mode = &twin.modes[*index];
        let Some(rate) = mode.rates[sensor] else { continue };
        let packet_ns = ns(mode.packet_s);
        let vectors = (rate.rate_hz * mode.packet_s).round().max(1.0) as u32;
        let mut begin = span.from;
        while begin + packet_ns <= span.to {
            let own = Span { from: begin, to: begin + packet_ns };
            begin = own.to;
            if twin.gaps.iter().any(|gap| gap.meets(&own)) {
                continue;
            }
            if random.uniform() < twin.packets.lost {
                counts.lost += 1;
                continue;
            }
            counts.arrived += 1;
            // One of the seven ways in which axes are bad.
            let mut bad = || if random.uniform() < twin.packets.bad_vectors { 1 + (random.uniform() * 7.0) as u8 } else { 0 };
            let bad: Vec<u8> = (0..vectors).map(|_| bad()).collect();
            let swapped = random.uniform() < twin.packets.swapped;
            list.push(Packet { begin: own.from, length_ns: packet_ns, mode: *index as u8, rate, bad, swapped });
        }
    }
    for index in 1..list.len() {
        if list[index - 1].swapped {
            counts.swapped += 1;
            list.swap(index - 1, index);
            list[index - 1].swapped = false;
            list[index].swapped = false;
        }
    }
    let mut out = Vec::new();
    for packet in list {
        packet.rows(twin, thermistors, &mut out);
        if random.uniform() < twin.packets.repeated {
            counts.repeated += 1;
            let first = out.len() - packet.bad.len();
            out.extend_from_within(first..);
            out[first + packet.bad.len()..].iter_mut().for_each(|row| row.repeated = true);
        }
    }
    (out, counts)
}

/// A packet that arrives.
struct Packet {
    begin: Tt2000,
    length_ns: i64,
    mode: u8,
    rate: Rate,
    /// Quality bits of its vectors.
    bad: Vec<u8>,
    /// Whether it arrives behind the next one.
    swapped: bool,
}

impl Packet {
    /// Its rows, behind others.
    fn rows(&self, twin: &TelemetryTwin, thermistors: &[Thermistor; 2], out: &mut Vec<Row>) {
        let read = |time: Tt2000| -> [f64; 2] {
            std::array::from_fn(|i| thermistors[i].count(degc(&twin.sensors[i].course, twin.span.from, time)))
        };
        // The thermistors are read in the middle of a packet.
        let packet = read(self.begin + self.length_ns / 2).map(f64::round);
        out.extend(self.bad.iter().zip(0_u32..).map(|(bad, k)| {
            let tag = self.begin + ns(f64::from(k) / self.rate.rate_hz);
            let time = tag + self.rate.shift_ns.unwrap_or(0);
            let thermistor = if twin.exact { read(time) } else { packet };
            Row { tag, time, mode: self.mode, thermistor, bad: *bad, repeated: false }
        }));
    }
}
