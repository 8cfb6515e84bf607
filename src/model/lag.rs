//! A temperature that follows or leads another one: the part of a sensor that matters, and the thermistor beside it (docs/mathematics.md,
//! "Temperature"; CH-GFZ-TR-2601 section 8).

use crate::fit::smooth::Course;
use std::fmt;
use std::str::FromStr;
use thiserror::Error;

/// Steps of the first scan of a search, to either side of no lag.
const STEPS: i32 = 20;
/// A search ends with steps of this length, s: far below what readings tell, so that a strong lag leaves nothing.
const FINEST_S: f64 = 0.05;
/// Rounds in which the step for the curvature comes down to the uncertainty that follows from it.
const ROUNDS: usize = 8;

/// How the temperature of the part that matters follows from that of the thermistor. All values are in seconds.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Lag {
    /// The part is later by a time, or earlier where it is negative.
    Delay(f64),
    /// The part is heated through its surface and follows the thermistor with a time constant.
    FirstOrder(f64),
    /// The thermistor follows the part with a time constant.
    InverseFirstOrder(f64),
}

/// What is left of a difference at the first reading counts for nothing below this part of the noise of a reading.
const FORGOTTEN: f64 = 0.1;
/// Noise of readings that seem to have none, K.
const LEAST_NOISE_K: f64 = 1e-3;

impl Lag {
    /// Names of the forms in files.
    pub const FORMS: [&'static str; 3] = ["delay", "first order", "inverse first order"];

    /// A form by its name, with its delay or time constant, s.
    #[must_use]
    pub fn named(form: &str, lag_s: f64) -> Option<Self> {
        let all = [Lag::Delay(lag_s), Lag::FirstOrder(lag_s), Lag::InverseFirstOrder(lag_s)];
        all.into_iter().find(|lag| lag.form() == form)
    }

    /// A time constant: positive where the part follows the thermistor, negative where the thermistor follows the part.
    #[must_use]
    pub fn time_constant(tau_s: f64) -> Self {
        if tau_s < 0.0 { Lag::InverseFirstOrder(-tau_s) } else { Lag::FirstOrder(tau_s) }
    }

    /// Name of its form in files.
    #[must_use]
    pub fn form(self) -> &'static str {
        match self {
            Lag::Delay(_) => Self::FORMS[0],
            Lag::FirstOrder(_) => Self::FORMS[1],
            Lag::InverseFirstOrder(_) => Self::FORMS[2],
        }
    }

    /// Its delay or time constant, s.
    #[must_use]
    pub fn seconds(self) -> f64 {
        let (Lag::Delay(lag_s) | Lag::FirstOrder(lag_s) | Lag::InverseFirstOrder(lag_s)) = self;
        lag_s
    }

    /// Its delay or time constant, s, negative where the part is earlier than the thermistor.
    #[must_use]
    pub fn signed_seconds(self) -> f64 {
        match self {
            Lag::Delay(lag_s) | Lag::FirstOrder(lag_s) => lag_s,
            Lag::InverseFirstOrder(tau_s) => -tau_s,
        }
    }

    /// A lag of the same family by which the part is later by so many seconds more.
    #[must_use]
    pub fn later_by(self, by_s: f64) -> Self {
        match self {
            Lag::Delay(delay_s) => Lag::Delay(delay_s + by_s),
            Lag::FirstOrder(_) | Lag::InverseFirstOrder(_) => Self::time_constant(self.signed_seconds() + by_s),
        }
    }

    /// The temperature of the part, (s, °C), from the course of the thermistor.
    ///
    /// A first order is the exact answer to straight lines between the readings, from equilibrium at the first one (see
    /// [`Lag::known_from_s`]). Its inverse is
    /// `T + τ dT/dt`, which is exact; only the rate has to be taken from readings.
    #[must_use]
    pub fn of(self, thermistor: &Course) -> Vec<(f64, f64)> {
        let series = &thermistor.series;
        match self {
            Lag::Delay(delay_s) => series.iter().map(|&(t, v)| (t + delay_s, v)).collect(),
            Lag::FirstOrder(tau_s) => {
                let mut last = series.first().copied().unwrap_or_default();
                let mut body = last.1;
                let mut next = |&(t, v): &(f64, f64)| {
                    let x = (t - last.0) / tau_s;
                    if x > 0.0 {
                        body = follow(body, last.1, v, x);
                    }
                    last = (t, v);
                    (t, body)
                };
                series.iter().map(&mut next).collect()
            }
            Lag::InverseFirstOrder(tau_s) => {
                series.iter().zip(&thermistor.rate_per_s).map(|(&(t, v), rate)| (t, v + tau_s * rate)).collect()
            }
        }
    }

    /// The temperature of the part, (s, °C), in the time of a run, as far as the readings of its thermistor tell it. A part that was at rest with its
    /// thermistor at the begin was so before.
    #[must_use]
    pub fn in_run(self, readings: &[(f64, f64)]) -> Vec<(f64, f64)> {
        let smooth = Course::smooth(readings);
        let mut series = match self {
            // A rate of single readings is their noise.
            Lag::InverseFirstOrder(_) => self.of(&smooth),
            Lag::Delay(_) | Lag::FirstOrder(_) => self.of(&Course::exact(readings.to_vec())),
        };
        match (self.known_from_s(&smooth), series.first(), smooth.series.first()) {
            (Some(known_s), ..) => series.retain(|(t_s, _)| *t_s >= known_s),
            (None, Some((begin_s, _)), Some((_, degc))) => {
                let before: Vec<(f64, f64)> =
                    readings.iter().map(|(t_s, _)| (*t_s, *degc)).take_while(|(t_s, _)| t_s < begin_s).collect();
                series.splice(..0, before);
            }
            _ => {}
        }
        series
    }

    /// When the temperature of the part begins to be known, s. A part that follows a thermistor which moves at its first reading may have been
    /// in equilibrium then, or have followed for long; what this makes out is forgotten once it is below a tenth of the noise of the readings. One
    /// that is later by a time was then where the thermistor had been before. `None` where it is known from the first reading on.
    #[must_use]
    pub fn known_from_s(self, thermistor: &Course) -> Option<f64> {
        let (begin_s, _) = *thermistor.series.first()?;
        let behind_k = thermistor.rate_per_s.first()?.abs() * self.signed_seconds();
        let noise_k = thermistor.noise.max(LEAST_NOISE_K);
        (behind_k > noise_k).then(|| match self {
            Lag::FirstOrder(tau_s) | Lag::InverseFirstOrder(tau_s) => begin_s + tau_s * (behind_k / (FORGOTTEN * noise_k)).ln(),
            Lag::Delay(delay_s) => begin_s + delay_s,
        })
    }

    /// When the temperature of the part ends to be known, s: where it is earlier than its thermistor by a time, this does not read what the part had
    /// last. `None` where it is known up to the last reading.
    #[must_use]
    pub fn known_until_s(self, thermistor: &Course) -> Option<f64> {
        let Lag::Delay(delay_s) = self else { return None };
        let (end_s, _) = *thermistor.series.last()?;
        let ahead_k = thermistor.rate_per_s.last()?.abs() * -delay_s;
        (ahead_k > thermistor.noise.max(LEAST_NOISE_K)).then_some(end_s + delay_s)
    }
}

/// Why a text is no lag.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
#[error("write a number of seconds for a delay, or first-order=SECONDS or inverse=SECONDS with a positive number")]
pub struct NoLag;

/// As people write it: seconds of a delay, `first-order=SECONDS` or `inverse=SECONDS`.
impl FromStr for Lag {
    type Err = NoLag;

    fn from_str(text: &str) -> Result<Self, NoLag> {
        let seconds = |text: &str| text.trim().parse::<f64>().ok().filter(|s| s.is_finite()).ok_or(NoLag);
        let positive = |text: &str| seconds(text).and_then(|s| if s > 0.0 { Ok(s) } else { Err(NoLag) });
        match text.split_once('=') {
            None => seconds(text).map(Lag::Delay),
            Some(("first-order", tau_s)) => positive(tau_s).map(Lag::FirstOrder),
            Some(("inverse", tau_s)) => positive(tau_s).map(Lag::InverseFirstOrder),
            Some(_) => Err(NoLag),
        }
    }
}

impl fmt::Display for Lag {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Lag::Delay(delay_s) => write!(f, "{delay_s}"),
            Lag::FirstOrder(tau_s) => write!(f, "first-order={tau_s}"),
            Lag::InverseFirstOrder(tau_s) => write!(f, "inverse={tau_s}"),
        }
    }
}

/// The most likely lag of a family.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Best {
    /// The lag.
    pub lag: Lag,
    /// Standard uncertainty of its delay or time constant, s; NaN where the readings do not bound it.
    pub std_s: f64,
    /// Its deviance.
    pub deviance: f64,
}

/// The delay and the time constant, negative ones included, with the least deviance (minus twice the log likelihood) up to `longest_s`.
#[must_use]
pub fn search(longest_s: f64, deviance: impl Fn(Lag) -> f64) -> [Best; 2] {
    [search_in(Lag::Delay, longest_s, &deviance), search_in(Lag::time_constant, longest_s, &deviance)]
}

fn search_in(family: fn(f64) -> Lag, longest_s: f64, deviance: &impl Fn(Lag) -> f64) -> Best {
    let at = |lag_s: f64| deviance(family(lag_s));
    let first_step_s = longest_s / f64::from(STEPS);
    let (mut best_s, mut least) = (0.0, f64::INFINITY);
    for k in -STEPS..=STEPS {
        let lag_s = f64::from(k) * first_step_s;
        let value = at(lag_s);
        if value < least {
            (best_s, least) = (lag_s, value);
        }
    }
    let mut step_s = first_step_s;
    while step_s > FINEST_S {
        step_s *= 0.5;
        for lag_s in [best_s - step_s, best_s + step_s] {
            let value = at(lag_s);
            if value < least {
                (best_s, least) = (lag_s, value);
            }
        }
    }
    // The curvature of the deviance is twice the information. It is that of the minimum where the step is about the uncertainty: a
    // strong lag outgrows the noise within a few seconds, and the deviance is no parabola any more.
    let (mut std_s, mut step_s) = (f64::NAN, first_step_s);
    for _ in 0..ROUNDS {
        let curvature = (at(best_s + step_s) - 2.0 * least + at(best_s - step_s)) / (step_s * step_s);
        std_s = if curvature > 0.0 { (2.0 / curvature).sqrt() } else { f64::NAN };
        if std_s.is_nan() || 4.0 * std_s > step_s || step_s <= FINEST_S {
            break;
        }
        step_s = (2.0 * std_s).max(FINEST_S);
    }
    Best { lag: family(best_s), std_s, deviance: least }
}

/// Temperature of the body after a stretch in which the temperature outside went from one value to another in a straight line;
/// `x` is the length of the stretch over the time constant.
#[must_use]
pub fn follow(body: f64, from: f64, to: f64, x: f64) -> f64 {
    let slope = (to - from) / x;
    to - slope + (body - from + slope) * (-x).exp()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::run::interpolate;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;
    use rand_xoshiro::rand_core::SeedableRng;
    use std::f64::consts::TAU;

    #[test]
    fn steps_are_approached_and_ramps_followed_at_a_distance() {
        assert!((follow(0.0, 1.0, 1.0, 2.0) - (1.0 - f64::exp(-2.0))).abs() < 1e-15);
        // After a long ramp the distance is the rise in one time constant.
        assert!((follow(0.0, 0.0, 50.0, 50.0) - 49.0).abs() < 1e-12);
        // Two halves are one whole.
        let half = follow(3.0, 1.0, 2.0, 0.7);
        assert!((follow(half, 2.0, 3.0, 0.7) - follow(3.0, 1.0, 3.0, 1.4)).abs() < 1e-14);
    }

    #[test]
    fn lags_do_to_a_ramp_what_they_must() {
        let ramp: Vec<(f64, f64)> = (0..400).map(|i| (30.0 * f64::from(i), 0.01 * 30.0 * f64::from(i))).collect();
        for course in [Course::smooth(&ramp), Course::exact(ramp)] {
            let value = |lag: Lag| lag.of(&course)[300].1;
            assert!((value(Lag::FirstOrder(480.0)) - (90.0 - 4.8 * (1.0 - f64::exp(-9000.0 / 480.0)))).abs() < 1e-9);
            assert!((value(Lag::InverseFirstOrder(480.0)) - 94.8).abs() < 1e-9);
            let delayed = Lag::Delay(480.0).of(&course)[300];
            assert!((delayed.0 - 9480.0).abs() < 1e-9 && (delayed.1 - 90.0).abs() < 1e-9);
        }
    }

    #[test]
    fn a_part_is_known_in_a_run_where_its_thermistor_tells() {
        let times = || (0..400).map(|i| 30.0 * f64::from(i));
        // At rest for an hour, then a ramp: the delayed part is known from the first reading on.
        let rested: Vec<(f64, f64)> = times().map(|t_s| (t_s, 20.0 + 0.01 * (t_s - 3600.0).max(0.0))).collect();
        let part = Lag::Delay(480.0).in_run(&rested);
        for (t_s, degc) in times().map(|t_s| (t_s, interpolate(&part, t_s))) {
            assert!((degc - (20.0 + 0.01 * (t_s - 4080.0).max(0.0))).abs() < 1e-9, "{t_s} {degc}");
        }
        assert!(part[0].0 == 0.0);
        // It moves already: where the part was before is not known.
        let ramp: Vec<(f64, f64)> = times().map(|t_s| (t_s, 0.01 * t_s)).collect();
        assert!((Lag::Delay(480.0).in_run(&ramp)[0].0 - 480.0).abs() < 1e-9);
        // A first order has forgotten it when a tenth of the noise is left, which is 1e-3 K where none shows: 4.8 K, ln(4.8e4) time constants.
        let from_s = Lag::FirstOrder(480.0).in_run(&ramp)[0].0;
        assert!((from_s - 480.0 * f64::ln(4.8e4)).abs() <= 30.0, "{from_s}");
    }

    #[test]
    fn forms_have_their_names() {
        for lag in [Lag::Delay(-3.0), Lag::FirstOrder(4.0), Lag::InverseFirstOrder(5.0)] {
            assert_eq!(Lag::named(lag.form(), lag.seconds()), Some(lag));
        }
        assert_eq!(Lag::named("second order", 1.0), None);
        assert_eq!(Lag::time_constant(-5.0), Lag::InverseFirstOrder(5.0));
    }

    #[test]
    fn people_write_lags() {
        for (text, lag) in [
            ("-12.5", Lag::Delay(-12.5)),
            ("first-order=480", Lag::FirstOrder(480.0)),
            ("inverse=480", Lag::InverseFirstOrder(480.0)),
        ] {
            assert_eq!((text.parse(), lag.to_string().as_str()), (Ok(lag), text));
        }
        for text in ["", "delay", "first-order=-480", "inverse=0", "first order=480", "inf", "NaN", "second-order=1"] {
            assert_eq!(text.parse::<Lag>(), Err(NoLag), "{text}");
        }
    }

    #[test]
    fn lags_of_a_family_go_on_through_none() {
        assert_eq!(Lag::Delay(5.0).later_by(-8.0), Lag::Delay(-3.0));
        assert_eq!(Lag::FirstOrder(5.0).later_by(-8.0), Lag::InverseFirstOrder(3.0));
        assert_eq!(Lag::InverseFirstOrder(3.0).later_by(8.0), Lag::FirstOrder(5.0));
        assert_eq!(Lag::InverseFirstOrder(3.0).signed_seconds(), -3.0);
    }

    #[test]
    fn a_part_that_follows_a_ramp_is_known_once_its_begin_is_forgotten() {
        // 0.01 K/s and 480 s: 4.8 K are between equilibrium and a long ramp; 4.8 exp(-t/480) is below 1e-4 K after 5173.
        let ramp: Vec<(f64, f64)> = (0..400).map(|i| (50.0 + 30.0 * f64::from(i), 0.3 * f64::from(i))).collect();
        let from_s = Lag::FirstOrder(480.0).known_from_s(&Course::exact(ramp.clone())).unwrap();
        assert!((from_s - (50.0 + 480.0 * f64::ln(4.8e4))).abs() < 1e-6, "{from_s}");
        assert_eq!(Lag::Delay(480.0).known_from_s(&Course::exact(ramp.clone())), Some(530.0));
        for lag in [Lag::Delay(-480.0), Lag::InverseFirstOrder(480.0)] {
            assert_eq!(lag.known_from_s(&Course::exact(ramp.clone())), None);
        }
        let rest: Vec<(f64, f64)> = ramp.iter().map(|(t, _)| (*t, 20.0)).collect();
        assert_eq!(Lag::FirstOrder(480.0).known_from_s(&Course::exact(rest)), None);
    }

    const TAU_S: f64 = 480.0;
    /// ±40 K in four hours, seen for eight.
    const AMPLITUDE_K: f64 = 40.0;
    const OMEGA: f64 = TAU / 14_400.0;
    const NOISE_K: f64 = 0.02;

    /// Readings of a thermistor that is a sine.
    fn readings(step_s: f64, seed: u64, value: impl Fn(f64) -> f64) -> Course {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let all = (0..=(28_800.0 / step_s) as usize).map(|i| step_s * i as f64);
        let noisy = |t: f64| {
            let noise: f64 = StandardNormal.sample(&mut random);
            (t, value(t) + NOISE_K * noise)
        };
        Course::smooth(&all.map(noisy).collect::<Vec<(f64, f64)>>())
    }

    /// Root mean square of a series about a truth, K, without the first and last 5000 s: the memory of the begin of a first order, and
    /// windows that are cut off.
    fn rms_k(series: &[(f64, f64)], truth: impl Fn(f64) -> f64) -> f64 {
        let inside = || series.iter().filter(|(t, _)| (5000.0..23_800.0).contains(t));
        (inside().map(|(t, v)| (v - truth(*t)).powi(2)).sum::<f64>() / inside().count() as f64).sqrt()
    }

    /// A thermistor that follows a sine with 480 s is behind it by a phase of atan(ωτ) and smaller by 1/sqrt(1 + (ωτ)²); its lag gives the
    /// sine back. What is allowed was reckoned before: the slope of a local cubic over 2m + 1 readings h apart scatters by about
    /// `4.33 σ / (sqrt(2m + 1) m h)`. At 10 s the noise lets windows grow to m = 32 or 64: with 32, 480 s times that is 0.0161 K, beside
    /// 0.0037 K of the value. At 300 s they end at m = 2, where the slope is `(v₋₂ - 8 v₋₁ + 8 v₁ - v₂) / 12h` and scatters by
    /// 0.95 σ/h: 0.030 K, beside 0.014 K of the value. A quarter is added for the scatter of the scatter.
    ///
    /// Two other definitions that were in use do not keep this: differences over four readings to either side are wrong by 0.25 K at
    /// 300 s, straight lines through the raw readings of 300 s to either side leave 0.023 K at 10 s.
    #[test]
    fn the_inverse_of_a_first_order_has_its_closed_form() {
        let x = OMEGA * TAU_S;
        let part = |t: f64| AMPLITUDE_K * (OMEGA * t).sin();
        let thermistor = |t: f64| AMPLITUDE_K / (1.0 + x * x) * ((OMEGA * t).sin() - x * (OMEGA * t).cos());
        for (step_s, most_k) in [(10.0, 1.25 * 0.0165), (300.0, 1.25 * 0.033)] {
            for seed in 0..4 {
                let left = rms_k(&Lag::InverseFirstOrder(TAU_S).of(&readings(step_s, seed, thermistor)), part);
                assert!(left < most_k, "{step_s} s, {seed}: {left} K");
            }
        }
    }

    /// The other way round the noise averages out, what counts is the line between readings, which lies below the sine by
    /// `A (ωh)²/12` in the mean: 0.057 K at 300 s of the amplitude, its root mean square 0.04 K, and 0.00004 K at 10 s, where the smooth
    /// values err by 0.0037 K at most.
    #[test]
    fn a_first_order_has_its_closed_form() {
        let x = OMEGA * TAU_S;
        let thermistor = |t: f64| AMPLITUDE_K * (OMEGA * t).sin();
        let part = |t: f64| AMPLITUDE_K / (1.0 + x * x) * ((OMEGA * t).sin() - x * (OMEGA * t).cos());
        for (step_s, most_k) in [(10.0, 1.25 * 0.0037), (300.0, 0.05)] {
            let left = rms_k(&Lag::FirstOrder(TAU_S).of(&readings(step_s, 1, thermistor)), part);
            assert!(left < most_k, "{step_s} s: {left} K");
        }
    }

    /// A deviance that is `((lag - 300)/7)²` near its minimum, and grows with the logarithm far away, as squares of residuals do.
    #[test]
    fn a_search_finds_a_strong_lag_and_its_uncertainty() {
        let deviance = |lag: Lag| {
            let away = match lag {
                Lag::Delay(s) | Lag::FirstOrder(s) => s - 300.0,
                Lag::InverseFirstOrder(s) => -s - 300.0,
            };
            2000.0 * (1.0 + (away / 7.0).powi(2) / 2000.0).ln()
        };
        for best in search(2400.0, deviance) {
            assert!((best.lag.seconds() - 300.0).abs() < FINEST_S && best.deviance < 1e-4, "{best:?}");
            // Two standard uncertainties to either side, where the logarithm is below the parabola by 0.1 %.
            assert!((best.std_s / 7.0 - 1.0).abs() < 0.01, "{best:?}");
        }
    }
}
