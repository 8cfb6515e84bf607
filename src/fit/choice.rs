//! Choice among models of the same data.

/// Akaike's information criterion with the correction of Hurvich and Tsai for short data: `deviance + 2k + 2k(k+1)/(n-k-1)`.
///
/// `deviance` is -2 ln L of `rows` observations at the maximum; for least squares of unknown variance that is `n ln(rss/n)`, up to a
/// constant. `parameters` counts all that were estimated, variances included. The model with the smallest value is expected to
/// predict best; differences below two mean little. `None` where the correction has no value: `rows <= parameters + 1`.
#[must_use]
pub fn aicc(deviance: f64, parameters: usize, rows: usize) -> Option<f64> {
    let spare = rows.checked_sub(parameters + 1).filter(|spare| *spare > 0)? as f64;
    let k = parameters as f64;
    Some(deviance + 2.0 * k + 2.0 * k * (k + 1.0) / spare)
}

#[cfg(test)]
mod tests {
    use super::aicc;

    #[test]
    fn by_hand() {
        // n = 10, k = 3: 6 + 24 / 6.
        assert_eq!(aicc(-20.0, 3, 10), Some(-10.0));
        assert_eq!(aicc(-20.0, 3, 5), Some(10.0));
        assert_eq!(aicc(-20.0, 3, 4), None);
        assert_eq!(aicc(-20.0, 3, 0), None);
    }
}
