//! Thermistor counts to the sensor temperature (RO-IGEP-TR0028 sections 3.3.3, 4.2.2.5 and 4.2.3.2).

use super::{Block, Step};
use crate::data::time::Tt2000;
use crate::fit::statistics::central_median;
use std::ops::Range;

/// Steps of the converter of the thermistor.
const STEPS: f64 = 65_536.0;
/// Range of its voltages, V.
const VOLTS: f64 = 5.0;

/// A thermistor with its converter of 16 bits over ± 2.5 V.
#[derive(Clone, Debug, PartialEq)]
pub struct Thermometer {
    /// `T_r = Σ T_k Uᵏ`, °C per Vᵏ.
    pub coefficients: Vec<f64>,
    /// `T = T_r - T_OFF`, °C.
    pub t_off_degc: f64,
}

impl Thermometer {
    /// The voltage of unsigned counts, V: `N = (TLM + 2¹⁵) mod 2¹⁶`, `U = N 5/(2¹⁶ - 1) - 2.5`.
    #[must_use]
    pub fn volts(count: f64) -> f64 {
        (count + 0.5 * STEPS).rem_euclid(STEPS) * VOLTS / (STEPS - 1.0) - 0.5 * VOLTS
    }

    /// The temperature of the thermistor before its offset is taken off, °C.
    #[must_use]
    pub fn raw_degc(&self, count: f64) -> f64 {
        crate::model::polynomial::value(&self.coefficients, Self::volts(count))
    }

    /// The temperature, °C.
    #[must_use]
    pub fn degc(&self, count: f64) -> f64 {
        self.raw_degc(count) - self.t_off_degc
    }

    /// Standard uncertainty of a temperature from the step of the converter, °C.
    #[must_use]
    pub fn std_degc(&self, count: f64) -> f64 {
        let volts = Self::volts(count);
        let slopes = self.coefficients.iter().enumerate().skip(1).map(|(k, c)| k as f64 * c * volts.powi(k as i32 - 1));
        slopes.sum::<f64>().abs() * VOLTS / (STEPS - 1.0) / 12.0_f64.sqrt()
    }
}

/// The rows of packets one after the other: runs of equal counts that are not longer than `packet_ns` of their first row.
pub(super) fn packets(times: &[Tt2000], counts: &[f64], packet_ns: impl Fn(usize) -> i64) -> Vec<Range<usize>> {
    let mut packets = Vec::new();
    let mut begin = 0;
    while begin < times.len() {
        let longest_ns = packet_ns(begin);
        let same = |row: &usize| counts[*row] == counts[begin] && times[*row] - times[begin] < longest_ns;
        let length = (begin..times.len()).take_while(same).count().max(1);
        packets.push(begin..begin + length);
        begin += length;
    }
    packets
}

/// Running median of the thermistor over packets: the counts of a packet become the median of those of all packets whose middle is within
/// half of `window_ns` of its own. A packet is a run of equal counts that is not longer than `packet_ns`.
pub fn smooth(times: &[Tt2000], counts: &mut [f64], packet_ns: i64, window_ns: i64) {
    let middle = |rows: &Range<usize>| times[rows.start] + (times[rows.end - 1] - times[rows.start]) / 2;
    let packets: Vec<(Tt2000, f64, usize)> =
        packets(times, counts, |_| packet_ns).iter().map(|rows| (middle(rows), counts[rows.start], rows.len())).collect();
    let mut row = 0;
    for (middle, _, length) in &packets {
        let first = packets.partition_point(|(t, ..)| t + window_ns / 2 < *middle);
        let last = packets.partition_point(|(t, ..)| t - window_ns / 2 <= *middle);
        let mut near: Vec<f64> = packets[first..last].iter().map(|(_, count, _)| *count).collect();
        counts[row..row + length].fill(central_median(&mut near));
        row += length;
    }
}

impl Step for Thermometer {
    fn apply(&self, block: &mut Block) {
        // A packet has one reading for many vectors.
        let mut last = (f64::NAN, f64::NAN);
        for (count, degc) in block.thermistor.iter().zip(&mut block.t_degc) {
            if *count != last.0 {
                last = (*count, self.degc(*count));
            }
            *degc = last.1;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_voltage_goes_from_one_end_of_the_converter_to_the_other() {
        // Telemetry counts from the middle of the range: 8000h is the lowest voltage, 7FFFh the highest one.
        assert!((Thermometer::volts(32_768.0) + 2.5).abs() < 1e-12);
        assert!((Thermometer::volts(32_767.0) - 2.5).abs() < 1e-12);
        assert!((Thermometer::volts(0.0) - (32_768.0 * 5.0 / 65_535.0 - 2.5)).abs() < 1e-12);
    }

    #[test]
    fn a_single_wrong_packet_does_not_move_the_temperature() {
        let times: Vec<Tt2000> = (0..50).map(|k| k * 10).collect();
        // Packets of ten vectors, counts that rise, one that is wrong.
        let mut counts: Vec<f64> = (0..50).map(|k| [100.0, 101.0, 9000.0, 103.0, 104.0][k / 10]).collect();
        smooth(&times, &mut counts, 100, 250);
        assert_eq!([counts[0], counts[15], counts[25], counts[35], counts[49]], [100.5, 101.0, 103.0, 104.0, 103.5]);
    }

    #[test]
    fn the_step_of_the_converter_is_its_uncertainty() {
        let thermometer = Thermometer { coefficients: vec![-368.61072, 458.49304, -356.0289, 180.00644], t_off_degc: -2.7 };
        let count = 13_837.0;
        let step = thermometer.degc(count + 1.0) - thermometer.degc(count);
        assert!((thermometer.std_degc(count) * 12.0_f64.sqrt() / step - 1.0).abs() < 1e-3);
        assert!((thermometer.degc(count) - thermometer.raw_degc(count) - 2.7).abs() < 1e-12);
    }
}
