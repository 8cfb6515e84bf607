//! The steps of a sensor, made of what the configuration states.

use super::housekeeping::{HousekeepingFile, bits_of};
use super::{Carry, Ground, Prepared};
use crate::data::error::Finding;
use crate::data::flags::Flags;
use crate::files::flight::daily::DailyModel;
use crate::files::flight::edited::plain;
use crate::files::flight::mission::{Counts, Jump, Mission, OffsetFrame, OutsideTemperature, RangeMatrix, Sensor};
use crate::flight::attitude::{AttitudeFaults, AttitudeStep};
use crate::flight::counts::CountsStep;
use crate::flight::daily::{Continuity, DailyStep};
use crate::flight::disturbance::{DisturbanceStep, max_gap_ns};
use crate::flight::ground::{DailySlopes, GroundStep, Limits, MatrixEntry, MatrixStep, ReadingNoise};
use crate::flight::offsets::OffsetsStep;
use crate::flight::rotate::RotateStep;
use crate::flight::temperature::Thermometer;
use crate::flight::{Block, Stage, Step, stage_of};
use crate::model::field_calibration::{AtTemperature, Coefficient, Coefficients, FieldCalibration, MatrixForm, Parameter};
use nalgebra::{DMatrix, Matrix3, Vector3};
use std::ops::Range;

/// Vectors beside the day that is made, whose model is not known.
struct NoModel;

impl Step for NoModel {
    fn apply(&self, block: &mut Block) {
        (0..block.len()).for_each(|row| block.take_away(row, Flags::TIME));
    }
}

/// The steps of a sensor and a stretch of time, stage by stage.
pub struct Steps {
    list: Vec<(Stage, Box<dyn Step>)>,
    /// What a person should know of their tables.
    pub notes: Vec<String>,
}

/// A step that acts on the vectors of one day only.
struct OnDay<S>(Range<i64>, S);

impl<S: Step> Step for OnDay<S> {
    fn apply(&self, block: &mut Block) {
        let rows = block.rows_in(&self.0);
        if rows.len() == block.len() {
            self.1.apply(block);
        } else if !rows.is_empty() {
            let mut part = block.part(&rows);
            self.1.apply(&mut part);
            block.put_part(rows.start, &part);
        }
    }
}

impl Steps {
    /// Makes the steps of a day up to a stage; `days` are those of the stretch that it needs.
    ///
    /// # Errors
    /// What is wrong with the daily model of the day, or with the readings of the housekeeping that a field follows.
    pub fn make(
        prepared: &Prepared,
        carry: &Carry,
        index: usize,
        day: i32,
        days: &Range<i32>,
        last: Stage,
    ) -> Result<Self, Finding> {
        let mission = &prepared.mission;
        let sensor = &mission.sensors[index];
        let mut list: Vec<(Stage, Box<dyn Step>)> = Vec::new();
        let mut notes = Vec::new();
        let mut models: Vec<DayModel> = if mission.steps.iter().any(|s| s == "daily") {
            days.clone().map(|own| (prepared.leap.day(own), prepared.daily(sensor, own))).collect()
        } else {
            Vec::new()
        };
        for name in &mission.steps {
            // Offsets in axes of the sensor belong to level A, whatever the place of the step and the levels that are made.
            if name == "offsets" {
                list.extend(offsets(sensor, OffsetFrame::Uvw).map(|step| (Stage::A, step)));
            }
            let Some(stage) = stage_of(name).filter(|stage| *stage <= last) else { continue };
            match name.as_str() {
                "counts" => list.push((stage, Box::new(counts(&sensor.counts)))),
                "temperature" => {
                    if let Some(ground) = &prepared.ground[index] {
                        list.push((stage, Box::new(ground.thermometer.clone())));
                    }
                }
                "ground" => {
                    let slopes = |(own, (span, model)): (i32, &DayModel)| {
                        let model = model.as_ref().ok()?.as_ref()?;
                        // A day whose continuity is not known has no vectors.
                        let joined = carry.continuity(mission, &sensor.name, own).unwrap_or_default();
                        daily_slopes(sensor, span, model, &joined)
                    };
                    list.push((stage, ground(prepared, index, days.clone().zip(&models).filter_map(slopes).collect())));
                }
                "daily" => {
                    for (own, (span, model)) in days.clone().zip(std::mem::take(&mut models)) {
                        let known = model.and_then(|model| match model {
                            None => Ok(None),
                            Some(model) => Ok(Some((model, carry.continuity(mission, &sensor.name, own)?))),
                        });
                        match known {
                            Ok(Some((model, continuity))) => {
                                let step = daily(mission, sensor, model, continuity);
                                list.push((stage, Box::new(OnDay(span, step))));
                            }
                            Ok(None) => {}
                            Err(finding) if own == day => return Err(finding),
                            Err(_) => list.push((stage, Box::new(OnDay(span, NoModel)))),
                        }
                    }
                }
                "disturbance" => {
                    for stated in &mission.disturbances {
                        let step = disturbance(prepared, stated, days)?;
                        notes.extend(step.standing(&prepared.leap.day(day)).map(|reading| {
                            format!(
                                "`{}` of the housekeeping stands at {reading} all day: what follows it is taken off as if it did not change; check \
                                 the channel",
                                stated.column
                            )
                        }));
                        list.push((stage, Box::new(step)));
                    }
                }
                "rotate" => {
                    let states = sensor.rotations.iter().map(|r| (r.span.from, r.span.to, r.uvw_to_sc)).collect();
                    list.push((stage, Box::new(RotateStep { states })));
                }
                "offsets" => list.extend(offsets(sensor, OffsetFrame::Sc).map(|step| (stage, step))),
                "attitude" => {
                    if let (Some(table), Some(celestial)) = (&prepared.attitude, &mission.celestial) {
                        let leap = &prepared.leap;
                        let table = table.over(&(leap.day(days.start).start..leap.day(days.end).start), leap)?;
                        let faults = AttitudeFaults::of(&table, celestial.max_gap_ns);
                        notes.extend(faults.notes(&table, &leap.day(day), leap));
                        let (max_gap_ns, std_rad) = (celestial.max_gap_ns, celestial.std_rad);
                        let step = AttitudeStep { table, max_gap_ns, std_rad, wrong: faults.wrong };
                        list.push((stage, Box::new(step)));
                    }
                }
                _ => {}
            }
        }
        list.sort_by_key(|(stage, _)| *stage);
        Ok(Self { list, notes })
    }

    /// Takes vectors through the steps of a stage.
    pub fn apply(&self, stage: Stage, block: &mut Block) {
        self.list.iter().filter(|(s, _)| *s == stage).for_each(|(_, step)| step.apply(block));
    }
}

/// The span of a day with its model, or why it has none.
type DayModel = (Range<i64>, Result<Option<DailyModel>, Finding>);

/// The part of a day in which a model acts, with what it does with the temperature.
fn daily_slopes(sensor: &Sensor, day: &Range<i64>, model: &DailyModel, joined: &Continuity) -> Option<DailySlopes> {
    let span = day.start..sensor.daily_to.map_or(day.end, |to| day.end.min(to));
    (span.start < span.end).then(|| DailySlopes {
        span,
        polynomials: model.polynomials.clone(),
        sum_nt_per_k: joined.sum_nt_per_k,
    })
}

fn counts(stated: &Counts) -> CountsStep {
    let ent_per_count = match stated {
        Counts::Converter { .. } => vec![stated.ent_per_count(0)],
        Counts::Factor { ent_per_count, .. } => ent_per_count.clone(),
    };
    CountsStep { ent_per_count, shift_ent: stated.shift_ent(), limits: stated.limits() }
}

fn offsets(sensor: &Sensor, frame: OffsetFrame) -> Option<Box<dyn Step>> {
    let (intervals, elsewhere): (Vec<Jump>, Vec<Jump>) = sensor.jumps.iter().copied().partition(|j| j.frame == frame);
    // Also where all of them act in axes of the sensor, level B has the flag.
    let acts = if frame == OffsetFrame::Sc { !sensor.jumps.is_empty() } else { !intervals.is_empty() };
    acts.then(|| Box::new(OffsetsStep { intervals, elsewhere }) as Box<dyn Step>)
}

pub(super) fn limits(mission: &Mission, valid_degc: [f64; 2]) -> Limits {
    let kept_degc = match (&mission.outside, &mission.extended_degc) {
        (OutsideTemperature::Flag, Some((range, _))) => [range[0].min(valid_degc[0]), range[1].max(valid_degc[1])],
        _ => valid_degc,
    };
    Limits { valid_degc, kept_degc }
}

/// Noise of a reading by mode: what is stated, and the step of the converter.
fn noise(mission: &Mission, sensor: &Sensor) -> Option<ReadingNoise> {
    if !mission.uncertainty {
        return None;
    }
    let of = |sid: &String| sensor.noise_ent.get(&Some(sid.clone())).or_else(|| sensor.noise_ent.get(&None));
    let std_ent = mission.modes.iter().map(|mode| of(&mode.sid).copied().unwrap_or(f64::NAN)).collect();
    Some(ReadingNoise { std_ent, step_ent: counts(&sensor.counts).ent_per_count })
}

fn ground(prepared: &Prepared, index: usize, daily: Vec<DailySlopes>) -> Box<dyn Step> {
    let mission = &prepared.mission;
    let sensor = &mission.sensors[index];
    let noise = noise(mission, sensor);
    match &prepared.ground[index] {
        Some(Ground { calibration, effects, thermometer, t_off_std_degc, valid_degc, convention, .. }) => Box::new(GroundStep {
            calibration: calibration.clone(),
            effects: effects.clone(),
            thermometer: thermometer.clone(),
            t_off_std_degc: *t_off_std_degc,
            limits: limits(mission, *valid_degc),
            noise,
            daily,
            frame: sensor.frame.filter(|wanted| Some(*wanted) != *convention),
        }),
        None => Box::new(MatrixStep { entries: sensor.matrices.iter().map(entry).collect(), noise }),
    }
}

/// A matrix of the configuration with its covariance.
fn entry(stated: &RangeMatrix) -> MatrixEntry {
    let subtracted = if stated.added { Vector3::zeros() } else { stated.offset };
    let elements = (0..9).map(|e| (Parameter::Matrix(e / 3, e % 3), stated.matrix[(e / 3, e % 3)]));
    let offsets = (0..3).map(|i| (Parameter::Offset(i), subtracted[i]));
    let coefficients = elements.chain(offsets).map(|(parameter, value)| Coefficient { parameter, power: 0, value }).collect();
    // An offset that is added behind the matrix acts as one of -M⁻¹ times it before: so its errors go together with those of the matrix.
    let before = stated.matrix.try_inverse().filter(|_| stated.added).map(|inverse| -inverse);
    let by_offset = before.unwrap_or_else(Matrix3::identity);
    let turn = DMatrix::from_fn(12, 12, |i, k| match (i, k) {
        (9.., 9..) => by_offset[(i - 9, k - 9)],
        _ => f64::from(u8::from(i == k)),
    });
    let covariance =
        stated.covariance.as_ref().map(|rows| &turn * DMatrix::from_fn(12, 12, |i, k| rows[i][k]) * turn.transpose());
    let parts = Coefficients { matrix: Some(MatrixForm::Whole), coefficients, covariance, ..Coefficients::default() };
    let at = FieldCalibration::new(parts).ok().and_then(|calibration| calibration.at(0.0));
    MatrixEntry {
        from: stated.span.from,
        to: stated.span.to,
        range: stated.range,
        at: at.unwrap_or_else(|| AtTemperature::exact(subtracted, stated.matrix)),
        added_nt: if stated.added { stated.offset } else { Vector3::zeros() },
    }
}

fn daily(mission: &Mission, sensor: &Sensor, model: DailyModel, continuity: Continuity) -> DailyStep {
    let limits = limits(mission, model.valid_degc);
    DailyStep { polynomials: model.polynomials, continuity, limits, to: sensor.daily_to }
}

/// The readings of the housekeeping of some days that a field follows.
fn disturbance(
    prepared: &Prepared,
    stated: &crate::files::flight::mission::Disturbance,
    days: &Range<i32>,
) -> Result<DisturbanceStep, Finding> {
    let mission = &prepared.mission;
    let Some(folder) = &mission.hk else {
        let rule = format!("the field of `{}` needs housekeeping", stated.column);
        return Err(Finding::error(&mission.folder.display().to_string(), rule, "state the folder `hk`"));
    };
    let readings = |own: &HousekeepingFile| {
        let all: Vec<usize> = (0..own.time.len()).collect();
        own.readings(prepared, &plain(&stated.column), &all)?.ok_or_else(|| own.lacks(&stated.column))
    };
    let mut rows: Vec<(i64, f64)> = Vec::new();
    for file in crate::files::flight::edited::day_files(folder)? {
        if file.day.is_some_and(|day| !(days.start - 1..days.end + 1).contains(&day)) {
            continue;
        }
        let own = match HousekeepingFile::open(prepared, &file).and_then(|own| Ok((readings(&own)?, own.time))) {
            // A day beside those that are made says itself what is wrong with it; without it only the ends of these are not known.
            Err(_) if file.day.is_some_and(|day| !days.contains(&day)) => continue,
            other => other?,
        };
        rows.extend(own.1.into_iter().zip(own.0));
    }
    rows.sort_by_key(|(time, _)| *time);
    rows.dedup_by_key(|(time, _)| *time);
    let (time, reading): (Vec<i64>, Vec<f64>) = rows.into_iter().unzip();
    // A channel of the instrument has whole counts.
    let std_unit = if bits_of(prepared, &plain(&stated.column)).is_some() { 12.0_f64.sqrt().recip() } else { 0.0 };
    let vector_nt_per_unit = stated.vector_nt_per_unit;
    Ok(DisturbanceStep { max_gap_ns: max_gap_ns(&time), time, reading, vector_nt_per_unit, std_unit })
}

/// The thermometer of a sensor, if it has one.
pub fn thermometer(prepared: &Prepared, index: usize) -> Option<&Thermometer> {
    prepared.ground[index].as_ref().map(|ground| &ground.thermometer)
}
