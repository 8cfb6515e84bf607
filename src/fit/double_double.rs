//! Double-double arithmetic: an unevaluated sum of two `f64`, about 32 decimal digits.
//!
//! Only what iterative refinement and the change of polynomial basis need. The low part of very small numbers underflows
//! gradually, so results near `f64::MIN_POSITIVE` carry single precision only.

use std::ops::{Add, AddAssign, Div, Mul, Neg, Sub};

use nalgebra::DMatrix;

/// An unevaluated sum `hi + lo` with `|lo| <= ulp(hi) / 2`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DoubleDouble {
    /// The value rounded to `f64`.
    pub hi: f64,
    /// What `hi` lacks of the exact value.
    pub lo: f64,
}

/// Sum and its exact rounding error, for any `a` and `b`.
pub fn two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    let b_part = sum - a;
    (sum, (a - (sum - b_part)) + (b - b_part))
}

/// Sum and its exact rounding error where `|a| >= |b|`.
fn quick_two_sum(a: f64, b: f64) -> (f64, f64) {
    let sum = a + b;
    (sum, b - (sum - a))
}

/// A number as the sum of two of 26 bits.
fn split(a: f64) -> (f64, f64) {
    let scaled = 134_217_729.0 * a;
    let high = scaled - (scaled - a);
    (high, a - high)
}

/// Product and its exact rounding error, for numbers below 1e300. Compilers call a function for `mul_add` where not every processor has it.
fn two_prod(a: f64, b: f64) -> (f64, f64) {
    let product = a * b;
    let ((a_high, a_low), (b_high, b_low)) = (split(a), split(b));
    (product, ((a_high * b_high - product) + a_high * b_low + a_low * b_high) + a_low * b_low)
}

impl DoubleDouble {
    /// The number one.
    pub const ONE: Self = Self { hi: 1.0, lo: 0.0 };

    /// The exact sum of two `f64`.
    pub fn sum(a: f64, b: f64) -> Self {
        let (hi, lo) = two_sum(a, b);
        Self { hi, lo }
    }

    /// The nearest `f64`.
    pub fn value(self) -> f64 {
        self.hi + self.lo
    }
}

impl From<f64> for DoubleDouble {
    fn from(hi: f64) -> Self {
        Self { hi, lo: 0.0 }
    }
}

impl Neg for DoubleDouble {
    type Output = Self;

    fn neg(self) -> Self {
        Self { hi: -self.hi, lo: -self.lo }
    }
}

impl Add for DoubleDouble {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        let (high, high_error) = two_sum(self.hi, other.hi);
        let (low, low_error) = two_sum(self.lo, other.lo);
        // Two renormalisations keep the relative error small even where the high parts cancel.
        let (high, rest) = quick_two_sum(high, high_error + low);
        let (hi, lo) = quick_two_sum(high, rest + low_error);
        Self { hi, lo }
    }
}

impl AddAssign for DoubleDouble {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for DoubleDouble {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        self + -other
    }
}

impl Mul for DoubleDouble {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        let (product, error) = two_prod(self.hi, other.hi);
        let (hi, lo) = quick_two_sum(product, error + (self.hi * other.lo + self.lo * other.hi));
        Self { hi, lo }
    }
}

impl Mul<f64> for DoubleDouble {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        let (product, error) = two_prod(self.hi, factor);
        let (hi, lo) = quick_two_sum(product, self.lo.mul_add(factor, error));
        Self { hi, lo }
    }
}

impl Div<f64> for DoubleDouble {
    type Output = Self;

    /// Long division with three partial quotients; division by zero gives no finite number.
    fn div(self, divisor: f64) -> Self {
        let divisor_exact = Self::from(divisor);
        let first = self.hi / divisor;
        let rest = self - divisor_exact * first;
        let second = rest.hi / divisor;
        let rest = rest - divisor_exact * second;
        let (hi, lo) = quick_two_sum(first, second);
        Self { hi, lo } + Self::from(rest.hi / divisor)
    }
}

/// The product of two matrices.
pub fn product(a: &DMatrix<DoubleDouble>, b: &DMatrix<DoubleDouble>) -> DMatrix<DoubleDouble> {
    let mut product = DMatrix::from_element(a.nrows(), b.ncols(), DoubleDouble::default());
    add_product(&mut product, a, b);
    product
}

/// Adds the product of two matrices to a third, column after column.
pub fn add_product(sum: &mut DMatrix<DoubleDouble>, a: &DMatrix<DoubleDouble>, b: &DMatrix<DoubleDouble>) {
    let rows = a.nrows();
    if rows == 0 {
        return;
    }
    for (sum, factors) in sum.as_mut_slice().chunks_exact_mut(rows).zip(b.column_iter()) {
        for (column, &factor) in a.as_slice().chunks_exact(rows).zip(factors.iter()) {
            sum.iter_mut().zip(column).for_each(|(sum, &entry)| *sum += entry * factor);
        }
    }
}

/// Adds the product of a transposed matrix and another to a third, column after column.
pub fn add_transposed_product(sum: &mut DMatrix<DoubleDouble>, a: &DMatrix<DoubleDouble>, b: &DMatrix<DoubleDouble>) {
    /// Every sum waits for its last term, so that some of them go side by side.
    const TOGETHER: usize = 4;
    let rows = a.nrows();
    for c in 0..b.ncols() {
        let factors = &b.as_slice()[c * rows..(c + 1) * rows];
        for first in (0..a.ncols()).step_by(TOGETHER) {
            let column = |k: usize| &a.as_slice()[(first + k) * rows..(first + k + 1) * rows];
            if first + TOGETHER <= a.ncols() {
                let columns: [&[DoubleDouble]; TOGETHER] = std::array::from_fn(column);
                let mut sums: [DoubleDouble; TOGETHER] = std::array::from_fn(|k| sum[(first + k, c)]);
                for (row, &factor) in factors.iter().enumerate() {
                    (0..TOGETHER).for_each(|k| sums[k] += columns[k][row] * factor);
                }
                (0..TOGETHER).for_each(|k| sum[(first + k, c)] = sums[k]);
            } else {
                for k in 0..a.ncols() - first {
                    let own = &mut sum[(first + k, c)];
                    column(k).iter().zip(factors).for_each(|(&entry, &factor)| *own += entry * factor);
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const THIRD: DoubleDouble = DoubleDouble { hi: 0.3333333333333333, lo: 1.850371707708594e-17 };
    const SEVENTH: DoubleDouble = DoubleDouble { hi: 0.14285714285714285, lo: 7.93016446160826e-18 };

    /// Asserts that `x` agrees with `hi + lo` to 31 digits.
    fn assert_close(x: DoubleDouble, hi: f64, lo: f64) {
        let error = x - DoubleDouble { hi, lo };
        assert!(error.hi.abs() <= 1e-31 * hi.abs(), "{x:?} is not {hi:e} + {lo:e}");
    }

    #[test]
    fn errors_of_sums_and_products_are_exact() {
        let tiny = f64::EPSILON / 4.0;
        assert_eq!(two_sum(1.0, tiny), (1.0, tiny));
        assert_eq!(two_sum(tiny, 1.0), (1.0, tiny));
        assert_eq!(quick_two_sum(1.0, tiny), (1.0, tiny));
        // 2⁵³ + 3 is a tie that rounds up to 2⁵³ + 4.
        assert_eq!(two_sum(3.0, 9_007_199_254_740_992.0), (9_007_199_254_740_996.0, -1.0));
        // (1 + e)² = 1 + 2e + e², the last term is below the last digit.
        let e = f64::EPSILON;
        assert_eq!(two_prod(1.0 + e, 1.0 + e), (1.0 + 2.0 * e, e * e));
        // 134217729² = 2⁵⁴ + 2²⁸ + 1.
        assert_eq!(two_prod(134_217_729.0, 134_217_729.0), (18_014_398_777_917_440.0, 1.0));
    }

    #[test]
    fn operations_keep_31_digits() {
        assert_close(THIRD + SEVENTH, 0.47619047619047616, 2.6433881538694202e-17);
        assert_close(THIRD - SEVENTH, 0.19047619047619047, 1.057355261547768e-17);
        assert_close(THIRD * SEVENTH, 0.047619047619047616, 2.64338815386942e-18);
        assert_close(THIRD * 2.0 / 7.0, 0.09523809523809523, 5.28677630773884e-18);
        assert_close(DoubleDouble::from(1.0) / 7.0, SEVENTH.hi, SEVENTH.lo);
        let pi = DoubleDouble { hi: std::f64::consts::PI, lo: 1.2246467991473532e-16 };
        assert_close(pi / 1e-3, 3141.5926535897934, -1.987282392965626e-13);
    }

    #[test]
    fn cancellation_leaves_the_low_parts() {
        let x = DoubleDouble::sum(1.0, 1e-20);
        assert_eq!((x - DoubleDouble::ONE).value(), 1e-20);
        assert_eq!((-x + x).value(), 0.0);
    }

    #[test]
    fn a_sum_of_many_terms_loses_nothing() {
        // 0.1 is not binary: ten thousand times its exact value is 1000 + 10000 (0.1 - 1/10).
        let mut sum = DoubleDouble::default();
        for _ in 0..10_000 {
            sum += DoubleDouble::from(0.1);
        }
        let exact = DoubleDouble::from(0.1) * 10_000.0;
        assert!((sum - exact).value().abs() < 1e-27);
        assert!((exact - DoubleDouble::from(1000.0)).value() - 5.551115123125783e-14 < 1e-28);
    }

    #[test]
    fn products_of_matrices_keep_what_f64_loses() {
        // (1 + e)² - 1 - 2 e = e² for e = 2⁻⁴⁰.
        let e = 2f64.powi(-40);
        let row = |values: [f64; 3]| DMatrix::from_row_slice(1, 3, &values.map(DoubleDouble::from));
        let (a, b) = (row([1.0 + e, -1.0, -2.0]), row([1.0 + e, 1.0, e]));
        assert_eq!(product(&a, &b.transpose())[(0, 0)].value(), e * e);
        let mut sum = DMatrix::from_element(1, 1, DoubleDouble::ONE);
        add_transposed_product(&mut sum, &a.transpose(), &b.transpose());
        assert_eq!(sum[(0, 0)], DoubleDouble::sum(1.0, e * e));
    }
}
