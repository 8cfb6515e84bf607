//! How often two effects can both be named, and nothing else: what someone names who has the candidates of the diagnosis and knows the true
//! covariance of the noise, beside the diagnosis in the same runs.

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
use calfit::fit::statistics::log_sum;
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

/// The candidates of the diagnosis on the means of a run, whitened with a covariance of the noise.
struct Known<'a> {
    means: &'a Means<'a>,
    residual: DVector<f64>,
    /// What the run's own parameters leave of each candidate.
    left: Vec<Option<DMatrix<f64>>>,
}

/// A candidate and the logarithm of its evidence times its prior.
type Weighed = (f64, usize);

impl<'a> Known<'a> {
    fn of(means: &'a Means<'a>, white: White) -> Self {
        let usable = |c: usize| means.log_priors[c].is_finite().then(|| white.left(&means.candidates[c].columns)).flatten();
        let left = (0..means.candidates.len()).map(usable).collect();
        Self { residual: white.residual, left, means }
    }

    /// The best explanation beside candidates that are there already, by its best candidate: candidates of one key are one explanation.
    fn best(&self, beside: &[usize]) -> Option<Weighed> {
        let columns: Vec<DVector<f64>> =
            beside.iter().filter_map(|c| self.left[*c].as_ref()).flat_map(|l| l.column_iter().map(|c| c.into_owned())).collect();
        let taken = (!columns.is_empty()).then(|| orthonormal(&DMatrix::from_columns(&columns), None, INDEPENDENT));
        let without = |of: &DMatrix<f64>| taken.as_ref().map_or_else(|| of.clone(), |q| of - q * q.tr_mul(of));
        let residual = without(&DMatrix::from_column_slice(self.residual.len(), 1, self.residual.as_slice()));
        let mut of_key: BTreeMap<&str, Vec<Weighed>> = BTreeMap::new();
        for (c, left) in self.left.iter().enumerate() {
            let Some(left) = left else { continue };
            let own = without(left);
            if own.norm_squared() <= ABSORBED * ABSORBED * left.norm_squared() {
                continue;
            }
            let base = orthonormal(&own, None, INDEPENDENT);
            let score = Score::known(base.tr_mul(&residual).norm_squared(), base.ncols());
            of_key.entry(self.means.candidates[c].key.as_str()).or_default().push((score.evidence + self.means.log_priors[c], c));
        }
        let explanation = |all: Vec<Weighed>| {
            let (_, best) = all.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0))?;
            Some((log_sum(all.iter().map(|(evidence, _)| *evidence)), best))
        };
        of_key.into_values().filter_map(explanation).max_by(|a, b| a.0.total_cmp(&b.0))
    }

    /// Names of effects, each of at least so much evidence beside the others.
    fn names(&self, least: f64) -> BTreeSet<String> {
        let mut terms: Vec<usize> = Vec::new();
        while terms.len() < MOST {
            let Some((_, best)) = self.best(&terms).filter(|(evidence, _)| *evidence > least) else { break };
            terms.push(best);
            for _ in 0..ROUNDS {
                let before = terms.clone();
                for k in 0..terms.len() {
                    let others: Vec<usize> = terms.iter().enumerate().filter(|(i, _)| *i != k).map(|(_, c)| *c).collect();
                    terms[k] = self.best(&others).map_or(terms[k], |(_, best)| best);
                }
                if terms == before {
                    break;
                }
            }
        }
        terms.into_iter().map(|c| self.means.candidates[c].effect.to_string()).collect()
    }
}

fn made(kind: Kind, seed: u64, names: &[&str], strength_k: f64) -> Option<Blind> {
    let mut random = Random::new(seed, "pairs programme");
    let is_other = random.chance(OTHER_PROGRAMME) && kind == Kind::Lin;
    let programme = if is_other { Programme::ALL[random.below(Programme::ALL.len())] } else { Programme::default() };
    // Spikes are in no covariance.
    let noise = Some(Family::WITHOUT_SPIKES[random.below(Family::WITHOUT_SPIKES.len())]);
    let effects = names.iter().map(|name| (*name).to_owned()).collect();
    let blind = generate(seed, kind, &Options { effects, strength_k, programme, noise, ..Options::default() }).ok()?;
    let is_seen = |e: &super::TrueEffect| e.identifiable && !e.seen_inside_plateaus && !e.natural_size;
    blind.truth.effects.iter().all(is_seen).then_some(blind)
}

/// Two different effects that such a run can show.
fn drawn(kind: Kind, seed: u64) -> [&'static str; 2] {
    let mut random = Random::new(seed, "pairs");
    let names = effects::visible(kind);
    let first = names[random.below(names.len())];
    loop {
        let second = names[random.below(names.len())];
        if second != first {
            return [first, second];
        }
    }
}

/// Evidence that one in a hundred null runs exceeds for the one who knows.
fn least(kind: Kind, first: u64, runs: u64) -> f64 {
    let of = |seed: u64| known(&made(kind, seed, &[], 0.0)?, |known| known.best(&[]).map(|(evidence, _)| evidence))?;
    let mut all: Vec<f64> = (first..first + runs).into_par_iter().filter_map(of).collect();
    all.sort_by(f64::total_cmp);
    let place = (all.len() as f64 * (1.0 - FALSE_ALARMS)) as usize;
    all.get(place.min(all.len().saturating_sub(1))).copied().unwrap_or(f64::INFINITY)
}

/// What the one who knows sees in a run.
fn known<T>(blind: &Blind, of: impl FnOnce(&Known) -> T) -> Option<T> {
    let prepared = prepared(blind)?;
    let (means, cells) = looked_at(&prepared, blind)?;
    Some(of(&Known::of(&means, White::new(&blind.truth.noise, blind, &prepared, &cells))))
}

/// Who names effects, in words of the table.
const WHO: [&str; 2] = ["knows the noise", "the diagnosis"];

/// What is named in a run: by the one who knows, and by the diagnosis.
fn named(blind: &Blind, least: f64) -> Option<[BTreeSet<String>; 2]> {
    let by_known = known(blind, |known| known.names(least))?;
    Some([by_known, judge(blind).steps.into_iter().map(|s| s.effect).collect()])
}

/// What one of them made of runs of one strength.
#[derive(Default)]
struct Named {
    both: Share,
    one: Share,
    wrong: usize,
    runs: usize,
}

impl Named {
    fn add(&mut self, names: &BTreeSet<String>, hidden: &BTreeSet<String>) {
        let is_exact = names == hidden;
        if hidden.len() == 1 {
            self.one.add(!names.is_empty())
        } else {
            self.both.add(is_exact)
        }
        self.wrong += names.difference(hidden).count();
        self.runs += 1;
    }
}

/// A table of how often both of two effects are named, and nothing else, of `runs` pairs of each strength, beside how often one of the same
/// strength is found.
pub fn table(kind: Kind, first: u64, runs: u64) -> String {
    let least = least(kind, first, 2 * runs);
    let mut text = format!(
        "Runs of kind {}. Who knows the noise names from a logarithm of the evidence of {least:.1} on, which {:.0} % of {} null runs exceed.\n\n| k | pairs | who | both exact | one found | ratio to its square | wrong terms per run |\n|---|---|---|---|---|---|---|\n",
        kind.name(),
        100.0 * FALSE_ALARMS,
        2 * runs
    );
    for k in STRENGTHS {
        let of = |seed: u64| {
            let names = drawn(kind, seed);
            let look = |names: &[&str]| {
                let blind = made(kind, seed, names, k)?;
                let hidden: BTreeSet<String> = blind.truth.effects.iter().map(|e| e.effect.clone()).collect();
                Some((named(&blind, least)?, hidden))
            };
            Some([look(&names)?, look(&names[..1])?])
        };
        let all: Vec<([BTreeSet<String>; 2], BTreeSet<String>)> =
            (first..first + runs).into_par_iter().filter_map(of).flatten_iter().collect();
        for (who, words) in WHO.iter().enumerate() {
            let mut named = Named::default();
            all.iter().for_each(|(names, hidden)| named.add(&names[who], hidden));
            let [both, one] = [named.both, named.one].map(Share::percent);
            let ratio = both / 100.0 / (one / 100.0).powi(2);
            let wrong = named.wrong as f64 / named.runs.max(1) as f64;
            let _ = writeln!(text, "| {k} | {} | {words} | {both:.0} % | {one:.0} % | {ratio:.2} | {wrong:.3} |", named.both.of);
        }
    }
    text
}
