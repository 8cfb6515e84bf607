//! Slow noise as a sum of relaxations.

/// Parts of relaxations with these time constants in noise of the power density `f^-exponent`; the sum is one.
pub(super) fn parts(time_constants: &[f64], exponent: f64) -> Vec<f64> {
    let powers: Vec<f64> = time_constants.iter().map(|tau| (tau / time_constants[0]).powf(exponent - 1.0)).collect();
    let sum: f64 = powers.iter().sum();
    powers.into_iter().map(|power| power / sum).collect()
}
