//! Times of flight data: TT2000 as in CDF, UTC with its leap seconds, the clock of the spacecraft. All arithmetic is in whole nanoseconds.

use hifitime::leap_seconds::LatestLeapSeconds;
use jiff::civil::Date;
use std::fmt;

/// ns in a second.
pub const SECOND_NS: i64 = 1_000_000_000;
/// ns in a day without a leap second.
pub const DAY_NS: i64 = 86_400 * SECOND_NS;
/// TT - TAI, ns.
const TT_MINUS_TAI_NS: i64 = 32_184_000_000;
/// Days from 1970-01-01 to 2000-01-01.
const TO_2000_DAYS: i64 = 10_957;
/// Seconds from 1900-01-01, from which tables of leap seconds count, to 1970-01-01.
const TO_1970_S: i64 = 2_208_988_800;

/// The whole number of ns that is nearest to a length in seconds.
#[must_use]
pub fn ns(seconds: f64) -> i64 {
    #[expect(clippy::cast_possible_truncation, clippy::cast_precision_loss, reason = "lengths of up to years")]
    let ns = (seconds * SECOND_NS as f64).round() as i64;
    ns
}

/// ns since 2000-01-01T12:00:00 TT, continuous over leap seconds: `time_tt2000` of CDF.
pub type Tt2000 = i64;

/// A moment in UTC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Utc {
    /// Day, counted from 1970-01-01.
    pub day: i32,
    /// ns since its begin; at or beyond [`DAY_NS`] within a leap second.
    pub ns: i64,
}

impl Utc {
    /// Whether it lies within a leap second.
    #[must_use]
    pub fn in_leap_second(self) -> bool {
        self.ns >= DAY_NS
    }

    /// ns since 1970 as timestamps count, which know no leap seconds: within one it is the last ns before it ends its day.
    #[must_use]
    pub fn timestamp_ns(self) -> i64 {
        i64::from(self.day) * DAY_NS + self.ns.min(DAY_NS - 1)
    }

    /// Year, month, day.
    #[must_use]
    pub fn date(self) -> Date {
        date_of(self.day)
    }
}

/// The date of a day counted from 1970-01-01.
#[must_use]
pub fn date_of(day: i32) -> Date {
    Date::constant(1970, 1, 1).saturating_add(jiff::Span::new().days(day))
}

/// The day, counted from 1970-01-01, of a date.
#[must_use]
pub fn day_of(date: Date) -> i32 {
    Date::constant(1970, 1, 1).duration_until(date).as_hours().checked_div(24).and_then(|d| i32::try_from(d).ok()).unwrap_or(0)
}

impl fmt::Display for Utc {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let date = self.date();
        // Seconds of a day count to 60 in its last minute where there is a leap second.
        let s = self.ns / SECOND_NS;
        let (minute_of_day, second) = if self.in_leap_second() { (1439, s - 1439 * 60) } else { (s / 60, s % 60) };
        let (hour, minute, ns) = (minute_of_day / 60, minute_of_day % 60, self.ns % SECOND_NS);
        write!(f, "{:04}-{:02}-{:02}T{hour:02}:{minute:02}:{second:02}.{ns:09}", date.year(), date.month(), date.day())
    }
}

/// From when on ΔAT = TAI - UTC has a value.
#[derive(Clone, Copy, Debug)]
struct Step {
    /// First day, counted from 1970-01-01.
    day: i32,
    /// The same moment, TT2000.
    begin: Tt2000,
    /// ns.
    delta_at_ns: i64,
}

/// The table of leap seconds of the International Earth Rotation Service since 1972.
#[derive(Clone, Debug)]
pub struct LeapSeconds {
    steps: Vec<Step>,
}

impl Default for LeapSeconds {
    fn default() -> Self {
        let announced = LatestLeapSeconds::default().filter(|leap| leap.announced_by_iers);
        #[expect(clippy::cast_possible_truncation, reason = "whole seconds since 1900")]
        let step = |(timestamp_s, delta_at_s): (f64, f64)| {
            let day = (timestamp_s as i64 - TO_1970_S) / 86_400;
            let delta_at_ns = delta_at_s as i64 * SECOND_NS;
            Step { day: day as i32, begin: tt2000_of(day, 0, delta_at_ns), delta_at_ns }
        };
        let mut steps: Vec<Step> = announced.map(|leap| step((leap.timestamp_tai_s, leap.delta_at))).collect();
        steps.sort_unstable_by_key(|step| step.day);
        Self { steps }
    }
}

/// A time beyond those that can be told is the first or last one there is: [`is_possible`] says so.
fn tt2000_of(day: i64, ns: i64, delta_at_ns: i64) -> Tt2000 {
    (day - TO_2000_DAYS).saturating_mul(DAY_NS).saturating_add(ns).saturating_add(delta_at_ns + TT_MINUS_TAI_NS - DAY_NS / 2)
}

/// Whether a time of a file can be one: it lies within a century of 2000, so that differences of two have a value.
#[must_use]
pub fn is_possible(time: Tt2000) -> bool {
    const CENTURY_NS: u64 = 36_525 * DAY_NS as u64;
    time.unsigned_abs() < CENTURY_NS
}

impl LeapSeconds {
    /// UTC of a time. Times before 1972 have the offset of 1972.
    #[must_use]
    pub fn utc(&self, time: Tt2000) -> Utc {
        let next = self.steps.partition_point(|step| step.begin <= time);
        let delta_at_ns = self.steps.get(next.saturating_sub(1)).map_or(0, |step| step.delta_at_ns);
        let since_1970 = time.saturating_add(TO_2000_DAYS * DAY_NS + DAY_NS / 2 - TT_MINUS_TAI_NS - delta_at_ns);
        let (day, ns) = (since_1970.div_euclid(DAY_NS), since_1970.rem_euclid(DAY_NS));
        let day = i32::try_from(day).unwrap_or(i32::MAX);
        // The last second before a step counts as the 61st of the last minute of its day.
        match self.steps.get(next) {
            Some(step) if day >= step.day => Utc { day: step.day - 1, ns: ns + DAY_NS },
            _ => Utc { day, ns },
        }
    }

    /// The time of UTC.
    #[must_use]
    pub fn tt2000(&self, utc: Utc) -> Tt2000 {
        let next = self.steps.partition_point(|step| step.day <= utc.day);
        let delta_at_ns = self.steps.get(next.saturating_sub(1)).map_or(0, |step| step.delta_at_ns);
        tt2000_of(i64::from(utc.day), utc.ns, delta_at_ns)
    }

    /// Whether a day, counted from 1970-01-01, ends with a leap second.
    #[must_use]
    pub fn ends_with_leap_second(&self, day: i32) -> bool {
        self.steps.iter().skip(1).any(|step| step.day == day + 1)
    }

    /// The time of a timestamp, ns since 1970.
    #[must_use]
    pub fn tt2000_of_timestamp(&self, ns: i64) -> Tt2000 {
        let next = self.steps.partition_point(|step| i64::from(step.day) * DAY_NS <= ns);
        let delta_at_ns = self.steps.get(next.saturating_sub(1)).map_or(0, |step| step.delta_at_ns);
        tt2000_of(0, ns, delta_at_ns)
    }

    /// What a timestamp of a time says of it: the same time, but within a leap second the last ns before it.
    #[must_use]
    pub fn through_timestamp(&self, time: Tt2000) -> Tt2000 {
        let next = self.steps.partition_point(|step| step.begin <= time);
        // Before the first step there is none to insert.
        match self.steps.get(next.max(1)) {
            Some(step) if time >= step.begin - SECOND_NS => step.begin - SECOND_NS - 1,
            _ => time,
        }
    }

    /// The time of text like `2015-06-30T23:59:60.25Z`; the zone, which is always UTC, and everything behind the date may lack.
    #[must_use]
    pub fn parse(&self, text: &str) -> Option<Tt2000> {
        let text = text.trim();
        let text = text.strip_suffix('Z').unwrap_or(text);
        let (date, clock) = text.split_once(['T', ' ']).unwrap_or((text, ""));
        let whole = |part: &str, digits: usize| -> Option<i64> {
            (part.len() == digits && part.bytes().all(|b| b.is_ascii_digit())).then(|| part.parse().ok()).flatten()
        };
        let mut parts = date.splitn(3, '-');
        let (year, month, day) = (whole(parts.next()?, 4)?, whole(parts.next()?, 2)?, whole(parts.next()?, 2)?);
        let date = Date::new(i16::try_from(year).ok()?, i8::try_from(month).ok()?, i8::try_from(day).ok()?).ok()?;
        let day = day_of(date);
        let mut ns = 0;
        if !clock.is_empty() {
            let mut parts = clock.splitn(3, ':');
            let (hour, minute) = (whole(parts.next()?, 2)?, whole(parts.next()?, 2)?);
            let (second, fraction) = match parts.next() {
                None => (0, 0),
                Some(seconds) => match seconds.split_once('.') {
                    None => (whole(seconds, 2)?, 0),
                    Some((second, fraction)) if (1..=9).contains(&fraction.len()) => {
                        let digits = whole(fraction, fraction.len())?;
                        (whole(second, 2)?, digits * 10_i64.pow(9 - fraction.len() as u32))
                    }
                    Some(_) => return None,
                },
            };
            let last = if hour == 23 && minute == 59 && self.ends_with_leap_second(day) { 60 } else { 59 };
            if hour > 23 || minute > 59 || second > last {
                return None;
            }
            ns = ((hour * 60 + minute) * 60 + second) * SECOND_NS + fraction;
        }
        Some(self.tt2000(Utc { day, ns })).filter(|time| is_possible(*time))
    }

    /// First and last moment of a UTC day, the last one not of it, leap second included.
    #[must_use]
    pub fn day(&self, day: i32) -> std::ops::Range<Tt2000> {
        self.tt2000(Utc { day, ns: 0 })..self.tt2000(Utc { day: day + 1, ns: 0 })
    }

    /// The moment from which a spacecraft clock counts SI seconds, 2003-01-01T00:00:00 UTC for Rosetta (RO-IGEP-TR0028 section 4.1).
    #[must_use]
    pub fn clock_begin(&self) -> Tt2000 {
        self.tt2000(Utc { day: 12_053, ns: 0 })
    }

    /// The times of readings of such a clock, s.
    #[must_use]
    pub fn of_clock(&self, clock_s: &[f64]) -> Vec<Tt2000> {
        let begin = self.clock_begin();
        #[expect(clippy::cast_possible_truncation, reason = "seconds of decades in ns")]
        let time = |s: &f64| begin.saturating_add((s * SECOND_NS as f64).round() as i64);
        clock_s.iter().map(time).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_far_beyond_those_of_a_mission_do_not_come_round_again() {
        let leap = LeapSeconds::default();
        // 9999-12-31 is 2.5e20 ns behind 2000, more than 2^63.
        for text in ["9999-12-31T00:00:00", "0001-01-01", "1899-12-31", "2100-01-02"] {
            assert_eq!(leap.parse(text), None, "{text}");
        }
        assert!(["1901-01-01", "2099-12-31T23:59:59.999999999Z"].iter().all(|text| leap.parse(text).is_some()));
        for ns in [i64::MIN, i64::MAX] {
            let _ = leap.utc(ns).to_string();
            assert!(!is_possible(leap.tt2000_of_timestamp(ns)) && !is_possible(leap.through_timestamp(ns)));
        }
        assert!(leap.of_clock(&[1e300, -1e300]).iter().all(|time| !is_possible(*time)));
    }

    #[test]
    fn tt2000_is_that_of_cdf() {
        let leap = LeapSeconds::default();
        // 2000-01-01T12:00:00 UTC is 64.184 s after the same label in TT: 32 leap seconds and 32.184 s.
        assert_eq!(leap.parse("2000-01-01T12:00:00Z"), Some(64_184_000_000));
        // 5660 days after 2000-01-01, less half a day, with 36 leap seconds and 32.184 s.
        assert_eq!(leap.parse("2015-07-01T00:00:00.000000000Z"), Some(488_980_868_184_000_000));
        assert_eq!(leap.parse("2015-06-30T23:59:60.000Z"), Some(488_980_867_184_000_000));
        assert_eq!(leap.parse("2015-06-30T23:59:59"), Some(488_980_866_184_000_000));
    }

    #[test]
    fn a_timestamp_holds_every_time_but_those_of_a_leap_second() {
        let leap = LeapSeconds::default();
        for text in ["1971-05-05T00:00:00Z", "2015-06-30T23:59:59.999999999Z", "2015-07-01T00:00:00Z", "2026-01-01T00:00:00Z"] {
            let time = leap.parse(text).unwrap();
            assert_eq!(leap.through_timestamp(time), time, "{text}");
            assert_eq!(leap.tt2000_of_timestamp(leap.utc(time).timestamp_ns()), time, "{text}");
        }
        let before = leap.parse("2015-06-30T23:59:59.999999999Z").unwrap();
        for text in ["2015-06-30T23:59:60Z", "2015-06-30T23:59:60.999999999Z"] {
            assert_eq!(leap.through_timestamp(leap.parse(text).unwrap()), before, "{text}");
        }
    }

    #[test]
    fn every_label_comes_back() {
        let leap = LeapSeconds::default();
        for text in [
            "1999-12-31T23:59:59.999999999",
            "2004-02-29T00:00:00.000000001",
            "2015-06-30T23:59:59.999999999",
            "2015-06-30T23:59:60.000000000",
            "2015-06-30T23:59:60.999999999",
            "2015-07-01T00:00:00.000000000",
            "2016-12-31T23:59:60.500000000",
            "2026-11-23T12:34:56.000000000",
        ] {
            let time = leap.parse(text).unwrap();
            assert_eq!(leap.utc(time).to_string(), text);
            assert_eq!(leap.tt2000(leap.utc(time)), time);
        }
        assert!(leap.utc(leap.parse("2015-06-30T23:59:60.5").unwrap()).in_leap_second());
        assert_eq!(leap.day(day_of(Date::constant(2015, 6, 30))).count_s(), 86_401);
        assert_eq!(leap.day(day_of(Date::constant(2015, 7, 1))).count_s(), 86_400);
    }

    trait CountS {
        fn count_s(self) -> i64;
    }

    impl CountS for std::ops::Range<Tt2000> {
        fn count_s(self) -> i64 {
            (self.end - self.start) / SECOND_NS
        }
    }

    #[test]
    fn what_is_no_time_is_refused() {
        let leap = LeapSeconds::default();
        for text in ["2015-06-29T23:59:60", "2015-06-31", "2015-6-30", "2015-06-30T24:00:00", "2015-06-30T12:00:00.", "12:00", ""]
        {
            assert_eq!(leap.parse(text), None, "{text}");
        }
    }
}
