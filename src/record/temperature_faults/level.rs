//! Temperature channels in another unit, and those that disagree with their neighbour.

use super::channel::Channel;
use super::{AGREEMENT_K, ChannelFault, Fault, is_neighbour};
use crate::data::run::interpolate;
use crate::fit::statistics::{median, two_sided_tail};

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

impl Channel<'_> {
    pub(super) fn unit(&self, others: &[&Channel], in_room: bool) -> Option<ChannelFault> {
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

    /// Whether this channel of a room and that of the sensor were exchanged.
    pub(super) fn exchanged(&self, sensor: &Channel) -> Option<ChannelFault> {
        let of_a_room = |degc: f64| two_sided_tail((degc - ROOM_DEGC[0]).abs() / ROOM_DEGC[1]);
        let other = (sensor.name.to_owned(), sensor.median);
        // What no instrument has is no exchange but a channel that reads nothing.
        let is_a_temperature = two_sided_tail((self.median - INSTRUMENT_DEGC[0]).abs() / INSTRUMENT_DEGC[1]) > SENSIBLE;
        let is_so = is_a_temperature && of_a_room(self.median) < LEAST_AGREEMENT && of_a_room(sensor.median) > SENSIBLE;
        is_so.then(|| self.fault(Fault::Exchanged { read: self.median, other }, of_a_room(self.median)))
    }

    pub(super) fn apart(&self, others: &[&Channel]) -> Option<ChannelFault> {
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
}
