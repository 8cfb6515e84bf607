//! Dense samples reduced to what a picture can show: smallest and largest reading per column, in bounded memory.

use crate::data::run::{Header, Setting, Vector, VectorSink};
use crate::data::units::Reading;

/// Columns that are kept at most; when they are full, pairs are joined.
const COLUMNS: usize = 2048;

/// Smallest and largest reading of a stretch of time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Column {
    /// Middle of the stretch, s since the run's start.
    pub t_s: f64,
    /// Smallest reading per component, enT.
    pub min: Reading,
    /// Largest reading per component, enT.
    pub max: Reading,
}

#[derive(Clone, Copy, Debug)]
struct Extremes {
    min: [f64; 3],
    max: [f64; 3],
}

const NOTHING: Extremes = Extremes { min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

/// Takes vectors and keeps extremes per column.
#[derive(Clone, Debug, Default)]
pub struct Envelope {
    begin_s: Option<f64>,
    width_s: f64,
    columns_per_s: f64,
    columns: Vec<Extremes>,
}

impl VectorSink for Envelope {
    fn begin(&mut self, header: &Header, _settings: &[Setting]) {
        *self = Envelope { columns: Vec::with_capacity(COLUMNS), ..Envelope::default() };
        self.set_width(1.0 / header.sample_rate_hz);
    }

    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        let begin_s = *self.begin_s.get_or_insert(vector.t_s);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates at zero")]
        let mut index = ((vector.t_s - begin_s) * self.columns_per_s) as usize;
        if index >= self.columns.len() {
            index = self.grow(index);
        }
        let Reading(r) = vector.reading;
        if let Some(column) = self.columns.get_mut(index) {
            for ((low, high), r) in column.min.iter_mut().zip(&mut column.max).zip(r) {
                *low = if r < *low { r } else { *low };
                *high = if r > *high { r } else { *high };
            }
        }
    }
}

impl Envelope {
    fn set_width(&mut self, width_s: f64) {
        self.width_s = width_s;
        self.columns_per_s = 1.0 / width_s;
    }

    #[cold]
    fn grow(&mut self, mut index: usize) -> usize {
        while index >= COLUMNS {
            let joined = self.columns.chunks(2).map(|pair| {
                pair.iter().fold(NOTHING, |a, b| Extremes {
                    min: std::array::from_fn(|i| a.min[i].min(b.min[i])),
                    max: std::array::from_fn(|i| a.max[i].max(b.max[i])),
                })
            });
            self.columns = joined.collect();
            self.set_width(2.0 * self.width_s);
            index /= 2;
        }
        if index >= self.columns.len() {
            self.columns.resize(index + 1, NOTHING);
        }
        index
    }

    /// The columns that hold samples, in time order.
    #[must_use]
    pub fn columns(&self) -> Vec<Column> {
        let begin_s = self.begin_s.unwrap_or_default();
        self.columns
            .iter()
            .enumerate()
            .filter(|(_, c)| c.min[0] <= c.max[0])
            .map(|(i, c)| Column { t_s: begin_s + (i as f64 + 0.5) * self.width_s, min: Reading(c.min), max: Reading(c.max) })
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_envelope_of_many_samples_keeps_every_extreme() {
        let mut envelope = Envelope::default();
        envelope.set_width(1.0 / 128.0);
        for n in 0..1_000_000_u64 {
            let spike = if n == 777_777 { 50.0 } else { 0.0 };
            envelope.vector(Vector { n, t_s: n as f64 / 128.0, reading: Reading([1.0 + spike, -1.0, 0.0]) });
        }
        let columns = envelope.columns();
        assert!(columns.len() <= COLUMNS && columns.len() > COLUMNS / 2 - 1);
        let highest = columns.iter().max_by(|a, b| a.max.0[0].total_cmp(&b.max.0[0])).unwrap();
        assert_eq!(highest.max.0[0], 51.0);
        assert!((highest.t_s - 777_777.0 / 128.0).abs() < 2.0 * envelope.width_s);
        assert!(columns.iter().all(|c| c.min.0[1] == -1.0));
    }
}
