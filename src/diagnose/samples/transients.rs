//! Transients after the steps of the field: means over the phases of all settings, on top of each other.

use super::scatter::{Expected, Scatter};
use super::{Inside, SIGNIFICANT, interval_s, windows_of};
use crate::fit::NORMAL_95;
use crate::fit::statistics::{median, two_sided_tail};
use crate::model::effects::in_samples::{self, InSamples};
use crate::model::effects::{Catalogue, EffectRef};
use crate::record::prepared::{PreparedRun, Samples};
use nalgebra::{DMatrix, DVector, Matrix2, Vector2};
use rayon::prelude::*;

/// Fewest bins of a plateau, and fewest plateaus.
const LEAST_BINS: usize = 4;
const LEAST_PLATEAUS: usize = 12;
/// Rounds of an amplitude, the scatter about it, and the amplitude again.
const ROUNDS: usize = 3;
/// Chi square by which a single axis has to be better than all together: currents in a housing act on all.
const SINGLE_AXIS: f64 = 6.0;
/// Parts by which a time constant is refined.
const FINER: [f64; 5] = [0.25, 0.12, 0.06, 0.03, 0.015];
/// Steps by the slopes of amplitude and time constant after that: of a clear transient the time constant is known far better than its last part.
const BY_SLOPES: usize = 4;
/// Step of the derivative by the logarithm of a time constant.
const TAU_STEP: f64 = 0.01;
/// Time constants over which an amplitude that is not much larger than its noise is averaged: so many to either side, their logarithms this far
/// apart.
const BESIDE: i32 = 8;
const BESIDE_STEP: f64 = 0.15;

/// Time constants of a low-pass that every sensor has, in sample intervals: beside a transient that decays within one of them it cannot be told
/// from that, and says nothing of what stands around the sensor.
const OF_LOW_PASS: [f64; 3] = [0.25, 0.5, 1.0];
/// Chi square by which a transient has to be better than that of a low-pass: 95 % of those of a low-pass are not.
const SLOWER: f64 = NORMAL_95 * NORMAL_95;
/// Samples beside an edge that a low-pass can reach: a step of 100 000 times the noise, a time constant of one interval.
const MOST_BESIDE: usize = 12;
/// Samples in which a low-pass that is no longer the clearest transient falls to a part that does not matter.
const CLEAR: usize = 3;

/// Bins of one axis, plateau after plateau.
type Bins = Vec<DVector<f64>>;

/// Phases of a plateau for the stack: ends of bins in samples after its begin, closer where transients are fast.
pub fn phases(samples: usize) -> Vec<usize> {
    let mut edges = vec![0usize];
    let mut width = 1usize;
    while edges[edges.len() - 1] + width <= samples {
        let last = edges[edges.len() - 1] + width;
        edges.push(last);
        if edges.len() % 2 == 0 {
            width = (width * 3).div_ceil(2);
        }
    }
    edges
}

/// The clearest transient of all effects of a catalogue that make some.
#[must_use]
pub fn transient(
    prepared: &PreparedRun,
    samples: &Samples,
    settings: &[[f64; 2]],
    skip_s: f64,
    catalogue: &Catalogue,
) -> Option<Inside> {
    let of_effect = |effect: EffectRef| match effect.in_samples()? {
        InSamples::Transient(form) => transient_of(effect, form, prepared, samples, settings, skip_s),
        _ => None,
    };
    catalogue.iter().filter_map(of_effect).max_by(|a, b| a.strength.total_cmp(&b.strength))
}

/// What plateaus count for by their sizes: those with more noise for less.
fn weights_of(bins: &Bins) -> Vec<f64> {
    let sizes: Vec<f64> = bins.iter().map(|d| d.norm_squared()).collect();
    let usual = median(&mut sizes.clone()).max(f64::MIN_POSITIVE);
    sizes.iter().map(|s| (2.0 * usual / (usual + s)).sqrt()).collect()
}

/// A transient with its time constant, amplitude and chi square.
#[derive(Clone)]
struct Transient {
    chi_square: f64,
    tau_s: f64,
    axes: Vec<usize>,
    amplitude: f64,
    std: f64,
    /// Degrees of freedom of its standard uncertainty.
    freedom: f64,
}

/// A transient that is no noise.
struct Shown {
    transient: Transient,
    /// Probability that noise alone makes one as clear with one time constant, and the number of those that were tried.
    p_value: f64,
    trials: usize,
}

/// The plateaus on top of each other: means of the samples over bins of the time since the step, less those of the plateaus.
struct Stack<'a> {
    prepared: &'a PreparedRun,
    samples: &'a Samples,
    form: in_samples::Transient,
    interval_s: f64,
    /// Samples nearer than this to an edge do not count, s.
    beside_s: f64,
    /// First sample of each plateau.
    begins: Vec<usize>,
    /// Ends of the bins, in samples after the begin.
    edges: Vec<usize>,
    data: [Bins; 3],
    /// Settings with more noise count for less.
    weights: [Vec<f64>; 3],
    expected: Expected,
}

impl<'a> Stack<'a> {
    /// Of samples that come every `interval_s`, without those nearer than `beside_s` to an edge. `None` where there are too few plateaus.
    fn new(
        form: in_samples::Transient,
        prepared: &'a PreparedRun,
        samples: &'a Samples,
        settings: &[[f64; 2]],
        interval_s: f64,
        beside_s: f64,
    ) -> Option<Self> {
        let windows = windows_of(samples, settings, beside_s);
        let shortest = windows.iter().map(|w| w[1].saturating_sub(w[0])).min()?;
        let edges = phases(shortest);
        let bins = edges.len() - 1;
        if bins < LEAST_BINS || windows.len() < LEAST_PLATEAUS {
            return None;
        }
        let begins = windows.into_iter().map(|[begin, _]| begin).collect();
        let expected = Expected::new(&edges);
        let (data, weights) = Default::default();
        let mut stack = Self { prepared, samples, form, interval_s, beside_s, begins, edges, data, weights, expected };
        stack.data = stack.bins_of(&|[from, to]| {
            let sum = |a: usize| samples.reading_ent[from..to].iter().map(|v| v[a]).sum::<f64>();
            [0, 1, 2].map(|a| sum(a) / (to - from) as f64)
        });
        stack.weights = stack.data.each_ref().map(weights_of);
        Some(stack)
    }

    /// The same with weights of what a transient leaves, and the transient with them. Where noise adds to a transient its plateau is larger, and
    /// would count for less than one where noise takes from it: the transient would seem too small.
    fn weighed_beside(self, transient: Transient) -> (Self, Transient) {
        let template = self.template(transient.tau_s);
        let of_axis = |a: usize| {
            let amplitude = if transient.axes.contains(&a) { transient.amplitude } else { 0.0 };
            weights_of(&self.data[a].iter().zip(&template[a]).map(|(data, template)| data - template * amplitude).collect())
        };
        let weights = [0, 1, 2].map(of_axis);
        let stack = Self { weights, ..self };
        let refined = stack.of_axes(transient.tau_s, &transient.axes).and_then(|now| stack.refined(now));
        (stack, refined.unwrap_or(transient))
    }

    /// The transient with a time constant on some axes.
    fn of_axes(&self, tau_s: f64, axes: &[usize]) -> Option<Transient> {
        self.transients(tau_s).into_iter().find(|transient| transient.axes == axes)
    }

    fn bins(&self) -> usize {
        self.edges.len() - 1
    }

    /// Means over ranges of samples as bins, each less the mean of its plateau.
    fn bins_of(&self, mean_of: &(dyn Fn([usize; 2]) -> [f64; 3] + Sync)) -> [Bins; 3] {
        let bins = self.bins();
        let of_plateau = |begin: &usize| -> [DVector<f64>; 3] {
            let all = mean_of([*begin, begin + self.edges[bins]]);
            let each: Vec<[f64; 3]> = self.edges.windows(2).map(|e| mean_of([begin + e[0], begin + e[1]])).collect();
            [0, 1, 2].map(|a: usize| DVector::from_fn(bins, |k, _| each[k][a] - all[a]))
        };
        let plateaus: Vec<[DVector<f64>; 3]> = self.begins.par_iter().map(of_plateau).collect();
        let mut axes: [Bins; 3] = Default::default();
        plateaus.into_iter().for_each(|plateau| axes.iter_mut().zip(plateau).for_each(|(axis, row)| axis.push(row)));
        axes
    }

    /// What a transient of unit amplitude makes of the bins.
    fn template(&self, tau_s: f64) -> [Bins; 3] {
        self.bins_of(&|[from, to]| {
            let ends_s = [self.samples.t_s[from], self.samples.t_s[to - 1]];
            (self.form.mean)(&self.prepared.record.steps, ends_s, self.interval_s, tau_s).map(|v| -v)
        })
    }

    /// Weighted bins of some kind without the last ones, which follow from the others.
    fn weighted(&self, axis: usize, bins: &Bins) -> Bins {
        let free = self.bins() - 1;
        bins.iter().zip(&self.weights[axis]).map(|(bins, weight)| bins.rows(0, free) * *weight).collect()
    }

    /// Covariance of the weighted bins about a transient.
    fn scatter(&self, data: &Bins, template: &Bins, amplitude: f64) -> Option<Scatter> {
        let left: Bins = data.iter().zip(template).map(|(data, template)| data - template * amplitude).collect();
        self.expected.scatter(&left)
    }

    /// Amplitude of a template on one axis and its standard uncertainty, with the degrees of freedom of that.
    fn amplitude(&self, axis: usize, template: &Bins) -> Option<[f64; 3]> {
        let [data, template] = [&self.data[axis], template].map(|bins| self.weighted(axis, bins));
        let mut found = [0.0; 3];
        for _ in 0..ROUNDS {
            let scatter = self.scatter(&data, &template, found[0])?;
            let (mut top, mut bottom) = (0.0, 0.0);
            for (data, template) in data.iter().zip(&template) {
                let weighted = &scatter.inverse * template;
                top += weighted.dot(data);
                bottom += weighted.dot(template);
            }
            found = [top / bottom, bottom.sqrt().recip(), scatter.freedom];
        }
        (found[1] > 0.0 && found[1].is_finite()).then_some(found)
    }

    /// The transients with a time constant: on all axes with one amplitude, and on each axis by itself.
    fn transients(&self, tau_s: f64) -> Vec<Transient> {
        let template = self.template(tau_s);
        let known: Vec<(usize, [f64; 3])> = (0..3).filter_map(|a| Some((a, self.amplitude(a, &template[a])?))).collect();
        let weight: f64 = known.iter().map(|(_, [_, s, _])| s.powi(-2)).sum();
        let mut all = Vec::new();
        if known.len() == 3 {
            let amplitude = known.iter().map(|(_, [v, s, _])| v / (s * s)).sum::<f64>() / weight;
            let chi_square = amplitude * amplitude * weight;
            let freedom = known.iter().map(|(_, [_, _, freedom])| *freedom).fold(f64::INFINITY, f64::min);
            all.push(Transient { chi_square, tau_s, axes: vec![0, 1, 2], amplitude, std: weight.sqrt().recip(), freedom });
        }
        all.extend(known.into_iter().map(|(a, [amplitude, std, freedom])| {
            let chi_square = (amplitude / std).powi(2) - SINGLE_AXIS;
            Transient { chi_square, tau_s, axes: vec![a], amplitude, std, freedom }
        }));
        all
    }

    /// The best of time constants, beginning with one that is known: the first of those of equal chi square.
    fn best(&self, known: Option<Transient>, taus_s: &[f64]) -> Option<Transient> {
        // In the order of the time constants, whatever the threads.
        let all: Vec<Vec<Transient>> = taus_s.par_iter().map(|tau_s| self.transients(*tau_s)).collect();
        all.into_iter().flatten().fold(known, |best, next| match best {
            Some(best) if next.chi_square.partial_cmp(&best.chi_square) != Some(std::cmp::Ordering::Greater) => Some(best),
            _ => Some(next),
        })
    }

    /// A transient with the best time constant near its own.
    fn refined(&self, transient: Transient) -> Option<Transient> {
        let mut best = FINER.into_iter().try_fold(transient, |best, step| {
            let tau_s = best.tau_s;
            self.best(Some(best), &[1.0 - step, 1.0 + step].map(|factor| tau_s * factor))
        })?;
        let most = FINER[FINER.len() - 1];
        for _ in 0..BY_SLOPES {
            let Some((information, slope)) = self.information(&best) else { break };
            let Some(step) = information.try_inverse().map(|covariance| (covariance * slope)[1]) else { break };
            let Some(next) = self.of_axes(best.tau_s * step.clamp(-most, most).exp(), &best.axes) else { break };
            if next.chi_square <= best.chi_square {
                break;
            }
            best = next;
        }
        Some(best)
    }

    /// The clearest transient of the time constants, if noise makes one as clear seldom.
    fn shown(&self, taus_s: &[f64]) -> Option<Shown> {
        // A time constant is tried on all axes together and on each of them.
        let trials = 4 * taus_s.len();
        let coarse = self.best(None, taus_s)?;
        // The scatter is estimated from few plateaus, so that chi square has the tails of the t distribution: Bartlett's formula, inverted,
        // gives the value of normal noise that is as improbable.
        let freedom = coarse.freedom;
        let effective = freedom * (1.0 + coarse.chi_square.max(0.0) / freedom).ln();
        let p_value = two_sided_tail(effective.max(0.0).sqrt()).max(f64::MIN_POSITIVE);
        if p_value * trials as f64 > SIGNIFICANT {
            return None;
        }
        Some(Shown { transient: self.refined(coarse)?, p_value, trials })
    }

    /// A transient that is no noise with its uncertainties, as something of an effect.
    fn described(&self, effect: EffectRef, shown: &Shown) -> Inside {
        let found = &shown.transient;
        let wide = self.spread(found);
        let std = self.std(found).map(|[of_amplitude, of_tau]| [of_amplitude.max(wide), of_tau]);
        Inside {
            values: vec![(found.amplitude, std.map_or(found.std, |[of_amplitude, _]| of_amplitude))],
            shape_std: std.map(|[_, of_tau]| (self.form.time_constant.to_owned(), of_tau)).into_iter().collect(),
            strength: found.chi_square.max(0.0).sqrt(),
            p_value: shown.p_value,
            trials: shown.trials,
            beside_s: self.beside_s,
            ..Inside::new(effect, (self.form.term)(&found.axes, found.tau_s))
        }
    }

    /// Standard uncertainties of amplitude and time constant, which go together: from the information on both.
    fn std(&self, transient: &Transient) -> Option<[f64; 2]> {
        let (information, _) = self.information(transient)?;
        information.try_inverse().map(|c| [c[(0, 0)].sqrt(), transient.tau_s * c[(1, 1)].sqrt()])
    }

    /// Information on amplitude and the logarithm of the time constant, and the slopes of half of chi square by them.
    fn information(&self, transient: &Transient) -> Option<(Matrix2<f64>, Vector2<f64>)> {
        let Transient { tau_s, axes, amplitude, .. } = transient;
        let [now, later, sooner] = [1.0, 1.0 + TAU_STEP, 1.0 - TAU_STEP].map(|factor| self.template(tau_s * factor));
        let (mut information, mut slopes) = (Matrix2::zeros(), Vector2::zeros());
        for &a in axes {
            let [data, now, later, sooner] = [&self.data[a], &now[a], &later[a], &sooner[a]].map(|bins| self.weighted(a, bins));
            let Some(scatter) = self.scatter(&data, &now, *amplitude) else { continue };
            for (((data, now), later), sooner) in data.iter().zip(&now).zip(&later).zip(&sooner) {
                let slope = (later - sooner) * (amplitude / (2.0 * TAU_STEP));
                let both = DMatrix::from_columns(&[now.clone(), slope]);
                let weighted = both.transpose() * &scatter.inverse;
                information += (&weighted * &both).fixed_view::<2, 2>(0, 0);
                slopes += (&weighted * (data - now * *amplitude)).fixed_rows::<2>(0);
            }
        }
        (information != Matrix2::zeros()).then_some((information, slopes))
    }

    /// Standard uncertainty of the amplitude from the likelihoods of time constants far to either side: the amplitude goes with a time constant as an
    /// exponential does, and not in proportion.
    fn spread(&self, transient: &Transient) -> f64 {
        let beside = |step: i32| self.of_axes(transient.tau_s * (BESIDE_STEP * f64::from(step)).exp(), &transient.axes);
        let others: Vec<Option<Transient>> = (-BESIDE..=BESIDE).into_par_iter().map(beside).collect();
        let mut sums = [0.0; 2];
        for other in others.into_iter().flatten() {
            let weight = (0.5 * (other.chi_square - transient.chi_square)).min(0.0).exp();
            sums[0] += weight;
            sums[1] += weight * (other.std.powi(2) + (other.amplitude - transient.amplitude).powi(2));
        }
        (sums[1] / sums[0].max(f64::MIN_POSITIVE)).sqrt()
    }
}

/// Whether a transient of an effect follows the steps. The low-pass of the sensor shows in the samples beside an edge: the first never counts, and
/// more are left out as long as what they show decays as quickly as a low-pass does.
fn transient_of(
    effect: EffectRef,
    form: in_samples::Transient,
    prepared: &PreparedRun,
    samples: &Samples,
    settings: &[[f64; 2]],
    skip_s: f64,
) -> Option<Inside> {
    let interval_s = interval_s(samples)?;
    let longest = settings.iter().map(|[b, e]| e - b).fold(f64::INFINITY, f64::min);
    let of_low_pass = OF_LOW_PASS.map(|intervals| intervals * interval_s);
    let taus: Vec<f64> = of_low_pass.into_iter().chain(form.taus_s.iter().copied().filter(|t| *t < longest)).collect();
    let of = |beside_s: f64| {
        let stack = Stack::new(form, prepared, samples, settings, interval_s, beside_s)?;
        let shown = stack.shown(&taus)?;
        Some((stack, shown))
    };
    // Slower than a low-pass, and not by chance.
    let is_slow = |(stack, shown): &(Stack, Shown)| {
        let Transient { tau_s, axes, chi_square, .. } = &shown.transient;
        let low_pass = of_low_pass.iter().filter_map(|tau_s| stack.of_axes(*tau_s, axes)).map(|t| t.chi_square);
        *tau_s > interval_s && *chi_square > low_pass.fold(0.0, f64::max) + SLOWER
    };
    for more in 0..MOST_BESIDE {
        let beside_s = skip_s.max(interval_s) + more as f64 * interval_s;
        let found = of(beside_s)?;
        if is_slow(&found) {
            // What the low-pass leaves beside it makes the time constant too short.
            let (stack, shown) = of(beside_s + CLEAR as f64 * interval_s).filter(is_slow).unwrap_or(found);
            let (stack, transient) = stack.weighed_beside(shown.transient);
            return Some(stack.described(effect, &Shown { transient, ..shown }));
        }
    }
    None
}
