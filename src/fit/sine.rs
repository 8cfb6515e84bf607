//! Sines in samples at counted instants: amplitude, phase and frequency by least squares (IEEE 1057), the undamaged stretch of
//! a setting, and the sample rate which many settings share.
//!
//! Samples carry a counter, not a time: the instant of counter n is `n / rate`, gaps are allowed. The frequency may lie far
//! above half of the rate, the alias then is what the samples show. Phases are reduced without loss, so neither large counters
//! nor aliasing cost digits.
//!
//! * [`three`] and [`four`]: amplitude, phase and offset, the frequency given or free.
//! * [`Sums`] and [`coherent`]: normal equations of short segments and the longest stretch which one sine describes.
//! * [`common_rate`]: one sample rate for all settings of a run.
//! * [`local_noise_std`] and [`noise_near`]: what noise near the frequency does to amplitude and phase, of one sine and of many.

mod noise;
mod rate;
mod segments;
#[cfg(test)]
mod tests;

pub use noise::{Residue, noise_near};
pub use rate::{CommonRate, Drift, Packet, PacketRate, RateRefusal, RunnerUp, Verdict, common_rate};
pub use segments::{Sums, coherent};

use std::f64::consts::{PI, TAU};
use std::ops::RangeInclusive;

use nalgebra::DMatrix;

use super::double_double::DoubleDouble;
use super::statistics::std_of;

/// Cycles of the sine, and of its alias around 0 and half of the rate, which a fit asks for: a setting of one nominal period
/// may lose a fifth of it at its ends.
pub const LEAST_CYCLES: f64 = 0.8;
/// Share of the product of the variances of sine and cosine which is left in their determinant, below which samples at
/// unlucky instants do not tell the two apart.
const LEAST_DETERMINANT: f64 = 1e-8;
/// Samples between exact phases, and the length of plain sums.
const BLOCK: usize = 256;
/// Samples of a block whose phases are exact in its table: first and every so many after them.
const FINE: usize = 16;
/// Steps of the frequency.
const MAX_STEPS: usize = 40;
/// A step of this share of its standard deviation is the last one: the next is smaller by about the noise over the amplitude.
const FINISHED: f64 = 1e-9;
/// Steps which no longer shrink are rounding below this share of the standard deviation.
const STALLED: f64 = 1e-5;
/// Of the readings, without noise.
const ROUNDING: f64 = 16.0 * f64::EPSILON;
/// A frequency this many cycles over the stretch away from its start belongs to another peak.
const MAX_WALK: f64 = 2.0;
/// Share of the counters of a stretch which have to be there: bins of bursts far apart are not independent of the fit.
const LEAST_COVERAGE: f64 = 0.5;
/// Bins of the periodogram on each side, the nearest two left out.
const BINS: RangeInclusive<i32> = 2..=17;
/// Bins which make a mean; with fewer the slope of the spectrum is needed.
const ENOUGH_BINS: usize = 8;
/// Bins above the frequency which show the slope.
const SLOPE_BINS: RangeInclusive<i32> = 2..=33;
/// Variance of the logarithm of a bin of the periodogram, `π² / 6`.
const LOG_VARIANCE: f64 = PI * PI / 6.0;

/// Why samples have no answer.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum SineRefusal {
    /// Counters and readings differ in number.
    #[error("{counters} counters are given for {readings} readings")]
    Length { counters: usize, readings: usize },
    /// Too few samples for a fit with residuals.
    #[error("{samples} samples are given, {needed} needed")]
    TooFew { samples: usize, needed: usize },
    /// A reading is NaN or infinite, or a result overflowed.
    #[error("sample {row} is not finite")]
    NotFinite {
        /// Index of the sample, from 0.
        row: usize,
    },
    /// A counter does not exceed the one before, or has more than 53 bits.
    #[error("the counter of sample {row} does not exceed the one before it or is beyond 2^53")]
    Counter {
        /// Index of the sample, from 0.
        row: usize,
    },
    /// Frequency or rate is not a positive number.
    #[error("a frequency of {frequency_hz} Hz at {rate_hz} samples per second is no sine")]
    Frequency { frequency_hz: f64, rate_hz: f64 },
    /// The stretch is too short for the frequency.
    #[error("the samples span {cycles:.3} cycles of {frequency_hz} Hz, at least {} are needed", LEAST_CYCLES)]
    TooShort { frequency_hz: f64, cycles: f64 },
    /// The samples show the sine as a constant, or as one that changes its sign with every sample.
    #[error(
        "{frequency_hz} Hz at {rate_hz:.6} samples per second looks like {alias_hz:.6} Hz, {cycles:.3} cycles over the samples away \
         from {limit_hz:.6} Hz: sine and cosine cannot be told apart"
    )]
    Alias {
        frequency_hz: f64,
        rate_hz: f64,
        /// What the samples show, Hz, between 0 and half of the rate.
        alias_hz: f64,
        /// 0 or half of the rate, Hz: the one that is near.
        limit_hz: f64,
        /// Distance of the two, cycles over the stretch.
        cycles: f64,
    },
    /// The samples there are do not tell sine, cosine and offset apart.
    #[error("the instants of the {samples} samples do not tell sine and cosine of {frequency_hz} Hz apart")]
    Undetermined { frequency_hz: f64, samples: usize },
    /// The free frequency found no minimum near its start.
    #[error("the frequency did not settle near {frequency_hz} Hz within {iterations} steps")]
    NotSettled { frequency_hz: f64, iterations: usize },
}

impl SineRefusal {
    /// The remedy, as an imperative.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Length { .. } => "give one counter per reading",
            Self::TooFew { .. } | Self::TooShort { .. } => "measure longer at this frequency, or leave it out",
            Self::NotFinite { .. } => "remove readings which are not numbers",
            Self::Counter { .. } => "sort the samples by counter and remove duplicates",
            Self::Frequency { .. } => "check the frequency and the sample rate",
            Self::Alias { .. } => "measure at another frequency, further from multiples of half of the sample rate, or longer",
            Self::Undetermined { .. } => "measure at another frequency, or look for the missing samples",
            Self::NotSettled { .. } => "give a better start value of the frequency, or fit with a known one",
        }
    }
}

/// Cycles per sample with twice the digits of `f64`, whole cycles taken out.
#[derive(Clone, Copy, Debug)]
struct Turn(DoubleDouble);

impl Turn {
    fn new(frequency_hz: DoubleDouble, rate_hz: f64) -> Self {
        let ratio = frequency_hz / rate_hz;
        // Whole cycles do not show at whole counters; taking them out is exact.
        Self(ratio + DoubleDouble::from(-ratio.hi.round()))
    }

    /// Phase at a counter, cycles, within about half a cycle of zero.
    fn cycles(self, n: u64) -> f64 {
        let n = n as f64;
        let product = self.0.hi * n;
        let error = self.0.hi.mul_add(n, -product);
        let fraction = (product - product.round()) + self.0.lo.mul_add(n, error);
        fraction - fraction.round()
    }

    /// What the samples show, cycles per sample, 0 to 1/2.
    fn alias(self) -> f64 {
        self.0.value().abs()
    }
}

/// Phase of a sine of `frequency_hz` at counter `n` of a clock of `rate_hz`: `2π · frac(f n / f_s)` in (-π, π], rad.
///
/// Product and quotient keep their rounding errors: the result is good to 1e-15 rad for counters up to 2⁵³ and any frequency.
pub fn phase(frequency_hz: f64, rate_hz: f64, n: u64) -> f64 {
    TAU * Turn::new(frequency_hz.into(), rate_hz).cycles(n)
}

/// Sine and cosine of one frequency at counters: an exact phase per 256 counters, a table between them.
#[derive(Clone, Debug)]
pub struct Oscillator {
    turn: Turn,
    table: Vec<[f64; 2]>,
    block: u64,
    base: [f64; 2],
}

impl Oscillator {
    /// A sine of `frequency_hz` whose phase is zero at counter 0 of a clock of `rate_hz`.
    pub fn new(frequency_hz: f64, rate_hz: f64) -> Self {
        Self::of(Turn::new(frequency_hz.into(), rate_hz))
    }

    fn of(turn: Turn) -> Self {
        let exact = |n: usize| <[f64; 2]>::from((TAU * turn.cycles(n as u64)).sin_cos());
        let fine: [[f64; 2]; FINE] = std::array::from_fn(exact);
        let coarse = (0..BLOCK).step_by(FINE).map(exact);
        let table = coarse.flat_map(|first| fine.map(|angle| sum_of(first, angle))).collect();
        Self { turn, table, block: 0, base: [0.0, 1.0] }
    }

    /// `[sin, cos]` at counter `n`, good to some 6e-16; fastest in rising order.
    #[inline]
    pub fn at(&mut self, n: u64) -> [f64; 2] {
        let block = n / BLOCK as u64;
        if block != self.block {
            self.block = block;
            self.base = (TAU * self.turn.cycles(block * BLOCK as u64)).sin_cos().into();
        }
        sum_of(self.base, self.table[(n % BLOCK as u64) as usize])
    }
}

/// `[sin, cos]` of the sum of two angles, of each of which they are given.
#[inline]
fn sum_of([s, c]: [f64; 2], [sin, cos]: [f64; 2]) -> [f64; 2] {
    [s * cos + c * sin, c * cos - s * sin]
}

/// A fitted sine `y = A sin(2π f n / f_s) + B cos(2π f n / f_s) + C`.
#[derive(Clone, Debug, PartialEq)]
pub struct Sine {
    /// A, unit of the readings.
    pub sin: f64,
    /// B, unit of the readings.
    pub cos: f64,
    /// C, unit of the readings.
    pub offset: f64,
    /// f, Hz: as given or as fitted.
    pub frequency_hz: f64,
    /// `sqrt(A² + B²)`, unit of the readings.
    pub amplitude: f64,
    /// `atan2(B, A)`, rad: `y = amplitude · sin(2π f n / f_s + phase) + C`.
    pub phase_rad: f64,
    /// Covariance of A, B, C and, where it is free, f: 3 x 3 or 4 x 4, for independent errors of equal variance.
    pub covariance: DMatrix<f64>,
    /// Standard deviation of one reading, `sqrt(rss / dof)`.
    pub residual_std: f64,
    /// Samples minus parameters.
    pub dof: usize,
    /// Residual sum of squares.
    pub rss: f64,
    /// Standard deviation of the amplitude, unit of the readings.
    pub amplitude_std: f64,
    /// Standard deviation of the phase, rad; meaningless beside a noise of the amplitude that is not much smaller than it.
    pub phase_std_rad: f64,
    /// Standard deviation of C, unit of the readings.
    pub offset_std: f64,
    /// Standard deviation of f, Hz; zero where it was given.
    pub frequency_std_hz: f64,
    /// Observed minus fitted, one per sample.
    pub residuals: Vec<f64>,
}

/// Fits sine, cosine and offset of a known frequency.
///
/// `n` are rising counters of a clock of `rate_hz`, `y` one reading per counter in any unit. Phases refer to counter 0.
///
/// # Errors
///
/// A [`SineRefusal`] where the samples do not determine the three parameters and a residual.
pub fn three(n: &[u64], y: &[f64], frequency_hz: f64, rate_hz: f64) -> Result<Sine, SineRefusal> {
    let turn = check(n, y, frequency_hz, rate_hz, 4)?;
    let mut fit = Fit::new(n, y, turn).ok_or(SineRefusal::Undetermined { frequency_hz, samples: n.len() })?;
    let dof = n.len() - 3;
    let rss = fit.rss();
    let covariance = fit.basis.unscaled_covariance() * (rss / dof as f64);
    finish(&mut fit, frequency_hz, rss, dof, covariance)
}

/// Fits sine, cosine, offset and frequency, the frequency searched from `start_hz`, which must be good to about half a cycle
/// over the stretch. Otherwise as [`three`].
///
/// # Errors
///
/// A [`SineRefusal`] where the samples do not determine the four parameters and a residual, or where the frequency leaves the
/// peak it started on.
pub fn four(n: &[u64], y: &[f64], start_hz: f64, rate_hz: f64) -> Result<Sine, SineRefusal> {
    check(n, y, start_hz, rate_hz, 5)?;
    let refused = || SineRefusal::Undetermined { frequency_hz: start_hz, samples: n.len() };
    let range_hz = MAX_WALK * rate_hz / stretch(n);
    let dof = n.len() - 4;
    let mut frequency = DoubleDouble::from(start_hz);
    let mut last = f64::INFINITY;
    for iterations in 1..=MAX_STEPS {
        let turn = Turn::new(frequency, rate_hz);
        let mut fit = Fit::new(n, y, turn).ok_or_else(refused)?;
        let slope = fit.derivative(n, TAU / rate_hz).ok_or_else(refused)?;
        let step = slope.step();
        let rss = fit.rss();
        let std = (rss / dof as f64 / slope.information).sqrt();
        // What the step changes in the samples, root mean square, next to what their digits can show.
        let visible = step.abs() * (slope.information / n.len() as f64).sqrt() > ROUNDING * fit.size();
        let stalled = step.abs() >= 0.5 * last && (step.abs() <= STALLED * std || !visible);
        let settled = step.abs() <= FINISHED * std || stalled;
        // The frequency has twice the digits of f64: its rounding would show in the phase. Samples without noise may leave nothing.
        if settled || step.abs() <= f64::EPSILON.powi(2) * start_hz {
            let covariance = slope.covariance(&fit, rate_hz) * (rss / dof as f64);
            return finish(&mut fit, frequency.value(), rss, dof, covariance);
        }
        last = step.abs();
        frequency += step.into();
        if !((frequency.value() - start_hz).abs() <= range_hz && frequency.value() > 0.0) {
            return Err(SineRefusal::NotSettled { frequency_hz: start_hz, iterations });
        }
    }
    Err(SineRefusal::NotSettled { frequency_hz: start_hz, iterations: MAX_STEPS })
}

/// Puts the answer together; A and B of the fit refer to counter 0.
fn finish(fit: &mut Fit, frequency_hz: f64, rss: f64, dof: usize, covariance: DMatrix<f64>) -> Result<Sine, SineRefusal> {
    let [sin, cos, offset] = fit.coefficients;
    let offset = offset + fit.reference;
    let amplitude = sin.hypot(cos);
    // Without an amplitude any direction is as good.
    let (s, c) = if amplitude > 0.0 { (sin / amplitude, cos / amplitude) } else { (1.0, 0.0) };
    let (v_ss, v_sc, v_cc) = (covariance[(0, 0)], covariance[(0, 1)], covariance[(1, 1)]);
    let sine = Sine {
        sin,
        cos,
        offset,
        frequency_hz,
        amplitude,
        phase_rad: cos.atan2(sin),
        residual_std: (rss / dof as f64).sqrt(),
        dof,
        rss,
        amplitude_std: std_of(s * s * v_ss + 2.0 * s * c * v_sc + c * c * v_cc),
        phase_std_rad: std_of(c * c * v_ss - 2.0 * s * c * v_sc + s * s * v_cc) / amplitude,
        offset_std: covariance[(2, 2)].sqrt(),
        frequency_std_hz: if covariance.nrows() > 3 { covariance[(3, 3)].sqrt() } else { 0.0 },
        covariance,
        residuals: std::mem::take(&mut fit.residuals),
    };
    // Readings near the largest number overflow here.
    if rss.is_finite() && amplitude.is_finite() && offset.is_finite() { Ok(sine) } else { Err(SineRefusal::NotFinite { row: 0 }) }
}

/// Counters from the first to the last sample, one sample period for the last.
fn stretch(n: &[u64]) -> f64 {
    match (n.first(), n.last()) {
        (Some(first), Some(last)) => (last - first) as f64 + 1.0,
        _ => 0.0,
    }
}

/// Refuses what cannot be fitted; gives cycles per sample.
fn check(n: &[u64], y: &[f64], frequency_hz: f64, rate_hz: f64, needed: usize) -> Result<Turn, SineRefusal> {
    if n.len() != y.len() {
        return Err(SineRefusal::Length { counters: n.len(), readings: y.len() });
    }
    let ratio = frequency_hz / rate_hz;
    // The smallest normal number stands for zero as well as for what a quotient of denormal numbers would leave.
    if !(frequency_hz > 0.0 && rate_hz > 0.0 && ratio >= f64::MIN_POSITIVE && ratio < 2f64.powi(52)) {
        return Err(SineRefusal::Frequency { frequency_hz, rate_hz });
    }
    if n.len() < needed {
        return Err(SineRefusal::TooFew { samples: n.len(), needed });
    }
    if let Some(row) = y.iter().position(|y| !y.is_finite()) {
        return Err(SineRefusal::NotFinite { row });
    }
    if let Some(row) = n.windows(2).position(|pair| pair[1] <= pair[0] || pair[1] > 1 << 53) {
        return Err(SineRefusal::Counter { row: row + 1 });
    }
    let stretch = stretch(n);
    if ratio * stretch < LEAST_CYCLES {
        return Err(SineRefusal::TooShort { frequency_hz, cycles: ratio * stretch });
    }
    let turn = Turn::new(frequency_hz.into(), rate_hz);
    let alias = turn.alias();
    let (limit, distance) = if alias < 0.25 { (0.0, alias) } else { (0.5, 0.5 - alias) };
    if distance * stretch < LEAST_CYCLES {
        let (alias_hz, limit_hz) = (alias * rate_hz, limit * rate_hz);
        return Err(SineRefusal::Alias { frequency_hz, rate_hz, alias_hz, limit_hz, cycles: distance * stretch });
    }
    Ok(turn)
}

/// Sums over samples: plain within blocks, without loss between them.
fn sums<const K: usize>(count: usize, term: impl Fn(usize) -> [f64; K]) -> [f64; K] {
    let mut totals = [DoubleDouble::default(); K];
    for start in (0..count).step_by(BLOCK) {
        let mut block = [0.0; K];
        for i in start..count.min(start + BLOCK) {
            let term = term(i);
            for k in 0..K {
                block[k] += term[k];
            }
        }
        for k in 0..K {
            totals[k] += block[k].into();
        }
    }
    totals.map(DoubleDouble::value)
}

/// Sine, cosine and one at the counters of some samples, ready to be projected on.
struct Basis {
    /// `[sin, cos]` per sample.
    columns: Vec<[f64; 2]>,
    mean: [f64; 2],
    /// Inverse of the centred normal matrix of sine and cosine: ss, sc, cc.
    inverse: [f64; 3],
}

impl Basis {
    /// None where sine, cosine and offset cannot be told apart.
    fn new(n: &[u64], turn: Turn) -> Option<Self> {
        let mut oscillator = Oscillator::of(turn);
        let columns: Vec<[f64; 2]> = n.iter().map(|&n| oscillator.at(n)).collect();
        let count = columns.len() as f64;
        let mean = sums(columns.len(), |i| columns[i]).map(|sum| sum / count);
        let [ss, sc, cc] = sums(columns.len(), |i| {
            let (s, c) = (columns[i][0] - mean[0], columns[i][1] - mean[1]);
            [s * s, s * c, c * c]
        });
        let determinant = ss * cc - sc * sc;
        // Half of the samples is what either column has where it is sampled well.
        let determined = determinant > LEAST_DETERMINANT * (0.5 * count).powi(2);
        determined.then(|| Self { columns, mean, inverse: [cc / determinant, -sc / determinant, ss / determinant] })
    }

    /// Takes the projection out of `values` and gives its coefficients.
    fn project(&self, values: &mut [f64]) -> [f64; 3] {
        let mut coefficients = [0.0; 3];
        // The second round works on what the first left over: it removes the rounding of the normal equations.
        for _ in 0..2 {
            let [sum, sv, cv] = sums(values.len(), |i| {
                let ([s, c], v) = (self.columns[i], values[i]);
                [v, (s - self.mean[0]) * v, (c - self.mean[1]) * v]
            });
            let [ss, sc, cc] = self.inverse;
            let (a, b) = (ss * sv + sc * cv, sc * sv + cc * cv);
            let offset = sum / values.len() as f64 - a * self.mean[0] - b * self.mean[1];
            for (value, [s, c]) in values.iter_mut().zip(&self.columns) {
                *value -= a * s + b * c + offset;
            }
            for (sum, step) in coefficients.iter_mut().zip([a, b, offset]) {
                *sum += step;
            }
        }
        coefficients
    }

    /// `(XᵀX)⁻¹` of sine, cosine and one, 3 x 3.
    fn unscaled_covariance(&self) -> DMatrix<f64> {
        let ([ss, sc, cc], [s, c]) = (self.inverse, self.mean);
        let (so, co) = (-(ss * s + sc * c), -(sc * s + cc * c));
        let oo = 1.0 / self.columns.len() as f64 - so * s - co * c;
        DMatrix::from_row_slice(3, 3, &[ss, sc, so, sc, cc, co, so, co, oo])
    }
}

/// A sine of fixed frequency in some samples.
struct Fit {
    basis: Basis,
    /// Taken off the readings before anything else.
    reference: f64,
    /// A, B, and C without the reference.
    coefficients: [f64; 3],
    residuals: Vec<f64>,
}

/// The derivative of the samples by one more parameter which turns the phase in proportion to the counter.
struct Slope {
    /// Coefficients of what sine, cosine and offset share with it.
    shared: [f64; 3],
    /// What they do not share, one per sample.
    own: Vec<f64>,
    /// Its square.
    information: f64,
    /// Its product with the residuals.
    gradient: f64,
    /// The counter around which the phase turns.
    middle: u64,
}

impl Fit {
    /// None where the samples do not determine it.
    fn new(n: &[u64], y: &[f64], turn: Turn) -> Option<Self> {
        let basis = Basis::new(n, turn)?;
        let [sum] = sums(y.len(), |i| [y[i] - y[0]]);
        let reference = y[0] + sum / y.len() as f64;
        let mut residuals: Vec<f64> = y.iter().map(|y| y - reference).collect();
        let coefficients = basis.project(&mut residuals);
        Some(Self { basis, reference, coefficients, residuals })
    }

    fn rss(&self) -> f64 {
        let [rss] = sums(self.residuals.len(), |i| [self.residuals[i] * self.residuals[i]]);
        rss
    }

    /// Size of the readings.
    fn size(&self) -> f64 {
        let [a, b, _] = self.coefficients;
        a.hypot(b) + self.reference.abs()
    }

    /// The derivative by a parameter that turns the phase by `unit` rad per counter; None where it is zero.
    fn derivative(&self, n: &[u64], unit: f64) -> Option<Slope> {
        let ([a, b, _], middle) = (self.coefficients, n[0] / 2 + n[n.len() - 1] / 2);
        // Around the middle it shares least with sine and cosine.
        let turned = n.iter().map(|&n| unit * (n as i64 - middle as i64) as f64);
        let mut own: Vec<f64> = turned.zip(&self.basis.columns).map(|(turned, [s, c])| turned * (a * c - b * s)).collect();
        let shared = self.basis.project(&mut own);
        let [information, gradient] = sums(own.len(), |i| [own[i] * own[i], own[i] * self.residuals[i]]);
        (information > 0.0).then_some(Slope { shared, own, information, gradient, middle })
    }
}

impl Slope {
    /// Gauss-Newton step of the parameter.
    fn step(&self) -> f64 {
        self.gradient / self.information
    }

    /// Covariance of A, B, C and the frequency for readings of unit variance, 4 x 4.
    fn covariance(&self, fit: &Fit, rate_hz: f64) -> DMatrix<f64> {
        let mut covariance = DMatrix::zeros(4, 4);
        covariance.view_mut((0, 0), (3, 3)).copy_from(&fit.basis.unscaled_covariance());
        // The frequency turns the phase around the middle; A and B belong to counter 0.
        let turned = TAU / rate_hz * self.middle as f64;
        let [a, b, _] = fit.coefficients;
        let [s, c, o] = self.shared;
        let along = DMatrix::from_column_slice(4, 1, &[turned * b - s, -turned * a - c, -o, 1.0]);
        covariance + &along * along.transpose() / self.information
    }
}

/// Variance of A (or B) by the residuals at one frequency, cycles per sample.
fn periodogram(n: &[u64], residuals: &[f64], cycles: f64) -> f64 {
    let mut oscillator = Oscillator::of(Turn(cycles.into()));
    let (s, c) = n.iter().zip(residuals).fold((0.0, 0.0), |(s, c), (&n, r)| {
        let [sin, cos] = oscillator.at(n);
        (s + r * sin, c + r * cos)
    });
    2.0 * (s * s + c * c) / (n.len() as f64).powi(2)
}

/// Standard uncertainty of A (or B) at a frequency from the noise near it, unit of the residuals; None where there are too few
/// samples to see any, or where more than half of the stretch is missing.
///
/// The periodogram of the residuals, taken at up to 16 multiples of one cycle per stretch on either side of the alias of
/// `frequency_hz`, between half and twice the alias and below half of the rate, gives the variance of A; the two nearest
/// multiples are left out, because the fit took its share there. For white noise this is `s · sqrt(2 / N)`. Where the stretch
/// has only a few cycles the multiples above are used with the power law which they follow themselves.
pub fn local_noise_std(n: &[u64], residuals: &[f64], frequency_hz: f64, rate_hz: f64) -> Option<f64> {
    let turn = check(n, residuals, frequency_hz, rate_hz, 8).ok()?;
    if (n.len() as f64) < LEAST_COVERAGE * stretch(n) {
        return None;
    }
    let (alias, bin) = (turn.alias(), 1.0 / stretch(n));
    let variance = |cycles: f64| periodogram(n, residuals, cycles);
    let inside = |&cycles: &f64| cycles >= 0.5 * alias && cycles <= 2.0 * alias && cycles < 0.5;
    let both = BINS.flat_map(|k| [alias - f64::from(k) * bin, alias + f64::from(k) * bin]);
    let near: Vec<f64> = both.filter(inside).map(variance).collect();
    if near.len() >= ENOUGH_BINS {
        return Some((near.iter().sum::<f64>() / near.len() as f64).sqrt());
    }

    let above = SLOPE_BINS.map(|k| alias + f64::from(k) * bin).filter(|&cycles| cycles < 0.5);
    let spectrum: Vec<(f64, f64)> = above.map(|cycles| ((cycles / alias).ln(), variance(cycles))).collect();
    let count = spectrum.len() as f64;
    if spectrum.len() < ENOUGH_BINS {
        return None;
    }
    let mean_x = spectrum.iter().map(|(x, _)| x).sum::<f64>() / count;
    let sxx: f64 = spectrum.iter().map(|(x, _)| (x - mean_x).powi(2)).sum();
    let sxy: f64 = spectrum.iter().map(|(x, v)| (x - mean_x) * v.max(f64::MIN_POSITIVE).ln()).sum();
    // Drawn towards zero by its own variance: the slope of white noise is chance and must not be extrapolated. A rising or a very
    // steep spectrum is not, either.
    let slope = sxy / sxx;
    let slope = (slope * (1.0 - LOG_VARIANCE / (sxx * slope * slope)).max(0.0)).clamp(-2.0, 0.0);
    Some((spectrum.iter().map(|(x, v)| v * (-slope * x).exp()).sum::<f64>() / count).sqrt())
}
