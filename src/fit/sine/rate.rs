//! One sample rate for the sines of many settings.
//!
//! Every packet, one component of one setting, has its own sine, offset and noise, and its phase is unknown: only the progress
//! of the phase within it tells the rate. A packet of f Hz that lasts T seconds has a likelihood with a peak of the relative
//! width `1 / (f T)`: low frequencies lead to the right peak of the high ones, which give the digits.

use std::f64::consts::TAU;

use crate::fit::order::excess;
use crate::fit::scalar::minimum_by_thirds;

use super::{Fit, Oscillator, Residue, SineRefusal, Turn, check, noise_near, stretch};

/// Relative range of the search around the start value.
const RANGE: f64 = 1e-3;
/// Cycles of a packet in the first stage of the search: longer packets are cut, so that the work stays within bounds.
const STAGE_CYCLES: f64 = 3e5;
/// Cycles of a stage over those of the stage before, whose range it narrows by up to as much.
const STAGE_RATIO: f64 = 10.0;
/// Twice the logarithm of the likelihood below its maximum at which a rate is given up.
const GIVEN_UP: f64 = 50.0;
/// Cycles by which the phase may run off within a segment at the end of the range.
const SEGMENT_CYCLES: f64 = 0.1;
/// Segments of a packet at least.
const LEAST_SEGMENTS: f64 = 6.0;
/// Rates tried per width of the narrowest peak.
const PER_PEAK: f64 = 8.0;
/// Lowest rates of the scan which are followed to the bottom of their valley, with cuts to two thirds of its width.
const VALLEYS: usize = 50;
const THIRDS: usize = 14;
/// Deepest valleys which are compared on the samples, and steps to the bottom of each.
const CANDIDATES: usize = 5;
const CLIMBS: usize = 8;
/// Residuals below this share of the readings are rounding.
const LEAST_SHARE: f64 = 1e-12;
/// Relative step which ends the iteration.
const FINISHED: f64 = 1e-12;
/// In place of it: the share of the standard deviation at which the result may be used.
const SETTLED: f64 = 1e-3;
/// Steps altogether, and those at the begin in which a packet weighs by its residuals at the common rate.
const MAX_STEPS: usize = 40;
const PROFILE_STEPS: usize = 4;
/// Distance in standard deviations at which a packet disagrees.
const DISAGREES: f64 = 5.0;
/// Median of the magnitude of a standard Gaussian.
const MEDIAN_MAGNITUDE: f64 = 0.674_489_750_196_081_7;

/// The samples of one component in one setting.
#[derive(Clone, Copy, Debug)]
pub struct Packet<'a> {
    /// Rising counters of the clock which all packets share.
    pub n: &'a [u64],
    /// One reading per counter, any unit.
    pub y: &'a [f64],
    /// True frequency, Hz.
    pub frequency_hz: f64,
    /// Standard deviation of a reading that it has at least, whatever the residuals are, unit of the readings: rounding may leave the same at
    /// every phase, so that residuals do not show it.
    pub least_std: f64,
}

impl Packet<'_> {
    /// Sum of squares of residuals that are no smaller than they are said to be.
    fn least(&self, squares: f64) -> f64 {
        squares.max(self.y.len() as f64 * self.least_std.powi(2))
    }
}

/// How a packet was used.
#[derive(Clone, Debug, PartialEq)]
pub enum Verdict {
    /// It counts.
    Used,
    /// It contradicts the others by this many standard deviations and does not count.
    Disagrees {
        /// Its rate minus the common rate over its standard deviation.
        distance: f64,
    },
    /// It says nothing about the rate.
    Refused(SineRefusal),
}

/// The sample rate from one packet.
#[derive(Clone, Debug, PartialEq)]
pub struct PacketRate {
    /// Rate, Hz; NaN where the packet was refused. Good as long as it is within one peak of the common rate.
    pub rate_hz: f64,
    /// Standard deviation, Hz; NaN where the packet was refused.
    pub std_hz: f64,
    /// Middle of the packet, s after counter 0.
    pub time_s: f64,
    /// Standard deviation of one reading, unit of the readings; NaN where the packet was refused.
    pub residual_std: f64,
    /// How it was used.
    pub verdict: Verdict,
}

/// The best rate which is not on the peak of the result.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RunnerUp {
    /// Rate, Hz.
    pub rate_hz: f64,
    /// Weighted chi-square there minus that of the result: below some 25 the result is ambiguous.
    pub chi_square_excess: f64,
}

/// A linear drift of the rate over the run.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drift {
    /// Hz/s.
    pub hz_per_s: f64,
    /// Standard deviation, Hz/s.
    pub std_hz_per_s: f64,
}

/// The answer of [`common_rate`].
#[derive(Clone, Debug, PartialEq)]
pub struct CommonRate {
    /// Sample rate, Hz.
    pub rate_hz: f64,
    /// Standard deviation, Hz, inflated where the packets scatter more than they should.
    pub std_hz: f64,
    /// Chi-square of the rates of the used packets around the common one.
    pub chi_square: f64,
    /// Used packets less one.
    pub dof: usize,
    /// Factor by which `std_hz` was inflated; one where chi-square is below its 99 % quantile.
    pub inflation: f64,
    /// The second-best rate, where there is another peak in the range.
    pub runner_up: Option<RunnerUp>,
    /// Drift over the run; None where the used packets do not have two different times.
    pub drift: Option<Drift>,
    /// One per packet, in their order.
    pub packets: Vec<PacketRate>,
}

/// Why there is no common rate.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[allow(missing_docs, reason = "the messages tell what the fields are")]
pub enum RateRefusal {
    /// The start value is not a positive number.
    #[error("a sample rate of {rate_hz} Hz to start from is none")]
    Start { rate_hz: f64 },
    /// No packet can be used.
    #[error("none of {packets} sines can be used{}", first.as_ref().map_or_else(String::new, |why| format!(": {why}")))]
    NoPacket {
        packets: usize,
        /// Why the first one cannot.
        first: Option<SineRefusal>,
    },
    /// The best rate lies outside of the range searched.
    #[error("the best sample rate, {rate_hz:.6} Hz, is more than {:.1} % away from {start_hz} Hz", 100.0 * RANGE)]
    OutOfRange { start_hz: f64, rate_hz: f64 },
    /// The iteration did not come to rest.
    #[error("the sample rate did not settle near {rate_hz:.6} Hz")]
    NotSettled { rate_hz: f64 },
}

impl RateRefusal {
    /// The remedy, as an imperative.
    pub fn remedy(&self) -> &'static str {
        match self {
            Self::Start { .. } | Self::OutOfRange { .. } => "check the nominal sample rate and the frequencies",
            Self::NoPacket { first, .. } => first.as_ref().map_or("give settings with a sine", SineRefusal::remedy),
            Self::NotSettled { .. } => "leave out settings with lost samples or wrong frequencies",
        }
    }
}

/// Finds the sample rate at which every packet is a sine of its own frequency, within 0.1 % of `start_hz`.
///
/// Each packet counts with its own noise, taken near its frequency where that can be seen. Packets whose own rate contradicts
/// that of the others by more than five standard deviations (of all packets, if they scatter more than they should) do not
/// count; two packets cannot contradict each other.
///
/// # Errors
///
/// A [`RateRefusal`] where no packet can be used or the iteration leaves the range or does not settle.
pub fn common_rate(packets: &[Packet], start_hz: f64) -> Result<CommonRate, RateRefusal> {
    if !(start_hz > 0.0 && start_hz.is_finite()) {
        return Err(RateRefusal::Start { rate_hz: start_hz });
    }
    let refusals: Vec<Option<SineRefusal>> =
        packets.iter().map(|packet| check(packet.n, packet.y, packet.frequency_hz, start_hz, 5).err()).collect();
    let good: Vec<Packet> = packets.iter().zip(&refusals).filter(|(_, refusal)| refusal.is_none()).map(|(p, _)| *p).collect();
    if good.is_empty() {
        return Err(RateRefusal::NoPacket { packets: packets.len(), first: refusals.into_iter().flatten().next() });
    }

    let (captured, other) = capture(&good, start_hz);
    let (rate_hz, states) = settle(&good, captured)?;
    let used: Vec<&State> = states.iter().filter(|state| state.used).collect();
    let information: f64 = used.iter().map(|state| state.weight()).sum();
    if information <= 0.0 {
        let first = good.first().map(|p| SineRefusal::Undetermined { frequency_hz: p.frequency_hz, samples: p.n.len() });
        return Err(RateRefusal::NoPacket { packets: packets.len(), first });
    }
    let chi_square: f64 = used.iter().map(|state| (state.offset / state.std).powi(2)).sum();
    let dof = used.len() - 1;
    let inflation = excess(chi_square, dof);
    let std_hz = inflation / information.sqrt();
    if (rate_hz - start_hz).abs() > RANGE * start_hz + 5.0 * std_hz {
        return Err(RateRefusal::OutOfRange { start_hz, rate_hz });
    }
    let worse = |other: f64| -> f64 {
        let used = good.iter().zip(&states).filter(|(_, state)| state.used);
        used.map(|(packet, state)| (rss(packet, other) - state.rss) / state.noise.powi(2)).sum()
    };
    let runner_up = other.map(|other| RunnerUp { rate_hz: other, chi_square_excess: worse(other) });

    let times: Vec<f64> = good.iter().map(|packet| middle(packet.n) / rate_hz).collect();
    let drift = drift(&states, &times);
    let mut states = states.into_iter();
    let packets = packets.iter().zip(refusals).map(|(packet, refusal)| {
        let time_s = middle(packet.n) / rate_hz;
        let state = if refusal.is_none() { states.next() } else { None };
        let why = refusal.unwrap_or(SineRefusal::Undetermined { frequency_hz: packet.frequency_hz, samples: packet.n.len() });
        match state.filter(|state| state.std.is_finite()) {
            Some(State { std, offset, residual_std, used, .. }) => {
                let verdict = if used { Verdict::Used } else { Verdict::Disagrees { distance: offset / std } };
                PacketRate { rate_hz: rate_hz + offset, std_hz: std, time_s, residual_std, verdict }
            }
            None => {
                let nan = f64::NAN;
                PacketRate { rate_hz: nan, std_hz: nan, time_s, residual_std: nan, verdict: Verdict::Refused(why) }
            }
        }
    });
    Ok(CommonRate { rate_hz, std_hz, chi_square, dof, inflation, runner_up, drift, packets: packets.collect() })
}

/// The counter in the middle of a packet.
fn middle(n: &[u64]) -> f64 {
    match (n.first(), n.last()) {
        (Some(&first), Some(&last)) => 0.5 * (first as f64 + last as f64),
        _ => f64::NAN,
    }
}

/// The sine of a packet at a rate.
fn fit(packet: &Packet, rate_hz: f64) -> Option<Fit> {
    Fit::new(packet.n, packet.y, Turn::new(packet.frequency_hz.into(), rate_hz))
}

/// Residual sum of squares of a packet at a rate; infinite where the rate leaves its sine undetermined.
fn rss(packet: &Packet, rate_hz: f64) -> f64 {
    fit(packet, rate_hz).map_or(f64::INFINITY, |fit| fit.rss())
}

/// One packet at the common rate.
#[derive(Clone, Debug)]
struct State {
    /// Own rate minus common rate, Hz.
    offset: f64,
    /// Standard deviation of the own rate, Hz; infinite where the packet says nothing.
    std: f64,
    /// Residual sum of squares at the common rate.
    rss: f64,
    /// Standard deviation of a reading around the sine at the own rate.
    residual_std: f64,
    /// The same by the noise near the frequency.
    noise: f64,
    used: bool,
}

impl State {
    const SILENT: Self =
        Self { offset: 0.0, std: f64::INFINITY, rss: f64::INFINITY, residual_std: f64::NAN, noise: f64::INFINITY, used: false };

    fn weight(&self) -> f64 {
        1.0 / (self.std * self.std)
    }
}

/// Gauss-Newton steps from the captured rate; gives the rate and every packet at it.
fn settle(packets: &[Packet], captured_hz: f64) -> Result<(f64, Vec<State>), RateRefusal> {
    let mut rate_hz = captured_hz;
    // Noise near the frequency over that of all residuals, per packet: it is looked at once, near the end.
    let mut ratios: Option<Vec<f64>> = None;
    for step in 0..MAX_STEPS {
        let profile = step < PROFILE_STEPS;
        if !profile && ratios.is_none() {
            ratios = Some(noise_ratios(packets, rate_hz));
        }
        let mut states: Vec<State> = packets
            .iter()
            .enumerate()
            .map(|(i, packet)| state(packet, rate_hz, if profile { None } else { ratios.as_ref().map(|c| c[i]) }))
            .collect();
        if !profile {
            choose(&mut states);
        }
        let used = || states.iter().filter(|state| state.used);
        let information: f64 = used().map(State::weight).sum();
        if information <= 0.0 || information.is_nan() {
            return Ok((rate_hz, states));
        }
        let change = used().map(|state| state.weight() * state.offset).sum::<f64>() / information;
        let small = change.abs() <= FINISHED * rate_hz;
        if !profile && (small || step + 1 == MAX_STEPS && change.abs() <= SETTLED / information.sqrt()) {
            return Ok((rate_hz, states));
        }
        rate_hz += change;
        let walk = (rate_hz - captured_hz).abs();
        if walk > 2.0 * RANGE * captured_hz || walk.is_nan() {
            break;
        }
    }
    Err(RateRefusal::NotSettled { rate_hz })
}

/// A packet at a rate. Its noise is that around its own rate times the ratio of the noise near its frequency to all of it; where that is not
/// given, it is all that the common rate leaves over, so that packets of another rate weigh little.
fn state(packet: &Packet, rate_hz: f64, noise_ratio: Option<f64>) -> State {
    let Some(fit) = fit(packet, rate_hz) else {
        return State::SILENT;
    };
    let unit = -TAU * packet.frequency_hz / (rate_hz * rate_hz);
    let Some(slope) = fit.derivative(packet.n, unit) else {
        return State::SILENT;
    };
    let rss = fit.rss();
    let own = if noise_ratio.is_some() { (rss - slope.gradient * slope.step()).max(0.0) } else { rss };
    // Readings without noise still have rounding.
    let residual_std = (own / (packet.n.len() - 4) as f64).sqrt().max(f64::EPSILON * fit.size());
    let noise = (residual_std * noise_ratio.unwrap_or(1.0)).max(packet.least_std);
    State { offset: slope.step(), std: noise / slope.information.sqrt(), rss, residual_std, noise, used: true }
}

/// Noise near the frequency of every packet over that of all its residuals.
fn noise_ratios(packets: &[Packet], rate_hz: f64) -> Vec<f64> {
    // Residuals around the sine at the own rate, and its phase.
    let own = |packet: &Packet| {
        let fit = fit(packet, rate_hz)?;
        let slope = fit.derivative(packet.n, -TAU * packet.frequency_hz / (rate_hz * rate_hz))?;
        let residuals: Vec<f64> = fit.residuals.iter().zip(&slope.own).map(|(r, own)| r - slope.step() * own).collect();
        Some((residuals, fit.coefficients[1].atan2(fit.coefficients[0])))
    };
    let owns: Vec<(Vec<f64>, f64)> = packets.iter().map(|packet| own(packet).unwrap_or_default()).collect();
    let residues: Vec<Residue> = packets
        .iter()
        .zip(&owns)
        .map(|(packet, (residuals, phase_rad))| Residue {
            n: packet.n,
            residuals,
            frequency_hz: packet.frequency_hz,
            phase_rad: *phase_rad,
        })
        .collect();
    let over_white = |(near, residue): (Option<[f64; 2]>, &Residue)| {
        let [_, near] = near?;
        let white = (residue.residuals.iter().map(|r| r * r).sum::<f64>() / (residue.n.len() - 4) as f64).sqrt();
        (near > 0.0 && white > 0.0).then_some(near / white)
    };
    noise_near(&residues, rate_hz).into_iter().zip(&residues).map(|pair| over_white(pair).unwrap_or(1.0)).collect()
}

/// Marks the packets which agree: around the rate of the one with which most agree, then around their common rate.
fn choose(states: &mut [State]) {
    let heard: Vec<usize> = (0..states.len()).filter(|&i| states[i].std.is_finite()).collect();
    states.iter_mut().for_each(|state| state.used = state.std.is_finite());
    if heard.len() < 3 {
        return;
    }
    let distance = |states: &[State], i: usize, centre: f64| ((states[i].offset - centre) / states[i].std).abs();
    let loss = |centre: f64| -> f64 { heard.iter().map(|&i| distance(states, i, centre).min(DISAGREES).powi(2)).sum() };
    let best = heard.iter().map(|&i| (loss(states[i].offset), i)).min_by(|a, b| a.0.total_cmp(&b.0));
    let mut centre = best.map_or(0.0, |(_, i)| states[i].offset);
    // The centre itself has a distance of zero; the mean of those that agree replaces it.
    for _ in 0..10 {
        let mut distances: Vec<f64> = heard.iter().map(|&i| distance(states, i, centre)).collect();
        distances.sort_by(f64::total_cmp);
        let scale = (distances[distances.len() / 2] / MEDIAN_MAGNITUDE).max(1.0);
        let (mut sum, mut information) = (0.0, 0.0);
        for &i in &heard {
            states[i].used = distance(states, i, centre) <= DISAGREES * scale;
            if states[i].used {
                sum += states[i].weight() * states[i].offset;
                information += states[i].weight();
            }
        }
        if information <= 0.0 || information.is_nan() {
            return;
        }
        centre = sum / information;
    }
}

/// Straight line through the rates of the used packets.
fn drift(states: &[State], times: &[f64]) -> Option<Drift> {
    let used: Vec<(f64, f64, f64)> =
        states.iter().zip(times).filter(|(s, _)| s.used).map(|(s, &t)| (t, s.offset, s.weight())).collect();
    let information: f64 = used.iter().map(|(_, _, w)| w).sum();
    let mean = |value: &dyn Fn(&(f64, f64, f64)) -> f64| used.iter().map(|row| row.2 * value(row)).sum::<f64>() / information;
    let (mean_t, mean_x) = (mean(&|row| row.0), mean(&|row| row.1));
    let stt: f64 = used.iter().map(|(t, _, w)| w * (t - mean_t).powi(2)).sum();
    let stx: f64 = used.iter().map(|(t, x, w)| w * (t - mean_t) * (x - mean_x)).sum();
    // Packets of one setting differ in time by rounding only.
    if !(stt > 1e-12 * information * mean_t.powi(2) && used.len() > 2) {
        return None;
    }
    let hz_per_s = stx / stt;
    let chi_square = used.iter().map(|(t, x, w)| w * (x - mean_x - hz_per_s * (t - mean_t)).powi(2)).sum();
    let std_hz_per_s = excess(chi_square, used.len() - 2) / stt.sqrt();
    Some(Drift { hz_per_s, std_hz_per_s })
}

/// A segment of a packet: sums of its products with sine and cosine at the rate which the search is centred on.
#[derive(Clone, Copy, Default)]
struct Segment {
    /// Samples.
    count: f64,
    /// Mean counter from the middle of the packet.
    at: f64,
    /// Sums of sine and cosine, of half the cosine and half the sine of the double angle, of sine and cosine times reading.
    one: [f64; 2],
    double: [f64; 2],
    reading: [f64; 2],
}

/// A packet reduced to segments.
struct Reduced {
    segments: Vec<Segment>,
    /// Samples in them.
    count: f64,
    /// Sum of squares of the readings around their mean.
    squares: f64,
    /// What is left of them at least.
    least: f64,
    /// Radians per counter and relative change of the sample period.
    turn: f64,
}

impl Reduced {
    /// Segments within which the phase stays at rates within `range`.
    fn new(packet: &Packet, rate_hz: f64, range: f64) -> Self {
        let (n, y) = (packet.n, packet.y);
        let count = y.len() as f64;
        let (mean, middle) = (y.iter().sum::<f64>() / count, middle(n));
        let length = stretch(n);
        let cycles = packet.frequency_hz / rate_hz * length;
        let parts = (cycles * range / SEGMENT_CYCLES).ceil().max(LEAST_SEGMENTS);
        let mut segments = vec![Segment::default(); parts as usize];
        let mut oscillator = Oscillator::new(packet.frequency_hz, rate_hz);
        let mut squares = 0.0;
        for (&n_i, &y) in n.iter().zip(y) {
            let d = y - mean;
            let [s, c] = oscillator.at(n_i);
            let part = ((n_i - n[0]) as f64 / length * parts) as usize;
            let segment = &mut segments[part.min(parts as usize - 1)];
            segment.count += 1.0;
            segment.at += n_i as f64 - middle;
            for (sum, term) in [
                (&mut segment.one, [s, c]),
                (&mut segment.double, [0.5 * (c * c - s * s), s * c]),
                (&mut segment.reading, [s * d, c * d]),
            ] {
                sum[0] += term[0];
                sum[1] += term[1];
            }
            squares += d * d;
        }
        segments.retain(|segment| segment.count > 0.0);
        segments.iter_mut().for_each(|segment| segment.at /= segment.count);
        let least = packet.least(LEAST_SHARE * squares).max(f64::MIN_POSITIVE);
        Self { segments, count, squares, least, turn: TAU * packet.frequency_hz / rate_hz }
    }

    /// Twice the negative logarithm of the likelihood, with the noise that fits best, at a relative change of the period.
    fn cost(&self, change: f64) -> f64 {
        let ([mut s, mut c], [mut q, mut w], [mut sd, mut cd]) = ([0.0; 2], [0.0; 2], [0.0; 2]);
        for segment in &self.segments {
            let (sin, cos) = (self.turn * segment.at * change).sin_cos();
            let (sin2, cos2) = (2.0 * sin * cos, cos * cos - sin * sin);
            let ([s0, c0], [q0, w0], [sd0, cd0]) = (segment.one, segment.double, segment.reading);
            s += s0 * cos + c0 * sin;
            c += c0 * cos - s0 * sin;
            q += q0 * cos2 - w0 * sin2;
            w += w0 * cos2 + q0 * sin2;
            sd += sd0 * cos + cd0 * sin;
            cd += cd0 * cos - sd0 * sin;
        }
        let n = self.count;
        // Readings count from their mean: centring the columns is enough.
        let (ss, sc, cc) = (0.5 * n - q - s * s / n, w - s * c / n, 0.5 * n + q - c * c / n);
        let determinant = ss * cc - sc * sc;
        let explained =
            if determinant > 1e-8 * n * n { (cc * sd * sd - 2.0 * sc * sd * cd + ss * cd * cd) / determinant } else { 0.0 };
        n * (self.squares - explained).max(self.least).ln()
    }
}

/// Cycles of the longest packet.
fn longest(packets: &[Packet], rate_hz: f64) -> f64 {
    packets.iter().map(|packet| packet.frequency_hz / rate_hz * stretch(packet.n)).fold(0.0, f64::max)
}

/// The packets up to as many cycles, at least four samples of each.
fn cut<'a>(packets: &[Packet<'a>], most: f64, rate_hz: f64) -> Vec<Packet<'a>> {
    let cut = |packet: &Packet<'a>| {
        let last = packet.n[0] as f64 + most * rate_hz / packet.frequency_hz;
        let samples = packet.n.partition_point(|&n| n as f64 <= last).clamp(5, packet.n.len());
        Packet { n: &packet.n[..samples], y: &packet.y[..samples], ..*packet }
    };
    packets.iter().map(cut).collect()
}

/// The bottom of a valley within a step of `centre`, by thirds, and its depth.
fn bottom(cost: &impl Fn(f64) -> f64, centre: f64, step: f64) -> (f64, f64) {
    let at = minimum_by_thirds(cost, [centre - step, centre + step], THIRDS);
    (at, cost(at))
}

/// The top of the peak of the likelihood near a rate, and twice the negative logarithm of the likelihood there.
fn climb(packets: &[Packet], start_hz: f64, peak_hz: f64) -> (f64, f64) {
    let mut rate_hz = start_hz;
    for _ in 0..CLIMBS {
        let states: Vec<State> = packets.iter().map(|packet| state(packet, rate_hz, None)).collect();
        let information: f64 = states.iter().map(State::weight).sum();
        let change = states.iter().map(|state| state.weight() * state.offset).sum::<f64>() / information;
        // Not across the next valley.
        let walk = (rate_hz + change - start_hz).abs();
        if walk > 0.5 * peak_hz || walk.is_nan() {
            break;
        }
        rate_hz += change;
        if change.abs() * information.sqrt() <= SETTLED {
            break;
        }
    }
    let cost = |packet: &Packet| {
        let least = packet.least(packet.y.len() as f64 * f64::MIN_POSITIVE);
        packet.y.len() as f64 * rss(packet, rate_hz).clamp(least, f64::MAX).ln()
    };
    (rate_hz, packets.iter().map(cost).sum())
}

/// The rate with the largest likelihood within the range, near the top of its peak, and that of the next best peak.
fn capture(packets: &[Packet], start_hz: f64) -> (f64, Option<f64>) {
    let (mut centre_hz, mut range, mut most) = (start_hz, RANGE, STAGE_CYCLES);
    let mut runner_up = None;
    loop {
        let part = cut(packets, most, centre_hz);
        let width = 1.0 / longest(&part, centre_hz);
        let reduced: Vec<Reduced> = part.iter().map(|packet| Reduced::new(packet, centre_hz, range)).collect();
        let points = (2.0 * range / width * PER_PEAK).ceil().max(8.0) as usize;
        let step = 2.0 * range / points as f64;
        let change = |i: usize| step * i as f64 - range;
        let costs: Vec<f64> = (0..=points).map(|i| reduced.iter().map(|r| r.cost(change(i))).sum()).collect();
        let is_valley = |&i: &usize| (i == 0 || costs[i] < costs[i - 1]) && (i == points || costs[i] <= costs[i + 1]);
        let mut valleys: Vec<usize> = (0..=points).filter(is_valley).collect();
        valleys.sort_by(|&a, &b| costs[a].total_cmp(&costs[b]));
        valleys.truncate(VALLEYS);
        let total = |change: f64| reduced.iter().map(|r| r.cost(change)).sum::<f64>();
        let mut bottoms: Vec<(f64, f64)> = valleys.iter().map(|&i| bottom(&total, change(i), step)).collect();
        bottoms.sort_by(|a, b| a.1.total_cmp(&b.1));
        // Segments favour rates near the centre: peaks of nearly the same height are told apart by the samples.
        bottoms.truncate(CANDIDATES);
        let rate_at = |change: f64| centre_hz / (1.0 + change);
        let mut tops: Vec<(f64, f64)> = bottoms.iter().map(|b| climb(&part, rate_at(b.0), width * centre_hz)).collect();
        tops.sort_by(|a, b| a.1.total_cmp(&b.1));
        let Some(&(best_hz, best_cost)) = tops.first() else {
            return (centre_hz, None);
        };
        let apart = |rate_hz: f64| (rate_hz - best_hz).abs() > 0.5 * width * best_hz;
        let second = tops.iter().map(|top| top.0).find(|&rate_hz| apart(rate_hz));
        // A later stage sees more of the packets, but not the rates which this one gave up.
        runner_up = second.or(runner_up);
        if part.iter().zip(packets).all(|(part, whole)| part.n.len() == whole.n.len()) {
            return (best_hz, runner_up);
        }
        let lowest = bottoms.first().map_or(f64::INFINITY, |bottom| bottom.1);
        let flat = (0..=points).filter(|&i| costs[i] < lowest + GIVEN_UP).map(|i| rate_at(change(i)));
        let alive = flat.chain(tops.iter().filter(|top| top.1 < best_cost + GIVEN_UP).map(|top| top.0));
        let spread = alive.map(|rate_hz| (rate_hz / best_hz - 1.0).abs()).fold(0.0, f64::max);
        range = (range / STAGE_RATIO).max(1.5 * spread + 2.0 * width).min(range);
        (centre_hz, most) = (best_hz, most * STAGE_RATIO);
    }
}
