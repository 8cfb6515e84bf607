//! Noise of a series of means that is white, slow, or grows with the applied field, and its whitening.
//!
//! The covariance is `white_i δ_ij (1 + field u_i²) + slow C_ij + slow_field u_i u_j C_ij`, all times a variance per component, with `u`
//! the size of the field relative to the largest, and `C` that of noise which forgets after a time, or which has a power density of about
//! `f^-a`: a sum of relaxations whose time constants lie a fixed factor apart. So the whitening is a Kalman filter and its cost is in
//! proportion to the rows. Shares and exponent are those of the largest restricted likelihood (REML), common to all components; the
//! variance is that of each component.

mod whitener;

use super::spectrum::parts;
use super::{NoiseModel, NoiseParameters};
use crate::fit::statistics::log_sum;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use statrs::function::gamma::ln_gamma;
use std::ops::Range;
use std::sync::Arc;
use whitener::{Part, Whitener};

/// Exponents of the power density of slow noise that are tried.
const EXPONENTS: [f64; 7] = [0.5, 0.75, 1.0, 1.25, 1.5, 1.75, 2.0];
/// Times after which slow noise forgets that are tried, in rows.
const MEMORIES: [f64; 6] = [1.0, 2.0, 4.0, 8.0, 16.0, 32.0];
/// Every how many of them are tried first.
const COARSE: usize = 2;
/// Ratios of slow to white variance of one mean that are tried first.
const RATIOS: [f64; 7] = [0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 300.0];
/// Ratios of the variances that grow with the field, at the largest field, to the white variance.
const FIELD_RATIOS: [f64; 5] = [0.3, 1.0, 3.0, 10.0, 30.0];
/// The same for slow noise of the gain where the readings suggest none.
const GAIN_RATIOS: [f64; 4] = [0.3, 1.0, 3.0, 10.0];
/// Steps of the ratios from there on.
const CLOSER: [f64; 4] = [2.0, 1.5, 1.25, 1.1];
/// Noise that grows with the field is rare: logarithms of its prior, for white and for slow noise.
const RARE: [f64; 2] = [1.5, 3.0];
/// Prior probability that means scatter more or less than the samples inside them let expect, and the range of logarithms of its factor.
const APART_PRIOR: f64 = 0.1;
const APART_RANGE: f64 = 9.0;
/// Prior probabilities of white noise that grows with the field, where the readings suggest it, and of slow noise of the gain.
const GROWING_PRIOR: [f64; 2] = [0.2, 0.25];
/// Time constants of the relaxations of a power density: the shortest in rows, the longest in lengths of the series, and their ratio.
const SHORTEST: f64 = 0.4;
const LONGEST: f64 = 3.0;
const APART: f64 = 3.0;

/// What is known of the rows of a component before the noise is.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    /// Middle of each row, s; ascending.
    pub t_s: Vec<f64>,
    /// White variance of each row relative to the others, per component.
    pub white: Vec<[f64; 3]>,
    /// Applied field of each component relative to the largest, -1 to 1.
    pub field: Vec<[f64; 3]>,
    /// What is known from inside the rows.
    pub inside: Option<Inside>,
}

/// White noise by the samples inside the rows: how much neighbouring parts of a row differ.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Inside {
    /// Variance of the mean of a row of relative variance one, per component.
    pub variance: [f64; 3],
    /// Differences that tell it, per component.
    pub freedom: f64,
}

impl NoiseParameters {
    /// Place of its shape among [`EXPONENTS`] and then [`MEMORIES`].
    fn shape(&self) -> usize {
        let same = |list: &[f64], value: f64| list.iter().position(|v| *v == value).unwrap_or(0);
        if self.memory_rows > 0.0 { EXPONENTS.len() + same(&MEMORIES, self.memory_rows) } else { same(&EXPONENTS, self.exponent) }
    }

    fn with_shape(self, shape: usize) -> Self {
        match shape.checked_sub(EXPONENTS.len()) {
            None => NoiseParameters { exponent: EXPONENTS[shape], memory_rows: 0.0, ..self },
            Some(memory) => NoiseParameters { exponent: 2.0, memory_rows: MEMORIES[memory], ..self },
        }
    }

    /// Shapes next to its own.
    fn neighbours(&self) -> impl Iterator<Item = usize> {
        let shape = self.shape();
        [shape.checked_sub(1), Some(shape + 1).filter(|s| *s < SHAPES)].into_iter().flatten()
    }

    fn is_slow(&self) -> bool {
        self.all_slow() > 0.0
    }

    /// Logarithm of the prior.
    fn prior(&self) -> f64 {
        let of = |share: f64, prior: f64| if share > 0.0 { -prior } else { 0.0 };
        let apart = if self.apart { APART_PRIOR } else { 1.0 - APART_PRIOR };
        of(self.white_field, RARE[0]) + of(self.slow_field, RARE[1]) + apart.ln()
    }
}

/// Every how many of the noises of the gain are looked at first, and the logarithm of a likelihood ratio that leaves no hope for the others.
const EVERY: usize = 5;
const HOPELESS: f64 = 40.0;

/// Rows of the part by which noises are ruled out, the logarithm of a likelihood ratio that does so, and how many times more rows there have to
/// be for that to be worth it.
const PART_ROWS: usize = 400;
const HOPELESS_OF_A_PART: f64 = 30.0;
const LEAST_SAVING: usize = 3;

/// Number of shapes of slow noise.
const SHAPES: usize = EXPONENTS.len() + MEMORIES.len();

/// One shape of slow noise: relaxations.
struct Slow {
    /// Time constants, s.
    tau_s: Vec<f64>,
    /// Their variances; the sum is one.
    variance: Vec<f64>,
    /// What is left of each from the row before, row after row.
    keep: Vec<f64>,
}

/// Slow noise of all shapes at the times of some rows.
struct Series {
    rows: Rows,
    /// White variances are those of the first component everywhere.
    equal: bool,
    slow: Vec<Slow>,
}

/// What finds the noise of some rows.
pub struct Correlations(Arc<Series>);

/// Noise of all three components.
#[derive(Clone)]
pub struct Noise {
    /// Its parameters.
    pub parameters: NoiseParameters,
    /// Standard deviation of the white part of a row of relative variance one, per component.
    pub white_std: [f64; 3],
    /// Squares and degrees of freedom of what tells the white noise of each component beside the rows, in units of it.
    pub inside: [[f64; 2]; 3],
    whiteners: [Arc<Whitener>; 3],
    series: Arc<Series>,
}

impl Slow {
    fn new(t_s: &[f64], tau_s: Vec<f64>, variance: Vec<f64>) -> Self {
        let gaps = std::iter::once(0.0).chain(t_s.windows(2).map(|w| w[1] - w[0]));
        let keep = gaps.flat_map(|gap| tau_s.iter().map(move |tau| (-gap / tau).exp())).collect();
        Self { variance, keep, tau_s }
    }

    fn correlation(&self, lag_s: f64) -> f64 {
        self.tau_s.iter().zip(&self.variance).map(|(tau, v)| v * (-lag_s / tau).exp()).sum()
    }
}

impl Series {
    fn element(&self, parameters: &NoiseParameters, component: usize, i: usize, j: usize) -> f64 {
        let (u, v) = (self.rows.field[i][component], self.rows.field[j][component]);
        let correlated = if parameters.is_slow() {
            let lag_s = (self.rows.t_s[i] - self.rows.t_s[j]).abs();
            (parameters.slow + parameters.slow_field * u * v) * self.slow[parameters.shape()].correlation(lag_s)
        } else {
            0.0
        };
        if i == j { correlated + self.white(parameters, component, i) } else { correlated }
    }

    fn white(&self, parameters: &NoiseParameters, component: usize, row: usize) -> f64 {
        let u = self.rows.field[row][component];
        self.rows.white[row][component] * parameters.white_at(u)
    }

    fn whitener(&self, parameters: &NoiseParameters, component: usize, rows: Range<usize>) -> Option<Whitener> {
        let slow = &self.slow[parameters.shape()];
        let of_field = |i: usize| self.rows.field[i][component];
        let part = |size: f64, load| Part { size, variance: &slow.variance, keep: &slow.keep, load };
        // Relaxations that add to every row, and others that add in proportion to the field.
        let mut parts = vec![part(parameters.slow, None), part(parameters.slow_field, Some(&of_field as &dyn Fn(usize) -> f64))];
        parts.retain(|p| p.size > 0.0);
        Whitener::new(rows, |i| self.white(parameters, component, i), &parts)
    }
}

impl Correlations {
    /// Of rows at these times.
    #[must_use]
    pub fn new(rows: Rows) -> Self {
        let t = &rows.t_s;
        let span = (t[t.len() - 1] - t[0]).max(f64::MIN_POSITIVE);
        let mut gaps: Vec<f64> = t.windows(2).map(|w| w[1] - w[0]).collect();
        gaps.sort_by(f64::total_cmp);
        let gap = gaps.get(gaps.len() / 2).copied().unwrap_or(span).max(span * 1e-9);
        let tau_s: Vec<f64> = std::iter::successors(Some(SHORTEST * gap), |tau| Some(tau * APART))
            .take_while(|tau| *tau < LONGEST * span)
            .collect();
        let power = |a: &f64| Slow::new(t, tau_s.clone(), parts(&tau_s, *a));
        let slow = EXPONENTS.iter().map(power).chain(MEMORIES.iter().map(|m| Slow::new(t, vec![m * gap], vec![1.0]))).collect();
        let equal = rows.white.iter().all(|w| w[1] == w[0] && w[2] == w[0]);
        Self(Arc::new(Series { rows, equal, slow }))
    }

    /// The same noise at other rows: its time constants stay.
    #[must_use]
    pub fn at(&self, rows: Rows) -> Self {
        let slow = self.0.slow.iter().map(|s| Slow::new(&rows.t_s, s.tau_s.clone(), s.variance.clone())).collect();
        let equal = rows.white.iter().all(|w| w[1] == w[0] && w[2] == w[0]);
        Self(Arc::new(Series { rows, equal, slow }))
    }

    /// Noise of these rows as it was found at others; `None` where a variance is none.
    #[must_use]
    pub fn known(&self, noise: &Noise) -> Option<Noise> {
        let count = self.0.rows.t_s.len();
        let of = |a: usize| self.0.whitener(&noise.parameters, a, 0..count).map(Arc::new);
        Some(Noise { whiteners: [of(0)?, of(1)?, of(2)?], series: Arc::clone(&self.0), ..noise.clone() })
    }

    /// Restricted log likelihood of noise with some parameters, up to a constant, with the white standard deviation of each component; `None` where it has none.
    fn likelihood(&self, parameters: &NoiseParameters, data: &Data) -> Option<(f64, Noise)> {
        let mut sum = 0.0;
        let mut white_std = [0.0; 3];
        let mut inside = [[0.0; 2]; 3];
        let mut whiteners: Vec<Arc<Whitener>> = Vec::with_capacity(3);
        let equal = !parameters.grows() && self.0.equal;
        for component in 0..3 {
            let whitener = match whiteners.last() {
                Some(same) if equal => Arc::clone(same),
                _ => Arc::new(self.0.whitener(parameters, component, 0..self.0.rows.t_s.len())?),
            };
            let left = fit(&whitener, &data.readings.column(component).into_owned(), &data.designs[component])?;
            let known = self.0.rows.inside.map(|i| [i.freedom * i.variance[component], i.freedom]);
            let (squares, freedom) = match known {
                Some([own, count]) if !parameters.apart => (left.squares + own, left.freedom + count),
                _ => (left.squares, left.freedom),
            };
            sum += of_squares(squares, freedom) - 0.5 * (left.log_covariance + left.log_normal);
            if let Some([own, count]) = known.filter(|_| parameters.apart) {
                sum += of_squares(own, count) - APART_RANGE.ln();
            }
            let variance = squares / freedom;
            white_std[component] = variance.sqrt();
            inside[component] = known.filter(|_| !parameters.apart).map_or([0.0; 2], |[own, count]| [own / variance, count]);
            whiteners.push(whitener);
        }
        let whiteners = whiteners.try_into().ok()?;
        sum.is_finite()
            .then_some((sum, Noise { parameters: *parameters, white_std, inside, whiteners, series: Arc::clone(&self.0) }))
    }

    /// The likelihood for the test that holds both forms together.
    #[cfg(test)]
    pub(in crate::fit::noise) fn restricted(
        &self,
        parameters: &NoiseParameters,
        readings: &DMatrix<f64>,
        designs: &[DMatrix<f64>; 3],
    ) -> f64 {
        self.likelihood(parameters, &Data { readings, designs }).map_or(f64::NAN, |(likelihood, _)| likelihood)
    }

    /// Time constants and variances of its slow noise.
    #[cfg(test)]
    pub(in crate::fit::noise) fn relaxations(&self, parameters: &NoiseParameters) -> (&[f64], &[f64]) {
        let slow = &self.0.slow[parameters.shape()];
        (&slow.tau_s, &slow.variance)
    }

    fn value(&self, parameters: &NoiseParameters, data: &Data) -> f64 {
        self.likelihood(parameters, data).map_or(f64::NEG_INFINITY, |(l, _)| l + parameters.prior())
    }

    /// The most likely of some parameters, the first of equal ones.
    fn best(&self, tried: &[NoiseParameters], data: &Data) -> (f64, NoiseParameters) {
        let values: Vec<f64> = tried.par_iter().map(|c| self.value(c, data)).collect();
        let first = (f64::NEG_INFINITY, NoiseParameters::WHITE);
        tried.iter().zip(values).fold(first, |best, (c, v)| if v > best.0 { (v, *c) } else { best })
    }

    /// The most likely parameters near others.
    fn climb(&self, mut best: (f64, NoiseParameters), data: &Data) -> (f64, NoiseParameters) {
        for factor in CLOSER {
            let now = best.1;
            let mut tried: Vec<NoiseParameters> = Vec::new();
            for f in [factor, 1.0 / factor] {
                tried.push(NoiseParameters { slow: now.slow * f, ..now });
                tried.push(NoiseParameters { white_field: now.white_field * f, ..now });
                tried.push(NoiseParameters { slow_field: now.slow_field * f, ..now });
                // More of all slow noise, or of all that grows.
                tried.push(NoiseParameters { slow: now.slow * f, slow_field: now.slow_field * f, ..now });
            }
            if now.is_slow() {
                for shape in now.neighbours() {
                    tried.extend(
                        [factor, 1.0, 1.0 / factor].map(|f| NoiseParameters { slow: now.slow * f, ..now }.with_shape(shape)),
                    );
                }
            }
            tried.retain(|c| *c != now);
            let found = self.best(&tried, data);
            if found.0 > best.0 {
                best = found;
            }
        }
        best
    }

    /// The noise that readings about a linear model allow, with the logarithm of the probability of each: slow noise of every kind and size,
    /// of the gain too, or none, and white noise that grows as in `from`, or none: what is not in the model may look like it. The last is
    /// white.
    #[must_use]
    pub fn plausible(&self, from: &NoiseParameters, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> Vec<(Noise, f64)> {
        let data = Data { readings, designs };
        let tried = self.hopeful(self.around(from), &data);
        let weigh = |tried: &[(NoiseParameters, f64)]| -> Vec<(Noise, f64)> {
            let of_one =
                |(c, prior): &(NoiseParameters, f64)| self.likelihood(c, &data).map(|(l, noise)| (noise, l + prior.ln()));
            tried.par_iter().filter_map(of_one).collect()
        };
        let best = |all: &[(Noise, f64)]| all.iter().map(|a| a.1).fold(f64::NEG_INFINITY, f64::max);
        let (gain, other): (Vec<_>, Vec<_>) = tried.into_iter().partition(|(c, _)| c.slow_field > 0.0);
        let other = weigh(&other);
        // Noise of the gain is dear. Where the readings suggest none, a part of it tells whether the rest has to be looked at.
        let (some, rest): (Vec<_>, Vec<_>) = gain.into_iter().enumerate().partition(|(k, _)| k % EVERY == 0);
        let [some, rest] = [some, rest].map(|all| all.into_iter().map(|(_, one)| one).collect::<Vec<_>>());
        let mut all = weigh(&some);
        if from.slow_field > 0.0 || best(&all) > best(&other) - HOPELESS {
            all.extend(weigh(&rest));
        }
        all.extend(other);
        let sum = log_sum(all.iter().map(|a| a.1));
        all.iter_mut().for_each(|a| a.1 -= sum);
        all
    }

    /// Noises that readings may allow beside the most likely one, with their probabilities before; the last is white.
    fn around(&self, from: &NoiseParameters) -> Vec<(NoiseParameters, f64)> {
        let mut tried: Vec<(NoiseParameters, f64)> = Vec::new();
        let of_rows =
            if self.0.rows.inside.is_some() { vec![(true, APART_PRIOR), (false, 1.0 - APART_PRIOR)] } else { vec![(false, 1.0)] };
        let [of_white, of_gain] = GROWING_PRIOR;
        let of_gain = if self.0.rows.field.iter().flatten().any(|u| *u != 0.0) { of_gain } else { 0.0 };
        let white_fields =
            if from.white_field > 0.0 { vec![(from.white_field, of_white), (0.0, 1.0 - of_white)] } else { vec![(0.0, 1.0)] };
        for (apart, p) in of_rows {
            for (white_field, q) in &white_fields {
                let white = NoiseParameters { apart, white_field: *white_field, ..NoiseParameters::WHITE };
                // Scatter apart and slow noise of the gain are both rare: of one of them nothing else is tried.
                let of_gain = if apart == from.apart { of_gain } else { 0.0 };
                let gain = if of_gain > 0.0 { slow_of_the_gain(from, white) } else { Vec::new() };
                let parts = [(gain, of_gain), (slow_of_any_size(white), 1.0 - of_gain)];
                tried.extend(
                    parts
                        .into_iter()
                        .flat_map(|(all, r)| all.into_iter().map(move |(parameters, part)| (parameters, p * q * r * part))),
                );
            }
        }
        tried
    }

    /// Of many rows, the noises that a part of the rows, evenly taken, does not rule out, and white ones: a likelihood is dear, and what a part
    /// makes hopeless all make more so. Of few rows all.
    fn hopeful(&self, tried: Vec<(NoiseParameters, f64)>, data: &Data) -> Vec<(NoiseParameters, f64)> {
        let count = self.0.rows.t_s.len();
        let every = count / PART_ROWS;
        if every < LEAST_SAVING {
            return tried;
        }
        let rows: Vec<usize> = (0..count).step_by(every).collect();
        let part = self.at(Rows {
            t_s: rows.iter().map(|i| self.0.rows.t_s[*i]).collect(),
            white: rows.iter().map(|i| self.0.rows.white[*i]).collect(),
            field: rows.iter().map(|i| self.0.rows.field[*i]).collect(),
            inside: self.0.rows.inside,
        });
        let (readings, designs) = (data.readings.select_rows(&rows), data.designs.each_ref().map(|d| d.select_rows(&rows)));
        let of_part = Data { readings: &readings, designs: &designs };
        let values: Vec<f64> = tried.par_iter().map(|(c, _)| part.value(c, &of_part)).collect();
        let best = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        // A part that is too small for the model rules nothing out.
        if !best.is_finite() {
            return tried;
        }
        let is_open = |c: &NoiseParameters, value: f64| value > best - HOPELESS_OF_A_PART || !c.is_slow();
        tried.into_iter().zip(values).filter(|((c, _), value)| is_open(c, *value)).map(|(one, _)| one).collect()
    }

    /// Noise of given parameters, its variances from residuals about a linear model.
    #[must_use]
    pub fn with_parameters(
        &self,
        parameters: NoiseParameters,
        readings: &DMatrix<f64>,
        designs: &[DMatrix<f64>; 3],
    ) -> Option<Noise> {
        self.likelihood(&parameters, &Data { readings, designs }).map(|(_, noise)| noise)
    }

    /// Logarithm of the likelihood ratio of noise to the same without its slow parts; zero where one of them is none.
    #[must_use]
    pub fn slow_over_white(&self, parameters: &NoiseParameters, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> f64 {
        let data = Data { readings, designs };
        let without = NoiseParameters { slow: 0.0, slow_field: 0.0, ..*parameters };
        let both = (self.likelihood(parameters, &data), self.likelihood(&without, &data));
        if let (Some((with, _)), Some((without, _))) = both { with - without } else { 0.0 }
    }

    /// The most likely noise of residuals about a linear model: `readings` has a column per component, `designs` the columns that were
    /// fitted to each.
    #[must_use]
    pub fn estimate(&self, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> Option<Noise> {
        let data = Data { readings, designs };
        let slow = RATIOS
            .iter()
            .flat_map(|slow| coarse_shapes().map(|s| NoiseParameters { slow: *slow, ..NoiseParameters::WHITE }.with_shape(s)));
        let mut best = self.best(&std::iter::once(NoiseParameters::WHITE).chain(slow).collect::<Vec<_>>(), &data);
        // What grows with the field, beside what does not or in its place.
        let base = best.1;
        let mut growing = Vec::new();
        for ratio in FIELD_RATIOS {
            growing.push(NoiseParameters { white_field: ratio, ..base });
            growing.push(NoiseParameters { white_field: ratio, slow: 0.0, ..base });
            growing.push(NoiseParameters { slow_field: ratio, ..base });
            growing.extend(coarse_shapes().map(|s| NoiseParameters { slow_field: ratio, slow: 0.0, ..base }.with_shape(s)));
        }
        let grown = self.best(&growing, &data);
        if grown.0 > best.0 {
            best = grown;
        }
        best = self.climb(best, &data);
        self.finished(best, &data)
    }

    /// The same near other parameters, as of a model with a term more or less: a fifth of the work, which is worth it for thousands of rows.
    #[must_use]
    pub fn estimate_near(&self, near: &NoiseParameters, readings: &DMatrix<f64>, designs: &[DMatrix<f64>; 3]) -> Option<Noise> {
        let data = Data { readings, designs };
        let mut tried = vec![NoiseParameters::WHITE, *near, NoiseParameters { slow_field: 0.0, white_field: 0.0, ..*near }];
        // A climb does not leave zero.
        let grown = [0.3, 3.0, 30.0];
        for ratio in grown {
            if near.slow == 0.0 {
                let shapes = coarse_shapes().step_by(COARSE);
                tried.extend(shapes.map(|s| NoiseParameters { slow: ratio, ..*near }.with_shape(s)));
            }
            if near.white_field == 0.0 {
                tried.push(NoiseParameters { white_field: ratio, ..*near });
            }
            if near.slow_field == 0.0 {
                tried.push(NoiseParameters { slow_field: ratio, ..*near });
            }
        }
        let best = self.climb(self.best(&tried, &data), &data);
        self.finished(best, &data)
    }

    fn finished(&self, mut best: (f64, NoiseParameters), data: &Data) -> Option<Noise> {
        if best.1.slow_field > 0.0 && best.1.slow == 0.0 {
            // A climb does not leave zero.
            let both: Vec<NoiseParameters> = RATIOS.iter().map(|slow| NoiseParameters { slow: *slow, ..best.1 }).collect();
            let found = self.best(&both, data);
            if found.0 > best.0 {
                best = self.climb(found, data);
            }
        }
        if self.0.rows.inside.is_some() {
            let apart = [best.1, NoiseParameters { slow: 0.0, ..best.1 }, NoiseParameters::WHITE]
                .map(|c| NoiseParameters { apart: true, ..c });
            let found = self.climb(self.best(&apart, data), data);
            if found.0 > best.0 {
                best = found;
            }
        }
        self.with_parameters(best.1, data.readings, data.designs)
    }
}

impl Noise {
    /// Standard deviation of every row, per component.
    #[must_use]
    pub fn std(&self) -> Vec<[f64; 3]> {
        let one = |i: usize, a: usize| self.white_std[a] * self.series.element(&self.parameters, a, i, i).sqrt();
        (0..self.rows()).map(|i| std::array::from_fn(|a| one(i, a))).collect()
    }

    /// The noise of some rows of a component by themselves; `None` where a variance is none.
    #[must_use]
    pub fn of_stretch(&self, component: usize, rows: Range<usize>) -> Option<Stretch> {
        let whitener = self.series.whitener(&self.parameters, component, rows)?;
        Some(Stretch { std: self.white_std[component], whitener })
    }
}

/// Noise of some rows that follow each other.
pub struct Stretch {
    std: f64,
    whitener: Whitener,
}

impl Stretch {
    /// Columns whitened by the covariance of these rows.
    #[must_use]
    pub fn whitened(&self, columns: &DMatrix<f64>) -> DMatrix<f64> {
        let mut white = columns.clone();
        self.whitener.whiten(&mut white);
        white / self.std
    }

    /// Standard deviation of every row where those before it are known.
    pub fn fresh_std(&self) -> impl Iterator<Item = f64> {
        self.whitener.scale.iter().map(|scale| self.std / scale)
    }
}

impl NoiseModel for Noise {
    fn rows(&self) -> usize {
        self.whiteners[0].scale.len()
    }

    fn covariance_of_rows(&self, component: usize, rows: &[usize]) -> DMatrix<f64> {
        let variance = self.white_std[component].powi(2);
        let element = |i: usize, j: usize| variance * self.series.element(&self.parameters, component, rows[i], rows[j]);
        DMatrix::from_fn(rows.len(), rows.len(), element)
    }

    fn whiten(&self, component: usize, columns: &mut DMatrix<f64>) {
        self.whiteners[component].whiten(columns);
        *columns /= self.white_std[component];
    }

    fn log_determinant(&self, component: usize) -> f64 {
        self.whiteners[component].log_covariance() + 2.0 * self.rows() as f64 * self.white_std[component].ln()
    }
}

/// Readings, and the columns that are fitted to each component.
struct Data<'a> {
    readings: &'a DMatrix<f64>,
    designs: &'a [DMatrix<f64>; 3],
}

/// Shapes that are tried first.
fn coarse_shapes() -> impl Iterator<Item = usize> {
    (0..SHAPES).step_by(COARSE)
}

/// White noise with slow noise of every shape and size, or none, which is the last; with their probabilities.
fn slow_of_any_size(white: NoiseParameters) -> Vec<(NoiseParameters, f64)> {
    let part = 0.5 / (RATIOS.len() * coarse_shapes().count()) as f64;
    let slow = RATIOS
        .iter()
        .flat_map(|slow| coarse_shapes().map(move |s| (NoiseParameters { slow: *slow, ..white }.with_shape(s), part)));
    slow.chain([(white, 0.5)]).collect()
}

/// White noise with slow noise of the gain and other slow noise of every shape, of sizes about those of other parameters if these have them; with
/// their probabilities.
fn slow_of_the_gain(from: &NoiseParameters, white: NoiseParameters) -> Vec<(NoiseParameters, f64)> {
    let gain = if from.slow_field > 0.0 { [3.0, 1.0, 0.3, 0.1].map(|f| f * from.slow_field) } else { GAIN_RATIOS };
    let other = if from.slow > 0.0 { [1.0, 0.3, 0.0].map(|f| f * from.slow) } else { [0.3, 0.1, 0.0] };
    let part = 1.0 / (gain.len() * other.len() * coarse_shapes().count()) as f64;
    let sizes = gain.iter().flat_map(|f| other.iter().map(move |s| (*f, *s)));
    let of_size = |(slow_field, slow): (f64, f64)| {
        let one = NoiseParameters { slow, slow_field, ..white };
        coarse_shapes().map(move |s| (one.with_shape(s), part))
    };
    sizes.flat_map(of_size).collect()
}

/// Logarithm of the probability of squares of a variance of which nothing is known but that its logarithm is uniform, but for powers of π.
fn of_squares(squares: f64, freedom: f64) -> f64 {
    ln_gamma(0.5 * freedom) - 0.5 * freedom * (0.5 * squares).ln() - std::f64::consts::LN_2
}

/// What a whitened fit leaves.
struct Left {
    squares: f64,
    /// Logarithms of the determinants of covariance and normal matrix.
    log_covariance: f64,
    log_normal: f64,
    freedom: f64,
}

fn fit(whitener: &Whitener, reading: &DVector<f64>, design: &DMatrix<f64>) -> Option<Left> {
    let (n, p) = design.shape();
    let mut all = DMatrix::zeros(n, p + 1);
    all.columns_mut(0, p).copy_from(design);
    all.column_mut(p).copy_from(reading);
    whitener.whiten(&mut all);
    let normal = all.columns(0, p).transpose() * all.columns(0, p);
    let cholesky = normal.cholesky()?;
    let rhs = all.columns(0, p).tr_mul(&all.column(p));
    let squares = all.column(p).norm_squared() - rhs.dot(&cholesky.solve(&rhs));
    let log_normal = 2.0 * cholesky.l_dirty().diagonal().iter().map(|d| d.ln()).sum::<f64>();
    let freedom = n.checked_sub(p).filter(|f| *f > 1)? as f64;
    (squares > 0.0).then_some(Left { squares, log_covariance: whitener.log_covariance(), log_normal, freedom })
}

#[cfg(test)]
mod tests;
