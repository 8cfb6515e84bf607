//! Values that were taken because they are large: what their selection does to them.
//!
//! An effect of true strength μ is seen at `K = μ + noise` and named only where K is beyond a threshold; of those that are named, the
//! weak ones were lucky. Given that, `P(K > k | μ, K > t) = Q(k - μ) / Q(t - μ)` has an interval of 95 % for μ of its own, lower and wider
//! than `k ± 1.96`.

use crate::fit::scalar::bisect;
use crate::fit::statistics::std_of;
use statrs::distribution::{ContinuousCDF, Normal};

/// So far above the threshold selection does not matter.
const FAR: f64 = 5.0;
/// Probabilities at the ends of the interval.
const ENDS: [f64; 2] = [0.025, 0.975];

/// Parameters of one effect, each with its standard uncertainty, which was seen at a strength and would have been named from another one on;
/// both in multiples of the noise. They become the middle of an interval of 95 % that holds although the effect was chosen, and its
/// half width over 1.96.
#[must_use]
pub fn corrected(values: &[(f64, f64)], strength: f64, least: f64) -> Vec<(f64, f64)> {
    let Some([low, high]) = interval(strength, least) else { return values.to_vec() };
    // Just above the threshold the interval shrinks to nothing, which says nothing about the effect.
    let high = high.max(strength);
    let width = ((high - low) / (2.0 * crate::fit::NORMAL_95)).max(1.0);
    let middle = 0.5 * (low + high) / strength;
    // Of the variance of a parameter, the part along the effect itself changes.
    let of = |(value, std): &(f64, f64)| {
        let along = (value / strength).powi(2);
        (middle * value, std_of(std * std + along * (width * width - 1.0)))
    };
    values.iter().map(of).collect()
}

/// Interval of the true strength; `None` where selection does not matter or the strengths are none.
fn interval(strength: f64, least: f64) -> Option<[f64; 2]> {
    if !(least > 0.0 && (least..least + FAR).contains(&strength)) {
        return None;
    }
    let normal = Normal::new(0.0, 1.0).ok()?;
    let above = |mu: f64| normal.sf(strength - mu) / normal.sf(least - mu);
    Some(ENDS.map(|probability| {
        let [low, _] = bisect(|mu| above(mu) < probability, [0.0, strength + FAR], f64::EPSILON);
        low
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    #[test]
    fn what_stands_far_out_stays() {
        assert_eq!(corrected(&[(3.0, 0.2)], 15.0, 4.0), [(3.0, 0.2)]);
        // Just within reach the change is small.
        let [(value, std)] = corrected(&[(8.9, 1.0)], 8.9, 4.0)[..] else { panic!() };
        assert!((value - 8.9).abs() < 1e-2 && (std - 1.0).abs() < 1e-2, "{value} {std}");
    }

    #[test]
    fn what_was_just_named_may_be_anything_up_to_what_was_seen() {
        let [(value, std)] = corrected(&[(4.001, 1.0)], 4.001, 4.0)[..] else { panic!() };
        assert!(value > 0.0 && value < 4.001 && std >= 1.0, "{value} {std}");
        assert!((value + 1.96 * std - 4.001).abs() < 0.1 && value - 1.96 * std < 0.1, "{value} {std}");
    }

    /// Of what is named, at least 95 % lie in their intervals, whatever the true strength; without the correction far fewer do.
    #[test]
    fn intervals_hold_although_only_large_values_are_named() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(7);
        for (truth, least) in [(3.0, 4.0), (4.0, 4.0), (5.0, 4.5), (8.0, 4.0)] {
            let (mut named, mut held, mut plain) = (0_u32, 0_u32, 0_u32);
            while named < 20_000 {
                let noise: f64 = StandardNormal.sample(&mut random);
                let seen = truth + noise;
                if seen <= least {
                    continue;
                }
                named += 1;
                let [(value, std)] = corrected(&[(seen, 1.0)], seen, least)[..] else { panic!() };
                held += u32::from((value - truth).abs() <= 1.96 * std);
                plain += u32::from((seen - truth).abs() <= 1.96);
            }
            // Binomial standard deviation 0.15 %.
            let [held, plain] = [held, plain].map(|n| 100.0 * f64::from(n) / f64::from(named));
            // Just above the threshold intervals are longer than they need to be.
            let most = if truth > least + 2.0 { 95.7 } else { 98.5 };
            assert!(held > 94.3 && held < most, "{truth}: {held} %");
            assert!(truth > 3.5 || plain < 90.0, "{truth}: {plain} %");
        }
    }
}
