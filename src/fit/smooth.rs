//! A slow quantity out of noisy readings of it: local parabolas, over as many readings as predict left-out ones best.
//!
//! What follows from a temperature, a field of some nT per kelvin, takes its noise along: a thermistor that scatters by 0.01 K makes
//! a column that scatters as well, and a fit to it finds too little. A thermal mass is smooth over minutes.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Readings on either side that are tried, beside the series as it is.
const REACHES: [usize; 8] = [2, 4, 8, 16, 32, 64, 128, 256];

/// Readings on either side over which a rate is taken where the readings need no smoothing.
const LEAST_REACH: usize = 2;

/// A slow quantity in the course of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Time, s, and value; ascending in time.
    pub series: Vec<(f64, f64)>,
    /// Rate of change at each of these times, per second.
    pub rate_per_s: Vec<f64>,
}

impl Course {
    /// The smooth course of noisy readings, (s, value), ascending in time.
    #[must_use]
    pub fn smooth(readings: &[(f64, f64)]) -> Self {
        let (reach, series) = best(readings);
        Self { rate_per_s: rates(readings, reach.unwrap_or(LEAST_REACH)), series }
    }

    /// Readings as they are, with the rates of the curve through them.
    #[must_use]
    pub fn exact(readings: Vec<(f64, f64)>) -> Self {
        Self { rate_per_s: rates(&readings, LEAST_REACH), series: readings }
    }
}

/// The smooth course of a series, (time, value), ascending in time.
#[must_use]
pub fn smoothed(series: &[(f64, f64)]) -> Vec<(f64, f64)> {
    best(series).1
}

/// The reach whose parabolas predict left-out readings best, `None` if two neighbours do, with the smooth values.
fn best(series: &[(f64, f64)]) -> (Option<usize>, Vec<(f64, f64)>) {
    // Two neighbours predict a reading without any smoothing.
    let between: f64 = (1..series.len().saturating_sub(1))
        .map(|i| {
            let [(t0, v0), (t, v), (t1, v1)] = [series[i - 1], series[i], series[i + 1]];
            let part = if t1 > t0 { (t - t0) / (t1 - t0) } else { 0.5 };
            (v - v0 - part * (v1 - v0)).powi(2)
        })
        .sum();
    let mut best = (between, None, series.to_vec());
    for reach in REACHES.into_iter().filter(|r| series.len() > 2 * *r + 1) {
        let (error, values) = parabolas(series, reach);
        if error < best.0 {
            best = (error, Some(reach), values);
        }
    }
    (best.1, best.2)
}

/// Rates of change by local cubics over so many readings on either side. The parabola that gives the best value lags behind in its
/// slope: where the window is wide enough for the noise, the third derivative of the course moves the slope of a parabola by more than
/// the noise does, that of a cubic by nothing.
fn rates(series: &[(f64, f64)], reach: usize) -> Vec<f64> {
    let n = series.len();
    let slope = |i: usize| {
        let window = &series[i.saturating_sub(reach)..(i + reach + 1).min(n)];
        let (at_s, value) = series[i];
        let scale = (window[window.len() - 1].0 - window[0].0).max(f64::MIN_POSITIVE);
        let (mut normal, mut right) = (Matrix4::zeros(), Vector4::zeros());
        for (t, v) in window {
            let x = (t - at_s) / scale;
            let row = Vector4::new(1.0, x, x * x, x * x * x);
            normal += row * row.transpose();
            right += row * (v - value);
        }
        let cubic = (window.len() > 4).then(|| normal.try_inverse()).flatten();
        cubic.map_or_else(|| chord(series, i), |inverse| (inverse * right)[1] / scale)
    };
    (0..n).map(slope).collect()
}

/// Rate between the neighbours of a reading; zero where there are none.
fn chord(series: &[(f64, f64)], i: usize) -> f64 {
    let (a, b) = (series[i.saturating_sub(1)], series[(i + 1).min(series.len() - 1)]);
    if b.0 > a.0 { (b.1 - a.1) / (b.0 - a.0) } else { 0.0 }
}

/// Squares of the errors of readings predicted by the others in their windows, and the smooth values; ends do not count.
fn parabolas(series: &[(f64, f64)], reach: usize) -> (f64, Vec<(f64, f64)>) {
    let n = series.len();
    let mut error = 0.0;
    let values = (0..n)
        .map(|i| {
            let window = &series[i.saturating_sub(reach)..(i + reach + 1).min(n)];
            let (at_s, value) = series[i];
            let scale = (window[window.len() - 1].0 - window[0].0).max(f64::MIN_POSITIVE);
            let (mut normal, mut right) = (Matrix3::zeros(), Vector3::zeros());
            for (t, v) in window {
                let x = (t - at_s) / scale;
                let row = Vector3::new(1.0, x, x * x);
                normal += row * row.transpose();
                right += row * (v - value);
            }
            let Some(inverse) = normal.try_inverse() else { return (at_s, value) };
            let fitted = (inverse * right)[0];
            // The weight of the reading in its own prediction.
            let own = inverse[(0, 0)];
            if i > 0 && i + 1 < n && own < 1.0 {
                error += (fitted / (1.0 - own)).powi(2);
            }
            (at_s, value + fitted)
        })
        .collect();
    (error, values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;

    fn rms(a: &[(f64, f64)], truth: impl Fn(f64) -> f64) -> f64 {
        (a.iter().map(|(t, v)| (v - truth(*t)).powi(2)).sum::<f64>() / a.len() as f64).sqrt()
    }

    #[test]
    fn noise_of_a_slow_course_goes() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(3);
        let truth = |t: f64| 20.0 + 0.4 * (t / 900.0).sin();
        let series: Vec<(f64, f64)> = (0..400)
            .map(|i| {
                let noise: f64 = StandardNormal.sample(&mut random);
                (10.0 * f64::from(i), truth(10.0 * f64::from(i)) + 0.01 * noise)
            })
            .collect();
        let left = rms(&smoothed(&series), truth);
        // A parabola over 65 readings leaves 1.5 / sqrt(65) of the noise.
        assert!(left < 0.0035, "{left}");
    }

    /// A day's wave seen for eight hours every 20 s: windows as wide as an hour follow it, and what they leave of the noise is what a fit to a
    /// part of a hundredth of a kelvin still sees.
    #[test]
    fn a_very_slow_course_is_smoothed_far() {
        let truth = |t: f64| 17.0 + 0.4 * (std::f64::consts::TAU * t / 86_400.0).sin();
        let left = |seed: u64| {
            let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
            let reading = |t: f64, noise: f64| (t, truth(t) + 0.02 * noise);
            let series: Vec<(f64, f64)> =
                (0..1441).map(|i| reading(20.0 * f64::from(i), StandardNormal.sample(&mut random))).collect();
            // At its ends a parabola has more freedom.
            rms(&smoothed(&series)[256..1441 - 256], truth)
        };
        let all = ((0..20).map(|seed| left(seed).powi(2)).sum::<f64>() / 20.0).sqrt();
        // A parabola over 129 readings leaves 1.5 / sqrt(129) of the 0.02 K; a wider one less.
        assert!(all < 0.02 * 1.5 / 129.0_f64.sqrt(), "{all}");
    }

    #[test]
    fn parabolas_and_single_steps_stay() {
        let parabola: Vec<(f64, f64)> =
            (0..200).map(|i| (f64::from(i), 3.0 - 0.2 * f64::from(i) + 1e-3 * f64::from(i * i))).collect();
        let left = rms(&smoothed(&parabola), |t| 3.0 - 0.2 * t + 1e-3 * t * t);
        assert!(left < 1e-9, "{left}");
        let step = |t: f64| if t < 99.5 { 0.0 } else { 5.0 };
        let series: Vec<(f64, f64)> = (0..200).map(|i| (f64::from(i), step(f64::from(i)))).collect();
        // Without noise only the resolution limits, and the neighbours describe the course better than a parabola.
        let left = rms(&smoothed(&series), step);
        assert!(left < 1e-9, "{left}");
    }
}
