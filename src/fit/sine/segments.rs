//! Normal equations of short stretches, and the longest run of them which one sine describes.

use std::ops::Range;

use crate::fit::double_double::{DoubleDouble, two_sum};

use super::LEAST_DETERMINANT;

/// Factors of a standard deviation of chi-square by which a window, and each of its segments, may exceed the limit.
const WINDOW_FACTOR: f64 = 3.0;
const SEGMENT_FACTOR: f64 = 4.0;

/// Sums of products of sine, cosine, one and reading over a segment, exact enough to merge and to solve any window of segments.
///
/// Readings count from a reference, best one near them. Two segments of different references merge, too.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sums {
    count: u64,
    reference: f64,
    /// ss, sc, cc, s, c, sd, cd, d, dd, with d the reading less the reference.
    sums: [DoubleDouble; 9],
}

impl Sums {
    /// No samples yet; `reference` in the unit of the readings.
    pub fn new(reference: f64) -> Self {
        Self { count: 0, reference, sums: [DoubleDouble::default(); 9] }
    }

    /// Samples.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Adds a reading at a sample where the oscillator stands at `[sin, cos]`.
    #[inline]
    pub fn add(&mut self, [s, c]: [f64; 2], reading: f64) {
        let d = reading - self.reference;
        self.count += 1;
        for (sum, term) in self.sums.iter_mut().zip([s * s, s * c, c * c, s, c, s * d, c * d, d, d * d]) {
            let (hi, error) = two_sum(sum.hi, term);
            *sum = DoubleDouble { hi, lo: sum.lo + error };
        }
    }

    /// Adds the samples of another segment.
    pub fn merge(&mut self, other: &Self) {
        let mut added = other.sums;
        let shift = DoubleDouble::sum(other.reference, -self.reference);
        if shift != DoubleDouble::default() {
            let [_, _, _, s, c, _, _, d, _] = other.sums;
            added[5] += shift * s;
            added[6] += shift * c;
            added[7] += shift * other.count as f64;
            added[8] += shift * d * 2.0 + shift * shift * other.count as f64;
        }
        self.count += other.count;
        self.sums.iter_mut().zip(added).for_each(|(sum, term)| *sum += term);
    }

    /// `(A, B, C, rss)` of the sine through the samples; None where they do not determine it.
    pub fn solve(&self) -> Option<(f64, f64, f64, f64)> {
        if self.count < 3 {
            return None;
        }
        let count = self.count as f64;
        let [ss, sc, cc, s, c, sd, cd, d, _] = self.sums;
        let centred = |product: DoubleDouble, a: DoubleDouble, b: DoubleDouble| (product - a * b / count).value();
        let (v_ss, v_sc, v_cc) = (centred(ss, s, s), centred(sc, s, c), centred(cc, c, c));
        let (v_sd, v_cd) = (centred(sd, s, d), centred(cd, c, d));
        let determinant = v_ss * v_cc - v_sc * v_sc;
        if determinant <= LEAST_DETERMINANT * (0.5 * count).powi(2) || determinant.is_nan() {
            return None;
        }
        let sin = (v_cc * v_sd - v_sc * v_cd) / determinant;
        let cos = (v_ss * v_cd - v_sc * v_sd) / determinant;
        let offset = (d.value() - sin * s.value() - cos * c.value()) / count;
        let rss = self.rss_of(sin, cos, offset);
        rss.is_finite().then_some((sin, cos, offset + self.reference, rss))
    }

    /// Sum of squares around a sine whose offset counts from the reference.
    fn rss_of(&self, sin: f64, cos: f64, offset: f64) -> f64 {
        let [ss, sc, cc, s, c, sd, cd, d, dd] = self.sums;
        let (sin, cos, offset) = (DoubleDouble::from(sin), DoubleDouble::from(cos), DoubleDouble::from(offset));
        let on_sin = sin * ss + (cos * sc + offset * s) * 2.0 - sd * 2.0;
        let on_cos = cos * cc + offset * c * 2.0 - cd * 2.0;
        let on_one = offset * self.count as f64 - d * 2.0;
        let rss = (dd + sin * on_sin + cos * on_cos + offset * on_one).value();
        // Rounding may make it slightly negative; NaN has to stay NaN.
        if rss < 0.0 { 0.0 } else { rss }
    }

    /// The variance of the readings around the sine through them, if one sine describes the window and each of its segments.
    fn describes(&self, window: &[Self], limit: f64) -> bool {
        let Some((sin, cos, offset, rss)) = self.solve() else {
            return false;
        };
        let within = |rss: f64, dof: f64, factor: f64| rss <= dof * limit * limit * (1.0 + factor * (2.0 / dof).sqrt());
        self.count > 3
            && within(rss, (self.count - 3) as f64, WINDOW_FACTOR)
            && window.iter().all(|segment| {
                let dof = segment.count as f64;
                segment.count == 0 || within(segment.rss_of(sin, cos, offset - segment.reference), dof, SEGMENT_FACTOR)
            })
    }
}

/// The longest run of consecutive segments which one sine describes; of equally long ones the first. None where there is none
/// of at least `least` segments.
///
/// The residual standard deviation of the run, and of every segment around the sine of the run, must not exceed `tolerance`
/// times `floor_std` (unit of the readings, the noise of undamaged settings) by more than chance allows. A run neither starts
/// nor ends with an empty segment. Only what changes the residuals is seen: a slip of the phase which is small next to the
/// noise over the amplitude passes, and does as little to the result.
pub fn coherent(segments: &[Sums], floor_std: f64, tolerance: f64, least: usize) -> Option<Range<usize>> {
    let limit = floor_std * tolerance;
    let mut best: Option<Range<usize>> = None;
    for start in 0..segments.len() {
        let longest = best.as_ref().map_or(least.max(1) - 1, Range::len);
        if segments.len() - start <= longest {
            break;
        }
        if segments[start].count == 0 {
            continue;
        }
        let mut total = Sums::new(segments[start].reference);
        let merged: Vec<Sums> = segments[start..]
            .iter()
            .map(|segment| {
                total.merge(segment);
                total
            })
            .collect();
        let ends = (start + longest + 1..=segments.len()).rev().filter(|end| segments[end - 1].count > 0);
        let mut runs = ends.map(|end| start..end);
        best = runs.find(|run| merged[run.len() - 1].describes(&segments[run.clone()], limit)).or(best);
    }
    best
}
