//! Calm stretches of a day: where the field of a quiet time may be compared with the temperature (RO-IGEP-TR0028 section 4.2.3.3).

use super::means::means;
use super::{Block, Series};
use crate::data::time::{SECOND_NS, Tt2000};
use std::ops::Range;

/// Length of a row, ns.
pub const ROW_NS: i64 = 60 * SECOND_NS;
/// Means of one second that a row must have to show whether it is calm.
const LEAST_SECONDS: usize = 20;
/// A row is calm if its means of one second scatter by at most so many times their noise.
pub const MULTIPLE: f64 = 10.0;

/// The mean of a calm minute.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CalmRow {
    /// Begin of the minute.
    pub from: Tt2000,
    /// End of the minute, not of it.
    pub to: Tt2000,
    /// nT, axes of the sensor.
    pub field_nt: [f64; 3],
    /// °C.
    pub degc: f64,
    /// Vectors of the mean.
    pub vectors: usize,
}

/// The calm minutes of level A of a day: those within `spans` or, without any, those in which the means of one second scatter by at most
/// [`MULTIPLE`] times the noise of such a mean in every component.
#[must_use]
pub fn calm_rows(blocks: &[Block], day: &Range<Tt2000>, spans: Option<&[Range<Tt2000>]>) -> Vec<CalmRow> {
    let series = Series::of(blocks);
    let degc: Vec<f64> = blocks.iter().flat_map(|block| block.t_degc.iter().copied()).collect();
    let own_nt2: Vec<[f32; 6]> = blocks.iter().flat_map(|block| block.own_nt2.iter().copied()).collect();
    let seconds = means(&series, day, SECOND_NS);
    let there: Vec<usize> = (0..seconds.time.len()).filter(|i| seconds.count[*i] > 0).collect();
    let minutes = there.chunk_by(|a, b| minute(day, seconds.time[*a]) == minute(day, seconds.time[*b]));
    let mut rows = Vec::new();
    for list in minutes {
        let from = day.start + minute(day, seconds.time[list[0]]) * ROW_NS;
        let to = (from + ROW_NS).min(day.end);
        let vectors: Vec<usize> = list
            .iter()
            .flat_map(|i| seconds.rows[*i].0..seconds.rows[*i].1)
            .filter(|row| !series.field_nt[0][*row].is_nan() && degc[*row].is_finite())
            .collect();
        let calm = match spans {
            Some(spans) => spans.iter().any(|span| span.start <= from && to <= span.end),
            None => is_calm(&seconds.field_nt, &seconds.count, list, &vectors, &own_nt2),
        };
        if calm && !vectors.is_empty() {
            let mean = |of: &[f64]| vectors.iter().map(|row| of[*row]).sum::<f64>() / vectors.len() as f64;
            let field_nt = series.field_nt.each_ref().map(|c| mean(c));
            rows.push(CalmRow { from, to, field_nt, degc: mean(&degc), vectors: vectors.len() });
        }
    }
    rows
}

fn minute(day: &Range<Tt2000>, time: Tt2000) -> i64 {
    (time - day.start) / ROW_NS
}

fn is_calm(field_nt: &[Vec<f64>; 3], count: &[u32], seconds: &[usize], vectors: &[usize], own_nt2: &[[f32; 6]]) -> bool {
    if seconds.len() < LEAST_SECONDS {
        return false;
    }
    let per_second = seconds.iter().map(|i| f64::from(count[*i])).sum::<f64>() / seconds.len() as f64;
    [0, 3, 5].into_iter().enumerate().all(|(c, place)| {
        let n = seconds.len() as f64;
        let mean = seconds.iter().map(|i| field_nt[c][*i]).sum::<f64>() / n;
        let variance = seconds.iter().map(|i| (field_nt[c][*i] - mean).powi(2)).sum::<f64>() / (n - 1.0);
        let own = vectors.iter().filter_map(|row| own_nt2.get(*row)).map(|v| f64::from(v[place])).sum::<f64>();
        variance <= MULTIPLE * MULTIPLE * own / vectors.len() as f64 / per_second
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two minutes at 4 Hz with noise of 0.1 nT from vector to vector; the second one has a step of `step_nt` in y.
    fn two_minutes(step_nt: f64) -> Vec<Block> {
        let mut block = Block::default();
        for i in 0..480_i64 {
            let noise = if i % 3 == 0 { 0.1 } else { -0.05 };
            block.time.push(i * SECOND_NS / 4);
            block.field[0].push(5.0 + noise);
            block.field[1].push(noise + if i >= 360 { step_nt } else { 0.0 });
            block.field[2].push(-3.0);
            block.t_degc.push(-40.0 + i as f64 / 480.0);
            block.own_nt2.push([0.01, 0.0, 0.0, 0.01, 0.0, 0.01]);
        }
        block.mode = vec![0; 480];
        block.flags = vec![0; 480];
        vec![block]
    }

    #[test]
    fn a_minute_with_a_step_beyond_the_noise_is_not_calm() {
        // A mean of a second has noise of 0.05 nT; a step of 2 nT in the middle scatters by 1 nT, twenty times as much.
        let rows = calm_rows(&two_minutes(2.0), &(0..120 * SECOND_NS), None);
        assert_eq!(rows.len(), 1);
        assert_eq!((rows[0].from, rows[0].to, rows[0].vectors), (0, ROW_NS, 240));
        assert!((rows[0].field_nt[0] - 5.0).abs() < 1e-12, "{rows:?}");
        // The mean of i / 480 over 0 to 239.
        assert!((rows[0].degc - (-40.0 + 119.5 / 480.0)).abs() < 1e-12, "{rows:?}");
        assert_eq!(calm_rows(&two_minutes(0.5), &(0..120 * SECOND_NS), None).len(), 2);
    }

    #[test]
    fn a_table_of_calm_times_is_taken_as_it_is() {
        let second = ROW_NS..2 * ROW_NS;
        let rows = calm_rows(&two_minutes(2.0), &(0..120 * SECOND_NS), Some(&[second]));
        assert_eq!(rows.iter().map(|r| r.from).collect::<Vec<_>>(), [ROW_NS]);
    }
}
