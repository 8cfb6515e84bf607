//! Means over intervals of a day (RO-IGEP-TR0028 sections 4.6, 4.7, 4.8 and 4.10).

use super::{Block, Series};
use crate::data::time::Tt2000;

/// Means, interval by interval; those without vectors are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Means {
    /// Middle of the interval.
    pub time: Vec<Tt2000>,
    /// nT; nan where no vector of the interval is there.
    pub field_nt: [Vec<f64>; 3],
    /// Vectors of the mean.
    pub count: Vec<u32>,
    /// Mode of the first vector.
    pub mode: Vec<u8>,
    /// Flags of all of them.
    pub flags: Vec<u32>,
    /// Rows of the series, first and behind the last one.
    pub rows: Vec<(usize, usize)>,
}

/// Means over intervals of `mean_ns` that count from the begin of a day; the last one ends with it.
#[must_use]
pub fn means(series: &Series, day: &std::ops::Range<Tt2000>, mean_ns: i64) -> Means {
    let mut out = Means::default();
    let mut row = series.time.partition_point(|t| *t < day.start);
    let last = series.time.partition_point(|t| *t < day.end);
    while row < last {
        let index = (series.time[row] - day.start) / mean_ns;
        let begin = day.start + index * mean_ns;
        let end = (begin + mean_ns).min(day.end);
        let next = row + series.time[row..last].iter().take_while(|t| **t < end).count();
        let rows = row..next;
        let mut sum = [0.0; 3];
        let mut count = 0;
        for i in rows.clone().filter(|i| !series.field_nt[0][*i].is_nan()) {
            (0..3).for_each(|c| sum[c] += series.field_nt[c][i]);
            count += 1;
        }
        out.time.push(begin + (end - begin) / 2);
        for c in 0..3 {
            out.field_nt[c].push(if count == 0 { f64::NAN } else { sum[c] / f64::from(count) });
        }
        out.count.push(count);
        out.mode.push(series.mode[row]);
        out.flags.push(rows.fold(0, |all, i| all | series.flags[i]));
        out.rows.push((row, next));
        row = next;
    }
    out
}

impl Means {
    /// Covariances of the means, nT², in the order of [`SYMMETRIC`], of the blocks that they were made of: the independent part falls with the
    /// number of vectors, the common one does not. Empty where the blocks have none, nan for a mean without vectors.
    ///
    /// [`SYMMETRIC`]: crate::model::field_calibration::SYMMETRIC
    #[must_use]
    pub fn covariances_nt2(&self, blocks: &[Block]) -> [Vec<[f64; 6]>; 2] {
        let own: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.own_nt2).collect();
        let common: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.common_nt2).collect();
        let mean_of = |list: &[&[f32; 6]], (first, last): (usize, usize)| -> [f64; 6] {
            let mut sums = [(0.0, 0.0); 6];
            for covariance in list.get(first..last).unwrap_or_default() {
                for ((sum, count), element) in sums.iter_mut().zip(covariance.iter()).filter(|(_, v)| !v.is_nan()) {
                    *sum += f64::from(*element);
                    *count += 1.0;
                }
            }
            sums.map(|(sum, count)| sum / count)
        };
        let of = |list: &[&[f32; 6]], falls: bool| {
            if list.is_empty() {
                return Vec::new();
            }
            let each = self.rows.iter().zip(&self.count).map(|(rows, count)| {
                let n = if falls { f64::from(*count) } else { 1.0 };
                mean_of(list, *rows).map(|mean| mean / n)
            });
            each.collect::<Vec<[f64; 6]>>()
        };
        [of(&own, true), of(&common, false)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_count_from_the_begin_of_the_day() {
        let time = vec![100, 104, 109, 110, 131, 138, 139];
        let x = vec![1.0, 2.0, f64::NAN, 4.0, f64::NAN, 6.0, 8.0];
        let field_nt = [x.clone(), x.clone(), x];
        let series = Series { time, field_nt, mode: vec![0; 7], flags: vec![1, 2, 4, 0, 0, 8, 16] };
        let found = means(&series, &(100..139), 10);
        assert_eq!(found.time, [105, 115, 134]);
        assert_eq!(found.count, [2, 1, 1]);
        assert_eq!(found.field_nt[0], [1.5, 4.0, 6.0]);
        assert_eq!(found.flags, [7, 0, 8]);
    }
}
