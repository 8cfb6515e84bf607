//! A jump of the thermistor that its own readings do not tell, because the temperature turns there or moves fast: the readings of the sensor do.
//!
//! A lag splits the heating from the cooling branch, and so does a thermistor that reads something else from one moment on. Where ramps are of equal
//! speed the two differ only around the turn, so that a jump there passes for a lag. Both are tried. A jump needs room in the readings of the
//! thermistor; it is claimed where it explains clearly more than the best lag, and where it explains as much and these readings change by more than
//! a turn lets them. Where it explains as much and they need not hold one, nobody can tell, and that is said.

use super::means::{LinearOrders, Means};
use super::thermistors::{SIGNIFICANT, Series};
use crate::data::note::{Note, NoteKind};
use crate::fit::smooth::Course;
use crate::record::temperature_faults::may_jump;
use nalgebra::{DMatrix, DVector};

/// Rounds in which the size of a jump settles, and the part of its uncertainty below which a change of it is none.
const ROUNDS: usize = 12;
const SETTLED: f64 = 0.01;
/// Half of the distance over which the derivative by the temperature is taken, K.
const DISTANCE_K: f64 = 0.1;
/// Settings and readings on either side of where a first scan sees a jump among which its place is looked for.
const NEAR: f64 = 3.0;

/// A jump of a thermistor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Step {
    /// Time of the first reading behind it, s since the run's start.
    pub t_s: f64,
    /// Size, K.
    pub size_k: f64,
    /// Its standard uncertainty, K.
    pub std_k: f64,
    /// By how much it lowers minus twice the log likelihood.
    gain: f64,
    /// Whether it is claimed; otherwise it explains as much as a lag does.
    pub is_claimed: bool,
}

impl Step {
    /// A jump of the thermistor that explains at least as much as a lag, which lowers minus twice the log likelihood by `lag_gain`.
    pub fn of(series: &[(f64, f64)], means: &Means, orders: LinearOrders, lag_gain: f64) -> Option<Self> {
        let places = means.t_s.len();
        // It may be anywhere, which is worth twice the logarithm of the number of places.
        let least = SIGNIFICANT * SIGNIFICANT + 2.0 * (places as f64).ln();
        let smooth = |series: &[(f64, f64)]| means.degc(&Course::smooth(series).series);
        let degc = smooth(series);
        let scan = Linear::of(means, &degc, orders)?.scan()?;
        if scan.gain < least {
            return None;
        }
        let without = means.deviance(&degc, orders);
        let usual_s = |count: usize, span_s: f64| span_s / (count.max(2) - 1) as f64;
        let span_s = |first: Option<f64>, last: Option<f64>| last.unwrap_or(0.0) - first.unwrap_or(0.0);
        let of_settings = usual_s(places, span_s(means.t_s.first().copied(), means.t_s.last().copied()));
        let of_readings = usual_s(series.len(), span_s(series.first().map(|r| r.0), series.last().map(|r| r.0)));
        let near_s = NEAR * of_settings.max(of_readings);
        let at = |(t_s, _): &(f64, f64)| -> Option<Self> {
            if (t_s - scan.t_s).abs() > near_s || !may_jump(series, *t_s, [scan.size_k, scan.std_k]) {
                return None;
            }
            let step = Self::settled(series, means, orders, *t_s, scan.size_k)?;
            let gain = without - means.deviance(&smooth(&step.taken_off(series)), orders);
            Some(Self { gain, ..step })
        };
        let best = series.iter().filter_map(at).max_by(|a, b| a.gain.total_cmp(&b.gain))?;
        // The smooth course follows the noise of the readings as far as it does not average over it, which no scatter of the settings tells.
        let course = Course::smooth(series);
        let of_noise_k = course.noise / ((2 * course.reach() + 1) as f64).sqrt();
        if best.size_k.abs() < SIGNIFICANT * of_noise_k {
            return None;
        }
        let is_needed = !may_jump(series, best.t_s, [0.0, 0.0]);
        let ahead = best.gain - lag_gain.max(0.0);
        let is_claimed = ahead > least || (is_needed && ahead > -least);
        (best.gain > least && ahead > -least).then_some(Self { is_claimed, ..best })
    }

    /// What the readings of the sensor make of a jump at a time beyond what those of the thermistor told, which was taken off: where the temperature
    /// turns these tell its size to a few hundredths of a kelvin. `None` where they leave no room for it, as where the sensor has a lag.
    pub fn beyond(series: &[(f64, f64)], means: &Means, orders: LinearOrders, t_s: f64) -> Option<Self> {
        Self::settled(series, means, orders, t_s, 0.0).map(|step| Self { is_claimed: true, ..step })
    }

    /// A jump at a time whose size settles from a first one, K; `None` where the readings of the thermistor leave no room for it.
    fn settled(series: &[(f64, f64)], means: &Means, orders: LinearOrders, t_s: f64, size_k: f64) -> Option<Self> {
        let mut step = Self { t_s, size_k, std_k: f64::INFINITY, gain: 0.0, is_claimed: false };
        for _ in 0..ROUNDS {
            let degc = means.degc(&Course::smooth(&step.taken_off(series)).series);
            let (by_k, std_k) = Linear::of(means, &degc, orders)?.jump(t_s)?;
            (step.size_k, step.std_k) = (step.size_k + by_k, std_k);
            if by_k.abs() < SETTLED * std_k {
                break;
            }
        }
        may_jump(series, t_s, [step.size_k, step.std_k]).then_some(step)
    }

    /// The readings as if right before the jump.
    pub fn taken_off(&self, series: &[(f64, f64)]) -> Series {
        series.iter().map(|(t_s, degc)| (*t_s, if *t_s < self.t_s { *degc } else { degc - self.size_k })).collect()
    }

    /// What its uncertainty does to a course, K.
    pub fn uncertain(&self, course: &Course) -> Course {
        let of = |(t_s, _): &(f64, f64)| (*t_s, if *t_s < self.t_s { 0.0 } else { self.std_k });
        Course::exact(course.series.iter().map(of).collect())
    }

    /// What is said of it.
    pub fn note(&self, channel: &str) -> Note {
        let text = format!(
            "temperature channel {channel} jumps by {:+.3} ± {:.3} K at {:.0} s: the readings of the sensor show it, and no lag explains them better; the \
             sensor temperature of the result rests on it, without the jump and as if right before it",
            self.size_k, self.std_k, self.t_s
        );
        Note::new(NoteKind::Temperature, text)
            .about(channel)
            .with_remedy("do not use the temperature, and measure with a thermistor that holds")
    }

    /// What is said of one that the readings of the thermistor told already, to within less than this.
    pub fn note_beyond(&self, channel: &str) -> Note {
        let text = format!(
            "the jump of temperature channel {channel} at {:.0} s is {:+.3} ± {:.3} K more than its own readings tell, by the readings of the sensor",
            self.t_s, self.size_k, self.std_k
        );
        Note::new(NoteKind::Temperature, text).about(channel)
    }

    /// What is said of one that is not claimed beside a lag that is.
    pub fn rival(&self, channel: &str) -> Note {
        let text = format!(
            "a jump of {:+.3} K of temperature channel {channel} at {:.0} s, for which its readings have room, explains the readings of the sensor as well as \
             the lag: which of the two it was this run does not tell, and if it was a jump the temperatures of the result are wrong by up to {:.3} K",
            self.size_k,
            self.t_s,
            self.size_k.abs()
        );
        Note::new(NoteKind::Temperature, text)
            .about(channel)
            .with_remedy("let the temperature go more slowly, or rest, where it turns; give the lag with --lag if it is known")
    }
}

/// A linear model of the settings at their temperatures, and what a change of these does to the readings.
struct Linear<'a> {
    t_s: &'a [f64],
    /// Orthonormal columns.
    columns: DMatrix<f64>,
    /// What it leaves, and the derivative of the readings by the temperature, each over the noise of the component: a column per component.
    left: DMatrix<f64>,
    slope: DMatrix<f64>,
}

/// Where a first scan sees a jump.
struct Seen {
    t_s: f64,
    size_k: f64,
    std_k: f64,
    gain: f64,
}

impl<'a> Linear<'a> {
    /// `None` where the settings do not determine it.
    fn of(means: &'a Means, degc: &[f64], orders: LinearOrders) -> Option<Self> {
        let baseline = means.baseline(degc, orders).in_units_of(&means.fields_nt);
        let factors = baseline.columns(&means.fields_nt, degc).qr();
        let columns = factors.q();
        let coefficients = factors.r().solve_upper_triangular(&columns.tr_mul(&means.readings_ent))?;
        let mut left = &means.readings_ent - &columns * columns.tr_mul(&means.readings_ent);
        let beside = |by_k: f64| {
            let degc: Vec<f64> = degc.iter().map(|t| t + by_k).collect();
            baseline.columns(&means.fields_nt, &degc) * &coefficients
        };
        let mut slope = (beside(DISTANCE_K) - beside(-DISTANCE_K)) / (2.0 * DISTANCE_K);
        for (mut left, mut slope) in left.column_iter_mut().zip(slope.column_iter_mut()) {
            let std = left.norm() / (degc.len() as f64).sqrt();
            if std <= 0.0 {
                return None;
            }
            left /= std;
            slope /= std;
        }
        Some(Self { t_s: &means.t_s, columns, left, slope })
    }

    /// A jump of the thermistor at a time, K, and its standard uncertainty, to first order: behind it the sensor is colder by so much than it says.
    fn jump(&self, t_s: f64) -> Option<(f64, f64)> {
        let (mut along, mut square) = (0.0, 0.0);
        for (left, slope) in self.left.column_iter().zip(self.slope.column_iter()) {
            let behind = DVector::from_fn(slope.len(), |i, _| if self.t_s[i] < t_s { 0.0 } else { slope[i] });
            along -= behind.dot(&left);
            square += behind.norm_squared() - self.columns.tr_mul(&behind).norm_squared();
        }
        (square > 0.0).then(|| (along / square, square.sqrt().recip()))
    }

    /// The jump that explains most, of those right before a setting.
    fn scan(&self) -> Option<Seen> {
        let one = |t_s: &f64| {
            let (size_k, std_k) = self.jump(*t_s)?;
            Some(Seen { t_s: *t_s, size_k, std_k, gain: (size_k / std_k).powi(2) })
        };
        self.t_s.iter().skip(1).filter_map(one).max_by(|a, b| a.gain.total_cmp(&b.gain))
    }
}
