//! A small part of the readings of a run, by which runs that share readings are found without keeping them.
//!
//! Every stretch of [`STRETCH`] readings has a mark, a number mixed of its bits; a sketch keeps the smallest marks. Which these are depends on the readings
//! alone, not on where in the file they stand: the copy of a run that begins later or ends earlier has those of the stretches that it holds as well. Of two
//! sketches the smallest marks of both together are a sample of all stretches of both runs, and the part of these that stands in both sketches is that of the
//! stretches that both runs hold.

use crate::data::run::{Vector, VectorSink};

/// Readings of a stretch. A single reading may occur in any other run by chance, or where the sensor rests; as many in a row do not.
pub const STRETCH: u32 = 16;
/// Marks that are kept: a share is known to a few hundredths.
const KEPT: usize = 256;
/// Shared marks below which nothing is said: few may be the same by chance.
pub const LEAST: usize = 8;
/// An odd number without a pattern in its bits.
const MIXER: u64 = 0x9e37_79b9_7f4a_7c15;

/// The smallest marks of the readings of a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Sketch {
    /// Ascending, each once.
    marks: Vec<u64>,
    /// Readings that were taken.
    count: u64,
    /// The mark of the last stretch.
    recent: u64,
}

impl Sketch {
    /// Of readings that are means, few and with many digits: each is a stretch of its own.
    pub fn of_means<'a>(means: impl IntoIterator<Item = &'a [f64]>) -> Self {
        let mut sketch = Self::default();
        for mean in means {
            sketch.count += 1;
            let mark = mean.iter().fold(1, |mark, value| mixed(mark ^ value.to_bits()));
            sketch.keep(mark);
        }
        sketch
    }

    /// Takes the next reading.
    #[inline(always)]
    pub fn take(&mut self, [x, y, z]: [f64; 3]) {
        self.count += 1;
        let own = mixed(x.to_bits() ^ y.to_bits().rotate_left(21) ^ z.to_bits().rotate_left(42));
        // Four bits for every reading, so that what is older than a stretch is shifted out.
        self.recent = (self.recent << (u64::BITS / STRETCH)).wrapping_add(own);
        // Hardly one of many thousand marks is among the smallest.
        if self.marks.len() < KEPT || self.marks.last().is_some_and(|largest| self.recent < *largest) {
            self.keep(self.recent);
        }
    }

    #[cold]
    fn keep(&mut self, mark: u64) {
        if let Err(place) = self.marks.binary_search(&mark) {
            self.marks.insert(place, mark);
            self.marks.truncate(KEPT);
        }
    }

    /// Readings that were taken.
    #[must_use]
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The marks that are kept, ascending.
    #[must_use]
    pub fn marks(&self) -> &[u64] {
        &self.marks
    }

    /// Which part of the one that holds less stands in the other one as well; zero where they share too little to tell.
    #[must_use]
    pub fn shared_with(&self, other: &Self) -> f64 {
        let (shared, shorter) = self.compared(other);
        if shared < LEAST { 0.0 } else { shared as f64 / shorter as f64 }
    }

    /// Whether most of the one that holds less stands in the other one as well, however little that is: nothing goes with everything.
    #[must_use]
    pub fn goes_with(&self, other: &Self) -> bool {
        let (shared, shorter) = self.compared(other);
        2 * shared >= shorter
    }

    /// Of a sample of the marks of both, how many stand in both, and how many in the one that has fewer of them.
    fn compared(&self, other: &Self) -> (usize, usize) {
        let (mut i, mut j) = (0, 0);
        let (mut all, mut shared) = (0_usize, 0_usize);
        // A sketch that is full tells nothing of marks beyond its largest; one that is not holds all of its run.
        while all < KEPT {
            match (self.marks.get(i), other.marks.get(j)) {
                (None, None) => break,
                (Some(a), Some(b)) if a == b => {
                    shared += 1;
                    i += 1;
                    j += 1;
                }
                (Some(a), Some(b)) if a > b => j += 1,
                (None, Some(_)) => j += 1,
                (Some(_), _) => i += 1,
            }
            all += 1;
        }
        (shared, i.min(j))
    }
}

/// A number mixed so that each of its bits has an influence on all bits.
#[inline(always)]
fn mixed(bits: u64) -> u64 {
    let product = u128::from(bits ^ MIXER) * u128::from(MIXER);
    (product >> 64) as u64 ^ product as u64
}

impl VectorSink for Sketch {
    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        self.take(vector.reading.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fit::random::Random;

    /// Noise in the digits of a file beside a field.
    fn readings(seed: u64, count: usize) -> Vec<[f64; 3]> {
        let mut random = Random::seeded(seed);
        (0..count).map(|_| [100.0, -20.0, 5.0].map(|field| ((field + 0.1 * random.gaussian()) * 100.0).round() / 100.0)).collect()
    }

    fn sketch(readings: &[[f64; 3]]) -> Sketch {
        let mut sketch = Sketch::default();
        readings.iter().for_each(|reading| sketch.take(*reading));
        sketch
    }

    #[test]
    fn what_a_copy_lacks_at_its_ends_does_not_hide_it() {
        let all = readings(1, 20_000);
        let whole = sketch(&all);
        assert_eq!(whole.shared_with(&whole), 1.0);
        for (from, until) in [(0, 19_940), (500, 20_000), (7000, 15_000)] {
            let part = sketch(&all[from..until]);
            for share in [whole.shared_with(&part), part.shared_with(&whole)] {
                assert!(share > 0.75, "{from} to {until}: {share}");
            }
        }
        // Of 20 000 readings, 4000 stand in both.
        let third = [&all[..4000], &readings(2, 16_000)].concat();
        let share = whole.shared_with(&sketch(&third));
        assert!((0.05..0.4).contains(&share), "{share}");
    }

    #[test]
    fn runs_of_one_field_share_nothing_though_their_readings_are_the_same_now_and_then() {
        // Sixty values of every component: the same reading comes again within a few hundred thousand.
        let [a, b] = [3, 4].map(|seed| sketch(&readings(seed, 300_000)));
        assert_eq!(a.shared_with(&b), 0.0);
        // A sensor that rests gives one reading, which says nothing.
        let at_rest = sketch(&[[1.0, 2.0, 3.0]; 5000]);
        assert!(at_rest.marks().len() < 2 * STRETCH as usize);
        assert_eq!(sketch(&[]).shared_with(&at_rest), 0.0);
        assert!(at_rest.goes_with(&at_rest) && at_rest.goes_with(&sketch(&[])));
        assert!(!at_rest.goes_with(&sketch(&[[1.0, 2.0, 3.5]; 5000])));
    }

    #[test]
    fn means_are_compared_one_by_one() {
        let all = readings(5, 40);
        let of = |part: &[[f64; 3]]| Sketch::of_means(part.iter().map(|mean| mean.as_slice()));
        assert_eq!(of(&all).shared_with(&of(&all[10..])), 1.0);
        let other = readings(6, 40);
        assert_eq!(of(&all).shared_with(&of(&other)), 0.0);
    }
}
