//! Plateau means as a problem of the search.

use super::{MANY_ROWS, Means, MeansModel, Term, describe, with_shape};
use crate::data::units::Scale;
use crate::diagnose::candidate::{self, Candidate, Threshold};
use crate::diagnose::explanations::{Explanation, SHARE, Scored};
use crate::diagnose::problem::{Description, Problem, Revision};
use crate::fit::noise::state_space::Noise;
use crate::fit::scalar::{self, Stop};
use crate::fit::scan::{ABSORBED, Group, Score};
use crate::fit::statistics::log_sum;
use crate::model::effects::Spec;
use rayon::prelude::*;

/// Evidence (logarithm) that a term needs beyond what simulated noise gives, since the noise that the readings allow gives more than the
/// noise that they suggest; as in reports/blind-study.md.
const NOISE_UNKNOWN: f64 = 1.1;
/// Explanations beside which a second effect is looked for where none stands out alone; as in reports/blind-study.md.
const HIDDEN: usize = 3;
/// How probable noise that forgets is without fields, over what it is with them.
const FORGETS: f64 = 0.1;
/// Explanations whose evidence is averaged over the noise; as in reports/blind-study.md.
const PROMISING: usize = 5;
/// Evidence (logarithm) by which two effects of the catalogue have to exceed a function that is in no catalogue, beside which they are
/// many: a likelihood ratio of e.
const BESIDE_UNKNOWN: f64 = 1.0;
/// The plain squares of the predictions may grow by this factor, which is 5 % of their root, where the weighted ones become less.
const PLAIN_GROWTH: f64 = 1.1;
/// Logarithm of what a noise adds to an evidence that has no influence on it.
const NEGLIGIBLE: f64 = -15.0;
/// Noises over which the evidence of many rows is averaged.
const MOST_NOISES: usize = 16;
/// Seed of the simulated noise.
const SEED: u64 = 0x0ca1_f175;
/// Where the search for the best value of a shape parameter ends, as a part of the value, and after how many steps.
const SHAPE_PART: f64 = 1e-3;
const SHAPE_STEPS: u64 = 24;

/// What stands out beside chosen terms.
struct Look {
    /// Explanations with averaged evidence, the best first.
    averaged: Vec<Explanation>,
    /// The best of them, if it is no noise.
    evident: Option<Term>,
    /// The noise that the readings allow, with the logarithm of the probability of each; the last is white.
    noises: Vec<(Noise, f64)>,
    /// The model with white noise, and the candidates beside it.
    white: Option<(MeansModel, Vec<Group>)>,
}

impl Problem for Means<'_> {
    type Term = Term;
    type Fit = MeansModel;

    /// One false alarm in a hundred runs: the target of reports/blind-study.md.
    const FALSE_ALARM: f64 = 0.01;
    /// As in reports/blind-study.md. More would fit the noise of a hundred means.
    const MOST_TERMS: usize = 6;
    /// As many rounds may rule something out.
    const MOST_ROUNDS: usize = 2 * Self::MOST_TERMS;
    /// Two terms that change places would do so for ever; as in reports/blind-study.md.
    const MOST_REVISIONS: usize = 3;

    fn fitted(&self, chosen: &[Term]) -> Option<MeansModel> {
        self.model(&self.all(chosen))
    }

    fn evident(&self, model: &MeansModel, chosen: &[Term]) -> Option<Vec<Term>> {
        let now = self.all(chosen);
        let look = self.look(model, &now);
        let Look { averaged, evident, noises, white } = look;
        let pair = |(white, groups): (MeansModel, Vec<Group>), than: f64| self.pair(&noises, &white, groups, &now, than);
        let found = match evident {
            // A smooth function of one covariate stands in for two effects that nearly follow it.
            Some(one) if one.candidate.effect.is_unknown() => {
                let than = averaged
                    .first()
                    .map_or(0.0, |best| best.score.evidence_of_any_size() + best.beside_noise() - best.score.evidence);
                Some(white.and_then(|white| pair(white, than)).map_or_else(|| vec![one], Vec::from))
            }
            Some(one) => Some(vec![one]),
            None => {
                let claimed = &model.noise.parameters;
                let is_slow = claimed.slow + claimed.slow_field > 0.0;
                let hidden = self.hidden(&averaged, model, &now);
                let white = white.filter(|_| hidden.is_none() && is_slow);
                hidden.or_else(|| white.and_then(|white| pair(white, f64::NEG_INFINITY))).map(Vec::from)
            }
        };
        Some(found.unwrap_or_default())
    }

    /// With the noise that is left with the further terms.
    fn predicts(&self, chosen: &[Term], further: &[Term]) -> Option<bool> {
        let now = self.all(chosen);
        let with: Vec<&Candidate> = now.iter().copied().chain(further.iter().map(|t| &t.candidate)).collect();
        let noise = self.estimated(&with)?;
        Some(self.predicted(&noise, &with).sum < self.predicted(&noise, &now).sum)
    }

    /// In the final model and with its noise: a term goes if the weighted squares of the predictions grow by it, or their plain ones by more
    /// than noise makes of a weight. The last one goes if the first ones alone predict better than all.
    fn unconfirmed(&self, model: &MeansModel, chosen: &[Term]) -> Option<Option<usize>> {
        let all = self.all(chosen);
        let of_all = self.predicted(&model.noise, &all);
        let is_worse = |others: &[&Candidate]| {
            let held = self.predicted(&model.noise, others);
            let grows = held.sum < of_all.sum || held.plain_nt2() * PLAIN_GROWTH < of_all.plain_nt2();
            grows.then_some(held.sum)
        };
        let first = self.given.len();
        let without = |index: usize| Some((index, is_worse(&candidate::without(&all, &[first + index]))?));
        let worst = (0..chosen.len()).filter_map(without).min_by(|a, b| a.1.total_cmp(&b.1)).map(|(index, _)| index);
        let is_superfluous = |count: usize| self.predicted(&model.noise, &all[..first + count]).sum < of_all.sum;
        Some(worst.or_else(|| (0..chosen.len().saturating_sub(1)).any(is_superfluous).then(|| chosen.len() - 1)))
    }

    /// The whole form: its other axes and shapes are alike.
    fn rule_out(&mut self, term: &Term) {
        let Candidate { key, spec, .. } = &term.candidate;
        for (is_out, candidate) in self.ruled_out.iter_mut().zip(&self.candidates) {
            *is_out |= candidate.key == *key && candidate.spec.form == spec.form;
        }
    }

    fn belong_together(&self, earlier: &Term, last: &Term) -> bool {
        earlier.candidate.is_same_form(&last.candidate)
    }

    /// On the axes of both.
    fn merged(&self, earlier: &Term, last: &Term) -> Option<Term> {
        let (earlier_axes, last) = (&earlier.candidate.spec.axes, &last.candidate);
        let mut axes = [earlier_axes.clone(), last.spec.axes.clone()].concat();
        axes.sort_unstable();
        axes.dedup();
        if axes == *earlier_axes {
            return None;
        }
        let spec = Spec { axes, ..last.spec.clone() };
        let columns = last.effect.columns(&self.prepared.record, &spec)?;
        Some(Term { candidate: Candidate::of_readings(last.effect, spec, columns), ..earlier.clone() })
    }

    /// In flight, where the field of the spacecraft is slow noise.
    fn looks_again_at_one(&self) -> bool {
        self.prepared.record.scale == Scale::Calibrated
    }

    /// Beside all other terms, with the noise that is left with all of them.
    fn revised(&self, chosen: &mut [Term], index: usize) -> Option<Revision<Term>> {
        let all = self.all(chosen);
        let at = self.given.len() + index;
        let others = candidate::without(&all, &[at]);
        let noise = self.estimated(&all)?;
        let model = self.model_with(noise, &others);
        let scored = self.scored(&model);
        let own = all[at];
        let score = model.fitted.score(&self.group(&model, own));
        let is_new = |c: &Candidate| chosen.iter().all(|t| t.candidate.key != c.key);
        let candidate = match scored.revised(&own.key, &score) {
            Revision::Drop => return Some(Revision::Drop),
            Revision::Swap(better) if is_new(&self.candidates[better]) => {
                let candidate = self.refined(&model, &self.candidates[better]);
                return Some(Revision::Swap(Term { candidate, ..chosen[index].clone() }));
            }
            _ => self.refined(&model, own),
        };
        chosen[index].candidate = candidate;
        Some(Revision::Keep)
    }

    fn describe(&self, model: &MeansModel, chosen: &[Term], index: usize, number: usize) -> Description {
        describe::describe(self, model, chosen, index, number)
    }
}

/// Noises with their probabilities where a sensor alone makes them: its noise has a power density, and one that forgets after a few rows, which makes of
/// weak 1/f noise a drift, is rarer there than among the noises of a run.
fn of_a_sensor(mut noises: Vec<(Noise, f64)>) -> Vec<(Noise, f64)> {
    for (noise, log_probability) in &mut noises {
        if noise.parameters.memory_rows > 0.0 {
            *log_probability += FORGETS.ln();
        }
    }
    let sum = log_sum(noises.iter().map(|n| n.1));
    noises.iter_mut().for_each(|n| n.1 -= sum);
    noises
}

impl Means<'_> {
    /// What stands out beside a model.
    fn look(&self, model: &MeansModel, now: &[&Candidate]) -> Look {
        let scored = self.scored(model);
        let noises = self.correlations.plausible(&model.noise.parameters, &self.readings, &self.designs(now));
        let noises = if self.is_of_sensor_alone() { of_a_sensor(noises) } else { noises };
        let white = noises.last().map(|(white, _)| self.model_with(white.clone(), now));
        let white_scored = white.as_ref().map(|white| self.scored(white));
        let averaged = self.averaged(&scored, white.as_ref().zip(white_scored.as_ref()), &noises, (now, model));
        let groups = white_scored.map(|scored| scored.groups);
        // Whether anything is there is told by what is likeliest beside noise, and what it is by what is likeliest among effects.
        let most = averaged.iter().map(Explanation::beside_noise).max_by(f64::total_cmp);
        let evident = averaged.first().zip(most.filter(|most| *most > NOISE_UNKNOWN)).and_then(|(best, most)| {
            let evident = scored.evident(most - NOISE_UNKNOWN, Self::FALSE_ALARM, SEED)?;
            Some(Term {
                candidate: self.refined(model, &self.candidates[best.best]),
                p_global: evident.p_global,
                trials: evident.trials,
                threshold: Threshold::Part(best.score.part_for(evident.margin + best.lost)),
            })
        });
        Look { averaged, evident, noises, white: white.zip(groups) }
    }

    /// Whether neither coils nor a spacecraft make the field.
    fn is_of_sensor_alone(&self) -> bool {
        !self.prepared.record.has_fields() && self.prepared.record.scale != Scale::Calibrated
    }

    /// Two effects that are noise to each other: each stands out beside the other one alone.
    fn hidden(&self, averaged: &[Explanation], model: &MeansModel, now: &[&Candidate]) -> Option<[Term; 2]> {
        let beside = |c: &Candidate| {
            let with: Vec<&Candidate> = now.iter().copied().chain([c]).collect();
            self.look(&self.model(&with)?, &with).evident
        };
        averaged.iter().filter(|e| e.beside_noise() > 0.0).take(HIDDEN).find_map(|e| {
            let second = beside(&self.refined(model, &self.candidates[e.best]))?;
            let first = beside(&second.candidate).filter(|first| first.candidate.key == e.key)?;
            Some([first, second])
        })
    }

    /// Two effects that slow noise, or noise of the gain, stands in for as long as one of them is missing: the best pair, its evidence averaged
    /// over the noise that the readings allow. Its evidence has to exceed another one by that of a trial.
    fn pair(
        &self,
        noises: &[(Noise, f64)],
        white: &MeansModel,
        groups: Vec<Group>,
        now: &[&Candidate],
        than: f64,
    ) -> Option<[Term; 2]> {
        let scored = self.scored_with(white, groups);
        let is_tried = |i: &usize| {
            let candidate = &self.candidates[*i];
            !candidate.effect.is_unknown() && self.is_searched(*i) && now.iter().all(|c| c.key != candidate.key)
        };
        let open: Vec<usize> = (0..self.candidates.len()).filter(is_tried).collect();
        let prior: f64 = open.iter().map(|i| self.log_priors[*i].exp()).sum();
        // There are half as many pairs of effects as the square of the effects, and each may stand beside any other.
        let beside_single = (0.5 * prior).ln().max(0.0) + NOISE_UNKNOWN;
        let tried = self.best_of_each(white, &scored.groups, &open);
        let pairs = tried.iter().enumerate().flat_map(|(k, i)| tried[k + 1..].iter().map(move |j| [*i, *j]));
        // Two curves of one family stand for any curve; an unknown one is better called unknown.
        let family = |i: usize| self.candidates[i].effect.about().family;
        let is_pair = |[i, j]: &[usize; 2]| {
            self.candidates[*i].key != self.candidates[*j].key && (than == f64::NEG_INFINITY || family(*i) != family(*j))
        };
        let pairs: Vec<[usize; 2]> = pairs.filter(is_pair).collect();
        let log_prior = |pair: &[usize; 2]| pair.iter().map(|i| self.log_priors[*i]).sum::<f64>();
        let beside_white = |pair: &[usize; 2]| {
            let group = white.fitted.both(&scored.groups[pair[0]], &scored.groups[pair[1]]);
            if group.surviving > ABSORBED {
                white.fitted.score(&group).evidence_of_any_size() + log_prior(pair)
            } else {
                f64::NEG_INFINITY
            }
        };
        let mut ranked: Vec<(f64, [usize; 2])> = pairs.par_iter().map(|pair| (beside_white(pair), *pair)).collect();
        ranked.sort_by(|a, b| b.0.total_cmp(&a.0));
        ranked.truncate(PROMISING);
        // White noise is one of those over which is averaged, and the one that gives a pair the most.
        ranked.retain(|(evidence, _)| *evidence > beside_single);
        if ranked.is_empty() {
            return None;
        }
        let most = ranked[0].0 - log_prior(&ranked[0].1);
        let noises = self.of_influence(noises, most);
        let scores: Vec<Vec<Score>> = noises
            .par_iter()
            .map(|(noise, _)| {
                let model = self.model_with(noise.clone(), now);
                let score = |[i, j]: [usize; 2]| {
                    let [first, second] = [i, j].map(|i| self.group(&model, &self.candidates[i]));
                    model.fitted.score(&model.fitted.both(&first, &second))
                };
                ranked.iter().map(|(_, pair)| score(*pair)).collect()
            })
            .collect();
        let evidence =
            |k: usize| log_sum(noises.iter().zip(&scores).map(|((_, weight), scores)| weight + scores[k].evidence_of_any_size()));
        let averaged = ranked.iter().enumerate().map(|(k, (_, pair))| (evidence(k) + log_prior(pair), k));
        let (evidence, k) = averaged
            .max_by(|a, b| a.0.total_cmp(&b.0))
            .filter(|(evidence, _)| *evidence > beside_single.max(than + BESIDE_UNKNOWN))?;
        let evident = scored.evident(evidence - beside_single, Self::FALSE_ALARM, SEED)?;
        let most = (0..noises.len()).max_by(|a, b| {
            let of = |n: usize| noises[n].1 + scores[n][k].evidence_of_any_size();
            of(*a).total_cmp(&of(*b))
        })?;
        let lost = scores[most][k].evidence_of_any_size() + log_prior(&ranked[k].1) - evidence;
        let part = scores[most][k].part_for(evident.margin + lost.max(0.0));
        Some(ranked[k].1.map(|i| Term {
            candidate: self.refined(white, &self.candidates[i]),
            p_global: evident.p_global,
            trials: open.len() * (open.len() - 1) / 2,
            threshold: Threshold::Part(part),
        }))
    }

    /// The noises that have an influence on an evidence of this size; of many rows, which tell their noise well, the most probable ones and
    /// white noise.
    fn of_influence<'n>(&self, noises: &'n [(Noise, f64)], most: f64) -> Vec<&'n (Noise, f64)> {
        let mut all: Vec<&(Noise, f64)> = noises.iter().filter(|(_, weight)| weight + most > NEGLIGIBLE).collect();
        if self.prepared.readings.nrows() > MANY_ROWS && all.len() > MOST_NOISES {
            let white = all.pop();
            all.sort_by(|a, b| b.1.total_cmp(&a.1));
            all.truncate(MOST_NOISES);
            all.extend(white);
        }
        all
    }

    /// Of every form of every effect the candidate of the largest evidence, and that of the largest one on all axes.
    fn best_of_each(&self, model: &MeansModel, groups: &[Group], open: &[usize]) -> Vec<usize> {
        let mut best: Vec<(f64, usize, bool)> = Vec::new();
        for &i in open.iter().filter(|i| groups[**i].surviving > ABSORBED) {
            let candidate = &self.candidates[i];
            let evidence = model.fitted.score(&groups[i]).evidence + self.log_priors[i];
            let is_same =
                |j: usize| self.candidates[j].key == candidate.key && self.candidates[j].spec.form == candidate.spec.form;
            for on_all in [false, true].into_iter().filter(|on_all| !on_all || candidate.spec.axes.len() == 3) {
                match best.iter_mut().find(|b| b.2 == on_all && is_same(b.1)) {
                    Some(known) if known.0 < evidence => (known.0, known.1) = (evidence, i),
                    Some(_) => {}
                    None => best.push((evidence, i, on_all)),
                }
            }
        }
        let mut tried: Vec<usize> = best.into_iter().map(|b| b.1).collect();
        tried.sort_unstable();
        tried.dedup();
        tried
    }

    /// The most promising explanations, their evidence averaged over the noise that the readings allow; the best first.
    ///
    /// A shape of the grid is that of an effect to half a step only: of a large one so much is left that slow noise would explain it better. What
    /// the best shape gives beyond those that a search for it costs counts as well.
    fn averaged(
        &self,
        scored: &Scored,
        white: Option<(&MeansModel, &Scored)>,
        noises: &[(Noise, f64)],
        (now, model): (&[&Candidate], &MeansModel),
    ) -> Vec<Explanation> {
        let mut chosen: Vec<Explanation> = scored.explanations.iter().take(PROMISING).cloned().collect();
        // What slow noise hides shows beside white noise.
        for e in white.into_iter().flat_map(|(_, white)| white.explanations.iter().take(PROMISING)) {
            if !chosen.iter().any(|c| c.best == e.best) {
                chosen.push(e.clone());
            }
        }
        let most = chosen.iter().map(|e| e.score.evidence).fold(0.0, f64::max);
        let noises = self.of_influence(noises, most);
        // The sharpest look at a shape is that beside white noise.
        let sharpest = white.map_or(model, |(white, _)| white);
        let refined: Vec<Option<Candidate>> = chosen
            .par_iter()
            .map(|e| Some(self.refined(sharpest, &self.candidates[e.best])).filter(|r| r.spec != self.candidates[e.best].spec))
            .collect();
        let scores: Vec<Vec<(Score, Option<Score>)>> = noises
            .par_iter()
            .map(|(noise, _)| {
                let model = self.model_with(noise.clone(), now);
                let score = |candidate: &Candidate| model.fitted.score(&self.group(&model, candidate));
                let of_both = |(e, refined): (&Explanation, &Option<Candidate>)| {
                    (score(&self.candidates[e.best]), refined.as_ref().map(score))
                };
                chosen.iter().zip(&refined).map(of_both).collect()
            })
            .collect();
        for (k, e) in chosen.iter_mut().enumerate() {
            let (mut of_grid, mut of_shape) = (Vec::new(), Vec::new());
            for ((_, weight), scores) in noises.iter().zip(&scores) {
                let weighed = |score: Score| (weight + score.evidence, score);
                of_grid.push(weighed(scores[k].0));
                of_shape.extend(scores[k].1.map(weighed));
            }
            let [average, with_shape] = [&of_grid, &of_shape].map(|all| log_sum(all.iter().map(|(evidence, _)| *evidence)));
            // All candidates of the explanation gain as its best one does.
            let grid = e.evidence + average - e.score.evidence;
            let shape = with_shape - SHARE + self.log_priors[e.best] + e.favour;
            let (evidence, average, all) = if shape > grid { (shape, with_shape, of_shape) } else { (grid, average, of_grid) };
            e.evidence = evidence;
            e.score = all.into_iter().max_by(|a, b| a.0.total_cmp(&b.0)).map_or(e.score, |(_, score)| score);
            e.lost = (e.score.evidence - average).max(0.0);
        }
        chosen.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let mut keys: Vec<String> = Vec::new();
        chosen.retain(|e| !keys.contains(&e.key) && (keys.push(e.key.clone()), true).1);
        chosen
    }

    /// A candidate with the best value of its continuous shape parameter.
    pub(super) fn refined(&self, model: &MeansModel, candidate: &Candidate) -> Candidate {
        let Some((name, value)) = candidate.effect.continuous(&candidate.spec) else { return candidate.clone() };
        let record = &self.prepared.record;
        let evaluate = |v: f64| -> Option<f64> {
            let other = with_shape(candidate, record, name, v)?;
            Some(model.fitted.score(&self.group(model, &other)).evidence)
        };
        let [low, high] = candidate.effect.shape_range(record, &candidate.spec, name, value);
        let cost = |v| -evaluate(v).unwrap_or(f64::NEG_INFINITY).max(-1e6);
        let stop = Stop { relative: SHAPE_PART, absolute: 1e-6 * value.abs().max(1e-9), steps: SHAPE_STEPS };
        let found = scalar::minimum(cost, [low, high], stop);
        let better = found.filter(|v| evaluate(*v) > evaluate(value));
        better.and_then(|v| with_shape(candidate, record, name, v)).unwrap_or_else(|| candidate.clone())
    }
}
