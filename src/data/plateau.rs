//! Vectors to plateau statistics, streaming: every setting is divided into equal bins, each with count, mean, scatter and
//! extremes, so that settling, edges and spikes can be judged afterwards without keeping samples.

mod cut;
mod displacement;
mod edges;
mod inside;

pub use cut::{Cut, LEAST_COVERAGE, Settling};
pub use displacement::{Course, Displacement, displacement};

use crate::data::run::{GivenBlock, Header, Run, Setting, Vector, VectorSink};
use crate::data::units::{COMPONENTS, Reading};
use crate::fit::statistics::median;
use inside::{contrasts, drop_saturated, is_between, spiky_bins};
use serde::Serialize;
use std::cell::OnceCell;
use std::fmt;
use std::ops::Range;

/// Bins of one setting.
const BINS: usize = 64;

/// Sums of one bin, relative to the first reading of the setting, which keeps the squares small; extremes as they were read.
#[derive(Clone, Copy, Debug)]
struct Bin {
    count: u64,
    sum: [f64; 3],
    squares: [f64; 3],
    min: [f64; 3],
    max: [f64; 3],
}

impl Bin {
    const EMPTY: Bin = Bin { count: 0, sum: [0.0; 3], squares: [0.0; 3], min: [f64::INFINITY; 3], max: [f64::NEG_INFINITY; 3] };

    fn merge(&mut self, other: &Bin) {
        self.count += other.count;
        for i in 0..3 {
            self.sum[i] += other.sum[i];
            self.squares[i] += other.squares[i];
            self.min[i] = self.min[i].min(other.min[i]);
            self.max[i] = self.max[i].max(other.max[i]);
        }
    }

    #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
    fn mean(&self, axis: usize) -> f64 {
        self.sum[axis] / self.count as f64
    }
}

/// Why a plateau is not used.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case", tag = "reason")]
pub enum Drop {
    /// No sample falls into the settled part of the setting.
    NoSamples,
    /// Samples are missing.
    Coverage {
        /// Part of the expected samples that is there.
        fraction: f64,
    },
    /// A component rests at the end of its range.
    Saturated {
        /// Component.
        component: usize,
    },
    /// The applied field is beyond the limit of the analysis.
    FieldLimit {
        /// Component, nominal sensor axes.
        component: usize,
        /// Limit, nT.
        limit_nt: f64,
    },
    /// The setting is a sine.
    Sine,
    /// It, or so much of it that the rest is too little, is left out by hand.
    Excluded {
        /// Why.
        because: String,
    },
}

impl fmt::Display for Drop {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let name = |component: &usize| COMPONENTS.get(*component).copied().unwrap_or("?");
        match self {
            Drop::NoSamples => write!(f, "no settled samples"),
            Drop::Coverage { fraction } => write!(f, "only {:.1} % of the samples are there", 100.0 * fraction),
            Drop::Saturated { component } => write!(f, "{} rests at the end of its range", name(component)),
            Drop::FieldLimit { component, limit_nt } => write!(f, "field beyond ±{limit_nt} nT on {}", name(component)),
            Drop::Sine => write!(f, "the field is a sine, not constant"),
            Drop::Excluded { because } => write!(f, "left out by hand: {because}"),
        }
    }
}

/// Smallest and largest used reading of a plateau.
#[derive(Clone, Copy, Debug)]
struct Extremes {
    min: [f64; 3],
    max: [f64; 3],
}

/// Statistics of one setting.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plateau {
    /// Index of the setting in the run, from 0.
    pub index: usize,
    /// The setting.
    pub setting: Setting,
    /// Begin and end of the used part, s since the run's start.
    pub used_s: [f64; 2],
    /// Mean reading of the used samples, enT.
    pub mean: Reading,
    /// Standard deviation of the used samples, enT; `None` if the file does not tell.
    pub std_ent: Option<[f64; 3]>,
    /// Used samples; `None` if the file does not tell.
    pub count: Option<u64>,
    /// Samples left out because of a spike beside them.
    pub spike_samples: u64,
    /// Why the plateau is not used.
    pub dropped: Option<Drop>,
    /// How neighbouring parts of the used samples differ, shortest parts first; empty if the file brings means only.
    #[serde(skip)]
    pub contrasts: Vec<Contrasts>,
}

/// Differences of the means of neighbouring parts of one plateau, all parts of the same length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrasts {
    /// Length of a part, s.
    pub part_s: f64,
    /// Number of pairs of parts.
    pub count: u64,
    /// Mean over the pairs of the sum of the inverse counts of samples: the mean square for samples of unit variance.
    pub inverse_samples: f64,
    /// Mean square of the differences, enT².
    pub mean_square: [f64; 3],
    /// Mean of the differences, later part minus earlier one, enT: what a steady change of the reading makes of all of them.
    pub mean: [f64; 3],
}

impl Plateau {
    /// Middle of the used part, s since the run's start.
    #[must_use]
    pub fn t_s(&self) -> f64 {
        0.5 * (self.used_s[0] + self.used_s[1])
    }
}

/// The plateaus of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Plateaus {
    /// One entry per setting, in time order.
    pub list: Vec<Plateau>,
    /// Time left out at the begin of every setting, s.
    pub settling_s: f64,
    /// Time after which the data no longer show the step before, found from them, s.
    pub settling_found_s: f64,
    /// The data show the step before for as long as can be seen.
    pub still_settling: bool,
    /// Part of the step before a setting that its readings lose between the two halves of what is used of it, with its standard uncertainty, where
    /// that is no noise.
    pub still_follows: Option<[f64; 2]>,
    /// Time left out at the end of every setting, s.
    pub early_end_s: f64,
    /// Displacement of the data's steps against the table of settings, s; positive when the data are late.
    pub edge_shift_s: f64,
    /// Longest shift that still leaves most of a plateau, s.
    pub tolerable_shift_s: f64,
    /// Samples outside of all settings.
    pub outside: u64,
    /// Plateaus per component in which all samples are equal.
    pub without_scatter: [usize; 3],
    /// A reading in the middle of every pause between two settings, (s since the run's start, enT): what is applied there.
    #[serde(skip)]
    pub pauses: Vec<(f64, [f64; 3])>,
}

impl Plateaus {
    /// Ids of the positions of the settings, in ascending order.
    #[must_use]
    pub fn positions(&self) -> Vec<u32> {
        let mut ids: Vec<u32> = self.list.iter().map(|p| p.setting.position).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Whether the run has no sample at all, so that nothing could settle.
    #[must_use]
    pub fn lack_samples(&self, run: &Run) -> bool {
        run.blocks.is_empty() && run.vectors.count == 0 && self.list.iter().all(|p| p.count == Some(0))
    }
}

/// Takes vectors and keeps sums per bin.
#[derive(Clone, Debug, Default)]
pub struct Accumulator {
    settings: Vec<Setting>,
    sample_rate_hz: f64,
    bins: Vec<[Bin; BINS]>,
    references: Vec<Option<[f64; 3]>>,
    current: usize,
    begin_s: f64,
    end_s: f64,
    bins_per_s: f64,
    outside: u64,
    pause_s: f64,
    pauses: Vec<(f64, [f64; 3])>,
    open: Open,
}

/// The bin that samples go into, kept apart: four lanes in place of three components let the compiler work on pairs.
#[derive(Clone, Copy, Debug)]
struct Open {
    /// Index within the setting; none if no bin is open.
    index: usize,
    count: u64,
    reference: [f64; 4],
    sum: [f64; 4],
    squares: [f64; 4],
    min: [f64; 4],
    max: [f64; 4],
}

impl Open {
    fn new(index: usize, bin: &Bin, reference: [f64; 3]) -> Self {
        let lanes = |[x, y, z]: [f64; 3]| [x, y, z, 0.0];
        Open {
            index,
            count: bin.count,
            reference: lanes(reference),
            sum: lanes(bin.sum),
            squares: lanes(bin.squares),
            min: lanes(bin.min),
            max: lanes(bin.max),
        }
    }

    #[inline(always)]
    fn add(&mut self, [x, y, z]: [f64; 3]) {
        self.count += 1;
        for (i, r) in [x, y, z, 0.0].into_iter().enumerate() {
            let d = r - self.reference[i];
            self.sum[i] += d;
            self.squares[i] += d * d;
            self.min[i] = if r < self.min[i] { r } else { self.min[i] };
            self.max[i] = if r > self.max[i] { r } else { self.max[i] };
        }
    }

    fn bin(&self) -> Bin {
        let components = |[x, y, z, _]: [f64; 4]| [x, y, z];
        Bin {
            count: self.count,
            sum: components(self.sum),
            squares: components(self.squares),
            min: components(self.min),
            max: components(self.max),
        }
    }
}

impl Default for Open {
    fn default() -> Self {
        Open::new(usize::MAX, &Bin::EMPTY, [0.0; 3])
    }
}

impl VectorSink for Accumulator {
    fn needs_settings(&self) -> bool {
        true
    }

    fn begin(&mut self, header: &Header, settings: &[Setting]) {
        self.settings = settings.to_vec();
        self.sample_rate_hz = header.sample_rate_hz;
        self.bins = vec![[Bin::EMPTY; BINS]; settings.len()];
        self.references = vec![None; settings.len()];
        self.current = 0;
        self.open = Open::default();
        self.enter();
    }

    #[inline(always)]
    fn vector(&mut self, vector: Vector) {
        if vector.t_s >= self.end_s {
            self.advance(vector.t_s);
        }
        if vector.t_s < self.begin_s {
            self.outside += 1;
            if vector.t_s >= self.pause_s {
                self.pauses.push((vector.t_s, vector.reading.0));
                self.pause_s = f64::INFINITY;
            }
            return;
        }
        let Reading(r) = vector.reading;
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "the time is within the setting")]
        let index = (((vector.t_s - self.begin_s) * self.bins_per_s) as u32 as usize).min(BINS - 1);
        if index != self.open.index {
            self.turn_to(index, r);
        }
        self.open.add(r);
    }
}

impl Accumulator {
    fn enter(&mut self) {
        self.pause_s = f64::INFINITY;
        match self.settings.get(self.current) {
            Some(s) => {
                if let Some(before) = self.current.checked_sub(1).and_then(|i| self.settings.get(i)) {
                    self.pause_s = 0.5 * (before.t_end_s + s.t_start_s);
                }
                self.begin_s = s.t_start_s;
                self.end_s = s.t_end_s;
                self.bins_per_s = BINS as f64 / (s.t_end_s - s.t_start_s);
            }
            None => {
                self.begin_s = f64::INFINITY;
                self.end_s = f64::INFINITY;
            }
        }
    }

    /// Opens another bin of the current setting, for a sample with reading `r`.
    #[cold]
    fn turn_to(&mut self, index: usize, r: [f64; 3]) {
        self.close();
        let bin = self.bins.get(self.current).and_then(|bins| bins.get(index));
        if let (Some(bin), Some(reference)) = (bin, self.references.get_mut(self.current)) {
            self.open = Open::new(index, bin, *reference.get_or_insert(r));
        }
    }

    /// Puts the open bin back into its place.
    fn close(&mut self) {
        if let Some(bin) = self.bins.get_mut(self.current).and_then(|bins| bins.get_mut(self.open.index)) {
            *bin = self.open.bin();
        }
        self.open = Open::default();
    }

    #[cold]
    fn advance(&mut self, t_s: f64) {
        self.close();
        while t_s >= self.end_s {
            self.current += 1;
            self.enter();
        }
    }

    /// The plateaus of what was read. A plateau with less than the least coverage of its expected samples is dropped.
    #[must_use]
    pub fn finish(mut self, Cut { settling, least_coverage }: Cut) -> Plateaus {
        self.close();
        // Only data without scatter need it, and sorting the readings of a run for every plateau would take longer than reading it.
        let found = OnceCell::new();
        let resolution = || *found.get_or_init(|| self.resolution());
        let levels = self.levels(edges::REFERENCE, &resolution);
        let edges = self.find_edges(&levels, &resolution);
        let settling_s = match settling {
            Settling::Given(given_s) => given_s,
            Settling::Found => edges.settling_s,
        };
        let mut list = Vec::with_capacity(self.settings.len());
        let mut extremes = Vec::with_capacity(self.settings.len());
        let mut all_used = Vec::with_capacity(self.settings.len());
        for (index, setting) in self.settings.iter().enumerate() {
            let bin_s = (setting.t_end_s - setting.t_start_s) / BINS as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates at 0 and at BINS")]
            let bins_of = |time_s: f64| ((time_s / bin_s - 1e-9).ceil() as usize).min(BINS);
            let used = bins_of(settling_s)..BINS - bins_of(edges.early_end_s);
            all_used.push(used.clone());
            let (plateau, range) = self.plateau(index, used, least_coverage, &resolution, &levels);
            list.push(plateau);
            extremes.push(range);
        }
        let without_scatter = drop_saturated(&mut list, &extremes);
        let is_seen = |[part, std]: &[f64; 2]| part.abs() > edges::NEGLIGIBLE && part.abs() > edges::SIGNIFICANT * std;
        Plateaus {
            list,
            still_follows: self.following(&all_used).filter(is_seen),
            settling_s,
            settling_found_s: edges.settling_s,
            still_settling: edges.still_settling && settling == Settling::Found,
            early_end_s: edges.early_end_s,
            edge_shift_s: edges.shift_s,
            tolerable_shift_s: 0.25 * self.median_duration_s(),
            outside: self.outside,
            without_scatter,
            pauses: std::mem::take(&mut self.pauses),
        }
    }

    fn median_duration_s(&self) -> f64 {
        median(&mut self.settings.iter().map(|s| s.t_end_s - s.t_start_s).collect::<Vec<f64>>())
    }

    fn plateau(
        &self,
        index: usize,
        used: Range<usize>,
        least_coverage: f64,
        resolution: &impl Fn() -> [f64; 3],
        levels: &[Option<[f64; 3]>],
    ) -> (Plateau, Extremes) {
        let setting = &self.settings[index];
        let Range { start: first, end } = used;
        let duration_s = setting.t_end_s - setting.t_start_s;
        let edge_s = |bin: usize| setting.t_start_s + duration_s * bin as f64 / BINS as f64;
        let used_s = [edge_s(first.min(end)), edge_s(end)];
        let bins = self.bins.get(index).and_then(|b| b.get(first.min(end)..end)).unwrap_or_default();
        let reference = self.references.get(index).copied().flatten().unwrap_or_default();

        let there: u64 = bins.iter().map(|b| b.count).sum();
        let spiky = spiky_bins(bins, reference, resolution);
        let mut total = Bin::EMPTY;
        for (bin, _) in bins.iter().zip(&spiky).filter(|(_, spiky)| !**spiky) {
            total.merge(bin);
        }
        // A sample whose time rounds across the edge belongs to the setting beside: it is left out, and is no spike.
        let level = |setting: Option<usize>| setting.and_then(|i| levels.get(i)).copied().flatten();
        let neighbours = [(0, level(index.checked_sub(1))), (BINS - 1, level(Some(index + 1)))];
        let beyond_edge = |(edge, beside): (usize, Option<[f64; 3]>)| {
            let place = edge.checked_sub(first)?;
            let bin = bins.get(place).filter(|_| spiky[place])?;
            is_between(bin, &total, beside?).then_some(bin.count)
        };
        let edge_samples: u64 = neighbours.into_iter().filter_map(beyond_edge).sum();
        #[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
        let (count, fraction) = (total.count as f64, there as f64 / (self.sample_rate_hz * (used_s[1] - used_s[0])).max(1.0));
        let mut mean = [f64::NAN; 3];
        let mut std = [f64::NAN; 3];
        for axis in 0..3 {
            if total.count > 0 {
                mean[axis] = reference[axis] + total.mean(axis);
            }
            if total.count > 1 {
                let centred = total.squares[axis] - total.sum[axis] * total.sum[axis] / count;
                // Equal samples have no scatter; rounding may leave a little.
                let scatters = total.min[axis] < total.max[axis];
                std[axis] = if scatters { (centred.max(0.0) / (count - 1.0)).sqrt() } else { 0.0 };
            }
        }
        let dropped = if setting.frequency_hz > 0.0 {
            Some(Drop::Sine)
        } else if total.count == 0 {
            Some(Drop::NoSamples)
        } else if fraction < least_coverage {
            Some(Drop::Coverage { fraction })
        } else {
            None
        };
        let plateau = Plateau {
            index,
            setting: *setting,
            used_s,
            mean: Reading(mean),
            std_ent: (total.count > 1).then_some(std),
            count: Some(total.count),
            spike_samples: there - total.count - edge_samples,
            dropped,
            contrasts: contrasts(bins, &spiky, duration_s / BINS as f64, self.sample_rate_hz),
        };
        (plateau, Extremes { min: total.min, max: total.max })
    }

    /// The smallest difference of two readings that stand for different bins, per component: no less than one digit of the data.
    fn resolution(&self) -> [f64; 3] {
        std::array::from_fn(|axis| {
            let mut levels: Vec<f64> = self.bins.iter().flatten().filter(|b| b.count > 0).map(|b| b.min[axis]).collect();
            levels.sort_by(f64::total_cmp);
            levels.windows(2).map(|w| w[1] - w[0]).filter(|d| *d > 0.0).fold(f64::INFINITY, f64::min)
        })
    }
}

/// The plateaus of a run: those that the file brings, or those of the vectors that were read.
#[must_use]
pub fn of_run(run: &Run, vectors: Accumulator, cut: Cut) -> Plateaus {
    let mut plateaus = if run.blocks.is_empty() { vectors.finish(cut) } else { from_blocks(&run.blocks) };
    for plateau in &mut plateaus.list {
        // Of samples what is left may be enough; a mean that the file brings cannot be divided.
        let lacks = matches!(plateau.dropped, Some(Drop::NoSamples | Drop::Coverage { .. })) || !run.blocks.is_empty();
        if let Some(because) = run.excluded_because(plateau.index, &plateau.setting).filter(|_| lacks) {
            plateau.dropped = Some(Drop::Excluded { because: because.to_owned() });
        }
    }
    plateaus
}

/// Plateaus that the file brings ready made.
#[must_use]
pub fn from_blocks(blocks: &[GivenBlock]) -> Plateaus {
    let list = blocks
        .iter()
        .enumerate()
        .map(|(index, b)| Plateau {
            index,
            setting: b.setting,
            used_s: [b.setting.t_start_s, b.setting.t_end_s],
            mean: b.mean,
            std_ent: b.std_ent,
            count: b.count,
            spike_samples: 0,
            dropped: None,
            contrasts: Vec::new(),
        })
        .collect();
    Plateaus {
        list,
        settling_s: 0.0,
        settling_found_s: 0.0,
        still_settling: false,
        still_follows: None,
        early_end_s: 0.0,
        edge_shift_s: 0.0,
        tolerable_shift_s: f64::INFINITY,
        outside: 0,
        without_scatter: [0; 3],
        pauses: Vec::new(),
    }
}

#[cfg(test)]
mod tests;
