//! A slow quantity out of noisy readings of it: local parabolas, over as many readings as predict left-out ones best.
//!
//! What follows from a temperature, a field of some nT per kelvin, takes its noise along: a thermistor that scatters by 0.01 K makes
//! a column that scatters as well, and a fit to it finds too little. A thermal mass is smooth over minutes.

use nalgebra::{SMatrix, SVector};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;

/// Readings on either side that are tried, beside the series as it is.
const REACHES: [usize; 8] = [2, 4, 8, 16, 32, 64, 128, 256];

/// Readings on either side over which a rate is taken where the readings need no smoothing.
const LEAST_REACH: usize = 2;

/// Random courses of the noise of readings: they tell the standard deviation that it adds to something to a tenth.
const NOISES: usize = 64;
const SEED: u64 = 20_131_998;

/// A slow quantity in the course of time.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Time, s, and value; ascending in time.
    pub series: Vec<(f64, f64)>,
    /// Rate of change at each of these times, per second.
    pub rate_per_s: Vec<f64>,
    /// Standard deviation of the noise of a reading; zero where readings are taken as they are.
    pub noise: f64,
    /// Readings on either side that a value follows from; `None` for the reading alone.
    reach: Option<usize>,
}

/// How values and rates of a course follow from its readings: a value and a rate is a sum of the readings around it with these weights.
pub struct Weights {
    times_s: Vec<f64>,
    /// First reading, and the weights of it and those after it.
    value: Vec<(usize, Vec<f64>)>,
    rate: Vec<(usize, Vec<f64>)>,
}

impl Weights {
    /// The course that these readings would have, one for each of the course that the weights are of.
    #[must_use]
    pub fn course(&self, readings: &[f64]) -> Course {
        let sum = |(first, weights): &(usize, Vec<f64>)| readings[*first..].iter().zip(weights).map(|(v, w)| v * w).sum::<f64>();
        Course {
            series: self.times_s.iter().zip(&self.value).map(|(t, w)| (*t, sum(w))).collect(),
            rate_per_s: self.rate.iter().map(sum).collect(),
            ..Course::default()
        }
    }
}

impl Course {
    /// The smooth course of noisy readings, (s, value), ascending in time.
    #[must_use]
    pub fn smooth(readings: &[(f64, f64)]) -> Self {
        let Best { reach, series, noise } = best(readings);
        Self { rate_per_s: rates(readings, reach.unwrap_or(LEAST_REACH)), series, noise, reach }
    }

    /// Readings as they are, with the rates of the curve through them.
    #[must_use]
    pub fn exact(readings: Vec<(f64, f64)>) -> Self {
        Self { rate_per_s: rates(&readings, LEAST_REACH), series: readings, noise: 0.0, reach: None }
    }

    /// Courses that the noise of the readings alone would make, the same in every analysis; none where there is no noise. The sum of the
    /// squares of what they do is the variance that the noise gives: it is smoothed before it acts, and then the same for times that are near each other.
    pub fn noises(&self) -> impl Iterator<Item = Course> {
        let count = if self.noise > 0.0 { NOISES } else { 0 };
        let weights = self.weights();
        let mut random = Xoshiro256PlusPlus::seed_from_u64(SEED);
        let scale = self.noise / (NOISES as f64).sqrt();
        (0..count).map(move |_| {
            let one = |_: usize| -> f64 { StandardNormal.sample(&mut random) };
            weights.course(&(0..weights.times_s.len()).map(one).map(|v| scale * v).collect::<Vec<f64>>())
        })
    }

    /// Readings on either side that a value follows from; 0 for the reading alone.
    #[must_use]
    pub fn reach(&self) -> usize {
        self.reach.unwrap_or(0)
    }

    /// How it follows from readings.
    #[must_use]
    pub fn weights(&self) -> Weights {
        let all = 0..self.series.len();
        let alone = |i: usize| (i, vec![1.0]);
        let value = |i: usize| match self.reach {
            Some(reach) => {
                value_at(&self.series, i, reach).map_or_else(|| alone(i), |fit| (fit.first, fit.weights(&self.series, 0)))
            }
            None => alone(i),
        };
        let rate = |i: usize| match slope_at(&self.series, i, self.reach.unwrap_or(LEAST_REACH)) {
            Some(fit) => (fit.first, fit.weights(&self.series, 1)),
            None => chord_weights(&self.series, i),
        };
        Weights {
            times_s: self.series.iter().map(|(t, _)| *t).collect(),
            value: all.clone().map(value).collect(),
            rate: all.map(rate).collect(),
        }
    }
}

/// The smooth course of a series, (time, value), ascending in time.
#[must_use]
pub fn smoothed(series: &[(f64, f64)]) -> Vec<(f64, f64)> {
    best(series).series
}

/// The reach whose parabolas predict left-out readings best, `None` if two neighbours do, with the smooth values.
struct Best {
    reach: Option<usize>,
    series: Vec<(f64, f64)>,
    /// Standard deviation of the noise of a reading.
    noise: f64,
}

fn best(series: &[(f64, f64)]) -> Best {
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
    let (error, reach, values) = best;
    // A reading and the mean of two others scatter by √1.5 of the noise against each other; a reading has the weight 9/4N in the middle of a
    // parabola through N, and its prediction by the others scatters the more.
    let own = reach.map_or(2.0 / 3.0, |reach| 1.0 - 2.25 / (2 * reach + 1) as f64);
    let noise = (own * error / series.len().saturating_sub(2).max(1) as f64).sqrt();
    Best { reach, series: values, noise }
}

/// A polynomial of N coefficients through a window of readings, in units of the window about one of them.
struct Local<const N: usize> {
    first: usize,
    last: usize,
    at_s: f64,
    scale_s: f64,
    inverse: SMatrix<f64, N, N>,
}

impl<const N: usize> Local<N> {
    /// Around a reading, over so many on either side; `None` where they do not determine it.
    fn at(series: &[(f64, f64)], i: usize, reach: usize) -> Option<Self> {
        let (first, last) = (i.saturating_sub(reach), (i + reach + 1).min(series.len()));
        let (at_s, scale_s) = (series[i].0, (series[last - 1].0 - series[first].0).max(f64::MIN_POSITIVE));
        let mut normal = SMatrix::<f64, N, N>::zeros();
        for (t, _) in &series[first..last] {
            let row = powers::<N>((t - at_s) / scale_s);
            normal += row * row.transpose();
        }
        Some(Self { first, last, at_s, scale_s, inverse: normal.try_inverse()? })
    }

    /// Its coefficients for the values of a series over the one at this reading.
    fn coefficients(&self, series: &[(f64, f64)], value: f64) -> SVector<f64, N> {
        let mut right = SVector::<f64, N>::zeros();
        for (t, v) in &series[self.first..self.last] {
            right += powers::<N>((t - self.at_s) / self.scale_s) * (v - value);
        }
        self.inverse * right
    }

    /// Weights of the readings of the window in the derivative of so high an order, zero or one, per second.
    fn weights(&self, series: &[(f64, f64)], order: usize) -> Vec<f64> {
        let unit = self.scale_s.powi(order as i32);
        let weight = |(t, _): &(f64, f64)| (self.inverse * powers::<N>((t - self.at_s) / self.scale_s))[order] / unit;
        series[self.first..self.last].iter().map(weight).collect()
    }
}

fn powers<const N: usize>(x: f64) -> SVector<f64, N> {
    let mut power = 1.0;
    SVector::from_fn(|_, _| {
        let value = power;
        power *= x;
        value
    })
}

/// The parabola that gives the value at a reading.
fn value_at(series: &[(f64, f64)], i: usize, reach: usize) -> Option<Local<3>> {
    Local::at(series, i, reach)
}

/// The cubic that gives the rate at a reading. The parabola that gives the best value lags behind in its slope: where the window is wide
/// enough for the noise, the third derivative of the course moves the slope of a parabola by more than the noise does, that of a cubic by
/// nothing.
fn slope_at(series: &[(f64, f64)], i: usize, reach: usize) -> Option<Local<4>> {
    let readings = (i + reach + 1).min(series.len()) - i.saturating_sub(reach);
    (readings > 4).then(|| Local::at(series, i, reach)).flatten()
}

/// Rates of change by local cubics over so many readings on either side.
fn rates(series: &[(f64, f64)], reach: usize) -> Vec<f64> {
    let slope = |i: usize| match slope_at(series, i, reach) {
        Some(cubic) => cubic.coefficients(series, series[i].1)[1] / cubic.scale_s,
        None => chord(series, i),
    };
    (0..series.len()).map(slope).collect()
}

/// Rate between the neighbours of a reading; zero where there are none.
fn chord(series: &[(f64, f64)], i: usize) -> f64 {
    let (a, b) = (series[i.saturating_sub(1)], series[(i + 1).min(series.len() - 1)]);
    if b.0 > a.0 { (b.1 - a.1) / (b.0 - a.0) } else { 0.0 }
}

/// The weights of a chord.
fn chord_weights(series: &[(f64, f64)], i: usize) -> (usize, Vec<f64>) {
    let (first, last) = (i.saturating_sub(1), (i + 1).min(series.len() - 1));
    let span_s = series[last].0 - series[first].0;
    let mut weights = vec![0.0; last - first + 1];
    if span_s > 0.0 {
        weights[0] -= 1.0 / span_s;
        weights[last - first] += 1.0 / span_s;
    }
    (first, weights)
}

/// Squares of the errors of readings predicted by the others in their windows, and the smooth values; ends do not count.
fn parabolas(series: &[(f64, f64)], reach: usize) -> (f64, Vec<(f64, f64)>) {
    let n = series.len();
    let mut error = 0.0;
    let values = (0..n)
        .map(|i| {
            let (at_s, value) = series[i];
            let Some(parabola) = value_at(series, i, reach) else { return (at_s, value) };
            let fitted = parabola.coefficients(series, value)[0];
            // The weight of the reading in its own prediction.
            let own = parabola.inverse[(0, 0)];
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

    /// Values and rates are the sums of readings that their weights say, and the noise of the readings is found.
    #[test]
    fn weights_are_those_of_the_course() {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(8);
        let mut noise = |std: f64| -> f64 {
            let unit: f64 = StandardNormal.sample(&mut random);
            std * unit
        };
        for std in [0.0, 0.02] {
            let reading = |i: i32| (f64::from(i) * 20.0, 10.0 * (f64::from(i) / 90.0).sin() + noise(std));
            let readings: Vec<(f64, f64)> = (0..600).map(reading).collect();
            let course = Course::smooth(&readings);
            assert!((course.noise - std).abs() < 0.1 * std + 1e-3, "{} {std}", course.noise);
            let again = course.weights().course(&readings.iter().map(|(_, v)| *v).collect::<Vec<f64>>());
            for (found, expected) in again.series.iter().zip(&course.series) {
                assert!((found.1 - expected.1).abs() < 1e-9, "{found:?} {expected:?}");
            }
            for (found, expected) in again.rate_per_s.iter().zip(&course.rate_per_s) {
                assert!((found - expected).abs() < 1e-10, "{found} {expected}");
            }
        }
        // Ends of two readings alone.
        let rates = Course::smooth(&[(0.0, 1.0), (10.0, 3.0)]).weights().course(&[1.0, 3.0]).rate_per_s;
        assert!(rates.len() == 2 && rates.iter().all(|rate| (rate - 0.2).abs() < 1e-12), "{rates:?}");
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
