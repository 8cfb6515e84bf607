//! A field with a heater whose times are known, for tests.

use super::{HeaterInterval, HeaterOn};
use crate::fit::random::Random;

pub const SECOND: i64 = 1_000_000_000;

/// The field of a heater that switches every 12 to 20 s, on a walk of 0.05 nT per second with noise of 0.03 nT, two vectors a second.
pub struct Switching {
    pub time: Vec<i64>,
    pub field_nt: [Vec<f64>; 3],
    /// The heater is on in these times.
    pub table: Vec<HeaterOn>,
    /// All of the time.
    pub interval: HeaterInterval,
}

impl Switching {
    /// Over a length, s, at both ends of which it is quiet for some 20 s.
    pub fn new(seed: u64, heater_nt: [f64; 3], length_s: i64) -> Self {
        let mut random = Random::seeded(seed);
        let mut table = Vec::new();
        let mut at = 20.0;
        while at < (length_s - 40) as f64 {
            let mut next = || {
                at += 12.0 + 8.0 * random.uniform();
                (at * SECOND as f64) as i64
            };
            table.push(HeaterOn { from_tt2000: next(), to_tt2000: next(), class: 0 });
        }
        let time: Vec<i64> = (0..2 * length_s).map(|k| k * SECOND / 2).collect();
        let is_on = |t: &i64| f64::from(u8::from(table.iter().any(|row| (row.from_tt2000..row.to_tt2000).contains(t))));
        let field_nt = heater_nt.map(|nt| {
            let mut level = 0.0;
            let value = |t: &i64| {
                level += 0.035 * random.gaussian();
                level + 0.03 * random.gaussian() + nt * is_on(t)
            };
            time.iter().map(value).collect::<Vec<f64>>()
        });
        Self { time, field_nt, table, interval: HeaterInterval { from_tt2000: 0, to_tt2000: length_s * SECOND } }
    }
}
