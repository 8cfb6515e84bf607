//! Level J: what two sensors have in common, from means at common times (RO-IGEP-TR0028, section 4.11, which names no algorithm).
//!
//! [`principal`] looks along the first principal axis of the readings of both sensors, component by component, with gain one for what
//! both see alike. Noise of the spacecraft is seen by both sensors too, stronger by the inner one; then the outboard sensor alone is
//! better than the common part. [`gradiometer`] takes that noise away where the matrix M is known by which it is stronger at
//! the inboard sensor.

use crate::model::field_calibration::turned;
use nalgebra::{Matrix3, Vector3};

/// Weight of what both sensors see alike on the principal axis, below which readings have nothing in common; it is the root of 2 for
/// equal readings.
const LEAST_COMMON: f64 = 1e-6;
/// Largest condition of M - 1.
const MAX_CONDITION: f64 = 1e6;

/// Why there is no common part.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum TwoSensorsError {
    /// The sensors do not have the same number of means.
    #[error("the means of both sensors are taken at common times, but OB has {outboard} and IB has {inboard}")]
    Length { outboard: usize, inboard: usize },
    /// There is no axis in fewer than two pairs.
    #[error("component {component}: {pairs} times at which both sensors have a mean; at least 2 are needed")]
    TooFew { component: char, pairs: usize },
    /// The readings do not change, or change against each other.
    #[error("component {component}: the readings of the sensors have no common part (principal axis {axis:?})")]
    NothingCommon { component: char, axis: [f64; 2] },
    /// The coupling does not tell the field from the noise.
    #[error("M - 1 is singular (condition {condition:.1e}): noise that is equal at both sensors cannot be told from the field")]
    Coupling { condition: f64 },
}

/// Common part of both sensors and the rest of each, NaN where a sensor has no mean.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parts {
    /// What both see, nT.
    pub common_nt: [Vec<f64>; 3],
    /// OB less the common part, nT.
    pub own_outboard_nt: [Vec<f64>; 3],
    /// IB less the common part, nT.
    pub own_inboard_nt: [Vec<f64>; 3],
    /// The common part is the first matrix times OB, plus the second one times IB, plus a constant.
    pub weights: [Matrix3<f64>; 2],
}

/// The principal axis of one component.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axis {
    /// Its direction in (OB, IB), a unit vector with a positive sum.
    pub direction: [f64; 2],
    /// Share of the variance of both that lies along it.
    pub share: f64,
    /// Correlation of both sensors.
    pub correlation: f64,
    /// Means of OB and IB over the interval, nT.
    pub mean_nt: [f64; 2],
    /// Times at which both have a mean.
    pub pairs: usize,
}

/// Places of equal times in two series that rise: index in the first, index in the second.
#[must_use]
pub fn common_times(outboard_tt2000: &[i64], inboard_tt2000: &[i64]) -> Vec<[usize; 2]> {
    let (mut i, mut j) = (0, 0);
    let mut pairs = Vec::new();
    while let (Some(a), Some(b)) = (outboard_tt2000.get(i), inboard_tt2000.get(j)) {
        match a.cmp(b) {
            std::cmp::Ordering::Less => i += 1,
            std::cmp::Ordering::Greater => j += 1,
            std::cmp::Ordering::Equal => {
                pairs.push([i, j]);
                (i, j) = (i + 1, j + 1);
            }
        }
    }
    pairs
}

/// Common part along the principal axis of every component, over all that is given: a day or an interval.
///
/// With e the first eigenvector of the covariance of (OB, IB) and x their deviations from their means, the common part is
/// `(e·x) / (e_1 + e_2) + (mean_OB + mean_IB) / 2`. Times without both means do not count for mean and covariance.
///
/// # Errors
///
/// [`TwoSensorsError`].
pub fn principal(outboard_nt: [&[f64]; 3], inboard_nt: [&[f64]; 3]) -> Result<(Parts, [Axis; 3]), TwoSensorsError> {
    check_lengths(outboard_nt, inboard_nt)?;
    let mut parts = Parts::default();
    let mut axes = Vec::with_capacity(3);
    for c in 0..3 {
        let pairs = || outboard_nt[c].iter().zip(inboard_nt[c]).map(|(o, i)| [*o, *i]);
        let axis = axis(pairs().filter(|pair| pair.iter().all(|v| v.is_finite())), ['x', 'y', 'z'][c])?;
        let [e, m] = [axis.direction, axis.mean_nt];
        let middle = 0.5 * (m[0] + m[1]);
        let common = |[o, i]: [f64; 2]| (e[0] * (o - m[0]) + e[1] * (i - m[1])) / (e[0] + e[1]) + middle;
        parts.common_nt[c] = pairs().map(common).collect();
        (0..2).for_each(|sensor| parts.weights[sensor][(c, c)] = e[sensor] / (e[0] + e[1]));
        axes.push(axis);
    }
    parts.subtract(outboard_nt, inboard_nt);
    // Three components make three axes.
    Ok((parts, [axes[0], axes[1], axes[2]]))
}

fn axis(pairs: impl Iterator<Item = [f64; 2]> + Clone, component: char) -> Result<Axis, TwoSensorsError> {
    let count = pairs.clone().count();
    if count < 2 {
        return Err(TwoSensorsError::TooFew { component, pairs: count });
    }
    let n = count as f64;
    let sum = pairs.clone().fold([0.0; 2], |sum, pair| [sum[0] + pair[0], sum[1] + pair[1]]);
    let mean_nt = sum.map(|s| s / n);
    let [oo, oi, ii] = pairs.fold([0.0; 3], |[oo, oi, ii], pair| {
        let [o, i] = [pair[0] - mean_nt[0], pair[1] - mean_nt[1]];
        [oo + o * o / n, oi + o * i / n, ii + i * i / n]
    });
    // The axis of a symmetric matrix of two rows stands at half the angle of (oo - ii, 2 oi).
    let (sine, cosine) = (0.5 * (2.0 * oi).atan2(oo - ii)).sin_cos();
    let sign = if sine + cosine < 0.0 { -1.0 } else { 1.0 };
    let direction = [sign * cosine, sign * sine];
    let largest = 0.5 * (oo + ii + (oo - ii).hypot(2.0 * oi));
    if !(oo + ii > 0.0 && direction[0] + direction[1] > LEAST_COMMON) {
        return Err(TwoSensorsError::NothingCommon { component, axis: direction });
    }
    Ok(Axis { direction, share: largest / (oo + ii), correlation: oi / (oo * ii).sqrt(), mean_nt, pairs: count })
}

/// Common part of two sensors where the noise at IB is `coupling` times that at OB: `(M - 1)⁻¹ (M OB - IB)`. A vector with a component
/// that is not there has no common part.
///
/// # Errors
///
/// [`TwoSensorsError::Length`], and [`TwoSensorsError::Coupling`] where M - 1 has no inverse.
pub fn gradiometer(outboard_nt: [&[f64]; 3], inboard_nt: [&[f64]; 3], coupling: [[f64; 3]; 3]) -> Result<Parts, TwoSensorsError> {
    check_lengths(outboard_nt, inboard_nt)?;
    let m = Matrix3::from_fn(|i, j| coupling[i][j]);
    let excess = m - Matrix3::identity();
    let values = excess.singular_values();
    let condition = values.max() / values.min();
    let inverse = excess.try_inverse().filter(|_| condition < MAX_CONDITION);
    let inverse = inverse.ok_or(TwoSensorsError::Coupling { condition })?;
    let at = |sensor: [&[f64]; 3], row: usize| Vector3::new(sensor[0][row], sensor[1][row], sensor[2][row]);
    let mut parts = Parts { weights: [inverse * m, -inverse], ..Parts::default() };
    for row in 0..outboard_nt[0].len() {
        let common = inverse * (m * at(outboard_nt, row) - at(inboard_nt, row));
        let whole = common.iter().all(|v| v.is_finite());
        for c in 0..3 {
            parts.common_nt[c].push(if whole { common[c] } else { f64::NAN });
        }
    }
    parts.subtract(outboard_nt, inboard_nt);
    Ok(parts)
}

fn check_lengths(outboard_nt: [&[f64]; 3], inboard_nt: [&[f64]; 3]) -> Result<(), TwoSensorsError> {
    let outboard = outboard_nt[0].len();
    match outboard_nt.iter().chain(&inboard_nt).find(|values| values.len() != outboard) {
        Some(other) => Err(TwoSensorsError::Length { outboard, inboard: other.len() }),
        None => Ok(()),
    }
}

impl Parts {
    /// Covariances of the common part, of the rest of OB and of the rest of IB, nT², row by row in the order of [`SYMMETRIC`], from those of
    /// both sensors, which are independent of each other. The weights are taken for exact.
    ///
    /// [`SYMMETRIC`]: crate::model::field_calibration::SYMMETRIC
    #[must_use]
    pub fn covariances_nt2(&self, outboard_nt2: &[[f64; 6]], inboard_nt2: &[[f64; 6]]) -> [Vec<[f64; 6]>; 3] {
        let [outboard, inboard] = self.weights;
        let rest = |weight: Matrix3<f64>| Matrix3::identity() - weight;
        [[outboard, inboard], [rest(outboard), inboard], [outboard, rest(inboard)]].map(|[a, b]| {
            let both = outboard_nt2.iter().zip(inboard_nt2).map(|(o, i)| (turned(&a, o), turned(&b, i)));
            both.map(|(o, i)| std::array::from_fn(|place| o[place] + i[place])).collect()
        })
    }

    fn subtract(&mut self, outboard_nt: [&[f64]; 3], inboard_nt: [&[f64]; 3]) {
        for c in 0..3 {
            let less = |sensor: &[f64]| sensor.iter().zip(&self.common_nt[c]).map(|(b, common)| b - common).collect();
            (self.own_outboard_nt[c], self.own_inboard_nt[c]) = (less(outboard_nt[c]), less(inboard_nt[c]));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    type Sensor = [Vec<f64>; 3];

    fn slices(sensor: &Sensor) -> [&[f64]; 3] {
        sensor.each_ref().map(Vec::as_slice)
    }

    /// Field, OB and IB where the noise of the spacecraft is M times stronger at IB.
    fn sensors(coupling: [[f64; 3]; 3], rows: usize) -> [Sensor; 3] {
        let mut random = Random::seeded(11);
        let mut out: [Sensor; 3] = Default::default();
        for row in 0..rows {
            let noise: [f64; 3] = std::array::from_fn(|_| 0.3 * random.gaussian());
            for c in 0..3 {
                let field = (0.01 * row as f64 + c as f64).sin() + 2.0 * c as f64;
                let strong: f64 = (0..3).map(|k| coupling[c][k] * noise[k]).sum();
                for (sensor, value) in out.iter_mut().zip([field, field + noise[c], field + strong]) {
                    sensor[c].push(value);
                }
            }
        }
        out
    }

    #[test]
    fn the_principal_axis_is_that_of_an_ellipse() {
        // Points on a closed ellipse with half axes 2 and 1/2 at 30°: variances 2 and 1/8, share 16/17.
        let (sine, cosine) = (std::f64::consts::PI / 6.0).sin_cos();
        let points = (0..360).map(|i| f64::from(i).to_radians()).map(|t| {
            let (long, short) = (2.0 * t.cos(), 0.5 * t.sin());
            [10.0 + cosine * long - sine * short, 4.0 + sine * long + cosine * short]
        });
        let mut outboard: Vec<f64> = points.clone().map(|p| p[0]).collect();
        let mut inboard: Vec<f64> = points.map(|p| p[1]).collect();
        // Nulls of either sensor.
        outboard.splice(7..7, [f64::NAN, 1e6]);
        inboard.splice(7..7, [1e6, f64::NAN]);
        let (parts, axes) = principal([&outboard; 3], [&inboard; 3]).unwrap();
        for axis in axes {
            assert!((axis.direction[0] - cosine).abs() < 1e-14 && (axis.direction[1] - sine).abs() < 1e-14);
            assert!((axis.share - 16.0 / 17.0).abs() < 1e-14 && axis.pairs == 360);
            // Covariance (2 - 1/8) sin cos over the root of the product of the variances.
            let [oo, ii] = [2.0 * 0.75 + 0.125 * 0.25, 2.0 * 0.25 + 0.125 * 0.75];
            assert!((axis.correlation - 1.875 * sine * cosine / f64::sqrt(oo * ii)).abs() < 1e-14);
            assert!((axis.mean_nt[0] - 10.0).abs() < 1e-13 && (axis.mean_nt[1] - 4.0).abs() < 1e-13);
        }
        // At t = 0 both deviate by (2 cos 30°, 2 sin 30°), which is 2 along the axis.
        for c in 0..3 {
            assert!((parts.common_nt[c][0] - (7.0 + 2.0 / (cosine + sine))).abs() < 1e-13);
            assert!((parts.own_outboard_nt[c][0] + parts.common_nt[c][0] - outboard[0]).abs() < 1e-14);
            assert!((parts.own_inboard_nt[c][0] + parts.common_nt[c][0] - inboard[0]).abs() < 1e-14);
            assert!([7, 8].iter().all(|i| parts.common_nt[c][*i].is_nan() && parts.own_inboard_nt[c][*i].is_nan()));
        }
    }

    #[test]
    fn what_both_see_alike_has_gain_one() {
        let field: Vec<f64> = (0..50).map(|i| f64::from(i * i % 17)).collect();
        let (parts, axes) = principal([&field; 3], [&field; 3]).unwrap();
        for c in 0..3 {
            assert!(parts.common_nt[c].iter().zip(&field).all(|(a, b)| (a - b).abs() < 1e-13));
            assert!((axes[c].correlation - 1.0).abs() < 1e-14 && (axes[c].share - 1.0).abs() < 1e-14);
        }
    }

    #[test]
    fn noise_that_is_stronger_inboard_makes_the_axis_worse_than_outboard_alone_and_the_gradiometer_exact() {
        let coupling = [[1.53, 0.08, 0.08], [0.08, 1.83, 0.08], [0.08, 0.08, 1.68]];
        let [field, outboard, inboard] = sensors(coupling, 4000);
        let rms = |a: &[f64], b: &[f64]| {
            let mean = a.iter().zip(b).map(|(x, y)| x - y).sum::<f64>() / a.len() as f64;
            (a.iter().zip(b).map(|(x, y)| (x - y - mean).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
        };
        let (parts, _) = principal(slices(&outboard), slices(&inboard)).unwrap();
        let exact = gradiometer(slices(&outboard), slices(&inboard), coupling).unwrap();
        for c in 0..3 {
            assert!(rms(&parts.common_nt[c], &field[c]) > 1.15 * rms(&outboard[c], &field[c]));
            assert!(exact.common_nt[c].iter().zip(&field[c]).all(|(a, b)| (a - b).abs() < 1e-13));
        }
    }

    #[test]
    fn a_null_component_leaves_no_gradiometer() {
        let coupling = [[2.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
        let [_, mut outboard, inboard] = sensors(coupling, 3);
        outboard[1][1] = f64::NAN;
        let parts = gradiometer(slices(&outboard), slices(&inboard), coupling).unwrap();
        assert!((0..3).all(|c| parts.common_nt[c][1].is_nan() && parts.common_nt[c][2].is_finite()));
    }

    #[test]
    fn what_has_no_answer_is_refused() {
        let (one, falling) = ([1.0, 2.0, 3.0], [3.0, 2.0, 1.0]);
        let error = principal([&one; 3], [&one[..2]; 3]).unwrap_err();
        assert_eq!(error, TwoSensorsError::Length { outboard: 3, inboard: 2 });
        let error = principal([&one; 3], [&[f64::NAN, f64::NAN, 1.0]; 3]).unwrap_err();
        assert_eq!(error, TwoSensorsError::TooFew { component: 'x', pairs: 1 });
        let error = principal([&one; 3], [&one, &falling, &one]).unwrap_err();
        assert!(matches!(error, TwoSensorsError::NothingCommon { component: 'y', .. }));
        let error = principal([&[1.0; 3]; 3], [&[1.0; 3]; 3]).unwrap_err();
        assert!(matches!(error, TwoSensorsError::NothingCommon { component: 'x', .. }));
        // Noise along x that is equal at both sensors.
        let coupling = [[1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 2.0]];
        let error = gradiometer([&one; 3], [&one; 3], coupling).unwrap_err();
        assert!(matches!(error, TwoSensorsError::Coupling { .. }));
    }

    #[test]
    fn common_times_are_found_whatever_is_missing() {
        assert_eq!(common_times(&[1, 2, 4, 7, 9], &[0, 2, 3, 7, 9, 10]), [[1, 1], [3, 3], [4, 4]]);
        assert!(common_times(&[1, 2], &[]).is_empty());
    }
}
