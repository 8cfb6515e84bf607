//! Where simulated and measured data disagree, which effect is missing, and how the gap shrinks with it.
//!
//! A run becomes rows with covariates and a linear model ([`scene`]); jumps of thermistors are taken off ([`faults`]). What happens inside the
//! plateaus is looked for in the samples ([`samples`]) and taken off. The noise of the means is estimated before anything is named; then
//! every term of the catalogue ([`crate::model::effects`]) and a smooth function of every covariate are scored beside the model ([`search`]),
//! the evidence of the best is averaged over all noise that the readings allow, the best term is added, all is fitted again, and terms
//! are dropped and swapped, until nothing significant is left. What is accepted has predicted stretches that were held out. Results are
//! plain structs ([`result`]).

pub mod across;
pub mod branches;
pub mod faults;
pub mod freq;
pub mod inside_maps;
pub mod known;
pub mod result;
pub mod samples;
pub mod scene;
pub mod search;
pub mod selection;
pub mod signature;
pub mod where_map;
pub mod words;

use crate::campaign::Campaign;
use crate::formats::facility::Facility;
use crate::model::effects::in_sine::InSine;
use crate::model::effects::thermal_lag::shifted;
use crate::model::effects::{self, CATALOGUE, Record, Row, Spec};
use crate::plateau::Plateaus;
use crate::run::{Kind, Run, interpolate};
use crate::units::COMPONENTS;
use nalgebra::DMatrix;
use result::{
    Branches, DetectionLimit, Diagnosis, Evidence, Gap, Map, NotIdentifiable, Parameter, Pictures, RunnerUp, ShapePoint, Step,
};
use samples::Inside;
pub use scene::Samples;
use scene::Scene;
use search::{Candidate, HeldOut, Search, State, Term};

/// Two explanations are told apart by this ratio of likelihoods (logarithm).
const APART: f64 = 4.605;
/// Groups that look alike to this degree are one.
const ALIKE: f64 = 0.99;
/// Signal to noise ratio of a group that is found with 90 %, at one false alarm in a hundred runs.
const FOUND_90: f64 = 5.2;
/// From here on a name may be called certain.
const CERTAIN: f64 = 10.0;
/// From this many standard deviations on a drift beside white noise is told of.
const HIDDEN: f64 = 4.0;
/// Rivals of a step whose evidence is drawn.
const RIVALS: usize = 7;
/// An effect of which less than this part is left beside the fitted parameters cannot be shown.
const SHOWN: f64 = 0.02;

/// How a diagnosis is made.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The facility that turns settings into the reference field.
    pub facility: Option<Facility>,
    /// Effects that are known already. What acts between the means is fitted again; what acts inside the plateaus is taken off.
    pub given: Vec<Given>,
}

/// An effect that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// Id.
    pub id: &'static str,
    /// Form, axes and shape.
    pub spec: Spec,
    /// Values of the linear parameters.
    pub values: Vec<f64>,
    /// What it does to sines.
    pub in_sine: Option<InSine>,
    /// Runs in which it was found.
    pub runs: Vec<String>,
}

/// Effects that show inside the plateaus and are known from there.
pub const INSIDE: [&str; 4] = ["settling", "time_shift", "heater_pwm", "interference_tone"];

impl Given {
    /// Why it does not hold for a run: it belongs to the times of others.
    #[must_use]
    pub fn of_another(&self, run: &str) -> Option<String> {
        let of_others = known::is_of_one_run(self.id, &self.spec.form) && !self.runs.iter().any(|r| r == run);
        let runs = self.runs.join(", ");
        of_others.then(|| format!("{} holds for the times of the run in which it was found ({runs}) alone", self.id))
    }

    fn is_inside(&self) -> bool {
        INSIDE.contains(&self.id) && self.in_sine.is_none()
    }
}

/// Diagnoses one run with fields in steps, a sweep, sines, or a run in zero field.
///
/// # Errors
/// Why the run cannot be looked at.
pub fn run(
    run: &Run,
    plateaus: &Plateaus,
    samples: Option<&Samples>,
    campaign: &Campaign,
    options: &Options,
) -> Result<Diagnosis, String> {
    if run.header.kind == Kind::Frequency {
        return freq::run(run, samples, campaign, options);
    }
    let samples = samples.filter(|s| !s.t_s.is_empty());
    let mut scene = Scene::new(run, plateaus, samples, campaign, options.facility.as_ref()).map_err(|e| e.0)?;
    let mut warnings = std::mem::take(&mut scene.warnings);
    let mut steps: Vec<Step> = std::mem::take(&mut scene.faults);
    let known: Vec<Inside> = options.given.iter().filter(|g| g.is_inside()).map(Inside::known).collect();
    let count_known = known.len();
    let mut inside: Vec<Inside> = known;
    let settings: Vec<[f64; 2]> = plateaus
        .list
        .iter()
        .filter(|p| p.setting.frequency_hz == 0.0)
        .map(|p| [p.setting.t_start_s, p.setting.t_end_s])
        .collect();
    let known_lag = options.given.iter().find(|g| g.id == "thermal_lag");
    if let Some(lag) = known_lag {
        scene.follow(&lag.spec.form, lag.spec.get("lag").unwrap_or(0.0));
    }
    let between = options.given.iter().filter(|g| !g.is_inside() && g.id != "thermal_lag");
    let given: Vec<Candidate> = between.filter_map(|g| candidate(&scene.record, g.id, &g.spec)).collect();

    let mut pictures = Pictures::default();
    let design_before = scene.design.clone();
    let raw = corrected(&scene, &inside);
    // A lag changes the temperatures that the model itself is a polynomial of: it is looked for first, and then built in.
    let mut has_lag = known_lag.is_some();
    if scene.record.thermal.is_some()
        && !has_lag
        && let Some((step, branches, evidence)) = find_lag(&mut scene, &raw, &given, steps.len())
    {
        has_lag = true;
        steps.push(step);
        pictures.branches = Some(branches);
        pictures.evidence.push(evidence);
    }
    // What happens inside the plateaus next: its consequences for the means are known then.
    let steady = samples.map(|samples| scene.at_steady_temperature(samples, &settings));
    let samples = steady.as_deref();
    if let Some(samples) = samples {
        if scene.record.has_fields() {
            let shift = samples::displaced(&scene, samples);
            let skip_s = shift.as_ref().and_then(|s| s.spec.get("shift")).map_or(0.0, f64::abs) * 1.5;
            let transient = samples::transients(&scene, samples, &settings, skip_s);
            let is_known = |found: &Inside| inside.iter().any(|k: &Inside| k.id == found.id);
            let new: Vec<Inside> = [shift, transient].into_iter().flatten().filter(|f| !is_known(f)).collect();
            for mut found in new {
                samples::measure(&scene, samples, &settings, &inside, &mut found);
                inside.push(found);
            }
        }
        let known = inside.clone();
        inside.extend(samples::periodic(&scene, samples, &known));
    }
    let readings = corrected(&scene, &inside);
    let mut search = Search::new(&scene, readings);
    if has_lag {
        search.leave_out(|c| c.id == "thermal_lag");
    }
    if scene.record.has_samples {
        // The samples have told already.
        search.leave_out(|c| ["settling", "time_shift"].contains(&c.id));
    }
    let (terms, state) = search.run(&given).ok_or("the noise of the plateau means has no estimate")?;
    let all: Vec<&Candidate> = given.iter().chain(terms.iter().map(|t| &t.candidate)).collect();

    let row_std = search.row_std(&state, &all);
    let noise_floor_nt = std::array::from_fn(|a| row_std[0][a] * scene.nt_per_ent[a]);
    let mut maps = Vec::new();
    for (index, found) in inside.iter().enumerate().skip(count_known) {
        let picture = samples.and_then(|s| inside_maps::of(&scene, s, &settings, &inside[..index], found, steps.len()));
        pictures.inside.extend(picture);
        steps.push(inside_step(found, &scene));
    }
    let found_before = steps.len();
    for (index, term) in terms.iter().enumerate() {
        let at = given.len() + index;
        steps.push(term_step(&search, &state, &all, at, term, &row_std, found_before + index, &mut maps, &mut pictures));
    }
    let (mut steps, places) = joined(steps);
    // A further form of an effect has no picture of its own.
    let place = |step: usize| places.get(step).copied().flatten();
    maps = maps.into_iter().filter_map(|m| Some(Map { step: place(m.step)?, ..m })).collect();
    let evidence = std::mem::take(&mut pictures.evidence);
    pictures.evidence = evidence.into_iter().filter_map(|e| Some(Evidence { step: place(e.step)?, ..e })).collect();
    pictures.left = quiet_maps(&search, &state, &all, noise_floor_nt);
    let before = where_map::Model {
        record: &scene.record,
        readings: &raw,
        design: &design_before,
        given: given.iter().map(|g| &g.stacked).collect(),
        nt_per_ent: scene.nt_per_ent,
    };
    pictures.places = where_map::places(&before, &state.noise);
    sufficient(&mut steps);
    let (not_identifiable, detection_limits) = limits(&search, &state, &steps);
    warnings.extend(hidden_drifts(&search, &state, &all, &steps));
    if run.vectors.lost > 0 {
        warnings.push(format!("{} samples are missing in {} gaps", run.vectors.lost, run.vectors.gap_count));
    }
    Ok(Diagnosis {
        format: "diagnosis",
        version: 1,
        runs: vec![run.header.run.clone()],
        noise_floor_nt,
        noise: Some(state.noise.colour),
        verdict: words::verdict(&steps),
        steps,
        not_identifiable,
        detection_limits,
        response: None,
        warnings,
        reading_ent: std::array::from_fn(|a| {
            let readings = search.scene.record.rows.iter().map(|r| r.linear_ent[a]);
            readings.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
        }),
        maps,
        pictures,
    })
}

fn candidate(record: &Record, id: &str, spec: &Spec) -> Option<Candidate> {
    let effect = effects::named(id)?;
    Some(Candidate::new(effect.id(), spec.clone(), effect.columns(record, spec)?))
}

/// Readings without what was found in the samples, enT.
fn corrected(scene: &Scene, inside: &[Inside]) -> DMatrix<f64> {
    let mut readings = scene.readings.clone();
    for found in inside {
        let columns = effects::named(found.id).and_then(|e| e.columns(&scene.record, &found.spec)).unwrap_or_default();
        for (column, (value, _)) in columns.iter().zip(&found.values) {
            for i in 0..readings.nrows() {
                for a in 0..3 {
                    readings[(i, a)] -= value * column.values[i][a];
                }
            }
        }
    }
    readings
}

/// A lag is looked for to this step, s: far below what its readings tell, so that a strong one leaves nothing.
const FINE_LAG_S: f64 = 0.05;

/// Looks for a lag of the thermistor and, if there is one, gives the scene the temperatures of the part that matters.
fn find_lag(
    scene: &mut Scene,
    readings: &DMatrix<f64>,
    given: &[Candidate],
    number: usize,
) -> Option<(Step, Branches, Evidence)> {
    let series = scene.record.sensor.as_ref()?.series.clone();
    let times: Vec<f64> = scene.record.rows.iter().map(Row::t_s).collect();
    let degc = |form: &str, lag_s: f64| -> Vec<f64> {
        let lagged = shifted(&series, form, lag_s);
        times.iter().map(|t| interpolate(&lagged, *t)).collect()
    };
    let squares = |degc: Vec<f64>| scene.squares_with(readings, &degc);
    let search = Search::new(scene, readings.clone());
    let now: Vec<&Candidate> = given.iter().collect();
    let state = search.state(&now)?;
    let groups = search.groups(&state);
    let explanations = search.explanations(&state, &groups);
    let best = explanations.iter().find(|e| e.key == "thermal_lag")?;
    if best.evidence < 12.0 {
        return None;
    }
    let rival = explanations.first().filter(|e| e.key != "thermal_lag").map(|e| &search.bank[e.best]);
    // Each form with its best lag.
    let before = squares(degc("delay", 0.0));
    let length = scene.record.span_s[1] - scene.record.span_s[0];
    let mut found: Option<(f64, &str, f64)> = None;
    for (form, sign) in [("delay", 1.0), ("delay", -1.0), ("first order", 1.0), ("inverse first order", 1.0)] {
        let mut best = (f64::INFINITY, 0.0);
        let mut lag = 30.0;
        while lag < 0.2 * length {
            let sum = squares(degc(form, sign * lag));
            if sum < best.0 {
                best = (sum, lag);
            }
            lag *= 1.25;
        }
        let mut width = 0.2 * best.1;
        while width > FINE_LAG_S {
            for side in [-1.0, 1.0] {
                let other = best.1 + side * width;
                let sum = if other > 0.0 { squares(degc(form, sign * other)) } else { f64::INFINITY };
                if sum < best.0 {
                    best = (sum, other);
                }
            }
            width *= 0.6;
        }
        if found.is_none_or(|f| best.0 < f.0) {
            found = Some((best.0, form, sign * best.1));
        }
    }
    let (after, form, lag_s) = found?;
    let freedom = (3 * readings.nrows()) as f64;
    if after >= before {
        return None;
    }
    // Where a second more or less costs as much as the noise: the curvature of the squares.
    let h = 0.05 * lag_s.abs().max(20.0);
    let curvature = (squares(degc(form, lag_s + h)) + squares(degc(form, lag_s - h)) - 2.0 * after) / (h * h);
    let variance = after / (freedom - 3.0 * scene.design.ncols() as f64);
    // The instants of the thermistor's readings are known to one reading.
    let interval_s = (series[series.len() - 1].0 - series[0].0) / (series.len() - 1).max(1) as f64;
    let std_s = (2.0 * variance / curvature.max(f64::MIN_POSITIVE) + interval_s * interval_s / 12.0).sqrt();
    let strength = (freedom * (before / after).ln()).max(0.0).sqrt();
    let spec = Spec::new(form, &[0, 1, 2]).with("lag", lag_s, "s");
    let held_before = search.held_out(&state.noise, &now);
    let p_value = best.score.p_value();
    let nt_per_ent = scene.nt_per_ent;
    let (n, runners_up) = (search.bank.len(), runners(&search, &groups, &explanations, "thermal_lag"));
    let gap_before = gap(&held_before, nt_per_ent);
    let evidence = bars(&search, &explanations, "thermal_lag", best.evidence, number);
    let beside_rival = rival.and_then(|rival| {
        let with: Vec<&Candidate> = now.iter().copied().chain([rival]).collect();
        let noise = search.state(&with)?.noise;
        let sum = search.held_out(&noise, &with).sum;
        Some((noise, sum))
    });
    let mut lagged = scene.clone();
    lagged.with_temperatures(degc(form, lag_s));
    let search = Search::new(&lagged, readings.clone());
    // A strong lag is no line, so that what bends freely may follow its line better: the lag itself has to predict more.
    if beside_rival.is_some_and(|(noise, sum)| search.held_out(&noise, &now).sum >= sum) {
        return None;
    }
    let state = search.state(&now)?;
    let held_after = search.held_out(&state.noise, &now);
    let gap_after = gap(&held_after, nt_per_ent);
    let name = scene.record.sensor.as_ref().map_or_else(String::new, |c| c.name.clone());
    let row_std = search.row_std(&state, &now);
    let branches = branches::of(
        &branches::Side { record: &scene.record, residual_ent: &held_before.residual_ent },
        &branches::Side { record: &lagged.record, residual_ent: &held_after.residual_ent },
        row_std[0],
        &name,
        &series,
        number,
    );
    let step = Step {
        effect: "thermal_lag".to_owned(),
        axes: COMPONENTS.map(str::to_owned).to_vec(),
        ambiguous_with: Vec::new(),
        parameters: vec![Parameter { name: "lag".to_owned(), value: lag_s, std: Some(std_s), unit: "s".to_owned() }],
        place: format!("all axes, where {name} rises or falls: up to {:.2} nT", gap_before.max_nt),
        p_value,
        trials: n,
        p_value_corrected: (p_value * n as f64).clamp(f64::MIN_POSITIVE, 1.0),
        gap_before,
        gap_after,
        strength_k: strength,
        family: effects::Family::Thermal.name(),
        wording: if strength > CERTAIN { "is" } else { "consistent with" },
        runners_up,
        next_measurement: None,
        sentence: words::lag(&name, form, lag_s, std_s, &gap_before, &gap_after),
        covariate: None,
        shape: Vec::new(),
        form: spec,
        further: Vec::new(),
    };
    *scene = lagged;
    Some((step, branches, evidence))
}

/// A step found in the samples.
fn inside_step(found: &Inside, scene: &Scene) -> Step {
    let about = effects::named(found.id).map(effects::Effect::about);
    let columns = effects::named(found.id).and_then(|e| e.columns(&scene.record, &found.spec)).unwrap_or_default();
    let shape_std = |name: &str| found.shape_std.iter().find(|(n, _)| n == name).map(|(_, s)| *s);
    let mut parameters: Vec<Parameter> = columns
        .iter()
        .zip(&found.values)
        .map(|(c, (value, std))| Parameter { name: c.name.clone(), value: *value, std: Some(*std), unit: c.unit.to_owned() })
        .collect();
    parameters.extend(found.spec.shape.iter().map(|(name, value, unit)| Parameter {
        name: name.clone(),
        value: *value,
        std: shape_std(name),
        unit: unit.clone(),
    }));
    let nt = |ent: [f64; 3]| std::array::from_fn(|a| ent[a] * scene.nt_per_ent[a]);
    let gap = |k: usize| Gap {
        rms_nt: nt(found.rms_ent[k]),
        chi2_per_dof: found.squares[k] / found.squares[2].max(1.0),
        max_nt: nt(found.rms_ent[k]).into_iter().fold(0.0, f64::max),
    };
    let certain = found.ambiguous_with.is_empty() && found.strength > CERTAIN;
    let mut step = Step {
        effect: found.id.to_owned(),
        axes: found.spec.axis_names().into_iter().map(str::to_owned).collect(),
        ambiguous_with: found.ambiguous_with.iter().map(|s| (*s).to_owned()).collect(),
        form: found.spec.clone(),
        further: Vec::new(),
        parameters,
        place: words::place_inside(found),
        p_value: found.p_value,
        trials: found.trials,
        p_value_corrected: (found.p_value * found.trials as f64).clamp(f64::MIN_POSITIVE, 1.0),
        gap_before: gap(0),
        gap_after: gap(1),
        strength_k: found.strength,
        family: about.map_or("unknown", |a| a.family.name()),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: Vec::new(),
        next_measurement: (!certain).then(|| about.map(|a| a.best_measurement.to_owned())).flatten(),
        sentence: String::new(),
        covariate: None,
        shape: Vec::new(),
    };
    step.sentence = words::sentence(&step);
    step
}

fn gap(held: &HeldOut, nt_per_ent: [f64; 3]) -> Gap {
    let n = held.residual_ent.nrows();
    let rms_nt: [f64; 3] =
        std::array::from_fn(|a| (held.residual_ent.column(a).norm_squared() / n as f64).sqrt() * nt_per_ent[a]);
    let max_nt = (0..3).map(|a| held.residual_ent.column(a).amax() * nt_per_ent[a]).fold(0.0, f64::max);
    Gap { rms_nt, chi2_per_dof: held.sum / (3 * n) as f64, max_nt }
}

fn runners(
    search: &Search,
    groups: &[crate::fit::scan::Group],
    explanations: &[search::Explanation],
    own: &str,
) -> Vec<RunnerUp> {
    use crate::fit::scan::Fitted;
    let Some(reference) = explanations.iter().find(|e| e.key == own) else { return Vec::new() };
    let others = explanations.iter().filter(|e| e.key != own && e.evidence > reference.evidence - 60.0).take(5);
    others
        .map(|e| RunnerUp {
            effect: search.bank[e.best].key.clone(),
            log_ratio: e.evidence - reference.evidence,
            correlation: Fitted::correlation(&groups[e.best], &groups[reference.best]),
        })
        .collect()
}

/// Evidence of a step and of the rivals that explain anything at all.
fn bars(search: &Search, explanations: &[search::Explanation], key: &str, own: f64, step: usize) -> Evidence {
    let rivals = explanations.iter().filter(|e| e.key != key && e.evidence > 0.0).take(RIVALS);
    let named = std::iter::once((key.to_owned(), own));
    Evidence { step, bars: named.chain(rivals.map(|e| (search.bank[e.best].key.clone(), e.evidence))).collect(), apart: APART }
}

/// A step found in the means.
#[expect(clippy::too_many_arguments, reason = "what the search knows of one of its terms")]
fn term_step(
    search: &Search,
    state: &State,
    all: &[&Candidate],
    at: usize,
    term: &Term,
    row_std: &[[f64; 3]],
    number: usize,
    maps: &mut Vec<Map>,
    pictures: &mut Pictures,
) -> Step {
    let scene = search.scene;
    let nt_per_ent = scene.nt_per_ent;
    let others: Vec<&Candidate> = all.iter().enumerate().filter(|(i, _)| *i != at).map(|(_, c)| *c).collect();
    let candidate = all[at];
    // The evidence of everything else in place of this term, with the noise of the full model.
    let without = search.state_beside(state, &others);
    let groups = search.groups(&without);
    let explanations = search.explanations(&without, &groups);
    let own_group = search.group(&without, candidate);
    let score = without.fitted.score(&own_group);
    let own =
        explanations.iter().find(|e| e.key == candidate.key).map_or(score.evidence, |e| e.evidence).max(score.evidence - 3.0);
    pictures.evidence.push(bars(search, &explanations, &candidate.key, own, number));
    let mut ambiguous: Vec<String> = Vec::new();
    for e in explanations.iter().filter(|e| e.key != candidate.key) {
        let id = search.bank[e.best].id.to_owned();
        let twin = crate::fit::scan::Fitted::correlation(&groups[e.best], &own_group) > ALIKE
            && groups[e.best].count() == own_group.count()
            && id != "unknown";
        if (e.evidence > own - APART || twin) && id != candidate.id && !ambiguous.contains(&id) {
            ambiguous.push(id);
        }
    }
    let values = search.estimate(state, all, at).unwrap_or_default();
    let shown = selection::corrected(
        &values[..candidate.parameters.len().min(values.len())],
        score.strength,
        term.least * score.strength,
    );
    let mut parameters: Vec<Parameter> = candidate
        .parameters
        .iter()
        .zip(&shown)
        .map(|((name, unit), (value, std))| Parameter {
            name: name.clone(),
            value: *value,
            std: Some(*std),
            unit: (*unit).to_owned(),
        })
        .collect();
    let shape_value = values.get(candidate.parameters.len());
    if candidate.id != "unknown" {
        parameters.extend(candidate.spec.shape.iter().map(|(name, value, unit)| Parameter {
            name: name.clone(),
            value: *value,
            std: shape_value.filter(|(v, _)| v == value).map(|(_, s)| *s),
            unit: unit.clone(),
        }));
    }
    let amplitudes = nalgebra::DVector::from_fn(candidate.stacked.ncols(), |j, _| values.get(j).map_or(0.0, |v| v.0));
    let contribution = &candidate.stacked * amplitudes;
    let before = search.held_out(&state.noise, &others);
    let after = search.held_out(&state.noise, all);
    let n = scene.readings.nrows();
    // Drawn over the covariate which the contribution follows best, on the axis on which it is largest.
    let axis = (0..3)
        .max_by(|a, b| {
            let size = |a: usize| contribution.rows(a * n, n).norm() * nt_per_ent[a];
            size(*a).total_cmp(&size(*b))
        })
        .unwrap_or(0);
    // What the parameters of the linear model take of it is no disagreement.
    let q = scene.design.clone().qr().q();
    let own_part = contribution.rows(axis * n, n).into_owned();
    let own_part: Vec<f64> = (&own_part - &q * q.tr_mul(&own_part)).iter().copied().collect();
    let (covariate, unit, x) = words::follows(&scene.record, &own_part, candidate.covariate());
    let nt = |held: &HeldOut| held.residual_ent.column(axis).iter().map(|r| r * nt_per_ent[axis]).collect::<Vec<f64>>();
    let noise_nt = row_std.iter().map(|s| s[axis]).sum::<f64>() / n as f64 * nt_per_ent[axis];
    let most = (0..n).max_by(|i, j| own_part[*i].abs().total_cmp(&own_part[*j].abs())).unwrap_or(0);
    let size_nt = own_part[most].abs() * nt_per_ent[axis];
    // Six digits, of a field or of a temperature.
    let decimals = (5.0 - x[most].abs().log10().floor()).clamp(0.0, 4.0) as usize;
    let place = format!(
        "{}, where the {covariate} is {:.decimals$} {unit}: up to {size_nt:.3} nT ({:.1} noise)",
        COMPONENTS[axis],
        x[most],
        size_nt / noise_nt.max(f64::MIN_POSITIVE)
    );
    let shape = if candidate.id == "unknown" {
        words::shape(&x, &own_part, nt_per_ent[axis], &after, axis, row_std)
    } else {
        Vec::<ShapePoint>::new()
    };
    maps.push(Map {
        covariate: covariate.clone(),
        unit: unit.to_owned(),
        axis,
        x,
        before_nt: nt(&before),
        after_nt: nt(&after),
        noise_nt,
        step: number,
    });
    let about = candidate.effect().about();
    let certain = ambiguous.is_empty() && score.strength > CERTAIN;
    let next_measurement = words::next_measurement(candidate.id, &ambiguous);
    let axes: Vec<String> = candidate.spec.axis_names().into_iter().map(str::to_owned).collect();
    let mut step = Step {
        effect: candidate.id.to_owned(),
        axes,
        ambiguous_with: ambiguous,
        form: candidate.spec.clone(),
        further: Vec::new(),
        parameters,
        place,
        p_value: score.p_value(),
        trials: term.trials,
        p_value_corrected: term.p_global,
        gap_before: gap(&before, nt_per_ent),
        gap_after: gap(&after, nt_per_ent),
        strength_k: score.strength,
        family: about.family.name(),
        wording: if certain { "is" } else { "consistent with" },
        runners_up: runners(search, &groups, &explanations, &candidate.key),
        next_measurement,
        sentence: String::new(),
        covariate: candidate.covariate().map(str::to_owned),
        shape,
    };
    step.sentence = words::sentence(&step);
    step
}

/// What the whole model leaves of the readings.
fn quiet_maps(search: &Search, state: &State, all: &[&Candidate], noise_floor_nt: [f64; 3]) -> Vec<Map> {
    let held = search.held_out(&state.noise, all);
    (0..3)
        .map(|axis| {
            let record = &search.scene.record;
            let nt: Vec<f64> = held.residual_ent.column(axis).iter().map(|r| r * search.scene.nt_per_ent[axis]).collect();
            Map {
                covariate: "time".to_owned(),
                unit: "s".to_owned(),
                axis,
                x: record.rows.iter().map(Row::t_s).collect(),
                before_nt: nt.clone(),
                after_nt: nt,
                noise_nt: noise_floor_nt[axis],
                step: 0,
            }
        })
        .collect()
}

/// One step per effect, whatever the number of its forms, and where each step went; none for one that joined another.
fn joined(steps: Vec<Step>) -> (Vec<Step>, Vec<Option<usize>>) {
    let mut all: Vec<Step> = Vec::new();
    let mut places = Vec::with_capacity(steps.len());
    for step in steps {
        let same = |s: &&mut Step| s.effect == step.effect && s.covariate == step.covariate && !s.form.axes.is_empty();
        let Some(first) = all.iter_mut().find(same).filter(|_| step.family != effects::Family::Periodic.name()) else {
            places.push(Some(all.len()));
            all.push(step);
            continue;
        };
        places.push(None);
        for axis in &step.axes {
            if !first.axes.contains(axis) {
                first.axes.push(axis.clone());
            }
        }
        first.axes.sort();
        first.further.push((step.form.clone(), step.parameters.clone()));
        first.ambiguous_with.retain(|a| step.ambiguous_with.contains(a));
        first.gap_after = step.gap_after;
        first.strength_k = first.strength_k.hypot(step.strength_k);
        first.sentence = words::sentence(first);
    }
    (all, places)
}

/// Drifts that would be clear beside white noise and that the slow noise explains as well.
fn hidden_drifts(search: &Search, state: &State, all: &[&Candidate], steps: &[Step]) -> Vec<String> {
    let colour = state.noise.colour;
    if colour.slow == 0.0 {
        return Vec::new();
    }
    let Some(drifts) = search.drifts(all) else { return Vec::new() };
    let order = search.scene.record.trend_order + 1;
    let named = |axis: &str| steps.iter().any(|s| s.effect == "offset_drift" && s.axes.iter().any(|a| a == axis));
    (0..3)
        .filter(|a| drifts[*a].0.abs() > HIDDEN * drifts[*a].1 && !named(COMPONENTS[*a]))
        .map(|a| {
            let (c, std) = drifts[a];
            format!(
                "the offset of {} drifts in order {order} of time, p{order} = {:+.3} nT, {:.1} times its standard deviation beside white noise; the \
                 slow noise of this run, {:.1} times the white variance of a mean, makes as much, so that no effect is named",
                COMPONENTS[a],
                c * search.scene.nt_per_ent[a],
                c.abs() / std,
                colour.slow
            )
        })
        .collect()
}

/// Names are no longer certain where something unknown was left over on the same axes.
fn sufficient(steps: &mut [Step]) {
    let left: Vec<Vec<String>> = steps.iter().filter(|s| s.effect == "unknown").map(|s| s.axes.clone()).collect();
    for step in steps.iter_mut().filter(|s| s.effect != "unknown" && s.wording == "is") {
        if left.iter().any(|axes| axes.iter().any(|a| step.axes.contains(a))) {
            step.wording = "consistent with";
        }
    }
}

/// What cannot be shown, and how small an effect of the rest would have been found.
fn limits(search: &Search, state: &State, steps: &[Step]) -> (Vec<NotIdentifiable>, Vec<DetectionLimit>) {
    let found = |id: &str| steps.iter().any(|s| s.effect == id);
    let mut none: Vec<NotIdentifiable> = search
        .absent
        .iter()
        .filter(|a| !found(a.id))
        .map(|a| NotIdentifiable { effect: a.id.to_owned(), reason: a.reason.clone() })
        .collect();
    let groups = search.groups(state);
    let n = search.scene.readings.nrows();
    let mut limits = Vec::new();
    for effect in CATALOGUE.iter().filter(|e| e.id() != "unknown" && !found(e.id())) {
        let own: Vec<usize> = (0..search.bank.len()).filter(|i| search.bank[*i].id == effect.id()).collect();
        if own.is_empty() {
            continue;
        }
        if own.iter().all(|i| groups[*i].surviving < SHOWN) {
            let most = own.iter().map(|i| groups[*i].surviving).fold(0.0, f64::max);
            let reason = format!("{:.1} % of it is left beside the fitted parameters", 100.0 * most);
            none.push(NotIdentifiable { effect: effect.id().to_owned(), reason });
            continue;
        }
        for axis in 0..3 {
            let best = own
                .iter()
                .filter(|i| {
                    search.bank[**i].spec.axes == [axis]
                        && search.bank[**i].stacked.ncols() == 1
                        && groups[**i].surviving >= SHOWN
                })
                .map(|i| {
                    let least = FOUND_90 / groups[*i].norms[0];
                    let size = (0..3)
                        .map(|a| search.bank[*i].stacked.rows(a * n, n).amax() * search.scene.nt_per_ent[a])
                        .fold(0.0, f64::max);
                    (least * size, least, *i)
                })
                .min_by(|a, b| a.0.total_cmp(&b.0));
            if let Some((amplitude_nt, least, i)) = best {
                let (name, unit) = &search.bank[i].parameters[0];
                limits.push(DetectionLimit {
                    effect: effect.id().to_owned(),
                    axis: COMPONENTS[axis].to_owned(),
                    amplitude_nt,
                    parameter: format!("{name} = {least:.2e} {unit}"),
                });
            }
        }
    }
    none.sort_by(|a, b| a.effect.cmp(&b.effect));
    (none, limits)
}

/// Kinds of runs that [`run`] takes.
#[must_use]
pub fn takes(kind: Kind) -> bool {
    matches!(kind, Kind::Linearity | Kind::Sweep | Kind::ZeroField | Kind::Frequency)
}
