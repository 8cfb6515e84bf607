//! The samples of every sine, kept while the file of the run is read.

use crate::data::plateau::Settling;
use crate::data::run::{Header, Setting, Vector, VectorSink};
use std::ops::Range;

/// Samples that are kept at most: seventeen hours at 128 Hz in 256 MB.
pub(super) const MOST_SAMPLES: usize = 8_000_000;
/// Least number of samples of a setting, and of a segment of it.
pub(super) const LEAST_SAMPLES: usize = 16;
/// Part of a setting that is left out after a change of frequency where nothing else is said, and its bounds, s.
const SETTLING_PART: f64 = 1.0 / 32.0;
const SETTLING_S: [f64; 2] = [0.1, 1.0];

/// The samples of one sine.
#[derive(Clone, Debug, Default)]
pub(super) struct Record {
    pub n: Vec<u64>,
    pub t_s: Vec<f64>,
    pub y: [Vec<f64>; 3],
}

impl Record {
    /// Times of the first and the last sample of a stretch, s.
    pub fn ends_s(&self, used: &Range<usize>) -> Option<[f64; 2]> {
        let stretch = self.t_s.get(used.clone())?;
        Some([*stretch.first()?, *stretch.last()?])
    }

    /// The settled samples of a setting, without the one at its end, which may belong to the next by rounding of the times.
    pub fn settled(&self, setting: &Setting, settling: Settling, sample_s: f64) -> Range<usize> {
        let settling_s = match settling {
            Settling::Given(s) => s,
            Settling::Found => (SETTLING_PART * (setting.t_end_s - setting.t_start_s)).clamp(SETTLING_S[0], SETTLING_S[1]),
        };
        let end = self.t_s.partition_point(|t| *t < setting.t_end_s - sample_s);
        let begin = self.t_s.partition_point(|t| *t < setting.t_start_s + settling_s);
        begin.min(end)..end
    }
}

/// Keeps the samples of settings that are sines.
#[derive(Clone, Debug, Default)]
pub struct Sines {
    pub(super) settings: Vec<Setting>,
    pub(super) records: Vec<Record>,
    current: usize,
    pub(super) kept: usize,
    pub(super) overflown: bool,
}

impl VectorSink for Sines {
    fn needs_settings(&self) -> bool {
        true
    }

    fn begin(&mut self, _header: &Header, settings: &[Setting]) {
        *self = Self { settings: settings.to_vec(), records: vec![Record::default(); settings.len()], ..Self::default() };
    }

    fn vector(&mut self, vector: Vector) {
        while self.settings.get(self.current).is_some_and(|s| vector.t_s >= s.t_end_s) {
            self.current += 1;
        }
        let Some(setting) = self.settings.get(self.current) else { return };
        if setting.frequency_hz <= 0.0 || vector.t_s < setting.t_start_s {
            return;
        }
        if self.kept == MOST_SAMPLES {
            self.overflown = true;
            return;
        }
        self.kept += 1;
        let record = &mut self.records[self.current];
        record.n.push(vector.n);
        record.t_s.push(vector.t_s);
        record.y.iter_mut().zip(vector.reading.0).for_each(|(y, r)| y.push(r));
    }
}
