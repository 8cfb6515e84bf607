//! A body that is heated through its surface: it follows the temperature outside with a time constant (mathematics.md section 4).

/// Temperature of the body after a stretch in which the temperature outside went from one value to another in a straight line;
/// `x` is the length of the stretch over the time constant.
#[must_use]
pub fn follow(body: f64, from: f64, to: f64, x: f64) -> f64 {
    let slope = (to - from) / x;
    to - slope + (body - from + slope) * (-x).exp()
}

#[cfg(test)]
mod tests {
    use super::follow;

    #[test]
    fn steps_are_approached_and_ramps_followed_at_a_distance() {
        assert!((follow(0.0, 1.0, 1.0, 2.0) - (1.0 - f64::exp(-2.0))).abs() < 1e-15);
        // After a long ramp the distance is the rise in one time constant.
        assert!((follow(0.0, 0.0, 50.0, 50.0) - 49.0).abs() < 1e-12);
        // Two halves are one whole.
        let half = follow(3.0, 1.0, 2.0, 0.7);
        assert!((follow(half, 2.0, 3.0, 0.7) - follow(3.0, 1.0, 3.0, 1.4)).abs() < 1e-14);
    }
}
