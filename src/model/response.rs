//! AC response of a magnetometer: `|G(f)|` as DC gain times a shape, a product of textbook factors (docs/mathematics.md, "Frequency
//! response").
//!
//! [`RESPONSES`] lists the shapes. A further one is one entry there; a further factor is one variant of [`Factor`].

use crate::fit::scalar::bisect;
use serde::Serialize;
use std::f64::consts::{FRAC_1_SQRT_2, PI};

/// Ratio of neighbouring frequencies in the search for the -3 dB point: finer than any structure of a shape above that level.
const SCAN: f64 = 1.01;
/// The search starts this far below the lowest frequency of the parameters and ends as far above the highest.
const SCAN_RANGE: f64 = 1e3;
/// Relative accuracy of the -3 dB point.
const CORNER_ACCURACY: f64 = 1e-13;

/// One factor of a shape. Each is 1 at f = 0 and carries its sign, so that shapes stay smooth where a boxcar changes it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Factor {
    /// `1 / sqrt(1 + x²)`, x = f / corner.
    FirstOrder,
    /// `1 / sqrt((1 - x²)² + (x / Q)²)`, x = f / f0.
    SecondOrder,
    /// `sqrt(1 + x²)`, x = f / zero: the zero in the closed loop of a feedback magnetometer, which lifts the response above its
    /// DC value before it falls.
    Zero,
    /// `1 / sqrt(1 + x^(2n))`, x = f / corner, n the order.
    Butterworth(u16),
    /// `sin(πx) / (N sin(πx / N))`, x = f / notch: the sum of N readings at distance T, with the notch at 1 / (N T). Amplitudes tell
    /// the notch; N only through the lobes beyond it, which return to 1 at f = N notch.
    Boxcar(u16),
    /// `sin(πx) / (πx)`: the limit of many readings, or an integrator.
    Integrator,
}

/// A parameter of a shape.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Parameter {
    /// Name, without its unit.
    pub name: &'static str,
    /// `Hz`, or `1` for a quality factor.
    pub unit: &'static str,
}

const CORNER: Parameter = Parameter { name: "corner", unit: "Hz" };
const F0: Parameter = Parameter { name: "f0", unit: "Hz" };
const Q: Parameter = Parameter { name: "q", unit: "1" };
const ZERO: Parameter = Parameter { name: "zero", unit: "Hz" };
const NOTCH: Parameter = Parameter { name: "notch", unit: "Hz" };

impl Factor {
    fn parameters(self) -> &'static [Parameter] {
        match self {
            Factor::FirstOrder | Factor::Butterworth(_) => &[CORNER],
            Factor::SecondOrder => &[F0, Q],
            Factor::Zero => &[ZERO],
            Factor::Boxcar(_) | Factor::Integrator => &[NOTCH],
        }
    }

    /// Value at f, Hz, and its derivatives by the logarithms of the parameters (the second one 0 where there is none).
    fn value(self, f: f64, p: &[f64]) -> (f64, [f64; 2]) {
        let [first, second] = [p.first().copied().unwrap_or(f64::NAN), p.get(1).copied().unwrap_or(f64::NAN)];
        let x = f / first;
        match self {
            Factor::FirstOrder => power(x, 1),
            Factor::Butterworth(order) => power(x, order),
            Factor::SecondOrder => {
                let (stiff, damped) = (1.0 - x * x, x / second);
                let magnitude = 1.0 / (stiff * stiff + damped * damped).sqrt();
                // Shares of the squared denominator: finite however large x is.
                let (by_stiff, by_damped) = (x * magnitude, damped * magnitude);
                let by_f0 = magnitude * (by_damped * by_damped - 2.0 * by_stiff * by_stiff * stiff);
                (magnitude, [by_f0, magnitude * by_damped * by_damped])
            }
            Factor::Zero => {
                let magnitude = (1.0 + x * x).sqrt();
                (magnitude, [-x * (x / magnitude), 0.0])
            }
            Factor::Boxcar(readings) => {
                let n = f64::from(readings);
                let (sin, cos) = turns(x);
                let (sin_one, cos_one) = turns(x / n);
                if sin_one == 0.0 {
                    // All readings see the same phase, but for the sign.
                    return (cos / cos_one, [0.0; 2]);
                }
                let value = sin / (n * sin_one);
                (value, [-x * PI / (n * sin_one) * (cos - value * cos_one), 0.0])
            }
            Factor::Integrator => {
                if x == 0.0 {
                    return (1.0, [0.0; 2]);
                }
                let (sin, cos) = turns(x);
                let value = sin / (PI * x);
                (value, [value - cos, 0.0])
            }
        }
    }
}

impl Factor {
    /// Phase at f, Hz, of the causal filter, rad; the sign that a boxcar's value carries is not in it.
    fn phase_rad(self, f: f64, p: &[f64]) -> f64 {
        let [first, second] = [p.first().copied().unwrap_or(f64::NAN), p.get(1).copied().unwrap_or(f64::NAN)];
        let x = f / first;
        match self {
            Factor::FirstOrder => -x.atan(),
            Factor::SecondOrder => -(x / second).atan2(1.0 - x * x),
            Factor::Zero => x.atan(),
            // Poles at angles of (2k + 1) π / 2n around the negative real axis.
            Factor::Butterworth(order) => {
                let n = i32::from(order);
                let pole = |k: i32| {
                    let (im, re) = (PI * f64::from(2 * k + 1 - n) / f64::from(2 * n)).sin_cos();
                    -(x - im).atan2(re)
                };
                (0..n).map(pole).sum()
            }
            // The readings of the last 1 / notch seconds, or N of them at distance T: half of the time between first and last.
            Factor::Boxcar(readings) => -PI * x * (1.0 - 1.0 / f64::from(readings)),
            Factor::Integrator => -PI * x,
        }
    }
}

/// `1 / sqrt(1 + x^(2n))` and its derivative by the logarithm of the corner.
fn power(x: f64, order: u16) -> (f64, [f64; 2]) {
    let power = x.powi(i32::from(order));
    let magnitude = 1.0 / (1.0 + power * power).sqrt();
    // A power beyond the largest number is all there is under the root.
    let share = if power.is_finite() { power * magnitude } else { 1.0 };
    (magnitude, [f64::from(order) * magnitude * share * share, 0.0])
}

/// Sine and cosine of πx, exact at whole and half x.
fn turns(x: f64) -> (f64, f64) {
    let halves = (2.0 * x).round();
    let (sin, cos) = (PI * (x - 0.5 * halves)).sin_cos();
    match halves.rem_euclid(4.0) as u8 {
        0 => (sin, cos),
        1 => (cos, -sin),
        2 => (-sin, -cos),
        _ => (-cos, sin),
    }
}

/// A shape: `|G(f)| / G(0)` with its parameters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Response {
    /// Name in results.
    pub name: &'static str,
    /// Its factors.
    pub factors: &'static [Factor],
}

/// At most this many factors make a shape.
const MOST_FACTORS: usize = 4;
/// At most this many parameters.
const MOST_PARAMETERS: usize = 2 * MOST_FACTORS;

/// The shapes that are tried, simple ones first.
pub const RESPONSES: &[Response] = &[
    Response { name: "first order", factors: &[Factor::FirstOrder] },
    Response { name: "second order", factors: &[Factor::SecondOrder] },
    Response { name: "second order with zero", factors: &[Factor::SecondOrder, Factor::Zero] },
    Response { name: "Butterworth 2", factors: &[Factor::Butterworth(2)] },
    Response { name: "Butterworth 3", factors: &[Factor::Butterworth(3)] },
    Response { name: "Butterworth 4", factors: &[Factor::Butterworth(4)] },
    Response { name: "Butterworth 5", factors: &[Factor::Butterworth(5)] },
    Response { name: "Butterworth 6", factors: &[Factor::Butterworth(6)] },
    Response { name: "boxcar of 2", factors: &[Factor::Boxcar(2)] },
    Response { name: "boxcar of 4", factors: &[Factor::Boxcar(4)] },
    Response { name: "boxcar of 8", factors: &[Factor::Boxcar(8)] },
    Response { name: "boxcar of 16", factors: &[Factor::Boxcar(16)] },
    Response { name: "boxcar", factors: &[Factor::Integrator] },
    Response { name: "boxcar x first order", factors: &[Factor::Integrator, Factor::FirstOrder] },
    Response { name: "boxcar x second order", factors: &[Factor::Integrator, Factor::SecondOrder] },
    Response { name: "boxcar x second order with zero", factors: &[Factor::Integrator, Factor::SecondOrder, Factor::Zero] },
];

impl Response {
    /// The shape of that name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        RESPONSES.iter().copied().find(|response| response.name == name)
    }

    /// Its parameters, in the order of every slice of them. All are positive.
    #[must_use]
    pub fn parameters(&self) -> Vec<Parameter> {
        self.factors.iter().flat_map(|factor| factor.parameters()).copied().collect()
    }

    /// Number of parameters that were chosen by the data: those of [`parameters`](Self::parameters), and an order or a number of
    /// readings, which the registry offers several of.
    #[must_use]
    pub fn freedom(&self) -> usize {
        let whole = self.factors.iter().filter(|factor| matches!(factor, Factor::Butterworth(_) | Factor::Boxcar(_)));
        self.parameters().len() + whole.count()
    }

    /// `|G(f)| / G(0)` at f, Hz; NaN where a parameter is missing or not a positive number.
    #[must_use]
    pub fn value(&self, f: f64, parameters: &[f64]) -> f64 {
        self.value_and_slopes(f, parameters).0
    }

    /// Phase of the causal filter at f, Hz, in rad: `G = ±value · exp(i phase)` with the sign included as π.
    #[must_use]
    pub fn phase_rad(&self, f: f64, parameters: &[f64]) -> f64 {
        let (mut phase, mut sign, mut from) = (0.0, 1.0, 0);
        for factor in self.factors {
            let own = parameters.get(from..).unwrap_or(&[]);
            phase += factor.phase_rad(f, own);
            sign *= factor.value(f, own).0.signum();
            from += factor.parameters().len();
        }
        if sign < 0.0 { phase + PI } else { phase }
    }

    /// Parameters in the same proportions, with the -3 dB point at a given frequency, Hz.
    #[must_use]
    pub fn scaled_to(&self, corner_hz: f64, parameters: &[f64]) -> Option<Vec<f64>> {
        let factor = corner_hz / self.corner_hz(parameters)?;
        let kinds = self.parameters();
        Some(kinds.iter().zip(parameters).map(|(kind, p)| if kind.unit == "Hz" { p * factor } else { *p }).collect())
    }

    /// [`value`](Self::value) and its derivatives by the logarithms of the parameters; those beyond the last are zero.
    #[must_use]
    pub fn value_and_slopes(&self, f: f64, parameters: &[f64]) -> (f64, [f64; MOST_PARAMETERS]) {
        let mut slopes = [0.0; MOST_PARAMETERS];
        if !parameters.iter().all(|p| *p > 0.0 && p.is_finite()) {
            return (f64::NAN, slopes);
        }
        let mut product = 1.0;
        let mut from = 0;
        for factor in self.factors {
            let own = factor.parameters().len();
            let (value, by) = factor.value(f, parameters.get(from..).unwrap_or(&[]));
            slopes.iter_mut().take(from).for_each(|slope| *slope *= value);
            for (slope, by) in slopes.iter_mut().skip(from).zip(by.iter().take(own)) {
                *slope = product * by;
            }
            product *= value;
            from += own;
        }
        if product < 0.0 {
            slopes.iter_mut().for_each(|slope| *slope = -*slope);
        }
        (product.abs(), slopes)
    }

    /// f_3dB, Hz: the smallest f with `|G(f)| = G(0) / √2`. `None` where the shape does not fall that far.
    #[must_use]
    pub fn corner_hz(&self, parameters: &[f64]) -> Option<f64> {
        let kinds = self.parameters();
        if kinds.len() != parameters.len() || !parameters.iter().all(|p| *p > 0.0 && p.is_finite()) {
            return None;
        }
        let frequencies = || kinds.iter().zip(parameters).filter(|(kind, _)| kind.unit == "Hz").map(|(_, &p)| p);
        // A second order of low Q falls at Q f0.
        let damped = kinds.iter().zip(parameters).filter(|(kind, _)| kind.unit == "1").map(|(_, &q)| q.min(1.0)).product::<f64>();
        let mut low = frequencies().fold(f64::INFINITY, f64::min) * damped / SCAN_RANGE;
        let end = frequencies().fold(0.0, f64::max) * SCAN_RANGE;
        let mut high = low * SCAN;
        while self.value(high, parameters) > FRAC_1_SQRT_2 {
            low = high;
            high *= SCAN;
            if high > end || !high.is_finite() {
                return None;
            }
        }
        let [low, high] = bisect(|f| self.value(f, parameters) > FRAC_1_SQRT_2, [low, high], CORNER_ACCURACY);
        Some(0.5 * (low + high))
    }

    /// Relative change of f_3dB per relative change of each parameter, at a corner from [`corner_hz`](Self::corner_hz).
    ///
    /// The response depends on f over the frequencies of its parameters only, so that the slope by f is that by all of them.
    #[must_use]
    pub fn corner_slopes(&self, corner_hz: f64, parameters: &[f64]) -> Vec<f64> {
        let kinds = self.parameters();
        let (_, slopes) = self.value_and_slopes(corner_hz, parameters);
        let by_frequency = by_frequency(&kinds, &slopes);
        slopes.iter().take(kinds.len()).map(|slope| slope / by_frequency).collect()
    }

    /// How steep the response falls: decrease of its logarithm per logarithm of the frequency.
    #[must_use]
    pub fn steepness(&self, f: f64, parameters: &[f64]) -> f64 {
        let (value, slopes) = self.value_and_slopes(f, parameters);
        by_frequency(&self.parameters(), &slopes) / value
    }

    /// Parameters to start a fit from, several sets, for data which fall to -3 dB near `corner_hz`.
    #[must_use]
    pub fn starts(&self, corner_hz: f64) -> Vec<Vec<f64>> {
        // The notch of a boxcar lies at 1 / 0.443 of its corner, and further up where other factors do the rest.
        let scaled = |list: &[&[f64]]| -> Vec<Vec<f64>> {
            let kinds = self.parameters();
            let one =
                |set: &&[f64]| kinds.iter().zip(*set).map(|(k, s)| if k.unit == "Hz" { s * corner_hz } else { *s }).collect();
            list.iter().map(one).collect()
        };
        match self.factors {
            [Factor::SecondOrder] => scaled(&[&[1.0, 0.7], &[0.8, 1.2]]),
            [Factor::SecondOrder, Factor::Zero] => scaled(&[&[0.9, 0.7, 2.0], &[0.6, 0.7, 0.8]]),
            [Factor::Boxcar(_) | Factor::Integrator] => scaled(&[&[2.26]]),
            [Factor::Integrator, Factor::FirstOrder] => scaled(&[&[2.4, 2.8], &[3.5, 1.3]]),
            [Factor::Integrator, Factor::SecondOrder] => scaled(&[&[2.4, 1.6, 0.9], &[4.0, 1.1, 0.7]]),
            [Factor::Integrator, Factor::SecondOrder, Factor::Zero] => {
                scaled(&[&[2.2, 1.0, 0.45, 0.5], &[3.5, 0.7, 0.6, 0.6], &[2.4, 1.6, 0.9, 3.0]])
            }
            _ => vec![self.parameters().iter().map(|kind| if kind.unit == "Hz" { corner_hz } else { 1.0 }).collect()],
        }
    }
}

/// Derivative by the logarithm of all frequencies together: that by the logarithm of f, with the other sign.
fn by_frequency(kinds: &[Parameter], slopes: &[f64]) -> f64 {
    kinds.iter().zip(slopes).filter(|(kind, _)| kind.unit == "Hz").map(|(_, slope)| slope).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A first set of parameters for every shape.
    fn each() -> impl Iterator<Item = (Response, Vec<f64>)> {
        RESPONSES.iter().flat_map(|response| response.starts(60.0).into_iter().map(|start| (*response, start)))
    }

    #[test]
    fn names_are_unique_and_starts_complete() {
        for (i, response) in RESPONSES.iter().enumerate() {
            assert_eq!(RESPONSES.iter().position(|other| other.name == response.name), Some(i));
            assert_eq!(Response::named(response.name), Some(*response));
            assert!(response.factors.len() <= MOST_FACTORS);
        }
        for (response, start) in each() {
            assert_eq!(start.len(), response.parameters().len(), "{}", response.name);
            let corner = response.corner_hz(&start).unwrap();
            assert!((20.0..200.0).contains(&corner), "{} {corner}", response.name);
        }
        assert_eq!(Response::named("third order"), None);
    }

    #[test]
    fn every_shape_is_one_at_dc_and_has_its_slopes() {
        for (response, p) in each() {
            assert_eq!(response.value(0.0, &p), 1.0, "{}", response.name);
            for f in [0.1, 3.0, 47.0, 61.0, 130.0, 199.0, 1000.0] {
                let (_, slopes) = response.value_and_slopes(f, &p);
                for j in 0..p.len() {
                    let at = |factor: f64| {
                        let mut moved = p.clone();
                        moved[j] *= factor;
                        response.value(f, &moved)
                    };
                    let h: f64 = 1e-5;
                    let numeric = (at(h.exp()) - at((-h).exp())) / (2.0 * h);
                    assert!(
                        (numeric - slopes[j]).abs() < 1e-7 * (1.0 + numeric.abs()),
                        "{} {f} {j}: {numeric} {}",
                        response.name,
                        slopes[j]
                    );
                }
            }
        }
    }

    #[test]
    fn corners_are_where_the_textbook_has_them() {
        let corner = |name: &str, p: &[f64]| Response::named(name).unwrap().corner_hz(p).unwrap();
        let close = |a: f64, b: f64| assert!((a / b - 1.0).abs() < 1e-12, "{a} {b}");
        close(corner("first order", &[60.0]), 60.0);
        for n in 2..=6 {
            close(corner(&format!("Butterworth {n}"), &[55.0]), 55.0);
        }
        for (f0, q) in [(60.0, 0.7), (64.2, 0.73), (60.0, 5.0), (60.0, 0.01)] {
            let b: f64 = 1.0 - 0.5 / (q * q);
            // x² = b + sqrt(b² + 1), without cancellation for small Q.
            let x2 = if b < 0.0 { 1.0 / ((b * b + 1.0).sqrt() - b) } else { b + (b * b + 1.0).sqrt() };
            close(corner("second order", &[f0, q]), f0 * x2.sqrt());
        }
        // sinc(x) = 1/√2 at x = 0.442946470689452.
        close(corner("boxcar", &[100.0]), 44.294_647_068_945_2);
        // Two readings: |cos(πx/2)| = 1/√2 at x = 1/2.
        close(corner("boxcar of 2", &[100.0]), 50.0);
    }

    #[test]
    fn phases_are_those_of_the_filters() {
        let phase = |name: &str, f: f64, p: &[f64]| Response::named(name).unwrap().phase_rad(f, p);
        let close = |a: f64, b: f64| assert!((a - b).abs() < 1e-12, "{a} {b}");
        close(phase("first order", 60.0, &[60.0]), -PI / 4.0);
        close(phase("second order", 60.0, &[60.0, 0.7]), -PI / 2.0);
        // 1 / (s² + √2 s + 1) and 1 / ((s + 1)(s² + s + 1)) at s = i x.
        let x: f64 = 0.8;
        close(phase("Butterworth 2", x, &[1.0]), -(2f64.sqrt() * x).atan2(1.0 - x * x));
        close(phase("Butterworth 3", x, &[1.0]), -x.atan() - x.atan2(1.0 - x * x));
        // The mean of a cosine over the last second, and of four readings of it at distances of a quarter.
        for f in [0.3, 1.4, 2.7] {
            let turn = |t: f64| {
                let (im, re) = (-2.0 * PI * f * t).sin_cos();
                (re, im)
            };
            let steps = 100_000;
            let mean = |count: usize, at: &dyn Fn(usize) -> f64| {
                let sum = (0..count).map(|k| turn(at(k))).fold((0.0, 0.0), |a, b| (a.0 + b.0, a.1 + b.1));
                (sum.0 / count as f64, sum.1 / count as f64)
            };
            let boxcar = mean(steps, &|k| (k as f64 + 0.5) / steps as f64);
            let four = mean(4, &|k| k as f64 / 4.0);
            for (name, (re, im)) in [("boxcar", boxcar), ("boxcar of 4", four)] {
                let response = Response::named(name).unwrap();
                let (value, phase) = (response.value(f, &[1.0]), response.phase_rad(f, &[1.0]));
                assert!((value * phase.cos() - re).abs() < 1e-8 && (value * phase.sin() - im).abs() < 1e-8, "{name} {f}");
            }
        }
    }

    #[test]
    fn slopes_of_the_corner() {
        for (response, p) in each() {
            let corner = response.corner_hz(&p).unwrap();
            for (j, slope) in response.corner_slopes(corner, &p).into_iter().enumerate() {
                let at = |factor: f64| {
                    let mut moved = p.clone();
                    moved[j] *= factor;
                    response.corner_hz(&moved).unwrap().ln()
                };
                let h: f64 = 1e-4;
                let numeric = (at(h.exp()) - at((-h).exp())) / (2.0 * h);
                assert!((numeric - slope).abs() < 1e-6, "{} {j}: {numeric} {slope}", response.name);
            }
        }
    }

    #[test]
    fn limits_are_exact() {
        let boxcar = Response::named("boxcar of 4").unwrap();
        for (f, value) in [(0.0, 1.0), (100.0, 0.0), (200.0, 0.0), (400.0, 1.0), (800.0, 1.0), (1200.0, 1.0)] {
            assert_eq!(boxcar.value(f, &[100.0]), value, "{f}");
        }
        assert_eq!(Response::named("boxcar").unwrap().value(300.0, &[100.0]), 0.0);
        let steep = Response::named("Butterworth 6").unwrap();
        let (value, slopes) = steep.value_and_slopes(1e60, &[1.0]);
        assert!(value == 0.0 && slopes[0] == 0.0);
        let second = Response::named("second order").unwrap();
        assert!((second.value(60.0, &[60.0, 3.0]) - 3.0).abs() < 1e-15);
        assert!(second.value(60.0, &[60.0]).is_nan() && second.value(60.0, &[-60.0, 1.0]).is_nan());
        assert_eq!(second.corner_hz(&[60.0]), None);
        assert_eq!(second.corner_hz(&[f64::NAN, 1.0]), None);
        // A zero far below the second order: it rises for ever or falls far beyond.
        let lifted = Response { name: "zero", factors: &[Factor::Zero] };
        assert_eq!(lifted.corner_hz(&[1.0]), None);
    }
}
