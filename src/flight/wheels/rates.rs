//! The table of rotation rates: phases, and where a rate lies in the spectrum of samples.

use super::WheelError;
pub use crate::files::flight::auxiliary::WheelRates;

/// Rates linear between rows, with the turns that they add up to.
#[derive(Clone, Debug, Default)]
pub(super) struct Table {
    times: Vec<i64>,
    rates: Vec<Vec<f64>>,
    /// Turns since the first row without the whole ones, which a phase does not see and which would cost its last digits.
    turns: Vec<Vec<f64>>,
    /// Rows of the run of equal rates that every row is in.
    runs: Vec<Vec<usize>>,
    /// For every row the number of gaps before it.
    gaps: Vec<usize>,
}

/// A time in the table: the row at or before it and the seconds since.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    row: usize,
    since_s: f64,
}

pub(super) fn seconds(nanoseconds: i64) -> f64 {
    nanoseconds as f64 * 1e-9
}

impl Table {
    /// Rows with a rate that is not a number are left out; rows further apart than `longest_gap_s` have a gap between them.
    pub fn new(wheels: &WheelRates, longest_gap_s: f64) -> Result<Self, WheelError> {
        let rows = wheels.time_tt2000.len();
        if let Some(wheel) = wheels.rate_hz.iter().position(|rates| rates.len() != rows) {
            return Err(WheelError::Length { wheel: wheel + 1, found: wheels.rate_hz[wheel].len(), rows });
        }
        if let Some(row) = (1..rows).find(|&i| wheels.time_tt2000[i] <= wheels.time_tt2000[i - 1]) {
            return Err(WheelError::Order { row });
        }
        let kept: Vec<usize> = (0..rows).filter(|&i| wheels.rate_hz.iter().all(|rates| rates[i].is_finite())).collect();
        let times: Vec<i64> = kept.iter().map(|&i| wheels.time_tt2000[i]).collect();
        let rates: Vec<Vec<f64>> = wheels.rate_hz.iter().map(|rates| kept.iter().map(|&i| rates[i]).collect()).collect();
        let mut gaps = vec![0; times.len()];
        for i in 1..times.len() {
            gaps[i] = gaps[i - 1] + usize::from(seconds(times[i] - times[i - 1]) > longest_gap_s);
        }
        let added = |rates: &Vec<f64>| {
            let mut turns = vec![0.0; times.len()];
            for i in 1..times.len() {
                let step = 0.5 * (rates[i - 1] + rates[i]) * seconds(times[i] - times[i - 1]);
                turns[i] = (turns[i - 1] + step).fract();
            }
            turns
        };
        let turns = rates.iter().map(added).collect();
        let run_lengths = |rates: &Vec<f64>| rates.chunk_by(|a, b| a == b).flat_map(|run| vec![run.len(); run.len()]).collect();
        let runs = rates.iter().map(run_lengths).collect();
        Ok(Self { times, rates, turns, runs, gaps })
    }

    /// Number of wheels.
    pub fn wheels(&self) -> usize {
        self.rates.len()
    }

    /// The place of a time, and the number of gaps before it; `None` before the first row, after the last one and in gaps. Fast where
    /// `near` is a little earlier.
    pub fn place(&self, time: i64, near: usize) -> Option<(Place, usize)> {
        let mut row = near;
        if row >= self.times.len() || self.times[row] > time || self.times.get(row + 4).is_some_and(|t| *t <= time) {
            row = self.times.partition_point(|t| *t <= time).checked_sub(1)?;
        }
        while self.times.get(row + 1).is_some_and(|t| *t <= time) {
            row += 1;
        }
        let since = time - self.times[row];
        let inside = since == 0 || self.gaps.get(row + 1).is_some_and(|gaps| *gaps == self.gaps[row]);
        inside.then(|| (Place { row, since_s: seconds(since) }, self.gaps[row]))
    }

    /// Turns of a wheel since the first row, without some whole ones.
    pub fn turns(&self, wheel: usize, at: Place) -> f64 {
        let (rates, x) = (&self.rates[wheel], at.since_s);
        self.turns[wheel][at.row] + x * (rates[at.row] + 0.5 * x * self.slope(wheel, at.row))
    }

    /// Rows that show the same rate of a wheel as the one at or before a place. The error of rounding stays that long.
    pub fn equal_rows(&self, wheel: usize, at: Place) -> usize {
        self.runs[wheel][at.row]
    }

    /// Rate of a wheel at a place.
    pub fn rate_hz(&self, wheel: usize, at: Place) -> f64 {
        self.rates[wheel][at.row] + at.since_s * self.slope(wheel, at.row)
    }

    /// Lowest and highest rate of a wheel in the time between two places.
    pub fn rates_between(&self, wheel: usize, from: Place, to: Place) -> [f64; 2] {
        let rates = &self.rates[wheel];
        let ends = [from, to].map(|at| self.rate_hz(wheel, at));
        let low = rates[from.row + 1..=to.row.max(from.row)].iter().fold(ends[0].min(ends[1]), |low, r| low.min(*r));
        let high = rates[from.row + 1..=to.row.max(from.row)].iter().fold(ends[0].max(ends[1]), |high, r| high.max(*r));
        [low, high]
    }

    fn slope(&self, wheel: usize, row: usize) -> f64 {
        let rates = &self.rates[wheel];
        rates.get(row + 1).map_or(0.0, |next| (next - rates[row]) / seconds(self.times[row + 1] - self.times[row]))
    }
}

/// No wheel changes its rate faster, Hz per s: a torque of 0.2 N m changes that of one of 0.1 kg m² by a third of it.
const FASTEST_HZ_PER_S: f64 = 1.0;

/// For every wheel, from 0, the times in a stretch at which its rate is not reached from that of the row before.
#[must_use]
pub fn leaps(wheels: &WheelRates, span: &std::ops::Range<i64>) -> Vec<(usize, Vec<i64>)> {
    let of_one = |rates: &Vec<f64>| -> Vec<i64> {
        let rows = (1..wheels.time_tt2000.len().min(rates.len())).filter(|row| span.contains(&wheels.time_tt2000[*row]));
        let is_leap = |row: &usize| {
            let step_s = seconds(wheels.time_tt2000[*row] - wheels.time_tt2000[row - 1]);
            (rates[*row] - rates[row - 1]).abs() > FASTEST_HZ_PER_S * step_s
        };
        rows.filter(is_leap).map(|row| wheels.time_tt2000[row]).collect()
    };
    let all = wheels.rate_hz.iter().map(of_one).enumerate();
    all.filter(|(_, times)| !times.is_empty()).collect()
}

impl Place {
    /// The row at or before the time.
    pub fn row(self) -> usize {
        self.row
    }
}

/// Frequencies at which rates from a lowest to a highest one are seen in samples (the folding of R 4.9): `|f - f_s round(f / f_s)|`.
pub(super) fn alias_range_hz([low, high]: [f64; 2], rate_hz: f64) -> [f64; 2] {
    let alias = |f: f64| (f - rate_hz * (f / rate_hz).round()).abs();
    let (a, b) = (alias(low), alias(high));
    // Every multiple of half the sample rate in between folds the range at 0 or at half the rate.
    let (first, last) = ((2.0 * low / rate_hz).ceil(), (2.0 * high / rate_hz).floor());
    let folds_at = |odd: f64| last > first || (last == first && first.rem_euclid(2.0) == odd);
    [if folds_at(0.0) { 0.0 } else { a.min(b) }, if folds_at(1.0) { 0.5 * rate_hz } else { a.max(b) }]
}

#[cfg(test)]
mod tests {
    use super::*;

    const S: i64 = 1_000_000_000;

    #[test]
    fn phases_are_the_integral_of_the_rate_over_a_day() {
        // 30 Hz + 1e-4 t Hz/s: 30 t + 0.5e-4 t² turns, rows every 8 s from a time far from zero.
        let start = 500_000_000 * S;
        let time_tt2000: Vec<i64> = (0..10_801).map(|i| start + 8 * S * i).collect();
        let rate_hz = vec![time_tt2000.iter().map(|t| 30.0 + 1e-4 * seconds(t - start)).collect()];
        let table = Table::new(&WheelRates { time_tt2000, rate_hz }, 60.0).unwrap();
        for t in [0, 3 * S + 1, 40_000 * S + 123_456_789, 86_399 * S + 999_999_999] {
            let (place, gaps) = table.place(start + t, 0).unwrap();
            let x = t as i128;
            // The same in whole numbers of 1e-22 turns.
            let exact = x * 300_000_000_000_000 + x * x / 2;
            let fraction = (exact % 10_i128.pow(22)) as f64 * 1e-22;
            let error = table.turns(0, place) - fraction;
            assert!((error - error.round()).abs() < 2e-10, "{t}: {error}");
            assert_eq!(gaps, 0);
        }
    }

    #[test]
    fn nothing_is_extrapolated() {
        let time_tt2000 = [0, 8, 16, 116, 124].map(|t| t * S).to_vec();
        let mut wheels = WheelRates { time_tt2000, rate_hz: vec![vec![1.0; 5]] };
        let table = Table::new(&wheels, 60.0).unwrap();
        let gaps = |t: i64| table.place(t, 0).map(|x| x.1);
        assert_eq!([-1, 0, 8 * S, 16 * S, 16 * S + 1, 116 * S, 124 * S, 124 * S + 1].map(gaps), {
            [None, Some(0), Some(0), Some(0), None, Some(1), Some(1), None]
        });
        // A rate that is missing is no rate: without the row at 8 s there is none from 0 to 16 s where 10 s are allowed.
        wheels.rate_hz[0][1] = f64::NAN;
        let table = Table::new(&wheels, 10.0).unwrap();
        assert!(table.place(9 * S, 0).is_none() && Table::new(&wheels, 16.0).unwrap().place(9 * S, 0).is_some());
        wheels.time_tt2000[3] = 16 * S;
        assert_eq!(Table::new(&wheels, 60.0).unwrap_err(), WheelError::Order { row: 3 });
        wheels.rate_hz.push(vec![1.0; 4]);
        assert_eq!(Table::new(&wheels, 60.0).unwrap_err(), WheelError::Length { wheel: 2, found: 4, rows: 5 });
    }

    #[test]
    fn runs_of_equal_rates_are_counted() {
        let time_tt2000 = (0..6).map(|t| 8 * t * S).collect();
        let wheels = WheelRates { time_tt2000, rate_hz: vec![vec![1.0, 1.0, 1.5, 2.0, 2.0, 2.0], vec![3.0; 6]] };
        let table = Table::new(&wheels, 60.0).unwrap();
        let rows = |wheel: usize| [0, 1, 2, 3, 5].map(|row| table.equal_rows(wheel, table.place(8 * row * S, 0).unwrap().0));
        assert_eq!((rows(0), rows(1)), ([2, 2, 1, 3, 3], [6; 5]));
    }

    #[test]
    fn rates_that_no_wheel_reaches_are_told() {
        // A row every 8 s: 7.9 Hz is reached in that time, 8.1 Hz is not, and a missing rate says nothing.
        let rate_hz = vec![vec![20.0, 27.9, 20.0, f64::NAN, 0.0, 0.0], vec![3.0, 3.0, 11.1, 11.2, 11.3, 11.4]];
        let wheels = WheelRates { time_tt2000: (0..6).map(|t| 8 * t * S).collect(), rate_hz };
        assert_eq!(leaps(&wheels, &(0..100 * S)), [(1, vec![16 * S])]);
        assert!(leaps(&wheels, &(17 * S..100 * S)).is_empty());
    }

    #[test]
    fn rates_fold_at_half_the_sample_rate() {
        for (range, expected) in [
            ([33.0, 34.0], [6.0, 7.0]),
            ([27.0, 28.0], [7.0, 8.0]),
            ([29.0, 32.0], [8.0, 10.0]),
            ([19.5, 20.2], [0.0, 0.5]),
            ([9.0, 21.0], [0.0, 10.0]),
            ([-3.0, -2.0], [2.0, 3.0]),
            ([20.0, 20.0], [0.0, 0.0]),
        ] {
            let found = alias_range_hz(range, 20.0);
            assert!(found.iter().zip(expected).all(|(f, e): (&f64, f64)| (f - e).abs() < 1e-12), "{range:?}: {found:?}");
        }
    }
}
