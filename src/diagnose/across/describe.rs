//! The description of a term between runs.

use super::problem::{Comparison, Term, chosen_candidates};
use super::run_set::{RunCandidate, RunSet, count};
use super::{CLASSES_IN_WORDS, axis_of};
use crate::data::units::COMPONENTS;
use crate::diagnose::candidate::without;
use crate::diagnose::problem::Description;
use crate::diagnose::result::{Map, ShapePoint, Telling};
use crate::diagnose::selection;
use crate::diagnose::steps::{Facts, Name, Significance, linear_parameters};
use crate::fit::scan::Fitted;
use crate::model::effects::Spec;
use nalgebra::{DMatrix, DVector};

/// A name is doubted where the orientations, each counted once, show the effect with a larger probability of noise.
const DOUBTED: f64 = 0.01;
/// What the runs do not determine: singular values below this part of the largest.
const UNDETERMINED: f64 = 1e-7;

/// What a term contributes to the values of the runs, and the value on which it is largest, nT.
struct Contribution {
    values: DVector<f64>,
    class: usize,
    run: usize,
    i: usize,
    size_nt: f64,
}

impl Contribution {
    fn new(set: &RunSet, candidate: &RunCandidate, amplitudes: &[(f64, f64)]) -> Self {
        let n = set.count();
        let values = &candidate.columns * DVector::from_fn(amplitudes.len(), |j, _| amplitudes[j].0);
        let in_nt = |row: usize| values[row] * set.runs[(row / 3) % n].nt_per_unit(row / (3 * n));
        // Without a field scale factors and angles have no size in nT: the size beside the uncertainty decides.
        let size = |row: usize| in_nt(row).abs() + 1e-9 * (values[row] / set.std[row]).abs().min(1.0);
        let most = (0..9 * n).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
        let size_nt = in_nt(most).abs();
        Self { values, class: most / (3 * n), run: (most / 3) % n, i: most % 3, size_nt }
    }

    /// Row of the same value of another run.
    fn row(&self, set: &RunSet, run: usize) -> usize {
        (self.class * set.count() + run) * 3 + self.i
    }

    /// Where it is largest, in words.
    fn place(&self, set: &RunSet, scales: &[f64; 3]) -> String {
        let (run, most) = (&set.runs[self.run], self.row(set, self.run));
        format!(
            "{} of {}, run {} in {}: up to {:.2} nT ({:.1} noise)",
            CLASSES_IN_WORDS[self.class],
            COMPONENTS[axis_of(self.class, self.i)],
            run.run,
            run.position.orientation(),
            self.size_nt,
            (self.values[most] / (set.std[most] * scales[self.class])).abs()
        )
    }

    /// The same value of every run.
    fn shape(&self, set: &RunSet, scales: &[f64; 3]) -> Vec<ShapePoint> {
        let point = |run: usize| ShapePoint {
            covariate: (run + 1) as f64,
            residual_nt: self.values[self.row(set, run)] * set.runs[run].nt_per_unit(self.class),
            std_nt: set.std[self.row(set, run)] * scales[self.class] * set.runs[run].nt_per_unit(self.class),
        };
        (0..set.count()).map(point).collect()
    }
}

/// The facts of a chosen term beside all others.
pub(super) fn describe(comparison: &Comparison, fitted: &Fitted, chosen: &[Term], index: usize, number: usize) -> Description {
    let (set, term) = (&comparison.set, &chosen[index]);
    let terms = chosen_candidates(chosen);
    let (candidate, others) = (terms[index], without(&terms, &[index]));
    let scales = set.scales(fitted);
    let without = set.fitted(&others);
    let own_group = set.group(&without, candidate);
    let scored = comparison.scored_as_rivals(&without, &others, &own_group);
    let rivals = scored.rivals(candidate, &own_group);
    let score = rivals.score;
    let is_unknown = candidate.effect.is_unknown();
    let once = counted_once(set, &others, candidate);
    let amplitudes = estimate(set, &terms, index, &scales);
    let shown = selection::corrected(&amplitudes, score.strength, term.threshold.strength(score.strength));
    let contribution = Contribution::new(set, candidate, &amplitudes);
    let [before, after] = [&others, &terms].map(|terms| set.held_out(terms, &scales));
    let classes = set.classes(&[candidate]);
    let gaps = [&before, &after].map(|deviations| set.gap(deviations, &scales, &terms, classes).0);
    let sentence = format!(
        "{} does not agree with the others, by up to {:.2} nT, in a way that no effect of the catalogue explains; without it chi square over degrees of freedom of the others, held out, goes from {:.2} to {:.2}.",
        candidate.spec.form, contribution.size_nt, gaps[0].chi2_per_dof, gaps[1].chi2_per_dof
    );
    let remark = |p: f64| {
        format!(
            " Repeats of an orientation tell the noise; where every orientation counts once and the scatter between them is the noise, the probability is {p:.1e}."
        )
    };
    let significance = Significance {
        p_value: score.p_value(),
        trials: term.trials,
        p_value_corrected: term.p_global,
        strength_k: score.strength,
    };
    // What runs disagree by is no term of a reading: a model file has no use for its axes.
    let form = Spec { axes: Vec::new(), ..candidate.spec.clone() };
    let facts = Facts {
        axes: candidate.spec.axis_names(),
        parameters: linear_parameters(candidate.parameters.iter().map(|(name, unit)| (name.as_str(), *unit)), &shown),
        place: contribution.place(set, &scales),
        gaps,
        ambiguous_with: rivals.ambiguous(),
        runners_up: rivals.runners_up(),
        name: if is_unknown || once.is_some_and(|p| p >= DOUBTED) { Name::Doubted } else { Name::ByStrength },
        telling: if is_unknown {
            Telling::always(sentence)
        } else {
            Telling { own: None, remark: once.map(remark).unwrap_or_default() }
        },
        covariate: candidate.covariate.clone(),
        shape: if is_unknown { contribution.shape(set, &scales) } else { Vec::new() },
        shape_names: if is_unknown { names(set) } else { Vec::new() },
        ..Facts::new(candidate.effect, form, significance)
    };
    let (class, i) = gains_most(set, classes, [&before, &after], &scales);
    let of_run = |run: usize| set.std[(class * set.count() + run) * 3 + i] * scales[class] * set.runs[run].nt_per_unit(class);
    let map = map_of(set, class, i, number, [&before, &after], of_run(contribution.run));
    Description { facts, map, evidence: None }
}

/// Estimates of a term beside the others: the shortest solution, so that what the runs do not determine is not in it.
fn estimate(set: &RunSet, terms: &[&RunCandidate], at: usize, scales: &[f64; 3]) -> Vec<(f64, f64)> {
    let n = 3 * set.count();
    let weighted = |m: &DMatrix<f64>| DMatrix::from_fn(m.nrows(), m.ncols(), |r, c| m[(r, c)] / (set.std[r] * scales[r / n]));
    let y = weighted(&DMatrix::from_column_slice(set.y.len(), 1, set.y.as_slice())).column(0).into_owned();
    let beside = Fitted::new(&y, &weighted(&set.model(&without(terms, &[at]))), [0, n, 2 * n, 3 * n]);
    let left = beside.beside(&weighted(&terms[at].columns));
    let svd = left.svd(true, true);
    let least = UNDETERMINED * svd.singular_values.max();
    let Some((u, v)) = svd.u.as_ref().zip(svd.v_t.as_ref()) else { return Vec::new() };
    (0..v.ncols())
        .map(|p| {
            let seen = (0..svd.singular_values.len()).filter(|k| svd.singular_values[*k] > least);
            seen.fold((0.0, 0.0_f64), |(value, std), k| {
                let along = v[(k, p)] / svd.singular_values[k];
                (value + along * u.column(k).dot(&beside.residual), std.hypot(along))
            })
        })
        .collect()
}

/// Probability of a term where every orientation counts once, with the scatter between the orientations as noise: what would be left
/// of the evidence if the orientations differed by themselves. `None` without repeats.
fn counted_once(set: &RunSet, others: &[&RunCandidate], candidate: &RunCandidate) -> Option<f64> {
    let (n, g) = (set.count(), count(&set.orientation));
    if n == g {
        return None;
    }
    let number = |o: usize| set.orientation.iter().filter(|r| **r == o).count() as f64;
    let mean = DMatrix::from_fn(9 * g, 9 * n, |row, column| {
        let (o, r) = ((row / 3) % g, (column / 3) % n);
        let same = row / (3 * g) == column / (3 * n) && row % 3 == column % 3 && set.orientation[r] == o;
        if same { 1.0 / number(o) } else { 0.0 }
    });
    let fitted = Fitted::new(&(&mean * &set.y), &(&mean * set.model(others)), [0, 3 * g, 6 * g, 9 * g]);
    let group = fitted.group(&(&mean * &candidate.columns));
    let score = fitted.score(&group);
    let left: f64 = fitted.freedom().iter().sum();
    (left > score.count as f64 + 1.0).then(|| score.p_value())
}

/// Names of the runs.
fn names(set: &RunSet) -> Vec<String> {
    set.runs.iter().map(|run| run.run.clone()).collect()
}

/// The value, its class and component, of which a term takes most off the held-out deviations.
fn gains_most(set: &RunSet, classes: [bool; 3], [before, after]: [&DVector<f64>; 2], scales: &[f64; 3]) -> (usize, usize) {
    let n = set.count();
    let gain = |&(class, i): &(usize, usize)| -> f64 {
        let of_run = |row: usize| (before[row].powi(2) - after[row].powi(2)) / (set.std[row] * scales[class]).powi(2);
        (0..n).map(|run| of_run((class * n + run) * 3 + i)).sum()
    };
    let values = (0..3).filter(|class| classes[*class]).flat_map(|class| (0..3).map(move |i| (class, i)));
    values.max_by(|a, b| gain(a).total_cmp(&gain(b))).unwrap_or_default()
}

/// The largest probability of noise of all terms where every orientation counts once, if it is one that doubts a name.
pub(super) fn by_orientations(set: &RunSet, terms: &[&RunCandidate]) -> Option<f64> {
    let named = (0..terms.len()).filter(|index| !terms[*index].effect.is_unknown());
    let largest = named.filter_map(|index| counted_once(set, &without(terms, &[index]), terms[index])).reduce(f64::max)?;
    (largest >= DOUBTED).then_some(largest)
}

/// Deviations of one value of every run from models that have not seen the run: without and with a term.
pub(super) fn map_of(set: &RunSet, class: usize, i: usize, step: usize, deviations: [&DVector<f64>; 2], noise_nt: f64) -> Map {
    let n = set.count();
    let nt = |d: &DVector<f64>| (0..n).map(|r| d[(class * n + r) * 3 + i] * set.runs[r].nt_per_unit(class)).collect::<Vec<f64>>();
    let [before_nt, after_nt] = deviations.map(nt);
    Map {
        covariate: format!("run ({})", CLASSES_IN_WORDS[class]),
        unit: String::new(),
        axis: axis_of(class, i),
        x: (1..=n).map(|r| r as f64).collect(),
        before_nt,
        after_nt,
        noise_nt,
        step,
        names: names(set),
    }
}
