//! Whether the facility stepped between two calibrations, or follows a temperature: both are fitted to the same rows and compared by their
//! evidence.
//!
//! The evidence is the Bayesian information criterion, `n ln(S / n) + k ln n` for n rows, k parameters and the sum S of the squared
//! residuals: half of a difference is about the logarithm of the odds. A step that nobody expected has to be worth more than what any of the
//! many places where it could be would gain by chance.

use super::terms::{CONSTANT, Modulus, Observation, Step, Terms};
use super::{MOST_CONDITION, MOST_THERMAL_CONDITION, start};
use crate::fit::{Limits, NonlinearSolution, nonlinear};
use crate::model::facility_calibration::{Explanation, ScalarHypothesis};

/// A step has to lower the criterion by this much: odds of e^5 to 1, and by chance at most once in 200 sets of four calibrations.
const CONVINCING: f64 = 10.0;
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
}

/// A fit to the rows that count, by its evidence.
struct Scored {
    bic: f64,
    parameters: usize,
    solution: NonlinearSolution,
}

/// The rows that are compared: those that agree with their own calibration.
struct Comparison<'a> {
    rows: &'a [Observation],
    moduli: Vec<f64>,
    weights: Vec<f64>,
}

impl Comparison<'_> {
    fn score(&self, terms: &Terms) -> Option<Scored> {
        let most = if terms.coil || terms.rack { MOST_THERMAL_CONDITION } else { MOST_CONDITION };
        let model = Modulus { rows: self.rows, terms };
        let limits = Limits { max_condition: most };
        let solution = nonlinear::solve(&model, &self.moduli, Some(&self.weights), &start(self.rows, terms), &limits).ok()?;
        let rows: f64 = self.weights.iter().sum();
        let squares = solution.residual_std.powi(2) * solution.dof as f64;
        let parameters = terms.count();
        Some(Scored { bic: rows * (squares / rows).ln() + parameters as f64 * rows.ln(), parameters, solution })
    }

    /// The better one of steps beside the temperature coefficients and in place of those of what steps.
    fn best_with_steps(&self, terms: &Terms) -> Option<f64> {
        let both = [terms.clone(), terms.with_steps_in_place()];
        both.iter().filter_map(|t| self.score(t)).map(|s| s.bic).reduce(f64::min)
    }

    fn hypothesis(&self, explanation: Explanation, terms: &Terms) -> Option<ScalarHypothesis> {
        let scored = self.score(terms)?;
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

/// Looks for steps beside and in place of what the temperatures explain; `counts` says which rows agree with their own calibration.
pub(super) fn explain(rows: &[Observation], counts: &[bool], thermal: &Terms) -> Explained {
    let comparison = Comparison {
        rows,
        moduli: rows.iter().map(|r| r.scalar.modulus_nt).collect(),
        weights: counts.iter().map(|c| f64::from(u8::from(*c))).collect(),
    };
    let runs = rows.iter().map(|r| r.run + 1).max().unwrap_or_default();
    let mut terms = thermal.clone();
    let mut undecided: Option<(f64, Step)> = None;
    let mut best_step: Option<(f64, Step)> = None;
    while terms.steps.len() < MOST_STEPS {
        let Some(current) = comparison.best_with_steps(&terms) else { break };
        let mut best: Option<(f64, Step)> = None;
        for parameter in 0..CONSTANT {
            // Coefficients that a parameter does not need would speak for a step that takes their place.
            let mut without = terms.clone();
            without.held.push(parameter);
            let needs_none = comparison.score(&without).map_or(f64::INFINITY, |s| s.bic);
            let before = current.min(needs_none);
            for from_run in 1..runs {
                let step = Step { parameter, from_run };
                if terms.steps.contains(&step) {
                    continue;
                }
                let mut with = terms.clone();
                with.steps.push(step);
                let Some(after) = comparison.best_with_steps(&with) else { continue };
                let gain = before - after;
                if best.is_none_or(|(most, _)| gain > most) {
                    best = Some((gain, step));
                }
            }
        }
        let Some((gain, step)) = best else { break };
        if terms.steps.is_empty() {
            best_step = best;
        }
        if gain <= CONVINCING {
            undecided = best.filter(|_| gain > 0.0 && (terms.coil || terms.rack));
            break;
        }
        terms.steps.push(step);
    }
    // What is told of the two hypotheses: with the steps that were found, or with the likeliest one.
    let mut stepping = terms.clone();
    if stepping.steps.is_empty() {
        stepping.steps.extend(best_step.map(|(_, step)| step));
    }
    let has_thermal = thermal.coil || thermal.rack;
    let mut hypotheses: Vec<ScalarHypothesis> = Vec::new();
    hypotheses.extend(comparison.hypothesis(Explanation::Nothing, &Terms::constant()));
    if has_thermal {
        hypotheses.extend(comparison.hypothesis(Explanation::Temperatures, thermal));
    }
    if !stepping.steps.is_empty() {
        hypotheses.extend(comparison.hypothesis(Explanation::Steps, &stepping.with_steps_in_place()));
        if has_thermal {
            hypotheses.extend(comparison.hypothesis(Explanation::Both, &stepping));
        }
    }
    // What the calibrations determine stays beside the step: a coefficient that is small is not zero.
    let beside = has_thermal && comparison.score(&terms).is_some();
    let chosen = match (terms.steps.is_empty(), has_thermal, beside) {
        (true, false, _) => Explanation::Nothing,
        (true, true, _) => Explanation::Temperatures,
        (false, _, true) => Explanation::Both,
        (false, ..) => Explanation::Steps,
    };
    for hypothesis in &mut hypotheses {
        hypothesis.chosen = hypothesis.explanation == chosen;
    }
    let terms = if chosen == Explanation::Steps { terms.with_steps_in_place() } else { terms };
    Explained { terms, hypotheses, undecided: undecided.map(|(_, step)| step) }
}
