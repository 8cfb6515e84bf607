//! A term that a search tries, and one that it accepted.

use crate::model::effects::{Column, EffectRef, Spec};
use nalgebra::DMatrix;

/// A term that is tried: one form of an effect, with its axes and its shape.
#[derive(Clone, Debug)]
pub struct Candidate {
    /// Effect.
    pub effect: EffectRef,
    /// What an unknown disagreement depends on; `None` for the effects of the catalogue.
    pub covariate: Option<String>,
    /// The effect, with the covariate of an unknown one or with what it follows: candidates of one key are one explanation.
    pub key: String,
    /// Form, axes and shape.
    pub spec: Spec,
    /// Names and units of the linear parameters.
    pub parameters: Vec<(String, &'static str)>,
    /// Contribution per unit of each parameter: one row per value of the problem.
    pub columns: DMatrix<f64>,
}

impl Candidate {
    /// A candidate with its columns.
    #[must_use]
    pub fn new(
        effect: EffectRef,
        covariate: Option<String>,
        spec: Spec,
        parameters: Vec<(String, &'static str)>,
        columns: DMatrix<f64>,
    ) -> Self {
        let follows = covariate.clone().or_else(|| effect.follows(&spec));
        let key = follows.map_or_else(|| effect.to_string(), |follows| format!("{effect}: {follows}"));
        Self { effect, covariate, key, spec, parameters, columns }
    }

    /// From the columns of an effect on readings of three components, enT per unit: component after component. The form of an unknown
    /// dependence is the name of its covariate.
    #[must_use]
    pub fn of_readings(effect: EffectRef, spec: Spec, columns: Vec<Column>) -> Self {
        let n = columns.first().map_or(0, |c| c.values.len());
        let of_axis = |column: &Column, a: usize| column.values.iter().map(move |value| value[a]).collect::<Vec<f64>>();
        let stacked: Vec<f64> = columns.iter().flat_map(|column| [0, 1, 2].map(|a| of_axis(column, a))).flatten().collect();
        let stacked = DMatrix::from_vec(3 * n, columns.len(), stacked);
        let covariate = effect.is_unknown().then(|| spec.form.clone());
        Self::new(effect, covariate, spec, columns.into_iter().map(|c| (c.name, c.unit)).collect(), stacked)
    }

    /// Whether both are the same form of one effect of the catalogue with the same shape, so that they may differ by their axes only.
    #[must_use]
    pub fn is_same_form(&self, other: &Self) -> bool {
        self.effect == other.effect
            && !self.effect.is_unknown()
            && self.spec.form == other.spec.form
            && self.spec.shape == other.spec.shape
    }
}

/// All terms but some, which are given by their places.
pub fn without<'c, C>(all: &[&'c C], gone: &[usize]) -> Vec<&'c C> {
    all.iter().enumerate().filter(|(i, _)| !gone.contains(i)).map(|(_, term)| *term).collect()
}

/// A term that was accepted.
#[derive(Clone, Debug)]
pub struct Accepted<C> {
    /// The term.
    pub candidate: C,
    /// Probability that noise alone gives any candidate as much evidence.
    pub p_global: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// The weakest effect that would have been accepted with the noise that is left beside it: whether slow noise stands in for it is no matter of how
    /// large noise made it.
    pub threshold: Threshold,
}

/// The weakest effect that would have been accepted, as signal to noise ratio.
#[derive(Clone, Copy, Debug)]
pub enum Threshold {
    /// As a part of the strength that was seen.
    Part(f64),
    /// About this, whatever was seen.
    Strength(f64),
}

impl Threshold {
    /// Signal to noise ratio for an effect that was seen with this one.
    #[must_use]
    pub fn strength(self, seen: f64) -> f64 {
        match self {
            Self::Part(part) => part * seen,
            Self::Strength(strength) => strength,
        }
    }
}
