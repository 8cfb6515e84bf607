//! Sample rate and counter of samples that have times only.

use crate::data::error::Finding;

/// ns in a second.
const SECOND: f64 = 1e9;
/// A time that is late by more than this part of a period, against the times before, comes after a loss.
const LATE: f64 = 0.6;
/// The times before are averaged over so many samples.
const MEMORY: f64 = 16.0;
/// A column in which more than this part of the times repeats the one above is coarser than a sample.
const COARSE: f64 = 0.1;
/// A rate is taken for a rounder one that is so near: half of what the reader of run files allows a clock to be off.
const ROUND: f64 = 7e-4;

/// The times of samples, in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Samples {
    /// Counter.
    pub n: Vec<u64>,
    /// Time of every sample since the first one, ns: its own, or from the counter where times are coarse.
    pub smooth_ns: Vec<f64>,
    /// Nominal sample rate, Hz.
    pub rate_hz: f64,
    /// Rate of the times.
    pub measured_hz: f64,
    /// Step of a time column that is coarser than a sample, s.
    pub coarse_s: Option<f64>,
}

/// What the times tell of the rate.
#[derive(Clone, Copy, Debug)]
struct Steps {
    period_ns: f64,
    /// Step of a coarse column, 0 elsewhere.
    quantum_ns: f64,
}

/// Period and step of times in order; absent where all are equal.
fn steps(ns: &[i64]) -> Option<Steps> {
    let mut positive: Vec<i64> = ns.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0).collect();
    let repeats = ns.len().saturating_sub(1) - positive.len();
    positive.sort_unstable();
    let median = *positive.get(positive.len() / 2)? as f64;
    if repeats as f64 <= COARSE * ns.len() as f64 {
        return Some(Steps { period_ns: median, quantum_ns: 0.0 });
    }
    // From the first step to the last one, whole steps hold whole numbers of samples.
    let first = ns.iter().position(|t| *t > ns[0])?;
    let last = ns.iter().rposition(|t| *t < ns[ns.len() - 1]).map_or(0, |at| at + 1);
    let period_ns = if last > first { (ns[last] - ns[first]) as f64 / (last - first) as f64 } else { median / (first as f64) };
    Some(Steps { period_ns, quantum_ns: median })
}

/// Counter and smooth times since the first one for a period.
fn count(ns: &[i64], steps: Steps) -> (Vec<u64>, Vec<f64>) {
    let Steps { period_ns, quantum_ns } = steps;
    // ns since 1970 have more digits than a floating point number.
    let (mut n, mut smooth) = (vec![0], vec![0.0]);
    let (mut at_ns, mut weight) = (0.0, 1.0);
    for pair in ns.windows(2) {
        let tag = (pair[1] - ns[0]) as f64;
        let last = n[n.len() - 1];
        // The same time again in a column that is not coarse is the same sample.
        if pair[1] == pair[0] && quantum_ns == 0.0 {
            n.push(last);
            smooth.push(at_ns);
            continue;
        }
        let late = tag - (at_ns + period_ns);
        let lost = if late > LATE * period_ns + quantum_ns { (late / period_ns).round() } else { 0.0 };
        let expected = at_ns + (1.0 + lost) * period_ns;
        weight = if lost > 0.0 { 1.0 } else { (weight + 1.0_f64).min(if quantum_ns > 0.0 { 1e3 } else { MEMORY }) };
        at_ns = expected + (tag - expected) / weight;
        n.push(last + 1 + lost as u64);
        smooth.push(at_ns);
    }
    (n, smooth)
}

/// The nominal rate that a measured one stands for: rates and periods of few digits first.
pub(super) fn nominal(rate_hz: f64) -> f64 {
    let rounded = |value: f64, digits: i32| {
        let unit = 10f64.powi(value.log10().floor() as i32 + 1 - digits);
        // Through text, so that a rate of 66.7 Hz is that number and not its neighbour.
        format!("{:.9e}", (value / unit).round() * unit).parse().unwrap_or(value)
    };
    for digits in 1..=4 {
        let candidates: [f64; 2] = [rounded(rate_hz, digits), 1.0 / rounded(1.0 / rate_hz, digits)];
        if let Some(found) = candidates.into_iter().find(|c| (c / rate_hz - 1.0).abs() < ROUND) {
            return found;
        }
    }
    rate_hz
}

/// The rate of times in order; absent where all are equal.
pub(super) fn measured_hz(ns: &[i64]) -> Option<f64> {
    let mut steps = steps(ns)?;
    // The median of differences is as coarse as the digits of the times: the length of the whole run is better.
    for _ in 0..3 {
        let (n, _) = count(ns, steps);
        let samples = n[n.len() - 1];
        if samples > 0 && steps.quantum_ns == 0.0 {
            steps.period_ns = (ns[ns.len() - 1] - ns[0]) as f64 / samples as f64;
        }
    }
    Some(SECOND / steps.period_ns)
}

/// Counter and rate of samples with these times, which do not go back.
///
/// # Errors
/// One time for all rows, or a given rate that is not theirs.
pub(super) fn from_times(file: &str, ns: &[i64], given_hz: Option<f64>) -> Result<Samples, Finding> {
    let measured = measured_hz(ns).zip(steps(ns));
    let Some((measured_hz, found)) = measured else {
        let rule = "all rows have the same time, so that no sample rate can be found";
        return Err(Finding::error(file, rule, "name the column of the time, or one with a `counter` under [time]"));
    };
    let rate_hz = given_hz.unwrap_or_else(|| nominal(measured_hz));
    agrees(file, rate_hz, measured_hz)?;
    let (n, smooth) = count(ns, Steps { period_ns: SECOND / rate_hz, ..found });
    let coarse = found.quantum_ns > 0.0;
    let smooth_ns = if coarse { smooth } else { since_first(ns) };
    Ok(Samples { n, smooth_ns, rate_hz, measured_hz, coarse_s: coarse.then_some(found.quantum_ns / SECOND) })
}

/// Times since the first one, ns.
pub(super) fn since_first(ns: &[i64]) -> Vec<f64> {
    ns.iter().map(|t| (t - ns[0]) as f64).collect()
}

/// A given rate that is not that of the times makes losses or repetitions that are none.
pub(super) fn agrees(file: &str, rate_hz: f64, measured_hz: f64) -> Result<(), Finding> {
    const OFF: f64 = 0.02;
    if (measured_hz / rate_hz - 1.0).abs() > OFF {
        let rule = format!("the times come at {measured_hz:.4} Hz, and `sample_rate` is {rate_hz} Hz");
        return Err(Finding::error(
            file,
            rule,
            "correct `sample_rate` under [run] or `format` under [time], or take `sample_rate` out",
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(rate_hz: f64, digits: i32, count: u64, lost: std::ops::Range<u64>) -> Vec<i64> {
        let unit = 10f64.powi(9 - digits);
        (0..count).filter(|n| !lost.contains(n)).map(|n| ((n as f64 / rate_hz * 1e9 / unit).round() * unit) as i64).collect()
    }

    #[test]
    fn losses_are_found_although_the_clock_runs_a_little_off() {
        for (rate_hz, nominal_hz, digits) in [(127.9989, 128.0, 4), (10.0, 10.0, 3), (66.67, 200.0 / 3.0, 6), (0.99995, 1.0, 3)] {
            let ns = times(rate_hz, digits, 20_000, 5000..5056);
            let found = from_times("t", &ns, None).unwrap();
            assert!((found.rate_hz / nominal_hz - 1.0).abs() < 1e-9, "{} {nominal_hz}", found.rate_hz);
            let expected: Vec<u64> = (0..20_000).filter(|n| !(5000..5056).contains(n)).collect();
            assert!(found.n == expected, "{rate_hz}");
        }
    }

    #[test]
    fn coarse_times_become_smooth() {
        let ns: Vec<i64> = (0..5000_i64).map(|n| n / 10 * 1_000_000_000).collect();
        let found = from_times("t", &ns, None).unwrap();
        assert_eq!((found.rate_hz, found.coarse_s), (10.0, Some(1.0)));
        assert_eq!(found.n, (0..5000).collect::<Vec<u64>>());
        // Times of a clock that is read off by whole seconds are late by half a second on average.
        let late: Vec<f64> = found.smooth_ns.iter().enumerate().skip(1000).map(|(n, t)| t / 1e9 - n as f64 / 10.0).collect();
        assert!(late.iter().all(|l| (-0.6..0.1).contains(l)), "{late:?}");
    }

    #[test]
    fn a_wrong_rate_is_told() {
        let ns = times(128.0, 4, 2000, 0..0);
        let told = from_times("t", &ns, Some(10.0)).unwrap_err().to_string();
        // Times to a tenth of a millisecond tell the rate within some mHz.
        assert!(told.contains("`sample_rate` is 10 Hz") && (told.contains("127.99") || told.contains("128.00")), "{told}");
        assert!(from_times("t", &[5, 5, 5], None).unwrap_err().to_string().contains("same time"));
    }
}
