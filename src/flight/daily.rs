//! The extended temperature model (RO-IGEP-TR0028 section 4.2.3.3): `B - (P_d(T) + S_d)`, behind the matrix, and its continuity at midnight.

use super::ground::{Limits, derivative};
use super::{Block, Step};
use crate::data::flags::Flags;
use crate::data::time::Tt2000;
use crate::model::polynomial::{TemperaturePolynomial, value};
use std::collections::HashMap;

/// The model of one day.
#[derive(Clone, Debug, PartialEq)]
pub struct DailyStep {
    /// `P_d` of x, y, z, nT over °C.
    pub polynomials: [TemperaturePolynomial; 3],
    /// What joins it to the models of the days before.
    pub continuity: Continuity,
    /// Temperatures.
    pub limits: Limits,
    /// From when on there is no model.
    pub to: Option<Tt2000>,
}

/// What joins the model of a day to those of the days before.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Continuity {
    /// `S_d`, nT.
    pub sum_nt: [f64; 3],
    /// Its change if all temperatures are higher, nT/K: what the offset of the thermistor does.
    pub sum_nt_per_k: [f64; 3],
    /// The offset at midnight; absent where continuity begins anew.
    pub joined: Option<Joined>,
}

/// The offset of the first vector of a day, which is that of the last one of the day before.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Joined {
    /// Temperature of the first vector, °C.
    pub degc: f64,
    /// Variance of the offset there, nT².
    pub variance_nt2: [f64; 3],
}

/// The variance of a model at a temperature, or of the difference of its values at two, nT²; a model without a stated covariance has none.
fn variance_nt2(polynomial: &TemperaturePolynomial, degc: f64, from_degc: Option<f64>) -> f64 {
    let variance = polynomial.variance_of(|k| degc.powi(k as i32) - from_degc.map_or(0.0, |from| from.powi(k as i32)));
    if variance.is_nan() { 0.0 } else { variance }
}

impl Step for DailyStep {
    fn apply(&self, block: &mut Block) {
        let mut known: HashMap<u64, ([f64; 3], [f32; 3])> = HashMap::new();
        for row in 0..block.len() {
            if self.to.is_some_and(|to| block.time[row] >= to) {
                continue;
            }
            let degc = block.t_degc[row];
            let (without_flag, given) = self.limits.of(degc);
            if !given {
                block.take_away(row, Flags::TEMPERATURE);
                continue;
            }
            if !without_flag {
                block.flags[row] |= Flags::TEMPERATURE.0;
            }
            let (offset, variance) = known.entry(degc.to_bits()).or_insert_with(|| {
                let offset = std::array::from_fn(|i| value(&self.polynomials[i].coefficients, degc) + self.continuity.sum_nt[i]);
                // A joined day goes on from the offset at midnight, so that of its own model only the difference from there counts.
                let joined = self.continuity.joined;
                let variance = std::array::from_fn(|i| {
                    let own = variance_nt2(&self.polynomials[i], degc, joined.map(|j| j.degc));
                    #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
                    let variance = (own + joined.map_or(0.0, |j| j.variance_nt2[i])) as f32;
                    variance
                });
                (offset, variance)
            });
            for i in 0..3 {
                block.field[i][row] -= offset[i];
            }
            if let Some(covariance) = block.common_nt2.get_mut(row) {
                [0, 3, 5].into_iter().zip(variance).for_each(|(place, v)| covariance[place] += *v);
            }
        }
    }
}

/// What continuity needs of a day: its first and its last accepted vector, and its model.
#[derive(Clone, Debug, PartialEq)]
pub struct DayEnds {
    /// Corrected times of the first and the last vector.
    pub time: [Tt2000; 2],
    /// Their temperatures, °C.
    pub degc: [f64; 2],
    /// `P_d` of x, y, z, nT over °C.
    pub model: [TemperaturePolynomial; 3],
}

impl DayEnds {
    fn offset_nt(&self, end: usize) -> [f64; 3] {
        self.model.each_ref().map(|p| value(&p.coefficients, self.degc[end]))
    }

    /// The slope of the model at the temperature of an end, nT/K.
    fn slope_nt_per_k(&self, end: usize) -> [f64; 3] {
        self.model.each_ref().map(|p| value(&derivative(&p.coefficients), self.degc[end]))
    }

    /// Variance of the offset at the end of the day, nT².
    fn variance_at_end(&self, before: &Continuity) -> [f64; 3] {
        let at_begin = before.joined.map_or([0.0; 3], |j| j.variance_nt2);
        std::array::from_fn(|i| at_begin[i] + variance_nt2(&self.model[i], self.degc[1], before.joined.map(|j| j.degc)))
    }
}

/// What joins the days of one sensor, in their order: `S_d = S_{d-1} + P_{d-1}(T_end) - P_d(T_start)`; it begins anew, with zero, on the first
/// day, behind a gap that is longer than `reset_gap_ns`, and where a moment of `resets` lies between two days.
#[must_use]
pub fn continuity(days: &[DayEnds], reset_gap_ns: i64, resets: &[Tt2000]) -> Vec<Continuity> {
    let mut list: Vec<Continuity> = Vec::with_capacity(days.len());
    for (index, day) in days.iter().enumerate() {
        let before = index.checked_sub(1).and_then(|i| Some((days.get(i)?, *list.get(i)?)));
        let joined = before.filter(|(last, _)| {
            let (end, begin) = (last.time[1], day.time[0]);
            begin - end <= reset_gap_ns && !resets.iter().any(|at| (end + 1..=begin).contains(at))
        });
        list.push(joined.map_or_else(Continuity::default, |(last, own)| {
            let (end_nt, begin_nt) = (last.offset_nt(1), day.offset_nt(0));
            let [end_slope, begin_slope] = [last.slope_nt_per_k(1), day.slope_nt_per_k(0)];
            Continuity {
                sum_nt: std::array::from_fn(|i| own.sum_nt[i] + end_nt[i] - begin_nt[i]),
                sum_nt_per_k: std::array::from_fn(|i| own.sum_nt_per_k[i] + end_slope[i] - begin_slope[i]),
                joined: Some(Joined { degc: day.degc[0], variance_nt2: last.variance_at_end(&own) }),
            }
        }));
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::DMatrix;

    /// A day whose model is `T` in x, so that its offsets are its temperatures.
    fn day(begin: i64, end: i64, degc: [f64; 2], covariance: &DMatrix<f64>) -> DayEnds {
        let of = |coefficients: Vec<f64>| TemperaturePolynomial {
            coefficients,
            covariance: covariance.clone(),
            valid_degc: [-100.0, 100.0],
        };
        DayEnds { time: [begin, end], degc, model: [of(vec![0.0, 1.0]), of(vec![0.0, 0.0]), of(vec![0.0, 0.0])] }
    }

    #[test]
    fn the_field_goes_on_at_midnight_and_begins_anew_behind_a_gap() {
        let none = DMatrix::zeros(0, 0);
        let days = [
            day(0, 90, [1.0, 4.0], &none),
            day(100, 190, [3.5, 2.0], &none),
            day(400, 490, [7.0, 7.5], &none),
            day(500, 590, [1.0, 1.0], &none),
        ];
        let found = continuity(&days, 100, &[495]);
        assert_eq!(found[0], Continuity::default());
        // 4 at the end of the first day, 3.5 at the begin of the second one.
        assert_eq!(found[1].sum_nt, [0.5, 0.0, 0.0]);
        assert_eq!(found[1].joined, Some(Joined { degc: 3.5, variance_nt2: [0.0; 3] }));
        assert_eq!(found[2], Continuity::default());
        // A campaign begins between the last two days.
        assert_eq!(found[3], Continuity::default());
        assert_eq!(continuity(&days, 100, &[])[3].sum_nt, [6.5, 0.0, 0.0]);
        // With slopes of 1 and 3 nT/K the sum of the second day falls by 2 nT if both temperatures at midnight are higher by 1 K.
        let mut steep = days[..2].to_vec();
        steep[1].model[0].coefficients = vec![0.0, 3.0];
        assert_eq!(continuity(&steep, 100, &[])[1].sum_nt_per_k, [-2.0, 0.0, 0.0]);
        assert_eq!(continuity(&steep, 100, &[])[1].sum_nt, [4.0 - 3.0 * 3.5, 0.0, 0.0]);
    }

    /// Of the models of the days before, the first one counts with its value and each later one with its change over its day.
    #[test]
    fn what_is_uncertain_of_the_models_before_is_in_the_offset_of_a_day() {
        // Value at 0 °C and slope, uncertain by 0.3 nT and 0.02 nT/K, with correlation.
        let covariance = DMatrix::from_row_slice(2, 2, &[0.09, -0.003, -0.003, 0.0004]);
        let days: Vec<DayEnds> = [[5.0, 15.0], [14.0, 4.0], [4.5, 10.0]]
            .into_iter()
            .zip(0..)
            .map(|(t, n)| day(100 * n, 100 * n + 95, t, &covariance))
            .collect();
        let found = continuity(&days, 100, &[]);
        let variances: Vec<f64> = found.iter().map(|c| c.joined.map_or(0.0, |j| j.variance_nt2[0])).collect();
        // The first day at its end: 0.09 - 2 · 15 · 0.003 + 15² · 0.0004; the second one adds (4 - 14)² · 0.0004.
        let first = 0.09 - 0.09 + 225.0 * 0.0004;
        assert!((variances[1] - first).abs() < 1e-15 && (variances[2] - (first + 0.04)).abs() < 1e-15, "{variances:?}");
        // At 9.5 °C on the third day the slope of its own model has acted over 5 K.
        let step = DailyStep {
            polynomials: days[2].model.clone(),
            continuity: found[2],
            limits: Limits { valid_degc: [-100.0, 100.0], kept_degc: [-100.0, 100.0] },
            to: None,
        };
        let mut block = Block {
            time: vec![250],
            field: [vec![0.0], vec![0.0], vec![0.0]],
            t_degc: vec![9.5],
            flags: vec![0],
            common_nt2: vec![[0.0; 6]],
            ..Block::default()
        };
        step.apply(&mut block);
        assert!((f64::from(block.common_nt2[0][0]) - (first + 0.04 + 25.0 * 0.0004)).abs() < 1e-8, "{:?}", block.common_nt2);
    }
}
