//! Value ranges, round tick steps and tick labels free of rounding noise.

use super::Scale;

/// Values beyond this size are not drawn: differences between them may overflow.
const LARGEST: f64 = 1e300;

/// Values below this size are not drawn on a logarithmic scale: their ticks would lose digits.
const SMALLEST: f64 = 1e-280;

/// Most ticks an axis may carry.
const MOST_TICKS: usize = 16;

/// Whether a value can be placed on an axis.
pub(super) fn usable(value: f64) -> bool {
    value.abs() <= LARGEST
}

impl Scale {
    /// Whether a value can be placed on an axis of this scale.
    pub(super) fn takes(self, value: f64) -> bool {
        match self {
            Scale::Linear | Scale::TimeOfDay => usable(value),
            Scale::Logarithmic => (SMALLEST..=LARGEST).contains(&value),
        }
    }

    /// What a length along an axis is proportional to; not finite for values a logarithmic axis
    /// does not take.
    pub(super) fn place(self, value: f64) -> f64 {
        match self {
            Scale::Linear | Scale::TimeOfDay => value,
            Scale::Logarithmic => value.log10(),
        }
    }
}

/// Interval covered by the values shown to it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Span {
    pub scale: Scale,
    /// Ends as places on the scale.
    pub low: f64,
    pub high: f64,
}

impl Span {
    pub fn empty(scale: Scale) -> Span {
        Span { scale, low: f64::INFINITY, high: f64::NEG_INFINITY }
    }

    pub fn add(&mut self, value: f64) {
        if self.scale.takes(value) {
            let place = self.scale.place(value);
            self.low = self.low.min(place);
            self.high = self.high.max(place);
        }
    }

    pub fn is_empty(&self) -> bool {
        self.low > self.high
    }

    pub fn contains(&self, value: f64) -> bool {
        let place = self.scale.place(value);
        self.low <= place && place <= self.high
    }

    pub fn width(&self) -> f64 {
        self.high - self.low
    }

    /// The interval with a margin on both sides, never degenerate; `None` when it is empty.
    pub fn padded(&self, share: f64) -> Option<Span> {
        if self.is_empty() {
            return None;
        }
        let size = match self.scale {
            Scale::Linear | Scale::TimeOfDay => self.low.abs().max(self.high.abs()),
            // A decade, wherever it lies.
            Scale::Logarithmic => 1.0,
        };
        // Differences below the resolution of a double are rounding, not data.
        let equal = self.width() <= size * 1e-12 || size < 1e-280;
        let margin = match equal {
            true if size < 1e-280 => 1.0,
            true => size * 0.05,
            false => self.width() * share,
        };
        Some(Span { low: self.low - margin, high: self.high + margin, ..*self })
    }
}

/// One labelled position on an axis.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Tick {
    pub value: f64,
    pub label: String,
}

/// An axis with its ticks.
#[derive(Debug, Clone)]
pub(super) struct Axis {
    pub span: Span,
    pub ticks: Vec<Tick>,
    /// Positions between the labelled ones.
    pub minor: Vec<f64>,
    /// Factor and offset common to all labels, empty for labels that are plain values.
    pub note: String,
}

impl Axis {
    /// Chooses the finest ticks whose labels have room; `room` is told the labels and the least
    /// distance of neighbouring ticks in pixels.
    pub fn new(span: Span, length: f64, room: impl Fn(&[Tick], f64) -> bool) -> Axis {
        match span.scale {
            Scale::Linear => Axis::linear(span, length, room),
            Scale::Logarithmic => Axis::logarithmic(span, length, room),
            Scale::TimeOfDay => Axis::time_of_day(span, length, room),
        }
    }

    /// Ticks at round times of a clock; parts of a second are decimal hours.
    fn time_of_day(span: Span, length: f64, room: impl Fn(&[Tick], f64) -> bool) -> Axis {
        let mut axis = Axis::bare(span);
        let [low_s, high_s] = [span.low, span.high].map(|hours| 3600.0 * hours);
        let multiples = |step_s: i64| {
            let step = step_s as f64;
            ((low_s / step - 1e-9).ceil() as i64..=(high_s / step + 1e-9).floor() as i64).map(move |n| n * step_s)
        };
        for (step_s, minor_s) in CLOCK_S {
            let count = multiples(step_s).count();
            if count > MOST_TICKS {
                continue;
            }
            if count < 2 {
                break;
            }
            let tick = |at: i64| Tick { value: at as f64 / 3600.0, label: clock(at, step_s) };
            axis.ticks = multiples(step_s).map(tick).collect();
            axis.minor = multiples(minor_s).filter(|at| at % step_s != 0).map(|at| at as f64 / 3600.0).collect();
            if room(&axis.ticks, step_s as f64 / (high_s - low_s) * length) {
                break;
            }
        }
        if axis.ticks.is_empty() { Axis::linear(span, length, room) } else { axis }
    }

    fn bare(span: Span) -> Axis {
        Axis { span, ticks: Vec::new(), minor: Vec::new(), note: String::new() }
    }

    /// Ticks at powers of ten, with 2 and 5 times them where less than two decades are shown.
    fn logarithmic(span: Span, length: f64, room: impl Fn(&[Tick], f64) -> bool) -> Axis {
        let mut axis = Axis::bare(span);
        let decade = length / span.width();
        let first = span.low.floor() as i32;
        let last = span.high.floor() as i32;
        let values = |step: i32, factors: &'static [i64]| {
            let exponents = (first..=last).filter(move |e| e.rem_euclid(step) == 0);
            let all = exponents.flat_map(move |e| factors.iter().map(move |&f| (f, e)));
            all.filter(move |&(f, e)| span.contains(scaled(f, e)))
        };
        let fine = (span.width() < 2.0).then_some((1, &[1, 2, 5][..]));
        for (step, factors) in fine.into_iter().chain((1..).map(|step| (step, &[1][..]))) {
            let count = values(step, factors).count();
            if count < 2 {
                break;
            }
            if count > MOST_TICKS {
                continue;
            }
            let tick = |(factor, exponent)| Tick { value: scaled(factor, exponent), label: power(factor, exponent) };
            axis.ticks = values(step, factors).map(tick).collect();
            let between: &[i64] = match step {
                // Closer ones would run together.
                1 if decade < 60.0 => &[2, 5],
                1 => &[2, 3, 4, 5, 6, 7, 8, 9],
                _ => &[1],
            };
            let is_labelled = |&(f, e): &(i64, i32)| e.rem_euclid(step) == 0 && factors.contains(&f);
            let minor = values(1, between).filter(|number| !is_labelled(number));
            axis.minor = minor.map(|(factor, exponent)| scaled(factor, exponent)).collect();
            let least = if factors.len() > 1 { 2f64.log10() } else { f64::from(step) };
            if room(&axis.ticks, least * decade) {
                break;
            }
        }
        if axis.ticks.len() < 3 && span.width() < 1.0 {
            // So narrow a range is nearly linear: even steps, closest together at the upper end.
            let (low, high) = (10f64.powf(span.low), 10f64.powf(span.high));
            let closest = (high - low) / (high * (high / low).ln());
            let even = Span { scale: Scale::Linear, low, high };
            axis = Axis { span, ..Axis::linear(even, length * closest, room) };
        }
        axis
    }

    /// Steps of 1, 2 or 5 times a power of ten.
    fn linear(span: Span, length: f64, room: impl Fn(&[Tick], f64) -> bool) -> Axis {
        let mut axis = Axis::bare(span);
        let first = (span.width() / MOST_TICKS as f64).log10().floor() as i32;
        for (exponent, factor) in (first..first + 4).flat_map(|e| [(e, 1), (e, 2), (e, 5)]) {
            let unit = |n: i64| scaled(n, exponent);
            let step = unit(factor);
            let low = (span.low / step - 1e-9).ceil() as i64;
            let high = (span.high / step + 1e-9).floor() as i64;
            let count = high - low + 1;
            if count > MOST_TICKS as i64 {
                continue;
            }
            if count < 1 || (count == 1 && !axis.ticks.is_empty()) {
                break;
            }
            let numbers: Vec<i64> = (low..=high).map(|n| n * factor).collect();
            let (labels, note) = labels(&numbers, exponent);
            axis.ticks = numbers.iter().zip(labels).map(|(&n, label)| Tick { value: unit(n), label }).collect();
            axis.note = note;
            axis.minor = minor(span, exponent, factor);
            if room(&axis.ticks, step / span.width() * length) {
                break;
            }
        }
        axis
    }

    /// Position of a value on a stretch of pixels.
    pub fn at(&self, value: f64, from: f64, to: f64) -> f64 {
        from + (self.span.scale.place(value) - self.span.low) / self.span.width() * (to - from)
    }
}

/// Round steps of a clock and the steps between their ticks, s.
const CLOCK_S: [(i64, i64); 17] = [
    (1, 1),
    (2, 1),
    (5, 1),
    (10, 2),
    (15, 5),
    (30, 10),
    (60, 15),
    (120, 30),
    (300, 60),
    (600, 120),
    (900, 300),
    (1800, 600),
    (3600, 900),
    (7200, 1800),
    (10_800, 3600),
    (21_600, 3600),
    (43_200, 10_800),
];

/// A time of the day, of ticks that are so many seconds apart.
fn clock(at_s: i64, step_s: i64) -> String {
    let (hours, minutes, seconds) = (at_s.div_euclid(3600), at_s.rem_euclid(3600) / 60, at_s.rem_euclid(60));
    if step_s < 60 { format!("{hours:02}:{minutes:02}:{seconds:02}") } else { format!("{hours:02}:{minutes:02}") }
}

/// Quarters of steps of 2, fifths of other steps.
fn minor(span: Span, exponent: i32, factor: i64) -> Vec<f64> {
    let parts = if factor == 2 { 4 } else { 5 };
    // Counted in hundredths of the power of ten, of which all parts are whole numbers.
    let part = 100 * factor / parts;
    let unit = |n: i64| scaled(n * part, exponent - 2);
    let low = (span.low / unit(1)).ceil() as i64;
    let high = (span.high / unit(1)).floor() as i64;
    let between = (low..=high).filter(|n| n % parts != 0);
    between.map(unit).collect()
}

/// `number` times a power of ten, divided rather than multiplied where that is exact.
fn scaled(number: i64, exponent: i32) -> f64 {
    match exponent {
        0.. => number as f64 * 10f64.powi(exponent),
        _ => number as f64 / 10f64.powi(-exponent),
    }
}

fn digits(number: i64) -> i32 {
    number.unsigned_abs().checked_ilog10().unwrap_or(0) as i32 + 1
}

/// Writes ascending numbers, in units of a power of ten, as short labels and the note that goes
/// with them. Everything is done on the integers, so that no label shows binary rounding.
fn labels(numbers: &[i64], exponent: i32) -> (Vec<String>, String) {
    let (Some(&first), Some(&last)) = (numbers.first(), numbers.last()) else {
        return (Vec::new(), String::new());
    };
    let largest = first.abs().max(last.abs());
    let spread = (last - first).max(1);
    let length = (digits(largest) + exponent).max(1) + (-exponent).max(0);
    let mut notes = Vec::new();
    let mut offset = 0;
    if length > 7 && largest / 1000 >= spread {
        let round = 10i64.saturating_pow(digits(spread) as u32);
        let nearest = if first > 0 { first } else { last };
        offset = nearest / round * round;
    }
    let size = numbers.iter().fold(0, |size: i64, n| size.max((n - offset).abs()));
    let magnitude = digits(size) + exponent - 1;
    let power = match magnitude {
        -3..=5 => 0,
        _ => magnitude.div_euclid(3) * 3,
    };
    if power != 0 {
        notes.push(format!("×10{}", superscript(power)));
    }
    if offset != 0 {
        let sign = if offset < 0 { "−" } else { "+" };
        notes.push(format!("offset {sign}{}", amount(offset.abs(), exponent)));
    }
    let labels = numbers.iter().map(|n| decimal(n - offset, exponent - power)).collect();
    (labels, notes.join("  "))
}

/// An offset in full, or in powers of ten when that would be a long row of zeros.
fn amount(mut number: i64, mut exponent: i32) -> String {
    while number % 10 == 0 && number != 0 {
        number /= 10;
        exponent += 1;
    }
    match digits(number) + exponent {
        -3..=15 => decimal(number, exponent),
        leading => {
            let mantissa = decimal(number, 1 - digits(number));
            format!("{mantissa}×10{}", superscript(leading - 1))
        }
    }
}

/// `number` times a power of ten, written out exactly.
fn decimal(number: i64, exponent: i32) -> String {
    let sign = if number < 0 { "−" } else { "" };
    let mut text = number.unsigned_abs().to_string();
    if exponent >= 0 && number != 0 {
        text.extend(std::iter::repeat_n('0', exponent as usize));
    } else if exponent < 0 {
        let decimals = exponent.unsigned_abs() as usize;
        text = format!("{text:0>width$}", width = decimals + 1);
        text.insert(text.len() - decimals, '.');
    }
    format!("{sign}{text}")
}

/// A digit times a power of ten, written out up to four digits.
fn power(factor: i64, exponent: i32) -> String {
    match (factor, exponent) {
        (_, -3..=3) => decimal(factor, exponent),
        (1, _) => format!("10{}", superscript(exponent)),
        _ => format!("{factor}×10{}", superscript(exponent)),
    }
}

fn superscript(number: i32) -> String {
    const DIGITS: [char; 10] = ['⁰', '¹', '²', '³', '⁴', '⁵', '⁶', '⁷', '⁸', '⁹'];
    number.to_string().chars().map(|c| c.to_digit(10).map_or('⁻', |d| DIGITS[d as usize])).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn linear(low: f64, high: f64) -> Span {
        Span { scale: Scale::Linear, low, high }
    }

    fn logarithmic(low: f64, high: f64) -> Span {
        Span { scale: Scale::Logarithmic, low: low.log10(), high: high.log10() }
    }

    fn texts(low: f64, high: f64, least: f64) -> (Vec<String>, String) {
        let axis = Axis::new(linear(low, high), 1000.0, |_, distance| distance >= least);
        let labels = axis.ticks.iter().map(|tick| tick.label.clone());
        (labels.collect(), axis.note)
    }

    #[test]
    fn times_of_a_day_are_those_of_a_clock() {
        let labels = |low: f64, high: f64, least: f64| {
            let span = Span { scale: Scale::TimeOfDay, low, high };
            let axis = Axis::new(span, 1000.0, |_, distance| distance >= least);
            (axis.ticks.iter().map(|tick| tick.label.clone()).collect::<Vec<_>>(), axis.minor)
        };
        let (whole, minor) = labels(0.0, 24.0, 120.0);
        assert_eq!(whole, ["00:00", "03:00", "06:00", "09:00", "12:00", "15:00", "18:00", "21:00", "24:00"]);
        assert_eq!(minor[..3], [1.0, 2.0, 4.0]);
        assert_eq!(labels(11.5, 11.5 + 5.0 / 60.0, 150.0).0, ["11:30", "11:31", "11:32", "11:33", "11:34", "11:35"]);
        assert_eq!(labels(11.5, 11.5 + 20.0 / 3600.0, 240.0).0, ["11:30:00", "11:30:05", "11:30:10", "11:30:15", "11:30:20"]);
    }

    #[test]
    fn labels_carry_no_binary_rounding() {
        let (labels, note) = texts(-0.05, 0.55, 150.0);
        assert_eq!(labels, ["0.0", "0.1", "0.2", "0.3", "0.4", "0.5"]);
        assert_eq!(note, "");
    }

    #[test]
    fn negative_numbers_have_a_true_minus() {
        let (labels, _) = texts(-2000.0, 2000.0, 200.0);
        assert_eq!(labels, ["−2000", "−1000", "0", "1000", "2000"]);
    }

    #[test]
    fn long_numbers_share_an_offset_or_a_factor() {
        let (labels, note) = texts(1.76e9, 1.76e9 + 600.0, 150.0);
        assert_eq!(labels, ["0", "100", "200", "300", "400", "500", "600"]);
        assert_eq!(note, "offset +1760000000");
        let (labels, note) = texts(-49000.0005, -49000.0, 190.0);
        assert_eq!(labels, ["−500", "−400", "−300", "−200", "−100", "0"]);
        assert_eq!(note, "×10⁻⁶  offset −49000");
        let (labels, note) = texts(0.0, 3e-7, 300.0);
        assert_eq!(labels, ["0", "100", "200", "300"]);
        assert_eq!(note, "×10⁻⁹");
        let (labels, note) = texts(0.0, 4e9, 450.0);
        assert_eq!(labels, ["0", "2", "4"]);
        assert_eq!(note, "×10⁹");
    }

    #[test]
    fn ordinary_ranges_need_no_note() {
        let (labels, note) = texts(17.1, 17.3, 200.0);
        assert_eq!(labels, ["17.10", "17.15", "17.20", "17.25", "17.30"]);
        assert_eq!(note, "");
        let (_, note) = texts(49000.0, 49010.0, 100.0);
        assert_eq!(note, "");
    }

    #[test]
    fn equal_values_get_a_range() {
        for value in [0.0, 17.2, -49000.0, 1e-290, 1e300, -3e-250] {
            let mut span = Span::empty(Scale::Linear);
            span.add(value);
            let padded = span.padded(0.07).expect("one value");
            assert!(padded.low < value && value < padded.high, "{value}");
            let axis = Axis::new(padded, 200.0, |_, distance| distance >= 40.0);
            assert!(axis.ticks.len() >= 2, "{value}: {:?}", axis.ticks);
        }
        assert_eq!(Span::empty(Scale::Linear).padded(0.1), None);
    }

    #[test]
    fn ranges_of_any_size_get_few_distinct_short_labels_in_order() {
        for exponent in -250..=290 {
            for (low, high) in [(0.0, 7.3), (-3.1, 4.9), (100.0, 100.13), (-77.0, -76.9991)] {
                let scale = 10f64.powi(exponent);
                let span = linear(low * scale, high * scale);
                let axis = Axis::new(span, 600.0, |_, distance| distance >= 40.0);
                let count = axis.ticks.len();
                assert!((2..=MOST_TICKS).contains(&count), "{span:?} {count}");
                for pair in axis.ticks.windows(2) {
                    assert!(pair[0].value < pair[1].value, "{span:?}");
                    assert_ne!(pair[0].label, pair[1].label, "{span:?}");
                }
                let longest = axis.ticks.iter().map(|tick| tick.label.chars().count());
                assert!(longest.max() <= Some(9), "{:?}", axis.ticks);
            }
        }
    }

    #[test]
    fn values_that_cannot_be_drawn_do_not_count() {
        let mut span = Span::empty(Scale::Linear);
        for value in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e305] {
            span.add(value);
        }
        assert!(span.is_empty());
        span.add(2.0);
        assert!(span.contains(2.0) && !span.contains(f64::NAN));
    }

    #[test]
    fn minor_ticks_lie_between_the_labelled_ones() {
        let span = linear(0.0, 4.0);
        let axis = Axis::new(span, 100.0, |_, distance| distance >= 50.0);
        assert_eq!(axis.minor, [0.5, 1.0, 1.5, 2.5, 3.0, 3.5]);
    }

    fn decades(low: f64, high: f64, length: f64) -> (Vec<String>, Axis) {
        let axis = Axis::new(logarithmic(low, high), length, |_, distance| distance >= 40.0);
        (axis.ticks.iter().map(|tick| tick.label.clone()).collect(), axis)
    }

    #[test]
    fn logarithmic_axes_have_a_tick_per_decade() {
        let (labels, axis) = decades(0.1, 20000.0, 1000.0);
        assert_eq!(labels, ["0.1", "1", "10", "100", "1000", "10⁴"]);
        assert_eq!(axis.minor.len(), 5 * 8 + 1);
        assert_eq!(axis.minor[..8], [0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9]);
        assert!((axis.at(10.0, 0.0, 5.301) - 2.0).abs() < 1e-3);
        let (labels, axis) = decades(0.9e-4, 1.1e-2, 100.0);
        assert_eq!(labels, ["10⁻⁴", "0.001", "0.01"]);
        assert_eq!(axis.minor, [0.0002, 0.0005, 0.002, 0.005]);
    }

    #[test]
    fn short_logarithmic_axes_have_ticks_between() {
        assert_eq!(decades(0.4, 15.0, 1000.0).0, ["0.5", "1", "2", "5", "10"]);
        assert_eq!(decades(1900.0, 50000.0, 1000.0).0, ["2000", "5000", "10⁴", "2×10⁴", "5×10⁴"]);
        let (labels, axis) = decades(11.0, 16.2, 1000.0);
        assert_eq!(labels, ["11.0", "11.5", "12.0", "12.5", "13.0", "13.5", "14.0", "14.5", "15.0", "15.5", "16.0"]);
        assert!(axis.at(11.0, 0.0, 9.0).abs() < 1e-9 && (axis.at(16.2, 0.0, 9.0) - 9.0).abs() < 1e-9);
    }

    #[test]
    fn logarithmic_ranges_of_any_size_get_few_distinct_short_labels_in_order() {
        for exponent in -270..=270 {
            for ratio in [1.0 + 1e-9, 1.001, 1.3, 2.7, 7.0, 33.0, 1e3, 1e7, 1e25] {
                let low = 1.7 * 10f64.powi(exponent);
                let (labels, axis) = decades(low, low * ratio, 600.0);
                let case = format!("{low} {ratio} {labels:?}");
                assert!((2..=MOST_TICKS).contains(&labels.len()), "{case}");
                assert!(labels.windows(2).all(|pair| pair[0] != pair[1]), "{case}");
                assert!(labels.iter().all(|label| label.chars().count() <= 9), "{case}");
                let places: Vec<f64> = axis.ticks.iter().map(|tick| axis.at(tick.value, 0.0, 600.0)).collect();
                assert!(places.windows(2).all(|pair| pair[0] < pair[1]), "{case}");
                assert!(places.iter().all(|place| (-1.0..=601.0).contains(place)), "{case} {places:?}");
            }
        }
        let (labels, axis) = decades(SMALLEST, LARGEST, 600.0);
        assert!((2..=MOST_TICKS).contains(&labels.len()), "{labels:?}");
        assert!(axis.minor.len() < 600);
    }

    #[test]
    fn values_that_are_not_positive_have_no_logarithm() {
        let mut span = Span::empty(Scale::Logarithmic);
        for value in [0.0, -0.0, -3.0, f64::NAN, f64::INFINITY, f64::NEG_INFINITY, f64::MIN_POSITIVE, 1e305] {
            span.add(value);
            assert!(!span.contains(value));
        }
        assert!(span.is_empty());
        span.add(1.0);
        let padded = span.padded(0.07).expect("one value");
        assert!(padded.contains(1.0) && padded.contains(1.1) && !padded.contains(2.0));
        assert!(!padded.contains(0.0) && !padded.contains(-1.0));
    }
}
