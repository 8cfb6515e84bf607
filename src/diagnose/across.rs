//! What is missing between runs: the parameters of several runs disagree where nothing may differ.
//!
//! Every run gives nine values: ln σ (3), offset (3, nT) and ξ (3, degrees). What is common to the runs of a sensor is fitted, with
//! polynomials of its temperature where the runs span temperatures; candidates are the first-order consequences of wrong facility
//! parameters (mathematics.md section 5, CH-GFZ-TR-2601 sections 7 and 9), of temperatures, of time and of a place beside the centre.
//! The scatter of each of the three classes has its own unknown scale. Where the runs bring uncertainties and do not contradict them,
//! these count as values without parameters; otherwise the scatter is known from repeats and from what the model leaves.

mod candidates;
mod scene;
mod search;
mod values;

use super::result::{DetectionLimit, Diagnosis, Map, NotIdentifiable, Parameter, Pictures, RunnerUp, ShapePoint, Step};
use super::{DiagnoseError, selection, words};
use crate::data::units::{COMPONENTS, three_digits};
use crate::fit::scan::{Fitted, Group, Score};
use crate::fit::statistics::{chi2_tail, fisher_tail};
use crate::model::effects::{Catalogue, EffectRef, Spec, UNKNOWN};
use crate::model::position::PAIRS;
use candidates::candidates;
use nalgebra::{DMatrix, DVector};
use scene::{Candidate, Scene, count};
use search::Search;
pub use values::RunValues;

/// Classes of values that have a scatter of their own.
const CLASSES: [&str; 3] = ["sigma", "offset", "xi"];
/// Uncertainties are not believed where the best models leave so unlikely a scatter.
const CONTRADICTED: f64 = 0.01;
/// As many orientations must agree before another one can stand out.
const LEAST_AGREEING: usize = 3;
/// Strength from which an effect is significant, about: what selection does to values depends on it little.
const LEAST: f64 = 4.0;

/// Sensor axis whose reading an angle between two axes changes: the later one, as ω is triangular.
fn axis_of(class: usize, i: usize) -> usize {
    if class == 2 { PAIRS[i].1 } else { i }
}

/// Diagnoses runs together.
///
/// # Errors
/// Why these runs show nothing together.
pub fn across(runs: &[RunValues], catalogue: &Catalogue) -> Result<Diagnosis, DiagnoseError> {
    let mut warnings = Vec::new();
    let has_others = |run: &RunValues| runs.iter().filter(|r| r.sensor == run.sensor).count() > 1;
    let (kept, alone): (Vec<RunValues>, Vec<RunValues>) = runs.iter().cloned().partition(has_others);
    if kept.is_empty() {
        return Err(DiagnoseError::SingleRuns);
    }
    warnings.extend(alone.iter().map(|r| format!("run {} is the only one of sensor {} and was not used", r.run, r.sensor)));
    let runs = kept.as_slice();
    let mut scene = Scene::new(runs);
    let (bank, mut not_identifiable) = candidates(&scene, catalogue);
    let left: f64 = (0..3).map(|c| scene.left(c, &[]).1).sum();
    if left < 3.0 {
        return Err(DiagnoseError::NoFreedom);
    }
    if runs.iter().any(|r| r.field_nt.is_none()) {
        warnings.push("a run states no field: the deviations of its scale factors and angles have no size in nT".to_owned());
    }
    scene.anchor(&bank, &mut warnings);
    let mut search = Search { scene, bank, vetoed: Vec::new() };
    let found = search.run();
    let scene = &search.scene;
    let all: Vec<&Candidate> = found.iter().map(|t| &t.0).collect();
    let fitted = scene.fitted(&all);
    let scales = scene.scales(&fitted);
    let mut maps = Vec::new();
    let mut steps: Vec<Step> = Vec::new();
    for index in 0..found.len() {
        let (step, map) = step(&search, &found, index, &scales);
        maps.push(map);
        steps.push(step);
    }
    let n = scene.count();
    let noise_floor_nt = std::array::from_fn(|a| {
        let mut sum = 0.0;
        for (r, run) in runs.iter().enumerate() {
            for class in 0..3 {
                for i in (0..3).filter(|i| axis_of(class, *i) == a) {
                    sum += (scene.std[(class * n + r) * 3 + i] * scales[class] * run.nt_per_unit(class)).powi(2);
                }
            }
        }
        (sum / n as f64).sqrt()
    });
    if remaining(scene, &all, &mut warnings) {
        steps.iter_mut().for_each(|s| s.wording = "consistent with");
    }
    if maps.is_empty() {
        let deviations = scene.held_out(&[], &scales);
        maps = (0..3).map(|a| map_of(scene, 1, a, 0, &deviations, &deviations, noise_floor_nt[a])).collect();
    }
    let detection_limits = limits(&search, &fitted, &scales, &steps, &mut not_identifiable);
    let orientations = count(&scene.orientation);
    warnings.push(format!(
        "{n} runs, {orientations} orientation{}; every run in turn was held out; nT of scale factors and angles at the largest field of the run",
        if orientations == 1 { "" } else { "s" }
    ));
    let left = if steps.is_empty() { maps.clone() } else { Vec::new() };
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: runs.iter().map(|r| r.run.clone()).collect(),
        noise_floor_nt,
        noise: None,
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits,
        warnings,
        reading_ent: [[f64::INFINITY, f64::NEG_INFINITY]; 3],
        maps,
        response: None,
        pictures: Pictures { left, ..Pictures::default() },
    })
}

/// Estimates of a term beside the others: the shortest solution, so that what the runs do not determine is not in it.
fn estimate(scene: &Scene, terms: &[&Candidate], at: usize, scales: &[f64; 3]) -> Vec<(f64, f64)> {
    let n = 3 * scene.count();
    let weighted = |m: &DMatrix<f64>| DMatrix::from_fn(m.nrows(), m.ncols(), |r, c| m[(r, c)] / (scene.std[r] * scales[r / n]));
    let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, t)| *t).collect();
    let y = weighted(&DMatrix::from_column_slice(scene.y.len(), 1, scene.y.as_slice())).column(0).into_owned();
    let beside = Fitted::new(&y, &weighted(&scene.model(&others)), [0, n, 2 * n, 3 * n]);
    let left = beside.beside(&weighted(&terms[at].columns));
    let svd = left.svd(true, true);
    let least = 1e-7 * svd.singular_values.max();
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

fn map_of(scene: &Scene, class: usize, i: usize, step: usize, before: &DVector<f64>, after: &DVector<f64>, noise_nt: f64) -> Map {
    let n = scene.count();
    let nt =
        |d: &DVector<f64>| (0..n).map(|r| d[(class * n + r) * 3 + i] * scene.runs[r].nt_per_unit(class)).collect::<Vec<f64>>();
    let what = ["sensitivity", "offset", "angle"][class];
    Map {
        covariate: format!("run in the order given ({what})"),
        unit: String::new(),
        axis: axis_of(class, i),
        x: (1..=n).map(|r| r as f64).collect(),
        before_nt: nt(before),
        after_nt: nt(after),
        noise_nt,
        step,
    }
}

fn step(search: &Search, found: &[(Candidate, f64, usize)], at: usize, scales: &[f64; 3]) -> (Step, Map) {
    let (scene, n) = (&search.scene, search.scene.count());
    let terms: Vec<&Candidate> = found.iter().map(|t| &t.0).collect();
    let others: Vec<&Candidate> = terms.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, t)| *t).collect();
    let candidate = terms[at];
    let without = scene.fitted(&others);
    let groups = search.groups(&without);
    let own_group = scene.group(&without, candidate);
    let score: Score = without.score(&own_group);
    let explanations = search.explanations(&without, &groups, &others);
    let own =
        explanations.iter().find(|e| e.key == candidate.key()).map_or(score.evidence, |e| e.evidence).max(score.evidence - 3.0);
    let mut ambiguous: Vec<EffectRef> = Vec::new();
    let mut runners_up = Vec::new();
    for e in explanations.iter().filter(|e| e.key != candidate.key()) {
        let correlation = Fitted::correlation(&groups[e.best], &own_group);
        let effect = search.bank[e.best].effect;
        let twin = correlation > super::ALIKE && groups[e.best].count() == own_group.count() && !effect.is_unknown();
        if (e.evidence > own - super::APART || twin) && effect != candidate.effect && !ambiguous.contains(&effect) {
            ambiguous.push(effect);
        }
        if runners_up.len() < 5 {
            runners_up.push(RunnerUp { effect: e.key.clone(), log_ratio: e.evidence - own, correlation });
        }
    }
    let once = counted_once(scene, &others, candidate);
    let values = estimate(scene, &terms, at, scales);
    let parameters: Vec<Parameter> = candidate
        .parameters
        .iter()
        .zip(selection::corrected(&values, score.strength, LEAST))
        .map(|((name, unit), (value, std))| Parameter { name: name.clone(), value, std: Some(std), unit: (*unit).to_owned() })
        .collect();
    let contribution = &candidate.columns * DVector::from_fn(values.len(), |j, _| values[j].0);
    let classes = Search::classes(&[candidate], n);
    let (before, after) = (scene.held_out(&others, scales), scene.held_out(&terms, scales));
    let (gap_before, gap_after) = (scene.gap(&before, scales, &terms, classes).0, scene.gap(&after, scales, &terms, classes).0);
    // Drawn and told where the contribution is largest.
    let in_nt = |row: usize| contribution[row] * scene.runs[(row / 3) % n].nt_per_unit(row / (3 * n));
    let size = |row: usize| in_nt(row).abs() + 1e-9 * (contribution[row] / scene.std[row]).abs().min(1.0);
    let most = (0..9 * n).max_by(|a, b| size(*a).total_cmp(&size(*b))).unwrap_or(0);
    let (class, r, i) = (most / (3 * n), (most / 3) % n, most % 3);
    let noise_nt = scene.std[most] * scales[class] * scene.runs[r].nt_per_unit(class);
    let axis = COMPONENTS[axis_of(class, i)];
    let place = format!(
        "{} of {axis}, run {} in {}: up to {:.2} nT ({:.1} noise)",
        ["sensitivity", "offset", "angle"][class],
        scene.runs[r].run,
        scene.runs[r].position.orientation(),
        in_nt(most).abs(),
        (contribution[most] / (scene.std[most] * scales[class])).abs()
    );
    let is_unknown = candidate.effect.is_unknown();
    let certain = ambiguous.is_empty() && score.strength > super::CERTAIN && once.is_none_or(|p| p < 0.01) && !is_unknown;
    let shape = if is_unknown {
        let own_row = |k: usize| (class * n + k) * 3 + i;
        let point = |k: usize| ShapePoint {
            covariate: (k + 1) as f64,
            residual_nt: contribution[own_row(k)] * scene.runs[k].nt_per_unit(class),
            std_nt: scene.std[own_row(k)] * scales[class] * scene.runs[k].nt_per_unit(class),
        };
        (0..n).map(point).collect()
    } else {
        Vec::new()
    };
    let mut step = Step {
        effect: candidate.effect,
        axes: candidate.spec.axis_names().into_iter().map(str::to_owned).collect(),
        next_measurement: words::next_measurement(candidate.effect, &ambiguous),
        ambiguous_with: ambiguous,
        // What runs disagree by is no term of a reading: a model file has no use for it.
        form: Spec { axes: Vec::new(), ..candidate.spec.clone() },
        further: Vec::new(),
        parameters,
        place,
        p_value: score.p_value(),
        trials: found[at].2,
        p_value_corrected: found[at].1,
        gap_before,
        gap_after,
        strength_k: score.strength,
        family: candidate.effect.about().family.name(),
        wording: if certain { "is" } else { "consistent with" },
        runners_up,
        sentence: String::new(),
        covariate: candidate.covariate.map(str::to_owned),
        shape,
    };
    step.sentence = if is_unknown {
        format!(
            "{} does not agree with the others, by up to {:.2} nT, in a way that no effect of the catalogue explains; without it chi square over degrees of freedom of the others, held out, goes from {:.2} to {:.2}.",
            step.form.form,
            in_nt(most).abs(),
            step.gap_before.chi2_per_dof,
            step.gap_after.chi2_per_dof
        )
    } else {
        words::sentence(&step)
    };
    if let Some(p) = once.filter(|_| !is_unknown) {
        step.sentence.push_str(&format!(
            " Repeats of an orientation tell the noise; where every orientation counts once and the scatter between them is the noise, the probability is {p:.1e}."
        ));
    }
    let map = map_of(scene, class, i, at, &before, &after, noise_nt);
    (step, map)
}

/// Probability of a term where every orientation counts once, with the scatter between the orientations as noise: what would be left
/// of the evidence if the orientations differed by themselves. `None` without repeats.
fn counted_once(scene: &Scene, others: &[&Candidate], candidate: &Candidate) -> Option<f64> {
    let (n, g) = (scene.count(), count(&scene.orientation));
    if n == g {
        return None;
    }
    let number = |o: usize| scene.orientation.iter().filter(|r| **r == o).count() as f64;
    let mean = DMatrix::from_fn(9 * g, 9 * n, |row, column| {
        let (o, r) = ((row / 3) % g, (column / 3) % n);
        let same = row / (3 * g) == column / (3 * n) && row % 3 == column % 3 && scene.orientation[r] == o;
        if same { 1.0 / number(o) } else { 0.0 }
    });
    let fitted = Fitted::new(&(&mean * &scene.y), &(&mean * scene.model(others)), [0, 3 * g, 6 * g, 9 * g]);
    let group = fitted.group(&(&mean * &candidate.columns));
    let score = fitted.score(&group);
    let left: f64 = fitted.freedom().iter().sum();
    (left > score.count as f64 + 1.0).then(|| score.p_value())
}

/// Whether the runs still disagree; says by how much.
fn remaining(scene: &Scene, terms: &[&Candidate], warnings: &mut Vec<String>) -> bool {
    let (n, orientations) = (scene.count(), count(&scene.orientation));
    let mut disagree = false;
    for class in 0..3 {
        let (sum, freedom) = scene.left(class, terms);
        // What every orientation may have of its own leaves the repeats.
        let own = DMatrix::from_fn(9 * n, 9 * orientations, |row, c| {
            let (k, r, i) = (row / (3 * n), (row / 3) % n, row % 3);
            if scene.orientation[r] == c / 9 && (c % 9) / 3 == k && c % 3 == i { 1.0 } else { 0.0 }
        });
        let free = Candidate {
            effect: UNKNOWN,
            covariate: None,
            cause: None,
            spec: Spec::new("", &[]),
            parameters: Vec::new(),
            columns: own,
            alone: None,
        };
        let with: Vec<&Candidate> = terms.iter().copied().chain(std::iter::once(&free)).collect();
        let (within, within_freedom) = scene.left(class, &with);
        let (between, between_freedom) = (sum - within, freedom - within_freedom);
        if between_freedom < 0.5 {
            continue;
        }
        let (p, noise) = if within_freedom > 1.5 {
            let noise = within / within_freedom;
            (fisher_tail(between / between_freedom / noise, [between_freedom, within_freedom]), noise)
        } else if scene.anchors[class] > 0 {
            (chi2_tail(between, between_freedom), 1.0)
        } else {
            continue;
        };
        if p < CONTRADICTED {
            disagree = true;
            let ratio = (between / between_freedom / noise).sqrt();
            warnings.push(format!(
                "{}: the orientations still differ by {ratio:.1} times what repeats let expect (p = {p:.1e}), and nothing that was tried explains it",
                CLASSES[class]
            ));
        }
    }
    disagree
}

fn limits(
    search: &Search,
    fitted: &Fitted,
    scales: &[f64; 3],
    steps: &[Step],
    none: &mut Vec<NotIdentifiable>,
) -> Vec<DetectionLimit> {
    let (scene, n) = (&search.scene, search.scene.count());
    let mut limits = Vec::new();
    let mut effects: Vec<EffectRef> = search.bank.iter().map(|c| c.effect).filter(|e| !e.is_unknown()).collect();
    effects.dedup();
    for effect in effects.into_iter().filter(|effect| steps.iter().all(|s| s.effect != *effect)) {
        let own: Vec<&Candidate> = search.bank.iter().filter(|c| c.effect == effect).collect();
        let groups: Vec<Group> = own.iter().map(|c| scene.group(fitted, c)).collect();
        if groups.iter().all(|g| g.surviving < super::SHOWN) {
            let most = groups.iter().map(|g| g.surviving).fold(0.0, f64::max);
            let reason = format!("{:.1} % of it is left beside the fitted parameters", 100.0 * most);
            none.push(NotIdentifiable { effect, reason });
            continue;
        }
        for axis in 0..3 {
            let best = own
                .iter()
                .zip(&groups)
                .filter(|(c, g)| c.spec.axes == [axis] && c.columns.ncols() == 1 && g.surviving >= super::SHOWN)
                .map(|(c, g)| {
                    let class = (0..3).find(|k| c.columns.rows(k * 3 * n, 3 * n).norm() > 0.0).unwrap_or(0);
                    let least = super::FOUND_90 * scales[class] / g.norms[0];
                    let size = (0..9 * n)
                        .map(|row| c.columns[(row, 0)].abs() * scene.runs[(row / 3) % n].nt_per_unit(class))
                        .fold(0.0, f64::max);
                    (least * size, least, *c)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((amplitude_nt, least, c)) = best {
                let (name, unit) = &c.parameters[0];
                limits.push(DetectionLimit {
                    effect,
                    axis: COMPONENTS[axis].to_owned(),
                    amplitude_nt,
                    parameter: format!("{name} = {} {unit}", three_digits(least)).trim_end().to_owned(),
                });
            }
        }
    }
    limits
}
