//! Plateau means of one run: what is tried on them, the model with chosen terms, and its noise.
//!
//! The noise of the means is estimated anew with every set of terms, since a missing effect passes as slow noise; the evidence of the most
//! promising candidates is averaged over all noise that the readings allow ([`super::problem`] has the search, `problem` what it asks).

mod attenuation;
mod chosen;
mod describe;
mod each_axis;
mod estimate;
mod held_out;
mod in_time;
mod memory;
mod other_form;
mod problem;
mod thermistor;

use super::candidate::{Accepted, Candidate};
use super::explanations::{self, Scored};
use crate::fit::noise::NoiseModel;
use crate::fit::noise::state_space::{Correlations, Inside, Noise, Rows};
use crate::fit::scan::{Fitted, Group, orthonormal};
use crate::model::effects::{self, Catalogue, Covariate, EffectRef, Record, Spec, UNKNOWN, Unseen};
use crate::record::plan::Planned;
use crate::record::prepared::PreparedRun;
pub(super) use describe::{HOPELESS, gap};
pub use estimate::Residuals;
pub use held_out::HeldOut;
use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use std::sync::{Mutex, OnceLock};

/// A column of which the others leave less than this part counts as one of them when the noise is estimated.
const INDEPENDENT: f64 = 1e-5;
/// Candidates that one thread whitens at a time.
const AT_ONCE: usize = 16;

/// With more rows than these the noise beside terms is looked for near that of the terms before.
const MANY_ROWS: usize = 1000;

/// A term of the means that was accepted.
pub type Term = Accepted<Candidate>;

/// The linear model with chosen terms, and the noise that is left beside it.
pub struct MeansModel {
    /// Noise of the means.
    pub noise: Noise,
    /// Whitened residuals.
    pub fitted: Fitted,
    /// Whitened columns of the model, those of the terms last.
    pub columns: DMatrix<f64>,
    /// Whitened readings.
    pub readings: DVector<f64>,
    /// Sizes of the terms, once they were asked for.
    sizes: OnceLock<Vec<Vec<(f64, f64)>>>,
}

impl MeansModel {
    /// Values and standard uncertainties of the parameters of each term: see [`Means::estimates`].
    fn estimates(&self, means: &Means, terms: &[&Candidate]) -> &Vec<Vec<(f64, f64)>> {
        self.sizes.get_or_init(|| means.estimates(self, terms).unwrap_or_default())
    }
}

/// Why the catalogue has no candidate for an effect.
pub struct Absent {
    /// The effect.
    pub effect: EffectRef,
    /// Why.
    pub reason: Unseen,
}

/// The plateau means of a run with everything that is tried on them.
pub struct Means<'a> {
    /// The run.
    pub prepared: &'a PreparedRun,
    /// Readings less what was found in the samples, enT.
    pub readings: DMatrix<f64>,
    /// Terms that are there for sure: effects that were known before.
    pub given: Vec<Candidate>,
    /// Candidates.
    pub candidates: Vec<Candidate>,
    /// Logarithm of the prior of each; minus infinity for those that are looked for elsewhere.
    pub log_priors: Vec<f64>,
    /// Those that are no longer looked for, since they did not predict. They are rivals of what is named in their place: its twin would
    /// stand alone.
    ruled_out: Vec<bool>,
    /// Effects without a candidate.
    pub absent: Vec<Absent>,
    correlations: Correlations,
    /// The record with the noise of its thermistors once more, draw after draw, once it was asked for.
    drawn: OnceLock<Vec<Record>>,
    /// The noise that was estimated last: the search asks for the same again and again.
    last: Mutex<Option<Estimated>>,
}

/// The noise that was estimated beside terms, given by their keys and forms.
#[derive(Clone)]
struct Estimated {
    terms: Vec<(String, Spec)>,
    noise: Noise,
}

/// Candidates of all effects of a catalogue and of all unknown dependences, and the effects that have none.
fn candidates(record: &Record, catalogue: &Catalogue) -> (Vec<Candidate>, Vec<Absent>) {
    let (mut forms, mut absent) = (Vec::new(), Vec::new());
    for effect in catalogue.iter() {
        match effect.specs(record) {
            Ok(specs) => forms.extend(specs.into_iter().map(|spec| (effect, spec))),
            Err(reason) => absent.push(Absent { effect, reason }),
        }
    }
    forms.extend(UNKNOWN.specs(record).unwrap_or_default().into_iter().map(|spec| (UNKNOWN, spec)));
    let covariates = Covariate::all(record);
    let candidate = |(effect, spec): (EffectRef, Spec)| {
        let columns = if effect.is_unknown() {
            covariates.iter().find(|c| c.name == spec.form).and_then(|c| effects::unknown_columns(record, c, &spec))
        } else {
            effect.columns(record, &spec)
        };
        Some(Candidate::of_readings(effect, spec, columns?))
    };
    (forms.into_par_iter().filter_map(candidate).collect(), absent)
}

/// What the noise depends on: times, white variances and fields of the rows.
fn noise_rows(record: &Record, white: &[[f64; 3]], inside: Option<Inside>) -> Rows {
    let most: [f64; 3] = std::array::from_fn(|a| record.most_ent(a).max(f64::MIN_POSITIVE));
    Rows {
        t_s: record.rows.iter().map(effects::Row::t_s).collect(),
        white: white.to_vec(),
        inside,
        field: record.rows.iter().map(|r| std::array::from_fn(|a| r.linear_ent[a] / most[a])).collect(),
    }
}

impl<'a> Means<'a> {
    /// Everything that can be tried on a run beside the effects that are given.
    #[must_use]
    pub fn new(prepared: &'a PreparedRun, readings: DMatrix<f64>, catalogue: &Catalogue, given: Vec<Candidate>) -> Self {
        let (candidates, absent) = candidates(&prepared.record, catalogue);
        let trend_order = Some(prepared.record.trend_order);
        let log_priors = explanations::log_priors(candidates.iter(), |effect| effect.prior(trend_order));
        let correlations = Correlations::new(noise_rows(&prepared.record, &prepared.white, prepared.inside));
        let ruled_out = vec![false; candidates.len()];
        Self {
            prepared,
            readings,
            given,
            candidates,
            log_priors,
            ruled_out,
            absent,
            correlations,
            drawn: OnceLock::new(),
            last: Mutex::default(),
        }
    }

    /// Noise of this run in another one that could be measured.
    pub(super) fn noise_of(&self, noise: &Noise, next: &Planned) -> Option<Noise> {
        self.correlations.at(noise_rows(&next.record, &next.white, self.prepared.inside)).known(noise)
    }

    /// Leaves candidates out that are looked for elsewhere.
    pub fn leave_out(&mut self, which: impl Fn(&Candidate) -> bool) {
        let left_out = self.log_priors.iter_mut().zip(&self.candidates).filter(|(_, c)| which(c));
        left_out.for_each(|(log_prior, _)| *log_prior = f64::NEG_INFINITY);
    }

    /// The given terms and the chosen ones.
    #[must_use]
    pub fn all<'b>(&'b self, chosen: &'b [Term]) -> Vec<&'b Candidate> {
        self.given.iter().chain(chosen.iter().map(|t| &t.candidate)).collect()
    }

    fn rows(&self) -> usize {
        self.prepared.readings.nrows()
    }

    fn edges(&self) -> [usize; 4] {
        let n = self.rows();
        [0, n, 2 * n, 3 * n]
    }

    fn whiten(&self, noise: &Noise, stacked: &DMatrix<f64>) -> DMatrix<f64> {
        let n = self.rows();
        let mut out = stacked.clone();
        for a in 0..3 {
            let of_component = |column: usize| 3 * n * column + a * n..3 * n * column + (a + 1) * n;
            let all: Vec<&[f64]> = (0..stacked.ncols()).map(|column| &stacked.as_slice()[of_component(column)]).collect();
            // Most columns act on one component.
            if all.iter().all(|column| column.iter().all(|v| *v == 0.0)) {
                continue;
            }
            let mut part = DMatrix::from_vec(n, all.len(), all.concat());
            noise.whiten(a, &mut part);
            for (column, whitened) in part.as_slice().chunks_exact(n).enumerate() {
                out.as_mut_slice()[of_component(column)].copy_from_slice(whitened);
            }
        }
        out
    }

    /// The linear model and the terms as columns of each component, for the noise.
    fn designs(&self, terms: &[&Candidate]) -> [DMatrix<f64>; 3] {
        let n = self.rows();
        [0, 1, 2].map(|a| {
            let mut columns: Vec<DVector<f64>> = self.prepared.design.column_iter().map(|c| c.into_owned()).collect();
            for term in terms {
                for column in term.columns.column_iter() {
                    let own = column.rows(a * n, n).into_owned();
                    if own.norm() > 0.0 {
                        columns.push(&own / own.norm());
                    }
                }
            }
            orthonormal(&DMatrix::from_columns(&columns), None, INDEPENDENT)
        })
    }

    /// The model with these terms, its noise estimated with them.
    #[must_use]
    pub fn model(&self, terms: &[&Candidate]) -> Option<MeansModel> {
        Some(self.model_with(self.estimated(terms)?, terms))
    }

    /// The noise beside these terms.
    fn estimated(&self, terms: &[&Candidate]) -> Option<Noise> {
        let named: Vec<(String, Spec)> = terms.iter().map(|t| (t.key.clone(), t.spec.clone())).collect();
        let known = self.last.lock().ok().and_then(|last| last.clone()).filter(|last| last.terms == named);
        if let Some(last) = known {
            return Some(last.noise);
        }
        let designs = self.designs(terms);
        let before = self.last.lock().ok().and_then(|last| last.as_ref().map(|l| l.noise.parameters));
        let noise = match before.filter(|_| self.rows() > MANY_ROWS) {
            Some(near) => self.correlations.estimate_near(&near, &self.readings, &designs)?,
            None => self.correlations.estimate(&self.readings, &designs)?,
        };
        if let Ok(mut last) = self.last.lock() {
            *last = Some(Estimated { terms: named, noise: noise.clone() });
        }
        Some(noise)
    }

    fn model_with(&self, noise: Noise, terms: &[&Candidate]) -> MeansModel {
        let n = self.rows();
        let p = self.prepared.design.ncols();
        let own = [0, 1, 2].map(|a| {
            let mut design = self.prepared.design.clone();
            noise.whiten(a, &mut design);
            design
        });
        let extra: usize = terms.iter().map(|t| t.columns.ncols()).sum();
        let mut common = DMatrix::zeros(3 * n, extra);
        let mut at = 0;
        for term in terms {
            common.columns_mut(at, term.columns.ncols()).copy_from(&self.whiten(&noise, &term.columns));
            at += term.columns.ncols();
        }
        let mut columns = DMatrix::zeros(3 * n, 3 * p + extra);
        for (a, design) in own.iter().enumerate() {
            columns.view_mut((a * n, a * p), (n, p)).copy_from(design);
        }
        columns.columns_mut(3 * p, extra).copy_from(&common);
        let stacked = DMatrix::from_column_slice(3 * n, 1, self.readings.as_slice());
        let readings = self.whiten(&noise, &stacked).column(0).into_owned();
        let fitted = Fitted::of_components(&readings, &own, &common, self.edges()).with_noise_beside(noise.inside);
        MeansModel { noise, fitted, columns, readings, sizes: OnceLock::new() }
    }

    /// Another model with the noise of this one.
    #[must_use]
    pub fn model_beside(&self, model: &MeansModel, terms: &[&Candidate]) -> MeansModel {
        self.model_with(model.noise.clone(), terms)
    }

    /// All candidates beside a model.
    #[must_use]
    pub fn groups(&self, model: &MeansModel) -> Vec<Group> {
        self.candidates.par_iter().with_min_len(AT_ONCE).map(|c| self.group(model, c)).collect()
    }

    /// One candidate beside a model.
    #[must_use]
    pub fn group(&self, model: &MeansModel, candidate: &Candidate) -> Group {
        model.fitted.group(&self.whiten(&model.noise, &candidate.columns))
    }

    /// Whether a candidate is looked for.
    fn is_searched(&self, index: usize) -> bool {
        self.log_priors[index].is_finite() && !self.ruled_out[index]
    }

    /// The candidates that are looked for, scored beside a model.
    pub(super) fn scored<'b>(&'b self, model: &'b MeansModel) -> Scored<'b> {
        self.scored_with(model, self.groups(model))
    }

    /// The same with what the model leaves of them.
    fn scored_with<'b>(&'b self, model: &'b MeansModel, groups: Vec<Group>) -> Scored<'b> {
        self.scored_if(model, groups, |_| false)
    }

    /// Candidates scored beside a model as rivals of one that was chosen: those that were ruled out as well, where it may stand for them.
    fn scored_as_rivals<'b>(&'b self, model: &'b MeansModel, chosen: &Group) -> Scored<'b> {
        self.scored_if(model, self.groups(model), |other| explanations::may_be(&model.fitted, chosen, other))
    }

    /// Candidates scored beside a model; of those that were ruled out the ones that count.
    fn scored_if<'b>(&'b self, model: &'b MeansModel, groups: Vec<Group>, counts: impl Fn(&Group) -> bool) -> Scored<'b> {
        let is_scored = |i: usize| !self.ruled_out[i] || counts(&groups[i]);
        let log_prior = |(i, prior): (usize, &f64)| if is_scored(i) { *prior } else { f64::NEG_INFINITY };
        let log_priors = self.log_priors.iter().enumerate().map(log_prior).collect();
        let trend_order = Some(self.prepared.record.trend_order);
        Scored::new(&model.fitted, self.candidates.iter().collect(), groups, log_priors, trend_order)
    }
}

/// A candidate with another value of a shape parameter.
fn with_shape(candidate: &Candidate, record: &Record, name: &str, value: f64) -> Option<Candidate> {
    let mut spec = candidate.spec.clone();
    spec.shape.iter_mut().find(|(n, _, _)| n == name)?.1 = value;
    let columns = candidate.effect.columns(record, &spec)?;
    Some(Candidate::of_readings(candidate.effect, spec, columns))
}
