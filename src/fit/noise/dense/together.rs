//! What several runs show of their noise together.
//!
//! Fifty to a hundred rows tell the noise of a run to some 15 %. Where every run is weighed and believed by its own estimate, runs that look
//! quiet by chance weigh most, and a polynomial through six of them states an uncertainty that is a tenth too small. Runs of one sensor in one
//! mode at one facility have the same electronics and the same source, so that their noise is of one kind as far as they show nothing else. How
//! frequent every kind of noise is among the runs is estimated from all of them (the nonparametric maximum likelihood of a mixing distribution,
//! Laird 1978, by a limited number of steps of expectation and maximisation, which keeps it as wide as the runs differ), and takes
//! the place of the prior. A run that is noisier than the others says so by its own likelihood: part of the prior stays that of any run.

use super::super::NoiseParameters;
use std::collections::BTreeMap;

/// Part of the prior that stays what it is for a run of which nothing else is known.
const OWN: f64 = 0.05;
/// Steps of expectation and maximisation. The distribution narrows about as the root of twice their number: runs whose noise is the same
/// then know it to about a third of what each knows by itself.
const STEPS: usize = 30;
/// Kinds less probable are left out.
const NO_KIND: f64 = 1e-4;

/// Where slow noise comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Origin {
    /// The samples carry it.
    Samples,
    /// It is between the rows alone, as a drift.
    Rows,
    /// The gain has it.
    Gain,
}

/// Noise of rows in units of the white noise of their samples, which is the same thing in all runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseKind {
    /// Where slow noise comes from.
    pub origin: Origin,
    /// Its parameters, in units of the white variance that the samples of a row of mean weight let expect.
    pub parameters: NoiseParameters,
}

impl NoiseKind {
    fn key(&self) -> (Origin, [u64; 4]) {
        let NoiseParameters { exponent, white, white_field, .. } = self.parameters;
        (self.origin, [exponent, self.parameters.all_slow(), white, white_field].map(f64::to_bits))
    }
}

/// A kind of noise that a run was asked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Candidate {
    /// The kind.
    pub kind: NoiseKind,
    /// Its prior probability in a run of which nothing else is known.
    pub prior: f64,
    /// Minus twice its log likelihood, over the lowest of the run.
    pub deviance: f64,
}

/// How probable every kind of noise is in a component of a run of a group.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Pooled {
    probabilities: BTreeMap<(Origin, [u64; 4]), (NoiseKind, f64)>,
}

impl Pooled {
    /// Of kinds and their probabilities.
    #[must_use]
    pub fn of(list: impl IntoIterator<Item = (NoiseKind, f64)>) -> Self {
        Self { probabilities: list.into_iter().map(|(kind, p)| (kind.key(), (kind, p))).collect() }
    }

    /// The kinds with their probabilities, in an order of their own.
    pub fn kinds(&self) -> impl Iterator<Item = (NoiseKind, f64)> + '_ {
        self.probabilities.values().copied()
    }

    /// Prior probability of what a run of the group is asked for.
    pub(super) fn prior(&self, candidate: &Candidate) -> f64 {
        let shown = self.probabilities.get(&candidate.kind.key()).map_or(0.0, |(_, probability)| *probability);
        believed(candidate.prior, shown)
    }

    /// What runs show together that were asked alike.
    fn shown_by(runs: &[&[Candidate]]) -> Self {
        let mut kinds = BTreeMap::new();
        for candidate in runs.iter().copied().flatten() {
            kinds.insert(candidate.kind.key(), (candidate.kind, candidate.prior));
        }
        // Every kind by its number: a step takes each candidate of each run.
        let keys: Vec<_> = kinds.keys().copied().collect();
        let numbered: Vec<Vec<(usize, f64, f64)>> = runs
            .iter()
            .map(|run| {
                run.iter()
                    .filter_map(|c| Some((keys.binary_search(&c.kind.key()).ok()?, c.prior, (-0.5 * c.deviance).exp())))
                    .collect()
            })
            .collect();
        let sum: f64 = kinds.values().map(|(_, prior)| prior).sum();
        let mut shown: Vec<f64> = kinds.values().map(|(_, prior)| prior / sum).collect();
        for _ in 0..STEPS {
            let mut next = vec![0.0; shown.len()];
            for run in &numbered {
                let weight = |&(kind, prior, likelihood): &(usize, f64, f64)| believed(prior, shown[kind]) * likelihood;
                let sum: f64 = run.iter().map(weight).sum();
                for candidate in run {
                    next[candidate.0] += weight(candidate) / sum / runs.len() as f64;
                }
            }
            shown = next;
        }
        let mut probabilities: BTreeMap<_, _> = kinds
            .into_iter()
            .zip(shown)
            .map(|((key, (kind, _)), p)| (key, (kind, p)))
            .filter(|(_, (_, p))| *p > NO_KIND)
            .collect();
        let sum: f64 = probabilities.values().map(|(_, p)| p).sum();
        probabilities.values_mut().for_each(|(_, p)| *p /= sum);
        Self { probabilities }
    }
}

/// Prior probability of a kind in a run of a group: that of any run, and what the runs show.
fn believed(prior: f64, shown: f64) -> f64 {
    OWN * prior + (1.0 - OWN) * shown
}

/// The noise of the runs of a group, per right-hand side of their fits.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GroupNoise {
    /// One entry per right-hand side.
    pub components: Vec<Pooled>,
}

impl GroupNoise {
    /// What runs show together, each with what was tried per right-hand side; `None` for fewer than two runs.
    #[must_use]
    pub fn shown_by(runs: &[&[Vec<Candidate>]]) -> Option<Self> {
        let count = runs.iter().map(|run| run.len()).min().filter(|_| runs.len() > 1)?;
        let component = |a: usize| Pooled::shown_by(&runs.iter().map(|run| run[a].as_slice()).collect::<Vec<_>>());
        Some(Self { components: (0..count).map(component).collect() })
    }
}

#[cfg(test)]
mod tests {
    use super::super::{DenseNoise, Octave, Sampled, estimate_with};
    use super::*;
    use crate::fit::random::Random;
    use crate::fit::{Design, Limits, Solution, solve};
    use nalgebra::DMatrix;

    const ROWS: usize = 40;
    const SAMPLES: usize = 32;

    /// A run whose rows scatter by so much beside their samples of unit variance, of which a third is 1/f noise.
    struct Run {
        solution: Solution,
        intervals: Vec<[f64; 2]>,
        octaves: Vec<Octave>,
    }

    impl Run {
        fn of(between: f64, random: &mut Random) -> Self {
            let slow = random.flicker(ROWS * SAMPLES);
            let scatter: Vec<f64> = (0..ROWS).map(|_| between * random.gaussian()).collect();
            let value = |(i, s): (usize, &f64)| 0.7f64.sqrt() * random.gaussian() + 0.3f64.sqrt() * s + scatter[i / SAMPLES];
            let samples: Vec<f64> = slow.iter().enumerate().map(value).collect();
            let mean = |from: usize, length: usize| samples[from..from + length].iter().sum::<f64>() / length as f64;
            let columns = DMatrix::from_fn(ROWS, 2, |i, j| if j == 0 { [1.0, -1.0][i % 2] } else { 1.0 });
            let design = Design::new(vec!["quick".to_owned(), "mean".to_owned()], columns).unwrap();
            let rhs = DMatrix::from_fn(ROWS, 1, |i, _| mean(SAMPLES * i, SAMPLES));
            let octave = |length: usize| {
                let starts = (0..ROWS * SAMPLES).step_by(2 * length);
                let squares = starts.map(|k| (mean(k, length) - mean(k + length, length)).powi(2)).sum();
                let count = (ROWS * SAMPLES / (2 * length)) as f64;
                Octave { length: length as f64, count, white: 2.0 / length as f64, squares: vec![squares] }
            };
            Self {
                solution: solve(&design, &rhs, None, &Limits::default()).unwrap(),
                intervals: (0..ROWS).map(|i| [(SAMPLES * i) as f64, (SAMPLES * (i + 1)) as f64]).collect(),
                octaves: [4, 8, 16].into_iter().map(octave).collect(),
            }
        }

        fn noise(&self, group: Option<&GroupNoise>) -> DenseNoise {
            let (intervals, octaves) = (&self.intervals, &self.octaves);
            let counts = [SAMPLES as f64; ROWS];
            estimate_with(&self.solution, &Sampled { intervals, counts: &counts, octaves, scatter: None, group }).unwrap()
        }

        /// Standard deviation of the column that changes sign from row to row.
        fn std(&self, group: Option<&GroupNoise>) -> f64 {
            self.noise(group).covariance()[(0, 0)].sqrt()
        }
    }

    fn together(runs: &[Run]) -> GroupNoise {
        let noises: Vec<DenseNoise> = runs.iter().map(|run| run.noise(None)).collect();
        GroupNoise::shown_by(&noises.iter().map(|n| n.tried().unwrap()).collect::<Vec<_>>()).unwrap()
    }

    /// Scatter of logarithms, and their mean.
    fn scatter(values: &[f64]) -> [f64; 2] {
        let logs: Vec<f64> = values.iter().map(|v| v.ln()).collect();
        let mean = logs.iter().sum::<f64>() / logs.len() as f64;
        [(logs.iter().map(|l| (l - mean).powi(2)).sum::<f64>() / (logs.len() - 1) as f64).sqrt(), mean]
    }

    #[test]
    fn runs_with_one_noise_state_one_uncertainty() {
        let mut random = Random(88_172_645_463_325_252);
        let (mut alone, mut with, mut errors) = (Vec::new(), Vec::new(), Vec::new());
        for _ in 0..8 {
            let runs: Vec<Run> = (0..8).map(|_| Run::of(0.45, &mut random)).collect();
            let group = together(&runs);
            alone.extend(runs.iter().map(|run| run.std(None)));
            with.extend(runs.iter().map(|run| run.std(Some(&group))));
            errors.extend(runs.iter().map(|run| run.solution.coefficients[(0, 0)]));
        }
        let ([alone, _], [with, mean]) = (scatter(&alone), scatter(&with));
        // Eight groups differ by what eight runs tell: a third of what one tells.
        assert!(with < 0.6 * alone, "{with} {alone}");
        // 64 errors tell their standard deviation to 9 %.
        let real = (errors.iter().map(|e| e * e).sum::<f64>() / errors.len() as f64).sqrt();
        assert!((0.73..1.27).contains(&(mean.exp() / real)), "{} {real}", mean.exp());
    }

    #[test]
    fn a_run_that_is_noisier_than_its_group_says_so() {
        let mut random = Random(7_046_029_254_386_353_131);
        for _ in 0..4 {
            let mut runs: Vec<Run> = (0..7).map(|_| Run::of(0.2, &mut random)).collect();
            runs.push(Run::of(1.0, &mut random));
            let group = together(&runs);
            let (alone, with) = (runs[7].std(None), runs[7].std(Some(&group)));
            assert!((0.85..1.15).contains(&(with / alone)), "{with} {alone}");
        }
    }

    #[test]
    fn one_run_makes_no_group() {
        let mut random = Random(88_172_645_463_325_252);
        let noise = Run::of(0.0, &mut random).noise(None);
        assert_eq!(GroupNoise::shown_by(&[noise.tried().unwrap()]), None);
    }
}
