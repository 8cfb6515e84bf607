//! Which noise residuals and samples allow together, and how probable each is.

use super::super::NoiseParameters;
use super::super::spectrum::parts;
use super::kernel::contrast_variance;
use super::likelihood::{Estimate, Likelihood};
use super::together::{Candidate, NoiseKind, Origin, Pooled};
use super::{ComponentNoise, Octave};

/// Exponents of the power density of slow noise; the first is tried before all others.
pub(super) const EXPONENTS: [f64; 4] = [1.0, 0.5, 1.5, 2.0];
/// Prior probability of each where there is slow noise.
const PRIOR_EXPONENTS: [f64; 4] = [0.94, 0.02, 0.0395, 0.0005];
/// Probability of 1/f noise from which the other exponents are tried too: more than the residuals of white noise leave of its prior.
const SUSPECTED: f64 = 0.1;
/// Prior probability that the samples carry white noise alone.
const PRIOR_NONE: f64 = 0.9;
/// Smallest and largest ratio of slow to white noise in a row, and how many in between: less cannot be told from none, more is slow noise
/// alone.
const LEAST_RATIO: f64 = 1.0;
const MOST_RATIO: f64 = 1e5;
const RATIOS: usize = 29;
/// Contrasts of 1/f noise are not quite independent: they count as this part of their number.
const INDEPENDENT: f64 = 0.8;
/// Prior probability of steep noise between the rows that what is inside them does not show, as with drifts, and its variances over the
/// white one.
const PRIOR_APART: f64 = 0.0001;
const APART_EXPONENT: f64 = 2.0;
const APART_SIZES: [f64; 11] = [3.0, 10.0, 30.0, 1e2, 3e2, 1e3, 3e3, 1e4, 3e4, 1e5, 1e6];
/// Prior probability that rows scatter by more than their samples let expect, as where a field is set anew for every row, and the range
/// of the factors.
const PRIOR_EXCESS: f64 = 0.5;
const LEAST_EXCESS: f64 = 1.26;
const MOST_EXCESS: f64 = 1e5;
const EXCESSES: usize = 26;
/// The same for less scatter: noise that is not white between the samples, a tone for example, averages out in a row.
const PRIOR_LACK: f64 = 0.02;
const LACKS: [f64; 4] = [0.6, 0.3, 0.1, 0.01];
/// Prior odds of scatter between the rows that grows with the reading, by each of some sizes, against scatter that does not, and these sizes: its variances at the largest reading over
/// that without. A source is specified by a part of its setting; with these odds errors of gains are 0.92 of what is stated where the scatter does
/// not grow, and 1.27 where it grows by so little that a run of 37 settings cannot tell it: larger odds make the first smaller and the second
/// nearer to one (`reports/coverage.md`, "Sources that scatter").
const PRIOR_GROWTH: f64 = 1.0 / 12.0;
pub(super) const GROWTHS: [f64; 9] = [1.0, 3.0, 10.0, 30.0, 100.0, 1e3, 1e4, 1e5, 1e6];
/// Prior probability of slow noise of the gain.
const PRIOR_GAIN: f64 = 0.01;
/// Deviance beyond the lowest of what the contrasts rule out.
const IMPROBABLE: f64 = 25.0;
/// Places less probable are left out.
const NO_PLACE: f64 = 1e-4;

/// A white and a slow variance of a row of mean weight, and how probable they are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Place {
    pub probability: f64,
    pub white: f64,
    pub slow: f64,
    /// Where only residuals tell the noise, the variance of such a row if all noise is independent from row to row, otherwise 0.
    pub alone: f64,
    /// The shape of the slow noise: an exponent, by index into [`EXPONENTS`], or one of the gain after them.
    pub shape: usize,
    /// How the white noise differs between the rows: as the samples do, or one of [`GROWTHS`] besides.
    pub growth: Option<usize>,
    /// What it is in units of the samples of any run.
    pub kind: NoiseKind,
}

impl Place {
    /// Whether the noise grows with the reading.
    pub fn grows(&self) -> bool {
        self.kind.parameters.grows()
    }
}

/// Contrasts of one length beside a row of mean weight: their variances for white noise and for slow noise of each exponent that gives
/// such a row unit variance.
pub(super) struct Inside {
    count: f64,
    white: f64,
    slow: [f64; EXPONENTS.len()],
}

impl Inside {
    /// `units`: factors which give a row of mean weight unit variance, per exponent.
    pub fn of(octave: &Octave, inverse_samples: f64, time_constants: &[f64], units: [f64; EXPONENTS.len()]) -> Self {
        Inside {
            count: INDEPENDENT * octave.count,
            white: octave.white / inverse_samples,
            slow: std::array::from_fn(|e| {
                units[e] * contrast_variance(octave.length, time_constants, &parts(time_constants, EXPONENTS[e]))
            }),
        }
    }
}

/// What the contrasts say: white variance of a row by its samples, slow variance, prior times likelihood.
#[derive(Clone, Copy)]
struct Told {
    sampled: f64,
    slow: f64,
    /// Slow variance over the white one by the samples.
    ratio: f64,
    deviance: f64,
    prior: f64,
}

/// Averages over the noise of one right-hand side.
pub(super) struct Average<'a> {
    inside: &'a [Inside],
    mean_squares: Vec<f64>,
    excesses: Vec<(f64, f64)>,
    /// Lowest deviance of the contrasts, and with the residuals.
    lowest_inside: f64,
    lowest: f64,
    places: Vec<(Place, Candidate)>,
    /// The excess near which the likelihood was largest.
    likely: usize,
    /// What other runs show, if they are known.
    pooled: Option<&'a Pooled>,
}

impl<'a> Average<'a> {
    pub fn new(inside: &'a [Inside], mean_squares: Vec<f64>, pooled: Option<&'a Pooled>) -> Self {
        let excesses = excesses();
        let likely = excesses.iter().position(|(factor, _)| *factor == 1.0).unwrap_or_default();
        let (lowest_inside, lowest) = (f64::INFINITY, f64::INFINITY);
        Self { inside, mean_squares, excesses, lowest_inside, lowest, places: Vec::new(), likely, pooled }
    }

    /// The white noise of the samples, profiled, and the deviance of the contrasts for a ratio of slow to white noise.
    fn told(&self, shape: usize, (ratio, prior): (f64, f64)) -> Told {
        let total: f64 = self.inside.iter().map(|o| o.count).sum();
        let (mut sampled, mut deviance) = (0.0, 0.0);
        for (octave, square) in self.inside.iter().zip(&self.mean_squares) {
            let unit = octave.white + ratio * octave.slow[shape];
            sampled += octave.count * square / unit / total;
            deviance += octave.count * unit.ln();
        }
        Told { sampled, slow: ratio * sampled, ratio, deviance: deviance + total * sampled.ln(), prior }
    }

    /// Tries white noise and slow noise of an exponent with given residuals.
    pub fn try_shape(&mut self, shape: usize, likelihood: Likelihood) {
        let mut told: Vec<Told> = ratios()
            .map(|(ratio, prior)| self.told(shape, (ratio, prior * (1.0 - PRIOR_NONE) * PRIOR_EXPONENTS[shape])))
            .collect();
        let none = self.told(shape, (0.0, PRIOR_NONE));
        if shape == 0 {
            told.push(none);
        }
        if EXPONENTS[shape] == APART_EXPONENT {
            let prior = PRIOR_APART / APART_SIZES.len() as f64;
            // What is inside the rows is explained as well as it can be.
            let deviance = self.lowest_inside;
            told.extend(APART_SIZES.map(|ratio| Told { slow: ratio * none.sampled, ratio, prior, deviance, ..none }));
        }
        let apart = told.len() - if EXPONENTS[shape] == APART_EXPONENT { APART_SIZES.len() } else { 0 };
        self.lowest_inside = told.iter().map(|t| t.deviance).fold(self.lowest_inside, f64::min);
        let most = self.lowest_inside + IMPROBABLE;
        for (k, t) in told.into_iter().enumerate().filter(|(_, t)| t.deviance < most) {
            let origin = if k < apart { Origin::Samples } else { Origin::Rows };
            self.try_whites(t, likelihood, origin, shape, None);
        }
    }

    /// Tries scatter between the rows that grows with the reading, alone or beside 1/f noise as well.
    pub fn try_growth(&mut self, (growth, is_slow): (usize, bool), likelihood: Likelihood, offset: f64) {
        let mut all = vec![self.told(0, (0.0, PRIOR_NONE))];
        if is_slow {
            all.extend(ratios().map(|(ratio, prior)| self.told(0, (ratio, prior * (1.0 - PRIOR_NONE)))));
        }
        all.retain(|t| t.deviance < self.lowest_inside + IMPROBABLE);
        for t in all {
            let t = Told { prior: t.prior * PRIOR_GROWTH, deviance: t.deviance + offset, ..t };
            self.try_whites(t, likelihood, Origin::Samples, 0, Some(growth));
        }
    }

    /// Tries slow noise of the gain; slow noise besides is part of the scatter between the rows there.
    pub fn try_gain(&mut self, shape: usize, likelihood: Likelihood) {
        let none = self.told(0, (0.0, PRIOR_NONE));
        let prior = PRIOR_GAIN / APART_SIZES.len() as f64;
        for ratio in APART_SIZES {
            let told = Told { slow: ratio * none.sampled, ratio, prior, deviance: self.lowest_inside, ..none };
            self.try_whites(told, likelihood, Origin::Gain, shape, None);
        }
    }

    /// The likelihood has one maximum in the white variance: outwards from the last one until it has become small.
    fn try_whites(&mut self, told: Told, likelihood: Likelihood, origin: Origin, shape: usize, growth: Option<usize>) {
        let exponent = EXPONENTS.get(shape).copied().unwrap_or(EXPONENTS[0]);
        let mut try_out = |k: usize| {
            let (excess, prior) = self.excesses[k];
            let white = excess * told.sampled;
            let deviance = likelihood.absolute(white, told.slow) + told.deviance;
            let parameters = NoiseParameters {
                exponent,
                white: excess,
                slow: if origin == Origin::Gain { 0.0 } else { told.ratio },
                slow_field: if origin == Origin::Gain { told.ratio } else { 0.0 },
                white_field: growth.map_or(0.0, |g| GROWTHS[g]),
                apart: excess != 1.0,
                ..NoiseParameters::WHITE
            };
            let kind = NoiseKind { origin, parameters };
            let candidate = Candidate { kind, prior: told.prior * prior, deviance };
            let probability = self.pooled.map_or(candidate.prior, |pooled| pooled.prior(&candidate));
            self.places.push((Place { probability, white, slow: told.slow, alone: 0.0, shape, growth, kind }, candidate));
            deviance
        };
        let mut here = (try_out(self.likely), self.likely);
        for (mut k, up) in [(self.likely, true), (self.likely, false)] {
            let mut last = here.0;
            while let Some(next) = if up { Some(k + 1).filter(|n| *n < self.excesses.len()) } else { k.checked_sub(1) } {
                k = next;
                let deviance = try_out(k);
                if deviance < here.0 {
                    here = (deviance, k);
                }
                if deviance > last && deviance > self.lowest.min(here.0) + IMPROBABLE {
                    break;
                }
                last = deviance;
            }
        }
        (self.lowest, self.likely) = (self.lowest.min(here.0), here.1);
    }

    fn weight(&self, (place, candidate): &(Place, Candidate)) -> f64 {
        place.probability * (0.5 * (self.lowest - candidate.deviance)).exp()
    }

    /// Whether slow noise is probable enough that its exponent matters.
    pub fn suspects_slow_noise(&self) -> bool {
        let sum: f64 = self.places.iter().map(|p| self.weight(p)).sum();
        let slow: f64 = self.places.iter().filter(|(p, _)| p.slow > 0.0).map(|p| self.weight(p)).sum();
        slow > SUSPECTED * sum
    }

    /// The places that are left, with their probabilities, the noise of a row of mean weight, and what was tried.
    pub fn finish(self) -> (ComponentNoise, Vec<Place>, Vec<Candidate>) {
        let mut places: Vec<Place> = self.places.iter().map(|p| Place { probability: self.weight(p), ..p.0 }).collect();
        let sum: f64 = places.iter().map(|p| p.probability).sum();
        places.retain(|p| p.probability > NO_PLACE * sum);
        let sum: f64 = places.iter().map(|p| p.probability).sum();
        places.iter_mut().for_each(|p| p.probability /= sum);
        let [white, slow] = totals(&places);
        let best = places.iter().max_by(|a, b| a.probability.total_cmp(&b.probability));
        let (v, s) = best.map_or((white, slow), |p| (p.white, p.slow));
        let noise = ComponentNoise {
            std: (white + slow).sqrt(),
            share: slow / (white + slow),
            most_likely_std: (v + s).sqrt(),
            most_likely_share: s / (v + s),
            independent_rows: f64::NAN,
        };
        let mut tried: Vec<Candidate> = self.places.into_iter().map(|(_, candidate)| candidate).collect();
        tried.retain(|candidate| candidate.deviance < self.lowest + IMPROBABLE);
        tried.iter_mut().for_each(|candidate| candidate.deviance -= self.lowest);
        (noise, places, tried)
    }
}

/// The same where only residuals tell the noise: without growth, and with those of [`GROWTHS`] that were tried.
pub(super) fn of_residuals(found: &[(Option<usize>, Estimate)]) -> (ComponentNoise, Vec<Place>) {
    let lowest = found.iter().map(|(_, e)| e.deviance).fold(f64::INFINITY, f64::min);
    let weight = |(growth, e): &(Option<usize>, Estimate)| {
        let prior = growth.map_or(1.0, |_| PRIOR_GROWTH);
        // Residuals that are all zero have no likelihood.
        prior * if e.noise.std > 0.0 { (0.5 * (lowest - e.deviance)).exp() } else { 1.0 }
    };
    let sum: f64 = found.iter().map(weight).sum();
    let place = |entry: &(Option<usize>, Estimate)| {
        let (growth, Estimate { noise, alone, .. }) = entry;
        let variance = noise.std * noise.std;
        let white_field = growth.map_or(0.0, |g| GROWTHS[g]);
        Place {
            probability: weight(entry) / sum,
            white: variance * (1.0 - noise.share),
            slow: variance * noise.share,
            alone: *alone,
            shape: 0,
            growth: *growth,
            kind: NoiseKind { origin: Origin::Rows, parameters: NoiseParameters { white_field, ..NoiseParameters::WHITE } },
        }
    };
    let places: Vec<Place> = found.iter().map(place).collect();
    let best = found.iter().max_by(|a, b| weight(a).total_cmp(&weight(b)));
    let most_likely = best.map_or(found[0].1.noise, |(_, e)| e.noise);
    let [white, slow] = totals(&places);
    let std = (white + slow).sqrt();
    (ComponentNoise { std, share: if std > 0.0 { slow / (white + slow) } else { 0.0 }, ..most_likely }, places)
}

/// White and slow variance of a row of mean weight, averaged.
fn totals(places: &[Place]) -> [f64; 2] {
    let mean = |of: fn(&Place) -> f64| places.iter().map(|p| p.probability * of(p)).sum();
    [mean(|p| p.white), mean(|p| p.slow)]
}

/// Ratios of slow noise to white noise of the samples in a row: every order of magnitude is as likely.
fn ratios() -> impl Iterator<Item = (f64, f64)> {
    spread([LEAST_RATIO, MOST_RATIO], RATIOS)
}

/// White variance of rows over what their samples let expect, ascending, with prior probabilities: equal, or scatter between the rows
/// besides.
fn excesses() -> Vec<(f64, f64)> {
    let mut list = vec![(1.0, 1.0 - PRIOR_EXCESS - PRIOR_LACK)];
    list.extend(spread([LEAST_EXCESS, MOST_EXCESS], EXCESSES).map(|(factor, prior)| (factor, PRIOR_EXCESS * prior)));
    list.extend(LACKS.map(|factor| (factor, PRIOR_LACK / LACKS.len() as f64)));
    list.sort_by(|a, b| a.0.total_cmp(&b.0));
    list
}

/// Values in equal ratios with equal probabilities.
fn spread([least, most]: [f64; 2], count: usize) -> impl Iterator<Item = (f64, f64)> {
    let step = (most / least).powf(1.0 / (count - 1) as f64);
    (0..count).map(move |k| (least * step.powi(k as i32), 1.0 / count as f64))
}
