//! The one builder of steps: the facts of something that was found, whatever the data were, and the step made of them.

use super::result::{Forecast, FurtherForm, Gap, Parameter, RunnerUp, ShapePoint, Step, Telling};
use super::samples::Inside;
use super::{CERTAIN, next, words};
use crate::data::units::COMPONENTS;
use crate::fit::statistics::median;
use crate::model::effects::bad_thermistor::{BadThermistor, JUMP, JUMP_TIME};
use crate::model::effects::time_shift::TimeShift;
use crate::model::effects::{Column, EffectRef, Family, Record, Spec};
use crate::record::prepared::PreparedRun;
use crate::record::temperature_faults::Jumps;

/// An effect does not act on an axis where it is less than this part of what it is on another one.
const SMALL_PART: f64 = 0.1;

/// How sure it is that something was found.
#[derive(Clone, Copy, Debug)]
pub struct Significance {
    /// Probability that noise alone gives this candidate as large a score.
    pub p_value: f64,
    /// Candidates that were tried.
    pub trials: usize,
    /// Probability that noise alone gives any candidate as much.
    pub p_value_corrected: f64,
    /// Signal to noise ratio.
    pub strength_k: f64,
}

impl Significance {
    /// Of something that is seen without statistics.
    pub fn seen(trials: usize, strength_k: f64) -> Self {
        Self { p_value: f64::MIN_POSITIVE, trials, p_value_corrected: f64::MIN_POSITIVE, strength_k }
    }

    /// Of the best of independent trials, by Bonferroni's inequality.
    pub fn of_trials(p_value: f64, trials: usize, strength_k: f64) -> Self {
        let p_value_corrected = (p_value * trials as f64).clamp(f64::MIN_POSITIVE, 1.0);
        Self { p_value, trials, p_value_corrected, strength_k }
    }
}

/// How sure a name may be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Name {
    /// Certain if the effect is strong and has no rival.
    ByStrength,
    /// Certain: damage is seen, not inferred.
    Certain,
    /// Not certain, however strong the effect is.
    Doubted,
}

/// The facts that describe something that was found: [`Facts::step`] makes the step.
pub struct Facts {
    /// The effect.
    pub effect: EffectRef,
    /// Axes on which it acts.
    pub axes: Vec<&'static str>,
    /// What was fitted.
    pub form: Spec,
    /// Its parameters.
    pub parameters: Vec<Parameter>,
    /// Where the data disagree, in words.
    pub place: String,
    /// How sure it is.
    pub significance: Significance,
    /// Disagreement on held-out data without and with it.
    pub gaps: [Gap; 2],
    /// Other effects that these data cannot distinguish from it.
    pub ambiguous_with: Vec<EffectRef>,
    /// The candidates next to it.
    pub runners_up: Vec<RunnerUp>,
    /// How sure the name may be.
    pub name: Name,
    /// What to measure, if it is more than what distinguishes the rivals.
    pub next_measurement: Option<String>,
    /// What runs of a menu would tell.
    pub next_forecast: Vec<Forecast>,
    /// How it is told.
    pub telling: Telling,
    /// What an unknown dependence follows.
    pub covariate: Option<String>,
    /// The unknown dependence.
    pub shape: Vec<ShapePoint>,
    /// Names of its points, where their covariate is a number in a list.
    pub shape_names: Vec<String>,
    /// The plateau without which little of it is left, s since the run's start.
    pub one_plateau_s: Option<f64>,
}

impl Facts {
    /// Facts that have to be known; there are no rivals, and nothing is known of the size.
    pub fn new(effect: EffectRef, form: Spec, significance: Significance) -> Self {
        Self {
            effect,
            axes: form.axis_names(),
            form,
            parameters: Vec::new(),
            place: String::new(),
            significance,
            gaps: [Gap::default(); 2],
            ambiguous_with: Vec::new(),
            runners_up: Vec::new(),
            name: Name::ByStrength,
            next_measurement: None,
            next_forecast: Vec::new(),
            telling: Telling::default(),
            covariate: None,
            shape: Vec::new(),
            shape_names: Vec::new(),
            one_plateau_s: None,
        }
    }

    /// Whether the name is certain.
    pub fn is_certain(&self) -> bool {
        match self.name {
            Name::ByStrength => self.ambiguous_with.is_empty() && self.significance.strength_k > CERTAIN,
            Name::Certain => true,
            Name::Doubted => false,
        }
    }

    /// The step that describes it.
    pub fn step(self) -> Step {
        let wording = if self.is_certain() { "is" } else { "consistent with" };
        let apart = || words::next_measurement(self.effect, &self.ambiguous_with);
        let in_general = self.next_measurement.or_else(apart);
        let next_measurement = next::words(self.effect, &self.next_forecast, in_general);
        let Significance { p_value, trials, p_value_corrected, strength_k } = self.significance;
        let [gap_before, gap_after] = self.gaps;
        let mut step = Step {
            effect: self.effect,
            axes: self.axes.into_iter().map(str::to_owned).collect(),
            ambiguous_with: self.ambiguous_with,
            form: self.form,
            further: Vec::new(),
            parameters: self.parameters,
            place: self.place,
            p_value,
            trials,
            // It is simulated for the search, the single one is that beside all other terms, which may have become weaker. Then any of the
            // candidates is as weak at most so many times as often.
            p_value_corrected: if p_value_corrected > p_value {
                p_value_corrected
            } else {
                (p_value * trials as f64).max(p_value).min(1.0)
            },
            gap_before,
            gap_after,
            strength_k,
            family: self.effect.about().family.name(),
            wording,
            runners_up: self.runners_up,
            next_measurement,
            next_forecast: self.next_forecast,
            sentence: String::new(),
            telling: self.telling,
            covariate: self.covariate,
            shape: self.shape,
            shape_names: self.shape_names,
            one_plateau_s: self.one_plateau_s,
        };
        step.sentence = sentence(&step);
        step
    }
}

/// The sentence for a step as certain as its name is.
fn sentence(step: &Step) -> String {
    let Telling { own, remark } = &step.telling;
    let own = own.as_ref().map(|[certain, doubted]| if step.wording == "is" { certain } else { doubted });
    format!("{}{remark}", own.cloned().unwrap_or_else(|| words::sentence(step)))
}

impl Telling {
    /// In the same words whether the name is certain or not.
    pub fn always(sentence: String) -> Self {
        Self { own: Some([sentence.clone(), sentence]), remark: String::new() }
    }
}

/// Linear parameters by their names and units, with values and standard uncertainties.
pub fn linear_parameters<'a>(names: impl IntoIterator<Item = (&'a str, &'static str)>, values: &[(f64, f64)]) -> Vec<Parameter> {
    let parameter = |((name, unit), (value, std)): ((&str, &'static str), &(f64, f64))| Parameter {
        name: name.to_owned(),
        value: *value,
        std: Some(*std),
        unit: unit.to_owned(),
    };
    names.into_iter().zip(values).map(parameter).collect()
}

/// Shape parameters of a form; those that were found on a grid have no uncertainty.
pub fn shape_parameters(form: &Spec, std: impl Fn(&str, f64) -> Option<f64>) -> impl Iterator<Item = Parameter> {
    form.shape.iter().map(move |(name, value, unit)| Parameter {
        name: name.clone(),
        value: *value,
        std: std(name, *value),
        unit: unit.clone(),
    })
}

/// A step found in the samples. Edges that are displaced leave something beside the settings, which comes again with these: a periodic signal
/// beside them is not certain.
pub(super) fn inside_step(found: &Inside, prepared: &PreparedRun, is_shifted: bool, fits_settings: bool) -> Step {
    let columns = found.effect.columns(&prepared.record, &found.spec).unwrap_or_default();
    let shape_std = |name: &str, _| found.shape_std.iter().find(|(n, _)| n == name).map(|(_, s)| *s);
    let mut parameters = linear_parameters(columns.iter().map(|c| (c.name.as_str(), c.unit)), &found.values);
    parameters.extend(shape_parameters(&found.spec, shape_std));
    let nt = |ent: [f64; 3]| std::array::from_fn(|a| ent[a] * prepared.nt_per_ent[a]);
    let gap = |k: usize| Gap {
        rms_nt: nt(found.rms_ent[k]),
        chi2_per_dof: found.squares[k] / found.squares[2].max(1.0),
        max_nt: nt(found.rms_ent[k]).into_iter().fold(0.0, f64::max),
    };
    let significance = Significance::of_trials(found.p_value, found.trials, found.strength);
    let is_beside_shift = is_shifted && found.effect.about().family == Family::Periodic && !found.effect.is(&TimeShift);
    let facts = Facts {
        parameters,
        place: found.effect.place_in_samples(&found.spec),
        gaps: [gap(0), gap(1)],
        ambiguous_with: found.ambiguous_with.clone(),
        name: if is_beside_shift || fits_settings { Name::Doubted } else { Name::ByStrength },
        telling: Telling { own: None, remark: if fits_settings { FITS.to_owned() } else { String::new() } },
        ..Facts::new(found.effect, found.spec.clone(), significance)
    };
    let next_measurement = (!facts.is_certain()).then(|| found.effect.about().best_measurement.to_owned());
    Facts { next_measurement, ..facts }.step()
}

/// What is said of a period that fits into the settings.
const FITS: &str = " Its period fits into the settings: what happens in the same place of each of them looks the same.";

/// Which of some signals have a period of which a whole number goes from every setting to the next, as far as the length of the record tells it. What
/// happens in the same place of every setting has long waves; where one of those fits, the short ones that do are of the same.
pub(super) fn fit_into(found: &[Inside], settings_s: &[[f64; 2]]) -> Vec<bool> {
    /// Settings of unequal lengths have no period.
    const EQUAL: f64 = 0.01;
    /// Waves of this many periods in a setting are long ones.
    const LONG: f64 = 16.0;
    let mut steps_s: Vec<f64> = settings_s.windows(2).map(|pair| pair[1][0] - pair[0][0]).collect();
    let usual_s = median(&mut steps_s);
    let equal = steps_s.iter().filter(|step_s| (*step_s - usual_s).abs() <= EQUAL * usual_s).count();
    // The record tells a frequency to one period in its length.
    let whole = |found: &Inside| {
        let periods = usual_s / found.effect.period_s(&found.spec)?;
        let is_whole = periods >= 0.5 && (periods - periods.round()).abs() * settings_s.len() as f64 <= 1.0;
        (2 * equal > steps_s.len() && is_whole).then_some(periods)
    };
    let all: Vec<Option<f64>> = found.iter().map(whole).collect();
    let any_long = all.iter().flatten().any(|periods| *periods <= LONG);
    all.into_iter().map(|periods| any_long && periods.is_some()).collect()
}

/// The facts of a thermistor that jumps, as its own readings show them: those of the sensor have not been asked.
pub(super) fn fault_facts(fault: &Jumps) -> Facts {
    let Jumps { channel: name, jumps, usual_k: _, readings, probability, noise_k: _ } = fault;
    let list: Vec<String> = jumps.iter().map(|(t_s, size)| format!("by {size:+.2} K at {t_s:.0} s")).collect();
    let list = list.join(", ");
    let parameter = |(k, (_, size)): (usize, &(f64, f64))| Parameter {
        name: if k == 0 { format!("jump of {name}") } else { format!("jump {} of {name}", k + 1) },
        value: *size,
        std: None,
        unit: "K".to_owned(),
    };
    let form = Spec::new(JUMP, &[]).with(JUMP_TIME, jumps[0].0, "s");
    let probability = probability.max(f64::MIN_POSITIVE);
    let significance = Significance {
        p_value: (probability / *readings as f64).max(f64::MIN_POSITIVE),
        trials: *readings,
        p_value_corrected: probability,
        strength_k: fault.strength(),
    };
    Facts {
        parameters: jumps.iter().enumerate().map(parameter).collect(),
        place: format!("channel {name} jumps {list}"),
        name: Name::Doubted,
        telling: Telling::always(format!(
            "The temperature channel {name} jumps {list}, as no body does; all else was looked for with the jumps taken off."
        )),
        next_measurement: Some(EffectRef::new(&BadThermistor).about().best_measurement.to_owned()),
        ..Facts::new(EffectRef::new(&BadThermistor), form, significance)
    }
}

/// Where a step went.
pub(super) struct Place {
    /// Its index.
    pub step: usize,
    /// Whether it is the first form of its effect and did not join another one.
    pub is_first: bool,
}

/// One step per effect, whatever the number of its forms, and where each step went.
pub(super) fn joined(steps: Vec<Step>) -> (Vec<Step>, Vec<Place>) {
    let mut all: Vec<Step> = Vec::new();
    let mut places = Vec::with_capacity(steps.len());
    for step in steps {
        let same = |s: &Step| s.effect == step.effect && s.covariate == step.covariate && !s.form.axes.is_empty();
        let is_alone = step.family == Family::Periodic.name();
        let Some(earlier) = all.iter().position(same).filter(|_| !is_alone) else {
            places.push(Place { step: all.len(), is_first: true });
            all.push(step);
            continue;
        };
        places.push(Place { step: earlier, is_first: false });
        let first = &mut all[earlier];
        for axis in &step.axes {
            if !first.axes.contains(axis) {
                first.axes.push(axis.clone());
            }
        }
        first.axes.sort();
        first.further.push(FurtherForm {
            form: step.form.clone(),
            parameters: step.parameters.clone(),
            one_plateau_s: step.one_plateau_s,
        });
        if step.one_plateau_s.is_some() {
            first.wording = step.wording;
            first.telling.remark.push_str(&step.telling.remark);
        }
        first.ambiguous_with.retain(|a| step.ambiguous_with.contains(a));
        first.gap_after = step.gap_after;
        first.strength_k = first.strength_k.hypot(step.strength_k);
        // Sentences of a form's own do not speak of a further one.
        first.telling.own = None;
        first.sentence = sentence(first);
    }
    (all, places)
}

/// Names are no longer certain where something unknown was left over on the same axes, or where the gap is still open there.
pub(super) fn sufficient(steps: &mut [Step], record: &Record, open: [bool; 3]) {
    let unknown: Vec<[bool; 3]> =
        steps.iter().filter(|s| s.effect.is_unknown()).map(|s| COMPONENTS.map(|a| s.axes.iter().any(|own| own == a))).collect();
    for step in steps.iter_mut().filter(|s| s.wording == "is") {
        let acts = acts_on(step, record);
        let meets = |axes: &[bool; 3]| (0..3).any(|a| axes[a] && acts[a]);
        // What was found in the samples does not rest on their means, but for what is periodic: something slower beats with the settings.
        let is_of_means = step.effect.in_samples().is_none() || step.effect.period_s(&step.form).is_some();
        let is_open = is_of_means && meets(&open);
        if is_open || (!step.effect.is_unknown() && unknown.iter().any(meets)) {
            step.doubt();
        }
    }
}

impl Step {
    /// Its name is not certain.
    pub(super) fn doubt(&mut self) {
        self.wording = "consistent with";
        self.sentence = sentence(self);
    }
}

/// The axes of the sensor whose readings a step changes, which are other ones than those that it names where these are coil axes, or axes of a
/// turn; all of them where it has no columns.
pub(super) fn acts_on(step: &Step, record: &Record) -> [bool; 3] {
    let forms = std::iter::once(&step.form).chain(step.further.iter().map(|further| &further.form));
    let columns: Option<Vec<Vec<Column>>> = forms.map(|form| step.effect.columns(record, form)).collect();
    let Some(columns) = columns else { return [true; 3] };
    let largest = |a: usize| columns.iter().flatten().flat_map(|c| &c.values).map(|v| v[a].abs()).fold(0.0, f64::max);
    let sizes = [0, 1, 2].map(largest);
    // A lag that is built into the temperatures of the record changes no more.
    if sizes == [0.0; 3] {
        return [true; 3];
    }
    // A field along one coil axis has a little of itself on every axis of a sensor that is not quite parallel.
    sizes.map(|size| size > SMALL_PART * sizes.iter().fold(0.0, |m: f64, s| m.max(*s)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::effects::example;
    use crate::model::effects::rotation_drift::RotationDrift;

    /// A turn about y moves what x and z read, and nothing of y: where the gap of x is open the name is not certain, and the sentence says so.
    #[test]
    fn a_name_is_not_certain_where_the_gap_is_open() {
        let record = example::of(&RotationDrift).unwrap().record;
        let turn = || {
            let significance = Significance { p_value: 1e-9, trials: 100, p_value_corrected: 1e-7, strength_k: 25.0 };
            Facts::new(EffectRef::new(&RotationDrift), Spec::new("time", &[1]), significance).step()
        };
        for (open, wording) in
            [([true, false, false], "consistent with"), ([false, false, true], "consistent with"), ([false, true, false], "is")]
        {
            let mut steps = [turn()];
            sufficient(&mut steps, &record, open);
            assert_eq!(steps[0].wording, wording, "{open:?}");
            assert_eq!(steps[0].sentence.contains("consistent with"), wording != "is", "{}", steps[0].sentence);
        }
    }

    /// A name that is no longer certain is told so in a sentence of its own, too, and what follows the sentence stays.
    #[test]
    fn a_name_that_is_no_longer_certain_is_told_so() {
        let record = example::of(&RotationDrift).unwrap().record;
        let significance = Significance { p_value: 1e-9, trials: 100, p_value_corrected: 1e-7, strength_k: 25.0 };
        let remark = " It was told twice.".to_owned();
        let own = Some(["The sensor turns.", "The sensor may turn."].map(str::to_owned));
        for (telling, wanted) in [
            (Telling { own, remark: remark.clone() }, "The sensor may turn. It was told twice."),
            (Telling { own: None, remark }, "The data are consistent with rotation_drift"),
            (Telling::always("A count was lost.".to_owned()), "A count was lost."),
        ] {
            let is_usual = telling.own.is_none();
            let facts = Facts { telling, ..Facts::new(EffectRef::new(&RotationDrift), Spec::new("time", &[1]), significance) };
            let mut steps = [facts.step()];
            sufficient(&mut steps, &record, [true; 3]);
            let said = &steps[0].sentence;
            assert!(said.starts_with(wanted) && (!is_usual || said.ends_with(" It was told twice.")), "{said}");
        }
    }
}
