//! Noise of the hidden truth: families at sample level, and the exact whitening that belongs to them.
//!
//! Slow noise is a sum of relaxations (autoregressive processes of first order) of samples with random corner frequencies and an exponent that
//! changes at a random one; the diagnosis has no bend, and time constants of its own at fixed ratios between means. Covariances are
//! closed forms, so that a Kalman filter over means of samples whitens with the true covariance however long the record is.

use super::sensor::{CleanRun, Kind};
use rand_distr::{Distribution, StandardNormal, StudentT};
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::{Rng, SeedableRng};
use serde::Serialize;

/// Random numbers of one purpose; equal seeds and names give equal numbers.
pub struct Random(Xoshiro256PlusPlus);

impl Random {
    /// The stream of a purpose.
    pub fn new(seed: u64, name: &str) -> Self {
        // FNV-1a, so that the streams of neighbouring seeds and names lie far apart.
        let bytes = seed.to_le_bytes().into_iter().chain(name.bytes());
        Self(Xoshiro256PlusPlus::seed_from_u64(
            bytes.fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)),
        ))
    }

    /// Mean 0, standard deviation 1.
    #[inline]
    pub fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }

    /// Uniform in [0, 1).
    #[inline]
    pub fn uniform(&mut self) -> f64 {
        (self.0.next_u64() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// Uniform between two values.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.uniform()
    }

    /// Between two values, uniform in the logarithm.
    pub fn log_between(&mut self, low: f64, high: f64) -> f64 {
        self.between(low.ln(), high.ln()).exp()
    }

    /// A whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.uniform() * count as f64) as usize).min(count - 1)
    }

    /// -1 or 1.
    pub fn sign(&mut self) -> f64 {
        if self.uniform() < 0.5 { -1.0 } else { 1.0 }
    }

    /// Whether something of this probability happens.
    pub fn chance(&mut self, probability: f64) -> bool {
        self.uniform() < probability
    }

    /// Puts a list into random order.
    pub fn shuffle<T>(&mut self, list: &mut [T]) {
        for i in (1..list.len()).rev() {
            list.swap(i, self.below(i + 1));
        }
    }
}

/// A family of noise.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Family {
    White,
    PowerLaw,
    Autoregressive,
    Telegraph,
    GrowsWithField,
    ProportionalFlicker,
    HeavyTails,
    GrowsWithTemperature,
    Spikes,
}

impl Family {
    pub const ALL: [Family; 9] = [
        Family::White,
        Family::PowerLaw,
        Family::Autoregressive,
        Family::Telegraph,
        Family::GrowsWithField,
        Family::ProportionalFlicker,
        Family::HeavyTails,
        Family::GrowsWithTemperature,
        Family::Spikes,
    ];
    /// Those of which a run draws one where none is asked for: all but the last.
    pub const WITHOUT_SPIKES: [Family; Self::ALL.len() - 1] = *Self::ALL.first_chunk().unwrap();

    /// Name in tables.
    pub fn name(self) -> &'static str {
        match self {
            Family::White => "white",
            Family::PowerLaw => "bent 1/f^a",
            Family::Autoregressive => "AR(1)",
            Family::Telegraph => "random telegraph",
            Family::GrowsWithField => "white, grows with the field",
            Family::ProportionalFlicker => "1/f in proportion to the field",
            Family::HeavyTails => "heavy tails",
            Family::GrowsWithTemperature => "white, grows with temperature",
            Family::Spikes => "spikes and a burst",
        }
    }
}

/// How white noise depends on the state of the sample; the factor on its standard deviation.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Growth {
    None,
    /// `1 + size |b|^power` with the own component over the range.
    Field {
        size: f64,
        power: f64,
    },
    /// `1 + size` beyond a share of the range, straight from there on.
    FieldBeyond {
        size: f64,
        onset: f64,
    },
    /// `1 + size (T - T_lowest) / (T_highest - T_lowest)` with the sensor temperature.
    Temperature {
        size: f64,
    },
}

/// Distribution of white noise; its standard deviation is the stated one in every case.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Tails {
    Normal,
    Student {
        freedom: f64,
    },
    /// One in a hundred samples is this many times larger.
    Outliers {
        times: f64,
    },
    /// Normal, with single samples that are 10 to 1000 enT off and a burst of twenty times the noise. Means that a sweep brings are 4 to 12
    /// of their standard deviations off.
    Spikes {
        single: usize,
        burst: usize,
    },
}

/// One slow process.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Relaxation {
    /// enT².
    pub variance_ent2: f64,
    /// Correlation time, s.
    pub tau_s: f64,
    /// Multiplied by the own field component over the range.
    pub proportional: bool,
    /// Jumps between two levels instead of a normal process; mean and covariance are the same.
    pub telegraph: bool,
}

/// The noise of one sensor in one run set.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Noise {
    pub family: Family,
    /// Standard deviation of white noise per sample, enT, per component.
    pub white_ent: [f64; 3],
    pub growth: Growth,
    pub tails: Tails,
    /// For a component with a white noise of 1 enT; others in proportion.
    pub slow: Vec<Relaxation>,
}

/// Means of this many samples decide on shares of slow noise.
fn typical_cell(clean: &CleanRun) -> (f64, f64) {
    let samples = clean.plateaus.first().map_or(1, |p| p.len());
    (samples as f64, samples as f64 / clean.rate_hz)
}

impl Noise {
    /// Draws the parameters of a family.
    pub fn drawn(family: Family, clean: &CleanRun, random: &mut Random) -> Self {
        let around = match clean.kind {
            Kind::Lin | Kind::Positions => 0.38,
            Kind::Sweep => 0.36,
            Kind::ZeroField => 0.30,
            Kind::Frequency => 0.35,
        };
        let white_ent = std::array::from_fn(|_| around * random.between(0.8, 1.2));
        let mut noise = Self { family, white_ent, growth: Growth::None, tails: Tails::Normal, slow: Vec::new() };
        let length_s = clean.count as f64 / clean.rate_hz;
        match family {
            Family::White => {}
            Family::PowerLaw => {
                let exponents = [random.between(0.6, 1.8), random.between(0.6, 1.8)];
                let share = random.between(0.1, 0.9);
                noise.slow = sum_of_relaxations(exponents, share, false, clean, random);
            }
            Family::Autoregressive | Family::Telegraph => {
                let (samples, cell_s) = typical_cell(clean);
                let tau_s = random.log_between((0.3 * cell_s).max(1.0 / clean.rate_hz), 0.1 * length_s);
                let share = random.between(0.15, 0.8);
                let one = Relaxation { variance_ent2: 1.0, tau_s, proportional: false, telegraph: family == Family::Telegraph };
                let mean = mean_variance(decay(tau_s, clean.rate_hz), samples);
                noise.slow = vec![Relaxation { variance_ent2: share / (1.0 - share) / samples / mean, ..one }];
            }
            Family::GrowsWithField => {
                noise.growth = match random.below(3) {
                    0 => Growth::Field { size: random.between(0.5, 2.5), power: 1.0 },
                    1 => Growth::Field { size: random.between(0.5, 2.5), power: 2.0 },
                    _ => Growth::FieldBeyond { size: random.between(1.0, 4.0), onset: random.between(0.3, 0.7) },
                }
            }
            Family::ProportionalFlicker => {
                let share = random.between(0.3, 0.85);
                noise.slow = sum_of_relaxations([random.between(0.8, 1.3), random.between(0.8, 1.3)], share, true, clean, random);
            }
            Family::HeavyTails => {
                noise.tails = if random.chance(0.5) {
                    Tails::Student { freedom: random.between(3.0, 6.0) }
                } else {
                    Tails::Outliers { times: random.between(5.0, 10.0) }
                }
            }
            Family::GrowsWithTemperature => noise.growth = Growth::Temperature { size: random.between(0.5, 2.5) },
            Family::Spikes => noise.tails = Tails::Spikes { single: 4 + random.below(5), burst: 4 + random.below(13) },
        }
        let already_slow = !noise.slow.is_empty() && family != Family::ProportionalFlicker;
        if family != Family::White && !already_slow && random.chance(0.5) {
            let exponents = [random.between(0.8, 1.2), random.between(0.8, 1.2)];
            noise.slow.extend(sum_of_relaxations(exponents, random.between(0.1, 0.8), false, clean, random));
        }
        noise
    }

    /// Factor on the white noise of a sample.
    fn growth_at(&self, clean: &CleanRun, sample: usize, component: usize) -> f64 {
        let b = clean.own_field(sample, component).abs();
        match self.growth {
            Growth::None => 1.0,
            Growth::Field { size, power } => 1.0 + size * b.powf(power),
            Growth::FieldBeyond { size, onset } => 1.0 + size * (b - onset).max(0.0) / (1.0 - onset),
            Growth::Temperature { size } => {
                let (low, high) = clean.sensor_degc.limits();
                1.0 + size * (clean.sensor_degc.at(clean.t_s(sample)) - low) / (high - low).max(1e-9)
            }
        }
    }

    /// One record of noise, enT.
    pub fn record(&self, clean: &CleanRun, random: &mut Random) -> Vec<[f64; 3]> {
        let mut record = self.white(clean, random);
        if let Tails::Spikes { single, burst } = self.tails {
            self.spikes(clean, [single, burst], &mut record, random);
        }
        for (component, white_ent) in self.white_ent.into_iter().enumerate() {
            for relaxation in &self.slow {
                let std = relaxation.variance_ent2.sqrt() * white_ent;
                let keep = decay(relaxation.tau_s, clean.rate_hz);
                let factor = |sample: usize| if relaxation.proportional { clean.own_field(sample, component) } else { 1.0 };
                if relaxation.telegraph {
                    let flips = 0.5 * (1.0 - keep);
                    let mut level = std * random.sign();
                    for (sample, value) in record.iter_mut().enumerate() {
                        value[component] += level * factor(sample);
                        if random.uniform() < flips {
                            level = -level;
                        }
                    }
                } else {
                    let kick = std * (1.0 - keep * keep).sqrt();
                    let mut level = std * random.normal();
                    for (sample, value) in record.iter_mut().enumerate() {
                        value[component] += level * factor(sample);
                        level = keep * level + kick * random.normal();
                    }
                }
            }
        }
        record
    }

    /// Adds single samples, or means of a sweep, that stand out, and a burst.
    fn spikes(&self, clean: &CleanRun, [single, burst]: [usize; 2], record: &mut [[f64; 3]], random: &mut Random) {
        for _ in 0..single {
            let (axis, sign) = (random.below(3), random.sign());
            if clean.kind == Kind::Sweep {
                let block = clean.plateaus[random.below(clean.plateaus.len())].clone();
                let size = self.white_ent[axis] / (block.len() as f64).sqrt() * random.between(4.0, 12.0);
                record[block].iter_mut().for_each(|r| r[axis] += sign * size);
            } else {
                record[random.below(clean.count)][axis] += sign * random.log_between(10.0, 1000.0);
            }
        }
        if clean.kind != Kind::Sweep {
            let first = random.below(clean.count - burst);
            for reading in &mut record[first..first + burst] {
                (0..3).for_each(|a| reading[a] += 20.0 * self.white_ent[a] * random.normal());
            }
        }
    }

    fn white(&self, clean: &CleanRun, random: &mut Random) -> Vec<[f64; 3]> {
        let student = match self.tails {
            Tails::Student { freedom } => StudentT::new(freedom).ok().map(|t| (t, ((freedom - 2.0) / freedom).sqrt())),
            _ => None,
        };
        let unit = |random: &mut Random| match (self.tails, &student) {
            (Tails::Outliers { times }, _) => {
                let factor = if random.chance(0.01) { times } else { 1.0 };
                factor * random.normal() / (1.0 + 0.01 * (times * times - 1.0)).sqrt()
            }
            (_, Some((t, to_unit))) => t.sample(&mut random.0) * to_unit,
            _ => random.normal(),
        };
        if clean.kind == Kind::Sweep && matches!(self.tails, Tails::Student { .. } | Tails::Outliers { .. }) {
            // Only means of a block are seen: the tails are those of the means.
            let mut record = vec![[0.0; 3]; clean.count];
            for block in &clean.plateaus {
                let mean: [f64; 3] = std::array::from_fn(|i| self.white_ent[i] / (block.len() as f64).sqrt() * unit(random));
                record[block.clone()].fill(mean);
            }
            return record;
        }
        (0..clean.count)
            .map(|sample| {
                std::array::from_fn(|i| {
                    let grown = if self.growth == Growth::None { 1.0 } else { self.growth_at(clean, sample, i) };
                    self.white_ent[i] * grown * unit(random)
                })
            })
            .collect()
    }
}

/// Relaxations whose sum has a density of about `f^-a`, with one exponent above and another below a random frequency: corner frequencies a
/// random two to six times apart. `share` is the part of the slow noise in the variance of a plateau's mean.
fn sum_of_relaxations(
    exponents: [f64; 2],
    share: f64,
    proportional: bool,
    clean: &CleanRun,
    random: &mut Random,
) -> Vec<Relaxation> {
    let (samples, cell_s) = typical_cell(clean);
    let length_s = clean.count as f64 / clean.rate_hz;
    let bend_s = random.log_between(cell_s, length_s);
    let mut slow = Vec::new();
    let mut tau_s = random.between(1.0, 4.0) / clean.rate_hz;
    while tau_s < 2.0 * length_s {
        let ratio = random.log_between(2.0, 6.0);
        // The variance of a relaxation stands for the noise of the frequencies up to its neighbour.
        let exponent = if tau_s < bend_s { exponents[0] } else { exponents[1] };
        let variance_ent2 = (tau_s / bend_s).powf(exponent - 1.0) * ratio.ln();
        slow.push(Relaxation { variance_ent2, tau_s, proportional, telegraph: false });
        tau_s *= ratio;
    }
    let mean: f64 = slow.iter().map(|r| r.variance_ent2 * mean_variance(decay(r.tau_s, clean.rate_hz), samples)).sum();
    // A field component is a third of its range in the mean square.
    let wanted = share / (1.0 - share) / samples * if proportional { 3.0 } else { 1.0 };
    slow.iter_mut().for_each(|r| r.variance_ent2 *= wanted / mean);
    slow
}

/// Correlation of neighbouring samples.
fn decay(tau_s: f64, rate_hz: f64) -> f64 {
    (-1.0 / (tau_s * rate_hz)).exp()
}

/// Variance of the mean of neighbouring samples of a relaxation of unit variance.
fn mean_variance(keep: f64, samples: f64) -> f64 {
    let (n, rest) = (samples, 1.0 - keep);
    if n <= 1.0 {
        return 1.0;
    }
    let rate = -keep.ln();
    if n * rate < 1e-3 {
        // The closed form below is a small difference of large numbers there.
        return 1.0 - rate * (n * n - 1.0) / (3.0 * n) + rate * rate * (n * n - 1.0) / 12.0;
    }
    (n * (1.0 + keep) / rest - 2.0 * keep * (1.0 - keep.powf(n)) / (rest * rest)) / (n * n)
}

/// Neighbouring samples that are averaged.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cell {
    pub first: usize,
    pub count: usize,
}

/// How a relaxation comes to the next cell: `end = keep · end`, `mean = reach · end`, with the covariance of what is new.
#[derive(Clone, Copy)]
struct Step {
    keep: f64,
    reach: f64,
    new: [f64; 3],
}

impl Step {
    fn new(keep: f64, gap: usize, count: usize) -> Self {
        let n = count as f64;
        let sum = |keep: f64| if 1.0 - keep < 1e-12 { n } else { (1.0 - keep.powf(n)) / (1.0 - keep) };
        let along = sum(keep) / n;
        let end = keep.powf((gap + count - 1) as f64);
        let reach = keep.powf(gap as f64) * along;
        let new = [1.0 - end * end, along - end * reach, mean_variance(keep, n) - reach * reach];
        Self { keep: end, reach, new }
    }
}

/// Turns means of cells into numbers of unit variance that do not go together, for one component of one run.
pub struct Whitener {
    slow: usize,
    /// Per cell: one over the standard deviation of what is new in it.
    scale: Vec<f64>,
    /// Per cell and relaxation: reach times factor, keep, gain.
    steps: Vec<[f64; 3]>,
}

impl Whitener {
    /// The Kalman filter of the noise over the cells.
    pub fn new(noise: &Noise, clean: &CleanRun, component: usize, cells: &[Cell]) -> Self {
        let slow = noise.slow.len();
        let unit = noise.white_ent[component];
        let keeps: Vec<f64> = noise.slow.iter().map(|r| decay(r.tau_s, clean.rate_hz)).collect();
        let variances: Vec<f64> = noise.slow.iter().map(|r| r.variance_ent2 * unit * unit).collect();
        let mut covariance: Vec<Vec<f64>> =
            (0..slow).map(|i| (0..slow).map(|j| if i == j { variances[i] } else { 0.0 }).collect()).collect();
        let mut whitener = Self { slow, scale: Vec::with_capacity(cells.len()), steps: Vec::with_capacity(cells.len() * slow) };
        let mut last = 0;
        let mut known: Option<(usize, usize, Vec<Step>)> = None;
        let mut crossed = vec![0.0; slow];
        let mut loading = vec![0.0; slow];
        for cell in cells {
            let gap = (cell.first + 1 - last).min(1 << 30);
            if known.as_ref().is_none_or(|(g, n, _)| (*g, *n) != (gap, cell.count)) {
                known = Some((gap, cell.count, keeps.iter().map(|keep| Step::new(*keep, gap, cell.count)).collect()));
            }
            let Some((_, _, steps)) = &known else { continue };
            let grown: f64 = if noise.growth == Growth::None {
                cell.count as f64
            } else {
                (cell.first..cell.first + cell.count).map(|s| noise.growth_at(clean, s, component).powi(2)).sum()
            };
            let mut variance = unit * unit * grown / (cell.count as f64).powi(2);
            let b = clean.own_field(cell.first, component);
            for (j, relaxation) in noise.slow.iter().enumerate() {
                loading[j] = if relaxation.proportional { b } else { 1.0 };
            }
            for i in 0..slow {
                let mut sum = 0.0;
                let mut across = 0.0;
                for j in 0..slow {
                    let term = covariance[i][j] * steps[j].reach * loading[j];
                    sum += term;
                    across += term;
                }
                let own = variances[i] * loading[i];
                variance += loading[i] * (steps[i].reach * sum + own * steps[i].new[2]);
                crossed[i] = steps[i].keep * across + own * steps[i].new[1];
            }
            for i in 0..slow {
                for j in 0..=i {
                    let new = if i == j { variances[i] * steps[i].new[0] } else { 0.0 };
                    let value = steps[i].keep * covariance[i][j] * steps[j].keep + new - crossed[i] * crossed[j] / variance;
                    covariance[i][j] = value;
                    covariance[j][i] = value;
                }
                whitener.steps.push([steps[i].reach * loading[i], steps[i].keep, crossed[i] / variance]);
            }
            whitener.scale.push(1.0 / variance.sqrt());
            last = cell.first + cell.count;
        }
        whitener
    }

    /// Logarithm of the determinant of the covariance of the means.
    pub fn log_covariance(&self) -> f64 {
        -2.0 * self.scale.iter().map(|s| s.ln()).sum::<f64>()
    }

    /// Whitens one column of means.
    pub fn apply(&self, column: &[f64]) -> Vec<f64> {
        let mut state = vec![0.0; self.slow];
        let mut steps = self.steps.chunks_exact(self.slow.max(1));
        column
            .iter()
            .zip(&self.scale)
            .map(|(value, scale)| {
                if self.slow == 0 {
                    return value * scale;
                }
                let Some(step) = steps.next() else { return 0.0 };
                let new = value - state.iter().zip(step).map(|(s, [reach, _, _])| s * reach).sum::<f64>();
                for (s, [_, keep, gain]) in state.iter_mut().zip(step) {
                    *s = keep * *s + gain * new;
                }
                new * scale
            })
            .collect()
    }
}

impl Noise {
    /// Standard deviation of the mean of a cell, enT.
    pub fn mean_std_ent(&self, clean: &CleanRun, component: usize, cell: &Cell) -> f64 {
        let samples = cell.count as f64;
        let b = clean.own_field(cell.first, component);
        let white: f64 = if self.growth == Growth::None {
            samples
        } else {
            (cell.first..cell.first + cell.count).map(|s| self.growth_at(clean, s, component).powi(2)).sum()
        };
        let slow = self.slow.iter().map(|r| {
            let factor = if r.proportional { b * b } else { 1.0 };
            factor * r.variance_ent2 * mean_variance(decay(r.tau_s, clean.rate_hz), samples)
        });
        self.white_ent[component] * (white / (samples * samples) + slow.sum::<f64>()).sqrt()
    }
}
