//! Minima and roots of functions of one number.

use argmin::core::{CostFunction, Error, Executor};
use argmin::solver::brent::BrentOpt;

struct Cost<F>(F);

impl<F: Fn(f64) -> f64> CostFunction for Cost<F> {
    type Param = f64;
    type Output = f64;

    fn cost(&self, at: &f64) -> Result<f64, Error> {
        Ok((self.0)(*at))
    }
}

/// When a search for a minimum stops.
#[derive(Clone, Copy, Debug)]
pub struct Stop {
    /// Relative accuracy of the place.
    pub relative: f64,
    /// Absolute accuracy of the place, which is added.
    pub absolute: f64,
    /// Most steps.
    pub steps: u64,
}

/// The place of a minimum of `cost` between two places by Brent's method. `None` where the search has no answer.
pub fn minimum(cost: impl Fn(f64) -> f64, [low, high]: [f64; 2], stop: Stop) -> Option<f64> {
    let solver = BrentOpt::new(low, high).set_tolerance(stop.relative, stop.absolute);
    let search = Executor::new(Cost(cost), solver).configure(|state| state.max_iters(stop.steps));
    search.timer(false).run().ok()?.state().best_param
}

/// The same by a number of steps that each keep two thirds of the interval. It needs no smoothness, and the place depends
/// on comparisons of costs only, so that it is the same for costs with different rounding.
pub fn minimum_by_thirds(cost: impl Fn(f64) -> f64, [mut low, mut high]: [f64; 2], steps: usize) -> f64 {
    for _ in 0..steps {
        let (left, right) = (low + (high - low) / 3.0, high - (high - low) / 3.0);
        (low, high) = if cost(left) < cost(right) { (low, right) } else { (left, high) };
    }
    0.5 * (low + high)
}

/// The interval in which a condition that holds at its lower end ceases to hold, halved until it is narrower than `relative` times its
/// upper end, or as narrow as doubles allow.
pub fn bisect(holds: impl Fn(f64) -> bool, [mut low, mut high]: [f64; 2], relative: f64) -> [f64; 2] {
    while high - low > relative * high {
        let middle = 0.5 * (low + high);
        if middle <= low || middle >= high {
            break;
        }
        if holds(middle) { low = middle } else { high = middle }
    }
    [low, high]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_parabola_and_a_root_are_found() {
        let cost = |x: f64| (x - 0.3).powi(2);
        let found = minimum(cost, [-1.0, 2.0], Stop { relative: 1e-8, absolute: 1e-9, steps: 100 }).unwrap();
        assert!((found - 0.3).abs() < 1e-7, "{found}");
        assert!((minimum_by_thirds(cost, [-1.0, 2.0], 40) - 0.3).abs() < 1e-6);
        let [low, high] = bisect(|x| x * x < 2.0, [0.0, 2.0], 1e-13);
        assert!(low <= 2f64.sqrt() && 2f64.sqrt() <= high && high - low < 1e-12);
        // An accuracy beyond that of doubles ends the search, too.
        let [low, high] = bisect(|x| x * x < 2.0, [0.0, 2.0], 0.0);
        assert!(high - low <= 4.0 * f64::EPSILON);
    }
}
