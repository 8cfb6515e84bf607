//! Effects that are known from a model file: taken off the readings of other analyses, or added to simulated ones.
//!
//! Both evaluate the columns of the catalogue on a [`Record`] of the run, at plateau means or at samples, with the linear sensor that
//! [`PreparedRun`] fits, as the diagnosis did when it found the effect.

mod added;
pub mod in_sines;
mod off_samples;

pub use added::{Added, CHUNK};
pub use off_samples::OffSamples;

use super::prepared::{PreparedRun, Samples};
use crate::data::error::Finding;
use crate::data::note::{Note, NoteKind};
use crate::data::plateau::{Drop, Plateau, Plateaus};
use crate::data::provenance::Input;
use crate::data::run::{Kind, Run, interpolate};
use crate::data::units::{COMPONENTS, Scale};
use crate::files::parameter::{Model, ModelEffect};
use crate::files::text::Group;
use crate::fit::smooth::Course;
use crate::model::applied::{AppliedEffect, ModelApplied};
use crate::model::campaign::Instructions;
use crate::model::effects::earthfield_leakage::EarthfieldLeakage;
use crate::model::effects::in_samples::InSamples;
use crate::model::effects::in_sine::{CORRELATION, InSine, Poles};
use crate::model::effects::record::{Channel, earlier_fields};
use crate::model::effects::thermal_lag::{self, ThermalLag};
use crate::model::effects::{
    Acts, Catalogue, Changes, Column, Covariate, Effect, EffectRef, Family, Record, Row, Spec, Thermal, unknown_columns,
};
use crate::model::lag::Lag;
use nalgebra::{Matrix3, Vector3};
use thiserror::Error;

/// Readings beyond those of the runs in which an effect was found by more than this part of their range are an extrapolation.
const BEYOND: f64 = 0.01;
/// The linear sensor is fitted so often to readings without the effects: the second time they are the corrected ones.
const FITS: usize = 2;
/// Step of the derivative by a shape parameter, as a part of its value.
const SHAPE_STEP: f64 = 1e-3;

/// An effect that is known.
#[derive(Clone, Debug, PartialEq)]
pub struct Given {
    /// The effect.
    pub effect: EffectRef,
    /// Form, axes and shape.
    pub spec: Spec,
    /// Values of the linear parameters.
    pub values: Vec<f64>,
    /// What it does to sines.
    pub in_sine: Option<InSine>,
    /// Runs in which it was found.
    pub runs: Vec<String>,
}

impl Given {
    /// Why it does not hold for a run: it belongs to the times of others.
    #[must_use]
    pub fn of_another(&self, run: &str) -> Option<String> {
        let of_others = self.effect.is_of_one_run(&self.spec.form) && !self.runs.iter().any(|r| r == run);
        let runs = self.runs.join(", ");
        of_others.then(|| format!("{} holds for the times of the run in which it was found ({runs}) alone", self.effect))
    }

    /// The lag of the thermistor, if it is one.
    #[must_use]
    pub fn thermal_lag(&self) -> Option<Lag> {
        thermal_lag::of(&self.spec).filter(|_| self.effect.is(&ThermalLag))
    }

    /// Whether it shows inside the plateaus and is known from there.
    #[must_use]
    pub fn is_inside(&self) -> bool {
        self.effect.acts_in(Acts::Samples) && self.in_sine.is_none()
    }
}

/// The effects of a model file.
#[derive(Clone, Debug, PartialEq)]
pub struct Known {
    /// The file, under its name.
    pub input: Input,
    /// The effects, in the order of the file.
    pub effects: Vec<KnownEffect>,
    /// Sensor and mode of the runs in which they were found; absent where the file does not tell.
    pub of: Option<[String; 2]>,
}

/// Effects of another sensor or mode.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("{file} holds effects of {} {}, and this is of {} {}", of[0], of[1], this[0], this[1])]
pub struct OtherSensor {
    /// The model file.
    pub file: String,
    /// Sensor and mode of the model.
    pub of: [String; 2],
    /// Sensor and mode of what it is used for.
    pub this: [String; 2],
}

impl OtherSensor {
    /// What to do about it.
    pub const REMEDY: &str = "name the model of this sensor and mode, or leave --model out";
}

/// An effect of a model file.
#[derive(Clone, Debug, PartialEq)]
pub struct KnownEffect {
    /// Id, form, axes, shape and values.
    pub given: Given,
    /// Standard uncertainties of the values; zero where the file has none.
    pub std: Vec<f64>,
    /// The same of the continuous shape parameter, in its unit.
    pub shape_std: f64,
    /// What it does to a sine if its parameters move along the axes of their uncertainty by one standard deviation, one after the other.
    pub sine_variants: Vec<InSine>,
    /// Smallest and largest reading of the sensor axes with which it was found, enT; absent if the file does not tell.
    pub reading_ent: Option<[[f64; 2]; 3]>,
}

/// What was taken off the means of a run.
#[derive(Clone, Debug)]
pub struct Applied {
    /// For the parameter file.
    pub part: ModelApplied,
    /// Standard uncertainty of each parameter, and the change of the mean reading of every plateau per unit of it, enT.
    pub carried: Vec<(f64, Vec<[f64; 3]>)>,
}

impl Applied {
    /// The changes of the mean readings of all plateaus by one standard uncertainty of each parameter, enT.
    #[must_use]
    pub fn changes_ent(&self) -> Vec<Vec<[f64; 3]>> {
        let scaled = |(std, values): &(f64, Vec<[f64; 3]>)| values.iter().map(|unit| unit.map(|v| std * v)).collect();
        self.carried.iter().map(scaled).collect()
    }
}

impl Known {
    /// The effects of a model file by a catalogue; `groups` are its tables `[[effect]]`, for the place of a complaint.
    ///
    /// # Errors
    /// An effect, form or axis that the catalogue does not have, or a parameter that is missing, with its line.
    pub fn of(input: Input, model: &Model, groups: &[Group], catalogue: &Catalogue) -> Result<Self, Finding> {
        let effects = model.effect.iter().zip(groups).map(|(e, group)| {
            let own = e.run.iter().cloned();
            let runs = if e.run.is_some() { own.collect() } else { model.used.clone() };
            KnownEffect::of(e, runs, group, catalogue)
        });
        let of = model.sensor.clone().zip(model.mode.clone()).map(|(sensor, mode)| [sensor, mode]);
        Ok(Self { input, effects: effects.collect::<Result<_, _>>()?, of })
    }

    /// Refuses its use for another sensor or mode. Effects of the facility are the same for every sensor.
    ///
    /// # Errors
    /// [`OtherSensor`]
    pub fn holds_for(&self, sensor: &str, mode: &str) -> Result<(), OtherSensor> {
        match &self.of {
            Some(of) if self.is_of_a_sensor() && of.each_ref().map(String::as_str) != [sensor, mode] => {
                let this = [sensor.to_owned(), mode.to_owned()];
                Err(OtherSensor { file: self.input.path.clone(), of: of.clone(), this })
            }
            _ => Ok(()),
        }
    }

    /// A note where the file does not tell of which sensor and mode its effects are.
    #[must_use]
    pub fn untold(&self) -> Option<Note> {
        let file = &self.input.path;
        let text = format!("{file} does not tell of which sensor and mode its effects are, so that this was not compared");
        let note = || Note::new(NoteKind::Model, text).about(file.as_str());
        let remedy = "make it again with `calfit diagnose --write-model`";
        (self.of.is_none() && self.is_of_a_sensor()).then(|| note().with_remedy(remedy))
    }

    fn is_of_a_sensor(&self) -> bool {
        self.effects.iter().any(|e| e.given.effect.about().family != Family::Facility)
    }

    /// For the diagnosis.
    #[must_use]
    pub fn given(&self) -> Vec<Given> {
        self.effects.iter().map(|e| e.given.clone()).collect()
    }

    /// The lag of the thermistor, if it is among the effects.
    #[must_use]
    pub fn thermal_lag(&self) -> Option<Lag> {
        self.effects.iter().find_map(|e| e.given.thermal_lag())
    }
}

impl KnownEffect {
    fn of(entry: &ModelEffect, runs: Vec<String>, group: &Group, catalogue: &Catalogue) -> Result<Self, Finding> {
        let help = format!("see `calfit effects {}`", entry.id);
        let effect = catalogue
            .named(&entry.id)
            .ok_or_else(|| group.refuse("id", "is no effect of the catalogue", "list the catalogue with `calfit effects`"))?;
        let axes: Option<Vec<usize>> = entry.axes.iter().map(|a| COMPONENTS.iter().position(|c| c == a)).collect();
        let axes = axes
            .filter(|a| !a.is_empty())
            .ok_or_else(|| group.refuse("axes", "must name sensor axes", "write some of \"x\", \"y\", \"z\""))?;
        let shape = entry.shape.iter().map(|s| (s.name.clone(), s.value, s.unit.clone())).collect();
        let spec = Spec { form: entry.form.clone(), axes, shape };
        if entry.parameter.iter().chain(&entry.shape).any(|p| !p.value.is_finite()) {
            return Err(group.refuse("id", "has a value that is not finite", "correct the value, or take the effect out"));
        }
        let [plain, thermal] = [specimen(false), specimen(true)];
        let specs = [effect.specs(&plain), effect.specs(&thermal)];
        let forms: Vec<String> = specs.iter().flatten().flatten().map(|s| s.form.clone()).collect();
        let (in_sine, sine_variants) = in_sine(&*effect, &spec, entry, group, &help)?;
        let is_of_sines = in_sine.is_some();
        if !effect.is_unknown() && !forms.is_empty() && !forms.contains(&spec.form) && !is_of_sines {
            let mut names: Vec<&str> = forms.iter().map(String::as_str).collect();
            names.dedup();
            return Err(group.refuse("form", &format!("is none of {}", names.join(", ")), &help));
        }
        // Effects that only show between runs or in sines have no term of a reading.
        let has_term = specs.iter().any(Result::is_ok) && !is_of_sines;
        let columns = if is_of_sines {
            None
        } else if effect.is_unknown() {
            let covariate = Covariate { name: spec.form.clone(), unit: "", values: vec![0.0; plain.rows.len()], gain: false };
            unknown_columns(&plain, &covariate, &spec)
        } else {
            effect.columns(&plain, &spec).or_else(|| effect.columns(&thermal, &spec))
        };
        if has_term && columns.is_none() {
            return Err(group.refuse("id", "lacks a shape parameter of its form", &help));
        }
        let names = columns.unwrap_or_default().into_iter().map(|c| c.name);
        let mut values = Vec::new();
        let mut std = Vec::new();
        // A lag changes the temperatures: its column, a part of one, is no parameter.
        for name in names.filter(|_| effect.changes() != Changes::Temperatures) {
            let found = entry.parameter.iter().find(|p| p.name == name);
            let found = found.ok_or_else(|| group.refuse("id", &format!("lacks its parameter `{name}`"), &help))?;
            values.push(found.value);
            std.push(found.std.unwrap_or(0.0));
        }
        let shape = effect.continuous(&spec).and_then(|(name, _)| entry.shape.iter().find(|s| s.name == name));
        let shape_std = shape.and_then(|s| s.std).unwrap_or(0.0);
        let given = Given { effect, spec, values, in_sine, runs };
        let reading_ent = entry.reading_ent.as_ref().and_then(|r| <[[f64; 2]; 3]>::try_from(r.clone()).ok());
        Ok(Self { given, std, shape_std, sine_variants, reading_ent })
    }

    pub(super) fn columns(&self, record: &Record) -> Option<Vec<Column>> {
        let columns = self.given.effect.columns(record, &self.given.spec)?;
        (columns.len() == self.given.values.len()).then_some(columns)
    }

    /// What it contributes to the rows of a record.
    fn contribution(&self, columns: &[Column], rows: usize) -> Vec<[f64; 3]> {
        let mut own = vec![[0.0; 3]; rows];
        for (column, value) in columns.iter().zip(&self.given.values) {
            for (total, unit) in own.iter_mut().zip(&column.values) {
                (0..3).for_each(|a| total[a] += value * unit[a]);
            }
        }
        own
    }

    /// Its change per unit of the continuous shape parameter; `None` of a shape that is known exactly.
    fn by_shape(&self, record: &Record) -> Option<Vec<[f64; 3]>> {
        let (name, value) = self.given.effect.continuous(&self.given.spec).filter(|_| self.shape_std > 0.0)?;
        let by = (SHAPE_STEP * value.abs()).min(self.shape_std);
        let at = |value: f64| {
            let mut spec = self.given.spec.clone();
            spec.shape.iter_mut().filter(|(own, _, _)| own == name).for_each(|shape| shape.1 = value);
            let columns = self.given.effect.columns(record, &spec)?;
            Some(self.contribution(&columns, record.rows.len()))
        };
        let (more, less) = (at(value + by)?, at(value - by)?);
        let slope = |(more, less): (&[f64; 3], &[f64; 3])| std::array::from_fn(|a| (more[a] - less[a]) / (2.0 * by));
        Some(more.iter().zip(&less).map(slope).collect()).filter(|_| by > 0.0)
    }

    /// Why it has no term in the readings of a run.
    fn unusable(&self, record: &Record) -> Option<String> {
        let (effect, kind) = (self.given.effect, record.kind);
        let [begin, end] = record.span_s;
        if effect.changes() == Changes::Temperatures {
            return (record.thermal.is_none()).then(|| format!("{effect} has no influence on a {kind} run"));
        }
        if let Some(onset_s) = effect.begins_s(&self.given.spec)
            && !(begin..=end).contains(&onset_s)
        {
            return Some(format!("{effect} begins at {onset_s:.0} s, outside of the run ({begin:.0} to {end:.0} s)"));
        }
        if effect.in_samples().is_some_and(InSamples::follows_steps) && record.steps.is_empty() {
            return Some(format!("{effect} needs the steps of the field, which the run does not tell"));
        }
        if self.columns(record).is_none() {
            return Some(match effect.specs(record) {
                Err(reason) => format!("{effect} has no term in this run: {reason}"),
                Ok(_) => format!("{effect} needs what the run does not have: {}", effect.about().needs),
            });
        }
        None
    }

    /// Says where it is used beyond the readings with which it was found.
    fn extrapolates(&self, record: &Record, file: &str, notes: &mut impl Extend<Note>) {
        let axes = &self.given.spec.axes;
        let follows = |axis: usize| match self.given.effect.about().family {
            Family::StaticOdd | Family::StaticEven => axes.contains(&axis),
            // The fields across the axes on which it acts.
            Family::CrossField => axes.iter().any(|own| *own != axis),
            Family::Unknown => true,
            _ => false,
        };
        let Some(ranges) = self.reading_ent else { return };
        for (axis, [low, high]) in ranges.into_iter().enumerate().filter(|(axis, _)| follows(*axis)) {
            let beyond = |x: f64| (low - x).max(x - high);
            let farthest = record.rows.iter().map(|r| beyond(r.linear_ent[axis])).fold(0.0, f64::max);
            if farthest > BEYOND * (high - low) && high > low {
                notes.extend([Note::new(
                    NoteKind::Model,
                    format!(
                        "{} of {file} was found with readings of {} from {low:.0} to {high:.0} enT, this run goes {farthest:.0} \
                     enT beyond",
                        self.given.effect, COMPONENTS[axis]
                    ),
                )
                .about(self.given.effect.id())]);
            }
        }
    }

    /// Says to what offsets refer from which it took a part.
    fn refers_to(&self, record: &Record) -> Option<Note> {
        let [x, y, z] = record.variometer.as_ref().filter(|_| self.given.effect.is(&EarthfieldLeakage))?;
        let text = format!(
            "{} is taken off as deviations from the mean variometer reading of the run, {:.2}, {:.2}, {:.2} nT: the offset is that at this \
             reading, and has κ times it in it",
            self.given.effect, x.mean, y.mean, z.mean
        );
        Some(Note::new(NoteKind::Model, text).about(self.given.effect.id()))
    }

    /// For a parameter file, with its largest contribution to a mean reading.
    pub(super) fn applied(&self, largest_nt: f64) -> AppliedEffect {
        AppliedEffect {
            id: self.given.effect.to_string(),
            form: self.given.spec.form.clone(),
            axes: self.given.spec.axis_names().into_iter().map(str::to_owned).collect(),
            largest_nt: Some(largest_nt),
            largest_part: None,
        }
    }

    pub(super) fn name(&self) -> String {
        format!("{} {}", self.given.effect, self.given.spec.axis_names().concat())
    }
}

/// What an effect does to sines, and with its parameters moved by their uncertainties.
fn in_sine(
    effect: &dyn Effect,
    spec: &Spec,
    entry: &ModelEffect,
    group: &Group,
    help: &str,
) -> Result<(Option<InSine>, Vec<InSine>), Finding> {
    let find = |name: &str| entry.parameter.iter().chain(&entry.shape).find(|p| p.name == name);
    let mut used: Vec<(f64, f64)> = Vec::new();
    let mut missing = None;
    let plain = effect.in_sine(spec, &mut |name| {
        let found = find(name);
        missing = missing.take().or_else(|| found.is_none().then(|| name.to_owned()));
        used.push(found.map_or((f64::NAN, 0.0), |p| (p.value, p.std.unwrap_or(0.0))));
        used[used.len() - 1].0
    });
    if let Some(name) = missing.filter(|_| plain.is_some()) {
        return Err(group.refuse("id", &format!("lacks its parameter `{name}`"), help));
    }
    if let Some(InSine::Poles { corner_hz, poles, .. }) = plain {
        let has_no_quality = matches!(poles, Poles::Two { quality } if quality <= 0.0);
        for (is_wrong, name) in [(corner_hz <= 0.0, "frequency f_c"), (has_no_quality, "quality")] {
            if is_wrong {
                return Err(group.refuse(
                    "id",
                    &format!("has a {name} that is not positive"),
                    "correct the value, or take the effect out",
                ));
            }
        }
    }
    // The two parameters of a pole go together.
    let r = find(CORRELATION).map_or(0.0, |p| p.value.clamp(-1.0, 1.0));
    let moves: Vec<Vec<f64>> = match used.as_slice() {
        [(_, a), (_, b)] => vec![vec![*a, r * b], vec![0.0, (1.0 - r * r).sqrt() * b]],
        _ => (0..used.len()).map(|k| (0..used.len()).map(|j| if j == k { used[k].1 } else { 0.0 }).collect()).collect(),
    };
    let variants = moves.iter().filter(|m| m.iter().any(|m| *m != 0.0)).filter_map(|moved| {
        // A large step keeps the sign, as frequencies must.
        let mut values =
            used.iter().zip(moved).map(|((value, _), by)| if *value == 0.0 { *by } else { value * (by / value).exp() });
        effect.in_sine(spec, &mut |_| values.next().unwrap_or(f64::NAN))
    });
    Ok((plain, variants.collect()))
}

/// A small record in which every covariate moves: what parameters a form has.
fn specimen(with_temperature: bool) -> Record {
    const ROWS: usize = 16;
    let span_s = [0.0, 4000.0];
    let at = |i: usize| span_s[1] * i as f64 / (ROWS - 1) as f64;
    let channel = || {
        let series: Vec<(f64, f64)> = (0..ROWS).map(|i| (at(i), i as f64)).collect();
        let values: Vec<f64> = series.iter().map(|(_, v)| *v).collect();
        let mean = values.iter().sum::<f64>() / ROWS as f64;
        Channel { name: String::new(), course: Course::exact(series), values, mean }
    };
    let field = |i: usize| [i as f64, -(i as f64), 1.0];
    let row = |i: usize| Row {
        run: 0,
        used_s: [at(i); 2],
        field_coil_nt: field(i),
        earlier_coil_nt: std::array::from_fn(|k| field(i.saturating_sub(k + 1))),
        linear_ent: field(i),
    };
    let thermal = Thermal {
        middle_degc: 0.5 * (ROWS - 1) as f64,
        half_k: 0.5 * (ROWS - 1) as f64,
        response: vec![Matrix3::identity(); 3],
        offset_ent: vec![[0.0; 3]; 3],
        degc: (0..ROWS).map(|i| i as f64).collect(),
    };
    Record {
        trend_order: super::prepared::TREND_ORDER,
        kind: if with_temperature { Kind::Sweep } else { Kind::Linearity },
        scale: Scale::Engineering,
        rows: (0..ROWS).map(row).collect(),
        response: Matrix3::identity(),
        span_s,
        steps: Vec::new(),
        sensor: Some(channel()),
        thermistors: Vec::new(),
        coil: Some(channel()),
        rack: Some(channel()),
        variometer: Some([channel(), channel(), channel()]),
        others: Vec::new(),
        thermal: with_temperature.then_some(thermal),
        has_samples: true,
    }
}

/// Takes the known effects of a model off the means of the plateaus, whose settings are reference fields by now. What cannot be taken
/// off is left and warned about.
#[must_use]
pub fn apply(
    known: &Known,
    run: &Run,
    plateaus: &Plateaus,
    list: &mut [Plateau],
    instructions: &Instructions,
    notes: &mut impl Extend<Note>,
) -> Applied {
    notes.extend(known.untold());
    let file = &known.input.path;
    let mut part = ModelApplied { file: file.clone(), effect: Vec::new(), left_out: Vec::new() };
    let mut carried = Vec::new();
    let same = Plateaus { list: list.to_vec(), ..plateaus.clone() };
    let samples = pauses(plateaus);
    let samples = run.blocks.is_empty().then_some(&samples);
    let mut prepared = match PreparedRun::new(run, &same, samples, instructions, None) {
        Ok(prepared) => prepared,
        Err(reason) => {
            notes.extend([
                Note::new(NoteKind::Model, format!("no effect of {file} was taken off: {}", reason.0)).about(file.as_str())
            ]);
            part.left_out = known.effects.iter().map(KnownEffect::name).collect();
            return Applied { part, carried };
        }
    };
    if let Some(lag) = known.thermal_lag() {
        prepared.follow(lag);
    }
    let mut usable: Vec<&KnownEffect> = Vec::new();
    for effect in &known.effects {
        let reason = effect.given.of_another(&run.header.run).or_else(|| effect.unusable(&prepared.record));
        match reason {
            Some(reason) => {
                notes.extend([Note::new(NoteKind::Model, format!("not taken off: {reason}")).about(effect.name())]);
                part.left_out.push(effect.name());
            }
            None => {
                effect.extrapolates(&prepared.record, file, notes);
                notes.extend(effect.refers_to(&prepared.record));
                usable.push(effect);
            }
        }
    }
    let base = prepared.record.rows.len();
    let mut rows = Vec::new();
    for fit in 0..FITS {
        let mut readings = prepared.readings.clone();
        // The prepared run has the plateaus that are used; those that are not are corrected too, for their residuals.
        let places: Vec<usize> = (0..list.len()).filter(|i| list[*i].dropped.is_none()).collect();
        let others: Vec<usize> =
            (0..list.len()).filter(|i| list[*i].dropped.as_ref().is_some_and(|d| *d != Drop::Sine)).collect();
        rows = [places, others.clone()].concat();
        let tail = others.iter().map(|i| row_of(list, *i)).collect();
        let mut record = prepared.record.clone();
        set_tail(&mut record, base, tail);
        part.effect.clear();
        carried.clear();
        let mut sum = vec![[0.0; 3]; rows.len()];
        for effect in &usable {
            let columns = effect.columns(&record).unwrap_or_default();
            let own = effect.contribution(&columns, rows.len());
            let sizes = columns.into_iter().zip(&effect.std).filter(|(_, std)| **std > 0.0);
            carried.extend(sizes.map(|(column, std)| (*std, column.values)));
            carried.extend(effect.by_shape(&record).map(|slope| (effect.shape_std, slope)));
            let size = |v: &[f64; 3]| (0..3).map(|a| v[a].abs() * prepared.nt_per_ent[a]).fold(0.0, f64::max);
            part.effect.push(effect.applied(own.iter().take(base).map(size).fold(0.0, f64::max)));
            for (total, own) in sum.iter_mut().zip(&own) {
                (0..3).for_each(|a| total[a] += own[a]);
            }
        }
        if fit + 1 < FITS {
            for i in 0..base {
                (0..3).for_each(|a| readings[(i, a)] -= sum[i][a]);
            }
            prepared.refit(&readings);
        } else {
            for (own, place) in sum.iter().zip(&rows) {
                (0..3).for_each(|a| list[*place].mean.0[a] -= own[a]);
            }
        }
    }
    // From the order of the rows to that of the plateaus.
    for (_, values) in &mut carried {
        let mut ordered = vec![[0.0; 3]; list.len()];
        for (value, place) in values.iter().zip(&rows) {
            ordered[*place] = *value;
        }
        *values = ordered;
    }
    Applied { part, carried }
}

/// The readings in the pauses, which tell what is applied there.
fn pauses(plateaus: &Plateaus) -> Samples {
    let (t_s, reading_ent): (Vec<f64>, Vec<[f64; 3]>) = plateaus.pauses.iter().copied().unzip();
    Samples { n: (0..t_s.len() as u64).collect(), t_s, reading_ent }
}

fn row_of(list: &[Plateau], index: usize) -> Row {
    let earlier = earlier_fields(|before| list.get(index.checked_sub(before)?).map(|p| p.setting.field.0));
    let p = &list[index];
    Row { run: 0, used_s: p.used_s, field_coil_nt: p.setting.field.0, earlier_coil_nt: earlier, linear_ent: [0.0; 3] }
}

/// Puts rows behind the first `base` ones, in place of those that are there: what an effect looks up in the whole record, ranges and
/// means, stays that of the run.
fn set_tail(record: &mut Record, base: usize, rows: Vec<Row>) {
    record.rows.truncate(base);
    let times: Vec<f64> = rows.iter().map(Row::t_s).collect();
    record.rows.extend(rows);
    let channels = record.sensor.iter_mut().chain(&mut record.coil).chain(&mut record.rack);
    let channels = channels.chain(&mut record.thermistors).chain(&mut record.others);
    for channel in channels.chain(record.variometer.iter_mut().flatten()) {
        channel.values.truncate(base);
        channel.values.extend(times.iter().map(|t| interpolate(&channel.course.series, *t)));
    }
    if let Some(thermal) = &mut record.thermal {
        thermal.degc.truncate(base);
        thermal.degc.extend(times.iter().map(|t| record.sensor.as_ref().map_or(f64::NAN, |c| interpolate(&c.course.series, *t))));
    }
    for i in base..record.rows.len() {
        let response = record.thermal.as_ref().map_or(record.response, |thermal| {
            let u = thermal.u(i);
            thermal.response.iter().enumerate().fold(Matrix3::zeros(), |sum, (power, m)| sum + m * u.powi(power as i32))
        });
        let row = &mut record.rows[i];
        row.linear_ent = (response * Vector3::from(row.field_coil_nt)).into();
    }
}
