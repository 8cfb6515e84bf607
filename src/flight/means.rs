//! Means over intervals of a day (RO-IGEP-TR0028 sections 4.6, 4.7, 4.8 and 4.10).

use super::{Block, Series};
use crate::data::time::Tt2000;
use crate::model::field_calibration::SYMMETRIC;
use std::ops::Range;

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
    /// The quality bits of all vectors of every mean, of the blocks that they were made of.
    #[must_use]
    pub fn quality(&self, blocks: &[Block]) -> Vec<u8> {
        let all: Vec<u8> = blocks.iter().flat_map(|block| block.quality.iter().copied()).collect();
        let of_rows = |(first, last): &(usize, usize)| all.get(*first..*last).unwrap_or_default().iter().fold(0, |a, b| a | b);
        self.rows.iter().map(of_rows).collect()
    }

    /// Covariances of the means, nT², in the order of [`SYMMETRIC`], of the blocks that they were made of. Of the part that is not common, the
    /// noise of the readings falls with the number of vectors, and the error of the thermistor only with the number of its readings. The common
    /// part does not fall. Empty where the blocks have none, nan for a mean without vectors.
    ///
    /// [`SYMMETRIC`]: crate::model::field_calibration::SYMMETRIC
    #[must_use]
    pub fn covariances_nt2(&self, blocks: &[Block]) -> [Vec<[f64; 6]>; 2] {
        let own: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.own_nt2).collect();
        let common: Vec<&[f32; 6]> = blocks.iter().flat_map(|b| &b.common_nt2).collect();
        let by_thermistor: Vec<&[f32; 3]> = blocks.iter().flat_map(|b| &b.thermistor_nt).collect();
        let readings: Vec<f64> = blocks.iter().flat_map(|b| b.thermistor.iter().copied()).collect();
        let own_of = |rows: Range<usize>| {
            let all = sums(&own[rows.clone()]);
            let thermistor = by_thermistor.get(rows.clone()).unwrap_or_default();
            let thermistor = Thermistor::of(&readings[rows.start..rows.start + thermistor.len()], thermistor);
            std::array::from_fn(|e| {
                let (sum, count) = all[e];
                (sum - thermistor.squares[e] + thermistor.squares_of_sums[e]) / (count * count)
            })
        };
        let common_of = |rows: Range<usize>| sums(&common[rows]).map(|(sum, count)| sum / count);
        let each = || self.rows.iter().map(|(first, last)| *first..*last);
        let own = if own.is_empty() { Vec::new() } else { each().map(own_of).collect() };
        let common = if common.is_empty() { Vec::new() } else { each().map(common_of).collect() };
        [own, common]
    }
}

/// Sums of the elements of covariances, and how many there are, without those that are not known.
fn sums(list: &[&[f32; 6]]) -> [(f64, f64); 6] {
    let mut sums = [(0.0, 0.0); 6];
    for covariance in list {
        for ((sum, count), element) in sums.iter_mut().zip(covariance.iter()).filter(|(_, v)| !v.is_nan()) {
            *sum += f64::from(*element);
            *count += 1.0;
        }
    }
    sums
}

/// What the error of the thermistor does to a sum of vectors, nT², in the order of `SYMMETRIC`.
///
/// All vectors of a reading have its error: the covariance of the sum is `Σ s sᵀ` with `s` the sum over the vectors of one reading of what a
/// standard uncertainty of it changes in each. Counts that stay the same from packet to packet are one reading: where the temperature moves by
/// less than a step, the next packet rounds it to the same side, and says nothing new.
#[derive(Default)]
struct Thermistor {
    /// `Σ v vᵀ`, as if every vector had an error of its own.
    squares: [f64; 6],
    /// `Σ s sᵀ`.
    squares_of_sums: [f64; 6],
}

impl Thermistor {
    fn of(readings: &[f64], by_thermistor_nt: &[&[f32; 3]]) -> Self {
        let mut out = Self::default();
        let (mut count, mut sum) = (f64::NAN, [0.0; 3]);
        for (reading, change) in readings.iter().zip(by_thermistor_nt).filter(|(_, change)| !change[0].is_nan()) {
            if *reading != count {
                add_square(&mut out.squares_of_sums, &sum);
                (count, sum) = (*reading, [0.0; 3]);
            }
            let change = change.map(f64::from);
            (0..3).for_each(|i| sum[i] += change[i]);
            add_square(&mut out.squares, &change);
        }
        add_square(&mut out.squares_of_sums, &sum);
        out
    }
}

/// Adds `v vᵀ`.
fn add_square(sums: &mut [f64; 6], vector: &[f64; 3]) {
    SYMMETRIC.into_iter().zip(sums).for_each(|((i, k), sum)| *sum += vector[i] * vector[k]);
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

    #[test]
    fn the_quality_of_a_mean_has_the_bits_of_its_vectors() {
        let block = |quality: &[u8]| Block { quality: quality.to_vec(), ..Block::default() };
        let means = Means { rows: vec![(0, 3), (3, 4)], ..Means::default() };
        assert_eq!(means.quality(&[block(&[8, 8]), block(&[10, 16])]), [10, 16]);
    }

    /// The error of a mean in closed form: noise of one nT² that every vector has for itself, and readings of the thermistor of one standard
    /// uncertainty of (0.5, -0.2, 1) nT each, of which every vector of a reading has the same.
    #[test]
    fn the_thermistor_falls_with_its_readings_and_the_noise_with_the_vectors() {
        let per_reading = [0.5_f32, -0.2, 1.0];
        let square = |share: f64| SYMMETRIC.map(|(i, k)| share * f64::from(per_reading[i]) * f64::from(per_reading[k]));
        let noise = SYMMETRIC.map(|(i, k)| f64::from(u8::from(i == k)));
        // Readings of 16 vectors: two packets with the same count, one with another, back to the first; a vector that is null.
        let block = |from: usize, to: usize| {
            let rows = from..to;
            let count = |i: usize| [700.0, 700.0, 701.0, 700.0][i / 16];
            let own: [f64; 6] = std::array::from_fn(|e| noise[e] + square(1.0)[e]);
            let mut block = Block {
                time: rows.clone().map(|i| i as i64).collect(),
                thermistor: rows.clone().map(count).collect(),
                field: [(); 3].map(|()| vec![1.0; rows.len()]),
                mode: vec![0; rows.len()],
                flags: vec![0; rows.len()],
                own_nt2: vec![own.map(|v| v as f32); rows.len()],
                thermistor_nt: vec![per_reading; rows.len()],
                common_nt2: vec![[0.25; 6]; rows.len()],
                ..Block::default()
            };
            if rows.contains(&63) {
                block.take_away(63 - from, crate::data::flags::Flags::TEMPERATURE);
            }
            block
        };
        // The shares of 32, 16 and 15 vectors of 63 in the whole, of one reading alone in its parts.
        let shares = |of: &[f64]| of.iter().map(|n| n * n).sum::<f64>() / of.iter().sum::<f64>().powi(2);
        for (mean_ns, wanted) in
            [(64, vec![(63.0, shares(&[32.0, 16.0, 15.0]))]), (32, vec![(32.0, 1.0), (31.0, shares(&[16.0, 15.0]))])]
        {
            let blocks = [block(0, 20), block(20, 64)];
            let [own, common] = means(&Series::of(&blocks), &(0..64), mean_ns).covariances_nt2(&blocks);
            assert_eq!(own.len(), wanted.len());
            for ((found, common), (vectors, share)) in own.iter().zip(&common).zip(wanted) {
                for e in 0..6 {
                    let wanted = noise[e] / vectors + square(share)[e];
                    assert!((found[e] - wanted).abs() < 1e-6, "{mean_ns} {e}: {} in place of {wanted}", found[e]);
                    assert!((common[e] - 0.25).abs() < 1e-12);
                }
            }
        }
        // A turn of the axes turns the part of the thermistor with the rest: about z by a right angle, x goes to y.
        let mut turned = block(0, 16);
        let turn = nalgebra::Matrix3::new(0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0);
        (0..16).for_each(|row| turned.turn_covariances(row, &turn));
        let [own, _] = means(&Series::of(&[turned.clone()]), &(0..16), 16).covariances_nt2(&[turned]);
        let wanted = [0.04 + 1.0 / 16.0, 0.25 + 1.0 / 16.0, 1.0 + 1.0 / 16.0];
        for (axis, wanted) in wanted.into_iter().enumerate() {
            let place = SYMMETRIC.iter().position(|place| *place == (axis, axis)).unwrap();
            assert!((own[0][place] - wanted).abs() < 1e-6);
        }
    }
}
