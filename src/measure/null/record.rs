//! What is kept of a long record while it is read: bins, periodograms, and the record at a low rate, in bounded memory.

use super::spikes::{Gate, Spikes, Stills};
use crate::data::run::{Header, Setting, Vector, VectorSink};
use crate::data::units::Reading;
use crate::fit::allan::{Bin, Differences};
use crate::fit::spectrum::{Halfband, Welch, sum};

/// Samples of a segment at full rate.
pub const BLOCK: usize = 4096;
/// Samples of the smallest bin, and of a sample of the slow record.
pub const CHUNK: usize = 64;
/// Halvings from the full rate to that of the slow record.
const HALVINGS: usize = 6;
/// Octaves of differences within a bin.
const OCTAVES: usize = 6;
/// Bins and samples of the slow record that are kept at most; when they are full, pairs are joined.
const MOST: usize = 1 << 17;
/// Records up to this length are kept whole, and their spectrum is made from that.
const HEAD: usize = 4 * BLOCK;
/// Gaps of this many samples or less are bridged by a straight line.
pub const MOST_FILLED: u64 = CHUNK as u64;

/// Takes the vectors of a long record: some 15 MB, however long it is.
#[derive(Default)]
pub struct Record {
    gate: Gate,
    inner: Option<Box<Inner>>,
}

struct Inner {
    welch: Welch,
    cascade: Vec<Halfband>,
    pieces: [[Vec<f64>; 3]; 2],
    work: Vec<f64>,
    begun: bool,
    first: u64,
    next: u64,
    reference: [f64; 3],
    block: [Vec<f64>; 3],
    /// Samples of the block that were dealt with.
    dealt: usize,
    bins: Vec<Bin>,
    bin_chunks: u64,
    within: [Differences; OCTAVES],
    slow: [Vec<f64>; 3],
    slow_samples: u64,
    head: [Vec<f64>; 3],
    filled: u64,
    last: [f64; 3],
    still_since_s: f64,
    last_s: f64,
    frozen_s: [f64; 2],
    stills: [Stills; 3],
}

/// What was kept.
pub(super) struct Kept {
    /// Samples that stand out of those beside them, which are not among what follows.
    pub spikes: Option<Spikes>,
    /// The longest stretch of equal readings of every component that noise does not make.
    pub stills: [Option<[f64; 2]>; 3],
    /// Subtracted from every sample, enT.
    pub reference: [f64; 3],
    /// Bins in time order.
    pub bins: Vec<Bin>,
    /// Samples of a full bin.
    pub bin_samples: u64,
    /// Differences within the smallest bins at 1, 2, 4 ... samples.
    pub within: Vec<Differences>,
    /// Periodograms at full rate.
    pub welch: Welch,
    /// The record at a low rate, NaN where samples are missing.
    pub slow: [Vec<f64>; 3],
    /// Samples for one of the slow record.
    pub slow_samples: u64,
    /// The whole record, if it is short.
    pub head: Option<[Vec<f64>; 3]>,
    /// Samples that a straight line stands for.
    pub filled: u64,
    /// The longest stretch of samples that are all alike.
    pub frozen_s: Option<[f64; 2]>,
}

impl VectorSink for Record {
    fn begin(&mut self, _header: &Header, _settings: &[Setting]) {
        self.inner = Some(Box::default());
    }

    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        if let Some(inner) = &mut self.inner {
            self.gate.vector(vector, &mut |vector| inner.vector(vector));
        }
    }
}

impl Record {
    /// Deals with what is left.
    pub(super) fn finish(self) -> Kept {
        let mut inner = *self.inner.unwrap_or_default();
        let spikes = self.gate.finish(&mut |vector| inner.vector(vector));
        inner.deal();
        inner.stands_still();
        let length = inner.head[0].len();
        let whole = inner.next - inner.first == length as u64;
        Kept {
            spikes,
            stills: inner.stills.map(Stills::longest),
            reference: inner.reference,
            bins: inner.bins,
            bin_samples: inner.bin_chunks * CHUNK as u64,
            within: inner.within.to_vec(),
            welch: inner.welch,
            slow: inner.slow,
            slow_samples: inner.slow_samples,
            head: whole.then_some(inner.head),
            filled: inner.filled,
            frozen_s: (inner.frozen_s[1] > inner.frozen_s[0]).then_some(inner.frozen_s),
        }
    }
}

impl Default for Inner {
    fn default() -> Self {
        Self {
            welch: Welch::new(BLOCK),
            cascade: vec![Halfband::default(); HALVINGS],
            pieces: Default::default(),
            work: Vec::with_capacity(CHUNK),
            begun: false,
            first: 0,
            next: 0,
            reference: [0.0; 3],
            block: std::array::from_fn(|_| Vec::with_capacity(BLOCK)),
            dealt: 0,
            bins: Vec::new(),
            bin_chunks: 1,
            within: [Differences::default(); OCTAVES],
            slow: Default::default(),
            slow_samples: 1 << HALVINGS,
            head: Default::default(),
            filled: 0,
            last: [f64::NAN; 3],
            still_since_s: 0.0,
            last_s: 0.0,
            frozen_s: [0.0; 2],
            stills: Default::default(),
        }
    }
}

impl Inner {
    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        let Reading(reading) = vector.reading;
        if vector.n != self.next || !self.begun {
            self.jump(vector.n, reading);
        }
        for (still, value) in self.stills.iter_mut().zip(reading) {
            still.add(vector.t_s, value);
        }
        if reading != self.last {
            if self.last_s > self.still_since_s {
                self.stands_still();
            }
            self.still_since_s = vector.t_s;
            self.last = reading;
        }
        self.last_s = vector.t_s;
        self.put([reading[0] - self.reference[0], reading[1] - self.reference[1], reading[2] - self.reference[2]]);
    }

    #[inline(always)]
    fn put(&mut self, sample: [f64; 3]) {
        for (block, value) in self.block.iter_mut().zip(sample) {
            block.push(value);
        }
        self.next += 1;
        if self.block[0].len() == BLOCK {
            self.full();
        }
    }

    /// Keeps the longest stretch of equal samples.
    fn stands_still(&mut self) {
        if self.last_s - self.still_since_s > self.frozen_s[1] - self.frozen_s[0] {
            self.frozen_s = [self.still_since_s, self.last_s];
        }
    }

    /// The first sample, or one after a gap.
    #[cold]
    fn jump(&mut self, n: u64, reading: [f64; 3]) {
        if !self.begun {
            self.begun = true;
            (self.first, self.next, self.reference) = (n, n, reading);
            return;
        }
        let lost = n.saturating_sub(self.next);
        let last = self.block.each_ref().map(|b| b.last().copied());
        if let (1..=MOST_FILLED, [Some(x), Some(y), Some(z)]) = (lost, last) {
            let from = [x, y, z];
            for i in 1..=lost {
                let part = i as f64 / (lost + 1) as f64;
                self.put(std::array::from_fn(|c| from[c] + part * (reading[c] - self.reference[c] - from[c])));
            }
            self.filled += lost;
            return;
        }
        self.deal();
        self.block.iter_mut().for_each(Vec::clear);
        self.dealt = 0;
        self.cascade.iter_mut().for_each(Halfband::clear);
        self.next = self.next.max(n);
        let begin = self.next - self.first;
        while begin / self.slow_samples >= MOST as u64 {
            self.halve_slow();
        }
        #[expect(clippy::cast_possible_truncation, reason = "less than MOST")]
        let index = (begin / self.slow_samples) as usize;
        if index > self.slow[0].len() {
            self.slow.iter_mut().for_each(|s| s.resize(index, f64::NAN));
        }
    }

    #[cold]
    fn full(&mut self) {
        self.deal();
        self.welch.add(self.block.each_ref().map(Vec::as_slice));
        for block in &mut self.block {
            block.drain(..BLOCK / 2);
        }
        self.dealt = BLOCK / 2;
    }

    /// Brings the new samples of the block to bins, slow record and head.
    fn deal(&mut self) {
        let end = self.block[0].len();
        let mut at = self.dealt;
        let mut n = self.next - self.first - (end - at) as u64;
        let begin = n;
        while at < end {
            let in_chunk = n % CHUNK as u64;
            #[expect(clippy::cast_possible_truncation, reason = "less than a chunk")]
            let length = (CHUNK - in_chunk as usize).min(end - at);
            let is_whole = length == CHUNK;
            let index = self.bin(n);
            for c in 0..3 {
                let part = &self.block[c][at..at + length];
                self.bins[index].sum[c] += sum(part);
                if is_whole {
                    Differences::add(&mut self.within, c, part, &mut self.work);
                }
            }
            self.bins[index].count += length as u32;
            if is_whole {
                for (level, differences) in self.within.iter_mut().enumerate() {
                    differences.count += (CHUNK >> (level + 1)) as u64;
                }
            }
            at += length;
            n += length as u64;
        }
        if begin <= HEAD as u64 {
            let from = begin as usize;
            for (head, block) in self.head.iter_mut().zip(&self.block) {
                head.resize(from, f64::NAN);
                let room = HEAD.saturating_sub(from).min(end - self.dealt);
                head.extend_from_slice(&block[self.dealt..self.dealt + room]);
            }
        }
        self.slow_down();
        self.dealt = end;
    }

    /// Index of the bin of a sample; makes room for it.
    fn bin(&mut self, n: u64) -> usize {
        while n / CHUNK as u64 / self.bin_chunks >= MOST as u64 {
            self.bins = self
                .bins
                .chunks(2)
                .map(|pair| Bin {
                    sum: std::array::from_fn(|c| pair.iter().map(|b| b.sum[c]).sum()),
                    count: pair.iter().map(|b| b.count).sum(),
                })
                .collect();
            self.bin_chunks *= 2;
        }
        #[expect(clippy::cast_possible_truncation, reason = "less than MOST")]
        let index = (n / CHUNK as u64 / self.bin_chunks) as usize;
        if index >= self.bins.len() {
            self.bins.resize(index + 1, Bin::default());
        }
        index
    }

    /// Filters the new samples down to the rate of the slow record.
    fn slow_down(&mut self) {
        let [a, b] = &mut self.pieces;
        let (mut input, mut output) = (a, b);
        for (piece, block) in input.iter_mut().zip(&self.block) {
            piece.clear();
            piece.extend_from_slice(&block[self.dealt..]);
        }
        for filter in &mut self.cascade {
            output.iter_mut().for_each(Vec::clear);
            filter.push(input.each_ref().map(Vec::as_slice), output);
            (input, output) = (output, input);
        }
        for (slow, piece) in self.slow.iter_mut().zip(input) {
            slow.extend_from_slice(piece);
        }
        while self.slow[0].len() >= MOST {
            self.halve_slow();
        }
    }

    fn halve_slow(&mut self) {
        let mut half: [Vec<f64>; 3] = Default::default();
        Halfband::default().push(self.slow.each_ref().map(Vec::as_slice), &mut half);
        self.slow = half;
        self.slow_samples *= 2;
        self.cascade.push(Halfband::default());
    }
}
