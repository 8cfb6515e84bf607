//! Whether the facility stepped between two calibrations, or follows a temperature: both are fitted to the same rows and compared by their
//! evidence.
//!
//! The evidence is the Bayesian information criterion, `n ln(S / n) + k ln n` for n rows, k parameters and the sum S of the squared
//! residuals: half of a difference is about the logarithm of the odds. A step that nobody expected has to be worth more than what any of the
//! many places where it could be would gain by chance.

use super::scatter::FAMILIES;
use super::terms::{CONSTANT, Modulus, Observation, Step, Terms};
use super::{MOST_CONDITION, MOST_THERMAL_CONDITION, fit, start};
use crate::data::note::{Note, NoteKind};
use crate::fit::{Limits, NonlinearSolution, nonlinear};
use crate::model::facility_calibration::{Explanation, ScalarHypothesis};
use rayon::prelude::*;

/// A step has to lower the criterion by this much: odds of e^5 to 1, and by chance at most once in 200 sets of four calibrations.
pub(super) const CONVINCING: f64 = 10.0;
/// A step that lowers it by this much is told: by chance in one of fifty sets of four calibrations.
const WORTH_TELLING: f64 = 5.0;
/// Most steps that are looked for.
const MOST_STEPS: usize = 12;

/// What explains the calibrations best.
pub(super) struct Explained {
    /// The model.
    pub terms: Terms,
    /// What was compared.
    pub hypotheses: Vec<ScalarHypothesis>,
    /// A step that explains the calibrations better than the temperatures do, but not convincingly.
    pub undecided: Option<Step>,
    /// Families of which a step was not taken, since a scatter of the calibrations explains them as well.
    pub scatters: [bool; FAMILIES.len()],
}

impl Explained {
    /// By these terms alone, where nothing else can be looked for.
    pub fn by(terms: Terms) -> Self {
        Self { terms, hypotheses: Vec::new(), undecided: None, scatters: [false; FAMILIES.len()] }
    }

    /// Says that steps may be left which were not looked for.
    pub fn note(&self) -> Option<Note> {
        let text = format!(
            "{MOST_STEPS} steps were found, and no more are looked for: others may be in the parameters and in their uncertainties"
        );
        let note = || Note::new(NoteKind::Fit, text).with_remedy("calibrate the periods between the steps by themselves");
        (self.terms.steps.len() >= MOST_STEPS).then(note)
    }
}

/// A fit to the rows that count, by its evidence.
struct Scored {
    bic: f64,
    /// `n ln(S / n)`, the part of it that does not count parameters.
    deviance: f64,
    parameters: usize,
    solution: NonlinearSolution,
}

/// A step that may be, and how much it lowers the criterion.
#[derive(Clone, Copy)]
struct Candidate {
    step: Step,
    gain: f64,
    /// Whether the temperatures explain something of its parameter that has to be explained.
    replaces: bool,
}

/// The rows that are compared: those that agree with their own calibration.
struct Comparison<'a> {
    rows: &'a [Observation],
    moduli: Vec<f64>,
    weights: Vec<f64>,
    runs: usize,
}

impl Comparison<'_> {
    fn score(&self, terms: &Terms) -> Option<Scored> {
        self.score_from(terms, &start(self.rows, terms))
    }

    /// The same, with a search that begins at a point near the minimum.
    fn score_from(&self, terms: &Terms, start: &[f64]) -> Option<Scored> {
        let most = if terms.coil || terms.rack { MOST_THERMAL_CONDITION } else { MOST_CONDITION };
        let model = Modulus { rows: self.rows, terms };
        let limits = Limits { max_condition: most };
        let solution = nonlinear::solve(&model, &self.moduli, Some(&self.weights), start, &limits).ok()?;
        let rows: f64 = self.weights.iter().sum();
        let deviance = rows * (solution.residual_std.powi(2) * solution.dof as f64 / rows).ln();
        let parameters = terms.count();
        Some(Scored { bic: deviance + parameters as f64 * rows.ln(), deviance, parameters, solution })
    }

    /// The model itself, or with the coefficients of what steps taken as zero where it is not determined otherwise.
    fn score_with_steps(&self, terms: &Terms) -> Option<Scored> {
        self.score(terms).or_else(|| self.score(&terms.with_steps_in_place()))
    }

    /// The step that lowers the criterion most, of the families that do not scatter.
    fn best_step(&self, terms: &Terms, scatters: [bool; FAMILIES.len()]) -> Option<Candidate> {
        let current = self.score_with_steps(terms)?;
        let own = if current.parameters == terms.count() { terms.clone() } else { terms.with_steps_in_place() };
        // All of them differ from the current model by one step or by two coefficients.
        let score = |other: &Terms| self.score_from(other, &other.continued(&current.solution.parameters, &own));
        let of_parameter = |parameter: usize| {
            // Coefficients that a parameter does not need would speak for a step that takes their place.
            let mut without = terms.clone();
            without.held.push(parameter);
            let needs_none = score(&without).map_or(f64::INFINITY, |s| s.bic);
            let candidate = |from_run: usize| {
                let step = Step { parameter, from_run };
                if terms.steps.contains(&step) {
                    return None;
                }
                let mut with = terms.clone();
                with.steps.push(step);
                let beside = score(&with).map(|s| current.bic.min(needs_none) - s.bic);
                // That a step in place of two coefficients is one parameter less does not count for it: few calibrations at temperatures
                // that happen to follow each other look like a step.
                let mut in_place = with.clone();
                in_place.held.push(parameter);
                let in_place = score(&in_place).map(|s| (current.deviance - s.deviance).min(needs_none - s.bic));
                let gain = [beside, in_place].into_iter().flatten().fold(f64::NEG_INFINITY, f64::max);
                Some(Candidate { step, gain, replaces: needs_none - current.bic > CONVINCING })
            };
            (1..self.runs).filter_map(candidate).collect::<Vec<_>>()
        };
        let candidates: Vec<Vec<Candidate>> =
            (0..CONSTANT).into_par_iter().filter(|parameter| !scatters[parameter / 3]).map(of_parameter).collect();
        candidates.into_iter().flatten().reduce(|best, next| if next.gain > best.gain { next } else { best })
    }

    /// The model with all steps that are convincing, the first one that is not, and which families only scatter.
    fn with_steps(
        &self,
        terms: &Terms,
        is_kept: impl Fn(Step, &[Step]) -> bool,
    ) -> (Terms, Option<Candidate>, [bool; FAMILIES.len()]) {
        let (mut terms, mut scatters) = (terms.clone(), [false; FAMILIES.len()]);
        while terms.steps.len() < MOST_STEPS {
            match self.best_step(&terms, scatters) {
                Some(Candidate { step, gain, .. }) if gain > CONVINCING => {
                    if is_kept(step, &terms.steps) {
                        terms.steps.push(step);
                    } else {
                        scatters[step.parameter / 3] = true;
                    }
                }
                other => return (terms, other, scatters),
            }
        }
        (terms, None, scatters)
    }

    fn hypothesis(&self, explanation: Explanation, terms: &Terms) -> Option<ScalarHypothesis> {
        let scored = self.score_with_steps(terms)?;
        Some(ScalarHypothesis {
            explanation,
            parameters: scored.parameters,
            degrees_of_freedom: scored.solution.dof,
            residual_std_nt: scored.solution.residual_std,
            bic: scored.bic,
            chosen: false,
        })
    }
}

/// The rows, each calibration at one temperature, that agree with a fit to their own one, in which nothing can step; all of one that cannot
/// stand alone.
pub(super) fn agreeing_with_their_own(rows: &[Observation], runs: usize) -> Vec<bool> {
    let mut counts = vec![true; rows.len()];
    for run in 0..runs {
        let places: Vec<usize> = (0..rows.len()).filter(|i| rows[*i].run == run).collect();
        let own: Vec<Observation> = places.iter().map(|i| Observation { run: 0, ..rows[*i].clone() }).collect();
        let Ok(fitted) = fit(&own, &Terms::constant(), MOST_CONDITION) else { continue };
        for (place, used) in places.into_iter().zip(fitted.used) {
            counts[place] = used;
        }
    }
    counts
}

/// Looks for steps beside and in place of what the temperatures explain; `counts` says which rows agree with their own calibration, and `is_kept` of
/// a step and those before it whether it stays where calibrations may scatter.
pub(super) fn explain(
    rows: &[Observation],
    counts: &[bool],
    thermal: &Terms,
    is_kept: impl Fn(Step, &[Step]) -> bool,
) -> Explained {
    let comparison = Comparison {
        rows,
        moduli: rows.iter().map(|r| r.scalar.modulus_nt).collect(),
        weights: counts.iter().map(|c| f64::from(u8::from(*c))).collect(),
        runs: rows.iter().map(|r| r.run + 1).max().unwrap_or_default(),
    };
    let has_thermal = thermal.coil || thermal.rack;
    let (terms, next, scatters) = comparison.with_steps(thermal, is_kept);
    let alone = if has_thermal { comparison.with_steps(&Terms::constant(), |_, _| true).0 } else { terms.clone() };
    let mut hypotheses: Vec<ScalarHypothesis> = Vec::new();
    hypotheses.extend(comparison.hypothesis(Explanation::Nothing, &Terms::constant()));
    if has_thermal {
        hypotheses.extend(comparison.hypothesis(Explanation::Temperatures, thermal));
    }
    if !alone.steps.is_empty() {
        hypotheses.extend(comparison.hypothesis(Explanation::Steps, &alone));
    }
    if has_thermal && !terms.steps.is_empty() {
        hypotheses.extend(comparison.hypothesis(Explanation::Both, &terms));
    }
    let chosen = match (terms.steps.is_empty(), has_thermal) {
        (true, false) => Explanation::Nothing,
        (true, true) => Explanation::Temperatures,
        (false, false) => Explanation::Steps,
        (false, true) => Explanation::Both,
    };
    for hypothesis in &mut hypotheses {
        hypothesis.chosen = hypothesis.explanation == chosen;
    }
    // What the calibrations determine stays beside the step: a coefficient that is small is not zero.
    let terms = if comparison.score(&terms).is_some() { terms } else { terms.with_steps_in_place() };
    let undecided = next.filter(|next| next.gain > WORTH_TELLING && next.replaces).map(|next| next.step);
    Explained { terms, hypotheses, undecided, scatters }
}
