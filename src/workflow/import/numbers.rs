//! Numbers of other units, and how many decimals they need.

use crate::files::import::mapping::TemperatureUnit;

/// Decimals of a run file at most: then every number from a tenth on is written to its last bit.
const MOST_DECIMALS: usize = 17;

/// A value in another unit. A decimal number of up to fifteen digits stays one: 0.0123 µT is 12.3 nT and not its neighbour.
pub(super) fn scaled(value: f64, factor: f64) -> f64 {
    if factor == 1.0 || !value.is_finite() { value } else { fifteen_digits(value * factor) }
}

/// A temperature in °C.
pub(super) fn celsius(value: f64, unit: TemperatureUnit) -> f64 {
    let degc = match unit {
        TemperatureUnit::Celsius => return value,
        TemperatureUnit::Kelvin => value - 273.15,
        TemperatureUnit::Fahrenheit => (value - 32.0) / 1.8,
    };
    if degc.is_finite() { (degc * 1e9).round() / 1e9 } else { degc }
}

/// The number of fifteen digits nearest to a value.
fn fifteen_digits(value: f64) -> f64 {
    format!("{value:.14e}").parse().unwrap_or(value)
}

/// The least number of decimals with which all values are written without loss, as far as decimals can.
pub(super) fn decimals(values: impl Iterator<Item = f64>) -> usize {
    let mut most = 0;
    for value in values.filter(|v| v.is_finite()) {
        while most < MOST_DECIMALS && !is_exact(value, most) {
            most += 1;
        }
    }
    most
}

/// Whether a number is one with so many decimals.
fn is_exact(value: f64, decimals: usize) -> bool {
    /// Larger numbers are no exact products.
    const EXACT: f64 = 9_007_199_254_740_992.0;
    let power = 10f64.powi(decimals as i32);
    let product = (value * power).round();
    // A whole number divided by a power of ten is rounded correctly, so it is the number that the text gives.
    if product.abs() < EXACT { product / power == value } else { format!("{value:.decimals$}").parse() == Ok(value) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn units_keep_decimal_numbers() {
        for (value, nt) in [(0.0123, 12.3), (1.234_567_8, 1234.5678), (-54.214_43, -54214.43)] {
            assert_eq!(scaled(value, 1000.0), nt);
        }
        assert_eq!(celsius(295.65, TemperatureUnit::Kelvin), 22.5);
        assert_eq!(celsius(72.5, TemperatureUnit::Fahrenheit), 22.5);
        assert!(scaled(f64::NAN, 1000.0).is_nan());
    }

    #[test]
    fn decimals_are_those_that_were_written() {
        for (value, expected) in
            [(0.0, 0), (1.5, 1), (0.0078, 4), (-54552.286058, 6), (0.1 + 0.2, 17), (3.0172792096032395, 16), (1e15, 0)]
        {
            assert_eq!(decimals(std::iter::once(value)), expected, "{value}");
        }
        assert_eq!(decimals([1.0, 0.25, 7.5, f64::NAN].into_iter()), 2);
    }
}
