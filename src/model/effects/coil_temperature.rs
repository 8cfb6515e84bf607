//! The coil constant follows the temperature of the coils.

use super::between::{self, BETWEEN_RUNS, BetweenRuns, Cause, Runs, TOGETHER_AND_SINGLY, Term};
use super::one;
use super::record::{Channel, centred, delayed};
use super::{
    About, Acts, Column, Effect, Family, GAIN_WITH, PART_OF_THE_AMPLITUDE, Record, ShapeParameter, Spec, Unseen,
    singly_and_together,
};
use crate::data::run::Kind;
use crate::data::units::COMPONENTS;
use crate::model::position::Class;
use nalgebra::DVector;

/// Delays behind the thermistor that are tried, s: a template serves its neighbours to a factor of two.
const LAGS_S: [f64; 4] = [15.0, 60.0, 240.0, 900.0];
/// Shortest delay, as a part of the run: what is later by less is not late.
const LEAST_PART: f64 = 0.004;
/// Least correlation of a delayed temperature with itself, that of a wave and one an eighth of its period later: a wave that is late by a
/// quarter is its own rate.
const LEAST_ALIKE: f64 = std::f64::consts::FRAC_1_SQRT_2;

/// Form: a scale factor for each coil axis.
const PER_AXIS: &str = "per axis";
/// Form: one scale factor for all.
const COMMON: &str = "common";
/// Shape: the reading follows the temperature of so many seconds before.
pub const LAG: &str = "lag";
/// The covariate in words.
const COIL: &str = "coil temperature";

/// The coil constant follows the temperature of the coils.
pub struct CoilTemperature;

impl Effect for CoilTemperature {
    fn id(&self) -> &'static str {
        "coil_temperature"
    }

    fn about(&self) -> About {
        About {
            summary: "coil constant follows the coil temperature",
            formula: "B_k (1 + α_k (T_coil - T_0)) on coil axis k; T_0 is the mean over the run; T_coil at the time t, or at t - lag",
            family: Family::Facility,
            seen_in: "lin, sweep",
            needs: "coil temperature",
            source: "CH-GFZ-TR-2601 section 6",
            best_measurement: "the same settings with the coils at two temperatures, the sensor at one",
        }
    }

    fn acts(&self) -> &'static [Acts] {
        &[Acts::Means, Acts::BetweenRuns]
    }

    fn shape(&self) -> &'static [ShapeParameter] {
        const { &[ShapeParameter::continuous(LAG, "s")] }
    }

    fn shown_along(&self, _spec: &Spec) -> Option<String> {
        Some(format!("{GAIN_WITH}coil temperature"))
    }

    fn unseen_by(&self, kind: Kind) -> Option<Unseen> {
        (kind == Kind::Frequency).then_some(PART_OF_THE_AMPLITUDE)
    }

    fn specs(&self, record: &Record) -> Result<Vec<Spec>, Unseen> {
        record.require_fields()?;
        let coil = moving(record.coil.as_ref(), COIL)?;
        let mut specs = singly_and_together(PER_AXIS);
        specs.push(Spec::new(COMMON, &[0, 1, 2]));
        Ok(now_and_later(specs, coil, record))
    }

    fn columns(&self, record: &Record, spec: &Spec) -> Option<Vec<Column>> {
        let deviation = deviation(record.coil.as_ref()?, record, spec);
        Some(scale_columns(record, spec, spec.form == COMMON, "alpha", &deviation))
    }

    fn between_runs(&self, runs: &Runs) -> Option<BetweenRuns> {
        let Some(kelvin) = runs.deviations_k(|r| r.coil_degc) else {
            return Some(BetweenRuns::unseen(Cause::CoilTemperature, "the runs bring no coil temperatures that differ"));
        };
        let term = |axes: &[usize]| {
            let column = |&axis: &usize| {
                between::Column::of(format!("alpha_{}", COMPONENTS[axis]), "1/K", runs, |class, run, i| {
                    let (along, factor) = Class::Scale.sees(&runs.0[run].position, i);
                    if class == Class::Scale && along == axis { factor * kelvin[run] } else { 0.0 }
                })
            };
            Term { spec: Spec::new(BETWEEN_RUNS, axes), columns: axes.iter().map(column).collect() }
        };
        Some(BetweenRuns::tried(Cause::CoilTemperature, TOGETHER_AND_SINGLY.map(term).into()))
    }
}

/// A channel; refused if it is not there or stands still.
///
/// # Errors
/// The reason.
pub(super) fn moving<'a>(channel: Option<&'a Channel>, what: &'static str) -> Result<&'a Channel, Unseen> {
    let channel = channel.ok_or(Unseen::NotRecorded(what))?;
    let spread = centred(channel).iter().map(|v| v.abs()).fold(0.0, f64::max);
    if spread > 0.0 { Ok(channel) } else { Err(Unseen::StandsStill(what)) }
}

/// The terms of a temperature, and each of them with the delays that the run can show.
pub(super) fn now_and_later(specs: Vec<Spec>, channel: &Channel, record: &Record) -> Vec<Spec> {
    let least_s = LEAST_PART * (record.span_s[1] - record.span_s[0]);
    let now = DVector::from_vec(centred(channel));
    let alike = |lag_s: f64| {
        let then = DVector::from_vec(delayed(channel, &record.rows, lag_s));
        now.dot(&then) > LEAST_ALIKE * now.norm() * then.norm()
    };
    let lags = LAGS_S.into_iter().filter(|lag| *lag > least_s && alike(*lag));
    let late: Vec<Spec> = lags.flat_map(|lag| specs.iter().map(move |s| s.clone().with(LAG, lag, "s"))).collect();
    [specs, late].concat()
}

/// A temperature without its mean, at every row or by the term's lag before it.
pub(super) fn deviation(channel: &Channel, record: &Record, spec: &Spec) -> Vec<f64> {
    spec.get(LAG).map_or_else(|| centred(channel), |lag_s| delayed(channel, &record.rows, lag_s))
}

/// A scale factor that follows a channel: one per coil axis, or one for all.
pub(super) fn scale_columns(record: &Record, spec: &Spec, common: bool, name: &str, deviation: &[f64]) -> Vec<Column> {
    if common {
        return vec![Column::of(name, "1/K", record, |i, r| r.linear_ent.map(|x| x * deviation[i]))];
    }
    let column = |&k: &usize| {
        let reading = |i: usize, field: [f64; 3]| record.reading(one(k, field[k] * deviation[i]));
        Column::of(format!("{name}_{}", COMPONENTS[k]), "1/K", record, |i, r| reading(i, r.field_coil_nt))
    };
    spec.axes.iter().map(column).collect()
}
