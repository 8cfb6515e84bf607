//! Vectors to plateau statistics, streaming: every setting is divided into equal bins, each with count, mean, scatter and
//! extremes, so that settling, edges and spikes can be judged afterwards without keeping samples.

use crate::data::run::{GivenBlock, Header, Run, Setting, Vector, VectorSink};
use crate::data::units::{COMPONENTS, Reading};
use crate::fit::statistics::median;
use serde::Serialize;
use std::cell::OnceCell;
use std::fmt;
use std::ops::Range;

/// Bins of one setting.
const BINS: usize = 64;
/// Expected samples of the shortest parts that are compared within a plateau.
const FEWEST_IN_PART: f64 = 4.0;
/// Bins that settling and a late edge may take at most.
const MOST_SETTLING: usize = 48;
/// Bins that show the level of a setting, whatever happens at its ends: free of data that are late by up to three eighths or early
/// by up to a quarter of a plateau.
const REFERENCE: Range<usize> = 3 * BINS / 8..3 * BINS / 4;

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

/// Where a setting's samples stop to be influenced by the step before it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Settling {
    /// Found from the data.
    Found,
    /// Given, s after the begin of the setting.
    Given(f64),
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

    /// The plateaus of what was read. A plateau with less than `least_coverage` of its expected samples is dropped.
    #[must_use]
    pub fn finish(mut self, settling: Settling, least_coverage: f64) -> Plateaus {
        self.close();
        let edges = self.find_edges();
        let settling_s = match settling {
            Settling::Given(given_s) => given_s,
            Settling::Found => edges.settling_s,
        };
        // Only data without scatter need it, and sorting the readings of a run for every plateau would take longer than reading it.
        let found = OnceCell::new();
        let resolution = || *found.get_or_init(|| self.resolution());
        let mut list = Vec::with_capacity(self.settings.len());
        let mut extremes = Vec::with_capacity(self.settings.len());
        for (index, setting) in self.settings.iter().enumerate() {
            let bin_s = (setting.t_end_s - setting.t_start_s) / BINS as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates at 0 and at BINS")]
            let bins_of = |time_s: f64| ((time_s / bin_s - 1e-9).ceil() as usize).min(BINS);
            let used = bins_of(settling_s)..BINS - bins_of(edges.early_end_s);
            let (plateau, range) = self.plateau(index, setting, used, least_coverage, &resolution);
            list.push(plateau);
            extremes.push(range);
        }
        let without_scatter = drop_saturated(&mut list, &extremes);
        Plateaus {
            list,
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
        setting: &Setting,
        used: Range<usize>,
        least_coverage: f64,
        resolution: &impl Fn() -> [f64; 3],
    ) -> (Plateau, Extremes) {
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
                // Equal samples have no scatter, whatever rounding leaves of it.
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
            spike_samples: there - total.count,
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

    /// Finds how many bins follow the step before a setting, and how many already follow the step after it: the deviation of every
    /// bin from the setting's middle is regressed on the step, over all settings and components at once.
    fn find_edges(&self) -> Edges {
        // All settings share one clock after a step, whatever their length.
        let slot_s = self.median_duration_s() / BINS as f64;
        let middle = self.levels(REFERENCE);
        // Data that step too early show at least one whole sample of the next setting.
        let one_sample = 1.0 / (slot_s * self.sample_rate_hz).max(1.0);
        let early = (0..BINS - REFERENCE.end).map(|slot| self.response(&middle, slot, slot_s, false));
        let early_slots = followed(early, 0.5 * one_sample);
        // The level that a decay goes to is best seen at the end.
        let end = BINS - early_slots.map_or(BINS - REFERENCE.end, |slots| if slots == 0 { 0 } else { slots + 1 });
        let last = self.levels(end - BINS / 4..end);
        let late = (0..MOST_SETTLING).map(|slot| self.response(&last, slot, slot_s, true));
        let late_slots = followed(late, NEGLIGIBLE);
        // A decay that has just become too small to be seen still biases the mean; half as long again makes it negligible.
        let settling = match late_slots {
            Some(0) => 0,
            Some(slots) => (slots + slots / 2 + 1).min(MOST_SETTLING),
            None => MOST_SETTLING,
        };
        let shift_bins = self.step_inside().map_or(0.0, |at| if at < BINS as f64 / 2.0 { at } else { at - BINS as f64 });
        Edges {
            settling_s: settling as f64 * slot_s,
            still_settling: late_slots.is_none(),
            early_end_s: (BINS - end) as f64 * slot_s,
            shift_s: shift_bins * slot_s,
        }
    }

    /// Mean reading of every setting over some of its bins.
    fn levels(&self, bins: Range<usize>) -> Vec<Option<[f64; 3]>> {
        let level = |(all, reference): (&[Bin; BINS], &Option<[f64; 3]>)| {
            let mut total = Bin::EMPTY;
            all.get(bins.clone())?.iter().for_each(|b| total.merge(b));
            let reference = (*reference)?;
            (total.count > 0).then(|| std::array::from_fn(|axis| reference[axis] + total.mean(axis)))
        };
        self.bins.iter().zip(&self.references).map(level).collect()
    }

    /// Where, in bins, the data step inside the settings, if they do: there most settings jump by a good part of the step of the
    /// applied field to a neighbouring setting, elsewhere few do.
    fn step_inside(&self) -> Option<f64> {
        let distance = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt();
        let fields: Vec<[f64; 3]> = self.settings.iter().map(|s| s.field.0).collect();
        let smallest_jump = |i: usize| {
            let steps =
                [i.checked_sub(1), Some(i + 1)].into_iter().flatten().filter_map(|n| Some(distance(*fields.get(n)?, fields[i])));
            steps.filter(|step| *step > 0.0).fold(f64::INFINITY, f64::min) / 2.0
        };
        let jumps: Vec<f64> = (0..fields.len()).map(smallest_jump).collect();
        let changing = jumps.iter().filter(|j| j.is_finite()).count();
        // Per bin, for every setting that jumps there, the part of the jump that the bin itself has not yet taken.
        let parts: Vec<Vec<(f64, f64)>> = (0..BINS - 2)
            .map(|bin| {
                let part = |(bins, jump): (&[Bin; BINS], &f64)| {
                    let [before, at, after] = [0, 1, 2].map(|i| std::array::from_fn(|axis| bins[bin + i].mean(axis)));
                    let whole = distance(before, after);
                    (whole.is_finite() && whole > *jump).then(|| ((distance(at, after) / whole).min(1.0), whole / jump))
                };
                self.bins.iter().zip(&jumps).filter_map(part).collect()
            })
            .collect();
        let typical = median(&mut parts.iter().map(|p| p.len() as f64).collect::<Vec<f64>>());
        // The bins beside the step show less of it than the one that holds it.
        let size = |part: &[(f64, f64)]| (part.len(), median(&mut part.iter().map(|p| p.1).collect::<Vec<f64>>()));
        let (bin, part) = parts.into_iter().enumerate().max_by(|(_, a), (_, b)| {
            let (a, b) = (size(a), size(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1))
        })?;
        let clear = 2 * part.len() > changing && 4.0 * typical < part.len() as f64;
        clear.then(|| bin as f64 + 1.0 + median(&mut part.iter().map(|p| p.0).collect::<Vec<f64>>()))
    }

    /// How much of the step before and of the step after a setting its data show at a time after its begin (or before its end), from
    /// a regression on both steps over all settings and components.
    fn response(&self, middle: &[Option<[f64; 3]>], slot: usize, slot_s: f64, after_begin: bool) -> Response {
        let (mut pp, mut pn, mut nn, mut pd, mut nd, mut dd, mut count) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for (i, (setting, bins)) in self.settings.iter().zip(&self.bins).enumerate() {
            let level = |i: Option<usize>| i.and_then(|i| middle.get(i)).copied().flatten();
            let (Some(here), Some(Some(reference))) = (level(Some(i)), self.references.get(i)) else { continue };
            let (before, after) = (level(i.checked_sub(1)), level(Some(i + 1)));
            let (Some(before), Some(after)) = (before.or(after.map(|_| here)), after.or(before.map(|_| here))) else { continue };
            let bin_s = (setting.t_end_s - setting.t_start_s) / BINS as f64;
            #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates at BINS")]
            let index = ((slot as f64 + 0.5) * slot_s / bin_s) as usize;
            let Some(bin) = bins.get(if after_begin { index } else { (BINS - 1).wrapping_sub(index) }).filter(|b| b.count > 0)
            else {
                continue;
            };
            for axis in 0..3 {
                let (p, n) = (before[axis] - here[axis], after[axis] - here[axis]);
                let d = reference[axis] + bin.mean(axis) - here[axis];
                pp += p * p;
                pn += p * n;
                nn += n * n;
                pd += p * d;
                nd += n * d;
                dd += d * d;
                count += 1.0;
            }
        }
        let (own, own_d) = if after_begin { (pp, pd) } else { (nn, nd) };
        if count < 6.0 || own <= 0.0 {
            return Response { fraction: 0.0, z: 0.0 };
        }
        let determinant = pp * nn - pn * pn;
        let (fraction, explained, weight) = if determinant > 1e-6 * pp * nn {
            let of_before = (pd * nn - nd * pn) / determinant;
            let of_after = (nd * pp - pd * pn) / determinant;
            let explained = of_before * pd + of_after * nd;
            if after_begin { (of_before, explained, nn / determinant) } else { (of_after, explained, pp / determinant) }
        } else {
            // Both steps are the same one, as where two fields alternate.
            (own_d / own, own_d * own_d / own, 1.0 / own)
        };
        let std = ((dd - explained).max(0.0) / (count - 2.0) * weight).sqrt();
        Response { fraction, z: if std > 0.0 { fraction.abs() / std } else { 0.0 } }
    }
}

/// A component whose samples of a plateau are all equal, and equal to the largest or smallest reading of all plateaus, is at the end
/// of its range if that happens with different fields, or if most other plateaus of the component do scatter. Returns the number of
/// plateaus without scatter.
fn drop_saturated(list: &mut [Plateau], extremes: &[Extremes]) -> [usize; 3] {
    let mut without_scatter = [0; 3];
    for (component, silent) in without_scatter.iter_mut().enumerate() {
        let used: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
        let is_still = |i: &usize| extremes[*i].min[component] == extremes[*i].max[component];
        let still: Vec<usize> = used.iter().copied().filter(is_still).collect();
        *silent = still.len();
        let low = used.iter().map(|i| extremes[*i].min[component]).fold(f64::INFINITY, f64::min);
        let high = used.iter().map(|i| extremes[*i].max[component]).fold(f64::NEG_INFINITY, f64::max);
        for end in [low, high] {
            let rests: Vec<usize> = still.iter().copied().filter(|i| extremes[*i].min[component] == end).collect();
            let differ = rests.iter().any(|i| list[*i].setting.field != list[rests[0]].setting.field);
            if low < high && (differ || 2 * (used.len() - still.len()) > used.len()) {
                for i in rests {
                    list[i].dropped = Some(Drop::Saturated { component });
                }
            }
        }
    }
    without_scatter
}

/// How much of a neighbouring step a bin shows.
#[derive(Clone, Copy, Debug)]
struct Response {
    fraction: f64,
    z: f64,
}

/// A part of a step that is too small to matter for a sensitivity.
const NEGLIGIBLE: f64 = 1e-7;

/// How many slots from the begin show the step: up to the first two that do not. `None`: they all do. Significant is what exceeds four
/// standard errors, so that sixty-four slots raise a false alarm in one run of two hundred and fifty, and `least` of the step.
fn followed(responses: impl Iterator<Item = Response>, least: f64) -> Option<usize> {
    let follows: Vec<bool> = responses.map(|r| r.z > 4.0 && r.fraction.abs() > least).collect();
    follows.windows(2).position(|pair| !pair[0] && !pair[1])
}

#[derive(Clone, Copy, Debug, Default)]
struct Edges {
    settling_s: f64,
    still_settling: bool,
    early_end_s: f64,
    shift_s: f64,
}

/// Bins with a sample that is more than six times as far from the plateau's level as the farthest sample of a typical bin, or, where
/// typical bins do not scatter at all, as the resolution of the data.
fn spiky_bins(bins: &[Bin], reference: [f64; 3], resolution: &impl Fn() -> [f64; 3]) -> Vec<bool> {
    let mut spiky = vec![false; bins.len()];
    let filled = bins.iter().filter(|b| b.count > 0).count();
    if filled < 8 {
        return spiky;
    }
    for axis in 0..3 {
        let level =
            reference[axis] + median(&mut bins.iter().filter(|b| b.count > 0).map(|b| b.mean(axis)).collect::<Vec<f64>>());
        let reach = |b: &Bin| (b.max[axis] - level).max(level - b.min[axis]);
        let mut typical = median(&mut bins.iter().filter(|b| b.count > 0).map(reach).collect::<Vec<f64>>());
        // Rounding leaves a little of what is nothing.
        if typical <= 1e-9 * level.abs().max(1.0) && bins.iter().any(|b| b.count > 0 && reach(b) > 1e-6 * level.abs().max(1.0)) {
            typical = resolution()[axis];
        }
        for (flag, bin) in spiky.iter_mut().zip(bins) {
            *flag |= bin.count > 0 && typical > 0.0 && reach(bin) > 6.0 * typical;
        }
    }
    spiky
}

/// Contrasts of neighbouring parts at every octave of length, from parts that hold a few samples up to half of the plateau. Bins
/// with a spike do not count, nor do pairs with a part that lost more than half of its samples.
#[expect(clippy::cast_precision_loss, reason = "counts are far below 2^53")]
fn contrasts(bins: &[Bin], spiky: &[bool], bin_s: f64, sample_rate_hz: f64) -> Vec<Contrasts> {
    let expected = bin_s * sample_rate_hz;
    let mut parts: Vec<Bin> = bins.iter().zip(spiky).map(|(bin, spiky)| if *spiky { Bin::EMPTY } else { *bin }).collect();
    let (mut length, mut list) = (1, Vec::new());
    while parts.len() > 1 {
        let least = 0.5 * expected * length as f64;
        let (mut count, mut inverse_samples, mut squares) = (0, 0.0, [0.0; 3]);
        for pair in parts.chunks_exact(2).filter(|p| p.iter().all(|b| b.count as f64 >= least)) {
            count += 1;
            inverse_samples += 1.0 / pair[0].count as f64 + 1.0 / pair[1].count as f64;
            for (axis, square) in squares.iter_mut().enumerate() {
                *square += (pair[0].mean(axis) - pair[1].mean(axis)).powi(2);
            }
        }
        if count > 0 && least >= 0.5 * FEWEST_IN_PART {
            let pairs = count as f64;
            let (inverse_samples, mean_square) = (inverse_samples / pairs, squares.map(|s| s / pairs));
            list.push(Contrasts { part_s: bin_s * length as f64, count, inverse_samples, mean_square });
        }
        let joined = parts.chunks_exact(2).map(|pair| {
            let mut whole = pair[0];
            whole.merge(&pair[1]);
            whole
        });
        parts = joined.collect();
        length *= 2;
    }
    list
}

/// Least part of the expected samples that a plateau must have, where nothing else is said.
pub const LEAST_COVERAGE: f64 = 0.9;

/// The plateaus of a run: those that the file brings, or those of the vectors that were read.
#[must_use]
pub fn of_run(run: &Run, vectors: Accumulator, settling: Settling, least_coverage: f64) -> Plateaus {
    if run.blocks.is_empty() { vectors.finish(settling, least_coverage) } else { from_blocks(&run.blocks) }
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
