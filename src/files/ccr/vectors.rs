//! Rows of `@VECTORS`: a fast path for plain rows and the clock that turns counters into times.

use crate::data::run::{Gap, VectorAccount};

/// Bytes that a plain row can have at most: five numbers of fifteen digits with signs, points and separators.
pub(super) const WINDOW: usize = 104;

/// A row as it stands in the file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Row {
    pub n: u64,
    pub t_s: f64,
    /// Decimals of the time tag.
    pub t_decimals: u32,
    pub reading: [f64; 3],
}

/// Counter and time tag of a row.
#[derive(Clone, Copy, Debug)]
struct Tag {
    n: u64,
    t_s: f64,
}

impl Row {
    fn tag(&self) -> Tag {
        Tag { n: self.n, t_s: self.t_s }
    }
}

pub(super) const POWERS: [f64; 16] = [1.0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15];

/// Appends the digits at `at` to `number` and returns it with the index of the byte after them. Byte by byte, which was measured to be
/// a quarter faster than words of eight digits with computed ends; a likely reason is that a guessed end lets the next number begin.
#[inline(always)]
fn digits(row: &[u8; WINDOW], mut at: usize, mut number: u64) -> (u64, usize) {
    for byte in row.get(at..).unwrap_or_default() {
        let digit = u64::from(*byte).wrapping_sub(u64::from(b'0'));
        if digit > 9 {
            break;
        }
        number = number.wrapping_mul(10).wrapping_add(digit);
        at += 1;
    }
    (number, at)
}

/// A number without exponent, at most fifteen digits: a whole number below 2^53 divided by a power of ten below 10^22, hence
/// correctly rounded. Returns value, decimals, and the index of the byte after it.
#[inline(always)]
fn decimal(row: &[u8; WINDOW], at: usize) -> Option<(f64, u32, usize)> {
    let negative = *row.get(at)? == b'-';
    let begin = at + usize::from(negative);
    let (mut mantissa, mut end) = digits(row, begin, 0);
    let mut count = end - begin;
    let mut decimals = 0;
    if count == 0 {
        return None;
    }
    if row.get(end) == Some(&b'.') {
        let point = end + 1;
        (mantissa, end) = digits(row, point, mantissa);
        decimals = end - point;
        count += decimals;
        if decimals == 0 {
            return None;
        }
    }
    if count > 15 {
        return None;
    }
    #[expect(clippy::cast_precision_loss, reason = "at most fifteen digits")]
    let magnitude = mantissa.cast_signed() as f64 / POWERS[decimals & 15];
    // The sign of noise cannot be guessed, so it is no branch.
    let value = f64::from_bits(magnitude.to_bits() | (u64::from(negative) << 63));
    Some((value, decimals as u32, end))
}

/// Reads a row `n,t,x,y,z` of plain numbers with its line end. `None` means that the row needs the careful path, which finds out
/// what is unusual or wrong.
#[inline(always)]
pub(super) fn plain_row(row: &[u8; WINDOW]) -> Option<(Row, usize)> {
    let (n, at) = digits(row, 0, 0);
    if at == 0 || at > 15 {
        return None;
    }
    let comma = |at: usize| (row.get(at) == Some(&b',')).then_some(at + 1);
    let (t_s, t_decimals, at) = decimal(row, comma(at)?)?;
    let (x, _, at) = decimal(row, comma(at)?)?;
    let (y, _, at) = decimal(row, comma(at)?)?;
    let (z, _, at) = decimal(row, comma(at)?)?;
    let length = match row.get(at)? {
        b'\n' => at + 1,
        b'\r' if row.get(at + 1) == Some(&b'\n') => at + 2,
        _ => return None,
    };
    Some((Row { n, t_s, t_decimals, reading: [x, y, z] }, length))
}

/// What the clock says to a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Tick {
    /// A sample, with its time from the counter.
    Sample(f64),
    /// A repetition of the row before.
    Duplicate,
    /// The counter goes back.
    CounterBack { from: u64, to: u64 },
    /// The time tag goes back.
    TimeBack { from_s: f64, to_s: f64 },
    /// The time tag is away from the time of the counter; so far the tags run at this rate.
    Disagrees { by_s: f64, rate_hz: f64 },
}

/// Times from counters. The time of a sample is `n / rate` plus an offset that follows the mean of the last
/// [`Clock::MEMORY`] time tags, so that neither the rounding of the tags nor a sensor clock that runs a little off moves a
/// sample across the edge of a setting.
#[derive(Clone, Debug)]
pub(super) struct Clock {
    period_s: f64,
    first_n: u64,
    first_t_s: f64,
    offset_s: f64,
    weight: f64,
    last: Option<Tag>,
    quantum_s: f64,
    coarse: bool,
    /// Rows that repeat the time tag of the row above.
    pub equal_tags: u64,
    /// Lines of the first of them.
    pub equal_lines: Vec<u64>,
    decimals: u32,
    pub account: VectorAccount,
    /// Lines of the first repeated rows.
    pub duplicate_lines: Vec<u64>,
}

impl Clock {
    /// Samples over which the offset is averaged. A clock that is off by more than 1.5 samples in this many is refused.
    pub const MEMORY: f64 = 1024.0;
    /// Longest step of a time column that is taken for coarse, not for wrong.
    const LONGEST_STEP_S: f64 = 10.0;

    pub fn new(sample_rate_hz: f64) -> Self {
        Self {
            period_s: 1.0 / sample_rate_hz,
            first_n: 0,
            first_t_s: 0.0,
            offset_s: 0.0,
            weight: 0.0,
            last: None,
            quantum_s: 0.0,
            coarse: false,
            equal_tags: 0,
            equal_lines: Vec::new(),
            decimals: 0,
            account: VectorAccount::default(),
            duplicate_lines: Vec::new(),
        }
    }

    /// Takes the next row, which stands in `line`.
    #[inline(always)]
    pub fn tick(&mut self, row: &Row, line: u64) -> Tick {
        let Some(last) = self.last else { return self.first(row) };
        if (row.n != last.n + 1 || row.t_s <= last.t_s)
            && let Some(tick) = self.unusual(row, &last, line)
        {
            return tick;
        }
        if row.t_decimals > self.decimals {
            self.set_decimals(row.t_decimals);
        }
        #[expect(clippy::cast_precision_loss, reason = "a counter of fifteen digits is exact")]
        let nominal_s = (row.n - self.first_n).cast_signed() as f64 * self.period_s;
        let deviation_s = row.t_s - (nominal_s + self.offset_s);
        if deviation_s.abs() > self.tolerance_s() && !self.forgive(row, &last, deviation_s) {
            let rate_hz = self.rate_hz(row.tag());
            self.restart(row);
            return Tick::Disagrees { by_s: deviation_s, rate_hz };
        }
        if self.weight < Self::MEMORY {
            self.weight += 1.0;
            self.offset_s += deviation_s / self.weight;
        } else {
            // A power of two: the same as the division.
            self.offset_s += deviation_s * (1.0 / Self::MEMORY);
        }
        self.last = Some(row.tag());
        self.account.count += 1;
        Tick::Sample(nominal_s + self.offset_s)
    }

    /// How far a time tag may be from the time of the counter, s.
    #[inline(always)]
    fn tolerance_s(&self) -> f64 {
        1.5 * self.period_s + self.quantum_s
    }

    #[cold]
    fn set_decimals(&mut self, decimals: u32) {
        self.decimals = decimals;
        if !self.coarse {
            self.quantum_s = 0.75 * 10f64.powi(-(decimals.min(12) as i32));
        }
    }

    #[cold]
    fn first(&mut self, row: &Row) -> Tick {
        self.first_t_s = row.t_s;
        self.set_decimals(row.t_decimals);
        self.restart(row);
        self.account.count = 1;
        Tick::Sample(row.t_s)
    }

    /// Begins anew at a row, so that one fault is reported once.
    fn restart(&mut self, row: &Row) {
        self.first_n = row.n;
        self.offset_s = row.t_s;
        self.weight = 1.0;
        self.last = Some(row.tag());
    }

    /// A counter that does not go on by one, or a time tag that does not advance. `None`: a sample all the same.
    #[cold]
    fn unusual(&mut self, row: &Row, last: &Tag, line: u64) -> Option<Tick> {
        if row.n == last.n {
            self.account.duplicates += 1;
            if self.duplicate_lines.len() < 5 {
                self.duplicate_lines.push(line);
            }
            return Some(Tick::Duplicate);
        }
        if row.n < last.n || row.t_s < last.t_s {
            self.restart(row);
            return Some(if row.n < last.n {
                Tick::CounterBack { from: last.n, to: row.n }
            } else {
                Tick::TimeBack { from_s: last.t_s, to_s: row.t_s }
            });
        }
        if row.t_s == last.t_s {
            self.equal_tags += 1;
            if self.equal_lines.len() < 5 {
                self.equal_lines.push(line);
            }
        }
        let lost = row.n - last.n - 1;
        if lost > 0 {
            self.account.lost = self.account.lost.saturating_add(lost);
            self.account.gap_count += 1;
            if self.account.gaps.len() < VectorAccount::MOST_GAPS {
                self.account.gaps.push(Gap { line, t_s: row.t_s, lost });
            }
        }
        None
    }

    /// A time column whose steps are longer than a sample is accepted as such: the counter carries the time.
    #[cold]
    fn forgive(&mut self, row: &Row, last: &Tag, deviation_s: f64) -> bool {
        // Across a gap a clock that is off by up to 0.15 % is followed as it is elsewhere.
        #[expect(clippy::cast_precision_loss, reason = "a counter of fifteen digits is exact")]
        let gap_s = (row.n - last.n) as f64 * self.period_s;
        if deviation_s.abs() <= self.tolerance_s() + 0.0015 * gap_s {
            return true;
        }
        if 2 * self.equal_tags < self.account.count {
            return false;
        }
        // More than half of the tags repeat the one before: a column in steps. Its first steps tell how long they are.
        self.coarse = true;
        self.quantum_s = self.quantum_s.max((1.5 * (row.t_s - last.t_s)).min(Self::LONGEST_STEP_S));
        row.t_s == last.t_s || deviation_s.abs() <= self.tolerance_s()
    }

    /// Step of a time column that is coarser than a sample, s. Where more than a tenth of the tags repeat, the column is taken for
    /// coarse even if its steps are too short to be refused.
    pub fn coarse_step_s(&self) -> Option<f64> {
        if self.coarse {
            return Some(self.quantum_s / 1.5);
        }
        let span_s = self.last?.t_s - self.first_t_s;
        let distinct = self.account.count - self.equal_tags;
        (10 * self.equal_tags > self.account.count && distinct > 1).then(|| span_s / (distinct - 1) as f64)
    }

    /// The rate of the time tags if it cannot be that of the counter, Hz. A coarse column tells it over the whole run only.
    pub fn wrong_rate_hz(&self) -> Option<f64> {
        let last = self.last?;
        let rate_hz = self.rate_hz(last);
        let uncertainty = 1.5 / Self::MEMORY + self.coarse_step_s().unwrap_or_default() / (last.t_s - self.first_t_s);
        ((rate_hz * self.period_s - 1.0).abs() > uncertainty).then_some(rate_hz)
    }

    /// Rate of the time tags up to one of them, Hz.
    fn rate_hz(&self, Tag { n, t_s }: Tag) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "a counter of fifteen digits is exact")]
        let samples = (n - self.first_n).cast_signed() as f64;
        samples / (t_s - self.first_t_s)
    }

    /// The account, complete.
    pub fn finish(mut self) -> VectorAccount {
        if let Some(last) = self.last {
            self.account.span_s = Some([self.first_t_s, last.t_s]);
            self.account.measured_rate_hz = Some(self.rate_hz(last)).filter(|rate| rate.is_finite());
        }
        self.account
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plain(text: &str) -> Option<(Row, usize)> {
        let mut window = [0; WINDOW];
        window[..text.len()].copy_from_slice(text.as_bytes());
        plain_row(&window)
    }

    #[test]
    fn plain_rows_are_read_as_the_standard_library_reads_them() {
        for (n, t, x) in [
            ("0", "0.0000", "6.938"),
            ("12345678", "964.4531", "-54214.43"),
            ("123456789012345", "9999999.9999999", "0"),
            ("7", "1", "-0.0000001"),
            ("8", "0.00000000000001", "-12345678.9012345"),
            ("000000000000009", "007.50", "-0"),
        ] {
            let text = format!("{n},{t},{x},{x},1.5\n");
            let (row, length) = plain(&text).unwrap();
            assert_eq!(length, text.len());
            assert_eq!(row.n, n.parse::<u64>().unwrap());
            assert_eq!(row.t_s, t.parse::<f64>().unwrap());
            let x: f64 = x.parse().unwrap();
            assert_eq!(row.reading.map(f64::to_bits), [x, x, 1.5].map(f64::to_bits));
        }
        assert_eq!(plain("1,2,3,4,5\r\n").unwrap().1, 11);
    }

    #[test]
    fn anything_unusual_is_left_to_the_careful_path() {
        for text in [
            "1,2,3,4\n",
            "1,2,3,4,5,6\n",
            "1,2,3,4,5e3\n",
            "1,2,nan,4,5\n",
            "a,2,3,4,5\n",
            "-1,2,3,4,5\n",
            "1,,3,4,5\n",
            "1,2,3.,4,5\n",
            "1,2,.3,4,5\n",
            "1,2,3,4,123456789012345.5\n",
            "1234567890123456,2,3,4,5\n",
            "1;2;3;4;5\n",
            "1,2,3,4,5\r5\n",
            "1,2,3,4,5 \n",
        ] {
            assert_eq!(plain(text), None, "{text}");
        }
    }

    fn row(n: u64, t_s: f64) -> Row {
        Row { n, t_s, t_decimals: 4, reading: [0.0; 3] }
    }

    #[test]
    fn times_come_from_the_counter_and_follow_a_clock_that_is_a_little_off() {
        // 127.9989 Hz where 128 Hz are nominal, tags rounded to 0.1 ms: after half an hour the nominal time is 15 ms off.
        let mut clock = Clock::new(128.0);
        let mut worst: f64 = 0.0;
        for n in 0..230_400_u64 {
            let true_s = n as f64 / 127.9989;
            let tag = (true_s * 1e4).round() / 1e4;
            match clock.tick(&row(n, tag), n) {
                Tick::Sample(t_s) => worst = worst.max((t_s - true_s).abs()),
                other => panic!("{other:?}"),
            }
        }
        assert!(worst < 2e-4, "{worst}");
        assert!((clock.finish().measured_rate_hz.unwrap() - 127.9989).abs() < 1e-5);
    }

    #[test]
    fn a_wrong_rate_is_found_within_a_few_samples() {
        let mut clock = Clock::new(128.0);
        let found = (0..100_u64).find(|n| matches!(clock.tick(&row(*n, *n as f64 / 100.0), 1), Tick::Disagrees { .. }));
        assert!(found.unwrap() < 30);
    }

    #[test]
    fn a_coarse_time_column_is_replaced_by_the_counter() {
        let mut clock = Clock::new(128.0);
        for n in 0..20_000_u64 {
            let true_s = n as f64 / 128.0;
            match clock.tick(&Row { n, t_s: true_s.floor(), t_decimals: 0, reading: [0.0; 3] }, 1) {
                Tick::Sample(t_s) => assert!((t_s - true_s).abs() < 1.0),
                other => panic!("{n}: {other:?}"),
            }
        }
        assert!((clock.coarse_step_s().unwrap() - 1.0).abs() < 0.1);
    }

    #[test]
    fn gaps_repetitions_and_steps_back_are_told_apart() {
        let mut clock = Clock::new(1.0);
        assert!(matches!(clock.tick(&row(5, 5.0), 1), Tick::Sample(_)));
        assert!(matches!(clock.tick(&row(9, 9.0), 2), Tick::Sample(_)));
        assert_eq!(clock.account.lost, 3);
        assert_eq!(clock.tick(&row(9, 9.0), 3), Tick::Duplicate);
        assert!(matches!(clock.clone().tick(&row(8, 10.0), 4), Tick::CounterBack { from: 9, to: 8 }));
        assert!(matches!(clock.clone().tick(&row(10, 8.0), 5), Tick::TimeBack { .. }));
        assert!(matches!(clock.tick(&row(10, 14.0), 6), Tick::Disagrees { .. }));
    }
}
