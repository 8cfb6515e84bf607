//! What could be found at all: the candidates of the diagnosis beside the model of the run, weighed with a covariance that only the
//! generator has. Nothing of the diagnosis' own noise enters.

use super::noise::{Cell, Family, Noise, Random, Whitener};
use super::sensor::Kind;
use super::{Blind, kinds};
use calfit::diagnose::means::Means;
use calfit::fit::scan::{ABSORBED, Score, orthonormal};
use calfit::fit::statistics::log_sum;
use calfit::model::effects::{Acts, Catalogue};
use calfit::record::prepared::PreparedRun;
use nalgebra::{DMatrix, DVector};
use serde::Serialize;
use std::collections::BTreeMap;

/// Draws from the generator's distribution of noise that stand for all of it.
const DRAWS: u64 = 100;
/// One in so many sweeps is looked at.
const SWEEPS: u64 = 4;
/// Part of a column beside the others from which on it counts.
pub(super) const INDEPENDENT: f64 = 1e-6;
/// Explanations of largest evidence that are weighed with all of them.
const PROMISING: usize = 6;

/// The best candidate and the logarithm of its evidence times its prior.
#[derive(Clone, Debug, Serialize)]
pub struct Best {
    pub evidence: f64,
    pub effect: String,
}

/// What a search finds that knows more than anyone can.
#[derive(Clone, Debug, Serialize)]
pub struct Ideal {
    /// With the true covariance of the noise.
    pub known: Best,
    /// With the true white noise, and slow noise that may be any which the generator draws.
    pub drawn: Best,
}

/// An explanation: its best candidate with the logarithm of its evidence, and that of the evidence times prior of all of them.
#[derive(Clone, Copy)]
struct Explained {
    best: usize,
    of_best: f64,
    evidence: f64,
}

/// Means of a run, whitened, beside the run's own parameters.
pub(super) struct White {
    whiteners: [Whitener; 3],
    /// Orthonormal base of the run's own parameters.
    bases: [DMatrix<f64>; 3],
    pub(super) residual: DVector<f64>,
    /// Restricted, up to a constant.
    log_likelihood: f64,
}

fn whitened(whitener: &Whitener, columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut out = columns.clone();
    for mut column in out.column_iter_mut().filter(|c| c.amax() > 0.0) {
        let values: Vec<f64> = column.iter().copied().collect();
        column.copy_from_slice(&whitener.apply(&values));
    }
    out
}

impl White {
    pub(super) fn new(noise: &Noise, blind: &Blind, prepared: &PreparedRun, cells: &[Cell]) -> Self {
        let whiteners = [0, 1, 2].map(|i| Whitener::new(noise, &blind.clean_runs[0], i, cells));
        let n = cells.len();
        let mut residual = DVector::zeros(3 * n);
        let mut log_likelihood = 0.0;
        let bases = [0, 1, 2].map(|i| {
            let qr = whitened(&whiteners[i], &prepared.design).qr();
            let log_normal: f64 = qr.r().diagonal().iter().map(|d| d.abs().ln()).sum();
            let base = qr.q();
            let reading = whitened(&whiteners[i], &prepared.readings.columns(i, 1).into_owned());
            let left = &reading - &base * base.tr_mul(&reading);
            log_likelihood -= 0.5 * left.norm_squared() + 0.5 * whiteners[i].log_covariance() + log_normal;
            residual.rows_mut(i * n, n).copy_from(&left);
            base
        });
        Self { whiteners, bases, residual, log_likelihood }
    }

    /// What the run's own parameters leave of columns, component after component, whitened; none where they absorb them.
    pub(super) fn left(&self, stacked: &DMatrix<f64>) -> Option<DMatrix<f64>> {
        let n = self.residual.len() / 3;
        let mut left = stacked.clone();
        let mut before = 0.0;
        for i in 0..3 {
            let white = whitened(&self.whiteners[i], &stacked.rows(i * n, n).into_owned());
            before += white.norm_squared();
            left.rows_mut(i * n, n).copy_from(&(&white - &self.bases[i] * self.bases[i].tr_mul(&white)));
        }
        (left.norm_squared() > ABSORBED * ABSORBED * before).then_some(left)
    }

    /// Logarithm of the evidence of columns; minus infinity where the run's own parameters absorb them.
    fn evidence(&self, stacked: &DMatrix<f64>) -> f64 {
        let Some(left) = self.left(stacked) else { return f64::NEG_INFINITY };
        let base = orthonormal(&left, None, INDEPENDENT);
        Score::known(base.tr_mul(&self.residual).norm_squared(), base.ncols()).evidence
    }
}

/// What the diagnosis tries on the plateau means of a run, and their samples; none where they are not all looked at.
pub(super) fn looked_at<'a>(prepared: &'a PreparedRun, blind: &Blind) -> Option<(Means<'a>, Vec<Cell>)> {
    let [cells] = kinds::plateau_cells(&blind.clean_runs).try_into().ok()?;
    if cells.len() != prepared.record.rows.len() {
        return None;
    }
    let mut means = Means::new(prepared, prepared.readings.clone(), &Catalogue::default(), Vec::new());
    if prepared.record.has_samples {
        // These are found in the samples.
        means.leave_out(|c| c.effect.acts_in(Acts::Samples));
    }
    Some((means, cells))
}

/// Means beside noise that may be any which the generator draws, the white part of it the true one.
fn drawn<'a>(blind: &'a Blind, prepared: &'a PreparedRun, cells: &'a [Cell]) -> impl Iterator<Item = White> + 'a {
    (0..DRAWS).map(move |draw| {
        let mut random = Random::new(blind.truth.seed.wrapping_add(draw), "noise of the ideal");
        let family = Family::WITHOUT_SPIKES[random.below(Family::WITHOUT_SPIKES.len())];
        let slow = Noise::drawn(family, &blind.clean_runs[0], &mut random).slow;
        White::new(&Noise { slow, ..blind.truth.noise.clone() }, blind, prepared, cells)
    })
}

/// What can be found in the plateau means of a run; none where they are not what shows its effects, and in most of the sweeps.
pub fn ideal(prepared: &PreparedRun, blind: &Blind) -> Option<Ideal> {
    let left_out = match blind.truth.kind {
        Kind::Frequency => true,
        // Hundreds of rows take their time.
        Kind::Sweep => !blind.truth.seed.is_multiple_of(SWEEPS),
        _ => false,
    };
    if left_out {
        return None;
    }
    let (means, cells) = looked_at(prepared, blind)?;
    let truth = White::new(&blind.truth.noise, blind, prepared, &cells);
    let usable: Vec<usize> = (0..means.candidates.len()).filter(|c| means.log_priors[*c].is_finite()).collect();
    let of = |white: &White, c: usize| white.evidence(&means.candidates[c].columns);
    // All candidates of one key are one explanation, in which the best one stands for the others.
    let explained = |white: &White| {
        let mut of_key: BTreeMap<&str, Vec<(usize, f64)>> = BTreeMap::new();
        for c in &usable {
            of_key.entry(means.candidates[*c].key.as_str()).or_default().push((*c, of(white, *c)));
        }
        let explanation = |all: Vec<(usize, f64)>| {
            let with_prior = all.iter().map(|(c, evidence)| evidence + means.log_priors[*c]);
            let (best, of_best) = all.iter().copied().max_by(|a, b| a.1.total_cmp(&b.1))?;
            Some(Explained { best, of_best, evidence: log_sum(with_prior) })
        };
        let mut all: Vec<Explained> = of_key.into_values().filter_map(explanation).collect();
        all.sort_by(|a, b| b.evidence.total_cmp(&a.evidence));
        all
    };
    let known = explained(&truth);
    // What slow noise hides shows beside white noise.
    let white = White::new(&Noise { slow: Vec::new(), ..blind.truth.noise.clone() }, blind, prepared, &cells);
    let without = explained(&white);
    let most = [&known, &without].into_iter().flat_map(|all| all.iter().take(PROMISING));
    let promising: Vec<Explained> = most.filter(|one| one.evidence.is_finite()).copied().collect();
    let draws: Vec<(f64, Vec<f64>)> = drawn(blind, prepared, &cells)
        .map(|white| (white.log_likelihood, promising.iter().map(|one| of(&white, one.best)).collect()))
        .collect();
    let total = log_sum(draws.iter().map(|d| d.0));
    let averaged = promising.iter().enumerate().map(|(k, one)| {
        let average = log_sum(draws.iter().map(|d| d.0 + d.1[k])) - total;
        (one.best, one.evidence + average - one.of_best)
    });
    let by_lottery = averaged.max_by(|a, b| a.1.total_cmp(&b.1))?;
    let best = |(c, evidence): (usize, f64)| Best { evidence, effect: means.candidates[c].effect.to_string() };
    let of_all = known.first()?;
    Some(Ideal { known: best((of_all.best, of_all.evidence)), drawn: best(by_lottery) })
}
