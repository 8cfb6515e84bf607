//! Quantiles, tails and robust statistics: one definition of each, the distributions from statrs.

use std::f64::consts::SQRT_2;

use super::scalar::bisect;
use statrs::distribution::{ChiSquared, ContinuousCDF, FisherSnedecor, StudentsT};
use statrs::function::erf::{erfc, erfc_inv};
use statrs::function::gamma::{gamma_ur, ln_gamma};

/// Standard deviations that hold 95 % of a normal distribution.
pub const NORMAL_95: f64 = 1.959_963_984_540_054;

/// Degrees of freedom from which on a quantile of χ² is that of Wilson and Hilferty, then good to 1e-9: the incomplete gamma function takes
/// as many terms as the square root of their number.
const MANY: f64 = 1e6;

/// Standard deviations that hold 95 % of Student's distribution; infinite without a degree of freedom.
#[must_use]
pub fn student_95(dof: usize) -> f64 {
    // statrs inverts this distribution to 1e-4 only where there are very many degrees of freedom; its tail is exact.
    let upper = |distribution: StudentsT| bisect(|t| distribution.sf(t) > 0.025, [1.0, 13.0], f64::EPSILON)[1];
    StudentsT::new(0.0, 1.0, dof as f64).map_or(f64::INFINITY, upper)
}

/// Factor on a standard uncertainty with so many degrees of freedom, by which 1.96 of it make an interval of 95 %.
#[must_use]
pub fn student_factor(dof: usize) -> f64 {
    student_95(dof) / NORMAL_95
}

/// Probability that a number of Student's distribution exceeds `t`; `None` without a degree of freedom.
#[must_use]
pub fn student_tail(t: f64, dof: usize) -> Option<f64> {
    StudentsT::new(0.0, 1.0, dof as f64).ok().map(|distribution| distribution.sf(t))
}

/// Probability that a number of Fisher's F distribution with two degrees of freedom exceeds `f`; 1 without a degree of freedom.
#[must_use]
pub fn fisher_tail(f: f64, [numerator, denominator]: [f64; 2]) -> f64 {
    FisherSnedecor::new(numerator, denominator).map_or(1.0, |distribution| distribution.sf(f))
}

/// Probability that a standard normal number is farther from zero than `x`, which is not negative.
#[must_use]
pub fn two_sided_tail(x: f64) -> f64 {
    erfc(x / SQRT_2)
}

/// Probability that χ² with `dof` degrees of freedom, which need not be a whole number, exceeds `chi2`; 1 without a degree of
/// freedom.
#[must_use]
pub fn chi2_tail(chi2: f64, dof: f64) -> f64 {
    ChiSquared::new(dof).map_or(1.0, |distribution| distribution.sf(chi2))
}

/// The value that χ² with `dof` degrees of freedom, which need not be a whole number, stays below with a probability between 0
/// and 1; 0 without a degree of freedom.
#[must_use]
pub fn chi2_quantile(dof: f64, probability: f64) -> f64 {
    if dof > MANY {
        let (spread, normal) = (2.0 / (9.0 * dof), SQRT_2 * erfc_inv(2.0 * (1.0 - probability)));
        return dof * (1.0 - spread + normal * spread.sqrt()).powi(3);
    }
    ChiSquared::new(dof).map_or(0.0, |distribution| distribution.inverse_cdf(probability))
}

/// Logarithm of the probability that χ² with `dof` degrees of freedom exceeds `chi2`, also where the probability itself is too
/// small for a double.
#[must_use]
pub fn log_chi2_tail(chi2: f64, dof: f64) -> f64 {
    let direct = if chi2 <= 0.0 {
        1.0
    } else if chi2 < 1300.0 {
        gamma_ur(0.5 * dof, 0.5 * chi2)
    } else {
        0.0
    };
    // statrs has no logarithm of a tail. Here the first term of the asymptotic series of the incomplete gamma function is enough.
    if direct > 1e-280 { direct.ln() } else { (0.5 * dof - 1.0) * (0.5 * chi2).ln() - 0.5 * chi2 - ln_gamma(0.5 * dof) }
}

/// The standard deviation of a variance: zero of one that rounding made negative, and nan of one that nothing tells, which `max` would turn into zero.
pub fn std_of(variance: f64) -> f64 {
    if variance < 0.0 { 0.0 } else { variance.sqrt() }
}

/// Logarithm of the sum of numbers that are given by their logarithms.
#[must_use]
pub fn log_sum(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
    if most.is_finite() { most + values.map(|v| (v - most).exp()).sum::<f64>().ln() } else { most }
}

/// The median, which of an even number of values is the upper of the two in the middle; NaN of nothing. It reorders the values.
#[must_use]
pub fn median(values: &mut [f64]) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() {
        return f64::NAN;
    }
    *values.select_nth_unstable_by(middle, f64::total_cmp).1
}

/// The median, which of an even number of values is the mean of the two in the middle; NaN of nothing. It reorders the values.
#[must_use]
pub fn central_median(values: &mut [f64]) -> f64 {
    let upper = median(values);
    if values.len() % 2 == 1 || values.is_empty() {
        return upper;
    }
    let lower = values[..values.len() / 2].iter().copied().max_by(f64::total_cmp).unwrap_or(upper);
    0.5 * (lower + upper)
}

/// The standard deviation of normal values about zero that a minority of others does not move, by the median of their magnitudes; NaN of nothing.
#[must_use]
pub fn robust_std(values: impl IntoIterator<Item = f64>) -> f64 {
    const NORMAL_STD_OF_MEDIAN: f64 = 1.482_602_218_505_602;
    NORMAL_STD_OF_MEDIAN * median(&mut values.into_iter().map(f64::abs).collect::<Vec<f64>>())
}

/// The smallest and the largest value; of nothing, plus and minus infinity.
pub fn extremes(values: impl IntoIterator<Item = f64>) -> [f64; 2] {
    values.into_iter().fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
}

/// Slope of the straight line through points, (x, y), by least squares; 0 where all stand at one x.
pub fn slope(points: &[(f64, f64)]) -> f64 {
    let n = points.len() as f64;
    let (x, y) = points.iter().fold((0.0, 0.0), |(a, b), (x, y)| (a + x / n, b + y / n));
    let (xy, xx) = points.iter().fold((0.0, 0.0), |(a, b), (u, v)| (a + (u - x) * (v - y), b + (u - x).powi(2)));
    if xx > 0.0 { xy / xx } else { 0.0 }
}

/// The largest value minus the smallest; 0 of nothing.
pub fn extent(values: impl IntoIterator<Item = f64>) -> f64 {
    let [low, high] = extremes(values);
    (high - low).max(0.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn student_quantiles_join_and_end_at_the_normal_one() {
        // Tables: 11 degrees of freedom 2.201, 30 degrees 2.042.
        assert!((student_95(11) - 2.201).abs() < 1e-3 && (student_95(30) - 2.042).abs() < 1e-3);
        assert!((student_95(1_000_000) - NORMAL_95).abs() < 1e-5);
        assert!((1..200).all(|dof| student_95(dof + 1) < student_95(dof)));
        // One degree of freedom is Cauchy's distribution: tan(0.475 π). Without one there is no interval.
        assert!((student_95(1) - (0.475 * std::f64::consts::PI).tan()).abs() < 1e-9);
        assert!(student_95(0).is_infinite());
    }

    #[test]
    fn tails_of_the_normal_distribution() {
        for (x, tail) in [(0.0, 1.0), (1.0, 0.317_310_5), (NORMAL_95, 0.05), (4.0, 6.334e-5)] {
            assert!((two_sided_tail(x) - tail).abs() < 2e-7, "{x}");
        }
        assert!((two_sided_tail(NORMAL_95) - 0.05).abs() < 1e-11);
    }

    #[test]
    fn chi_squares_agree_with_their_closed_forms() {
        // Two degrees of freedom are an exponential distribution, one is a squared normal number.
        assert!((chi2_quantile(2.0, 0.99) + 2.0 * 0.01_f64.ln()).abs() < 1e-9);
        assert!((chi2_quantile(1.0, 0.95) - NORMAL_95 * NORMAL_95).abs() < 1e-9);
        assert!((chi2_tail(NORMAL_95 * NORMAL_95, 1.0) - 0.05).abs() < 1e-12);
        assert_eq!((chi2_tail(3.0, 0.0), chi2_quantile(0.0, 0.99)), (1.0, 0.0));
        for chi2 in [1.0, 100.0, 1200.0, 1e4] {
            assert!((log_chi2_tail(chi2, 2.0) + 0.5 * chi2).abs() < 1e-9 * chi2, "{chi2}");
        }
        assert_eq!(log_chi2_tail(0.0, 3.0), 0.0);
        for probability in [0.025, 0.5, 0.99] {
            let [below, above] = [0.999_999 * MANY, 1.000_001 * MANY].map(|dof| chi2_quantile(dof, probability) / dof);
            assert!((below - above).abs() < 1e-8, "{below} {above}");
        }
    }

    #[test]
    fn medians_and_extremes() {
        assert_eq!((median(&mut [3.0, 1.0, 2.0]), central_median(&mut [3.0, 1.0, 2.0])), (2.0, 2.0));
        assert_eq!((median(&mut [4.0, 1.0, 2.0, 3.0]), central_median(&mut [4.0, 1.0, 2.0, 3.0])), (3.0, 2.5));
        assert!(median(&mut []).is_nan() && central_median(&mut []).is_nan());
        assert_eq!((extremes([2.0, -1.0]), extent([2.0, -1.0]), extent([])), ([-1.0, 2.0], 3.0, 0.0));
    }
}
