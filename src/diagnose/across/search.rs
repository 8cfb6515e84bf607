//! Finds what is wrong between runs, one effect after the other.

use super::LEAST_AGREEING;
use super::candidates::ORIENTATION;
use super::scene::{Candidate, Scene, count, numbered};
use crate::fit::scan::{ABSORBED, Fitted, Group};

/// A candidate is taken if noise alone gives as much evidence less often than this.
const SIGNIFICANT: f64 = 0.003;
/// Below this evidence noise alone gives as much in one case of a few.
const HOPELESS: f64 = 2.0;
/// Most effects.
const MOST_STEPS: usize = 6;
/// A term gives way to another one whose evidence is larger by this much.
const SWAP: f64 = 1.0;
const SEED: u64 = 0x0ca1_ac05;

/// Evidence of all candidates of one key.
pub struct Explanation {
    pub key: String,
    pub evidence: f64,
    pub best: usize,
    pub best_evidence: f64,
}

pub struct Search<'a> {
    pub scene: Scene<'a>,
    pub bank: Vec<Candidate>,
    pub vetoed: Vec<usize>,
}

impl Search<'_> {
    fn prior(&self, index: usize) -> f64 {
        let same = self.bank.iter().filter(|c| c.explains_as(&self.bank[index])).count() as f64;
        (self.bank[index].effect.prior(None) / same).ln()
    }

    /// A term that leaves too few orientations to compare is no candidate.
    fn is_open(&self, index: usize, terms: &[&Candidate]) -> bool {
        let candidate = &self.bank[index];
        if self.vetoed.contains(&index) || terms.iter().any(|t| t.explains_as(candidate) && t.spec == candidate.spec) {
            return false;
        }
        let alone = |t: &Candidate| t.covariate == Some(ORIENTATION);
        !alone(candidate) || count(&self.scene.orientation) > LEAST_AGREEING + terms.iter().filter(|t| alone(t)).count()
    }

    pub fn explanations(&self, fitted: &Fitted, groups: &[Group], terms: &[&Candidate]) -> Vec<Explanation> {
        let keys = numbered(self.bank.iter().map(Candidate::key));
        let mut all: Vec<Explanation> = (0..count(&keys))
            .filter_map(|key| {
                let own: Vec<(usize, f64)> = (0..self.bank.len())
                    .filter(|i| keys[*i] == key && self.is_open(*i, terms) && groups[*i].surviving > ABSORBED)
                    .map(|i| (i, fitted.score(&groups[i]).evidence + self.prior(i)))
                    .filter(|(_, e)| e.is_finite())
                    .collect();
                let (best, best_evidence) = own.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
                let evidence = best_evidence + own.iter().map(|(_, e)| (e - best_evidence).exp()).sum::<f64>().ln();
                Some(Explanation { key: self.bank[best].key(), evidence, best, best_evidence })
            })
            .collect();
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        all
    }

    pub fn groups(&self, fitted: &Fitted) -> Vec<Group> {
        self.bank.iter().map(|c| self.scene.group(fitted, c)).collect()
    }

    pub fn classes(candidates: &[&Candidate], n: usize) -> [bool; 3] {
        std::array::from_fn(|c| candidates.iter().any(|t| t.columns.rows(c * 3 * n, 3 * n).norm() > 0.0))
    }

    /// The terms with probability that noise alone gives as much, and how many were tried.
    pub fn run(&mut self) -> Vec<(Candidate, f64, usize)> {
        let mut terms: Vec<(Candidate, f64, usize)> = Vec::new();
        for _ in 0..3 * MOST_STEPS {
            if terms.len() >= MOST_STEPS {
                break;
            }
            let now: Vec<&Candidate> = terms.iter().map(|t| &t.0).collect();
            let fitted = self.scene.fitted(&now);
            if fitted.freedom().iter().sum::<f64>() < 2.0 {
                break;
            }
            let groups = self.groups(&fitted);
            let explanations = self.explanations(&fitted, &groups, &now);
            let most = explanations.iter().map(|e| e.best_evidence).fold(f64::NEG_INFINITY, f64::max);
            let Some(best) = explanations.first().filter(|_| most > HOPELESS) else { break };
            let usable: Vec<usize> = (0..groups.len())
                .filter(|i| self.is_open(*i, &now) && groups[*i].surviving > ABSORBED && groups[*i].count() > 0)
                .collect();
            let tried: Vec<&Group> = usable.iter().map(|i| &groups[*i]).collect();
            let priors: Vec<f64> = usable.iter().map(|i| self.prior(*i)).collect();
            let p_global = fitted.simulate(&tried, &priors, SEED).global_p(most);
            if p_global > SIGNIFICANT {
                break;
            }
            let (index, candidate) = (best.best, self.bank[best.best].clone());
            let mut with = now.clone();
            with.push(&candidate);
            let scales = self.scene.scales(&self.scene.fitted(&with));
            let classes = Self::classes(&[&candidate], self.scene.count());
            let sum = |terms: &[&Candidate]| self.scene.gap(&self.scene.held_out(terms, &scales), &scales, &with, classes).1;
            if sum(&with) >= sum(&now) {
                // It does not predict what it has not seen.
                self.vetoed.push(index);
                continue;
            }
            let number = usable.len();
            terms.push((candidate, p_global, number));
            self.merge(&mut terms);
            self.repair(&mut terms);
        }
        terms
    }

    /// One term on all axes in place of two of one effect on different axes.
    fn merge(&self, terms: &mut Vec<(Candidate, f64, usize)>) {
        let Some(last) = terms.last().cloned() else { return };
        let earlier = terms.len() - 1;
        let joins = |t: &Candidate| {
            !t.effect.is_unknown()
                && t.explains_as(&last.0)
                && t.spec.form == last.0.spec.form
                && t.spec.shape == last.0.spec.shape
        };
        if let Some(index) = terms[..earlier].iter().position(|t| joins(&t.0))
            && let Some(all) = self.bank.iter().find(|c| joins(c) && c.spec.axes.len() == 3)
        {
            terms[index].0 = all.clone();
            terms.pop();
        }
    }

    /// Drops what the others made superfluous, and swaps what something else explains better.
    fn repair(&self, terms: &mut Vec<(Candidate, f64, usize)>) {
        let mut index = 0;
        while index < terms.len() && terms.len() > 1 {
            let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, t)| &t.0).collect();
            let fitted = self.scene.fitted(&others);
            let groups = self.groups(&fitted);
            let explanations = self.explanations(&fitted, &groups, &others);
            let own = explanations.iter().find(|e| e.key == terms[index].0.key()).map_or(f64::NEG_INFINITY, |e| e.evidence);
            let own = own.max(fitted.score(&self.scene.group(&fitted, &terms[index].0)).evidence - 3.0);
            let better =
                explanations.first().filter(|b| b.evidence > own + SWAP && b.key != terms[index].0.key()).map(|b| b.best);
            if own < 0.0 {
                terms.remove(index);
                continue;
            }
            if let Some(better) = better {
                terms[index].0 = self.bank[better].clone();
            }
            index += 1;
        }
    }
}
