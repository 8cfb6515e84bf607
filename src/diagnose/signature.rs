//! What an effect looks like: its forms with their parameters, and its contribution to the readings of an example run.

use super::words;
use crate::model::effects::example::{self, Example};
use crate::model::effects::{About, Acts, EffectRef, Record, Row, Spec};
use serde::Serialize;

/// Largest contribution that is shown, nT.
const SHOWN_NT: f64 = 1.0;

/// An effect of the catalogue, explained.
#[derive(Clone, Debug, Serialize)]
pub struct Explained {
    /// Id.
    pub effect: &'static str,
    /// In words.
    #[serde(flatten)]
    pub about: About,
    /// Its forms; none where the readings of one run do not show it.
    pub forms: Vec<Form>,
    /// What it does to an example run.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub example: Option<Signature>,
}

/// A form of an effect.
#[derive(Clone, Debug, Serialize)]
pub struct Form {
    /// Name.
    pub form: String,
    /// Linear parameters, as name and unit.
    pub parameters: Vec<(String, String)>,
    /// Shape parameters, as name and unit.
    pub shape: Vec<(String, String)>,
}

/// The contribution of an effect to the readings of an example run, 1 nT where it is largest.
#[derive(Clone, Debug, Serialize)]
pub struct Signature {
    /// The run.
    pub run: &'static str,
    /// Form, axes and shape.
    pub form: Spec,
    /// Parameters that make it: name, value, unit.
    pub parameters: Vec<(String, f64, String)>,
    /// What it follows.
    pub covariate: String,
    /// Unit of that.
    pub unit: &'static str,
    /// The rows are samples, and not means of plateaus.
    pub sampled: bool,
    /// Contributions in time order.
    pub points: Vec<Point>,
}

/// The contribution to one reading.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Point {
    /// Time, s since the run's start.
    pub t_s: f64,
    /// Value of the covariate.
    pub covariate: f64,
    /// Contribution along the sensor axes, nT.
    pub contribution_nt: [f64; 3],
}

/// Explains an effect.
#[must_use]
pub fn explain(effect: EffectRef) -> Explained {
    let example = example::of(&*effect);
    let forms = example.as_ref().map_or_else(Vec::new, |e| forms(effect, &e.record));
    let signature = example.and_then(|e| signature(effect, e));
    Explained { effect: effect.id(), about: effect.about(), forms, example: signature }
}

fn forms(effect: EffectRef, record: &Record) -> Vec<Form> {
    let mut specs = effect.specs(record).unwrap_or_default();
    specs.extend(effect.example(record).filter(|_| specs.is_empty()));
    if effect.is_unknown() {
        // Every covariate is a form: one of them says how they look.
        specs = effect.example(record).into_iter().collect();
    }
    let mut forms: Vec<Form> = Vec::new();
    for spec in specs {
        if forms.iter().any(|f| f.form == spec.form) {
            continue;
        }
        let columns = effect.columns(record, &spec).unwrap_or_default();
        forms.push(Form {
            form: spec.form,
            parameters: columns.into_iter().map(|c| (c.name, c.unit.to_owned())).collect(),
            shape: spec.shape.into_iter().map(|(name, _, unit)| (name, unit)).collect(),
        });
    }
    forms
}

fn signature(effect: EffectRef, example: Example) -> Option<Signature> {
    let record = &example.record;
    let spec = effect.example(record)?;
    let columns = effect.columns(record, &spec)?;
    let n = record.rows.len();
    // Every column as large as the others, then all together 1 nT.
    let most = |values: &[[f64; 3]]| values.iter().flatten().fold(0.0, |m: f64, v| m.max(v.abs()));
    let sizes: Vec<f64> = columns.iter().map(|c| most(&c.values).max(f64::MIN_POSITIVE)).collect();
    let sum =
        |i: usize| -> [f64; 3] { std::array::from_fn(|a| columns.iter().zip(&sizes).map(|(c, s)| c.values[i][a] / s).sum()) };
    let sums: Vec<[f64; 3]> = (0..n).map(sum).collect();
    let scale = SHOWN_NT / most(&sums).max(f64::MIN_POSITIVE);
    let contribution: Vec<[f64; 3]> = sums.iter().map(|v| v.map(|v| v * scale)).collect();
    let axis = (0..3).max_by(|a, b| {
        let size = |a: usize| contribution.iter().map(|v| v[a] * v[a]).sum::<f64>();
        size(*a).total_cmp(&size(*b))
    })?;
    let own: Vec<f64> = contribution.iter().map(|v| v[axis]).collect();
    let (covariate, unit, x) = covariate(effect, record, &spec, &own);
    Some(Signature {
        run: example.run,
        parameters: columns.iter().zip(&sizes).map(|(c, s)| (c.name.clone(), scale / s, c.unit.to_owned())).collect(),
        form: spec,
        covariate,
        unit,
        sampled: example.sampled,
        points: (0..n).map(|i| Point { t_s: record.rows[i].t_s(), covariate: x[i], contribution_nt: contribution[i] }).collect(),
    })
}

/// What a contribution follows: inside a plateau the time since the step or within the period.
fn covariate(effect: EffectRef, record: &Record, spec: &Spec, own: &[f64]) -> (String, &'static str, Vec<f64>) {
    let of = |value: &dyn Fn(f64) -> f64| record.rows.iter().map(Row::t_s).map(value).collect();
    if !effect.acts_in(Acts::Samples) {
        return words::follows(record, own, effect.is_unknown().then_some(spec.form.as_str()), true);
    }
    if let Some(period_s) = effect.period_s(spec) {
        return ("time within the period".to_owned(), "s", of(&|t| t.rem_euclid(period_s)));
    }
    let since = |t: f64| {
        let last = record.steps.partition_point(|s| s.t_s <= t).checked_sub(1);
        t - last.map_or(0.0, |k| record.steps[k].t_s)
    };
    ("time since the step".to_owned(), "s", of(&since))
}
