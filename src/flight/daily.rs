//! The extended temperature model (RO-IGEP-TR0028 section 4.2.3.3): `B - (P_d(T) + S_d)`, behind the matrix, and its continuity at midnight.

use super::ground::Limits;
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
    /// `S_d`, nT.
    pub continuity_nt: [f64; 3],
    /// Temperatures.
    pub limits: Limits,
    /// From when on there is no model.
    pub to: Option<Tt2000>,
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
                let offset = std::array::from_fn(|i| value(&self.polynomials[i].coefficients, degc) + self.continuity_nt[i]);
                // A model without a stated covariance adds none.
                let variance = std::array::from_fn(|i| {
                    let std = self.polynomials[i].evaluate(degc).1;
                    #[expect(clippy::cast_possible_truncation, reason = "variances need few digits")]
                    let variance = (std * std) as f32;
                    if variance.is_nan() { 0.0 } else { variance }
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

/// What continuity needs of a day: the first and the last accepted vector, and the model there.
#[derive(Clone, Debug, PartialEq)]
pub struct DayEnds {
    /// Corrected times of the first and the last vector.
    pub time: [Tt2000; 2],
    /// `P_d` at their temperatures, nT.
    pub model_nt: [[f64; 3]; 2],
}

/// `S_d` of the days of one sensor in their order, nT, and whether it begins anew: `S_d = S_{d-1} + P_{d-1}(T_end) - P_d(T_start)`; zero
/// on the first day, behind a gap that is longer than `reset_gap_ns`, and where a moment of `resets` lies between two days.
#[must_use]
pub fn continuity(days: &[DayEnds], reset_gap_ns: i64, resets: &[Tt2000]) -> Vec<([f64; 3], bool)> {
    let mut list: Vec<([f64; 3], bool)> = Vec::with_capacity(days.len());
    for (index, day) in days.iter().enumerate() {
        let before = index.checked_sub(1).and_then(|i| Some((days.get(i)?, *list.get(i)?)));
        let joined = before.filter(|(last, _)| {
            let (end, begin) = (last.time[1], day.time[0]);
            begin - end <= reset_gap_ns && !resets.iter().any(|at| (end + 1..=begin).contains(at))
        });
        list.push(match joined {
            None => ([0.0; 3], true),
            Some((last, (sum, _))) => (std::array::from_fn(|i| sum[i] + last.model_nt[1][i] - day.model_nt[0][i]), false),
        });
    }
    list
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_goes_on_at_midnight_and_begins_anew_behind_a_gap() {
        let day = |begin: i64, end: i64, first: f64, last: f64| DayEnds {
            time: [begin, end],
            model_nt: [[first, 0.0, 0.0], [last, 0.0, 0.0]],
        };
        let days = [day(0, 90, 1.0, 4.0), day(100, 190, 3.5, 2.0), day(400, 490, 7.0, 7.5), day(500, 590, 1.0, 1.0)];
        let found = continuity(&days, 100, &[495]);
        assert_eq!(found[0], ([0.0; 3], true));
        // 4 at the end of the first day, 3.5 at the begin of the second one.
        assert_eq!(found[1], ([0.5, 0.0, 0.0], false));
        assert_eq!(found[2], ([0.0; 3], true));
        // A campaign begins between the last two days.
        assert_eq!(found[3], ([0.0; 3], true));
        assert_eq!(continuity(&days, 100, &[])[3], ([6.5, 0.0, 0.0], false));
    }
}
