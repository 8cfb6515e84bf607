//! The search: score every candidate, pay for the trials, add the best, refit everything, drop and swap, until nothing is left.

use crate::fit::noise::NoiseModel;
use crate::fit::noise::state_space::{Colour, Correlations, Noise, Rows};
use crate::fit::scalar::{self, Stop};
use crate::fit::scan::{ABSORBED, Fitted, Group, Score, orthonormal};
use crate::model::effects::offset_drift::{self, OffsetDrift};
use crate::model::effects::{self, Catalogue, Column, Covariate, EffectRef, Record, Spec, UNKNOWN, Unseen};
use crate::record::scene::Scene;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;

/// Probability with which noise alone may give as much evidence as a candidate needs.
const FALSE_ALARM: f64 = 0.01;
/// Evidence (logarithm) that it needs beyond that, since the noise that the readings allow gives more than the noise that they suggest.
const NOISE_UNKNOWN: f64 = 1.1;
/// Explanations beside which a second effect is looked for where none stands out alone.
const HIDDEN: usize = 3;
/// Explanations whose evidence is averaged.
const PROMISING: usize = 5;
/// Logarithm of the probability of noise that has no influence on an average.
const NEGLIGIBLE: f64 = -7.0;
/// Most effects of one run.
const MOST_STEPS: usize = 6;
/// A term gives way to another one whose evidence is larger by this much.
const SWAP: f64 = 1.0;
/// Seed of the simulated noise.
const SEED: u64 = 0x0ca1_f175;
/// Folds that are held out in turn.
pub const FOLDS: usize = 18;

/// A term that is tried.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Effect.
    pub effect: EffectRef,
    /// Id, with the covariate of an unknown one: candidates of one key are one explanation.
    pub key: String,
    /// Form, axes and shape.
    pub spec: Spec,
    /// Names and units of the parameters.
    pub parameters: Vec<(String, &'static str)>,
    /// Contribution per unit of each parameter, enT: component after component.
    pub stacked: DMatrix<f64>,
}

impl Candidate {
    /// From the columns of an effect.
    #[must_use]
    pub fn new(effect: EffectRef, spec: Spec, columns: Vec<Column>) -> Self {
        let n = columns.first().map_or(0, |c| c.values.len());
        let stacked = DMatrix::from_fn(3 * n, columns.len(), |i, j| columns[j].values[i % n][i / n]);
        let key = if effect.is_unknown() { format!("{effect}: {}", spec.form) } else { effect.to_string() };
        Self { effect, key, spec, parameters: columns.into_iter().map(|c| (c.name, c.unit)).collect(), stacked }
    }

    /// The covariate of an unknown dependence.
    #[must_use]
    pub fn covariate(&self) -> Option<&str> {
        self.effect.is_unknown().then_some(self.spec.form.as_str())
    }

    fn with_shape(&self, record: &Record, name: &str, value: f64) -> Option<Self> {
        let mut spec = self.spec.clone();
        spec.shape.iter_mut().find(|(n, _, _)| n == name)?.1 = value;
        let columns = self.effect.columns(record, &spec)?;
        Some(Self::new(self.effect, spec, columns))
    }

    fn continuous(&self) -> Option<(&str, f64)> {
        self.effect.continuous(&self.spec)
    }
}

/// What was accepted.
#[derive(Clone, Debug)]
pub struct Term {
    /// The term.
    pub candidate: Candidate,
    /// Probability that noise alone gives as much evidence.
    pub p_global: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// Part of its strength with which it would have been accepted just so.
    pub least: f64,
}

/// What is seen beside a model.
struct Look {
    state: State,
    /// Explanations, the best first.
    averaged: Vec<Explanation>,
    /// What is no noise.
    evident: Option<Term>,
}

/// A model with its noise.
pub struct State {
    /// Noise of the means.
    pub noise: Noise,
    /// Whitened residuals.
    pub fitted: Fitted,
    /// Whitened columns of the model, those of the terms last.
    pub columns: DMatrix<f64>,
    /// Whitened readings.
    pub readings: DVector<f64>,
}

/// Why the catalogue has no candidate for an effect.
pub struct Absent {
    /// The effect.
    pub effect: EffectRef,
    /// Why.
    pub reason: Unseen,
}

/// A scene with everything that is tried on it.
pub struct Search<'a> {
    /// The scene.
    pub scene: &'a Scene,
    /// Readings less what was found in the samples, enT.
    pub readings: DMatrix<f64>,
    /// Candidates.
    pub bank: Vec<Candidate>,
    /// Logarithm of the prior weight of each.
    pub priors: Vec<f64>,
    /// Effects without a candidate.
    pub absent: Vec<Absent>,
    correlations: Correlations,
    /// Candidates that are not looked for: found elsewhere, or of a form that did not predict.
    left_out: Vec<bool>,
}

/// Evidence of an explanation: all its candidates together, and the best of them.
#[derive(Clone, Debug)]
pub struct Explanation {
    /// Key.
    pub key: String,
    /// Logarithm of evidence times prior.
    pub evidence: f64,
    /// Best candidate.
    pub best: usize,
    /// Evidence of the best candidate with its prior.
    pub best_evidence: f64,
    /// Score of the best candidate.
    pub score: Score,
}

fn log_sum(values: impl Iterator<Item = f64> + Clone) -> f64 {
    let most = values.clone().fold(f64::NEG_INFINITY, f64::max);
    if most.is_finite() { most + values.map(|v| (v - most).exp()).sum::<f64>().ln() } else { most }
}

impl<'a> Search<'a> {
    /// Everything that can be tried on a scene.
    #[must_use]
    pub fn new(scene: &'a Scene, readings: DMatrix<f64>, catalogue: &Catalogue) -> Self {
        let record = &scene.record;
        let (mut bank, mut absent) = (Vec::new(), Vec::new());
        for effect in catalogue.iter() {
            match effect.specs(record) {
                Ok(specs) => bank.extend(specs.into_iter().filter_map(|spec| {
                    let columns = effect.columns(record, &spec)?;
                    Some(Candidate::new(effect, spec, columns))
                })),
                Err(reason) => absent.push(Absent { effect, reason }),
            }
        }
        let covariates = Covariate::all(record);
        for spec in UNKNOWN.specs(record).unwrap_or_default() {
            let columns =
                covariates.iter().find(|c| c.name == spec.form).and_then(|c| effects::unknown_columns(record, c, &spec));
            bank.extend(columns.map(|columns| Candidate::new(UNKNOWN, spec, columns)));
        }
        let rows = Rows {
            t_s: record.rows.iter().map(effects::Row::t_s).collect(),
            white: scene.white.clone(),
            inside: scene.inside,
            field: {
                let most: [f64; 3] = std::array::from_fn(|a| record.most_ent(a).max(f64::MIN_POSITIVE));
                record.rows.iter().map(|r| std::array::from_fn(|a| r.linear_ent[a] / most[a])).collect()
            },
        };
        let left_out = vec![false; bank.len()];
        let mut search =
            Self { scene, readings, priors: Vec::new(), bank, absent, correlations: Correlations::new(rows), left_out };
        search.set_priors();
        search
    }

    fn set_priors(&mut self) {
        self.priors = self
            .bank
            .iter()
            .zip(&self.left_out)
            .map(|(c, out)| {
                let same = self.bank.iter().filter(|o| o.key == c.key).count() as f64;
                let own = c.effect.prior(Some(self.scene.record.trend_order));
                if *out { f64::NEG_INFINITY } else { (own / same).ln() }
            })
            .collect();
    }

    fn rows(&self) -> usize {
        self.scene.readings.nrows()
    }

    fn edges(&self) -> [usize; 4] {
        let n = self.rows();
        [0, n, 2 * n, 3 * n]
    }

    fn whiten(&self, noise: &Noise, stacked: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.rows();
        let mut out = stacked.clone();
        for a in 0..3 {
            let mut part = out.rows(a * n, n).into_owned();
            noise.whiten(a, &mut part);
            out.rows_mut(a * n, n).copy_from(&part);
        }
        out
    }

    /// The linear model and the terms as columns of each component, for the noise.
    fn designs(&self, terms: &[&Candidate]) -> [DMatrix<f64>; 3] {
        let n = self.rows();
        [0, 1, 2].map(|a| {
            let mut columns: Vec<DVector<f64>> = self.scene.design.column_iter().map(|c| c.into_owned()).collect();
            for term in terms {
                for column in term.stacked.column_iter() {
                    let own = column.rows(a * n, n).into_owned();
                    if own.norm() > 0.0 {
                        columns.push(&own / own.norm());
                    }
                }
            }
            orthonormal(&DMatrix::from_columns(&columns), None, 1e-5)
        })
    }

    /// The model with these terms, its noise estimated with them.
    #[must_use]
    pub fn state(&self, terms: &[&Candidate]) -> Option<State> {
        let noise = self.correlations.estimate(&self.readings, &self.designs(terms))?;
        Some(self.state_with(noise, terms))
    }

    fn state_with(&self, noise: Noise, terms: &[&Candidate]) -> State {
        let n = self.rows();
        let p = self.scene.design.ncols();
        let own = [0, 1, 2].map(|a| {
            let mut design = self.scene.design.clone();
            noise.whiten(a, &mut design);
            design
        });
        let extra: usize = terms.iter().map(|t| t.stacked.ncols()).sum();
        let mut common = DMatrix::zeros(3 * n, extra);
        let mut at = 0;
        for term in terms {
            common.columns_mut(at, term.stacked.ncols()).copy_from(&self.whiten(&noise, &term.stacked));
            at += term.stacked.ncols();
        }
        let mut columns = DMatrix::zeros(3 * n, 3 * p + extra);
        for (a, design) in own.iter().enumerate() {
            columns.view_mut((a * n, a * p), (n, p)).copy_from(design);
        }
        columns.columns_mut(3 * p, extra).copy_from(&common);
        let stacked = DMatrix::from_column_slice(3 * n, 1, self.readings.as_slice());
        let readings = self.whiten(&noise, &stacked).column(0).into_owned();
        let fitted = Fitted::of_components(&readings, &own, &common, self.edges()).with_noise_beside(noise.inside);
        State { noise, fitted, columns, readings }
    }

    /// Parameters of the linear model, component after component, and their covariance: averaged over the noise that the readings allow,
    /// the scatter of the averaged values included.
    #[must_use]
    pub fn linear(&self) -> Option<(DVector<f64>, DMatrix<f64>)> {
        let noise = self.state(&[])?.noise;
        let noises = self.correlations.plausible(&noise.colour, &self.readings, &self.designs(&[]));
        let fits: Vec<(f64, DVector<f64>, DMatrix<f64>)> = noises
            .into_par_iter()
            .filter(|(_, weight)| *weight > NEGLIGIBLE)
            .filter_map(|(noise, weight)| {
                let state = self.state_with(noise, &[]);
                let covariance = state.columns.tr_mul(&state.columns).cholesky()?.inverse();
                let values = &covariance * state.columns.tr_mul(&state.readings);
                Some((weight.exp(), values, covariance))
            })
            .collect();
        let total: f64 = fits.iter().map(|f| f.0).sum();
        let count = fits.first()?.1.len();
        let mean = fits.iter().fold(DVector::zeros(count), |sum, (w, values, _)| sum + values * (w / total));
        let covariance = fits.iter().fold(DMatrix::zeros(count, count), |sum, (w, values, covariance)| {
            let off = values - &mean;
            sum + (covariance + &off * off.transpose()) * (w / total)
        });
        Some((mean, covariance))
    }

    /// Another model with the noise of this one.
    #[must_use]
    pub fn state_beside(&self, state: &State, terms: &[&Candidate]) -> State {
        self.state_with(state.noise.clone(), terms)
    }

    /// All candidates beside a model.
    #[must_use]
    pub fn groups(&self, state: &State) -> Vec<Group> {
        self.bank.par_iter().with_min_len(16).map(|c| state.fitted.group(&self.whiten(&state.noise, &c.stacked))).collect()
    }

    /// One candidate beside a model.
    #[must_use]
    pub fn group(&self, state: &State, candidate: &Candidate) -> Group {
        state.fitted.group(&self.whiten(&state.noise, &candidate.stacked))
    }

    /// Explanations by their evidence, the best first.
    #[must_use]
    pub fn explanations(&self, state: &State, groups: &[Group]) -> Vec<Explanation> {
        let scores: Vec<Score> = groups.iter().map(|g| state.fitted.score(g)).collect();
        let mut keys: Vec<&str> = Vec::new();
        let mut all: Vec<Explanation> = Vec::new();
        for candidate in &self.bank {
            if keys.last() == Some(&candidate.key.as_str()) || keys.contains(&candidate.key.as_str()) {
                continue;
            }
            keys.push(&candidate.key);
            let own: Vec<usize> = (0..self.bank.len())
                .filter(|i| self.bank[*i].key == candidate.key && groups[*i].surviving > ABSORBED && self.priors[*i].is_finite())
                .collect();
            let weighted = |i: &usize| scores[*i].evidence + self.priors[*i];
            let Some(best) = own.iter().copied().max_by(|a, b| weighted(a).total_cmp(&weighted(b))) else { continue };
            all.push(Explanation {
                key: candidate.key.clone(),
                evidence: log_sum(own.iter().map(weighted)),
                best,
                best_evidence: weighted(&best),
                score: scores[best],
            });
        }
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        all
    }

    /// The most promising explanations, their evidence averaged over the noise that the readings allow; the best first.
    fn averaged(&self, state: &State, now: &[&Candidate], explanations: &[Explanation]) -> Vec<Explanation> {
        let noises = self.correlations.plausible(&state.noise.colour, &self.readings, &self.designs(now));
        let mut chosen: Vec<Explanation> = explanations.iter().take(PROMISING).cloned().collect();
        // What slow noise hides shows beside white noise.
        if let Some((white, _)) = noises.last() {
            let white = self.state_with(white.clone(), now);
            let groups = self.groups(&white);
            for e in self.explanations(&white, &groups).into_iter().take(PROMISING) {
                if !chosen.iter().any(|c| c.best == e.best) {
                    chosen.push(e);
                }
            }
        }
        let scores: Vec<Vec<Score>> = noises
            .par_iter()
            .map(|(noise, _)| {
                let state = self.state_with(noise.clone(), now);
                chosen.iter().map(|e| state.fitted.score(&self.group(&state, &self.bank[e.best]))).collect()
            })
            .collect();
        for (k, e) in chosen.iter_mut().enumerate() {
            let terms = noises.iter().zip(&scores).map(|((_, weight), scores)| weight + scores[k].evidence);
            let average = log_sum(terms.clone());
            let most = (0..noises.len()).zip(terms).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |(i, _)| i);
            // All candidates of the explanation gain as its best one does.
            let gain = average - e.score.evidence;
            e.evidence += gain;
            e.best_evidence += gain;
            e.score = scores[most][k];
        }
        chosen.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        let mut keys: Vec<String> = Vec::new();
        chosen.retain(|e| !keys.contains(&e.key) && (keys.push(e.key.clone()), true).1);
        chosen
    }

    /// What stands out beside a model.
    fn look(&self, now: &[&Candidate]) -> Option<Look> {
        let state = self.state(now)?;
        let groups = self.groups(&state);
        let explanations = self.explanations(&state, &groups);
        let averaged = self.averaged(&state, now, &explanations);
        let Some(best) = averaged.first().filter(|e| e.best_evidence > NOISE_UNKNOWN) else {
            return Some(Look { state, averaged, evident: None });
        };
        let usable: Vec<usize> = (0..groups.len())
            .filter(|i| groups[*i].surviving > ABSORBED && self.priors[*i].is_finite() && groups[*i].count() > 0)
            .collect();
        let tried: Vec<&Group> = usable.iter().map(|i| &groups[*i]).collect();
        let priors: Vec<f64> = usable.iter().map(|i| self.priors[*i]).collect();
        let maxima = state.fitted.simulate(&tried, &priors, SEED);
        let evidence = best.best_evidence - NOISE_UNKNOWN;
        let margin = evidence - maxima.evidence_at(FALSE_ALARM);
        let evident = (margin > 0.0).then(|| Term {
            candidate: self.refined(&state, &self.bank[best.best]),
            p_global: maxima.global_p(evidence),
            trials: usable.len(),
            least: best.score.part_for(margin),
        });
        Some(Look { state, averaged, evident })
    }

    /// Two effects that are noise to each other: each stands out beside the other one alone.
    fn hidden(&self, look: &Look, now: &[&Candidate]) -> Option<[Term; 2]> {
        let beside = |c: &Candidate| self.look(&now.iter().copied().chain([c]).collect::<Vec<_>>())?.evident;
        look.averaged.iter().filter(|e| e.best_evidence > 0.0).take(HIDDEN).find_map(|e| {
            let second = beside(&self.refined(&look.state, &self.bank[e.best]))?;
            let first = beside(&second.candidate).filter(|first| first.candidate.key == e.key)?;
            Some([first, second])
        })
    }

    /// Looks for terms, beside those that are given.
    pub fn run(&mut self, given: &[Candidate]) -> Option<(Vec<Term>, State)> {
        let mut terms: Vec<Term> = Vec::new();
        let mut round = 0;
        loop {
            round += 1;
            let now: Vec<&Candidate> = given.iter().chain(terms.iter().map(|t| &t.candidate)).collect();
            if terms.len() >= MOST_STEPS || round > 2 * MOST_STEPS {
                let state = self.state(&now)?;
                return Some((terms, state));
            }
            let mut look = self.look(&now)?;
            let found: Vec<Term> = match look.evident.take() {
                Some(one) => vec![one],
                None => self.hidden(&look, &now).map(Vec::from).unwrap_or_default(),
            };
            if found.is_empty() {
                return Some((terms, look.state));
            }
            let after: Vec<&Candidate> = now.iter().copied().chain(found.iter().map(|t| &t.candidate)).collect();
            let noise = self.state(&after)?.noise;
            let (without, with) = (self.held_out(&noise, &now), self.held_out(&noise, &after));
            if with.sum >= without.sum {
                // It does not predict what it has not seen.
                for Term { candidate: Candidate { key, spec, .. }, .. } in found {
                    self.leave_out(|c| c.key == key && c.spec.form == spec.form);
                }
                continue;
            }
            for term in found {
                terms.push(term);
                self.merge(&mut terms);
            }
            self.repair(given, &mut terms)?;
        }
    }

    /// One term in place of two that are the same effect on different axes.
    fn merge(&self, terms: &mut Vec<Term>) {
        let Some(last) = terms.pop() else { return };
        let joins = |t: &Term| {
            let (a, b) = (&t.candidate, &last.candidate);
            a.effect == b.effect && !a.effect.is_unknown() && a.spec.form == b.spec.form && a.spec.shape == b.spec.shape
        };
        let Some(index) = terms.iter().position(joins) else { return terms.push(last) };
        let mut axes = [terms[index].candidate.spec.axes.clone(), last.candidate.spec.axes.clone()].concat();
        axes.sort_unstable();
        axes.dedup();
        let spec = Spec { axes, ..last.candidate.spec.clone() };
        match last.candidate.effect.columns(&self.scene.record, &spec) {
            Some(columns) if spec.axes != terms[index].candidate.spec.axes => {
                let candidate = Candidate::new(last.candidate.effect, spec, columns);
                terms[index].candidate = candidate;
            }
            _ => terms.push(last),
        }
    }

    /// Drops terms that the others made superfluous, and swaps those for which something better is left.
    fn repair(&self, given: &[Candidate], terms: &mut Vec<Term>) -> Option<()> {
        if terms.len() < 2 {
            return Some(());
        }
        for _ in 0..3 {
            let mut changed = false;
            let mut index = 0;
            while index < terms.len() && terms.len() > 1 {
                let others: Vec<&Candidate> = given
                    .iter()
                    .chain(terms.iter().enumerate().filter(|(i, _)| *i != index).map(|(_, t)| &t.candidate))
                    .collect();
                let all: Vec<&Candidate> = given.iter().chain(terms.iter().map(|t| &t.candidate)).collect();
                let noise = self.correlations.estimate(&self.readings, &self.designs(&all))?;
                let state = self.state_with(noise, &others);
                let groups = self.groups(&state);
                let explanations = self.explanations(&state, &groups);
                let own = explanations.iter().find(|e| e.key == terms[index].candidate.key);
                let own_group = self.group(&state, &terms[index].candidate);
                let own_score = state.fitted.score(&own_group);
                let own_evidence = own.map_or(f64::NEG_INFINITY, |e| e.evidence).max(own_score.evidence - 3.0);
                if own_evidence < 0.0 {
                    terms.remove(index);
                    changed = true;
                    continue;
                }
                if let Some(best) = explanations.first().filter(|b| b.evidence > own_evidence + SWAP)
                    && best.key != terms[index].candidate.key
                    && terms.iter().all(|t| t.candidate.key != best.key)
                {
                    terms[index].candidate = self.refined(&state, &self.bank[best.best]);
                    changed = true;
                } else {
                    terms[index].candidate = self.refined(&state, &terms[index].candidate);
                }
                index += 1;
            }
            if !changed {
                break;
            }
        }
        Some(())
    }

    /// A candidate with the best value of its continuous shape parameter.
    fn refined(&self, state: &State, candidate: &Candidate) -> Candidate {
        let Some((name, value)) = candidate.continuous() else { return candidate.clone() };
        let record = &self.scene.record;
        let evaluate = |v: f64| -> Option<f64> {
            let other = candidate.with_shape(record, name, v)?;
            Some(state.fitted.score(&self.group(state, &other)).evidence)
        };
        let [low, high] = candidate.effect.shape_range(record, &candidate.spec, name, value);
        let cost = |v| -evaluate(v).unwrap_or(f64::NEG_INFINITY).max(-1e6);
        let stop = Stop { relative: 1e-3, absolute: 1e-6 * value.abs().max(1e-9), steps: 24 };
        let found = scalar::minimum(cost, [low, high], stop);
        let better = found.filter(|v| evaluate(*v) > evaluate(value));
        better.and_then(|v| candidate.with_shape(record, name, v)).unwrap_or_else(|| candidate.clone())
    }

    /// Predictions of stretches that were left out of the fit, one after the other.
    #[must_use]
    pub fn held_out(&self, noise: &Noise, terms: &[&Candidate]) -> HeldOut {
        let n = self.rows();
        let p = self.scene.design.ncols();
        let extra: usize = terms.iter().map(|t| t.stacked.ncols()).sum();
        let width = 3 * p + extra;
        let folds = FOLDS.min(n / 3);
        let design_row = |a: usize, i: usize| -> DVector<f64> {
            let mut row = DVector::zeros(width);
            for j in 0..p {
                row[a * p + j] = self.scene.design[(i, j)];
            }
            let mut at = 3 * p;
            for term in terms {
                for column in term.stacked.column_iter() {
                    row[at] = column[a * n + i];
                    at += 1;
                }
            }
            row
        };
        // Columns of very different size make bad normal equations.
        let mut sizes = DVector::from_element(width, 0.0);
        for a in 0..3 {
            for i in 0..n {
                sizes.zip_apply(&design_row(a, i), |s: &mut f64, v: f64| *s = s.max(v.abs()));
            }
        }
        sizes.apply(|s| *s = if *s > 0.0 { s.recip() } else { 1.0 });
        let parts: Vec<Fold> = (0..folds)
            .map(|fold| {
                let rows: Vec<usize> = (fold * n / folds..(fold + 1) * n / folds).collect();
                let m = rows.len();
                let mut x = DMatrix::zeros(3 * m, width);
                let mut y = DVector::zeros(3 * m);
                let mut places = Vec::with_capacity(3 * m);
                let (mut white_x, mut white_y) = (x.clone(), y.clone());
                for a in 0..3 {
                    for (k, i) in rows.iter().enumerate() {
                        x.row_mut(a * m + k).copy_from(&design_row(a, *i).component_mul(&sizes).transpose());
                        y[a * m + k] = self.readings[(*i, a)];
                        places.push((*i, a));
                    }
                    if let Some(cholesky) = noise.covariance_of_rows(a, &rows).cholesky() {
                        let l = cholesky.l();
                        let solved = l.solve_lower_triangular(&x.rows(a * m, m).into_owned());
                        let target = l.solve_lower_triangular(&y.rows(a * m, m).into_owned());
                        if let (Some(solved), Some(target)) = (solved, target) {
                            white_x.rows_mut(a * m, m).copy_from(&solved);
                            white_y.rows_mut(a * m, m).copy_from(&target);
                        }
                    }
                }
                (places, x, y, white_x, white_y)
            })
            .collect();
        let grams: Vec<(DMatrix<f64>, DVector<f64>)> =
            parts.iter().map(|(_, _, _, wx, wy)| (wx.tr_mul(wx), wx.tr_mul(wy))).collect();
        let total = grams.iter().fold((DMatrix::zeros(width, width), DVector::zeros(width)), |(g, b), (h, c)| (g + h, b + c));
        let mut residual = DMatrix::zeros(n, 3);
        let mut sum = 0.0;
        let mut by_fold = Vec::with_capacity(folds);
        for ((places, x, y, wx, wy), (gram, rhs)) in parts.iter().zip(&grams) {
            let mut others = &total.0 - gram;
            // What a fold alone determines stays where it is without it.
            let ridge = 1e-12 * total.0.trace() / width as f64;
            (0..width).for_each(|j| others[(j, j)] += ridge);
            let Some(cholesky) = others.cholesky() else { continue };
            let coefficients = cholesky.solve(&(&total.1 - rhs));
            let left = y - x * &coefficients;
            for ((i, a), r) in places.iter().zip(left.iter()) {
                residual[(*i, *a)] = *r;
            }
            let squares = (wy - wx * &coefficients).norm_squared();
            by_fold.push(squares);
            sum += squares;
        }
        HeldOut { residual_ent: residual, sum, by_fold }
    }

    /// Noise of every row about the fitted model, enT: slow noise that the model follows is not in it.
    #[must_use]
    pub fn row_std(&self, state: &State, terms: &[&Candidate]) -> Vec<[f64; 3]> {
        let n = self.rows();
        let designs = self.designs(terms);
        let level: [f64; 3] = std::array::from_fn(|a| {
            let reading = self.readings.column(a);
            let left = reading - &designs[a] * designs[a].tr_mul(&reading);
            left.norm() / ((n - designs[a].ncols()).max(1) as f64).sqrt()
        });
        let total = state.noise.std();
        let usual: [f64; 3] = std::array::from_fn(|a| (total.iter().map(|s| s[a] * s[a]).sum::<f64>() / n as f64).sqrt());
        total.iter().map(|s| std::array::from_fn(|a| s[a] / usual[a] * level[a])).collect()
    }

    /// How the offset of each component drifts beside a model with white noise, in the lowest order that is not fitted: amplitude and standard
    /// uncertainty, enT. It is what slow noise stands for.
    #[must_use]
    pub fn drifts(&self, terms: &[&Candidate]) -> Option<[(f64, f64); 3]> {
        let white = self.correlations.with_colour(Colour::WHITE, &self.readings, &self.designs(terms))?;
        let of = |axis: usize| {
            let spec = Spec::new(offset_drift::LINE, &[axis]);
            let drift = EffectRef::new(&OffsetDrift);
            let columns = drift.columns(&self.scene.record, &spec)?;
            let line = Candidate::new(drift, spec, columns);
            let with: Vec<&Candidate> = terms.iter().copied().chain([&line]).collect();
            self.estimate(&self.state_with(white.clone(), &with), &with, terms.len())?.first().copied()
        };
        Some([of(0)?, of(1)?, of(2)?])
    }

    /// Leaves candidates out.
    pub fn leave_out(&mut self, which: impl Fn(&Candidate) -> bool) {
        self.left_out.iter_mut().zip(&self.bank).for_each(|(out, c)| *out |= which(c));
        self.set_priors();
    }

    /// Values and covariance of the parameters of the last `count` columns, with the uncertainty of continuous shapes in it.
    #[must_use]
    pub fn estimate(&self, state: &State, terms: &[&Candidate], index: usize) -> Option<Vec<(f64, f64)>> {
        let before: usize = terms[..index].iter().map(|t| t.stacked.ncols()).sum();
        let extra: usize = terms.iter().map(|t| t.stacked.ncols()).sum();
        let from = state.columns.ncols() - extra + before;
        let own = terms[index].stacked.ncols();
        let solve = |columns: &DMatrix<f64>| -> Option<(DVector<f64>, DMatrix<f64>)> {
            let sizes: Vec<f64> = columns.column_iter().map(|c| c.norm().max(f64::MIN_POSITIVE)).collect();
            let scaled = DMatrix::from_fn(columns.nrows(), columns.ncols(), |i, j| columns[(i, j)] / sizes[j]);
            let svd = scaled.svd(true, true);
            let inverse = svd.pseudo_inverse(1e-10).ok()?;
            let mut values = &inverse * &state.readings;
            let mut covariance = &inverse * inverse.transpose();
            for i in 0..sizes.len() {
                values[i] /= sizes[i];
                for j in 0..sizes.len() {
                    covariance[(i, j)] /= sizes[i] * sizes[j];
                }
            }
            Some((values, covariance))
        };
        let (values, covariance) = solve(&state.columns)?;
        let mut result: Vec<(f64, f64)> =
            (0..own).map(|j| (values[from + j], covariance[(from + j, from + j)].max(0.0).sqrt())).collect();
        if let Some((name, value)) = terms[index].continuous() {
            // The column of the shape parameter, at the amplitude that was found.
            let step = 1e-3 * value.abs().max(1e-9);
            let at = |v: f64| terms[index].with_shape(&self.scene.record, name, v).map(|c| c.stacked);
            if let (Some(up), Some(down)) = (at(value + step), at(value - step)) {
                let amplitudes = DVector::from_fn(own, |j, _| values[from + j]);
                let slope = (up - down) * amplitudes / (2.0 * step);
                if slope.norm() > 0.0 {
                    let slope = self.whiten(&state.noise, &DMatrix::from_column_slice(slope.len(), 1, slope.as_slice()));
                    let mut columns = state.columns.clone().insert_column(state.columns.ncols(), 0.0);
                    let last = columns.ncols() - 1;
                    columns.column_mut(last).copy_from(&slope.column(0));
                    if let Some((_, covariance)) = solve(&columns) {
                        for (j, r) in result.iter_mut().enumerate() {
                            r.1 = covariance[(from + j, from + j)].max(0.0).sqrt();
                        }
                        result.push((value, covariance[(last, last)].max(0.0).sqrt()));
                    }
                }
            }
        }
        Some(result)
    }
}

/// A stretch: row and component of each reading, columns and readings, the same whitened.
type Fold = (Vec<(usize, usize)>, DMatrix<f64>, DVector<f64>, DMatrix<f64>, DVector<f64>);

/// What predictions of held-out stretches leave.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// Readings minus predictions, enT.
    pub residual_ent: DMatrix<f64>,
    /// Squares of the whitened residuals.
    pub sum: f64,
    /// The same per fold.
    pub by_fold: Vec<f64>,
}
