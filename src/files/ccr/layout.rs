//! Rows laid out as the one above them: the places of digits, points, signs and commas repeat, so a few comparisons of words prove that
//! a row has them, and its numbers are taken eight digits at a time.

use super::vectors::{POWERS, Row, WINDOW};

/// Bytes of the longest row that has a layout, with its line end.
const LONGEST: usize = 64;
/// Bytes of a word.
const WORD: usize = 8;

/// Where the digits of up to eight characters stand.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Piece {
    start: usize,
    /// Digits before the point.
    whole: u64,
    /// Digits after the point, or all of them if there is none.
    others: u64,
    /// Brings the last character to the end of the word.
    shift: u32,
}

/// Where a number stands, without its sign.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Place {
    tail: Piece,
    /// What stands before the last eight characters.
    front: Option<(Piece, u64)>,
    sign: u64,
    power: f64,
}

/// The layout of a row.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Layout {
    lowest: [u8; LONGEST],
    span: [u8; LONGEST],
    places: [Place; 5],
    t_decimals: u32,
    length: usize,
}

impl Layout {
    /// The layout of a plain row with its line end; `None` if it is longer than layouts can be.
    pub fn of(row: &[u8]) -> Option<Layout> {
        if row.len() > LONGEST {
            return None;
        }
        let mut layout = Layout {
            lowest: [0; LONGEST],
            span: [u8::MAX; LONGEST],
            places: Default::default(),
            t_decimals: 0,
            length: row.len(),
        };
        for ((byte, lowest), span) in row.iter().zip(&mut layout.lowest).zip(&mut layout.span) {
            (*lowest, *span) = if byte.is_ascii_digit() { (b'0', 9) } else { (*byte, 0) };
        }
        let mut start = 0;
        for (i, (cell, place)) in row.trim_ascii_end().split(|b| *b == b',').zip(&mut layout.places).enumerate() {
            let decimals = cell.iter().position(|b| *b == b'.').map_or(0, |point| cell.len() - point - 1);
            *place = Place::of(cell, start, decimals)?;
            start += cell.len() + 1;
            if i == 1 {
                layout.t_decimals = decimals as u32;
            }
        }
        Some(layout)
    }

    /// Bytes of the row.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Whether the row at the begin of the window has this layout, its line end included.
    #[inline(always)]
    pub fn fits(&self, window: &[u8; WINDOW]) -> bool {
        let mut outside = [0; 16];
        let parts = window.as_chunks().0.iter().zip(self.lowest.as_chunks().0).zip(self.span.as_chunks().0);
        for ((bytes, lowest), span) in parts {
            let (bytes, lowest, span): (&[u8; 16], &[u8; 16], &[u8; 16]) = (bytes, lowest, span);
            for i in 0..16 {
                outside[i] |= bytes[i].wrapping_sub(lowest[i]).saturating_sub(span[i]);
            }
        }
        u128::from_ne_bytes(outside) == 0
    }

    /// The row at the begin of the window, which must fit.
    #[inline(always)]
    pub fn row(&self, window: &[u8; WINDOW]) -> Row {
        let [n, t, x, y, z] = &self.places;
        Row {
            n: n.digits(window),
            t_s: t.number(window),
            t_decimals: self.t_decimals,
            reading: [x.number(window), y.number(window), z.number(window)],
        }
    }
}

impl Place {
    fn of(cell: &[u8], start: usize, decimals: usize) -> Option<Place> {
        let (start, text, sign) = match cell.strip_prefix(b"-") {
            Some(text) => (start + 1, text, 1 << 63),
            None => (start, cell, 0),
        };
        let (front, tail) = text.split_at(text.len().saturating_sub(WORD));
        if front.len() > WORD {
            return None;
        }
        let tail_digits = tail.iter().filter(|b| b.is_ascii_digit()).count();
        let tail = Piece::of(tail, start + front.len());
        let front = (!front.is_empty()).then(|| (Piece::of(front, start), 10_u64.pow(tail_digits as u32)));
        Some(Place { tail, front, sign, power: *POWERS.get(decimals)? })
    }

    #[inline(always)]
    fn digits(&self, window: &[u8; WINDOW]) -> u64 {
        let tail = self.tail.digits(window);
        self.front.map_or(tail, |(front, power)| front.digits(window).wrapping_mul(power).wrapping_add(tail))
    }

    /// At most fifteen digits divided by a power of ten below 10^22, hence correctly rounded.
    #[inline(always)]
    fn number(&self, window: &[u8; WINDOW]) -> f64 {
        #[expect(clippy::cast_precision_loss, reason = "at most fifteen digits")]
        let magnitude = self.digits(window).cast_signed() as f64 / self.power;
        f64::from_bits(magnitude.to_bits() | self.sign)
    }
}

impl Piece {
    fn of(text: &[u8], start: usize) -> Piece {
        let point = text.iter().position(|b| *b == b'.');
        let (mut whole, mut others) = (0, 0);
        for i in (0..text.len()).filter(|i| Some(*i) != point) {
            let mask = 0x0f << (8 * i);
            if point.is_some_and(|point| i < point) {
                whole |= mask;
            } else {
                others |= mask;
            }
        }
        Piece { start, whole, others, shift: 8 * (WORD - text.len()) as u32 }
    }

    #[inline(always)]
    fn digits(&self, window: &[u8; WINDOW]) -> u64 {
        // A layout begins all pieces within its longest row, which makes the bounds known here.
        let start = self.start % LONGEST;
        let word = window.get(start..).and_then(<[u8]>::first_chunk).map_or(0, |bytes| u64::from_le_bytes(*bytes));
        eight_digits((((word & self.whole) << 8) | (word & self.others)) << (self.shift % u64::BITS))
    }
}

/// The number of eight digits, one per byte, the first one in the lowest byte: pairs, then fours and eights.
#[inline(always)]
fn eight_digits(digits: u64) -> u64 {
    const EVERY_FOURTH: u64 = 0x0000_00ff_0000_00ff;
    let pairs = digits.wrapping_mul(10).wrapping_add(digits >> 8);
    let first_and_third = (pairs & EVERY_FOURTH).wrapping_mul((1_000_000 << 32) + 100);
    let second_and_fourth = ((pairs >> 16) & EVERY_FOURTH).wrapping_mul((10_000 << 32) + 1);
    first_and_third.wrapping_add(second_and_fourth) >> 32
}

#[cfg(test)]
mod tests {
    use super::super::vectors::plain_row;
    use super::*;
    use proptest::prelude::*;

    fn window(text: &str) -> [u8; WINDOW] {
        let mut window = [b'7'; WINDOW];
        window[..text.len()].copy_from_slice(text.as_bytes());
        window
    }

    fn cell() -> impl Strategy<Value = String> {
        "-?([0-9]{1,15}|[0-9]{1,5}\\.[0-9]{1,10}|[0-9]{1,12}\\.[0-9]{1,3})"
    }

    proptest! {
        #[test]
        fn a_layout_gives_what_the_plain_path_gives(
            n in "[0-9]{1,15}", cells in prop::collection::vec(cell(), 4), end in "\r?\n", digits in prop::collection::vec(0..10_u8, LONGEST),
        ) {
            let first = format!("{n},{}{end}", cells.join(","));
            if let Some(layout) = Layout::of(first.as_bytes()) {
                // Other digits in the same places.
                let other: String =
                    first.chars().zip(&digits).map(|(c, d)| if c.is_ascii_digit() { char::from(b'0' + d) } else { c }).collect();
                for text in [first, other] {
                    let window = window(&text);
                    prop_assert!(layout.fits(&window));
                    prop_assert_eq!(Some((layout.row(&window), layout.length())), plain_row(&window));
                }
            }
        }
    }

    #[test]
    fn any_other_byte_does_not_fit() {
        let text = "286718,2239.9883,1.11,-2.87,9.01\n";
        let layout = Layout::of(text.as_bytes()).unwrap();
        for at in 0..text.len() {
            for byte in 0..=u8::MAX {
                let mut window = window(text);
                let same_kind = window[at] == byte || window[at].is_ascii_digit() && byte.is_ascii_digit();
                window[at] = byte;
                assert_eq!(layout.fits(&window), same_kind, "{byte} at {at}");
            }
        }
        assert_eq!(Layout::of(&[b'1'; LONGEST + 1]), None);
    }
}
