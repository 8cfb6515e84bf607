//! Known effects of a sensor on single readings whose circumstances are not known: those that are functions of the reading alone.

use super::known::{Known, KnownEffect};
use crate::data::note::{Note, NoteKind};
use crate::data::run::Kind;
use crate::data::units::Scale;
use crate::model::applied::AppliedEffect;
use crate::model::effects::{EffectRef, Family, Record, Row};
use nalgebra::Matrix3;
use thiserror::Error;

/// The terms are small beside the reading of which they are functions: each round leaves the square of their slope, which is below 1e-3.
const ROUNDS: usize = 4;

/// An effect that readings alone do not determine.
#[derive(Clone, Debug, Error, PartialEq)]
#[error("{effect} is no function of the reading alone: {needs}")]
pub struct NeedsMore {
    /// The effect.
    pub effect: String,
    /// What it needs.
    pub needs: &'static str,
}

/// The effects of a model that are functions of the reading of the linear sensor.
#[derive(Clone, Debug, PartialEq)]
pub struct SingleReadings {
    effects: Vec<KnownEffect>,
}

/// An effect of a model that single readings do not determine.
#[derive(Clone, Debug, PartialEq)]
pub struct LeftOut {
    /// Its id.
    pub effect: EffectRef,
    /// Id and axes.
    pub name: String,
    /// Why they do not.
    pub why: Why,
}

/// Why single readings do not determine an effect.
#[derive(Clone, Copy, Debug, Error, PartialEq, Eq)]
pub enum Why {
    /// They do not have it, and why.
    #[error("{0}")]
    NotThere(&'static str),
    /// They have it, and it needs this besides.
    #[error("it is no function of the reading alone: {0}")]
    NeedsMore(&'static str),
}

/// What is taken off a reading.
#[derive(Clone, Debug, PartialEq)]
pub struct TakenOff {
    /// Sum of the effects, enT.
    pub sum_ent: [f64; 3],
    /// For every uncertain parameter the change of the reading by its standard uncertainty, enT.
    pub uncertain_ent: Vec<[f64; 3]>,
    /// The reading lies beyond those with which an effect was found.
    pub beyond: bool,
}

impl SingleReadings {
    /// The effects of a model, and notes on those that such readings do not have: effects of the facility, of the times of a run, of its
    /// damages, and of the response to alternating fields, which is not applied.
    ///
    /// # Errors
    /// An effect that the readings have and that cannot be told from them.
    pub fn of(known: &Known) -> Result<(Self, Vec<Note>), NeedsMore> {
        let (readings, left_out) = Self::of_these(known);
        let note = |LeftOut { effect, why, .. }| match why {
            Why::NotThere(reason) => {
                let text = format!("{effect} of {} is not taken off these readings: {reason}", known.input.path);
                Ok(Note::new(NoteKind::Method, text).about(effect.id()))
            }
            Why::NeedsMore(needs) => Err(NeedsMore { effect: effect.to_string(), needs }),
        };
        Ok((readings, left_out.into_iter().map(note).collect::<Result<_, _>>()?))
    }

    /// The effects of a model that readings alone determine, and those that they do not.
    #[must_use]
    pub fn of_these(known: &Known) -> (Self, Vec<LeftOut>) {
        let mut effects = Vec::new();
        let mut left_out = Vec::new();
        for effect in &known.effects {
            match why_not(effect) {
                None => effects.push(effect.clone()),
                Some(why) => left_out.push(LeftOut { effect: effect.given.effect, name: effect.name(), why }),
            }
        }
        (Self { effects }, left_out)
    }

    /// For a parameter file, with the largest contribution of each effect to readings without their offset, enT, of which one enT along each
    /// sensor axis is so many nT.
    #[must_use]
    pub fn applied(&self, without_offset_ent: &[[f64; 3]], nt_per_ent: [f64; 3]) -> Vec<AppliedEffect> {
        let largest_nt = |effect: &KnownEffect| {
            let alone = Self { effects: vec![effect.clone()] }.taken_off(without_offset_ent);
            let size = |one: &TakenOff| (0..3).map(|a| one.sum_ent[a].abs() * nt_per_ent[a]).fold(0.0, f64::max);
            alone.iter().map(size).fold(0.0, f64::max)
        };
        self.effects.iter().map(|effect| effect.applied(largest_nt(effect))).collect()
    }

    /// What is taken off readings, given without their offset, enT.
    #[must_use]
    pub fn taken_off(&self, without_offset_ent: &[[f64; 3]]) -> Vec<TakenOff> {
        let mut record = record(without_offset_ent);
        let mut sums = vec![[0.0; 3]; without_offset_ent.len()];
        for _ in 0..ROUNDS {
            for ((row, own), sum) in record.rows.iter_mut().zip(without_offset_ent).zip(&sums) {
                row.linear_ent = std::array::from_fn(|i| own[i] - sum[i]);
            }
            sums.fill([0.0; 3]);
            for effect in &self.effects {
                for (column, value) in effect.columns(&record).unwrap_or_default().iter().zip(&effect.given.values) {
                    for (sum, unit) in sums.iter_mut().zip(&column.values) {
                        (0..3).for_each(|i| sum[i] += value * unit[i]);
                    }
                }
            }
        }
        let mut found: Vec<TakenOff> =
            sums.into_iter().map(|sum_ent| TakenOff { sum_ent, uncertain_ent: Vec::new(), beyond: false }).collect();
        for effect in &self.effects {
            for (column, std) in
                effect.columns(&record).unwrap_or_default().iter().zip(&effect.std).filter(|(_, std)| **std > 0.0)
            {
                for (one, unit) in found.iter_mut().zip(&column.values) {
                    one.uncertain_ent.push(unit.map(|u| u * std));
                }
            }
            if let Some(ranges) = effect.reading_ent {
                for (one, row) in found.iter_mut().zip(&record.rows) {
                    one.beyond |= (0..3).any(|i| !(ranges[i][0]..=ranges[i][1]).contains(&row.linear_ent[i]));
                }
            }
        }
        found
    }
}

/// Why single readings do not determine an effect; `None` where they do.
fn why_not(effect: &KnownEffect) -> Option<Why> {
    let about = effect.given.effect.about();
    Some(match about.family {
        Family::StaticOdd | Family::StaticEven | Family::CrossField => return None,
        Family::Facility => Why::NotThere("it belongs to the facility"),
        Family::Time => Why::NotThere("it belongs to the times of its run"),
        Family::DataFault => Why::NotThere("it is a damage of the data of its run"),
        Family::Response => Why::NotThere("the response to alternating fields is not applied"),
        Family::Thermal | Family::History | Family::Periodic | Family::Unknown => Why::NeedsMore(about.needs),
    })
}

/// Readings of which nothing else is known.
fn record(readings_ent: &[[f64; 3]]) -> Record {
    let zero = [0.0; 3];
    let row = |linear_ent: &[f64; 3]| Row {
        run: 0,
        used_s: [0.0; 2],
        field_coil_nt: zero,
        earlier_coil_nt: Default::default(),
        linear_ent: *linear_ent,
    };
    Record {
        kind: Kind::Linearity,
        scale: Scale::Engineering,
        rows: readings_ent.iter().map(row).collect(),
        response: Matrix3::identity(),
        span_s: [0.0; 2],
        steps: Vec::new(),
        sensor: None,
        thermistors: Vec::new(),
        coil: None,
        rack: None,
        variometer: None,
        others: Vec::new(),
        thermal: None,
        trend_order: 0,
        has_samples: true,
    }
}
