//! How often two effects can both be named, and nothing else: what someone names who knows the true covariance of the noise and has the
//! candidates of the diagnosis, beside the diagnosis, in the same linearity runs.

use super::ideal::{INDEPENDENT, White, looked_at};
use super::judge::{judge, prepared};
use super::kinds::generate;
use super::noise::{Family, Random};
use super::programme::Programme;
use super::score::Share;
use super::sensor::Kind;
use super::{Blind, Options, effects};
use calfit::diagnose::means::Means;
use calfit::fit::scan::{ABSORBED, Score, orthonormal};
use calfit::record::prepared::PreparedRun;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write;

/// Strengths of each of the two.
const STRENGTHS: [f64; 2] = [8.0, 15.0];
/// Part of the runs that have another programme than the usual one, as in the study.
const OTHER_PROGRAMME: f64 = 0.6;
/// Part of the null runs in which something is named.
const FALSE_ALARMS: f64 = 0.01;
/// Effects that are named at most: one more than there are shows what is wrong.
const MOST: usize = 3;
/// Times that every name is looked at again beside the others.
const ROUNDS: usize = 3;

/// The candidates of the diagnosis on the means of a run, whitened with the true covariance of the noise.
struct Known<'a> {
    means: Means<'a>,
    residual: DVector<f64>,
    /// What the run's own parameters leave of each candidate.
    left: Vec<Option<DMatrix<f64>>>,
}

/// What explains most: the effect, the logarithm of its evidence times its prior, and its best candidate.
struct Best {
    evidence: f64,
    candidate: usize,
}

impl<'a> Known<'a> {
    fn of(prepared: &'a PreparedRun, blind: &Blind) -> Option<Self> {
        let (means, cells) = looked_at(prepared, blind)?;
        let white = White::new(&blind.truth.noise, blind, prepared, &cells);
        let usable = |c: usize| means.log_priors[c].is_finite().then(|| white.left(&means.candidates[c].columns)).flatten();
        let left = (0..means.candidates.len()).map(usable).collect();
        Some(Self { residual: white.residual, left, means })
    }

    /// The best explanation beside candidates that are there already: candidates of one key are one explanation.
    fn best(&self, beside: &[usize]) -> Option<Best> {
        let columns: Vec<DVector<f64>> =
            beside.iter().filter_map(|c| self.left[*c].as_ref()).flat_map(|l| l.column_iter().map(|c| c.into_owned())).collect();
        let taken = (!columns.is_empty()).then(|| orthonormal(&DMatrix::from_columns(&columns), None, INDEPENDENT));
        let without = |of: &DMatrix<f64>| taken.as_ref().map_or_else(|| of.clone(), |q| of - q * q.tr_mul(of));
        let residual = without(&DMatrix::from_column_slice(self.residual.len(), 1, self.residual.as_slice()));
        let mut of_key: BTreeMap<&str, Vec<(f64, usize)>> = BTreeMap::new();
        for (c, left) in self.left.iter().enumerate() {
            let Some(left) = left else { continue };
            let own = without(left);
            if own.norm_squared() <= ABSORBED * ABSORBED * left.norm_squared() {
                continue;
            }
            let base = orthonormal(&own, None, INDEPENDENT);
            let score = Score::known(base.tr_mul(&residual).norm_squared(), base.ncols());
            let evidence = score.evidence + self.means.log_priors[c];
            of_key.entry(self.means.candidates[c].key.as_str()).or_default().push((evidence, c));
        }
        let explanation = |all: &Vec<(f64, usize)>| {
            let (most, candidate) = all.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0))?;
            Some(Best { evidence: most + all.iter().map(|(e, _)| (e - most).exp()).sum::<f64>().ln(), candidate })
        };
        of_key.values().filter_map(explanation).max_by(|a, b| a.evidence.total_cmp(&b.evidence))
    }

    /// Names of effects, each of at least so much evidence beside the others.
    fn names(&self, least: f64) -> BTreeSet<String> {
        let mut terms: Vec<usize> = Vec::new();
        while terms.len() < MOST {
            let Some(best) = self.best(&terms).filter(|best| best.evidence > least) else { break };
            terms.push(best.candidate);
            for _ in 0..ROUNDS {
                let before = terms.clone();
                for k in 0..terms.len() {
                    let others: Vec<usize> = terms.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, c)| *c).collect();
                    terms[k] = self.best(&others).map_or(terms[k], |best| best.candidate);
                }
                if terms == before {
                    break;
                }
            }
        }
        terms.into_iter().map(|c| self.means.candidates[c].effect.to_string()).collect()
    }
}

fn made(seed: u64, names: &[&str], strength_k: f64) -> Option<Blind> {
    let mut random = Random::new(seed, "pairs programme");
    let programme =
        if random.chance(OTHER_PROGRAMME) { Programme::ALL[random.below(Programme::ALL.len())] } else { Programme::default() };
    // Spikes are in no covariance.
    let noise = Some(Family::WITHOUT_SPIKES[random.below(Family::WITHOUT_SPIKES.len())]);
    let effects = names.iter().map(|name| (*name).to_owned()).collect();
    let blind = generate(seed, Kind::Lin, &Options { effects, strength_k, programme, noise, ..Options::default() }).ok()?;
    let is_seen = |e: &super::TrueEffect| e.identifiable && !e.seen_inside_plateaus && !e.natural_size;
    blind.truth.effects.iter().all(is_seen).then_some(blind)
}

/// Two different effects that a linearity run can show.
fn drawn(seed: u64) -> [&'static str; 2] {
    let mut random = Random::new(seed, "pairs");
    let names = effects::visible(Kind::Lin);
    let first = names[random.below(names.len())];
    loop {
        let second = names[random.below(names.len())];
        if second != first {
            return [first, second];
        }
    }
}

/// What is named in a run: by the one who knows, and by the diagnosis.
fn named(blind: &Blind, least: f64) -> Option<[BTreeSet<String>; 2]> {
    let prepared = prepared(blind)?;
    let known = Known::of(&prepared, blind)?.names(least);
    let said = judge(blind).steps;
    Some([known, said.into_iter().map(|s| s.effect).collect()])
}

/// Evidence that one in a hundred null runs exceeds for the one who knows.
fn least(first: u64, runs: u64) -> f64 {
    let of = |seed: u64| {
        let blind = made(seed, &[], 0.0)?;
        let prepared = prepared(&blind)?;
        Some(Known::of(&prepared, &blind)?.best(&[])?.evidence)
    };
    let mut all: Vec<f64> = (first..first + runs).into_par_iter().filter_map(of).collect();
    all.sort_by(f64::total_cmp);
    let place = (all.len() as f64 * (1.0 - FALSE_ALARMS)) as usize;
    all.get(place.min(all.len().saturating_sub(1))).copied().unwrap_or(f64::INFINITY)
}

/// A table of how often both of two effects are named, and nothing else, of `runs` pairs of each strength, beside how often one of the same
/// strength is found.
pub fn table(first: u64, runs: u64) -> String {
    let least = least(first, 2 * runs);
    let mut text = format!(
        "Named from a logarithm of the evidence of {least:.1} on, which {:.0} % of {} null runs exceed.\n\n| k | pairs | both exact by the one who knows the noise | one found by him | ratio to its square | both exact in the diagnosis | one found in it | ratio to its square |\n|---|---|---|---|---|---|---|---|\n",
        100.0 * FALSE_ALARMS,
        2 * runs
    );
    for k in STRENGTHS {
        let of = |seed: u64| {
            let names = drawn(seed);
            let (pair, one) = (made(seed, &names, k)?, made(seed, &names[..1], k)?);
            let hidden: BTreeSet<String> = pair.truth.effects.iter().map(|e| e.effect.clone()).collect();
            let exact = named(&pair, least)?.map(|names| names == hidden);
            Some((exact, named(&one, least)?.map(|names| !names.is_empty())))
        };
        let all: Vec<([bool; 2], [bool; 2])> = (first..first + runs).into_par_iter().filter_map(of).collect();
        let _ = write!(text, "| {k} | {} |", all.len());
        for who in [0, 1] {
            let (mut both, mut one) = (Share::default(), Share::default());
            all.iter().for_each(|(exact, found)| {
                both.add(exact[who]);
                one.add(found[who]);
            });
            let ratio = both.percent() / 100.0 / (one.percent() / 100.0).powi(2);
            let _ = write!(text, " {:.0} % | {:.0} % | {ratio:.2} |", both.percent(), one.percent());
        }
        text.push('\n');
    }
    text
}
